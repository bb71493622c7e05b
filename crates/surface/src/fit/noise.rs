//! What the residuals say of the sensors: σ per sensor from gated readings, and whether it contradicts what
//! was stated.

use crate::observe::{Foot, FootState};
use crate::observe::{Observations, Quantity};
use planish_estimate::{Result, TruncatedNormal, gated_scale};

/// Stated σ are believed within this factor: real instruments are not specified more sharply.
const BELIEVED: f64 = 1.1;

/// So many readings to spare can contradict a stated σ: if the fit leaves more than this share of them free.
const ENOUGH_TO_CONTRADICT: f64 = 20.0;
const LEAST_REDUNDANCY: f64 = 0.2;

/// A variance over that stated that is rounding and no more.
const LEAST_RELATIVE_VARIANCE: f64 = 1e-24;

/// The noise of every sensor as the fit knows it now.
#[derive(Debug, Clone)]
pub(super) struct SensorNoise {
    /// Variance as estimated over variance as stated (over one where none was stated).
    pub estimated: Vec<f64>,
    /// Variance as used over variance as stated.
    pub used: Vec<f64>,
    /// Readings behind each estimate.
    pub count: Vec<usize>,
    /// Whether the estimate is used although σ was stated.
    pub contradicted: Vec<bool>,
    /// What the variance over that stated cannot well exceed: one where σ was stated, less where neighbouring
    /// points agree better.
    pub most: Vec<f64>,
    /// Whether the surface follows the sensor's readings wherever they go, so that what they leave says
    /// nothing of their error.
    pub followed: Vec<bool>,
}

/// Variance of points about the planes of their neighbours, over that of their noise at most: neighbours may
/// err together.
const ROUGHNESS_TO_NOISE: f64 = 4.0;

impl SensorNoise {
    /// Nothing known yet: stated variances count as they are.
    pub(super) fn stated(observations: &Observations) -> Self {
        let channels = observations.stated.len();
        let most: Vec<f64> = (0..channels)
            .map(|channel| {
                let bound = observations
                    .roughness
                    .get(channel)
                    .copied()
                    .flatten()
                    .map_or(f64::INFINITY, |r| ROUGHNESS_TO_NOISE * r);
                if observations.stated[channel] { bound.min(1.0) } else { bound }
            })
            .collect();
        // An unstated σ is unknown: until it is estimated, nothing may be made of it (no lift is taken off).
        let used = (0..channels)
            .map(|channel| if observations.stated[channel] { most[channel] } else { 0.0 })
            .collect();
        Self {
            estimated: vec![1.0; channels],
            used,
            count: vec![0; channels],
            contradicted: vec![false; channels],
            most,
            followed: vec![false; channels],
        }
    }

    /// Goes back to what readings without a stated σ said before the surface heard of them, where it now
    /// follows them wherever they go: each round would weigh them more for the little that they leave,
    /// without end.
    pub(super) fn keep_where_followed(
        &mut self,
        observations: &Observations,
        before: &Self,
        degrees: &[f64],
    ) {
        for channel in 0..self.used.len() {
            let spare = self.count[channel] as f64 - degrees[channel];
            let is_followed = spare < LEAST_REDUNDANCY * self.count[channel] as f64;
            if is_followed && !observations.stated[channel] && !observations.channels[channel].invented {
                self.estimated[channel] = before.estimated[channel];
                self.used[channel] = before.used[channel];
                self.followed[channel] = true;
            }
        }
    }

    /// Estimates every sensor from residuals whose gate at `gate` σ is corrected for.
    ///
    /// `degrees` are the effective degrees of freedom that each sensor's readings determine: their χ² is
    /// smaller than their number by that. While `settled` is false the surface still misses shape, and every
    /// sensor counts as its residuals say, if worse than stated.
    pub(super) fn estimate(
        observations: &Observations,
        subset: &[u32],
        feet: &[Foot],
        gate: f64,
        degrees: &[f64],
        settled: bool,
    ) -> Result<Self> {
        let mut noise = Self::stated(observations);
        for channel in 0..observations.stated.len() {
            // What was concluded from readings says nothing of the sensor that took them.
            if observations.channels[channel].invented {
                continue;
            }
            let least = match observations.channels[channel].quantity {
                Quantity::Position => observations.least_variance,
                // Of numbers that have no length, or one over it: what rounding leaves of any.
                Quantity::Normal | Quantity::Curvature => LEAST_RELATIVE_VARIANCE,
            };
            let normalised: Vec<f64> = subset
                .iter()
                .zip(feet)
                .filter(|(i, foot)| {
                    foot.state == FootState::Good && observations.channel(**i as usize) == channel
                })
                .flat_map(|(_, foot)| foot.residuals().iter().map(|r| r / foot.variance.sqrt()))
                .collect();
            noise.count[channel] = normalised.len();
            if normalised.len() < 8 {
                if !observations.stated[channel] && !normalised.is_empty() {
                    // Too few for a scale of their own: the scale of all readings stands in.
                    let quantity = observations.channels[channel].quantity;
                    let all: Vec<f64> = feet
                        .iter()
                        .filter(|f| f.state == FootState::Good && f.quantity == quantity)
                        .flat_map(|f| f.residuals().iter().copied())
                        .collect();
                    noise.used[channel] = gated_scale(&all, gate)?.sigma.powi(2).max(least);
                    noise.estimated[channel] = noise.used[channel];
                }
                if observations.stated[channel] {
                    noise.used[channel] = 1.0;
                }
                continue;
            }
            let scale = gated_scale(&normalised, gate)?;
            // Readings that the fit follows wherever they go say nothing of their error.
            let redundancy = 1.0 - degrees[channel] / scale.kept.max(1) as f64;
            let redundant = redundancy * scale.kept as f64;
            // Exact data leave residuals of rounding size; a variance of zero would leave nothing to weigh
            // with.
            noise.estimated[channel] =
                (scale.sigma * scale.sigma / redundancy.max(LEAST_REDUNDANCY)).max(least);
            let ratio = noise.estimated[channel].sqrt();
            let standard_error = (0.5 / redundant.max(1.0)).sqrt() * ratio;
            // A surface follows errors that neighbours share: small residuals are then no proof that errors
            // are small.
            let may_be_smaller = !observations.err_together[observations.channels[channel].sensor];
            let smaller = may_be_smaller && ratio < 1.0 / BELIEVED - 3.0 * standard_error;
            let off = redundancy > LEAST_REDUNDANCY
                && redundant > ENOUGH_TO_CONTRADICT
                && (ratio > BELIEVED + 3.0 * standard_error || smaller);
            if !observations.stated[channel] {
                noise.used[channel] = noise.estimated[channel];
            } else if !settled {
                noise.used[channel] = noise.estimated[channel].max(noise.most[channel]);
            } else {
                noise.used[channel] = if off { noise.estimated[channel] } else { 1.0 };
                noise.contradicted[channel] = off;
            }
        }
        Ok(noise)
    }
}

/// What the residuals of one sensor's readings sum up to.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ResidualSums {
    /// Readings.
    pub count: usize,
    /// `Σ r²`.
    pub square: f64,
    /// `Σ w r²`.
    pub weighted: f64,
    /// The sum of their stated variances.
    pub variance: f64,
}

impl ResidualSums {
    pub(super) fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.square += other.square;
        self.weighted += other.weighted;
        self.variance += other.variance;
    }
}

/// The variance that a gate leaves, over the whole.
pub(super) fn kept_variance(gate: f64) -> Result<f64> {
    Ok(TruncatedNormal::new(gate)?.variance_ratio())
}
