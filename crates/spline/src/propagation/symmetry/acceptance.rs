//! Acceptance of symmetric objects, and refusal of others, over kinds of objects, noise and seen shares.

use super::*;
use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Waves over the directions: `Σ a cos(w·d + φ)`.
struct Waves(Vec<(f64, DVec3, f64)>);

impl Waves {
    fn new(rng: &mut ChaCha8Rng, amplitude: f64) -> Self {
        let wave = |_| (amplitude * normal(rng) / 2.0, 1.8 * normal_vector(rng), 6.3 * rng.random::<f64>());
        Self((0..6).map(wave).collect())
    }

    fn at(&self, d: DVec3) -> f64 {
        self.0.iter().map(|(a, w, phase)| a * (w.dot(d) + phase).cos()).sum()
    }

    /// The part that a reflection in x = 0 does not change.
    fn even(&self, d: DVec3) -> f64 {
        0.5 * (self.at(d) + self.at(DVec3::new(-d.x, d.y, d.z)))
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample::<f64, _>(StandardNormal)
}

fn normal_vector(rng: &mut ChaCha8Rng) -> DVec3 {
    DVec3::new(normal(rng), normal(rng), normal(rng))
}

/// A star-shaped object that is symmetric about x = 0, by its radius in each direction.
fn radius(kind: usize, even: &impl Fn(DVec3) -> f64, d: DVec3) -> f64 {
    let about = |axes: [f64; 3], power: f64| {
        ((0..3).map(|k| (d[k] / axes[k]).abs().powf(power)).sum::<f64>()).powf(-1.0 / power)
    };
    let bump = |c: DVec3, width: f64| (-d.distance(c.normalize()).powi(2) / (width * width)).exp();
    let pair = |c: DVec3, width: f64| bump(c, width) + bump(DVec3::new(-c.x, c.y, c.z), width);
    match kind {
        // A blob, a rounded box, two lobes, a long body, and a head with pairs of bumps.
        0 => 1.0 + even(d),
        1 => about([1.0, 0.7, 0.5], 6.0) * (1.0 + 0.3 * even(d)),
        2 => (0.6 + 0.5 * d.x * d.x + 0.15 * d.y + 0.1 * d.y * d.z) * (1.0 + 0.5 * even(d)),
        3 => about([1.0, 0.45, 0.35], 2.0) * (1.0 + even(d)),
        _ => {
            1.0 + 0.2 * pair(DVec3::new(0.6, 0.7, 0.3), 0.35) - 0.1 * pair(DVec3::new(0.3, -0.5, 0.8), 0.3)
                + 0.15 * bump(DVec3::new(0.0, 0.2, 1.0), 0.4)
                + 0.5 * even(d)
        }
    }
}

/// A cloud, the true plane, and the share of it whose mirror image was seen, too.
struct Scene {
    facets: Option<Facets>,
    plane: Symmetry,
    overlap: f64,
}

fn scene(seed: u64, kind: usize, seen: f64, noise: f64, odd: f64) -> Scene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let waves = Waves::new(&mut rng, 0.15);
    let broken = Waves::new(&mut rng, 1.0);
    let shape = |d: DVec3| {
        let part = broken.at(d) - broken.even(d);
        radius(kind, &|d| waves.even(d), d) * (1.0 + odd * part)
    };
    // The cloud stands anywhere; the object is cut by a plane across a random direction.
    let axis = normal_vector(&mut rng).normalize();
    let (e1, e2) = planish_core::vector3::tangents(axis);
    let origin = 3.0 * normal_vector(&mut rng);
    let place = |p: DVec3| origin + p.x * axis + p.y * e1 + p.z * e2;
    let towards = normal_vector(&mut rng).normalize();
    let mut all: Vec<(DVec3, DVec3, DVec3)> = (0..12_000)
        .map(|_| {
            let d = normal_vector(&mut rng).normalize();
            let (a, b) = planish_core::vector3::tangents(d);
            let at = |d: DVec3| shape(d.normalize()) * d.normalize();
            let along = |e: DVec3| at(d + 1e-5 * e) - at(d - 1e-5 * e);
            let n = along(a).cross(along(b)).normalize();
            (d, at(d), n)
        })
        .collect();
    all.sort_by(|a, b| b.0.dot(towards).total_cmp(&a.0.dot(towards)));
    all.truncate((12_000.0 * seen) as usize);
    let last = all.last().unwrap().0.dot(towards);
    let mirrored = all.iter().filter(|(d, ..)| DVec3::new(-d.x, d.y, d.z).dot(towards) >= last).count();
    let overlap = mirrored as f64 / all.len() as f64;
    let points: Vec<DVec3> = all.iter().map(|(_, p, n)| place(*p + noise * normal(&mut rng) * *n)).collect();
    let normals: Vec<DVec3> = all.iter().map(|(.., n)| place(*n) - origin).collect();
    let facets = Facets::new(&points, &normals, &vec![noise * noise; points.len()], true).ok();
    Scene { facets, plane: Symmetry::Mirror { point: origin, normal: axis }, overlap }
}

/// True if the plane is the true one, within 4 σ or 2° and 2 % of the size.
fn is_true(found: &FittedSymmetry, scene: &Scene, size: f64) -> bool {
    let (normal, truth) = (found.symmetry.direction(), scene.plane.direction());
    let off = (scene.plane.point() - found.symmetry.point()).dot(normal).abs();
    normal.dot(truth).abs() > 2.0_f64.to_radians().cos() && off < 0.02 * size
}

/// Numbers of scenes: accepted with the true plane, accepted with another one, refused.
fn outcomes(seeds: u64, shares: &[f64], odd: f64, report: bool) -> Vec<[usize; 3]> {
    let mut of_overlap = vec![[0; 3]; 5];
    for kind in 0..5 {
        for seed in 0..seeds {
            for &seen in shares {
                let noise = [0.001, 0.004][seed as usize % 2];
                let scene = scene(1000 * kind as u64 + seed, kind, seen, noise, odd);
                let Some(facets) = &scene.facets else { continue };
                let found = fit_symmetry(facets, SymmetryKind::Mirror { towards: None });
                let outcome = match &found {
                    Some(f) if f.supported && is_true(f, &scene, facets.size) => 0,
                    Some(f) if f.supported => 1,
                    _ => 2,
                };
                if report && outcome > 0 {
                    let text = found.map(|f| {
                        let off = f.symmetry.direction().dot(scene.plane.direction()).abs().acos();
                        (f.compared, f.agreeing, f.departure / facets.size, f.sigmas(), off.to_degrees())
                    });
                    println!(
                        "kind {kind} seed {seed} seen {seen} noise {noise} overlap {:.2} of {}: {outcome} \
                         {text:?}",
                        scene.overlap,
                        facets.all.len()
                    );
                }
                of_overlap[((5.0 * scene.overlap) as usize).min(4)][outcome] += 1;
            }
        }
    }
    of_overlap
}

#[test]
#[ignore = "statistics of 200 objects"]
fn acceptance_of_mirror_planes_by_overlap() {
    let shares = [0.5, 0.6, 0.7, 0.8, 0.95];
    println!("symmetric: {:?}", outcomes(4, &shares, 0.0, true));
    for odd in [0.02, 0.1] {
        println!("odd part {odd}: {:?}", outcomes(2, &shares, odd, false));
    }
}
