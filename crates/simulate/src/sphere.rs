//! Figures 2 and 3 of the paper on Kalman spline fusion: a sphere, measured badly, found again.
//!
//! Input: [`SphereOptions`] and a seed. Output: [`SphereRow`]s, mean errors in per cent of the radius
//! over maximum noise, for both filters beside what the posterior promises; written as CSV and drawn as SVG
//! with [`sphere_csv`] and [`sphere_figure`].
//!
//! The paper covers the sphere by one 7 × 7 patch that starts as a cylinder. So do we, over the part that a
//! sensor in front sees: directions `(tan a, tan b, 1)` with `|a|, |b| ≤ 60°`, out to 68° from the axis at
//! the corners. The chart is regular everywhere, and one patch divides into 4, 16 and 64 as in the paper; a
//! closed ball has poles, about which patches are divided all around together, and would compare other
//! numbers of patches. Readings lie at random in the chart with known parameters; their noise is along the
//! normal and uniform up to its maximum `m`, so filters are told a variance of `m²/3`, never less than
//! `(0.2 %)²` of the radius, about what one patch misses of the sphere. Orientations are tilted by an angle
//! that is uniform up to its maximum, at the places of the positions, after all of them; filters are told
//! `θ/√6` along either tangent, never less than 0.005 rad, the slope that a single patch misses of a sphere.
//!
//! The weight of the smoothness prior is that of restricted likelihood for each set's positions over patches
//! divided twice, or as often as is asked for: one prior for all depths. Readings come in `depth + 1` equal
//! parts; after each but the last, patches are divided where innovations are too large or curvature varies by
//! more than its σ explains. A sphere gives no reason for that, so the curves of all depths lie near each
//! other; with `noise_divides` the paper's criterion counts noise as variation, and one sees what needless
//! patches cost. The global filter has the same leaf cells and all the readings. The posterior bound is the
//! mean of `√(2/π) σ` over the area, σ along the normal by the global filter: what the mean absolute error
//! would be were the sphere drawn from the prior.
//!
//! Not guaranteed: that errors stay below the bound. The sphere is no draw from the prior, which pulls it to
//! the cylinder by what few and bad readings leave open: 50 positions to 12 % err by 1.23 of the bound, with
//! either filter. Without noise a sphere is best held by one patch, which misses it by 0.05 %; four patches
//! have more freedom than the readings fill.
//!
//! # References
//! Wang, Wang, *On 3D model construction by fusing heterogeneous sensor data*, CVGIP: Image Understanding
//! 1994, section 4.1.

mod tables;

pub use tables::{sphere_csv, sphere_figure};

use planish_core::Progress;
use planish_estimate::sparse::{BlockInformation, SelectedInverse};
use planish_estimate::vector3::{cross, dot, norm, tangents, unit};
use planish_estimate::{
    Dispersion, Error, Result, SmoothnessEvaluation, SmoothnessModel, SmoothnessSearch,
    maximize_restricted_likelihood,
};
use planish_spline::{
    CellCovariance, CellInformation, Hierarchy, Jet, PatchFilter, PatchFilterOptions, Shape, SmoothnessPrior,
    StateLayout, SubdivisionCriteria, Surface, SurfaceReading, SurfaceSystem, cubic, fit_function,
    leaf_weights, parameter_plane,
};
use planish_surface::fit::{Formation, Snapshot};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::{FRAC_2_PI, PI, TAU};
use std::sync::Arc;

/// Half the opening of the chart.
const HALF_OPENING: f64 = PI / 3.0;
/// Base cells along each direction: one patch.
const CELLS: usize = 4;
/// Readings are never told to be better than this share of the radius: one patch comes no nearer to a sphere.
const LEAST_SIGMA: f64 = 2e-3;
/// Orientations are never told to be better than this, in radians: one patch holds a sphere's slope no
/// better.
const LEAST_TILT: f64 = 5e-3;
/// Hold of the prior, per base cell to the fourth: features up to three cells long are left to the energy.
const HOLD: f64 = 0.01;
/// The weight of the prior is found over patches divided this often: what finer ones add to a sphere is not
/// seen.
const WEIGHT_DEPTH: u8 = 2;
/// Points along each direction of the chart at which errors are taken.
const PROBES: usize = 24;
/// Maximum position noise at which orientations of several errors are compared, in per cent.
const COMPARED_NOISE: f64 = 6.0;

/// Settings of the sphere's figures.
#[derive(Debug, Clone, PartialEq)]
pub struct SphereOptions {
    /// Seed of every reading.
    pub seed: u64,
    /// Sets of readings that are averaged.
    pub sets: usize,
    /// Readings of a set.
    pub readings: Vec<usize>,
    /// Maximum noise of positions, in per cent of the radius.
    pub noise_percent: Vec<f64>,
    /// The deepest subdivision; every depth up to it is computed.
    pub depth: u8,
    /// Maximum error of the orientations that are added in the second figure, in degrees.
    pub orientation_deg: f64,
    /// Whether curvature that varies within its own σ divides patches too, as in the paper; a sphere asks for
    /// no division else.
    pub noise_divides: bool,
    /// Maximum errors of orientations that are compared at a noise of 6 %, in degrees.
    pub compared_orientations_deg: Vec<f64>,
}

impl Default for SphereOptions {
    /// Those of the paper: 50, 100 and 150 readings, noise from 0 to 12 %, depths 0 to 3, orientations to 2°
    /// and from 0 to 5°, 20 sets.
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

/// One point of a curve: means over the sets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SphereRow {
    /// Readings of each kind.
    pub readings: usize,
    /// Maximum noise of positions, in per cent of the radius.
    pub noise_percent: f64,
    /// Maximum error of orientations in degrees; none where there were positions only.
    pub orientation_deg: Option<f64>,
    /// How often patches could be divided at most.
    pub depth: u8,
    /// Leaf patches at the end.
    pub leaf_patches: f64,
    /// Mean error of the patch filter, in per cent of the radius.
    pub patch_percent: f64,
    /// Mean error of the global filter, in per cent of the radius.
    pub global_percent: f64,
    /// What the global posterior lets expect, in per cent of the radius.
    pub bound_percent: f64,
}

/// The columns of the CSV.
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
        let bad = |what: &str| Err(Error::input(format!("the sphere's figures need {what}")));
        if self.sets == 0 {
            return bad("at least one set of readings");
        }
        if self.readings.is_empty() || self.readings.iter().any(|&n| n < 20) {
            return bad("at least 20 readings in a set: fewer do not determine the weight of the prior");
        }
        let range = |x: &[f64], most: f64| x.iter().all(|x| (0.0..=most).contains(x));
        if self.noise_percent.is_empty() || !range(&self.noise_percent, 50.0) {
            return bad("noise from 0 to 50 % of the radius");
        }
        if !range(&self.compared_orientations_deg, 30.0) || !range(&[self.orientation_deg], 30.0) {
            return bad("orientation errors from 0 to 30 degrees");
        }
        if self.depth > 4 {
            return bad("a depth of 4 or less");
        }
        Ok(())
    }
}

/// Simulates all sets and averages them: for each number of readings, noise, orientation error and depth one
/// row.
///
/// The same options give the same numbers at any number of threads.
///
/// # Errors
/// `Input` for options out of range; `Interrupted`.
pub fn sphere(options: &SphereOptions, progress: &dyn Progress) -> Result<Vec<SphereRow>> {
    options.validate()?;
    let setting = Setting::new(options.depth, options.noise_divides)?;
    let mut rows = Vec::new();
    let total = (options.readings.len() * options.noise_percent.len()) as f64;
    for &readings in &options.readings {
        for (k, &noise) in options.noise_percent.iter().enumerate() {
            let begun = rows.len();
            let mut tilts = vec![options.orientation_deg];
            if noise == COMPARED_NOISE {
                tilts.extend(&options.compared_orientations_deg);
                tilts.sort_by(f64::total_cmp);
                tilts.dedup();
            }
            let sets: Vec<Vec<SphereRow>> = (0..options.sets as u64)
                .into_par_iter()
                .map(|set| {
                    // The same places and signs of errors at every noise: curves differ by what is varied
                    // alone.
                    let seed =
                        options.seed.wrapping_mul(1_000_003).wrapping_add(set * 4099 + readings as u64);
                    setting.one_set(seed, readings, noise, &tilts, options.depth)
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

fn average(sets: &[Vec<SphereRow>]) -> Vec<SphereRow> {
    let mut mean = sets[0].clone();
    let share = 1.0 / sets.len() as f64;
    for (k, row) in mean.iter_mut().enumerate() {
        let of = |value: &dyn Fn(&SphereRow) -> f64| share * sets.iter().map(|s| value(&s[k])).sum::<f64>();
        row.leaf_patches = of(&|r| r.leaf_patches);
        row.patch_percent = of(&|r| r.patch_percent);
        row.global_percent = of(&|r| r.global_percent);
        row.bound_percent = of(&|r| r.bound_percent);
    }
    mean
}

/// What all sets have in common. The radius is 1.
struct Setting {
    cylinder: Surface,
    metric: Surface,
    /// Over the space in which the weight of the prior is found.
    system: SurfaceSystem,
    noise_divides: bool,
}

/// The direction, that is the point of the unit sphere, at base parameters.
fn on_sphere(u: f64, v: f64) -> [f64; 3] {
    let angle = |x: f64| (2.0 * x / CELLS as f64 - 1.0) * HALF_OPENING;
    unit([angle(u).tan(), angle(v).tan(), 1.0]).unwrap_or([0.0, 0.0, 1.0])
}

/// Places drawn evenly over the parameters, and readings of the sphere there whose distances err by up to so
/// many per cent.
fn measured(
    random: &mut ChaCha8Rng,
    count: usize,
    noise_percent: f64,
) -> (Vec<[f64; 2]>, Vec<SurfaceReading>) {
    let sigma = (noise_percent / 100.0 / 3.0_f64.sqrt()).max(LEAST_SIGMA);
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

/// How the patch filter forms the sphere from the cylinder that it starts with: the first set of the most
/// readings, at the middle one of the noises, divided to the full depth. The first snapshot knows no reading.
///
/// # Errors
/// As for [`sphere`].
pub fn sphere_forming(options: &SphereOptions, frames: usize) -> Result<Formation> {
    options.validate()?;
    let count = options.readings.iter().copied().max().unwrap_or(0);
    let noise = options.noise_percent[options.noise_percent.len() / 2];
    let setting = Setting::new(options.depth, options.noise_divides)?;
    let (_, positions) = measured(&mut ChaCha8Rng::seed_from_u64(options.seed), count, noise);
    let prior = SmoothnessPrior { weight: setting.weight(&positions)?, hold: HOLD };
    let places = (positions.iter())
        .filter_map(|reading| match reading {
            SurfaceReading::Position { point, .. } => Some(*point),
            _ => None,
        })
        .collect();
    let mut forming = Formation { places, snapshots: Vec::new() };
    let every = count.div_ceil(frames.saturating_sub(1).max(1)).max(1);
    let mut taken = 0;
    let filter = setting.filtered(&positions, prior, options.depth, |filter| {
        if taken % every == 0 && taken < count {
            forming.snapshots.push(Snapshot::of_patches(taken, filter.clone())?);
        }
        taken += 1;
        Ok(())
    })?;
    forming.snapshots.push(Snapshot::of_patches(count, filter)?);
    Ok(forming)
}

impl Setting {
    fn new(depth: u8, noise_divides: bool) -> Result<Self> {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [CELLS; 2])?);
        let cylinder = fit_function(&space, |u, v| {
            let [a, b] = [u, v].map(|x| (2.0 * x / CELLS as f64 - 1.0) * HALF_OPENING);
            [a.sin(), b, a.cos()]
        })?;
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

    fn one_set(
        &self,
        seed: u64,
        count: usize,
        noise_percent: f64,
        tilts_deg: &[f64],
        depth: u8,
    ) -> Result<Vec<SphereRow>> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (places, positions) = measured(&mut random, count, noise_percent);
        let turns: Vec<[f64; 2]> =
            places.iter().map(|_| [random.random::<f64>(), TAU * random.random::<f64>()]).collect();
        let prior = SmoothnessPrior { weight: self.weight(&positions)?, hold: HOLD };
        let mut rows = Vec::new();
        for depth in 0..=depth {
            let filter = self.filtered(&positions, prior, depth, |_| Ok(()))?;
            let space = Arc::clone(filter.space());
            let leaf_patches = filter.patches().len() as f64;
            let global = Global::new(self, &space, prior, &positions)?;
            let by_position = global.solve()?;
            let mut row = |tilt: Option<f64>, patch: &Surface, global: &Solved| {
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
            let full = filter.with_full_layout()?;
            for &tilt in tilts_deg {
                let normals: Vec<SurfaceReading> = places
                    .iter()
                    .zip(&turns)
                    .map(|(&[u, v], &[share, turn])| tilted([u, v], tilt.to_radians(), share, turn))
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

    /// The patch filter, fed in parts, divided between them.
    /// `watch` sees it before the first reading and after each.
    fn filtered(
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

    /// The weight that restricted likelihood gives the prior, which all depths share.
    fn weight(&self, positions: &[SurfaceReading]) -> Result<f64> {
        let unit = SmoothnessPrior { weight: 1.0, hold: HOLD }.information(&self.system, &self.metric)?;
        let space = self.system.space();
        // Departures from the cylinder: one matrix, three right-hand sides.
        let mut data = BlockInformation::zeros(Arc::clone(self.system.pattern()), 1, 3)?;
        let mut squares = 0.0;
        for reading in positions {
            let SurfaceReading::Position { parameters: [u, v], point, variance } = *reading else {
                continue;
            };
            let (leaf, [s, t]) = space.locate(u, v);
            let (nodes, weights) = space.extraction(leaf);
            let at = self.cylinder.point(u, v);
            let departure = [0, 1, 2].map(|d| point[d] - at[d]);
            squares += departure.iter().map(|x| x * x).sum::<f64>() / variance;
            let c = leaf_weights(s, t);
            let row: Vec<f64> = weights.iter().map(|w| w.iter().zip(&c).map(|(a, b)| a * b).sum()).collect();
            let matrix: Vec<f64> =
                row.iter().flat_map(|a| row.iter().map(move |b| a * b / variance)).collect();
            let vector: Vec<f64> = row.iter().flat_map(|a| departure.map(|x| a * x / variance)).collect();
            data.add_element(nodes, &matrix, &vector)?;
        }
        let nodes = space.node_count();
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
                residual: squares + data.quadratic_form(&x)? - 2.0 * fitted,
                roughness: unit.quadratic_form(&x)?,
                trace: None,
            })
        };
        let search = SmoothnessSearch { bounds: (1e-2, 1e8), ..SmoothnessSearch::from_start(100.0) };
        Ok(maximize_restricted_likelihood(&model, &search, evaluate)?.weight)
    }
}

/// The normal at a place, tilted by a share of the largest tilt.
fn tilted([u, v]: [f64; 2], largest: f64, share: f64, turn: f64) -> SurfaceReading {
    let n = on_sphere(u, v);
    let (t1, t2) = tangents(n);
    let (s, c) = (largest * share).sin_cos();
    let (sin, cos) = turn.sin_cos();
    SurfaceReading::Normal {
        parameters: [u, v],
        normal: [0, 1, 2].map(|d| c * n[d] + s * (cos * t1[d] + sin * t2[d])),
        // The square of an angle uniform up to θ is θ²/3 on average, half of it along either tangent.
        sigma_rad: (largest / 6.0_f64.sqrt()).max(LEAST_TILT),
    }
}

fn readings_by_leaf<'a>(
    space: &Hierarchy,
    readings: &'a [SurfaceReading],
) -> Vec<Vec<([f64; 2], &'a SurfaceReading)>> {
    let mut by_leaf = vec![Vec::new(); space.leaves().len()];
    for reading in readings {
        let [u, v] = reading.parameters();
        let (leaf, local) = space.locate(u, v);
        by_leaf[leaf].push((local, reading));
    }
    by_leaf
}

/// Points of the chart with their share of the sphere's area.
fn probes() -> impl Iterator<Item = ([f64; 2], f64)> {
    let place = |k: usize| CELLS as f64 * (k as f64 + 0.5) / PROBES as f64;
    (0..PROBES * PROBES).map(move |k| {
        let [u, v] = [place(k % PROBES), place(k / PROBES)];
        let h = 1e-4;
        let [a, b] = [[h, 0.0], [0.0, h]].map(|[du, dv]| {
            let (p, q) = (on_sphere(u + du, v + dv), on_sphere(u - du, v - dv));
            [0, 1, 2].map(|d| p[d] - q[d])
        });
        ([u, v], norm(cross(a, b)))
    })
}

/// Mean distance from the sphere, over its area, in per cent of the radius.
fn mean_error(surface: &Surface) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for ([u, v], share) in probes() {
        sum += share * (norm(surface.point(u, v)) - 1.0).abs();
        area += share;
    }
    100.0 * sum / area
}

/// The global filter in information form.
#[derive(Clone)]
struct Global {
    system: Arc<SurfaceSystem>,
    information: BlockInformation,
}

struct Solved {
    surface: Surface,
    bound_percent: f64,
}

impl Global {
    fn new(
        setting: &Setting,
        space: &Arc<Hierarchy>,
        prior: SmoothnessPrior,
        positions: &[SurfaceReading],
    ) -> Result<Self> {
        let system = SurfaceSystem::new(space)?;
        let by_leaf = readings_by_leaf(space, positions);
        let mut information = system.accumulate(|leaf, cell| {
            for ([s, t], reading) in &by_leaf[leaf] {
                if let SurfaceReading::Position { point, variance, .. } = reading {
                    let w = 1.0 / variance;
                    cell.add_vector(&leaf_weights(*s, *t), *point, &[w, 0.0, 0.0, w, 0.0, w]);
                }
            }
            !by_leaf[leaf].is_empty()
        })?;
        let scalar = prior.information(&system, &setting.metric)?;
        let mut wide = scalar.expanded(3)?;
        let start: Vec<f64> = setting.cylinder.refined(Arc::clone(space))?.vertices().as_flattened().to_vec();
        let mut vector = vec![0.0; start.len()];
        wide.multiply(&start, &mut vector)?;
        wide.vector_mut().copy_from_slice(&vector);
        information.add_scaled(&wide, 1.0)?;
        Ok(Self { system: Arc::new(system), information })
    }

    /// Adds orientations, `n · t1 = n · t2 = 0`, linearised at the surface that positions gave.
    fn add_normals(&mut self, normals: &[SurfaceReading], at: &Surface) -> Result<()> {
        let by_leaf = readings_by_leaf(self.system.space(), normals);
        let added = self.system.accumulate(|leaf, cell: &mut CellInformation| {
            for (local, reading) in &by_leaf[leaf] {
                let SurfaceReading::Normal { normal, sigma_rad, .. } = reading else {
                    continue;
                };
                let jet = at.leaf_jet(leaf, local[0], local[1]);
                let Some(own) = jet.normal() else { continue };
                let facing = dot(*normal, own);
                for (weights, tangent) in tangent_weights(at, leaf, *local, &jet) {
                    // The gradient of n · t for a unit tangent t, as the patch filter has it.
                    cell.add_scalar(
                        &weights,
                        own.map(|x| facing * x),
                        -dot(*normal, tangent),
                        1.0 / (sigma_rad * sigma_rad),
                    );
                }
            }
            !by_leaf[leaf].is_empty()
        })?;
        self.information.add_scaled(&added, 1.0)
    }

    fn solve(&self) -> Result<Solved> {
        let factor = self.system.factorize(&self.information)?;
        let mut x = self.information.vector().to_vec();
        factor.solve_in_place(&mut x)?;
        let surface = self.system.surface(&x)?;
        let inverse = SelectedInverse::new(&factor);
        let space = self.system.space();
        let cells: Vec<Option<CellCovariance>> = (0..space.leaves().len())
            .map(|leaf| {
                let covariance = inverse.dense(space.extraction(leaf).0)?;
                Some(CellCovariance::new(space, leaf, &covariance))
            })
            .collect();
        let (mut sum, mut area) = (0.0, 0.0);
        for ([u, v], share) in probes() {
            let (leaf, [s, t]) = space.locate(u, v);
            if let Some(cell) = &cells[leaf] {
                sum += share * cell.variance_along(&leaf_weights(s, t), on_sphere(u, v)).max(0.0).sqrt();
                area += share;
            }
        }
        Ok(Solved { surface, bound_percent: 100.0 * FRAC_2_PI.sqrt() * sum / area })
    }
}

/// Two orthonormal tangents, and the weights of the derivatives along them.
fn tangent_weights(at: &Surface, leaf: usize, [s, t]: [f64; 2], jet: &Jet) -> [([f64; 16], [f64; 3]); 2] {
    let side = at.space().leaves()[leaf].side();
    let (bu, bv) = (cubic(s), cubic(t));
    let l = norm(jet.du);
    let m = dot(jet.du, jet.dv) / l;
    let q = norm([0, 1, 2].map(|d| jet.dv[d] - m / l * jet.du[d]));
    [[1.0 / l, 0.0], [-m / (l * q), 1.0 / q]].map(|[a, b]| {
        let weights = std::array::from_fn(|k| {
            (a * bu[1][k % 4] * bv[0][k / 4] + b * bu[0][k % 4] * bv[1][k / 4]) / side
        });
        (weights, [0, 1, 2].map(|d| a * jet.du[d] + b * jet.dv[d]))
    })
}

#[cfg(test)]
mod tests;
