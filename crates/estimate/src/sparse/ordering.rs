//! Elimination order of the nodes.
//!
//! Input: a pattern, and for the geometric ordering a point in the parameter plane per node. Output: a
//! permutation of nodes that keeps the factor sparse. Not guaranteed: minimum fill, which is NP-hard.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

use super::BlockPattern;
use super::pattern::Graph;
use crate::{Error, Result};

/// Parts of at most this many nodes are not dissected further.
///
/// On bicubic grids (7 × 7 stencil), values from 20 to 100 change the time of the factorisation by less than
/// 10 %.
const LEAF_NODES: usize = 40;
/// A cut at a coordinate is rejected if one part is smaller than this fraction of the whole. The cut then
/// uses the rank, which balances the parts but does not follow grid lines.
const MIN_SHARE: f64 = 0.3;

/// A permutation of nodes for elimination.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeOrdering {
    old_from_new: Vec<u32>,
}

impl NodeOrdering {
    /// The order of the node numbers.
    #[must_use]
    pub fn natural(nodes: usize) -> Self {
        Self { old_from_new: (0..nodes as u32).collect() }
    }

    /// A given permutation: `old_from_new[k]` is the k-th node to be eliminated.
    ///
    /// # Errors
    /// `Input` when a node is missing or repeated.
    pub fn from_permutation(old_from_new: Vec<u32>) -> Result<Self> {
        let mut seen = vec![false; old_from_new.len()];
        for &node in &old_from_new {
            match seen.get_mut(node as usize) {
                Some(place) if !*place => *place = true,
                _ => {
                    return Err(Error::input(format!(
                        "node {node} is repeated or does not exist: not a permutation"
                    )));
                }
            }
        }
        Ok(Self { old_from_new })
    }

    /// Approximate minimum degree ordering, for patterns without coordinates.
    ///
    /// # Errors
    /// `Unsupported` when the pattern is too large for the index type.
    ///
    /// # References
    /// Amestoy, Davis, Duff, *An approximate minimum degree ordering algorithm*, 1996; faer's implementation.
    pub fn amd(pattern: &BlockPattern) -> Result<Self> {
        let nodes = pattern.nodes();
        let too_large = |_| Error::unsupported("the pattern is too large for the minimum-degree ordering");
        // AMD uses the pattern of A + Aᵀ, so either triangle works. The lower triangle by columns is the
        // upper triangle by columns of the transpose.
        let mut starts: Vec<u64> = Vec::with_capacity(nodes + 1);
        let mut rows: Vec<u64> = Vec::with_capacity(pattern.entries());
        starts.push(0);
        for node in 0..nodes {
            rows.extend(pattern.column(node).iter().map(|&row| u64::from(row)));
            starts.push(rows.len() as u64);
        }
        let matrix = SymbolicSparseColMatRef::new_checked(nodes, nodes, &starts, None, &rows);
        let mut memory = MemBuffer::try_new(amd::order_scratch::<u64>(nodes, rows.len()))
            .map_err(|_| Error::unsupported("not enough memory for the minimum-degree ordering"))?;
        let (mut forward, mut inverse) = (vec![0_u64; nodes], vec![0_u64; nodes]);
        amd::order(&mut forward, &mut inverse, matrix, amd::Control::default(), MemStack::new(&mut memory))
            .map_err(too_large)?;
        Self::from_permutation(forward.into_iter().map(|node| node as u32).collect())
    }

    /// Geometric nested dissection: halves the nodes recursively at a coordinate. Nodes between the halves
    /// come last.
    ///
    /// `coordinates[node]` is a point in the parameter plane, in any unit. Each part is cut in both
    /// directions; the better compromise of separator size and balance is kept. The separator is found in the
    /// graph: the nodes of one half that are coupled to the other. Periodic directions and refinement levels
    /// therefore need no special treatment. Cost: O(e log n) for e entries of the pattern.
    ///
    /// # Errors
    /// `Input` when coordinates are missing or not finite.
    ///
    /// # Examples
    /// ```
    /// use planish_estimate::sparse::{BlockPattern, NodeOrdering};
    ///
    /// let pattern = BlockPattern::from_elements(3, [[0, 1], [1, 2]])?;
    /// let ordering = NodeOrdering::nested_dissection(&pattern, &[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])?;
    /// assert_eq!(ordering.old_from_new().len(), 3);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    ///
    /// # References
    /// George, *Nested dissection of a regular finite element mesh*, 1973.
    pub fn nested_dissection(pattern: &BlockPattern, coordinates: &[[f64; 2]]) -> Result<Self> {
        if coordinates.len() != pattern.nodes() {
            return Err(Error::input(format!(
                "expected a point for each of {} nodes for nested dissection, found {}",
                pattern.nodes(),
                coordinates.len()
            )));
        }
        if let Some(node) = coordinates.iter().position(|point| !point.iter().all(|value| value.is_finite()))
        {
            return Err(Error::input(format!("node {node}: expected finite coordinates")));
        }
        let mut dissection = Dissection {
            graph: Graph::renamed(pattern, |node| node),
            coordinates,
            side: vec![OUTSIDE; pattern.nodes()],
            order: Vec::with_capacity(pattern.nodes()),
        };
        dissection.dissect((0..pattern.nodes() as u32).collect());
        Ok(Self { old_from_new: dissection.order })
    }

    /// The nodes in elimination order.
    #[must_use]
    pub fn old_from_new(&self) -> &[u32] {
        &self.old_from_new
    }
}

const OUTSIDE: u8 = 0;
const LOW: u8 = 1;
const HIGH: u8 = 2;

struct Dissection<'a> {
    graph: Graph,
    coordinates: &'a [[f64; 2]],
    /// The half of the current part to which each node belongs.
    side: Vec<u8>,
    order: Vec<u32>,
}

/// Two parts that are coupled only through the separator.
struct Cut {
    low: Vec<u32>,
    high: Vec<u32>,
    separator: Vec<u32>,
}

impl Cut {
    /// Cost of a cut: the size of the separator, increased by the imbalance of the parts.
    fn cost(&self) -> f64 {
        let total = (self.low.len() + self.high.len() + self.separator.len()) as f64;
        let larger_half = self.low.len().max(self.high.len()) as f64;
        self.separator.len() as f64 * (1.0 + 2.0 * (larger_half / total - 0.5).max(0.0))
    }
}

impl Dissection<'_> {
    fn dissect(&mut self, mut piece: Vec<u32>) {
        if piece.len() <= LEAF_NODES {
            // Sorted, so that the order does not depend on the selection algorithm of the cuts.
            piece.sort_unstable();
            self.order.append(&mut piece);
            return;
        }
        // Both directions are tried. The longer side is not always better: refined regions and periodic
        // directions change the size of a separator.
        let (first, second) = (self.cut(&piece, 0), self.cut(&piece, 1));
        let (mut cut, along) = if second.cost() < first.cost() { (second, 0) } else { (first, 1) };
        if cut.low.is_empty() && cut.high.is_empty() {
            // All nodes are coupled, so no cut exists.
            piece.sort_unstable();
            self.order.append(&mut piece);
            return;
        }
        // Freed before recursion; otherwise a copy of every level would be alive.
        drop(piece);
        // The separator comes last. Eliminating it earlier would couple both halves.
        self.dissect(cut.low);
        self.dissect(cut.high);
        let coordinates = self.coordinates;
        let place = |node: u32| coordinates[node as usize];
        // Sorted along its own direction, so that rows of a front are contiguous in that of the parent and
        // are added in long runs.
        cut.separator.sort_unstable_by(|&a, &b| {
            place(a)[along]
                .total_cmp(&place(b)[along])
                .then(place(a)[1 - along].total_cmp(&place(b)[1 - along]))
                .then(a.cmp(&b))
        });
        self.order.append(&mut cut.separator);
    }

    /// Halves a part at a coordinate of the given axis and extracts the separator.
    fn cut(&mut self, piece: &[u32], axis: usize) -> Cut {
        let value = |node: u32| self.coordinates[node as usize][axis];
        let mut sorted = piece.to_vec();
        let middle = sorted.len() / 2;
        let by_rank = |a: &u32, b: &u32| value(*a).total_cmp(&value(*b)).then(a.cmp(b));
        // Selection is linear; sorting each part at every level would add a factor of log n.
        let (_, &mut median, _) = sorted.select_nth_unstable_by(middle, by_rank);
        let at = value(median);
        // Nodes with exactly the coordinate of the median go to the same side, so that grid lines are not
        // split.
        let below = piece.iter().filter(|&&node| value(node) < at).count();
        let up_to = piece.iter().filter(|&&node| value(node) <= at).count();
        let share = |count: usize| count.min(piece.len() - count) as f64 / piece.len() as f64;
        let is_low: Box<dyn Fn(u32) -> bool> = if share(below).max(share(up_to)) < MIN_SHARE {
            Box::new(|node| by_rank(&node, &median).is_lt())
        } else if share(below) >= share(up_to) {
            Box::new(|node| value(node) < at)
        } else {
            Box::new(|node| value(node) <= at)
        };
        for &node in piece {
            self.side[node as usize] = if is_low(node) { LOW } else { HIGH };
        }
        drop(is_low);

        let touches = |node: u32, other: u8| {
            self.graph
                .neighbours(node as usize)
                .iter()
                .any(|&neighbour| self.side[neighbour as usize] == other)
        };
        let (mut border, mut count) = (vec![false; piece.len()], [0_usize; 2]);
        let mut size = [0_usize; 2];
        for (&node, at_border) in piece.iter().zip(&mut border) {
            let side = self.side[node as usize];
            size[usize::from(side - LOW)] += 1;
            if touches(node, LOW + HIGH - side) {
                *at_border = true;
                count[usize::from(side - LOW)] += 1;
            }
        }
        // If both borders have the same size, use that of the larger half.
        let from_low = count[0] < count[1] || (count[0] == count[1] && size[0] >= size[1]);
        let giving = if from_low { LOW } else { HIGH };
        let mut cut = Cut { low: Vec::new(), high: Vec::new(), separator: Vec::new() };
        for (&node, &at_border) in piece.iter().zip(&border) {
            let side = self.side[node as usize];
            if at_border && side == giving {
                cut.separator.push(node);
            } else if side == LOW {
                cut.low.push(node);
            } else {
                cut.high.push(node);
            }
        }
        // Nodes outside the current part must not count as neighbours of a later one.
        for &node in piece {
            self.side[node as usize] = OUTSIDE;
        }
        cut
    }
}
