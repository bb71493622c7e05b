//! `planish info`: describes the contents of a file.

mod text;

use crate::common::{CommonArgs, short_help};
use crate::summary::{self, Summary};
use clap::{Args, ValueHint};
use planish::info::{FileInfo, info};
use planish::progress::Progress;
use planish::{Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish info examples/data/pebble/job.toml
  planish info examples/data/pebble/truth.ply
  planish info part.planish --json

Reads scans, lists of scans, meshes and saved models. Lengths are in the unit of the file.";

/// Arguments of `planish info`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish info examples/data/pebble/job.toml"), after_long_help = EXAMPLES)]
pub struct InfoArgs {
    /// Scan, list of scans, mesh or saved model
    #[arg(value_name = "FILE", value_hint = ValueHint::FilePath)]
    file: PathBuf,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// JSON keys of `info`.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    info: FileInfo,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &InfoArgs) -> u8 {
    summary::run("info", &args.common, |progress| work(args, progress))
}

fn work(args: &InfoArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    // Large scans are read as a whole; the check lets Ctrl-C stop before that.
    progress.check("reading", 0.0)?;
    let found = info(&args.file, args.common.unit.map(Unit::from))?;
    Ok(Summary {
        text: text::text(&args.file, &found),
        unit: found.unit,
        inputs: found.files.clone(),
        // `info` writes nothing, and its success is no judgement of the file: findings hold that.
        outputs: Vec::new(),
        findings: found.findings.clone(),
        body: Body { info: found, termination: "converged" },
    })
}
