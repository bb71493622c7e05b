use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SIGMA: f64 = 0.02;

fn height(x: f64, y: f64) -> f64 {
    0.4 * (0.9 * x).sin() * (0.7 * y).cos()
}

/// Positions of a sheet, read from above.
fn readings(count: usize, seed: u64) -> Vec<Reading> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let [x, y] = [10.0 * random.random::<f64>(), 8.0 * random.random::<f64>()];
            let point = DVec3::from_array([x, y, height(x, y)].map(|c| {
                let noise: f64 = StandardNormal.sample(&mut random);
                c + SIGMA * noise
            }));
            match Reading::position(point, SIGMA) {
                Reading::Position { point, covariance, .. } => {
                    Reading::Position { point, covariance, facing: Some(DVec3::Z) }
                }
                other => other,
            }
        })
        .collect()
}

fn options() -> StreamOptions {
    StreamOptions { shape: Some(Shape::Sheet), ..StreamOptions::default() }
}

/// A program that was stopped and one that was not must end with the same numbers.
#[test]
fn a_resumed_stream_continues_to_the_last_bit() {
    let all = readings(3000, 1);
    let mut stream = SurfaceStream::start(&all[..600], &options()).unwrap();
    for reading in &all[600..1500] {
        stream.push(reading).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("half.planish");
    stream.save(&path).unwrap();
    let mut resumed = SurfaceStream::resume(&path, &options()).unwrap();
    for one in [&mut stream, &mut resumed] {
        for reading in &all[1500..] {
            one.push(reading).unwrap();
        }
    }
    assert_eq!(stream.readings(), resumed.readings());
    let (a, b) = (stream.model().unwrap(), resumed.model().unwrap());
    assert_eq!(a.surface.vertices(), b.surface.vertices());
    assert_eq!(a.known.filter().unwrap().state(), b.known.filter().unwrap().state());
}

/// The reported σ must be correct, and memory must not depend on the number of readings.
#[test]
fn sigma_is_calibrated_and_memory_constant() {
    let all = readings(20_000, 2);
    let mut stream = SurfaceStream::start(&all[..800], &options()).unwrap();
    let mut bytes = Vec::new();
    for (k, reading) in all[800..].iter().enumerate() {
        stream.push(reading).unwrap();
        if k == 9_000 || k == 19_000 {
            stream.surface().unwrap();
            bytes.push((stream.bytes() as f64) / stream.patches() as f64);
        }
    }
    assert!((bytes[1] / bytes[0] - 1.0).abs() < 0.05, "{bytes:?} bytes a patch");
    stream.surface().unwrap();
    let (mut squares, mut sigmas, mut inside) = (0.0, 0.0, 0.0);
    for i in 0..20 {
        for j in 0..20 {
            let [x, y] = [0.5 + 9.0 * f64::from(i) / 19.0, 0.5 + 7.0 * f64::from(j) / 19.0];
            let place = stream.nearest(DVec3::new(x, y, height(x, y)));
            let error = (place.position[2] - height(place.position[0], place.position[1])) * place.normal[2];
            squares += (error / place.sigma).powi(2) / 400.0;
            sigmas += place.sigma / 400.0;
            inside += f64::from(u8::from(error.abs() < 1.96 * place.sigma)) / 400.0;
        }
    }
    assert!((0.5..1.5).contains(&squares), "mean square of normalised errors {squares}");
    assert!(inside > 0.88, "{inside} within 1.96 σ");
    assert!(sigmas < 0.3 * SIGMA, "{sigmas}");
}

/// Gross errors change nothing that is known, and a later change of unit or file does not go unnoticed.
#[test]
fn gross_errors_are_rejected_and_wrong_files_refused() {
    let all = readings(1500, 3);
    let mut stream = SurfaceStream::start(&all[..1000], &options()).unwrap();
    let before = stream.nearest(DVec3::new(5.0, 4.0, 0.0));
    let outlier = Reading::position(DVec3::new(5.0, 4.0, 2.0), SIGMA);
    assert_eq!(stream.push(&outlier).unwrap(), Some(RejectionCause::Outlier));
    assert_eq!(stream.nearest(DVec3::new(5.0, 4.0, 0.0)), before);
    let beyond = Reading::position(DVec3::new(30.0, 4.0, 0.0), SIGMA);
    assert_eq!(stream.push(&beyond).unwrap(), Some(RejectionCause::BeyondBorder));
    assert!(stream.push(&Reading::position(DVec3::new(f64::NAN, 4.0, 0.0), SIGMA)).is_err());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("global.planish");
    save(&crate::test_support::small_model(Shape::Sheet), &[], &path).unwrap();
    let e = SurfaceStream::resume(&path, &options()).err().unwrap();
    assert!(e.to_string().contains("global filter"), "{e}");
}

/// A normal and a curvature add information to that of positions.
#[test]
fn normals_and_curvatures_lower_sigma() {
    let all = readings(800, 4);
    let mut stream = SurfaceStream::start(&all, &options()).unwrap();
    let [x, y] = [5.2, 3.9];
    let at = stream.nearest(DVec3::new(x, y, height(x, y)));
    let before = at.sigma;
    for k in 0..40 {
        let shift = 0.3 * f64::from(k % 5) - 0.6;
        let place = stream.nearest(DVec3::new(x + shift, y, height(x + shift, y)));
        let [px, py, _] = place.position.to_array();
        let slope = [0.36 * (0.9 * px).cos() * (0.7 * py).cos(), -0.28 * (0.9 * px).sin() * (0.7 * py).sin()];
        let length = (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt();
        let normal = DVec3::new(-slope[0] / length, -slope[1] / length, 1.0 / length);
        let reading = Reading::Normal { at: place.position, normal, sigma_rad: 0.01 };
        assert_eq!(stream.push(&reading).unwrap(), None);
    }
    let curvature = Reading::Curvature {
        at: at.position,
        normal: at.normal,
        direction: DVec3::X,
        principal: [0.0, 0.0],
        sigma: 5.0,
    };
    assert_eq!(stream.push(&curvature).unwrap(), None, "so vague a reading fits anything");
    let after = stream.nearest(at.position).sigma;
    assert!(after < before, "{after} {before}");
}
