//! `fit` by the patch filter: a first fit of a bounded number of readings, then all others one at a time.
//!
//! Comes in: scans. Goes out: a [`Fit`] whose model holds the filter. The first readings, some thousands of
//! all, are fitted at once by the global filter over the base grid: that finds the shape, the noise and the
//! weight of smoothness, and its posterior is what the patches begin with. Every other reading is filtered
//! once, in a seeded random order, so that patches are divided early everywhere; none is taken in twice. The
//! readings of a live sensor come in their own order: see [`crate::stream`].
//!
//! Not guaranteed: the last bit of accuracy where patches were divided late: what a coarse patch took in says
//! nothing of finer detail.

use super::engine::{Foot, FootState, by_leaf, project};
use super::forming::{Forming, Snapshot};
use super::noise::SensorNoise;
use super::observations::{Measured, Observations, Quantity, Rejection, hash01};
use super::refined::{Cause, RefinementLog};
use super::stages::{Settled, extent_of, first_surface, grown, refine_to_noise, weights};
use super::{Fit, FitOptions, finish, forming, observation_options, observe};
use crate::model::{NodeCovariance, Posterior, SurfaceModel};
use crate::progress::{Part, Progress};
use crate::stream::{Core, Incoming, Rules, What};
use planish_estimate::{Error, Result};
use planish_exchange::ScanSet;
use planish_spline::{
    FootPointSearch, Hierarchy, PATCH_CELLS, PatchFilter, PatchFilterOptions, Shape, SmoothnessPrior,
    StateLayout, Surface, SurfaceSystem, fit_function, leaf_weights, patch_hierarchy,
};
use std::sync::Arc;

/// Readings of the first fit: a share of all, and bounds of their number.
const FIRST_SHARE: usize = 4;
const FEWEST_FIRST: usize = 500;
const MOST_FIRST: usize = 20_000;
/// A ball's base grid grows this often at most before its cells are those of patches.
const MOST_GROWTH: u8 = 2;
/// Levels of subdivision beyond the base grid where nobody says.
const USUAL_DEPTH: u8 = 3;
/// Features so many times longer than the surface are held back: what makes the prior proper.
const HOLD_LENGTH: f64 = 2.0;
/// Neighbours are not told what lowers a variance by less than this share.
const LEAST_GAIN: f64 = 1e-2;
/// Readings between two looks at whether the user still wants the answer.
const READINGS_PER_CHECK: usize = 4096;

/// What a patch filter made of the readings of a fit.
pub(super) struct Fused {
    pub filter: Arc<PatchFilter>,
    /// For each reading of the subset, why it was left out.
    refused: Vec<Option<Rejection>>,
    /// Patches of the deepest level that would have been divided further.
    held_back: usize,
    deepest: usize,
}

impl Fused {
    /// Information of every foot: nothing of those that were left out.
    pub(super) fn information(
        &self,
        observations: &Observations,
        subset: &[u32],
        feet: &[Foot],
        noise: &SensorNoise,
    ) -> Vec<f64> {
        (subset.iter().zip(feet).zip(&self.refused))
            .map(|((&i, foot), refused)| match refused {
                None => 1.0 / (noise.used[observations.channel(i as usize)] * foot.variance),
                Some(_) => 0.0,
            })
            .collect()
    }

    pub(super) fn warning(&self) -> Option<String> {
        (self.held_back > 0).then(|| {
            format!(
                "{} of {} patches still err together at level {}, the deepest allowed: raise --max-depth for more detail",
                self.held_back,
                self.filter.patches().len(),
                self.deepest
            )
        })
    }
}

/// A surface found from the first readings, and a filter that goes on from there.
pub(crate) struct FirstFit {
    pub(super) settled: Settled,
    pub core: Core,
}

impl FirstFit {
    /// By how much the σ of the first sensor's positions is larger than stated; 1 where they are believed.
    pub(crate) fn sigma_factor(&self) -> f64 {
        self.settled.noise.used.first().map_or(1.0, |variance| variance.sqrt())
    }

    /// How many readings it took in.
    pub(crate) fn readings(&self) -> usize {
        self.settled.subset.len()
    }

    /// Weight of the thin plate.
    pub(crate) fn smoothness_weight(&self) -> f64 {
        self.settled.weight
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
    let growth = options.max_depth.map_or(MOST_GROWTH, |depth| depth.min(MOST_GROWTH));
    let found = FitOptions { max_depth: Some(growth), ..options.clone() };
    let surface = first_surface(observations, &found, PATCH_CELLS, &Part::new(progress, 0.0, 0.3))?;
    let mut log = grown(surface.space(), PATCH_CELLS * PATCH_CELLS);
    let (metric, base_level) = rebased(surface)?;
    let depth = options.max_depth.map_or(USUAL_DEPTH, |depth| depth.saturating_sub(base_level as u8));
    // Patches are whole, so they have more cells than the shape of the first readings asks for.
    let of_depth = |depth: u8| FitOptions {
        max_depth: Some(depth),
        max_coefficients: options.max_coefficients / 2,
        ..options.clone()
    };
    let mut settled = refine_to_noise(
        observations,
        metric.clone(),
        first,
        &of_depth(depth),
        &Part::new(progress, 0.3, 0.8),
    )?;
    let reached_tolerance = settled.reached_tolerance;
    let space = patch_hierarchy(settled.surface.space())?;
    if space.levels() > 1 {
        log_cover(&mut log, base_level, settled.surface.space(), &space, options);
        let surface = settled.surface.refined(space)?;
        settled = refine_to_noise(
            observations,
            surface,
            settled.subset,
            &of_depth(0),
            &Part::new(progress, 0.8, 1.0),
        )?;
        // Over cells that are fixed every tolerance is reached.
        settled.reached_tolerance = reached_tolerance;
    }
    let Settled { surface, system, feet, .. } = &settled;
    let prior = SmoothnessPrior { weight: settled.weight, hold: (HOLD_LENGTH * extent_of(surface)).powi(-4) };
    // One coordinate stands for all: rows count as if every normal were the same.
    let up = vec![[0.0, 0.0, 1.0]; surface.space().node_count()];
    let used = weights(observations, &settled.subset, feet, &settled.noise, options.gate, false);
    let (start, order) = super::engine::by_leaf(feet, surface.space().leaves().len());
    let mut information = system.accumulate_along(&up, |leaf, add| {
        for &k in &order[start[leaf] as usize..start[leaf + 1] as usize] {
            let (foot, w) = (&feet[k as usize], used[k as usize]);
            if w > 0.0 {
                foot.rows(surface, |_, row| add(row, up[0], 0.0, w));
            }
        }
    })?;
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
            min_gain: LEAST_GAIN,
            ..PatchFilterOptions::default()
        },
    )?;
    let mut core = Core::new(filter, base_level, rules(options))?;
    core.log = log;
    for (foot, _) in feet.iter().zip(&used).filter(|(_, w)| **w > 0.0) {
        core.mark(surface.space().parameters(foot.leaf as usize, foot.local));
    }
    Ok(FirstFit { settled, core })
}

/// What the first readings had divided, in patches.
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
        // Whether anything in a patch is deeper: as it came out, and as the readings asked for.
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

pub(super) fn rules(options: &FitOptions) -> Rules {
    Rules { gate: options.gate, refine_by: options.refine_by, max_coefficients: options.max_coefficients }
}

/// The same surface over a base grid of the cells of its finest level, all of which are leaves; how many
/// levels that took off.
fn rebased(surface: Surface) -> Result<(Surface, usize)> {
    let space = surface.space();
    let levels = space.levels() - 1;
    if levels == 0 {
        return Ok((surface, 0));
    }
    let scale = (1_u32 << levels) as f64;
    let [columns, rows] = space.extent();
    let fine = Arc::new(Hierarchy::uniform(space.shape(), space.base().map(|n| n << levels))?);
    let over_the_pole = space.shape() == Shape::Ball;
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

/// Poses are no part of a patch's state: what many patches share cannot be told to each of them as if it were
/// news.
pub(super) fn refuse_align(options: &FitOptions) -> Result<()> {
    if options.align {
        return Err(Error::unsupported(
            "the patch filter takes poses as they are stated: needed the global filter to align scans",
        ));
    }
    Ok(())
}

/// What the sensors of the scans state and the filter does not use, for the same reason.
pub(super) fn unused_biases(set: &ScanSet) -> Vec<String> {
    (set.sensors.iter().enumerate())
        .filter(|(k, sensor)| sensor.sigma_bias.is_some() && set.scans.iter().any(|posed| posed.sensor == *k))
        .map(|(_, sensor)| {
            format!(
                "the patch filter takes every reading as independent: `sigma_bias` of the sensor \"{}\" was not used, and σ of the surface is too small by it",
                sensor.name
            )
        })
        .collect()
}

/// Readings that were concluded from others err together: a filter that takes one after the other as
/// independent would average that away.
pub(super) fn refuse_concluded(options: &FitOptions) -> Result<()> {
    let asked = [(options.symmetry.is_some(), "--symmetry"), (options.complete_smooth, "--complete")];
    match asked.iter().find(|(asked, _)| *asked) {
        Some((_, name)) => Err(Error::unsupported(format!(
            "{name} concludes readings from others, which err together, and the patch filter takes every reading as independent: needed --filter global"
        ))),
        None => Ok(()),
    }
}

/// A surface is known whose variance is this share of a reading's.
const KNOWN: f64 = 0.1;
/// So many readings on what was measured before tell the noise of a later session.
const ENOUGH_FOR_NOISE: usize = 200;

/// Fits scans by the patch filter.
pub(super) fn fit_patches(set: &ScanSet, options: &FitOptions, progress: &dyn Progress) -> Result<Fit> {
    let sheet =
        FitOptions { shape: options.shape.or(options.ground.map(|_| Shape::Sheet)), ..options.clone() };
    refuse_align(options)?;
    let mut observations = observe(set, &observation_options(set, options))?;
    let origin = observations.recentre();
    progress.check("normals", 0.02)?;
    let used: Vec<u32> =
        (0..observations.len() as u32).filter(|&i| !observations.held_out[i as usize]).collect();
    let wanted = (used.len() / FIRST_SHARE).clamp(FEWEST_FIRST, MOST_FIRST);
    let order = shuffled(&used, options.seed);
    let (first, others) = order.split_at(wanted.min(order.len()));
    let FirstFit { settled, core } =
        first_fit_of(&mut observations, first.to_vec(), &sheet, &Part::new(progress, 0.02, 0.4))?;
    // Half of the snapshots are of the readings that found the first surface.
    let mut forming = (options.snapshots)
        .map(|frames| forming::formed(&observations, &settled, options, frames.div_ceil(2), progress))
        .transpose()?;
    let fused = stream(
        &observations,
        settled,
        core,
        others,
        options,
        forming.as_mut(),
        &Part::new(progress, 0.4, 0.85),
    )?;
    let mut fitted = finish::finish(set, &observations, fused, options, None, None, origin, progress)?;
    fitted.forming = forming;
    fitted.translated(origin)
}

/// Filters the readings of another day into a saved model.
pub(super) fn update_patches(
    model: &SurfaceModel,
    filter: &Arc<PatchFilter>,
    observations: &Observations,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Settled> {
    let used: Vec<u32> =
        (0..observations.len() as u32).filter(|&i| !observations.held_out[i as usize]).collect();
    let surface = &model.surface;
    let mut at = vec![[0.0; 2]; observations.len()];
    let search = FootPointSearch::new(surface, 2, 0.1 * extent_of(surface))?;
    let stated = SensorNoise::stated(observations);
    let feet = project(surface, observations, &used, &mut at, Some(&search), &stated.used);
    let degrees = vec![0.0; observations.stated.len()];
    // Where the surface is known no better than a reading, residuals are shape that is not known, and no
    // noise.
    let posterior = Posterior::new(surface, Arc::new(NodeCovariance::Patches(Arc::clone(filter))));
    let (start, order) = by_leaf(&feet, surface.space().leaves().len());
    let (mut known, mut known_feet) = (Vec::new(), Vec::new());
    for (leaf, _) in model.observed.iter().enumerate().filter(|(_, o)| o.is_measured()) {
        let own = &order[start[leaf] as usize..start[leaf + 1] as usize];
        if own.is_empty() {
            continue;
        }
        let cell = posterior.leaf(leaf)?;
        for &k in own {
            let foot = &feet[k as usize];
            let of_surface = cell.variance_along(&leaf_weights(foot.local[0], foot.local[1]), foot.normal);
            if foot.quantity != Quantity::Position || of_surface < KNOWN * foot.variance {
                known.push(used[k as usize]);
                known_feet.push(*foot);
            }
        }
    }
    let noise = if known.len() < ENOUGH_FOR_NOISE {
        SensorNoise::estimate(observations, &used, &feet, options.gate, &degrees, true)?
    } else {
        SensorNoise::estimate(observations, &known, &known_feet, options.gate, &degrees, true)?
    };
    let system = SurfaceSystem::new(surface.space())?;
    let nothing_yet = Settled {
        surface: surface.clone(),
        prior: system.nothing()?,
        system,
        subset: Vec::new(),
        feet: Vec::new(),
        noise,
        weight: model.smoothness_weight,
        at: Vec::new(),
        reached_limit: false,
        reached_tolerance: false,
        refined: RefinementLog::default(),
        fused: None,
        moves_freely: false,
    };
    let core = Core::new(PatchFilter::clone(filter), 0, rules(options))?;
    let order = shuffled(&used, options.seed);
    stream(observations, nothing_yet, core, &order, options, None, &Part::new(progress, 0.2, 0.85))
}

/// The readings in a random order.
pub(super) fn shuffled(all: &[u32], seed: u64) -> Vec<u32> {
    let mut keyed: Vec<(f64, u32)> = all.iter().map(|&i| (hash01(seed, 1 << 20, u64::from(i)), i)).collect();
    keyed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// One reading as the filter takes it, its variance that which the sensor is found to have.
pub(super) fn incoming(observations: &Observations, i: usize, factors: &[f64]) -> Incoming {
    let factor = factors[observations.channel(i)];
    let variance = || factor * observations.variance(i, [0.0; 3]);
    Incoming {
        at: observations.points[i],
        facing: observations.normal(i),
        what: match observations.measured(i) {
            Measured::Position => What::Position(observations.covariance(i).map(|c| factor * c)),
            Measured::Normal(normal) => What::Normal(normal, variance()),
            Measured::Curvature(tensor) => What::Curvature(tensor, variance()),
        },
    }
}

/// Filters the readings `others` in, one at a time, and lays all readings on the surface that comes of it.
pub(super) fn stream(
    observations: &Observations,
    first: Settled,
    mut core: Core,
    others: &[u32],
    options: &FitOptions,
    mut forming: Option<&mut Forming>,
    progress: &dyn Progress,
) -> Result<Settled> {
    let known = weights(observations, &first.subset, &first.feet, &first.noise, options.gate, false);
    let mut refused: Vec<Option<Rejection>> =
        first.feet.iter().zip(&known).map(|(foot, &w)| foot.rejection(w)).collect();
    let all = first.subset.len() + others.len();
    let frames = options.snapshots.map_or(0, |frames| frames / 2 + 1);
    let mut moments = forming::counts(first.subset.len(), all, frames).into_iter().skip(1).peekable();
    for (k, &i) in others.iter().enumerate() {
        if k % READINGS_PER_CHECK == 0 {
            progress.check("streaming", k as f64 / others.len() as f64)?;
            progress.items(k, "readings");
        }
        let outcome = core.take(&incoming(observations, i as usize, &first.noise.used))?;
        if let Some(forming) = forming.as_deref_mut() {
            if outcome.is_none() {
                forming.places.push(observations.points[i as usize]);
            }
            if moments.next_if_eq(&(first.subset.len() + k + 1)).is_some() {
                let snapshot = Snapshot::of_patches(forming.places.len(), core.filter.clone())?;
                forming.snapshots.push(snapshot);
            }
        }
        refused.push(outcome);
    }
    let surface = core.reconcile()?;
    let subset: Vec<u32> = first.subset.iter().chain(others).copied().collect();
    let mut at = vec![[0.0; 2]; observations.len()];
    let search = FootPointSearch::new(&surface, 2, 0.1 * extent_of(&surface))?;
    let mut feet = project(&surface, observations, &subset, &mut at, Some(&search), &first.noise.used);
    for (foot, refused) in feet.iter_mut().zip(&refused) {
        // What became of a reading was settled when it came.
        foot.state = match refused {
            Some(Rejection::NormalMismatch) => FootState::NormalMismatch,
            Some(Rejection::BeyondBorder) => FootState::BeyondBorder,
            _ => FootState::Good,
        };
    }
    let system = SurfaceSystem::new(surface.space())?;
    let held_back = core.held_back();
    let deepest = core.base_level + usize::from(core.filter.options().maximum_depth);
    let mut refined = core.log;
    let most = options.max_coefficients;
    let full = core.filter.patches().len() + 3 > most / crate::stream::VERTICES_PER_PATCH;
    Ok(Settled {
        prior: system.nothing()?,
        system,
        surface,
        subset,
        feet,
        at,
        reached_limit: full && held_back > 0,
        reached_tolerance: first.reached_tolerance,
        refined: std::mem::take(&mut refined),
        fused: Some(Fused { filter: Arc::new(core.filter), refused, held_back, deepest }),
        noise: first.noise,
        weight: first.weight,
        moves_freely: false,
    })
}
