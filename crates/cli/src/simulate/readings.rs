//! `planish simulate scene readings`.

use crate::common::{CommonArgs, short_help};
use crate::contour::{KindChoice, kind};
use crate::lines::Lines;
use crate::numbers::count;
use crate::summary::{self, Summary};
use crate::values::{self, numbers, positive, share};
use clap::{Args, ValueHint};
use planish::Finding;
use planish::finding::with_warnings;
use planish::simulate::{ReadingsOptions, ReadingsSummary, write_readings_scene};
use planish::{Error, Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene readings --shape ellipse --readings 300 --out seen
  planish contour seen/readings.csv -o contour.json

The folder then has readings.csv, exact.csv (the same without errors) and truth.json (kind and parameters as \
in contour.json). Objects are about 100 mm large. By default the sensor is 300 mm away; σ is 2 mm for its \
position, 2° for its heading and 1 % for ranges.";

/// Arguments of `planish simulate scene readings`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate scene readings --shape ellipse --out seen"),
          after_long_help = EXAMPLES)]
pub struct ReadingsArgs {
    /// Output folder; it is created if necessary
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Shape of the object
    ///
    /// Shapes are circle, ellipse, rectangle, rounded-rectangle, slot, regular-polygon-N and polygon-6 (an
    /// L).
    #[arg(long, value_name = "KIND", default_value = "rectangle", value_parser = kind)]
    shape: KindChoice,
    /// Number of readings
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
    /// Share of readings that are outliers
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share,
          allow_negative_numbers = true)]
    outliers: f64,
    /// Velocity of the object, in lengths and degrees per second, at 100 readings per second
    #[arg(long, value_name = "VX,VY,DEG", value_parser = velocity, allow_hyphen_values = true)]
    velocity: Option<[f64; 3]>,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

// The example in the message is a valid value of the option.
fn velocity(text: &str) -> Result<[f64; 3], String> {
    numbers(text, "10,-5,20")
}

/// JSON keys of scenes of readings.
#[derive(Serialize)]
pub struct ReadingsBody {
    rows: usize,
    columns: Vec<&'static str>,
    #[serde(flatten, serialize_with = "with_warnings")]
    findings: Vec<Finding>,
    termination: &'static str,
}

/// The summary of a scene of readings with this text.
pub fn readings_summary(made: ReadingsSummary, unit: Unit, lines: Lines) -> Summary<ReadingsBody> {
    Summary {
        text: lines.into_text(),
        unit: Some(unit),
        inputs: Vec::new(),
        outputs: made.files,
        findings: Vec::new(),
        body: ReadingsBody {
            rows: made.rows,
            columns: made.columns,
            findings: Vec::new(),
            termination: "converged",
        },
    }
}

/// Runs the command; returns the exit code.
pub fn run(args: &ReadingsArgs) -> u8 {
    summary::run("simulate scene readings", &args.common, |_| work(args))
}

fn work(args: &ReadingsArgs) -> Result<Summary<ReadingsBody>> {
    // The parser is that of `contour`, which also accepts kinds that are no single shape in the plane.
    let KindChoice::Plane(kind) = args.shape.clone() else {
        return Err(Error::input("expected one shape in the plane for --shape, such as ellipse"));
    };
    let unit = args.common.unit.map_or(Unit::Millimetre, Unit::from);
    let options = ReadingsOptions {
        kind,
        readings: args.readings,
        sweep: args.sweep,
        noise: args.noise,
        outlier_share: args.outliers,
        // Users state degrees; the scene computes in radians.
        velocity: args.velocity.map_or([0.0; 3], |[x, y, deg]| [x, y, deg.to_radians()]),
        seed: args.common.seed,
        unit,
    };
    let made = write_readings_scene(&options, &args.out)?;
    let mut lines = Lines::default();
    lines.line(format!("Simulated {} readings of a {}.", count(made.rows), options.kind));
    lines.gap();
    lines.line(format!("Wrote {} files to {}. Next:", made.files.len(), args.out.display()));
    // The option of `contour` that matches the simulated motion.
    let motion = match args.velocity {
        None => "",
        Some([_, _, 0.0]) => " --motion linear",
        Some(_) => " --motion rigid",
    };
    lines.line(format!(
        "  planish contour {}{motion} -o contour.json -o contour.svg",
        args.out.join("readings.csv").display()
    ));
    Ok(readings_summary(made, unit, lines))
}
