use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Random points over a square of side 120, three per unit of area, with the height and class from `height`,
/// and their true classes.
fn landscape(height: impl Fn(f64, f64, &mut ChaCha8Rng) -> (f64, Ground)) -> (Vec<DVec3>, Vec<Ground>) {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    (0..43_200)
        .map(|_| {
            let (x, y): (f64, f64) = (rng.random_range(0.0..120.0), rng.random_range(0.0..120.0));
            let (z, what) = height(x, y, &mut rng);
            (DVec3::new(x, y, z + rng.random_range(-0.05..0.05)), what)
        })
        .unzip()
}

/// A gently rolling surface.
fn meadow(x: f64, y: f64) -> f64 {
    3.0 * (0.06 * x).sin() + 2.0 * (0.05 * y).cos()
}

/// Shares of ground points that were rejected and of other points that were accepted.
fn errors(points: &[DVec3], truth: &[Ground], options: &GroundOptions) -> [f64; 2] {
    let found = classify_ground(points, options).unwrap();
    [Ground::Bare, Ground::Above].map(|kind| {
        let of_kind: Vec<usize> = (0..truth.len()).filter(|&i| truth[i] == kind).collect();
        let wrong = of_kind.iter().filter(|&&i| (found[i] == Ground::Bare) != (kind == Ground::Bare));
        wrong.count() as f64 / of_kind.len().max(1) as f64
    })
}

/// A town: two houses, one with a gable roof, and trees that half of the pulses penetrate.
fn town(x: f64, y: f64, rng: &mut ChaCha8Rng) -> (f64, Ground) {
    let ground = meadow(x, y);
    let within = |a: f64, b: f64, c: f64, d: f64| (a..b).contains(&x) && (c..d).contains(&y);
    if within(20.0, 45.0, 30.0, 48.0) {
        (meadow(32.0, 39.0) + 7.0, Ground::Above)
    } else if within(70.0, 90.0, 20.0, 32.0) {
        (meadow(80.0, 26.0) + 4.0 + 0.5 * (6.0 - (y - 26.0).abs()), Ground::Above)
    } else if y > 80.0 && rng.random_bool(0.5) {
        (ground + rng.random_range(1.5..15.0), Ground::Above)
    } else {
        (ground, Ground::Bare)
    }
}

#[test]
fn houses_and_trees_are_rejected_and_ground_is_kept() {
    let (points, truth) = landscape(town);
    let [lost, kept] = errors(&points, &truth, &GroundOptions::for_unit(1.0));
    assert!(lost < 0.01 && kept < 0.01, "{lost} {kept}");
}

#[test]
fn results_do_not_depend_on_unit_and_map_coordinates() {
    let (points, _) = landscape(town);
    let metres = classify_ground(&points, &GroundOptions::for_unit(1.0)).unwrap();
    // A power of two, so that no number is rounded.
    let far: Vec<DVec3> =
        (points.iter()).map(|p| 4.0 * p + DVec3::new(600_000.0, 4_000_000.0, 500.0)).collect();
    let quarters = classify_ground(&far, &GroundOptions::for_unit(4.0)).unwrap();
    let other = metres.iter().zip(&quarters).filter(|(a, b)| a != b).count();
    assert!(other * 1000 < metres.len(), "{other}");
}

#[test]
fn a_steep_hillside_is_ground_and_its_house_is_not() {
    let (points, truth) = landscape(|x, y, _| {
        let house = (50.0..62.0).contains(&x) && (50.0..62.0).contains(&y);
        let ground = 0.6 * x;
        if house { (0.6 * 62.0 + 4.0, Ground::Above) } else { (ground, Ground::Bare) }
    });
    let [lost, kept] = errors(&points, &truth, &GroundOptions::for_unit(1.0));
    assert!(lost < 0.03 && kept < 0.02, "{lost} {kept}");
}

#[test]
fn both_levels_of_a_cliff_are_ground() {
    let (points, truth) = landscape(|x, y, _| {
        let step = if x + 0.2 * y > 70.0 { 12.0 } else { 0.0 };
        (meadow(x, y) + step, Ground::Bare)
    });
    let [lost, _] = errors(&points, &truth, &GroundOptions::for_unit(1.0));
    assert!(lost < 0.03, "{lost}");
}

#[test]
fn points_far_below_the_ground_are_rejected() {
    let (mut points, _) = landscape(|x, y, _| (meadow(x, y), Ground::Bare));
    for k in (0..points.len()).step_by(4000) {
        points[k][2] -= 30.0;
    }
    let found = classify_ground(&points, &GroundOptions::for_unit(1.0)).unwrap();
    for (k, found) in found.iter().enumerate() {
        let expected = if k % 4000 == 0 { Ground::Below } else { Ground::Bare };
        assert_eq!(*found, expected, "point {k}");
    }
}

#[test]
fn objects_wider_than_the_option_are_classified_as_ground() {
    let hall = |x: f64, y: f64| (20.0..80.0).contains(&x) && (20.0..80.0).contains(&y);
    let (points, truth) =
        landscape(|x, y, _| if hall(x, y) { (9.0, Ground::Above) } else { (0.0, Ground::Bare) });
    let kept = |widest: f64| {
        let options = GroundOptions { widest, ..GroundOptions::for_unit(1.0) };
        errors(&points, &truth, &options)[1]
    };
    assert!(kept(30.0) > 0.5 && kept(90.0) < 0.02, "{} {}", kept(30.0), kept(90.0));
}

#[test]
fn classes_do_not_depend_on_the_number_of_threads() {
    let (points, _) = landscape(town);
    let made = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| classify_ground(&points, &GroundOptions::for_unit(1.0)).unwrap())
    });
    assert!(made[0] == made[1]);
}

#[test]
fn radii_reach_the_widest() {
    assert_eq!(radii(0).collect::<Vec<_>>(), [1]);
    assert_eq!(radii(18).collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 18]);
}

#[test]
fn a_disc_takes_the_lowest_cell_within_its_radius() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (columns, rows) = (37, 150);
    let raster = Raster { columns, rows, values: (0..columns * rows).map(|_| rng.random()).collect() };
    for radius in [1_usize, 2, 3, 7, 20] {
        let found = lowest_in_disc(&raster, radius);
        for (at, value) in found.values.iter().enumerate().step_by(13) {
            let (i, j) = (at % columns, at / columns);
            let near = |k: &usize| {
                (k % columns).abs_diff(i).pow(2) + (k / columns).abs_diff(j).pow(2) <= radius * radius
            };
            let expected =
                (0..columns * rows).filter(near).map(|k| raster.values[k]).fold(f32::MAX, f32::min);
            assert_eq!(*value, expected, "radius {radius} at {i}, {j}");
        }
    }
}

#[test]
fn a_membrane_continues_a_plane_across_a_hole() {
    let (columns, rows) = (90, 70);
    let plane = |k: usize| 0.3 * (k % columns) as f32 - 0.1 * (k / columns) as f32;
    let known: Vec<bool> = (0..columns * rows)
        .map(|k| !((30..60).contains(&(k % columns)) && (20..50).contains(&(k / columns))))
        .collect();
    let values = (0..columns * rows).map(|k| if known[k] { plane(k) } else { f32::NAN }).collect();
    let made = filled(Raster { columns, rows, values }, &known);
    for (k, z) in made.values.iter().enumerate() {
        assert!((z - plane(k)).abs() < 0.5, "{k}: {z} instead of {}", plane(k));
    }
}

#[test]
fn invalid_input_is_rejected() {
    let points = [DVec3::ZERO, DVec3::new(1e7, 1e7, 0.0)];
    let good = GroundOptions::for_unit(1.0);
    for options in [
        GroundOptions { widest: 0.0, ..good },
        GroundOptions { slope: f64::NAN, ..good },
        GroundOptions { height: -1.0, ..good },
    ] {
        assert!(classify_ground(&points, &options).unwrap_err().to_string().contains("expected a"));
    }
    assert!(classify_ground(&[], &good).unwrap().is_empty());
    assert_eq!(classify_ground(&[DVec3::new(1.0, 2.0, 3.0)], &good).unwrap(), [Ground::Bare]);
}
