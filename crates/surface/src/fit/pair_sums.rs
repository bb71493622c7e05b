//! Sums over pairs of different readings that are near each other, by which shape is separated from noise.
//!
//! Input: readings with their feet, and the covariance of the surface. Output: what the residuals of pairs
//! have in common. Errors of the surface are `e`, and those of the readings are independent, so that
//!
//! ```text
//! E[h_i h_j] = E[e_i e_j] − 2 Σ_ij,
//! ```
//!
//! because each reading pulls the surface by `Σ_ij` over its variance at the other reading. The mean square
//! of the error beyond the covariance is `h_i h_j + Σ_ij` of readings at one place.
//!
//! [`PairSums`] count all pairs of a bin alike. [`LagSums`] extrapolate to the distance zero, like the nugget
//! of a variogram: shape as fine as the spacing of the readings is not common to readings one spacing apart.
//!
//! # References
//! Matheron, *Principles of geostatistics*, 1963 (the variogram and its nugget).

use crate::model::LeafCovariance;
use crate::observe::Foot;
use planish_core::DVec3;
use planish_estimate::chi_square_deviation;
use planish_spline::{Surface, leaf_weights};

/// Largest distance of the pairs of [`LagSums`], in spacings. On five surfaces with and without facets, lines
/// over 1.5 spacings gave 0.91 to 1.22 times the mean square of the true errors, those over 2 spacings 0.83
/// to 1.1 times with a quarter less noise (decision 0130).
const MAX_LAG: f64 = 1.5;
/// Readings of a square of a leaf of which all pairs are looked at.
const READINGS_PER_SQUARE: f64 = 32.0;
/// Smallest determinant of the equations of a line, as a share of that of distances without a mean.
const MIN_DETERMINANT: f64 = 1e-3;

/// Sums over the bins of a leaf, or of several leaves.
#[derive(Clone, Copy, Default)]
pub(super) struct PairSums {
    /// `Σ_b ((Σ w h)² − Σ (w h)²)/Σ w`.
    pub shape: f64,
    /// `Σ_b (Σ w − Σ w²/Σ w)`.
    pub precision: f64,
    /// Variance of `shape` under noise: `2 Σ_b (1 − 1/n_b)` for bins of `n_b` readings.
    pub spread: f64,
    /// Variance of the surface at the readings, times `precision`.
    pub of_surface: f64,
}

impl PairSums {
    pub(super) fn add(&mut self, other: &Self) {
        self.shape += other.shape;
        self.precision += other.precision;
        self.spread += other.spread;
        self.of_surface += other.of_surface;
    }

    /// `m²`, which may be negative by chance; none without pairs.
    pub(super) fn estimate(&self) -> Option<f64> {
        (self.precision > 0.0).then(|| (self.shape + self.of_surface) / self.precision)
    }

    /// True if `m²` is this many standard deviations above zero.
    ///
    /// With `ν = spread/2` degrees of freedom, `shape + ν` is χ² under noise.
    pub(super) fn is_significant(&self, deviations: f64) -> bool {
        let degrees = 0.5 * self.spread;
        let mean = (self.shape + self.of_surface) / degrees + 1.0;
        self.spread > 0.0 && chi_square_deviation(mean, degrees) > deviations
    }

    /// `m²`, if it is significant.
    pub(super) fn significant(&self, deviations: f64) -> Option<f64> {
        self.estimate().filter(|_| self.is_significant(deviations))
    }
}

/// The readings of one bin.
#[derive(Clone, Default)]
struct Bin {
    /// `Σ w h`, `Σ (w h)²`, `Σ w` and `Σ w²`.
    pull: f64,
    pulls_squared: f64,
    precision: f64,
    squared: f64,
    count: f64,
    /// `Σ w a` and `Σ w n`, with the weights `a` of the leaf's coefficients at a foot.
    row: [f64; 16],
    normal: DVec3,
}

impl Bin {
    fn add(&mut self, foot: &Foot, w: f64) {
        let pull = w * foot.height();
        self.pull += pull;
        self.pulls_squared += pull * pull;
        self.precision += w;
        self.squared += w * w;
        self.count += 1.0;
        for (sum, a) in self.row.iter_mut().zip(leaf_weights(foot.local[0], foot.local[1])) {
            *sum += w * a;
        }
        self.normal += w * foot.normal;
    }

    /// Its pairs.
    ///
    /// The variance is that at the readings of the bin. It differs from place to place: if readings are
    /// dense, that in the middle of a cell is 0.65 times the mean over the cell (decision 0130).
    fn pairs(&self, covariance: &LeafCovariance<'_>) -> PairSums {
        let precision = self.precision - self.squared / self.precision;
        let mean_row = self.row.map(|a| a / self.precision);
        let variance = covariance.variance_along(&mean_row, self.normal.normalize_or_zero());
        PairSums {
            shape: (self.pull * self.pull - self.pulls_squared) / self.precision,
            precision,
            spread: 2.0 * (1.0 - 1.0 / self.count),
            of_surface: variance.max(0.0) * precision,
        }
    }
}

/// The pairs of readings of a leaf that share one of `side` × `side` bins. Each reading comes with its
/// weight.
pub(super) fn pairs_in_bins(
    readings: &[(&Foot, f64)],
    side: usize,
    covariance: &LeafCovariance<'_>,
) -> PairSums {
    let mut bins = vec![Bin::default(); side * side];
    for &(foot, w) in readings {
        let [i, j] = foot.local.map(|x| ((x * side as f64) as usize).min(side - 1));
        bins[j * side + i].add(foot, w);
    }
    let mut sums = PairSums::default();
    for bin in bins.iter().filter(|bin| bin.count > 1.0) {
        sums.add(&bin.pairs(covariance));
    }
    sums
}

/// Sums over pairs of readings by their distance `d`, in spacings of the readings: a straight line through
/// `y = h_i h_j + Σ_ij`, with the inverse product of the variances of both readings as weight `q`.
#[derive(Clone, Copy, Default)]
pub(super) struct LagSums {
    /// Number of pairs.
    pub count: f64,
    /// `Σ q`, `Σ q d` and `Σ q d²`.
    weights: [f64; 3],
    /// `Σ q y` and `Σ q y d`.
    products: [f64; 2],
}

impl LagSums {
    pub(super) fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.weights.iter_mut().zip(other.weights).for_each(|(own, other)| *own += other);
        self.products.iter_mut().zip(other.products).for_each(|(own, other)| *own += other);
    }

    pub(super) fn add_pair(&mut self, distance: f64, product: f64, weight: f64) {
        let powers = [1.0, distance, distance * distance].map(|power| weight * power);
        self.count += 1.0;
        self.weights.iter_mut().zip(powers).for_each(|(own, power)| *own += power);
        self.products.iter_mut().zip(powers).for_each(|(own, power)| *own += power * product);
    }

    /// `Σ q`: the weight of the pairs in a mean over several groups.
    pub(super) fn weight(&self) -> f64 {
        self.weights[0]
    }

    /// The value of the line at the distance zero and its variance; none if all distances are equal.
    pub(super) fn at_zero(&self) -> Option<(f64, f64)> {
        let ([s0, s1, s2], [y0, y1]) = (self.weights, self.products);
        let determinant = s0 * s2 - s1 * s1;
        (determinant > MIN_DETERMINANT * s0 * s2)
            .then(|| ((s2 * y0 - s1 * y1) / determinant, s2 / determinant))
    }
}

/// The pairs of readings of a leaf that are nearer to each other than [`MAX_LAG`] spacings. `spacing` is that
/// of the readings.
pub(super) fn pairs_by_distance(
    readings: &[(&Foot, f64)],
    surface: &Surface,
    spacing: f64,
    covariance: &LeafCovariance<'_>,
) -> LagSums {
    // Readings of small squares, since their pairs grow with the square of their number.
    let side = (readings.len() as f64 / READINGS_PER_SQUARE).sqrt().ceil().max(1.0) as usize;
    let mut squares = vec![Vec::new(); side * side];
    for &(foot, w) in readings {
        let [i, j] = foot.local.map(|x| ((x * side as f64) as usize).min(side - 1));
        let [s, t] = foot.local;
        squares[j * side + i].push((
            foot,
            w,
            surface.leaf_point(foot.leaf as usize, s, t),
            leaf_weights(s, t),
        ));
    }
    let mut sums = LagSums::default();
    for square in &squares {
        for (k, (a, wa, at_a, row_a)) in square.iter().enumerate() {
            for (b, wb, at_b, row_b) in &square[..k] {
                let distance = at_a.distance(*at_b) / spacing;
                if distance < MAX_LAG {
                    // The variance half way between the readings has the same limit as their covariance.
                    let row = std::array::from_fn(|k| 0.5 * (row_a[k] + row_b[k]));
                    let normal = (a.normal + b.normal).normalize_or_zero();
                    let variance = covariance.variance_along(&row, normal).max(0.0);
                    sums.add_pair(distance, a.height() * b.height() + variance, wa * wb);
                }
            }
        }
    }
    sums
}
