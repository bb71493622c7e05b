//! Laws of contours: derivatives match differences, and fits recover simulated contours within their
//! covariance.

use super::reading::{ContourEquation, ContourModel};
use super::*;
use nalgebra::DVector;
use planish_estimate::implicit::{ImplicitReading, MAX_NOISE};
use planish_estimate::{ChiSquareMean, normalized_squared};

const SENSOR: SensorOptions = SensorOptions {
    standoff: 3.0,
    sigma: [0.006, 0.006, 0.0105, 0.0],
    sigma_range_share: 0.003,
    sweep: 1,
    outlier_share: 0.0,
    velocity: [0.0; 3],
    rate_hz: 100.0,
};

fn examples() -> Vec<(ContourKind, Vec<f64>)> {
    let chain = ContourKind::Chain { arcs: vec![false, true, false, true], closed: true };
    vec![
        (ContourKind::Line, vec![0.4, 0.3]),
        (ContourKind::Circle, vec![0.1, -0.2, 1.0]),
        (ContourKind::Ellipse, vec![0.1, -0.2, 1.0, 0.6, 0.5]),
        (ContourKind::Rectangle, vec![0.1, -0.2, 1.6, 1.2, 0.5]),
        (ContourKind::RoundedRectangle, vec![0.1, -0.2, 1.6, 1.2, 0.5, 0.25]),
        (ContourKind::Slot, vec![0.1, -0.2, 2.0, 0.9, 0.5]),
        (ContourKind::RegularPolygon(5), vec![0.1, -0.2, 1.0, 0.3]),
        (ContourKind::Polygon(4), vec![-0.8, -0.7, 0.9, -0.5, 0.6, 0.8, -0.7, 0.5]),
        (chain, vec![-0.8, -0.5, 0.8, -0.5, 0.8, 0.5, -0.8, 0.5, 0.7, -0.3]),
    ]
}

#[test]
fn derivatives_match_differences() {
    let reading = ContourReading {
        target: ContourTarget::Range {
            origin: [3.0, 1.0],
            heading_rad: 3.3,
            range: 2.2,
            sigma: [0.02, 0.03, 0.04, 0.05],
        },
        pose: None,
        time_s: 0.7,
        line: 1,
    };
    for (kind, theta) in examples() {
        for (form, shared_poses) in
            [(Form::ActiveFacet, false), (Form::ActiveFacet, true), (Form::Product, false)]
        {
            let model = ContourModel {
                kind: kind.clone(),
                form,
                motion: PlanarMotion::Rigid,
                pivot: [0.2, 0.1],
                time_s: 0.0,
                shared_poses,
                constraints: Vec::new(),
            };
            let equation = ContourEquation::new(&model, &reading);
            let mut x = [&theta[..], &[0.3, -0.2, 0.4]].concat();
            if shared_poses {
                x.extend([0.5, -0.3, 0.2]);
            }
            let u = vec![0.3; equation.noise()];
            for branch in 0..equation.branches() {
                check(&equation, branch, &x, &u, &format!("{kind} {form:?} {branch}"));
            }
        }
    }
}

fn check(equation: &ContourEquation<'_>, branch: usize, x: &[f64], u: &[f64], name: &str) {
    let value = |x: &[f64], u: &[f64]| {
        let (mut h, mut d) = (vec![0.0; x.len()], vec![0.0; u.len()]);
        let g = equation.gradient(branch, x, u, &mut h, &mut d);
        (g, h, d)
    };
    let (_, by_state, by_noise) = value(x, u);
    let step = 1e-5;
    for k in 0..x.len() + u.len() {
        let moved = |sign: f64| {
            let (mut x, mut u) = (x.to_vec(), u.to_vec());
            if k < x.len() {
                x[k] += sign * step
            } else {
                u[k - x.len()] += sign * step
            }
            value(&x, &u).0
        };
        let difference = (moved(1.0) - moved(-1.0)) / (2.0 * step);
        let stated = if k < x.len() { by_state[k] } else { by_noise[k - x.len()] };
        assert!(
            (difference - stated).abs() < 1e-6 * (1.0 + stated.abs()),
            "{name}, {k}: {stated} for {difference}"
        );
    }
    let mut hessian = [[0.0; MAX_NOISE]; MAX_NOISE];
    if !equation.noise_hessian(branch, x, u, &mut hessian) {
        return;
    }
    for j in 0..u.len() {
        let moved = |sign: f64| {
            let mut u = u.to_vec();
            u[j] += sign * step;
            value(x, &u).2
        };
        let (up, down) = (moved(1.0), moved(-1.0));
        for i in 0..u.len() {
            let difference = (up[i] - down[i]) / (2.0 * step);
            assert!(
                (difference - hessian[i][j]).abs() < 1e-6,
                "{name}, second {i} {j}: {} for {difference}",
                hessian[i][j]
            );
        }
    }
}

/// Mean normalised estimation error squared (NEES) per dimension over 25 seeded runs.
fn consistency(
    kind: &ContourKind,
    theta: &[f64],
    sensor: &SensorOptions,
    options: &ContourFitOptions,
    extra: &[f64],
) -> ChiSquareMean {
    let truth = DVector::from_vec([theta, extra].concat());
    let mut nees = ChiSquareMean::new(truth.len() as f64).expect("degrees");
    for run in 0..25 {
        let made = ranges(kind, theta, [theta[0], theta[1]], 150, sensor, run);
        let found = fit(kind, &made.noisy, options).expect("a fit");
        let (mut state, mut from) = kind.canonical(&found.state.as_slice()[..theta.len()]);
        state.extend(found.state.iter().skip(theta.len()));
        from.extend((theta.len()..found.state.len()).map(|k| (k, 1.0)));
        let mut off = DVector::from_vec(state) - &truth;
        if kind.parameters() == 5 {
            off[4] -= std::f64::consts::PI * (off[4] / std::f64::consts::PI).round();
        }
        let n = truth.len();
        let covariance = nalgebra::DMatrix::from_fn(n, n, |i, j| found.covariance[(from[i].0, from[j].0)]);
        let value = normalized_squared(&off, &covariance).expect("a value");
        nees.add(value).expect("finite");
    }
    nees
}

#[test]
fn simulated_contours_are_recovered_within_their_covariance() {
    for method in [Method::Combined, Method::Batch, Method::NoiseUpdated] {
        let options = ContourFitOptions { method, gate: None, ..ContourFitOptions::default() };
        for (kind, theta) in [
            (ContourKind::Circle, vec![0.1, -0.2, 1.0]),
            (ContourKind::Ellipse, vec![0.1, -0.2, 1.0, 0.6, 0.5]),
            (ContourKind::Rectangle, vec![0.1, -0.2, 1.6, 1.2, 0.5]),
        ] {
            let nees = consistency(&kind, &theta, &SENSOR, &options, &[]);
            assert!((0.6..1.5).contains(&nees.reduced()), "{kind} {method:?}: {}", nees.reduced());
        }
    }
}

#[test]
fn covariance_includes_the_shared_pose_error_of_a_sweep() {
    let sensor = SensorOptions { sweep: 10, ..SENSOR };
    for method in [Method::Batch, Method::NoiseUpdated] {
        let options = ContourFitOptions { method, gate: None, ..ContourFitOptions::default() };
        let nees = consistency(&ContourKind::Circle, &[0.1, -0.2, 1.0], &sensor, &options, &[]);
        assert!((0.5..1.6).contains(&nees.reduced()), "{method:?}: {}", nees.reduced());
    }
}

#[test]
fn velocity_of_a_moving_circle_is_recovered() {
    let sensor = SensorOptions { velocity: [0.2, -0.1, 0.0], ..SENSOR };
    let options =
        ContourFitOptions { motion: PlanarMotion::Linear, gate: None, ..ContourFitOptions::default() };
    // The reference time is that of the first reading, which is zero.
    let nees = consistency(&ContourKind::Circle, &[0.1, -0.2, 1.0], &sensor, &options, &[0.2, -0.1]);
    assert!((0.5..1.6).contains(&nees.reduced()), "{}", nees.reduced());
}

#[test]
fn the_true_kind_is_chosen_at_moderate_noise() {
    for (kind, theta) in [
        (ContourKind::Circle, vec![0.1, -0.2, 1.0]),
        (ContourKind::Ellipse, vec![0.1, -0.2, 1.0, 0.6, 0.5]),
        (ContourKind::Rectangle, vec![0.1, -0.2, 1.6, 1.0, 0.5]),
        (ContourKind::Slot, vec![0.1, -0.2, 2.0, 0.9, 0.5]),
    ] {
        let made = ranges(&kind, &theta, [0.1, -0.2], 200, &SENSOR, 4);
        let choice =
            choose(&auto_kinds(), false, &made.noisy, &ContourFitOptions::default()).expect("a choice");
        assert_eq!(choice.fit.kind, kind, "{:?}", choice.alternatives);
    }
}

#[test]
fn readings_near_corners_do_not_widen_a_rectangle() {
    // Noise of 2 % and 2°: if every reading is assigned to the nearer side, the width is 1.2 σ too large.
    let sensor = SensorOptions { sigma: [0.02, 0.02, 0.035, 0.0], sigma_range_share: 0.01, ..SENSOR };
    let truth = [0.1, -0.2, 1.6, 1.2, 0.5];
    let runs = 24;
    let mean_of = |corner_margin| {
        let options = ContourFitOptions {
            method: Method::Batch,
            gate: None,
            corner_margin,
            ..ContourFitOptions::default()
        };
        let one = |run| {
            let made = ranges(&ContourKind::Rectangle, &truth, [0.1, -0.2], 800, &sensor, run);
            let found = fit(&ContourKind::Rectangle, &made.noisy, &options).expect("a fit");
            let (theta, from) = ContourKind::Rectangle.canonical(found.state.as_slice());
            (theta[2] - truth[2]) / found.covariance[(from[2].0, from[2].0)].sqrt()
        };
        (0..runs).map(one).sum::<f64>() / runs as f64
    };
    let (all, kept) = (mean_of(None), mean_of(ContourFitOptions::default().corner_margin));
    assert!(all > 0.8 && kept.abs() < 0.6, "{all} {kept}");
}

#[test]
fn separate_finds_parts_and_holes() {
    let (outer, inner) = (vec![0.0, 0.0, 2.0, 1.6, 0.3], vec![0.0, 0.0, 0.3]);
    let mut all = points(&ContourKind::Rectangle, &outer, 400, 0.01, 1).noisy;
    all.extend(points(&ContourKind::Circle, &inner, 100, 0.01, 2).noisy);
    let groups = separate(&all, 0.2);
    assert_eq!(groups.iter().map(Vec::len).collect::<Vec<_>>(), [400, 100]);
    let outline = ContourKind::Rectangle.outline(&outer).expect("an outline");
    let hole = ContourKind::Circle.outline(&inner).expect("an outline");
    assert!(hole.vertices.iter().all(|&v| contains(&outline, v)));
    assert!(!contains(&hole, outline.vertices[0]));
}

#[test]
fn outliers_are_rejected() {
    let sensor = SensorOptions { outlier_share: 0.15, ..SENSOR };
    let made = ranges(&ContourKind::Circle, &[0.1, -0.2, 1.0], [0.1, -0.2], 200, &sensor, 9);
    let found = fit(&ContourKind::Circle, &made.noisy, &ContourFitOptions::default()).expect("a fit");
    let off = found.state - DVector::from_column_slice(&[0.1, -0.2, 1.0]);
    assert!(normalized_squared(&off, &found.covariance).expect("a value") < 16.0);
    let rejected = found.used.iter().filter(|used| !**used).count();
    assert!((15..=45).contains(&rejected), "{rejected}");
}

/// The number of ten seeds with which a concave polygon is chosen from few readings and none is rejected.
fn concave_are_chosen(corners: &[[f64; 2]], count: usize, sigma: f64) -> usize {
    let kind = ContourKind::Polygon(corners.len());
    let chosen = |seed: &u64| {
        let turn = 0.7 * *seed as f64;
        let theta: Vec<f64> = corners
            .iter()
            .flat_map(|[x, y]| [turn.cos() * x - turn.sin() * y, turn.sin() * x + turn.cos() * y])
            .collect();
        let mut readings = points(&kind, &theta, count, sigma, *seed).noisy;
        // A picture lists its edges from top to bottom.
        readings.sort_by(|a, b| a.point()[1].total_cmp(&b.point()[1]));
        let choice = choose(&auto_kinds(), true, &readings, &ContourFitOptions::default());
        choice.is_ok_and(|choice| choice.fit.kind == kind && choice.fit.used.iter().all(|used| *used))
    };
    (0..10).filter(chosen).count()
}

#[test]
fn concave_polygons_are_found_whatever_the_order_of_their_readings() {
    let elbow = [[0.0, 0.0], [66.0, 0.0], [66.0, 28.0], [26.0, 28.0], [26.0, 56.0], [0.0, 56.0]];
    assert!(concave_are_chosen(&elbow, 50, 0.1) >= 9);
    let fork = [
        [0.0, 0.0],
        [60.0, 0.0],
        [60.0, 50.0],
        [45.0, 50.0],
        [45.0, 12.0],
        [15.0, 12.0],
        [15.0, 50.0],
        [0.0, 50.0],
    ];
    assert!(concave_are_chosen(&fork, 80, 0.1) >= 9);
}

#[test]
fn triangles_with_sharp_corners_are_found() {
    let truth = [0.0, 0.0, 80.0, 0.0, 0.0, 60.0];
    let options = SensorOptions {
        standoff: 300.0,
        sigma: [0.2, 0.2, 0.2_f64.to_radians(), 0.0],
        sigma_range_share: 0.001,
        ..SENSOR
    };
    for seed in 0..40 {
        let made = ranges(&ContourKind::Polygon(3), &truth, [40.0, 30.0], 300, &options, seed);
        let found = fit(&ContourKind::Polygon(3), &made.noisy, &ContourFitOptions::default());
        let found = found.unwrap_or_else(|e| panic!("seed {seed}: {e}"));
        let (theta, _) = found.kind.canonical(found.state.as_slice());
        let near = |p: &[f64]| {
            let off = truth.chunks(2).map(|t| (t[0] - p[0]).hypot(t[1] - p[1]));
            off.fold(f64::INFINITY, f64::min)
        };
        assert!(theta.chunks(2).all(|p| near(p) < 3.0), "seed {seed}: {theta:?}");
    }
}

#[test]
fn open_outlines_and_outlines_with_arcs_are_chains() {
    let chain = |arcs: &[bool], closed| ContourKind::Chain { arcs: arcs.to_vec(), closed };
    for (kind, theta, middle) in [
        // An open angle and a rounded step, each seen from one side; a D seen from all around.
        (chain(&[false, false], false), vec![-1.0, 0.3, 0.1, -0.5, 0.8, 0.7], [0.0, 1.0]),
        (
            chain(&[false, true, false], false),
            vec![-1.0, -0.4, 0.0, -0.4, 0.5, 0.1, 0.5, 0.9, 0.414],
            [-1.0, 1.0],
        ),
        (chain(&[false, true], true), vec![-0.4, 0.8, -0.4, -0.8, 0.9], [0.0, 0.0]),
    ] {
        let mut found = 0;
        for seed in 0..6 {
            let made = ranges(&kind, &theta, middle, 200, &SENSOR, seed);
            let choice =
                choose(&auto_kinds(), true, &made.noisy, &ContourFitOptions::default()).expect("a choice");
            // A closed chain may begin at any of its vertices.
            let of_kind = |fit: &ContourFit| match (&fit.kind, &kind) {
                (ContourKind::Chain { arcs: a, closed: c }, ContourKind::Chain { arcs: b, closed: d }) => {
                    c == d
                        && a.len() == b.len()
                        && a.iter().filter(|x| **x).count() == b.iter().filter(|x| **x).count()
                }
                _ => false,
            };
            found += usize::from(of_kind(&choice.fit));
        }
        assert!(found >= 4, "{kind:?}: {found} of 6");
    }
}

#[test]
fn rounded_corners_are_identified_at_high_noise() {
    // A choice by distances to the nearest side identified half of these as rectangles.
    let sensor = SensorOptions::around(1.0, 1.0);
    let theta = [0.0, 0.0, 1.8, 1.2, 0.5, 0.3];
    let kinds =
        [ContourKind::Rectangle, ContourKind::RoundedRectangle, ContourKind::Slot, ContourKind::Ellipse];
    let rounded = (0..10).filter(|&seed| {
        let made = ranges(&ContourKind::RoundedRectangle, &theta, [0.0; 2], 200, &sensor, seed);
        let choice = choose(&kinds, false, &made.noisy, &ContourFitOptions::default()).expect("a choice");
        choice.fit.kind == ContourKind::RoundedRectangle
    });
    let count = rounded.count();
    assert!(count >= 9, "{count} of 10");
}

#[test]
fn coincident_readings_are_rejected_for_every_kind() {
    let reading = ContourReading {
        target: ContourTarget::Point { position: [1.0, 1.0], sigma: 0.1 },
        time_s: 0.0,
        pose: None,
        line: 1,
    };
    for kind in auto_kinds() {
        assert!(fit(&kind, &vec![reading; 40], &ContourFitOptions::default()).is_err(), "{kind}");
    }
}

/// If less than half of a circle is observed, its radius depends on the curvature of an arc; σ is correct
/// there, too.
#[test]
fn radius_of_a_short_arc_has_the_stated_sigma() {
    let sensor = SensorOptions::around(1.0, 1.0);
    let runs = 24;
    let nees = |run: u64| {
        let seen = ranges(&ContourKind::Circle, &[0.0, 0.0, 1.0], [0.0; 2], 300, &sensor, run).noisy;
        let is_near = |s: &&ContourReading| {
            let [x, y] = s.point();
            y.atan2(x).abs() < 1.05
        };
        let arc: Vec<ContourReading> = seen.iter().filter(is_near).copied().collect();
        let found = fit(&ContourKind::Circle, &arc, &ContourFitOptions::default()).expect("a fit");
        (found.state[2] - 1.0).powi(2) / found.covariance[(2, 2)]
    };
    let mean = (0..runs).map(nees).sum::<f64>() / runs as f64;
    assert!((0.5..2.2).contains(&mean), "{mean}");
}

#[test]
fn readings_closer_than_their_sigma_show_no_outline() {
    let spot = points(&ContourKind::Circle, &[0.0, 0.0, 1e-3], 50, 0.1, 1).exact;
    let e = choose(&auto_kinds(), true, &spot, &ContourFitOptions::default()).unwrap_err();
    assert!(e.to_string().contains("found all 50 closer together"), "{e}");
}

#[test]
fn simulated_readings_end_when_no_beam_meets_the_object() {
    // After the first reading, the object is 100 times its size away.
    let sensor = SensorOptions { velocity: [100.0, 0.0, 0.0], rate_hz: 1.0, ..SENSOR };
    let made = ranges(&ContourKind::Circle, &[0.0, 0.0, 1.0], [0.0; 2], 50, &sensor, 1);
    assert!((1..50).contains(&made.exact.len()), "{}", made.exact.len());
    assert_eq!(made.exact.len(), made.noisy.len());
}
