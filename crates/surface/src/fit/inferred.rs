//! Readings that were concluded from others, and the error that they share.
//!
//! The copies that a symmetry makes all lie off where its axis lies off; their mean is no better known than
//! one of them. In an information matrix of independent readings they must weigh less. A thin plate of weight
//! `w` under readings of the variance `v`, `ρ` of them an area, leaves the variance
//! `∫ d²k/(2π)² / (ρ/v + w k⁴) = 1/(8 √(w ρ/v))` at a point. It is that of the shared error, `s²`, where
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

/// Gives feet of readings that were concluded from others the variance with which the surface is known as
/// well as one of them, no better.
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
            foot.variance = variance.own + variance.shared.max(spread);
        }
    }
}
