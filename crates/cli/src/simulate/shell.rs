//! `planish simulate scene shell`.

use crate::common::{CommonArgs, short_help};
use crate::lines::Lines;
use crate::numbers::count;
use crate::summary::{self, Summary};
use crate::values::{self, positive, share};
use clap::{Args, ValueHint};
use planish::Finding;
use planish::finding::with_warnings;
use planish::simulate::{ShellSceneOptions, write_shell_scene};
use planish::{Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene shell --out bent
  planish simulate scene shell --mesh head.obj --controls 40 --points 20000 --views 8 --out bent

The folder then has mesh.obj (at rest), points.ply with σ, views.toml with a mask for each view, truth.ply \
(the deformed mesh) and truth.json (controls and their displacements).";

/// Arguments of `planish simulate scene shell`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene shell --out bent"), after_long_help = EXAMPLES)]
pub struct ShellSceneArgs {
    /// Output folder; it is created if necessary
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Mesh to deform [default: a ball of 100 mm]
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    mesh: Option<PathBuf>,
    /// Number of controls, chosen on the mesh
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = values::count,
          allow_negative_numbers = true)]
    controls: usize,
    /// σ of the displacements of the controls, as a share of the mesh's size
    #[arg(long, value_name = "SHARE", default_value_t = 0.03, value_parser = positive,
          allow_negative_numbers = true)]
    deformation: f64,
    /// Number of points
    #[arg(long, value_name = "N", default_value_t = 20_000, value_parser = values::count,
          allow_negative_numbers = true)]
    points: usize,
    /// σ of the points, as a share of the mesh's size
    #[arg(long, value_name = "SHARE", default_value_t = 0.002, value_parser = positive,
          allow_negative_numbers = true)]
    noise: f64,
    /// Share of points that are outliers at random positions
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, value_parser = share,
          allow_negative_numbers = true)]
    outliers: f64,
    /// Number of views around the object, each with a mask
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = values::count,
          allow_negative_numbers = true)]
    views: usize,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// JSON keys of the scene.
#[derive(Serialize)]
struct Body {
    rows: usize,
    columns: [&'static str; 4],
    controls: usize,
    #[serde(flatten, serialize_with = "with_warnings")]
    findings: Vec<Finding>,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ShellSceneArgs) -> u8 {
    summary::run("simulate scene shell", &args.common, |_| work(args))
}

fn work(args: &ShellSceneArgs) -> Result<Summary<Body>> {
    let made = write_shell_scene(
        &ShellSceneOptions {
            mesh: args.mesh.clone(),
            controls: args.controls,
            deformation: args.deformation,
            points: args.points,
            noise: args.noise,
            outliers: args.outliers,
            views: args.views,
            seed: args.common.seed,
            // The default ball is 100 mm large, so without an option its unit is the millimetre.
            unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
        },
        &args.out,
    )?;
    let mut lines = Lines::default();
    lines.line(format!(
        "Deformed a mesh with {} controls: {} points and masks of {} views.",
        count(made.controls),
        count(made.points),
        count(args.views)
    ));
    lines.gap();
    lines.line(format!("Wrote {} files to {}.", made.files.len(), args.out.display()));
    Ok(Summary {
        text: lines.into_text(),
        // The unit of the given mesh counts, which only the scene knows.
        unit: Some(made.unit),
        inputs: args.mesh.clone().into_iter().collect(),
        outputs: made.files,
        findings: Vec::new(),
        body: Body {
            rows: made.points,
            // The columns of points.ply, so that a program knows them without reading the file.
            columns: ["x", "y", "z", "sigma"],
            controls: made.controls,
            findings: Vec::new(),
            termination: "converged",
        },
    })
}
