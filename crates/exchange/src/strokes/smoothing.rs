//! Arcs and curves from strokes that continue each other: arcs of one circle become one arc, and short lines
//! along a curve become an arc or one chain of points.
//!
//! For a polygon inscribed in a circle, the angle between two sides over the mean of their lengths is the
//! curvature, whatever the lengths. So runs of short lines of one curvature are candidates for arcs.

use super::{Accuracy, Stroke, ends};
use planish_solid::views::{Curve2, distance};
use std::f64::consts::TAU;

/// Maximum angle between short lines along a curve. A larger value takes prisms with many sides for
/// cylinders: those with 30 sides and more are.
const MAX_TURN: f64 = 0.21;
/// Minimum number of lines along a curve.
const MIN_LINES: usize = 4;
/// Minimum number of lines along a curve of another kind; fewer may be edges with small angles between them.
const MIN_CURVE_LINES: usize = 8;
/// Maximum ratio of curvatures along an arc.
const CURVATURE_RATIO: f64 = 1.1;
/// Ratio of a line that touches an arc to the short lines along it.
const LONGER: f64 = 2.0;
/// Maximum distance of points from a circle, relative to the error of coordinates.
const ON_CIRCLE: f64 = 4.0;
/// Angle of an arc up to which a circle through its ends is accurate.
const MAX_OPEN: f64 = 5.5;
/// Radii of arcs of one circle differ by less than this share.
const SAME_RADIUS: f64 = 1e-3;

/// Joins strokes that continue each other in their order.
pub(crate) fn smoothed(strokes: Vec<Stroke>, accuracy: &Accuracy) -> Vec<Stroke> {
    let mut joined: Vec<Stroke> = Vec::with_capacity(strokes.len());
    let mut run: Vec<Stroke> = Vec::new();
    for stroke in strokes {
        let continues = run.last().is_some_and(|last| continues(last, &stroke, accuracy));
        if !continues {
            joined.extend(curves_of_run(std::mem::take(&mut run), accuracy));
        }
        run.push(stroke);
    }
    joined.extend(curves_of_run(run, accuracy));
    let mut arcs: Vec<Stroke> = Vec::with_capacity(joined.len());
    for stroke in joined {
        match arcs.last_mut().and_then(|last| Some((joined_arcs(last, &stroke, accuracy)?, last))) {
            Some((curve, last)) => last.drawn.curve = curve,
            None => arcs.push(stroke),
        }
    }
    arcs
}

fn is_same_pen(a: &Stroke, b: &Stroke) -> bool {
    a.pen == b.pen && a.drawn.style == b.drawn.style
}

/// Whether a line continues another one with a small turn.
fn continues(last: &Stroke, next: &Stroke, accuracy: &Accuracy) -> bool {
    let (Curve2::Segment(a, b), Curve2::Segment(c, d)) = (&last.drawn.curve, &next.drawn.curve) else {
        return false;
    };
    is_same_pen(last, next) && distance(*b, *c) <= accuracy.position && {
        let turn = turn_of(*a, *b, *d).abs();
        turn < MAX_TURN && turn > 1e-4
    }
}

/// Angle by which a path turns at its middle point.
fn turn_of(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - b[0], c[1] - b[1]]);
    (u[0] * v[1] - u[1] * v[0]).atan2(u[0] * v[0] + u[1] * v[1])
}

/// Arcs and chains along a run of lines.
fn curves_of_run(run: Vec<Stroke>, accuracy: &Accuracy) -> Vec<Stroke> {
    if run.len() < MIN_LINES {
        return run;
    }
    let mut points: Vec<[f64; 2]> = run.iter().map(|s| ends(&s.drawn.curve)[0]).collect();
    points.extend(run.last().map(|s| ends(&s.drawn.curve)[1]));
    let curvature = |k: usize| {
        let [a, b, c] = [points[k - 1], points[k], points[k + 1]];
        turn_of(a, b, c) / (0.5 * (distance(a, b) + distance(b, c)))
    };
    let curvatures: Vec<f64> = (1..run.len()).map(curvature).collect();
    // Where a line meets an arc, or two arcs meet, the curvature is another than at the corners beside it.
    let agree = |a: usize, b: usize| {
        let ratio = curvatures.get(a).zip(curvatures.get(b)).map(|(a, b)| a / b);
        ratio.is_some_and(|ratio| (1.0 / CURVATURE_RATIO..=CURVATURE_RATIO).contains(&ratio))
    };
    let joins = |corner: usize| (corner > 0 && agree(corner, corner - 1)) || agree(corner, corner + 1);
    let mut found = Vec::new();
    let mut begin = 0;
    while begin < run.len() {
        let mut end = begin + 1;
        while end < run.len() && joins(end - 1) {
            end += 1;
        }
        found.push((begin, end, arc_through(&points[begin..=end], accuracy)));
        begin = end;
    }
    // Beside arcs there are only single lines that touch them, which are longer. Otherwise all of it is one
    // curve of another kind, and a part of it that is nearly an arc is none.
    let length = |k: usize| distance(points[k], points[k + 1]);
    let beside = |k: usize| {
        let neighbours = [k.checked_sub(1), (k + 2 < points.len()).then_some(k + 1)];
        neighbours.into_iter().flatten().map(length).fold(0.0, f64::max)
    };
    let is_line = |begin: usize, end: usize| end == begin + 1 && length(begin) > LONGER * beside(begin);
    if !found.iter().all(|(begin, end, arc)| arc.is_some() || is_line(*begin, *end)) {
        if run.len() < MIN_CURVE_LINES {
            return run;
        }
        let mut one = run[0].clone();
        one.drawn.curve = Curve2::Chain(points);
        return vec![one];
    }
    let mut strokes = Vec::new();
    for (begin, end, arc) in found {
        match arc {
            Some(curve) => {
                let mut one = run[begin].clone();
                one.drawn.curve = curve;
                strokes.push(one);
            }
            None => strokes.extend_from_slice(&run[begin..end]),
        }
    }
    strokes
}

/// The arc through all points, if they lie on one.
fn arc_through(points: &[[f64; 2]], accuracy: &Accuracy) -> Option<Curve2> {
    let (first, middle, last) = (points[0], points[points.len() / 2], points[points.len() - 1]);
    if points.len() <= MIN_LINES {
        return None;
    }
    // A closed polygon has its ends in common.
    let third = if distance(first, last) <= accuracy.position { points[points.len() / 4] } else { last };
    let (center, radius) = circle_through(first, middle, third)?;
    if !points.iter().all(|p| (distance(*p, center) - radius).abs() <= ON_CIRCLE * accuracy.rounding) {
        return None;
    }
    let angle = |p: [f64; 2]| (p[1] - center[1]).atan2(p[0] - center[0]);
    let sweep: f64 = points
        .windows(2)
        .map(|p| {
            let step = angle(p[1]) - angle(p[0]);
            step - TAU * (step / TAU).round()
        })
        .sum();
    let start = if sweep > 0.0 { angle(first) } else { angle(last) };
    Some(whole(Curve2::Arc { center, radius, start, sweep: sweep.abs().min(TAU) }, accuracy))
}

pub(super) fn circle_through(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Option<([f64; 2], f64)> {
    let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
    let cross = 2.0 * (u[0] * v[1] - u[1] * v[0]);
    let (su, sv) = (u[0] * u[0] + u[1] * u[1], v[0] * v[0] + v[1] * v[1]);
    let off = [(v[1] * su - u[1] * sv) / cross, (u[0] * sv - v[0] * su) / cross];
    let radius = off[0].hypot(off[1]);
    (radius.is_finite() && radius > 0.0).then_some(([a[0] + off[0], a[1] + off[1]], radius))
}

/// A full circle, if the ends of an arc meet.
fn whole(arc: Curve2, accuracy: &Accuracy) -> Curve2 {
    match arc {
        Curve2::Arc { center, radius, sweep, .. } if radius * (TAU - sweep) <= 2.0 * accuracy.position => {
            Curve2::Arc { center, radius, start: 0.0, sweep: TAU }
        }
        other => other,
    }
}

/// One arc, if two arcs of one circle continue each other.
fn joined_arcs(last: &Stroke, next: &Stroke, accuracy: &Accuracy) -> Option<Curve2> {
    let (
        Curve2::Arc { center: c, radius: r, sweep: w, .. },
        Curve2::Arc { center: d, radius: q, sweep: v, .. },
    ) = (&last.drawn.curve, &next.drawn.curve)
    else {
        return None;
    };
    let near = accuracy.position + SAME_RADIUS * r.max(*q);
    if !is_same_pen(last, next) || distance(*c, *d) > near || (r - q).abs() > near || w + v > TAU + 1e-3 {
        return None;
    }
    let [a, b] = [ends(&last.drawn.curve), ends(&next.drawn.curve)];
    let touches = |p: [f64; 2], q: [f64; 2]| distance(p, q) <= accuracy.position;
    // Arcs run counter-clockwise, whatever the order in which they are drawn.
    let [from, joint, to] = match (touches(a[1], b[0]), touches(b[1], a[0])) {
        (true, _) => [a[0], a[1], b[1]],
        (_, true) => [b[0], b[1], a[1]],
        _ => return None,
    };
    // The longer arc is more accurate, and the circle through the ends of both still more.
    let longer = if w >= v { (*c, *r) } else { (*d, *q) };
    let through_ends = circle_through(from, joint, to).filter(|_| w + v < MAX_OPEN);
    let (center, radius) = through_ends.unwrap_or(longer);
    let start = (from[1] - center[1]).atan2(from[0] - center[0]);
    Some(whole(Curve2::Arc { center, radius, start, sweep: (w + v).min(TAU) }, accuracy))
}
