use super::*;
use crate::dense::ScaledCholesky;
use crate::test_support::{Gaussian, dmatrix};
use crate::{ErrorKind, Information};
use nalgebra::DVector;

/// Noisy values on a grid with penalised second differences: a discrete smoothing spline.
struct Smoothing {
    design: DMatrix<f64>,
    weight: DMatrix<f64>,
    reading: DVector<f64>,
    penalty: DMatrix<f64>,
    information: Information,
}

fn smoothing(seed: u64, sigma: f64, stated: f64) -> Smoothing {
    let mut random = Gaussian::seeded(seed);
    let (unknowns, readings) = (16, 50);
    let truth = DVector::from_fn(unknowns, |i, _| (0.5 * i as f64).sin() + 0.1 * i as f64);
    let design = DMatrix::from_fn(readings, unknowns, |i, j| {
        let at = (unknowns - 1) as f64 * i as f64 / (readings - 1) as f64;
        (1.0 - (at - j as f64).abs()).max(0.0)
    });
    let reading = &design * truth + random.vector(readings) * sigma;
    let weight = DMatrix::identity(readings, readings) / (stated * stated);
    let differences = DMatrix::from_fn(unknowns - 2, unknowns, |i, j| match j.wrapping_sub(i) {
        0 | 2 => 1.0,
        1 => -2.0,
        _ => 0.0,
    });
    let penalty = differences.transpose() * differences;
    let information = Information::from_rows(&design, &weight, &reading).unwrap();
    Smoothing { design, weight, reading, penalty, information }
}

impl Smoothing {
    fn model(&self, dispersion: Dispersion) -> SmoothnessModel {
        let (rank, log_pseudo_determinant) = log_pseudo_determinant(&self.penalty, 1e-10).unwrap();
        SmoothnessModel { rank, unknowns: 16, equations: 50, log_pseudo_determinant, dispersion }
    }

    fn evaluate(&self, weight: f64) -> Result<SmoothnessEvaluation> {
        let factor = ScaledCholesky::new(&(&self.information.matrix + &self.penalty * weight))
            .map_err(|null| null.into_error("the surface"))?;
        let state = factor.solve(&self.information.vector);
        let residual = &self.reading - &self.design * &state;
        Ok(SmoothnessEvaluation {
            log_determinant: factor.ln_determinant(),
            residual: residual.dot(&(&self.weight * &residual)),
            roughness: state.dot(&(&self.penalty * &state)),
            trace: Some(factor.inverse().dot(&self.penalty)),
        })
    }

    /// Density of contrasts orthogonal to the null space, with their full covariance. It shares no code with
    /// the implementation.
    fn brute_force(&self, weight: f64, dispersion: Dispersion) -> f64 {
        let eigen = self.penalty.clone().symmetric_eigen();
        let inverted = eigen.eigenvalues.map(|value| if value > 1e-9 { 1.0 / value } else { 0.0 });
        let prior =
            &eigen.eigenvectors * DMatrix::from_diagonal(&inverted) * eigen.eigenvectors.transpose() / weight;
        let line = DMatrix::from_fn(16, 2, |i, j| if j == 0 { 1.0 } else { i as f64 });
        let fixed = (&self.design * line).qr().q();
        // An orthonormal basis of the complement of the fixed part.
        let projector = DMatrix::identity(50, 50) - &fixed * fixed.transpose();
        let basis = projector.symmetric_eigen();
        let columns: Vec<_> = (0..50)
            .filter(|&i| basis.eigenvalues[i] > 0.5)
            .map(|i| basis.eigenvectors.column(i).into_owned())
            .collect();
        let contrasts = DMatrix::from_columns(&columns);
        let noise = self.weight.clone().try_inverse().unwrap();
        let covariance =
            contrasts.transpose() * (noise + &self.design * prior * self.design.transpose()) * &contrasts;
        let factor = covariance.cholesky().unwrap();
        let reading = contrasts.transpose() * &self.reading;
        let squared = reading.dot(&factor.solve(&reading));
        let n = 48.0;
        let scale = match dispersion {
            Dispersion::Known(scale) => scale,
            Dispersion::Estimated => squared / n,
        };
        -0.5 * (factor.ln_determinant() + n * (std::f64::consts::TAU * scale).ln() + squared / scale)
    }
}

#[test]
fn likelihood_equals_that_of_the_contrasts_up_to_a_constant() {
    let problem = smoothing(71, 0.2, 0.3);
    for dispersion in [Dispersion::Known(1.0), Dispersion::Known(2.5), Dispersion::Estimated] {
        let model = problem.model(dispersion);
        assert_eq!(model.rank, 14);
        let difference = |weight: f64| {
            let fast = model.log_likelihood(weight, &problem.evaluate(weight).unwrap());
            fast - problem.brute_force(weight, dispersion)
        };
        let expected = difference(1.0);
        for weight in [1e-3, 0.1, 7.0, 300.0] {
            assert!((difference(weight) - expected).abs() < 1e-8, "{dispersion:?} {weight}");
        }
    }
}

#[test]
fn search_and_fixed_point_find_the_same_weight_as_a_fine_grid() {
    for (dispersion, stated) in [(Dispersion::Known(1.0), 0.2), (Dispersion::Estimated, 0.05)] {
        let problem = smoothing(72, 0.2, stated);
        let model = problem.model(dispersion);
        let likelihood = |log: f64| model.log_likelihood(log.exp(), &problem.evaluate(log.exp()).unwrap());
        let grid = (-8000..8000)
            .map(|i| 1e-3 * f64::from(i))
            .max_by(|a, b| likelihood(*a).total_cmp(&likelihood(*b)));
        let grid = grid.unwrap();
        for start in [1e-4, 1.0, 1e4] {
            let search = SmoothnessSearch {
                tolerance: 1e-4,
                max_evaluations: 500,
                ..SmoothnessSearch::from_start(start)
            };
            let by_search = maximize_restricted_likelihood(&model, &search, |w| problem.evaluate(w)).unwrap();
            let by_update = fellner_schall(&model, &search, |w| problem.evaluate(w)).unwrap();
            for found in [by_search, by_update] {
                assert_eq!(found.termination, Termination::Converged);
                assert!((found.weight.ln() - grid).abs() < 3e-3, "{found:?} {grid}");
                assert!(!found.at_bound);
            }
            assert!(by_search.evaluations <= 25, "{}", by_search.evaluations);
        }
    }
}

#[test]
fn a_start_near_the_optimum_needs_few_solutions() {
    let problem = smoothing(73, 0.2, 0.2);
    let model = problem.model(Dispersion::Known(1.0));
    let best =
        maximize_restricted_likelihood(&model, &SmoothnessSearch::from_start(1.0), |w| problem.evaluate(w))
            .unwrap();
    let near = SmoothnessSearch { tolerance: 0.05, ..SmoothnessSearch::from_start(3.0 * best.weight) };
    let again = maximize_restricted_likelihood(&model, &near, |w| problem.evaluate(w)).unwrap();
    assert!(again.evaluations <= 10, "{}", again.evaluations);
    assert!((again.weight / best.weight).ln().abs() < 0.1);
}

#[test]
fn estimated_dispersion_recovers_a_wrongly_stated_sigma() {
    let mut ratio = 0.0;
    let runs = 60;
    for seed in 0..runs {
        let problem = smoothing(100 + seed, 0.2, 0.05);
        let model = problem.model(Dispersion::Estimated);
        let found = maximize_restricted_likelihood(&model, &SmoothnessSearch::from_start(1.0), |w| {
            problem.evaluate(w)
        });
        ratio += found.unwrap().dispersion.sqrt() / runs as f64;
    }
    assert!((ratio / 4.0 - 1.0).abs() < 0.05, "{ratio}");
}

#[test]
fn data_without_roughness_send_the_weight_to_its_bound() {
    let mut problem = smoothing(74, 0.0, 0.2);
    problem.reading = &problem.design * DVector::from_fn(16, |i, _| 1.0 + 0.25 * i as f64);
    problem.information = Information::from_rows(&problem.design, &problem.weight, &problem.reading).unwrap();
    let model = problem.model(Dispersion::Known(1.0));
    let search = SmoothnessSearch { bounds: (1e-3, 1e5), ..SmoothnessSearch::from_start(1.0) };
    let found = maximize_restricted_likelihood(&model, &search, |w| problem.evaluate(w)).unwrap();
    assert!(found.at_bound && found.weight > 9e4, "{found:?}");
    let found = fellner_schall(&model, &search, |w| problem.evaluate(w)).unwrap();
    assert!(found.at_bound && found.weight > 9e4, "{found:?}");
}

#[test]
fn a_maximum_next_to_a_bound_and_a_start_on_it_are_found() {
    let problem = smoothing(72, 0.2, 0.2);
    let model = problem.model(Dispersion::Known(1.0));
    let free = SmoothnessSearch { tolerance: 1e-4, ..SmoothnessSearch::from_start(1.0) };
    let best = maximize_restricted_likelihood(&model, &free, |w| problem.evaluate(w)).unwrap().weight;
    for (start, bounds) in [(0.01 * best, (0.01 * best, 1.1 * best)), (1.1 * best, (0.01 * best, 1.1 * best))]
    {
        let tight = SmoothnessSearch { start, bounds, ..free };
        let found = maximize_restricted_likelihood(&model, &tight, |w| problem.evaluate(w)).unwrap();
        assert!((found.weight / best).ln().abs() < 1e-3 && !found.at_bound, "{found:?} {best}");
    }
}

#[test]
fn pseudo_determinant_excludes_only_the_null_space() {
    let (rank, log) =
        log_pseudo_determinant(&dmatrix![2.0, -2.0, 0.0; -2.0, 2.0, 0.0; 0.0, 0.0, 1e-12], 1e-10).unwrap();
    assert_eq!(rank, 2);
    assert!((log - (4.0_f64.ln() + 1e-12_f64.ln())).abs() < 1e-3, "{log}");
    assert_eq!(log_pseudo_determinant(&DMatrix::zeros(2, 2), 1e-10).unwrap(), (0, 0.0));
}

#[test]
fn invalid_models_and_searches_are_rejected() {
    let problem = smoothing(75, 0.2, 0.2);
    let search = SmoothnessSearch::from_start(1.0);
    let good = problem.model(Dispersion::Known(1.0));
    let models = [
        SmoothnessModel { rank: 0, ..good },
        SmoothnessModel { rank: 17, ..good },
        SmoothnessModel { equations: 2, ..good },
        SmoothnessModel { dispersion: Dispersion::Known(0.0), ..good },
    ];
    for model in models {
        let refused = maximize_restricted_likelihood(&model, &search, |w| problem.evaluate(w));
        assert_eq!(refused.unwrap_err().kind(), ErrorKind::Input);
    }
    let backwards = SmoothnessSearch { bounds: (2.0, 3.0), ..search };
    assert!(maximize_restricted_likelihood(&good, &backwards, |w| problem.evaluate(w)).is_err());
    let traceless = |w| problem.evaluate(w).map(|e| SmoothnessEvaluation { trace: None, ..e });
    assert_eq!(fellner_schall(&good, &search, traceless).unwrap_err().kind(), ErrorKind::Input);
}
