//! Readings whose parameters are known: one linear problem, solved exactly.
//!
//! Comes in: scans with the columns `u` and `v` in `[0, 1]`. Goes out: a model whose vertices have a full
//! covariance, not along normals only. Readings stream through sums over cells; nothing is kept of them, and
//! only those outside the gate are gone back to.
//!
//! A coordinate that is an affine function of `(u, v)`, like the plan of a height field, has no noise: it is
//! reproduced and counts as exact. The others share the noise of their reading.
//!
//! Not guaranteed: that readings which were given wrong parameters are found out.

mod readings;

use super::finish::{has_uncertain_pose, pose_reports, warnings};
use super::noise::{ResidualSums, kept_variance};
use super::smoothing::{Smoothing, Totals, reference_surface};
use super::stages::with_neighbours;
use super::{Fit, FitOptions, FitReport, FitTermination, HeldOut};
use crate::model::{NodeCovariance, Observed, Posterior, SensorReport, SurfaceModel};
use crate::observe::{Quantity, Rejection};
use planish_core::Progress;
use planish_estimate::sparse::{BlockInformation, SelectedInverse};
use planish_estimate::{Error, Result};
use planish_exchange::{ScanSet, Unit};
use planish_mesh::BoundingBox;
use planish_spline::{Hierarchy, Shape, Surface, SurfaceSystem, leaf_weights};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

use readings::{Evaluation, Reading, Readings, TASK};

/// Rounds of weighing and gating; and what must change for another: shares of a variance, and of the
/// readings, if none of them is more than so many σ beyond the gate.
const MOST_ROUNDS: u32 = 20;
const SETTLED_VARIANCE: f64 = 0.01;
const SETTLED_GATE: f64 = 1e-4;
const MARGINAL: f64 = 1.0;
/// While gross errors are looked for: rounds at most, and which change of a variance makes another one worth
/// while.
const BOUNDED_ROUNDS: u32 = 8;
const FOUND_VARIANCE: f64 = 0.1;
/// Readings of which less than this share is free of the surface do not tell noise from shape; and fewer free
/// ones contradict no stated σ.
const LEAST_REDUNDANCY: f64 = 0.2;
const ENOUGH_TO_CONTRADICT: f64 = 20.0;
/// A grid of more cells takes more memory than most machines have.
const MOST_CELLS: usize = 1 << 18;
/// Stated σ are believed within this factor.
const BELIEVED: f64 = 1.1;
/// Information of an exact coordinate over that of the others.
const EXACT: f64 = 1e6;

/// Fits a uniform grid of so many cells to readings with known parameters.
///
/// # Errors
/// `Input` when a scan has no parameters, or some outside `[0, 1]`; `Unsupported` for noise that depends on
/// direction; `Undetermined` when the readings do not determine the surface.
pub(super) fn fit_known(
    set: &ScanSet,
    cells: [usize; 2],
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Fit> {
    let shape = options.shape.unwrap_or(Shape::Sheet);
    let many = cells[0].saturating_mul(cells[1]);
    if many > MOST_CELLS {
        return Err(Error::input(format!(
            "needed at most {MOST_CELLS} cells (each takes some 20 KB while its covariance is found), found {} × {} = {many}",
            cells[0], cells[1]
        )));
    }
    let space = Arc::new(Hierarchy::uniform(shape, cells)?);
    let mut readings = Readings::new(set, cells, options)?;
    progress.check("equations", 0.02)?;
    let (mut system, mut sums) = (None, Vec::new());
    rayon::in_place_scope(|scope| {
        scope.spawn(|_| system = Some(SurfaceSystem::new(&space)));
        sums = readings.sum(&space, progress)?;
        Ok::<_, Error>(())
    })?;
    let Some(system) = system else { unreachable!("the scope waits for the system") };
    let system = system?;
    let mut variances = vec![1.0; set.sensors.len()];
    let mut earlier: Option<Smoothing> = None;
    let mut bounded: Option<Vec<f64>> = None;
    for round in 1.. {
        progress.check("smoothing", 0.25 + 0.02 * f64::from(round))?;
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
        progress.check("gating", 0.26 + 0.02 * f64::from(round))?;
        let now = readings.robust_variances(&evaluation)?;
        let examined = readings.examine(&evaluation, &now)?;
        let changed = difference(&readings.gated, &examined.gated);
        // Gross errors drag the first surface along, and the gate with it: softened, they let go of it, a
        // round after the other.
        let is_plain = bounded.is_none() && readings.gated.iter().all(Vec::is_empty);
        let before = bounded.as_ref().filter(|_| readings.softening.is_some());
        let moves = before.is_some_and(|before| far_apart(&now, before, FOUND_VARIANCE));
        if (is_plain && changed > 0) || (moves && round <= BOUNDED_ROUNDS) {
            readings.soften(evaluation, now.clone());
            if variances.len() > 1 {
                variances.clone_from(&now);
            }
            bounded = Some(now);
            sums = readings.sum(&space, progress)?;
            // What gross errors made of the weight is no place to start from.
            earlier = None;
            continue;
        }
        let same_noise = variances.len() == 1 || !far_apart(&now, &variances, SETTLED_VARIANCE);
        let is_marginal = changed as f64 <= SETTLED_GATE * total.sums.count() as f64
            && examined.farthest_new <= options.gate + MARGINAL;
        let settled = same_noise && readings.softening.is_none() && (changed == 0 || is_marginal);
        if settled || round == MOST_ROUNDS {
            readings.set_gated(examined.gated);
            let solved = Solved {
                total,
                variances,
                smoothing,
                surface,
                evaluation,
                residuals: examined.residuals,
                reached_limit: !settled,
            };
            return solved.finish(&readings, &system, progress);
        }
        if variances.len() > 1 {
            variances = now;
        }
        let was_softened = readings.softening.is_some();
        if changed > 0 || was_softened {
            readings.set_gated(examined.gated);
            sums = readings.sum(&space, progress)?;
        }
        earlier = (!was_softened).then_some(smoothing);
    }
    unreachable!("the loop ends by returning")
}

/// Whether any of some variances differs from another by more than a share.
fn far_apart(a: &[f64], b: &[f64], share: f64) -> bool {
    a.iter().zip(b).any(|(a, b)| (a / b - 1.0).abs() > share)
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
    fn finish(
        mut self,
        readings: &Readings<'_>,
        system: &SurfaceSystem,
        progress: &dyn Progress,
    ) -> Result<Fit> {
        let count: usize = self.residuals.iter().map(|r| r.count).sum();
        let coordinates = self.smoothing.measured.iter().filter(|m| **m).count() as f64;
        let numbers = coordinates * count as f64;
        let mut inverse = SelectedInverse::new(&self.smoothing.factor);
        let mut degrees = coordinates * inverse.trace_with(&self.total.information)?;
        // So few readings may be followed wherever they go: then only a stated σ tells noise from shape.
        let is_free = degrees < (1.0 - LEAST_REDUNDANCY) * numbers;
        if !is_free {
            if !readings.stated.iter().all(|stated| *stated) {
                let [nu, nv] = system.space().base();
                return Err(Error::undetermined(format!(
                    "{count} readings on {nu} × {nv} cells do not tell noise from shape: needed their σ (the column sigma, or a sensor's), \
                     more of them, or fewer cells"
                )));
            }
            self.variances.fill(1.0);
            self.smoothing = self.smoothing.with_stated_noise(system, &self.total)?;
            self.surface = self.smoothing.surface(system, &self.total)?;
            self.evaluation = Evaluation::new(&self.surface, self.smoothing.measured);
            self.residuals = readings.examine(&self.evaluation, &self.variances)?.residuals;
            inverse = SelectedInverse::new(&self.smoothing.factor);
            degrees = coordinates * inverse.trace_with(&self.total.information)?;
        }
        let Self { total, variances, smoothing, surface, evaluation, residuals, reached_limit } = self;
        let set = readings.set;
        let measured = smoothing.measured;
        progress.check("covariance", 0.8)?;
        let is_gated = readings.gated.iter().any(|gated| !gated.is_empty());
        let kept = if is_gated { kept_variance(readings.options.gate)? } else { 1.0 };

        // σ² of the readings: residuals over what is left of their number.
        let count: usize = residuals.iter().map(|r| r.count).sum();
        let weighted: f64 = residuals.iter().zip(&variances).map(|(r, v)| r.weighted / v).sum();
        let redundant = (coordinates * count as f64 - degrees).max(1.0);
        let estimated = (weighted / (redundant * kept)).max(least_variance(&surface, &total));
        let contradicts = is_free && redundant > ENOUGH_TO_CONTRADICT;
        let believed = |s: usize| {
            let agrees = || (1.0 / BELIEVED..BELIEVED).contains(&(estimated * variances[s]).sqrt());
            readings.stated[s] && (!contradicts || agrees())
        };
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
            shape_left: Vec::new(),
            observed: observed.into_iter().map(Observed::of_measured).collect(),
            sensors: sensors.clone(),
            poses: pose_reports(set),
            smoothness_weight: smoothing.found.weight / scale,
            observations: count,
            measured_coordinates: Some(measured),
            moves_freely: false,
            patches: None,
            shared: None,
            surface,
        };
        let covariance = Arc::new(NodeCovariance::of_coordinates(inverse, measured, scale));
        let posterior = Posterior::new(&model.surface, Arc::clone(&covariance));
        progress.check("figures", 0.9)?;
        let held_out = readings.judge(&evaluation, &posterior, scale, &variances, is_gated)?;
        let scales: Vec<f64> = variances.iter().map(|v| scale * v).collect();
        let shape_left = readings.shape_left(&evaluation, &scales);
        let sigma = posterior.sigma_summary(&model.observed)?;
        let areas: Vec<f64> = (0..model.observed.len())
            .map(|leaf| model.surface.leaf_jet(leaf, 0.5, 0.5).area_element())
            .collect();
        let observed_area: f64 =
            areas.iter().zip(&model.observed).filter(|(_, o)| o.is_measured()).map(|(a, _)| a).sum();
        let square: f64 = residuals.iter().map(|r| r.square).sum();
        let n = coordinates * count.max(1) as f64;
        let not_finite: usize = set.scans.iter().map(|posed| posed.scan.dropped_not_finite).sum();
        let gated: usize = readings.gated.iter().map(Vec::len).sum();
        let repeated: usize = readings.repeated.iter().map(Vec::len).sum();
        let causes = [
            (Rejection::NotFinite, not_finite),
            (Rejection::Duplicate, repeated),
            (Rejection::Outlier, gated),
        ];
        let rejected: BTreeMap<String, usize> = causes
            .into_iter()
            .filter(|(_, n)| *n > 0)
            .map(|(cause, n)| (cause.name().to_owned(), n))
            .collect();
        let observed_share = observed_area / areas.iter().sum::<f64>();
        let mut warnings = warnings(&sensors, observed_share, 0.0, &rejected, readings.total + not_finite);
        if has_uncertain_pose(set) {
            warnings
                .push("where parameters are known poses are taken as exact: their σ was not used".to_owned());
        }
        if let Some(share) = shape_left {
            let [nu, nv] = model.surface.space().base();
            warnings.push(format!(
                "{:.0} % of the residuals' variance is shape that {nu} × {nv} cells cannot follow: take more cells, or σ is too small",
                100.0 * share
            ));
        }
        let report = FitReport {
            observations: count,
            shape: model.surface.space().shape().name().to_owned(),
            coefficients: model.surface.space().node_count(),
            levels: 1,
            filter: super::Filter::Global,
            refined: Vec::new(),
            cells: model.surface.space().leaves().len(),
            rms: (square / n).sqrt(),
            rms_normalised: (weighted / (scale * n)).sqrt(),
            reduced_chi_square: weighted / (scale * redundant * kept),
            warnings,
            rejected,
            sensors,
            poses: model.poses.clone(),
            sigma,
            observed_area_fraction: observed_share,
            shape_left: None,
            smoothness_weight: model.smoothness_weight,
            propagation: None,
            held_out,
            termination: if reached_limit { FitTermination::Limit } else { FitTermination::Converged },
        };
        progress.advance("done", 1.0);
        Ok(Fit { model, report, earlier_states: Vec::new(), forming: None, readings: None, covariance })
    }
}

impl Readings<'_> {
    /// Held-out readings: each measured coordinate's residual over `√(σ_reading² + σ_surface²)`, behind the
    /// same gate as all others.
    fn judge(
        &self,
        surface: &Evaluation,
        posterior: &Posterior<'_>,
        scale: f64,
        variances: &[f64],
        is_gated: bool,
    ) -> Result<HeldOut> {
        let gate = if is_gated { self.options.gate } else { f64::INFINITY };
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
            return Ok(HeldOut { n: 0, rms_normalised: f64::NAN });
        }
        let mean = kept.iter().sum::<f64>() / (kept.len() * surface.coordinates.len()) as f64;
        Ok(HeldOut {
            n: kept.len(),
            rms_normalised: if is_gated { (mean / kept_variance(gate)?).sqrt() } else { mean.sqrt() },
        })
    }
}

/// A variance that rounding alone leaves.
fn least_variance(surface: &Surface, total: &Totals) -> f64 {
    let size = BoundingBox::from_points(surface.vertices()).map_or(0.0, |b| b.diagonal());
    let typical = total.sums.count().max(1) as f64 / total.sums.weight();
    ((1e-12 * size).powi(2) / typical).max(f64::MIN_POSITIVE)
}

/// Information of one unknown a node over all three coordinates, times a factor, about the world's origin
/// where it was about another; exact coordinates are held much firmer.
fn over_coordinates(
    information: &BlockInformation,
    factor: f64,
    measured: [bool; 3],
    origin: [f64; 3],
) -> Result<BlockInformation> {
    let mut out = BlockInformation::zeros(Arc::clone(information.pattern()), 3, 1)?;
    let weights = measured.map(|m| if m { factor } else { EXACT * factor });
    (out.values_mut().par_chunks_exact_mut(9).zip(information.values())).with_min_len(TASK).for_each(
        |(block, value)| {
            for d in 0..3 {
                block[4 * d] = weights[d] * value;
            }
        },
    );
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
