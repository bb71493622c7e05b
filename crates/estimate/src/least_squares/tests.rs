use super::*;
use crate::test_support::{Gaussian, dmatrix, dvector, relative_difference, scalar};
use crate::{Belief, ChiSquareMean, Dimensions, ErrorKind, Explicit, Implicit, Linear, normalized_squared};

fn line_readings(random: &mut Gaussian, truth: &DVector<f64>, count: usize, sigma: f64) -> Vec<Linear> {
    (0..count)
        .map(|_| {
            let row = random.matrix(1, truth.len());
            let reading = (&row * truth)[0] + sigma * random.number();
            Linear::new(row, dvector![reading]).unwrap()
        })
        .collect()
}

fn with_loss<'a>(equations: &'a [Linear], sigma: f64, loss: Loss) -> Vec<Measurement<'a>> {
    equations.iter().map(|z| Measurement::new(z, scalar(sigma * sigma)).with_loss(loss)).collect()
}

fn solve(measurements: &[Measurement<'_>], start: &DVector<f64>) -> LeastSquaresFit {
    least_squares(measurements, &Information::zero(start.len()), start, &LeastSquaresOptions::default())
        .unwrap()
}

#[test]
fn a_linear_batch_equals_the_belief_and_its_leverages_add_up() {
    let mut random = Gaussian::seeded(31);
    let truth = random.vector(4);
    let equations = line_readings(&mut random, &truth, 20, 0.1);
    let prior = Information::from_covariance(&random.vector(4), &random.covariance(4)).unwrap();
    let mut belief = Belief::from_information(prior.clone(), Information::zero(4)).unwrap();
    for equation in &equations {
        belief.update(&equation.linearized(&truth, &dvector![0.0]).unwrap(), &scalar(0.01)).unwrap();
    }
    let measurements = with_loss(&equations, 0.1, Loss::Gaussian);
    let fit =
        least_squares(&measurements, &prior, &DVector::zeros(4), &LeastSquaresOptions::default()).unwrap();
    assert_eq!(fit.termination, Termination::Converged);
    assert!(fit.iterations <= 3);
    assert!((&fit.state - belief.mean().unwrap()).amax() < 1e-11);
    assert!(relative_difference(fit.covariance.as_ref().unwrap(), &belief.covariance().unwrap()) < 1e-11);
    assert!(relative_difference(&fit.information.matrix, &belief.data().matrix) < 1e-12);
    assert!((&fit.information.vector - &belief.data().vector).amax() < 1e-9 * belief.data().vector.amax());
    let used = (belief.covariance().unwrap() * &belief.data().matrix).trace();
    assert!((fit.leverages.iter().sum::<f64>() - used).abs() < 1e-11);
}

/// A point on a circle of unknown centre and radius.
fn circle(z: [f64; 2]) -> impl MeasurementEquation {
    Implicit::new(Dimensions { state: 3, noise: 2, equations: 1 }, move |x, v, out| {
        let p = [z[0] - v[0] - x[0], z[1] - v[1] - x[1]];
        let r = p[0].hypot(p[1]);
        out.misclosure[0] = r - x[2];
        out.state_jacobian.copy_from_slice(&[-p[0] / r, -p[1] / r, -1.0]);
        out.noise_jacobian.copy_from_slice(&[-p[0] / r, -p[1] / r]);
    })
}

#[test]
fn corrected_readings_lie_on_the_fitted_circle_and_the_objective_is_minimal() {
    let mut random = Gaussian::seeded(32);
    let covariance = dmatrix![0.02, 0.006; 0.006, 0.01];
    let points: Vec<[f64; 2]> = (0..15)
        .map(|i| {
            let (angle, v) = (0.3 * f64::from(i), random.draw(&covariance));
            [2.0 * angle.cos() + v[0], 1.0 + 2.0 * angle.sin() + v[1]]
        })
        .collect();
    let equations: Vec<_> = points.iter().map(|&z| circle(z)).collect();
    let measurements: Vec<_> = equations.iter().map(|z| Measurement::new(z, covariance.clone())).collect();
    let fit = solve(&measurements, &dvector![0.5, 0.5, 1.0]);
    assert_eq!(fit.termination, Termination::Converged);
    for (z, v) in points.iter().zip(&fit.residuals) {
        let distance = (z[0] - v[0] - fit.state[0]).hypot(z[1] - v[1] - fit.state[1]);
        assert!((distance - fit.state[2]).abs() < 1e-8);
    }
    // Brute force: the nearest point of the circle in the metric of the covariance, by search along the
    // circle.
    let inverse = covariance.clone().try_inverse().unwrap();
    let objective = |x: &DVector<f64>| -> f64 {
        points
            .iter()
            .map(|z| {
                let squared = |angle: f64| {
                    let v = dvector![z[0] - x[0] - x[2] * angle.cos(), z[1] - x[1] - x[2] * angle.sin()];
                    v.dot(&(&inverse * &v))
                };
                let middle = (z[1] - x[1]).atan2(z[0] - x[0]);
                let found =
                    crate::line_search::maximize_between(middle - 1.0, middle + 1.0, 1e-9, 200, |a| {
                        Ok(-squared(a))
                    });
                -0.5 * found.unwrap().best.value
            })
            .sum()
    };
    let minimum = objective(&fit.state);
    assert!((fit.loss - minimum).abs() < 1e-9, "{} {minimum}", fit.loss);
    for direction in 0..3 {
        for sign in [-1.0, 1.0] {
            let mut moved = fit.state.clone();
            moved[direction] += sign * 1e-3;
            assert!(objective(&moved) > minimum);
        }
    }
}

#[test]
fn a_far_start_where_undamped_steps_diverge_still_converges() {
    // Undamped Gauss–Newton diverges on arctan from 2.
    let equation = Explicit::new(dvector![0.0], 1, |x, prediction, jacobian| {
        prediction[0] = x[0].atan();
        jacobian[(0, 0)] = 1.0 / (1.0 + x[0] * x[0]);
    });
    for initial_damping in [0.0, 1e-3] {
        let options = LeastSquaresOptions { initial_damping, ..LeastSquaresOptions::default() };
        let measurement = Measurement::new(&equation, scalar(1.0));
        let fit = least_squares(&[measurement], &Information::zero(1), &dvector![2.0], &options).unwrap();
        assert_eq!(fit.termination, Termination::Converged);
        assert!(fit.state[0].abs() < 1e-6);
    }
}

#[test]
fn large_offsets_and_small_sigmas_end_by_tolerance_and_not_by_error() {
    let equations: Vec<_> =
        [[1e4 + 2.0, 1e4], [1e4, 1e4 + 2.0], [1e4 - 2.0, 1e4], [1e4 + 1e-6, 1e4 - 2.0]].map(circle).into();
    let readings: Vec<_> =
        equations.iter().map(|z| Measurement::new(z, DMatrix::identity(2, 2) * 1e-14)).collect();
    let fit = solve(&readings, &dvector![1e4 + 0.3, 1e4 - 0.2, 1.5]);
    assert!(
        matches!(fit.termination, Termination::Converged | Termination::ReachedTolerance),
        "{:?}",
        fit.termination
    );
    assert!((fit.state[2] - 2.0).abs() < 1e-5);
}

#[test]
fn an_undetermined_direction_is_reported_and_not_guessed() {
    let sum = Linear::new(dmatrix![1.0, 1.0, 0.0], dvector![2.0]).unwrap();
    let fit = solve(&[Measurement::new(&sum, scalar(1.0))], &DVector::zeros(3));
    assert_eq!(fit.termination, Termination::Undetermined);
    assert!(fit.covariance.is_none());
    let direction = fit.undetermined_direction.unwrap();
    assert!((direction[0] + direction[1]).abs() < 1e-9 * direction.norm());
    assert!((fit.state[0] + fit.state[1] - 2.0).abs() < 1e-6, "{}", fit.state);
}

#[test]
fn reaching_the_maximum_number_of_steps_is_reported() {
    let equations: Vec<_> = [[2.0, 0.1], [0.0, 2.1], [-1.9, 0.0], [0.1, -2.0]].map(circle).into();
    let readings: Vec<_> = equations.iter().map(|z| Measurement::new(z, DMatrix::identity(2, 2))).collect();
    let options = LeastSquaresOptions { max_iterations: 1, ..LeastSquaresOptions::default() };
    let fit = least_squares(&readings, &Information::zero(3), &dvector![0.5, 0.5, 1.0], &options).unwrap();
    assert_eq!((fit.termination, fit.iterations), (Termination::Limit, 1));
}

#[test]
fn wrong_shapes_are_input_errors_that_name_the_measurement() {
    let equation = Linear::new(dmatrix![1.0, 1.0], dvector![2.0]).unwrap();
    let options = LeastSquaresOptions::default();
    let cases = [
        (Measurement::new(&equation, DMatrix::identity(2, 2)), 2),
        (Measurement::new(&equation, scalar(1.0)), 3),
        (Measurement::new(&equation, scalar(1.0)).with_loss(Loss::Huber { threshold: 0.0 }), 2),
    ];
    for (measurement, n) in cases {
        let refused = least_squares(&[measurement], &Information::zero(n), &DVector::zeros(n), &options);
        assert_eq!(refused.unwrap_err().kind(), ErrorKind::Input);
    }
}

#[test]
fn stated_covariance_of_robust_fits_matches_many_runs() {
    let sigma = 0.2;
    for (loss, seed) in [(Loss::huber(), 33), (Loss::tukey(), 34), (Loss::Huber { threshold: 0.5 }, 35)] {
        let mut random = Gaussian::seeded(seed);
        let mut nees = ChiSquareMean::new(2.0).unwrap();
        for _ in 0..300 {
            let truth = random.vector(2);
            let equations = line_readings(&mut random, &truth, 80, sigma);
            let fit = solve(&with_loss(&equations, sigma, loss), &truth);
            nees.add(normalized_squared(&(&fit.state - truth), fit.covariance.as_ref().unwrap()).unwrap())
                .unwrap();
        }
        assert!(nees.is_consistent(0.99).unwrap(), "{loss:?}: {} {:?}", nees.mean(), nees.band(0.99));
    }
}

#[test]
fn gross_outliers_move_a_gaussian_fit_but_not_a_redescending_one() {
    let sigma = 0.1;
    let mut random = Gaussian::seeded(36);
    let mut squares = [0.0; 2];
    let mut nees = ChiSquareMean::new(2.0).unwrap();
    for _ in 0..200 {
        let truth = random.vector(2);
        let mut equations = line_readings(&mut random, &truth, 76, sigma);
        equations.extend((0..4).map(|_| Linear::new(random.matrix(1, 2), dvector![8.0]).unwrap()));
        let gaussian = solve(&with_loss(&equations, sigma, Loss::Gaussian), &truth);
        let tukey = solve(&with_loss(&equations, sigma, Loss::tukey()), &truth);
        squares[0] += (&gaussian.state - &truth).norm_squared();
        squares[1] += (&tukey.state - &truth).norm_squared();
        nees.add(normalized_squared(&(&tukey.state - truth), tukey.covariance.as_ref().unwrap()).unwrap())
            .unwrap();
        assert!(tukey.weights[76..].iter().all(|&w| w < 0.5));
    }
    assert!(squares[1] < 0.01 * squares[0], "{squares:?}");
    assert!(nees.is_consistent(0.99).unwrap(), "{} {:?}", nees.mean(), nees.band(0.99));
}
