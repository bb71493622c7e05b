//! Summaries of `planish next`.

use crate::lines::{Align, Lines};
use crate::numbers::{count, counted, percent, significant};
use planish::next::{Change, NextJobReport, NextViewsJobReport};

fn changes(lines: &mut Lines, worst: Change, mean: Change) {
    for (name, change) in [("Largest σ", worst), ("Root mean square σ", mean)] {
        lines.line(format!(
            "{name}: {} before, {} after.",
            significant(change.before, 3),
            significant(change.after, 3)
        ));
    }
}

fn already_reached(worst: Change, mean: Change) -> String {
    let mut lines = Lines::default();
    lines.line("The model already reaches the goal: no further measurements are required.");
    lines.gap();
    changes(&mut lines, worst, mean);
    lines.into_text()
}

/// The summary of planned points.
pub fn points_text(report: &NextJobReport) -> String {
    let next = &report.next;
    let mut lines = Lines::default();
    if next.points.is_empty() && next.reached_goal == Some(true) {
        return already_reached(next.worst_sigma, next.mean_sigma);
    }
    lines.line(format!(
        "{} points to measure with σ {} {}, best first.",
        count(next.points.len()),
        significant(next.sigma, 3),
        report.unit
    ));
    lines.gap();
    // Five digits place a probe to a ten-thousandth of the coordinates; the files have all digits.
    let number = |x: f64| significant(x, 5);
    let rows: Vec<Vec<String>> = (1..)
        .zip(&next.points)
        .map(|(k, p): (usize, _)| {
            let normal = p.normal.to_array().map(|c| format!("{c:.2}")).join(" ");
            let mut row = vec![k.to_string()];
            row.extend(p.position.to_array().map(number));
            row.extend([normal, significant(p.sigma_before, 3), significant(p.sigma_after, 3)]);
            row
        })
        .collect();
    lines.table(
        &[
            ("", Align::Right),
            ("x", Align::Right),
            ("y", Align::Right),
            ("z", Align::Right),
            ("normal", Align::Left),
            ("σ before", Align::Right),
            ("σ after", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    changes(&mut lines, next.worst_sigma, next.mean_sigma);
    // The last entry is for as many points as were chosen.
    if let Some(random) = &next.random
        && let Some(median) = random.worst_sigma_median.last()
    {
        lines.line(format!(
            "With {} random sets of as many points, the median of the largest σ is {}.",
            random.draws,
            significant(*median, 3)
        ));
    }
    lines.into_text()
}

/// The summary of planned views.
pub fn views_text(report: &NextViewsJobReport) -> String {
    let next = &report.next;
    let mut lines = Lines::default();
    if next.views.is_empty() && next.reached_goal == Some(true) {
        return already_reached(next.worst_sigma, next.mean_sigma);
    }
    lines.line(format!(
        "{} to take, best first, of {} candidate poses. Lengths in {}.",
        counted(next.views.len(), "view"),
        count(next.candidates),
        report.unit
    ));
    lines.gap();
    let rows: Vec<Vec<String>> = (1..)
        .zip(&next.views)
        .map(|(k, v): (usize, _)| {
            let mut row = vec![k.to_string()];
            row.extend(v.translation.to_array().map(|x| significant(x, 5)));
            // Four decimals of a unit quaternion are about 0.01°, enough to recognise a pose; the files have
            // all digits.
            row.extend([
                v.quaternion_xyzw.map(|c| format!("{c:.4}")).join(" "),
                count(v.readings),
                percent(v.seen),
                percent(v.seen_so_far),
                significant(v.worst_sigma_after, 3),
                significant(v.mean_sigma_after, 3),
            ]);
            row
        })
        .collect();
    lines.table(
        &[
            ("", Align::Right),
            ("x", Align::Right),
            ("y", Align::Right),
            ("z", Align::Right),
            ("quaternion x y z w", Align::Left),
            ("readings", Align::Right),
            ("visible", Align::Right),
            ("visible so far", Align::Right),
            ("largest σ", Align::Right),
            ("rms σ", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    changes(&mut lines, next.worst_sigma, next.mean_sigma);
    // More views cannot lower this σ, so the user needs another sensor position or range.
    if let Some(place) = &next.worst_unseen {
        lines.line(format!(
            "{} of the area is visible from no pose; σ there is up to {}, at {}.",
            percent(next.unseen),
            significant(place.sigma, 3),
            place.position.to_array().map(|x| significant(x, 4)).join(" ")
        ));
    }
    lines.into_text()
}
