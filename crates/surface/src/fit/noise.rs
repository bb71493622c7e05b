//! Noise of the sensors: σ of each channel from its gated residuals, and whether it contradicts the stated σ.
//!
//! Variances are handled as factors on the stated variance of each reading, so that σ may differ from reading
//! to reading. A channel without a stated σ has stated variance 1.

use super::shared_errors::MAX_OVERSTATEMENT;
use crate::observe::{Channel, Foot, FootState, ProjectedReadings, Quantity};
use planish_estimate::{Result, TruncatedNormal, gated_scale, gated_scale_over_background};

/// Largest ratio of estimated to stated σ, or the inverse, that is not a contradiction.
///
/// Instruments are rarely specified more sharply. A smaller tolerance reports correct sensors as wrong; a
/// larger one misses wrong ones. See decision 0009.
pub(super) const STATED_SIGMA_TOLERANCE: f64 = 1.1;

/// Redundant readings needed to contradict a stated σ. The standard error of an estimate from 20 is 16 %.
pub(super) const MIN_FOR_CONTRADICTION: f64 = 20.0;
/// Ratio of the quartiles of the stated variances from which a misfit is no evidence against all of them.
const UNEVEN_VARIANCES: f64 = 100.0;
/// Smallest share of redundant readings from which noise can be estimated. With less, the surface follows its
/// readings and their residuals carry no information about σ. See decision 0009.
pub(super) const MIN_REDUNDANCY: f64 = 0.2;
/// Minimum number of components from which the scale of a channel is estimated on its own.
///
/// The standard error of σ from 8 components is 25 %; below that, the scale of all readings of the quantity
/// is safer.
const MIN_FOR_SCALE: usize = 8;

/// Largest scale of the differences to wide neighbourhoods over a stated σ that are errors and not shape. The
/// differences contain some shape when shared errors are complete in them.
const MAX_SHARED_SIGMA: f64 = 1.3;

/// Variance of rounding, over the stated variance, for quantities that are not lengths.
const MIN_RELATIVE_VARIANCE: f64 = 1e-24;

/// How residuals determine the noise.
#[derive(Debug, Clone, Copy)]
pub(super) struct NoiseRules {
    /// Readings farther from the surface than this many σ are rejected.
    pub gate: f64,
    /// True if residuals smaller than a stated σ lower it.
    pub may_lower: bool,
}

/// The noise of every channel at one stage of a fit.
#[derive(Debug, Clone)]
pub(super) struct SensorNoise {
    /// Estimated variance over stated variance (over 1 if none was stated).
    pub estimated_factors: Vec<f64>,
    /// Variance that the fit uses, over stated variance.
    pub variance_factors: Vec<f64>,
    /// Number of components behind each estimate.
    pub count: Vec<usize>,
    /// True if the estimate is used although σ was stated.
    pub is_contradicted: Vec<bool>,
    /// Share of the stated variance that neighbouring readings have in common: see
    /// [`super::shared_errors`].
    pub shared_share: Vec<f64>,
    /// For each leaf the variance of its positions beyond that of the sensors, where the surface does not
    /// follow them: see [`super::local_misfit`]. Empty while the shape is being found.
    pub local_variance: Vec<f64>,
    /// Plausible upper bound of the variance over that stated: 1 if σ was stated, less if neighbouring points
    /// agree better.
    pub factor_bounds: Vec<f64>,
    /// True if the fit has too few redundant readings of this channel to estimate its noise.
    ///
    /// A flexible surface can pass through a small number of readings exactly. Their residuals are then close
    /// to zero and carry no information about σ, so the previous estimate is kept.
    pub lacks_redundancy: Vec<bool>,
}

/// Factor on the variance of points about the planes of their neighbours, for an upper bound of their noise.
/// It allows for errors that neighbours share, which those planes do not show. See decision 0009.
const ROUGHNESS_TO_NOISE: f64 = 4.0;

impl SensorNoise {
    /// The noise as stated, before any estimate.
    pub(super) fn stated(channels: &[Channel]) -> Self {
        let count = channels.len();
        let factor_bounds: Vec<f64> = (channels.iter())
            .map(|channel| {
                let bound = channel.roughness.map_or(f64::INFINITY, |r| ROUGHNESS_TO_NOISE * r);
                if channel.stated { bound.min(1.0) } else { bound }
            })
            .collect();
        // An unstated σ is unknown: until it is estimated, no lift by tangential noise is subtracted.
        let variance_factors = (channels.iter().zip(&factor_bounds))
            .map(|(channel, bound)| if channel.stated { *bound } else { 0.0 })
            .collect();
        Self {
            estimated_factors: vec![1.0; count],
            variance_factors,
            count: vec![0; count],
            is_contradicted: vec![false; count],
            shared_share: vec![0.0; count],
            local_variance: Vec::new(),
            factor_bounds,
            lacks_redundancy: vec![false; count],
        }
    }

    /// Variance of the reading of foot `k`, as the fit uses it.
    pub(super) fn variance(&self, readings: ProjectedReadings<'_>, k: usize) -> f64 {
        self.of_foot(readings.channel(k), &readings.feet[k])
    }

    /// Variance of a reading of `channel` with this foot, as the fit uses it.
    pub(super) fn of_foot(&self, channel: usize, foot: &Foot) -> f64 {
        self.variance_factors[channel] * foot.variance + self.misfit_variance(foot)
    }

    /// The part of the variance that the surface's misfit around the foot of a position has.
    pub(super) fn misfit_variance(&self, foot: &Foot) -> f64 {
        match foot.quantity {
            Quantity::Position => self.local_variance.get(foot.leaf as usize).copied().unwrap_or(0.0),
            Quantity::Normal | Quantity::Curvature => 0.0,
        }
    }

    /// Keeps the noise from before an update for channels without a stated σ that lack redundancy.
    ///
    /// The surface follows their readings. Each iteration would weigh them more for their small residuals,
    /// without end.
    pub(super) fn keep_where_redundancy_lacks(
        &mut self,
        channels: &[Channel],
        before: &Self,
        degrees: &[f64],
    ) {
        for channel in 0..self.variance_factors.len() {
            let spare = self.count[channel] as f64 - degrees[channel];
            let lacks_redundancy = spare < MIN_REDUNDANCY * self.count[channel] as f64;
            if lacks_redundancy && !channels[channel].stated && !channels[channel].inferred {
                self.estimated_factors[channel] = before.estimated_factors[channel];
                self.variance_factors[channel] = before.variance_factors[channel];
                self.lacks_redundancy[channel] = true;
            }
        }
    }

    /// Estimates every channel from its residuals, with a correction for the gate.
    ///
    /// Residuals larger than a stated σ contradict it if the differences of neighbours do, too: the surface
    /// may not follow the shape. Smaller residuals do not, because the surface follows errors that neighbours
    /// share: a stated σ is lowered only if `rules` permit it.
    ///
    /// `degrees` are the effective degrees of freedom that each channel's readings determine; their χ² is
    /// smaller by that number. Before convergence the surface still misses shape, so a channel whose
    /// residuals are larger than stated is weighed by its residuals.
    ///
    /// # Errors
    /// `Input` for a gate out of range.
    pub(super) fn estimate(
        readings: ProjectedReadings<'_>,
        rules: NoiseRules,
        degrees: &[f64],
        converged: bool,
    ) -> Result<Self> {
        let ProjectedReadings { observations, subset, feet } = readings;
        let NoiseRules { gate, may_lower } = rules;
        let mut noise = Self::stated(&observations.channels);
        for channel in 0..observations.channels.len() {
            // Inferred readings carry no information about the noise of sensors.
            if observations.channels[channel].inferred {
                continue;
            }
            let min_variance = match observations.channels[channel].quantity {
                Quantity::Position if observations.channels[channel].stated => observations.min_variance,
                Quantity::Position => observations.min_variance.max(observations.rounding_variance),
                // These have other units than lengths.
                Quantity::Normal | Quantity::Curvature => MIN_RELATIVE_VARIANCE,
            };
            let own: Vec<&Foot> = (subset.iter().zip(feet))
                .filter(|(i, foot)| {
                    foot.state == FootState::Good && observations.channel(**i as usize) == channel
                })
                .map(|(_, foot)| foot)
                .collect();
            // Residuals in stated σ, so that readings of one sensor may have different σ.
            let least = least_judged_variance(&own);
            let normalised: Vec<f64> = (own.iter().filter(|foot| foot.variance >= least))
                .flat_map(|foot| foot.residuals().iter().map(|r| r / foot.variance.sqrt()))
                .collect();
            noise.count[channel] = normalised.len();
            if normalised.len() < MIN_FOR_SCALE {
                if !observations.channels[channel].stated && !normalised.is_empty() {
                    // Too few for a scale of their own: use the scale of all readings of the quantity.
                    let quantity = observations.channels[channel].quantity;
                    let all: Vec<f64> = feet
                        .iter()
                        .filter(|f| f.state == FootState::Good && f.quantity == quantity)
                        .flat_map(|f| f.residuals().iter().copied())
                        .collect();
                    noise.variance_factors[channel] =
                        gated_scale(&all, gate)?.sigma.powi(2).max(min_variance);
                    noise.estimated_factors[channel] = noise.variance_factors[channel];
                }
                if observations.channels[channel].stated {
                    noise.variance_factors[channel] = 1.0;
                }
                continue;
            }
            let scale = gated_scale_over_background(&normalised, gate)?;
            // Residuals are smaller than the errors of the readings, by the degrees of freedom that these
            // determine.
            // Where only less certain readings are judged, the others have determined the surface.
            let used = if least > 0.0 { 0.0 } else { degrees[channel] };
            let redundancy = 1.0 - used / scale.kept.max(1) as f64;
            // Exact data leave residuals of rounding size. A variance of zero would make weights infinite.
            let factor = (scale.sigma * scale.sigma / redundancy.max(MIN_REDUNDANCY)).max(min_variance);
            let residuals = ResidualScale { factor, redundancy, kept: scale.kept, min_variance };
            noise.judge(&observations.channels[channel], channel, residuals, may_lower, converged);
        }
        Ok(noise)
    }

    /// Decides between the stated σ of a channel, that of its residuals and that by neighbours.
    fn judge(
        &mut self,
        of: &Channel,
        channel: usize,
        residuals: ResidualScale,
        may_lower: bool,
        converged: bool,
    ) {
        let ResidualScale { factor, redundancy, kept, min_variance } = residuals;
        if !converged {
            self.estimated_factors[channel] = factor;
            self.variance_factors[channel] =
                if of.stated { factor.max(self.factor_bounds[channel]) } else { factor };
            return;
        }
        let neighbours = of.independent_noise();
        // Residuals larger than neighbours allow contain shape that the surface does not follow. Where
        // quadrics give no estimate, the scatter about planes is the bound of a stated σ.
        let factor = match neighbours {
            Some(found) => {
                let upper = found.shared.map_or(found.upper, |shared| shared.sigma.max(found.upper));
                let largest = STATED_SIGMA_TOLERANCE + 3.0 * found.standard_error;
                if factor.sqrt() <= largest * upper { factor } else { upper * upper }
            }
            None if of.stated => {
                let bound = of.roughness.map_or(f64::INFINITY, |roughness| ROUGHNESS_TO_NOISE * roughness);
                factor.min(bound.max(1.0))
            }
            None => factor,
        };
        let factor = factor.max(min_variance);
        self.estimated_factors[channel] = factor;
        if !of.stated {
            self.variance_factors[channel] = factor;
            return;
        }
        let redundant = redundancy * kept as f64;
        let ratio = factor.sqrt();
        // An estimated σ of n redundant readings has the relative standard error 1/√(2n).
        let standard_error = (0.5 / redundant.max(1.0)).sqrt() * ratio;
        // The surface follows errors that neighbours share, so small residuals do not prove small errors.
        let may_be_smaller = may_lower && !of.correlated_errors;
        let is_determined = redundancy > MIN_REDUNDANCY && redundant > MIN_FOR_CONTRADICTION;
        let smaller = ratio < 1.0 / STATED_SIGMA_TOLERANCE - 3.0 * standard_error;
        let confirmed = neighbours.is_none_or(|found| {
            found.lower - 3.0 * found.standard_error * found.upper > STATED_SIGMA_TOLERANCE
        });
        let larger = confirmed && ratio > STATED_SIGMA_TOLERANCE + 3.0 * standard_error;
        let off = is_determined && (larger || may_be_smaller && smaller);
        let far_smaller = MAX_OVERSTATEMENT * (ratio + 3.0 * standard_error) < 1.0;
        // Differences that grow with the neighbourhood up to the stated σ are errors that neighbours share.
        let shared = of.neighbour_noise.and_then(|found| found.shared);
        let are_shared = shared.is_some_and(|found| found.sigma <= MAX_SHARED_SIGMA)
            && STATED_SIGMA_TOLERANCE * (ratio + 3.0 * standard_error) < 1.0;
        if is_determined && !off && (far_smaller || are_shared) {
            self.shared_share[channel] = 1.0 - factor;
        }
        self.variance_factors[channel] = if off { factor } else { 1.0 };
        self.is_contradicted[channel] = off;
    }
}

/// The variance from which readings show whether their σ is misstated; 0 if all do.
///
/// A surface misses shape by the same distance at readings of any σ. Of readings whose σ spans decades, the
/// most certain half shows nothing else; a wrong factor of σ shows in the other half as well.
fn least_judged_variance(feet: &[&Foot]) -> f64 {
    let mut variances: Vec<f64> = feet.iter().map(|foot| foot.variance).collect();
    if variances.len() < MIN_FOR_CONTRADICTION as usize {
        return 0.0;
    }
    let mut quantile = |quarters: usize| {
        let at = quarters * (variances.len() - 1) / 4;
        *variances.select_nth_unstable_by(at, f64::total_cmp).1
    };
    let [low, middle, high] = [1, 2, 3].map(&mut quantile);
    if high > UNEVEN_VARIANCES * low { middle } else { 0.0 }
}

/// The scale of a channel's residuals.
#[derive(Clone, Copy)]
struct ResidualScale {
    /// Variance over the stated variance, corrected for the gate and the degrees of freedom.
    factor: f64,
    /// Share of the residuals that the surface did not use up.
    redundancy: f64,
    /// Residuals within the gate.
    kept: usize,
    /// Smallest factor, by rounding.
    min_variance: f64,
}

/// Sums over the residuals of one sensor's readings.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ResidualSums {
    /// Number of readings.
    pub count: usize,
    /// `Σ r²`.
    pub square: f64,
    /// `Σ w r²`.
    pub weighted: f64,
    /// Sum of the stated variances.
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

/// The share of a normal variable's variance that a gate leaves.
pub(super) fn kept_variance(gate: f64) -> Result<f64> {
    Ok(TruncatedNormal::new(gate)?.variance_ratio())
}
