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
//! Not guaranteed: correlated errors of neighbouring readings (a scan's own bias, stereo near silhouettes)
//! cannot be separated from shape, and count as such.

use super::leaves::neighbourhood;
use super::misfit::{BINS, MAX_GROSS};
use super::noise::SensorNoise;
use crate::model::Posterior;
use crate::observe::Quantity;
use crate::observe::{Foot, FootChannels, FootState, by_leaf};
use planish_estimate::{Result, chi_square_deviation};
use rayon::prelude::*;
use serde::Serialize;

/// Significance in standard deviations of noise: of a single leaf, and of a leaf with its neighbours. Lower
/// values enlarge σ by chance on some of the thousands of leaves; higher ones miss shape that makes σ too
/// small. See decision 0008.
const SIGNIFICANT_ALONE: f64 = 4.0;
const SIGNIFICANT_TOGETHER: f64 = 3.0;

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

/// The sums of a leaf.
#[derive(Clone, Copy, Default)]
struct Shared {
    /// `Σ_b ((Σ w h)² − Σ (w h)²)/Σ w`.
    shape: f64,
    /// `Σ_b (Σ w − Σ w²/Σ w)`.
    precision: f64,
    /// Variance of `shape` under noise: `2 Σ_b (1 − 1/n_b)` for bins of `n_b` readings.
    spread: f64,
    /// Variance of the surface at the readings, times `precision`.
    of_surface: f64,
}

impl Shared {
    fn add(&mut self, other: &Self) {
        self.shape += other.shape;
        self.precision += other.precision;
        self.spread += other.spread;
        self.of_surface += other.of_surface;
    }

    /// `m²`, if it is significant.
    ///
    /// With `ν = spread/2` degrees of freedom, `shape + ν` is χ² under noise.
    fn mean_square(&self, significant: f64) -> Option<f64> {
        let shape = self.shape + self.of_surface;
        let degrees = 0.5 * self.spread;
        let deviation = chi_square_deviation(shape / degrees + 1.0, degrees);
        (self.spread > 0.0 && deviation > significant).then(|| shape / self.precision)
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
    let of_leaf = |leaf: usize| -> Result<Shared> {
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
        let side = bins_per_side(if is_shape { inside + outside } else { inside });
        let bin = |local: [f64; 2]| {
            let [i, j] = local.map(|x| ((x * side as f64) as usize).min(side - 1));
            j * BINS + i
        };
        // Σ w h, Σ (w h)², Σ w, Σ w² and the number of each bin.
        let mut bins = [[0.0; 5]; BINS * BINS];
        let (mut all, mut middle) = (0.0, [0.0; 2]);
        for k in near().filter(|&k| is_shape || information[k] > 0.0) {
            let foot = &feet[k];
            let w = 1.0 / (noise.variance_factors[channels.channel(k)] * foot.variance);
            let pull = w * foot.height();
            all += w;
            middle = [0, 1].map(|d| middle[d] + w * foot.local[d]);
            for (sum, term) in bins[bin(foot.local)].iter_mut().zip([pull, pull * pull, w, w * w, 1.0]) {
                *sum += term;
            }
        }
        let mut shared = Shared::default();
        for [sum, squares, precision, squared, count] in bins.into_iter().filter(|bin| bin[4] > 1.0) {
            shared.add(&Shared {
                shape: (sum * sum - squares) / precision,
                precision: precision - squared / precision,
                spread: 2.0 * (1.0 - 1.0 / count),
                of_surface: 0.0,
            });
        }
        if shared.precision > 0.0 {
            // Readings may lie in one corner of a leaf, so the variance is taken at their centre.
            let variance = posterior.variance_in(leaf, middle.map(|x| x / all))?;
            shared.of_surface = variance.max(0.0) * shared.precision;
        }
        Ok(shared)
    };
    // The sums of a leaf enter up to nine neighbourhoods, so they are made once.
    let sums: Vec<Shared> =
        (0..leaves).into_par_iter().with_min_len(64).map(of_leaf).collect::<Result<_>>()?;
    let local: Vec<Option<f64>> = (0..leaves)
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let mut together = Shared::default();
            for other in neighbourhood(surface.space(), leaf) {
                together.add(&sums[other]);
            }
            // The leaf alone comes first: the mean over its neighbours would make strong local shape too
            // small.
            (sums[leaf].mean_square(SIGNIFICANT_ALONE)).or_else(|| together.mean_square(SIGNIFICANT_TOGETHER))
        })
        .collect();
    // Shape below the significance of a neighbourhood, but common to the whole surface, as of a curve that
    // all cells are too large for. With a hundred readings a leaf it can exceed σ of the surface (decision
    // 0096).
    let mut rest = Shared::default();
    for (own, _) in sums.iter().zip(&local).filter(|(_, found)| found.is_none()) {
        rest.add(own);
    }
    let everywhere = rest.mean_square(SIGNIFICANT_TOGETHER).unwrap_or(0.0);
    // A leaf without readings shows no shape; its σ is that of the prior.
    Ok((local.into_iter().zip(&sums))
        .map(|(found, own)| found.unwrap_or(if own.precision > 0.0 { everywhere } else { 0.0 }))
        .collect())
}
