//! Variance components: what the residuals of each group say about its stated σ.
//!
//! Comes in: squared normalised residuals and leverages, sorted into groups (a sensor, a scan). Goes out: the
//! factor between the σ that the residuals show and the one that was stated, its standard error, and whether
//! they contradict each other. Not guaranteed: an answer for a group whose readings the unknowns absorb; its
//! redundancy is near zero and its error large.

use crate::dense::require_finite_number;
use crate::{ChiSquareBand, Error, Result, Termination, TruncatedNormal};

/// Sums over groups of readings, from which their variance factors follow.
///
/// With `r` the residual over its stated σ and `h` its leverage (the reading's part of `tr(H Σ HᵀW)`), a
/// group's variance factor is `s² = Σ r² / Σ (1 − h)`. Assumes independent readings, Gaussian but for what a
/// gate took out. Cost: constant per reading.
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

/// What the residuals of one group say about its stated σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VarianceComponent {
    /// Estimated σ over stated σ.
    pub sigma_factor: f64,
    /// The standard error of `sigma_factor`, `s / √(2 f)` for redundancy `f`.
    pub standard_error: f64,
    /// `f = n − Σ h`: how many readings were free to deviate.
    pub redundancy: f64,
    /// How many readings there were.
    pub count: usize,
}

impl VarianceComponent {
    /// Whether the stated σ lies outside the two-sided interval of the given confidence: a χ² test of `f s²`.
    ///
    /// # Errors
    /// `Input` when the confidence is not between 0 and 1.
    pub fn contradicts_stated(&self, confidence: f64) -> Result<bool> {
        let band = ChiSquareBand::reduced(self.redundancy, confidence)?;
        Ok(!band.contains(self.sigma_factor * self.sigma_factor))
    }
}

impl VarianceComponents {
    /// No readings yet, in so many groups.
    #[must_use]
    pub fn new(groups: usize) -> Self {
        Self { groups: vec![Sums::default(); groups] }
    }

    /// How many groups there are.
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

    /// Adds a reading that passed a gate, whose squares are short of `c(k)` on the average.
    ///
    /// The gate must be in units of the σ that this sum is to find: iterate when it was set by the stated
    /// one.
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
            return Err(Error::input("a squared residual cannot be negative"));
        }
        let groups = self.groups.len();
        let sums = self
            .groups
            .get_mut(group)
            .ok_or_else(|| Error::input(format!("there is no group {group} among {groups}")))?;
        sums.count += count;
        sums.squares += squares;
        sums.leverage += leverages;
        Ok(())
    }

    /// Adds the sums of another part of the same readings, such as another thread's.
    ///
    /// # Errors
    /// `Input` when the numbers of groups differ.
    pub fn merge(&mut self, other: &Self) -> Result<()> {
        if self.groups.len() != other.groups.len() {
            return Err(Error::input("variance components of different groups cannot be merged"));
        }
        for (sums, more) in self.groups.iter_mut().zip(&other.groups) {
            sums.count += more.count;
            sums.squares += more.squares;
            sums.leverage += more.leverage;
        }
        Ok(())
    }

    /// What a group's residuals say.
    ///
    /// # Errors
    /// `Input` when there is no such group; `Undetermined` when its redundancy is below 1e-6: the unknowns
    /// absorb its readings.
    pub fn component(&self, group: usize) -> Result<VarianceComponent> {
        let sums = self
            .groups
            .get(group)
            .ok_or_else(|| Error::input(format!("there is no group {group} among {}", self.groups.len())))?;
        let redundancy = sums.count as f64 - sums.leverage;
        if redundancy < 1e-6 {
            return Err(Error::undetermined(format!(
                "the {} readings of group {group} leave no redundancy to tell their σ: add readings or \
                 state σ",
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

/// Variance factors of all groups, from a solution that was repeated until they agreed with its residuals.
#[derive(Debug, Clone, PartialEq)]
pub struct IteratedVarianceComponents {
    /// Per group, relative to the σ that was stated at first. `None` where the readings do not tell; its σ
    /// stays as stated.
    pub components: Vec<Option<VarianceComponent>>,
    /// How many solutions were made.
    pub iterations: usize,
    /// Whether the factors settled.
    pub termination: Termination,
}

/// Repeats a solution with corrected σ until each group's residuals agree with it: `σ_g² ← σ_g² s_g²`.
///
/// `solve` is given each group's factor on its stated σ; it solves with those and adds every reading,
/// normalised by the *corrected* σ, with the leverage of that solution. Settled when no factor changes by
/// more than `tolerance`, relatively. The fixed point is that of Helmert's estimator, which is REML for
/// Gaussian readings. Cost: `limit` solutions at most.
///
/// # Errors
/// Those of `solve`; `Input` when it returns another number of groups.
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
            return Err(Error::input(format!(
                "{} groups came back where {groups} were asked for",
                sums.groups()
            )));
        }
        let mut change = 0.0_f64;
        for group in 0..groups {
            // A group without redundancy, or one that is met exactly, keeps its σ.
            let step = sums.component(group).ok().filter(|step| step.sigma_factor > 0.0);
            components[group] = step.map(|step| {
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
