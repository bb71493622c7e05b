//! Independent rows of a matrix, and the combinations that form the dependent ones.

use nalgebra::DMatrix;

/// A row that is a combination of earlier independent rows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DependentRow {
    /// Index of the row.
    pub(crate) row: usize,
    /// Indices of the independent rows in the combination; together with the row, a minimal dependent set.
    pub(crate) combination: Vec<usize>,
}

/// Rows split into independent and dependent ones; earlier rows have priority.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct RowRank {
    pub(crate) independent: Vec<usize>,
    pub(crate) dependent: Vec<DependentRow>,
}

/// Splits the rows of a matrix by Gram–Schmidt orthogonalisation in order.
///
/// A row is dependent if the length of its remainder is below `tolerance` times its entry of `sizes`. The
/// combination that forms it is unique, so it is the smallest dependent set that contains the row (a circuit
/// of the matroid of the rows). A pivoted QR would not respect the order of preference. Cost: `rows² ·
/// columns`.
pub(crate) fn row_rank(matrix: &DMatrix<f64>, sizes: &[f64], tolerance: f64) -> RowRank {
    let mut rank = RowRank::default();
    let mut basis: Vec<Vec<f64>> = Vec::new();
    // Row k of the basis is Σ weights_of[k][i] · independent row i.
    let mut weights_of: Vec<Vec<f64>> = Vec::new();
    for row in 0..matrix.nrows() {
        let mut left: Vec<f64> = matrix.row(row).iter().copied().collect();
        let mut combination = vec![0.0; basis.len()];
        // Twice is enough: one pass of Gram–Schmidt loses orthogonality for nearly dependent rows.
        for _ in 0..2 {
            for (k, unit) in basis.iter().enumerate() {
                let share: f64 = unit.iter().zip(&left).map(|(u, l)| u * l).sum();
                left.iter_mut().zip(unit).for_each(|(l, u)| *l -= share * u);
                for (i, weight) in weights_of[k].iter().enumerate() {
                    combination[i] += share * weight;
                }
            }
        }
        let norm = left.iter().map(|l| l * l).sum::<f64>().sqrt();
        if norm > tolerance * sizes[row] {
            basis.push(left.iter().map(|l| l / norm).collect());
            let mut weights: Vec<f64> = combination.iter().map(|c| -c / norm).collect();
            weights.push(1.0 / norm);
            weights_of.push(weights);
            rank.independent.push(row);
        } else {
            let members = combination
                .iter()
                .zip(&rank.independent)
                .filter(|(weight, member)| weight.abs() * sizes[**member] > 1e-6 * sizes[row])
                .map(|(_, &member)| member)
                .collect();
            rank.dependent.push(DependentRow { row, combination: members });
        }
    }
    rank
}

/// Lengths of the rows; 1 for a row of zeros, so that it counts as dependent.
pub(crate) fn row_norms(matrix: &DMatrix<f64>) -> Vec<f64> {
    matrix.row_iter().map(|row| row.norm()).map(|norm| if norm > 0.0 { norm } else { 1.0 }).collect()
}
