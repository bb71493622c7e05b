//! `planish next`: plans the next measurements.

mod args;
mod text;

use crate::summary::{self, Summary};
pub use args::NextArgs;
use planish::next::{NextJob, NextJobReport, NextOptions, NextViewsJob, NextViewsJobReport, Objective};
use planish::progress::Progress;
use planish::{DVec3, Finding, Job, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// JSON keys of `next`.
#[derive(Serialize)]
struct Body<R: Serialize> {
    #[serde(flatten)]
    report: R,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &NextArgs) -> u8 {
    // The parser refuses one of the two without the other, so all other pairs mean points.
    match (args.views, &args.sensor) {
        (Some(_), Some(sensor)) => {
            summary::run("next", &args.common, |progress| choose_views(args, sensor, progress))
        }
        _ => summary::run("next", &args.common, |progress| choose_points(args, progress)),
    }
}

fn options(args: &NextArgs) -> NextOptions {
    NextOptions {
        // `--views` excludes `--count`, so the maximum of either kind has one place in the library.
        count: args.views.unwrap_or(args.count),
        region: args.region.map(|corners| corners.map(DVec3::from)),
        measured_only: args.measured_only,
        objective: if args.mean { Objective::Mean } else { Objective::Worst },
        against_random: args.against_random,
        seed: args.common.seed,
        ..NextOptions::default()
    }
}

fn termination(reached_goal: Option<bool>) -> &'static str {
    match reached_goal {
        // The names are those of `fit`, so that a program reads one set of words from all commands.
        Some(true) => "reached_tolerance",
        Some(false) => "limit",
        None => "converged",
    }
}

fn summary<R: Serialize>(
    args: &NextArgs,
    inputs: Vec<PathBuf>,
    text: String,
    unit: planish::Unit,
    findings: Vec<Finding>,
    body: Body<R>,
) -> Summary<Body<R>> {
    Summary {
        text,
        unit: Some(unit),
        inputs,
        outputs: args.output.iter().chain(&args.page.report).cloned().collect(),
        findings,
        body,
    }
}

fn choose_points(args: &NextArgs, progress: &dyn Progress) -> Result<Summary<Body<NextJobReport>>> {
    let job = NextJob {
        model: args.model.clone(),
        options: options(args),
        sigma: args.sigma,
        goal: args.goal,
        outputs: args.output.clone(),
        report: args.page.output(&args.common),
    };
    let report = job.run(progress)?;
    let findings = report.findings.clone();
    let body = Body { termination: termination(report.next.reached_goal), report };
    let (text, unit) = (text::points_text(&body.report), body.report.unit);
    Ok(summary(args, vec![args.model.clone()], text, unit, findings, body))
}

fn choose_views(
    args: &NextArgs,
    sensor: &Path,
    progress: &dyn Progress,
) -> Result<Summary<Body<NextViewsJobReport>>> {
    let job = NextViewsJob {
        model: args.model.clone(),
        sensor: sensor.to_owned(),
        options: options(args),
        goal: args.goal,
        outputs: args.output.clone(),
        report: args.page.output(&args.common),
    };
    let report = job.run(progress)?;
    let findings = report.findings.clone();
    let body = Body { termination: termination(report.next.reached_goal), report };
    let (text, unit) = (text::views_text(&body.report), body.report.unit);
    Ok(summary(args, vec![args.model.clone(), sensor.to_owned()], text, unit, findings, body))
}
