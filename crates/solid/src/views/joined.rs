//! Joins coordinates of a drawing that differ by less than a tolerance.
//!
//! Input: a drawing and a tolerance. Output: the same drawing, in which coordinates of one axis that are
//! at most the tolerance apart have the same value in all views: ends of lines, centres and extremes of
//! circles. Radii that are at most the tolerance apart are equal. Points along other curves are not changed.
//!
//! Rounded values of a circle are inconsistent: its centre plus its radius is not the coordinate of the line
//! that touches it. With values x of coordinates and radii, weighted by how often each is drawn, the changes
//! d minimise Σ wᵢ dᵢ² subject to A (x + d) = 0, a row of A for each circle and line that touch: centre ±
//! radius − coordinate. The rows are made orthogonal one after the other; those that depend on others are
//! left out.
//!
//! Not guaranteed: different coordinates may become equal. A sequence of values, each within the tolerance of
//! the next, becomes one value.

use crate::drawing::{Curve2, Drawing, ViewContent};
use planish_estimate::{Error, Result};
use std::collections::BTreeSet;

/// Limits of the decades of errors of coordinates, relative to the size of a drawing.
const MISMATCHES: [f64; 4] = [2e-7, 2e-5, 2e-4, 2e-3];
/// Maximum number of circles' extremes that are made consistent; the effort grows with its square.
const MAX_CIRCLE_ROWS: usize = 1000;

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
    let mut groups = coordinates(drawing).map(|values| grouped(values, tolerance));
    let radii = drawing.views.iter().flat_map(|v| &v.curves).filter_map(|c| match &c.curve {
        Curve2::Arc { radius, .. } => Some(*radius),
        _ => None,
    });
    let mut radii = grouped(radii.collect(), tolerance);
    make_circles_consistent(drawing, &mut groups, &mut radii, tolerance);
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
                    *center = [to(0, center[0]), to(1, center[1])];
                    *radius = representative(&radii, *radius);
                }
                Curve2::Chain(_) => {}
            }
        }
    }
    Ok(found)
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
fn nearest(groups: &[Group], value: f64, tolerance: f64) -> f64 {
    let off = |at: &f64| (at - value).abs();
    let nearest = groups.iter().map(|g| g.value).min_by(|a, b| off(a).total_cmp(&off(b)));
    nearest.filter(|at| off(at) <= tolerance).unwrap_or(value)
}

/// Values of which each is at most the tolerance from the next.
#[derive(Debug, Clone, Copy)]
struct Group {
    low: f64,
    high: f64,
    /// The value that replaces them.
    value: f64,
    count: usize,
}

/// Groups of values, ascending.
fn grouped(mut values: Vec<f64>, tolerance: f64) -> Vec<Group> {
    values.sort_by(f64::total_cmp);
    // Compared with the previous value, not with the first of the group: a fixed width would split values at
    // arbitrary places.
    let groups = values.chunk_by(|a, b| b - a <= tolerance);
    let one = |group: &[f64]| Group {
        low: group[0],
        high: group[group.len() - 1],
        value: most_frequent(group),
        count: group.len(),
    };
    groups.map(one).collect()
}

/// Changes values so that circles reach the lines that touch them.
fn make_circles_consistent(
    drawing: &Drawing,
    groups: &mut [Vec<Group>; 3],
    radii: &mut [Group],
    tolerance: f64,
) {
    let before = [groups[0].len(), groups[1].len(), groups[2].len()];
    let first = [0, before[0], before[0] + before[1], before.iter().sum::<usize>()];
    let mut rows: BTreeSet<[(usize, i8); 3]> = BTreeSet::new();
    for view in &drawing.views {
        let axes = view.kind.axes();
        for drawn in &view.curves {
            let Curve2::Arc { center, radius, .. } = &drawn.curve else { continue };
            let Some(r) = index_of(radii, *radius) else { continue };
            for (k, sign) in [(0, 1_i8), (0, -1), (1, 1), (1, -1)] {
                let own = &groups[axes[k]];
                let reach = center[k] + f64::from(sign) * radius;
                let (Some(c), Some(end)) = (index_of(own, center[k]), index_of(own, reach)) else { continue };
                // A coordinate of this circle alone is that of no line.
                if own[end].count > 1 && c != end {
                    let at = first[axes[k]];
                    rows.insert([(at + c, 1), (first[3] + r, sign), (at + end, -1)]);
                }
            }
        }
    }
    if rows.is_empty() || rows.len() > MAX_CIRCLE_ROWS {
        return;
    }
    let all = || groups.iter().flatten().chain(radii.iter());
    let roots: Vec<f64> = all().map(|g| (g.count as f64).sqrt()).collect();
    let old: Vec<f64> = all().map(|g| g.value).collect();
    let mut scaled: Vec<f64> = old.iter().zip(&roots).map(|(x, w)| x * w).collect();
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    for row in rows {
        let mut q = vec![0.0; old.len()];
        row.iter().for_each(|(k, sign)| q[*k] += f64::from(*sign) / roots[*k]);
        let length = dot(&q, &q).sqrt();
        // Twice, because once leaves rounding errors of nearly dependent rows.
        for _ in 0..2 {
            for other in &basis {
                let along = dot(&q, other);
                q.iter_mut().zip(other).for_each(|(q, o)| *q -= along * o);
            }
        }
        let left = dot(&q, &q).sqrt();
        if left > 1e-9 * length {
            q.iter_mut().for_each(|q| *q /= left);
            let along = dot(&scaled, &q);
            scaled.iter_mut().zip(&q).for_each(|(x, q)| *x -= along * q);
            basis.push(q);
        }
    }
    let new: Vec<f64> = scaled.iter().zip(&roots).map(|(x, w)| x / w).collect();
    // Otherwise lines and circles that only nearly touch would be bent together.
    if new.iter().zip(&old).all(|(a, b)| (a - b).abs() <= tolerance) {
        let values = groups.iter_mut().flatten().chain(radii);
        values.zip(new).for_each(|(group, value)| group.value = value);
    }
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

/// The group that contains a value.
fn index_of(groups: &[Group], value: f64) -> Option<usize> {
    let at = groups.partition_point(|g| g.high < value);
    groups.get(at).filter(|g| g.low <= value).map(|_| at)
}

fn representative(groups: &[Group], value: f64) -> f64 {
    index_of(groups, value).map_or(value, |at| groups[at].value)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{rectangle, segment};
    use super::super::{LineStyle, View, ViewKind, solve};
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
    fn rounded_circles_reach_the_lines_that_touch_them() {
        // A cylinder of radius 7 at (10, 10), in a block whose views are rounded to other steps.
        let drawing = |center: [f64; 2], radius: f64, side: [f64; 2]| {
            let circle = Curve2::Arc { center, radius, start: 0.0, sweep: std::f64::consts::TAU };
            let line = |x: f64| segment([x, 0.0], [x, 20.0], LineStyle::Hidden);
            let mut top = rectangle([0.0, 0.0], [30.0, 20.0]);
            top.push(super::super::DrawnCurve { curve: circle, ..line(0.0) });
            let mut front = rectangle([0.0, 0.0], [30.0, 20.0]);
            front.extend(side.map(line));
            let view = |kind, curves| View::new(kind, curves);
            Drawing { views: vec![view(ViewKind::Front, front), view(ViewKind::Top, top)] }
        };
        let rounded = drawing([10.0004, 9.9997], 6.9996, [3.0006, 16.9998]);
        let found = joined(&rounded, 0.002).unwrap();
        let Curve2::Arc { center, radius, .. } = found.views[1].curves[4].curve else { panic!() };
        for (k, sign) in [(4, -1.0), (5, 1.0)] {
            let Curve2::Segment(a, _) = found.views[0].curves[k].curve else { panic!() };
            assert!((center[0] + sign * radius - a[0]).abs() < 1e-12, "{a:?} {center:?} {radius}");
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
