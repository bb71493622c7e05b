//! The prior of smooth displacements, and its weight by marginal likelihood.
//!
//! In: a stiffness `K` or a rigidity, and the information of the data about the parameters. Out: `λ` of `λ/2
//! · (q − m)ᵀ K (q − m)`, or of `λ/2 · E(q − m)` with the energy linearised where the fit is. Source: S.
//! Wood, M. Fasiolo, *A generalized Fellner-Schall method for smoothing parameter optimization*, 2017.

use super::dense::Factor;
use super::undetermined;
use crate::rigidity::Rigidity;
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use planish_estimate::{Dispersion, Error, Result, SmoothnessEvaluation, SmoothnessModel};
use std::borrow::Cow;

/// Maximum number of updates of the weight in one iteration of the fit.
const MAX_UPDATES: usize = 20;
/// Above this number of unknowns an update costs as much as an iteration. Then only a few updates are made,
/// and the weight converges together with the fit.
const MANY_UNKNOWNS: usize = 1000;
const MAX_UPDATES_OF_MANY: usize = 3;
/// Minimum roughness after a step, as a share of that before it.
const MIN_ROUGHNESS: f64 = 1e-3;

/// The energy that is small for smooth displacements.
enum Energy {
    /// `dᵀ K d` of the displacements `d`.
    Linear(DMatrix<f64>),
    /// The energy of points that the first parameters displace.
    AsRigidAsPossible(Rigidity),
}

/// The energy near given displacements: `E + 2 gᵀδ + δᵀ H δ`.
pub(super) struct LinearisedEnergy<'a> {
    pub energy: f64,
    pub gradient: DVector<f64>,
    pub information: Cow<'a, DMatrix<f64>>,
}

/// The prior and its weight.
pub(super) struct Smoothness {
    energy: Energy,
    rank: usize,
    weight: f64,
    /// Upper limit of the weight.
    max_weight: f64,
}

impl Smoothness {
    /// A prior whose weight is limited to that of independent displacements of `start_sigma`. Their expected
    /// roughness is `σ² tr K`, and that of the prior is `rank(K)/λ`.
    pub(super) fn new(
        stiffness: DMatrix<f64>,
        rigidity: Option<Rigidity>,
        start_sigma: Option<f64>,
    ) -> Result<Self> {
        let (energy, rank, trace) = match rigidity {
            Some(rigidity) => {
                let rank = rigidity.rank();
                let at_rest = rigidity.linearised(rigidity.rest()).information.trace();
                (Energy::AsRigidAsPossible(rigidity), rank, at_rest)
            }
            None => {
                let (rank, trace) = (rank_of_stiffness(&stiffness)?, stiffness.trace());
                (Energy::Linear(stiffness), rank, trace)
            }
        };
        let max_weight = start_sigma.map_or(f64::INFINITY, |sigma| rank as f64 / (sigma * sigma * trace));
        Ok(Self { energy, rank, weight: 0.0, max_weight })
    }

    /// Starts with the weight of an earlier fit.
    pub(super) fn resume(&mut self, weight: f64) {
        self.weight = weight.min(self.max_weight);
    }

    /// Number of independent changes of shape.
    pub(super) fn rank(&self) -> usize {
        self.rank
    }

    /// Upper limit of the weight.
    pub(super) fn max_weight(&self) -> f64 {
        self.max_weight
    }

    /// True if rotations of parts have no energy.
    pub(super) fn allows_rotations(&self) -> bool {
        matches!(self.energy, Energy::AsRigidAsPossible(_))
    }

    /// The energy of displacements.
    pub(super) fn roughness(&self, displacements: &DVector<f64>) -> f64 {
        match &self.energy {
            Energy::Linear(stiffness) => displacements.dot(&(stiffness * displacements)),
            Energy::AsRigidAsPossible(rigidity) => rigidity.energy(&displaced(rigidity, displacements)),
        }
    }

    /// The energy near displacements, by all parameters.
    pub(super) fn linearised(&self, displacements: &DVector<f64>) -> LinearisedEnergy<'_> {
        match &self.energy {
            Energy::Linear(stiffness) => {
                let gradient = stiffness * displacements;
                LinearisedEnergy {
                    energy: displacements.dot(&gradient),
                    gradient,
                    information: Cow::Borrowed(stiffness),
                }
            }
            Energy::AsRigidAsPossible(rigidity) => {
                let of_points = rigidity.linearised(&displaced(rigidity, displacements));
                // Parameters after those of the points, the motions of parts, have no energy.
                let (all, own) = (displacements.len(), of_points.gradient.len());
                LinearisedEnergy {
                    energy: of_points.energy,
                    gradient: of_points.gradient.resize_vertically(all, 0.0),
                    information: Cow::Owned(match all == own {
                        true => of_points.information,
                        false => of_points.information.resize(all, all, 0.0),
                    }),
                }
            }
        }
    }

    /// The weight of maximum marginal likelihood, linearised at the displacements `d`: the data have the
    /// information `N` about a change of them, and favour `N δ = b`.
    pub(super) fn weight(
        &mut self,
        information: &DMatrix<f64>,
        vector: &DVector<f64>,
        displacements: &DVector<f64>,
    ) -> Result<f64> {
        if self.rank == 0 {
            return Ok(0.0);
        }
        let own = self.linearised(displacements);
        let natural = information.trace() / own.information.trace();
        if natural.is_nan() || natural <= 0.0 {
            return Err(undetermined());
        }
        let mut weight = match self.weight {
            0.0 => (0.01 * natural).min(self.max_weight),
            before => before,
        };
        let model = SmoothnessModel {
            equations: vector.len() + 1,
            unknowns: vector.len(),
            rank: self.rank,
            log_pseudo_determinant: 0.0,
            dispersion: Dispersion::Known(1.0),
        };
        let updates = if vector.len() > MANY_UNKNOWNS { MAX_UPDATES_OF_MANY } else { MAX_UPDATES };
        for _ in 0..updates {
            let Some(factor) = Factor::new(&(information + weight * &*own.information)) else {
                return Err(undetermined());
            };
            // The prior concerns total displacements from the start, not the increment of this iteration.
            let change = factor.solve(&(vector - weight * &own.gradient));
            let roughness =
                own.energy + 2.0 * own.gradient.dot(&change) + change.dot(&(&*own.information * &change));
            // The update does not use the determinants, so they are not computed.
            let evaluation = SmoothnessEvaluation {
                residual: 0.0,
                // The quadratic model of an energy that is not quadratic may become negative.
                roughness: roughness.max(MIN_ROUGHNESS * own.energy),
                log_determinant: 0.0,
                trace: Some(factor.inverse().dot(&own.information)),
            };
            let next = (model.fellner_schall_update(weight, &evaluation)?)
                .clamp(1e-8 * natural, 1e8 * natural)
                .min(self.max_weight);
            let change = (next / weight).ln().abs();
            weight = next;
            if change < 0.02 {
                break;
            }
        }
        self.weight = weight;
        Ok(self.weight)
    }
}

/// The points of an energy after their displacements, the first parameters.
pub(super) fn displaced(rigidity: &Rigidity, displacements: &DVector<f64>) -> Vec<DVec3> {
    (rigidity.rest().iter().enumerate())
        .map(|(k, p)| *p + DVec3::from_array(std::array::from_fn(|axis| displacements[3 * k + axis])))
        .collect()
}

/// The rank of a stiffness. It is needed once per fit, because the stiffness does not change.
fn rank_of_stiffness(stiffness: &DMatrix<f64>) -> Result<usize> {
    let (own, times) = match of_one_coordinate(stiffness) {
        Some(own) => (own, 3),
        None => (stiffness.clone(), 1),
    };
    let eigen = own.symmetric_eigenvalues();
    let largest = eigen.iter().copied().fold(0.0, f64::max);
    if eigen.iter().any(|e| *e < -1e-8 * largest) {
        return Err(Error::input("expected a positive semidefinite stiffness of the controls"));
    }
    Ok(times * eigen.iter().filter(|e| **e > 1e-10 * largest).count())
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
            let mut smooth = Smoothness::new(bending.clone(), None, start_sigma).unwrap();
            smooth.weight(&information, &zero, &zero).unwrap()
        };
        let (free, held) = (weight(None), weight(Some(2.0)));
        assert!((held - 8.0 / (4.0 * bending.trace())).abs() < 1e-9, "{held}");
        assert!(free > 1e3 * held, "{free} {held}");
    }
}
