//! Arithmetic of points and directions stored as `[f64; 3]`.
//!
//! Plain arrays cross every crate boundary and are what files hold, so no conversion is needed anywhere.
//!
//! # Examples
//! The distance of a point from a plane through `origin` with a unit normal:
//! ```
//! use planish_core::vector3::{dot, sub};
//! let (origin, normal) = ([0.0, 0.0, 1.0], [0.0, 0.6, 0.8]);
//! assert_eq!(dot(normal, sub([5.0, 0.0, 3.5], origin)), 2.0);
//! ```

/// `a + b`.
#[inline]
#[must_use]
pub fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a − b`.
#[inline]
#[must_use]
pub fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `s a`.
#[inline]
#[must_use]
pub fn scale(s: f64, a: [f64; 3]) -> [f64; 3] {
    [s * a[0], s * a[1], s * a[2]]
}

/// `a + s b`.
#[inline]
#[must_use]
pub fn add_scaled(a: [f64; 3], s: f64, b: [f64; 3]) -> [f64; 3] {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

/// `a · b`.
#[inline]
#[must_use]
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a × b`.
///
/// # Examples
/// ```
/// use planish_core::vector3::cross;
/// assert_eq!(cross([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]), [0.0, 0.0, 1.0]);
/// ```
#[inline]
#[must_use]
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `|a|`.
#[inline]
#[must_use]
pub fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// `|a − b|`.
#[inline]
#[must_use]
pub fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    norm(sub(a, b))
}

/// `a / |a|`; `None` if `|a|²` is zero or not finite.
///
/// # Examples
/// ```
/// use planish_core::vector3::unit;
/// assert_eq!(unit([0.0, 4.0, 0.0]), Some([0.0, 1.0, 0.0]));
/// assert_eq!(unit([0.0; 3]), None);
/// ```
#[inline]
#[must_use]
pub fn unit(a: [f64; 3]) -> Option<[f64; 3]> {
    let length = norm(a);
    (length > 0.0 && length.is_finite()).then(|| scale(1.0 / length, a))
}

/// Two unit vectors that form a right-handed frame with the unit vector `n`: `e1 × e2 = n`.
///
/// # Examples
/// ```
/// use planish_core::vector3::{cross, distance, tangents};
/// let normal = [0.6, 0.0, 0.8];
/// let (e1, e2) = tangents(normal);
/// assert!(distance(cross(e1, e2), normal) < 1e-15);
/// ```
///
/// # References
/// Duff et al., *Building an Orthonormal Basis, Revisited*, JCGT 2017.
#[must_use]
pub fn tangents(n: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    // With the sign, the divisor is at least 1 in magnitude: no cancellation near n = (0, 0, −1).
    let sign = 1.0_f64.copysign(n[2]);
    let a = -1.0 / (sign + n[2]);
    let b = n[0] * n[1] * a;
    ([1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]], [b, sign + n[1] * n[1] * a, -n[1]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tangents_make_a_right_handed_frame() {
        for n in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, -0.8, 0.0], [-0.36, 0.48, -0.8]] {
            let (e1, e2) = tangents(n);
            assert!(distance(cross(e1, e2), n) < 1e-15);
            assert!(dot(e1, e2).abs() < 1e-15 && (norm(e1) - 1.0).abs() < 1e-15);
        }
    }
}
