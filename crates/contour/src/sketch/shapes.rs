//! Drawing of each kind of contour, and its parameters from the drawing.

use crate::constraint::{Constraint, ParametricDrawing, PointId};
use crate::planar::{ContourKind, arc_circle};
use planish_estimate::{Error, Result};
use std::f64::consts::TAU;

/// The drawing of one contour with the constraints of its kind.
pub(super) struct Drawn {
    pub(super) drawing: ParametricDrawing,
    pub(super) given: Vec<Constraint>,
}

/// Draws a contour. The order of parts is the one that [`parameters`] reads.
pub(super) fn drawn(
    kind: &ContourKind,
    theta: &[f64],
    observed_ends: Option<[[f64; 2]; 2]>,
) -> Result<Drawn> {
    let mut drawing = ParametricDrawing::default();
    let mut given = Vec::new();
    match kind {
        ContourKind::Line => {
            let Some(observed_ends) = observed_ends else {
                return Err(Error::input(
                    "a line without ends cannot be drawn: expected the ends of its observed part",
                ));
            };
            let (sin, cos) = theta[0].sin_cos();
            // The ends of the observed part lie near the line, not on it: project them.
            let [a, b] = observed_ends.map(|p| {
                let along = cos * p[0] + sin * p[1];
                drawing.point([along * cos - theta[1] * sin, along * sin + theta[1] * cos])
            });
            drawing.bar(a, b)?;
        }
        ContourKind::Circle => {
            let centre = drawing.point([theta[0], theta[1]]);
            drawing.circle(centre, theta[2])?;
        }
        ContourKind::Ellipse => {
            let (sin, cos) = theta[4].sin_cos();
            let centre = drawing.point([theta[0], theta[1]]);
            let major = drawing.point([theta[0] + theta[2] * cos, theta[1] + theta[2] * sin]);
            let minor = drawing.point([theta[0] - theta[3] * sin, theta[1] + theta[3] * cos]);
            let (a, b) = (drawing.bar(centre, major)?, drawing.bar(centre, minor)?);
            given.push(Constraint::Perpendicular { a, b });
        }
        ContourKind::Rectangle | ContourKind::RoundedRectangle => {
            let bars = drawing.add_polygon(&corners(theta))?;
            // Three right angles imply the fourth.
            given.extend((0..3).map(|i| Constraint::Perpendicular { a: bars[i], b: bars[i + 1] }));
            if *kind == ContourKind::RoundedRectangle {
                let (sin, cos) = theta[4].sin_cos();
                let local = [theta[5] - 0.5 * theta[2], theta[5] - 0.5 * theta[3]];
                let centre = drawing.point([
                    theta[0] + cos * local[0] - sin * local[1],
                    theta[1] + sin * local[0] + cos * local[1],
                ]);
                let circle = drawing.circle(centre, theta[5])?;
                // One circle stands for all four corners, which have the same radius by definition.
                given.extend([bars[3], bars[0]].map(|bar| Constraint::Tangent { bar, circle, left: true }));
            }
        }
        ContourKind::Slot => {
            let (sin, cos) = theta[4].sin_cos();
            let reach = 0.5 * (theta[2] - theta[3]);
            let [a, b] = [-reach, reach].map(|t| drawing.point([theta[0] + t * cos, theta[1] + t * sin]));
            drawing.bar(a, b)?;
            let [a, b] = [drawing.circle(a, 0.5 * theta[3])?, drawing.circle(b, 0.5 * theta[3])?];
            given.push(Constraint::EqualRadius { a, b });
        }
        ContourKind::RegularPolygon(sides) => {
            let corner = |i: usize| {
                let angle = theta[3] + TAU * i as f64 / *sides as f64;
                [theta[0] + theta[2] * angle.cos(), theta[1] + theta[2] * angle.sin()]
            };
            let vertices: Vec<[f64; 2]> = (0..*sides).map(corner).collect();
            let bars = drawing.add_polygon(&vertices)?;
            let radians = TAU / *sides as f64;
            given.extend(bars.windows(2).map(|pair| Constraint::EqualLength { a: pair[0], b: pair[1] }));
            // n − 1 equal lengths and n − 3 angles leave four degrees of freedom; the other angles follow
            // from the closed polygon.
            let turns = bars.windows(2).take(sides - 3);
            given.extend(turns.map(|pair| Constraint::Angle { from: pair[0], to: pair[1], radians }));
        }
        ContourKind::Polygon(count) => {
            let vertices: Vec<[f64; 2]> = (0..*count).map(|i| [theta[2 * i], theta[2 * i + 1]]).collect();
            drawing.add_polygon(&vertices)?;
        }
        ContourKind::Chain { arcs, closed } => chain(&mut drawing, &mut given, arcs, *closed, theta)?,
    }
    Ok(Drawn { drawing, given })
}

/// Draws the vertices of a chain, a bar for each straight piece, and a circle with an arc for each other
/// piece.
fn chain(
    drawing: &mut ParametricDrawing,
    given: &mut Vec<Constraint>,
    arcs: &[bool],
    closed: bool,
    theta: &[f64],
) -> Result<()> {
    let count = arcs.len() + usize::from(!closed);
    let at = |i: usize| [theta[2 * (i % count)], theta[2 * (i % count) + 1]];
    let points: Vec<PointId> = (0..count).map(|i| drawing.point(at(i))).collect();
    let mut bulge = 2 * count;
    for (i, &is_arc) in arcs.iter().enumerate() {
        let (from, to) = (points[i], points[(i + 1) % count]);
        if !is_arc {
            drawing.bar(from, to)?;
            continue;
        }
        let (centre, radius) = arc_circle(at(i), at(i + 1), theta[bulge]);
        let centre = drawing.point(centre);
        let circle = drawing.circle(centre, radius)?;
        // Arcs of a drawing run counter-clockwise; a piece with a negative bulge runs clockwise.
        let (start, end) = if theta[bulge] > 0.0 { (from, to) } else { (to, from) };
        let arc = drawing.arc(circle, start, end);
        given.extend(drawing.arc_constraints(arc));
        bulge += 1;
    }
    Ok(())
}

/// Corners of a rectangle, counter-clockwise from the lower left one in its own axes.
fn corners(theta: &[f64]) -> [[f64; 2]; 4] {
    let (sin, cos) = theta[4].sin_cos();
    [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(x, y)| {
        let (x, y) = (x * theta[2], y * theta[3]);
        [theta[0] + cos * x - sin * y, theta[1] + sin * x + cos * y]
    })
}

/// Parameters of a contour from the values of its drawing; the estimated ones select the direction of arcs.
pub(super) fn parameters(kind: &ContourKind, x: &[f64], before: &[f64]) -> Vec<f64> {
    let at = |i: usize| [x[2 * i], x[2 * i + 1]];
    let between = |a: [f64; 2], b: [f64; 2]| [b[0] - a[0], b[1] - a[1]];
    let length = |d: [f64; 2]| d[0].hypot(d[1]);
    let angle = |d: [f64; 2]| d[1].atan2(d[0]);
    let middle = |count: usize| {
        let sum = (0..count).fold([0.0; 2], |sum, i| [sum[0] + at(i)[0], sum[1] + at(i)[1]]);
        sum.map(|s| s / count as f64)
    };
    match kind {
        ContourKind::Line => {
            let turn = angle(between(at(0), at(1)));
            let (sin, cos) = turn.sin_cos();
            vec![turn, cos * x[1] - sin * x[0]]
        }
        ContourKind::Circle | ContourKind::Polygon(_) => x.to_vec(),
        ContourKind::Ellipse => {
            let (major, minor) = (between(at(0), at(1)), between(at(0), at(2)));
            vec![x[0], x[1], length(major), length(minor), angle(major)]
        }
        ContourKind::Rectangle | ContourKind::RoundedRectangle => {
            // The centroid of the corners uses all of them alike; at an exact rectangle any choice is the
            // same.
            let center = middle(4);
            let (width, height) = (between(at(0), at(1)), between(at(1), at(2)));
            let mut theta = vec![center[0], center[1], length(width), length(height), angle(width)];
            if *kind == ContourKind::RoundedRectangle {
                theta.push(x[10]);
            }
            theta
        }
        ContourKind::Slot => {
            let (a, b) = (at(0), at(1));
            let along = between(a, b);
            // Both radii are equal under the constraint of the kind; the mean serves before it is imposed.
            let radius = 0.5 * (x[4] + x[5]);
            vec![
                0.5 * (a[0] + b[0]),
                0.5 * (a[1] + b[1]),
                length(along) + 2.0 * radius,
                2.0 * radius,
                angle(along),
            ]
        }
        ContourKind::RegularPolygon(sides) => {
            let center = middle(*sides);
            // All corners are equivalent under the constraints; the first one defines size and angle.
            let first = between(center, at(0));
            vec![center[0], center[1], length(first), angle(first)]
        }
        ContourKind::Chain { arcs, closed } => {
            let count = arcs.len() + usize::from(!closed);
            let mut theta = x[..2 * count].to_vec();
            let mut next = 2 * count;
            for (k, i) in (0..arcs.len()).filter(|&i| arcs[i]).enumerate() {
                let (centre, a, b) = ([x[next], x[next + 1]], at(i), at((i + 1) % count));
                theta.push(bulge(centre, a, b, before[2 * count + k]));
                next += 3;
            }
            theta
        }
    }
}

/// Bulge of the arc from `a` to `b` about a centre, with the period nearest to the bulge before.
fn bulge(centre: [f64; 2], a: [f64; 2], b: [f64; 2], before: f64) -> f64 {
    let turn = (b[1] - centre[1]).atan2(b[0] - centre[0]) - (a[1] - centre[1]).atan2(a[0] - centre[0]);
    let turns = ((4.0 * before.atan() - turn) / TAU).round();
    (0.25 * (turn + turns * TAU)).tan()
}
