//! Even quads: each pulls its corners towards the nearest square, and vertices move along the mesh.
//!
//! Squares of any size are allowed, so quads may be large in one place and small in another. Quads that are
//! turned over are pulled apart, because a square keeps the orientation of the mesh. Means of neighbours,
//! as in Laplacian smoothing, would instead move all vertices of a bent tube to its inner side. Vertices on
//! creases move along them, and others stay between them. Edges inside of a fan of more than 180° at a corner
//! take the directions that the cells there have ([`QuadDomain::concave_fans`]).

use super::network::Place;
use planish_core::DVec3;
use planish_core::vector3::tangents;
use planish_mesh::MeshSearch;
use planish_spline::{ConcaveFan, QuadDomain};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

/// Rounds for a new layout, and for one of which the vertices are even already.
pub(super) const ROUNDS: usize = 20;
pub(super) const FEW_ROUNDS: usize = 2;
/// Share of the way to the mean of the corners of squares.
const STEP: f64 = 0.7;
/// Weight of the middle between the neighbours on a crease. Beside narrow quads, squares alone would draw
/// vertices of a crease together.
const EVEN: f64 = 0.5;
/// Share of the way to the direction of an edge inside of a concave fan.
const TURN: f64 = 0.8;
/// Smallest angle in space of such a fan. Those of less are defects of the layout.
const MIN_CONCAVE: f64 = 1.1 * PI;
/// Smallest square, as a share of the mean distance of the corners from the middle of their quad.
const MIN_SIZE: f64 = 0.5;
/// Corners of a square.
const SQUARE: [[f64; 2]; 4] = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];

/// Moves the vertices of a closed domain along a mesh, each within its place.
pub(super) fn relax(domain: &QuadDomain, positions: &mut Vec<DVec3>, places: &[Place], rounds: usize) {
    let mut corners_of = vec![Vec::new(); positions.len()];
    for (q, quad) in domain.cells().iter().enumerate() {
        (0..4).for_each(|k| corners_of[quad[k] as usize].push((q, k)));
    }
    let mut normals = vec![DVec3::ZERO; positions.len()];
    for quad in domain.cells() {
        let [a, b, c, d] = quad.map(|v| positions[v as usize]);
        let normal = (c - a).cross(d - b);
        quad.iter().for_each(|&v| normals[v as usize] += normal);
    }
    let mut on: Vec<(DVec3, DVec3)> =
        (0..positions.len()).into_par_iter().map(|v| within(&places[v], positions[v], normals[v])).collect();
    let turned = domain.concave_fans();
    let mut along: Vec<Vec<u32>> = vec![Vec::new(); positions.len()];
    for &[a, b] in domain.creases() {
        along[a as usize].push(b);
        along[b as usize].push(a);
    }
    for _ in 0..rounds {
        let squares: Vec<[DVec3; 4]> =
            domain.cells().par_iter().map(|quad| square_near(quad.map(|v| on[v as usize]))).collect();
        on = (0..on.len())
            .into_par_iter()
            .map(|v| {
                let (at, normal) = on[v];
                let own = &corners_of[v];
                let mut mean = own.iter().map(|&(q, k)| squares[q][k]).sum::<DVec3>() / own.len() as f64;
                if let (Place::Along(_), &[a, b]) = (&places[v], &along[v][..]) {
                    mean = mean.lerp(0.5 * (on[a as usize].0 + on[b as usize].0), EVEN);
                }
                if matches!(places[v], Place::Fixed) {
                    return on[v];
                }
                // Without its part along the normal, the step stays near this side of a thin part.
                let step = STEP * (mean - at);
                within(&places[v], at + step - step.dot(normal) * normal, normal)
            })
            .collect();
        turn_edges(&turned, &mut on, places);
    }
    *positions = on.into_iter().map(|(point, _)| point).collect();
}

/// Moves the ends of edges inside of concave fans towards the places that the tangents of the cells ask for.
///
/// Divisions turn such edges away from these directions. In an L bracket, edges that were 14° off had folded
/// pieces after four divisions. Fans of less than 180° in space are left as they are.
fn turn_edges(fans: &[ConcaveFan], on: &mut [(DVec3, DVec3)], places: &[Place]) {
    let mut turned: Vec<(usize, DVec3)> = Vec::new();
    for fan in fans {
        let corner = on[fan.corner as usize].0;
        let ways: Vec<DVec3> = fan.ends.iter().map(|&v| on[v as usize].0 - corner).collect();
        let angle: f64 = ways.windows(2).map(|pair| pair[0].angle_between(pair[1])).sum();
        let (first, last) = (ways[0], ways[ways.len() - 1]);
        if angle < MIN_CONCAVE || !angle.is_finite() {
            continue;
        }
        for (&end, [a, b]) in fan.ends[1..].iter().zip(&fan.shares) {
            turned.push((end as usize, corner + *a * first + *b * last));
        }
    }
    for (v, target) in turned {
        if let Place::On(_) = places[v] {
            let (at, normal) = on[v];
            on[v] = within(&places[v], at.lerp(target, TURN), normal);
        }
    }
}

/// The point of a place nearest to a position, with its normal. That of a crease has none: it would differ
/// from those of the quads on both sides.
fn within(place: &Place, position: DVec3, normal: DVec3) -> (DVec3, DVec3) {
    match place {
        Place::On(mesh) => nearest(mesh, position, normal),
        Place::Along(curve) => (curve.nearest(position).0, DVec3::ZERO),
        Place::Fixed => (position, DVec3::ZERO),
    }
}

/// The point of a mesh nearest to a position, on triangles that face the side of a normal, with its own
/// normal. The other side of a thin part is nearer to positions beneath the surface.
fn nearest(mesh: &MeshSearch, position: DVec3, normal: DVec3) -> (DVec3, DVec3) {
    (mesh.closest_compatible(position, normal, FRAC_PI_2))
        .or_else(|| mesh.closest(position))
        .map_or((position, normal), |on| (on.point, on.normal))
}

/// The corners of the square nearest to those of a quad, in the plane across their mean normal.
fn square_near(corners: [(DVec3, DVec3); 4]) -> [DVec3; 4] {
    let middle = 0.25 * corners.iter().map(|(p, _)| *p).sum::<DVec3>();
    let sum = corners.iter().map(|(_, n)| *n).sum::<DVec3>();
    // With all corners on creases, the normal is that of the quad.
    let [a, b, c, d] = corners.map(|(p, _)| p);
    let across = if sum == DVec3::ZERO { (c - a).cross(d - b) } else { sum };
    let Some(normal) = across.try_normalize() else {
        return corners.map(|(p, _)| p);
    };
    let (e1, e2) = tangents(normal);
    // With complex numbers z for the corners and s for those of a square, the factor of least squares is
    // Σ s̄ z / Σ |s|².
    let (mut re, mut im, mut size) = (0.0, 0.0, 0.0);
    for ((p, _), [x, y]) in corners.iter().zip(SQUARE) {
        let (u, v) = ((*p - middle).dot(e1), (*p - middle).dot(e2));
        re += 0.125 * (x * u + y * v);
        im += 0.125 * (x * v - y * u);
        size += 0.25 * u.hypot(v) / std::f64::consts::SQRT_2;
    }
    let own = re.hypot(im);
    let scale = if own > 0.0 { own.max(MIN_SIZE * size) / own } else { 0.0 };
    SQUARE.map(|[x, y]| {
        let (u, v) = (scale * (re * x - im * y), scale * (re * y + im * x));
        middle + u * e1 + v * e2
    })
}
