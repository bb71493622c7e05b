//! Reads the inputs of a shell fit from files.

use super::super::pose::{DEFAULT_BLEND, part_vertices};
use super::{DeformationKind, NEIGHBOURS, ShellFitJob, landmarks};
use nalgebra::{DMatrix, DVector};
use planish_core::{DVec3, Finding, FindingCode, Setting, SymmetricMatrix3};
use planish_estimate::{Error, Result};
use planish_exchange::mesh::read_mesh;
use planish_exchange::textured::TexturedMesh;
use planish_exchange::views::{ViewFile, Views, read_views};
use planish_exchange::{Unit, paths_in, read_inputs};
use planish_mesh::TriangleMesh;
use planish_report::numbers::counted;
use planish_sense::{Silhouette, SilhouetteOptions, silhouette};
use planish_shell::{
    ControlGrowth, Controls, Deformation, Dirichlet, FeatureObservation, FeatureTrack, LandmarkReading,
    Lattice, LatticeBasis, Modes, OutlineKind, OutlinePoint, ParameterPrior, PartMotion, PointReading,
    RigidPart, RigidParts, Rigidity, ShellReadings, ShellView, VertexDisplacements, automatic_controls,
    nearest_pairs, stiffness, stiffness_for_xyz,
};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Initial σ of points without a stated σ, relative to the mesh's size. Its value does not matter, because σ
/// is then estimated from residuals.
const UNKNOWN_SIGMA: f64 = 1e-3;
/// σ of the distance of a tracked feature from the mesh, relative to the mesh's size. Smaller values tie
/// features to a mesh that is still wrong; larger ones lose the information of tracks about shape.
const SURFACE_SIGMA: f64 = 1e-3;
/// Maximum number of vertices that move independently. The equations are dense: three unknowns per vertex,
/// with cost in the cube of their number.
const MAX_VERTICES: usize = 600;

/// A deformation with its smoothness energy and prior.
pub(super) struct Moved {
    pub deformation: Box<dyn Deformation>,
    pub stiffness: Option<DMatrix<f64>>,
    pub rigidity: Option<Rigidity>,
    pub prior: Option<ParameterPrior>,
    pub controls: usize,
}

/// The files of one frame.
#[derive(Debug, Clone, Default)]
pub(super) struct FrameFiles {
    pub name: String,
    pub points: Vec<PathBuf>,
    pub silhouettes: Option<PathBuf>,
    pub landmarks: Option<PathBuf>,
}

/// The readings of one frame.
pub(super) struct Frame {
    pub points: Vec<PointReading>,
    /// Whether all points state σ.
    pub states_sigma: bool,
    pub views: Vec<ViewFile>,
    pub masks: Vec<Option<Silhouette>>,
    pub fitted: Vec<ShellView>,
    pub tracks: Vec<FeatureTrack>,
    pub landmarks: Vec<LandmarkReading>,
    pub landmark_names: Vec<String>,
    /// Files that were read in addition to the given ones.
    pub files: Vec<PathBuf>,
}

impl Frame {
    pub(super) fn readings(&self) -> ShellReadings<'_> {
        ShellReadings {
            points: &self.points,
            views: &self.fitted,
            tracks: &self.tracks,
            landmarks: &self.landmarks,
        }
    }

    /// Reads the files of a frame, for a mesh.
    pub(super) fn read(
        job: &ShellFitJob,
        files: &FrameFiles,
        mesh: &TriangleMesh,
        units: &mut Units,
        findings: &mut Vec<Finding>,
    ) -> Result<Self> {
        let size = mesh.surface_bounds().map_or(0.0, |bounds| bounds.diagonal());
        let (points, states_sigma) = read_points(job, &files.points, size, units, findings)?;
        let mut read = Vec::new();
        let views = match &files.silhouettes {
            Some(path) => {
                let views = read_views(path)?;
                units.add(views.unit, path)?;
                read.extend(views.files.iter().cloned());
                read.extend(views.views.iter().filter_map(|view| view.mask.clone()));
                views
            }
            None => Views { views: Vec::new(), tracks: Vec::new(), unit: None, files: Vec::new() },
        };
        let masks = read_masks(&views, job)?;
        let (landmarks, landmark_names) = match &files.landmarks {
            Some(path) => landmarks::read(path, mesh, size, findings)?,
            None => (Vec::new(), Vec::new()),
        };
        Ok(Self {
            landmarks,
            landmark_names,
            points,
            states_sigma,
            fitted: (views.views.iter().zip(&masks))
                .map(|(view, mask)| shell_view(view, mask.as_ref()))
                .collect(),
            tracks: (views.tracks.iter())
                .map(|track| FeatureTrack {
                    observations: (track.iter())
                        // Held-out views must not influence the fit in any way, or their overlap would not
                        // test it.
                        .filter(|(view, _, _)| !views.views[*view as usize].held_out)
                        .map(|(view, pixel, sigma_px)| FeatureObservation {
                            view: *view,
                            pixel: *pixel,
                            sigma_px: *sigma_px,
                        })
                        .collect(),
                    sigma_surface: SURFACE_SIGMA * size,
                })
                // One ray per feature leaves its depth open.
                .filter(|track| track.observations.len() > 1)
                .collect(),
            views: views.views,
            masks,
            files: read,
        })
    }
}

/// The frames of a folder: its folders by name, each with `views.toml`, files `points.*` or `landmarks.csv`.
pub(super) fn frames_of(folder: &Path) -> Result<Vec<FrameFiles>> {
    let mut frames = Vec::new();
    // Frames follow the order of names. Files beside the folders are allowed, for example the mesh.
    for path in paths_in(folder)?.into_iter().filter(|path| path.is_dir()) {
        let mut frame = FrameFiles {
            name: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            ..FrameFiles::default()
        };
        for file in paths_in(&path)? {
            let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if name == "landmarks.csv" {
                frame.landmarks = Some(file);
            } else if name == "views.toml" {
                frame.silhouettes = Some(file);
            } else if name.starts_with("points.") {
                frame.points.push(file);
            }
        }
        // An error, because a misnamed file would otherwise leave a frame without readings unnoticed.
        if frame.silhouettes.is_none() && frame.points.is_empty() && frame.landmarks.is_none() {
            return Err(Error::input(format!(
                "{}: expected views.toml, points.* or landmarks.csv in the folder of a frame",
                path.display()
            )));
        }
        frames.push(frame);
    }
    match frames.is_empty() {
        true => Err(Error::input(format!("{}: expected a folder for each frame", folder.display()))),
        false => Ok(frames),
    }
}

/// The unit that all files share.
pub(super) struct Units {
    found: Option<(Unit, PathBuf)>,
    fallback: Option<Unit>,
}

impl Units {
    pub(super) fn new(fallback: Option<Unit>) -> Self {
        Self { found: None, fallback }
    }

    pub(super) fn add(&mut self, unit: Option<Unit>, path: &Path) -> Result<()> {
        match (&self.found, unit) {
            // No conversion here: mesh, cameras and points are parts of one scene, and different units
            // usually mean a mistake.
            (Some((before, file)), Some(unit)) if *before != unit => Err(Error::input(format!(
                "{} is in {unit} and {} in {before}: expected one unit",
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

    pub(super) fn unit(&self) -> Unit {
        self.found.as_ref().map(|(unit, _)| *unit).or(self.fallback).unwrap_or(Unit::Millimetre)
    }
}

/// The deformation that a job asks for, with its rigid parts.
pub(super) fn moved(job: &ShellFitJob, mesh: &mut TriangleMesh, appearance: &TexturedMesh) -> Result<Moved> {
    let parts = rigid_parts(job, appearance)?;
    let inner = without_parts(job, mesh, &parts)?;
    with_parts(job, mesh, &parts, inner)
}

/// The rigid parts of a job.
pub(super) fn rigid_parts(job: &ShellFitJob, appearance: &TexturedMesh) -> Result<Vec<RigidPart>> {
    let part = |name: &String| {
        let vertices = part_vertices(appearance, name).map_err(|e| e.in_context(job.mesh.display()))?;
        Ok(RigidPart { vertices, motion: PartMotion::Free })
    };
    job.rigid.iter().map(part).collect()
}

/// A deformation of controls on a mesh, with its rigid parts.
pub(super) fn of_controls(
    job: &ShellFitJob,
    mesh: &TriangleMesh,
    parts: &[RigidPart],
    controls: &Controls,
) -> Result<Moved> {
    let dirichlet = Box::new(Dirichlet::new(&controls.points, &mesh.positions)?);
    let inner = free(dirichlet, &controls.points, &controls.triangles, &controls.edges)?;
    with_parts(job, mesh, parts, inner)
}

/// A deformation of free controls.
fn free(
    deformation: Box<dyn Deformation>,
    rest: &[DVec3],
    triangles: &[[u32; 3]],
    edges: &[[u32; 2]],
) -> Result<Moved> {
    let k = stiffness(rest, triangles, edges);
    Ok(Moved {
        deformation,
        rigidity: Some(Rigidity::new(rest, edges, &k)?),
        stiffness: Some(stiffness_for_xyz(&k)),
        prior: None,
        controls: rest.len(),
    })
}

/// A deformation whose parts stay rigid.
fn with_parts(job: &ShellFitJob, mesh: &TriangleMesh, parts: &[RigidPart], inner: Moved) -> Result<Moved> {
    if parts.is_empty() {
        return Ok(inner);
    }
    // Rigid parts reduce the smoothness energy to fewer unknowns. Modes have a prior instead of an energy.
    let Some(stiffness) = &inner.stiffness else {
        return Err(Error::unsupported("expected controls or a lattice for rigid parts, found modes"));
    };
    let size = mesh.surface_bounds().map_or(0.0, |bounds| bounds.diagonal());
    let blend = job.blend.unwrap_or(DEFAULT_BLEND * size);
    let made = RigidParts::new(mesh, inner.deformation, parts, blend)
        .map_err(|e| e.in_context(job.mesh.display()))?;
    Ok(Moved { stiffness: Some(made.stiffness(stiffness)), deformation: Box::new(made), ..inner })
}

/// The triangles of a mesh outside rigid parts, on the same vertices. All triangles if none remain.
pub(super) fn deformable_part(mesh: &TriangleMesh, parts: &[RigidPart]) -> TriangleMesh {
    let mut rigid = vec![false; mesh.positions.len()];
    for v in parts.iter().flat_map(|part| &part.vertices) {
        if let Some(rigid) = rigid.get_mut(*v as usize) {
            *rigid = true;
        }
    }
    let mut rest = mesh.clone();
    rest.triangles.retain(|t| t.iter().any(|v| !rigid[*v as usize]));
    if rest.triangles.is_empty() {
        rest.triangles.clone_from(&mesh.triangles);
    }
    rest
}

/// The deformation of the non-rigid part, so that no control is placed on rigid parts.
fn without_parts(job: &ShellFitJob, mesh: &mut TriangleMesh, parts: &[RigidPart]) -> Result<Moved> {
    let given = match &job.controls_file {
        Some(path) => {
            let read = read_inputs(&[path], job.unit)?;
            let not_finite: usize = read.scans.iter().map(|s| s.scan.dropped_not_finite).sum();
            if not_finite > 0 {
                return Err(Error::input(format!(
                    "{}: {} with coordinates that are not finite numbers",
                    path.display(),
                    counted(not_finite, "control")
                )));
            }
            Some(read.scans.iter().flat_map(|s| s.scan.points.clone()).collect::<Vec<_>>())
        }
        None => None,
    };
    if given.is_some() && job.deformation != DeformationKind::Dirichlet {
        return Err(Error::input(
            "expected the deformation dirichlet (natural neighbours) for a file of controls, found another \
             one",
        ));
    }
    let count = job.controls.unwrap_or(ControlGrowth::default().initial);
    Ok(match (job.deformation, given) {
        (DeformationKind::Dirichlet, Some(points)) => {
            let dirichlet = Box::new(Dirichlet::new(&points, &mesh.positions)?);
            free(dirichlet, &points, &[], &nearest_pairs(&points, NEIGHBOURS))?
        }
        (DeformationKind::Dirichlet, None) => {
            let made = automatic_controls(&deformable_part(mesh, parts), count)?;
            let dirichlet = Box::new(Dirichlet::new(&made.points, &mesh.positions)?);
            free(dirichlet, &made.points, &made.triangles, &made.edges)?
        }
        (DeformationKind::Lattice, _) => {
            // The number of controls is that of the whole lattice, so its cube root is that of one edge.
            let along = ((count as f64).cbrt().round() as usize).max(2);
            // Bernstein polynomials act on the whole mesh. With many points, B-splines keep the effect of
            // each local.
            let basis = if along >= 5 { LatticeBasis::CubicBSpline } else { LatticeBasis::Bernstein };
            // The lattice encloses the triangles only. Unused vertices may be far away.
            let made = Lattice::new(&within_surface(mesh), [along; 3], basis)?;
            let points = made.controls().unwrap_or_default().to_vec();
            free(Box::new(made), &points, &[], &nearest_pairs(&points, NEIGHBOURS))?
        }
        (DeformationKind::Vertices, _) => {
            let count = mesh.positions.len();
            if count > MAX_VERTICES {
                return Err(Error::unsupported(format!(
                    "{}: expected at most {MAX_VERTICES} vertices that each move independently, found \
                     {count}: use controls, or a coarser mesh",
                    job.mesh.display()
                )));
            }
            let vertices = Box::new(VertexDisplacements::new(&mesh.positions));
            free(vertices, &mesh.positions, &mesh.triangles, &[])?
        }
        (DeformationKind::Modes, _) => {
            let mut family = Vec::new();
            for path in &job.family {
                family.push(read_mesh(path)?.points);
            }
            let modes = Modes::from_meshes(&family, count)?;
            // Modes move vertices by their number. With other vertices, the result would be meaningless.
            if modes.mean().len() != mesh.positions.len() {
                return Err(Error::input(format!(
                    "{}: expected as many vertices as the family has, found {} instead of {}",
                    job.mesh.display(),
                    mesh.positions.len(),
                    modes.mean().len()
                )));
            }
            // The fit starts at the mean of the family, where the prior has its maximum.
            mesh.positions = modes.mean().to_vec();
            let count = modes.parameters();
            // Modes are as long as one standard deviation of the family.
            let prior =
                ParameterPrior { mean: DVector::zeros(count), information: DMatrix::identity(count, count) };
            Moved {
                deformation: Box::new(modes),
                stiffness: None,
                rigidity: None,
                prior: Some(prior),
                controls: count,
            }
        }
    })
}

/// The vertices. Those of no triangle are moved to a vertex of the first triangle.
fn within_surface(mesh: &TriangleMesh) -> Vec<DVec3> {
    let mut places = vec![mesh.positions[mesh.triangles[0][0] as usize]; mesh.positions.len()];
    for v in mesh.triangles.iter().flatten() {
        places[*v as usize] = mesh.positions[*v as usize];
    }
    places
}

fn read_points(
    job: &ShellFitJob,
    files: &[PathBuf],
    size: f64,
    units: &mut Units,
    findings: &mut Vec<Finding>,
) -> Result<(Vec<PointReading>, bool)> {
    if files.is_empty() {
        return Ok((Vec::new(), false));
    }
    let set = read_inputs(files, job.unit)?;
    // The reader has already applied the job's unit to files without one; only a unit of the files can
    // conflict.
    units.add(set.unit.filter(|_| job.unit.is_none()), &files[0])?;
    let mut points = Vec::new();
    let mut unknown = 0_usize;
    let not_finite: usize = set.scans.iter().map(|posed| posed.scan.dropped_not_finite).sum();
    if not_finite > 0 {
        findings.push(Finding::new(
            FindingCode::PointsNotFinite,
            format!("{} with coordinates that are not finite: ignored", counted(not_finite, "point")),
        ));
    }
    for posed in &set.scans {
        let (scan, pose) = (&posed.scan, &posed.scan.world_from_scanner);
        for (i, point) in scan.points.iter().enumerate() {
            let stated = match (&scan.covariance, &scan.sigma) {
                (Some(all), _) => all[i],
                (None, Some(all)) => SymmetricMatrix3::isotropic(all[i] * all[i]),
                (None, None) => {
                    unknown += 1;
                    SymmetricMatrix3::isotropic((UNKNOWN_SIGMA * size).powi(2))
                }
            };
            points.push(PointReading { at: pose.apply(*point), covariance: stated.rotated(&pose.rotation) });
        }
    }
    // The assumed σ is a start for its estimation. Used as a fact, it would be an invented accuracy.
    if unknown > 0 && job.believe_sigma {
        return Err(Error::input(format!(
            "expected σ of every point to use it as stated, found {unknown} points without σ"
        ))
        .with_setting(Setting::BelieveSigma));
    }
    if unknown > 0 && unknown < points.len() {
        findings.push(Finding::new(
            FindingCode::SigmaAssumed,
            format!(
                "{unknown} of {} points state no σ: {:.3e} was assumed",
                points.len(),
                UNKNOWN_SIGMA * size
            ),
        ));
    }
    Ok((points, unknown == 0))
}

fn read_masks(views: &Views, job: &ShellFitJob) -> Result<Vec<Option<Silhouette>>> {
    (views.views.par_iter()).map(|view| read_mask(view, job.outline_step_px)).collect()
}

/// The mask of a view, if it has one. Places on its border are at least `apart_px` apart.
pub(in crate::shell) fn read_mask(view: &ViewFile, apart_px: f64) -> Result<Option<Silhouette>> {
    let Some(path) = &view.mask else { return Ok(None) };
    let options = SilhouetteOptions {
        threshold: view.mask_threshold,
        min_share: view.mask_min_share.unwrap_or(SilhouetteOptions::default().min_share),
        sigma_px: view.sigma_px,
        apart_px,
        ..SilhouetteOptions::default()
    };
    let Some(picture) = view.read_mask()? else { return Ok(None) };
    silhouette(&picture, &options).map(Some).map_err(|e| e.in_context(path.display()))
}

fn shell_view(view: &ViewFile, mask: Option<&Silhouette>) -> ShellView {
    let mut made = ShellView {
        camera: view.camera,
        // The camera of a held-out view stays as given: nothing of it may be estimated.
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
    made.outline.extend((view.contours.iter()).map(|(pixel, sigma_px)| OutlinePoint {
        pixel: *pixel,
        sigma_px: *sigma_px,
        kind: OutlineKind::Contour,
    }));
    made
}
