use super::*;
use crate::ErrorKind;
use crate::test_support::{Gaussian, dmatrix, dvector, relative_difference};

/// A point on a circle (centre, radius) with noise in both coordinates; `mistake` is added to one entry of a
/// Jacobian.
fn circle(z: [f64; 2], mistake: f64) -> impl MeasurementEquation {
    Implicit::new(Dimensions { state: 3, noise: 2, equations: 1 }, move |x, v, out| {
        let p = [z[0] - v[0] - x[0], z[1] - v[1] - x[1]];
        out.misclosure[0] = p[0] * p[0] + p[1] * p[1] - x[2] * x[2];
        out.state_jacobian.copy_from_slice(&[-2.0 * p[0], -2.0 * p[1], -2.0 * x[2]]);
        out.noise_jacobian.copy_from_slice(&[-2.0 * p[0], -2.0 * p[1] * (1.0 + mistake)]);
    })
}

#[test]
fn the_checker_accepts_correct_jacobians_and_reports_the_size_of_an_error() {
    let (x, v) = (dvector![0.3, -0.2, 1.5], dvector![0.1, 0.05]);
    assert!(check_jacobians(&circle([1.0, 1.2], 0.0), &x, &v, 1e-3).unwrap() < 1e-10);
    let deviation = check_jacobians(&circle([1.0, 1.2], 0.01), &x, &v, 1e-3).unwrap();
    assert!((deviation - 0.01 / 1.01).abs() < 1e-6, "{deviation}");
    // The sign of D is a convention and easily confused.
    assert!((check_jacobians(&circle([1.0, 1.2], -2.0), &x, &v, 1e-3).unwrap() - 2.0).abs() < 1e-6);
    assert!(check_jacobians(&circle([1.0, 1.2], 0.0), &x, &v, 0.0).is_err());
}

#[test]
fn the_checker_ignores_rounding_of_large_readings() {
    let far = Explicit::new(dvector![0.0], 2, |x, prediction, jacobian| {
        prediction[0] = x[0].sin() + 1e6;
        jacobian[(0, 0)] = x[0].cos();
    });
    assert!(check_jacobians(&far, &dvector![1.0, 5.0], &dvector![0.0], 1e-3).unwrap() < 1e-9);
}

#[test]
fn explicit_and_linear_agree() {
    let mut random = Gaussian::seeded(11);
    let (design, reading, covariance) = (random.matrix(2, 3), random.vector(2), random.covariance(2));
    let linear = Linear::new(design.clone(), reading.clone()).unwrap();
    let explicit = Explicit::new(reading, 3, move |x, prediction, jacobian| {
        prediction.copy_from(&(&design * x));
        jacobian.copy_from(&design);
    });
    let (x, v) = (random.vector(3), random.vector(2));
    assert_eq!(linear.linearized(&x, &v).unwrap(), explicit.linearized(&x, &v).unwrap());
    assert!(check_jacobians(&linear, &x, &v, 1e-2).unwrap() < 1e-10);
    let a = linear.linearized(&x, &v).unwrap().information(&covariance).unwrap();
    let b =
        linear.linearized(&random.vector(3), &random.vector(2)).unwrap().information(&covariance).unwrap();
    assert!(relative_difference(&a.matrix, &b.matrix) < 1e-14);
}

#[test]
fn the_noise_estimate_makes_the_linearised_equation_hold_and_is_the_smallest() {
    let mut random = Gaussian::seeded(12);
    let at = circle([1.0, 1.2], 0.0).linearized(&dvector![0.3, -0.2, 1.0], &dvector![0.1, -0.1]).unwrap();
    let covariance = random.covariance(2);
    let x = dvector![0.31, -0.25, 1.1];
    let v = at.noise_estimate(&covariance, &x).unwrap();
    let misclosure =
        &at.misclosure + &at.state_jacobian * (&x - &at.state) + &at.noise_jacobian * (&v - &at.noise);
    assert!(misclosure.amax() < 1e-14);
    let cost = |v: &DVector<f64>| v.dot(&covariance.clone().cholesky().unwrap().solve(v));
    let along = dvector![-at.noise_jacobian[1], at.noise_jacobian[0]] * 1e-2;
    assert!(cost(&v) < cost(&(&v + &along)) && cost(&v) < cost(&(&v - &along)));
    // Its normalised square equals that of the misclosure.
    let left = at.unexplained() - &at.state_jacobian * (&x - &at.state);
    assert!(
        (cost(&v) - left[0] * left[0] / at.reading_covariance(&covariance).unwrap()[(0, 0)]).abs() < 1e-12
    );
}

#[test]
fn a_constraint_without_noise_is_rejected() {
    let at = circle([0.3, -0.2], 0.0).linearized(&dvector![0.3, -0.2, 1.0], &dvector![0.0, 0.0]).unwrap();
    let error = at.information(&DMatrix::identity(2, 2)).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Undetermined);
    assert_eq!(at.information(&dmatrix![1.0]).unwrap_err().kind(), ErrorKind::Input);
}

#[test]
fn an_equation_that_is_not_defined_is_an_error_and_not_a_silent_nan() {
    let root = Explicit::new(dvector![1.0], 1, |x, prediction, jacobian| {
        prediction[0] = x[0].sqrt();
        jacobian[(0, 0)] = 0.5 / x[0].sqrt();
    });
    assert_eq!(root.linearized(&dvector![-1.0], &dvector![0.0]).unwrap_err().kind(), ErrorKind::Input);
    assert_eq!(root.linearized(&dvector![1.0, 2.0], &dvector![0.0]).unwrap_err().kind(), ErrorKind::Input);
}
