//! σ of a surface from few readings, with the uncertainty of σ and of the smoothness weight.
//!
//! Input: the posterior of the heights of a surface over its base. Output: for each leaf, the part of σ² that
//! the stored information, which has one weight and one σ, does not contain.

use crate::model::Posterior;
use nalgebra::DVector;
use planish_core::DVec3;
use planish_estimate::{Result, SmoothnessPosterior};
use planish_spline::{Surface, leaf_weights, quadrature};
use rayon::prelude::*;

/// The posterior of the heights at the nodes, along one direction each.
pub(super) struct MarginalHeights {
    pub posterior: SmoothnessPosterior,
    pub directions: Vec<DVec3>,
}

impl MarginalHeights {
    /// The change of a row of the sixteen coefficients of a leaf, seen along `normal`, with the heights.
    pub(super) fn row(&self, surface: &Surface, leaf: usize, c: &[f64; 16], normal: DVec3) -> DVector<f64> {
        row_of_heights(&self.directions, surface, leaf, c, normal)
    }

    /// Variance of the surface along its normal.
    pub(super) fn variance_in(&self, surface: &Surface, leaf: usize, [s, t]: [f64; 2]) -> f64 {
        let normal = surface.leaf_jet(leaf, s, t).normal().unwrap_or_default();
        self.posterior.variance(&self.row(surface, leaf, &leaf_weights(s, t), normal))
    }

    /// For each leaf, the mean over its area of the variance that `stored` lacks.
    ///
    /// # Errors
    /// As for [`Posterior::leaf`].
    pub(super) fn excess(&self, stored: &Posterior<'_>) -> Result<Vec<f64>> {
        let surface = stored.surface();
        (0..surface.space().leaves().len())
            .into_par_iter()
            .map(|leaf| {
                let cell = stored.leaf(leaf)?;
                let mut sum = 0.0;
                for q in quadrature() {
                    let normal = surface.leaf_jet(leaf, q.local[0], q.local[1]).normal().unwrap_or_default();
                    let own = cell.variance_along(&leaf_weights(q.local[0], q.local[1]), normal);
                    sum += q.weight * (self.variance_in(surface, leaf, q.local) - own);
                }
                Ok(sum.max(0.0))
            })
            .collect()
    }
}

/// See [`MarginalHeights::row`].
pub(super) fn row_of_heights(
    directions: &[DVec3],
    surface: &Surface,
    leaf: usize,
    c: &[f64; 16],
    normal: DVec3,
) -> DVector<f64> {
    let (nodes, weights) = surface.space().extraction(leaf);
    let mut row = DVector::zeros(directions.len());
    for (&node, weights) in nodes.iter().zip(weights) {
        let at_point: f64 = weights.iter().zip(c).map(|(w, c)| w * c).sum();
        row[node as usize] += at_point * normal.dot(directions[node as usize]);
    }
    row
}
