//! Drawings without hidden lines: if no solid explains all lines, views that draw none may omit them.

use super::sheet::ReadDrawing;
use super::{SearchedReading, search_readings};
use planish_core::{Finding, FindingCode, Progress};
use planish_solid::drawing::{Drawing, View, ViewContent};

/// Whether a view may omit hidden lines.
fn may_omit(view: &View) -> bool {
    view.shows_hidden_edges() && !view.has_hidden_lines()
}

/// The drawing with views that may omit hidden lines; none if there are none.
fn without_hidden(drawing: &Drawing) -> Option<Drawing> {
    let mut drawing = drawing.clone();
    let mut is_changed = false;
    for view in drawing.views.iter_mut().filter(|view| may_omit(view)) {
        view.content = ViewContent::VisibleEdges;
        is_changed = true;
    }
    is_changed.then_some(drawing)
}

/// Searches the readings for a solid that has hidden edges in views that draw no hidden lines.
pub(super) fn search_without_hidden(
    readings: Vec<ReadDrawing>,
    progress: &dyn Progress,
) -> Option<SearchedReading> {
    let readings: Vec<ReadDrawing> = readings
        .into_iter()
        .filter_map(|reading| {
            let drawing = without_hidden(&reading.drawing)?;
            let named: Vec<&str> =
                reading.drawing.views.iter().filter(|v| may_omit(v)).map(|v| v.kind.name()).collect();
            let text = format!(
                "no hidden lines are drawn in the {} view{}, and the solid has hidden edges there: what only \
                 hidden lines would show is not determined",
                named.join(" and the "),
                if named.len() > 1 { "s" } else { "" }
            );
            let mut findings = reading.findings;
            findings.push(Finding::new(FindingCode::HiddenLinesOmitted, text));
            Some(ReadDrawing { drawing, findings, ..reading })
        })
        .collect();
    if readings.is_empty() {
        return None;
    }
    // An error here has the same cause as that of the drawing as it is, which names the lines.
    search_readings(readings, progress, |error, _| error).ok().filter(SearchedReading::is_solved)
}
