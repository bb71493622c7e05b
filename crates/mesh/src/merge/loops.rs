//! Small holes closed with the triangles of least area.
//!
//! Comes in: a surface with borders. Goes out: triangles over loops that are short enough and may be closed, without new vertices. Cost O(n³) for a loop of n edges (G. Barequet, M. Sharir, *Filling gaps in the boundary of a
//! polyhedron*, 1995). Not guaranteed: that the new triangles cross nothing.

use super::manifold::{NONE, next_in_triangle, opposites};
use planish_estimate::vector3::{cross, dot, norm, sub};
use std::collections::HashSet;

/// A triangle that faces the other way than its corners counts so many times its area.
const FOLDED: f64 = 4.0;

/// Loops of a border, none by a vertex twice: the vertices in the direction of the triangles along them.
pub(super) fn border_loops(triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
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

/// A loop that comes by a vertex twice is two loops.
fn simple_loops(vertices: Vec<u32>, loops: &mut Vec<Vec<u32>>) {
    let mut way: Vec<u32> = Vec::with_capacity(vertices.len());
    let mut on_way: HashSet<u32> = HashSet::new();
    for v in vertices {
        if on_way.contains(&v) {
            let at = way.iter().position(|w| *w == v).unwrap_or(0);
            let part = way.split_off(at);
            for w in &part[1..] {
                on_way.remove(w);
            }
            way.push(v);
            loops.push(part);
        } else {
            on_way.insert(v);
            way.push(v);
        }
    }
    loops.push(way);
}

/// Closes loops of at most `longest` edges for which `may_close` holds. Gives how many.
pub(super) fn close_loops(
    positions: &[[f64; 3]],
    normals: &[[f64; 3]],
    triangles: &mut Vec<[u32; 3]>,
    longest: usize,
    may_close: impl Fn(&[u32]) -> bool,
) -> usize {
    let loops: Vec<Vec<u32>> = border_loops(triangles)
        .into_iter()
        .filter(|l| l.len() <= longest && may_close(l))
        .collect();
    let mut on_loop = vec![false; positions.len()];
    for v in loops.iter().flatten() {
        on_loop[*v as usize] = true;
    }
    let mut edges: HashSet<[u32; 2]> = HashSet::new();
    for t in triangles.iter() {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            if on_loop[a as usize] && on_loop[b as usize] {
                edges.insert([a.min(b), a.max(b)]);
            }
        }
    }
    // The border of a lone triangle is no hole.
    let alone: HashSet<[u32; 3]> = triangles
        .iter()
        .filter(|t| t.iter().all(|v| on_loop[*v as usize]))
        .map(|t| sorted(*t))
        .collect();
    let mut closed = 0;
    for vertices in loops {
        let lone = vertices.len() == 3 && alone.contains(&sorted([vertices[0], vertices[1], vertices[2]]));
        if lone {
            continue;
        }
        if let Some(cover) = least_cover(positions, normals, &vertices, &edges) {
            for t in &cover {
                for k in 0..3 {
                    edges.insert([t[k].min(t[(k + 1) % 3]), t[k].max(t[(k + 1) % 3])]);
                }
            }
            triangles.extend(cover);
            closed += 1;
        }
    }
    closed
}

fn sorted(mut t: [u32; 3]) -> [u32; 3] {
    t.sort_unstable();
    t
}

/// The triangulation of a loop of least area whose inner edges are not in use, turned against the loop.
fn least_cover(
    positions: &[[f64; 3]],
    normals: &[[f64; 3]],
    vertices: &[u32],
    edges: &HashSet<[u32; 2]>,
) -> Option<Vec<[u32; 3]>> {
    let n = vertices.len();
    if n < 3 {
        return None;
    }
    let at = |k: usize| positions[vertices[k] as usize];
    let cost = |i: usize, j: usize, k: usize| {
        // Seen against the loop: k, j, i.
        let up = cross(sub(at(j), at(k)), sub(at(i), at(k)));
        let facing: f64 = [i, j, k].iter().map(|v| dot(normals[vertices[*v] as usize], up)).sum();
        norm(up) * if facing > 0.0 { 1.0 } else { FOLDED }
    };
    let free = |i: usize, j: usize| {
        let (a, b) = (vertices[i], vertices[j]);
        !edges.contains(&[a.min(b), a.max(b)])
    };
    let mut best = vec![0.0; n * n];
    let mut split = vec![usize::MAX; n * n];
    for gap in 2..n {
        for i in 0..n - gap {
            let k = i + gap;
            best[i * n + k] = f64::INFINITY;
            if gap + 1 < n && !free(i, k) {
                continue;
            }
            for j in i + 1..k {
                let sum = best[i * n + j] + best[j * n + k] + cost(i, j, k);
                if sum < best[i * n + k] {
                    best[i * n + k] = sum;
                    split[i * n + k] = j;
                }
            }
        }
    }
    if !best[n - 1].is_finite() {
        return None;
    }
    let mut cover = Vec::with_capacity(n - 2);
    let mut spans = vec![(0, n - 1)];
    while let Some((i, k)) = spans.pop() {
        if k < i + 2 {
            continue;
        }
        let j = split[i * n + k];
        cover.push([vertices[k], vertices[j], vertices[i]]);
        spans.push((i, j));
        spans.push((j, k));
    }
    Some(cover)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriangleMesh;
    use crate::primitives::icosphere;

    #[test]
    fn a_hole_in_a_ball_is_closed_the_right_way_round() {
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
