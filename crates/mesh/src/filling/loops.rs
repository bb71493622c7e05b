//! Border loops, and closing of short ones without new vertices.
//!
//! In: triangles with manifold edges. Out: the loops of their border, and triangles over those that may be
//! closed ([`minimal_cover`]). Not guaranteed: that the new triangles do not intersect anything.

use super::cover::{Surroundings, minimal_cover};
use crate::edges::edge;
use crate::half_edges::{NONE, next_in_triangle, opposites};
use planish_core::DVec3;
use std::collections::HashSet;

/// The loops of the border, as vertices in the direction of the adjacent triangles. No loop contains a vertex
/// twice.
pub(crate) fn border_loops(triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let opposite = opposites(triangles);
    let corner = |half: u32| triangles[half as usize / 3][half as usize % 3];
    let mut done = vec![false; opposite.len()];
    let mut loops = Vec::new();
    for first in 0..opposite.len() as u32 {
        if opposite[first as usize] != NONE || done[first as usize] {
            continue;
        }
        let mut vertices = Vec::new();
        let mut half = first;
        loop {
            done[half as usize] = true;
            vertices.push(corner(half));
            // Turning about the end through its triangles stays within one fan. A search by vertex could
            // leave a vertex with several fans by the wrong edge.
            half = next_in_triangle(half);
            while opposite[half as usize] != NONE {
                half = next_in_triangle(opposite[half as usize]);
            }
            if half == first {
                break;
            }
        }
        simple_loops(vertices, &mut loops);
    }
    loops
}

/// Splits a loop at vertices that it passes twice: a cover of the whole would have a non-manifold vertex
/// there.
fn simple_loops(vertices: Vec<u32>, loops: &mut Vec<Vec<u32>>) {
    let mut path: Vec<u32> = Vec::with_capacity(vertices.len());
    let mut on_path: HashSet<u32> = HashSet::new();
    for v in vertices {
        if on_path.contains(&v) {
            let at = path.iter().position(|w| *w == v).unwrap_or(0);
            // The part since the first visit is a closed loop of its own. Its other vertices leave the
            // path, so that they may be passed again.
            let part = path.split_off(at);
            for w in &part[1..] {
                on_path.remove(w);
            }
            path.push(v);
            loops.push(part);
        } else {
            on_path.insert(v);
            path.push(v);
        }
    }
    loops.push(path);
}

/// Closes loops of at most `longest` edges for which `may_close` is true; returns their number.
pub(crate) fn close_loops(
    positions: &[DVec3],
    normals: &[DVec3],
    triangles: &mut Vec<[u32; 3]>,
    longest: usize,
    may_close: impl Fn(&[u32]) -> bool,
) -> usize {
    let loops: Vec<Vec<u32>> =
        border_loops(triangles).into_iter().filter(|l| l.len() <= longest && may_close(l)).collect();
    let mut on_loop = vec![false; positions.len()];
    for v in loops.iter().flatten() {
        on_loop[*v as usize] = true;
    }
    let mut edges: HashSet<[u32; 2]> = HashSet::new();
    for t in triangles.iter() {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            if on_loop[a as usize] && on_loop[b as usize] {
                edges.insert(edge(a, b));
            }
        }
    }
    // The border of a single triangle is not a hole.
    let single_triangles: HashSet<[u32; 3]> =
        triangles.iter().filter(|t| t.iter().all(|v| on_loop[*v as usize])).map(|t| sorted(*t)).collect();
    let mut closed = 0;
    for vertices in loops {
        let is_single_triangle = vertices.len() == 3
            && single_triangles.contains(&sorted([vertices[0], vertices[1], vertices[2]]));
        if is_single_triangle {
            continue;
        }
        let around = Surroundings { positions, normals, edges: &edges };
        if let Some(cover) = minimal_cover(&around, &vertices) {
            // Covers of later loops must not repeat the edges of this one.
            for t in &cover {
                for k in 0..3 {
                    edges.insert(edge(t[k], t[(k + 1) % 3]));
                }
            }
            triangles.extend(cover);
            closed += 1;
        }
    }
    closed
}

/// The corners in ascending order.
fn sorted(mut t: [u32; 3]) -> [u32; 3] {
    t.sort_unstable();
    t
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriangleMesh;
    use crate::primitives::icosphere;

    #[test]
    fn the_cover_of_a_hole_in_a_ball_faces_outwards() {
        let ball = icosphere(1.0, 3);
        let normals = ball.vertex_normals();
        let mut open: Vec<[u32; 3]> = (0..ball.triangles.len())
            .filter(|&t| ball.corners(t).iter().all(|p| p[2] < 0.9))
            .map(|t| ball.triangles[t])
            .collect();
        let loops = border_loops(&open);
        assert_eq!(loops.len(), 1);
        let long = close_loops(&ball.positions, &normals, &mut open, loops[0].len() - 1, |_| true);
        assert_eq!(long, 0);
        assert_eq!(close_loops(&ball.positions, &normals, &mut open, 100, |_| true), 1);
        let check = TriangleMesh::try_new(ball.positions.clone(), open).unwrap().check();
        assert!(check.watertight && check.oriented && check.manifold, "{check:?}");
    }
}
