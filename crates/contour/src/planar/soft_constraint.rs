//! What is known of a chain beside the readings, each as an equation of its own.

use super::ends::End;
use super::joints::Joint;
use super::kind::ContourKind;

/// Something that holds, to its σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum SoftConstraint {
    /// Where an open chain ends.
    End(End),
    /// A smooth joint.
    Joint(Joint),
}

impl SoftConstraint {
    /// By how much it is violation at `theta`; the derivative is added to `by_theta`.
    pub(crate) fn violation(&self, kind: &ContourKind, theta: &[f64], by_theta: &mut [f64]) -> f64 {
        match self {
            Self::End(end) => end.violation(kind, theta, by_theta),
            Self::Joint(joint) => joint.violation(kind, theta, by_theta),
        }
    }

    /// Its σ.
    pub(crate) fn sigma(&self) -> f64 {
        match self {
            Self::End(end) => end.sigma,
            Self::Joint(joint) => joint.sigma_rad,
        }
    }
}
