//! Weight of a smoothness prior by restricted maximum likelihood (REML).
//!
//! Input: how the log-determinant and the quadratic forms of a penalised solution depend on the weight `w` of
//! the prior `w K`. Output: the weight of maximum likelihood, by search or by fixed point. The caller solves
//! the equations, so dense and sparse problems both work. Not guaranteed: a finite weight. Data that lie in
//! the null space of the penalty send it to its bound.

use crate::dense::{diagonal_scale, eigen, require_covariance, require_finite_number, scaled_by};
use crate::line_search::{Evaluated, maximize_bracketed};
use crate::{Error, ErrorKind, Result, Termination};
use nalgebra::DMatrix;

/// The common scale `φ` of the covariances of data and prior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Dispersion {
    /// Known scale; 1 if the stated σ are correct.
    Known(f64),
    /// Estimated together with the weight: `φ = (RSS + w xᵀKx) / (n − M)`.
    Estimated,
}

/// The quantities of a smoothing problem that do not depend on the weight.
///
/// The model: readings `z = H x + v` with `v ~ N(0, φ W⁻¹)`, and `x` with prior information `w K / φ`, flat
/// along the null space of `K`. If three coordinates share `K`, triple rank, unknowns and equations, and sum
/// the quantities of the evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothnessModel {
    /// The rank of `K`.
    pub rank: usize,
    /// Number of unknowns; the null space of dimension `M = unknowns − rank` has a flat prior.
    pub unknowns: usize,
    /// Number of scalar equations of the data.
    pub equations: usize,
    /// `log |K|₊`, the [pseudo-determinant](log_pseudo_determinant); it only shifts the likelihood, so 0
    /// works as well.
    pub log_pseudo_determinant: f64,
    /// The scale of all covariances.
    pub dispersion: Dispersion,
}

/// A penalised solution at one weight `w`, with `A = Λ + w K` and `x̂ = A⁻¹ η`; all for `φ = 1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothnessEvaluation {
    /// `log |Λ + w K|`.
    pub log_determinant: f64,
    /// `(z − H x̂)ᵀ W (z − H x̂)`.
    pub residual: f64,
    /// `x̂ᵀ K x̂`.
    pub roughness: f64,
    /// `tr((Λ + w K)⁻¹ K)`; expected only by the Fellner–Schall update.
    pub trace: Option<f64>,
}

impl SmoothnessModel {
    fn validate(&self) -> Result<()> {
        let null = self.unknowns.checked_sub(self.rank);
        if self.rank == 0 || null.is_none_or(|null| null >= self.equations) {
            return Err(Error::input(format!(
                "expected a prior of rank 1 or more and more equations than unknowns without a prior, \
                 found rank {}, {} unknowns and {} equations",
                self.rank, self.unknowns, self.equations
            )));
        }
        match self.dispersion {
            Dispersion::Known(scale) if !(scale > 0.0 && scale.is_finite()) => {
                Err(Error::input(format!("expected a scale of covariances > 0, found {scale}")))
            }
            _ => Ok(()),
        }
    }

    /// `n − M` as a floating-point number.
    fn contrasts(&self) -> f64 {
        // In this order the unsigned numbers cannot become negative.
        (self.equations + self.rank) as f64 - self.unknowns as f64
    }

    /// `φ`, known or estimated at this weight.
    #[must_use]
    pub fn dispersion_at(&self, weight: f64, evaluation: &SmoothnessEvaluation) -> f64 {
        match self.dispersion {
            Dispersion::Known(scale) => scale,
            Dispersion::Estimated => (evaluation.residual + weight * evaluation.roughness) / self.contrasts(),
        }
    }

    /// The restricted log-likelihood of the weight, up to a constant independent of `w` and `φ`:
    ///
    /// `½ [r log w + log|K|₊ − log|Λ + wK| − (RSS + w x̂ᵀKx̂)/φ − (n − M) log(2πφ)]`.
    ///
    /// # References
    /// Patterson, Thompson, *Recovery of inter-block information when block sizes are unequal*, 1971; Wood,
    /// *Fast stable restricted maximum likelihood and marginal likelihood estimation of semiparametric
    /// generalized linear models*, 2011, section 2.1.
    #[must_use]
    pub fn log_likelihood(&self, weight: f64, evaluation: &SmoothnessEvaluation) -> f64 {
        let scale = self.dispersion_at(weight, evaluation);
        let penalized = evaluation.residual + weight * evaluation.roughness;
        0.5 * (self.rank as f64 * weight.ln() + self.log_pseudo_determinant
            - evaluation.log_determinant
            - penalized / scale
            - self.contrasts() * (std::f64::consts::TAU * scale).ln())
    }

    /// The Fellner–Schall update `w ← φ (r − w tr(A⁻¹K))₊ / x̂ᵀKx̂`: positive, and stationary where the
    /// likelihood is.
    ///
    /// `r − w tr(A⁻¹K)` is the number of penalised unknowns that the data determine, and is negative only by
    /// rounding. The weight can fall to zero, or grow to infinity if the roughness vanishes: bound it.
    ///
    /// # Errors
    /// `Input` when the evaluation has no trace.
    ///
    /// # References
    /// Wood, Fasiolo, *A generalized Fellner–Schall method for smoothing parameter optimization with
    /// application to Tweedie location, scale and shape models*, 2017, eq. 4.
    pub fn fellner_schall_update(&self, weight: f64, evaluation: &SmoothnessEvaluation) -> Result<f64> {
        let trace = evaluation.trace.ok_or_else(|| {
            Error::input("the Fellner–Schall update needs the trace of covariance times penalty")
        })?;
        let determined = (self.rank as f64 - weight * trace).max(0.0);
        let scale = self.dispersion_at(weight, evaluation);
        Ok(if evaluation.roughness > 0.0 { scale * determined / evaluation.roughness } else { f64::INFINITY })
    }
}

/// Options of the search for the weight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothnessSearch {
    /// Initial weight.
    pub start: f64,
    /// First step of `log w`, the expected error of the initial weight. Steps double until the likelihood
    /// falls.
    pub step: f64,
    /// Minimum and maximum weight.
    pub bounds: (f64, f64),
    /// Tolerance of `log w`.
    pub tolerance: f64,
    /// Maximum number of solutions.
    pub max_evaluations: usize,
}

impl SmoothnessSearch {
    /// Starts at a given weight, with bounds of 16 powers of ten, a tolerance of 1 % and at most 60
    /// solutions.
    #[must_use]
    pub fn from_start(start: f64) -> Self {
        Self { start, step: 2.0, bounds: (1e-16 * start, 1e16 * start), tolerance: 0.01, max_evaluations: 60 }
    }

    fn validate(&self) -> Result<()> {
        let (low, high) = self.bounds;
        if low > 0.0
            && low <= self.start
            && self.start <= high
            && high.is_finite()
            && self.tolerance > 0.0
            && self.step > 0.0
        {
            Ok(())
        } else {
            Err(Error::input(format!(
                "the search for a smoothness weight needs a start within positive bounds and a positive \
                 tolerance: {self:?}"
            )))
        }
    }

    fn is_at_bound(&self, weight: f64) -> bool {
        let (low, high) = self.bounds;
        weight <= low * (1.0 + 1e-9) || weight >= high * (1.0 - 1e-9)
    }
}

/// The estimated weight of a smoothness prior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothnessWeight {
    /// `w`.
    pub weight: f64,
    /// `φ` at that weight.
    pub dispersion: f64,
    /// The restricted log-likelihood there.
    pub log_likelihood: f64,
    /// True if the weight is at a bound: the data support no smoothing, or only the null space.
    pub at_bound: bool,
    /// Number of solutions.
    pub evaluations: usize,
    /// Whether the search converged.
    pub termination: Termination,
}

/// Finds the weight of maximum restricted likelihood: brackets it from the start, then uses golden section
/// with parabolic steps.
///
/// `evaluate` solves at a weight. A start within a factor of 100 needs about ten solutions. The result is *a*
/// local maximum; the likelihood of a single weight rarely has two.
///
/// # Errors
/// Those of `evaluate`, except `Undetermined` after the first solution, which only excludes that weight;
/// `Input` when the model or the search is not valid, or a likelihood is not finite.
///
/// # Examples
/// One unknown with prior `N(0, 1/w)` and one reading 3 with σ = 1: the most likely prior variance is
/// `3² − 1`.
/// ```
/// use planish_estimate::{
///     Dispersion, SmoothnessEvaluation, SmoothnessModel, SmoothnessSearch,
///     maximize_restricted_likelihood,
/// };
///
/// let model = SmoothnessModel {
///     rank: 1,
///     unknowns: 1,
///     equations: 1,
///     log_pseudo_determinant: 0.0,
///     dispersion: Dispersion::Known(1.0),
/// };
/// let search = SmoothnessSearch { tolerance: 1e-6, ..SmoothnessSearch::from_start(1.0) };
/// let found = maximize_restricted_likelihood(&model, &search, |w| {
///     let x = 3.0 / (1.0 + w);
///     Ok(SmoothnessEvaluation {
///         log_determinant: (1.0 + w).ln(),
///         residual: (3.0 - x) * (3.0 - x),
///         roughness: x * x,
///         trace: None,
///     })
/// })?;
/// assert!((1.0 / found.weight - 8.0).abs() < 1e-3);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Wood, *Fast stable restricted maximum likelihood and marginal likelihood estimation of semiparametric
/// generalized linear models*, 2011; Brent, *Algorithms for minimization without derivatives*, 1973.
pub fn maximize_restricted_likelihood(
    model: &SmoothnessModel,
    search: &SmoothnessSearch,
    mut evaluate: impl FnMut(f64) -> Result<SmoothnessEvaluation>,
) -> Result<SmoothnessWeight> {
    model.validate()?;
    search.validate()?;
    let mut best: Option<SmoothnessWeight> = None;
    let mut evaluations = 0;
    let mut value_at = |log_weight: f64| -> Result<f64> {
        evaluations += 1;
        // The search runs in `log w`: weights span many decades and stay positive. `exp` does not invert `ln`
        // exactly, and the clamp keeps the weight within its bounds.
        let weight = log_weight.exp().clamp(search.bounds.0, search.bounds.1);
        let found = match solve_at(model, search, weight, &mut evaluate) {
            Ok(found) => found,
            // A weight without a solution is too small or too large, so it cannot be the optimum.
            Err(error) if error.kind() == ErrorKind::Undetermined && best.is_some() => {
                return Ok(f64::NEG_INFINITY);
            }
            Err(error) => return Err(error),
        };
        if best.is_none_or(|best| found.log_likelihood > best.log_likelihood) {
            best = Some(found);
        }
        Ok(found.log_likelihood)
    };

    let (lowest, highest) = (search.bounds.0.ln(), search.bounds.1.ln());
    let mut evaluated = |at: f64| value_at(at).map(|value| Evaluated { at, value });
    let start = evaluated(search.start.ln())?;
    let first = evaluated((start.at + search.step).min(highest))?;
    // Bracket the maximum: walk uphill with doubled steps until the likelihood falls or a bound is reached.
    // At the upper bound the first step has length zero and shows no direction.
    let is_uphill = first.value >= start.value && first.at > start.at;
    let (mut behind, mut inner) = if is_uphill { (start, first) } else { (first, start) };
    let mut step = if is_uphill { search.step } else { -search.step };
    let mut left = search.max_evaluations.saturating_sub(2);
    let mut converged = false;
    while left > 0 {
        let ahead = (inner.at + step).clamp(lowest, highest);
        let trial = if ahead == inner.at { inner } else { evaluated(ahead)? };
        // Only new points count as evaluations.
        left -= usize::from(ahead != inner.at);
        if trial.value < inner.value || ahead == inner.at {
            let bracket = if behind.at < trial.at { [behind, inner, trial] } else { [trial, inner, behind] };
            let value_at = |at| evaluated(at).map(|found| found.value);
            converged = maximize_bracketed(bracket, search.tolerance, left, value_at)?.converged;
            break;
        }
        (behind, inner) = (inner, trial);
        step *= 2.0;
    }
    let best =
        best.ok_or_else(|| Error::input("expected at least one solution for the search for a weight"))?;
    let termination = if converged { Termination::Converged } else { Termination::Limit };
    Ok(SmoothnessWeight { evaluations, termination, ..best })
}

/// Finds the fixed point of the [Fellner–Schall update](SmoothnessModel::fellner_schall_update), halving
/// steps that reduce the likelihood.
///
/// `evaluate` solves at a weight and returns the trace. Convergence is linear: fast if the data determine the
/// penalised unknowns well, slow otherwise. In the second case prefer [`maximize_restricted_likelihood`].
///
/// # Errors
/// Those of `evaluate`; `Input` when the model or the search is not valid, a likelihood is not finite, or a
/// trace is missing.
///
/// # Examples
/// The same problem as for [`maximize_restricted_likelihood`]:
/// ```
/// use planish_estimate::{
///     Dispersion, SmoothnessEvaluation, SmoothnessModel, SmoothnessSearch, fellner_schall,
/// };
///
/// let model = SmoothnessModel {
///     rank: 1,
///     unknowns: 1,
///     equations: 1,
///     log_pseudo_determinant: 0.0,
///     dispersion: Dispersion::Known(1.0),
/// };
/// let search = SmoothnessSearch { tolerance: 1e-6, ..SmoothnessSearch::from_start(1.0) };
/// let found = fellner_schall(&model, &search, |w| {
///     let x = 3.0 / (1.0 + w);
///     Ok(SmoothnessEvaluation {
///         log_determinant: (1.0 + w).ln(),
///         residual: (3.0 - x) * (3.0 - x),
///         roughness: x * x,
///         trace: Some(1.0 / (1.0 + w)),
///     })
/// })?;
/// assert!((1.0 / found.weight - 8.0).abs() < 1e-3);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Wood, Fasiolo, *A generalized Fellner–Schall method for smoothing parameter optimization with application
/// to Tweedie location, scale and shape models*, 2017.
pub fn fellner_schall(
    model: &SmoothnessModel,
    search: &SmoothnessSearch,
    mut evaluate: impl FnMut(f64) -> Result<SmoothnessEvaluation>,
) -> Result<SmoothnessWeight> {
    model.validate()?;
    search.validate()?;
    let mut solve = |weight: f64| -> Result<(SmoothnessWeight, f64)> {
        let evaluation = evaluate(weight)?;
        let found = solve_at(model, search, weight, &mut |_| Ok(evaluation))?;
        let next = model.fellner_schall_update(weight, &evaluation)?;
        Ok((found, next.clamp(search.bounds.0, search.bounds.1)))
    };
    let (mut best, mut next) = solve(search.start)?;
    let mut evaluations = 1;
    let mut termination = Termination::Limit;
    while evaluations < search.max_evaluations {
        let step = (next / best.weight).ln();
        if step.abs() <= search.tolerance {
            termination = Termination::Converged;
            break;
        }
        let (trial, after) = solve(next)?;
        evaluations += 1;
        // Near the optimum, differences of the likelihood are rounding and must not halve steps.
        let rounding = 1e-12 * (1.0 + best.log_likelihood.abs());
        if trial.log_likelihood >= best.log_likelihood - rounding {
            (best, next) = (trial, after);
        } else {
            // Half of the step in `log w`. It is an ascent direction, so some fraction of it raises the
            // likelihood.
            next = best.weight * (0.5 * step).exp();
        }
    }
    Ok(SmoothnessWeight { evaluations, termination, ..best })
}

fn solve_at(
    model: &SmoothnessModel,
    search: &SmoothnessSearch,
    weight: f64,
    evaluate: &mut impl FnMut(f64) -> Result<SmoothnessEvaluation>,
) -> Result<SmoothnessWeight> {
    let evaluation = evaluate(weight)?;
    let log_likelihood = model.log_likelihood(weight, &evaluation);
    require_finite_number("the restricted likelihood of a smoothness weight", log_likelihood)?;
    Ok(SmoothnessWeight {
        weight,
        dispersion: model.dispersion_at(weight, &evaluation),
        log_likelihood,
        at_bound: search.is_at_bound(weight),
        evaluations: 1,
        termination: Termination::Limit,
    })
}

/// The rank of a symmetric positive semidefinite matrix and the logarithm of the product of its positive
/// eigenvalues, `log |K|₊`.
///
/// The rank is decided after scaling to unit diagonal: eigenvalues below `tolerance` times the largest are
/// zero. 1e-10 suits penalties that were integrated exactly. Cost: `10 n³`.
///
/// # Examples
/// ```
/// use nalgebra::DMatrix;
/// use planish_estimate::log_pseudo_determinant;
///
/// // The penalty (x0 − x1)² does not see a common shift: rank 1, eigenvalues 0 and 2.
/// let penalty = DMatrix::from_row_slice(2, 2, &[1.0, -1.0, -1.0, 1.0]);
/// let (rank, log) = log_pseudo_determinant(&penalty, 1e-10)?;
/// assert_eq!(rank, 1);
/// assert!((log - 2.0_f64.ln()).abs() < 1e-12);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # Errors
/// `Input` when the matrix is not symmetric positive semidefinite.
pub fn log_pseudo_determinant(matrix: &DMatrix<f64>, tolerance: f64) -> Result<(usize, f64)> {
    require_covariance("the penalty", matrix, matrix.nrows())?;
    let not_finite = || Error::input("the eigenvalue iteration of the penalty does not converge");
    let rank = {
        let scaled = eigen(scaled_by(matrix, &diagonal_scale(matrix))).ok_or_else(not_finite)?.eigenvalues;
        let largest = scaled.iter().copied().fold(0.0, f64::max);
        scaled.iter().filter(|&&value| value > tolerance * largest).count()
    };
    // Scaling keeps the rank but changes the product, so the product uses eigenvalues of the unscaled matrix.
    let mut values: Vec<f64> =
        eigen(matrix.clone()).ok_or_else(not_finite)?.eigenvalues.iter().copied().collect();
    values.sort_by(|a, b| b.total_cmp(a));
    Ok((rank, values[..rank].iter().map(|value| value.max(f64::MIN_POSITIVE).ln()).sum()))
}

#[cfg(test)]
mod tests;
