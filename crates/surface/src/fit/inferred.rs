//! Inferred readings, and the error that they have in common.
//!
//! If the axis of a symmetry is wrong, all copies that it makes are wrong in the same way: their mean is no
//! better than one of them. An information matrix of independent readings must therefore give them less
//! weight. A thin plate of weight `w` under readings of variance `v` and density `ρ` has the variance `∫
//! d²k/(2π)² / (ρ/v + w k⁴) = 1/(8 √(w ρ/v))` at a point. This equals the variance `s²` of the common error
//! for
//!
//! ```text
//! v = 64 ρ w s⁴
//! ```
//!
//! Not guaranteed: σ of averages over areas, which stays too small.

use crate::observe::Observations;
use crate::observe::{Foot, FootState};
use planish_spline::Surface;
use std::collections::BTreeMap;

/// Enlarges the variances of inferred readings, so that the surface is known as well as from one of them
/// alone.
pub(super) fn share_errors(
    observations: &Observations,
    subset: &[u32],
    feet: &mut [Foot],
    surface: &Surface,
    weight: Option<f64>,
) {
    if !observations.channels.iter().any(|channel| channel.inferred) {
        return;
    }
    let inferred = |&i: &u32| observations.inferred(i as usize);
    let mut count: BTreeMap<u32, f64> = BTreeMap::new();
    for (i, foot) in subset.iter().zip(&*feet) {
        if foot.state == FootState::Good && inferred(i).is_some() {
            *count.entry(foot.leaf).or_default() += 1.0;
        }
    }
    let density: BTreeMap<u32, f64> = (count.into_iter())
        .map(|(leaf, n)| (leaf, n / surface.leaf_area(leaf as usize).max(f64::MIN_POSITIVE)))
        .collect();
    for (i, foot) in subset.iter().zip(feet) {
        if let (Some(variance), Some(weight)) = (inferred(i), weight) {
            let around = density.get(&foot.leaf).copied().unwrap_or(0.0);
            let spread = 64.0 * around * weight * variance.shared.powi(2);
            // Where copies are too sparse to be averaged, each still has the shared error.
            foot.variance = variance.own + variance.shared.max(spread);
        }
    }
}
