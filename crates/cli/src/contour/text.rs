//! The summary of `planish contour`.

use super::constraints_text::constraints_text;
use crate::lines::{Align, Lines};
use crate::numbers::{count, significant};
use planish::contour::{ContourReport, PartReport, Relation};
use std::path::PathBuf;

/// The summary of the contours.
pub fn text(report: &ContourReport, outputs: &[PathBuf]) -> String {
    let mut lines = Lines::default();
    let walls: Vec<usize> =
        (0..report.contours.len()).filter(|&i| !report.contours[i].spans.is_empty()).collect();
    if !walls.is_empty() {
        walls_text(&mut lines, report, &walls);
    }
    for (i, part) in report.contours.iter().enumerate().filter(|(_, part)| part.spans.is_empty()) {
        if i > 0 || !walls.is_empty() {
            lines.gap();
        }
        part_text(&mut lines, part, i, report);
    }
    if let Some(samples) = report.samples_per_pixel {
        lines.gap();
        lines.line(format!(
            "The picture has {samples} × {samples} samples per pixel: σ includes the displacement of sides \
             along its rows and columns."
        ));
    }
    if let Some(levels) = &report.levels {
        lines.gap();
        let what = match levels.relation {
            Relation::Prism => "agree: a prism",
            Relation::Revolution => "are circles with one axis: a surface of revolution",
            Relation::None => "do not agree",
        };
        lines.line(format!(
            "The contours of {} levels {what} (χ² {} with {} degrees of freedom).",
            levels.levels.len(),
            significant(levels.chi_square, 3),
            levels.degrees
        ));
    }
    if let Some(constrained) = &report.constrained {
        lines.gap();
        lines.line("The values above use only the readings. With the given and detected constraints:");
        lines.gap();
        constraints_text(&mut lines, constrained);
    }
    if !outputs.is_empty() {
        lines.gap();
        let names: Vec<String> = outputs.iter().map(|path| path.display().to_string()).collect();
        lines.line(format!("Wrote {}.", names.join(", ")));
    }
    lines.into_text()
}

/// All walls in one table, as a room has many.
fn walls_text(lines: &mut Lines, report: &ContourReport, walls: &[usize]) {
    let sum = |of: fn(&PartReport) -> usize| walls.iter().map(|&i| of(&report.contours[i])).sum::<usize>();
    lines.line(format!(
        "{} {}, from {} readings ({} rejected by the gate), with {} {}.",
        walls.len(),
        if walls.len() == 1 { "wall" } else { "walls" },
        count(sum(|part| part.readings)),
        count(sum(|part| part.rejected)),
        report.corners.len(),
        if report.corners.len() == 1 { "corner" } else { "corners" },
    ));
    if let Some(sigma) = report.sigma_range {
        lines.line(format!("σ of a range from the residuals of the walls: {}.", significant(sigma, 2)));
    }
    if let Some(errors) = report.wall_errors.filter(|errors| errors.deviation > 0.0) {
        lines.line(format!(
            "σ of the deviation from straight walls that neighbours share: {} (correlated over {}).",
            significant(errors.deviation, 2),
            significant(errors.correlation_length, 2)
        ));
    }
    lines.gap();
    let rows: Vec<Vec<String>> = (walls.iter())
        .map(|&i| {
            let part = &report.contours[i];
            let end = |end: Option<[f64; 2]>| {
                end.map_or_else(String::new, |[x, y]| format!("{}, {}", significant(x, 5), significant(y, 5)))
            };
            vec![
                (i + 1).to_string(),
                end(part.spans.first().map(|span| span[0])),
                end(part.spans.last().map(|span| span[1])),
                part.spans.len().to_string(),
                count(part.readings),
                part.sigma_across.map_or_else(String::new, |sigma| significant(sigma, 2)),
            ]
        })
        .collect();
    let columns = [
        ("wall", Align::Right),
        ("from", Align::Left),
        ("to", Align::Left),
        ("spans", Align::Right),
        ("readings", Align::Right),
        ("σ across", Align::Right),
    ];
    lines.table(&columns, &rows);
}

fn part_text(lines: &mut Lines, part: &PartReport, index: usize, report: &ContourReport) {
    let level = part.level.map_or_else(String::new, |level| format!(" at level {level}"));
    let hole = part.hole_of.map_or_else(String::new, |of| format!(", a hole of contour {}", of + 1));
    // A single contour needs no number.
    let name = if report.contours.len() > 1 { format!("Contour {}: ", index + 1) } else { String::new() };
    lines.line(format!(
        "{name}{}{level}{hole}, from {} readings ({} rejected by the gate).",
        part.kind,
        count(part.readings),
        count(part.rejected)
    ));
    // The margin shows how certain the kind is: a small one hardly distinguishes both kinds.
    if let (Some(margin), Some(other)) = (part.bic_margin, part.alternatives.first()) {
        lines.line(format!("Next best: {} (BIC larger by {}).", other.kind, significant(margin, 3)));
    }
    lines.gap();
    let rows: Vec<Vec<String>> = (part.parameters.iter().chain(&part.sides))
        .map(|(name, value)| vec![name.clone(), significant(value.value, 6), significant(value.sigma, 2)])
        .collect();
    lines.table(&[("parameter", Align::Left), ("value", Align::Right), ("σ", Align::Right)], &rows);
}
