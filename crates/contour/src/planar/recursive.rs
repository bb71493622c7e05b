//! Fit of one kind of contour by a filter: a batch of a few readings, then one reading after the other.
//!
//! The filter needs a state close to the truth, because it linearises each reading once and never returns to
//! it. The batch provides that state.

use super::fit::{ContourFit, GatedResiduals, ROBUST_THRESHOLDS, batch, equations, shared};
use super::likelihood::marginal_likelihood;
use super::options::{ContourFitOptions, Method, corner_margin, outlier_gate};
use super::reading::{ContourEquation, ContourModel, ContourReading};
use nalgebra::DMatrix;
use planish_estimate::implicit::{ImplicitOptions, ImplicitUpdate, fit_implicit};
use planish_estimate::{KalmanFilter, Result, Termination};

/// Splits the readings into a seed, spread evenly over all of them, and the rest in their order.
///
/// All readings of a pose go to the same part: the error of a pose is dropped from the state when the next
/// pose begins, so it cannot be estimated twice.
pub(super) fn split_seed(
    readings: &[ContourReading],
    model: &ContourModel,
) -> (Vec<ContourReading>, Vec<ContourReading>) {
    // Several readings on each piece: a filter that starts with a wrong phase does not recover.
    let wanted = (4 * model.unknowns())
        .max(8 * model.kind.pieces())
        .max(12)
        .min(readings.len() / 2)
        .max(model.unknowns());
    let stride = (readings.len() / wanted.max(1)).max(1);
    let mut counted = 0;
    let mut poses = Vec::new();
    let mut is_seed = vec![false; readings.len()];
    for i in (0..readings.len()).step_by(stride) {
        if counted < wanted {
            is_seed[i] = true;
            poses.extend(readings[i].pose);
            counted += 1;
        }
    }
    let in_seed = |i: usize| is_seed[i] || readings[i].pose.is_some_and(|p| poses.contains(&p));
    let pick =
        |seed: bool| (0..readings.len()).filter(|&i| in_seed(i) == seed).map(|i| readings[i]).collect();
    (pick(true), pick(false))
}

/// Runs the filter of the options over all readings that are not in the seed.
///
/// # Errors
/// As [`batch`], for the readings of the seed.
pub(super) fn recursive(
    model: &ContourModel,
    readings: &[ContourReading],
    start: &[f64],
    options: &ContourFitOptions,
) -> Result<ContourFit> {
    let (seed, rest) = split_seed(readings, model);
    let first = batch(model, &seed, start, options, &ROBUST_THRESHOLDS)?;
    let mut filter = KalmanFilter::new(first.state, first.covariance)?;
    let mut update = match options.method {
        Method::Extended => ImplicitUpdate::extended(),
        Method::Iterated => ImplicitUpdate::iterated(),
        _ => ImplicitUpdate::noise_updated(),
    };
    update.gate = options.gate;
    update.margin = corner_margin(model, readings.len(), options);
    update.correct_bias &= options.correct_bias;
    let n = model.unknowns();
    let mut pose: Option<usize> = None;
    for reading in &rest {
        if model.shared_poses && (reading.pose.is_none() || reading.pose != pose || filter.mean().len() == n)
        {
            change_pose(&mut filter, n)?;
            pose = reading.pose;
        }
        let equation = ContourEquation::new(model, reading);
        // An error means that the equation has no value at the prediction. The reading is then skipped; it
        // shows as NaN among the distances.
        let _ = filter.update_implicit(&equation, &update);
    }
    let state = filter.mean().rows(0, n).into_owned();
    let covariance = filter.covariance().view((0, 0), (n, n)).into_owned();
    // Distances of all readings to the final contour, those of the seed included. Zero iterations evaluate
    // them without moving the contour.
    let (all, groups) = equations(model, readings);
    let evaluate_only =
        ImplicitOptions { max_iterations: 0, correct_bias: false, ..ImplicitOptions::default() };
    let mut evaluated = fit_implicit(&all, shared(model, &groups), &state, &evaluate_only)?;
    // The equations of soft constraints follow those of the readings.
    evaluated.distances.truncate(readings.len());
    let GatedResiduals { used, squares, log_likelihood: by_distance } =
        GatedResiduals::from_distances(&evaluated.distances, options.gate);
    let marginal_likelihood = marginal_likelihood(model, state.as_slice(), readings, outlier_gate(options));
    Ok(ContourFit {
        kind: model.kind.clone(),
        state,
        covariance,
        distances: evaluated.distances,
        used,
        squares,
        min_side_coverage: marginal_likelihood.min_side_coverage,
        log_likelihood: marginal_likelihood.log_likelihood.unwrap_or(by_distance),
        termination: Termination::Converged,
        pivot: model.pivot,
        time_s: model.time_s,
    })
}

/// Replaces the errors of the last pose in the state by those of the next, with unit variance.
///
/// Dropping them is marginalisation: their correlation with the parameters stays in the covariance of these.
fn change_pose(filter: &mut KalmanFilter, n: usize) -> Result<()> {
    let had = filter.mean().len();
    let mut transition = DMatrix::zeros(n + 3, had);
    let mut fresh = DMatrix::zeros(n + 3, n + 3);
    for k in 0..n {
        transition[(k, k)] = 1.0;
    }
    for k in n..n + 3 {
        fresh[(k, k)] = 1.0;
    }
    filter.predict(&transition, &fresh)
}
