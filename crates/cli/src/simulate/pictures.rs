//! `planish simulate scene stereo` and `planish simulate scene grid`.

use super::SceneShape;
use crate::common::{CommonArgs, short_help};
use crate::lines::Lines;
use crate::numbers::{count, significant};
use crate::summary::Summary;
use crate::values::{self, not_negative, pixels, positive};
use clap::{Args, ValueEnum, ValueHint};
use planish::Finding;
use planish::finding::with_warnings;
use planish::progress::Progress;
use planish::simulate::{
    PictureScene, PictureSceneOptions, PictureSceneSummary, PictureTruth, write_picture_scene,
};
use planish::{Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene stereo --out scene --views 1 --size 640x480
  planish simulate scene grid --out stripes --shape tube --views 1 --size 640x480

The folder then has for each view the images (left-1.png and right-1.png, or stripes-1.png and plain-1.png) \
and view-1.toml, the job of this view alone. It also has the calibration (cameras.toml or grid.toml), \
truth.ply and truth.json. job.toml has the poses of stereo-1.ply or grid-1.ply and so on; write these files \
there with `planish sense`. Both scenes show the same object from the same views, so `planish fit \
scene/job.toml stripes/job.toml` fuses them.";

/// Arguments of `planish simulate scene stereo` and `grid`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene stereo --out scene --views 1 --size 640x480"),
          after_long_help = EXAMPLES)]
pub struct PictureArgs {
    /// Output folder; it is created if necessary
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,

    /// Object: a mesh or CAD faces (.step) [default: a freeform object of 100 mm]
    ///
    /// Formats of meshes: .ply, .obj, .stl, .off and .glb.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = "Scene")]
    mesh: Option<PathBuf>,
    /// Number of smooth (Loop) subdivisions of the mesh, from 0 to 5
    ///
    /// The subdivided mesh is the object, and truth.ply.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = values::count,
          allow_negative_numbers = true, requires = "mesh", help_heading = "Scene", hide_short_help = true)]
    subdivide: usize,
    /// Upward axis
    #[arg(long, value_name = "AXIS", value_enum, default_value_t = AxisArg::Z, help_heading = "Scene",
          hide_short_help = true)]
    up: AxisArg,
    /// Topology of the freeform object
    #[arg(long, value_name = "SHAPE", value_enum, default_value_t = SceneShape::Ball, conflicts_with = "mesh",
          help_heading = "Scene")]
    shape: SceneShape,
    /// Contrast of the object's texture, from 0 (uniform) to below 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.7, value_parser = not_negative,
          allow_negative_numbers = true, help_heading = "Scene", hide_short_help = true)]
    texture: f64,
    /// Number of views around the object
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = values::count,
          allow_negative_numbers = true, help_heading = "Cameras")]
    views: usize,
    /// Columns and rows of the images
    #[arg(long, value_name = "NxM", default_value = "960x720", value_parser = pixels,
          help_heading = "Cameras")]
    size: [usize; 2],
    /// σ of the brightness of a pixel, of 255
    #[arg(long, value_name = "GREYS", default_value_t = 1.0, value_parser = not_negative,
          allow_negative_numbers = true, help_heading = "Cameras", hide_short_help = true)]
    sigma_brightness: f64,
    /// With `grid`: distance of the stripes, in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 18.0, value_parser = positive,
          allow_negative_numbers = true, help_heading = "Cameras", hide_short_help = true)]
    stripe_spacing: f64,

    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

// The variants have no doc comments: the names are the axes, and a doc comment would become help.
/// Value of `--up`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum AxisArg {
    X,
    Y,
    Z,
}

/// JSON keys of the scenes.
#[derive(Serialize)]
pub struct PictureBody {
    truth: PictureTruth,
    #[serde(flatten, serialize_with = "with_warnings")]
    findings: Vec<Finding>,
    termination: &'static str,
}

/// Simulates the scene.
pub fn work(
    scene: PictureScene,
    args: &PictureArgs,
    progress: &dyn Progress,
) -> Result<Summary<PictureBody>> {
    let options = PictureSceneOptions {
        mesh: args.mesh.clone(),
        subdivide: args.subdivide,
        // The order of the variants is the order of the coordinates.
        up: args.up as usize,
        shape: args.shape.into(),
        views: args.views,
        size: args.size,
        texture: args.texture,
        sigma_brightness: args.sigma_brightness,
        stripe_spacing: args.stripe_spacing,
        seed: args.common.seed,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
    };
    let made = write_picture_scene(scene, &options, &args.out, progress)?;
    Ok(Summary {
        text: text(scene, args, &made),
        unit: made.truth.unit.parse().ok(),
        inputs: args.mesh.iter().cloned().collect(),
        outputs: made.files.clone(),
        findings: Vec::new(),
        body: PictureBody { truth: made.truth, findings: Vec::new(), termination: "converged" },
    })
}

fn text(scene: PictureScene, args: &PictureArgs, made: &PictureSceneSummary) -> String {
    let mut lines = Lines::default();
    let truth = &made.truth;
    lines.line(format!(
        "Rendered {} images of {} ({} long, {} triangles) from {} views.",
        count(2 * truth.poses.len()),
        truth.object,
        format_args!("{} {}", significant(truth.diagonal, 3), truth.unit),
        count(truth.mesh_triangles),
        count(truth.poses.len())
    ));
    lines.gap();
    lines.line(format!("Wrote {} files to {}. Next, for each view:", made.files.len(), args.out.display()));
    let at = |name: &str| args.out.join(name).display().to_string();
    let [first, second] = scene.pictures(1).map(|name| at(&name));
    let between = if scene == PictureScene::Grid { " --plain " } else { " " };
    // Disparities of neighbours have correlated errors. Points some pixels apart are nearly independent.
    let apart = if scene == PictureScene::Stereo { " --step 8" } else { "" };
    lines.line(format!(
        "  planish sense {} {first}{between}{second} --calib {}{apart} -o {}",
        scene.name(),
        at(scene.calibration()),
        at(&format!("{}-1.ply", scene.name()))
    ));
    // Stripes give only normals and curvatures; a fit also needs positions, such as those of stereo.
    let (then, other_job) = match scene {
        PictureScene::Stereo => ("and then:", ""),
        PictureScene::Grid => (
            "and then, with the positions of the same views from `simulate scene stereo --out stereo` and \
             `sense stereo`:",
            "stereo/job.toml ",
        ),
    };
    lines.line(then);
    lines.line(format!("  planish fit {other_job}{} -o part.planish", at("job.toml")));
    lines.line(format!("  planish compare part.planish {}", at("truth.ply")));
    lines.into_text()
}
