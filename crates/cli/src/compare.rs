//! `planish compare`.

use crate::args::{CompareArgs, PartName};
use crate::numbers::{count, percent, significant};
use crate::report::{self, Align, Lines, Summary};
use planish::Job;
use planish::compare::{CompareJob, CompareOptions, ComparisonReport, Deviations};
use planish::progress::Progress;
use planish::{Result, Unit};
use serde::Serialize;

/// The keys of `compare` beside the common ones.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: ComparisonReport,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &CompareArgs) -> u8 {
    report::run("compare", &args.common, |progress| work(args, progress))
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
        text: text(args, &report),
        unit: Some(report.unit),
        inputs: vec![args.model.clone(), args.reference.clone()],
        outputs: args.page.report.iter().cloned().collect(),
        warnings: report.warnings.clone(),
        body: Body { report, termination: "converged" },
    })
}

fn text(args: &CompareArgs, report: &ComparisonReport) -> String {
    let mut lines = Lines::default();
    lines.line(format!(
        "Deviations of {} from {} in {}, positive on the side that normals point to.",
        args.model.display(),
        args.reference.display(),
        report.unit
    ));
    lines.gap();
    let row = |name: &str, found: &Option<Deviations>| {
        let mut row = vec![name.to_owned()];
        match found {
            Some(d) => row.extend(
                [d.rms, d.mean, d.p50, d.p95, d.max]
                    .map(|value| significant(value, 3))
                    .into_iter()
                    .chain([count(d.n)]),
            ),
            None => row.extend(["–"; 6].map(str::to_owned)),
        }
        row
    };
    lines.table(
        &[
            ("", Align::Left),
            ("rms", Align::Right),
            ("mean", Align::Right),
            ("median |d|", Align::Right),
            ("95 % |d|", Align::Right),
            ("largest |d|", Align::Right),
            ("points", Align::Right),
        ],
        &[row("model to reference", &report.forward), row("reference to model", &report.backward)],
    );
    lines.gap();
    lines.line(match report.coverage95 {
        Some(share) => {
            format!("Within 1.96 σ: {} of the reference's points (95 % where σ is true).", percent(share))
        }
        None => "The model states no σ: its coverage cannot be told.".to_owned(),
    });
    let skipped = report.skipped;
    let (of_model, of_reference) = match args.part {
        PartName::Measured => (
            "points of the model were never measured",
            "points of the reference face a part of the model that was never measured",
        ),
        PartName::Completed | PartName::Known | PartName::All => (
            "points of the model are of another part",
            "points of the reference face another part of the model",
        ),
    };
    let causes = [
        (skipped.model_not_observed, of_model),
        (skipped.model_beyond_border, "points of the model lie beyond a border of the reference"),
        (skipped.reference_not_observed, of_reference),
        (skipped.reference_beyond_border, "points of the reference lie beyond a border of the model"),
    ];
    for (n, cause) in causes.into_iter().filter(|(n, _)| *n > 0) {
        lines.line(format!("Left out: {} {cause}.", count(n)));
    }
    if let Some(written) = args.page.written() {
        lines.line(written);
    }
    lines.into_text()
}
