//! `planish simulate scene contours`.

use crate::common::{CommonArgs, short_help};
use crate::lines::Lines;
use crate::numbers::count;
use crate::summary::{self, Summary};
use crate::values::{self, positive};
use clap::{Args, ValueEnum, ValueHint};
use planish::Finding;
use planish::finding::with_warnings;
use planish::simulate::{ContoursOptions, ContoursShape, write_contours_scene};
use planish::{Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene contours --out hyperboloid
  planish simulate scene contours --shape carafe --sigma-px 0.1 --views 61 --out carafe

The folder then has motion-1.toml and motion-2.toml with a mask and measured contours for each view, \
truth.ply and truth.json. Each motion sees the left and right side of the object. The result is four \
overlapping patches that cover all sides.";

// The variants have no doc comments: the names are the shapes, and a doc comment would become help.
/// Value of `--shape`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ContoursShapeName {
    Hyperboloid,
    Carafe,
}

/// Arguments of `planish simulate scene contours`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene contours --out hyperboloid"),
          after_long_help = EXAMPLES)]
pub struct ContoursSceneArgs {
    /// Output folder; it is created if necessary
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Object
    #[arg(long, value_name = "SHAPE", value_enum, default_value_t = ContoursShapeName::Hyperboloid)]
    shape: ContoursShapeName,
    /// Number of views of each motion, over 120°
    #[arg(long, value_name = "N", default_value_t = 41, value_parser = values::count,
          allow_negative_numbers = true)]
    views: usize,
    /// σ of contour points, along both axes of the image
    #[arg(long, value_name = "PIXELS", default_value_t = 0.2, value_parser = positive,
          allow_negative_numbers = true)]
    sigma_px: f64,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// JSON keys of the scene.
#[derive(Serialize)]
struct SceneBody {
    rows: usize,
    columns: [&'static str; 4],
    #[serde(flatten, serialize_with = "with_warnings")]
    findings: Vec<Finding>,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ContoursSceneArgs) -> u8 {
    // Nothing is rendered, so there is no progress to report.
    summary::run("simulate scene contours", &args.common, |_| work(args))
}

fn work(args: &ContoursSceneArgs) -> Result<Summary<SceneBody>> {
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
        "Simulated the contours of two motions with {} views each: {} points.",
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
    // Each motion sees two sides of the object, so `sense contours` writes two patches for it.
    let patches: Vec<String> = ["1.1", "1.2", "2.1", "2.2"].map(|k| at(&format!("patch-{k}.ply"))).to_vec();
    lines.line(format!("  planish merge {} -o {}", patches.join(" "), at("whole.ply")));
    lines.line(format!("  planish compare {} {}", at("whole.ply"), at("truth.ply")));
    Ok(Summary {
        text: lines.into_text(),
        unit: Some(options.unit),
        inputs: Vec::new(),
        outputs: made.files,
        findings: Vec::new(),
        body: SceneBody {
            rows: made.places,
            columns: ["x", "y", "sigma_px", "contour"],
            findings: Vec::new(),
            termination: "converged",
        },
    })
}
