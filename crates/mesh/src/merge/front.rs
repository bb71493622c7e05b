//! Stitches pieces of a surface together with triangles between their borders (advancing front).
//!
//! In: pieces with manifold edges and vertices, separated by gaps of a few edges. Out: additional triangles
//! over the same vertices. The candidate at an open edge `a → b` is the border vertex that sees the edge
//! under the largest angle, with no other border edge between. This is the Delaunay choice in the plane of
//! the edge: no other border vertex lies in the circumcircle. The smallest circles come first (F. Bernardini
//! and others, *The ball-pivoting algorithm*, 1999; here the ball has the size that each triangle needs).
//!
//! The border is stored as open edges with their successors, so that a vertex can occur on it twice, once on
//! each side of a triangle that touches it. Adding a triangle to a manifold with border therefore always
//! gives a manifold with border, wherever the vertices are.
//!
//! Not guaranteed: that every gap is closed, or that triangles of pieces that fold over each other do not
//! intersect.

use crate::half_edges::{NONE, next_in_triangle, opposites};
use planish_core::DVec3;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};

/// Minimum cosine between the normal of a new triangle and the vertex normals at its corners.
///
/// A larger value leaves gaps at sharp edges; a smaller one allows triangles that fold back.
const MIN_NORMAL_COSINE: f64 = 0.35;

/// Vertices to be stitched, and which of them may be joined.
pub(super) struct SeamInput<'a> {
    pub positions: &'a [DVec3],
    /// Unit normals.
    pub normals: &'a [DVec3],
    /// Maximum distance from each vertex to those that it is joined with.
    pub reach: &'a [f64],
    /// Returns true if three border vertices may form a triangle.
    pub may_join: &'a (dyn Fn([u32; 3]) -> bool + 'a),
}

/// The open edges of a surface, linked along their loops.
struct Border {
    from: Vec<u32>,
    to: Vec<u32>,
    next: Vec<u32>,
    previous: Vec<u32>,
    open: Vec<bool>,
    /// Open edges that start at each vertex. A vector, because looking these up in a hash map took a third of
    /// the time of stitching.
    outgoing: Vec<Vec<u32>>,
    /// Edges with both ends on the border, the smaller index first.
    edges: HashSet<[u32; 2]>,
}

/// A triangle that can be added to an edge: its third corner is the start of `outgoing`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Candidate {
    outgoing: u32,
    radius: f64,
}

/// Closes gaps; new triangles are appended.
pub(super) fn stitch(seam: &SeamInput<'_>, triangles: &mut Vec<[u32; 3]>) {
    let mut border = Border::new(triangles, seam.positions.len());
    let grid = Grid::new(seam, border.from.iter().copied());
    let mut queue = BinaryHeap::new();
    for edge in 0..border.from.len() as u32 {
        if let Some(best) = candidate(seam, &border, &grid, edge) {
            queue.push(Reverse((best.radius.to_bits(), edge)));
        }
    }
    // Entries of the queue become stale when the border changes, so the candidate is computed again.
    while let Some(Reverse((bits, edge))) = queue.pop() {
        if !border.open[edge as usize] {
            continue;
        }
        let Some(best) = candidate(seam, &border, &grid, edge) else {
            continue;
        };
        // The candidate is gone. The edge waits with its next best, so that the smallest circles stay first.
        if best.radius.to_bits() > bits {
            queue.push(Reverse((best.radius.to_bits(), edge)));
            continue;
        }
        let (a, b, c) =
            (border.from[edge as usize], border.to[edge as usize], border.from[best.outgoing as usize]);
        triangles.push([b, a, c]);
        for changed in border.add_triangle(edge, best.outgoing).into_iter().flatten() {
            for around in [border.previous[changed as usize], changed, border.next[changed as usize]] {
                if let Some(best) = candidate(seam, &border, &grid, around) {
                    queue.push(Reverse((best.radius.to_bits(), around)));
                }
            }
        }
    }
}

impl Border {
    fn new(triangles: &[[u32; 3]], vertices: usize) -> Self {
        let opposite = opposites(triangles);
        let mut number = HashMap::new();
        let mut border = Self {
            from: Vec::new(),
            to: Vec::new(),
            next: Vec::new(),
            previous: Vec::new(),
            open: Vec::new(),
            outgoing: vec![Vec::new(); vertices],
            edges: HashSet::new(),
        };
        let corner = |half: u32| triangles[half as usize / 3][half as usize % 3];
        for half in (0..opposite.len() as u32).filter(|&h| opposite[h as usize] == NONE) {
            let edge = border.from.len() as u32;
            number.insert(half, edge);
            border.from.push(corner(half));
            border.to.push(corner(next_in_triangle(half)));
            border.outgoing[corner(half) as usize].push(edge);
        }
        border.next = vec![NONE; border.from.len()];
        border.previous = vec![NONE; border.from.len()];
        border.open = vec![true; border.from.len()];
        // The successor of an open edge is found by turning about its end through the triangles there, so
        // that each fan of a vertex keeps its own part of the border.
        for (&half, &edge) in &number {
            let mut at = next_in_triangle(half);
            while opposite[at as usize] != NONE {
                at = next_in_triangle(opposite[at as usize]);
            }
            let next = number[&at];
            border.next[edge as usize] = next;
            border.previous[next as usize] = edge;
        }
        let last = triangles.iter().flatten().max().map_or(0, |v| *v as usize + 1);
        let mut on_border = vec![false; last];
        for v in &border.from {
            on_border[*v as usize] = true;
        }
        for half in 0..opposite.len() as u32 {
            let (a, b) = (corner(half), corner(next_in_triangle(half)));
            if on_border[a as usize] && on_border[b as usize] {
                border.edges.insert([a.min(b), a.max(b)]);
            }
        }
        border
    }

    /// Adds the triangle of `edge` and the start of `outgoing`. Returns the new open edges.
    fn add_triangle(&mut self, edge: u32, outgoing: u32) -> [Option<u32>; 2] {
        let (e, g) = (edge as usize, outgoing as usize);
        let (before, after, incoming) = (self.previous[e], self.next[e], self.previous[g]);
        let (a, b, c) = (self.from[e], self.to[e], self.from[g]);
        self.close(edge);
        // Each of the two other sides closes an edge of the border or becomes a new one. Corners are compared
        // as edges of the border, not as vertices: a vertex can be on the border twice, and only the matching
        // occurrence may be closed.
        let first = if before == outgoing {
            self.close(outgoing);
            None
        } else {
            Some(self.open_edge(a, c))
        };
        let second = if after == incoming {
            self.close(incoming);
            None
        } else {
            Some(self.open_edge(c, b))
        };
        match (first, second) {
            (Some(x), Some(y)) => {
                self.link(before, x);
                self.link(x, outgoing);
                self.link(incoming, y);
                self.link(y, after);
            }
            (Some(x), None) => {
                self.link(before, x);
                self.link(x, outgoing);
            }
            (None, Some(y)) => {
                self.link(incoming, y);
                self.link(y, after);
            }
            (None, None) => {}
        }
        [first, second]
    }

    fn link(&mut self, first: u32, then: u32) {
        self.next[first as usize] = then;
        self.previous[then as usize] = first;
    }

    fn open_edge(&mut self, from: u32, to: u32) -> u32 {
        let edge = self.from.len() as u32;
        self.from.push(from);
        self.to.push(to);
        self.next.push(NONE);
        self.previous.push(NONE);
        self.open.push(true);
        self.outgoing[from as usize].push(edge);
        self.edges.insert([from.min(to), from.max(to)]);
        edge
    }

    fn close(&mut self, edge: u32) {
        self.open[edge as usize] = false;
        self.outgoing[self.from[edge as usize] as usize].retain(|e| *e != edge);
    }

    fn joined(&self, a: u32, b: u32) -> bool {
        self.edges.contains(&[a.min(b), a.max(b)])
    }
}

/// The best triangle at an open edge: the one with the smallest circumcircle.
fn candidate(seam: &SeamInput<'_>, border: &Border, grid: &Grid, edge: u32) -> Option<Candidate> {
    let e = edge as usize;
    let (a, b) = (border.from[e], border.to[e]);
    let at = |v: u32| seam.positions[v as usize];
    let normal_at = |v: u32| seam.normals[v as usize];
    let up = (normal_at(a) + normal_at(b)).try_normalize()?;
    let along = (at(b) - at(a)).try_normalize()?;
    let outwards = along.cross(up).try_normalize()?;
    let middle = 0.5 * (at(a) + at(b));
    let length = at(a).distance(at(b));
    // Coordinates in the plane of the edge: along it and outwards.
    let flat = |p: DVec3| {
        let d = p - middle;
        [d.dot(along), d.dot(outwards)]
    };
    let (flat_a, flat_b) = ([-0.5 * length, 0.0], [0.5 * length, 0.0]);
    let before = border.from[border.previous[e] as usize];
    let after = border.to[border.next[e] as usize];

    // Border vertices in reach, on the same side of the surface.
    let mut near: Vec<(u32, [f64; 2])> = Vec::new();
    grid.visit(middle, grid.reach + 0.5 * length, |v| {
        if !border.outgoing[v as usize].is_empty() && normal_at(v).dot(up) > 0.0 {
            near.push((v, flat(at(v))));
        }
    });
    // Possible third corners, by the angle under which they see the edge.
    let mut seen: Vec<(f64, u32)> = Vec::new();
    for &(c, place) in &near {
        // A corner level with the edge gives a triangle without area.
        if c == a || c == b || place[1] < 1e-3 * length {
            continue;
        }
        let (to_a, to_b) = (at(a).distance(at(c)), at(b).distance(at(c)));
        // The coarsest of the three decides: beside a fine patch, a coarse one still reaches across.
        let reach = seam.reach[c as usize].max(seam.reach[a as usize]).max(seam.reach[b as usize]);
        if to_a > reach || to_b > reach {
            continue;
        }
        let Some(normal) = (at(a) - at(b)).cross(at(c) - at(b)).try_normalize() else {
            continue;
        };
        if [a, b, c].iter().any(|v| normal_at(*v).dot(normal) < MIN_NORMAL_COSINE) {
            continue;
        }
        if !(seam.may_join)([a, b, c]) {
            continue;
        }
        let cosine = (at(a) - at(c)).dot(at(b) - at(c)) / (to_a * to_b);
        seen.push((cosine, c));
    }
    // The largest angle (smallest cosine) whose triangle fits between the borders wins.
    seen.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
    if seen.is_empty() {
        return None;
    }
    // Border edges nearby, in the plane of the edge, that a new edge must not cross.
    let others: Vec<(u32, u32, [f64; 2], [f64; 2])> = (near.iter())
        .flat_map(|&(v, place)| border.outgoing[v as usize].iter().map(move |other| (v, place, *other)))
        .filter(|(.., other)| *other != edge)
        .map(|(v, place, other)| (v, border.to[other as usize], place))
        .filter(|(_, w, _)| normal_at(*w).dot(up) > 0.0)
        .map(|(v, w, place)| (v, w, place, flat(at(w))))
        .collect();
    for (cosine, c) in seen {
        let place = flat(at(c));
        for &outgoing in &border.outgoing[c as usize] {
            let incoming = border.previous[outgoing as usize];
            let (is_next, is_previous) = (border.next[e] == incoming, border.previous[e] == outgoing);
            if !is_next && border.joined(b, c) || !is_previous && border.joined(a, c) {
                continue;
            }
            // The triangle must lie in the open sector of each of its corners.
            let (p, n) = (border.from[incoming as usize], border.to[outgoing as usize]);
            let sectors = within(seam, c, [p, b, a, n])
                && within(seam, a, [before, c, b, b])
                && within(seam, b, [a, a, c, after]);
            if !sectors {
                continue;
            }
            // The two new edges must not cross other border edges. Only edges with an end in reach can do so.
            let crosses = others.iter().any(|&(v, w, s, t)| {
                // The new edges are on the outer side, up to the height of the corner.
                if s[1].min(t[1]) > place[1] || s[1].max(t[1]) < 0.0 {
                    return false;
                }
                let apart = |x: u32, y: u32| v != x && v != y && w != x && w != y;
                apart(a, c) && cross_in_plane(flat_a, place, s, t)
                    || apart(b, c) && cross_in_plane(flat_b, place, s, t)
            });
            if crosses {
                continue;
            }
            let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
            return Some(Candidate { outgoing, radius: length / (2.0 * sine).max(1e-12) });
        }
    }
    None
}

/// Returns true if the directions from a vertex to four others are in counter-clockwise order about its
/// normal. The first two may coincide, and the last two.
fn within(seam: &SeamInput<'_>, vertex: u32, order: [u32; 4]) -> bool {
    let (at, normal) = (seam.positions[vertex as usize], seam.normals[vertex as usize]);
    let direction = |v: u32| seam.positions[v as usize] - at;
    let first = direction(order[0]);
    let x = first - first.dot(normal) * normal;
    let Some(x) = x.try_normalize() else { return false };
    let y = normal.cross(x);
    let turn = |v: u32| {
        let d = direction(v);
        let angle = d.dot(y).atan2(d.dot(x));
        if angle < 0.0 { angle + std::f64::consts::TAU } else { angle }
    };
    let second = if order[1] == order[0] { 0.0 } else { turn(order[1]) };
    let third = turn(order[2]);
    // A border that turns back on itself leaves the full circle open.
    let last = if order[3] == order[0] { std::f64::consts::TAU } else { turn(order[3]) };
    second < third && third <= last
}

/// Returns true if two segments in a plane intersect in their interiors.
fn cross_in_plane(a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]) -> bool {
    let side =
        |p: [f64; 2], q: [f64; 2], r: [f64; 2]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
}

/// Border vertices in a grid of cubes with the size of the longest reach.
///
/// Stitching adds no vertices, so the grid is built once. Vertices that leave the border stay in it.
struct Grid {
    cubes: HashMap<[i64; 3], Vec<(u32, DVec3)>>,
    size: f64,
    /// Maximum reach of a vertex.
    reach: f64,
}

impl Grid {
    fn new(seam: &SeamInput<'_>, vertices: impl Iterator<Item = u32>) -> Self {
        let mut all: Vec<u32> = vertices.collect();
        all.sort_unstable();
        all.dedup();
        let reach = all.iter().map(|v| seam.reach[*v as usize]).fold(0.0, f64::max);
        let mut grid = Self { cubes: HashMap::new(), size: reach.max(f64::MIN_POSITIVE), reach };
        for v in all {
            let place = seam.positions[v as usize];
            let cube = grid.cube(place);
            grid.cubes.entry(cube).or_default().push((v, place));
        }
        grid
    }

    fn cube(&self, p: DVec3) -> [i64; 3] {
        (p / self.size).floor().to_array().map(|x| x as i64)
    }

    fn visit(&self, middle: DVec3, radius: f64, mut found: impl FnMut(u32)) {
        let low = self.cube(middle - radius);
        let high = self.cube(middle + radius);
        for i in low[0]..=high[0] {
            for j in low[1]..=high[1] {
                for k in low[2]..=high[2] {
                    for &(v, place) in self.cubes.get(&[i, j, k]).into_iter().flatten() {
                        if place.distance(middle) <= radius {
                            found(v);
                        }
                    }
                }
            }
        }
    }
}
