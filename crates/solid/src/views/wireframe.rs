//! Points and straight edges in space that all three views show.
//!
//! Input: a drawing of three views. Output: points whose images are ends of curves in each view, and
//! straight edges between them that are drawn, visible or hidden, in each. Edges parallel to an axis are
//! omitted, because they lie in no plane oblique to all views.
//!
//! Not guaranteed: the solid may not have these edges, since images of different edges may agree by chance.
//!
//! # References
//! Wesley and Markowsky 1981, *Fleshing out projections*: the pseudo wireframe.

use crate::drawing::{Curve2, Drawing, distance};
use planish_core::DVec3;

/// Maximum number of points. Drawings with more are not searched for oblique faces, which bounds the time.
const MAX_POINTS: usize = 1500;
/// Maximum number of points whose images are on one line. Lines with more are skipped: each pair of points is
/// tested against all others, so the time grows with the cube.
const MAX_ON_LINE: usize = 60;

/// Points and edges in space.
pub(super) struct Wireframe {
    pub(super) points: Vec<DVec3>,
    /// Pairs of points with no third one between them.
    pub(super) edges: Vec<[usize; 2]>,
    /// For each point, true if it is the end of a curve that is not straight, in any view.
    pub(super) ends_curve: Vec<bool>,
}

/// A point of a view at which curves end.
struct End {
    at: [f64; 2],
    of_slanted: bool,
    of_curve: bool,
}

/// A straight line of a view that is parallel to no axis.
pub(super) struct Slanted {
    from: [f64; 2],
    direction: [f64; 2],
    length: f64,
}

impl Slanted {
    fn new(a: [f64; 2], b: [f64; 2], near: f64) -> Option<Self> {
        let length = distance(a, b);
        let slanted = (0..2).all(|k| (a[k] - b[k]).abs() > near);
        slanted.then(|| Self { from: a, direction: [0, 1].map(|k| (b[k] - a[k]) / length), length })
    }

    /// Coordinates of a point along the line, and across it.
    fn place(&self, p: [f64; 2]) -> [f64; 2] {
        let d = [p[0] - self.from[0], p[1] - self.from[1]];
        let [x, y] = self.direction;
        [d[0] * x + d[1] * y, d[1] * x - d[0] * y]
    }
}

/// The points and edges of a drawing whose ends agree within a distance; `None` unless it has three views, or
/// if it has too many points.
pub(super) fn wireframe(drawing: &Drawing, near: f64) -> Option<Wireframe> {
    let axes: Vec<[usize; 3]> = drawing.views.iter().map(|v| v.kind.axes()).collect();
    // Front, top and side, by the axis along which each is seen.
    let by_sight = [1, 2, 0].map(|sight| axes.iter().position(|a| a[2] == sight));
    let [Some(front), Some(top), Some(side)] = by_sight else {
        return None;
    };
    let ends: Vec<Vec<End>> = (0..drawing.views.len()).map(|v| ends(drawing, v, near)).collect();
    let (points, ends_curve) = points(&ends, [front, top, side], near)?;
    let mut edges: Vec<[usize; 2]> = Vec::new();
    for (view, axes) in axes.iter().enumerate() {
        let lines = segments(drawing, view).filter_map(|(a, b)| Slanted::new(a, b, near));
        // Pieces of one straight line are one carrier: edges may reach over several of them.
        let mut known: Vec<Slanted> = Vec::new();
        for line in lines {
            let runs_along = |k: &Slanted| {
                [0.0, line.length].iter().all(|t| {
                    let p = [0, 1].map(|c| line.from[c] + t * line.direction[c]);
                    k.place(p)[1].abs() < near
                })
            };
            if !known.iter().any(runs_along) {
                known.push(line);
            }
        }
        for line in known {
            let mut on: Vec<usize> = (0..points.len())
                .filter(|k| line.place([points[*k][axes[0]], points[*k][axes[1]]])[1].abs() < near)
                .collect();
            if on.len() > MAX_ON_LINE {
                continue;
            }
            // In order along the line, so that the pairs below run in one direction.
            on.sort_by(|a, b| {
                let along = |k: usize| line.place([points[k][axes[0]], points[k][axes[1]]])[0];
                along(*a).total_cmp(&along(*b))
            });
            for (n, &i) in on.iter().enumerate() {
                for &j in &on[n + 1..] {
                    let edge = [i.min(j), i.max(j)];
                    if !edges.contains(&edge)
                        && is_minimal(&points, &on, i, j, near)
                        && drawing.views.iter().enumerate().all(|(v, view)| {
                            let [a, b, _] = view.kind.axes();
                            is_covered(
                                drawing,
                                v,
                                [points[i][a], points[i][b]],
                                [points[j][a], points[j][b]],
                                near,
                            )
                        })
                    {
                        edges.push(edge);
                    }
                }
            }
        }
    }
    Some(Wireframe { points, edges, ends_curve })
}

/// The straight lines of a view.
fn segments(drawing: &Drawing, view: usize) -> impl Iterator<Item = ([f64; 2], [f64; 2])> {
    drawing.views[view].curves.iter().filter_map(|c| match c.curve {
        Curve2::Segment(a, b) => Some((a, b)),
        _ => None,
    })
}

/// The ends of the curves of a view, each point once.
fn ends(drawing: &Drawing, view: usize, near: f64) -> Vec<End> {
    let mut found: Vec<End> = Vec::new();
    for drawn in &drawing.views[view].curves {
        let points = match &drawn.curve {
            Curve2::Segment(a, b) => vec![*a, *b],
            curve => {
                let points = curve.points();
                vec![points[0], points[points.len() - 1]]
            }
        };
        let of_slanted = matches!(drawn.curve, Curve2::Segment(a, b) if Slanted::new(a, b, near).is_some());
        let of_curve = !matches!(drawn.curve, Curve2::Segment(..));
        for at in points {
            // Curves that meet share an end, which has the properties of all of them.
            match found.iter_mut().find(|e| distance(e.at, at) < near) {
                Some(end) => {
                    end.of_slanted |= of_slanted;
                    end.of_curve |= of_curve;
                }
                None => found.push(End { at, of_slanted, of_curve }),
            }
        }
    }
    found
}

/// Points in space at whose image each view has an end, at least one of a slanted line; each with whether one
/// is of a curve.
///
/// Sorted lists by the shared coordinate avoid the product of all ends of three views.
fn points(ends: &[Vec<End>], [front, top, side]: [usize; 3], near: f64) -> Option<(Vec<DVec3>, Vec<bool>)> {
    let mut by_x: Vec<&End> = ends[top].iter().collect();
    by_x.sort_by(|a, b| a.at[0].total_cmp(&b.at[0]));
    let mut by_y: Vec<&End> = ends[side].iter().collect();
    by_y.sort_by(|a, b| a.at[0].total_cmp(&b.at[0]));
    // The top view shares x with the front view, and the side view shares y with the top view and z with the
    // front view: these are the three equations of a point.
    let range = |sorted: &[&End], value: f64| {
        let from = sorted.partition_point(|e| e.at[0] < value - near);
        from..from + sorted[from..].partition_point(|e| e.at[0] <= value + near)
    };
    let (mut points, mut ends_curve) = (Vec::new(), Vec::new());
    for f in &ends[front] {
        for t in &by_x[range(&by_x, f.at[0])] {
            for s in &by_y[range(&by_y, t.at[1])] {
                let is_slanted = f.of_slanted || t.of_slanted || s.of_slanted;
                if !is_slanted || (s.at[1] - f.at[1]).abs() > near {
                    continue;
                }
                // Each coordinate is drawn in two views; the mean halves the variance of rounding.
                points.push(DVec3::new(
                    (f.at[0] + t.at[0]) / 2.0,
                    (t.at[1] + s.at[0]) / 2.0,
                    (f.at[1] + s.at[1]) / 2.0,
                ));
                ends_curve.push(f.of_curve || t.of_curve || s.of_curve);
                if points.len() > MAX_POINTS {
                    return None;
                }
            }
        }
    }
    Some((points, ends_curve))
}

/// True if none of some points lies between two others.
fn is_minimal(points: &[DVec3], on: &[usize], i: usize, j: usize, near: f64) -> bool {
    let d = points[j] - points[i];
    let length = d.length();
    length > near
        && !on.iter().any(|&k| {
            let w = points[k] - points[i];
            let along = (0..3).map(|c| w[c] * d[c]).sum::<f64>() / length;
            let off = (w - along / length * d).length();
            along > near && along < length - near && off < near
        })
}

/// True if straight lines of a view cover the segment between two points without a gap.
fn is_covered(drawing: &Drawing, view: usize, a: [f64; 2], b: [f64; 2], near: f64) -> bool {
    let length = distance(a, b);
    // An edge along the line of sight is a point in this view and needs no line.
    if length < near {
        return true;
    }
    let way = Slanted { from: a, direction: [0, 1].map(|k| (b[k] - a[k]) / length), length };
    let mut runs: Vec<[f64; 2]> = segments(drawing, view)
        .map(|(p, q)| [way.place(p), way.place(q)])
        .filter(|[p, q]| p[1].abs() < near && q[1].abs() < near)
        .map(|[p, q]| [p[0].min(q[0]), p[0].max(q[0])])
        .collect();
    runs.sort_by(|p, q| p[0].total_cmp(&q[0]));
    let mut reached = 0.0;
    for run in runs {
        if run[0] > reached + near {
            break;
        }
        reached = f64::max(reached, run[1]);
    }
    reached >= length - near
}
