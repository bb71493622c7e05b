//! `planish solid`.

use crate::args::{ProjectionName, SolidArgs};
use crate::numbers::{count, significant};
use crate::report::{self, Align, Lines, Summary};
use planish::Job;
use planish::progress::Progress;
use planish::solid::{
    DimensionKind, FaceCounts, NoisyGeometry, Projection, SolidJob, SolidReport, UnexplainedLine,
};
use planish::{ErrorKind, Result};
use serde::Serialize;
use std::cell::Cell;

/// So many lines are named in the summary.
const NAMED: usize = 20;

/// The keys of `solid` beside the common ones.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: SolidReport,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &SolidArgs) -> u8 {
    let is_solved = Cell::new(true);
    let code = report::run("solid", &args.common, |progress| work(args, progress, &is_solved));
    match code {
        0 if !is_solved.get() => ErrorKind::Undetermined.exit_code(),
        code => code,
    }
}

fn work(args: &SolidArgs, progress: &dyn Progress, is_solved: &Cell<bool>) -> Result<Summary<Body>> {
    let job = SolidJob {
        views: args.views.clone(),
        projection: match args.projection {
            ProjectionName::First => Projection::FirstAngle,
            ProjectionName::Third => Projection::ThirdAngle,
        },
        kinds: (!args.kinds.is_empty()).then(|| args.kinds.iter().copied().map(Into::into).collect()),
        level: args.level,
        graphs: args.graphs.clone(),
        outputs: args.output.clone(),
        mesh_tolerance: args.mesh_tolerance,
        tolerance: args.tolerance,
        all: args.all,
        unit: args.common.unit.map(Into::into),
        report: args.page.output(&args.common),
    };
    let report = job.run(progress)?;
    is_solved.set(!report.solutions.is_empty());
    Ok(Summary {
        text: text(&report),
        unit: Some(report.unit),
        inputs: args.views.clone(),
        outputs: report.written.clone(),
        warnings: report.warnings.clone(),
        body: Body {
            termination: match (report.solutions.is_empty(), report.complete) {
                (true, _) => "undetermined",
                (false, true) => "converged",
                (false, false) => "limit",
            },
            report,
        },
    })
}

fn text(report: &SolidReport) -> String {
    let mut lines = Lines::default();
    let n = report.solutions.len();
    if n == 0 {
        lines.line(match report.refused.is_empty() {
            true => "No solid has these views. What none explains:",
            false => "No solid has these views. In what the nearest one differs (it is not written):",
        });
        lines.gap();
        let named = |u: &UnexplainedLine| {
            let entity = u.entity.clone().unwrap_or_else(|| "a missing line".to_owned());
            vec![u.view.to_owned(), entity, u.why.clone()]
        };
        let rows: Vec<Vec<String>> = report.unexplained.iter().take(NAMED).map(named).collect();
        let columns = [("view", Align::Left), ("entity", Align::Left), ("why", Align::Left)];
        lines.table(&columns, &rows);
        if report.unexplained.len() > NAMED {
            lines.line(format!("and {} more (--json names all)", report.unexplained.len() - NAMED));
        }
        return lines.into_text();
    }
    lines.line(match n {
        1 => "One solid has these views.".to_owned(),
        _ => format!("{} solids have these views, best first.", count(n)),
    });
    if !report.refused.is_empty() {
        let others = report.refused.len();
        lines.line(format!(
            "{} more {} found by the search, and show{} other lines than the drawing (--json names them).",
            count(others),
            if others == 1 { "was" } else { "were" },
            if others == 1 { "s" } else { "" },
        ));
    }
    for dropped in &report.dropped {
        lines.line(match dropped.count {
            1 => format!("1 more candidate is no solid: {}.", dropped.first),
            n => format!("{} more candidates are no solids; of the first, {}.", count(n), dropped.first),
        });
    }
    lines.gap();
    let rows: Vec<Vec<String>> = report
        .solutions
        .iter()
        .map(|s| {
            vec![
                s.rank.to_string(),
                significant(s.volume, 8),
                significant(s.area, 8),
                faces_by_kind(&s.faces),
                s.file.clone().unwrap_or_default(),
            ]
        })
        .collect();
    let [volume, area] = [("volume", '³'), ("area", '²')]
        .map(|(what, power)| format!("{what} / {}{power}", report.unit.name()));
    lines.table(
        &[
            ("", Align::Right),
            (volume.as_str(), Align::Right),
            (area.as_str(), Align::Right),
            ("faces", Align::Left),
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

/// `6 planes, 1 cylinder, 2 spheres`: the kinds that there are.
fn faces_by_kind(faces: &FaceCounts) -> String {
    let kinds = [
        (faces.plane, "plane", "planes"),
        (faces.cylinder, "cylinder", "cylinders"),
        (faces.cone, "cone", "cones"),
        (faces.sphere, "sphere", "spheres"),
        (faces.torus, "torus", "tori"),
        (faces.freeform, "freeform", "freeform"),
    ];
    let told = kinds.into_iter().filter(|(n, ..)| *n > 0);
    told.map(|(n, one, many)| format!("{n} {}", if n == 1 { one } else { many }))
        .collect::<Vec<_>>()
        .join(", ")
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
                size.sigma.map_or_else(|| "unknown".to_owned(), |sigma| significant(sigma, 2)),
            ]
        })
        .collect();
    lines.table(&[("size", Align::Left), ("value", Align::Right), ("σ", Align::Right)], &rows);
}
