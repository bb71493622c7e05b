//! Batch least squares on measurement equations: Gauss–Newton and Levenberg–Marquardt on the Gauss–Helmert
//! model.
//!
//! Input: equations `g(z − v, x) = 0` with noise covariances and losses, a prior, an initial state. Output:
//! the most likely state, its covariance, the residuals, and the reason for stopping. Not guaranteed: the
//! global optimum.

use crate::dense::{ScaledCholesky, require_covariance, require_vector, symmetric_part};
use crate::equation::linearize_into;
use crate::{Error, Information, Linearization, Loss, LossMoments, MeasurementEquation, Result};
use nalgebra::{DMatrix, DVector};

/// Why an iteration stopped. A failure to converge is a result, not an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Termination {
    /// The last step was negligible.
    Converged,
    /// The objective decreased by less than its tolerance, but the step was not negligible.
    ReachedTolerance,
    /// The maximum number of iterations was reached.
    Limit,
    /// There is no information along some direction of the state.
    Undetermined,
}

/// A measurement: an equation, the covariance `R` of its noise, and its loss.
#[derive(Clone)]
pub struct Measurement<'a> {
    equation: &'a dyn MeasurementEquation,
    noise_covariance: DMatrix<f64>,
    loss: Loss,
}

impl<'a> Measurement<'a> {
    /// A measurement with Gaussian loss; `R` is noise × noise and must be positive definite.
    #[must_use]
    pub fn new(equation: &'a dyn MeasurementEquation, noise_covariance: DMatrix<f64>) -> Self {
        Self { equation, noise_covariance, loss: Loss::Gaussian }
    }

    /// The same measurement with another loss, of the normalised residual `√(vᵀR⁻¹v)`.
    #[must_use]
    pub fn with_loss(mut self, loss: Loss) -> Self {
        self.loss = loss;
        self
    }
}

/// Options of [`least_squares`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeastSquaresOptions {
    /// Initial damping, relative to the diagonal of the information. Zero means Gauss–Newton until a step
    /// fails.
    pub initial_damping: f64,
    /// Maximum number of steps.
    pub max_iterations: usize,
    /// Converged when the Gauss–Newton step is shorter than this many posterior standard deviations.
    pub step_tolerance: f64,
    /// Stop when a step reduces the objective by less than this fraction.
    pub objective_tolerance: f64,
}

impl Default for LeastSquaresOptions {
    fn default() -> Self {
        Self { initial_damping: 0.0, max_iterations: 100, step_tolerance: 1e-8, objective_tolerance: 1e-15 }
    }
}

/// Result of [`least_squares`].
#[derive(Debug, Clone, PartialEq)]
pub struct LeastSquaresFit {
    /// The state `x̂`.
    pub state: DVector<f64>,
    /// Its covariance, corrected for the losses; `None` where the state is undetermined.
    pub covariance: Option<DMatrix<f64>>,
    /// Information of the measurements without the prior, linearised at `x̂`, with the weights of the losses.
    pub information: Information,
    /// The residuals `v̂` of each measurement, measured minus corrected.
    pub residuals: Vec<DVector<f64>>,
    /// `√(v̂ᵀ R⁻¹ v̂)` of each measurement.
    pub normalized_residuals: Vec<f64>,
    /// Weight of each measurement, from its loss.
    pub weights: Vec<f64>,
    /// Contribution of each measurement to the effective number of unknowns, `w tr(W H Λ⁻¹ Hᵀ)`; `NaN` where
    /// the state is undetermined.
    pub leverages: Vec<f64>,
    /// `Σ ρ(r)` over the measurements, prior excluded.
    pub loss: f64,
    /// Number of steps.
    pub iterations: usize,
    /// Why the iteration stopped.
    pub termination: Termination,
    /// A direction of the state without information, if there is one.
    pub undetermined_direction: Option<DVector<f64>>,
}

/// The state that minimises `½ xᵀΛx − ηᵀx + Σ ρ(√(vᵀR⁻¹v))` subject to `g(z − v, x) = 0` for every
/// measurement.
///
/// The noise is relinearised at every state, and misclosures are evaluated at the corrected readings `z − v`.
/// Therefore the result is the optimum of the constrained problem (Gauss–Helmert), not of its first
/// linearisation. Steps are damped solutions of the reweighted normal equations; a step is accepted only if
/// the objective decreases. The covariance is `A⁻¹ B A⁻¹`, with the prior and each measurement's weighted
/// information scaled by the loss's [moments](Loss::moments) for Gaussian data; with Gaussian losses it is
/// the inverse information. Cost: `N (m³ + m n²) + n³` per step for `N` measurements of `m` equations.
///
/// # Errors
/// `Input` when shapes differ, a covariance or loss is not valid, or an equation is not defined at the start;
/// `Undetermined` when an equation has no noise there. The fit reports an undetermined state.
///
/// # Examples
/// Radius of a circle about the origin. Both coordinates of a point are noisy, so the equation is implicit.
/// ```
/// use nalgebra::{DMatrix, DVector};
/// use planish_estimate::{
///     Dimensions, Implicit, Information, LeastSquaresOptions, Measurement, least_squares,
/// };
///
/// let dimensions = Dimensions { state: 1, noise: 2, equations: 1 };
/// let points = [[1.1, 0.0], [0.0, 0.9], [-1.0, 0.0]].map(|z: [f64; 2]| {
///     Implicit::new(dimensions, move |x, v, out| {
///         let p = [z[0] - v[0], z[1] - v[1]];
///         out.misclosure[0] = p[0].hypot(p[1]) - x[0];
///         out.state_jacobian[0] = -1.0;
///         out.noise_jacobian[(0, 0)] = -p[0] / p[0].hypot(p[1]);
///         out.noise_jacobian[(0, 1)] = -p[1] / p[0].hypot(p[1]);
///     })
/// });
/// let noise = DMatrix::identity(2, 2) * 0.01;
/// let readings: Vec<_> = points.iter().map(|z| Measurement::new(z, noise.clone())).collect();
/// let (prior, start) = (Information::zero(1), DVector::from_element(1, 0.5));
/// let fit = least_squares(&readings, &prior, &start, &LeastSquaresOptions::default())?;
/// assert!((fit.state[0] - 1.0).abs() < 1e-9);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Helmert, *Die Ausgleichungsrechnung nach der Methode der kleinsten Quadrate*, 1907; Pope, *Some pitfalls
/// to be avoided in the iterative adjustment of nonlinear problems*, 1972; Marquardt, *An algorithm for
/// least-squares estimation of nonlinear parameters*, 1963.
pub fn least_squares(
    measurements: &[Measurement<'_>],
    prior: &Information,
    start: &DVector<f64>,
    options: &LeastSquaresOptions,
) -> Result<LeastSquaresFit> {
    let batch = Batch::new(measurements, prior, start)?;
    let mut point = batch.evaluate(start, &batch.no_noise(), options)?;
    let mut damping = options.initial_damping.max(0.0);
    let mut iterations = 0;
    let mut termination = Termination::Limit;
    while iterations < options.max_iterations {
        iterations += 1;
        // Solve the damped normal equations. Convergence uses the undamped step, because damping shortens
        // steps far from the optimum as well.
        let normal = &prior.matrix + &point.information;
        let step = match damped_factor(&normal, damping) {
            Some(factor) => {
                let step = factor.solve(&point.descent);
                let undamped = if damping > 0.0 { damped_factor(&normal, 0.0) } else { None };
                let decrement = undamped.as_ref().unwrap_or(&factor).inverse_form(&point.descent).sqrt();
                if decrement <= options.step_tolerance {
                    termination = Termination::Converged;
                    break;
                }
                step
            }
            None => {
                damping = (10.0 * damping).max(1e-8);
                continue;
            }
        };
        // An equation that is not defined at the trial state rejects the step.
        let trial = batch.evaluate(&(&point.state + &step), &point.noises, options).ok();
        match trial.filter(|trial| trial.objective < point.objective) {
            Some(trial) => {
                let decrease = point.objective - trial.objective;
                let small = decrease <= options.objective_tolerance * trial.loss.abs();
                point = trial;
                damping = if damping > 1e-9 { 0.2 * damping } else { 0.0 };
                if small {
                    termination = Termination::ReachedTolerance;
                    break;
                }
            }
            None if damping > 1e8 || step.norm() <= f64::EPSILON * point.state.norm() => {
                termination = Termination::ReachedTolerance;
                break;
            }
            None => damping = (10.0 * damping).max(1e-4),
        }
    }
    batch.finish(point, iterations, termination)
}

/// The problem: everything that does not change between steps.
struct Batch<'a, 'b> {
    measurements: &'b [Measurement<'a>],
    prior: &'b Information,
    start: &'b DVector<f64>,
    /// Gradient of the prior term at the start.
    prior_gradient: DVector<f64>,
    moments: Vec<LossMoments>,
}

/// The objective and its normal equations at a state.
struct Point {
    state: DVector<f64>,
    noises: Vec<DVector<f64>>,
    linearizations: Vec<Linearization>,
    /// Prior term plus loss; the prior term is zero at the start.
    objective: f64,
    loss: f64,
    normalized_residuals: Vec<f64>,
    weights: Vec<f64>,
    /// `Σ w HᵀWH`.
    information: DMatrix<f64>,
    /// The negative gradient of the objective.
    descent: DVector<f64>,
}

impl<'a, 'b> Batch<'a, 'b> {
    fn new(
        measurements: &'b [Measurement<'a>],
        prior: &'b Information,
        start: &'b DVector<f64>,
    ) -> Result<Self> {
        let n = start.len();
        require_vector("the start", start, n)?;
        require_vector("the prior's vector", &prior.vector, n)?;
        require_covariance("the prior's information", &prior.matrix, n)?;
        let mut known: Vec<(Loss, usize, LossMoments)> = Vec::new();
        let mut moments = Vec::with_capacity(measurements.len());
        for (i, measurement) in measurements.iter().enumerate() {
            let dimensions = measurement.equation.dimensions();
            if dimensions.state != n {
                return Err(Error::input(format!(
                    "measurement {i}: expected {n} unknowns as in the start, found {}",
                    dimensions.state
                )));
            }
            let covariance = &measurement.noise_covariance;
            require_covariance("the noise covariance", covariance, dimensions.noise)
                .map_err(|error| error.in_context(format!("measurement {i}")))?;
            // Moments need thousands of evaluations, and most measurements share their loss and dimension.
            let found =
                known.iter().find(|(loss, d, _)| (*loss, *d) == (measurement.loss, dimensions.equations));
            moments.push(match found {
                Some((_, _, moments)) => *moments,
                None => {
                    let computed = measurement.loss.moments(dimensions.equations)?;
                    known.push((measurement.loss, dimensions.equations, computed));
                    computed
                }
            });
        }
        let prior_gradient = &prior.matrix * start - &prior.vector;
        Ok(Self { measurements, prior, start, prior_gradient, moments })
    }

    fn no_noise(&self) -> Vec<DVector<f64>> {
        self.measurements.iter().map(|m| DVector::zeros(m.equation.dimensions().noise)).collect()
    }

    fn evaluate(
        &self,
        x: &DVector<f64>,
        noises: &[DVector<f64>],
        options: &LeastSquaresOptions,
    ) -> Result<Point> {
        let n = x.len();
        // Relative to the start. The absolute prior term can be huge, and its small changes would drown in
        // rounding.
        let moved = x - self.start;
        let bent = &self.prior.matrix * &moved;
        let count = self.measurements.len();
        let mut point = Point {
            state: x.clone(),
            noises: Vec::with_capacity(count),
            linearizations: Vec::with_capacity(count),
            objective: 0.5 * moved.dot(&bent) + self.prior_gradient.dot(&moved),
            loss: 0.0,
            normalized_residuals: Vec::with_capacity(count),
            weights: Vec::with_capacity(count),
            information: DMatrix::zeros(n, n),
            descent: -(&self.prior_gradient + bent),
        };
        for (i, (measurement, noise)) in self.measurements.iter().zip(noises).enumerate() {
            let corrected = correct(measurement, x, noise, options.step_tolerance)
                .map_err(|error| error.in_context(format!("measurement {i}")))?;
            let loss = &measurement.loss;
            let weight = loss.weight(corrected.normalized_residual);
            point.loss += loss.rho(corrected.normalized_residual);
            let jacobian = &corrected.at.state_jacobian;
            // The loss scales the information of a reading. The unweighted solution would follow outliers.
            let weighted = corrected.weight.solve_matrix(jacobian) * weight;
            point.information.gemm_tr(1.0, jacobian, &weighted, 1.0);
            point.descent.gemv_tr(1.0, &weighted, &corrected.at.unexplained(), 1.0);
            point.normalized_residuals.push(corrected.normalized_residual);
            point.weights.push(weight);
            point.noises.push(corrected.noise);
            point.linearizations.push(corrected.at);
        }
        point.objective += point.loss;
        // Symmetrise the sum once; a product of matrices is symmetric only up to rounding.
        point.information = symmetric_part(&point.information);
        if point.objective.is_finite() {
            Ok(point)
        } else {
            Err(Error::input("the objective is not finite: choose a start closer to the solution"))
        }
    }

    fn finish(&self, point: Point, iterations: usize, termination: Termination) -> Result<LeastSquaresFit> {
        let normal = &self.prior.matrix + &point.information;
        // `descent` includes the prior. Its gradient is added again, because the result contains the data
        // alone.
        let vector = &point.information * &point.state
            + &point.descent
            + (&self.prior.matrix * &point.state - &self.prior.vector);
        let mut fit = LeastSquaresFit {
            covariance: None,
            information: Information { matrix: point.information, vector },
            residuals: point.noises,
            leverages: vec![f64::NAN; point.weights.len()],
            normalized_residuals: point.normalized_residuals,
            weights: point.weights,
            loss: point.loss,
            state: point.state,
            iterations,
            termination,
            undetermined_direction: None,
        };
        let inverse = match ScaledCholesky::new(&normal) {
            Ok(factor) => factor.inverse(),
            Err(null) => {
                fit.termination = Termination::Undetermined;
                fit.undetermined_direction = Some(null.direction);
                return Ok(fit);
            }
        };
        // Sandwich covariance from the expected slope and variance of the scores.
        let (mut slope, mut score) = (self.prior.matrix.clone(), self.prior.matrix.clone());
        for (i, at) in point.linearizations.iter().enumerate() {
            let weight = at.weight(&self.measurements[i].noise_covariance)?;
            let information = at.state_jacobian.transpose() * weight.solve_matrix(&at.state_jacobian);
            fit.leverages[i] = fit.weights[i] * inverse.dot(&information);
            let moments = &self.moments[i];
            // The weights suppress outliers. Division by their expectation for Gaussian data restores the
            // full information of inliers.
            let share = fit.weights[i] / moments.weight;
            slope += &information * (share * moments.slope);
            score += &information * (share * moments.influence_squared);
        }
        fit.covariance = ScaledCholesky::new(&slope).ok().map(|factor| {
            let bread = factor.inverse();
            symmetric_part(&(&bread * score * &bread))
        });
        Ok(fit)
    }
}

/// A measurement linearised at a state and at the most likely noise.
struct Corrected {
    noise: DVector<f64>,
    at: Linearization,
    weight: ScaledCholesky,
    normalized_residual: f64,
}

/// The most likely noise that makes the equation hold at `x`: `v ← R Dᵀ W (D v − g(z − v, x))` until it
/// converges.
fn correct(
    measurement: &Measurement<'_>,
    x: &DVector<f64>,
    noise: &DVector<f64>,
    tolerance: f64,
) -> Result<Corrected> {
    let covariance = &measurement.noise_covariance;
    let mut at = Linearization::zero(measurement.equation.dimensions());
    let mut v = noise.clone();
    let mut previous = f64::INFINITY;
    let mut relaxation = 1.0_f64;
    // The fixed point converges fast for small noise. If the noise exceeds the radius of curvature, full
    // steps diverge and shorter ones converge.
    for _ in 0..200 {
        linearize_into(measurement.equation, x, &v, &mut at)?;
        let weight = at.weight(covariance)?;
        let unexplained = at.unexplained();
        // The full solution is computed, not an increment of `v`, so errors of earlier steps do not
        // accumulate.
        let step = covariance * (at.noise_jacobian.transpose() * weight.solve(&unexplained)) - &v;
        let largest = (0..v.len())
            .map(|i| step[i].abs() / covariance[(i, i)].sqrt().max(f64::MIN_POSITIVE))
            .fold(0.0, f64::max);
        let normalized_residual = weight.inverse_form(&unexplained).sqrt();
        // Far from the origin, rounding of the reading limits how small a step can get.
        let stalled = largest >= previous && largest <= 1e-4;
        if largest <= 0.01 * tolerance * (1.0 + normalized_residual) || stalled {
            v += step;
            return Ok(Corrected { noise: v, at, weight, normalized_residual });
        }
        if largest > 0.9 * previous {
            relaxation = (0.5 * relaxation).max(0.02);
        }
        v.axpy(relaxation, &step, 1.0);
        previous = largest;
    }
    Err(Error::undetermined(
        "the noise of a reading does not converge: the state is too far from the reading",
    ))
}

fn damped_factor(normal: &DMatrix<f64>, damping: f64) -> Option<ScaledCholesky> {
    let mut damped = normal.clone();
    for i in 0..damped.nrows() {
        let d = damped[(i, i)];
        // An unknown without any information has no scale to damp. A unit diagonal keeps it where it is,
        // since its gradient is zero, and lets the others move.
        damped[(i, i)] = if damping > 0.0 && d <= 0.0 { 1.0 } else { d * (1.0 + damping) };
    }
    ScaledCholesky::new(&damped).ok()
}

#[cfg(test)]
mod tests;
