//! Sparse equations with a dense border: a few unknowns shared by many readings.
//!
//! Input: the factor of the sparse part `A`, its coupling `C` with a few shared unknowns, and their
//! information `P`. Output: solutions of the full system, the covariance of the shared unknowns, and their
//! contribution to the covariance of the sparse unknowns:
//!
//! ```text
//! [ A   C ] [x]   [g]        S = P − Cᵀ A⁻¹ C        Σ_pp = S⁻¹
//! [ Cᵀ  P ] [p] = [h]                                Σ_xx = A⁻¹ + (A⁻¹C) S⁻¹ (A⁻¹C)ᵀ
//! ```
//!
//! The second term of `Σ_xx` has the rank of `p`. Correlated errors are therefore stored as a low-rank term,
//! and the sparse matrix stays sparse. Not guaranteed: accuracy of shared unknowns that are determined only
//! by small differences of large numbers; give each of them a prior.

use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, Dyn};

use super::CholeskyFactor;
use crate::{Error, Result};

/// Fractions of noise in the information along a direction. Above the first the information is reduced, above
/// the second it is zero.
///
/// The estimate of the noise itself scatters. Lower fractions discard real information, higher ones keep
/// noise.
const NOISE_FRACTIONS: (f64, f64) = (0.25, 0.75);

/// Factored equations of the shared unknowns.
#[derive(Debug, Clone)]
pub struct Bordered {
    /// `A⁻¹ C`, `n × m`, row by row.
    solved: Vec<f64>,
    /// `S = P − Cᵀ A⁻¹ C`, factored.
    complement: Cholesky<f64, Dyn>,
}

impl Bordered {
    /// Eliminates the sparse unknowns and factors the rest. `coupling` is `C`, `n × m`, row by row; `corner`
    /// is `P`, `m × m`, symmetric.
    ///
    /// Cost: `m` solutions with the factor, `n m²` and `m³/3`; memory `n m`.
    ///
    /// # Errors
    /// `Input` when sizes do not match; `Undetermined` when `S` is not positive definite, because readings
    /// and prior together do not determine the shared unknowns.
    ///
    /// # Examples
    /// One unknown, read as 3 with information 4 by a sensor whose offset also has information 4. Half of the
    /// information remains.
    /// ```
    /// use planish_estimate::sparse::{
    ///     BlockInformation, BlockPattern, Bordered, CholeskyFactor, NodeOrdering, SymbolicFactor,
    /// };
    /// use std::sync::Arc;
    ///
    /// let pattern = Arc::new(BlockPattern::from_elements(1, [[0]])?);
    /// let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &NodeOrdering::natural(1), 1)?);
    /// let mut information = BlockInformation::zeros(pattern, 1, 1)?;
    /// information.add_element(&[0], &[4.0], &[12.0])?;
    /// let factor = CholeskyFactor::factorize(&symbolic, &information)?;
    /// // z = x + p: the information range the offset plus that range the reading.
    /// let bordered = Bordered::new(&factor, &[4.0], &[4.0 + 4.0])?;
    /// let (mut x, mut p) = (vec![12.0], vec![12.0]);
    /// bordered.solve_in_place(&factor, &[4.0], &mut x, &mut p)?;
    /// assert!((x[0] - 3.0).abs() < 1e-12 && p[0].abs() < 1e-12);
    /// let added = bordered.shared_rows();
    /// assert!((0.25 + added[0] * added[0] - 0.5).abs() < 1e-12);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn new(factor: &CholeskyFactor, coupling: &[f64], corner: &[f64]) -> Result<Self> {
        let (solved, symmetric) = reduce(factor, coupling, corner)?;
        let complement = Cholesky::new(symmetric).ok_or_else(|| {
            Error::undetermined(
                "the unknowns shared by readings are determined neither by the readings nor by their prior",
            )
        })?;
        Ok(Self { solved, complement })
    }

    /// Returns `P − Cᵀ A⁻¹ C`, `m × m`, which need not be positive definite.
    ///
    /// # Errors
    /// `Input` when sizes do not match.
    pub fn complement_of(factor: &CholeskyFactor, coupling: &[f64], corner: &[f64]) -> Result<Vec<f64>> {
        Ok(reduce(factor, coupling, corner)?.1.as_slice().to_vec())
    }

    /// Number of shared unknowns.
    #[must_use]
    pub fn shared(&self) -> usize {
        self.complement.l_dirty().nrows()
    }

    /// Solves the full system: replaces `g` by `x` and `h` by `p`. `factor` and `coupling` are those of
    /// [`Self::new`].
    ///
    /// # Errors
    /// `Input` when sizes do not match.
    pub fn solve_in_place(
        &self,
        factor: &CholeskyFactor,
        coupling: &[f64],
        x: &mut [f64],
        p: &mut [f64],
    ) -> Result<()> {
        let m = self.shared();
        if p.len() != m || x.len() * m != self.solved.len() || coupling.len() != self.solved.len() {
            return Err(Error::input(format!(
                "expected {} and {m} right-hand sides, found {} and {}",
                self.solved.len() / m.max(1),
                x.len(),
                p.len()
            )));
        }
        // Block elimination in three steps: solve for x as if p were zero, solve for p, then correct x.
        // `A⁻¹C` is stored, so the sparse factor is used once.
        factor.solve_in_place(x)?;
        if m == 0 {
            return Ok(());
        }
        for (row, x) in coupling.chunks_exact(m).zip(&*x) {
            for (p, c) in p.iter_mut().zip(row) {
                *p -= c * x;
            }
        }
        let found = self.complement.solve(&nalgebra::DVector::from_column_slice(p));
        p.copy_from_slice(found.as_slice());
        for (row, x) in self.solved.chunks_exact(m).zip(x) {
            *x -= row.iter().zip(&*p).map(|(f, p)| f * p).sum::<f64>();
        }
        Ok(())
    }

    /// `S⁻¹`, the covariance of the shared unknowns, `m × m`.
    #[must_use]
    pub fn shared_covariance(&self) -> Vec<f64> {
        self.complement.inverse().as_slice().to_vec()
    }

    /// `pᵀ S p`: squared length, in standard deviations, of a step of the shared unknowns. The sparse
    /// unknowns are free.
    ///
    /// # Errors
    /// `Input` when `p` does not have `m` components.
    pub fn shared_length2(&self, p: &[f64]) -> Result<f64> {
        let l = self.complement.l_dirty();
        let m = l.nrows();
        if p.len() != m {
            return Err(Error::input(format!("expected {m} shared unknowns, found {}", p.len())));
        }
        // `|Lᵀ p|²` instead of `pᵀ (S p)`: a sum of squares cannot become negative by cancellation.
        Ok((0..m).map(|column| (column..m).map(|row| l[(row, column)] * p[row]).sum::<f64>().powi(2)).sum())
    }

    /// `S`, the marginal information about the shared unknowns, `m × m`.
    #[must_use]
    pub fn shared_information(&self) -> Vec<f64> {
        let l = self.complement.l();
        (&l * l.transpose()).as_slice().to_vec()
    }

    /// Removes the information about the shared unknowns that is due to `noise`, but keeps at least `floor`.
    /// Also returns the change of `P`. All matrices are `m × m`.
    ///
    /// Let `μ` be the fraction of noise in `S` along a common eigenvector of both. `1 − μ` of `S` is kept for
    /// `μ` below 1/4, a decreasing part of it above, and nothing from 3/4 on, because the noise scatters
    /// about its mean. In the metric of `floor` no eigenvalue of the result is below 1.
    ///
    /// # Errors
    /// `Input` when `floor` is not positive definite, or sizes do not match.
    pub fn without_noise(mut self, noise: &[f64], floor: &[f64]) -> Result<(Self, Vec<f64>)> {
        let m = self.shared();
        let wrong = || Error::input(format!("expected a positive definite minimum information of {m} × {m}"));
        if noise.len() != m * m || floor.len() != m * m {
            return Err(wrong());
        }
        // Work in common eigenvectors: noise in one direction must not cost information in others, as a
        // common factor would.
        let before = DMatrix::from_column_slice(m, m, &self.shared_information());
        let noise = DMatrix::from_column_slice(m, m, noise);
        let kept = with_eigenvalues(&self.complement.l(), &noise, |share| {
            let fade = (NOISE_FRACTIONS.1 - share) / (NOISE_FRACTIONS.1 - NOISE_FRACTIONS.0);
            (1.0 - share).max(0.0) * fade.clamp(0.0, 1.0)
        });
        let floor = Cholesky::new(DMatrix::from_column_slice(m, m, floor)).ok_or_else(wrong)?;
        // The limit applies in the metric of `floor` itself. Limiting the entries could make the matrix
        // indefinite.
        let after = (kept.and_then(|kept| with_eigenvalues(&floor.l(), &kept, |value| value.max(1.0))))
            .ok_or_else(wrong)?;
        let change = (&after - before).as_slice().to_vec();
        self.complement = Cholesky::new(after).ok_or_else(wrong)?;
        Ok((self, change))
    }

    /// Directions of some shared unknowns whose prior variance the readings reduce by less than the fraction
    /// `share`. Each direction is one σ of the prior long; they are orthogonal in the metric of the prior,
    /// whose information about these unknowns is `prior`.
    ///
    /// Eigenvectors of `L₀ᵀ Σ L₀` with eigenvalues above `1 − share`, where `L₀ L₀ᵀ` is the prior and `Σ` the
    /// block of `S⁻¹`.
    ///
    /// # Errors
    /// `Input` when the prior is not positive definite or of another size.
    pub fn undetermined(&self, range: Range<usize>, prior: &[f64], share: f64) -> Result<Vec<Vec<f64>>> {
        let m = range.len();
        let wrong = || Error::input(format!("expected a positive definite prior of {m} × {m}"));
        if prior.len() != m * m || range.end > self.shared() {
            return Err(wrong());
        }
        let l = Cholesky::new(DMatrix::from_column_slice(m, m, prior)).ok_or_else(wrong)?.l();
        let covariance = self.complement.inverse().view((range.start, range.start), (m, m)).into_owned();
        // In units of the prior, eigenvalues are ratios of variances. They do not depend on units of the
        // unknowns.
        let whitened = l.transpose() * covariance * &l;
        let eigen = (0.5 * (&whitened + whitened.transpose())).symmetric_eigen();
        let upper = l.transpose();
        Ok((eigen.eigenvalues.iter().enumerate())
            .filter(|(_, left)| **left > 1.0 - share)
            .filter_map(|(k, _)| upper.solve_upper_triangular(&eigen.eigenvectors.column(k)))
            .map(|v| v.as_slice().to_vec())
            .collect())
    }

    /// `G`, `n × m`, row by row, with `Σ_xx = A⁻¹ + G Gᵀ`.
    #[must_use]
    pub fn shared_rows(&self) -> Vec<f64> {
        let m = self.shared();
        let rows = DMatrix::from_column_slice(m, self.solved.len() / m.max(1), &self.solved);
        // Gᵀ = L⁻¹ (A⁻¹C)ᵀ.
        let l = self.complement.l();
        l.solve_lower_triangular(&rows).map_or_else(Vec::new, |g| g.as_slice().to_vec())
    }
}

/// Applies `f` to the generalised eigenvalues: `L V f(Λ) Vᵀ Lᵀ` for a symmetric matrix `L V Λ Vᵀ Lᵀ`. `None`
/// if `L` is singular.
fn with_eigenvalues(l: &DMatrix<f64>, matrix: &DMatrix<f64>, f: impl Fn(f64) -> f64) -> Option<DMatrix<f64>> {
    let half = l.solve_lower_triangular(matrix)?;
    let whitened = l.solve_lower_triangular(&half.transpose())?;
    let eigen = (0.5 * (&whitened + whitened.transpose())).symmetric_eigen();
    let back = l * &eigen.eigenvectors;
    let made = &back * DMatrix::from_diagonal(&eigen.eigenvalues.map(f)) * back.transpose();
    Some(0.5 * (&made + made.transpose()))
}

/// Computes `A⁻¹ C` and `P − Cᵀ A⁻¹ C`.
fn reduce(factor: &CholeskyFactor, coupling: &[f64], corner: &[f64]) -> Result<(Vec<f64>, DMatrix<f64>)> {
    let m = corner.len().isqrt();
    let n = factor.symbolic().pattern().nodes() * factor.symbolic().block_size();
    if m * m != corner.len() || coupling.len() != n * m {
        return Err(Error::input(format!(
            "{n} sparse unknowns and a corner of {} entries require a coupling of {n} × {m}, found {} \
             entries",
            corner.len(),
            coupling.len()
        )));
    }
    let mut solved = coupling.to_vec();
    if m > 0 {
        factor.solve_in_place(&mut solved)?;
    }
    // Both are row-major, so reading them as column-major gives their transposes.
    let (c, f) = (DMatrix::from_column_slice(m, n, coupling), DMatrix::from_column_slice(m, n, &solved));
    let reduced = DMatrix::from_column_slice(m, m, corner) - &c * f.transpose();
    // Cholesky reads one triangle; the rounding of the other one would be ignored.
    let symmetric = 0.5 * (&reduced + reduced.transpose());
    Ok((solved, symmetric))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sparse::{BlockInformation, BlockPattern, NodeOrdering, SymbolicFactor};
    use std::sync::Arc;

    const N: usize = 12;
    const M: usize = 3;

    /// A chain of unknowns whose readings `x_i − x_{i+1} + row · p` share three offsets.
    fn chain_with_offsets() -> (CholeskyFactor, Vec<f64>, Vec<f64>, DMatrix<f64>) {
        let pattern =
            Arc::new(BlockPattern::from_elements(N, (0..N as u32 - 1).map(|i| [i, i + 1])).unwrap());
        let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &NodeOrdering::natural(N), 1).unwrap());
        let mut information = BlockInformation::zeros(pattern, 1, 1).unwrap();
        let mut dense = DMatrix::<f64>::zeros(N + M, N + M);
        for i in 0..N - 1 {
            let w = 1.0 + 0.3 * i as f64;
            let mut row = vec![0.0; N + M];
            (row[i], row[i + 1]) = (1.0, -0.8);
            for k in 0..M {
                row[N + k] = ((i * (k + 2)) as f64).sin();
            }
            let element = [row[i], row[i + 1]];
            let matrix: Vec<f64> = (element.iter().flat_map(|a| element.map(|b| w * a * b))).collect();
            information.add_element(&[i as u32, i as u32 + 1], &matrix, &[0.0, 0.0]).unwrap();
            let row = nalgebra::DVector::from_vec(row);
            dense += w * &row * row.transpose();
        }
        information.add_diagonal(0.05);
        for i in 0..N {
            dense[(i, i)] += 0.05;
        }
        for k in 0..M {
            dense[(N + k, N + k)] += 0.2;
        }
        let coupling = (0..N).flat_map(|i| (0..M).map(move |k| (i, N + k))).map(|at| dense[at]).collect();
        let corner = dense.view((N, N), (M, M)).into_owned().as_slice().to_vec();
        (CholeskyFactor::factorize(&symbolic, &information).unwrap(), coupling, corner, dense)
    }

    #[test]
    fn solutions_and_covariances_equal_those_of_the_dense_system() {
        let (factor, coupling, corner, dense) = chain_with_offsets();
        let bordered = Bordered::new(&factor, &coupling, &corner).unwrap();
        let inverse = dense.clone().try_inverse().unwrap();
        let right = nalgebra::DVector::from_fn(N + M, |i, _| (i as f64).cos());
        let expected = &inverse * &right;
        let (mut x, mut p) = (right.as_slice()[..N].to_vec(), right.as_slice()[N..].to_vec());
        bordered.solve_in_place(&factor, &coupling, &mut x, &mut p).unwrap();
        for (found, expected) in x.iter().chain(&p).zip(expected.iter()) {
            assert!((found - expected).abs() < 1e-11, "{found} {expected}");
        }
        let covariance = bordered.shared_covariance();
        let information = bordered.shared_information();
        let length2: f64 = (0..M * M).map(|k| p[k / M] * information[k] * p[k % M]).sum();
        assert!((bordered.shared_length2(&p).unwrap() / length2 - 1.0).abs() < 1e-11);
        for a in 0..M {
            for b in 0..M {
                assert!((covariance[a * M + b] - inverse[(N + a, N + b)]).abs() < 1e-11);
            }
        }
        let (rows, conditional) =
            (bordered.shared_rows(), dense.view((0, 0), (N, N)).into_owned().try_inverse().unwrap());
        for a in 0..N {
            for b in 0..N {
                let shared: f64 = (0..M).map(|k| rows[a * M + k] * rows[b * M + k]).sum();
                assert!((conditional[(a, b)] + shared - inverse[(a, b)]).abs() < 1e-11);
            }
        }
    }

    #[test]
    fn directions_without_information_from_readings_are_found() {
        let (factor, coupling, corner, _) = chain_with_offsets();
        // A fourth unknown that appears in no reading.
        let coupling: Vec<f64> =
            coupling.chunks_exact(M).flat_map(|row| [row[0], row[1], row[2], 0.0]).collect();
        let (mut corner4, mut prior) = ([0.0; 16], [0.0; 16]);
        for a in 0..M {
            for b in 0..M {
                corner4[4 * a + b] = corner[M * a + b];
            }
            prior[5 * a] = 0.2;
        }
        (corner4[15], prior[15]) = (0.25, 0.25);
        let bordered = Bordered::new(&factor, &coupling, &corner4).unwrap();
        let found = bordered.undetermined(0..4, &prior, 0.1).unwrap();
        let only = found.iter().find(|v| v[3].abs() > 1.0).unwrap();
        assert!((only[3].abs() - 2.0).abs() < 1e-9 && only[..3].iter().all(|c| c.abs() < 1e-9), "{found:?}");
        assert!(bordered.undetermined(0..4, &prior[1..], 0.1).is_err());
        // The fourth unknown alone is also such a direction, one σ long.
        let alone = bordered.undetermined(3..4, &[0.25], 0.1).unwrap();
        assert!((alone[0][0].abs() - 2.0).abs() < 1e-9 && alone.len() == 1);
    }

    #[test]
    fn noise_is_removed_from_the_information_down_to_the_floor() {
        let (factor, coupling, corner, _) = chain_with_offsets();
        let bordered = Bordered::new(&factor, &coupling, &corner).unwrap();
        let before = bordered.shared_information();
        let floor: Vec<f64> = (0..M * M).map(|k| if k % (M + 1) == 0 { 0.2 } else { 0.0 }).collect();
        let none = bordered.clone().without_noise(&[0.0; M * M], &floor).unwrap();
        assert!(none.1.iter().all(|c| c.abs() < 1e-12));
        let of_noise = |share: f64| -> Vec<f64> {
            let noise: Vec<f64> = before.iter().map(|s| share * s).collect();
            let (left, change) = bordered.clone().without_noise(&noise, &floor).unwrap();
            let left = left.shared_information();
            for (k, s) in left.iter().enumerate() {
                assert!((before[k] + change[k] - s).abs() < 1e-12);
            }
            left
        };
        // A tenth is removed, as far as the floor allows. Only the floor remains of information that is
        // mostly noise.
        for (k, s) in of_noise(0.1).iter().enumerate() {
            let bound = if floor[k] > 0.0 { floor[k] } else { f64::NEG_INFINITY };
            assert!(*s > bound - 1e-12 && (0.9 * before[k] - s).abs() < 0.2, "{s} {}", before[k]);
        }
        for (s, floor) in of_noise(0.9).iter().zip(&floor) {
            assert!((s - floor).abs() < 1e-12);
        }
    }

    #[test]
    fn an_undetermined_shared_unknown_is_reported() {
        let (factor, coupling, mut corner, _) = chain_with_offsets();
        // A corner for which no information about the shared unknowns remains.
        let bordered = Bordered::new(&factor, &coupling, &corner).unwrap();
        for (c, s) in corner.iter_mut().zip(bordered.shared_information()) {
            *c -= s * (1.0 + 1e-9);
        }
        let e = Bordered::new(&factor, &coupling, &corner).unwrap_err();
        assert_eq!(e.kind(), crate::ErrorKind::Undetermined);
        assert!(Bordered::new(&factor, &coupling[1..], &corner).is_err());
    }
}
