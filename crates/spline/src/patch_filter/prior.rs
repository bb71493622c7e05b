//! The smoothness prior of the patch filter and the global filter.
//!
//! Input: a weight, a hold, and the surface that defines the metric. Output: the information of the prior
//! over the nodes of a hierarchy, and the prior covariance of the vertices of any patch.
//!
//! The deviation `x` of each coordinate from the initial surface has the density `exp(−½ xᵀ Λ x)` with
//!
//! ```text
//! Λ = weight · (K + hold · M),    K = ∫ |∇∇f|² dA (thin plate),    M = ∫ f² dA.
//! ```
//!
//! The hold makes the prior proper, as a filter in covariance form requires: without it planes would have
//! infinite variance. Both forms are integrals over the same surface. Therefore the priors of a coarse and a
//! finer space are related by `αᵀ Λ_f α = Λ_c`, exactly for the metric of a plane.

use super::quadtree::{Quadtree, VERTICES};
use crate::energy::LeafEnergy;
use crate::hierarchy::{Hierarchy, Shape};
use crate::surface::Surface;
use crate::system::SurfaceSystem;
use nalgebra::DMatrix;
use planish_core::DVec3;
use planish_estimate::sparse::{
    BlockInformation, BlockPattern, CholeskyFactor, NodeOrdering, SelectedInverse, SymbolicFactor,
};
use planish_estimate::{Error, Result};
use std::sync::Arc;

/// A proper smoothness prior on the deviation from an initial surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothnessPrior {
    /// Weight of the thin-plate energy: 1 over the model's unit squared, per unit of energy.
    pub weight: f64,
    /// Weight of `∫ f² dA` relative to the energy, in 1/length⁴ of the metric. It suppresses features much
    /// longer than `hold^(−1/4)`.
    pub hold: f64,
}

impl SmoothnessPrior {
    /// Checks that both numbers are positive.
    ///
    /// # Errors
    /// `Input` when one is not.
    pub fn validate(&self) -> Result<()> {
        let good = |x: f64| x > 0.0 && x.is_finite();
        if good(self.weight) && good(self.hold) {
            return Ok(());
        }
        Err(Error::input(format!(
            "a proper smoothness prior needs a positive weight and hold, found {} and {}",
            self.weight, self.hold
        )))
    }

    /// The information `Λ` of one coordinate of the deviation over the nodes of a system: `b = 1`, three
    /// right-hand sides of zero.
    ///
    /// `metric` defines the metric of the energies; its space is that of the system or coarser.
    ///
    /// # Errors
    /// `Input` when the numbers are not positive or `metric` is finer than the system's space.
    pub fn information(&self, system: &SurfaceSystem, metric: &Surface) -> Result<BlockInformation> {
        self.validate()?;
        let stiffest = stiffest(metric);
        // The median is taken over the base grid and the limit applied to finer leaves, so that it does not
        // change with subdivision.
        let metric = metric.refined(Arc::clone(system.space()))?;
        let mut leaves = metric.thin_plate(system.space());
        for (leaf, cell) in leaves.iter_mut().zip(system.space().leaves()) {
            // The form of a leaf of half the side is four times as large.
            let share = stiffest * f64::from(1_u32 << (2 * cell.level)) / trace(leaf);
            if share < 1.0 {
                for entry in leaf.thin_plate.iter_mut().flatten() {
                    *entry *= share;
                }
            }
        }
        let mut sum = system.assemble_energy(&leaves)?;
        sum.add_scaled(&system.mass(&metric)?, self.hold)?;
        for value in sum.values_mut() {
            *value *= self.weight;
        }
        Ok(sum)
    }
}

/// Maximum energy of a leaf relative to the median of all leaves.
///
/// The metric of a folded surface is singular somewhere. A quadrature point near the singularity would have
/// an energy that reduces all others to rounding. Leaves at a pole have about 10⁵ times the median, and must
/// keep it.
const MAX_RELATIVE_ENERGY: f64 = 1e7;

fn trace(leaf: &LeafEnergy) -> f64 {
    (0..16).map(|k| leaf.thin_plate[k][k]).sum()
}

/// The maximum trace of the thin-plate form of a leaf over the base grid of the surface.
fn stiffest(metric: &Surface) -> f64 {
    let level = |leaf: usize| metric.space().leaves()[leaf].level;
    let mut traces: Vec<f64> = (metric.thin_plate(metric.space()).iter().enumerate())
        .map(|(leaf, energy)| trace(energy) / f64::from(1_u32 << (2 * level(leaf))))
        .collect();
    let middle = traces.len() / 2;
    MAX_RELATIVE_ENERGY * *traces.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The plane `(u, v, 0)` over a sheet. Energies in its metric are parametric energies.
///
/// # Errors
/// `Input` for shapes other than a sheet, which have no such plane.
pub fn parameter_plane(space: &Arc<Hierarchy>) -> Result<Surface> {
    if space.shape() != Some(Shape::Sheet) {
        return Err(Error::input(format!(
            "a {} does not lie in a plane: use the metric of its initial surface",
            space.topology_name()
        )));
    }
    let coarse = Arc::new(space.unrefined());
    let vertices = coarse.node_anchors().iter().map(|a| DVec3::new(a[0], a[1], 0.0)).collect();
    Surface::new(coarse, vertices)?.refined(Arc::clone(space))
}

/// Covariances of the vertices of patches, from information over nodes.
///
/// The vertices of a patch are coupled in the pattern, so the selected inverse contains all their
/// covariances. It costs two to three times as much as the factor; a solve per patch would cost a hundred
/// times more.
pub(super) struct PatchCovariances {
    inverse: SelectedInverse,
}

impl PatchCovariances {
    /// Covariances of the prior, for weight 1.
    pub fn of_prior(quadtree: &Quadtree, metric: &Surface, hold: f64) -> Result<Self> {
        let system = SurfaceSystem::new(&quadtree.space)?;
        let unit = SmoothnessPrior { weight: 1.0, hold };
        Self::of_information(quadtree, &unit.information(&system, metric)?)
    }

    /// Covariances from information of one coordinate over the nodes.
    pub fn of_information(quadtree: &Quadtree, information: &BlockInformation) -> Result<Self> {
        let space = &quadtree.space;
        // Each patch is one element, although the energy couples less. This puts all its covariances into the
        // factor.
        let coupled = (0..quadtree.patches.len()).map(|patch| nodes_of(&quadtree.extraction(patch)));
        let pattern = Arc::new(BlockPattern::from_elements(space.node_count(), coupled)?);
        let ordering = NodeOrdering::nested_dissection(&pattern, space.node_anchors())?;
        let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &ordering, 1)?);
        let factor = CholeskyFactor::factorize(&symbolic, &information.on_pattern(&pattern)?)?;
        Ok(Self { inverse: SelectedInverse::new(&factor) })
    }

    /// The covariance `E Λ⁻¹ Eᵀ` of a patch with extraction `E`.
    pub fn covariance(&self, quadtree: &Quadtree, patch: usize) -> Result<DMatrix<f64>> {
        let rows = quadtree.extraction(patch);
        let nodes = nodes_of(&rows);
        let between = (self.inverse.dense(&nodes))
            .ok_or_else(|| Error::undetermined(format!("patch {patch} has no covariance")))?;
        let extraction = DMatrix::from_fn(VERTICES, nodes.len(), |r, c| {
            rows[r].iter().find(|(node, _)| *node == nodes[c]).map_or(0.0, |(_, w)| *w)
        });
        let covariance = &extraction
            * DMatrix::from_row_slice(nodes.len(), nodes.len(), &between)
            * extraction.transpose();
        Ok(0.5 * (&covariance + covariance.transpose()))
    }
}

/// The nodes in the extraction of a patch, each once.
fn nodes_of(rows: &[Vec<(u32, f64)>]) -> Vec<u32> {
    let mut nodes: Vec<u32> = rows.iter().flatten().map(|(node, _)| *node).collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}

/// The nearest positive semidefinite matrix: negative eigenvalues, caused by rounding, become zero.
pub(super) fn positive_part(matrix: DMatrix<f64>) -> DMatrix<f64> {
    let symmetric = 0.5 * (&matrix + matrix.transpose());
    let mut eigen = symmetric.symmetric_eigen();
    if eigen.eigenvalues.min() >= 0.0 {
        return 0.5 * (&matrix + matrix.transpose());
    }
    for value in eigen.eigenvalues.iter_mut() {
        *value = value.max(0.0);
    }
    eigen.recompose()
}
