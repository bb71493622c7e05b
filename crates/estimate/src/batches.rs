//! What values of neighbours have in common.
//!
//! Comes in: places, and a value at each. Goes out: means of products of two values by how near their places
//! are. Places are halved across their longest side, again and again, so that batches of one level are alike
//! in number and each is compact; a level costs `n` additions, as the products of all pairs in a batch are
//! `(Σ z)² − Σ z²`. The variance of a mean of `m` values that are alike by `ρ` is `σ² (1/m + (1 − 1/m) ρ)`
//! (batch means: C. Geyer, *Practical Markov chain Monte Carlo*, 1992).
//!
//! Where places are measured with the noise that the values are made of, neighbours are alike in their noise:
//! of readings about a surface the nearest have the same distance from it. Feet on the surface are places
//! that know nothing of it.

use planish_core::vector3::dot;
use rayon::prelude::*;
use std::ops::Range;

/// So many places are halved by one thread.
const ALONE: usize = 20_000;

/// Places in nested batches: `2^k` of them at depth `k`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NestedBatches {
    order: Vec<u32>,
}

/// Products of the values of two places of one batch, summed over a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairProducts {
    /// Places in a batch, in the mean over all places.
    pub size: f64,
    /// `Σ z_i z_j` over ordered pairs of different places.
    pub sum: f64,
    /// How many ordered pairs.
    pub pairs: f64,
}

impl PairProducts {
    /// The mean product.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.sum / self.pairs
    }

    /// The standard deviation of [`Self::mean`] where values are independent with unit variance:
    /// `√(2/pairs)`, as each product is there twice.
    #[must_use]
    pub fn mean_sigma(&self) -> f64 {
        (2.0 / self.pairs).sqrt()
    }
}

impl NestedBatches {
    /// Batches of places, `n log n`; the same places give the same batches.
    #[must_use]
    pub fn of(places: &[[f64; 3]]) -> Self {
        let mut order: Vec<u32> = (0..places.len() as u32).collect();
        let axes = oblique();
        let turned: Vec<[f64; 3]> = places.iter().map(|p| axes.map(|axis| dot(axis, *p))).collect();
        halve(&turned, &mut order, 0..places.len(), (0, 0));
        Self { order }
    }

    /// How many levels there are; the batches of the last have two to three places.
    #[must_use]
    pub fn depth(&self) -> u32 {
        (self.order.len() / 2).max(1).ilog2() + 1
    }

    /// The batches of one level.
    pub fn batches(&self, depth: u32) -> impl Iterator<Item = &[u32]> {
        let count = self.order.len();
        (0..1_usize << depth).map(move |k| &self.order[bound(count, k, depth)..bound(count, k + 1, depth)])
    }

    /// Products of the values of neighbours, smallest batches first. Only levels with at least `least`
    /// batches are told.
    #[must_use]
    pub fn products(&self, values: &[f64], least: usize) -> Vec<PairProducts> {
        let first = least.max(1).next_power_of_two().ilog2();
        (first..self.depth())
            .into_par_iter()
            .rev()
            .map(|depth| {
                let (mut sum, mut pairs) = (0.0, 0.0);
                for batch in self.batches(depth) {
                    let (mut all, mut own) = (0.0, 0.0);
                    for &i in batch {
                        let z = values[i as usize];
                        all += z;
                        own += z * z;
                    }
                    sum += all * all - own;
                    pairs += (batch.len() * batch.len().saturating_sub(1)) as f64;
                }
                let size = 1.0 + pairs / (self.order.len().max(1) as f64);
                PairProducts { size, sum, pairs }
            })
            .collect()
    }
}

/// Axes along which no grid is laid: about z, x and z by a radian each. Where a row of a grid is halved
/// lengthwise, noise decides who is on which side, and those of one side are alike.
fn oblique() -> [[f64; 3]; 3] {
    let (s, c) = 1.0_f64.sin_cos();
    [
        [c * c - s * s * c, s * c + s * c * c, s * s],
        [-c * s - s * c * c, -s * s + c * c * c, c * s],
        [s * s, -c * s, c],
    ]
}

/// Where the `k`-th batch of a level begins.
fn bound(count: usize, k: usize, depth: u32) -> usize {
    ((count as u128 * k as u128) >> depth) as usize
}

/// Puts places in the order of their batches; `at` is the batch `order` is.
fn halve(places: &[[f64; 3]], order: &mut [u32], all: Range<usize>, (k, depth): (usize, u32)) {
    if order.len() < 4 {
        return;
    }
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for &i in &*order {
        for axis in 0..3 {
            let x = places[i as usize][axis];
            low[axis] = low[axis].min(x);
            high[axis] = high[axis].max(x);
        }
    }
    let side = |axis: &usize| high[*axis] - low[*axis];
    let longest = (0..3).max_by(|a, b| side(a).total_cmp(&side(b))).unwrap_or(0);
    let start = bound(all.len(), k, depth);
    let middle = bound(all.len(), 2 * k + 1, depth + 1) - start;
    order.select_nth_unstable_by(middle, |a, b| {
        let [x, y] = [a, b].map(|i| places[*i as usize][longest]);
        x.total_cmp(&y).then(a.cmp(b))
    });
    let alone = order.len() < ALONE;
    let (left, right) = order.split_at_mut(middle);
    let mut lower = || halve(places, left, all.clone(), (2 * k, depth + 1));
    let mut upper = || halve(places, right, all.clone(), (2 * k + 1, depth + 1));
    if alone {
        lower();
        upper();
    } else {
        rayon::join(lower, upper);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn places(count: usize) -> Vec<[f64; 3]> {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        (0..count).map(|_| [random.random(), random.random(), 0.0]).collect()
    }

    /// Every place is in one batch of every level, batches are those of the level above cut in two, and small
    /// ones are compact.
    #[test]
    fn batches_are_nested_and_compact() {
        for count in [0, 1, 2, 3, 5, 64, 1000, 50_001] {
            let places = places(count);
            let batches = NestedBatches::of(&places);
            let mut seen = vec![false; count];
            batches.order.iter().for_each(|i| seen[*i as usize] = true);
            assert!(seen.iter().all(|s| *s), "{count}");
            for depth in 0..batches.depth() {
                let sizes: Vec<usize> = batches.batches(depth).map(<[u32]>::len).collect();
                assert_eq!(sizes.iter().sum::<usize>(), count);
                assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1, "{count}");
            }
        }
        let places = places(50_001);
        let batches = NestedBatches::of(&places);
        for batch in batches.batches(10) {
            for axis in 0..2 {
                let of = batch.iter().map(|i| places[*i as usize][axis]);
                let extent = of.clone().fold(0.0, f64::max) - of.fold(1.0, f64::min);
                // A square cut into 2^10 pieces, which lie askew.
                assert!(extent < 4.0 / 32.0, "{extent}");
            }
        }
    }

    /// Products of pairs are those that a double loop finds.
    #[test]
    fn products_are_those_of_all_pairs() {
        let places = places(70);
        let batches = NestedBatches::of(&places);
        let values: Vec<f64> = (0..70).map(|i| f64::from(i).sin()).collect();
        for (level, found) in batches.products(&values, 1).iter().rev().enumerate() {
            let (mut sum, mut pairs) = (0.0, 0.0);
            for batch in batches.batches(level as u32) {
                for i in batch {
                    for j in batch.iter().filter(|j| *j != i) {
                        sum += values[*i as usize] * values[*j as usize];
                        pairs += 1.0;
                    }
                }
            }
            assert!((found.sum - sum).abs() < 1e-12 && found.pairs == pairs, "{level}");
        }
    }

    /// Noise has nothing in common, within the stated σ; a wave has while batches are shorter than it.
    #[test]
    fn waves_are_told_from_noise() {
        let places = places(20_000);
        let batches = NestedBatches::of(&places);
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let noise: Vec<f64> = (0..places.len()).map(|_| StandardNormal.sample(&mut random)).collect();
        for level in batches.products(&noise, 16) {
            assert!(level.mean().abs() < 4.0 * level.mean_sigma(), "{level:?}");
        }
        let wavy: Vec<f64> = (places.iter().zip(&noise))
            .map(|(p, n)| n + 0.2 * 2.0_f64.sqrt() * (std::f64::consts::TAU * 2.0 * p[0]).sin())
            .collect();
        let levels = batches.products(&wavy, 16);
        let small = levels.iter().find(|level| level.size > 30.0).unwrap();
        assert!((small.mean() - 0.04).abs() < 4.0 * small.mean_sigma() + 0.004, "{small:?}");
        assert!(levels[0].mean_sigma() < 0.01);
    }
}
