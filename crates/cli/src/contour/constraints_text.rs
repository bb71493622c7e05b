//! The part of the summary of `planish contour` that lists constraints.

use crate::lines::{Align, Lines};
use crate::numbers::{count, significant};

use planish::contour::SnapOutcome;
use planish::contour::{ConstrainedReport, ReportedRelation};

/// Number of relations that are listed; the JSON object has all.
const RELATIONS_SHOWN: usize = 12;

/// Adds the detected, imposed and free constraints.
pub fn constraints_text(lines: &mut Lines, report: &ConstrainedReport) {
    relations(lines, report);
    if !report.sizes.is_empty() {
        lines.gap();
        sizes(lines, report);
    }
    lines.gap();
    let rows: Vec<Vec<String>> = report
        .dimensions
        .iter()
        .map(|dimension| vec![dimension.text.clone(), significant(dimension.sigma, 2)])
        .collect();
    if rows.is_empty() {
        // A sketch without free dimensions is fully determined, which is worth a line.
        lines.line("No free dimensions.");
    } else {
        lines.line("Free dimensions:");
        lines.gap();
        lines.table(&[("dimension", Align::Left), ("σ", Align::Right)], &rows);
    }
    lines.gap();
    let free = &report.freedoms;
    lines.line(format!(
        "{} parameters, rank {} (structural rank {}): {} degrees of freedom, {} of them rigid motions.",
        free.parameters, free.rank, free.structural_rank, free.free, free.rigid_motions
    ));
    for set in report.redundant.iter().take(RELATIONS_SHOWN) {
        lines.line(format!("Redundant: {}, implied by {}.", set.text, list(&set.with)));
    }
    // `checked_sub` is none if all were listed; 0 more are not reported.
    if let Some(more) = report.redundant.len().checked_sub(RELATIONS_SHOWN).filter(|more| *more > 0) {
        lines.line(format!("… and {} more; --json lists all.", count(more)));
    }
    // Without constraints there is nothing to test, and p would be meaningless.
    if report.degrees > 0 {
        lines.line(format!(
            "All constraints: χ² {} with {} degrees of freedom, p = {}.",
            significant(report.chi_square, 3),
            report.degrees,
            significant(report.p_value, 2)
        ));
    }
}

/// Relations by outcome, and a table of those that were imposed.
fn relations(lines: &mut Lines, report: &ConstrainedReport) {
    // Outcomes are words of the JSON object.
    let with_outcome = |outcome: &str| -> Vec<&ReportedRelation> {
        report.relations.iter().filter(|r| r.outcome == outcome).collect()
    };
    let imposed = with_outcome("imposed");
    // Implied relations hold as well, but imposing them would add no rank.
    let implied = with_outcome("implied").len();
    if !report.relations.is_empty() {
        lines.line(format!(
            "{} of {} relations hold: {} imposed, {} implied by these ({} expected by chance).",
            count(imposed.len() + implied),
            count(report.relations.len()),
            count(imposed.len()),
            count(implied),
            // The number expected by chance shows how many of the relations may be accidents
            // (docs/decisions/0045-finding-constraints.md).
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
    // Each passed its own test, but not together with stronger relations.
    for relation in with_outcome("refused").into_iter().take(RELATIONS_SHOWN) {
        lines.line(format!("Rejected: {}, conflicts with {}.", relation.text, list(&relation.with)));
    }
}

/// A table of the sizes that were compared with the grid of `--snap`.
fn sizes(lines: &mut Lines, report: &ConstrainedReport) {
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
                outcome_text(size.outcome).to_owned(),
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

fn list(names: &[String]) -> String {
    match names {
        [] => "the given constraints".to_owned(),
        names => names.join("; "),
    }
}

fn outcome_text(outcome: SnapOutcome) -> &'static str {
    match outcome {
        SnapOutcome::Snapped => "snapped to the grid",
        SnapOutcome::Implied => "on the grid, implied by others",
        SnapOutcome::FixedOffGrid => "off the grid, fixed by others",
        SnapOutcome::OffGrid => "not snapped: no multiple fits",
        SnapOutcome::Ambiguous => "not snapped: σ is too large for this grid",
        SnapOutcome::Refused => "not snapped: conflicts with imposed constraints",
    }
}
