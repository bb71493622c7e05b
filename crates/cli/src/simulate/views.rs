//! `planish simulate scene views`.

use super::readings::{ReadingsBody, readings_summary};
use crate::common::{CommonArgs, short_help};
use crate::lines::Lines;
use crate::numbers::count;
use crate::summary::{self, Summary};
use crate::values::{self, positive};
use clap::{Args, ValueHint};
use planish::simulate::{ViewsOptions, write_views_scene};
use planish::{Result, Unit};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene views --out prism
  planish contour prism/front/readings.csv -o front.json
  planish solid front.json top.json side.json -o prism.step -o prism.json

The folders front, top and side then have readings.csv, exact.csv (the same without errors) and truth.json \
(as contour.json). The upper truth.json has the vertices of the prism. The prism is 80 mm wide (x), 100 mm \
deep (y) and 60 mm high (z), with its right angle at the origin: figure 3 of Weiss-Cohen, Bondarenko and \
Halevi 2009. The sensor is 300 mm away; σ is 0.2 mm for its position, 0.2° for its heading and 0.1 % for \
ranges.";

/// Arguments of `planish simulate scene views`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene views --out prism"), after_long_help = EXAMPLES)]
pub struct ViewsArgs {
    /// Output folder; it is created if necessary
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Number of readings of each view
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = values::count,
          allow_negative_numbers = true)]
    readings: usize,
    /// Number of readings from each pose; they share the error of the pose
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = values::count,
          allow_negative_numbers = true)]
    sweep: usize,
    /// Factor on the default σ
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = positive,
          allow_negative_numbers = true)]
    noise: f64,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ViewsArgs) -> u8 {
    summary::run("simulate scene views", &args.common, |_| work(args))
}

fn work(args: &ViewsArgs) -> Result<Summary<ReadingsBody>> {
    let unit = args.common.unit.map_or(Unit::Millimetre, Unit::from);
    let options = ViewsOptions {
        readings: args.readings,
        sweep: args.sweep,
        noise: args.noise,
        seed: args.common.seed,
        unit,
    };
    let made = write_views_scene(&options, &args.out)?;
    let mut lines = Lines::default();
    lines.line(format!("Simulated {} readings of a prism in three views.", count(made.rows)));
    lines.gap();
    lines.line(format!(
        "Wrote {} files to {}. Next, for front, top and side:",
        made.files.len(),
        args.out.display()
    ));
    lines.line(format!(
        "  planish contour {} --constrain -o front.json",
        // With `--constrain`, the contour file has the constraints; otherwise `solid` has to find them.
        args.out.join("front/readings.csv").display()
    ));
    // One command for three views: the solid needs the constrained contours of all of them.
    lines.line("  planish solid front.json top.json side.json -o prism.step -o prism.json");
    Ok(readings_summary(made, unit, lines))
}
