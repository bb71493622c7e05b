//! `planish simulate sphere`.

use crate::common::{CommonArgs, ReportArgs, short_help};
use crate::lines::{Align, Lines};
use crate::numbers::{count, significant};
use crate::summary::Summary;
use crate::values::{self, not_negative};
use clap::{Args, ValueHint};
use planish::Finding;
use planish::finding::with_warnings;
use planish::progress::Progress;
use planish::simulate::{SPHERE_COLUMNS, SphereJob, SphereOptions, SphereRow};
use planish::{Job, Result};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate sphere -o figure2.svg -o figure2.csv --sets 1 --depth 1
  planish simulate sphere --sets 1 --depth 0 --readings 100 --orientation-deg 5 -o normals.csv

The front of the sphere is measured at 50, 100 and 150 points with known parameters and with noise along the \
normal of up to 12 % of the radius. Then orientations are added. Curves are means over the sets: the patch \
filter for each subdivision depth, the global filter, and the error expected from the posterior. All of the \
20 sets at depth 3 take some minutes.";

/// Arguments of `planish simulate sphere`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish simulate sphere -o figure2.svg --sets 1 --depth 1"),
          after_long_help = EXAMPLES)]
pub struct SphereArgs {
    /// Output file: .svg (figures) or .csv (numbers); repeatable
    #[arg(long, short, value_name = "FILE", required = true, value_hint = ValueHint::FilePath)]
    out: Vec<PathBuf>,

    /// Number of sets of readings that are averaged
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = values::count,
          allow_negative_numbers = true, help_heading = "Sphere")]
    sets: usize,
    /// Number of readings of a set, instead of 50, 100 and 150; repeatable
    #[arg(long, value_name = "N", value_parser = values::count, allow_negative_numbers = true,
          help_heading = "Sphere")]
    readings: Vec<usize>,
    /// Maximum subdivision depth, from 0 to 4; all depths up to it are computed
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=4),
          allow_negative_numbers = true, help_heading = "Sphere")]
    depth: u8,
    /// Also subdivide patches whose curvature varies only within its σ
    #[arg(long, help_heading = "Sphere", hide_short_help = true)]
    noise_divides: bool,
    /// Maximum error of the orientations, in degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 2.0, value_parser = not_negative,
          allow_negative_numbers = true, help_heading = "Sphere")]
    orientation_deg: f64,
    /// Show the sphere forming from a cylinder: a .glb animation or a new folder of images
    ///
    /// The patch filter adds one reading per step.
    #[arg(long, value_name = "OUT.glb|DIR", help_heading = "Sphere", value_hint = ValueHint::AnyPath,
          hide_short_help = true)]
    animate: Option<PathBuf>,

    /// The report.
    #[command(flatten)]
    page: ReportArgs,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// JSON keys of `simulate sphere`.
#[derive(Serialize)]
pub struct SphereBody {
    rows: Vec<SphereRow>,
    columns: [&'static str; SPHERE_COLUMNS.len()],
    #[serde(flatten, serialize_with = "with_warnings")]
    findings: Vec<Finding>,
    termination: &'static str,
}

/// Runs the simulation.
pub fn work(args: &SphereArgs, progress: &dyn Progress) -> Result<Summary<SphereBody>> {
    // The defaults are the settings of the paper, so options that are not given reproduce its figures.
    let defaults = SphereOptions::default();
    let options = SphereOptions {
        seed: args.common.seed,
        sets: args.sets,
        // Given numbers replace all of the paper's numbers, so clap must not have these as default values.
        readings: if args.readings.is_empty() { defaults.readings.clone() } else { args.readings.clone() },
        depth: args.depth,
        orientation_deg: args.orientation_deg,
        noise_divides: args.noise_divides,
        ..defaults
    };
    let job = SphereJob {
        options: options.clone(),
        outputs: args.out.clone(),
        animation: args.animate.clone(),
        report: args.page.output(&args.common),
    };
    let rows = job.run(progress)?;
    Ok(Summary {
        text: text(args, &options, &rows),
        // Errors are in per cent of the radius, so the result has no lengths.
        unit: None,
        inputs: Vec::new(),
        outputs: (args.out.iter()).chain(&args.animate).chain(&args.page.report).cloned().collect(),
        findings: Vec::new(),
        body: SphereBody { rows, columns: SPHERE_COLUMNS, findings: Vec::new(), termination: "converged" },
    })
}

fn text(args: &SphereArgs, options: &SphereOptions, rows: &[SphereRow]) -> String {
    let mut lines = Lines::default();
    lines.line(format!(
        "Fitted a sphere to {} sets of readings per point of a curve. Mean errors in % of the radius:",
        count(options.sets)
    ));
    lines.gap();
    let table: Vec<Vec<String>> = rows
        .iter()
        // The table has the finest depth only; the files have all depths.
        .filter(|row| row.depth == options.depth)
        .map(|row| {
            vec![
                count(row.readings),
                significant(row.noise_percent, 2),
                // A row without orientations is the first figure: positions only.
                row.orientation_deg.map_or_else(|| "–".to_owned(), |x| significant(x, 2)),
                significant(row.leaf_patches, 3),
                significant(row.patch_percent, 3),
                significant(row.global_percent, 3),
                significant(row.bound_percent, 3),
            ]
        })
        .collect();
    lines.table(
        &[
            ("readings", Align::Right),
            ("noise / %", Align::Right),
            ("orientations / °", Align::Right),
            ("patches", Align::Right),
            ("patch filter", Align::Right),
            ("global", Align::Right),
            ("bound", Align::Right),
        ],
        &table,
    );
    lines.gap();
    let names: Vec<String> =
        args.out.iter().chain(&args.animate).map(|path| path.display().to_string()).collect();
    lines.line(format!("Wrote {}.", names.join(", ")));
    lines.into_text()
}
