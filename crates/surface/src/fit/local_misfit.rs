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
    let by_leaf = NormalisedResiduals::new(readings, noise, surface.space().leaves().len());
    (0..by_leaf.sums.len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let own = by_leaf.of(leaf);
            let mut found = LeafMisfit {
                readings: own.len(),
                not_followed: own.iter().filter(|r| r.abs() > gate).count(),
                ..LeafMisfit::default()
            };
            // An edge shows in the readings of all leaves along it before it shows in those of one.
            for leaves in [vec![leaf], neighbourhood(surface.space(), leaf)] {
                let sums = leaves.iter().fold(Sums::default(), |sums, &k| sums + by_leaf.sums[k]);
                if sums.count < MIN_READINGS as usize {
                    continue;
                }
                let residuals = || leaves.iter().flat_map(|&k| by_leaf.of(k)).copied().collect();
                let noise = sums.count as f64 / sums.precision;
                let variance = noise * excess_square(sums, residuals, gate)?;
                if found.noise_variance == 0.0 || variance > found.variance {
                    (found.noise_variance, found.variance) = (noise, variance);
                }
            }
            Ok(found)
        })
        .collect()
}

/// Residuals of positions over the σ of their sensors, leaf by leaf.
struct NormalisedResiduals {
    values: Vec<f64>,
    /// Of each leaf, the number of its first residual.
    start: Vec<usize>,
    sums: Vec<Sums>,
}

/// Sums over residuals: their number, their squares, and the precisions of their readings.
#[derive(Clone, Copy, Default)]
struct Sums {
    count: usize,
    square: f64,
    precision: f64,
}

impl std::ops::Add for Sums {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            square: self.square + other.square,
            precision: self.precision + other.precision,
        }
    }
}

impl NormalisedResiduals {
    fn new(readings: ProjectedReadings<'_>, noise: &SensorNoise, leaves: usize) -> Self {
        let ProjectedReadings { observations, feet, .. } = readings;
        let (first, order) = by_leaf(feet, leaves);
        let mut found = Self { values: Vec::new(), start: vec![0], sums: Vec::with_capacity(leaves) };
        for leaf in 0..leaves {
            let mut sums = Sums::default();
            let on_leaf = &order[first[leaf] as usize..first[leaf + 1] as usize];
            for k in on_leaf.iter().map(|&k| k as usize) {
                let channel = readings.channel(k);
                let variance = noise.variance_factors[channel] * feet[k].variance;
                let counts = feet[k].state == FootState::Good && feet[k].quantity == Quantity::Position;
                if counts && variance > 0.0 && !observations.channels[channel].inferred {
                    let residual = feet[k].height() / variance.sqrt();
                    found.values.push(residual);
                    let one = Sums { count: 1, square: residual * residual, precision: 1.0 / variance };
                    sums = sums + one;
                }
            }
            found.start.push(found.values.len());
            found.sums.push(sums);
        }
        found
    }

    fn of(&self, leaf: usize) -> &[f64] {
        &self.values[self.start[leaf]..self.start[leaf + 1]]
    }
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

/// `s² − 1` of normalised residuals with the given sums, if it is significant, else 0.
fn excess_square(sums: Sums, residuals: impl Fn() -> Vec<f64>, gate: f64) -> Result<f64> {
    let significant = |square: f64, count: f64| square > 1.0 + SIGNIFICANT * (2.0 / count).sqrt();
    // The gate only lowers the scale, and most leaves are without misfit.
    if !significant(sums.square / sums.count as f64, sums.count as f64) {
        return Ok(0.0);
    }
    let scale = gated_scale(&residuals(), gate)?;
    let square = scale.sigma * scale.sigma;
    Ok(if significant(square, scale.kept.max(1) as f64) { square - 1.0 } else { 0.0 })
}
