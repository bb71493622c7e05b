//! `planish simulate scene turning`.

use super::text::{ScanSceneBody, summary};
use crate::common::{CommonArgs, short_help};
use crate::summary::Summary;
use crate::values::{self, positive};
use clap::{Args, ValueHint};
use planish::progress::Progress;
use planish::simulate::{TurningOptions, write_turning_scene};
use planish::{Result, Unit};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene turning --views 6 --rate 6 --out turning
  planish fit turning/job.toml --motion rigid -o part.planish
  planish compare part.planish turning/truth.ply

The folder then has job.toml (with the time of each scan), a .ply file for each scan, truth.ply (the object \
at the first scan) and truth.json (axis and rate).";

/// Arguments of `planish simulate scene turning`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene turning --out turning"),
          after_long_help = EXAMPLES)]
pub struct TurningArgs {
    /// Output folder; it is created if necessary
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Approximate number of readings of all scans
    #[arg(long, value_name = "N", default_value_t = 60_000, value_parser = values::count,
          allow_negative_numbers = true)]
    readings: usize,
    /// Number of scans, one per second
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = values::count,
          allow_negative_numbers = true)]
    views: usize,
    /// Rotation rate of the turntable, in degrees per second
    #[arg(long, value_name = "DEG", default_value_t = 6.0, value_parser = positive,
          allow_negative_numbers = true)]
    rate: f64,
    /// True σ of the laser along its rays, in --unit; half of it across [default: 0.1 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    sigma: Option<f64>,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Simulates the scene.
pub fn work(args: &TurningArgs, progress: &dyn Progress) -> Result<Summary<ScanSceneBody>> {
    let options = TurningOptions {
        seed: args.common.seed,
        readings: args.readings,
        views: args.views,
        rate_deg_per_s: args.rate,
        sigma: args.sigma,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
    };
    let made = write_turning_scene(&options, &args.out, progress)?;
    // Without this option, `fit` would overlay the scans as if the object stood still.
    Ok(summary(&args.out, made, options.unit, [" --motion rigid", ""]))
}
