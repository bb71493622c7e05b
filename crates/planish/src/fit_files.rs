//! The job `planish fit`: files in, a model fitted or updated, files out.
//!
//! Input: a [`FitJob`]. Output: the files that it names and a [`FitJobReport`]. Outputs are checked
//! before anything is read, and written when everything else has succeeded.

mod findings;
mod page;
mod task;

pub use task::FitTask;

use crate::animation::{AnimationOutput, AnimationReport, FRAMES, write_forming};
use crate::assumed_unit::implausible_size;
use crate::job::Job;
use crate::output::{
    OutputFormat, OutputOptions, PlannedOutput, WrittenFile, check_outputs, plan_outputs, prepare,
    refuse_input_as_output,
};
use crate::report::{ReportOutput, with_page};
use page::fit_page;
use planish_core::{Finding, FindingCode, Length, Setting};
use planish_core::{Progress, ProgressPart, WRITING_STAGE};
use planish_estimate::{Error, ErrorKind, Result};
use planish_exchange::{InputFile, ScanSet, Unit, extension, make_folder, read_inputs};
use planish_mesh::BoundingBox;
use planish_sense::SensorKind;
use planish_spline::Shape;
use planish_surface::export::Closing;
use planish_surface::fit::{Fit, FitOptions, FitReport, GroundWidth, Strategy, fit, update};
use planish_surface::model::{Posterior, SurfaceModel};
use planish_surface::observe::check_domain;
use planish_surface::saved::{SavedModel, Session, SessionInput, load_with_provenance};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Minimum value of the limit on control vertices. The coarsest surfaces have a few dozen, so a smaller limit
/// is a mistake.
pub const MIN_COEFFICIENTS: usize = 16;

/// Maximum rms of added readings, relative to the size of the saved model. A smaller value would reject
/// coarse sensors; a larger one would accept another object that lies nearby.
const MAX_RMS_RATIO: f64 = 0.05;
/// Maximum deviation of a scan's pose from the predicted steady motion, in σ. Beyond it, the scan is named in
/// a finding.
const MAX_INNOVATION: f64 = 3.0;

/// A fit: its scans, its settings and its outputs.
///
/// # Examples
/// ```no_run
/// use planish::Job;
/// use planish::fit_files::FitJob;
/// use planish::progress::Silent;
/// let job = FitJob {
///     inputs: vec!["top.ply".into(), "side.ply".into()],
///     outputs: vec!["part.step".into(), "part.planish".into()],
///     ..FitJob::default()
/// };
/// let done = job.run(&Silent)?;
/// println!("σ of the surface: {} {}", done.fit.sigma.median, done.unit);
/// # Ok::<(), planish::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct FitJob {
    /// Scans and lists of scans.
    pub inputs: Vec<PathBuf>,
    /// Fit a new model, or update a saved one (default: fit with [`FitOptions::default`]).
    pub task: FitTask,
    /// Files to write: see [`crate::output::OutputFormat`].
    pub outputs: Vec<PathBuf>,
    /// Unit of files that state none.
    pub unit: Option<Unit>,
    /// Distance at which the refinement of a new model stops. It replaces [`FitOptions::tolerance`] and may
    /// have a unit of its own; otherwise it is in the unit of the scans.
    pub tolerance: Option<Length>,
    /// Chord error of meshes; half the median σ if none is given. Without a unit, it is in that of the model.
    pub mesh_tolerance: Option<Length>,
    /// Side of the cells of rasters; about the spacing of the readings where none is given. Without a unit,
    /// it is in that of the model.
    pub cell_size: Option<Length>,
    /// Which parts that were neither measured nor inferred meshes and STEP files have.
    pub closing: Closing,
    /// Folder for the states of a bending sheet, one model and one mesh per time.
    pub states: Option<PathBuf>,
    /// A .glb file or a folder of pictures that shows how the model formed, reading by reading.
    pub animation: Option<PathBuf>,
    /// A page that shows the result.
    pub report: Option<ReportOutput>,
    /// The arguments that decide the answer, for the saved model's provenance.
    pub arguments: Vec<String>,
}

/// The figures of a job.
#[derive(Debug, Clone)]
pub struct FitJobReport {
    /// The fit's figures; with the findings of the whole job.
    pub fit: FitReport,
    /// Unit of every length.
    pub unit: Unit,
    /// Files that were read.
    pub inputs: Vec<InputFile>,
    /// Files that were written.
    pub written: Vec<WrittenFile>,
    /// How the model formed, if requested.
    pub animation: Option<AnimationReport>,
    /// Number of readings of all sessions in the model.
    pub observations_of_all_sessions: usize,
    /// Seconds that the fit itself took: without reading and writing files.
    pub fit_seconds: f64,
}

impl Job for FitJob {
    type Report = FitJobReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(self.inputs.iter().map(PathBuf::as_path).chain(self.task.model()).map(Path::to_owned).collect())
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        // Settings and outputs are checked before anything is read: a fit may take minutes, and a mistyped
        // extension must not cost them.
        check_settings(self)?;
        plan_outputs(&self.outputs)?;
        if let Some(folder) = &self.states {
            if self.task.fit_options().is_none_or(|options| options.strategy != Strategy::Bending) {
                return Err(Error::input(format!(
                    "{}: expected the motion of a bending sheet for an output per state, found another \
                     motion",
                    folder.display()
                ))
                .with_setting(Setting::Motion));
            }
            make_folder(folder)?;
        }
        let mut outputs = self.outputs.clone();
        if let Some(AnimationOutput::Mesh(path)) = animation_of(self)? {
            outputs.push(path);
        }
        with_page(outputs, self.report.as_ref())
    }

    fn execute(&self, progress: &dyn Progress) -> Result<FitJobReport> {
        fit_scans(self, progress)
    }
}

fn animation_of(job: &FitJob) -> Result<Option<AnimationOutput>> {
    job.animation.as_deref().map(AnimationOutput::plan).transpose()
}

/// Reads, fits and writes. Nothing is written unless the fit succeeds.
fn fit_scans(job: &FitJob, progress: &dyn Progress) -> Result<FitJobReport> {
    let outputs = plan_outputs(&job.outputs)?;
    let animation = animation_of(job)?;
    progress.check("reading", 0.0)?;
    // The shape may be given, so a raster that cannot be written is refused before the scans are read.
    refuse_raster_of(job, &outputs)?;
    let mut set = read_inputs(&job.inputs, job.unit)?;
    // Default widths of the ground filter are in metres. An update keeps the unit of its model.
    let unit_of_maps = set.unit.is_none() && job.task.model().is_none() && job.task.ground().is_some();
    if unit_of_maps {
        set.unit = Some(Unit::Metre);
    }
    // A list names more inputs than the command line does.
    let read: Vec<PathBuf> = set.inputs.iter().map(|input| input.path.clone()).collect();
    let pages = job.report.iter().map(|page| &page.path);
    for path in outputs.iter().map(|output| &output.path).chain(pages) {
        refuse_input_as_output(path, &read)?;
    }
    // Before the fit, which would show lost digits of far coordinates only as noise.
    let in_far_places = check_domain(&set, &names(&job.inputs))?;
    let earlier = job.task.model().map(load_with_provenance).transpose()?;
    progress.check("reading", 0.05)?;
    let fitting = ProgressPart::new(progress, 0.05, 0.9);
    // The reported time excludes files, so that it can be compared between machines and formats.
    let start = Instant::now();
    let fitted = match (&job.task, &earlier) {
        (FitTask::Update { options, .. }, Some(earlier)) => update(&earlier.model, &set, options, &fitting),
        (FitTask::Update { .. }, None) => unreachable!("the model of an update was read"),
        (FitTask::Fit(options), _) => {
            options_of_fit(job, options, &set).and_then(|options| fit(&set, &options, &fitting))
        }
    };
    let fit_seconds = start.elapsed().as_secs_f64();
    let fitted = fitted.map_err(|e| with_inputs(e, job))?;
    // An update without used readings would return the old model, and a script would take that for success.
    if fitted.report.observations == 0 {
        return Err(all_rejected_error(job, &fitted.report));
    }
    if let Some(earlier) = &earlier {
        reject_other_object(job, &earlier.model, &fitted.report)?;
    }
    progress.check("making outputs", 0.9)?;
    let posterior = fitted.posterior();
    let mut report = fitted.report.clone();
    report.findings.extend(input_findings(&set, earlier.as_ref(), &fitted.model));
    report.findings.extend(in_far_places);
    if job.closing == Closing::Never {
        report.findings.retain(|finding| finding.code != FindingCode::OpeningsClosed);
    }
    if unit_of_maps {
        let text =
            "no file states its unit of length: metres are assumed, as on maps; specify the unit: m or ft";
        report.findings.push(Finding::new(FindingCode::UnitAssumed, text).with_setting(Setting::Unit));
    }
    report.findings.extend(unclassified(job, &set));
    report.findings.extend(unsteady_motion_findings(&report));
    // Outputs are prepared in memory first. A failure in one of them then leaves no partial set of files.
    let states = states_to_write(job, &fitted)?;
    let mesh_tolerance = job.mesh_tolerance.map(|length| length.in_unit(fitted.model.unit));
    let mut states_prepared = Vec::new();
    for (state, outputs) in &states {
        let options = OutputOptions { mesh_tolerance, closing: job.closing, ..OutputOptions::default() };
        states_prepared.push(prepare(&state.model, &state.posterior(), outputs, &options)?);
    }
    // Drawing can be interrupted, writing cannot.
    let animation = (animation.iter())
        .zip(&fitted.formation)
        .map(|(output, forming)| {
            write_forming(forming, fitted.model.unit, output, &ProgressPart::new(progress, 0.9, 0.95))
        })
        .next()
        .transpose()?;
    let to_write = ToWrite {
        outputs: &outputs,
        model: &fitted.model,
        posterior: &posterior,
        provenance: earlier.map(|earlier| earlier.provenance).unwrap_or_default(),
    };
    let mut written = write(job, &set, to_write, progress, &mut report)?;
    for prepared in &states_prepared {
        written.extend(prepared.write(&[session(job, &set)])?);
    }
    // Findings that depend on the other findings come last.
    let judged = findings::judge(&fitted, &report);
    report.findings.extend(judged);
    if let Some(output) = &job.report {
        let verb = if job.task.model().is_some() { "Updated" } else { "Fitted" };
        let named = Job::inputs(job)?;
        let page = fit_page(&fitted, &report, &named, mesh_tolerance, job.task.gate(), verb)?;
        output.write(page, &files_read(job, &set))?;
    }
    progress.advance("done", 1.0);
    Ok(FitJobReport {
        fit: report,
        unit: fitted.model.unit,
        inputs: set.inputs,
        written,
        animation,
        observations_of_all_sessions: fitted.model.observations,
        fit_seconds,
    })
}

/// Adds the names of the inputs to an error of the fit, which knows no files.
fn with_inputs(e: Error, job: &FitJob) -> Error {
    match e.kind() {
        ErrorKind::Interrupted => e,
        // The message begins with the name of a scan, which is that of its file.
        _ if e.place().is_some_and(|scan| job.inputs.iter().any(|path| is_scan_of(scan, path))) => e,
        _ => e.in_context(names(&job.inputs)),
    }
}

/// The settings of a new fit, with the job's own tolerance and the snapshots of its animation.
///
/// # Errors
/// `Unsupported` for an animation of a strategy without snapshots.
fn options_of_fit(job: &FitJob, options: &FitOptions, set: &ScanSet) -> Result<FitOptions> {
    let mut options = options.clone();
    if let Some(length) = job.tolerance {
        options.tolerance = Some(length.in_unit(set.unit.unwrap_or(Unit::Millimetre)));
    }
    if job.animation.is_some() {
        // An error before the fit, because a missing animation would be noticed only after it.
        let Some(snapshots) = options.strategy.snapshots_mut() else {
            return Err(Error::unsupported(
                "expected an animation of another fit: with known parameters or bending, all readings of a \
                 time are used together and have no order",
            ));
        };
        *snapshots = Some(FRAMES);
    }
    Ok(options)
}

/// The input files, and a description of the contents of each.
fn files_read(job: &FitJob, set: &ScanSet) -> Vec<(PathBuf, String)> {
    let description = |input: &InputFile| match (input.points, input.dropped_not_finite) {
        (0, _) => "sensors and scans".to_owned(),
        (n, 0) => format!("{n} points"),
        (n, dropped) => format!("{n} points, {dropped} others are not finite"),
    };
    let scans = set.inputs.iter().map(|input| (input.path.clone(), description(input)));
    let model =
        job.task.model().into_iter().map(|path| (path.to_owned(), "the model that was updated".to_owned()));
    scans.chain(model).collect()
}

/// The states of a bending sheet and their files, if requested.
fn states_to_write<'a>(job: &FitJob, fitted: &'a Fit) -> Result<Vec<(&'a Fit, Vec<PlannedOutput>)>> {
    let Some(folder) = &job.states else {
        return Ok(Vec::new());
    };
    // The final state is the last one of the sheet, so the files are in the order of time.
    let all = fitted.earlier_states.iter().chain([fitted]);
    all.enumerate()
        .map(|(k, state)| {
            let name = |extension: &str| folder.join(format!("state-{}.{extension}", k + 1));
            let files = [name("planish"), name("ply")];
            // These names were not known when the other outputs were checked.
            check_outputs(&files, &job.inputs)?;
            Ok((state, plan_outputs(&files)?))
        })
        .collect()
}

/// A finished model and the files that it goes to.
struct ToWrite<'a> {
    outputs: &'a [PlannedOutput],
    model: &'a SurfaceModel,
    posterior: &'a Posterior<'a>,
    /// The sessions that made the model before this one.
    provenance: Vec<Session>,
}

fn write(
    job: &FitJob,
    set: &ScanSet,
    ToWrite { outputs, model, posterior, mut provenance }: ToWrite<'_>,
    progress: &dyn Progress,
    report: &mut FitReport,
) -> Result<Vec<WrittenFile>> {
    let options = OutputOptions {
        mesh_tolerance: job.mesh_tolerance.map(|length| length.in_unit(model.unit)),
        cell_size: job.cell_size.map(|length| length.in_unit(model.unit)),
        closing: job.closing,
        georeference: set.georeference.clone(),
    };
    let prepared = prepare(model, posterior, outputs, &options)?;
    report.findings.extend(prepared.findings.iter().cloned());
    if job.closing == Closing::Never {
        report.topology.borders = prepared.borders().unwrap_or(report.topology.borders);
    }
    provenance.push(session(job, set));
    // The last point at which a job can be interrupted. Files that were begun are completed.
    progress.check(WRITING_STAGE, 0.95)?;
    prepared.write(&provenance)
}

/// Findings about scans that deviate from the steady motion of the object.
fn unsteady_motion_findings(report: &FitReport) -> Vec<Finding> {
    let motion = report.propagation.as_ref().and_then(|p| p.motion.as_ref());
    let off = motion.iter().flat_map(|m| &m.poses).filter(|pose| pose.innovation > MAX_INNOVATION);
    off.map(|pose| {
        let text = format!(
            "{}: at {} s the object is {:.0} σ from the position of a steady motion: check the time of the \
             scan and whether the object turns steadily",
            pose.scan, pose.time_s, pose.innovation
        );
        Finding::new(FindingCode::MotionUnsteady, text)
    })
    .collect()
}

/// Error if every reading was rejected: an unchanged model is not a result.
fn all_rejected_error(job: &FitJob, report: &FitReport) -> Error {
    let causes: Vec<String> = report.rejected.iter().map(|(cause, n)| format!("{n} {cause}")).collect();
    let surface = match job.task.model() {
        Some(model) => format!("the surface of {}", model.display()),
        None => "the surface".to_owned(),
    };
    Error::undetermined(format!(
        "{}: every reading was rejected ({}); expected readings of {surface}",
        names(&job.inputs),
        causes.join(", ").replace('_', " ")
    ))
}

/// Refuses readings that lie far from the saved model, relative to its size.
fn reject_other_object(job: &FitJob, earlier: &SurfaceModel, report: &FitReport) -> Result<()> {
    let size = BoundingBox::from_points(earlier.surface.vertices()).map_or(0.0, |b| b.diagonal());
    // The gate does not catch this case: the estimated σ grows with the residuals, so nothing is rejected.
    if report.rms <= MAX_RMS_RATIO * size {
        return Ok(());
    }
    let unit = earlier.unit;
    Err(Error::undetermined(format!(
        "{}: the readings lie {:.3e} {unit} (rms) from a model of size {size:.3e} {unit}: check that both \
         have the same frame and unit",
        names(&job.inputs),
        report.rms
    )))
}

/// Whether a scan has the name of a file. Scans of a file with several have its name with a number behind it.
fn is_scan_of(scan: &str, path: &std::path::Path) -> bool {
    // Only the start is compared, because scans of one file are numbered behind its name.
    path.file_name().is_some_and(|name| scan.starts_with(&*name.to_string_lossy()))
}

/// The first few of many paths.
fn names(paths: &[PathBuf]) -> String {
    let first: Vec<String> = paths.iter().take(3).map(|p| p.display().to_string()).collect();
    let more = if paths.len() > first.len() { ", …" } else { "" };
    first.join(", ") + more
}

fn session(job: &FitJob, set: &ScanSet) -> Session {
    let inputs = set.inputs.iter().map(|input| SessionInput {
        name: input.path.display().to_string(),
        points: input.points,
        points_hash: hash_of(input),
    });
    Session {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        arguments: job.arguments.clone(),
        seed: job.task.seed(),
        inputs: inputs.collect(),
    }
}

fn input_findings(set: &ScanSet, earlier: Option<&SavedModel>, made: &SurfaceModel) -> Vec<Finding> {
    let mut findings = earlier.map_or_else(Vec::new, |earlier| earlier.findings.clone());
    // The surface reaches beyond its readings, so it is larger than the object that was measured.
    let sizes = (set.scans.iter())
        .filter_map(|posed| BoundingBox::from_points(&posed.scan.points))
        .map(|bounds| bounds.longest_side());
    let size = sizes.fold(0.0, f64::max);
    if let Some(implausible) = implausible_size(size, made.unit).filter(|_| made.unit_assumed) {
        findings.push(implausible);
    } else if set.unit.is_none() && earlier.is_none() {
        findings.push(
            Finding::new(
                FindingCode::UnitAssumed,
                "no file states its unit of length: millimetres are assumed; specify the unit (mm, m, in \
                 or ft)",
            )
            .with_setting(Setting::Unit),
        );
    }
    for posed in &set.scans {
        let sensor = &set.sensors[posed.sensor];
        let stated = posed.scan.sigma_curvature.is_some() || sensor.sigma_curvature.is_some();
        // Positions have a σ that residuals can estimate. Curvatures without a stated σ would get an
        // arbitrary weight, so they are not used.
        if posed.scan.curvatures.is_some() && !stated && sensor.kind != SensorKind::Curvature {
            findings.push(Finding::new(
                FindingCode::CurvaturesUnused,
                format!(
                    "{}: k1 k2 are not used, because their σ is unknown; expected the column `sigma_k`, \
                 or `sigma_k` of the sensor in a job",
                    posed.scan.name
                ),
            ));
        }
    }
    findings.extend(added_twice(set, earlier));
    findings
}

fn hash_of(input: &InputFile) -> Option<String> {
    (input.points > 0).then(|| format!("{:016x}", input.points_hash))
}

/// Warns of scans that the model contains already: they would reduce its variance without new information.
fn added_twice(set: &ScanSet, earlier: Option<&SavedModel>) -> Vec<Finding> {
    let sessions = earlier.iter().flat_map(|e| &e.provenance);
    let before: Vec<&SessionInput> =
        sessions.flat_map(|s| &s.inputs).filter(|input| input.points > 0).collect();
    let mut findings = Vec::new();
    for input in set.inputs.iter().filter(|input| input.points > 0) {
        let path = input.path.display();
        let hash = hash_of(input);
        let same = before.iter().find(|b| b.points_hash == hash);
        // Models of older versions keep names and numbers only, which cannot prove it.
        let alike = || {
            let name = |b: &SessionInput| Path::new(&b.name).file_name() == input.path.file_name();
            before.iter().find(|b| b.points_hash.is_none() && name(b) && b.points == input.points)
        };
        let text = if let Some(same) = same {
            format!("{path}: the model already contains these points ({}): they count twice", same.name)
        } else if alike().is_some() {
            format!(
                "{path}: a scan of this name and size was added to the model before; if it is the same \
                 scan, its readings count twice"
            )
        } else {
            continue;
        };
        findings.push(Finding::new(FindingCode::ScanAddedTwice, text));
    }
    findings
}

/// Refuses a height raster of a shape other than a sheet, before the work if the shape is given.
fn refuse_raster_of(job: &FitJob, outputs: &[PlannedOutput]) -> Result<()> {
    let shape =
        job.task.fit_options().and_then(|options| options.shape).filter(|shape| *shape != Shape::Sheet);
    if let Some(shape) = shape {
        // The shape that the filter would select contradicts the given one. Neither is silently overridden.
        if job.task.ground().is_some() {
            return Err(Error::input(format!(
                "expected the shape sheet for the ground, found {}",
                shape.name()
            ))
            .with_setting(Setting::Shape));
        }
        if let Some(raster) = outputs.iter().find(|output| output.format == OutputFormat::Tiff) {
            return Err(Error::input(format!(
                "{}: expected the shape sheet for a raster of heights, found {}",
                raster.path.display(),
                shape.name()
            ))
            .with_setting(Setting::Shape));
        }
    }
    Ok(())
}

/// Warns if a sheet is fitted to lidar without classes: it follows roofs and trees, which may be intended.
fn unclassified(job: &FitJob, set: &ScanSet) -> Vec<Finding> {
    let of_lidar = |path: &std::path::Path| ["las", "laz"].contains(&extension(path).as_str());
    let lidar = set.inputs.iter().any(|input| of_lidar(&input.path));
    let classified = set.scans.iter().any(|posed| posed.scan.classes.is_some());
    let is_sheet = |options: &FitOptions| options.shape == Some(Shape::Sheet) && options.ground().is_none();
    // Only if the sheet was requested: a closed shape of lidar points is not terrain.
    let wanted = job.task.fit_options().is_some_and(is_sheet);
    if wanted && lidar && !classified {
        let text = "the lidar points have no classes: buildings and trees are part of the sheet; use the \
            ground filter to reject them";
        vec![Finding::new(FindingCode::PointsUnclassified, text).with_setting(Setting::Ground)]
    } else {
        Vec::new()
    }
}

fn check_settings(job: &FitJob) -> Result<()> {
    let (gate, held_out_share) = (job.task.gate(), job.task.held_out_share());
    let max_coefficients = job.task.max_coefficients();
    let tolerance = job.task.fit_options().and_then(|options| options.tolerance);
    let widest = match job.task.ground() {
        Some(GroundWidth::Widest(widest)) => Some(widest),
        _ => None,
    };
    for (name, value) in [
        ("tolerance", job.tolerance.map(|length| length.value).or(tolerance)),
        ("mesh tolerance", job.mesh_tolerance.map(|length| length.value)),
        ("cell size", job.cell_size.map(|length| length.value)),
        ("width of objects on the ground", widest),
    ] {
        // Negated, so that NaN is refused as well.
        if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
            return Err(Error::input(format!("expected a {name} > 0, found {value}")));
        }
    }
    // A gate below 1 σ would reject a third of correct readings and bias σ towards zero.
    if !(gate.is_finite() && gate >= 1.0) {
        return Err(Error::input(format!("expected a gate of at least 1 σ (4 is usual), found {gate}")));
    }
    if max_coefficients < MIN_COEFFICIENTS {
        return Err(Error::input(format!(
            "expected at least {MIN_COEFFICIENTS} coefficients, found a limit of {max_coefficients}"
        )));
    }
    // With a larger share, too few readings would be left to fit.
    if !(0.0..0.9).contains(&held_out_share) {
        return Err(Error::input(format!(
            "expected a held-out share from 0 to below 0.9, found {held_out_share}"
        )));
    }
    Ok(())
}
