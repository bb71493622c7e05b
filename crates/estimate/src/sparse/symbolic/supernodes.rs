//! Elimination tree and supernodes.
//!
//! Input: a graph of nodes in elimination order. Output: the parent of each column, and groups of columns
//! with (nearly) the same rows, in an order in which every subtree is contiguous.

use super::NONE;
use crate::sparse::pattern::Graph;

/// Merge a child into its parent if the merged supernode has at most this many columns (unknowns) and at most
/// this fraction of stored zeros.
///
/// The optimum is flat: half or twice the numbers of columns cost at most 15 % of the time of the
/// factorisation on bicubic grids (200 × 200 with b = 1, 64 × 64 with b = 3). Other fractions cost less.
const MERGE_COLUMNS_AND_ZEROS: [(usize, f64); 3] = [(32, 0.6), (128, 0.2), (usize::MAX, 0.05)];

/// The parent of each column, and the entries of each column of the factor with its diagonal.
pub(super) fn elimination_tree(graph: &Graph, nodes: usize) -> (Vec<u32>, Vec<u32>) {
    let mut parent = vec![NONE; nodes];
    let mut ancestor = vec![NONE; nodes];
    for row in 0..nodes as u32 {
        for &column in graph.neighbours(row as usize).iter().filter(|&&column| column < row) {
            // Climb from each entry to the root found so far. `ancestor` skips paths that were climbed before
            // (path compression); without it, long chains take quadratic time.
            let mut at = column;
            while at != row {
                let next = std::mem::replace(&mut ancestor[at as usize], row);
                if next == NONE {
                    parent[at as usize] = row;
                    break;
                }
                at = next;
            }
        }
    }
    // Row i of the factor is the part of the tree on the paths from the entries of row i in the matrix to i.
    let mut counts = vec![1_u32; nodes];
    let mut seen_by = vec![NONE; nodes];
    for row in 0..nodes as u32 {
        seen_by[row as usize] = row;
        for &column in graph.neighbours(row as usize).iter().filter(|&&column| column < row) {
            let mut at = column;
            while seen_by[at as usize] != row {
                seen_by[at as usize] = row;
                counts[at as usize] += 1;
                at = parent[at as usize];
            }
        }
    }
    (parent, counts)
}

/// Supernodes with their tree.
pub(super) struct Groups {
    /// The columns in their final order.
    pub order: Vec<u32>,
    /// First column of each supernode, and the end.
    pub start: Vec<u32>,
    /// Parent of each supernode, or [`NONE`].
    pub parent: Vec<u32>,
}

/// Groups columns into supernodes, merges small ones into their parents, and orders them along the tree.
pub(super) fn relaxed_supernodes(parent: &[u32], counts: &[u32], block: usize) -> Groups {
    let nodes = parent.len();
    let order = postorder(parent);
    // Fundamental supernodes: runs of the postorder in which each column is the parent of the previous one
    // and has the same rows.
    let mut group_of = vec![0_u32; nodes];
    let mut top = Vec::new();
    for (k, &node) in order.iter().enumerate() {
        // A column of the factor contains the rows of its children below it. A count smaller by one therefore
        // means equal rows, and no rows need to be compared.
        let joins = k > 0 && {
            let before = order[k - 1] as usize;
            parent[before] == node && counts[before] == counts[node as usize] + 1
        };
        if joins {
            top.pop();
        }
        group_of[node as usize] = top.len() as u32;
        top.push(node);
    }
    let groups = top.len();
    let mut columns = vec![0_usize; groups];
    for &group in &group_of {
        columns[group as usize] += 1;
    }
    let rows: Vec<usize> = top.iter().map(|&node| counts[node as usize] as usize - 1).collect();
    let mut group_parent: Vec<u32> = top
        .iter()
        .map(|&node| match parent[node as usize] {
            NONE => NONE,
            above => group_of[above as usize],
        })
        .collect();
    let mut entries: Vec<usize> = (0..groups).map(|g| trapezoid(columns[g], rows[g])).collect();

    let mut children: Vec<Vec<u32>> = vec![Vec::new(); groups];
    for g in 0..groups {
        if group_parent[g] != NONE {
            children[group_parent[g] as usize].push(g as u32);
        }
    }
    let mut merged_into: Vec<u32> = (0..groups as u32).collect();
    for g in 0..groups {
        // Greedy: the child that adds the fewest zeros first. Larger panels are faster in dense kernels,
        // which pays for some zeros.
        loop {
            let zeros_with = |child: usize| {
                let merged = trapezoid(columns[g] + columns[child], rows[g]);
                (merged - entries[g] - entries[child], merged)
            };
            let best = children[g].iter().enumerate().min_by_key(|&(_, &child)| zeros_with(child as usize).0);
            let Some((at, &child)) = best else { break };
            let child = child as usize;
            let (zeros, merged) = zeros_with(child);
            let width = (columns[g] + columns[child]) * block;
            let fits = MERGE_COLUMNS_AND_ZEROS
                .iter()
                .any(|&(max_columns, part)| width <= max_columns && zeros as f64 <= part * merged as f64);
            if !fits {
                break;
            }
            columns[g] += columns[child];
            entries[g] += entries[child];
            merged_into[child] = g as u32;
            children[g].swap_remove(at);
            // Grandchildren become candidates of the enlarged supernode.
            let grandchildren = std::mem::take(&mut children[child]);
            for &grandchild in &grandchildren {
                group_parent[grandchild as usize] = g as u32;
            }
            children[g].extend(grandchildren);
        }
    }

    ordered_groups(&order, &group_of, &group_parent, merged_into)
}

/// Numbers the groups that remain after merging: supernodes along their tree, columns within a supernode in
/// postorder.
fn ordered_groups(
    order: &[u32],
    group_of: &[u32],
    group_parent: &[u32],
    mut merged_into: Vec<u32>,
) -> Groups {
    let (nodes, groups) = (order.len(), merged_into.len());
    // Parents have higher numbers, so going down resolves chains of merges in one pass.
    for g in (0..groups).rev() {
        merged_into[g] = merged_into[merged_into[g] as usize];
    }
    let mut members: Vec<Vec<u32>> = vec![Vec::new(); groups];
    for &node in order {
        members[merged_into[group_of[node as usize] as usize] as usize].push(node);
    }
    let mut final_of = vec![NONE; groups];
    let (mut final_order, mut start, mut survivors) = (Vec::with_capacity(nodes), vec![0_u32], Vec::new());
    let tree: Vec<u32> = (0..groups)
        .map(|g| if merged_into[g] == g as u32 { group_parent[g] } else { merged_into[g] })
        .collect();
    for g in postorder(&tree) {
        if merged_into[g as usize] == g {
            final_of[g as usize] = survivors.len() as u32;
            survivors.push(g);
            final_order.append(&mut members[g as usize]);
            start.push(final_order.len() as u32);
        }
    }
    let parent = survivors
        .iter()
        .map(|&g| match group_parent[g as usize] {
            NONE => NONE,
            above => final_of[merged_into[above as usize] as usize],
        })
        .collect();
    Groups { order: final_order, start, parent }
}

/// Number of entries of a supernode: a triangle of its columns above a rectangle of its rows.
fn trapezoid(columns: usize, rows: usize) -> usize {
    columns * (columns + 1) / 2 + columns * rows
}

/// Postorder: children before parents, each subtree contiguous, siblings in the order of their numbers.
fn postorder(parent: &[u32]) -> Vec<u32> {
    let count = parent.len();
    let (mut first_child, mut next_sibling) = (vec![NONE; count], vec![NONE; count]);
    let mut stack = Vec::new();
    for node in (0..count).rev() {
        match parent[node] {
            NONE => stack.push(node as u32),
            above => {
                next_sibling[node] = first_child[above as usize];
                first_child[above as usize] = node as u32;
            }
        }
    }
    let mut order = Vec::with_capacity(count);
    while let Some(&node) = stack.last() {
        let child = first_child[node as usize];
        if child == NONE {
            order.push(node);
            stack.pop();
        } else {
            first_child[node as usize] = next_sibling[child as usize];
            stack.push(child);
        }
    }
    order
}
