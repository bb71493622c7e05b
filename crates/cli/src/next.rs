//! `planish next`.

use crate::args::NextArgs;
use crate::numbers::{count, significant};
use crate::report::{self, Align, Lines, Summary};
use planish::Result;
use planish::next::{NextJob, NextJobReport, NextOptions, Objective, next_files};
use planish::progress::Progress;
use serde::Serialize;

/// The keys of `next` beside the common ones.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: NextJobReport,
    warnings: Vec<String>,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &NextArgs) -> u8 {
    report::run("next", &args.common, |progress| work(args, progress))
}

fn work(args: &NextArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let job = NextJob {
        model: args.model.clone(),
        options: NextOptions {
            count: args.count,
            region: args.region,
            measured_only: args.measured_only,
            objective: if args.mean { Objective::Mean } else { Objective::Worst },
            ..NextOptions::default()
        },
        sigma: args.sigma,
        goal: args.goal,
        outputs: args.output.clone(),
    };
    let report = next_files(&job, progress)?;
    let missed = report.next.reached_goal == Some(false);
    let warnings = if missed {
        vec![format!(
            "{} points do not reach the goal: raise --count, or measure with a smaller σ",
            report.next.points.len()
        )]
    } else {
        Vec::new()
    };
    Ok(Summary {
        text: text(&report),
        unit: Some(report.unit),
        inputs: vec![args.model.clone()],
        outputs: args.output.clone(),
        warnings: warnings.clone(),
        body: Body {
            termination: match report.next.reached_goal {
                Some(true) => "reached_tolerance",
                Some(false) => "limit",
                None => "converged",
            },
            report,
            warnings,
        },
    })
}

fn text(report: &NextJobReport) -> String {
    let next = &report.next;
    let mut lines = Lines::default();
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
    for (name, change) in [("Largest σ", next.worst_sigma), ("Mean σ", next.mean_sigma)] {
        lines.line(format!(
            "{name}: {} before, {} after.",
            significant(change.before, 3),
            significant(change.after, 3)
        ));
    }
    lines.into_text()
}
