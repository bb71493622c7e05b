use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use planish_core::SymmetricMatrix3;

const SIDE: usize = 64;
const RADIUS: f64 = 28.0;

fn lights(count: usize) -> Vec<DVec3> {
    let light = |k: usize| {
        let angle = TAU * k as f64 / count as f64;
        let tilt = if k.is_multiple_of(2) { 0.6 } else { 0.35 };
        DVec3::new(tilt * angle.cos(), tilt * angle.sin(), -(1.0 - tilt * tilt).sqrt())
    };
    (0..count).map(light).collect()
}

fn true_normal(k: usize) -> Option<DVec3> {
    let (x, y) = (((k % SIDE) as f64 - 32.0) / RADIUS, ((k / SIDE) as f64 - 32.0) / RADIUS);
    let square = x * x + y * y;
    (square < 0.8).then(|| DVec3::new(x, y, -(1.0 - square).sqrt()))
}

fn normal_number(rng: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (TAU * b).cos()
}

/// A ball of varying albedo with noise, and highlights where `gloss` is not 0.
fn ball(lights: &[DVec3], sigma: f64, ambient: f64, gloss: f64, seed: u64) -> Vec<Image> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut image = |l: &DVec3| {
        let mut value = |k: usize| {
            let Some(n) = true_normal(k) else { return 0.0 };
            let albedo = 150.0 + 60.0 * ((k % 11) as f64 / 11.0);
            let mirrored = 2.0 * n.dot(*l) * -n[2] + l[2];
            let highlight = gloss * mirrored.max(0.0).powi(60);
            (albedo * (n.dot(*l).max(0.0) + ambient) + highlight + sigma * normal_number(&mut rng)) as f32
        };
        Image::try_new(SIDE, SIDE, (0..SIDE * SIDE).map(&mut value).collect()).unwrap()
    };
    lights.iter().map(&mut image).collect()
}

#[test]
fn images_inconsistent_with_their_lights_are_detected() {
    let directions = lights(6);
    let mut pictures = ball(&directions, 1.0, 0.0, 0.0, 3);
    let found = |pictures: &[Image]| {
        let stated = PhotometricOptions { sigma_brightness: Some(1.0), ..PhotometricOptions::default() };
        photometric_normals(pictures, &directions, None, &stated)
    };
    let true_order = found(&pictures).unwrap();
    let residual = true_order.sigma_of_residuals.unwrap();
    assert!((0.7..1.4).contains(&residual), "{residual} of 1");
    // A wrong order of the lights gives large residuals for any stated σ. (Not a cyclic shift of a ring of
    // lights.)
    pictures.swap(0, 2);
    let wrong_order = found(&pictures).unwrap();
    let residual = wrong_order.sigma_of_residuals.unwrap();
    assert!(residual > 0.05 * wrong_order.brightest, "{residual} of {}", wrong_order.brightest);
    // The same image for all lights: residuals do not reveal that.
    let e = found(&vec![pictures[0].clone(); 6]).unwrap_err();
    assert!(e.to_string().contains("images 1 and 2 are the same"), "{e}");
}

/// Tangential components of the errors divided by their σ, and the errors in degrees.
fn judge(map: &NormalMap) -> (Vec<f64>, Vec<f64>) {
    let (mut normalised, mut degrees) = (Vec::new(), Vec::new());
    for k in 0..SIDE * SIDE {
        let (Some(truth), Some(found)) = (true_normal(k), map.normals[k]) else {
            continue;
        };
        let (e1, e2) = tangents(truth);
        let sigma = map.sigma_deg[k].to_radians();
        normalised.extend([found.dot(e1) / sigma, found.dot(e2) / sigma]);
        degrees.push(found.dot(truth).clamp(-1.0, 1.0).acos().to_degrees());
    }
    (normalised, degrees)
}

#[test]
fn stated_sigma_agrees_with_the_errors() {
    for (count, stated) in [(3, Some(2.0)), (6, None), (12, None)] {
        let lights = lights(count);
        let options =
            PhotometricOptions { sigma_brightness: stated, ambient: Some(0.0), ..Default::default() };
        let (mut squares, mut inside, mut n) = (0.0, 0, 0);
        for seed in 0..4 {
            let map =
                photometric_normals(&ball(&lights, 2.0, 0.0, 0.0, seed), &lights, None, &options).unwrap();
            let (normalised, _) = judge(&map);
            squares += normalised.iter().map(|e| e * e).sum::<f64>();
            inside += normalised.iter().filter(|e| e.abs() < 1.96).count();
            n += normalised.len();
        }
        let (scale, covered) = ((squares / n as f64).sqrt(), inside as f64 / n as f64);
        assert!(
            (0.88..1.12).contains(&scale) && (0.92..0.98).contains(&covered),
            "{count}: {scale} {covered}"
        );
    }
}

#[test]
fn highlights_are_rejected() {
    let lights = lights(12);
    let images = ball(&lights, 1.0, 0.0, 180.0, 1);
    let map = photometric_normals(&images, &lights, None, &PhotometricOptions::default()).unwrap();
    let (_, robust) = judge(&map);
    // Least squares of all readings, as a measure of what was to be left out.
    let mut m = SymmetricMatrix3::ZERO;
    lights.iter().for_each(|l| m.add_outer(1.0, *l));
    let inverse = inverse(&m).unwrap();
    let plain = |k: usize| {
        let truth = true_normal(k)?;
        let mut r = DVec3::ZERO;
        for (l, image) in lights.iter().zip(&images) {
            (0..3).for_each(|c| r[c] += l[c] * f64::from(image.values[k]));
        }
        Some(inverse.times(r).try_normalize()?.dot(truth).clamp(-1.0, 1.0).acos().to_degrees())
    };
    let plain: Vec<f64> = (0..SIDE * SIDE).filter_map(plain).collect();
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    assert!(mean(&robust) < 0.5 * mean(&plain), "{} and {}", mean(&robust), mean(&plain));
}

#[test]
fn ambient_light_is_estimated() {
    let lights = lights(8);
    let map =
        photometric_normals(&ball(&lights, 1.0, 0.12, 0.0, 3), &lights, None, &PhotometricOptions::default())
            .unwrap();
    assert!((map.ambient - 0.12).abs() < 0.04, "{}", map.ambient);
    let (_, degrees) = judge(&map);
    assert!(median(degrees.clone()) < 1.5, "{}", median(degrees));
}

#[test]
fn a_mirror_ball_gives_the_directions_of_lights() {
    let lights = lights(5);
    let image = |l: &DVec3| {
        let half = DVec3::new(l[0], l[1], l[2] - 1.0).try_normalize().unwrap();
        let value = |k: usize| true_normal(k).map_or(0.0, |n| (200.0 * n.dot(half).powi(400)) as f32);
        Image::try_new(SIDE, SIDE, (0..SIDE * SIDE).map(value).collect()).unwrap()
    };
    let disc = |k: usize| {
        let (x, y) = ((k % SIDE) as f64 - 32.0, (k / SIDE) as f64 - 32.0);
        if x * x + y * y < RADIUS * RADIUS { 255.0 } else { 0.0 }
    };
    let mask = Image::try_new(SIDE, SIDE, (0..SIDE * SIDE).map(disc).collect()).unwrap();
    let found = lights_from_ball(&lights.iter().map(image).collect::<Vec<_>>(), &mask).unwrap();
    for (found, light) in found.iter().zip(&lights) {
        assert!(found.dot(*light) > 1.5_f64.to_radians().cos(), "{found:?} {light:?}");
    }
}

#[test]
fn colours_encode_normals() {
    // 128 128 255 faces the camera; black was never drawn.
    let map = normals_from_colours(2, 1, &[127.5, 127.5, 255.0, 0.0, 0.0, 0.0], 255.0, 3.0).unwrap();
    assert_eq!(map.normals[0], Some(DVec3::new(0.0, -0.0, -1.0)));
    assert_eq!((map.normals[1], map.undetermined), (None, 1));
    let scan = map.scan(0.5, "map").unwrap();
    assert_eq!((scan.points.len(), scan.sigma_normal_deg), (1, Some(vec![3.0])));
}

#[test]
fn undetermined_normals_are_rejected() {
    let three = lights(3);
    let images = ball(&three, 1.0, 0.0, 0.0, 1);
    let message = |images: &[Image], lights: &[DVec3]| {
        photometric_normals(images, lights, None, &PhotometricOptions::default()).unwrap_err().to_string()
    };
    assert!(message(&images, &three).contains("expected sigma_brightness"));
    assert!(message(&images, &lights(4)).contains("found 3 and 4"));
    let flat = [
        DVec3::new(0.0, 0.0, -1.0),
        DVec3::new(0.6, 0.0, -0.8),
        DVec3::new(-0.6, 0.0, -0.8),
        DVec3::new(0.3, 0.0, -0.95),
    ];
    assert!(message(&ball(&flat, 1.0, 0.0, 0.0, 1), &flat).contains("one plane"));
}
