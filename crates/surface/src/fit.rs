//! Fits surfaces to scans.
//!
//! Input: a [`ScanSet`] and [`FitOptions`]. Output: a [`Fit`]: a model with its covariance, and a report.
//! Follow the modules in this order:
//!
//! | stage | module | hands over |
//! |---|---|---|
//! | observe | [`crate::observe`] | [`Observations`]: readings in the world frame with their covariances |
//! | first | `first` (`drape`; `growth` for balls that are not star-shaped) | a starting surface |
//! | refine | `refine` (`misfit`, `division`) | a `ConvergedFit`: surface, feet, noise, smoothness weight |
//! | finish | `finish` | a [`Fit`]: information, covariance, report |
//!
//! `creased_fit` chooses between first surfaces with and without sharp edges by their fits.
//! `few_readings` replaces the first surface and the refinement if there are few. Large clouds pass these
//! stages with a first batch; `batches` adds the others. Other strategies replace stages (see [`Strategy`]):
//! `known_parameters` all of them, `patch` filters readings one at a time,
//! `motion` and `bending` follow an object through time. `update` adds readings to a saved model.

mod batches;
mod bending;
mod bending_energy;
mod bending_report;
mod block_ranges;
mod creased_fit;
mod creases;
mod division;
mod drape;
mod enclosed;
mod enclosing_mesh;
mod few_readings;
mod finish;
mod first;
mod folds;
mod formation;
mod gaps;
mod growth;
mod indicator;
mod inferred;
mod known_parameters;
mod leaves;
mod local_misfit;
mod marginal;
mod minimum;
mod misfit;
mod misfit_by_bending;
mod misfit_report;
mod motion;
mod noise;
mod options;
mod over_quads;
mod pair_sums;
mod patch;
mod propagation;
mod refine;
mod refine_by_curvature;
mod refine_by_roughness;
mod report;
mod residual_sample;
mod rough_places;
mod scan_differences;
mod shared_errors;
mod smoothing;
mod spline_error;
mod support;
mod surface_misfit;
mod uneven_sigma;
mod unresolved_shape;
mod update;
mod verdict;
mod weights;

pub use crate::model::SigmaSummary;
pub use crate::observe::{ObservationOptions, Observations, Quantity, RejectionCause};
pub use crate::subdivision::{LevelRefinement, RefineBy};
pub use bending_report::{BendingReport, BendingState};
pub use enclosing_mesh::{BodiesAndHandles, TopologyMargin};
pub(crate) use finish::open_leaves;
pub use formation::{Formation, Snapshot};
pub(crate) use leaves::with_neighbours;
pub use local_misfit::LeafMisfit;
pub use misfit_report::{MisfitPlace, MisfitReport};
pub use motion::{MotionPose, MotionReport};
pub use options::{
    Filter, FitOptions, GlobalOptions, GroundWidth, PatchOptions, Strategy, UpdateOptions,
    max_coefficients_within,
};
pub(crate) use patch::{FirstFit, first_fit_of};
use planish_core::Setting;
pub use propagation::PropagationReport;
pub use report::{FitReport, FitTermination, HeldOut};
pub use residual_sample::{ResidualSample, ScanSummary};
pub use scan_differences::ScanDifference;
pub use surface_misfit::UnresolvedPlace;
pub use unresolved_shape::UnresolvedShape;
pub use verdict::FitVerdict;

use crate::model::{Knowledge, NodeCovariance, Observed, Posterior, SurfaceModel};
use crate::observe::ScanErrors;
use batches::Batches;
use creased_fit::fit_first_shape;
use finish::{FinishInput, finish};
use first::{FirstShape, inward_normals};
use planish_core::{DVec3, Progress, ProgressPart};
use planish_estimate::{Error, Result};
use planish_exchange::{ScanSet, Unit};
use planish_sense::GroundOptions;
use planish_spline::{FootPointSearch, Shape};
use propagation::converge_with_propagation;
use refine::ConvergedFit;
use report::rejected_readings;
use std::sync::Arc;
use uneven_sigma::refuse_uneven_sigma;

/// A fitted model with its figures.
pub struct Fit {
    /// The model.
    pub model: SurfaceModel,
    /// The figures.
    pub report: FitReport,
    /// For a sheet that bends: the states before the last, in the order of time. Empty otherwise.
    pub earlier_states: Vec<Fit>,
    /// How the model formed with the number of readings, if that was asked for.
    pub formation: Option<Formation>,
    /// A sample of the readings with their residuals; none if parameters were known or a sheet bends.
    pub readings: Option<ResidualSample>,
    covariance: Arc<NodeCovariance>,
}

impl Fit {
    /// The same fit with every point moved.
    fn translated(mut self, by: DVec3) -> Result<Self> {
        if by != DVec3::ZERO {
            self.model = self.model.translated(by)?;
            self.formation = self.formation.map(|formation| formation.translated(by)).transpose()?;
            self.readings = self.readings.map(|readings| readings.translated(by));
        }
        Ok(self)
    }

    /// The posterior covariance of the model. The fit has computed it already, so this costs nothing.
    #[must_use]
    pub fn posterior(&self) -> Posterior<'_> {
        Posterior::new(&self.model.surface, Arc::clone(&self.covariance)).of_model(&self.model)
    }
}

/// Fits a surface to scans.
///
/// # Errors
/// `Undetermined` if the points do not determine a surface; `Input` for values out of range, and for a shape
/// that the strategy cannot have; `Interrupted` on request.
///
/// # Examples
/// ```
/// use planish_core::random::{SplitMix64, unit_interval};
/// use planish_core::{DVec3, Silent};
/// use planish_exchange::{PosedScan, ScanSet, Unit};
/// use planish_sense::{Noise, Scan, Sensor};
/// use planish_surface::fit::{FitOptions, fit};
///
/// // A scan of a wavy sheet, with errors of up to 0.02 mm.
/// let mut random = SplitMix64::new(1);
/// let mut draw = || unit_interval(random.next_u64());
/// let points = (0..2000).map(|_| {
///     let (x, y) = (8.0 * draw(), 6.0 * draw());
///     DVec3::new(x, y, 0.3 * x.sin() + 0.04 * (draw() - 0.5))
/// });
/// let scan = Scan { name: "sheet".to_owned(), points: points.collect(), ..Scan::default() };
/// let sensor = Sensor { noise: Some(Noise::Isotropic { sigma: 0.0115 }), ..Sensor::default() };
/// let set = ScanSet {
///     unit: Some(Unit::Millimetre),
///     sensors: vec![sensor],
///     scans: vec![PosedScan { scan, sensor: 0, sigma_translation: None, sigma_rotation_deg: None }],
///     ..ScanSet::default()
/// };
/// let fitted = fit(&set, &FitOptions::default(), &Silent)?;
/// assert_eq!(fitted.report.topology.shape, "sheet");
/// assert!(fitted.report.rms < 0.012 && fitted.report.sigma.median < 0.01);
/// # Ok::<(), planish_core::Error>(())
/// ```
pub fn fit(set: &ScanSet, options: &FitOptions, progress: &dyn Progress) -> Result<Fit> {
    // With known parameters, the cells are the caller's choice, and so is what they miss.
    if !options.force && !matches!(options.strategy, Strategy::KnownParameters { .. }) {
        refuse_uneven_sigma(set)?;
    }
    match &options.strategy {
        Strategy::Global(global) => fit_global(set, global, options, progress),
        Strategy::Patches(patches) => patch::fit_patches(set, patches, options, progress),
        Strategy::KnownParameters { cells } => {
            known_parameters::fit_known_parameters(set, *cells, options, progress)
        }
        Strategy::Moving(global) => motion::fit_moving(set, global, options, progress),
        Strategy::Bending => bending::fit_bending(set, options, progress),
    }
}

/// Fits by the global filter: in batches if the cloud is large and nothing needs all readings at hand.
fn fit_global(
    set: &ScanSet,
    global: &GlobalOptions,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Fit> {
    let ground = global.ground.map(|width| ground_options(set.unit, width));
    let completes = global.symmetry.is_some() || global.fill_gaps;
    // Snapshots and completion need all readings at hand.
    let batches = if completes || global.snapshots.is_some() {
        None
    } else {
        Batches::divide(set, options, ground.as_ref())?
    };
    match batches {
        Some(batches) => fit_in_batches(set, &batches, global, options, progress),
        None => fit_at_once(set, global, options, progress),
    }
}

/// Fits all readings at once by the global filter.
fn fit_at_once(
    set: &ScanSet,
    global: &GlobalOptions,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Fit> {
    let sheet = options.with_shape_of_ground();
    let mut observations = observe(set, &observation_options(set, options))?;
    // About a distant origin, products of coordinates lose the digits that determine the surface
    // (decision 0010).
    let origin = observations.recentre();
    // Centres of rotation come from the moved readings, so the unknowns of scans follow the move.
    observations.scan_errors = ScanErrors::new(set, &observations, origin, global.align, None);
    progress.check("normals", 0.01)?;
    let (converged, propagation) =
        converge_with_propagation(&mut observations, origin, global, &sheet, progress)?;
    // Snapshots come before `finish`, which consumes the converged surface.
    let formation = (global.snapshots)
        .map(|frames| {
            let part = ProgressPart::new(progress, 0.88, 0.9);
            formation::formation_of_global_fit(&observations, &converged, options, frames, &part)
        })
        .transpose()?;
    let input = FinishInput::new(set, &observations, options, origin);
    let mut fitted = finish(input, converged, progress)?;
    fitted.formation = formation;
    let inferred_area_fraction = fitted.model.area_fraction(Observed::Inferred);
    fitted.report.propagation =
        propagation.map(|found| PropagationReport { inferred_area_fraction, ..found });
    fitted.translated(origin)
}

/// Fits a first batch of a large cloud, and adds the others.
fn fit_in_batches(
    set: &ScanSet,
    batches: &Batches<'_>,
    global: &GlobalOptions,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Fit> {
    let sheet = options.with_shape_of_ground();
    progress.check("dealing out", 0.01)?;
    // The copied scans of the batch are freed at the end of this block, before the fit needs its memory.
    let mut observations = {
        let first = batches.batch(0);
        let options = observation_options(set, options);
        // The ground was found in the whole cloud already.
        observe(&first, &ObservationOptions { ground: None, ..options })?
    };
    // The intake did not separate the ground again, but the weights of readings depend on this mark.
    observations.intake.ground = global.ground.is_some();
    observations.intake.later_batches = batches.count - 1;
    let origin = observations.recentre();
    observations.scan_errors = ScanErrors::new(set, &observations, origin, global.align, None);
    progress.check("normals", 0.02)?;
    // The first batch is a sample of the whole, with more readings than the allowed control vertices can
    // follow: it shows all shape that the fit can resolve (decision 0011).
    let mut converged = converge(&mut observations, &sheet, &ProgressPart::new(progress, 0.02, 0.6))?;
    let added = batches::add_batches(batches, &observations, origin, &mut converged, options, progress)?;
    let input = FinishInput { added: Some(added), ..FinishInput::new(set, &observations, options, origin) };
    finish(input, converged, progress)?.translated(origin)
}

/// Adds scans to a model: its hierarchy stays, information adds, and the prior counts once.
///
/// # Errors
/// As for [`fit`]; `Input` if units or filters differ.
pub fn update(
    model: &SurfaceModel,
    set: &ScanSet,
    options: &UpdateOptions,
    progress: &dyn Progress,
) -> Result<Fit> {
    check_update(model, set, options)?;
    let align = options.align;
    let options = &options.fit_options();
    let mut observations = observe(set, &observation_options(set, options))?;
    let origin = observations.recentre();
    let moved;
    let model = if origin == DVec3::ZERO {
        model
    } else {
        moved = model.clone().translated(origin.map(|c| -c))?;
        &moved
    };
    progress.check("normals", 0.1)?;
    let surface = &model.surface;
    // The new cloud alone has two sides. The model decides which of them is outside (decision 0009).
    let search = FootPointSearch::new(surface, 2, 0.0)?;
    observations.orient_by(|p| {
        let [u, v] = search.nearest(p, DVec3::ZERO);
        surface.normal(u, v).unwrap_or(DVec3::ZERO)
    });
    observations.scan_errors = ScanErrors::new(set, &observations, origin, align, Some(model));
    let converged = match &model.known {
        Knowledge::AlongNormals { information, .. }
        | Knowledge::PerCoordinate { information, .. }
        | Knowledge::Free { information } => {
            update::add_to_model(model, information, &mut observations, options, progress)?
        }
        Knowledge::Patches(filter) => {
            patch::refuse_align(align)?;
            // Poses are not part of the state of a patch, so they count as exact.
            observations.scan_errors = ScanErrors::default();
            patch::update_patches(model, filter, &observations, options, progress)?
        }
    };
    let input = FinishInput { earlier: Some(model), ..FinishInput::new(set, &observations, options, origin) };
    finish(input, converged, progress)?.translated(origin)
}

/// Refuses an update that the model cannot take.
fn check_update(model: &SurfaceModel, set: &ScanSet, options: &UpdateOptions) -> Result<()> {
    if let Some(unit) = set.unit
        && unit != model.unit
        // An assumed unit is no statement: the readings may name the one that all numbers are in.
        && !model.unit_assumed
    {
        return Err(Error::input(format!(
            "expected scans and a model of the same unit, found {} and {}: convert one of them",
            unit.name(),
            model.unit.name()
        )));
    }
    if matches!(model.known, Knowledge::Free { .. }) {
        return Err(Error::unsupported(
            "expected a model of a rigid object, found a state of a bending sheet, to which scans of other \
             states cannot be added: fit all scans together",
        )
        .with_setting(Setting::Motion));
    }
    // An information matrix and the beliefs of patches do not add, so a model stays with its filter.
    let own = if model.known.filter().is_some() { Filter::Patch } else { Filter::Global };
    if let Some(asked) = options.filter.filter(|asked| *asked != own) {
        let name = |filter| match filter {
            Filter::Global => "global",
            Filter::Patch => "patch",
        };
        return Err(Error::input(format!(
            "expected the {} filter of the model for an update, or none, found {}",
            name(own),
            name(asked)
        ))
        .with_setting(Setting::Filter));
    }
    Ok(())
}

/// Finds a starting surface and refines it.
///
/// # Errors
/// `Undetermined` if no reading measures a position, or what the stages report.
fn converge(
    observations: &mut Observations,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<ConvergedFit> {
    let is_position = |i: usize| {
        let channel = &observations.channels[observations.channel(i)];
        channel.quantity == Quantity::Position && !channel.inferred
    };
    if !(0..observations.len()).any(is_position) {
        return Err(Error::undetermined(
            "expected readings of positions after all rejections, found only normals or curvatures, which \
             do not determine the position of the surface: add positions (a few touch points are enough), \
             or specify kind = \"range\" if the points of these sensors are measured as well",
        ));
    }
    if few_readings::is_few(observations)
        && let Some(converged) = few_readings::fit_few_readings(observations, options, progress)?
    {
        return Ok(converged);
    }
    let mut shape = FirstShape::of(observations, options, 1, progress)?;
    if shape.faces_inwards {
        // Later batches would keep their normals, and measured ones are no matter of orientation alone.
        if observations.intake.later_batches > 0 || !observations.turn_normals() {
            return Err(inward_normals());
        }
        shape = FirstShape::of(observations, options, 1, progress)?;
    }
    fit_first_shape(observations, options, &shape, progress)
}

/// The given scans of a set, with its sensors.
fn scans_of(set: &ScanSet, scans: &[usize]) -> ScanSet {
    ScanSet {
        scans: scans.iter().map(|&k| set.scans[k].clone()).collect(),
        inputs: Vec::new(),
        ..set.clone()
    }
}

/// Settings that separate the ground from objects, in the unit of the scans (metres if they state none, as
/// maps do).
fn ground_options(unit: Option<Unit>, width: GroundWidth) -> GroundOptions {
    let options =
        GroundOptions::for_unit(Unit::Metre.millimetres() / unit.unwrap_or(Unit::Metre).millimetres());
    match width {
        GroundWidth::Default => options,
        GroundWidth::Widest(widest) => GroundOptions { widest, ..options },
    }
}

/// The observations of a set of scans; some are held out.
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
        // A sheet over lidar is a map of the ground; other shapes are objects on it.
        sheet: options.shape == Some(Shape::Sheet) || options.ground().is_some(),
        unprocessed: false,
        ground: options.ground().map(|width| ground_options(set.unit, width)),
    }
}
