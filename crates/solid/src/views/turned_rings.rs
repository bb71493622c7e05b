//! Groups loops on cones, spheres and tori into faces.
//!
//! A ray goes from a loop into the face, along a line of constant angle around the axis. The first loop that
//! it meets bounds the same face. The ray continues around the tube of a torus, and over the pole of a sphere
//! or the apex of a cone.

use super::rings::by_face;
use crate::brep::{Coedge, FaceSurface, Solid, unit};
use planish_core::DVec3;
use std::f64::consts::{PI, TAU};

/// Number of straight pieces that approximate an edge.
const PIECES: usize = 64;
/// Pieces of each edge from which a ray starts.
///
/// Some rays are unusable, because the edge runs along them; five at unequal distances leave others.
const RAYS: [usize; 5] = [13, 22, 31, 42, 51];

/// A loop in the parameters of a surface.
struct Ring {
    /// Ends of each piece; the angle of the second end is the one nearest to that of the first.
    pieces: Vec<[[f64; 2]; 2]>,
    /// Indices of the pieces from which rays start.
    ray_pieces: Vec<usize>,
}

impl Ring {
    fn new(solid: &Solid, surface: &FaceSurface, ring: &[Coedge]) -> Self {
        let periods = surface.periods();
        let (mut pieces, mut ray_pieces) = (Vec::new(), Vec::new());
        for coedge in ring {
            let edge = &solid.edges[coedge.edge];
            let at = |k: usize| {
                let share = k as f64 / PIECES as f64;
                let share = if coedge.forward { share } else { 1.0 - share };
                surface.parameters(edge.curve.point(edge.range[0] + (edge.range[1] - edge.range[0]) * share))
            };
            ray_pieces.extend(RAYS.map(|k| pieces.len() + k));
            for k in 0..PIECES {
                let (a, mut b) = (at(k), at(k + 1));
                for c in 0..2 {
                    if let Some(period) = periods[c] {
                        b[c] -= period * ((b[c] - a[c]) / period).round();
                    }
                }
                pieces.push([a, b]);
            }
        }
        Self { pieces, ray_pieces }
    }

    /// Distance along v, in a direction, from a point to the loop.
    fn seen(&self, surface: &FaceSurface, [u, v]: [f64; 2], direction: f64) -> Option<f64> {
        let tube = surface.periods()[1];
        let mut best: Option<f64> = None;
        for [a, b] in &self.pieces {
            // The neighbouring turns as well: a piece may begin on one side of the ray's angle and end
            // beyond.
            let shift = TAU * ((u - a[0]) / TAU).round();
            for shift in [shift - TAU, shift, shift + TAU] {
                let (from, to) = (a[0] + shift, b[0] + shift);
                // Half-open, so that a ray through a corner meets one of two pieces.
                if (from <= u) == (to <= u) {
                    continue;
                }
                let at = a[1] + (b[1] - a[1]) * (u - from) / (to - from);
                let mut far = direction * (at - v);
                if let Some(period) = tube {
                    far = far.rem_euclid(period);
                    if period - far < 1e-9 {
                        far = 0.0;
                    }
                }
                if far > 1e-9 && best.is_none_or(|best| far < best) {
                    best = Some(far);
                }
            }
        }
        best
    }
}

/// Groups loops into faces. Loops around the axis come first in each.
pub(super) fn turned_faces(
    solid: &Solid,
    surface: &FaceSurface,
    outward: bool,
    loops: Vec<Vec<Coedge>>,
) -> Vec<Vec<Vec<Coedge>>> {
    let rings: Vec<Ring> = loops.iter().map(|l| Ring::new(solid, surface, l)).collect();
    let mut face_of: Vec<usize> = (0..loops.len()).collect();
    for index in 0..rings.len() {
        for &piece in &rings[index].ray_pieces {
            let [a, b] = rings[index].pieces[piece];
            let from = [0.4871 * b[0] + 0.5129 * a[0], 0.4871 * b[1] + 0.5129 * a[1]];
            let Some(direction) = into_face(surface, outward, a, b) else {
                continue;
            };
            let Some(other) = first_seen(&rings, surface, from, direction) else {
                continue;
            };
            let (old, new) = (face_of[index], face_of[other]);
            for face in face_of.iter_mut().filter(|f| **f == old) {
                *face = new;
            }
        }
    }
    // Loops around the axis come first: a face between two of them has no outer loop in parameters.
    by_face(loops, &face_of, |index| {
        let turn: f64 = rings[index].pieces.iter().map(|[a, b]| b[0] - a[0]).sum();
        turn.abs() < PI
    })
}

/// Whether v increases (1) or decreases (−1) from a piece of a loop into the face; `None` if the piece runs
/// along v.
///
/// The face is on the left of its loops, seen from outside.
fn into_face(surface: &FaceSurface, outward: bool, a: [f64; 2], b: [f64; 2]) -> Option<f64> {
    let (p, q) = (surface.point(a), surface.point(b));
    let n = surface.normal(p).map(|c| if outward { c } else { -c });
    let left = n.cross(q - p);
    let small = 1e-4;
    let up = surface.point([a[0], a[1] + small]) - surface.point([a[0], a[1] - small]);
    if left.length() == 0.0 || up.length() == 0.0 {
        return None;
    }
    let rise = unit(left).dot(unit(up));
    // Where the piece runs nearly along v, rounding would decide; other rays of the edge are used.
    (rise.abs() > 0.1).then(|| rise.signum())
}

/// The loop that a ray meets first. A ray that leaves over a pole comes back half a turn further.
fn first_seen(rings: &[Ring], surface: &FaceSurface, from: [f64; 2], direction: f64) -> Option<usize> {
    let nearest = |from: [f64; 2], direction: f64| {
        rings
            .iter()
            .enumerate()
            .filter_map(|(k, ring)| ring.seen(surface, from, direction).map(|far| (far, k)))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|s| s.1)
    };
    if let Some(found) = nearest(from, direction) {
        return Some(found);
    }
    // Nothing was met up to the end of v. Over a pole or an apex, the same meridian continues on the other
    // side.
    let [bottom, top] = surface.range_v();
    let end = if direction > 0.0 { top } else { bottom };
    match end.is_finite() {
        true => nearest([from[0] + PI, end], -direction),
        false => None,
    }
}

/// The sphere with an axis whose poles are away from all edges of some loops.
///
/// At a pole the angle of a parameter is undetermined, so loops through it cannot be unrolled.
pub(super) fn with_free_poles(solid: &Solid, surface: FaceSurface, loops: &[Vec<Coedge>]) -> FaceSurface {
    let FaceSurface::Sphere { center, axis, x, radius } = surface else {
        return surface;
    };
    /// Maximum cosine between the directions of an edge point and a pole (3.6°).
    const MAX_POLE_COSINE: f64 = 0.998;
    let y = axis.cross(x);
    let oblique = unit(axis + 0.61 * x + 0.37 * y);
    let frames = [(axis, x), (x, y), (y, axis), (oblique, unit(oblique.cross(x)))];
    let is_free = |axis: DVec3| {
        loops.iter().flatten().all(|coedge| {
            let edge = &solid.edges[coedge.edge];
            (0..=PIECES).all(|k| {
                let t = edge.range[0] + (edge.range[1] - edge.range[0]) * k as f64 / PIECES as f64;
                unit(edge.curve.point(t) - center).dot(axis).abs() < MAX_POLE_COSINE
            })
        })
    };
    // Of the free axes, the one around which most loops run: readers of STEP handle such loops best.
    let around = |frame: &(DVec3, DVec3)| {
        let (axis, x) = *frame;
        let turned = FaceSurface::Sphere { center, axis, x, radius };
        let turn = |ring: &Vec<Coedge>| -> f64 {
            let pieces = Ring::new(solid, &turned, ring).pieces;
            pieces.iter().map(|[a, b]| b[0] - a[0]).sum()
        };
        loops.iter().filter(|ring| turn(ring).abs() < PI).count()
    };
    let found = frames.into_iter().filter(|(axis, _)| is_free(*axis)).min_by_key(around);
    let (axis, x) = found.unwrap_or(frames[0]);
    FaceSurface::Sphere { center, axis, x, radius }
}
