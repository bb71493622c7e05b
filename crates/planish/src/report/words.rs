//! Words that all reports share: lengths in a unit that reads well, heads of tables.

pub(crate) use planish_core::SmallUnit;

/// Prefixes a name with `A` or `An`.
pub(crate) fn with_article(name: &str) -> String {
    // Names of kinds are in lower case.
    let an = name.starts_with(['a', 'e', 'i', 'o', 'u']);
    format!("{} {name}", if an { "An" } else { "A" })
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
