//! `planish simulate scene vessel`.

use super::text::{ScanSceneBody, summary};
use crate::common::{CommonArgs, short_help};
use crate::summary::Summary;
use crate::values::{self, positive};
use clap::{Args, ValueHint};
use planish::progress::Progress;
use planish::simulate::{VesselOptions, write_vessel_scene};
use planish::{Result, Unit};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene vessel --readings 20000 --out vessel
  planish fit vessel/job.toml --symmetry rotation:full -o vessel.planish
  planish compare vessel.planish vessel/truth.ply --part completed

The folder then has job.toml (for `planish fit`), laser-1.ply, truth.ply (a mesh of the whole vessel, for \
`planish compare`) and truth.json.";

/// Arguments of `planish simulate scene vessel`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene vessel --out vessel"), after_long_help = EXAMPLES)]
pub struct VesselArgs {
    /// Output folder; it is created if necessary
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Approximate number of readings
    #[arg(long, value_name = "N", default_value_t = 30_000, value_parser = values::count,
          allow_negative_numbers = true)]
    readings: usize,
    /// True σ of the laser along its rays, in --unit; half of it across [default: 0.1 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    sigma: Option<f64>,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Simulates the scene.
pub fn work(args: &VesselArgs, progress: &dyn Progress) -> Result<Summary<ScanSceneBody>> {
    let options = VesselOptions {
        seed: args.common.seed,
        readings: args.readings,
        sigma: args.sigma,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
    };
    let made = write_vessel_scene(&options, &args.out, progress)?;
    // The scanner sees one side only; the comparison shows how good the completed side is.
    let how = [" --symmetry rotation:full", " --part completed"];
    Ok(summary(&args.out, made, options.unit, how))
}
