//! What a fit completes or follows beyond its readings: symmetry, gaps, motion, bending.

use super::gaps::completed;
use super::refine::{ConvergedFit, refine_to_noise};
use super::{BendingReport, FitOptions, GlobalOptions, MotionReport, converge};
use crate::complete::{GapReport, SymmetryReport, complete_by_symmetry};
use crate::observe::Observations;
use planish_core::{DVec3, Progress, ProgressPart};
use planish_estimate::Result;
use serde::Serialize;

/// What was completed beyond the readings, and by what.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct PropagationReport {
    /// The symmetry that was fitted, or looked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub symmetry: Option<SymmetryReport>,
    /// The gaps, the largest first, if completion was asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub gaps: Vec<GapReport>,
    /// The motion of the object, if that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<MotionReport>,
    /// How a sheet bent, if that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bending: Option<BendingReport>,
    /// Readings inferred from others.
    pub pseudo_readings: usize,
    /// Share of the surface's area that is known through inferred readings alone.
    #[serde(rename = "invented_area_fraction")]
    pub inferred_area_fraction: f64,
}

impl PropagationReport {
    /// The same with every point moved.
    #[must_use]
    pub fn translated(mut self, by: DVec3) -> Self {
        // A motion is added later, in world coordinates. The other figures do not depend on the origin.
        if let Some(symmetry) = self.symmetry.as_mut().filter(|s| s.is_found()) {
            symmetry.point += by;
        }
        self
    }
}

/// Completes the observations as the options ask, and fits a surface to all of them.
///
/// Gaps need a surface to be found, so their completion refines that surface a second time.
pub(super) fn converge_with_propagation(
    observations: &mut Observations,
    origin: DVec3,
    global: &GlobalOptions,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<(ConvergedFit, Option<PropagationReport>)> {
    let mut report = None;
    // Symmetry comes first: it needs the readings only, and its copies may close gaps.
    if let Some(choice) = global.symmetry {
        progress.check("symmetry", 0.015)?;
        let found = complete_by_symmetry(observations, choice)?;
        let found = PropagationReport {
            symmetry: Some(found.symmetry),
            pseudo_readings: found.pseudo_readings,
            ..PropagationReport::default()
        };
        report = Some(found.translated(origin));
    }
    if !global.fill_gaps {
        return Ok((converge(observations, options, progress)?, report));
    }
    let converged = converge(observations, options, &ProgressPart::new(progress, 0.0, 0.6))?;
    let (readings, gaps) = completed(observations, &converged, options.gate);
    let mut report = report.unwrap_or_default();
    report.gaps = gaps;
    report.pseudo_readings += readings.len();
    if readings.is_empty() {
        return Ok((converged, Some(report)));
    }
    // The surface without inferred readings is near the final one, so the second refinement starts from it.
    observations.add_inferred(&readings);
    let subset = observations.fitted();
    let rest = ProgressPart::new(progress, 0.6, 0.9);
    let converged = refine_to_noise(observations, converged.surface, subset, options, &rest)?;
    Ok((converged, Some(report)))
}
