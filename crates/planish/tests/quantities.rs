//! Positions, normals and curvatures in any mix: is the surface right, and are its σ true?

// Helpers of tests may unwrap and print as tests do.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use planish::fit::{Fit, FitOptions, fit};
use planish::progress::Silent;
use planish_estimate::vector3::{add_scaled, dot, tangents, unit};
use planish_exchange::{PosedScan, ScanSet, Unit};
use planish_sense::{Noise, PrincipalCurvatures, Scan, Sensor, SensorKind};
use planish_spline::{BaseShape, Jet, Shape, Surface, SurfaceSystem, leaf_weights};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SIGMA: f64 = 0.01;
const SIGMA_DEG: f64 = 1.0;
const SIGMA_CURVATURE: f64 = 0.05;

/// Side of the truth's domain, and its cells along each side.
const SIZE: f64 = 10.0;
const CELLS: usize = 8;
/// Its curvature's standard deviation, times the root of the area of a cell.
const BENT: f64 = 0.1;

/// A height field drawn from the thin-plate prior itself: only then is 95 % what a true σ covers.
fn truth(seed: u64) -> Surface {
    let base = BaseShape::plane(
        [0.5 * SIZE, 0.5 * SIZE, 0.0],
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [0.5 * SIZE; 2],
    );
    let plane = base.surface([CELLS, CELLS]).unwrap();
    let system = SurfaceSystem::new(plane.space()).unwrap();
    let mut precision = system.thin_plate(&plane).unwrap();
    let area = (SIZE / CELLS as f64).powi(2);
    for value in precision.values_mut() {
        *value /= BENT * BENT * area;
    }
    // A loose hold on the planes that the energy does not see.
    precision.add_diagonal(1e-2);
    let factor = system.refactorize_scalar(None, &precision).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut z: Vec<f64> = (0..plane.vertices().len())
        .map(|_| StandardNormal.sample(&mut rng))
        .collect();
    factor.solve_lower_transpose_in_place(&mut z).unwrap();
    let vertices = (plane.vertices().iter().zip(&z)).map(|(p, z)| [p[0], p[1], *z]);
    plane.with_vertices(vertices.collect()).unwrap()
}

fn jet_at(truth: &Surface, x: f64, y: f64) -> Jet {
    let scale = CELLS as f64 / SIZE;
    truth.jet(scale * x, scale * y)
}

/// How many readings of each kind, and what their true σ are over those stated.
#[derive(Clone, Copy)]
struct Mix {
    positions: usize,
    normals: usize,
    curvatures: usize,
    misstated: [f64; 3],
}

const NOTHING: Mix = Mix {
    positions: 0,
    normals: 0,
    curvatures: 0,
    misstated: [1.0; 3],
};

fn readings(truth: &Surface, mix: Mix, seed: u64) -> ScanSet {
    let mut rng = ChaCha8Rng::seed_from_u64(100 + seed);
    let draw = |rng: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(rng) };
    let sensors = vec![
        Sensor {
            name: "laser".to_owned(),
            noise: Some(Noise::Isotropic { sigma: SIGMA }),
            ..Sensor::default()
        },
        Sensor {
            name: "photometric".to_owned(),
            kind: SensorKind::Normal,
            sigma_normal_deg: Some(SIGMA_DEG),
            ..Sensor::default()
        },
        Sensor {
            name: "stripes".to_owned(),
            kind: SensorKind::Curvature,
            sigma_curvature: Some(SIGMA_CURVATURE),
            ..Sensor::default()
        },
    ];
    let mut set = ScanSet {
        unit: Some(Unit::Millimetre),
        sensors,
        ..ScanSet::default()
    };
    for (sensor, count) in [mix.positions, mix.normals, mix.curvatures].into_iter().enumerate() {
        if count == 0 {
            continue;
        }
        let mut scan = Scan {
            name: set.sensors[sensor].name.clone(),
            ..Scan::default()
        };
        let (mut normals, mut curvatures) = (Vec::new(), Vec::new());
        for k in 0..count {
            // Four positions stand near the corners.
            let (x, y) = if count <= 4 {
                ([1.0, 9.0][k % 2], [1.0, 9.0][k / 2 % 2])
            } else {
                (SIZE * rng.random::<f64>(), SIZE * rng.random::<f64>())
            };
            let jet = jet_at(truth, x, y);
            let (normal, curvature) = (jet.normal().unwrap(), jet.curvature().unwrap());
            let mut point = jet.point;
            if sensor == 0 {
                point = point.map(|c| c + mix.misstated[0] * SIGMA * draw(&mut rng));
            }
            scan.points.push(point);
            let sigma = mix.misstated[1] * SIGMA_DEG.to_radians();
            let (e1, e2) = tangents(normal);
            let tilted = add_scaled(
                add_scaled(normal, sigma * draw(&mut rng), e1),
                sigma * draw(&mut rng),
                e2,
            );
            normals.push(unit(if sensor == 1 { tilted } else { normal }).unwrap());
            // Isotropic noise on the tensor: σ on the diagonal, σ/√2 off it, in any frame.
            let sigma = mix.misstated[2] * SIGMA_CURVATURE;
            let [d1, d2] = curvature.directions;
            let [a, b, c] = [
                curvature.principal[0] + sigma * draw(&mut rng),
                sigma / std::f64::consts::SQRT_2 * draw(&mut rng),
                curvature.principal[1] + sigma * draw(&mut rng),
            ];
            let (mean, half) = (0.5 * (a + c), 0.5 * (a - c));
            let angle = 0.5 * b.atan2(half);
            curvatures.push(PrincipalCurvatures {
                values: [mean + half.hypot(b), mean - half.hypot(b)],
                direction: add_scaled(d1.map(|x| x * angle.cos()), angle.sin(), d2),
            });
        }
        if sensor > 0 {
            scan.normals = Some(normals);
        }
        if sensor == 2 {
            scan.curvatures = Some(curvatures);
        }
        set.scans.push(PosedScan {
            scan,
            sensor,
            sigma_translation: None,
            sigma_rotation_deg: None,
        });
    }
    set
}

fn fitted(truth: &Surface, mix: Mix, seed: u64) -> Fit {
    let options = FitOptions {
        shape: Some(Shape::Sheet),
        ..FitOptions::default()
    };
    fit(&readings(truth, mix, seed), &options, &Silent).unwrap()
}

/// Errors along the normal at the middles of the leaves inside, each with its stated σ.
fn errors(fit: &Fit, truth: &Surface) -> Vec<(f64, f64)> {
    let surface = &fit.model.surface;
    let posterior = fit.posterior();
    (0..surface.space().leaves().len())
        .filter_map(|leaf| {
            let jet = surface.leaf_jet(leaf, 0.5, 0.5);
            let [x, y, z] = jet.point;
            if !(0.5..9.5).contains(&x) || !(0.5..9.5).contains(&y) {
                return None;
            }
            let normal = jet.normal().unwrap();
            let true_jet = jet_at(truth, x, y);
            let n = true_jet.normal().unwrap();
            let error = (z - true_jet.point[2]) * n[2] * dot(n, normal).signum();
            let variance = posterior
                .leaf(leaf)
                .unwrap()
                .variance_along(&leaf_weights(0.5, 0.5), normal);
            Some((error, variance.sqrt()))
        })
        .collect()
}

/// Root mean square of the errors and how often 1.96 σ hold them, over several truths.
fn judged(name: &str, mix: Mix, seeds: u64) -> (f64, f64) {
    let all: Vec<(f64, f64)> = (0..seeds)
        .flat_map(|seed| {
            let truth = truth(seed);
            errors(&fitted(&truth, mix, seed), &truth)
        })
        .collect();
    let n = all.len() as f64;
    let rms = (all.iter().map(|(e, _)| e * e).sum::<f64>() / n).sqrt();
    let sigma = (all.iter().map(|(_, s)| s * s).sum::<f64>() / n).sqrt();
    let covered = all.iter().filter(|(e, s)| e.abs() < 1.96 * s).count() as f64 / n;
    println!("{name}: rms {rms:.5}, σ {sigma:.5}, covered {covered:.4} of {n}");
    (rms, covered)
}

#[test]
fn every_mix_of_quantities_is_covered_by_its_sigma() {
    let positions = Mix {
        positions: 2_000,
        ..NOTHING
    };
    let (alone, covered) = judged("positions", positions, 6);
    assert!((0.88..0.98).contains(&covered), "{covered}");
    let anchored = Mix {
        positions: 4,
        ..NOTHING
    };
    let only = |name: &str, mix: Mix| {
        let (_, covered) = judged(name, mix, 6);
        assert!(covered > 0.92, "{name}: {covered}");
    };
    only(
        "normals",
        Mix {
            normals: 3_000,
            ..anchored
        },
    );
    only(
        "curvatures",
        Mix {
            curvatures: 3_000,
            ..anchored
        },
    );
    let mixed = Mix {
        normals: 2_000,
        curvatures: 500,
        ..positions
    };
    let (rms, covered) = judged("all", mixed, 6);
    assert!(rms < 0.75 * alone, "normals add nothing: {rms} {alone}");
    assert!((0.91..0.98).contains(&covered), "{covered}");
}

#[test]
fn a_misstated_sigma_of_any_quantity_is_found_out() {
    let mix = Mix {
        positions: 2_000,
        normals: 2_000,
        curvatures: 2_000,
        misstated: [1.0, 3.0, 0.4],
    };
    let report = fitted(&truth(3), mix, 3).report;
    for (sensor, (quantity, sigma)) in report.sensors.iter().zip([
        ("position", SIGMA),
        ("normal", 3.0 * SIGMA_DEG),
        ("curvature", 0.4 * SIGMA_CURVATURE),
    ]) {
        println!("{sensor:?}");
        assert_eq!(sensor.quantity, quantity);
        assert!((sensor.sigma_estimated / sigma - 1.0).abs() < 0.1, "{sensor:?}");
        assert_eq!(sensor.sigma_used_is_estimated, quantity != "position");
    }
}
