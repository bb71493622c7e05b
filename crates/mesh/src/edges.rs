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
    pub fn of(triangles: &[[u32; 3]]) -> Self {
        let mut keyed: Vec<(u64, u32)> = triangles
            .iter()
            .enumerate()
            .flat_map(|(t, corners)| {
                (0..3).map(move |k| {
                    let (a, b) = (corners[k], corners[(k + 1) % 3]);
                    ((u64::from(a.min(b)) << 32) | u64::from(a.max(b)), (3 * t + k) as u32)
                })
            })
            .collect();
        keyed.par_sort_unstable();
        let mut table = Self {
            ends: Vec::with_capacity(keyed.len() / 2),
            triangle_edges: vec![[0; 3]; triangles.len()],
            starts: Vec::with_capacity(keyed.len() / 2 + 1),
            half_edges: Vec::with_capacity(keyed.len()),
        };
        let mut last = None;
        for (key, half) in keyed {
            if last != Some(key) {
                last = Some(key);
                table.starts.push(table.half_edges.len() as u32);
                table.ends.push([(key >> 32) as u32, key as u32]);
            }
            table.half_edges.push(half);
            table.triangle_edges[half as usize / 3][half as usize % 3] = table.ends.len() as u32 - 1;
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

/// Whether a triangle names a vertex twice.
pub(crate) fn is_collapsed(t: [u32; 3]) -> bool {
    t[0] == t[1] || t[1] == t[2] || t[2] == t[0]
}
