//! Correlation of residuals: unresolved shape that the controls cannot represent.
//!
//! In: residuals of readings and their positions. Out: the number of correlated readings that are worth one,
//! and the σ of the unresolved shape.
//!
//! The noise of neighbouring readings is independent. If their residuals `r_i = n_i + m(x_i)` are correlated,
//! the common part `m` is shape that the controls cannot represent. In batches of `c` neighbours
//! ([`NestedBatches`]) with correlation `ρ`, the variance of a mean is `1 + (c − 1) ρ` times that of
//! independent residuals. The mean of `r_i r_j` over pairs in small batches is the variance of `m`.
//!
//! The fit itself correlates the residuals of noise by `−h_ij`, with `H = A N⁻¹ Aᵀ` of the whitened equations
//! `A`. This would hide a small `m`, so it is compensated: `tr(B H)` over the pairs of a level is estimated
//! by random signs (M. Hutchinson, 1990).
//!
//! Not guaranteed: shape finer than the spacing of readings looks like noise, and unresolved shape without
//! readings is not detected.

use planish_core::DVec3;
use planish_estimate::NestedBatches;

/// Significance, in σ, from which a mean product counts as correlation. Lower values call noise unresolved
/// shape.
const MIN_SIGNIFICANCE: f64 = 3.0;
/// Minimum number of batches of a level that is used. The relative standard error of a mean square of 16
/// values is 35 %.
const MIN_BATCHES: usize = 16;
/// Minimum number of readings from which a correlation is estimated: the relative standard error of a
/// variance from 30 values is 26 %.
const MIN_RESIDUALS: usize = 30;

/// A residual with its position.
#[derive(Debug, Clone, Copy)]
pub(super) struct Residual {
    /// Position; neighbours by it are neighbours on the object.
    pub at: DVec3,
    /// Residual as a distance.
    pub distance: f64,
    /// The σ of its noise.
    pub sigma: f64,
    /// Random signs `s`.
    pub signs: [f64; DRAWS],
    /// Their residuals after the fit, `s − H s`.
    pub left: [f64; DRAWS],
}

/// Random signs per reading. More would not help, because the noise of the products dominates.
pub(super) const DRAWS: usize = 4;

/// The correlation of residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ResidualCorrelation {
    /// Number of readings that carry the information of one; 1 if residuals are noise.
    pub together: f64,
    /// Sums whose ratio is the variance of the unresolved shape: over pairs of neighbours, of the products of
    /// residuals and of one, each divided by both σ.
    pub shared: [f64; 2],
}

impl ResidualCorrelation {
    /// No significant correlation, or too few residuals.
    pub(super) const NONE: Self = Self { together: 1.0, shared: [0.0; 2] };

    /// Estimates the correlation. Cost: `n log n`.
    pub(super) fn from_residuals(residuals: &[Residual]) -> Self {
        if residuals.len() < MIN_RESIDUALS {
            return Self::NONE;
        }
        // Normalised, so that readings with different σ can be compared. A common factor on σ cancels below.
        let normalized: Vec<f64> = residuals.iter().map(|r| r.distance / r.sigma).collect();
        let variance = normalized.iter().map(|r| r * r).sum::<f64>() / residuals.len() as f64;
        if !(variance > 0.0 && variance.is_finite()) {
            return Self::NONE;
        }
        let places: Vec<DVec3> = residuals.iter().map(|r| r.at).collect();
        let batches = NestedBatches::new(&places);
        let products = |value_of: &dyn Fn(&Residual) -> f64| {
            let values: Vec<f64> = residuals.iter().map(value_of).collect();
            batches.products(&values, MIN_BATCHES)
        };
        let levels = batches.products(&normalized, MIN_BATCHES);
        // The sum over pairs that the fit itself removes, estimated from random signs.
        let mut removed_by_fit = vec![0.0; levels.len()];
        for draw in 0..DRAWS {
            let [signs, left] = [products(&|r| r.signs[draw]), products(&|r| r.left[draw])];
            for (removed_by_fit, (signs, left)) in removed_by_fit.iter_mut().zip(signs.iter().zip(left)) {
                *removed_by_fit += (signs.sum - left.sum) / DRAWS as f64;
            }
        }
        let weights = products(&|r| 1.0 / r.sigma);
        let mut found = Self::NONE;
        let mut best = 0.0;
        for ((level, removed_by_fit), weights) in levels.iter().zip(removed_by_fit).zip(weights) {
            let correlation = (level.sum / variance + removed_by_fit) / level.pairs;
            // A level counts only if its correlation is significant; the most significant one gives the
            // variance of the shape.
            let significant = correlation - MIN_SIGNIFICANCE * level.mean_sigma();
            if significant <= 0.0 {
                continue;
            }
            let correlation = correlation.min(1.0);
            found.together = found.together.max(1.0 + (level.size - 1.0) * correlation);
            if significant > best {
                best = significant;
                found.shared = [correlation * variance * level.pairs, weights.sum];
            }
        }
        found
    }

    /// σ of the unresolved shape, from several kinds of readings.
    pub(super) fn sigma(all: &[Self]) -> f64 {
        let [products, weights] =
            (all.iter()).fold([0.0; 2], |sum, one| [sum[0] + one.shared[0], sum[1] + one.shared[1]]);
        if weights > 0.0 { (products / weights).max(0.0).sqrt() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Noise of σ 1 to 3 on a square, plus waves of a given height and length.
    fn residuals(count: usize, height: f64, length: f64) -> Vec<Residual> {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        (0..count)
            .map(|_| {
                let at = DVec3::new(random.random::<f64>(), random.random::<f64>(), 0.0);
                let sigma = random.random_range(1.0..3.0);
                let noise: f64 = StandardNormal.sample(&mut random);
                let turn = std::f64::consts::TAU / length;
                let wave = 2.0 * height * (turn * at[0]).sin() * (turn * at[1]).sin();
                Residual {
                    at,
                    distance: sigma * noise + wave,
                    sigma,
                    signs: [0.0; DRAWS],
                    left: [0.0; DRAWS],
                }
            })
            .collect()
    }

    /// A good mesh is accepted for any σ of its readings.
    #[test]
    fn noise_is_uncorrelated() {
        assert_eq!(
            ResidualCorrelation::from_residuals(&residuals(4000, 0.0, 1.0)),
            ResidualCorrelation::NONE
        );
        assert_eq!(ResidualCorrelation::from_residuals(&residuals(10, 5.0, 1.0)), ResidualCorrelation::NONE);
    }

    /// Unresolved shape is estimated below larger noise. Longer waves correlate more readings.
    #[test]
    fn unresolved_waves_are_found_in_noise() {
        let [short, long] =
            [0.25, 0.5].map(|length| ResidualCorrelation::from_residuals(&residuals(6000, 1.0, length)));
        for found in [short, long] {
            let sigma = ResidualCorrelation::sigma(&[found]);
            assert!((sigma - 1.0).abs() < 0.15, "{sigma}");
        }
        assert!(short.together > 5.0 && long.together > 1.5 * short.together, "{short:?} {long:?}");
        // Empty kinds do not change it.
        assert_eq!(
            ResidualCorrelation::sigma(&[short, ResidualCorrelation::NONE]),
            ResidualCorrelation::sigma(&[short])
        );
        assert_eq!(ResidualCorrelation::sigma(&[]), 0.0);
    }

    /// A fit with many unknowns absorbs noise, which correlates its residuals. After compensation a smaller
    /// wave is estimated with its amplitude, and noise alone has none.
    #[test]
    fn the_fits_own_correlation_is_compensated() {
        let (count, waves) = (4000, 12);
        let mut random = ChaCha8Rng::seed_from_u64(9);
        let at: Vec<DVec3> = (0..count).map(|_| DVec3::new(random.random(), random.random(), 0.0)).collect();
        let cosine = |k: usize, x: f64| (std::f64::consts::PI * k as f64 * x).cos();
        let design = DMatrix::from_fn(count, waves * waves, |i, k| {
            cosine(k / waves, at[i][0]) * cosine(k % waves, at[i][1])
        });
        let normal = (design.transpose() * &design).cholesky().unwrap();
        let left_of = |values: &DVector<f64>| values - &design * normal.solve(&(design.transpose() * values));
        let draws: Vec<DVector<f64>> = (0..DRAWS)
            .map(|_| DVector::from_fn(count, |_, _| if random.random::<bool>() { 1.0 } else { -1.0 }))
            .collect();
        let left: Vec<DVector<f64>> = draws.iter().map(left_of).collect();
        let noise = DVector::from_fn(count, |_, _| StandardNormal.sample(&mut random));
        let found = |height: f64, corrected: bool| {
            let wave = DVector::from_fn(count, |i, _| 2.0_f64.sqrt() * height * cosine(13, at[i][0]));
            let fitted = left_of(&(&noise + wave));
            let residuals: Vec<Residual> = (0..count)
                .map(|i| Residual {
                    at: at[i],
                    distance: fitted[i],
                    sigma: 1.0,
                    signs: std::array::from_fn(|d| draws[d][i]),
                    left: std::array::from_fn(|d| if corrected { left[d][i] } else { draws[d][i] }),
                })
                .collect();
            ResidualCorrelation::from_residuals(&residuals)
        };
        assert_eq!(found(0.0, true), ResidualCorrelation::NONE);
        let [uncorrected, sigma] =
            [false, true].map(|corrected| ResidualCorrelation::sigma(&[found(0.35, corrected)]));

        let removed_by_fit = (waves * waves) as f64 / count as f64;
        assert!(sigma > 0.25 && sigma < 0.38, "{sigma}");
        assert!(
            (sigma * sigma - uncorrected * uncorrected - removed_by_fit).abs() < 0.3 * removed_by_fit,
            "{sigma} {uncorrected}"
        );
    }
}
