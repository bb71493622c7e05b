//! Meshes of surfaces, judged by the mesh crate: manifold, closed where the surface is, within the chord
//! error.

use planish_core::DVec3;
use planish_mesh::{MeshSearch, TriangleMesh};
use planish_spline::{BaseShape, Shape, Surface, Tessellation, TessellationOptions, tessellate};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn bumpy(base: &BaseShape, random: &mut ChaCha8Rng) -> Surface {
    let mut surface = base.surface([10, 8]).unwrap();
    for round in 0..3 {
        let bump = 0.08 * 0.4_f64.powi(round);
        let mut noise = || random.random_range(-bump..bump);
        let vertices =
            surface.vertices().iter().map(|p| *p + 1.0 * DVec3::new(noise(), noise(), noise())).collect();
        surface = surface.with_vertices(vertices).unwrap();
        if round < 2 {
            let supports = surface.space().support_leaves();
            let mut marked = Vec::new();
            for support in &supports {
                if random.random_range(0.0..1.0) < 0.06 {
                    marked.extend(support.iter().map(|&leaf| leaf as usize));
                }
            }
            surface = surface.refined(surface.space().refine(&marked).into()).unwrap();
        }
    }
    surface
}

fn shapes() -> [BaseShape; 4] {
    let axis = DVec3::new(0.0, 0.6, 0.8);
    [
        BaseShape::plane(DVec3::new(1.0, 2.0, 3.0), [DVec3::X, DVec3::new(0.0, 0.6, 0.8)], [2.0, 1.5]),
        BaseShape::cylinder(DVec3::new(1.0, 2.0, 3.0), axis, 1.0, 2.0),
        BaseShape::sphere(DVec3::new(1.0, 2.0, 3.0), 1.5, axis),
        BaseShape::torus(DVec3::new(1.0, 2.0, 3.0), axis, 2.0, 0.7),
    ]
}

fn mesh(tessellation: &Tessellation) -> TriangleMesh {
    TriangleMesh::try_new(tessellation.positions.clone(), tessellation.triangles.clone()).unwrap()
}

#[test]
fn meshes_of_refined_surfaces_are_manifold_and_closed_where_the_surface_is() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for base in shapes() {
        let surface = bumpy(&base, &mut random);
        for tolerance in [1.0, 0.01, 0.001] {
            let options = TessellationOptions { tolerance, ..TessellationOptions::default() };
            let check = mesh(&tessellate(&surface, &options).unwrap()).check();
            let (euler, loops) = match base.shape {
                Shape::Sheet => (1, 1),
                Shape::Tube => (0, 2),
                Shape::Ball => (2, 0),
                Shape::Torus => (0, 0),
            };
            assert!(check.manifold && check.oriented, "{:?}: {check:?}", base.shape);
            assert_eq!(check.watertight, loops == 0, "{:?}: {check:?}", base.shape);
            assert_eq!(
                (check.euler_characteristic, check.boundary_loops, check.components),
                (euler, loops, 1),
                "{:?}",
                base.shape
            );
            assert_eq!((check.unused_vertices, check.degenerate_triangles), (0, 0), "{:?}", base.shape);
        }
    }
}

#[test]
fn the_surface_is_within_the_chord_error_of_its_mesh() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for base in shapes() {
        let surface = bumpy(&base, &mut random);
        let [nu, nv] = surface.space().extent();
        for tolerance in [0.05, 0.002] {
            let options = TessellationOptions { tolerance, ..TessellationOptions::default() };
            let mesh = mesh(&tessellate(&surface, &options).unwrap());
            let search = MeshSearch::try_new(&mesh).unwrap();
            let mut worst = 0.0_f64;
            for _ in 0..20_000 {
                let p = surface.point(random.random_range(0.0..nu), random.random_range(0.0..nv));
                worst = worst.max(search.closest(p).unwrap().distance);
            }
            assert!(worst <= tolerance, "{:?}: {worst} above {tolerance}", base.shape);
            // A bound that is never neared would waste triangles.
            assert!(worst > 0.1 * tolerance, "{:?}: {worst} far below {tolerance}", base.shape);
        }
    }
}

#[test]
fn a_torus_mesh_encloses_its_volume_with_outward_normals() {
    let base = BaseShape::torus(DVec3::ZERO, DVec3::Z, 2.0, 0.5);
    let surface = base.surface([24, 12]).unwrap();
    let options = TessellationOptions { tolerance: 1e-4, ..TessellationOptions::default() };
    let tessellation = tessellate(&surface, &options).unwrap();
    let mesh = mesh(&tessellation);
    let exact = 2.0 * std::f64::consts::PI.powi(2) * 2.0 * 0.25;
    let volume = mesh.signed_volume().unwrap();
    assert!((volume / exact - 1.0).abs() < 2e-3, "{volume} {exact}");
    for (a, b) in mesh.vertex_normals().iter().zip(&tessellation.normals) {
        assert!(a.dot(*b) > 0.99);
    }
}
