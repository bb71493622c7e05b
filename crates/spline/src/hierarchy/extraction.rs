//! The extraction of all leaves as one sparse matrix.
//!
//! Input: a [`Hierarchy`]. Output: coefficients of all leaves from control vertices, and the transposed map
//! for right-hand sides. Most coefficients equal one vertex, so the dense weights of
//! [`Hierarchy::extraction`] are mostly zero. The result has the same bytes for any number of threads.

use super::Hierarchy;
use planish_core::DVec3;
use rayon::prelude::*;
use std::sync::OnceLock;

/// Rows of a sparse matrix.
#[derive(Debug, Clone)]
struct Rows {
    start: Vec<u32>,
    entries: Vec<(u32, f64)>,
}

impl Rows {
    fn row(&self, row: usize) -> &[(u32, f64)] {
        &self.entries[self.start[row] as usize..self.start[row + 1] as usize]
    }

    /// `Σ weight · value` over the entries of a row.
    #[inline]
    fn combine(&self, row: usize, value: impl Fn(usize) -> DVec3) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for &(column, w) in self.row(row) {
            let p = value(column as usize);
            for d in 0..3 {
                sum[d] += w * p[d];
            }
        }
        sum
    }
}

/// Weights of the nodes in the coefficients of the leaves, stored by coefficient and by node.
#[derive(Debug, Clone)]
pub(crate) struct SparseExtraction {
    /// Row `16 · leaf + k`: nodes.
    by_coefficient: Rows,
    /// Row `node`: `16 · leaf + k`. Made on first use.
    by_node: OnceLock<Rows>,
}

/// Leaves whose rows are found by a thread at a time.
const LEAVES: usize = 512;

impl SparseExtraction {
    pub(crate) fn new(space: &Hierarchy) -> Self {
        let leaves = space.leaves().len();
        let parts: Vec<Rows> = (0..leaves.div_ceil(LEAVES))
            .into_par_iter()
            .map(|part| {
                let own = part * LEAVES..leaves.min((part + 1) * LEAVES);
                let (mut start, mut entries) =
                    (Vec::with_capacity(16 * LEAVES), Vec::with_capacity(20 * LEAVES));
                for leaf in own {
                    let (nodes, weights) = space.extraction(leaf);
                    for k in 0..16 {
                        // Most weights are zero. About 20 entries per leaf remain, slightly more than one per
                        // coefficient.
                        let found = nodes.iter().zip(weights).filter(|(_, w)| w[k] != 0.0);
                        entries.extend(found.map(|(&node, w)| (node, w[k])));
                        start.push(entries.len() as u32);
                    }
                }
                Rows { start, entries }
            })
            .collect();
        let mut all = Rows {
            start: Vec::with_capacity(16 * leaves + 1),
            entries: Vec::with_capacity(parts.iter().map(|part| part.entries.len()).sum()),
        };
        all.start.push(0);
        for Rows { start, entries } in parts {
            let first = all.entries.len() as u32;
            all.start.extend(start.iter().map(|end| first + end));
            all.entries.extend(entries);
        }
        Self { by_coefficient: all, by_node: OnceLock::new() }
    }

    /// The rows of the transposed matrix.
    ///
    /// Stored in both orders, so that both maps gather. Scattering from several threads would need locks, and
    /// the order of additions would vary.
    fn by_node(&self, nodes: usize) -> &Rows {
        self.by_node.get_or_init(|| {
            let Rows { start, entries } = &self.by_coefficient;
            let mut count = vec![0_u32; nodes + 1];
            for (node, _) in entries {
                count[*node as usize + 1] += 1;
            }
            for node in 0..nodes {
                count[node + 1] += count[node];
            }
            let mut by_node = Rows { start: count.clone(), entries: vec![(0, 0.0); entries.len()] };
            for row in 0..start.len() - 1 {
                for &(node, w) in self.by_coefficient.row(row) {
                    let place = &mut count[node as usize];
                    by_node.entries[*place as usize] = (row as u32, w);
                    *place += 1;
                }
            }
            by_node
        })
    }

    /// Sixteen coefficients of every leaf.
    pub(crate) fn coefficients(&self, vertices: &[DVec3]) -> Vec<[DVec3; 16]> {
        (0..(self.by_coefficient.start.len() - 1) / 16)
            .into_par_iter()
            .with_min_len(512)
            .map(|leaf| {
                std::array::from_fn(|k| self.by_coefficient.combine(16 * leaf + k, |node| vertices[node]))
            })
            .collect()
    }

    /// Applies the transpose: sums values of all coefficients at the nodes. Node-major, three columns.
    pub(crate) fn gather(&self, of_leaves: &[[DVec3; 16]], nodes: usize) -> Vec<f64> {
        let by_node = self.by_node(nodes);
        (0..nodes)
            .into_par_iter()
            .with_min_len(512)
            .flat_map_iter(|node| by_node.combine(node, |row| of_leaves[row / 16][row % 16]).to_array())
            .collect()
    }
}
