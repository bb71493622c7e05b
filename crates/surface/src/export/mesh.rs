//! Triangle meshes of a model, with σ at each vertex.
//!
//! Input: a model, its posterior and a chord error. Output: a [`ModelMesh`], written as PLY or GLB with
//! `x y z nx ny nz sigma observed`, or as OBJ or STL without σ. σ is that of the surface point along its
//! normal. `observed` is 1 where readings support the surface, 2 where it was completed by inference from
//! other parts, 3 where it does not follow its readings, and 0 where only the prior holds. The bytes do not
//! depend on the number of threads.
//!
//! Not guaranteed: that σ holds between vertices where the mesh is much coarser than the leaves; that the
//! mesh does not cross itself where the surface folds.

use super::trimming::{Closing, KeptParts};
use crate::model::SigmaSummary;
use crate::model::sigmas_along;
use crate::model::{Posterior, SurfaceModel};
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_estimate::Result;
use planish_exchange::Unit;
use planish_exchange::mesh::{Column, MeshColumns, write_mesh};
use planish_mesh::{TriangleMesh, VertexCurvature};
use planish_spline::{Surface, TessellationOptions, min_triangles, tessellate, tessellate_parts};
use std::path::Path;

/// Approximate maximum of triangles of meshes without a requested tolerance: a file of some 40 MB.
pub const MAX_DEFAULT_TRIANGLES: u64 = 1_000_000;
/// Approximate maximum of triangles of meshes with a requested tolerance: a gigabyte.
pub const MAX_TRIANGLES: u64 = 20_000_000;

/// A mesh of a model.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelMesh {
    /// Positions and triangles, in the model's unit.
    pub mesh: TriangleMesh,
    /// Unit normals of the surface, one for each vertex.
    pub normals: Vec<DVec3>,
    /// σ of each vertex along its normal, in the model's unit.
    pub sigma: Vec<f64>,
    /// How each vertex is known: see [`Observed::mark`](crate::model::Observed::mark).
    pub observed: Vec<u8>,
    /// Chord error of the mesh.
    pub tolerance: f64,
    /// Unit of every length.
    pub unit: Unit,
    /// What a user should know.
    pub findings: Vec<Finding>,
}

/// A mesh within `tolerance` of the model's surface, with σ at each vertex.
///
/// The default tolerance is half the median σ of the measured surface, or what [`MAX_DEFAULT_TRIANGLES`]
/// allow. A given tolerance is enlarged to what [`MAX_TRIANGLES`] allow. A leaf is divided into 64 × 64
/// squares at most. A finding reports each limit that applies.
///
/// Cost: one covariance for each leaf; one jet and about 300 multiply-adds for each vertex.
///
/// # Errors
/// `Input` for a tolerance that is not positive.
///
/// # Examples
/// ```
/// use planish_surface::export::mesh_from_model;
/// use planish_surface::test_support::small_model;
/// let model = small_model(planish_spline::Shape::Ball);
/// let mesh = mesh_from_model(&model, &model.posterior()?, Some(0.01))?;
/// assert!(mesh.mesh.check().watertight);
/// assert_eq!(mesh.sigma.len(), mesh.mesh.positions.len());
/// # Ok::<(), planish_core::Error>(())
/// ```
pub fn mesh_from_model(
    model: &SurfaceModel,
    posterior: &Posterior<'_>,
    tolerance: Option<f64>,
) -> Result<ModelMesh> {
    mesh_of_size(model, posterior, tolerance, [MAX_DEFAULT_TRIANGLES, MAX_TRIANGLES])
}

/// [`mesh_from_model`] without the parts that `closing` leaves out; see
/// [`Support`](crate::model::Support).
///
/// # Errors
/// As for [`mesh_from_model`].
pub fn trimmed_mesh_from_model(
    model: &SurfaceModel,
    posterior: &Posterior<'_>,
    closing: Closing,
    tolerance: Option<f64>,
) -> Result<ModelMesh> {
    let limits = [MAX_DEFAULT_TRIANGLES, MAX_TRIANGLES];
    let kept = KeptParts::new(model, closing);
    placed_mesh_of_size(model, posterior, tolerance, limits, kept.as_ref()).map(|placed| placed.mesh)
}

/// A mesh, with the surface parameters of each vertex.
pub struct PlacedMesh {
    /// The mesh.
    pub mesh: ModelMesh,
    /// For each vertex, a leaf that contains it.
    pub leaf: Vec<u32>,
    /// Coordinates in that leaf.
    pub local: Vec<[f64; 2]>,
}

/// A mesh of a model with at most about `max_triangles` triangles, with the parameters of its vertices.
///
/// # Errors
/// As for [`mesh_from_model`].
pub fn placed_mesh(
    model: &SurfaceModel,
    posterior: &Posterior<'_>,
    tolerance: Option<f64>,
    max_triangles: u64,
) -> Result<PlacedMesh> {
    placed_mesh_of_size(model, posterior, tolerance, [max_triangles; 2], None)
}

/// [`mesh_from_model`] with other limits of triangles: without and with a requested tolerance.
fn mesh_of_size(
    model: &SurfaceModel,
    posterior: &Posterior<'_>,
    tolerance: Option<f64>,
    max_triangles: [u64; 2],
) -> Result<ModelMesh> {
    placed_mesh_of_size(model, posterior, tolerance, max_triangles, None).map(|placed| placed.mesh)
}

fn placed_mesh_of_size(
    model: &SurfaceModel,
    posterior: &Posterior<'_>,
    tolerance: Option<f64>,
    [max_by_default, max_triangles]: [u64; 2],
    kept: Option<&KeptParts<'_>>,
) -> Result<PlacedMesh> {
    let mut findings = Vec::new();
    let unit = model.unit;
    let (wanted, max_triangles) = match tolerance {
        Some(tolerance) => (tolerance, max_triangles),
        // Added in quadrature, a chord error of σ/2 makes σ 12 % larger at most.
        None => (0.5 * median_sigma(model, posterior)?, max_by_default),
    };
    // The tolerance is enlarged before the surface is divided: the number of triangles can be predicted.
    let affordable = affordable_tolerance(&model.surface, wanted, max_triangles)?;
    if affordable > wanted {
        let goal = match tolerance {
            Some(_) => format!("the requested {wanted:.2e} {unit}"),
            None => format!("half its median σ, {wanted:.2e} {unit}"),
        };
        let text = format!(
            "the chord error of the mesh is {affordable:.2e} {unit} instead of {goal}, which needs more \
             than {max_triangles} triangles"
        );
        findings.push(match tolerance {
            Some(_) => Finding::new(FindingCode::MeshTriangleLimit, text),
            // A stated tolerance may have more triangles.
            None => Finding::new(
                FindingCode::MeshTriangleLimit,
                text + "; specify the chord error to get \
                it",
            )
            .with_setting(Setting::MeshTolerance),
        });
    }
    let tolerance = affordable;
    let options = TessellationOptions { tolerance, ..TessellationOptions::default() };
    let made = match kept {
        None => tessellate(&model.surface, &options)?,
        Some(kept) => tessellate_parts(
            &model.surface,
            &options,
            |leaf| kept.halvings(leaf),
            |leaf, local| kept.has(leaf, local),
        )?,
    };
    if made.limited_leaves > 0 {
        let text = format!(
            "the chord error exceeds {tolerance:.2e} {unit} on {} of {} cells, because cells are divided \
             into at most 64 × 64 squares",
            made.limited_leaves,
            model.observed.len()
        );
        findings.push(Finding::new(FindingCode::MeshSubdivisionLimit, text));
    }
    let sigma = sigmas_along(posterior, &made.leaf, &made.local, &made.normals)?;
    let observed = (made.leaf.iter().zip(&made.local))
        .map(|(&leaf, &local)| model.observed_at(leaf as usize, local).mark())
        .collect();
    Ok(PlacedMesh {
        mesh: ModelMesh {
            mesh: TriangleMesh::try_new(made.positions, made.triangles)?,
            normals: made.normals,
            sigma,
            observed,
            tolerance,
            unit: model.unit,
            findings,
        },
        leaf: made.leaf,
        local: made.local,
    })
}

/// The given tolerance, enlarged until a mesh within it has at most `max_triangles` triangles.
///
/// # Errors
/// `Input` for a tolerance that is not positive.
pub fn affordable_tolerance(surface: &Surface, wanted: f64, max_triangles: u64) -> Result<f64> {
    let mut tolerance = wanted;
    // A leaf takes at least two triangles, so a limit below that could never be met.
    loop {
        let options = TessellationOptions { tolerance, ..TessellationOptions::default() };
        if min_triangles(surface, &options)? <= max_triangles.max(2 * surface.space().leaves().len() as u64) {
            return Ok(tolerance);
        }
        // The number of triangles is about inversely proportional to the chord error, so steps of 25 % use
        // at least 80 % of the limit.
        tolerance *= 1.25;
    }
}

/// Median, by area, of σ along the normal at the middle of every measured leaf (of every leaf if none was
/// measured).
///
/// # Errors
/// `Undetermined` if the surface has no area.
pub fn median_sigma(model: &SurfaceModel, posterior: &Posterior<'_>) -> Result<f64> {
    sigma_summary(model, posterior).map(|sigma| sigma.median)
}

/// Quantiles, by area, of σ along the normal at the middle of every measured leaf (of every leaf if none was
/// measured).
///
/// # Errors
/// `Undetermined` if the surface has no area.
///
/// # Examples
/// ```
/// use planish_surface::export::sigma_summary;
/// use planish_surface::test_support::small_model;
/// let model = small_model(planish_spline::Shape::Sheet);
/// let sigma = sigma_summary(&model, &model.posterior()?)?;
/// assert!(sigma.median <= sigma.p95 && sigma.p95 <= sigma.max);
/// # Ok::<(), planish_core::Error>(())
/// ```
pub fn sigma_summary(model: &SurfaceModel, posterior: &Posterior<'_>) -> Result<SigmaSummary> {
    posterior.sigma_summary(&model.observed)
}

/// Writes a model's mesh in the format of the path's extension: `.ply`, `.obj`, `.stl` or `.glb`, each
/// optionally with `.gz`.
///
/// # Errors
/// `Unsupported` for other extensions and for meshes too large for a format; `Io` if the file cannot be
/// written. No partial file is left.
pub fn write_model_mesh(mesh: &ModelMesh, path: &Path) -> Result<()> {
    let ModelMesh { mesh, normals, sigma, observed, unit, .. } = mesh;
    write_known_mesh(path, &KnownMesh { mesh, normals, sigma, observed, curvature: None, unit: *unit })
}

/// A mesh with what is known about each of its vertices.
#[derive(Debug, Clone, Copy)]
pub struct KnownMesh<'a> {
    /// The mesh.
    pub mesh: &'a TriangleMesh,
    /// Unit normals.
    pub normals: &'a [DVec3],
    /// σ along the normal.
    pub sigma: &'a [f64],
    /// How each vertex is known: see [`Observed::mark`](crate::model::Observed::mark).
    pub observed: &'a [u8],
    /// Curvature, if it was estimated.
    pub curvature: Option<&'a VertexCurvature>,
    /// Unit of every length.
    pub unit: Unit,
}

/// Writes a mesh with σ at each vertex in the format of the path's extension.
///
/// # Errors
/// As [`write_model_mesh`].
pub fn write_known_mesh(
    path: &Path,
    KnownMesh { mesh, normals, sigma, observed, curvature, unit }: &KnownMesh<'_>,
) -> Result<()> {
    let mut columns = vec![("sigma", Column::F64(sigma)), ("observed", Column::U8(observed))];
    if let Some(known) = *curvature {
        columns.extend([
            ("mean_curvature", Column::F64(&known.mean)),
            ("gaussian_curvature", Column::F64(&known.gaussian)),
            ("sigma_mean_curvature", Column::F64(&known.sigma_mean)),
            ("border", Column::U8(&known.border)),
        ]);
    }
    write_mesh(
        path,
        &MeshColumns {
            points: &mesh.positions,
            normals: Some(normals),
            columns,
            triangles: &mesh.triangles,
            unit: Some(*unit),
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{SIGMA, model_of, refined_surface, small_model};
    use planish_exchange::mesh::read_mesh;
    use planish_spline::Shape;

    #[test]
    fn sigma_of_every_vertex_is_that_of_its_surface_point() {
        let model = small_model(Shape::Ball);
        let posterior = model.posterior().unwrap();
        let mesh = mesh_from_model(&model, &posterior, Some(1e-3)).unwrap();
        let made = tessellate(&model.surface, &TessellationOptions { tolerance: 1e-3, ..Default::default() })
            .unwrap();
        for vertex in (0..mesh.sigma.len()).step_by(17) {
            let leaf = made.leaf[vertex] as usize;
            let alone = Posterior::sigma_along(
                &posterior.leaf(leaf).unwrap(),
                made.local[vertex],
                made.normals[vertex],
            );
            assert_eq!(mesh.sigma[vertex].to_bits(), alone.to_bits(), "vertex {vertex}");
            assert_eq!(mesh.observed[vertex], model.observed[leaf].mark());
        }
        assert!(mesh.sigma.iter().all(|&s| s > 0.0));
    }

    #[test]
    fn unmeasured_vertices_have_larger_sigma() {
        let model = model_of(refined_surface(Shape::Sheet), |leaf| leaf % 100 < 15);
        let mesh = mesh_from_model(&model, &model.posterior().unwrap(), Some(0.01)).unwrap();
        let mean = |seen: u8| {
            let sigmas: Vec<f64> =
                mesh.sigma.iter().zip(&mesh.observed).filter(|(_, o)| **o == seen).map(|(s, _)| *s).collect();
            sigmas.iter().sum::<f64>() / sigmas.len() as f64
        };
        assert!(mean(0) > 2.0 * mean(1), "{} {}", mean(0), mean(1));
        assert!(mean(1) < SIGMA);
    }

    #[test]
    fn the_default_chord_error_is_half_the_median_sigma() {
        let model = small_model(Shape::Ball);
        let posterior = model.posterior().unwrap();
        let mesh = mesh_from_model(&model, &posterior, None).unwrap();
        assert_eq!(mesh.tolerance, 0.5 * median_sigma(&model, &posterior).unwrap());
        assert!(mesh.findings.is_empty() && mesh.mesh.check().watertight);
        // A unit ball: no chord lies deeper than the tolerance.
        for corners in (0..mesh.mesh.triangles.len()).map(|t| mesh.mesh.corners(t)) {
            let middle =
                DVec3::from_array([0, 1, 2].map(|d| corners.iter().map(|p| p[d]).sum::<f64>() / 3.0));
            assert!(middle.length() > 1.0 - 1.1 * mesh.tolerance - 1e-3);
        }
    }

    #[test]
    fn a_sigma_too_small_to_mesh_is_reported() {
        let mut model = small_model(Shape::Ball);
        let information = model.known.information_mut().unwrap();
        let data = information.data.clone();
        information.data.add_scaled(&data, 1e16).unwrap();
        let posterior = model.posterior().unwrap();
        // So few leaves stay below the limit of triangles at any number of divisions; then that of divisions
        // holds.
        let mesh = mesh_of_size(&model, &posterior, None, [4_000_000, 4_000_000]).unwrap();
        assert_eq!(mesh.tolerance, 0.5 * median_sigma(&model, &posterior).unwrap());
        let [warning] = &mesh.findings[..] else {
            panic!("{:?}", mesh.findings);
        };
        assert!(warning.text.contains("at most 64 × 64 squares"), "{warning}");
        // Triangles run out first.
        let mesh = mesh_of_size(&model, &posterior, None, [20_000, 40_000]).unwrap();
        assert!(mesh.tolerance > 0.5 * median_sigma(&model, &posterior).unwrap());
        assert!(mesh.mesh.triangles.len() <= 22_000 && mesh.mesh.triangles.len() > 10_000);
        let [warning] = &mesh.findings[..] else {
            panic!("{:?}", mesh.findings);
        };
        assert!(warning.text.contains("half its median σ"), "{warning}");
        assert_eq!(warning.settings, [Setting::MeshTolerance]);
    }

    #[test]
    fn a_tolerance_that_takes_too_many_triangles_is_enlarged_and_reported() {
        let model = small_model(Shape::Ball);
        let posterior = model.posterior().unwrap();
        let mesh = mesh_of_size(&model, &posterior, Some(1e-9), [20_000, 40_000]).unwrap();
        assert!(mesh.tolerance > 1e-9 && mesh.mesh.triangles.len() <= 44_000);
        assert!(mesh.findings[0].text.contains("the requested"), "{:?}", mesh.findings);
        assert!(mesh_from_model(&model, &posterior, Some(0.0)).is_err());
    }

    #[test]
    fn the_file_holds_the_columns_of_the_contract() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        let model = small_model(Shape::Tube);
        let mesh = mesh_from_model(&model, &model.posterior().unwrap(), Some(0.01)).unwrap();
        write_model_mesh(&mesh, &path).unwrap();
        let read = read_mesh(&path).unwrap();
        let names: Vec<&str> = read.columns.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["nx", "ny", "nz", "sigma", "observed"]);
        assert_eq!(read.column("sigma").unwrap(), mesh.sigma);
        assert_eq!((read.points, read.triangles), (mesh.mesh.positions, mesh.mesh.triangles));
        assert_eq!(read.unit, Some(Unit::Millimetre));
    }

    #[test]
    fn every_format_holds_the_same_triangles() {
        let folder = tempfile::tempdir().unwrap();
        let model = small_model(Shape::Ball);
        let mesh = mesh_from_model(&model, &model.posterior().unwrap(), Some(0.01)).unwrap();
        for name in ["a.ply.gz", "a.obj", "a.obj.gz", "a.stl", "a.glb", "a.glb.gz"] {
            let path = folder.path().join(name);
            write_model_mesh(&mesh, &path).unwrap();
            let read = read_mesh(&path).unwrap();
            let scale = read.unit.unwrap().millimetres();
            assert_eq!(read.triangles.len(), mesh.mesh.triangles.len(), "{name}");
            for (found, expected) in read.triangles.iter().zip(&mesh.mesh.triangles).step_by(7) {
                for k in 0..3 {
                    let (a, b) = (read.points[found[k] as usize], mesh.mesh.positions[expected[k] as usize]);
                    assert!((0..3).all(|d| (scale * a[d] - b[d]).abs() < 1e-6), "{name} {a:?} {b:?}");
                }
            }
            let sigma = read.column("sigma").map(|sigma| scale * sigma[5]);
            assert_eq!(sigma.is_some(), name.contains("ply") || name.contains("glb"), "{name}");
            assert!(sigma.is_none_or(|s| (s / mesh.sigma[5] - 1.0).abs() < 1e-6), "{name}");
        }
    }

    #[test]
    fn the_exported_mesh_does_not_depend_on_the_number_of_threads() {
        let model = small_model(Shape::Torus);
        let made = [1, 2, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| mesh_from_model(&model, &model.posterior().unwrap(), None).unwrap())
        });
        assert!(made[0] == made[1] && made[1] == made[2]);
    }
}
