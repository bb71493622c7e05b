//! Fit of one kind of contour to readings.
//!
//! In: a [`ContourKind`], readings, [`ContourFitOptions`]. Out: a [`ContourFit`] with parameters, covariance,
//! and the distance of each reading. Stages: starts, robust batch, gate, batch (or a filter), marginal
//! likelihood. Not guaranteed: the global optimum; the search climbs from a few starts.

use super::combined::combined;
use super::ends::ends;
use super::joints::joints;
use super::kind::ContourKind;
use super::likelihood::marginal_likelihood;
use super::options::{ContourFitOptions, Method, corner_margin, gate_cost, outlier_gate};
use super::plausible::{corners_are_real, stays_near};
use super::reading::{ContourEquation, ContourModel, ContourReading, ContourTarget, Form, PlanarMotion};
use super::recursive::{recursive, split_seed};
use super::soft_constraint::SoftConstraint;
use super::start::{MAX_PIECES, mean, starts};
use nalgebra::{DMatrix, DVector};
use planish_estimate::implicit::{ImplicitOptions, SharedNoise, fit_implicit, kanatani_cramer_rao};
use planish_estimate::{Error, Loss, Result, Termination};

/// Largest loss of log-likelihood, over all readings, by leaving out those near corners.
///
/// A fit that loses more has converged to another phase or size, and the fit with all readings is used
/// instead. Small losses are normal, because the two fits maximise different functions.
const MAX_MARGIN_LOSS: f64 = 20.0;

/// Thresholds of Tukey's loss in σ for two successive robust batches.
///
/// The first is wide, because a rough start may be many σ from half of its readings. The second rejects
/// outliers before the gate is applied.
pub(super) const ROBUST_THRESHOLDS: [f64; 2] = [20.0, 6.0];

/// A fitted contour with its covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct ContourFit {
    /// Kind of the contour.
    pub kind: ContourKind,
    /// Parameters of the contour, then of the motion; angles in radians, not normalised (see
    /// [`ContourKind::canonical`]).
    pub state: DVector<f64>,
    /// Covariance of `state`.
    pub covariance: DMatrix<f64>,
    /// Distance of each reading from the contour in σ; NaN for a reading without a value.
    pub distances: Vec<f64>,
    /// For each reading, true if it was used and false if it was rejected.
    pub used: Vec<bool>,
    /// Log-likelihood of all readings, with their places on the outline integrated out, up to a constant
    /// common to all kinds.
    ///
    /// If readings share poses, it is `−½ Σ s²` over the used readings, minus half the squared gate for each
    /// rejected one.
    pub log_likelihood: f64,
    /// Smallest fraction of a straight side that has readings nearby; 1 for kinds without independent sides,
    /// such as regular polygons.
    pub min_side_coverage: f64,
    /// `Σ s²` over the used readings and over the errors of shared poses.
    pub squares: f64,
    /// How the iteration ended.
    pub termination: Termination,
    /// Fixed centre of rotation of the motion.
    pub pivot: [f64; 2],
    /// Time in seconds to which the parameters refer, if the object moves.
    pub time_s: f64,
}

impl ContourFit {
    /// Bayesian information criterion `−2 ln L + k ln n`.
    ///
    /// A chain also pays twice the logarithm of the number of possible patterns of lines and arcs, since its
    /// pattern was searched for.
    #[must_use]
    pub fn bic(&self) -> f64 {
        criterion(&self.kind, self.state.len(), self.distances.len(), self.log_likelihood)
    }

    /// χ² of the used readings per degree of freedom; 1 is expected.
    #[must_use]
    pub fn reduced_chi_square(&self) -> f64 {
        let count = self.used.iter().filter(|used| **used).count() as f64;
        self.squares / (count - self.state.len() as f64).max(1.0)
    }
}

/// Bayesian information criterion of a kind with this log-likelihood.
fn criterion(kind: &ContourKind, unknowns: usize, readings: usize, log_likelihood: f64) -> f64 {
    let patterns = match kind {
        ContourKind::Chain { arcs, .. } => arcs.len() as f64 * 2f64.ln() + (MAX_PIECES as f64).ln(),
        _ => 0.0,
    };
    unknowns as f64 * (readings.max(2) as f64).ln() + 2.0 * (patterns - log_likelihood)
}

/// Fits one kind of contour to readings.
///
/// Errors of poses are part of the noise of each reading, or unknowns if several readings share a pose.
/// Starts come from [`starts`]. A robust batch (Tukey's loss) precedes the gate; a batch of the accepted
/// readings follows. A recursive method replaces that last batch: it is initialised by a batch of a few
/// readings spread over the contour, and filters only the others.
///
/// # Errors
/// `Undetermined` if the readings do not determine the parameters, or if the fit fails from every start.
///
/// # Examples
/// ```
/// use planish_contour::planar::{ContourFitOptions, ContourKind, ContourReading, ContourTarget, fit};
///
/// let readings: Vec<ContourReading> = (0..60)
///     .map(|k| {
///         let angle = std::f64::consts::TAU * f64::from(k) / 60.0;
///         let target = ContourTarget::Point {
///             position: [3.0 + 5.0 * angle.cos(), 1.0 + 5.0 * angle.sin()],
///             sigma: 0.01,
///         };
///         ContourReading { target, pose: None, time_s: 0.0, line: k as usize }
///     })
///     .collect();
/// let circle = fit(&ContourKind::Circle, &readings, &ContourFitOptions::default())?;
/// assert!((circle.state[2] - 5.0).abs() < 0.001);
/// let sigma = circle.covariance[(2, 2)].sqrt();
/// assert!((sigma - 0.01 / 60f64.sqrt()).abs() < 1e-4); // σ own the radius
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn fit(
    kind: &ContourKind,
    readings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<ContourFit> {
    let found = fit_within(kind, readings, options, &ROBUST_THRESHOLDS)?;
    polish(found, readings, options)
}

/// Final refinement of the chosen kind by the marginal likelihood (only [`Method::Combined`]).
///
/// It is separate from [`fit_within`] because [`super::choose()`] needs it for one kind only, and it is the
/// most expensive stage.
///
/// # Errors
/// As [`fit`].
pub(crate) fn polish(
    found: ContourFit,
    readings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<ContourFit> {
    if options.method != Method::Combined {
        return Ok(found);
    }
    let readings = &own_poses(readings)[..];
    let model = with_soft_constraints(
        &contour_model(&found.kind, readings, options)?,
        readings,
        found.state.as_slice(),
    );
    combined(&model, readings, found, options)
}

/// As [`fit`], but from a start close to the optimum and without the final refinement.
///
/// After [`rough`], the wide threshold of the robust loss is not needed again.
///
/// # Errors
/// As [`fit`].
pub(crate) fn finish(
    kind: &ContourKind,
    readings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<ContourFit> {
    fit_within(kind, readings, options, &ROBUST_THRESHOLDS[1..])
}

/// Fits from every start and returns the most likely plausible result.
fn fit_within(
    kind: &ContourKind,
    readings: &[ContourReading],
    options: &ContourFitOptions,
    thresholds: &[f64],
) -> Result<ContourFit> {
    let readings = &own_poses(readings)[..];
    let points: Vec<[f64; 2]> = readings.iter().map(ContourReading::point).collect();
    let model = contour_model(kind, readings, options)?;
    let mut best: Option<ContourFit> = None;
    for start in candidates(&model, readings, options)? {
        let model = with_soft_constraints(&model, readings, &start);
        // A start may diverge or lose its readings; the others can still succeed.
        let Ok(found) = fit_from(&model, readings, &start, options, thresholds) else {
            continue;
        };
        if kind.is_valid(&found.state.as_slice()[..kind.parameters()])
            && corners_are_real(&found)
            && stays_near(kind, found.state.as_slice(), found.pivot, &points)
            && best.as_ref().is_none_or(|b| found.log_likelihood > b.log_likelihood)
        {
            best = Some(found);
        }
    }
    best.ok_or_else(|| {
        Error::undetermined(format!(
            "the readings do not determine a {kind}: they may cover too little of it, or show another shape"
        ))
    })
}

/// Result of a few robust steps: predicts the BIC of a kind at a small part of the cost of a fit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RoughFit {
    /// Parameters of the contour, then of the motion.
    pub(crate) state: Vec<f64>,
    /// BIC at `state`; each reading costs at most as much as one at the gate.
    pub(crate) bic: f64,
}

/// Takes a few robust steps from each start and returns the best result.
///
/// # Errors
/// As [`fit`].
pub(crate) fn rough(
    kind: &ContourKind,
    readings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<RoughFit> {
    let readings = &own_poses(readings)[..];
    let model = contour_model(kind, readings, options)?;
    let points: Vec<[f64; 2]> = readings.iter().map(ContourReading::point).collect();
    let charge = gate_cost(Some(outlier_gate(options)));
    let mut best: Option<RoughFit> = None;
    for start in candidates(&model, readings, options)? {
        let model = with_soft_constraints(&model, readings, &start);
        let (equations, groups) = equations(&model, readings);
        // The bias by curvature and the margin at corners change a BIC by little and cost time.
        let settings = |threshold: f64| ImplicitOptions {
            loss: Loss::Tukey { threshold },
            correct_bias: false,
            margin: None,
            max_iterations: 6,
            step_tolerance: 0.1,
        };
        let mut state = DVector::from_vec(start);
        // The cost serves as log-likelihood for shared poses, where there is no other.
        let mut cost = f64::INFINITY;
        for threshold in ROBUST_THRESHOLDS {
            let Ok(found) = fit_implicit(&equations, shared(&model, &groups), &state, &settings(threshold))
            else {
                break;
            };
            state = found.state;
            let each = |d: &f64| {
                if d.is_finite() { charge.min(0.5 * d * d) } else { charge }
            };
            // Errors of shared poses have a prior of unit variance, which counts like their readings.
            let poses: f64 = found.shared.iter().map(|s| 0.5 * s.norm_squared()).sum();
            cost = poses + found.distances.iter().map(each).sum::<f64>();
        }
        let marginal_likelihood =
            marginal_likelihood(&model, state.as_slice(), readings, outlier_gate(options));
        let bic =
            criterion(kind, state.len(), readings.len(), marginal_likelihood.log_likelihood.unwrap_or(-cost));
        if bic.is_finite()
            && stays_near(kind, state.as_slice(), model.pivot, &points)
            && best.as_ref().is_none_or(|b| bic < b.bic)
        {
            let state = state.as_slice().to_vec();
            best = Some(RoughFit { state, bic });
        }
    }
    best.ok_or_else(|| Error::undetermined(format!("the readings do not determine a {kind}")))
}

/// Model of the fit without soft constraints; checks that the readings are as many as the unknowns.
fn contour_model(
    kind: &ContourKind,
    readings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<ContourModel> {
    let points: Vec<[f64; 2]> = readings.iter().map(ContourReading::point).collect();
    let times = readings.iter().map(|s| s.time_s);
    let model = ContourModel {
        kind: kind.clone(),
        form: options.form,
        motion: options.motion,
        pivot: mean(&points),
        // The earliest reading, so that the parameters describe the start of the measurement.
        time_s: if options.motion == PlanarMotion::Still { 0.0 } else { times.fold(f64::INFINITY, f64::min) },
        shared_poses: readings.iter().any(|s| s.pose.is_some()),
        constraints: Vec::new(),
    };
    if readings.len() < model.unknowns() {
        return Err(Error::undetermined(format!(
            "{} cannot determine the {} unknowns of a {kind}: provide at least as many",
            reading_count(readings.len()),
            model.unknowns()
        )));
    }
    Ok(model)
}

/// `1 reading`, `7 readings`.
pub(super) fn reading_count(readings: usize) -> String {
    match readings {
        1 => "1 reading".to_owned(),
        n => format!("{n} readings"),
    }
}

/// Adds the smooth joints of a chain and the ends of an open one, both judged at `start`.
fn with_soft_constraints(model: &ContourModel, readings: &[ContourReading], start: &[f64]) -> ContourModel {
    let mut model = model.clone();
    let theta = &start[..model.kind.parameters()];
    model.constraints = joints(&model.kind, theta).into_iter().map(SoftConstraint::Joint).collect();
    if let ContourKind::Chain { closed: false, .. } = model.kind {
        // Ends are judged in the frame of the contour: motion would blur the extent of the readings.
        let at_reference_time =
            |reading: &ContourReading| ContourEquation::new(&model, reading).point_at_reference_time(start);
        let points: Vec<_> = readings.iter().map(at_reference_time).collect();
        let ends = ends(&model.kind, theta, &points);
        model.constraints.extend(ends.into_iter().map(SoftConstraint::End));
    }
    model
}

/// Starting states: the one in the options, or those that the readings suggest.
fn candidates(
    model: &ContourModel,
    readings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<Vec<Vec<f64>>> {
    if let Some(start) = &options.start {
        return Ok(vec![start.clone()]);
    }
    // A filter may use its seed only: readings used to initialise are not filtered again.
    let first = match options.method {
        Method::Batch | Method::Combined => readings.to_vec(),
        _ => split_seed(readings, model).0,
    };
    Ok(with_motion(starts(&model.kind, &first)?, model, &first))
}

/// Kanatani–Cramér–Rao bound on the covariance of the parameters of a kind at `truth`.
///
/// `exact` holds readings without errors; their σ are those of the measurement. No unbiased method can have a
/// smaller covariance.
///
/// # Errors
/// `Undetermined` if the readings do not determine the parameters.
///
/// # Examples
/// ```
/// use planish_contour::planar::{ContourKind, bound, points};
///
/// let truth = [0.0, 0.0, 10.0];
/// let simulated = points(&ContourKind::Circle, &truth, 400, 0.1, 1);
/// let covariance = bound(&ContourKind::Circle, &truth, &simulated.exact)?;
/// assert!((covariance[(2, 2)].sqrt() - 0.1 / 20.0).abs() < 2e-4); // σ / √n for the radius
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn bound(kind: &ContourKind, truth: &[f64], exact: &[ContourReading]) -> Result<DMatrix<f64>> {
    let model = ContourModel {
        kind: kind.clone(),
        form: Form::ActiveFacet,
        motion: PlanarMotion::Still,
        pivot: [0.0; 2],
        time_s: 0.0,
        shared_poses: exact.iter().any(|s| s.pose.is_some()),
        constraints: Vec::new(),
    };
    let (equations, groups) = equations(&model, exact);
    kanatani_cramer_rao(&equations, shared(&model, &groups), &DVector::from_column_slice(truth))
}

/// Removes the pose numbers if no two readings share one.
///
/// The error of a pose with a single reading is ordinary noise of that reading. It then needs no unknown, and
/// the correction for curvature covers it.
fn own_poses(readings: &[ContourReading]) -> Vec<ContourReading> {
    let mut poses: Vec<usize> = readings.iter().filter_map(|s| s.pose).collect();
    let all = poses.len();
    poses.sort_unstable();
    poses.dedup();
    let shared = poses.len() < all;
    let pose = |s: &ContourReading| s.pose.filter(|_| shared);
    readings.iter().map(|s| ContourReading { pose: pose(s), ..*s }).collect()
}

/// Appends starting velocities: zero, and the mean drift of the points.
fn with_motion(thetas: Vec<Vec<f64>>, model: &ContourModel, readings: &[ContourReading]) -> Vec<Vec<f64>> {
    let extra = model.motion.unknowns();
    if extra == 0 {
        return thetas;
    }
    // The regression of the points on time is the velocity only if all sides are seen at all times. If the
    // sensor goes around the object, it is wrong, and the start without motion is the better one.
    let mean_time = readings.iter().map(|s| s.time_s).sum::<f64>() / readings.len() as f64;
    let square: f64 = readings.iter().map(|s| (s.time_s - mean_time).powi(2)).sum();
    let drift = [0, 1].map(|k| {
        let product: f64 = readings.iter().map(|s| (s.time_s - mean_time) * s.point()[k]).sum();
        if square > 0.0 { product / square } else { 0.0 }
    });
    let still = thetas.iter().map(|t| [&t[..], &vec![0.0; extra]].concat());
    // Undo the drift before searching for the shape, as the moving points may show no outline at all.
    let back: Vec<ContourReading> = readings
        .iter()
        .map(|s| {
            let p = s.point();
            let time = s.time_s - model.time_s;
            ContourReading {
                target: ContourTarget::Point {
                    position: [p[0] - drift[0] * time, p[1] - drift[1] * time],
                    sigma: s.covariance()[0].sqrt(),
                },
                ..*s
            }
        })
        .collect();
    let drifting = starts(&model.kind, &back).unwrap_or_default();
    let moved = drifting.into_iter().map(|t| {
        let mut start = [&t[..], &drift[..]].concat();
        // No rotation rate: the centroid carries no information about it.
        start.resize(t.len() + extra, 0.0);
        start
    });
    still.chain(moved).collect()
}

/// One equation per reading, then one per soft constraint, with the number of the pose group of each.
///
/// Readings without a pose, and soft constraints, form groups of their own.
pub(super) fn equations<'a>(
    model: &'a ContourModel,
    readings: &'a [ContourReading],
) -> (Vec<ContourEquation<'a>>, Vec<usize>) {
    // Poses get consecutive numbers in their order of appearance. The estimator eliminates them group by
    // group.
    let mut numbers = std::collections::BTreeMap::new();
    let mut groups = Vec::with_capacity(readings.len());
    let mut alone = 0;
    for reading in readings {
        let key = match reading.pose {
            Some(pose) => (false, pose),
            None => {
                alone += 1;
                (true, alone)
            }
        };
        let next = numbers.len();
        groups.push(*numbers.entry(key).or_insert(next));
    }
    // Soft constraints come last, so that the first distances of a fit are those of the readings.
    let mut equations: Vec<ContourEquation<'_>> =
        (readings.iter()).map(|reading| ContourEquation::new(model, reading)).collect();
    if let Some(reading) = readings.first() {
        for &constraint in &model.constraints {
            groups.push(numbers.len() + equations.len() - readings.len());
            equations.push(ContourEquation {
                constraint: Some(constraint),
                ..ContourEquation::new(model, reading)
            });
        }
    }
    (equations, groups)
}

/// Groups of equations that share the three errors of a pose, if any do.
pub(super) fn shared<'a>(model: &ContourModel, groups: &'a [usize]) -> Option<SharedNoise<'a>> {
    model.shared_poses.then_some(SharedNoise { size: 3, groups })
}

/// Statistics of the distances of all readings after the gate.
pub(crate) struct GatedResiduals {
    pub(crate) used: Vec<bool>,
    /// `Σ s²` over the used readings.
    pub(crate) squares: f64,
    /// `−½ Σ s²`, minus the cost of the rejected readings.
    pub(crate) log_likelihood: f64,
}

impl GatedResiduals {
    pub(crate) fn from_distances(distances: &[f64], gate: Option<f64>) -> Self {
        let near = |d: &f64| d.is_finite() && gate.is_none_or(|g| d.abs() <= g);
        let used: Vec<bool> = distances.iter().map(near).collect();
        let squares: f64 = (distances.iter().zip(&used)).filter(|(_, u)| **u).map(|(d, _)| d * d).sum();
        let rejected = used.iter().filter(|u| !**u).count() as f64;
        Self { used, squares, log_likelihood: -0.5 * squares - rejected * gate_cost(gate) }
    }
}

/// Fits from one start by the method of the options, except for the final refinement.
fn fit_from(
    model: &ContourModel,
    readings: &[ContourReading],
    start: &[f64],
    options: &ContourFitOptions,
    thresholds: &[f64],
) -> Result<ContourFit> {
    match options.method {
        Method::Batch | Method::Combined => batch(model, readings, start, options, thresholds),
        _ => recursive(model, readings, start, options),
    }
}

/// Robust batches with decreasing thresholds, the gate, then a batch of the accepted readings.
///
/// # Errors
/// `Undetermined` if too few readings pass the gate, or if they leave a parameter free.
pub(super) fn batch(
    model: &ContourModel,
    readings: &[ContourReading],
    start: &[f64],
    options: &ContourFitOptions,
    thresholds: &[f64],
) -> Result<ContourFit> {
    let (all, groups) = equations(model, readings);
    let plain = ImplicitOptions {
        correct_bias: options.correct_bias && options.gate.is_none(),
        ..ImplicitOptions::default()
    };
    let mut at = DVector::from_column_slice(start);
    let mut used = vec![true; readings.len()];
    if let Some(gate) = options.gate {
        // The robust loss only brings the contour into place; its covariance is not used. Hence the loose
        // tolerance and the hard gate below, whose effect on the covariance is small and known.
        for &threshold in thresholds {
            let robust = ImplicitOptions {
                loss: Loss::Tukey { threshold },
                correct_bias: false,
                margin: None,
                max_iterations: 30,
                step_tolerance: 1e-2,
            };
            at = fit_implicit(&all, shared(model, &groups), &at, &robust)?.state;
        }
        // Zero iterations evaluate the distances without moving the contour.
        let evaluate_only = ImplicitOptions { max_iterations: 0, correct_bias: false, ..plain };
        let evaluated = fit_implicit(&all, shared(model, &groups), &at, &evaluate_only)?;
        for (used, distance) in used.iter_mut().zip(&evaluated.distances) {
            *used = distance.abs() <= gate;
        }
    }
    // A hard gate instead of weights: the covariance of the last batch is then that of the accepted readings.
    let kept: Vec<ContourReading> =
        readings.iter().zip(&used).filter(|(_, u)| **u).map(|(s, _)| *s).collect();
    if kept.len() < model.unknowns() {
        return Err(Error::undetermined("too few readings lie near the contour"));
    }
    let (equations, kept_groups) = equations(model, &kept);
    let final_options = ImplicitOptions {
        correct_bias: options.correct_bias,
        margin: corner_margin(model, readings.len(), options),
        ..plain
    };
    let mut found = fit_implicit(&equations, shared(model, &kept_groups), &at, &final_options)?;
    let mut likelihood_found =
        marginal_likelihood(model, found.state.as_slice(), readings, outlier_gate(options));
    if final_options.margin.is_some() && model.kind.pieces() > 2 {
        // If the margin removes many readings, the remaining ones may agree with another phase or size. Fit
        // all readings as well, and compare both results by the likelihood of all.
        let all_readings_options = ImplicitOptions { margin: None, ..final_options };
        let other = fit_implicit(&equations, shared(model, &kept_groups), &at, &all_readings_options)?;
        let likelihood_other =
            marginal_likelihood(model, other.state.as_slice(), readings, outlier_gate(options));
        let is_lost = |own: f64, all: f64| own < all - MAX_MARGIN_LOSS;
        if other.covariance.is_some()
            && (likelihood_found.log_likelihood.zip(likelihood_other.log_likelihood))
                .is_some_and(|(own, all)| is_lost(own, all))
        {
            (found, likelihood_found) = (other, likelihood_other);
        }
    }
    // A singular information matrix: a parameter can change without a change of any distance.
    let Some(covariance) = found.covariance else {
        return Err(Error::undetermined("the readings leave a parameter of the contour undetermined"));
    };
    // Distances are per accepted reading; map them back to all readings.
    let mut distances = vec![f64::NAN; readings.len()];
    let mut next = found.distances.iter();
    for (distance, used) in distances.iter_mut().zip(&mut used) {
        if *used {
            *distance = next.next().copied().unwrap_or(f64::NAN);
            *used = distance.is_finite();
        }
    }
    let rejected = used.iter().filter(|u| !**u).count() as f64;
    Ok(ContourFit {
        kind: model.kind.clone(),
        state: found.state,
        covariance,
        distances,
        used,
        squares: 2.0 * found.loss,
        min_side_coverage: likelihood_found.min_side_coverage,
        log_likelihood: (likelihood_found.log_likelihood)
            .unwrap_or(-found.loss - rejected * gate_cost(options.gate)),
        termination: found.termination,
        pivot: model.pivot,
        time_s: model.time_s,
    })
}
