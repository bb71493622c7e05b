//! The least edit of a drawing that no solid explains, in reports.

use super::UnexplainedLine;
use super::relaxed::with_tolerance;
use super::search::SearchedReading;
use super::sheet::ReadDrawing;
use planish_core::{Finding, FindingCode, Progress, Setting};
use planish_estimate::Result;
use planish_solid::drawing::LineStyle;
use planish_solid::repair::{Edit, EditKind, Repair, repair};
use planish_solid::views::{Solutions, coordinate_mismatches};
use serde::Serialize;

/// An edit of a line after which a drawing shows a solid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedEdit {
    /// `add`, `remove`, `move` or `restyle`.
    pub edit: &'static str,
    /// The view and the entity (none for an added line), and what is done to it, with its position.
    #[serde(flatten)]
    pub line: UnexplainedLine,
    /// Places along the line before the edit; those of the new line if it is added.
    pub places: Vec<[f64; 2]>,
    /// Places along the line after it is moved.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub moved_to: Vec<[f64; 2]>,
}

impl From<&Edit> for ReportedEdit {
    fn from(edit: &Edit) -> Self {
        let style = match edit.style {
            LineStyle::Visible => "visible",
            LineStyle::Hidden => "hidden",
        };
        let place = |places: &[[f64; 2]]| {
            places.first().map_or(String::new(), |at| format!(" {:.4} {:.4}", at[0], at[1]))
        };
        let at = place(&edit.places);
        let reason = match edit.kind {
            EditKind::Add => format!("add a {style} line through{at}"),
            EditKind::Remove => format!("remove the {style} line, or its part at{at}"),
            EditKind::Move => format!("move the {style} line at{at} to{}", place(&edit.moved_to)),
            EditKind::Restyle => format!("draw the line {style} at{at}"),
        };
        Self {
            edit: edit.kind.name(),
            line: UnexplainedLine { view: edit.view.name(), entity: edit.entity.clone(), reason },
            places: edit.places.clone(),
            moved_to: edit.moved_to.clone(),
        }
    }
}

/// A drawing, the solid that it shows after edits, and the edits.
pub(super) struct Repaired {
    pub reading: ReadDrawing,
    pub repair: Repair,
}

impl Repaired {
    pub(super) fn edits(&self) -> Vec<ReportedEdit> {
        self.repair.edits.iter().map(ReportedEdit::from).collect()
    }

    /// Whether the solid is written, or only the edits are listed.
    pub(super) fn finding(&self, is_written: bool) -> Finding {
        let edits = self.edits();
        let first = edits.first().map_or(String::new(), |edit| {
            let entity = edit.line.entity.as_ref().map_or(String::new(), |name| format!(" ({name})"));
            format!("in the {} view, {}{entity}", edit.line.view, edit.line.reason)
        });
        let more = match edits.len() {
            0 | 1 => String::new(),
            n => format!(", and {} more", n - 1),
        };
        let others = match self.repair.others {
            0 => String::new(),
            n => format!("; as few edits give {n} more"),
        };
        match is_written {
            true => {
                let text = format!("the solid is that of the drawing after edits: {first}{more}{others}");
                Finding::new(FindingCode::DrawingRepaired, text)
            }
            false => {
                let text = format!(
                    "the drawing shows a solid after edits: {first}{more}{others}; request a repair to \
                     write it"
                );
                Finding::new(FindingCode::RepairFound, text).with_setting(Setting::Repair)
            }
        }
    }

    /// The repaired drawing as the result of a search.
    pub(super) fn into_searched(self) -> SearchedReading {
        let found = Solutions { solutions: vec![self.repair.solution], ..Solutions::default() };
        SearchedReading { reading: self.reading, found, differences: vec![Vec::new()], undecided: None }
    }
}

/// The least edit of the most plausible reading of a drawing, as it is, or else with joined coordinates.
pub(super) fn repaired(
    readings: &[ReadDrawing],
    is_exact: bool,
    progress: &dyn Progress,
) -> Result<Option<Repaired>> {
    let Some(reading) = readings.first() else { return Ok(None) };
    // Each tolerance takes a search for each view, so only the largest is tried.
    let mismatch = match is_exact {
        true => None,
        false => coordinate_mismatches(&reading.drawing).pop(),
    };
    let joined = mismatch.and_then(|mismatch| with_tolerance(reading, mismatch));
    for reading in std::iter::once(reading.clone()).chain(joined) {
        progress.check("repairing", 0.5)?;
        // A solid without edits was left out by the search of all views: no edit explains the difference.
        if let Some(repair) = repair(&reading.drawing).filter(|repair| !repair.edits.is_empty()) {
            return Ok(Some(Repaired { reading, repair }));
        }
    }
    Ok(None)
}
