//! The sharp edges of a surface, and σ of their positions.

use super::posterior::Posterior;
use planish_core::DVec3;
use planish_estimate::Result;
use planish_spline::leaf_weights;
use serde::Serialize;

/// The creases of a surface: curves at which its normal jumps.
///
/// The position of a crease has a covariance across its tangent. σ is the root of the larger eigenvalue, at
/// the middle of each leaf along the crease.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CreaseSummary {
    /// Length of all creases.
    pub length: f64,
    /// Median σ of their positions, by length.
    pub sigma_median: f64,
    /// Largest σ.
    pub sigma_max: f64,
}

/// Parts of a leaf's side of which the length is the sum.
const PARTS: usize = 4;

impl CreaseSummary {
    /// The creases of a surface; none if it has none.
    ///
    /// # Errors
    /// As for [`Posterior::leaf`].
    pub(crate) fn of(posterior: &Posterior<'_>) -> Result<Option<Self>> {
        let surface = posterior.surface();
        let space = surface.space();
        if !space.has_creases() {
            return Ok(None);
        }
        let mut parts: Vec<(f64, f64)> = Vec::new();
        for leaf in 0..space.leaves().len() {
            for (axis, at_end) in [(0, false), (0, true), (1, false), (1, true)] {
                if !space.is_at_crease(leaf, axis, at_end) {
                    continue;
                }
                let place = |along: f64| {
                    let mut local = [along; 2];
                    local[axis] = f64::from(u8::from(at_end));
                    local
                };
                let points: Vec<DVec3> = (0..=PARTS)
                    .map(|k| place(k as f64 / PARTS as f64))
                    .map(|[s, t]| surface.leaf_point(leaf, s, t))
                    .collect();
                // Both sides of a crease have half of it.
                let length = 0.5 * points.windows(2).map(|pair| pair[0].distance(pair[1])).sum::<f64>();
                let middle = place(0.5);
                let jet = surface.leaf_jet(leaf, middle[0], middle[1]);
                let Some(normal) = jet.normal() else { continue };
                let across = normal.cross(if axis == 0 { jet.dv } else { jet.du }).normalize_or_zero();
                let covariance = posterior.leaf(leaf)?;
                let weights = leaf_weights(middle[0], middle[1]);
                let variance = |direction: DVec3| covariance.variance_along(&weights, direction);
                let [a, b, both] = [normal, across, normal + across].map(variance);
                let (mean, half, product) = (0.5 * (a + b), 0.5 * (a - b), 0.5 * (both - a - b));
                parts.push((length, (mean + half.hypot(product)).max(0.0).sqrt()));
            }
        }
        parts.sort_by(|a, b| a.1.total_cmp(&b.1));
        let length: f64 = parts.iter().map(|(own, _)| own).sum();
        let mut until = 0.0;
        let median = parts.iter().find(|(own, _)| {
            until += own;
            2.0 * until >= length
        });
        let largest = parts.last();
        Ok(median.zip(largest).map(|(median, largest)| Self {
            length,
            sigma_median: median.1,
            sigma_max: largest.1,
        }))
    }
}
