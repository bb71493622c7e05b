//! A nearby drawing that satisfies constraints, by damped Gauss–Newton steps.
//!
//! In: a drawing and constraints. Out: parameters, and whether all constraints hold there. Not guaranteed:
//! that a solution far from the start is found.

use super::drawing::ParametricDrawing;
use super::equations::ConstraintEquations;
use super::relation::Constraint;
use nalgebra::{Cholesky, DMatrix, DVector};

/// Result of the search for a drawing that satisfies constraints.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstraintSolution {
    /// Final parameters.
    pub values: DVector<f64>,
    /// True if all constraints hold and no bar or circle has collapsed.
    pub holds: bool,
    /// Largest absolute residual; lengths are divided by the extent of the drawing.
    pub residual: f64,
}

/// Scaled residuals below this count as satisfied: far above rounding, far below any tolerance of a drawing.
const RESIDUAL_TOLERANCE: f64 = 1e-10;
/// Bars and circles smaller than this fraction of the drawing have collapsed.
///
/// Conflicting lengths can often be satisfied by shrinking parts to points, which is no solution.
const MIN_SIZE: f64 = 1e-6;
/// Maximum number of steps. A consistent system needs a few; the limit ends the search in conflicting ones.
const MAX_STEPS: usize = 200;

/// Moves a drawing until constraints hold, by steps `−Jᵀ (J Jᵀ + λ I)⁻¹ f` with `λ = min(|f|², 10⁻³)`.
///
/// Each step is the shortest one that reduces the residuals, so the drawing moves little. Redundant
/// constraints do no harm. Cost: `m² n + m³` per step for `m` equations of `n` parameters; a few steps if it
/// succeeds.
///
/// # Examples
/// ```
/// use planish_contour::constraint::{BarId, Constraint, ParametricDrawing, solve};
///
/// let drawing = ParametricDrawing::polygon(&[[0.0, 0.0], [4.1, 0.2], [4.0, 3.0]])?;
/// let solution = solve(&drawing, &[Constraint::Horizontal { bar: BarId(0) }]);
/// assert!(solution.holds && (solution.values[3] - 0.1).abs() < 1e-9);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Yamashita and Fukushima 2001, *On the rate of convergence of the Levenberg–Marquardt method* (this `λ`
/// also converges quadratically if `J` is rank-deficient).
#[must_use]
pub fn solve(drawing: &ParametricDrawing, constraints: &[Constraint]) -> ConstraintSolution {
    let equations = ConstraintEquations::new(drawing, constraints);
    let size = drawing.extent();
    let mut x = drawing.values();
    let (mut residuals, mut jacobian) = equations.residuals_and_jacobian(&x);
    let mut damping = 1.0;
    for _ in 0..MAX_STEPS {
        // Continue past the tolerance: the last quadratic steps cost little and reach rounding.
        if residuals.amax() <= 1e-3 * RESIDUAL_TOLERANCE {
            break;
        }
        let Some(step) = damped_step(&jacobian, &residuals, size, damping) else {
            break;
        };
        let moved = &x + &step;
        let (new_residuals, new_jacobian) = equations.residuals_and_jacobian(&moved);
        if new_residuals.norm() < residuals.norm() {
            // Progress this small means a local minimum with positive residuals: the constraints conflict.
            let stalled = new_residuals.norm() > (1.0 - 1e-9) * residuals.norm();
            (x, residuals, jacobian) = (moved, new_residuals, new_jacobian);
            // Less damping after success, down to a bound: λ also shrinks with the residuals.
            damping = (0.3 * damping).max(1e-3);
            if stalled {
                break;
            }
        } else if step.norm() <= f64::EPSILON * size || damping > 1e8 {
            break;
        } else {
            damping *= 10.0;
        }
    }
    let residual = if residuals.is_empty() { 0.0 } else { residuals.amax() };
    let holds = residual <= RESIDUAL_TOLERANCE && !has_collapsed(drawing, &x);
    ConstraintSolution { values: x, holds, residual }
}

/// One damped step, or `None` if the damped normal matrix is not positive definite.
fn damped_step(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    size: f64,
    damping: f64,
) -> Option<DVector<f64>> {
    // Residuals are dimensionless. Slopes per extent of the drawing are, too, so that λ suits any unit.
    let slopes = jacobian * size;
    let mut normal = &slopes * slopes.transpose();
    // The floor keeps redundant constraints from making the normal matrix singular.
    let lambda = (damping * residuals.norm_squared()).min(damping * 1e-3).max(1e-14);
    for i in 0..normal.nrows() {
        normal[(i, i)] += lambda;
    }
    let factor = Cholesky::new(normal)?;
    Some(slopes.transpose() * factor.solve(residuals) * -size)
}

/// True if a bar or circle is smaller than [`MIN_SIZE`] of the drawing.
fn has_collapsed(drawing: &ParametricDrawing, x: &DVector<f64>) -> bool {
    let Ok(moved) = drawing.with_values(x) else {
        return true;
    };
    let smallest = MIN_SIZE * drawing.extent();
    moved.bars().any(|bar| moved.length(bar) < smallest)
        || moved.circles().any(|circle| moved.radius(circle) < smallest)
}
