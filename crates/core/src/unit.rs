//! Units of length, and lengths with a unit.
//!
//! Inside the program a length is a plain `f64` in the unit of the model, and the unit travels with the
//! model. [`Length`] is for values that a user states before the model is read.

use std::fmt;
use std::str::FromStr;

use crate::error::Error;

/// The unit of every length of a model.
///
/// # Examples
/// ```
/// use planish_core::Unit;
/// let unit: Unit = "in".parse()?;
/// assert_eq!((unit, unit.millimetres()), (Unit::Inch, 25.4));
/// assert!("yd".parse::<Unit>().is_err());
/// # Ok::<(), planish_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Unit {
    /// Millimetres, `mm`.
    Millimetre,
    /// Metres, `m`.
    Metre,
    /// Inches of 25.4 mm, `in`.
    Inch,
    /// Feet of 304.8 mm, `ft`. US survey feet, which are longer by two parts in a million, are read as these.
    Foot,
}

impl Unit {
    /// The name in files and options: `mm`, `m`, `in` or `ft`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Millimetre => "mm",
            Self::Metre => "m",
            Self::Inch => "in",
            Self::Foot => "ft",
        }
    }

    /// Its length in millimetres.
    #[must_use]
    pub fn millimetres(self) -> f64 {
        match self {
            Self::Millimetre => 1.0,
            Self::Metre => 1000.0,
            // Exact by definition: the international inch of 1959.
            Self::Inch => 25.4,
            Self::Foot => 304.8,
        }
    }
}

impl FromStr for Unit {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        // By the names that are written, so that every written unit can be read.
        [Self::Millimetre, Self::Metre, Self::Inch, Self::Foot]
            .into_iter()
            .find(|unit| unit.name() == name)
            .ok_or_else(|| Error::input(format!("unit `{name}`: expected `mm`, `m`, `in` or `ft`")))
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A length as a user states it: in a unit of its own, or in the unit of the model.
///
/// # Examples
/// ```
/// use planish_core::{Length, Unit};
/// let stated = Length { value: 2.0, unit: Some(Unit::Inch) };
/// assert_eq!(stated.in_unit(Unit::Millimetre), 50.8);
/// let without_unit = Length { value: 2.0, unit: None };
/// assert_eq!(without_unit.in_unit(Unit::Metre), 2.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// The number, in `unit`.
    pub value: f64,
    /// The unit; `None` for that of the model.
    pub unit: Option<Unit>,
}

impl Length {
    /// The length in the given unit. A length without a unit is in that unit already.
    #[must_use]
    pub fn in_unit(self, unit: Unit) -> f64 {
        self.value * self.unit.unwrap_or(unit).millimetres() / unit.millimetres()
    }
}

impl From<f64> for Length {
    /// A length in the unit of the model.
    fn from(value: f64) -> Self {
        Self { value, unit: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_parse_to_their_units() {
        for unit in [Unit::Millimetre, Unit::Metre, Unit::Inch, Unit::Foot] {
            assert_eq!(unit.name().parse::<Unit>().unwrap(), unit);
        }
    }

    #[test]
    fn lengths_convert_between_units() {
        let length = Length { value: 3.0, unit: Some(Unit::Foot) };
        assert!((length.in_unit(Unit::Inch) - 36.0).abs() < 1e-13);
        assert!((length.in_unit(Unit::Metre) - 0.9144).abs() < 1e-15);
    }
}
