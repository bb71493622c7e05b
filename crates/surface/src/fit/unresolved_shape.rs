//! What the leaves leave out of the shape, as a part of σ.
//!
//! A posterior covariance knows the noise of readings and how smooth the prior holds surfaces to be, not that
//! a leaf is too large to follow them. Where a limit of depth or of coefficients, or an update over a fixed
//! hierarchy, leaves shape out, readings near each other lie on the same side of the surface. Over the bins
//! `b` of a leaf
//!
//! ```text
//! Σ_b ((Σ w h)² − Σ (w h)²)/Σ w  =  m² Σ_b (Σ w − Σ w²/Σ w) − s² Σ_b (…)   on average,
//! ```
//!
//! `m²` the mean square of what is left out, and `s²` the surface's own variance, which the fit has taken out
//! of the residuals. Products of one reading with itself do not occur, so the noise of the readings needs not
//! be known. `m²` is stated where it is more than noise makes.
//!
//! Not guaranteed: errors that readings near each other share (a scan's own bias, stereo near silhouettes)
//! cannot be told from shape, and count as such.

use super::leaves::neighbourhood;
use super::misfit::{BINS, MAX_GROSS, bin_of};
use super::noise::SensorNoise;
use crate::model::Posterior;
use crate::observe::Quantity;
use crate::observe::{Foot, FootChannels, FootState, by_leaf};
use planish_estimate::Result;
use rayon::prelude::*;
use serde::Serialize;

/// So many standard deviations of what noise makes, of a leaf alone, and of a leaf and those around it.
const SIGNIFICANT_ALONE: f64 = 4.0;
const SIGNIFICANT_TOGETHER: f64 = 3.0;

/// Shape that cells are too large to follow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnresolvedShape {
    /// Its root mean square along the normal, where there is any.
    pub rms: f64,
    /// The share of the surface's area where there is.
    pub area_fraction: f64,
}

impl UnresolvedShape {
    /// By the mean squares and areas of leaves.
    pub(super) fn from_leaves(squares: &[f64], areas: &[f64]) -> Option<Self> {
        let there = || squares.iter().zip(areas).filter(|(square, _)| **square > 0.0);
        let area: f64 = there().map(|(_, area)| area).sum();
        (area > 0.0).then(|| Self {
            rms: (there().map(|(square, area)| square * area).sum::<f64>() / area).sqrt(),
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
    /// Twice the number of pairs in the bins, in which a bin of n has n − 1 over n: the variance of `shape`
    /// under noise.
    spread: f64,
    /// The surface's own variance where the readings lie, times `precision`.
    of_surface: f64,
}

impl Shared {
    fn add(&mut self, other: &Self) {
        self.shape += other.shape;
        self.precision += other.precision;
        self.spread += other.spread;
        self.of_surface += other.of_surface;
    }

    /// `m²` where it is significant. With `ν = spread/2` degrees of freedom `shape + ν` is χ² under noise,
    /// far from normal for a few of them: the cube root of `χ²/ν` is normal with mean `1 − 2/9ν` and variance
    /// `2/9ν` (E. Wilson, M. Hilferty 1931).
    fn mean_square(&self, significant: f64) -> Option<f64> {
        let shape = self.shape + self.of_surface;
        let degrees = 0.5 * self.spread;
        let (mean, variance) = (1.0 - 2.0 / (9.0 * degrees), 2.0 / (9.0 * degrees));
        let normal = ((shape / degrees + 1.0).max(0.0).cbrt() - mean) / variance.sqrt();
        (self.spread > 0.0 && normal > significant).then(|| shape / self.precision)
    }
}

/// For each leaf the mean square of the shape that it leaves out along its normal, 0 where none is seen.
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
            own.filter(|&k| feet[k].state == FootState::Good && feet[k].quantity == Quantity::Position)
        };
        let (mut inside, mut outside) = (0_usize, 0_usize);
        for k in near() {
            *(if information[k] > 0.0 { &mut inside } else { &mut outside }) += 1;
        }
        let is_shape = outside as f64 > MAX_GROSS * (inside + outside) as f64;
        // Σ w h, Σ (w h)², Σ w, Σ w² and the number of each bin.
        let mut bins = [[0.0; 5]; BINS * BINS];
        let (mut all, mut middle) = (0.0, [0.0; 2]);
        for k in near().filter(|&k| is_shape || information[k] > 0.0) {
            let foot = &feet[k];
            let w = 1.0 / (noise.variance_factors[channels.channel(k)] * foot.variance);
            let pull = w * foot.height();
            all += w;
            middle = [0, 1].map(|d| middle[d] + w * foot.local[d]);
            for (sum, term) in bins[bin_of(foot.local)].iter_mut().zip([pull, pull * pull, w, w * w, 1.0]) {
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
            // Readings may lie in one corner of a leaf whose middle nobody saw.
            let variance = posterior.variance_in(leaf, middle.map(|x| x / all))?;
            shared.of_surface = variance.max(0.0) * shared.precision;
        }
        Ok(shared)
    };
    let sums: Vec<Shared> =
        (0..leaves).into_par_iter().with_min_len(64).map(of_leaf).collect::<Result<_>>()?;
    Ok((0..leaves)
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let mut together = Shared::default();
            for other in neighbourhood(surface.space(), leaf) {
                together.add(&sums[other]);
            }
            (sums[leaf].mean_square(SIGNIFICANT_ALONE))
                .or_else(|| together.mean_square(SIGNIFICANT_TOGETHER))
                .unwrap_or(0.0)
        })
        .collect())
}
