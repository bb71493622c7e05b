//! `planish shell pose`: a mesh posed by moving a few of its controls.
//!
//! Input: a mesh, and a TOML file of poses and keyframes:
//!
//! ```toml
//! controls = 60                       # chosen on the mesh; or a list of places [[x, y, z], ...]
//! blend = 2.0                         # length over which rigid parts blend (default: size / 10)
//!
//! [[rigid]]
//! part = "head"                       # a group, object or material of the OBJ
//! motion = "follow"                   # follows the controls around it, or "held"
//!
//! [[pose]]
//! name = "shoulders up"
//! move = [
//!   { near = [10, 0, 2], by = [0, 3, 0] },                  # the nearest control
//!   { control = 7, by = [0, 3, 0] },                        # the control with this index
//!   { near = [0, -20, 0], within = 6, by = [0, 3, 0] },     # all controls within this distance
//! ]
//!
//! [[keyframe]]
//! seconds = 0
//! weights = { "shoulders up" = 0 }
//! [[keyframe]]
//! seconds = 1.5
//! weights = { "shoulders up" = 1 }
//! ```
//!
//! Output: GLB with a morph target for each pose, and an animation if there are keyframes. Texture
//! coordinates and the texture of an OBJ or GLB file are kept. Other formats contain the mesh in the first
//! pose.
//!
//! Not guaranteed: a posed mesh may intersect itself.

use super::appearance::{Known, NamedPlaces, PoseAnimation, normals_of, picture_of, write_glb, write_obj};
use super::surface::mesh_outputs;
use crate::job::Job;
use nalgebra::DVector;
use planish_core::Finding;
use planish_core::finding::with_warnings;
use planish_core::vector3::{coordinates, from_arrays};
use planish_core::{DVec3, Progress, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_exchange::extension;
use planish_exchange::glb::Keyframe;
use planish_exchange::mesh::{MeshColumns, is_mesh_file, write_mesh};
use planish_exchange::poses::{ControlsEntry, MoveEntry, PoseFile, PoseTarget, read_poses};
use planish_exchange::textured::{TexturedMesh, read_textured, read_vertex_list};
use planish_mesh::TriangleMesh;
use planish_report::numbers::significant;
use planish_shell::{Dirichlet, PartMotion, RigidPart, RigidParts, automatic_controls, displaced_positions};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Default number of controls. More make local poses possible; fewer move larger regions together.
const DEFAULT_CONTROLS: usize = 60;
/// Default length over which rigid parts blend into the rest, relative to the mesh's size. Shorter blends
/// crease the surface; longer ones move what should stay.
pub(super) const DEFAULT_BLEND: f64 = 0.1;

/// Settings of the job.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShellPoseJob {
    /// The mesh.
    pub mesh: PathBuf,
    /// Poses and keyframes.
    pub poses: PathBuf,
    /// Additional rigid parts: a group, object or material of the OBJ file, or a file of vertex indices.
    pub rigid: Vec<String>,
    /// Files to write.
    pub outputs: Vec<PathBuf>,
    /// Unit of the mesh if the file states none.
    pub unit: Option<Unit>,
}

/// Result of the job.
#[derive(Debug, Clone, Serialize)]
pub struct ShellPoseReport {
    /// Unit of lengths.
    #[serde(skip)]
    pub unit: Option<Unit>,
    /// Vertices of the mesh.
    pub vertices: usize,
    /// Number of controls.
    pub controls: usize,
    /// Positions of the controls.
    pub control_points: Vec<DVec3>,
    /// Rigid parts and their vertices.
    pub rigid: Vec<RigidReport>,
    /// Poses.
    pub poses: Vec<PoseTargetReport>,
    /// Keyframes.
    pub keyframes: usize,
    /// Files read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
    /// Files written.
    #[serde(skip)]
    pub written: Vec<PathBuf>,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
    /// `converged`.
    pub termination: &'static str,
}

/// A rigid part.
#[derive(Debug, Clone, Serialize)]
pub struct RigidReport {
    /// Its name.
    pub part: String,
    /// Number of its vertices.
    pub vertices: usize,
    /// Whether it keeps its position.
    pub held: bool,
}

/// A pose.
#[derive(Debug, Clone, Serialize)]
pub struct PoseTargetReport {
    /// Its name.
    pub name: String,
    /// Number of controls that are moved.
    pub moved: usize,
    /// Largest displacement of a vertex.
    pub farthest: f64,
}

/// The vertices of a rigid part: by its name in the file, or a file of indices from 0.
///
/// # Errors
/// `Input` if neither exists, or if a word of the file is no index.
pub fn part_vertices(mesh: &TexturedMesh, part: &str) -> Result<Vec<u32>> {
    // Names of the mesh have priority over files, so that a file in the folder cannot change the meaning of a
    // job.
    if let Some(vertices) = mesh.vertices_of(part) {
        return Ok(vertices);
    }
    let path = Path::new(part);
    if !path.is_file() {
        let mut names: Vec<&str> = mesh.parts.iter().map(|part| part.name.as_str()).collect();
        names.dedup();
        return Err(Error::input(format!(
            "expected {}, found `{part}`, which is no group, object or material of the mesh and no file",
            match names.is_empty() {
                true => "a file of vertex indices, as the mesh has no parts".to_owned(),
                false => format!("one of {}, or a file of vertex indices", names.join(", ")),
            }
        )));
    }
    read_vertex_list(path)
}

impl Job for ShellPoseJob {
    type Report = ShellPoseReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.mesh.clone(), self.poses.clone()])
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        let needed = ".glb (all poses), or .ply, .obj, .stl or .off (the first pose)";
        mesh_outputs(&self.outputs, is_mesh_file, needed)
    }

    fn execute(&self, progress: &dyn Progress) -> Result<ShellPoseReport> {
        pose_mesh(self, progress)
    }
}

/// Poses a mesh.
fn pose_mesh(job: &ShellPoseJob, progress: &dyn Progress) -> Result<ShellPoseReport> {
    progress.check("reading", 0.0)?;
    let mut file = read_textured(&job.mesh)?;
    let poses = read_poses(&job.poses)?;
    file.unit = file.unit.or(job.unit);
    let mesh = TriangleMesh::try_new(file.points.clone(), file.triangles.clone())
        .map_err(|e| e.in_context(job.mesh.display()))?;
    let size = mesh.surface_bounds().map_or(0.0, |b| b.diagonal());
    let controls = match &poses.controls {
        ControlsEntry::Count(count) => automatic_controls(&mesh, *count)?.points,
        ControlsEntry::Default => automatic_controls(&mesh, DEFAULT_CONTROLS)?.points,
        ControlsEntry::Points(points) => from_arrays(points).to_vec(),
    };
    // Parts are resolved before the deformation is built: a misspelt name must not cost that time.
    let (parts, rigid) = rigid_parts(job, &file, &poses)?;
    progress.check("weighing", 0.2)?;
    let inner = Box::new(Dirichlet::new(&controls, &mesh.positions)?);
    let blend = poses.blend.unwrap_or(DEFAULT_BLEND * size);
    let deformation =
        RigidParts::new(&mesh, inner, &parts, blend).map_err(|e| e.in_context(job.mesh.display()))?;
    let (mut targets, mut reports) = (Vec::new(), Vec::new());
    for pose in &poses.poses {
        progress.check("posing", 0.3)?;
        // Each pose starts from the given mesh, not from the pose before it. Morph targets add up in viewers.
        let (q, moved) = moves(&pose.moves, &controls, size)
            .map_err(|e| e.in_context(format!("{}: pose `{}`", job.poses.display(), pose.name)))?;
        let points = displaced_positions(&mesh.positions, &deformation, &deformation.rigid_start(&q));
        reports.push(PoseTargetReport {
            name: pose.name.clone(),
            moved,
            farthest: (points.iter().zip(&mesh.positions)).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max),
        });
        targets.push(points);
    }
    progress.check(WRITING_STAGE, 0.8)?;
    let mut findings = std::mem::take(&mut file.findings);
    // A missing texture matters only if a file is written.
    let picture = match job.outputs.is_empty() {
        true => None,
        false => picture_of(&file, &mut findings),
    };
    let mut written = Vec::new();
    for path in &job.outputs {
        written.extend(write(path, &file, &mesh, &poses, &targets, picture.as_deref())?);
    }
    let mut read = vec![job.mesh.clone(), job.poses.clone()];
    read.append(&mut file.files);
    Ok(ShellPoseReport {
        unit: file.unit,
        vertices: mesh.positions.len(),
        controls: controls.len(),
        control_points: controls,
        rigid,
        poses: reports,
        keyframes: poses.keyframes.len(),
        inputs: read,
        written,
        findings,
        termination: "converged",
    })
}

fn rigid_parts(
    job: &ShellPoseJob,
    file: &TexturedMesh,
    poses: &PoseFile,
) -> Result<(Vec<RigidPart>, Vec<RigidReport>)> {
    // Parts that only the job names follow the surface; a fixed part has to be stated in the file.
    let named = job.rigid.iter().map(|part| (part.clone(), false));
    let all = named.chain(poses.rigid.iter().map(|entry| (entry.part.clone(), entry.held)));
    let (mut parts, mut reports) = (Vec::new(), Vec::new());
    for (part, held) in all {
        let vertices = part_vertices(file, &part).map_err(|e| e.in_context(job.mesh.display()))?;
        reports.push(RigidReport { part, vertices: vertices.len(), held });
        parts.push(RigidPart { vertices, motion: if held { PartMotion::Fixed } else { PartMotion::Free } });
    }
    Ok((parts, reports))
}

/// Displacements of controls, and how many are moved; those of several moves add up. Places are within the
/// mesh's `size` of some control.
fn moves(entries: &[MoveEntry], controls: &[DVec3], size: f64) -> Result<(DVector<f64>, usize)> {
    if entries.is_empty() {
        return Err(Error::input("expected `move`, found none"));
    }
    let mut by = vec![DVec3::ZERO; controls.len()];
    for entry in entries {
        // Of equally near controls the first counts, so that a pose is the same in every run.
        let near = |at: DVec3| {
            (0..controls.len()).min_by(|a, b| controls[*a].distance(at).total_cmp(&controls[*b].distance(at)))
        };
        let chosen: Vec<usize> = match entry.target {
            PoseTarget::Control(index) if index < controls.len() => vec![index],
            PoseTarget::Control(index) => {
                return Err(Error::input(format!(
                    "expected a control from 0 to {}, found {index}",
                    controls.len().saturating_sub(1)
                )));
            }
            PoseTarget::Nearest(at) => near(DVec3::from(at)).into_iter().collect(),
            PoseTarget::Within(at, reach) => {
                (0..controls.len()).filter(|k| controls[*k].distance(DVec3::from(at)) <= reach).collect()
            }
        };
        let (at, reach, within) = match entry.target {
            PoseTarget::Within(at, reach) => (DVec3::from(at), reach, true),
            PoseTarget::Nearest(at) => (DVec3::from(at), size, false),
            // A control by its index has no distance to check.
            PoseTarget::Control(_) => (DVec3::ZERO, f64::INFINITY, false),
        };
        let away = near(at).map_or(f64::INFINITY, |k| controls[k].distance(at));
        // A place far from the mesh is usually in another unit. Without this check, the nearest control would
        // move.
        if chosen.is_empty() || away > reach {
            let DVec3 { x, y, z } = at;
            return Err(Error::input(format!(
                "expected a control within {reach} of {x}, {y}, {z}, found the nearest at a distance of \
                 {}; {}",
                significant(away, 3),
                match within {
                    true => "use a larger `within`, a point nearer to the mesh, or more controls",
                    false => "this is more than the size of the mesh; use a point near the mesh",
                }
            )));
        }
        for k in chosen {
            by[k] += DVec3::from(entry.by);
        }
    }
    // Counted after adding up: opposite moves of one control cancel.
    let moved = by.iter().filter(|d| **d != DVec3::ZERO).count();
    Ok((DVector::from_column_slice(coordinates(&by)), moved))
}

/// Writes one file and its companion files.
fn write(
    path: &Path,
    file: &TexturedMesh,
    mesh: &TriangleMesh,
    poses: &PoseFile,
    targets: &[Vec<DVec3>],
    picture: Option<&[u8]>,
) -> Result<Vec<PathBuf>> {
    // Formats without morph targets show the first pose.
    let points = targets.first().unwrap_or(&mesh.positions);
    match extension(path).as_str() {
        "glb" => {
            let named: Vec<NamedPlaces<'_>> = (poses.poses.iter().zip(targets))
                .map(|(pose, places)| (pose.name.as_str(), &places[..]))
                .collect();
            let keyframes: Vec<Keyframe> = (poses.keyframes.iter())
                .map(|frame| Keyframe { seconds: frame.seconds, weights: frame.weights.clone() })
                .collect();
            let animation = PoseAnimation { poses: &named, keyframes: &keyframes };
            write_glb(path, file, &mesh.positions, animation, Known::default(), picture)?;
            Ok(vec![path.to_owned()])
        }
        "obj" => write_obj(path, file, points, picture),
        _ => {
            write_mesh(
                path,
                &MeshColumns {
                    points,
                    // Normals of the posed mesh: those of the file belong to the mesh at rest.
                    normals: Some(&normals_of(points, &mesh.triangles)),
                    triangles: &mesh.triangles,
                    unit: file.unit,
                    ..MeshColumns::default()
                },
            )?;
            Ok(vec![path.to_owned()])
        }
    }
}
