//! Rigid motions between two frames, such as a scanner's and the world's.
//!
//! In: a quaternion, a rotation vector or a twist, and a translation. Out: a [`Pose`] that moves points,
//! rotates directions, is composed and inverted, and gives its rotation back in the same forms.
//!
//! Not guaranteed: a pose that is built from a matrix by hand is not checked. The rotation must be
//! orthonormal with determinant +1.

use crate::matrix3::{IDENTITY, from_columns, times};
use glam::DVec3;

/// A rigid motion `p_world = R p_scanner + t`.
///
/// Variables are named after both frames, as in `world_from_scanner`.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, Pose};
/// let pose = Pose::from_rotation_vector(std::f64::consts::FRAC_PI_2 * DVec3::Z, DVec3::new(0.0, 0.0, 5.0));
/// let p = pose.apply(DVec3::X);
/// assert!((p[1] - 1.0).abs() < 1e-12 && p[2] == 5.0);
/// assert!(pose.inverse().apply(p).abs_diff_eq(DVec3::X, 1e-12));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Rotation matrix `R`, row by row: orthonormal, determinant +1.
    pub rotation: [[f64; 3]; 3],
    /// Translation `t`, in the model's unit.
    pub translation: DVec3,
}

impl Default for Pose {
    fn default() -> Self {
        Self::identity()
    }
}

impl Pose {
    /// The identity.
    #[must_use]
    pub fn identity() -> Self {
        Self { rotation: IDENTITY, translation: DVec3::ZERO }
    }

    /// The motion of a quaternion `(x, y, z, w)`, which is normalised, and a translation; `None` for a
    /// quaternion that is zero or not finite.
    ///
    /// # Examples
    /// ```
    /// use planish_core::{DVec3, Pose};
    /// let half_turn = Pose::from_quaternion_xyzw([0.0, 0.0, 2.0, 0.0], DVec3::ZERO).expect("not zero");
    /// assert_eq!(half_turn.apply(DVec3::X), DVec3::NEG_X);
    /// assert_eq!(Pose::from_quaternion_xyzw([0.0; 4], DVec3::ZERO), None);
    /// ```
    #[must_use]
    pub fn from_quaternion_xyzw(quaternion: [f64; 4], translation: DVec3) -> Option<Self> {
        let length = quaternion.iter().map(|c| c * c).sum::<f64>().sqrt();
        if !length.is_finite() || length == 0.0 {
            return None;
        }
        let [x, y, z, w] = quaternion.map(|c| c / length);
        let rotation = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ];
        Some(Self { rotation, translation })
    }

    /// A rotation by `|ω|` radians about the axis `ω` through the origin, `R = exp([ω]×)`, then a
    /// translation.
    #[must_use]
    pub fn from_rotation_vector(omega: DVec3, translation: DVec3) -> Self {
        let half = 0.5 * omega.length();
        // sin(x)/x by its series where x is small: the next term, x⁴/120, is below rounding.
        let sinc = if half < 1e-4 { 1.0 - half * half / 6.0 } else { half.sin() / half };
        let DVec3 { x, y, z } = 0.5 * sinc * omega;
        // The quaternion is normalised there, so the matrix is orthonormal to rounding.
        Self::from_quaternion_xyzw([x, y, z, half.cos()], translation)
            .unwrap_or(Self { translation, ..Self::identity() })
    }

    /// `ω` of the rotation: its axis times its angle in radians, at most π.
    #[must_use]
    pub fn rotation_vector(&self) -> DVec3 {
        let [x, y, z, w] = self.quaternion_xyzw();
        let axis = DVec3::new(x, y, z);
        let sine = axis.length();
        // `atan2` instead of `acos(w)`, which loses half the digits for small angles.
        let factor = if sine < 1e-8 { 2.0 } else { 2.0 * sine.atan2(w) / sine };
        factor * axis
    }

    /// The unit quaternion `(x, y, z, w)` of the rotation, with `w ≥ 0`.
    #[must_use]
    pub fn quaternion_xyzw(&self) -> [f64; 4] {
        let r = &self.rotation;
        // Dividing by the largest component avoids cancellation in the others.
        let squares = [
            1.0 + r[0][0] - r[1][1] - r[2][2],
            1.0 - r[0][0] + r[1][1] - r[2][2],
            1.0 - r[0][0] - r[1][1] + r[2][2],
            1.0 + r[0][0] + r[1][1] + r[2][2],
        ];
        let largest = (0..4).max_by(|&a, &b| squares[a].total_cmp(&squares[b])).unwrap_or(3);
        let s = 2.0 * squares[largest].sqrt();
        let q = match largest {
            0 => [s / 4.0, (r[0][1] + r[1][0]) / s, (r[0][2] + r[2][0]) / s, (r[2][1] - r[1][2]) / s],
            1 => [(r[0][1] + r[1][0]) / s, s / 4.0, (r[1][2] + r[2][1]) / s, (r[0][2] - r[2][0]) / s],
            2 => [(r[0][2] + r[2][0]) / s, (r[1][2] + r[2][1]) / s, s / 4.0, (r[1][0] - r[0][1]) / s],
            _ => [(r[2][1] - r[1][2]) / s, (r[0][2] - r[2][0]) / s, (r[1][0] - r[0][1]) / s, s / 4.0],
        };
        // `q` and `−q` are the same rotation; `w ≥ 0` selects the angle of at most π.
        if q[3] < 0.0 { q.map(|c| -c) } else { q }
    }

    /// Rotates a direction: `R d`.
    #[must_use]
    pub fn rotate(&self, d: DVec3) -> DVec3 {
        times(&self.rotation, d)
    }

    /// Moves a point: `R p + t`.
    #[must_use]
    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.rotate(p) + self.translation
    }

    /// The composition that applies `inner` first, then this motion.
    ///
    /// # Examples
    /// ```
    /// use planish_core::{DVec3, Pose};
    /// let world_from_table = Pose { translation: DVec3::new(0.0, 0.0, 1.0), ..Pose::identity() };
    /// let table_from_scanner = Pose { translation: DVec3::new(2.0, 0.0, 0.0), ..Pose::identity() };
    /// let world_from_scanner = world_from_table.after(&table_from_scanner);
    /// assert_eq!(world_from_scanner.translation, DVec3::new(2.0, 0.0, 1.0));
    /// ```
    #[must_use]
    pub fn after(&self, inner: &Self) -> Self {
        let columns = [0, 1, 2].map(|k| self.rotate(DVec3::from_array(inner.rotation.map(|row| row[k]))));
        Self { rotation: from_columns(columns), translation: self.apply(inner.translation) }
    }

    /// The exponential of a twist: the motion after unit time with the constant angular velocity
    /// `rotation_rad` and the velocity `translation` of the origin in the rotating frame.
    ///
    /// # Examples
    /// ```
    /// use planish_core::{DVec3, Pose};
    /// let step = Pose::from_twist(0.3 * DVec3::Z, DVec3::X);
    /// let (rotation_rad, translation) = step.twist();
    /// assert!((rotation_rad[2] - 0.3).abs() < 1e-15 && (translation[0] - 1.0).abs() < 1e-15);
    /// ```
    ///
    /// # References
    /// Murray, Li & Sastry, *A mathematical introduction to robotic manipulation*, 1994, eq. 2.36.
    #[must_use]
    pub fn from_twist(rotation_rad: DVec3, translation: DVec3) -> Self {
        let angle = rotation_rad.length();
        // (1 − cos θ)/θ² and (θ − sin θ)/θ³, by their series where small θ would cancel.
        let (first, second) = if angle < 1e-4 {
            (0.5, 1.0 / 6.0)
        } else {
            let square = angle * angle;
            ((1.0 - angle.cos()) / square, (angle - angle.sin()) / (square * angle))
        };
        let once = rotation_rad.cross(translation);
        let twice = rotation_rad.cross(once);
        let moved = translation + first * once + second * twice;
        Self::from_rotation_vector(rotation_rad, moved)
    }

    /// The logarithm: the inverse of [`Pose::from_twist`], for rotations by less than π.
    #[must_use]
    pub fn twist(&self) -> (DVec3, DVec3) {
        let turn = self.rotation_vector();
        let angle = turn.length();
        let factor = if angle < 1e-4 {
            // The limit for small angles, where the formula below divides two differences that cancel.
            1.0 / 12.0
        } else {
            (1.0 - 0.5 * angle / (0.5 * angle).tan()) / (angle * angle)
        };
        let once = turn.cross(self.translation);
        let twice = turn.cross(once);
        (turn, self.translation - 0.5 * once + factor * twice)
    }

    /// The inverse motion.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let r = &self.rotation;
        let rotation = [0, 1, 2].map(|i| [r[0][i], r[1][i], r[2][i]]);
        let back = Self { rotation, translation: DVec3::ZERO }.rotate(self.translation);
        Self { rotation, translation: -back }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn composition_applies_both_motions() {
        let first = Pose::from_quaternion_xyzw([0.1, -0.7, 0.2, 0.6], DVec3::new(1.0, 2.0, 3.0)).unwrap();
        let then = Pose::from_quaternion_xyzw([0.3, 0.1, -0.2, 0.5], DVec3::new(-4.0, 0.5, 2.0)).unwrap();
        let p = DVec3::new(0.3, -0.4, 0.5);
        let (both, stepwise) = (then.after(&first).apply(p), then.apply(first.apply(p)));
        assert!(both.abs_diff_eq(stepwise, 1e-14));
        assert_eq!(Pose::identity().after(&first), first);
    }

    #[test]
    fn twists_round_trip_and_compose() {
        for (w, v) in [
            (DVec3::new(0.3, -0.8, 1.1), DVec3::new(4.0, 0.5, -2.0)),
            (DVec3::new(1e-6, 2e-6, 0.0), DVec3::new(1.0, -1.0, 3.0)),
            (DVec3::ZERO, DVec3::new(0.5, 0.0, 0.1)),
        ] {
            let pose = Pose::from_twist(w, v);
            let (turn, shift) = pose.twist();
            let same = |a: DVec3, b: DVec3| a.abs_diff_eq(b, 1e-9);
            assert!(same(turn, w) && same(shift, v), "{turn:?} {shift:?}");
            let half = Pose::from_twist(0.5 * w, 0.5 * v);
            let p = DVec3::new(1.0, 2.0, -0.5);
            assert!(same(half.after(&half).apply(p), pose.apply(p)));
        }
    }

    #[test]
    fn rotation_vector_round_trips() {
        for omega in [
            DVec3::new(0.3, -1.2, 0.7),
            DVec3::new(1e-9, 2e-9, -1e-9),
            DVec3::ZERO,
            DVec3::new(0.0, 3.1, 0.0),
            DVec3::new(1e-5, 0.0, 0.0),
        ] {
            let pose = Pose::from_rotation_vector(omega, DVec3::new(1.0, 2.0, 3.0));
            let again = pose.rotation_vector();
            assert!(
                omega
                    .to_array()
                    .iter()
                    .zip(again.to_array())
                    .all(|(a, b)| (a - b).abs() < 1e-14 * (1.0 + 1e6 * a.abs().min(1e-6))),
                "{omega:?} {again:?}"
            );
        }
        // A quarter turn about z carries x to y.
        let quarter = Pose::from_rotation_vector(std::f64::consts::FRAC_PI_2 * DVec3::Z, DVec3::ZERO);
        assert!((quarter.rotate(DVec3::X)[1] - 1.0).abs() < 1e-15);
    }

    #[test]
    fn quaternion_round_trips() {
        for q in [
            [0.1, -0.7, 0.2, 0.6],
            [0.9, 0.1, 0.1, -0.2],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 1.0, 0.0, 1e-9],
            [0.0, 0.0, 0.0, 1.0],
        ] {
            let pose = Pose::from_quaternion_xyzw(q, DVec3::new(1.0, 2.0, 3.0)).unwrap();
            let again =
                Pose::from_quaternion_xyzw(pose.quaternion_xyzw(), DVec3::new(1.0, 2.0, 3.0)).unwrap();
            let p = DVec3::new(0.3, -0.4, 0.5);
            let (a, b) = (pose.apply(p), again.inverse().apply(pose.apply(p)));
            assert!(again.apply(p).abs_diff_eq(a, 1e-14));
            assert!(b.abs_diff_eq(p, 1e-14));
        }
        assert!(Pose::from_quaternion_xyzw([0.0; 4], DVec3::ZERO).is_none());
    }
}
