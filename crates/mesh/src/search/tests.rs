use super::*;
use crate::primitives::{cylinder, grid_sheet, icosphere};
use planish_estimate::ErrorKind;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, TAU};

fn any(random: &mut ChaCha8Rng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| random.random::<f64>() * 2.0 - 1.0))
}

/// Random triangles, one in three without area.
fn random_triangles(count: u32, seed: u64) -> TriangleMesh {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut positions = Vec::new();
    for t in 0..count {
        let a = any(&mut random);
        let b = a + 0.2 * any(&mut random);
        let c = a + 0.2 * any(&mut random);
        positions.extend(match t % 12 {
            0 => [a, a, a],
            1 => [a, a, b],
            2 => [a, b, 0.3 * a + 0.7 * b],
            3 => [a, b, 0.3 * a + 0.7 * b + 1e-15 * c],
            _ => [a, b, c],
        });
    }
    TriangleMesh::try_new(positions, (0..count).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect()).unwrap()
}

/// The distance from one triangle by another method: Voronoi regions (Ericson, Real-Time Collision Detection
/// 2005, 5.1.5), and segments for triangles without area.
fn reference_distance(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let segment = |a: DVec3, b: DVec3| {
        let ab = b - a;
        let s = if ab.length_squared() > 0.0 {
            ((p - a).dot(ab) / ab.length_squared()).clamp(0.0, 1.0)
        } else {
            0.0
        };
        p.distance(a + s * ab)
    };
    let edges = segment(a, b).min(segment(b, c)).min(segment(c, a));
    let (ab, ac) = (b - a, c - a);
    if ab.cross(ac).length() < 1e-10 * ab.length() * ac.length() {
        return edges;
    }
    let (ap, bp, cp) = (p - a, p - b, p - c);
    let (d1, d2, d3, d4) = (ab.dot(ap), ac.dot(ap), ab.dot(bp), ac.dot(bp));
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    if va > 0.0 && vb > 0.0 && vc > 0.0 {
        let sum = va + vb + vc;
        p.distance(a + vb / sum * ab + vc / sum * ac)
    } else {
        edges
    }
}

#[test]
fn closest_agrees_with_all_triangles() {
    let mesh = random_triangles(600, 1);
    let search = MeshSearch::try_new(&mesh).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(2);
    for round in 0..3000 {
        // Near, inside, far; every fourth exactly on a vertex.
        let p = match round % 4 {
            0 => mesh.positions[random.random_range(0..mesh.positions.len())],
            1 => 10.0 * any(&mut random),
            _ => any(&mut random),
        };
        let expected = (0..600).map(|t| reference_distance(p, mesh.corners(t))).fold(f64::INFINITY, f64::min);
        let foot = search.closest(p).unwrap();
        assert!((foot.distance - expected).abs() < 1e-13, "{} {expected}", foot.distance);
        let t = foot.triangle as usize;
        assert!((p.distance(foot.point) - foot.distance).abs() < 1e-13);
        assert!(mesh.point_at(t, foot.barycentric).distance(foot.point) < 1e-13);
        assert!(foot.barycentric.iter().all(|&b| (0.0..=1.0).contains(&b)));
        assert!((foot.barycentric.iter().sum::<f64>() - 1.0).abs() < 1e-14);
        let zeros = foot.barycentric.iter().filter(|&&b| b == 0.0).count();
        let expected_zeros = match foot.feature {
            Feature::Face => 0,
            Feature::Edge(_) => 1,
            Feature::Vertex(_) => 2,
        };
        assert_eq!(zeros, expected_zeros);
    }
}

#[test]
fn hints_bounds_and_batches_do_not_change_the_answer() {
    let mesh = random_triangles(900, 3);
    let search = MeshSearch::try_new(&mesh).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let mut points: Vec<DVec3> = (0..2000).map(|_| any(&mut random)).collect();
    points[17] = DVec3::new(f64::NAN, 0.0, 0.0);
    let all = search.closest_all(&points);
    let within = search.closest_all_within(&points, 0.1);
    for (i, &p) in points.iter().enumerate() {
        let plain = search.closest(p);
        assert_eq!(plain, all[i]);
        let Some(plain) = plain else {
            assert_eq!((i, within[i]), (17, None));
            continue;
        };
        for hint in [0, plain.triangle, 899, u32::MAX] {
            assert_eq!(search.closest_hinted(p, hint), Some(plain));
        }
        assert_eq!(within[i], (plain.distance <= 0.1).then_some(plain));
        assert_eq!(search.closest_within(p, plain.distance * (1.0 + 1e-12)), Some(plain));
        assert_eq!(search.closest_within(p, plain.distance * (1.0 - 1e-12)), None);
    }
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(one_thread.install(|| search.closest_all(&points)), all);
}

/// The winding number of a closed mesh: the solid angle of its triangles over 4π (van Oosterom and Strackee
/// 1983). It is 1 inside and 0 outside for any shape.
fn winding(mesh: &TriangleMesh, p: DVec3) -> f64 {
    let half_angles = (0..mesh.triangles.len()).map(|t| {
        let [a, b, c] = mesh.corners(t).map(|q| q - p);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        a.dot(b.cross(c)).atan2(la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
    });
    half_angles.sum::<f64>() / TAU
}

#[test]
fn signs_match_winding_numbers_at_spikes_and_creases() {
    // A ball with alternating radii of 0.4 and 1.6 has sharp spikes and notches, where the normal of the
    // nearest face alone gives the wrong side.
    let mut spiky = icosphere(1.0, 2);
    for (i, p) in spiky.positions.iter_mut().enumerate() {
        *p = (if i % 2 == 0 { 0.4 } else { 1.6 }) * *p;
    }
    let can = cylinder(0.7, 0.2, 7, 1, true);
    let mut random = ChaCha8Rng::seed_from_u64(8);
    for mesh in [spiky, can] {
        let search = MeshSearch::try_new(&mesh).unwrap();
        let mut features = [0; 3];
        for _ in 0..4000 {
            let p = 1.8 * any(&mut random);
            let foot = search.closest(p).unwrap();
            assert_eq!(foot.signed_distance < 0.0, winding(&mesh, p) > 0.5, "{p:?} {foot:?}");
            assert!(!foot.on_boundary);
            features[match foot.feature {
                Feature::Face => 0,
                Feature::Edge(_) => 1,
                Feature::Vertex(_) => 2,
            }] += 1;
        }
        assert!(features.iter().all(|&n| n > 100), "{features:?}");
    }
}

#[test]
fn signs_of_a_triangle_soup_match_the_closed_mesh() {
    let ball = cylinder(0.7, 0.2, 7, 1, true);
    let soup = TriangleMesh {
        positions: (0..ball.triangles.len()).flat_map(|t| ball.corners(t)).collect(),
        triangles: (0..ball.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
    };
    let (a, b) = (MeshSearch::try_new(&ball).unwrap(), MeshSearch::try_new(&soup).unwrap());
    let mut random = ChaCha8Rng::seed_from_u64(10);
    for _ in 0..1000 {
        let p = any(&mut random);
        assert_eq!(a.closest(p), b.closest(p));
    }
}

#[test]
fn distances_from_a_faceted_ball_match_the_sphere() {
    let ball = icosphere(2.0, 6);
    let search = MeshSearch::try_new(&ball).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(12);
    // The facets lie inside the sphere by at most their sagitta.
    let sagitta = 2.0
        - (0..ball.triangles.len()).map(|t| ball.point_at(t, [1.0 / 3.0; 3]).length()).fold(2.0, f64::min);
    assert!(sagitta < 2.0 * 0.3 / 4096.0, "{sagitta}");
    for _ in 0..2000 {
        let p = 4.0 * any(&mut random);
        let foot = search.closest(p).unwrap();
        let smooth = p.length() - 2.0;
        assert!(foot.signed_distance > smooth - 1e-12 && foot.signed_distance < smooth + 1.1 * sagitta);
        if p.length() > 0.5 {
            assert!(foot.normal.dot(p) / p.length() > 0.99);
        }
    }
}

#[test]
fn feet_on_an_open_border_are_marked() {
    let sheet = grid_sheet(2.0, 2.0, 4, 4);
    let search = MeshSearch::try_new(&sheet).unwrap();
    let beyond = search.closest(DVec3::new(1.3, 0.1, -0.4)).unwrap();
    assert!(beyond.on_boundary && (beyond.signed_distance + 0.5).abs() < 1e-15);
    let corner = search.closest(DVec3::new(2.0, 2.0, 0.0)).unwrap();
    assert!(corner.on_boundary && matches!(corner.feature, Feature::Vertex(_)));
    let above = search.closest(DVec3::new(0.5, 0.5, 0.25)).unwrap();
    assert!(!above.on_boundary && above.signed_distance == 0.25);
}

#[test]
fn incompatible_triangles_are_ignored() {
    // Two sheets back to back, 0.1 apart; a point nearer to the lower one, which faces down.
    let mut mesh = grid_sheet(1.0, 1.0, 3, 3);
    let count = mesh.positions.len() as u32;
    let lower: Vec<DVec3> = mesh.positions.iter().map(|p| DVec3::new(p.x, p.y, -0.1)).collect();
    mesh.positions.extend(lower);
    let turned: Vec<[u32; 3]> =
        mesh.triangles.iter().map(|t| [t[1] + count, t[0] + count, t[2] + count]).collect();
    mesh.triangles.extend(turned);
    let search = MeshSearch::try_new(&mesh).unwrap();
    let p = DVec3::new(0.07, 0.03, -0.08);
    assert!((search.closest(p).unwrap().signed_distance + 0.02).abs() < 1e-15);
    let up = search.closest_compatible(p, DVec3::new(0.3, 0.0, 2.0), FRAC_PI_2).unwrap();
    assert!((up.signed_distance + 0.08).abs() < 1e-15 && up.triangle < 18);
    assert!(search.closest_compatible(p, DVec3::new(1.0, 0.0, 0.1), 0.5).is_none());
    assert!(search.closest_compatible(p, DVec3::ZERO, 3.0).is_none());
    assert!(search.closest_within(p, -1.0).is_none() && search.closest_within(DVec3::ZERO, -1.0).is_none());
    assert!(search.closest_compatible_within(p, DVec3::Z, 0.1, 0.05).is_none());
    assert!(search.closest_compatible_within(p, DVec3::Z, 0.1, 0.09).is_some());
}

#[test]
fn meshes_without_triangles_are_rejected() {
    let none = TriangleMesh::try_new(vec![DVec3::ZERO], vec![]).unwrap();
    assert_eq!(MeshSearch::try_new(&none).unwrap_err().kind(), ErrorKind::Undetermined);
    let broken = TriangleMesh { positions: vec![], triangles: vec![[0, 1, 2]] };
    assert_eq!(MeshSearch::try_new(&broken).unwrap_err().kind(), ErrorKind::Input);
}

/// Copies of a triangle change no answer, whatever their corner comes first. The tree leaves them out,
/// because every search would compare all of them.
#[test]
fn copies_of_triangles_change_no_answer() {
    let ball = icosphere(1.0, 2);
    let mut copied = ball.clone();
    for turn in 0..3 {
        copied.triangles.extend(ball.triangles.iter().map(|t| [0, 1, 2].map(|k| t[(k + turn) % 3])));
    }
    let (search, with_copies) = (MeshSearch::try_new(&ball).unwrap(), MeshSearch::try_new(&copied).unwrap());
    assert_eq!(with_copies.bvh.triangles.len(), ball.triangles.len());
    assert_eq!(with_copies.triangle_count(), copied.triangles.len());
    for k in 0..50 {
        let p = DVec3::new((f64::from(k)).sin(), (1.7 * f64::from(k)).cos(), 0.4);
        let (a, b) = (search.closest(p).unwrap(), with_copies.closest_hinted(p, 900).unwrap());
        assert_eq!((a.point, a.triangle), (b.point, b.triangle));
    }
    // A triangle of the opposite orientation is no copy: searches by normal tell them apart.
    let mut both = ball.clone();
    both.triangles.extend(ball.triangles.iter().map(|[a, b, c]| [*a, *c, *b]));
    assert_eq!(MeshSearch::try_new(&both).unwrap().bvh.triangles.len(), both.triangles.len());
}
