//! Hierarchies over domains of any topology.
//!
//! Input: a [`QuadDomain`] and the split cells. Output: numbered nodes and leaves with their extraction.
//!
//! Each level has the vertices of the divided domain. A vertex of a level is a node if all cells that depend
//! on it exist, and not all of them are split. Where finer cells need a vertex that is not a node, it follows
//! from the coarser level by the rules of Catmull and Clark: the truncation of hierarchical B-splines.
//!
//! Cells at an extraordinary vertex have 4 × 4 leaves, two levels below the cell. All cells around such a
//! vertex are split together. Where they are, the surface changes slightly, since the finer space does not
//! contain the coarser one there.

use super::cell_tree::{CellTree, children};
use super::{Cell, CreaseNode, Hierarchy, MAX_LEVEL, Topology, places::in_quad};
use crate::quad_domain::{
    Level, LevelCell, Neighbourhood, PIECES, QuadDomain, Weighted, leaf_weights, to_edge,
};
use planish_estimate::{Error, Result};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::Arc;

/// Levels between a cell at an extraordinary vertex and its leaves.
pub(super) const PIECE_LEVELS: u8 = PIECES.trailing_zeros() as u8;

/// Quads that one thread finds the leaves of at a time. The numbers do not depend on it.
const QUADS_PER_WALK: usize = 32;

/// Weighted nodes.
pub(crate) type Combination = Vec<(u32, f64)>;

/// A map from numbers or cells, which come from no one who could choose them to collide.
pub(super) type NumberMap<K, V> = HashMap<K, V, BuildHasherDefault<NumberHasher>>;

/// Hashes a few numbers.
#[derive(Debug, Default)]
pub(super) struct NumberHasher(u64);

impl Hasher for NumberHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u64(byte.into()));
    }

    fn write_u8(&mut self, number: u8) {
        self.write_u64(number.into());
    }

    fn write_u32(&mut self, number: u32) {
        self.write_u64(number.into());
    }

    fn write_u64(&mut self, number: u64) {
        // An odd factor near 2⁶⁴ divided by the golden ratio spreads numbers over the upper bits.
        self.0 = (self.0.rotate_left(26) ^ number).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    }

    fn write_usize(&mut self, number: usize) {
        self.write_u64(number as u64);
    }
}

/// The node of each vertex of a level.
pub(super) type LevelNodes = NumberMap<usize, u32>;

/// What a hierarchy over a domain of quads knows besides its leaves.
#[derive(Debug, Clone)]
pub(super) struct OverQuads {
    pub(super) domain: Arc<QuadDomain>,
    /// For each level, the nodes of its vertices.
    nodes: Vec<LevelNodes>,
    /// The nodes on creases, in ascending order, and the node of each further unknown.
    crease_nodes: Vec<CreaseNode>,
    further_unknowns: Vec<u32>,
}

impl OverQuads {
    fn new(domain: &Arc<QuadDomain>) -> Self {
        Self {
            domain: Arc::clone(domain),
            nodes: Vec::new(),
            crease_nodes: Vec::new(),
            further_unknowns: Vec::new(),
        }
    }

    /// Finds the nodes on creases from the anchors of all.
    fn find_crease_nodes(&mut self, anchors: &[[f64; 2]]) {
        if self.domain.creases().is_empty() {
            return;
        }
        let on_crease = |(node, &[u, v]): (usize, &[f64; 2])| {
            let quad = u as u32;
            // The far side of a quad is a rounding error before its end.
            let at = if u.next_up() >= f64::from(quad + 1) { [1.0, v] } else { [u - f64::from(quad), v] };
            let place = self.domain.place_on_crease(quad, at)?;
            let places = place.around.into_iter().map(|(quad, at)| in_quad(quad, at)).collect();
            Some(CreaseNode { node: node as u32, places, along: place.along })
        };
        self.crease_nodes = anchors.iter().enumerate().filter_map(on_crease).collect();
        let further = self.crease_nodes.iter().flat_map(|n| vec![n.node; n.further_unknowns()]);
        self.further_unknowns = further.collect();
    }

    /// The nodes of a finer hierarchy over the same domain as weighted nodes of this one.
    fn refined_nodes(&self, finer: &Self) -> Vec<Combination> {
        let mut known = Coefficients::new(self);
        let mut found = vec![Vec::new(); finer.nodes.iter().map(|nodes| nodes.len()).sum()];
        for (level, nodes) in finer.nodes.iter().enumerate() {
            for (&vertex, &node) in nodes {
                found[node as usize] = known.of(level, vertex).clone();
            }
        }
        found
    }
}

/// The coefficients at vertices of all levels as weighted nodes.
struct Coefficients<'a> {
    over: &'a OverQuads,
    /// For each level, those that are no nodes and were asked for.
    known: Vec<NumberMap<usize, Combination>>,
    one: Combination,
}

impl<'a> Coefficients<'a> {
    fn new(over: &'a OverQuads) -> Self {
        Self { over, known: Vec::new(), one: Vec::new() }
    }

    fn of(&mut self, level: usize, vertex: usize) -> &Combination {
        if let Some(&node) = self.over.nodes.get(level).and_then(|nodes| nodes.get(&vertex)) {
            self.one = vec![(node, 1.0)];
            return &self.one;
        }
        if self.known.len() <= level {
            self.known.resize_with(level + 1, NumberMap::default);
        }
        if !self.known[level].contains_key(&vertex) {
            let mut sum: Combination = Vec::new();
            // On level 0 all vertices are nodes, or all cells around them are split and nobody asks.
            if let Some(coarser) = level.checked_sub(1) {
                let domain = Arc::clone(&self.over.domain);
                let levels = [level, coarser].map(|l| Level::new(&domain, l));
                for (parent, weight) in levels[0].parents(&levels[1], vertex) {
                    for &(node, w) in self.of(coarser, parent) {
                        match sum.iter_mut().find(|(n, _)| *n == node) {
                            Some((_, own)) => *own += weight * w,
                            None => sum.push((node, weight * w)),
                        }
                    }
                }
            }
            self.known[level].insert(vertex, sum);
        }
        &self.known[level][&vertex]
    }
}

impl Hierarchy {
    /// The unrefined hierarchy over a domain of quads.
    ///
    /// Parameters: `u` is the number of the quad plus the place along its first side, `v` the place along its
    /// second one.
    ///
    /// # Errors
    /// `Input` for a quad with several corners that have not four quads (divide the domain first), and for
    /// vertices on a border that have more than two.
    ///
    /// # Examples
    /// The faces of a cube, divided once:
    /// ```
    /// use planish_spline::{Hierarchy, QuadDomain};
    /// let cube = QuadDomain::new(&[
    ///     [0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5],
    /// ])?;
    /// let space = Hierarchy::over(cube.divided()?.domain.into())?;
    /// // Each of the 24 quads has a corner with three quads, so it has 4 × 4 leaves.
    /// assert_eq!((space.node_count(), space.leaves().len()), (26, 24 * 16));
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    pub fn over(domain: Arc<QuadDomain>) -> Result<Self> {
        domain.check_spline()?;
        let quads = domain.cells().len();
        if quads > 1 << 17 {
            return Err(Error::input(format!("a domain of {quads} quads is too large")));
        }
        Ok(Self::build_over(domain, CellTree::new([quads, 1])))
    }

    /// The hierarchy over a domain of quads whose leaves are exactly the given cells.
    ///
    /// # Errors
    /// As for [`Hierarchy::over`]; `Input` when the cells do not tile the domain exactly once, or break the
    /// rules of grading.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{Hierarchy, QuadDomain};
    /// use std::sync::Arc;
    /// let domain = Arc::new(QuadDomain::new(&[[0, 1, 4, 3], [1, 2, 5, 4]])?);
    /// let refined = Hierarchy::over(domain.clone())?.refine(&[1]);
    /// let rebuilt = Hierarchy::over_leaves(domain, refined.leaves())?;
    /// assert_eq!(rebuilt.leaves(), refined.leaves());
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    pub fn over_leaves(domain: Arc<QuadDomain>, leaves: &[Cell]) -> Result<Self> {
        let mut split = Self::over(Arc::clone(&domain))?.cells;
        let quads = domain.cells().len();
        let all: HashSet<Cell> = leaves.iter().copied().collect();
        for &leaf in leaves {
            if usize::from(leaf.level) > MAX_LEVEL || !split.is_inside(leaf) {
                return Err(Error::input(format!("cell {leaf:?} lies outside the {quads} quads")));
            }
            // A leaf is a piece of a cell at an extraordinary vertex if the leaf at the vertex has its level:
            // where the cell is split, that one is finer.
            let of_piece = leaf.level.checked_sub(PIECE_LEVELS).and_then(|level| {
                let cell = Cell { level, i: leaf.i >> PIECE_LEVELS, j: leaf.j >> PIECE_LEVELS };
                let corner = Level::new(&domain, level.into()).extraordinary_corner(level_cell(cell))?;
                let last = PIECES as u32 - 1;
                let [x, y] = [[0, 0], [last, 0], [last, last], [0, last]][corner as usize];
                let [i, j] = [(cell.i << PIECE_LEVELS) + x, (cell.j << PIECE_LEVELS) + y];
                all.contains(&Cell { level: leaf.level, i, j }).then_some(cell)
            });
            if let Some(parent) = of_piece.unwrap_or(leaf).parent() {
                split.split(parent);
            }
        }
        close(&domain, &mut split);
        let built = Self::build_over(domain, split);
        let sorted = |cells: &[Cell]| {
            let mut cells = cells.to_vec();
            cells.sort_unstable();
            cells
        };
        if sorted(leaves) != sorted(&built.leaves) {
            return Err(Error::input(
                "the cells do not tile the quads exactly once, or break the rules of grading",
            ));
        }
        Ok(built)
    }

    /// Over a domain of quads, the nodes of a finer hierarchy as weighted nodes of this one: by the rules of
    /// Catmull and Clark, so at extraordinary vertices that are split the surface changes slightly.
    pub(crate) fn refined_nodes(&self, finer: &Self) -> Option<Vec<Combination>> {
        self.quads().zip(finer.quads()).map(|(coarse, fine)| coarse.refined_nodes(fine))
    }

    /// The domain of quads; none for the other shapes.
    #[must_use]
    pub fn domain(&self) -> Option<&Arc<QuadDomain>> {
        self.quads().map(|over| &over.domain)
    }

    /// True if the domain has creases.
    #[must_use]
    pub fn has_creases(&self) -> bool {
        self.domain().is_some_and(|domain| !domain.creases().is_empty())
    }

    /// The nodes on creases, in ascending order.
    pub(crate) fn crease_nodes(&self) -> &[CreaseNode] {
        self.quads().map_or(&[], |over| &over.crease_nodes)
    }

    /// The node of each unknown beyond the first of all nodes, in ascending order.
    pub(crate) fn further_unknowns(&self) -> &[u32] {
        self.quads().map_or(&[], |over| &over.further_unknowns)
    }

    /// The hierarchy with numbered nodes but without leaves, and the nodes of vertices.
    pub(super) fn numbered_over(domain: &Arc<QuadDomain>, split: CellTree) -> (Self, OverQuads) {
        let mut over = OverQuads::new(domain);
        let mut made = Self::empty(Topology::Quads(over.clone()), [domain.cells().len(), 1], split);
        over.nodes = (0..made.cells.levels()).map(|level| made.number_vertices(domain, level)).collect();
        over.find_crease_nodes(&made.node_anchors);
        (made, over)
    }

    pub(super) fn build_over(domain: Arc<QuadDomain>, split: CellTree) -> Self {
        let (mut made, over) = Self::numbered_over(&domain, split);
        let quads: Vec<u32> = (0..made.base[0] as u32).collect();
        let walks: Vec<QuadLeaves> = quads
            .par_chunks(QUADS_PER_WALK)
            .map(|own| {
                let mut walk = QuadWalk {
                    levels: (0..made.cells.levels()).map(|level| Level::new(&domain, level)).collect(),
                    coefficients: Coefficients::new(&over),
                    hierarchy: &made,
                    found: QuadLeaves::default(),
                };
                own.iter().for_each(|&i| walk.descend(Cell { level: 0, i, j: 0 }));
                walk.found
            })
            .collect();
        walks.into_iter().for_each(|found| made.append(found));
        made.topology = Topology::Quads(over);
        made
    }

    /// Adds leaves after those found before.
    fn append(&mut self, found: QuadLeaves) {
        let (first_leaf, first_node) = (self.leaves.len() as u32, self.nodes.len() as u32);
        for (cell, leaf, has_pieces) in found.cells {
            self.cells.number(cell, first_leaf + leaf, has_pieces);
        }
        self.leaves.extend(found.leaves);
        self.offsets.extend(found.ends.into_iter().map(|end| first_node + end));
        self.nodes.extend(found.nodes);
        self.weights.extend(found.weights);
    }

    /// Numbers the nodes of a level, and stores their anchors.
    fn number_vertices(&mut self, domain: &QuadDomain, level: usize) -> LevelNodes {
        let of_level = Level::new(domain, level);
        let cells = self.cells.cells(level);
        let used = cells.par_iter().with_min_len(256);
        let used = used.flat_map_iter(|&cell| of_level.neighbourhood(level_cell(cell)).vertices());
        let mut used: Vec<usize> = used.collect();
        used.par_sort_unstable();
        used.dedup();
        // The search for the cells that depend on a vertex takes the time. Nodes are numbered after it.
        let found: Vec<(usize, [f64; 2])> = used
            .into_par_iter()
            .with_min_len(256)
            .filter_map(|vertex| {
                let users = of_level.users(vertex).into_iter().map(|cell| cell_of_level(cell, level));
                let (mut exist, mut are_split) = (true, true);
                for cell in users {
                    exist &= self.cells.contains(cell);
                    are_split &= self.cells.is_split(cell);
                }
                (exist && !are_split).then(|| {
                    let (quad, at) = of_level.nearest_inner_place(vertex);
                    let side = 1.0 / (1_u64 << level) as f64;
                    (vertex, in_quad(quad, at.map(|x| x as f64 * side)))
                })
            })
            .collect();
        let mut nodes = LevelNodes::default();
        nodes.reserve(found.len());
        for (vertex, anchor) in found {
            nodes.insert(vertex, self.node_anchors.len() as u32);
            self.node_anchors.push(anchor);
        }
        nodes
    }
}

/// Splits further cells until the rules of grading are satisfied: the parent of a split cell and all cells
/// around its corners are split, and so are all cells around an extraordinary vertex if one is.
pub(super) fn close(domain: &QuadDomain, split: &mut CellTree) {
    split.close(|cell, also| {
        let require = |level: usize, cells: Vec<LevelCell>, of: &Level, also: &mut Vec<Cell>| {
            let inner = cells.into_iter().filter(|&cell| of.is_inner(cell));
            also.extend(inner.map(|cell| cell_of_level(cell, level)));
        };
        let level = usize::from(cell.level);
        let (of_level, own) = (Level::new(domain, level), level_cell(cell));
        if let Some(corner) = of_level.extraordinary_corner(own) {
            let vertex = of_level.corners(own)[corner as usize];
            require(level, of_level.around(vertex), &of_level, also);
        }
        if let (Some(coarser), Some(parent)) = (level.checked_sub(1), cell.parent()) {
            let of_coarser = Level::new(domain, coarser);
            for vertex in of_coarser.corners(level_cell(parent)) {
                require(coarser, of_coarser.around(vertex), &of_coarser, also);
            }
        }
    });
}

/// A cell in the frame of its quad.
fn level_cell(cell: Cell) -> LevelCell {
    let quad = cell.i >> cell.level;
    LevelCell { quad, at: [i64::from(cell.i - (quad << cell.level)), i64::from(cell.j)] }
}

fn cell_of_level(LevelCell { quad, at: [x, y] }: LevelCell, level: usize) -> Cell {
    Cell { level: level as u8, i: (quad << level) + x as u32, j: y as u32 }
}

/// The coefficients of a weighted sum of vertices, as those of its vertices.
fn weighted_entries((vertices, weights): (&Weighted, [f64; 16])) -> impl Iterator<Item = (usize, [f64; 16])> {
    vertices.iter().map(move |&(vertex, share)| (vertex, weights.map(|w| share * w)))
}

/// Leaves over some quads in order, with their extraction. Numbers count from the first of them.
#[derive(Default)]
struct QuadLeaves {
    leaves: Vec<Cell>,
    /// For each leaf, the number of nodes up to its last.
    ends: Vec<u32>,
    nodes: Vec<u32>,
    weights: Vec<[f64; 16]>,
    /// Cells with their first leaf, and whether it is one of several.
    cells: Vec<(Cell, u32, bool)>,
}

/// Traversal that finds the leaves in order, with their extraction.
struct QuadWalk<'a> {
    levels: Vec<Level<'a>>,
    coefficients: Coefficients<'a>,
    hierarchy: &'a Hierarchy,
    found: QuadLeaves,
}

impl QuadWalk<'_> {
    fn descend(&mut self, cell: Cell) {
        if self.hierarchy.cells.is_split(cell) {
            return children(cell).into_iter().for_each(|child| self.descend(child));
        }
        let one = |k: usize| std::array::from_fn(|j| f64::from(u8::from(j == k)));
        match self.levels[usize::from(cell.level)].neighbourhood(level_cell(cell)) {
            Neighbourhood::Regular(vertices) => {
                self.number_leaf(cell, false);
                self.add_leaf(cell, cell.level, vertices.iter().enumerate().map(|(k, &v)| (v, one(k))));
            }
            Neighbourhood::Creased(vertices) => {
                self.number_leaf(cell, false);
                let entries = vertices.iter().enumerate().map(|(k, weighted)| (weighted, one(k)));
                self.add_leaf(cell, cell.level, entries.flat_map(weighted_entries));
            }
            Neighbourhood::Around { corner, shape, cell: number, vertices } => {
                self.number_leaf(cell, true);
                let weights = &leaf_weights(shape)[number];
                for row in 0..PIECES {
                    for column in 0..PIECES {
                        // The same leaf in the frame in which the corner is at (0, 0).
                        let last = PIECES - 1;
                        let [s, t] = to_edge(corner, [column, row], last);
                        let turned = weights[t * PIECES + s].iter().map(|w| {
                            std::array::from_fn(|k| {
                                let [s, t] = to_edge(corner, [k % 4, k / 4], 3);
                                w[4 * t + s]
                            })
                        });
                        let piece = Cell {
                            level: cell.level + PIECE_LEVELS,
                            i: (cell.i << PIECE_LEVELS) + column as u32,
                            j: (cell.j << PIECE_LEVELS) + row as u32,
                        };
                        let entries = vertices.iter().zip(turned).flat_map(weighted_entries);
                        self.add_leaf(piece, cell.level, entries);
                    }
                }
            }
        }
    }

    /// The next leaf is this cell, or the first of its pieces.
    fn number_leaf(&mut self, cell: Cell, has_pieces: bool) {
        self.found.cells.push((cell, self.found.leaves.len() as u32, has_pieces));
    }

    /// A leaf with the vertices of a level and their weights.
    fn add_leaf(&mut self, leaf: Cell, level: u8, entries: impl Iterator<Item = (usize, [f64; 16])>) {
        let mut merged: Vec<(u32, [f64; 16])> = Vec::with_capacity(20);
        for (vertex, weights) in entries {
            for &(node, share) in self.coefficients.of(usize::from(level), vertex) {
                let at = merged.iter().position(|(n, _)| *n == node).unwrap_or_else(|| {
                    merged.push((node, [0.0; 16]));
                    merged.len() - 1
                });
                (0..16).for_each(|k| merged[at].1[k] += share * weights[k]);
            }
        }
        merged.retain(|(_, weights)| weights.iter().any(|&w| w != 0.0));
        merged.sort_unstable_by_key(|(node, _)| *node);
        let found = &mut self.found;
        found.leaves.push(leaf);
        found.nodes.extend(merged.iter().map(|(node, _)| node));
        found.weights.extend(merged.iter().map(|(_, weights)| weights));
        found.ends.push(found.nodes.len() as u32);
    }
}

#[cfg(test)]
mod tests;
