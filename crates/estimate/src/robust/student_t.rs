//! The scale and the degrees of freedom of residuals with heavy tails.

use super::{Loss, median_magnitude_scale};
use crate::{Error, Result, Termination};
use statrs::function::gamma::digamma;

/// A Student t distribution about zero, fitted to residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StudentTScale {
    /// The scale in the unit of the residuals. The standard deviation is `σ √(ν/(ν−2))` for `ν > 2`.
    pub sigma: f64,
    /// Degrees of freedom `ν`, between 0.1 (heavy tails) and 1000 (nearly Gaussian).
    pub degrees: f64,
    /// Number of EM rounds.
    pub iterations: usize,
    /// Whether scale and degrees of freedom converged.
    pub termination: Termination,
}

impl StudentTScale {
    const DEGREES: (f64, f64) = (0.1, 1000.0);

    /// Fits the scale, and the degrees of freedom unless given, by expectation maximisation (EM).
    ///
    /// `u = (ν+1)/(ν + r²/σ²)`, `σ² = mean(u r²)`, and `ν` from
    /// `ln(ν/2) − ψ(ν/2) + 1 + mean(ln u − u) + ψ((ν₀+1)/2) − ln((ν₀+1)/2) = 0`. Cost: `n` per round, up to
    /// 1000 rounds.
    ///
    /// # Errors
    /// `Undetermined` when more than half of the residuals are zero or there are none; `Input` when one is
    /// not finite or the degrees are not positive.
    ///
    /// # Examples
    /// ```
    /// use planish_estimate::StudentTScale;
    ///
    /// let residuals = [-2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 100.0];
    /// let scale = StudentTScale::fit(&residuals, Some(3.0))?;
    /// assert!(scale.sigma < 3.0); // the standard deviation is 38
    /// assert!(scale.weight(100.0) < 0.01);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    ///
    /// # References
    /// Lange, Little, Taylor, *Robust statistical modeling using the t distribution*, 1989; Liu, Rubin, *ML
    /// estimation of the t distribution using EM and its extensions*, 1995.
    pub fn fit(residuals: &[f64], degrees: Option<f64>) -> Result<Self> {
        if let Some(given) = degrees {
            Loss::StudentT { degrees: given }.validate()?;
        }
        let mut sigma = median_magnitude_scale(residuals)?;
        if sigma <= 0.0 {
            return Err(Error::undetermined(
                "more than half of the residuals are zero: their scale is undetermined",
            ));
        }
        let n = residuals.len() as f64;
        // Four degrees of freedom start between heavy tails and a Gaussian.
        let mut nu = degrees.unwrap_or(4.0);
        let limit = 1000;
        for iterations in 1..=limit {
            let (mut weighted, mut log_minus) = (0.0, 0.0);
            for r in residuals {
                let u = (nu + 1.0) / (nu + (r / sigma).powi(2));
                weighted += u * r * r;
                // Both sums use the weights of one E-step, so sigma and nu are updated together (ECM).
                log_minus += u.ln() - u;
            }
            let next_sigma = (weighted / n).sqrt();
            let next_nu = match degrees {
                Some(given) => given,
                None => {
                    let half = 0.5 * (nu + 1.0);
                    degrees_from(1.0 + log_minus / n + digamma(half) - half.ln())
                }
            };
            let change = (next_sigma / sigma).ln().abs().max((next_nu / nu).ln().abs());
            (sigma, nu) = (next_sigma, next_nu);
            if change <= 1e-8 || iterations == limit {
                let termination = if change <= 1e-8 { Termination::Converged } else { Termination::Limit };
                return Ok(Self { sigma, degrees: nu, iterations, termination });
            }
        }
        unreachable!("the last round returns")
    }

    /// The weight of a residual, `(ν+1)/(ν + r²/σ²)`.
    #[must_use]
    pub fn weight(&self, residual: f64) -> f64 {
        Loss::StudentT { degrees: self.degrees }.weight(residual / self.sigma)
    }
}

/// Solves `ln(ν/2) − ψ(ν/2) + constant = 0` for ν; the left side decreases with ν from ∞ to `constant`, so
/// bisection finds the root.
fn degrees_from(constant: f64) -> f64 {
    // Bisection in the logarithm, because the bounds are four decades apart. Newton's method would need a
    // safeguard where the function is nearly flat.
    let (mut low, mut high) = (StudentTScale::DEGREES.0.ln(), StudentTScale::DEGREES.1.ln());
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        let half = 0.5 * middle.exp();
        if half.ln() - digamma(half) + constant > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    (0.5 * (low + high)).exp()
}
