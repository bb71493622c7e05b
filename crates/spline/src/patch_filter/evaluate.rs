//! Evaluation of a patch filter: surface, σ and curvatures.

use super::criterion::{SubdivisionCriteria, SubdivisionReason, gaussian_curvature};
use super::filter::PatchFilter;
use super::options::StateLayout;
use super::quadtree::{SparseRow, VERTICES, vertex_of};
use crate::basis::cubic;
use crate::hierarchy::Cell;
use crate::surface::{Jet, Surface, jet_of, leaf_weights};
use planish_core::DVec3;
use planish_estimate::Result;
use std::collections::HashMap;
use std::sync::Arc;

impl PatchFilter {
    /// Gaussian curvature and its σ at the centres of the sixteen cells of a leaf patch; `None` if the
    /// surface is singular.
    #[must_use]
    pub fn curvatures(&self, patch: usize) -> Option<[[f64; 2]; 16]> {
        let h = f64::from(1_u32 << self.quadtree.patches[patch].depth);
        let orders = [[1, 0], [0, 1], [2, 0], [1, 1], [0, 2]];
        let basis = cubic(0.5);
        let mut out = [[0.0; 2]; 16];
        for (cell, to) in out.iter_mut().enumerate() {
            let jet = jet_of(&self.cell_coefficients(patch, cell), h, 0.5, 0.5);
            let (value, gradient) = gaussian_curvature(&jet)?;
            // dK = Σ_o ∂K/∂S_o · Σ_k c_ok P_k
            let mut form = [DVec3::ZERO; 16];
            for (order, slope) in orders.iter().zip(&gradient) {
                let scale = h.powi((order[0] + order[1]) as i32);
                for (k, f) in form.iter_mut().enumerate() {
                    let w = scale * basis[order[0]][k % 4] * basis[order[1]][k / 4];
                    *f += w * *slope;
                }
            }
            *to = [value, self.variance_of_form(patch, cell, &form).sqrt()];
        }
        Some(out)
    }

    /// Variance of `direction · S(u, v)` in the patch at `(u, v)`.
    #[must_use]
    pub fn variance_along(&self, u: f64, v: f64, direction: DVec3) -> f64 {
        let (leaf, [s, t]) = self.quadtree.space.locate(u, v);
        let (patch, cell) = self.quadtree.patch_of_leaf[leaf];
        // The patch of the point, not an average of copies: its covariance contains the readings of the patch
        // itself.
        let form = leaf_weights(s, t).map(|w| w * direction);
        self.variance_of_form(patch as usize, usize::from(cell), &form)
    }

    /// Covariance of the sixteen coefficients of a leaf cell, `16 × 16`, common to all unknown coordinates.
    /// `None` in the full layout, where coordinates differ.
    #[must_use]
    pub fn leaf_covariance(&self, leaf: usize) -> Option<Vec<f64>> {
        if self.options.layout == StateLayout::Full {
            return None;
        }
        let &(patch, cell) = self.quadtree.patch_of_leaf.get(leaf)?;
        let belief = &self.members[patch as usize].belief;
        let at = |k: usize| vertex_of(usize::from(cell), k);
        let entry = |k: usize| belief.covariance()[at(k / 16) * VERTICES + at(k % 16)];
        Some((0..256).map(entry).collect())
    }

    /// Number of leaf patches at the maximum depth that the criteria would subdivide further.
    #[must_use]
    pub fn held_back(&self, criteria: &SubdivisionCriteria) -> usize {
        let deepest = self.options.maximum_depth;
        (0..self.members.len())
            .filter(|&p| self.quadtree.patches[p].depth >= deepest && self.reason(p, criteria).is_some())
            .count()
    }

    pub(super) fn reason(&self, patch: usize, criteria: &SubdivisionCriteria) -> Option<SubdivisionReason> {
        criteria.reason(&self.members[patch].innovations, || self.curvatures(patch))
    }

    /// σ of the surface along its normal at `(u, v)`; `None` if it has no normal.
    #[must_use]
    pub fn sigma(&self, u: f64, v: f64) -> Option<f64> {
        let normal = self.jet(u, v).normal()?;
        Some(self.variance_along(u, v, normal).sqrt())
    }

    /// Point and derivatives at `(u, v)` in the patch there.
    #[must_use]
    pub fn jet(&self, u: f64, v: f64) -> Jet {
        let (leaf, [s, t]) = self.quadtree.space.locate(u, v);
        let (patch, cell) = self.quadtree.patch_of_leaf[leaf];
        let side = self.quadtree.space.leaves()[leaf].side();
        jet_of(&self.cell_coefficients(patch as usize, usize::from(cell)), 1.0 / side, s, t)
    }

    /// The surface of all patches. Copies of a vertex are averaged with inverse variances, so the surface is
    /// always C², whether reconciled or not.
    ///
    /// # Errors
    /// `Input` when a vertex is not finite.
    pub fn surface(&self) -> Result<Surface> {
        let mut sums: HashMap<Cell, [[f64; 2]; 3]> = HashMap::new();
        for (p, patch) in self.quadtree.patches.iter().enumerate() {
            for vertex in 0..VERTICES {
                let sum = sums.entry(self.quadtree.function(*patch, vertex)).or_default();
                let point = self.vertex(p, vertex);
                for d in 0..3 {
                    // The bound keeps weights finite for exactly known vertices.
                    // Copies of a vertex differ slightly between patches. Weights by information prefer the
                    // patch with readings near it.
                    let weight = 1.0 / self.vertex_variance(p, vertex, d).max(1e-200);
                    sum[d][0] += weight;
                    sum[d][1] += weight * point[d];
                }
            }
        }
        let space = &self.quadtree.space;
        let vertices = space.vertices_from(|cell| {
            let (patch, number) = self.quadtree.patch_of_leaf[space.leaf_over(cell).unwrap_or(0)];
            let patch = self.quadtree.patches[patch as usize];
            std::array::from_fn(|k| {
                let function = self.quadtree.function(patch, vertex_of(usize::from(number), k));
                sums.get(&function).map_or(DVec3::ZERO, |s| DVec3::from(s.map(|[w, wx]| wx / w)))
            })
        });
        Surface::new(Arc::clone(space), vertices)
    }

    /// The estimate of a vertex of a patch.
    fn vertex(&self, patch: usize, vertex: usize) -> DVec3 {
        let member = &self.members[patch];
        let mean = member.belief.mean();
        match self.options.layout {
            StateLayout::Height => {
                let at = member.initial[vertex];
                DVec3::new(at[0], at[1], mean[vertex])
            }
            _ => DVec3::new(mean[3 * vertex], mean[3 * vertex + 1], mean[3 * vertex + 2]),
        }
    }

    fn vertex_variance(&self, patch: usize, vertex: usize, coordinate: usize) -> f64 {
        let belief = &self.members[patch].belief;
        let at = match self.options.layout {
            StateLayout::Full => 3 * vertex + coordinate,
            _ => vertex,
        };
        belief.covariance()[at * belief.dimension() + at]
    }

    pub(super) fn cell_coefficients(&self, patch: usize, cell: usize) -> [DVec3; 16] {
        std::array::from_fn(|k| self.vertex(patch, vertex_of(cell, k)))
    }

    /// Variance of `Σ_k f_k · P_k` over the sixteen coefficients of a cell.
    fn variance_of_form(&self, patch: usize, cell: usize, form: &[DVec3; 16]) -> f64 {
        let belief = &self.members[patch].belief;
        let row_of = |d: usize| -> SparseRow {
            form.iter().enumerate().map(|(k, f)| (vertex_of(cell, k) as u16, f[d])).collect()
        };
        let variance = match self.options.layout {
            StateLayout::Height => belief.variance_of(&row_of(2)),
            // Coordinates share one covariance and are independent, so their variances add up.
            StateLayout::Isotropic | StateLayout::Normal => {
                (0..3).map(|d| belief.variance_of(&row_of(d))).sum()
            }
            StateLayout::Full => {
                let row: SparseRow = (0..3)
                    .flat_map(|d| row_of(usize::from(d)).into_iter().map(move |(k, w)| (3 * k + d, w)))
                    .collect();
                belief.variance_of(&row)
            }
        };
        variance.max(0.0)
    }
}
