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

/// What readings far from the surface weigh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Weighting {
    /// Zero outside the gate: the information of a model.
    Gated,
    /// While the shape is being found, Huber's weights replace the gate.
    Bounded,
    /// The same, but where most readings of a leaf are on one side of the surface, the force is bounded from
    /// their median distance on.
    BoundedByLeaf,
    /// While the surface converges: gated, but where the surface does not follow its readings, Huber's
    /// weights replace the variance of the misfit within the gate. That variance weakened the readings of
    /// small tips so much that the thin plate flattened them, which enlarged the misfit in turn (decision
    /// 0124).
    BoundedWithinGate,
}

/// Information of every foot: one over its variance, and less for readings far from the surface.
///
/// The force of readings beyond [`BOUNDED_FROM_SIGMAS`] is bounded where weights are Huber's. On ground, the
/// weights of readings above the surface fall off faster, so that the sheet settles on the lower of two
/// layers (Kraus & Pfeifer 1998, *Determination of terrain models in wooded areas with airborne laser
/// scanner data*; the form of the fall is ours, in units of σ).
pub(super) fn weights(
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    gate: f64,
    weighting: Weighting,
) -> Vec<f64> {
    weights_with_surface_variance(readings, noise, gate, weighting, |_| 0.0)
}

/// [`weights`] where the surface itself is uncertain: its variance at each foot widens the gate.
pub(super) fn weights_with_surface_variance(
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    gate: f64,
    weighting: Weighting,
    surface_variance: impl Fn(usize) -> f64,
) -> Vec<f64> {
    let finding = matches!(weighting, Weighting::Bounded | Weighting::BoundedByLeaf);
    // What is left of objects on the ground is common to the readings of a leaf as well.
    let has_common = weighting == Weighting::BoundedByLeaf && !readings.observations.intake.ground;
    let common = if has_common { common_distances(readings, noise) } else { Vec::new() };
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
                if weighting == Weighting::BoundedWithinGate && misfit > 0.0 {
                    let own = variance - misfit;
                    (BOUNDED_FROM_SIGMAS * own.sqrt() / foot.extremes().0).min(1.0) / own
                } else {
                    1.0 / variance
                }
            }
        })
        .collect()
}

/// For each leaf, how far the surface is from most of its readings of positions, in σ: the size of the median
/// of their signed distances. Gross errors lie on both sides of a surface; shape that it has lost does not.
fn common_distances(readings: ProjectedReadings<'_>, noise: &SensorNoise) -> Vec<f64> {
    let leaves = readings.feet.iter().map(|foot| foot.leaf as usize + 1).max().unwrap_or(0);
    let mut distances: Vec<Vec<f64>> = vec![Vec::new(); leaves];
    for (k, foot) in readings.feet.iter().enumerate() {
        if foot.state == FootState::Good && foot.quantity == Quantity::Position {
            distances[foot.leaf as usize].push(foot.height() / noise.variance(readings, k).sqrt());
        }
    }
    distances.iter_mut().map(|own| common_distance(own)).collect()
}

/// The size of the median of signed distances; 0 for so few that it may be that of gross errors.
fn common_distance(distances: &mut [f64]) -> f64 {
    let middle = distances.len() / 2;
    match distances.len() >= MIN_COMMON {
        true => distances.select_nth_unstable_by(middle, f64::total_cmp).1.abs(),
        false => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Otherwise readings of a small tip would lose to the thin plate, or gross errors drag the surface
    /// along.
    #[test]
    fn readings_on_one_side_of_the_surface_are_shape_and_few_others_are_not() {
        assert_eq!(common_distance(&mut [19.0, 21.0, 20.0, -1.0, 22.0, 20.5]), 20.5);
        assert_eq!(common_distance(&mut [0.4, -90.0, -0.3, 80.0, 0.1]), 0.1);
        assert_eq!(common_distance(&mut [20.0, 21.0]), 0.0);
    }
}
