//! More smoothness for fits whose mesh folds.
//!
//! In: the end of a fit's last stage. Out: whether to repeat it with more smoothness, and the fit with folds
//! if they follow the data.

use super::ShellFit;
use super::equations::{Equations, Source};
use super::result::finished;
use super::solve::{Search, Setup};
use super::starts::follows;
use crate::deformation::displaced_positions;
use planish_estimate::Result;

/// Factor on the smoothness weight each time the fitted mesh folds. Larger factors need fewer repetitions and
/// overshoot more.
const FOLD_WEIGHT_STEP: f64 = 4.0;
/// Largest product of [`FOLD_WEIGHT_STEP`]: bounds the repetitions at four.
const MAX_FOLD_WEIGHT: f64 = 256.0;
/// Largest ratio of the residuals of a fit without folds to those of the fit with folds. Above it, the folds
/// are taken to follow the data.
const MAX_UNFOLDED_RMS_RATIO: f64 = 1.1;

/// Raises the smoothness of the last stage until the mesh does not fold.
///
/// Where the controls cannot follow the shape, folds make up for it; more smoothness removes them if that
/// costs little. Folds that the residuals require are kept. Fits to outlines alone are left as they are,
/// because folds are not their main fault.
pub(super) struct FoldControl {
    /// Extra factor on the smoothness weight.
    pub(super) factor: f64,
    /// The smoothness weight by likelihood. The covariance uses this one: the extra factor adds no
    /// information.
    pub(super) likelihood_weight: Option<f64>,
    /// The fit with folds and its normalised rms, returned if removing the folds costs too much.
    pub(super) folded: Option<(ShellFit, f64)>,
}

impl Default for FoldControl {
    fn default() -> Self {
        Self { factor: 1.0, likelihood_weight: None, folded: None }
    }
}

impl FoldControl {
    /// Whether the stage must be repeated with the raised factor.
    pub(super) fn needs_more_smoothness(
        &mut self,
        setup: &Setup<'_>,
        search: &Search<'_>,
        equations: &[Equations],
        weight: f64,
    ) -> Result<bool> {
        let may_raise = weight > 0.0 && setup.options.prior.is_none() && self.factor < MAX_FOLD_WEIGHT;
        if !may_raise || setup.readings.points.is_empty() {
            return Ok(false);
        }
        let (mesh, deformation) = (&setup.mesh, setup.deformation);
        let moved = displaced_positions(&mesh.positions, deformation, &search.state.q);
        let folds = mesh.distortion(&moved).folds > 0;
        let rms = rms_normalized(equations);
        let fits_as_well =
            self.folded.as_ref().is_none_or(|(_, before)| rms < MAX_UNFOLDED_RMS_RATIO * before);
        if !fits_as_well {
            return Ok(false);
        }
        if !folds {
            self.folded = None;
            return Ok(false);
        }
        if self.folded.is_none() {
            let (priors, state) = (&search.priors, search.state.clone());
            let made = finished(mesh, deformation, priors, state, equations, &search.factors, weight)?;
            // At a wrong position, folds follow the data; more smoothness costs time and changes little.
            if made.unresolved_shape > 0.0 && follows(&made) {
                self.likelihood_weight = Some(weight);
                self.folded = Some((made, rms));
            }
        }
        if self.folded.is_some() {
            self.factor *= FOLD_WEIGHT_STEP;
        }
        Ok(self.folded.is_some())
    }
}

/// Root mean square of residuals divided by their stated σ, over the likely equations of readings.
fn rms_normalized(equations: &[Equations]) -> f64 {
    let of_readings = (equations.iter().flat_map(|some| &some.list))
        .filter(|e| e.source != Source::Region && e.is_likely());
    let (squares, count) =
        of_readings.fold((0.0, 0_usize), |(sum, n), e| (sum + e.normalized().powi(2), n + 1));
    (squares / count.max(1) as f64).sqrt()
}
