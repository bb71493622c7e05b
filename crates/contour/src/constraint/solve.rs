//! The nearest drawing that obeys constraints, found by damped steps from where it is.
//!
//! Comes in: a drawing and constraints. Goes out: parameters, and whether all constraints hold there. Not
//! guaranteed: that a drawing which obeys them is found where one exists far from the start.

use super::drawing::ParametricDrawing;
use super::equations::ConstraintEquations;
use super::relation::Constraint;
use nalgebra::{Cholesky, DMatrix, DVector};

/// Where the search for a drawing that obeys constraints ended.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstraintSolution {
    /// The parameters.
    pub values: DVector<f64>,
    /// Whether all constraints hold, and no bar or circle has shrunk to nothing for it.
    pub holds: bool,
    /// The largest residual, lengths divided by the drawing's extent.
    pub residual: f64,
}

/// Residuals below this are rounding of a drawing of extent 1.
const HOLDS: f64 = 1e-10;
/// A bar or circle this much smaller than the drawing has collapsed.
const COLLAPSED: f64 = 1e-6;
const MAX_STEPS: usize = 200;

/// Moves a drawing as little as possible until constraints hold: steps `−Jᵀ (J Jᵀ + λ I)⁻¹ f` with
/// `λ = min(|f|², 10⁻³)`.
///
/// Redundant constraints do no harm. Cost: `m² n + m³` a step, for `m` equations of `n` parameters; a few
/// steps where it succeeds.
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
/// converges quadratically also where `J` has no full rank).
#[must_use]
pub fn solve(drawing: &ParametricDrawing, constraints: &[Constraint]) -> ConstraintSolution {
    let equations = ConstraintEquations::new(drawing, constraints);
    let size = drawing.extent();
    let mut x = drawing.values();
    let (mut residuals, mut jacobian) = equations.residuals_and_jacobian(&x);
    let mut damping = 1.0;
    for _ in 0..MAX_STEPS {
        // Past the threshold, the last steps cost little and reach rounding.
        if residuals.amax() <= 1e-3 * HOLDS {
            break;
        }
        let Some(step) = damped_step(&jacobian, &residuals, size, damping) else {
            break;
        };
        let moved = &x + &step;
        let (new_residuals, new_jacobian) = equations.residuals_and_jacobian(&moved);
        if new_residuals.norm() < residuals.norm() {
            let stalled = new_residuals.norm() > (1.0 - 1e-9) * residuals.norm();
            (x, residuals, jacobian) = (moved, new_residuals, new_jacobian);
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
    let holds = residual <= HOLDS && !has_collapsed(drawing, &x);
    ConstraintSolution { values: x, holds, residual }
}

fn damped_step(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    size: f64,
    damping: f64,
) -> Option<DVector<f64>> {
    // Residuals are pure numbers; so are these slopes, per extent of the drawing.
    let slopes = jacobian * size;
    let mut normal = &slopes * slopes.transpose();
    let lambda = (damping * residuals.norm_squared()).min(damping * 1e-3).max(1e-14);
    for i in 0..normal.nrows() {
        normal[(i, i)] += lambda;
    }
    let factor = Cholesky::new(normal)?;
    Some(slopes.transpose() * factor.solve(residuals) * -size)
}

fn has_collapsed(drawing: &ParametricDrawing, x: &DVector<f64>) -> bool {
    let Ok(moved) = drawing.with_values(x) else {
        return true;
    };
    let smallest = COLLAPSED * drawing.extent();
    moved.bars().any(|bar| moved.length(bar) < smallest)
        || moved.circles().any(|circle| moved.radius(circle) < smallest)
}
