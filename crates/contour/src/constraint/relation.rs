//! The constraints, each with its residual and the gradient of the residual.
//!
//! In: a drawing. Out: equations `f(x) = 0`, one for a simple constraint and two for a compound one. Lengths
//! are in the unit of the drawing, directions in radians or as sines and cosines. Not guaranteed: a value if
//! a bar has no length; the residual is NaN then.
//!
//! With `d = end − start` of a bar, `l = |d|`, `u = d/l` and `n = (−u_y, u_x)` the unit vector to its left,
//! everything below follows from `∂l/∂d = u` and `∂(direction)/∂d = n/l`.

use super::drawing::{BarId, CircleId, ParametricDrawing, PointId};
use super::equations::Equation;
use super::place::Place;
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI};

/// An axis of the drawing's plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// The first coordinate.
    X,
    /// The second coordinate.
    Y,
}

/// A geometric relation between parts of a drawing.
///
/// The paper squares its distances and does not normalise its products (Weiss-Cohen et al. 2009, eq. 4.1).
/// Here residuals are lengths and angles, so that their σ has a unit. Where a constraint holds, the gradients
/// of both forms agree up to a factor, and so do ranks and graphs.
///
/// # Examples
/// ```
/// use planish_contour::constraint::{BarId, Constraint, ParametricDrawing};
///
/// let triangle = ParametricDrawing::polygon(&[[0.0, 0.0], [40.0, 0.0], [0.0, 30.0]])?;
/// let right_angle = Constraint::Perpendicular { a: BarId(0), b: BarId(2) };
/// let equations = right_angle.equations(&triangle, triangle.values().as_slice());
/// assert!(equations[0].residual.abs() < 1e-15);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Weiss-Cohen, Bondarenko and Halevi 2009, eq. 3.1–3.5; Lin, Gossard and Light 1981, *Variational geometry
/// in computer-aided design*.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Constraint {
    /// `|b − a| = value`.
    Distance {
        /// One point.
        a: PointId,
        /// The other.
        b: PointId,
        /// The distance.
        value: f64,
    },
    /// The distance of a point to the left of a bar, negative to its right: `u × (p − start) = value`.
    ///
    /// Weiss-Cohen et al. 2009, eq. 3.3–3.5, with `V` from the start of the bar to the point, as in their
    /// text. Eq. 3.4 is printed with the opposite sign, which makes distances to the right positive.
    PointLineDistance {
        /// The point.
        point: PointId,
        /// The bar.
        bar: BarId,
        /// The signed distance.
        value: f64,
    },
    /// The angle by which `to` is turned from `from`, counter-clockwise, in radians.
    Angle {
        /// The bar from which the angle is measured.
        from: BarId,
        /// The bar to which the angle is measured.
        to: BarId,
        /// The angle in radians.
        radians: f64,
    },
    /// Two bars are parallel: the sine of their angle is zero.
    Parallel {
        /// One bar.
        a: BarId,
        /// The other.
        b: BarId,
    },
    /// Two bars are perpendicular: the cosine of their angle is zero.
    Perpendicular {
        /// One bar.
        a: BarId,
        /// The other.
        b: BarId,
    },
    /// The line of a bar touches a circle whose centre lies to the left or to the right of the bar.
    ///
    /// The side is part of the constraint: the absolute value of a distance has no derivative at zero.
    Tangent {
        /// The bar.
        bar: BarId,
        /// The circle.
        circle: CircleId,
        /// True if the centre lies to the left.
        left: bool,
    },
    /// Two circles touch: `|c_b − c_a| = r_a + r_b`, or `|r_a − r_b|` if one is inside the other.
    TangentCircles {
        /// One circle.
        a: CircleId,
        /// The other.
        b: CircleId,
        /// True if one is inside the other.
        inside: bool,
    },
    /// Two circles have the same centre (two equations).
    Concentric {
        /// One circle.
        a: CircleId,
        /// The other.
        b: CircleId,
    },
    /// Two bars have equal lengths.
    EqualLength {
        /// One bar.
        a: BarId,
        /// The other.
        b: BarId,
    },
    /// Two circles have equal radii.
    EqualRadius {
        /// One circle.
        a: CircleId,
        /// The other.
        b: CircleId,
    },
    /// Two points are mirror images about the line of a bar (two equations).
    Symmetric {
        /// One point.
        a: PointId,
        /// The other.
        b: PointId,
        /// The axis.
        about: BarId,
    },
    /// A bar is parallel to the x axis.
    Horizontal {
        /// The bar.
        bar: BarId,
    },
    /// A bar is parallel to the y axis.
    Vertical {
        /// The bar.
        bar: BarId,
    },
    /// A point has a given coordinate: one half of the paper's anchor (eq. 4.1, f4 or f5).
    Coordinate {
        /// The point.
        point: PointId,
        /// The coordinate.
        axis: Axis,
        /// Its value.
        value: f64,
    },
    /// A point has a given position (two equations): the paper's anchor point.
    Anchor {
        /// The point.
        point: PointId,
        /// The position.
        at: [f64; 2],
    },
    /// Two points coincide (two equations).
    Coincident {
        /// One point.
        a: PointId,
        /// The other.
        b: PointId,
    },
    /// A point lies on a circle, such as an end of an arc.
    PointOnCircle {
        /// The point.
        point: PointId,
        /// The circle.
        circle: CircleId,
    },
    /// A bar touches a circle at a point of both, such as the joint of a bar and an arc.
    ///
    /// The radius to the point is perpendicular to the bar. The distance of the centre from the bar would not
    /// do: given that the point is on both, it is at most the radius, and at this maximum its gradient
    /// depends on those of the other constraints.
    TangentAt {
        /// The bar.
        bar: BarId,
        /// The circle.
        circle: CircleId,
        /// The point.
        point: PointId,
    },
    /// Two coordinates are equal, such as those of a corner in two views.
    Aligned {
        /// One coordinate.
        a: Place,
        /// The other.
        b: Place,
    },
    /// A circle has a given radius.
    Radius {
        /// The circle.
        circle: CircleId,
        /// Its radius.
        value: f64,
    },
}

/// A bar at the values `x`: unit direction, unit normal to the left, length.
struct Line {
    along: [f64; 2],
    left: [f64; 2],
    length: f64,
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn scaled(s: f64, v: [f64; 2]) -> [f64; 2] {
    [s * v[0], s * v[1]]
}

/// Builds an equation: its residual and the sum of its gradients.
struct Builder<'a> {
    drawing: &'a ParametricDrawing,
    x: &'a [f64],
    equation: Equation,
}

impl<'a> Builder<'a> {
    fn new(drawing: &'a ParametricDrawing, x: &'a [f64]) -> Self {
        Self { drawing, x, equation: Equation { residual: 0.0, gradient: Vec::new(), is_length: true } }
    }

    /// Position of a point at `x`.
    fn at(&self, point: PointId) -> [f64; 2] {
        self.drawing.coordinates(point).map(|i| self.x[i])
    }

    fn between(&self, a: PointId, b: PointId) -> [f64; 2] {
        let (a, b) = (self.at(a), self.at(b));
        [b[0] - a[0], b[1] - a[1]]
    }

    fn line_between(&self, a: PointId, b: PointId) -> Line {
        // A length of zero gives NaN, which `Equation::is_finite` detects.
        let d = self.between(a, b);
        let length = d[0].hypot(d[1]);
        let along = [d[0] / length, d[1] / length];
        Line { along, left: [-along[1], along[0]], length }
    }

    fn line(&self, bar: BarId) -> Line {
        let [a, b] = self.drawing.ends(bar);
        self.line_between(a, b)
    }

    /// Adds a slope to the gradient. Parameters of a gradient are unique, as parts may share points.
    fn parameter(&mut self, parameter: usize, slope: f64) {
        // A linear search: an equation has at most eight parameters.
        match self.equation.gradient.iter_mut().find(|(known, _)| *known == parameter) {
            Some((_, sum)) => *sum += slope,
            None => self.equation.gradient.push((parameter, slope)),
        }
    }

    fn point(&mut self, point: PointId, slope: [f64; 2]) {
        let [x, y] = self.drawing.coordinates(point);
        self.parameter(x, slope[0]);
        self.parameter(y, slope[1]);
    }

    /// Adds the gradient of a function of `b − a`.
    fn vector(&mut self, a: PointId, b: PointId, slope: [f64; 2]) {
        self.point(a, scaled(-1.0, slope));
        self.point(b, slope);
    }

    fn bar(&mut self, bar: BarId, slope: [f64; 2]) {
        let [a, b] = self.drawing.ends(bar);
        self.vector(a, b, slope);
    }

    fn add_radius(&mut self, circle: CircleId, factor: f64) {
        let parameter = self.drawing.radius_parameter(circle);
        self.equation.residual += factor * self.x[parameter];
        self.parameter(parameter, factor);
    }

    fn add_distance(&mut self, a: PointId, b: PointId, factor: f64) {
        let line = self.line_between(a, b);
        self.equation.residual += factor * line.length;
        self.vector(a, b, scaled(factor, line.along));
    }

    /// Adds the signed distance of the point `Σ w_i p_i` from a bar; the weights sum to one.
    fn add_offset(&mut self, points: &[(PointId, f64)], bar: BarId, factor: f64) {
        let line = self.line(bar);
        let start = self.at(self.drawing.ends(bar)[0]);
        let mut from_start = [-start[0], -start[1]];
        for &(point, weight) in points {
            let p = self.at(point);
            from_start = [from_start[0] + weight * p[0], from_start[1] + weight * p[1]];
        }
        // Rotating the bar about its start moves the foot of the point across by its distance along the bar:
        // the last term of the gradient.
        self.equation.residual += factor * dot(line.left, from_start);
        for &(point, weight) in points {
            self.point(point, scaled(factor * weight, line.left));
        }
        self.point(self.drawing.ends(bar)[0], scaled(-factor, line.left));
        self.bar(bar, scaled(-factor * dot(line.along, from_start) / line.length, line.left));
    }

    /// A function of the angle between two bars; `of_angle` returns its value and derivative.
    fn turn(mut self, from: BarId, to: BarId, of_angle: impl Fn(f64) -> (f64, f64)) -> Equation {
        let (a, b) = (self.line(from), self.line(to));
        // atan2 is well-conditioned at every angle; acos of the dot product is not near parallel bars.
        let angle = dot(a.left, b.along).atan2(dot(a.along, b.along));
        let (value, slope) = of_angle(angle);
        self.equation.is_length = false;
        self.equation.residual = value;
        self.bar(from, scaled(-slope / a.length, a.left));
        self.bar(to, scaled(slope / b.length, b.left));
        self.equation
    }

    /// Adds a constant and returns the equation.
    fn plus(mut self, constant: f64) -> Equation {
        self.equation.residual += constant;
        self.equation
    }
}

impl Constraint {
    /// Number of equations: two for a compound constraint.
    #[must_use]
    pub fn equation_count(&self) -> usize {
        match self {
            Self::Concentric { .. }
            | Self::Symmetric { .. }
            | Self::Anchor { .. }
            | Self::Coincident { .. } => 2,
            _ => 1,
        }
    }

    /// The equations at the parameters `x` of a drawing: residuals and gradients.
    ///
    /// A gradient lists every parameter that the equation depends on, even with a zero slope at `x`: the
    /// graphs need the structure. Cost: constant.
    ///
    /// # Panics
    /// If it refers to a part that the drawing does not have, or if `x` is too short.
    #[must_use]
    pub fn equations(&self, drawing: &ParametricDrawing, x: &[f64]) -> Vec<Equation> {
        let mut new = Builder::new(drawing, x);
        let one = match *self {
            Self::Distance { a, b, value } => {
                new.add_distance(a, b, 1.0);
                new.plus(-value)
            }
            Self::PointLineDistance { point, bar, value } => {
                new.add_offset(&[(point, 1.0)], bar, 1.0);
                new.plus(-value)
            }
            // The wrapped difference is continuous near its zero, wherever the cut of atan2 lies.
            Self::Angle { from, to, radians } => new.turn(from, to, |angle| (wrapped(angle - radians), 1.0)),
            // Zero for parallel and for antiparallel bars: the direction of a bar has no meaning.
            Self::Parallel { a, b } => new.turn(a, b, |angle| (angle.sin(), angle.cos())),
            Self::Perpendicular { a, b } => new.turn(a, b, |angle| (angle.cos(), -angle.sin())),
            Self::Tangent { bar, circle, left } => {
                // A signed distance: the absolute value would have a kink where the bar passes the centre.
                let side = if left { 1.0 } else { -1.0 };
                new.add_offset(&[(drawing.centre(circle), 1.0)], bar, side);
                new.add_radius(circle, -1.0);
                new.plus(0.0)
            }
            Self::TangentCircles { a, b, inside } => {
                // |r_a − r_b| without its kink: the sign follows the larger circle.
                let radius = |circle| x[drawing.radius_parameter(circle)];
                let (of_a, of_b) = match (inside, radius(a) >= radius(b)) {
                    (false, _) => (-1.0, -1.0),
                    (true, true) => (-1.0, 1.0),
                    (true, false) => (1.0, -1.0),
                };
                new.add_distance(drawing.centre(a), drawing.centre(b), 1.0);
                new.add_radius(a, of_a);
                new.add_radius(b, of_b);
                new.plus(0.0)
            }
            // A difference, not a ratio: σ is a length for short and long bars alike.
            Self::EqualLength { a, b } => {
                let ([a0, a1], [b0, b1]) = (drawing.ends(a), drawing.ends(b));
                new.add_distance(a0, a1, 1.0);
                new.add_distance(b0, b1, -1.0);
                new.plus(0.0)
            }
            Self::EqualRadius { a, b } => {
                new.add_radius(a, 1.0);
                new.add_radius(b, -1.0);
                new.plus(0.0)
            }
            // Differences of coordinates instead of angles: linear equations are imposed exactly in one step.
            Self::Horizontal { bar } => return vec![difference(drawing, x, drawing.ends(bar), 1)],
            Self::Vertical { bar } => return vec![difference(drawing, x, drawing.ends(bar), 0)],
            Self::Coordinate { point, axis, value } => {
                return vec![coordinate(drawing, x, point, axis as usize, value)];
            }
            Self::Anchor { point, at } => {
                return (0..2).map(|axis| coordinate(drawing, x, point, axis, at[axis])).collect();
            }
            Self::Concentric { a, b } => {
                let centres = [drawing.centre(a), drawing.centre(b)];
                return (0..2).map(|axis| difference(drawing, x, centres, axis)).collect();
            }
            Self::Coincident { a, b } => {
                return (0..2).map(|axis| difference(drawing, x, [a, b], axis)).collect();
            }
            // The midpoint lies on the axis, and the line through both points is perpendicular to it.
            Self::Symmetric { a, b, about } => {
                new.add_offset(&[(a, 0.5), (b, 0.5)], about, 1.0);
                return vec![new.plus(0.0), along(drawing, x, [a, b], about)];
            }
            // A distance minus a radius: a length, unlike a difference of squares.
            Self::PointOnCircle { point, circle } => {
                new.add_distance(drawing.centre(circle), point, 1.0);
                new.add_radius(circle, -1.0);
                new.plus(0.0)
            }
            Self::TangentAt { bar, circle, point } => {
                return vec![along(drawing, x, [drawing.centre(circle), point], bar)];
            }
            Self::Aligned { a, b } => {
                for (place, factor) in [(a, -1.0), (b, 1.0)] {
                    new.equation.residual += factor * place.value(drawing, x);
                    for (parameter, slope) in place.terms(drawing) {
                        new.parameter(parameter, factor * slope);
                    }
                }
                new.plus(0.0)
            }
            Self::Radius { circle, value } => {
                new.add_radius(circle, 1.0);
                new.plus(-value)
            }
        };
        vec![one]
    }

    /// The same constraint with its dimension measured in a drawing; `None` for a relation without a
    /// dimension.
    ///
    /// Distances of zero and multiples of a right angle are relations, because they express no size.
    #[must_use]
    pub fn measured(&self, drawing: &ParametricDrawing, x: &[f64]) -> Option<Self> {
        // The residual is the measured dimension minus the stated one; adding it gives the measured one.
        let mut read = *self;
        let found = self.equations(drawing, x)[0].residual;
        match &mut read {
            Self::Distance { value, .. } | Self::PointLineDistance { value, .. } if *value == 0.0 => {
                return None;
            }
            // Exact comparison: these values are stated, not computed.
            Self::Angle { radians, .. } if (*radians / FRAC_PI_2).fract() == 0.0 => return None,
            Self::Angle { radians, .. } => *radians = wrapped(*radians + found),
            Self::Distance { value, .. }
            | Self::PointLineDistance { value, .. }
            | Self::Coordinate { value, .. }
            | Self::Radius { value, .. } => *value += found,
            Self::Anchor { point, at } => *at = drawing.coordinates(*point).map(|i| x[i]),
            _ => return None,
        }
        Some(read)
    }
}

/// The equivalent angle in [−π, π).
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(2.0 * PI) - PI
}

/// A coordinate of `b` minus that of `a`.
fn difference(drawing: &ParametricDrawing, x: &[f64], [a, b]: [PointId; 2], axis: usize) -> Equation {
    let (i, j) = (drawing.coordinates(a)[axis], drawing.coordinates(b)[axis]);
    Equation { residual: x[j] - x[i], gradient: vec![(i, -1.0), (j, 1.0)], is_length: true }
}

/// A coordinate of a point minus a value.
fn coordinate(drawing: &ParametricDrawing, x: &[f64], point: PointId, axis: usize, value: f64) -> Equation {
    let parameter = drawing.coordinates(point)[axis];
    Equation { residual: x[parameter] - value, gradient: vec![(parameter, 1.0)], is_length: true }
}

/// `(b − a) · u` for the direction `u` of a bar: zero if the line through both points is perpendicular to it.
fn along(drawing: &ParametricDrawing, x: &[f64], [a, b]: [PointId; 2], bar: BarId) -> Equation {
    let mut new = Builder::new(drawing, x);
    let line = new.line(bar);
    let across = new.between(a, b);
    new.equation.residual = dot(across, line.along);
    new.vector(a, b, line.along);
    new.bar(bar, scaled(dot(across, line.left) / line.length, line.left));
    new.equation
}
