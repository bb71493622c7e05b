//! The constraints, each with its residual and the residual's gradient.
//!
//! Comes in: a drawing. Goes out: equations `f(x) = 0`; one for a simple constraint, two for a compound one.
//! Lengths are in the drawing's unit, directions in radians or as sines and cosines. Not guaranteed: a value
//! where a bar has no length; it is NaN there.
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

/// Something that holds between parts of a drawing.
///
/// The paper squares its distances and does not normalise its products (D eq. 4.1). Here residuals are
/// lengths and angles, so that their σ means something; where a constraint holds, both forms have the same
/// gradients up to a factor, and so the same ranks and graphs.
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
    /// D eq. 3.3–3.5 with the text's `V` from the bar's start to the point; eq. 3.4 is printed with the
    /// opposite sign, which counts distances to the right.
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
        /// The bar from which the angle counts.
        from: BarId,
        /// The bar to which it counts.
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
    /// A bar's line touches a circle, whose centre lies to the left of the bar or to its right.
    Tangent {
        /// The bar.
        bar: BarId,
        /// The circle.
        circle: CircleId,
        /// Whether the centre lies to the left.
        left: bool,
    },
    /// Two circles touch: `|c_b − c_a| = r_a + r_b`, or `|r_a − r_b|` where one is inside the other.
    TangentCircles {
        /// One circle.
        a: CircleId,
        /// The other.
        b: CircleId,
        /// Whether one is inside the other.
        inside: bool,
    },
    /// Two circles have one centre (two equations).
    Concentric {
        /// One circle.
        a: CircleId,
        /// The other.
        b: CircleId,
    },
    /// Two bars are of equal length.
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
    /// Two points mirror each other about a bar's line (two equations).
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
    /// A point has a given coordinate: half of the paper's anchor (D eq. 4.1, f4 or f5).
    Coordinate {
        /// The point.
        point: PointId,
        /// Which coordinate.
        axis: Axis,
        /// Its value.
        value: f64,
    },
    /// A point is at a given place (two equations): the paper's anchor point.
    Anchor {
        /// The point.
        point: PointId,
        /// The place.
        at: [f64; 2],
    },
    /// Two points are one (two equations).
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
    /// A bar touches a circle at a point that is on both, such as where an arc goes on from a bar: the radius
    /// to the point stands upright on the bar.
    TangentAt {
        /// The bar.
        bar: BarId,
        /// The circle.
        circle: CircleId,
        /// The point.
        point: PointId,
    },
    /// Two coordinates are one, such as those of a corner in two views.
    Aligned {
        /// One.
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

/// A bar at the values `x`: direction, left normal, length.
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

/// Builds an equation: a value and the sum of its gradients.
struct Builder<'a> {
    drawing: &'a ParametricDrawing,
    x: &'a [f64],
    equation: Equation,
}

impl<'a> Builder<'a> {
    fn new(drawing: &'a ParametricDrawing, x: &'a [f64]) -> Self {
        Self { drawing, x, equation: Equation { residual: 0.0, gradient: Vec::new(), is_length: true } }
    }

    fn at(&self, point: PointId) -> [f64; 2] {
        self.drawing.coordinates(point).map(|i| self.x[i])
    }

    fn between(&self, a: PointId, b: PointId) -> [f64; 2] {
        let (a, b) = (self.at(a), self.at(b));
        [b[0] - a[0], b[1] - a[1]]
    }

    fn line_between(&self, a: PointId, b: PointId) -> Line {
        let d = self.between(a, b);
        let length = d[0].hypot(d[1]);
        let along = [d[0] / length, d[1] / length];
        Line { along, left: [-along[1], along[0]], length }
    }

    fn line(&self, bar: BarId) -> Line {
        let [a, b] = self.drawing.ends(bar);
        self.line_between(a, b)
    }

    fn parameter(&mut self, parameter: usize, slope: f64) {
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

    /// The gradient with respect to `b − a`.
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

    /// The signed distance of the point `Σ w_i p_i` (weights that sum to one) from a bar.
    fn add_offset(&mut self, points: &[(PointId, f64)], bar: BarId, factor: f64) {
        let line = self.line(bar);
        let start = self.at(self.drawing.ends(bar)[0]);
        let mut from_start = [-start[0], -start[1]];
        for &(point, weight) in points {
            let p = self.at(point);
            from_start = [from_start[0] + weight * p[0], from_start[1] + weight * p[1]];
        }
        self.equation.residual += factor * dot(line.left, from_start);
        for &(point, weight) in points {
            self.point(point, scaled(factor * weight, line.left));
        }
        self.point(self.drawing.ends(bar)[0], scaled(-factor, line.left));
        self.bar(bar, scaled(-factor * dot(line.along, from_start) / line.length, line.left));
    }

    /// A function of the angle from one bar to the other, given its derivative.
    fn turn(mut self, from: BarId, to: BarId, of_angle: impl Fn(f64) -> (f64, f64)) -> Equation {
        let (a, b) = (self.line(from), self.line(to));
        let angle = dot(a.left, b.along).atan2(dot(a.along, b.along));
        let (value, slope) = of_angle(angle);
        self.equation.is_length = false;
        self.equation.residual = value;
        self.bar(from, scaled(-slope / a.length, a.left));
        self.bar(to, scaled(slope / b.length, b.left));
        self.equation
    }

    fn plus(mut self, constant: f64) -> Equation {
        self.equation.residual += constant;
        self.equation
    }
}

impl Constraint {
    /// How many equations it is: two for a compound constraint.
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

    /// Its equations at the parameters `x` of a drawing: residuals and gradients.
    ///
    /// The gradient names every parameter that the equation depends on, also where the slope is zero at `x`.
    /// Cost: constant.
    ///
    /// # Panics
    /// When it names a part that the drawing does not have, or `x` is too short.
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
            Self::Angle { from, to, radians } => new.turn(from, to, |angle| (wrapped(angle - radians), 1.0)),
            Self::Parallel { a, b } => new.turn(a, b, |angle| (angle.sin(), angle.cos())),
            Self::Perpendicular { a, b } => new.turn(a, b, |angle| (angle.cos(), -angle.sin())),
            Self::Tangent { bar, circle, left } => {
                let side = if left { 1.0 } else { -1.0 };
                new.add_offset(&[(drawing.centre(circle), 1.0)], bar, side);
                new.add_radius(circle, -1.0);
                new.plus(0.0)
            }
            Self::TangentCircles { a, b, inside } => {
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
            Self::Symmetric { a, b, about } => {
                new.add_offset(&[(a, 0.5), (b, 0.5)], about, 1.0);
                return vec![new.plus(0.0), along(drawing, x, [a, b], about)];
            }
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

    /// The same constraint, with its dimension read from a drawing; none for a relation without one.
    ///
    /// Distances of zero and right or straight angles are relations: what they say is not a size.
    #[must_use]
    pub fn measured(&self, drawing: &ParametricDrawing, x: &[f64]) -> Option<Self> {
        let mut read = *self;
        let found = self.equations(drawing, x)[0].residual;
        match &mut read {
            Self::Distance { value, .. } | Self::PointLineDistance { value, .. } if *value == 0.0 => {
                return None;
            }
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

/// An angle brought between −π and π.
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(2.0 * PI) - PI
}

/// `b − a` along an axis.
fn difference(drawing: &ParametricDrawing, x: &[f64], [a, b]: [PointId; 2], axis: usize) -> Equation {
    let (i, j) = (drawing.coordinates(a)[axis], drawing.coordinates(b)[axis]);
    Equation { residual: x[j] - x[i], gradient: vec![(i, -1.0), (j, 1.0)], is_length: true }
}

fn coordinate(drawing: &ParametricDrawing, x: &[f64], point: PointId, axis: usize, value: f64) -> Equation {
    let parameter = drawing.coordinates(point)[axis];
    Equation { residual: x[parameter] - value, gradient: vec![(parameter, 1.0)], is_length: true }
}

/// `(b − a) · u` of a bar: how far two points are from lying straight across it.
fn along(drawing: &ParametricDrawing, x: &[f64], [a, b]: [PointId; 2], bar: BarId) -> Equation {
    let mut new = Builder::new(drawing, x);
    let line = new.line(bar);
    let across = new.between(a, b);
    new.equation.residual = dot(across, line.along);
    new.vector(a, b, line.along);
    new.bar(bar, scaled(dot(across, line.left) / line.length, line.left));
    new.equation
}
