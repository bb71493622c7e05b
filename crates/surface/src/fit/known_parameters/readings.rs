//! Readings with known parameters: which of them are fitted, held out, gated or duplicates.
//!
//! Input: scans with `u` and `v`. Output: sums over cells, and the residuals of a surface. Only marks are
//! kept for each reading.

use crate::fit::FitOptions;
use crate::fit::noise::ResidualSums;
use crate::observe::{BitsHasher, hash01};
use planish_core::{DVec3, Progress};
use planish_estimate::{Error, Result, TruncatedNormal, gated_scale};
use planish_exchange::ScanSet;
use planish_mesh::BoundingBox;
use planish_sense::{Noise, Pose};
use planish_spline::{Hierarchy, PositionReading, PositionSums, Surface};
use rayon::prelude::*;
use std::hash::Hasher;
use std::ops::Range;
use std::sync::Arc;

/// Readings of one parallel task. Fixed, so that sums do not depend on the number of threads.
pub(super) const TASK: usize = 1 << 13;
/// Held-out readings that are enough to judge a fit: their normalised rms has a standard error of 1.3 %.
const MAX_HELD_OUT: f64 = 3_000.0;
/// Residuals that are enough to estimate the scale of a sensor: its standard error is 0.3 %.
const MAX_FOR_SCALE: usize = 50_000;
/// Minimum number of readings of a fit. A quadric has nine coefficients; one more reading leaves a residual.
const MIN_READINGS: usize = 10;
/// Readings farther than this many σ are softened while gross errors are searched for. A larger bound lets
/// these errors drag the surface along; a smaller one gives away information of correct readings.
const BOUNDED_FROM_SIGMAS: f64 = 2.5;
/// Margin in σ beyond the gate, or beyond the farthest expected draw of noise, up to which distant readings
/// can be noise.
const BEYOND_NOISE: f64 = 2.0;
/// Readings for each bin in which neighbours are compared. More of them give more pairs, but average over
/// finer shape.
const READINGS_PER_BIN: f64 = 8.0;
/// Unresolved shape is reported if it is this many standard deviations of noise, and at least this share of
/// the residuals' variance.
const SIGNIFICANT_SHAPE: f64 = 5.0;
const MIN_REPORTED_SHARE: f64 = 0.05;
/// Rounding error, as a share of the size of the surface.
const ROUNDING: f64 = 1e-12;

/// The readings of a set of scans, with marks of those that are not fitted.
pub(super) struct Readings<'a> {
    pub(super) set: &'a ScanSet,
    pub(super) cells: [f64; 2],
    pub(super) options: &'a FitOptions,
    /// Number of readings.
    pub(super) total: usize,
    /// Numbers of held-out readings of each scan, ascending.
    pub(super) held_out: Vec<Vec<u32>>,
    /// Numbers of gated readings of each scan, ascending.
    pub(super) gated: Vec<Vec<u32>>,
    /// Numbers of readings that repeat an earlier one of their scan, ascending.
    pub(super) repeated: Vec<Vec<u32>>,
    /// The surface and variances by which distant readings are softened, if they are.
    pub(super) softening: Option<Softening>,
    /// For each scan, marks of readings that are held out or repeated; and of these and the gated ones.
    pub(super) is_held_out: Vec<Marks>,
    pub(super) is_excluded: Vec<Marks>,
    /// For each sensor, true if σ was stated.
    pub(super) stated: Vec<bool>,
    /// Each sensor's 1/variance for scans without σ; 1 if none is stated.
    pub(super) information: Vec<f64>,
    /// For each scan, true if its pose is not the identity.
    pub(super) is_moved: Vec<bool>,
}

/// Softening of distant readings: beyond [`BOUNDED_FROM_SIGMAS`] σ from a surface, each adds as much to the
/// sum of squares as a reading at that distance.
pub(super) struct Softening {
    pub(super) surface: Evaluation,
    /// Each sensor's variance over that stated.
    pub(super) variances: Vec<f64>,
}

/// One mark for each reading.
pub(super) struct Marks(Vec<u64>);

impl Marks {
    /// `size` marks, of which those in `numbers` are set.
    pub(super) fn on<'n>(size: usize, numbers: impl IntoIterator<Item = &'n u32>) -> Self {
        let mut words = vec![0; size.div_ceil(64)];
        for &k in numbers {
            words[k as usize / 64] |= 1 << (k % 64);
        }
        Self(words)
    }

    #[inline(always)]
    pub(super) fn has(&self, k: usize) -> bool {
        self.0[k / 64] & (1 << (k % 64)) != 0
    }
}

/// One reading in the world frame.
#[derive(Clone, Copy)]
pub(super) struct Reading {
    pub(super) at: [f64; 2],
    pub(super) point: DVec3,
    /// Stated 1/variance; 1 if none was stated.
    pub(super) information: f64,
}

/// The readings of one scan.
#[derive(Clone, Copy)]
pub(super) struct OfScan<'a> {
    pub(super) parameters: &'a [[f64; 2]],
    pub(super) points: &'a [DVec3],
    pub(super) sigma: Option<&'a [f64]>,
    /// 1/variance of readings without a σ of their own.
    pub(super) information: f64,
    pub(super) pose: Option<&'a Pose>,
    pub(super) cells: [f64; 2],
    pub(super) is_excluded: &'a Marks,
    pub(super) is_held_out: &'a Marks,
    /// A surface, and the distance up to which a reading of unit information keeps its full weight.
    pub(super) softened: Option<(&'a Evaluation, f64)>,
}

impl OfScan<'_> {
    #[inline(always)]
    pub(super) fn reading(&self, k: usize) -> Reading {
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

    /// Reading `k`; none if it takes no part in the fit.
    #[inline(always)]
    pub(super) fn fitted(&self, k: usize) -> Option<PositionReading> {
        (!self.is_excluded.has(k)).then(|| {
            let reading = self.reading(k);
            let softened = self.softened.map_or(1.0, |(surface, bound)| {
                let far = surface.residual(reading).fold(0.0, |far: f64, r| far.max(r.abs()));
                (bound / (far * reading.information.sqrt()).max(f64::MIN_POSITIVE)).min(1.0).powi(2)
            });
            PositionReading {
                parameters: reading.at,
                position: reading.point,
                information: softened * reading.information,
            }
        })
    }
}

impl<'a> Readings<'a> {
    pub(super) fn new(set: &'a ScanSet, cells: [usize; 2], options: &'a FitOptions) -> Result<Self> {
        let total: usize = set.scans.iter().map(|posed| posed.scan.points.len()).sum();
        if total < MIN_READINGS {
            return Err(Error::undetermined(format!(
                "expected at least {MIN_READINGS} readings, found {total} in all"
            )));
        }
        let mut stated = vec![true; set.sensors.len()];
        // The caller adds the name of a single file.
        let located = |e: Error, name: &str| if set.scans.len() > 1 { e.at(name) } else { e };
        for posed in &set.scans {
            let name = &posed.scan.name;
            if posed.scan.parameters.is_none() {
                let e = "expected the columns u v (the parameters of each reading, in [0, 1]), found none";
                return Err(located(Error::input(e), name));
            }
            if posed.scan.covariance.is_some() {
                let e = "expected one σ for each reading (the column sigma) with known parameters, found \
                    covariances cxx … czz";
                return Err(located(Error::unsupported(e), name));
            }
            if posed.scan.sigma.is_none() {
                match set.sensors[posed.sensor].noise {
                    None => stated[posed.sensor] = false,
                    Some(Noise::Isotropic { .. }) => {}
                    Some(Noise::Ray { .. }) => {
                        let e = Error::unsupported(format!(
                            "expected one σ for all directions with known parameters, found sigma_along and \
                             sigma_across of the sensor \"{}\"",
                            set.sensors[posed.sensor].name
                        ));
                        return Err(located(e, name));
                    }
                }
            }
        }
        for posed in &set.scans {
            // `&` and a fold instead of `&&` and a search: without branches, millions of readings are checked
            // in vector instructions. The number of a bad one is looked up afterwards.
            let inside = |p: &[f64; 2]| (0.0..=1.0).contains(&p[0]) & (0.0..=1.0).contains(&p[1]);
            if let Some(all) = &posed.scan.parameters
                && !all.par_chunks(TASK).all(|part| part.iter().fold(true, |good, p| good & inside(p)))
                && let Some(k) = all.iter().position(|p| !inside(p))
            {
                let e = Error::input(format!(
                    "expected u and v in [0, 1], found ({}, {}) (point {k})",
                    all[k][0], all[k][1]
                ));
                return Err(located(e, &posed.scan.name));
            }
        }
        let repeated = repeated(set);
        let mut held_out = held_out(set, options, total);
        for (held_out, repeated) in held_out.iter_mut().zip(&repeated) {
            // A copy of a fitted reading cannot judge the fit.
            held_out.retain(|k| repeated.binary_search(k).is_err());
        }
        let marks = || -> Vec<Marks> {
            (set.scans.iter().zip(held_out.iter().zip(&repeated)))
                .map(|(posed, (held_out, repeated))| {
                    Marks::on(posed.scan.points.len(), held_out.iter().chain(repeated))
                })
                .collect()
        };
        Ok(Self {
            set,
            cells: cells.map(|n| n as f64),
            options,
            total,
            is_held_out: marks(),
            is_excluded: marks(),
            held_out,
            repeated,
            softening: None,
            gated: vec![Vec::new(); set.scans.len()],
            stated,
            information: (set.sensors.iter())
                .map(|sensor| match sensor.noise {
                    Some(Noise::Isotropic { sigma }) => 1.0 / (sigma * sigma),
                    _ => 1.0,
                })
                .collect(),
            // Without a pose, nine products for each reading are saved.
            is_moved: (set.scans.iter())
                .map(|posed| posed.scan.world_from_scanner != Pose::identity())
                .collect(),
        })
    }

    /// The readings of scan `s`.
    pub(super) fn of_scan(&self, s: usize) -> OfScan<'_> {
        let posed = &self.set.scans[s];
        OfScan {
            parameters: posed.scan.parameters.as_deref().unwrap_or(&[]),
            points: &posed.scan.points,
            sigma: posed.scan.sigma.as_deref(),
            information: self.information[posed.sensor],
            pose: self.is_moved[s].then_some(&posed.scan.world_from_scanner),
            cells: self.cells,
            is_excluded: &self.is_excluded[s],
            is_held_out: &self.is_held_out[s],
            softened: (self.softening.as_ref())
                .map(|by| (&by.surface, BOUNDED_FROM_SIGMAS * by.variances[posed.sensor].sqrt())),
        }
    }

    /// Softens readings that are far from a surface.
    pub(super) fn soften(&mut self, surface: Evaluation, variances: Vec<f64>) {
        self.softening = Some(Softening { surface, variances });
    }

    /// Rejects the readings in `gated` instead of those before.
    pub(super) fn set_gated(&mut self, gated: Vec<Vec<u32>>) {
        self.softening = None;
        let excluded = gated.iter().zip(&self.held_out).zip(&self.repeated);
        self.is_excluded = (self.set.scans.iter().zip(excluded))
            .map(|(posed, ((gated, held_out), repeated))| {
                Marks::on(posed.scan.points.len(), gated.iter().chain(held_out).chain(repeated))
            })
            .collect();
        self.gated = gated;
    }

    /// The results of `work(scan, numbers)` for all readings, in the order of tasks.
    pub(super) fn in_tasks<T: Send>(&self, work: impl Fn(usize, Range<usize>) -> T + Sync) -> Vec<T> {
        let tasks: Vec<(usize, Range<usize>)> = (self.set.scans.iter().enumerate())
            .flat_map(|(s, posed)| {
                let size = posed.scan.points.len();
                (0..size).step_by(TASK).map(move |k| (s, k..size.min(k + TASK)))
            })
            .collect();
        // Results are collected in the order of the tasks, so sums over them do not depend on the threads.
        tasks.into_par_iter().map(|(s, range)| work(s, range)).collect()
    }

    /// The sums of each sensor's fitted readings.
    pub(super) fn sum(&self, space: &Arc<Hierarchy>, progress: &dyn Progress) -> Result<Vec<PositionSums>> {
        let mut sums = vec![PositionSums::new(space); self.set.sensors.len()];
        for (s, posed) in self.set.scans.iter().enumerate() {
            progress.check("adding up", 0.1 + 0.2 * s as f64 / self.set.scans.len() as f64)?;
            progress
                .items(self.set.scans[..s].iter().map(|before| before.scan.points.len()).sum(), "readings");
            let scan = self.of_scan(s);
            sums[posed.sensor]
                .add_from(posed.scan.points.len(), |k| scan.fitted(k))
                .map_err(|e| e.at(&posed.scan.name))?;
        }
        Ok(sums)
    }

    /// The readings outside the gate, given each sensor's variance over that stated, and residual sums of
    /// those inside.
    pub(super) fn examine(&self, surface: &Evaluation, variances: &[f64]) -> Result<Examined> {
        let gate2 = self.options.gate * self.options.gate;
        let parts = self.in_tasks(|s, range| {
            let variance = variances[self.set.scans[s].sensor];
            let scan = self.of_scan(s);
            let mut part = ExaminedPart { scan: s, ..ExaminedPart::default() };
            for k in range {
                // Gated readings are examined again: a better surface may accept them.
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
                let normalised = largest * reading.information / variance;
                // Residuals of rounding size are no errors of a sensor.
                if normalised > gate2 && largest > surface.rounding {
                    part.farthest = part.farthest.max(normalised);
                    if !scan.is_excluded.has(k) {
                        part.farthest_new = part.farthest_new.max(normalised);
                    }
                    part.gated.push(k as u32);
                    part.outside.add(&residual);
                } else {
                    part.inside.add(&residual);
                }
            }
            part
        });
        let mut gated = vec![Vec::new(); self.set.scans.len()];
        let mut inside = vec![ResidualSums::default(); self.set.sensors.len()];
        let mut outside = inside.clone();
        let (mut farthest, mut farthest_new) = (0.0_f64, 0.0_f64);
        for part in parts {
            let sensor = self.set.scans[part.scan].sensor;
            gated[part.scan].extend(part.gated);
            inside[sensor].add(&part.inside);
            outside[sensor].add(&part.outside);
            farthest = farthest.max(part.farthest.sqrt());
            farthest_new = farthest_new.max(part.farthest_new.sqrt());
        }
        // If noise alone explains the number of readings outside and their distance, none of them is gross.
        let beyond = 1.0 - TruncatedNormal::new(self.options.gate)?.share_kept();
        let count: usize = inside.iter().chain(&outside).map(|r| r.count).sum();
        let numbers = (surface.coordinates.len() * count).max(1) as f64;
        // The number outside is compared with its Poisson spread, the farthest with the extreme of normal
        // draws.
        let expected = beyond * numbers;
        let found: usize = outside.iter().map(|r| r.count).sum();
        let far = self.options.gate.max((2.0 * numbers.ln()).sqrt()) + BEYOND_NOISE;
        if found as f64 <= expected + 4.0 * expected.sqrt() + 1.0 && farthest <= far {
            gated.iter_mut().for_each(Vec::clear);
            for (inside, outside) in inside.iter_mut().zip(&outside) {
                inside.add(outside);
            }
        }
        Ok(Examined { gated, residuals: inside, farthest_new })
    }

    /// Share of the residuals' variance that is common to neighbours, if it is more than noise: shape that
    /// the grid cannot follow.
    ///
    /// It is `Σ_b ((Σ r)² − Σ r²)/n_b` over small bins of a sample, with residuals clamped to the gate.
    pub(super) fn unresolved_share(&self, surface: &Evaluation, variances: &[f64]) -> Option<f64> {
        // A sample is enough, and keeps the cost independent of the number of readings.
        let step = (self.total / MAX_FOR_SCALE).max(1);
        let side = ((self.total / step) as f64 / READINGS_PER_BIN).sqrt().floor().max(1.0);
        let coordinates = surface.coordinates.len();
        // Sum, sum of squares and number of each bin and coordinate.
        let mut bins = vec![[0.0_f64; 3]; (side * side) as usize * coordinates];
        for (s, posed) in self.set.scans.iter().enumerate() {
            let scan = self.of_scan(s);
            let spread = variances[posed.sensor].sqrt();
            for k in (0..posed.scan.points.len()).step_by(step).filter(|&k| !scan.is_excluded.has(k)) {
                let reading = scan.reading(k);
                let place = [0, 1].map(|d| (reading.at[d] / self.cells[d] * side).min(side - 1.0) as usize);
                let bin = (place[1] * side as usize + place[0]) * coordinates;
                for (bin, r) in bins[bin..].iter_mut().zip(surface.residual(reading)) {
                    // Clamped, so that one gross error is not taken for the shape of its bin.
                    let r = (r * reading.information.sqrt() / spread)
                        .clamp(-self.options.gate, self.options.gate);
                    *bin = [bin[0] + r, bin[1] + r * r, bin[2] + 1.0];
                }
            }
        }
        let (mut shared, mut total, mut pairs) = (0.0, 0.0, 0.0);
        for [sum, squares, n] in bins.into_iter().filter(|[_, _, n]| *n > 1.0) {
            shared += (sum * sum - squares) / n;
            total += (n - 1.0) * squares / n;
            pairs += 1.0 - 1.0 / n;
        }
        let share = shared / total.max(f64::MIN_POSITIVE);
        (shared > SIGNIFICANT_SHAPE * f64::sqrt(2.0 * pairs) && share > MIN_REPORTED_SHARE).then_some(share)
    }

    /// Each sensor's variance over that stated, from a sample of its residuals. Readings beyond the gate do
    /// not matter, because the gate itself is set by these variances.
    pub(super) fn robust_variances(&self, surface: &Evaluation) -> Result<Vec<f64>> {
        let mut residuals = vec![Vec::new(); self.set.sensors.len()];
        let step = (self.total / MAX_FOR_SCALE).max(1);
        for (s, posed) in self.set.scans.iter().enumerate() {
            let scan = self.of_scan(s);
            let sample = (0..posed.scan.points.len().div_ceil(step)).into_par_iter();
            let of_sample: Vec<f64> = (sample.with_min_len(TASK))
                .filter(|k| !scan.is_held_out.has(k * step))
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

/// The outcome of [`Readings::examine`].
pub(super) struct Examined {
    /// Numbers of readings outside the gate, by scan, ascending.
    pub(super) gated: Vec<Vec<u32>>,
    /// Residual sums of those inside, by sensor.
    pub(super) residuals: Vec<ResidualSums>,
    /// Distance in σ of the farthest reading outside that was inside before.
    pub(super) farthest_new: f64,
}

/// The outcome of one task.
#[derive(Default)]
pub(super) struct ExaminedPart {
    pub(super) scan: usize,
    pub(super) gated: Vec<u32>,
    pub(super) inside: ResidualSums,
    pub(super) outside: ResidualSums,
    /// Squared distance over variance of the farthest reading, and of the farthest that was inside before.
    pub(super) farthest: f64,
    pub(super) farthest_new: f64,
}

/// The measured coordinates of a surface as polynomials on every leaf, for fast evaluation.
pub(super) struct Evaluation {
    pub(super) space: Arc<Hierarchy>,
    /// Measured coordinates.
    pub(super) coordinates: Vec<usize>,
    /// For each leaf and measured coordinate, coefficient of `xⁱ yʲ` at `[j][i]`.
    pub(super) polynomials: Vec<[[f64; 4]; 4]>,
    /// Square of a residual of rounding size.
    pub(super) rounding: f64,
}

/// Coefficient of `xⁱ` in the cubic B-spline weight `k` of a cell, times 6.
const WEIGHTS_6: [[f64; 4]; 4] =
    [[1.0, -3.0, 3.0, -1.0], [4.0, 0.0, -6.0, 3.0], [1.0, 3.0, 3.0, -3.0], [0.0, 0.0, 0.0, 1.0]];

impl Evaluation {
    pub(super) fn new(surface: &Surface, measured: [bool; 3]) -> Self {
        let coordinates: Vec<usize> = (0..3).filter(|&d| measured[d]).collect();
        let coefficients = surface.space().leaf_coefficients(surface.vertices());
        // The sum over sixteen products of weights is one polynomial for each leaf, which Horner's rule
        // evaluates with fifteen multiplications.
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
            rounding: (ROUNDING * BoundingBox::from_points(surface.vertices()).map_or(0.0, |b| b.diagonal()))
                .powi(2),
        }
    }

    /// Reading minus surface, in the measured coordinates.
    #[inline(always)]
    pub(super) fn residual(&self, reading: Reading) -> impl Iterator<Item = f64> {
        let (leaf, [x, y]) = self.space.locate(reading.at[0], reading.at[1]);
        let many = self.coordinates.len();
        let own = &self.polynomials[leaf * many..(leaf + 1) * many];
        self.coordinates.iter().zip(own).map(move |(&d, p)| {
            let [a, b, c, e] = p.map(|row| ((row[3] * x + row[2]) * x + row[1]) * x + row[0]);
            reading.point[d] - (((e * y + c) * y + b) * y + a)
        })
    }
}

/// Numbers of the held-out readings of each scan: one at random from each stratum of `1/share` readings, and
/// at most as many as are needed.
pub(super) fn held_out(set: &ScanSet, options: &FitOptions, total: usize) -> Vec<Vec<u32>> {
    let share = options.held_out_share.min(MAX_HELD_OUT / total as f64);
    (set.scans.iter().enumerate())
        .map(|(s, posed)| {
            let size = posed.scan.points.len();
            // One draw for each stratum instead of one for each reading: the numbers are ascending, as the
            // binary searches need them, and the other readings cost nothing.
            let strata = (size as f64 * share).ceil() as u64;
            let chosen = (0..strata).map(|b| (b as f64 + hash01(options.seed, s as u64, b)) / share);
            chosen.filter(|k| *k < size as f64).map(|k| k as u32).collect()
        })
        .collect()
}

/// Numbers of readings that repeat an earlier one of their scan to the last digit, ascending.
///
/// Copies have the same hash, so a sample by hash contains all copies of a reading or none. All readings are
/// examined only if the sample contains copies.
pub(super) fn repeated(set: &ScanSet) -> Vec<Vec<u32>> {
    (set.scans.iter())
        .map(|posed| {
            let (points, parameters) = (&posed.scan.points, posed.scan.parameters.as_deref().unwrap_or(&[]));
            let hashes = |wanted: fn(u64) -> bool| -> Vec<(u64, u32)> {
                let mut all: Vec<(u64, u32)> = (points.par_iter().zip(parameters).enumerate())
                    .with_min_len(TASK)
                    .map(|(k, (p, at))| (hash_of(p.to_array().iter().chain(at)), k as u32))
                    .filter(|(hash, _)| wanted(*hash))
                    .collect();
                // Equal hashes are sorted by number, so the first of several copies is the one that stays.
                all.par_sort_unstable();
                all
            };
            // Different readings may have one hash, so the numbers themselves are compared, too.
            let same = |pair: &[(u64, u32)]| {
                let [i, j] = [pair[0].1 as usize, pair[1].1 as usize];
                pair[0].0 == pair[1].0 && points[i] == points[j] && parameters[i] == parameters[j]
            };
            if !hashes(|hash| hash & 63 == 0).windows(2).any(same) {
                return Vec::new();
            }
            let all = hashes(|_| true);
            let mut repeated: Vec<u32> =
                all.windows(2).filter(|pair| same(pair)).map(|pair| pair[1].1).collect();
            repeated.sort_unstable();
            repeated
        })
        .collect()
}

/// A hash of the bits of numbers.
pub(super) fn hash_of<'n>(numbers: impl Iterator<Item = &'n f64>) -> u64 {
    let mut hasher = BitsHasher::default();
    numbers.for_each(|x| hasher.write_u64(x.to_bits()));
    hasher.finish()
}
