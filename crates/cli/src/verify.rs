//! `planish verify`: checks that files are whole and consistent.

use crate::common::{CommonArgs, short_help};
use crate::summary::{self, Summary};
use clap::{Args, ValueHint};
use planish::progress::Progress;
use planish::verify::{VerifyJob, VerifyReport};
use planish::{ErrorKind, FindingLevel, Job, Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish verify examples/data/pebble/job.toml examples/data/pebble/truth.ply
  planish verify part.planish part.ply part.step --json

Prints one line per file. The exit code is 0 if all files are whole, 2 if one has a defect, and 3
if files could not be read.";

/// Arguments of `planish verify`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish verify part.planish part.ply"), after_long_help = EXAMPLES)]
pub struct VerifyArgs {
    /// Models, meshes, scans, lists, views, drawings, pictures or calibrations
    #[arg(value_name = "FILE", required = true, value_hint = ValueHint::FilePath)]
    files: Vec<PathBuf>,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// JSON keys of `verify`.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: VerifyReport,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &VerifyArgs) -> u8 {
    summary::run_with_code("verify", &args.common, |progress| work(args, progress))
}

fn work(args: &VerifyArgs, progress: &dyn Progress) -> Result<(Summary<Body>, u8)> {
    let job = VerifyJob { files: args.files.clone(), unit: args.common.unit.map(Unit::from) };
    let report = job.run(progress)?;
    let code = exit_code(&report);
    let summary = Summary {
        text: text(&report),
        unit: args.common.unit.map(Unit::from),
        inputs: args.files.clone(),
        outputs: Vec::new(),
        // The lines of the summary already state the defects.
        findings: report.findings.iter().filter(|f| f.level < FindingLevel::Error).cloned().collect(),
        body: Body { report, termination: "converged" },
    };
    Ok((summary, code))
}

/// Any defect has the code of wrong input, whatever kind of error found it. Files that cannot be read at all
/// have the code of other commands if there is no defect besides.
fn exit_code(report: &VerifyReport) -> u8 {
    let kinds: Vec<ErrorKind> = report.files.iter().filter_map(|file| file.error).collect();
    match kinds.iter().any(|&kind| kind != ErrorKind::Io) {
        true => ErrorKind::Input.exit_code(),
        false => kinds.first().map_or(0, |kind| kind.exit_code()),
    }
}

/// One line for each file.
fn text(report: &VerifyReport) -> String {
    let line = |file: &planish::verify::VerifiedFile| {
        let state = if file.whole { "ok    " } else { "defect" };
        format!("{state}  {}: {}\n", file.file.display(), file.text)
    };
    report.files.iter().map(line).collect()
}
