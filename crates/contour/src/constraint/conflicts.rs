//! χ² of sets of constraints to first order, for the search of conflicts.
//!
//! In: an estimate, and constraints linearised where they nearly hold. Out: the χ² of any subset, without
//! solving nonlinear equations. Not guaranteed: second-order terms; the caller repeats the search with the
//! exact equations if this one finds no conflict.

use super::drawing::ParametricDrawing;
use super::equations::ConstraintEquations;
use super::impose::{KNOWN_SIGMA, row_sigmas};
use super::relation::Constraint;
use nalgebra::{DMatrix, DVector};

/// Constraints as rows `a = L^T h` of whitened slopes with their misclosures at the estimate.
pub(super) struct Linearised {
    rows: Vec<Vec<Row>>,
}

struct Row {
    slopes: DVector<f64>,
    misclosure: f64,
    /// A remainder shorter than this counts as dependent.
    min_norm: f64,
}

/// χ² of a set of constraints.
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
        // Linearised where the constraints nearly hold, but the misclosure refers to the estimate: χ² is the
        // distance from there.
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
                min_norm: KNOWN_SIGMA * sizes[i],
            };
            (0..jacobian.nrows()).map(of_row).collect()
        });
        Self { rows: rows.collect() }
    }

    /// χ² of constraints imposed in this order: `Σ c²` over orthogonalised rows, `c` being the remaining
    /// misclosure divided by the length of the remaining row.
    pub(super) fn cost(&self, chosen: impl Iterator<Item = usize>) -> Cost {
        let mut basis: Vec<(DVector<f64>, f64)> = Vec::new();
        let mut cost = Cost::default();
        for row in chosen.flat_map(|i| &self.rows[i]) {
            let (mut left, mut misclosure) = (row.slopes.clone(), row.misclosure);
            // Gram–Schmidt twice, as in `row_rank`.
            for _ in 0..2 {
                for (unit, of_unit) in &basis {
                    let share = unit.dot(&left);
                    left.axpy(-share, unit, 1.0);
                    misclosure -= share * of_unit;
                }
            }
            let norm = left.norm();
            if norm > row.min_norm {
                let of_unit = misclosure / norm;
                cost.chi_square += of_unit * of_unit;
                cost.degrees += 1;
                basis.push((left / norm, of_unit));
            }
        }
        cost
    }
}
