//! `planish next`: plans the next measurements.

mod args;
mod text;

use crate::numbers::{counted, percent, significant};
use crate::summary::{self, Summary};
pub use args::NextArgs;
use planish::next::{
    NextJob, NextJobReport, NextOptions, NextViewsJob, NextViewsJobReport, Objective, UnmeasurableSigma,
};
use planish::progress::Progress;
use planish::{Job, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// JSON keys of `next`.
#[derive(Serialize)]
struct Body<R: Serialize> {
    #[serde(flatten)]
    report: R,
    warnings: Vec<String>,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &NextArgs) -> u8 {
    match (args.views, &args.sensor) {
        (Some(views), Some(sensor)) => {
            summary::run("next", &args.common, |progress| choose_views(args, views, sensor, progress))
        }
        _ => summary::run("next", &args.common, |progress| choose_points(args, progress)),
    }
}

fn options(args: &NextArgs) -> NextOptions {
    NextOptions {
        count: args.views.unwrap_or(args.count),
        region: args.region,
        measured_only: args.measured_only,
        objective: if args.mean { Objective::Mean } else { Objective::Worst },
        against_random: args.against_random,
        seed: args.common.seed,
        ..NextOptions::default()
    }
}

fn termination(reached_goal: Option<bool>) -> &'static str {
    match reached_goal {
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
    body: Body<R>,
) -> Summary<Body<R>> {
    Summary {
        text,
        unit: Some(unit),
        inputs,
        outputs: args.output.iter().chain(&args.page.report).cloned().collect(),
        warnings: body.warnings.clone(),
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
    let mut warnings = Vec::new();
    if report.next.reached_goal == Some(false) {
        warnings.push(format!(
            "the goal is not reached with {} points: increase --count, or measure with a smaller σ",
            report.next.points.len()
        ));
    }
    warnings.extend(unresolved_shape_warning(report.next.shape_left, report.unit));
    let body = Body { termination: termination(report.next.reached_goal), warnings, report };
    let (text, unit) = (text::points_text(&body.report), body.report.unit);
    Ok(summary(args, vec![args.model.clone()], text, unit, body))
}

fn choose_views(
    args: &NextArgs,
    views: usize,
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
    // Fewer views than requested are no error: further views may have nothing to add.
    let found = report.next.views.len();
    let mut warnings = Vec::new();
    if report.next.reached_goal == Some(false) {
        warnings.push(format!(
            "the goal is not reached with {}: increase --views, or use a more accurate sensor",
            counted(found, "view")
        ));
    }
    if found < views && report.next.reached_goal != Some(true) {
        warnings
            .push(format!("{} of {views} chosen: further views would not reduce σ", counted(found, "view")));
    }
    warnings.extend(unresolved_shape_warning(report.next.shape_left, report.unit));
    let body = Body { termination: termination(report.next.reached_goal), warnings, report };
    let (text, unit) = (text::views_text(&body.report), body.report.unit);
    Ok(summary(args, vec![args.model.clone(), sensor.to_owned()], text, unit, body))
}

/// The warning about unresolved shape, the part of σ in `info` and `fit` that readings do not reduce.
fn unresolved_shape_warning(left: Option<UnmeasurableSigma>, unit: planish::Unit) -> Option<String> {
    let left = left?;
    Some(format!(
        "unresolved shape of up to {2} {unit} on {0} of the area is not included: readings do not reduce it; \
         with it, the largest σ is {1} {unit} at the end; fit again with a larger --max-depth or \
         --max-coefficients",
        percent(left.area_fraction),
        significant(left.worst_sigma_after, 3),
        significant(left.largest, 3)
    ))
}
