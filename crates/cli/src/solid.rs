//! `planish solid`.

use crate::args::SolidArgs;
use crate::numbers::{count, significant};
use crate::report::{self, Align, Lines, Summary};
use planish::Result;
use planish::progress::Progress;
use planish::solid::{SolidJob, SolidReport, solid_files};
use serde::Serialize;

/// The keys of `solid` beside the common ones.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: SolidReport,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &SolidArgs) -> u8 {
    report::run("solid", &args.common, |progress| work(args, progress))
}

fn work(args: &SolidArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let job = SolidJob {
        views: args.views.clone(),
        outputs: args.output.clone(),
        all: args.all,
        unit: args.common.unit.map(Into::into),
    };
    let report = solid_files(&job, progress)?;
    Ok(Summary {
        text: text(&report),
        unit: Some(report.unit),
        inputs: args.views.clone(),
        outputs: report.written.clone(),
        warnings: report.warnings.clone(),
        body: Body {
            termination: if report.complete { "converged" } else { "limit" },
            report,
        },
    })
}

fn text(report: &SolidReport) -> String {
    let mut lines = Lines::default();
    let n = report.solutions.len();
    lines.line(match n {
        1 => "One solid has these views.".to_owned(),
        _ => format!("{} solids have these views, best first.", count(n)),
    });
    lines.gap();
    let rows: Vec<Vec<String>> = report
        .solutions
        .iter()
        .map(|s| {
            vec![
                s.rank.to_string(),
                significant(s.volume, 8),
                significant(s.area, 8),
                s.faces.plane.to_string(),
                s.faces.cylinder.to_string(),
                s.file.clone().unwrap_or_default(),
            ]
        })
        .collect();
    lines.table(
        &[
            ("", Align::Right),
            ("volume", Align::Right),
            ("area", Align::Right),
            ("planes", Align::Right),
            ("cylinders", Align::Right),
            ("file", Align::Left),
        ],
        &rows,
    );
    lines.into_text()
}
