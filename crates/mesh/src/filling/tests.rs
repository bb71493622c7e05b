use super::*;
use crate::primitives::{cylinder, grid_sheet, icosphere};
use planish_estimate::ErrorKind;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A ball of radius 1 without the part above a height.
fn open_ball(below: f64) -> TriangleMesh {
    let mut ball = icosphere(1.0, 5);
    let kept: Vec<[u32; 3]> = (0..ball.triangles.len())
        .filter(|&t| ball.corners(t).iter().all(|p| p[2] < below))
        .map(|t| ball.triangles[t])
        .collect();
    ball.triangles = kept;
    let used = crate::MergePatch::make_manifold(&ball, &[]).unwrap().patch;
    used.mesh
}

fn fill(mesh: &TriangleMesh, longest: usize) -> Filled {
    fill_holes(mesh, &vec![0.001; mesh.positions.len()], HoleLimit::Edges(longest), &mut |_| Ok(())).unwrap()
}

/// A cover continues the surrounding curvature, so that a ball stays a ball. A flat cover would be wrong by
/// 1 − cos θ (0.1, 0.3, 0.7) and a thin plate by a fifth of that. σ covers the deviation.
#[test]
fn the_cover_of_a_ball_continues_its_curvature() {
    for (below, tolerance) in [(0.9, 0.001), (0.7, 0.005), (0.3, 0.02)] {
        let ball = open_ball(below);
        let n = ball.positions.len();
        let filled = fill(&ball, 10_000);
        let check = filled.mesh.check();
        assert!(check.watertight && check.oriented && check.manifold, "{below}: {check:?}");
        assert_eq!((filled.holes, filled.outer_rims, filled.too_large, filled.uncovered), (1, 0, 0, 0));
        assert_eq!(&filled.mesh.positions[..n], &ball.positions[..]);
        let (mut worst, mut over) = (0.0_f64, 0.0_f64);
        for (p, s) in filled.mesh.positions.iter().zip(&filled.sigma).skip(n) {
            let off = (p.length() - 1.0).abs();
            worst = worst.max(off);
            over = over.max(off / s);
        }
        let angles: Vec<f64> = (ball.triangles.len()..filled.mesh.triangles.len())
            .map(|t| crate::triangle_shape(&filled.mesh.corners(t)).0)
            .collect();
        let small = angles.iter().filter(|a| **a < 0.35).count();
        println!(
            "below {below}: {} vertices, off by {worst:.4}, {over:.2} σ; {small} of {} angles below 20°",
            filled.mesh.positions.len() - n,
            angles.len()
        );
        assert!(
            filled.mesh.positions.len() > n + 20 && worst < tolerance && over < 1.0,
            "{below}: {worst}, {over}"
        );
        assert!(20 * small < angles.len(), "{small} of {}", angles.len());
    }
}

/// Noise at the border is extrapolated into the cover, and σ grows accordingly.
#[test]
fn sigma_of_a_cover_includes_noise_at_its_border() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut outside = 0;
    let mut count = 0;
    for sigma in [0.001, 0.005] {
        let mut ball = open_ball(0.7);
        let n = ball.positions.len();
        for p in &mut ball.positions {
            // Uniform, with this standard deviation.
            let off = sigma * 12_f64.sqrt() * (rng.random::<f64>() - 0.5);
            *p = (1.0 + off) * *p;
        }
        let filled = fill_holes(&ball, &vec![sigma; n], HoleLimit::Edges(10_000), &mut |_| Ok(())).unwrap();
        let over: Vec<f64> = (filled.mesh.positions.iter().zip(&filled.sigma).skip(n))
            .map(|(p, s)| (p.length() - 1.0).abs() / s)
            .collect();
        println!("{sigma}: {:.2} σ at most", over.iter().copied().fold(0.0, f64::max));
        outside += over.iter().filter(|o| **o > 1.96).count();
        count += over.len();
    }
    assert!(20 * outside <= count, "{outside} of {count}");
}

/// The rims of a sheet and of a shallow dome stay open. A hole in the sheet is filled and stays flat, and so
/// are the ends of a tube.
#[test]
fn outer_rims_stay_open() {
    let mut sheet = grid_sheet(2.0, 2.0, 41, 41);
    sheet.triangles.retain(|t| t.iter().any(|v| sheet.positions[*v as usize].length() > 0.5));
    let sheet = crate::MergePatch::make_manifold(&sheet, &[]).unwrap().patch.mesh;
    let filled = fill(&sheet, 10_000);
    assert_eq!((filled.holes, filled.outer_rims), (1, 1));
    assert!(filled.mesh.positions.iter().all(|p| p[2].abs() < 1e-9));
    assert!((filled.mesh.area() - 4.0).abs() < 1e-9);
    let dome = open_ball(-0.5);
    let turned = TriangleMesh::try_new(
        dome.positions.iter().map(|p| DVec3::new(p.x, -p.y, -p.z)).collect(),
        dome.triangles.clone(),
    );
    assert_eq!(fill(&turned.unwrap(), 10_000).outer_rims, 1);
    let tube = fill(&cylinder(1.0, 3.0, 40, 20, false), 40);
    assert!(tube.mesh.check().watertight && tube.holes == 2);
    assert_eq!(fill(&cylinder(1.0, 3.0, 40, 20, false), 39).too_large, 2);
    // The border of a single triangle is not a hole.
    let triangle = TriangleMesh::try_new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).unwrap();
    assert_eq!((fill(&triangle, 10).holes, fill(&triangle, 10).outer_rims), (0, 1));
}

/// A long loop is split before it is covered, in reasonable time, and can be interrupted.
#[test]
fn long_loops_are_covered_too() {
    let tube = cylinder(1.0, 0.02, 3000, 3, false);
    let filled = fill(&tube, 10_000);
    let check = filled.mesh.check();
    assert!(check.watertight && check.manifold && check.oriented, "{check:?}");
    assert!(filled.mesh.positions.len() < 60_000, "{}", filled.mesh.positions.len());
    let sigma = vec![0.001; tube.positions.len()];
    let stopped = fill_holes(&tube, &sigma, HoleLimit::Edges(10_000), &mut |_| Err(Error::interrupted()));
    assert_eq!(stopped.unwrap_err().kind(), ErrorKind::Interrupted);
    assert!(fill_holes(&tube, &sigma[1..], HoleLimit::Edges(10), &mut |_| Ok(())).is_err());
}

/// A slit of any length is narrow, a round hole of the same area is not; wide parts stay open.
#[test]
fn narrow_holes_are_filled_by_width() {
    let sheet = |is_hole: &dyn Fn(DVec3) -> bool| {
        let mut sheet = grid_sheet(4.0, 4.0, 81, 81);
        sheet.triangles.retain(|t| !t.iter().any(|v| is_hole(sheet.positions[*v as usize])));
        crate::MergePatch::make_manifold(&sheet, &[]).unwrap().patch.mesh
    };
    let filled = |mesh: &TriangleMesh, widest: f64| {
        let sigma = vec![0.001; mesh.positions.len()];
        fill_holes(mesh, &sigma, HoleLimit::Width(widest), &mut |_| Ok(())).unwrap()
    };
    // Edges are 0.05 long; with the triangles around it, the slit is 0.15 wide.
    let slit = sheet(&|p| p.x.abs() < 1.5 && p.y.abs() < 0.03);
    let found = filled(&slit, 3.0);
    assert_eq!((found.holes, found.too_large, found.outer_rims), (1, 0, 1));
    assert!((found.mesh.area() - 16.0).abs() < 1e-9);
    assert_eq!(filled(&slit, 1.0).too_large, 1);
    let round = sheet(&|p| p.length() < 0.4);
    assert_eq!((filled(&round, 3.0).holes, filled(&round, 3.0).too_large), (0, 1));
    assert_eq!(filled(&sheet(&|p| p.length() < 0.06), 3.0).holes, 1);
}
