//! How alike the noise of neighbours is.
//!
//! Comes in: patches and where they lie on one another. Goes out: for each patch, what share of the variance
//! the mean of some neighbours keeps.
//!
//! σ of a patch says how far a vertex is off, not whether its neighbours are off with it: those of a smooth
//! model are, of a scan whose pose is a little wrong all are. What two patches of one place differ by has the
//! noise of both, so that the products of differences at neighbouring places tell: with `h = n_j − n_i`,
//! `E[h_a h_b] = ρ (σ_i² + σ_j²)` ([`NestedBatches`]). A mean of `m` of them has the variance
//! `σ² (1/m + (1 − 1/m) ρ)`.
//!
//! A difference is to a foot, whose height is a mean of three corners. Feet that share corners are alike of
//! white noise too; that is known from the weights, and taken off. Places are where both patches together
//! say, by their information: those errors are independent of the differences.
//!
//! Not guaranteed: which of two patches it is whose neighbours are alike; both are taken to be. What all
//! patches have in common shows in no difference.

use super::{Overlap, Patch};
use planish_estimate::NestedBatches;
use planish_estimate::vector3::add_scaled;
use rayon::prelude::*;

/// Batches of no more vertices are looked at.
const LARGEST: usize = 4096;
/// Vertices that two patches share of which products are made: batches spread over all.
const LOOKED_AT: usize = 100_000;
/// Sizes of batches, by powers of two.
const SIZES: usize = 14;

/// How alike the noise of neighbours is, by how many there are.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NoiseLikeness {
    /// `ln` of the number of neighbours, and `ρ`; rising numbers.
    curve: Vec<(f64, f64)>,
}

/// Sums over pairs of one size of batches.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    products: f64,
    white: f64,
    pairs: f64,
    members: f64,
}

/// A vertex that lies on another patch.
struct Difference {
    at: [f64; 3],
    /// Over the σ of both.
    height: f64,
    /// Corners of the foot, each with its part of the noise.
    corners: [(u32, f64); 3],
}

impl NoiseLikeness {
    /// `ρ` of the mean of so many neighbours: nothing for white noise, one where all are off together.
    /// Nothing where nothing tells.
    #[must_use]
    pub fn of(&self, neighbours: f64) -> f64 {
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

    /// The share of the variance of one that a mean of so many neighbours keeps: `1/m + (1 − 1/m) ρ`.
    #[must_use]
    pub fn share_of_mean(&self, neighbours: f64) -> f64 {
        let one = 1.0 / neighbours.max(1.0);
        one + (1.0 - one) * self.of(neighbours)
    }
}

/// How alike the noise of neighbours is, of every patch. Cost `n log n`.
#[must_use]
pub fn noise_likeness(patches: &[Patch], overlap: &Overlap) -> Vec<NoiseLikeness> {
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
                    let alike = (s.products - s.white) / (s.pairs - s.white);
                    (size.ln(), alike.clamp(0.0, 1.0))
                })
                .collect();
            NoiseLikeness { curve }
        })
        .collect()
}

/// What patch `i` differs by from patch `j`.
fn differences(patches: &[Patch], overlap: &Overlap, i: usize, j: usize) -> Vec<Difference> {
    let (mine, theirs) = (&overlap.patches[i], &overlap.patches[j]);
    let (mesh, other) = (&patches[i].mesh, &patches[j].mesh);
    (0..mesh.positions.len())
        .filter_map(|v| {
            let foot = mine.feet(v).iter().find(|f| f.patch as usize == j && !f.beside)?;
            let there = other.interpolate(&theirs.sigma, foot.triangle as usize, foot.barycentric);
            let own = mine.sigma[v] * mine.sigma[v];
            let variance = own + there * there;
            let both = variance.sqrt();
            let triangle = other.triangles[foot.triangle as usize];
            Some(Difference {
                at: add_scaled(mesh.positions[v], foot.height * own / variance, mine.normals[v]),
                height: foot.height / both,
                corners: std::array::from_fn(|k| {
                    let corner = triangle[k];
                    (corner, foot.barycentric[k] * theirs.sigma[corner as usize] / both)
                }),
            })
        })
        .collect()
}

/// Adds the products of all pairs of every batch.
fn add(differences: &[Difference], sums: &mut [Sums; SIZES]) {
    let places: Vec<[f64; 3]> = differences.iter().map(|d| d.at).collect();
    let batches = NestedBatches::new(&places);
    let top = (differences.len() / LARGEST).max(1).ilog2();
    let step = differences.len().div_ceil(LOOKED_AT).max(1);
    for depth in top..batches.depth() {
        let of_level: Vec<&[u32]> = (batches.batches(depth).enumerate())
            .filter(|(k, batch)| (k >> (depth - top)).is_multiple_of(step) && batch.len() > 1)
            .map(|(_, batch)| batch)
            .collect();
        let found: Vec<Sums> = of_level.par_iter().map(|batch| of_batch(batch, differences)).collect();
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

fn of_batch(batch: &[u32], differences: &[Difference]) -> Sums {
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

    /// Two sheets with unit edges and noise of the given σ: a share of its variance is waves that are longer
    /// than the sheet is cut into.
    fn sheets(smooth: f64) -> Vec<Patch> {
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
                Patch { mesh, sigma }
            })
            .collect()
    }

    /// White noise has nothing in common though feet share corners; the smooth share is found in small
    /// batches, and less in those that are longer than the waves.
    #[test]
    fn the_smooth_share_of_noise_is_found() {
        for smooth in [0.0, 0.3, 1.0] {
            let patches = sheets(smooth);
            let overlap = Overlap::find(&patches, &OverlapOptions::default()).unwrap();
            for likeness in noise_likeness(&patches, &overlap) {
                for neighbours in [6.0, 20.0, 60.0] {
                    let found = likeness.of(neighbours);
                    assert!(
                        (found - smooth).abs() < 0.05 + 0.25 * smooth,
                        "{neighbours}: {found} for {smooth}"
                    );
                }
                assert!(likeness.of(3000.0) <= 0.1 + 0.5 * smooth);
            }
        }
    }

    /// Nothing that tells is nothing in common.
    #[test]
    fn without_differences_noise_is_white() {
        assert_eq!(NoiseLikeness::default().of(10.0), 0.0);
        assert_eq!(NoiseLikeness::default().share_of_mean(4.0), 0.25);
    }
}
