use super::*;
use planish_mesh::{grid_sheet, icosphere};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Points of a unit ball and a field of unit variance on it, correlated over about `length`, of which the
/// share `white` of the variance is uncorrelated.
fn field_on_ball(rng: &mut ChaCha8Rng, length: f64, white: f64) -> (Vec<DVec3>, Vec<f64>) {
    let points = icosphere(1.0, 4).positions;
    // A sum of waves with Gaussian frequencies has the covariance exp(−d²/2ℓ²).
    let waves: Vec<(DVec3, f64)> = (0..200)
        .map(|_| {
            let frequency = DVec3::new(normal(rng), normal(rng), normal(rng)) * (1.0 / length);
            (frequency, std::f64::consts::TAU * rng.random::<f64>())
        })
        .collect();
    let smooth = |p: &DVec3| -> f64 { waves.iter().map(|(k, phase)| (k.dot(*p) + phase).cos()).sum() };
    let scale = (2.0 / waves.len() as f64).sqrt() * (1.0 - white).sqrt();
    let values = points.iter().map(|p| scale * smooth(p) + white.sqrt() * normal(rng)).collect();
    (points, values)
}

fn on_ball(points: &[DVec3], values: &[f64]) -> CommonOffset {
    // On a unit ball the normals are the points.
    CommonOffset::estimate(points, values, points).unwrap()
}

#[test]
fn sigma_includes_the_spatial_correlation() {
    for (length, white) in [(0.02, 1.0), (0.1, 0.3), (0.3, 0.5), (0.3, 0.0)] {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let runs = 100;
        let (mut square, mut false_alarms) = (0.0, 0);
        for _ in 0..runs {
            let (points, values) = field_on_ball(&mut rng, length, white);
            let found = on_ball(&points, &values);
            square += (found.value / found.sigma).powi(2) / f64::from(runs);
            false_alarms += u32::from(found.is_notable());
        }
        // A σ of independent points would give 20 to 200 for the correlated fields. The largest of several
        // variances is cautious.
        assert!((0.5..1.8).contains(&square), "length {length}, white {white}: {square}");
        assert!(false_alarms <= 2, "length {length}, white {white}: {false_alarms} of {runs}");
    }
}

#[test]
fn an_offset_is_found_beside_defects_of_places() {
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (points, mut values) = field_on_ball(&mut rng, 0.1, 0.5);
        let offset = if seed % 2 == 0 { 0.8 } else { -0.8 };
        for (value, p) in values.iter_mut().zip(&points) {
            // A dent over a twentieth of the ball.
            *value = 0.3 * *value + offset - if p[2] > 0.9 { 30.0 } else { 0.0 };
        }
        let found = on_ball(&points, &values);
        assert!(found.is_notable(), "{found:?}");
        assert!((found.value - offset).abs() < 0.15, "{found:?}");
        assert!(found.explained_by_shift < 0.01, "{found:?}");
    }
}

#[test]
fn a_shift_of_a_plane_is_not_told_from_an_offset() {
    let sheet = grid_sheet(2.0, 2.0, 20, 20).positions;
    let up = vec![DVec3::new(0.0, 0.0, 1.0); sheet.len()];
    let found = CommonOffset::estimate(&sheet, &vec![0.1; sheet.len()], &up).unwrap();
    assert!(found.explained_by_shift > 0.999 && found.is_notable(), "{found:?}");
    let text = found.text(SmallUnit::for_length("mm", 0.1));
    assert!(text.contains("so flat that a shift"), "{text}");
}

#[test]
fn few_places_have_no_sigma() {
    let points: Vec<DVec3> = (0..5).map(|k| DVec3::new(f64::from(k), 0.0, 0.0)).collect();
    assert_eq!(CommonOffset::estimate(&points, &[1.0; 5], &points), None);
    assert_eq!(CommonOffset::estimate(&[DVec3::ZERO; 9], &[1.0; 9], &[DVec3::ZERO; 9]), None);
}

#[test]
fn dense_places_count_once() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut points, mut values) = field_on_ball(&mut rng, 0.1, 1.0);
    // Nine tenths of the points lie at one place that is displaced.
    for _ in 0..9 * points.len() {
        points.push(DVec3::new(0.0, 0.0, 1.0));
        values.push(5.0);
    }
    let found = on_ball(&points, &values);
    assert!(!found.is_notable() && found.value.abs() < 0.2, "{found:?}");
}
