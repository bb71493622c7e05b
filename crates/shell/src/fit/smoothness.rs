//! The prior of smooth displacements, and its weight by marginal likelihood.
//!
//! Comes in: a stiffness `K`, and the information of the data about the parameters. Goes out: `λ` of `λ/2 · (q − m)ᵀ K (q − m)`.
//! Source: S. Wood, M. Fasiolo, *A generalized Fellner-Schall method for smoothing parameter optimization*, 2017.

use super::undetermined;
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Dispersion, Error, Result, SmoothnessEvaluation, SmoothnessModel};

/// The prior and its weight.
pub(super) struct Smoothness {
    pub stiffness: DMatrix<f64>,
    rank: usize,
    log_pseudo_determinant: f64,
    weight: f64,
}

impl Smoothness {
    pub(super) fn new(stiffness: DMatrix<f64>) -> Result<Self> {
        let eigen = stiffness.clone().symmetric_eigen().eigenvalues;
        let largest = eigen.iter().copied().fold(0.0, f64::max);
        let positive: Vec<f64> = eigen.iter().copied().filter(|e| *e > 1e-10 * largest).collect();
        if eigen.iter().any(|e| *e < -1e-8 * largest) {
            return Err(Error::input("the stiffness of controls is not positive semidefinite"));
        }
        Ok(Self {
            rank: positive.len(),
            log_pseudo_determinant: positive.iter().map(|e| e.ln()).sum(),
            stiffness,
            weight: 0.0,
        })
    }

    pub(super) fn roughness(&self, q: &DVector<f64>) -> f64 {
        q.dot(&(&self.stiffness * q))
    }

    /// The weight that makes the data most likely, linearised at `q`: they say `N x = N q + b` of the whole displacement `x`.
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
            self.weight = 0.01 * natural;
        }
        let target = information * q + vector;
        let model = SmoothnessModel {
            equations: q.len() + 1,
            unknowns: q.len(),
            rank: self.rank,
            log_pseudo_determinant: self.log_pseudo_determinant,
            dispersion: Dispersion::Known(1.0),
        };
        for _ in 0..20 {
            let equations = information + self.weight * &self.stiffness;
            let Some(factor) = equations.cholesky() else {
                return Err(undetermined());
            };
            let x = factor.solve(&target);
            let evaluation = SmoothnessEvaluation {
                residual: 0.0,
                roughness: self.roughness(&x),
                log_determinant: 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>(),
                trace: Some(factor.solve(&self.stiffness).trace()),
            };
            let next = (model.fellner_schall_update(self.weight, &evaluation)?).clamp(1e-8 * natural, 1e8 * natural);
            let change = (next / self.weight).ln().abs();
            self.weight = next;
            if change < 0.02 {
                break;
            }
        }
        Ok(self.weight)
    }
}
