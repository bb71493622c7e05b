mod inheritance;

use super::*;
use crate::hierarchy::{Hierarchy, Shape};
use crate::surface::{Surface, leaf_weights};
use crate::system::SurfaceSystem;
use nalgebra::DMatrix;
use planish_core::{DVec3, SymmetricMatrix3};
use quadtree::{Quadtree, VERTICES, quarter_matrix};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;

const PRIOR: SmoothnessPrior = SmoothnessPrior { weight: 3.0, hold: 0.02 };

fn plane(base: [usize; 2]) -> Surface {
    parameter_plane(&Arc::new(Hierarchy::uniform(Shape::Sheet, base).unwrap())).unwrap()
}

fn filter(base: [usize; 2], layout: StateLayout, prior: SmoothnessPrior) -> PatchFilter {
    filter_to_depth(0, base, layout, prior)
}

fn filter_to_depth(depth: u8, base: [usize; 2], layout: StateLayout, prior: SmoothnessPrior) -> PatchFilter {
    let plane = plane(base);
    let options =
        PatchFilterOptions { layout, min_gain: 1e-9, maximum_depth: depth, ..PatchFilterOptions::default() };
    PatchFilter::new(&plane, &plane, prior, options).unwrap()
}

/// Positions near a wavy surface over the base grid.
fn positions(base: [usize; 2], count: usize, sigma: f64, seed: u64) -> Vec<SurfaceReading> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let [u, v] = base.map(|n| n as f64 * random.random::<f64>());
            let mut noise = || -> f64 { sigma * Distribution::<f64>::sample(&StandardNormal, &mut random) };
            SurfaceReading::Position {
                parameters: [u, v],
                point: DVec3::new(
                    u + noise(),
                    v + noise(),
                    0.4 * (0.9 * u).sin() * (0.7 * v).cos() + noise(),
                ),
                variance: sigma * sigma,
            }
        })
        .collect()
}

/// The global filter over the space of a patch filter, in information form: all vertices with three
/// coordinates per node.
struct Global {
    space: Arc<Hierarchy>,
    information: DMatrix<f64>,
    vector: DMatrix<f64>,
}

impl Global {
    fn new(space: &Arc<Hierarchy>, prior: SmoothnessPrior) -> Self {
        let coarse = plane(space.base());
        let system = SurfaceSystem::new(space).unwrap();
        let scalar = prior.information(&system, &coarse).unwrap().to_dense();
        let information = scalar.kronecker(&DMatrix::<f64>::identity(3, 3));
        let initial = coarse.refined(Arc::clone(space)).unwrap();
        let mean = DMatrix::from_fn(information.nrows(), 1, |k, _| initial.vertices()[k / 3][k % 3]);
        Self { space: Arc::clone(space), vector: &information * mean, information }
    }

    fn row(&self, u: f64, v: f64, direction: DVec3) -> DMatrix<f64> {
        let (leaf, [s, t]) = self.space.locate(u, v);
        let (nodes, weights) = self.space.extraction(leaf);
        let mut row = DMatrix::zeros(self.vector.nrows(), 1);
        for (&node, w) in nodes.iter().zip(weights) {
            let sum: f64 = w.iter().zip(leaf_weights(s, t)).map(|(a, b)| a * b).sum();
            for d in 0..3 {
                row[(3 * node as usize + d, 0)] += sum * direction[d];
            }
        }
        row
    }

    fn add(&mut self, reading: &SurfaceReading) {
        let [u, v] = reading.parameters();
        let rows: Vec<(DVec3, f64, f64)> = match *reading {
            SurfaceReading::Position { point, variance, .. } => (0..3)
                .map(|d| {
                    let mut a = DVec3::ZERO;
                    a[d] = 1.0;
                    (a, point[d], variance)
                })
                .collect(),
            SurfaceReading::Along { direction, value, variance, .. } => vec![(direction, value, variance)],
            _ => unreachable!("the tests add positions and directions only"),
        };
        for (a, z, variance) in rows {
            let row = self.row(u, v, a);
            self.information += &row * row.transpose() / variance;
            self.vector += row * (z / variance);
        }
    }

    fn solve(self) -> Posterior {
        let covariance = self.information.clone().cholesky().unwrap().inverse();
        Posterior { mean: &covariance * &self.vector, covariance, global: self }
    }
}

struct Posterior {
    global: Global,
    mean: DMatrix<f64>,
    covariance: DMatrix<f64>,
}

impl Posterior {
    fn at(&self, u: f64, v: f64, direction: DVec3) -> (f64, f64) {
        let row = self.global.row(u, v, direction);
        (row.dot(&self.mean), (row.transpose() * &self.covariance * &row)[(0, 0)].sqrt())
    }
}

/// Largest difference of mean (in the global σ) and of σ (relative) between a patch filter and the global
/// one.
fn differences(filter: &PatchFilter, global: &Posterior, direction: DVec3) -> (f64, f64) {
    let [nu, nv] = filter.space().extent();
    let (mut mean, mut sigma) = (0.0_f64, 0.0_f64);
    for i in 0..=20 {
        for j in 0..=20 {
            let (u, v) = (nu * f64::from(i) / 20.0, nv * f64::from(j) / 20.0);
            let (m, s) = global.at(u, v, direction);
            let own = direction.dot(filter.jet(u, v).point);
            mean = mean.max((own - m).abs() / s);
            sigma = sigma.max((filter.variance_along(u, v, direction).sqrt() / s - 1.0).abs());
        }
    }
    (mean, sigma)
}

#[test]
fn one_patch_equals_the_global_filter_in_any_order() {
    let base = [4, 4];
    let mut readings = positions(base, 60, 0.05, 3);
    for k in 0..3 {
        let mut filter = filter(base, StateLayout::Isotropic, PRIOR);
        let mut global = Global::new(filter.space(), PRIOR);
        readings.rotate_left(17 * k);
        for reading in &readings {
            filter.observe(reading).unwrap();
            global.add(reading);
        }
        let (mean, sigma) = differences(&filter, &global.solve(), DVec3::new(0.6, 0.0, 0.8));
        assert!(mean < 1e-9 && sigma < 1e-9, "{mean:e} {sigma:e}");
    }
}

#[test]
fn directed_readings_in_one_full_patch_equal_the_global_filter() {
    let base = [4, 4];
    let mut filter = filter(base, StateLayout::Full, PRIOR);
    let mut global = Global::new(filter.space(), PRIOR);
    for (k, reading) in positions(base, 40, 0.05, 5).into_iter().enumerate() {
        let SurfaceReading::Position { parameters, point, .. } = reading else {
            continue;
        };
        let angle = k as f64;
        let direction = DVec3::new(angle.cos() * 0.6, angle.sin() * 0.6, 0.8);
        let along =
            SurfaceReading::Along { parameters, direction, value: direction.dot(point), variance: 1e-3 };
        for reading in [reading, along] {
            filter.observe(&reading).unwrap();
            global.add(&reading);
        }
    }
    let (mean, sigma) = differences(&filter, &global.solve(), DVec3::new(0.6, 0.0, 0.8));
    assert!(mean < 1e-9 && sigma < 1e-9, "{mean:e} {sigma:e}");
}

#[test]
fn heights_are_the_third_coordinate_of_positions() {
    let base = [4, 4];
    let mut heights = filter(base, StateLayout::Height, PRIOR);
    let mut points = filter(base, StateLayout::Isotropic, PRIOR);
    for reading in positions(base, 30, 0.05, 9) {
        heights.observe(&reading).unwrap();
        points.observe(&reading).unwrap();
    }
    let (a, b) = (heights.surface().unwrap(), points.surface().unwrap());
    assert!((a.point(1.3, 2.2)[2] - b.point(1.3, 2.2)[2]).abs() < 1e-12);
    assert!((a.point(1.3, 2.2)[0] - 1.3).abs() < 1e-12, "coordinates in the plane are fixed");
    let z = DVec3::Z;
    assert!((heights.variance_along(1.3, 2.2, z) / points.variance_along(1.3, 2.2, z) - 1.0).abs() < 1e-12);
    // A reading along an oblique direction measures the height.
    let slanted = SurfaceReading::Along {
        parameters: [1.3, 2.2],
        direction: DVec3::new(0.6, 0.0, 0.8),
        value: 0.6 * 1.3 + 0.8 * 0.25,
        variance: 1e-12,
    };
    heights.observe(&slanted).unwrap();
    assert!((heights.surface().unwrap().point(1.3, 2.2)[2] - 0.25).abs() < 1e-6);
    assert!(points.observe(&slanted).is_err(), "coordinates would no longer share a covariance");
}

/// A strip has no loops, so messages carry all information, at once or in parts.
#[test]
fn a_strip_of_patches_equals_the_global_filter() {
    let base = [16, 4];
    let mut filter = filter(base, StateLayout::Isotropic, PRIOR);
    let mut global = Global::new(filter.space(), PRIOR);
    assert_eq!(filter.patches().len(), 4);
    for (k, reading) in positions(base, 120, 0.05, 11).iter().enumerate() {
        filter.observe(reading).unwrap();
        global.add(reading);
        if k % 37 == 0 {
            filter.reconcile().unwrap();
        }
    }
    filter.reconcile().unwrap();
    let (mean, sigma) = differences(&filter, &global.solve(), DVec3::Z);
    println!("strip: mean {mean:.2e} σ, σ {sigma:.2e}");
    assert!(mean < 1e-4 && sigma < 1e-4, "{mean:e} {sigma:e}");
}

/// With loops, adjacent levels and a subdivision in between, the filter is close to the global one and its σ
/// is never much smaller.
#[test]
fn an_adaptive_quadtree_stays_within_half_a_sigma_of_the_global_filter() {
    let base = [4, 4];
    // Weights close to those of restricted likelihood for such a wave, and four times as large.
    for (seed, weight, first) in [(1, 25.0, 0), (1, 25.0, 40), (2, 100.0, 40)] {
        let prior = SmoothnessPrior { weight, ..PRIOR };
        let mut filter = filter_to_depth(2, base, StateLayout::Isotropic, prior);
        let readings = positions(base, 400, 0.05, seed);
        for (k, reading) in readings.iter().enumerate() {
            match k {
                _ if k == first => drop(filter.subdivide(&[filter.patches()[0]]).unwrap()),
                _ if k == 3 * first + 1 => drop(filter.subdivide(&[filter.patches()[1]]).unwrap()),
                _ => {}
            }
            filter.observe(reading).unwrap();
        }
        filter.reconcile().unwrap();
        assert_eq!(filter.patches().len(), 7, "one of four children is subdivided again");
        let mut global = Global::new(filter.space(), prior);
        for reading in &readings {
            global.add(reading);
        }
        let global = global.solve();
        let (mean, sigma) = differences(&filter, &global, DVec3::Z);
        println!("weight {weight}, first division after {first} readings: mean {mean:.3} σ, σ {sigma:.3}");
        assert!(mean < 0.5, "weight {weight}: {mean} σ from the global mean");
        assert!(sigma < 0.25, "weight {weight}: σ differs by {sigma}");
    }
}

/// A filter that expects detail never has a smaller σ than one that does not, and the same σ at the maximum
/// depth.
#[test]
fn expected_detail_increases_sigma() {
    let plane = plane([4, 4]);
    let filter = |expect_detail: bool| {
        let options = PatchFilterOptions { maximum_depth: 1, expect_detail, ..PatchFilterOptions::default() };
        PatchFilter::new(&plane, &plane, PRIOR, options).unwrap()
    };
    let (mut plain, mut with_detail) = (filter(false), filter(true));
    let z = DVec3::Z;
    for reading in positions([4, 4], 50, 0.02, 37) {
        plain.observe(&reading).unwrap();
        with_detail.observe(&reading).unwrap();
    }
    let ratio = with_detail.variance_along(1.7, 2.4, z) / plain.variance_along(1.7, 2.4, z);
    assert!(ratio > 1.5, "{ratio}");
    for filter in [&mut plain, &mut with_detail] {
        filter.subdivide(&[filter.patches()[0]]).unwrap();
        let reading = SurfaceReading::Position {
            parameters: [1.7, 2.4],
            point: DVec3::new(1.7, 2.4, 0.0),
            variance: 1e-8,
        };
        filter.observe(&reading).unwrap();
    }
    let ratio = with_detail.variance_along(1.7, 2.4, z) / plain.variance_along(1.7, 2.4, z);
    assert!((ratio - 1.0).abs() < 0.01, "patches of maximum depth represent all detail: {ratio}");
}

/// The estimate of an isotropic filter is kept when readings with directions follow.
#[test]
fn the_full_layout_continues_from_the_isotropic_one() {
    let mut isotropic = filter([8, 4], StateLayout::Isotropic, PRIOR);
    let mut full = filter([8, 4], StateLayout::Full, PRIOR);
    for reading in positions([8, 4], 40, 0.05, 41) {
        isotropic.observe(&reading).unwrap();
        full.observe(&reading).unwrap();
    }
    let mut widened = isotropic.with_full_layout().unwrap();
    let slanted = SurfaceReading::Along {
        parameters: [5.0, 2.0],
        direction: DVec3::new(0.6, 0.0, 0.8),
        value: 3.1,
        variance: 1e-4,
    };
    for filter in [&mut widened, &mut full] {
        filter.observe(&slanted).unwrap();
        filter.reconcile().unwrap();
    }
    for (u, v) in [(1.0, 1.0), (4.1, 3.0), (7.0, 2.0)] {
        let (a, b) = (widened.jet(u, v).point, full.jet(u, v).point);
        assert!((0..3).all(|d| (a[d] - b[d]).abs() < 1e-5), "{a:?} {b:?}");
        assert!((widened.sigma(u, v).unwrap() / full.sigma(u, v).unwrap() - 1.0).abs() < 1e-5);
    }
    let heights = filter([4, 4], StateLayout::Height, PRIOR);
    assert!(heights.with_full_layout().is_err());
}

/// In the stiff limit every reading counts once everywhere, although patches form loops.
#[test]
fn information_around_a_loop_is_counted_once() {
    let prior = SmoothnessPrior { weight: 1e5, hold: 1e-6 };
    let base = [12, 12];
    let mut filter = filter(base, StateLayout::Isotropic, prior);
    let mut global = Global::new(filter.space(), prior);
    for reading in positions(base, 50, 0.5, 13) {
        filter.observe(&reading).unwrap();
        global.add(&reading);
    }
    for _ in 0..3 {
        filter.reconcile().unwrap();
    }
    let (mean, sigma) = differences(&filter, &global.solve(), DVec3::Z);
    println!("stiff: mean {mean:.3} σ, σ {sigma:.3}");
    assert!(mean < 0.3 && sigma < 0.1, "{mean} {sigma}");
}

#[test]
fn a_resumed_filter_continues_bit_for_bit() {
    let base = [8, 4];
    let readings = positions(base, 90, 0.05, 23);
    let mut filter = filter_to_depth(3, base, StateLayout::Isotropic, PRIOR);
    for reading in &readings[..40] {
        filter.observe(reading).unwrap();
    }
    filter.subdivide(&[filter.patches()[1]]).unwrap();
    for reading in &readings[40..60] {
        filter.observe(reading).unwrap();
    }
    let mut resumed = PatchFilter::from_state(&filter.state()).unwrap();
    for one in [&mut filter, &mut resumed] {
        for reading in &readings[60..] {
            one.observe(reading).unwrap();
        }
        one.refine(&SubdivisionCriteria { curvature_variation: Some(0.1), ..SubdivisionCriteria::default() })
            .unwrap();
    }
    assert_eq!(filter.state(), resumed.state());
    let mut broken = filter.state();
    broken.patches.pop();
    assert!(PatchFilter::from_state(&broken).is_err(), "a missing patch is an error");
}

#[test]
fn memory_does_not_grow_with_readings() {
    let mut filter = filter([4, 4], StateLayout::Height, PRIOR);
    let readings = positions([4, 4], 1000, 0.05, 29);
    filter.observe(&readings[0]).unwrap();
    let before = filter.bytes();
    for reading in &readings {
        filter.observe(reading).unwrap();
    }
    assert_eq!(filter.bytes(), before);
    assert_eq!(filter.readings(), 1001);
}

/// The radius of a sphere is recovered from normals and curvatures with few positions.
#[test]
fn normals_and_curvatures_of_a_sphere_reduce_error_and_sigma() {
    let radius = 5.0;
    let at = |u: f64, v: f64| {
        let (x, y) = (u - 2.0, v - 2.0);
        DVec3::new(x, y, (radius * radius - x * x - y * y).sqrt())
    };
    let mut filter = filter_to_depth(0, [4, 4], StateLayout::Full, PRIOR);
    let errors = |filter: &PatchFilter| {
        let surface = filter.surface().unwrap();
        let (mut worst, mut sigma) = (0.0_f64, 0.0_f64);
        for k in 0..=16 {
            let (u, v) = (0.25 * f64::from(k), 4.0 - 0.25 * f64::from(k));
            let p = surface.point(u, v);
            worst = worst.max((p.length() - radius).abs());
            sigma = sigma.max(filter.sigma(u, v).unwrap());
        }
        (worst, sigma)
    };
    for [u, v] in [[0.3, 0.3], [3.7, 0.4], [0.3, 3.6], [3.7, 3.7]] {
        let point = at(u, v);
        let reading = SurfaceReading::Position { parameters: [u, v], point, variance: 1e-6 };
        filter.observe(&reading).unwrap();
    }
    let mut last = errors(&filter);
    let grid: Vec<[f64; 2]> =
        (0..36).map(|k| [0.35 + 0.66 * f64::from(k % 6), 0.35 + 0.66 * f64::from(k / 6)]).collect();
    for which in 0..2 {
        for &[u, v] in &grid {
            let normal = at(u, v) / radius;
            let (t1, t2) = planish_core::vector3::tangents(normal);
            let reading = match which {
                0 => SurfaceReading::Normal { parameters: [u, v], normal, sigma_rad: 0.01 },
                _ => SurfaceReading::Curvature {
                    parameters: [u, v],
                    normal,
                    principal: [-1.0 / radius; 2],
                    directions: [t1, t2],
                    sigma: 0.01,
                },
            };
            let update = filter.observe(&reading).unwrap();
            assert_eq!(update.equations, 2 + which);
        }
        let now = errors(&filter);
        assert!(now.0 < 0.5 * last.0 && now.1 < last.1, "{which}: {now:?} after {last:?}");
        last = now;
    }
    assert!(last.0 < 3.0 * last.1, "an error of {} with σ of {}", last.0, last.1);
}

#[test]
fn patches_are_subdivided_only_where_the_shape_requires_it() {
    let base = [8, 8];
    let mut random = ChaCha8Rng::seed_from_u64(31);
    let bump = |u: f64, v: f64| 0.8 * (-3.0 * ((u - 1.7).powi(2) + (v - 2.1).powi(2))).exp();
    let criteria = |curvature: bool| SubdivisionCriteria {
        curvature_variation: curvature.then_some(0.5),
        chi_square: (!curvature).then_some(3.0),
        ..SubdivisionCriteria::default()
    };
    for curvature in [false, true] {
        let mut filter =
            filter_to_depth(3, base, StateLayout::Height, SmoothnessPrior { weight: 30.0, ..PRIOR });
        let mut divided = Vec::new();
        for round in 0..3 {
            for _ in 0..1500 {
                let [u, v] = base.map(|n| n as f64 * random.random::<f64>());
                let noise: f64 = StandardNormal.sample(&mut random);
                filter
                    .observe(&SurfaceReading::Along {
                        parameters: [u, v],
                        direction: DVec3::Z,
                        value: bump(u, v) + 0.01 * noise,
                        variance: 1e-4,
                    })
                    .unwrap();
            }
            let now = filter.refine(&criteria(curvature)).unwrap();
            println!("curvature {curvature} round {round}: {now:?}");
            divided.extend(now);
        }
        let bumpy = FilterPatch { depth: 0, i: 0, j: 0 };
        let reason = divided.iter().find(|s| s.patch == bumpy).expect("the bump's patch is divided").reason;
        match curvature {
            true => assert!(matches!(reason, SubdivisionReason::CurvatureVariation(x) if x > 0.5)),
            false => assert!(matches!(reason, SubdivisionReason::ChiSquare(x) if x > 3.0)),
        }
        {
            let plain = FilterPatch { depth: 0, i: 1, j: 1 };
            assert!(
                divided.iter().all(|s| s.patch != plain || s.reason == SubdivisionReason::Grading),
                "the flat corner stays whole"
            );
        }
        assert!(filter.patches().iter().all(|p| p.depth <= 3));
    }
}

#[test]
fn invalid_readings_and_options_are_rejected_without_a_change() {
    let mut filter = filter([4, 4], StateLayout::Full, PRIOR);
    let state = filter.state();
    let good = ([1.0, 1.0], DVec3::Z);
    for reading in [
        SurfaceReading::Position { parameters: [f64::NAN, 1.0], point: good.1, variance: 1.0 },
        SurfaceReading::Position { parameters: good.0, point: good.1, variance: -1.0 },
        SurfaceReading::Along {
            parameters: good.0,
            direction: DVec3::new(0.0, 0.0, 2.0),
            value: 1.0,
            variance: 1.0,
        },
        SurfaceReading::PositionWithCovariance {
            parameters: good.0,
            point: good.1,
            covariance: SymmetricMatrix3::from_array([1.0, 2.0, 0.0, 1.0, 0.0, 1.0]),
        },
    ] {
        assert!(filter.observe(&reading).is_err(), "{reading:?}");
    }
    assert_eq!(filter.state(), state);
    let invalid = plane([5, 4]);
    assert!(PatchFilter::new(&invalid, &invalid, PRIOR, PatchFilterOptions::default()).is_err());
    let even = plane([4, 4]);
    let flat = SmoothnessPrior { hold: 0.0, ..PRIOR };
    assert!(PatchFilter::new(&even, &even, flat, PatchFilterOptions::default()).is_err());
    assert!(filter.subdivide(&[FilterPatch { depth: 1, i: 0, j: 0 }]).is_err());
}
