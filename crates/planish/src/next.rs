//! Chooses the next points to measure, or the next poses of a sensor, that reduce σ of a model most.
//!
//! Input: a model and the σ of a sensor, or a sensor with its field of view. Output: points on the surface
//! ([`next_points`]) or poses around it ([`next_views`]), with σ before and after. Each is the best choice
//! given those before it. No fit is needed: the effect of a reading on the covariance does not depend on its
//! value.
//!
//! A reading along the normal with variance `r` and row `a` changes the covariance of any two rows `p`, `q`
//! by `−(pᵀΣa)(aᵀΣq)/(aᵀΣa + r)` (Kalman 1960). The columns `Σa` of all candidates are computed once and then
//! updated after each choice. A step therefore only compares candidates over all places of the region.
//!
//! Shape smaller than the cells is a part of the model's σ, but readings do not reduce it. It is excluded
//! here, and the report states its size ([`UnmeasurableSigma`]).
//!
//! Not guaranteed: the best set of points. For the mean variance of independent places, a greedy choice
//! reaches at least 63 % of the best gain (Nemhauser, Wolsey and Fisher 1978), and usually far more.

use crate::job::Job;
use crate::output::unsupported_extension;
use crate::report::{ReportOutput, with_page};
use page::next_page;
use planish_core::finding::with_warnings;
use planish_core::{DVec3, Finding, Length, Progress, Unit};
use planish_estimate::sparse::{BlockInformation, CholeskyFactor};
use planish_estimate::{Error, Result};
use planish_exchange::ply::{Column, MeshColumns, write_points};
use planish_exchange::{extension, write_atomically};
use planish_spline::{SurfaceSystem, leaf_weights};
use planish_surface::model::{Posterior, SurfaceModel};
use planish_surface::saved::load;
use rayon::prelude::*;
use serde::Serialize;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

mod directions;
mod findings;
mod limits;
pub(crate) mod page;
mod random;
mod sight;
mod view_files;
mod views;

pub use limits::{MAX_POINTS, MAX_RANDOM_SETS, MAX_VIEWS};
pub use random::RandomDraws;
pub use view_files::{NextViewsJob, NextViewsJobReport};
pub use views::{NextView, UnseenPlace, ViewsReport, next_views};

use directions::directions;
use limits::{check_counts, check_view_count};
use random::{InitialState, at_random};

/// Memory for the covariance columns of all candidates, in numbers (48 MB). A column has one number per
/// unknown, so large models get fewer candidates.
const COLUMN_NUMBERS: usize = 6_000_000;
/// Bounds of the number of candidates. With fewer than the first, the best place may be missed. Every step
/// compares each candidate over all places, so more than the second cost time only.
const MAX_CANDIDATES: [usize; 2] = [600, 4000];
/// Right-hand sides that are solved together: the factor is then read from memory once for all of them.
const COLUMNS_PER_SOLVE: usize = 16;
/// Power of the variances whose mean stands for the largest. A high power is close to the maximum. A finite
/// one still rewards progress at other places that are nearly as bad (`docs/decisions/0015`).
const POWER_OF_WORST: i32 = 6;

/// The quantity to minimise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Objective {
    /// The largest σ of the region.
    #[default]
    Worst,
    /// The mean variance of the region, by area.
    Mean,
}

/// Settings.
#[derive(Debug, Clone, PartialEq)]
pub struct NextOptions {
    /// Maximum number of points (up to [`MAX_POINTS`]) or poses (up to [`MAX_VIEWS`]).
    pub count: usize,
    /// σ of the readings along the normal, in the model's unit; that of the model's best sensor if none is
    /// given.
    pub sigma: Option<f64>,
    /// Stop where the largest σ of the region is at most this.
    pub goal: Option<f64>,
    /// Two corners of a box that limits the region; the whole surface if none is given.
    pub region: Option<[DVec3; 2]>,
    /// Whether the region is limited to parts that were measured already.
    pub measured_only: bool,
    /// The quantity to minimise.
    pub objective: Objective,
    /// Number of random sets of points that are evaluated for comparison (up to [`MAX_RANDOM_SETS`]).
    pub against_random: usize,
    /// Seed of these draws.
    pub seed: u64,
}

impl Default for NextOptions {
    fn default() -> Self {
        Self {
            count: 10,
            sigma: None,
            goal: None,
            region: None,
            measured_only: false,
            objective: Objective::Worst,
            against_random: 0,
            seed: 0,
        }
    }
}

/// A point to measure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NextPoint {
    /// Position on the surface.
    pub position: DVec3,
    /// The surface's unit normal there.
    pub normal: DVec3,
    /// σ of the surface along it, once all points before this one are measured.
    pub sigma_before: f64,
    /// σ after this point is measured as well.
    pub sigma_after: f64,
    /// Largest σ of the region after this point is measured.
    pub worst_sigma_after: f64,
}

/// A figure before any point is measured and after all are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Change {
    /// Before.
    pub before: f64,
    /// After.
    pub after: f64,
}

/// Points to measure next, with σ before and after.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextReport {
    /// The points, best first.
    pub points: Vec<NextPoint>,
    /// The largest σ of the region.
    pub worst_sigma: Change,
    /// The root of the mean variance of the region, by area.
    pub mean_sigma: Change,
    /// σ of the readings.
    pub sigma: f64,
    /// Whether the goal is reached; none if no goal was given.
    pub reached_goal: Option<bool>,
    /// σ of unresolved shape, which all other figures exclude. Absent if there is none.
    #[serde(rename = "shape_left", skip_serializing_if = "Option::is_none")]
    pub unresolved_shape: Option<UnmeasurableSigma>,
    /// Result of the same number of points drawn at random, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub random: Option<RandomDraws>,
}

/// σ of unresolved shape, which is smaller than the model's cells. Smaller cells reduce it, readings do not.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnmeasurableSigma {
    /// The largest in the region, as a standard deviation along the normal.
    pub largest: f64,
    /// Share of the region's area with unresolved shape.
    pub area_fraction: f64,
    /// The largest σ of the region with it, once all is measured: `√(variance + shape left)` of the worst
    /// place.
    pub worst_sigma_after: f64,
}

impl UnmeasurableSigma {
    /// Summary over the places of the region, with their variances after all points are measured.
    fn new(model: &SurfaceModel, places: &[Place], variances: &[f64]) -> Option<Self> {
        let square = |place: &Place| model.excess_variance.get(place.leaf).copied().unwrap_or(0.0);
        let largest = places.iter().map(square).fold(0.0, f64::max);
        let area = |is_counted: &dyn Fn(&&Place) -> bool| {
            places.iter().filter(is_counted).map(|p| p.area).sum::<f64>()
        };
        (largest > 0.0).then(|| Self {
            largest: largest.sqrt(),
            area_fraction: area(&|place| square(place) > 0.0) / area(&|_| true),
            worst_sigma_after: (places.iter().zip(variances))
                .map(|(place, variance)| variance + square(place))
                .fold(0.0, f64::max)
                .sqrt(),
        })
    }
}

/// A place of the region: the middle of a leaf.
struct Place {
    leaf: usize,
    position: DVec3,
    normal: DVec3,
    area: f64,
    /// The row of a reading along the normal: unknowns and weights.
    row: Vec<(u32, f64)>,
}

impl Place {
    /// The row applied to a column over the unknowns.
    fn dot(&self, column: &[f64]) -> f64 {
        self.row.iter().map(|&(node, w)| w * column[node as usize]).sum()
    }
}

/// A candidate: its place, and the covariance of its reading with every node.
struct Candidate {
    place: usize,
    column: Vec<f64>,
}

/// Chooses points one after the other.
///
/// # Errors
/// `Input` for options out of range and regions without surface; `Unsupported` for models with independently
/// measured coordinates; `Undetermined` if prior and data do not determine a vertex; `Interrupted` on
/// request.
pub fn next_points(
    model: &SurfaceModel,
    options: &NextOptions,
    progress: &dyn Progress,
) -> Result<NextReport> {
    check_counts(options)?;
    let sigma = options.sigma.or_else(|| best_sigma(model)).ok_or_else(|| {
        Error::input(
            "expected σ of the planned readings, found none: the model has no sensor that measures \
             positions",
        )
    })?;
    check_lengths(&[("σ", Some(sigma)), ("goal", options.goal)])?;
    let Prepared { system, directions, information, places } = Prepared::new(model, options, progress)?;
    // The factor is computed once. All columns of the covariance follow from it by back-substitution.
    let factor = system.factorize_scalar(&information)?;
    progress.check("covariance", 0.15)?;
    // Variances before the first reading. They are updated after each choice and never recomputed, because a
    // new factorisation per point would dominate the cost.
    let unknowns = directions.len();
    let mut variances = variances_of(model, &factor, directions, &places)?;
    let reading = sigma * sigma;
    // Random sets start from the same variances as the choice, so they are drawn before these change.
    let random = match options.against_random {
        0 => None,
        draws => {
            let before =
                InitialState { factor: &factor, unknowns, places: &places, variances: &variances, reading };
            Some(at_random(before, options, draws, progress)?)
        }
    };
    let mut candidates = columns(
        &factor,
        unknowns,
        &places,
        chosen(&places, &variances, (COLUMN_NUMBERS / unknowns).clamp(MAX_CANDIDATES[0], MAX_CANDIDATES[1])),
        progress,
    )?;
    let before = figures(&places, &variances);
    let mut points = Vec::new();
    let reached = |variances: &[f64]| options.goal.map(|goal| figures(&places, variances).0 <= goal);
    while points.len() < options.count && reached(&variances) != Some(true) {
        progress.check("choosing", 0.5 + 0.5 * points.len() as f64 / options.count.max(1) as f64)?;
        progress.items(points.len(), "points");
        // The cost that each candidate would leave. Each one sums over the places in their order, so the
        // result does not depend on the number of threads. Of equal candidates, the first is chosen.
        let left: Vec<f64> = candidates
            .par_iter()
            .map(|candidate| {
                let own = places[candidate.place].dot(&candidate.column) + reading;
                (places.iter().zip(&variances))
                    .map(|(place, variance)| {
                        let after = variance - place.dot(&candidate.column).powi(2) / own;
                        place.area * cost(options.objective, after)
                    })
                    .sum()
            })
            .collect();
        let Some(best) = (0..left.len()).min_by(|&a, &b| left[a].total_cmp(&left[b])) else {
            break;
        };
        let (at, column) = (candidates[best].place, candidates[best].column.clone());
        let own = places[at].dot(&column) + reading;
        for (place, variance) in places.iter().zip(&mut variances) {
            // Rounding can leave a small negative variance at a place that many points determine.
            *variance = (*variance - place.dot(&column).powi(2) / own).max(0.0);
        }
        candidates.par_iter_mut().for_each(|candidate| {
            // The columns of the other candidates change, too: the next choice must include the information
            // of this reading.
            let share = places[candidate.place].dot(&column) / own;
            for (c, x) in candidate.column.iter_mut().zip(&column) {
                *c -= share * x;
            }
        });
        points.push(NextPoint {
            position: places[at].position,
            normal: places[at].normal,
            sigma_before: (own - reading).max(0.0).sqrt(),
            sigma_after: variances[at].sqrt(),
            worst_sigma_after: figures(&places, &variances).0,
        });
    }
    let after = figures(&places, &variances);
    progress.advance("done", 1.0);
    Ok(NextReport {
        points,
        worst_sigma: Change { before: before.0, after: after.0 },
        mean_sigma: Change { before: before.1, after: after.1 },
        sigma,
        reached_goal: reached(&variances),
        unresolved_shape: UnmeasurableSigma::new(model, &places, &variances),
        random,
    })
}

/// Refuses the first length that is stated and not positive.
fn check_lengths(lengths: &[(&str, Option<f64>)]) -> Result<()> {
    // Outside this range, the square underflows to zero or overflows to infinity.
    let wrong = |value: &Option<f64>| value.is_some_and(|v| !(1e-100..1e100).contains(&v));
    match lengths.iter().find(|(_, value)| wrong(value)) {
        Some((name, value)) => Err(Error::input(format!(
            "expected a {name} > 0, between 1e-100 and 1e100, found {}",
            value.unwrap_or(f64::NAN)
        ))),
        None => Ok(()),
    }
}

/// The information of a model, with the directions in which vertices move, and the places of the region.
struct Prepared {
    system: SurfaceSystem,
    directions: Vec<DVec3>,
    /// Information of data and prior, with one unknown for each direction.
    information: BlockInformation,
    places: Vec<Place>,
}

impl Prepared {
    fn new(model: &SurfaceModel, options: &NextOptions, progress: &dyn Progress) -> Result<Self> {
        progress.check("equations", 0.05)?;
        let system = SurfaceSystem::new(model.surface.space())?;
        // One unknown for most vertices: a reading measures the surface along its normal only, and three
        // unknowns would make the factorisation far more expensive (`docs/decisions/0002`).
        let directions = directions(model)?;
        let information = model.information_along(&system, &directions)?;
        let places = places(model, &directions, options);
        // Without this check, the figures of an empty region would be 0/0 and the goal would seem reached.
        if places.is_empty() {
            return Err(Error::input("expected a region that contains a part of the surface, found none"));
        }
        Ok(Self { system, directions, information, places })
    }
}

/// The variance along the normal of every place.
fn variances_of(
    model: &SurfaceModel,
    factor: &CholeskyFactor,
    directions: Vec<DVec3>,
    places: &[Place],
) -> Result<Vec<f64>> {
    let posterior = Posterior::new(&model.surface, Arc::new(model.covariance_along(factor, directions)?));
    (places.par_iter())
        .with_min_len(64)
        .map(|place| {
            let cell = posterior.leaf(place.leaf)?;
            // Rounding can make the variance of a well measured place slightly negative.
            Ok(cell.variance_along(&leaf_weights(0.5, 0.5), place.normal).max(0.0))
        })
        .collect()
}

/// The job `planish next`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NextJob {
    /// A saved model.
    pub model: PathBuf,
    /// Maximum number of points, and the other options. Lengths are given separately.
    pub options: NextOptions,
    /// σ of the readings.
    pub sigma: Option<Length>,
    /// Stop when the largest σ is at most this.
    pub goal: Option<Length>,
    /// Files of the points: `.csv` or `.ply`.
    pub outputs: Vec<PathBuf>,
    /// A page that shows the points on the model.
    pub report: Option<ReportOutput>,
}

/// Result of a [`NextJob`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextJobReport {
    /// The points and figures.
    #[serde(flatten)]
    pub next: NextReport,
    /// The model's unit.
    #[serde(skip)]
    pub unit: Unit,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}

impl Job for NextJob {
    type Report = NextJobReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.model.clone()])
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        if let Some(path) = self.outputs.iter().find(|p| !matches!(extension(p).as_str(), "csv" | "ply")) {
            return Err(unsupported_extension(path, ".csv or .ply (points with normals and σ)"));
        }
        with_page(self.outputs.clone(), self.report.as_ref())
    }

    fn execute(&self, progress: &dyn Progress) -> Result<NextJobReport> {
        choose_points(self, progress)
    }
}

/// Reads a saved model, chooses points, and writes them.
fn choose_points(job: &NextJob, progress: &dyn Progress) -> Result<NextJobReport> {
    check_counts(&job.options)?;
    progress.check("reading", 0.0)?;
    let model = load(&job.model)?;
    let options = NextOptions {
        sigma: job.sigma.map(|length| length.in_unit(model.unit)),
        goal: job.goal.map(|length| length.in_unit(model.unit)),
        ..job.options.clone()
    };
    let next = next_points(&model, &options, progress).map_err(|e| e.in_context(job.model.display()))?;
    // Findings are derived before the files are written, so the page and the caller get the same ones.
    let findings = findings::judge_points(&next, model.unit);
    for path in &job.outputs {
        write_points_of(path, &next.points, model.unit)?;
    }
    if let Some(page) = &job.report {
        let made = next_page(&model, &next, findings.clone(), &job.model)?;
        page.write(made, &[(job.model.clone(), "the model".to_owned())])?;
    }
    Ok(NextJobReport { next, unit: model.unit, findings })
}

fn write_points_of(path: &Path, points: &[NextPoint], unit: Unit) -> Result<()> {
    if extension(path) == "csv" {
        return write_atomically(path, |writer| {
            writeln!(writer, "x,y,z,nx,ny,nz,sigma_before,sigma_after")?;
            for p in points {
                let DVec3 { x, y, z } = p.position;
                let [nx, ny, nz] = p.normal.to_array();
                writeln!(writer, "{x},{y},{z},{nx},{ny},{nz},{},{}", p.sigma_before, p.sigma_after)?;
            }
            Ok(())
        });
    }
    let column = |value: fn(&NextPoint) -> f64| points.iter().map(value).collect::<Vec<f64>>();
    let (before, after) = (column(|p| p.sigma_before), column(|p| p.sigma_after));
    write_points(
        path,
        &MeshColumns {
            points: &points.iter().map(|p| p.position).collect::<Vec<_>>(),
            normals: Some(&points.iter().map(|p| p.normal).collect::<Vec<_>>()),
            columns: vec![("sigma_before", Column::F64(&before)), ("sigma_after", Column::F64(&after))],
            unit: Some(unit),
            ..MeshColumns::default()
        },
    )
}

fn cost(objective: Objective, variance: f64) -> f64 {
    match objective {
        Objective::Worst => variance.max(0.0).powi(POWER_OF_WORST),
        Objective::Mean => variance,
    }
}

/// Smallest σ of the sensors that measured positions.
fn best_sigma(model: &SurfaceModel) -> Option<f64> {
    let used = model.sensors.iter().filter(|s| s.quantity == "position").map(|s| {
        // The σ that the fit used: a stated σ that its residuals contradict would promise too much.
        if s.sigma_used_is_estimated {
            s.sigma_estimated
        } else {
            s.sigma_stated.unwrap_or(s.sigma_estimated)
        }
    });
    used.filter(|sigma| *sigma > 0.0).min_by(f64::total_cmp)
}

/// The leaves whose middles are places of the region.
fn region_leaves(model: &SurfaceModel, options: &NextOptions) -> Vec<usize> {
    (0..model.surface.space().leaves().len())
        .filter(|&leaf| !options.measured_only || model.observed.get(leaf).is_some_and(|o| o.is_measured()))
        .filter(|&leaf| {
            let p = model.surface.leaf_point(leaf, 0.5, 0.5);
            (options.region).is_none_or(|[low, high]| (0..3).all(|d| (low[d]..=high[d]).contains(&p[d])))
        })
        // Degenerate cells have no normal, so a reading along it has no row.
        .filter(|&leaf| model.surface.leaf_jet(leaf, 0.5, 0.5).normal().is_some())
        .collect()
}

fn places(model: &SurfaceModel, directions: &[DVec3], options: &NextOptions) -> Vec<Place> {
    let space = model.surface.space();
    let weights = leaf_weights(0.5, 0.5);
    (region_leaves(model, options).into_iter())
        .map(|leaf| {
            let jet = model.surface.leaf_jet(leaf, 0.5, 0.5);
            let normal = jet.normal().unwrap_or(DVec3::ZERO);
            let side = space.leaves()[leaf].side();
            // The row of the reading: the weights of the nodes at the middle of the leaf, times the component
            // of each node's motion along the normal.
            let unknowns = space.unknowns(leaf).filter(|(unknown, _)| (*unknown as usize) < directions.len());
            let row = unknowns.map(|(unknown, e)| {
                let weight: f64 = e.iter().zip(&weights).map(|(e, w)| e * w).sum();
                (unknown, weight * normal.dot(directions[unknown as usize]))
            });
            Place {
                leaf,
                position: jet.point,
                normal,
                area: jet.area_element() * side * side,
                row: row.collect(),
            }
        })
        .collect()
}

/// Selects at most `limit` candidates, denser where σ is large, including the place with the largest σ.
fn chosen(places: &[Place], variances: &[f64], limit: usize) -> Vec<usize> {
    if places.len() <= limit {
        return (0..places.len()).collect();
    }
    // Systematic sampling of area × variance: one candidate for each equal share of the sum. It needs no
    // random numbers, and dense cells do not attract more candidates than their area deserves.
    let weights: Vec<f64> = places.iter().zip(variances).map(|(p, v)| p.area * v).collect();
    let step = weights.iter().sum::<f64>() / (limit - 1) as f64;
    let (mut sum, mut next_threshold) = (0.0, 0.5 * step);
    let mut found: Vec<usize> = Vec::with_capacity(limit);
    for (k, weight) in weights.iter().enumerate() {
        sum += weight;
        if sum >= next_threshold {
            found.push(k);
            next_threshold = ((sum / step).floor() + 1.0) * step;
        }
    }
    // Sampling may skip the place with the largest σ, and the objective is about just that place.
    found.extend((0..places.len()).max_by(|&a, &b| variances[a].total_cmp(&variances[b])));
    found.sort_unstable();
    found.dedup();
    found
}

fn columns(
    factor: &CholeskyFactor,
    unknowns: usize,
    places: &[Place],
    chosen: Vec<usize>,
    progress: &dyn Progress,
) -> Result<Vec<Candidate>> {
    let mut found = Vec::with_capacity(chosen.len());
    for (done, part) in chosen.chunks(COLUMNS_PER_SOLVE).enumerate() {
        progress.check("columns", 0.2 + 0.3 * (done * COLUMNS_PER_SOLVE) as f64 / chosen.len() as f64)?;
        progress.items(done * COLUMNS_PER_SOLVE, "places");
        let mut solved = vec![0.0; unknowns * part.len()];
        for (c, &place) in part.iter().enumerate() {
            for &(node, weight) in &places[place].row {
                solved[node as usize * part.len() + c] += weight;
            }
        }
        factor.solve_in_place(&mut solved)?;
        found.extend(part.iter().enumerate().map(|(c, &place)| Candidate {
            place,
            column: solved.iter().skip(c).step_by(part.len()).copied().collect(),
        }));
    }
    Ok(found)
}

/// The largest σ, and the root of the mean variance by area.
fn figures(places: &[Place], variances: &[f64]) -> (f64, f64) {
    let worst = variances.iter().copied().fold(0.0, f64::max);
    let area: f64 = places.iter().map(|p| p.area).sum();
    let mean = places.iter().zip(variances).map(|(p, v)| p.area * v).sum::<f64>() / area;
    (worst.sqrt(), mean.sqrt())
}

#[cfg(test)]
mod tests;
