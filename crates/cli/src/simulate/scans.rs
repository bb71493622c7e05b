//! `planish simulate scene scans`.

use super::SceneShape;
use super::text::{ScanSceneBody, summary};
use crate::common::{CommonArgs, short_help};
use crate::summary::Summary;
use crate::values::{self, not_negative, positive, share};
use clap::{Args, ValueHint};
use planish::progress::Progress;
use planish::simulate::{ScanSceneOptions, write_scans_scene};
use planish::{Result, Unit};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene scans --out scene
  planish simulate scene scans --shape tube --seed 7 --readings 12000 --outliers 0.05 --out pipe

The folder then has job.toml (for `planish fit`), a .ply file for each scan, truth.ply (a mesh of the true \
surface, for `planish compare`) and truth.json (true σ, outliers, and the formula of the surface). The \
object is 100 mm long; --unit selects the unit of the files.";

/// Arguments of `planish simulate scene scans`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene scans --out scene"), after_long_help = EXAMPLES)]
pub struct ScansArgs {
    /// Output folder; it is created if necessary
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,

    /// Topology of the surface
    #[arg(long, value_name = "SHAPE", value_enum, default_value_t = SceneShape::Ball, help_heading = "Scene")]
    shape: SceneShape,
    /// Approximate number of readings of all scanners
    #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = values::count,
          allow_negative_numbers = true, help_heading = "Scene")]
    readings: usize,
    /// Maximum number of triangles of truth.ply [default: half the readings, from 5120 to 80000]
    #[arg(long, value_name = "N", value_parser = values::count, allow_negative_numbers = true,
          help_heading = "Scene", hide_short_help = true)]
    truth_triangles: Option<usize>,

    /// True σ of the laser along its rays, in --unit; half of it across [default: 0.1 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          help_heading = "Sensors")]
    sigma: Option<f64>,
    /// Number of views of the laser
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = values::count,
          allow_negative_numbers = true, help_heading = "Sensors")]
    views: usize,
    /// Omit the old scanner
    #[arg(long, help_heading = "Sensors", hide_short_help = true)]
    no_old_scanner: bool,
    /// True σ divided by the stated σ of the old scanner; 1 is correct
    #[arg(long, value_name = "FACTOR", default_value_t = 3.0, value_parser = positive,
          allow_negative_numbers = true, help_heading = "Sensors", hide_short_help = true)]
    misstated: f64,
    /// Number of points of the touch probe; 0 omits the probe
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = values::count,
          allow_negative_numbers = true, help_heading = "Sensors")]
    probe_points: usize,
    /// Share of the scanners' readings that are outliers, from 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.01, value_parser = share,
          allow_negative_numbers = true, help_heading = "Sensors")]
    outliers: f64,
    /// Relative increase of σ from the centre of a scanner's field of view to its corners
    ///
    /// If it is above 0, each reading has its own σ.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = not_negative,
          allow_negative_numbers = true, help_heading = "Sensors", hide_short_help = true)]
    unevenness: f64,
    /// Write unorganised points instead of organised grids
    #[arg(long, help_heading = "Sensors", hide_short_help = true)]
    no_grids: bool,

    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Simulates the scene.
pub fn work(args: &ScansArgs, progress: &dyn Progress) -> Result<Summary<ScanSceneBody>> {
    let options = ScanSceneOptions {
        shape: args.shape.into(),
        seed: args.common.seed,
        readings: args.readings,
        sigma: args.sigma,
        views: args.views,
        // Flags of clap are off by default, so the option is negative and the setting positive.
        old_scanner: !args.no_old_scanner,
        misstated: args.misstated,
        probe_points: args.probe_points,
        outlier_share: args.outliers,
        unevenness: args.unevenness,
        organised: !args.no_grids,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
        truth_triangles: args.truth_triangles,
    };
    let made = write_scans_scene(&options, &args.out, progress)?;
    // The defaults of `fit` and `compare` suit this scene.
    Ok(summary(&args.out, made, options.unit, ["", ""]))
}
