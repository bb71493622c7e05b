//! Fits of readings whose parameters are known: one linear problem, solved exactly.
//!
//! Input: scans with the columns `u` and `v` in `[0, 1]`. Output: a model whose vertices have a full
//! covariance, not along normals only. Readings are summed over cells and not kept. A round gates them by the
//! last surface and weighs sensors by their residuals, until neither changes.
//!
//! A coordinate that is an affine function of `(u, v)`, like the plan of a height field, has no noise: it is
//! reproduced exactly. The other coordinates share the noise of their reading.
//!
//! Not guaranteed: that readings with wrong parameters are found.

mod readings;

use super::finish::{common_findings, has_uncertain_pose, scan_pose_reports};
use super::leaves::with_neighbours;
use super::noise::{
    MIN_FOR_CONTRADICTION, MIN_REDUNDANCY, ResidualSums, STATED_SIGMA_TOLERANCE, kept_variance,
};
use super::shared_errors::{MAX_OVERSTATEMENT, combined_variance};
use super::smoothing::{Smoothing, Totals, reference_surface};
use super::{Fit, FitOptions, FitReport, FitTermination, HeldOut};
use crate::model::{
    Knowledge, NodeCovariance, Observed, Posterior, SensorReport, Support, SurfaceModel, SurfaceTopology,
    VertexInformation,
};
use crate::observe::{Quantity, RejectionCause};
use planish_core::Progress;
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_estimate::sparse::{BlockInformation, SelectedInverse};
use planish_estimate::{Error, Result};
use planish_exchange::{ScanSet, Unit};
use planish_mesh::BoundingBox;
use planish_spline::{Hierarchy, PositionSums, Shape, Surface, SurfaceSystem, leaf_weights};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

use readings::{Evaluation, Reading, Readings, TASK};

/// Maximum number of rounds of weighing and gating.
const MAX_ROUNDS: u32 = 20;
/// Relative change of a sensor's variance below which it has converged.
const CONVERGED_VARIANCE: f64 = 0.01;
/// Share of the readings that may still change sides of the gate, if none of them is more than
/// [`MARGIN_SIGMAS`] σ beyond it. Such readings would otherwise alternate without end.
const CONVERGED_GATE: f64 = 1e-4;
const MARGIN_SIGMAS: f64 = 1.0;
/// Maximum number of rounds with softened readings, and the relative change of a variance that asks for
/// another one.
const BOUNDED_ROUNDS: u32 = 8;
const FOUND_VARIANCE: f64 = 0.1;
/// Largest number of cells. The covariance takes about 20 KB for each, so more would exceed the memory of
/// most machines.
const MAX_CELLS: usize = 1 << 18;
/// Information of an exact coordinate over that of the others: firm, but far from the limits of rounding.
const EXACT_INFORMATION_RATIO: f64 = 1e6;

/// Fits a uniform grid of `cells` to readings with known parameters.
///
/// # Errors
/// `Input` if a scan has no parameters, or some outside `[0, 1]`; `Unsupported` for noise that depends on
/// direction; `Undetermined` if the readings do not determine the surface.
pub(super) fn fit_known_parameters(
    set: &ScanSet,
    cells: [usize; 2],
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Fit> {
    let shape = options.shape.unwrap_or(Shape::Sheet);
    refuse_too_many(cells)?;
    let space = Arc::new(Hierarchy::uniform(shape, cells)?);
    let mut readings = Readings::new(set, cells, options)?;
    progress.check("equations", 0.02)?;
    let (mut system, mut sums) = (None, Vec::new());
    // The system of equations is prepared on one thread while the readings are summed.
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
    // A round solves, and then updates the variances of sensors and the rejected readings. The rounds end
    // when neither changes noticeably.
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
                    // The metric of a closed shape is only known from a first surface.
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
        // Gross errors drag the first surface along, and the gate with it. Softened weights free the surface
        // from them within a few rounds.
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
            // The weight found with gross errors is a poor start.
            earlier = None;
            continue;
        }
        // A single sensor needs no weighing: a common factor cancels in the restricted likelihood.
        let same_noise = variances.len() == 1 || !far_apart(&now, &variances, CONVERGED_VARIANCE);
        let is_marginal = changed as f64 <= CONVERGED_GATE * total.sums.count() as f64
            && examined.farthest_new <= options.gate + MARGIN_SIGMAS;
        let converged = same_noise && readings.softening.is_none() && (changed == 0 || is_marginal);
        if converged || round == MAX_ROUNDS {
            readings.set_gated(examined.gated);
            let solved = Solved {
                sums,
                total,
                variances,
                smoothing,
                surface,
                evaluation,
                residuals: examined.residuals,
                reached_limit: !converged,
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

/// True if any variance of `a` differs from that of `b` by more than the given share.
fn far_apart(a: &[f64], b: &[f64], share: f64) -> bool {
    a.iter().zip(b).any(|(a, b)| (a / b - 1.0).abs() > share)
}

/// Refuses grids whose covariance takes too much memory.
fn refuse_too_many(cells: [usize; 2]) -> Result<()> {
    let many = cells[0].saturating_mul(cells[1]);
    if many <= MAX_CELLS {
        return Ok(());
    }
    Err(Error::input(format!(
        "expected at most {MAX_CELLS} cells (each needs about 20 KB for its covariance), found {} × {} \
         = {many}",
        cells[0], cells[1]
    )))
}

/// Number of entries that are in only one of two lists of ascending lists.
fn difference(a: &[Vec<u32>], b: &[Vec<u32>]) -> usize {
    a.iter()
        .zip(b)
        .map(|(a, b)| {
            let common = a.iter().filter(|k| b.binary_search(k).is_ok()).count();
            a.len() + b.len() - 2 * common
        })
        .sum()
}

/// A converged fit without its figures.
struct Solved {
    /// The sums of every sensor, weighted by its stated σ.
    sums: Vec<PositionSums>,
    total: Totals,
    /// Each sensor's variance over that stated, up to a common factor; 1 for a single sensor.
    variances: Vec<f64>,
    smoothing: Smoothing,
    surface: Surface,
    evaluation: Evaluation,
    residuals: Vec<ResidualSums>,
    reached_limit: bool,
}

/// σ of the readings, up to which the figures of a fit are scaled.
struct NoiseScale {
    /// Estimated variance over that stated, up to each sensor's own factor.
    estimated: f64,
    /// The variance that is used: that of a sensor whose stated σ is accepted, or the estimate.
    used: f64,
    /// For each sensor, true if its stated σ is accepted.
    accepted: Vec<bool>,
    /// For each sensor, the share of the stated variance that neighbouring readings have in common.
    shared: Vec<f64>,
    /// `Σ w r²` and the number of residuals less the degrees of freedom.
    weighted: f64,
    redundant: f64,
    /// The share of the variance that the gate leaves.
    kept: f64,
    is_gated: bool,
}

impl Solved {
    fn count(&self) -> usize {
        self.residuals.iter().map(|r| r.count).sum()
    }

    /// Number of measured coordinates.
    fn coordinates(&self) -> f64 {
        self.smoothing.measured.iter().filter(|m| **m).count() as f64
    }

    /// The model, its covariance and the report.
    fn finish(
        mut self,
        readings: &Readings<'_>,
        system: &SurfaceSystem,
        progress: &dyn Progress,
    ) -> Result<Fit> {
        // All measured coordinates have the same information, so one inverse serves them.
        let mut inverse = SelectedInverse::new(&self.smoothing.factor);
        let mut degrees = self.coordinates() * inverse.trace_with(&self.total.information)?;
        let numbers = self.coordinates() * self.count() as f64;
        let has_redundancy = degrees < (1.0 - MIN_REDUNDANCY) * numbers;
        // Residuals of a surface that follows its readings carry no information about σ (decision 0012).
        if !has_redundancy {
            self = self.with_stated_noise(readings, system)?;
            inverse = SelectedInverse::new(&self.smoothing.factor);
            degrees = self.coordinates() * inverse.trace_with(&self.total.information)?;
        }
        progress.check("covariance", 0.8)?;
        let noise = self.noise_scale(readings, degrees, has_redundancy)?;
        let model = self.model(readings, &noise)?;
        let covariance =
            Arc::new(NodeCovariance::of_coordinates(inverse, self.smoothing.measured, noise.used));
        progress.check("figures", 0.9)?;
        let report = self.report(readings, &noise, &model, &covariance)?;
        progress.advance("done", 1.0);
        Ok(Fit { model, report, earlier_states: Vec::new(), formation: None, readings: None, covariance })
    }

    /// Solves again with the stated σ.
    ///
    /// A surface with nearly as many degrees of freedom as readings can follow them exactly. Then only a
    /// stated σ separates noise from shape.
    fn with_stated_noise(self, readings: &Readings<'_>, system: &SurfaceSystem) -> Result<Self> {
        if !readings.stated.iter().all(|stated| *stated) {
            let [nu, nv] = system.space().base();
            return Err(Error::undetermined(format!(
                "{} readings on {nu} × {nv} cells cannot separate noise from shape: specify σ (the column \
                 sigma, or of a sensor), add readings, or use fewer cells",
                self.count()
            )));
        }
        let variances = vec![1.0; self.variances.len()];
        // The sums so far are weighted by the estimated variances of the sensors.
        let total = Totals::new(&self.sums, &variances, system)?;
        let smoothing = self.smoothing.with_stated_noise(system, &total)?;
        let surface = smoothing.surface(system, &total)?;
        let evaluation = Evaluation::new(&surface, smoothing.measured);
        let residuals = readings.examine(&evaluation, &variances)?.residuals;
        Ok(Self { total, variances, smoothing, surface, evaluation, residuals, ..self })
    }

    /// σ² of the readings: their weighted squares over their redundancy.
    fn noise_scale(&self, readings: &Readings<'_>, degrees: f64, has_redundancy: bool) -> Result<NoiseScale> {
        let is_gated = readings.gated.iter().any(|gated| !gated.is_empty());
        // The residuals are those of a truncated normal only if the gate has removed any.
        let kept = if is_gated { kept_variance(readings.options.gate)? } else { 1.0 };
        let weighted: f64 = self.residuals.iter().zip(&self.variances).map(|(r, v)| r.weighted / v).sum();
        let redundant = (self.coordinates() * self.count() as f64 - degrees).max(1.0);
        let estimated = (weighted / (redundant * kept)).max(min_variance(&self.surface, &self.total));
        let may_contradict = has_redundancy && redundant > MIN_FOR_CONTRADICTION;
        // Estimated over stated σ.
        let ratio = |s: usize| (estimated * self.variances[s]).sqrt();
        let accepted: Vec<bool> = (0..self.variances.len())
            .map(|s| {
                // Small residuals do not prove a small σ: the surface follows errors that neighbours share.
                let may_lower = readings.options.estimate_sigma;
                let least = if may_lower { 1.0 / STATED_SIGMA_TOLERANCE } else { 0.0 };
                let agrees = || (least..STATED_SIGMA_TOLERANCE).contains(&ratio(s));
                readings.stated[s] && (!may_contradict || agrees())
            })
            .collect();
        let shared = (0..self.variances.len())
            .map(|s| {
                let is_shared = accepted[s] && may_contradict && MAX_OVERSTATEMENT * ratio(s) < 1.0;
                if is_shared { 1.0 - ratio(s).powi(2) } else { 0.0 }
            })
            .collect();
        // All variances share one factor, so one accepted sensor fixes the scale of all.
        let used = match (0..self.variances.len()).find(|&s| accepted[s] && self.residuals[s].count > 0) {
            Some(s) => 1.0 / self.variances[s],
            None => estimated,
        };
        Ok(NoiseScale { estimated, used, accepted, shared, weighted, redundant, kept, is_gated })
    }

    /// For each leaf the variance that readings have in common; empty if there is none.
    fn shared_variance(&self, noise: &NoiseScale) -> Vec<f64> {
        let sensors = (self.residuals.iter().zip(&self.variances).zip(&noise.shared))
            .filter(|((r, _), _)| r.count > 0)
            .map(|((r, v), share)| {
                let (n, variance) = (r.count as f64, r.variance / r.count as f64);
                [n / (variance * v), share * variance]
            });
        let common = combined_variance(sensors).unwrap_or(0.0);
        if common > 0.0 { vec![common; self.surface.space().leaves().len()] } else { Vec::new() }
    }

    fn sensor_reports(&self, readings: &Readings<'_>, noise: &NoiseScale) -> Vec<SensorReport> {
        (readings.set.sensors.iter().enumerate())
            .filter(|(s, _)| self.residuals[*s].count > 0)
            .map(|(s, sensor)| {
                let r = &self.residuals[s];
                let n = r.count as f64;
                let typical = (r.variance / n).sqrt();
                SensorReport {
                    name: sensor.name.clone(),
                    quantity: Quantity::Position.name().to_owned(),
                    observations: r.count,
                    sigma_stated: readings.stated[s].then_some(typical),
                    sigma_estimated: (noise.estimated * self.variances[s]).sqrt() * typical,
                    sigma_shared: Some(noise.shared[s])
                        .filter(|share| *share > 0.0)
                        .map(|share| share.sqrt() * typical),
                    rms: (r.square / (self.coordinates() * n)).sqrt(),
                    sigma_used_is_estimated: !noise.accepted[s],
                }
            })
            .collect()
    }

    fn model(&self, readings: &Readings<'_>, noise: &NoiseScale) -> Result<SurfaceModel> {
        let Self { total, smoothing, surface, .. } = self;
        let measured = smoothing.measured;
        let observed = with_neighbours(surface.space(), &total.sums.observed());
        // Prior and data are known up to one common factor on all variances, so both are divided by it.
        let weight = smoothing.found.weight / noise.used;
        let information = VertexInformation {
            prior: over_coordinates(&smoothing.energy, weight, measured, DVec3::ZERO)?,
            data: over_coordinates(&total.information, 1.0 / noise.used, measured, total.sums.origin())?,
        };
        Ok(SurfaceModel {
            unit: readings.set.unit.unwrap_or(Unit::Millimetre),
            unit_assumed: readings.set.unit.is_none(),
            known: Knowledge::PerCoordinate { information, measured },
            excess_variance: self.shared_variance(noise),
            support: Support::default(),
            predictive: None,
            observed: observed.into_iter().map(Observed::from_measured).collect(),
            sensors: self.sensor_reports(readings, noise),
            poses: scan_pose_reports(readings.set),
            smoothness_weight: weight,
            observations: self.count(),
            surface: surface.clone(),
        })
    }

    fn report(
        &self,
        readings: &Readings<'_>,
        noise: &NoiseScale,
        model: &SurfaceModel,
        covariance: &Arc<NodeCovariance>,
    ) -> Result<FitReport> {
        let posterior = Posterior::new(&model.surface, Arc::clone(covariance));
        let scales: Vec<f64> = self.variances.iter().map(|v| noise.used * v).collect();
        let held_out = readings.judge(&self.evaluation, &posterior, &scales, noise.is_gated)?;
        let unresolved_share = readings.unresolved_share(&self.evaluation, &scales);
        let sigma = posterior.sigma_summary(&model.observed)?;
        // All cells have the same sides, so shares of the area need only the area element at their middles.
        let areas: Vec<f64> = (0..model.observed.len())
            .map(|leaf| model.surface.leaf_jet(leaf, 0.5, 0.5).area_element())
            .collect();
        let observed_area: f64 =
            areas.iter().zip(&model.observed).filter(|(_, o)| o.is_measured()).map(|(a, _)| a).sum();
        let observed_share = observed_area / areas.iter().sum::<f64>();
        let square: f64 = self.residuals.iter().map(|r| r.square).sum();
        let n = self.coordinates() * self.count().max(1) as f64;
        let space = model.surface.space();
        let (rejected, total) = readings.rejected();
        let mut findings = common_findings(&model.sensors, model.unit, observed_share, 0.0, &rejected, total);
        if has_uncertain_pose(readings.set) {
            findings.push(Finding::new(
                FindingCode::PoseSigmaUnused,
                "with known parameters, poses are treated as exact: their σ was not used",
            ));
        }
        if let Some(share) = unresolved_share {
            let [nu, nv] = space.base();
            let text = format!(
                "{:.0} % of the variance of the residuals is unresolved shape: {nu} × {nv} cells are too \
                 few, or σ is too small",
                100.0 * share
            );
            findings.push(
                Finding::new(FindingCode::UnresolvedShape, text).with_setting(Setting::KnownParameters),
            );
        }
        Ok(FitReport {
            observations: self.count(),
            topology_margin: None,
            topology: SurfaceTopology::of(space),
            coefficients: space.node_count(),
            levels: 1,
            filter: super::Filter::Global,
            refined: Vec::new(),
            cells: space.leaves().len(),
            rms: (square / n).sqrt(),
            rms_normalised: (noise.weighted / (noise.used * n)).sqrt(),
            reduced_chi_square: noise.weighted / (noise.used * noise.redundant * noise.kept),
            findings,
            rejected,
            sensors: model.sensors.clone(),
            poses: model.poses.clone(),
            sigma,
            creases: None,
            observed_area_fraction: observed_share,
            // Unresolved shape is a finding here, because it is known for the grid as a whole only.
            unresolved_shape: None,
            verdict: super::FitVerdict::Converged,
            unresolved_area_fraction: 0.0,
            unresolved_places: Vec::new(),
            misfit: None,
            smoothness_weight: model.smoothness_weight,
            propagation: None,
            held_out,
            termination: if self.reached_limit { FitTermination::Limit } else { FitTermination::Converged },
        })
    }
}

impl Readings<'_> {
    /// Rejected readings by cause, and the number of readings before any rejection.
    fn rejected(&self) -> (BTreeMap<String, usize>, usize) {
        let not_finite: usize = self.set.scans.iter().map(|posed| posed.scan.dropped_not_finite).sum();
        let gated: usize = self.gated.iter().map(Vec::len).sum();
        let repeated: usize = self.repeated.iter().map(Vec::len).sum();
        let causes = [
            (RejectionCause::NotFinite, not_finite),
            (RejectionCause::Duplicate, repeated),
            (RejectionCause::Outlier, gated),
        ];
        let rejected = (causes.into_iter())
            .filter(|(_, n)| *n > 0)
            .map(|(cause, n)| (cause.name().to_owned(), n))
            .collect();
        (rejected, self.total + not_finite)
    }

    /// Root mean square of the held-out readings: each measured coordinate's residual over
    /// `√(σ_reading² + σ_surface²)`, behind the gate of the fit.
    ///
    /// `scales` is the variance of each sensor over that stated.
    fn judge(
        &self,
        surface: &Evaluation,
        posterior: &Posterior<'_>,
        scales: &[f64],
        is_gated: bool,
    ) -> Result<HeldOut> {
        let gate = if is_gated { self.options.gate } else { f64::INFINITY };
        let Some(&measured) = surface.coordinates.first() else {
            return Err(Error::undetermined("expected measured coordinates, found none"));
        };
        // All measured coordinates have the same variance, so one of them stands for all.
        let mut axis = DVec3::ZERO;
        axis[measured] = 1.0;
        // Sorted by leaf, because the covariance of a leaf takes longest.
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
                    let of_reading = scales[self.set.scans[*s].sensor] / reading.information;
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

/// Variance of rounding.
fn min_variance(surface: &Surface, total: &Totals) -> f64 {
    let size = BoundingBox::from_points(surface.vertices()).map_or(0.0, |b| b.diagonal());
    // Exact readings would make σ zero and the weights infinite.
    let typical = total.sums.count().max(1) as f64 / total.sums.weight();
    ((1e-12 * size).powi(2) / typical).max(f64::MIN_POSITIVE)
}

/// Information of one unknown for each node, expanded to three coordinates, times `factor`, and moved from
/// `origin` to the world's origin. Exact coordinates are held much firmer.
fn over_coordinates(
    information: &BlockInformation,
    factor: f64,
    measured: [bool; 3],
    origin: DVec3,
) -> Result<BlockInformation> {
    let mut out = BlockInformation::zeros(Arc::clone(information.pattern()), 3, 1)?;
    let weights = measured.map(|m| if m { factor } else { EXACT_INFORMATION_RATIO * factor });
    (out.values_mut().par_chunks_exact_mut(9).zip(information.values())).with_min_len(TASK).for_each(
        |(block, value)| {
            for d in 0..3 {
                // Noise is independent of direction, so coordinates do not couple: only the diagonal is
                // filled.
                block[4 * d] = weights[d] * value;
            }
        },
    );
    // With η = Λ x, a shift of the origin by o adds Λ o, whose entries are row sums times o.
    let mut row_sums = vec![0.0; information.dimension()];
    if origin != DVec3::ZERO {
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
