//! Joins coordinates of a drawing that differ by less than a tolerance.
//!
//! Input: a drawing and a tolerance. Output: the same drawing, in which coordinates of one axis that are
//! at most the tolerance apart have the same value in all views: ends of lines, centres and extremes of
//! circles. Points along other curves are not changed.
//!
//! Not guaranteed: different coordinates may become equal. A sequence of values, each within the tolerance of
//! the next, becomes one value.

use crate::drawing::{Curve2, Drawing, ViewContent};
use planish_estimate::{Error, Result};

/// Limits of the decades of errors of coordinates, relative to the size of a drawing.
const MISMATCHES: [f64; 4] = [2e-7, 2e-5, 2e-4, 2e-3];

/// Joins coordinates that are at most `tolerance` apart, in the unit of the drawing.
///
/// ```
/// use planish_solid::views::{Curve2, Drawing, DrawnCurve, LineStyle, View, ViewKind, joined};
///
/// let line = |a, b| DrawnCurve {
///     curve: Curve2::Segment(a, b),
///     style: LineStyle::Visible,
///     entity: "LINE".to_owned(),
/// };
/// // The second line begins 0.001 beside the end of the first.
/// let curves = vec![line([0.0, 0.0], [40.0, 0.0]), line([40.001, 0.0], [40.0, 20.0])];
/// let drawing = Drawing { views: vec![View::new(ViewKind::Front, curves)] };
/// let joined = joined(&drawing, 0.01)?;
/// assert_eq!(joined.views[0].curves[1].curve, Curve2::Segment([40.0, 0.0], [40.0, 20.0]));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # Errors
/// `Input` if the tolerance is not positive or exceeds a hundredth of the drawing's size, or if a line would
/// lose its length. The message names the line.
pub fn joined(drawing: &Drawing, tolerance: f64) -> Result<Drawing> {
    let size = drawing.size();
    if !(tolerance > 0.0 && tolerance <= 0.01 * size) {
        return Err(Error::input(format!(
            "expected a tolerance above 0 and at most a hundredth of the drawing ({:.3e}), found \
             {tolerance:e}",
            0.01 * size
        )));
    }
    let values = coordinates(drawing);
    let mut groups = values.map(|values| grouped(values, tolerance));
    put_ends_on_circles(drawing, &mut groups, tolerance);
    let mut found = drawing.clone();
    for view in &mut found.views {
        let axes = view.kind.axes();
        if let ViewContent::Section(section) = &mut view.content {
            section.at = nearest(&groups[axes[2]], section.at, tolerance);
        }
        let to = |k: usize, value: f64| representative(&groups[axes[k]], value);
        for drawn in &mut view.curves {
            match &mut drawn.curve {
                Curve2::Segment(a, b) => {
                    let ends = [*a, *b];
                    (*a, *b) = ([to(0, a[0]), to(1, a[1])], [to(0, b[0]), to(1, b[1])]);
                    // A line that had no length before is harmless and stays.
                    if a == b && ends[0] != ends[1] {
                        return Err(Error::input(format!(
                            "expected lines longer than the tolerance {tolerance:e}, found {}: reduce the \
                             tolerance, or remove this line",
                            drawn.entity
                        )));
                    }
                }
                Curve2::Arc { center, radius, .. } => {
                    // The radius follows from joined coordinates: tangent lines then still touch the circle.
                    let reach = to(0, center[0] + *radius) - to(0, center[0]);
                    *center = [to(0, center[0]), to(1, center[1])];
                    *radius = if reach > 0.0 { reach } else { *radius };
                }
                Curve2::Chain(_) => {}
            }
        }
    }
    Ok(found)
}

/// Replaces the coordinate of a line along an axis where it ends at a circle, by that of the intersection.
///
/// Centres, radii and lines have designed coordinates; their intersections are rounded in files.
/// The search computes them from circle and line, and would find an end beside them.
fn put_ends_on_circles(drawing: &Drawing, groups: &mut [Vec<[f64; 3]>; 3], tolerance: f64) {
    let joined = groups.clone();
    for view in &drawing.views {
        let axes = view.kind.axes();
        let to = |k: usize, value: f64| representative(&joined[axes[k]], value);
        for drawn in &view.curves {
            let Curve2::Segment(a, b) = &drawn.curve else { continue };
            // The coordinate that is the same at both ends.
            let Some(level) = (0..2).find(|k| (a[*k] - b[*k]).abs() <= tolerance && a[1 - k] != b[1 - k])
            else {
                continue;
            };
            for end in [a, b] {
                for other in &view.curves {
                    let Curve2::Arc { center, radius, .. } = &other.curve else { continue };
                    let off = to(level, end[level]) - to(level, center[level]);
                    let half = (radius * radius - off * off).max(0.0).sqrt();
                    // Near the point where the line is tangent, the intersection is uncertain.
                    if half < 0.1 * radius {
                        continue;
                    }
                    let middle = to(1 - level, center[1 - level]);
                    let value = end[1 - level];
                    let at = if value > middle { middle + half } else { middle - half };
                    if (at - value).abs() > tolerance {
                        continue;
                    }
                    let known = &mut groups[axes[1 - level]];
                    let place = known.partition_point(|g| g[1] < value);
                    if let Some(group) = known.get_mut(place).filter(|g| g[0] <= value) {
                        group[2] = at;
                    }
                }
            }
        }
    }
}

/// Coordinates of each axis, of ends of lines, and of centres and extremes of circles.
fn coordinates(drawing: &Drawing) -> [Vec<f64>; 3] {
    let mut values: [Vec<f64>; 3] = Default::default();
    for view in &drawing.views {
        let axes = view.kind.axes();
        for drawn in &view.curves {
            for k in 0..2 {
                match &drawn.curve {
                    Curve2::Segment(a, b) => values[axes[k]].extend([a[k], b[k]]),
                    Curve2::Arc { center, radius, .. } => {
                        values[axes[k]].extend([center[k] - radius, center[k], center[k] + radius]);
                    }
                    Curve2::Chain(_) => {}
                }
            }
        }
    }
    values
}

/// Errors of coordinates that a drawing may have, ascending: differences of neighbouring coordinates of an
/// axis, the largest of each decade.
///
/// Differences below 2·10⁻⁷ of the size are equal for the search anyway, and those above 2·10⁻³ are taken as
/// intended.
#[must_use]
pub fn coordinate_mismatches(drawing: &Drawing) -> Vec<f64> {
    let size = drawing.size();
    let mut largest = [0.0_f64; MISMATCHES.len() - 1];
    for mut values in coordinates(drawing) {
        values.sort_by(f64::total_cmp);
        for gap in values.windows(2).map(|pair| pair[1] - pair[0]) {
            let is_in = |k: &usize| gap > MISMATCHES[*k] * size && gap <= MISMATCHES[k + 1] * size;
            if let Some(k) = (0..largest.len()).find(is_in) {
                largest[k] = largest[k].max(gap);
            }
        }
    }
    largest.into_iter().filter(|gap| *gap > 0.0).collect()
}

/// The representative of the group nearest to a value, if one is within the tolerance.
fn nearest(groups: &[[f64; 3]], value: f64, tolerance: f64) -> f64 {
    let nearest = groups.iter().map(|g| g[2]).min_by(|a, b| (a - value).abs().total_cmp(&(b - value).abs()));
    nearest.filter(|at| (at - value).abs() <= tolerance).unwrap_or(value)
}

/// Groups of values, each at most the tolerance from the next: minimum, maximum and representative of each,
/// ascending.
fn grouped(mut values: Vec<f64>, tolerance: f64) -> Vec<[f64; 3]> {
    values.sort_by(f64::total_cmp);
    let mut groups: Vec<Vec<f64>> = Vec::new();
    for value in values {
        // Compared with the previous value, not with the first of the group: a fixed width would split values
        // at arbitrary places.
        match groups.last_mut() {
            Some(group) if value - group[group.len() - 1] <= tolerance => group.push(value),
            _ => groups.push(vec![value]),
        }
    }
    let one = |group: Vec<f64>| [group[0], group[group.len() - 1], most_frequent(&group)];
    groups.into_iter().map(one).collect()
}

/// The most frequent value; of equally frequent ones, that with the fewest decimals, then the smallest.
fn most_frequent(group: &[f64]) -> f64 {
    let count = |v: f64| group.iter().filter(|w| **w == v).count();
    let decimals = |v: f64| {
        let is_integer = |d: &i32| {
            let scaled = v * 10_f64.powi(*d);
            (scaled - scaled.round()).abs() < 1e-6
        };
        (0..9).find(is_integer).unwrap_or(9)
    };
    let key = |v: f64| (std::cmp::Reverse(count(v)), decimals(v));
    group.iter().copied().min_by_key(|v| key(*v)).unwrap_or(0.0)
}

/// The representative of the group that contains a value.
fn representative(groups: &[[f64; 3]], value: f64) -> f64 {
    let at = groups.partition_point(|g| g[1] < value);
    groups.get(at).filter(|g| g[0] <= value).map_or(value, |g| g[2])
}

#[cfg(test)]
mod tests {
    use super::super::tests::{rectangle, segment};
    use super::super::{DrawnCurve, LineStyle, View, ViewKind, solve};
    use super::*;

    fn block(gap: f64, scale: f64) -> Drawing {
        let view = |kind, curves| View::new(kind, curves);
        let mut front = rectangle([0.0, 0.0], [40.0, 20.0]);
        front[0] = segment([0.0, 0.0], [40.0 - gap, 0.0], LineStyle::Visible);
        Drawing {
            views: vec![
                view(ViewKind::Front, front),
                view(ViewKind::Top, rectangle([0.0, 0.0], [40.0 * scale, 30.0 * scale])),
                view(ViewKind::Side, rectangle([0.0, 0.0], [30.0, 20.0])),
            ],
        }
    }

    #[test]
    fn gaps_and_scale_errors_below_the_tolerance_still_give_the_solid() {
        for (drawing, tolerance) in [(block(1e-3, 1.0), 2e-3), (block(0.0, 1.001), 0.05)] {
            let best = solve(&joined(&drawing, tolerance).unwrap()).unwrap().solutions.remove(0);
            assert!((best.measures.volume - 24_000.0).abs() < 1e-6, "{}", best.measures.volume);
        }
    }

    #[test]
    fn a_line_shorter_than_the_tolerance_is_rejected_by_name() {
        let mut drawing = block(0.0, 1.0);
        let mut short = segment([10.0, 0.0], [10.0, 0.1], LineStyle::Visible);
        short.entity = "LINE 2A".to_owned();
        drawing.views[0].curves.push(short);
        let message = joined(&drawing, 0.2).unwrap_err().to_string();
        assert!(message.contains("found LINE 2A"), "{message}");
        assert!(joined(&drawing, 1.0).is_err() && joined(&drawing, 0.0).is_err());
    }

    #[test]
    fn rounded_ends_of_lines_are_put_on_their_circle() {
        // A shaft of diameter 10 along z with a flat at y = 8.1, which ends at 5 ± √(25 − 3.1²), rounded.
        let half = (25.0_f64 - 3.1 * 3.1).sqrt();
        let rounded = (half * 1e3).round() / 1e3;
        let circle = Curve2::Arc { center: [5.0, 5.0], radius: 5.0, start: 0.0, sweep: 1.0 };
        let flat = segment([5.0 - rounded, 8.1], [5.0 + rounded, 8.1], LineStyle::Visible);
        let arc = DrawnCurve { curve: circle, ..flat.clone() };
        let drawing = Drawing { views: vec![View::new(ViewKind::Top, vec![flat, arc])] };
        let Curve2::Segment(a, b) = joined(&drawing, 1e-3).unwrap().views[0].curves[0].curve.clone() else {
            panic!("expected a segment");
        };
        assert!((b[0] - a[0] - 2.0 * half).abs() < 1e-12 && (rounded - half).abs() > 1e-6);
    }

    #[test]
    fn mismatches_are_the_differences_that_a_tolerance_must_bridge() {
        assert!(coordinate_mismatches(&block(0.0, 1.0)).is_empty());
        for drawing in [block(1e-3, 1.0), block(0.0, 1.001)] {
            assert!(solve(&drawing).map_or(true, |found| !found.unexplained.is_empty()));
            let found = coordinate_mismatches(&drawing);
            let tolerance = 1.1 * found[found.len() - 1];
            let best = solve(&joined(&drawing, tolerance).unwrap()).unwrap().solutions.remove(0);
            assert!((best.measures.volume - 24_000.0).abs() < 1e-6, "{}", best.measures.volume);
        }
        // A step of a hundredth of the size is intended.
        assert!(coordinate_mismatches(&block(0.4, 1.0)).is_empty());
    }
}
