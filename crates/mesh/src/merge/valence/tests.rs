//! Edge flips on sheets and balls whose edges were flipped at random.

use super::*;
use crate::mesh::TriangleMesh;
use crate::primitives::{grid_sheet, icosphere};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn valences_of(triangles: &[[u32; 3]], vertices: usize) -> Vec<u32> {
    valences(triangles, &opposites(triangles), vertices)
}

#[test]
fn flips_reduce_high_valences_and_keep_the_surface() {
    let sheet = grid_sheet(1.0, 1.0, 12, 12);
    let mut triangles = sheet.triangles.clone();
    // Flip some diagonals.
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for square in 0..triangles.len() / 2 {
        if rng.random::<f64>() < 0.5 {
            continue;
        }
        let pair = [triangles[2 * square], triangles[2 * square + 1]];
        let unshared = |k: usize| *pair[k].iter().find(|v| !pair[1 - k].contains(v)).unwrap();
        let flipped = |k: usize| {
            let at = pair[k].iter().position(|v| *v == unshared(k)).unwrap();
            [pair[k][at], pair[k][(at + 1) % 3], unshared(1 - k)]
        };
        triangles[2 * square] = flipped(0);
        triangles[2 * square + 1] = flipped(1);
    }
    let before = valences_of(&triangles, sheet.positions.len());
    let area = TriangleMesh::try_new(sheet.positions.clone(), triangles.clone()).unwrap().area();
    let (flips, counted) = even_out(&sheet.positions, &mut triangles, &vec![true; sheet.positions.len()]);
    let after = valences_of(&triangles, sheet.positions.len());
    assert_eq!(counted, after);
    let mesh = TriangleMesh::try_new(sheet.positions, triangles).unwrap();
    assert!(
        flips > 0 && mesh.check().manifold && mesh.check().oriented,
        "{flips} {:?} {before:?}",
        mesh.check()
    );
    assert!((mesh.area() - area).abs() < 1e-12);
    let over = |valence: &[u32]| valence.iter().filter(|v| **v > 6).count();
    assert!(4 * over(&after) < over(&before), "{} and {}", over(&after), over(&before));
}

/// No vertex of 20 irregular seams keeps seven edges: the excess is carried to vertices that have room for
/// it.
#[test]
fn no_vertex_of_a_seam_keeps_seven_edges() {
    let ball = icosphere(1.0, 5);
    let (mut left, mut vertices) = (0, 0);
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut triangles = ball.triangles.clone();
        let mut net = FlipMesh::new(&ball.positions, &mut triangles);
        for half in 0..net.opposite.len() as u32 {
            let middle = net.positions[net.corner(half) as usize];
            if middle[2].abs() < 0.04
                && rng.random::<f64>() < 0.3
                && net.change(half).is_some_and(|(_, around)| net.may_flip(around))
            {
                net.flip(half);
            }
        }
        let seam: Vec<bool> = ball.positions.iter().map(|p| p[2].abs() < 0.04).collect();
        let (_, valence) = even_out(&ball.positions, &mut triangles, &seam);
        left += valence.iter().zip(&seam).filter(|(n, s)| **s && **n > 6).count();
        vertices += seam.iter().filter(|s| **s).count();
        let check = TriangleMesh::try_new(ball.positions.clone(), triangles).unwrap().check();
        assert!(check.manifold && check.oriented && check.watertight, "{check:?}");
    }
    assert!(vertices > 3000 && left == 0, "{left} of {vertices}");
}

#[test]
fn valences_count_edges() {
    let ball = icosphere(1.0, 2);
    let valence = valences_of(&ball.triangles, ball.positions.len());
    assert_eq!(valence.iter().filter(|v| **v == 5).count(), 12);
    assert!(valence.iter().all(|v| *v == 5 || *v == 6));
}
