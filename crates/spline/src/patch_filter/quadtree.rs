//! The quadtree of leaf patches over a hierarchy, and the vertices that neighbours share.
//!
//! Input: a [`Hierarchy`] whose leaf cells form blocks of 4 × 4. Output: the patches, each with 7 × 7
//! coefficients, and the shared linear functions of every two neighbours.
//!
//! The control vertices of a patch fall into nine classes: the centre, those shared across one edge (north,
//! south, east, west), and those also shared across a corner. Two patches of one level share 7 × 3 vertices
//! across an edge and 3 × 3 across a corner. If the neighbour is one level coarser, the three outer layers of
//! the finer patch are subdivided vertices of the coarser one: 15 values of the coarser patch determine 21 of
//! the finer.
//!
//! Not guaranteed: shared functions of patches on opposite sides of a pole. They are connected by the patches
//! between them.

use crate::hierarchy::{Cell, Hierarchy};
use nalgebra::DMatrix;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use std::collections::HashMap;
use std::sync::Arc;

/// Number of cells of a patch in each direction.
pub const PATCH_CELLS: usize = 4;
/// Number of control vertices of a patch in each direction.
pub const PATCH_VERTICES: usize = PATCH_CELLS + 3;
/// Number of control vertices of a patch.
pub(super) const VERTICES: usize = PATCH_VERTICES * PATCH_VERTICES;

/// A leaf patch: 4 × 4 cells of one level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FilterPatch {
    /// Subdivision depth.
    pub depth: u8,
    /// Column among the patches of this depth.
    pub i: u32,
    /// Row among the patches of this depth.
    pub j: u32,
}

impl FilterPatch {
    /// The cell in the given column and row of the patch.
    fn cell(self, column: usize, row: usize) -> Cell {
        Cell {
            level: self.depth,
            i: self.i * PATCH_CELLS as u32 + column as u32,
            j: self.j * PATCH_CELLS as u32 + row as u32,
        }
    }

    /// The patch that contains this one as a quarter.
    pub(super) fn parent(self) -> Option<Self> {
        Some(Self { depth: self.depth.checked_sub(1)?, i: self.i / 2, j: self.j / 2 })
    }
}

/// The neighbours of the same size that share a control vertex: one of the nine classes of vertices.
///
/// # Examples
/// ```
/// use planish_spline::VertexSharing;
/// let corner = VertexSharing::new(0, 6);
/// assert_eq!((corner.west, corner.north, corner.copies()), (true, true, 4));
/// assert_eq!(VertexSharing::new(3, 3).copies(), 1);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VertexSharing {
    /// Shared with the neighbour towards smaller u.
    pub west: bool,
    /// Shared with the neighbour towards larger u.
    pub east: bool,
    /// Shared with the neighbour towards smaller v.
    pub south: bool,
    /// Shared with the neighbour towards larger v.
    pub north: bool,
}

impl VertexSharing {
    /// The class of the vertex in the given column and row, each from 0 to 6.
    #[must_use]
    pub fn new(column: usize, row: usize) -> Self {
        Self {
            west: column < 3,
            east: column + 3 >= PATCH_VERTICES,
            south: row < 3,
            north: row + 3 >= PATCH_VERTICES,
        }
    }

    /// Number of patches of a uniform grid that contain the vertex: 1, 2 or 4.
    #[must_use]
    pub fn copies(self) -> usize {
        (1 + usize::from(self.west || self.east)) * (1 + usize::from(self.south || self.north))
    }
}

/// A linear function of the coefficients of a patch.
pub(super) type SparseRow = Vec<(u16, f64)>;

/// Shared functions of two neighbours: `rows[0]` of the coefficients of the first patch equal `rows[1]` of
/// the second.
#[derive(Debug, Clone)]
pub(super) struct Separator {
    pub patches: [u32; 2],
    pub rows: [Vec<SparseRow>; 2],
}

/// The leaf patches of a hierarchy.
#[derive(Debug, Clone)]
pub(super) struct Quadtree {
    pub space: Arc<Hierarchy>,
    pub patches: Vec<FilterPatch>,
    /// For every leaf cell, its patch and its number in the patch, `4 · row + column`.
    pub patch_of_leaf: Vec<(u32, u8)>,
    pub separators: Vec<Separator>,
    /// Separators of each patch, in a fixed order.
    pub separators_of: Vec<Vec<u32>>,
    /// The leaf cells of every patch.
    leaves: Vec<[u32; 16]>,
}

/// The coarsest hierarchy of whole patches that is nowhere coarser than the given hierarchy.
///
/// # Errors
/// `Input` when the base grid is not a multiple of 4 × 4 cells.
///
/// # Examples
/// ```
/// use planish_spline::{Hierarchy, Shape, patch_hierarchy};
///
/// let space = Hierarchy::uniform(Shape::Sheet, [8, 4])?;
/// let patches = patch_hierarchy(&space)?;
/// assert_eq!(patches.leaves().len(), 32); // two patches of 4 × 4 cells
/// # Ok::<(), planish_spline::Error>(())
/// ```
pub fn patch_hierarchy(space: &Hierarchy) -> Result<Arc<Hierarchy>> {
    let mut tree = Quadtree::new(Arc::new(space.unrefined()))?;
    loop {
        let mut marked = vec![false; tree.patches.len()];
        for (leaf, cell) in space.leaves().iter().enumerate() {
            // The centre of the leaf is inside of exactly one patch.
            let [u, v] = space.parameters(leaf, [0.5, 0.5]);
            let (patch, _) = tree.patch_of_leaf[tree.space.locate(u, v).0];
            marked[patch as usize] |= cell.level > tree.patches[patch as usize].depth;
        }
        if !marked.contains(&true) {
            return Ok(tree.space);
        }
        tree = tree.subdivided(&marked)?;
    }
}

impl Quadtree {
    /// The patches of a hierarchy.
    ///
    /// # Errors
    /// `Input` when the base grid is not a multiple of 4 × 4 cells, or leaf cells do not form whole patches.
    pub fn new(space: Arc<Hierarchy>) -> Result<Self> {
        if space.base().iter().any(|n| !n.is_multiple_of(PATCH_CELLS)) {
            return Err(Error::input(format!(
                "patches have 4 × 4 cells: expected a base grid in multiples of 4, found {} × {}",
                space.base()[0],
                space.base()[1]
            )));
        }
        let number: HashMap<Cell, u32> = (0..).zip(space.leaves()).map(|(n, &cell)| (cell, n)).collect();
        let mut patches: Vec<FilterPatch> = space
            .leaves()
            .iter()
            .map(|cell| FilterPatch {
                depth: cell.level,
                i: cell.i / PATCH_CELLS as u32,
                j: cell.j / PATCH_CELLS as u32,
            })
            .collect();
        // Sorted, so that numbers of patches depend on the surface alone and not on the history of
        // subdivisions.
        patches.sort_unstable();
        patches.dedup();
        let mut patch_of_leaf = vec![(0, 0); space.leaves().len()];
        let mut leaves = Vec::with_capacity(patches.len());
        for (p, patch) in (0..).zip(&patches) {
            let mut own = [0; 16];
            for (k, leaf) in own.iter_mut().enumerate() {
                let cell = patch.cell(k % PATCH_CELLS, k / PATCH_CELLS);
                *leaf = *number.get(&cell).ok_or_else(|| {
                    Error::input(format!("the cells around {cell:?} do not form a whole patch"))
                })?;
                patch_of_leaf[*leaf as usize] = (p, k as u8);
            }
            leaves.push(own);
        }
        let mut made =
            Self { space, patches, patch_of_leaf, separators: Vec::new(), separators_of: Vec::new(), leaves };
        made.find_separators();
        Ok(made)
    }

    /// The quadtree after subdivision of the marked patches and of those that grading requires.
    pub fn subdivided(&self, marked: &[bool]) -> Result<Self> {
        let mut marked = marked.to_vec();
        loop {
            // Extending grading to whole patches can require further cells, hence the loop.
            let cells: Vec<usize> = (0..self.patches.len())
                .filter(|&p| marked[p])
                .flat_map(|p| self.leaves[p])
                .map(|leaf| leaf as usize)
                .collect();
            let space = Arc::new(self.space.refine(&cells));
            // Grading splits single cells; extend it to whole patches.
            let left: std::collections::HashSet<Cell> = space.leaves().iter().copied().collect();
            let mut changed = false;
            for (p, patch) in self.patches.iter().enumerate() {
                let complete = (0..16).all(|k| left.contains(&patch.cell(k % 4, k / 4)));
                changed |= !complete && !marked[p];
                marked[p] |= !complete;
            }
            if !changed {
                return Self::new(space);
            }
        }
    }

    /// The 49 coefficients of a patch as weighted sums of nodes.
    pub fn extraction(&self, patch: usize) -> Vec<Vec<(u32, f64)>> {
        (0..VERTICES)
            .map(|vertex| {
                let (column, row) = (vertex % PATCH_VERTICES, vertex / PATCH_VERTICES);
                // All cells of a patch have one level, so any cell that uses a vertex gives the same weights.
                let (ci, cj) = (column.min(PATCH_CELLS - 1), row.min(PATCH_CELLS - 1));
                let leaf = self.leaves[patch][cj * PATCH_CELLS + ci] as usize;
                let k = 4 * (row - cj) + column - ci;
                let (nodes, weights) = self.space.extraction(leaf);
                nodes
                    .iter()
                    .zip(weights)
                    .filter(|(_, w)| w[k] != 0.0)
                    .map(|(&node, w)| (node, w[k]))
                    .collect()
            })
            .collect()
    }

    /// The coefficients of a patch from those of its leaves.
    pub fn coefficients(&self, patch: usize, of_leaf: impl Fn(usize) -> [DVec3; 16]) -> Vec<DVec3> {
        let mut out = vec![DVec3::ZERO; VERTICES];
        for (cell, &leaf) in self.leaves[patch].iter().enumerate() {
            let c = of_leaf(leaf as usize);
            // Adjacent cells share vertices; all write the same value.
            for (k, p) in c.iter().enumerate() {
                out[vertex_of(cell, k)] = *p;
            }
        }
        out
    }

    /// The function, on the level of the patch, of a vertex.
    pub fn function(&self, patch: FilterPatch, vertex: usize) -> Cell {
        let at = patch.cell(vertex % PATCH_VERTICES, vertex / PATCH_VERTICES);
        let wrapped = |x: u32, base: usize, periodic: bool| match periodic {
            true => x % ((base as u32) << patch.depth),
            false => x,
        };
        let base = self.space.base();
        Cell {
            level: patch.depth,
            i: wrapped(at.i, base[0], self.space.periodic_u()),
            j: wrapped(at.j, base[1], self.space.periodic_v()),
        }
    }

    fn find_separators(&mut self) {
        let mut holders: HashMap<Cell, Vec<(u32, u16)>> = HashMap::new();
        let mut shared: HashMap<[u32; 2], Vec<[u16; 2]>> = HashMap::new();
        for (p, patch) in (0..).zip(&self.patches) {
            for vertex in 0..VERTICES {
                // Functions of one level have the same cell on all patches that share them, so equal keys
                // find shared vertices, also across periodic borders.
                let held = holders.entry(self.function(*patch, vertex)).or_default();
                for &(other, at) in held.iter() {
                    if other != p {
                        shared.entry([other, p]).or_default().push([at, vertex as u16]);
                    }
                }
                held.push((p, vertex as u16));
            }
        }
        let mut separators: Vec<Separator> = shared
            .into_iter()
            // Corner-only neighbours are covered by the patches beside both.
            .filter(|(_, pairs)| pairs.len() > 9)
            .map(|(patches, pairs)| Separator {
                patches,
                rows: [0, 1].map(|side| pairs.iter().map(|pair| vec![(pair[side], 1.0)]).collect()),
            })
            .collect();
        let index: HashMap<FilterPatch, u32> =
            (0..).zip(&self.patches).map(|(p, &patch)| (patch, p)).collect();
        for (p, patch) in (0..).zip(&self.patches) {
            for side in Side::ALL {
                // Only from finer to coarser, so that each pair is found once. Grading limits the difference
                // to one level.
                if let Some(coarser) = self.coarser_neighbour(*patch, side).and_then(|q| index.get(&q)) {
                    separators.push(side.separator(*coarser, p, *patch));
                }
            }
        }
        // The order of a `HashMap` differs from run to run. It decides the paths of messages and so the last
        // digits.
        separators.sort_by_key(|s| s.patches);
        self.separators_of = vec![Vec::new(); self.patches.len()];
        for (n, separator) in (0..).zip(&separators) {
            for &p in &separator.patches {
                self.separators_of[p as usize].push(n);
            }
        }
        self.separators = separators;
    }

    /// The patch one level coarser beyond a side, if the domain continues there.
    fn coarser_neighbour(&self, patch: FilterPatch, side: Side) -> Option<FilterPatch> {
        let depth = patch.depth.checked_sub(1)?;
        let step = |x: u32, d: i64, base: usize, periodic: bool| {
            let count = (base as i64 / PATCH_CELLS as i64) << patch.depth;
            let moved = i64::from(x) + d;
            let moved = if periodic { moved.rem_euclid(count) } else { moved };
            (0..count).contains(&moved).then_some(moved as u32 / 2)
        };
        let base = self.space.base();
        let [di, dj] = side.step();
        let found = FilterPatch {
            depth,
            i: step(patch.i, di, base[0], self.space.periodic_u())?,
            j: step(patch.j, dj, base[1], self.space.periodic_v())?,
        };
        // There is no coarser leaf inside the parent.
        (Some(found) != patch.parent()).then_some(found)
    }
}

/// Index in the patch of the `k`-th of the sixteen coefficients of its `cell`-th cell.
#[inline]
pub(super) fn vertex_of(cell: usize, k: usize) -> usize {
    (cell / PATCH_CELLS + k / 4) * PATCH_VERTICES + cell % PATCH_CELLS + k % 4
}

#[derive(Debug, Clone, Copy)]
enum Side {
    West,
    East,
    South,
    North,
}

impl Side {
    const ALL: [Self; 4] = [Self::West, Self::East, Self::South, Self::North];

    fn step(self) -> [i64; 2] {
        match self {
            Self::West => [-1, 0],
            Self::East => [1, 0],
            Self::South => [0, -1],
            Self::North => [0, 1],
        }
    }

    /// Shared functions of a patch and its coarser neighbour beyond this side: vertices of the coarser patch,
    /// recovered from the finer one by the left inverse of the two-scale relation.
    fn separator(self, coarser: u32, finer: u32, patch: FilterPatch) -> Separator {
        // Shared functions are the 15 coarse values. The 21 fine vertices are linear functions of them, so
        // their covariance would be singular.
        let across = DMatrix::from_row_slice(3, 3, &[0.5, 0.5, 0.0, 0.125, 0.75, 0.125, 0.0, 0.5, 0.5]);
        let along = two_scale_rows();
        // The pseudo-inverse gives coarse values from fine ones. It is exact, because the fine vertices are
        // refined from them.
        let inverse = |m: &DMatrix<f64>| {
            (m.transpose() * m)
                .try_inverse()
                .map_or_else(|| DMatrix::zeros(m.ncols(), m.nrows()), |g| g * m.transpose())
        };
        let (across, along) = (inverse(&across), inverse(&along));
        let lies_along_u = matches!(self, Self::West | Self::East);
        // Layers at the low side of the finer patch correspond to layers at the high side of the coarser one.
        let (fine_first, coarse_first) = match self {
            Self::West | Self::South => (0, PATCH_CELLS),
            Self::East | Self::North => (PATCH_CELLS, 0),
        };
        // The finer patch lies along the lower or upper half of the coarser one's side.
        let half = 2 * (if lies_along_u { patch.j } else { patch.i } % 2) as usize;
        let vertex = |across: usize, along: usize| -> u16 {
            let (column, row) = if lies_along_u { (across, along) } else { (along, across) };
            (row * PATCH_VERTICES + column) as u16
        };
        let mut rows = [Vec::new(), Vec::new()];
        for a in 0..along.nrows() {
            for n in 0..across.nrows() {
                rows[0].push(vec![(vertex(coarse_first + n, half + a), 1.0)]);
                let mut of_finer = SparseRow::new();
                for b in 0..along.ncols() {
                    for m in 0..across.ncols() {
                        of_finer.push((vertex(fine_first + m, b), across[(n, m)] * along[(a, b)]));
                    }
                }
                rows[1].push(of_finer);
            }
        }
        Separator { patches: [coarser, finer], rows }
    }
}

/// Seven vertices of the finer level from five of the coarser: the two-scale relation over half a patch.
fn two_scale_rows() -> DMatrix<f64> {
    let mut rows = DMatrix::zeros(PATCH_VERTICES, 5);
    for t in 0..PATCH_VERTICES {
        let first = t / 2;
        if t % 2 == 0 {
            rows[(t, first)] = 0.5;
            rows[(t, first + 1)] = 0.5;
        } else {
            rows[(t, first)] = 0.125;
            rows[(t, first + 1)] = 0.75;
            rows[(t, first + 2)] = 0.125;
        }
    }
    rows
}

/// The two-scale relation: the 49 vertices of a quarter of a patch from those of the patch. `half` selects
/// the quarter.
pub(super) fn quarter_matrix(half: [usize; 2]) -> DMatrix<f64> {
    let along = two_scale_rows();
    let mut alpha = DMatrix::zeros(VERTICES, VERTICES);
    for row in 0..PATCH_VERTICES {
        for column in 0..PATCH_VERTICES {
            for r in 0..5 {
                for c in 0..5 {
                    let from = (2 * half[1] + r) * PATCH_VERTICES + 2 * half[0] + c;
                    alpha[(row * PATCH_VERTICES + column, from)] = along[(row, r)] * along[(column, c)];
                }
            }
        }
    }
    alpha
}
