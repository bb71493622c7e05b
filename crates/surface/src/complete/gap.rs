//! Report of a gap.

use planish_spline::Classification;
use serde::Serialize;

/// A gap in the measured part of a surface, and the simple shape around it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GapReport {
    /// `plane`, `sphere`, `cylinder`, or `none` if the readings around it have no such shape; the gap is then
    /// completed by the smoothness prior alone.
    pub kind: String,
    /// Probability of the shape, if it is one of the three.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// Radius and its σ, for a sphere or cylinder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius: Option<[f64; 2]>,
    /// σ of the shape's parameters: shift and tilts (radians) of a plane; centre and radius of a sphere;
    /// shifts and tilts of the axis and radius of a cylinder.
    pub sigma: Vec<f64>,
    /// Residual χ² of the readings around the gap over the degrees of freedom.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reduced_chi_square: Option<f64>,
    /// Area of the gap.
    pub area: f64,
    /// Readings around the gap that were used.
    pub readings: usize,
    /// Inferred readings.
    pub pseudo_readings: usize,
}

impl GapReport {
    pub(crate) fn new(
        found: Option<&Classification>,
        area: f64,
        readings: usize,
        pseudo_readings: usize,
    ) -> Self {
        let best = found.map(Classification::best);
        let sigma = best.map_or_else(Vec::new, planish_spline::FittedPrimitive::sigmas);
        let radius = best.and_then(|b| b.primitive.radius());
        Self {
            kind: best.map_or("none", |b| b.primitive.name()).to_owned(),
            // Accepted shapes are sorted, the most likely first. Without one, the prior alone completes the
            // gap.
            probability: found.and_then(|f| f.probabilities.first().copied()),
            // The radius is the last parameter of a sphere and of a cylinder: see `sigma`.
            radius: radius.zip(sigma.last().copied()).map(|(r, s)| [r, s]),
            reduced_chi_square: best.map(|b| b.chi_square / b.degrees),
            sigma,
            area,
            readings,
            pseudo_readings,
        }
    }
}
