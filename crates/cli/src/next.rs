//! `planish next`.

use crate::args::NextArgs;
use crate::numbers::{count, counted, percent, significant};
use crate::report::{self, Align, Lines, Summary};
use planish::Job;
use planish::Result;
use planish::next::{
    Change, NextJob, NextJobReport, NextOptions, NextViewsJob, NextViewsJobReport, Objective,
    UnmeasurableSigma,
};
use planish::progress::Progress;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The keys of `next` beside the common ones.
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
            report::run("next", &args.common, |progress| choose_views(args, views, sensor, progress))
        }
        _ => report::run("next", &args.common, |progress| choose_points(args, progress)),
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
            "{} points do not reach the goal: raise --count, or measure with a smaller σ",
            report.next.points.len()
        ));
    }
    warnings.extend(told_of_shape(report.next.shape_left, report.unit));
    let body = Body { termination: termination(report.next.reached_goal), warnings, report };
    let (text, unit) = (text(&body.report), body.report.unit);
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
    let found = report.next.views.len();
    let mut warnings = Vec::new();
    if report.next.reached_goal == Some(false) {
        warnings.push(format!(
            "{} do not reach the goal: raise --views, or measure with a better sensor",
            counted(found, "view")
        ));
    }
    if found < views && report.next.reached_goal != Some(true) {
        warnings.push(format!("{} of {views}: no further view would lower σ", counted(found, "view")));
    }
    warnings.extend(told_of_shape(report.next.shape_left, report.unit));
    let body = Body { termination: termination(report.next.reached_goal), warnings, report };
    let (text, unit) = (text_of_views(&body.report), body.report.unit);
    Ok(summary(args, vec![args.model.clone(), sensor.to_owned()], text, unit, body))
}

fn changes(lines: &mut Lines, worst: Change, mean: Change) {
    for (name, change) in [("Largest σ", worst), ("Root mean square σ", mean)] {
        lines.line(format!(
            "{name}: {} before, {} after.",
            significant(change.before, 3),
            significant(change.after, 3)
        ));
    }
}

/// What no reading makes smaller, and what `info` and `fit` count as a part of σ.
fn told_of_shape(left: Option<UnmeasurableSigma>, unit: planish::Unit) -> Option<String> {
    let left = left?;
    Some(format!(
        "on {} of the area cells are too large to follow the shape, by up to {} {unit}: no reading makes that smaller, and no figure here counts it; \
         with it the largest σ is {} {unit} in the end: `fit` with more --max-depth or --max-coefficients",
        percent(left.area_fraction),
        significant(left.largest, 3),
        significant(left.worst_sigma_after, 3)
    ))
}

fn already_reached(worst: Change, mean: Change) -> String {
    let mut lines = Lines::default();
    lines.line("The model reaches the goal as it is: nothing need be measured.");
    lines.gap();
    changes(&mut lines, worst, mean);
    lines.into_text()
}

fn text(report: &NextJobReport) -> String {
    let next = &report.next;
    let mut lines = Lines::default();
    if next.points.is_empty() && next.reached_goal == Some(true) {
        return already_reached(next.worst_sigma, next.mean_sigma);
    }
    lines.line(format!(
        "{} points to measure with σ {} {}, best first.",
        count(next.points.len()),
        significant(next.sigma, 3),
        report.unit
    ));
    lines.gap();
    let number = |x: f64| significant(x, 5);
    let rows: Vec<Vec<String>> = (1..)
        .zip(&next.points)
        .map(|(k, p): (usize, _)| {
            let normal = p.normal.map(|c| format!("{c:.2}")).join(" ");
            let mut row = vec![k.to_string()];
            row.extend(p.position.map(number));
            row.extend([normal, significant(p.sigma_before, 3), significant(p.sigma_after, 3)]);
            row
        })
        .collect();
    lines.table(
        &[
            ("", Align::Right),
            ("x", Align::Right),
            ("y", Align::Right),
            ("z", Align::Right),
            ("normal", Align::Left),
            ("σ before", Align::Right),
            ("σ after", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    changes(&mut lines, next.worst_sigma, next.mean_sigma);
    if let Some(random) = &next.random
        && let Some(median) = random.worst_sigma_median.last()
    {
        lines.line(format!(
            "Of {} sets of as many points drawn at random, the median leaves a largest σ of {}.",
            random.draws,
            significant(*median, 3)
        ));
    }
    lines.into_text()
}

fn text_of_views(report: &NextViewsJobReport) -> String {
    let next = &report.next;
    let mut lines = Lines::default();
    if next.views.is_empty() && next.reached_goal == Some(true) {
        return already_reached(next.worst_sigma, next.mean_sigma);
    }
    lines.line(format!(
        "{} to take, best first, of {} poses that were compared. Lengths in {}.",
        counted(next.views.len(), "view"),
        count(next.candidates),
        report.unit
    ));
    lines.gap();
    let rows: Vec<Vec<String>> = (1..)
        .zip(&next.views)
        .map(|(k, v): (usize, _)| {
            let mut row = vec![k.to_string()];
            row.extend(v.translation.map(|x| significant(x, 5)));
            row.extend([
                v.quaternion_xyzw.map(|c| format!("{c:.4}")).join(" "),
                count(v.readings),
                percent(v.seen),
                percent(v.seen_so_far),
                significant(v.worst_sigma_after, 3),
                significant(v.mean_sigma_after, 3),
            ]);
            row
        })
        .collect();
    lines.table(
        &[
            ("", Align::Right),
            ("x", Align::Right),
            ("y", Align::Right),
            ("z", Align::Right),
            ("quaternion x y z w", Align::Left),
            ("readings", Align::Right),
            ("sees", Align::Right),
            ("seen so far", Align::Right),
            ("largest σ", Align::Right),
            ("rms σ", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    changes(&mut lines, next.worst_sigma, next.mean_sigma);
    if let Some(place) = &next.worst_unseen {
        lines.line(format!(
            "No pose sees {} of the area; σ there is up to {}, at {}.",
            percent(next.unseen),
            significant(place.sigma, 3),
            place.position.map(|x| significant(x, 4)).join(" ")
        ));
    }
    lines.into_text()
}
