//! `planish shell fit`: a mesh moved by a few controls until it goes through points and shows the outlines of views.
//!
//! Comes in: a mesh of any kind, point files, `views.toml` with masks. Goes out: the mesh where it was found, with σ along its normals; poses of cameras that were uncertain; how far the masks are covered, in views held out as well.
//!
//! Not guaranteed: the right place for a mesh that starts more than a tenth of its size away from points, or that does not overlap its masks.

use super::overlap::intersection_over_union;
use crate::model::SigmaSummary;
use crate::output::refuse_input_as_output;
use crate::progress::{Progress, WRITING_STAGE};
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Error, Result, Termination};
use planish_exchange::mesh::{Column, MeshColumns, is_mesh_file, read_mesh, write_mesh};
use planish_exchange::picture::read_brightness;
use planish_exchange::views::{Views, read_views};
use planish_exchange::{Unit, check_writable, read_inputs};
use planish_mesh::{BoundingBox, TriangleMesh};
use planish_sense::{Silhouette, SilhouetteOptions, silhouette};
pub use planish_shell::Metaball;
use planish_shell::{
    Deformation, Dirichlet, FeatureTrack, Lattice, LatticeBasis, Modes, OutlineKind, OutlinePoint, ParameterPrior,
    PointReading, ShellFit, ShellFitOptions, ShellReadings, ShellView, Sighting, SourceFit, VertexDisplacements,
    automatic_controls, fit_shell, nearest_pairs, of_three_coordinates, stiffness,
};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// σ of points that state none, as a share of the mesh's size: only their ratios count, the residuals say the rest.
const UNKNOWN_SIGMA: f64 = 1e-3;
/// σ by which a tracked feature may lie off the mesh, as a share of its size.
const SURFACE_SIGMA: f64 = 1e-3;
/// Neighbours that controls without a triangulation are joined to.
const NEIGHBOURS: usize = 6;
/// A vertex is measured where at least so much of what is known of it comes from the readings.
const MEASURED: f64 = 0.5;
/// Vertices that may each move on their own: equations are dense.
const MOST_VERTICES: usize = 600;

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
    /// What moves the mesh.
    pub deformation: DeformationKind,
    /// How many controls, where none are given: of a lattice all its points, of modes the most.
    pub controls: usize,
    /// Control points.
    pub controls_file: Option<PathBuf>,
    /// The family whose modes move the mesh: the same vertices in every file.
    pub family: Vec<PathBuf>,
    /// What metaballs are built around.
    pub metaball: Metaball,
    /// Places on the border of a mask are at least so far apart, in pixels.
    pub outline_step_px: f64,
    /// Whether σ of points and outlines are what is stated.
    pub believe_sigma: bool,
    /// Meshes to write.
    pub outputs: Vec<PathBuf>,
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
    /// Iterations.
    pub iterations: usize,
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

/// A deformation with what is smooth in it, and what is known before.
struct Moved {
    deformation: Box<dyn Deformation>,
    stiffness: Option<DMatrix<f64>>,
    prior: Option<ParameterPrior>,
    controls: usize,
}

/// Fits, and writes what was asked for.
///
/// # Errors
/// `Io` where a file cannot be read or written; `Input` for meshes without faces, views that make no sense, units that differ, and everything that [`fit_shell`] refuses; `Undetermined` where the readings do not say where the mesh is.
pub fn shell_fit_files(job: &ShellFitJob, progress: &dyn Progress) -> Result<ShellFitReport> {
    let mut inputs = vec![job.mesh.clone()];
    inputs.extend(
        job.points
            .iter()
            .chain(&job.silhouettes)
            .chain(&job.controls_file)
            .chain(&job.family)
            .cloned(),
    );
    for output in &job.outputs {
        refuse_input_as_output(output, &inputs)?;
        if !is_mesh_file(output) {
            return Err(Error::unsupported(format!(
                "{}: a fitted shell is written as .ply, .glb, .obj or .stl",
                output.display()
            )));
        }
        check_writable(output)?;
    }
    progress.check("reading", 0.0)?;
    let mut units = Units::of(job.unit);
    let file = read_mesh(&job.mesh)?;
    units.add(file.unit, &job.mesh)?;
    let mut mesh = TriangleMesh {
        positions: file.points,
        triangles: file.triangles,
    };
    if mesh.triangles.is_empty() {
        return Err(Error::undetermined(format!(
            "{}: has no faces: a shell needs a mesh",
            job.mesh.display()
        )));
    }
    let moved = moved(job, &mut mesh)?;
    let size = BoundingBox::of(&mesh.positions).map_or(0.0, |bounds| bounds.diagonal());
    let mut warnings = Vec::new();
    let points = read_points(job, size, &mut units, &mut warnings)?;
    let mut views = None;
    if let Some(path) = &job.silhouettes {
        let read = read_views(path)?;
        units.add(read.unit, path)?;
        inputs.extend(read.files.iter().cloned());
        inputs.extend(read.views.iter().filter_map(|view| view.mask.clone()));
        views = Some(read);
    }
    let views = views.unwrap_or(Views {
        views: Vec::new(),
        tracks: Vec::new(),
        unit: None,
        files: Vec::new(),
    });
    let masks = read_masks(&views, job)?;
    let fitted: Vec<ShellView> = (views.views.iter().zip(&masks))
        .map(|(view, mask)| shell_view(view, mask.as_ref()))
        .collect();
    let tracks: Vec<FeatureTrack> = (views.tracks.iter())
        .map(|track| FeatureTrack {
            sightings: (track.iter())
                .map(|(view, pixel, sigma_px)| Sighting {
                    view: *view,
                    pixel: *pixel,
                    sigma_px: *sigma_px,
                })
                .collect(),
            sigma_surface: SURFACE_SIGMA * size,
        })
        .collect();
    let overlap = |mesh: &TriangleMesh, cameras: &dyn Fn(usize) -> planish_shell::Camera| -> BTreeMap<String, f64> {
        (views.views.iter().zip(&masks).enumerate())
            .filter_map(|(v, (view, mask))| {
                mask.as_ref()
                    .map(|mask| (view.name.clone(), intersection_over_union(mesh, &cameras(v), mask)))
            })
            .collect()
    };
    let iou_before = overlap(&mesh, &|v| fitted[v].camera);
    progress.check("fitting", 0.1)?;
    let options = ShellFitOptions {
        metaball: job.metaball,
        believe_sigma: job.believe_sigma,
        stiffness: moved.stiffness.clone(),
        prior: moved.prior.clone(),
        iterations: 20,
        ..ShellFitOptions::default()
    };
    let readings = ShellReadings {
        points: &points,
        views: &fitted,
        tracks: &tracks,
    };
    let made = fit_shell(&mesh, &*moved.deformation, &readings, &options)?;
    let found = TriangleMesh {
        positions: made.positions.clone(),
        triangles: mesh.triangles.clone(),
    };
    let (normals, sigma, observed) = known(&found, &made, &*moved.deformation);
    progress.check(WRITING_STAGE, 0.95)?;
    for output in &job.outputs {
        write_mesh(
            output,
            &MeshColumns {
                points: &found.positions,
                normals: Some(&normals),
                columns: vec![("sigma", Column::F64(&sigma)), ("observed", Column::U8(&observed))],
                triangles: &found.triangles,
                unit: Some(units.unit()),
            },
        )?;
    }
    let measured: Vec<f64> = (sigma.iter().zip(&observed))
        .filter(|(_, o)| **o == 1)
        .map(|(s, _)| *s)
        .collect();
    let of = [&made.points, &made.outlines, &made.tracks].map(ReadingsReport::of);
    let [of_points, of_outlines, of_tracks] = of;
    for (what, report) in [("points", &of_points), ("outlines", &of_outlines)] {
        if let Some(report) = report.filter(|r| 3 * r.outliers > r.count) {
            warnings.push(format!(
                "{} of {} {what} are gross errors: the mesh may have too few controls for the thing, or have started too far away",
                report.outliers, report.count
            ));
        }
    }
    Ok(ShellFitReport {
        rms_points: of_points.map(|r| r.rms),
        rms_silhouettes_px: of_outlines.map(|r| r.rms),
        iou: overlap(&found, &|v| made.cameras[v]),
        iou_before,
        held_out: (views.views.iter())
            .filter(|view| view.held_out)
            .map(|view| view.name.clone())
            .collect(),
        controls: moved.controls,
        outliers: of.iter().flatten().map(|r| r.outliers).sum(),
        points: of_points,
        outlines: of_outlines,
        tracks: of_tracks,
        poses: poses(&views, &fitted, &made),
        observed_fraction: measured.len() as f64 / sigma.len().max(1) as f64,
        sigma: sigma_summary(measured),
        smoothness_weight: made.smoothness_weight,
        iterations: made.iterations,
        termination: match made.termination {
            Termination::Converged => "converged",
            Termination::ReachedTolerance => "reached_tolerance",
            _ => "limit",
        },
        unit: units.unit(),
        inputs,
        written: job.outputs.clone(),
        warnings,
    })
}

/// The unit that all files share.
struct Units {
    found: Option<(Unit, PathBuf)>,
    fallback: Option<Unit>,
}

impl Units {
    fn of(fallback: Option<Unit>) -> Self {
        Self { found: None, fallback }
    }

    fn add(&mut self, unit: Option<Unit>, path: &std::path::Path) -> Result<()> {
        match (&self.found, unit) {
            (Some((before, file)), Some(unit)) if *before != unit => Err(Error::input(format!(
                "{} is in {unit} and {} in {before}: needed one unit",
                path.display(),
                file.display()
            ))),
            (None, Some(unit)) => {
                self.found = Some((unit, path.to_owned()));
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn unit(&self) -> Unit {
        self.found
            .as_ref()
            .map(|(unit, _)| *unit)
            .or(self.fallback)
            .unwrap_or(Unit::Millimetre)
    }
}

fn moved(job: &ShellFitJob, mesh: &mut TriangleMesh) -> Result<Moved> {
    let given = match &job.controls_file {
        Some(path) => Some(
            read_inputs(&[path], job.unit)?
                .scans
                .iter()
                .flat_map(|s| s.scan.points.clone())
                .collect::<Vec<_>>(),
        ),
        None => None,
    };
    if given.is_some() && job.deformation != DeformationKind::Dirichlet {
        return Err(Error::input(
            "a file of controls is for the deformation by natural neighbours (dirichlet) only",
        ));
    }
    let free = |deformation: Box<dyn Deformation>, k: DMatrix<f64>, controls: usize| Moved {
        deformation,
        stiffness: Some(of_three_coordinates(&k)),
        prior: None,
        controls,
    };
    Ok(match (job.deformation, given) {
        (DeformationKind::Dirichlet, Some(points)) => {
            let k = stiffness(&points, &[], &nearest_pairs(&points, NEIGHBOURS));
            free(Box::new(Dirichlet::new(&points, &mesh.positions)?), k, points.len())
        }
        (DeformationKind::Dirichlet, None) => {
            let made = automatic_controls(mesh, job.controls)?;
            let k = stiffness(&made.points, &made.triangles, &made.edges);
            free(
                Box::new(Dirichlet::new(&made.points, &mesh.positions)?),
                k,
                made.points.len(),
            )
        }
        (DeformationKind::Lattice, _) => {
            let along = ((job.controls as f64).cbrt().round() as usize).max(2);
            let basis = if along >= 5 {
                LatticeBasis::CubicBSpline
            } else {
                LatticeBasis::Bernstein
            };
            let made = Lattice::new(&mesh.positions, [along; 3], basis)?;
            let points = made.controls().unwrap_or_default().to_vec();
            let k = stiffness(&points, &[], &nearest_pairs(&points, NEIGHBOURS));
            free(Box::new(made), k, points.len())
        }
        (DeformationKind::Vertices, _) => {
            let count = mesh.positions.len();
            if count > MOST_VERTICES {
                return Err(Error::unsupported(format!(
                    "{}: has {count} vertices, and at most {MOST_VERTICES} may each move on their own: use controls, or a coarser mesh",
                    job.mesh.display()
                )));
            }
            let k = stiffness(&mesh.positions, &mesh.triangles, &[]);
            free(Box::new(VertexDisplacements::new(&mesh.positions)), k, count)
        }
        (DeformationKind::Modes, _) => {
            let mut family = Vec::new();
            for path in &job.family {
                family.push(read_mesh(path)?.points);
            }
            let modes = Modes::of(&family, job.controls)?;
            if modes.mean().len() != mesh.positions.len() {
                return Err(Error::input(format!(
                    "{} has {} vertices, and the family {}: needed the same vertices in all",
                    job.mesh.display(),
                    mesh.positions.len(),
                    modes.mean().len()
                )));
            }
            mesh.positions = modes.mean().to_vec();
            let count = modes.parameters();
            // Modes are as long as one standard deviation of the family.
            let prior = ParameterPrior {
                mean: DVector::zeros(count),
                information: DMatrix::identity(count, count),
            };
            Moved {
                deformation: Box::new(modes),
                stiffness: None,
                prior: Some(prior),
                controls: count,
            }
        }
    })
}

fn read_points(
    job: &ShellFitJob,
    size: f64,
    units: &mut Units,
    warnings: &mut Vec<String>,
) -> Result<Vec<PointReading>> {
    if job.points.is_empty() {
        return Ok(Vec::new());
    }
    let set = read_inputs(&job.points, job.unit)?;
    units.add(set.unit.filter(|_| job.unit.is_none()), &job.points[0])?;
    let mut points = Vec::new();
    let mut unknown = 0_usize;
    for posed in &set.scans {
        let (scan, pose) = (&posed.scan, &posed.scan.world_from_scanner);
        for (i, point) in scan.points.iter().enumerate() {
            let stated = match (&scan.covariance, &scan.sigma) {
                (Some(all), _) => all[i],
                (None, Some(all)) => {
                    let v = all[i] * all[i];
                    [v, 0.0, 0.0, v, 0.0, v]
                }
                (None, None) => {
                    unknown += 1;
                    let v = (UNKNOWN_SIGMA * size).powi(2);
                    [v, 0.0, 0.0, v, 0.0, v]
                }
            };
            points.push(PointReading {
                at: pose.apply(*point),
                covariance: turned(pose, stated),
            });
        }
    }
    if unknown > 0 && job.believe_sigma {
        return Err(Error::input(format!(
            "{unknown} points state no σ, and --believe-sigma needs one of all"
        )));
    }
    if unknown > 0 && unknown < points.len() {
        warnings.push(format!(
            "{unknown} of {} points state no σ: {:.3e} was taken",
            points.len(),
            UNKNOWN_SIGMA * size
        ));
    }
    Ok(points)
}

/// `R Σ Rᵀ`.
fn turned(pose: &planish_sense::Pose, [xx, xy, xz, yy, yz, zz]: [f64; 6]) -> [f64; 6] {
    let rows = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
    // Columns of R Σ, then rows of that by R.
    let half = [0, 1, 2].map(|k| pose.rotate(rows[k]));
    let full = [0, 1, 2].map(|i| pose.rotate([half[0][i], half[1][i], half[2][i]]));
    planish_estimate::vector3::upper_triangle(|i, j| full[i][j])
}

fn read_masks(views: &Views, job: &ShellFitJob) -> Result<Vec<Option<Silhouette>>> {
    (views.views.par_iter())
        .map(|view| {
            let Some(path) = &view.mask else { return Ok(None) };
            let options = SilhouetteOptions {
                threshold: view.mask_threshold,
                sigma_px: view.sigma_px,
                apart_px: job.outline_step_px,
                ..SilhouetteOptions::default()
            };
            let picture = read_brightness(path)?;
            silhouette(&picture, &options)
                .map(Some)
                .map_err(|e| e.in_context(path.display()))
        })
        .collect()
}

fn shell_view(view: &planish_exchange::views::ViewFile, mask: Option<&Silhouette>) -> ShellView {
    let mut made = ShellView {
        camera: view.camera,
        pose: view.pose.filter(|_| !view.held_out),
        outline: Vec::new(),
        inside: Vec::new(),
        outside: Vec::new(),
    };
    if view.held_out {
        return made;
    }
    if let Some(mask) = mask {
        made.outline.extend((mask.border.iter()).map(|pixel| OutlinePoint {
            pixel: *pixel,
            sigma_px: mask.sigma_px,
            kind: OutlineKind::Border,
        }));
        made.inside.clone_from(&mask.inside);
        made.outside.clone_from(&mask.outside);
    }
    made.outline
        .extend((view.contours.iter()).map(|(pixel, sigma_px)| OutlinePoint {
            pixel: *pixel,
            sigma_px: *sigma_px,
            kind: OutlineKind::Contour,
        }));
    made
}

/// Normals of vertices, σ along them, and whether the readings say more of them than what was known before.
fn known(mesh: &TriangleMesh, made: &ShellFit, deformation: &dyn Deformation) -> (Vec<[f64; 3]>, Vec<f64>, Vec<u8>) {
    let normals = mesh.vertex_normals();
    let by_data = &made.covariance * &made.data_information * &made.covariance;
    let (sigma, observed) = (0..mesh.positions.len())
        .into_par_iter()
        .map(|v| {
            let mut row = DVector::zeros(deformation.basis());
            deformation.row(v as u32, normals[v], &mut |k, entry| row[k] += entry);
            let row = match deformation.reduction() {
                Some(reduction) => reduction.tr_mul(&row),
                None => row,
            };
            let variance = row.dot(&(&made.covariance * &row)).max(0.0);
            let share = row.dot(&(&by_data * &row)) / variance;
            (variance.sqrt(), u8::from(share > MEASURED))
        })
        .unzip();
    (normals, sigma, observed)
}

fn sigma_summary(mut sigmas: Vec<f64>) -> SigmaSummary {
    sigmas.sort_by(f64::total_cmp);
    let at = |share: f64| {
        if sigmas.is_empty() {
            0.0
        } else {
            planish_mesh::quantile_of_sorted(&sigmas, share)
        }
    };
    SigmaSummary {
        median: at(0.5),
        p95: at(0.95),
        max: at(1.0),
    }
}

fn poses(views: &Views, given: &[ShellView], made: &ShellFit) -> Vec<PoseReport> {
    let mut reports = Vec::new();
    for (v, covariance) in made.pose_covariances.iter().enumerate() {
        let Some(covariance) = covariance else { continue };
        let camera = &made.cameras[v];
        let change = camera.change_from(&given[v].camera);
        let length = |c: &[f64]| c.iter().map(|x| x * x).sum::<f64>().sqrt();
        reports.push(PoseReport {
            view: views.views[v].name.clone(),
            turned_deg: length(&change[..3]).to_degrees(),
            moved: length(&change[3..]),
            r: std::array::from_fn(|i| std::array::from_fn(|j| camera.r[(i, j)])),
            t: camera.t.into(),
            sigma_rotation_deg: std::array::from_fn(|k| covariance[(k, k)].sqrt().to_degrees()),
            sigma_translation: std::array::from_fn(|k| covariance[(3 + k, 3 + k)].sqrt()),
        });
    }
    reports
}
