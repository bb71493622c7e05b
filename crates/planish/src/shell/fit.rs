//! `planish shell fit`: a mesh moved by a few controls until it goes through points and shows the outlines of
//! views.
//!
//! Comes in: a mesh of any kind, point files, `views.toml` with masks. Goes out: the mesh where it was found,
//! with σ along its normals, and with its texture; poses of cameras that were uncertain; how far the masks
//! are covered, in views held out as well.
//!
//! Not guaranteed: the right place for a mesh that starts more than a tenth of its size away from points, or
//! that does not overlap its masks.

pub(super) mod input;
mod inspection;
mod report;
mod rough_start;

use super::looks::{Known, picture_of, write_moved};
use super::surface::check_outputs;
use crate::report::{ReportOutput, ShownShell, shell_page};
use input::{Frame, FrameFiles, Moved, Units};
use planish_core::{Progress, WRITING_STAGE};
use planish_estimate::{Error, ErrorKind, Result, Termination};
use planish_exchange::Unit;
use planish_exchange::mesh::is_mesh_file;
use planish_exchange::textured::{TexturedMesh, read_textured};
use planish_mesh::TriangleMesh;
pub use planish_shell::Metaball;
use planish_shell::intersection_over_union;
use planish_shell::{
    Camera, FrameFit, ShellFitOptions, ShellProgress, ShellTracker, SourceFit, fit_shell_watched,
};
use planish_surface::export::write_known_mesh;
use planish_surface::model::SigmaSummary;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Neighbours that controls without a triangulation are joined to.
const NEIGHBOURS: usize = 6;
/// A vertex is measured where at least so much of what is known of it comes from the readings.
const MEASURED: f64 = 0.5;

/// What moves the mesh.
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

/// What to do.
#[derive(Debug, Clone, PartialEq)]
pub struct ShellFitJob {
    /// The mesh.
    pub mesh: PathBuf,
    /// Files of points.
    pub points: Vec<PathBuf>,
    /// Cameras and masks.
    pub silhouettes: Option<PathBuf>,
    /// A folder with one for each frame of something that moves, instead of points and silhouettes.
    pub sequence: Option<PathBuf>,
    /// What moves the mesh.
    pub deformation: DeformationKind,
    /// How many controls, where none are given: of a lattice all its points, of modes the most.
    pub controls: usize,
    /// Control points.
    pub controls_file: Option<PathBuf>,
    /// The family whose modes move the mesh: the same vertices in every file.
    pub family: Vec<PathBuf>,
    /// Parts that stay rigid: a group, object or material of the OBJ, or a file of vertex indices.
    pub rigid: Vec<String>,
    /// Over which length they fade into the rest; a tenth of the mesh's size where none is given.
    pub blend: Option<f64>,
    /// What metaballs are built around.
    pub metaball: Metaball,
    /// Places on the border of a mask are at least so far apart, in pixels.
    pub outline_step_px: f64,
    /// Whether σ of points and outlines are what is stated.
    pub believe_sigma: bool,
    /// Whether the mesh is only a start: it then flows out where masks are not covered, is cut where they
    /// show nothing, and made anew before the fit.
    pub rough_start: bool,
    /// Meshes to write.
    pub outputs: Vec<PathBuf>,
    /// A page that shows what was found.
    pub report: Option<ReportOutput>,
    /// The unit where no file names it.
    pub unit: Option<Unit>,
}

/// What became of readings of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReadingsReport {
    /// How many there were.
    pub count: usize,
    /// How many of them are gross errors.
    pub outliers: usize,
    /// Root mean square of the residuals of all others: distances of points, pixels of outlines, σ of tracks.
    pub rms: f64,
    /// By how much their σ are larger than stated.
    pub sigma_factor: f64,
}

impl ReadingsReport {
    fn of(source: &SourceFit) -> Option<Self> {
        (!source.outliers.is_empty()).then(|| Self {
            count: source.outliers.len(),
            outliers: source.outliers.iter().filter(|outlier| **outlier).count(),
            rms: source.rms,
            sigma_factor: source.sigma_factor,
        })
    }
}

/// A pose that was uncertain.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PoseReport {
    /// Its view.
    pub view: String,
    /// How far it was turned, in degrees.
    pub turned_deg: f64,
    /// How far it was moved.
    pub moved: f64,
    /// `R`, row by row.
    pub r: [[f64; 3]; 3],
    /// `t`.
    pub t: [f64; 3],
    /// σ about each axis of the camera, in degrees.
    pub sigma_rotation_deg: [f64; 3],
    /// σ along each axis of the camera.
    pub sigma_translation: [f64; 3],
}

/// A frame of a sequence.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameReport {
    /// Its folder's name.
    pub frame: String,
    /// Root mean square of the distances of points that are no gross errors.
    pub rms_points: Option<f64>,
    /// The same of places on outlines, in pixels.
    pub rms_silhouettes_px: Option<f64>,
    /// The mean over its views of how far what they show agrees with their masks.
    pub iou: Option<f64>,
    /// Root mean square of what parameters differ from what was predicted, over that of their σ; none of the
    /// first.
    pub surprise: Option<f64>,
    /// The median σ of vertices along normals.
    pub sigma: f64,
}

/// What became of a rough start before the fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlowReport {
    /// How often the mesh was made anew.
    pub rounds: usize,
    /// Facets of the mesh that was fitted.
    pub facets: usize,
    /// Its parts.
    pub parts: usize,
    /// How far it agreed with each mask.
    pub iou: BTreeMap<String, f64>,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ShellFitReport {
    /// Root mean square of the distances of points that are no gross errors.
    pub rms_points: Option<f64>,
    /// The same of places on outlines, in pixels.
    pub rms_silhouettes_px: Option<f64>,
    /// How far what each view shows agrees with its mask.
    pub iou: BTreeMap<String, f64>,
    /// The same before the fit.
    pub iou_before: BTreeMap<String, f64>,
    /// Views that took no part.
    pub held_out: Vec<String>,
    /// How many controls there are; parameters, of modes.
    pub controls: usize,
    /// Gross errors of all kinds.
    pub outliers: usize,
    /// Points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<ReadingsReport>,
    /// Places on outlines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outlines: Option<ReadingsReport>,
    /// Tracked features.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracks: Option<ReadingsReport>,
    /// Poses that were uncertain.
    pub poses: Vec<PoseReport>,
    /// σ of the vertices that were measured, along normals.
    pub sigma: SigmaSummary,
    /// The share of vertices of which more than half of what is known comes from the readings.
    pub observed_fraction: f64,
    /// The weight of smoothness, by marginal likelihood.
    pub smoothness_weight: f64,
    /// σ of what the controls cannot follow, along normals; σ of the vertices holds it.
    pub lack_of_fit: f64,
    /// Iterations.
    pub iterations: usize,
    /// What became of a rough start before the fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow: Option<FlowReport>,
    /// Frames of a sequence; all above is of the last.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frames: Vec<FrameReport>,
    /// How it ended.
    pub termination: &'static str,
    /// The unit of lengths.
    #[serde(skip)]
    pub unit: Unit,
    /// Every file that was read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
    /// Every file that was written.
    #[serde(skip)]
    pub written: Vec<PathBuf>,
    /// What a user should know.
    #[serde(skip)]
    pub warnings: Vec<String>,
}

/// Where fitting begins and ends in the whole job.
const FITTING: (f64, f64) = (0.05, 0.95);

/// Fits, and writes what was asked for.
///
/// # Errors
/// `Io` where a file cannot be read or written; `Input` for meshes without faces, views that make no sense,
/// units that differ, and everything that [`fit_shell_watched`] refuses; `Undetermined` where the readings do
/// not say where the mesh is; `Interrupted` when told to stop, at the next iteration: of a sequence the
/// frames before are written then.
pub fn shell_fit_files(job: &ShellFitJob, progress: &dyn Progress) -> Result<ShellFitReport> {
    let mut inputs = vec![job.mesh.clone()];
    inputs.extend(job.controls_file.iter().chain(&job.family).cloned());
    let frames = match &job.sequence {
        Some(_) if job.rough_start => {
            return Err(Error::input(
                "a sequence follows one mesh: make a rough start ready by the first frame's silhouettes alone",
            ));
        }
        Some(_) if !job.points.is_empty() || job.silhouettes.is_some() => {
            return Err(Error::input(
                "a sequence holds its points and silhouettes in the folders of its frames",
            ));
        }
        Some(folder) => input::frames_of(folder)?,
        None => vec![FrameFiles {
            name: String::new(),
            points: job.points.clone(),
            silhouettes: job.silhouettes.clone(),
        }],
    };
    inputs.extend(frames.iter().flat_map(|frame| frame.points.iter().chain(&frame.silhouettes)).cloned());
    let outputs = outputs_of(job, &frames, &inputs)?;
    if let Some(page) = &job.report {
        page.check(&inputs, &outputs.concat())?;
    }
    progress.check("reading", 0.0)?;
    let mut units = Units::of(job.unit);
    let (mut mesh, mut looks) = read_template(job, &mut units)?;
    inputs.extend(looks.files.iter().cloned());
    let mut warnings = looks.warnings.clone();
    let given_mesh = mesh.clone();
    let (mut flow, mut start_sigma) = (None, Vec::new());
    if job.rough_start {
        progress.check("flowing", 0.0)?;
        let made = rough_start::flown(job, mesh, &mut units, &mut |rounds| {
            progress.items(rounds, "rounds");
            progress.check("flowing", FITTING.0 * rounds as f64 / (rounds + 3) as f64)
        })?;
        looks = rough_start::without_looks(looks, &made.mesh, &mut warnings);
        (mesh, start_sigma, flow) = (made.mesh, made.sigma, Some(made.report));
    }
    let Moved { deformation, stiffness, prior, controls } = input::moved(job, &mut mesh, &looks)?;
    let size = mesh.surface_bounds().map_or(0.0, |bounds| bounds.diagonal());
    if size <= 0.0 {
        return Err(Error::undetermined(format!(
            "{}: all vertices of faces are at one place: a mesh needs a size",
            job.mesh.display()
        )));
    }
    let options = ShellFitOptions {
        metaball: job.metaball,
        believe_sigma: job.believe_sigma,
        stiffness,
        prior,
        iterations: 20,
        ..match job.rough_start {
            true => rough_start::options(size),
            false => ShellFitOptions::default(),
        }
    };
    let mut tracker = match &job.sequence {
        Some(_) => Some(ShellTracker::new(&mesh, &*deformation, options.clone())?),
        None => None,
    };
    let (mut of_frames, mut last) = (Vec::new(), None);
    let picture = picture_of(&looks, &mut warnings);
    let mut written = Vec::new();
    for (k, files) in frames.iter().enumerate() {
        let tracked = tracker.is_some();
        let stage = if tracked { "following" } else { "fitting" };
        let share =
            |of_frame: f64| FITTING.0 + (FITTING.1 - FITTING.0) * (k as f64 + of_frame) / frames.len() as f64;
        progress.check(stage, share(0.0))?;
        let in_frame = |e: Error| {
            if files.name.is_empty() {
                e
            } else if e.kind() == ErrorKind::Interrupted {
                Error::new(e.kind(), format!("interrupted in frame {}: {k} frames are done", files.name))
            } else {
                e.in_context(format!("frame {}", files.name))
            }
        };
        let frame = Frame::read(job, files, size, &mut units, &mut warnings)?;
        inputs.extend(frame.files.iter().cloned());
        if k == 0 {
            inspection::points_and_mesh(&frame, &mesh, units.unit()).map_err(in_frame)?;
            warnings.extend(inspection::masks(&frame, &mesh, !job.rough_start));
        }
        let mut watch = |at: ShellProgress| {
            if let Some(rms) = at.rms_points {
                progress.rms(rms);
            }
            if tracked {
                progress.items(k, "frames");
            } else {
                progress.items(at.iteration, "iterations");
            }
            progress.check(stage, share(at.share))
        };
        let made = match &mut tracker {
            Some(tracker) => tracker.follow_watched(&frame.readings(), &mut watch),
            None => fit_shell_watched(&mesh, &*deformation, &frame.readings(), &options, &mut watch)
                .map(|fit| FrameFit { fit, predicted: None, acceleration: 0.0 }),
        };
        let FrameFit { fit: made, predicted, .. } = made.map_err(in_frame)?;
        let found = TriangleMesh { positions: made.positions.clone(), triangles: mesh.triangles.clone() };
        let (normals, sigma, observed) = report::known(&found, &made, &*deformation, &start_sigma);
        for output in &outputs[k] {
            let textured = TexturedMesh { unit: Some(units.unit()), ..looks.clone() };
            let stated = Known { sigma: &sigma, observed: &observed };
            match write_moved(output, &textured, &found.positions, stated, picture.as_deref())? {
                Some(files) => written.extend(files),
                None => {
                    write_known_mesh(output, &found, &normals, &sigma, &observed, None, units.unit())?;
                    written.push(output.clone());
                }
            }
        }
        let iou = overlap(&frame, &found, &made.cameras);
        if tracker.is_some() {
            of_frames.push(FrameReport {
                frame: files.name.clone(),
                rms_points: ReadingsReport::of(&made.points).map(|r| r.rms),
                rms_silhouettes_px: ReadingsReport::of(&made.outlines).map(|r| r.rms),
                iou: (!iou.is_empty()).then(|| iou.values().sum::<f64>() / iou.len() as f64),
                surprise: predicted.map(|q| (&made.parameters - q).norm() / made.covariance.trace().sqrt()),
                sigma: SigmaSummary::from_values(sigma.clone()).median,
            });
        }
        last = Some((frame, made, iou, sigma, observed));
    }
    progress.check(WRITING_STAGE, 0.98)?;
    let (frame, made, iou, sigma, observed) =
        last.ok_or_else(|| Error::input("a sequence without frames"))?;
    let given: Vec<Camera> = frame.fitted.iter().map(|view| view.camera).collect();
    let iou_before = overlap(&frame, &given_mesh, &given);
    let measured: Vec<f64> =
        (sigma.iter().zip(&observed)).filter(|(_, o)| **o == 1).map(|(s, _)| *s).collect();
    let of = [&made.points, &made.outlines, &made.tracks].map(ReadingsReport::of);
    let [points, outlines, tracks] = of;
    let mut done = ShellFitReport {
        rms_points: points.map(|r| r.rms),
        rms_silhouettes_px: outlines.map(|r| r.rms),
        iou,
        iou_before,
        held_out: (frame.views.iter()).filter(|view| view.held_out).map(|view| view.name.clone()).collect(),
        controls,
        outliers: of.iter().flatten().map(|r| r.outliers).sum(),
        points,
        outlines,
        tracks,
        poses: report::poses(&frame, &made),
        observed_fraction: measured.len() as f64 / sigma.len().max(1) as f64,
        sigma: SigmaSummary::from_values(measured),
        smoothness_weight: made.smoothness_weight,
        lack_of_fit: made.lack_of_fit,
        iterations: made.iterations,
        flow,
        frames: of_frames,
        termination: match made.termination {
            Termination::Converged => "converged",
            Termination::ReachedTolerance => "reached_tolerance",
            _ => "limit",
        },
        unit: units.unit(),
        inputs,
        written,
        warnings,
    };
    done.warnings.extend(inspection::outcome(
        &done,
        &mesh,
        &made.positions,
        frame.states_sigma,
        job.believe_sigma,
    ));
    if let Some(page) = &job.report {
        let shown = ShownShell {
            found: &TriangleMesh { positions: made.positions, triangles: mesh.triangles.clone() },
            given: &mesh,
            sigma: &sigma,
            observed: &observed,
            points: frame.points.iter().map(|reading| reading.at).collect(),
        };
        let files: Vec<_> = done.inputs.iter().map(|path| (path.clone(), String::new())).collect();
        page.write(shell_page(&done, &shown, std::slice::from_ref(&job.mesh)), &files)?;
    }
    Ok(done)
}

/// Where the meshes of each frame go.
fn outputs_of(job: &ShellFitJob, frames: &[FrameFiles], inputs: &[PathBuf]) -> Result<Vec<Vec<PathBuf>>> {
    let of_frame = |frame: &FrameFiles, output: &Path| match job.sequence {
        None => output.to_owned(),
        Some(_) => {
            let stem = output.file_stem().unwrap_or_default().to_string_lossy();
            let ending = output.extension().unwrap_or_default().to_string_lossy();
            output.with_file_name(format!("{stem}.{}.{ending}", frame.name))
        }
    };
    let planned: Vec<Vec<PathBuf>> = (frames.iter())
        .map(|frame| job.outputs.iter().map(|output| of_frame(frame, output)).collect())
        .collect();
    check_outputs(&planned.concat(), inputs, is_mesh_file, ".ply, .obj, .stl, .off or .glb")?;
    Ok(planned)
}

/// The mesh, and what it looks like.
fn read_template(job: &ShellFitJob, units: &mut Units) -> Result<(TriangleMesh, TexturedMesh)> {
    let file = read_textured(&job.mesh)?;
    units.add(file.unit, &job.mesh)?;
    if file.triangles.is_empty() {
        return Err(Error::undetermined(format!(
            "{}: has no faces: a shell needs a mesh",
            job.mesh.display()
        )));
    }
    let mesh = TriangleMesh { positions: file.points.clone(), triangles: file.triangles.clone() };
    Ok((mesh, file))
}

/// How far what each view shows of a mesh agrees with its mask.
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
