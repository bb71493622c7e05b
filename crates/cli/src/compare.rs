//! `planish compare`: deviations of a model from a reference.

mod text;

use crate::common::{CommonArgs, ReportArgs, short_help};
use crate::summary::{self, Summary};
use crate::values::length;
use clap::{Args, ValueEnum, ValueHint};
use planish::Job;
use planish::compare::{CompareJob, CompareOptions, ComparedPart, ComparisonReport};
use planish::progress::Progress;
use planish::{Length, Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish compare part.planish examples/data/pebble/truth.ply
  planish compare part.ply other-scan.xyz --unit mm

Deviations are signed: positive if the model lies on the side that the normal of the reference points to. \
Only the part of the model selected by --part is compared. Points beyond a boundary are not compared. \
Coverage is the share of the reference points that lie within 1.96 √(σ_model² + σ_reference²); it is 0.95 if \
the stated σ is correct.";

/// Arguments of `planish compare`.
#[derive(Debug, Args)]
#[command(
    after_help = short_help!(
        "planish compare examples/data/pebble/truth.ply examples/data/pebble/probe.ply --unit mm"
    ),
    after_long_help = EXAMPLES
)]
pub struct CompareArgs {
    /// Saved model (.planish), mesh (.ply, .obj, .stl, .off, .glb) or CAD faces (.step)
    #[arg(value_name = "MODEL", value_hint = ValueHint::FilePath)]
    model: PathBuf,
    /// Mesh, points, or scans as for `planish fit`
    #[arg(value_name = "REFERENCE", value_hint = ValueHint::FilePath)]
    reference: PathBuf,
    /// Part of the model that is compared
    #[arg(long, value_name = "PART", value_enum, default_value_t = PartName::Measured)]
    part: PartName,
    /// Maximum chord error of the model's mesh, as a length [default: half the median σ]
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true,
          hide_short_help = true)]
    mesh_tolerance: Option<Length>,
    /// The report.
    #[command(flatten)]
    page: ReportArgs,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// Value of `--part`.
// `view` colours by the same deviations and shares this value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PartName {
    /// The measured part
    Measured,
    /// The part that `fit` completed by symmetry or smoothness
    Completed,
    /// The measured and the completed part
    Known,
    /// The whole model
    All,
}

impl From<PartName> for ComparedPart {
    fn from(name: PartName) -> Self {
        match name {
            PartName::Measured => Self::Measured,
            PartName::Completed => Self::Completed,
            PartName::Known => Self::Known,
            PartName::All => Self::All,
        }
    }
}

/// JSON keys of `compare`.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: ComparisonReport,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &CompareArgs) -> u8 {
    summary::run("compare", &args.common, |progress| work(args, progress))
}

fn work(args: &CompareArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let options = CompareOptions {
        part: args.part.into(),
        unit: args.common.unit.map(Unit::from),
        mesh_tolerance: args.mesh_tolerance,
    };
    let job = CompareJob {
        model: args.model.clone(),
        reference: args.reference.clone(),
        options,
        report: args.page.output(&args.common),
    };
    let report = job.run(progress)?;
    Ok(Summary {
        text: text::text(args, &report),
        unit: Some(report.unit),
        // The files that the user named; a list of scans as the reference names further ones.
        inputs: vec![args.model.clone(), args.reference.clone()],
        outputs: args.page.report.iter().cloned().collect(),
        findings: report.findings.clone(),
        body: Body { report, termination: "converged" },
    })
}
