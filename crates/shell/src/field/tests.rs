use super::*;
use planish_mesh::{MeshSearch, grid_sheet, icosphere};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A bumpy ball with an inconsistently oriented facet, one of zero area, and one that is disconnected.
fn rough_mesh() -> TriangleMesh {
    let mut mesh = icosphere(1.0, 2);
    let mut random = ChaCha8Rng::seed_from_u64(8);
    for p in &mut mesh.positions {
        let factor = random.random_range(0.9..1.1);
        *p = p.map(|x| factor * x);
    }
    mesh.triangles[7].swap(0, 1);
    mesh.triangles.push([0, 0, 5]);
    mesh
}

fn places(count: usize, seed: u64) -> Vec<DVec3> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.5..1.5)))).collect()
}

/// Derivatives with respect to the position and all vertices agree with finite differences at a thousand
/// random states.
#[test]
fn derivatives_agree_with_differences() {
    let step = 1e-6;
    for metaball in [Metaball::Triangular, Metaball::Spherical] {
        let mesh = rough_mesh();
        let options = ShellOptions { reach: Some(40.0), ..ShellOptions::new(metaball, 6.0) };
        let shell = Shell::new(&mesh, &options).unwrap();
        let mut shares = Vec::new();
        let mut random = ChaCha8Rng::seed_from_u64(5);
        for at in places(1000, 4) {
            let made = shell.distance(at, &mut shares).unwrap();
            let mut by_vertex = vec![DVec3::ZERO; mesh.positions.len()];
            shell.by_vertices(at, &shares, &made, |vertex, by| {
                by_vertex[vertex as usize] += by;
            });
            // The sign is that of the nearest facet. Halfway between two facets it jumps and has no
            // derivative.
            let same_side = |other: &ShellDistance| other.facet == made.facet;
            for axis in 0..3 {
                let [up, down] = [step, -step].map(|by| {
                    let mut at = at;
                    at[axis] += by;
                    shell.distance(at, &mut Vec::new()).unwrap()
                });
                if same_side(&up) && same_side(&down) {
                    let difference = (up.distance - down.distance) / (2.0 * step);
                    assert!(
                        (difference - made.gradient[axis]).abs() < 1e-4,
                        "{at:?}: {difference} {:?}",
                        made.gradient
                    );
                }
            }
            let (vertex, axis) =
                (random.random_range(0..mesh.positions.len()), random.random_range(0..3_usize));
            let [up, down] = [step, -step].map(|by| {
                let mut mesh = mesh.clone();
                mesh.positions[vertex][axis] += by;
                Shell::new(&mesh, &options).unwrap().distance(at, &mut Vec::new()).unwrap()
            });
            if same_side(&up) && same_side(&down) {
                let difference = (up.distance - down.distance) / (2.0 * step);
                let stated = by_vertex[vertex][axis];
                assert!(
                    (difference - stated).abs() < 1e-4,
                    "{metaball:?} {at:?} {vertex}: {difference} {stated}"
                );
            }
            let hessian = shell.hessian(at, &shares, &made);
            let [up, down] = [step, -step]
                .map(|by| shell.distance(DVec3::new(at[0] + by, at[1], at[2]), &mut Vec::new()).unwrap());
            // Above the border between face and edge the curvature of the distance jumps.
            let near_jump =
                shares.iter().any(|one| one.near.barycentric.iter().any(|b| *b > 0.0 && *b < 1e-4));
            if same_side(&up) && same_side(&down) && !(near_jump && metaball == Metaball::Triangular) {
                for row in 0..3 {
                    let difference = (up.gradient[row] - down.gradient[row]) / (2.0 * step);
                    let off = (difference - hessian[(row, 0)]).abs();
                    assert!(off < 1e-3 * (1.0 + hessian.norm()), "{at:?}: {difference} {hessian}");
                }
                assert!((hessian - hessian.transpose()).norm() < 1e-9 * hessian.norm());
            }
        }
    }
}

/// A translation of the mesh is equivalent to the opposite translation of the position, so the derivatives
/// with respect to the vertices and to the position add up to zero.
#[test]
fn a_translation_of_the_mesh_is_the_opposite_motion_of_the_position() {
    for metaball in [Metaball::Triangular, Metaball::Spherical] {
        let mesh = rough_mesh();
        let shell = Shell::new(&mesh, &ShellOptions::new(metaball, 10.0)).unwrap();
        let mut shares = Vec::new();
        for at in places(200, 9) {
            let made = shell.distance(at, &mut shares).unwrap();
            let mut sum = made.gradient;
            shell.by_vertices(at, &shares, &made, |_, by| sum += by);
            assert!(sum.length() < 1e-9, "{at:?}: {sum:?}");
        }
    }
}

/// On a plane, spherical metaballs have neither thickness nor bulge. The bulge of triangular ones is at most
/// `ln(n)/k`, and the paper's shell is at `d0 − ln(T)/k` for one facet.
#[test]
fn thickness_and_bulge_are_as_stated() {
    let sheet = grid_sheet(4.0, 4.0, 40, 40);
    let k = 12.0;
    let spherical = Shell::new(&sheet, &ShellOptions::new(Metaball::Spherical, k)).unwrap();
    let triangular = Shell::new(&sheet, &ShellOptions::new(Metaball::Triangular, k)).unwrap();
    let middle = sheet.positions.iter().sum::<DVec3>();
    let middle = 1.0 / sheet.positions.len() as f64 * middle;
    for height in [0.0, 0.01, 0.2, 1.0] {
        let at = middle + DVec3::new(0.013, 0.027, height);
        for shell in [&spherical, &triangular] {
            let made = shell.distance(at, &mut Vec::new()).unwrap();
            assert!((made.distance.abs() - height).abs() < 1e-12);
        }
        // The paper's sum has both: on its shell, D is still half a unit.
        assert!(triangular.field(at) < -1.0 || height > 0.2);
    }
    let one = TriangleMesh {
        positions: vec![DVec3::ZERO, DVec3::new(9.0, 0.0, 0.0), DVec3::new(0.0, 9.0, 0.0)],
        triangles: vec![[0, 1, 2]],
    };
    let options =
        ShellOptions { thickness: 0.5, threshold: 0.7, ..ShellOptions::new(Metaball::Triangular, 3.0) };
    let shell = Shell::new(&one, &options).unwrap();
    let sheet_at = options.thickness - options.threshold.ln() / options.sharpness;
    for side in [1.0, -1.0] {
        assert!(shell.field(DVec3::new(2.0, 2.0, side * sheet_at)).abs() < 1e-12);
        assert!(shell.field(DVec3::new(2.0, 2.0, side * 0.9 * sheet_at)) < 0.0);
    }
}

/// For large k the field's distance is the mesh's distance above faces, its gradient has unit length, and no
/// value over- or underflows far away.
#[test]
fn sharp_shells_have_the_distance_of_the_mesh() {
    let mesh = icosphere(1.0, 3);
    let search = MeshSearch::try_new(&mesh).unwrap();
    let shell = Shell::new(&mesh, &ShellOptions::new(Metaball::Triangular, 1e5)).unwrap();
    let (mut compared, mut all) = (0, 0);
    for at in places(300, 2) {
        let made = shell.distance(at, &mut Vec::new()).unwrap();
        let closest = search.closest(at).unwrap();
        all += 1;
        if closest.feature == planish_mesh::Feature::Face && closest.barycentric.iter().all(|b| *b > 0.1) {
            compared += 1;
            assert!((made.distance - closest.signed_distance).abs() < 1e-3, "{at:?} {made:?} {closest:?}");
            assert!((made.gradient.length() - 1.0).abs() < 1e-2);
        }
    }
    assert!(compared * 5 > all, "{compared} of {all}");
    for at in [DVec3::new(1e6, 2e6, -3e6), DVec3::new(1e-3, 0.0, 0.0)] {
        let made = shell.distance(at, &mut Vec::new()).unwrap();
        assert!(made.distance.is_finite() && made.gradient.is_finite());
    }
    assert!(shell.distance(DVec3::new(f64::NAN, 0.0, 0.0), &mut Vec::new()).is_none());
}

/// The truncation error against the complete sum is below its bound.
#[test]
fn truncation_error_is_below_its_bound() {
    let mesh = rough_mesh();
    for metaball in [Metaball::Triangular, Metaball::Spherical] {
        let shell_of = |reach: f64| {
            let options = ShellOptions { reach: Some(reach), ..ShellOptions::new(metaball, 20.0) };
            Shell::new(&mesh, &options).unwrap()
        };
        let others = 1e3 * mesh.triangles.len() as f64;
        let (coarse, untruncated) = (shell_of((others / 1e-3).ln()), shell_of(700.0));
        for at in places(300, 12) {
            let [a, b] = [&coarse, &untruncated].map(|shell| shell.distance(at, &mut Vec::new()).unwrap());
            assert_eq!(a.facet, b.facet);
            // Heights differ at most by the size of the mesh.
            assert!((a.distance - b.distance).abs() < 1e-3 * 4.0, "{a:?} {b:?}");
        }
    }
}

/// Parts lie on their facets, have at most the requested size, and cover the same area.
#[test]
fn subdivision_keeps_the_surface() {
    let mesh = rough_mesh();
    let (fine, origins) = subdivide_for_spheres(&mesh, 0.05, 1_000_000);
    let area = |mesh: &TriangleMesh| {
        (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                0.5 * (b - a).cross(c - a).length()
            })
            .sum::<f64>()
    };
    assert!((area(&fine) - area(&mesh)).abs() < 1e-9);
    for t in 0..fine.triangles.len() {
        assert!(skeleton(&fine.corners(t)).radius <= 0.05);
    }
    for (position, origin) in fine.positions.iter().zip(&origins) {
        let again = origin.iter().fold(DVec3::ZERO, |sum, (v, w)| sum + *w * mesh.positions[*v as usize]);
        assert!(again.distance(*position) < 1e-12);
    }
    let (bounded, _) = subdivide_for_spheres(&mesh, 1e-4, 5000);
    assert!(bounded.triangles.len() <= 5000);
}

#[test]
fn invalid_meshes_and_options_are_rejected() {
    let mesh = icosphere(1.0, 1);
    let refused =
        |mesh: &TriangleMesh, options: ShellOptions| Shell::new(mesh, &options).unwrap_err().to_string();
    assert!(
        refused(&TriangleMesh::default(), ShellOptions::new(Metaball::Triangular, 1.0))
            .contains("expected a mesh with faces")
    );
    for k in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(refused(&mesh, ShellOptions::new(Metaball::Triangular, k)).contains("sharpness"));
    }
    let line = TriangleMesh { positions: vec![DVec3::ZERO, DVec3::X], triangles: vec![[0, 1, 1]] };
    assert!(refused(&line, ShellOptions::new(Metaball::Spherical, 1.0)).contains("area"));
    let invalid_reach =
        ShellOptions { reach: Some(f64::NAN), ..ShellOptions::new(Metaball::Triangular, 1.0) };
    assert!(refused(&mesh, invalid_reach).contains("reach"));
}
