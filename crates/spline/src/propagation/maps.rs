//! The maps of a symmetry, and their derivatives with respect to axis or plane.

use planish_core::{DVec3, vector3::tangents};
use std::f64::consts::TAU;

/// A symmetry with its axis or plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Symmetry {
    /// Rotation about an axis: by `2π/order`, or by any angle if there is no order.
    Rotation {
        /// The point of the axis nearest to the centre of the cloud.
        point: DVec3,
        /// Its unit direction.
        direction: DVec3,
        /// Number of repetitions of the shape in a full turn.
        order: Option<u32>,
    },
    /// Reflection in a plane.
    Mirror {
        /// The point of the plane nearest to the centre of the cloud.
        point: DVec3,
        /// Its unit normal.
        normal: DVec3,
    },
}

/// One map of a symmetry: a rotation by an angle, or the reflection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Map {
    Turn { sin: f64, cos: f64 },
    Reflect,
}

impl Map {
    pub(super) fn turn(angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self::Turn { sin, cos }
    }
}

/// Maximum number of parameters: an axis has two shifts and two tilts, a plane one shift and two tilts.
pub(super) const MAX_PARAMETERS: usize = 4;

impl Symmetry {
    /// Number of parameters.
    #[must_use]
    pub fn parameters(&self) -> usize {
        match self {
            Self::Rotation { .. } => 4,
            Self::Mirror { .. } => 3,
        }
    }

    /// A fixed point of the maps.
    #[must_use]
    pub fn point(&self) -> DVec3 {
        match *self {
            Self::Rotation { point, .. } | Self::Mirror { point, .. } => point,
        }
    }

    /// The direction of the axis, or the normal of the plane.
    #[must_use]
    pub fn direction(&self) -> DVec3 {
        match *self {
            Self::Rotation { direction, .. } => direction,
            Self::Mirror { normal, .. } => normal,
        }
    }

    /// The image of a direction.
    pub(super) fn carry(&self, map: Map, v: DVec3) -> DVec3 {
        match (*self, map) {
            (Self::Rotation { direction: d, .. }, Map::Turn { sin, cos }) => {
                // Rodrigues' rotation formula.
                cos * v + sin * d.cross(v) + (1.0 - cos) * d.dot(v) * d
            }
            (Self::Mirror { normal, .. }, _) => v - 2.0 * normal.dot(v) * normal,
            (Self::Rotation { .. }, Map::Reflect) => v,
        }
    }

    /// The image of a point.
    pub(super) fn apply(&self, map: Map, p: DVec3) -> DVec3 {
        self.point() + self.carry(map, p - self.point())
    }

    /// The image of a point and its normal: rotated by the angle about the axis, or reflected if there is no
    /// angle.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::Symmetry;
    ///
    /// let mirror = Symmetry::Mirror { point: DVec3::X, normal: DVec3::X };
    /// let (point, normal) = mirror.image(None, DVec3::new(3.0, 2.0, 0.0), DVec3::new(0.6, 0.8, 0.0));
    /// assert_eq!(point, DVec3::new(-1.0, 2.0, 0.0));
    /// assert!((normal[0] + 0.6).abs() < 1e-15);
    /// ```
    #[must_use]
    pub fn image(&self, angle: Option<f64>, point: DVec3, normal: DVec3) -> (DVec3, DVec3) {
        let map = angle.map_or(Map::Reflect, Map::turn);
        (self.apply(map, point), self.carry(map, normal))
    }

    /// The angle of a point about the axis; about the normal of a plane.
    #[must_use]
    pub fn angle(&self, point: DVec3) -> f64 {
        self.cylindrical(point)[2]
    }

    /// Derivatives of [`Symmetry::apply`] with respect to the parameters of [`Symmetry::moved`].
    pub(super) fn derivatives(&self, map: Map, p: DVec3) -> [DVec3; MAX_PARAMETERS] {
        let (e1, e2) = tangents(self.direction());
        let r = p - self.point();
        match *self {
            Self::Rotation { direction: d, .. } => {
                let shift = |e: DVec3| e - self.carry(map, e);
                // If the axis rotates by ω = d × e, the map changes by [ω]R − R[ω].
                let tilt = |e: DVec3| {
                    let w = d.cross(e);
                    w.cross(self.carry(map, r)) - self.carry(map, w.cross(r))
                };
                [shift(e1), shift(e2), tilt(e1), tilt(e2)]
            }
            Self::Mirror { normal: m, .. } => {
                let tilt = |e: DVec3| -2.0 * r.dot(e) * m - 2.0 * r.dot(m) * e;
                [2.0 * m, tilt(e1), tilt(e2), DVec3::ZERO]
            }
        }
    }

    /// Moves the symmetry: shifts along the tangents of its axis (or the normal of its plane), then tilts in
    /// radians.
    pub(super) fn moved(&self, by: &[f64]) -> Self {
        let d = self.direction();
        let (e1, e2) = tangents(d);
        let tilted = |a: f64, b: f64| {
            let t = d + a * e1 + b * e2;
            // Normalised after each step; otherwise the length would grow at second order.
            1.0 / t.length() * t
        };
        match *self {
            Self::Rotation { point, order, .. } => Self::Rotation {
                point: point + by[0] * e1 + by[1] * e2,
                direction: tilted(by[2], by[3]),
                order,
            },
            Self::Mirror { point, normal } => {
                Self::Mirror { point: point + by[0] * normal, normal: tilted(by[1], by[2]) }
            }
        }
    }

    /// The same symmetry with its reference point nearest to a given point.
    pub(super) fn near(self, p: DVec3) -> Self {
        match self {
            // Near the cloud, shifts and tilts are nearly uncorrelated. About a distant point, each tilt
            // would move the axis far away.
            Self::Rotation { point, direction, order } => {
                Self::Rotation { point: point + (p - point).dot(direction) * direction, direction, order }
            }
            Self::Mirror { point, normal } => {
                Self::Mirror { point: p - (p - point).dot(normal) * normal, normal }
            }
        }
    }

    /// The maps of a finite symmetry, without the identity.
    pub(super) fn maps(&self) -> Vec<Map> {
        match *self {
            Self::Rotation { order: Some(n), .. } => {
                (1..n).map(|k| Map::turn(TAU * f64::from(k) / f64::from(n))).collect()
            }
            // Infinitely many, so they cannot be listed.
            Self::Rotation { order: None, .. } => Vec::new(),
            Self::Mirror { .. } => vec![Map::Reflect],
        }
    }

    /// Height along the axis, distance from it, and the angle about it.
    pub(super) fn cylindrical(&self, p: DVec3) -> [f64; 3] {
        let d = self.direction();
        let (e1, e2) = tangents(d);
        let r = p - self.point();
        let (x, y) = (r.dot(e1), r.dot(e2));
        [r.dot(d), x.hypot(y), y.atan2(x)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_agree_with_differences() {
        let d = DVec3::new(0.3, -0.5, 0.8).try_normalize().unwrap();
        let point = DVec3::new(0.4, 0.1, -0.2);
        let rotation = Symmetry::Rotation { point, direction: d, order: None };
        let mirror = Symmetry::Mirror { point, normal: d };
        let p = DVec3::new(1.2, -0.7, 0.5);
        for (symmetry, map) in [(rotation, Map::turn(0.9)), (mirror, Map::Reflect)] {
            let all = symmetry.derivatives(map, p);
            for k in 0..symmetry.parameters() {
                let step = |h: f64| {
                    let mut by = [0.0; MAX_PARAMETERS];
                    by[k] = h;
                    symmetry.moved(&by).apply(map, p)
                };
                let h = 1e-5;
                let difference = 0.5 / h * (step(h) - step(-h));
                assert!(difference.distance(all[k]) < 1e-8, "parameter {k}: {difference:?} {:?}", all[k]);
            }
        }
    }
}
