//! Products and inverse of plain 3 × 3 matrices `[[f64; 3]; 3]`, row by row.
//!
//! Rotations and the intrinsics of cameras are stored this way. For symmetric matrices, see
//! [`SymmetricMatrix3`](crate::SymmetricMatrix3).

use glam::DVec3;

/// The identity.
pub const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// The matrix with these rows, such as the rotation into a frame with three unit vectors as axes.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, matrix3::from_rows};
/// let rows = [DVec3::Y, DVec3::NEG_X, DVec3::Z];
/// assert_eq!(from_rows(rows), [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
/// ```
#[inline]
#[must_use]
pub fn from_rows(rows: [DVec3; 3]) -> [[f64; 3]; 3] {
    rows.map(|row| row.to_array())
}

/// The matrix with these columns, such as the rotation from a frame with these unit vectors as axes.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, matrix3::from_columns};
/// let columns = [DVec3::Y, DVec3::NEG_X, DVec3::Z];
/// assert_eq!(from_columns(columns), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
/// ```
#[inline]
#[must_use]
pub fn from_columns([x, y, z]: [DVec3; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|k| [x[k], y[k], z[k]])
}

/// The rows of a matrix as vectors: the inverse of [`from_rows`].
#[inline]
#[must_use]
pub fn rows(m: &[[f64; 3]; 3]) -> [DVec3; 3] {
    m.map(DVec3::from_array)
}

/// `M v`.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, matrix3::times};
/// let quarter_turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
/// assert_eq!(times(&quarter_turn, DVec3::new(2.0, 0.0, 5.0)), DVec3::new(0.0, 2.0, 5.0));
/// ```
#[inline]
#[must_use]
pub fn times(m: &[[f64; 3]; 3], v: DVec3) -> DVec3 {
    DVec3::from_array(rows(m).map(|row| row.dot(v)))
}

/// `Mᵀ v`: for a rotation, the inverse rotation of `v`.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, matrix3::{times, transposed_times}};
/// let quarter_turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
/// let v = DVec3::new(2.0, 3.0, 5.0);
/// assert_eq!(transposed_times(&quarter_turn, times(&quarter_turn, v)), v);
/// ```
#[inline]
#[must_use]
pub fn transposed_times(m: &[[f64; 3]; 3], v: DVec3) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|j| (0..3).map(|i| m[i][j] * v[i]).sum()))
}

/// The inverse; `None` for a (nearly) singular matrix.
///
/// The determinant is compared with the product of the lengths of the rows, so the test does not depend on
/// units: rows of K mix pixels and ones.
///
/// # Examples
/// ```
/// use planish_core::matrix3::inverse;
/// let m = [[2.0, 0.0, 4.0], [0.0, 4.0, 0.0], [0.0, 0.0, 1.0]];
/// assert_eq!(inverse(&m), Some([[0.5, 0.0, -2.0], [0.0, 0.25, 0.0], [0.0, 0.0, 1.0]]));
/// assert_eq!(inverse(&[[1.0, 2.0, 3.0]; 3]), None);
/// ```
#[must_use]
pub fn inverse(m: &[[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    let [a, b, c] = rows(m);
    // Cross products of rows are the columns of the adjugate; this needs no pivots.
    let columns = [b.cross(c), c.cross(a), a.cross(b)];
    let determinant = a.dot(columns[0]);
    let size = a.length() * b.length() * c.length();
    // Far above rounding, which is about 1e-16 of this product.
    (determinant.abs() > 1e-12 * size && size > 0.0)
        .then(|| [0, 1, 2].map(|i| [0, 1, 2].map(|j| columns[j][i] / determinant)))
}
