//! Quantities that readings measure, and the channels of a fit.

use planish_core::{DVec3, SymmetricMatrix3};
use planish_sense::{NeighbourNoise, Pose};

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
            // Only the component along the normal: the others change parameters, not the shape (decision
            // 0002).
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
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Channel {
    /// Index of the sensor in the set.
    pub sensor: usize,
    /// Quantity that it measures.
    pub quantity: Quantity,
    /// True if its readings were inferred from others. The channel then has no sensor and no noise of its
    /// own.
    pub inferred: bool,
    /// True if σ was stated: by the sensor's model, or for every point of its scans.
    pub stated: bool,
    /// Variance of the points of the channel's largest scan about the planes of their neighbours, over the
    /// stated variance (over 1 if none was stated). It is at least that of the noise, unless errors of
    /// neighbours are correlated. None if there are too few points.
    pub roughness: Option<f64>,
    /// Noise of the channel's largest scan by its neighbours, over the stated σ. None if there are too few
    /// points, or their errors are too large for their distances.
    pub neighbour_noise: Option<NeighbourNoise>,
    /// True if errors of neighbouring readings are correlated. In dense stereo they are, since neighbours
    /// share most of the matched pixels.
    pub correlated_errors: bool,
}

impl Channel {
    /// A channel of a sensor, with a stated σ until a scan states none.
    pub(super) fn new(sensor: usize, quantity: Quantity) -> Self {
        Self {
            sensor,
            quantity,
            inferred: false,
            stated: true,
            roughness: None,
            neighbour_noise: None,
            correlated_errors: false,
        }
    }

    /// The noise by neighbours, if it is evidence of σ. Where errors of neighbours are correlated, their
    /// differences are too small.
    pub(crate) fn independent_noise(&self) -> Option<NeighbourNoise> {
        self.neighbour_noise.filter(|_| !self.correlated_errors)
    }

    /// True if the channel holds the readings of a quantity by a sensor.
    pub(super) fn measures(&self, sensor: usize, quantity: Quantity) -> bool {
        self.sensor == sensor && self.quantity == quantity && !self.inferred
    }
}

/// The value of one reading, in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measured {
    /// A position, which [`ReadingColumns::points`](super::ReadingColumns) holds.
    Position,
    /// A unit normal.
    Normal(DVec3),
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
