//! Truncated hierarchical bicubic B-splines over a quadtree of dyadic levels.
//!
//! Input: a topology, a base grid, and the split cells. Output: numbered basis functions (*nodes*, each with
//! one control vertex) and, for every leaf cell, the *extraction*: the weights of the nodes in the sixteen
//! B-spline coefficients of that cell. Evaluation, observations, energies and export use only these sixteen
//! coefficients, so they do not depend on the hierarchy.
//!
//! The base grid has unit cells: `u ∈ [0, base[0]]`, `v ∈ [0, base[1]]`; a cell of level `l` has side `2^−l`.
//!
//! Not guaranteed: a history. Two hierarchies with the same cells are equal, however they were refined.
//!
//! # References
//! Giannelli, Jüttler, Speleers, *THB-splines: the truncated basis for hierarchical splines*, CAGD 2012.
//! Toshniwal, Speleers, Hiemstra, Hughes, *Multi-degree smooth polar splines*, CMAME 2017 (poles).

mod cell_tree;
mod extraction;
mod grading;
mod layout;
mod places;
mod poles;
mod quads;
mod shape;
mod unknowns;

use crate::basis::cubic_half;
use cell_tree::CellTree;
use extraction::SparseExtraction;
use grading::close;
use layout::{FoundLeaves, Layout, Walk};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use poles::{POLE_ANGLES, PoleMap};
use quads::OverQuads;
use rayon::prelude::*;
pub use shape::Shape;
use std::collections::HashMap;
use std::sync::{Arc, OnceLock};
pub(crate) use unknowns::CreaseNode;

/// A knot square: level and integer position in the grid of that level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Cell {
    /// 0 for the base grid; each level halves the side.
    pub level: u8,
    /// Column, along u.
    pub i: u32,
    /// Row, along v.
    pub j: u32,
}

impl Cell {
    /// Side of the cell in base-grid units.
    #[inline]
    #[must_use]
    pub fn side(self) -> f64 {
        1.0 / (1_u64 << self.level) as f64
    }

    /// The cell of which this is a quarter; none for a cell of the base grid.
    fn parent(self) -> Option<Self> {
        Some(Self { level: self.level.checked_sub(1)?, i: self.i / 2, j: self.j / 2 })
    }
}

/// Maximum level. With base grids of at most 2^14 cells, or 2^17 quads, cell numbers of one direction stay
/// below 2^29.
pub const MAX_LEVEL: usize = 12;

/// How the cells of the base are joined.
#[derive(Debug, Clone)]
enum Topology {
    /// A grid.
    Grid(Shape),
    /// A mesh of quads in one row, each joined to others by any of its sides.
    Quads(OverQuads),
}

/// The quadtree, its basis functions and their extraction on every leaf cell.
#[derive(Debug, Clone)]
pub struct Hierarchy {
    topology: Topology,
    base: [usize; 2],
    cells: CellTree,
    leaves: Vec<Cell>,
    /// Level, column and row of each function of the tube (before poles are extracted).
    functions: Vec<Cell>,
    node_anchors: Vec<[f64; 2]>,
    offsets: Vec<u32>,
    nodes: Vec<u32>,
    weights: Vec<[f64; 16]>,
    sparse: OnceLock<SparseExtraction>,
    poles: Vec<PoleMap>,
    /// Node of each tube function; `None` if the function is replaced by pole nodes.
    node_of_function: Vec<Option<u32>>,
}

impl Hierarchy {
    /// The unrefined hierarchy over a base grid of `base[0] × base[1]` cells.
    ///
    /// # Errors
    /// `Input` when a periodic direction has fewer than 4 cells, a ball has fewer than 4 rows, or another
    /// direction has no cell.
    pub fn uniform(shape: Shape, base: [usize; 2]) -> Result<Self> {
        // In a periodic direction of fewer than four cells a cubic would overlap itself. A ball needs two
        // rings of functions at each pole and a third one beyond them.
        let minimum =
            [if shape.periodic_u() { 4 } else { 1 }, if shape.periodic_v() || shape.polar() { 4 } else { 1 }];
        for d in 0..2 {
            if base[d] < minimum[d] {
                return Err(Error::input(format!(
                    "a {} needs a base grid of at least {} × {} cells, found {} × {}",
                    shape.name(),
                    minimum[0],
                    minimum[1],
                    base[0],
                    base[1]
                )));
            }
            // With the maximum level, indices of cells still fit 32 bits.
            if base[d] > 1 << 14 {
                return Err(Error::input(format!(
                    "a base grid of {} × {} cells is too large",
                    base[0], base[1]
                )));
            }
        }
        Ok(Self::build(shape, base, CellTree::new(base)))
    }

    /// The hierarchy whose leaves are exactly the given cells.
    ///
    /// # Errors
    /// `Input` when the cells do not tile the domain exactly once, or a pole is not split all around.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{Hierarchy, Shape};
    ///
    /// let refined = Hierarchy::uniform(Shape::Tube, [6, 4])?.refine(&[7, 8, 13, 14]);
    /// let rebuilt = Hierarchy::from_leaves(Shape::Tube, [6, 4], refined.leaves())?;
    /// assert_eq!(rebuilt.leaves(), refined.leaves());
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    pub fn from_leaves(shape: Shape, base: [usize; 2], leaves: &[Cell]) -> Result<Self> {
        let mut split = Self::uniform(shape, base)?.cells;
        for &cell in leaves {
            if usize::from(cell.level) > MAX_LEVEL || !split.is_inside(cell) {
                return Err(Error::input(format!("cell {cell:?} lies outside the base grid {base:?}")));
            }
            // A leaf requires that all its ancestors are split, and only these.
            if let Some(parent) = cell.parent() {
                split.split(parent);
            }
        }
        // The given cells must satisfy grading already. If `close` had to split more, the leaves would not be
        // those given.
        let before = split.split_count();
        close(shape, base, &mut split);
        if before != split.split_count() {
            return Err(Error::input("the cells break the grading rule of the hierarchy"));
        }
        let built = Self::build(shape, base, split);
        let mut wanted = leaves.to_vec();
        wanted.sort_unstable();
        let mut have = built.leaves.clone();
        have.sort_unstable();
        if wanted != have {
            return Err(Error::input("the cells do not tile the parameter domain exactly once"));
        }
        Ok(built)
    }

    /// Splits the marked leaves, and others that nestedness and grading require: neighbouring leaves differ
    /// by at most one level, and poles are split all around.
    ///
    /// Splitting a single cell activates no bicubic function. Mark whole supports (see
    /// [`Hierarchy::support_leaves`]).
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{Hierarchy, Shape};
    ///
    /// let coarse = Hierarchy::uniform(Shape::Sheet, [6, 6])?;
    /// let support = coarse.support_leaves()[40].iter().map(|&leaf| leaf as usize).collect::<Vec<_>>();
    /// let fine = coarse.refine(&support);
    /// assert_eq!(fine.levels(), 2);
    /// assert_eq!(fine.leaves().len(), 36 + 3 * support.len());
    /// fine.sanity_check()?;
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn refine(&self, marked: &[usize]) -> Self {
        self.with_split(self.split_with(marked))
    }

    /// Number of nodes that [`Hierarchy::refine`] would produce, at a fraction of its cost.
    #[must_use]
    pub fn refined_node_count(&self, marked: &[usize]) -> usize {
        match &self.topology {
            Topology::Grid(shape) => {
                Layout::new(*shape, self.base, self.split_with(marked)).hierarchy.node_count()
            }
            Topology::Quads(over) => {
                Self::numbered_over(&over.domain, self.split_with(marked)).0.node_count()
            }
        }
    }

    /// The split cells after splitting the marked leaves.
    fn split_with(&self, marked: &[usize]) -> CellTree {
        let mut split = self.cells.clone();
        for &leaf in marked {
            let cell = self.cell_of_leaf(leaf);
            // Not an error: refinement by a criterion marks the same cell again in every round.
            if usize::from(cell.level) < self.max_cell_level() {
                split.split(cell);
            }
        }
        match &self.topology {
            Topology::Grid(shape) => close(*shape, self.base, &mut split),
            Topology::Quads(over) => quads::close(&over.domain, &mut split),
        }
        split
    }

    /// The level from which on cells are not split. Leaves at extraordinary vertices are finer than cells.
    fn max_cell_level(&self) -> usize {
        match &self.topology {
            Topology::Grid(_) => MAX_LEVEL,
            Topology::Quads(_) => MAX_LEVEL - quads::PIECE_LEVELS as usize,
        }
    }

    /// The cell whose functions a leaf has: itself, except at extraordinary vertices, where a cell has
    /// several leaves.
    #[must_use]
    pub fn cell_of_leaf(&self, leaf: usize) -> Cell {
        let own = self.leaves[leaf];
        self.cell_of_piece(own).unwrap_or(own)
    }

    /// The hierarchy with every leaf split.
    #[must_use]
    pub fn refine_all(&self) -> Self {
        self.refine(&(0..self.leaves.len()).collect::<Vec<_>>())
    }

    /// The shape of the base grid; none over a domain of quads.
    #[must_use]
    pub fn shape(&self) -> Option<Shape> {
        match self.topology {
            Topology::Grid(shape) => Some(shape),
            Topology::Quads(_) => None,
        }
    }

    /// The name of the topology in files: that of the shape, or `quads`.
    #[must_use]
    pub fn topology_name(&self) -> &'static str {
        self.shape().map_or("quads", Shape::name)
    }

    /// True if u is periodic.
    #[inline]
    #[must_use]
    pub fn periodic_u(&self) -> bool {
        self.shape().is_some_and(Shape::periodic_u)
    }

    /// True if v is periodic.
    #[inline]
    #[must_use]
    pub fn periodic_v(&self) -> bool {
        self.shape().is_some_and(Shape::periodic_v)
    }

    /// True if the ends of v are poles.
    #[inline]
    #[must_use]
    pub fn polar(&self) -> bool {
        self.shape().is_some_and(Shape::polar)
    }

    /// True if both have the same cells before any is split.
    #[must_use]
    pub fn same_base(&self, other: &Self) -> bool {
        let domains = [self, other].map(|space| {
            let domain = space.domain()?;
            Some((domain.cells(), domain.creases(), domain.corners()))
        });
        self.shape() == other.shape() && self.base == other.base && domains[0] == domains[1]
    }

    /// The hierarchy without splits.
    #[must_use]
    pub fn unrefined(&self) -> Self {
        self.with_split(CellTree::new(self.base))
    }

    fn with_split(&self, split: CellTree) -> Self {
        match &self.topology {
            Topology::Grid(shape) => Self::build(*shape, self.base, split),
            Topology::Quads(over) => Self::build_over(Arc::clone(&over.domain), split),
        }
    }

    /// A cell that is split in another hierarchy over the same base, but not in this one.
    pub(crate) fn coarser_than(&self, other: &Self) -> Option<Cell> {
        (0..other.cells.levels()).find_map(|level| {
            let split = other.cells.split_cells(level).iter().copied();
            split.filter(|&cell| !self.cells.is_split(cell)).min()
        })
    }

    fn quads(&self) -> Option<&OverQuads> {
        match &self.topology {
            Topology::Grid(_) => None,
            Topology::Quads(over) => Some(over),
        }
    }

    /// Number of cells of the base grid along u and v.
    #[must_use]
    pub fn base(&self) -> [usize; 2] {
        self.base
    }

    /// Extent of the parameters: `u ∈ [0, extent[0]]`, `v ∈ [0, extent[1]]`.
    #[must_use]
    pub fn extent(&self) -> [f64; 2] {
        [self.base[0] as f64, self.base[1] as f64]
    }

    /// Number of levels in use, at least 1.
    #[must_use]
    pub fn levels(&self) -> usize {
        self.leaves.iter().map(|cell| usize::from(cell.level) + 1).max().unwrap_or(1)
    }

    /// The leaf cells, in the order of their numbers.
    #[must_use]
    pub fn leaves(&self) -> &[Cell] {
        &self.leaves
    }

    /// Number of nodes, which is the number of control vertices.
    #[must_use]
    pub fn node_count(&self) -> usize {
        self.node_anchors.len()
    }

    /// The anchor of each node: the parameters where its function is largest.
    #[must_use]
    pub fn node_anchors(&self) -> &[[f64; 2]] {
        &self.node_anchors
    }

    /// The nodes whose functions are nonzero on a leaf and, for each, its weights in the sixteen coefficients
    /// (`4 · row + column`).
    #[must_use]
    pub fn extraction(&self, leaf: usize) -> (&[u32], &[[f64; 16]]) {
        let range = self.offsets[leaf] as usize..self.offsets[leaf + 1] as usize;
        (&self.nodes[range.clone()], &self.weights[range])
    }

    /// For each node, the leaves of its support.
    #[must_use]
    pub fn support_leaves(&self) -> Vec<Vec<u32>> {
        let mut supports = vec![Vec::new(); self.node_count()];
        for leaf in 0..self.leaves.len() {
            for &node in self.extraction(leaf).0 {
                supports[node as usize].push(leaf as u32);
            }
        }
        supports
    }

    /// The sixteen coefficients of every leaf, from the control vertices.
    #[must_use]
    pub fn leaf_coefficients(&self, vertices: &[DVec3]) -> Vec<[DVec3; 16]> {
        self.sparse_extraction().coefficients(vertices)
    }

    /// The extraction as a sparse matrix, built on first use.
    pub(crate) fn sparse_extraction(&self) -> &SparseExtraction {
        self.sparse.get_or_init(|| SparseExtraction::new(self))
    }

    /// Control vertices of a given surface, described by the sixteen coefficients of any cell inside one leaf
    /// of the *source*.
    ///
    /// `coefficients(cell)` returns the coefficients on that cell; all must describe one surface in the span
    /// of this hierarchy. The coefficient of a truncated function equals that of the untruncated one on any
    /// leaf of its level (preservation of coefficients), so one leaf per function is sufficient.
    pub fn vertices_from(&self, mut coefficients: impl FnMut(Cell) -> [DVec3; 16]) -> Vec<DVec3> {
        // Each function needs a single leaf of its level, so most leaves need no coefficients at all.
        let mut of_function: Vec<Option<DVec3>> = vec![None; self.functions.len()];
        let index: HashMap<Cell, usize> = self.functions.iter().enumerate().map(|(n, &f)| (f, n)).collect();
        for &cell in &self.leaves {
            // Only leaves that are needed are evaluated, and each once.
            let mut local = None;
            let level = usize::from(cell.level);
            for k in 0..16 {
                let function = self.function_on_cell(cell, k);
                if let Some(&n) = index.get(&function)
                    && of_function[n].is_none()
                {
                    let c = *local.get_or_insert_with(|| coefficients(Cell { level: level as u8, ..cell }));
                    of_function[n] = Some(c[k]);
                }
            }
        }
        let mut vertices = vec![DVec3::ZERO; self.node_count()];
        for (n, value) in of_function.iter().enumerate() {
            if let (Some(node), Some(p)) = (self.node_of_function[n], value) {
                vertices[node as usize] = *p;
            }
        }
        for pole in &self.poles {
            let ring = |r: usize, i: usize| -> DVec3 {
                let n = index[&self.ring_function(pole, r, i)];
                of_function[n].unwrap_or(DVec3::ZERO)
            };
            let columns = grid(self.base, pole.level)[0];
            // β1 = (c1 + c2/2)/1.5, then p, a and b by least squares over the ring. This is exact for a polar
            // surface.
            // The splines of cosine and sine are orthogonal around the ring, so the three unknowns separate.
            let mut sums = [DVec3::ZERO; 3];
            let mut squares = [0.0; 2];
            for i in 0..columns {
                let (c1, c2) = (ring(1, i), ring(2, i));
                for d in 0..3 {
                    let beta = (c1[d] + 0.5 * c2[d]) / 1.5;
                    sums[0][d] += beta;
                    sums[1][d] += beta * pole.cosine[i];
                    sums[2][d] += beta * pole.sine[i];
                }
                squares[0] += pole.cosine[i].powi(2);
                squares[1] += pole.sine[i].powi(2);
            }
            for (k, phi) in POLE_ANGLES.iter().enumerate() {
                for d in 0..3 {
                    let p = sums[0][d] / columns as f64;
                    let (a, b) = (sums[1][d] / squares[0], sums[2][d] / squares[1]);
                    vertices[pole.first_node as usize + k][d] = p + 2.0 * (a * phi.cos() + b * phi.sin());
                }
            }
        }
        vertices
    }

    /// Checks all invariants: leaves tile the domain, weights sum to one on every leaf, every node has a
    /// support.
    ///
    /// # Errors
    /// `Input` that names the first violated invariant.
    pub fn sanity_check(&self) -> Result<()> {
        // Sides are powers of two, so the sum of areas has hardly any rounding.
        let area: f64 = self.leaves.iter().map(|cell| cell.side() * cell.side()).sum();
        if (area - self.extent()[0] * self.extent()[1]).abs() > 1e-9 * area {
            return Err(Error::input("the leaves do not tile the domain"));
        }
        let mut acts = vec![false; self.node_count()];
        for leaf in 0..self.leaves.len() {
            let (nodes, weights) = self.extraction(leaf);
            for &node in nodes {
                acts[node as usize] = true;
            }
            for k in 0..16 {
                let sum: f64 = weights.iter().map(|w| w[k]).sum();
                if (sum - 1.0).abs() > 1e-12 {
                    return Err(Error::input(format!("weights of leaf {leaf} sum to {sum}, not 1")));
                }
            }
        }
        match acts.iter().position(|&a| !a) {
            Some(node) => Err(Error::input(format!("node {node} has no support"))),
            None => Ok(()),
        }
    }

    /// The function with local number `k = 4 · row + column` on a cell.
    fn function_on_cell(&self, cell: Cell, k: usize) -> Cell {
        let [columns, rows] = grid(self.base, usize::from(cell.level));
        let i = cell.i as usize + k % 4;
        let j = cell.j as usize + k / 4;
        Cell {
            level: cell.level,
            i: if self.periodic_u() { i % columns } else { i } as u32,
            j: if self.periodic_v() { j % rows } else { j } as u32,
        }
    }

    fn build(shape: Shape, base: [usize; 2], split: CellTree) -> Self {
        let layout = Layout::new(shape, base, split);
        let pole_of_function = layout.hierarchy.pole_expansion(&layout.functions);
        // Descend the tree with the coefficients of all functions that are not yet zero, truncated at each
        // level. Rows of base cells are independent, so they run in parallel and are joined in order.
        let rows: Vec<FoundLeaves> = (0..base[1] as u32)
            .into_par_iter()
            .map(|j| {
                let mut walk = Walk {
                    layout: &layout,
                    pole_of_function: &pole_of_function,
                    found: FoundLeaves::default(),
                };
                for i in 0..base[0] as u32 {
                    walk.descend(Cell { level: 0, i, j }, Vec::new());
                }
                walk.found
            })
            .collect();
        let mut hierarchy = layout.hierarchy;
        for found in rows {
            for (cell, count) in found.cells.iter().zip(&found.counts) {
                hierarchy.cells.number(*cell, hierarchy.leaves.len() as u32, false);
                hierarchy.leaves.push(*cell);
                hierarchy.offsets.push(hierarchy.offsets[hierarchy.offsets.len() - 1] + count);
            }
            hierarchy.nodes.extend(found.nodes);
            hierarchy.weights.extend(found.weights);
        }
        hierarchy
    }
}

/// Numbers of columns and rows of cells at a level.
fn grid(base: [usize; 2], level: usize) -> [usize; 2] {
    [base[0] << level, base[1] << level]
}

/// The `d`-th cell (of four) in the support of function `i`; `None` if it lies outside an open domain.
fn support_cell(i: usize, d: usize, cells: usize, periodic: bool) -> Option<usize> {
    let c = i as i64 - 3 + d as i64;
    if periodic {
        Some(c.rem_euclid(cells as i64) as usize)
    } else {
        (0..cells as i64).contains(&c).then_some(c as usize)
    }
}

/// Coefficients of one quarter of a cell from those of the cell (exact).
#[must_use]
pub fn quarter(w: &[f64; 16], half_u: usize, half_v: usize) -> [f64; 16] {
    let mut rows = [0.0; 16];
    for r in 0..4 {
        let half = cubic_half([w[4 * r], w[4 * r + 1], w[4 * r + 2], w[4 * r + 3]], half_u);
        rows[4 * r..4 * r + 4].copy_from_slice(&half);
    }
    let mut out = [0.0; 16];
    for c in 0..4 {
        let half = cubic_half([rows[c], rows[4 + c], rows[8 + c], rows[12 + c]], half_v);
        for r in 0..4 {
            out[4 * r + c] = half[r];
        }
    }
    out
}

/// [`quarter`] for each of three coordinates.
#[must_use]
pub fn quarter3(c: &[DVec3; 16], half_u: usize, half_v: usize) -> [DVec3; 16] {
    let mut out = [DVec3::ZERO; 16];
    for d in 0..3 {
        let q = quarter(&std::array::from_fn(|k| c[k][d]), half_u, half_v);
        for k in 0..16 {
            out[k][d] = q[k];
        }
    }
    out
}

#[cfg(test)]
mod tests;
