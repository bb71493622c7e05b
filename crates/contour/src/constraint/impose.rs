//! Constraints imposed on an estimate: measurements of zero, or small, covariance.
//!
//! Comes in: a drawing whose parameters are an estimate, its covariance, constraints. Goes out: the most
//! likely drawing that obeys them, its covariance, and what it cost the estimate (χ²). Not guaranteed: the
//! nearest one, where several branches obey the constraints.

use super::diagnose::satisfy;
use super::drawing::ParametricDrawing;
use super::equations::ConstraintEquations;
use super::minimal::quick_xplain;
use super::rank::row_rank;
use super::relation::Constraint;
use super::solve::solve;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use planish_estimate::{EquationUpdate, Error, KalmanFilter, Result};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// An estimate with constraints imposed.
#[derive(Debug, Clone, PartialEq)]
pub struct Imposed {
    /// The most likely drawing that obeys the constraints.
    pub drawing: ParametricDrawing,
    /// The covariance of its parameters; singular along what the constraints fix.
    pub covariance: DMatrix<f64>,
    /// The squared distance by which the estimate had to move, in its own covariance.
    pub chi_square: f64,
    /// How many independent equations moved it: the degrees of freedom of that χ².
    pub degrees: usize,
    /// The probability of a χ² at least as large when the constraints are true.
    pub p_value: f64,
    /// Constraints that the others, or the estimate, had implied before their turn.
    pub implied: Vec<usize>,
}

/// Relative σ of a residual below which it is known already.
pub(super) const KNOWN: f64 = 1e-6;
/// Steps, as shares of the extent, at which an estimate has settled.
const MOVED: f64 = 1e-12;
/// Steps at which it may stall.
const STALLED: f64 = 1e-7;
const MAX_ITERATIONS: usize = 100;
/// Scaled residuals that an imposed estimate may leave.
const SETTLED: f64 = 1e-8;

/// Imposes constraints on an estimate with the iterated Kalman filter: readings `f(x) = 0` with `R = σ² I`;
/// in square roots where σ is zero.
///
/// `covariance` is that of the drawing's parameters, in their order, and may be singular. `sigma` is how
/// truly the constraints hold: angles in radians and lengths as shares of the drawing's extent; zero for
/// exactly. Which of the equations are independent is judged where they hold, as at a noisy estimate
/// redundant ones look independent. At the fixed point `χ² = (x − x̂)ᵀ P⁻¹ (x − x̂)`, the least that any
/// drawing which obeys the constraints can have. Cost: some `n² m` steps.
///
/// # Errors
/// `Input` when the covariance does not fit, a constraint names a part that is not there, or the constraints
/// contradict each other (the smallest set that does is named); `Undetermined` when the search does not
/// settle on them.
///
/// # Examples
/// ```
/// use nalgebra::DMatrix;
/// use planish_contour::constraint::{BarId, Constraint, ParametricDrawing, impose};
///
/// let triangle = ParametricDrawing::polygon(&[[0.0, 0.0], [4.0, 0.1], [0.0, 3.0]])?;
/// let covariance = DMatrix::identity(6, 6) * 0.01;
/// let level = impose(&triangle, &covariance, &[Constraint::Horizontal { bar: BarId(0) }], 0.0)?;
/// assert!((level.drawing.values()[1] - 0.05).abs() < 1e-9 && (level.chi_square - 0.5).abs() < 1e-9);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// De Geeter, Van Brussel and De Schutter 1997, *A smoothly constrained Kalman filter*; Jazwinski 1970,
/// section 8.3.
pub fn impose(
    drawing: &ParametricDrawing,
    covariance: &DMatrix<f64>,
    constraints: &[Constraint],
    sigma: f64,
) -> Result<Imposed> {
    let start = Start { root: &square_root(covariance), near: None };
    impose_from(drawing, covariance, constraints, sigma, start)
}

/// What is known before constraints are imposed on an estimate again and again.
#[derive(Clone, Copy)]
pub(super) struct Start<'a> {
    /// [`square_root`] of the covariance.
    pub(super) root: &'a DMatrix<f64>,
    /// A drawing that obeys most of the constraints.
    pub(super) near: Option<&'a ParametricDrawing>,
}

/// [`impose`] with a head start.
pub(super) fn impose_from(
    drawing: &ParametricDrawing,
    covariance: &DMatrix<f64>,
    constraints: &[Constraint],
    sigma: f64,
    start: Start<'_>,
) -> Result<Imposed> {
    if !(sigma >= 0.0 && sigma.is_finite()) {
        return Err(Error::input(format!(
            "the σ with which constraints hold must not be negative, but is {sigma}"
        )));
    }
    constraints.iter().try_for_each(|constraint| constraint.require_parts(drawing))?;
    KalmanFilter::new(drawing.values(), covariance.clone())?;
    let near = start.near.map(|near| solve(near, constraints)).filter(|solution| solution.holds);
    let solution = near.unwrap_or_else(|| satisfy(drawing, constraints));
    if !solution.holds {
        return Err(contradiction(drawing, constraints));
    }
    let all = ConstraintEquations::new(drawing, constraints);
    let (_, jacobian) = all.residuals_and_jacobian(&solution.values);
    let spreads = &jacobian * start.root;
    let rank = row_rank(&spreads, &row_sigmas(&jacobian, covariance), KNOWN);
    let independent = all.clone().with_rows(&rank.independent);
    let degrees = independent.len();
    let updated = if degrees == 0 {
        Updated { mean: drawing.values(), covariance: covariance.clone(), chi_square: 0.0 }
    } else if sigma > 0.0 {
        with_noise(drawing, covariance, &independent, sigma)?
    } else {
        exactly(drawing, covariance, start.root, &independent, &solution.values)?
    };
    let left = all.residuals(&updated.mean);
    if sigma == 0.0 && !left.is_empty() && left.amax() > SETTLED {
        return Err(Error::undetermined(format!(
            "the estimate does not settle on the constraints: {} is still off by {:.1e} of the drawing's \
             extent",
            constraints[all.owners()[left.iamax()]].describe(drawing),
            left.amax()
        )));
    }
    let owners = all.owners();
    let moved = |constraint: &usize| rank.independent.iter().any(|&row| owners[row] == *constraint);
    Ok(Imposed {
        drawing: drawing.with_values(&updated.mean)?,
        covariance: updated.covariance,
        chi_square: updated.chi_square,
        degrees,
        p_value: chi_square_tail(updated.chi_square, degrees),
        implied: (0..constraints.len()).filter(|constraint| !moved(constraint)).collect(),
    })
}

/// An estimate after an update.
struct Updated {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    chi_square: f64,
}

fn with_noise(
    drawing: &ParametricDrawing,
    covariance: &DMatrix<f64>,
    equations: &ConstraintEquations<'_>,
    sigma: f64,
) -> Result<Updated> {
    let mut filter = KalmanFilter::new(drawing.values(), covariance.clone())?;
    let noise = DMatrix::identity(equations.len(), equations.len()) * (sigma * sigma);
    let innovation = filter.update_equation(equations, &noise, &EquationUpdate::iterated())?;
    Ok(Updated {
        mean: filter.mean().clone(),
        covariance: filter.covariance().clone(),
        chi_square: innovation.normalized_squared,
    })
}

/// The iterated update without noise in square roots: with `P = L Lᵀ` and `Lᵀ Hᵀ = Q R`,
/// `x ← x̂ − L Q R⁻ᵀ (f + H (x̂ − x))` from a place where the equations hold, `P ← L (I − Q Qᵀ) Lᵀ`.
///
/// # References
/// Björck 1996, *Numerical methods for least squares problems*, section 5.1 (the null-space method).
fn exactly(
    drawing: &ParametricDrawing,
    covariance: &DMatrix<f64>,
    root: &DMatrix<f64>,
    equations: &ConstraintEquations<'_>,
    start: &DVector<f64>,
) -> Result<Updated> {
    let estimate = drawing.values();
    let mut x = start.clone();
    let mut previous = f64::INFINITY;
    for _ in 0..MAX_ITERATIONS {
        let (residuals, jacobian) = equations.residuals_and_jacobian(&x);
        let (q, r) = (&jacobian * root).transpose().qr().unpack();
        let misclosure = residuals + &jacobian * (&estimate - &x);
        let Some(whitened) = r.tr_solve_upper_triangular(&misclosure) else {
            break;
        };
        let across = root * &q;
        let next = &estimate - &across * &whitened;
        let moved = (&next - &x).amax() / drawing.extent();
        x = next;
        if !moved.is_finite() {
            break;
        }
        // Nearly dependent equations magnify rounding: there it stalls earlier.
        if moved <= MOVED || (moved >= previous && moved <= STALLED) {
            let reduced = covariance - &across * across.transpose();
            return Ok(Updated {
                mean: x,
                covariance: 0.5 * (&reduced + reduced.transpose()),
                chi_square: whitened.norm_squared(),
            });
        }
        previous = moved;
    }
    Err(Error::undetermined(
        "the estimate does not settle on the constraints: they are far from what was measured",
    ))
}

/// σ of every row of `J x` if the components of `x` were independent.
pub(super) fn row_sigmas(jacobian: &DMatrix<f64>, covariance: &DMatrix<f64>) -> Vec<f64> {
    jacobian
        .row_iter()
        .map(|row| {
            let squares = row.iter().enumerate().map(|(j, slope)| slope * slope * covariance[(j, j)]);
            let sum: f64 = squares.sum();
            if sum > 0.0 { sum.sqrt() } else { 1.0 }
        })
        .collect()
}

/// `L` with `L Lᵀ = Σ`; a covariance may be singular.
pub(super) fn square_root(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let scale: DVector<f64> = covariance.diagonal().map(|d| if d > 0.0 { d.sqrt() } else { 1.0 });
    let scaled = DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |i, j| {
        covariance[(i, j)] / (scale[i] * scale[j])
    });
    let eigen = SymmetricEigen::new(scaled);
    let mut root = eigen.eigenvectors;
    for (j, value) in eigen.eigenvalues.iter().enumerate() {
        root.column_mut(j).scale_mut(value.max(0.0).sqrt());
    }
    for (i, factor) in scale.iter().enumerate() {
        root.row_mut(i).scale_mut(*factor);
    }
    root
}

/// The probability of a χ² of `degrees` degrees of freedom at least as large; 1 without any.
#[must_use]
pub fn chi_square_tail(chi_square: f64, degrees: usize) -> f64 {
    ChiSquared::new(degrees as f64).map_or(1.0, |distribution| distribution.sf(chi_square))
}

/// The χ² that is exceeded with a probability of `level`.
pub(super) fn chi_square_bound(level: f64, degrees: usize) -> f64 {
    ChiSquared::new(degrees as f64).map_or(0.0, |distribution| distribution.inverse_cdf(1.0 - level))
}

fn contradiction(drawing: &ParametricDrawing, constraints: &[Constraint]) -> Error {
    let found = quick_xplain(constraints.len(), |chosen| {
        let chosen: Vec<Constraint> = chosen.iter().map(|&i| constraints[i]).collect();
        satisfy(drawing, &chosen).holds
    });
    let names: Vec<String> = found.iter().map(|&i| constraints[i].describe(drawing)).collect();
    Error::input(format!(
        "these constraints cannot hold together: {}; leave one of them out",
        names.join("; ")
    ))
}
