//! Correlation of the values of neighbouring points.
//!
//! Input: points with one value each. Output: mean products of pairs of values, for a sequence of distances.
//! The points are halved repeatedly across their longest side, so batches of one level are compact and of
//! equal size. A level costs `n` additions, because the products of all pairs in a batch sum to
//! `(Σ z)² − Σ z²`. The variance of a mean of `m` values with correlation `ρ` is `σ² (1/m + (1 − 1/m) ρ)`
//! (batch means: C. Geyer, *Practical Markov chain Monte Carlo*, 1992).
//!
//! The points must not contain the noise that makes up the values. Among readings near a surface, the closest
//! pairs have similar distances from it by selection. Use the foot points on the surface instead: they do not
//! depend on the distance.

use planish_core::{BoundingBox, DVec3};
use rayon::prelude::*;
use std::ops::Range;

/// Fewer points than this are halved by one thread. Trades parallel work against the cost of scheduling.
const SERIAL_POINTS: usize = 20_000;

/// Points in nested batches: `2^k` batches at depth `k`.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_estimate::NestedBatches;
///
/// let points: Vec<DVec3> = (0..16).map(|i| f64::from(i) * DVec3::X).collect();
/// let batches = NestedBatches::new(&points);
/// // The values change sign half way: only neighbours agree.
/// let values: Vec<f64> = (0..16).map(|i| if i < 8 { 1.0 } else { -1.0 }).collect();
/// let products = batches.products(&values, 1);
/// assert_eq!(products[0].mean(), 1.0); // the smallest batches
/// assert!(products[products.len() - 1].mean() < 0.0); // one batch of all points
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NestedBatches {
    order: Vec<u32>,
}

/// Products of the values of two points of one batch, summed over a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairProducts {
    /// Size of the batch of a point, averaged over all points.
    pub size: f64,
    /// `Σ z_i z_j` over ordered pairs of different points.
    pub sum: f64,
    /// Number of ordered pairs.
    pub pairs: f64,
}

impl PairProducts {
    /// The mean product.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.sum / self.pairs
    }

    /// Standard deviation of [`Self::mean`] for independent values of unit variance: `√(2/pairs)`, because
    /// each product is counted twice.
    #[must_use]
    pub fn mean_sigma(&self) -> f64 {
        (2.0 / self.pairs).sqrt()
    }
}

impl NestedBatches {
    /// Builds the batches. The same points give the same batches. Cost: `n log n`.
    #[must_use]
    pub fn new(places: &[DVec3]) -> Self {
        // Indices of four bytes: the order of millions of points then fits the cache twice as well as with
        // eight.
        let mut order: Vec<u32> = (0..places.len() as u32).collect();
        let axes = oblique();
        let turned: Vec<DVec3> =
            places.iter().map(|p| DVec3::from_array(axes.map(|axis| axis.dot(*p)))).collect();
        halve(&turned, &mut order, 0..places.len(), (0, 0));
        Self { order }
    }

    /// Number of levels; the batches of the last level hold two or three points.
    #[must_use]
    pub fn depth(&self) -> u32 {
        (self.order.len() / 2).max(1).ilog2() + 1
    }

    /// The batches of one level.
    pub fn batches(&self, depth: u32) -> impl Iterator<Item = &[u32]> {
        let count = self.order.len();
        (0..1_usize << depth).map(move |k| &self.order[bound(count, k, depth)..bound(count, k + 1, depth)])
    }

    /// Products of the values of neighbours, smallest batches first. Levels with fewer than `min_batches`
    /// batches are omitted.
    #[must_use]
    pub fn products(&self, values: &[f64], min_batches: usize) -> Vec<PairProducts> {
        let first = min_batches.max(1).next_power_of_two().ilog2();
        // Levels are independent, and `collect` keeps their order, so the sums do not depend on the number of
        // threads.
        (first..self.depth())
            .into_par_iter()
            .rev()
            .map(|depth| {
                let (mut sum, mut pairs) = (0.0, 0.0);
                for batch in self.batches(depth) {
                    // (Σ z)² − Σ z² sums all ordered pairs in linear time; a loop over the pairs of a large
                    // batch would be quadratic.
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

/// Axes oblique to any grid: rotated about z, x and z by one radian each.
///
/// If a row of a grid were halved lengthwise, noise would decide on which side a point lies. Points of one
/// side would then be correlated by selection.
fn oblique() -> [DVec3; 3] {
    let (s, c) = 1.0_f64.sin_cos();
    [
        DVec3::new(c * c - s * s * c, s * c + s * c * c, s * s),
        DVec3::new(-c * s - s * c * c, -s * s + c * c * c, c * s),
        DVec3::new(s * s, -c * s, c),
    ]
}

/// Start of the `k`-th batch of a level.
fn bound(count: usize, k: usize, depth: u32) -> usize {
    // The bounds of a level are also bounds of the next one, because `2k` at `depth + 1` gives the same
    // number as `k` at `depth`. That nests the batches, and sizes within a level differ by at most one.
    ((count as u128 * k as u128) >> depth) as usize
}

/// Sorts the points of batch `k` of a level into its two halves, and so on recursively.
fn halve(places: &[DVec3], order: &mut [u32], all: Range<usize>, (k, depth): (usize, u32)) {
    if order.len() < 4 {
        return;
    }
    let Some(bounds) = BoundingBox::around(order.iter().map(|&i| places[i as usize])) else {
        return;
    };
    let side = |axis: &usize| bounds.max[*axis] - bounds.min[*axis];
    // Cutting the longest side keeps batches compact. Long and thin ones would mix near and far pairs.
    let longest = (0..3).max_by(|a, b| side(a).total_cmp(&side(b))).unwrap_or(0);
    let start = bound(all.len(), k, depth);
    let middle = bound(all.len(), 2 * k + 1, depth + 1) - start;
    order.select_nth_unstable_by(middle, |a, b| {
        let [x, y] = [a, b].map(|i| places[*i as usize][longest]);
        // Ties go by index. Otherwise the selection algorithm would decide in which half duplicate points
        // lie.
        x.total_cmp(&y).then(a.cmp(b))
    });
    let serial = order.len() < SERIAL_POINTS;
    let (left, right) = order.split_at_mut(middle);
    let mut lower = || halve(places, left, all.clone(), (2 * k, depth + 1));
    let mut upper = || halve(places, right, all.clone(), (2 * k + 1, depth + 1));
    if serial {
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

    fn places(count: usize) -> Vec<DVec3> {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        (0..count).map(|_| DVec3::new(random.random(), random.random(), 0.0)).collect()
    }

    /// Every point is in one batch of every level, batches are halves of those above, and small ones are
    /// compact.
    #[test]
    fn batches_are_nested_and_compact() {
        for count in [0, 1, 2, 3, 5, 64, 1000, 50_001] {
            let places = places(count);
            let batches = NestedBatches::new(&places);
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
        let batches = NestedBatches::new(&places);
        for batch in batches.batches(10) {
            for axis in 0..2 {
                let along = batch.iter().map(|i| places[*i as usize][axis]);
                let extent = along.clone().fold(0.0, f64::max) - along.fold(1.0, f64::min);
                // A square cut into 2^10 pieces, which lie obliquely.
                assert!(extent < 4.0 / 32.0, "{extent}");
            }
        }
    }

    /// Products of pairs equal those of a double loop.
    #[test]
    fn products_equal_those_of_a_double_loop() {
        let places = places(70);
        let batches = NestedBatches::new(&places);
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

    /// White noise is uncorrelated within the stated σ; a wave is correlated in batches shorter than it.
    #[test]
    fn waves_are_distinguished_from_noise() {
        let places = places(20_000);
        let batches = NestedBatches::new(&places);
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let noise: Vec<f64> = (0..places.len()).map(|_| StandardNormal.sample(&mut random)).collect();
        for level in batches.products(&noise, 16) {
            assert!(level.mean().abs() < 4.0 * level.mean_sigma(), "{level:?}");
        }
        let with_waves: Vec<f64> = (places.iter().zip(&noise))
            .map(|(p, n)| n + 0.2 * 2.0_f64.sqrt() * (std::f64::consts::TAU * 2.0 * p[0]).sin())
            .collect();
        let levels = batches.products(&with_waves, 16);
        let small = levels.iter().find(|level| level.size > 30.0).unwrap();
        assert!((small.mean() - 0.04).abs() < 4.0 * small.mean_sigma() + 0.004, "{small:?}");
        assert!(levels[0].mean_sigma() < 0.01);
    }
}
