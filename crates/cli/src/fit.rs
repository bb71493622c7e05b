//! `planish fit`: fits a surface to scans.

mod args;
mod task;
mod text;
mod values;

use crate::summary::{self, Summary};
pub use args::FitArgs;
use clap::ValueEnum;
use planish::Job;
use planish::animation::AnimationReport;
use planish::complete::SymmetryChoice;
use planish::fit::{FitOptions, FitReport, RefineBy};
use planish::fit_files::{FitJob, FitJobReport};
use planish::output::WrittenFile;
use planish::progress::Progress;
use planish::{DVec3, Result, SymmetryKind, Unit};
use serde::Serialize;
use std::path::PathBuf;

/// JSON keys of `fit`.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    fit: FitReport,
    /// Number of readings of all sessions in the model.
    observations_of_all_sessions: usize,
    /// Duration without reading and writing files.
    fit_seconds: f64,
    written: Vec<WrittenFile>,
    #[serde(skip_serializing_if = "Option::is_none")]
    animation: Option<AnimationReport>,
}

/// Runs the command; returns the exit code.
pub fn run(args: &FitArgs) -> u8 {
    summary::run("fit", &args.common, |progress| work(args, progress))
}

fn work(args: &FitArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let done = job(args)?.run(progress)?;
    Ok(Summary {
        // The text and the lists borrow the report, so they come before the body, which takes it apart.
        text: text::text(args, &done),
        unit: Some(done.unit),
        inputs: files_read(args, &done),
        outputs: (done.written.iter().map(|w| w.file.clone()))
            .chain(done.animation.iter().map(|a| a.file.clone()))
            .chain(args.page.report.clone())
            .collect(),
        findings: done.fit.findings.clone(),
        body: Body {
            fit: done.fit,
            observations_of_all_sessions: done.observations_of_all_sessions,
            fit_seconds: done.fit_seconds,
            written: done.written,
            animation: done.animation,
        },
    })
}

/// The job of these arguments.
///
/// # Errors
/// `Unsupported` for options that exclude each other.
fn job(args: &FitArgs) -> Result<FitJob> {
    Ok(FitJob {
        inputs: args.scans.clone(),
        outputs: args.output.clone(),
        task: task::task(args)?,
        unit: args.common.unit.map(Unit::from),
        tolerance: args.tolerance,
        mesh_tolerance: args.mesh_tolerance,
        cell_size: args.cell_size,
        closing: args.close.into(),
        states: args.states.clone(),
        animation: args.animate.clone(),
        report: args.page.output(&args.common),
        arguments: deciding_arguments(args),
    })
}

/// All files that were read: scans and lists, then the updated model.
fn files_read(args: &FitArgs, done: &FitJobReport) -> Vec<PathBuf> {
    let scans = done.inputs.iter().map(|input| input.path.clone());
    scans.chain(args.update.clone()).collect()
}

/// The arguments that decide the result, in a fixed order; a saved model records them.
///
/// Outputs, threads and printing are left out: equal results have equal records.
fn deciding_arguments(args: &FitArgs) -> Vec<String> {
    let mut all = vec!["fit".to_owned()];
    all.extend(args.scans.iter().map(|path| path.display().to_string()));
    // The width needs `=`, as on the command line; without one, the job chooses it.
    all.extend(args.ground.map(|width| width.map_or("--ground".to_owned(), |w| format!("--ground={w}"))));
    let flags = [("--align", args.align), ("--estimate-sigma", args.estimate_sigma)];
    all.extend(flags.into_iter().filter(|(_, is_set)| *is_set).map(|(name, _)| name.to_owned()));
    let value_name = |value: Option<clap::builder::PossibleValue>| value.map(|v| v.get_name().to_owned());
    let mut option = |name: &str, value: Option<String>| {
        if let Some(value) = value {
            all.extend([name.to_owned(), value]);
        }
    };
    let defaults = FitOptions::default();
    // Default values are left out, so that stating a default does not change the record.
    let differs = |value: f64, default: f64| (value != default).then(|| value.to_string());
    option("--update", args.update.as_ref().map(|path| path.display().to_string()));
    // The record has the names of the command line, because `planish info` prints it as a command.
    option("--shape", args.shape.map(|s| planish::Shape::from(s).name().to_owned()));
    option("--genus", args.genus.map(|n| n.to_string()));
    option("--known-uv", args.known_uv.map(|[u, v]| format!("{u}x{v}")));
    option("--motion", args.motion.and_then(|m| value_name(m.to_possible_value())));
    option("--complete", args.complete.map(|_| "smooth".to_owned()));
    option("--symmetry", args.symmetry.as_ref().map(symmetry_name));
    option("--tolerance", args.tolerance.map(|t| format!("{}{}", t.value, t.unit.map_or("", Unit::name))));
    option(
        // A stated memory may have lowered it.
        "--max-coefficients",
        Some(task::largest(args)).filter(|n| *n != defaults.max_coefficients).map(|n| n.to_string()),
    );
    option("--filter", args.filter.and_then(|f| value_name(f.to_possible_value())));
    option("--max-depth", args.max_depth.map(|d| d.to_string()));
    option(
        "--refine-by",
        value_name(args.refine_by.to_possible_value())
            .filter(|_| RefineBy::from(args.refine_by) != defaults.refine_by),
    );
    option("--force", args.force.then(String::new));
    option("--gate", differs(args.gate, defaults.gate));
    option("--held-out", differs(args.held_out, defaults.held_out_share));
    option("--unit", args.common.unit.map(|u| Unit::from(u).name().to_owned()));
    option("--seed", (args.common.seed != defaults.seed).then(|| args.common.seed.to_string()));
    all
}

/// A symmetry as a value of `--symmetry`.
fn symmetry_name(choice: &SymmetryChoice) -> String {
    // The inverse of `values::symmetry`.
    let towards = |d: &Option<DVec3>| d.map_or(String::new(), |d| format!(":{},{},{}", d.x, d.y, d.z));
    match choice {
        SymmetryChoice::Auto => "auto".to_owned(),
        SymmetryChoice::Of(SymmetryKind::Mirror { towards: d }) => format!("mirror{}", towards(d)),
        SymmetryChoice::Of(SymmetryKind::Rotation { order, towards: d }) => {
            let order = order.map_or("full".to_owned(), |n| n.to_string());
            format!("rotation:{order}{}", towards(d))
        }
    }
}
