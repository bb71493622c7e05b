//! Coordinates that parts of a drawing reach: of points, and of circles where these end.
//!
//! Comes in: a part and an axis. Goes out: the coordinate as a sum of parameters. What is seen from two sides
//! has such coordinates in both views.

use super::drawing::{CircleId, Offset, ParametricDrawing, PointId};
use super::relation::Axis;
use serde::{Deserialize, Serialize};

/// A coordinate of something in a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(tag = "of", rename_all = "snake_case")]
pub enum Place {
    /// That of a point.
    Point {
        /// The point.
        point: PointId,
        /// Which coordinate.
        axis: Axis,
    },
    /// How far a circle reaches: its centre's coordinate, less or plus its radius.
    Extreme {
        /// The circle.
        circle: CircleId,
        /// Which coordinate.
        axis: Axis,
        /// Whether the largest, else the least.
        upper: bool,
    },
}

impl Place {
    /// Its parameters, each with a factor of one or minus one.
    #[must_use]
    pub fn terms(self, drawing: &ParametricDrawing) -> Vec<(usize, f64)> {
        match self {
            Self::Point { point, axis } => vec![(drawing.coordinates(point)[axis as usize], 1.0)],
            Self::Extreme { circle, axis, upper } => vec![
                (drawing.coordinates(drawing.centre(circle))[axis as usize], 1.0),
                (drawing.radius_parameter(circle), if upper { 1.0 } else { -1.0 }),
            ],
        }
    }

    /// Its value.
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

    pub(super) fn shifted(self, offset: Offset) -> Self {
        match self {
            Self::Point { point, axis } => Self::Point { point: offset.point(point), axis },
            Self::Extreme { circle, axis, upper } => {
                Self::Extreme { circle: offset.circle(circle), axis, upper }
            }
        }
    }
}
