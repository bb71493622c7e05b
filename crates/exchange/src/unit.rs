//! Units of length that files and options can name.

use std::fmt;
use std::str::FromStr;

use planish_estimate::Error;

/// The unit of every length of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Unit {
    /// Millimetres, `mm`.
    Millimetre,
    /// Metres, `m`.
    Metre,
    /// Inches of 25.4 mm, `in`.
    Inch,
    /// International feet of 304.8 mm, `ft`. US survey feet, longer by two parts in a million, are read as
    /// these.
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

    /// Length in millimetres.
    ///
    /// # Examples
    /// ```
    /// use planish_exchange::Unit;
    /// let unit: Unit = "in".parse()?;
    /// assert_eq!((unit, unit.millimetres(), unit.name()), (Unit::Inch, 25.4, "in"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn millimetres(self) -> f64 {
        match self {
            Self::Millimetre => 1.0,
            Self::Metre => 1000.0,
            Self::Inch => 25.4,
            Self::Foot => 304.8,
        }
    }
}

impl FromStr for Unit {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
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
