//! Unknown displacements of control vertices.
//!
//! Each node has one unknown: its vertex moves along the normal of the surface, since motion along the
//! surface does not change the shape. Vertices on creases change it in two directions, and those at corners,
//! and where creases meet, in three. Their further unknowns come after those of all nodes. Without creases,
//! unknowns and nodes are the same.

use super::Hierarchy;

/// A node on a crease.
#[derive(Debug, Clone)]
pub(crate) struct CreaseNode {
    pub(crate) node: u32,
    /// Parameters of its anchor in each cell around it.
    pub(crate) places: Vec<[f64; 2]>,
    /// The direction of the crease in parameters of the first place; none where the vertex moves freely.
    pub(crate) along: Option<[f64; 2]>,
}

impl CreaseNode {
    pub(crate) fn further_unknowns(&self) -> usize {
        if self.along.is_some() { 1 } else { 2 }
    }
}

impl Hierarchy {
    /// Number of unknown displacements: one for each node, one more for each on a crease, and two more for
    /// each at a corner.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{Hierarchy, QuadDomain};
    /// let cells = [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6]];
    /// let flat = Hierarchy::over(QuadDomain::new(&cells)?.into())?;
    /// let creased = Hierarchy::over(QuadDomain::with_creases(&cells, &[[1, 5]], &[])?.into())?;
    /// assert_eq!(flat.unknown_count(), flat.node_count());
    /// // Both vertices of the crease, and those beyond the borders at which it ends.
    /// assert_eq!(creased.unknown_count(), creased.node_count() + 4);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn unknown_count(&self) -> usize {
        self.node_count() + self.further_unknowns().len()
    }

    /// The node of an unknown.
    #[must_use]
    pub fn node_of_unknown(&self, unknown: usize) -> usize {
        match unknown.checked_sub(self.node_count()) {
            None => unknown,
            Some(further) => self.further_unknowns()[further] as usize,
        }
    }

    /// The unknowns on which a leaf depends, each with the weights of its node in the sixteen coefficients.
    pub fn unknowns(&self, leaf: usize) -> impl Iterator<Item = (u32, &[f64; 16])> {
        let (nodes, weights) = self.extraction(leaf);
        let further = self.further_unknowns();
        let of_node = move |node: u32| {
            let first = further.partition_point(|&n| n < node);
            let count = further[first..].iter().take_while(|&&n| n == node).count();
            (first..first + count).map(|k| (self.node_count() + k) as u32)
        };
        let all = move || nodes.iter().copied().zip(weights);
        let on_creases = all().filter(move |_| !further.is_empty());
        all().chain(on_creases.flat_map(move |(node, weights)| of_node(node).map(move |k| (k, weights))))
    }
}
