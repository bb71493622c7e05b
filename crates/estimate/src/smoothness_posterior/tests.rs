use super::*;
use crate::test_support::Gaussian;

/// A polygon of 30 values with second differences as penalty, read at `n` places.
struct Problem {
    rows: DMatrix<f64>,
    penalty: DMatrix<f64>,
    truth: DVector<f64>,
}

const SIZE: usize = 30;

impl Problem {
    /// A walk whose second differences have the standard deviation `bend`.
    fn random(random: &mut Gaussian, n: usize, bend: f64) -> Self {
        let differences = DMatrix::from_fn(SIZE - 2, SIZE, |i, j| match j.wrapping_sub(i) {
            0 | 2 => 1.0,
            1 => -2.0,
            _ => 0.0,
        });
        let mut truth = DVector::zeros(SIZE);
        let (mut at, mut slope) = (random.number(), 0.3 * random.number());
        for value in truth.iter_mut() {
            *value = at;
            at += slope;
            slope += bend * random.number();
        }
        let places: Vec<usize> = (0..n).map(|i| i * (SIZE - 1) / (n - 1)).collect();
        let rows = DMatrix::from_fn(n, SIZE, |i, j| if places[i] == j { 1.0 } else { 0.0 });
        Self { rows, penalty: differences.tr_mul(&differences), truth }
    }

    fn posterior(&self, values: &DVector<f64>, dispersion: Dispersion) -> SmoothnessPosterior {
        let readings = PenalizedReadings {
            rows: &self.rows,
            values,
            penalty: &self.penalty,
            null: 2,
            typical_weight: 1.0,
        };
        SmoothnessPosterior::new(&readings, dispersion).unwrap()
    }
}

/// Share of the truths within 95 % intervals over `draws` problems.
fn coverage(n: usize, bend: f64, sigma: f64, dispersion: Dispersion, draws: usize) -> f64 {
    let mut random = Gaussian::seeded(7);
    let (mut inside, mut all) = (0, 0);
    for _ in 0..draws {
        let problem = Problem::random(&mut random, n, bend);
        let values = &problem.rows * &problem.truth + DVector::from_fn(n, |_, _| sigma * random.number());
        let posterior = problem.posterior(&values, dispersion);
        for k in 0..SIZE {
            let mut q = DVector::zeros(SIZE);
            q[k] = 1.0;
            let off = posterior.mean()[k] - problem.truth[k];
            inside += usize::from(off.abs() < NORMAL_95 * posterior.variance(&q).sqrt());
            all += 1;
        }
    }
    inside as f64 / all as f64
}

#[test]
fn intervals_hold_whatever_the_noise_and_the_number_of_readings() {
    for n in [8, 12, 30] {
        for (bend, sigma) in [(0.1, 1.0), (0.3, 0.3), (0.3, 1e-6)] {
            let found = coverage(n, bend, sigma, Dispersion::Estimated, 60);
            assert!(found > 0.88, "{n} readings, bend {bend}, sigma {sigma}: covered {found}");
        }
        let found = coverage(n, 0.3, 1.0, Dispersion::Known(1.0), 60);
        assert!((0.92..0.985).contains(&found), "{n} readings, known sigma: covered {found}");
    }
}

#[test]
fn exact_readings_of_a_straight_line_are_followed_exactly() {
    let mut random = Gaussian::seeded(1);
    let problem = Problem::random(&mut random, 10, 0.0);
    let posterior = problem.posterior(&(&problem.rows * &problem.truth), Dispersion::Estimated);
    let mut q = DVector::zeros(SIZE);
    q[SIZE / 2 + 1] = 1.0;
    assert!((posterior.mean() - &problem.truth).amax() < 1e-6);
    assert!(posterior.variance(&q).sqrt() < 1e-6 && posterior.dispersion() > 0.0);
}

#[test]
fn open_directions_are_an_error() {
    // Two places do not show where a third one is, and nothing holds it.
    let rows = DMatrix::from_fn(6, 3, |i, j| if i % 2 == j { 1.0 } else { 0.0 });
    let readings = PenalizedReadings {
        rows: &rows,
        values: &DVector::from_element(6, 1.0),
        penalty: &DMatrix::from_diagonal(&DVector::from_vec(vec![0.0, 1.0, 0.0])),
        null: 2,
        typical_weight: 1.0,
    };
    assert!(SmoothnessPosterior::new(&readings, Dispersion::Estimated).is_err());
}
