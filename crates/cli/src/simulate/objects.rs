//! `planish simulate scene handles`, `plate`, `cup` and `bracket`.

use super::text::{ScanSceneBody, summary_of};
use crate::common::{CommonArgs, short_help};
use crate::summary::{self, Summary};
use crate::values::{self, not_negative, positive, share};
use clap::{Args, ValueHint};
use planish::progress::Progress;
use planish::simulate::{ObjectKind, ObjectSceneOptions, write_object_scene};
use planish::{Result, Unit};
use std::path::PathBuf;

const HANDLES_EXAMPLES: &str = "\
Examples:
  planish simulate scene handles --out rings
  planish simulate scene handles --genus 3 --seed 7 --sigma 0.05 --out rings

The folder then has job.toml (for `planish fit`), a .ply file for each scan, truth.ply (a watertight mesh of \
the true surface, for `planish compare`) and truth.json (genus, sizes, σ and outliers). The object is 100 mm \
long; --unit selects the unit of the files.";

const PLATE_EXAMPLES: &str = "\
Examples:
  planish simulate scene plate --out plate
  planish simulate scene plate --holes 1 --outliers 0.05 --out plate

The folder then has job.toml (for `planish fit`), a .ply file for each scan, truth.ply (a watertight mesh \
with exact sharp edges, for `planish compare`) and truth.json (genus, sizes, holes, edges, σ and outliers). \
The plate is 100 mm x 60 mm x 10 mm; --unit selects the unit of the files.";

const CUP_EXAMPLES: &str = "\
Examples:
  planish simulate scene cup --out cup
  planish simulate scene cup --wall 3 --views 20 --out cup

The folder then has job.toml (for `planish fit`), a .ply file for each scan, truth.ply (a watertight mesh of \
the true surface, for `planish compare`) and truth.json (genus, sizes, σ and outliers). The cup is about 100 \
mm wide with its handle; --unit selects the unit of the files.";

const BRACKET_EXAMPLES: &str = "\
Examples:
  planish simulate scene bracket --out bracket
  planish simulate scene bracket --fillet 3 --readings 200000 --out bracket

The folder then has job.toml (for `planish fit`), a .ply file for each scan, truth.ply (a watertight mesh \
with exact sharp edges, for `planish compare`) and truth.json (genus, sizes, holes, fillet, edges, σ and \
outliers). The bracket is 100 mm x 60 mm x 70 mm; --unit selects the unit of the files.";

/// Options of every scene of an object.
#[derive(Debug, Args)]
struct ScanningArgs {
    /// Output folder; it is created if necessary
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Approximate number of readings of all scans
    #[arg(long, value_name = "N", default_value_t = 60_000, value_parser = values::count,
          allow_negative_numbers = true, help_heading = "Scans")]
    readings: usize,
    /// Number of scans, from directions all around the object
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = values::count,
          allow_negative_numbers = true, help_heading = "Scans")]
    views: usize,
    /// True σ of the laser along its rays, in --unit; half of it across [default: 0.1 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          help_heading = "Scans")]
    sigma: Option<f64>,
    /// σ of measured normals, in degrees; 0 omits the normals
    #[arg(long, value_name = "DEG", default_value_t = 5.0, value_parser = not_negative,
          allow_negative_numbers = true, help_heading = "Scans")]
    sigma_normal_deg: f64,
    /// Share of the readings that are outliers, from 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.01, value_parser = share,
          allow_negative_numbers = true, help_heading = "Scans")]
    outliers: f64,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// Arguments of `planish simulate scene handles`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene handles --out rings"),
          after_long_help = HANDLES_EXAMPLES)]
pub struct HandlesArgs {
    /// Number of rings, which is the genus, from 1 to 16
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = values::count,
          allow_negative_numbers = true)]
    genus: usize,
    /// Options of the scans.
    #[command(flatten)]
    scanning: ScanningArgs,
}

/// Arguments of `planish simulate scene plate`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene plate --out plate"),
          after_long_help = PLATE_EXAMPLES)]
pub struct PlateArgs {
    /// Number of through holes, from 1 to 8
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = values::count,
          allow_negative_numbers = true)]
    holes: usize,
    /// Options of the scans.
    #[command(flatten)]
    scanning: ScanningArgs,
}

/// Arguments of `planish simulate scene cup`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene cup --out cup"), after_long_help = CUP_EXAMPLES)]
pub struct CupArgs {
    /// Thickness of the wall, in --unit, from 3 mm to 10 mm [default: 4 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    wall: Option<f64>,
    /// Options of the scans.
    #[command(flatten)]
    scanning: ScanningArgs,
}

/// Arguments of `planish simulate scene bracket`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene bracket --out bracket"),
          after_long_help = BRACKET_EXAMPLES)]
pub struct BracketArgs {
    /// Radius of the fillet, in --unit, from 0.5 mm to 20 mm [default: 8 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    fillet: Option<f64>,
    /// Options of the scans.
    #[command(flatten)]
    scanning: ScanningArgs,
}

impl HandlesArgs {
    /// Runs the command; returns the exit code.
    pub fn run(&self) -> u8 {
        let what = match self.genus {
            1 => "a ring".to_owned(),
            genus => format!("{genus} joined rings"),
        };
        self.scanning.run("simulate scene handles", &what, ObjectKind::Handles { genus: self.genus })
    }
}

impl PlateArgs {
    /// Runs the command; returns the exit code.
    pub fn run(&self) -> u8 {
        let what = match self.holes {
            1 => "a plate with a hole".to_owned(),
            holes => format!("a plate with {holes} holes"),
        };
        self.scanning.run("simulate scene plate", &what, ObjectKind::Plate { holes: self.holes })
    }
}

impl CupArgs {
    /// Runs the command; returns the exit code.
    pub fn run(&self) -> u8 {
        self.scanning.run("simulate scene cup", "a cup", ObjectKind::Cup { wall: self.wall })
    }
}

impl BracketArgs {
    /// Runs the command; returns the exit code.
    pub fn run(&self) -> u8 {
        self.scanning.run("simulate scene bracket", "a bracket", ObjectKind::Bracket { fillet: self.fillet })
    }
}

impl ScanningArgs {
    /// Runs the command; `what` names the object in the text.
    fn run(&self, command: &'static str, what: &str, object: ObjectKind) -> u8 {
        summary::run(command, &self.common, |progress| self.work(what, object, progress))
    }

    /// Simulates the scene.
    fn work(
        &self,
        what: &str,
        object: ObjectKind,
        progress: &dyn Progress,
    ) -> Result<Summary<ScanSceneBody>> {
        let options = ObjectSceneOptions {
            object,
            seed: self.common.seed,
            readings: self.readings,
            views: self.views,
            sigma: self.sigma,
            sigma_normal_deg: (self.sigma_normal_deg > 0.0).then_some(self.sigma_normal_deg),
            outlier_share: self.outliers,
            unit: self.common.unit.map_or(Unit::Millimetre, Unit::from),
        };
        let made = write_object_scene(&options, &self.out, progress)?;
        // The defaults of `fit` and `compare` suit this scene.
        Ok(summary_of(what, &self.out, made, options.unit, ["", ""]))
    }
}
