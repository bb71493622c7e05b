//! Shapes in space, their parameters in a chart, and signed distances with derivatives.

use nalgebra::{Matrix3, Vector3};
use std::fmt;

/// The kind of a shape, with the order of its reported parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PrimitiveKind {
    /// An infinite plane: `normal_x normal_y normal_z offset`, the points with `n·p = offset`.
    Plane,
    /// `center_x center_y center_z radius`.
    Sphere,
    /// An infinite cylinder: `point_x point_y point_z axis_x axis_y axis_z radius`. The point is the one on
    /// the axis nearest to the centroid of the readings.
    Cylinder,
    /// `center_x center_y center_z length width height` and the three unit axes, `length_x … height_z`.
    Box,
}

impl fmt::Display for PrimitiveKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Plane => "plane3",
            Self::Sphere => "sphere",
            Self::Cylinder => "cylinder",
            Self::Box => "box",
        })
    }
}

impl PrimitiveKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Plane, Self::Sphere, Self::Cylinder, Self::Box];

    /// Number of unknowns; smaller than the number of reported parameters if these contain directions.
    #[must_use]
    pub fn unknowns(self) -> usize {
        match self {
            Self::Plane => 3,
            Self::Sphere => 4,
            Self::Cylinder => 5,
            Self::Box => 9,
        }
    }

    /// Names of the reported parameters; directions have three components.
    ///
    /// # Examples
    /// ```
    /// use planish_contour::primitive::PrimitiveKind;
    ///
    /// assert_eq!(PrimitiveKind::Plane.names(), ["normal_x", "normal_y", "normal_z", "offset"]);
    /// assert_eq!(PrimitiveKind::Plane.unknowns(), 3); // a unit normal has two degrees of freedom
    /// ```
    #[must_use]
    pub fn names(self) -> &'static [&'static str] {
        match self {
            Self::Plane => &["normal_x", "normal_y", "normal_z", "offset"],
            Self::Sphere => &["center_x", "center_y", "center_z", "radius"],
            Self::Cylinder => &["point_x", "point_y", "point_z", "axis_x", "axis_y", "axis_z", "radius"],
            Self::Box => &[
                "center_x", "center_y", "center_z", "length", "width", "height", "length_x", "length_y",
                "length_z", "width_x", "width_y", "width_z", "height_x", "height_y", "height_z",
            ],
        }
    }

    /// Number of smooth pieces: 6 sides of a box, otherwise 1.
    pub(crate) fn pieces(self) -> usize {
        if self == Self::Box { 6 } else { 1 }
    }

    /// True if all values are finite and all sizes positive.
    pub(crate) fn is_valid(self, x: &[f64]) -> bool {
        x.iter().all(|value| value.is_finite())
            && match self {
                Self::Plane => true,
                Self::Sphere => x[3] > 0.0,
                Self::Cylinder => x[4] > 0.0,
                Self::Box => x[6..9].iter().all(|&size| size > 0.0),
            }
    }
}

/// Local frame of the unknowns: directions are close to its third axis, and rotations close to the identity.
///
/// Angles or rotation vectors in a fixed frame have singularities; this chart has none near the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Chart {
    /// Origin of the frame.
    pub(crate) pivot: Vector3<f64>,
    /// Axes of the frame as columns.
    pub(crate) frame: Matrix3<f64>,
}

impl Chart {
    /// A chart whose third axis is `direction`.
    pub(crate) fn along(pivot: Vector3<f64>, direction: Vector3<f64>) -> Self {
        let third = direction.normalize();
        // The coordinate axis most nearly perpendicular to the direction: its cross product cannot vanish.
        let smallest = third.iamin();
        let first = Vector3::ith(smallest, 1.0).cross(&third).normalize();
        let second = third.cross(&first);
        Self { pivot, frame: Matrix3::from_columns(&[first, second, third]) }
    }

    /// Unit vector along `third + a first + b second`, and its derivatives by `a` and `b`.
    fn direction(&self, a: f64, b: f64) -> (Vector3<f64>, [Vector3<f64>; 2]) {
        let [first, second, third] = [0, 1, 2].map(|k| self.frame.column(k).into_owned());
        // Two unknowns instead of three components with a constraint: the covariance is regular.
        let long = third + first * a + second * b;
        let length = long.norm();
        let n = long / length;
        (n, [first, second].map(|e| (e - n * n.dot(&e)) / length))
    }

    /// Rotation of a box: world from the axes of the box.
    fn rotation(&self, w: [f64; 3]) -> Matrix3<f64> {
        self.frame * nalgebra::Rotation3::new(Vector3::from(w)).into_inner()
    }

    /// Reported parameters of the unknowns `x` in this chart.
    pub(crate) fn reported(&self, shape: PrimitiveKind, x: &[f64]) -> Vec<f64> {
        match shape {
            PrimitiveKind::Plane => {
                let (n, _) = self.direction(x[0], x[1]);
                vec![n.x, n.y, n.z, x[2] + n.dot(&self.pivot)]
            }
            PrimitiveKind::Sphere => (0..4).map(|k| x[k] + if k < 3 { self.pivot[k] } else { 0.0 }).collect(),
            PrimitiveKind::Cylinder => {
                let (n, _) = self.direction(x[2], x[3]);
                let c = self.axis_point(x);
                // The point of the axis nearest to the pivot.
                let p = c + n * n.dot(&(self.pivot - c));
                vec![p.x, p.y, p.z, n.x, n.y, n.z, x[4]]
            }
            PrimitiveKind::Box => {
                let r = self.rotation([x[3], x[4], x[5]]);
                let mut values: Vec<f64> = (0..3).map(|k| x[k] + self.pivot[k]).collect();
                // A box has 24 descriptions. The longest side first, and axes with a positive largest
                // component, select one of them.
                let mut order = [0, 1, 2];
                order.sort_by(|&a: &usize, &b: &usize| x[6 + b].total_cmp(&x[6 + a]));
                values.extend(order.map(|k| x[6 + k]));
                for k in order {
                    let axis = r.column(k);
                    let sign = if axis[axis.iamax()] < 0.0 { -1.0 } else { 1.0 };
                    values.extend(axis.iter().map(|c| sign * c));
                }
                values
            }
        }
    }

    /// Point of a cylinder's axis in the plane of the first two axes of the frame.
    fn axis_point(&self, x: &[f64]) -> Vector3<f64> {
        self.pivot + self.frame.column(0) * x[0] + self.frame.column(1) * x[1]
    }
}

/// Signed distance to a piece of a shape, positive outside, and `∂g/∂p`; fills `by_state` with `∂g/∂x`.
pub(crate) fn distance(
    shape: PrimitiveKind,
    chart: &Chart,
    x: &[f64],
    piece: usize,
    p: &Vector3<f64>,
    by_state: &mut [f64],
) -> (f64, Vector3<f64>) {
    match shape {
        PrimitiveKind::Plane => {
            let (n, by) = chart.direction(x[0], x[1]);
            let d = p - chart.pivot;
            by_state[0] = by[0].dot(&d);
            by_state[1] = by[1].dot(&d);
            by_state[2] = -1.0;
            (n.dot(&d) - x[2], n)
        }
        PrimitiveKind::Sphere => {
            let d = p - chart.pivot - Vector3::new(x[0], x[1], x[2]);
            let length = d.norm();
            let n = d / length;
            for k in 0..3 {
                by_state[k] = -n[k];
            }
            by_state[3] = -1.0;
            (length - x[3], n)
        }
        PrimitiveKind::Cylinder => {
            let (axis, by) = chart.direction(x[2], x[3]);
            let d = p - chart.axis_point(x);
            let along = axis.dot(&d);
            let across = d - axis * along;
            let length = across.norm();
            let n = across / length;
            by_state[0] = -n.dot(&chart.frame.column(0));
            by_state[1] = -n.dot(&chart.frame.column(1));
            // n is perpendicular to the axis, so that of ∂(d − axis (axis·d)) only −(∂axis) (axis·d) remains.
            by_state[2] = -along * n.dot(&by[0]);
            by_state[3] = -along * n.dot(&by[1]);
            by_state[4] = -1.0;
            (length - x[4], n)
        }
        PrimitiveKind::Box => {
            let (axis, sign) = side(piece);
            let w = Vector3::new(x[3], x[4], x[5]);
            let r = chart.rotation([x[3], x[4], x[5]]);
            let n = r.column(axis) * sign;
            let q = r.transpose() * (p - chart.pivot - Vector3::new(x[0], x[1], x[2]));
            by_state.fill(0.0);
            for k in 0..3 {
                by_state[k] = -n[k];
            }
            // q = Rᵀ d and dR = R [J dw]ₓ: dq = q × (J dw).
            let jacobian = right_jacobian(&w);
            for k in 0..3 {
                by_state[3 + k] = sign * q.cross(&jacobian.column(k))[axis];
            }
            // A size moves its two opposite sides by half each.
            by_state[6 + axis] = -0.5;
            (sign * q[axis] - 0.5 * x[6 + axis], n)
        }
    }
}

/// Distance of a point within a side of a box to the nearest edge, negative beyond it; infinite for shapes
/// without edges.
pub(crate) fn within(shape: PrimitiveKind, chart: &Chart, x: &[f64], piece: usize, p: &Vector3<f64>) -> f64 {
    if shape != PrimitiveKind::Box {
        return f64::INFINITY;
    }
    let q = local(chart, x, p);
    let (axis, _) = side(piece);
    // The edges of a side are where the other two coordinates reach half their sizes.
    let others = (0..3).filter(|&k| k != axis);
    others.map(|k| 0.5 * x[6 + k] - q[k].abs()).fold(f64::INFINITY, f64::min)
}

/// Vector from the nearest point of a side of a box to the projection of a point into the plane of that side.
pub(crate) fn overshoot(chart: &Chart, x: &[f64], piece: usize, p: &Vector3<f64>) -> Vector3<f64> {
    let q = local(chart, x, p);
    let (axis, _) = side(piece);
    let mut over = Vector3::zeros();
    for k in (0..3).filter(|&k| k != axis) {
        over[k] = (q[k].abs() - 0.5 * x[6 + k]).max(0.0) * q[k].signum();
    }
    chart.rotation([x[3], x[4], x[5]]) * over
}

/// A point in the axes of a box, relative to its centre.
fn local(chart: &Chart, x: &[f64], p: &Vector3<f64>) -> Vector3<f64> {
    chart.rotation([x[3], x[4], x[5]]).transpose() * (p - chart.pivot - Vector3::new(x[0], x[1], x[2]))
}

/// Axis and sign of the outward normal of side `piece` of a box.
fn side(piece: usize) -> (usize, f64) {
    (piece / 2, if piece.is_multiple_of(2) { 1.0 } else { -1.0 })
}

/// Right Jacobian `J` of SO(3): `exp([w + dw]ₓ) = exp([w]ₓ) exp([J dw]ₓ)` to first order.
fn right_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let cross = w.cross_matrix();
    let angle = w.norm();
    // Both quotients below are 0/0 at zero; the next term of the series is of order 1e-12 here.
    if angle < 1e-6 {
        return Matrix3::identity() - 0.5 * cross;
    }
    let squared = angle * angle;
    Matrix3::identity() - cross * ((1.0 - angle.cos()) / squared)
        + cross * cross * ((angle - angle.sin()) / (squared * angle))
}
