//! What nobody measured, concluded from what was: the paper's propagation.
//!
//! Comes in: observations. Goes out: the same with readings added that were concluded from them, each with
//! the variance of its conclusion, and a report that says what was found. Wherever something was measured,
//! that overrules: concluded readings are many times as uncertain, and none is put beside a real one.
//!
//! | module | what |
//! |---|---|
//! | symmetry | copies of the readings by a rotation or a reflection |
//! | motion | a rigid body that moves while it is scanned: pose and velocity |
//! | bending | a sheet that bends without stretch: what a fit says of it; `fit` follows it |
//! | gap | what surrounds a gap; `fit` finds the gaps of its surface |
//!
//! # References
//! The paper on Kalman spline fusion, section 3.3.

mod bending;
mod gap;
mod motion;
mod seen;
mod symmetry;

pub use bending::{BendingReport, BendingState};
pub(crate) use bending::{State, states_in_time};
pub use gap::GapReport;
pub use motion::{MotionPose, MotionReport};
pub(crate) use motion::{RigidTracker, scans_in_time};
pub(crate) use seen::Seen;
pub use symmetry::{SymmetryChoice, SymmetryReport, complete_by_symmetry};

use planish_estimate::vector3::add;
use serde::Serialize;

/// What was completed, and by what.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct PropagationReport {
    /// The symmetry that was fitted, or looked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub symmetry: Option<SymmetryReport>,
    /// The gaps that were looked at, the largest first, where that was asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub gaps: Vec<GapReport>,
    /// The motion of the thing, where that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<MotionReport>,
    /// How a sheet bent, where that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bending: Option<BendingReport>,
    /// Readings that were concluded from others.
    pub pseudo_readings: usize,
    /// Share of the surface's area that is known through them alone.
    pub invented_area_fraction: f64,
}

impl PropagationReport {
    /// The same where every point is moved.
    #[must_use]
    pub fn translated(mut self, by: [f64; 3]) -> Self {
        if let Some(symmetry) = self.symmetry.as_mut().filter(|s| s.is_found()) {
            symmetry.point = add(symmetry.point, by);
        }
        self
    }
}
