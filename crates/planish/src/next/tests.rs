//! The effect of the chosen points and views on σ.

use super::*;
use planish_core::Silent;
use planish_exchange::{PosedScan, ScanSet};
use planish_mesh::BoundingBox;
use planish_sense::{Noise, Pose, Scan, Sensor, ViewSensor};
use planish_spline::Shape;
use planish_surface::fit::{FitOptions, fit};
use planish_surface::test_support::{model_of, refined_surface};
use rand::{RngExt, SeedableRng, seq::index::sample};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A wavy sheet with few readings in one corner.
fn model() -> SurfaceModel {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let points = (0..3_000).filter_map(|_| {
        let (x, y): (f64, f64) = (4.0 * random.random::<f64>(), 3.0 * random.random::<f64>());
        let noise: f64 = StandardNormal.sample(&mut random);
        let is_sparse = x > 2.0 && y > 1.5 && random.random::<f64>() > 0.02;
        (!is_sparse).then_some(DVec3::new(x, y, 0.2 * (2.0 * x).sin() * (1.5 * y).cos() + 0.01 * noise))
    });
    let scan = Scan { name: "cloud".to_owned(), points: points.collect(), ..Scan::default() };
    let set = ScanSet {
        sensors: vec![Sensor {
            name: "laser".to_owned(),
            noise: Some(Noise::Isotropic { sigma: 0.01 }),
            ..Sensor::default()
        }],
        scans: vec![PosedScan { scan, sensor: 0, sigma_translation: None, sigma_rotation_deg: None }],
        ..ScanSet::default()
    };
    let options = FitOptions { shape: Some(Shape::Sheet), ..FitOptions::default() };
    fit(&set, &options, &Silent).unwrap().model
}

#[test]
fn sigma_after_points_matches_the_updated_information() {
    let mut model = model();
    let options = NextOptions { count: 6, sigma: Some(0.004), ..NextOptions::default() };
    let report = next_points(&model, &options, &Silent).unwrap();
    assert_eq!(report.points.len(), 6);
    assert!(report.worst_sigma.after < 0.8 * report.worst_sigma.before, "{report:?}");
    let system = SurfaceSystem::new(model.surface.space()).unwrap();
    let at: Vec<usize> = (report.points.iter())
        .map(|point| {
            let same =
                |leaf: &usize| (model.surface.leaf_point(*leaf, 0.5, 0.5) - point.position).length() < 1e-9;
            (0..model.observed.len()).find(same).unwrap()
        })
        .collect();
    let more = system
        .accumulate(|leaf, cell| {
            for point in at.iter().zip(&report.points).filter(|(l, _)| **l == leaf).map(|(_, p)| p) {
                cell.add_scalar(&leaf_weights(0.5, 0.5), point.normal, 0.0, 1.0 / (0.004 * 0.004));
            }
            at.contains(&leaf)
        })
        .unwrap();
    model.known.information_mut().unwrap().data.add_scaled(&more, 1.0).unwrap();
    // Readings do not reduce σ of unresolved shape.
    model.excess_variance.clear();
    let posterior = model.posterior().unwrap();
    let after = figures(
        &places(&model, &model.surface.directions(), &options),
        &(0..model.observed.len())
            .map(|leaf| {
                let normal = model.surface.leaf_jet(leaf, 0.5, 0.5).normal().unwrap();
                let cell = posterior.leaf(leaf).unwrap();
                cell.variance_along(&leaf_weights(0.5, 0.5), normal)
            })
            .collect::<Vec<f64>>(),
    );
    assert!((after.0 / report.worst_sigma.after - 1.0).abs() < 1e-6, "{after:?} {report:?}");
    assert!((after.1 / report.mean_sigma.after - 1.0).abs() < 1e-6, "{after:?} {report:?}");
}

/// Readings cannot reduce σ of unresolved shape. The report must state it, so that `info` and `next` agree.
#[test]
fn unresolved_shape_above_the_goal_is_reported() {
    let mut model = model();
    model.excess_variance = vec![0.0; model.observed.len()];
    let options = NextOptions { count: 2, sigma: Some(0.004), ..NextOptions::default() };
    assert_eq!(next_points(&model, &options, &Silent).unwrap().unresolved_shape, None);
    model.excess_variance[3] = 0.25;
    let report = next_points(&model, &options, &Silent).unwrap();
    let left = report.unresolved_shape.unwrap();
    assert_eq!(left.largest, 0.5);
    assert!(left.area_fraction > 0.0 && left.area_fraction < 0.1, "{left:?}");
    assert!(report.worst_sigma.after < 0.2 && left.worst_sigma_after >= 0.5, "{report:?}");
}

/// Remaining σ after `count` readings at random places.
fn at_random(model: &SurfaceModel, count: usize, seed: u64) -> f64 {
    let system = SurfaceSystem::new(model.surface.space()).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let leaves = model.observed.len();
    let at: Vec<usize> = sample(&mut random, leaves, count.min(leaves)).into_vec();
    let mut drawn = model.clone();
    let more = system.accumulate(|leaf, cell| {
        let normal = model.surface.leaf_jet(leaf, 0.5, 0.5).normal().unwrap_or(DVec3::ZERO);
        if at.contains(&leaf) {
            cell.add_scalar(&leaf_weights(0.5, 0.5), normal, 0.0, 1.0 / (0.004 * 0.004));
        }
        at.contains(&leaf)
    });
    drawn.known.information_mut().unwrap().data.add_scaled(&more.unwrap(), 1.0).unwrap();
    let posterior = drawn.posterior().unwrap();
    (0..leaves)
        .map(|leaf| {
            let normal = model.surface.leaf_jet(leaf, 0.5, 0.5).normal().unwrap();
            let cell = posterior.leaf(leaf).unwrap();
            cell.variance_along(&leaf_weights(0.5, 0.5), normal)
        })
        .fold(0.0, f64::max)
        .sqrt()
}

#[test]
fn chosen_points_equal_twice_as_many_random_ones() {
    let model = model();
    let options = NextOptions { count: 8, sigma: Some(0.004), ..NextOptions::default() };
    let chosen = next_points(&model, &options, &Silent).unwrap().worst_sigma.after;
    let mut random: Vec<f64> = (0..15).map(|seed| at_random(&model, 16, seed)).collect();
    random.sort_by(f64::total_cmp);
    assert!(chosen < random[7], "{chosen} {random:?}");
}

#[test]
fn the_goal_ends_the_selection_and_the_region_limits_it() {
    let model = model();
    let options = NextOptions {
        count: 500,
        sigma: Some(0.004),
        region: Some([DVec3::new(2.2, 1.7, -9.0), DVec3::new(3.8, 2.8, 9.0)]),
        ..NextOptions::default()
    };
    let first = next_points(&model, &NextOptions { count: 0, ..options.clone() }, &Silent).unwrap();
    assert!(first.points.is_empty());
    let goal = 0.6 * first.worst_sigma.before;
    let report = next_points(&model, &NextOptions { goal: Some(goal), ..options.clone() }, &Silent).unwrap();
    assert_eq!(report.reached_goal, Some(true));
    assert!(report.worst_sigma.after <= goal && report.points.len() < 200, "{}", report.points.len());
    assert!(report.points.iter().all(|p| p.position[0] >= 2.2 && p.position[1] >= 1.7));
    let outside = NextOptions { region: Some([DVec3::splat(50.0), DVec3::splat(60.0)]), ..options };
    assert!(next_points(&model, &outside, &Silent).is_err());
}

/// A sensor for objects of about size one.
fn camera() -> ViewSensor {
    ViewSensor {
        borders: ViewSensor::borders_of_angles([0.9, 0.7]),
        rays: [48, 36],
        range: [1.0, 6.0],
        max_incidence_rad: 1.1,
        sigma_along: 0.004,
        sigma_across: 0.002,
        sigma_per_range2: 0.0005,
        over_cosine: false,
    }
}

/// A torus with radii 1 and 0.4 about z. A quarter of it was not measured.
fn ring() -> SurfaceModel {
    let surface = refined_surface(Shape::Torus);
    let middle = |leaf: usize| surface.leaf_point(leaf, 0.5, 0.5);
    let measured: Vec<bool> = (0..surface.space().leaves().len())
        .map(|leaf| middle(leaf)[0] < 0.0 || middle(leaf)[1] < 0.0)
        .collect();
    model_of(surface, |leaf| measured[leaf])
}

#[test]
fn sigma_after_views_matches_the_updated_information() {
    let mut model = ring();
    let (sensor, options) = (camera(), NextOptions { count: 2, ..NextOptions::default() });
    let report = next_views(&model, &sensor, &options, &Silent).unwrap();
    assert_eq!(report.views.len(), 2);
    assert!(report.worst_sigma.after < 0.5 * report.worst_sigma.before, "{report:?}");
    // The same readings as three coordinates with their covariance across the normal alone, by the model's
    // own posterior.
    let system = SurfaceSystem::new(model.surface.space()).unwrap();
    let unknown = model.clone();
    let sight = sight::Sight::new(&unknown, &sensor).unwrap();
    for view in &report.views {
        let pose = Pose::from_quaternion_xyzw(view.quaternion_xyzw, view.translation).unwrap();
        let visible = sight.readings(&pose);
        assert_eq!(visible.readings.len(), view.readings);
        let more = system.accumulate(|leaf, cell| {
            let of_leaf = visible.readings.iter().filter(|r| r.leaf as usize == leaf);
            of_leaf
                .map(|r| {
                    cell.add_scalar(&leaf_weights(r.local[0], r.local[1]), r.normal, 0.0, 1.0 / r.variance)
                })
                .count()
                > 0
        });
        model.known.information_mut().unwrap().data.add_scaled(&more.unwrap(), 1.0).unwrap();
    }
    let posterior = model.posterior().unwrap();
    let sigma = |leaf: usize| {
        let normal = model.surface.leaf_jet(leaf, 0.5, 0.5).normal().unwrap();
        let cell = posterior.leaf(leaf).unwrap();
        cell.variance_along(&leaf_weights(0.5, 0.5), normal).sqrt()
    };
    let worst = (0..model.observed.len()).map(sigma).fold(0.0, f64::max);
    assert!((worst / report.worst_sigma.after - 1.0).abs() < 1e-6, "{worst} {report:?}");
}

#[test]
fn the_chosen_views_do_not_depend_on_the_number_of_threads() {
    let model = ring();
    let options = NextOptions { count: 2, ..NextOptions::default() };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| next_views(&model, &camera(), &options, &Silent).unwrap())
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn hidden_points_are_not_measured() {
    let model = ring();
    let sensor = ViewSensor { max_incidence_rad: 1.5, ..camera() };
    let sight = sight::Sight::new(&model, &sensor).unwrap();
    // From the side, level with the ring: its near part hides the far one's middle, and the hole.
    let pose = sight::pose_looking_along(DVec3::new(5.0, 0.0, 0.0), DVec3::new(-1.0, 0.0, 0.0)).unwrap();
    let visible = sight.readings(&pose);
    assert!(visible.readings.len() > 200);
    for r in &visible.readings {
        let hidden = r.point[0] < 0.9 && r.point[1].abs() < 0.3 && r.point[2].abs() < 0.3;
        assert!(!hidden && r.normal.dot(pose.translation - r.point) > 0.0, "{r:?}");
    }
    let directions = vec![DVec3::Z; model.surface.space().node_count()];
    let places = places(&model, &directions, &NextOptions::default());
    for place in &places {
        let hidden =
            place.position[0] < 0.9 && place.position[1].abs() < 0.3 && place.position[2].abs() < 0.3;
        assert!(!(hidden && sight.visible_coordinates(&pose, place).is_some()), "{:?}", place.position);
    }
    assert!(places.iter().filter(|p| sight.visible_coordinates(&pose, p).is_some()).count() > 10);
}

#[test]
fn views_from_behind_or_too_far_away_measure_no_points() {
    let model = model_of(refined_surface(Shape::Sheet), |leaf| leaf % 3 == 0);
    let sensor = camera();
    let sight = sight::Sight::new(&model, &sensor).unwrap();
    let middle = BoundingBox::from_points(model.surface.vertices()).unwrap().center();
    let normal = model.surface.leaf_jet(0, 0.5, 0.5).normal().unwrap();
    let readings = |far: f64| {
        let towards = if far > 0.0 { -1.0 } else { 1.0 };
        let pose = sight::pose_looking_along(middle + far * normal, towards * normal).unwrap();
        sight.readings(&pose).readings.len()
    };
    assert!(readings(2.5) > 100);
    assert_eq!((readings(-2.5), readings(9.0), readings(0.5)), (0, 0, 0));
}

#[test]
fn parts_invisible_from_all_poses_are_reported() {
    // Only readings within about 1° of the normal: this excludes most of a torus from every pose.
    let sensor = ViewSensor { max_incidence_rad: 0.02, ..camera() };
    let options = NextOptions { count: 2, ..NextOptions::default() };
    let report = next_views(&ring(), &sensor, &options, &Silent).unwrap();
    assert!(report.unseen > 0.1 && report.worst_unseen.is_some(), "{report:?}");
    let seen = report.views.last().map_or(0.0, |v| v.seen_so_far);
    assert!(seen > 0.0 && seen <= 1.0 - report.unseen + 1e-12, "{report:?}");
    let all = next_views(&ring(), &camera(), &options, &Silent).unwrap();
    assert!(all.unseen < 1e-9 && all.worst_unseen.is_none(), "{all:?}");
    let far = ViewSensor { range: [400.0, 800.0], borders: [[0.5, 0.6]; 2], ..camera() };
    let e = next_views(&ring(), &far, &options, &Silent).unwrap_err().to_string();
    assert!(e.contains("found no pose that sees the region"), "{e}");
}

#[test]
fn random_draws_match_their_readings() {
    let model = model();
    let options = NextOptions { count: 6, sigma: Some(0.004), against_random: 9, ..NextOptions::default() };
    let report = next_points(&model, &options, &Silent).unwrap();
    let random = report.random.unwrap();
    assert_eq!(random.worst_sigma_median.len(), 6);
    assert!(random.worst_sigma_median.is_sorted_by(|a, b| a >= b));
    assert!(
        random.worst_sigma_median[5] > report.worst_sigma.after
            && random.worst_sigma_p10[0] <= report.worst_sigma.before
    );
    assert!((report.points[5].worst_sigma_after / report.worst_sigma.after - 1.0).abs() < 1e-12);
}

#[test]
fn numbers_of_points_that_take_hours_are_refused_at_once() {
    let model = model();
    let message = |count: usize, against_random: usize| {
        let options = NextOptions { count, sigma: Some(0.004), against_random, ..NextOptions::default() };
        let points = next_points(&model, &options, &Silent).map(|report| report.points.len());
        points.unwrap_err().to_string()
    };
    for count in [MAX_POINTS + 1, 1_000_000_000, usize::MAX] {
        assert_eq!(message(count, 0), format!("expected at most 10000 points to plan, found {count}"));
        assert_eq!(message(count, 3), format!("expected at most 10000 points to plan, found {count}"));
        assert!(
            message(1, count)
                .contains(&format!("expected at most 10000 random sets of points, found {count}"))
        );
        let options = NextOptions { count, ..NextOptions::default() };
        let error = next_views(&model, &camera(), &options, &Silent).unwrap_err().to_string();
        assert_eq!(error, format!("expected at most 1000 poses to plan, found {count}"));
        let job = NextJob { options: options.clone(), model: "gone.planish".into(), ..NextJob::default() };
        assert!(job.run(&Silent).unwrap_err().to_string().contains("expected at most"));
    }
}
