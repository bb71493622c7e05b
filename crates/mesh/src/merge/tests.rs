use super::*;
use crate::primitives::{grid_sheet, icosphere};
use crate::search::MeshSearch;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The part of a rotated ball on one side of a plane.
fn cap(turn: f64, axis: DVec3, min_height: f64, subdivisions: u32) -> TriangleMesh {
    let mut ball = icosphere(10.0, subdivisions);
    let (s, c) = turn.sin_cos();
    for p in &mut ball.positions {
        *p = DVec3::new(c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]);
        let DVec3 { x, y, z } = *p;
        *p = DVec3::new(x, c * y - s * z, s * y + c * z);
    }
    ball.triangles.retain(|t| t.iter().all(|v| ball.positions[*v as usize].dot(axis) >= min_height));
    ball
}

fn merge(meshes: &[TriangleMesh], sigma: f64, options: &OverlapOptions) -> (Overlap, StitchedMesh) {
    let patches: Vec<MergePatch> = meshes
        .iter()
        .map(|m| MergePatch::make_manifold(m, &vec![sigma; m.positions.len()]).unwrap().patch)
        .collect();
    let overlap = Overlap::find(&patches, options).unwrap();
    let fused = fuse_patches(&patches, &overlap);
    let zipped = stitch_patches(&patches, &overlap, &fused, &StitchOptions::default()).unwrap();
    (overlap, zipped)
}

#[test]
fn two_caps_of_a_ball_give_a_watertight_ball() {
    let meshes = [cap(0.3, DVec3::Z, -2.0, 5), cap(1.1, DVec3::new(0.0, 0.0, -1.0), -2.0, 5)];
    let (overlap, zipped) = merge(&meshes, 0.02, &OverlapOptions::default());
    let check = zipped.mesh.check();
    assert!(check.watertight && check.manifold && check.oriented, "{check:?}");
    assert_eq!(check.euler_characteristic, 2);
    assert_eq!(overlap.regions.len(), 1);
    for p in &zipped.mesh.positions {
        assert!((p.length() - 10.0).abs() < 0.02, "{p:?}");
    }
    assert!(zipped.valence.iter().skip(8).sum::<usize>() == 0, "{:?}", zipped.valence);
}

#[test]
fn six_noisy_patches_give_a_watertight_ball_with_calibrated_sigma() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let sigma = 0.03;
    let axes = [
        DVec3::X,
        DVec3::new(-1.0, 0.0, 0.0),
        DVec3::Y,
        DVec3::new(0.0, -1.0, 0.0),
        DVec3::Z,
        DVec3::new(0.0, 0.0, -1.0),
    ];
    let mut meshes: Vec<TriangleMesh> =
        axes.iter().enumerate().map(|(k, axis)| cap(0.2 + 0.37 * k as f64, *axis, 4.0, 5)).collect();
    for mesh in &mut meshes {
        for p in &mut mesh.positions {
            let noise: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            *p += sigma * noise * p.try_normalize().unwrap();
        }
    }
    let (_, zipped) = merge(&meshes, sigma, &OverlapOptions::default());
    let check = zipped.mesh.check();
    assert!(check.watertight && check.manifold && check.oriented, "{check:?}");
    let squares: f64 = zipped
        .mesh
        .positions
        .iter()
        .zip(&zipped.sigma)
        .map(|(p, s)| ((p.length() - 10.0) / s).powi(2))
        .sum::<f64>()
        / zipped.mesh.positions.len() as f64;
    assert!((0.7..1.3).contains(&squares), "{squares}");
}

#[test]
fn overlapping_sheets_become_one_with_the_same_outline() {
    let mut left = grid_sheet(10.0, 10.0, 41, 41);
    let mut right = grid_sheet(10.0, 10.0, 34, 34);
    for p in &mut left.positions {
        p[0] -= 4.0;
    }
    for p in &mut right.positions {
        p[0] += 4.0;
        p[2] += 0.01;
    }
    let (_, zipped) = merge(&[left.clone(), right], 0.01, &OverlapOptions::default());
    let check = zipped.mesh.check();
    assert!(
        check.manifold && check.oriented && check.boundary_loops == 1 && check.components == 1,
        "{check:?}"
    );
    assert!((zipped.mesh.area() - 180.0).abs() < 1.0, "{}", zipped.mesh.area());
    let search = MeshSearch::try_new(&zipped.mesh).unwrap();
    for p in &left.positions {
        assert!(search.closest(*p).unwrap().distance < 0.2, "{p:?}");
    }
}

#[test]
fn duplicate_and_contained_patches_are_ignored() {
    let sheet = grid_sheet(10.0, 10.0, 31, 31);
    let small = grid_sheet(3.0, 3.0, 12, 12);
    let (_, zipped) = merge(&[sheet.clone(), sheet.clone(), small], 0.01, &OverlapOptions::default());
    assert_eq!(zipped.mesh.triangles.len(), sheet.triangles.len());
    assert!((zipped.mesh.area() - 100.0).abs() < 1e-9);
}

#[test]
fn errors_name_the_invalid_patch() {
    let patch = |sigma: Vec<f64>| MergePatch { mesh: grid_sheet(1.0, 1.0, 3, 3), sigma };
    let message =
        |patches: &[MergePatch]| Overlap::find(patches, &OverlapOptions::default()).unwrap_err().to_string();
    assert!(message(&[patch(vec![])]).contains("two patches"));
    assert!(message(&[patch(vec![]), patch(vec![0.1; 3])]).contains("patch 1"));
    let mut sigma = vec![0.1; patch(vec![]).mesh.positions.len()];
    sigma[3] = f64::NAN;
    assert!(message(&[patch(sigma), patch(vec![])]).contains("vertex 3"));
    assert!(message(&[patch(vec![]), MergePatch::default()]).contains("expected triangles"));
}

/// An unstated σ is estimated from the differences, whether the other patch states its own or not.
#[test]
fn an_unstated_sigma_is_estimated_from_differences() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut sheet = |shift: f64, sigma: f64| {
        let mut mesh = grid_sheet(60.0, 60.0, 60, 60);
        for p in &mut mesh.positions {
            let noise = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            *p = DVec3::new(p[0] + shift, p[1] + 0.7 * shift, sigma * noise);
        }
        mesh
    };
    let (precise, noisy) = (sheet(0.0, 0.05), sheet(0.4, 0.2));
    let equal = [sheet(0.1, 0.1), sheet(0.55, 0.1)];
    let patch = |mesh: &TriangleMesh, sigma: &[f64]| MergePatch { mesh: mesh.clone(), sigma: sigma.to_vec() };
    let found = |patches: [MergePatch; 2]| {
        let overlap = Overlap::find(&patches, &OverlapOptions::default()).unwrap();
        overlap.patches.iter().map(|p| p.sigma[0]).collect::<Vec<_>>()
    };
    let stated = vec![0.05; precise.positions.len()];
    let one = found([patch(&precise, &stated), patch(&noisy, &[])]);
    assert!(one[0] == 0.05 && (one[1] / 0.2 - 1.0).abs() < 0.06, "{one:?}");
    for sigma in found(equal.each_ref().map(|mesh| patch(mesh, &[]))) {
        assert!((sigma / 0.1 - 1.0).abs() < 0.06, "{sigma}");
    }
}

fn moved(mut mesh: TriangleMesh, by: DVec3) -> TriangleMesh {
    for p in &mut mesh.positions {
        *p += by;
    }
    mesh
}

/// If two sheets are equally far inside, rounding must not decide triangle by triangle which one is kept: the
/// result has no holes at any scale.
#[test]
fn seams_do_not_depend_on_rounding() {
    for scale in [1.0, 0.7, 0.01, 0.001] {
        let sheet = grid_sheet(400.0 * scale, 80.0 * scale, 400, 80);
        let other = moved(sheet.clone(), DVec3::new(200.6 * scale, 0.14 * scale, 0.0));
        let (_, zipped) = merge(&[sheet, other], 0.01 * scale, &OverlapOptions::default());
        let check = zipped.mesh.check();
        assert!(check.boundary_loops == 1 && check.manifold, "{scale}: {check:?}");
        let area = zipped.mesh.area() / (scale * scale);
        assert!((area - 600.6 * 80.0).abs() < 30.0, "{scale}: {area}");
    }
}

/// Two scans from one viewpoint have the same border within noise: one of them is kept as a whole.
#[test]
fn two_scans_from_one_viewpoint_leave_no_holes() {
    for sigma in [0.001, 0.03] {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut scan = || {
            let mut mesh = grid_sheet(40.0, 20.0, 80, 40);
            for p in &mut mesh.positions {
                p[2] = sigma * ((0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0);
            }
            mesh
        };
        let meshes = [scan(), scan()];
        let (_, zipped) = merge(&meshes, sigma, &OverlapOptions::default());
        let check = zipped.mesh.check();
        assert_eq!(check.boundary_loops, 1, "{sigma}: {check:?}");
        assert!(zipped.mesh.area() >= 799.0, "{sigma}: {}", zipped.mesh.area());
    }
}

/// The detail that a fine patch shows between the vertices of a coarse one is kept, in either order of both.
#[test]
fn a_fine_patch_keeps_its_detail_within_a_coarse_one() {
    let coarse = grid_sheet(100.0, 100.0, 20, 20);
    let mut fine = grid_sheet(30.0, 30.0, 60, 60);
    let bump = |x: f64, y: f64| 0.5 * (-(x * x + y * y) / 8.0).exp();
    for p in &mut fine.positions {
        p[2] = bump(p[0], p[1]);
    }
    for order in [[0, 1], [1, 0]] {
        let patches = [(&coarse, 0.2), (&fine, 0.02)].map(|(mesh, sigma)| {
            MergePatch::make_manifold(mesh, &vec![sigma; mesh.positions.len()]).unwrap().patch
        });
        let patches = order.map(|k| patches[k].clone());
        let overlap = Overlap::find(&patches, &OverlapOptions::default()).unwrap();
        let zipped =
            stitch_patches(&patches, &overlap, &fuse_patches(&patches, &overlap), &StitchOptions::default())
                .unwrap();
        let check = zipped.mesh.check();
        assert!(check.boundary_loops == 1 && check.manifold, "{check:?}");
        let top = zipped.mesh.positions.iter().map(|p| p[2]).fold(0.0, f64::max);
        assert!((top - 0.5).abs() < 0.02, "{top}");
    }
}

/// A patch within one triangle of another shares a region with it.
#[test]
fn a_patch_on_one_triangle_overlaps() {
    let plate = grid_sheet(100.0, 100.0, 4, 4);
    let fine = moved(grid_sheet(4.0, 3.0, 40, 28), DVec3::new(8.0, 4.0, 0.01));
    let (overlap, _) = merge(&[plate, fine.clone()], 0.05, &OverlapOptions::default());
    assert_eq!(overlap.regions.len(), 1);
    assert_eq!(overlap.regions[0].points, fine.positions.len());
}
