//! Constraints imposed on an estimate, as measurements of zero or small covariance.
//!
//! In: a drawing whose parameters are an estimate, its covariance, constraints. Out: the most likely drawing
//! that satisfies them, its covariance, and the χ² of the change. Not guaranteed: the nearest solution if the
//! constraints have several branches.

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
    /// The most likely drawing that satisfies the constraints.
    pub drawing: ParametricDrawing,
    /// Covariance of its parameters, singular in the directions that the constraints fix.
    pub covariance: DMatrix<f64>,
    /// Squared Mahalanobis distance between the drawing and the unconstrained estimate.
    pub chi_square: f64,
    /// Degrees of freedom of `chi_square`: the number of independent equations.
    pub degrees: usize,
    /// Probability of a χ² at least as large if the constraints are true.
    pub p_value: f64,
    /// Indices of constraints that earlier ones or the estimate imply.
    pub implied: Vec<usize>,
}

/// Relative σ of a residual below which it is already known.
///
/// The reference is σ with independent parameters. The square of this ratio, 1e-12, must stay above the
/// rounding of a covariance.
pub(super) const KNOWN_SIGMA: f64 = 1e-6;
/// Converged if a step is below this fraction of the extent.
const STEP_TOLERANCE: f64 = 1e-12;
/// Largest step, as a fraction of the extent, at which a stalled iteration counts as converged.
const STALL_TOLERANCE: f64 = 1e-7;
/// Maximum number of iterations of the exact update.
const MAX_ITERATIONS: usize = 100;
/// Largest scaled residual of a successfully imposed constraint.
const RESIDUAL_TOLERANCE: f64 = 1e-8;

/// Imposes constraints on an estimate by the iterated Kalman filter, as measurements `f(x) = 0` with `R = σ²
/// I`.
///
/// `covariance` is that of the parameters of the drawing and may be singular. `sigma` is the σ with which the
/// constraints hold: angles in radians, lengths as fractions of the extent of the drawing. Zero means
/// exactly, and uses a square-root form. At the fixed point, `χ² = (x − x̂)ᵀ P⁻¹ (x − x̂)` is the minimum
/// over all drawings that satisfy the constraints. Cost: `n² m` per iteration.
///
/// # Errors
/// `Input` if the covariance does not fit, a constraint refers to a part that the drawing does not have, or
/// the constraints conflict (the message lists a minimal set); `Undetermined` if the iteration does not
/// converge.
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

/// Precomputed data for imposing several sets of constraints on the same estimate.
#[derive(Clone, Copy)]
pub(super) struct Start<'a> {
    /// [`square_root`] of the covariance.
    pub(super) root: &'a DMatrix<f64>,
    /// A drawing that satisfies most of the constraints.
    pub(super) near: Option<&'a ParametricDrawing>,
}

/// [`impose`] with precomputed data.
pub(super) fn impose_from(
    drawing: &ParametricDrawing,
    covariance: &DMatrix<f64>,
    constraints: &[Constraint],
    sigma: f64,
    start: Start<'_>,
) -> Result<Imposed> {
    if !(sigma >= 0.0 && sigma.is_finite()) {
        return Err(Error::input(format!("expected σ of at least 0 of the constraints, found {sigma}")));
    }
    constraints.iter().try_for_each(|constraint| constraint.require_parts(drawing))?;
    // Only for its checks of the covariance: size, symmetry, finite values.
    KalmanFilter::new(drawing.values(), covariance.clone())?;
    // A drawing that satisfies most constraints already is a better start than the estimate: it keeps the
    // branch, and the search takes fewer steps.
    let near = start.near.map(|near| solve(near, constraints)).filter(|solution| solution.holds);
    let solution = near.unwrap_or_else(|| satisfy(drawing, constraints));
    if !solution.holds {
        return Err(contradiction(drawing, constraints));
    }
    // Independence is judged where the constraints hold. At a noisy estimate, redundant ones look
    // independent: all four right angles of a rectangle, for example.
    let all = ConstraintEquations::new(drawing, constraints);
    let (_, jacobian) = all.residuals_and_jacobian(&solution.values);
    let spreads = &jacobian * start.root;
    let rank = row_rank(&spreads, &row_sigmas(&jacobian, covariance), KNOWN_SIGMA);
    let independent = all.clone().with_rows(&rank.independent);
    let degrees = independent.len();
    // Dependent rows would make the innovation covariance singular, so only independent ones are imposed.
    let updated = if degrees == 0 {
        Updated { mean: drawing.values(), covariance: covariance.clone(), chi_square: 0.0 }
    } else if sigma > 0.0 {
        with_noise(drawing, covariance, &independent, sigma)?
    } else {
        exactly(drawing, covariance, start.root, &independent, &solution.values)?
    };
    // The dependent rows were left out: check that they hold as well.
    let left = all.residuals(&updated.mean);
    if sigma == 0.0 && !left.is_empty() && left.amax() > RESIDUAL_TOLERANCE {
        return Err(Error::undetermined(format!(
            "the estimate does not converge to the constraints: the error of {} is {:.1e} of the extent of \
             the drawing",
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

/// Result of an update.
struct Updated {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    chi_square: f64,
}

/// The iterated update with noise of σ.
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

/// The iterated update without noise in square-root form, from a point where the equations hold.
///
/// With `P = L Lᵀ` and `Lᵀ Hᵀ = Q R`: `x ← x̂ − L Q R⁻ᵀ (f + H (x̂ − x))` and `P ← L (I − Q Qᵀ) Lᵀ`. The
/// innovation covariance `H P Hᵀ` is never formed: it squares the condition number, and with `R = 0` nothing
/// regularises it.
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
        // Nearly dependent equations amplify rounding, so that steps stop shrinking above the tolerance.
        if moved <= STEP_TOLERANCE || (moved >= previous && moved <= STALL_TOLERANCE) {
            // Symmetrised below: rounding would otherwise accumulate over many steps of a search.
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
        "the estimate does not converge to the constraints: they are far from the measurements",
    ))
}

/// σ of each row of `J x` if the components of `x` were independent; 1 if it would be zero.
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

/// A square root `L` with `L Lᵀ = Σ`, from eigenvalues because Σ may be singular.
///
/// Σ is scaled to unit diagonal first, as parameters may differ by orders of magnitude.
pub(super) fn square_root(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let scale: DVector<f64> = covariance.diagonal().map(|d| if d > 0.0 { d.sqrt() } else { 1.0 });
    let scaled = DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |i, j| {
        covariance[(i, j)] / (scale[i] * scale[j])
    });
    let eigen = SymmetricEigen::new(scaled);
    let mut root = eigen.eigenvectors;
    for (j, value) in eigen.eigenvalues.iter().enumerate() {
        // Eigenvalues of a singular matrix can be slightly negative by rounding.
        root.column_mut(j).scale_mut(value.max(0.0).sqrt());
    }
    for (i, factor) in scale.iter().enumerate() {
        root.row_mut(i).scale_mut(*factor);
    }
    root
}

/// Probability of a χ² with `degrees` degrees of freedom at least as large; 1 with zero degrees.
///
/// # Examples
/// ```
/// use planish_contour::constraint::chi_square_tail;
///
/// assert!((chi_square_tail(3.841, 1) - 0.05).abs() < 1e-4);
/// assert_eq!(chi_square_tail(3.841, 0), 1.0);
/// ```
#[must_use]
pub fn chi_square_tail(chi_square: f64, degrees: usize) -> f64 {
    ChiSquared::new(degrees as f64).map_or(1.0, |distribution| distribution.sf(chi_square))
}

/// The χ² that is exceeded with probability `level`.
pub(super) fn chi_square_bound(level: f64, degrees: usize) -> f64 {
    ChiSquared::new(degrees as f64).map_or(0.0, |distribution| distribution.inverse_cdf(1.0 - level))
}

/// Error that lists a minimal set of conflicting constraints.
fn contradiction(drawing: &ParametricDrawing, constraints: &[Constraint]) -> Error {
    let found = quick_xplain(constraints.len(), |chosen| {
        let chosen: Vec<Constraint> = chosen.iter().map(|&i| constraints[i]).collect();
        satisfy(drawing, &chosen).holds
    });
    let names: Vec<String> = found.iter().map(|&i| constraints[i].describe(drawing)).collect();
    Error::input(format!("these constraints conflict: {}; remove one of them", names.join("; ")))
}
