//! Causes for which readings are rejected.

/// Cause for which a reading is rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum RejectionCause {
    /// A coordinate was not finite.
    NotFinite,
    /// Its coordinates repeat an earlier point of its sensor to the last digit: one reading written twice.
    Duplicate,
    /// Its class in the file is noise, or is not ground where the ground is fitted.
    Class,
    /// It lies on an object on the ground, where the ground is fitted.
    AboveGround,
    /// It lies far below the ground, where the ground is fitted.
    BelowGround,
    /// It is separated from all of its neighbours by jumps in depth, or far from all other points.
    Isolated,
    /// It lies next to a jump in depth.
    DepthEdge,
    /// The sensor saw it at a grazing angle.
    Grazing,
    /// Its scan normal disagrees with the normal of the surface at its foot.
    NormalMismatch,
    /// It lies beyond the border of an open surface.
    BeyondBorder,
    /// It is farther from the surface than its error explains.
    Outlier,
    /// Its sensor measures normals or curvatures but gives none for it.
    NoDirection,
    /// The direction of its first curvature is parallel to its normal.
    DirectionAlongNormal,
}

impl RejectionCause {
    /// The key in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            // Scripts of users read these keys, so a variant that is renamed keeps its key.
            Self::NotFinite => "not_finite",
            Self::Duplicate => "duplicate",
            Self::Class => "class",
            Self::AboveGround => "above_ground",
            Self::BelowGround => "below_ground",
            Self::Isolated => "isolated",
            Self::DepthEdge => "depth_edge",
            Self::Grazing => "grazing",
            Self::NormalMismatch => "normal_mismatch",
            Self::BeyondBorder => "beyond_border",
            Self::Outlier => "outlier",
            Self::NoDirection => "no_direction",
            Self::DirectionAlongNormal => "direction_along_normal",
        }
    }
}
