//! Functions of points and directions that [`DVec3`] lacks.
//!
//! `DVec3` has operators and methods: `a + b`, `s * a`, `a.dot(b)`, `a.cross(b)`, `a.length()`,
//! `a.distance(b)`, `a.try_normalize()`.
//!
//! # Examples
//! The distance of a point from a plane through `origin` with a unit normal:
//! ```
//! use planish_core::DVec3;
//! let (origin, normal) = (DVec3::Z, DVec3::new(0.0, 0.6, 0.8));
//! assert_eq!(normal.dot(DVec3::new(5.0, 0.0, 3.5) - origin), 2.0);
//! ```

use glam::DVec3;

/// Two unit vectors that form a right-handed frame with the unit vector `n`: `e1 × e2 = n`.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, vector3::tangents};
/// let normal = DVec3::new(0.6, 0.0, 0.8);
/// let (e1, e2) = tangents(normal);
/// assert!(e1.cross(e2).distance(normal) < 1e-15);
/// ```
///
/// # References
/// Duff et al., *Building an Orthonormal Basis, Revisited*, JCGT 2017.
#[must_use]
pub fn tangents(n: DVec3) -> (DVec3, DVec3) {
    // With the sign, the divisor is at least 1 in magnitude: no cancellation near n = (0, 0, −1).
    let sign = 1.0_f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), DVec3::new(b, sign + n.y * n.y * a, -n.y))
}

/// Vectors as arrays, without a copy: what files and numeric code hold.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, vector3::as_arrays};
/// assert_eq!(as_arrays(&[DVec3::X, DVec3::Z]), [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
/// ```
#[must_use]
pub fn as_arrays(vectors: &[DVec3]) -> &[[f64; 3]] {
    bytemuck::cast_slice(vectors)
}

/// All coordinates of vectors, one vector after the other, without a copy.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, vector3::coordinates};
/// assert_eq!(coordinates(&[DVec3::X, DVec3::Z]), [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
/// ```
#[must_use]
pub fn coordinates(vectors: &[DVec3]) -> &[f64] {
    bytemuck::cast_slice(vectors)
}

/// Arrays as vectors, without a copy: the inverse of [`as_arrays`].
///
/// # Examples
/// ```
/// use planish_core::{DVec3, vector3::from_arrays};
/// assert_eq!(from_arrays(&[[1.0, 0.0, 0.0]]), [DVec3::X]);
/// ```
#[must_use]
pub fn from_arrays(arrays: &[[f64; 3]]) -> &[DVec3] {
    bytemuck::cast_slice(arrays)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Numbers of all signs and magnitudes, with exact zeros of both signs among them.
    fn random_vector(random: &mut ChaCha8Rng) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| match random.random_range(0..12) {
            0 => 0.0,
            1 => -0.0,
            _ => random.random_range(-1.0..1.0) * 2.0_f64.powi(random.random_range(-40..40)),
        }))
    }

    /// Fits are reproducible bit for bit, so a version of `glam` that fuses or reorders operations must not
    /// enter unnoticed.
    #[test]
    fn operations_round_as_written_out() {
        let bits = |v: DVec3| v.to_array().map(f64::to_bits);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..10_000 {
            let (u, v) = (random_vector(&mut random), random_vector(&mut random));
            let (a, b, s) = (u.to_array(), v.to_array(), random.random_range(-3.0..3.0_f64));
            let by_component = |f: &dyn Fn(usize) -> f64| std::array::from_fn(|k| f(k).to_bits());
            assert_eq!(bits(u + v), by_component(&|k| a[k] + b[k]));
            assert_eq!(bits(u - v), by_component(&|k| a[k] - b[k]));
            assert_eq!(bits(s * u), by_component(&|k| s * a[k]));
            assert_eq!(bits(u / s), by_component(&|k| a[k] / s));
            assert_eq!(bits(u + s * v), by_component(&|k| a[k] + s * b[k]));
            assert_eq!(bits(-u), by_component(&|k| -a[k]));
            assert_eq!(bits(0.5 * (u + v)), by_component(&|k| 0.5 * (a[k] + b[k])));
            let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
            assert_eq!(bits(u.cross(v)), cross.map(f64::to_bits));
            let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
            assert_eq!(u.dot(v).to_bits(), dot(a, b).to_bits());
            assert_eq!(u.length_squared().to_bits(), dot(a, a).to_bits());
            assert_eq!(u.length().to_bits(), dot(a, a).sqrt().to_bits());
            let d = std::array::from_fn(|k| a[k] - b[k]);
            assert_eq!(u.distance(v).to_bits(), dot(d, d).sqrt().to_bits());
            let length = dot(a, a).sqrt();
            let expected = (length > 0.0).then(|| a.map(|c| (1.0 / length * c).to_bits()));
            assert_eq!(u.try_normalize().map(bits), expected);
        }
    }

    #[test]
    fn tangents_make_a_right_handed_frame() {
        for n in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, -0.8, 0.0], [-0.36, 0.48, -0.8]] {
            let n = DVec3::from_array(n);
            let (e1, e2) = tangents(n);
            assert!(e1.cross(e2).distance(n) < 1e-15);
            assert!(e1.dot(e2).abs() < 1e-15 && (e1.length() - 1.0).abs() < 1e-15);
        }
    }
}
