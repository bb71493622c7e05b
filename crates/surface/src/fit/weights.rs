//! Weights of readings, and of the smoothness prior by the length over which it smooths.

use super::noise::SensorNoise;
use crate::observe::{Foot, FootState, ProjectedReadings, Quantity};

/// While the shape is still being found, readings farther than this many σ pull with bounded force.
///
/// A smaller bound slows the search, since most distant readings are shape that is still missing. A larger
/// one lets gross errors drag the surface along.
const BOUNDED_FROM_SIGMAS: f64 = 2.5;

/// Readings of a leaf of which the median is no chance of few gross errors.
const MIN_COMMON: usize = 5;

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

/// What readings far from the surface weigh. `areas` are those of the leaves: a surface that is farther from
/// readings than the side of its leaf lacks the part that they lie on, and would fold if it were pulled there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Weighting<'a> {
    /// Zero outside the gate: the information of a model.
    Gated,
    /// While the shape is being found, Huber's weights replace the gate. Where most readings of a leaf are on
    /// one side of the surface, the force is bounded from their median distance on.
    Bounded { areas: &'a [f64] },
    /// While the surface converges: gated, but where the surface does not follow its readings, Huber's weights
    /// replace the variance of the misfit within the gate. That variance weakened the readings of small tips so
    /// much that the thin plate flattened them, which enlarged the misfit in turn (decision 0123).
    BoundedWithinGate { areas: &'a [f64] },
}

/// Information of every foot: one over its variance, and less for readings far from the surface.
///
/// The force of readings beyond [`BOUNDED_FROM_SIGMAS`] is bounded where weights are Huber's. On ground, the
/// weights of readings above the surface fall off faster, so that the sheet settles on the lower of two layers
/// (Kraus & Pfeifer 1998, *Determination of terrain models in wooded areas with airborne laser scanner data*;
/// the form of the fall is ours, in units of σ).
pub(super) fn weights(
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    gate: f64,
    weighting: Weighting<'_>,
) -> Vec<f64> {
    weights_with_surface_variance(readings, noise, gate, weighting, |_| 0.0)
}

/// [`weights`] where the surface itself is uncertain: its variance at each foot widens the gate.
pub(super) fn weights_with_surface_variance(
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    gate: f64,
    weighting: Weighting<'_>,
    surface_variance: impl Fn(usize) -> f64,
) -> Vec<f64> {
    let finding = matches!(weighting, Weighting::Bounded { .. });
    // What is left of objects on the ground is common to the readings of a leaf as well.
    let common = match weighting {
        Weighting::Bounded { areas } if !readings.observations.intake.ground => {
            common_distances(readings, noise, areas)
        }
        _ => Vec::new(),
    };
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
                let common = common.get(foot.leaf as usize).copied().unwrap_or(0.0);
                let softened = match r / (BOUNDED_FROM_SIGMAS + common) {
                    far if far <= 1.0 => 1.0,
                    // What is left of objects on the ground lies above it: the farther, the less it pulls.
                    far if above => 1.0 / (1.0 + (far - 1.0).powi(2) * far),
                    // Bounded force: most distant readings are shape still to be found, not errors.
                    far => 1.0 / far,
                };
                softened / variance
            } else if r > gate {
                0.0
            } else {
                let misfit = noise.misfit_variance(foot);
                match weighting {
                    Weighting::BoundedWithinGate { areas } if is_near(foot, misfit.sqrt(), areas) => {
                        let own = variance - misfit;
                        bounded(foot.extremes().0 / own.sqrt(), misfit) / own
                    }
                    _ => 1.0 / variance,
                }
            }
        })
        .collect()
}

/// Huber's weight of a distance in σ; 1 without misfit.
fn bounded(distance: f64, misfit: f64) -> f64 {
    if misfit > 0.0 { (BOUNDED_FROM_SIGMAS / distance).min(1.0) } else { 1.0 }
}

/// True if a distance from the surface is at most the side of the leaf of a foot.
fn is_near(foot: &Foot, distance: f64, areas: &[f64]) -> bool {
    areas.get(foot.leaf as usize).is_some_and(|area| distance * distance <= *area)
}

/// For each leaf, how far the surface is from most of its readings of positions, in σ: the size of the median
/// of their signed distances, if it is near them. Gross errors lie on both sides of a surface; shape that it
/// has lost does not.
fn common_distances(readings: ProjectedReadings<'_>, noise: &SensorNoise, areas: &[f64]) -> Vec<f64> {
    let mut heights: Vec<Vec<f64>> = vec![Vec::new(); areas.len()];
    let mut variances = vec![0.0; areas.len()];
    for (k, foot) in readings.feet.iter().enumerate() {
        let leaf = foot.leaf as usize;
        if foot.state == FootState::Good && foot.quantity == Quantity::Position && leaf < areas.len() {
            heights[leaf].push(foot.height());
            variances[leaf] += noise.variance(readings, k);
        }
    }
    let distance = |(leaf, own): (usize, &mut Vec<f64>)| {
        let middle = own.len() / 2;
        if own.len() < MIN_COMMON {
            return 0.0;
        }
        let median = own.select_nth_unstable_by(middle, f64::total_cmp).1.abs();
        if median * median > areas[leaf] {
            return 0.0;
        }
        median / (variances[leaf] / own.len() as f64).sqrt()
    };
    heights.iter_mut().enumerate().map(distance).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forces_are_bounded_only_where_the_surface_misses_its_readings() {
        assert_eq!(bounded(3.5, 0.0), 1.0);
        assert_eq!(bounded(1.0, 0.2), 1.0);
        assert_eq!(bounded(10.0, 0.2), 0.25);
    }
}
