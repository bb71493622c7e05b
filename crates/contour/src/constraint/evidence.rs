//! Test of one relation at an estimate: χ², probability of an accident, evidence, and linearity.

use super::candidates::Candidate;
use super::drawing::ParametricDrawing;
use super::draws::Draws;
use super::equations::{ConstraintEquations, Equation};
use super::impose::{Imposed, KNOWN_SIGMA, chi_square_bound, chi_square_tail, square_root};
use super::relation::Constraint;
use super::solve::solve;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::f64::consts::{PI, TAU};

/// An estimate, with random drawings from its distribution.
pub(super) struct State {
    drawing: ParametricDrawing,
    covariance: DMatrix<f64>,
    /// Random steps from the estimate by its covariance, each with the drawing after the imposed constraints
    /// are restored there.
    samples: Vec<(DVector<f64>, DVector<f64>)>,
}

/// Number of random drawings. Only the order of magnitude of the nonlinear part is needed.
const SAMPLES: u64 = 16;
/// Maximum variance of the nonlinear part, as a fraction of that of the linear part.
///
/// If accepted relations cancel the linear part except for the deviation of the estimate itself, both are of
/// comparable size, a hundred times this limit.
const MAX_NONLINEAR_SHARE: f64 = 0.01;
/// Scaled residual below which constraints are restored; `solve` reaches about as much.
const RESTORED: f64 = 1e-12;
/// Maximum number of steps with a fixed Jacobian, which converge linearly.
const CHORD_STEPS: usize = 12;
/// Smallest ratio of diagonal entries of a usable Cholesky factor.
const MIN_PIVOT_RATIO: f64 = 1e-6;
/// A residual below this fraction of its range is zero up to rounding.
const ZERO_RESIDUAL: f64 = 1e-6;

impl State {
    /// An estimate without imposed constraints; all relations count as linear there.
    pub(super) fn unconstrained(drawing: &ParametricDrawing, covariance: &DMatrix<f64>) -> Self {
        Self { drawing: drawing.clone(), covariance: covariance.clone(), samples: Vec::new() }
    }

    /// An estimate with imposed constraints, with samples.
    pub(super) fn new(estimate: &Imposed, imposed: &[Constraint]) -> Self {
        let mut state = Self::unconstrained(&estimate.drawing, &estimate.covariance);
        let values = estimate.drawing.values();
        let root = square_root(&estimate.covariance);
        let nearby = Nearby::new(&estimate.drawing, imposed);
        state.samples = (0..SAMPLES)
            .filter_map(|seed| {
                let step = &root * Draws::new(seed).spread(values.len());
                let moved = nearby.restored(&(&values + &step))?;
                Some((step, moved))
            })
            .collect();
        state
    }
}

/// Constraints that hold at a drawing and are to be restored at nearby drawings.
struct Nearby<'a> {
    drawing: &'a ParametricDrawing,
    imposed: &'a [Constraint],
    equations: ConstraintEquations<'a>,
    /// Slopes per extent where the constraints hold, and the factor of `J Jᵀ`; `None` if they are dependent.
    chord: Option<(DMatrix<f64>, Cholesky<f64, Dyn>)>,
}

impl<'a> Nearby<'a> {
    fn new(drawing: &'a ParametricDrawing, imposed: &'a [Constraint]) -> Self {
        let equations = ConstraintEquations::new(drawing, imposed);
        let (_, jacobian) = equations.residuals_and_jacobian(&drawing.values());
        let slopes = jacobian * drawing.extent();
        let factor = Cholesky::new(&slopes * slopes.transpose());
        // For dependent equations, rounding can make the factorisation succeed with a useless factor.
        let usable = factor.filter(|factor| {
            let diagonal = factor.l_dirty().diagonal();
            diagonal.iter().all(|d| *d > MIN_PIVOT_RATIO * diagonal.amax())
        });
        Self { drawing, imposed, equations, chord: usable.map(|factor| (slopes, factor)) }
    }

    /// A drawing near `values` that satisfies the constraints.
    ///
    /// Steps with the fixed Jacobian share one factorisation among all samples; [`solve`] is the fallback.
    fn restored(&self, values: &DVector<f64>) -> Option<DVector<f64>> {
        let size = self.drawing.extent();
        if let Some((slopes, factor)) = &self.chord {
            let mut x = values.clone();
            for _ in 0..CHORD_STEPS {
                let residuals = self.equations.residuals(&x);
                if residuals.is_empty() || residuals.amax() <= RESTORED {
                    return Some(x);
                }
                if !residuals.iter().all(|r| r.is_finite()) {
                    break;
                }
                x -= slopes.tr_mul(&factor.solve(&residuals)) * size;
            }
        }
        let moved = solve(&self.drawing.with_values(values).ok()?, self.imposed);
        moved.holds.then_some(moved.values)
    }
}

/// Result of the test of one relation.
pub(super) struct Test {
    pub(super) chi_square: f64,
    /// Number of equations that are not already known.
    pub(super) degrees: usize,
    pub(super) p_value: f64,
    /// Fraction of its range over which the relation would pass: the probability of an accident.
    pub(super) chance: f64,
    /// Log-likelihood ratio of the residual: the relation holds, against anywhere in its range.
    pub(super) log_evidence: f64,
    /// True if the residual is zero up to rounding.
    pub(super) holds: bool,
    /// True if the residual has a finite value.
    pub(super) is_defined: bool,
}

impl Test {
    /// For a relation that is undefined at the estimate, such as tangency of concentric circles.
    fn undefined(degrees: usize) -> Self {
        Self {
            chi_square: 0.0,
            degrees,
            p_value: 1.0,
            chance: 1.0,
            log_evidence: f64::NEG_INFINITY,
            holds: false,
            is_defined: false,
        }
    }
}

/// Level of a test, as bounds of χ².
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Level {
    /// Bounds for one and two degrees of freedom; constraints have no more equations.
    bounds: [f64; 2],
}

impl Level {
    pub(super) fn new(level: f64) -> Self {
        Self { bounds: [1, 2].map(|degrees| chi_square_bound(level, degrees)) }
    }
}

/// Tests a relation at a state; `reference` is the covariance before anything was imposed.
pub(super) fn test(candidate: &Candidate, state: &State, reference: &DMatrix<f64>, level: Level) -> Test {
    // Without copying the parameters: this runs for every candidate in every step of the search.
    let equations = candidate.constraint.equations(&state.drawing, state.drawing.raw_values());
    if !equations.iter().all(Equation::is_finite) {
        return Test::undefined(equations.len());
    }
    let known: Vec<f64> = equations.iter().map(|equation| KNOWN_SIGMA * sigma(equation, reference)).collect();
    let covariance = |a: &Equation, b: &Equation| -> f64 {
        let rows = a.gradient.iter().map(|&(i, slope)| {
            let row = b.gradient.iter().map(|&(j, other)| other * state.covariance[(i, j)]);
            slope * row.sum::<f64>()
        });
        rows.sum()
    };
    // χ² and the determinant of the covariance by a Cholesky step over at most two equations: the second one
    // is reduced by its regression on the first. A matrix would be allocated for every candidate and state.
    let (mut chi_square, mut determinant, mut degrees) = (0.0, 1.0, 0);
    let mut before: Option<(&Equation, f64)> = None;
    for (equation, known) in equations.iter().zip(&known) {
        let mut variance = covariance(equation, equation);
        let mut residual = equation.residual;
        if let Some((first, of_first)) = before {
            let slope = covariance(first, equation) / of_first;
            variance -= slope * slope * of_first;
            residual -= slope * first.residual;
        }
        // An equation with no variance left is known: its residual is rounding, and dividing by its variance
        // would make noise of it.
        if variance > known * known {
            chi_square += residual * residual / variance;
            determinant *= variance;
            degrees += 1;
            before = before.or(Some((equation, variance)));
        }
    }
    let holds = equations.iter().all(|equation| equation.residual.abs() <= ZERO_RESIDUAL * candidate.range);
    if degrees == 0 {
        return Test {
            chi_square: 0.0,
            degrees,
            p_value: 1.0,
            chance: 0.0,
            log_evidence: 0.0,
            holds,
            is_defined: true,
        };
    }
    // The window is a ball of the radius `reach` in whitened residuals; `volume` maps it into the range.
    let volume = determinant.sqrt() / candidate.range.powi(degrees as i32);
    let reach = level.bounds[degrees - 1].sqrt();
    // Volume of the unit ball: the window is an interval or an ellipse.
    let ball = if degrees == 1 { 2.0 } else { PI };
    Test {
        chi_square,
        degrees,
        p_value: chi_square_tail(chi_square, degrees),
        chance: ball * reach.powi(degrees as i32) * volume,
        log_evidence: -volume.ln() - 0.5 * degrees as f64 * TAU.ln() - 0.5 * chi_square,
        holds,
        is_defined: true,
    }
}

/// σ of a residual if the parameters were independent; 1 if it would be zero.
fn sigma(equation: &Equation, covariance: &DMatrix<f64>) -> f64 {
    let squares = equation.gradient.iter().map(|&(i, slope)| slope * slope * covariance[(i, i)]);
    let sum: f64 = squares.sum();
    if sum > 0.0 { sum.sqrt() } else { 1.0 }
}

/// True if the residual of a relation is linear over the samples: the part that the gradient does not explain
/// is small compared with the linear one, or rounding.
///
/// Near a rectangle, one pair of parallel sides makes the other two sides equal to first order. The test of
/// their equality is then meaningless: its variance is of second order (decision record 0045).
pub(super) fn is_linear(candidate: &Candidate, state: &State, reference: &DMatrix<f64>) -> bool {
    let equations = candidate.constraint.equations(&state.drawing, state.drawing.raw_values());
    let mut linear = vec![0.0; equations.len()];
    let mut rest = vec![0.0; equations.len()];
    for (step, values) in &state.samples {
        // The step is the linear prediction; the sample after restoring the constraints is the truth.
        let moved = candidate.constraint.equations(&state.drawing, values.as_slice());
        for (row, (equation, moved)) in equations.iter().zip(&moved).enumerate() {
            let predicted: f64 = equation.gradient.iter().map(|&(i, slope)| slope * step[i]).sum();
            linear[row] += predicted * predicted;
            rest[row] += (moved.residual - equation.residual - predicted).powi(2);
        }
    }
    let count = state.samples.len() as f64;
    equations.iter().enumerate().all(|(row, equation)| {
        let rounding = ZERO_RESIDUAL * sigma(equation, reference);
        rest[row] <= (MAX_NONLINEAR_SHARE * linear[row]).max(rounding * rounding * count)
    })
}
