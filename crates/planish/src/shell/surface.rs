//! `planish shell mesh`: the surface of a mesh's shell as a manifold mesh.
//!
//! Input: any mesh and the options of its field. Output: a mesh, and its deviations from the exact surface.
//!
//! Not guaranteed: parts thinner than a cell are lost, and sharp edges are cut by chords.

use crate::job::Job;
use crate::output::unsupported_extension;
use planish_core::finding::with_warnings;
use planish_core::{Finding, FindingCode};
use planish_core::{Progress, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_exchange::mesh::{MeshColumns, is_mesh_file, read_mesh, write_mesh};
use planish_mesh::TriangleMesh;
pub use planish_shell::{IsoLevel, Metaball};
use planish_shell::{IsoOptions, Shell, ShellOptions, iso_surface, subdivide_for_spheres};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Default thickness of a shell and softness of its field, relative to the mesh's size. A thicker shell or a
/// softer field closes gaps and rounds edges.
const DEFAULT_THICKNESS: f64 = 0.01;
const DEFAULT_SOFTNESS: f64 = 0.002;
/// Maximum radius of spherical metaballs relative to the softness of the field. Larger spheres make the
/// surface bumpy; smaller ones need more facets, in proportion to the square.
const MAX_SPHERE_RATIO: f64 = 3.0;
/// Maximum number of facets after division into spherical metaballs. It bounds memory and time; reaching it
/// is reported.
const MAX_FACETS: usize = 400_000;

/// Settings of the job.
#[derive(Debug, Clone, PartialEq)]
pub struct ShellMeshJob {
    /// The mesh.
    pub mesh: PathBuf,
    /// The surface of the shell to mesh.
    pub level: IsoLevel,
    /// Shape of the metaballs.
    pub metaball: Metaball,
    /// `d0` of triangular metaballs; a hundredth of the mesh's size if none is given.
    pub thickness: Option<f64>,
    /// `1/k`; 1/500 of the mesh's size if none is given.
    pub softness: Option<f64>,
    /// `T`.
    pub threshold: f64,
    /// Side of a cell; 1/150 of the mesh's size if none is given.
    pub cell: Option<f64>,
    /// Files to write.
    pub outputs: Vec<PathBuf>,
    /// Unit of the mesh if the file states none.
    pub unit: Option<Unit>,
}

/// Result of the job.
#[derive(Debug, Clone, Serialize)]
pub struct ShellMeshReport {
    /// Unit of lengths.
    #[serde(skip)]
    pub unit: Option<Unit>,
    /// Vertices of the surface.
    pub vertices: usize,
    /// Its triangles.
    pub triangles: usize,
    /// Its parts.
    pub components: usize,
    /// Vertices − edges + triangles.
    pub euler_characteristic: i64,
    /// Whether the mesh is closed.
    pub watertight: bool,
    /// Whether the mesh is manifold.
    pub manifold: bool,
    /// Side of a cell.
    pub cell: f64,
    /// `1/k` of the field.
    pub softness: f64,
    /// Facets that the field was made of.
    pub facets: usize,
    /// Distance of the middles of facets from the exact surface, rms.
    pub deviation_rms: f64,
    /// The largest.
    pub deviation_max: f64,
    /// Files written.
    #[serde(skip)]
    pub written: Vec<PathBuf>,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
    /// `converged`.
    pub termination: &'static str,
}

impl Default for ShellMeshJob {
    fn default() -> Self {
        Self {
            mesh: PathBuf::new(),
            level: IsoLevel::Shell,
            metaball: Metaball::Triangular,
            thickness: None,
            softness: None,
            threshold: 1.0,
            cell: None,
            outputs: Vec::new(),
            unit: None,
        }
    }
}

impl Job for ShellMeshJob {
    type Report = ShellMeshReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.mesh.clone()])
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        mesh_outputs(&self.outputs, is_mesh_file, ".ply, .obj, .stl, .off or .glb")
    }

    fn execute(&self, progress: &dyn Progress) -> Result<ShellMeshReport> {
        mesh_shell(self, progress)
    }
}

/// Outputs whose extensions are all `good`; `needed` lists those that are.
pub(super) fn mesh_outputs(
    outputs: &[PathBuf],
    good: impl Fn(&Path) -> bool,
    needed: &str,
) -> Result<Vec<PathBuf>> {
    match outputs.iter().find(|path| !good(path)) {
        Some(path) => Err(unsupported_extension(path, needed)),
        None => Ok(outputs.to_vec()),
    }
}

/// Meshes the surface of a shell.
fn mesh_shell(job: &ShellMeshJob, progress: &dyn Progress) -> Result<ShellMeshReport> {
    progress.check("reading", 0.0)?;
    let file = read_mesh(&job.mesh)?;
    let unit = file.unit.or(job.unit);
    let mesh =
        TriangleMesh::try_new(file.points, file.triangles).map_err(|e| e.in_context(job.mesh.display()))?;
    let size = mesh.surface_bounds().map_or(0.0, |b| b.diagonal());
    // All defaults are relative to the size, so a mesh without one would divide by zero.
    if size <= 0.0 {
        return Err(Error::undetermined(format!(
            "{}: expected a mesh with faces and an extent, {}",
            job.mesh.display(),
            match mesh.triangles.is_empty() {
                true => "found no faces",
                false => "found all vertices of its faces at one point",
            }
        )));
    }
    // The softness decides how fine facets must be, so it is fixed before they are divided.
    let softness = job.softness.unwrap_or(DEFAULT_SOFTNESS * size);
    let mut findings = Vec::new();
    let wrapped = match job.metaball {
        // Triangular metaballs follow facets of any size; spheres only approximate small ones.
        Metaball::Triangular => mesh,
        Metaball::Spherical => {
            // The sphere of a facet is as large as the facet, so the softness limits its size.
            let (fine, _) = subdivide_for_spheres(&mesh, MAX_SPHERE_RATIO * softness, MAX_FACETS);
            // A warning: the surface is valid, but bumpy.
            if fine.triangles.len() >= MAX_FACETS {
                let text = format!(
                    "{}: {} facets are too few for spherical metaballs of this softness, so the surface is \
                     bumpy; use a larger softness, or triangular metaballs",
                    job.mesh.display(),
                    fine.triangles.len()
                );
                findings.push(Finding::new(FindingCode::FacetLimit, text));
            }
            fine
        }
    };
    let options = ShellOptions {
        thickness: job.thickness.unwrap_or(DEFAULT_THICKNESS * size),
        threshold: job.threshold,
        ..ShellOptions::new(job.metaball, 1.0 / softness)
    };
    progress.check("meshing", 0.1)?;
    let made = Shell::new(&wrapped, &options)
        .and_then(|shell| iso_surface(&shell, &IsoOptions { level: job.level, cell: job.cell }))
        .map_err(|e| e.in_context(job.mesh.display()))?;
    progress.check(WRITING_STAGE, 0.9)?;
    // One set of normals for all files, so that they agree.
    let normals = made.mesh.vertex_normals();
    for path in &job.outputs {
        write_mesh(
            path,
            &MeshColumns {
                points: &made.mesh.positions,
                normals: Some(&normals),
                triangles: &made.mesh.triangles,
                unit,
                ..MeshColumns::default()
            },
        )?;
    }
    Ok(ShellMeshReport {
        unit,
        vertices: made.mesh.positions.len(),
        triangles: made.mesh.triangles.len(),
        components: made.check.components,
        euler_characteristic: made.check.euler_characteristic,
        // Checked on the result, although the extraction guarantees both.
        watertight: made.check.watertight,
        manifold: made.check.manifold,
        cell: made.cell,
        softness,
        // After the division: these facets form the field and decide time and memory.
        facets: wrapped.triangles.len(),
        deviation_rms: made.deviation_rms,
        deviation_max: made.deviation_max,
        written: job.outputs.clone(),
        findings,
        termination: "converged",
    })
}
