//! A few unknowns that many readings share, beside the sparse ones: an arrow of equations.
//!
//! Input: the factor of the sparse part `A`, its coupling `C` with few further unknowns, and their own
//! information `P`. Output: solutions of the whole, the covariance of the few, and what their uncertainty
//! adds to the covariance of the many:
//!
//! ```text
//! [ A   C ] [x]   [g]        S = P − Cᵀ A⁻¹ C        Σ_pp = S⁻¹
//! [ Cᵀ  P ] [p] = [h]                                Σ_xx = A⁻¹ + (A⁻¹C) S⁻¹ (A⁻¹C)ᵀ
//! ```
//!
//! The second term of `Σ_xx` has the rank of `p`: correlated errors are kept as a low-rank term, and no
//! sparse matrix fills in. Not guaranteed: digits of unknowns of `p` that the whole determines only by
//! differences of much larger numbers; give each a prior.

use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, Dyn};

use super::CholeskyFactor;
use crate::{Error, Result};

/// Directions of which a larger share of the information than the first is noise count as known less, of the
/// second as unknown.
const MOST_NOISE: (f64, f64) = (0.25, 0.75);

/// The reduced equations of the few unknowns, factored.
#[derive(Debug, Clone)]
pub struct Bordered {
    /// `A⁻¹ C`, `n × m`, row by row.
    solved: Vec<f64>,
    /// `S = P − Cᵀ A⁻¹ C`, factored.
    complement: Cholesky<f64, Dyn>,
}

impl Bordered {
    /// Reduces and factors. `coupling` is `C`, `n × m`, row by row; `corner` is `P`, `m × m`, symmetric.
    ///
    /// Cost: `m` solutions with the factor, `n m²` and `m³/3`; memory `n m`.
    ///
    /// # Errors
    /// `Input` when the sizes do not fit; `Undetermined` when `S` is not positive definite: the few unknowns
    /// are not determined by readings and their own prior together.
    ///
    /// # Examples
    /// One unknown read as 3 with information 4, by a sensor whose offset has information 4, too: half of the
    /// information is left.
    /// ```
    /// use planish_estimate::sparse::{BlockInformation, BlockPattern, Bordered, CholeskyFactor, NodeOrdering, SymbolicFactor};
    /// use std::sync::Arc;
    ///
    /// let pattern = Arc::new(BlockPattern::from_elements(1, [[0]])?);
    /// let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &NodeOrdering::natural(1), 1)?);
    /// let mut information = BlockInformation::zeros(pattern, 1, 1)?;
    /// information.add_element(&[0], &[4.0], &[12.0])?;
    /// let factor = CholeskyFactor::factorize(&symbolic, &information)?;
    /// // z = x + p: the offset's own information and the reading's.
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
                "what readings share is determined neither by them nor by what was known before",
            )
        })?;
        Ok(Self { solved, complement })
    }

    /// `P − Cᵀ A⁻¹ C` alone, `m × m`, which need not be positive definite.
    ///
    /// # Errors
    /// `Input` when the sizes do not fit.
    pub fn complement_of(factor: &CholeskyFactor, coupling: &[f64], corner: &[f64]) -> Result<Vec<f64>> {
        Ok(reduce(factor, coupling, corner)?.1.as_slice().to_vec())
    }

    /// How many unknowns are shared.
    #[must_use]
    pub fn shared(&self) -> usize {
        self.complement.l_dirty().nrows()
    }

    /// Solves for both: `x` from `g`, `p` from `h`. `factor` and `coupling` are those of [`Self::new`].
    ///
    /// # Errors
    /// `Input` when the sizes do not fit.
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
                "needed {} and {m} right-hand sides, found {} and {}",
                self.solved.len() / m.max(1),
                x.len(),
                p.len()
            )));
        }
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

    /// `pᵀ S p`: the square of a step of the shared unknowns in standard deviations, the others left open.
    ///
    /// # Errors
    /// `Input` when there are other than `m` of them.
    pub fn shared_length2(&self, p: &[f64]) -> Result<f64> {
        let l = self.complement.l_dirty();
        let m = l.nrows();
        if p.len() != m {
            return Err(Error::input(format!("needed {m} shared unknowns, found {}", p.len())));
        }
        Ok((0..m).map(|column| (column..m).map(|row| l[(row, column)] * p[row]).sum::<f64>().powi(2)).sum())
    }

    /// `S`, the information about the shared unknowns when all others are left open, `m × m`.
    #[must_use]
    pub fn shared_information(&self) -> Vec<f64> {
        let l = self.complement.l();
        (&l * l.transpose()).as_slice().to_vec()
    }

    /// The same without the information about the shared unknowns that is only `noise`, but never below what
    /// `least` says, and by how much their corner `P` has changed. All are `m × m`.
    ///
    /// Along the common eigenvectors of `noise` and `S`, with `μ` the share of noise in `S`, `1 − μ` of `S`
    /// is kept where `μ` is less than a quarter; of more an ever smaller part, and nothing from three
    /// quarters on, as noise scatters about its mean. In the metric of `least` no eigenvalue of what is left
    /// may fall below one.
    ///
    /// # Errors
    /// `Input` when `least` is not positive definite, or a size does not fit.
    pub fn without_noise(mut self, noise: &[f64], least: &[f64]) -> Result<(Self, Vec<f64>)> {
        let m = self.shared();
        let wrong = || Error::input(format!("needed a positive definite least information of {m} × {m}"));
        if noise.len() != m * m || least.len() != m * m {
            return Err(wrong());
        }
        let before = DMatrix::from_column_slice(m, m, &self.shared_information());
        let noise = DMatrix::from_column_slice(m, m, noise);
        let kept = with_eigenvalues(&self.complement.l(), &noise, |share| {
            let believed = (MOST_NOISE.1 - share) / (MOST_NOISE.1 - MOST_NOISE.0);
            (1.0 - share).max(0.0) * believed.clamp(0.0, 1.0)
        });
        let least = Cholesky::new(DMatrix::from_column_slice(m, m, least)).ok_or_else(wrong)?;
        let after = (kept.and_then(|kept| with_eigenvalues(&least.l(), &kept, |value| value.max(1.0))))
            .ok_or_else(wrong)?;
        let change = (&after - before).as_slice().to_vec();
        self.complement = Cholesky::new(after).ok_or_else(wrong)?;
        Ok((self, change))
    }

    /// Directions of some of the shared unknowns of which the readings took away less than a `share` of what
    /// variance `prior`, the information about them alone, leaves them: each as long as one σ of the prior,
    /// orthogonal in its metric.
    ///
    /// Eigenvectors of `L₀ᵀ Σ L₀` with eigenvalues above `1 − share`, where `L₀ L₀ᵀ` is the prior and `Σ`
    /// their part of `S⁻¹`.
    ///
    /// # Errors
    /// `Input` when the prior is not positive definite or of another size.
    pub fn undetermined(&self, of: Range<usize>, prior: &[f64], share: f64) -> Result<Vec<Vec<f64>>> {
        let m = of.len();
        let wrong = || Error::input(format!("needed a positive definite prior of {m} × {m}"));
        if prior.len() != m * m || of.end > self.shared() {
            return Err(wrong());
        }
        let l = Cholesky::new(DMatrix::from_column_slice(m, m, prior)).ok_or_else(wrong)?.l();
        let covariance = self.complement.inverse().view((of.start, of.start), (m, m)).into_owned();
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

/// `L V f(Λ) Vᵀ Lᵀ` of a symmetric matrix `L V Λ Vᵀ Lᵀ`; none where `L` is singular.
fn with_eigenvalues(l: &DMatrix<f64>, matrix: &DMatrix<f64>, f: impl Fn(f64) -> f64) -> Option<DMatrix<f64>> {
    let half = l.solve_lower_triangular(matrix)?;
    let whitened = l.solve_lower_triangular(&half.transpose())?;
    let eigen = (0.5 * (&whitened + whitened.transpose())).symmetric_eigen();
    let back = l * &eigen.eigenvectors;
    let made = &back * DMatrix::from_diagonal(&eigen.eigenvalues.map(f)) * back.transpose();
    Some(0.5 * (&made + made.transpose()))
}

/// `A⁻¹ C` and `P − Cᵀ A⁻¹ C`.
fn reduce(factor: &CholeskyFactor, coupling: &[f64], corner: &[f64]) -> Result<(Vec<f64>, DMatrix<f64>)> {
    let m = corner.len().isqrt();
    let n = factor.symbolic().pattern().nodes() * factor.symbolic().block_size();
    if m * m != corner.len() || coupling.len() != n * m {
        return Err(Error::input(format!(
            "{n} sparse unknowns and a corner of {} entries need a coupling of {n} × {m}, found {} entries",
            corner.len(),
            coupling.len()
        )));
    }
    let mut solved = coupling.to_vec();
    if m > 0 {
        factor.solve_in_place(&mut solved)?;
    }
    // Both have their rows one after the other: as columns they are transposed.
    let (c, f) = (DMatrix::from_column_slice(m, n, coupling), DMatrix::from_column_slice(m, n, &solved));
    let reduced = DMatrix::from_column_slice(m, m, corner) - &c * f.transpose();
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

    /// A chain of unknowns, of which every reading `x_i − x_{i+1} + row · p` shares three offsets.
    fn whole() -> (CholeskyFactor, Vec<f64>, Vec<f64>, DMatrix<f64>) {
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
    fn solutions_and_covariances_are_those_of_the_dense_whole() {
        let (factor, coupling, corner, dense) = whole();
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
    fn directions_that_readings_leave_as_they_were_are_found() {
        let (factor, coupling, corner, _) = whole();
        // A fourth unknown that no reading has.
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
        // The fourth alone is a direction as well, one σ long.
        let alone = bordered.undetermined(3..4, &[0.25], 0.1).unwrap();
        assert!((alone[0][0].abs() - 2.0).abs() < 1e-9 && alone.len() == 1);
    }

    #[test]
    fn information_that_is_noise_is_left_out_down_to_what_is_known_in_any_case() {
        let (factor, coupling, corner, _) = whole();
        let bordered = Bordered::new(&factor, &coupling, &corner).unwrap();
        let before = bordered.shared_information();
        let least: Vec<f64> = (0..M * M).map(|k| if k % (M + 1) == 0 { 0.2 } else { 0.0 }).collect();
        let none = bordered.clone().without_noise(&[0.0; M * M], &least).unwrap();
        assert!(none.1.iter().all(|c| c.abs() < 1e-12));
        let of_noise = |share: f64| -> Vec<f64> {
            let noise: Vec<f64> = before.iter().map(|s| share * s).collect();
            let (left, change) = bordered.clone().without_noise(&noise, &least).unwrap();
            let left = left.shared_information();
            for (k, s) in left.iter().enumerate() {
                assert!((before[k] + change[k] - s).abs() < 1e-12);
            }
            left
        };
        // A tenth is taken off, as far as the least allows; of what is mostly noise only the least is left.
        for (k, s) in of_noise(0.1).iter().enumerate() {
            let floor = if least[k] > 0.0 { least[k] } else { f64::NEG_INFINITY };
            assert!(*s > floor - 1e-12 && (0.9 * before[k] - s).abs() < 0.2, "{s} {}", before[k]);
        }
        for (s, least) in of_noise(0.9).iter().zip(&least) {
            assert!((s - least).abs() < 1e-12);
        }
    }

    #[test]
    fn a_shared_unknown_that_nothing_determines_is_said_to_be() {
        let (factor, coupling, mut corner, _) = whole();
        // The corner that would leave no information at all.
        let bordered = Bordered::new(&factor, &coupling, &corner).unwrap();
        for (c, s) in corner.iter_mut().zip(bordered.shared_information()) {
            *c -= s * (1.0 + 1e-9);
        }
        let e = Bordered::new(&factor, &coupling, &corner).unwrap_err();
        assert_eq!(e.kind(), crate::ErrorKind::Undetermined);
        assert!(Bordered::new(&factor, &coupling[1..], &corner).is_err());
    }
}
