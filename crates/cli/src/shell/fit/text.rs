//! The summary of `planish shell fit`.

use crate::lines::{Align, Lines};
use crate::numbers::{count, counted, significant};
use planish::shell::fit::{ReadingsReport, ShellFitReport};

/// The summary of a fitted mesh.
pub fn text(report: &ShellFitReport) -> String {
    let mut lines = Lines::default();
    let unit = report.unit;
    lines.line(format!(
        "Fitted a mesh with {} in {}.",
        counted(report.controls, "control"),
        counted(report.iterations, "iteration")
    ));
    lines.gap();
    // Tables without rows are left out: a fit has points, outlines or both, and only sequences have frames.
    readings(&mut lines, report);
    if !report.iou.is_empty() {
        overlaps(&mut lines, report);
    }
    if !report.frames.is_empty() {
        frames(&mut lines, report);
    }
    if !report.poses.is_empty() {
        poses(&mut lines, report);
    }
    lines.facts([
        (
            "σ where measured",
            format!(
                "median {} {unit}, 95 % below {}, largest {}",
                significant(report.sigma.median, 3),
                significant(report.sigma.p95, 3),
                significant(report.sigma.max, 3)
            ),
        ),
        ("measured", format!("{:.1} % of the vertices", 100.0 * report.observed_fraction)),
    ]);
    lines.into_text()
}

/// A table of the kinds of readings.
fn readings(lines: &mut Lines, report: &ShellFitReport) {
    let unit = report.unit;
    // Each kind has its own unit, so the unit is in the cell and not in the heading.
    let row = |name: &str, r: &Option<ReadingsReport>, unit: &str| {
        r.as_ref().map(|r| {
            vec![
                name.to_owned(),
                count(r.count),
                count(r.outliers),
                format!("{} {unit}", significant(r.rms, 3)),
                significant(r.sigma_factor, 3),
            ]
        })
    };
    let rows: Vec<Vec<String>> = [
        row("points", &report.points, &unit.to_string()),
        row("outlines", &report.outlines, "px"),
        row("tracks", &report.tracks, "σ"),
        row("landmarks", &report.landmarks, &unit.to_string()),
    ]
    .into_iter()
    .flatten()
    .collect();
    lines.table(
        &[
            ("", Align::Left),
            ("readings", Align::Right),
            ("outliers", Align::Right),
            ("rms", Align::Right),
            ("σ estimated/stated", Align::Right),
        ],
        &rows,
    );
    lines.gap();
}

/// A table of the intersection over union of outlines and masks.
fn overlaps(lines: &mut Lines, report: &ShellFitReport) {
    let rows: Vec<Vec<String>> = (report.iou.iter())
        .map(|(view, iou)| {
            vec![
                view.clone(),
                // Both maps have the same views, so the index cannot fail.
                significant(report.iou_before[view], 3),
                significant(*iou, 3),
                // A held-out view is the only independent check of a fit to silhouettes.
                if report.held_out.contains(view) { "held out".to_owned() } else { String::new() },
            ]
        })
        .collect();
    lines.table(
        &[("view", Align::Left), ("IoU before", Align::Right), ("after", Align::Right), ("", Align::Left)],
        &rows,
    );
    lines.gap();
}

/// A table of the frames of a sequence.
fn frames(lines: &mut Lines, report: &ShellFitReport) {
    let unit = report.unit;
    // A frame may lack points or views, and the first frame has no prediction to deviate from.
    let shown = |value: Option<f64>| value.map_or_else(String::new, |value| significant(value, 3));
    let rows: Vec<Vec<String>> = (report.frames.iter())
        .map(|frame| {
            vec![
                frame.frame.clone(),
                shown(frame.rms_points),
                shown(frame.rms_silhouettes_px),
                shown(frame.iou),
                shown(frame.prediction_error),
                significant(frame.sigma, 3),
            ]
        })
        .collect();
    let (rms_points, sigma) = (format!("rms points / {unit}"), format!("σ / {unit}"));
    lines.table(
        &[
            ("frame", Align::Left),
            (&rms_points, Align::Right),
            ("rms outlines px", Align::Right),
            ("IoU", Align::Right),
            ("deviation/σ", Align::Right),
            (&sigma, Align::Right),
        ],
        &rows,
    );
    lines.gap();
}

/// A table of the estimated poses of cameras.
fn poses(lines: &mut Lines, report: &ShellFitReport) {
    let unit = report.unit;
    // One σ for three axes: the largest one is on the safe side.
    let largest = |values: [f64; 3]| significant(values.into_iter().fold(0.0, f64::max), 2);
    let rows: Vec<Vec<String>> = (report.poses.iter())
        .map(|pose| {
            vec![
                pose.view.clone(),
                format!("{}°", significant(pose.turned_deg, 3)),
                format!("{}°", largest(pose.sigma_rotation_deg)),
                significant(pose.moved, 3),
                largest(pose.sigma_translation),
            ]
        })
        .collect();
    let moved = format!("moved / {unit}");
    lines.table(
        &[
            ("camera", Align::Left),
            ("rotated", Align::Right),
            ("σ", Align::Right),
            (&moved, Align::Right),
            ("σ", Align::Right),
        ],
        &rows,
    );
    lines.gap();
}
