//! Robust losses, and estimates of scale that are robust to outliers and corrected for gates.
//!
//! Input: *normalised residuals* `r = (measured − predicted) / σ`, in standard deviations and never squared;
//! or plain residuals of one group. Output: losses, weights and scales that are consistent for Gaussian data.
//! Not guaranteed: a breakdown point above one half; a good result of a gate or a redescending loss from a
//! poor start.

mod student_t;

pub use student_t::StudentTScale;

use crate::{Error, Result, Termination};
use statrs::distribution::{Continuous, ContinuousCDF, Normal};
use statrs::function::gamma::ln_gamma;

/// The loss `ρ(r)` of a *normalised residual* `r`; close to `r²/2` for small `r`.
///
/// All functions take the residual in standard deviations, of either sign, not its square. For a measurement
/// of several equations `r` is the length `√(vᵀR⁻¹v)`. Laws: `ρ(0) = 0`, `ρ' = ψ`, `w = ψ/r`, `ψ` odd. Cost:
/// constant.
///
/// # Examples
/// ```
/// use planish_estimate::Loss;
///
/// let loss = Loss::huber();
/// assert_eq!(loss.weight(1.0), 1.0); // one standard deviation: full weight
/// assert_eq!(loss.weight(13.45), 0.1); // ten thresholds: a tenth of the weight
/// assert!((loss.efficiency()? - 0.95).abs() < 1e-3);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Huber, Ronchetti, *Robust statistics*, 2009, chapter 4; Holland, Welsch, *Robust regression using
/// iteratively reweighted least-squares*, 1977.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// `ρ = r²/2`.
    Gaussian,
    /// `ρ = r²/2` within the threshold, linear beyond: convex, bounded influence.
    Huber {
        /// The residual beyond which the influence is constant, in standard deviations.
        threshold: f64,
    },
    /// `ρ = (c²/2) ln(1 + (r/c)²)`: the influence falls as `1/r`.
    Cauchy {
        /// `c`, the residual of weight one half, in standard deviations.
        scale: f64,
    },
    /// `ρ = (c²/6) (1 − (1 − (r/c)²)³)` within the threshold, constant beyond: distant outliers have no
    /// influence.
    Tukey {
        /// `c`, beyond which readings have zero weight, in standard deviations.
        threshold: f64,
    },
    /// `ρ = ((ν+1)/2) ln(1 + r²/ν)`: the negative log-density of Student's t. Its weight at zero is
    /// `(ν+1)/ν`, not one.
    StudentT {
        /// `ν`, the degrees of freedom.
        degrees: f64,
    },
}

/// Moments of a loss for Gaussian data. They determine the covariance of the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LossMoments {
    /// `E[ψ²] / d`: the variance of one equation's score.
    pub influence_squared: f64,
    /// `E[ψ' / d + (1 − 1/d) ψ/r]`: the slope of one equation's mean score; `E[ψ']` for one equation.
    pub slope: f64,
    /// `E[w]`: the mean weight.
    pub weight: f64,
}

impl Loss {
    /// Huber's loss with 95 % efficiency for Gaussian data (threshold 1.345).
    #[must_use]
    pub fn huber() -> Self {
        Self::Huber { threshold: 1.345 }
    }

    /// Cauchy's loss with 95 % efficiency for Gaussian data (scale 2.3849).
    #[must_use]
    pub fn cauchy() -> Self {
        Self::Cauchy { scale: 2.3849 }
    }

    /// Tukey's loss with 95 % efficiency for Gaussian data (threshold 4.6851).
    #[must_use]
    pub fn tukey() -> Self {
        Self::Tukey { threshold: 4.6851 }
    }

    /// Checks that the constant is positive and finite.
    ///
    /// # Errors
    /// `Input` when it is not.
    pub fn validate(&self) -> Result<()> {
        let constant = match *self {
            Self::Gaussian => 1.0,
            Self::Huber { threshold } | Self::Tukey { threshold } => threshold,
            Self::Cauchy { scale } => scale,
            Self::StudentT { degrees } => degrees,
        };
        if constant > 0.0 && constant.is_finite() {
            Ok(())
        } else {
            Err(Error::input(format!("the constant of a robust loss must be positive and finite: {self:?}")))
        }
    }

    /// `ρ(r)`: the loss of a normalised residual.
    #[must_use]
    pub fn rho(&self, normalized_residual: f64) -> f64 {
        let r = normalized_residual.abs();
        match *self {
            Self::Gaussian => 0.5 * r * r,
            Self::Huber { threshold } if r <= threshold => 0.5 * r * r,
            Self::Huber { threshold } => threshold * (r - 0.5 * threshold),
            // `ln_1p` keeps the digits of small residuals, where `ln(1 + q)` would round `q` away.
            Self::Cauchy { scale } => 0.5 * scale * scale * (r / scale).powi(2).ln_1p(),
            Self::Tukey { threshold } => {
                let inside = (1.0 - (r / threshold).powi(2)).max(0.0);
                threshold * threshold / 6.0 * (1.0 - inside.powi(3))
            }
            Self::StudentT { degrees } => 0.5 * (degrees + 1.0) * (r * r / degrees).ln_1p(),
        }
    }

    /// `ψ(r) = ρ'(r)`: the influence of a normalised residual.
    #[must_use]
    pub fn psi(&self, normalized_residual: f64) -> f64 {
        normalized_residual * self.weight(normalized_residual)
    }

    /// `ψ'(r)`: the derivative of the influence.
    #[must_use]
    pub fn psi_slope(&self, normalized_residual: f64) -> f64 {
        let squared = normalized_residual * normalized_residual;
        match *self {
            Self::Gaussian => 1.0,
            Self::Huber { threshold } => f64::from(squared <= threshold * threshold),
            Self::Cauchy { scale } => {
                let q = squared / (scale * scale);
                (1.0 - q) / (1.0 + q).powi(2)
            }
            Self::Tukey { threshold } => {
                let q = squared / (threshold * threshold);
                if q < 1.0 { (1.0 - q) * (1.0 - 5.0 * q) } else { 0.0 }
            }
            Self::StudentT { degrees } => (degrees + 1.0) * (degrees - squared) / (degrees + squared).powi(2),
        }
    }

    /// `w(r) = ψ(r)/r`: the factor on the information of a reading in reweighted least squares.
    #[must_use]
    pub fn weight(&self, normalized_residual: f64) -> f64 {
        let r = normalized_residual.abs();
        match *self {
            Self::Gaussian => 1.0,
            Self::Huber { threshold } if r <= threshold => 1.0,
            Self::Huber { threshold } => threshold / r,
            Self::Cauchy { scale } => 1.0 / (1.0 + (r / scale).powi(2)),
            Self::Tukey { threshold } => (1.0 - (r / threshold).powi(2)).max(0.0).powi(2),
            Self::StudentT { degrees } => (degrees + 1.0) / (degrees + r * r),
        }
    }

    /// Expectations over Gaussian data for measurements of `equations` equations each, with `r² ~ χ²` of as
    /// many degrees of freedom.
    ///
    /// The covariance of an M-estimate is `(influence_squared / slope²) (Σ HᵀWH)⁻¹`. Cost: 4000 evaluations.
    ///
    /// # Errors
    /// `Input` when the constant is not positive, there are no equations, or the loss is so narrow that the
    /// slope is not positive.
    ///
    /// # References
    /// Huber, Ronchetti, *Robust statistics*, 2009, chapter 7 (asymptotic covariance of M-estimates).
    pub fn moments(&self, equations: usize) -> Result<LossMoments> {
        self.validate()?;
        if equations == 0 {
            return Err(Error::input("expected at least one equation of a measurement"));
        }
        let d = equations as f64;
        // The density of r is concentrated within a few units of √d; beyond √d + 12 it is below e⁻⁷².
        let far = d.sqrt() + 12.0;
        // Simpson's rule converges fast only where the integrand is smooth, so the range is split where it is
        // not.
        let kink = match *self {
            Self::Huber { threshold } | Self::Tukey { threshold } => threshold.min(far),
            _ => far,
        };
        let log_norm = (1.0 - 0.5 * d) * std::f64::consts::LN_2 - ln_gamma(0.5 * d);
        // In logarithms, because powers and Γ overflow for many equations. One equation needs its own case: 0
        // · ln 0 is NaN.
        let density = |r: f64| match equations {
            1 => (log_norm - 0.5 * r * r).exp(),
            _ => (log_norm + (d - 1.0) * r.ln() - 0.5 * r * r).exp(),
        };
        let mut moments = LossMoments { influence_squared: 0.0, slope: 0.0, weight: 0.0 };
        let slope_at = |r: f64, inside: bool| match *self {
            // The slope jumps at the kink, so each side is integrated with its own value.
            Self::Huber { .. } => f64::from(inside),
            _ => self.psi_slope(r),
        };
        for (low, high, inside) in [(0.0, kink, true), (kink, far, false)] {
            let intervals = 2000;
            let spacing = (high - low) / f64::from(intervals);
            for i in 0..=intervals {
                let r = low + spacing * f64::from(i);
                let simpson = if i == 0 || i == intervals { 1.0 } else { f64::from(2 + 2 * (i % 2)) };
                let share = simpson * spacing / 3.0 * density(r);
                let weight = self.weight(r);
                moments.influence_squared += share * (r * weight).powi(2) / d;
                moments.slope += share * (slope_at(r, inside) / d + (1.0 - 1.0 / d) * weight);
                moments.weight += share * weight;
            }
        }
        if moments.slope > 0.0 {
            Ok(moments)
        } else {
            Err(Error::input(format!(
                "{self:?} is too narrow: it rejects most inliers of {equations} equations"
            )))
        }
    }

    /// The efficiency for Gaussian data, `E[ψ']² / E[ψ²]`: 1 for the Gaussian loss, less for all others.
    ///
    /// # Errors
    /// As [`Self::moments`].
    pub fn efficiency(&self) -> Result<f64> {
        let moments = self.moments(1)?;
        Ok(moments.slope * moments.slope / moments.influence_squared)
    }
}

/// The factor that turns `(Σ HᵀWH)⁻¹` into the covariance of an M-estimate: `mean ψ² / (mean ψ')²` over the
/// residuals.
///
/// Assumes independent residuals of one equation each, including outliers, and many more residuals than
/// unknowns. Prefer [`Loss::moments`] for data known to be Gaussian. Cost: `n`.
///
/// # Errors
/// `Input` when the loss is invalid; `Undetermined` when there are no residuals or the mean slope is not
/// positive.
///
/// # Examples
/// ```
/// use planish_estimate::{Loss, sandwich_factor};
///
/// // With a Gaussian loss the factor is the mean square: the stated σ is too small by a factor of 2.
/// assert_eq!(sandwich_factor(&Loss::Gaussian, &[2.0, -2.0, 2.0, -2.0])?, 4.0);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Huber, Ronchetti, *Robust statistics*, 2009, section 7.6.
pub fn sandwich_factor(loss: &Loss, normalized_residuals: &[f64]) -> Result<f64> {
    loss.validate()?;
    let n = normalized_residuals.len() as f64;
    let influence: f64 = normalized_residuals.iter().map(|&r| loss.psi(r).powi(2)).sum();
    let slope: f64 = normalized_residuals.iter().map(|&r| loss.psi_slope(r)).sum();
    if slope > 0.0 {
        Ok(influence * n / (slope * slope))
    } else {
        Err(Error::undetermined(
            "the robust loss gives zero weight to most residuals: the covariance is undetermined",
        ))
    }
}

/// A Gaussian truncated by a gate at ±k standard deviations.
///
/// `c(k) = 1 − 2 k φ(k) / (2 Φ(k) − 1)` is the variance inside the gate divided by the full variance. A scale
/// estimated from gated residuals is too small by `√c(k)`: 0.989 at k = 3, 0.880 at k = 2.
///
/// # Examples
/// ```
/// use planish_estimate::TruncatedNormal;
///
/// let gate = TruncatedNormal::new(2.0)?;
/// assert!((gate.variance_ratio() - 0.7737).abs() < 1e-4);
/// assert!((gate.share_kept() - 0.9545).abs() < 1e-4);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Johnson, Kotz, Balakrishnan, *Continuous univariate distributions*, volume 1, 1994, section 13.10.1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruncatedNormal {
    gate: f64,
    variance_ratio: f64,
    share_kept: f64,
}

impl TruncatedNormal {
    /// The gate `|r| ≤ k`, in true standard deviations.
    ///
    /// # Errors
    /// `Input` when `k` is not positive. Infinity means no gate.
    pub fn new(gate: f64) -> Result<Self> {
        if gate.is_nan() || gate <= 0.0 {
            return Err(Error::input(format!("expected a gate > 0 in standard deviations, found {gate}")));
        }
        let normal = Normal::standard();
        let share_kept = 1.0 - 2.0 * normal.sf(gate);
        let variance_ratio = if gate < 1e-2 {
            // Series, because the closed form loses its digits to cancellation.
            gate * gate / 3.0 * (1.0 - 2.0 * gate * gate / 15.0)
        } else if gate.is_finite() {
            1.0 - 2.0 * gate * normal.pdf(gate) / share_kept
        } else {
            1.0
        };
        Ok(Self { gate, variance_ratio, share_kept })
    }

    /// The gate `k` in standard deviations.
    #[must_use]
    pub fn gate(&self) -> f64 {
        self.gate
    }

    /// `c(k)`: variance inside the gate divided by the full variance.
    #[must_use]
    pub fn variance_ratio(&self) -> f64 {
        self.variance_ratio
    }

    /// `2 Φ(k) − 1`: the fraction inside the gate.
    #[must_use]
    pub fn share_kept(&self) -> f64 {
        self.share_kept
    }

    /// The full standard deviation, from that of residuals inside a gate at `k` *true* standard deviations.
    #[must_use]
    pub fn corrected_sigma(&self, sigma_of_gated: f64) -> f64 {
        sigma_of_gated / self.variance_ratio.sqrt()
    }
}

/// The scale of residuals about their median: `1.4826 · median |r − median r|`.
///
/// Estimates σ of Gaussian data in the unit of the residuals. Up to half of the data may be outliers. Cost:
/// `n`.
///
/// # Errors
/// `Undetermined` when there are no residuals, `Input` when one is not finite.
///
/// # References
/// Hampel, *The influence curve and its role in robust estimation*, 1974.
///
/// # Examples
/// ```
/// use planish_estimate::median_absolute_deviation;
///
/// let residuals = [-1.0, 0.0, 1.0, 2.0, 1000.0];
/// assert!((median_absolute_deviation(&residuals)? - 1.4826).abs() < 1e-4);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn median_absolute_deviation(residuals: &[f64]) -> Result<f64> {
    let middle = median(residuals.to_vec())?;
    median_magnitude(residuals.iter().map(|r| r - middle))
}

/// The scale of residuals about zero: `1.4826 · median |r|`.
///
/// # Errors
/// As [`median_absolute_deviation`].
pub fn median_magnitude_scale(residuals: &[f64]) -> Result<f64> {
    median_magnitude(residuals.iter().copied())
}

fn median_magnitude(residuals: impl Iterator<Item = f64>) -> Result<f64> {
    // 1 / Φ⁻¹(3/4)
    Ok(1.482_602_218_505_602 * median(residuals.map(f64::abs).collect())?)
}

fn median(mut values: Vec<f64>) -> Result<f64> {
    if values.is_empty() {
        return Err(Error::undetermined("expected at least one residual for a scale"));
    }
    require_finite(&values)?;
    let half = values.len() / 2;
    let even = values.len().is_multiple_of(2);
    let (below, upper, _) = values.select_nth_unstable_by(half, f64::total_cmp);
    let lower = if even { below.iter().copied().fold(f64::NEG_INFINITY, f64::max) } else { *upper };
    Ok(0.5 * (lower + *upper))
}

fn require_finite(values: &[f64]) -> Result<()> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(i) => Err(Error::input(format!("residual {i}: expected a finite number"))),
        None => Ok(()),
    }
}

/// Result of [`gated_scale`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GatedScale {
    /// σ, corrected for the gate; same unit as the residuals.
    pub sigma: f64,
    /// Number of residuals inside the gate.
    pub kept: usize,
    /// Number of rounds.
    pub iterations: usize,
    /// Whether the gate converged.
    pub termination: Termination,
}

/// Estimates σ about zero from the residuals within ±k σ, iterated until gate and scale agree.
///
/// `σ² = mean(r² : |r| ≤ k σ) / c(k)` with `c` of [`TruncatedNormal`]: the true σ of Gaussian data is the
/// fixed point. The iteration starts from the median of magnitudes and is monotone, so it ends. Cost: `n` per
/// round, about ten rounds.
///
/// # Errors
/// `Undetermined` when there are no residuals; `Input` when one is not finite or the gate is below 1.
///
/// # Examples
/// ```
/// use planish_estimate::gated_scale;
///
/// // σ = 1 with alternating residuals of ±0.5 and ±1.3, and one gross outlier.
/// let mut residuals: Vec<f64> = (0..100)
///     .map(|i| if i % 4 < 2 { 0.5 } else { 1.3 } * if i % 2 == 0 { 1.0 } else { -1.0 })
///     .collect();
/// residuals.push(1e6);
/// let scale = gated_scale(&residuals, 3.0)?;
/// assert_eq!(scale.kept, 100);
/// assert!((scale.sigma - 1.0).abs() < 0.02);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn gated_scale(residuals: &[f64], gate: f64) -> Result<GatedScale> {
    // The median is of the order of the true scale even if nearly half of the residuals are outliers. A gate
    // of root mean squares would contain these outliers.
    gated_scale_from(residuals, gate, median_magnitude_scale(residuals)?)
}

/// [`gated_scale`] from a given first scale, for data of which more than half may be contaminated.
///
/// # Errors
/// As [`gated_scale`].
pub fn gated_scale_from(residuals: &[f64], gate: f64, first: f64) -> Result<GatedScale> {
    // In a narrow gate the density is nearly constant, so that every σ is nearly a fixed point.
    if gate.is_nan() || gate < 1.0 {
        return Err(Error::input(format!(
            "a gate of {gate} standard deviations is too narrow to estimate a scale: use at least 1"
        )));
    }
    let truncated = TruncatedNormal::new(gate)?;
    let mut sigma = first;
    let limit = 200;
    for iterations in 1..=limit {
        // The set inside the gate changes in discrete steps, so the iteration ends exactly, not
        // asymptotically.
        let bound = gate * sigma;
        let (mut kept, mut sum) = (0_usize, 0.0);
        for r in residuals.iter().filter(|r| r.abs() <= bound) {
            kept += 1;
            sum += r * r;
        }
        let next = truncated.corrected_sigma((sum / kept.max(1) as f64).sqrt());
        let converged = (next - sigma).abs() <= 1e-12 * sigma;
        sigma = next;
        if converged || iterations == limit {
            let termination = if converged { Termination::Converged } else { Termination::Limit };
            return Ok(GatedScale { sigma, kept, iterations, termination });
        }
    }
    unreachable!("the last round returns")
}

/// Fewer residuals show no density of a background.
const MIN_FOR_BACKGROUND: usize = 100;

/// [`gated_scale`] of residuals of which some are spread evenly, as gross errors in a volume are.
///
/// The residuals between the gate and twice the gate show how many of those within it belong to the even
/// background. Their number and their squares are subtracted: with 30 % of such errors within twenty σ the
/// plain scale is half as large again as it should be. The plain scale is returned where the background would
/// be most of the residuals within the gate, and for fewer than 100 residuals.
///
/// # Errors
/// As [`gated_scale`].
///
/// # Examples
/// ```
/// use planish_estimate::{gated_scale, gated_scale_over_background};
/// // The quantiles of a standard normal distribution ten times, and 40 residuals between −20 and 20.
/// let normal = [0.126, 0.385, 0.674, 1.036, 1.645].map(|q| [q, -q]).concat().repeat(10);
/// let even = (0..40).map(|k| f64::from(k) - 19.5);
/// let residuals: Vec<f64> = normal.into_iter().chain(even).collect();
/// let scale = gated_scale_over_background(&residuals, 4.0)?;
/// assert!((scale.sigma - 1.0).abs() < 0.25);
/// assert!(gated_scale(&residuals, 4.0)?.sigma > 1.3);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn gated_scale_over_background(residuals: &[f64], gate: f64) -> Result<GatedScale> {
    let plain = gated_scale(residuals, gate)?;
    // A few residuals between gate and twice the gate are no density.
    if residuals.len() < MIN_FOR_BACKGROUND {
        return Ok(plain);
    }
    let truncated = TruncatedNormal::new(gate)?;
    // From below, so that a gate full of background is no fixed point.
    let mut sigma = median_magnitude_scale(residuals)?.min(plain.sigma);
    let limit = 100;
    for iterations in 1..=limit {
        let bound = gate * sigma;
        let (mut kept, mut sum, mut background) = (0_usize, 0.0, 0_usize);
        for r in residuals.iter().map(|r| r.abs()).filter(|r| *r <= 2.0 * bound) {
            if r <= bound {
                kept += 1;
                sum += r * r;
            } else {
                background += 1;
            }
        }
        // An even density has the mean square bound²/3 within the bound.
        let square = sum - background as f64 * bound * bound / 3.0;
        if 4 * background > 3 * kept || square <= 0.0 {
            return Ok(plain);
        }
        let count = (kept - background).max(1) as f64;
        let next = truncated.corrected_sigma((square / count).sqrt());
        let converged = (next - sigma).abs() <= 1e-3 * sigma;
        sigma = next;
        if converged || iterations == limit {
            let termination = if converged { Termination::Converged } else { Termination::Limit };
            return Ok(GatedScale { sigma, kept: kept - background, iterations, termination });
        }
    }
    unreachable!("the last round returns")
}

#[cfg(test)]
mod tests;
