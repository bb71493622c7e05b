//! What holds between contours, for people.

use crate::numbers::{count, significant};
use crate::report::{Align, Lines};
use planish::contour::SnapOutcome;
use planish::contour::{ConstrainedReport, ReportedRelation};

/// Relations and sets that are named one by one; the JSON has all.
const NAMED: usize = 12;

/// Says what was found, imposed and left free.
pub fn constrained_text(lines: &mut Lines, report: &ConstrainedReport) {
    let of = |outcome: &str| -> Vec<&ReportedRelation> {
        report.relations.iter().filter(|r| r.outcome == outcome).collect()
    };
    let imposed = of("imposed");
    if !report.relations.is_empty() {
        lines.line(format!(
            "{} of {} relations hold: {} imposed, {} follow from these ({} expected by chance).",
            count(imposed.len() + of("implied").len()),
            count(report.relations.len()),
            count(imposed.len()),
            count(of("implied").len()),
            significant(report.expected_by_chance, 2)
        ));
    }
    if !imposed.is_empty() {
        lines.gap();
        let rows: Vec<Vec<String>> = imposed
            .iter()
            .map(|r| vec![r.text.clone(), significant(r.chi_square, 3), significant(r.p_value, 2)])
            .collect();
        lines.table(&[("relation", Align::Left), ("χ²", Align::Right), ("p", Align::Right)], &rows);
    }
    for relation in of("refused").into_iter().take(NAMED) {
        lines.line(format!("Refused: {}, for {}.", relation.text, list(&relation.with)));
    }
    if !report.sizes.is_empty() {
        lines.gap();
        let rows: Vec<Vec<String>> = report
            .sizes
            .iter()
            .map(|size| {
                vec![
                    size.text.clone(),
                    significant(size.value, 6),
                    significant(size.sigma, 2),
                    significant(size.nearest, 6),
                    significant(size.p_value, 2),
                    said(size.outcome).to_owned(),
                ]
            })
            .collect();
        lines.table(
            &[
                ("size", Align::Left),
                ("value", Align::Right),
                ("σ", Align::Right),
                ("grid", Align::Right),
                ("p", Align::Right),
                ("", Align::Left),
            ],
            &rows,
        );
    }
    lines.gap();
    let rows: Vec<Vec<String>> = report
        .dimensions
        .iter()
        .map(|dimension| vec![dimension.text.clone(), significant(dimension.sigma, 2)])
        .collect();
    if rows.is_empty() {
        lines.line("Nothing is left free.");
    } else {
        lines.line("What is left free, as dimensions:");
        lines.gap();
        lines.table(&[("dimension", Align::Left), ("σ", Align::Right)], &rows);
    }
    lines.gap();
    let free = &report.freedoms;
    lines.line(format!(
        "{} parameters, rank {} (by structure {}): {} freedoms, {} of them motions of the whole.",
        free.parameters, free.rank, free.structural_rank, free.free, free.rigid_motions
    ));
    for set in report.redundant.iter().take(NAMED) {
        lines.line(format!("Redundant: {}, by {}.", set.text, list(&set.with)));
    }
    if let Some(more) = report.redundant.len().checked_sub(NAMED).filter(|more| *more > 0) {
        lines.line(format!("… and {} more; --json has all.", count(more)));
    }
    if report.degrees > 0 {
        lines.line(format!(
            "All of it costs the readings χ² {} of {} degrees, p = {}.",
            significant(report.chi_square, 3),
            report.degrees,
            significant(report.p_value, 2)
        ));
    }
}

fn list(names: &[String]) -> String {
    match names {
        [] => "what was given".to_owned(),
        names => names.join("; "),
    }
}

fn said(outcome: SnapOutcome) -> &'static str {
    match outcome {
        SnapOutcome::Snapped => "put on the grid",
        SnapOutcome::Implied => "on the grid by others",
        SnapOutcome::FixedOffGrid => "fixed off the grid by others",
        SnapOutcome::OffGrid => "left: on no multiple",
        SnapOutcome::Ambiguous => "left: known too badly for this grid",
        SnapOutcome::Refused => "left: quarrels with what is imposed",
    }
}
