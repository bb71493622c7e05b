//! Curves and surfaces of faces: lines, circles, ellipses, splines; planes and cylinders.

use planish_estimate::vector3::{add_scaled as along, cross, dot, norm, scale, sub};

/// A curve of an edge.
#[derive(Debug, Clone, PartialEq)]
pub enum Curve {
    /// `origin + t direction`, the direction of unit length.
    Line {
        /// The point of parameter 0.
        origin: [f64; 3],
        /// A unit vector.
        direction: [f64; 3],
    },
    /// `center + a cos t + b sin t` for orthogonal axes: a circle where they are equally long, else an ellipse.
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

impl Curve {
    /// The point of a parameter.
    #[must_use]
    pub fn point(&self, t: f64) -> [f64; 3] {
        match self {
            Self::Line { origin, direction } => along(*origin, t, *direction),
            Self::Ellipse { center, a, b } => along(along(*center, t.cos(), *a), t.sin(), *b),
            Self::Spline { points, derivatives } => {
                let (k, s) = piece(points.len(), t);
                let (s2, s3) = (s * s, s * s * s);
                let weights = [
                    2.0 * s3 - 3.0 * s2 + 1.0,
                    s3 - 2.0 * s2 + s,
                    3.0 * s2 - 2.0 * s3,
                    s3 - s2,
                ];
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
        w[0] * points[k][c] + w[1] * derivatives[k][c] + w[2] * points[k + 1][c] + w[3] * derivatives[k + 1][c]
    })
}

/// A surface of a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
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
}

impl Surface {
    /// The parameters of a point: coordinates in a plane; on a cylinder the angle in (−π, π] and the height.
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
        }
    }

    /// The point of parameters.
    #[must_use]
    pub fn point(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        match self {
            Self::Plane { origin, normal, x } => along(along(*origin, u, *x), v, cross(*normal, *x)),
            Self::Cylinder {
                origin,
                axis,
                x,
                radius,
            } => {
                let across = along(scale(radius * u.cos(), *x), radius * u.sin(), cross(*axis, *x));
                along(along(*origin, 1.0, across), v, *axis)
            }
        }
    }

    /// The unit normal at a point: a plane's own, away from a cylinder's axis.
    #[must_use]
    pub fn normal(&self, p: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Plane { normal, .. } => *normal,
            Self::Cylinder { origin, axis, .. } => {
                let d = sub(p, *origin);
                unit(along(d, -dot(d, *axis), *axis))
            }
        }
    }

    /// The signed distance of a point: positive on the normal's side.
    #[must_use]
    pub fn distance(&self, p: [f64; 3]) -> f64 {
        match self {
            Self::Plane { origin, normal, .. } => dot(sub(p, *origin), *normal),
            Self::Cylinder {
                origin, axis, radius, ..
            } => {
                let d = sub(p, *origin);
                norm(along(d, -dot(d, *axis), *axis)) - radius
            }
        }
    }

    /// Its kind in words.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Plane { .. } => "plane",
            Self::Cylinder { .. } => "cylinder",
        }
    }
}
