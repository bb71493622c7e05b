//! Sizes in space with their σ: where a solid's vertices and edges come from in the views, and what is known
//! of those.

use super::ConsistentViews;
use crate::brep::{EdgeCurve, Solid};
use planish_contour::constraint::Place;
use planish_estimate::vector3::norm;
use serde::Serialize;

/// A vertex of the solid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpaceVertex {
    /// `V1` and so on.
    pub name: String,
    /// Where it is.
    pub position: [f64; 3],
    /// σ of its coordinates; none where no view shows the coordinate.
    pub sigma: [Option<f64>; 3],
    /// What the views show on its coordinates, such as `x of front P1`.
    pub seen_as: Vec<String>,
}

/// What sort of size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DimensionKind {
    /// How far the whole reaches along an axis.
    Extent,
    /// The length of a straight edge.
    Length,
    /// The diameter of a circular edge.
    Diameter,
}

/// A size of the solid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpaceDimension {
    /// What sort.
    pub kind: DimensionKind,
    /// `x`, `V1V2`, or where the circle is.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its standard deviation; none where no view shows what it depends on.
    pub sigma: Option<f64>,
}

/// Coordinates of a solid's vertices are those of the views within this share of the extent.
const COINCIDENT: f64 = 1e-6;

/// A linear function of the parameters.
type Gradient = Vec<(usize, f64)>;

impl ConsistentViews {
    /// The vertices of a solid that was made from [`Self::exact_views`].
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

    /// Extents, lengths of straight edges and diameters of circular ones of a solid that was made from
    /// [`Self::exact_views`], with their standard deviations `√(gᵀ P g)` under the joint covariance of all
    /// views.
    #[must_use]
    pub fn dimensions(&self, solid: &Solid) -> Vec<SpaceDimension> {
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
                EdgeCurve::Ellipse { center, a, b } if (norm(*a) - norm(*b)).abs() <= self.same() => {
                    let radius = norm(*a);
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

    fn length(&self, solid: &Solid, start: usize, end: usize) -> SpaceDimension {
        let (a, b) = (solid.vertices[start], solid.vertices[end]);
        let along: [f64; 3] = std::array::from_fn(|k| b[k] - a[k]);
        let length = along.iter().map(|d| d * d).sum::<f64>().sqrt();
        let (from, to) = (self.coordinates(a), self.coordinates(b));
        let mut terms = Vec::new();
        let mut known = true;
        for k in 0..3 {
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

    fn diameter(&self, center: [f64; 3], radius: f64) -> SpaceDimension {
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

    /// For each coordinate of a point, what the views show there.
    fn coordinates(&self, position: [f64; 3]) -> [Option<&Vec<Place>>; 3] {
        std::array::from_fn(|axis| {
            let near = self.levels[axis].iter().min_by(|a, b| {
                let off = |level: &super::AxisCoordinate| (level.value - position[axis]).abs();
                off(a).total_cmp(&off(b))
            });
            near.filter(|level| (level.value - position[axis]).abs() <= self.same())
                .map(|level| &level.places)
        })
    }

    fn same(&self) -> f64 {
        COINCIDENT * self.drawing.extent()
    }

    fn terms(&self, place: Place) -> Gradient {
        place.terms(&self.drawing)
    }

    fn sigma_of(&self, gradient: &Gradient) -> f64 {
        let products = gradient.iter().flat_map(|a| gradient.iter().map(move |b| (a, b)));
        let variance: f64 = products.map(|(&(i, a), &(j, b))| a * b * self.covariance[(i, j)]).sum();
        variance.max(0.0).sqrt()
    }
}

fn sum(terms: &[(f64, Gradient)]) -> Gradient {
    let scaled = terms.iter().map(|(factor, gradient)| (factor, gradient));
    scaled
        .flat_map(|(factor, gradient)| gradient.iter().map(move |&(i, slope)| (i, factor * slope)))
        .collect()
}
