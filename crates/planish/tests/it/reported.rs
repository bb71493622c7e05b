//! Cases that must be reported: the same readings in two files, options that a filter cannot use, and shapes
//! that do not fit a motion.

use planish::export::mesh_from_model;
use planish::fit::{
    FitOptions, FitTermination, GlobalOptions, ObservationOptions, Observations, PatchOptions, Quantity,
    RejectionCause, Strategy, fit,
};
use planish::progress::{Progress, Silent};
use planish::simulate::{ScanScene, ScanSceneOptions, scans};
use planish_core::DVec3;
use planish_estimate::ErrorKind;
use planish_exchange::ScanSet;
use planish_sense::{PrincipalCurvatures, Scan, Sensor};
use planish_spline::Shape;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use std::f64::consts::{PI, TAU};

fn scene(shape: Shape, readings: usize) -> ScanScene {
    scans(&ScanSceneOptions {
        shape,
        readings,
        views: if shape == Shape::Ball { 6 } else { 2 },
        old_scanner: false,
        probe_points: 0,
        organised: false,
        outlier_share: 0.0,
        ..ScanSceneOptions::default()
    })
    .unwrap()
}

fn sheet() -> FitOptions {
    FitOptions { shape: Some(Shape::Sheet), ..FitOptions::default() }
}

/// The set with its first scan in a second file.
fn with_a_copy(set: &ScanSet) -> ScanSet {
    let mut twice = set.clone();
    let mut copy = twice.scans[0].clone();
    copy.scan.name = "copy.ply".to_owned();
    twice.scans.push(copy);
    twice
}

#[test]
fn readings_in_two_files_count_once_and_both_are_named() {
    let set = scene(Shape::Sheet, 4000).set;
    let once = fit(&set, &sheet(), &Silent).unwrap();
    let twice = fit(&with_a_copy(&set), &sheet(), &Silent).unwrap();
    let copied = set.scans[0].scan.points.len();
    assert_eq!(twice.report.rejected.get("duplicate"), Some(&copied));
    assert_eq!(twice.report.observations, once.report.observations);
    // If the copy counted, σ of the surface would be about a quarter smaller.
    let ratio = twice.report.sigma.median / once.report.sigma.median;
    assert!((ratio - 1.0).abs() < 1e-6, "{ratio}");
    let named =
        |f: &&planish::Finding| f.text.contains("copy.ply") && f.text.contains(&set.scans[0].scan.name);
    assert_eq!(twice.report.findings.iter().filter(named).count(), 1, "{:?}", twice.report.findings);
    assert_eq!(once.report.findings.iter().filter(|w| w.text.contains("to the last digit")).count(), 0);
}

/// Another pose, another sensor, or another reading at one place are no copies.
#[test]
fn scans_that_agree_for_other_reasons_are_no_copies() {
    let set = scene(Shape::Sheet, 4000).set;
    let mut moved = with_a_copy(&set);
    moved.scans.last_mut().unwrap().scan.world_from_scanner.translation[2] += 1e-3;
    let mut other = with_a_copy(&set);
    let mut sensor = other.sensors[other.scans[0].sensor].clone();
    sensor.name = "another".to_owned();
    other.sensors.push(sensor);
    other.scans.last_mut().unwrap().sensor = other.sensors.len() - 1;
    for set in [moved, other] {
        let report = fit(&set, &sheet(), &Silent).unwrap().report;
        assert_eq!(report.rejected.get("duplicate"), None);
    }
}

#[test]
fn the_patch_filter_reports_unused_input() {
    let set = scene(Shape::Sheet, 8000).set;
    let patch = FitOptions { strategy: Strategy::Patches(PatchOptions::default()), ..sheet() };
    let mut biased = set.clone();
    biased.sensors.iter_mut().for_each(|s| s.sigma_bias = Some(0.05));
    let rough = FitOptions { tolerance: Some(5.0), ..patch };
    let report = fit(&biased, &rough, &Silent).unwrap().report;
    assert!(report.findings.iter().any(|f| f.text.contains("sigma_bias")), "{:?}", report.findings);
    assert_eq!(report.termination, FitTermination::ReachedTolerance);
}

/// Stops as soon as a surface is made.
struct NoWork;

impl Progress for NoWork {
    fn advance(&self, stage: &str, _: f64) {
        assert!(stage != "first shape" && stage != "growing", "the work has begun: {stage}");
    }
}

#[test]
fn a_bending_ball_is_rejected_before_the_work() {
    // Seen from all sides at each of two times: one view alone looks like a sheet.
    let mut set = scene(Shape::Ball, 4000).set;
    set.scans.iter_mut().for_each(|posed| posed.scan.time_s = Some(0.0));
    let mut later = set.scans.clone();
    later.iter_mut().for_each(|posed| posed.scan.time_s = Some(1.0));
    set.scans.extend(later);
    let options = FitOptions { strategy: Strategy::Bending, ..FitOptions::default() };
    let e = fit(&set, &options, &NoWork).err().unwrap();
    assert!(e.kind() == ErrorKind::Input && e.to_string().contains("looks like a ball"), "{e}");
}

/// A principal direction along the normal is invalid. A direction of zero means unknown.
#[test]
fn curvatures_along_the_normal_are_counted_by_that_name() {
    let up = DVec3::Z;
    let scan = Scan {
        name: "bent.csv".to_owned(),
        points: (0..40).map(|k| DVec3::new(f64::from(k % 8), f64::from(k / 8), 0.0)).collect(),
        normals: Some(vec![up; 40]),
        sigma_normal_deg: Some(vec![1.0; 40]),
        curvatures: Some(
            (0..40)
                .map(|k| PrincipalCurvatures {
                    values: [0.1, 0.0],
                    direction: [DVec3::X, up, DVec3::ZERO][k % 3],
                })
                .collect(),
        ),
        sigma_curvature: Some(vec![0.01; 40]),
        ..Scan::default()
    };
    let options = ObservationOptions {
        held_out_share: 0.0,
        seed: 0,
        checks: FitOptions::default().checks,
        sheet: true,
        unprocessed: true,
        ground: None,
    };
    let made = Observations::new(&[&scan], &[0], &[Sensor::default()], &options).unwrap();
    assert_eq!(made.intake.rejected.get(&RejectionCause::DirectionAlongNormal), Some(&13));
    let bent = (0..made.len()).filter(|&i| made.quantity(i) == Quantity::Curvature).count();
    assert_eq!(bent, 14);
}

/// Two scans that share a tenth of the sheet: the surface follows each of them where it is alone.
#[test]
fn scans_that_overlap_little_and_differ_are_named() {
    let mut set = scene(Shape::Sheet, 6000).set;
    let x = |set: &ScanSet, side: f64| {
        let all = set.scans.iter().flat_map(|posed| &posed.scan.points);
        all.map(|p| side * p.x).fold(f64::NEG_INFINITY, f64::max)
    };
    let (low, high) = (-x(&set, -1.0), x(&set, 1.0));
    for (posed, side) in set.scans.iter_mut().zip([-1.0, 1.0]) {
        let Scan { points, normals, sigma, .. } = &mut posed.scan;
        assert!(normals.is_none() && sigma.is_none());
        points.retain(|p| side * (p.x - 0.5 * (low + high)) > -0.05 * (high - low));
    }
    let differs = |set: &ScanSet| {
        let found = fit(set, &sheet(), &Silent).unwrap();
        found
            .readings
            .unwrap()
            .scans
            .iter()
            .filter_map(|scan| scan.difference)
            .map(|d| d.rms / d.sigma)
            .fold(0.0, f64::max)
    };
    let as_simulated = differs(&set);
    for p in &mut set.scans[1].scan.points {
        p.z += 0.25;
    }
    let displaced = differs(&set);
    println!("difference over σ: {as_simulated}, then {displaced}");
    assert!(as_simulated < 0.5 && displaced > 1.0);
}

/// A pipe that is bent by 270° and open at both ends. Chosen as a ball, its cells would fold over each other.
/// Over quads, it is closed by two caps that nothing was measured on.
#[test]
fn bent_pipes_are_followed_and_their_ends_are_unmeasured() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let normal = Normal::new(0.0, 0.05).unwrap();
    let points = std::iter::repeat_with(|| {
        let (along, around) = (rng.random_range(0.0..1.5 * PI), rng.random_range(0.0..TAU));
        let radius = 40.0 + 10.0 * around.cos();
        // Evenly by area: the outer side is longer.
        let is_kept = rng.random_range(0.0..50.0) < radius;
        let p = DVec3::new(radius * along.cos(), radius * along.sin(), 10.0 * around.sin());
        is_kept.then(|| p + DVec3::from_array([0; 3].map(|_| normal.sample(&mut rng))))
    });
    let scan =
        Scan { name: "pipe".to_owned(), points: points.flatten().take(8000).collect(), ..Scan::default() };
    let mut set = scene(Shape::Sheet, 100).set;
    set.scans.truncate(1);
    set.scans[0].scan = scan;
    set.sensors[set.scans[0].sensor].noise = None;
    let found = fit(&set, &FitOptions::default(), &Silent).unwrap();
    let made = mesh_from_model(&found.model, &found.posterior(), Some(0.05)).unwrap();
    let (mut covered, mut measured, mut caps, mut far) = (0_u32, 0_u32, 0, 0);
    for ((p, sigma), observed) in made.mesh.positions.iter().zip(&made.sigma).zip(&made.observed) {
        let error = ((p.x.hypot(p.y) - 40.0).hypot(p.z) - 10.0).abs();
        // Beyond the ends, by more than two spacings of 8000 readings on 11,800 mm².
        let is_cap = p.x > 2.4 && p.y < -2.4 || error > 2.4;
        caps += usize::from(is_cap);
        far += usize::from(is_cap && *observed == 1);
        measured += u32::from(*observed == 1);
        covered += u32::from(*observed == 1 && error < 1.96 * sigma);
    }
    println!("{covered} of {measured} covered, {far} of {caps} beyond the ends measured");
    // Marks have cells, so a single vertex just beyond the limit may lie in a measured one.
    assert!(f64::from(covered) > 0.9 * f64::from(measured) && caps > 1000 && 1000 * far <= caps);
}

/// Normals with the wrong side, or those of a cavity that was scanned from within.
#[test]
fn normals_that_face_inwards_are_turned() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let normal = Normal::new(0.0, 0.02).unwrap();
    let axes = DVec3::new(20.0, 15.0, 12.0);
    let (points, normals): (Vec<_>, Vec<_>) = std::iter::repeat_with(|| {
        DVec3::from_array([(); 3].map(|()| normal.sample(&mut rng))).normalize_or_zero()
    })
    .take(4000)
    .map(|d| (d * axes, -(d / axes).normalize()))
    .unzip();
    let points: Vec<DVec3> = (points.into_iter())
        .map(|p: DVec3| p + DVec3::from_array([(); 3].map(|()| normal.sample(&mut rng))))
        .collect();
    for genus in [None, Some(0)] {
        let mut set = scene(Shape::Sheet, 100).set;
        set.scans.truncate(1);
        let scan = Scan { name: "cavity".to_owned(), points: points.clone(), ..Scan::default() };
        set.scans[0].scan = Scan { normals: Some(normals.clone()), ..scan };
        set.sensors[set.scans[0].sensor].noise = None;
        let strategy = Strategy::Global(GlobalOptions { genus, ..GlobalOptions::default() });
        let found = fit(&set, &FitOptions { strategy, ..FitOptions::default() }, &Silent).unwrap();
        let turned = found.report.findings.iter().filter(|f| f.text.contains("they were turned"));
        assert_eq!(turned.count(), 1, "{:?}", found.report.findings);
        let made = mesh_from_model(&found.model, &found.posterior(), Some(0.05)).unwrap();
        let corners = (0..made.mesh.triangles.len()).map(|k| made.mesh.corners(k));
        let volume: f64 = corners.map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
        let ratio = volume / (4.0 / 3.0 * PI * axes.x * axes.y * axes.z);
        assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
    }
}
