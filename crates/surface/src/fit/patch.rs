//! Fits by the patch filter: a global fit of some first readings, then all others one at a time.
//!
//! Input: scans. Output: a [`Fit`] whose model holds the filter. The first readings, some thousands of all,
//! are fitted by the global filter over the base grid. That gives the shape, the noise and the smoothness
//! weight, and its posterior is the start of the patches. Every other reading is filtered once, in a seeded
//! random order, so that patches are divided early everywhere. The readings of a live sensor come in their
//! own order: see [`crate::stream`].
//!
//! Not guaranteed: full accuracy where patches were divided late. A reading filtered into a coarse patch
//! carries no information about finer detail.

use super::division::growth_log;
use super::finish::{FinishInput, finish};
use super::first::{ShownShape, first_surface};
use super::formation::{Formation, Snapshot};
use super::noise::SensorNoise;
use super::refine::{ConvergedFit, ConvergedKind, refine_to_noise};
use super::weights::{Weighting, weights};
use super::{Fit, FitOptions, PatchOptions, formation, observation_options, observe};
use crate::model::{NodeCovariance, Posterior, SurfaceModel};
use crate::observe::surface_extent;
use crate::observe::{FootState, ProjectedReadings, by_leaf, project};
use crate::observe::{Measured, Observations, Quantity, RejectionCause, hash01};
use crate::patch_stream::{IncomingReading, PatchRules, ReadingValue, StreamingFilter};
use crate::subdivision::{Cause, RefinementLog};
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_core::{Progress, ProgressPart};
use planish_estimate::{Error, Result};
use planish_exchange::ScanSet;
use planish_spline::{
    FootPointSearch, Hierarchy, PATCH_CELLS, PatchFilter, PatchFilterOptions, Shape, SmoothnessPrior,
    StateLayout, Surface, SurfaceSystem, fit_function, leaf_weights, patch_hierarchy,
};
use std::sync::Arc;

/// Readings of the first fit: one in [`FIRST_SHARE`] of all, with bounds of their number.
///
/// More of them cost memory and time. A first fit that misses shape takes it for noise, which made σ twice
/// too large on the bunny (decision 0025).
const FIRST_SHARE: usize = 4;
const MIN_FIRST: usize = 500;
const MAX_FIRST: usize = 20_000;
/// Levels by which a ball grows before its cells become those of patches. Thin parts need some; each has four
/// times as many patches from the start.
const MAX_GROWTH: u8 = 2;
/// Default depth of subdivision beyond the base grid. Every patch has a dense covariance, and each level has
/// up to four times as many patches.
const DEFAULT_DEPTH: u8 = 3;
/// Length of the weak hold that makes the prior proper, in extents of the surface.
///
/// An affine motion costs no thin-plate energy, so a prior without a hold has no covariance. Twice the size
/// of the object is too long to change its shape.
const HOLD_LENGTH: f64 = 2.0;
/// Smallest relative reduction of a variance that is passed on to neighbouring patches. Smaller gains cost
/// updates without a visible effect on σ (decision 0025).
const MIN_GAIN: f64 = 1e-2;
/// Readings between two checks for an interruption by the user.
const READINGS_PER_CHECK: usize = 4096;

/// The patch filter after all readings of a fit.
pub(super) struct PatchFilterOutcome {
    pub filter: Arc<PatchFilter>,
    /// For each reading of the subset, why it was rejected.
    refused: Vec<Option<RejectionCause>>,
    /// Patches of the deepest level that would have been divided further.
    held_back: usize,
    deepest: usize,
}

impl PatchFilterOutcome {
    /// Information of every foot; zero for rejected readings.
    pub(super) fn information(&self, readings: ProjectedReadings<'_>, noise: &SensorNoise) -> Vec<f64> {
        (self.refused.iter().enumerate())
            .map(|(k, refused)| match refused {
                None => 1.0 / noise.variance(readings, k),
                Some(_) => 0.0,
            })
            .collect()
    }

    pub(super) fn finding(&self) -> Option<Finding> {
        (self.held_back > 0).then(|| {
            let text = format!(
                "the residuals of {} of {} patches are correlated at level {}, the maximum depth: raise \
                 the maximum depth for more detail",
                self.held_back,
                self.filter.patches().len(),
                self.deepest
            );
            Finding::new(FindingCode::PatchErrorsCorrelated, text).with_setting(Setting::MaxDepth)
        })
    }
}

/// A global fit of the first readings, and a filter that starts from it.
pub(crate) struct FirstFit {
    pub(super) converged: ConvergedFit,
    pub core: StreamingFilter,
}

impl FirstFit {
    /// Estimated over stated σ of the first sensor's positions; 1 if the stated σ is used.
    pub(crate) fn sigma_factor(&self) -> f64 {
        self.converged.noise.variance_factors.first().map_or(1.0, |variance| variance.sqrt())
    }

    /// Number of readings used.
    pub(crate) fn readings(&self) -> usize {
        self.converged.subset.len()
    }

    /// Weight of the thin-plate energy.
    pub(crate) fn smoothness_weight(&self) -> f64 {
        self.converged.weight
    }
}

/// Fits the readings `first` over a base grid of patches.
///
/// # Errors
/// As for [`super::fit`].
pub(crate) fn first_fit_of(
    observations: &mut Observations,
    first: Vec<u32>,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<FirstFit> {
    let growth = options.max_depth.map_or(MAX_GROWTH, |depth| depth.min(MAX_GROWTH));
    let found = FitOptions { max_depth: Some(growth), ..options.clone() };
    let surface = first_surface(observations, &found, PATCH_CELLS, &ProgressPart::new(progress, 0.0, 0.3))?;
    // Counted in patches, because the filter divides these.
    let mut log = growth_log(surface.space(), PATCH_CELLS * PATCH_CELLS);
    // Patches divide a uniform base grid, so the levels that a ball has grown become that grid.
    let (metric, base_level) = rebased(surface)?;
    // Levels that a ball has grown count towards the depth that the user allows.
    let depth = options.max_depth.map_or(DEFAULT_DEPTH, |depth| depth.saturating_sub(base_level as u8));
    // Patches are divided as a whole, so they have more cells than the first readings ask for: half the
    // limit.
    let of_depth = |depth: u8| FitOptions {
        max_depth: Some(depth),
        max_coefficients: options.max_coefficients / 2,
        ..options.clone()
    };
    let mut converged = refine_to_noise(
        observations,
        metric.clone(),
        first,
        &of_depth(depth),
        &ProgressPart::new(progress, 0.3, 0.8),
    )?;
    let reached_tolerance = converged.reached_tolerance;
    // Patches are divided as a whole. The second fit gives the joint posterior over exactly their cells, so
    // that neighbouring patches start in agreement.
    let space = patch_hierarchy(converged.surface.space())?;
    if space.levels() > 1 {
        log_cover(&mut log, base_level, converged.surface.space(), &space, options);
        let surface = converged.surface.refined(space)?;
        converged = refine_to_noise(
            observations,
            surface,
            converged.subset,
            &of_depth(0),
            &ProgressPart::new(progress, 0.8, 1.0),
        )?;
        // A fit over fixed cells always reports its tolerance as reached, so the earlier result counts.
        converged.reached_tolerance = reached_tolerance;
    }
    let ConvergedFit { surface, system, feet, .. } = &converged;
    let prior =
        SmoothnessPrior { weight: converged.weight, hold: (HOLD_LENGTH * surface_extent(surface)).powi(-4) };
    // One coordinate stands for all three, so rows count as if all normals were equal.
    let up = vec![DVec3::Z; surface.space().node_count()];
    let used = weights(converged.readings(observations), &converged.noise, options.gate, Weighting::Gated);
    let (start, order) = crate::observe::by_leaf(feet, surface.space().leaves().len());
    let mut information = system.accumulate_along(&up, |leaf, add| {
        for &k in &order[start[leaf] as usize..start[leaf + 1] as usize] {
            let (foot, w) = (&feet[k as usize], used[k as usize]);
            if w > 0.0 {
                foot.rows(surface, |_, row| add(row, up[0], 0.0, w));
            }
        }
    })?;
    // The prior has the metric of the base surface, which the filter keeps for patches that are divided
    // later.
    let of_prior = prior.information(system, &metric)?.expanded(3)?;
    information.add_scaled(&system.contract(&of_prior, &up)?, 1.0)?;
    let filter = PatchFilter::from_first_fit(
        surface,
        &metric,
        prior,
        &information,
        PatchFilterOptions {
            layout: StateLayout::Normal,
            maximum_depth: depth,
            min_gain: MIN_GAIN,
            ..PatchFilterOptions::default()
        },
    )?;
    let mut core = StreamingFilter::new(filter, base_level, rules(options))?;
    core.log = log;
    // The first readings are part of the filter's state, so their places count as measured.
    for (foot, _) in feet.iter().zip(&used).filter(|(_, w)| **w > 0.0) {
        core.mark(surface.space().parameters(foot.leaf as usize, foot.local));
    }
    Ok(FirstFit { converged, core })
}

/// Logs the divisions that the first readings caused, in patches.
fn log_cover(
    log: &mut RefinementLog,
    base_level: usize,
    wanted: &Hierarchy,
    made: &Hierarchy,
    options: &FitOptions,
) {
    let cause = if options.refine_by.residuals() { Cause::Residuals } else { Cause::Curvature };
    let patches = |depth: usize| made.base().map(|n| (n / PATCH_CELLS) << depth);
    for depth in 0..made.levels() - 1 {
        // Which patches contain deeper cells: in the hierarchy made, and in the one that the readings asked
        // for.
        let [columns, rows] = patches(depth);
        let deeper = |space: &Hierarchy| {
            let mut marks = vec![false; columns * rows];
            for cell in space.leaves().iter().filter(|cell| usize::from(cell.level) > depth) {
                let shift = usize::from(cell.level) - depth;
                let at = [cell.i, cell.j].map(|c| (c as usize >> shift) / PATCH_CELLS);
                marks[at[1] * columns + at[0]] = true;
            }
            marks
        };
        let asked = deeper(wanted);
        let (mut own, mut grading) = (0, 0);
        for (asked, _) in asked.iter().zip(deeper(made)).filter(|(_, made)| *made) {
            *(if *asked { &mut own } else { &mut grading }) += 1;
        }
        log.add(base_level + depth, cause, own);
        log.add(base_level + depth, Cause::Grading, grading);
    }
}

pub(super) fn rules(options: &FitOptions) -> PatchRules {
    PatchRules {
        gate: options.gate,
        refine_by: options.refine_by,
        max_coefficients: options.max_coefficients,
    }
}

/// The same surface over a base grid of the cells of its finest level, and the number of levels removed. All
/// leaves must be of that level.
fn rebased(surface: Surface) -> Result<(Surface, usize)> {
    let space = surface.space();
    let levels = space.levels() - 1;
    if levels == 0 {
        return Ok((surface, 0));
    }
    let shape = space.shape().ok_or_else(|| Error::input("patches need a grid of cells"))?;
    let scale = (1_u32 << levels) as f64;
    let [columns, rows] = space.extent();
    let fine = Arc::new(Hierarchy::uniform(shape, space.base().map(|n| n << levels))?);
    // Beyond a pole the surface continues on the other side, half a turn away.
    let over_the_pole = shape == Shape::Ball;
    let made = fit_function(&fine, |u, v| {
        let [u, v] = [u / scale, v / scale];
        if over_the_pole && !(0.0..=rows).contains(&v) {
            let back = if v < 0.0 { -v } else { 2.0 * rows - v };
            surface.point(u + 0.5 * columns, back)
        } else {
            surface.point(u, v)
        }
    })?;
    Ok((made, levels))
}

/// Refuses alignment. Poses are not part of a patch's state: information that many patches share would count
/// in each of them as new.
pub(super) fn refuse_align(align: bool) -> Result<()> {
    if align {
        return Err(Error::unsupported(
            "expected the global filter for an alignment, found the patch filter, which uses poses as \
             stated",
        ));
    }
    Ok(())
}

/// Warnings about biases of sensors, which the filter cannot use for the same reason.
pub(super) fn unused_biases(set: &ScanSet) -> Vec<Finding> {
    (set.sensors.iter().enumerate())
        .filter(|(k, sensor)| sensor.sigma_bias.is_some() && set.scans.iter().any(|posed| posed.sensor == *k))
        .map(|(_, sensor)| {
            let text = format!(
                "the patch filter treats all readings as independent: `sigma_bias` of the sensor \"{}\" \
                 was not used, so σ of the surface is too small",
                sensor.name
            );
            Finding::new(FindingCode::BiasUnused, text)
        })
        .collect()
}

/// Largest variance of the surface, as a share of a reading's, at which residuals show noise rather than
/// unknown shape. The estimated σ is then at most 5 % too large.
const MAX_SURFACE_SHARE: f64 = 0.1;
/// Readings on the measured surface from which the noise of a later session is estimated; with fewer, all
/// readings are used. The standard error of σ from 200 is 5 %.
const MIN_FOR_NOISE: usize = 200;

/// Fits scans by the patch filter.
///
/// # Errors
/// As for [`super::fit`].
pub(super) fn fit_patches(
    set: &ScanSet,
    patches: &PatchOptions,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Fit> {
    let sheet = options.with_shape_of_ground();
    let mut observations = observe(set, &observation_options(set, options))?;
    let origin = observations.recentre();
    progress.check("normals", 0.02)?;
    let used = observations.fitted();
    let wanted = (used.len() / FIRST_SHARE).clamp(MIN_FIRST, MAX_FIRST);
    // A random order spreads the first readings over the whole object.
    let order = shuffled(&used, options.seed);
    let (first, others) = order.split_at(wanted.min(order.len()));
    let FirstFit { converged, core } =
        first_fit_of(&mut observations, first.to_vec(), &sheet, &ProgressPart::new(progress, 0.02, 0.4))?;
    // Half of the snapshots show the readings of the first fit.
    let mut formation = (patches.snapshots)
        .map(|frames| {
            formation::formation_of_global_fit(
                &observations,
                &converged,
                options,
                frames.div_ceil(2),
                progress,
            )
        })
        .transpose()?;
    let filtered = stream(
        &observations,
        StreamInput { first: converged, core, others, options, snapshots: patches.snapshots },
        formation.as_mut(),
        &ProgressPart::new(progress, 0.4, 0.85),
    )?;
    let mut fitted = finish(FinishInput::new(set, &observations, options, origin), filtered, progress)?;
    fitted.formation = formation;
    fitted.translated(origin)
}

/// Filters the readings of a later session into a saved model.
pub(super) fn update_patches(
    model: &SurfaceModel,
    filter: &Arc<PatchFilter>,
    observations: &Observations,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<ConvergedFit> {
    let used = observations.fitted();
    let surface = &model.surface;
    let mut at = vec![[0.0; 2]; observations.len()];
    let search = FootPointSearch::new(surface, 2, 0.1 * surface_extent(surface))?;
    let stated = SensorNoise::stated(&observations.channels);
    let feet = project(surface, observations, &used, &mut at, Some(&search), &stated.variance_factors);
    // The surface of the model did not follow these readings, so they determine none of its degrees of
    // freedom.
    let degrees = vec![0.0; observations.channels.len()];
    // Where the surface is known no better than a reading, residuals contain unknown shape besides noise.
    // Later sessions may extend beyond the measured part, where residuals carry no information about noise.
    let posterior = Posterior::new(surface, Arc::new(NodeCovariance::Patches(Arc::clone(filter))));
    let (start, order) = by_leaf(&feet, surface.space().leaves().len());
    let (mut on_known, mut known_feet) = (Vec::new(), Vec::new());
    for (leaf, _) in model.observed.iter().enumerate().filter(|(_, o)| o.is_measured()) {
        let own = &order[start[leaf] as usize..start[leaf + 1] as usize];
        if own.is_empty() {
            continue;
        }
        let cell = posterior.leaf(leaf)?;
        for &k in own {
            let foot = &feet[k as usize];
            let of_surface = cell.variance_along(&leaf_weights(foot.local[0], foot.local[1]), foot.normal);
            if foot.quantity != Quantity::Position || of_surface < MAX_SURFACE_SHARE * foot.variance {
                on_known.push(used[k as usize]);
                known_feet.push(*foot);
            }
        }
    }
    let noise = if on_known.len() < MIN_FOR_NOISE {
        SensorNoise::estimate(
            ProjectedReadings { observations, subset: &used, feet: &feet },
            options.noise_rules(),
            &degrees,
            true,
        )?
    } else {
        SensorNoise::estimate(
            ProjectedReadings { observations, subset: &on_known, feet: &known_feet },
            options.noise_rules(),
            &degrees,
            true,
        )?
    };
    let system = SurfaceSystem::new(surface.space())?;
    let no_readings = ConvergedFit {
        surface: surface.clone(),
        prior: system.zero_information()?,
        system,
        subset: Vec::new(),
        feet: Vec::new(),
        noise,
        weight: model.smoothness_weight,
        at: Vec::new(),
        reached_limit: false,
        reached_tolerance: false,
        refined: RefinementLog::default(),
        kind: ConvergedKind::AlongNormals,
        marginal: None,
        shown: ShownShape::default(),
    };
    let core = StreamingFilter::new(PatchFilter::clone(filter), 0, rules(options))?;
    let order = shuffled(&used, options.seed);
    let input = StreamInput { first: no_readings, core, others: &order, options, snapshots: None };
    stream(observations, input, None, &ProgressPart::new(progress, 0.2, 0.85))
}

/// The readings in a random order.
pub(super) fn shuffled(all: &[u32], seed: u64) -> Vec<u32> {
    // A number that no scan has: otherwise the order would repeat the choice of held-out readings.
    let mut keyed: Vec<(f64, u32)> = all.iter().map(|&i| (hash01(seed, 1 << 20, u64::from(i)), i)).collect();
    keyed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// Reading `i` for the filter, with the estimated variance of its sensor.
pub(super) fn incoming(observations: &Observations, i: usize, factors: &[f64]) -> IncomingReading {
    let factor = factors[observations.channel(i)];
    let variance = || factor * observations.variance(i, DVec3::ZERO);
    IncomingReading {
        at: observations.readings.points[i],
        facing: observations.normal(i),
        value: match observations.measured(i) {
            Measured::Position => ReadingValue::Position(observations.covariance(i).scaled(factor)),
            Measured::Normal(normal) => ReadingValue::Normal(normal, variance()),
            Measured::Curvature(tensor) => ReadingValue::Curvature(tensor, variance()),
        },
    }
}

/// A fit of first readings, and the readings to filter after it.
pub(super) struct StreamInput<'a> {
    pub first: ConvergedFit,
    pub core: StreamingFilter,
    pub others: &'a [u32],
    pub options: &'a FitOptions,
    /// Number of snapshots of the whole fit, if any.
    pub snapshots: Option<usize>,
}

/// Filters the readings in `input.others` one at a time, and projects all readings on the resulting surface.
pub(super) fn stream(
    observations: &Observations,
    StreamInput { first, mut core, others, options, snapshots }: StreamInput<'_>,
    mut formation: Option<&mut Formation>,
    progress: &dyn Progress,
) -> Result<ConvergedFit> {
    let information = weights(first.readings(observations), &first.noise, options.gate, Weighting::Gated);
    let mut refused: Vec<Option<RejectionCause>> =
        first.feet.iter().zip(&information).map(|(foot, &w)| foot.rejection(w)).collect();
    let all = first.subset.len() + others.len();
    let frames = snapshots.map_or(0, |frames| frames / 2 + 1);
    let mut moments = formation::counts(first.subset.len(), all, frames).into_iter().skip(1).peekable();
    for (k, &i) in others.iter().enumerate() {
        if k % READINGS_PER_CHECK == 0 {
            progress.check("streaming", k as f64 / others.len() as f64)?;
            progress.items(k, "readings");
        }
        let outcome =
            core.filter_reading(&incoming(observations, i as usize, &first.noise.variance_factors))?;
        if let Some(formation) = formation.as_deref_mut() {
            if outcome.is_none() {
                formation.places.push(observations.readings.points[i as usize]);
            }
            if moments.next_if_eq(&(first.subset.len() + k + 1)).is_some() {
                let snapshot = Snapshot::of_patches(formation.places.len(), core.filter.clone())?;
                formation.snapshots.push(snapshot);
            }
        }
        refused.push(outcome);
    }
    let surface = core.reconcile()?;
    // The order of `refused`: first readings, then those of the stream.
    let subset: Vec<u32> = first.subset.iter().chain(others).copied().collect();
    let mut at = vec![[0.0; 2]; observations.len()];
    // Each reading was filtered on the surface of its time. The report needs residuals from the final one.
    let search = FootPointSearch::new(&surface, 2, 0.1 * surface_extent(&surface))?;
    let mut feet =
        project(&surface, observations, &subset, &mut at, Some(&search), &first.noise.variance_factors);
    for (foot, refused) in feet.iter_mut().zip(&refused) {
        // A reading was accepted or rejected when it was filtered; its foot must not change that.
        foot.state = match refused {
            Some(RejectionCause::NormalMismatch) => FootState::NormalMismatch,
            Some(RejectionCause::BeyondBorder) => FootState::BeyondBorder,
            _ => FootState::Good,
        };
    }
    let system = SurfaceSystem::new(surface.space())?;
    let held_back = core.held_back();
    let deepest = core.base_level + usize::from(core.filter.options().maximum_depth);
    let mut refined = core.log;
    let max_coefficients = options.max_coefficients;
    // A division adds three patches; with less room than that the limit stops it.
    let full = core.filter.patches().len() + 3 > max_coefficients / crate::patch_stream::VERTICES_PER_PATCH;
    Ok(ConvergedFit {
        prior: system.zero_information()?,
        system,
        surface,
        subset,
        feet,
        at,
        reached_limit: full && held_back > 0,
        reached_tolerance: first.reached_tolerance,
        refined: std::mem::take(&mut refined),
        kind: ConvergedKind::Patches(PatchFilterOutcome {
            filter: Arc::new(core.filter),
            refused,
            held_back,
            deepest,
        }),
        noise: first.noise,
        weight: first.weight,
        marginal: None,
        shown: ShownShape::default(),
    })
}
