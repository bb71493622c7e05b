//! Conditions that the coordinates of a drawing meet within their errors.
//!
//! Input: a drawing and a tolerance. Output: the different values of coordinates and radii, and conditions
//! between them:
//! - a circle reaches a coordinate of lines, in its view or in another one: centre ± radius = coordinate;
//! - an end of a line or arc is on a circle, or on a slanted line;
//! - slanted lines continue each other;
//! - a slanted line touches a circle, at its end or between its ends; two circles touch at an end.
//!
//! A condition is one that values with their errors ([`CoordinateErrors`]) may meet: its residual is at most
//! four standard deviations.
//!
//! Lines along an axis need no conditions of their own: their ends share a coordinate.

use crate::drawing::conditions::{on_circle, on_line, tangent_at, touches};
use crate::drawing::{Curve2, Drawing, View, distance};
use planish_estimate::{Condition, residual_variance};
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Factor of the standard deviation of designed values, which are multiples of 0.01: they are exact, and the
/// error is in the others. One of a hundred values with four decimals is such a multiple by chance.
const DESIGNED_SIGMA: f64 = 0.01;
/// Factor of the standard deviation of values that only follow from circles.
const DERIVED_SIGMA: f64 = 10.0;
/// Maximum residual of a condition in standard deviations. Of values with uniform errors it is at most about
/// 4.2; a larger limit would bend lines and circles together that only nearly touch.
const GATE: f64 = 4.0;
/// Maximum growth of errors from values to the residual. Short lines determine no direction.
const MAX_GROWTH: f64 = 10.0;
/// Maximum number of slanted lines of a view that are compared with each other and with all ends.
const MAX_SLANTED: usize = 500;
/// Minimum distance of different places, in tolerances.
const APART: f64 = 10.0;

/// Errors of the coordinates of a drawing.
#[derive(Debug, Clone, Copy)]
pub(super) struct CoordinateErrors {
    /// Maximum error of a place that follows from several values, such as the extreme of a circle.
    pub(super) tolerance: f64,
    /// Maximum difference of drawn values that are the same.
    pub(super) same: f64,
    /// Standard deviation of a drawn value.
    pub(super) sigma: f64,
}

/// Values of which each is near to the next.
#[derive(Debug, Clone, Copy)]
struct Group {
    low: f64,
    high: f64,
    /// The value that replaces them.
    value: f64,
    /// How often it is drawn; zero for values that only follow from circles.
    count: usize,
}

/// The different values of coordinates and radii of a drawing.
pub(super) struct Coordinates {
    /// Those of each axis, ascending, and the radii.
    groups: [Vec<Group>; 4],
    /// The values of all groups, one axis after the other.
    pub(super) values: Vec<f64>,
    tolerance: f64,
    /// Standard deviation of a drawn value.
    sigma: f64,
}

impl Coordinates {
    /// The values of ends of lines and arcs, and of centres, radii and extremes of circles.
    pub(super) fn new(drawing: &Drawing, errors: CoordinateErrors) -> Self {
        let CoordinateErrors { tolerance, same, sigma } = errors;
        let (mut drawn, mut derived): ([Vec<f64>; 4], [Vec<f64>; 4]) = Default::default();
        for view in &drawing.views {
            let axes = view.kind.axes();
            for curve in view.curves.iter().map(|c| &c.curve) {
                match curve {
                    Curve2::Segment(a, b) => (0..2).for_each(|k| drawn[axes[k]].extend([a[k], b[k]])),
                    Curve2::Arc { center, radius, .. } => {
                        drawn[3].push(*radius);
                        let ends = ends_of(curve).into_iter().flatten();
                        let extremes = extremes(curve, tolerance);
                        (0..2).for_each(|k| drawn[axes[k]].push(center[k]));
                        ends.for_each(|p| (0..2).for_each(|k| derived[axes[k]].push(p[k])));
                        extremes.for_each(|(k, side)| derived[axes[k]].push(center[k] + side * radius));
                    }
                    Curve2::Chain(_) => {}
                }
            }
        }
        let both = drawn.into_iter().zip(derived);
        let groups: Vec<Vec<Group>> =
            both.map(|(drawn, derived)| grouped(drawn, derived, [same, tolerance])).collect();
        let groups: [Vec<Group>; 4] = groups.try_into().unwrap_or_default();
        let values = groups.iter().flatten().map(|g| g.value).collect();
        Self { groups, values, tolerance, sigma }
    }

    /// Standard deviations of the values: those that are designed or drawn several times change less.
    pub(super) fn sigmas(&self) -> Vec<f64> {
        let factor = |g: &Group| match g.count {
            0 => DERIVED_SIGMA,
            n if is_designed(g.value) => DESIGNED_SIGMA / (n as f64).sqrt(),
            n => 1.0 / (n as f64).sqrt(),
        };
        self.groups.iter().flatten().map(|g| self.sigma * factor(g)).collect()
    }

    /// The number of a value of an axis (3 for radii) within the tolerance.
    pub(super) fn index(&self, axis: usize, value: f64) -> Option<usize> {
        let first: usize = self.groups[..axis].iter().map(Vec::len).sum();
        nearest(&self.groups[axis], value, self.tolerance).map(|at| first + at)
    }

    /// The number of a radius.
    pub(super) fn radius(&self, value: f64) -> Option<usize> {
        self.index(3, value)
    }

    /// The numbers of both coordinates of a point of a view.
    fn point(&self, axes: [usize; 3], p: [f64; 2]) -> Option<[usize; 2]> {
        Some([self.index(axes[0], p[0])?, self.index(axes[1], p[1])?])
    }

    fn place(&self, [x, y]: [usize; 2]) -> [f64; 2] {
        [self.values[x], self.values[y]]
    }

    /// Whether values that are within their errors of these may meet a condition.
    fn may_meet(&self, condition: &Condition) -> bool {
        let growth = residual_variance(condition, &self.values, |_| 1.0);
        let limit = GATE * self.sigma;
        let residual = condition(&self.values).0;
        (1e-6..MAX_GROWTH * MAX_GROWTH).contains(&growth) && residual * residual <= limit * limit * growth
    }
}

/// Whether a value is a multiple of 0.01.
fn is_designed(value: f64) -> bool {
    (100.0 * value - (100.0 * value).round()).abs() < 1e-6
}

/// The start and the end of an arc that is no whole circle.
fn ends_of(curve: &Curve2) -> Option<[[f64; 2]; 2]> {
    let Curve2::Arc { center, radius, start, sweep } = curve else { return None };
    let at = |angle: f64| [center[0] + radius * angle.cos(), center[1] + radius * angle.sin()];
    (*sweep < TAU - 1e-9).then(|| [at(*start), at(start + sweep)])
}

/// Axis and side of the extremes that are on an arc.
fn extremes(curve: &Curve2, tolerance: f64) -> impl Iterator<Item = (usize, f64)> {
    let sides = [(0, 1.0), (1, 1.0), (0, -1.0), (1, -1.0)];
    let arc = match curve {
        Curve2::Arc { radius, start, sweep, .. } => Some(([*start, *sweep], APART * tolerance / radius)),
        _ => None,
    };
    let is_on = move |quarter: &usize| {
        arc.is_some_and(|(arc, slack)| is_within(arc, *quarter as f64 * FRAC_PI_2, slack))
    };
    (0..4).filter(is_on).map(move |quarter| sides[quarter])
}

/// Whether an angle is on an arc, with some slack at its ends.
fn is_within([start, sweep]: [f64; 2], angle: f64, slack: f64) -> bool {
    (angle - start + slack).rem_euclid(TAU) <= sweep + 2.0 * slack
}

/// Groups of values, ascending. Derived values join the groups of drawn ones, and do not join them together.
fn grouped(drawn: Vec<f64>, derived: Vec<f64>, [same, tolerance]: [f64; 2]) -> Vec<Group> {
    let mut groups = chained(drawn, same);
    let apart = derived.into_iter().filter(|v| nearest(&groups, *v, tolerance).is_none()).collect();
    let others = chained(apart, tolerance);
    groups.extend(others.into_iter().map(|group| Group { count: 0, ..group }));
    groups.sort_by(|a, b| a.low.total_cmp(&b.low));
    groups
}

/// Groups of values of which each is at most a distance from the next.
fn chained(mut values: Vec<f64>, distance: f64) -> Vec<Group> {
    values.sort_by(f64::total_cmp);
    // Compared with the previous value, not with the first of the group: a fixed width would split values at
    // arbitrary places.
    let groups = values.chunk_by(|a, b| b - a <= distance);
    let one = |group: &[f64]| Group {
        low: group[0],
        high: group[group.len() - 1],
        value: most_frequent(group),
        count: group.len(),
    };
    groups.map(one).collect()
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

/// The group nearest to a value, if one is within the tolerance.
fn nearest(groups: &[Group], value: f64, tolerance: f64) -> Option<usize> {
    let off = |k: usize| (groups[k].low - value).max(value - groups[k].high).max(0.0);
    let at = groups.partition_point(|g| g.high < value);
    let near = [at.checked_sub(1), Some(at).filter(|k| *k < groups.len())];
    let best = near.into_iter().flatten().min_by(|a, b| off(*a).total_cmp(&off(*b)));
    best.filter(|k| off(*k) <= tolerance)
}

/// A point by the numbers of its coordinates.
type Point = [usize; 2];

/// The ends, slanted lines and circles of a view, by the numbers of their values.
#[derive(Default)]
struct ViewCurves {
    ends: BTreeSet<Point>,
    /// Lines along no axis.
    slanted: BTreeSet<[Point; 2]>,
    /// The arcs of each circle: start and sweep.
    circles: BTreeMap<[usize; 3], Vec<[f64; 2]>>,
}

impl ViewCurves {
    fn new(view: &View, known: &Coordinates) -> Self {
        let axes = view.kind.axes();
        let mut found = Self::default();
        for curve in view.curves.iter().map(|c| &c.curve) {
            let ends = match curve {
                Curve2::Segment(a, b) => Some([*a, *b]),
                _ => ends_of(curve),
            };
            let ends = ends.map(|ends| ends.map(|p| known.point(axes, p)));
            found.ends.extend(ends.into_iter().flatten().flatten());
            match (curve, ends) {
                (Curve2::Segment(..), Some([Some(a), Some(b)])) if a[0] != b[0] && a[1] != b[1] => {
                    found.slanted.insert([a.min(b), a.max(b)]);
                }
                (Curve2::Arc { center, radius, start, sweep }, _) => {
                    if let (Some([x, y]), Some(r)) = (known.point(axes, *center), known.radius(*radius)) {
                        found.circles.entry([x, y, r]).or_default().push([*start, *sweep]);
                    }
                }
                _ => {}
            }
        }
        found
    }

    /// Whether a place near a circle is at one of its arcs.
    fn is_at_arc(&self, circle: &[usize; 3], known: &Coordinates, p: [f64; 2]) -> bool {
        let [x, y, r] = circle.map(|k| known.values[k]);
        let (angle, slack) = ((p[1] - y).atan2(p[0] - x), APART * known.tolerance / r.max(known.tolerance));
        self.circles[circle].iter().any(|arc| is_within(*arc, angle, slack))
    }
}

/// The conditions that the values of a drawing may meet.
pub(super) fn conditions<'a>(drawing: &Drawing, known: &Coordinates, tolerance: f64) -> Vec<Condition<'a>> {
    let mut all = reaches(drawing, known, tolerance);
    for view in &drawing.views {
        let curves = ViewCurves::new(view, known);
        let on_circles = ends_on_circles(&curves, known, &mut all);
        ends_on_lines(&curves, known, &mut all);
        contacts(&curves, known, &on_circles, &mut all);
    }
    all
}

/// That circles reach coordinates of lines: centre ± radius = coordinate.
fn reaches<'a>(drawing: &Drawing, known: &Coordinates, tolerance: f64) -> Vec<Condition<'a>> {
    let mut found: BTreeSet<(usize, usize, bool, usize)> = BTreeSet::new();
    for view in &drawing.views {
        let axes = view.kind.axes();
        for curve in view.curves.iter().map(|c| &c.curve) {
            let Curve2::Arc { center, radius, .. } = curve else { continue };
            let Some(r) = known.radius(*radius) else { continue };
            for (k, side) in extremes(curve, tolerance) {
                let reach = center[k] + side * radius;
                let numbers = (known.index(axes[k], center[k]), known.index(axes[k], reach));
                if let (Some(c), Some(end)) = numbers
                    && c != end
                {
                    found.insert((c, r, side > 0.0, end));
                }
            }
        }
    }
    let condition = |(c, r, is_upper, end): (usize, usize, bool, usize)| -> Condition<'a> {
        let side = if is_upper { 1.0 } else { -1.0 };
        Box::new(move |x| (x[c] + side * x[r] - x[end], vec![(c, 1.0), (r, side), (end, -1.0)]))
    };
    found.into_iter().map(condition).filter(|c| known.may_meet(c)).collect()
}

/// That ends are on circles. Returns them with their circle.
fn ends_on_circles(
    curves: &ViewCurves,
    known: &Coordinates,
    all: &mut Vec<Condition<'_>>,
) -> BTreeSet<(Point, [usize; 3])> {
    let mut found = BTreeSet::new();
    for end in &curves.ends {
        for circle in curves.circles.keys() {
            let condition = on_circle(*end, *circle);
            if known.may_meet(&condition) && curves.is_at_arc(circle, known, known.place(*end)) {
                found.insert((*end, *circle));
                // At an extreme of the circle, the condition is that of `reaches`.
                if end[0] != circle[0] && end[1] != circle[1] {
                    all.push(condition);
                }
            }
        }
    }
    found
}

/// That ends are on slanted lines, between their ends, or where another line continues them.
fn ends_on_lines(curves: &ViewCurves, known: &Coordinates, all: &mut Vec<Condition<'_>>) {
    if curves.slanted.len() > MAX_SLANTED {
        return;
    }
    let apart = APART * known.tolerance;
    let length = |line: &[Point; 2]| distance(known.place(line[0]), known.place(line[1]));
    let mut found: BTreeSet<(Point, [Point; 2])> = BTreeSet::new();
    for line in curves.slanted.iter().filter(|line| length(line) > apart) {
        let may_be_on = |p: &Point| known.may_meet(&on_line(*p, *line));
        for end in curves.ends.iter().filter(|end| !line.contains(end)) {
            let [p, a, b] = [*end, line[0], line[1]].map(|p| known.place(p));
            let is_between = distance(p, a).max(distance(p, b)) < length(line) && {
                distance(p, a).min(distance(p, b)) > apart
            };
            if is_between && may_be_on(end) {
                found.insert((*end, *line));
            }
        }
        for other in curves.slanted.iter().filter(|other| length(other) < length(line)) {
            if other.iter().all(|end| line.contains(end) || may_be_on(end)) {
                found.extend(other.iter().filter(|end| !line.contains(end)).map(|end| (*end, *line)));
            }
        }
    }
    all.extend(found.into_iter().map(|(end, line)| on_line(end, line)));
}

/// That slanted lines touch circles, and circles each other.
fn contacts(
    curves: &ViewCurves,
    known: &Coordinates,
    on_circles: &BTreeSet<(Point, [usize; 3])>,
    all: &mut Vec<Condition<'_>>,
) {
    let apart = APART * known.tolerance;
    let mut add = |condition: Condition<'static>| {
        if known.may_meet(&condition) {
            all.push(condition);
        }
    };
    for line in &curves.slanted {
        let [a, b] = line.map(|p| known.place(p));
        let length = distance(a, b);
        for circle in curves.circles.keys() {
            let center = [circle[0], circle[1]];
            let ends: Vec<&Point> =
                line.iter().filter(|end| on_circles.contains(&(**end, *circle))).collect();
            // A line from end to end of a circle is a chord.
            if let [end] = ends[..] {
                add(tangent_at(*end, center, *line));
                continue;
            }
            let c = known.place(center);
            let u = [0, 1].map(|k| (b[k] - a[k]) / length.max(f64::MIN_POSITIVE));
            let along = (c[0] - a[0]) * u[0] + (c[1] - a[1]) * u[1];
            let side = (u[0] * (c[1] - a[1]) - u[1] * (c[0] - a[0])).signum();
            let foot = [a[0] + along * u[0], a[1] + along * u[1]];
            let is_between = along > apart && along < length - apart;
            if ends.is_empty() && is_between && curves.is_at_arc(circle, known, foot) {
                add(touches(*line, *circle, side));
            }
        }
    }
    for (end, first) in on_circles {
        for (_, second) in on_circles.range((*end, *first)..).take_while(|(other, _)| other == end) {
            let centers = [[first[0], first[1]], [second[0], second[1]]];
            if distance(known.place(centers[0]), known.place(centers[1])) > apart {
                add(on_line(*end, centers));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{rectangle, segment};
    use super::super::{Curve2, Drawing, DrawnCurve, LineStyle, View, ViewKind, joined, solve, unrounded};
    use crate::drawing::{distance, distance_to_segment};
    use std::f64::consts::{PI, TAU};

    const FAR: [f64; 2] = [50.3, 7.1];
    const RADII: [f64; 2] = [10.0, 6.2];

    fn rounded(v: f64) -> f64 {
        (v * 1e4).round() / 1e4
    }

    /// An arc with centre and radius rounded to four decimals, and angles to six decimals of a degree.
    fn arc(center: [f64; 2], radius: f64, [from, to]: [f64; 2]) -> DrawnCurve {
        let angle = |a: f64| (a.to_degrees() * 1e6).round().to_radians() / 1e6;
        let curve = Curve2::Arc {
            center: center.map(rounded),
            radius: rounded(radius),
            start: angle(from),
            sweep: (angle(to) - angle(from)).rem_euclid(TAU),
        };
        DrawnCurve { curve, ..segment([0.0; 2], [1.0; 2], LineStyle::Visible) }
    }

    fn line(a: [f64; 2], b: [f64; 2]) -> DrawnCurve {
        segment(a.map(rounded), b.map(rounded), LineStyle::Visible)
    }

    /// A lever of height 8 between two round ends, displaced by an arbitrary corner; rounded to four
    /// decimals.
    fn lever() -> (Drawing, f64) {
        let corner = [0.123_456, 0.765_432];
        let at = |p: [f64; 2]| [p[0] + corner[0], p[1] + corner[1]];
        let (d, turn) = (FAR[0].hypot(FAR[1]), FAR[1].atan2(FAR[0]));
        let open = ((RADII[0] - RADII[1]) / d).acos();
        let foot = |c: [f64; 2], r: f64, a: f64| at([c[0] + r * a.cos(), c[1] + r * a.sin()]);
        let tangent = |a: f64| line(foot([0.0; 2], RADII[0], a), foot(FAR, RADII[1], a));
        let top = vec![
            arc(at([0.0; 2]), RADII[0], [turn + open, turn - open + TAU]),
            arc(at(FAR), RADII[1], [turn - open, turn + open]),
            tangent(turn + open),
            tangent(turn - open),
        ];
        let box_of = |low: f64, high: f64, at: f64| {
            let corners = [[low + at, 0.0], [high + at, 8.0]].map(|p| p.map(rounded));
            rectangle(corners[0], corners[1])
        };
        let views = vec![
            View::new(ViewKind::Front, box_of(-RADII[0], FAR[0] + RADII[1], corner[0])),
            View::new(ViewKind::Top, top),
            View::new(ViewKind::Side, box_of(-RADII[0], FAR[1] + RADII[1], corner[1])),
        ];
        let [big, small] = RADII;
        let flank = (d * d - (big - small).powi(2)).sqrt();
        let area = big * big * (PI - open) + small * small * open + (big + small) * flank;
        (Drawing { views }, 8.0 * area)
    }

    /// Centre and radius of the first arc and the ends of the first line of the top view.
    fn first_contact(drawing: &Drawing) -> ([f64; 2], f64, [[f64; 2]; 2]) {
        let curves = &drawing.views[1].curves;
        let Curve2::Arc { center, radius, .. } = curves[0].curve else { panic!() };
        let Curve2::Segment(a, b) = curves[2].curve else { panic!() };
        (center, radius, [a, b])
    }

    #[test]
    fn rounded_lever_becomes_consistent_and_is_solved() {
        let (drawing, volume) = lever();
        let (center, radius, [a, b]) = first_contact(&drawing);
        assert!((distance_to_segment(center, a, b) - radius).abs() > 1e-6);
        let found = unrounded(&drawing).unwrap();
        assert!((found.step - 1e-4).abs() < 1e-12 && found.change < 3e-4, "{found:?}");
        let (center, radius, [a, b]) = first_contact(&found.drawing);
        assert!((distance(center, a) - radius).abs() < 1e-9);
        assert!((distance_to_segment(center, a, b) - radius).abs() < 1e-9);
        // The arc ends where the line begins.
        let ends = found.drawing.views[1].curves[0].curve.points();
        assert!(distance(ends[0], a).min(distance(ends[ends.len() - 1], a)) < 1e-9);
        let solved = solve(&found.drawing).unwrap();
        assert!((solved.solutions[0].measures.volume / volume - 1.0).abs() < 1e-5);
        // Consistent drawings stay as they are.
        assert!(unrounded(&found.drawing).is_none());
    }

    #[test]
    fn a_line_that_misses_a_circle_by_more_than_rounding_is_kept() {
        let (mut drawing, _) = lever();
        let before = drawing.views[1].curves[2].clone();
        let Curve2::Segment(a, b) = before.curve else { panic!() };
        // Both ends are 0.002 beside the circles.
        let beside = |p: [f64; 2]| rounded(p[1] + 0.002);
        let moved = Curve2::Segment([a[0], beside(a)], [b[0], beside(b)]);
        drawing.views[1].curves[2].curve = moved.clone();
        let found = joined(&drawing, 4e-4).unwrap();
        let (Curve2::Segment(a, b), Curve2::Segment(p, q)) = (&found.views[1].curves[2].curve, &moved) else {
            panic!()
        };
        assert!(distance(*a, *p).max(distance(*b, *q)) < 1e-4, "{found:?}");
    }

    #[test]
    fn ends_of_a_notch_are_on_both_circles() {
        // A disc of radius 20 with a round notch of radius 5 at its rim.
        let (angle, reach) = (0.7_f64, 20.5);
        let center = [0.345_678 + 20.0, 0.456_789 + 20.0];
        let hub = [center[0] + reach * angle.cos(), center[1] + reach * angle.sin()];
        // Angles from the triangle of both centres and a corner.
        let at_disc = ((400.0 + reach * reach - 25.0) / (40.0 * reach)).acos();
        let at_notch = ((25.0 + reach * reach - 400.0) / (10.0 * reach)).acos();
        let top = vec![
            arc(center, 20.0, [angle + at_disc, angle - at_disc + TAU]),
            arc(hub, 5.0, [angle + PI - at_notch, angle + PI + at_notch]),
        ];
        let drawing = Drawing { views: vec![View::new(ViewKind::Top, top)] };
        let found = joined(&drawing, 4e-4).unwrap();
        let [disc, notch] = [0, 1].map(|k| found.views[0].curves[k].curve.points());
        assert!(distance(disc[0], notch[0]).min(distance(disc[0], notch[notch.len() - 1])) < 1e-9);
        assert!(
            distance(disc[disc.len() - 1], notch[0])
                .min(distance(disc[disc.len() - 1], notch[notch.len() - 1]))
                < 1e-9
        );
    }
}
