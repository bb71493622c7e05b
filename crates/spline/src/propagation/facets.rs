//! A cloud as independent facets: each is a quadric over a plane, fitted to readings that no other facet
//! uses.
//!
//! Facets represent the measured surface. No reading belongs to two facets, so their errors are independent
//! and error propagation gives the covariance of estimates from them.
//!
//! Not guaranteed: accuracy where the surface deviates from a quadric within a facet.

use nalgebra::{SMatrix, SVector};
use planish_core::{BoundingBox, DVec3, vector3::tangents};
use planish_estimate::{Error, Result};
use std::collections::BTreeMap;

/// Coefficients of a quadric: `c0 + c1 x + c2 y + c3 x² + c4 xy + c5 y²`.
pub(super) const COEFFICIENTS: usize = 6;
/// Minimum number of readings of a facet: three times the number of coefficients of a quadric. With fewer,
/// the scatter about the quadric hardly determines the noise.
const MIN_READINGS: usize = 18;
/// Maximum number of facets, and minimum fraction of readings in facets. More and smaller facets follow the
/// shape better, but each has fewer readings and the search for pairs is slower.
const MAX_FACETS: usize = 1200;
const MIN_SHARE: f64 = 0.75;
/// Side of the cubes that divide the cloud, relative to its size: first value, growth, last value.
const MIN_SIDE: f64 = 1.0 / 40.0;
const GROWTH: f64 = 1.25;
const COARSEST: f64 = 1.0 / 5.0;
/// Minimum length of the mean normal of a facet. It excludes sharp edges, which are not quadrics.
const MIN_MEAN_NORMAL: f64 = 0.85;
/// Minimum number of facets for a symmetry. Fewer can agree with many axes or planes by chance.
const MIN_FACETS: usize = 12;
/// The median of χ² is smaller than its degrees of freedom by this (for many of them).
const MEDIAN_BELOW_MEAN: f64 = 2.0 / 3.0;

/// A facet of a measured surface.
#[derive(Debug, Clone)]
pub struct Facet {
    /// The point of the quadric over the mean of its readings.
    pub point: DVec3,
    /// The outward unit normal at this point.
    pub normal: DVec3,
    /// Number of its readings.
    pub readings: usize,
    origin: DVec3,
    axes: [DVec3; 3],
    coefficients: [f64; COEFFICIENTS],
    covariance: SMatrix<f64, COEFFICIENTS, COEFFICIENTS>,
}

/// Height of a point over a facet, with derivatives.
pub(super) struct Height {
    /// Distance along the normal of the facet.
    pub value: f64,
    /// Derivative with respect to the point: the normal of the quadric there.
    pub normal: DVec3,
    /// Derivative with respect to the coefficients.
    pub by_coefficients: SVector<f64, COEFFICIENTS>,
    /// Distance within the tangent plane.
    pub slip: f64,
}

/// A cloud divided into facets.
#[derive(Debug, Clone)]
pub struct Facets {
    /// The facets.
    pub all: Vec<Facet>,
    /// For each point of the cloud, its facet.
    pub of_point: Vec<Option<u32>>,
    /// Side of the cubes that divide the cloud.
    pub side: f64,
    /// Diagonal of the box around the cloud.
    pub size: f64,
    /// Median over the facets of residual variance divided by stated variance.
    pub variance_factor: f64,
}

impl Facets {
    /// Divides a cloud into cubes, separates points with different directions of normals, and fits a quadric
    /// to each group.
    ///
    /// `variance` is that of each point along its normal. If `trusted` is false, only its ratios are used. In
    /// both cases the scatter about the quadrics replaces it if it is larger.
    ///
    /// # Errors
    /// `Undetermined` for a cloud that is too small or too rough for a dozen facets.
    pub fn new(points: &[DVec3], normals: &[DVec3], variance: &[f64], trusted: bool) -> Result<Self> {
        let bounds: BoundingBox = points.iter().copied().collect();
        let (lo, size) = (bounds.min, bounds.diagonal());
        let mut side = MIN_SIDE * size;
        let mut cut = group_points(points, normals, lo, side);
        // Sparse clouds need larger cubes; the smallest cubes with enough readings follow the shape best.
        while side < COARSEST * size && !fits(&cut, points.len()) {
            side *= GROWTH;
            cut = group_points(points, normals, lo, side);
        }
        let mut made =
            Self { all: Vec::new(), of_point: vec![None; points.len()], side, size, variance_factor: 1.0 };
        let mut factors = Vec::new();
        for members in cut.values().filter(|m| m.len() >= MIN_READINGS) {
            if let Some((facet, factor)) = Facet::fitted(points, normals, variance, members) {
                for &i in members {
                    made.of_point[i as usize] = Some(made.all.len() as u32);
                }
                made.all.push(facet);
                factors.push(factor);
            }
        }
        if made.all.len() < MIN_FACETS {
            return Err(Error::undetermined(format!(
                "the readings form {} smooth facets, but a symmetry needs at least {MIN_FACETS}: the \
                 readings are too few or too rough",
                made.all.len()
            )));
        }
        let middle = factors.len() / 2;
        // The median, because facets over an edge or unresolved shape have arbitrarily large residuals.
        let factor = *factors.select_nth_unstable_by(middle, f64::total_cmp).1;
        made.variance_factor = if trusted { factor.max(1.0) } else { factor };
        for facet in &mut made.all {
            facet.covariance *= made.variance_factor;
        }
        Ok(made)
    }
}

/// The points of each cube and direction of normals.
fn group_points(points: &[DVec3], normals: &[DVec3], lo: DVec3, side: f64) -> BTreeMap<[i64; 4], Vec<u32>> {
    // Ordered, so that facets are numbered alike in every run.
    let mut cut: BTreeMap<[i64; 4], Vec<u32>> = BTreeMap::new();
    for ((i, p), n) in (0..).zip(points).zip(normals) {
        let axis = (0..3).max_by(|&a, &b| n[a].abs().total_cmp(&n[b].abs())).unwrap_or(0);
        // Points without a normal.
        if n[axis] == 0.0 {
            continue;
        }
        // A cube can contain both sides of a thin wall; the main direction of the normal separates them.
        let facing = 2 * axis as i64 + i64::from(n[axis] < 0.0);
        let [x, y, z] = [0, 1, 2].map(|d| ((p[d] - lo[d]) / side).floor() as i64);
        cut.entry([x, y, z, facing]).or_default().push(i);
    }
    cut
}

/// True if the facets contain enough readings and are not too many.
fn fits(cut: &BTreeMap<[i64; 4], Vec<u32>>, total: usize) -> bool {
    let full = || cut.values().filter(|m| m.len() >= MIN_READINGS);
    full().map(Vec::len).sum::<usize>() as f64 >= MIN_SHARE * total as f64 && full().count() <= MAX_FACETS
}

impl Facet {
    /// Fits a quadric by weighted least squares. Also returns the median of squared residuals divided by
    /// their variance. `None` for readings on a line or an edge.
    fn fitted(points: &[DVec3], normals: &[DVec3], variance: &[f64], members: &[u32]) -> Option<(Self, f64)> {
        let count = members.len() as f64;
        let mean = |vectors: &[DVec3]| {
            let sum = members.iter().fold(DVec3::ZERO, |s, &i| s + vectors[i as usize]);
            1.0 / count * sum
        };
        let (origin, turned) = (mean(points), mean(normals));
        let normal = turned
            .try_normalize()
            .filter(|_| turned.length_squared() >= MIN_MEAN_NORMAL * MIN_MEAN_NORMAL)?;
        let (e1, e2) = tangents(normal);
        let axes = [e1, e2, normal];
        let local = |p: DVec3| axes.map(|a| a.dot(p - origin));
        let spread = members
            .iter()
            .map(|&i| local(points[i as usize]))
            .fold(0.0_f64, |s, [x, y, _]| s.max(x.abs()).max(y.abs()));
        if spread <= 0.0 {
            return None;
        }
        let mut normal_matrix = SMatrix::<f64, COEFFICIENTS, COEFFICIENTS>::zeros();
        let mut right = SVector::<f64, COEFFICIENTS>::zeros();
        // Coordinates of the order of one keep the matrix well conditioned.
        for &i in members {
            let [x, y, z] = local(points[i as usize]);
            let row = monomials(x / spread, y / spread);
            let w = 1.0 / variance[i as usize];
            normal_matrix += row * row.transpose() * w;
            right += row * (w * z);
        }
        let inverse = normal_matrix.cholesky()?.inverse();
        // The inverse is needed anyway, as covariance.
        let scaled = inverse * right;
        let chi2: f64 = members
            .iter()
            .map(|&i| {
                let [x, y, z] = local(points[i as usize]);
                (z - monomials(x / spread, y / spread).dot(&scaled)).powi(2) / variance[i as usize]
            })
            .sum();
        let degrees = count - COEFFICIENTS as f64;
        let units = monomials(1.0 / spread, 1.0 / spread);
        let coefficients = scaled.component_mul(&units);
        let covariance = SMatrix::from_fn(|i, j| inverse[(i, j)] * units[i] * units[j]);
        // The height at the mean is twice as uncertain as a single reading: the readings lie on a line or a
        // ring, and the quadric extrapolates.
        if covariance[(0, 0)] > 4.0 * variance[members[0] as usize] {
            return None;
        }
        let made = Self {
            point: origin + coefficients[0] * normal,
            normal: (normal - coefficients[1] * e1 - coefficients[2] * e2).try_normalize()?,
            readings: members.len(),
            origin,
            axes,
            coefficients: coefficients.into(),
            covariance,
        };
        Some((made, chi2 / (degrees - MEDIAN_BELOW_MEAN)))
    }

    /// Height of a point over the quadric.
    pub(super) fn height(&self, p: DVec3) -> Height {
        let [x, y, z] = self.axes.map(|a| a.dot(p - self.origin));
        let c = &self.coefficients;
        let row = monomials(x, y);
        let slope_x = c[1] + 2.0 * c[3] * x + c[4] * y;
        let slope_y = c[2] + c[4] * x + 2.0 * c[5] * y;
        // The height over the tangent plane of the quadric instead of the vertical one: a distance to first
        // order.
        let over = 1.0 / (1.0 + slope_x * slope_x + slope_y * slope_y).sqrt();
        let surface: f64 = row.iter().zip(c).map(|(r, c)| r * c).sum();
        let [e1, e2, n] = self.axes;
        Height {
            value: over * (z - surface),
            normal: over * (n - slope_x * e1 - slope_y * e2),
            by_coefficients: row * -over,
            slip: x.hypot(y),
        }
    }

    /// Covariance of the coefficients.
    pub(super) fn covariance(&self) -> &SMatrix<f64, COEFFICIENTS, COEFFICIENTS> {
        &self.covariance
    }

    /// Variance of a height with the given derivatives.
    pub(super) fn variance(&self, by_coefficients: &SVector<f64, COEFFICIENTS>) -> f64 {
        (by_coefficients.transpose() * self.covariance * by_coefficients)[(0, 0)]
    }

    /// Derivatives of the height of the facet's own point with respect to the coefficients.
    pub(super) fn own() -> SVector<f64, COEFFICIENTS> {
        monomials(0.0, 0.0)
    }
}

fn monomials(x: f64, y: f64) -> SVector<f64, COEFFICIENTS> {
    SVector::from([1.0, x, y, x * x, x * y, y * y])
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    #[test]
    fn facets_of_a_noisy_sphere_lie_on_it_within_their_sigma() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let sigma = 0.02;
        let (mut points, mut normals) = (Vec::new(), Vec::new());
        while points.len() < 20_000 {
            let d = DVec3::from_array([0; 3].map(|_| rng.sample::<f64, _>(StandardNormal)));
            let Some(n) = d.try_normalize() else { continue };
            points.push((3.0 + sigma * rng.sample::<f64, _>(StandardNormal)) * n);
            normals.push(n);
        }
        // The stated variance is four times too small, which the scatter reveals.
        let facets = Facets::new(&points, &normals, &vec![0.25 * sigma * sigma; points.len()], true).unwrap();
        assert!((facets.variance_factor - 4.0).abs() < 0.4, "{}", facets.variance_factor);
        let squares: f64 =
            facets.all.iter().map(|f| (f.point.length() - 3.0).powi(2) / f.variance(&Facet::own())).sum();
        let mean = squares / facets.all.len() as f64;
        // The mean of squares, within four standard errors plus the fourth-order error of a quadric.
        assert!(
            facets.all.len() > 100 && (mean - 1.0).abs() < 4.0 * (2.0 / facets.all.len() as f64).sqrt() + 0.1,
            "{mean}"
        );
    }
}
