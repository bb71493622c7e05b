//! `planish shell mesh`: the surface of a mesh's shell as a manifold mesh.
//!
//! Input: any mesh and the options of its field. Output: a mesh, and its deviations from the exact surface.
//!
//! Not guaranteed: parts thinner than a cell are lost.

use crate::job::Job;
use crate::output::unsupported_extension;
use planish_core::finding::with_warnings;
use planish_core::{Finding, FindingCode};
use planish_core::{Progress, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_exchange::mesh::{MeshColumns, is_mesh_file, read_mesh, write_mesh};
use planish_mesh::TriangleMesh;
use planish_report::numbers::{counted, significant};
pub use planish_shell::Metaball;
use planish_shell::{
    IsoLevel, IsoOptions, IsoSurface, Shell, ShellOptions, iso_surface, subdivide_for_spheres,
};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Default distance of the outer surface or thickness of a shell, and softness of its field, relative to the
/// mesh's size. A thicker shell or a softer field closes gaps and rounds edges.
const DEFAULT_THICKNESS: f64 = 0.01;
const DEFAULT_SOFTNESS: f64 = 0.002;
/// Maximum radius of spherical metaballs relative to the softness of the field. Larger spheres make the
/// surface bumpy; smaller ones need more facets, in proportion to the square.
const MAX_SPHERE_RATIO: f64 = 3.0;
/// Maximum number of facets after division into spherical metaballs. It bounds memory and time; reaching it
/// is reported.
const MAX_FACETS: usize = 400_000;

/// The surface to mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MeshedSurface {
    /// The paper's shell: a sheet on each side of the mesh.
    Shell,
    /// All points at this distance from the mesh that can be reached from outside: one sheet. The default
    /// distance is a hundredth of the mesh's size.
    Outer(Option<f64>),
    /// All points at this signed distance from a closed mesh, negative inside.
    Offset(f64),
}

/// Largest fraction of a surface that may be missing without a warning: at corners in narrow places, the
/// exact surface is cut off by up to a cell.
const MAX_LOST: f64 = 1e-3;

/// Settings of the job.
#[derive(Debug, Clone, PartialEq)]
pub struct ShellMeshJob {
    /// The mesh.
    pub mesh: PathBuf,
    /// The surface to mesh.
    pub surface: MeshedSurface,
    /// Shape of the metaballs, for [`MeshedSurface::Shell`] as are the next three.
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
    /// Number of pairs of triangles that intersect.
    pub self_intersections: usize,
    /// Closed sheets that cannot be reached from outside and were left out of an outer surface.
    pub enclosed: usize,
    /// Area of the mesh whose exact surface is missing, relative to all that has one; none for a shell.
    pub lost_area_fraction: Option<f64>,
    /// Signed distance of an outer surface or an offset; none for a shell.
    pub distance: Option<f64>,
    /// Side of a cell.
    pub cell: f64,
    /// `1/k` of the field of a shell.
    pub softness: Option<f64>,
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
            surface: MeshedSurface::Outer(None),
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
                true =>
                    "found no faces; files of points have none: fit a surface to them, or save a mesh with \
                         faces (.ply, .obj, .stl, .off, .glb)",
                false => "found all vertices of its faces at one point",
            }
        )));
    }
    let softness = job.softness.unwrap_or(DEFAULT_SOFTNESS * size);
    let (level, distance) = match job.surface {
        MeshedSurface::Shell => (IsoLevel::Shell, None),
        MeshedSurface::Outer(distance) => {
            let distance = distance.unwrap_or(DEFAULT_THICKNESS * size);
            (IsoLevel::Outer(distance), Some(distance))
        }
        MeshedSurface::Offset(offset) => (IsoLevel::Offset(offset), Some(offset)),
    };
    let mut findings = Vec::new();
    let wrapped = match (job.surface, job.metaball) {
        (MeshedSurface::Shell, Metaball::Spherical) => divided(job, &mesh, softness, &mut findings),
        // Triangular metaballs follow facets of any size, and exact distances need no metaballs.
        _ => mesh,
    };
    let options = ShellOptions {
        thickness: job.thickness.unwrap_or(DEFAULT_THICKNESS * size),
        threshold: job.threshold,
        ..ShellOptions::new(Metaball::Triangular, 1.0 / softness)
    };
    let options = match job.surface {
        MeshedSurface::Shell => ShellOptions { metaball: job.metaball, ..options },
        _ => options,
    };
    progress.check("meshing", 0.1)?;
    let made = Shell::new(&wrapped, &options)
        .and_then(|shell| iso_surface(&shell, &IsoOptions { level, cell: job.cell }))
        .map_err(|e| e.in_context(job.mesh.display()))?;
    findings.extend(defects(&made, &job.mesh));
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
        self_intersections: made.self_intersections,
        enclosed: made.enclosed,
        lost_area_fraction: made.lost_area_fraction,
        distance,
        cell: made.cell,
        softness: (job.surface == MeshedSurface::Shell).then_some(softness),
        // After the division: these facets form the field and decide time and memory.
        facets: wrapped.triangles.len(),
        deviation_rms: made.deviation_rms,
        deviation_max: made.deviation_max,
        written: job.outputs.clone(),
        findings,
        termination: "converged",
    })
}

/// Findings about what is wrong with a meshed surface.
fn defects(made: &IsoSurface, original: &Path) -> Vec<Finding> {
    let mut found = Vec::new();
    if made.reversed > 0 {
        let text = format!(
            "{}: {} did not face the same way as most of the surface and were reversed",
            original.display(),
            counted(made.reversed, "triangle")
        );
        found.push(Finding::new(FindingCode::FacetsInconsistent, text));
    }
    if made.deviation_max > made.cell {
        let text = format!(
            "a triangle is {} from the exact surface, more than a cell ({}): use smaller cells, and check \
             the original for triangles that cross or face the wrong way",
            significant(made.deviation_max, 3),
            significant(made.cell, 3)
        );
        found.push(Finding::new(FindingCode::DeviationLarge, text));
    }
    if made.self_intersections > 0 {
        let pairs = counted(made.self_intersections, "pair");
        let text = format!("the mesh intersects itself, in {pairs} of triangles: use smaller cells");
        found.push(Finding::new(FindingCode::SelfCrossing, text));
    }
    let lost = made.lost_area_fraction.unwrap_or(0.0);
    if lost > MAX_LOST {
        let percent = significant(100.0 * lost, 2);
        let text = format!(
            "{percent} % of the surface is missing, where it is thinner than a cell: use smaller cells"
        );
        found.push(Finding::new(FindingCode::PartsLost, text));
    }
    found
}

/// The mesh with facets small enough for spherical metaballs of this softness.
fn divided(
    job: &ShellMeshJob,
    mesh: &TriangleMesh,
    softness: f64,
    findings: &mut Vec<Finding>,
) -> TriangleMesh {
    // The sphere of a facet is as large as the facet, so the softness limits its size.
    let (fine, _) = subdivide_for_spheres(mesh, MAX_SPHERE_RATIO * softness, MAX_FACETS);
    // A warning: the surface is valid, but bumpy.
    if fine.triangles.len() >= MAX_FACETS {
        let text = format!(
            "{}: {} facets are too few for spherical metaballs of this softness, so the surface is bumpy; \
             use a larger softness, or triangular metaballs",
            job.mesh.display(),
            fine.triangles.len()
        );
        findings.push(Finding::new(FindingCode::FacetLimit, text));
    }
    fine
}
