//! The thin-plate energy of a surface, by which its smoothness weight is estimated.

use planish_estimate::Result;
use planish_estimate::sparse::BlockInformation;
use planish_spline::{LeafEnergy, Surface, SurfaceSystem};
use rayon::prelude::*;

/// Largest plausible `∫ κ² dA` of one leaf: that of a quarter turn, (π/2)².
///
/// A leaf that bends more is a fold or too coarse. A larger bound lets folds make the whole surface soft.
const MAX_LEAF_BENDING: f64 = 2.5;
/// Factor on the energy of leaves above [`MAX_LEAF_BENDING`]: large enough to smooth a fold within a round.
/// See decision 0003.
const STIFFENING: f64 = 100.0;

/// The prior's energy at a surface, in its own metric.
pub(super) struct BendingEnergy {
    /// `K` of one coordinate; the same for each.
    pub matrix: BlockInformation,
    leaves: Vec<LeafEnergy>,
    /// `∫ κ1² + κ2² dA` over the leaves below [`MAX_LEAF_BENDING`].
    pub total: f64,
}

impl BendingEnergy {
    /// Assembles the thin plate. Leaves that bend more than they can resolve weigh [`STIFFENING`] times as
    /// much.
    ///
    /// A leaf whose normal turns by more than a quarter turn is a fold or a spike, or the shape is finer
    /// than the leaf. In each case it is kept smooth until refinement shows otherwise, and it is left out of
    /// the estimate of how smooth the rest is.
    pub(super) fn new(system: &SurfaceSystem, surface: &Surface) -> Result<Self> {
        let mut leaves = surface.thin_plate(system.space());
        for (leaf, energy) in leaves.iter_mut().enumerate() {
            if energy.energy(surface.leaf_coefficients(leaf)) > MAX_LEAF_BENDING {
                for entry in energy.thin_plate.iter_mut().flatten() {
                    *entry *= STIFFENING;
                }
            }
        }
        let matrix = system.assemble_energy(&leaves)?;
        let mut made = Self { matrix, leaves, total: 0.0 };
        made.measure(surface);
        Ok(made)
    }

    /// Sets `total` to the energy of a surface in this metric.
    pub(super) fn measure(&mut self, surface: &Surface) {
        let bends: Vec<f64> = (0..self.leaves.len())
            .into_par_iter()
            .with_min_len(256)
            .map(|leaf| self.leaves[leaf].energy(surface.leaf_coefficients(leaf)))
            .collect();
        // The energies are collected first and added in order, so the sum does not depend on the threads.
        // Folds are left out (decision 0003).
        self.total = bends.iter().filter(|&&b| b <= MAX_LEAF_BENDING).sum();
    }
}
