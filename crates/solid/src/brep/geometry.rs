//! Curves and surfaces of faces: lines, circles, ellipses, splines; planes, cylinders, cones, spheres and
//! tori.

use planish_core::DVec3;
use std::f64::consts::{FRAC_PI_2, TAU};

/// A curve of an edge.
#[derive(Debug, Clone, PartialEq)]
pub enum EdgeCurve {
    /// `origin + t direction`, the direction of unit length.
    Line {
        /// The point at parameter 0.
        origin: DVec3,
        /// A unit vector.
        direction: DVec3,
    },
    /// `center + a cos t + b sin t` with orthogonal a and b: a circle if they have equal lengths, else an
    /// ellipse.
    Ellipse {
        /// Centre.
        center: DVec3,
        /// Semi-axis, not shorter than `b`.
        a: DVec3,
        /// The other semi-axis.
        b: DVec3,
    },
    /// A cubic Hermite spline with one piece for each unit of the parameter.
    Spline {
        /// The points at parameters 0, 1, 2 …
        points: Vec<DVec3>,
        /// The derivatives at these points.
        derivatives: Vec<DVec3>,
    },
}

/// `a` scaled to unit length; zero if `a` is zero.
pub(crate) fn unit(a: DVec3) -> DVec3 {
    1.0 / a.length().max(f64::MIN_POSITIVE) * a
}

impl EdgeCurve {
    /// The point at a parameter.
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::brep::EdgeCurve;
    ///
    /// let circle = EdgeCurve::Ellipse { center: DVec3::X, a: 2.0 * DVec3::X, b: 2.0 * DVec3::Y };
    /// assert_eq!(circle.point(0.0), 3.0 * DVec3::X);
    /// ```
    #[must_use]
    pub fn point(&self, t: f64) -> DVec3 {
        match self {
            Self::Line { origin, direction } => *origin + t * *direction,
            Self::Ellipse { center, a, b } => *center + t.cos() * *a + t.sin() * *b,
            // Cubic Hermite basis. Points and derivatives are shared by neighbouring pieces, so the curve has
            // a continuous tangent.
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
    pub fn derivative(&self, t: f64) -> DVec3 {
        match self {
            Self::Line { direction, .. } => *direction,
            Self::Ellipse { a, b, .. } => -t.sin() * *a + t.cos() * *b,
            // The derivatives of the Hermite basis above.
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

/// The piece of a spline at a parameter, and the share of the piece there.
///
/// Parameters outside of the spline belong to its first or last piece, which is then extrapolated.
fn piece(points: usize, t: f64) -> (usize, f64) {
    let k = (t.floor().max(0.0) as usize).min(points.saturating_sub(2));
    (k, t - k as f64)
}

/// Weighted sum of the ends and derivatives of a piece.
fn hermite(points: &[DVec3], derivatives: &[DVec3], k: usize, w: [f64; 4]) -> DVec3 {
    w[0] * points[k] + w[1] * derivatives[k] + w[2] * points[k + 1] + w[3] * derivatives[k + 1]
}

/// A surface of a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaceSurface {
    /// All points with `normal · (p − origin) = 0`.
    Plane {
        /// A point of the plane.
        origin: DVec3,
        /// Unit normal.
        normal: DVec3,
        /// Unit vector in the plane, the direction of u.
        x: DVec3,
    },
    /// All points at a distance from an axis.
    Cylinder {
        /// A point of the axis.
        origin: DVec3,
        /// Unit vector along the axis.
        axis: DVec3,
        /// Unit vector across the axis, the direction of angle 0.
        x: DVec3,
        /// Radius.
        radius: f64,
    },
    /// All points whose distance from an axis is `radius + height tan(half_angle)`, where this is positive.
    Cone {
        /// The point of the axis at height 0.
        origin: DVec3,
        /// Unit vector along the axis, towards the wider end.
        axis: DVec3,
        /// Unit vector across the axis, the direction of angle 0.
        x: DVec3,
        /// Radius at height 0, ≥ 0.
        radius: f64,
        /// Angle between the axis and the surface, in radians, in (0, π/2).
        half_angle_rad: f64,
    },
    /// All points at a distance from a centre.
    Sphere {
        /// Centre.
        center: DVec3,
        /// Unit vector from the south to the north pole.
        axis: DVec3,
        /// Unit vector across the axis, the direction of longitude 0.
        x: DVec3,
        /// Radius.
        radius: f64,
    },
    /// All points at the minor radius from a circle with the major radius around an axis.
    Torus {
        /// Centre.
        center: DVec3,
        /// Unit vector along the axis.
        axis: DVec3,
        /// Unit vector across the axis, the direction of angle 0.
        x: DVec3,
        /// Radius of the circle around the axis, not less than the minor radius.
        major: f64,
        /// Radius of the tube.
        minor: f64,
    },
}

/// Coordinates relative to an axis: along x, along axis × x, and along the axis.
fn about(p: DVec3, origin: DVec3, axis: DVec3, x: DVec3) -> [f64; 3] {
    let d = p - origin;
    [d.dot(x), d.dot(axis.cross(x)), d.dot(axis)]
}

/// The point at an angle around an axis, a distance from it and a height.
fn around(origin: DVec3, axis: DVec3, x: DVec3, [angle, distance, height]: [f64; 3]) -> DVec3 {
    let across = distance * angle.cos() * x + distance * angle.sin() * axis.cross(x);
    origin + across + height * axis
}

impl FaceSurface {
    /// Parameters (u, v) of a point near the surface.
    ///
    /// On a plane these are coordinates. On other surfaces u is the angle around the axis, in (−π, π]. Then v
    /// is the height on a cylinder or cone, the latitude on a sphere, and the angle around the tube, in (−π,
    /// π], on a torus.
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::brep::FaceSurface;
    ///
    /// let (axis, x) = (DVec3::Z, DVec3::X);
    /// let cylinder = FaceSurface::Cylinder { origin: DVec3::ZERO, axis, x, radius: 2.0 };
    /// assert_eq!(cylinder.parameters(DVec3::new(2.0, 0.0, 5.0)), [0.0, 5.0]);
    /// assert_eq!(cylinder.point([0.0, 5.0]), DVec3::new(2.0, 0.0, 5.0));
    /// ```
    #[must_use]
    pub fn parameters(&self, p: DVec3) -> [f64; 2] {
        match self {
            Self::Plane { origin, normal, x } => {
                let d = p - *origin;
                [d.dot(*x), d.dot(normal.cross(*x))]
            }
            Self::Cylinder { origin, axis, x, .. } => {
                let d = p - *origin;
                [d.dot(axis.cross(*x)).atan2(d.dot(*x)), d.dot(*axis)]
            }
            Self::Cone { origin, axis, x, .. } => {
                let [a, b, h] = about(p, *origin, *axis, *x);
                [b.atan2(a), h]
            }
            Self::Sphere { center, axis, x, .. } => {
                let [a, b, h] = about(p, *center, *axis, *x);
                [b.atan2(a), h.atan2(a.hypot(b))]
            }
            // By atan2 instead of acos or asin, which lose half of the digits near the poles.
            Self::Torus { center, axis, x, major, .. } => {
                let [a, b, h] = about(p, *center, *axis, *x);
                [b.atan2(a), h.atan2(a.hypot(b) - major)]
            }
        }
    }

    /// The point at parameters (u, v).
    #[must_use]
    pub fn point(&self, [u, v]: [f64; 2]) -> DVec3 {
        match self {
            Self::Plane { origin, normal, x } => *origin + u * *x + v * normal.cross(*x),
            Self::Cylinder { origin, axis, x, radius } => {
                let across = radius * u.cos() * *x + radius * u.sin() * axis.cross(*x);
                *origin + across + v * *axis
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

    /// Unit normal at a point: that of a plane, else away from the axis, the centre of a sphere, or the
    /// centre line of a torus.
    #[must_use]
    pub fn normal(&self, p: DVec3) -> DVec3 {
        match self {
            Self::Plane { normal, .. } => *normal,
            Self::Cylinder { origin, axis, .. } => {
                let d = p - *origin;
                unit(d - d.dot(*axis) * *axis)
            }
            // The gradient of the signed distance: outwards and, since the cone widens along the axis,
            // against it.
            Self::Cone { origin, axis, half_angle_rad, .. } => {
                let d = p - *origin;
                let out = unit(d - d.dot(*axis) * *axis);
                half_angle_rad.cos() * out - half_angle_rad.sin() * *axis
            }
            Self::Sphere { center, .. } => unit(p - *center),
            Self::Torus { center, axis, major, .. } => {
                let d = p - *center;
                let out = unit(d - d.dot(*axis) * *axis);
                unit(d - major * out)
            }
        }
    }

    /// Signed distance of a point, positive on the side of the normal.
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::brep::FaceSurface;
    ///
    /// let (axis, x) = (DVec3::Z, DVec3::X);
    /// let torus = FaceSurface::Torus { center: DVec3::ZERO, axis, x, major: 5.0, minor: 1.0 };
    /// assert_eq!(torus.distance(DVec3::new(5.0, 0.0, 3.0)), 2.0);
    /// ```
    #[must_use]
    pub fn distance(&self, p: DVec3) -> f64 {
        match self {
            Self::Plane { origin, normal, .. } => (p - *origin).dot(*normal),
            Self::Cylinder { origin, axis, radius, .. } => {
                let d = p - *origin;
                (d - d.dot(*axis) * *axis).length() - radius
            }
            // Measured in the half plane of the point and the axis, from the line of the cone extended beyond
            // the apex. There, the nearest point of the cone is the apex itself, which is farther away.
            Self::Cone { origin, axis, x, radius, half_angle_rad } => {
                let [a, b, h] = about(p, *origin, *axis, *x);
                (a.hypot(b) - radius) * half_angle_rad.cos() - h * half_angle_rad.sin()
            }
            Self::Sphere { center, radius, .. } => (p - *center).length() - radius,
            Self::Torus { center, axis, x, major, minor } => {
                let [a, b, h] = about(p, *center, *axis, *x);
                (a.hypot(b) - major).hypot(h) - minor
            }
        }
    }

    /// Period of each parameter: 2π for an angle around the axis or the tube; `None` if it is not periodic.
    #[must_use]
    pub fn periods(&self) -> [Option<f64>; 2] {
        match self {
            Self::Plane { .. } => [None; 2],
            Self::Cylinder { .. } | Self::Cone { .. } | Self::Sphere { .. } => [Some(TAU), None],
            Self::Torus { .. } => [Some(TAU); 2],
        }
    }

    /// Range of v: between the poles of a sphere, and from the apex of a cone to infinity.
    #[must_use]
    pub fn range_v(&self) -> [f64; 2] {
        match self {
            Self::Cone { radius, half_angle_rad, .. } => [-radius / half_angle_rad.tan(), f64::INFINITY],
            Self::Sphere { .. } => [-FRAC_PI_2, FRAC_PI_2],
            _ => [f64::NEG_INFINITY, f64::INFINITY],
        }
    }

    /// Name of the kind of surface.
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
