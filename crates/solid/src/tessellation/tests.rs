use super::*;
use crate::brep::{Face, FaceSurface};
use crate::views::{Curve2, Drawing, DrawnCurve, LineStyle, View, ViewKind, solve};
use std::f64::consts::TAU;

fn drawn(curve: Curve2, style: LineStyle) -> DrawnCurve {
    DrawnCurve { curve, style, entity: "test".to_owned() }
}

fn rectangle([x, y]: [f64; 2]) -> Vec<DrawnCurve> {
    let corners = [[0.0, 0.0], [x, 0.0], [x, y], [0.0, y]];
    (0..4).map(|k| drawn(Curve2::Segment(corners[k], corners[(k + 1) % 4]), LineStyle::Visible)).collect()
}

fn circle(center: [f64; 2], radius: f64) -> DrawnCurve {
    let curve = Curve2::Arc { center, radius, start: 0.0, sweep: TAU };
    drawn(curve, LineStyle::Visible)
}

fn hidden(a: [f64; 2], b: [f64; 2]) -> DrawnCurve {
    drawn(Curve2::Segment(a, b), LineStyle::Hidden)
}

fn solved(views: [Vec<DrawnCurve>; 3]) -> Solid {
    let views = ViewKind::ALL.into_iter().zip(views);
    let drawing = Drawing { views: views.map(|(kind, curves)| View::new(kind, curves)).collect() };
    let found = solve(&drawing).unwrap();
    assert!(!found.solutions.is_empty(), "{found:?}");
    found.solutions[0].solid.clone()
}

/// A box of 40 × 30 × 20 with a hole of diameter 12 from top to bottom.
fn box_with_hole() -> Solid {
    let with = |mut curves: Vec<DrawnCurve>, at: [f64; 2]| {
        curves.extend(at.map(|u| hidden([u, 0.0], [u, 20.0])));
        curves
    };
    let mut top = rectangle([40.0, 30.0]);
    top.push(circle([20.0, 15.0], 6.0));
    solved([with(rectangle([40.0, 20.0]), [14.0, 26.0]), top, with(rectangle([30.0, 20.0]), [9.0, 21.0])])
}

/// Holes of different diameter along x and along z that cross: their edges are splines.
fn crossing_holes() -> Solid {
    let mut top = rectangle([20.0, 20.0]);
    top.push(circle([10.0, 10.0], 5.0));
    let mut side = rectangle([20.0, 20.0]);
    side.push(circle([10.0, 10.0], 3.0));
    side.extend([5.0, 15.0].map(|y| hidden([y, 0.0], [y, 20.0])));
    let mut front = rectangle([20.0, 20.0]);
    for u in [7.0, 13.0] {
        // The narrow hole ends at the wide one: at x = 10 ± 4 beside, at 10 ± 5 above and below.
        top.extend([[0.0, 6.0], [14.0, 20.0]].map(|x| hidden([x[0], u], [x[1], u])));
        front.extend([[0.0, 5.0], [15.0, 20.0]].map(|x| hidden([x[0], u], [x[1], u])));
    }
    for x in [5.0, 15.0] {
        front.extend([[0.0, 7.0], [13.0, 20.0]].map(|z| hidden([x, z[0]], [x, z[1]])));
    }
    // Seen along y, the holes meet on x = 10 ± √(25 − y²), z = 10 ± √(9 − y²).
    for (sx, sz) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let point = |k: i32| {
            let y = 3.0 * (TAU / 4.0 * f64::from(k) / 60.0).sin();
            [10.0 + sx * (25.0 - y * y).sqrt(), 10.0 + sz * (9.0 - y * y).max(0.0).sqrt()]
        };
        front.push(drawn(Curve2::Chain((0..=60).map(point).collect()), LineStyle::Hidden));
    }
    solved([front, top, side])
}

#[test]
fn box_with_a_hole_is_closed_and_has_its_volume() {
    let solid = box_with_hole();
    let exact = solid.measures();
    let mut last = f64::MAX;
    for tolerance in [0.5, 0.05, 0.005] {
        let mesh = tessellate(&solid, tolerance).unwrap();
        let found = mesh.check();
        assert!(found.watertight && found.oriented && found.manifold);
        assert_eq!(found.euler_characteristic, 0);
        let off = (mesh.signed_volume().unwrap() - exact.volume).abs();
        // A polygon around the hole differs from the circle by less than its chord error, over 240 π of wall.
        assert!(off < tolerance * 240.0 * std::f64::consts::PI && off < last, "{tolerance}: {off}");
        last = off;
        for p in &mesh.positions {
            let nearest = solid.faces.iter().map(|f| f.surface.distance(*p).abs()).fold(f64::MAX, f64::min);
            assert!(nearest < 1e-9);
        }
    }
}

#[test]
fn holes_that_cross_share_the_points_of_their_edges() {
    let solid = crossing_holes();
    let exact = solid.measures();
    let mesh = tessellate(&solid, 0.01).unwrap();
    let found = mesh.check();
    assert!(found.watertight && found.oriented && found.manifold);
    // Four openings: a ball with three handles.
    assert_eq!(found.euler_characteristic, 2 - 2 * 3);
    assert!((mesh.signed_volume().unwrap() - exact.volume).abs() < 0.01 * exact.area);
    // The middle of every triangle is within the tolerance of the faces of the solid.
    for t in 0..mesh.triangles.len() {
        let p = mesh.point_at(t, [1.0 / 3.0; 3]);
        let off = solid.faces.iter().map(|f| f.surface.distance(p).abs()).fold(f64::MAX, f64::min);
        assert!(off <= 0.011, "{off}");
    }
}

#[test]
fn missing_face_is_an_error() {
    let mut solid = box_with_hole();
    solid.faces.pop();
    let e = tessellate(&solid, 0.1).unwrap_err();
    assert!(e.to_string().contains("do not close"), "{e}");
}

#[test]
fn zero_tolerance_is_rejected() {
    for tolerance in [0.0, -1.0, f64::NAN] {
        assert!(tessellate(&box_with_hole(), tolerance).is_err());
    }
}

/// The front and side view, and the top view, of a turned part.
fn turned(across: Vec<DrawnCurve>, top: Vec<DrawnCurve>) -> Solid {
    solved([across.clone(), top, across])
}

fn arc(center: [f64; 2], radius: f64, start: f64, sweep: f64) -> DrawnCurve {
    let curve = Curve2::Arc { center, radius, start, sweep };
    drawn(curve, LineStyle::Visible)
}

fn line(a: [f64; 2], b: [f64; 2]) -> DrawnCurve {
    drawn(Curve2::Segment(a, b), LineStyle::Visible)
}

/// The half y > 0 of a cone of radius 10 and height 30: its straight edges end at the tip.
fn half_a_cone() -> Solid {
    let tip = 30.0 * DVec3::Z;
    let [right, left] = [10.0 * DVec3::X, DVec3::new(-10.0, 0.0, 0.0)];
    let line = |from: DVec3, to: DVec3, ends: [usize; 2]| {
        let span = to - from;
        let length = span.length();
        Edge {
            curve: EdgeCurve::Line { origin: from, direction: span.map(|c| c / length) },
            range: [0.0, length],
            start: ends[0],
            end: ends[1],
        }
    };
    let arc = Edge {
        curve: EdgeCurve::Ellipse { center: DVec3::ZERO, a: right, b: 10.0 * DVec3::Y },
        range: [0.0, std::f64::consts::PI],
        start: 1,
        end: 2,
    };
    let face = |surface: FaceSurface, ring: &[(usize, bool)]| Face {
        surface,
        outward: true,
        loops: vec![ring.iter().map(|&(edge, forward)| Coedge { edge, forward }).collect()],
    };
    let plane = |normal: DVec3| FaceSurface::Plane { origin: DVec3::ZERO, normal, x: DVec3::X };
    let cone = FaceSurface::Cone {
        origin: DVec3::ZERO,
        axis: DVec3::new(0.0, 0.0, -1.0),
        x: DVec3::X,
        radius: 10.0,
        half_angle_rad: (1.0_f64 / 3.0).atan(),
    };
    let solid = Solid {
        vertices: vec![tip, right, left],
        edges: vec![arc, line(left, right, [2, 1]), line(right, tip, [1, 0]), line(left, tip, [2, 0])],
        faces: vec![
            face(plane(DVec3::new(0.0, 0.0, -1.0)), &[(0, false), (1, false)]),
            face(plane(DVec3::new(0.0, -1.0, 0.0)), &[(1, true), (2, true), (3, false)]),
            face(cone, &[(0, true), (3, true), (2, false)]),
        ],
    };
    solid.check(1e-9).unwrap();
    solid
}

/// Faces with a pole of a sphere or an apex of a cone inside or on the boundary, and faces without a
/// boundary: all meshes are closed and have the volume of the solid.
#[test]
fn faces_over_poles_and_apexes_are_closed() {
    use std::f64::consts::{FRAC_PI_2, PI};
    let disc = || vec![circle([0.0, 0.0], 10.0)];
    let dome = || vec![arc([0.0, 0.0], 10.0, 0.0, PI), line([-10.0, 0.0], [10.0, 0.0])];
    let tip = |up: f64| vec![line([-10.0, 0.0], [0.0, up]), line([0.0, up], [10.0, 0.0])];
    let mut cone = tip(30.0);
    cone.push(line([-10.0, 0.0], [10.0, 0.0]));
    let mut bicone = tip(30.0);
    bicone.extend(tip(-5.0));
    bicone.push(line([-10.0, 0.0], [10.0, 0.0]));
    // The edges of a quarter of a ball end at a pole.
    let half_disc = || vec![arc([0.0, 0.0], 10.0, 0.0, PI), line([-10.0, 0.0], [10.0, 0.0])];
    let quarter_side = vec![
        arc([0.0, 0.0], 10.0, 0.0, FRAC_PI_2),
        line([0.0, 0.0], [10.0, 0.0]),
        line([0.0, 0.0], [0.0, 10.0]),
    ];
    let solids = [
        ("dome", turned(dome(), disc()), 2000.0 / 3.0 * PI),
        ("ball", turned(disc(), disc()), 4000.0 / 3.0 * PI),
        ("cone", turned(cone, disc()), 1000.0 * PI),
        ("double cone", turned(bicone, disc()), 3500.0 / 3.0 * PI),
        ("quarter of a ball", solved([dome(), half_disc(), quarter_side]), 1000.0 / 3.0 * PI),
        ("half a cone", half_a_cone(), 500.0 * PI),
    ];
    for (name, solid, volume) in solids {
        let mut last = f64::MAX;
        for tolerance in [0.1, 0.01] {
            let mesh = tessellate(&solid, tolerance).unwrap_or_else(|e| panic!("{name}: {e}"));
            let found = mesh.check();
            assert!(found.watertight && found.oriented && found.manifold, "{name}");
            assert_eq!(found.euler_characteristic, 2, "{name}");
            let off = (mesh.signed_volume().unwrap() - volume).abs();
            assert!(off < tolerance * solid.measures().area && off < last, "{name}: {off}");
            last = off;
        }
    }
}

#[test]
fn too_fine_tolerance_is_rejected_with_the_smallest_possible_one() {
    let mut ball = Solid::default();
    let surface = FaceSurface::Sphere { center: DVec3::ZERO, axis: DVec3::Z, x: DVec3::X, radius: 10.0 };
    ball.add_untrimmed(surface, true);
    let message = tessellate(&ball, 1e-9).unwrap_err().to_string();
    assert!(message.contains("found about") && message.contains("or more"), "{message}");
    let tolerance = min_tolerance(&ball);
    assert!(
        triangles_needed(&ball, tolerance) <= MAX_TRIANGLES
            && triangles_needed(&ball, 0.98 * tolerance) > MAX_TRIANGLES
    );
    // The estimated number of triangles agrees with the actual one within a factor of three.
    let made = tessellate(&ball, 1e-2).unwrap().triangles.len() as f64;
    let needed = triangles_needed(&ball, 1e-2);
    assert!((needed / 3.0..3.0 * needed).contains(&made), "{made} of {needed}");
}
