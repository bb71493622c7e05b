use super::*;
use planish_core::Silent;

fn options() -> SphereOptions {
    SphereOptions {
        sets: 4,
        readings: vec![100],
        noise_percent: vec![2.0, 6.0],
        depth: 1,
        compared_orientations_deg: vec![0.0, 5.0],
        ..SphereOptions::default()
    }
}

/// The statements about the figures hold for a few sets, with patches that are split.
#[test]
fn errors_stay_near_the_bound_and_orientations_lower_them() {
    let rows = sphere(&SphereOptions { noise_divides: true, ..options() }, &Silent).unwrap();
    let find = |noise: f64, tilt: Option<f64>, depth: u8| {
        rows.iter()
            .find(|r| r.noise_percent == noise && r.orientation_deg == tilt && r.depth == depth)
            .unwrap()
    };
    for row in &rows {
        // The mean of four sets scatters by a fifth; the bound hardly does.
        assert!(row.patch_percent < 1.6 * row.bound_percent, "{row:?}");
        assert!((row.patch_percent / row.global_percent - 1.0).abs() < 0.15, "{row:?}");
    }
    for noise in [2.0, 6.0] {
        for depth in [0, 1] {
            let (alone, helped) = (find(noise, None, depth), find(noise, Some(2.0), depth));
            assert!(helped.patch_percent < 0.8 * alone.patch_percent, "{helped:?} after {alone:?}");
            assert!(helped.bound_percent < alone.bound_percent);
        }
        let (coarse, fine) = (find(noise, None, 0), find(noise, None, 1));
        assert_eq!(coarse.leaf_patches, 1.0);
        assert!(fine.leaf_patches > 1.0, "{fine:?}");
        assert!(fine.patch_percent < 1.1 * coarse.patch_percent, "{fine:?} after {coarse:?}");
        // With one patch, both filters solve the same equations.
        assert!((coarse.patch_percent / coarse.global_percent - 1.0).abs() < 1e-6, "{coarse:?}");
    }
    assert!(find(2.0, None, 0).patch_percent < find(6.0, None, 0).patch_percent);
    assert!(find(6.0, Some(0.0), 0).bound_percent < find(6.0, Some(5.0), 0).bound_percent);
}

#[test]
fn snapshots_lead_from_the_cylinder_to_the_sphere() {
    let options = SphereOptions { depth: 1, ..SphereOptions::default() };
    let forming = sphere_forming(&options, 16).unwrap();
    let readings: Vec<usize> = forming.snapshots.iter().map(|s| s.readings).collect();
    assert_eq!((readings[0], readings[readings.len() - 1]), (0, 150));
    assert!(readings.is_sorted_by(|a, b| a < b), "{readings:?}");
    let errors: Vec<f64> = forming.snapshots.iter().map(|s| mean_error(&s.surface)).collect();
    // The error of the cylinder is several per cent; the last snapshot is the result of the filter.
    assert!(errors[errors.len() - 1] < 0.5 * errors[0], "{errors:?}");
}
