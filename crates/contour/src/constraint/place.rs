//! Coordinates of parts of a drawing: of points, and of the extremes of circles.
//!
//! In: a part and an axis. Out: the coordinate as a signed sum of parameters. A feature seen in two views has
//! such a coordinate in each; their equality is a constraint.

use super::drawing::{CircleId, Offset, ParametricDrawing, PointId};
use super::relation::Axis;
use serde::{Deserialize, Serialize};

/// A coordinate of a part of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(tag = "of", rename_all = "snake_case")]
pub enum Place {
    /// Coordinate of a point.
    Point {
        /// The point.
        point: PointId,
        /// The coordinate.
        axis: Axis,
    },
    /// Minimum or maximum coordinate of a circle: that of its centre minus or plus the radius.
    Extreme {
        /// The circle.
        circle: CircleId,
        /// The coordinate.
        axis: Axis,
        /// True for the maximum, false for the minimum.
        upper: bool,
    },
}

impl Place {
    /// Indices of its parameters, each with a factor of 1 or −1.
    #[must_use]
    pub fn terms(self, drawing: &ParametricDrawing) -> Vec<(usize, f64)> {
        match self {
            Self::Point { point, axis } => vec![(drawing.coordinates(point)[axis as usize], 1.0)],
            // Linear in centre and radius, so that equal extremes of two views are linear constraints.
            Self::Extreme { circle, axis, upper } => vec![
                (drawing.coordinates(drawing.centre(circle))[axis as usize], 1.0),
                (drawing.radius_parameter(circle), if upper { 1.0 } else { -1.0 }),
            ],
        }
    }

    /// Value at the parameters `x`.
    #[must_use]
    pub fn value(self, drawing: &ParametricDrawing, x: &[f64]) -> f64 {
        self.terms(drawing).iter().map(|&(i, factor)| factor * x[i]).sum()
    }

    /// In words, such as `x of P1` or `largest y of circle 2`.
    #[must_use]
    pub fn describe(self, drawing: &ParametricDrawing) -> String {
        let letter = |axis| if axis == Axis::X { 'x' } else { 'y' };
        match self {
            Self::Point { point, axis } => format!("{} of {}", letter(axis), drawing.point_name(point)),
            Self::Extreme { circle, axis, upper } => format!(
                "{} {} of {}",
                if upper { "largest" } else { "least" },
                letter(axis),
                drawing.circle_name(circle)
            ),
        }
    }

    /// The same coordinate after its drawing was appended to another.
    pub(super) fn shifted(self, offset: Offset) -> Self {
        match self {
            Self::Point { point, axis } => Self::Point { point: offset.point(point), axis },
            Self::Extreme { circle, axis, upper } => {
                Self::Extreme { circle: offset.circle(circle), axis, upper }
            }
        }
    }
}
