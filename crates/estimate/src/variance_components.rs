//! Variance components: estimates of σ per group from residuals.
//!
//! Input: squared normalised residuals and leverages, sorted into groups (a sensor, a scan). Output: the
//! ratio of estimated to stated σ, its standard error, and a test of the stated value. Not guaranteed: an
//! estimate for a group whose readings the unknowns fit exactly. Its redundancy is near zero and its error
//! large.

use crate::dense::require_finite_number;
use crate::{ChiSquareBand, Error, Result, Termination, TruncatedNormal};

/// Sums over groups of readings for the estimation of variance factors.
///
/// With `r` the residual over its stated σ and `h` its leverage (the contribution of the reading to
/// `tr(H Σ HᵀW)`), the variance factor of a group is `s² = Σ r² / Σ (1 − h)`. Assumes independent Gaussian
/// readings, possibly truncated by a gate. Cost: constant per reading.
///
/// # Examples
/// ```
/// use planish_estimate::VarianceComponents;
///
/// let mut sums = VarianceComponents::new(1);
/// for i in 0..1000 {
///     let residual_over_stated = if i % 2 == 0 { 3.0 } else { -3.0 };
///     sums.add(0, residual_over_stated * residual_over_stated, 0.0)?;
/// }
/// let sensor = sums.component(0)?;
/// assert!((sensor.sigma_factor - 3.0).abs() < 1e-12);
/// assert!(sensor.contradicts_stated(0.99)?);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Förstner, *Ein Verfahren zur Schätzung von Varianz- und Kovarianzkomponenten*, 1979; Koch, *Parameter
/// estimation and hypothesis testing in linear models*, 1999, section 3.6.
#[derive(Debug, Clone, PartialEq)]
pub struct VarianceComponents {
    groups: Vec<Sums>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Sums {
    squares: f64,
    leverage: f64,
    count: usize,
}

/// Estimate of σ of one group from its residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VarianceComponent {
    /// Estimated σ divided by stated σ.
    pub sigma_factor: f64,
    /// The standard error of `sigma_factor`, `s / √(2 f)` for redundancy `f`.
    pub standard_error: f64,
    /// Redundancy `f = n − Σ h`, the degrees of freedom of the residuals.
    pub redundancy: f64,
    /// Number of readings.
    pub count: usize,
}

impl VarianceComponent {
    /// True if the stated σ lies outside the two-sided confidence interval: a χ² test of `f s²`.
    ///
    /// # Errors
    /// `Input` when the confidence is not between 0 and 1.
    pub fn contradicts_stated(&self, confidence: f64) -> Result<bool> {
        let band = ChiSquareBand::reduced(self.redundancy, confidence)?;
        Ok(!band.contains(self.sigma_factor * self.sigma_factor))
    }
}

impl VarianceComponents {
    /// Empty sums for the given number of groups.
    #[must_use]
    pub fn new(groups: usize) -> Self {
        Self { groups: vec![Sums::default(); groups] }
    }

    /// Number of groups.
    #[must_use]
    pub fn groups(&self) -> usize {
        self.groups.len()
    }

    /// Adds a reading: its *squared* normalised residual `r²` and its leverage `h`, between 0 and 1.
    ///
    /// # Errors
    /// `Input` when there is no such group, a value is not finite, or `r²` is negative.
    pub fn add(&mut self, group: usize, squared_normalized_residual: f64, leverage: f64) -> Result<()> {
        self.add_sums(group, 1, squared_normalized_residual, leverage)
    }

    /// Adds a reading that passed a gate. Its square is too small by the factor `c(k)` on average.
    ///
    /// The gate must be in units of the σ to be estimated. Iterate if it was set with the stated σ.
    ///
    /// # Errors
    /// As [`Self::add`].
    pub fn add_gated(
        &mut self,
        group: usize,
        squared_normalized_residual: f64,
        leverage: f64,
        gate: &TruncatedNormal,
    ) -> Result<()> {
        self.add_sums(group, 1, squared_normalized_residual / gate.variance_ratio(), leverage)
    }

    /// Adds many readings at once: their number, `Σ r²` and `Σ h`. A measurement of `d` equations counts as
    /// `d` readings.
    ///
    /// # Errors
    /// As [`Self::add`].
    pub fn add_sums(&mut self, group: usize, count: usize, squares: f64, leverages: f64) -> Result<()> {
        require_finite_number("a squared residual", squares)?;
        require_finite_number("a leverage", leverages)?;
        if squares < 0.0 {
            return Err(Error::input("expected a squared residual of at least 0"));
        }
        let groups = self.groups.len();
        let sums = self
            .groups
            .get_mut(group)
            .ok_or_else(|| Error::input(format!("expected groups below {groups}, found {group}")))?;
        sums.count += count;
        sums.squares += squares;
        sums.leverage += leverages;
        Ok(())
    }

    /// Adds the sums of other readings, for example those of another thread.
    ///
    /// # Errors
    /// `Input` when the numbers of groups differ.
    pub fn merge(&mut self, other: &Self) -> Result<()> {
        if self.groups.len() != other.groups.len() {
            return Err(Error::input(
                "expected variance components of the same groups to merge, found different ones",
            ));
        }
        for (sums, more) in self.groups.iter_mut().zip(&other.groups) {
            sums.count += more.count;
            sums.squares += more.squares;
            sums.leverage += more.leverage;
        }
        Ok(())
    }

    /// Estimates σ of a group.
    ///
    /// # Errors
    /// `Input` when there is no such group; `Undetermined` when its redundancy is below 1e-6, because the
    /// unknowns fit its readings exactly.
    pub fn component(&self, group: usize) -> Result<VarianceComponent> {
        let sums = self.groups.get(group).ok_or_else(|| {
            Error::input(format!("expected groups below {}, found {group}", self.groups.len()))
        })?;
        // Each reading fitted by the unknowns reduces its own residual. Dividing by the count alone would
        // make σ too small.
        let redundancy = sums.count as f64 - sums.leverage;
        if redundancy < 1e-6 {
            return Err(Error::undetermined(format!(
                "the {} readings of group {group} have no redundancy, so σ cannot be estimated: add \
                 readings or specify σ",
                sums.count
            )));
        }
        let sigma_factor = (sums.squares / redundancy).sqrt();
        Ok(VarianceComponent {
            sigma_factor,
            standard_error: sigma_factor / (2.0 * redundancy).sqrt(),
            redundancy,
            count: sums.count,
        })
    }
}

/// Result of [`iterate_variance_components`].
#[derive(Debug, Clone, PartialEq)]
pub struct IteratedVarianceComponents {
    /// One component per group, relative to the stated σ. `None` if the readings do not determine it; the
    /// stated σ is then kept.
    pub components: Vec<Option<VarianceComponent>>,
    /// Number of solutions.
    pub iterations: usize,
    /// Whether the factors converged.
    pub termination: Termination,
}

/// Repeats a solution with corrected σ until σ and residuals of each group agree: `σ_g² ← σ_g² s_g²`.
///
/// `solve` receives the factor of σ of each group. It solves with the corrected σ and returns the sums of all
/// readings, normalised by the *corrected* σ, with the leverages of that solution. The iteration stops when
/// no factor changes by more than `tolerance` (relative). The fixed point is Helmert's estimator, which
/// equals REML for Gaussian readings. Cost: `limit` solutions at most.
///
/// # Errors
/// Those of `solve`; `Input` when it returns another number of groups.
///
/// # Examples
/// Residuals of ±3 from a sensor with a stated σ of 1. Nothing else is estimated, so the leverage is zero.
/// ```
/// use planish_estimate::{VarianceComponents, iterate_variance_components};
///
/// let found = iterate_variance_components(1, 1e-9, 20, |factors| {
///     let mut sums = VarianceComponents::new(1);
///     for _ in 0..100 {
///         sums.add(0, (3.0 / factors[0]).powi(2), 0.0)?;
///     }
///     Ok(sums)
/// })?;
/// let sensor = found.components[0].expect("a redundant group");
/// assert!((sensor.sigma_factor - 3.0).abs() < 1e-9);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Förstner, *Ein Verfahren zur Schätzung von Varianz- und Kovarianzkomponenten*, 1979.
pub fn iterate_variance_components(
    groups: usize,
    tolerance: f64,
    limit: usize,
    mut solve: impl FnMut(&[f64]) -> Result<VarianceComponents>,
) -> Result<IteratedVarianceComponents> {
    let mut factors = vec![1.0; groups];
    let mut components = vec![None; groups];
    for iterations in 1..=limit {
        let sums = solve(&factors)?;
        if sums.groups() != groups {
            return Err(Error::input(format!("expected sums of {groups} groups, found {}", sums.groups())));
        }
        let mut change = 0.0_f64;
        for group in 0..groups {
            // A group without redundancy, or with residuals of exactly zero, keeps its σ: a factor of zero
            // would give it infinite weight.
            let step = sums.component(group).ok().filter(|step| step.sigma_factor > 0.0);
            components[group] = step.map(|step| {
                // In logarithms, halving and doubling count alike.
                change = change.max(step.sigma_factor.ln().abs());
                factors[group] *= step.sigma_factor;
                VarianceComponent {
                    sigma_factor: factors[group],
                    standard_error: factors[group] / (2.0 * step.redundancy).sqrt(),
                    ..step
                }
            });
        }
        if change <= tolerance {
            return Ok(IteratedVarianceComponents {
                components,
                iterations,
                termination: Termination::Converged,
            });
        }
    }
    Ok(IteratedVarianceComponents { components, iterations: limit, termination: Termination::Limit })
}

#[cfg(test)]
mod tests;
