//! Unresolved shape: shape smaller than the leaves, as a part of σ.
//!
//! A posterior covariance contains the noise of readings and the smoothness of the prior, but not the error
//! of a leaf that is too large for the shape. Limits of depth or coefficients, or an update over a fixed
//! hierarchy, cause such errors. Readings near each other then lie on the same side of the surface. Over the
//! bins `b` of a leaf
//!
//! ```text
//! Σ_b ((Σ w h)² − Σ (w h)²)/Σ w  =  m² Σ_b (Σ w − Σ w²/Σ w) − s² Σ_b (…)   on average,
//! ```
//!
//! where `m²` is the mean square of the unresolved shape and `s²` the surface's own variance, which the fit
//! has removed from the residuals. Products of one reading with itself do not occur, so the noise of the
//! readings need not be known. `m²` is reported if it is significant.
//!
//! Shape that is too weak for a leaf and its neighbours is estimated from all leaves, as a function of their
//! bending ([`super::misfit_by_bending`]).
//!
//! Not guaranteed: correlated errors of neighbouring readings (a scan's own bias, stereo near silhouettes)
//! cannot be separated from shape, and count as such.

use super::leaves::{is_piece, leaf_areas, neighbourhood, with_neighbours};
use super::misfit::{BINS, MAX_GROSS};
use super::misfit_by_bending::MisfitByBending;
use super::noise::SensorNoise;
use super::pair_sums::{LagSums, PairSums, pairs_by_distance, pairs_in_bins};
use super::rough_places::energy_density;
use crate::model::Posterior;
use crate::observe::Quantity;
use crate::observe::{Foot, FootChannels, FootState, by_leaf};
use planish_estimate::Result;
use planish_spline::Surface;
use rayon::prelude::*;
use serde::Serialize;

/// Significance in standard deviations of noise: of a single leaf, and of a leaf with its neighbours. Lower
/// values enlarge σ by chance on some of the thousands of leaves; higher ones miss shape that makes σ too
/// small. See decision 0008.
const SIGNIFICANT_ALONE: f64 = 4.0;
const SIGNIFICANT_TOGETHER: f64 = 3.0;
/// Readings of which pairs are looked at by their distance, about. More would only take longer.
const READINGS_BY_DISTANCE: usize = 100_000;

/// Shape smaller than the cells.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnresolvedShape {
    /// Root mean square along the normal, over the leaves that have any.
    pub rms: f64,
    /// Share of the surface's area with unresolved shape.
    pub area_fraction: f64,
}

impl UnresolvedShape {
    /// From mean squares and areas of the leaves; none if all are zero.
    pub(super) fn from_leaves(squares: &[f64], areas: &[f64]) -> Option<Self> {
        let unresolved = || squares.iter().zip(areas).filter(|(square, _)| **square > 0.0);
        let area: f64 = unresolved().map(|(_, area)| area).sum();
        (area > 0.0).then(|| Self {
            rms: (unresolved().map(|(square, area)| square * area).sum::<f64>() / area).sqrt(),
            area_fraction: area / areas.iter().sum::<f64>(),
        })
    }
}

/// Bins along each side of a leaf with so many readings: only pairs in one bin count, so that a few readings
/// share wider ones.
fn bins_per_side(readings: usize) -> usize {
    match readings {
        0..8 => 1,
        8..32 => 2,
        _ => BINS,
    }
}

/// For each leaf the mean square of its unresolved shape along the normal; 0 if none is significant.
pub(super) fn unresolved_shape(
    posterior: &Posterior<'_>,
    channels: &FootChannels<'_>,
    feet: &[Foot],
    information: &[f64],
    noise: &SensorNoise,
) -> Result<Vec<f64>> {
    let surface = posterior.surface();
    let leaves = surface.space().leaves().len();
    let (start, order) = by_leaf(feet, leaves);
    // A sample of the leaves shows what all have in common.
    let step = (feet.len() / READINGS_BY_DISTANCE).max(1);
    let areas = leaf_areas(surface);
    // Pairs in bins, and by their distance.
    let of_leaf = |leaf: usize| -> Result<(PairSums, LagSums)> {
        let near = || {
            let own = order[start[leaf] as usize..start[leaf + 1] as usize].iter().map(|&k| k as usize);
            // Gross errors near each other would count as shape.
            own.filter(|&k| {
                let foot = &feet[k];
                foot.state == FootState::Good
                    && foot.quantity == Quantity::Position
                    && channels.observations.readings.on_surface[channels.subset[k] as usize]
            })
        };
        let (mut inside, mut outside) = (0_usize, 0_usize);
        for k in near() {
            *(if information[k] > 0.0 { &mut inside } else { &mut outside }) += 1;
        }
        // Many readings beyond the gate are shape that the gate mistook for gross errors.
        let is_shape = outside as f64 > MAX_GROSS * (inside + outside) as f64;
        let count = if is_shape { inside + outside } else { inside };
        if count < 2 {
            return Ok(Default::default());
        }
        let covariance = posterior.leaf(leaf)?;
        let readings: Vec<(&Foot, f64)> = near()
            .filter(|&k| is_shape || information[k] > 0.0)
            .map(|k| (&feet[k], 1.0 / (noise.variance_factors[channels.channel(k)] * feet[k].variance)))
            .collect();
        let in_bins = pairs_in_bins(&readings, bins_per_side(count), &covariance);
        let by_distance = if leaf.is_multiple_of(step) {
            let spacing = (areas[leaf] / count as f64).sqrt();
            pairs_by_distance(&readings, surface, spacing, &covariance)
        } else {
            LagSums::default()
        };
        Ok((in_bins, by_distance))
    };
    // The sums of a leaf enter up to nine neighbourhoods, so they are made once.
    let sums: Vec<(PairSums, LagSums)> =
        (0..leaves).into_par_iter().with_min_len(64).map(of_leaf).collect::<Result<_>>()?;
    let local: Vec<Option<f64>> = (0..leaves)
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let mut together = PairSums::default();
            for other in neighbourhood(surface.space(), leaf) {
                together.add(&sums[other].0);
            }
            // The leaf alone comes first: the mean over its neighbours would make strong local shape too
            // small.
            (sums[leaf].0.significant(SIGNIFICANT_ALONE))
                .or_else(|| together.significant(SIGNIFICANT_TOGETHER))
        })
        .collect();
    // Shape below the significance of a neighbourhood, but common to the whole surface, as of a curve that
    // all cells are too large for. With a hundred readings a leaf it can exceed σ of the surface (decisions
    // 0096 and 0130).
    let bending = bending_of_leaves(surface, &areas);
    let rest = || (0..leaves).filter(|&leaf| local[leaf].is_none());
    let mut all = PairSums::default();
    rest().for_each(|leaf| all.add(&sums[leaf].0));
    // Bins have less noise than lines by distance, but miss shape as fine as the spacing of the readings.
    let everywhere = MisfitByBending::new(
        rest().map(|leaf| (bending[leaf], sums[leaf].1)),
        all.is_significant(SIGNIFICANT_TOGETHER),
        SIGNIFICANT_TOGETHER,
    );
    let is_measured: Vec<bool> = (0..leaves).map(|leaf| start[leaf] < start[leaf + 1]).collect();
    // Leaves far from readings show no shape; their σ is that of the prior.
    let is_near = with_neighbours(surface.space(), &is_measured);
    Ok((0..leaves)
        .map(|leaf| {
            let common = everywhere.as_ref().filter(|_| is_near[leaf]).map_or(0.0, |by| by.at(bending[leaf]));
            local[leaf].map_or(common, |own| own.max(common))
        })
        .collect())
}

/// For each leaf the bending of its cell, `∫ κ1² + κ2² dA`, by the mean density of its neighbourhood.
fn bending_of_leaves(surface: &Surface, areas: &[f64]) -> Vec<f64> {
    let space = surface.space();
    let density: Vec<f64> =
        (0..areas.len()).into_par_iter().with_min_len(64).map(|leaf| energy_density(surface, leaf)).collect();
    (0..areas.len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let (energy, area) = (neighbourhood(space, leaf).into_iter())
                .fold((0.0, 0.0), |(energy, area), k| (energy + areas[k] * density[k], area + areas[k]));
            // A cell at an extraordinary vertex has sixteen pieces.
            let of_cell = if is_piece(space, leaf) { 16.0 * areas[leaf] } else { areas[leaf] };
            if area > 0.0 { energy / area * of_cell } else { 0.0 }
        })
        .collect()
}
