//! χ² of sets of constraints to first order, for the many questions of which of them quarrel.
//!
//! Comes in: an estimate, and constraints linearised where they nearly hold. Goes out: what a set of them
//! costs the estimate. Not guaranteed: second-order terms, which a last look with the real equations must
//! take.

use super::drawing::ParametricDrawing;
use super::equations::ConstraintEquations;
use super::impose::{KNOWN, row_sigmas};
use super::relation::Constraint;
use nalgebra::{DMatrix, DVector};

/// Constraints as rows `a = L^T h` of whitened slopes with their misclosures at the estimate.
pub(super) struct Linearised {
    rows: Vec<Vec<Row>>,
}

struct Row {
    slopes: DVector<f64>,
    misclosure: f64,
    /// Less than this is nothing.
    least: f64,
}

/// What a set costs.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Cost {
    pub(super) chi_square: f64,
    pub(super) degrees: usize,
}

impl Linearised {
    /// Linearises constraints at a drawing; `root` and `covariance` are those of the estimate.
    pub(super) fn new(
        estimate: &ParametricDrawing,
        at: &ParametricDrawing,
        root: &DMatrix<f64>,
        covariance: &DMatrix<f64>,
        constraints: &[Constraint],
    ) -> Self {
        let x = at.values();
        let back = estimate.values() - &x;
        let rows = constraints.iter().map(|constraint| {
            let (residuals, jacobian) =
                ConstraintEquations::new(at, &[*constraint]).residuals_and_jacobian(&x);
            let whitened = &jacobian * root;
            let misclosures = residuals + &jacobian * &back;
            let sizes = row_sigmas(&jacobian, covariance);
            let of_row = |i: usize| Row {
                slopes: whitened.row(i).transpose(),
                misclosure: misclosures[i],
                least: KNOWN * sizes[i],
            };
            (0..jacobian.nrows()).map(of_row).collect()
        });
        Self { rows: rows.collect() }
    }

    /// What constraints cost together, in this order: `Σ c²` over rows made orthogonal, `c` what is left of a
    /// misclosure over what is left of its row.
    pub(super) fn cost(&self, chosen: impl Iterator<Item = usize>) -> Cost {
        let mut basis: Vec<(DVector<f64>, f64)> = Vec::new();
        let mut cost = Cost::default();
        for row in chosen.flat_map(|i| &self.rows[i]) {
            let (mut left, mut misclosure) = (row.slopes.clone(), row.misclosure);
            for _ in 0..2 {
                for (unit, of_unit) in &basis {
                    let share = unit.dot(&left);
                    left.axpy(-share, unit, 1.0);
                    misclosure -= share * of_unit;
                }
            }
            let norm = left.norm();
            if norm > row.least {
                let of_unit = misclosure / norm;
                cost.chi_square += of_unit * of_unit;
                cost.degrees += 1;
                basis.push((left / norm, of_unit));
            }
        }
        cost
    }
}
