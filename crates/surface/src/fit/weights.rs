//! Weights of readings, and of the smoothness prior by the length over which it smooths.

use super::noise::SensorNoise;
use crate::observe::{Foot, FootState, ProjectedReadings, Quantity};

/// While the shape is still being found, readings farther than this many σ pull with bounded force.
///
/// A smaller bound slows the search, since most distant readings are shape that is still missing. A larger
/// one lets gross errors drag the surface along.
const BOUNDED_FROM_SIGMAS: f64 = 2.5;

/// The weight of the thin plate that smooths over `length`: information of positions per area times the
/// fourth power of the length, of normals times its square, of curvatures as it is.
pub(super) fn weight_of_length(feet: &[Foot], information: &[f64], area: f64, length: f64) -> f64 {
    (feet.iter().zip(information))
        .map(|(foot, &w)| smoothing_information(foot.quantity, w, length))
        .sum::<f64>()
        / area
}

/// Contribution of one reading to [`weight_of_length`], before the division by the area.
pub(super) fn smoothing_information(quantity: Quantity, information: f64, length: f64) -> f64 {
    information
        * match quantity {
            Quantity::Position => length.powi(4),
            Quantity::Normal => length.powi(2),
            Quantity::Curvature => 1.0,
        }
}

/// Information of every foot: one over its variance, and zero outside the gate.
///
/// While the shape is being found (`finding`), Huber's weights replace the gate. On ground the weights of
/// readings above the surface fall off faster, so that the sheet settles on the lower of two layers (Kraus &
/// Pfeifer 1998, *Determination of terrain models in wooded areas with airborne laser scanner data*; the form
/// of the fall is ours, in units of σ).
pub(super) fn weights(
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    gate: f64,
    finding: bool,
) -> Vec<f64> {
    weights_with_surface_variance(readings, noise, gate, finding, |_| 0.0)
}

/// [`weights`] where the surface itself is uncertain: its variance at each foot widens the gate.
pub(super) fn weights_with_surface_variance(
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    gate: f64,
    finding: bool,
    surface_variance: impl Fn(usize) -> f64,
) -> Vec<f64> {
    (readings.feet.iter().enumerate())
        .map(|(k, foot)| {
            if foot.state != FootState::Good {
                return 0.0;
            }
            let variance = noise.variance(readings, k);
            // The largest component decides: a mean over the components would let a correct one hide a
            // gross error.
            let r = foot.extremes().0 / (variance + surface_variance(k)).sqrt();
            if finding {
                let above = readings.observations.intake.ground
                    && foot.quantity == Quantity::Position
                    && foot.height() * foot.normal[2] > 0.0;
                let softened = match r / BOUNDED_FROM_SIGMAS {
                    far if far <= 1.0 => 1.0,
                    // What is left of objects on the ground lies above it: the farther, the less it pulls.
                    far if above => 1.0 / (1.0 + (far - 1.0).powi(2) * far),
                    // Bounded force: most distant readings are shape still to be found, not errors.
                    far => 1.0 / far,
                };
                softened / variance
            } else if r <= gate {
                1.0 / variance
            } else {
                0.0
            }
        })
        .collect()
}
