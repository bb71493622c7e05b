//! The solid that explains most lines of a picture, if none explains all.
//!
//! Traced lines may be missing, false, or in the wrong style. A solid without a few details is of more use
//! than none, so the nearest one is the result, with a finding that names what it does not explain.

use super::line_of;
use super::search::SearchedReading;
use super::sheet::ReadDrawing;
use super::silhouette::silhouette;
use planish_core::{Finding, FindingCode, Progress};
use planish_solid::drawing::{Drawing, LineStyle, ViewContent};
use planish_solid::reprojection::ReprojectionOptions;
use planish_solid::views::{NearestSolid, Solutions, joined, solve_nearest};

/// Minimum agreement of the lines of the solid with those of the picture. Solids of generated pictures with
/// an agreement of 0.39 to 0.54 had an intersection over union of 0.1 to 0.3: their views were read wrongly.
const MIN_AGREEMENT: f64 = 0.6;
/// Agreement from which on no other reading of the lines is tried.
const GOOD_AGREEMENT: f64 = 0.97;
/// Distance within which coordinates of a picture are the same, relative to the size of the drawing: about
/// 1.5 pixels.
const JOINED: f64 = 2e-3;
/// Tolerances of the comparison: places of traced lines have errors of up to two pixels.
const COMPARISON: ReprojectionOptions = ReprojectionOptions { near: 3e-3, shortest: 1e-2, spacing: 1e-2 };
/// Maximum number of differences that the finding names.
const MAX_NAMED: usize = 3;

/// The solid that explains most lines of the most plausible reading; none if it explains too few.
pub(super) fn nearest(readings: &[ReadDrawing], progress: &dyn Progress) -> Option<SearchedReading> {
    let mut reading = readings.first()?.clone();
    let mut best: Option<NearestSolid> = None;
    for variant in variants(&reading.drawing) {
        progress.check("searching", 0.5).ok()?;
        let Ok(Some(found)) = solve_nearest(&variant, &COMPARISON) else { continue };
        let found = NearestSolid::new(found.solution, &reading.drawing, &COMPARISON);
        if best.as_ref().is_none_or(|best| found.agreement > best.agreement) {
            best = Some(found);
        }
        if best.as_ref().is_some_and(|best| best.agreement >= GOOD_AGREEMENT) {
            break;
        }
    }
    let best = best.filter(|best| best.agreement >= MIN_AGREEMENT)?;
    reading.findings.push(finding(&best));
    let found = Solutions { solutions: vec![best.solution], complete: false, ..Solutions::default() };
    Some(SearchedReading { reading, found, differences: vec![Vec::new()], undecided: None })
}

/// The drawing as it is, with joined coordinates, without hidden lines, and the outer contours alone.
fn variants(drawing: &Drawing) -> Vec<Drawing> {
    let tolerance = JOINED * drawing.size();
    let mut all = vec![drawing.clone()];
    let mut longer = drawing.clone();
    longer.views.iter_mut().for_each(|view| view.curves.retain(|c| c.curve.length() > tolerance));
    all.extend(joined(&longer, tolerance));
    let mut visible = all[all.len() - 1].clone();
    for view in &mut visible.views {
        view.curves.retain(|c| c.style == LineStyle::Visible);
        if view.content == ViewContent::AllEdges {
            view.content = ViewContent::VisibleEdges;
        }
    }
    let mut contours = visible.clone();
    for view in &mut contours.views {
        view.curves = silhouette(view);
        // Nothing follows from lines that are missing.
        view.content = ViewContent::Doubtful;
    }
    all.extend([visible, contours]);
    all
}

/// What the solid does not explain.
fn finding(best: &NearestSolid) -> Finding {
    let share = (100.0 * best.agreement).floor();
    let named: Vec<String> = (best.differences.iter().take(MAX_NAMED))
        .map(|difference| {
            let line = line_of(difference);
            let entity = line.entity.map_or(String::new(), |name| format!(" ({name})"));
            format!("{} view: {}{entity}", line.view, line.reason)
        })
        .collect();
    let more = match best.differences.len().saturating_sub(MAX_NAMED) {
        0 => String::new(),
        n => format!("; and {n} more"),
    };
    let list = if named.is_empty() { String::new() } else { format!(": {}{more}", named.join("; ")) };
    let text = format!(
        "no solid explains all traced lines; the solid agrees with {share} % of their length, and details \
         may be missing or wrong{list}"
    );
    Finding::new(FindingCode::LinesUnexplained, text)
}
