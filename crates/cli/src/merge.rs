//! `planish merge`: merges overlapping patches into one mesh.

mod args;
mod text;

use crate::summary::{self, Summary};
pub use args::MergeArgs;
use clap::ValueEnum;
use planish::Job;
use planish::Length;
use planish::merge::{MergeJob, MergeJobReport, MergeOptions, MergeReport, SplineReport};
use planish::progress::Progress;
use planish::{Result, Unit};
use serde::Serialize;

/// JSON keys of `merge`.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: MergeReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    spline: Option<SplineReport>,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &MergeArgs) -> u8 {
    summary::run("merge", &args.common, |progress| work(args, progress))
}

fn work(args: &MergeArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let options = MergeOptions {
        method: args.method.map(Into::into).unwrap_or_default(),
        unit: args.common.unit.map(Unit::from),
        mesh_tolerance: args.mesh_tolerance,
        epsilon: args.epsilon,
        theta_deg: args.theta,
        fill: args.fill,
        curvature: args.curvature,
        align: args.align,
        believe_sigma: args.believe_sigma,
    };
    let job = MergeJob {
        patches: args.patches.clone(),
        bound: args.complete.clone(),
        options,
        outputs: args.output.clone(),
        report: args.page.output(&args.common),
        seed: args.common.seed,
        arguments: deciding_arguments(args),
    };
    let MergeJobReport { merge: report, spline } = job.run(progress)?;
    let findings = report.findings.clone();
    Ok(Summary {
        text: text::text(args, &report, spline.as_ref()),
        unit: Some(report.unit),
        inputs: report.inputs.clone(),
        outputs: args.output.iter().chain(&args.page.report).cloned().collect(),
        findings,
        // All commands have this key, so that programs need no exception; a merge succeeds or is an error.
        body: Body { report, spline, termination: "converged" },
    })
}

/// The arguments that decide the result; a saved model records them.
fn deciding_arguments(args: &MergeArgs) -> Vec<String> {
    let mut all = vec!["merge".to_owned()];
    all.extend(args.patches.iter().map(|path| path.display().to_string()));
    let method = args.method.and_then(|m| m.to_possible_value());
    // The unit is recorded as it was stated; a conversion would round.
    let stated = |length: Length| format!("{}{}", length.value, length.unit.map_or("", Unit::name));
    // Default values are left out, so that stating a default does not change the record.
    let given = [
        ("--method", method.map(|v| v.get_name().to_owned())),
        ("--epsilon", args.epsilon.map(stated)),
        ("--theta", args.theta.map(|v| v.to_string())),
        ("--fill", args.fill.map(|edges| edges.to_string())),
        ("--mesh-tolerance", args.mesh_tolerance.map(stated)),
        ("--complete", args.complete.as_ref().map(|p| p.display().to_string())),
        ("--unit", args.common.unit.map(|u| Unit::from(u).name().to_owned())),
        ("--seed", (args.common.seed > 0).then(|| args.common.seed.to_string())),
    ];
    for (name, value) in given {
        if let Some(value) = value {
            all.extend([name.to_owned(), value]);
        }
    }
    if args.align {
        all.push("--align".to_owned());
    }
    if args.believe_sigma {
        all.push("--believe-sigma".to_owned());
    }
    if args.curvature {
        all.push("--curvature".to_owned());
    }
    all
}
