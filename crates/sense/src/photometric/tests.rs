use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use planish_core::vector3::tangents;

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
    // Two exchanged images of six: either their readings are rejected, or the residuals are large.
    pictures.swap(0, 2);
    let wrong_order = found(&pictures).unwrap();
    let residual = wrong_order.sigma_of_residuals.unwrap();
    let rejected = wrong_order.rejected_by_light.iter().copied().fold(0.0, f64::max);
    assert!(
        residual > 0.05 * wrong_order.brightest || rejected > 0.5,
        "{residual} of {}, {rejected}",
        wrong_order.brightest
    );
    assert!(true_order.rejected_by_light.iter().all(|share| *share < 0.1));
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
        // Residuals cannot exclude a small deviation from Lambert's law, so an estimated σ includes one, also
        // for this surface, which has none.
        let (least, most) = if stated.is_some() { (0.88, 0.98) } else { (0.4, 1.01) };
        assert!(
            (least..1.12).contains(&scale) && (0.92..most).contains(&covered),
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

/// A surface for [`covered`].
#[derive(Debug, Clone, Copy)]
enum Surface {
    /// Lambert's law.
    Matte,
    /// With a sharp highlight that is five times as bright as the rest.
    SharpGloss,
    /// With a broad highlight.
    BroadGloss,
    /// Oren and Nayar 1994, roughness 0.5.
    Rough,
    /// A camera with this gamma curve.
    Gamma(f64),
    /// Ambient light of 8 %.
    Ambient,
    /// Lights whose strengths differ by 5 % from each other.
    Strengths,
    /// Lights whose directions are wrong by 1.5°.
    Directions,
}

/// Images of a ball under random lights: the stated lights, the images, and the object's true normals.
fn surface_images(surface: Surface, count: usize, seed: u64) -> (Vec<DVec3>, Vec<Image>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let light = |k: usize, rng: &mut ChaCha8Rng| {
        let around = TAU * (k as f64 + 0.4 * (rng.random::<f64>() - 0.5)) / count as f64;
        let tilt = 0.2 + 0.5 * rng.random::<f64>();
        DVec3::new(tilt.sin() * around.cos(), tilt.sin() * around.sin(), -tilt.cos())
    };
    let lights: Vec<DVec3> = (0..count).map(|k| light(k, &mut rng)).collect();
    let albedo: Vec<f64> = (0..SIDE * SIDE).map(|_| 105.0 + 45.0 * rng.random::<f64>()).collect();
    let mut images = Vec::new();
    let mut stated = Vec::new();
    for &l in &lights {
        let strength = 1.0 + 0.05 * normal_number(&mut rng);
        let error = DVec3::from_array([0; 3].map(|_| 1.5_f64.to_radians() * normal_number(&mut rng)));
        let half = (l - DVec3::Z).normalize();
        let values = (0..SIDE * SIDE)
            .map(|k| {
                let Some(n) = true_normal(k) else { return 0.0 };
                let cosine = n.dot(l).max(0.0);
                let gloss = n.dot(half).max(0.0);
                let share = match surface {
                    Surface::Matte | Surface::Directions => cosine,
                    Surface::SharpGloss => cosine + 5.0 * gloss.powi(400),
                    Surface::BroadGloss => cosine + 0.3 * gloss.powi(10) * f64::from(cosine > 0.0),
                    Surface::Rough => {
                        let (a, b) = (1.0 - 0.125 / 0.58, 0.1125 / 0.34);
                        let (to_light, to_camera) = (cosine.acos(), (-n.z).acos());
                        let (across, beside) = (l - n.dot(l) * n, -DVec3::Z + n.z * n);
                        let turn = across.dot(beside) / (across.length() * beside.length() + 1e-12);
                        let (large, small) = (to_light.max(to_camera), to_light.min(to_camera));
                        cosine * (a + b * turn.max(0.0) * large.sin() * small.tan())
                    }
                    Surface::Gamma(gamma) => cosine.powf(gamma),
                    Surface::Ambient => cosine + 0.08,
                    Surface::Strengths => strength * cosine,
                };
                (albedo[k] * share + normal_number(&mut rng)).round() as f32
            })
            .collect();
        images.push(Image::try_new(SIDE, SIDE, values).unwrap());
        stated.push(if matches!(surface, Surface::Directions) { (l + error).normalize() } else { l });
    }
    (stated, images)
}

/// Share of the tangential errors within 1.96 σ, root mean square of error over σ, and median error.
fn covered(surface: Surface, count: usize, seed: u64) -> [f64; 3] {
    let (lights, images) = surface_images(surface, count, seed);
    let map = photometric_normals(&images, &lights, None, &PhotometricOptions::default()).unwrap();
    let (normalised, degrees) = judge(&map);
    let inside = normalised.iter().filter(|e| e.abs() < 1.96).count() as f64 / normalised.len() as f64;
    let rms = (normalised.iter().map(|e| e * e).sum::<f64>() / normalised.len() as f64).sqrt();
    println!(
        "{surface:?} {count} lights: coverage {inside:.3}, rms {rms:.2}, error {:.2}, ambient {:.3}, noise \
         {:.2}, model {:.4}, {:?}",
        median(degrees.clone()),
        map.ambient,
        map.sigma_brightness,
        map.model_error,
        map.readings
    );
    [inside, rms, median(degrees)]
}

const SURFACES: [Surface; 9] = [
    Surface::Matte,
    Surface::SharpGloss,
    Surface::BroadGloss,
    Surface::Rough,
    Surface::Gamma(1.15),
    Surface::Gamma(0.85),
    Surface::Ambient,
    Surface::Strengths,
    Surface::Directions,
];

#[test]
fn normals_of_surfaces_that_are_not_matte_are_covered() {
    for surface in SURFACES {
        // One image series shares the errors of its lights, so a single coverage scatters.
        let [inside, ..] = covered(surface, 12, 5);
        assert!(inside > 0.85, "{surface:?}: {inside}");
    }
}

#[test]
#[ignore = "54 image series: run by `just nightly`"]
fn normals_of_many_surfaces_are_covered() {
    for surface in SURFACES {
        for count in [8, 24] {
            let mean = (0..3).map(|seed| covered(surface, count, 10 + seed)[0]).sum::<f64>() / 3.0;
            assert!(mean > 0.88, "{surface:?} {count}: {mean}");
        }
    }
}

#[test]
fn saturated_readings_are_excluded_and_counted() {
    let (lights, mut images) = surface_images(Surface::Matte, 12, 3);
    for image in &mut images {
        image.values.iter_mut().filter(|v| **v >= 110.0).for_each(|v| *v = f32::NAN);
    }
    let map = photometric_normals(&images, &lights, None, &PhotometricOptions::default()).unwrap();
    let counts = map.readings;
    assert!(counts.saturated > counts.used / 20, "{counts:?}");
    let (normalised, _) = judge(&map);
    let inside = normalised.iter().filter(|e| e.abs() < 1.96).count() as f64 / normalised.len() as f64;
    assert!(inside > 0.88, "{inside}");
    // Two readings are left.
    for image in &mut images[2..] {
        image.values.fill(f32::NAN);
    }
    images[2].values[0] = 1.0;
    let error = photometric_normals(&images, &lights, None, &PhotometricOptions::default());
    assert!(error.is_err());
}

/// With few lights, residuals show little of the deviation from Lambert's law, and the variance of maximum
/// likelihood is often zero. σ with it covers 0.43 to 0.55 of the errors of these scenes.
#[test]
fn normals_under_few_lights_are_covered() {
    let scenes = [
        (Surface::BroadGloss, 5, 0),
        (Surface::Gamma(0.85), 4, 2),
        (Surface::Ambient, 4, 0),
        (Surface::Directions, 5, 2),
    ];
    for (surface, count, seed) in scenes {
        let [inside, ..] = covered(surface, count, seed);
        assert!(inside > 0.85, "{surface:?} {count}: {inside}");
    }
}

#[test]
fn the_threshold_of_dark_pixels_does_not_depend_on_the_brightest() {
    let (lights, mut images) = surface_images(Surface::Matte, 12, 4);
    let mask = (0..SIDE * SIDE).map(|k| f32::from(u8::from(true_normal(k).is_some()))).collect();
    let mask = Image::try_new(SIDE, SIDE, mask).unwrap();
    let found = |images: &[Image]| {
        photometric_normals(images, &lights, Some(&mask), &PhotometricOptions::default()).unwrap()
    };
    let before = found(&images);
    assert_eq!(before.dark, 0);
    // A highlight of one pixel, fifty times as bright as the rest.
    images[3].values[SIDE * SIDE / 2 + 40] = 7500.0;
    let after = found(&images);
    assert_eq!(after.dark, 0);
    assert_eq!(after.normals.iter().flatten().count(), before.normals.iter().flatten().count());
    // Pixels that no light reaches are counted.
    for image in &mut images {
        image.values[..SIDE * SIDE / 3].fill(0.0);
    }
    let dark = (0..SIDE * SIDE / 3).filter(|k| true_normal(*k).is_some()).count();
    assert_eq!(found(&images).dark, dark);
}
