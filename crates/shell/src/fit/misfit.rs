//! What controls cannot follow: residuals that hang together.
//!
//! Comes in: residuals of readings and where these are. Goes out: how many readings say no more than one, and the σ of what the mesh lacks.
//!
//! Noise of one reading tells nothing of its neighbour's. Where the residuals `r_i = n_i + m(x_i)` of neighbours are alike, the rest `m` is shape that the controls do not make. With `ρ_k` the correlation of a residual with that of
//! its `k`-th neighbour, `n` readings know a mean as well as `n / (1 + Σ ρ_k)` that are independent; the sum ends where `ρ_k` is lost in the noise (C. Geyer, *Practical Markov chain Monte Carlo*, 1992, ends his there). And the mean
//! of `r_i r_j` over nearest neighbours is the variance of `m`.
//!
//! Not guaranteed: shape finer than the distances between readings, which looks like noise; what is lacking where nothing is read.

/// Readings whose neighbours are looked at; spread over all.
const LOOKED_AT: usize = 500;
/// Neighbours by powers of two: up to the 511th.
const BLOCKS: usize = 9;
/// A correlation below so many of its own σ is none.
const SIGNIFICANT: f64 = 3.0;
/// Blocks that nearest neighbours are of: the first three.
const NEAREST: usize = 2;
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
}

/// What residuals have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Misfit {
    /// So many readings know as much as one alone; one, where residuals are noise.
    pub together: f64,
    /// The sums whose ratio is the variance of what the mesh lacks: over nearest neighbours, of the products of residuals and of one, each over both σ.
    pub shared: [f64; 2],
}

impl Misfit {
    /// Residuals that are noise, or too few to tell.
    pub(super) const NONE: Self = Self {
        together: 1.0,
        shared: [0.0; 2],
    };

    /// Cost: 500 times the readings.
    pub(super) fn of(residuals: &[Residual]) -> Self {
        let count = residuals.len();
        if count < LEAST {
            return Self::NONE;
        }
        let normalized: Vec<f64> = residuals.iter().map(|r| r.distance / r.sigma).collect();
        let variance = normalized.iter().map(|r| r * r).sum::<f64>() / count as f64;
        if variance.is_nan() || variance <= 0.0 {
            return Self::NONE;
        }
        let most = ((1_usize << BLOCKS) - 1).min(count - 1);
        let (mut products, mut pairs) = ([0.0; BLOCKS], [0_usize; BLOCKS]);
        let mut shared = [0.0; 2];
        let looked_at = count.min(LOOKED_AT);
        for look in 0..looked_at {
            let i = look * count / looked_at;
            let own = residuals[i].at;
            let mut others: Vec<(f64, u32)> = (0..count as u32)
                .filter(|j| *j as usize != i)
                .map(|j| {
                    let at = residuals[j as usize].at;
                    ((0..3).map(|k| (at[k] - own[k]) * (at[k] - own[k])).sum(), j)
                })
                .collect();
            let by_distance = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
            if most < others.len() {
                others.select_nth_unstable_by(most, by_distance);
                others.truncate(most);
            }
            others.sort_unstable_by(by_distance);
            for (rank, (_, j)) in others.iter().enumerate() {
                let (j, block) = (*j as usize, (rank + 1).ilog2() as usize);
                let product = normalized[i] * normalized[j];
                products[block] += product;
                pairs[block] += 1;
                if block < NEAREST {
                    shared[0] += product;
                    shared[1] += 1.0 / (residuals[i].sigma * residuals[j].sigma);
                }
            }
        }
        let mut together = 1.0;
        for block in 0..BLOCKS {
            // Pairs of one reading are not independent: each reading counts once for the σ of a mean.
            let mean = products[block] / pairs[block].max(1) as f64;
            let sigma = variance / (looked_at.min(pairs[block].max(1)) as f64).sqrt();
            if mean < SIGNIFICANT * sigma {
                break;
            }
            together += (1_usize << block).min(most) as f64 * (mean / variance).min(1.0);
        }
        if together == 1.0 {
            return Self::NONE;
        }
        Self { together, shared }
    }

    /// σ of what the mesh lacks, by several kinds of readings.
    pub(super) fn sigma(all: &[Self]) -> f64 {
        let [products, weights] =
            (all.iter()).fold([0.0; 2], |sum, one| [sum[0] + one.shared[0], sum[1] + one.shared[1]]);
        if weights > 0.0 {
            (products / weights).max(0.0).sqrt()
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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

    /// Shape that is left over is found through noise that is larger, with its size; longer waves make more readings say the same.
    #[test]
    fn waves_are_found_through_noise() {
        let [short, long] = [0.25, 0.5].map(|length| Misfit::of(&residuals(6000, 1.0, length)));
        for found in [short, long] {
            let sigma = Misfit::sigma(&[found]);
            assert!((sigma - 1.0).abs() < 0.15, "{sigma}");
        }
        assert!(
            short.together > 5.0 && long.together > 1.5 * short.together,
            "{short:?} {long:?}"
        );
        // Kinds without any leave it as it is.
        assert_eq!(Misfit::sigma(&[short, Misfit::NONE]), Misfit::sigma(&[short]));
        assert_eq!(Misfit::sigma(&[]), 0.0);
    }
}
