//! Curves and surfaces of faces: lines, circles, ellipses, splines; planes, cylinders, cones, spheres and
//! tori.

use planish_estimate::vector3::{add_scaled as along, cross, dot, norm, scale, sub};
use std::f64::consts::{FRAC_PI_2, TAU};

/// A curve of an edge.
#[derive(Debug, Clone, PartialEq)]
pub enum EdgeCurve {
    /// `origin + t direction`, the direction of unit length.
    Line {
        /// The point of parameter 0.
        origin: [f64; 3],
        /// A unit vector.
        direction: [f64; 3],
    },
    /// `center + a cos t + b sin t` for orthogonal axes: a circle where they are equally long, else an
    /// ellipse.
    Ellipse {
        /// The centre.
        center: [f64; 3],
        /// Half an axis; not shorter than `b`.
        a: [f64; 3],
        /// The other.
        b: [f64; 3],
    },
    /// Cubic pieces between points with given derivatives, one for each unit of the parameter.
    Spline {
        /// The points of parameters 0, 1, 2 …
        points: Vec<[f64; 3]>,
        /// The derivatives there.
        derivatives: Vec<[f64; 3]>,
    },
}

/// `a` of unit length.
pub(crate) fn unit(a: [f64; 3]) -> [f64; 3] {
    scale(1.0 / norm(a).max(f64::MIN_POSITIVE), a)
}

impl EdgeCurve {
    /// The point of a parameter.
    #[must_use]
    pub fn point(&self, t: f64) -> [f64; 3] {
        match self {
            Self::Line { origin, direction } => along(*origin, t, *direction),
            Self::Ellipse { center, a, b } => along(along(*center, t.cos(), *a), t.sin(), *b),
            Self::Spline { points, derivatives } => {
                let (k, s) = piece(points.len(), t);
                let (s2, s3) = (s * s, s * s * s);
                let weights = [2.0 * s3 - 3.0 * s2 + 1.0, s3 - 2.0 * s2 + s, 3.0 * s2 - 2.0 * s3, s3 - s2];
                hermite(points, derivatives, k, weights)
            }
        }
    }

    /// The derivative at a parameter.
    #[must_use]
    pub fn derivative(&self, t: f64) -> [f64; 3] {
        match self {
            Self::Line { direction, .. } => *direction,
            Self::Ellipse { a, b, .. } => along(scale(-t.sin(), *a), t.cos(), *b),
            Self::Spline { points, derivatives } => {
                let (k, s) = piece(points.len(), t);
                let weights = [
                    6.0 * s * s - 6.0 * s,
                    3.0 * s * s - 4.0 * s + 1.0,
                    6.0 * s - 6.0 * s * s,
                    3.0 * s * s - 2.0 * s,
                ];
                hermite(points, derivatives, k, weights)
            }
        }
    }
}

fn piece(points: usize, t: f64) -> (usize, f64) {
    let k = (t.floor().max(0.0) as usize).min(points.saturating_sub(2));
    (k, t - k as f64)
}

fn hermite(points: &[[f64; 3]], derivatives: &[[f64; 3]], k: usize, w: [f64; 4]) -> [f64; 3] {
    [0, 1, 2].map(|c| {
        w[0] * points[k][c]
            + w[1] * derivatives[k][c]
            + w[2] * points[k + 1][c]
            + w[3] * derivatives[k + 1][c]
    })
}

/// A surface of a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaceSurface {
    /// All points with `normal · (p − origin) = 0`.
    Plane {
        /// A point of it.
        origin: [f64; 3],
        /// Its unit normal.
        normal: [f64; 3],
        /// A unit vector in it.
        x: [f64; 3],
    },
    /// All points at the radius from an axis.
    Cylinder {
        /// A point of the axis.
        origin: [f64; 3],
        /// The axis, of unit length.
        axis: [f64; 3],
        /// A unit vector across the axis, where the angle is zero.
        x: [f64; 3],
        /// The radius.
        radius: f64,
    },
    /// All points whose distance from an axis is `radius + height tan(half_angle)`, where that is positive.
    Cone {
        /// The point of the axis at height 0.
        origin: [f64; 3],
        /// The axis, of unit length, towards where the cone is wider.
        axis: [f64; 3],
        /// A unit vector across the axis, where the angle is zero.
        x: [f64; 3],
        /// The radius at height 0, not negative.
        radius: f64,
        /// Between the axis and the surface, in radians, in (0, π/2).
        half_angle_rad: f64,
    },
    /// All points at the radius from a centre.
    Sphere {
        /// The centre.
        center: [f64; 3],
        /// From pole to pole, of unit length.
        axis: [f64; 3],
        /// A unit vector across the axis, where the longitude is zero.
        x: [f64; 3],
        /// The radius.
        radius: f64,
    },
    /// All points at the minor radius from a circle of the major radius around an axis.
    Torus {
        /// The centre.
        center: [f64; 3],
        /// The axis, of unit length.
        axis: [f64; 3],
        /// A unit vector across the axis, where the angle around it is zero.
        x: [f64; 3],
        /// The radius of the circle around the axis, not less than the minor radius.
        major: f64,
        /// The radius of the tube.
        minor: f64,
    },
}

/// Coordinates about an axis: along two directions across it, and along it.
fn about(p: [f64; 3], origin: [f64; 3], axis: [f64; 3], x: [f64; 3]) -> [f64; 3] {
    let d = sub(p, origin);
    [dot(d, x), dot(d, cross(axis, x)), dot(d, axis)]
}

/// The point of an angle around an axis, a distance from it and a height.
fn around(origin: [f64; 3], axis: [f64; 3], x: [f64; 3], [angle, distance, height]: [f64; 3]) -> [f64; 3] {
    let across = along(scale(distance * angle.cos(), x), distance * angle.sin(), cross(axis, x));
    along(along(origin, 1.0, across), height, axis)
}

impl FaceSurface {
    /// The parameters (u, v) of a point: coordinates in a plane; else u is the angle around the axis in (−π,
    /// π], and v the height on a cylinder or cone, the latitude on a sphere, the angle around the tube, in
    /// (−π, π], on a torus.
    #[must_use]
    pub fn parameters(&self, p: [f64; 3]) -> [f64; 2] {
        match self {
            Self::Plane { origin, normal, x } => {
                let d = sub(p, *origin);
                [dot(d, *x), dot(d, cross(*normal, *x))]
            }
            Self::Cylinder { origin, axis, x, .. } => {
                let d = sub(p, *origin);
                [dot(d, cross(*axis, *x)).atan2(dot(d, *x)), dot(d, *axis)]
            }
            Self::Cone { origin, axis, x, .. } => {
                let [a, b, h] = about(p, *origin, *axis, *x);
                [b.atan2(a), h]
            }
            Self::Sphere { center, axis, x, .. } => {
                let [a, b, h] = about(p, *center, *axis, *x);
                [b.atan2(a), h.atan2(a.hypot(b))]
            }
            Self::Torus { center, axis, x, major, .. } => {
                let [a, b, h] = about(p, *center, *axis, *x);
                [b.atan2(a), h.atan2(a.hypot(b) - major)]
            }
        }
    }

    /// The point of parameters.
    #[must_use]
    pub fn point(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        match self {
            Self::Plane { origin, normal, x } => along(along(*origin, u, *x), v, cross(*normal, *x)),
            Self::Cylinder { origin, axis, x, radius } => {
                let across = along(scale(radius * u.cos(), *x), radius * u.sin(), cross(*axis, *x));
                along(along(*origin, 1.0, across), v, *axis)
            }
            Self::Cone { origin, axis, x, radius, half_angle_rad } => {
                around(*origin, *axis, *x, [u, radius + v * half_angle_rad.tan(), v])
            }
            Self::Sphere { center, axis, x, radius } => {
                around(*center, *axis, *x, [u, radius * v.cos(), radius * v.sin()])
            }
            Self::Torus { center, axis, x, major, minor } => {
                around(*center, *axis, *x, [u, major + minor * v.cos(), minor * v.sin()])
            }
        }
    }

    /// The unit normal at a point: a plane's own, away from an axis, from a sphere's centre, or out of a
    /// torus' tube.
    #[must_use]
    pub fn normal(&self, p: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Plane { normal, .. } => *normal,
            Self::Cylinder { origin, axis, .. } => {
                let d = sub(p, *origin);
                unit(along(d, -dot(d, *axis), *axis))
            }
            Self::Cone { origin, axis, half_angle_rad, .. } => {
                let d = sub(p, *origin);
                let out = unit(along(d, -dot(d, *axis), *axis));
                along(scale(half_angle_rad.cos(), out), -half_angle_rad.sin(), *axis)
            }
            Self::Sphere { center, .. } => unit(sub(p, *center)),
            Self::Torus { center, axis, major, .. } => {
                let d = sub(p, *center);
                let out = unit(along(d, -dot(d, *axis), *axis));
                unit(along(d, -major, out))
            }
        }
    }

    /// The signed distance of a point: positive on the normal's side.
    #[must_use]
    pub fn distance(&self, p: [f64; 3]) -> f64 {
        match self {
            Self::Plane { origin, normal, .. } => dot(sub(p, *origin), *normal),
            Self::Cylinder { origin, axis, radius, .. } => {
                let d = sub(p, *origin);
                norm(along(d, -dot(d, *axis), *axis)) - radius
            }
            Self::Cone { origin, axis, x, radius, half_angle_rad } => {
                let [a, b, h] = about(p, *origin, *axis, *x);
                (a.hypot(b) - radius) * half_angle_rad.cos() - h * half_angle_rad.sin()
            }
            Self::Sphere { center, radius, .. } => norm(sub(p, *center)) - radius,
            Self::Torus { center, axis, x, major, minor } => {
                let [a, b, h] = about(p, *center, *axis, *x);
                (a.hypot(b) - major).hypot(h) - minor
            }
        }
    }

    /// By how much each parameter comes back to the same points: 2π around an axis or a tube; none where it
    /// does not.
    #[must_use]
    pub fn periods(&self) -> [Option<f64>; 2] {
        match self {
            Self::Plane { .. } => [None; 2],
            Self::Cylinder { .. } | Self::Cone { .. } | Self::Sphere { .. } => [Some(TAU), None],
            Self::Torus { .. } => [Some(TAU); 2],
        }
    }

    /// The range of v: between the poles of a sphere, from a cone's apex on.
    #[must_use]
    pub fn range_v(&self) -> [f64; 2] {
        match self {
            Self::Cone { radius, half_angle_rad, .. } => [-radius / half_angle_rad.tan(), f64::INFINITY],
            Self::Sphere { .. } => [-FRAC_PI_2, FRAC_PI_2],
            _ => [f64::NEG_INFINITY, f64::INFINITY],
        }
    }

    /// Its kind in words.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Plane { .. } => "plane",
            Self::Cylinder { .. } => "cylinder",
            Self::Cone { .. } => "cone",
            Self::Sphere { .. } => "sphere",
            Self::Torus { .. } => "torus",
        }
    }
}
