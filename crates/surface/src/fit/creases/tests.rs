//! Creases of bodies of which the sharp edges are known.

use super::chains::{close_corners, graph_of};
use super::{SharpEdges, Sphere, with_creases};
use crate::fit::enclosing_mesh::enclosing_mesh;
use crate::fit::options::Handles;
use crate::layout::CreasedMesh;
use planish_core::{BoundingBox, DVec3};
use planish_mesh::{TriangleMesh, isosurface};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// A straight edge, or a part of a circle, as points that are close together.
type Edge = Vec<DVec3>;

/// A body as a function that is negative inside, with its sharp edges.
struct Body {
    height: fn(DVec3) -> f64,
    edges: Vec<Edge>,
}

/// How readings are spread over a body.
#[derive(Clone, Copy)]
enum Spread {
    Uniform,
    /// On planes three spacings apart.
    Lines,
    /// Four times as dense on one side.
    Uneven,
}

const SIGMA: f64 = 0.05;

fn segment(a: [f64; 3], b: [f64; 3]) -> Edge {
    let (a, b) = (DVec3::from(a), DVec3::from(b));
    (0..=400).map(|k| a.lerp(b, f64::from(k) / 400.0)).collect()
}

fn circle(radius: f64, z: f64) -> Edge {
    (0..1200)
        .map(|k| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 1200.0).sin_cos();
            DVec3::new(radius * cos, radius * sin, z)
        })
        .collect()
}

/// Distance from a box with half sides `half`, negative inside.
fn box_height(p: DVec3, half: DVec3) -> f64 {
    let d = p.abs() - half;
    d.max(DVec3::ZERO).length() + d.max_element().min(0.0)
}

const HALF: DVec3 = DVec3::new(20.0, 14.0, 10.0);

fn cuboid() -> Body {
    let mut edges = Vec::new();
    for [s, t] in [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]] {
        let [x, y, z] = HALF.to_array();
        edges.push(segment([-x, s * y, t * z], [x, s * y, t * z]));
        edges.push(segment([s * x, -y, t * z], [s * x, y, t * z]));
        edges.push(segment([s * x, t * y, -z], [s * x, t * y, z]));
    }
    Body { height: |p| box_height(p, HALF), edges }
}

fn rounded_cuboid() -> Body {
    Body { height: |p| box_height(p, HALF - DVec3::splat(4.5)) - 4.5, edges: Vec::new() }
}

fn can() -> Body {
    let height = |p: DVec3| {
        let d = DVec3::new(p.truncate().length() - 14.0, p.z.abs() - 12.0, 0.0);
        d.max(DVec3::ZERO).length() + d.x.max(d.y).min(0.0)
    };
    Body { height, edges: vec![circle(14.0, 12.0), circle(14.0, -12.0)] }
}

fn bracket() -> Body {
    let height = |p: DVec3| {
        let foot = box_height(p - DVec3::new(0.0, 0.0, -10.0), DVec3::new(20.0, 12.0, 6.0));
        foot.min(box_height(p - DVec3::new(-13.0, 0.0, 4.0), DVec3::new(7.0, 12.0, 20.0)))
    };
    let outline = [[-20.0, -16.0], [20.0, -16.0], [20.0, -4.0], [-6.0, -4.0], [-6.0, 24.0], [-20.0, 24.0]];
    let mut edges = Vec::new();
    for k in 0..6 {
        let ([x, z], [u, w]) = (outline[k], outline[(k + 1) % 6]);
        edges.extend([-12.0, 12.0].map(|y| segment([x, y, z], [u, y, w])));
        edges.push(segment([x, -12.0, z], [x, 12.0, z]));
    }
    Body { height, edges }
}

fn sphere() -> Body {
    Body { height: |p| p.length() - 16.0, edges: Vec::new() }
}

/// Readings of a body with unit normals.
fn readings(body: &Body, count: usize, spread: Spread, seed: u64) -> (Vec<DVec3>, Vec<DVec3>) {
    let bounds = BoundingBox { min: DVec3::splat(-26.0), max: DVec3::splat(26.0) };
    let mesh = isosurface(&bounds, 1.0, body.height, |p, reach| (body.height)(p).abs() <= reach).unwrap();
    let spacing = (mesh.area() / count as f64).sqrt();
    let gradient = |p: DVec3| {
        let step = 1e-5;
        let along = |axis: DVec3| (body.height)(p + step * axis) - (body.height)(p - step * axis);
        DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z)).normalize_or_zero()
    };
    let mut until = 0.0;
    let areas: Vec<f64> = (0..mesh.triangles.len())
        .map(|k| {
            let [a, b, c] = mesh.corners(k);
            until += (b - a).cross(c - a).length();
            until
        })
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    while points.len() < count {
        let at = rng.random_range(0.0..until);
        let [a, b, c] = mesh.corners(areas.partition_point(|area| *area < at).min(areas.len() - 1));
        let (s, t): (f64, f64) = (rng.random(), rng.random());
        let (s, t) = if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) };
        let mut p = a + s * (b - a) + t * (c - a);
        match spread {
            Spread::Uniform => {}
            // Oblique, so that planes do not lie within faces.
            Spread::Lines => {
                let across = DVec3::new(0.36, 0.48, 0.8);
                let place = p.dot(across) / (2.0 * spacing);
                p += 2.0 * spacing * (place.round() - place) * across;
            }
            Spread::Uneven if p.x < 0.0 && rng.random::<f64>() > 0.25 => continue,
            Spread::Uneven => {}
        }
        for _ in 0..20 {
            p -= (body.height)(p) * gradient(p);
        }
        if (body.height)(p).abs() > 1e-6 {
            continue;
        }
        let normal = gradient(p);
        points.push(p + SIGMA * DVec3::from_array([0; 3].map(|_| rng.sample::<f64, _>(StandardNormal))));
        normals.push(normal);
    }
    (points, normals)
}

fn creased(body: &Body, count: usize, spread: Spread, seed: u64) -> (TriangleMesh, CreasedMesh, f64) {
    let (points, normals) = readings(body, count, spread, seed);
    let mesh = enclosing_mesh(&points, &normals, Handles::AsSeen).unwrap().mesh;
    let spacing = (mesh.area() / count as f64).sqrt();
    let made = with_creases(mesh.clone(), &points, &normals, SIGMA).unwrap().mesh;
    (mesh, made, spacing)
}

/// The shares of edges near creases and of creases near edges, within two spacings, and the root mean square
/// distance of vertices of creases from edges.
fn comparison(body: &Body, made: &CreasedMesh, spacing: f64) -> [f64; 3] {
    let at = |v: u32| made.mesh.positions[v as usize];
    let found: Vec<DVec3> = (made.creases.iter())
        .flat_map(|&[a, b]| (0..8).map(move |k| at(a).lerp(at(b), (f64::from(k) + 0.5) / 8.0)))
        .collect();
    let edges: Vec<DVec3> = body.edges.iter().flatten().copied().collect();
    let nearest = |p: DVec3, all: &[DVec3]| all.iter().map(|q| q.distance(p)).fold(f64::INFINITY, f64::min);
    let share = |these: &[DVec3], others: &[DVec3]| {
        let near = these.iter().filter(|p| nearest(**p, others) < 2.0 * spacing).count();
        near as f64 / these.len().max(1) as f64
    };
    let squares: f64 = made.creases.iter().flatten().map(|&v| nearest(at(v), &edges).powi(2)).sum();
    let rms = (squares / (2 * made.creases.len()).max(1) as f64).sqrt();
    [share(&edges, &found), share(&found, &edges), rms]
}

/// Creases are edges of a closed mesh of the same topology that is not turned over beside them.
fn assert_sound(given: &TriangleMesh, made: &CreasedMesh, body: &Body) {
    let (before, after) = (given.check(), made.mesh.check());
    assert!(after.watertight && after.manifold && after.oriented, "{after:?}");
    assert_eq!(after.euler_characteristic, before.euler_characteristic);
    let is_edge = |pair: &[u32; 2]| made.mesh.triangles.iter().any(|t| pair.iter().all(|v| t.contains(v)));
    assert!(made.creases.iter().all(is_edge));
    let mut turned = 0;
    for k in 0..made.mesh.triangles.len() {
        let [a, b, c] = made.mesh.corners(k);
        let (middle, normal) = ((a + b + c) / 3.0, (b - a).cross(c - a).normalize_or_zero());
        let inside = (body.height)(middle - 0.3 * normal);
        turned += usize::from((body.height)(middle + 0.3 * normal) < inside);
    }
    assert!(turned * 500 < made.mesh.triangles.len(), "{turned} triangles are turned over");
}

#[test]
fn edges_of_a_cuboid_are_creases_that_meet_at_its_corners() {
    let body = cuboid();
    for (spread, seed) in [(Spread::Uniform, 1), (Spread::Lines, 2), (Spread::Uneven, 3)] {
        let (given, made, spacing) = creased(&body, 6000, spread, seed);
        assert_sound(&given, &made, &body);
        let [recall, precision, rms] = comparison(&body, &made, spacing);
        assert!(recall > 0.97 && precision > 0.97 && rms < 1.5 * SIGMA, "{recall} {precision} {rms}");
    }
}

/// Where edges are left out, none is left, and the mesh is round. The others stay as they are.
#[test]
fn edges_can_be_left_out_near_a_corner() {
    let body = cuboid();
    let (points, normals) = readings(&body, 6000, Spread::Uniform, 8);
    let mesh = enclosing_mesh(&points, &normals, Handles::AsSeen).unwrap().mesh;
    let all = with_creases(mesh.clone(), &points, &normals, SIGMA).unwrap();
    let left_out = Sphere { center: HALF, radius: 5.0 };
    let rest = all.without(&[left_out]);
    assert_sound(&mesh, &rest.mesh, &body);
    assert!((all.length() - rest.length() - 15.0).abs() < 2.5, "{} {}", all.length(), rest.length());
    let farthest = |edges: &SharpEdges| {
        let own = &edges.mesh;
        let at = |v: &u32| own.mesh.positions[*v as usize];
        own.creases.iter().flatten().map(|v| at(v).distance(HALF)).fold(f64::INFINITY, f64::min)
    };
    assert!(farthest(&all) < 0.3 && farthest(&rest) > 4.0, "{} {}", farthest(&all), farthest(&rest));
    let nearest = |edges: &SharpEdges| {
        edges.mesh.mesh.positions.iter().map(|p| p.distance(HALF)).fold(f64::INFINITY, f64::min)
    };
    assert!(nearest(&rest) > nearest(&all) + 0.3, "{} {}", nearest(&all), nearest(&rest));
    assert!(all.without(&[Sphere { center: DVec3::ZERO, radius: 100.0 }]).is_empty());
}

/// Two bodies of edges: one with a bridge of two spacings between corners, and one without.
#[test]
fn corners_that_are_close_to_each_other_are_found() {
    let positions = [[0.0, 0.0], [5.0, 0.0], [7.0, 0.0], [12.0, 0.0], [5.0, 5.0], [7.0, 5.0]];
    let positions = positions.map(|[x, y]| DVec3::new(x, y, 0.0));
    let graph = graph_of(&[[0, 1], [1, 2], [2, 3], [1, 4], [2, 5]]);
    assert_eq!(close_corners(&graph, &positions, &[], 2.5), [1, 2]);
    assert!(close_corners(&graph, &positions, &[], 1.5).is_empty());
    assert_eq!(close_corners(&graph, &positions, &[], 6.0), [0, 1, 2, 3, 4, 5]);
}

#[test]
fn rims_of_a_can_are_two_circles() {
    let body = can();
    let (given, made, spacing) = creased(&body, 6000, Spread::Uniform, 4);
    assert_sound(&given, &made, &body);
    let [recall, precision, rms] = comparison(&body, &made, spacing);
    assert!(recall > 0.98 && precision > 0.99 && rms < 1.5 * SIGMA, "{recall} {precision} {rms}");
    // Closed curves: every vertex has two creases, and none is a corner.
    let mut counts = vec![0; made.mesh.positions.len()];
    made.creases.iter().flatten().for_each(|&v| counts[v as usize] += 1);
    assert!(counts.iter().all(|count| matches!(count, 0 | 2)));
    assert!(made.corners.is_empty(), "{:?}", made.corners);
}

#[test]
fn concave_edges_of_a_bracket_are_creases() {
    let body = bracket();
    let (given, made, spacing) = creased(&body, 8000, Spread::Uniform, 5);
    assert_sound(&given, &made, &body);
    let [recall, precision, rms] = comparison(&body, &made, spacing);
    assert!(recall > 0.97 && precision > 0.97 && rms < 2.0 * SIGMA, "{recall} {precision} {rms}");
    // The edge between both parts.
    let at = |v: u32| made.mesh.positions[v as usize];
    let is_concave = |p: DVec3| (p.x + 6.0).abs() < 1.0 && (p.z + 4.0).abs() < 1.0 && p.y.abs() < 10.0;
    assert!(made.creases.iter().filter(|[a, b]| is_concave(at(*a)) && is_concave(at(*b))).count() > 10);
}

#[test]
fn smooth_bodies_have_no_creases_and_keep_their_mesh() {
    for body in [sphere(), rounded_cuboid()] {
        for spread in [Spread::Uniform, Spread::Lines, Spread::Uneven] {
            let (given, made, _) = creased(&body, 6000, spread, 6);
            assert!(made.creases.is_empty() && made.corners.is_empty());
            assert_eq!(made.mesh, given);
        }
    }
}

/// Normals that are estimated from neighbours are wrong beside edges. Creases are found, but less exactly.
#[test]
fn estimated_normals_show_the_edges_of_a_can() {
    let body = can();
    let (points, normals) = readings(&body, 6000, Spread::Uniform, 7);
    let mut estimated = planish_sense::cloud_geometry(&points, 12).unwrap().normals;
    for (own, given) in estimated.iter_mut().zip(&normals) {
        *own *= 1.0_f64.copysign(own.dot(*given));
    }
    let mesh = enclosing_mesh(&points, &estimated, Handles::AsSeen).unwrap().mesh;
    let spacing = (mesh.area() / 6000.0).sqrt();
    let made = with_creases(mesh.clone(), &points, &estimated, SIGMA).unwrap().mesh;
    assert_sound(&mesh, &made, &body);
    let [recall, precision, rms] = comparison(&body, &made, spacing);
    assert!(recall > 0.75 && precision > 0.97 && rms < 0.7 * spacing, "{recall} {precision} {rms}");
}
