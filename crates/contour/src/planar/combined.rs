//! Refinement of a batch fit by the marginal likelihood.
//!
//! The batch uses all readings at once: it converges from a rough start and detects outliers. However, it
//! assigns each reading to its nearest place. If the noise is a large fraction of a side or a radius, the
//! result is biased and its covariance too small. The likelihood with the places integrated out has neither
//! problem ([`most_likely`]), but it must start near its maximum.

use super::fit::{ContourFit, GatedResiduals, equations};
use super::kind::ContourKind;
use super::marginal::most_likely;
use super::options::{ContourFitOptions, outlier_gate};
use super::plausible::corners_are_real;
use super::reading::{ContourModel, ContourReading, Form};
use planish_estimate::Result;
use planish_estimate::implicit::{ImplicitOptions, fit_implicit};

/// With fewer readings per unknown, the batch is not refined: the shares of the cells are
/// estimated as well, and small samples cannot carry both.
const READINGS_PER_UNKNOWN: usize = 4;
/// Maximum distance of the refined state from the batch, in σ per parameter (root mean square).
///
/// The bias that the refinement removes is a few σ at most. A maximum farther away belongs to another shape.
const MAX_SIGMAS: f64 = 5.0;

/// The most likely contour near the batch result, or that result itself.
///
/// The result of the batch stays for lines (it already maximises the likelihood), open chains (their ends
/// have equations of their own), shared poses, the product form, and if bias correction is off.
///
/// # Errors
/// As [`fit_implicit`].
pub(super) fn combined(
    model: &ContourModel,
    readings: &[ContourReading],
    found: ContourFit,
    options: &ContourFitOptions,
) -> Result<ContourFit> {
    let is_endless = matches!(model.kind, ContourKind::Line | ContourKind::Chain { closed: false, .. });
    if is_endless
        || model.form != Form::ActiveFacet
        || model.shared_poses
        || !options.correct_bias
        || readings.len() < READINGS_PER_UNKNOWN * model.unknowns()
    {
        return Ok(found);
    }
    let Some(better) = most_likely(model, readings, &found.state, &found.covariance, outlier_gate(options))
    else {
        return Ok(found);
    };
    // Mahalanobis distance of both states in the covariance of the batch.
    let off = &better.state - &found.state;
    let Some(solved) = found.covariance.clone().cholesky().map(|c| c.solve(&off)) else {
        return Ok(found);
    };
    let is_near = off.dot(&solved) < MAX_SIGMAS * MAX_SIGMAS * off.len() as f64;
    // The marginal likelihood has no distances; everything else comes from the batch.
    let candidate = ContourFit { state: better.state, covariance: better.covariance, ..found.clone() };
    if !is_near
        || !model.kind.is_valid(&candidate.state.as_slice()[..model.kind.parameters()])
        || !corners_are_real(&candidate)
    {
        return Ok(found);
    }
    // Distances, gate and χ² at the refined state; a reading may have crossed the gate.
    let (all, _) = equations(model, readings);
    let evaluate_only =
        ImplicitOptions { max_iterations: 0, correct_bias: false, ..ImplicitOptions::default() };
    let mut distances = fit_implicit(&all, None, &candidate.state, &evaluate_only)?.distances;
    // The equations of soft constraints follow those of the readings.
    distances.truncate(readings.len());
    let judged = GatedResiduals::from_distances(&distances, options.gate);
    Ok(ContourFit { used: judged.used, squares: judged.squares, distances, ..candidate })
}
