//! Quads from triangles, with as few extraordinary vertices as local changes reach.
//!
//! Pairs of triangles become quads. The triangles that are left are moved through quads until two meet: a
//! triangle and a quad are a pentagon, which can be divided into a quad and a triangle at any other side. A
//! closed surface has an even number of them. Then vertices of two quads are removed, quads are collapsed and
//! edges are turned where that brings the numbers of quads at vertices nearer to four.
//!
//! # References
//! Tarini, Pietroni, Cignoni, Panozzo, Puppo, *Practical quad mesh simplification*, Computer Graphics Forum
//! 29, 2010: the local changes.

use super::decimation::Decimation;
use super::faces::{Face, Faces};
use planish_core::DVec3;
use std::collections::{HashMap, HashSet, VecDeque};
use std::f64::consts::FRAC_PI_2;

/// Largest deviation of a corner of a quad from a right angle.
const MAX_SKEW: f64 = 1.2;
/// The same for quads beside a turned edge.
const MAX_SKEW_TURNED: f64 = 1.5;
/// Defect of a vertex of two quads: it is not allowed.
const TWO_QUADS: i64 = 100;

type Edge = (u32, u32);
/// For each face, the triangle from which it was reached, and the face and edge before it.
type Reached = HashMap<u32, (u32, Option<(u32, Edge)>)>;

/// Turns all triangles into quads. False if some are left.
pub(super) fn pair(coarse: &mut Decimation, at: &[DVec3]) -> bool {
    let faces = &coarse.faces;
    let mut pairs: Vec<(bool, f64, Edge)> = Vec::new();
    for edge in faces.edges() {
        let Some(both) = faces.sides(edge) else { continue };
        let own = skew(&both.corners, at);
        let is_diagonal = coarse.is_diagonal(edge);
        if is_diagonal || own < MAX_SKEW {
            pairs.push((!is_diagonal, own, edge));
        }
    }
    pairs.sort_unstable_by(|x, y| (x.0.cmp(&y.0)).then(x.1.total_cmp(&y.1)).then(x.2.cmp(&y.2)));
    let faces = &mut coarse.faces;
    for (_, _, edge) in pairs {
        join(faces, edge);
    }
    meet(faces, at)
}

/// Makes a quad of two triangles at an edge.
fn join(faces: &mut Faces, edge: Edge) -> bool {
    let Some(both) = faces.sides(edge) else { return false };
    let Ok(corners) = both.corners.try_into() else { return false };
    faces.replace(&both.faces, &[Face::quad(corners)]).is_some()
}

/// Largest deviation of the four corners of a quad from right angles.
fn skew(corners: &[u32], at: &[DVec3]) -> f64 {
    let [a, b, c, d] = [0, 1, 2, 3].map(|k| at[corners[k] as usize]);
    let normal = (c - a).cross(d - b).normalize_or_zero();
    let angle = |before: DVec3, own: DVec3, after: DVec3| {
        let (x, y) = (after - own, before - own);
        (x.cross(y).dot(normal).atan2(x.dot(y)) - FRAC_PI_2).abs()
    };
    angle(d, a, b).max(angle(a, b, c)).max(angle(b, c, d)).max(angle(c, d, a))
}

/// Moves triangles until they meet in pairs. False if some are left.
fn meet(faces: &mut Faces, at: &[DVec3]) -> bool {
    let mut blocked = HashSet::new();
    while let Some(path) = shortest_path(faces, &blocked) {
        for (k, &edge) in path.iter().enumerate() {
            let is_moved = match path.get(k + 1) {
                None => join(faces, edge),
                Some(next) => move_triangle(faces, at, edge, *next),
            };
            if !is_moved {
                // Another path avoids this edge.
                blocked.insert(edge);
                break;
            }
        }
    }
    !faces.has_triangles()
}

/// Divides the pentagon of a triangle and a quad at an edge into a triangle at the next edge, and a quad.
fn move_triangle(faces: &mut Faces, at: &[DVec3], edge: Edge, next: Edge) -> bool {
    let Some(both) = faces.sides(edge) else { return false };
    let corners = both.corners;
    let Some(start) = corners.iter().position(|&v| v == next.0) else { return false };
    if corners.len() != 5 || corners[(start + 1) % 5] != next.1 {
        return false;
    }
    let [p, q, r, s, t] = [0, 1, 2, 3, 4].map(|k| corners[(start + k) % 5]);
    let mut ways = [([p, q, r], [p, r, s, t]), ([p, q, t], [q, r, s, t])];
    if skew(&ways[1].1, at) < skew(&ways[0].1, at) {
        ways.swap(0, 1);
    }
    ways.into_iter().any(|(triangle, quad)| {
        faces.replace(&both.faces, &[Face::triangle(triangle), Face::quad(quad)]).is_some()
    })
}

/// Edges across which the shortest path leads from one triangle to another.
fn shortest_path(faces: &Faces, blocked: &HashSet<Edge>) -> Option<Vec<Edge>> {
    let mut reached = Reached::new();
    let mut queue: VecDeque<u32> = VecDeque::new();
    for (number, _) in faces.all().filter(|(_, face)| face.is_triangle()) {
        reached.insert(number, (number, None));
        queue.push_back(number);
    }
    let back = |reached: &Reached, mut f: u32| {
        let mut edges = Vec::new();
        while let Some((before, edge)) = reached[&f].1 {
            edges.push(edge);
            f = before;
        }
        edges
    };
    while let Some(f) = queue.pop_front() {
        let (source, _) = reached[&f];
        for edge @ (a, b) in faces.face(f)?.edges() {
            if blocked.contains(&edge) || blocked.contains(&(b, a)) {
                continue;
            }
            let (g, _) = faces.left_of(b, a)?;
            match reached.get(&g) {
                Some((other, _)) if *other != source => {
                    let mut path = back(&reached, f);
                    path.reverse();
                    path.push(edge);
                    path.extend(back(&reached, g).into_iter().map(|(a, b)| (b, a)));
                    return Some(path);
                }
                Some(_) => {}
                None => {
                    reached.insert(g, (source, Some((f, edge))));
                    queue.push_back(g);
                }
            }
        }
    }
    None
}

/// Evens out the numbers of quads at vertices, until no change makes them better.
pub(super) fn even_out(faces: &mut Faces, at: &mut [DVec3]) {
    loop {
        let mut changes = 0;
        for v in 0..at.len() as u32 {
            changes += usize::from(faces.valence(v) == 2 && remove_vertex(faces, v));
        }
        let quads: Vec<u32> = faces.all().map(|(number, _)| number).collect();
        changes += quads.into_iter().filter(|&quad| collapse(faces, at, quad)).count();
        changes += faces.edges().into_iter().filter(|&edge| turn(faces, at, edge)).count();
        if changes == 0 {
            return;
        }
    }
}

fn defect(valence: usize) -> i64 {
    if valence <= 2 { TWO_QUADS } else { (valence as i64 - 4).pow(2) }
}

/// Makes one quad of the two around a vertex.
fn remove_vertex(faces: &mut Faces, v: u32) -> bool {
    let [a, b] = *faces.neighbours(v) else { return false };
    let (Some((f, first)), Some((g, second))) = (faces.left_of(v, a), faces.left_of(v, b)) else {
        return false;
    };
    let beyond = |face: Face| face.corners().iter().copied().find(|w| ![v, a, b].contains(w));
    let (Some(c), Some(d)) = (beyond(first), beyond(second)) else { return false };
    faces.replace(&[f, g], &[Face::quad([a, c, b, d])]).is_some()
}

/// Merges opposite corners of a quad, if that makes valences better.
fn collapse(faces: &mut Faces, at: &mut [DVec3], quad: u32) -> bool {
    let Some(face) = faces.face(quad) else { return false };
    let [a, b, c, d] = *face.corners() else { return false };
    [[a, b, c, d], [b, c, d, a]].into_iter().any(|[kept, left, gone, right]| {
        let [n, l, m, r] = [kept, left, gone, right].map(|v| faces.valence(v));
        let now = defect(n) + defect(l) + defect(m) + defect(r);
        let then = defect(n + m - 2) + defect(l - 1) + defect(r - 1);
        if then >= now || faces.are_joined(kept, gone) || faces.common_neighbours(kept, gone).len() != 2 {
            return false;
        }
        let is_merged = faces.merge_into(kept, gone);
        if is_merged {
            at[kept as usize] = 0.5 * (at[kept as usize] + at[gone as usize]);
        }
        is_merged
    })
}

/// Turns the edge between two quads within their hexagon, if that makes valences better.
fn turn(faces: &mut Faces, at: &[DVec3], edge: Edge) -> bool {
    let Some(both) = faces.sides(edge) else { return false };
    let hexagon = both.corners;
    if both.faces[0] == both.faces[1] || hexagon.len() != 6 {
        return false;
    }
    let valence: Vec<usize> = hexagon.iter().map(|&v| faces.valence(v)).collect();
    // The edge joins corners 0 and 3.
    let gain = |start: usize| {
        let [x, y] = [valence[start], valence[start + 3]];
        let now = defect(valence[0]) + defect(valence[3]) + defect(x) + defect(y);
        now - defect(valence[0] - 1) - defect(valence[3] - 1) - defect(x + 1) - defect(y + 1)
    };
    let quads = |start: usize| [0, 3].map(|k| [0, 1, 2, 3].map(|j| hexagon[(start + k + j) % 6]));
    let is_square = |&start: &usize| quads(start).iter().all(|quad| skew(quad, at) < MAX_SKEW_TURNED);
    let best = [1, 2].into_iter().filter(is_square).max_by_key(|&start| gain(start));
    let Some(start) = best.filter(|&start| gain(start) > 0) else { return false };
    faces.replace(&both.faces, &quads(start).map(Face::quad)).is_some()
}
