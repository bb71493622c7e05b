//! What controls cannot follow: residuals that hang together.
//!
//! Comes in: residuals of readings and where these are. Goes out: how many readings say no more than one, and
//! the σ of what the mesh lacks.
//!
//! Noise of one reading tells nothing of its neighbour's. Where the residuals `r_i = n_i + m(x_i)` of
//! neighbours are alike, the rest `m` is shape that the controls do not make. In batches of `c` neighbours
//! ([`NestedBatches`]) whose residuals are alike by `ρ`, a mean varies `1 + (c − 1) ρ` times as much as that
//! of independent ones, and the mean of `r_i r_j` over pairs of small batches is the variance of `m`.
//!
//! A fit takes from residuals what its unknowns follow: of noise they are alike by `−h_ij`, with
//! `H = A N⁻¹ Aᵀ` of the whitened equations `A`. That is what `m` has to be seen through where it is small,
//! so it is taken off: `tr(B H)` over the pairs of a level by random signs (M. Hutchinson, 1990).
//!
//! Not guaranteed: shape finer than the distances between readings, which looks like noise; what is lacking
//! where nothing is read.

use planish_estimate::NestedBatches;

/// A mean product below so many of its own σ is none.
const SIGNIFICANT: f64 = 3.0;
/// Batches of a level that tells anything.
const LEAST_BATCHES: usize = 16;
/// Readings that are told anything by.
const LEAST: usize = 30;

/// A residual and where it is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Residual {
    /// A place: neighbours by it are neighbours on the thing.
    pub at: [f64; 3],
    /// Measured less predicted, as a distance.
    pub distance: f64,
    /// The σ of its noise.
    pub sigma: f64,
    /// Random signs `s`.
    pub signs: [f64; DRAWS],
    /// What the fit leaves of them, `s − H s`.
    pub left: [f64; DRAWS],
}

/// Random signs of each reading; more of them do not matter beside the noise of the products themselves.
pub(super) const DRAWS: usize = 4;

/// What residuals have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Misfit {
    /// So many readings know as much as one alone; one, where residuals are noise.
    pub together: f64,
    /// The sums whose ratio is the variance of what the mesh lacks: over pairs of neighbours, of the products
    /// of residuals and of one, each over both σ.
    pub shared: [f64; 2],
}

impl Misfit {
    /// Residuals that are noise, or too few to tell.
    pub(super) const NONE: Self = Self { together: 1.0, shared: [0.0; 2] };

    /// Cost: `n log n`.
    pub(super) fn of(residuals: &[Residual]) -> Self {
        if residuals.len() < LEAST {
            return Self::NONE;
        }
        let normalized: Vec<f64> = residuals.iter().map(|r| r.distance / r.sigma).collect();
        let variance = normalized.iter().map(|r| r * r).sum::<f64>() / residuals.len() as f64;
        if !(variance > 0.0 && variance.is_finite()) {
            return Self::NONE;
        }
        let places: Vec<[f64; 3]> = residuals.iter().map(|r| r.at).collect();
        let batches = NestedBatches::new(&places);
        let products = |of: &dyn Fn(&Residual) -> f64| {
            let values: Vec<f64> = residuals.iter().map(of).collect();
            batches.products(&values, LEAST_BATCHES)
        };
        let levels = batches.products(&normalized, LEAST_BATCHES);
        let mut taken = vec![0.0; levels.len()];
        for draw in 0..DRAWS {
            let [signs, left] = [products(&|r| r.signs[draw]), products(&|r| r.left[draw])];
            for (taken, (signs, left)) in taken.iter_mut().zip(signs.iter().zip(left)) {
                *taken += (signs.sum - left.sum) / DRAWS as f64;
            }
        }
        let weights = products(&|r| 1.0 / r.sigma);
        let mut found = Self::NONE;
        let mut most = 0.0;
        for ((level, taken), weights) in levels.iter().zip(taken).zip(weights) {
            let alike = (level.sum / variance + taken) / level.pairs;
            let sure = alike - SIGNIFICANT * level.mean_sigma();
            if sure <= 0.0 {
                continue;
            }
            let alike = alike.min(1.0);
            found.together = found.together.max(1.0 + (level.size - 1.0) * alike);
            if sure > most {
                most = sure;
                found.shared = [alike * variance * level.pairs, weights.sum];
            }
        }
        found
    }

    /// σ of what the mesh lacks, by several kinds of readings.
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

    /// Noise of σ 1 to 3 on a square, and waves of the given height and length.
    fn residuals(count: usize, height: f64, length: f64) -> Vec<Residual> {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        (0..count)
            .map(|_| {
                let at = [random.random::<f64>(), random.random::<f64>(), 0.0];
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

    /// A good mesh is not called a bad one, whatever the σ of its readings.
    #[test]
    fn noise_has_nothing_in_common() {
        assert_eq!(Misfit::of(&residuals(4000, 0.0, 1.0)), Misfit::NONE);
        assert_eq!(Misfit::of(&residuals(10, 5.0, 1.0)), Misfit::NONE);
    }

    /// Shape that is left over is found through noise that is larger, with its size; longer waves make more
    /// readings say the same.
    #[test]
    fn waves_are_found_through_noise() {
        let [short, long] = [0.25, 0.5].map(|length| Misfit::of(&residuals(6000, 1.0, length)));
        for found in [short, long] {
            let sigma = Misfit::sigma(&[found]);
            assert!((sigma - 1.0).abs() < 0.15, "{sigma}");
        }
        assert!(short.together > 5.0 && long.together > 1.5 * short.together, "{short:?} {long:?}");
        // Kinds without any leave it as it is.
        assert_eq!(Misfit::sigma(&[short, Misfit::NONE]), Misfit::sigma(&[short]));
        assert_eq!(Misfit::sigma(&[]), 0.0);
    }

    /// A wave that is small beside what a fit of many unknowns takes from noise is found with its size, as
    /// that is taken off; noise alone stays noise.
    #[test]
    fn what_a_fit_takes_is_taken_off() {
        let (count, waves) = (4000, 12);
        let mut random = ChaCha8Rng::seed_from_u64(9);
        let at: Vec<[f64; 3]> = (0..count).map(|_| [random.random(), random.random(), 0.0]).collect();
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
        let found = |height: f64, taken_off: bool| {
            let wave = DVector::from_fn(count, |i, _| 2.0_f64.sqrt() * height * cosine(13, at[i][0]));
            let fitted = left_of(&(&noise + wave));
            let residuals: Vec<Residual> = (0..count)
                .map(|i| Residual {
                    at: at[i],
                    distance: fitted[i],
                    sigma: 1.0,
                    signs: std::array::from_fn(|d| draws[d][i]),
                    left: std::array::from_fn(|d| if taken_off { left[d][i] } else { draws[d][i] }),
                })
                .collect();
            Misfit::of(&residuals)
        };
        assert_eq!(found(0.0, true), Misfit::NONE);
        let [untold, sigma] = [false, true].map(|taken_off| Misfit::sigma(&[found(0.35, taken_off)]));

        let taken = (waves * waves) as f64 / count as f64;
        assert!(sigma > 0.25 && sigma < 0.38, "{sigma}");
        assert!((sigma * sigma - untold * untold - taken).abs() < 0.3 * taken, "{sigma} {untold}");
    }
}
