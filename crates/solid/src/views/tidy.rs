//! Merges arcs and short chords of one circle into exact parts of it.
//!
//! Input: a drawing. Output: the same curves; arcs and short chords whose points lie on the circle of another
//! arc get exactly this circle. Circles get round centres and radii if their points allow it. Exported
//! outlines are cut at every crossing. A circle fitted to a short piece has a wrong centre, although the
//! piece itself is in the right place.
//!
//! Splines and polygons along a circle become arcs of it: the edge of a hole through a curved face is a
//! spline, and so is its image along the axis of the hole. Fragments that lie on a longer curve are removed;
//! Open Cascade leaves one at most cross holes and keyways.
//!
//! Limits: ellipses and other splines are not changed.

use crate::drawing::{Curve2, Drawing, DrawnCurve, View, distance, nearest_on_curve};
use nalgebra::{DMatrix, DVector};
use planish_contour::planar::circle_of_points;
use std::f64::consts::TAU;

/// Maximum distance of an arc from a circle to which it belongs, relative to the size of the drawing.
///
/// A larger value merges different circles; a smaller one leaves the pieces of one circle apart.
const ON_CIRCLE: f64 = 2e-5;
/// Maximum distance of the ends of a chord from its circle, relative to the size.
///
/// Ends of lines are exact, unlike fitted arcs, so this is smaller than [`ON_CIRCLE`]. Otherwise short sides
/// of a polygon near a circle would become arcs.
const CHORD_ENDS: f64 = 1e-6;
/// Curves shorter than this, relative to the size, are removed. They are below the tolerance of coordinates.
const MIN_LENGTH: f64 = 3e-7;
/// Arcs with a sweep below this (in radians) and a rise below [`SLIVER_RISE`] do not define a circle.
const SLIVER_SWEEP: f64 = 0.1;
/// See [`SLIVER_SWEEP`]; height above the chord, relative to the size.
const SLIVER_RISE: f64 = 1e-4;
/// Circles get values with two decimals, or tangents of lines, if their points stay this close (relative to
/// the size).
const MAX_ROUNDING: f64 = 1e-6;
/// Circles get values with four decimals if their points stay this close (relative to the size), plus
/// [`ROUND_LENGTH`].
///
/// It is smaller than [`MAX_ROUNDING`], because any value is within 5e-5 of one with four decimals.
const ROUND: f64 = 5e-8;
/// Absolute part of the distance, for coordinates written with six decimals.
const ROUND_LENGTH: f64 = 4e-6;

/// Maximum distance of a spline from its circle, relative to the height of the curve above its chord.
///
/// Splines of Open Cascade along circles are off by 2e-6 to 7e-5 of it; the intersection curves of two
/// cylinders that are nearest to arcs by 5e-4 and more (40 parts of a generator).
const MAX_CIRCLE_ERROR: f64 = 1e-4;
/// Minimum sweep of a spline that defines a circle, in radians. Shorter ones fit conics as well.
const MIN_CIRCLE_SWEEP: f64 = 0.5;
/// Minimum sweep of a curve that is recognised as a part of an ellipse close to a circle, in radians.
/// Harmonics of second order fit the errors of shorter ones as well.
const MIN_ELLIPSE_SWEEP: f64 = 2.0;
/// Maximum part of the deviations from a circle that those of an ellipse leave. Of the splines of Open
/// Cascade along circles, harmonics of second order leave most.
const ELLIPSE_REST: f64 = 0.05;
/// Maximum length of a fragment that is removed where it lies on a longer curve, relative to the size.
///
/// Fragments of Open Cascade had 3e-6 to 8e-5 of the size. A larger value could remove a change of style.
const MAX_FRAGMENT: f64 = 2e-4;
/// Error of coordinates with six decimals, and of the square roots of them.
const STATED_ROUNDING: f64 = 1e-6;

/// A circle.
#[derive(Clone, Copy)]
struct Circle {
    center: [f64; 2],
    radius: f64,
}

impl Circle {
    /// Distance of a point from the circle.
    fn off(&self, p: [f64; 2]) -> f64 {
        (distance(p, self.center) - self.radius).abs()
    }

    fn angle(&self, p: [f64; 2]) -> f64 {
        (p[1] - self.center[1]).atan2(p[0] - self.center[0])
    }

    /// The arc of this circle from one point to another, counter-clockwise.
    fn arc(&self, from: [f64; 2], to: [f64; 2], closed: bool) -> Curve2 {
        let start = self.angle(from);
        let sweep = if closed { TAU } else { (self.angle(to) - start).rem_euclid(TAU) };
        Curve2::Arc { center: self.center, radius: self.radius, start, sweep }
    }

    /// The circle with a round centre and radius, one tangent to straight lines of all views, or one about
    /// the centre of a longer arc, if the points allow it; else the circle itself.
    fn regularised(self, points: &[[f64; 2]], lines: [&[f64]; 2], longer: &[Self], size: f64) -> Self {
        let far = MAX_ROUNDING * size;
        // Designed values first, then tangents of lines, then values with more decimals, which are weaker
        // evidence and must fit better.
        let candidates = [
            (Some(self.rounded(1e-2)), far),
            (self.between(lines, far), far),
            (self.concentric(points, longer, size), ROUND * size + ROUND_LENGTH),
            (Some(self.rounded(1e-4)).filter(|c| self.may_be(c, points, size)), ROUND * size + ROUND_LENGTH),
        ];
        candidates
            .into_iter()
            .filter_map(|(circle, within)| Some((circle?, within)))
            .find(|(c, within)| c.radius > 0.0 && points.iter().all(|p| c.off(*p) <= *within))
            .map_or(self, |(c, _)| c)
    }

    /// The circle about the nearest centre of a longer arc that the points allow.
    fn concentric(&self, points: &[[f64; 2]], longer: &[Self], size: f64) -> Option<Self> {
        let off = |c: &Self| distance(c.center, self.center);
        let nearest = longer.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
        let about = Self { center: nearest.center, radius: self.radius };
        self.may_be(&about, points, size).then_some(about)
    }

    /// True if a circle fits the points of an arc as well as this one, for points with six decimals.
    ///
    /// A long arc determines its centre nearly as well as its points; a short one does not. Without this,
    /// every sixth arbitrary coordinate would be near enough to one with four decimals.
    fn may_be(&self, other: &Self, points: &[[f64; 2]], size: f64) -> bool {
        let [first, middle, last] = [0, points.len() / 2, points.len() - 1].map(|k| points[k]);
        let height = distance(middle, [0, 1].map(|k| (first[k] + last[k]) / 2.0)).min(self.radius);
        let moved = distance(other.center, self.center).max((other.radius - self.radius).abs());
        moved * height <= self.radius * (ROUND * size / 10.0 + STATED_ROUNDING)
    }

    /// The circle that a spline approximates: tangent to lines, about a known centre, or with round values.
    ///
    /// `None` if there is none and the centre of the spline is too inaccurate for the search.
    fn designed(self, off: f64, lines: [&[f64]; 2], known: &[Self], size: f64) -> Option<Self> {
        // The errors of many points along a circle cancel in its centre and radius.
        let within = (off / 4.0).max(MAX_ROUNDING * size);
        let near = |c: &Self| distance(c.center, self.center).max((c.radius - self.radius).abs()) <= within;
        let about = |c: &Self| Self { center: c.center, radius: self.radius };
        let tangent = self.between(lines, within).filter(near);
        let [coarse, fine] = [1e-2, 1e-4].map(|step| self.rounded(step));
        let round = (within < 1e-3).then_some(coarse).filter(near);
        let concentric = known.iter().map(about).find(near).map(|c| Self { radius: fine.radius, ..c });
        let designed = tangent.or(round).or(concentric.filter(near));
        designed.or((off <= MAX_ROUNDING * size).then_some(self))
    }

    /// The circle with centre and radius at multiples of a step.
    fn rounded(self, step: f64) -> Self {
        Self {
            center: self.center.map(|v| (v / step).round() * step),
            radius: (self.radius / step).round() * step,
        }
    }

    /// The circle whose extremes are coordinates of lines, along both axes if both have such lines.
    fn between(&self, lines: [&[f64]; 2], within: f64) -> Option<Self> {
        let near = |k: usize, value: f64| {
            let at = lines[k].partition_point(|v| *v < value - within);
            lines[k].get(at).copied().filter(|v| (v - value).abs() <= within)
        };
        let spans = [0, 1]
            .map(|k| Some([near(k, self.center[k] - self.radius)?, near(k, self.center[k] + self.radius)?]));
        let radii: Vec<f64> = spans.iter().flatten().map(|s| (s[1] - s[0]) / 2.0).collect();
        let radius = radii.iter().sum::<f64>() / radii.len() as f64;
        (!radii.is_empty()).then(|| Self {
            center: [0, 1].map(|k| spans[k].map_or(self.center[k], |s| (s[0] + s[1]) / 2.0)),
            radius,
        })
    }
}

/// True if an arc is nearly straight. Exporters write parts of the intersection curves of two cylinders as
/// such arcs; they are not images of a cylinder.
fn is_sliver(curve: &Curve2, size: f64) -> bool {
    match curve {
        Curve2::Arc { radius, sweep, .. } => {
            *sweep < SLIVER_SWEEP && radius * (1.0 - (sweep / 2.0).cos()) < SLIVER_RISE * size
        }
        _ => false,
    }
}

/// The drawing with exact circles, and without very short curves.
pub(super) fn tidied(drawing: &Drawing) -> Drawing {
    let size = drawing.size();
    // Coordinates of lines along the axes of space. Lines of one view also fix circles of another one: the
    // outline of a cylinder is tangent to its circle.
    let mut lines: [Vec<f64>; 3] = Default::default();
    for view in &drawing.views {
        let axes = view.kind.axes();
        for drawn in &view.curves {
            if let Curve2::Segment(a, b) = &drawn.curve {
                for k in (0..2).filter(|&k| (a[k] - b[k]).abs() <= CHORD_ENDS * size) {
                    lines[axes[k]].push(a[k]);
                }
            }
        }
    }
    for values in &mut lines {
        values.sort_by(f64::total_cmp);
    }
    let tidy = |view: &View| {
        let axes = view.kind.axes();
        tidied_view(view, [&lines[axes[0]], &lines[axes[1]]], size)
    };
    Drawing { views: drawing.views.iter().map(tidy).collect() }
}

/// The curves of a view; `lines` are the sorted coordinates of straight lines along its two axes.
fn tidied_view(view: &View, lines: [&[f64]; 2], size: f64) -> View {
    let mut circles: Vec<Circle> = Vec::new();
    let mut curves = view.curves.clone();
    // Longest sweep first: the error of a fitted centre grows quickly as the sweep becomes small.
    let mut arcs: Vec<(f64, usize)> = curves
        .iter()
        .enumerate()
        .filter_map(|(index, drawn)| match drawn.curve {
            Curve2::Arc { sweep, .. } => Some((sweep, index)),
            _ => None,
        })
        .collect();
    arcs.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    for (sweep, index) in arcs {
        let Curve2::Arc { center, radius, .. } = curves[index].curve else {
            continue;
        };
        let points = curves[index].curve.points();
        let on = |c: &Circle| points.iter().all(|p| c.off(*p) <= ON_CIRCLE * size);
        // An arc on a known circle is a part of it. A nearly straight one without such a circle becomes a
        // polygon: its own circle would be meaningless. Any other arc defines a circle for the shorter ones.
        let circle = match circles.iter().filter(|c| on(c)).min_by(|a, b| {
            let far = |c: &Circle| points.iter().map(|p| c.off(*p)).fold(0.0, f64::max);
            far(a).total_cmp(&far(b))
        }) {
            Some(circle) => *circle,
            None if is_sliver(&curves[index].curve, size) => {
                curves[index].curve = Curve2::Chain(points);
                continue;
            }
            None => {
                let circle = Circle { center, radius }.regularised(&points, lines, &circles, size);
                circles.push(circle);
                circle
            }
        };
        curves[index].curve = circle.arc(points[0], points[points.len() - 1], sweep >= TAU - 1e-9);
    }
    along_circles(&mut curves, &mut circles, lines, size);
    for drawn in &mut curves {
        let Curve2::Segment(a, b) = drawn.curve else {
            continue;
        };
        let middle = [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0];
        let is_chord = |c: &&Circle| {
            let ends = [a, b].iter().all(|p| c.off(*p) <= CHORD_ENDS * size);
            ends && c.off(middle) <= ON_CIRCLE * size
        };
        // A chord short enough that its middle is on the circle, too, is part of the shorter arc.
        if let Some(circle) = circles.iter().find(is_chord) {
            let (arc, back) = (circle.arc(a, b, false), circle.arc(b, a, false));
            let shorter = if arc.length() <= back.length() { arc } else { back };
            drawn.curve = shorter;
        }
    }
    curves.retain(|c: &DrawnCurve| c.curve.length() > MIN_LENGTH * size);
    View { curves: without_fragments(curves, size, 0.0), ..view.clone() }
}

/// The drawing without fragments that lie on longer curves, within the errors of their coordinates.
pub(super) fn defragmented(drawing: &Drawing, error: f64) -> Drawing {
    let size = drawing.size();
    let view =
        |view: &View| View { curves: without_fragments(view.curves.clone(), size, error), ..view.clone() };
    Drawing { views: drawing.views.iter().map(view).collect() }
}

/// Replaces splines and polygons along circles by arcs, and adds their circles.
fn along_circles(curves: &mut [DrawnCurve], circles: &mut Vec<Circle>, lines: [&[f64]; 2], size: f64) {
    let mut found: Vec<(f64, usize, Circle)> = curves
        .iter()
        .enumerate()
        .filter_map(|(index, drawn)| match &drawn.curve {
            Curve2::Chain(points) => fitted(points).map(|(circle, sweep)| (sweep, index, circle)),
            _ => None,
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    for (_, index, circle) in found {
        let points = curves[index].curve.points();
        let off = points.iter().map(|p| circle.off(*p)).fold(0.0, f64::max);
        let on = |c: &&Circle| points.iter().all(|p| c.off(*p) <= (2.0 * off).max(ON_CIRCLE * size));
        let circle = match circles.iter().find(on) {
            Some(known) => *known,
            None => {
                let Some(exact) = circle.designed(off, lines, circles, size) else {
                    continue;
                };
                circles.push(exact);
                exact
            }
        };
        let (first, last) = (points[0], points[points.len() - 1]);
        let closed = distance(first, last) <= (2.0 * off).max(MAX_ROUNDING * size);
        // The direction of the points decides which of the two arcs between their ends is meant.
        let forward = turned(&points) > 0.0;
        curves[index].curve = match forward {
            true => circle.arc(first, last, closed),
            false => circle.arc(last, first, closed),
        };
    }
}

/// Twice the area between a polygon and its chord; positive for counter-clockwise points.
fn turned(points: &[[f64; 2]]) -> f64 {
    let from = points[0];
    let cross = |p: &[[f64; 2]]| {
        let [a, b] = [0, 1].map(|k| [p[k][0] - from[0], p[k][1] - from[1]]);
        a[0] * b[1] - a[1] * b[0]
    };
    points.windows(2).map(cross).sum()
}

/// The circle through the points of a curve, and its sweep; `None` if they are not on one.
fn fitted(points: &[[f64; 2]]) -> Option<(Circle, f64)> {
    // The corners of a regular polygon lie on a circle as well, but are farther apart than points of splines
    // and ellipses (at most 0.131 of the radius).
    const MIN_POINTS: usize = 9;
    const MAX_CHORD: f64 = 0.14;
    if points.len() < MIN_POINTS {
        return None;
    }
    let &[x, y, radius] = circle_of_points(points).as_deref()? else {
        return None;
    };
    let circle = Circle { center: [x, y], radius };
    if points.windows(2).any(|p| distance(p[0], p[1]) > MAX_CHORD * radius) {
        return None;
    }
    let length: f64 = points.windows(2).map(|p| distance(p[0], p[1])).sum();
    let sweep = length / radius;
    let height = radius * (1.0 - (sweep.min(TAU) / 2.0).cos());
    let off = points.iter().map(|p| circle.off(*p)).fold(0.0, f64::max);
    ((MIN_CIRCLE_SWEEP..TAU + 0.01).contains(&sweep)
        && off <= MAX_CIRCLE_ERROR * height
        && !is_ellipse(points, &circle, sweep, off))
    .then_some((circle, sweep))
}

/// True if the deviations of some points from a circle are those of an ellipse: the circle is seen at an
/// angle.
///
/// A circle tilted by `θ` has the radius `r (1 − sin²θ cos²(φ − φ₀) / 2)`: 1.5e-6 of it at 0.1°. Least
/// squares for the harmonics of first and second order of the deviations; what is left must be a small part
/// of them.
fn is_ellipse(points: &[[f64; 2]], circle: &Circle, sweep: f64, off: f64) -> bool {
    if sweep < MIN_ELLIPSE_SWEEP {
        return false;
    }
    let angles: Vec<f64> = points.iter().map(|p| circle.angle(*p)).collect();
    let design = DMatrix::from_fn(points.len(), 5, |i, j| match j {
        0 => 1.0,
        1 => angles[i].cos(),
        2 => angles[i].sin(),
        3 => (2.0 * angles[i]).cos(),
        _ => (2.0 * angles[i]).sin(),
    });
    let deviations =
        DVector::from_fn(points.len(), |i, _| distance(points[i], circle.center) - circle.radius);
    let Ok(harmonics) = design.clone().svd(true, true).solve(&deviations, 1e-9) else { return false };
    (deviations - design * harmonics).amax() < ELLIPSE_REST * off
}

/// The curves without fragments of which every point lies on one longer curve. Points have errors of up to
/// `error`.
fn without_fragments(curves: Vec<DrawnCurve>, size: f64, error: f64) -> Vec<DrawnCurve> {
    let is_fragment = |drawn: &DrawnCurve| {
        let length = drawn.curve.length();
        length < MAX_FRAGMENT * size && {
            let points = drawn.curve.points();
            // Less than its length: the end of a neighbour is as near as that.
            let near = (ON_CIRCLE * size).min(length / 10.0).max(error);
            let on = |p: &[f64; 2], c: &Curve2| distance(*p, nearest_on_curve(c, *p)) <= near;
            let longer = |c: &&DrawnCurve| c.curve.length() > 4.0 * length;
            curves.iter().filter(longer).any(|c| points.iter().all(|p| on(p, &c.curve)))
        }
    };
    let kept: Vec<bool> = curves.iter().map(|c| !is_fragment(c)).collect();
    curves.into_iter().zip(kept).filter(|(_, kept)| *kept).map(|(c, _)| c).collect()
}
