//! The edges of a triangle list, each once, with the triangles around it.
//!
//! Comes in: triangles of vertex indices. Goes out: numbered edges in ascending order of their end vertices.
//! Not guaranteed: two triangles to an edge; a triangle that names a vertex twice is listed all the same, and
//! [`is_collapsed`] tells.

use rayon::prelude::*;

/// Edges numbered 0.., and half-edges `3 t + k`: triangle `t` from corner `k` to the next.
pub(crate) struct EdgeTable {
    /// Both end vertices, the smaller first.
    pub ends: Vec<[u32; 2]>,
    /// The edge of each half-edge.
    pub triangle_edges: Vec<[u32; 3]>,
    starts: Vec<u32>,
    half_edges: Vec<u32>,
}

impl EdgeTable {
    /// Cost O(n + v) for n triangles over vertices numbered up to v: half-edges are counted at their lesser
    /// ends, and only those at one vertex are compared.
    pub fn new(triangles: &[[u32; 3]]) -> Self {
        let (mut keyed, at_vertex) = by_lesser_end(triangles);
        sort_at_each_vertex(&mut keyed, &at_vertex);
        let mut table = Self {
            ends: Vec::with_capacity(keyed.len() / 2),
            triangle_edges: vec![[0; 3]; triangles.len()],
            starts: Vec::with_capacity(keyed.len() / 2 + 1),
            half_edges: Vec::with_capacity(keyed.len()),
        };
        for (lesser, of_vertex) in (0_u32..).zip(at_vertex.windows(2)) {
            let mut last = None;
            for key in &keyed[of_vertex[0] as usize..of_vertex[1] as usize] {
                let (greater, half) = ((key >> 32) as u32, *key as u32);
                if last != Some(greater) {
                    last = Some(greater);
                    table.starts.push(table.half_edges.len() as u32);
                    table.ends.push([lesser, greater]);
                }
                table.half_edges.push(half);
                table.triangle_edges[half as usize / 3][half as usize % 3] = table.ends.len() as u32 - 1;
            }
        }
        table.starts.push(table.half_edges.len() as u32);
        table
    }

    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// The half-edges along edge `edge`, in ascending order.
    pub fn half_edges(&self, edge: usize) -> &[u32] {
        &self.half_edges[self.starts[edge] as usize..self.starts[edge + 1] as usize]
    }
}

/// Half-edges, each behind its greater end, in the order of their lesser ends; and where those of each vertex
/// start.
fn by_lesser_end(triangles: &[[u32; 3]]) -> (Vec<u64>, Vec<u32>) {
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

/// Sorts the half-edges of each vertex, many vertices at a time.
fn sort_at_each_vertex(keyed: &mut [u64], starts: &[u32]) {
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

/// The edge between two vertices, whichever way round.
#[inline]
pub(crate) fn edge(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Whether a triangle names a vertex twice.
pub(crate) fn is_collapsed(t: [u32; 3]) -> bool {
    t[0] == t[1] || t[1] == t[2] || t[2] == t[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::icosphere;
    use std::collections::BTreeMap;

    /// Edges and half-edges are those, in that order, of all half-edges sorted by both ends: meshes with many
    /// vertices, with fins, with triangles that name a vertex twice, with none.
    #[test]
    fn edges_are_those_of_half_edges_sorted() {
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
