//! Motions of parts: a rotation about a joint, and rigid motions of the part and of the rest.
//!
//! In: positions with the weight of the part at each. Out: moved positions.

use super::joint::Joint;
use nalgebra::{Matrix3, Rotation3, Vector3};
use planish_core::DVec3;

/// A rotation about a pivot. Positions of weight `w` turn by the share `w` of its angle.
#[derive(Debug, Clone, Copy)]
pub(super) struct PartRotation {
    pub pivot: DVec3,
    /// Rotation vector.
    pub turn: Vector3<f64>,
}

/// `x ↦ R x + t`.
#[derive(Debug, Clone, Copy)]
pub(super) struct RigidMotion {
    pub rotation: Matrix3<f64>,
    pub translation: Vector3<f64>,
}

/// A motion of the part with an index.
#[derive(Debug, Clone, Copy)]
pub(super) enum Motion {
    Turn(usize, PartRotation),
    /// Rigid motions of the rest and of the part. Positions of weight `w` move to the mean of both, weighted
    /// by `1 − w` and `w`.
    Shift(usize, [RigidMotion; 2]),
    /// A joint.
    Bend(Joint),
}

/// `3u² − 2u³`, 0 below 0 and 1 above 1.
pub(super) fn smooth_step(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * (3.0 - 2.0 * u)
}

impl PartRotation {
    /// The motion of positions of weight 1.
    pub(super) fn rigid(&self) -> RigidMotion {
        RigidMotion::IDENTITY.followed_by(self.turn, Vector3::zeros(), self.pivot)
    }

    /// A position and a normal after the rotation.
    pub(super) fn applied(&self, at: DVec3, normal: DVec3, weight: f64) -> (DVec3, DVec3) {
        let rotation = Rotation3::new(weight * self.turn);
        let turned = |v: DVec3| DVec3::from(rotation * Vector3::from(v));
        (self.pivot + turned(at - self.pivot), turned(normal))
    }
}

impl RigidMotion {
    pub(super) const IDENTITY: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        translation: Vector3::new(0.0, 0.0, 0.0),
    };

    pub(super) fn applied(&self, at: DVec3) -> DVec3 {
        DVec3::from(self.rotation * Vector3::from(at) + self.translation)
    }

    pub(super) fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// This motion after another one.
    pub(super) fn after(&self, first: &Self) -> Self {
        Self {
            rotation: self.rotation * first.rotation,
            translation: self.rotation * first.translation + self.translation,
        }
    }

    /// This motion followed by a rotation about a centre and a translation.
    pub(super) fn followed_by(&self, turn: Vector3<f64>, shift: Vector3<f64>, center: DVec3) -> Self {
        let (rotation, center) = (Rotation3::new(turn), Vector3::from(center));
        Self {
            rotation: rotation * self.rotation,
            translation: rotation * (self.translation - center) + center + shift,
        }
    }
}

/// A position and a normal after rigid motions of the rest and of the part.
pub(super) fn shifted(
    [rest, part]: &[RigidMotion; 2],
    at: DVec3,
    normal: DVec3,
    weight: f64,
) -> (DVec3, DVec3) {
    let position = (1.0 - weight) * rest.applied(at) + weight * part.applied(at);
    let turned = |m: &RigidMotion| DVec3::from(m.rotation * Vector3::from(normal));
    let direction = (1.0 - weight) * turned(rest) + weight * turned(part);
    (position, direction.try_normalize().unwrap_or(normal))
}
