//! Groups loops on planes and cylinders into faces.

use crate::brep::{Coedge, EdgeCurve, FaceSurface, Solid};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// A loop in the parameters of a surface.
struct Ring {
    /// Points along the loop; angles are continuous, without jumps by a turn.
    points: Vec<[f64; 2]>,
    /// Turns around the axis of a cylinder.
    turns: i32,
    /// Signed area, positive if counter-clockwise.
    area: f64,
}

impl Ring {
    fn new(solid: &Solid, surface: &FaceSurface, coedges: &[Coedge]) -> Self {
        let mut points: Vec<[f64; 2]> = Vec::new();
        let periodic = matches!(surface, FaceSurface::Cylinder { .. });
        for coedge in coedges {
            let edge = &solid.edges[coedge.edge];
            let n = if matches!(edge.curve, EdgeCurve::Line { .. }) { 1 } else { 32 };
            for k in 0..n {
                let share = k as f64 / n as f64;
                let share = if coedge.forward { share } else { 1.0 - share };
                let mut q = surface
                    .parameters(edge.curve.point(edge.range[0] + (edge.range[1] - edge.range[0]) * share));
                if let Some(last) = points.last().filter(|_| periodic) {
                    q[0] -= TAU * ((q[0] - last[0]) / TAU).round();
                }
                points.push(q);
            }
        }
        let mut close = points[0];
        let last = points[points.len() - 1];
        let mut turns = 0;
        if periodic {
            close[0] -= TAU * ((close[0] - last[0]) / TAU).round();
            // Zero for a loop that encloses an area, ±1 for one around the axis.
            turns = ((close[0] - points[0][0]) / TAU).round() as i32;
        }
        points.push(close);
        let area = points.windows(2).map(|p| (p[0][0] * p[1][1] - p[1][0] * p[0][1]) / 2.0).sum();
        Self { points, turns, area }
    }

    /// The smallest v above a point at which the ring crosses the line of constant u.
    fn above(&self, u: f64, v: f64, periodic: bool) -> Option<f64> {
        let mut best: Option<f64> = None;
        for p in self.points.windows(2) {
            // Continuous angles may leave the first turn, so the ring is repeated on both sides.
            let shifts: Vec<f64> = match periodic {
                true => (-3..=3).map(|k| f64::from(k) * TAU).collect(),
                false => vec![0.0],
            };
            for shift in shifts {
                let (a, b) = (p[0][0] + shift, p[1][0] + shift);
                // Half-open: a ray through a common corner of two segments crosses exactly one of them.
                if (a <= u) == (b <= u) {
                    continue;
                }
                let at = p[0][1] + (p[1][1] - p[0][1]) * (u - a) / (b - a);
                if at > v && best.is_none_or(|best| at < best) {
                    best = Some(at);
                }
            }
        }
        best
    }
}

/// Groups loops into faces.
///
/// The first loop above the highest segment of a hole, along the line of constant u, belongs to the same
/// face. Chains of holes end at an outer loop, so each hole needs only one ray.
pub(super) fn faces(
    solid: &Solid,
    surface: &FaceSurface,
    outward: bool,
    loops: Vec<Vec<Coedge>>,
) -> Vec<Vec<Vec<Coedge>>> {
    let rings: Vec<Ring> = loops.iter().map(|l| Ring::new(solid, surface, l)).collect();
    let periodic = matches!(surface, FaceSurface::Cylinder { .. });
    let sense = if outward { 1.0 } else { -1.0 };
    let mut face_of: Vec<usize> = (0..loops.len()).collect();
    for (index, ring) in rings.iter().enumerate() {
        // An outer loop encloses the face and needs no ray.
        let is_outer = ring.turns == 0 && ring.area * sense > 0.0;
        // Loops around the axis that bound from below look up as well.
        let is_upper = ring.turns != 0 && f64::from(ring.turns) * sense < 0.0;
        if is_outer || is_upper {
            continue;
        }
        // A place within the highest segment that is not steep: never a corner, where two segments meet.
        let top = ring
            .points
            .windows(2)
            .filter(|p| (p[0][0] - p[1][0]).abs() > 1e-9)
            .max_by(|p, q| (p[0][1] + p[1][1]).total_cmp(&(q[0][1] + q[1][1])));
        let Some(top) = top else { continue };
        let share = 0.4871;
        let u = top[0][0] + share * (top[1][0] - top[0][0]);
        let v = top[0][1] + share * (top[1][1] - top[0][1]);
        // Above the ring itself, which the ray would otherwise meet at once.
        let small = 1e-9 * (1.0 + v.abs());
        let seen = rings
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != index)
            .filter_map(|(other, r)| r.above(u, v + small, periodic).map(|at| (at, other)))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, other)) = seen {
            let (from, to) = (face_of[index], face_of[other]);
            for face in &mut face_of {
                if *face == from {
                    *face = to;
                }
            }
        }
    }
    by_face(loops, &face_of, |index| rings[index].turns == 0 && rings[index].area * sense < 0.0)
}

/// The loops of each face, outer loops before holes, in the order of the face numbers.
pub(super) fn by_face(
    loops: Vec<Vec<Coedge>>,
    face_of: &[usize],
    is_hole: impl Fn(usize) -> bool,
) -> Vec<Vec<Vec<Coedge>>> {
    let mut grouped: BTreeMap<usize, Vec<(bool, Vec<Coedge>)>> = BTreeMap::new();
    for (index, ring) in loops.into_iter().enumerate() {
        grouped.entry(face_of[index]).or_default().push((is_hole(index), ring));
    }
    grouped
        .into_values()
        .map(|mut loops| {
            loops.sort_by_key(|l| l.0);
            loops.into_iter().map(|l| l.1).collect()
        })
        .collect()
}
