//! The summary of `planish solid`.

use crate::lines::{Align, Lines};
use crate::numbers::{count, counted, significant};
use planish::solid::{
    DimensionKind, FaceCounts, NoisyGeometry, ReportedEdit, ReportedHeight, ReportedStack, SolidReport,
    UnexplainedLine,
};

/// Number of unexplained lines that are listed; the JSON object has all.
const LINES_SHOWN: usize = 20;

/// The summary of a reconstruction.
pub fn text(report: &SolidReport) -> String {
    let mut lines = Lines::default();
    let n = report.solutions.len();
    // Without a solid there is no table of solids; the unexplained lines are the result.
    if n == 0 {
        edits(&mut lines, report, "No solid has these views, but one has them after these edits (--repair):");
        unexplained(&mut lines, report);
        return lines.into_text();
    }
    edits(&mut lines, report, "No solid has these views. One has them after these edits:");
    lines.line(match n {
        1 if !report.edits.is_empty() => "The solid of the edited drawing:".to_owned(),
        1 => "One solid has these views.".to_owned(),
        _ => format!("{} solids have these views, best first.", count(n)),
    });
    // Rejected solids are not written, so this line is the only sign of them.
    if !report.refused.is_empty() {
        let others = report.refused.len();
        lines.line(format!(
            "{} rejected: {} lines differ from the drawing (--json lists them).",
            counted(others, "more solid"),
            if others == 1 { "its" } else { "their" },
        ));
    }
    for dropped in &report.dropped {
        lines.line(match dropped.count {
            1 => format!("1 more candidate is invalid: {}.", dropped.first),
            n => format!("{} more candidates are invalid; the first: {}.", count(n), dropped.first),
        });
    }
    lines.gap();
    let rows: Vec<Vec<String>> = report
        .solutions
        .iter()
        .map(|s| {
            vec![
                s.rank.to_string(),
                // Eight digits: sizes of a drawing are exact, and solids may differ in a small detail only.
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
    if let Some(stack) = &report.stack {
        stack_text(&mut lines, stack);
    }
    lines.into_text()
}

/// The edits after which a drawing shows a solid; nothing if there are none.
fn edits(lines: &mut Lines, report: &SolidReport, title: &str) {
    if report.edits.is_empty() {
        return;
    }
    lines.line(title);
    lines.gap();
    let cells = |edit: &ReportedEdit| {
        let entity = edit.line.entity.clone().unwrap_or_else(|| "a missing line".to_owned());
        vec![edit.line.view.to_owned(), entity, edit.line.reason.clone()]
    };
    let columns = [("view", Align::Left), ("entity", Align::Left), ("edit", Align::Left)];
    lines.table(&columns, &report.edits.iter().map(cells).collect::<Vec<_>>());
    lines.gap();
}

/// The sections of a solid, with sizes ± σ.
fn stack_text(lines: &mut Lines, stack: &ReportedStack) {
    let height = |height: &ReportedHeight| {
        let value = format!("{} ± {}", significant(height.value, 6), significant(height.sigma, 2));
        match height.between {
            Some([from, to]) => format!("{value} (not measured: between {from} and {to})"),
            None => value,
        }
    };
    lines.gap();
    lines.line(format!(
        "{} relations of the sections hold (χ² {} with {} degrees of freedom).",
        count(stack.relations),
        significant(stack.chi_square, 3),
        stack.degrees
    ));
    for section in &stack.sections {
        lines.gap();
        let levels = counted(section.levels.len(), "level");
        lines.line(format!(
            "Section from {levels}, height {} to {}:",
            height(&section.bottom),
            height(&section.top)
        ));
        let rows: Vec<Vec<String>> = (section.contours.iter())
            .flat_map(|contour| {
                contour.sizes.iter().map(|(name, size)| {
                    let sigma = significant(size.sigma, 2);
                    vec![contour.kind.clone(), name.clone(), significant(size.value, 6), sigma]
                })
            })
            .collect();
        let columns =
            [("contour", Align::Left), ("size", Align::Left), ("value", Align::Right), ("σ", Align::Right)];
        lines.table(&columns, &rows);
    }
}

/// The lines that no solid, or not the nearest one, explains.
fn unexplained(lines: &mut Lines, report: &SolidReport) {
    lines.line(match report.refused.is_empty() {
        true => "No solid has these views. Lines that cannot be explained:",
        false => "No solid has these views. Differences of the nearest solid (not written):",
    });
    lines.gap();
    let cells = |u: &UnexplainedLine| {
        // A missing line is not in the file, so it has no name.
        let entity = u.entity.clone().unwrap_or_else(|| "a missing line".to_owned());
        vec![u.view.to_owned(), entity, u.reason.clone()]
    };
    let rows: Vec<Vec<String>> = report.unexplained.iter().take(LINES_SHOWN).map(cells).collect();
    let columns = [("view", Align::Left), ("entity", Align::Left), ("reason", Align::Left)];
    lines.table(&columns, &rows);
    if report.unexplained.len() > LINES_SHOWN {
        lines.line(format!("and {} more (--json lists all)", report.unexplained.len() - LINES_SHOWN));
    }
}

/// The number of faces of each kind, such as `6 planes, 1 cylinder, 2 spheres`.
fn faces_by_kind(faces: &FaceCounts) -> String {
    let kinds = [
        (faces.plane, "plane", "planes"),
        (faces.cylinder, "cylinder", "cylinders"),
        (faces.cone, "cone", "cones"),
        (faces.sphere, "sphere", "spheres"),
        (faces.torus, "torus", "tori"),
        // No plural: "freeform" is an adjective here.
        (faces.freeform, "freeform", "freeform"),
    ];
    let present = kinds.into_iter().filter(|(n, ..)| *n > 0);
    present
        .map(|(n, one, many)| format!("{n} {}", if n == 1 { one } else { many }))
        .collect::<Vec<_>>()
        .join(", ")
}

/// How noisy views were fused, and the dimensions of the best solid.
fn geometry_text(lines: &mut Lines, geometry: &NoisyGeometry) {
    for view in &geometry.views {
        lines.line(format!(
            "{}: {}; {} parameters, rank {}; {}.",
            view.view,
            view.contours.join(", "),
            view.parameters,
            view.rank,
            match view.constraints.len() {
                0 => "no constraints".to_owned(),
                _ => view.constraints.join(", "),
            }
        ));
    }
    lines.gap();
    let rows: Vec<Vec<String>> = geometry
        .matches
        .iter()
        // Implied matches follow from the others and carry no information of their own.
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
            ("equal in two views", Align::Left),
            ("χ²", Align::Right),
            ("p", Align::Right),
            ("", Align::Left),
        ],
        &rows,
    );
    lines.gap();
    lines.line(format!(
        "Fusing the views: χ² {} with {} degrees of freedom, p = {}.",
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
    lines.table(&[("dimension", Align::Left), ("value", Align::Right), ("σ", Align::Right)], &rows);
}
