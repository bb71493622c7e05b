//! The global filter of the sphere experiment: one sparse information matrix over all control vertices.
//!
//! Input: the readings with their parameters, the prior and the subdivided space. Output: a
//! [`GlobalSolution`], the surface and the error that its covariance predicts. The filter has the leaf
//! cells and the readings of the patch filter, so that the two differ only in how they use them.

use super::{SharedModel, on_sphere, probes};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_estimate::sparse::{BlockInformation, SelectedInverse};
use planish_spline::{
    CellCovariance, CellInformation, Hierarchy, Jet, SmoothnessPrior, Surface, SurfaceReading, SurfaceSystem,
    cubic, leaf_weights,
};
use std::f64::consts::FRAC_2_PI;
use std::sync::Arc;

/// The global filter in information form, `Λ x = η`, with three coordinates per control vertex.
#[derive(Clone)]
pub(super) struct GlobalFilter {
    system: Arc<SurfaceSystem>,
    information: BlockInformation,
}

/// The estimate of the global filter and the accuracy that it predicts for itself.
pub(super) struct GlobalSolution {
    pub surface: Surface,
    /// Expected mean absolute error by the posterior, in per cent of the radius.
    pub bound_percent: f64,
}

impl GlobalFilter {
    /// Adds the prior and all positions; both are linear, so no linearisation point is needed.
    pub fn new(
        model: &SharedModel,
        space: &Arc<Hierarchy>,
        prior: SmoothnessPrior,
        positions: &[SurfaceReading],
    ) -> Result<Self> {
        let system = SurfaceSystem::new(space)?;
        let by_leaf = readings_by_leaf(space, positions);
        let mut information = system.accumulate(|leaf, cell| {
            for ([s, t], reading) in &by_leaf[leaf] {
                if let SurfaceReading::Position { point, variance, .. } = reading {
                    let w = 1.0 / variance;
                    cell.add_vector(&leaf_weights(*s, *t), *point, &[w, 0.0, 0.0, w, 0.0, w]);
                }
            }
            !by_leaf[leaf].is_empty()
        })?;
        // The prior draws towards the cylinder, not towards zero: its vector is its matrix times the
        // cylinder.
        let scalar = prior.information(&system, &model.metric)?;
        let mut wide = scalar.expanded(3)?;
        let start = planish_core::vector3::coordinates(model.cylinder.refined(Arc::clone(space))?.vertices())
            .to_vec();
        let mut vector = vec![0.0; start.len()];
        wide.multiply(&start, &mut vector)?;
        wide.vector_mut().copy_from_slice(&vector);
        information.add_scaled(&wide, 1.0)?;
        Ok(Self { system: Arc::new(system), information })
    }

    /// Adds orientations, `n · t1 = n · t2 = 0`, linearised at the surface estimated from the positions.
    ///
    /// The equation of a normal is not linear in the control vertices. The tangents of the starting
    /// cylinder are wrong by up to 60°; those of the surface of the positions suffice for one step.
    pub fn add_normals(&mut self, normals: &[SurfaceReading], at: &Surface) -> Result<()> {
        let by_leaf = readings_by_leaf(self.system.space(), normals);
        let added = self.system.accumulate(|leaf, cell: &mut CellInformation| {
            for (local, reading) in &by_leaf[leaf] {
                let SurfaceReading::Normal { normal, sigma_rad, .. } = reading else {
                    continue;
                };
                let jet = at.leaf_jet(leaf, local[0], local[1]);
                let Some(own) = jet.normal() else { continue };
                let facing = normal.dot(own);
                for (weights, tangent) in tangent_weights(at, leaf, *local, &jet) {
                    // The gradient of n · t for a unit tangent t: a change of the tangent counts along the
                    // surface's own normal, scaled by how far the measured one agrees. The patch filter
                    // uses the same, so that one patch and the global filter give the same numbers.
                    cell.add_scalar(
                        &weights,
                        own.map(|x| facing * x),
                        -normal.dot(tangent),
                        1.0 / (sigma_rad * sigma_rad),
                    );
                }
            }
            !by_leaf[leaf].is_empty()
        })?;
        self.information.add_scaled(&added, 1.0)
    }

    /// Solves for the surface and averages its predicted σ over the area of the sphere.
    pub fn solve(&self) -> Result<GlobalSolution> {
        let factor = self.system.factorize(&self.information)?;
        let mut x = self.information.vector().to_vec();
        factor.solve_in_place(&mut x)?;
        let surface = self.system.surface(&x)?;
        // A point depends on the 16 vertices of its cell, so only their covariances are needed: the selected
        // inverse gives them without the dense inverse.
        let inverse = SelectedInverse::new(&factor);
        let space = self.system.space();
        let cells: Vec<Option<CellCovariance>> = (0..space.leaves().len())
            .map(|leaf| {
                let covariance = inverse.dense(space.extraction(leaf).0)?;
                Some(CellCovariance::new(space, leaf, &covariance))
            })
            .collect();
        let (mut sum, mut area) = (0.0, 0.0);
        for ([u, v], share) in probes() {
            let (leaf, [s, t]) = space.locate(u, v);
            if let Some(cell) = &cells[leaf] {
                sum += share * cell.variance_along(&leaf_weights(s, t), on_sphere(u, v)).max(0.0).sqrt();
                area += share;
            }
        }
        // E|e| = √(2/π) σ for a Gaussian error e.
        Ok(GlobalSolution { surface, bound_percent: 100.0 * FRAC_2_PI.sqrt() * sum / area })
    }
}

/// Two orthonormal tangents at a point of a leaf cell, each with the weights of the cell's 16 control
/// vertices in the derivative along it.
///
/// Gram–Schmidt on `S_u` and `S_v`, written out so that the weights follow the tangents linearly.
fn tangent_weights(at: &Surface, leaf: usize, [s, t]: [f64; 2], jet: &Jet) -> [([f64; 16], DVec3); 2] {
    let side = at.space().leaves()[leaf].side();
    let (bu, bv) = (cubic(s), cubic(t));
    let l = jet.du.length();
    let m = jet.du.dot(jet.dv) / l;
    let q = (jet.dv - m / l * jet.du).length();
    [[1.0 / l, 0.0], [-m / (l * q), 1.0 / q]].map(|[a, b]| {
        let weights = std::array::from_fn(|k| {
            (a * bu[1][k % 4] * bv[0][k / 4] + b * bu[0][k % 4] * bv[1][k / 4]) / side
        });
        (weights, a * jet.du + b * jet.dv)
    })
}

/// The readings of each leaf cell with their local parameters, in the order of the input.
fn readings_by_leaf<'a>(
    space: &Hierarchy,
    readings: &'a [SurfaceReading],
) -> Vec<Vec<([f64; 2], &'a SurfaceReading)>> {
    let mut by_leaf = vec![Vec::new(); space.leaves().len()];
    for reading in readings {
        let [u, v] = reading.parameters();
        let (leaf, local) = space.locate(u, v);
        by_leaf[leaf].push((local, reading));
    }
    by_leaf
}
