//! Which rows of a matrix are independent, and of which others a dependent one is made.

use nalgebra::DMatrix;

/// A row that is a combination of independent rows before it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DependentRow {
    /// The row.
    pub(crate) row: usize,
    /// The independent rows that it is made of: with it, a smallest dependent set.
    pub(crate) of: Vec<usize>,
}

/// Rows split into independent ones, taken first come first served, and dependent ones.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct RowRank {
    pub(crate) independent: Vec<usize>,
    pub(crate) dependent: Vec<DependentRow>,
}

/// Splits the rows of a matrix by orthogonalisation in order, each against all before it, twice.
///
/// A row is dependent when less than `tolerance` of its `sizes` entry is left. The combination that makes it
/// is unique, hence the smallest dependent set with it in (a circuit of the matroid of the rows). Cost:
/// `rows² · columns`.
pub(crate) fn row_rank(matrix: &DMatrix<f64>, sizes: &[f64], tolerance: f64) -> RowRank {
    let mut rank = RowRank::default();
    let mut basis: Vec<Vec<f64>> = Vec::new();
    // Row k of the basis is Σ made[k][i] · independent row i.
    let mut made: Vec<Vec<f64>> = Vec::new();
    for row in 0..matrix.nrows() {
        let mut left: Vec<f64> = matrix.row(row).iter().copied().collect();
        let mut combination = vec![0.0; basis.len()];
        for _ in 0..2 {
            for (k, unit) in basis.iter().enumerate() {
                let share: f64 = unit.iter().zip(&left).map(|(u, l)| u * l).sum();
                left.iter_mut().zip(unit).for_each(|(l, u)| *l -= share * u);
                for (i, weight) in made[k].iter().enumerate() {
                    combination[i] += share * weight;
                }
            }
        }
        let norm = left.iter().map(|l| l * l).sum::<f64>().sqrt();
        if norm > tolerance * sizes[row] {
            basis.push(left.iter().map(|l| l / norm).collect());
            let mut weights: Vec<f64> = combination.iter().map(|c| -c / norm).collect();
            weights.push(1.0 / norm);
            made.push(weights);
            rank.independent.push(row);
        } else {
            let of = combination
                .iter()
                .zip(&rank.independent)
                .filter(|(weight, member)| weight.abs() * sizes[**member] > 1e-6 * sizes[row])
                .map(|(_, &member)| member)
                .collect();
            rank.dependent.push(DependentRow { row, of });
        }
    }
    rank
}

/// The lengths of the rows, and 1 for a row of zeros.
pub(crate) fn row_norms(matrix: &DMatrix<f64>) -> Vec<f64> {
    matrix.row_iter().map(|row| row.norm()).map(|norm| if norm > 0.0 { norm } else { 1.0 }).collect()
}
