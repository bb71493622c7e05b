//! The thin-plate energy of a surface, by which its smoothness weight is estimated.

use planish_core::DisjointSets;
use planish_estimate::Result;
use planish_estimate::sparse::BlockInformation;
use planish_spline::{LeafEnergy, QuadDomain, Surface, SurfaceSystem};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Largest plausible `∫ κ² dA` of one leaf: that of a quarter turn, (π/2)².
///
/// A leaf that bends more is a fold or too coarse. A larger bound lets folds make the whole surface soft.
const MAX_LEAF_BENDING: f64 = 2.5;
/// Factor on the energy of leaves above [`MAX_LEAF_BENDING`]: large enough to smooth a fold within a round.
/// See decision 0003.
const STIFFENING: f64 = 100.0;

/// Modes of a flat face without energy: its position along its normal and its two tilts.
const FLAT_MODES: usize = 3;

/// Largest factor by which the smoothness weight rises in one iteration; it falls by at most the same factor.
///
/// The update holds at a converged surface. Far from it, an unbounded change would flatten the surface, or
/// let it follow its noise, in a single step.
const MAX_WEIGHT_CHANGE: f64 = 5.0;

/// The prior's energy at a surface, in its own metric.
pub(super) struct BendingEnergy {
    /// `K` of one coordinate; the same for each.
    pub matrix: BlockInformation,
    leaves: Vec<LeafEnergy>,
    /// `∫ κ1² + κ2² dA` over the leaves below [`MAX_LEAF_BENDING`].
    pub total: f64,
    /// Number of the other leaves.
    left_out: usize,
    /// Parts of the surface that creases separate; none if it has no creases.
    faces: Option<usize>,
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
        let faces = surface.space().domain().and_then(|domain| faces_between_creases(domain));
        let mut made = Self { matrix, leaves, total: 0.0, left_out: 0, faces };
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
        self.left_out = bends.iter().filter(|&&b| b > MAX_LEAF_BENDING).count();
    }

    /// The next smoothness weight from the present one and the degrees of freedom that the readings
    /// determine: the fixed-point iteration of Fellner and Schall, `w ← (degrees − modes without energy) /
    /// xᵀKx` (Wood & Fasiolo 2017).
    ///
    /// Every smooth shape counts as one such mode. A flat sheet has three, which matters with a handful of
    /// readings only (decision 0003). With creases, each face may be flat, and leaves that are left out of
    /// the energy have at least a degree each. If no more than these are determined, nothing shows how smooth
    /// the rest is, and the weight stays: without this, it grew beyond all bounds where faces are flat and
    /// folds hold all degrees (decision 0132).
    pub(super) fn next_weight(&self, weight: f64, degrees: f64) -> f64 {
        let energy = self.total.max(f64::MIN_POSITIVE);
        let Some(faces) = self.faces else { return (degrees - 1.0).max(1.0) / energy };
        match degrees - (FLAT_MODES * faces + self.left_out) as f64 {
            bent if bent > 1.0 => bent / energy,
            _ => weight,
        }
    }
}

/// The steps of the smoothness weight, in its logarithm.
///
/// The fixed-point iteration of Fellner and Schall overshoots where the energy depends steeply on the weight:
/// it then alternates around the solution. Each time it turns back, its steps become shorter.
pub(super) struct WeightSearch {
    last_step: f64,
    share: f64,
}

impl Default for WeightSearch {
    fn default() -> Self {
        Self { last_step: 0.0, share: 1.0 }
    }
}

impl WeightSearch {
    const MIN_SHARE: f64 = 0.25;

    /// The next weight, from the present one and that of the fixed-point iteration.
    pub(super) fn next(&mut self, weight: f64, proposed: f64) -> f64 {
        let step = (proposed / weight).clamp(1.0 / MAX_WEIGHT_CHANGE, MAX_WEIGHT_CHANGE).ln();
        if step * self.last_step < 0.0 {
            self.share = (0.5 * self.share).max(Self::MIN_SHARE);
        }
        self.last_step = step;
        weight * (self.share * step).exp()
    }
}

/// The number of parts into which creases divide a domain; none without creases.
fn faces_between_creases(domain: &QuadDomain) -> Option<usize> {
    if domain.creases().is_empty() {
        return None;
    }
    let mut sets = DisjointSets::new(domain.cells().len());
    let mut first_at: HashMap<[u32; 2], u32> = HashMap::new();
    for (cell, corners) in domain.cells().iter().enumerate() {
        for k in 0..4 {
            let (a, b) = (corners[k], corners[(k + 1) % 4]);
            if !domain.is_crease([a, b]) {
                let other = *first_at.entry([a.min(b), a.max(b)]).or_insert(cell as u32);
                sets.join(other, cell as u32);
            }
        }
    }
    let roots: HashSet<u32> = sets.into_roots().into_iter().collect();
    Some(roots.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cube with all of its edges as creases has six faces; with those around two opposite ones, three.
    #[test]
    fn creases_divide_a_cube_into_faces() {
        let (quads, _) = planish_spline::test_meshes::voxels(&[[0, 0, 0]]);
        let smooth = QuadDomain::new(&quads).unwrap();
        assert_eq!(faces_between_creases(&smooth), None);
        let edges_of = |q: &[u32; 4]| (0..4).map(|k| [q[k], q[(k + 1) % 4]]).collect::<Vec<_>>();
        let all: Vec<[u32; 2]> = quads.iter().flat_map(edges_of).filter(|[a, b]| a < b).collect();
        let of = |creases: &[[u32; 2]]| {
            faces_between_creases(&QuadDomain::with_creases(&quads, creases, &[]).unwrap())
        };
        assert_eq!(of(&all), Some(6));
        let opposite = quads.iter().find(|q| q.iter().all(|v| !quads[0].contains(v))).unwrap();
        let around = [edges_of(&quads[0]), edges_of(opposite)].concat();
        assert_eq!(of(&around), Some(3));
    }
}
