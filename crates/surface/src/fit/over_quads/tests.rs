//! Fits of objects with handles.

use crate::export::{BrepOptions, brep_from_model, mesh_from_model};
use crate::fit::{Fit, FitOptions, FitVerdict, GlobalOptions, Strategy, fit};
use planish_core::{BoundingBox, DVec3, Silent};
use planish_exchange::{PosedScan, ScanSet, Unit};
use planish_mesh::isosurface;
use planish_sense::{Noise, Scan, Sensor};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const SIGMA: f64 = 0.1;

/// Height above two rings that are joined smoothly, and its gradient.
fn two_rings(p: DVec3) -> (f64, DVec3) {
    let (mut sum, mut slope) = (0.0, DVec3::ZERO);
    for x in [-20.0, 20.0] {
        let q = p - DVec3::new(x, 0.05 * x, 0.0);
        let (out, up) = (q.truncate().length() - 20.0, q.z);
        let distance = out.hypot(up).max(1e-12);
        let along = q.truncate().normalize_or_zero().extend(0.0);
        let weight = (-0.3 * distance).exp();
        sum += weight;
        slope += weight / distance * (out * along + up * DVec3::Z);
    }
    (-sum.ln() / 0.3 - 7.0, slope / sum)
}

/// Readings all over the two rings.
fn scan(count: usize, seed: u64) -> ScanSet {
    let bounds = BoundingBox { min: DVec3::splat(-50.0), max: DVec3::splat(50.0) };
    let mesh = isosurface(&bounds, 2.0, |p| two_rings(p).0, |_, _| true).unwrap();
    let mut until = 0.0;
    let areas: Vec<f64> = (0..mesh.triangles.len())
        .map(|k| {
            let [a, b, c] = mesh.corners(k);
            until += (b - a).cross(c - a).length();
            until
        })
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let at = rng.random_range(0.0..until);
        let [a, b, c] = mesh.corners(areas.partition_point(|area| *area < at).min(areas.len() - 1));
        let (s, t): (f64, f64) = (rng.random(), rng.random());
        let (s, t) = if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) };
        let mut p = a + s * (b - a) + t * (c - a);
        for _ in 0..5 {
            let (height, slope) = two_rings(p);
            p -= height / slope.length_squared() * slope;
        }
        normals.push(two_rings(p).1.normalize());
        points.push(p + SIGMA * DVec3::from_array([0; 3].map(|_| rng.sample::<f64, _>(StandardNormal))));
    }
    let scan = Scan { name: "rings".to_owned(), points, normals: Some(normals), ..Scan::default() };
    let sensor = Sensor { noise: Some(Noise::Isotropic { sigma: SIGMA }), ..Sensor::default() };
    ScanSet {
        unit: Some(Unit::Millimetre),
        sensors: vec![sensor],
        scans: vec![PosedScan { scan, sensor: 0, sigma_translation: None, sigma_rotation_deg: None }],
        ..ScanSet::default()
    }
}

fn fitted(count: usize, seed: u64) -> Fit {
    let strategy = Strategy::Global(GlobalOptions::default());
    fit(&scan(count, seed), &FitOptions { strategy, ..FitOptions::default() }, &Silent).unwrap()
}

#[test]
fn two_rings_are_fitted_and_covered() {
    let made = fitted(10_000, 1);
    let model = &made.model;
    let domain = model.surface.space().domain().expect("a ball has no handles");
    assert_eq!((domain.genus(), domain.components(), domain.borders()), (2, 1, 0));
    assert_eq!(made.report.verdict, FitVerdict::Converged);
    let mesh = mesh_from_model(model, &made.posterior(), Some(0.1)).unwrap();
    let check = mesh.mesh.check();
    assert!(check.watertight && check.euler_characteristic == -2);
    let errors = mesh.mesh.positions.iter().map(|p| {
        let (height, slope) = two_rings(*p);
        (height / slope.length()).abs()
    });
    let covered = errors.zip(&mesh.sigma).filter(|(error, sigma)| *error < 1.96 * **sigma).count();
    let share = covered as f64 / mesh.sigma.len() as f64;
    println!("{} coefficients, covered {share:.3}", made.report.coefficients);
    assert!((0.9..0.99).contains(&share), "{share}");
}

#[test]
fn models_over_quads_are_saved_and_exported() {
    let made = fitted(3_000, 2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rings.planish");
    crate::saved::save(&made.model, &[], &path).unwrap();
    let read = crate::saved::load(&path).unwrap();
    assert_eq!(read.surface.space().leaves(), made.model.surface.space().leaves());
    assert_eq!(read.surface.vertices(), made.model.surface.vertices());
    let brep = brep_from_model(&read, &BrepOptions::default());
    brep.check(1e-6).unwrap();
    let domain = read.surface.space().domain().unwrap();
    assert!(brep.closed && 4 * brep.faces.len() < domain.cells().len());
    // A closed surface of genus 2: V − E + F = −2.
    assert_eq!(brep.vertices.len() as i64 - brep.edges.len() as i64 + brep.faces.len() as i64, -2);
}
