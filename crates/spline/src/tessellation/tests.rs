use super::*;
use crate::base::BaseShape;
use crate::hierarchy::Hierarchy;
use std::collections::HashMap;
use std::sync::Arc;

const SHAPES: [Shape; 4] = [Shape::Sheet, Shape::Tube, Shape::Ball, Shape::Torus];

/// A repeatable value in [−1, 1).
fn noise(n: usize) -> f64 {
    let mut x = (n as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    x ^= x >> 29;
    x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x ^= x >> 32;
    (x >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

fn base(shape: Shape) -> BaseShape {
    let axis = DVec3::new(0.0, 0.6, 0.8);
    match shape {
        Shape::Sheet => {
            BaseShape::plane(DVec3::new(1.0, 2.0, 3.0), [DVec3::X, DVec3::new(0.0, 0.6, 0.8)], [2.0, 1.5])
        }
        Shape::Tube => BaseShape::cylinder(DVec3::new(1.0, 2.0, 3.0), axis, 1.0, 2.0),
        Shape::Ball => BaseShape::sphere(DVec3::new(1.0, 2.0, 3.0), 1.5, axis),
        Shape::Torus => BaseShape::torus(DVec3::new(1.0, 2.0, 3.0), axis, 2.0, 0.7),
    }
}

/// A bumpy surface with random refinement, `rounds` levels deep.
fn bumpy(shape: Shape, rounds: usize, seed: usize) -> Surface {
    let mut surface = base(shape).surface([8, 6]).unwrap();
    for round in 0..=rounds {
        let bump = 0.1 * 0.5_f64.powi(round as i32);
        let vertices = surface.vertices().iter().enumerate().map(|(n, p)| {
            let at = 3 * n + 1000 * round + 77 * seed;
            *p + bump * DVec3::new(noise(at), noise(at + 1), noise(at + 2))
        });
        surface = surface.with_vertices(vertices.collect()).unwrap();
        if round < rounds {
            let supports = surface.space().support_leaves();
            let marked: Vec<usize> = (0..supports.len())
                .filter(|&n| noise(seed + 10_000 * (round + 1) + n) > 0.85)
                .flat_map(|n| supports[n].iter().map(|&leaf| leaf as usize))
                .collect();
            surface = surface.refined(surface.space().refine(&marked).into()).unwrap();
        }
    }
    surface
}

/// Checks that every edge has one or two triangles of opposite direction and that all vertices are used.
/// Returns border edges and the Euler characteristic.
fn check(mesh: &Tessellation) -> (usize, i64) {
    let mut edges: HashMap<[u32; 2], i64> = HashMap::new();
    let mut used = vec![false; mesh.positions.len()];
    for t in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            assert_ne!(a, b, "degenerate triangle {t:?}");
            used[a as usize] = true;
            assert!(
                edges.insert([a, b], 1).is_none(),
                "two triangles traverse {a}-{b} in the same direction"
            );
        }
    }
    assert!(used.iter().all(|&u| u), "an unused vertex");
    let border = edges.keys().filter(|&&[a, b]| !edges.contains_key(&[b, a])).count();
    let distinct = (edges.len() + border) / 2;
    let euler = mesh.positions.len() as i64 - distinct as i64 + mesh.triangles.len() as i64;
    (border, euler)
}

fn options(tolerance: f64) -> TessellationOptions {
    TessellationOptions { tolerance, ..TessellationOptions::default() }
}

#[test]
fn meshes_have_no_cracks_between_levels() {
    for shape in SHAPES {
        for (rounds, seed) in [(0, 0), (1, 1), (2, 2), (3, 3), (3, 4)] {
            let surface = bumpy(shape, rounds, seed);
            assert_eq!(surface.space().levels(), rounds + 1, "{shape:?}: refinement was empty");
            for tolerance in [1.0, 0.03, 0.003] {
                let mesh = tessellate(&surface, &options(tolerance)).unwrap();
                let (border, euler) = check(&mesh);
                let expected = match shape {
                    Shape::Sheet => 1,
                    Shape::Ball => 2,
                    Shape::Tube | Shape::Torus => 0,
                };
                assert_eq!(euler, expected, "{shape:?} {rounds} {tolerance}");
                let closed = matches!(shape, Shape::Ball | Shape::Torus);
                assert_eq!(border == 0, closed, "{shape:?} {rounds} {tolerance}: {border} border edges");
                assert_eq!(mesh.limited_leaves, 0);
            }
        }
    }
}

#[test]
fn vertices_lie_on_the_surface_at_their_parameters() {
    for shape in SHAPES {
        let surface = bumpy(shape, 2, 5);
        let mesh = tessellate(&surface, &options(0.01)).unwrap();
        for n in 0..mesh.positions.len() {
            let [u, v] = mesh.parameters[n];
            let p = surface.point(u, v);
            assert!(p.distance(mesh.positions[n]) < 1e-12, "{shape:?}");
            assert_eq!(surface.space().parameters(mesh.leaf[n] as usize, mesh.local[n]), mesh.parameters[n]);
            let normal = surface.normal(u, v).unwrap();
            assert!(normal.distance(mesh.normals[n]) < 1e-6, "{shape:?} at {u} {v}");
        }
    }
}

#[test]
fn triangles_are_oriented_by_the_normals_and_a_ball_faces_outward() {
    for shape in SHAPES {
        let surface = base(shape).surface([12, 8]).unwrap();
        let mesh = tessellate(&surface, &options(0.003)).unwrap();
        let mut volume = 0.0;
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|n| mesh.positions[n as usize]);
            let n = (b - a).cross(c - a);
            volume += (a - DVec3::new(1.0, 2.0, 3.0)).dot(n) / 6.0;
            for &corner in t {
                assert!(n.dot(mesh.normals[corner as usize]) > 0.0, "{shape:?}");
            }
        }
        let pi = std::f64::consts::PI;
        match shape {
            Shape::Ball => assert!((volume / (4.0 / 3.0 * pi * 1.5_f64.powi(3)) - 1.0).abs() < 0.01),
            Shape::Torus => assert!((volume / (2.0 * pi * pi * 2.0 * 0.49) - 1.0).abs() < 0.02),
            Shape::Sheet | Shape::Tube => {}
        }
    }
}

#[test]
fn a_pole_is_one_vertex_with_its_normal() {
    let axis = DVec3::new(0.0, 0.6, 0.8);
    let surface = base(Shape::Ball).surface([12, 8]).unwrap();
    let mesh = tessellate(&surface, &options(0.001)).unwrap();
    for (v, side) in [(0.0, -1.0), (8.0, 1.0)] {
        let at_pole: Vec<usize> = (0..mesh.positions.len()).filter(|&n| mesh.parameters[n][1] == v).collect();
        assert_eq!(at_pole.len(), 1);
        assert!(mesh.normals[at_pole[0]].distance(side * axis) < 1e-9);
    }
}

#[test]
fn a_plane_has_two_triangles_per_leaf() {
    let surface = base(Shape::Sheet).surface([5, 4]).unwrap();
    let mesh = tessellate(&surface, &options(1e-9)).unwrap();
    assert_eq!(mesh.triangles.len(), 40);
}

#[test]
fn the_limit_of_divisions_is_respected_and_reported() {
    let surface = bumpy(Shape::Torus, 1, 8);
    let limited = TessellationOptions { tolerance: 1e-12, max_divisions: 5 };
    let mesh = tessellate(&surface, &limited).unwrap();
    assert_eq!(mesh.limited_leaves, surface.space().leaves().len());
    // Four divisions in each direction; a fan next to finer leaves has more than two triangles.
    let grid = surface.space().leaves().len() * 32;
    assert!(mesh.triangles.len() > grid && mesh.triangles.len() < 2 * grid);
    check(&mesh);
}

#[test]
fn wrong_options_are_rejected() {
    let surface = base(Shape::Sheet).surface([2, 2]).unwrap();
    for (tolerance, max_divisions) in
        [(0.0, 8), (-1.0, 8), (f64::NAN, 8), (f64::INFINITY, 8), (1.0, 0), (1.0, 65)]
    {
        let wrong = TessellationOptions { tolerance, max_divisions };
        assert!(tessellate(&surface, &wrong).is_err(), "{wrong:?}");
    }
}

#[test]
fn a_collapsed_patch_still_gets_normals() {
    // The first three rows of vertices each collapse to a point: S_u = 0 along v = 0.
    let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [3, 3]).unwrap());
    let vertices =
        space.node_anchors().iter().map(|&[u, v]| DVec3::new(u * (v - 1.0).max(0.0), v, 0.0)).collect();
    let surface = Surface::new(space, vertices).unwrap();
    assert!(surface.normal(1.0, 0.0).is_none());
    let mesh = tessellate(&surface, &options(0.01)).unwrap();
    for n in &mesh.normals {
        assert!((n.length() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn the_mesh_does_not_depend_on_the_number_of_threads() {
    let surface = bumpy(Shape::Ball, 3, 9);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| tessellate(&surface, &options(0.001)).unwrap())
    };
    assert_eq!(run(1), run(3));
}

/// Meshes over quads are closed: neighbours share their vertices across edges, levels and extraordinary
/// vertices, whichever way their parameters run.
#[test]
fn meshes_over_quads_are_closed() {
    use crate::quad_domain::{QuadDomain, test_meshes::two_holes};
    let (quads, positions) = two_holes();
    let division = QuadDomain::new(&quads).unwrap().divided().unwrap();
    let vertices = division.apply(&positions);
    let mut surface =
        Surface::new(Hierarchy::over(Arc::new(division.domain)).unwrap().into(), vertices).unwrap();
    for round in 0..3 {
        let supports = surface.space().support_leaves();
        let own: Vec<usize> =
            supports[(37 * (round + 1)) % supports.len()].iter().map(|&leaf| leaf as usize).collect();
        surface = surface.refined(surface.space().refine(&own).into()).unwrap();
        let options = TessellationOptions { tolerance: 0.01, ..TessellationOptions::default() };
        let mesh = tessellate(&surface, &options).unwrap();
        let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
        for [a, b, c] in &mesh.triangles {
            [(*a, *b), (*b, *c), (*c, *a)].into_iter().for_each(|edge| *edges.entry(edge).or_default() += 1);
        }
        assert!(edges.iter().all(|(&(a, b), &count)| count == 1 && edges.get(&(b, a)) == Some(&1)));
        let euler = mesh.positions.len() as i64 - edges.len() as i64 / 2 + mesh.triangles.len() as i64;
        assert_eq!(euler, -2, "a surface of genus 2");
        for (k, &[u, v]) in mesh.parameters.iter().enumerate() {
            assert!(surface.point(u, v).distance(mesh.positions[k]) < 1e-9, "vertex {k}");
        }
    }
}
