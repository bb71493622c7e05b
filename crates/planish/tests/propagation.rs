//! What nobody measured, concluded from what was: judged against the truth.

// Helpers of tests may unwrap and print as tests do.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

mod common;

use common::probed;
use planish::fit::{Fit, FitOptions, fit};
use planish::model::{Observed, Posterior};
use planish::progress::Silent;
use planish::propagate::SymmetryChoice;
use planish::simulate::{TurningOptions, VesselOptions, turning, vessel};
use planish::{Shape, SymmetryKind};
use planish_estimate::vector3::{add_scaled, cross, scale, unit};
use planish_sense::Pose;
use planish_spline::{FootPointSearch, ProjectionOptions};
use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Root mean square deviation and share within 1.96 σ of the points whose feet are known so, or of all.
fn judge(fit: &Fit, truth: &[([f64; 3], [f64; 3])], known: Option<Observed>) -> (f64, f64, usize) {
    let surface = &fit.model.surface;
    let posterior = fit.model.posterior().unwrap();
    let search = FootPointSearch::new(surface, 2, 1.0).unwrap();
    let (mut squares, mut covered, mut count) = (0.0, 0.0, 0);
    for (p, n) in truth {
        let foot = surface.project(*p, search.nearest(*p, *n), &ProjectionOptions::default());
        if foot.at_border || known.is_some_and(|k| fit.model.observed[foot.leaf as usize] != k) {
            continue;
        }
        let cell = posterior.leaf(foot.leaf as usize).unwrap();
        let sigma = Posterior::sigma_along(&cell, foot.local, foot.normal);
        squares += foot.height * foot.height;
        covered += f64::from(foot.height.abs() <= 1.96 * sigma);
        count += 1;
    }
    let n = count.max(1) as f64;
    ((squares / n).sqrt(), covered / n, count)
}

fn vessel_truth(scene: &planish::simulate::ScanScene) -> Vec<([f64; 3], [f64; 3])> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let points = scene.truth.sample_area_uniform(3000, &mut rng);
    points.iter().map(|p| (p.position, p.normal)).collect()
}

fn full_rotation() -> Option<SymmetryChoice> {
    Some(SymmetryChoice::Of(SymmetryKind::Rotation {
        order: None,
        towards: None,
    }))
}

#[test]
fn the_unseen_side_of_a_vessel_follows_from_its_symmetry() {
    let scene = vessel(&VesselOptions {
        readings: 12_000,
        ..VesselOptions::default()
    })
    .unwrap();
    let truth = vessel_truth(&scene);
    let plain = fit(&scene.set, &FitOptions::default(), &Silent).unwrap();
    let options = FitOptions {
        symmetry: full_rotation(),
        ..FitOptions::default()
    };
    let whole = fit(&scene.set, &options, &Silent).unwrap();
    let found = whole.report.propagation.clone().unwrap();
    let symmetry = found.symmetry.unwrap();
    // The axis is z.
    assert!(symmetry.direction[2].abs() > 0.99999, "{symmetry:?}");
    assert!(symmetry.point[0].hypot(symmetry.point[1]) < 5.0 * symmetry.sigma_point[0].max(symmetry.sigma_point[1]));
    assert!(found.invented_area_fraction > 0.4, "{}", found.invented_area_fraction);
    let (rms, coverage, n) = judge(&whole, &truth, Some(Observed::Invented));
    let (measured, seen_coverage, _) = judge(&whole, &truth, Some(Observed::Measured));
    let (before, _, _) = judge(&plain, &truth, None);
    println!("unseen {rms} of {n}, before {before}, measured {measured}, coverage {coverage} {seen_coverage}");
    assert!(n > 1000 && rms < 0.15 && before > 10.0 * rms);
    assert!(coverage > 0.9 && seen_coverage > 0.9);
    // Copies are no readings.
    assert!(whole.report.observations.abs_diff(plain.report.observations) < 50);
    assert!(whole.report.sensors.len() == 1);

    let proposed = fit(
        &scene.set,
        &FitOptions {
            symmetry: Some(SymmetryChoice::Auto),
            ..FitOptions::default()
        },
        &Silent,
    )
    .unwrap();
    let symmetry = proposed.report.propagation.unwrap().symmetry.unwrap();
    assert!(symmetry.proposed && symmetry.kind == "rotation" && symmetry.order.is_none());
}

#[test]
fn real_readings_overrule_a_symmetry() {
    let mut scene = vessel(&VesselOptions {
        readings: 12_000,
        ..VesselOptions::default()
    })
    .unwrap();
    // The other side was pressed in by 2 mm, and a probe has touched it there.
    let foot = scene.truth.foot([-60.0, 0.0, -5.0]).unwrap();
    let (middle, n) = (foot.point.position, foot.point.normal);
    let (e1, e2) = planish_estimate::vector3::tangents(n);
    let pressed: Vec<[f64; 3]> = (0..121)
        .map(|k| {
            let [x, y] = [k % 11, k / 11].map(|c| 1.4 * (f64::from(c) - 5.0));
            let p = add_scaled(add_scaled(middle, x, e1), y, e2);
            let on = scene.truth.foot(p).unwrap().point;
            let depth = 2.0 * (-(x * x + y * y) / 18.0_f64).exp();
            add_scaled(on.position, -depth, on.normal)
        })
        .collect();
    let deepest = pressed[60];
    let probe = probed(pressed, None, Some(0.01));
    let mut scan = probe.scans[0].clone();
    scan.sensor = 1;
    scene.set.sensors.push(probe.sensors[0].clone());
    scene.set.scans.push(scan);
    let options = FitOptions {
        symmetry: full_rotation(),
        ..FitOptions::default()
    };
    let fitted = fit(&scene.set, &options, &Silent).unwrap();
    let (rms, _, seen) = judge(&fitted, &[(deepest, n)], Some(Observed::Measured));
    assert!(seen == 1 && rms < 0.15, "{rms} from the pressed point");
}

/// A point and its normal.
type Oriented = ([f64; 3], [f64; 3]);

/// Positions over a grid of parameters with noise, a disc of the parameters left out.
fn with_gap(
    seed: u64,
    sigma: f64,
    surface: impl Fn(f64, f64) -> ([f64; 3], [f64; 3]),
) -> (Vec<[f64; 3]>, Vec<[f64; 3]>, Vec<Oriented>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut points, mut normals, mut truth) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..9000 {
        let [x, y] = [0; 2].map(|_| 20.0 * rng.random::<f64>() - 10.0);
        let (p, n) = surface(x, y);
        if x.hypot(y) < 3.5 {
            truth.push((p, n));
        } else {
            points.push(add_scaled(p, sigma * rng.sample::<f64, _>(StandardNormal), n));
            normals.push(n);
        }
    }
    (points, normals, truth)
}

#[test]
fn gaps_in_a_plane_a_sphere_and_a_cylinder_are_filled_within_their_sigma() {
    type Surface = fn(f64, f64) -> ([f64; 3], [f64; 3]);
    let table: Surface = |x, y| ([x, y, 0.1 * x], unit([-0.1, 0.0, 1.0]).unwrap());
    let dome: Surface = |x, y| {
        let n = [x / 20.0, y / 20.0, (1.0 - (x * x + y * y) / 400.0).sqrt()];
        (n.map(|c| 20.0 * c), n)
    };
    let roof: Surface = |x, y| {
        let (sin, cos) = (x / 15.0).sin_cos();
        ([15.0 * sin, y, 15.0 * cos], [sin, 0.0, cos])
    };
    let sigma = 0.02;
    for (kind, surface) in [("plane", table), ("sphere", dome), ("cylinder", roof)] {
        let (points, normals, truth) = with_gap(5, sigma, surface);
        let set = probed(points, Some(normals), Some(sigma));
        let options = FitOptions {
            shape: Some(Shape::Sheet),
            complete_smooth: true,
            ..FitOptions::default()
        };
        let filled = fit(&set, &options, &Silent).unwrap();
        let found = filled.report.propagation.clone().unwrap();
        assert_eq!(found.gaps[0].kind, kind, "{:?}", found.gaps);
        let (rms, coverage, n) = judge(&filled, &truth, Some(Observed::Invented));
        let plain = fit(
            &set,
            &FitOptions {
                complete_smooth: false,
                ..options
            },
            &Silent,
        )
        .unwrap();
        let (before, _, _) = judge(&plain, &truth, None);
        println!(
            "{kind}: rms {rms} ({n}), coverage {coverage}, before {before}; {:?}",
            found.gaps
        );
        assert!(n > 100, "{kind}: {n} of {} are completed", truth.len());
        assert!(rms < sigma && coverage > 0.9, "{kind}: {rms} {coverage}");
        assert!(
            kind == "plane" || before > 1.5 * rms,
            "{kind}: {before} before, {rms} after"
        );
    }
}

#[test]
fn a_freeform_without_symmetry_is_told_so() {
    let scene = planish::simulate::scans(&planish::simulate::ScanSceneOptions {
        readings: 12_000,
        ..planish::simulate::ScanSceneOptions::default()
    })
    .unwrap();
    let auto = FitOptions {
        symmetry: Some(SymmetryChoice::Auto),
        ..FitOptions::default()
    };
    let found = fit(&scene.set, &auto, &Silent).unwrap().report.propagation.unwrap();
    assert!(!found.symmetry.unwrap().is_found() && found.pseudo_readings == 0);
    let wanted = FitOptions {
        symmetry: full_rotation(),
        ..FitOptions::default()
    };
    let error = fit(&scene.set, &wanted, &Silent).err().unwrap();
    assert!(
        error.kind() == planish::ErrorKind::Undetermined && error.to_string().contains("--symmetry auto"),
        "{error}"
    );
}

#[test]
fn pose_and_rate_of_a_turning_thing_lie_within_their_sigma() {
    let (mut rate_error, mut pose_error) = (0.0, 0.0);
    let seeds = [1, 2, 3];
    for seed in seeds {
        let scene = turning(&TurningOptions {
            seed,
            readings: 24_000,
            views: 5,
            ..TurningOptions::default()
        })
        .unwrap();
        let options = FitOptions {
            rigid_motion: true,
            ..FitOptions::default()
        };
        let fitted = fit(&scene.set, &options, &Silent).unwrap();
        let motion = fitted.report.propagation.clone().unwrap().motion.unwrap();
        let truth = scene.motion.unwrap();
        let [rate, sigma] = motion.rate_deg_per_s;
        rate_error += ((rate - truth.rate_deg_per_s) / sigma).powi(2) / seeds.len() as f64;
        for pose in &motion.poses[1..] {
            let turn = scale((truth.rate_deg_per_s * pose.time_s).to_radians(), truth.axis);
            let true_pose = Pose::from_twist(turn, cross(truth.axis_point, turn));
            let found = Pose::from_quaternion_xyzw(pose.quaternion_xyzw, pose.translation).unwrap();
            let (off, _) = found.inverse().after(&true_pose).twist();
            let squares: f64 = (0..3)
                .map(|k| (off[k].to_degrees() / pose.sigma_rotation_deg[k]).powi(2))
                .sum();
            pose_error += squares / (3 * (motion.poses.len() - 1) * seeds.len()) as f64;
        }
        println!(
            "rate {rate} ± {sigma}; speed {:?}; last pose σ {:?}",
            motion.speed, motion.poses[4].sigma_rotation_deg
        );
        // Of the true surface what was seen.
        let seen = scene.readings.iter().flatten().step_by(11);
        let points: Vec<_> = seen.map(|r| (r.point.position, r.point.normal)).collect();
        let (rms, coverage, _) = judge(&fitted, &points, Some(Observed::Measured));
        println!("measured {rms}, coverage {coverage}");
        assert!(rms < 0.1);
    }
    println!("squares over variance: rate {rate_error}, poses {pose_error}");
    // Of one number and of three, over three scenes: pose errors of a scene are alike, as they share its first scan.
    assert!(rate_error < 4.0, "{rate_error}");
    assert!((0.2..2.5).contains(&pose_error), "{pose_error}");
}

#[test]
fn a_moving_thing_needs_times() {
    let mut scene = turning(&TurningOptions {
        readings: 2000,
        views: 2,
        ..TurningOptions::default()
    })
    .unwrap();
    scene.set.scans[1].scan.time_s = None;
    let options = FitOptions {
        rigid_motion: true,
        ..FitOptions::default()
    };
    let error = fit(&scene.set, &options, &Silent).err().unwrap();
    assert!(error.to_string().contains("laser-2.ply: needed the time"), "{error}");
}
