//! Readings whose parameters are known: one linear problem, solved exactly.
//!
//! Comes in: scans with the columns `u` and `v` in `[0, 1]`. Goes out: a model whose vertices have a full covariance, not along normals
//! only. Readings stream through sums over cells; nothing is kept of them, and only those outside the gate are gone back to.
//!
//! A coordinate that is an affine function of `(u, v)`, like the plan of a height field, has no noise: it is reproduced and counts as
//! exact. The others share the noise of their reading.
//!
//! Not guaranteed: that readings which were given wrong parameters are found out.

use super::finish::{pose_reports, warnings};
use super::noise::{ResidualSums, kept_variance};
use super::observations::{Quantity, Rejection, hash01};
use super::smoothing::{Smoothing, Totals, reference_surface};
use super::stages::with_neighbours;
use super::{Fit, FitOptions, FitReport, FitTermination, HeldOut};
use crate::model::{NodeCovariance, Posterior, SensorReport, SurfaceModel};
use crate::progress::Progress;
use planish_estimate::sparse::{BlockInformation, SelectedInverse};
use planish_estimate::{Error, Result, TruncatedNormal, gated_scale};
use planish_exchange::{ScanSet, Unit};
use planish_mesh::BoundingBox;
use planish_sense::{Noise, Pose};
use planish_spline::{Hierarchy, PositionReading, PositionSums, Shape, Surface, SurfaceSystem, leaf_weights};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// Readings that one task looks at.
const TASK: usize = 1 << 13;
/// So many held-out readings judge any fit.
const ENOUGH_HELD_OUT: f64 = 3_000.0;
/// ResidualSums that are enough to find the scale of a sensor.
const ENOUGH_FOR_SCALE: usize = 50_000;
/// Rounds of weighing and gating, and what must change for another: shares of a variance, and of the readings.
const MOST_ROUNDS: u32 = 8;
const SETTLED_VARIANCE: f64 = 0.01;
const SETTLED_GATE: f64 = 1e-4;
/// Stated σ are believed within this factor.
const BELIEVED: f64 = 1.1;
/// Information of an exact coordinate over that of the others.
const EXACT: f64 = 1e6;
/// Fewer readings say nothing of a surface and its noise.
const LEAST_READINGS: usize = 10;

/// Readings of a set of scans and which of them are fitted.
struct Readings<'a> {
    set: &'a ScanSet,
    cells: [f64; 2],
    options: &'a FitOptions,
    /// How many there are.
    total: usize,
    /// Numbers of held-out readings of each scan, ascending.
    held_out: Vec<Vec<u32>>,
    /// Numbers of gated readings of each scan, ascending.
    gated: Vec<Vec<u32>>,
    /// For each scan, those that are held out, and those that are held out or gated.
    is_held_out: Vec<Marks>,
    is_left_out: Vec<Marks>,
    /// Whether a sensor's σ was stated.
    stated: Vec<bool>,
    /// Each sensor's 1/variance where its scans state no σ: 1 where nobody does.
    information: Vec<f64>,
    /// Whether a scan has a pose to be carried along by.
    is_moved: Vec<bool>,
}

/// One mark a reading.
struct Marks(Vec<u64>);

impl Marks {
    /// Marks on some of so many numbers.
    fn on<'n>(size: usize, numbers: impl IntoIterator<Item = &'n u32>) -> Self {
        let mut words = vec![0; size.div_ceil(64)];
        for &k in numbers {
            words[k as usize / 64] |= 1 << (k % 64);
        }
        Self(words)
    }

    #[inline(always)]
    fn has(&self, k: usize) -> bool {
        self.0[k / 64] & (1 << (k % 64)) != 0
    }
}

/// One reading in the world.
#[derive(Clone, Copy)]
struct Reading {
    at: [f64; 2],
    point: [f64; 3],
    /// 1/variance as stated; 1 where it was not.
    information: f64,
}

/// Readings of one scan, by their numbers.
#[derive(Clone, Copy)]
struct OfScan<'a> {
    parameters: &'a [[f64; 2]],
    points: &'a [[f64; 3]],
    sigma: Option<&'a [f64]>,
    /// Where none is stated with the readings.
    information: f64,
    pose: Option<&'a Pose>,
    cells: [f64; 2],
    is_left_out: &'a Marks,
    is_held_out: &'a Marks,
}

impl OfScan<'_> {
    #[inline(always)]
    fn reading(&self, k: usize) -> Reading {
        let [u, v] = self.parameters[k];
        Reading {
            at: [u * self.cells[0], v * self.cells[1]],
            point: match self.pose {
                Some(pose) => pose.apply(self.points[k]),
                None => self.points[k],
            },
            information: match self.sigma {
                Some(sigma) => 1.0 / (sigma[k] * sigma[k]),
                None => self.information,
            },
        }
    }

    /// A reading that takes part in the fit.
    #[inline(always)]
    fn fitted(&self, k: usize) -> Option<PositionReading> {
        (!self.is_left_out.has(k)).then(|| {
            let reading = self.reading(k);
            PositionReading {
                parameters: reading.at,
                position: reading.point,
                information: reading.information,
            }
        })
    }
}

impl<'a> Readings<'a> {
    fn new(set: &'a ScanSet, cells: [usize; 2], options: &'a FitOptions) -> Result<Self> {
        let total: usize = set.scans.iter().map(|posed| posed.scan.points.len()).sum();
        if total < LEAST_READINGS {
            return Err(Error::undetermined(format!(
                "{total} readings in all: at least {LEAST_READINGS} are needed"
            )));
        }
        let mut stated = vec![true; set.sensors.len()];
        for posed in &set.scans {
            let name = &posed.scan.name;
            if posed.scan.parameters.is_none() {
                return Err(Error::input(format!(
                    "{name}: needed the columns u v (the parameters of each reading, in [0, 1]), found none"
                )));
            }
            if posed.scan.covariance.is_some() {
                return Err(Error::unsupported(format!(
                    "{name}: needed one σ a reading (the column sigma) where parameters are known, found covariances cxx … czz"
                )));
            }
            if posed.scan.sigma.is_none() {
                match set.sensors[posed.sensor].noise {
                    None => stated[posed.sensor] = false,
                    Some(Noise::Isotropic { .. }) => {}
                    Some(Noise::Ray { .. }) => {
                        return Err(Error::unsupported(format!(
                            "{name}: needed one σ for all directions where parameters are known, found sigma_along and sigma_across of the sensor \"{}\"",
                            set.sensors[posed.sensor].name
                        )));
                    }
                }
            }
        }
        for posed in &set.scans {
            let inside = |p: &[f64; 2]| (0.0..=1.0).contains(&p[0]) & (0.0..=1.0).contains(&p[1]);
            if let Some(all) = &posed.scan.parameters
                && !all
                    .par_chunks(TASK)
                    .all(|part| part.iter().fold(true, |good, p| good & inside(p)))
                && let Some(k) = all.iter().position(|p| !inside(p))
            {
                return Err(Error::input(format!(
                    "{}: needed u and v in [0, 1], found ({}, {}) (point {k})",
                    posed.scan.name, all[k][0], all[k][1]
                )));
            }
        }
        let held_out = held_out(set, options, total);
        let marks = || -> Vec<Marks> {
            (set.scans.iter().zip(&held_out))
                .map(|(posed, numbers)| Marks::on(posed.scan.points.len(), numbers))
                .collect()
        };
        Ok(Self {
            set,
            cells: cells.map(|n| n as f64),
            options,
            total,
            is_held_out: marks(),
            is_left_out: marks(),
            held_out,
            gated: vec![Vec::new(); set.scans.len()],
            stated,
            information: (set.sensors.iter())
                .map(|sensor| match sensor.noise {
                    Some(Noise::Isotropic { sigma }) => 1.0 / (sigma * sigma),
                    _ => 1.0,
                })
                .collect(),
            is_moved: (set.scans.iter())
                .map(|posed| posed.scan.world_from_scanner != Pose::identity())
                .collect(),
        })
    }

    /// The readings of scan `s`.
    fn of_scan(&self, s: usize) -> OfScan<'_> {
        let posed = &self.set.scans[s];
        OfScan {
            parameters: posed.scan.parameters.as_deref().unwrap_or(&[]),
            points: &posed.scan.points,
            sigma: posed.scan.sigma.as_deref(),
            information: self.information[posed.sensor],
            pose: self.is_moved[s].then_some(&posed.scan.world_from_scanner),
            cells: self.cells,
            is_left_out: &self.is_left_out[s],
            is_held_out: &self.is_held_out[s],
        }
    }

    /// Leaves out other readings by the gate.
    fn set_gated(&mut self, gated: Vec<Vec<u32>>) {
        self.is_left_out = (self.set.scans.iter().zip(&gated).zip(&self.held_out))
            .map(|((posed, gated), held_out)| Marks::on(posed.scan.points.len(), gated.iter().chain(held_out)))
            .collect();
        self.gated = gated;
    }

    /// Every reading's part in something, task by task in their order: `work(scan, numbers)`.
    fn in_tasks<T: Send>(&self, work: impl Fn(usize, Range<usize>) -> T + Sync) -> Vec<T> {
        let tasks: Vec<(usize, Range<usize>)> = (self.set.scans.iter().enumerate())
            .flat_map(|(s, posed)| {
                let size = posed.scan.points.len();
                (0..size).step_by(TASK).map(move |k| (s, k..size.min(k + TASK)))
            })
            .collect();
        tasks.into_par_iter().map(|(s, range)| work(s, range)).collect()
    }

    /// The sums of each sensor's readings that are fitted.
    fn sum(&self, space: &Arc<Hierarchy>, progress: &dyn Progress) -> Result<Vec<PositionSums>> {
        let mut sums = vec![PositionSums::new(space); self.set.sensors.len()];
        for (s, posed) in self.set.scans.iter().enumerate() {
            progress.check("adding up", 0.1 + 0.2 * s as f64 / self.set.scans.len() as f64)?;
            let scan = self.of_scan(s);
            sums[posed.sensor]
                .add_from(posed.scan.points.len(), |k| scan.fitted(k))
                .map_err(|e| e.in_context(&posed.scan.name))?;
        }
        Ok(sums)
    }

    /// Sorts the readings by the gate, given each sensor's variance over that stated; and what the residuals of those inside sum up to.
    fn examine(&self, surface: &Evaluation, variances: &[f64]) -> Result<Examined> {
        let gate2 = self.options.gate * self.options.gate;
        let parts = self.in_tasks(|s, range| {
            let limit = gate2 * variances[self.set.scans[s].sensor];
            let scan = self.of_scan(s);
            let mut part = (s, Vec::new(), ResidualSums::default(), ResidualSums::default());
            for k in range {
                if scan.is_held_out.has(k) {
                    continue;
                }
                let reading = scan.reading(k);
                let (mut square, mut largest) = (0.0, 0.0_f64);
                for r in surface.residual(reading) {
                    square += r * r;
                    largest = largest.max(r * r);
                }
                let residual = ResidualSums {
                    count: 1,
                    square,
                    weighted: reading.information * square,
                    variance: 1.0 / reading.information,
                };
                if largest * reading.information > limit {
                    part.1.push(k as u32);
                    part.3.add(&residual);
                } else {
                    part.2.add(&residual);
                }
            }
            part
        });
        let mut gated = vec![Vec::new(); self.set.scans.len()];
        let mut inside = vec![ResidualSums::default(); self.set.sensors.len()];
        let mut outside = inside.clone();
        for (s, found, kept, left) in parts {
            let sensor = self.set.scans[s].sensor;
            gated[s].extend(found);
            inside[sensor].add(&kept);
            outside[sensor].add(&left);
        }
        // What noise alone puts there is not put there by anything else.
        let beyond = 1.0 - TruncatedNormal::new(self.options.gate)?.share_kept();
        let coordinates = surface.coordinates.len();
        let count: usize = inside.iter().chain(&outside).map(|r| r.count).sum();
        let expected = beyond * (coordinates * count) as f64;
        let found: usize = outside.iter().map(|r| r.count).sum();
        if found as f64 <= expected + 4.0 * expected.sqrt() + 1.0 {
            gated.iter_mut().for_each(Vec::clear);
            for (inside, outside) in inside.iter_mut().zip(&outside) {
                inside.add(outside);
            }
        }
        Ok(Examined {
            gated,
            residuals: inside,
        })
    }

    /// Each sensor's variance over that stated as a sample of its residuals says, whatever is outside the gate.
    fn robust_variances(&self, surface: &Evaluation) -> Result<Vec<f64>> {
        let mut residuals = vec![Vec::new(); self.set.sensors.len()];
        let step = (self.total / ENOUGH_FOR_SCALE).max(1);
        for (s, posed) in self.set.scans.iter().enumerate() {
            let scan = self.of_scan(s);
            let sample = (0..posed.scan.points.len().div_ceil(step)).into_par_iter();
            let of_sample: Vec<f64> = (sample.with_min_len(TASK))
                .flat_map_iter(|k| {
                    let reading = scan.reading(k * step);
                    let weight = reading.information.sqrt();
                    surface.residual(reading).map(move |r| r * weight)
                })
                .collect();
            residuals[posed.sensor].extend(of_sample);
        }
        (residuals.iter())
            .map(|all| match all.is_empty() {
                true => Ok(1.0),
                false => Ok(gated_scale(all, self.options.gate)?.sigma.powi(2)),
            })
            .collect()
    }
}

/// What the gate makes of the readings.
struct Examined {
    /// Numbers of those outside, scan by scan, ascending.
    gated: Vec<Vec<u32>>,
    /// Sums over those inside, sensor by sensor.
    residuals: Vec<ResidualSums>,
}

/// The measured coordinates of a surface as polynomials on every leaf: a surface that is quick to ask.
struct Evaluation {
    space: Arc<Hierarchy>,
    /// Which coordinates are measured.
    coordinates: Vec<usize>,
    /// For each leaf and measured coordinate, coefficient of `xⁱ yʲ` at `[j][i]`.
    polynomials: Vec<[[f64; 4]; 4]>,
}

/// Coefficient of `xⁱ` in the cubic B-spline weight `k` of a cell, times 6.
const WEIGHTS_6: [[f64; 4]; 4] = [
    [1.0, -3.0, 3.0, -1.0],
    [4.0, 0.0, -6.0, 3.0],
    [1.0, 3.0, 3.0, -3.0],
    [0.0, 0.0, 0.0, 1.0],
];

impl Evaluation {
    fn new(surface: &Surface, measured: [bool; 3]) -> Self {
        let coordinates: Vec<usize> = (0..3).filter(|&d| measured[d]).collect();
        let coefficients = surface.space().leaf_coefficients(surface.vertices());
        let polynomials = (coefficients.iter())
            .flat_map(|c| {
                coordinates.iter().map(|&d| {
                    let mut polynomial = [[0.0; 4]; 4];
                    for (k, c) in c.iter().enumerate() {
                        for j in 0..4 {
                            for i in 0..4 {
                                polynomial[j][i] += WEIGHTS_6[k / 4][j] * WEIGHTS_6[k % 4][i] * c[d] / 36.0;
                            }
                        }
                    }
                    polynomial
                })
            })
            .collect();
        Self {
            space: Arc::clone(surface.space()),
            coordinates,
            polynomials,
        }
    }

    /// Reading minus surface, in the measured coordinates.
    #[inline(always)]
    fn residual(&self, reading: Reading) -> impl Iterator<Item = f64> {
        let (leaf, [x, y]) = self.space.locate(reading.at[0], reading.at[1]);
        let many = self.coordinates.len();
        let own = &self.polynomials[leaf * many..(leaf + 1) * many];
        self.coordinates.iter().zip(own).map(move |(&d, p)| {
            let [a, b, c, e] = p.map(|row| ((row[3] * x + row[2]) * x + row[1]) * x + row[0]);
            reading.point[d] - (((e * y + c) * y + b) * y + a)
        })
    }
}

/// Fits a uniform grid of so many cells to readings with known parameters.
///
/// # Errors
/// `Input` when a scan has no parameters, or some outside `[0, 1]`; `Unsupported` for noise that depends on direction; `Undetermined` when the
/// readings do not determine the surface.
pub(super) fn fit_known(
    set: &ScanSet,
    cells: [usize; 2],
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Fit> {
    let shape = options.shape.unwrap_or(Shape::Sheet);
    let space = Arc::new(Hierarchy::uniform(shape, cells)?);
    let mut readings = Readings::new(set, cells, options)?;
    progress.check("equations", 0.02)?;
    let (mut system, mut sums) = (None, Vec::new());
    rayon::in_place_scope(|scope| {
        scope.spawn(|_| system = Some(SurfaceSystem::new(&space)));
        sums = readings.sum(&space, progress)?;
        Ok::<_, Error>(())
    })?;
    let Some(system) = system else {
        unreachable!("the scope waits for the system")
    };
    let system = system?;
    let mut variances = vec![1.0; set.sensors.len()];
    let mut earlier: Option<Smoothing> = None;
    let mut round = 0;
    loop {
        round += 1;
        progress.check("smoothing", 0.25 + 0.05 * f64::from(round))?;
        let total = Totals::new(&sums, &variances, &system)?;
        let smoothing = match earlier {
            None => {
                let start = Smoothing::first_weight(&total.sums)?;
                let first = Smoothing::new(&system, &reference_surface(&space, &total.sums)?, &total, start)?;
                if shape == Shape::Sheet {
                    first
                } else {
                    // The metric of a closed shape is not known before there is one.
                    Smoothing::new(&system, &first.surface(&system, &total)?, &total, None)?
                }
            }
            Some(earlier) => earlier.again(&system, &total)?,
        };
        let surface = smoothing.surface(&system, &total)?;
        let evaluation = Evaluation::new(&surface, smoothing.measured);
        progress.check("gating", 0.27 + 0.05 * f64::from(round))?;
        let now = readings.robust_variances(&evaluation)?;
        let examined = readings.examine(&evaluation, &now)?;
        let same_noise =
            variances.len() == 1 || (now.iter().zip(&variances)).all(|(a, b)| (a / b - 1.0).abs() < SETTLED_VARIANCE);
        let changed = difference(&readings.gated, &examined.gated);
        let settled = same_noise && changed as f64 <= SETTLED_GATE * total.sums.count() as f64;
        if settled || round == MOST_ROUNDS {
            let solved = Solved {
                total,
                variances,
                smoothing,
                surface,
                evaluation,
                residuals: examined.residuals,
                reached_limit: round == MOST_ROUNDS,
            };
            return solved.finish(&readings, progress);
        }
        if variances.len() > 1 {
            variances = now;
        }
        if changed > 0 {
            readings.set_gated(examined.gated);
            sums = readings.sum(&space, progress)?;
        }
        earlier = Some(smoothing);
    }
}

/// Numbers of readings that are held out of each scan: one at random of as many as the share wants, as few as judge the fit.
fn held_out(set: &ScanSet, options: &FitOptions, total: usize) -> Vec<Vec<u32>> {
    let share = options.held_out_share.min(ENOUGH_HELD_OUT / total as f64);
    (set.scans.iter().enumerate())
        .map(|(s, posed)| {
            let size = posed.scan.points.len();
            let strata = (size as f64 * share).ceil() as u64;
            let chosen = (0..strata).map(|b| (b as f64 + hash01(options.seed, s as u64, b)) / share);
            chosen.filter(|k| *k < size as f64).map(|k| k as u32).collect()
        })
        .collect()
}

/// How many numbers are in one of two lists of ascending lists only.
fn difference(a: &[Vec<u32>], b: &[Vec<u32>]) -> usize {
    a.iter()
        .zip(b)
        .map(|(a, b)| {
            let common = a.iter().filter(|k| b.binary_search(k).is_ok()).count();
            a.len() + b.len() - 2 * common
        })
        .sum()
}

/// A fit that is settled but for its figures.
struct Solved {
    total: Totals,
    /// Each sensor's variance over that stated, up to a factor common to all; 1 for one sensor.
    variances: Vec<f64>,
    smoothing: Smoothing,
    surface: Surface,
    evaluation: Evaluation,
    residuals: Vec<ResidualSums>,
    reached_limit: bool,
}

impl Solved {
    fn finish(self, readings: &Readings<'_>, progress: &dyn Progress) -> Result<Fit> {
        let Self {
            total,
            variances,
            smoothing,
            surface,
            evaluation,
            residuals,
            reached_limit,
        } = self;
        let set = readings.set;
        let measured = smoothing.measured;
        let coordinates = measured.iter().filter(|m| **m).count() as f64;
        progress.check("covariance", 0.8)?;
        let is_gated = readings.gated.iter().any(|gated| !gated.is_empty());
        let kept = if is_gated {
            kept_variance(readings.options.gate)?
        } else {
            1.0
        };

        // σ² of the readings: residuals over what is left of their number.
        let inverse = SelectedInverse::new(&smoothing.factor);
        let degrees = coordinates * inverse.trace_with(&total.information)?;
        let count: usize = residuals.iter().map(|r| r.count).sum();
        let weighted: f64 = residuals.iter().zip(&variances).map(|(r, v)| r.weighted / v).sum();
        let redundant = (coordinates * count as f64 - degrees).max(1.0);
        let estimated = (weighted / (redundant * kept)).max(least_variance(&surface, &total));
        let believed =
            |s: usize| readings.stated[s] && (1.0 / BELIEVED..BELIEVED).contains(&(estimated * variances[s]).sqrt());
        let scale = match (0..variances.len()).find(|&s| believed(s) && residuals[s].count > 0) {
            Some(s) => 1.0 / variances[s],
            None => estimated,
        };

        let observed = with_neighbours(surface.space(), &total.sums.observed());
        let sensors: Vec<SensorReport> = (set.sensors.iter().enumerate())
            .filter(|(s, _)| residuals[*s].count > 0)
            .map(|(s, sensor)| {
                let r = &residuals[s];
                let n = r.count as f64;
                let typical = (r.variance / n).sqrt();
                SensorReport {
                    name: sensor.name.clone(),
                    quantity: Quantity::Position.name().to_owned(),
                    observations: r.count,
                    sigma_stated: readings.stated[s].then_some(typical),
                    sigma_estimated: (estimated * variances[s]).sqrt() * typical,
                    rms: (r.square / (coordinates * n)).sqrt(),
                    sigma_used_is_estimated: !believed(s),
                }
            })
            .collect();
        let model = SurfaceModel {
            unit: set.unit.unwrap_or(Unit::Millimetre),
            prior: over_coordinates(&smoothing.energy, smoothing.found.weight / scale, measured, [0.0; 3])?,
            data: over_coordinates(&total.information, 1.0 / scale, measured, total.sums.origin())?,
            observed,
            sensors: sensors.clone(),
            poses: pose_reports(set),
            smoothness_weight: smoothing.found.weight / scale,
            observations: count,
            measured_coordinates: Some(measured),
            surface,
        };
        let covariance = Arc::new(NodeCovariance::of_coordinates(inverse, measured, scale));
        let posterior = Posterior::new(&model.surface, Arc::clone(&covariance));
        progress.check("figures", 0.9)?;
        let held_out = readings.judge(&evaluation, &posterior, scale, &variances)?;
        let sigma = posterior.sigma_summary(&model.observed)?;
        let areas: Vec<f64> = (0..model.observed.len())
            .map(|leaf| model.surface.leaf_jet(leaf, 0.5, 0.5).area_element())
            .collect();
        let observed_area: f64 = areas
            .iter()
            .zip(&model.observed)
            .filter(|(_, o)| **o)
            .map(|(a, _)| a)
            .sum();
        let square: f64 = residuals.iter().map(|r| r.square).sum();
        let n = coordinates * count.max(1) as f64;
        let not_finite: usize = set.scans.iter().map(|posed| posed.scan.dropped_not_finite).sum();
        let gated: usize = readings.gated.iter().map(Vec::len).sum();
        let rejected: BTreeMap<String, usize> = [(Rejection::NotFinite, not_finite), (Rejection::Outlier, gated)]
            .into_iter()
            .filter(|(_, n)| *n > 0)
            .map(|(cause, n)| (cause.name().to_owned(), n))
            .collect();
        let observed_share = observed_area / areas.iter().sum::<f64>();
        let report = FitReport {
            observations: count,
            shape: model.surface.space().shape().name().to_owned(),
            coefficients: model.surface.space().node_count(),
            levels: 1,
            cells: model.surface.space().leaves().len(),
            rms: (square / n).sqrt(),
            rms_normalised: (weighted / (scale * n)).sqrt(),
            reduced_chi_square: weighted / (scale * redundant * kept),
            warnings: warnings(&sensors, observed_share, &rejected, readings.total + not_finite),
            rejected,
            sensors,
            poses: model.poses.clone(),
            sigma,
            observed_area_fraction: observed_share,
            smoothness_weight: model.smoothness_weight,
            held_out,
            termination: if reached_limit {
                FitTermination::Limit
            } else {
                FitTermination::Converged
            },
        };
        progress.advance("done", 1.0);
        Ok(Fit {
            model,
            report,
            covariance,
        })
    }
}

impl Readings<'_> {
    /// Held-out readings: each measured coordinate's residual over `√(σ_reading² + σ_surface²)`, behind the same gate as all others.
    fn judge(&self, surface: &Evaluation, posterior: &Posterior<'_>, scale: f64, variances: &[f64]) -> Result<HeldOut> {
        let gate = self.options.gate;
        let Some(&measured) = surface.coordinates.first() else {
            return Err(Error::undetermined("no coordinate was measured"));
        };
        let mut axis = [0.0; 3];
        axis[measured] = 1.0;
        // By leaves: their covariance is what takes long.
        let mut held_out: Vec<_> = (self.held_out.iter().enumerate())
            .flat_map(|(s, numbers)| {
                let scan = self.of_scan(s);
                numbers.iter().map(move |&k| {
                    let reading = scan.reading(k as usize);
                    (surface.space.locate(reading.at[0], reading.at[1]), s, reading)
                })
            })
            .collect();
        held_out.sort_by_key(|((leaf, _), _, _)| *leaf);
        let judged: Vec<Option<f64>> = held_out
            .chunk_by(|a, b| a.0.0 == b.0.0)
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|of_leaf| {
                let cell = posterior.leaf(of_leaf[0].0.0)?;
                let judge = |((_, local), s, reading): &((usize, [f64; 2]), usize, Reading)| {
                    let of_surface = cell.variance_along(&leaf_weights(local[0], local[1]), axis);
                    let of_reading = scale * variances[self.set.scans[*s].sensor] / reading.information;
                    let (mut largest, mut squares) = (0.0_f64, 0.0);
                    for r in surface.residual(*reading) {
                        let square = r * r / (of_reading + of_surface);
                        largest = largest.max(square);
                        squares += square;
                    }
                    (largest <= gate * gate).then_some(squares)
                };
                Ok(of_leaf.iter().map(judge).collect::<Vec<_>>())
            })
            .collect::<Result<Vec<_>>>()?
            .concat();
        let kept: Vec<f64> = judged.into_iter().flatten().collect();
        if kept.is_empty() {
            return Ok(HeldOut {
                n: 0,
                rms_normalised: f64::NAN,
            });
        }
        let mean = kept.iter().sum::<f64>() / (kept.len() * surface.coordinates.len()) as f64;
        Ok(HeldOut {
            n: kept.len(),
            rms_normalised: (mean / kept_variance(gate)?).sqrt(),
        })
    }
}

/// A variance that rounding alone leaves.
fn least_variance(surface: &Surface, total: &Totals) -> f64 {
    let size = BoundingBox::of(surface.vertices()).map_or(0.0, |b| b.diagonal());
    let typical = total.sums.count().max(1) as f64 / total.sums.weight();
    ((1e-12 * size).powi(2) / typical).max(f64::MIN_POSITIVE)
}

/// Information of one unknown a node over all three coordinates, times a factor, about the world's origin where it was about another;
/// exact coordinates are held much firmer.
fn over_coordinates(
    information: &BlockInformation,
    factor: f64,
    measured: [bool; 3],
    origin: [f64; 3],
) -> Result<BlockInformation> {
    let mut out = BlockInformation::zeros(Arc::clone(information.pattern()), 3, 1)?;
    let weights = measured.map(|m| if m { factor } else { EXACT * factor });
    (out.values_mut().par_chunks_exact_mut(9).zip(information.values()))
        .with_min_len(TASK)
        .for_each(|(block, value)| {
            for d in 0..3 {
                block[4 * d] = weights[d] * value;
            }
        });
    let mut row_sums = vec![0.0; information.dimension()];
    if origin != [0.0; 3] {
        information.multiply(&vec![1.0; information.dimension()], &mut row_sums)?;
    }
    let rows = information.vector().chunks_exact(3).zip(&row_sums);
    for (to, (from, sum)) in out.vector_mut().chunks_exact_mut(3).zip(rows) {
        for d in 0..3 {
            to[d] = weights[d] * (from[d] + sum * origin[d]);
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests;
