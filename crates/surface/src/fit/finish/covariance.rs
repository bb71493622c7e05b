//! The posterior covariance of a model, with the poses and biases of its scans as common unknowns.

use super::Finishing;
use crate::model::{NodeCovariance, SurfaceModel};
use crate::observe::{FootChannels, Linearized, by_leaf};
use planish_core::{DVec3, Progress};
use planish_estimate::Result;
use planish_estimate::sparse::CholeskyFactor;
use planish_spline::SurfaceSystem;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;

/// Draws of the surface's noise.
///
/// Each scan sums its share of a draw over thousands of readings, so a dozen draws average well. The cost is
/// one solution of the equations for each draw. See decision 0014.
const NOISE_DRAWS: u64 = 12;

impl Finishing<'_> {
    /// The covariance of the nodes, and the information that was stated about the unknowns of scans. The
    /// model receives the information of these unknowns.
    pub(super) fn covariance(
        &self,
        model: &mut SurfaceModel,
        progress: &dyn Progress,
    ) -> Result<(Arc<NodeCovariance>, Vec<f64>)> {
        let errors = &self.observations.scan_errors;
        let channels = FootChannels::new(self.observations, self.subset);
        let directions = model.surface.directions();
        let linearized = Linearized {
            surface: &model.surface,
            directions: &directions,
            feet: self.feet,
            information: self.information,
            channels: &channels,
        };
        // Batches are samples of one cloud, so the other batches are assumed to carry the same information
        // about scans as this one.
        let parts = {
            let own = self.information.iter().filter(|&&w| w > 0.0).count().max(1) as f64;
            let others: usize = self.residuals_of_batches().iter().map(|o| o.count).sum();
            1.0 + others as f64 / own
        };
        let mut stated = Vec::new();
        if let (false, Some(slot)) = (errors.is_empty(), model.known.scan_errors_mut()) {
            let equations = errors.equations(&linearized);
            // Removing spurious information must not go below what the user has stated.
            stated = equations.prior.clone();
            *slot = Some(equations.into_information(parts));
        }
        progress.check("covariance", 0.95)?;
        let covariance = model.covariance(self.system)?;
        let Some(mut scan_error_information) = model.known.scan_errors_mut().and_then(Option::take) else {
            return Ok((Arc::new(covariance), stated));
        };
        // Noise of the surface tilts its normals. Without this correction the tilt would count as
        // information about rotations that no reading determines.
        let factor = self.system.factorize_scalar(&model.information_along(self.system, &directions)?)?;
        let noise = noise_of_surface(self.system, &linearized, &factor, parts)?;
        let of_noise = errors.noise_information(&linearized, &factor, &noise, parts)?;
        let (covariance, change) = covariance.without_spurious_information(&of_noise, &stated)?;
        for (corner, change) in scan_error_information.corner.iter_mut().zip(change) {
            *corner += change;
        }
        if let Some(slot) = model.known.scan_errors_mut() {
            *slot = Some(scan_error_information);
        }
        Ok((Arc::new(covariance), stated))
    }
}

/// Draws of the surface's error caused by the noise of the readings: the sixteen coefficients of every leaf.
///
/// Each is `Λ⁻¹ Σ √w a ε` with ε ~ N(0, 1). All readings are `parts` times as many as those at hand. The
/// covariance of the draws, `Λ⁻¹ Λ_data Λ⁻¹`, is smaller than the posterior's, which also contains the detail
/// that the surface does not show.
fn noise_of_surface(
    system: &SurfaceSystem,
    at: &Linearized<'_>,
    factor: &CholeskyFactor,
    parts: f64,
) -> Result<Vec<Vec<[DVec3; 16]>>> {
    let Linearized { surface, directions, feet, information, .. } = *at;
    let space = system.space();
    let (start, order) = by_leaf(feet, space.leaves().len());
    (0..NOISE_DRAWS)
        .map(|draw| {
            // Each draw has its own seed, so the draws depend neither on their order nor on the threads.
            let mut rng = ChaCha8Rng::seed_from_u64(draw);
            let drawn: Vec<DVec3> = (0..feet.len())
                .map(|_| DVec3::from_array([(); 3].map(|()| StandardNormal.sample(&mut rng))))
                .collect();
            let sums = system.accumulate_along(directions, |leaf, add| {
                for &k in &order[start[leaf] as usize..start[leaf + 1] as usize] {
                    let (foot, w) = (&feet[k as usize], information[k as usize]);
                    if w > 0.0 {
                        foot.rows(surface, |r, row| {
                            // Times the weight w, this is √(parts w) ε: the score of all readings.
                            add(row, foot.normal, drawn[k as usize][r] * (parts / w).sqrt(), w)
                        });
                    }
                }
            })?;
            let mut moved = sums.vector().to_vec();
            factor.solve_in_place(&mut moved)?;
            Ok(space.leaf_coefficients(&surface.displacements(directions, &moved)))
        })
        .collect()
}
