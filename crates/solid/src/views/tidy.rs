//! Curves tidied: what drawing programs leave in pieces, or fit only roughly, on the circle that it means.
//!
//! Comes in: the curves of a view. Goes out: the same curves, where an arc or a short chord whose points lie on another arc's circle is on that
//! very circle, and circles whose points allow it have round centres and radii. Exported outlines are cut at every crossing; a circle fitted to
//! a short piece has a centre far off, though the piece itself is where it should be.
//!
//! Not guaranteed: ellipses and splines are left as they are.

use super::drawing::{Curve2, DrawnCurve, View, distance};
use std::f64::consts::TAU;

/// Points of arcs within this share of the drawing's size of a circle lie on it.
const ON_CIRCLE: f64 = 2e-5;
/// Ends of a chord within this share of the size of a circle lie on it.
const CHORD_ENDS: f64 = 1e-6;
/// Curves shorter than this share of the size are crumbs that tell nothing.
const SHORTEST: f64 = 3e-7;
/// Circles are moved to round values where their points move by no more than this share of the size, plus [`ROUND_LENGTH`].
const ROUND: f64 = 5e-8;
const ROUND_LENGTH: f64 = 4e-6;

/// A circle.
#[derive(Clone, Copy)]
struct Circle {
    center: [f64; 2],
    radius: f64,
}

impl Circle {
    fn off(&self, p: [f64; 2]) -> f64 {
        (distance(p, self.center) - self.radius).abs()
    }

    fn angle(&self, p: [f64; 2]) -> f64 {
        (p[1] - self.center[1]).atan2(p[0] - self.center[0])
    }

    /// The arc of this circle from one point to another, counter-clockwise.
    fn arc(&self, from: [f64; 2], to: [f64; 2], whole: bool) -> Curve2 {
        let start = self.angle(from);
        let sweep = if whole {
            TAU
        } else {
            (self.angle(to) - start).rem_euclid(TAU)
        };
        Curve2::Arc {
            center: self.center,
            radius: self.radius,
            start,
            sweep,
        }
    }

    /// Round centre and radius, where all points stay within a distance.
    fn rounded(self, points: &[[f64; 2]], within: f64) -> Self {
        let round = |v: f64| (v * 1e4).round() / 1e4;
        let round = Self {
            center: self.center.map(round),
            radius: round(self.radius),
        };
        match round.radius > 0.0 && points.iter().all(|p| round.off(*p) <= within) {
            true => round,
            false => self,
        }
    }
}

/// A view with its curves tidied, for a drawing of a size.
pub(super) fn tidied(view: &View, size: f64) -> View {
    let mut circles: Vec<Circle> = Vec::new();
    let mut curves = view.curves.clone();
    // What spans most of a circle tells best where it is.
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
        let circle = match circles.iter().filter(|c| on(c)).min_by(|a, b| {
            let far = |c: &Circle| points.iter().map(|p| c.off(*p)).fold(0.0, f64::max);
            far(a).total_cmp(&far(b))
        }) {
            Some(circle) => *circle,
            None => {
                let circle = Circle { center, radius }.rounded(&points, ROUND * size + ROUND_LENGTH);
                circles.push(circle);
                circle
            }
        };
        curves[index].curve = circle.arc(points[0], points[points.len() - 1], sweep >= TAU - 1e-9);
    }
    for drawn in &mut curves {
        let Curve2::Segment(a, b) = drawn.curve else { continue };
        let middle = [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0];
        let is_chord = |c: &&Circle| {
            let ends = [a, b].iter().all(|p| c.off(*p) <= CHORD_ENDS * size);
            ends && c.off(middle) <= ON_CIRCLE * size
        };
        if let Some(circle) = circles.iter().find(is_chord) {
            let (arc, back) = (circle.arc(a, b, false), circle.arc(b, a, false));
            let shorter = if arc.length() <= back.length() { arc } else { back };
            drawn.curve = shorter;
        }
    }
    curves.retain(|c: &DrawnCurve| c.curve.length() > SHORTEST * size);
    View {
        kind: view.kind,
        curves,
    }
}
