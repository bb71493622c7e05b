//! What the surface does not follow: for each leaf, the scale of its residuals beyond the noise.
//!
//! A spline cannot follow an edge, a handle or the two sides of a thin part, and a wrong shape follows
//! nothing. The residuals there are larger than the noise of the sensors, for which they are no evidence
//! ([`planish_sense::neighbour_noise`]). With the scale `s` of a leaf's normalised residuals,
//!
//! ```text
//! m² = (s² − 1) / mean(1/v)
//! ```
//!
//! is the variance along the normal that explains them. It is added to the variance of the readings of the
//! leaf, so that they are neither rejected nor believed beyond what the surface can follow. The scale is
//! iterated between a gate and the residuals within it: few readings far from all others are outliers.
//!
//! Not guaranteed: outliers that are more than half of a leaf count as shape.

use super::division::MIN_READINGS;
use super::leaves::neighbourhood;
use super::noise::SensorNoise;
use crate::observe::{FootState, ProjectedReadings, Quantity, by_leaf};
use planish_estimate::{Result, gated_scale};
use planish_spline::Surface;
use rayon::prelude::*;

/// Significance of the scale of a leaf, in standard errors of its square. A lower one enlarges σ of some of
/// thousands of leaves by chance; a higher one rejects readings that the surface should be near.
const SIGNIFICANT: f64 = 4.0;

/// What a leaf's readings of positions show.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LeafMisfit {
    /// Number of readings with a foot on the leaf, rejected ones included.
    pub readings: usize,
    /// Readings beyond the gate of their own σ, without the misfit of the leaf.
    pub not_followed: usize,
    /// Variance along the normal beyond that of the readings; 0 if it is not significant.
    pub variance: f64,
    /// Variance of the readings by their sensors.
    pub noise_variance: f64,
}

impl LeafMisfit {
    /// Share of the readings that the surface does not follow.
    #[must_use]
    pub fn share_not_followed(&self) -> f64 {
        self.not_followed as f64 / self.readings.max(1) as f64
    }

    /// True if the misfit is larger than the noise of the readings.
    #[must_use]
    pub fn exceeds_noise(&self) -> bool {
        self.variance > self.noise_variance
    }
}

/// The misfit of each leaf: that of its own readings or that of its neighbourhood, whichever is larger.
pub(super) fn local_misfit(
    surface: &Surface,
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    gate: f64,
) -> Result<Vec<LeafMisfit>> {
    let ProjectedReadings { observations, feet, .. } = readings;
    let space = surface.space();
    let leaves = space.leaves().len();
    let (start, order) = by_leaf(feet, leaves);
    // Normalised residuals and precisions of the readings of a leaf.
    let own = |leaf: usize| {
        let on_leaf = order[start[leaf] as usize..start[leaf + 1] as usize].iter().map(|&k| k as usize);
        on_leaf
            .filter(|&k| feet[k].state == FootState::Good && feet[k].quantity == Quantity::Position)
            .filter(|&k| !observations.channels[readings.channel(k)].inferred)
            .filter_map(|k| {
                let variance = noise.variance_factors[readings.channel(k)] * feet[k].variance;
                (variance > 0.0).then(|| [feet[k].height() / variance.sqrt(), 1.0 / variance])
            })
    };
    (0..leaves)
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let near: Vec<[f64; 2]> = own(leaf).collect();
            let mut found = LeafMisfit {
                readings: near.len(),
                not_followed: near.iter().filter(|[r, _]| r.abs() > gate).count(),
                ..LeafMisfit::default()
            };
            // An edge shows in the readings of all leaves along it before it shows in those of one.
            let around: Vec<[f64; 2]> = neighbourhood(space, leaf).into_iter().flat_map(own).collect();
            for readings in [near, around].iter().filter(|readings| readings.len() >= MIN_READINGS as usize) {
                let noise = readings.len() as f64 / readings.iter().map(|[_, w]| w).sum::<f64>();
                let variance = noise * excess_square(readings, gate)?;
                if found.noise_variance == 0.0 || variance > found.variance {
                    (found.noise_variance, found.variance) = (noise, variance);
                }
            }
            Ok(found)
        })
        .collect()
}

/// The variance that the misfit of each leaf adds to its readings.
pub(super) fn local_variances(
    surface: &Surface,
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    gate: f64,
) -> Result<Vec<f64>> {
    Ok(local_misfit(surface, readings, noise, gate)?.into_iter().map(|found| found.variance).collect())
}

/// `s² − 1` of normalised residuals, if it is significant, else 0.
fn excess_square(residuals: &[[f64; 2]], gate: f64) -> Result<f64> {
    let significant = |square: f64, count: f64| square > 1.0 + SIGNIFICANT * (2.0 / count).sqrt();
    // The gate only lowers the scale, and most leaves are without misfit.
    let count = residuals.len() as f64;
    let square = residuals.iter().map(|[r, _]| r * r).sum::<f64>() / count;
    if !significant(square, count) {
        return Ok(0.0);
    }
    let normalised: Vec<f64> = residuals.iter().map(|[r, _]| *r).collect();
    let scale = gated_scale(&normalised, gate)?;
    let square = scale.sigma * scale.sigma;
    Ok(if significant(square, scale.kept.max(1) as f64) { square - 1.0 } else { 0.0 })
}
