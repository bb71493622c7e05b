//! What the surface does not follow: for each leaf, the scale of its residuals beyond the noise.
//!
//! A spline cannot follow an edge, a handle or the two sides of a thin part, and a wrong shape follows
//! nothing. The residuals there are larger than the noise of the sensors, for which they are no evidence
//! ([`planish_sense::neighbour_noise`]). The variance `m²` along the normal that explains the residuals `e`
//! of a leaf's readings with variances `v` solves
//!
//! ```text
//! scale(e / √(v + m²)) = 1
//! ```
//!
//! It is added to the variance of the readings of the leaf, so that they are neither rejected nor believed
//! beyond what the surface can follow. The scale is that of the residuals within a gate: few readings far
//! from all others are outliers.
//!
//! Readings that agree with no neighbours are left out where most others agree ([`surface_consensus`]).
//!
//! Not guaranteed: outliers that are more than 60 % of the readings of a neighbourhood count as shape.
//!
//! [`surface_consensus`]: planish_sense::surface_consensus
//!
//! # References
//! Paule and Mandel, *Consensus values and weighting factors*, 1982 (an additional variance common to
//! readings of different variances).

use super::division::MIN_READINGS;
use super::leaves::neighbourhood;
use super::noise::SensorNoise;
use crate::observe::{FootState, ProjectedReadings, Quantity, by_leaf};
use planish_estimate::{Result, chi_square_deviation, gated_scale};
use planish_spline::{Hierarchy, Surface};
use rayon::prelude::*;

/// Significance of the scale of a leaf, in standard deviations of a normal variable. A lower one enlarges σ
/// of some of thousands of leaves by chance; a higher one rejects readings that the surface should be near.
const SIGNIFICANT: f64 = 4.0;
/// Readings that agree with no neighbours are gross errors if more than this share of the readings around
/// them do agree; fewer are shape that shows in no neighbourhood.
const MIN_AGREEING: f64 = 0.4;

/// Median of χ² with one degree of freedom: a normal error is smaller in half of the cases.
const CHI_SQUARE_MEDIAN: f64 = 0.454_936;
/// Iterations of the common variance, and the relative change after which they end.
const MAX_ITERATIONS: usize = 30;
const SETTLED: f64 = 0.01;

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
    let by_leaf = ResidualsByLeaf::new(surface.space(), readings, noise);
    (0..by_leaf.sums.len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let own = by_leaf.of(leaf);
            let mut found = LeafMisfit {
                readings: own.len(),
                not_followed: own.iter().filter(|r| r.normalised().abs() > gate).count(),
                ..LeafMisfit::default()
            };
            // An edge shows in the readings of all leaves along it before it shows in those of one.
            for leaves in [vec![leaf], neighbourhood(surface.space(), leaf)] {
                let sums = leaves.iter().fold(Sums::default(), |sums, &k| sums + by_leaf.sums[k]);
                if sums.count < MIN_READINGS as usize {
                    continue;
                }
                let noise = (sums.log_variance / sums.count as f64).exp();
                let variance = match sums.is_significant() {
                    true => common_variance(&by_leaf.residuals_of(&leaves), noise, gate)?,
                    false => 0.0,
                };
                if found.noise_variance == 0.0 || variance > found.variance {
                    (found.noise_variance, found.variance) = (noise, variance);
                }
            }
            Ok(found)
        })
        .collect()
}

/// A residual and the variance of its reading.
#[derive(Clone, Copy)]
struct Residual {
    height: f64,
    variance: f64,
}

impl Residual {
    fn normalised(self) -> f64 {
        self.height / self.variance.sqrt()
    }
}

/// Residuals of positions with the variances of their sensors, leaf by leaf.
struct ResidualsByLeaf {
    values: Vec<Residual>,
    /// Of each leaf, the number of its first residual.
    start: Vec<usize>,
    sums: Vec<Sums>,
}

/// Sums over residuals: their number, the squares of the normalised ones, and the logarithms of the
/// variances.
#[derive(Clone, Copy, Default)]
struct Sums {
    count: usize,
    square: f64,
    log_variance: f64,
}

impl std::ops::Add for Sums {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            square: self.square + other.square,
            log_variance: self.log_variance + other.log_variance,
        }
    }
}

impl Sums {
    /// True if the residuals are larger than their σ. A gate only lowers their scale, and most leaves are
    /// without misfit.
    fn is_significant(self) -> bool {
        is_significant(self.square / self.count as f64, self.count)
    }
}

impl ResidualsByLeaf {
    fn new(space: &Hierarchy, readings: ProjectedReadings<'_>, noise: &SensorNoise) -> Self {
        let ProjectedReadings { observations, feet, .. } = readings;
        let leaves = space.leaves().len();
        let (first, order) = by_leaf(feet, leaves);
        let counts = |k: &usize| {
            let is_inferred = observations.channels[readings.channel(*k)].inferred;
            feet[*k].state == FootState::Good && feet[*k].quantity == Quantity::Position && !is_inferred
        };
        let good = |leaf: usize| {
            let on_leaf = &order[first[leaf] as usize..first[leaf + 1] as usize];
            on_leaf.iter().map(|&k| k as usize).filter(counts)
        };
        let agrees = |k: &usize| observations.readings.on_surface[readings.subset[*k] as usize];
        // Of each leaf, the readings and those that agree with their neighbours.
        let tallies: Vec<[usize; 2]> = (0..leaves)
            .into_par_iter()
            .with_min_len(64)
            .map(|leaf| [good(leaf).count(), good(leaf).filter(agrees).count()])
            .collect();
        let has_gross_errors = |leaf: usize| {
            let [all, agreeing] = tallies[leaf];
            if agreeing == all {
                return false;
            }
            let near = neighbourhood(space, leaf);
            let [all, agreeing] = [0, 1].map(|i| near.iter().map(|&k| tallies[k][i]).sum::<usize>());
            agreeing as f64 > MIN_AGREEING * all as f64
        };
        let of_leaf = |leaf: usize| -> (Vec<Residual>, Sums) {
            let only_agreeing = has_gross_errors(leaf);
            let residuals: Vec<Residual> = good(leaf)
                .filter(|k| !only_agreeing || agrees(k))
                .map(|k| Residual {
                    height: feet[k].height(),
                    variance: noise.variance_factors[readings.channel(k)] * feet[k].variance,
                })
                .filter(|residual| residual.variance > 0.0)
                .collect();
            let sums = residuals.iter().fold(Sums::default(), |sums, Residual { height, variance }| {
                let square = height * height / variance;
                sums + Sums { count: 1, square, log_variance: variance.ln() }
            });
            (residuals, sums)
        };
        let made: Vec<(Vec<Residual>, Sums)> =
            (0..leaves).into_par_iter().with_min_len(64).map(of_leaf).collect();
        let mut found =
            Self { values: Vec::with_capacity(feet.len()), start: vec![0], sums: Vec::with_capacity(leaves) };
        for (residuals, sums) in made {
            found.values.extend(residuals);
            found.start.push(found.values.len());
            found.sums.push(sums);
        }
        found
    }

    fn of(&self, leaf: usize) -> &[Residual] {
        &self.values[self.start[leaf]..self.start[leaf + 1]]
    }

    fn residuals_of(&self, leaves: &[usize]) -> Vec<Residual> {
        leaves.iter().flat_map(|&leaf| self.of(leaf)).copied().collect()
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

/// True if a mean square of normalised residuals exceeds 1 by more than chance explains.
fn is_significant(square: f64, count: usize) -> bool {
    chi_square_deviation(square, count.max(1) as f64) > SIGNIFICANT
}

/// The variance `m²` beyond those of the readings that explains their residuals; 0 if it is not significant.
/// `noise` is a typical variance of the readings.
///
/// From one iteration to the next, `v + m²` is multiplied by the square of the scale. The start explains
/// half of the residuals, so that no gate excludes most of them.
fn common_variance(residuals: &[Residual], noise: f64, gate: f64) -> Result<f64> {
    let mut needed: Vec<f64> =
        residuals.iter().map(|r| r.height * r.height / CHI_SQUARE_MEDIAN - r.variance).collect();
    let middle = needed.len() / 2;
    let mut variance = needed.select_nth_unstable_by(middle, f64::total_cmp).1.max(0.0);
    for _ in 0..MAX_ITERATIONS {
        let normalised: Vec<f64> =
            residuals.iter().map(|r| r.height / (r.variance + variance).sqrt()).collect();
        let scale = gated_scale(&normalised, gate)?;
        let square = scale.sigma * scale.sigma;
        if variance == 0.0 && !is_significant(square, scale.kept) {
            return Ok(0.0);
        }
        let next = ((variance + noise) * square - noise).max(0.0);
        let is_settled = (next - variance).abs() <= SETTLED * (variance + noise);
        variance = next;
        if is_settled {
            break;
        }
    }
    // As large as a deviation of the scale by chance, it is none.
    Ok(if is_significant(1.0 + variance / noise, residuals.len()) { variance } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Readings whose σ span six decades, all off by the same shape.
    #[test]
    fn a_common_variance_is_found_among_readings_of_any_sigma() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        for (true_variance, outliers) in [(1.0, 0), (1.0, 20), (0.0, 0)] {
            let residuals: Vec<Residual> = (0..400)
                .map(|k| {
                    let variance = 10_f64.powf(rng.random_range(-6.0..2.0));
                    let error: f64 = StandardNormal.sample(&mut rng);
                    let height = if k < outliers { 300.0 } else { (variance + true_variance).sqrt() * error };
                    Residual { height, variance }
                })
                .collect();
            let noise = (residuals.iter().map(|r| r.variance.ln()).sum::<f64>() / 400.0).exp();
            let found = common_variance(&residuals, noise, 4.0).unwrap();
            assert!(
                (found - true_variance).abs() < 0.25 * true_variance.max(4e-3),
                "{found}, {true_variance}"
            );
        }
    }
}
