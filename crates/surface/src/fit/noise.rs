//! What the residuals say of the sensors: σ per sensor from gated readings, and whether it contradicts what
//! was stated.

use crate::observe::{FootState, Observations, ProjectedReadings, Quantity};
use planish_estimate::{Result, TruncatedNormal, gated_scale};

/// Stated σ are believed within this factor: real instruments are not specified more sharply.
const STATED_SIGMA_TOLERANCE: f64 = 1.1;

/// So many readings to spare can contradict a stated σ: if the fit leaves more than this share of them free.
const ENOUGH_TO_CONTRADICT: f64 = 20.0;
const MIN_REDUNDANCY: f64 = 0.2;

/// A variance over that stated that is rounding and no more.
const MIN_RELATIVE_VARIANCE: f64 = 1e-24;

/// The noise of every sensor as the fit knows it now.
#[derive(Debug, Clone)]
pub(super) struct SensorNoise {
    /// Variance as estimated over variance as stated (over one where none was stated).
    pub estimated_factors: Vec<f64>,
    /// Variance as used over variance as stated.
    pub variance_factors: Vec<f64>,
    /// Readings behind each estimate.
    pub count: Vec<usize>,
    /// Whether the estimate is used although σ was stated.
    pub is_contradicted: Vec<bool>,
    /// What the variance over that stated cannot well exceed: one where σ was stated, less where neighbouring
    /// points agree better.
    pub factor_bounds: Vec<f64>,
    /// Whether the surface follows the sensor's readings wherever they go, so that what they leave says
    /// nothing of their error.
    pub lacks_redundancy: Vec<bool>,
}

/// Variance of points about the planes of their neighbours, over that of their noise at most: neighbours may
/// err together.
const ROUGHNESS_TO_NOISE: f64 = 4.0;

impl SensorNoise {
    /// Nothing known yet: stated variances count as they are.
    pub(super) fn stated(observations: &Observations) -> Self {
        let channels = observations.stated.len();
        let factor_bounds: Vec<f64> = (0..channels)
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
        let variance_factors = (0..channels)
            .map(|channel| if observations.stated[channel] { factor_bounds[channel] } else { 0.0 })
            .collect();
        Self {
            estimated_factors: vec![1.0; channels],
            variance_factors,
            count: vec![0; channels],
            is_contradicted: vec![false; channels],
            factor_bounds,
            lacks_redundancy: vec![false; channels],
        }
    }

    /// Variance of the reading of foot `k`, as the fit uses it.
    pub(super) fn variance(&self, readings: ProjectedReadings<'_>, k: usize) -> f64 {
        self.variance_factors[readings.channel(k)] * readings.feet[k].variance
    }

    /// Goes back to what readings without a stated σ said before the surface heard of them, where it now
    /// follows them wherever they go: each round would weigh them more for the little that they leave,
    /// without end.
    pub(super) fn keep_where_redundancy_lacks(
        &mut self,
        observations: &Observations,
        before: &Self,
        degrees: &[f64],
    ) {
        for channel in 0..self.variance_factors.len() {
            let spare = self.count[channel] as f64 - degrees[channel];
            let lacks_redundancy = spare < MIN_REDUNDANCY * self.count[channel] as f64;
            if lacks_redundancy && !observations.stated[channel] && !observations.channels[channel].inferred {
                self.estimated_factors[channel] = before.estimated_factors[channel];
                self.variance_factors[channel] = before.variance_factors[channel];
                self.lacks_redundancy[channel] = true;
            }
        }
    }

    /// Estimates every sensor from residuals whose gate at `gate` σ is corrected for.
    ///
    /// `degrees` are the effective degrees of freedom that each sensor's readings determine: their χ² is
    /// smaller than their number by that. While `converged` is false the surface still misses shape, and every
    /// sensor counts as its residuals say, if worse than stated.
    pub(super) fn estimate(
        readings: ProjectedReadings<'_>,
        gate: f64,
        degrees: &[f64],
        converged: bool,
    ) -> Result<Self> {
        let ProjectedReadings { observations, subset, feet } = readings;
        let mut noise = Self::stated(observations);
        for channel in 0..observations.stated.len() {
            // What was concluded from readings says nothing of the sensor that took them.
            if observations.channels[channel].inferred {
                continue;
            }
            let least = match observations.channels[channel].quantity {
                Quantity::Position => observations.min_variance,
                // Of numbers that have no length, or one over it: what rounding leaves of any.
                Quantity::Normal | Quantity::Curvature => MIN_RELATIVE_VARIANCE,
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
                    noise.variance_factors[channel] = gated_scale(&all, gate)?.sigma.powi(2).max(least);
                    noise.estimated_factors[channel] = noise.variance_factors[channel];
                }
                if observations.stated[channel] {
                    noise.variance_factors[channel] = 1.0;
                }
                continue;
            }
            let scale = gated_scale(&normalised, gate)?;
            // Readings that the fit follows wherever they go say nothing of their error.
            let redundancy = 1.0 - degrees[channel] / scale.kept.max(1) as f64;
            let redundant = redundancy * scale.kept as f64;
            // Exact data leave residuals of rounding size; a variance of zero would leave nothing to weigh
            // with.
            noise.estimated_factors[channel] =
                (scale.sigma * scale.sigma / redundancy.max(MIN_REDUNDANCY)).max(least);
            let ratio = noise.estimated_factors[channel].sqrt();
            let standard_error = (0.5 / redundant.max(1.0)).sqrt() * ratio;
            // A surface follows errors that neighbours share: small residuals are then no proof that errors
            // are small.
            let may_be_smaller = !observations.correlated_errors[observations.channels[channel].sensor];
            let smaller = may_be_smaller && ratio < 1.0 / STATED_SIGMA_TOLERANCE - 3.0 * standard_error;
            let off = redundancy > MIN_REDUNDANCY
                && redundant > ENOUGH_TO_CONTRADICT
                && (ratio > STATED_SIGMA_TOLERANCE + 3.0 * standard_error || smaller);
            if !observations.stated[channel] {
                noise.variance_factors[channel] = noise.estimated_factors[channel];
            } else if !converged {
                noise.variance_factors[channel] =
                    noise.estimated_factors[channel].max(noise.factor_bounds[channel]);
            } else {
                noise.variance_factors[channel] = if off { noise.estimated_factors[channel] } else { 1.0 };
                noise.is_contradicted[channel] = off;
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
