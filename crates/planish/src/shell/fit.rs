//! `planish shell fit`: deforms a mesh by a few controls so that it matches points and the outlines of views.
//!
//! Input: any mesh, point files, and `views.toml` with masks. Output: the deformed mesh with σ along its
//! normals and with its texture; poses of uncertain cameras; the overlap with the masks, including held-out
//! views.
//!
//! Not guaranteed: a mesh that starts more than a tenth of its size away from the points, or that does not
//! overlap its masks, may converge to a wrong position.

mod figures;
mod frames;
pub(super) mod input;
mod inspection;
mod landmarks;
mod page;
mod report;
mod rough_start;

use super::appearance::{Known, picture_of, write_moved};
use super::surface::mesh_outputs;
use crate::job::Job;
use crate::report::{ReportOutput, with_page};
pub use figures::{CameraPoseReport, FlowReport, FrameReport, ReadingsReport, ShellFitReport};
use frames::{FittedFrame, FrameStage, Moving, Pass};
use input::{Frame, FrameFiles, Moved, Units};
use page::{ShownShell, shell_page};
use planish_core::{Finding, Progress, WRITING_STAGE};
use planish_estimate::{Error, Result, Termination};
use planish_exchange::Unit;
use planish_exchange::mesh::is_mesh_file;
use planish_exchange::textured::{TexturedMesh, read_textured};
use planish_mesh::TriangleMesh;
pub use planish_shell::Metaball;
use planish_shell::intersection_over_union;
use planish_shell::{
    Camera, ControlGrowth, ControlledDeformation, Controls, FrameFit, GrownFit, ShellFit, ShellFitOptions,
    ShellProgress, ShellTracker, fit_shell_with_progress, fit_with_growing_controls,
};
use planish_surface::export::{KnownMesh, write_known_mesh};
use planish_surface::model::SigmaSummary;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Number of neighbours that each control is joined to if there is no triangulation. Fewer can leave groups
/// unconnected; more make the energy resist bending over several spacings.
const NEIGHBOURS: usize = 6;
/// Minimum fraction of a vertex's information that comes from readings for `observed` = 1.
const MIN_DATA_SHARE: f64 = 0.5;

/// Kind of deformation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DeformationKind {
    /// Natural neighbours of control points.
    #[default]
    Dirichlet,
    /// A lattice of control points around the mesh.
    Lattice,
    /// Every vertex.
    Vertices,
    /// The principal modes of a family of meshes.
    Modes,
}

/// Settings of the job.
#[derive(Debug, Clone, PartialEq)]
pub struct ShellFitJob {
    /// The mesh.
    pub mesh: PathBuf,
    /// Files of points.
    pub points: Vec<PathBuf>,
    /// Cameras and masks.
    pub silhouettes: Option<PathBuf>,
    /// Measured positions of places of the mesh.
    pub landmarks: Option<PathBuf>,
    /// Folder with a folder for each frame of a moving object. It replaces points, silhouettes and landmarks.
    pub sequence: Option<PathBuf>,
    /// Kind of deformation.
    pub deformation: DeformationKind,
    /// Number of controls if no file is given. For a lattice, the number of its points; for modes, their
    /// maximum number.
    ///
    /// Default: 60. Fits to points add more where the mesh does not follow them ([`ControlGrowth`]).
    pub controls: Option<usize>,
    /// Control points.
    pub controls_file: Option<PathBuf>,
    /// The family whose modes move the mesh: the same vertices in every file.
    pub family: Vec<PathBuf>,
    /// Parts that stay rigid: a group, object or material of the OBJ, or a file of vertex indices.
    pub rigid: Vec<String>,
    /// Length over which rigid parts blend into the rest (default: a tenth of the mesh's size).
    pub blend: Option<f64>,
    /// Shape of the metaballs.
    pub metaball: Metaball,
    /// Minimum distance between points on the outline of a mask, in pixels.
    pub outline_step_px: f64,
    /// Whether the stated σ of points and outlines are used without estimating them.
    pub believe_sigma: bool,
    /// Whether the mesh is only a rough start. It then grows where masks are not covered, is cut where they
    /// show background, and is remeshed before the fit.
    pub rough_start: bool,
    /// Whether each frame of a sequence is estimated from the frames up to it only.
    pub causal: bool,
    /// Whether a mesh is written that does not follow much of its points.
    pub force: bool,
    /// Meshes to write.
    pub outputs: Vec<PathBuf>,
    /// A page that shows the result.
    pub report: Option<ReportOutput>,
    /// Unit if no file states one.
    pub unit: Option<Unit>,
}

/// Start and end of the fit in the progress of the job.
const FITTING_PROGRESS: (f64, f64) = (0.05, 0.95);

impl Default for ShellFitJob {
    fn default() -> Self {
        Self {
            mesh: PathBuf::new(),
            points: Vec::new(),
            silhouettes: None,
            landmarks: None,
            sequence: None,
            deformation: DeformationKind::default(),
            controls: None,
            controls_file: None,
            family: Vec::new(),
            rigid: Vec::new(),
            blend: None,
            metaball: Metaball::Triangular,
            outline_step_px: 5.0,
            believe_sigma: false,
            rough_start: false,
            causal: false,
            force: false,
            outputs: Vec::new(),
            report: None,
            unit: None,
        }
    }
}

impl Job for ShellFitJob {
    type Report = ShellFitReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(inputs_with_frames(self, &frames_of(self)?))
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        let outputs = outputs_of_frames(self, &frames_of(self)?).concat();
        with_page(
            mesh_outputs(&outputs, is_mesh_file, ".ply, .obj, .stl, .off or .glb")?,
            self.report.as_ref(),
        )
    }

    fn execute(&self, progress: &dyn Progress) -> Result<ShellFitReport> {
        fit_mesh(self, progress)
    }
}

impl ShellFitJob {
    /// True if controls are added where the mesh does not follow the points: unless their number or places
    /// are given. Sequences and rough starts have a fixed number.
    fn adds_controls(&self) -> bool {
        self.deformation == DeformationKind::Dirichlet
            && self.controls.is_none()
            && self.controls_file.is_none()
            && self.sequence.is_none()
            && !self.rough_start
            && !self.points.is_empty()
    }
}

/// The files that the job names, with those of its frames.
fn inputs_with_frames(job: &ShellFitJob, frames: &[FrameFiles]) -> Vec<PathBuf> {
    let of_frames = (frames.iter())
        .flat_map(|frame| frame.points.iter().chain(&frame.silhouettes).chain(&frame.landmarks));
    let named = [&job.mesh].into_iter().chain(&job.controls_file).chain(&job.family);
    named.chain(of_frames).cloned().collect()
}

/// Points and silhouettes of each frame; one frame without a name if the mesh is fitted once.
fn frames_of(job: &ShellFitJob) -> Result<Vec<FrameFiles>> {
    match &job.sequence {
        // The command refuses these combinations earlier; users of the library meet them here.
        Some(_) if job.rough_start => Err(Error::input(
            "expected a mesh without a rough start for a sequence: make the rough start from the \
             silhouettes of the first frame alone",
        )),
        Some(_) if !job.points.is_empty() || job.silhouettes.is_some() || job.landmarks.is_some() => {
            Err(Error::input(
                "expected points, silhouettes and landmarks in the folders of the frames of a sequence, \
                 found them as separate inputs",
            ))
        }
        Some(folder) => input::frames_of(folder),
        None => Ok(vec![FrameFiles {
            name: String::new(),
            points: job.points.clone(),
            silhouettes: job.silhouettes.clone(),
            landmarks: job.landmarks.clone(),
        }]),
    }
}

/// Fits, and writes the outputs. Frames of a sequence are written when they have been followed, and again
/// when they have been smoothed; if it is interrupted, those are kept that are written.
fn fit_mesh(job: &ShellFitJob, progress: &dyn Progress) -> Result<ShellFitReport> {
    let frames = frames_of(job)?;
    let mut run = Run {
        job,
        progress,
        outputs: outputs_of_frames(job, &frames),
        inputs: inputs_with_frames(job, &frames),
        units: Units::new(job.unit),
        findings: Vec::new(),
        unfollowed: vec![None; frames.len()],
        of_frames: Vec::new(),
        written: Vec::new(),
    };
    progress.check("reading", 0.0)?;
    let mut start = run.start()?;
    // After the start: controls are placed on the mesh that is fitted, and modes replace its vertices.
    let Moved { deformation, stiffness, rigidity, prior, mut controls } =
        input::moved(job, &mut start.mesh, &start.appearance)?;
    let size = start.size(job)?;
    let options = ShellFitOptions {
        metaball: job.metaball,
        believe_sigma: job.believe_sigma,
        stiffness,
        // Outlines alone and rough starts have been tested with the stiffness only.
        rigidity: rigidity.filter(|_| !job.rough_start && frames.iter().any(|f| !f.points.is_empty())),
        prior,
        iterations: 20,
        ..match job.rough_start {
            true => rough_start::options(size),
            false => ShellFitOptions::default(),
        }
    };
    // The tracker keeps the motion between frames. Only a sequence has one, because a single fit starts from
    // the mesh itself.
    let mut tracker = match &job.sequence {
        Some(_) => Some(ShellTracker::new(&start.mesh, &*deformation, options.clone())?),
        None => None,
    };
    // Read once for all frames.
    let picture = picture_of(&start.appearance, &mut run.findings);
    let picture = picture.as_deref();
    let (mut last, mut grown) = (None, None);
    let smooths = tracker.is_some() && !job.causal && frames.len() > 1;
    for (k, files) in frames.iter().enumerate() {
        let pass = if tracker.is_some() { Pass::Following { smooths } } else { Pass::Fitting };
        let stage = FrameStage { number: k, count: frames.len(), pass, name: &files.name };
        let frame = run.read_frame(&stage, files, &start)?;
        let mut watch = |at: ShellProgress| stage.report(progress, &at);
        let fitted = match &mut tracker {
            Some(tracker) => tracker.follow_with_progress(&frame.readings(), &mut watch),
            None if job.adds_controls() => grown_fit(job, &start, &frame, &options, &mut watch).map(|made| {
                controls = made.controls.points.len();
                grown = Some(made.deformation);
                single(made.fit)
            }),
            None => {
                fit_shell_with_progress(&start.mesh, &*deformation, &frame.readings(), &options, &mut watch)
                    .map(single)
            }
        };
        let FrameFit { fit, predicted, .. } = fitted.map_err(|e| stage.in_frame(e))?;
        let of_mesh =
            Moving { start: &start, deformation: &**grown.as_ref().unwrap_or(&deformation), picture, size };
        last = Some(run.take(&stage, &of_mesh, frame, fit, predicted)?);
    }
    if let (true, Some(tracker)) = (smooths, &tracker) {
        let of_mesh = Moving { start: &start, deformation: &*deformation, picture, size };
        run.smooth(&frames, &of_mesh, tracker)?;
    }
    progress.check(WRITING_STAGE, 0.98)?;
    // The figures and the page are those of the last frame.
    let last = last.ok_or_else(|| Error::input("expected at least one frame in the sequence, found none"))?;
    run.finish(start, last, controls)
}

/// A fit that follows no other frame.
fn single(fit: ShellFit) -> FrameFit {
    FrameFit { fit, predicted: None, acceleration: 0.0 }
}

/// Fits with controls that are added where the mesh does not follow the points.
fn grown_fit(
    job: &ShellFitJob,
    start: &Start,
    frame: &Frame,
    options: &ShellFitOptions,
    watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
) -> Result<GrownFit> {
    let parts = input::rigid_parts(job, &start.appearance)?;
    let controlled = input::deformable_part(&start.mesh, &parts);
    let build = |controls: &Controls| {
        let Moved { deformation, stiffness, rigidity, .. } =
            input::of_controls(job, &start.mesh, &parts, controls)?;
        Ok(ControlledDeformation { deformation, stiffness, rigidity })
    };
    let growth = ControlGrowth::default();
    fit_with_growing_controls(&start.mesh, &controlled, &build, &frame.readings(), options, growth, watch)
}

/// State collected during a run.
struct Run<'a> {
    job: &'a ShellFitJob,
    progress: &'a dyn Progress,
    /// Files of the meshes, frame by frame.
    outputs: Vec<Vec<PathBuf>>,
    inputs: Vec<PathBuf>,
    units: Units,
    findings: Vec<Finding>,
    /// Findings about points that the mesh does not follow, frame by frame.
    unfollowed: Vec<Option<Finding>>,
    /// The figures of the frames of a sequence.
    of_frames: Vec<FrameReport>,
    written: Vec<PathBuf>,
}

/// The mesh that a fit starts with.
struct Start {
    /// The mesh of the file.
    given: TriangleMesh,
    /// The mesh for the fit, remeshed after a rough start.
    mesh: TriangleMesh,
    /// Texture, parts and file data of the mesh.
    appearance: TexturedMesh,
    /// σ of the vertices of a rough start; empty for others.
    sigma: Vec<f64>,
    flow: Option<FlowReport>,
}

impl Start {
    /// The diagonal of the mesh's bounding box.
    fn size(&self, job: &ShellFitJob) -> Result<f64> {
        match self.mesh.surface_bounds().map_or(0.0, |bounds| bounds.diagonal()) {
            size if size > 0.0 => Ok(size),
            _ => Err(Error::undetermined(format!(
                "{}: expected faces with an extent, found all vertices at one point",
                job.mesh.display()
            ))),
        }
    }
}

impl Run<'_> {
    /// Reads the mesh; a rough start flows to the masks first.
    fn start(&mut self) -> Result<Start> {
        let (mesh, appearance) = read_template(self.job, &mut self.units)?;
        self.inputs.extend(appearance.files.iter().cloned());
        self.findings.extend(appearance.findings.iter().cloned());
        // The overlap before the fit refers to the mesh of the file, also after a rough start.
        let given = mesh.clone();
        if !self.job.rough_start {
            return Ok(Start { given, mesh, appearance, sigma: Vec::new(), flow: None });
        }
        let progress = self.progress;
        progress.check("flowing", 0.0)?;
        let made = rough_start::rough_start_mesh(self.job, mesh, &mut self.units, &mut |rounds| {
            progress.items(rounds, "rounds");
            // The number of rounds is unknown, so the share only approaches its end.
            progress.check("flowing", FITTING_PROGRESS.0 * rounds as f64 / (rounds + 3) as f64)
        })?;
        // Remeshing changes the vertices, so texture coordinates and groups no longer belong to any.
        let appearance = rough_start::without_appearance(appearance, &made.mesh, &mut self.findings);
        Ok(Start { given, mesh: made.mesh, appearance, sigma: made.sigma, flow: Some(made.report) })
    }

    /// Reads the points and views of a frame; those of the first are compared with the mesh.
    fn read_frame(&mut self, stage: &FrameStage<'_>, files: &FrameFiles, start: &Start) -> Result<Frame> {
        self.progress.check(stage.title(), stage.share(0.0))?;
        let frame = Frame::read(self.job, files, &start.mesh, &mut self.units, &mut self.findings)?;
        self.inputs.extend(frame.files.iter().cloned());
        // Only the first frame can be compared with the given mesh. Later ones may have moved far from it.
        if stage.number == 0 {
            inspection::points_and_mesh(&frame, &start.mesh, self.units.unit())
                .map_err(|e| stage.in_frame(e))?;
            self.findings.extend(inspection::masks(&frame, &start.mesh, !self.job.rough_start));
        }
        Ok(frame)
    }

    /// Writes the fitted mesh of a frame.
    fn write(
        &mut self,
        number: usize,
        start: &Start,
        known: &KnownMesh<'_>,
        picture: Option<&[u8]>,
    ) -> Result<()> {
        let KnownMesh { mesh, sigma, observed, unit, .. } = *known;
        for output in &self.outputs[number] {
            let textured = TexturedMesh { unit: Some(unit), ..start.appearance.clone() };
            let files = write_moved(output, &textured, &mesh.positions, Known { sigma, observed }, picture)?;
            let files = match files {
                Some(files) => files,
                None => {
                    // Without a texture, the mesh has σ and `observed` as columns.
                    write_known_mesh(output, known)?;
                    vec![output.clone()]
                }
            };
            // Smoothed frames are written again.
            let new: Vec<PathBuf> = files.into_iter().filter(|file| !self.written.contains(file)).collect();
            self.written.extend(new);
        }
        Ok(())
    }

    /// The figures of the last frame, and the page.
    fn finish(self, start: Start, last: FittedFrame, controls: usize) -> Result<ShellFitReport> {
        let FittedFrame { frame, fit, iou, sigma, observed } = last;
        let given: Vec<Camera> = frame.fitted.iter().map(|view| view.camera).collect();
        // σ of vertices that only smoothness determines would hide how accurate the measured part is.
        let measured: Vec<f64> =
            (sigma.iter().zip(&observed)).filter(|(_, o)| **o == 1).map(|(s, _)| *s).collect();
        // Sources without readings are absent from the report.
        let sources = [&fit.points, &fit.outlines, &fit.tracks, &fit.landmarks];
        let of = sources.map(ReadingsReport::from_source);
        let [points, outlines, tracks, landmarks] = of;
        let mut done = ShellFitReport {
            rms_points: points.map(|r| r.rms),
            rms_silhouettes_px: outlines.map(|r| r.rms),
            iou,
            // With the cameras as given: it shows what the fit gained, including corrections of poses.
            iou_before: overlap(&frame, &start.given, &given),
            held_out: (frame.views.iter())
                .filter(|view| view.held_out)
                .map(|view| view.name.clone())
                .collect(),
            controls,
            outliers: of.iter().flatten().map(|r| r.outliers).sum(),
            points,
            outlines,
            tracks,
            landmarks,
            poses: report::poses(&frame, &fit),
            observed_fraction: measured.len() as f64 / sigma.len().max(1) as f64,
            sigma: SigmaSummary::from_values(measured),
            smoothness_weight: fit.smoothness_weight,
            unresolved_shape: fit.unresolved_shape,
            iterations: fit.iterations,
            flow: start.flow,
            frames: self.of_frames,
            termination: match fit.termination {
                _ if !inspection::follows(&fit, &start.mesh, frame.states_sigma) => "not_following",
                Termination::Converged => "converged",
                Termination::ReachedTolerance => "reached_tolerance",
                _ => "limit",
            },
            unit: self.units.unit(),
            inputs: self.inputs,
            written: self.written,
            findings: self.findings.into_iter().chain(self.unfollowed.into_iter().flatten()).collect(),
        };
        let trusts_sigma = self.job.believe_sigma;
        done.findings.extend(inspection::rejected_landmarks(&fit, &frame, self.units.unit()));
        let outcome =
            inspection::outcome(&done, &start.mesh, &fit.positions, frame.states_sigma, trusts_sigma);
        done.findings.extend(outcome);
        let ending = inspection::ending(&done);
        done.findings.extend(ending);
        if let Some(page) = &self.job.report {
            let shown = ShownShell {
                found: &TriangleMesh { positions: fit.positions, triangles: start.mesh.triangles.clone() },
                // Not the mesh of the file: after a rough start, only this one has the vertices of the
                // result.
                given: &start.mesh,
                sigma: &sigma,
                observed: &observed,
                points: frame.points.iter().map(|reading| reading.at).collect(),
            };
            let files: Vec<_> = done.inputs.iter().map(|path| (path.clone(), String::new())).collect();
            page.write(shell_page(&done, &shown, std::slice::from_ref(&self.job.mesh)), &files)?;
        }
        Ok(done)
    }
}

/// Files of the meshes of each frame.
fn outputs_of_frames(job: &ShellFitJob, frames: &[FrameFiles]) -> Vec<Vec<PathBuf>> {
    let of_frame = |frame: &FrameFiles, output: &Path| match job.sequence {
        None => output.to_owned(),
        Some(_) => {
            let stem = output.file_stem().unwrap_or_default().to_string_lossy();
            let ending = output.extension().unwrap_or_default().to_string_lossy();
            // The name of the frame goes before the extension, which selects the format.
            output.with_file_name(format!("{stem}.{}.{ending}", frame.name))
        }
    };
    frames.iter().map(|frame| job.outputs.iter().map(|output| of_frame(frame, output)).collect()).collect()
}

/// The mesh and its appearance.
fn read_template(job: &ShellFitJob, units: &mut Units) -> Result<(TriangleMesh, TexturedMesh)> {
    let file = read_textured(&job.mesh)?;
    units.add(file.unit, &job.mesh)?;
    if file.triangles.is_empty() {
        return Err(Error::undetermined(format!(
            "{}: expected a mesh with faces, found none",
            job.mesh.display()
        )));
    }
    let mesh = TriangleMesh { positions: file.points.clone(), triangles: file.triangles.clone() };
    Ok((mesh, file))
}

/// Overlap (IoU) of a mesh with the mask of each view.
// Sorted by name: a hash map would order the views differently in each run.
fn overlap(frame: &Frame, mesh: &TriangleMesh, cameras: &[Camera]) -> BTreeMap<String, f64> {
    (frame.views.iter().zip(&frame.masks).zip(cameras))
        .filter_map(|((view, mask), camera)| {
            (mask.as_ref()).map(|mask| {
                (
                    view.name.clone(),
                    intersection_over_union(mesh, camera, &mask.mask, mask.columns, mask.rows),
                )
            })
        })
        .collect()
}
