use crate::base::fit_function;
use crate::hierarchy::{Hierarchy, Shape};
use crate::patch_filter::{
    PatchFilter, PatchFilterOptions, SmoothnessPrior, StateLayout, SubdivisionCriteria, SubdivisionReason,
    SurfaceReading, parameter_plane, reading::EquationKind,
};
use crate::surface::{Surface, leaf_weights};
use crate::system::SurfaceSystem;
use nalgebra::DMatrix;
use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::sparse::BlockInformation;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;

const PRIOR: SmoothnessPrior = SmoothnessPrior { weight: 3.0, hold: 0.02 };
const UP: DVec3 = DVec3::Z;

fn plane(base: [usize; 2]) -> Surface {
    parameter_plane(&Arc::new(Hierarchy::uniform(Shape::Sheet, base).unwrap())).unwrap()
}

fn options(layout: StateLayout, maximum_depth: u8) -> PatchFilterOptions {
    PatchFilterOptions { layout, maximum_depth, min_gain: 1e-9, ..PatchFilterOptions::default() }
}

/// Heights over a plane, with some normals between them.
fn readings(base: [usize; 2], count: usize, sigma: f64, seed: u64) -> Vec<SurfaceReading> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let [u, v] = base.map(|n| n as f64 * random.random::<f64>());
            let noise: f64 = Distribution::<f64>::sample(&StandardNormal, &mut random);
            SurfaceReading::Along {
                parameters: [u, v],
                direction: UP,
                value: 0.1 * (0.9 * u).sin() * (0.7 * v).cos() + sigma * noise,
                variance: sigma * sigma,
            }
        })
        .collect()
}

/// If all readings are along one normal, the filter along normals equals the filter of heights.
#[test]
fn along_one_normal_it_equals_the_filter_of_heights() {
    let base = [8, 4];
    let flat = plane(base);
    let [mut heights, mut along] = [StateLayout::Height, StateLayout::Normal]
        .map(|layout| PatchFilter::new(&flat, &flat, PRIOR, options(layout, 1)).unwrap());
    for filter in [&mut heights, &mut along] {
        for reading in readings(base, 120, 0.03, 3) {
            filter.observe(&reading).unwrap();
        }
        filter.subdivide(&[filter.patches()[0]]).unwrap();
        for reading in readings(base, 60, 0.03, 4) {
            filter.observe(&reading).unwrap();
        }
        filter.reconcile().unwrap();
    }
    for [u, v] in [[0.3, 0.4], [3.9, 2.2], [4.1, 1.0], [7.5, 3.5]] {
        let (a, b) = (heights.jet(u, v).point[2], along.jet(u, v).point[2]);
        assert!((a - b).abs() < 1e-10, "{a} {b}");
        let (a, b) = (heights.variance_along(u, v, UP), along.variance_along(u, v, UP));
        assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
    }
    let position =
        SurfaceReading::Position { parameters: [1.0, 1.0], point: DVec3::new(1.0, 1.0, 0.0), variance: 1.0 };
    assert!(along.observe(&position).is_err(), "its parameters would count as measured");
}

/// A first fit followed by a stream gives the same belief as streaming all readings.
#[test]
fn a_first_fit_and_a_stream_equal_a_stream_alone() {
    let base = [4, 4];
    let flat = plane(base);
    let all = readings(base, 80, 0.05, 7);
    let system = SurfaceSystem::new(flat.space()).unwrap();
    let mut data = BlockInformation::zeros(Arc::clone(system.pattern()), 1, 3).unwrap();
    for reading in &all[..40] {
        let SurfaceReading::Along { parameters: [u, v], value, variance, .. } = *reading else {
            panic!("heights alone")
        };
        let (leaf, [s, t]) = flat.space().locate(u, v);
        let (nodes, weights) = flat.space().extraction(leaf);
        let c = leaf_weights(s, t);
        let row: Vec<f64> = weights.iter().map(|w| w.iter().zip(&c).map(|(a, b)| a * b).sum()).collect();
        let matrix: Vec<f64> = (row.iter()).flat_map(|a| row.iter().map(move |b| a * b / variance)).collect();
        let vector: Vec<f64> = row.iter().flat_map(|a| [0.0, 0.0, a * value / variance]).collect();
        data.add_element(nodes, &matrix, &vector).unwrap();
    }
    data.add_scaled(&PRIOR.information(&system, &flat).unwrap(), 1.0).unwrap();
    let factor = system.factorize_scalar(&data).unwrap();
    let mut x = data.vector().to_vec();
    factor.solve_in_place(&mut x).unwrap();
    let vertices = (flat.vertices().iter().zip(x.chunks_exact(3)))
        .map(|(p, x)| DVec3::new(p.x, p.y, p.z + x[2]))
        .collect();
    let fitted = flat.with_vertices(vertices).unwrap();
    let layout = options(StateLayout::Normal, 0);
    let mut first = PatchFilter::from_first_fit(&fitted, &flat, PRIOR, &data, layout).unwrap();
    let mut alone = PatchFilter::new(&flat, &flat, PRIOR, layout).unwrap();
    for reading in &all[40..] {
        first.observe(reading).unwrap();
    }
    for reading in &all {
        alone.observe(reading).unwrap();
    }
    for [u, v] in [[0.3, 0.4], [2.0, 2.2], [3.8, 1.0]] {
        let (a, b) = (first.jet(u, v).point[2], alone.jet(u, v).point[2]);
        assert!((a - b).abs() < 1e-9, "{a} {b}");
        let (a, b) = (first.variance_along(u, v, UP), alone.variance_along(u, v, UP));
        assert!((a / b - 1.0).abs() < 1e-8, "{a} {b}");
    }
}

/// A single outlier is rejected and changes nothing. A step confirmed by most readings is used and causes
/// subdivision.
#[test]
fn outliers_are_rejected_and_shape_is_not() {
    let base = [4, 4];
    let flat = plane(base);
    let mut filter = PatchFilter::new(&flat, &flat, PRIOR, options(StateLayout::Normal, 2)).unwrap();
    for reading in readings(base, 200, 0.02, 11) {
        filter.observe_within(&reading, 4.0).unwrap();
    }
    let before = filter.belief(0).clone();
    let outlier =
        |u: f64| SurfaceReading::Along { parameters: [u, 2.5], direction: UP, value: 0.9, variance: 4e-4 };
    let update = filter.observe_within(&outlier(2.5), 4.0).unwrap();
    assert!(!update.within_gate && update.normalized_squared == 0.0);
    assert_eq!(filter.belief(0), &before);
    assert_eq!(filter.readings(), 200);
    let criteria = SubdivisionCriteria { curvature_variation: None, ..SubdivisionCriteria::default() };
    assert!(filter.clone().refine(&criteria).unwrap().is_empty(), "a single outlier is not shape");
    for k in 0..60 {
        filter.observe_within(&outlier(2.2 + 0.01 * f64::from(k)), 4.0).unwrap();
    }
    assert!(filter.readings() > 220, "{} readings used", filter.readings());
    let subdivided = filter.refine(&criteria).unwrap();
    assert!(
        matches!(subdivided[..], [one] if matches!(one.reason, SubdivisionReason::ChiSquare(_))),
        "{subdivided:?}"
    );
    for k in 0..300 {
        filter.observe_within(&outlier(2.2 + 0.01 * f64::from(k % 60)), 4.0).unwrap();
    }
    let height = filter.jet(2.5, 2.5).point[2];
    assert!((height - 0.9).abs() < 0.1, "{height}");
}

/// A bowl over one patch.
fn bowl() -> Surface {
    let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [4, 4]).unwrap());
    fit_function(&space, |u, v| DVec3::new(u, v, 0.08 * ((u - 2.0).powi(2) + 0.5 * (v - 1.5).powi(2))))
        .unwrap()
}

/// Positions with anisotropic noise, normals and curvatures near the bowl.
fn mixed(bowl: &Surface, count: usize) -> Vec<SurfaceReading> {
    let mut random = ChaCha8Rng::seed_from_u64(31);
    (0..count)
        .map(|k| {
            let parameters = [0, 1].map(|_| 4.0 * random.random::<f64>());
            let mut noise =
                |sigma: f64| -> f64 { sigma * Distribution::<f64>::sample(&StandardNormal, &mut random) };
            let jet = bowl.jet(parameters[0], parameters[1]);
            let normal = jet.normal().unwrap();
            let tilted = normal.map(|c| c + noise(0.02)).try_normalize().unwrap();
            match k % 3 {
                0 => SurfaceReading::PositionWithCovariance {
                    parameters,
                    point: jet.point.map(|c| c + 0.2 + noise(0.03)),
                    covariance: SymmetricMatrix3::from_array([1e-3, 2e-4, 0.0, 2e-3, -1e-4, 5e-4]),
                },
                1 => SurfaceReading::Normal { parameters, normal: tilted, sigma_rad: 0.02 },
                _ => {
                    let along = tilted.cross(DVec3::Y).try_normalize().unwrap();
                    SurfaceReading::Curvature {
                        parameters,
                        normal: tilted,
                        principal: [0.16 + noise(0.02), 0.08 + noise(0.02)],
                        directions: [along, tilted.cross(along)],
                        sigma: 0.02,
                    }
                }
            }
        })
        .collect()
}

/// The mean of the global filter, all readings linearised at one surface: the sum of their information.
fn global_mean(at: &Surface, readings: &[SurfaceReading]) -> DMatrix<f64> {
    let space = at.space();
    let system = SurfaceSystem::new(space).unwrap();
    let mut information = (PRIOR.information(&system, &plane([4, 4])).unwrap().to_dense())
        .kronecker(&DMatrix::<f64>::identity(3, 3));
    let size = information.nrows();
    let mut vector = &information * DMatrix::from_fn(size, 1, |k, _| at.vertices()[k / 3][k % 3]);
    for reading in readings {
        let [u, v] = reading.parameters();
        let (leaf, local) = space.locate(u, v);
        let mut equations = [None; 3];
        let jet = || at.leaf_jet(leaf, local[0], local[1]);
        reading.equations(local, 1.0, jet, &mut equations).unwrap();
        let (nodes, weights) = space.extraction(leaf);
        for equation in equations.iter().flatten() {
            let EquationKind::Form(form, value) = equation.what else {
                panic!("every reading of the test is along a direction")
            };
            let mut row = DMatrix::zeros(size, 1);
            for (&node, w) in nodes.iter().zip(weights) {
                for k in 0..16 {
                    for d in 0..3 {
                        row[(3 * node as usize + d, 0)] += w[k] * form[k][d];
                    }
                }
            }
            information += &row * row.transpose() / equation.variance;
            vector += row * (value / equation.variance);
        }
    }
    information.cholesky().unwrap().solve(&vector)
}

/// The order of readings must not matter: twenty orders of positions, normals and curvatures give one surface
/// in both filters.
#[test]
fn twenty_orders_of_a_mixed_set_give_one_surface() {
    let bowl = bowl();
    let mut readings = mixed(&bowl, 150);
    let mut random = ChaCha8Rng::seed_from_u64(37);
    let options = PatchFilterOptions { linearize_at_initial: true, ..options(StateLayout::Full, 0) };
    let mut first: Option<[Surface; 2]> = None;
    for _ in 0..20 {
        readings.shuffle(&mut random);
        let mut filter = PatchFilter::new(&bowl, &plane([4, 4]), PRIOR, options).unwrap();
        for reading in &readings {
            filter.observe(reading).unwrap();
        }
        let mean = global_mean(&bowl, &readings);
        let vertices = mean.as_slice().chunks_exact(3).map(DVec3::from_slice).collect();
        let found = [filter.surface().unwrap(), bowl.with_vertices(vertices).unwrap()];
        let [patch, global] = first.get_or_insert_with(|| found.clone());
        for (a, b) in [(&found[0], &*patch), (&found[1], &*global), (&found[0], &found[1])] {
            let off = (a.vertices().iter().zip(b.vertices()))
                .map(|(a, b)| (a - b).abs().max_element())
                .fold(0.0, f64::max);
            assert!(off < 1e-9, "{off}");
        }
    }
    let moved = first.unwrap()[0].point(2.0, 2.0)[2] - bowl.point(2.0, 2.0)[2];
    assert!(moved > 0.1, "the readings lie 0.2 higher, the surface moved by {moved}");
}
