//! The noise by neighbours against simulated noise: shapes, outliers, uneven σ, dense points.

use super::*;
use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn vector(rng: &mut ChaCha8Rng, sigma: f64) -> DVec3 {
    sigma * DVec3::new(normal(rng), normal(rng), normal(rng))
}

/// Points of a random paraboloid over [−10, 10]².
fn sheet(n: usize, rng: &mut ChaCha8Rng) -> Vec<DVec3> {
    let [a, b, c] = [0.0; 3].map(|_: f64| rng.random_range(-0.05..0.05));
    (0..n)
        .map(|_| {
            let (x, y) = (rng.random_range(-10.0..10.0), rng.random_range(-10.0..10.0));
            DVec3::new(x, y, a * x * x + b * y * y + c * x * y)
        })
        .collect()
}

fn found(points: &[DVec3], sigma: f64) -> NeighbourNoise {
    neighbour_noise(points, |_, _| sigma * sigma).unwrap()
}

#[test]
fn scale_is_that_of_the_noise_from_few_and_many_points_of_any_size() {
    for (seed, n, sigma) in [(1, 100, 0.05), (2, 3000, 1e-4), (3, 3000, 0.01), (4, 20_000, 0.1)] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut points = sheet(n, &mut rng);
        points.iter_mut().for_each(|p| *p += vector(&mut rng, sigma));
        let noise = found(&points, sigma);
        let error = 4.0 * noise.standard_error;
        assert!((noise.upper - 1.0).abs() < error.max(0.08), "{n}: {noise:?}");
        assert!(noise.lower <= noise.upper && noise.lower > 0.6, "{n}: {noise:?}");
        // The scale is relative to the stated σ, whatever that is.
        let thrice = found(&points, 3.0 * sigma);
        assert!((3.0 * thrice.upper / noise.upper - 1.0).abs() < 1e-9);
    }
}

#[test]
fn noise_above_the_spacing_needs_more_neighbours() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut points = sheet(20_000, &mut rng);
    points.iter_mut().for_each(|p| *p += vector(&mut rng, 0.3));
    let noise = found(&points, 0.3);
    assert!((noise.upper - 1.0).abs() < 0.12 && noise.radius > 2.0, "{noise:?}");
}

#[test]
fn outliers_hardly_change_it() {
    for (seed, share, low, high, bound) in [
        (6, 0.15, -20.0, 20.0, 0.15),
        (7, 0.30, -20.0, 20.0, 0.25),
        (8, 0.45, -20.0, 20.0, 0.7),
        (9, 0.30, 1.0, 3.0, 0.25),
    ] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut points = sheet(3000, &mut rng);
        points.iter_mut().for_each(|p| *p += vector(&mut rng, 0.01));
        for p in &mut points {
            if rng.random_bool(share) {
                p.z += rng.random_range(low..high);
            }
        }
        let noise = found(&points, 0.01);
        assert!((noise.upper - 1.0).abs() < bound, "{share} {low}..{high}: {noise:?}");
    }
}

#[test]
fn sharp_edges_and_handles_are_no_noise() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let cube: Vec<DVec3> = (0..20_000)
        .map(|_| {
            let (u, v) = (rng.random_range(-10.0..10.0), rng.random_range(-10.0..10.0));
            let w = if rng.random_bool(0.5) { 10.0 } else { -10.0 };
            let p = [DVec3::new(u, v, w), DVec3::new(v, w, u), DVec3::new(w, u, v)];
            p[rng.random_range(0..3)] + vector(&mut rng, 0.05)
        })
        .collect();
    let noise = found(&cube, 0.05);
    assert!((noise.upper - 1.0).abs() < 0.15 && noise.lower < 1.15, "{noise:?}");
    let torus: Vec<DVec3> = (0..8000)
        .map(|_| {
            let (t, p) =
                (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(0.0..std::f64::consts::TAU));
            let r = 20.0 + 6.0 * f64::cos(p);
            DVec3::new(r * f64::cos(t), r * f64::sin(t), 6.0 * f64::sin(p)) + vector(&mut rng, 0.05)
        })
        .collect();
    let noise = found(&torus, 0.05);
    assert!((noise.upper - 1.0).abs() < 0.1, "{noise:?}");
}

#[test]
fn a_sigma_for_each_point_over_decades_is_confirmed() {
    for (seed, decades) in [(11, 0.6), (12, 4.0), (13, 9.0)] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut points = sheet(3000, &mut rng);
        let sigmas: Vec<f64> =
            points.iter().map(|_| 10_f64.powf(rng.random_range(-decades..0.0)) * 0.3).collect();
        for (p, sigma) in points.iter_mut().zip(&sigmas) {
            *p += vector(&mut rng, *sigma);
        }
        let noise = neighbour_noise(&points, |i, _| sigmas[i] * sigmas[i]).unwrap();
        assert!((noise.upper - 1.0).abs() < 0.3, "{decades} decades: {noise:?}");
    }
}

#[test]
fn shape_that_neighbours_do_not_resolve_lowers_only_the_lower_bound() {
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    // Waves of about ten spacings, far above the noise.
    let points: Vec<DVec3> = sheet(3000, &mut rng)
        .into_iter()
        .map(|p| DVec3::new(p.x, p.y, 0.5 * (1.8 * p.x).sin()) + vector(&mut rng, 0.002))
        .collect();
    let noise = found(&points, 0.002);
    assert!(noise.upper > 1.5 && noise.lower < 1.0, "{noise:?}");
}

#[test]
fn clouds_without_surfaces_and_lines_of_points_have_no_noise() {
    let mut rng = ChaCha8Rng::seed_from_u64(15);
    let volume: Vec<DVec3> = (0..2000).map(|_| vector(&mut rng, 1.0)).collect();
    assert_eq!(neighbour_noise(&volume, |_, _| 1e-4), None);
    let line: Vec<DVec3> = (0..2000).map(|i| DVec3::new(f64::from(i), 0.0, 0.0)).collect();
    assert_eq!(neighbour_noise(&line, |_, _| 1e-4), None);
    assert_eq!(neighbour_noise(&sheet(40, &mut rng), |_, _| 1e-4), None);
}

#[test]
fn errors_shared_by_neighbours_show_in_wider_neighbourhoods() {
    for (seed, spacings) in [(16, 1.0), (17, 2.0), (18, 3.0)] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let length = spacings * 20.0 / 5000_f64.sqrt();
        // A random field with the covariance exp(−d²/2L²), as a sum of waves.
        let waves: Vec<(DVec3, f64)> = (0..300)
            .map(|_| (vector(&mut rng, 1.0 / length), rng.random_range(0.0..std::f64::consts::TAU)))
            .collect();
        let mut points = sheet(5000, &mut rng);
        for p in &mut points {
            let field: f64 = waves.iter().map(|(k, phase)| (k.dot(*p) + phase).cos()).sum();
            p.z += 0.1 * (2.0 / 300.0_f64).sqrt() * field;
        }
        let noise = found(&points, 0.1);
        assert!(noise.upper < 0.6, "{spacings}: {noise:?}");
        let shared = noise.shared.unwrap();
        assert!(shared.sigma > 0.55 && shared.sigma < 1.2, "{spacings}: {noise:?}");
        // Independent errors of the same size show none.
        let mut points = sheet(5000, &mut rng);
        points.iter_mut().for_each(|p| *p += vector(&mut rng, 0.1));
        assert_eq!(found(&points, 0.1).shared, None);
    }
}

/// Sharp edges make differences grow with the neighbourhood, too, but with slopes that no errors have.
#[test]
fn a_plate_with_sharp_edges_has_no_shared_errors() {
    for (seed, thickness) in [(21, 0.5), (22, 1.0), (23, 2.0)] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let sides = [20.0, 20.0, thickness];
        let points: Vec<DVec3> = (0..20_000)
            .map(|_| {
                // A side in proportion to its area, and a place on it.
                let areas = [0, 1, 2].map(|axis| sides[(axis + 1) % 3] * sides[(axis + 2) % 3]);
                let mut at = rng.random_range(0.0..areas.iter().sum());
                let axis = areas
                    .iter()
                    .take_while(|&&area| {
                        at -= area;
                        at > 0.0
                    })
                    .count()
                    .min(2);
                let mut place = sides.map(|side| rng.random_range(0.0..side));
                place[axis] = if rng.random_range(0.0..1.0) < 0.5 { 0.0 } else { sides[axis] };
                DVec3::from_array(place) + vector(&mut rng, 0.005)
            })
            .collect();
        let noise = found(&points, 0.005);
        assert_eq!(noise.shared, None, "thickness {thickness}: {noise:?}");
    }
}
