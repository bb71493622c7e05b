//! `planish simulate scene bending`.

use super::text::{ScanSceneBody, summary};
use crate::common::{CommonArgs, short_help};
use crate::summary::Summary;
use crate::values::{self, not_negative, positive};
use clap::{Args, ValueHint};
use planish::progress::Progress;
use planish::simulate::{BendingOptions, write_bending_scene};
use planish::{Result, Unit};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene bending --states 4 --out bending
  planish fit bending/job.toml --motion bend -o sheet.planish
  planish compare sheet.planish bending/truth.ply
  planish compare sheet.planish bending/truth.ply --part completed

The folder then has job.toml (with the time of each scan), a .ply file for each scan, truth.ply (the sheet \
at the last time), truth-1.ply and so on (at each time) and truth.json (the formulas). The last scan misses \
a disc of the sheet that the other scans show. With --stretch the sheet stretches, and `fit` reports it.";

/// Arguments of `planish simulate scene bending`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene bending --out bending"),
          after_long_help = EXAMPLES)]
pub struct BendingArgs {
    /// Output folder; it is created if necessary
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Approximate number of readings of all scans
    #[arg(long, value_name = "N", default_value_t = 40_000, value_parser = values::count,
          allow_negative_numbers = true)]
    readings: usize,
    /// Number of states of the sheet, one per second; the first is flat
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = values::count,
          allow_negative_numbers = true)]
    states: usize,
    /// Maximum relative stretch along the sheet, from 0 (pure bending) to 0.2
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = not_negative,
          allow_negative_numbers = true)]
    stretch: f64,
    /// True σ of the laser along its rays, in --unit; half of it across [default: 0.1 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    sigma: Option<f64>,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Simulates the scene.
pub fn work(args: &BendingArgs, progress: &dyn Progress) -> Result<Summary<ScanSceneBody>> {
    let options = BendingOptions {
        seed: args.common.seed,
        readings: args.readings,
        states: args.states,
        stretch: args.stretch,
        sigma: args.sigma,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
    };
    let made = write_bending_scene(&options, &args.out, progress)?;
    // The truth is the sheet at the last scan, which is also the model of `--motion bend`.
    Ok(summary(&args.out, made, options.unit, [" --motion bend", ""]))
}
