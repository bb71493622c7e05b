//! Edges turned until vertices have six neighbours.
//!
//! Comes in: a surface and the vertices that may change. Goes out: the same vertices with as many triangles, each turn of an edge lessening `Σ (valence − 6)²` (4 on the border) without folding the surface. Not guaranteed: six everywhere, which the
//! topology does not allow.

use super::manifold::{NONE, next_in_triangle, opposites, previous_in_triangle};
use crate::triangle::smallest_angle;
use planish_estimate::vector3::{cross, dot, norm, sub};
use std::collections::HashSet;

/// What turns must leave as it is.
#[derive(Debug, Clone, Copy)]
struct Limits {
    /// The least cosine between the two triangles at an edge, before and after it is turned.
    flat: f64,
    /// Angles larger than this are good enough, in radians.
    well_shaped_rad: f64,
    /// The smallest angle of the triangles may shrink to this share by a turn.
    worse: f64,
    /// Turns in a row that are tried.
    in_a_row: usize,
}

/// First nothing that would show; where vertices keep too many edges, more; and what is left is carried farther away.
const LIMITS: [Limits; 3] = [
    Limits {
        flat: 0.7,
        well_shaped_rad: 0.35,
        worse: 0.4,
        in_a_row: 3,
    },
    Limits {
        flat: 0.5,
        well_shaped_rad: 0.17,
        worse: 0.3,
        in_a_row: 4,
    },
    Limits {
        flat: 0.5,
        well_shaped_rad: 0.17,
        worse: 0.3,
        in_a_row: 7,
    },
];
/// What lies so many edges away is near.
const NEAR: usize = 3;
/// So many turns are tried for one vertex.
const MOST_TRIED: usize = 5_000;
/// How much more edges beyond six count where they are not wanted.
const TOO_MANY: i64 = 20;

/// How many edges meet in every vertex.
fn valences(triangles: &[[u32; 3]], opposite: &[u32], vertices: usize) -> Vec<u32> {
    let mut valence = vec![0; vertices];
    for (half, over) in opposite.iter().enumerate() {
        let (a, b) = (triangles[half / 3][half % 3], triangles[half / 3][(half % 3 + 1) % 3]);
        valence[a as usize] += 1;
        if *over == NONE {
            valence[b as usize] += 1;
        }
    }
    valence
}

/// Turns edges near vertices for which `wanted` holds, up to so many steps away: those are to have six edges at most, the others as near six as can be. Gives how many turns were made, and how many edges meet in every vertex then.
pub(super) fn even_out(
    positions: &[[f64; 3]],
    triangles: &mut [[u32; 3]],
    wanted: &[bool],
    steps: usize,
) -> (usize, Vec<u32>) {
    let mut net = Net::new(positions, triangles, wanted, steps);
    let free = |half: &u32| net.free[net.corner(*half) as usize];
    let mut queue: Vec<u32> = (0..net.opposite.len() as u32).rev().filter(free).collect();
    while let Some(half) = queue.pop() {
        let better = |(change, around)| change < 0 && net.may_turn(around);
        if net.change(half).is_some_and(better) {
            let [t, s] = net.turn(half);
            queue.extend([3 * t, 3 * t + 1, 3 * t + 2, 3 * s, 3 * s + 1, 3 * s + 2]);
        }
    }
    // What no single turn betters, some in a row may. Where they do not, they are tried again once something near has changed.
    for limits in LIMITS {
        net.limits = limits;
        let mut changes = 1;
        let mut changed = vec![1; positions.len()];
        let mut tried = vec![0; positions.len()];
        loop {
            let before = net.turns;
            for v in 0..positions.len() as u32 {
                let at = v as usize;
                if !wanted[at] || net.valence[at] <= 6 || !net.any_near(v, |w| changed[w as usize] > tried[at]) {
                    continue;
                }
                (net.tried, tried[at]) = (0, changes);
                net.trail.clear();
                if net.relieve(v, limits.in_a_row, 0) {
                    changes += 1;
                    for w in net.trail.iter().flatten() {
                        changed[*w as usize] = changes;
                    }
                }
            }
            if net.turns == before {
                break;
            }
        }
    }
    (net.turns, net.valence)
}

/// Triangles with what is known of their edges and vertices.
struct Net<'a> {
    positions: &'a [[f64; 3]],
    triangles: &'a mut [[u32; 3]],
    wanted: &'a [bool],
    /// Vertices between which edges may be turned.
    free: Vec<bool>,
    opposite: Vec<u32>,
    /// A half-edge that leaves each vertex.
    leaves: Vec<u32>,
    valence: Vec<u32>,
    border: Vec<bool>,
    edges: HashSet<[u32; 2]>,
    limits: Limits,
    turns: usize,
    /// Turns tried since a vertex was begun with.
    tried: usize,
    /// The vertices of turns in a row that were not taken back.
    trail: Vec<[u32; 4]>,
}

impl<'a> Net<'a> {
    fn new(positions: &'a [[f64; 3]], triangles: &'a mut [[u32; 3]], wanted: &'a [bool], steps: usize) -> Self {
        let mut free = wanted.to_vec();
        for _ in 0..steps {
            let before = free.clone();
            for t in triangles.iter().filter(|t| t.iter().any(|v| before[*v as usize])) {
                for v in t {
                    free[*v as usize] = true;
                }
            }
        }
        let opposite = opposites(triangles);
        let mut border = vec![false; positions.len()];
        let mut edges = HashSet::new();
        let mut leaves = vec![NONE; positions.len()];
        for (half, over) in opposite.iter().enumerate() {
            let (a, b) = (triangles[half / 3][half % 3], triangles[half / 3][(half % 3 + 1) % 3]);
            leaves[a as usize] = half as u32;
            if *over == NONE {
                border[a as usize] = true;
                border[b as usize] = true;
            }
            // Only edges between vertices that are free are ever made.
            if free[a as usize] && free[b as usize] {
                edges.insert([a.min(b), a.max(b)]);
            }
        }
        Self {
            valence: valences(triangles, &opposite, positions.len()),
            positions,
            triangles,
            wanted,
            free,
            opposite,
            leaves,
            border,
            edges,
            limits: LIMITS[0],
            turns: 0,
            tried: 0,
            trail: Vec::new(),
        }
    }

    fn corner(&self, half: u32) -> u32 {
        self.triangles[half as usize / 3][half as usize % 3]
    }

    /// The ends of an edge, and the corners across it.
    fn around(&self, half: u32, over: u32) -> [u32; 4] {
        [half, over, previous_in_triangle(half), previous_in_triangle(over)].map(|h| self.corner(h))
    }

    /// How the sum changes when an edge is turned, and the vertices of its triangles ([`Self::around`]); none where it cannot be. Whether it may be is for [`Self::may_turn`] to say, which takes longer.
    fn change(&self, half: u32) -> Option<(i64, [u32; 4])> {
        let over = self.opposite[half as usize];
        if over == NONE {
            return None;
        }
        let around = self.around(half, over);
        let [a, b, c, d] = around;
        if !around.iter().all(|v| self.free[*v as usize])
            || c == d
            || self.valence[a as usize] <= 3
            || self.valence[b as usize] <= 3
        {
            return None;
        }
        let off = |v: u32, change: i64| {
            let v = v as usize;
            let count = i64::from(self.valence[v]) + change;
            let off = count - if self.border[v] { 4 } else { 6 };
            let over = (count - 6).max(0);
            off * off + if self.wanted[v] { TOO_MANY * over * over } else { 0 }
        };
        let before = off(a, 0) + off(b, 0) + off(c, 0) + off(d, 0);
        let after = off(a, -1) + off(b, -1) + off(c, 1) + off(d, 1);
        Some((after - before, around))
    }

    /// Whether an edge among such vertices may be turned: there is none yet where it would come to lie, and nothing folds.
    fn may_turn(&self, around: [u32; 4]) -> bool {
        let [_, _, c, d] = around;
        !self.edges.contains(&[c.min(d), c.max(d)]) && self.stays_flat(around)
    }

    /// Whether the triangles (a, b, c) and (b, a, d) may become (c, d, b) and (d, c, a).
    fn stays_flat(&self, [a, b, c, d]: [u32; 4]) -> bool {
        let at = |v: u32| self.positions[v as usize];
        let normal = |t: [u32; 3]| cross(sub(at(t[1]), at(t[0])), sub(at(t[2]), at(t[0])));
        let flat = |m: [f64; 3], n: [f64; 3]| dot(m, n) > self.limits.flat * norm(m) * norm(n);
        let (old, new) = ([[a, b, c], [b, a, d]], [[c, d, b], [d, c, a]]);
        let ([o0, o1], [n0, n1]) = (old.map(normal), new.map(normal));
        if !(flat(o0, o1) && flat(n0, n1) && flat(o0, n0) && flat(o0, n1)) {
            return false;
        }
        let least = |all: [[u32; 3]; 2]| {
            let angles = all.map(|t| smallest_angle(&t.map(at)));
            angles[0].min(angles[1])
        };
        let new = least(new);
        if new >= self.limits.well_shaped_rad {
            return true;
        }
        new >= self.limits.worse * least(old)
    }

    /// Turns an edge, without a question; gives its triangles. The edge is then the first of both.
    fn turn(&mut self, half: u32) -> [u32; 2] {
        let over = self.opposite[half as usize];
        let [a, b, c, d] = self.around(half, over);
        let outer = [
            next_in_triangle(half),
            previous_in_triangle(half),
            next_in_triangle(over),
            previous_in_triangle(over),
        ];
        let [bc, ca, ad, db] = outer.map(|h| self.opposite[h as usize]);
        let (t, s) = (half / 3, over / 3);
        self.triangles[t as usize] = [c, d, b];
        self.triangles[s as usize] = [d, c, a];
        let links = [
            (3 * t, 3 * s),
            (3 * t + 1, db),
            (3 * t + 2, bc),
            (3 * s + 1, ca),
            (3 * s + 2, ad),
        ];
        for (mine, theirs) in links {
            self.opposite[mine as usize] = theirs;
            if theirs != NONE {
                self.opposite[theirs as usize] = mine;
            }
        }
        for (v, leaving) in [(c, 3 * t), (d, 3 * s), (b, 3 * t + 2), (a, 3 * s + 2)] {
            self.leaves[v as usize] = leaving;
        }
        self.edges.remove(&[a.min(b), a.max(b)]);
        self.edges.insert([c.min(d), c.max(d)]);
        self.valence[a as usize] -= 1;
        self.valence[b as usize] -= 1;
        self.valence[c as usize] += 1;
        self.valence[d as usize] += 1;
        self.turns += 1;
        [t, s]
    }

    /// Half-edges that leave a vertex.
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
        // A border: round the other way, too.
        let mut at = first;
        while self.opposite[at as usize] != NONE {
            at = next_in_triangle(self.opposite[at as usize]);
            all.push(at);
        }
        all
    }

    /// Whether something holds of a vertex or one near it.
    fn any_near(&self, vertex: u32, holds: impl Fn(u32) -> bool) -> bool {
        let mut near = vec![vertex];
        let mut ring = 0..1;
        for _ in 0..NEAR {
            for k in ring.clone() {
                for half in self.leaving(near[k]) {
                    let end = self.corner(next_in_triangle(half));
                    if !near.contains(&end) {
                        near.push(end);
                    }
                }
            }
            ring = ring.end..near.len();
        }
        near.into_iter().any(holds)
    }

    /// Turns an edge of a vertex with too many, then one of a vertex that has too many by that, until the sum is less than it was; leaves all as it was where so many turns do not do.
    fn relieve(&mut self, vertex: u32, turns: usize, change: i64) -> bool {
        let mut leaving = self.leaving(vertex);
        let ends: Vec<u32> = leaving.iter().map(|h| self.corner(next_in_triangle(*h))).collect();
        for end in ends {
            let edge = (leaving.iter()).find(|h| self.corner(next_in_triangle(**h)) == end);
            let Some((edge, (more, around))) = edge.and_then(|h| Some((*h, self.change(*h)?))) else {
                continue;
            };
            let [_, _, c, d] = around;
            let full = |v: u32| self.valence[v as usize] >= 6 && self.wanted[v as usize];
            let helps = change + more < 0;
            if self.tried >= MOST_TRIED {
                return false;
            }
            if !helps && (turns == 1 || !(full(c) || full(d))) || !self.may_turn(around) {
                continue;
            }
            self.tried += 1;
            let [t, s] = self.turn(edge);
            self.trail.push(around);
            if helps {
                return true;
            }
            // Its ends now. Triangles change places when turns are taken back.
            let (c, d) = (self.corner(3 * t), self.corner(3 * s));
            for v in [c, d] {
                let full = self.valence[v as usize] > 6 && self.wanted[v as usize];
                if full && self.relieve(v, turns - 1, change + more) {
                    return true;
                }
            }
            let back = (self.leaving(c).into_iter()).find(|h| self.corner(next_in_triangle(*h)) == d);
            if let Some(back) = back {
                self.turn(back);
            }
            self.turns -= 2;
            self.trail.pop();
            leaving = self.leaving(vertex);
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriangleMesh;
    use crate::primitives::{grid_sheet, icosphere};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn valences_of(triangles: &[[u32; 3]], vertices: usize) -> Vec<u32> {
        valences(triangles, &opposites(triangles), vertices)
    }

    #[test]
    fn a_fan_is_evened_out_and_stays_a_surface() {
        let sheet = grid_sheet(1.0, 1.0, 12, 12);
        let mut triangles = sheet.triangles.clone();
        // Turn some diagonals the other way.
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for square in 0..triangles.len() / 2 {
            if rng.random::<f64>() < 0.5 {
                continue;
            }
            let pair = [triangles[2 * square], triangles[2 * square + 1]];
            let lone = |k: usize| *pair[k].iter().find(|v| !pair[1 - k].contains(v)).unwrap();
            let turned = |k: usize| {
                let at = pair[k].iter().position(|v| *v == lone(k)).unwrap();
                [pair[k][at], pair[k][(at + 1) % 3], lone(1 - k)]
            };
            triangles[2 * square] = turned(0);
            triangles[2 * square + 1] = turned(1);
        }
        let before = valences_of(&triangles, sheet.positions.len());
        let area = TriangleMesh::try_new(sheet.positions.clone(), triangles.clone())
            .unwrap()
            .area();
        let (turns, counted) = even_out(&sheet.positions, &mut triangles, &vec![true; sheet.positions.len()], 0);
        let after = valences_of(&triangles, sheet.positions.len());
        assert_eq!(counted, after);
        let mesh = TriangleMesh::try_new(sheet.positions, triangles).unwrap();
        assert!(
            turns > 0 && mesh.check().manifold && mesh.check().oriented,
            "{turns} {:?} {before:?}",
            mesh.check()
        );
        assert!((mesh.area() - area).abs() < 1e-12);
        let over = |valence: &[u32]| valence.iter().filter(|v| **v > 6).count();
        assert!(
            4 * over(&after) < over(&before),
            "{} and {}",
            over(&after),
            over(&before)
        );
    }

    /// Of 20 seams of 160 vertices that are much out of order, hardly a vertex keeps seven edges: what is too much is carried to where it may be, over seven turns if need be (with four, 24 vertices keep them).
    #[test]
    fn hardly_a_vertex_of_a_seam_keeps_seven_edges() {
        let ball = icosphere(1.0, 5);
        let (mut left, mut vertices) = (0, 0);
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut triangles = ball.triangles.clone();
            let everywhere = vec![true; ball.positions.len()];
            let mut net = Net::new(&ball.positions, &mut triangles, &everywhere, 0);
            for half in 0..net.opposite.len() as u32 {
                let middle = net.positions[net.corner(half) as usize];
                if middle[2].abs() < 0.04
                    && rng.random::<f64>() < 0.3
                    && net.change(half).is_some_and(|(_, around)| net.may_turn(around))
                {
                    net.turn(half);
                }
            }
            let seam: Vec<bool> = ball.positions.iter().map(|p| p[2].abs() < 0.04).collect();
            let (_, valence) = even_out(&ball.positions, &mut triangles, &seam, 3);
            left += valence.iter().zip(&seam).filter(|(n, s)| **s && **n > 6).count();
            vertices += seam.iter().filter(|s| **s).count();
            let check = TriangleMesh::try_new(ball.positions.clone(), triangles)
                .unwrap()
                .check();
            assert!(check.manifold && check.oriented && check.watertight, "{check:?}");
        }
        assert!(vertices > 3000 && left <= 8, "{left} of {vertices}");
    }

    #[test]
    fn valences_count_edges() {
        let ball = icosphere(1.0, 2);
        let valence = valences_of(&ball.triangles, ball.positions.len());
        assert_eq!(valence.iter().filter(|v| **v == 5).count(), 12);
        assert!(valence.iter().all(|v| *v == 5 || *v == 6));
    }
}
