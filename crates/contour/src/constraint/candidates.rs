//! Candidate relations of a drawing, each with the range of its residual among unrelated parts.

use super::drawing::{BarId, CircleId, ParametricDrawing, PointId};
use super::relation::Constraint;
use std::f64::consts::PI;

/// A relation to be tested.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// The relation.
    pub constraint: Constraint,
    /// Width of the range over which each residual would be evenly distributed if the parts were unrelated.
    ///
    /// It is π for directions, the larger of two lengths or radii, and the extent of the drawing for
    /// positions.
    pub range: f64,
}

/// All candidate relations of a drawing.
///
/// | parts | relations |
/// |---|---|
/// | a bar | horizontal, vertical |
/// | two bars | parallel, perpendicular, equal length |
/// | two circles | concentric, equal radii, tangent from outside or inside |
/// | a bar and a circle | tangent; at the common point if the bar continues as an arc of the circle |
/// | two points and an axis | symmetric |
///
/// Dimensions are not candidates; see [`snap`](crate::constraint::snap).
///
/// # Examples
/// ```
/// use planish_contour::constraint::{ParametricDrawing, candidates};
///
/// let triangle = ParametricDrawing::polygon(&[[0.0, 0.0], [4.0, 0.0], [0.0, 3.0]])?;
/// assert_eq!(candidates(&triangle).len(), 3 * 2 + 3 * 3); // three bars, three pairs of bars
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[must_use]
pub fn candidates(drawing: &ParametricDrawing) -> Vec<Candidate> {
    let extent = drawing.extent();
    let mut found = Vec::new();
    let mut add = |constraint, range| found.push(Candidate { constraint, range });
    let bars: Vec<BarId> = drawing.bars().collect();
    let circles: Vec<CircleId> = drawing.circles().collect();
    for (i, &a) in bars.iter().enumerate() {
        let length = drawing.length(a);
        // The residual is a difference of coordinates, length times sine: over all directions its density at
        // zero is that of a range of π times the length.
        add(Constraint::Horizontal { bar: a }, PI * length);
        add(Constraint::Vertical { bar: a }, PI * length);
        for &b in &bars[i + 1..] {
            add(Constraint::Parallel { a, b }, PI);
            add(Constraint::Perpendicular { a, b }, PI);
            // The ends of an axis are arbitrary: its length is meaningless.
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
            // The residual is the radius times a sine, as for horizontal bars.
            let range = PI * drawing.radius(circle);
            add(Constraint::TangentAt { bar, circle, point }, range);
        }
    }
    for (i, &a) in circles.iter().enumerate() {
        for &b in &circles[i + 1..] {
            let max_radius = drawing.radius(a).max(drawing.radius(b));
            add(Constraint::EqualRadius { a, b }, max_radius);
            // Circles drawn about one point are concentric by construction, and can never touch.
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

/// Bars that end at one of two points, each with that point.
fn bars_at(drawing: &ParametricDrawing, points: [PointId; 2]) -> impl Iterator<Item = (BarId, PointId)> {
    let pairs = drawing.bars().flat_map(move |bar| points.map(|point| (bar, point)));
    pairs.filter(|&(bar, point)| drawing.ends(bar).contains(&point))
}

/// True if a bar continues as an arc of a circle. It can then be tangent only at the common point, which is
/// another constraint.
fn meets_arc(drawing: &ParametricDrawing, bar: BarId, circle: CircleId) -> bool {
    let mut arcs = drawing.arcs().filter(|arc| arc.0 == circle);
    arcs.any(|(_, start, end)| drawing.ends(bar).iter().any(|&point| point == start || point == end))
}

/// True if the centre of a circle lies to the left of a bar.
pub(super) fn is_left(drawing: &ParametricDrawing, circle: CircleId, bar: BarId) -> bool {
    let offset = Constraint::PointLineDistance { point: drawing.centre(circle), bar, value: 0.0 };
    offset.equations(drawing, drawing.values().as_slice())[0].residual >= 0.0
}

/// True if two circles are closer to touching from inside than from outside.
pub(super) fn is_inside(drawing: &ParametricDrawing, a: CircleId, b: CircleId) -> bool {
    let gap = |inside| {
        Constraint::TangentCircles { a, b, inside }.equations(drawing, drawing.values().as_slice())[0]
            .residual
            .abs()
    };
    gap(true) < gap(false)
}
