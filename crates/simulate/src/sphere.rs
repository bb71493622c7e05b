//! Figures 2 and 3 of the paper on Kalman spline fusion: a sphere estimated from noisy readings.
//!
//! Input: [`SphereOptions`], which include the seed. Output: [`SphereRow`]s with the mean errors of the patch
//! filter and the global filter, and the error that the posterior predicts, in per cent of the radius.
//! [`sphere_csv`] writes them as CSV and [`sphere_figure`] draws them as SVG.
//!
//! **Chart.** Like the paper, the experiment starts from one 7 × 7 patch with the shape of a cylinder. The
//! patch covers the part of the sphere that a sensor in front sees: directions `(tan a, tan b, 1)` with
//! `|a|, |b| ≤ 60°`, out to 68° from the axis at the corners. This chart is regular everywhere, so one patch
//! splits into 4, 16 and 64 as in the paper. A closed ball has poles, around which all patches split
//! together.
//!
//! **Readings.** Positions lie at random parameters, which the filters know. Their noise is along the normal
//! and uniform up to a maximum `m`. The filters use its variance `m²/3`, and at least `(0.2 %)²` of the
//! radius. Orientations follow after all positions, at the same parameters. They are tilted by an angle that
//! is uniform up to a maximum `θ`; the filters use `σ = θ/√6` along each tangent, and at least 0.005 rad.
//!
//! **Prior.** Restricted likelihood selects the weight of the smoothness prior from the positions of each
//! set. All depths share this weight.
//!
//! **Subdivision.** Readings arrive in `depth + 1` equal parts. After each part but the last, a patch is
//! split if its innovations are too large or if its curvature varies by more than its σ explains. A sphere
//! meets neither criterion, so the curves of all depths nearly coincide. With `noise_divides`, noise counts
//! as variation as in the paper, which shows what needless patches cost.
//!
//! **Bound.** The global filter has the same leaf cells and all readings. The posterior bound is the mean of
//! `√(2/π) σ` over the area, with σ along the normal: the expected mean absolute error of a sphere that is
//! drawn from the prior.
//!
//! Not guaranteed: that errors stay below the bound. A sphere is not a draw from the prior, which pulls it
//! towards the cylinder where readings are few and noisy: for 50 positions with 12 % noise, the error of
//! either filter is 1.23 times the bound. Without noise, one patch is best; it approximates the sphere to
//! 0.05 %, and the readings do not determine the additional freedom of four patches.
//!
//! # References
//! Wang, Wang, *On 3D model construction by fusing heterogeneous sensor data*, CVGIP: Image Understanding
//! 1994, section 4.1.

mod global;
mod tables;

pub use tables::{sphere_csv, sphere_figure};

use global::{GlobalFilter, GlobalSolution};
use planish_core::vector3::tangents;
use planish_core::{DVec3, Progress};
use planish_estimate::sparse::BlockInformation;
use planish_estimate::{
    Dispersion, Error, Result, SmoothnessEvaluation, SmoothnessModel, SmoothnessSearch,
    maximize_restricted_likelihood,
};
use planish_spline::{
    Hierarchy, PatchFilter, PatchFilterOptions, Shape, SmoothnessPrior, StateLayout, SubdivisionCriteria,
    Surface, SurfaceReading, SurfaceSystem, fit_function, leaf_weights, parameter_plane,
};
use planish_surface::fit::{Formation, Snapshot};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Half the opening angle of the chart, in radians.
const HALF_OPENING: f64 = PI / 3.0;
/// Base cells along each direction: one patch.
const CELLS: usize = 4;
/// Minimum σ of a position that the filters use, as a share of the radius.
///
/// One patch approximates the sphere to 0.05 % on average. With a much smaller σ, the innovations of nearly
/// exact readings would count as misfit and split patches.
const MIN_SIGMA: f64 = 2e-3;
/// Minimum σ of an orientation that the filters use, in radians: one patch has slope errors of this size.
const MIN_TILT_RAD: f64 = 5e-3;
/// Hold of the prior, per base cell to the fourth power; features up to three cells long are left to the
/// thin-plate energy.
const PRIOR_HOLD: f64 = 0.01;
/// Subdivision depth at which the weight of the prior is estimated, at most.
///
/// A sphere has no detail that deeper patches could show, so that a deeper estimate only costs time.
const WEIGHT_DEPTH: u8 = 2;
/// Evaluation points of the error along each direction of the chart.
const PROBES: usize = 24;
/// Position noise for which several orientation errors are compared, in per cent.
const COMPARED_NOISE: f64 = 6.0;
/// Minimum number of readings in a set: fewer do not determine the weight of the prior.
const MIN_READINGS: usize = 20;

/// Settings of the sphere experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct SphereOptions {
    /// Seed of every reading.
    pub seed: u64,
    /// Number of sets of readings; results are means over the sets.
    pub sets: usize,
    /// Numbers of readings in a set, one experiment for each.
    pub readings: Vec<usize>,
    /// Maximum noise of the positions, in per cent of the radius, one experiment for each.
    pub noise_percent: Vec<f64>,
    /// Maximum subdivision depth; every depth up to it is computed.
    pub depth: u8,
    /// Maximum error of the orientations in the second figure, in degrees.
    pub orientation_deg: f64,
    /// True if variation of the curvature within its own σ splits patches too, as in the paper.
    ///
    /// If false, a sphere is hardly ever split.
    pub noise_divides: bool,
    /// Maximum orientation errors that are compared at a position noise of 6 %, in degrees.
    pub compared_orientations_deg: Vec<f64>,
}

impl Default for SphereOptions {
    /// Settings of the paper: 50, 100 and 150 readings, noise from 0 to 12 %, depths 0 to 3, orientation
    /// errors of 2° and from 0 to 5°; means over 20 sets.
    fn default() -> Self {
        Self {
            seed: 0,
            sets: 20,
            readings: vec![50, 100, 150],
            noise_percent: (0..=6).map(|k| 2.0 * f64::from(k)).collect(),
            depth: 3,
            orientation_deg: 2.0,
            noise_divides: false,
            compared_orientations_deg: (0..=5).map(f64::from).collect(),
        }
    }
}

/// One point of each curve: means over the sets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SphereRow {
    /// Number of positions, and of orientations if there are any.
    pub readings: usize,
    /// Maximum noise of the positions, in per cent of the radius.
    pub noise_percent: f64,
    /// Maximum error of the orientations, in degrees; `None` if only positions were measured.
    pub orientation_deg: Option<f64>,
    /// Maximum subdivision depth.
    pub depth: u8,
    /// Number of leaf patches after all readings.
    pub leaf_patches: f64,
    /// Mean error of the patch filter, in per cent of the radius.
    pub patch_percent: f64,
    /// Mean error of the global filter, in per cent of the radius.
    pub global_percent: f64,
    /// Mean error that the global posterior predicts, in per cent of the radius.
    pub bound_percent: f64,
}

/// Columns of the CSV file, in order.
pub const SPHERE_COLUMNS: [&str; 8] = [
    "readings",
    "noise_percent",
    "orientation_deg",
    "depth",
    "leaf_patches",
    "patch_percent",
    "global_percent",
    "bound_percent",
];

impl SphereOptions {
    fn validate(&self) -> Result<()> {
        let invalid = |needed: &str| Err(Error::input(format!("expected {needed}")));
        if self.sets == 0 {
            return invalid("at least one set of readings");
        }
        if self.readings.is_empty() || self.readings.iter().any(|&n| n < MIN_READINGS) {
            return invalid("at least 20 readings in a set: fewer do not determine the weight of the prior");
        }
        let within = |x: &[f64], maximum: f64| x.iter().all(|x| (0.0..=maximum).contains(x));
        if self.noise_percent.is_empty() || !within(&self.noise_percent, 50.0) {
            return invalid("noise from 0 to 50 % of the radius");
        }
        if !within(&self.compared_orientations_deg, 30.0) || !within(&[self.orientation_deg], 30.0) {
            return invalid("orientation errors from 0 to 30 degrees");
        }
        if self.depth > 4 {
            return invalid("a subdivision depth of at most 4");
        }
        Ok(())
    }
}

/// Runs the experiment: one row for each number of readings, noise, orientation error and depth.
///
/// The result does not depend on the number of threads.
///
/// # Errors
/// `Input` for options out of range; `Interrupted` on request.
///
/// # Examples
/// ```
/// use planish_core::Silent;
/// use planish_simulate::{SphereOptions, sphere, sphere_csv};
/// # fn main() -> planish_estimate::Result<()> {
/// let options = SphereOptions {
///     sets: 2,
///     readings: vec![50],
///     noise_percent: vec![2.0],
///     depth: 0,
///     ..SphereOptions::default()
/// };
/// let rows = sphere(&options, &Silent)?;
/// // One row with positions only, one with orientations too: these reduce the error.
/// assert_eq!((rows[0].orientation_deg, rows[1].orientation_deg), (None, Some(2.0)));
/// assert!(rows[1].patch_percent < rows[0].patch_percent);
/// assert!(sphere_csv(&rows).starts_with("readings,noise_percent,"));
/// # Ok(())
/// # }
/// ```
pub fn sphere(options: &SphereOptions, progress: &dyn Progress) -> Result<Vec<SphereRow>> {
    options.validate()?;
    let model = SharedModel::new(options.depth, options.noise_divides)?;
    let mut rows = Vec::new();
    let total = (options.readings.len() * options.noise_percent.len()) as f64;
    for &readings in &options.readings {
        for (k, &noise) in options.noise_percent.iter().enumerate() {
            let begun = rows.len();
            // The comparison shares the sets of the main figure, so that equal orientation errors give
            // equal rows, which are computed once.
            let mut tilts = vec![options.orientation_deg];
            if noise == COMPARED_NOISE {
                tilts.extend(&options.compared_orientations_deg);
                tilts.sort_by(f64::total_cmp);
                tilts.dedup();
            }
            let sets: Vec<Vec<SphereRow>> = (0..options.sets as u64)
                .into_par_iter()
                .map(|set| {
                    // The noise is not part of the seed. Readings of all noises have the same parameters and
                    // the same errors up to scale, so that curves are smooth with few sets.
                    let seed =
                        options.seed.wrapping_mul(1_000_003).wrapping_add(set * 4099 + readings as u64);
                    model.simulate_set(seed, readings, noise, &tilts, options.depth)
                })
                .collect::<Result<_>>()?;
            rows.extend(average(&sets));
            debug_assert_eq!(rows.len() - begun, sets[0].len());
            let at = options.readings.iter().position(|&n| n == readings).unwrap_or(0)
                * options.noise_percent.len()
                + k;
            progress.check("simulating", (at + 1) as f64 / total)?;
            progress.items((at + 1) * sets.len(), "sets of readings");
        }
    }
    Ok(rows)
}

/// The mean of each row over the sets, which have the same rows in the same order.
fn average(sets: &[Vec<SphereRow>]) -> Vec<SphereRow> {
    let mut mean = sets[0].clone();
    let share = 1.0 / sets.len() as f64;
    for (k, row) in mean.iter_mut().enumerate() {
        let mean_of =
            |value: &dyn Fn(&SphereRow) -> f64| share * sets.iter().map(|s| value(&s[k])).sum::<f64>();
        // Only results are averaged. The settings of a row are the same in all sets.
        row.leaf_patches = mean_of(&|r| r.leaf_patches);
        row.patch_percent = mean_of(&|r| r.patch_percent);
        row.global_percent = mean_of(&|r| r.global_percent);
        row.bound_percent = mean_of(&|r| r.bound_percent);
    }
    mean
}

/// The surfaces and the equation system that all sets of readings share. The radius is 1.
struct SharedModel {
    /// The starting surface: one patch.
    cylinder: Surface,
    /// The surface in whose metric the prior measures smoothness: the plane of the parameters.
    metric: Surface,
    /// Equations of the space in which the weight of the prior is estimated.
    system: SurfaceSystem,
    noise_divides: bool,
}

/// The point of the unit sphere at parameters of the base grid.
fn on_sphere(u: f64, v: f64) -> DVec3 {
    let angle = |x: f64| (2.0 * x / CELLS as f64 - 1.0) * HALF_OPENING;
    DVec3::new(angle(u).tan(), angle(v).tan(), 1.0).try_normalize().unwrap_or(DVec3::Z)
}

/// Draws parameters uniformly and measures the sphere there, with a radial error of at most `noise_percent`.
fn simulate_positions(
    random: &mut ChaCha8Rng,
    count: usize,
    noise_percent: f64,
) -> (Vec<[f64; 2]>, Vec<SurfaceReading>) {
    let sigma = (noise_percent / 100.0 / 3.0_f64.sqrt()).max(MIN_SIGMA);
    let places: Vec<[f64; 2]> =
        (0..count).map(|_| [0, 1].map(|_| CELLS as f64 * random.random::<f64>())).collect();
    let positions: Vec<SurfaceReading> = places
        .iter()
        .map(|&[u, v]| {
            let along = 1.0 + 0.01 * noise_percent * (2.0 * random.random::<f64>() - 1.0);
            SurfaceReading::Position {
                parameters: [u, v],
                point: on_sphere(u, v).map(|x| along * x),
                variance: sigma * sigma,
            }
        })
        .collect();
    (places, positions)
}

/// Snapshots of the patch filter while it turns the starting cylinder into the sphere.
///
/// Uses the first set with the largest number of readings, the middle noise and the full depth. There are
/// at most `frames` snapshots, but at least two: the cylinder before any reading, and the result.
///
/// # Errors
/// As for [`sphere`].
///
/// # Examples
/// ```
/// use planish_simulate::{SphereOptions, sphere_forming};
/// # fn main() -> planish_estimate::Result<()> {
/// let options = SphereOptions { readings: vec![20], depth: 0, ..SphereOptions::default() };
/// let forming = sphere_forming(&options, 5)?;
/// assert_eq!(forming.snapshots.first().map(|s| s.readings), Some(0));
/// assert_eq!(forming.snapshots.last().map(|s| s.readings), Some(20));
/// # Ok(())
/// # }
/// ```
pub fn sphere_forming(options: &SphereOptions, frames: usize) -> Result<Formation> {
    options.validate()?;
    let count = options.readings.iter().copied().max().unwrap_or(0);
    let noise = options.noise_percent[options.noise_percent.len() / 2];
    let model = SharedModel::new(options.depth, options.noise_divides)?;
    let (_, positions) = simulate_positions(&mut ChaCha8Rng::seed_from_u64(options.seed), count, noise);
    let prior = SmoothnessPrior { weight: model.prior_weight(&positions)?, hold: PRIOR_HOLD };
    let places = (positions.iter())
        .filter_map(|reading| match reading {
            SurfaceReading::Position { point, .. } => Some(*point),
            _ => None,
        })
        .collect();
    let mut forming = Formation { places, snapshots: Vec::new() };
    // The last snapshot is taken after the loop, so one frame fewer is taken during it.
    let every = count.div_ceil(frames.saturating_sub(1).max(1)).max(1);
    let mut observed = 0;
    let filter = model.run_patch_filter(&positions, prior, options.depth, |filter| {
        if observed % every == 0 && observed < count {
            forming.snapshots.push(Snapshot::of_patches(observed, filter.clone())?);
        }
        observed += 1;
        Ok(())
    })?;
    forming.snapshots.push(Snapshot::of_patches(count, filter)?);
    Ok(forming)
}

impl SharedModel {
    fn new(depth: u8, noise_divides: bool) -> Result<Self> {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [CELLS; 2])?);
        let cylinder = fit_function(&space, |u, v| {
            let [a, b] = [u, v].map(|x| (2.0 * x / CELLS as f64 - 1.0) * HALF_OPENING);
            DVec3::new(a.sin(), b, a.cos())
        })?;
        // Subdivided everywhere, because the weight is needed before the filter decides where to split.
        let mut finest = Hierarchy::clone(&space);
        for _ in 0..depth.min(WEIGHT_DEPTH) {
            finest = finest.refine_all();
        }
        Ok(Self {
            cylinder,
            metric: parameter_plane(&space)?,
            system: SurfaceSystem::new(&Arc::new(finest))?,
            noise_divides,
        })
    }

    /// Simulates one set of readings and runs both filters at every depth.
    ///
    /// Returns one row for the positions and one for each of `tilts_deg`, for depths 0 to `depth` in turn.
    fn simulate_set(
        &self,
        seed: u64,
        count: usize,
        noise_percent: f64,
        tilts_deg: &[f64],
        depth: u8,
    ) -> Result<Vec<SphereRow>> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (places, positions) = simulate_positions(&mut random, count, noise_percent);
        // Shares and directions of the tilts are drawn once: orientation errors differ by scale only.
        let turns: Vec<[f64; 2]> =
            places.iter().map(|_| [random.random::<f64>(), TAU * random.random::<f64>()]).collect();
        let prior = SmoothnessPrior { weight: self.prior_weight(&positions)?, hold: PRIOR_HOLD };
        let mut rows = Vec::new();
        for depth in 0..=depth {
            let filter = self.run_patch_filter(&positions, prior, depth, |_| Ok(()))?;
            let space = Arc::clone(filter.space());
            let leaf_patches = filter.patches().len() as f64;
            let global = GlobalFilter::new(self, &space, prior, &positions)?;
            let by_position = global.solve()?;
            let mut row = |tilt: Option<f64>, patch: &Surface, global: &GlobalSolution| {
                rows.push(SphereRow {
                    readings: count,
                    noise_percent,
                    orientation_deg: tilt,
                    depth,
                    leaf_patches,
                    patch_percent: mean_error(patch),
                    global_percent: mean_error(&global.surface),
                    bound_percent: global.bound_percent,
                });
            };
            row(None, &filter.surface()?, &by_position);
            // Positions with isotropic noise leave the three coordinates independent and equal, which the
            // isotropic layout uses. A normal couples them.
            let full = filter.with_full_layout()?;
            for &tilt in tilts_deg {
                let normals: Vec<SurfaceReading> = places
                    .iter()
                    .zip(&turns)
                    .map(|(&[u, v], &[share, turn])| tilted_normal([u, v], tilt.to_radians(), share, turn))
                    .collect();
                let mut filter = full.clone();
                for reading in &normals {
                    filter.observe(reading)?;
                }
                filter.reconcile()?;
                let mut global = global.clone();
                global.add_normals(&normals, &by_position.surface)?;
                row(Some(tilt), &filter.surface()?, &global.solve()?);
            }
        }
        Ok(rows)
    }

    /// Runs the patch filter over the positions and subdivides it between equal parts of them.
    ///
    /// `watch` is called before the first reading and after each reading.
    fn run_patch_filter(
        &self,
        positions: &[SurfaceReading],
        prior: SmoothnessPrior,
        depth: u8,
        mut watch: impl FnMut(&PatchFilter) -> Result<()>,
    ) -> Result<PatchFilter> {
        let options = PatchFilterOptions {
            layout: StateLayout::Isotropic,
            maximum_depth: depth,
            min_gain: 1e-3,
            ..PatchFilterOptions::default()
        };
        let mut filter = PatchFilter::new(&self.cylinder, &self.metric, prior, options)?;
        let criteria =
            SubdivisionCriteria { discount_noise: !self.noise_divides, ..SubdivisionCriteria::default() };
        let parts = usize::from(depth) + 1;
        watch(&filter)?;
        for part in 0..parts {
            for reading in &positions[part * positions.len() / parts..(part + 1) * positions.len() / parts] {
                filter.observe(reading)?;
                watch(&filter)?;
            }
            if part + 1 < parts {
                filter.refine(&criteria)?;
            }
        }
        filter.reconcile()?;
        Ok(filter)
    }

    /// The weight of the prior that maximises the restricted likelihood of the positions.
    fn prior_weight(&self, positions: &[SurfaceReading]) -> Result<f64> {
        // The prior is linear in its weight, so its information is computed once and scaled by each
        // trial.
        let unit =
            SmoothnessPrior { weight: 1.0, hold: PRIOR_HOLD }.information(&self.system, &self.metric)?;
        let space = self.system.space();
        // The unknowns are displacements from the cylinder. Isotropic noise gives all three coordinates the
        // same matrix, so one factorisation serves three right-hand sides.
        let mut data = BlockInformation::zeros(Arc::clone(self.system.pattern()), 1, 3)?;
        let mut squares = 0.0;
        for reading in positions {
            let SurfaceReading::Position { parameters: [u, v], point, variance } = *reading else {
                continue;
            };
            let (leaf, [s, t]) = space.locate(u, v);
            let (nodes, weights) = space.extraction(leaf);
            let at = self.cylinder.point(u, v);
            let departure = point - at;
            squares += departure.to_array().iter().map(|x| x * x).sum::<f64>() / variance;
            let c = leaf_weights(s, t);
            let row: Vec<f64> = weights.iter().map(|w| w.iter().zip(&c).map(|(a, b)| a * b).sum()).collect();
            let matrix: Vec<f64> =
                row.iter().flat_map(|a| row.iter().map(move |b| a * b / variance)).collect();
            let vector: Vec<f64> =
                row.iter().flat_map(|a| departure.to_array().map(|x| a * x / variance)).collect();
            data.add_element(nodes, &matrix, &vector)?;
        }
        let nodes = space.node_count();
        // The hold makes the prior regular, so its rank is the number of unknowns. Its determinant is a
        // constant factor of the likelihood and left out.
        let model = SmoothnessModel {
            rank: 3 * nodes,
            unknowns: 3 * nodes,
            equations: 3 * positions.len(),
            log_pseudo_determinant: 0.0,
            dispersion: Dispersion::Known(1.0),
        };
        let evaluate = |weight: f64| -> Result<SmoothnessEvaluation> {
            let mut matrix = data.clone();
            matrix.add_scaled(&unit, weight)?;
            let factor = self.system.factorize_scalar(&matrix)?;
            let mut x = data.vector().to_vec();
            factor.solve_in_place(&mut x)?;
            let fitted: f64 = x.iter().zip(data.vector()).map(|(a, b)| a * b).sum();
            Ok(SmoothnessEvaluation {
                log_determinant: 3.0 * factor.log_determinant(),
                // |A x − b|² by its three terms: the readings need no second pass.
                residual: squares + data.quadratic_form(&x)? - 2.0 * fitted,
                roughness: unit.quadratic_form(&x)?,
                trace: None,
            })
        };
        let search = SmoothnessSearch { bounds: (1e-2, 1e8), ..SmoothnessSearch::from_start(100.0) };
        Ok(maximize_restricted_likelihood(&model, &search, evaluate)?.weight)
    }
}

/// A measured normal of the sphere, tilted by `share · largest` radians in the tangential direction `turn`.
fn tilted_normal([u, v]: [f64; 2], largest: f64, share: f64, turn: f64) -> SurfaceReading {
    let n = on_sphere(u, v);
    let (t1, t2) = tangents(n);
    let (s, c) = (largest * share).sin_cos();
    let (sin, cos) = turn.sin_cos();
    SurfaceReading::Normal {
        parameters: [u, v],
        normal: c * n + s * (cos * t1 + sin * t2),
        // An angle uniform up to θ has the mean square θ²/3, and each tangent gets half of it: σ² = θ²/6.
        sigma_rad: (largest / 6.0_f64.sqrt()).max(MIN_TILT_RAD),
    }
}

/// Evaluation points: parameters and an area of the sphere in common units, the weight of the point.
fn probes() -> impl Iterator<Item = ([f64; 2], f64)> {
    let place = |k: usize| CELLS as f64 * (k as f64 + 0.5) / PROBES as f64;
    (0..PROBES * PROBES).map(move |k| {
        let [u, v] = [place(k % PROBES), place(k / PROBES)];
        // Differences suffice for weights of a mean.
        let h = 1e-4;
        let [a, b] = [[h, 0.0], [0.0, h]].map(|[du, dv]| {
            let (p, q) = (on_sphere(u + du, v + dv), on_sphere(u - du, v - dv));
            p - q
        });
        ([u, v], a.cross(b).length())
    })
}

/// Mean distance of a surface from the sphere, weighted by area, in per cent of the radius.
fn mean_error(surface: &Surface) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for ([u, v], share) in probes() {
        sum += share * (surface.point(u, v).length() - 1.0).abs();
        area += share;
    }
    100.0 * sum / area
}

#[cfg(test)]
mod tests;
