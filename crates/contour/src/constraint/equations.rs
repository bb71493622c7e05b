//! Constraints as one measurement equation of the parameters of a drawing.

use super::drawing::ParametricDrawing;
use super::relation::Constraint;
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Dimensions, Linearization, MeasurementEquation};

/// An equation `f(x) = 0`, evaluated at a point.
#[derive(Debug, Clone, PartialEq)]
pub struct Equation {
    /// The residual `f(x)`.
    pub residual: f64,
    /// `∂f/∂x` as pairs of parameter and slope, for every parameter that the equation depends on; slopes may
    /// be zero.
    pub gradient: Vec<(usize, f64)>,
    /// True if the residual is a length; otherwise it is dimensionless.
    pub is_length: bool,
}

impl Equation {
    /// True if the residual and all slopes are finite.
    pub(crate) fn is_finite(&self) -> bool {
        self.residual.is_finite() && self.gradient.iter().all(|(_, slope)| slope.is_finite())
    }
}

/// Equations of constraints as a measurement `f(x) + v = 0` for the estimators.
///
/// Lengths are divided by the extent of the drawing, so that all residuals are dimensionless and of
/// comparable size. With a noise covariance of zero they hold exactly.
///
/// # Examples
/// ```
/// use nalgebra::DVector;
/// use planish_estimate::check_jacobians;
/// use planish_contour::constraint::{BarId, Constraint, ConstraintEquations, ParametricDrawing};
///
/// let drawing = ParametricDrawing::polygon(&[[0.0, 0.0], [4.0, 0.3], [3.9, 3.0]])?;
/// let right_angle = [Constraint::Perpendicular { a: BarId(0), b: BarId(1) }];
/// let equations = ConstraintEquations::new(&drawing, &right_angle);
/// assert!(check_jacobians(&equations, &drawing.values(), &DVector::zeros(1), 1e-3)? < 1e-6);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ConstraintEquations<'a> {
    drawing: &'a ParametricDrawing,
    constraints: Vec<Constraint>,
    /// Indices of the used equations among all equations of the constraints.
    rows: Vec<usize>,
    /// Length by which residuals of lengths are divided.
    scale: f64,
}

impl<'a> ConstraintEquations<'a> {
    /// All equations of the constraints, scaled by the extent of the drawing.
    #[must_use]
    pub fn new(drawing: &'a ParametricDrawing, constraints: &[Constraint]) -> Self {
        let count = constraints.iter().map(Constraint::equation_count).sum();
        Self {
            drawing,
            constraints: constraints.to_vec(),
            rows: (0..count).collect(),
            scale: drawing.extent(),
        }
    }

    /// The same with only some of the equations, by their index among all.
    #[must_use]
    pub(crate) fn with_rows(mut self, rows: &[usize]) -> Self {
        self.rows = rows.to_vec();
        self
    }

    /// Number of equations.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// True if there are no equations.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// For each equation, the index of its constraint.
    #[must_use]
    pub fn owners(&self) -> Vec<usize> {
        let all: Vec<usize> = self
            .constraints
            .iter()
            .enumerate()
            .flat_map(|(i, constraint)| std::iter::repeat_n(i, constraint.equation_count()))
            .collect();
        self.rows.iter().map(|&row| all[row]).collect()
    }

    /// The equations at `x`, unscaled.
    #[must_use]
    pub fn at(&self, x: &[f64]) -> Vec<Equation> {
        // The equations of a compound constraint share their geometry: evaluate all, then select.
        let all: Vec<Equation> =
            self.constraints.iter().flat_map(|constraint| constraint.equations(self.drawing, x)).collect();
        self.rows.iter().map(|&row| all[row].clone()).collect()
    }

    /// The scaled residuals, without the Jacobian.
    #[must_use]
    pub(crate) fn residuals(&self, x: &DVector<f64>) -> DVector<f64> {
        // No Jacobian: the search for drawings near an estimate needs residuals far more often.
        let equations = self.at(x.as_slice());
        let scaled = equations.iter().map(|equation| {
            let factor = if equation.is_length { 1.0 / self.scale } else { 1.0 };
            factor * equation.residual
        });
        DVector::from_iterator(self.len(), scaled)
    }

    /// The scaled residuals and their Jacobian, equations × parameters.
    #[must_use]
    pub fn residuals_and_jacobian(&self, x: &DVector<f64>) -> (DVector<f64>, DMatrix<f64>) {
        let mut residuals = DVector::zeros(self.len());
        let mut jacobian = DMatrix::zeros(self.len(), x.len());
        for (row, equation) in self.at(x.as_slice()).iter().enumerate() {
            // One scale for lengths and angles, so that a single tolerance suits both.
            let factor = if equation.is_length { 1.0 / self.scale } else { 1.0 };
            residuals[row] = factor * equation.residual;
            for &(parameter, slope) in &equation.gradient {
                jacobian[(row, parameter)] += factor * slope;
            }
        }
        (residuals, jacobian)
    }
}

impl MeasurementEquation for ConstraintEquations<'_> {
    fn dimensions(&self) -> Dimensions {
        Dimensions { state: self.drawing.parameters(), noise: self.len(), equations: self.len() }
    }

    fn linearize(&self, x: &DVector<f64>, v: &DVector<f64>, out: &mut Linearization) {
        let (residuals, jacobian) = self.residuals_and_jacobian(x);
        out.misclosure.copy_from(&(residuals + v));
        out.state_jacobian.copy_from(&jacobian);
        out.noise_jacobian.fill_with_identity();
    }
}
