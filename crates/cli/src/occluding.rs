//! `planish sense contours` and `planish simulate scene contours`.

use crate::args::{CommonArgs, positive, whole};
use crate::numbers::{count, percent, significant};
use crate::report::{self, Align, Lines, Summary};
use clap::{Args, ValueEnum, ValueHint};
use planish::Job;
use planish::occluding::{OccludingJob, OccludingOptions, OccludingReport};
use planish::progress::Progress;
use planish::simulate::{ContoursOptions, ContoursShape, write_contours_scene};
use planish::{Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish sense contours views.toml -o points.ply
  planish sense contours views.toml --patch patch.ply --patch patch.planish --hull hull.ply --json

views.toml holds [[view]] in the order in which the camera took them, each with a mask (or contours, a CSV of x,y,sigma_px,contour), and K R t or P; \
a view with held_out = true only judges. A place of a contour is matched in the views before and after it along epipolar planes, and the circle that all three \
lines of sight touch tells its depth; its normal needs none. What contradicts itself, and what the camera's motion leaves open, is counted and left out. \
Points of neighbouring views that hang together are a strip, and --patch makes a surface of each, patch.1.ply, patch.2.ply and so on: meshes that join contours of consecutive views, with σ, as `planish merge` takes them; \
a sheet is fitted where a spline (.planish, .step) is asked for.";

/// Arguments of `planish sense contours`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct OccludingArgs {
    /// Views with masks or contours, and cameras
    #[arg(value_name = "VIEWS.toml", value_hint = ValueHint::FilePath)]
    pub views: PathBuf,
    /// Write points with covariance and normals (.ply); may be repeated
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Write a patch of each strip, numbered before the extension (.ply with σ and `observed`, .planish,
    /// .step, .glb, .obj, .stl); may be repeated
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub patch: Vec<PathBuf>,
    /// Write the visual hull of the masks (.ply, .glb, .obj, .stl)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub hull: Option<PathBuf>,
    /// Compare the outlines of this mesh, and of the hull, with every mask
    #[arg(long, value_name = "MESH", value_hint = ValueHint::FilePath)]
    pub judge: Option<PathBuf>,
    /// Strips of fewer points make no patch
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = whole, allow_negative_numbers = true)]
    pub least_points: usize,
    /// Half the width of the window in which place and tangent of a contour are told, in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 6.0, value_parser = positive, allow_negative_numbers = true)]
    pub window: f64,
    /// Contours nearer to their epipolar line than this are frontier points, in degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 15.0, value_parser = positive, allow_negative_numbers = true)]
    pub frontier: f64,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// The keys of `sense contours` beside the common ones.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: OccludingReport,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &OccludingArgs) -> u8 {
    report::run("sense contours", &args.common, |progress| work(args, progress))
}

fn work(args: &OccludingArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let job = OccludingJob {
        views: args.views.clone(),
        outputs: args.output.clone(),
        patches: args.patch.clone(),
        least_points: args.least_points,
        hull: args.hull.clone(),
        judged: args.judge.clone(),
        options: OccludingOptions {
            half_window_px: args.window,
            frontier_deg: args.frontier,
            ..OccludingOptions::default()
        },
        unit: args.common.unit.map(Unit::from),
        seed: args.common.seed,
    };
    let done = job.run(progress)?;
    let patches = done.patches.iter().flat_map(|p| &p.files).map(|w| w.file.clone());
    Ok(Summary {
        text: text(&done),
        unit: done.unit,
        inputs: done.inputs.clone(),
        outputs: done.written.iter().cloned().chain(patches).collect(),
        warnings: done.warnings.clone(),
        body: Body { report: done, termination: "converged" },
    })
}

fn text(done: &OccludingReport) -> String {
    let mut lines = Lines::default();
    lines.line(format!(
        "Sensed {} points of {} places along the contours of {} views ({}).",
        count(done.observations),
        count(done.contour_points),
        count(done.views),
        percent(done.observations as f64 / done.contour_points.max(1) as f64)
    ));
    lines.gap();
    let unit = done.unit.map_or("", Unit::name);
    let left_out: Vec<String> = (done.left_out.iter())
        .map(|(cause, n)| format!("{} {}", count(*n), cause.replace('_', "-")))
        .collect();
    let pairs = (done.sequences > 1).then(|| format!("{} sequences of views", count(done.sequences)));
    lines.facts([
        ("left out", left_out.join(", ")),
        ("views", pairs.unwrap_or_default()),
        ("contours", format!("reduced χ² {:.3} about their parabolas", done.chi2)),
        ("σ of depths", report::sigma_quantiles(done.sigma_depth, unit)),
        ("of which circles leave out", report::sigma_quantiles(done.sigma_circle, unit)),
        ("σ along normals", report::sigma_quantiles(done.sigma, unit)),
        ("σ of normals", report::sigma_quantiles(done.sigma_n_deg, "°")),
        (
            "unseen",
            done.unseen_share.map_or(String::new(), |share| {
                format!(
                    "{} of the visual hull's surface, where no contour is near: hollow, or between views",
                    percent(share)
                )
            }),
        ),
    ]);
    if !done.patches.is_empty() {
        lines.gap();
        let rows: Vec<Vec<String>> = (done.patches.iter())
            .enumerate()
            .map(|(k, p)| {
                vec![
                    (k + 1).to_string(),
                    count(p.points),
                    count(p.views),
                    significant(p.sigma, 3),
                    significant(p.area, 4),
                    percent(p.left_out_share),
                ]
            })
            .collect();
        lines.table(
            &[
                ("patch", Align::Right),
                ("points", Align::Right),
                ("views", Align::Right),
                (&format!("σ / {unit}"), Align::Right),
                ("area", Align::Right),
                ("left out inside", Align::Right),
            ],
            &rows,
        );
    }
    if !done.iou.is_empty() {
        lines.gap();
        let share = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.4}"));
        let rows: Vec<Vec<String>> = (done.iou.iter())
            .map(|row| {
                let held = if row.held_out { "held out" } else { "" };
                vec![row.view.clone(), held.to_owned(), share(row.hull), share(row.judged)]
            })
            .collect();
        lines.table(
            &[
                ("view", Align::Left),
                ("", Align::Left),
                ("IoU of the hull", Align::Right),
                ("of the judged", Align::Right),
            ],
            &rows,
        );
    }
    lines.gap();
    for file in done.written.iter().chain(done.patches.iter().flat_map(|p| p.files.iter().map(|w| &w.file))) {
        lines.line(format!("Wrote {}.", file.display()));
    }
    lines.into_text()
}

const SCENE_EXAMPLES: &str = "\
Examples:
  planish simulate scene contours --out hyperboloid
  planish simulate scene contours --shape carafe --sigma-px 0.1 --views 61 --out carafe

The folder then holds motion-1.toml and motion-2.toml with a mask and measured contours for each view, truth.ply and truth.json. \
Each motion sees the thing's left and right side: four patches, which overlap all around.";

/// What is seen.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; the names are the shapes")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ContoursShapeName {
    Hyperboloid,
    Carafe,
}

/// Arguments of `planish simulate scene contours`.
#[derive(Debug, Args)]
#[command(after_help = SCENE_EXAMPLES)]
pub struct ContoursSceneArgs {
    /// Folder to write to; made where it is missing
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// The thing
    #[arg(long, value_name = "SHAPE", value_enum, default_value_t = ContoursShapeName::Hyperboloid)]
    pub shape: ContoursShapeName,
    /// Views of each motion, over 120 degrees
    #[arg(long, value_name = "N", default_value_t = 41, value_parser = whole, allow_negative_numbers = true)]
    pub views: usize,
    /// σ of each place of a contour, along both axes of the picture
    #[arg(long, value_name = "PIXELS", default_value_t = 0.2, value_parser = positive, allow_negative_numbers = true)]
    pub sigma_px: f64,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// The keys of the scene beside the common ones.
#[derive(Serialize)]
struct SceneBody {
    rows: usize,
    columns: [&'static str; 4],
    warnings: [String; 0],
    termination: &'static str,
}

/// Runs the scene; returns the exit code.
pub fn run_scene(args: &ContoursSceneArgs) -> u8 {
    report::run("simulate scene contours", &args.common, |_| scene(args))
}

fn scene(args: &ContoursSceneArgs) -> Result<Summary<SceneBody>> {
    let options = ContoursOptions {
        shape: match args.shape {
            ContoursShapeName::Hyperboloid => ContoursShape::Hyperboloid,
            ContoursShapeName::Carafe => ContoursShape::Carafe,
        },
        views: args.views,
        sigma_px: args.sigma_px,
        seed: args.common.seed,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
    };
    let made = write_contours_scene(&options, &args.out)?;
    let mut lines = Lines::default();
    lines.line(format!(
        "Took the contours of two motions with {} views each: {} places.",
        count(args.views),
        count(made.places)
    ));
    lines.gap();
    lines.line(format!("Wrote {} files to {}. Next:", count(made.files.len()), args.out.display()));
    let at = |name: &str| args.out.join(name).display().to_string();
    for motion in 1..=made.views.len() {
        lines.line(format!(
            "  planish sense contours {} -o {} --patch {}",
            at(&format!("motion-{motion}.toml")),
            at(&format!("points-{motion}.ply")),
            at(&format!("patch-{motion}.ply"))
        ));
    }
    let patches: Vec<String> = ["1.1", "1.2", "2.1", "2.2"].map(|k| at(&format!("patch-{k}.ply"))).to_vec();
    lines.line(format!("  planish merge {} -o {}", patches.join(" "), at("whole.ply")));
    lines.line(format!("  planish compare {} {}", at("whole.ply"), at("truth.ply")));
    Ok(Summary {
        text: lines.into_text(),
        unit: Some(options.unit),
        inputs: Vec::new(),
        outputs: made.files,
        warnings: Vec::new(),
        body: SceneBody {
            rows: made.places,
            columns: ["x", "y", "sigma_px", "contour"],
            warnings: [],
            termination: "converged",
        },
    })
}
