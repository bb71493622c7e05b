use super::*;
use crate::fit::{Strategy, fit};
use nalgebra::{DMatrix, DVector};
use planish_core::Silent;
use planish_core::SymmetricMatrix3;
use planish_estimate::ErrorKind;
use planish_sense::{Noise, Scan, SensorKind};
use planish_spline::PositionSums;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Franke's test function (1979).
fn franke(x: f64, y: f64) -> f64 {
    let (x, y) = (9.0 * x, 9.0 * y);
    0.75 * (-((x - 2.0).powi(2) + (y - 2.0).powi(2)) / 4.0).exp()
        + 0.75 * (-(x + 1.0).powi(2) / 49.0 - (y + 1.0) / 10.0).exp()
        + 0.5 * (-((x - 7.0).powi(2) + (y - 3.0).powi(2)) / 4.0).exp()
        - 0.2 * (-(x - 4.0).powi(2) - (y - 7.0).powi(2)).exp()
}

fn heights(n: usize, sigma: f64, seed: u64) -> Scan {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let parameters: Vec<[f64; 2]> = (0..n).map(|_| [random.random(), random.random()]).collect();
    let points = parameters
        .iter()
        .map(|&[u, v]| {
            let noise: f64 = StandardNormal.sample(&mut random);
            DVec3::new(u, v, franke(u, v) + sigma * noise)
        })
        .collect();
    Scan { name: "heights".to_owned(), points, parameters: Some(parameters), ..Scan::default() }
}

fn set_of(scans: Vec<(Scan, Option<f64>)>) -> ScanSet {
    let sensors = scans
        .iter()
        .enumerate()
        .map(|(s, (_, sigma))| planish_sense::Sensor {
            name: format!("sensor {s}"),
            kind: SensorKind::Touch,
            noise: sigma.map(|sigma| Noise::Isotropic { sigma }),
            ..planish_sense::Sensor::default()
        })
        .collect();
    ScanSet {
        unit: Some(Unit::Millimetre),
        sensors,
        scans: scans
            .into_iter()
            .enumerate()
            .map(|(sensor, (scan, _))| planish_exchange::PosedScan {
                scan,
                sensor,
                sigma_translation: None,
                sigma_rotation_deg: None,
            })
            .collect(),
        ..ScanSet::default()
    }
}

fn options(cells: [usize; 2]) -> FitOptions {
    FitOptions { strategy: Strategy::KnownParameters { cells }, ..FitOptions::default() }
}

/// The textbook's ridge regression on a dense matrix, with the weight and σ that the fit has found.
#[test]
fn vertices_and_sigmas_match_dense_normal_equations() {
    let scan = heights(400, 0.01, 1);
    let set = set_of(vec![(scan.clone(), None)]);
    let options = FitOptions { held_out_share: 0.0, ..options([5, 4]) };
    let fitted = fit(&set, &options, &Silent).unwrap();
    let model = &fitted.model;
    assert_eq!(model.known.measured_coordinates(), Some([false, false, true]));
    let space = model.surface.space();
    let n = space.node_count();
    let system = SurfaceSystem::new(space).unwrap();
    let reference = {
        let mut sums = PositionSums::new(space);
        let at: Vec<[f64; 2]> = scan.parameters.iter().flatten().map(|[u, v]| [5.0 * u, 4.0 * v]).collect();
        sums.add(&at, &scan.points, None).unwrap();
        reference_surface(space, &sums).unwrap()
    };
    let energy = system.thin_plate(&reference).unwrap().to_dense();
    let mut h = DMatrix::zeros(scan.points.len(), n);
    for (k, [u, v]) in scan.parameters.iter().flatten().enumerate() {
        let (leaf, local) = space.locate(5.0 * u, 4.0 * v);
        let b = leaf_weights(local[0], local[1]);
        let (nodes, weights) = space.extraction(leaf);
        for (&node, w) in nodes.iter().zip(weights) {
            h[(k, node as usize)] += (0..16).map(|i| w[i] * b[i]).sum::<f64>();
        }
    }
    let sigma2 = model.sensors[0].sigma_estimated.powi(2);
    let information = h.transpose() * &h / sigma2 + energy * model.smoothness_weight;
    let covariance = information.try_inverse().unwrap();
    for d in 0..3 {
        let z = DVector::from_iterator(scan.points.len(), scan.points.iter().map(|p| p[d]));
        let x = &covariance * (h.transpose() * z) / sigma2;
        for node in 0..n {
            let found = model.surface.vertices()[node][d];
            assert!((found - x[node]).abs() < 1e-7, "vertex {node}, {d}: {found}, {}", x[node]);
        }
    }
    let posteriors = [fitted.posterior(), model.posterior().unwrap()];
    for (leaf, local) in [(0, [0.3, 0.7]), (7, [0.0, 0.5]), (19, [1.0, 1.0])] {
        let b = leaf_weights(local[0], local[1]);
        let (nodes, weights) = space.extraction(leaf);
        let mut row = DVector::zeros(n);
        for (&node, w) in nodes.iter().zip(weights) {
            row[node as usize] = (0..16).map(|i| w[i] * b[i]).sum::<f64>();
        }
        let wanted = (row.transpose() * &covariance * &row)[0];
        for posterior in &posteriors {
            let cell = posterior.leaf(leaf).unwrap();
            assert!((cell.variance_along(&b, DVec3::Z) / wanted - 1.0).abs() < 1e-6);
            // The plan is exact: along a slanted normal only the height counts.
            assert!(
                (cell.variance_along(&b, DVec3::new(0.6, 0.0, 0.8)) / (0.64 * wanted) - 1.0).abs() < 1e-6
            );
        }
    }
}

#[test]
fn sigma_of_the_surface_is_calibrated() {
    let mut squares = Vec::new();
    for seed in 0..4 {
        let fitted =
            fit(&set_of(vec![(heights(20_000, 0.01, seed), None)]), &options([21, 21]), &Silent).unwrap();
        let report = &fitted.report;
        assert!((report.sensors[0].sigma_estimated / 0.01 - 1.0).abs() < 0.02, "{report:?}");
        assert!((report.held_out.rms_normalised - 1.0).abs() < 0.05, "{report:?}");
        assert!(report.rejected.is_empty(), "{:?}", report.rejected);
        let surface = &fitted.model.surface;
        let posterior = fitted.posterior();
        for leaf in 0..surface.space().leaves().len() {
            let p = surface.leaf_point(leaf, 0.5, 0.5);
            let cell = posterior.leaf(leaf).unwrap();
            let sigma = Posterior::sigma_along(&cell, [0.5, 0.5], DVec3::Z);
            squares.push(((p[2] - franke(p[0], p[1])) / sigma).powi(2));
        }
    }
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    let covered = squares.iter().filter(|s| **s <= 1.96 * 1.96).count() as f64 / squares.len() as f64;
    assert!((0.8..1.2).contains(&mean), "mean square of normalised errors {mean}");
    assert!((0.92..0.98).contains(&covered), "coverage {covered}");
}

#[test]
fn gross_errors_are_rejected_and_change_little() {
    let clean = heights(20_000, 0.01, 7);
    let mut dirty = clean.clone();
    for p in dirty.points.iter_mut().step_by(20) {
        p[2] += 3.0;
    }
    let rms = |scan: &Scan| {
        let fitted = fit(&set_of(vec![(scan.clone(), None)]), &options([21, 21]), &Silent).unwrap();
        let surface = &fitted.model.surface;
        let leaves = surface.space().leaves().len();
        let square: f64 = (0..leaves)
            .map(|leaf| {
                let p = surface.leaf_point(leaf, 0.5, 0.5);
                (p[2] - franke(p[0], p[1])).powi(2)
            })
            .sum();
        ((square / leaves as f64).sqrt(), fitted.report)
    };
    let (alone, _) = rms(&clean);
    let (among, report) = rms(&dirty);
    let outliers = report.rejected["outlier"];
    // A tenth of them is held out.
    assert!((880..=1020).contains(&outliers), "{outliers}");
    assert!(among < 1.1 * alone, "{among} with gross errors, {alone} without");
    assert!((report.sensors[0].sigma_estimated / 0.01 - 1.0).abs() < 0.03);
}

#[test]
fn a_sensor_that_understates_its_sigma_is_detected() {
    let set = set_of(vec![(heights(8_000, 0.01, 1), Some(0.01)), (heights(8_000, 0.06, 2), Some(0.02))]);
    let report = fit(&set, &options([16, 16]), &Silent).unwrap().report;
    let [good, bad] = &report.sensors[..] else { panic!("{:?}", report.sensors) };
    assert!(!good.sigma_used_is_estimated && bad.sigma_used_is_estimated, "{:?}", report.sensors);
    assert!((good.sigma_estimated / 0.01 - 1.0).abs() < 0.04, "{good:?}");
    assert!((bad.sigma_estimated / 0.06 - 1.0).abs() < 0.04, "{bad:?}");
    assert!((report.held_out.rms_normalised - 1.0).abs() < 0.05);
}

/// A ball whose parameters are known: three measured coordinates, and a metric that it has to find itself.
#[test]
fn closed_shapes_with_known_parameters_are_fitted() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut scan = heights(20_000, 0.0, 3);
    let sigma = 0.02;
    scan.points = (scan.parameters.iter().flatten())
        .map(|&[u, v]| {
            let (a, b) = (std::f64::consts::TAU * u, std::f64::consts::PI * (v - 0.5));
            DVec3::from_array([2.0 * b.cos() * a.cos(), 2.0 * b.cos() * a.sin(), 3.0 * b.sin()].map(|x| {
                let noise: f64 = StandardNormal.sample(&mut random);
                100.0 + x + sigma * noise
            }))
        })
        .collect();
    let options = FitOptions { shape: Some(Shape::Ball), ..options([24, 12]) };
    let fitted = fit(&set_of(vec![(scan, None)]), &options, &Silent).unwrap();
    assert_eq!(fitted.model.known.measured_coordinates(), Some([true; 3]));
    let report = &fitted.report;
    assert!((report.sensors[0].sigma_estimated / sigma - 1.0).abs() < 0.02, "{report:?}");
    assert!((report.held_out.rms_normalised - 1.0).abs() < 0.05, "{report:?}");
    let surface = &fitted.model.surface;
    for leaf in (0..surface.space().leaves().len()).step_by(7) {
        let p = surface.leaf_point(leaf, 0.4, 0.6).map(|x| x - 100.0);
        let on = (p[0] / 2.0).powi(2) + (p[1] / 2.0).powi(2) + (p[2] / 3.0).powi(2);
        assert!((on - 1.0).abs() < 0.02, "{p:?}");
    }
}

#[test]
fn unsupported_input_with_known_parameters_is_refused() {
    let message = |scan: Scan, cells| {
        let error = fit(&set_of(vec![(scan, None)]), &options(cells), &Silent).err().unwrap();
        (error.kind(), error.to_string())
    };
    let good = || heights(50, 0.01, 1);
    let mut without = good();
    without.parameters = None;
    let mut outside = good();
    outside.parameters.as_mut().unwrap()[7] = [0.5, 1.5];
    let mut unknown = good();
    unknown.parameters.as_mut().unwrap()[3] = [f64::NAN, 0.5];
    let mut slanted = good();
    slanted.covariance = Some(vec![SymmetricMatrix3::isotropic(1.0); 50]);
    let mut line = good();
    line.parameters.as_mut().unwrap().iter_mut().for_each(|p| p[1] = p[0]);
    let mut few = good();
    few.points.truncate(5);
    for (scan, kind, words) in [
        (without, ErrorKind::Input, "expected the columns u v"),
        (outside, ErrorKind::Input, "found (0.5, 1.5) (point 7)"),
        (unknown, ErrorKind::Input, "found (NaN, 0.5) (point 3)"),
        (slanted, ErrorKind::Unsupported, "found covariances"),
        (line, ErrorKind::Undetermined, "found all on one line"),
        (few, ErrorKind::Undetermined, "found 5 in all"),
    ] {
        let (found, text) = message(scan, [4, 4]);
        assert!(found == kind && text.contains(words), "{text}");
    }
}

/// A gross error of any value is rejected, and every reading is accounted for.
#[test]
fn one_gross_error_of_any_size_is_rejected() {
    for size in [0.5, 30.0, 1e4] {
        let mut scan = heights(6_000, 0.01, 21);
        scan.points[1_234][2] += size;
        let total = scan.points.len();
        let fitted = fit(&set_of(vec![(scan, None)]), &options([12, 12]), &Silent).unwrap().report;
        let outliers = fitted.rejected.get("outlier").copied().unwrap_or(0);
        assert!((1..=4).contains(&outliers), "{size}: {:?}", fitted.rejected);
        let sigma = fitted.sensors[0].sigma_estimated;
        assert!((sigma / 0.01 - 1.0).abs() < 0.05, "{size}: {sigma}");
        assert_eq!(fitted.observations + outliers + fitted.held_out.n, total, "{size}");
    }
}

#[test]
fn a_tenth_of_gross_errors_on_one_side_is_rejected() {
    let mut scan = heights(6_000, 0.01, 22);
    for (k, p) in scan.points.iter_mut().enumerate().step_by(10) {
        p[2] += 0.05 + (k as f64 * 0.618_034).fract() * 3.0;
    }
    let report = fit(&set_of(vec![(scan, None)]), &options([12, 12]), &Silent).unwrap().report;
    assert!((500..640).contains(&report.rejected["outlier"]), "{:?}", report.rejected);
    assert!((report.sensors[0].sigma_estimated / 0.01 - 1.0).abs() < 0.1);
}

#[test]
fn readings_written_twice_count_once() {
    let mut scan = heights(2_000, 0.01, 23);
    for _ in 0..2 {
        scan.points.extend_from_within(..2_000);
        if let Some(parameters) = &mut scan.parameters {
            parameters.extend_from_within(..2_000);
        }
    }
    let report = fit(&set_of(vec![(scan, None)]), &options([8, 8]), &Silent).unwrap().report;
    assert_eq!(
        report.rejected["duplicate"],
        report.observations + report.held_out.n + report.rejected["duplicate"] - 2_000
    );
    assert!((report.sensors[0].sigma_estimated / 0.01 - 1.0).abs() < 0.08);
}

#[test]
fn too_few_readings_need_a_stated_sigma() {
    let few = || heights(24, 0.01, 24);
    let error = fit(&set_of(vec![(few(), None)]), &options([20, 20]), &Silent).err().unwrap();
    assert!(error.to_string().contains("cannot separate noise from shape"), "{error}");
    let report = fit(&set_of(vec![(few(), Some(0.01))]), &options([20, 20]), &Silent).unwrap().report;
    assert!(!report.sensors[0].sigma_used_is_estimated);
    assert!(report.sigma.median > 0.003, "{:?}", report.sigma);
}

#[test]
fn a_grid_that_is_too_coarse_is_reported() {
    let report = |cells| {
        fit(&set_of(vec![(heights(8_000, 0.01, 25), None)]), &options(cells), &Silent).unwrap().report
    };
    let coarse = report([2, 2]);
    assert!(
        coarse.findings.iter().any(|w| w.text.contains("2 × 2 cells are too few")),
        "{:?}",
        coarse.findings
    );
    assert!(report([14, 14]).findings.is_empty());
}
