//! Quantities that readings measure, and the channels of a fit.

use planish_core::SymmetricMatrix3;
use planish_sense::Pose;

/// The quantity that a reading measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Quantity {
    /// The position of the surface; only the component along its normal counts.
    #[default]
    Position,
    /// The orientation of the surface: the tilt of both tangents.
    Normal,
    /// The curvature of the surface: the three components of the second fundamental form.
    Curvature,
}

impl Quantity {
    /// Number of components of a reading that the surface determines.
    #[must_use]
    pub fn rows(self) -> usize {
        match self {
            Self::Position => 1,
            Self::Normal => 2,
            Self::Curvature => 3,
        }
    }

    /// The name in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Normal => "normal",
            Self::Curvature => "curvature",
        }
    }
}

/// The readings of one quantity by one sensor; each channel has its own σ.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Channel {
    /// Index of the sensor in the set.
    pub sensor: usize,
    /// Quantity that it measures.
    pub quantity: Quantity,
    /// True if its readings were inferred from others. The channel then has no sensor and no noise of its
    /// own.
    pub inferred: bool,
}

/// The value of one reading, in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measured {
    /// A position, which [`Observations::points`](super::Observations) holds.
    Position,
    /// A unit normal.
    Normal([f64; 3]),
    /// The second fundamental form as a tensor in space.
    Curvature(SymmetricMatrix3),
}

impl Measured {
    /// The value after a rotation.
    pub(crate) fn turned(&self, by: &Pose) -> Self {
        match self {
            Self::Position => Self::Position,
            Self::Normal(n) => Self::Normal(by.rotate(*n)),
            Self::Curvature(tensor) => Self::Curvature(tensor.rotated(&by.rotation)),
        }
    }
}
