//! The scene `shell`: a mesh deformed by known controls, as noisy points with outliers and as masks.
//!
//! Input: [`ShellSceneOptions`]. Output: `mesh.obj` (the mesh at rest), `points.ply` with σ, `views.toml`
//! with a mask for each view, `truth.ply` (the deformed mesh) and `truth.json` (controls and displacements).
//!
//! Not guaranteed: that a large deformation does not intersect itself.

use super::truth::positive;
use nalgebra::{DVector, Matrix3, Vector3};
use planish_core::{DVec3, vector3};
use planish_estimate::{Error, Result};
use planish_exchange::mesh::{Column, MeshColumns, read_mesh, write_mesh};
use planish_exchange::picture::write_grey_png;
use planish_exchange::{Unit, make_folder, write_atomically};
use planish_mesh::{BoundingBox, TriangleMesh, icosphere, sample_points};
use planish_shell::covered_pixels;
use planish_shell::{Camera, Dirichlet, automatic_controls_skipping, displaced_positions};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Columns and rows of an image.
const SIZE: [usize; 2] = [640, 480];
/// Distance of the cameras from the middle of the mesh, relative to the diagonal of its bounding box.
const DISTANCE: f64 = 2.0;
/// Diameter of the built-in ball, in millimetres.
const DIAMETER_MM: f64 = 100.0;

/// Settings of the scene `shell`.
#[derive(Debug, Clone, PartialEq)]
pub struct ShellSceneOptions {
    /// Mesh at rest; `None` for a ball.
    pub mesh: Option<PathBuf>,
    /// Number of controls, which are selected on the mesh.
    pub controls: usize,
    /// σ of the displacements of controls along each axis, relative to the diagonal of the bounding box.
    pub deformation: f64,
    /// Number of points.
    pub points: usize,
    /// σ of the points, relative to the diagonal of the bounding box.
    pub noise: f64,
    /// Share of points that are outliers, uniform in the bounding box.
    pub outliers: f64,
    /// Number of views, evenly around the z axis, alternately from above and below.
    pub views: usize,
    /// Seed of controls, displacements, points and errors.
    pub seed: u64,
    /// Unit of the ball, and of a mesh whose file states none.
    pub unit: Unit,
}

/// The size of the scene and the files written.
#[derive(Debug, Clone, PartialEq)]
pub struct ShellSceneSummary {
    /// Number of points.
    pub points: usize,
    /// Number of controls.
    pub controls: usize,
    /// Unit of every length.
    pub unit: Unit,
    /// All files written.
    pub files: Vec<PathBuf>,
}

/// Simulates the scene and writes its files, as `planish simulate scene shell` does.
///
/// # Errors
/// `Input` for options out of range or a mesh without faces; `Io` if a file cannot be read or written.
///
/// # Examples
/// ```
/// use planish_exchange::Unit;
/// use planish_simulate::{ShellSceneOptions, write_shell_scene};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let folder = tempfile::tempdir()?;
/// let options = ShellSceneOptions {
///     mesh: None,
///     controls: 6,
///     deformation: 0.02,
///     points: 200,
///     noise: 0.001,
///     outliers: 0.0,
///     views: 1,
///     seed: 1,
///     unit: Unit::Millimetre,
/// };
/// let summary = write_shell_scene(&options, folder.path())?;
/// assert_eq!((summary.points, summary.controls), (200, 6));
/// # Ok(())
/// # }
/// ```
pub fn write_shell_scene(options: &ShellSceneOptions, folder: &Path) -> Result<ShellSceneSummary> {
    positive("number of points", options.points as f64)?;
    positive("number of controls", options.controls as f64)?;
    positive("deformation", options.deformation)?;
    positive("noise", options.noise)?;
    if !(0.0..1.0).contains(&options.outliers) {
        return Err(Error::input(format!(
            "expected a share of outliers from 0 to below 1, found {}",
            options.outliers
        )));
    }
    // A mesh without a unit gets that of the options, as in every command that reads meshes.
    let (rest, unit) = match &options.mesh {
        Some(path) => {
            let file = read_mesh(path)?;
            let mesh = TriangleMesh::try_new(file.points, file.triangles)
                .map_err(|e| e.in_context(path.display()))?;
            (mesh, file.unit.unwrap_or(options.unit))
        }
        None => {
            let radius = 0.5 * DIAMETER_MM / options.unit.millimetres();
            (icosphere(radius, 4), options.unit)
        }
    };
    let bounds = BoundingBox::from_points(&rest.positions)
        .ok_or_else(|| Error::input("expected a mesh with vertices, found none"))?;
    let size = bounds.diagonal();
    // One sequence for everything, in this order: the skipped control, displacements, positions, errors.
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    // `skipped` makes these controls differ from those that a fit selects automatically: with the same ones,
    // a fit could represent the deformation exactly, which no real object allows.
    let skipped = random.random_range(1..rest.positions.len().max(2));
    let controls = automatic_controls_skipping(&rest, options.controls, skipped)?.points;
    let moved: Vec<DVec3> =
        (controls.iter()).map(|_| gaussian_vector(&mut random, options.deformation * size)).collect();
    let deformation = Dirichlet::new(&controls, &rest.positions)?;
    let q = DVector::from_column_slice(vector3::coordinates(&moved));
    let truth = TriangleMesh {
        positions: displaced_positions(&rest.positions, &deformation, &q),
        triangles: rest.triangles.clone(),
    };
    // The box of the deformed mesh, for outliers and cameras: a large deformation leaves that of the mesh
    // at rest.
    let bounds = BoundingBox::from_points(&truth.positions).unwrap_or(bounds);
    let sigma = options.noise * size;
    let points: Vec<DVec3> = sample_points(&truth, options.points, || random.random())?
        .into_iter()
        .map(|place| place.position)
        .collect();
    // All positions are drawn before all errors, so that another σ leaves the positions unchanged.
    let points: Vec<DVec3> = (points.into_iter())
        .map(|place| match random.random::<f64>() < options.outliers {
            true => {
                DVec3::from_array(std::array::from_fn(|k| random.random_range(bounds.min[k]..=bounds.max[k])))
            }
            false => DVec3::from((place + gaussian_vector(&mut random, sigma)).to_array()),
        })
        .collect();
    make_folder(folder)?;
    let mut files = Vec::new();
    let mut write = |name: &str, mesh: MeshColumns<'_>| {
        let path = folder.join(name);
        files.push(path.clone());
        write_mesh(&path, &MeshColumns { unit: Some(unit), ..mesh })
    };
    for (name, mesh) in [("mesh.obj", &rest), ("truth.ply", &truth)] {
        write(
            name,
            MeshColumns { points: &mesh.positions, triangles: &mesh.triangles, ..MeshColumns::default() },
        )?;
    }
    write(
        "points.ply",
        MeshColumns {
            points: &points,
            columns: vec![("sigma", Column::F64(&vec![sigma; points.len()]))],
            ..MeshColumns::default()
        },
    )?;
    let views = write_masks(&truth, &bounds, options.views, unit, folder, &mut files)?;
    let path = folder.join("views.toml");
    write_atomically(&path, |out| out.write_all(views.as_bytes()))?;
    files.push(path);
    let truth = json!({
        "controls": controls,
        "displacements": moved,
        "sigma": sigma,
        "outliers": options.outliers,
        "unit": unit.name(),
    });
    let path = folder.join("truth.json");
    write_atomically(&path, |out| writeln!(out, "{truth:#}"))?;
    files.push(path);
    Ok(ShellSceneSummary { points: points.len(), controls: controls.len(), unit, files })
}

/// Writes the masks of all views and returns the text of `views.toml`.
fn write_masks(
    truth: &TriangleMesh,
    bounds: &BoundingBox,
    count: usize,
    unit: Unit,
    folder: &Path,
    files: &mut Vec<PathBuf>,
) -> Result<String> {
    // Masks hold 0 and 255 only; the threshold in the middle reads them back exactly.
    let mut views = format!("unit = \"{}\"\nmask_threshold = 127\n", unit.name());
    for view in 0..count {
        let camera = camera(view, count, bounds)?;
        let name = format!("mask{:02}.png", view + 1);
        let path = folder.join(&name);
        write_grey_png(&path, SIZE[0], SIZE[1], &mask(truth, &camera))?;
        files.push(path);
        let rows = |m: &[[f64; 3]; 3]| {
            let row = |i: usize| format!("[{:?}, {:?}, {:?}]", m[i][0], m[i][1], m[i][2]);
            format!("[{}, {}, {}]", row(0), row(1), row(2))
        };
        views += &format!(
            "\n[[view]]\nmask = \"{name}\"\nK = {}\nR = {}\nt = [{:?}, {:?}, {:?}]\n",
            rows(&camera.pinhole.k),
            rows(&camera.pinhole.r),
            camera.pinhole.t[0],
            camera.pinhole.t[1],
            camera.pinhole.t[2]
        );
    }
    Ok(views)
}

/// A Gaussian vector with this σ along each axis.
fn gaussian_vector(random: &mut ChaCha8Rng, sigma: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| {
        let x: f64 = StandardNormal.sample(random);
        sigma * x
    }))
}

/// A camera that looks at the middle of a box, with the z axis upwards in the image.
fn camera(view: usize, views: usize, bounds: &BoundingBox) -> Result<Camera> {
    let size = bounds.diagonal();
    let angle = std::f64::consts::TAU * view as f64 / views as f64;
    // Outlines from a single elevation leave the top and bottom of the object undetermined.
    let height = if view.is_multiple_of(2) { 0.35 } else { -0.35 };
    let from = DVec3::new(angle.cos(), angle.sin(), height).try_normalize().unwrap_or(DVec3::X);
    let center = bounds.center() + DISTANCE * size * from;
    let forward = Vector3::from(-from);
    let right = forward.cross(&Vector3::z()).normalize();
    let down = forward.cross(&right);
    let r = Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
    let t = -(r * Vector3::from(center));
    // The diagonal of the box fills 80 % of the height of the image.
    let focal = 0.8 * SIZE[1] as f64 * DISTANCE;
    let [cx, cy] = SIZE.map(|n| 0.5 * (n as f64 - 1.0));
    Camera::new(
        [[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]],
        [0, 1, 2].map(|i| [0, 1, 2].map(|j| r[(i, j)])),
        t.into(),
    )
}

/// An image that is white where it shows the mesh.
fn mask(mesh: &TriangleMesh, camera: &Camera) -> Vec<u8> {
    let seen = covered_pixels(mesh, camera, SIZE[0], SIZE[1]);
    seen.into_iter().map(|seen| if seen { 255 } else { 0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_exchange::views::read_views;
    use planish_mesh::MeshSearch;
    use planish_shell::displacements;

    /// The distances of points agree with their σ, the controls of truth.json deform mesh.obj to truth.ply,
    /// and the masks cover the vertices of truth.ply.
    #[test]
    fn files_of_the_scene_agree_with_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let options = ShellSceneOptions {
            mesh: None,
            controls: 12,
            deformation: 0.03,
            points: 2000,
            noise: 0.002,
            outliers: 0.1,
            views: 3,
            seed: 5,
            unit: Unit::Millimetre,
        };
        let made = write_shell_scene(&options, folder.path()).unwrap();
        assert!(made.files.iter().all(|path| path.is_file()) && made.controls == 12);
        let read = |name: &str| read_mesh(&folder.path().join(name)).unwrap();
        let (rest, truth, points) = (read("mesh.obj"), read("truth.ply"), read("points.ply"));
        let search = MeshSearch::try_new(&TriangleMesh {
            positions: truth.points.clone(),
            triangles: truth.triangles,
        })
        .unwrap();
        let sigma = points.column("sigma").unwrap()[0];
        let near =
            (points.points.iter()).filter(|p| search.closest(**p).unwrap().distance < 2.0 * sigma).count();
        let share = near as f64 / points.points.len() as f64;
        assert!((0.82..0.95).contains(&share), "{share}");
        let text = std::fs::read_to_string(folder.path().join("truth.json")).unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        let list = |key: &str| -> Vec<DVec3> { serde_json::from_value(json[key].clone()).unwrap() };
        let deformation = Dirichlet::new(&list("controls"), &rest.points).unwrap();
        let q = DVector::from_column_slice(vector3::coordinates(&list("displacements")));
        for ((p, by), wanted) in rest.points.iter().zip(displacements(&deformation, &q)).zip(&truth.points) {
            assert!((*p + by).distance(*wanted) < 1e-9);
        }
        let views = read_views(&folder.path().join("views.toml")).unwrap();
        assert_eq!(views.views.len(), 3);
        for view in &views.views {
            let mask = planish_exchange::picture::read_brightness(view.mask.as_ref().unwrap()).unwrap();
            let white = mask.values.iter().filter(|v| **v > 127.0).count();
            assert!((0.05..0.7).contains(&(white as f64 / mask.values.len() as f64)));
            for p in truth.points.iter().step_by(50) {
                let ([x, y], _) = view.camera.project(*p).unwrap();
                let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [dx, dy]));
                assert!(around.into_iter().any(|[dx, dy]| {
                    let [column, row] = [x.round() as i64 + dx, y.round() as i64 + dy].map(|v| v as usize);
                    mask.values[row * SIZE[0] + column] > 127.0
                }));
            }
        }
    }
}
