//! The Kalman filter in covariance form, for linear readings and for measurement equations.
//!
//! Input: a mean, a covariance, one measurement at a time. Output: the updated mean and covariance and the
//! normalised innovation. The Joseph form keeps the covariance symmetric, and positive semidefinite up to the
//! rounding of its largest entry. Not guaranteed: that an iterated update converges (its [`Termination`]
//! reports this), nor that it finds the nearest of several optima.

use crate::dense::{ScaledCholesky, is_finite, require_covariance, require_vector, symmetric_part};
use crate::equation::linearize_into;
use crate::{Belief, Error, Linearization, MeasurementEquation, Result, Termination};
use nalgebra::{DMatrix, DVector};

/// Difference between a measurement and the prediction of the filter.
#[derive(Debug, Clone, PartialEq)]
pub struct Innovation {
    /// `e = y − H x̂⁻`, reading minus prediction. Implicit equations use the pseudo-reading of the last
    /// linearisation.
    pub residual: DVector<f64>,
    /// `S = H P Hᵀ + R`, the covariance of `e`.
    pub covariance: DMatrix<f64>,
    /// `K = P Hᵀ S⁻¹`, state × reading.
    pub gain: DMatrix<f64>,
    /// `eᵀ S⁻¹ e`, distributed as χ² if the filter is consistent, with as many degrees of freedom as `e` has
    /// components.
    pub normalized_squared: f64,
    /// Number of linearisations; 1 for linear readings.
    pub iterations: usize,
    /// How an iterated update ended.
    pub termination: Termination,
}

/// [`Innovation`] of a scalar reading, without allocation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScalarInnovation {
    /// `e = z − hᵀ x̂⁻`.
    pub residual: f64,
    /// `S = hᵀ P h + R`.
    pub variance: f64,
    /// `e² / S`, distributed as χ² with one degree of freedom when the filter is consistent.
    pub normalized_squared: f64,
}

/// Where a nonlinear update linearises the equation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Relinearization {
    /// Once, at the predicted state and zero noise: the extended Kalman filter.
    Never,
    /// Repeatedly at the updated state, with zero noise: the iterated extended Kalman filter. Correct only if
    /// `g` is linear in the reading.
    State,
    /// Repeatedly at the updated state and the updated noise: the noise-updated iterated filter, whose fixed
    /// point is the most likely `(x, v)` that satisfies the equation (Gauss–Helmert).
    StateAndNoise,
}

/// Options of a nonlinear update.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EquationUpdate {
    /// Where to linearise.
    pub relinearization: Relinearization,
    /// Maximum number of linearisations.
    pub max_iterations: usize,
    /// Stop when no component of `x` and `v` moves by more than this many of its prior standard deviations.
    pub tolerance: f64,
}

impl EquationUpdate {
    /// One linearisation at the predicted state (EKF).
    #[must_use]
    pub fn extended() -> Self {
        Self { relinearization: Relinearization::Never, max_iterations: 1, tolerance: 1e-10 }
    }

    /// Relinearised in the state, up to 50 times (IEKF).
    #[must_use]
    pub fn iterated() -> Self {
        Self { relinearization: Relinearization::State, max_iterations: 50, ..Self::extended() }
    }

    /// Relinearised in state and noise, up to 50 times (NUIEKF).
    #[must_use]
    pub fn noise_updated() -> Self {
        Self { relinearization: Relinearization::StateAndNoise, ..Self::iterated() }
    }
}

impl Default for EquationUpdate {
    fn default() -> Self {
        Self::noise_updated()
    }
}

/// A Kalman filter in covariance form: mean `x̂` and covariance `P`.
///
/// Updates: `K = P Hᵀ (H P Hᵀ + R)⁻¹`, `x̂ ← x̂ + K (z − H x̂)`, `P ← (I − K H) P (I − K H)ᵀ + K R Kᵀ`. Cost:
/// `n² m` per update of `m` readings. An update that fails leaves the filter unchanged.
///
/// # Examples
/// ```
/// use nalgebra::{DMatrix, DVector};
/// use planish_estimate::KalmanFilter;
///
/// let mut filter = KalmanFilter::new(DVector::from_vec(vec![0.0, 1.0]), DMatrix::identity(2, 2))?;
/// let one_second_later = DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 0.0, 1.0]);
/// filter.predict(&one_second_later, &DMatrix::from_row_slice(2, 2, &[0.0, 0.0, 0.0, 0.01]))?;
/// let innovation = filter.update_scalar(&DVector::from_vec(vec![1.0, 0.0]), 2.0, 0.5)?;
/// assert_eq!(innovation.residual, 1.0);
/// assert!((innovation.normalized_squared - 1.0 / 2.5).abs() < 1e-12);
/// assert!((filter.mean()[0] - 1.8).abs() < 1e-12);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Bucy, Joseph, *Filtering for stochastic processes with applications to guidance*, 1968.
#[derive(Debug, Clone, PartialEq)]
pub struct KalmanFilter {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl KalmanFilter {
    /// A filter with the given mean and covariance, which may be singular.
    ///
    /// # Errors
    /// `Input` when shapes differ, a value is not finite, or the covariance is not symmetric positive
    /// semidefinite.
    pub fn new(mean: DVector<f64>, covariance: DMatrix<f64>) -> Result<Self> {
        require_vector("the mean", &mean, mean.len())?;
        require_covariance("the covariance", &covariance, mean.len())?;
        Ok(Self { mean, covariance: symmetric_part(&covariance) })
    }

    /// A filter that starts from a belief.
    ///
    /// # Errors
    /// `Undetermined` when the belief's information is singular.
    pub fn from_belief(belief: &Belief) -> Result<Self> {
        let information = belief.information();
        Ok(Self { mean: information.mean()?, covariance: information.covariance()? })
    }

    /// The mean `x̂`.
    #[must_use]
    pub fn mean(&self) -> &DVector<f64> {
        &self.mean
    }

    /// The covariance `P`.
    #[must_use]
    pub fn covariance(&self) -> &DMatrix<f64> {
        &self.covariance
    }

    /// Mean and covariance, for updates that themselves keep the covariance symmetric and positive
    /// semidefinite.
    pub(crate) fn parts_mut(&mut self) -> (&mut DVector<f64>, &mut DMatrix<f64>) {
        (&mut self.mean, &mut self.covariance)
    }

    /// Predicts the state by `x ← F x + w`, `w ~ N(0, Q)`: `P ← F P Fᵀ + Q`.
    ///
    /// `F` may have more or fewer rows than the state has components.
    ///
    /// # Errors
    /// `Input` when shapes differ, a value is not finite, or `Q` is not symmetric positive semidefinite.
    pub fn predict(&mut self, transition: &DMatrix<f64>, process_covariance: &DMatrix<f64>) -> Result<()> {
        self.require_columns("the transition", transition)?;
        self.predict_to(transition * &self.mean, transition, process_covariance)
    }

    /// Predicts the state by a nonlinear `x ← f(x) + w`: `predicted` is `f(x̂)`, `transition` is `∂f/∂x`
    /// there.
    ///
    /// # Errors
    /// As [`Self::predict`].
    pub fn predict_to(
        &mut self,
        predicted: DVector<f64>,
        transition: &DMatrix<f64>,
        process_covariance: &DMatrix<f64>,
    ) -> Result<()> {
        self.require_columns("the transition", transition)?;
        require_vector("the predicted mean", &predicted, transition.nrows())?;
        require_covariance("the process covariance", process_covariance, transition.nrows())?;
        let carried = transition * &self.covariance * transition.transpose() + process_covariance;
        self.covariance = symmetric_part(&carried);
        self.mean = predicted;
        Ok(())
    }

    /// Innovation of readings `z = H x + v`, without an update. Use it for gates.
    ///
    /// # Errors
    /// `Input` when shapes differ or a value is not finite; `Undetermined` when `H P Hᵀ + R` is singular.
    pub fn innovation(
        &self,
        design: &DMatrix<f64>,
        reading: &DVector<f64>,
        noise_covariance: &DMatrix<f64>,
    ) -> Result<Innovation> {
        self.require_columns("the design matrix", design)?;
        require_vector("the reading", reading, design.nrows())?;
        require_covariance("the noise covariance", noise_covariance, design.nrows())?;
        self.innovation_of(design, reading, noise_covariance)
    }

    /// Updates with readings `z = H x + v`, `v ~ N(0, R)`.
    ///
    /// # Errors
    /// As [`Self::innovation`].
    pub fn update(
        &mut self,
        design: &DMatrix<f64>,
        reading: &DVector<f64>,
        noise_covariance: &DMatrix<f64>,
    ) -> Result<Innovation> {
        let innovation = self.innovation(design, reading, noise_covariance)?;
        self.mean += &innovation.gain * &innovation.residual;
        self.covariance = joseph_covariance(&self.covariance, design, noise_covariance, &innovation.gain);
        Ok(innovation)
    }

    /// Updates with one reading `z = hᵀ x + v`, `v ~ N(0, variance)`. Cost: `4 n²`.
    ///
    /// # Errors
    /// `Input` when shapes differ or a value is not finite or the variance negative; `Undetermined` when
    /// `hᵀ P h + R` is zero.
    pub fn update_scalar(
        &mut self,
        row: &DVector<f64>,
        reading: f64,
        variance: f64,
    ) -> Result<ScalarInnovation> {
        require_vector("the row", row, self.mean.len())?;
        if !(reading.is_finite() && variance >= 0.0 && variance.is_finite()) {
            return Err(Error::input(format!(
                "expected a finite reading and a variance of at least 0, found {reading} and {variance}"
            )));
        }
        let spread = &self.covariance * row;
        let total = row.dot(&spread) + variance;
        if total.is_nan() || total <= 0.0 {
            return Err(Error::undetermined(
                "a noise-free reading measures a direction that is already known exactly",
            ));
        }
        // Joseph's form in rank-one updates. `(I − k hᵀ) P` alone costs half, but cancellation can make
        // variances negative after precise readings.
        let residual = reading - row.dot(&self.mean);
        let gain = spread / total;
        self.mean.axpy(residual, &gain, 1.0);
        let row_spread = self.covariance.tr_mul(row);
        self.covariance.ger(-1.0, &gain, &row_spread, 1.0); // (I − k hᵀ) P
        // This product uses the covariance that the previous line changed.
        let left_spread = &self.covariance * row;
        self.covariance.ger(-1.0, &left_spread, &gain, 1.0); // … (I − k hᵀ)ᵀ
        self.covariance.ger(variance, &gain, &gain, 1.0);
        self.covariance = symmetric_part(&self.covariance);
        Ok(ScalarInnovation { residual, variance: total, normalized_squared: residual * residual / total })
    }

    /// Updates with a measurement `g(z − v, x) = 0`, `v ~ N(0, R)`.
    ///
    /// At each linearisation: `y = H x0 + D v0 − g0`, `x ← x̂ + P Hᵀ S⁻¹ (y − H x̂)`,
    /// `v ← R Dᵀ S⁻¹ (y − H x̂)` with `S = H P Hᵀ + D R Dᵀ`, where `x̂` and `P` stay those before the update.
    /// The innovation reports whether the iteration converged.
    ///
    /// # Errors
    /// `Input` when shapes differ or the equation is not defined at a state; `Undetermined` when `S` is
    /// singular.
    ///
    /// # Examples
    /// A reading of x² = 9 with a small variance, starting near 2.5:
    /// ```
    /// use nalgebra::{DMatrix, DVector};
    /// use planish_estimate::{EquationUpdate, Explicit, KalmanFilter, Termination};
    ///
    /// let square = Explicit::new(DVector::from_element(1, 9.0), 1, |x, prediction, jacobian| {
    ///     prediction[0] = x[0] * x[0];
    ///     jacobian[(0, 0)] = 2.0 * x[0];
    /// });
    /// let mut filter = KalmanFilter::new(DVector::from_element(1, 2.5), DMatrix::identity(1, 1))?;
    /// let noise = DMatrix::from_element(1, 1, 1e-6);
    /// let innovation = filter.update_equation(&square, &noise, &EquationUpdate::iterated())?;
    /// assert_eq!(innovation.termination, Termination::Converged);
    /// assert!((filter.mean()[0] - 3.0).abs() < 1e-5); // one linearisation alone gives 3.05
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    ///
    /// # References
    /// Jazwinski, *Stochastic processes and filtering theory*, 1970, section 8.3 (iterated in the state);
    /// Bondarenko, Halevi, Shpitalni, *Object identification and tracking via noise updated iterative
    /// extended Kalman filter*, 2004 (in state and noise).
    pub fn update_equation<E: MeasurementEquation + ?Sized>(
        &mut self,
        equation: &E,
        noise_covariance: &DMatrix<f64>,
        options: &EquationUpdate,
    ) -> Result<Innovation> {
        let dimensions = equation.dimensions();
        require_covariance("the noise covariance", noise_covariance, dimensions.noise)?;
        let mut at = Linearization::zero(dimensions);
        let mut x = self.mean.clone();
        let mut v = DVector::zeros(dimensions.noise);
        let mut iterations = 0;
        let mut previous = f64::INFINITY;
        // `self` changes only after the last iteration: every step starts from the same prediction, and an
        // error leaves the filter as it was.
        loop {
            linearize_into(equation, &x, &v, &mut at)?;
            iterations += 1;
            let reading_covariance = at.reading_covariance(noise_covariance)?;
            let mut innovation =
                self.innovation_of(&at.state_jacobian, &at.pseudo_reading(), &reading_covariance)?;
            let next = &self.mean + &innovation.gain * &innovation.residual;
            let next_noise = match options.relinearization {
                Relinearization::StateAndNoise => {
                    let factor = factor_of_innovation(&innovation.covariance)?;
                    noise_covariance * (at.noise_jacobian.transpose() * factor.solve(&innovation.residual))
                }
                _ => v.clone(),
            };
            let moved = largest_move(&next, &x, &self.covariance).max(largest_move(
                &next_noise,
                &v,
                noise_covariance,
            ));
            (x, v) = (next, next_noise);
            let converged = options.relinearization == Relinearization::Never || moved <= options.tolerance;
            // Far from the origin, rounding of the reading limits how small a step can get.
            let stalled = moved >= previous && moved <= 1e-4;
            previous = moved;
            // The update is applied even without convergence. The caller decides by `termination` whether to
            // use it.
            if converged || stalled || iterations >= options.max_iterations {
                self.covariance = joseph_covariance(
                    &self.covariance,
                    &at.state_jacobian,
                    &reading_covariance,
                    &innovation.gain,
                );
                self.mean = x;
                innovation.iterations = iterations;
                innovation.termination = match (converged, stalled) {
                    (true, _) => Termination::Converged,
                    (_, true) => Termination::ReachedTolerance,
                    _ => Termination::Limit,
                };
                return Ok(innovation);
            }
        }
    }

    fn innovation_of(
        &self,
        design: &DMatrix<f64>,
        reading: &DVector<f64>,
        noise_covariance: &DMatrix<f64>,
    ) -> Result<Innovation> {
        // Solutions with the factor of S instead of its inverse: fewer operations and no loss of digits.
        let cross = &self.covariance * design.transpose();
        let covariance = symmetric_part(&(design * &cross + noise_covariance));
        let factor = factor_of_innovation(&covariance)?;
        let residual = reading - design * &self.mean;
        Ok(Innovation {
            normalized_squared: factor.inverse_form(&residual),
            gain: factor.solve_matrix(&cross.transpose()).transpose(),
            residual,
            covariance,
            iterations: 1,
            termination: Termination::Converged,
        })
    }

    fn require_columns(&self, what: &str, matrix: &DMatrix<f64>) -> Result<()> {
        if matrix.ncols() != self.mean.len() {
            return Err(Error::input(format!(
                "{what}: found {} columns, expected {}, the size of the state",
                matrix.ncols(),
                self.mean.len()
            )));
        }
        if !is_finite(matrix) {
            return Err(Error::input(format!("expected finite values in {what}, found another")));
        }
        Ok(())
    }
}

/// The covariance after an update with *any* gain: `(I − K H) P (I − K H)ᵀ + K R Kᵀ`.
///
/// `P` is state × state, `H` reading × state, `R` reading × reading, `K` state × reading. The short form
/// `(I − K H) P` holds only for the optimal gain and loses symmetry to rounding. Cost: `2 n³`, or `n² m`
/// products where `m < n`.
///
/// # Panics
/// When the shapes do not match.
///
/// # References
/// Bucy, Joseph, *Filtering for stochastic processes with applications to guidance*, 1968.
#[must_use]
pub fn joseph_covariance(
    covariance: &DMatrix<f64>,
    design: &DMatrix<f64>,
    noise_covariance: &DMatrix<f64>,
    gain: &DMatrix<f64>,
) -> DMatrix<f64> {
    // The brackets matter: products with the few rows of H cost n² m, while I − K H would be a full n × n
    // matrix.
    let left = covariance - gain * (design * covariance);
    let both = &left - (&left * design.transpose()) * gain.transpose();
    symmetric_part(&(both + gain * noise_covariance * gain.transpose()))
}

fn factor_of_innovation(covariance: &DMatrix<f64>) -> Result<ScaledCholesky> {
    ScaledCholesky::new(covariance).map_err(|null| null.into_error("the innovation covariance"))
}

/// The largest change of a component in units of its standard deviation.
fn largest_move(to: &DVector<f64>, from: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
    let mut largest = 0.0_f64;
    for i in 0..to.len() {
        let change = (to[i] - from[i]).abs();
        if change > 0.0 {
            largest = largest.max(change / covariance[(i, i)].max(f64::MIN_POSITIVE).sqrt());
        }
    }
    largest
}

#[cfg(test)]
mod tests;
