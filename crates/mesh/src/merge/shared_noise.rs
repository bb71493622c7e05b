//! Correlation of the noise of neighbouring vertices, estimated from the differences between patches.
//!
//! In: patches and their overlap. Out: for each patch, the correlation by the number of neighbours.
//!
//! σ of a vertex does not state whether the errors of its neighbours are correlated. They are in a smoothed
//! model, and all of them are in a scan with a pose error. The difference of two patches contains the noise
//! of both, so that products of differences at neighbouring points show the correlation: with `h = n_j −
//! n_i`, `E[h_a h_b] = ρ (σ_i² + σ_j²)` ([`NestedBatches`]). A mean of `m` values has the variance `σ² (1/m +
//! (1 − 1/m) ρ)`.
//!
//! The height of a foot point interpolates three corners. Feet that share corners are therefore correlated
//! even for white noise; this part is known from the weights and subtracted. Batches are formed from the
//! positions of the weighted mean, whose errors are independent of the differences.
//!
//! Not guaranteed: the difference does not show which of the two patches has correlated noise; both are
//! assumed to. Errors common to all patches are not detected.

use super::{MergePatch, Overlap};
use planish_core::DVec3;
use planish_estimate::NestedBatches;
use rayon::prelude::*;

/// Maximum number of vertices in a batch.
///
/// Correlations over longer distances are not resolved; means over more neighbours use the value at this
/// size.
const MAX_BATCH: usize = 4096;
/// Number of shared vertices above which only every n-th batch is used; bounds the cost.
const MAX_SAMPLES: usize = 100_000;
/// Number of batch sizes, in powers of two.
const SIZES: usize = 14;

/// Correlation of the noise of neighbouring vertices, as a function of their number.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NoiseCorrelation {
    /// Pairs of `ln(number of neighbours)` (increasing) and `ρ`.
    curve: Vec<(f64, f64)>,
}

/// Sums over pairs of vertices in batches of one size.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    products: f64,
    white: f64,
    pairs: f64,
    members: f64,
}

/// The difference of two patches at a vertex of the first.
struct Difference {
    at: DVec3,
    /// Height of the foot point over the vertex, divided by the σ of the difference.
    height: f64,
    /// Corners of the triangle of the foot point, each with its share of the noise.
    corners: [(u32, f64); 3],
}

impl NoiseCorrelation {
    /// Correlation `ρ` in a mean of this number of neighbours: 0 for white noise, 1 for a common error.
    ///
    /// Without overlaps, noise is assumed to be white.
    #[must_use]
    pub fn correlation(&self, neighbours: f64) -> f64 {
        let x = neighbours.max(1.0).ln();
        let next = self.curve.partition_point(|(at, _)| *at < x);
        let (Some(below), Some(above)) =
            (self.curve.get(next.saturating_sub(1)), self.curve.get(next).or(self.curve.last()))
        else {
            return 0.0;
        };
        if above.0 <= below.0 {
            return below.1;
        }
        below.1 + (above.1 - below.1) * (x - below.0) / (above.0 - below.0)
    }

    /// Variance of a mean of `m` neighbours relative to that of one: `1/m + (1 − 1/m) ρ`.
    ///
    /// # Examples
    /// ```
    /// // White noise.
    /// assert_eq!(planish_mesh::NoiseCorrelation::default().share_of_mean(4.0), 0.25);
    /// ```
    #[must_use]
    pub fn share_of_mean(&self, neighbours: f64) -> f64 {
        let one = 1.0 / neighbours.max(1.0);
        one + (1.0 - one) * self.correlation(neighbours)
    }
}

/// Estimates the noise correlation of every patch. Cost O(n log n).
#[must_use]
pub fn noise_correlation(patches: &[MergePatch], overlap: &Overlap) -> Vec<NoiseCorrelation> {
    (0..patches.len())
        .into_par_iter()
        .map(|i| {
            let mut sums = [Sums::default(); SIZES];
            for j in (0..patches.len()).filter(|j| *j != i) {
                add(&differences(patches, overlap, i, j), &mut sums);
            }
            let curve = (sums.iter().filter(|s| s.pairs > s.white && s.members > 0.0))
                .map(|s| {
                    let size = 1.0 + s.pairs / s.members;
                    // The expected sum of products is ρ times the pairs, plus (1 − ρ) times what shared
                    // corners contribute.
                    let correlation = (s.products - s.white) / (s.pairs - s.white);
                    (size.ln(), correlation.clamp(0.0, 1.0))
                })
                .collect();
            NoiseCorrelation { curve }
        })
        .collect()
}

/// Differences of patch `j` from patch `i`, at the vertices of `i`.
fn differences(patches: &[MergePatch], overlap: &Overlap, i: usize, j: usize) -> Vec<Difference> {
    let (own_overlap, other_overlap) = (&overlap.patches[i], &overlap.patches[j]);
    let (mesh, other) = (&patches[i].mesh, &patches[j].mesh);
    (0..mesh.positions.len())
        .filter_map(|v| {
            let foot = own_overlap.feet(v).iter().find(|f| f.patch as usize == j && !f.beyond_border)?;
            let other_sigma =
                other.interpolate(&other_overlap.sigma, foot.triangle as usize, foot.barycentric);
            let own = own_overlap.sigma[v] * own_overlap.sigma[v];
            let variance = own + other_sigma * other_sigma;
            let both = variance.sqrt();
            let triangle = other.triangles[foot.triangle as usize];
            Some(Difference {
                // The position of the weighted mean: its error is independent of the difference, so that
                // forming batches by position does not select differences.
                at: mesh.positions[v] + foot.height * own / variance * own_overlap.normals[v],
                height: foot.height / both,
                corners: std::array::from_fn(|k| {
                    let corner = triangle[k];
                    (corner, foot.barycentric[k] * other_overlap.sigma[corner as usize] / both)
                }),
            })
        })
        .collect()
}

/// Adds the products of all pairs within each batch to the sums of its size.
fn add(differences: &[Difference], sums: &mut [Sums; SIZES]) {
    let places: Vec<DVec3> = differences.iter().map(|d| d.at).collect();
    let batches = NestedBatches::new(&places);
    let top = (differences.len() / MAX_BATCH).max(1).ilog2();
    let step = differences.len().div_ceil(MAX_SAMPLES).max(1);
    for depth in top..batches.depth() {
        let of_level: Vec<&[u32]> = (batches.batches(depth).enumerate())
            .filter(|(k, batch)| (k >> (depth - top)).is_multiple_of(step) && batch.len() > 1)
            .map(|(_, batch)| batch)
            .collect();
        let found: Vec<Sums> = of_level.par_iter().map(|batch| sums_of_batch(batch, differences)).collect();
        for one in found {
            let size = 1.0 + one.pairs / one.members;
            let sum = &mut sums[(size.log2().round() as usize).min(SIZES - 1)];
            sum.products += one.products;
            sum.white += one.white;
            sum.pairs += one.pairs;
            sum.members += one.members;
        }
    }
}

/// Sums over the pairs of one batch: `Σ_{a≠b} h_a h_b = (Σ h)² − Σ h²`.
fn sums_of_batch(batch: &[u32], differences: &[Difference]) -> Sums {
    let (mut all, mut own) = (0.0, 0.0);
    let mut corners: Vec<(u32, f64)> = Vec::with_capacity(3 * batch.len());
    let mut white = 0.0;
    for &d in batch {
        let one = &differences[d as usize];
        all += one.height;
        own += one.height * one.height;
        corners.extend(one.corners);
        white -= one.corners.iter().map(|(_, a)| a * a).sum::<f64>();
    }
    // With white noise, two heights are correlated only by the corners that they share: per corner, the
    // square of the sum of weights minus the squares, which the loop above has subtracted.
    corners.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    for of_corner in corners.chunk_by(|a, b| a.0 == b.0) {
        let sum: f64 = of_corner.iter().map(|(_, a)| a).sum();
        white += sum * sum;
    }
    Sums {
        products: all * all - own,
        white,
        pairs: (batch.len() * (batch.len() - 1)) as f64,
        members: batch.len() as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::super::OverlapOptions;
    use super::*;
    use crate::primitives::grid_sheet;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Two sheets with unit edges and noise of σ = 0.05. The share `smooth` of the variance is in long waves.
    fn sheets(smooth: f64) -> Vec<MergePatch> {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        [0.0, 0.37]
            .iter()
            .map(|shift| {
                let mut mesh = grid_sheet(80.0, 80.0, 80, 80);
                let phases: [f64; 8] = std::array::from_fn(|_| std::f64::consts::TAU * rng.random::<f64>());
                for p in &mut mesh.positions {
                    p[0] += shift;
                    p[1] += 0.7 * shift;
                    let white: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
                    let wave: f64 = (0..8)
                        .map(|k| {
                            let (s, c) = (0.8 * k as f64).sin_cos();
                            0.5 * (0.12 * (c * p[0] + s * p[1]) + phases[k]).sin()
                        })
                        .sum();
                    p[2] = 0.05 * ((1.0 - smooth).sqrt() * white + smooth.sqrt() * wave);
                }
                let sigma = vec![0.05; mesh.positions.len()];
                MergePatch { mesh, sigma }
            })
            .collect()
    }

    /// White noise is found to be uncorrelated although feet share corners. The smooth share is found in
    /// small batches, and less of it in batches that are larger than the waves.
    #[test]
    fn the_smooth_share_of_noise_is_found() {
        for smooth in [0.0, 0.3, 1.0] {
            let patches = sheets(smooth);
            // Few long waves look like a σ that is too small.
            let options = OverlapOptions { believe_sigma: true, ..OverlapOptions::default() };
            let overlap = Overlap::find(&patches, &options).unwrap();
            for found in noise_correlation(&patches, &overlap) {
                for neighbours in [6.0, 20.0, 60.0] {
                    let rho = found.correlation(neighbours);
                    assert!((rho - smooth).abs() < 0.05 + 0.25 * smooth, "{neighbours}: {rho} for {smooth}");
                }
                assert!(found.correlation(3000.0) <= 0.1 + 0.5 * smooth);
            }
        }
    }

    /// Without overlaps, noise is assumed to be white.
    #[test]
    fn without_differences_noise_is_white() {
        assert_eq!(NoiseCorrelation::default().correlation(10.0), 0.0);
        assert_eq!(NoiseCorrelation::default().share_of_mean(4.0), 0.25);
    }
}
