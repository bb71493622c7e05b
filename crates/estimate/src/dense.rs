//! Factors of dense symmetric matrices that report undetermined directions.
//!
//! Input: an information or covariance matrix whose unknowns may have different units. Output: a factor, or a
//! null direction. Ranks are decided after scaling to unit diagonal, so they do not depend on units.

use crate::{Error, Result};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, SymmetricEigen};

/// Cholesky factor of `S M S`, with `S` the diagonal scaling that gives `M` a unit diagonal.
pub(crate) struct ScaledCholesky {
    scale: DVector<f64>,
    factor: Cholesky<f64, Dyn>,
}

impl ScaledCholesky {
    /// Factors a symmetric matrix. Only the lower triangle is read.
    pub(crate) fn new(matrix: &DMatrix<f64>) -> std::result::Result<Self, NullDirection> {
        if !is_finite(matrix) {
            return Err(NullDirection { finite: false, direction: DVector::zeros(matrix.nrows()), count: 0 });
        }
        let scale = diagonal_scale(matrix);
        let scaled = scaled_by(matrix, &scale);
        let threshold = rank_tolerance(matrix.nrows());
        // After scaling, a squared pivot is the fraction of an unknown's information that the previous
        // unknowns do not share. Rounding leaves singular matrices tiny positive pivots, which a bare
        // factorisation accepts.
        match Cholesky::new(scaled.clone()) {
            Some(factor) if factor.l_dirty().diagonal().iter().all(|pivot| pivot * pivot > threshold) => {
                Ok(Self { scale, factor })
            }
            _ => Err(NullDirection::from_scaled(scaled, &scale)),
        }
    }

    pub(crate) fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        let mut solution = right.component_mul(&self.scale);
        self.factor.solve_mut(&mut solution);
        solution.component_mul(&self.scale)
    }

    pub(crate) fn solve_matrix(&self, right: &DMatrix<f64>) -> DMatrix<f64> {
        let mut solution = right.clone();
        self.scale_rows(&mut solution);
        self.factor.solve_mut(&mut solution);
        self.scale_rows(&mut solution);
        solution
    }

    pub(crate) fn inverse(&self) -> DMatrix<f64> {
        let inverse = scaled_by(&self.factor.inverse(), &self.scale);
        symmetric_part(&inverse)
    }

    /// `xᵀ M⁻¹ x`, never negative.
    pub(crate) fn inverse_form(&self, x: &DVector<f64>) -> f64 {
        let scaled = x.component_mul(&self.scale);
        // `|L⁻¹ x|²` is a sum of squares. The product of `x` with `M⁻¹ x` can become negative by
        // cancellation.
        match self.factor.l_dirty().solve_lower_triangular(&scaled) {
            Some(half) => half.norm_squared(),
            None => f64::INFINITY,
        }
    }

    pub(crate) fn ln_determinant(&self) -> f64 {
        // The sum of logarithms does not overflow, unlike the product of the pivots of a large matrix.
        self.factor.ln_determinant() - 2.0 * self.scale.iter().map(|s| s.ln()).sum::<f64>()
    }

    fn scale_rows(&self, matrix: &mut DMatrix<f64>) {
        for (i, s) in self.scale.iter().enumerate() {
            matrix.row_mut(i).scale_mut(*s);
        }
    }
}

/// Why a matrix has no factor: a direction without information, or a value that is not finite.
pub(crate) struct NullDirection {
    finite: bool,
    /// In the units of the unknowns; unit length after scaling each unknown by its information.
    pub(crate) direction: DVector<f64>,
    count: usize,
}

impl NullDirection {
    fn from_scaled(scaled: DMatrix<f64>, scale: &DVector<f64>) -> Self {
        let n = scaled.nrows();
        match eigen(scaled) {
            Some(eigen) => {
                let tolerance = rank_tolerance(n);
                let smallest = eigen.eigenvalues.imin();
                // At least one: the factor rejected a pivot, even if rounding lifts the smallest eigenvalue
                // above the tolerance.
                let count = eigen.eigenvalues.iter().filter(|&&value| value <= tolerance).count().max(1);
                let direction = eigen.eigenvectors.column(smallest).component_mul(scale);
                Self { finite: true, direction, count }
            }
            None => Self { finite: false, direction: DVector::zeros(n), count: 0 },
        }
    }

    /// The component with the largest magnitude in the direction.
    pub(crate) fn component(&self) -> usize {
        if self.direction.is_empty() { 0 } else { self.direction.iamax() }
    }

    /// Converts to an error; `what` names the undetermined quantity, for example "the state".
    pub(crate) fn into_error(self, what: &str) -> Error {
        if !self.finite {
            return Error::input(format!("expected finite values in {what}, found another"));
        }
        Error::undetermined(format!(
            "{what} is undetermined: there is no information along {} of {} directions, and component {} \
             is the largest of the weakest one; measure it, or specify a prior for it",
            self.count,
            self.direction.len(),
            self.component()
        ))
    }
}

pub(crate) fn is_finite(matrix: &DMatrix<f64>) -> bool {
    matrix.iter().all(|value| value.is_finite())
}

pub(crate) fn symmetric_part(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    (matrix + matrix.transpose()) * 0.5
}

/// Eigenvalues of a matrix with unit diagonal below this are rounding errors.
///
/// The backward error of a symmetric eigensolver or Cholesky factor is a small multiple of `n ε`. The factor
/// 10 trades false rank deficits against accepting directions that hold only rounding noise.
pub(crate) fn rank_tolerance(n: usize) -> f64 {
    10.0 * n as f64 * f64::EPSILON
}

pub(crate) fn eigen(matrix: DMatrix<f64>) -> Option<SymmetricEigen<f64, Dyn>> {
    // The limit protects the caller from an iteration that never converges. QR needs two or three sweeps per
    // eigenvalue.
    let limit = 100 * (matrix.nrows() + 1);
    if is_finite(&matrix) { SymmetricEigen::try_new(matrix, f64::EPSILON, limit) } else { None }
}

/// The scale `1/√Mᵢᵢ` of each unknown, or 1 if the diagonal is not positive.
pub(crate) fn diagonal_scale(matrix: &DMatrix<f64>) -> DVector<f64> {
    matrix.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 1.0 })
}

pub(crate) fn scaled_by(matrix: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| scale[i] * matrix[(i, j)] * scale[j])
}

/// The smallest eigenvalue of a symmetric matrix after scaling by `reference`'s diagonal; `None` when not
/// finite.
pub(crate) fn smallest_scaled_eigenvalue(matrix: &DMatrix<f64>, reference: &DMatrix<f64>) -> Option<f64> {
    if matrix.nrows() == 0 {
        return Some(0.0);
    }
    let scaled = scaled_by(matrix, &diagonal_scale(reference));
    eigen(scaled).map(|eigen| eigen.eigenvalues.min())
}

/// Checks that `covariance` is a finite, symmetric, positive semidefinite matrix of dimension `n`.
pub(crate) fn require_covariance(what: &str, covariance: &DMatrix<f64>, n: usize) -> Result<()> {
    if covariance.shape() != (n, n) {
        let (rows, columns) = covariance.shape();
        return Err(Error::input(format!("{what}: expected {n} × {n} entries, found {rows} × {columns}")));
    }
    if !is_finite(covariance) {
        return Err(Error::input(format!("expected finite values in {what}, found another")));
    }
    // Compare after scaling. A fixed tolerance on raw entries would depend on the units of the unknowns.
    let scaled = scaled_by(covariance, &diagonal_scale(covariance));
    for i in 0..n {
        for j in 0..i {
            if (scaled[(i, j)] - scaled[(j, i)]).abs() > 1e-9 {
                return Err(Error::input(format!("{what} is not symmetric in rows {j} and {i}")));
            }
        }
    }
    // Cheap sufficient conditions come first: the weight of many independent readings is diagonal, and needs
    // no eigenvalue decomposition.
    if is_nonnegative_diagonal(covariance) || Cholesky::new(scaled).is_some() {
        return Ok(());
    }
    match smallest_scaled_eigenvalue(covariance, covariance) {
        Some(smallest) if smallest >= -1e-9 => Ok(()),
        _ => Err(Error::input(format!("{what} is not positive semidefinite"))),
    }
}

fn is_nonnegative_diagonal(matrix: &DMatrix<f64>) -> bool {
    let n = matrix.nrows();
    (0..n).all(|j| matrix[(j, j)] >= 0.0 && (0..n).all(|i| i == j || matrix[(i, j)] == 0.0))
}

/// Checks a vector's length and that it is finite.
pub(crate) fn require_vector(what: &str, vector: &DVector<f64>, n: usize) -> Result<()> {
    if vector.len() != n {
        return Err(Error::input(format!("{what}: expected {n} components, found {}", vector.len())));
    }
    match vector.iter().position(|value| !value.is_finite()) {
        Some(i) => Err(Error::input(format!("component {i} of {what}: expected a finite number"))),
        None => Ok(()),
    }
}

/// Checks that a number is finite.
pub(crate) fn require_finite_number(what: &str, value: f64) -> Result<()> {
    if value.is_finite() {
        Ok(())
    } else {
        Err(Error::input(format!("{what}: expected a finite number, found {value}")))
    }
}
