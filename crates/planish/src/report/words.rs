//! Words that all reports share: lengths in a unit that reads well, heads of tables.

use planish_report::numbers::significant;

/// Prefixes a name with `A` or `An`.
pub(crate) fn with_article(name: &str) -> String {
    // Names of kinds are in lower case.
    let an = name.starts_with(['a', 'e', 'i', 'o', 'u']);
    format!("{} {name}", if an { "An" } else { "A" })
}

/// A unit in which small lengths read well.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SmallUnit<'a> {
    /// Its name.
    pub name: &'a str,
    /// Number of these units in one unit of the model.
    pub factor: f64,
}

impl<'a> SmallUnit<'a> {
    /// A readable unit for a typical length, given the unit of the model. For a model in metres, lengths
    /// below a centimetre are shown in millimetres.
    pub(crate) fn for_length(unit: &'a str, typical: f64) -> Self {
        if unit == "m" && typical.abs() < 0.01 {
            Self { name: "mm", factor: 1000.0 }
        } else {
            Self { name: unit, factor: 1.0 }
        }
    }

    /// A length without its unit.
    pub(crate) fn number(self, length: f64, digits: usize) -> String {
        significant(self.factor * length, digits)
    }

    /// Heading of a table column, such as `rms / mm`.
    pub(crate) fn head(self, what: &str) -> String {
        head(what, self.name)
    }

    /// A length with its unit.
    pub(crate) fn text(self, length: f64) -> String {
        format!("{} {}", self.number(length, 3), self.name)
    }
}

/// A table heading with its unit, if there is one: `length / mm`.
pub(crate) fn head(what: &str, unit: &str) -> String {
    if unit.is_empty() { what.to_owned() } else { format!("{what} / {unit}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_have_suitable_units_and_digits() {
        let small = SmallUnit::for_length("m", 0.0012);
        assert_eq!((small.text(0.0012), small.head("rms")), ("1.20 mm".to_owned(), "rms / mm".to_owned()));
        assert_eq!(SmallUnit::for_length("m", 2.0).text(2.0), "2.00 m");
        assert_eq!(head("radius", ""), "radius");
    }
}
