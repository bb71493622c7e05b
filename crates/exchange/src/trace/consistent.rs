//! Values that satisfy equations: the smallest weighted change of unknowns x so that c(x) = 0.
//!
//! Each step solves the linearised equations J d = −c with the smallest Σ dᵢ²/σᵢ², which is
//! d = −S Jᵀ (J S Jᵀ)⁻¹ c with S = diag(σ²).

use nalgebra::{DMatrix, DVector};

/// Steps of Newton's method.
const STEPS: usize = 30;
/// Maximum residual in pixels.
pub(super) const SOLVED: f64 = 1e-9;
/// Maximum number of equations; the effort grows with its cube.
const MAX_EQUATIONS: usize = 600;

/// An equation: its residual and the derivatives by unknowns.
pub(super) type Equation<'a> = Box<dyn Fn(&[f64]) -> (f64, Vec<(usize, f64)>) + 'a>;

/// The unknowns after the change, and the residuals of the equations: those that contradict each other are
/// not met. None if there are too many.
pub(super) fn solved(
    start: &[f64],
    sigmas: &[f64],
    equations: &[&Equation<'_>],
) -> Option<(Vec<f64>, Vec<f64>)> {
    let (n, m) = (start.len(), equations.len());
    if m > MAX_EQUATIONS {
        return None;
    }
    let mut x = start.to_vec();
    for _ in 0..STEPS {
        let mut jacobian: DMatrix<f64> = DMatrix::zeros(m, n);
        let mut residuals: DVector<f64> = DVector::zeros(m);
        for (row, equation) in equations.iter().enumerate() {
            let (residual, slopes) = equation(&x);
            residuals[row] = residual;
            slopes.iter().for_each(|(k, slope)| jacobian[(row, *k)] += slope * sigmas[*k]);
        }
        if m == 0 || residuals.amax() < SOLVED {
            break;
        }
        let mut normal: DMatrix<f64> = &jacobian * jacobian.transpose();
        // Equations may follow from each other, or contradict each other.
        let ridge = 1e-9 * normal.diagonal().amax().max(1e-12);
        (0..m).for_each(|k| normal[(k, k)] += ridge);
        let weights: DVector<f64> = normal.cholesky()?.solve(&residuals);
        let step: DVector<f64> = jacobian.transpose() * weights;
        (0..n).for_each(|k| x[k] -= sigmas[k] * step[k]);
        if x.iter().any(|v| !v.is_finite()) {
            return None;
        }
    }
    let residuals = equations.iter().map(|e| e(&x).0.abs()).collect();
    Some((x, residuals))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_moves_onto_a_circle_and_dependent_equations_do_no_harm() {
        // Unknowns: a point, and the radius of a circle around the origin, which is less accurate.
        let on_circle = |x: &[f64]| {
            let length = x[0].hypot(x[1]);
            (length - x[2], vec![(0, x[0] / length), (1, x[1] / length), (2, -1.0)])
        };
        let on_circle: Equation<'_> = Box::new(on_circle);
        let twice = [&on_circle, &on_circle];
        let (found, _) = solved(&[3.0, 4.0, 6.0], &[0.1, 0.1, 1.0], &twice).unwrap();
        assert!((found[0].hypot(found[1]) - found[2]).abs() < 1e-8, "{found:?}");
        assert!((found[2] - 5.0).abs() < 0.05, "{found:?}");
        let contradiction: Vec<Equation<'_>> =
            vec![Box::new(|x| (x[0] - 1.0, vec![(0, 1.0)])), Box::new(|x| (x[0] - 2.0, vec![(0, 1.0)]))];
        let both: Vec<&Equation<'_>> = contradiction.iter().collect();
        let (_, residuals) = solved(&[1.0], &[1.0], &both).unwrap();
        assert!(residuals.iter().all(|r| (r - 0.5).abs() < 1e-3), "{residuals:?}");
    }
}
