//! Unknown displacements of control vertices.
//!
//! Input: a [`Hierarchy`]. Output: which unknowns a leaf depends on, and for a [`Surface`] the direction of
//! each.
//!
//! Each node has one unknown: its vertex moves along the normal of the surface, since motion along the surface
//! does not change the shape. Vertices on creases change it in two directions, and those at corners, and where
//! creases meet, in three. Their further unknowns come after those of all nodes. Without creases, unknowns and
//! nodes are the same.
//!
//! Not guaranteed: that readings determine the further unknowns. Where the sides of a crease make no angle, it
//! slides along both.

use crate::hierarchy::Hierarchy;
use crate::surface::Surface;
use planish_core::DVec3;
use planish_core::vector3::tangents;
use planish_estimate::Result;

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

impl Surface {
    /// The unit direction of each unknown displacement.
    ///
    /// That of a node is the normal at its anchor; on a crease, the mean of the normals of all sides. A second
    /// one on a crease is perpendicular to it and to the crease. Those at a corner are perpendicular to each
    /// other.
    #[must_use]
    pub fn directions(&self) -> Vec<DVec3> {
        let mut directions = self.node_normals();
        for CreaseNode { node, places, along } in self.space().crease_nodes() {
            let normals = places.iter().filter_map(|&[u, v]| self.normal(u, v));
            let own = &mut directions[*node as usize];
            let mean = normals.sum::<DVec3>().try_normalize().unwrap_or(*own);
            let Some([du, dv]) = *along else {
                *own = mean;
                let (second, third) = tangents(mean);
                directions.extend([second, third]);
                continue;
            };
            let jet = self.jet(places[0][0], places[0][1]);
            let crease = (du * jet.du + dv * jet.dv).normalize_or_zero();
            *own = (mean - mean.dot(crease) * crease).try_normalize().unwrap_or(mean);
            let second = crease.cross(*own).try_normalize().unwrap_or_else(|| tangents(*own).0);
            directions.push(second);
        }
        directions
    }

    /// The surface with its vertices displaced by `steps` along the directions of all unknowns.
    ///
    /// # Errors
    /// `Input` if a coordinate is not finite.
    pub fn displaced(&self, directions: &[DVec3], steps: &[f64]) -> Result<Self> {
        let mut vertices = self.vertices().to_vec();
        for (unknown, (direction, step)) in directions.iter().zip(steps).enumerate() {
            vertices[self.space().node_of_unknown(unknown)] += *step * *direction;
        }
        self.with_vertices(vertices)
    }
}
