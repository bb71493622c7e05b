//! Symbolic analysis of a factorisation.
//!
//! Input: a pattern, an ordering and the unknowns per node. Output: supernodes (groups of columns with the
//! same rows), their tree, and the target positions of all entries and updates. The analysis is done once per
//! pattern and reused for every factorisation. Not guaranteed: that stored entries are nonzero. Supernodes
//! are merged if a few stored zeros make the dense kernels faster.

mod supernodes;

use std::sync::Arc;

use super::pattern::Graph;
use super::{BlockPattern, NodeOrdering};
use crate::{Error, Result};
use supernodes::{elimination_tree, relaxed_supernodes};

pub(super) const NONE: u32 = u32::MAX;

/// Position of a block of the information in the values of the factor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slot {
    /// Index of the block's first entry.
    pub offset: usize,
    /// Distance between columns.
    pub stride: usize,
}

/// The slot of one entry of the pattern.
#[derive(Debug, Clone, Copy)]
pub(super) struct EntrySlot {
    /// Index of the block's first entry.
    pub offset: usize,
    /// Distance between columns.
    stride: u32,
    /// Position in the pattern, with [`TRANSPOSED`].
    entry: u32,
}

const TRANSPOSED: u32 = 1 << 31;

impl EntrySlot {
    pub(super) fn stride(self) -> usize {
        self.stride as usize
    }

    /// Position in the pattern.
    pub(super) fn entry(self) -> usize {
        (self.entry & !TRANSPOSED) as usize
    }

    /// Whether the stored block of the information is transposed in the factor.
    pub(super) fn transposed(self) -> bool {
        self.entry & TRANSPOSED != 0
    }
}

/// A run of rows of a supernode that are contiguous in the front of its parent, counted in unknowns.
#[derive(Debug, Clone, Copy)]
pub(super) struct Run {
    /// First row, counted in the rows of the supernode.
    pub from: u32,
    /// Its position in the front of the parent: first the columns of the parent, then its rows.
    pub to: u32,
    pub length: u32,
}

impl Run {
    /// Splits the run into the part in the columns of the parent and the part in its rows, each as (from, to,
    /// length). `to` counts from the first column or row.
    pub(super) fn split(self, columns: usize) -> [(usize, usize, usize); 2] {
        let (from, to, length) = (self.from as usize, self.to as usize, self.length as usize);
        // A run may begin in the columns of the parent and end in its rows, because both are contiguous in
        // the front.
        let own = columns.saturating_sub(to).min(length);
        [(from, to.min(columns - own), own), (from + own, (to + own).saturating_sub(columns), length - own)]
    }
}

/// The symbolic analysis of a Cholesky factorisation `P Λ Pᵀ = L Lᵀ`, in blocks of `b` unknowns per node.
///
/// The permutation is the given ordering, postordered along the elimination tree.
///
/// # References
/// Liu, *The role of elimination trees in sparse factorization*, 1990; Ashcraft and Grimes, *The influence of
/// relaxed supernode partitions on the multifrontal method*, 1989.
pub struct SymbolicFactor {
    pattern: Arc<BlockPattern>,
    block: usize,
    pub(super) old_from_new: Vec<u32>,
    pub(super) new_from_old: Vec<u32>,
    /// First column (node, new numbering) of each supernode, and the end.
    pub(super) supernode_start: Vec<u32>,
    pub(super) supernode_of: Vec<u32>,
    row_start: Vec<usize>,
    /// Rows (nodes, new numbering) below the diagonal block of each supernode, ascending.
    rows: Vec<u32>,
    run_start: Vec<usize>,
    runs: Vec<Run>,
    pub(super) parent: Vec<u32>,
    child_start: Vec<usize>,
    children: Vec<u32>,
    roots: Vec<u32>,
    /// First supernode of the subtree that ends in each supernode.
    first_below: Vec<u32>,
    /// Operations of a factorisation in the subtree that ends in each supernode.
    tree_flops: Vec<f64>,
    /// Start of the values of each supernode: a column-major panel of (columns + rows)·b by columns·b.
    pub(super) value_start: Vec<usize>,
    /// The slots of all entries, by supernode.
    slots: Vec<EntrySlot>,
    slot_start: Vec<usize>,
}

impl SymbolicFactor {
    /// Analyses a pattern for elimination in the given order, with `block` unknowns per node.
    ///
    /// Cost: O(entries of the factor over nodes), independent of the unknowns per node.
    ///
    /// # Errors
    /// `Input` when the ordering belongs to another number of nodes, or when `block` is zero.
    pub fn analyse(pattern: &Arc<BlockPattern>, ordering: &NodeOrdering, block: usize) -> Result<Self> {
        let nodes = pattern.nodes();
        if ordering.old_from_new().len() != nodes || block == 0 {
            return Err(Error::input(format!(
                "an ordering of {} nodes with {block} unknowns each does not match a pattern of \
                 {nodes} nodes",
                ordering.old_from_new().len()
            )));
        }
        let given = ordering.old_from_new();
        let given_from_old = inverse(given);
        let graph = Graph::renamed(pattern, |node| given_from_old[node as usize]);
        // The tree needs the given order. Supernodes renumber the nodes, so the graph is built again below.
        // Without this renumbering, the columns of a supernode would not be contiguous and could not be one
        // dense panel.
        let (tree, counts) = elimination_tree(&graph, nodes);
        let groups = relaxed_supernodes(&tree, &counts, block);

        let old_from_new: Vec<u32> = groups.order.iter().map(|&node| given[node as usize]).collect();
        let new_from_old = inverse(&old_from_new);
        let graph = Graph::renamed(pattern, |node| new_from_old[node as usize]);
        let mut symbolic = Self {
            pattern: Arc::clone(pattern),
            block,
            old_from_new,
            new_from_old,
            supernode_of: vec![0; nodes],
            supernode_start: groups.start,
            row_start: vec![0],
            rows: Vec::new(),
            run_start: vec![0],
            runs: Vec::new(),
            parent: groups.parent,
            child_start: Vec::new(),
            children: Vec::new(),
            roots: Vec::new(),
            first_below: Vec::new(),
            tree_flops: Vec::new(),
            value_start: vec![0],
            slots: Vec::new(),
            slot_start: Vec::new(),
        };
        symbolic.link_children();
        symbolic.find_rows(&graph);
        symbolic.measure_trees();
        symbolic.find_runs();
        symbolic.find_slots();
        Ok(symbolic)
    }

    fn link_children(&mut self) {
        let supernodes = self.parent.len();
        let mut start = vec![0_usize; supernodes + 1];
        for &parent in self.parent.iter().filter(|&&parent| parent != NONE) {
            start[parent as usize + 1] += 1;
        }
        for s in 0..supernodes {
            start[s + 1] += start[s];
        }
        // A counting sort: linear, and stable, so that children are in ascending order.
        let mut fill = start.clone();
        self.children = vec![0; start[supernodes]];
        for (s, &parent) in self.parent.iter().enumerate() {
            if parent != NONE {
                self.children[fill[parent as usize]] = s as u32;
                fill[parent as usize] += 1;
            }
        }
        self.child_start = start;
        self.roots = (0..supernodes as u32).filter(|&s| self.parent[s as usize] == NONE).collect();
        self.first_below = (0..supernodes as u32).collect();
        for s in 0..supernodes {
            if let Some(&first) = self.children(s).first() {
                self.first_below[s] = self.first_below[first as usize];
            }
        }
    }

    fn measure_trees(&mut self) {
        for s in 0..self.supernodes() {
            let below: f64 = self.children(s).iter().map(|&c| self.tree_flops[c as usize]).sum();
            self.tree_flops.push(below + self.flops_of(s));
        }
    }

    /// Finds the rows of each supernode: the rows of its columns in the matrix, and those of its children
    /// below its columns.
    fn find_rows(&mut self, graph: &Graph) {
        let mut seen_by = vec![NONE; self.old_from_new.len()];
        // Supernodes are in postorder, so the sums of all children are complete.
        for s in 0..self.supernodes() {
            let (begin, end) = (self.supernode_start[s], self.supernode_start[s + 1]);
            self.supernode_of[begin as usize..end as usize].fill(s as u32);
            let first = self.rows.len();
            // Rows above the end of the supernode belong to its own columns.
            let mut keep = |rows: &mut Vec<u32>, row: u32| {
                if row >= end && seen_by[row as usize] != s as u32 {
                    seen_by[row as usize] = s as u32;
                    rows.push(row);
                }
            };
            for column in begin..end {
                for &row in graph.neighbours(column as usize) {
                    keep(&mut self.rows, row);
                }
            }
            // Children come before their parents in the order, so their rows are complete. Fill of deeper
            // descendants has already passed through them.
            for child in self.child_start[s]..self.child_start[s + 1] {
                let child = self.children[child] as usize;
                for at in self.row_start[child]..self.row_start[child + 1] {
                    let row = self.rows[at];
                    keep(&mut self.rows, row);
                }
            }
            self.rows[first..].sort_unstable();
            self.row_start.push(self.rows.len());
            let columns = (end - begin) as usize * self.block;
            // Diagonal block and rows are one panel with one stride, so that a factorisation handles both
            // with the same dense kernels.
            let height = columns + (self.rows.len() - first) * self.block;
            self.value_start.push(self.value_start[s] + height * columns);
        }
        self.rows.shrink_to_fit();
    }

    fn find_runs(&mut self) {
        let b = self.block as u32;
        for s in 0..self.supernodes() {
            if self.parent[s] != NONE {
                let parent = self.parent[s] as usize;
                let (begin, end) = (self.supernode_start[parent], self.supernode_start[parent + 1]);
                let first = self.runs.len();
                // Rows of child and parent are ascending, and every row of the child occurs in the front of
                // the parent. One pass over both finds all positions.
                let mut at = self.row_start[parent];
                for (from, &row) in (0..).zip(&self.rows[self.row_start[s]..self.row_start[s + 1]]) {
                    let to = if row < end {
                        row - begin
                    } else {
                        while self.rows[at] != row {
                            at += 1;
                        }
                        (at - self.row_start[parent]) as u32 + end - begin
                    };
                    match self.runs[first..].last_mut() {
                        // Contiguous rows are merged to one run, which is copied or added at once. Most rows
                        // are in few runs, because the front of the parent contains almost the same nodes.
                        Some(run) if run.to + run.length == to * b => run.length += b,
                        _ => self.runs.push(Run { from: from * b, to: to * b, length: b }),
                    }
                }
            }
            self.run_start.push(self.runs.len());
        }
    }

    /// Finds the target of each entry of the pattern once, so that a factorisation needs no search. Sorted by
    /// supernode, each thread finds its own entries in one range.
    fn find_slots(&mut self) {
        let mut start = vec![0_usize; self.supernodes() + 1];
        let column_of =
            |node: u32, row: u32| self.new_from_old[node as usize].min(self.new_from_old[row as usize]);
        for node in 0..self.pattern.nodes() {
            for &row in self.pattern.column(node) {
                start[self.supernode_of[column_of(node as u32, row) as usize] as usize + 1] += 1;
            }
        }
        for s in 0..self.supernodes() {
            start[s + 1] += start[s];
        }
        let mut fill = start.clone();
        let mut slots = vec![EntrySlot { offset: 0, stride: 0, entry: 0 }; self.pattern.entries()];
        for node in 0..self.pattern.nodes() {
            let j = self.new_from_old[node];
            for (entry, &row) in self.pattern.column_range(node).zip(self.pattern.column(node)) {
                let i = self.new_from_old[row as usize];
                let Some(slot) = self.locate(i.max(j), i.min(j)) else {
                    // The factor contains the pattern; fill only adds entries.
                    unreachable!("the factor holds every entry of the pattern")
                };
                let place = &mut fill[self.supernode_of[i.min(j) as usize] as usize];
                let flag = if i < j { TRANSPOSED } else { 0 };
                slots[*place] =
                    EntrySlot { offset: slot.offset, stride: slot.stride as u32, entry: entry as u32 | flag };
                *place += 1;
            }
        }
        (self.slots, self.slot_start) = (slots, start);
    }

    /// Position of the block in row `i` and column `j ≤ i` (new numbering), if it is in the factor.
    pub(super) fn locate(&self, i: u32, j: u32) -> Option<Slot> {
        let s = self.supernode_of[j as usize] as usize;
        let (begin, end) = (self.supernode_start[s], self.supernode_start[s + 1]);
        let rows = self.rows(s);
        let place = if i < end {
            (i - begin) as usize
        } else {
            (end - begin) as usize + rows.binary_search(&i).ok()?
        };
        let stride = ((end - begin) as usize + rows.len()) * self.block;
        Some(Slot {
            offset: self.value_start[s] + (j - begin) as usize * self.block * stride + place * self.block,
            stride,
        })
    }

    /// The pattern that was analysed.
    #[must_use]
    pub fn pattern(&self) -> &Arc<BlockPattern> {
        &self.pattern
    }

    /// Number of unknowns per node.
    #[must_use]
    pub fn block_size(&self) -> usize {
        self.block
    }

    /// Number of unknowns: nodes times block size.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.old_from_new.len() * self.block
    }

    /// Number of supernodes.
    #[must_use]
    pub fn supernodes(&self) -> usize {
        self.parent.len()
    }

    /// The nodes in elimination order: the given ordering, postordered.
    #[must_use]
    pub fn old_from_new(&self) -> &[u32] {
        &self.old_from_new
    }

    /// Number of stored values of a factor, including zeros of merged supernodes and upper triangles.
    #[must_use]
    pub fn stored_values(&self) -> usize {
        self.value_start[self.supernodes()]
    }

    /// Number of entries of the lower triangle of `L`, including zeros of merged supernodes.
    #[must_use]
    pub fn factor_entries(&self) -> usize {
        (0..self.supernodes())
            .map(|s| self.columns(s) * (self.columns(s) + 1) / 2 + self.columns(s) * self.height(s))
            .sum()
    }

    /// Number of multiplications and additions of one factorisation.
    #[must_use]
    pub fn flops(&self) -> f64 {
        (0..self.supernodes()).map(|s| self.flops_of(s)).sum()
    }

    fn flops_of(&self, s: usize) -> f64 {
        let (c, r) = (self.columns(s) as f64, self.height(s) as f64);
        // Factor of the diagonal block, solution of the rows below, update of the parent.
        c * c * c / 3.0 + c * c * r + c * r * r
    }

    /// The supernodes without parents.
    pub(super) fn roots(&self) -> &[u32] {
        &self.roots
    }

    /// First supernode of the subtree that ends in `s`. The subtree is the range from there to `s`.
    pub(super) fn first_below(&self, s: usize) -> usize {
        self.first_below[s] as usize
    }

    /// Operations of a factorisation in the subtree that ends in `s`.
    pub(super) fn tree_flops(&self, s: usize) -> f64 {
        self.tree_flops[s]
    }

    /// Number of stored values of the factor in the subtree that ends in `s`.
    pub(super) fn tree_values(&self, s: usize) -> usize {
        self.value_start[s + 1] - self.value_start[self.first_below(s)]
    }

    /// Number of unknowns that a supernode eliminates.
    pub(super) fn columns(&self, s: usize) -> usize {
        (self.supernode_start[s + 1] - self.supernode_start[s]) as usize * self.block
    }

    /// Number of unknowns below the diagonal block of a supernode.
    pub(super) fn height(&self, s: usize) -> usize {
        (self.row_start[s + 1] - self.row_start[s]) * self.block
    }

    /// Nodes below the diagonal block of a supernode, new numbering.
    pub(super) fn rows(&self, s: usize) -> &[u32] {
        &self.rows[self.row_start[s]..self.row_start[s + 1]]
    }

    /// The rows of a supernode as runs in the front of its parent.
    pub(super) fn runs(&self, s: usize) -> &[Run] {
        &self.runs[self.run_start[s]..self.run_start[s + 1]]
    }

    /// The entries of the pattern that lie in the panel of a supernode.
    pub(super) fn slots(&self, s: usize) -> &[EntrySlot] {
        &self.slots[self.slot_start[s]..self.slot_start[s + 1]]
    }

    /// The slots of all entries of the pattern.
    pub(super) fn all_slots(&self) -> &[EntrySlot] {
        &self.slots
    }

    pub(super) fn children(&self, s: usize) -> &[u32] {
        &self.children[self.child_start[s]..self.child_start[s + 1]]
    }
}

impl std::fmt::Debug for SymbolicFactor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SymbolicFactor")
            .field("nodes", &self.old_from_new.len())
            .field("block", &self.block)
            .field("supernodes", &self.supernodes())
            .field("factor_entries", &self.factor_entries())
            .finish_non_exhaustive()
    }
}

fn inverse(permutation: &[u32]) -> Vec<u32> {
    let mut inverse = vec![0; permutation.len()];
    for (new, &old) in permutation.iter().enumerate() {
        inverse[old as usize] = new as u32;
    }
    inverse
}
