//! Dimensions in space with σ.
//!
//! Vertices and edges of a solid are traced back to coordinates of the views, whose joint covariance is
//! known.

use super::ConsistentViews;
use crate::brep::{EdgeCurve, Solid};
use planish_contour::constraint::Place;
use planish_core::DVec3;
use serde::Serialize;

/// A vertex of the solid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpaceVertex {
    /// `V1` and so on.
    pub name: String,
    /// Position.
    pub position: DVec3,
    /// σ of each coordinate; `None` if no view shows the coordinate.
    pub sigma: [Option<f64>; 3],
    /// Points and circles of the views with these coordinates, such as `x of front P1`.
    pub seen_as: Vec<String>,
}

/// Kind of a dimension.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DimensionKind {
    /// Extent of the solid along an axis.
    Extent,
    /// Length of a straight edge.
    Length,
    /// Diameter of a circular edge.
    Diameter,
}

/// A dimension of the solid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpaceDimension {
    /// Kind.
    pub kind: DimensionKind,
    /// `x`, `V1V2`, or the name or position of the circle.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard deviation; `None` if no view shows a coordinate on which the dimension depends.
    pub sigma: Option<f64>,
}

/// Maximum difference between a coordinate of a solid and one of the views, relative to the extent.
///
/// The solid is built from exact views, so only rounding and snapping to a grid remain.
const COINCIDENT: f64 = 1e-6;

/// A linear function of the parameters: index and coefficient of each term.
type Gradient = Vec<(usize, f64)>;

impl ConsistentViews {
    /// The vertices of a solid made from [`Self::exact_views`], with σ of their coordinates.
    #[must_use]
    pub fn vertices(&self, solid: &Solid) -> Vec<SpaceVertex> {
        solid
            .vertices
            .iter()
            .enumerate()
            .map(|(i, &position)| {
                let places = self.coordinates(position);
                let seen = places.iter().flatten().flat_map(|places| places.iter());
                SpaceVertex {
                    name: format!("V{}", i + 1),
                    position,
                    sigma: places
                        .map(|places| places.map(|places| self.sigma_of(&places[0].terms(&self.drawing)))),
                    seen_as: seen.map(|place| place.describe(&self.drawing)).collect(),
                }
            })
            .collect()
    }

    /// Extents, lengths of straight edges and diameters of circular edges of a solid made from
    /// [`Self::exact_views`].
    ///
    /// Their standard deviation is `√(gᵀ P g)` with the gradient g and the joint covariance P of all views.
    /// Each diameter is listed once, although a hole has two circular edges.
    #[must_use]
    pub fn dimensions(&self, solid: &Solid) -> Vec<SpaceDimension> {
        // σ of an extent needs the covariance of both ends: common errors of a view cancel in the difference.
        let mut found = Vec::new();
        for (axis, levels) in self.levels.iter().enumerate() {
            if let (Some(low), Some(high)) = (levels.first(), levels.last()) {
                let gradient = sum(&[(1.0, self.terms(high.places[0])), (-1.0, self.terms(low.places[0]))]);
                found.push(SpaceDimension {
                    kind: DimensionKind::Extent,
                    name: ["x", "y", "z"][axis].to_owned(),
                    value: high.value - low.value,
                    sigma: Some(self.sigma_of(&gradient)),
                });
            }
        }
        for edge in &solid.edges {
            match &edge.curve {
                EdgeCurve::Line { .. } => found.push(self.length(solid, edge.start, edge.end)),
                EdgeCurve::Ellipse { center, a, b } if (a.length() - b.length()).abs() <= self.same() => {
                    let radius = a.length();
                    // Both ends of a hole, and several holes of one diameter, give one entry.
                    let known = found.iter().any(|d: &SpaceDimension| {
                        d.kind == DimensionKind::Diameter && (d.value - 2.0 * radius).abs() <= self.same()
                    });
                    if !known {
                        found.push(self.diameter(*center, radius));
                    }
                }
                _ => {}
            }
        }
        found
    }

    /// The length of an edge between two vertices.
    fn length(&self, solid: &Solid, start: usize, end: usize) -> SpaceDimension {
        let (a, b) = (solid.vertices[start], solid.vertices[end]);
        let along = b - a;
        let length = along.length();
        let (from, to) = (self.coordinates(a), self.coordinates(b));
        let mut terms = Vec::new();
        let mut known = true;
        for k in 0..3 {
            // The length has no first derivative along a coordinate without extent, so this need not be
            // known.
            let slope = along[k] / length;
            if along[k].abs() <= self.same() {
                continue;
            }
            match (&from[k], &to[k]) {
                (Some(from), Some(to)) => {
                    terms.extend([(slope, self.terms(to[0])), (-slope, self.terms(from[0]))]);
                }
                _ => known = false,
            }
        }
        SpaceDimension {
            kind: DimensionKind::Length,
            name: format!("V{}V{}", start + 1, end + 1),
            value: length,
            sigma: known.then(|| self.sigma_of(&sum(&terms))),
        }
    }

    /// The diameter of a circle. Its σ is that of a circle of the same radius in the drawing.
    fn diameter(&self, center: DVec3, radius: f64) -> SpaceDimension {
        let circle = self
            .drawing
            .circles()
            .find(|&circle| (self.drawing.radius(circle) - radius).abs() <= self.same());
        SpaceDimension {
            kind: DimensionKind::Diameter,
            name: circle.map_or_else(
                || format!("circle about {:.4} {:.4} {:.4}", center[0], center[1], center[2]),
                |circle| self.drawing.circle_name(circle).to_owned(),
            ),
            value: 2.0 * radius,
            sigma: circle.map(|circle| self.sigma_of(&vec![(self.drawing.radius_parameter(circle), 2.0)])),
        }
    }

    /// For each coordinate of a point, the places of the views that have this coordinate.
    fn coordinates(&self, position: DVec3) -> [Option<&Vec<Place>>; 3] {
        std::array::from_fn(|axis| {
            let near = self.levels[axis].iter().min_by(|a, b| {
                let off = |level: &super::AxisCoordinate| (level.value - position[axis]).abs();
                off(a).total_cmp(&off(b))
            });
            near.filter(|level| (level.value - position[axis]).abs() <= self.same())
                .map(|level| &level.places)
        })
    }

    /// Maximum difference of equal coordinates.
    fn same(&self) -> f64 {
        COINCIDENT * self.drawing.extent()
    }

    fn terms(&self, place: Place) -> Gradient {
        place.terms(&self.drawing)
    }

    /// `√(gᵀ P g)`. Rounding may make the variance of merged coordinates slightly negative.
    fn sigma_of(&self, gradient: &Gradient) -> f64 {
        let products = gradient.iter().flat_map(|a| gradient.iter().map(move |b| (a, b)));
        let variance: f64 = products.map(|(&(i, a), &(j, b))| a * b * self.covariance[(i, j)]).sum();
        variance.max(0.0).sqrt()
    }
}

/// Weighted sum of linear functions. Parameters may occur several times; `sigma_of` adds all products.
fn sum(terms: &[(f64, Gradient)]) -> Gradient {
    let scaled = terms.iter().map(|(factor, gradient)| (factor, gradient));
    scaled
        .flat_map(|(factor, gradient)| gradient.iter().map(move |&(i, slope)| (i, factor * slope)))
        .collect()
}
