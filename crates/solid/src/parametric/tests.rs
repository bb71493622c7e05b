use super::*;
use planish_mesh::TriangleMesh;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

const FINE: Fineness = Fineness { chord: 1e-3, longest: f64::INFINITY };

fn elementary(surface: crate::brep::FaceSurface) -> ParametricSurface {
    ParametricSurface::Elementary(surface)
}

fn sphere() -> ParametricSurface {
    elementary(crate::brep::FaceSurface::Sphere {
        center: DVec3::new(1.0, 2.0, 3.0),
        axis: DVec3::Z,
        x: DVec3::X,
        radius: 2.0,
    })
}

fn torus() -> ParametricSurface {
    elementary(crate::brep::FaceSurface::Torus {
        center: DVec3::ZERO,
        axis: DVec3::Z,
        x: DVec3::X,
        major: 3.0,
        minor: 1.0,
    })
}

/// A circle as a closed edge, which begins at parameter 0.
fn circle(shape: &mut ParametricShape, center: DVec3, a: DVec3, b: DVec3) -> usize {
    shape.vertices.push(center + a);
    let v = shape.vertices.len() - 1;
    shape.edges.push(ParametricEdge {
        curve: ParametricCurve::Ellipse { center, a, b },
        ends: [v, v],
        is_forward: true,
    });
    shape.edges.len() - 1
}

fn face(surface: ParametricSurface, is_outward: bool, loops: Vec<Vec<(usize, bool)>>) -> ParametricFace {
    ParametricFace { name: "face".to_owned(), surface, is_outward, loops }
}

/// The only part of a shape, its area and the check of its mesh.
fn meshed(shape: &ParametricShape, fineness: &Fineness) -> (TriangleMesh, f64, planish_mesh::MeshCheck) {
    let made = shape.triangles(fineness).unwrap();
    assert!(made.skipped.is_empty(), "{:?}", made.skipped);
    assert_eq!(made.parts.len(), 1);
    let part = made.parts[0].clone();
    let mesh = TriangleMesh::try_new(part.positions, part.triangles).unwrap();
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        0.5 * (b - a).cross(c - a).length()
    };
    let area = mesh.triangles.iter().map(area).sum();
    let check = mesh.check();
    assert!(check.manifold && check.oriented, "{check:?}");
    (mesh, area, check)
}

fn near(found: f64, truth: f64, share: f64) {
    assert!((found / truth - 1.0).abs() < share, "{found} is not {truth}");
}

#[test]
fn complete_spheres_and_tori_close_and_face_outwards() {
    for (surface, area, volume) in
        [(sphere(), 16.0 * PI, 32.0 / 3.0 * PI), (torus(), 12.0 * PI * PI, 6.0 * PI * PI)]
    {
        for (outward, sign) in [(true, 1.0), (false, -1.0)] {
            let mut shape = ParametricShape::default();
            shape.faces.push(face(surface.clone(), outward, Vec::new()));
            let (mesh, found, check) = meshed(&shape, &FINE);
            assert!(check.watertight);
            near(found, area, 2e-3);
            near(mesh.signed_volume().unwrap(), sign * volume, 2e-3);
        }
    }
}

#[test]
fn cap_contains_the_pole_on_the_left_of_its_loop() {
    // The circle of latitude 30° of a ball of radius 2 about (1, 2, 3), seen from above counter-clockwise.
    let (r, h) = (2.0 * (PI / 6.0).cos(), 1.0);
    for (is_outward, forward, is_upper) in
        [(true, true, true), (true, false, false), (false, true, false), (false, false, true)]
    {
        let mut shape = ParametricShape::default();
        let edge = circle(
            &mut shape,
            DVec3::new(1.0, 2.0, 3.0 + h),
            DVec3::new(r, 0.0, 0.0),
            DVec3::new(0.0, r, 0.0),
        );
        shape.faces.push(face(sphere(), is_outward, vec![vec![(edge, forward)]]));
        let (mesh, area, check) = meshed(&shape, &FINE);
        assert_eq!(check.boundary_loops, 1);
        near(area, if is_upper { 4.0 * PI } else { 12.0 * PI }, 3e-3);
        let top = mesh.positions.iter().map(|p| p[2]).fold(f64::MIN, f64::max);
        assert!((top > 4.9) == is_upper, "{top}");
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            let out = (b - a).cross(c - a).dot(a - DVec3::new(1.0, 2.0, 3.0));
            assert!((out > 0.0) == is_outward || out.abs() < 1e-12);
        }
    }
}

#[test]
fn ball_without_a_cap_beside_the_poles_is_the_complement() {
    // A cap of half an angle of 0.5 about the direction (1, 0, 0).
    let (cos, sin) = (0.5_f64.cos(), 0.5_f64.sin());
    for (forward, share) in [(false, 0.5 * (1.0 + cos)), (true, 0.5 * (1.0 - cos))] {
        let mut shape = ParametricShape::default();
        let center = DVec3::new(1.0 + 2.0 * cos, 2.0, 3.0);
        let edge =
            circle(&mut shape, center, DVec3::new(0.0, 2.0 * sin, 0.0), DVec3::new(0.0, 0.0, 2.0 * sin));
        shape.faces.push(face(sphere(), true, vec![vec![(edge, forward)]]));
        let (_, area, check) = meshed(&shape, &FINE);
        near(area, 16.0 * PI * share, 3e-3);
        assert_eq!((check.boundary_loops, check.euler_characteristic), (1, 1));
    }
}

#[test]
fn loops_select_the_band_of_a_torus_and_a_hole_leaves_the_rest() {
    // The outer and the inner half, between the circles of height ±1.
    for (up, area) in [(true, PI * (3.0 * PI + 2.0)), (false, PI * (3.0 * PI - 2.0))] {
        let mut shape = ParametricShape::default();
        let loops = [-1.0, 1.0]
            .map(|z| {
                (circle(&mut shape, DVec3::new(0.0, 0.0, z), 3.0 * DVec3::X, 3.0 * DVec3::Y), (z < 0.0) == up)
            })
            .map(|coedge| vec![coedge]);
        shape.faces.push(face(torus(), true, loops.to_vec()));
        let (_, found, _) = meshed(&shape, &FINE);
        near(found, 2.0 * area, 3e-3);
    }
    // A loop around the tube twice: half of the ring.
    for (forward, third) in [(true, 1.0 / 3.0), (false, 2.0 / 3.0)] {
        let mut shape = ParametricShape::default();
        let mut ring = |angle: f64| {
            let out = DVec3::new(angle.cos(), angle.sin(), 0.0);
            circle(&mut shape, 3.0 * out, out, DVec3::Z)
        };
        let edges = [ring(0.0), ring(TAU / 3.0)];
        // v grows to the left of −u: the first circle has larger angles to its right where it runs on.
        let loops = vec![vec![(edges[0], !forward)], vec![(edges[1], forward)]];
        shape.faces.push(face(torus(), true, loops));
        let (_, found, _) = meshed(&shape, &FINE);
        near(found, 12.0 * PI * PI * third, 3e-3);
    }
}

#[test]
fn the_direction_of_two_loops_around_a_cylinder_does_not_matter() {
    let cylinder = elementary(crate::brep::FaceSurface::Cylinder {
        origin: DVec3::ZERO,
        axis: DVec3::Z,
        x: DVec3::X,
        radius: 2.0,
    });
    for ways in [[true, false], [false, true], [true, true], [false, false]] {
        let mut shape = ParametricShape::default();
        let at = |shape: &mut ParametricShape, z: f64| {
            circle(shape, DVec3::new(0.0, 0.0, z), 2.0 * DVec3::X, 2.0 * DVec3::Y)
        };
        let loops = [at(&mut shape, 0.0), at(&mut shape, 5.0)];
        let loops = vec![vec![(loops[0], ways[0])], vec![(loops[1], ways[1])]];
        shape.faces.push(face(cylinder.clone(), true, loops));
        let (mesh, area, check) = meshed(&shape, &FINE);
        near(area, 20.0 * PI, 1e-3);
        assert_eq!(check.boundary_loops, 2);
        let [a, b, c] = mesh.triangles[0].map(|v| mesh.positions[v as usize]);
        assert!((b - a).cross(c - a).dot(DVec3::new(a[0], a[1], 0.0)) > 0.0);
    }
    // One loop alone bounds no face of a cylinder.
    let mut shape = ParametricShape::default();
    let edge = circle(&mut shape, DVec3::ZERO, 2.0 * DVec3::X, 2.0 * DVec3::Y);
    shape.faces.push(face(cylinder, true, vec![vec![(edge, true)]]));
    let made = shape.triangles(&FINE).unwrap();
    assert!(made.skipped[0].reason.contains("one loop runs around the surface"), "{:?}", made.skipped);
}

#[test]
fn faces_of_a_cone_at_and_beyond_its_apex_are_filled() {
    let cone = elementary(crate::brep::FaceSurface::Cone {
        origin: DVec3::ZERO,
        axis: DVec3::Z,
        x: DVec3::X,
        radius: 1.0,
        half_angle_rad: PI / 4.0,
    });
    let mut shape = ParametricShape::default();
    let edge = circle(&mut shape, DVec3::Z, 2.0 * DVec3::X, 2.0 * DVec3::Y);
    shape.faces.push(face(cone.clone(), true, vec![vec![(edge, false)]]));
    let (mesh, area, _) = meshed(&shape, &FINE);
    near(area, 4.0 * PI * 2_f64.sqrt(), 1e-3);
    assert!(mesh.positions.iter().any(|p| (*p - DVec3::new(0.0, 0.0, -1.0)).length() < 1e-12));
    // Beyond the apex, radii are negative and angles differ by half a turn.
    let mut shape = ParametricShape::default();
    let loops = [-2.0, -4.0].map(|z: f64| {
        let r = -1.0 - z;
        vec![(
            circle(&mut shape, DVec3::new(0.0, 0.0, z), DVec3::new(r, 0.0, 0.0), DVec3::new(0.0, r, 0.0)),
            true,
        )]
    });
    shape.faces.push(face(cone, true, loops.to_vec()));
    let (_, area, _) = meshed(&shape, &FINE);
    near(area, 8.0 * PI * 2_f64.sqrt(), 1e-3);
}

/// Half a circle of radius 2 from pole to pole as a rational spline, turned about the axis between them: a
/// ball.
fn turned_spline() -> (ParametricSurface, SplineCurve) {
    let h = 0.5_f64.sqrt();
    let poles = [
        DVec3::new(0.0, 0.0, -2.0),
        DVec3::new(2.0, 0.0, -2.0),
        2.0 * DVec3::X,
        DVec3::new(2.0, 0.0, 2.0),
        2.0 * DVec3::Z,
    ];
    let knots = vec![0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 2.0];
    let half = SplineCurve::try_new(2, knots, &poles, Some(&[1.0, h, 1.0, h, 1.0])).unwrap();
    let surface = ParametricSurface::Revolution {
        curve: ParametricCurve::Spline(half.clone()),
        origin: DVec3::ZERO,
        axis: DVec3::Z,
    };
    (surface, half)
}

#[test]
fn revolution_between_poles_is_a_ball_and_its_offset_a_larger_one() {
    let (ball, _) = turned_spline();
    assert_eq!(ball.poles().len(), 2);
    let offset = ParametricSurface::Offset { base: Box::new(ball.clone()), distance: 0.5 };
    for (surface, r) in [(ball, 2.0), (offset, 2.5)] {
        let mut shape = ParametricShape::default();
        shape.faces.push(face(surface, true, Vec::new()));
        let (mesh, area, check) = meshed(&shape, &FINE);
        assert!(check.watertight);
        near(area, 4.0 * PI * r * r, 2e-3);
        near(mesh.signed_volume().unwrap(), 4.0 / 3.0 * PI * r * r * r, 3e-3);
    }
}

#[test]
fn foot_points_of_surface_points_are_their_parameters() {
    let (ball, profile) = turned_spline();
    let wave: Vec<DVec3> = (0..36)
        .map(|k| {
            let (i, j) = (f64::from(k / 6), f64::from(k % 6));
            DVec3::new(i, j, (1.3 * i).sin() * (0.9 * j).cos())
        })
        .collect();
    let knots = vec![0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 3.0, 3.0, 3.0];
    let sheet = SplineSurface::try_new([3, 3], [knots.clone(), knots], &wave, None).unwrap();
    let surfaces = [
        ParametricSurface::Spline(Box::new(sheet)),
        ball,
        ParametricSurface::Extrusion {
            curve: ParametricCurve::Spline(profile),
            along: DVec3::new(0.3, 1.0, 0.1),
        },
        ParametricSurface::Revolution {
            curve: ParametricCurve::Line { origin: 2.0 * DVec3::X, along: DVec3::new(0.5, 1.0, 2.0) },
            origin: DVec3::ZERO,
            axis: DVec3::Z,
        },
        sphere(),
        torus(),
    ];
    for surface in surfaces {
        let mut feet = surface::Feet::new(&surface);
        for k in 0..200 {
            let (a, b) = (f64::from(k % 14) / 14.0, f64::from(k % 11) / 11.0);
            let at = [0.1 + 2.7 * a, 0.1 + 1.2 * b];
            let (p, [u, v]) = surface.at(at);
            let n = u.cross(v);
            let off = p + 0.02 / n.length() * n;
            let guess = (k % 2 == 0).then(|| [at[0] + 0.05, at[1] - 0.04]);
            let found = feet.foot(off, guess, 1e-3);
            let miss = (surface.point(found) - p).length();
            assert!(miss < 1e-6, "{} at {at:?}: {found:?} is {miss} off", surface.kind());
        }
    }
}

#[test]
fn welded_faces_share_edges() {
    // Two squares side by side, each with vertices and edges of its own, one of them off by a millionth.
    let mut shape = ParametricShape::default();
    for (k, x) in [0.0, 1.0 + 1e-6].into_iter().enumerate() {
        let corners = [
            DVec3::new(x, 0.0, 0.0),
            DVec3::new(x + 1.0, 0.0, 0.0),
            DVec3::new(x + 1.0, 1.0, 0.0),
            DVec3::new(x, 1.0, 0.0),
        ];
        shape.vertices.extend(corners);
        let mut ring = Vec::new();
        for side in 0..4 {
            let ends = [4 * k + side, 4 * k + (side + 1) % 4];
            let [from, to] = ends.map(|v| shape.vertices[v]);
            shape.edges.push(ParametricEdge {
                curve: ParametricCurve::Line { origin: from, along: to - from },
                ends,
                is_forward: true,
            });
            ring.push((shape.edges.len() - 1, true));
        }
        let plane = elementary(crate::brep::FaceSurface::Plane {
            origin: DVec3::ZERO,
            normal: DVec3::Z,
            x: DVec3::X,
        });
        shape.faces.push(face(plane, true, vec![ring]));
    }
    assert_eq!(shape.triangles(&FINE).unwrap().parts.len(), 2);
    shape.weld(1e-5);
    let even = Fineness { longest: 0.11, ..FINE };
    let (mesh, area, check) = meshed(&shape, &even);
    near(area, 2.0, 1e-5);
    assert_eq!((check.boundary_loops, check.components), (1, 1));
    assert!(mesh.triangles.len() > 300);
    let longest = mesh.triangles.iter().flat_map(|t| {
        let p = t.map(|v| mesh.positions[v as usize]);
        [(p[0] - p[1]).length(), (p[1] - p[2]).length(), (p[2] - p[0]).length()]
    });
    assert!(longest.fold(0.0, f64::max) < 2.0 * 0.11);
}

#[test]
fn invalid_indices_are_errors_and_invalid_faces_are_skipped() {
    let mut shape = ParametricShape::default();
    assert!(shape.triangles(&Fineness { chord: 0.0, ..FINE }).is_err());
    shape.faces.push(face(sphere(), true, vec![vec![(3, true)]]));
    assert_eq!(shape.triangles(&FINE).unwrap_err().to_string(), "there is no edge 3");
    // A loop far from its surface.
    let mut shape = ParametricShape::default();
    let edge = circle(&mut shape, DVec3::splat(9.0), DVec3::X, DVec3::Y);
    shape.faces.push(face(sphere(), true, vec![vec![(edge, true)]]));
    let made = shape.triangles(&FINE).unwrap();
    assert!(made.parts.is_empty() && made.skipped[0].reason.contains("off its surface"));
    // A whole plane.
    let plane =
        elementary(crate::brep::FaceSurface::Plane { origin: DVec3::ZERO, normal: DVec3::Z, x: DVec3::X });
    let mut shape = ParametricShape::default();
    shape.faces.push(face(plane, true, Vec::new()));
    let reason = "the face has no loops and its surface is unbounded";
    assert_eq!(shape.triangles(&FINE).unwrap().skipped[0].reason, reason);
    assert!(sphere().poles().iter().all(|p| p.value.abs() == FRAC_PI_2));
}

/// A polygon in the plane z = 0 as a shape of one face.
fn polygon(corners: &[[f64; 2]]) -> ParametricShape {
    let vertices: Vec<DVec3> = corners.iter().map(|[x, y]| DVec3::new(*x, *y, 0.0)).collect();
    let n = vertices.len();
    let edge = |k: usize| ParametricEdge {
        curve: ParametricCurve::Line { origin: vertices[k], along: vertices[(k + 1) % n] - vertices[k] },
        ends: [k, (k + 1) % n],
        is_forward: true,
    };
    let edges = (0..n).map(edge).collect();
    let plane = crate::brep::FaceSurface::Plane { origin: DVec3::ZERO, normal: DVec3::Z, x: DVec3::X };
    let faces = vec![face(elementary(plane), true, vec![(0..n).map(|k| (k, true)).collect()])];
    ParametricShape { vertices, edges, faces }
}

#[test]
fn a_star_of_many_corners_is_filled() {
    let count = 4000;
    let corner = |k: usize| {
        let (sin, cos) = (TAU * k as f64 / count as f64).sin_cos();
        let radius = 1.0 + (k % 2) as f64;
        [radius * cos, radius * sin]
    };
    let shape = polygon(&(0..count).map(corner).collect::<Vec<_>>());
    let (_, area, _) = meshed(&shape, &Fineness { chord: 1e-3, longest: 0.5 });
    near(area, (TAU / count as f64).sin() * count as f64, 1e-9);
}

/// A control point that is a thousand times too far away needs millions of points.
#[test]
fn a_face_with_a_far_control_point_is_skipped_with_its_reason() {
    let knots = vec![0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0];
    let mut poles: Vec<DVec3> =
        (0..16).map(|k| DVec3::new(f64::from(k / 4), f64::from(k % 4), 0.0)).collect();
    poles[5].z = 60_000.0;
    let surface = SplineSurface::try_new([3, 3], [knots.clone(), knots], &poles, None).unwrap();
    let faces = vec![face(ParametricSurface::Spline(Box::new(surface)), true, Vec::new())];
    let shape = ParametricShape { faces, ..ParametricShape::default() };
    let made = shape.triangles(&Fineness { chord: 1e-3, longest: 0.1 }).unwrap();
    assert!(made.skipped[0].reason.contains("a coordinate may be damaged"), "{:?}", made.skipped);
}

#[test]
fn copies_of_a_face_count_once_and_triangles_end_with_the_budget() {
    let mut shape = polygon(&[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]);
    let copy = shape.faces[0].clone();
    let mut turned = copy.clone();
    turned.loops[0].rotate_left(2);
    let mut other_side = copy.clone();
    other_side.is_outward = false;
    shape.faces.extend([turned, other_side, copy]);
    let every = shape.clone();
    shape.weld(1e-6);
    assert_eq!(shape.faces.len(), 2);
    // All faces together take the memory, and the one at which it ends is named.
    let fineness = Fineness { chord: 1e-3, longest: 0.5 };
    let points = shape.triangles(&fineness).unwrap().parts.iter().map(|p| p.positions.len()).sum::<usize>();
    let budget = planish_core::Budget::with_max(150 * points as u64, 100);
    let error = every.triangles_within(&fineness, &budget).unwrap_err().to_string();
    assert!(error.starts_with("face face: expected an input of 100 bytes"), "{error}");
}

#[test]
fn vertices_that_repeat_the_next_one_are_removed_in_one_pass() {
    let ring = |vertices: &[u32]| {
        let mut ring = lifted::Ring { vertices: vertices.to_vec(), along: (0..vertices.len()).collect() };
        ring.remove_repeated();
        (ring.vertices, ring.along)
    };
    assert_eq!(ring(&[1, 1, 2, 3, 3, 3, 1]), (vec![1, 2, 3], vec![1, 2, 5]));
    assert_eq!(ring(&[4, 4, 4]), (vec![4], vec![2]));
    assert_eq!(ring(&[]), (vec![], vec![]));
    assert_eq!(ring(&[1, 2, 3]), (vec![1, 2, 3], vec![0, 1, 2]));
}
