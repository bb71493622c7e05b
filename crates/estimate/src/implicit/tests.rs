//! Laws, tested on circles with closed-form solutions.

use super::*;
use crate::{
    ChiSquareMean, Dimensions, Implicit, Information, KalmanFilter, LeastSquaresOptions, Loss, Measurement,
};
use crate::{least_squares, normalized_squared};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// A point near a circle `(c, r)`; noise of σ in both coordinates.
struct OnCircle {
    point: [f64; 2],
    sigma: f64,
}

impl ImplicitReading for OnCircle {
    fn state(&self) -> usize {
        3
    }

    fn noise(&self) -> usize {
        2
    }

    fn gradient(&self, _: usize, x: &[f64], u: &[f64], by_state: &mut [f64], by_noise: &mut [f64]) -> f64 {
        let d = [0, 1].map(|k| self.point[k] - self.sigma * u[k] - x[k]);
        let length = d[0].hypot(d[1]);
        for k in 0..2 {
            by_state[k] = -d[k] / length;
            by_noise[k] = -self.sigma * d[k] / length;
        }
        by_state[2] = -1.0;
        length - x[2]
    }
}

const TRUTH: [f64; 3] = [3.0, -1.0, 2.0];

fn points(count: usize, sigma: f64, seed: u64) -> Vec<OnCircle> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|i| {
            let angle = std::f64::consts::TAU * (i as f64 * 0.618_033_988_75).fract();
            let mut noise = || sigma * random.sample::<f64, _>(StandardNormal);
            let point =
                [TRUTH[0] + TRUTH[2] * angle.cos() + noise(), TRUTH[1] + TRUTH[2] * angle.sin() + noise()];
            OnCircle { point, sigma }
        })
        .collect()
}

fn start() -> DVector<f64> {
    DVector::from_column_slice(&[2.7, -0.8, 2.2])
}

#[test]
fn the_mean_of_a_distance_equals_that_of_the_rice_distribution() {
    // E|z| − R for z at distance R from the centre: σ √(π/2) L½(−R²/2σ²) − R; values by SciPy.
    for (ratio, mean) in [(2.5, 0.211_201_5), (3.0, 0.172_577_3), (5.0, 0.101_069_6)] {
        let reading = OnCircle { point: [0.0, ratio], sigma: 1.0 };
        let x = [0.0, 0.0, ratio];
        let mut at = Normalized::new();
        let mut u = [0.0; 2];
        assert!(signed_distance(&reading, 0, &x, &[0.0; 2], &mut u, &mut at));
        // A reading outside has g > 0, and s = −g/|g_u|.
        let mut row_bias = [0.0; 3];
        let bias = -curvature_bias(&reading, 0, &x, &u, &at, &mut row_bias);
        assert!((bias - mean).abs() < 2e-3 * mean, "{bias} for {mean}");
    }
}

#[test]
fn a_foot_point_is_the_nearest_point_from_inside_and_outside() {
    for point in [[7.0, -1.0], [3.3, -1.4]] {
        let reading = OnCircle { point, sigma: 0.5 };
        let mut at = Normalized::new();
        let mut u = [0.0; 2];
        assert!(signed_distance(&reading, 0, &TRUTH, &[0.0; 2], &mut u, &mut at));
        let radial = (point[0] - TRUTH[0]).hypot(point[1] - TRUTH[1]) - TRUTH[2];
        assert!((at.distance + radial / 0.5).abs() < 1e-5);
        assert!((u[0].hypot(u[1]) - radial.abs() / 0.5).abs() < 1e-5);
    }
}

/// A point near the unit circle with much larger noise along x than along y, beyond the radius of curvature
/// in standard deviations.
struct Uneven {
    point: [f64; 2],
}

const UNEVEN: [f64; 2] = [0.6, 0.02];

impl ImplicitReading for Uneven {
    fn state(&self) -> usize {
        1
    }

    fn noise(&self) -> usize {
        2
    }

    fn gradient(&self, _: usize, x: &[f64], u: &[f64], by_state: &mut [f64], by_noise: &mut [f64]) -> f64 {
        let d = [0, 1].map(|k| self.point[k] - UNEVEN[k] * u[k]);
        let length = d[0].hypot(d[1]);
        by_state[0] = -1.0;
        for k in 0..2 {
            by_noise[k] = -UNEVEN[k] * d[k] / length;
        }
        length - x[0]
    }
}

#[test]
fn foot_points_beyond_the_radius_of_curvature_are_found() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut repelled = 0;
    for _ in 0..300 {
        let point = [random.random_range(-1.5..1.5), random.random_range(-1.1..1.1)];
        let reading = Uneven { point };
        let (mut u, mut at) = ([0.0; 2], Normalized::new());
        assert!(signed_distance(&reading, 0, &[1.0], &[0.0; 2], &mut u, &mut at), "{point:?}");
        let squared = |angle: f64| {
            let foot = [angle.cos(), angle.sin()];
            (0..2).map(|k| ((point[k] - foot[k]) / UNEVEN[k]).powi(2)).sum::<f64>()
        };
        let found = u.iter().map(|u| u * u).sum::<f64>();
        let angle = (point[1] - UNEVEN[1] * u[1]).atan2(point[0] - UNEVEN[0] * u[0]);
        // The foot point lies on the circle, no neighbour is closer, and the distance is correct.
        assert!((found - squared(angle)).abs() < 1e-4 * (1.0 + found), "{point:?}: {u:?}");
        assert!((found.sqrt() - at.distance.abs()).abs() < 1e-2 * (1.0 + found.sqrt()), "{point:?}");
        for step in [-0.01, 0.01] {
            assert!(found < squared(angle + step) + 1e-2 * (1.0 + found), "{point:?}: {u:?}");
        }
        let is_outside = point[0].hypot(point[1]) > 1.0;
        if is_outside {
            let minimum = (0..20_000).map(|k| squared(std::f64::consts::TAU * f64::from(k) / 20_000.0));
            let minimum = minimum.fold(f64::INFINITY, f64::min);
            assert!((found - minimum).abs() < 1e-2 * (1.0 + minimum), "{point:?}: {found}, {minimum}");
        }
        repelled += usize::from(found.sqrt() * (UNEVEN[0] * angle.sin()).powi(2) > UNEVEN[1]);
    }
    assert!(repelled > 50, "{repelled}");
}

#[test]
fn the_batch_equals_least_squares() {
    let readings = points(40, 0.1, 3);
    let options = ImplicitOptions { correct_bias: false, step_tolerance: 1e-9, ..ImplicitOptions::default() };
    let fit = fit_implicit(&readings, None, &start(), &options).expect("a fit");
    let dimensions = Dimensions { state: 3, noise: 2, equations: 1 };
    let equations: Vec<_> = readings
        .iter()
        .map(|reading| {
            Implicit::new(dimensions, move |x, v, out| {
                let (mut h, mut d) = ([0.0; 3], [0.0; 2]);
                let u = [v[0] / 0.1, v[1] / 0.1];
                out.misclosure[0] = reading.gradient(0, x.as_slice(), &u, &mut h, &mut d);
                for k in 0..3 {
                    out.state_jacobian[(0, k)] = h[k];
                }
                for k in 0..2 {
                    out.noise_jacobian[(0, k)] = d[k] / 0.1;
                }
            })
        })
        .collect();
    let measurements: Vec<_> =
        equations.iter().map(|e| Measurement::new(e, DMatrix::identity(2, 2) * 0.01)).collect();
    let reference =
        least_squares(&measurements, &Information::zero(3), &start(), &LeastSquaresOptions::default())
            .expect("a reference");
    assert!((&fit.state - &reference.state).amax() < 1e-7);
    assert!((fit.loss - reference.loss).abs() < 1e-8);
    let covariance = fit.covariance.expect("determined");
    assert!((covariance - reference.covariance.expect("determined")).amax() < 1e-7);
}

#[test]
fn correction_removes_the_essential_bias_of_the_radius() {
    // σ²/2R = 0.01 for σ = 0.2, R = 2: 100 runs of 100 readings determine it to 0.0004.
    let (runs, sigma) = (100, 0.2);
    let mut radius = [0.0; 2];
    let mut nees = ChiSquareMean::new(3.0).expect("degrees");
    for run in 0..runs {
        let readings = points(100, sigma, run);
        for (k, correct_bias) in [false, true].into_iter().enumerate() {
            let options = ImplicitOptions { correct_bias, ..ImplicitOptions::default() };
            let fit = fit_implicit(&readings, None, &start(), &options).expect("a fit");
            radius[k] += (fit.state[2] - TRUTH[2]) / runs as f64;
            if correct_bias {
                let off = fit.state - DVector::from_column_slice(&TRUTH);
                let value = normalized_squared(&off, &fit.covariance.expect("determined")).expect("a value");
                nees.add(value).expect("finite");
            }
        }
    }
    let essential = sigma * sigma / (2.0 * TRUTH[2]);
    assert!((radius[0] - essential).abs() < 0.005, "{radius:?}");
    assert!(radius[1].abs() < 0.005, "{radius:?}");
    assert!(nees.is_consistent(0.999).expect("a band"), "{}", nees.reduced());
}

#[test]
fn the_noise_updated_filter_agrees_with_the_batch() {
    let readings = points(400, 0.15, 11);
    let batch = fit_implicit(&readings, None, &start(), &ImplicitOptions::default()).expect("a fit");
    let first = fit_implicit(&readings[..20], None, &start(), &ImplicitOptions::default()).expect("a fit");
    let mut filter = KalmanFilter::new(first.state, first.covariance.expect("determined")).expect("a filter");
    for reading in &readings[20..] {
        filter.update_implicit(reading, &ImplicitUpdate::noise_updated()).expect("an update");
    }
    let covariance = batch.covariance.expect("determined");
    let off = filter.mean() - &batch.state;
    // They differ by the remaining linearisation error, a small fraction of a standard deviation.
    assert!(normalized_squared(&off, &covariance).expect("a value") < 0.1);
    assert!((filter.covariance() - &covariance).amax() < 0.05 * covariance.amax());
}

#[test]
fn a_gated_reading_does_not_change_the_filter() {
    let mut filter = KalmanFilter::new(DVector::from_column_slice(&TRUTH), DMatrix::identity(3, 3) * 1e-4)
        .expect("a filter");
    let before = filter.clone();
    let outlier = OnCircle { point: [9.0, 9.0], sigma: 0.1 };
    let options = ImplicitUpdate { gate: Some(4.0), ..ImplicitUpdate::noise_updated() };
    let innovation = filter.update_implicit(&outlier, &options).expect("an update");
    assert!(!innovation.accepted && innovation.normalized_squared > 16.0);
    assert_eq!(filter, before);
}

#[test]
fn a_loss_bounds_the_influence_of_outliers() {
    let mut readings = points(200, 0.05, 5);
    for k in 0..20 {
        readings[10 * k].point[0] += 1.5;
    }
    let options = ImplicitOptions { loss: Loss::tukey(), ..ImplicitOptions::default() };
    let fit = fit_implicit(&readings, None, &start(), &options).expect("a fit");
    let off = &fit.state - DVector::from_column_slice(&TRUTH);
    assert!(off.amax() < 0.03, "{off}");
    assert!((0..20).filter(|k| fit.weights[10 * k] == 0.0).count() >= 18);
}

/// A point near a circle; shared noise shifts all points of its group along x.
struct Shifted(OnCircle);

impl ImplicitReading for Shifted {
    fn state(&self) -> usize {
        4
    }

    fn noise(&self) -> usize {
        2
    }

    fn gradient(&self, _: usize, x: &[f64], u: &[f64], by_state: &mut [f64], by_noise: &mut [f64]) -> f64 {
        let shared = 0.3 * x[3];
        let moved = [x[0] + shared, x[1], x[2]];
        let g = self.0.gradient(0, &moved, u, &mut by_state[..3], by_noise);
        by_state[3] = 0.3 * by_state[0];
        g
    }
}

#[test]
fn shared_noise_is_one_unknown_of_its_group() {
    // Groups are shifted along x with σ = 0.3. So σ of the centre is 0.3/√groups for any number of readings.
    let mut nees = ChiSquareMean::new(3.0).expect("degrees");
    let mut random = ChaCha8Rng::seed_from_u64(2);
    for run in 0..60 {
        let mut readings: Vec<Shifted> = points(80, 0.05, 1000 + run).into_iter().map(Shifted).collect();
        let groups: Vec<usize> = (0..80).map(|i| i / 20).collect();
        let shifts: Vec<f64> = (0..4).map(|_| 0.3 * random.sample::<f64, _>(StandardNormal)).collect();
        for (reading, &group) in readings.iter_mut().zip(&groups) {
            reading.0.point[0] += shifts[group];
        }
        let shared = SharedNoise { size: 1, groups: &groups };
        let fit =
            fit_implicit(&readings, Some(shared), &start(), &ImplicitOptions::default()).expect("a fit");
        let covariance = fit.covariance.expect("determined");
        assert!((covariance[(0, 0)].sqrt() / 0.15 - 1.0).abs() < 0.1);
        let off = fit.state - DVector::from_column_slice(&TRUTH);
        nees.add(normalized_squared(&off, &covariance).expect("a value")).expect("finite");
    }
    assert!(nees.is_consistent(0.999).expect("a band"), "{}", nees.reduced());
}
