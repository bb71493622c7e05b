//! The prior of smooth displacements, and its weight by marginal likelihood.
//!
//! In: a stiffness `K`, and the information of the data about the parameters. Out: `λ` of
//! `λ/2 · (q − m)ᵀ K (q − m)`. Source: S. Wood, M. Fasiolo, *A generalized Fellner-Schall method for
//! smoothing parameter optimization*, 2017.

use super::dense::Factor;
use super::undetermined;
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Dispersion, Error, Result, SmoothnessEvaluation, SmoothnessModel};

/// Maximum number of updates of the weight in one iteration of the fit.
const MAX_UPDATES: usize = 20;
/// Above this number of unknowns an update costs as much as an iteration. Then only a few updates are made,
/// and the weight converges together with the fit.
const MANY_UNKNOWNS: usize = 1000;
const MAX_UPDATES_OF_MANY: usize = 3;

/// The prior and its weight.
pub(super) struct Smoothness {
    pub stiffness: DMatrix<f64>,
    rank: usize,
    weight: f64,
    /// Upper limit of the weight.
    max_weight: f64,
}

impl Smoothness {
    /// A prior whose weight is limited to that of independent displacements of `start_sigma`. Their expected
    /// roughness is `σ² tr K`, and that of the prior is `rank(K)/λ`.
    pub(super) fn new(stiffness: DMatrix<f64>, start_sigma: Option<f64>) -> Result<Self> {
        let (own, times) = match of_one_coordinate(&stiffness) {
            Some(own) => (own, 3),
            None => (stiffness.clone(), 1),
        };
        // The rank is needed once per fit; the stiffness does not change.
        let eigen = own.symmetric_eigenvalues();
        let largest = eigen.iter().copied().fold(0.0, f64::max);
        if eigen.iter().any(|e| *e < -1e-8 * largest) {
            return Err(Error::input("expected a positive semidefinite stiffness of the controls"));
        }
        let rank = times * eigen.iter().filter(|e| **e > 1e-10 * largest).count();
        let max_weight =
            start_sigma.map_or(f64::INFINITY, |sigma| rank as f64 / (sigma * sigma * stiffness.trace()));
        Ok(Self { rank, stiffness, weight: 0.0, max_weight })
    }

    pub(super) fn roughness(&self, q: &DVector<f64>) -> f64 {
        q.dot(&(&self.stiffness * q))
    }

    /// The weight of maximum marginal likelihood, linearised at `q`: the data require `N x = N q + b` of the
    /// total displacement `x`.
    pub(super) fn weight(
        &mut self,
        information: &DMatrix<f64>,
        vector: &DVector<f64>,
        q: &DVector<f64>,
    ) -> Result<f64> {
        if self.rank == 0 {
            return Ok(0.0);
        }
        let natural = information.trace() / self.stiffness.trace();
        if natural.is_nan() || natural <= 0.0 {
            return Err(undetermined());
        }
        if self.weight == 0.0 {
            self.weight = (0.01 * natural).min(self.max_weight);
        }
        // The prior concerns total displacements from the start, not the increment of this iteration.
        let target = information * q + vector;
        let model = SmoothnessModel {
            equations: q.len() + 1,
            unknowns: q.len(),
            rank: self.rank,
            log_pseudo_determinant: 0.0,
            dispersion: Dispersion::Known(1.0),
        };
        let updates = if q.len() > MANY_UNKNOWNS { MAX_UPDATES_OF_MANY } else { MAX_UPDATES };
        for _ in 0..updates {
            let Some(factor) = Factor::new(&(information + self.weight * &self.stiffness)) else {
                return Err(undetermined());
            };
            let x = factor.solve(&target);
            // The update does not use the determinants, so they are not computed.
            let evaluation = SmoothnessEvaluation {
                residual: 0.0,
                roughness: self.roughness(&x),
                log_determinant: 0.0,
                trace: Some(factor.inverse().dot(&self.stiffness)),
            };
            let next = (model.fellner_schall_update(self.weight, &evaluation)?)
                .clamp(1e-8 * natural, 1e8 * natural)
                .min(self.max_weight);
            let change = (next / self.weight).ln().abs();
            self.weight = next;
            if change < 0.02 {
                break;
            }
        }
        Ok(self.weight)
    }
}

/// The factor `K₁` if `K = K₁ ⊗ I₃`. `K` then has the eigenvalues of `K₁`, three times each, which are 27
/// times cheaper to compute.
fn of_one_coordinate(stiffness: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let size = stiffness.nrows();
    if !size.is_multiple_of(3) {
        return None;
    }
    let own = DMatrix::from_fn(size / 3, size / 3, |i, j| stiffness[(3 * i, 3 * j)]);
    let same = (0..size).all(|j| {
        (0..size).all(|i| stiffness[(i, j)] == if i % 3 == j % 3 { own[(i / 3, j / 3)] } else { 0.0 })
    });
    same.then_some(own)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings that agree with the start drive the weight to its maximum, so that the start seems certain; σ
    /// of the start limits it.
    #[test]
    fn start_sigma_limits_the_smoothness_weight() {
        let count = 10;
        let mut bending = DMatrix::zeros(count, count);
        for i in 1..count - 1 {
            let row = DVector::from_fn(count, |k, _| match k.abs_diff(i) {
                0 => -2.0,
                1 => 1.0,
                _ => 0.0,
            });
            bending += &row * row.transpose();
        }
        let information = DMatrix::identity(count, count);
        let zero = DVector::zeros(count);
        let weight = |start_sigma| {
            let mut smooth = Smoothness::new(bending.clone(), start_sigma).unwrap();
            smooth.weight(&information, &zero, &zero).unwrap()
        };
        let (free, held) = (weight(None), weight(Some(2.0)));
        assert!((held - 8.0 / (4.0 * bending.trace())).abs() < 1e-9, "{held}");
        assert!(free > 1e3 * held, "{free} {held}");
    }
}
