//! Sparsity pattern: which nodes are coupled.
//!
//! Input: elements, each a list of coupled nodes. Output: the lower triangle with the diagonal, by columns
//! with sorted rows. Not guaranteed: that every node belongs to an element. Diagonal entries always exist.

use crate::{Error, Result};

/// Maximum number of entries: [`super::ElementScatter`] needs two bits of a 32-bit position.
const MAX_ENTRIES: usize = (1 << 30) - 1;

/// The symmetric sparsity pattern of an information matrix over nodes.
///
/// Only entries `(i, j)` with `i ≥ j` are stored, by column, rows ascending; the diagonal comes first in each
/// column.
///
/// # Examples
/// ```
/// use planish_estimate::sparse::BlockPattern;
/// let chain = BlockPattern::from_elements(4, [[0, 1], [1, 2], [3, 2]])?;
/// assert_eq!(chain.column(1), &[1, 2]);
/// assert_eq!(chain.entries(), 4 + 3);
/// assert!(chain.position(0, 1).is_some() && chain.position(0, 3).is_none());
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockPattern {
    column_start: Vec<u32>,
    rows: Vec<u32>,
}

impl BlockPattern {
    /// The pattern in which every pair of nodes inside an element is coupled.
    ///
    /// Nodes of an element may come in any order and may repeat. Cost: O(Σ k²) for elements of k nodes.
    ///
    /// # Errors
    /// `Input` when an element names a node that does not exist, or when the pattern is too large for 30-bit
    /// positions.
    pub fn from_elements<E>(nodes: usize, elements: impl IntoIterator<Item = E>) -> Result<Self>
    where
        E: AsRef<[u32]>,
    {
        if nodes > MAX_ENTRIES {
            return Err(Error::input(format!(
                "expected at most {MAX_ENTRIES} nodes in a pattern, found {nodes}"
            )));
        }
        let mut element_start = vec![0_usize];
        let mut element_nodes: Vec<u32> = Vec::new();
        let mut sorted: Vec<u32> = Vec::new();
        let mut memberships = vec![0_usize; nodes + 1];
        for (index, element) in elements.into_iter().enumerate() {
            sorted.clear();
            sorted.extend_from_slice(element.as_ref());
            sorted.sort_unstable();
            // A node may repeat; it would otherwise be counted twice in its column.
            sorted.dedup();
            if let Some(&last) = sorted.last()
                && last as usize >= nodes
            {
                return Err(Error::input(format!(
                    "element {index}: expected nodes below {nodes}, found {last}"
                )));
            }
            for &node in &sorted {
                memberships[node as usize + 1] += 1;
            }
            element_nodes.extend_from_slice(&sorted);
            element_start.push(element_nodes.len());
        }
        // For each node, the range in `element_nodes` of the rest of each of its elements, starting at the
        // node.
        for node in 0..nodes {
            memberships[node + 1] += memberships[node];
        }
        let mut fill = memberships.clone();
        let mut tails = vec![(0_usize, 0_usize); element_nodes.len()];
        for bounds in element_start.windows(2) {
            for at in bounds[0]..bounds[1] {
                let slot = &mut fill[element_nodes[at] as usize];
                tails[*slot] = (at, bounds[1]);
                *slot += 1;
            }
        }

        let mut column_start = Vec::with_capacity(nodes + 1);
        column_start.push(0);
        let mut rows = Vec::new();
        // Marks with the number of the column need no clearing between columns.
        let mut seen_by = vec![u32::MAX; nodes];
        for node in 0..nodes {
            let column = node as u32;
            let begin = rows.len();
            rows.push(column);
            seen_by[node] = column;
            // Nodes of an element are sorted and the range begins at this one, so only the lower triangle is
            // visited.
            for &(from, to) in &tails[memberships[node]..memberships[node + 1]] {
                for &row in &element_nodes[from..to] {
                    if seen_by[row as usize] != column {
                        seen_by[row as usize] = column;
                        rows.push(row);
                    }
                }
            }
            rows[begin..].sort_unstable();
            if rows.len() > MAX_ENTRIES {
                return Err(Error::input(format!(
                    "expected at most {MAX_ENTRIES} entries of the pattern, found more: use fewer nodes"
                )));
            }
            column_start.push(rows.len() as u32);
        }
        rows.shrink_to_fit();
        Ok(Self { column_start, rows })
    }

    /// The union of two patterns.
    ///
    /// # Errors
    /// `Input` when the numbers of nodes differ, or when the union is too large for 30-bit positions.
    pub fn union(&self, other: &Self) -> Result<Self> {
        if self.nodes() != other.nodes() {
            return Err(Error::input(format!(
                "cannot unite patterns over {} and {} nodes",
                self.nodes(),
                other.nodes()
            )));
        }
        let mut column_start = vec![0_u32];
        let mut rows = Vec::with_capacity(self.entries().max(other.entries()));
        for node in 0..self.nodes() {
            let begin = rows.len();
            rows.extend_from_slice(self.column(node));
            rows.extend_from_slice(other.column(node));
            rows[begin..].sort_unstable();
            let mut kept = begin;
            for at in begin..rows.len() {
                if at == begin || rows[at] != rows[kept - 1] {
                    rows[kept] = rows[at];
                    kept += 1;
                }
            }
            rows.truncate(kept);
            if rows.len() > MAX_ENTRIES {
                return Err(Error::input(format!(
                    "expected at most {MAX_ENTRIES} entries of the pattern, found more: use fewer nodes"
                )));
            }
            column_start.push(rows.len() as u32);
        }
        Ok(Self { column_start, rows })
    }

    /// Number of nodes.
    #[must_use]
    pub fn nodes(&self) -> usize {
        self.column_start.len() - 1
    }

    /// Number of stored entries: the lower triangle with the diagonal.
    #[must_use]
    pub fn entries(&self) -> usize {
        self.rows.len()
    }

    /// The rows `i ≥ node` of one column, ascending; the first is the node itself.
    #[must_use]
    pub fn column(&self, node: usize) -> &[u32] {
        &self.rows[self.column_range(node)]
    }

    /// The positions of one column's entries among all entries.
    #[must_use]
    pub fn column_range(&self, node: usize) -> std::ops::Range<usize> {
        self.column_start[node] as usize..self.column_start[node + 1] as usize
    }

    /// The position of the entry that couples nodes `i` and `j`, in either order; `None` when they are not
    /// coupled.
    ///
    /// Cost: a binary search in one column.
    #[must_use]
    pub fn position(&self, i: u32, j: u32) -> Option<usize> {
        let (row, column) = (i.max(j), i.min(j) as usize);
        if row as usize >= self.nodes() {
            return None;
        }
        let range = self.column_range(column);
        self.rows[range.clone()].binary_search(&row).ok().map(|at| range.start + at)
    }

    /// True if both patterns are equal; fast for the same object.
    pub(super) fn same(a: &std::sync::Arc<Self>, b: &std::sync::Arc<Self>) -> bool {
        std::sync::Arc::ptr_eq(a, b) || a == b
    }
}

/// The graph of a pattern: the neighbours of each node, without the node itself.
pub(super) struct Graph {
    start: Vec<usize>,
    neighbours: Vec<u32>,
}

impl Graph {
    /// The graph of a pattern with node `old` renamed `new_from_old[old]`. Neighbours come in no particular
    /// order.
    pub(super) fn renamed(pattern: &BlockPattern, new_from_old: impl Fn(u32) -> u32) -> Self {
        let nodes = pattern.nodes();
        let mut start = vec![0_usize; nodes + 1];
        for node in 0..nodes {
            let column = new_from_old(node as u32) as usize;
            let below = &pattern.column(node)[1..];
            start[column + 1] += below.len();
            for &row in below {
                start[new_from_old(row) as usize + 1] += 1;
            }
        }
        for node in 0..nodes {
            start[node + 1] += start[node];
        }
        let mut fill = start.clone();
        let mut neighbours = vec![0_u32; start[nodes]];
        for node in 0..nodes {
            let column = new_from_old(node as u32);
            for &row in &pattern.column(node)[1..] {
                let row = new_from_old(row);
                neighbours[fill[column as usize]] = row;
                fill[column as usize] += 1;
                neighbours[fill[row as usize]] = column;
                fill[row as usize] += 1;
            }
        }
        Self { start, neighbours }
    }

    pub(super) fn neighbours(&self, node: usize) -> &[u32] {
        &self.neighbours[self.start[node]..self.start[node + 1]]
    }
}
