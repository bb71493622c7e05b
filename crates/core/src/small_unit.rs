//! The unit of lengths in messages and reports.

use crate::numbers::significant;

/// A unit in which small lengths are readable.
///
/// # Examples
/// ```
/// use planish_core::SmallUnit;
/// assert_eq!(SmallUnit::for_length("m", 0.0012).text(0.0012), "1.20 mm");
/// assert_eq!(SmallUnit::for_length("mm", 0.0012).text(0.0012), "0.00120 mm");
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmallUnit<'a> {
    /// Its name.
    pub name: &'a str,
    /// Number of these units in one unit of the model.
    pub factor: f64,
}

impl<'a> SmallUnit<'a> {
    /// A readable unit for a typical length, given the unit of the model. For a model in metres, lengths
    /// below a centimetre are shown in millimetres.
    #[must_use]
    pub fn for_length(unit: &'a str, typical: f64) -> Self {
        if unit == "m" && typical.abs() < 0.01 {
            Self { name: "mm", factor: 1000.0 }
        } else {
            Self { name: unit, factor: 1.0 }
        }
    }

    /// A length without its unit.
    #[must_use]
    pub fn number(self, length: f64, digits: usize) -> String {
        significant(self.factor * length, digits)
    }

    /// Heading of a table column, such as `rms / mm`; without a unit, only the name of the quantity.
    #[must_use]
    pub fn head(self, what: &str) -> String {
        if self.name.is_empty() { what.to_owned() } else { format!("{what} / {}", self.name) }
    }

    /// A length with its unit.
    #[must_use]
    pub fn text(self, length: f64) -> String {
        format!("{} {}", self.number(length, 3), self.name)
    }
}
