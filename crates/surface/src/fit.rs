//! Fusing scans into a surface.

mod bending;
mod bending_report;
mod refine_by_curvature;
mod finish;
mod formation;
mod gaps;
mod growth;
mod indicator;
mod inferred;
mod known_parameters;
mod batches;
mod motion;
mod noise;
mod patch;
mod propagation;
mod refine_by_roughness;
mod unresolved_shape;
mod residual_sample;
mod smoothing;
mod stages;

pub use crate::model::SigmaSummary;
pub use formation::{Formation, Snapshot};
pub(crate) use patch::{FirstFit, first_fit_of};
pub use propagation::PropagationReport;
pub use unresolved_shape::UnresolvedShape;
pub use residual_sample::{ScanSummary, ResidualSample};
pub(crate) use stages::with_neighbours;

use crate::complete::{self, SymmetryChoice};
use crate::model::{NodeCovariance, Observed, Posterior, SurfaceModel};
use crate::observe::ScanErrors;
pub use crate::observe::{ObservationOptions, Observations, Quantity, RejectionCause};
pub use crate::subdivision::{LevelRefinement, RefineBy};
pub use bending_report::{BendingReport, BendingState};
use batches::Batches;
pub use motion::{MotionPose, MotionReport};
use motion::{RigidTracker, scans_in_time};
use planish_core::{Progress, ProgressPart};
use planish_estimate::vector3::{add, dot, norm, scale, unit};
use planish_estimate::{Error, Result};
use planish_exchange::{ScanSet, Unit};
use planish_sense::{GroundOptions, ScanChecks};
use planish_spline::{FootPointSearch, Shape};
use serde::Serialize;
use stages::ConvergedFit;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Settings of a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// The topology; chosen from the cloud where none is given.
    pub shape: Option<Shape>,
    /// Where the scans carry the parameters `u` and `v` in `[0, 1]` of their readings: the cells of the
    /// uniform grid that is fitted to them. The problem is linear then: no tolerance and no limit of
    /// coefficients apply.
    pub known_parameters: Option<[usize; 2]>,
    /// Refinement stops where the surface is this close to the points, in the model's unit; where their noise
    /// says so if none is given.
    pub tolerance: Option<f64>,
    /// Whether only the bare earth is wanted of scans from above; then the shape is a sheet.
    pub ground: Option<GroundWidth>,
    /// How readings are filtered: globally where none is given, and into a saved model as it was made.
    pub filter: Option<Filter>,
    /// No more levels of subdivision beyond the base grid than this; where none is given as many as the
    /// readings fill, of the patch filter three.
    pub max_depth: Option<u8>,
    /// What asks for subdivision.
    pub refine_by: RefineBy,
    /// Whether every scan but the first may stand elsewhere than its file says; poses with a stated σ may in
    /// any case.
    pub align: bool,
    /// No more control vertices than this.
    pub max_coefficients: usize,
    /// The symmetry by which parts that nobody saw are completed.
    pub symmetry: Option<SymmetryChoice>,
    /// How the thing moved while its scans were taken, at the times that they state; where none is given it
    /// stood still.
    pub motion: Option<ObjectMotion>,
    /// Whether gaps are completed by the simple shape of what surrounds them.
    pub complete_smooth: bool,
    /// How many snapshots are kept of the way from few readings to all of them, where any are wanted: see
    /// [`Fit::formation`].
    pub snapshots: Option<usize>,
    /// Readings farther from the surface than this many σ are outliers.
    pub gate: f64,
    /// Share of the readings held out to judge the fit.
    pub held_out_share: f64,
    /// Seed of every random choice.
    pub seed: u64,
    /// Checks of each scan.
    pub checks: ScanChecks,
}

/// How a thing moves from scan to scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectMotion {
    /// As a rigid body with a velocity of its own.
    Rigid,
    /// A sheet bends without stretch: lengths along it stay.
    Bend,
}

/// How readings are filtered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Filter {
    /// All at once: one sparse information matrix over all control vertices.
    #[default]
    Global,
    /// One after the other: a quadtree of patches with a dense covariance each; memory does not grow with the
    /// readings, and σ is known at any time.
    Patch,
}

/// How wide things are that stand on the ground and are no part of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GroundWidth {
    /// Up to 36 m: houses, and most of what else is in a landscape.
    Usual,
    /// Up to so much, in the unit of the scans.
    Widest(f64),
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            shape: None,
            known_parameters: None,
            tolerance: None,
            ground: None,
            filter: None,
            max_depth: None,
            refine_by: RefineBy::Residuals,
            align: false,
            max_coefficients: 12_000,
            symmetry: None,
            motion: None,
            complete_smooth: false,
            snapshots: None,
            gate: 4.0,
            held_out_share: 0.1,
            seed: 0,
            checks: ScanChecks::default(),
        }
    }
}

/// How an iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FitTermination {
    /// Nothing is left to refine and the surface has come to rest.
    Converged,
    /// The asked-for tolerance is reached.
    ReachedTolerance,
    /// The limit of coefficients or iterations was reached first.
    Limit,
}

/// Held-out readings against the surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HeldOut {
    /// How many were judged.
    pub n: usize,
    /// Root mean square of residual over its predicted σ: 1 when the stated uncertainties are true.
    pub rms_normalised: f64,
}

/// The figures of a fit: the keys of the JSON summary.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FitReport {
    /// Readings used.
    pub observations: usize,
    /// Readings left out, by cause.
    pub rejected: BTreeMap<String, usize>,
    /// The topology.
    pub shape: String,
    /// Control vertices.
    pub coefficients: usize,
    /// Levels of the hierarchy.
    pub levels: usize,
    /// Leaf cells.
    pub cells: usize,
    /// How readings were filtered.
    pub filter: Filter,
    /// What was divided, level by level, and why.
    pub refined: Vec<LevelRefinement>,
    /// Root mean square of the residuals along the normals, in the model's unit.
    pub rms: f64,
    /// The same over each residual's σ.
    pub rms_normalised: f64,
    /// Residual χ² over the degrees of freedom.
    pub reduced_chi_square: f64,
    /// Sensor by sensor.
    pub sensors: Vec<crate::model::SensorReport>,
    /// Scan by scan.
    pub poses: Vec<crate::model::ScanPoseReport>,
    /// σ along the normal.
    pub sigma: SigmaSummary,
    /// Shape that cells are too large to follow, as the readings show; it is in σ. None where they show none.
    #[serde(rename = "shape_left", skip_serializing_if = "Option::is_none")]
    pub unresolved_shape: Option<UnresolvedShape>,
    /// Share of the surface's area that was measured.
    pub observed_area_fraction: f64,
    /// Weight of the thin-plate energy, by marginal likelihood.
    pub smoothness_weight: f64,
    /// What was completed by what was measured elsewhere, where that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub propagation: Option<PropagationReport>,
    /// The judgement by points that took no part.
    pub held_out: HeldOut,
    /// How it ended.
    pub termination: FitTermination,
    /// What a user should know.
    pub warnings: Vec<String>,
}

impl FitReport {
    /// Readings that were set aside although they might have been of the surface: all but those of classes
    /// that are not wanted, and those above the ground where the ground is.
    #[must_use]
    pub fn rejected_readings(&self) -> usize {
        rejected_readings(&self.rejected)
    }
}

fn rejected_readings(rejected: &BTreeMap<String, usize>) -> usize {
    let unwanted = [RejectionCause::Class, RejectionCause::AboveGround]
        .map(|cause| rejected.get(cause.name()).copied().unwrap_or(0));
    rejected.values().sum::<usize>() - unwanted.iter().sum::<usize>()
}

/// A fitted model with its figures.
pub struct Fit {
    /// The model.
    pub model: SurfaceModel,
    /// The figures.
    pub report: FitReport,
    /// Of a sheet that bends, the states before the last, in the order of time; empty of everything else.
    pub earlier_states: Vec<Fit>,
    /// How the model formation_of_global_fit, reading by reading, where that was asked for.
    pub formation: Option<Formation>,
    /// Some of the readings with their residuals; none where parameters were known or a sheet bends.
    pub readings: Option<ResidualSample>,
    covariance: Arc<NodeCovariance>,
}

impl Fit {
    /// The same fit with every point moved.
    fn translated(mut self, by: [f64; 3]) -> Result<Self> {
        if by != [0.0; 3] {
            self.model = self.model.translated(by)?;
            self.formation = self.formation.map(|formation| formation.translated(by)).transpose()?;
            self.readings = self.readings.map(|readings| readings.translated(by));
        }
        Ok(self)
    }

    /// The posterior covariance of the model, which the fit has made already.
    #[must_use]
    pub fn posterior(&self) -> Posterior<'_> {
        Posterior::new(&self.model.surface, Arc::clone(&self.covariance))
            .with_unresolved_shape(&self.model.unresolved_shape)
    }
}

/// Fits a surface to scans.
///
/// # Errors
/// `Undetermined` when the points do not determine a surface; `Input` for values that make no sense;
/// `Interrupted` on request.
pub fn fit(set: &ScanSet, options: &FitOptions, progress: &dyn Progress) -> Result<Fit> {
    if options.snapshots.is_some()
        && (options.known_parameters.is_some() || options.motion == Some(ObjectMotion::Bend))
    {
        return Err(Error::unsupported(
            "--animate shows readings that come one after the other: needed a fit without --known-uv and --motion bend, which take all of a time at once",
        ));
    }
    if options.filter == Some(Filter::Patch) {
        patch::refuse_concluded(options)?;
    }
    if options.motion == Some(ObjectMotion::Rigid) && options.filter == Some(Filter::Patch) {
        return Err(Error::unsupported(
            "--motion rigid lays scans on the surface of the first, and needs the covariance of the whole of it: needed --filter global",
        ));
    }
    match options.motion {
        Some(ObjectMotion::Rigid) => return fit_moving(set, options, progress),
        Some(ObjectMotion::Bend) => return bending::fit_bending(set, options, progress),
        None => {}
    }
    if let Some(cells) = options.known_parameters {
        if options.filter == Some(Filter::Patch) {
            return Err(Error::unsupported(
                "readings with known parameters are fused by the global filter, in one step: needed no other filter",
            ));
        }
        return known_parameters::fit_known_parameters(set, cells, options, progress);
    }
    if options.filter == Some(Filter::Patch) {
        return patch::fit_patches(set, options, progress);
    }
    let ground = options.ground.map(|width| ground_options(set.unit, width));
    let sheet =
        FitOptions { shape: options.shape.or(options.ground.map(|_| Shape::Sheet)), ..options.clone() };
    let completes = options.symmetry.is_some() || options.complete_smooth;
    // Snapshots are of readings that are all there.
    let dealt = if completes || options.snapshots.is_some() {
        None
    } else {
        Batches::deal(set, options, ground.as_ref())?
    };
    let Some(parts) = dealt else {
        let mut observations = observe(set, &observation_options(set, options))?;
        let origin = observations.recentre();
        observations.scan_errors = ScanErrors::new(set, &observations, origin, options.align, None);
        progress.check("normals", 0.01)?;
        let (converged, propagation) = propagated(&mut observations, origin, &sheet, progress)?;
        let formation = (options.snapshots)
            .map(|frames| {
                formation::formation_of_global_fit(
                    &observations,
                    &converged,
                    options,
                    frames,
                    &ProgressPart::new(progress, 0.88, 0.9),
                )
            })
            .transpose()?;
        let mut fitted = finish::finish(set, &observations, converged, options, None, None, origin, progress)?;
        fitted.formation = formation;
        let inferred_area_fraction = fitted.model.area_fraction(Observed::Inferred);
        fitted.report.propagation =
            propagation.map(|found| PropagationReport { inferred_area_fraction, ..found });
        return fitted.translated(origin);
    };
    progress.check("dealing out", 0.01)?;
    let mut observations = {
        let first = parts.part(0);
        let options = observation_options(set, options);
        observe(&first, &ObservationOptions { ground: None, ..options })?
    };
    observations.ground = options.ground.is_some();
    let origin = observations.recentre();
    observations.scan_errors = ScanErrors::new(set, &observations, origin, options.align, None);
    progress.check("normals", 0.02)?;
    let mut converged = stages::converge(&mut observations, &sheet, &ProgressPart::new(progress, 0.02, 0.6))?;
    let added = batches::add_batches(&parts, &observations, origin, &mut converged, options, progress)?;
    finish::finish(set, &observations, converged, options, None, Some(added), origin, progress)?
        .translated(origin)
}

/// Some scans of a set, with its sensors.
fn some_scans(set: &ScanSet, scans: &[usize]) -> ScanSet {
    ScanSet {
        scans: scans.iter().map(|&k| set.scans[k].clone()).collect(),
        inputs: Vec::new(),
        ..set.clone()
    }
}

/// Fits a thing that moved: its first scan makes a surface, the others are laid on it and tell the motion,
/// and all of them then make the model, as the thing was when the first was taken.
fn fit_moving(set: &ScanSet, options: &FitOptions, progress: &dyn Progress) -> Result<Fit> {
    let order = scans_in_time(set)?;
    let mut still = FitOptions { motion: None, ..options.clone() };
    let mut plain = FitOptions { symmetry: None, complete_smooth: false, snapshots: None, ..still.clone() };
    let mut first = fit(&some_scans(set, &order[..1]), &plain, &ProgressPart::new(progress, 0.0, 0.15))?;
    // A thing that turns shows its sides in time: one that curves away from the scanner is no sheet.
    if options.shape.is_none() && first.model.surface.space().shape() == Shape::Sheet && curves_away(&first) {
        (still.shape, plain.shape) = (Some(Shape::Ball), Some(Shape::Ball));
        first = fit(&some_scans(set, &order[..1]), &plain, &ProgressPart::new(progress, 0.15, 0.3))?;
    }
    let mut tracker = RigidTracker::new(&first, set, &order)?;
    for (k, &scan) in order.iter().enumerate().skip(1) {
        progress.check("following the motion", 0.3 + 0.2 * k as f64 / order.len() as f64)?;
        progress.items(k - 1, "scans");
        let readings = observe(
            &some_scans(set, &[scan]),
            &ObservationOptions { held_out_share: 0.0, ..observation_options(set, &plain) },
        )?;
        tracker.follow(scan, &readings)?;
    }
    let mut moved = set.clone();
    for (k, posed) in moved.scans.iter_mut().enumerate() {
        let Some(world_from_thing) = tracker.pose(k) else {
            continue;
        };
        posed.scan.world_from_scanner = world_from_thing.inverse().after(&posed.scan.world_from_scanner);
        // The whole says more of the poses than the first scan did: they stay unknowns, known as well as the
        // motion knows them.
        if k != order[0] {
            let [translation, rotation] = tracker.sigmas(k, posed.scan.world_from_scanner.translation);
            posed.sigma_translation = Some(translation);
            posed.sigma_rotation_deg = Some(rotation.to_degrees());
        }
    }
    let mut fitted = fit(&moved, &still, &ProgressPart::new(progress, 0.5, 1.0))?;
    tracker.converge(set, &fitted.report.poses)?;
    fitted.report.propagation.get_or_insert_default().motion = Some(tracker.report(set)?);
    Ok(fitted)
}

/// Whether more than a few percent of what was measured faces away from the middle of it by more than
/// `acos(0.4)`, 66°.
fn curves_away(fitted: &Fit) -> bool {
    let surface = &fitted.model.surface;
    let areas: Vec<[f64; 3]> = (0..surface.space().leaves().len())
        .filter(|&leaf| fitted.model.observed[leaf].is_measured())
        .filter_map(|leaf| {
            let [u, v] = surface.space().parameters(leaf, [0.5, 0.5]);
            Some(scale(surface.leaf_area(leaf), surface.normal(u, v)?))
        })
        .collect();
    let Some(towards) = unit(areas.iter().fold([0.0; 3], |sum, a| add(sum, *a))) else {
        return true;
    };
    let all: f64 = areas.iter().map(|a| norm(*a)).sum();
    let away: f64 = (areas.iter().map(|a| (norm(*a), dot(*a, towards))))
        .filter(|(area, facing)| *facing < 0.4 * area)
        .map(|(area, _)| area)
        .sum();
    away > 0.03 * all
}

/// Completes the observations by what the options ask for, and settles a surface on all of them.
fn propagated(
    observations: &mut Observations,
    origin: [f64; 3],
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<(ConvergedFit, Option<PropagationReport>)> {
    let mut report = None;
    if let Some(choice) = options.symmetry {
        progress.check("symmetry", 0.015)?;
        let found = complete::complete_by_symmetry(observations, choice)?;
        let found = PropagationReport {
            symmetry: Some(found.symmetry),
            pseudo_readings: found.pseudo_readings,
            ..PropagationReport::default()
        };
        report = Some(found.translated(origin));
    }
    if !options.complete_smooth {
        return Ok((stages::converge(observations, options, progress)?, report));
    }
    let converged = stages::converge(observations, options, &ProgressPart::new(progress, 0.0, 0.6))?;
    let (readings, gaps) = gaps::completed(observations, &converged, options.gate);
    let mut report = report.unwrap_or_default();
    report.gaps = gaps;
    report.pseudo_readings += readings.len();
    if readings.is_empty() {
        return Ok((converged, Some(report)));
    }
    observations.add_inferred(&readings);
    let subset = (0..observations.len() as u32).filter(|&i| !observations.held_out[i as usize]);
    let subset = subset.collect();
    let rest = ProgressPart::new(progress, 0.6, 0.9);
    let converged = stages::refine_to_noise(observations, converged.surface, subset, options, &rest)?;
    Ok((converged, Some(report)))
}

/// What tells the ground, in the unit of the scans; in metres where nobody says another, as maps are.
fn ground_options(unit: Option<Unit>, width: GroundWidth) -> GroundOptions {
    let options =
        GroundOptions::for_unit(Unit::Metre.millimetres() / unit.unwrap_or(Unit::Metre).millimetres());
    match width {
        GroundWidth::Usual => options,
        GroundWidth::Widest(widest) => GroundOptions { widest, ..options },
    }
}

/// The observations of a set of scans, some of them held out.
fn observe(set: &ScanSet, options: &ObservationOptions) -> Result<Observations> {
    let scans = set.scans.iter().map(|posed| &posed.scan).collect::<Vec<_>>();
    let sensor_of_scan = set.scans.iter().map(|posed| posed.sensor).collect::<Vec<_>>();
    Observations::new(&scans, &sensor_of_scan, &set.sensors, options)
}

fn observation_options(set: &ScanSet, options: &FitOptions) -> ObservationOptions {
    ObservationOptions {
        held_out_share: options.held_out_share,
        seed: options.seed,
        checks: options.checks,
        // A sheet over lidar is a map of the ground; other shapes are things that stand on it.
        sheet: options.shape == Some(Shape::Sheet) || options.ground.is_some(),
        unprocessed: false,
        ground: options.ground.map(|width| ground_options(set.unit, width)),
    }
}

/// Adds the scans of another day to a model: its hierarchy stays, information adds, the prior counts once.
///
/// # Errors
/// As for [`fit`]; `Input` when units differ.
pub fn update(
    model: &SurfaceModel,
    set: &ScanSet,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Fit> {
    if let Some(unit) = set.unit
        && unit != model.unit
    {
        return Err(Error::input(format!(
            "the scans' unit is {}, the model's is {}: convert one of them",
            unit.name(),
            model.unit.name()
        )));
    }
    if model.moves_freely {
        return Err(Error::unsupported(
            "the model is a state of a sheet that bends, and later scans are of other states: needed `fit --motion bend` of all scans together",
        ));
    }
    let own = if model.patches.is_some() { Filter::Patch } else { Filter::Global };
    if let Some(asked) = options.filter.filter(|asked| *asked != own) {
        let name = |filter| match filter {
            Filter::Global => "global",
            Filter::Patch => "patch",
        };
        return Err(Error::input(format!(
            "the model was made by the {} filter and goes on with it: needed no --filter, or that one, found {}",
            name(own),
            name(asked)
        )));
    }
    let mut observations = observe(set, &observation_options(set, options))?;
    let origin = observations.recentre();
    let moved;
    let model = if origin == [0.0; 3] {
        model
    } else {
        moved = model.clone().translated(origin.map(|c| -c))?;
        &moved
    };
    progress.check("normals", 0.1)?;
    let surface = &model.surface;
    let search = FootPointSearch::new(surface, 2, 0.0)?;
    observations.orient_by(|p| {
        let [u, v] = search.nearest(p, [0.0; 3]);
        surface.normal(u, v).unwrap_or([0.0; 3])
    });
    observations.scan_errors = ScanErrors::new(set, &observations, origin, options.align, Some(model));
    let converged = match &model.patches {
        None => finish::place(model, &mut observations, options, progress)?,
        Some(filter) => {
            patch::refuse_align(options)?;
            observations.scan_errors = ScanErrors::default();
            patch::update_patches(model, filter, &observations, options, progress)?
        }
    };
    finish::finish(set, &observations, converged, options, Some(model), None, origin, progress)?
        .translated(origin)
}
