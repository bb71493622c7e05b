use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

/// A sum of waves of many lengths: a texture in closed form, so that shifted images are exact.
struct Texture(Vec<[f64; 4]>);

impl Texture {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        let wave = |_| {
            let (angle, phase) = (rng.random::<f64>() * TAU, rng.random::<f64>() * TAU);
            let k = 0.15 + 1.2 * rng.random::<f64>();
            [k * angle.cos(), k * angle.sin(), phase, 10.0]
        };
        Self((0..40).map(wave).collect())
    }

    fn at(&self, x: f64, y: f64) -> f64 {
        128.0 + self.0.iter().map(|[a, b, phase, h]| h * (a * x + b * y + phase).sin()).sum::<f64>()
    }
}

const COLUMNS: usize = 160;
const ROWS: usize = 90;

/// A slanted plane behind a square parallel to the image, in two cameras with noise, and the true disparities
/// of the left image.
fn scene(seed: u64, sigma: f64) -> (Image, Image, Vec<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (back, front) = (Texture::new(&mut rng), Texture::new(&mut rng));
    // In the left image's columns: the plane d = 6 + 0.02 x + 0.01 y and the square d = 17.3.
    let plane = |x: f64, y: f64| 6.0 + 0.02 * x + 0.01 * y;
    let square = |x: f64, y: f64| (60.0..110.0).contains(&x) && (25.0..65.0).contains(&y);
    let truth = |k: usize| {
        let (x, y) = ((k % COLUMNS) as f64, (k / COLUMNS) as f64);
        if square(x, y) { 17.3 } else { plane(x, y) }
    };
    let left = |k: usize| {
        let (x, y) = ((k % COLUMNS) as f64, (k / COLUMNS) as f64);
        if square(x, y) { front.at(x, y) } else { back.at(x, y) }
    };
    let right = |k: usize| {
        let (x, y) = ((k % COLUMNS) as f64, (k / COLUMNS) as f64);
        // x_right = x − d(x) solved for x.
        let behind = (x + 6.0 + 0.01 * y) / 0.98;
        if square(x + 17.3, y) { front.at(x + 17.3, y) } else { back.at(behind, y) }
    };
    let mut normal = || {
        let (a, b): (f64, f64) = (rng.random(), rng.random());
        (-2.0 * (1.0 - a).ln()).sqrt() * (TAU * b).cos()
    };
    let mut image = |value: &dyn Fn(usize) -> f64| {
        let values = (0..COLUMNS * ROWS).map(|k| (value(k) + sigma * normal()) as f32).collect();
        Image::try_new(COLUMNS, ROWS, values).unwrap()
    };
    let (left, right) = (image(&left), image(&right));
    (left, right, (0..COLUMNS * ROWS).map(truth).collect())
}

const OPTIONS: StereoOptions = StereoOptions {
    min_disparity: 0,
    disparities: 32,
    small_step: 20,
    large_step: 200,
    uniqueness: 3,
    left_right: 1,
    speckle: 50,
};

fn matched(left: &Image, right: &Image) -> DisparityMap {
    match_stereo(left, right, &OPTIONS, &mut |_| Ok(())).unwrap()
}

#[test]
fn disparities_and_their_sigma_agree_with_the_truth() {
    let (mut inside, mut count, mut gross, mut pixels) = (0, 0, 0, 0);
    let mut squares = 0.0;
    for seed in 0..3 {
        let (left, right, truth) = scene(seed, 4.0);
        let map = matched(&left, &right);
        for (k, truth) in truth.iter().enumerate() {
            // What the right image cannot see has none.
            if k % COLUMNS < 20 {
                continue;
            }
            pixels += 1;
            let error = f64::from(map.disparity[k]) - truth;
            if error.is_finite() {
                count += 1;
                gross += usize::from(error.abs() > 1.0);
                inside += usize::from(error.abs() < 1.96 * f64::from(map.sigma[k]));
                squares += if error.abs() <= 1.0 { error * error } else { 0.0 };
            }
        }
    }
    let share = |n: usize| n as f64 / count as f64;
    assert!(count > pixels * 85 / 100, "{count} of {pixels}");
    assert!(share(gross) < 0.03, "{gross} of {count} are off by more than a pixel");
    assert!(share(inside) > 0.93, "{} are covered", share(inside));
    let rms = (squares / count as f64).sqrt();
    assert!(rms < 0.15, "rms of the others {rms}");
}

#[test]
fn more_noise_means_larger_errors_and_larger_sigma() {
    let median = |values: &[f32]| {
        let mut known: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
        known.sort_by(f32::total_cmp);
        known[known.len() / 2]
    };
    let sigma = [1.0, 12.0].map(|noise| {
        let (left, right, _) = scene(5, noise);
        median(&matched(&left, &right).sigma)
    });
    assert!(sigma[1] > 1.5 * sigma[0], "{sigma:?}");
}

#[test]
fn gross_errors_have_the_largest_sigmas() {
    let (left, right, truth) = scene(9, 8.0);
    let map = matched(&left, &right);
    let mut all: Vec<(f32, bool)> = (0..truth.len())
        .filter(|k| map.disparity[*k].is_finite())
        .map(|k| (map.sigma[k], (f64::from(map.disparity[k]) - truth[k]).abs() > 1.0))
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (low, high) = all.split_at(all.len() * 4 / 5);
    let gross = |part: &[(f32, bool)]| part.iter().filter(|(_, bad)| *bad).count();
    assert!(gross(high) > 4 * gross(low), "{} and {}", gross(high), gross(low));
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let (left, right, _) = scene(2, 3.0);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let map = pool.install(|| matched(&left, &right));
        let bits = |values: Vec<f32>| -> Vec<u32> { values.into_iter().map(f32::to_bits).collect() };
        (bits(map.disparity), bits(map.sigma), map.rejected)
    };
    assert!(run(1) == run(3));
}

#[test]
fn negative_disparities_are_found_with_the_images_exchanged() {
    let (left, right, _) = scene(3, 2.0);
    let options = StereoOptions { min_disparity: -31, ..OPTIONS };
    let map = match_stereo(&right, &left, &options, &mut |_| Ok(())).unwrap();
    // The middle of the square, seen from the right.
    let middle = map.disparity[45 * COLUMNS + 68];
    assert!((middle + 17.3).abs() < 0.3, "{middle}");
}

#[test]
fn images_without_texture_have_no_disparities() {
    let grey = Image::try_new(64, 32, vec![100.0; 64 * 32]).unwrap();
    let map = matched(&grey, &grey);
    assert!(map.disparity.iter().all(|d| d.is_nan()), "{:?}", map.rejected);
}

#[test]
fn invalid_sizes_and_options_are_rejected() {
    let image = |columns, rows| Image::try_new(columns, rows, vec![0.0; columns * rows]).unwrap();
    let refused = |left: &Image, right: &Image, options: &StereoOptions| {
        match_stereo(left, right, options, &mut |_| Ok(())).unwrap_err().to_string()
    };
    assert!(refused(&image(64, 32), &image(64, 33), &OPTIONS).contains("64 × 32 and 64 × 33"));
    let one = image(64, 32);
    for (options, words) in [
        (StereoOptions { disparities: 2, ..OPTIONS }, "of 4 to 4096"),
        (StereoOptions { large_step: 10, ..OPTIONS }, "penalties"),
        (StereoOptions { min_disparity: -64, ..OPTIONS }, "below the images' width of 64"),
    ] {
        assert!(refused(&one, &one, &options).contains(words), "{words}");
    }
    let mut dark = image(64, 32);
    dark.values[70] = f32::NAN;
    assert!(refused(&dark, &one, &OPTIONS).contains("pixel 70"));
}

#[test]
fn matching_stops_on_the_callbacks_error() {
    let (left, right, _) = scene(1, 1.0);
    let stopped = match_stereo(&left, &right, &OPTIONS, &mut |_| Err(Error::interrupted()));
    assert_eq!(stopped.unwrap_err().kind(), planish_estimate::ErrorKind::Interrupted);
}
