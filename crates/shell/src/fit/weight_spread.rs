//! The uncertainty of the smoothness weight, as part of the covariance of the parameters.
//!
//! In: the information and the vector of the readings at a result, the smoothness there, and its weight of
//! maximum marginal likelihood. Out: the covariance averaged over the weights that the readings leave open.
//!
//! The likelihood of a weight `λ`, with the information `N` and the vector `b` of the readings about a change
//! `δ`, and the energy `E + 2 gᵀδ + δᵀ H δ` of rank `r`, is
//!
//! `ln L = ½ r ln λ − ½ ln |N + λH| + ½ (b − λg)ᵀ (N + λH)⁻¹ (b − λg) − ½ λE`
//!
//! (S. Wood, *Fast stable restricted maximum likelihood and marginal likelihood estimation of semiparametric
//! generalized linear models*, 2011). Its maximum alone makes parts without readings too certain: few
//! or accurate readings near a rigid motion favour `λ` without bound. Each weight `λ_k` of a grid has a
//! probability `p_k ∝ L`, uniform in `ln λ` before, and a result of its own, which differs by `δ_k`:
//!
//! `C = Σ p_k (C_k + δ_k δ_kᵀ)`, `C_k = (N + λ_k H)⁻¹`
//!
//! (R. Kass, D. Steffey, *Approximate Bayesian inference in conditionally independent hierarchical models*,
//! 1989). The grid ends where the readings determine less than [`MIN_DEGREES`] of the changes of
//! shape: all larger weights mean a rigid motion.

use super::dense::Factor;
use super::equations::NormalEquations;
use super::priors::Priors;
use super::problem::State;
use super::smoothness::LinearisedEnergy;
use nalgebra::{DMatrix, DVector};

/// Ratio of neighbouring weights.
const STEP: f64 = 3.162_277_660_168_379_5;
/// Maximum number of weights on either side of the most likely one.
const MAX_STEPS: i32 = 16;
/// Difference of log-likelihoods from the largest beyond which weights are left out.
const MAX_FALL: f64 = 6.0;
/// Number of changes of shape that the readings determine at the largest weight.
const MIN_DEGREES: f64 = 0.5;
/// Maximum number of unknowns for which weights are compared. Time grows with the cube.
const MAX_UNKNOWNS: usize = 3000;

/// The smoothness at a result, and what the readings and other priors say about changes of it.
pub(super) struct WeighedSmoothness<'a> {
    energy: Option<LinearisedEnergy<'a>>,
    /// Whether other weights than the given one are considered.
    is_open: bool,
    rank: usize,
    weight: f64,
    max_weight: f64,
    /// Information and vector of the readings and other priors, about a change of all unknowns.
    readings: (DMatrix<f64>, DVector<f64>),
}

/// A weight of the grid.
struct Candidate {
    log_likelihood: f64,
    /// Change of the parameters to its own result.
    change: DVector<f64>,
    weight: f64,
    /// Number of changes of shape that the readings determine.
    degrees: f64,
}

impl<'a> WeighedSmoothness<'a> {
    /// The smoothness of a weight, zero if there is none, at a state whose readings have the sum `pass`.
    pub(super) fn new(priors: &'a Priors<'_>, state: &State, weight: f64, pass: &NormalEquations) -> Self {
        let smooth = &priors.smooth;
        // Outlines alone tell which vertices they determine by their share of the covariance.
        let is_open = !priors.readings.points.is_empty();
        Self {
            is_open,
            energy: (weight > 0.0).then(|| smooth.linearised(&(&state.q - &priors.start))),
            rank: smooth.rank(),
            weight,
            max_weight: smooth.max_weight(),
            readings: priors.add(state, 0.0, pass),
        }
    }

    /// The covariance averaged over weights. `counted` is the information of the readings and other priors in
    /// which correlated readings count less. `None` if it does not determine all unknowns.
    pub(super) fn covariance(&self, counted: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let Some(energy) = &self.energy else { return Some(Factor::new(counted)?.inverse()) };
        let inverse = |weight: f64| Some(Factor::new(&with_energy(counted, energy, weight))?.inverse());
        let compares = self.is_open && counted.nrows() <= MAX_UNKNOWNS;
        let probable = if compares { self.probable(energy) } else { None };
        let Some(probable) = probable else { return inverse(self.weight) };
        let mut sum = DMatrix::zeros(counted.nrows(), counted.nrows());
        for (probability, weight, change) in &probable {
            sum += *probability * inverse(*weight)?;
            sum.ger(*probability, change, change, 1.0);
        }
        Some(sum)
    }

    /// Weights with their probabilities, and the changes to their results from that of the given weight.
    fn probable(&self, energy: &LinearisedEnergy<'_>) -> Option<Vec<(f64, f64, DVector<f64>)>> {
        let mut all = vec![self.candidate(energy, self.weight)?];
        for sign in [-1, 1] {
            for k in 1..=MAX_STEPS {
                let next = self.weight * STEP.powi(sign * k);
                let made = if next <= self.max_weight { self.candidate(energy, next) } else { None };
                let highest = all.iter().map(|one| one.log_likelihood).fold(f64::NEG_INFINITY, f64::max);
                let Some(made) = made.filter(|made| {
                    made.log_likelihood > highest - MAX_FALL && (sign < 0 || made.degrees > MIN_DEGREES)
                }) else {
                    break;
                };
                all.push(made);
            }
        }
        let highest = all.iter().map(|one| one.log_likelihood).fold(f64::NEG_INFINITY, f64::max);
        let total: f64 = all.iter().map(|one| (one.log_likelihood - highest).exp()).sum();
        let origin = all[0].change.clone();
        let weighed = |one: Candidate| {
            let probability = (one.log_likelihood - highest).exp() / total;
            (probability, one.weight, one.change - &origin)
        };
        Some(all.into_iter().map(weighed).collect())
    }

    fn candidate(&self, energy: &LinearisedEnergy<'_>, weight: f64) -> Option<Candidate> {
        let (information, vector) = &self.readings;
        let parameters = energy.gradient.len();
        let factor = Factor::new(&with_energy(information, energy, weight))?;
        let mut vector = vector.clone();
        let mut own = vector.rows_mut(0, parameters);
        own -= weight * &energy.gradient;
        let change = factor.solve(&vector);
        let inverse = factor.inverse();
        let used = weight * inverse.view((0, 0), (parameters, parameters)).dot(&*energy.information);
        let log_likelihood = 0.5
            * (self.rank as f64 * weight.ln() - factor.log_determinant() + vector.dot(&change)
                - weight * energy.energy);
        Some(Candidate { log_likelihood, change, weight, degrees: self.rank as f64 - used })
    }
}

/// `N + λH`; unknowns after those of the energy have none.
fn with_energy(information: &DMatrix<f64>, energy: &LinearisedEnergy<'_>, weight: f64) -> DMatrix<f64> {
    let parameters = energy.gradient.len();
    let mut sum = information.clone();
    let mut own = sum.view_mut((0, 0), (parameters, parameters));
    own += weight * &*energy.information;
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::borrow::Cow;

    const COUNT: usize = 12;

    /// Second differences of a row of numbers, of which readings of σ = 1 measure the first few as `values`.
    fn chain(values: &[f64], max_weight: f64) -> WeighedSmoothness<'static> {
        let mut bending = DMatrix::zeros(COUNT, COUNT);
        for i in 1..COUNT - 1 {
            let row = DVector::from_fn(COUNT, |k, _| match k.abs_diff(i) {
                0 => -2.0,
                1 => 1.0,
                _ => 0.0,
            });
            bending += &row * row.transpose();
        }
        let mut information = DMatrix::zeros(COUNT, COUNT);
        (0..values.len()).for_each(|k| information[(k, k)] = 1.0);
        let vector = DVector::from_fn(COUNT, |k, _| values.get(k).copied().unwrap_or(0.0));
        let gradient = DVector::zeros(COUNT);
        WeighedSmoothness {
            energy: Some(LinearisedEnergy { energy: 0.0, gradient, information: Cow::Owned(bending) }),
            is_open: true,
            rank: COUNT - 2,
            weight: 1.0,
            max_weight,
            readings: (information, vector),
        }
    }

    fn sigma_at_the_end(smoothness: &WeighedSmoothness<'_>) -> f64 {
        smoothness.covariance(&smoothness.readings.0).unwrap()[(COUNT - 1, COUNT - 1)].sqrt()
    }

    /// Values on a line leave the weight open, and the far end is less certain than with the given weight.
    #[test]
    fn an_open_weight_adds_to_sigma() {
        let line: Vec<f64> = (0..6).map(|k| 0.5 * f64::from(k)).collect();
        let open = WeighedSmoothness { weight: 10.0, ..chain(&line, f64::INFINITY) };
        let fixed = WeighedSmoothness { is_open: false, weight: 10.0, ..chain(&line, f64::INFINITY) };
        assert!(sigma_at_the_end(&open) > 2.0 * sigma_at_the_end(&fixed));
        let weights = open.probable(open.energy.as_ref().unwrap()).unwrap();
        let total: f64 = weights.iter().map(|(p, ..)| p).sum();
        assert!((total - 1.0).abs() < 1e-12);
        assert!(weights.len() > 3 && weights.iter().all(|(_, weight, _)| *weight <= 10.0));
    }

    /// Weights above the maximum are not considered.
    #[test]
    fn weights_stay_below_their_maximum() {
        let limited = chain(&[0.0; 6], 1.5);
        let weights = limited.probable(limited.energy.as_ref().unwrap()).unwrap();
        assert!(weights.iter().all(|(_, weight, _)| *weight <= 1.5));
        assert!(sigma_at_the_end(&limited) > sigma_at_the_end(&chain(&[0.0; 6], f64::INFINITY)));
    }
}
