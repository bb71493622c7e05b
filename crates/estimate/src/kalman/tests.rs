use super::*;
use crate::test_support::{Gaussian, dmatrix, dvector, relative_difference, scalar};
use crate::{ChiSquareMean, Dimensions, Explicit, Implicit, Information, LeastSquaresOptions, Linear};
use crate::{ErrorKind, Measurement, least_squares, normalized_squared};

#[test]
fn one_by_one_in_any_order_equals_the_batch_and_the_information_form() {
    let mut random = Gaussian::seeded(21);
    let n = 6;
    let (mean, covariance) = (random.vector(n), random.covariance(n));
    let (design, reading) = (random.matrix(12, n), random.vector(12));
    let variances: Vec<f64> = (0..12).map(|_| 0.01 + random.number().abs()).collect();

    let start = KalmanFilter::new(mean.clone(), covariance.clone()).unwrap();
    let mut batch = start.clone();
    batch.update(&design, &reading, &DMatrix::from_diagonal(&variances.clone().into())).unwrap();
    let mut belief = Belief::from_covariance(mean, covariance).unwrap();
    for order in
        [(0..12).collect::<Vec<_>>(), (0..12).rev().collect(), vec![3, 7, 11, 0, 2, 1, 5, 4, 6, 10, 9, 8]]
    {
        let mut sequential = start.clone();
        for i in order {
            sequential.update_scalar(&design.row(i).transpose(), reading[i], variances[i]).unwrap();
        }
        assert!((sequential.mean() - batch.mean()).amax() < 1e-11);
        assert!(relative_difference(sequential.covariance(), batch.covariance()) < 1e-11);
    }
    for i in 0..12 {
        let equation = Linear::new(design.rows(i, 1).into_owned(), dvector![reading[i]]).unwrap();
        belief
            .update(&equation.linearized(&DVector::zeros(n), &dvector![0.0]).unwrap(), &scalar(variances[i]))
            .unwrap();
    }
    assert!((belief.mean().unwrap() - batch.mean()).amax() < 1e-11);
    assert!(relative_difference(&belief.covariance().unwrap(), batch.covariance()) < 1e-11);
    let again = KalmanFilter::from_belief(&belief).unwrap();
    assert!(relative_difference(again.covariance(), batch.covariance()) < 1e-11);
}

#[test]
fn scalar_and_vector_updates_agree() {
    let mut random = Gaussian::seeded(22);
    let start = KalmanFilter::new(random.vector(4), random.covariance(4)).unwrap();
    let row = random.vector(4);
    let (mut a, mut b) = (start.clone(), start);
    let scalar_innovation = a.update_scalar(&row, 0.7, 0.2).unwrap();
    let innovation = b.update(&DMatrix::from_rows(&[row.transpose()]), &dvector![0.7], &scalar(0.2)).unwrap();
    assert!((a.mean() - b.mean()).amax() < 1e-14);
    assert!(relative_difference(a.covariance(), b.covariance()) < 1e-14);
    assert!((scalar_innovation.normalized_squared - innovation.normalized_squared).abs() < 1e-13);
    assert!((scalar_innovation.variance - innovation.covariance[(0, 0)]).abs() < 1e-14);
}

#[test]
fn joseph_form_stays_symmetric_and_positive_for_extreme_ratios() {
    // Prior variances are 1e6. Up to thirteen orders of magnitude no eigenvalue is negative; beyond that only
    // by the rounding of the largest variance.
    for (variance, rounding) in [(1e-7, 0.0), (1e-12, 1e-8), (1e-20, 1e-8), (0.0, 1e-8)] {
        for seed in 0..20 {
            let mut random = Gaussian::seeded(230 + seed);
            let mut filter = KalmanFilter::new(DVector::zeros(5), random.covariance(5) * 1e6).unwrap();
            for _ in 0..if rounding > 0.0 { 4 } else { 200 } {
                filter.update_scalar(&random.vector(5), random.number(), variance).unwrap();
                let covariance = filter.covariance();
                assert_eq!(*covariance, covariance.transpose());
                let smallest = covariance.clone().symmetric_eigenvalues().min();
                assert!(smallest > -rounding || smallest > 0.0, "{variance} {seed} {smallest}");
            }
        }
    }
}

#[test]
fn joseph_form_is_the_true_covariance_for_any_gain() {
    let mut random = Gaussian::seeded(24);
    let (covariance, noise) = (random.covariance(3), random.covariance(2));
    let (design, gain) = (random.matrix(2, 3), random.matrix(3, 2) * 0.3);
    let stated = joseph_covariance(&covariance, &design, &noise, &gain);
    let mut sum = DMatrix::zeros(3, 3);
    let runs = 40_000;
    for _ in 0..runs {
        let (deviation, v) = (random.draw(&covariance), random.draw(&noise));
        let after = &deviation - &gain * (&design * &deviation + v);
        sum += &after * after.transpose();
    }
    assert!(relative_difference(&(sum / f64::from(runs)), &stated) < 0.03);
}

#[test]
fn nees_and_nis_of_a_tracked_state_lie_in_their_bands() {
    let mut random = Gaussian::seeded(25);
    let (transition, process) = (dmatrix![1.0, 0.5; 0.0, 1.0], dmatrix![0.02, 0.01; 0.01, 0.05]);
    let (design, noise) = (dmatrix![1.0, 0.0], scalar(0.3));
    let start = dmatrix![2.0, 0.3; 0.3, 1.0];
    let mut nees = ChiSquareMean::new(2.0).unwrap();
    let mut nis = ChiSquareMean::new(1.0).unwrap();
    for _ in 0..300 {
        let mut truth = random.draw(&start);
        let mut filter = KalmanFilter::new(DVector::zeros(2), start.clone()).unwrap();
        let mut last = 0.0;
        for _ in 0..20 {
            truth = &transition * truth + random.draw(&process);
            filter.predict(&transition, &process).unwrap();
            let reading = &design * &truth + random.draw(&noise);
            last = filter.update(&design, &reading, &noise).unwrap().normalized_squared;
        }
        nees.add(normalized_squared(&(filter.mean() - truth), filter.covariance()).unwrap()).unwrap();
        nis.add(last).unwrap();
    }
    assert!(nees.is_consistent(0.99).unwrap(), "{} {:?}", nees.mean(), nees.band(0.99));
    assert!(nis.is_consistent(0.99).unwrap(), "{} {:?}", nis.mean(), nis.band(0.99));
}

/// Ranges at uncertain bearings from the origin to a circle: one equation of `m` rows and `2 m` noise
/// components.
fn circle_by_range(readings: Vec<[f64; 2]>) -> impl MeasurementEquation {
    let m = readings.len();
    Implicit::new(Dimensions { state: 3, noise: 2 * m, equations: m }, move |x, v, out| {
        for (i, [range, bearing]) in readings.iter().enumerate() {
            let (rho, phi) = (range - v[2 * i], bearing - v[2 * i + 1]);
            let (sine, cosine) = phi.sin_cos();
            let p = [rho * cosine - x[0], rho * sine - x[1]];
            out.misclosure[i] = p[0] * p[0] + p[1] * p[1] - x[2] * x[2];
            for (j, value) in [-2.0 * p[0], -2.0 * p[1], -2.0 * x[2]].into_iter().enumerate() {
                out.state_jacobian[(i, j)] = value;
            }
            out.noise_jacobian[(i, 2 * i)] = -2.0 * (p[0] * cosine + p[1] * sine);
            out.noise_jacobian[(i, 2 * i + 1)] = -2.0 * rho * (p[1] * cosine - p[0] * sine);
        }
    })
}

struct CircleCase {
    truth: DVector<f64>,
    prior_mean: DVector<f64>,
    prior: DMatrix<f64>,
    readings: Vec<[f64; 2]>,
    noise: DMatrix<f64>,
}

fn circle_case(random: &mut Gaussian) -> CircleCase {
    let (sigma_range, sigma_bearing) = (0.1, 0.02);
    let prior = DMatrix::from_diagonal(&dvector![0.25, 0.25, 0.25]);
    let prior_mean = dvector![5.0, 1.0, 2.0];
    let truth = &prior_mean + random.draw(&prior);
    let readings = (0..12)
        .map(|i| {
            let angle = 1.6 + 0.28 * f64::from(i); // the side that faces the sensor
            let p = [truth[0] + truth[2] * angle.cos(), truth[1] + truth[2] * angle.sin()];
            let (range, bearing) = (p[0].hypot(p[1]), p[1].atan2(p[0]));
            [range + sigma_range * random.number(), bearing + sigma_bearing * random.number()]
        })
        .collect::<Vec<_>>();
    let variances = DVector::from_fn(24, |i, _| if i % 2 == 0 { sigma_range } else { sigma_bearing }.powi(2));
    CircleCase { truth, prior_mean, prior, readings, noise: DMatrix::from_diagonal(&variances) }
}

#[test]
fn noise_updated_filter_beats_the_extended_one_on_a_circle() {
    let mut random = Gaussian::seeded(26);
    let schemes = [EquationUpdate::extended(), EquationUpdate::iterated(), EquationUpdate::noise_updated()];
    let mut squares = [0.0; 3];
    let mut nees = [0.0; 3];
    let runs = 300;
    for _ in 0..runs {
        let case = circle_case(&mut random);
        let equation = circle_by_range(case.readings.clone());
        for (k, scheme) in schemes.iter().enumerate() {
            let mut filter = KalmanFilter::new(case.prior_mean.clone(), case.prior.clone()).unwrap();
            filter.update_equation(&equation, &case.noise, scheme).unwrap();
            let deviation = filter.mean() - &case.truth;
            squares[k] += deviation.norm_squared() / f64::from(runs);
            nees[k] += normalized_squared(&deviation, filter.covariance()).unwrap() / f64::from(runs);
        }
    }
    let [extended, iterated, noise_updated] = squares.map(f64::sqrt);
    assert!(noise_updated < 0.6 * extended, "{extended} {iterated} {noise_updated}");
    assert!(noise_updated < iterated, "{extended} {iterated} {noise_updated}");
    // Three unknowns: the noise-updated filter is consistent, the extended filter is not.
    assert!((nees[2] - 3.0).abs() < 0.6 && nees[0] > 6.0, "{nees:?}");
}

#[test]
fn noise_updated_filter_converges_to_the_gauss_helmert_solution() {
    let mut random = Gaussian::seeded(27);
    for _ in 0..5 {
        let case = circle_case(&mut random);
        let equation = circle_by_range(case.readings.clone());
        assert!(crate::check_jacobians(&equation, &case.truth, &DVector::zeros(24), 1e-3).unwrap() < 1e-8);
        let mut filter = KalmanFilter::new(case.prior_mean.clone(), case.prior.clone()).unwrap();
        let innovation =
            filter.update_equation(&equation, &case.noise, &EquationUpdate::noise_updated()).unwrap();
        assert_eq!(innovation.termination, Termination::Converged);

        let prior = Information::from_covariance(&case.prior_mean, &case.prior).unwrap();
        let options = LeastSquaresOptions::default();
        let fit = least_squares(
            &[Measurement::new(&equation, case.noise.clone())],
            &prior,
            &case.prior_mean,
            &options,
        );
        let fit = fit.unwrap();
        assert!((&fit.state - filter.mean()).amax() < 1e-7, "{} {}", fit.state, filter.mean());
        assert!(relative_difference(fit.covariance.as_ref().unwrap(), filter.covariance()) < 1e-6);
        // The normalised innovation equals twice the objective of prior and noise.
        let moved = &fit.state - &case.prior_mean;
        let objective = 2.0 * fit.loss + moved.dot(&(&prior.matrix * &moved));
        assert!((innovation.normalized_squared - objective).abs() < 1e-6 * objective);
    }
}

#[test]
fn all_schemes_agree_on_linear_equations() {
    let mut random = Gaussian::seeded(28);
    let start = KalmanFilter::new(random.vector(3), random.covariance(3)).unwrap();
    let (design, reading, noise) = (random.matrix(2, 3), random.vector(2), random.covariance(2));
    let equation = Linear::new(design.clone(), reading.clone()).unwrap();
    let mut expected = start.clone();
    expected.update(&design, &reading, &noise).unwrap();
    for scheme in [EquationUpdate::extended(), EquationUpdate::iterated(), EquationUpdate::noise_updated()] {
        let mut filter = start.clone();
        filter.update_equation(&equation, &noise, &scheme).unwrap();
        assert!((filter.mean() - expected.mean()).amax() < 1e-13);
        assert!(relative_difference(filter.covariance(), expected.covariance()) < 1e-13);
    }
}

#[test]
fn a_diverging_iteration_is_reported_and_invalid_input_has_no_effect() {
    let equation = Explicit::new(dvector![4.0], 1, |x, prediction, jacobian| {
        prediction[0] = x[0] * x[0];
        jacobian[(0, 0)] = 2.0 * x[0];
    });
    let mut filter = KalmanFilter::new(dvector![0.5], scalar(1.0)).unwrap();
    let before = filter.clone();
    assert!(filter.update_scalar(&dvector![1.0], f64::NAN, 1.0).is_err());
    assert!(filter.update(&dmatrix![1.0, 0.0], &dvector![1.0], &scalar(1.0)).is_err());
    assert!(filter.update_equation(&equation, &scalar(-1.0), &EquationUpdate::extended()).is_err());
    assert_eq!(filter, before);
    let twice = EquationUpdate { max_iterations: 2, ..EquationUpdate::iterated() };
    let innovation = filter.update_equation(&equation, &scalar(1e-4), &twice).unwrap();
    assert_eq!((innovation.termination, innovation.iterations), (Termination::Limit, 2));
    let mut certain = KalmanFilter::new(dvector![0.5], scalar(0.0)).unwrap();
    assert_eq!(certain.update_scalar(&dvector![1.0], 1.0, 0.0).unwrap_err().kind(), ErrorKind::Undetermined);
}
