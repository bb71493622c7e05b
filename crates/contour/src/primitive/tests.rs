//! Laws of shapes in space: derivatives match differences, and fits recover simulated shapes within their
//! covariance.

use super::ray::ShapeReading;
use super::shape::Chart;
use super::*;
use crate::planar::{ContourFitOptions, Method};
use nalgebra::Vector3;
use planish_core::DVec3;
use planish_estimate::implicit::ImplicitReading;

const SENSOR: SpaceSensor =
    SpaceSensor { standoff: 3.0, sigma_position: 0.01, sigma_angle_rad: 0.0175, sigma_range_share: 0.005 };

fn solids() -> Vec<SimulatedPrimitive> {
    let solid = |shape, size| SimulatedPrimitive {
        shape,
        center: DVec3::new(0.3, -0.2, 0.5),
        turn: DVec3::new(0.3, -0.5, 0.7),
        size,
    };
    vec![
        solid(PrimitiveKind::Plane, [1.5, 1.2, 0.0]),
        solid(PrimitiveKind::Sphere, [0.8, 0.0, 0.0]),
        solid(PrimitiveKind::Cylinder, [0.5, 1.6, 0.0]),
        solid(PrimitiveKind::Box, [1.4, 1.0, 0.7]),
    ]
}

#[test]
fn derivatives_match_differences() {
    let ray = Ray {
        target: RayTarget::Range {
            origin: DVec3::new(2.0, 1.0, 0.4),
            direction_rad: [3.5, -0.2],
            range: 1.3,
            sigma: [0.02, 0.03, 0.01, 0.04, 0.05, 0.02],
        },
        line: 1,
    };
    let chart = Chart::along(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.2, 0.3, 0.9));
    for shape in PrimitiveKind::ALL {
        let reading = ShapeReading { shape, chart: &chart, ray: &ray };
        let (n, p) = (reading.state(), reading.noise());
        let x: Vec<f64> = (0..n).map(|k| 0.3 + 0.1 * k as f64).collect();
        let u = vec![0.4; p];
        for branch in 0..reading.branches() {
            let value = |x: &[f64], u: &[f64]| {
                let (mut h, mut d) = (vec![0.0; n], vec![0.0; p]);
                let g = reading.gradient(branch, x, u, &mut h, &mut d);
                (g, [h, d].concat())
            };
            let stated = value(&x, &u).1;
            for k in 0..n + p {
                let moved = |step: f64| {
                    let mut both = [&x[..], &u[..]].concat();
                    both[k] += step;
                    value(&both[..n], &both[n..]).0
                };
                let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                assert!((difference - stated[k]).abs() < 1e-7, "{shape} {branch} {k}: {difference}");
            }
        }
    }
}

#[test]
fn simulated_shapes_are_recovered_within_their_covariance() {
    for solid in solids() {
        for method in [Method::Batch, Method::NoiseUpdated] {
            let options = ContourFitOptions { method, ..ContourFitOptions::default() };
            let truth = solid.parameters();
            let (mut sum, mut count) = (0.0, 0.0);
            for seed in 0..20 {
                let made = rays(&solid, 200, &SENSOR, seed);
                let found = fit(solid.shape, &made.noisy, &options).expect("a fit");
                // Reported directions make the covariance singular: each σ is judged separately.
                for k in 0..truth.len() {
                    if solid.shape == PrimitiveKind::Cylinder && k < 3 {
                        continue;
                    }
                    sum += (found.parameters[k] - truth[k]).powi(2) / found.covariance[(k, k)];
                    count += 1.0;
                }
            }
            assert!((0.7..1.4).contains(&(sum / count)), "{} {method:?}: {}", solid.shape, sum / count);
        }
    }
}

#[test]
fn axis_of_a_cylinder_passes_through_its_centre() {
    let solid = solids()[2];
    let made = rays(&solid, 300, &SENSOR, 5);
    let found = fit(PrimitiveKind::Cylinder, &made.noisy, &ContourFitOptions::default()).expect("a fit");
    let axis = Vector3::new(found.parameters[3], found.parameters[4], found.parameters[5]);
    let point = Vector3::new(found.parameters[0], found.parameters[1], found.parameters[2]);
    let off = Vector3::from(solid.center) - point;
    assert!((off - axis * axis.dot(&off)).norm() < 0.02);
}

#[test]
fn the_true_shape_is_chosen() {
    for solid in solids() {
        let made = rays(&solid, 200, &SENSOR, 3);
        let (best, others) =
            choose(&PrimitiveKind::ALL, &made.noisy, &ContourFitOptions::default()).expect("a choice");
        assert_eq!(best.shape, solid.shape, "{others:?}");
    }
}

#[test]
fn one_side_does_not_determine_a_box() {
    let solid = solids()[3];
    let turned = nalgebra::Rotation3::new(Vector3::from(solid.turn));
    let mut made = rays(&solid, 600, &SENSOR, 3).exact;
    // One side only.
    made.retain(|ray| {
        let q = turned.inverse() * (Vector3::from(ray.point()) - Vector3::from(solid.center));
        (q.x - 0.5 * solid.size[0]).abs() < 1e-9
    });
    let refused = fit(PrimitiveKind::Box, &made, &ContourFitOptions::default());
    assert!(refused.is_err(), "{refused:?}");
}
