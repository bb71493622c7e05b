//! The test of one relation at an estimate: χ², chance, evidence.

use super::candidates::Candidate;
use super::drawing::Drawing;
use super::draws::Draws;
use super::equations::Equation;
use super::impose::{chi_square_bound, chi_square_tail, known_rows, row_sigmas, square_root};
use super::relation::Constraint;
use super::solve::solve;
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Result, normalized_squared};
use std::f64::consts::{PI, TAU};

/// An estimate, and drawings that it could as well be.
pub(super) struct State {
    drawing: Drawing,
    covariance: DMatrix<f64>,
    /// `L` with `L Lᵀ` the covariance.
    root: DMatrix<f64>,
    /// Steps from the estimate by its covariance, and where they lead when what was imposed is restored.
    others: Vec<(DVector<f64>, DVector<f64>)>,
}

/// Enough to tell the size of what is not linear.
const OTHERS: u64 = 8;
/// The share of the linear part's variance that may come from the rest. Where accepted relations cancel the linear part but for the estimate's own
/// deviations, both are of one size.
const STRAIGHT: f64 = 0.01;
/// A residual is zero below this share of its range.
const ZERO: f64 = 1e-6;

impl State {
    /// An estimate on which nothing was imposed: it is taken as linear.
    pub(super) fn unconstrained(drawing: &Drawing, covariance: &DMatrix<f64>) -> Self {
        Self {
            drawing: drawing.clone(),
            covariance: covariance.clone(),
            root: square_root(covariance),
            others: Vec::new(),
        }
    }

    /// An estimate on which constraints were imposed.
    pub(super) fn new(drawing: &Drawing, covariance: &DMatrix<f64>, imposed: &[Constraint]) -> Self {
        let mut state = Self::unconstrained(drawing, covariance);
        let values = drawing.values();
        state.others = (0..OTHERS)
            .filter_map(|seed| {
                let step = &state.root * Draws::new(seed).spread(values.len());
                let moved = solve(&drawing.with_values(&(&values + &step)).ok()?, imposed);
                moved.holds.then_some((step, moved.values))
            })
            .collect();
        state
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
    /// Whether the residual's spread is that of its linear part.
    pub(super) is_linear: bool,
}

/// Tests a relation at a state; `reference` is the covariance before anything was imposed.
pub(super) fn test(candidate: &Candidate, state: &State, reference: &DMatrix<f64>, level: f64) -> Result<Test> {
    let equations = candidate
        .constraint
        .equations(&state.drawing, state.drawing.values().as_slice());
    let jacobian = jacobian(&equations, state.drawing.parameters());
    let rows = known_rows(&jacobian, &state.root, reference).independent;
    let degrees = rows.len();
    let mut found = Test {
        chi_square: 0.0,
        degrees,
        p_value: 1.0,
        chance: 0.0,
        log_evidence: 0.0,
        holds: equations
            .iter()
            .all(|equation| equation.residual.abs() <= ZERO * candidate.range),
        is_linear: is_linear(candidate, state, &equations, &jacobian, reference),
    };
    if degrees == 0 {
        return Ok(found);
    }
    let chosen = jacobian.select_rows(&rows);
    let residual = DVector::from_iterator(degrees, rows.iter().map(|&row| equations[row].residual));
    let product = &chosen * &state.covariance * chosen.transpose();
    let spread = (&product + product.transpose()) * 0.5;
    let volume = spread.determinant().max(0.0).sqrt() / candidate.range.powi(degrees as i32);
    let reach = chi_square_bound(level, degrees).sqrt();
    // Constraints have at most two equations: an interval, or an ellipse.
    let ball = if degrees == 1 { 2.0 } else { PI };
    found.chi_square = normalized_squared(&residual, &spread)?;
    found.p_value = chi_square_tail(found.chi_square, degrees);
    found.chance = ball * reach.powi(degrees as i32) * volume;
    found.log_evidence = -volume.ln() - 0.5 * degrees as f64 * TAU.ln() - 0.5 * found.chi_square;
    Ok(found)
}

fn jacobian(equations: &[Equation], parameters: usize) -> DMatrix<f64> {
    let mut jacobian = DMatrix::zeros(equations.len(), parameters);
    for (row, equation) in equations.iter().enumerate() {
        for &(parameter, slope) in &equation.gradient {
            jacobian[(row, parameter)] += slope;
        }
    }
    jacobian
}

/// Whether what the linear part leaves unexplained at the other drawings is small against it, or rounding.
fn is_linear(
    candidate: &Candidate,
    state: &State,
    equations: &[Equation],
    jacobian: &DMatrix<f64>,
    reference: &DMatrix<f64>,
) -> bool {
    let sizes = row_sigmas(jacobian, reference);
    let mut linear = vec![0.0; equations.len()];
    let mut rest = vec![0.0; equations.len()];
    for (step, values) in &state.others {
        let there = candidate.constraint.equations(&state.drawing, values.as_slice());
        for (row, equation) in there.iter().enumerate() {
            let predicted = (jacobian.row(row) * step)[0];
            linear[row] += predicted * predicted;
            rest[row] += (equation.residual - equations[row].residual - predicted).powi(2);
        }
    }
    let count = state.others.len() as f64;
    (0..equations.len()).all(|row| rest[row] <= (STRAIGHT * linear[row]).max((ZERO * sizes[row]).powi(2) * count))
}
