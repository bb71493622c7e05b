//! The priors of a fit: smoothness, a Gaussian prior, and the uncertainty of camera poses.
//!
//! In: the sum of the readings' equations. Out: the same with the priors added, and the cost of the priors.

use super::equations::NormalEquations;
use super::problem::State;
use super::readings::{PoseNoise, ShellReadings};
use super::smoothness::Smoothness;
use super::{ShellFitOptions, undetermined};
use nalgebra::{DMatrix, DVector};
use planish_estimate::Result;

/// The priors and the readings that they complement.
pub(super) struct Priors<'a> {
    pub smooth: Smoothness,
    pub options: &'a ShellFitOptions,
    /// Parameters from which smooth displacements are counted.
    pub start: DVector<f64>,
    /// The view and the noise of every pose in the state.
    pub poses: Vec<(usize, PoseNoise)>,
    pub readings: &'a ShellReadings<'a>,
}

impl Priors<'_> {
    /// Adds priors to information and vector.
    pub(super) fn add(
        &self,
        state: &State,
        weight: f64,
        pass: &NormalEquations,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let (mut information, mut vector) = (pass.information.clone(), pass.vector.clone());
        let parameters = state.q.len();
        let mut own = information.view_mut((0, 0), (parameters, parameters));
        let mut slope = vector.rows_mut(0, parameters);
        if weight > 0.0 {
            // Smoothness penalises the change from the start, not the shape itself: the mesh may have any
            // curvature.
            let smooth = self.smooth.linearised(&(&state.q - &self.start));
            own += weight * &*smooth.information;
            slope -= weight * smooth.gradient;
        }
        if let Some(prior) = &self.options.prior {
            own += &prior.information;
            slope -= &prior.information * (&state.q - &prior.mean);
        }
        for (slot, (view, noise)) in self.poses.iter().enumerate() {
            let change = state.cameras[*view].change_from(&self.readings.views[*view].camera);
            for k in 0..6 {
                let w = information_of(noise, k);
                let at = parameters + 6 * slot + k;
                information[(at, at)] += w;
                vector[at] -= w * change[k];
            }
        }
        (information, vector)
    }

    /// The cost of the priors.
    pub(super) fn cost(&self, state: &State, weight: f64) -> f64 {
        let mut sum = 0.5 * weight * self.smooth.roughness(&(&state.q - &self.start));
        if let Some(prior) = &self.options.prior {
            let off = &state.q - &prior.mean;
            sum += 0.5 * off.dot(&(&prior.information * &off));
        }
        for (view, noise) in &self.poses {
            let change = state.cameras[*view].change_from(&self.readings.views[*view].camera);
            sum += (0..6).map(|k| 0.5 * information_of(noise, k) * change[k] * change[k]).sum::<f64>();
        }
        sum
    }

    /// The state after a step.
    pub(super) fn moved(&self, state: &State, change: &DVector<f64>) -> State {
        let parameters = state.q.len();
        let mut next = State { q: &state.q + change.rows(0, parameters), cameras: state.cameras.clone() };
        for (slot, (view, _)) in self.poses.iter().enumerate() {
            let by = std::array::from_fn(|k| change[parameters + 6 * slot + k]);
            // Rotations are updated by composition; adding rotation vectors would not be a rotation by the
            // sum.
            next.cameras[*view] = state.cameras[*view].moved(by);
        }
        next
    }

    /// Information and vector of the parameters, marginalised over the poses (Schur complement).
    pub(super) fn without_poses(&self, state: &State, pass: &NormalEquations) -> Result<NormalEquations> {
        let (parameters, rest) = (state.q.len(), 6 * self.poses.len());
        let own = pass.information.view((0, 0), (parameters, parameters)).into_owned();
        let vector = pass.vector.rows(0, parameters).into_owned();
        if rest == 0 {
            return Ok(NormalEquations { information: own, vector });
        }
        // Only the block of the poses is used. It needs its priors: poses that no reading determines would
        // make the corner singular.
        let (all, slope) = self.add(state, 0.0, pass);
        let corner = all.view((parameters, parameters), (rest, rest)).into_owned();
        let mixed = pass.information.view((parameters, 0), (rest, parameters)).into_owned();
        let factor = corner.cholesky().ok_or_else(undetermined)?;
        Ok(NormalEquations {
            // The Schur complement marginalises the poses. Their uncertainty is then part of the information
            // about the shape.
            information: own - mixed.tr_mul(&factor.solve(&mixed)),
            vector: vector - mixed.tr_mul(&factor.solve(&slope.rows(parameters, rest).into_owned())),
        })
    }
}

fn information_of(noise: &PoseNoise, k: usize) -> f64 {
    let sigma = if k < 3 { noise.sigma_rotation } else { noise.sigma_translation };
    1.0 / (sigma * sigma)
}
