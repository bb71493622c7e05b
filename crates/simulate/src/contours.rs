//! The scene `contours`: occluding contours of a surface of revolution, from two motions of a camera around
//! it.
//!
//! Input: [`ContoursOptions`]. Output: a file of views for each motion, with a mask and measured contours for
//! each view, and the truth as a mesh and as JSON.
//!
//! The contour generator of `x² + y² = r(z)²` from a camera at `C` has a closed form: at height `z`,
//! `cos(θ − θ_C) = (r − r' (z − C_z)) / |C_xy|` (R. Mohr, C. Zhao, G. Koscielny 1994 show a hyperboloid and a
//! carafe). A contour contains the part of it that the object does not hide. The errors of its points are
//! independent, along both axes of the image. The top and bottom rims are edges, not occluding contours, so
//! only the masks contain them.
//!
//! Not guaranteed: the exact end of a contour where one part of the object hides another. The search along
//! the line of sight has finite steps.

use super::truth::positive;
use nalgebra::{Matrix3, Vector3};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_exchange::mesh::{MeshColumns, write_mesh};
use planish_exchange::picture::write_grey_png;
use planish_exchange::{Unit, make_folder, write_atomically};
use planish_mesh::TriangleMesh;
use planish_shell::Camera;
use planish_shell::covered_pixels;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde_json::json;
use std::f64::consts::TAU;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Columns and rows of an image.
const SIZE: [usize; 2] = [640, 480];
/// Samples per pixel of a mask along each axis.
const MASK_SAMPLES: usize = 3;
/// Distance of the camera from the middle of the object, in millimetres; the object is 100 mm high.
const DISTANCE_MM: f64 = 400.0;
/// Start angle, extent and elevation of each motion, in degrees.
const MOTIONS: [[f64; 3]; 2] = [[-60.0, 120.0, 10.0], [30.0, 120.0, -14.0]];
/// Steps of height at which a contour is computed, before one point per pixel is selected.
///
/// They are much finer than a pixel, so that selected points are a pixel apart along a slanted contour, too.
const HEIGHT_STEPS: usize = 6000;
/// Minimum length of a contour, in pixels; shorter pieces between occlusions are dropped.
const MIN_LENGTH_PX: f64 = 30.0;
/// Steps along a line of sight in the search for the part of the object that hides a point.
const STEPS: usize = 600;
/// Upper bound of the radius of the objects, in millimetres.
const MAX_RADIUS_MM: f64 = 50.0;

/// The object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ContoursShape {
    /// A hyperboloid of one sheet, `r² = 30² (1 + (z/40)²)`, 100 mm high.
    Hyperboloid,
    /// A carafe without a handle: a belly, a neck and a lip, 100 mm high.
    Carafe,
}

impl ContoursShape {
    fn name(self) -> &'static str {
        match self {
            Self::Hyperboloid => "hyperboloid",
            Self::Carafe => "carafe",
        }
    }

    /// Radius and its derivative at a height from −50 to 50, in millimetres.
    ///
    /// # Examples
    /// ```
    /// use planish_simulate::ContoursShape;
    /// assert_eq!(ContoursShape::Hyperboloid.profile(0.0), [30.0, 0.0]);
    /// let [belly, _] = ContoursShape::Carafe.profile(-20.0);
    /// assert!(belly > ContoursShape::Carafe.profile(20.0)[0]);
    /// ```
    #[must_use]
    pub fn profile(self, z: f64) -> [f64; 2] {
        match self {
            Self::Hyperboloid => {
                let r = 30.0 * (1.0 + (z / 40.0).powi(2)).sqrt();
                [r, 900.0 * z / 1600.0 / r]
            }
            Self::Carafe => {
                let belly = 24.0 * (-((z + 20.0) / 24.0).powi(2)).exp();
                let lip = 8.0 * ((z - 50.0) / 10.0).exp();
                [12.0 + belly + lip, -2.0 * (z + 20.0) / 576.0 * belly + lip / 10.0]
            }
        }
    }

    /// The point at a height and an angle about the axis.
    fn at(self, z: f64, angle: f64) -> DVec3 {
        let [r, _] = self.profile(z);
        DVec3::new(r * angle.cos(), r * angle.sin(), z)
    }
}

/// Half the height of the objects, in millimetres.
const HALF: f64 = 50.0;

/// Settings of the scene `contours`.
#[derive(Debug, Clone, PartialEq)]
pub struct ContoursOptions {
    /// The object.
    pub shape: ContoursShape,
    /// Number of views of each motion, which extends over 120°.
    pub views: usize,
    /// σ of each point of a contour along both axes of the image, in pixels.
    pub sigma_px: f64,
    /// Seed of every error.
    pub seed: u64,
    /// Unit of every length.
    pub unit: Unit,
}

/// The number of points and the files written.
#[derive(Debug, Clone, PartialEq)]
pub struct ContoursSummary {
    /// Number of points on all contours.
    pub places: usize,
    /// Files of views, one for each motion.
    pub views: Vec<PathBuf>,
    /// All files written.
    pub files: Vec<PathBuf>,
}

/// Simulates the scene and writes its files, as `planish simulate scene contours` does.
///
/// # Errors
/// `Input` for fewer than three views and for a σ that is not positive; `Io` if a file cannot be written.
pub fn write_contours_scene(options: &ContoursOptions, folder: &Path) -> Result<ContoursSummary> {
    positive("σ of the contour points", options.sigma_px)?;
    if options.views < 3 {
        return Err(Error::input(format!(
            "expected at least three views of each motion, found {}",
            options.views
        )));
    }
    let shape = options.shape;
    let size = 1.0 / options.unit.millimetres();
    make_folder(folder)?;
    let mut made = ContoursSummary { places: 0, views: Vec::new(), files: Vec::new() };
    let path = folder.join("truth.ply");
    let truth = surface_of_revolution(shape, 200, 360);
    let positions: Vec<DVec3> = truth.positions.iter().map(|p| size * *p).collect();
    write_mesh(
        &path,
        &MeshColumns {
            points: &positions,
            triangles: &truth.triangles,
            unit: Some(options.unit),
            ..MeshColumns::default()
        },
    )?;
    made.files.push(path);
    // One generator for both motions: the second has other errors than the first.
    let solid = closed_surface(shape);
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    for (m, [first, along, height]) in MOTIONS.into_iter().enumerate() {
        let mut views = format!("unit = \"{}\"\nsigma_px = {:?}\n", options.unit.name(), options.sigma_px);
        for k in 0..options.views {
            let angle = first + along * k as f64 / (options.views - 1) as f64;
            let camera = camera(angle.to_radians(), f64::to_radians(height))?;
            let [mask, contours] = ["png", "csv"].map(|kind| format!("view-{}-{:02}.{kind}", m + 1, k + 1));
            let path = folder.join(&mask);
            write_grey_png(&path, SIZE[0], SIZE[1], &coverage_mask(&solid, &camera)?)?;
            made.files.push(path);
            let mut text = "x,y,sigma_px,contour\n".to_owned();
            for (number, run) in visible_contours(shape, &camera).iter().enumerate() {
                for p in run {
                    let [x, y] = p.map(|x| {
                        let e: f64 = StandardNormal.sample(&mut random);
                        x + options.sigma_px * e
                    });
                    // Rounded far below σ, which keeps files small.
                    text += &format!("{x:.4},{y:.4},{:?},{number}\n", options.sigma_px);
                    made.places += 1;
                }
            }
            let path = folder.join(&contours);
            write_atomically(&path, |out| out.write_all(text.as_bytes()))?;
            made.files.push(path);
            // `{:?}` writes the shortest number that reads back exactly: cameras have no error of their own.
            let rows = |m: &[[f64; 3]; 3]| {
                let row = |i: usize| format!("[{:?}, {:?}, {:?}]", m[i][0], m[i][1], m[i][2]);
                format!("[{}, {}, {}]", row(0), row(1), row(2))
            };
            views += &format!(
                "\n[[view]]\nname = \"{}-{:02}\"\nmask = \"{mask}\"\ncontours = \"{contours}\"\nK = {}\nR = \
                 {}\nt = [{:?}, {:?}, {:?}]\n",
                m + 1,
                k + 1,
                rows(&camera.pinhole.k),
                rows(&camera.pinhole.r),
                size * camera.pinhole.t[0],
                size * camera.pinhole.t[1],
                size * camera.pinhole.t[2]
            );
        }
        let path = folder.join(format!("motion-{}.toml", m + 1));
        write_atomically(&path, |out| out.write_all(views.as_bytes()))?;
        made.files.push(path.clone());
        made.views.push(path);
    }
    let truth = json!({
        "shape": shape.name(),
        "profile": (0..=100)
            .map(|k| f64::from(k) - HALF)
            .map(|z| [size * z, size * shape.profile(z)[0]])
            .collect::<Vec<_>>(),
        "sigma_px": options.sigma_px,
        "unit": options.unit.name(),
    });
    let path = folder.join("truth.json");
    write_atomically(&path, |out| writeln!(out, "{truth:#}"))?;
    made.files.push(path);
    Ok(made)
}

/// A camera that looks at the middle of the object from an angle about the axis and an elevation, in radians.
fn camera(angle: f64, height: f64) -> Result<Camera> {
    let from = DVec3::new(
        DISTANCE_MM * height.cos() * angle.cos(),
        DISTANCE_MM * height.cos() * angle.sin(),
        DISTANCE_MM * height.sin(),
    );
    let forward = Vector3::from((-from).try_normalize().unwrap_or(DVec3::X));
    let right = forward.cross(&Vector3::z()).normalize();
    let r = Matrix3::from_rows(&[right.transpose(), forward.cross(&right).transpose(), forward.transpose()]);
    // The height of the object fills three quarters of the image.
    let focal = 0.75 * SIZE[1] as f64 * DISTANCE_MM / (2.0 * HALF);
    let [cx, cy] = SIZE.map(|n| 0.5 * (n as f64 - 1.0));
    Camera::new(
        [[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]],
        [0, 1, 2].map(|i| [0, 1, 2].map(|j| r[(i, j)])),
        (-(r * Vector3::from(from))).into(),
    )
}

/// The visible contours without errors, with one point per pixel of length.
fn visible_contours(shape: ContoursShape, camera: &Camera) -> Vec<Vec<[f64; 2]>> {
    let from = camera.center();
    let across = from[0].hypot(from[1]);
    let towards = from[1].atan2(from[0]);
    let mut found = Vec::new();
    // The generator has a branch on each side of the plane through the camera and the axis.
    for side in [-1.0, 1.0] {
        let mut run: Vec<[f64; 2]> = Vec::new();
        let mut length_since_point = 0.0;
        let mut before: Option<[f64; 2]> = None;
        let seen_at = |k: usize| {
            let z = HALF * (2.0 * k as f64 / HEIGHT_STEPS as f64 - 1.0);
            let [r, slope] = shape.profile(z);
            let cosine = (r - slope * (z - from[2])) / across;
            let at = shape.at(z, towards + side * cosine.clamp(-1.0, 1.0).acos());
            let seen = cosine.abs() < 1.0 && !is_hidden(shape, from, at);
            camera.project(at).filter(|_| seen)
        };
        // Visibility is the expensive part and computed in parallel; points are selected in order.
        let places: Vec<_> = (0..=HEIGHT_STEPS).into_par_iter().map(seen_at).collect();
        for place in places {
            match place {
                Some((p, _)) => {
                    length_since_point += before.map_or(1.0, |q| (p[0] - q[0]).hypot(p[1] - q[1]));
                    before = Some(p);
                    if length_since_point >= 1.0 {
                        // The rest is kept, so that steps do not add up to a coarser spacing.
                        length_since_point -= 1.0;
                        run.push(p);
                    }
                }
                // Occlusion ends a contour. The next visible point starts another one.
                None => {
                    before = None;
                    found.push(std::mem::take(&mut run));
                }
            }
        }
        found.push(run);
    }
    found.retain(|run| run.len() as f64 > MIN_LENGTH_PX);
    found
}

/// True if a line of sight that touches the object at `at` passes through it elsewhere.
///
/// For this test the object is closed at the top and bottom.
fn is_hidden(shape: ContoursShape, from: DVec3, at: DVec3) -> bool {
    let way = at - from;
    let far = at.distance(from);
    let reach = 3.0 * HALF / far;
    // Only the part of the line within the cylinder around the object is searched. It starts and ends where
    // |from + t·way|² = w² across the axis.
    let a = way[0] * way[0] + way[1] * way[1];
    let b = from[0] * way[0] + from[1] * way[1];
    let c = from[0] * from[0] + from[1] * from[1] - MAX_RADIUS_MM * MAX_RADIUS_MM;
    let root = (b * b - a * c).max(0.0).sqrt();
    let step = |t: f64| (((t - 1.0) / reach + 1.0) * 0.5 * STEPS as f64).clamp(0.0, STEPS as f64) as usize;
    (step((-b - root) / a)..=(step((root - b) / a) + 1).min(STEPS)).any(|k| {
        let t = 1.0 + reach * (2.0 * k as f64 / STEPS as f64 - 1.0);
        let p = from + t * way;
        let inside = p[2].abs() < HALF && p[0].hypot(p[1]) < shape.profile(p[2])[0] - 1e-3;
        // Near the contour the line leaves the surface only in second order, and the tolerance of `inside`
        // cannot decide. Points within 0.5 mm of the contour do not count.
        inside && (t - 1.0).abs() * far > 0.5
    })
}

/// The surface of revolution without its ends, facing outwards.
fn surface_of_revolution(shape: ContoursShape, up: usize, around: usize) -> TriangleMesh {
    let mut positions = Vec::new();
    for i in 0..=up {
        let z = HALF * (2.0 * i as f64 / up as f64 - 1.0);
        positions.extend((0..around).map(|j| shape.at(z, TAU * j as f64 / around as f64)));
    }
    let mut triangles = Vec::new();
    for i in 0..up {
        for j in 0..around {
            let at = |i: usize, j: usize| (i * around + j % around) as u32;
            triangles.push([at(i, j), at(i, j + 1), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i + 1, j)]);
        }
    }
    TriangleMesh { positions, triangles }
}

/// The surface of revolution with both ends closed, so that masks have no opening at the rims.
fn closed_surface(shape: ContoursShape) -> TriangleMesh {
    let (up, around) = (200, 360);
    let mut mesh = surface_of_revolution(shape, up, around);
    for (ring, z) in [(0, -HALF), (up, HALF)] {
        let middle = mesh.positions.len() as u32;
        mesh.positions.push(DVec3::new(0.0, 0.0, z));
        for j in 0..around {
            let [a, b] = [j, (j + 1) % around].map(|j| (ring * around + j) as u32);
            mesh.triangles.push(if z < 0.0 { [middle, b, a] } else { [middle, a, b] });
        }
    }
    mesh
}

/// The share of each pixel that the object covers, from 0 to 255.
fn coverage_mask(mesh: &TriangleMesh, camera: &Camera) -> Result<Vec<u8>> {
    let finer = MASK_SAMPLES as f64;
    let mut k = camera.pinhole.k;
    for row in k.iter_mut().take(2) {
        *row = row.map(|x| finer * x);
        // Pixel centres have whole coordinates: the first of n samples lies (n − 1)/2 samples before the
        // centre of its pixel.
        row[2] += 0.5 * (finer - 1.0);
    }
    let fine = Camera::new(k, camera.pinhole.r, camera.pinhole.t)?;
    let [columns, rows] = SIZE.map(|n| n * MASK_SAMPLES);
    let seen = covered_pixels(mesh, &fine, columns, rows);
    Ok((0..SIZE[0] * SIZE[1])
        .map(|p| {
            let (x, y) = (p % SIZE[0] * MASK_SAMPLES, p / SIZE[0] * MASK_SAMPLES);
            let count = (0..MASK_SAMPLES * MASK_SAMPLES)
                .filter(|s| seen[(y + s / MASK_SAMPLES) * columns + x + s % MASK_SAMPLES])
                .count();
            (255 * count / (MASK_SAMPLES * MASK_SAMPLES)) as u8
        })
        .collect())
}
