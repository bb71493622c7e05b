//! Active functions of a hierarchy, and the traversal that finds leaves and their coefficients.
//!
//! Input: split cells. Output: numbered functions and nodes, and for every leaf its nodes with weights.

use super::cell_tree::{CellTree, children};
use super::quads::NumberMap;
use super::{Cell, Hierarchy, Shape, Topology, grid, quarter, support_cell};
use std::collections::HashMap;
use std::sync::OnceLock;

/// A hierarchy with numbered nodes but without leaves.
pub(super) struct Layout {
    pub(super) hierarchy: Hierarchy,
    pub(super) functions: Functions,
}

/// The functions whose support consists of existing cells of their level, by level, row and column: the
/// number, or none if all these cells are split, so that functions of the next level replace it.
pub(super) type Functions = NumberMap<Cell, Option<u32>>;

impl Hierarchy {
    /// A hierarchy with these split cells, without functions and leaves.
    pub(super) fn empty(topology: Topology, base: [usize; 2], cells: CellTree) -> Self {
        Self {
            topology,
            base,
            cells,
            leaves: Vec::new(),
            functions: Vec::new(),
            node_anchors: Vec::new(),
            offsets: vec![0],
            nodes: Vec::new(),
            weights: Vec::new(),
            sparse: OnceLock::new(),
            poles: Vec::new(),
            node_of_function: Vec::new(),
        }
    }
}

impl Layout {
    pub(super) fn new(shape: Shape, base: [usize; 2], split: CellTree) -> Self {
        let mut hierarchy = Hierarchy::empty(Topology::Grid(shape), base, split);
        let mut functions = Functions::default();
        for level in 0..hierarchy.cells.levels() {
            let [columns, rows] = grid(base, level);
            let cells = hierarchy.cells.cells(level).into_iter();
            // Each function belongs to the first cell of its support, so each is found once.
            let mut candidates: Vec<[u32; 2]> = cells
                .flat_map(|cell| {
                    let across = first_on(cell.i, columns, shape.periodic_u());
                    let along = first_on(cell.j, rows, shape.periodic_v());
                    along.flat_map(move |j| across.clone().map(move |i| [j, i]))
                })
                .collect();
            candidates.sort_unstable();
            for [j, i] in candidates {
                let function = Cell { level: level as u8, i, j };
                let cells_of = |f: u32, cells: usize, periodic: bool| {
                    (0..4).filter_map(move |d| support_cell(f as usize, d, cells, periodic))
                };
                let support = || {
                    cells_of(j, rows, shape.periodic_v()).flat_map(|j| {
                        let row = cells_of(i, columns, shape.periodic_u());
                        row.map(move |i| Cell { i: i as u32, j: j as u32, ..function })
                    })
                };
                if !support().all(|cell| hierarchy.cells.contains(cell)) {
                    continue;
                }
                let is_active = !support().all(|cell| hierarchy.cells.is_split(cell));
                let number = is_active.then_some(hierarchy.functions.len() as u32);
                functions.insert(function, number);
                hierarchy.functions.extend(is_active.then_some(function));
            }
        }
        hierarchy.number_nodes();
        Self { hierarchy, functions }
    }
}

/// The functions of one direction whose support begins with a cell.
fn first_on(cell: u32, cells: usize, periodic: bool) -> std::ops::RangeInclusive<u32> {
    match cell {
        _ if periodic => {
            let function = (cell + 3) % cells as u32;
            function..=function
        }
        0 => 0..=3,
        _ => cell + 3..=cell + 3,
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
        let hierarchy = &self.layout.hierarchy;
        let mut own = [None; 16];
        for k in 0..16 {
            // Truncation: functions of this level, active or split further, take over this coefficient from
            // coarser ones. Without it the functions would not sum to one.
            if let Some(&active) = self.layout.functions.get(&hierarchy.function_on_cell(cell, k)) {
                for (_, w) in &mut list {
                    w[k] = 0.0;
                }
                own[k] = active;
            }
        }
        // Truncation often removes a function completely; dropping it keeps lists short.
        list.retain(|(_, w)| w.iter().any(|&x| x != 0.0));
        for (k, function) in own.into_iter().enumerate() {
            if let Some(function) = function {
                let mut w = [0.0; 16];
                w[k] = 1.0;
                list.push((function, w));
            }
        }
        if !hierarchy.cells.is_split(cell) {
            self.found_leaf(cell, &list);
            return;
        }
        for child in children(cell) {
            let [half_u, half_v] = [child.i, child.j].map(|x| x as usize % 2);
            let halves = list.iter().map(|(f, w)| (*f, quarter(w, half_u, half_v))).collect();
            self.descend(child, halves);
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
