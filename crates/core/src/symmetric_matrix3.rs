//! Symmetric 3 × 3 matrices: covariances of points and normals, and curvature tensors.
//!
//! In: six entries. Out: products, rotated matrices, and the variance along a direction.
//!
//! Not guaranteed: that a covariance is positive semidefinite. Readers of files check this.

use crate::matrix3::{self, IDENTITY};
use glam::DVec3;

/// A symmetric 3 × 3 matrix, such as the covariance of a point.
///
/// Arrays and files hold the entries of the upper triangle row by row: `[xx, xy, xz, yy, yz, zz]`.
///
/// # Examples
/// A scanner with σ = 0.3 along its ray and 0.1 across it:
/// ```
/// use planish_core::{DVec3, Pose, SymmetricMatrix3};
/// let mut covariance = SymmetricMatrix3::isotropic(0.1 * 0.1);
/// covariance.add_outer(0.3 * 0.3 - 0.1 * 0.1, DVec3::Z);
/// assert!((covariance.along(DVec3::Z).sqrt() - 0.3).abs() < 1e-15);
///
/// // A quarter turn about x moves the uncertain direction from z to −y.
/// let world_from_scanner = Pose::from_rotation_vector(std::f64::consts::FRAC_PI_2 * DVec3::X, DVec3::ZERO);
/// let in_world = covariance.rotated(&world_from_scanner.rotation);
/// assert!((in_world.yy.sqrt() - 0.3).abs() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SymmetricMatrix3 {
    /// Row 1, column 1.
    pub xx: f64,
    /// Row 1, column 2.
    pub xy: f64,
    /// Row 1, column 3.
    pub xz: f64,
    /// Row 2, column 2.
    pub yy: f64,
    /// Row 2, column 3.
    pub yz: f64,
    /// Row 3, column 3.
    pub zz: f64,
}

impl SymmetricMatrix3 {
    /// The zero matrix.
    pub const ZERO: Self = Self::isotropic(0.0);

    /// The covariance of a point with the same variance in every direction: `variance · I`.
    #[must_use]
    pub const fn isotropic(variance: f64) -> Self {
        Self { xx: variance, xy: 0.0, xz: 0.0, yy: variance, yz: 0.0, zz: variance }
    }

    /// The matrix of an entry for each row and column, each 0, 1 or 2. Only the upper triangle is evaluated.
    ///
    /// # Examples
    /// ```
    /// use planish_core::SymmetricMatrix3;
    /// let matrix = SymmetricMatrix3::from_entries(|i, j| (10 * i + j) as f64);
    /// assert_eq!(matrix.to_array(), [0.0, 1.0, 2.0, 11.0, 12.0, 22.0]);
    /// ```
    #[inline]
    #[must_use]
    pub fn from_entries(entry: impl Fn(usize, usize) -> f64) -> Self {
        Self::from_array([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|(i, j)| entry(i, j)))
    }

    /// The matrix of `[xx, xy, xz, yy, yz, zz]`.
    #[inline]
    #[must_use]
    pub const fn from_array([xx, xy, xz, yy, yz, zz]: [f64; 6]) -> Self {
        Self { xx, xy, xz, yy, yz, zz }
    }

    /// The entries `[xx, xy, xz, yy, yz, zz]`.
    #[inline]
    #[must_use]
    pub const fn to_array(self) -> [f64; 6] {
        [self.xx, self.xy, self.xz, self.yy, self.yz, self.zz]
    }

    /// All nine entries, row by row.
    #[inline]
    #[must_use]
    pub const fn rows(&self) -> [[f64; 3]; 3] {
        let Self { xx, xy, xz, yy, yz, zz } = *self;
        [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    }

    /// `C v`.
    #[inline]
    #[must_use]
    pub fn times(&self, v: DVec3) -> DVec3 {
        matrix3::times(&self.rows(), v)
    }

    /// The variance `nᵀ C n` along the unit vector `n`.
    ///
    /// # Examples
    /// ```
    /// use planish_core::{DVec3, SymmetricMatrix3};
    /// let covariance = SymmetricMatrix3::from_array([4.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
    /// assert_eq!(covariance.along(DVec3::X), 4.0);
    /// ```
    #[inline]
    #[must_use]
    pub fn along(&self, n: DVec3) -> f64 {
        n.dot(self.times(n))
    }

    /// The matrix in a rotated frame: `R C Rᵀ` for a rotation matrix `R`, row by row.
    #[must_use]
    pub fn rotated(&self, rotation: &[[f64; 3]; 3]) -> Self {
        // By rows of R: entry (i, j) is r_iᵀ C r_j, so the result is symmetric without averaging.
        let rows = matrix3::rows(rotation);
        let products = rows.map(|row| self.times(row));
        Self::from_entries(|i, j| rows[i].dot(products[j]))
    }

    /// `factor · C`.
    #[inline]
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self::from_array(self.to_array().map(|entry| factor * entry))
    }

    /// Adds `weight · v vᵀ`.
    ///
    /// # Examples
    /// ```
    /// use planish_core::{DVec3, SymmetricMatrix3};
    /// let mut sum = SymmetricMatrix3::ZERO;
    /// sum.add_outer(2.0, DVec3::new(1.0, 0.0, 3.0));
    /// assert_eq!(sum.to_array(), [2.0, 0.0, 6.0, 0.0, 0.0, 18.0]);
    /// ```
    #[inline]
    pub fn add_outer(&mut self, weight: f64, v: DVec3) {
        self.xx += weight * (v.x * v.x);
        self.xy += weight * (v.x * v.y);
        self.xz += weight * (v.x * v.z);
        self.yy += weight * (v.y * v.y);
        self.yz += weight * (v.y * v.z);
        self.zz += weight * (v.z * v.z);
    }

    /// `xx + yy + zz`.
    #[inline]
    #[must_use]
    pub fn trace(&self) -> f64 {
        self.xx + self.yy + self.zz
    }

    /// Unit eigenvectors, the one of the largest eigenvalue first, and the eigenvalues, by Jacobi rotations.
    ///
    /// The largest component of each vector is positive, so that equal input gives equal frames. The frame
    /// may be left-handed.
    ///
    /// # Examples
    /// The semi-axes of an error ellipsoid:
    /// ```
    /// use planish_core::{DVec3, SymmetricMatrix3};
    /// let (vectors, values) = SymmetricMatrix3::from_array([1.0, 0.0, 0.0, 9.0, 0.0, 4.0]).eigen();
    /// assert_eq!(values.map(f64::sqrt), [3.0, 2.0, 1.0]);
    /// assert_eq!(vectors[0], DVec3::Y);
    /// ```
    #[must_use]
    pub fn eigen(&self) -> ([DVec3; 3], [f64; 3]) {
        // The roots of the characteristic polynomial would be faster, but lose half of the digits where two
        // eigenvalues are close, as they are for isotropic noise.
        let mut a = self.rows();
        let mut v = IDENTITY;
        for _ in 0..60 {
            let off = a[0][1].abs() + a[0][2].abs() + a[1][2].abs();
            if off <= 1e-300 || off < 1e-17 * (a[0][0].abs() + a[1][1].abs() + a[2][2].abs()) {
                break;
            }
            for (p, q) in [(0, 1), (0, 2), (1, 2)] {
                if a[p][q] == 0.0 {
                    continue;
                }
                // The smaller of two roots: a rotation of at most 45°, with which the sweeps converge
                // (Golub and Van Loan, *Matrix Computations*, 2013, section 8.5).
                let theta = 0.5 * (a[q][q] - a[p][p]) / a[p][q];
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let t = if theta == 0.0 { 1.0 } else { t };
                let c = 1.0 / t.hypot(1.0);
                let s = t * c;
                for k in 0..3 {
                    let (x, y) = (a[k][p], a[k][q]);
                    a[k][p] = c * x - s * y;
                    a[k][q] = s * x + c * y;
                }
                for k in 0..3 {
                    let (x, y) = (a[p][k], a[q][k]);
                    a[p][k] = c * x - s * y;
                    a[q][k] = s * x + c * y;
                    let (x, y) = (v[p][k], v[q][k]);
                    v[p][k] = c * x - s * y;
                    v[q][k] = s * x + c * y;
                }
            }
        }
        let mut order = [0, 1, 2];
        order.sort_by(|&i, &j| a[j][j].total_cmp(&a[i][i]));
        let axes = order.map(|i| {
            let e = v[i];
            // Of components of nearly the same size the first decides, so that rounding does not flip axes.
            let largest =
                e.iter().copied().fold(0.0, |m: f64, c| if c.abs() > m.abs() + 1e-12 { c } else { m });
            (if largest < 0.0 { -1.0 } else { 1.0 }) * DVec3::from_array(e)
        });
        (axes, order.map(|i| a[i][i]))
    }

    /// True if all entries are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.to_array().iter().all(|entry| entry.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose;

    #[test]
    fn rotation_keeps_the_variance_along_rotated_directions() {
        let covariance = SymmetricMatrix3::from_array([2.0, 0.3, -0.4, 1.0, 0.2, 0.5]);
        let pose = Pose::from_rotation_vector(DVec3::new(0.4, -1.1, 0.3), DVec3::ZERO);
        let rotated = covariance.rotated(&pose.rotation);
        for n in [DVec3::X, DVec3::new(0.6, 0.0, 0.8), DVec3::new(-0.48, 0.6, 0.64)] {
            assert!((rotated.along(pose.rotate(n)) - covariance.along(n)).abs() < 1e-14);
        }
        assert!((rotated.trace() - covariance.trace()).abs() < 1e-14);
    }

    #[test]
    fn weighted_outer_products_sum_to_the_expected_entries() {
        let v = DVec3::new(0.5, -2.0, 3.0);
        let mut sum = SymmetricMatrix3::isotropic(1.0);
        sum.add_outer(0.25, v);
        let expected =
            SymmetricMatrix3::from_entries(|i, j| 0.25 * (v[i] * v[j]) + if i == j { 1.0 } else { 0.0 });
        assert_eq!(sum, expected);
    }
}
