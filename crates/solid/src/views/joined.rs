//! Joins coordinates of a drawing that differ by less than a tolerance, and makes rounded ones consistent.
//!
//! Input: a drawing and a tolerance. Output: the same drawing, in which coordinates of one axis that are
//! at most the tolerance apart have the same value in all views: ends of lines, centres and extremes of
//! circles. Radii that are at most the tolerance apart are equal. Points along other curves are not changed.
//!
//! Rounded values are inconsistent: the end of a slanted line is not on the circle that it touches. The
//! values are changed as little as possible so that such conditions hold ([`super::relations`]).
//!
//! Not guaranteed: different coordinates may become equal. A sequence of values, each within the tolerance of
//! the next, becomes one value.

use super::relations::{CoordinateErrors, Coordinates, conditions};
use super::tidy;
use crate::drawing::{Curve2, Drawing, ViewContent, distance};
use planish_estimate::{Error, Result, adjusted_without_conflicts};
use std::f64::consts::{PI, TAU};

/// Limits of the decades of errors of coordinates, relative to the size of a drawing.
const MISMATCHES: [f64; 4] = [2e-7, 2e-5, 2e-4, 2e-3];
/// Maximum residual of a condition that is met, relative to the size. The search needs 1e-7.
const SOLVED: f64 = 1e-11;
/// Steps of rounded coordinates that are recognised, in the unit of the drawing: three to five decimals.
const STEPS: [f64; 3] = [1e-3, 1e-4, 1e-5];
/// The steps of sheets in other scales, 1:2 and 2:1. They are recognised if [`MIN_OTHER`] different values
/// are no multiples of [`DESIGNED`]: a few values with four decimals may also be multiples of 0.0005.
const OTHER_STEPS: [f64; 4] = [2e-3, 5e-4, 2e-4, 5e-5];
/// See [`OTHER_STEPS`].
const MIN_OTHER: usize = 6;
/// Coordinates that are multiples of this are taken as designed, not as rounded.
const DESIGNED: f64 = 1e-2;
/// Maximum step relative to the size. Coarser drawings may be exact.
const MAX_STEP: f64 = 2e-5;
/// Maximum error of the extreme of a circle beside the line that shows it in another view, in steps.
const TOLERANCE_STEPS: f64 = 4.0;
/// Rounded coordinates of a value differ by at most two steps: each has an error of half a step, and so has
/// the corner of its view.
const SAME_STEPS: f64 = 2.1;
/// Standard deviation of a rounded coordinate in steps: 1/√12 for the value, and for the corner of its view.
const SIGMA_STEPS: f64 = 0.41;
/// Standard deviation of coordinates whose tolerance is given, in tolerances.
const SIGMA: f64 = 0.1;
/// Maximum change of a point of a rounded drawing, in steps: ends of arcs at small angles move most.
const MAX_CHANGE_STEPS: f64 = 200.0;
/// Maximum distance of a fragment from the curve on which it lies, in tolerances: both have errors. Fragments
/// of Open Cascade with four decimals were up to 1.2 tolerances off.
const FRAGMENT_ERROR: f64 = 2.0;
/// Changes that the search does not need, relative to the size and as a length (six decimals).
const NEGLIGIBLE: [f64; 2] = [1e-7, 2e-6];

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
    joined_within(drawing, CoordinateErrors { tolerance, same: tolerance, sigma: SIGMA * tolerance })
}

/// Joins coordinates with the same value, and makes them consistent.
fn joined_within(drawing: &Drawing, errors: CoordinateErrors) -> Result<Drawing> {
    let (size, tolerance) = (drawing.size(), errors.tolerance);
    let coordinates = Coordinates::new(drawing, errors);
    let conditions = conditions(drawing, &coordinates, tolerance);
    let sigmas = coordinates.sigmas();
    let start = &coordinates.values;
    let found = adjusted_without_conflicts(start, &sigmas, conditions, SOLVED * size, |_| tolerance);
    let mut joined = drawing.clone();
    for view in &mut joined.views {
        let axes = view.kind.axes();
        let to = |axis: usize, value: f64| coordinates.index(axis, value).map_or(value, |k| found[k]);
        if let ViewContent::Section(section) = &mut view.content {
            section.at = to(axes[2], section.at);
        }
        let point = |p: [f64; 2]| [0, 1].map(|k| to(axes[k], p[k]));
        for drawn in &mut view.curves {
            match &mut drawn.curve {
                Curve2::Segment(a, b) => {
                    let ends = [*a, *b];
                    (*a, *b) = (point(*a), point(*b));
                    // A line that had no length before is harmless and stays.
                    if a == b && ends[0] != ends[1] {
                        return Err(Error::input(format!(
                            "expected lines longer than the tolerance {tolerance:e}, found {}: reduce the \
                             tolerance, or remove this line",
                            drawn.entity
                        )));
                    }
                }
                Curve2::Arc { center, radius, start, sweep } => {
                    let ends = [*start, *start + *sweep].map(|t| on_circle(*center, *radius, t)).map(point);
                    *center = point(*center);
                    *radius = coordinates.radius(*radius).map_or(*radius, |k| found[k]);
                    if *sweep < TAU - 1e-9 {
                        (*start, *sweep) = between(*center, ends, *start, *sweep);
                    }
                }
                Curve2::Chain(_) => {}
            }
        }
    }
    Ok(joined)
}

/// The point of a circle at an angle.
fn on_circle(center: [f64; 2], radius: f64, angle: f64) -> [f64; 2] {
    [center[0] + radius * angle.cos(), center[1] + radius * angle.sin()]
}

/// Start and sweep of an arc between two points, near given ones.
fn between(center: [f64; 2], ends: [[f64; 2]; 2], start: f64, sweep: f64) -> (f64, f64) {
    let [from, to] = ends.map(|p| (p[1] - center[1]).atan2(p[0] - center[0]));
    let near = |angle: f64, known: f64| known + (angle - known + PI).rem_euclid(TAU) - PI;
    let from = near(from, start);
    (from, near(to, start + sweep) - from)
}

/// A drawing with rounded coordinates after the rounding errors were removed as far as its lines show them.
#[derive(Debug, Clone, PartialEq)]
pub struct Unrounded {
    /// The consistent drawing.
    pub drawing: Drawing,
    /// Step of the rounded coordinates.
    pub step: f64,
    /// Largest change of a point.
    pub change: f64,
}

/// Makes a drawing with rounded coordinates consistent; `None` if its coordinates are not rounded, or if they
/// are consistent as they are.
///
/// Coordinates are rounded if all of them are multiples of a step of 1e-5 to 2e-3, but not of 0.01, and if
/// the step is at most 2e-5 of the size. The result has one coordinate for values that are at most two
/// steps apart, no lines that are shorter than four, and no fragments that lie on other curves. Differences
/// of a drawing that rounding explains are lost.
#[must_use]
pub fn unrounded(drawing: &Drawing) -> Option<Unrounded> {
    let (size, step) = (drawing.size(), coordinate_step(drawing)?);
    let tolerance = TOLERANCE_STEPS * step;
    // Fragments of intersection curves are as short as their errors and have no direction.
    let mut drawing = tidy::defragmented(drawing, FRAGMENT_ERROR * tolerance);
    for view in &mut drawing.views {
        view.curves.retain(|drawn| drawn.curve.length() > tolerance);
    }
    let errors = CoordinateErrors { tolerance, same: SAME_STEPS * step, sigma: SIGMA_STEPS * step };
    let joined = joined_within(&drawing, errors).ok()?;
    let curves = |drawing: &Drawing| -> Vec<Curve2> {
        drawing.views.iter().flat_map(|v| &v.curves).map(|c| c.curve.clone()).collect()
    };
    let moved = |(a, b): (&Curve2, &Curve2)| {
        places(a).iter().zip(places(b)).map(|(p, q)| distance(*p, q)).fold(0.0, f64::max)
    };
    let change = curves(&drawing).iter().zip(&curves(&joined)).map(moved).fold(0.0, f64::max);
    let is_used = change > NEGLIGIBLE[0] * size + NEGLIGIBLE[1] && change <= MAX_CHANGE_STEPS * step;
    is_used.then_some(Unrounded { drawing: joined, step, change })
}

/// The ends of a line; the ends, the middle and the centre of an arc.
fn places(curve: &Curve2) -> Vec<[f64; 2]> {
    match curve {
        Curve2::Segment(a, b) => vec![*a, *b],
        Curve2::Arc { center, radius, start, sweep } => {
            let at = |share: f64| on_circle(*center, *radius, start + share * sweep);
            vec![*center, at(0.0), at(0.5), at(1.0)]
        }
        Curve2::Chain(points) => points.clone(),
    }
}

/// The step of which all coordinates are multiples, if they are rounded.
fn coordinate_step(drawing: &Drawing) -> Option<f64> {
    let mut values: Vec<f64> = Vec::new();
    for view in &drawing.views {
        for k in 0..2 {
            let of_axis = |curve: &Curve2| match curve {
                Curve2::Segment(a, b) => vec![a[k], b[k]],
                Curve2::Arc { center, .. } => vec![center[k]],
                Curve2::Chain(_) => Vec::new(),
            };
            let own: Vec<f64> = view.curves.iter().flat_map(|c| of_axis(&c.curve)).collect();
            // A view is placed by its corner, which may be the extreme of a curve of another kind.
            values.extend(own.iter().map(|v| v - own[0]));
        }
        values.extend(view.curves.iter().filter_map(|c| match c.curve {
            Curve2::Arc { radius, .. } => Some(radius),
            _ => None,
        }));
    }
    let size = drawing.size();
    // Values are differences of numbers that may be far from the origin of the sheet.
    let is_multiple =
        |v: &f64, step: f64| (v / step - (v / step).round()).abs() * step <= 1e-11 * size + 1e-12;
    let has_step = |step: f64| values.iter().all(|v| is_multiple(v, step));
    let mut others: Vec<i64> = (values.iter().filter(|v| !is_multiple(v, DESIGNED)))
        .map(|v| (v / (MAX_STEP * size)).round() as i64)
        .collect();
    others.sort_unstable();
    others.dedup();
    let mut steps: Vec<f64> = STEPS.to_vec();
    if others.len() >= MIN_OTHER {
        steps.extend(OTHER_STEPS);
    }
    steps.sort_by(|a, b| b.total_cmp(a));
    let is_found = |step: &f64| *step <= MAX_STEP * size && has_step(*step);
    steps.into_iter().find(is_found).filter(|_| !others.is_empty())
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
