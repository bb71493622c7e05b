//! Sequential filters for implicit readings: EKF, IEKF and NUIEKF, without allocation in their iterations.

use super::{ImplicitReading, MAX_NOISE, MAX_STATE, Normalized, best_branch, curvature_bias};
use crate::{Error, Termination};
use crate::{KalmanFilter, Loss, Relinearization, Result};

/// Options of an update with an implicit reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImplicitUpdate {
    /// Where to linearise.
    pub relinearization: Relinearization,
    /// If true, the mean distance caused by curvature is subtracted. Only effective if the noise is
    /// relinearised.
    pub correct_bias: bool,
    /// Maximum number of linearisations.
    pub max_iterations: usize,
    /// Stop when neither state nor noise moves by more than this many standard deviations.
    pub tolerance: f64,
    /// Reject a reading whose innovation exceeds this many standard deviations.
    pub gate: Option<f64>,
    /// Reject a reading closer than this many standard deviations to an end of its branch: it may belong to
    /// the next branch.
    pub margin: Option<f64>,
    /// Loss of the innovation; the variance of the reading is divided by its weight.
    pub loss: Loss,
}

impl ImplicitUpdate {
    /// Linearised once, at the prediction and zero noise (EKF).
    #[must_use]
    pub fn extended() -> Self {
        Self {
            relinearization: Relinearization::Never,
            correct_bias: false,
            max_iterations: 1,
            tolerance: 1e-4,
            gate: None,
            margin: None,
            loss: Loss::Gaussian,
        }
    }

    /// Relinearised in the state (IEKF).
    #[must_use]
    pub fn iterated() -> Self {
        Self { relinearization: Relinearization::State, max_iterations: 30, ..Self::extended() }
    }

    /// Relinearised in state and noise (NUIEKF), corrected for curvature.
    #[must_use]
    pub fn noise_updated() -> Self {
        Self { relinearization: Relinearization::StateAndNoise, correct_bias: true, ..Self::iterated() }
    }
}

/// Result of an update with an implicit reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImplicitInnovation {
    /// The innovation divided by the standard deviation of the reading.
    pub residual: f64,
    /// Its variance, `1 + h P hᵀ`.
    pub variance: f64,
    /// `residual² / variance`: distributed as χ² with one degree of freedom if the filter is consistent.
    pub normalized_squared: f64,
    /// True if the reading passed the gate and changed the state.
    pub accepted: bool,
    /// Number of linearisations.
    pub iterations: usize,
    /// How the iteration ended.
    pub termination: Termination,
}

impl KalmanFilter {
    /// Updates with a reading `g(z − L u, x) = 0`, `u ~ N(0, I)`.
    ///
    /// With `h = g_x/|g_u|`, `n = g_u/|g_u|` and `s = n·u − g/|g_u|` at `(x_i, u_i)`: `e = s − h (x̂ − x_i)`,
    /// `S = 1 + h P hᵀ`, `x_{i+1} = x̂ + P hᵀ e / S`, `u_{i+1} = n e / S`. Finally the mean of the score by
    /// [`curvature_bias`] is subtracted. The branch is chosen at the prediction. Cost: about `n²` per
    /// iteration.
    ///
    /// # Errors
    /// `Input` when the state has another dimension, or when the equation is not defined there. The filter is
    /// then unchanged.
    ///
    /// # References
    /// Bondarenko, Halevi, Shpitalni 2004; Weiss-Cohen, Bondarenko, Halevi 2009, eq. 2.17.
    pub fn update_implicit<R: ImplicitReading + ?Sized>(
        &mut self,
        reading: &R,
        options: &ImplicitUpdate,
    ) -> Result<ImplicitInnovation> {
        let (n, p) = (self.mean().len(), reading.noise());
        if reading.state() != n || n > MAX_STATE || p > MAX_NOISE {
            return Err(Error::input(format!(
                "expected a reading of {n} unknowns, found {} unknowns and {p} noise components",
                reading.state()
            )));
        }
        let undefined = || Error::input("the equation of a reading is not defined at the predicted state");
        let zero = [0.0; MAX_NOISE];
        let mut at = Normalized::new();
        let mut x = [0.0; MAX_STATE];
        x[..n].copy_from_slice(self.mean().as_slice());
        let mut u = zero;
        // The branch of the prediction is kept during the iteration.
        let branch = best_branch(reading, &x[..n]);
        let mut spread = [0.0; MAX_STATE];
        let mut innovation = ImplicitInnovation {
            residual: 0.0,
            variance: 1.0,
            normalized_squared: 0.0,
            accepted: true,
            iterations: 0,
            termination: Termination::Limit,
        };
        // Iterate linearisation and update. Mean and covariance stay those before the reading.
        let mut previous = f64::INFINITY;
        loop {
            if !at.at(reading, branch, &x[..n], &u[..p], &zero[..p]) {
                return Err(undefined());
            }
            innovation.iterations += 1;
            // The equation is divided by its standard deviation, so the variance of the reading is 1.
            innovation.variance = 1.0 + self.spread_of(&at.row[..n], &mut spread[..n]);
            innovation.residual = at.distance;
            for k in 0..n {
                innovation.residual += at.row[k] * (x[k] - self.mean()[k]);
            }
            if options.relinearization == Relinearization::Never {
                innovation.termination = Termination::Converged;
                break;
            }
            let step = innovation.residual / innovation.variance;
            let mut moved = self.move_state(&spread[..n], step, &mut x[..n]);
            if options.relinearization == Relinearization::StateAndNoise {
                for k in 0..p {
                    let next = at.normal[k] * step;
                    moved = moved.max((next - u[k]).abs());
                    u[k] = next;
                }
            }
            if moved <= options.tolerance {
                innovation.termination = Termination::Converged;
                break;
            }
            // Growing steps will not converge. The last linearisation is used, and `Limit` reports it.
            if innovation.iterations >= options.max_iterations || (moved > 4.0 * previous && moved > 10.0) {
                break;
            }
            previous = moved;
        }
        let mut row_bias = [0.0; MAX_STATE];
        // Bias correction, gate and margin use the final linearisation. The correction assumes the foot
        // point: at the noisy reading, gradient and misclosure are correlated, and an EKF would get another
        // bias.
        if options.correct_bias && options.relinearization == Relinearization::StateAndNoise {
            innovation.residual -= curvature_bias(reading, branch, &x[..n], &u[..p], &at, &mut row_bias[..n]);
        }
        innovation.normalized_squared = innovation.residual * innovation.residual / innovation.variance;
        let length = innovation.normalized_squared.sqrt();
        // NaN fails every comparison and would pass a gate that only tests for excess.
        if options.gate.is_some_and(|gate| length.is_nan() || length > gate) {
            innovation.accepted = false;
            return Ok(innovation);
        }
        // Filters without noise iteration have no corrected reading yet: use the first-order foot point.
        if options.relinearization != Relinearization::StateAndNoise {
            for k in 0..p {
                u[k] = at.normal[k] * at.distance;
            }
        }
        let near_end = options.margin.is_some_and(|m| reading.margin(branch, &x[..n], &u[..p]) < m);
        let weight = options.loss.weight(length);
        if near_end || weight <= 0.0 || !innovation.residual.is_finite() {
            innovation.accepted = false;
            return Ok(innovation);
        }
        // The loss changes the variance of the reading, 1, to 1/weight. That of the prediction stays.
        self.update_with_spread(&spread[..n], innovation.residual, innovation.variance - 1.0 + 1.0 / weight);
        if row_bias[..n].iter().any(|c| *c != 0.0) {
            // The bias of the score beyond the mean distance shifts the state. It needs the updated
            // covariance.
            self.shift(&row_bias[..n], -weight);
        }
        Ok(innovation)
    }

    /// Sets `x` to the mean plus `step · spread`. Returns the largest change of a component in standard
    /// deviations.
    fn move_state(&self, spread: &[f64], step: f64, x: &mut [f64]) -> f64 {
        let mut moved = 0.0_f64;
        for (k, x) in x.iter_mut().enumerate() {
            let next = self.mean()[k] + spread[k] * step;
            let sigma = self.covariance()[(k, k)].max(f64::MIN_POSITIVE).sqrt();
            moved = moved.max((next - *x).abs() / sigma);
            *x = next;
        }
        moved
    }

    /// Updates with a scalar reading of known `P hᵀ` and `S = h P hᵀ + R`, for `R ≥ 1`.
    ///
    /// The short form `P − P hᵀ h P / S` is safe here: with `R ≥ 1` cancellation is harmless, and symmetry is
    /// exact because both triangles are written together.
    fn update_with_spread(&mut self, spread: &[f64], residual: f64, total: f64) {
        let n = spread.len();
        let (mean, covariance) = self.parts_mut();
        let scale = 1.0 / total;
        for j in 0..n {
            let gain = scale * spread[j];
            mean[j] += gain * residual;
            for i in 0..=j {
                let value = covariance[(i, j)] - gain * spread[i];
                covariance[(i, j)] = value;
                covariance[(j, i)] = value;
            }
        }
    }

    /// Adds `share P w` to the state.
    fn shift(&mut self, w: &[f64], share: f64) {
        let (mean, covariance) = self.parts_mut();
        for (j, value) in w.iter().enumerate() {
            mean.axpy(share * value, &covariance.column(j), 1.0);
        }
    }

    /// Fills `P hᵀ` and returns `h P hᵀ`.
    fn spread_of(&self, row: &[f64], spread: &mut [f64]) -> f64 {
        let covariance = self.covariance();
        let mut total = 0.0;
        for (j, out) in spread.iter_mut().enumerate() {
            *out = covariance.column(j).iter().zip(row).map(|(c, h)| c * h).sum();
            total += *out * row[j];
        }
        total
    }
}
