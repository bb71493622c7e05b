//! Positions, normals and curvatures in any mix: the surface is correct, and its σ is consistent.

use planish::fit::{Fit, FitOptions, RefineBy, fit};
use planish::progress::Silent;
use planish_core::vector3::tangents;
use planish_core::{DVec3, SymmetricMatrix3};
use planish_exchange::{PosedScan, ScanSet, Unit};
use planish_sense::{Noise, PrincipalCurvatures, Scan, Sensor, SensorKind};
use planish_spline::{BaseShape, Jet, Shape, Surface, SurfaceSystem, leaf_weights};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SIGMA: f64 = 0.004;
const SIGMA_DEG: f64 = 0.4;
const SIGMA_CURVATURE: f64 = 0.02;

/// Side of the truth's domain, and its cells along each side.
const SIZE: f64 = 10.0;
const CELLS: usize = 8;
/// The spectral density of its curvature, as a standard deviation times a length: 0.04 in a cell. The prior
/// speaks of curvature in the metric of the surface, the truths are drawn in that of the plane: slopes have
/// to be gentle.
const ROUGHNESS: f64 = 0.05;

/// A height field over the square, and how its parameters follow from a place.
struct Truth {
    surface: Surface,
    /// The place of the parameters (0, 0), and the motion of the place with each of them.
    origin: [f64; 2],
    steps: [[f64; 2]; 2],
}

impl Truth {
    /// A field drawn from the thin-plate prior itself over the grid of a flat surface: only then is 95 % what
    /// a true σ covers.
    fn over(plane: &Surface, seed: u64) -> Self {
        let system = SurfaceSystem::new(plane.space()).unwrap();
        let mut precision = system.thin_plate(plane).unwrap();
        for value in precision.values_mut() {
            *value /= ROUGHNESS * ROUGHNESS;
        }
        // A hold on the planes that the energy does not see: nearly level, so that a fit lays its grid as
        // over a flat surface.
        precision.add_diagonal(10.0);
        let factor = system.refactorize_scalar(None, &precision).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut z: Vec<f64> = (0..plane.vertices().len()).map(|_| StandardNormal.sample(&mut rng)).collect();
        factor.solve_lower_transpose_in_place(&mut z).unwrap();
        let vertices = (plane.vertices().iter().zip(&z)).map(|(p, z)| DVec3::new(p[0], p[1], *z));
        let jet = plane.jet(0.0, 0.0);
        let plan = |p: DVec3| [p[0], p[1]];
        Self {
            surface: plane.with_vertices(vertices.collect()).unwrap(),
            origin: plan(jet.point),
            steps: [plan(jet.du), plan(jet.dv)],
        }
    }

    /// Over so many cells a side.
    fn on_cells(cells: usize, seed: u64) -> Self {
        let middle = DVec3::new(0.5 * SIZE, 0.5 * SIZE, 0.0);
        let base = BaseShape::plane(middle, [DVec3::X, DVec3::Y], [0.5 * SIZE; 2]);
        Self::over(&base.surface([cells, cells]).unwrap(), seed)
    }

    /// Over the very grid that a fit of so many readings begins with.
    fn on_grid_of_fit(mix: Mix, seed: u64) -> Self {
        let level = Self::on_cells(1, 0);
        let flat = level.surface.vertices().iter().map(|p| DVec3::new(p[0], p[1], 0.0));
        let level = Self { surface: level.surface.with_vertices(flat.collect()).unwrap(), ..level };
        let options = FitOptions { max_depth: Some(0), shape: Some(Shape::Sheet), ..FitOptions::default() };
        let fit = fit(&readings(&level, mix, seed), &options, &Silent).unwrap();
        // Only the grid of the fit is used, without its noise.
        let base = fit.model.surface.space().base();
        let corner = |u: f64, v: f64| fit.model.surface.jet(u * base[0] as f64, v * base[1] as f64).point;
        let [a, b, c] = [corner(0.0, 0.0), corner(1.0, 0.0), corner(0.0, 1.0)];
        let half = |p: DVec3, q: DVec3| 0.5 * (q - p) * DVec3::new(1.0, 1.0, 0.0);
        let (du, dv) = (half(a, b), half(a, c));
        let (lu, lv) = (du.length(), dv.length());
        let centre = DVec3::new(a[0] + du[0] + dv[0], a[1] + du[1] + dv[1], 0.0);
        let plane = BaseShape::plane(centre, [du / lu, dv / lv], [lu, lv]);
        Self::over(&plane.surface(base).unwrap(), seed)
    }

    fn jet_at(&self, x: f64, y: f64) -> Jet {
        let [du, dv] = self.steps;
        let (x, y) = (x - self.origin[0], y - self.origin[1]);
        let determinant = du[0] * dv[1] - du[1] * dv[0];
        self.surface.jet((x * dv[1] - y * dv[0]) / determinant, (y * du[0] - x * du[1]) / determinant)
    }
}

/// Number of readings of each kind, and ratios of their true to their stated σ.
#[derive(Clone, Copy)]
struct Mix {
    positions: usize,
    normals: usize,
    curvatures: usize,
    stereo: usize,
    misstated: [f64; 3],
}

const NO_READINGS: Mix = Mix { positions: 0, normals: 0, curvatures: 0, stereo: 0, misstated: [1.0; 3] };

/// Noise of a point that two cameras see from 60 above the middle, 20 apart, of 1000 pixels focal length,
/// each match off by σ = 0.05 pixels: along the ray `z² / (f b)` of that, across it `z / f`. And its
/// covariance.
fn stereo_noise(point: DVec3, normal_draws: DVec3) -> (DVec3, SymmetricMatrix3) {
    let seen_from = DVec3::new(0.5 * SIZE, 0.5 * SIZE, 60.0);
    let away = point - seen_from;
    let (ray, z) = (away.try_normalize().unwrap(), -away[2]);
    let (along, across) = (z * z / (1000.0 * 20.0) * 0.05, z / 1000.0 * 0.05);
    let (e1, e2) = tangents(ray);
    let noise = ray.map(|c| c * along * normal_draws[0]) + across * normal_draws[1] * e1;
    let noise = noise + across * normal_draws[2] * e2;
    let covariance = SymmetricMatrix3::from_entries(|a, b| {
        let same = if a == b { across * across } else { 0.0 };
        same + (along * along - across * across) * ray[a] * ray[b]
    });
    (noise, covariance)
}

fn readings(truth: &Truth, mix: Mix, seed: u64) -> ScanSet {
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
        Sensor { name: "pair".to_owned(), kind: SensorKind::Stereo, ..Sensor::default() },
    ];
    let mut set = ScanSet { unit: Some(Unit::Millimetre), sensors, ..ScanSet::default() };
    for (sensor, count) in [mix.positions, mix.normals, mix.curvatures, mix.stereo].into_iter().enumerate() {
        if count == 0 {
            continue;
        }
        let mut scan = Scan { name: set.sensors[sensor].name.clone(), ..Scan::default() };
        let (mut normals, mut curvatures, mut covariances) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..count {
            // Four positions stand near the corners.
            let (x, y) = if count <= 4 {
                ([1.0, 9.0][k % 2], [1.0, 9.0][k / 2 % 2])
            } else {
                (SIZE * rng.random::<f64>(), SIZE * rng.random::<f64>())
            };
            let jet = truth.jet_at(x, y);
            let (normal, curvature) = (jet.normal().unwrap(), jet.curvature().unwrap());
            let mut point = jet.point;
            if sensor == 0 {
                point = point.map(|c| c + mix.misstated[0] * SIGMA * draw(&mut rng));
            }
            if sensor == 3 {
                let (noise, covariance) =
                    stereo_noise(point, DVec3::from_array([(); 3].map(|()| draw(&mut rng))));
                point += noise;
                covariances.push(covariance);
            }
            scan.points.push(point);
            let sigma = mix.misstated[1] * SIGMA_DEG.to_radians();
            let (e1, e2) = tangents(normal);
            let tilted = normal + sigma * draw(&mut rng) * e1 + sigma * draw(&mut rng) * e2;
            normals.push((if sensor == 1 { tilted } else { normal }).try_normalize().unwrap());
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
                direction: d1.map(|x| x * angle.cos()) + angle.sin() * d2,
            });
        }
        if sensor == 3 {
            scan.covariance = Some(covariances);
        }
        if sensor > 0 {
            scan.normals = Some(normals);
        }
        if sensor == 2 {
            scan.curvatures = Some(curvatures);
        }
        set.scans.push(PosedScan { scan, sensor, sigma_translation: None, sigma_rotation_deg: None });
    }
    set
}

fn fitted(truth: &Truth, mix: Mix, seed: u64, refine_by: RefineBy) -> Fit {
    let options = FitOptions { shape: Some(Shape::Sheet), refine_by, ..FitOptions::default() };
    fit(&readings(truth, mix, seed), &options, &Silent).unwrap()
}

/// Errors along the normal at the middles of the leaves inside, each with its stated σ.
fn errors(fit: &Fit, truth: &Truth) -> Vec<(f64, f64)> {
    let surface = &fit.model.surface;
    let posterior = fit.posterior();
    (0..surface.space().leaves().len())
        .filter_map(|leaf| {
            let jet = surface.leaf_jet(leaf, 0.5, 0.5);
            let DVec3 { x, y, z } = jet.point;
            if !(0.5..9.5).contains(&x) || !(0.5..9.5).contains(&y) {
                return None;
            }
            let normal = jet.normal().unwrap();
            let true_jet = truth.jet_at(x, y);
            let n = true_jet.normal().unwrap();
            let error = (z - true_jet.point[2]) * n[2] * n.dot(normal).signum();
            let variance = posterior.leaf(leaf).unwrap().variance_along(&leaf_weights(0.5, 0.5), normal);
            Some((error, variance.sqrt()))
        })
        .collect()
}

/// Root mean square of the errors and how often 1.96 σ hold them.
fn judged(name: &str, all: &[(f64, f64)]) -> (f64, f64) {
    let n = all.len() as f64;
    let rms = (all.iter().map(|(e, _)| e * e).sum::<f64>() / n).sqrt();
    let sigma = (all.iter().map(|(_, s)| s * s).sum::<f64>() / n).sqrt();
    let covered = all.iter().filter(|(e, s)| e.abs() < 1.96 * s).count() as f64 / n;
    println!("{name}: rms {rms:.5}, σ {sigma:.5}, covered {covered:.4} of {n}");
    (rms, covered)
}

/// Coverage of each mix by itself and of all together, over so many truths drawn from the prior.
fn every_mix(seeds: u64) -> Vec<(&'static str, f64, f64)> {
    let positions = Mix { positions: 2_000, ..NO_READINGS };
    let anchored = Mix { positions: 4, ..NO_READINGS };
    let normals = Mix { normals: 3_000, ..anchored };
    let curvatures = Mix { curvatures: 3_000, ..anchored };
    let stereo = Mix { stereo: 2_000, ..anchored };
    let all = Mix { normals: 2_000, curvatures: 500, stereo: 1_000, ..positions };
    [
        ("positions", positions),
        ("normals", normals),
        ("curvatures", curvatures),
        ("stereo", stereo),
        ("all", all),
    ]
    .into_iter()
    .map(|(name, mix)| {
        let errors: Vec<(f64, f64)> = (0..seeds)
            .flat_map(|seed| {
                let truth = Truth::on_grid_of_fit(mix, seed);
                errors(&fitted(&truth, mix, seed, RefineBy::Residuals), &truth)
            })
            .collect();
        let (rms, covered) = judged(name, &errors);
        (name, rms, covered)
    })
    .collect()
}

#[test]
fn every_mix_of_quantities_is_covered_by_its_sigma() {
    let judged = every_mix(6);
    for (name, _, covered) in &judged {
        // Four anchors place a whole surface, so few truths are few independent errors.
        assert!((0.88..=1.0).contains(covered), "{name}: {covered}");
    }
    let (alone, mixed) = (judged[0].1, judged[4].1);
    assert!(mixed < 0.75 * alone, "normals add nothing: {mixed} {alone}");
}

/// `cargo test --release -p planish --test it quantities -- --ignored --nocapture`: three minutes.
#[test]
#[ignore = "heavy statistics"]
fn every_mix_of_many_truths_is_covered_by_its_sigma() {
    for (name, _, covered) in every_mix(120) {
        assert!((0.93..0.97).contains(&covered), "{name}: {covered}");
    }
}

/// A surface as rough as its thin plate allows has detail in every cell that residuals do not show.
#[test]
fn sigma_of_a_rough_surface_is_calibrated_with_division_by_roughness() {
    let positions = Mix { positions: 2_000, ..NO_READINGS };
    let covered = |refine_by: RefineBy| {
        let errors: Vec<(f64, f64)> = (10..14)
            .flat_map(|seed| {
                let truth = Truth::on_cells(32, seed);
                errors(&fitted(&truth, positions, seed, refine_by), &truth)
            })
            .collect();
        judged(&format!("rough, {refine_by:?}"), &errors).1
    };
    let (without, with) = (covered(RefineBy::Residuals), covered(RefineBy::Roughness));
    assert!((0.92..0.98).contains(&with), "{with}");
    assert!(without < 0.9, "nothing was to be gained: {without}, {with}");
}

#[test]
fn a_misstated_sigma_of_any_quantity_is_detected() {
    let mix =
        Mix { positions: 2_000, normals: 2_000, curvatures: 2_000, stereo: 0, misstated: [1.0, 3.0, 0.4] };
    let options = FitOptions { shape: Some(Shape::Sheet), estimate_sigma: true, ..FitOptions::default() };
    let report = fit(&readings(&Truth::on_cells(CELLS, 3), mix, 3), &options, &Silent).unwrap().report;
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
