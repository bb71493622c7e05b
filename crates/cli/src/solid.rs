//! `planish solid`.

use crate::args::SolidArgs;
use crate::numbers::{count, significant};
use crate::report::{self, Align, Lines, Summary};
use planish::Result;
use planish::progress::Progress;
use planish::solid::{DimensionKind, NoisyGeometry, SolidJob, SolidReport, solid_files};
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
        kinds: (!args.kinds.is_empty()).then(|| args.kinds.iter().copied().map(Into::into).collect()),
        level: args.level,
        graphs: args.graphs.clone(),
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
    if let Some(geometry) = &report.geometry {
        lines.gap();
        geometry_text(&mut lines, geometry);
    }
    lines.into_text()
}

/// How noisy views became one, and what is known of the best solid.
fn geometry_text(lines: &mut Lines, geometry: &NoisyGeometry) {
    for view in &geometry.views {
        lines.line(format!(
            "{}: {}; {} parameters, rank {}; {}.",
            view.view,
            view.contours.join(", "),
            view.parameters,
            view.rank,
            match view.constraints.len() {
                0 => "nothing else holds".to_owned(),
                _ => view.constraints.join(", "),
            }
        ));
    }
    lines.gap();
    let rows: Vec<Vec<String>> = geometry
        .matches
        .iter()
        .filter(|found| found.outcome != "implied")
        .map(|found| {
            vec![
                found.axis.to_owned(),
                found.text.clone(),
                significant(found.chi_square, 3),
                significant(found.p_value, 2),
                found.outcome.to_owned(),
            ]
        })
        .collect();
    lines.table(
        &[
            ("", Align::Left),
            ("the same in two views", Align::Left),
            ("χ²", Align::Right),
            ("p", Align::Right),
            ("", Align::Left),
        ],
        &rows,
    );
    lines.gap();
    lines.line(format!(
        "One geometry costs the views χ² {} of {} degrees, p = {}.",
        significant(geometry.chi_square, 3),
        geometry.degrees,
        significant(geometry.p_value, 2)
    ));
    lines.gap();
    let rows: Vec<Vec<String>> = geometry
        .dimensions
        .iter()
        .map(|size| {
            let kind = match size.kind {
                DimensionKind::Extent => "extent along",
                DimensionKind::Length => "length of",
                DimensionKind::Diameter => "diameter of",
            };
            vec![
                format!("{kind} {}", size.name),
                significant(size.value, 6),
                size.sigma
                    .map_or_else(|| "unknown".to_owned(), |sigma| significant(sigma, 2)),
            ]
        })
        .collect();
    lines.table(
        &[("size", Align::Left), ("value", Align::Right), ("σ", Align::Right)],
        &rows,
    );
}
