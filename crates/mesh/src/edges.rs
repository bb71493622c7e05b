//! The edges of a list of triangles, each with the triangles at it.
//!
//! In: triangles of vertex indices. Out: numbered edges in ascending order of their end vertices. Not
//! guaranteed: two triangles per edge. Triangles that contain a vertex twice are included; test them with
//! [`is_collapsed`].

use rayon::prelude::*;

/// Edges numbered from 0, and half-edges `3 t + k`: the edge of triangle `t` from corner `k` to the next.
pub(crate) struct EdgeTable {
    /// Both end vertices, the smaller first.
    pub ends: Vec<[u32; 2]>,
    /// The edge of each half-edge.
    pub triangle_edges: Vec<[u32; 3]>,
    starts: Vec<u32>,
    half_edges: Vec<u32>,
}

impl EdgeTable {
    /// Builds the table. Cost O(n + v) for n triangles over vertices numbered up to v.
    ///
    /// Half-edges are sorted by counting at their lower ends; only those at one vertex are compared. This is
    /// deterministic, which a hash map of edges would not be in its order.
    pub fn new(triangles: &[[u32; 3]]) -> Self {
        let (mut keyed, at_vertex) = by_lower_end(triangles);
        sort_at_each_vertex(&mut keyed, &at_vertex);
        let mut table = Self {
            ends: Vec::with_capacity(keyed.len() / 2),
            triangle_edges: vec![[0; 3]; triangles.len()],
            starts: Vec::with_capacity(keyed.len() / 2 + 1),
            half_edges: Vec::with_capacity(keyed.len()),
        };
        // Equal edges are adjacent after the sort, so a change of the higher end starts a new edge.
        for (lower, of_vertex) in (0_u32..).zip(at_vertex.windows(2)) {
            let mut last = None;
            for key in &keyed[of_vertex[0] as usize..of_vertex[1] as usize] {
                let (higher, half) = ((key >> 32) as u32, *key as u32);
                if last != Some(higher) {
                    last = Some(higher);
                    table.starts.push(table.half_edges.len() as u32);
                    table.ends.push([lower, higher]);
                }
                table.half_edges.push(half);
                table.triangle_edges[half as usize / 3][half as usize % 3] = table.ends.len() as u32 - 1;
            }
        }
        // The end of the last edge, so that every edge has a start and an end.
        table.starts.push(table.half_edges.len() as u32);
        table
    }

    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// The half-edges along an edge, in ascending order.
    pub fn half_edges(&self, edge: usize) -> &[u32] {
        &self.half_edges[self.starts[edge] as usize..self.starts[edge + 1] as usize]
    }
}

/// Half-edges in the order of their lower ends, and the start of those of each vertex.
///
/// Each entry has the higher end in its upper 32 bits and the half-edge in the lower ones, so that sorting
/// numbers sorts by both.
fn by_lower_end(triangles: &[[u32; 3]]) -> (Vec<u64>, Vec<u32>) {
    let vertices = triangles.iter().flatten().max().map_or(0, |last| *last as usize + 1);
    let mut starts = vec![0_u32; vertices + 1];
    for t in triangles {
        for k in 0..3 {
            starts[t[k].min(t[(k + 1) % 3]) as usize + 1] += 1;
        }
    }
    for v in 0..vertices {
        starts[v + 1] += starts[v];
    }
    // A counting sort needs no comparisons, and its result has a fixed order.
    let mut next = starts.clone();
    let mut keyed = vec![0; 3 * triangles.len()];
    for (n, t) in triangles.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            let place = &mut next[a.min(b) as usize];
            keyed[*place as usize] = (u64::from(a.max(b)) << 32) | (3 * n + k) as u64;
            *place += 1;
        }
    }
    (keyed, starts)
}

/// Sorts the half-edges of each vertex, in parallel over blocks of vertices.
fn sort_at_each_vertex(keyed: &mut [u64], starts: &[u32]) {
    // Blocks of fixed size: few enough for cheap tasks, and the same for any number of threads.
    const VERTICES: usize = 1 << 14;
    let mut rest = keyed;
    let mut pieces = Vec::new();
    for first in (0..starts.len() - 1).step_by(VERTICES) {
        let of_piece = &starts[first..(first + VERTICES + 1).min(starts.len())];
        let (piece, after) = rest.split_at_mut((of_piece[of_piece.len() - 1] - of_piece[0]) as usize);
        pieces.push((piece, of_piece));
        rest = after;
    }
    pieces.into_par_iter().for_each(|(piece, starts)| {
        for of_vertex in starts.windows(2) {
            piece[(of_vertex[0] - starts[0]) as usize..(of_vertex[1] - starts[0]) as usize].sort_unstable();
        }
    });
}

/// The key of the edge between two vertices, in either order.
#[inline]
pub(crate) fn edge(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// True if a triangle contains a vertex twice.
pub(crate) fn is_collapsed(t: [u32; 3]) -> bool {
    t[0] == t[1] || t[1] == t[2] || t[2] == t[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::icosphere;
    use std::collections::BTreeMap;

    /// Edges and half-edges have the order of all half-edges sorted by both ends, for meshes with many
    /// vertices, with fins, with triangles that contain a vertex twice, and without triangles.
    #[test]
    fn edges_match_sorted_half_edges() {
        let mut fins = icosphere(1.0, 2).triangles;
        fins.extend([[0, 1, 900], [1, 0, 7], [0, 12, 1], [5, 5, 3], [4, 4, 4]]);
        for triangles in [icosphere(1.0, 6).triangles, fins, Vec::new()] {
            let mut sorted: BTreeMap<[u32; 2], Vec<u32>> = BTreeMap::new();
            for half in 0..3 * triangles.len() {
                let t = triangles[half / 3];
                let (a, b) = (t[half % 3], t[(half % 3 + 1) % 3]);
                sorted.entry([a.min(b), a.max(b)]).or_default().push(half as u32);
            }
            let table = EdgeTable::new(&triangles);
            assert!(table.ends.iter().eq(sorted.keys()));
            for (edge, halves) in sorted.values().enumerate() {
                assert_eq!(table.half_edges(edge), halves);
                for half in halves {
                    assert_eq!(table.triangle_edges[*half as usize / 3][*half as usize % 3], edge as u32);
                }
            }
        }
    }
}
