//! From a cloud to a settled surface: first shape, then iterations and refinements until the noise is all
//! that is left.
//!
//! Comes in: [`Observations`] and the options. Goes out: a [`Settled`] surface with feet, noise and
//! smoothness weight; the information and its inverse are made from it once, by `finish`.

use super::FitOptions;
use super::bent::unevenly_bent;
use super::engine::{Foot, FootChannels, FootState, by_leaf, normal_step, project};
use super::growth::{MOST_LEVELS, grow};
use super::indicator::Indicator;
use super::invented::share_errors;
use super::noise::SensorNoise;
use super::observations::{Observations, Quantity};
use super::patch::Fused;
use super::refined::{Cause, RefineBy, RefinementLog};
use super::rough::too_coarse;
use crate::progress::Progress;
use planish_estimate::sparse::BlockInformation;
use planish_estimate::{Error, Result};
use planish_spline::{
    BaseShape, Cell, FootPointSearch, Hierarchy, LeafEnergy, Shape, Surface, SurfaceSystem,
    choose_base_shape, leaf_weights,
};
use rayon::prelude::*;
use std::collections::HashSet;
use std::sync::Arc;

/// Cells of the base grid, about.
const BASE_CELLS: usize = 128;
/// While the shape is being found, readings farther than so many σ pull with bounded force.
const BOUNDED: f64 = 2.5;
/// Points that are enough to find a first shape.
const ENOUGH_FOR_SHAPE: usize = 30_000;
/// Iterations between two refinements, and when the mean square step, in variances of the surface, is small
/// enough to go on.
const FINDING_ITERATIONS: usize = 2;
const MOST_FINDING_ITERATIONS: usize = 8;
const FOUND: f64 = 30.0;
/// Iterations at the end.
const LAST_ITERATIONS: usize = 7;
const LAST_ITERATIONS_WITH_POSES: usize = 14;
/// The surface is at rest when the mean square step that readings see is this share of its variance, with
/// what only the prior holds not more than so many times its variance off, and its weight has settled to
/// within so much.
const AT_REST: f64 = 0.1;
const UNSEEN_AT_REST: f64 = 4.0;
/// The same of what scans share: they slide along the surface with the feet of their readings, and come
/// nearer by half in each iteration.
const SHARED_AT_REST: f64 = 0.02;
const WEIGHT_AT_REST: f64 = 0.02;
/// Bins along each side of a leaf in which residuals are averaged to see shape that the leaf cannot follow.
pub(super) const BINS: usize = 4;
/// A leaf is split only where its readings can pay for it.
pub(super) const LEAST_READINGS: u32 = 8;
/// Shape worth a split explains at least this share of the variance of a leaf's readings.
const WORTHWHILE: f64 = 0.02;
/// A ball grows to no finer leaves than its readings can fill with so many each.
const READINGS_PER_GROWN_LEAF: usize = 6;
/// How many standard deviations of noise the shape shared by a leaf's readings must be.
const SIGNIFICANT: f64 = 2.5;
/// The same of the quarters of a leaf and its neighbours. Without this test 95 % intervals of simulated tubes
/// cover 90.5 % of the truth; with it at 2 they cover 94.8 %, sheets 95.5 % and balls 95.0 %.
const POOLED_SIGNIFICANT: f64 = 2.0;
/// A leaf that is smaller than so many σ is not split: readings would find a foot nearby however the surface
/// wrinkles, and σ would seem small. (A sphere of 40 000 readings with σ of 5 % of its radius seemed to have
/// 3.6 %.)
pub(super) const LEAST_LEAF_SIGMAS: f64 = 6.0;
/// Readings beyond the gate are no sign of shape where they are fewer than this share.
pub(super) const MOST_GROSS: f64 = 0.25;
/// Readings that an early round looks at, for each leaf.
const SAMPLE_PER_LEAF: usize = 12;
/// Lengths over which the prior smooths: at the start at least, in leaves; and at most, in square roots of
/// the surface's area. A stiffer plate would be no flatter, but what the readings say of its place would be
/// lost in rounding.
const FIRST_SMOOTHING: f64 = 0.15;
const STIFFEST: f64 = 2.0;
/// A leaf with more `∫ κ² dA` than a quarter turn has, (π/2)², is stiffened by this factor.
const MOST_BEND_OF_A_LEAF: f64 = 2.5;
const STIFFENING: f64 = 100.0;
/// σ of tangential motion, as a share of a leaf's size.
const TANGENTIAL_HOLD: f64 = 0.5;
/// Deepest level below the base grid.
const DEEPEST: u8 = 7;

/// A surface that has come to rest on its observations.
pub(super) struct Settled {
    pub surface: Surface,
    pub system: SurfaceSystem,
    /// The readings that take part, and their feet.
    pub subset: Vec<u32>,
    pub feet: Vec<Foot>,
    pub noise: SensorNoise,
    pub weight: f64,
    /// The prior's information of all three coordinates.
    pub prior: BlockInformation,
    /// Parameters of every observation.
    pub at: Vec<[f64; 2]>,
    pub reached_limit: bool,
    pub reached_tolerance: bool,
    /// What was divided on the way.
    pub refined: RefinementLog,
    /// What a patch filter made of the readings; it then holds what is known.
    pub fused: Option<Fused>,
    /// Whether vertices move in every direction: see [`crate::model::SurfaceModel::moves_freely`].
    pub moves_freely: bool,
}

/// Finds the first shape and settles it.
pub(super) fn settle(
    observations: &mut Observations,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Settled> {
    let places = |i: usize| {
        let channel = &observations.channels[observations.channel(i)];
        channel.quantity == Quantity::Position && !channel.invented
    };
    if !(0..observations.len()).any(places) {
        return Err(Error::undetermined(
            "no reading that is left measures a position: normals and curvatures leave open where the surface lies; add positions (a few touches will do), or say \
             kind = \"range\" where the points of these sensors are measured, too",
        ));
    }
    let surface = first_surface(observations, options, 1, progress)?;
    let subset: Vec<u32> =
        (0..observations.len() as u32).filter(|&i| !observations.held_out[i as usize]).collect();
    refine_to_noise(observations, surface, subset, options, progress)
}

/// The first shape, over a base grid whose sides are multiples of `multiple`; a ball's is refined as far as
/// it has grown.
pub(super) fn first_surface(
    observations: &Observations,
    options: &FitOptions,
    multiple: usize,
    progress: &dyn Progress,
) -> Result<Surface> {
    let size = observations.len();
    let some = enough_for_shape(observations);
    let (points, normals) = places_of(observations, &some);
    let base = choose_base_shape(&points, &normals, options.shape)?;
    // A small cloud cannot pay for many cells, whatever their prior.
    let grid = base_grid(&base, BASE_CELLS.min((size / 6).max(32)), multiple, options.max_coefficients)?;
    progress.check("first shape", 0.02)?;
    if base.shape == Shape::Ball {
        let indicator = Indicator::new(&points, &normals);
        let cells = |level: usize| (grid[0] * grid[1]) << (2 * level);
        let area = 4.0 * std::f64::consts::PI * base.size.iter().map(|s| s * s).sum::<f64>() / 3.0;
        let least_area = (LEAST_LEAF_SIGMAS * typical_sigma(observations, &some)).powi(2);
        let deepest = options.max_depth.map_or(MOST_LEVELS, |depth| MOST_LEVELS.min(depth.into()));
        let levels = (1..=deepest)
            .take_while(|&level| {
                cells(level) * READINGS_PER_GROWN_LEAF <= size
                    && area >= least_area * cells(level) as f64
                    && cells(level) <= options.max_coefficients
            })
            .count();
        grow(&base, grid, levels, &points, &indicator, &|share| {
            progress.check("growing", 0.05 + 0.35 * share)
        })
    } else {
        drape(&base, grid, &points)
    }
}

/// The shape that a first surface is made from, without the surface.
///
/// # Errors
/// `Undetermined` where the readings determine none.
pub(super) fn base_shape(observations: &Observations, shape: Option<Shape>) -> Result<BaseShape> {
    let (points, normals) = places_of(observations, &enough_for_shape(observations));
    choose_base_shape(&points, &normals, shape)
}

/// Readings that are enough to tell the shape.
fn enough_for_shape(observations: &Observations) -> Vec<u32> {
    let size = observations.len();
    (0..size as u32).step_by(size.div_ceil(ENOUGH_FOR_SHAPE).max(1)).collect()
}

/// Positions and normals of some readings.
fn places_of(observations: &Observations, some: &[u32]) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
    some.iter().map(|&i| (observations.points[i as usize], observations.normal(i as usize))).unzip()
}

/// A base grid of about so many cells, fewer where its nodes would be more than allowed; its sides are
/// multiples of `multiple`.
fn base_grid(base: &BaseShape, cells: usize, multiple: usize, most: usize) -> Result<[usize; 2]> {
    let mut cells = cells;
    loop {
        let grid = (base.grid(cells)).map(|n| (n + multiple / 2).max(multiple) / multiple * multiple);
        let nodes = Hierarchy::uniform(base.shape, grid)?.node_count();
        if nodes <= most {
            return Ok(grid);
        }
        if cells == 1 {
            return Err(Error::input(format!(
                "a {} takes at least {nodes} coefficients, but only {most} are allowed",
                base.shape.name()
            )));
        }
        cells = (cells * 4 / 5).max(1);
    }
}

/// Root mean square of the stated σ; zero where none is stated.
fn typical_sigma(observations: &Observations, some: &[u32]) -> f64 {
    let sum: f64 = some
        .iter()
        .map(|&i| i as usize)
        .filter(|&i| {
            observations.quantity(i) == Quantity::Position && observations.stated[observations.channel(i)]
        })
        .map(|i| {
            let [xx, _, _, yy, _, zz] = observations.covariance(i);
            (xx + yy + zz) / 3.0
        })
        .sum();
    (sum / some.len().max(1) as f64).sqrt()
}

/// The smooth surface over the base grid whose points at each reading's own base parameters are nearest to
/// the readings.
fn drape(base: &BaseShape, grid: [usize; 2], points: &[[f64; 3]]) -> Result<Surface> {
    let reference = base.surface(grid)?;
    let space = Arc::clone(reference.space());
    let extent = space.extent();
    let system = SurfaceSystem::new(&space)?;
    let mut lists: Vec<Vec<(u32, [f64; 2])>> = vec![Vec::new(); space.leaves().len()];
    for (i, p) in points.iter().enumerate() {
        let q = base.parameters(*p);
        let (leaf, local) = space.locate(q[0] * extent[0], q[1] * extent[1]);
        lists[leaf].push((i as u32, local));
    }
    let data = system.accumulate(|leaf, cell| {
        for &(i, local) in &lists[leaf] {
            cell.add_vector(
                &leaf_weights(local[0], local[1]),
                points[i as usize],
                &[1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
            );
        }
        !lists[leaf].is_empty()
    })?;
    // Smooth over one cell: what the readings say of finer shape comes later. The energy is that of the
    // departure from the base, so that unseen parts of a tube stay round.
    let area: f64 = reference.thin_plate(&space).iter().map(|l| l.area).sum();
    let cell = (area / space.leaves().len() as f64).sqrt();
    let weight = points.len() as f64 / area * cell.powi(4) * 0.05;
    let energy = system.thin_plate(&reference)?.expanded(3)?;
    let x: Vec<f64> = reference.vertices().iter().flatten().copied().collect();
    let mut pull = vec![0.0; x.len()];
    energy.multiply(&x, &mut pull)?;
    let mut total = data;
    total.add_scaled(&energy, weight)?;
    for (v, p) in total.vector_mut().iter_mut().zip(&pull) {
        *v += weight * p;
    }
    // A trace of the base itself where neither data nor energy reach.
    let hold = 1e-6 * total.diagonal().iter().sum::<f64>() / total.dimension() as f64;
    total.add_diagonal(hold);
    for (v, c) in total.vector_mut().iter_mut().zip(&x) {
        *v += hold * c;
    }
    let factor = system.factorize(&total)?;
    let mut solution = total.vector().to_vec();
    factor.solve_in_place(&mut solution)?;
    system.surface(&solution)
}

/// Iterates and refines until residuals hold no more shape.
pub(super) fn refine_to_noise(
    observations: &mut Observations,
    mut surface: Surface,
    subset: Vec<u32>,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Settled> {
    let mut at = vec![[f64::NAN; 2]; observations.len()];
    let mut noise = SensorNoise::stated(observations);
    let (mut weight, mut area) = (None, None);
    let mut degrees: Option<Vec<f64>> = None;
    let mut final_round = false;
    let mut outside: Vec<u32> = Vec::new();
    let (mut reached_limit, mut reached_tolerance) = (false, false);
    let mut refined = grown(surface.space(), 1);
    let mut projected = 0;
    for round in 0.. {
        if final_round {
            projected = 0;
        }
        let system = SurfaceSystem::new(surface.space())?;
        // Early rounds see a sample: every leaf needs a few dozen readings only.
        let sample: Vec<u32> = if final_round {
            subset.clone()
        } else {
            let wanted = (SAMPLE_PER_LEAF * surface.space().leaves().len()).max(40_000);
            subset.iter().copied().step_by((subset.len() / wanted).max(1)).collect()
        };
        // A reading is searched for when it is first seen, with its normal; later its foot is followed from
        // where it was. In the last round those that lie outside the gate are searched for anew.
        let again = if final_round { std::mem::take(&mut outside) } else { Vec::new() };
        let unseen = sample.iter().copied().filter(|&i| at[i as usize][0].is_nan());
        let lost: Vec<u32> = unseen.chain(again).collect();
        if !lost.is_empty() {
            let search = FootPointSearch::new(&surface, 2, 0.1 * extent_of(&surface))?;
            project(&surface, observations, &lost, &mut at, Some(&search), &noise.used);
        }
        let iterations = if final_round && !observations.shared.is_empty() {
            LAST_ITERATIONS_WITH_POSES
        } else if final_round {
            LAST_ITERATIONS
        } else {
            MOST_FINDING_ITERATIONS
        };
        let mut feet;
        let mut factor = None;
        // The metric stays that of the surface at the start of the round.
        let mut energy = BendingEnergy::new(&system, &surface)?;
        for iteration in 0..iterations {
            let share = 0.4 + 0.5 * (1.0 - 0.6_f64.powf(round as f64 + iteration as f64 / iterations as f64));
            progress.check(if final_round { "settling" } else { "refining" }, share)?;
            progress.items(projected, "readings");
            projected += sample.len();
            feet = project(&surface, observations, &sample, &mut at, None, &noise.used);
            share_errors(observations, &sample, &mut feet, &surface, weight);
            let channels = FootChannels::new(observations, &sample);
            let known = degrees.get_or_insert_with(|| first_degrees(&surface, &channels));
            noise = SensorNoise::estimate(observations, &sample, &feet, options.gate, known, final_round)?;
            let information = weights(observations, &sample, &feet, &noise, options.gate, !final_round);
            if !information.iter().any(|&w| w > 0.0) {
                return Err(Error::undetermined(
                    "no reading lies near the surface: do the scans share one frame and unit?",
                ));
            }
            progress.rms(rms_of_positions(&feet, &information));
            let area = *area.get_or_insert_with(|| leaf_areas(&surface).iter().sum());
            let start = weight.unwrap_or_else(|| first_weight(&surface, area, &feet, &information));
            let step = normal_step(
                &system,
                &surface,
                &feet,
                &information,
                &channels,
                &energy.matrix,
                start,
                None,
                &mut factor,
            )?;
            observations.take_shared(&step.shared);
            surface = step.surface;
            energy.measure(&surface);
            // Generalised Fellner–Schall: w ← (degrees that the data determine) / xᵀKx, a step at a time.
            let next =
                (step.degrees.iter().sum::<f64>() - 1.0).max(1.0) / energy.total.max(f64::MIN_POSITIVE);
            let stiffest = weight_of_length(&feet, &information, area, STIFFEST * area.sqrt());
            let next = next.clamp(0.2 * start, 5.0 * start).min(stiffest);
            weight = Some(next);
            let resting = step.seen < AT_REST
                && step.shared_decrement < SHARED_AT_REST
                && step.decrement < UNSEEN_AT_REST
                && (next / start - 1.0).abs() < WEIGHT_AT_REST;
            degrees = Some(step.degrees);
            if resting || (!final_round && iteration + 1 >= FINDING_ITERATIONS && step.decrement < FOUND) {
                break;
            }
        }
        let weight_now = weight.unwrap_or(0.0);
        if final_round {
            feet = project(&surface, observations, &subset, &mut at, None, &noise.used);
            share_errors(observations, &subset, &mut feet, &surface, weight);
            noise = SensorNoise::estimate(
                observations,
                &subset,
                &feet,
                options.gate,
                degrees.as_deref().unwrap_or(&[]),
                true,
            )?;
            // The prior of the model that goes out is that of its own metric.
            let energy = BendingEnergy::new(&system, &surface)?;
            let mut prior = system.tangential_hold(&surface, TANGENTIAL_HOLD)?;
            prior.add_scaled(&energy.matrix.expanded(3)?, weight_now)?;
            return Ok(Settled {
                surface,
                system,
                subset,
                feet,
                noise,
                weight: weight_now,
                prior,
                at,
                reached_limit,
                reached_tolerance,
                refined,
                fused: None,
                moves_freely: false,
            });
        }
        // What the leaves cannot follow.
        feet = project(&surface, observations, &sample, &mut at, None, &noise.used);
        share_errors(observations, &sample, &mut feet, &surface, weight);
        let kept = weights(observations, &sample, &feet, &noise, options.gate, false);
        outside = sample.iter().zip(&kept).filter(|(_, w)| **w == 0.0).map(|(i, _)| *i).collect();
        let mut verdict = if options.refine_by.residuals() {
            misfit(&surface, &feet, &noise, degrees.iter().flatten().sum(), observations, &sample, options)
        } else {
            Vec::new()
        };
        if let (true, Some(factor)) = (options.refine_by.curvature(), &factor) {
            let known: HashSet<usize> = verdict.iter().map(|m| m.leaf).collect();
            let read = (&*observations, &sample[..], &feet[..]);
            let bent = unevenly_bent(&surface, &system, factor, read, &noise, deepest(options))?;
            verdict.extend(bent.into_iter().filter(|m| !known.contains(&m.leaf)));
        }
        let space = surface.space();
        if options.tolerance.is_some() && verdict.is_empty() {
            reached_tolerance = true;
        }
        // What the readings show comes first.
        if options.refine_by == RefineBy::Roughness && verdict.len() < few(space) {
            verdict.extend(too_coarse(&surface, &feet, &kept, weight_now, deepest(options)));
        }
        if verdict.len() < few(space) {
            final_round = true;
            continue;
        }
        let (finer, split) = within_budget(space, &verdict, options.max_coefficients);
        let all = split == verdict.len();
        log_divisions(&mut refined, space, &finer, &verdict[..split]);
        reached_limit = !all;
        final_round = !all || finer.node_count() == space.node_count();
        surface = surface.refined(finer.into())?;
    }
    unreachable!("the loop ends by returning")
}

/// The prior's energy at a surface, in its own metric.
struct BendingEnergy {
    /// `K`, the same for each coordinate; three vectors.
    matrix: BlockInformation,
    leaves: Vec<LeafEnergy>,
    /// `∫ κ1² + κ2² dA` over the leaves that are bent within reason.
    total: f64,
    /// How many leaves were not.
    stiffened: usize,
}

impl BendingEnergy {
    /// Assembles the thin plate; leaves that bend more than they can resolve count [`STIFFENING`] times as
    /// much.
    ///
    /// A leaf whose normal turns by more than a quarter is a fold or a spike, or the shape is finer than the
    /// leaf: either way it is to be smooth until refinement shows otherwise, and must not tell how smooth the
    /// rest is.
    fn new(system: &SurfaceSystem, surface: &Surface) -> Result<Self> {
        let mut leaves = surface.thin_plate(system.space());
        for (leaf, energy) in leaves.iter_mut().enumerate() {
            if energy.energy(surface.leaf_coefficients(leaf)) > MOST_BEND_OF_A_LEAF {
                for entry in energy.thin_plate.iter_mut().flatten() {
                    *entry *= STIFFENING;
                }
            }
        }
        let matrix = system.assemble_energy(&leaves)?;
        let mut made = Self { matrix, leaves, total: 0.0, stiffened: 0 };
        made.measure(surface);
        Ok(made)
    }

    /// The energy of a surface in this metric, leaves that bend beyond reason left out.
    fn measure(&mut self, surface: &Surface) {
        let bends: Vec<f64> = (0..self.leaves.len())
            .into_par_iter()
            .with_min_len(256)
            .map(|leaf| self.leaves[leaf].energy(surface.leaf_coefficients(leaf)))
            .collect();
        self.total = bends.iter().filter(|&&b| b <= MOST_BEND_OF_A_LEAF).sum();
        self.stiffened = bends.iter().filter(|&&b| b > MOST_BEND_OF_A_LEAF).count();
    }
}

/// A length of the order of the whole surface.
pub(crate) fn extent_of(surface: &Surface) -> f64 {
    let (lo, hi) = surface.vertices().iter().fold(([f64::MAX; 3], [f64::MIN; 3]), |(lo, hi), p| {
        ([0, 1, 2].map(|d| lo[d].min(p[d])), [0, 1, 2].map(|d| hi[d].max(p[d])))
    });
    (0..3).map(|d| hi[d] - lo[d]).fold(0.0, f64::max)
}

/// Degrees of freedom before any were found out: half the nodes, or a quarter of the readings.
fn first_degrees(surface: &Surface, channels: &FootChannels<'_>) -> Vec<f64> {
    let rows = |k: usize| channels.observations.channels[channels.of(k)].quantity.rows() as f64;
    let numbers: f64 = (0..channels.subset.len()).map(rows).sum();
    let share = 0.5 * (surface.space().node_count() as f64 / numbers).min(0.5);
    let mut degrees = vec![0.0; channels.count];
    for k in 0..channels.subset.len() {
        degrees[channels.of(k)] += share * rows(k);
    }
    degrees
}

/// The weight of the thin plate that smooths over a length: information of positions an area, times the
/// length to the fourth; of slopes to the second, of curvatures as it is.
pub(super) fn weight_of_length(feet: &[Foot], information: &[f64], area: f64, length: f64) -> f64 {
    (feet.iter().zip(information))
        .map(|(foot, &w)| smoothing_information(foot.quantity, w, length))
        .sum::<f64>()
        / area
}

/// A reading's part in that.
pub(super) fn smoothing_information(quantity: Quantity, information: f64, length: f64) -> f64 {
    information
        * match quantity {
            Quantity::Position => length.powi(4),
            Quantity::Normal => length.powi(2),
            Quantity::Curvature => 1.0,
        }
}

/// To start the search for the weight: a stiff start would undo what growth has found, a soft one would
/// follow few readings anywhere.
fn first_weight(surface: &Surface, area: f64, feet: &[Foot], information: &[f64]) -> f64 {
    let leaves = surface.space().leaves().len() as f64;
    let readings = information.iter().filter(|&&w| w > 0.0).count() as f64;
    weight_of_length(feet, information, area, (area / leaves).sqrt() * FIRST_SMOOTHING.max(leaves / readings))
}

/// Root mean square of the distances of positions that count; not finite where none does.
fn rms_of_positions(feet: &[Foot], information: &[f64]) -> f64 {
    let counting = feet.iter().zip(information);
    let (squares, n) = counting
        .filter(|(foot, weight)| foot.quantity == Quantity::Position && **weight > 0.0)
        .fold((0.0, 0.0), |(squares, n), (foot, _)| (squares + foot.height() * foot.height(), n + 1.0));
    (squares / n).sqrt()
}

/// Information of every foot: one over its variance, zero outside the gate; softened to Huber's while the
/// shape is being found. Of the ground the upper side falls off faster, so that the sheet comes down to the
/// lower of two opinions (Kraus & Pfeifer 1998, *Determination of terrain models in wooded areas with
/// airborne laser scanner data*; the form of the fall is ours, in units of σ).
pub(super) fn weights(
    observations: &Observations,
    subset: &[u32],
    feet: &[Foot],
    noise: &SensorNoise,
    gate: f64,
    finding: bool,
) -> Vec<f64> {
    weights_beside(observations, subset, feet, noise, gate, finding, |_| 0.0)
}

/// [`weights`] where the surface from which feet are measured has a variance of its own, by foot: it widens
/// the gate.
pub(super) fn weights_beside(
    observations: &Observations,
    subset: &[u32],
    feet: &[Foot],
    noise: &SensorNoise,
    gate: f64,
    finding: bool,
    of_surface: impl Fn(usize) -> f64,
) -> Vec<f64> {
    subset
        .iter()
        .zip(feet)
        .enumerate()
        .map(|(k, (&i, foot))| {
            if foot.state != FootState::Good {
                return 0.0;
            }
            let variance = noise.used[observations.channel(i as usize)] * foot.variance;
            let r = foot.extremes().0 / (variance + of_surface(k)).sqrt();
            if finding {
                let above = observations.ground
                    && foot.quantity == Quantity::Position
                    && foot.height() * foot.normal[2] > 0.0;
                let softened = match r / BOUNDED {
                    far if far <= 1.0 => 1.0,
                    // What is left of things that stand on the ground lies above it: the farther, the less it
                    // pulls.
                    far if above => 1.0 / (1.0 + (far - 1.0).powi(2) * far),
                    // Far readings pull with bounded force: most are shape still to be found, not errors.
                    far => 1.0 / far,
                };
                softened / variance
            } else if r <= gate {
                1.0 / variance
            } else {
                0.0
            }
        })
        .collect()
}

/// A leaf that is to be split.
pub(super) struct Misfit {
    pub leaf: usize,
    pub cause: Cause,
    /// Shared shape of its own bins, in standard deviations of what noise makes; or how much its curvature
    /// varies; or how much too wide it is.
    pub severity: f64,
    /// Signs of the corner where it is worst.
    pub corner: [f64; 2],
}

/// The deepest level that is allowed.
fn deepest(options: &FitOptions) -> u8 {
    options.max_depth.map_or(DEEPEST, |depth| DEEPEST.min(depth))
}

/// So few misfits are chance.
fn few(space: &Hierarchy) -> usize {
    space.leaves().len().div_ceil(50)
}

/// Splits as many of the misfits, worst first, as the limit of coefficients allows, and says how many.
fn within_budget(space: &Hierarchy, misfits: &[Misfit], most: usize) -> (Hierarchy, usize) {
    let marked = |count: usize| blocks(space, &misfits[..count]);
    let nodes = |count: usize| space.refined_node_count(&marked(count));
    if nodes(misfits.len()) <= most {
        return (space.refine(&marked(misfits.len())), misfits.len());
    }
    let (mut fits, mut too_many) = (0, misfits.len());
    while too_many - fits > few(space).div_ceil(8) {
        let middle = fits.midpoint(too_many);
        if nodes(middle) <= most {
            fits = middle;
        } else {
            too_many = middle;
        }
    }
    (space.refine(&marked(fits)), fits)
}

/// What growth has divided, in squares of so many cells: every level whole.
pub(super) fn grown(space: &Hierarchy, cells: usize) -> RefinementLog {
    let mut log = RefinementLog::default();
    let base = space.base().iter().product::<usize>() / cells;
    for level in 1..space.levels() {
        log.add(level - 1, Cause::Growth, base << (2 * (level - 1)));
    }
    log
}

/// Which leaves were divided, and for what.
fn log_divisions(log: &mut RefinementLog, space: &Hierarchy, finer: &Hierarchy, misfits: &[Misfit]) {
    let of = |cause: Cause| -> HashSet<usize> {
        let own = misfits.iter().filter(|m| m.cause == cause);
        blocks(space, own).into_iter().collect()
    };
    let (residuals, curvature, roughness) =
        (of(Cause::Residuals), of(Cause::Curvature), of(Cause::Roughness));
    let kept: HashSet<Cell> = finer.leaves().iter().copied().collect();
    for (leaf, cell) in space.leaves().iter().enumerate().filter(|(_, cell)| !kept.contains(cell)) {
        let cause = if residuals.contains(&leaf) {
            Cause::Residuals
        } else if curvature.contains(&leaf) {
            Cause::Curvature
        } else if roughness.contains(&leaf) {
            Cause::Roughness
        } else {
            Cause::Grading
        };
        log.add(usize::from(cell.level), cause, 1);
    }
}

/// One bicubic function of the next level lives on a 2 × 2 block: the block at the worst corner of each leaf.
fn blocks<'a>(space: &Hierarchy, misfits: impl IntoIterator<Item = &'a Misfit>) -> Vec<usize> {
    let mut marked = Vec::new();
    for &Misfit { leaf, corner: [su, sv], .. } in misfits {
        for dv in [0.5, 0.5 + sv] {
            for du in [0.5, 0.5 + su] {
                let [u, v] = space.parameters(leaf, [du, dv]);
                let (other, _) = space.locate(u, v);
                if space.leaves()[other].level <= space.leaves()[leaf].level {
                    marked.push(other);
                }
            }
        }
    }
    marked.sort_unstable();
    marked.dedup();
    marked
}

/// The bin of a place on a leaf, row by row.
pub(super) fn bin_of(local: [f64; 2]) -> usize {
    let [i, j] = local.map(|x| ((x * BINS as f64) as usize).min(BINS - 1));
    j * BINS + i
}

/// The residuals `h` of one bin with weights `w`.
#[derive(Clone, Copy, Default)]
struct Bin {
    /// `Σ w h`, `Σ (w h)²` and `Σ w`.
    sum: f64,
    squares: f64,
    precision: f64,
    count: f64,
}

/// The residuals of one leaf, in bins: number by number of positions and normals, as smooth shape leaves each
/// of them smooth. Those of curvatures are no sign: the prior speaks of curvature itself and shrinks all of
/// its wavelengths alike, the more the more cells there are.
#[derive(Clone, Default)]
struct LeafResiduals {
    /// The bins of one number after those of the other.
    bins: Vec<Bin>,
    /// Numbers that were read, and how many of them are positions.
    count: u32,
    placed: u32,
    /// Mean variance of the positions, as small as it may be.
    variance: f64,
}

/// Numbers whose residuals are looked at: the height, and the tilt of two tangents.
const COUNTED_NUMBERS: usize = 3;

/// Where each quantity's numbers begin among those.
fn first_number(quantity: Quantity) -> usize {
    match quantity {
        Quantity::Position => 0,
        Quantity::Normal => 1,
        Quantity::Curvature => COUNTED_NUMBERS,
    }
}

impl LeafResiduals {
    /// `Σ_b ((Σ w h)² − Σ (w h)²) / Σ w` over the bins in which `of` puts any, and half its variance under
    /// noise.
    ///
    /// Only products of different readings are left: the mean is zero under any noise that is symmetric and
    /// independent, gross errors included, and grows with the shape that neighbours share.
    fn shared_shape(&self, of: impl Fn(usize) -> Option<usize>) -> (f64, f64) {
        let (mut shape, mut pairs) = (0.0, 0.0);
        for number in self.bins.chunks_exact(BINS * BINS) {
            let mut merged = [Bin::default(); BINS * BINS];
            for (bin, own) in number.iter().enumerate() {
                if let Some(to) = of(bin) {
                    let to = &mut merged[to];
                    to.sum += own.sum;
                    to.squares += own.squares;
                    to.precision += own.precision;
                    to.count += own.count;
                }
            }
            for bin in merged.iter().filter(|bin| bin.count > 1.0) {
                shape += (bin.sum * bin.sum - bin.squares) / bin.precision;
                pairs += 1.0 - 1.0 / bin.count;
            }
        }
        (shape, pairs)
    }

    /// The quarter of the leaf that a bin lies in.
    fn quarter(bin: usize) -> usize {
        usize::from(bin / BINS >= BINS / 2) * 2 + usize::from(bin % BINS >= BINS / 2)
    }

    /// The largest mean residual of the positions of a bin.
    fn largest_mean(&self) -> f64 {
        self.bins
            .iter()
            .take(BINS * BINS)
            .filter(|b| b.count > 0.0)
            .map(|b| (b.sum / b.precision).abs())
            .fold(0.0, f64::max)
    }

    /// The quarter that holds most of the misfit, as the signs of its corner.
    fn worst_corner(&self) -> [f64; 2] {
        let mut misfit = [0.0; 4];
        for (bin, b) in self.bins.iter().enumerate().filter(|(_, b)| b.count > 0.0) {
            misfit[Self::quarter(bin % (BINS * BINS))] += b.sum * b.sum / b.precision;
        }
        let worst = (0..4).max_by(|&a, &b| misfit[a].total_cmp(&misfit[b])).unwrap_or(0);
        [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]][worst]
    }
}

/// Averages residuals over the bins of each leaf and finds where they are too large to be noise, worst first.
///
/// See [`LeafResiduals::shared_shape`]; what the fit took of it is added. One leaf shows strong misfit alone;
/// what is too weak for that is looked for in the quarters of a leaf and its eight neighbours together,
/// because shape that is left out without a sign of it is what makes a stated σ too small; but only once
/// strong misfit is gone. With a tolerance, the means' own size decides.
fn misfit(
    surface: &Surface,
    feet: &[Foot],
    noise: &SensorNoise,
    degrees: f64,
    observations: &Observations,
    subset: &[u32],
    options: &FitOptions,
) -> Vec<Misfit> {
    let space = surface.space();
    let (start, order) = by_leaf(feet, space.leaves().len());
    let normalised = |k: u32| {
        let foot = &feet[k as usize];
        let sensor = observations.channel(subset[k as usize] as usize);
        // While shape is missing it inflates every estimate: a stated σ bounds it, and how well neighbouring
        // points agree. Neighbours of one scan may err together, though: without a stated σ their agreement
        // bounds only how small a leaf may be.
        let most = noise.used[sensor].min(noise.most[sensor]);
        let factor = if observations.stated[sensor] { most } else { noise.used[sensor] };
        let variance = factor * foot.variance;
        (foot.extremes().0 / variance.sqrt(), variance, most * foot.variance)
    };
    let areas = leaf_areas(surface);
    let numbers = (observations.channels.iter())
        .map(|channel| first_number(channel.quantity) + channel.quantity.rows())
        .max()
        .unwrap_or(1)
        .min(COUNTED_NUMBERS);
    let mut residuals = vec![LeafResiduals::default(); space.leaves().len()];
    for (leaf, made) in residuals.iter_mut().enumerate() {
        let good = || {
            order[start[leaf] as usize..start[leaf + 1] as usize]
                .iter()
                .filter(|&&k| {
                    let foot = &feet[k as usize];
                    foot.state == FootState::Good && first_number(foot.quantity) < numbers
                })
                .map(|&k| (&feet[k as usize], normalised(k)))
        };
        // Few far readings are gross errors, many are shape.
        let far = good().filter(|(_, (r, ..))| *r > options.gate).count();
        let gross = (far as f64) < MOST_GROSS * good().count() as f64;
        made.bins = vec![Bin::default(); numbers * BINS * BINS];
        for (foot, (r, variance, least)) in good() {
            if gross && r > options.gate {
                continue;
            }
            // Huber's mean: one wild reading must not split a leaf.
            let w = (if r > 3.0 { 3.0 / r } else { 1.0 }) / variance;
            let bin = bin_of(foot.local);
            for (number, h) in (first_number(foot.quantity)..).zip(foot.residuals()) {
                let bin = &mut made.bins[number * BINS * BINS + bin];
                bin.sum += w * h;
                bin.squares += (w * h).powi(2);
                bin.precision += w;
                bin.count += 1.0;
                made.count += 1;
            }
            if foot.quantity == Quantity::Position {
                made.placed += 1;
                made.variance += least;
            }
        }
        made.variance /= f64::from(made.placed.max(1));
    }
    // What the fit took of each measured leaf, on average.
    let measured = residuals.iter().filter(|r| r.count > 0).count();
    let taken = degrees / measured.max(1) as f64;
    let quarters: Vec<(f64, f64)> = residuals
        .iter()
        .map(|r| {
            let (shape, pairs) = r.shared_shape(|bin| Some(LeafResiduals::quarter(bin)));
            (shape + taken.min(0.8 * pairs), pairs)
        })
        .collect();
    let deepest = deepest(options);
    let (mut strong, mut weak) = (Vec::new(), Vec::new());
    for (leaf, own) in residuals.iter().enumerate() {
        let too_small = areas[leaf] < LEAST_LEAF_SIGMAS.powi(2) * own.variance;
        if too_small || space.leaves()[leaf].level >= deepest || own.count < LEAST_READINGS {
            continue;
        }
        let (shape, pairs) = own.shared_shape(Some);
        let spread = (2.0 * pairs).sqrt();
        let found = || Misfit {
            leaf,
            cause: Cause::Residuals,
            severity: shape / spread.max(1.0),
            corner: own.worst_corner(),
        };
        let significant = shape > (SIGNIFICANT * spread).max(WORTHWHILE * f64::from(own.count));
        if let Some(tolerance) = options.tolerance {
            if significant && own.largest_mean() > tolerance {
                strong.push(found());
            }
        } else if significant {
            strong.push(found());
        } else {
            let (mut excess, mut spread, mut count) = (0.0, 0.0, 0.0);
            for other in neighbourhood(space, leaf) {
                excess += quarters[other].0;
                spread += 2.0 * quarters[other].1;
                count += f64::from(residuals[other].count);
            }
            if excess > (POOLED_SIGNIFICANT * f64::sqrt(spread)).max(WORTHWHILE * count) {
                weak.push(found());
            }
        }
    }
    let worst_first = |a: &Misfit, b: &Misfit| b.severity.total_cmp(&a.severity).then(a.leaf.cmp(&b.leaf));
    strong.sort_by(worst_first);
    // Weak misfit is split too while that leaves most of the budget to stronger misfit yet to be found.
    let before = strong.len();
    strong.append(&mut weak);
    if before >= few(space)
        && space.refined_node_count(&blocks(space, &strong)) > options.max_coefficients / 2
    {
        strong.truncate(before);
    }
    strong.sort_by(worst_first);
    strong
}

/// A leaf and those around it, each once.
pub(super) fn neighbourhood(space: &Hierarchy, leaf: usize) -> Vec<usize> {
    let mut found: Vec<usize> = [-0.5, 0.5, 1.5]
        .into_iter()
        .flat_map(|dv| [-0.5, 0.5, 1.5].map(|du| [du, dv]))
        .map(|local| {
            let [u, v] = space.parameters(leaf, local);
            space.locate(u, v).0
        })
        .collect();
    found.sort_unstable();
    found.dedup();
    found
}

/// For each leaf, whether it holds an ungated foot of those that count, by their number.
pub(super) fn leaves_with_feet(
    surface: &Surface,
    feet: &[Foot],
    information: &[f64],
    counts: impl Fn(usize) -> bool,
) -> Vec<bool> {
    let space = surface.space();
    let mut own = vec![false; space.leaves().len()];
    for (k, (foot, &w)) in feet.iter().zip(information).enumerate() {
        own[foot.leaf as usize] |= w > 0.0 && counts(k);
    }
    own
}

/// For each leaf, whether it or one of its eight neighbours holds an ungated foot.
pub(super) fn observed_leaves(surface: &Surface, feet: &[Foot], information: &[f64]) -> Vec<bool> {
    with_neighbours(surface.space(), &leaves_with_feet(surface, feet, information, |_| true))
}

/// The marked leaves and the neighbours of each.
pub(crate) fn with_neighbours(space: &Hierarchy, own: &[bool]) -> Vec<bool> {
    let mut observed = own.to_vec();
    for leaf in 0..own.len() {
        if own[leaf] {
            for other in neighbourhood(space, leaf) {
                observed[other] = true;
            }
        }
    }
    observed
}

/// Area of each leaf.
pub(super) fn leaf_areas(surface: &Surface) -> Vec<f64> {
    (0..surface.space().leaves().len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| surface.leaf_area(leaf))
        .collect()
}
