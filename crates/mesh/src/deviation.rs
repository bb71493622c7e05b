//! Statistics of the deviations between two surfaces.
//!
//! In: signed deviations in the unit of the model. Out: the figures of `planish compare`.
//! Not guaranteed: robustness. A single outlier changes the rms, the mean and the maximum.

use planish_estimate::{Error, Result};

/// Statistics of a set of signed deviations.
///
/// # Examples
/// ```
/// use planish_mesh::DeviationStatistics;
/// let statistics = DeviationStatistics::from_signed(&[-1.0, 0.0, 1.0, 2.0])?;
/// assert_eq!((statistics.mean, statistics.p50, statistics.max), (0.5, 1.0, 2.0));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeviationStatistics {
    /// Root mean square `sqrt(Σ d² / n)`, relative to zero and not to the mean.
    pub rms: f64,
    /// Signed mean `Σ d / n`, the bias.
    pub mean: f64,
    /// Median of `|d|`.
    pub p50: f64,
    /// 95 % quantile of `|d|`.
    pub p95: f64,
    /// Maximum of `|d|`.
    pub max: f64,
    /// Number of deviations.
    pub n: usize,
}

impl DeviationStatistics {
    /// Computes the statistics, with quantiles as in [`quantile_of_sorted`]. Cost O(n log n).
    ///
    /// # Errors
    /// `Undetermined` for no deviations, `Input` for one that is not finite.
    pub fn from_signed(deviations: &[f64]) -> Result<Self> {
        if deviations.is_empty() {
            return Err(Error::undetermined(
                "expected deviations to summarise, found none: the two models do not overlap",
            ));
        }
        if let Some(at) = deviations.iter().position(|d| !d.is_finite()) {
            return Err(Error::input(format!(
                "deviation {at}: expected a finite number, found {}",
                deviations[at]
            )));
        }
        let n = deviations.len();
        // Sorted sizes serve both quantiles and the maximum; the sums below keep the order of the input,
        // so that they do not depend on the sort.
        let mut sizes: Vec<f64> = deviations.iter().map(|d| d.abs()).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        Ok(Self {
            rms: (deviations.iter().map(|d| d * d).sum::<f64>() / n as f64).sqrt(),
            mean: deviations.iter().sum::<f64>() / n as f64,
            p50: quantile_of_sorted(&sizes, 0.5),
            p95: quantile_of_sorted(&sizes, 0.95),
            max: sizes[n - 1],
            n,
        })
    }
}

/// The `p` quantile of ascending values.
///
/// It interpolates linearly between the values around position `p (n − 1)`, counted from zero. This is the
/// default of NumPy and R.
///
/// # Panics
/// If there are no values.
///
/// # Examples
/// ```
/// assert_eq!(planish_mesh::quantile_of_sorted(&[1.0, 2.0, 4.0], 0.75), 3.0);
/// ```
///
/// # References
/// Hyndman and Fan, *Sample Quantiles in Statistical Packages*, The American Statistician 1996, definition 7.
#[must_use]
pub fn quantile_of_sorted(ascending: &[f64], p: f64) -> f64 {
    let position = p.clamp(0.0, 1.0) * (ascending.len() - 1) as f64;
    let below = (position.floor() as usize).min(ascending.len() - 1);
    let above = (below + 1).min(ascending.len() - 1);
    let share = position - below as f64;
    ascending[below] + share * (ascending[above] - ascending[below])
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_estimate::ErrorKind;

    #[test]
    fn figures_match_numpy() {
        // numpy: d = [-3, 1, 2, -0.5, 0.25]; sqrt(mean(d**2)), mean(d), percentile(abs(d), [50, 95]),
        // max(abs(d)).
        let s = DeviationStatistics::from_signed(&[-3.0, 1.0, 2.0, -0.5, 0.25]).unwrap();
        assert!((s.rms - 1.691_892_431_568_863).abs() < 1e-14, "{}", s.rms);
        assert!((s.mean + 0.05).abs() < 1e-15);
        assert_eq!((s.p50, s.max, s.n), (1.0, 3.0, 5));
        assert!((s.p95 - 2.8).abs() < 1e-12);
    }

    #[test]
    fn all_quantiles_of_one_value_are_that_value() {
        let s = DeviationStatistics::from_signed(&[-2.0]).unwrap();
        assert_eq!((s.rms, s.mean, s.p50, s.p95, s.max), (2.0, -2.0, 2.0, 2.0, 2.0));
    }

    #[test]
    fn empty_sets_and_nan_are_rejected() {
        assert_eq!(DeviationStatistics::from_signed(&[]).unwrap_err().kind(), ErrorKind::Undetermined);
        assert_eq!(DeviationStatistics::from_signed(&[0.0, f64::NAN]).unwrap_err().kind(), ErrorKind::Input);
    }
}
