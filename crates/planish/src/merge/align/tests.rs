use super::*;
use nalgebra::{Matrix6, Vector6};
use planish_core::Silent;
use planish_mesh::grid_sheet;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SIGMA: f64 = 0.02;
const ACROSS: f64 = 40.0;

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

/// Fifty by fifty vertices over a square from `x`, a height above each place and an error along the normal
/// there, moved.
fn square(
    x: f64,
    moved: &Pose,
    height: impl Fn(f64, f64) -> f64,
    mut error: impl FnMut(f64, f64) -> f64,
) -> MergePatch {
    let mut mesh = grid_sheet(ACROSS, ACROSS, 49, 49);
    let corner = mesh.bounding_box().map_or(DVec3::ZERO, |b| b.min);
    for p in &mut mesh.positions {
        let [a, b] = [p[0] - corner[0] + x, p[1] - corner[1]];
        let slope = |d: [f64; 2]| (height(a + d[0], b + d[1]) - height(a - d[0], b - d[1])) / 2e-3;
        let n = DVec3::new(-slope([1e-3, 0.0]), -slope([0.0, 1e-3]), 1.0).try_normalize().unwrap();
        *p = moved.apply(DVec3::new(a, b, height(a, b)) + error(a, b) * n);
    }
    MergePatch::make_manifold(&mesh, &vec![SIGMA; mesh.positions.len()]).unwrap().patch
}

/// Aligns patches in place.
fn aligned(patches: &mut [MergePatch]) -> Result<(Vec<ScanPoseReport>, Vec<Finding>)> {
    let names: Vec<String> = (0..patches.len()).map(|k| format!("square {k}")).collect();
    let mut searches = planish_mesh::searches_of(patches)?;
    align(patches, &mut searches, &names, &Silent)
}

fn rolling(x: f64, y: f64) -> f64 {
    3.0 * (x / 6.0).sin() * (y / 7.0).cos() + 0.05 * x
}

/// By how much a pose misses the one that undoes a motion: translation and turn about the axes.
fn error_of(found: &ScanPoseReport, moved: &Pose) -> Vector6<f64> {
    let truth = moved.inverse();
    let pose = Pose::from_quaternion_xyzw(found.quaternion_xyzw, DVec3::from(found.translation)).unwrap();
    let turn = pose.after(&truth.inverse()).rotation_vector();
    Vector6::from_fn(|k, _| match k {
        0..3 => pose.translation[k] - truth.translation[k],
        _ => turn[k - 3],
    })
}

fn chi_square(found: &ScanPoseReport, moved: &Pose) -> f64 {
    let covariance = found.covariance.unwrap();
    let error = error_of(found, moved);
    let inverse = Matrix6::from_fn(|i, j| covariance[i][j]).try_inverse().unwrap();
    (error.transpose() * inverse * error)[(0, 0)]
}

fn random_pose(random: &mut ChaCha8Rng) -> Pose {
    let turn = DVec3::from_array([0; 3].map(|_| 0.008 * normal(random)));
    Pose::from_rotation_vector(turn, DVec3::from_array([0; 3].map(|_| 0.3 * normal(random))))
}

/// Two of three patches in a row are displaced. Over many seeds, their pose errors match the covariances.
#[test]
fn pose_errors_match_their_covariances() {
    let (mut sum, mut far, runs) = (0.0, 0.0_f64, 30);
    for seed in 0..runs {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let moved = [Pose::identity(), random_pose(&mut random), random_pose(&mut random)];
        let mut patches: Vec<MergePatch> = (moved.iter().enumerate())
            .map(|(k, m)| square(22.3 * k as f64, m, rolling, |_, _| SIGMA * normal(&mut random)))
            .collect();
        let (poses, findings) = aligned(&mut patches).unwrap();
        assert!(findings.is_empty(), "{findings:?}");
        assert!(poses[0].covariance.is_none() && poses[0].translation == [0.0; 3]);
        for k in [1, 2] {
            sum += chi_square(&poses[k], &moved[k]);
            far = far.max(error_of(&poses[k], &moved[k]).fixed_rows::<3>(0).norm());
        }
    }
    // The mean of χ² of six over sixty poses has a σ of 0.45; the second pose of a run depends on the first.
    let mean = sum / (2 * runs) as f64;
    println!("mean χ² {mean}, farthest {far}");
    assert!((4.2..7.5).contains(&mean), "mean χ² {mean}, farthest {far}");
    assert!(far < 0.5, "{far}");
}

/// Correlated errors of neighbours increase σ of the pose.
#[test]
fn correlated_errors_increase_sigma() {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    // Waves of half a patch and less.
    let waves: Vec<DVec3> = (0..40).map(|_| DVec3::from_array([0; 3].map(|_| normal(&mut random)))).collect();
    let together = |x: f64, y: f64| -> f64 {
        let wave = |w: &DVec3| (0.4 * (w.x * x + w.y * y) + 9.0 * w.z).sin();
        SIGMA * waves.iter().map(wave).sum::<f64>() / (waves.len() as f64 / 2.0).sqrt()
    };
    let mut sigma = |error: &mut dyn FnMut(f64, f64) -> f64| {
        let mut patches = [
            square(0.0, &Pose::identity(), rolling, |_, _| SIGMA * normal(&mut random)),
            square(15.3, &Pose::identity(), rolling, error),
        ];
        aligned(&mut patches).unwrap().0[1].sigma_translation.unwrap()
    };
    let mut other = ChaCha8Rng::seed_from_u64(5);
    let [alone, shared] = [sigma(&mut |_, _| SIGMA * normal(&mut other)), sigma(&mut { together })];
    assert!(shared > 1.7 * alone, "{shared} {alone}");
}

/// A bump on one patch only does not move it.
#[test]
fn outliers_do_not_move_a_patch() {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let moved = Pose::from_rotation_vector(DVec3::new(0.004, -0.006, 0.005), DVec3::new(0.3, -0.25, 0.35));
    let mut patches = [
        square(0.0, &Pose::identity(), rolling, |_, _| SIGMA * normal(&mut random)),
        square(15.3, &moved, rolling, |x, y| {
            let bump = if (x - 30.0).hypot(y - 20.0) < 6.0 { 0.4 } else { 0.0 };
            bump + SIGMA * normal(&mut random)
        }),
    ];
    let (poses, findings) = aligned(&mut patches).unwrap();
    assert!(findings.is_empty(), "{findings:?}");
    let error = error_of(&poses[1], &moved);
    assert!(error.fixed_rows::<3>(0).norm() < 0.02, "{error}");
    let moved_by = poses[1].moved.unwrap();
    assert!((0.3..1.0).contains(&moved_by), "{moved_by}");
}

/// Planes determine three of six directions. Along the other three, the patch is not moved, with a warning.
#[test]
fn sliding_directions_are_undetermined() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let moved = Pose::from_rotation_vector(DVec3::new(0.004, -0.006, 0.0), DVec3::new(0.0, 0.0, 0.35));
    let mut patches = [
        square(0.0, &Pose::identity(), |_, _| 0.0, |_, _| SIGMA * normal(&mut random)),
        square(15.3, &moved, |_, _| 0.0, |_, _| SIGMA * normal(&mut random)),
    ];
    let (poses, findings) = aligned(&mut patches).unwrap();
    assert_eq!(poses[1].undetermined.len(), 3, "{:?}", poses[1]);
    let message = findings.iter().map(|f| f.text.as_str()).collect::<Vec<_>>().join("\n");
    assert!(message.contains("do not determine 3 of the six directions of motion of square 1"), "{message}");
    let error = error_of(&poses[1], &moved);
    assert!(error[2].abs() < 0.01 && error[3].abs() < 1e-3 && error[4].abs() < 1e-3, "{error}");
    assert!(error[0].abs() < 0.1 && error[1].abs() < 0.1, "{error}");
}

#[test]
fn patches_out_of_reach_are_refused() {
    let far = |x: f64| square(x, &Pose::identity(), rolling, |_, _| 0.0);
    let message = aligned(&mut [far(0.0), far(400.0)]).unwrap_err().to_string();
    assert!(message.contains("within"), "{message}");
}

/// Patches of different objects are near at some places, but cannot be aligned.
#[test]
fn patches_of_different_objects_are_refused() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let other = |x: f64, y: f64| rolling(1.7 * y + 4.0, 1.4 * x);
    let mut patches = [
        square(0.0, &Pose::identity(), rolling, |_, _| SIGMA * normal(&mut random)),
        square(15.3, &Pose::identity(), other, |_, _| SIGMA * normal(&mut random)),
    ];
    let message = aligned(&mut patches).unwrap_err().to_string();
    assert!(
        message.contains("square 1 cannot be aligned") && message.contains("σ of their difference"),
        "{message}"
    );
}
