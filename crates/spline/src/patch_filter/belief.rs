//! The belief of a patch: mean and dense covariance of its control vertices, updated by scalar measurements.
//!
//! Input: rows `hᵀ x = z` with a variance, usually sparse. Output: the updated belief and the innovation.
//! Columns of the mean share one covariance, for example three coordinates with isotropic noise.
//!
//! Not guaranteed: a distinction between zero and a variance far below the rounding of the covariance.
//!
//! # References
//! Bucy, Joseph, *Filtering for stochastic processes with applications to guidance*, 1968 (the symmetric
//! update).

use nalgebra::DMatrix;
use planish_estimate::{Error, Result};

/// Mean and covariance of the unknowns of one patch.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchBelief {
    dimension: usize,
    columns: usize,
    /// `dimension × columns`, row-major.
    mean: Vec<f64>,
    /// `dimension × dimension`, symmetric to the last bit.
    covariance: Vec<f64>,
}

/// Buffers of an update, reused so that updates do not allocate.
#[derive(Debug, Clone, Default)]
pub(super) struct Workspace {
    spread: Vec<f64>,
    gain: Vec<f64>,
}

/// Innovation of a scalar measurement: one residual per column of the mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ColumnInnovation {
    pub residual: [f64; 3],
    /// `S = hᵀ Σ h + r`
    pub variance: f64,
}

impl PatchBelief {
    /// A belief from its mean, `dimension × columns` and row-major, and its covariance.
    ///
    /// # Errors
    /// `Input` when sizes do not match, a value is not finite, or there are more than three columns.
    pub fn from_covariance(columns: usize, mean: Vec<f64>, covariance: Vec<f64>) -> Result<Self> {
        if !(1..=3).contains(&columns) || !mean.len().is_multiple_of(columns) {
            return Err(Error::input(format!(
                "a mean of {} values cannot have {columns} columns",
                mean.len()
            )));
        }
        let dimension = mean.len() / columns;
        if covariance.len() != dimension * dimension {
            return Err(Error::input(format!(
                "a patch of {dimension} unknowns needs a covariance of {} values, found {}",
                dimension * dimension,
                covariance.len()
            )));
        }
        if mean.iter().chain(&covariance).any(|x| !x.is_finite()) {
            return Err(Error::input("the belief of a patch contains a value that is not finite"));
        }
        let mut belief = Self { dimension, columns, mean, covariance };
        // The update below keeps symmetry to the last bit, but only if the covariance has it at the start.
        belief.symmetrize();
        Ok(belief)
    }

    pub(super) fn from_matrices(mean: &DMatrix<f64>, covariance: &DMatrix<f64>) -> Self {
        let mut belief = Self {
            dimension: mean.nrows(),
            columns: mean.ncols(),
            mean: mean.transpose().as_slice().to_vec(),
            covariance: covariance.as_slice().to_vec(),
        };
        belief.symmetrize();
        belief
    }

    /// Number of unknowns.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of columns of the mean, which share the covariance.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The mean, `dimension × columns`, row-major.
    #[must_use]
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// The covariance of each column, `dimension × dimension`.
    #[must_use]
    pub fn covariance(&self) -> &[f64] {
        &self.covariance
    }

    pub(super) fn mean_matrix(&self) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.dimension, self.columns, &self.mean)
    }

    pub(super) fn covariance_matrix(&self) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.dimension, self.dimension, &self.covariance)
    }

    /// Adds `by(k)` to the `k`-th value of the mean.
    pub(super) fn translate(&mut self, by: impl Fn(usize) -> f64) {
        for (k, m) in self.mean.iter_mut().enumerate() {
            *m += by(k);
        }
    }

    fn symmetrize(&mut self) {
        let n = self.dimension;
        for i in 0..n {
            for j in 0..i {
                let middle = 0.5 * (self.covariance[i * n + j] + self.covariance[j * n + i]);
                self.covariance[i * n + j] = middle;
                self.covariance[j * n + i] = middle;
            }
        }
    }

    /// `hᵀ x` of a sparse row, for each column of the mean.
    pub(super) fn mean_of(&self, row: &[(u16, f64)]) -> [f64; 3] {
        let mut mean = [0.0; 3];
        for (column, m) in mean.iter_mut().enumerate().take(self.columns) {
            *m = row.iter().map(|&(i, w)| w * self.mean[usize::from(i) * self.columns + column]).sum();
        }
        mean
    }

    /// `hᵀ Σ h` of a sparse row.
    pub(super) fn variance_of(&self, row: &[(u16, f64)]) -> f64 {
        let n = self.dimension;
        row.iter()
            .map(|&(i, a)| {
                let line = &self.covariance[usize::from(i) * n..][..n];
                a * row.iter().map(|&(j, b)| b * line[usize::from(j)]).sum::<f64>()
            })
            .sum()
    }

    /// Updates with `hᵀ x = value + v`, `v ~ N(0, variance)`, for all columns: `k = Σh/S`,
    /// `x ← x + k (z − hᵀx)`, `Σ ← (I − k hᵀ) Σ (I − k hᵀ)ᵀ + r k kᵀ`.
    ///
    /// Cost: `dimension · (row length + 2.5 dimension)` multiply-adds, without allocation.
    pub(super) fn update(
        &mut self,
        row: &[(u16, f64)],
        value: [f64; 3],
        variance: f64,
        workspace: &mut Workspace,
    ) -> Result<ColumnInnovation> {
        let n = self.dimension;
        workspace.spread.clear();
        workspace.spread.resize(n, 0.0);
        let spread = &mut workspace.spread[..n];
        for &(index, weight) in row {
            // A row instead of a column: the covariance is symmetric, and a row is contiguous.
            let line = &self.covariance[usize::from(index) * n..][..n];
            for (s, x) in spread.iter_mut().zip(line) {
                *s += weight * x;
            }
        }
        let expected: f64 = row.iter().map(|&(i, w)| w * spread[usize::from(i)]).sum();
        // Rounding can make the variance of an exactly known value slightly negative.
        let total = expected.max(0.0) + variance;
        if !(total > 0.0 && total.is_finite()) {
            return Err(Error::undetermined(
                "a noise-free reading measures a value that is already known exactly",
            ));
        }
        // Before the mean changes.
        let predicted = self.mean_of(row);
        let mut residual = [0.0; 3];
        for (r, (z, p)) in residual.iter_mut().zip(value.iter().zip(&predicted)).take(self.columns) {
            *r = z - p;
        }
        workspace.gain.clear();
        workspace.gain.extend(spread.iter().map(|s| s / total));
        let gain = &workspace.gain[..n];
        for (mean, k) in self.mean.chunks_exact_mut(self.columns).zip(gain) {
            for (m, r) in mean.iter_mut().zip(&residual) {
                *m += k * r;
            }
        }
        // Products are arranged so that entries (i, j) and (j, i) have the same rounding.
        // With `s = Σ h` the Joseph form is `Σ − k sᵀ − s kᵀ + S k kᵀ`: three rank-one terms and no matrix
        // product.
        for ((line, &k), &s) in self.covariance.chunks_exact_mut(n).zip(gain).zip(spread.iter()) {
            for ((entry, &kj), &sj) in line.iter_mut().zip(gain).zip(spread.iter()) {
                *entry -= (k * sj + s * kj) - total * (k * kj);
            }
        }
        Ok(ColumnInnovation { residual, variance: total })
    }
}
