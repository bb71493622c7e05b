//! A sheet that bends without stretch: every later scan tells another state of the one sheet that the first
//! one saw.
//!
//! Comes in: scans of at least two times. Goes out: the state at the last time as a model, with those before
//! it, and a [`BendingReport`].
//!
//! The first state is a plain fit; its parameters name the points of the sheet from then on. The vertices of
//! every later state are those which the state before, the readings, and the lengths of the first state make
//! most likely, by Gauss–Newton with three unknowns a vertex:
//!
//! - readings, along the normal of their foot points;
//! - lengths along the sheet as they were ([`Metric`]), each known to a share `σ`: what sheets stretch, and
//!   what the first state does not know of its own lengths: a height error `σ_h` over a curvature `κ` changes
//!   squares of lengths by `2 κ σ_h`, over a leaf of size `ℓ` by `(σ_h/ℓ)²`. It starts large and shrinks from
//!   iteration to iteration, so that the sheet finds the readings first and its lengths then;
//! - that the displacement since the state before is smooth: a thin plate whose weight `λ` marginal
//!   likelihood chooses (generalised Fellner–Schall, `λ ← (rank K − λ tr Λ⁻¹K) / dᵀKd`);
//! - readings beyond the border pull it to them, as no reading lies off the sheet;
//! - a trace that holds points where they were along the sheet. Sliding along itself changes neither shape
//!   nor lengths of a developable sheet: only its borders tell it.
//!
//! What no scan of a time saw is carried there by the lengths, from the times that did see it:
//! [`Observed::Invented`].
//!
//! Not guaranteed: that a sheet is found which moved by more than it can be laid on from where it was (slopes
//! change by less than about 60°); that points keep their places along the sheet where the first scan saw
//! less of it than others; that a stretch is noticed which no curvature and no border shows.
//!
//! # References
//! The paper on Kalman spline fusion, section 3.3, which asks for constant Gaussian curvature; that is no
//! isometry (do Carmo 1976, section 4.3). Wood & Fasiolo, *A generalized Fellner–Schall method for smoothing
//! parameter optimization*, Biometrics 73 (2017), eq. 6.

mod state;

use super::observations::{ObservationOptions, Quantity};
use super::stages::{base_shape, leaf_areas};
use super::{Filter, Fit, FitOptions, finish, fit, observation_options, observe, some_scans};
use crate::model::{Observed, Posterior, SensorReport};
use crate::progress::{Part, Progress};
use crate::propagate::{BendingReport, BendingState, PropagationReport, State, states_in_time};
use planish_estimate::vector3::add_scaled;
use planish_estimate::{Error, ErrorKind, Result};
use planish_exchange::ScanSet;
use planish_spline::{Metric, Shape, Surface, SurfaceSystem};
use state::{Laid, Sheet};
use std::sync::Arc;

/// Lengths of paper, leather and metal change by less than this share before they tear or yield: paper tears
/// at one to three per cent, steel yields at 0.2 %, and bending by hand strains them far less.
const SIGMA_STRETCH: f64 = 1e-3;
/// Cells are divided, so often at most, while residuals are larger than noise by this factor.
const MOST_DIVISIONS: usize = 2;
const DIVIDED_ABOVE: f64 = 1.05;
/// A sheet has stretched when E, F or G changes by more, residuals are larger than noise by more, or a larger
/// share of readings lies beyond its border.
const MOST_CHANGE: f64 = 0.01;
const MOST_MISFIT: f64 = 1.2;
const MOST_BEYOND: f64 = 0.005;

/// Follows a sheet from state to state; the model is the last of them.
///
/// # Errors
/// `Input` for scans of one time and for closed shapes; `Unsupported` beside what else needs the whole of the
/// readings.
pub(super) fn fit_bending(set: &ScanSet, options: &FitOptions, progress: &dyn Progress) -> Result<Fit> {
    let states = states_in_time(set)?;
    refuse(options)?;
    let first_scans = some_scans(set, &states[0].scans);
    if options.shape.is_none() {
        // Before the work of a fit.
        let mut readings = observe(&first_scans, &observation_options(set, options))?;
        readings.recentre();
        refuse_other_than_sheet(set, &states[0], base_shape(&readings, None)?.shape)?;
    }
    let still = FitOptions { motion: None, ..options.clone() };
    let first = fit(&first_scans, &still, &Part::new(progress, 0.0, 0.3))?;
    refuse_other_than_sheet(set, &states[0], first.model.surface.space().shape())?;
    let mut reference = first.model.surface.clone();
    for divisions in 0.. {
        let from = 0.3 + 0.2 * divisions as f64;
        let part = Part::new(progress, from, from + 0.2);
        let followed = follow(set, &states, &first, &reference, &still, &part)?;
        let worst = followed.iter().map(|(_, state)| state.misfit).fold(0.0, f64::max);
        let space = reference.space();
        let finer = space.refine(&(0..space.leaves().len()).collect::<Vec<_>>());
        if worst < DIVIDED_ABOVE
            || divisions == MOST_DIVISIONS
            || finer.node_count() > options.max_coefficients
        {
            return Ok(reported(set, &states[0], first, followed, divisions));
        }
        reference = reference.refined(Arc::new(finer))?;
    }
    unreachable!("the loop ends by returning")
}

/// Refuses a first state of any shape but that of a sheet.
fn refuse_other_than_sheet(set: &ScanSet, first: &State, shape: Shape) -> Result<()> {
    if shape == Shape::Sheet {
        return Ok(());
    }
    Err(Error::input(format!(
        "{}: --motion bend follows sheets, which have one border; the first state looks like a {}: if it is a sheet, say --shape sheet",
        set.scans[first.scans[0]].scan.name,
        shape.name()
    )))
}

/// What does not go together with bending.
fn refuse(options: &FitOptions) -> Result<()> {
    let asked = [
        (options.filter == Some(Filter::Patch), "--filter patch"),
        (options.symmetry.is_some(), "--symmetry"),
        (options.complete_smooth, "--complete"),
        (options.align, "--align"),
        (options.known_parameters.is_some(), "--known-uv"),
        (options.ground.is_some(), "--ground"),
    ];
    if let Some((_, name)) = asked.iter().find(|(asked, _)| *asked) {
        return Err(Error::unsupported(format!(
            "--motion bend does not go together with {name}: every state of the sheet is fitted for itself, to the one before"
        )));
    }
    match options.shape {
        Some(shape) if shape != Shape::Sheet => Err(Error::input(format!(
            "--motion bend follows sheets, which have one border: needed --shape sheet, found {}",
            shape.name()
        ))),
        _ => Ok(()),
    }
}

/// What is known of the sheet's lengths.
struct Lengths {
    metric: Metric,
    /// σ of the square of a length, leaf by leaf.
    sigma: Vec<f64>,
    /// Whether some state so far has measured the leaf.
    measured: Vec<bool>,
}

/// Carries the sheet through all states after the first; a fit and its figures for each.
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
        let progress = Part::new(progress, share(k), share(k + 1));
        let scans = some_scans(set, &state.scans);
        let mut observations =
            observe(&scans, &ObservationOptions { sheet: true, ..observation_options(set, options) })?;
        let origin = observations.recentre();
        let previous = moved(&surface, origin.map(|c| -c))?;
        let sheet = Sheet { system: &system, lengths: &lengths, previous: &previous, options };
        let laid = sheet.settle(&mut observations, &progress).map_err(|e| match e.kind() {
            ErrorKind::Undetermined => e.in_context(format!(
                "{}: the sheet cannot be bent to all readings of its time; is the time right, and the shape one?",
                state.name(set)
            )),
            _ => e.in_context(state.name(set)),
        })?;
        let Laid { settled, beyond, held } = laid;
        let quiet = crate::progress::Silent;
        let mut made = finish::finish(&scans, &observations, settled, options, None, None, origin, &quiet)?
            .translated(origin)?;
        surface = made.model.surface.clone();
        lengths.carry_into(&mut made, &held);
        let figures = lengths.judge(&scans, state, &made, &first.report.sensors, beyond)?;
        lengths.learn(&made)?;
        followed.push((made, figures));
    }
    Ok(followed)
}

fn moved(surface: &Surface, by: [f64; 3]) -> Result<Surface> {
    surface.with_vertices(surface.vertices().iter().map(|p| add_scaled(*p, 1.0, by)).collect())
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

    /// Marks what a state knows from other times: parts without a reading of its own, even if one is near.
    fn carry_into(&self, state: &mut Fit, held: &[bool]) {
        for ((now, held), measured) in state.model.observed.iter_mut().zip(held).zip(&self.measured) {
            if !held && *measured {
                *now = Observed::Invented;
            }
        }
    }

    /// Learns the lengths of what a state was the first to see.
    fn learn(&mut self, state: &Fit) -> Result<()> {
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

    /// The figures of a state that has come to rest.
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
        let (mut mean, mut largest) = ([0.0; 3], [0.0_f64; 3]);
        let mut area = 0.0;
        let changes = self.metric.changes(&made.model.surface)?;
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
        let stretched = largest.iter().any(|c| *c > MOST_CHANGE);
        let off = beyond_border as f64 > MOST_BEYOND * readings as f64;
        Ok(BendingState {
            scans: names(scans),
            time_s: state.time_s,
            observations: readings,
            rms: made.report.rms,
            sigma,
            misfit,
            mean_change: mean.map(|c| c / area.max(f64::MIN_POSITIVE)),
            largest_change: largest,
            beyond_border,
            isometric: !(stretched || off || misfit > MOST_MISFIT),
            measured_area_fraction: share_of(&measured_now),
            carried_area_fraction: share_of(&|leaf| made.model.observed[leaf] == Observed::Invented),
            sigma_surface: made.report.sigma.median,
        })
    }
}

fn names(scans: &ScanSet) -> Vec<String> {
    scans.scans.iter().map(|posed| posed.scan.name.clone()).collect()
}

/// σ of the square of a length that a fit knows by the heights of its surface.
fn sigma_of_lengths(posterior: &Posterior<'_>, leaf: usize, local: [f64; 2]) -> Result<f64> {
    let surface = posterior.surface();
    let jet = surface.leaf_jet(leaf, local[0], local[1]);
    let side = surface.space().leaves()[leaf].side();
    let [e, _, g] = jet.first_form();
    let (Some(normal), Some(curvature)) = (jet.normal(), jet.curvature()) else {
        return Ok(1.0);
    };
    let height = Posterior::sigma_along(&posterior.leaf(leaf)?, local, normal);
    let bend = curvature.principal.iter().fold(0.0_f64, |most, k| most.max(k.abs()));
    let slope2 = height * height / (e.min(g) * side * side);
    Ok((2.0 * SIGMA_STRETCH).hypot(2.0 * bend * height).hypot(slope2))
}

/// σ of the positions of a state's sensors: as stated, or as the first state says of those that state none.
fn noise_of(sensors: &[SensorReport], first: &[SensorReport]) -> f64 {
    let positions = sensors.iter().filter(|s| s.quantity == Quantity::Position.name());
    let (mut square, mut count) = (0.0, 0.0);
    for sensor in positions {
        let known = first.iter().find(|f| f.name == sensor.name && f.quantity == sensor.quantity);
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

/// The last state as the answer, those before it kept, all told in the report.
fn reported(
    set: &ScanSet,
    state: &State,
    first: Fit,
    mut followed: Vec<(Fit, BendingState)>,
    divisions: usize,
) -> Fit {
    let sigma = noise_of(&first.report.sensors, &first.report.sensors);
    let mut states = vec![BendingState {
        scans: names(&some_scans(set, &state.scans)),
        time_s: state.time_s,
        observations: first.report.observations,
        rms: first.report.rms,
        sigma,
        misfit: first.report.rms / sigma,
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
    last.report.observed_area_fraction = last.model.area_fraction(Observed::Measured);
    last.earlier_states = std::iter::once(first).chain(followed.into_iter().map(|(fit, _)| fit)).collect();
    let stretched: Vec<&BendingState> = states.iter().filter(|state| !state.isometric).collect();
    last.report.warnings.extend(stretched.iter().map(|state| warning(state)));
    let invented_area_fraction = last.model.area_fraction(Observed::Invented);
    last.report.propagation = Some(PropagationReport {
        bending: Some(BendingReport {
            sigma_stretch: SIGMA_STRETCH,
            isometric: stretched.is_empty(),
            divisions,
            states,
        }),
        invented_area_fraction,
        ..PropagationReport::default()
    });
    last
}

fn warning(state: &BendingState) -> String {
    let change = state.largest_change.iter().copied().fold(0.0, f64::max);
    format!(
        "{}: not the sheet of the first scan, bent and not stretched: E, F or G changes by up to {:.1} %, residuals are {:.2} times their noise, and {} of {} \
         readings lie beyond the border; what was carried there from other times does not hold",
        state.scans.join(", "),
        100.0 * change,
        state.misfit,
        state.beyond_border,
        state.observations
    )
}
