//! Seeded randomness shared by the law tests.

use nalgebra::{DMatrix, DVector};

/// A vector from its components.
macro_rules! dvector {
    ($($x:expr),*) => { nalgebra::DVector::<f64>::from_column_slice(&[$($x),*]) };
}

/// A matrix from its rows, separated by semicolons.
macro_rules! dmatrix {
    ($($($x:expr),+);+) => {
        nalgebra::DMatrix::<f64>::from_rows(&[$(nalgebra::RowDVector::<f64>::from_row_slice(&[$($x),+])),+])
    };
}

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
pub(crate) use {dmatrix, dvector};

pub(crate) struct Gaussian(ChaCha8Rng);

impl Gaussian {
    pub(crate) fn seeded(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub(crate) fn number(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    pub(crate) fn vector(&mut self, n: usize) -> DVector<f64> {
        DVector::from_fn(n, |_, _| self.number())
    }

    pub(crate) fn matrix(&mut self, rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| self.number())
    }

    /// A well-conditioned covariance.
    pub(crate) fn covariance(&mut self, n: usize) -> DMatrix<f64> {
        let root = self.matrix(n, n);
        &root * root.transpose() / n as f64 + DMatrix::identity(n, n) * 0.3
    }

    /// A draw from `N(0, covariance)`.
    pub(crate) fn draw(&mut self, covariance: &DMatrix<f64>) -> DVector<f64> {
        covariance.clone().cholesky().unwrap().l() * self.vector(covariance.nrows())
    }
}

/// The largest difference of entries divided by the largest entry.
pub(crate) fn relative_difference(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).amax() / a.amax().max(b.amax()).max(f64::MIN_POSITIVE)
}

pub(crate) fn scalar(value: f64) -> DMatrix<f64> {
    DMatrix::from_element(1, 1, value)
}
