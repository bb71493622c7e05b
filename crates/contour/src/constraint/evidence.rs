//! The test of one relation at an estimate: χ², chance, evidence.

use super::candidates::Candidate;
use super::drawing::ParametricDrawing;
use super::draws::Draws;
use super::equations::{ConstraintEquations, Equation};
use super::impose::{Imposed, KNOWN, chi_square_bound, chi_square_tail, square_root};
use super::relation::Constraint;
use super::solve::solve;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::f64::consts::{PI, TAU};

/// An estimate, and drawings that it could as well be.
pub(super) struct State {
    drawing: ParametricDrawing,
    covariance: DMatrix<f64>,
    /// Steps from the estimate by its covariance, and where they lead when what was imposed is restored.
    others: Vec<(DVector<f64>, DVector<f64>)>,
}

/// Enough to tell the size of what is not linear.
const OTHERS: u64 = 16;
/// The share of the linear part's variance that may come from the rest. Where accepted relations cancel the
/// linear part but for the estimate's own deviations, both are of one size.
const STRAIGHT: f64 = 0.01;
/// Scaled residuals of a drawing at which constraints are restored, as `solve` leaves them.
const RESTORED: f64 = 1e-12;
const CHORD_STEPS: usize = 12;
/// The smallest diagonal entry of a factor over the largest.
const SOUND: f64 = 1e-6;
/// A residual is zero below this share of its range.
const ZERO: f64 = 1e-6;

impl State {
    /// An estimate on which nothing was imposed: it is taken as linear.
    pub(super) fn unconstrained(drawing: &ParametricDrawing, covariance: &DMatrix<f64>) -> Self {
        Self { drawing: drawing.clone(), covariance: covariance.clone(), others: Vec::new() }
    }

    /// An estimate on which constraints were imposed.
    pub(super) fn new(estimate: &Imposed, imposed: &[Constraint]) -> Self {
        let mut state = Self::unconstrained(&estimate.drawing, &estimate.covariance);
        let values = estimate.drawing.values();
        let root = square_root(&estimate.covariance);
        let nearby = Nearby::new(&estimate.drawing, imposed);
        state.others = (0..OTHERS)
            .filter_map(|seed| {
                let step = &root * Draws::new(seed).spread(values.len());
                let moved = nearby.restored(&(&values + &step))?;
                Some((step, moved))
            })
            .collect();
        state
    }
}

/// Constraints that hold at a drawing, to be restored at drawings nearby.
struct Nearby<'a> {
    drawing: &'a ParametricDrawing,
    imposed: &'a [Constraint],
    equations: ConstraintEquations<'a>,
    /// Slopes per extent where the constraints hold, and the factor of `J Jᵀ`; none where they are not
    /// independent.
    chord: Option<(DMatrix<f64>, Cholesky<f64, Dyn>)>,
}

impl<'a> Nearby<'a> {
    fn new(drawing: &'a ParametricDrawing, imposed: &'a [Constraint]) -> Self {
        let equations = ConstraintEquations::new(drawing, imposed);
        let (_, jacobian) = equations.residuals_and_jacobian(&drawing.values());
        let slopes = jacobian * drawing.extent();
        let factor = Cholesky::new(&slopes * slopes.transpose());
        // Of dependent equations, rounding may leave a factor of no use.
        let sound = factor.filter(|factor| {
            let diagonal = factor.l_dirty().diagonal();
            diagonal.iter().all(|d| *d > SOUND * diagonal.amax())
        });
        Self { drawing, imposed, equations, chord: sound.map(|factor| (slopes, factor)) }
    }

    /// A drawing that obeys the constraints: steps with the slopes of the first one, and where these do not
    /// lead there, the search from anew.
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

/// A test of one constraint at a state.
pub(super) struct Test {
    pub(super) chi_square: f64,
    /// Equations that are not known already.
    pub(super) degrees: usize,
    pub(super) p_value: f64,
    /// The share of its range in which the relation would pass.
    pub(super) chance: f64,
    /// `ln` of how much likelier the residual is if the relation holds than if it is anywhere in its range.
    pub(super) log_evidence: f64,
    /// Whether the residual is zero but for rounding.
    pub(super) holds: bool,
    /// Whether it has a value at all.
    pub(super) is_defined: bool,
}

impl Test {
    /// Of a relation without a value where the estimate is, such as tangent circles about one centre: it says
    /// nothing.
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

/// The level of a test, with the χ² it allows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Level {
    /// By degrees of freedom, one or two: constraints have no more equations.
    bounds: [f64; 2],
}

impl Level {
    pub(super) fn new(level: f64) -> Self {
        Self { bounds: [1, 2].map(|degrees| chi_square_bound(level, degrees)) }
    }
}

/// Tests a relation at a state; `reference` is the covariance before anything was imposed.
pub(super) fn test(candidate: &Candidate, state: &State, reference: &DMatrix<f64>, level: Level) -> Test {
    let equations = candidate.constraint.equations(&state.drawing, state.drawing.raw_values());
    if !equations.iter().all(Equation::is_finite) {
        return Test::undefined(equations.len());
    }
    let known: Vec<f64> = equations.iter().map(|equation| KNOWN * sigma(equation, reference)).collect();
    let covariance = |a: &Equation, b: &Equation| -> f64 {
        let rows = a.gradient.iter().map(|&(i, slope)| {
            let row = b.gradient.iter().map(|&(j, other)| other * state.covariance[(i, j)]);
            slope * row.sum::<f64>()
        });
        rows.sum()
    };
    // χ² and the volume's square, equation after equation, each less what the one before it says.
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
        if variance > known * known {
            chi_square += residual * residual / variance;
            determinant *= variance;
            degrees += 1;
            before = before.or(Some((equation, variance)));
        }
    }
    let holds = equations.iter().all(|equation| equation.residual.abs() <= ZERO * candidate.range);
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
    let volume = determinant.sqrt() / candidate.range.powi(degrees as i32);
    let reach = level.bounds[degrees - 1].sqrt();
    // An interval, or an ellipse.
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

/// σ of a residual if the parameters were independent.
fn sigma(equation: &Equation, covariance: &DMatrix<f64>) -> f64 {
    let squares = equation.gradient.iter().map(|&(i, slope)| slope * slope * covariance[(i, i)]);
    let sum: f64 = squares.sum();
    if sum > 0.0 { sum.sqrt() } else { 1.0 }
}

/// Whether a relation's residual spreads as its linear part does: what that leaves unexplained at the other
/// drawings is small against it, or rounding.
pub(super) fn is_linear(candidate: &Candidate, state: &State, reference: &DMatrix<f64>) -> bool {
    let equations = candidate.constraint.equations(&state.drawing, state.drawing.raw_values());
    let mut linear = vec![0.0; equations.len()];
    let mut rest = vec![0.0; equations.len()];
    for (step, values) in &state.others {
        let there = candidate.constraint.equations(&state.drawing, values.as_slice());
        for (row, (here, there)) in equations.iter().zip(&there).enumerate() {
            let predicted: f64 = here.gradient.iter().map(|&(i, slope)| slope * step[i]).sum();
            linear[row] += predicted * predicted;
            rest[row] += (there.residual - here.residual - predicted).powi(2);
        }
    }
    let count = state.others.len() as f64;
    equations.iter().enumerate().all(|(row, equation)| {
        let rounding = ZERO * sigma(equation, reference);
        rest[row] <= (STRAIGHT * linear[row]).max(rounding * rounding * count)
    })
}
