//! Active functions of a hierarchy, and the traversal that finds leaves and their coefficients.
//!
//! Input: split cells. Output: numbered functions and nodes, and for every leaf its nodes with weights.

use super::{Cell, Hierarchy, NOT_A_LEAF, Shape, Topology, grid, quarter, support_cell};
use std::collections::HashMap;
use std::sync::OnceLock;

/// A hierarchy with numbered nodes but without leaves.
pub(super) struct Layout {
    pub(super) hierarchy: Hierarchy,
    /// For each level, by function: its number, or `NOT_A_LEAF` if it is not active.
    pub(super) active: Vec<Vec<u32>>,
    /// For each level, by function: true if its support consists of existing cells of that level.
    pub(super) inside: Vec<Vec<bool>>,
}

impl Hierarchy {
    /// A hierarchy with these split cells, without functions and leaves.
    pub(super) fn empty(topology: Topology, base: [usize; 2], mut split: Vec<Vec<bool>>) -> Self {
        // Exactly one level without split cells follows the last split one, so equal cells give equal
        // hierarchies.
        while split.len() > 1 && split.last().is_some_and(|level| level.iter().all(|&s| !s)) {
            split.pop();
        }
        if split[split.len() - 1].iter().any(|&s| s) {
            split.push(vec![false; grid(base, split.len()).iter().product()]);
        }
        Self {
            topology,
            base,
            leaf_number: split.iter().map(|level| vec![NOT_A_LEAF; level.len()]).collect(),
            leaves: Vec::new(),
            functions: Vec::new(),
            node_anchors: Vec::new(),
            offsets: vec![0],
            nodes: Vec::new(),
            weights: Vec::new(),
            sparse: OnceLock::new(),
            poles: Vec::new(),
            node_of_function: Vec::new(),
            split,
        }
    }
}

impl Layout {
    pub(super) fn new(shape: Shape, base: [usize; 2], split: Vec<Vec<bool>>) -> Self {
        let mut hierarchy = Hierarchy::empty(Topology::Grid(shape), base, split);
        let split = &hierarchy.split;
        let levels = split.len();
        // A cell exists if its parent is split.
        let exists: Vec<Vec<bool>> = (0..levels)
            .map(|level| {
                let [columns, rows] = grid(base, level);
                (0..columns * rows)
                    .map(|index| {
                        level == 0
                            || split[level - 1][(index / columns / 2) * (columns / 2) + (index % columns) / 2]
                    })
                    .collect()
            })
            .collect();
        let mut active: Vec<Vec<u32>> = Vec::with_capacity(levels);
        let mut inside: Vec<Vec<bool>> = Vec::with_capacity(levels);
        for level in 0..levels {
            let [columns, rows] = grid(base, level);
            let [fu, fv] = hierarchy.function_grid(level);
            let mut number = vec![NOT_A_LEAF; fu * fv];
            let mut in_level = vec![false; fu * fv];
            let supports = |count: usize, cells: usize, periodic: bool| -> Vec<Vec<usize>> {
                let cells_of = |f| (0..4).filter_map(move |d| support_cell(f, d, cells, periodic)).collect();
                (0..count).map(cells_of).collect()
            };
            let (across, along) =
                (supports(fu, columns, shape.periodic_u()), supports(fv, rows, shape.periodic_v()));
            for j in 0..fv {
                for i in 0..fu {
                    let mut cells =
                        along[j].iter().flat_map(|cj| across[i].iter().map(move |ci| cj * columns + ci));
                    if !cells.clone().all(|cell| exists[level][cell]) {
                        continue;
                    }
                    in_level[j * fu + i] = true;
                    // A function whose cells are all split is replaced by functions of the next level.
                    if !cells.all(|cell| hierarchy.split[level][cell]) {
                        number[j * fu + i] = hierarchy.functions.len() as u32;
                        hierarchy.functions.push(Cell { level: level as u8, i: i as u32, j: j as u32 });
                    }
                }
            }
            active.push(number);
            inside.push(in_level);
        }
        hierarchy.number_nodes(&exists);
        Self { hierarchy, active, inside }
    }
}

/// Leaves in the order of the traversal, each with its nodes and their weights.
#[derive(Default)]
pub(super) struct FoundLeaves {
    pub(super) cells: Vec<Cell>,
    pub(super) counts: Vec<u32>,
    pub(super) nodes: Vec<u32>,
    pub(super) weights: Vec<[f64; 16]>,
}

/// Traversal of the quadtree that collects the functions of each leaf and their coefficients.
pub(super) struct Walk<'a> {
    pub(super) layout: &'a Layout,
    pub(super) pole_of_function: &'a HashMap<u32, Vec<(u32, f64)>>,
    pub(super) found: FoundLeaves,
}

/// Functions with their sixteen coefficients on a cell.
type Coefficients = Vec<(u32, [f64; 16])>;

impl Walk<'_> {
    /// Descends from a cell. `list` holds functions of coarser levels with their coefficients on this cell,
    /// not yet truncated at this level.
    pub(super) fn descend(&mut self, cell: Cell, mut list: Coefficients) {
        let level = usize::from(cell.level);
        let hierarchy = &self.layout.hierarchy;
        let [fu, _] = hierarchy.function_grid(level);
        let mut own = [NOT_A_LEAF; 16];
        for k in 0..16 {
            let f = hierarchy.function_on_cell(cell, k);
            let index = f.j as usize * fu + f.i as usize;
            // Truncation: functions of this level, active or split further, take over this coefficient from
            // coarser ones. Without it the functions would not sum to one.
            if self.layout.inside[level][index] {
                for (_, w) in &mut list {
                    w[k] = 0.0;
                }
            }
            own[k] = self.layout.active[level][index];
        }
        // Truncation often removes a function completely; dropping it keeps lists short.
        list.retain(|(_, w)| w.iter().any(|&x| x != 0.0));
        for (k, &function) in own.iter().enumerate() {
            if function != NOT_A_LEAF {
                let mut w = [0.0; 16];
                w[k] = 1.0;
                list.push((function, w));
            }
        }
        let columns = grid(hierarchy.base, level)[0];
        if !hierarchy.split[level][cell.j as usize * columns + cell.i as usize] {
            self.found_leaf(cell, &list);
            return;
        }
        for half_v in 0..2 {
            for half_u in 0..2 {
                let child = Cell { level: cell.level + 1, i: 2 * cell.i + half_u, j: 2 * cell.j + half_v };
                let halves =
                    list.iter().map(|(f, w)| (*f, quarter(w, half_u as usize, half_v as usize))).collect();
                self.descend(child, halves);
            }
        }
    }

    /// Converts functions to nodes: a pole node collects the coefficients of many functions.
    fn found_leaf(&mut self, cell: Cell, list: &Coefficients) {
        let mut merged: Coefficients = Vec::with_capacity(list.len());
        let mut add = |node: u32, scale: f64, w: &[f64; 16]| {
            let at = merged.iter().position(|(n, _)| *n == node).unwrap_or_else(|| {
                merged.push((node, [0.0; 16]));
                merged.len() - 1
            });
            for k in 0..16 {
                merged[at].1[k] += scale * w[k];
            }
        };
        for (function, w) in list {
            if let Some(node) = self.layout.hierarchy.node_of_function[*function as usize] {
                add(node, 1.0, w);
            }
            for &(node, scale) in self.pole_of_function.get(function).map_or(&[][..], |e| &e[..]) {
                add(node, scale, w);
            }
        }
        merged.retain(|(_, w)| w.iter().any(|&x| x != 0.0));
        // Sorted, so that elements and their order of addition do not depend on the traversal.
        merged.sort_unstable_by_key(|(node, _)| *node);
        self.found.cells.push(cell);
        self.found.counts.push(merged.len() as u32);
        self.found.nodes.extend(merged.iter().map(|(node, _)| node));
        self.found.weights.extend(merged.iter().map(|(_, w)| w));
    }
}
