//! The test of one relation at an estimate: χ², chance, evidence.

use super::candidates::Candidate;
use super::drawing::Drawing;
use super::draws::Draws;
use super::equations::Equation;
use super::impose::{KNOWN, chi_square_bound, chi_square_tail, square_root};
use super::rank::row_rank;
use super::relation::Constraint;
use super::solve::solve;
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Result, normalized_squared};
use std::f64::consts::{PI, TAU};

/// An estimate, and drawings that it could as well be.
pub(super) struct State {
    drawing: Drawing,
    /// `L` with `L Lᵀ` the covariance.
    root: DMatrix<f64>,
    /// Steps from the estimate by its covariance, and where they lead when what was imposed is restored.
    others: Vec<(DVector<f64>, DVector<f64>)>,
}

/// Enough to tell the size of what is not linear.
const OTHERS: u64 = 8;
/// The share of the linear part's variance that may come from the rest. Where accepted relations cancel the linear
/// part but for the estimate's own deviations, both are of one size.
const STRAIGHT: f64 = 0.01;
/// A residual is zero below this share of its range.
const ZERO: f64 = 1e-6;

impl State {
    /// An estimate on which nothing was imposed: it is taken as linear.
    pub(super) fn unconstrained(drawing: &Drawing, covariance: &DMatrix<f64>) -> Self {
        Self {
            drawing: drawing.clone(),
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

impl Test {
    /// Of a relation without a value where the estimate is, such as tangent circles about one centre: it says nothing.
    fn undefined(degrees: usize) -> Self {
        Self {
            chi_square: 0.0,
            degrees,
            p_value: 1.0,
            chance: 1.0,
            log_evidence: f64::NEG_INFINITY,
            holds: false,
            is_linear: false,
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
        Self {
            bounds: [1, 2].map(|degrees| chi_square_bound(level, degrees)),
        }
    }
}

/// Tests a relation at a state; `reference` is the covariance before anything was imposed.
pub(super) fn test(candidate: &Candidate, state: &State, reference: &DMatrix<f64>, level: Level) -> Result<Test> {
    let equations = candidate
        .constraint
        .equations(&state.drawing, state.drawing.values().as_slice());
    if !equations.iter().all(Equation::is_finite) {
        return Ok(Test::undefined(equations.len()));
    }
    let sizes: Vec<f64> = equations.iter().map(|equation| sigma(equation, reference)).collect();
    let spreads = spreads(&equations, &state.root);
    let rows = row_rank(&spreads, &sizes, KNOWN).independent;
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
        is_linear: is_linear(candidate, state, &equations, &sizes),
    };
    if degrees == 0 {
        return Ok(found);
    }
    let chosen = spreads.select_rows(&rows);
    let residual = DVector::from_iterator(degrees, rows.iter().map(|&row| equations[row].residual));
    let covariance = &chosen * chosen.transpose();
    let volume = covariance.determinant().max(0.0).sqrt() / candidate.range.powi(degrees as i32);
    let reach = level.bounds[degrees - 1].sqrt();
    // An interval, or an ellipse.
    let ball = if degrees == 1 { 2.0 } else { PI };
    found.chi_square = normalized_squared(&residual, &covariance)?;
    found.p_value = chi_square_tail(found.chi_square, degrees);
    found.chance = ball * reach.powi(degrees as i32) * volume;
    found.log_evidence = -volume.ln() - 0.5 * degrees as f64 * TAU.ln() - 0.5 * found.chi_square;
    Ok(found)
}

/// `J L`, row by row: the covariance of the residuals is its product with its transpose.
fn spreads(equations: &[Equation], root: &DMatrix<f64>) -> DMatrix<f64> {
    let mut spreads = DMatrix::zeros(equations.len(), root.ncols());
    for (row, equation) in equations.iter().enumerate() {
        for column in 0..root.ncols() {
            let products = equation.gradient.iter().map(|&(i, slope)| slope * root[(i, column)]);
            spreads[(row, column)] = products.sum();
        }
    }
    spreads
}

/// σ of a residual if the parameters were independent.
fn sigma(equation: &Equation, covariance: &DMatrix<f64>) -> f64 {
    let squares = equation
        .gradient
        .iter()
        .map(|&(i, slope)| slope * slope * covariance[(i, i)]);
    let sum: f64 = squares.sum();
    if sum > 0.0 { sum.sqrt() } else { 1.0 }
}

/// Whether what the linear part leaves unexplained at the other drawings is small against it, or rounding.
fn is_linear(candidate: &Candidate, state: &State, equations: &[Equation], sizes: &[f64]) -> bool {
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
    (0..equations.len()).all(|row| rest[row] <= (STRAIGHT * linear[row]).max((ZERO * sizes[row]).powi(2) * count))
}
