//! A sheet that bends without stretch: every later scan measures another state of the sheet in the first
//! scan.
//!
//! Input: scans of at least two times. Output: the state at the last time as a model, the states before it,
//! and a [`BendingReport`].
//!
//! The first state is a plain fit; its parameters identify the points of the sheet from then on. The vertices
//! of every later state are the most likely ones given the state before, the readings, and the lengths of the
//! first state. They are found by Gauss–Newton with three unknowns for each vertex. Its terms are
//!
//! - readings, along the normal of their foot points;
//! - preserved lengths along the sheet ([`Metric`]), each with a relative `σ`. It contains the stretch of
//!   real sheets and the uncertainty of the first state: a height error `σ_h` at curvature `κ` changes
//!   squares of lengths by `2 κ σ_h`, and over a leaf of size `ℓ` by `(σ_h/ℓ)²`. It starts large and shrinks
//!   from iteration to iteration, so that the sheet finds its readings first and its lengths afterwards;
//! - a smooth displacement since the state before: a thin plate whose weight `λ` is chosen by marginal
//!   likelihood (generalised Fellner–Schall, `λ ← (rank K − λ tr Λ⁻¹K) / dᵀKd`);
//! - a pull of the border towards readings beyond it, since no reading lies off the sheet;
//! - a weak hold of points along the sheet. A developable sheet that slides along itself keeps its shape and
//!   lengths, so only its borders show the motion.
//!
//! Parts that no scan of a time measured follow by the lengths from other times:
//! [`Observed::Inferred`].
//!
//! Not guaranteed: that a sheet is found whose slopes changed by more than about 60°; that points keep their
//! places along the sheet where the first scan measured less of it than others; that a stretch is noticed
//! which neither curvature nor border shows.
//!
//! # References
//! The paper on Kalman spline fusion, section 3.3, which asks for constant Gaussian curvature; that is no
//! isometry (do Carmo 1976, section 4.3). Wood & Fasiolo, *A generalized Fellner–Schall method for smoothing
//! parameter optimization*, Biometrics 73 (2017), eq. 6.

mod state;

use super::PropagationReport;
use super::bending_report::{BendingReport, BendingState, State, states_in_time};
use super::finish::{FinishInput, finish};
use super::first::base_shape;
use super::leaves::leaf_areas;
use super::{Fit, FitOptions, GlobalOptions, fit, observation_options, observe, scans_of};
use crate::model::{Observed, Posterior, SensorReport};
use crate::observe::{ObservationOptions, Quantity};
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_core::{Progress, ProgressPart};
use planish_estimate::{Error, ErrorKind, Result};
use planish_exchange::ScanSet;
use planish_spline::{Metric, Shape, Surface, SurfaceSystem};
use state::{BentState, Sheet};
use std::sync::Arc;

/// Relative σ of lengths along a sheet.
///
/// Paper tears at a strain of 1 to 3 % and steel yields at 0.2 %; bending by hand strains them far less. See
/// decision 0020.
const SIGMA_STRETCH: f64 = 1e-3;
/// Cells are divided while residuals exceed noise by the factor [`DIVIDED_ABOVE`], at most this many times.
const MAX_DIVISIONS: usize = 2;
const DIVIDED_ABOVE: f64 = 1.05;
/// Limits beyond which a state is reported as stretched: relative change of E, F or G; residuals over their
/// noise; share of the readings beyond the border. See decision 0020 for the stretches that they
/// detect.
const MAX_CHANGE: f64 = 0.01;
const MAX_MISFIT: f64 = 1.2;
const MAX_BEYOND: f64 = 0.005;

/// Follows a sheet from state to state; the model is the last state.
///
/// # Errors
/// `Input` for scans of one time and for other shapes than sheets.
pub(super) fn fit_bending(set: &ScanSet, options: &FitOptions, progress: &dyn Progress) -> Result<Fit> {
    let states = states_in_time(set)?;
    refuse_other_shape(options)?;
    let first_scans = scans_of(set, &states[0].scans);
    if options.shape.is_none() {
        // The shape is checked before the work of a fit.
        let mut first_readings = observe(&first_scans, &observation_options(set, options))?;
        first_readings.recentre();
        refuse_other_than_sheet(set, &states[0], Some(base_shape(&first_readings.readings, None)?.shape))?;
    }
    let still = options.with_global(GlobalOptions::default());
    let first = fit(&first_scans, &still, &ProgressPart::new(progress, 0.0, 0.3))?;
    refuse_other_than_sheet(set, &states[0], first.model.surface.space().shape())?;
    let mut reference = first.model.surface.clone();
    // Lengths belong to the cells over which they are measured, so finer cells follow all states anew.
    for divisions in 0.. {
        let from = 0.3 + 0.2 * divisions as f64;
        let part = ProgressPart::new(progress, from, from + 0.2);
        let followed = follow(set, &states, &first, &reference, &still, &part)?;
        // Residuals above the noise mean that cells are too large for the bends, unless the sheet stretched.
        let worst = followed.iter().map(|(_, state)| state.misfit).fold(0.0, f64::max);
        let space = reference.space();
        let finer = space.refine(&(0..space.leaves().len()).collect::<Vec<_>>());
        if worst < DIVIDED_ABOVE
            || divisions == MAX_DIVISIONS
            || finer.node_count() > options.max_coefficients
        {
            return Ok(reported(set, &states[0], first, followed, divisions));
        }
        reference = reference.refined(Arc::new(finer))?;
    }
    unreachable!("the loop ends by returning")
}

/// Refuses a first state that is not a sheet.
fn refuse_other_than_sheet(set: &ScanSet, first: &State, shape: Option<Shape>) -> Result<()> {
    if shape == Some(Shape::Sheet) {
        return Ok(());
    }
    Err(Error::input(format!(
        "expected a sheet for bending, found a first state that looks like a {}: if it is a sheet, specify \
         this shape",
        shape.map_or("surface", Shape::name)
    ))
    .at(&set.scans[first.scans[0]].scan.name)
    .with_setting(Setting::Motion)
    .with_setting(Setting::Shape))
}

/// Refuses to follow another shape than a sheet.
fn refuse_other_shape(options: &FitOptions) -> Result<()> {
    match options.shape {
        Some(shape) if shape != Shape::Sheet => {
            Err(Error::input(format!("expected the shape sheet for bending, found {}", shape.name()))
                .with_setting(Setting::Motion)
                .with_setting(Setting::Shape))
        }
        _ => Ok(()),
    }
}

/// Lengths along the sheet, and their uncertainty.
struct Lengths {
    metric: Metric,
    /// Relative σ of the square of a length, for each leaf.
    sigma: Vec<f64>,
    /// For each leaf, true if some state so far has measured it.
    measured: Vec<bool>,
}

/// Follows the sheet through all states after the first; a fit and its figures for each.
fn follow(
    set: &ScanSet,
    states: &[State],
    first: &Fit,
    reference: &Surface,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Vec<(Fit, BendingState)>> {
    let system = SurfaceSystem::new(reference.space())?;
    let mut lengths = Lengths::of_first(first, reference)?;
    let mut surface = reference.clone();
    let mut followed: Vec<(Fit, BendingState)> = Vec::new();
    for (k, state) in states.iter().enumerate().skip(1) {
        let share = |k: usize| (k - 1) as f64 / (states.len() - 1) as f64;
        let progress = ProgressPart::new(progress, share(k), share(k + 1));
        let scans = scans_of(set, &state.scans);
        let mut observations =
            observe(&scans, &ObservationOptions { sheet: true, ..observation_options(set, options) })?;
        let origin = observations.recentre();
        let previous = moved(&surface, origin.map(|c| -c))?;
        // The state before is the start, and its displacement is kept smooth, so states are followed one by
        // one.
        let sheet = Sheet { system: &system, lengths: &lengths, previous: &previous, options };
        let converged_state = sheet.fit(&mut observations, &progress).map_err(|e| match e.kind() {
            ErrorKind::Undetermined => e
                .in_context(
                    "the fit of a bent sheet to all readings of one time failed: check the times of the \
                     scans, and that they show one sheet",
                )
                .at(state.name(set)),
            _ => e.at(state.name(set)),
        })?;
        let BentState { converged, beyond, held } = converged_state;
        let quiet = planish_core::Silent;
        let mut made = finish(FinishInput::new(&scans, &observations, options, origin), converged, &quiet)?
            .translated(origin)?;
        surface = made.model.surface.clone();
        // Marks come before the figures, since these are taken over measured parts only.
        lengths.carry_into(&mut made, &held);
        let figures = lengths.judge(&scans, state, &made, &first.report.sensors, beyond)?;
        // After the figures: a state must not be judged by lengths that it defined itself.
        lengths.add_measured(&made)?;
        followed.push((made, figures));
    }
    Ok(followed)
}

fn moved(surface: &Surface, by: DVec3) -> Result<Surface> {
    surface.with_vertices(surface.vertices().iter().map(|p| *p + by).collect())
}

impl Lengths {
    fn of_first(first: &Fit, reference: &Surface) -> Result<Self> {
        let space = reference.space();
        let original = first.model.surface.space();
        let posterior = first.posterior();
        let (mut sigma, mut measured) = (Vec::new(), Vec::new());
        for leaf in 0..space.leaves().len() {
            let [u, v] = space.parameters(leaf, [0.5, 0.5]);
            let (of_fit, local) = original.locate(u, v);
            sigma.push(sigma_of_lengths(&posterior, of_fit, local)?);
            measured.push(first.model.observed[of_fit].is_measured());
        }
        Ok(Self { metric: Metric::new(reference), sigma, measured })
    }

    /// Marks leaves without a reading of this state as inferred, if other times have measured them.
    fn carry_into(&self, state: &mut Fit, held: &[bool]) {
        for (leaf, (held, measured)) in held.iter().zip(&self.measured).enumerate() {
            if !held && *measured {
                state.model.set_inferred(leaf);
            }
        }
    }

    /// Adds the lengths of leaves that this state is the first to measure.
    fn add_measured(&mut self, state: &Fit) -> Result<()> {
        let own = Metric::new(&state.model.surface);
        let posterior = state.posterior();
        for leaf in 0..self.measured.len() {
            if state.model.observed[leaf].is_measured() && !self.measured[leaf] {
                self.metric.copy_leaf(leaf, &own);
                self.sigma[leaf] = sigma_of_lengths(&posterior, leaf, [0.5, 0.5])?;
                self.measured[leaf] = true;
            }
        }
        Ok(())
    }

    /// The figures of a converged state.
    fn judge(
        &self,
        scans: &ScanSet,
        state: &State,
        made: &Fit,
        first: &[SensorReport],
        beyond_border: usize,
    ) -> Result<BendingState> {
        let areas = leaf_areas(&made.model.surface);
        let total: f64 = areas.iter().sum();
        let (mut mean, mut largest) = (DVec3::ZERO, [0.0_f64; 3]);
        let mut area = 0.0;
        let changes = self.metric.changes(&made.model.surface)?;
        // Other leaves have no lengths of an earlier state to compare with.
        let leaves = (0..areas.len()).filter(|&leaf| self.measured[leaf]);
        for leaf in leaves {
            area += areas[leaf];
            for d in 0..3 {
                mean[d] += areas[leaf] * changes[leaf].mean[d];
                largest[d] = largest[d].max(changes[leaf].largest[d]);
            }
        }
        let share_of = |what: &dyn Fn(usize) -> bool| {
            let of_kind = (0..areas.len()).filter(|&leaf| what(leaf)).map(|leaf| areas[leaf]);
            of_kind.fold(0.0, |sum, area| sum + area) / total
        };
        let measured_now = |leaf: usize| made.model.observed[leaf].is_measured();
        let sigma = noise_of(&made.report.sensors, first);
        let misfit = made.report.rms / sigma;
        let readings = made.report.observations;
        // Any of three signs is enough. Growth within the plane changes no residual and shows at the border
        // only (decision 0020).
        let stretched = largest.iter().any(|c| *c > MAX_CHANGE);
        let off = beyond_border as f64 > MAX_BEYOND * readings as f64;
        Ok(BendingState {
            scans: names(scans),
            time_s: state.time_s,
            observations: readings,
            rms: made.report.rms,
            sigma,
            misfit,
            mean_change: mean.map(|c| c / area.max(f64::MIN_POSITIVE)).to_array(),
            largest_change: largest,
            beyond_border,
            isometric: !(stretched || off || misfit > MAX_MISFIT),
            measured_area_fraction: share_of(&measured_now),
            carried_area_fraction: share_of(&|leaf| made.model.observed[leaf] == Observed::Inferred),
            sigma_surface: made.report.sigma.median,
        })
    }
}

fn names(scans: &ScanSet) -> Vec<String> {
    scans.scans.iter().map(|posed| posed.scan.name.clone()).collect()
}

/// Relative σ of the square of a length, from σ of the heights of a surface.
fn sigma_of_lengths(posterior: &Posterior<'_>, leaf: usize, local: [f64; 2]) -> Result<f64> {
    let surface = posterior.surface();
    let jet = surface.leaf_jet(leaf, local[0], local[1]);
    let side = surface.space().leaves()[leaf].side();
    let [e, _, g] = jet.first_form();
    let (Some(normal), Some(curvature)) = (jet.normal(), jet.curvature()) else {
        // Without a tangent plane lengths are unknown, and a relative σ of 1 leaves them free.
        return Ok(1.0);
    };
    let height = Posterior::sigma_along(&posterior.leaf(leaf)?, local, normal);
    let bend = curvature.principal.iter().fold(0.0_f64, |largest, k| largest.max(k.abs()));
    let slope2 = height * height / (e.min(g) * side * side);
    // The three terms of the module's documentation: stretch, height error at a curvature, tilt of a leaf.
    Ok((2.0 * SIGMA_STRETCH).hypot(2.0 * bend * height).hypot(slope2))
}

/// σ of the positions of a state's sensors: the stated one, or the estimate of the first state.
fn noise_of(sensors: &[SensorReport], first: &[SensorReport]) -> f64 {
    let positions = sensors.iter().filter(|s| s.quantity == Quantity::Position.name());
    let (mut square, mut count) = (0.0, 0.0);
    for sensor in positions {
        let known = first.iter().find(|f| f.name == sensor.name && f.quantity == sensor.quantity);
        // A state that stretched would enlarge an estimate of its own and hide the misfit, so that of the
        // first state is preferred.
        let sigma = match (known, sensor.sigma_stated) {
            (Some(known), _) if known.sigma_used_is_estimated => known.sigma_estimated,
            (_, Some(stated)) => stated,
            _ => sensor.sigma_estimated,
        };
        square += sensor.observations as f64 * sigma * sigma;
        count += sensor.observations as f64;
    }
    (square / f64::max(count, 1.0)).sqrt()
}

/// The last state as the result, with the states before it and the report of all.
fn reported(
    set: &ScanSet,
    state: &State,
    first: Fit,
    mut followed: Vec<(Fit, BendingState)>,
    divisions: usize,
) -> Fit {
    let sigma = noise_of(&first.report.sensors, &first.report.sensors);
    let mut states = vec![BendingState {
        scans: names(&scans_of(set, &state.scans)),
        time_s: state.time_s,
        observations: first.report.observations,
        rms: first.report.rms,
        sigma,
        misfit: first.report.rms / sigma,
        // Changes are relative to this state.
        mean_change: [0.0; 3],
        largest_change: [0.0; 3],
        beyond_border: 0,
        isometric: true,
        measured_area_fraction: first.report.observed_area_fraction,
        carried_area_fraction: 0.0,
        sigma_surface: first.report.sigma.median,
    }];
    states.extend(followed.iter().map(|(_, state)| state.clone()));
    let Some((mut last, _)) = followed.pop() else {
        return first;
    };
    // Leaves without readings were marked as inferred after the report had been made.
    last.report.observed_area_fraction = last.model.area_fraction(Observed::Measured);
    last.earlier_states = std::iter::once(first).chain(followed.into_iter().map(|(fit, _)| fit)).collect();
    let stretched: Vec<&BendingState> = states.iter().filter(|state| !state.isometric).collect();
    last.report.findings.extend(stretched.iter().map(|state| stretched_finding(state)));
    let inferred_area_fraction = last.model.area_fraction(Observed::Inferred);
    last.report.propagation = Some(PropagationReport {
        bending: Some(BendingReport {
            sigma_stretch: SIGMA_STRETCH,
            isometric: stretched.is_empty(),
            divisions,
            states,
        }),
        inferred_area_fraction,
        ..PropagationReport::default()
    });
    last
}

fn stretched_finding(state: &BendingState) -> Finding {
    let change = state.largest_change.iter().copied().fold(0.0, f64::max);
    let text = format!(
        "{}: the sheet differs from that of the first scan by more than bending: E, F or G changes by up \
         to {:.1} %, residuals are {:.2} times their σ, and {} of {} readings are beyond the boundary; \
         parts transferred from other times are not valid",
        state.scans.join(", "),
        100.0 * change,
        state.misfit,
        state.beyond_border,
        state.observations
    );
    Finding::new(FindingCode::SheetStretched, text)
}
