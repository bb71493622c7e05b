//! Prior knowledge about a chain, each item as one equation with its own σ.
//!
//! Readings leave some parameters of a chain free to first order: the position of an open end along the last
//! piece, and of a smooth joint between a line and an arc. A soft constraint fixes them and yields to
//! readings that know better.

use super::ends::End;
use super::joints::Joint;
use super::kind::ContourKind;

/// An equation between parameters of a chain that holds up to its σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum SoftConstraint {
    /// The position of an end of an open chain (σ is a length).
    End(End),
    /// A smooth joint (σ is an angle in radians).
    Joint(Joint),
}

impl SoftConstraint {
    /// Left side minus right side of the equation at `theta`; adds the derivative to `by_theta`.
    pub(crate) fn violation(&self, kind: &ContourKind, theta: &[f64], by_theta: &mut [f64]) -> f64 {
        match self {
            Self::End(end) => end.violation(kind, theta, by_theta),
            Self::Joint(joint) => joint.violation(kind, theta, by_theta),
        }
    }

    /// σ of the equation, in the unit of the violation.
    pub(crate) fn sigma(&self) -> f64 {
        match self {
            Self::End(end) => end.sigma,
            Self::Joint(joint) => joint.sigma_rad,
        }
    }
}
