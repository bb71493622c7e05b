//! One kind of contour fitted to readings.

use super::combined::combined;
use super::ends::ends;
use super::joints::joints;
use super::kind::ContourKind;
use super::likelihood::placed;
use super::plausible::{corners_are_real, stays_near};
use super::reading::{ContourEquation, ContourModel, ContourReading, ContourTarget, Form, PlanarMotion};
use super::recursive::{recursive, split_seed};
use super::soft_constraint::SoftConstraint;
use super::start::{MAX_PIECES, mean, starts};
use nalgebra::{DMatrix, DVector};
use planish_estimate::implicit::{ImplicitOptions, SharedNoise, fit_implicit, kanatani_cramer_rao};
use planish_estimate::{Error, Loss, Result, Termination};

/// With fewer readings a side than this, those near corners count: the bias is small beside what they tell.
const READINGS_PER_SIDE: usize = 25;

/// A fit without the readings near corners whose logarithm of the likelihood of all readings is less by more
/// than this has lost its way.
const MAX_MARGIN_LOSS: f64 = 20.0;

/// What a reading may cost a likelihood where there is no gate, in standard deviations.
const DEFAULT_OUTLIER_GATE: f64 = 10.0;

/// Where readings begin to lose their weight (Tukey), one batch after the other: wide at first, since an
/// outline that is not yet in place must not lose half of its readings.
pub(super) const ROBUST_THRESHOLDS: [f64; 2] = [20.0, 6.0];

/// How parameters are estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// All readings at once, then the most likely contour where it is not known from which place on it each
    /// of them is.
    Combined,
    /// All readings at once.
    Batch,
    /// One after the other, linearised at the prediction.
    Extended,
    /// One after the other, linearised anew in the state.
    Iterated,
    /// One after the other, linearised anew in state and noise.
    NoiseUpdated,
}

/// Settings of a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct ContourFitOptions {
    /// How parameters are estimated.
    pub method: Method,
    /// How pieces become an equation.
    pub form: Form,
    /// How the thing moves.
    pub motion: PlanarMotion,
    /// Readings farther than this many standard deviations are left out; `None` keeps all.
    pub gate: Option<f64>,
    /// Readings that lie nearer than so many σ to a corner of a rectangle or polygon do not count for its
    /// parameters: which side they are of is not certain, and taking the nearer one is a bias. With less than
    /// 25 readings a side all count.
    pub corner_margin: Option<f64>,
    /// Whether what curvature adds to distances is taken off (batch and NUIEKF).
    pub correct_bias: bool,
    /// Parameters, motion included, to start from, in place of what the readings suggest.
    pub start: Option<Vec<f64>>,
}

impl Default for ContourFitOptions {
    fn default() -> Self {
        Self {
            method: Method::Combined,
            form: Form::ActiveFacet,
            motion: PlanarMotion::Still,
            gate: Some(4.0),
            corner_margin: Some(2.0),
            correct_bias: true,
            start: None,
        }
    }
}

/// A contour with its covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct ContourFit {
    /// Its kind.
    pub kind: ContourKind,
    /// Its parameters, then the motion's; angles in radians, not brought to their canonical range.
    pub state: DVector<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// Distance of each reading in standard deviations; NaN where it has none.
    pub distances: Vec<f64>,
    /// Whether each reading counted.
    pub used: Vec<bool>,
    /// Logarithm of the likelihood of all readings, each anywhere on the outline, up to a constant that all
    /// kinds share; where readings share poses `−½ Σ s²` over those that counted, less what a gate costs for
    /// each that did not.
    pub log_likelihood: f64,
    /// The least share of a straight side that a reading came near; 1 where there is none, or where sides
    /// follow from one another as those of a regular polygon do.
    pub min_side_coverage: f64,
    /// `Σ s²` over the readings that counted, and of the shared errors of their poses.
    pub squares: f64,
    /// How it ended.
    pub termination: Termination,
    /// The pivot of the motion.
    pub pivot: [f64; 2],
    /// The time at which the contour is where the parameters say.
    pub time_s: f64,
}

impl ContourFit {
    /// `−2 ln L + k ln n`; of a chain, whose pattern of lines and arcs was looked for, also twice the
    /// logarithm of the number of patterns.
    #[must_use]
    pub fn bic(&self) -> f64 {
        criterion(&self.kind, self.state.len(), self.distances.len(), self.log_likelihood)
    }

    /// Mean squared distance over its degrees of freedom; one is expected.
    #[must_use]
    pub fn reduced_chi_square(&self) -> f64 {
        let count = self.used.iter().filter(|used| **used).count() as f64;
        self.squares / (count - self.state.len() as f64).max(1.0)
    }
}

fn criterion(kind: &ContourKind, unknowns: usize, readings: usize, log_likelihood: f64) -> f64 {
    let patterns = match kind {
        ContourKind::Chain { arcs, .. } => arcs.len() as f64 * 2f64.ln() + (MAX_PIECES as f64).ln(),
        _ => 0.0,
    };
    unknowns as f64 * (readings.max(2) as f64).ln() + 2.0 * (patterns - log_likelihood)
}

/// Fits a kind of contour to readings, with their poses in their noise, or as unknowns where readings share
/// them.
///
/// Starts as [`starts`]; a robust batch (Tukey), then the batch proper on what passes the gate. A recursive
/// method takes the batch's place after readings enough to know all parameters, spread over the whole, which
/// it does not take again.
///
/// # Errors
/// `Undetermined` when the readings do not determine the parameters, or when no start leads anywhere.
pub fn fit(
    kind: &ContourKind,
    sightings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<ContourFit> {
    let found = fit_within(kind, sightings, options, &ROBUST_THRESHOLDS)?;
    polish(found, sightings, options)
}

/// The last of the estimate, once the kind is known.
///
/// # Errors
/// As [`fit`].
pub(crate) fn polish(
    found: ContourFit,
    sightings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<ContourFit> {
    if options.method != Method::Combined {
        return Ok(found);
    }
    let sightings = &own_poses(sightings)[..];
    let model = with_soft_constraints(
        &contour_model(&found.kind, sightings, options)?,
        sightings,
        found.state.as_slice(),
    );
    combined(&model, sightings, found, options)
}

/// As [`fit`], from a start that a rough fit has brought near, and without the last of it.
///
/// # Errors
/// As [`fit`].
pub(crate) fn finish(
    kind: &ContourKind,
    sightings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<ContourFit> {
    fit_within(kind, sightings, options, &ROBUST_THRESHOLDS[1..])
}

fn fit_within(
    kind: &ContourKind,
    sightings: &[ContourReading],
    options: &ContourFitOptions,
    thresholds: &[f64],
) -> Result<ContourFit> {
    let sightings = &own_poses(sightings)[..];
    let points: Vec<[f64; 2]> = sightings.iter().map(ContourReading::point).collect();
    let model = contour_model(kind, sightings, options)?;
    let mut best: Option<ContourFit> = None;
    for start in candidates(&model, sightings, options)? {
        let model = with_soft_constraints(&model, sightings, &start);
        let Ok(found) = fit_from(&model, sightings, &start, options, thresholds) else {
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
            "the readings do not determine a {kind}: they may see too little of it, or be of something else"
        ))
    })
}

/// A fit that has only begun: what it may come to, for a small part of the time.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RoughFit {
    /// Parameters, motion included.
    pub(crate) state: Vec<f64>,
    /// `−2 ln L + k ln n` there, at most the charge of the gate a reading.
    pub(crate) bic: f64,
}

/// A few robust steps from each start, and the best of them.
///
/// # Errors
/// As [`fit`].
pub(crate) fn rough(
    kind: &ContourKind,
    sightings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<RoughFit> {
    let sightings = &own_poses(sightings)[..];
    let model = contour_model(kind, sightings, options)?;
    let points: Vec<[f64; 2]> = sightings.iter().map(ContourReading::point).collect();
    let charge = gate_cost(Some(outlier_gate(options)));
    let mut best: Option<RoughFit> = None;
    for start in candidates(&model, sightings, options)? {
        let model = with_soft_constraints(&model, sightings, &start);
        let (readings, groups) = equations(&model, sightings);
        let settings = |threshold: f64| ImplicitOptions {
            loss: Loss::Tukey { threshold },
            correct_bias: false,
            margin: None,
            max_iterations: 6,
            step_tolerance: 0.1,
        };
        let mut state = DVector::from_vec(start);
        let mut cost = f64::INFINITY;
        for threshold in ROBUST_THRESHOLDS {
            let Ok(found) = fit_implicit(&readings, shared(&model, &groups), &state, &settings(threshold))
            else {
                break;
            };
            state = found.state;
            let each = |d: &f64| {
                if d.is_finite() { charge.min(0.5 * d * d) } else { charge }
            };
            let poses: f64 = found.shared.iter().map(|s| 0.5 * s.norm_squared()).sum();
            cost = poses + found.distances.iter().map(each).sum::<f64>();
        }
        let placed = placed(&model, state.as_slice(), sightings, outlier_gate(options));
        let bic = criterion(kind, state.len(), sightings.len(), placed.log_likelihood.unwrap_or(-cost));
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

fn contour_model(
    kind: &ContourKind,
    sightings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<ContourModel> {
    let points: Vec<[f64; 2]> = sightings.iter().map(ContourReading::point).collect();
    let times = sightings.iter().map(|s| s.time_s);
    let model = ContourModel {
        kind: kind.clone(),
        form: options.form,
        motion: options.motion,
        pivot: mean(&points),
        time_s: if options.motion == PlanarMotion::Still { 0.0 } else { times.fold(f64::INFINITY, f64::min) },
        shared_poses: sightings.iter().any(|s| s.pose.is_some()),
        constraints: Vec::new(),
    };
    if sightings.len() < model.unknowns() {
        return Err(Error::undetermined(format!(
            "{} cannot determine the {} unknowns of a {kind}: give at least as many",
            reading_count(sightings.len()),
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

/// With the smooth joints of a chain that is about where it starts, and the ends of an open one.
fn with_soft_constraints(model: &ContourModel, sightings: &[ContourReading], start: &[f64]) -> ContourModel {
    let mut model = model.clone();
    let theta = &start[..model.kind.parameters()];
    model.constraints = joints(&model.kind, theta).into_iter().map(SoftConstraint::Joint).collect();
    if let ContourKind::Chain { closed: false, .. } = model.kind {
        let at_rest = |sighting: &ContourReading| ContourEquation::new(&model, sighting).seen_at_rest(start);
        let points: Vec<_> = sightings.iter().map(at_rest).collect();
        let ends = ends(&model.kind, theta, &points);
        model.constraints.extend(ends.into_iter().map(SoftConstraint::End));
    }
    model
}

/// Where to start: where it was said, or what the readings suggest.
fn candidates(
    model: &ContourModel,
    sightings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<Vec<Vec<f64>>> {
    if let Some(start) = &options.start {
        return Ok(vec![start.clone()]);
    }
    let first = match options.method {
        Method::Batch | Method::Combined => sightings.to_vec(),
        _ => split_seed(sightings, model).0,
    };
    Ok(with_motion(starts(&model.kind, &first)?, model, &first))
}

/// The Kanatani–Cramér–Rao bound on the covariance of the parameters of a kind at `truth`, from readings
/// without errors that state the σ of those with errors.
///
/// # Errors
/// `Undetermined` when the readings do not determine the parameters.
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
    let (readings, groups) = equations(&model, exact);
    kanatani_cramer_rao(&readings, shared(&model, &groups), &DVector::from_column_slice(truth))
}

/// A pose of a single reading is noise of that reading's own, which can be corrected for curvature: no
/// unknown is needed.
fn own_poses(sightings: &[ContourReading]) -> Vec<ContourReading> {
    let mut poses: Vec<usize> = sightings.iter().filter_map(|s| s.pose).collect();
    let all = poses.len();
    poses.sort_unstable();
    poses.dedup();
    let shared = poses.len() < all;
    let pose = |s: &ContourReading| s.pose.filter(|_| shared);
    sightings.iter().map(|s| ContourReading { pose: pose(s), ..*s }).collect()
}

fn with_motion(thetas: Vec<Vec<f64>>, model: &ContourModel, sightings: &[ContourReading]) -> Vec<Vec<f64>> {
    let extra = model.motion.unknowns();
    if extra == 0 {
        return thetas;
    }
    // The drift of the points, which holds where all sides are seen at all times; and none.
    let mean_time = sightings.iter().map(|s| s.time_s).sum::<f64>() / sightings.len() as f64;
    let square: f64 = sightings.iter().map(|s| (s.time_s - mean_time).powi(2)).sum();
    let drift = [0, 1].map(|k| {
        let product: f64 = sightings.iter().map(|s| (s.time_s - mean_time) * s.point()[k]).sum();
        if square > 0.0 { product / square } else { 0.0 }
    });
    let still = thetas.iter().map(|t| [&t[..], &vec![0.0; extra]].concat());
    // Starts of what the points would be without the drift.
    let back: Vec<ContourReading> = sightings
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
        start.resize(t.len() + extra, 0.0);
        start
    });
    still.chain(moved).collect()
}

pub(super) fn equations<'a>(
    model: &'a ContourModel,
    sightings: &'a [ContourReading],
) -> (Vec<ContourEquation<'a>>, Vec<usize>) {
    let mut numbers = std::collections::BTreeMap::new();
    let mut groups = Vec::with_capacity(sightings.len());
    let mut alone = 0;
    for sighting in sightings {
        let key = match sighting.pose {
            Some(pose) => (false, pose),
            None => {
                alone += 1;
                (true, alone)
            }
        };
        let next = numbers.len();
        groups.push(*numbers.entry(key).or_insert(next));
    }
    let mut readings: Vec<ContourEquation<'_>> =
        (sightings.iter()).map(|sighting| ContourEquation::new(model, sighting)).collect();
    if let Some(sighting) = sightings.first() {
        for &constraint in &model.constraints {
            groups.push(numbers.len() + readings.len() - sightings.len());
            readings.push(ContourEquation {
                constraint: Some(constraint),
                ..ContourEquation::new(model, sighting)
            });
        }
    }
    (readings, groups)
}

pub(super) fn shared<'a>(model: &ContourModel, groups: &'a [usize]) -> Option<SharedNoise<'a>> {
    model.shared_poses.then_some(SharedNoise { size: 3, groups })
}

/// The margin, where every side has readings enough that the bias matters more than the readings near
/// corners.
pub(super) fn corner_margin(
    model: &ContourModel,
    readings: usize,
    options: &ContourFitOptions,
) -> Option<f64> {
    let enough = readings >= READINGS_PER_SIDE * model.kind.pieces();
    options.corner_margin.filter(|_| enough)
}

/// Beyond how many standard deviations a reading is as unlikely as any.
pub(super) fn outlier_gate(options: &ContourFitOptions) -> f64 {
    options.gate.unwrap_or(DEFAULT_OUTLIER_GATE)
}

/// What a reading outside the gate costs: as much as one on it.
pub(super) fn gate_cost(gate: Option<f64>) -> f64 {
    gate.map_or(0.0, |g| 0.5 * g * g)
}

/// What the distances of all readings say once those beyond the gate are left out.
pub(crate) struct GatedResiduals {
    pub(crate) used: Vec<bool>,
    /// `Σ s²` over the readings that count.
    pub(crate) squares: f64,
    /// `−½ Σ s²`, less what the others cost.
    pub(crate) log_likelihood: f64,
}

impl GatedResiduals {
    pub(crate) fn from_distances(distances: &[f64], gate: Option<f64>) -> Self {
        let near = |d: &f64| d.is_finite() && gate.is_none_or(|g| d.abs() <= g);
        let used: Vec<bool> = distances.iter().map(near).collect();
        let squares: f64 = (distances.iter().zip(&used)).filter(|(_, u)| **u).map(|(d, _)| d * d).sum();
        let left_out = used.iter().filter(|u| !**u).count() as f64;
        Self { used, squares, log_likelihood: -0.5 * squares - left_out * gate_cost(gate) }
    }
}

fn fit_from(
    model: &ContourModel,
    sightings: &[ContourReading],
    start: &[f64],
    options: &ContourFitOptions,
    thresholds: &[f64],
) -> Result<ContourFit> {
    match options.method {
        Method::Batch | Method::Combined => batch(model, sightings, start, options, thresholds),
        _ => recursive(model, sightings, start, options),
    }
}

pub(super) fn batch(
    model: &ContourModel,
    sightings: &[ContourReading],
    start: &[f64],
    options: &ContourFitOptions,
    thresholds: &[f64],
) -> Result<ContourFit> {
    let (all, groups) = equations(model, sightings);
    let plain = ImplicitOptions {
        correct_bias: options.correct_bias && options.gate.is_none(),
        ..ImplicitOptions::default()
    };
    let mut at = DVector::from_column_slice(start);
    let mut used = vec![true; sightings.len()];
    if let Some(gate) = options.gate {
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
        let look = ImplicitOptions { max_iterations: 0, correct_bias: false, ..plain };
        let seen = fit_implicit(&all, shared(model, &groups), &at, &look)?;
        for (used, distance) in used.iter_mut().zip(&seen.distances) {
            *used = distance.abs() <= gate;
        }
    }
    let kept: Vec<ContourReading> =
        sightings.iter().zip(&used).filter(|(_, u)| **u).map(|(s, _)| *s).collect();
    if kept.len() < model.unknowns() {
        return Err(Error::undetermined("too few readings lie near the contour"));
    }
    let (readings, kept_groups) = equations(model, &kept);
    let options_here = ImplicitOptions {
        correct_bias: options.correct_bias,
        margin: corner_margin(model, sightings.len(), options),
        ..plain
    };
    let mut found = fit_implicit(&readings, shared(model, &kept_groups), &at, &options_here)?;
    let mut placed_found = placed(model, found.state.as_slice(), sightings, outlier_gate(options));
    if options_here.margin.is_some() && model.kind.pieces() > 2 {
        // Where the margin takes many readings, what is left may agree with another phase or size: all of
        // them tell.
        let all_count = ImplicitOptions { margin: None, ..options_here };
        let other = fit_implicit(&readings, shared(model, &kept_groups), &at, &all_count)?;
        let placed_other = placed(model, other.state.as_slice(), sightings, outlier_gate(options));
        let is_lost = |of: f64, all: f64| of < all - MAX_MARGIN_LOSS;
        if other.covariance.is_some()
            && (placed_found.log_likelihood.zip(placed_other.log_likelihood))
                .is_some_and(|(of, all)| is_lost(of, all))
        {
            (found, placed_found) = (other, placed_other);
        }
    }
    let Some(covariance) = found.covariance else {
        return Err(Error::undetermined("the readings leave a parameter of the contour free"));
    };
    let mut distances = vec![f64::NAN; sightings.len()];
    let mut next = found.distances.iter();
    for (distance, used) in distances.iter_mut().zip(&mut used) {
        if *used {
            *distance = next.next().copied().unwrap_or(f64::NAN);
            *used = distance.is_finite();
        }
    }
    let left_out = used.iter().filter(|u| !**u).count() as f64;
    Ok(ContourFit {
        kind: model.kind.clone(),
        state: found.state,
        covariance,
        distances,
        used,
        squares: 2.0 * found.loss,
        min_side_coverage: placed_found.min_side_coverage,
        log_likelihood: (placed_found.log_likelihood)
            .unwrap_or(-found.loss - left_out * gate_cost(options.gate)),
        termination: found.termination,
        pivot: model.pivot,
        time_s: model.time_s,
    })
}
