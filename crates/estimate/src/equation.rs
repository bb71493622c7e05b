//! The measurement equation `g(z − v, x) = 0`: the interface between models and estimation.
//!
//! Input: misclosure and Jacobians of a model at a state `x` and noise `v`. Output: the information that a
//! reading adds, and the most likely noise. Not guaranteed: that the Jacobians are correct; test them with
//! [`check_jacobians`].
//!
//! Sign convention: the true value of a reading `z` is `z − v`. So `v` is measured minus true, and
//! `D = ∂g/∂v = −∂g/∂z`. For an explicit reading `z = h(x) + v` this gives `g = z − v − h(x)`, `H = −∂h/∂x`,
//! `D = −I`.

use crate::dense::{ScaledCholesky, require_vector, symmetric_part};
use crate::{Error, Information, Result};
use nalgebra::{DMatrix, DVector};

/// Numbers of unknowns, noise components and equations of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dimensions {
    /// Components of the state `x`.
    pub state: usize,
    /// Components of the noise `v`, as many as of the reading `z`.
    pub noise: usize,
    /// Components of `g`; at most `noise`, or the equations could not all hold.
    pub equations: usize,
}

/// A measurement: `g(z − v, x) = 0` with noise `v ~ N(0, R)`.
///
/// The implementation holds the reading `z`, the caller holds `R`. Laws, checked by [`check_jacobians`]:
/// `state_jacobian` is `∂g/∂x` and `noise_jacobian` is `∂g/∂v` at the arguments. Results do not depend on
/// earlier calls.
pub trait MeasurementEquation {
    /// The dimensions, the same at every call.
    fn dimensions(&self) -> Dimensions;

    /// Fills misclosure `g(z − v, x)`, state Jacobian `∂g/∂x` and noise Jacobian `∂g/∂v` of `out`.
    ///
    /// `out` arrives with the right shapes and *unspecified* contents. Set NaN where `g` is not defined.
    fn linearize(&self, x: &DVector<f64>, v: &DVector<f64>, out: &mut Linearization);

    /// The linearisation at `(x, v)`, newly allocated.
    ///
    /// # Errors
    /// `Input` when a dimension is wrong, or when the equation is not defined there.
    fn linearized(&self, x: &DVector<f64>, v: &DVector<f64>) -> Result<Linearization> {
        let mut out = Linearization::zero(self.dimensions());
        linearize_into(self, x, v, &mut out)?;
        Ok(out)
    }
}

/// Sets the point of `out`, linearises there and checks that the result is finite.
pub(crate) fn linearize_into<E: MeasurementEquation + ?Sized>(
    equation: &E,
    x: &DVector<f64>,
    v: &DVector<f64>,
    out: &mut Linearization,
) -> Result<()> {
    let dimensions = equation.dimensions();
    require_vector("the state", x, dimensions.state)?;
    require_vector("the noise", v, dimensions.noise)?;
    if out.dimensions() != dimensions {
        *out = Linearization::zero(dimensions);
    }
    // The buffer is reused between readings. Storing the point here spares each implementation from doing so.
    out.state.copy_from(x);
    out.noise.copy_from(v);
    equation.linearize(x, v, out);
    // Checked here for every equation: a NaN in one reading would make the whole information NaN, far from
    // its cause.
    let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
    if out.dimensions() != dimensions {
        return Err(Error::input("a measurement equation changed the shape of its linearisation"));
    }
    if !finite(out.misclosure.as_slice())
        || !finite(out.state_jacobian.as_slice())
        || !finite(out.noise_jacobian.as_slice())
    {
        return Err(Error::input(
            "a measurement equation is not defined at the state where it was linearised",
        ));
    }
    Ok(())
}

/// A linearised measurement equation: `g ≈ g0 + H (x − x0) + D (v − v0)`.
#[derive(Debug, Clone, PartialEq)]
pub struct Linearization {
    /// `x0`, the state of the linearisation.
    pub state: DVector<f64>,
    /// `v0`, the noise of the linearisation.
    pub noise: DVector<f64>,
    /// `g0 = g(z − v0, x0)`.
    pub misclosure: DVector<f64>,
    /// `H = ∂g/∂x`, equations × state.
    pub state_jacobian: DMatrix<f64>,
    /// `D = ∂g/∂v = −∂g/∂z`, equations × noise.
    pub noise_jacobian: DMatrix<f64>,
}

impl Linearization {
    /// A linearisation of the given shapes, filled with zeros.
    #[must_use]
    pub fn zero(dimensions: Dimensions) -> Self {
        Self {
            state: DVector::zeros(dimensions.state),
            noise: DVector::zeros(dimensions.noise),
            misclosure: DVector::zeros(dimensions.equations),
            state_jacobian: DMatrix::zeros(dimensions.equations, dimensions.state),
            noise_jacobian: DMatrix::zeros(dimensions.equations, dimensions.noise),
        }
    }

    /// The dimensions of the equation.
    #[must_use]
    pub fn dimensions(&self) -> Dimensions {
        Dimensions { state: self.state.len(), noise: self.noise.len(), equations: self.misclosure.len() }
    }

    /// The pseudo-reading `y = H x0 + D v0 − g0`, for which the linear equation `y = H x + D v` holds.
    #[must_use]
    pub fn pseudo_reading(&self) -> DVector<f64> {
        &self.state_jacobian * &self.state + self.unexplained()
    }

    /// `D v0 − g0`: the residual of the pseudo-reading at `x = x0`. It is the negative linearised misclosure
    /// at `v = 0`.
    #[must_use]
    pub fn unexplained(&self) -> DVector<f64> {
        &self.noise_jacobian * &self.noise - &self.misclosure
    }

    /// `D R Dᵀ`: the covariance of the pseudo-reading.
    ///
    /// # Errors
    /// `Input` when `R` has another dimension than the noise.
    pub fn reading_covariance(&self, noise_covariance: &DMatrix<f64>) -> Result<DMatrix<f64>> {
        let n = self.noise.len();
        if noise_covariance.shape() != (n, n) {
            let (rows, columns) = noise_covariance.shape();
            return Err(Error::input(format!(
                "expected a noise covariance of {n} × {n}, found {rows} × {columns}"
            )));
        }
        let covariance = &self.noise_jacobian * noise_covariance * self.noise_jacobian.transpose();
        // The product is symmetric only up to rounding, and factorisations read one triangle.
        Ok(symmetric_part(&covariance))
    }

    pub(crate) fn weight(&self, noise_covariance: &DMatrix<f64>) -> Result<ScaledCholesky> {
        ScaledCholesky::new(&self.reading_covariance(noise_covariance)?)
            .map_err(|null| null.into_error("the noise of a measurement equation (D R Dᵀ)"))
    }

    /// The information that the measurement adds.
    ///
    /// `W = (D R Dᵀ)⁻¹`, `Λ = Hᵀ W H`, `η = Hᵀ W (H x0 + D v0 − g0)`: exact for equations linear in `x` and
    /// `v`. Cost: `m³ + m² n + m n²` for `m` equations and `n` unknowns.
    ///
    /// # Errors
    /// `Input` when `R` has a wrong dimension; `Undetermined` when `D R Dᵀ` is singular, because an equation
    /// without noise is a constraint and not a measurement.
    ///
    /// # References
    /// Koch, *Parameter estimation and hypothesis testing in linear models*, 1999, mixed model.
    pub fn information(&self, noise_covariance: &DMatrix<f64>) -> Result<Information> {
        let weight = self.weight(noise_covariance)?;
        // A solution instead of the inverse of `D R Dᵀ`, which is less accurate if readings differ in σ. The
        // same product serves matrix and vector.
        let weighted = weight.solve_matrix(&self.state_jacobian);
        Ok(Information {
            matrix: symmetric_part(&(self.state_jacobian.transpose() * &weighted)),
            vector: weighted.transpose() * self.pseudo_reading(),
        })
    }

    /// The most likely noise, given the state `x`: `v̂ = R Dᵀ W (D v0 − g0 − H (x − x0))`.
    ///
    /// This is the residual, measured minus corrected; `z − v̂` obeys the linearised equation at `x`.
    ///
    /// # Errors
    /// As [`Self::information`], and `Input` when `x` has a wrong dimension.
    pub fn noise_estimate(&self, noise_covariance: &DMatrix<f64>, x: &DVector<f64>) -> Result<DVector<f64>> {
        require_vector("the state", x, self.state.len())?;
        let weight = self.weight(noise_covariance)?;
        let residual = self.unexplained() - &self.state_jacobian * (x - &self.state);
        Ok(noise_covariance * (self.noise_jacobian.transpose() * weight.solve(&residual)))
    }
}

/// The largest relative deviation of an equation's Jacobians from differences of its misclosure.
///
/// Fourth-order central differences with spacing `step · max(1, |x_j|)`, and the same in `v`; each deviation
/// is reduced by the possible rounding error of `g` and divided by the largest entry of its column. A correct
/// Jacobian gives about `step⁴` times the curvature, below 1e-6 for `step = 1e-3` in natural units. A wrong
/// one gives its relative error. Cost: `4 (n + p)` linearisations.
///
/// # Errors
/// `Input` when a dimension is wrong, `step` is not positive, or the equation is not defined near `(x, v)`.
///
/// # Examples
/// ```
/// use nalgebra::{DMatrix, DVector};
/// use planish_estimate::{Explicit, check_jacobians};
///
/// let wrong = Explicit::new(DVector::from_element(1, 4.0), 1, |x, prediction, jacobian| {
///     prediction[0] = x[0] * x[0];
///     jacobian[(0, 0)] = x[0]; // correct: 2x
/// });
/// let deviation = check_jacobians(&wrong, &DVector::from_element(1, 3.0), &DVector::zeros(1), 1e-3)?;
/// assert!((deviation - 0.5).abs() < 1e-6);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn check_jacobians<E: MeasurementEquation + ?Sized>(
    equation: &E,
    x: &DVector<f64>,
    v: &DVector<f64>,
    step: f64,
) -> Result<f64> {
    if !(step > 0.0 && step.is_finite()) {
        return Err(Error::input(format!("expected a step of a difference > 0, found {step}")));
    }
    let at = equation.linearized(x, v)?;
    let in_state =
        deviation_of_columns(&at.state_jacobian, x, step, |x| Ok(equation.linearized(x, v)?.misclosure))?;
    // Errors of sign in D are otherwise hard to find: they cancel in `D R Dᵀ`.
    let in_noise =
        deviation_of_columns(&at.noise_jacobian, v, step, |v| Ok(equation.linearized(x, v)?.misclosure))?;
    Ok(in_state.max(in_noise))
}

fn deviation_of_columns(
    stated: &DMatrix<f64>,
    point: &DVector<f64>,
    step: f64,
    misclosure: impl Fn(&DVector<f64>) -> Result<DVector<f64>>,
) -> Result<f64> {
    let mut worst = 0.0_f64;
    let mut moved = point.clone();
    for j in 0..point.len() {
        let spacing = step * point[j].abs().max(1.0);
        // Restoring the value exactly, instead of subtracting the shift, keeps rounding from accumulating
        // over the columns.
        let mut at = |shift: f64| {
            moved[j] = point[j] + shift;
            let value = misclosure(&moved);
            moved[j] = point[j];
            value
        };
        let (near_up, near_down) = (at(spacing)?, at(-spacing)?);
        let (far_up, far_down) = (at(2.0 * spacing)?, at(-2.0 * spacing)?);
        // A difference cannot be more accurate than the rounding of `g` divided by the spacing. Far from the
        // origin this exceeds the truncation error, and a correct Jacobian would seem wrong.
        let rounding = 8.0 * f64::EPSILON * near_up.amax().max(near_down.amax()) / spacing;
        // Fourth order, because the error of plain differences at a step large enough for rounding would hide
        // errors of a Jacobian.
        let difference = ((near_up - near_down) * 8.0 - (far_up - far_down)) / (12.0 * spacing);
        let scale = difference.amax().max(stated.column(j).amax());
        let deviation = ((stated.column(j) - difference).amax() - rounding).max(0.0);
        if deviation > 0.0 {
            worst = worst.max(deviation / scale);
        }
    }
    Ok(worst)
}

/// A linear reading `z = A x + v`, as `g = z − v − A x`.
///
/// # Examples
/// ```
/// use nalgebra::{DMatrix, DVector};
/// use planish_estimate::{Linear, MeasurementEquation};
///
/// let sum = Linear::new(DMatrix::from_element(1, 2, 1.0), DVector::from_element(1, 3.0))?;
/// let state = DVector::from_vec(vec![7.0, -5.0]);
/// let at = sum.linearized(&state, &DVector::zeros(1))?;
/// let information = at.information(&DMatrix::from_element(1, 1, 0.25))?;
/// assert_eq!(information.matrix, DMatrix::from_element(2, 2, 4.0));
/// assert_eq!(information.vector, DVector::from_element(2, 12.0));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Linear {
    design: DMatrix<f64>,
    reading: DVector<f64>,
}

impl Linear {
    /// A reading `z` of `A x`. `A` has as many rows as `z` has components.
    ///
    /// # Errors
    /// `Input` when the dimensions differ or a value is not finite.
    pub fn new(design: DMatrix<f64>, reading: DVector<f64>) -> Result<Self> {
        require_vector("the reading", &reading, design.nrows())?;
        if !design.iter().all(|value| value.is_finite()) {
            return Err(Error::input("expected finite values in the design matrix, found another"));
        }
        Ok(Self { design, reading })
    }
}

impl MeasurementEquation for Linear {
    fn dimensions(&self) -> Dimensions {
        let rows = self.design.nrows();
        Dimensions { state: self.design.ncols(), noise: rows, equations: rows }
    }

    fn linearize(&self, x: &DVector<f64>, v: &DVector<f64>, out: &mut Linearization) {
        out.misclosure.copy_from(&(&self.reading - v - &self.design * x));
        out.state_jacobian.copy_from(&-&self.design);
        fill_negative_identity(&mut out.noise_jacobian);
    }
}

/// An explicit reading `z = h(x) + v`, as `g = z − v − h(x)`, with `h` and `∂h/∂x` from a closure.
///
/// The closure receives the state, the prediction to fill (as long as `z`) and the Jacobian to fill (`z` ×
/// state).
#[derive(Debug, Clone)]
pub struct Explicit<F> {
    reading: DVector<f64>,
    state: usize,
    predict: F,
}

impl<F: Fn(&DVector<f64>, &mut DVector<f64>, &mut DMatrix<f64>)> Explicit<F> {
    /// The reading `z` of `h(x)` for a state of the given dimension.
    pub fn new(reading: DVector<f64>, state: usize, predict: F) -> Self {
        Self { reading, state, predict }
    }
}

impl<F: Fn(&DVector<f64>, &mut DVector<f64>, &mut DMatrix<f64>)> MeasurementEquation for Explicit<F> {
    fn dimensions(&self) -> Dimensions {
        Dimensions { state: self.state, noise: self.reading.len(), equations: self.reading.len() }
    }

    fn linearize(&self, x: &DVector<f64>, v: &DVector<f64>, out: &mut Linearization) {
        out.misclosure.fill(0.0);
        out.state_jacobian.fill(0.0);
        (self.predict)(x, &mut out.misclosure, &mut out.state_jacobian);
        for i in 0..self.reading.len() {
            out.misclosure[i] = self.reading[i] - v[i] - out.misclosure[i];
        }
        out.state_jacobian.neg_mut();
        fill_negative_identity(&mut out.noise_jacobian);
    }
}

/// An implicit equation whose linearisation is a closure of `(x, v, out)`, as
/// [`MeasurementEquation::linearize`].
///
/// Unlike an implementation of the trait, the closure receives `out` filled with zeros.
#[derive(Debug, Clone)]
pub struct Implicit<F> {
    dimensions: Dimensions,
    linearize: F,
}

impl<F: Fn(&DVector<f64>, &DVector<f64>, &mut Linearization)> Implicit<F> {
    /// An equation of the given dimensions; the closure holds the reading.
    pub fn new(dimensions: Dimensions, linearize: F) -> Self {
        Self { dimensions, linearize }
    }
}

impl<F: Fn(&DVector<f64>, &DVector<f64>, &mut Linearization)> MeasurementEquation for Implicit<F> {
    fn dimensions(&self) -> Dimensions {
        self.dimensions
    }

    fn linearize(&self, x: &DVector<f64>, v: &DVector<f64>, out: &mut Linearization) {
        out.misclosure.fill(0.0);
        out.state_jacobian.fill(0.0);
        out.noise_jacobian.fill(0.0);
        (self.linearize)(x, v, out);
    }
}

fn fill_negative_identity(matrix: &mut DMatrix<f64>) {
    matrix.fill(0.0);
    matrix.fill_diagonal(-1.0);
}

#[cfg(test)]
mod tests;
