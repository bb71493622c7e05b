//! The scenes `stereo` and `grid`: images of a textured object from several views, and the ground truth.
//!
//! Input: [`PictureSceneOptions`] with a mesh or a built-in freeform. Output: a folder with
//!
//! - the images of every view and the calibration that `planish sense` reads,
//! - `job.toml` with the poses, which fuses the files that `sense` will write, and the same for each single
//!   view (`view-1.toml`),
//! - `truth.ply` and `truth.json`.
//!
//! The cameras lie on a ring around the object, 20° above its equator. Both scenes have the same cameras, so
//! that their results can be fused: the camera for the stripes is the left one of the stereo pair.
//!
//! Not guaranteed: that the views cover the whole surface.

use super::render::{Exposure, Light, Texture};
use super::truth::{Truth, positive};
use planish_core::Pinhole;
use planish_core::matrix3::from_columns;
use planish_core::{DVec3, Progress, ProgressPart, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::mesh::read_mesh;
use planish_exchange::picture::write_grey_png;
use planish_exchange::ply::{MeshColumns, write_mesh};
use planish_exchange::{Unit, make_folder, write_atomically};
use planish_mesh::{MeshSearch, TriangleMesh};
use planish_sense::Pose;
use planish_sense::stripes::StripePattern;
use planish_spline::Shape;
use serde::Serialize;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Length of a built-in object, in millimetres.
const SIZE_MM: f64 = 100.0;
/// Distance of the cameras from the middle of the object, relative to its diagonal.
const DISTANCE: f64 = 2.2;
/// Elevation of the cameras above the equator of the object.
const ELEVATION_DEG: f64 = 20.0;
/// Baseline of a stereo pair, relative to the distance of the object.
const BASELINE: f64 = 0.12;
/// Minimum disparity, in pixels; stereo searches from zero, so this leaves a margin at the far side.
const MIN_DISPARITY: f64 = 8.0;
/// Angle between camera and projector, seen from the object.
const PROJECTOR_DEG: f64 = 25.0;
/// Directions of the stripes.
///
/// Stripes are identified by their epipolar lines (see `docs/decisions/0033-crossed-stripes.md`). At 45°, a
/// shifted or rotated pattern has its crossings on the same lines, so that it could not be told apart.
const STRIPES_DEG: [f64; 2] = [35.0, 125.0];
/// σ of a stripe's profile, in pixels of the projector.
const STRIPE_SIGMA_PX: f64 = 1.8;
/// Size of the finest spots of the texture, in pixels.
const GRAIN_PX: f64 = 3.0;
/// Share of the image that the object fills, along the axis that limits the focal length.
const FILL_SHARE: f64 = 0.94;

/// Settings of the scenes `stereo` and `grid`.
#[derive(Debug, Clone, PartialEq)]
pub struct PictureSceneOptions {
    /// Mesh of the object; `None` for a freeform.
    pub mesh: Option<PathBuf>,
    /// Steps of smooth subdivision of the mesh, at most 5; the images and the truth show the refined mesh.
    pub subdivide: usize,
    /// Index of the vertical axis: 0, 1 or 2.
    pub up: usize,
    /// Topology of the freeform.
    pub shape: Shape,
    /// Number of views around the object.
    pub views: usize,
    /// Columns and rows of the images.
    pub size: [usize; 2],
    /// Contrast of the texture, from 0 (plain) to below 1.
    pub texture: f64,
    /// σ of the brightness of a pixel, on the scale from 0 to 255.
    pub sigma_brightness: f64,
    /// Spacing of the stripes, in pixels of the projector.
    pub stripe_spacing: f64,
    /// Seed of the freeform, the texture and all noise.
    pub seed: u64,
    /// Unit of a freeform, and of a mesh whose file states none.
    pub unit: Unit,
}

impl Default for PictureSceneOptions {
    fn default() -> Self {
        Self {
            mesh: None,
            subdivide: 0,
            up: 2,
            shape: Shape::Ball,
            views: 3,
            size: [960, 720],
            texture: 0.7,
            sigma_brightness: 1.0,
            stripe_spacing: 18.0,
            seed: 0,
            unit: Unit::Millimetre,
        }
    }
}

/// The kind of images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PictureScene {
    /// Rectified stereo pairs under a lamp.
    Stereo,
    /// An image with crossed projected stripes and one of the same view under a lamp.
    Grid,
}

impl PictureScene {
    /// Name on the command line, and stem of the file names that `sense` writes.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Stereo => "stereo",
            Self::Grid => "grid",
        }
    }

    /// File name of the calibration.
    #[must_use]
    pub fn calibration(self) -> &'static str {
        match self {
            Self::Stereo => "cameras.toml",
            Self::Grid => "grid.toml",
        }
    }

    /// File names of the two images of a view, in the order in which `sense` expects them.
    ///
    /// # Examples
    /// ```
    /// use planish_simulate::PictureScene;
    /// assert_eq!(PictureScene::Stereo.pictures(1), ["left-1.png", "right-1.png"]);
    /// assert_eq!(PictureScene::Grid.calibration(), "grid.toml");
    /// ```
    #[must_use]
    pub fn pictures(self, view: usize) -> [String; 2] {
        match self {
            Self::Stereo => ["left", "right"],
            Self::Grid => ["stripes", "plain"],
        }
        .map(|stem| format!("{stem}-{view}.png"))
    }
}

/// Contents of `truth.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PictureTruth {
    /// `stereo` or `grid`.
    pub scene: PictureScene,
    /// File name of the mesh, or shape of the freeform.
    #[serde(rename = "thing")]
    pub object: String,
    /// Seed of the scene.
    pub seed: u64,
    /// Unit of every length.
    pub unit: String,
    /// Diagonal of the bounding box of the object.
    pub diagonal: f64,
    /// σ of the brightness of a pixel, on the scale from 0 to 255.
    pub sigma_brightness: f64,
    /// Contrast of the texture, from 0 to below 1.
    pub texture: f64,
    /// Focal length, in pixels.
    pub focal: f64,
    /// Poses of the cameras; of a stereo pair, the left one.
    pub poses: Vec<ViewPose>,
    /// Number of vertices of `truth.ply`.
    pub mesh_vertices: usize,
    /// Number of triangles of `truth.ply`.
    pub mesh_triangles: usize,
}

/// World-from-camera pose of a view.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewPose {
    /// Position of the camera.
    pub translation: DVec3,
    /// Rotation as a quaternion.
    pub quaternion_xyzw: [f64; 4],
}

/// The files written and their ground truth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PictureSceneSummary {
    /// All files: `job.toml`, `truth.ply`, then the others.
    pub files: Vec<PathBuf>,
    /// Contents of `truth.json`.
    pub truth: PictureTruth,
}

/// The object and the cameras around it.
struct Stage {
    mesh: TriangleMesh,
    search: MeshSearch,
    object: String,
    unit: Unit,
    diagonal: f64,
    middle: DVec3,
    /// Distance of the cameras from the middle.
    far: f64,
    up: DVec3,
    focal: f64,
    poses: Vec<Pose>,
    options: PictureSceneOptions,
}

/// Renders the images of a scene and writes its files, as `planish simulate scene stereo` and `grid` do.
///
/// # Errors
/// `Input` for options out of range; errors of reading the mesh and of writing; `Interrupted` on request,
/// before `job.toml` is written.
///
/// # Examples
/// ```
/// use planish_core::Silent;
/// use planish_simulate::{PictureScene, PictureSceneOptions, write_picture_scene};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let folder = tempfile::tempdir()?;
/// let options = PictureSceneOptions { views: 1, size: [96, 72], ..PictureSceneOptions::default() };
/// let summary = write_picture_scene(PictureScene::Stereo, &options, folder.path(), &Silent)?;
/// assert!(summary.files[0].ends_with("job.toml"));
/// assert!(folder.path().join("left-1.png").is_file());
/// # Ok(())
/// # }
/// ```
pub fn write_picture_scene(
    scene: PictureScene,
    options: &PictureSceneOptions,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<PictureSceneSummary> {
    sanity_check(options)?;
    make_folder(folder)?;
    let stage = Stage::new(options)?;
    let mut files = Vec::new();
    // All images are kept until the last one is rendered; see below. They have one byte per pixel.
    let mut pictures = Vec::new();
    for view in 0..options.views {
        let share = |k: f64| (view as f64 + k) / options.views as f64;
        for (k, name) in scene.pictures(view + 1).into_iter().enumerate() {
            // Rendering takes nearly all of the time, writing the rest.
            let (from, to) = (share(0.5 * k as f64), share(0.5 * (k + 1) as f64));
            let part = ProgressPart::new(progress, 0.95 * from, 0.95 * to);
            pictures.push((folder.join(name), stage.take(scene, view, k, &part)?));
        }
    }
    // Nothing is written before all images exist, so an interrupted run leaves the folder as it was.
    progress.check(WRITING_STAGE, 0.95)?;
    for (path, picture) in pictures {
        write_grey_png(&path, options.size[0], options.size[1], &picture)?;
        files.push(path);
    }
    let mut write = |name: &str, text: &str| {
        let path = folder.join(name);
        write_atomically(&path, |writer| writer.write_all(text.as_bytes()))?;
        files.push(path);
        Ok::<_, Error>(())
    };
    write(scene.calibration(), &stage.calibration(scene))?;
    let truth = stage.truth(scene);
    let text = serde_json::to_string_pretty(&truth)
        .map_err(|e| Error::io("truth.json: could not be written").with_source(e))?;
    write("truth.json", &format!("{text}\n"))?;
    for view in 0..options.views {
        write(&format!("view-{}.toml", view + 1), &stage.job(scene, view..view + 1))?;
    }
    write("job.toml", &stage.job(scene, 0..options.views))?;
    let path = folder.join("truth.ply");
    let columns = MeshColumns {
        points: &stage.mesh.positions,
        normals: Some(&stage.mesh.vertex_normals()),
        triangles: &stage.mesh.triangles,
        unit: Some(stage.unit),
        ..MeshColumns::default()
    };
    write_mesh(&path, &columns)?;
    files.push(path);
    // `job.toml` and `truth.ply` were written last, and come first in the summary.
    files.rotate_right(2);
    progress.advance("done", 1.0);
    Ok(PictureSceneSummary { files, truth })
}

fn sanity_check(options: &PictureSceneOptions) -> Result<()> {
    let [columns, rows] = options.size;
    if !(1..=360).contains(&options.views) || columns.min(rows) < 64 || columns.max(rows) > 8192 {
        return Err(Error::input(format!(
            "expected 1 to 360 views of 64 to 8192 pixels along each side, found {} views of {columns} × \
             {rows}",
            options.views
        )));
    }
    if !(0.0..1.0).contains(&options.texture) || !(0.0..=64.0).contains(&options.sigma_brightness) {
        return Err(Error::input(format!(
            "expected a texture from 0 to below 1 and a noise from 0 to 64, found {} and {}",
            options.texture, options.sigma_brightness
        )));
    }
    if options.subdivide > 5 || options.up > 2 {
        return Err(Error::input(format!(
            "expected at most 5 subdivisions and the axis 0, 1 or 2, found {} and {}",
            options.subdivide, options.up
        )));
    }
    if !(6.0..=200.0).contains(&options.stripe_spacing) {
        return Err(Error::input(format!(
            "expected stripes 6 to 200 pixels apart, found {}",
            options.stripe_spacing
        )));
    }
    Ok(())
}

impl Stage {
    fn new(options: &PictureSceneOptions) -> Result<Self> {
        let (mesh, object, unit) = match &options.mesh {
            None => {
                let size = SIZE_MM / options.unit.millimetres();
                let truth = Truth::freeform(options.shape, size, options.seed)?;
                // A triangle then covers about ten pixels of a default image, as small as the spots of
                // the texture.
                (truth.mesh(80_000).0, options.shape.name().to_owned(), options.unit)
            }
            Some(path) => {
                let read = read_mesh(path)?;
                let mut mesh = TriangleMesh::try_new(read.points, read.triangles)
                    .map_err(|e| e.in_context(path.display()))?;
                for _ in 0..options.subdivide {
                    mesh = mesh.subdivided().map_err(|e| e.in_context(path.display()))?;
                }
                let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
                (mesh, name, read.unit.unwrap_or(options.unit))
            }
        };
        let bounds = mesh
            .bounding_box()
            .ok_or_else(|| Error::undetermined("expected a mesh with vertices, found none"))?;
        let (diagonal, middle) = (positive("diagonal of the mesh", bounds.diagonal())?, bounds.center());
        // Relative to the diagonal: meshes of any size and unit fill the images alike.
        let far = DISTANCE * diagonal;
        let mut up = DVec3::ZERO;
        up[options.up] = 1.0;
        let poses = (0..options.views)
            .map(|view| {
                pose_on_ring(middle, far, up, TAU * view as f64 / options.views as f64, ELEVATION_DEG)
            })
            .collect::<Result<Vec<_>>>()?;
        // The calibration is written once, so all views need the same focal length: the largest with which
        // every view shows the whole object.
        let mut half = [0.0_f64; 2];
        for pose in &poses {
            let camera_from_world = pose.inverse();
            for p in &mesh.positions {
                let DVec3 { x, y, z } = camera_from_world.apply(*p);
                half = [half[0].max(x.abs() / z), half[1].max(y.abs() / z)];
            }
        }
        let focal =
            (0..2).map(|k| FILL_SHARE * 0.5 * options.size[k] as f64 / half[k]).fold(f64::INFINITY, f64::min);
        Ok(Self {
            search: MeshSearch::try_new(&mesh)?,
            mesh,
            object,
            unit,
            diagonal,
            middle,
            far,
            up,
            focal,
            poses,
            options: options.clone(),
        })
    }

    /// The principal point, in pixels.
    fn axis(&self) -> [f64; 2] {
        self.options.size.map(|n| 0.5 * (n as f64 - 1.0))
    }

    /// A camera at a pose whose principal point has the column `cx`.
    fn camera(&self, pose: &Pose, cx: f64) -> Pinhole {
        Pinhole::new([[self.focal, 0.0, cx], [0.0, self.focal, self.axis()[1]], [0.0, 0.0, 1.0]], pose)
    }

    fn baseline(&self) -> f64 {
        BASELINE * self.far
    }

    /// `cx` of the right camera minus that of the left.
    ///
    /// The farthest point of the object gets the minimum disparity: `d = f b / z − doffs`.
    fn doffs(&self) -> f64 {
        (self.focal * self.baseline() / (self.far + 0.5 * self.diagonal) - MIN_DISPARITY).round()
    }

    /// The projector of a view, on the same ring as the camera.
    fn projector(&self, view: usize) -> Result<Pinhole> {
        let turn = TAU * view as f64 / self.options.views as f64 + PROJECTOR_DEG.to_radians();
        let pose = pose_on_ring(self.middle, self.far, self.up, turn, ELEVATION_DEG)?;
        Ok(self.camera(&pose, self.axis()[0]))
    }

    /// Stripes that cover the object at its nearest point.
    fn pattern(&self) -> StripePattern {
        // The object is largest in the image of the projector where it is nearest to it.
        let half = self.focal * 0.5 * self.diagonal / (self.far - 0.5 * self.diagonal);
        // Rounded up: stripes beyond the object do no harm, but a part without stripes has no readings.
        let count = (half / self.options.stripe_spacing).ceil() as i32;
        StripePattern {
            directions_rad: STRIPES_DEG.map(f64::to_radians),
            spacing: self.options.stripe_spacing,
            origin: self.axis(),
            range: [[-count, count]; 2],
        }
    }

    /// Renders the first (0) or second (1) image of a view.
    fn take(
        &self,
        scene: PictureScene,
        view: usize,
        which: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<u8>> {
        let pose = &self.poses[view];
        let left = self.camera(pose, self.axis()[0]);
        let camera = match (scene, which) {
            (PictureScene::Stereo, 1) => {
                let to_the_right =
                    Pose { translation: pose.apply(DVec3::new(self.baseline(), 0.0, 0.0)), ..*pose };
                self.camera(&to_the_right, self.axis()[0] + self.doffs())
            }
            _ => left,
        };
        // Both images of a pair have the same lamp, above the left camera: matching compares brightness.
        let light = match (scene, which) {
            (PictureScene::Grid, 0) => Light::Stripes {
                projector: self.projector(view)?,
                pattern: self.pattern(),
                sigma_px: STRIPE_SIGMA_PX,
            },
            _ => Light::Lamp(left.center() + 0.3 * self.far * self.up),
        };
        let exposure = Exposure {
            camera: &camera,
            size: self.options.size,
            light: &light,
            texture: &Texture {
                contrast: self.options.texture,
                // A length at the distance of the object, so that spots have the same size in all images.
                grain: GRAIN_PX * self.far / self.focal,
                seed: self.options.seed,
            },
            sigma_brightness: self.options.sigma_brightness,
            // Every image has independent noise, those of the other scene of the same view included.
            seed: self.options.seed.wrapping_add(
                1 + 2 * view as u64 + which as u64 + if scene == PictureScene::Grid { 1 << 32 } else { 0 },
            ),
        };
        exposure.take(&self.search, &mut |share| progress.check("rendering images", share))
    }

    /// The text of the calibration file.
    fn calibration(&self, scene: PictureScene) -> String {
        let [cx, cy] = self.axis();
        let mut text = format!("# Exact: the pictures are simulated.\nunit = \"{}\"\n", self.unit);
        let _ = match scene {
            PictureScene::Stereo => write!(
                text,
                "f = {:?}\ncx = {cx:?}\ncy = {cy:?}\nbaseline = {:?}\ndoffs = {:?}\n",
                self.focal,
                self.baseline(),
                self.doffs()
            ),
            PictureScene::Grid => {
                let pattern = self.pattern();
                // The projector moves with the camera, so that the first view stands for all.
                let camera_from_world = self.poses[0].inverse();
                let projector = self.projector(0).map(|p| {
                    let world_from_projector = Pose { rotation: p.r, translation: p.t }.inverse();
                    camera_from_world.after(&world_from_projector).inverse()
                });
                let projector = projector.unwrap_or_default();
                let k = format!(
                    "[[{:?}, 0.0, {cx:?}], [0.0, {:?}, {cy:?}], [0.0, 0.0, 1.0]]",
                    self.focal, self.focal
                );
                write!(
                    text,
                    "sigma_px = 0.01\n\n[camera]\nK = {k}\n\n[projector]\nK = {k}\nR = {:?}\nt = \
                     {:?}\n\n[stripes]\ndirections_deg = {STRIPES_DEG:?}\nspacing = {:?}\norigin = \
                     {:?}\nrange = {:?}\n",
                    projector.rotation,
                    projector.translation.to_array(),
                    pattern.spacing,
                    pattern.origin,
                    pattern.range
                )
            }
        };
        text
    }

    /// The text of a job that fuses the files that `sense` writes for these views.
    fn job(&self, scene: PictureScene, views: std::ops::Range<usize>) -> String {
        let name = scene.name();
        let kind = match scene {
            PictureScene::Stereo => "stereo",
            // `sense grid` computes curvatures from the points, so a job must not use both as independent
            // readings (see `docs/decisions/0033-crossed-stripes.md`).
            PictureScene::Grid => "curvature",
        };
        let mut text = format!(
            "# Simulated views; the files are those that `planish sense {name}` writes.\nunit \
             = \"{}\"\n\n[sensor.{name}]\nkind = \"{kind}\"\n",
            self.unit
        );
        for view in views {
            let pose = self.poses[view];
            let _ = write!(
                text,
                "\n[[scan]]\nsensor = \"{name}\"\nfile = \"{name}-{}.ply\"\npose = {{ translation = {:?}, \
                 quaternion_xyzw = {:?} }}\nviewpoint = [0.0, 0.0, 0.0]\n",
                view + 1,
                pose.translation.to_array(),
                pose.quaternion_xyzw()
            );
        }
        text
    }

    /// The contents of `truth.json`.
    fn truth(&self, scene: PictureScene) -> PictureTruth {
        let pose = |p: &Pose| ViewPose { translation: p.translation, quaternion_xyzw: p.quaternion_xyzw() };
        PictureTruth {
            scene,
            object: self.object.clone(),
            seed: self.options.seed,
            unit: self.unit.name().to_owned(),
            diagonal: self.diagonal,
            sigma_brightness: self.options.sigma_brightness,
            texture: self.options.texture,
            focal: self.focal,
            poses: self.poses.iter().map(pose).collect(),
            mesh_vertices: self.mesh.positions.len(),
            mesh_triangles: self.mesh.triangles.len(),
        }
    }
}

/// Pose of a camera on a ring around the vertical axis that looks at `middle`: x right, y down, z forward.
fn pose_on_ring(middle: DVec3, far: f64, up: DVec3, turn: f64, elevation_deg: f64) -> Result<Pose> {
    let across = DVec3::new(up[1], up[2], up[0]);
    let third = up.cross(across);
    let (sin, cos) = elevation_deg.to_radians().sin_cos();
    // A cyclic shift of a coordinate axis is perpendicular to it, so `across`, `third` and `level` have
    // unit length.
    let level = turn.cos() * across + turn.sin() * third;
    let towards = cos * level + sin * up;
    let position = middle + far * towards;
    let z = -towards;
    let x = z
        .cross(up)
        .try_normalize()
        .ok_or_else(|| Error::input("the camera must not look along the vertical axis"))?;
    let y = z.cross(x);
    let exact = Pose { rotation: from_columns([x, y, z]), translation: position };
    // The job states the pose as a quaternion. Its rounded value is used for rendering, too, so that images
    // and job agree exactly.
    Pose::from_quaternion_xyzw(exact.quaternion_xyzw(), position)
        .ok_or_else(|| Error::input("the direction of view is undefined"))
}
