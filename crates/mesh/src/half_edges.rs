//! Half-edges: those of triangle `t` are `3 t + k`, from corner `k` to the next.
//!
//! In: triangles whose edges are manifold and oriented. Out: the opposite of each half-edge, which is updated
//! when edges are flipped and triangles split. Not guaranteed: that the edge made by a flip does not exist
//! already; the caller has to test this.

use crate::edges::EdgeTable;
use crate::mesh::TriangleMesh;

/// No opposite half-edge: the edge is on the border.
pub(crate) const NONE: u32 = u32::MAX;

impl TriangleMesh {
    /// For each half-edge `3 t + k`, from corner `k` of triangle `t` to the next, the one in the other
    /// direction. [`u32::MAX`] at borders and at edges of more than two triangles.
    ///
    /// # Examples
    /// ```
    /// let ball = planish_mesh::icosphere(1.0, 1);
    /// let opposite = ball.opposite_half_edges();
    /// assert!((0..).zip(&opposite).all(|(half, over)| opposite[*over as usize] == half));
    /// ```
    #[must_use]
    pub fn opposite_half_edges(&self) -> Vec<u32> {
        opposites(&self.triangles)
    }
}

/// For each half-edge, the opposite one, or [`NONE`] on the border.
///
/// Edges with more than two triangles count as border.
pub(crate) fn opposites(triangles: &[[u32; 3]]) -> Vec<u32> {
    opposites_of(&EdgeTable::new(triangles), triangles.len())
}

/// [`opposites`] with an existing table of edges.
pub(crate) fn opposites_of(table: &EdgeTable, triangles: usize) -> Vec<u32> {
    let mut opposite = vec![NONE; 3 * triangles];
    for edge in 0..table.len() {
        if let [a, b] = *table.half_edges(edge) {
            opposite[a as usize] = b;
            opposite[b as usize] = a;
        }
    }
    opposite
}

/// The next half-edge in the same triangle.
#[inline]
pub(crate) fn next_in_triangle(half: u32) -> u32 {
    if half % 3 == 2 { half - 2 } else { half + 1 }
}

/// The previous half-edge in the same triangle.
#[inline]
pub(crate) fn previous_in_triangle(half: u32) -> u32 {
    if half.is_multiple_of(3) { half + 2 } else { half - 1 }
}

/// The ends `a, b` of an edge and the opposite corners `c, d`, for triangles (a, b, c) and (b, a, d).
#[inline]
pub(crate) fn around(triangles: &[[u32; 3]], half: u32, over: u32) -> [u32; 4] {
    let corner = |h: u32| triangles[h as usize / 3][h as usize % 3];
    [half, over, previous_in_triangle(half), previous_in_triangle(over)].map(corner)
}

/// Flips the edge (a, b) of [`around`] to (c, d) without checks.
///
/// The triangles become (c, d, b) and (d, c, a); the new edge is the first half-edge of both.
pub(crate) fn flip(triangles: &mut [[u32; 3]], opposite: &mut [u32], half: u32) -> [u32; 2] {
    let over = opposite[half as usize];
    let [a, b, c, d] = around(triangles, half, over);
    // The four outer neighbours are read before the triangles change: half-edges are numbered by
    // triangle, so they refer to other edges afterwards.
    let outer = [
        next_in_triangle(half),
        previous_in_triangle(half),
        next_in_triangle(over),
        previous_in_triangle(over),
    ];
    let [bc, ca, ad, db] = outer.map(|h| opposite[h as usize]);
    let (t, s) = (half / 3, over / 3);
    triangles[t as usize] = [c, d, b];
    triangles[s as usize] = [d, c, a];
    let links = [(3 * t, 3 * s), (3 * t + 1, db), (3 * t + 2, bc), (3 * s + 1, ca), (3 * s + 2, ad)];
    for (first, second) in links {
        link(opposite, first, second);
    }
    [t, s]
}

/// Splits a triangle into three at a vertex within it; the two additional ones are appended.
pub(crate) fn split_triangle(
    triangles: &mut Vec<[u32; 3]>,
    opposite: &mut Vec<u32>,
    triangle: u32,
    vertex: u32,
) {
    let [a, b, c] = triangles[triangle as usize];
    // Read first, for the same reason as in [`flip`].
    let outer: [u32; 3] = std::array::from_fn(|k| opposite[3 * triangle as usize + k]);
    let (t, s, r) = (triangle, triangles.len() as u32, triangles.len() as u32 + 1);
    triangles[t as usize] = [a, b, vertex];
    triangles.extend([[b, c, vertex], [c, a, vertex]]);
    // The two new triangles have no neighbours yet; a neighbour across a border stays `NONE`.
    opposite.extend([NONE; 6]);
    for (triangle, over) in [t, s, r].into_iter().zip(outer) {
        link(opposite, 3 * triangle, over);
    }
    for (triangle, next) in [(t, s), (s, r), (r, t)] {
        link(opposite, 3 * triangle + 1, 3 * next + 2);
    }
}

/// Makes two half-edges opposites of each other; the second may be [`NONE`].
fn link(opposite: &mut [u32], first: u32, second: u32) {
    opposite[first as usize] = second;
    if second != NONE {
        opposite[second as usize] = first;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{grid_sheet, icosphere};

    #[test]
    fn flips_and_splits_keep_opposites_consistent() {
        for mesh in [icosphere(1.0, 2), grid_sheet(1.0, 1.0, 4, 5)] {
            let (mut triangles, mut opposite) = (mesh.triangles.clone(), opposites(&mesh.triangles));
            for (vertex, half) in (mesh.positions.len() as u32..).zip((0..opposite.len() as u32).step_by(7)) {
                if opposite[half as usize] != NONE {
                    flip(&mut triangles, &mut opposite, half);
                }
                split_triangle(&mut triangles, &mut opposite, half / 3, vertex);
            }
            for (half, over) in (0_u32..).zip(&opposite).filter(|(_, over)| **over != NONE) {
                let corner = |h: u32| triangles[h as usize / 3][h as usize % 3];
                assert_eq!(opposite[*over as usize], half);
                assert_eq!(
                    [corner(half), corner(next_in_triangle(half))],
                    [corner(next_in_triangle(*over)), corner(*over)]
                );
            }
            let border = |opposites: &[u32]| opposites.iter().filter(|over| **over == NONE).count();
            assert_eq!(border(&opposite), border(&opposites(&mesh.triangles)));
        }
    }
}
