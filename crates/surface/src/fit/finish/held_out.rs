//! Comparison of the surface with the readings that were held out.

use crate::fit::HeldOut;
use crate::fit::noise::{SensorNoise, kept_variance};
use crate::model::Posterior;
use crate::observe::{FootState, Observations, project, surface_extent};
use planish_estimate::Result;
use planish_spline::FootPointSearch;
use rayon::prelude::*;

/// Root mean square of the held-out residuals over `√(σ_reading² + σ_surface²)`, behind the gate of the fit.
pub(super) fn judge_held_out(
    posterior: &Posterior<'_>,
    observations: &Observations,
    noise: &SensorNoise,
    at: &mut [[f64; 2]],
    gate: f64,
) -> Result<HeldOut> {
    let surface = posterior.surface();
    let held: Vec<u32> =
        (0..observations.len() as u32).filter(|&i| observations.readings.held_out[i as usize]).collect();
    if held.is_empty() {
        return Ok(HeldOut { n: 0, rms_normalised: f64::NAN });
    }
    // Held-out readings took no part in the iterations, so they have no foot to follow.
    let search = FootPointSearch::new(surface, 2, 0.1 * surface_extent(surface))?;
    let feet = project(surface, observations, &held, at, Some(&search), &noise.variance_factors);
    let normalised: Vec<Option<f64>> = held
        .par_iter()
        .zip(&feet)
        .with_min_len(256)
        .flat_map_iter(|(&i, foot)| {
            let mut rows = [None; 3];
            if foot.state == FootState::Good
                && let Ok(cell) = posterior.leaf(foot.leaf as usize)
            {
                let of_reading = noise.of_foot(observations.channel(i as usize), foot);
                foot.rows(surface, |r, row| {
                    let of_surface = cell.variance_along(row, foot.normal);
                    let normalised = foot.residuals()[r] / (of_reading + of_surface).sqrt();
                    rows[r] = (normalised.abs() <= gate).then_some(normalised);
                });
            }
            rows
        })
        .collect();
    let kept: Vec<f64> = normalised.into_iter().flatten().collect();
    let n = kept.len();
    let mean_square = kept.iter().map(|r| r * r).sum::<f64>() / n.max(1) as f64;
    // The gate cuts the tails of normal residuals, so their mean square is below 1 even if every σ is
    // right.
    Ok(HeldOut { n, rms_normalised: (mean_square / kept_variance(gate)?).sqrt() })
}
