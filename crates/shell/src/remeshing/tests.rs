use super::*;
use planish_mesh::icosphere;

/// The region between two planes, or outside of them.
struct Slab {
    from: f64,
    to: f64,
    sign: f64,
}

impl Region for Slab {
    fn depth(&self, at: DVec3) -> f64 {
        self.sign * (at[0] - self.from).min(self.to - at[0])
    }

    fn may_contain_boundary(&self, at: DVec3, reach: f64) -> bool {
        self.depth(at).abs() <= reach
    }
}

/// The unbounded region.
const UNBOUNDED: Slab = Slab { from: -100.0, to: 100.0, sign: 1.0 };

fn options(domain: &dyn Region) -> RemeshOptions<'_> {
    RemeshOptions { domain, flow: None, cell: 0.06, min_part_volume_ratio: 0.01, smoothing_passes: 0 }
}

/// Two intersecting balls, the second one also nested inside the first.
fn crossing() -> TriangleMesh {
    let mut all = icosphere(1.0, 4);
    for (radius, x) in [(1.0, 1.2), (0.5, 0.0)] {
        let first = all.positions.len() as u32;
        let ball = icosphere(radius, 4);
        all.positions.extend(ball.positions.iter().map(|p| DVec3::new(p.x + x, p.y, p.z)));
        (all.triangles).extend(ball.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    all
}

/// A self-intersecting mesh is replaced by the surface of its inside: one part without intersections, on the
/// outer spheres.
#[test]
fn self_intersections_become_one_surface() {
    let made = remesh(&crossing(), &options(&UNBOUNDED)).unwrap();
    let check = made.check();
    assert!(check.watertight && check.manifold && check.oriented, "{check:?}");
    assert_eq!((check.components, check.euler_characteristic), (1, 2));
    for p in &made.positions {
        let nearest = p.length().min(DVec3::new(p[0] - 1.2, p[1], p[2]).length());
        assert!((nearest - 1.0).abs() < 0.02, "{p:?}");
    }
    assert!(made.signed_volume().unwrap() > 0.0);
}

/// Parts outside of the domain are removed, which opens the mesh; small fragments are rejected.
#[test]
fn parts_outside_of_the_domain_are_cut() {
    let without = |from, to| Slab { from, to, sign: -1.0 };
    let torn = remesh(&crossing(), &options(&without(0.5, 0.7))).unwrap();
    assert_eq!((torn.check().components, torn.check().watertight), (2, true));
    assert!(torn.positions.iter().all(|p| !(0.52..0.68).contains(&p[0])));
    // A cap of a fortieth of the size.
    let remaining = remesh(&icosphere(1.0, 4), &options(&without(0.6, 0.9))).unwrap();
    assert_eq!(remaining.check().components, 1);
    let outside = remesh(&icosphere(1.0, 3), &options(&without(-2.0, 2.0))).unwrap_err();
    assert!(outside.to_string().contains("expected a part of the mesh"), "{outside}");
    let mut open = icosphere(1.0, 3);
    open.triangles.pop();
    let refused = remesh(&open, &options(&UNBOUNDED)).unwrap_err().to_string();
    assert!(refused.contains("3 boundary edges"), "{refused}");
}

/// The mesh grows into the uncovered region up to the limit and does not move in the covered region.
#[test]
fn meshes_grow_only_outside_of_the_covered_region() {
    let covered = Slab { from: -100.0, to: 0.0, sign: 1.0 };
    let flow = RemeshOptions { flow: Some((&covered, 0.3)), ..options(&UNBOUNDED) };
    let made = remesh(&icosphere(1.0, 4), &flow).unwrap();
    assert!(made.check().watertight);
    for p in &made.positions {
        let radius = p.length();
        if p[0] > 0.1 {
            assert!((radius - 1.3).abs() < 0.02, "{p:?}");
        } else if p[0] < -0.1 {
            assert!((radius - 1.0).abs() < 0.02, "{p:?}");
        }
    }
}

/// Smoothing removes roughness without shrinking, also over many rounds.
#[test]
fn smoothing_does_not_shrink() {
    let mut rough = icosphere(1.0, 5);
    for (k, p) in rough.positions.iter_mut().enumerate() {
        let share = 1.0 + 0.02 * (k as f64 * 2.4).sin();
        *p = p.map(|x| share * x);
    }
    let spread = |smoothing_passes| {
        let made = remesh(&rough, &RemeshOptions { smoothing_passes, ..options(&UNBOUNDED) }).unwrap();
        let radii: Vec<f64> = made.positions.iter().map(|p| p.length()).collect();
        let mean = radii.iter().sum::<f64>() / radii.len() as f64;
        let variance = radii.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / radii.len() as f64;
        (mean, variance.sqrt())
    };
    let ([before, rough], [after, smooth]) = (<[f64; 2]>::from(spread(0)), <[f64; 2]>::from(spread(20)));
    assert!(smooth < 0.7 * rough, "{smooth} {rough}");
    assert!((after - before).abs() < 0.005, "{after} {before}");
}

/// Means keep constant values, and distribute the value of one vertex with a constant sum on a mesh of
/// constant valence.
#[test]
fn smoothed_vertex_values_are_means() {
    let ball = icosphere(1.0, 3);
    let count = ball.positions.len();
    assert!((smooth_vertex_values(&ball, &vec![2.0; count], 10).iter()).all(|x| (x - 2.0).abs() < 1e-12));
    let mut one = vec![0.0; count];
    one[100] = 1.0;
    let spread = smooth_vertex_values(&ball, &one, 10);
    assert!(spread.iter().all(|x| (0.0..0.2).contains(x)) && spread[100] > 0.0);
    assert!((spread.iter().sum::<f64>() - 1.0).abs() < 0.1);
}
