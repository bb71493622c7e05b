//! What is tried if no solid explains all lines as they are drawn.
//!
//! 1. Coordinates that nearly agree are the same, with the smallest error that gives a solid; fragments that
//!    are shorter are dropped.
//! 2. Views that draw no hidden lines omit them. This comes first if no view draws any. The simplest solid
//!    is used: round holes go through unless a visible line shows where they end.
//!
//! Each is a finding.

use super::search::{SearchedReading, search_readings};
use super::sheet::ReadDrawing;
use planish_core::{Finding, FindingCode, Progress, Setting};
use planish_report::numbers::significant;
use planish_solid::brep::EdgeCurve;
use planish_solid::drawing::{Drawing, View, ViewContent};
use planish_solid::reprojection::{ReprojectionOptions, unseen_edges};
use planish_solid::sheet::hidden_circles;
use planish_solid::views::{LineStyle, coordinate_mismatches, joined};
use std::collections::BTreeSet;

/// Factor by which coordinates may differ more than those of the mismatch that is assumed.
const MARGIN: f64 = 1.1;

/// Maximum number of readings of a sheet that are relaxed, because each search takes time.
const MAX_READINGS: usize = 2;
/// Maximum number of searches with other styles.
const MAX_RESTYLED: usize = 5;

/// Searches a picture again with short lines in the other style, if the search names them: a line that is no
/// longer than a dash looks the same in both. None if no solid is found.
pub(super) fn search_restyled(
    readings: &[ReadDrawing],
    strict: Option<&SearchedReading>,
    progress: &dyn Progress,
) -> Option<SearchedReading> {
    let mut reading = readings.first().filter(|reading| !reading.open_styles.is_empty())?.clone();
    let mut open: BTreeSet<String> = reading.open_styles.iter().cloned().collect();
    let mut named = strict.map_or(BTreeSet::new(), |searched| named_by(searched, &open));
    let mut count = 0;
    for _ in 0..MAX_RESTYLED {
        // Without a name, all of them.
        let changed = if named.is_empty() { std::mem::take(&mut open) } else { named.clone() };
        if changed.is_empty() {
            return None;
        }
        count += changed.len();
        open.retain(|name| !changed.contains(name));
        for drawn in reading.drawing.views.iter_mut().flat_map(|view| &mut view.curves) {
            if changed.contains(&drawn.entity) {
                drawn.style = LineStyle::Hidden;
            }
        }
        let searched = search_readings(vec![reading.clone()], progress, |error, _| error);
        match searched {
            Ok(mut searched) if searched.is_solved() => {
                let text = format!(
                    "the views are those of a solid only if {count} lines that are no longer than a dash are \
                     hidden"
                );
                searched.reading.findings.push(Finding::new(FindingCode::DrawingInexact, text));
                return Some(searched);
            }
            Ok(searched) => named = named_by(&searched, &open),
            Err(_) => named.clear(),
        }
    }
    None
}

/// The entities among some that a search names.
fn named_by(searched: &SearchedReading, among: &BTreeSet<String>) -> BTreeSet<String> {
    let unexplained = searched.found.unexplained.iter().filter_map(|line| line.entity.clone());
    let differing = searched.differences.iter().flatten().filter_map(|line| line.entity.clone());
    unexplained.chain(differing).filter(|name| among.contains(name)).collect()
}

/// Searches the readings of a drawing with more and more freedom; none if no solid is found.
pub(super) fn search_relaxed(
    readings: &[ReadDrawing],
    is_exact: bool,
    progress: &dyn Progress,
) -> Option<SearchedReading> {
    let readings = &readings[..readings.len().min(MAX_READINGS)];
    // An error here has the same cause as that of the drawing as it is, which names the lines.
    let solved = |readings: Vec<ReadDrawing>| match readings.is_empty() {
        true => None,
        false => {
            search_readings(readings, progress, |error, _| error).ok().filter(SearchedReading::is_solved)
        }
    };
    // Views without any hidden line usually omit them. Otherwise a coordinate is the more likely error.
    let omits_all = |reading: &ReadDrawing| !reading.drawing.views.iter().any(View::has_hidden_lines);
    let omits_all = readings.first().is_some_and(omits_all);
    let visible = || solved(readings.iter().filter_map(without_hidden).collect());
    let mut by_visible = if omits_all { visible() } else { None };
    if let Some(found) = by_visible.take_if(|found| !found.found.has_unseen_faces) {
        return Some(judged_by_visible(found));
    }
    let mismatches = match is_exact {
        true => Vec::new(),
        false => readings.first().map_or(Vec::new(), |first| coordinate_mismatches(&first.drawing)),
    };
    for mismatch in mismatches {
        let joined = readings.iter().filter_map(|reading| with_tolerance(reading, mismatch));
        if let Some(found) = solved(joined.collect()) {
            return Some(found);
        }
    }
    by_visible.or_else(|| if omits_all { None } else { visible() }).map(judged_by_visible)
}

/// A result of views without hidden lines, which is not written if nothing shows where a part of it ends.
fn judged_by_visible(mut searched: SearchedReading) -> SearchedReading {
    searched.undecided = open_end(&searched);
    searched
}

/// The reading with coordinates joined that differ by at most a mismatch.
pub(super) fn with_tolerance(reading: &ReadDrawing, mismatch: f64) -> Option<ReadDrawing> {
    let tolerance = MARGIN * mismatch;
    let mut drawing = reading.drawing.clone();
    let mut dropped = 0;
    for view in &mut drawing.views {
        let count = view.curves.len();
        view.curves.retain(|drawn| drawn.curve.length() > tolerance);
        dropped += count - view.curves.len();
    }
    let drawing = joined(&drawing, tolerance).ok()?;
    let fragments = match dropped {
        0 => String::new(),
        n => format!(", and {n} lines that are shorter were left out"),
    };
    let text = format!(
        "the views are those of a solid only if coordinates that differ by up to {} are the same{fragments}",
        significant(tolerance, 2)
    );
    let mut findings = reading.findings.clone();
    findings.push(Finding::new(FindingCode::ToleranceEstimated, text).with_setting(Setting::Tolerance));
    Some(ReadDrawing { drawing, findings, ..reading.clone() })
}

/// What the visible lines leave open of a solid; none if they determine it.
fn open_end(searched: &SearchedReading) -> Option<String> {
    let first = searched.differences.iter().position(Vec::is_empty)?;
    let (solid, reading) = (&searched.found.solutions[first].solid, &searched.reading);
    let [planes, ..] = solid.faces_by_kind();
    if reading.has_centre_lines && planes == solid.faces.len() {
        let text = "the views draw no hidden lines, and centre lines show something round that no visible \
                    line shows: add hidden lines or a section";
        return Some(text.to_owned());
    }
    let explained = searched.differences.iter().filter(|differences| differences.is_empty()).count();
    if explained > 1 {
        return Some(format!(
            "{explained} solids have the visible lines, and no hidden lines distinguish them: add hidden \
             lines or a section"
        ));
    }
    // Round holes usually go through. A window and a pocket with straight sides are equally plausible.
    let is_straight = |edge: &usize| matches!(solid.edges[*edge].curve, EdgeCurve::Line { .. });
    let open = unseen_edges(solid, &reading.drawing, &ReprojectionOptions::default());
    let edge = &solid.edges[open.into_iter().find(|k| searched.found.has_unseen_faces || is_straight(k))?];
    let [x, y, z] = edge.curve.point(0.5 * (edge.range[0] + edge.range[1])).to_array();
    Some(format!(
        "the views draw no hidden lines, and none of them shows where the solid ends at {x:.4} {y:.4} \
         {z:.4}, such as the depth of a hole: add hidden lines or a section"
    ))
}

/// Whether a view may omit hidden lines.
fn may_omit(view: &View) -> bool {
    view.shows_hidden_edges() && !view.has_hidden_lines()
}

/// The reading with views that may omit hidden lines; none if there are none.
fn without_hidden(reading: &ReadDrawing) -> Option<ReadDrawing> {
    let mut drawing: Drawing = reading.drawing.clone();
    let mut named = Vec::new();
    for view in drawing.views.iter_mut().filter(|view| may_omit(view)) {
        view.content = ViewContent::VisibleEdges;
        named.push(view.kind.name());
    }
    if named.is_empty() {
        return None;
    }
    let candidates = hidden_circles(&drawing);
    drawing.views.extend(candidates);
    let text = format!(
        "no hidden lines are drawn in the {} view{}, but the solid has hidden edges there: what only hidden \
         lines would show, such as the depth of a hole, is not determined; the simplest solid is used",
        named.join(" and the "),
        if named.len() > 1 { "s" } else { "" }
    );
    let mut findings = reading.findings.clone();
    findings.push(Finding::new(FindingCode::HiddenLinesOmitted, text));
    Some(ReadDrawing { drawing, findings, ..reading.clone() })
}
