//! Variances of the surface at the feet, and the degrees of freedom that readings determine.

use crate::model::Posterior;
use crate::observe::{Foot, FootChannels, by_leaf};
use planish_estimate::Result;
use rayon::prelude::*;

/// The variance of the surface at each foot, in the quantity that the reading measures: the largest over its
/// rows.
pub(in crate::fit) fn variances_of_surface(posterior: &Posterior<'_>, feet: &[Foot]) -> Result<Vec<f64>> {
    let leaves = posterior.surface().space().leaves().len();
    let (start, order) = by_leaf(feet, leaves);
    // By leaf, because the covariance of a leaf costs more than the variances of its readings.
    let parts: Vec<Vec<(u32, f64)>> = (0..leaves)
        .into_par_iter()
        .map(|leaf| {
            let own = &order[start[leaf] as usize..start[leaf + 1] as usize];
            if own.is_empty() {
                return Ok(Vec::new());
            }
            let cell = posterior.leaf(leaf)?;
            let variance = |k: u32| {
                let foot = &feet[k as usize];
                let mut largest = 0.0_f64;
                foot.rows(posterior.surface(), |_, row| {
                    largest = largest.max(cell.variance_along(row, foot.normal));
                });
                (k, largest)
            };
            Ok(own.iter().map(|&k| variance(k)).collect())
        })
        .collect::<Result<_>>()?;
    let mut variances = vec![0.0; feet.len()];
    for (k, variance) in parts.into_iter().flatten() {
        variances[k as usize] = variance;
    }
    Ok(variances)
}

/// Degrees of freedom that the readings of each channel determine: `Σ_i w_i nᵢᵀ Σ nᵢ`.
pub(super) fn degrees_of_channels(
    posterior: &Posterior<'_>,
    channels: &FootChannels<'_>,
    feet: &[Foot],
    information: &[f64],
) -> Result<Vec<f64>> {
    let leaves = posterior.surface().space().leaves().len();
    let (start, order) = by_leaf(feet, leaves);
    // Chunks of fixed size: partial sums are added in the same order at any number of threads.
    let parts: Vec<Vec<f64>> = (0..leaves.div_ceil(64))
        .into_par_iter()
        .map(|chunk| {
            let mut part = vec![0.0; channels.count];
            for leaf in chunk * 64..leaves.min((chunk + 1) * 64) {
                let own = &order[start[leaf] as usize..start[leaf + 1] as usize];
                if own.is_empty() {
                    continue;
                }
                let cell = posterior.leaf(leaf)?;
                for k in own.iter().map(|&k| k as usize).filter(|&k| information[k] > 0.0) {
                    feet[k].rows(posterior.surface(), |_, row| {
                        part[channels.channel(k)] +=
                            information[k] * cell.variance_along(row, feet[k].normal);
                    });
                }
            }
            Ok(part)
        })
        .collect::<Result<_>>()?;
    let mut degrees = vec![0.0; channels.count];
    for part in parts {
        for (d, p) in degrees.iter_mut().zip(part) {
            *d += p;
        }
    }
    Ok(degrees)
}
