//! The scenes `stereo` and `grid`: pictures of a textured object from several views, and the truth.
//!
//! Input: [`PictureSceneOptions`]: a mesh, or a built-in freeform. Output: a folder with pictures of
//! every view, the calibration that `planish sense` reads, `job.toml` with the poses for what `sense` will
//! write, the same for each view alone (`view-1.toml`), `truth.ply` and `truth.json`.
//!
//! Views stand around the object on a ring, 20° above its equator. Both scenes have the same cameras, so that
//! their results belong together: the camera of the stripes is the left one of the pair.
//!
//! Not guaranteed: that all of a surface is seen.

use super::render::{Exposure, Light, Texture};
use super::truth::{Truth, positive};
use planish_core::Pinhole;
use planish_core::{Progress, ProgressPart, WRITING_STAGE};
use planish_estimate::vector3::{add_scaled, cross, scale, unit};
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
/// Distance of cameras to the object's middle, over its diagonal.
const DISTANCE: f64 = 2.2;
/// Height of the ring of views.
const ELEVATION_DEG: f64 = 20.0;
/// Distance of the two cameras of a pair, over that to the object.
const BASELINE: f64 = 0.12;
/// The least disparity, in pixels.
const LEAST_DISPARITY: f64 = 8.0;
/// The angle between camera and projector, seen from the object.
const PROJECTOR_DEG: f64 = 25.0;
/// Directions of the stripes. Neither whole shifts of the pattern nor quarter turns of it put crossings on
/// the lines of others, as 45° would.
const STRIPES_DEG: [f64; 2] = [35.0, 125.0];
/// σ of a stripe's profile, in pixels of the projector.
const STRIPE_SIGMA_PX: f64 = 1.8;
/// The finest spots of the texture, in pixels.
const GRAIN_PX: f64 = 3.0;
/// Share of the picture that the object takes.
const FILLED: f64 = 0.94;

/// Settings of the scenes `stereo` and `grid`.
#[derive(Debug, Clone, PartialEq)]
pub struct PictureSceneOptions {
    /// The object; a freeform if none is given.
    pub mesh: Option<PathBuf>,
    /// Steps of smooth subdivision of the mesh: what is seen and what is true is the finer one.
    pub subdivide: usize,
    /// The axis that stands upright: 0, 1 or 2.
    pub up: usize,
    /// Topology of the freeform.
    pub shape: Shape,
    /// Views around the object.
    pub views: usize,
    /// Columns and rows of the pictures.
    pub size: [usize; 2],
    /// Contrast of the texture, from 0 (plain) to below 1.
    pub texture: f64,
    /// σ of a pixel's brightness, of 255.
    pub sigma_brightness: f64,
    /// Distance of the stripes, in pixels.
    pub stripe_spacing: f64,
    /// Seed of the freeform, the texture and all noise.
    pub seed: u64,
    /// The unit of a freeform, and of a mesh whose file names none.
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

/// Which pictures are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PictureScene {
    /// Rectified pairs under a lamp.
    Stereo,
    /// Crossed stripes, and the same view under a lamp.
    Grid,
}

impl PictureScene {
    /// Its name on the command line, and the stem of what `sense` is to write.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Stereo => "stereo",
            Self::Grid => "grid",
        }
    }

    /// The calibration's file.
    #[must_use]
    pub fn calibration(self) -> &'static str {
        match self {
            Self::Stereo => "cameras.toml",
            Self::Grid => "grid.toml",
        }
    }

    /// The pictures of a view, as `sense` takes them.
    #[must_use]
    pub fn pictures(self, view: usize) -> [String; 2] {
        match self {
            Self::Stereo => ["left", "right"],
            Self::Grid => ["stripes", "plain"],
        }
        .map(|stem| format!("{stem}-{view}.png"))
    }
}

/// What `truth.json` says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PictureTruth {
    /// `stereo` or `grid`.
    pub scene: PictureScene,
    /// The mesh or the freeform.
    pub thing: String,
    /// Seed of the scene.
    pub seed: u64,
    /// Unit of every length.
    pub unit: String,
    /// Diagonal of the box about the object.
    pub diagonal: f64,
    /// σ of a pixel's brightness, of 255.
    pub sigma_brightness: f64,
    /// Contrast of the texture.
    pub texture: f64,
    /// Focal length, in pixels.
    pub focal: f64,
    /// Poses of the cameras.
    pub poses: Vec<ViewPose>,
    /// Vertices of `truth.ply`.
    pub mesh_vertices: usize,
    /// Triangles of `truth.ply`.
    pub mesh_triangles: usize,
}

/// Carries a camera's frame into the world.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewPose {
    /// Its place.
    pub translation: [f64; 3],
    /// Its rotation.
    pub quaternion_xyzw: [f64; 4],
}

/// Files that were written.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PictureSceneSummary {
    /// Every file, the job first.
    pub files: Vec<PathBuf>,
    /// What is true of them.
    pub truth: PictureTruth,
}

/// The object and the cameras around it.
struct Stage {
    mesh: TriangleMesh,
    search: MeshSearch,
    thing: String,
    unit: Unit,
    diagonal: f64,
    middle: [f64; 3],
    /// From the middle to the cameras.
    far: f64,
    up: [f64; 3],
    focal: f64,
    poses: Vec<Pose>,
    options: PictureSceneOptions,
}

/// Takes the pictures of a scene and writes them: what `planish simulate scene stereo` and `grid` do.
///
/// # Errors
/// `Input` for options that make no sense; what reading the mesh and writing report; `Interrupted` on
/// request, before `job.toml` is written.
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
    let mut pictures = Vec::new();
    for view in 0..options.views {
        let share = |k: f64| (view as f64 + k) / options.views as f64;
        for (k, name) in scene.pictures(view + 1).into_iter().enumerate() {
            let (from, to) = (share(0.5 * k as f64), share(0.5 * (k + 1) as f64));
            let part = ProgressPart::new(progress, 0.95 * from, 0.95 * to);
            pictures.push((folder.join(name), stage.take(scene, view, k, &part)?));
        }
    }
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
    files.rotate_right(2);
    progress.advance("done", 1.0);
    Ok(PictureSceneSummary { files, truth })
}

fn sanity_check(options: &PictureSceneOptions) -> Result<()> {
    let [columns, rows] = options.size;
    if !(1..=360).contains(&options.views) || columns.min(rows) < 64 || columns.max(rows) > 8192 {
        return Err(Error::input(format!(
            "needed 1 to 360 views of 64 to 8192 pixels along each side, found {} views of {columns} × \
             {rows}",
            options.views
        )));
    }
    if !(0.0..1.0).contains(&options.texture) || !(0.0..=64.0).contains(&options.sigma_brightness) {
        return Err(Error::input(format!(
            "needed a texture from 0 to below 1 and a noise from 0 to 64, found {} and {}",
            options.texture, options.sigma_brightness
        )));
    }
    if options.subdivide > 5 || options.up > 2 {
        return Err(Error::input(format!(
            "needed at most 5 subdivisions and the axis 0, 1 or 2, found {} and {}",
            options.subdivide, options.up
        )));
    }
    if !(6.0..=200.0).contains(&options.stripe_spacing) {
        return Err(Error::input(format!(
            "needed stripes 6 to 200 pixels apart, found {}",
            options.stripe_spacing
        )));
    }
    Ok(())
}

impl Stage {
    fn new(options: &PictureSceneOptions) -> Result<Self> {
        let (mesh, thing, unit) = match &options.mesh {
            None => {
                let size = SIZE_MM / options.unit.millimetres();
                let truth = Truth::freeform(options.shape, size, options.seed)?;
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
        let bounds =
            mesh.bounding_box().ok_or_else(|| Error::undetermined("a mesh without points cannot be seen"))?;
        let (diagonal, middle) = (positive("diagonal of the mesh", bounds.diagonal())?, bounds.center());
        let far = DISTANCE * diagonal;
        let mut up = [0.0; 3];
        up[options.up] = 1.0;
        let poses = (0..options.views)
            .map(|view| {
                pose_on_ring(middle, far, up, TAU * view as f64 / options.views as f64, ELEVATION_DEG)
            })
            .collect::<Result<Vec<_>>>()?;
        // One focal length for all views.
        let mut half = [0.0_f64; 2];
        for pose in &poses {
            let camera_from_world = pose.inverse();
            for p in &mesh.positions {
                let [x, y, z] = camera_from_world.apply(*p);
                half = [half[0].max(x.abs() / z), half[1].max(y.abs() / z)];
            }
        }
        let focal =
            (0..2).map(|k| FILLED * 0.5 * options.size[k] as f64 / half[k]).fold(f64::INFINITY, f64::min);
        Ok(Self {
            search: MeshSearch::try_new(&mesh)?,
            mesh,
            thing,
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

    /// The pixel on the axis.
    fn axis(&self) -> [f64; 2] {
        self.options.size.map(|n| 0.5 * (n as f64 - 1.0))
    }

    fn camera(&self, pose: &Pose, cx: f64) -> Pinhole {
        Pinhole::new([[self.focal, 0.0, cx], [0.0, self.focal, self.axis()[1]], [0.0, 0.0, 1.0]], pose)
    }

    fn baseline(&self) -> f64 {
        BASELINE * self.far
    }

    /// `cx` of the right camera less that of the left: such that the farthest of the object has the least
    /// disparity.
    fn doffs(&self) -> f64 {
        (self.focal * self.baseline() / (self.far + 0.5 * self.diagonal) - LEAST_DISPARITY).round()
    }

    /// The projector of a view, beside the camera.
    fn projector(&self, view: usize) -> Result<Pinhole> {
        let turn = TAU * view as f64 / self.options.views as f64 + PROJECTOR_DEG.to_radians();
        let pose = pose_on_ring(self.middle, self.far, self.up, turn, ELEVATION_DEG)?;
        Ok(self.camera(&pose, self.axis()[0]))
    }

    fn pattern(&self) -> StripePattern {
        let half = self.focal * 0.5 * self.diagonal / (self.far - 0.5 * self.diagonal);
        let count = (half / self.options.stripe_spacing).ceil() as i32;
        StripePattern {
            directions_rad: STRIPES_DEG.map(f64::to_radians),
            spacing: self.options.stripe_spacing,
            origin: self.axis(),
            range: [[-count, count]; 2],
        }
    }

    /// The first or the second picture of a view.
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
                let to_the_right = Pose { translation: pose.apply([self.baseline(), 0.0, 0.0]), ..*pose };
                self.camera(&to_the_right, self.axis()[0] + self.doffs())
            }
            _ => left,
        };
        // Above the left camera, so that both pictures of a pair are lit alike.
        let light = match (scene, which) {
            (PictureScene::Grid, 0) => Light::Stripes {
                projector: self.projector(view)?,
                pattern: self.pattern(),
                sigma_px: STRIPE_SIGMA_PX,
            },
            _ => Light::Lamp(add_scaled(left.center(), 0.3 * self.far, self.up)),
        };
        let exposure = Exposure {
            camera: &camera,
            size: self.options.size,
            light: &light,
            texture: &Texture {
                contrast: self.options.texture,
                grain: GRAIN_PX * self.far / self.focal,
                seed: self.options.seed,
            },
            sigma_brightness: self.options.sigma_brightness,
            // Every picture has noise of its own.
            seed: self.options.seed.wrapping_add(
                1 + 2 * view as u64 + which as u64 + if scene == PictureScene::Grid { 1 << 32 } else { 0 },
            ),
        };
        exposure.take(&self.search, &mut |share| progress.check("taking pictures", share))
    }

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
                // All views have the same projector, seen from the camera.
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
                    projector.rotation, projector.translation, pattern.spacing, pattern.origin, pattern.range
                )
            }
        };
        text
    }

    /// The job that fuses what `sense` makes of some of the views.
    fn job(&self, scene: PictureScene, views: std::ops::Range<usize>) -> String {
        let name = scene.name();
        let kind = match scene {
            PictureScene::Stereo => "stereo",
            // Its curvatures are made of its points: both together would count the same light twice.
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
                pose.translation,
                pose.quaternion_xyzw()
            );
        }
        text
    }

    fn truth(&self, scene: PictureScene) -> PictureTruth {
        let pose = |p: &Pose| ViewPose { translation: p.translation, quaternion_xyzw: p.quaternion_xyzw() };
        PictureTruth {
            scene,
            thing: self.thing.clone(),
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

/// A camera on a ring about the upright axis that looks at the middle: x right, y down, z forward.
fn pose_on_ring(middle: [f64; 3], far: f64, up: [f64; 3], turn: f64, elevation_deg: f64) -> Result<Pose> {
    let across = [up[1], up[2], up[0]];
    let third = cross(up, across);
    let (sin, cos) = elevation_deg.to_radians().sin_cos();
    let level = add_scaled(scale(turn.cos(), across), turn.sin(), third);
    let towards = add_scaled(scale(cos, level), sin, up);
    let position = add_scaled(middle, far, towards);
    let z = scale(-1.0, towards);
    let x = unit(cross(z, up)).ok_or_else(|| Error::input("a view from straight above"))?;
    let y = cross(z, x);
    let exact = Pose { rotation: [0, 1, 2].map(|k| [x[k], y[k], z[k]]), translation: position };
    // The pose of the quaternion as it is written, so that pictures and job agree.
    Pose::from_quaternion_xyzw(exact.quaternion_xyzw(), position)
        .ok_or_else(|| Error::input("a view without a direction"))
}
