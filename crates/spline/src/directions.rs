//! Directions in which control vertices move.
//!
//! Input: a [`Surface`]. Output: the direction of each unknown displacement (see
//! [`Hierarchy::unknown_count`](crate::Hierarchy::unknown_count)), and displaced surfaces.
//!
//! Not guaranteed: that readings determine the further unknowns of vertices on creases. Where the sides of a
//! crease make no angle, it slides along both.

use crate::hierarchy::CreaseNode;
use crate::surface::Surface;
use planish_core::DVec3;
use planish_core::vector3::tangents;
use planish_estimate::Result;

impl Surface {
    /// The unit direction of each unknown displacement.
    ///
    /// That of a node is the normal at its anchor; on a crease, the mean of the normals of all sides. A
    /// second one on a crease is perpendicular to it and to the crease. Those at a corner are perpendicular
    /// to each other.
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

    /// The displacement of each vertex by `steps` along the directions of all unknowns.
    #[must_use]
    pub fn displacements(&self, directions: &[DVec3], steps: &[f64]) -> Vec<DVec3> {
        let mut moved = vec![DVec3::ZERO; self.vertices().len()];
        for (unknown, (direction, step)) in directions.iter().zip(steps).enumerate() {
            moved[self.space().node_of_unknown(unknown)] += *step * *direction;
        }
        moved
    }

    /// The surface after [`Surface::displacements`].
    ///
    /// # Errors
    /// `Input` if a coordinate is not finite.
    pub fn displaced(&self, directions: &[DVec3], steps: &[f64]) -> Result<Self> {
        let moved = self.displacements(directions, steps);
        self.with_vertices(self.vertices().iter().zip(moved).map(|(p, by)| *p + by).collect())
    }
}
