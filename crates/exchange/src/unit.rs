//! Units of length that files can name.

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
}

impl Unit {
    /// The name in files and options: `mm`, `m` or `in`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Millimetre => "mm",
            Self::Metre => "m",
            Self::Inch => "in",
        }
    }

    /// How many millimetres it is long.
    #[must_use]
    pub fn millimetres(self) -> f64 {
        match self {
            Self::Millimetre => 1.0,
            Self::Metre => 1000.0,
            Self::Inch => 25.4,
        }
    }
}

impl FromStr for Unit {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        [Self::Millimetre, Self::Metre, Self::Inch]
            .into_iter()
            .find(|unit| unit.name() == name)
            .ok_or_else(|| Error::input(format!("unit `{name}`: needed `mm`, `m` or `in`")))
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
