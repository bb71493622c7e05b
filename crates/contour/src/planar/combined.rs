//! The batch, and after it the most likely contour where it is not known from which place on it each reading
//! is.
//!
//! The batch looks at all readings at once: it finds back from a start that is rough, and tells which
//! readings are wild. It takes every reading for the place that suits it best, which is biased and too sure
//! of itself where the noise is a good part of a side or a radius; the likelihood with the places integrated
//! out is neither (see [`most_likely`]), but has to begin near its maximum.

use super::fit::{ContourFit, ContourFitOptions, GatedResiduals, equations, outlier_gate};
use super::kind::ContourKind;
use super::marginal::most_likely;
use super::plausible::corners_are_real;
use super::reading::{ContourModel, ContourReading, Form};
use planish_estimate::Result;
use planish_estimate::implicit::{ImplicitOptions, fit_implicit};

/// With fewer readings for each unknown the batch is the last word.
const READINGS_PER_UNKNOWN: usize = 4;
/// Bias moves an estimate by a few standard deviations; where the maximum is farther from the batch than
/// this, it is of something else.
const FARTHEST: f64 = 5.0;

/// What the batch found, or the most likely contour beside it. Straight lines, of which the batch is the
/// maximum, open chains, whose ends are equations of their own, readings that share the error of their pose,
/// and the product form stay as they are.
///
/// # Errors
/// As [`fit_implicit`].
pub(super) fn combined(
    model: &ContourModel,
    sightings: &[ContourReading],
    found: ContourFit,
    options: &ContourFitOptions,
) -> Result<ContourFit> {
    let is_endless = matches!(model.kind, ContourKind::Line | ContourKind::Chain { closed: false, .. });
    if is_endless
        || model.form != Form::ActiveFacet
        || model.shared_poses
        || !options.correct_bias
        || sightings.len() < READINGS_PER_UNKNOWN * model.unknowns()
    {
        return Ok(found);
    }
    let Some(better) = most_likely(model, sightings, &found.state, &found.covariance, outlier_gate(options))
    else {
        return Ok(found);
    };
    let off = &better.state - &found.state;
    let Some(solved) = found.covariance.clone().cholesky().map(|c| c.solve(&off)) else {
        return Ok(found);
    };
    let is_near = off.dot(&solved) < FARTHEST * FARTHEST * off.len() as f64;
    let candidate = ContourFit { state: better.state, covariance: better.covariance, ..found.clone() };
    if !is_near
        || !model.kind.is_valid(&candidate.state.as_slice()[..model.kind.parameters()])
        || !corners_are_real(&candidate)
    {
        return Ok(found);
    }
    let (all, _) = equations(model, sightings);
    let look = ImplicitOptions { max_iterations: 0, correct_bias: false, ..ImplicitOptions::default() };
    let mut distances = fit_implicit(&all, None, &candidate.state, &look)?.distances;
    // Behind them are those of what is held.
    distances.truncate(sightings.len());
    let judged = GatedResiduals::from_distances(&distances, options.gate);
    Ok(ContourFit { used: judged.used, squares: judged.squares, distances, ..candidate })
}
