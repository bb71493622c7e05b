//! Edges turned until vertices have six neighbours.
//!
//! Comes in: a surface and the vertices that may change. Goes out: the same vertices with as many triangles, each turn of an edge lessening `Σ (valence − 6)²` (4 on the border) without folding the surface. Not guaranteed: six everywhere, which the
//! topology does not allow.

use super::manifold::{NONE, next_in_triangle, opposites, previous_in_triangle};
use crate::triangle::triangle_shape;
use planish_estimate::vector3::{cross, dot, norm, sub};
use std::collections::HashSet;

/// The least cosine between the two triangles at an edge, before and after it is turned.
const FLAT: f64 = 0.8;
/// The smallest angle of the triangles may shrink to this share by a turn.
const WORSE: f64 = 0.5;

/// How many edges meet in every vertex.
pub(super) fn valences(triangles: &[[u32; 3]], vertices: usize) -> Vec<u32> {
    let opposite = opposites(triangles);
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

/// Turns edges between vertices for which `free` holds. Gives how many turns were made.
pub(super) fn even_out(positions: &[[f64; 3]], triangles: &mut [[u32; 3]], free: &[bool]) -> usize {
    let mut valence = valences(triangles, positions.len());
    let mut opposite = opposites(triangles);
    let mut border = vec![false; positions.len()];
    let mut edges: HashSet<[u32; 2]> = HashSet::new();
    for (half, over) in opposite.iter().enumerate() {
        let (a, b) = (triangles[half / 3][half % 3], triangles[half / 3][(half % 3 + 1) % 3]);
        if *over == NONE {
            border[a as usize] = true;
            border[b as usize] = true;
        }
        edges.insert([a.min(b), a.max(b)]);
    }
    let mut turns = 0;
    let mut queue: Vec<u32> = (0..opposite.len() as u32).rev().collect();
    while let Some(half) = queue.pop() {
        let over = opposite[half as usize];
        if over == NONE {
            continue;
        }
        let corner = |t: &[[u32; 3]], h: u32| t[h as usize / 3][h as usize % 3];
        // Triangles (a, b, c) and (b, a, d) become (c, d, b) and (d, c, a).
        let (a, b) = (corner(triangles, half), corner(triangles, over));
        let (c, d) = (
            corner(triangles, previous_in_triangle(half)),
            corner(triangles, previous_in_triangle(over)),
        );
        if ![a, b, c, d].iter().all(|v| free[*v as usize]) || c == d || edges.contains(&[c.min(d), c.max(d)]) {
            continue;
        }
        let off = |v: u32, change: i64| {
            let ideal = if border[v as usize] { 4 } else { 6 };
            let off = i64::from(valence[v as usize]) + change - ideal;
            off * off
        };
        let before = off(a, 0) + off(b, 0) + off(c, 0) + off(d, 0);
        let after = off(a, -1) + off(b, -1) + off(c, 1) + off(d, 1);
        if after >= before || valence[a as usize] <= 3 || valence[b as usize] <= 3 {
            continue;
        }
        let at = |v: u32| positions[v as usize];
        let normal = |x: u32, y: u32, z: u32| cross(sub(at(y), at(x)), sub(at(z), at(x)));
        let flat = |m: [f64; 3], n: [f64; 3]| dot(m, n) > FLAT * norm(m) * norm(n);
        let (old, new) = ([normal(a, b, c), normal(b, a, d)], [normal(c, d, b), normal(d, c, a)]);
        if !flat(old[0], old[1]) || !flat(new[0], new[1]) || !flat(old[0], new[0]) || !flat(old[0], new[1]) {
            continue;
        }
        let least = |all: [[u32; 3]; 2]| {
            all.map(|t| triangle_shape(&t.map(at)).0)
                .into_iter()
                .fold(f64::INFINITY, f64::min)
        };
        if least([[c, d, b], [d, c, a]]) < WORSE * least([[a, b, c], [b, a, d]]) {
            continue;
        }
        // Half-edges of the four outer edges, and what lies across them.
        let (bc, ca) = (next_in_triangle(half), previous_in_triangle(half));
        let (ad, db) = (next_in_triangle(over), previous_in_triangle(over));
        let across = [bc, ca, ad, db].map(|h| opposite[h as usize]);
        let (t, s) = (half / 3, over / 3);
        triangles[t as usize] = [c, d, b];
        triangles[s as usize] = [d, c, a];
        // (c→d, d→b, b→c) and (d→c, c→a, a→d).
        let links = [
            (3 * t, 3 * s),
            (3 * t + 1, across[3]),
            (3 * t + 2, across[0]),
            (3 * s + 1, across[1]),
            (3 * s + 2, across[2]),
        ];
        for (mine, theirs) in links {
            opposite[mine as usize] = theirs;
            if theirs != NONE {
                opposite[theirs as usize] = mine;
            }
        }
        edges.remove(&[a.min(b), a.max(b)]);
        edges.insert([c.min(d), c.max(d)]);
        valence[a as usize] -= 1;
        valence[b as usize] -= 1;
        valence[c as usize] += 1;
        valence[d as usize] += 1;
        turns += 1;
        queue.extend([3 * t, 3 * t + 1, 3 * t + 2, 3 * s, 3 * s + 1, 3 * s + 2]);
    }
    turns
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriangleMesh;
    use crate::primitives::{grid_sheet, icosphere};

    #[test]
    fn a_fan_is_evened_out_and_stays_a_surface() {
        let sheet = grid_sheet(1.0, 1.0, 12, 12);
        let mut triangles = sheet.triangles.clone();
        // Turn some edges the wrong way: pairs of triangles of a square.
        for square in (0..triangles.len() / 2).step_by(3) {
            let all: Vec<u32> = triangles[2 * square..2 * square + 2].concat();
            let shared: Vec<u32> = all
                .iter()
                .copied()
                .filter(|v| all.iter().filter(|w| *w == v).count() == 2)
                .collect();
            let lone: Vec<u32> = all.iter().copied().filter(|v| !shared.contains(v)).collect();
            let (a, b) = (shared[0], *shared.iter().find(|v| **v != shared[0]).unwrap());
            let up = |t: [u32; 3]| {
                let p = t.map(|v| sheet.positions[v as usize]);
                cross(sub(p[1], p[0]), sub(p[2], p[0]))[2] > 0.0
            };
            for (k, end) in [a, b].into_iter().enumerate() {
                let t = [lone[0], lone[1], end];
                triangles[2 * square + k] = if up(t) { t } else { [t[1], t[0], t[2]] };
            }
        }
        let before = valences(&triangles, sheet.positions.len());
        let area = TriangleMesh::try_new(sheet.positions.clone(), triangles.clone())
            .unwrap()
            .area();
        let turns = even_out(&sheet.positions, &mut triangles, &vec![true; sheet.positions.len()]);
        let after = valences(&triangles, sheet.positions.len());
        let mesh = TriangleMesh::try_new(sheet.positions, triangles).unwrap();
        assert!(turns > 0 && mesh.check().manifold && mesh.check().oriented);
        assert!((mesh.area() - area).abs() < 1e-12);
        let over = |valence: &[u32]| valence.iter().filter(|v| **v > 6).count();
        assert!(
            20 * over(&after) < over(&before),
            "{} and {}",
            over(&after),
            over(&before)
        );
    }

    #[test]
    fn valences_count_edges() {
        let ball = icosphere(1.0, 2);
        let valence = valences(&ball.triangles, ball.positions.len());
        assert_eq!(valence.iter().filter(|v| **v == 5).count(), 12);
        assert!(valence.iter().all(|v| *v == 5 || *v == 6));
    }
}
