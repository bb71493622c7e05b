//! Clouds without grid, normals and viewpoint, with isolated points, duplicates and misstated σ.

use crate::common;
use planish_core::DVec3;

use planish::fit::{Fit, FitOptions, UpdateOptions, fit, update};
use planish::progress::Silent;
use planish_exchange::ScanSet;
use planish_spline::{FootPointSearch, ProjectionOptions, Shape};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SIGMA: f64 = 0.003;

fn height(x: f64, y: f64) -> f64 {
    0.2 * (4.0 * x).sin() * (3.0 * y).cos()
}

/// Noisy points of a wavy sheet over the unit square.
fn sheet(count: usize, seed: u64) -> Vec<DVec3> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let (x, y): (f64, f64) = (rng.random(), rng.random());
            let mut noise = || SIGMA * Distribution::<f64>::sample(&StandardNormal, &mut rng);
            DVec3::new(x + noise(), y + noise(), height(x, y) + noise())
        })
        .collect()
}

fn set_of(points: Vec<DVec3>, sigma: Option<f64>) -> ScanSet {
    common::probed(points, None, sigma)
}

fn run(set: &ScanSet) -> Fit {
    fit(set, &FitOptions::default(), &Silent).unwrap()
}

fn run_with_estimated_sigma(set: &ScanSet) -> Fit {
    fit(set, &FitOptions { estimate_sigma: true, ..FitOptions::default() }, &Silent).unwrap()
}

/// Share of the places of the true sheet that lie within 1.96 σ of the surface.
fn coverage(fit: &Fit) -> f64 {
    let surface = &fit.model.surface;
    let search = FootPointSearch::new(surface, 2, 0.0).unwrap();
    let posterior = fit.posterior();
    let mut rng = ChaCha8Rng::seed_from_u64(78);
    let count = 1000;
    let covered = (0..count)
        .filter(|_| {
            let [x, y] = [0, 1].map(|_| rng.random_range(0.05..0.95));
            let p = DVec3::new(x, y, height(x, y));
            let foot = surface.project(p, search.nearest(p, DVec3::ZERO), &ProjectionOptions::default());
            let leaf = posterior.leaf(foot.leaf as usize).unwrap();
            let sigma = planish_surface::model::Posterior::sigma_along(&leaf, foot.local, foot.normal);
            foot.height.abs() < 1.96 * sigma
        })
        .count();
    covered as f64 / f64::from(count)
}

/// Root mean square distance of the true sheet from the surface.
fn error(fit: &Fit) -> f64 {
    let surface = &fit.model.surface;
    assert_eq!(surface.space().shape(), Some(Shape::Sheet));
    let search = FootPointSearch::new(surface, 2, 0.0).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(77);
    let count = 2000;
    let square: f64 = (0..count)
        .map(|_| {
            let [x, y] = [0, 1].map(|_| rng.random_range(0.05..0.95));
            let p = DVec3::new(x, y, height(x, y));
            let foot = surface.project(p, search.nearest(p, DVec3::ZERO), &ProjectionOptions::default());
            foot.height * foot.height + foot.slip * foot.slip
        })
        .sum();
    (square / f64::from(count)).sqrt()
}

#[test]
fn dust_has_little_influence() {
    let clean = error(&run(&set_of(sheet(5000, 1), None)));
    assert!(clean < 0.3 * SIGMA, "{clean}");
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for (what, count, extent) in
        [("one far point", 1, 100.0), ("dust all about", 250, 2.0), ("dust far about", 250, 20.0)]
    {
        let mut points = sheet(5000, 1);
        points
            .extend((0..count).map(|_| DVec3::from_array([0; 3].map(|_| rng.random_range(-extent..extent)))));
        let found = error(&run(&set_of(points, None)));
        println!("{what}: {found:.6} instead of {clean:.6}");
        assert!(found < 1.3 * clean, "{what}: {found} instead of {clean}");
    }
}

#[test]
fn a_sigma_wrong_by_a_factor_of_a_thousand_is_detected() {
    let clean = error(&run(&set_of(sheet(5000, 3), None)));
    for factor in [1e-3, 0.01, 10.0, 100.0, 1e3] {
        let fit = run_with_estimated_sigma(&set_of(sheet(5000, 3), Some(factor * SIGMA)));
        let (found, sensor) = (error(&fit), &fit.report.sensors[0]);
        assert!(sensor.sigma_used_is_estimated, "{factor}");
        assert!((sensor.sigma_estimated / SIGMA - 1.0).abs() < 0.1, "{factor}: {}", sensor.sigma_estimated);
        assert!(found < 1.4 * clean, "{factor}: {found} instead of {clean}");
    }
}

/// Smoothed points agree with each other far better than with the truth, as their σ says.
#[test]
fn points_with_shared_errors_keep_their_sigma() {
    for seed in 0..4 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // A random field of variance σ² with a wavelength of about a fifth of the sheet, as smoothing leaves.
        let waves: Vec<[f64; 3]> = (0..200)
            .map(|_| {
                let k = [0, 1].map(|_| 30.0 * Distribution::<f64>::sample(&StandardNormal, &mut rng));
                [k[0], k[1], std::f64::consts::TAU * rng.random::<f64>()]
            })
            .collect();
        let amplitude = SIGMA * (2.0 / waves.len() as f64).sqrt();
        let shared = |x: f64, y: f64| {
            amplitude * waves.iter().map(|[u, v, phase]| (u * x + v * y + phase).cos()).sum::<f64>()
        };
        let points = (0..8000)
            .map(|_| {
                let (x, y): (f64, f64) = (rng.random(), rng.random());
                DVec3::new(x, y, height(x, y) + shared(x, y))
            })
            .collect();
        let fit = run(&set_of(points, Some(SIGMA)));
        let sensor = &fit.report.sensors[0];
        assert!(!sensor.sigma_used_is_estimated && sensor.sigma_shared.is_some(), "{sensor:?}");
        let code = planish::FindingCode::SharedErrors;
        assert!(fit.report.findings.iter().any(|f| f.code == code), "{:?}", fit.report.findings);
        let covered = coverage(&fit);
        println!("seed {seed}: covered {covered}, median σ {:.5}", fit.report.sigma.median);
        assert!(covered > 0.9, "seed {seed}: covered {covered}");
        assert!(fit.report.sigma.median < 1.3 * SIGMA, "seed {seed}: {}", fit.report.sigma.median);
    }
}

#[test]
fn a_sigma_stated_too_large_is_kept_with_a_finding() {
    let fit = run(&set_of(sheet(5000, 3), Some(1.3 * SIGMA)));
    let sensor = &fit.report.sensors[0];
    assert!(!sensor.sigma_used_is_estimated && sensor.sigma_shared.is_none(), "{sensor:?}");
    let code = planish::FindingCode::SensorSigmaCautious;
    assert!(fit.report.findings.iter().any(|f| f.code == code), "{:?}", fit.report.findings);
    assert!(coverage(&fit) > 0.95);
}

#[test]
fn a_point_written_five_times_is_one_reading() {
    let once = run(&set_of(sheet(2000, 4), None));
    let points = (0..5).flat_map(|_| sheet(2000, 4)).collect();
    let fit = run(&set_of(points, None));
    assert_eq!(fit.report.rejected["duplicate"], 8000);
    assert!(
        (fit.report.sensors[0].sigma_estimated / once.report.sensors[0].sigma_estimated - 1.0).abs() < 0.05
    );
}

#[test]
fn normals_of_zero_are_unknown_normals() {
    let mut set = set_of(sheet(3000, 5), None);
    let without = error(&run(&set));
    set.scans[0].scan.normals = Some(vec![DVec3::ZERO; 3000]);
    assert!((error(&run(&set)) / without - 1.0).abs() < 0.05);
}

#[test]
fn clouds_without_orientation_are_added_for_either_assumed_side() {
    for seed in 10..18 {
        let points = sheet(4000, seed);
        let first = run(&set_of(points[..2000].to_vec(), None));
        let second = set_of(points[2000..].to_vec(), None);
        let both = update(&first.model, &second, &UpdateOptions::default(), &Silent).unwrap();
        assert!(both.report.observations > 1700, "seed {seed}: {:?}", both.report.rejected);
        assert!(error(&both) < error(&first), "seed {seed}");
    }
}

#[test]
fn few_known_readings_do_not_determine_their_own_noise() {
    let points = sheet(4000, 11);
    let first = run(&set_of(points.clone(), Some(SIGMA)));
    let again = points.into_iter().step_by(400).collect();
    let both = update(&first.model, &set_of(again, None), &UpdateOptions::default(), &Silent).unwrap();
    let sensor = &both.report.sensors[0];
    assert!(sensor.sigma_used_is_estimated);
    // Ten readings that the surface followed would leave next to nothing, and count without end.
    assert!(sensor.sigma_estimated > 0.3 * SIGMA, "{sensor:?}");
    assert!(error(&both) < 2.0 * error(&first));
}

#[test]
fn the_limit_of_coefficients_is_respected() {
    let set = set_of(sheet(3000, 6), None);
    for max_coefficients in [25, 40, 100, 150] {
        let options = FitOptions { max_coefficients, ..FitOptions::default() };
        let made = fit(&set, &options, &Silent).unwrap();
        assert!(
            made.report.coefficients <= max_coefficients,
            "{} of {max_coefficients}",
            made.report.coefficients
        );
    }
    let options = FitOptions { max_coefficients: 20, ..FitOptions::default() };
    assert!(fit(&set, &options, &Silent).is_err());
}

/// A map's coordinates: seven digits before the point must not cost the last ones behind it.
#[test]
fn a_fit_far_from_the_origin_equals_one_near_it_and_can_be_updated() {
    let far = DVec3::new(6.5e5, 4.25e6, -1024.0);
    let moved = |points: &[DVec3]| -> Vec<DVec3> {
        let moved = points.iter().map(|p| p + far);
        moved.collect()
    };
    // Both clouds rounded alike, so that only the place differs.
    let rounded = |points: Vec<DVec3>| -> Vec<DVec3> {
        let digits = 2.0_f64.powi(-30);
        points.iter().map(|p| p.map(|c| (c / digits).round() * digits)).collect()
    };
    let (first, second) = (rounded(sheet(4000, 5)), rounded(sheet(3000, 6)));
    let near = run(&set_of(first.clone(), Some(SIGMA)));
    let away = run(&set_of(moved(&first), Some(SIGMA)));
    let add = |fit: &Fit, points| {
        update(&fit.model, &set_of(points, Some(SIGMA)), &UpdateOptions::default(), &Silent).unwrap()
    };
    let near_both = add(&near, second.clone());
    let away_both = add(&away, moved(&second));
    for (near, away) in [(&near, &away), (&near_both, &away_both)] {
        assert_eq!(near.report.observations, away.report.observations);
        assert_eq!(near.report.coefficients, away.report.coefficients);
        assert!((near.report.sigma.median / away.report.sigma.median - 1.0).abs() < 1e-6);
        for (p, q) in near.model.surface.vertices().iter().zip(away.model.surface.vertices()) {
            for d in 0..3 {
                assert!((p[d] + far[d] - q[d]).abs() < 1e-6, "{p:?} {q:?}");
            }
        }
    }
}

/// Ground whose mesh faces down is dark in every viewer, and half of its readings would lie on the other
/// side.
#[test]
fn a_sheet_of_points_without_orientation_faces_up() {
    let options = FitOptions { shape: Some(Shape::Sheet), ..FitOptions::default() };
    for turned in [false, true] {
        let points = sheet(3000, 8)
            .into_iter()
            .map(|DVec3 { x, y, z }| if turned { DVec3::new(x, -y, -z) } else { DVec3::new(x, y, z) });
        let fit = fit(&set_of(points.collect(), Some(SIGMA)), &options, &Silent).unwrap();
        let [u, v] = fit.model.surface.space().extent().map(|e| 0.5 * e);
        assert!(fit.model.surface.normal(u, v).unwrap()[2] > 0.5);
        assert!(!fit.report.rejected.contains_key("normal_mismatch"));
    }
}
