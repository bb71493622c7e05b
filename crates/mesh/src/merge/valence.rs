//! Flips edges so that most vertices have six neighbours.
//!
//! In: a surface and the vertices of its seams. Out: the same vertices with the same number of triangles.
//! The sum `Σ (valence − 6)²` (4 on the border) decreases with each flip or sequence of flips, without
//! folding the surface. Not guaranteed: six neighbours everywhere, which the topology does not permit.

use crate::half_edges::{NONE, around, flip, next_in_triangle, opposites, previous_in_triangle};
use crate::triangle::smallest_angle;
use planish_core::DVec3;
use std::collections::{HashMap, HashSet};

/// Limits on the change of the surface by flips.
#[derive(Debug, Clone, Copy)]
struct Limits {
    /// Minimum cosine between the two triangles at an edge, before and after the flip.
    flat: f64,
    /// Angles above this are always acceptable, in radians.
    well_shaped_rad: f64,
    /// Smallest permitted ratio of the smallest angle after the flip to that before.
    worse: f64,
    /// Maximum length of a sequence of flips.
    sequence: usize,
}

/// Rounds of increasing permission: first flips that are hardly visible, then larger changes of shape, then
/// longer sequences, and finally flips on rough surfaces.
///
/// Strict limits first: most vertices are solved there, so that few triangles get worse shapes.
const LIMITS: [Limits; 4] = [
    Limits { flat: 0.7, well_shaped_rad: 0.35, worse: 0.4, sequence: 3 },
    Limits { flat: 0.5, well_shaped_rad: 0.17, worse: 0.3, sequence: 4 },
    Limits { flat: 0.5, well_shaped_rad: 0.17, worse: 0.3, sequence: 9 },
    Limits { flat: 0.2, well_shaped_rad: 0.1, worse: 0.2, sequence: 9 },
];
/// Distance in edges within which a change makes another attempt at a vertex worthwhile.
const RETRY_RADIUS: usize = 3;
/// Maximum number of flips tried for one vertex of a seam; bounds the cost of the search.
const MAX_TRIED: usize = 4_000;
/// The same for sequences at all vertices, before those at seams. Patches have many vertices with more than
/// six edges, at borders and gaps of scans. With the effort of the seams, merging took three times as long.
const MAX_TRIED_ELSEWHERE: usize = 100;
/// Additional weight of edges beyond six at the vertices that should have six at most.
const EXCESS_WEIGHT: i64 = 20;

/// The number of edges at every vertex.
fn valences(triangles: &[[u32; 3]], opposite: &[u32], vertices: usize) -> Vec<u32> {
    let mut valence = vec![0; vertices];
    for (half, over) in opposite.iter().enumerate() {
        let (a, b) = (triangles[half / 3][half % 3], triangles[half / 3][(half % 3 + 1) % 3]);
        valence[a as usize] += 1;
        // Each edge is counted at the start of a half-edge; a border edge has only one and is counted at
        // its end here.
        if *over == NONE {
            valence[b as usize] += 1;
        }
    }
    valence
}

/// Flips edges so that vertices get at most six edges. Vertices of the `seam` are tried longer than others.
/// Returns the number of flips and the valence of every vertex.
pub(super) fn even_out(positions: &[DVec3], triangles: &mut [[u32; 3]], seam: &[bool]) -> (usize, Vec<u32>) {
    let mut net = FlipMesh::new(positions, triangles);
    // Single flips that improve the sum, until none is left. After a flip, the edges of both triangles are
    // worth another test.
    let has_too_many = |half: &u32| {
        let [a, b] = [net.corner(*half), net.end(*half)];
        net.valence[a as usize] > 6 || net.valence[b as usize] > 6
    };
    let mut queue: Vec<u32> = (0..net.opposite.len() as u32).rev().filter(has_too_many).collect();
    while let Some(half) = queue.pop() {
        let better = |(change, around)| change < 0 && net.may_flip(around);
        if net.change(half).is_some_and(better) {
            let [t, s] = net.flip(half);
            queue.extend([3 * t, 3 * t + 1, 3 * t + 2, 3 * s, 3 * s + 1, 3 * s + 2]);
        }
    }
    // Where no single flip improves the sum, a sequence can: everywhere, and then longer ones at seams, which
    // may leave their excess at vertices of the patches.
    // The last limits are for seams alone: they permit thin triangles.
    for limits in &LIMITS[..3] {
        net.improve(*limits, MAX_TRIED_ELSEWHERE);
    }
    net.wanted = seam.to_vec();
    for limits in LIMITS {
        net.improve(limits, MAX_TRIED);
    }
    (net.flips, net.valence)
}

/// Triangles with their adjacency and valences.
struct FlipMesh<'a> {
    positions: &'a [DVec3],
    triangles: &'a mut [[u32; 3]],
    /// For each vertex, true if it should have at most six edges.
    wanted: Vec<bool>,
    opposite: Vec<u32>,
    /// For each vertex, one half-edge that starts there.
    leaves: Vec<u32>,
    valence: Vec<u32>,
    border: Vec<bool>,
    limits: Limits,
    flips: usize,
    /// Number of flips tried for the current vertex, and its maximum.
    tried: usize,
    max_tried: usize,
    /// The vertices of the flips in the current sequence.
    trail: Vec<[u32; 4]>,
    /// For vertices near the current one, the distance in edges to a vertex that can take another edge.
    room: HashMap<u32, usize>,
}

impl<'a> FlipMesh<'a> {
    fn new(positions: &'a [DVec3], triangles: &'a mut [[u32; 3]]) -> Self {
        let opposite = opposites(triangles);
        let mut border = vec![false; positions.len()];
        let mut leaves = vec![NONE; positions.len()];
        for (half, over) in opposite.iter().enumerate() {
            let (a, b) = (triangles[half / 3][half % 3], triangles[half / 3][(half % 3 + 1) % 3]);
            leaves[a as usize] = half as u32;
            if *over == NONE {
                border[a as usize] = true;
                border[b as usize] = true;
            }
        }
        Self {
            valence: valences(triangles, &opposite, positions.len()),
            wanted: vec![true; positions.len()],
            positions,
            triangles,
            opposite,
            leaves,
            border,
            limits: LIMITS[0],
            flips: 0,
            tried: 0,
            max_tried: MAX_TRIED,
            trail: Vec::new(),
            room: HashMap::new(),
        }
    }

    fn corner(&self, half: u32) -> u32 {
        self.triangles[half as usize / 3][half as usize % 3]
    }

    /// The end of a half-edge.
    fn end(&self, half: u32) -> u32 {
        self.corner(next_in_triangle(half))
    }

    /// Change of the sum by a flip, and the vertices of the two triangles ([`around`]); `None` if the
    /// topology does not permit the flip. Geometry is checked separately by [`Self::may_flip`], which is
    /// slower.
    fn change(&self, half: u32) -> Option<(i64, [u32; 4])> {
        let over = self.opposite[half as usize];
        if over == NONE {
            return None;
        }
        let around = around(self.triangles, half, over);
        let [a, b, c, d] = around;
        // `c == d` is a pair of triangles over the same three vertices. A vertex with three edges would
        // keep two, which is no surface.
        if c == d || self.valence[a as usize] <= 3 || self.valence[b as usize] <= 3 {
            return None;
        }
        // Squares, so that one vertex with eight edges is worse than two with seven.
        let off = |v: u32, change: i64| {
            let v = v as usize;
            let count = i64::from(self.valence[v]) + change;
            let off = count - if self.border[v] { 4 } else { 6 };
            let over = (count - 6).max(0);
            off * off + if self.wanted[v] { EXCESS_WEIGHT * over * over } else { 0 }
        };
        let before = off(a, 0) + off(b, 0) + off(c, 0) + off(d, 0);
        let after = off(a, -1) + off(b, -1) + off(c, 1) + off(d, 1);
        Some((after - before, around))
    }

    /// Returns true if a flip neither duplicates an edge nor folds the surface.
    fn may_flip(&self, around: [u32; 4]) -> bool {
        let [_, _, c, d] = around;
        !self.joined(c, d) && self.stays_flat(around)
    }

    /// Returns true if two vertices have a common edge.
    fn joined(&self, a: u32, b: u32) -> bool {
        // A border vertex has one neighbour that no half-edge from it ends at.
        let ends_at = |from: u32, to: u32| self.leaving(from).into_iter().any(|half| self.end(half) == to);
        ends_at(a, b) || ends_at(b, a)
    }

    /// Returns true if the triangles (a, b, c) and (b, a, d) may become (c, d, b) and (d, c, a).
    fn stays_flat(&self, [a, b, c, d]: [u32; 4]) -> bool {
        let at = |v: u32| self.positions[v as usize];
        let normal = |t: [u32; 3]| (at(t[1]) - at(t[0])).cross(at(t[2]) - at(t[0]));
        let flat = |m: DVec3, n: DVec3| m.dot(n) > self.limits.flat * m.length() * n.length();
        let (old, new) = ([[a, b, c], [b, a, d]], [[c, d, b], [d, c, a]]);
        let ([o0, o1], [n0, n1]) = (old.map(normal), new.map(normal));
        if !(flat(o0, o1) && flat(n0, n1) && flat(o0, n0) && flat(o0, n1)) {
            return false;
        }
        let worst = |all: [[u32; 3]; 2]| {
            let angles = all.map(|t| smallest_angle(&t.map(at)));
            angles[0].min(angles[1])
        };
        let new = worst(new);
        if new >= self.limits.well_shaped_rad {
            return true;
        }
        new >= self.limits.worse * worst(old)
    }

    /// Flips an edge without checks and returns its triangles; the edge becomes the first of both.
    fn flip(&mut self, half: u32) -> [u32; 2] {
        let [a, b, c, d] = around(self.triangles, half, self.opposite[half as usize]);
        let [t, s] = flip(self.triangles, &mut self.opposite, half);
        for (v, leaving) in [(c, 3 * t), (d, 3 * s), (b, 3 * t + 2), (a, 3 * s + 2)] {
            self.leaves[v as usize] = leaving;
        }
        self.valence[a as usize] -= 1;
        self.valence[b as usize] -= 1;
        self.valence[c as usize] += 1;
        self.valence[d as usize] += 1;
        self.flips += 1;
        [t, s]
    }

    /// All half-edges that start at a vertex.
    fn leaving(&self, vertex: u32) -> Vec<u32> {
        let first = self.leaves[vertex as usize];
        let mut all = vec![first];
        let mut at = first;
        loop {
            let over = self.opposite[previous_in_triangle(at) as usize];
            if over == first {
                return all;
            }
            if over == NONE {
                break;
            }
            all.push(over);
            at = over;
        }
        // At a border, continue in the other direction.
        let mut at = first;
        while self.opposite[at as usize] != NONE {
            at = next_in_triangle(self.opposite[at as usize]);
            all.push(at);
        }
        all
    }

    /// The vertices up to `steps` edges away, nearest first, starting with the vertex itself.
    fn near(&self, vertex: u32, steps: usize) -> Vec<u32> {
        let mut near = vec![vertex];
        let mut known = HashSet::from([vertex]);
        let mut ring = 0..1;
        for _ in 0..steps {
            for k in ring.clone() {
                let ends = self.leaving(near[k]).into_iter().map(|half| self.end(half));
                near.extend(ends.filter(|end| known.insert(*end)));
            }
            ring = ring.end..near.len();
        }
        near
    }

    /// Returns true if a vertex must not get another edge.
    fn is_full(&self, vertex: u32) -> bool {
        self.valence[vertex as usize] >= 6 && self.wanted[vertex as usize]
    }

    /// Sets [`Self::room`] around a vertex, as far as this number of flips can reach.
    fn find_room(&mut self, vertex: u32, flips: usize) {
        let mut ring = self.near(vertex, flips);
        let within: HashSet<u32> = ring.iter().copied().collect();
        ring.retain(|v| !self.is_full(*v));
        self.room = ring.iter().map(|v| (*v, 0)).collect();
        for far in 1..=flips {
            let mut next = Vec::new();
            let ends: Vec<u32> =
                (ring.iter()).flat_map(|v| self.leaving(*v)).map(|half| self.end(half)).collect();
            for end in ends {
                if within.contains(&end) && !self.room.contains_key(&end) {
                    self.room.insert(end, far);
                    next.push(end);
                }
            }
            ring = next;
        }
    }

    /// Returns true if a vertex has more edges than it should have.
    fn has_too_many(&self, vertex: u32) -> bool {
        self.valence[vertex as usize] > 6 && self.wanted[vertex as usize]
    }

    /// Ends of the edges of a vertex that are worth flipping, the most promising first.
    ///
    /// `others` also have too many edges. Flips that leave few such vertices, close to vertices with room,
    /// come first.
    fn flip_candidates(&self, vertex: u32, others: &[u32], flips: usize, change: i64) -> Vec<u32> {
        let mut ends: Vec<(usize, usize, u32)> = (self.leaving(vertex).into_iter())
            .filter_map(|half| {
                let (more, [.., c, d]) = self.change(half)?;
                let end = self.end(half);
                if change + more < 0 {
                    return Some((0, 0, end));
                }
                let far = |v: u32| self.room.get(&v).copied().unwrap_or(usize::MAX);
                let carried = [c, d].into_iter().filter(|v| self.is_full(*v));
                let rest = others.iter().filter(|v| **v != end || self.valence[end as usize] > 7);
                // Each vertex that is left with too many edges needs a flip of its own, but one flip can
                // serve two of them; and an excess has to be carried over `far` edges. Both are lower bounds
                // of the flips needed, by which hopeless sequences are cut off.
                let left = carried.clone().count() + rest.count();
                let far = carried.map(far).max().unwrap_or(0);
                (left > 0 && left.div_ceil(2).max(far) < flips).then_some((left, far, end))
            })
            .collect();
        ends.sort_unstable();
        ends.into_iter().map(|(.., end)| end).collect()
    }

    /// Tries sequences of flips at all vertices with too many edges, until none helps.
    fn improve(&mut self, limits: Limits, max_tried: usize) {
        (self.limits, self.max_tried) = (limits, max_tried);
        let mut changes = 1;
        let mut changed = vec![1; self.positions.len()];
        let mut tried = vec![0; self.positions.len()];
        loop {
            let before = self.flips;
            for v in 0..self.positions.len() as u32 {
                let at = v as usize;
                // A failed vertex is tried again only after a change nearby.
                if !self.has_too_many(v)
                    || !self.near(v, RETRY_RADIUS).into_iter().any(|w| changed[w as usize] > tried[at])
                {
                    continue;
                }
                (self.tried, tried[at]) = (0, changes);
                self.trail.clear();
                self.find_room(v, limits.sequence);
                if self.reduce_valence(&[v], limits.sequence, 0) {
                    changes += 1;
                    for w in self.trail.iter().flatten() {
                        changed[*w as usize] = changes;
                    }
                }
            }
            if self.flips == before {
                break;
            }
        }
    }

    /// Flips an edge of the last vertex with too many edges, then edges of the vertices that have too many as
    /// a result, until the sum has decreased. Undoes all flips if this number of them does not suffice.
    fn reduce_valence(&mut self, too_many: &[u32], flips: usize, change: i64) -> bool {
        let Some((vertex, others)) = too_many.split_last() else {
            return false;
        };
        for end in self.flip_candidates(*vertex, others, flips, change) {
            // Undone flips renumber half-edges, so the edge is found again by its end.
            let edge = self.leaving(*vertex).into_iter().find(|h| self.end(*h) == end);
            let Some((edge, (more, around))) = edge.and_then(|h| Some((h, self.change(h)?))) else {
                continue;
            };
            if self.tried >= self.max_tried {
                return false;
            }
            if !self.may_flip(around) {
                continue;
            }
            self.tried += 1;
            self.flip(edge);
            self.trail.push(around);
            if change + more < 0 {
                return true;
            }
            let [.., c, d] = around;
            let mut left = too_many.to_vec();
            left.extend([c, d].iter().filter(|v| !too_many.contains(v)));
            left.retain(|v| self.has_too_many(*v));
            if self.reduce_valence(&left, flips - 1, change + more) {
                return true;
            }
            let back = self.leaving(c).into_iter().find(|h| self.end(*h) == d);
            // Undone by a second flip, which counts as well: hence two less.
            if let Some(back) = back {
                self.flip(back);
            }
            self.flips -= 2;
            self.trail.pop();
        }
        false
    }
}

#[cfg(test)]
mod tests;
