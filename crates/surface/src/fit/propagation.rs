//! What a fit completed or followed beyond the readings: symmetry, gaps, motion, bending.

use super::{BendingReport, MotionReport};
use crate::complete::{GapReport, SymmetryReport};
use planish_core::vector3::add;
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
    #[serde(rename = "invented_area_fraction")]
    pub inferred_area_fraction: f64,
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
