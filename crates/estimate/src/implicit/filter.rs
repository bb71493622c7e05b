//! One implicit reading at a time: EKF, IEKF and NUIEKF without allocation in their iterations.

use super::{ImplicitReading, MOST_NOISE, MOST_STATE, Normalized, best_branch, curvature_bias};
use crate::{Error, Termination};
use crate::{KalmanFilter, Loss, Relinearization, Result};

/// How to take in an implicit reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImplicitUpdate {
    /// Where to linearise.
    pub relinearization: Relinearization,
    /// Whether the mean distance that curvature causes is taken off. Only where the noise is relinearised is
    /// that the bias.
    pub correct_bias: bool,
    /// The most linearisations.
    pub max_iterations: usize,
    /// Stop when neither state nor noise moves by more than this many standard deviations.
    pub tolerance: f64,
    /// A reading whose innovation exceeds this many standard deviations is left out.
    pub gate: Option<f64>,
    /// A reading nearer to the end of its branch than so many standard deviations is left out: it may be of
    /// the next one.
    pub margin: Option<f64>,
    /// What an innovation is charged; its weight divides the reading's variance.
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

    /// Linearised anew in the state (IEKF).
    #[must_use]
    pub fn iterated() -> Self {
        Self { relinearization: Relinearization::State, max_iterations: 30, ..Self::extended() }
    }

    /// Linearised anew in state and noise (NUIEKF), corrected for curvature.
    #[must_use]
    pub fn noise_updated() -> Self {
        Self { relinearization: Relinearization::StateAndNoise, correct_bias: true, ..Self::iterated() }
    }
}

/// What an implicit reading had to say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImplicitInnovation {
    /// The innovation over the reading's own standard deviation.
    pub residual: f64,
    /// Its variance, `1 + h P hᵀ`.
    pub variance: f64,
    /// `residual² / variance`: χ² of one degree when the filter is consistent.
    pub normalized_squared: f64,
    /// Whether it passed the gate and changed the state.
    pub accepted: bool,
    /// How often the equation was linearised.
    pub iterations: usize,
    /// Whether the update settled.
    pub termination: Termination,
}

impl KalmanFilter {
    /// Takes in a reading `g(z − L u, x) = 0`, `u ~ N(0, I)`.
    ///
    /// With `h = g_x/|g_u|`, `n = g_u/|g_u|` and `s = n·u − g/|g_u|` at `(x_i, u_i)`: `e = s − h (x̂ − x_i)`,
    /// `S = 1 + h P hᵀ`, `x_{i+1} = x̂ + P hᵀ e / S`, `u_{i+1} = n e / S`. At the end the mean of the score
    /// by [`curvature_bias`] is taken off. The facet is chosen at the prediction. Cost: about `n²` an
    /// iteration.
    ///
    /// # Errors
    /// `Input` when the state has another dimension, or when the equation is not defined there. The filter
    /// then stays as it was.
    ///
    /// # References
    /// Bondarenko, Halevi, Shpitalni 2004; Weiss-Cohen, Bondarenko, Halevi 2009, eq. 2.17.
    pub fn update_implicit<R: ImplicitReading + ?Sized>(
        &mut self,
        reading: &R,
        options: &ImplicitUpdate,
    ) -> Result<ImplicitInnovation> {
        let (n, p) = (self.mean().len(), reading.noise());
        if reading.state() != n || n > MOST_STATE || p > MOST_NOISE {
            return Err(Error::input(format!(
                "a reading of {} unknowns and {p} noises does not fit a state of {n}",
                reading.state()
            )));
        }
        let undefined = || Error::input("a reading's equation is not defined at the predicted state");
        let zero = [0.0; MOST_NOISE];
        let mut at = Normalized::new();
        let mut x = [0.0; MOST_STATE];
        x[..n].copy_from_slice(self.mean().as_slice());
        let mut u = zero;
        let branch = best_branch(reading, &x[..n]);
        let mut spread = [0.0; MOST_STATE];
        let mut innovation = ImplicitInnovation {
            residual: 0.0,
            variance: 1.0,
            normalized_squared: 0.0,
            accepted: true,
            iterations: 0,
            termination: Termination::Limit,
        };
        let mut previous = f64::INFINITY;
        loop {
            if !at.at(reading, branch, &x[..n], &u[..p], &zero[..p]) {
                return Err(undefined());
            }
            innovation.iterations += 1;
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
            let mut moved = 0.0_f64;
            for k in 0..n {
                let next = self.mean()[k] + spread[k] * step;
                let sigma = self.covariance()[(k, k)].max(f64::MIN_POSITIVE).sqrt();
                moved = moved.max((next - x[k]).abs() / sigma);
                x[k] = next;
            }
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
            if innovation.iterations >= options.max_iterations || (moved > 4.0 * previous && moved > 10.0) {
                break;
            }
            previous = moved;
        }
        let mut row_bias = [0.0; MOST_STATE];
        if options.correct_bias && options.relinearization == Relinearization::StateAndNoise {
            innovation.residual -= curvature_bias(reading, branch, &x[..n], &u[..p], &at, &mut row_bias[..n]);
        }
        innovation.normalized_squared = innovation.residual * innovation.residual / innovation.variance;
        let length = innovation.normalized_squared.sqrt();
        if options.gate.is_some_and(|gate| length.is_nan() || length > gate) {
            innovation.accepted = false;
            return Ok(innovation);
        }
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
        self.absorb(&spread[..n], innovation.residual, innovation.variance - 1.0 + 1.0 / weight);
        if row_bias[..n].iter().any(|c| *c != 0.0) {
            // What the score has beyond its mean distance moves the state by the covariance after the
            // reading.
            self.shift(&row_bias[..n], -weight);
        }
        Ok(innovation)
    }

    /// Takes in a scalar reading of known `P hᵀ` and `S = h P hᵀ + R`, with `R` of one or more:
    /// `P − P hᵀ h P / S`, which then loses no digits that matter, and stays symmetric bit by bit.
    fn absorb(&mut self, spread: &[f64], residual: f64, total: f64) {
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
