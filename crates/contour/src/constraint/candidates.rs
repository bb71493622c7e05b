//! Which relations a drawing could obey, and within what range they would lie by chance.

use super::drawing::{BarId, CircleId, ParametricDrawing, PointId};
use super::relation::Constraint;
use std::f64::consts::PI;

/// A relation that might hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// The relation.
    pub constraint: Constraint,
    /// The width of the range over which each of its residuals would spread evenly if the parts had nothing
    /// to do with each other: half a turn for directions, the larger of two lengths or radii, the drawing's
    /// extent for places.
    pub range: f64,
}

/// All relations that may be proposed for a drawing.
///
/// Of every bar: horizontal, vertical. Of two bars: parallel, perpendicular, equally long. Of two circles:
/// concentric, equal radii, tangent from outside and inside. Of a bar and a circle: tangent; of an arc and a
/// bar that meet: tangent there. Of two points and an axis: symmetric. Distances are no candidates;
/// [`snap`](crate::constraint::snap) proposes those.
#[must_use]
pub fn candidates(drawing: &ParametricDrawing) -> Vec<Candidate> {
    let extent = drawing.extent();
    let mut found = Vec::new();
    let mut add = |constraint, range| found.push(Candidate { constraint, range });
    let bars: Vec<BarId> = drawing.bars().collect();
    let circles: Vec<CircleId> = drawing.circles().collect();
    for (i, &a) in bars.iter().enumerate() {
        let length = drawing.length(a);
        add(Constraint::Horizontal { bar: a }, PI * length);
        add(Constraint::Vertical { bar: a }, PI * length);
        for &b in &bars[i + 1..] {
            add(Constraint::Parallel { a, b }, PI);
            add(Constraint::Perpendicular { a, b }, PI);
            if !drawing.is_axis(a) && !drawing.is_axis(b) {
                add(Constraint::EqualLength { a, b }, length.max(drawing.length(b)));
            }
        }
        for &circle in circles.iter().filter(|&&circle| !meets_arc(drawing, a, circle)) {
            let left = is_left(drawing, circle, a);
            add(Constraint::Tangent { bar: a, circle, left }, extent);
        }
    }
    for (circle, start, end) in drawing.arcs() {
        for (bar, point) in bars_at(drawing, [start, end]) {
            let range = PI * drawing.radius(circle);
            add(Constraint::TangentAt { bar, circle, point }, range);
        }
    }
    for (i, &a) in circles.iter().enumerate() {
        for &b in &circles[i + 1..] {
            let larger = drawing.radius(a).max(drawing.radius(b));
            add(Constraint::EqualRadius { a, b }, larger);
            if drawing.centre(a) != drawing.centre(b) {
                add(Constraint::Concentric { a, b }, extent);
                let inside = is_inside(drawing, a, b);
                add(Constraint::TangentCircles { a, b, inside }, extent);
            }
        }
    }
    let points: Vec<_> = drawing.points().collect();
    for &about in bars.iter().filter(|&&bar| drawing.is_axis(bar)) {
        let ends = drawing.ends(about);
        for (i, &a) in points.iter().enumerate().filter(|(_, point)| !ends.contains(point)) {
            for &b in points[i + 1..].iter().filter(|point| !ends.contains(point)) {
                add(Constraint::Symmetric { a, b, about }, extent);
            }
        }
    }
    found
}

/// Bars that end at one of two points, with that point.
fn bars_at(drawing: &ParametricDrawing, points: [PointId; 2]) -> impl Iterator<Item = (BarId, PointId)> {
    let pairs = drawing.bars().flat_map(move |bar| points.map(|point| (bar, point)));
    pairs.filter(|&(bar, point)| drawing.ends(bar).contains(&point))
}

/// Whether a bar goes on as an arc of a circle: then it may touch the circle only where they meet.
fn meets_arc(drawing: &ParametricDrawing, bar: BarId, circle: CircleId) -> bool {
    let mut arcs = drawing.arcs().filter(|arc| arc.0 == circle);
    arcs.any(|(_, start, end)| drawing.ends(bar).iter().any(|&point| point == start || point == end))
}

/// Whether a circle's centre lies to the left of a bar.
pub(super) fn is_left(drawing: &ParametricDrawing, circle: CircleId, bar: BarId) -> bool {
    let offset = Constraint::PointLineDistance { point: drawing.centre(circle), bar, value: 0.0 };
    offset.equations(drawing, drawing.values().as_slice())[0].residual >= 0.0
}

/// Whether two circles are nearer to touching from inside than from outside.
pub(super) fn is_inside(drawing: &ParametricDrawing, a: CircleId, b: CircleId) -> bool {
    let gap = |inside| {
        Constraint::TangentCircles { a, b, inside }.equations(drawing, drawing.values().as_slice())[0]
            .residual
            .abs()
    };
    gap(true) < gap(false)
}
