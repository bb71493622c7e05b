//! Consistency: tests whether deviations match their stated covariances.
//!
//! Input: deviations from the truth, or residuals, with their covariances. Output: χ² statistics with
//! two-sided bands, coverage of intervals, and a test for white residuals. Not guaranteed: accuracy; a
//! consistent estimate can have a large σ.

use crate::dense::{ScaledCholesky, require_covariance, require_finite_number, require_vector};
use crate::{Error, Result};
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{Binomial, ChiSquared, ContinuousCDF, DiscreteCDF, Normal};

/// How far the mean of the squares of `degrees` standard normal errors, `χ²/ν`, is above 1, as a standard
/// normal variable.
///
/// The cube root of `χ²/ν` is nearly normal with mean `1 − 2/9ν` and variance `2/9ν`, even for a few
/// degrees of freedom. χ² itself is skewed, and a limit in its standard deviations is exceeded too often.
///
/// # Examples
/// ```
/// use planish_estimate::chi_square_deviation;
///
/// // One of a thousand χ² values with 10 degrees of freedom is above 29.59; so is a normal one above 3.09.
/// assert!((chi_square_deviation(2.959, 10.0) - 3.09).abs() < 0.03);
/// ```
///
/// # References
/// Wilson, Hilferty, *The distribution of chi-square*, PNAS 1931.
#[must_use]
pub fn chi_square_deviation(mean_square: f64, degrees: f64) -> f64 {
    let variance = 2.0 / (9.0 * degrees);
    (mean_square.max(0.0).cbrt() - 1.0 + variance) / variance.sqrt()
}

/// `eᵀ Σ⁻¹ e`, distributed as χ² for `e ~ N(0, Σ)`, with as many degrees of freedom as `e` has components.
///
/// For an estimation error and its covariance this is the NEES (normalised estimation error squared); for an
/// innovation it is the NIS. Cost: `n³/3`.
///
/// # Examples
/// ```
/// use nalgebra::{DMatrix, DVector};
/// use planish_estimate::normalized_squared;
///
/// let deviation = DVector::from_vec(vec![0.2, -0.3]);
/// let covariance = DMatrix::from_diagonal(&DVector::from_vec(vec![0.01, 0.09]));
/// assert!((normalized_squared(&deviation, &covariance)? - 5.0).abs() < 1e-12);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # Errors
/// `Input` when shapes differ or the covariance is not positive semidefinite; `Undetermined` when it is
/// singular.
///
/// # References
/// Bar-Shalom, Li, Kirubarajan, *Estimation with applications to tracking and navigation*, 2001, section 5.4.
pub fn normalized_squared(deviation: &DVector<f64>, covariance: &DMatrix<f64>) -> Result<f64> {
    require_vector("the deviation", deviation, deviation.len())?;
    require_covariance("the covariance", covariance, deviation.len())?;
    let factor =
        ScaledCholesky::new(covariance).map_err(|null| null.into_error("the covariance of the deviation"))?;
    Ok(factor.inverse_form(deviation))
}

/// Two-sided band of a χ² statistic at a given confidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChiSquareBand {
    /// The lower end.
    pub lower: f64,
    /// The upper end.
    pub upper: f64,
}

impl ChiSquareBand {
    /// The band of the *mean* of `samples` independent χ² values of `degrees` degrees of freedom each.
    ///
    /// # Errors
    /// `Input` when there are no samples or degrees, or when the confidence is not between 0 and 1.
    ///
    /// # Examples
    /// ```
    /// use planish_estimate::ChiSquareBand;
    ///
    /// // 50 runs of a state of two, as in the reference's example 5.4.2.
    /// let band = ChiSquareBand::of_mean(50, 2.0, 0.95)?;
    /// assert!((band.lower - 1.484).abs() < 1e-3 && (band.upper - 2.591).abs() < 1e-3);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn of_mean(samples: usize, degrees: f64, confidence: f64) -> Result<Self> {
        // A sum of independent χ² values is χ² itself, so the band is exact for any number of samples. A
        // Gaussian band would be symmetric and wrong for few of them.
        let n = samples as f64;
        Self::of_sum(n * degrees, confidence)
            .map(|band| Self { lower: band.lower / n, upper: band.upper / n })
    }

    /// The band of a reduced χ², the sum of squares over its redundancy.
    ///
    /// # Errors
    /// `Input` when the redundancy is not positive, or when the confidence is not between 0 and 1.
    pub fn reduced(redundancy: f64, confidence: f64) -> Result<Self> {
        Self::of_sum(redundancy, confidence)
            .map(|band| Self { lower: band.lower / redundancy, upper: band.upper / redundancy })
    }

    /// The band of a sum of squares with the given degrees of freedom, which need not be an integer.
    ///
    /// # Errors
    /// `Input` when the degrees are not positive, or when the confidence is not between 0 and 1.
    pub fn of_sum(degrees: f64, confidence: f64) -> Result<Self> {
        let tail = tail_of(confidence)?;
        let distribution =
            ChiSquared::new(degrees).ok().filter(|_| degrees.is_finite()).ok_or_else(|| {
                Error::input(format!("expected positive degrees of freedom for χ², found {degrees}"))
            })?;
        Ok(Self { lower: distribution.inverse_cdf(tail), upper: distribution.inverse_cdf(1.0 - tail) })
    }

    /// True if a value lies in the band.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        self.lower <= value && value <= self.upper
    }
}

fn tail_of(confidence: f64) -> Result<f64> {
    if confidence > 0.0 && confidence < 1.0 {
        Ok(0.5 * (1.0 - confidence))
    } else {
        Err(Error::input(format!("expected a confidence between 0 and 1, found {confidence}")))
    }
}

/// Mean of χ² values, such as NEES or NIS over several runs, with its band.
///
/// # Examples
/// ```
/// use planish_estimate::ChiSquareMean;
///
/// let mut nees = ChiSquareMean::new(3.0)?;
/// for value in [2.1, 3.9, 2.7, 3.4] {
///     nees.add(value)?;
/// }
/// assert!(nees.is_consistent(0.95)?);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChiSquareMean {
    degrees: f64,
    sum: f64,
    samples: usize,
}

impl ChiSquareMean {
    /// An empty mean of values with the given degrees of freedom.
    ///
    /// # Errors
    /// `Input` when the degrees are not positive.
    pub fn new(degrees: f64) -> Result<Self> {
        ChiSquareBand::of_sum(degrees, 0.5)?;
        Ok(Self { degrees, sum: 0.0, samples: 0 })
    }

    /// Adds a value.
    ///
    /// # Errors
    /// `Input` when it is not finite.
    pub fn add(&mut self, value: f64) -> Result<()> {
        require_finite_number("a χ² value", value)?;
        self.sum += value;
        self.samples += 1;
        Ok(())
    }

    /// Number of values.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// The mean value; its expectation is the degrees of freedom. NaN without values.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.sum / self.samples as f64
    }

    /// The reduced χ²: the mean divided by the degrees of freedom. Its expectation is 1.
    #[must_use]
    pub fn reduced(&self) -> f64 {
        self.mean() / self.degrees
    }

    /// The band of the mean.
    ///
    /// # Errors
    /// `Input` when there are no values, or when the confidence is not between 0 and 1.
    pub fn band(&self, confidence: f64) -> Result<ChiSquareBand> {
        ChiSquareBand::of_mean(self.samples, self.degrees, confidence)
    }

    /// True if the mean lies in its band. Above it, the stated σ are too small; below it, too large.
    ///
    /// # Errors
    /// As [`Self::band`].
    pub fn is_consistent(&self, confidence: f64) -> Result<bool> {
        Ok(self.band(confidence)?.contains(self.mean()))
    }
}

/// Counts how often the truth lies in the stated interval, optionally weighted, for example by area.
///
/// # Examples
/// ```
/// use planish_estimate::Coverage;
///
/// let mut coverage = Coverage::of_interval(0.95)?;
/// for (deviation, sigma) in [(0.1, 0.1), (-0.19, 0.1), (0.25, 0.1), (0.0, 0.2)] {
///     coverage.add(deviation, sigma)?;
/// }
/// assert_eq!(coverage.share(), 0.75);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coverage {
    interval: f64,
    half_width: f64,
    count: usize,
    inside: f64,
    weight: f64,
    squared_weight: f64,
}

impl Coverage {
    /// An empty count for the two-sided Gaussian interval of this probability, for example ±1.96 σ for 0.95.
    ///
    /// # Errors
    /// `Input` when the probability is not between 0 and 1.
    pub fn of_interval(probability: f64) -> Result<Self> {
        let half_width = -Normal::standard().inverse_cdf(tail_of(probability)?);
        Ok(Self {
            interval: probability,
            half_width,
            count: 0,
            inside: 0.0,
            weight: 0.0,
            squared_weight: 0.0,
        })
    }

    /// Counts a deviation whose stated standard deviation is `sigma`, in the same unit.
    ///
    /// # Errors
    /// `Input` when a value is not finite or `sigma` is negative.
    pub fn add(&mut self, deviation: f64, sigma: f64) -> Result<()> {
        self.add_weighted(deviation, sigma, 1.0)
    }

    /// Counts a deviation with a weight, for example the area that it represents.
    ///
    /// # Errors
    /// `Input` when a value is not finite, or when `sigma` or the weight is negative.
    pub fn add_weighted(&mut self, deviation: f64, sigma: f64, weight: f64) -> Result<()> {
        require_finite_number("a deviation", deviation)?;
        require_finite_number("a standard deviation", sigma)?;
        require_finite_number("a weight", weight)?;
        if sigma < 0.0 || weight < 0.0 {
            return Err(Error::input("expected a standard deviation and a weight of at least 0"));
        }
        self.count += 1;
        self.weight += weight;
        self.squared_weight += weight * weight;
        if deviation.abs() <= self.half_width * sigma {
            self.inside += weight;
        }
        Ok(())
    }

    /// Adds another count of the same interval.
    ///
    /// # Errors
    /// `Input` when the intervals differ.
    pub fn merge(&mut self, other: &Self) -> Result<()> {
        if self.interval != other.interval {
            return Err(Error::input(
                "expected coverages of the same interval to merge, found different ones",
            ));
        }
        self.count += other.count;
        self.inside += other.inside;
        self.weight += other.weight;
        self.squared_weight += other.squared_weight;
        Ok(())
    }

    /// Number of deviations.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// The weighted fraction inside the interval. NaN for an empty count.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.inside / self.weight
    }

    /// The band of [`Self::share`] for correct σ and independent cases: lower and upper binomial quantiles.
    ///
    /// The effective number of weighted cases is `(Σ w)² / Σ w²`. Neighbours on a surface are correlated,
    /// which makes the band too narrow.
    ///
    /// # Errors
    /// `Input` when the confidence is not between 0 and 1; `Undetermined` for an empty count.
    pub fn band(&self, confidence: f64) -> Result<(f64, f64)> {
        let tail = tail_of(confidence)?;
        // Kish's effective sample size; the binomial distribution needs an integer.
        let cases = (self.weight * self.weight / self.squared_weight).round();
        if cases.is_nan() || cases < 1.0 {
            return Err(Error::undetermined("expected at least one case for a coverage, found none"));
        }
        let binomial = Binomial::new(self.interval, cases as u64)
            .map_err(|cause| Error::input("a coverage band cannot be computed").with_source(cause))?;
        Ok((binomial.inverse_cdf(tail) as f64 / cases, binomial.inverse_cdf(1.0 - tail) as f64 / cases))
    }
}

/// Result of the test [`whiteness`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whiteness {
    /// `n (n + 2) Σ ρ_k² / (n − k)` over the lags.
    pub statistic: f64,
    /// Probability of a statistic at least as large for a white sequence.
    pub p_value: f64,
}

/// Tests a sequence of normalised residuals for autocorrelation at lags 1 to `lags` (Ljung–Box test). Cost:
/// `n · lags`.
///
/// # Errors
/// `Input` when a value is not finite, there are no lags, or not more values than lags; `Undetermined` when
/// all values are equal.
///
/// # References
/// Ljung, Box, *On a measure of lack of fit in time series models*, 1978.
///
/// # Examples
/// ```
/// use planish_estimate::whiteness;
///
/// let wave: Vec<f64> = (0..100).map(|i| (0.1 * f64::from(i)).sin()).collect();
/// assert!(whiteness(&wave, 5)?.p_value < 1e-6); // neighbours are correlated
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn whiteness(residuals: &[f64], lags: usize) -> Result<Whiteness> {
    if lags == 0 || residuals.len() <= lags {
        return Err(Error::input(format!(
            "expected at least one lag and more residuals than lags for the test of whiteness, found {} \
             residuals and {lags} lags",
            residuals.len()
        )));
    }
    for &residual in residuals {
        require_finite_number("a residual", residual)?;
    }
    let n = residuals.len() as f64;
    let mean = residuals.iter().sum::<f64>() / n;
    // A constant offset would correlate all residuals. It is a matter of bias, not of whiteness.
    let centred: Vec<f64> = residuals.iter().map(|r| r - mean).collect();
    let power: f64 = centred.iter().map(|r| r * r).sum();
    if power <= 0.0 {
        return Err(Error::undetermined(
            "expected different residuals for an autocorrelation, found all equal",
        ));
    }
    let sum: f64 = (1..=lags)
        .map(|lag| {
            let product: f64 = centred.iter().zip(&centred[lag..]).map(|(a, b)| a * b).sum();
            // The weight 1/(n − k) is what Ljung and Box change in the test of Box and Pierce, whose
            // statistic is too small for short sequences.
            (product / power).powi(2) / (n - lag as f64)
        })
        .sum();
    let statistic = n * (n + 2.0) * sum;
    let distribution = ChiSquared::new(lags as f64)
        .map_err(|cause| Error::input("the test of whiteness cannot be computed").with_source(cause))?;
    Ok(Whiteness { statistic, p_value: distribution.sf(statistic) })
}

#[cfg(test)]
mod tests;
