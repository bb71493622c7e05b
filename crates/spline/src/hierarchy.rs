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

mod extraction;

use crate::basis::cubic_half;
use extraction::SparseExtraction;
use planish_estimate::{Error, Result};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::OnceLock;

/// Topology of a surface: which parameter directions are closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Shape {
    /// Open in both directions.
    Sheet,
    /// Periodic in u, open in v.
    Tube,
    /// Periodic in u, with a pole at each end of v.
    Ball,
    /// Periodic in both directions.
    Torus,
}

impl Shape {
    /// True if u is periodic.
    #[must_use]
    pub fn periodic_u(self) -> bool {
        self != Self::Sheet
    }

    /// True if v is periodic.
    #[must_use]
    pub fn periodic_v(self) -> bool {
        self == Self::Torus
    }

    /// True if the ends of v are poles.
    #[must_use]
    pub fn polar(self) -> bool {
        self == Self::Ball
    }

    /// The name used in files and options.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Sheet => "sheet",
            Self::Tube => "tube",
            Self::Ball => "ball",
            Self::Torus => "torus",
        }
    }

    /// The shape with the given name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Sheet, Self::Tube, Self::Ball, Self::Torus].into_iter().find(|shape| shape.name() == name)
    }
}

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
}

/// Maximum level.
pub const MAX_LEVEL: usize = 12;

const NOT_A_LEAF: u32 = u32::MAX;

/// Moves a parameter into `[0, n]`. The test comes first, because almost all are inside and a remainder is
/// slow.
#[inline]
fn wrap_or_clamp(x: f64, n: f64, periodic: bool) -> f64 {
    if (0.0..n).contains(&x) {
        x
    } else if periodic {
        x.rem_euclid(n)
    } else {
        x.clamp(0.0, n)
    }
}

/// The quadtree, its basis functions and their extraction on every leaf cell.
#[derive(Debug, Clone)]
pub struct Hierarchy {
    shape: Shape,
    base: [usize; 2],
    /// For each level, by cell (row-major): true if the cell exists and is split.
    split: Vec<Vec<bool>>,
    /// For each level, by cell: the number of the leaf, or `NOT_A_LEAF`.
    leaf_number: Vec<Vec<u32>>,
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

/// Extraction at a pole: two rings of tube functions from three pole nodes and the third ring.
#[derive(Debug, Clone)]
struct PoleMap {
    level: usize,
    at_top: bool,
    /// First of the three pole nodes.
    first_node: u32,
    /// Ring values of the two splines that represent cosine and sine around the pole.
    cosine: Vec<f64>,
    sine: Vec<f64>,
}

/// Angles of the three pole vertices.
const POLE_ANGLES: [f64; 3] = [0.0, 2.0 * std::f64::consts::FRAC_PI_3, 4.0 * std::f64::consts::FRAC_PI_3];

impl PoleMap {
    /// Weights (nonnegative, sum one) of the three pole nodes in the ring-1 coefficient
    /// `β1_i = p + a cos_i + b sin_i`, with `T_k = p + 2 (a cos φ_k + b sin φ_k)`.
    fn ring_weights(&self, i: usize) -> [f64; 3] {
        POLE_ANGLES.map(|phi| (1.0 + self.cosine[i] * phi.cos() + self.sine[i] * phi.sin()) / 3.0)
    }
}

impl Hierarchy {
    /// The unrefined hierarchy over a base grid of `base[0] × base[1]` cells.
    ///
    /// # Errors
    /// `Input` when a periodic direction has fewer than 4 cells, a ball has fewer than 4 rows, or another
    /// direction has no cell.
    pub fn uniform(shape: Shape, base: [usize; 2]) -> Result<Self> {
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
            if base[d] > 1 << 14 {
                return Err(Error::input(format!(
                    "a base grid of {} × {} cells is too large",
                    base[0], base[1]
                )));
            }
        }
        let split = vec![vec![false; base[0] * base[1]]];
        Ok(Self::build(shape, base, split))
    }

    /// The hierarchy whose leaves are exactly the given cells.
    ///
    /// # Errors
    /// `Input` when the cells do not tile the domain exactly once, or a pole is not split all around.
    pub fn from_leaves(shape: Shape, base: [usize; 2], leaves: &[Cell]) -> Result<Self> {
        let mut hierarchy = Self::uniform(shape, base)?;
        let mut split = std::mem::take(&mut hierarchy.split);
        for &cell in leaves {
            let [n, m] = grid(base, usize::from(cell.level).min(MAX_LEVEL));
            if usize::from(cell.level) > MAX_LEVEL || cell.i as usize >= n || cell.j as usize >= m {
                return Err(Error::input(format!("cell {cell:?} lies outside the base grid {base:?}")));
            }
            let (mut i, mut j) = (cell.i as usize, cell.j as usize);
            for level in (0..usize::from(cell.level)).rev() {
                (i, j) = (i / 2, j / 2);
                while split.len() <= level {
                    split.push(vec![false; grid(base, split.len()).iter().product()]);
                }
                let columns = grid(base, level)[0];
                split[level][j * columns + i] = true;
            }
        }
        let before = split.clone();
        close(shape, base, &mut split, usize::MAX);
        if before.iter().flatten().filter(|&&s| s).count() != split.iter().flatten().filter(|&&s| s).count() {
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
        Self::build(self.shape, self.base, self.split_with(marked))
    }

    /// Number of nodes that [`Hierarchy::refine`] would produce, at a fraction of its cost.
    #[must_use]
    pub fn refined_node_count(&self, marked: &[usize]) -> usize {
        Layout::new(self.shape, self.base, self.split_with(marked)).hierarchy.node_count()
    }

    /// The split cells after splitting the marked leaves.
    fn split_with(&self, marked: &[usize]) -> Vec<Vec<bool>> {
        let mut split = self.split.clone();
        for &leaf in marked {
            let cell = self.leaves[leaf];
            let level = usize::from(cell.level);
            if level >= MAX_LEVEL {
                continue;
            }
            let columns = grid(self.base, level)[0];
            split[level][cell.j as usize * columns + cell.i as usize] = true;
        }
        close(self.shape, self.base, &mut split, MAX_LEVEL);
        split
    }

    /// The hierarchy with every leaf split.
    #[must_use]
    pub fn refine_all(&self) -> Self {
        self.refine(&(0..self.leaves.len()).collect::<Vec<_>>())
    }

    /// The topology.
    #[must_use]
    pub fn shape(&self) -> Shape {
        self.shape
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

    /// The leaf that contains `(u, v)`, and the local coordinates in it. Periodic parameters are wrapped,
    /// others are clamped.
    #[inline]
    #[must_use]
    pub fn locate(&self, u: f64, v: f64) -> (usize, [f64; 2]) {
        let [u, v] = self.wrap(u, v);
        self.cell_at(0, u, v).unwrap_or_else(|| self.locate_below(u, v))
    }

    /// The leaf below the base grid that contains `(u, v)`. Kept out of line, so that the common case of a
    /// base cell stays small.
    #[inline(never)]
    fn locate_below(&self, u: f64, v: f64) -> (usize, [f64; 2]) {
        let mut level = 1;
        loop {
            if let Some(found) = self.cell_at(level, u, v) {
                return found;
            }
            level += 1;
        }
    }

    /// The leaf of a level that contains `(u, v)`, and the local coordinates in it; `None` if the cell of
    /// that level is not a leaf.
    #[inline(always)]
    fn cell_at(&self, level: usize, u: f64, v: f64) -> Option<(usize, [f64; 2])> {
        let [columns, rows] = grid(self.base, level);
        let scale = (1_u64 << level) as f64;
        let i = ((u * scale) as usize).min(columns - 1);
        let j = ((v * scale) as usize).min(rows - 1);
        match self.leaf_number[level][j * columns + i] {
            NOT_A_LEAF => None,
            leaf => Some((leaf as usize, [u * scale - i as f64, v * scale - j as f64])),
        }
    }

    /// Moves parameters into the domain: wraps periodic directions, clamps open ones, and continues across
    /// the pole of a ball.
    #[inline]
    #[must_use]
    pub fn wrap(&self, mut u: f64, mut v: f64) -> [f64; 2] {
        let [nu, nv] = self.extent();
        if self.shape.polar() {
            if v < 0.0 {
                v = -v;
                u += nu / 2.0;
            } else if v > nv {
                v = 2.0 * nv - v;
                u += nu / 2.0;
            }
        }
        [wrap_or_clamp(u, nu, self.shape.periodic_u()), wrap_or_clamp(v, nv, self.shape.periodic_v())]
    }

    /// Parameters of a leaf-local point.
    #[must_use]
    pub fn parameters(&self, leaf: usize, local: [f64; 2]) -> [f64; 2] {
        let cell = self.leaves[leaf];
        let side = cell.side();
        [(f64::from(cell.i) + local[0]) * side, (f64::from(cell.j) + local[1]) * side]
    }

    /// The leaf that equals or contains a cell; `None` if the cell is split.
    #[must_use]
    pub fn leaf_over(&self, cell: Cell) -> Option<usize> {
        for level in (0..=usize::from(cell.level)).rev() {
            if level >= self.leaf_number.len() {
                continue;
            }
            let shift = usize::from(cell.level) - level;
            let (i, j) = (cell.i as usize >> shift, cell.j as usize >> shift);
            let columns = grid(self.base, level)[0];
            let leaf = self.leaf_number[level][j * columns + i];
            if leaf != NOT_A_LEAF {
                return Some(leaf as usize);
            }
        }
        None
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
    pub fn leaf_coefficients(&self, vertices: &[[f64; 3]]) -> Vec<[[f64; 3]; 16]> {
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
    pub fn vertices_from(&self, mut coefficients: impl FnMut(Cell) -> [[f64; 3]; 16]) -> Vec<[f64; 3]> {
        let mut of_function: Vec<Option<[f64; 3]>> = vec![None; self.functions.len()];
        let index: HashMap<Cell, usize> = self.functions.iter().enumerate().map(|(n, &f)| (f, n)).collect();
        for &cell in &self.leaves {
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
        let mut vertices = vec![[0.0; 3]; self.node_count()];
        for (n, value) in of_function.iter().enumerate() {
            if let (Some(node), Some(p)) = (self.node_of_function[n], value) {
                vertices[node as usize] = *p;
            }
        }
        for pole in &self.poles {
            let ring = |r: usize, i: usize| -> [f64; 3] {
                let n = index[&self.ring_function(pole, r, i)];
                of_function[n].unwrap_or([0.0; 3])
            };
            let columns = grid(self.base, pole.level)[0];
            // β1 = (c1 + c2/2)/1.5, then p, a and b by least squares over the ring. This is exact for a polar
            // surface.
            let mut sums = [[0.0; 3]; 3];
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
            i: if self.shape.periodic_u() { i % columns } else { i } as u32,
            j: if self.shape.periodic_v() { j % rows } else { j } as u32,
        }
    }

    /// The tube function in ring `r` (0 nearest the pole) and column `i`.
    fn ring_function(&self, pole: &PoleMap, r: usize, i: usize) -> Cell {
        let rows = grid(self.base, pole.level)[1];
        let j = if pole.at_top { rows + 2 - r } else { r };
        Cell { level: pole.level as u8, i: i as u32, j: j as u32 }
    }

    fn build(shape: Shape, base: [usize; 2], split: Vec<Vec<bool>>) -> Self {
        let layout = Layout::new(shape, base, split);
        let pole_of_function = layout.hierarchy.pole_expansion(&layout.active);
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
                let columns = grid(base, usize::from(cell.level))[0];
                hierarchy.leaf_number[usize::from(cell.level)][cell.j as usize * columns + cell.i as usize] =
                    hierarchy.leaves.len() as u32;
                hierarchy.leaves.push(*cell);
                hierarchy.offsets.push(hierarchy.offsets[hierarchy.offsets.len() - 1] + count);
            }
            hierarchy.nodes.extend(found.nodes);
            hierarchy.weights.extend(found.weights);
        }
        hierarchy
    }

    /// Number of functions in each direction at a level.
    fn function_grid(&self, level: usize) -> [usize; 2] {
        let [columns, rows] = grid(self.base, level);
        [
            if self.shape.periodic_u() { columns } else { columns + 3 },
            if self.shape.periodic_v() { rows } else { rows + 3 },
        ]
    }

    /// Numbers the nodes: functions in their order, without two rings at each pole. These are replaced by
    /// three pole nodes at the end.
    fn number_nodes(&mut self, exists: &[Vec<bool>]) {
        let mut replaced = vec![false; self.functions.len()];
        if self.shape.polar() {
            for at_top in [false, true] {
                let level = (0..exists.len())
                    .rev()
                    .find(|&level| {
                        let [columns, rows] = grid(self.base, level);
                        exists[level][if at_top { (rows - 1) * columns } else { 0 }]
                    })
                    .unwrap_or(0);
                let (mut cosine, mut sine) = (Vec::new(), Vec::new());
                let n = self.base[0];
                for i in 0..n {
                    // Greville point of function i: (i − 1) cells.
                    let angle = std::f64::consts::TAU * (i as f64 - 1.0) / n as f64;
                    cosine.push(angle.cos());
                    sine.push(angle.sin());
                }
                for l in 0..level {
                    let basis = crate::basis::UniformBasis::new(3, n << l, crate::basis::End::Periodic)
                        .expect("a ball has at least four columns");
                    cosine = basis.refine(&cosine);
                    sine = basis.refine(&sine);
                }
                self.poles.push(PoleMap { level, at_top, first_node: 0, cosine, sine });
            }
            for (n, f) in self.functions.iter().enumerate() {
                for pole in &self.poles {
                    let rows = grid(self.base, pole.level)[1];
                    let ring =
                        if pole.at_top { rows + 2 - (f.j as usize).min(rows + 2) } else { f.j as usize };
                    replaced[n] |= usize::from(f.level) == pole.level && ring < 2;
                }
            }
        }
        for (n, f) in self.functions.iter().enumerate() {
            if replaced[n] {
                self.node_of_function.push(None);
                continue;
            }
            self.node_of_function.push(Some(self.node_anchors.len() as u32));
            let side = f.side();
            let mut anchor = [(f64::from(f.i) - 1.0) * side, (f64::from(f.j) - 1.0) * side];
            if self.shape.periodic_u() {
                anchor[0] = anchor[0].rem_euclid(self.base[0] as f64);
            }
            if self.shape.periodic_v() {
                anchor[1] = anchor[1].rem_euclid(self.base[1] as f64);
            }
            self.node_anchors.push(anchor);
        }
        for pole in &mut self.poles {
            pole.first_node = self.node_anchors.len() as u32;
            let v = if pole.at_top { self.base[1] as f64 } else { 0.0 };
            for k in 0..3 {
                self.node_anchors.push([self.base[0] as f64 * k as f64 / 3.0, v]);
            }
        }
    }

    /// For every tube function near a pole, the nodes of its coefficient with their weights.
    ///
    /// With clamped coefficients β0, β1, β2 of a meridian, the uniform ones are `c2 = β2`,
    /// `c1 = 1.5 β1 − 0.5 β2`, `c0 = 6 β0 − 6 β1 + β2` (blossoming); β0 is the pole, β1 the ring that spans
    /// its tangent plane.
    fn pole_expansion(&self, active: &[Vec<u32>]) -> HashMap<u32, Vec<(u32, f64)>> {
        let mut expansion = HashMap::new();
        for pole in &self.poles {
            let [columns, _] = grid(self.base, pole.level);
            let [fu, _] = self.function_grid(pole.level);
            for i in 0..columns {
                let at = |r: usize| {
                    let f = self.ring_function(pole, r, i);
                    active[pole.level][f.j as usize * fu + f.i as usize]
                };
                let outer = self.node_of_function[at(2) as usize]
                    .expect("the third ring is not replaced by pole nodes");
                let ring = pole.ring_weights(i);
                let mut first = vec![(outer, -0.5)];
                let mut zeroth = vec![(outer, 1.0)];
                for (k, w) in ring.iter().enumerate() {
                    let node = pole.first_node + k as u32;
                    first.push((node, 1.5 * w));
                    zeroth.push((node, 2.0 - 6.0 * w));
                }
                expansion.insert(at(1), first);
                expansion.insert(at(0), zeroth);
            }
        }
        expansion
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

/// Splits further cells until all rules of nesting and grading are satisfied.
fn close(shape: Shape, base: [usize; 2], split: &mut Vec<Vec<bool>>, max_level: usize) {
    // Requirements propagate from fine to coarse levels, so one sweep is sufficient for grading. Poles can
    // then require further splits, hence the loop.
    loop {
        let mut changed = false;
        for level in (0..split.len()).rev() {
            let [columns, rows] = grid(base, level);
            if shape.polar() {
                for pair in [[0, 1], [rows - 1, rows - 2]] {
                    let any =
                        pair.iter().any(|&j| split[level][j * columns..(j + 1) * columns].iter().any(|&s| s));
                    if any {
                        for j in pair {
                            for s in &mut split[level][j * columns..(j + 1) * columns] {
                                changed |= !*s;
                                *s = true;
                            }
                        }
                    }
                }
            }
            if level == 0 {
                continue;
            }
            // A split cell requires its parent and the eight neighbours of the parent to be split.
            let [parent_columns, parent_rows] = grid(base, level - 1);
            for j in 0..rows {
                for i in 0..columns {
                    if !split[level][j * columns + i] {
                        continue;
                    }
                    for dj in -1..=1_i64 {
                        for di in -1..=1_i64 {
                            let ci = neighbour(i / 2, di, parent_columns, shape.periodic_u());
                            let cj = neighbour(j / 2, dj, parent_rows, shape.periodic_v());
                            if let (Some(ci), Some(cj)) = (ci, cj) {
                                let s = &mut split[level - 1][cj * parent_columns + ci];
                                changed |= !*s;
                                *s = true;
                            }
                        }
                    }
                }
            }
        }
        // Cells split at the last level need a level for their children.
        if split.last().is_some_and(|level| level.iter().any(|&s| s))
            && split.len() <= max_level.min(MAX_LEVEL)
        {
            let level = split.len();
            split.push(vec![false; grid(base, level).iter().product()]);
        }
        if !changed {
            break;
        }
    }
}

fn neighbour(c: usize, d: i64, cells: usize, periodic: bool) -> Option<usize> {
    let n = c as i64 + d;
    if periodic {
        Some(n.rem_euclid(cells as i64) as usize)
    } else {
        (0..cells as i64).contains(&n).then_some(n as usize)
    }
}

/// A hierarchy with numbered nodes but without leaves.
struct Layout {
    hierarchy: Hierarchy,
    /// For each level, by function: its number, or `NOT_A_LEAF` if it is not active.
    active: Vec<Vec<u32>>,
    /// For each level, by function: true if its support consists of existing cells of that level.
    inside: Vec<Vec<bool>>,
}

impl Layout {
    fn new(shape: Shape, base: [usize; 2], mut split: Vec<Vec<bool>>) -> Self {
        while split.len() > 1 && split.last().is_some_and(|level| level.iter().all(|&s| !s)) {
            split.pop();
        }
        if split[split.len() - 1].iter().any(|&s| s) {
            split.push(vec![false; grid(base, split.len()).iter().product()]);
        }
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
        let mut hierarchy = Hierarchy {
            shape,
            base,
            leaf_number: exists.iter().map(|level| vec![NOT_A_LEAF; level.len()]).collect(),
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
        };
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
struct FoundLeaves {
    cells: Vec<Cell>,
    counts: Vec<u32>,
    nodes: Vec<u32>,
    weights: Vec<[f64; 16]>,
}

/// Traversal of the quadtree that collects the functions of each leaf and their coefficients.
struct Walk<'a> {
    layout: &'a Layout,
    pole_of_function: &'a HashMap<u32, Vec<(u32, f64)>>,
    found: FoundLeaves,
}

/// Functions with their sixteen coefficients on a cell.
type Coefficients = Vec<(u32, [f64; 16])>;

impl Walk<'_> {
    /// Descends from a cell. `list` holds functions of coarser levels with their coefficients on this cell,
    /// not yet truncated at this level.
    fn descend(&mut self, cell: Cell, mut list: Coefficients) {
        let level = usize::from(cell.level);
        let hierarchy = &self.layout.hierarchy;
        let [fu, _] = hierarchy.function_grid(level);
        let mut own = [NOT_A_LEAF; 16];
        for k in 0..16 {
            let f = hierarchy.function_on_cell(cell, k);
            let index = f.j as usize * fu + f.i as usize;
            if self.layout.inside[level][index] {
                for (_, w) in &mut list {
                    w[k] = 0.0;
                }
            }
            own[k] = self.layout.active[level][index];
        }
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
        merged.sort_unstable_by_key(|(node, _)| *node);
        self.found.cells.push(cell);
        self.found.counts.push(merged.len() as u32);
        self.found.nodes.extend(merged.iter().map(|(node, _)| node));
        self.found.weights.extend(merged.iter().map(|(_, w)| w));
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
pub fn quarter3(c: &[[f64; 3]; 16], half_u: usize, half_v: usize) -> [[f64; 3]; 16] {
    let mut out = [[0.0; 3]; 16];
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
