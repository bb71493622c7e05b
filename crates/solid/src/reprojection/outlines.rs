//! The lines of a solid that a view can show: edges, and outlines where the line of sight touches curved
//! faces.

use super::scene::Eye;
use crate::brep::TrimmedFace;
use crate::brep::{Coedge, EdgeCurve, FaceSurface, Solid, unit};
use planish_core::{BoundingBox, DVec3};
use std::f64::consts::{PI, TAU};

/// Faces continue each other smoothly if the cosine between their normals differs from ±1 by less than this
/// (0.08°).
///
/// A larger value loses edges of nearly flat angles; a smaller one shows tangent edges of inaccurate
/// surfaces.
const SMOOTH: f64 = 1e-6;
/// A face is seen edge-on if the cosine between its normal and the line of sight is below this.
const EDGE_ON: f64 = 1e-5;
/// Distance from an edge or an outline at which the faces beside it are tested, relative to the size.
///
/// It must exceed the errors of edges, and be small against the faces.
const SIDE_OFFSET: f64 = 1e-4;
/// Maximum chord error of polygons along curves, relative to the size.
///
/// It is a hundredth of the default tolerance
/// [`ReprojectionOptions::near`](super::ReprojectionOptions::near).
const CHORD: f64 = 5e-6;
/// Numbers of cells along both parameters of a curved face in which outlines are searched.
///
/// An outline within one cell is missed; more cells take more time.
const CELLS: [usize; 2] = [48, 24];
/// Number of parts of a circle along which the line of sight touches a face.
const CIRCLE_PARTS: usize = 720;
/// Number of times that a part of an outline is halved.
const HALVINGS: usize = 4;

/// A line of the solid in a view.
pub(super) struct Outline {
    /// Points along the line, in space.
    pub(super) points: Vec<DVec3>,
    /// True if a drawing must show the line; optional lines may be drawn.
    pub(super) is_required: bool,
    /// Number shared by the lines of one edge, or of the outline of one face.
    pub(super) group: usize,
}

/// Edges and their faces, the same for all views.
pub(super) struct Edges {
    /// The faces and coedges that use each edge.
    uses: Vec<Vec<(usize, Coedge)>>,
    /// Points along each edge.
    chains: Vec<Vec<DVec3>>,
    /// For each edge, true if another one coincides with it. Drawing conventions differ for these.
    is_double: Vec<bool>,
}

impl Edges {
    pub(super) fn new(solid: &Solid, size: f64) -> Self {
        let mut uses = vec![Vec::new(); solid.edges.len()];
        for (index, face) in solid.faces.iter().enumerate() {
            for coedge in face.loops.iter().flatten() {
                uses[coedge.edge].push((index, *coedge));
            }
        }
        let chains: Vec<Vec<DVec3>> = solid.edges.iter().map(|e| chain(e, size)).collect();
        let near = SIDE_OFFSET * size;
        let middle = |k: usize| {
            let edge = &solid.edges[k];
            edge.curve.point((edge.range[0] + edge.range[1]) / 2.0)
        };
        // Coincident edges may be divided differently, so each middle is compared with the whole other edge,
        // and in both directions: a short edge may lie on a long one.
        let middles: Vec<DVec3> = (0..solid.edges.len()).map(middle).collect();
        let touches = |k: usize, p: DVec3| chains[k].windows(2).any(|q| far_from(p, q[0], q[1]) < near);
        let boxes: Vec<Option<BoundingBox>> = chains.iter().map(|c| BoundingBox::from_points(c)).collect();
        let in_box = |b: &Option<BoundingBox>, p: DVec3| {
            b.is_some_and(|b| (0..3).all(|c| p[c] > b.min[c] - near && p[c] < b.max[c] + near))
        };
        let is_double = (0..chains.len())
            .map(|k| {
                (0..chains.len()).any(|other| {
                    let between =
                        |a: usize, b: usize| in_box(&boxes[a], middles[b]) && touches(a, middles[b]);
                    other != k && (between(other, k) || between(k, other))
                })
            })
            .collect();
        Self { uses, chains, is_double }
    }

    /// Whether faces meet at an angle at an edge.
    pub(super) fn is_sharp(&self, solid: &Solid, faces: &[TrimmedFace<'_>], index: usize) -> bool {
        let [(f, _), (g, _)] = self.uses[index][..] else { return false };
        let edge = &solid.edges[index];
        let p = edge.curve.point((edge.range[0] + edge.range[1]) / 2.0);
        faces[f].outward(p).dot(faces[g].outward(p)) < 1.0 - SMOOTH
    }
}

/// The distance of a point to the segment between two points.
fn far_from(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    let d = b - a;
    let share = ((p - a).dot(d) / d.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    (p - (a + share * d)).length()
}

/// Points along an edge, with a chord error of at most [`CHORD`].
fn chain(edge: &crate::brep::Edge, size: f64) -> Vec<DVec3> {
    let [from, to] = edge.range;
    let pieces = edge.pieces();
    let mut points = vec![edge.curve.point(from)];
    for k in 0..pieces {
        let at = |share: f64| from + (to - from) * (k as f64 + share) / pieces as f64;
        let [a, m, b] = [0.0, 0.5, 1.0].map(|s| edge.curve.point(at(s)));
        // The chord error falls with the square of the length.
        let miss = far_from(m, a, b) / (CHORD * size);
        let parts = miss.sqrt().ceil().clamp(1.0, 64.0) as usize;
        points.extend((1..=parts).map(|j| edge.curve.point(at(j as f64 / parts as f64))));
    }
    points
}

/// All lines of a solid in a view.
pub(super) fn outlines(
    solid: &Solid,
    faces: &[TrimmedFace<'_>],
    edges: &Edges,
    eye: Eye,
    size: f64,
) -> Vec<Outline> {
    let mut found = Vec::new();
    for index in 0..solid.edges.len() {
        if let Some(is_required) = of_edge(solid, faces, edges, index, eye, size) {
            found.push(Outline {
                points: edges.chains[index].clone(),
                is_required: is_required && !edges.is_double[index],
                group: index,
            });
        }
    }
    for (index, face) in faces.iter().enumerate() {
        if matches!(face.surface(), FaceSurface::Plane { .. }) {
            continue;
        }
        found.extend(touching(face, eye, size).into_iter().map(|points| Outline {
            points,
            is_required: true,
            group: solid.edges.len() + index,
        }));
    }
    found
}

/// Whether an edge must be drawn; `None` if it is never drawn.
///
/// A sharp edge must be drawn. A smooth one must be drawn if one face is turned to the viewer and the other
/// one away, where it is an outline. Other smooth edges may be drawn if two surfaces meet there.
fn of_edge(
    solid: &Solid,
    faces: &[TrimmedFace<'_>],
    edges: &Edges,
    index: usize,
    eye: Eye,
    size: f64,
) -> Option<bool> {
    let [(f, first), (g, second)] = edges.uses[index][..] else {
        return Some(false);
    };
    if solid.faces[f].is_untrimmed() {
        return None;
    }
    let edge = &solid.edges[index];
    let (mut any, mut all) = (false, true);
    // An edge may be an outline along a part only, so it is required only if all samples require it.
    for share in [0.21, 0.48, 0.83] {
        let t = edge.range[0] + (edge.range[1] - edge.range[0]) * share;
        let p = edge.curve.point(t);
        let normals = [faces[f].outward(p), faces[g].outward(p)];
        let cosine = normals[0].dot(normals[1]);
        if cosine > 1.0 - SMOOTH {
            let tangent = unit(edge.curve.derivative(t));
            let facing = |face: &TrimmedFace<'_>, coedge: Coedge, normal: DVec3| {
                let run = if coedge.forward { tangent } else { tangent.map(|c| -c) };
                // The normals at the edge itself agree, so they are compared beside it. A face is on the left
                // of its loop.
                let shifted = p + SIDE_OFFSET * size * unit(normal.cross(run));
                let towards = face.outward(shifted).dot(eye.towards());
                if towards.abs() < EDGE_ON { 0.0 } else { towards.signum() }
            };
            let turns = facing(&faces[f], first, normals[0]) != facing(&faces[g], second, normals[1]);
            any |= turns;
            all &= turns;
        } else {
            // Opposite normals are a cusp, where the boundary touches itself; conventions differ.
            any = true;
            all &= cosine > SMOOTH - 1.0;
        }
    }
    // A smooth edge between two planes exists only where something touches the plane from behind.
    let are_planes = [f, g].iter().all(|k| matches!(faces[*k].surface(), FaceSurface::Plane { .. }));
    (any || are_planes || is_tangent(solid, f, g)).then_some(any && all)
}

/// True if a smooth edge lies between two different surfaces, which some drawings show. It is false for seams
/// and for cuts within one surface.
fn is_tangent(solid: &Solid, f: usize, g: usize) -> bool {
    let radius = |k: usize| match solid.faces[k].surface {
        FaceSurface::Cylinder { radius, .. } | FaceSurface::Sphere { radius, .. } => radius,
        FaceSurface::Torus { minor, .. } => minor,
        FaceSurface::Cone { half_angle_rad, .. } => half_angle_rad,
        FaceSurface::Plane { .. } => 0.0,
    };
    let [a, b] = [&solid.faces[f], &solid.faces[g]];
    let is_same = std::mem::discriminant(&a.surface) == std::mem::discriminant(&b.surface)
        && a.outward == b.outward
        && (radius(f) - radius(g)).abs() <= SMOOTH * radius(f);
    f != g && !is_same
}

/// Outlines of a curved face: `n · e = 0`, with the face on both sides.
///
/// Outlines of spheres, and of tori along or across their axis, are circles; exact ones avoid the search.
fn touching(face: &TrimmedFace<'_>, eye: Eye, size: f64) -> Vec<Vec<DVec3>> {
    if let Some(circles) = touching_circles(face.surface(), eye.towards()) {
        return circles
            .iter()
            .flat_map(|circle| parts_of_circle(face, circle, eye.towards(), size))
            .collect();
    }
    touching_by_cells(face, eye, size)
}

/// The circles along which the line of sight touches a sphere, or a torus with its axis along or across it;
/// `None` for any other surface.
fn touching_circles(surface: &FaceSurface, e: DVec3) -> Option<Vec<EdgeCurve>> {
    let circle = |center: DVec3, a: DVec3, b: DVec3, radius: f64| EdgeCurve::Ellipse {
        center,
        a: radius * a,
        b: radius * b,
    };
    match *surface {
        FaceSurface::Sphere { center, axis, x, radius } => {
            let a = if axis.dot(e).abs() < 0.9 { axis } else { x };
            let a = unit(a - a.dot(e) * e);
            Some(vec![circle(center, a, e.cross(a), radius)])
        }
        FaceSurface::Torus { center, axis, x, major, minor } => {
            let y = axis.cross(x);
            let tilt = axis.dot(e).abs();
            if tilt > 1.0 - 1e-9 {
                let rings = [major - minor, major + minor].into_iter().filter(|r| *r > 0.0);
                Some(rings.map(|r| circle(center, x, y, r)).collect())
            } else if tilt < 1e-9 {
                let w = unit(axis.cross(e));
                let tubes = [-major, major].map(|r| circle(center + r * w, w, axis, minor));
                let rim_circles = [-minor, minor].map(|h| circle(center + h * axis, x, y, major));
                Some(tubes.into_iter().chain(rim_circles).collect())
            } else {
                None
            }
        }
        _ => None,
    }
}

/// The parts of a circle of contact that have the face on both sides.
fn parts_of_circle(face: &TrimmedFace<'_>, circle: &EdgeCurve, e: DVec3, size: f64) -> Vec<Vec<DVec3>> {
    let surface = face.surface();
    let point = |k: usize| circle.point(TAU * k as f64 / CIRCLE_PARTS as f64);
    let is_in = |k: usize| {
        let q = circle.point(TAU * (k as f64 + 0.5) / CIRCLE_PARTS as f64);
        // The line of sight is a tangent of the surface there, and crosses the outline.
        [-1.0, 1.0].into_iter().all(|side| {
            let shifted = surface.parameters(q + side * SIDE_OFFSET * size * e);
            face.contains(surface.point(shifted))
        })
    };
    let inside: Vec<bool> = (0..CIRCLE_PARTS).map(is_in).collect();
    // The loop starts at a gap, so that no part is split where the circle closes.
    let Some(gap) = inside.iter().position(|i| !i) else {
        return vec![(0..=CIRCLE_PARTS).map(point).collect()];
    };
    let mut found: Vec<Vec<DVec3>> = Vec::new();
    let mut runs = false;
    for k in gap..gap + CIRCLE_PARTS {
        let is_in = inside[k % CIRCLE_PARTS];
        match found.last_mut() {
            Some(part) if is_in && runs => part.push(point(k + 1)),
            _ if is_in => found.push(vec![point(k), point(k + 1)]),
            _ => {}
        }
        runs = is_in;
    }
    found
}

/// Outlines of any surface, in the cells of its parameters at whose corners `n · e` has both signs.
fn touching_by_cells(face: &TrimmedFace<'_>, eye: Eye, size: f64) -> Vec<Vec<DVec3>> {
    let surface = face.surface();
    let towards = |uv: [f64; 2]| surface.normal(surface.point(uv)).dot(eye.towards());
    let [from, to] = second_range(face);
    let [columns, rows] = CELLS;
    let at = |i: usize, j: usize| {
        [-PI + TAU * (i as f64 + 0.137) / columns as f64, from + (to - from) * j as f64 / rows as f64]
    };
    let mut values = Vec::with_capacity((columns + 1) * (rows + 1));
    for j in 0..=rows {
        for i in 0..=columns {
            values.push(towards(at(i, j)));
        }
    }
    // A cylinder along the line of sight is edge-on everywhere: its edges are drawn, and it has no outline.
    if values.iter().all(|v| v.abs() < EDGE_ON) {
        return Vec::new();
    }
    let value = |i: usize, j: usize| values[j * (columns + 1) + i];
    let mut found = Vec::new();
    for j in 0..rows {
        for i in 0..columns {
            let corners = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]];
            let mut crossed = Vec::new();
            for k in 0..4 {
                let (a, b) = (corners[k], corners[(k + 1) % 4]);
                if (value(a[0], a[1]) > 0.0) != (value(b[0], b[1]) > 0.0) {
                    crossed.push(zero_between(&towards, at(a[0], a[1]), at(b[0], b[1])));
                }
            }
            // Four crossings (a saddle) give two parts. Their pairing may be wrong, but only within one cell.
            for pair in crossed.chunks_exact(2) {
                found.extend(part_in_face(face, &towards, [pair[0], pair[1]], size));
            }
        }
    }
    found
}

/// The range of the second parameter of a face, including the apex of a cone.
fn second_range(face: &TrimmedFace<'_>) -> [f64; 2] {
    if face.second_is_angle() {
        return [-PI, PI];
    }
    let [mut from, mut to] =
        face.loop_parameters().fold([f64::MAX, f64::MIN], |[lo, hi], uv| [lo.min(uv[1]), hi.max(uv[1])]);
    if let FaceSurface::Cone { radius, half_angle_rad, .. } = face.surface() {
        let tip = -radius / half_angle_rad.tan();
        from = from.min(tip);
        to = to.max(tip);
    }
    [from, to]
}

/// Zero of a function of the parameters between two points of different sign, by bisection.
fn zero_between(value: &dyn Fn([f64; 2]) -> f64, mut a: [f64; 2], mut b: [f64; 2]) -> [f64; 2] {
    let above = value(a) > 0.0;
    for _ in 0..48 {
        let middle = [0, 1].map(|k| (a[k] + b[k]) / 2.0);
        *(if (value(middle) > 0.0) == above { &mut a } else { &mut b }) = middle;
    }
    [0, 1].map(|k| (a[k] + b[k]) / 2.0)
}

/// The part of an outline between two points that lies within the face.
fn part_in_face(
    face: &TrimmedFace<'_>,
    towards: &dyn Fn([f64; 2]) -> f64,
    ends: [[f64; 2]; 2],
    size: f64,
) -> Option<Vec<DVec3>> {
    let surface = face.surface();
    // Points in between, moved across the chord to the zero of the function. Small moves are tried first, so
    // that another branch of the outline is not taken.
    let on = |share: f64| {
        let p = [0, 1].map(|k| ends[0][k] + share * (ends[1][k] - ends[0][k]));
        if towards(p).abs() < 1e-12 {
            return p;
        }
        let across = [ends[0][1] - ends[1][1], ends[1][0] - ends[0][0]];
        let side = |s: f64| [p[0] + s * across[0], p[1] + s * across[1]];
        let reach =
            [0.05, 0.3, 1.0].into_iter().find(|r| (towards(side(*r)) > 0.0) != (towards(side(-*r)) > 0.0));
        reach.map_or(p, |r| zero_between(towards, side(-r), side(r)))
    };
    let is_in = |share: f64| {
        let uv = on(share);
        let q = surface.point(uv);
        // A step across the outline, along the gradient of n · e on the surface. Where the surface is flat in
        // one parameter, steps along parameters would run along the outline.
        [-1.0, 1.0].into_iter().all(|s| {
            let h = 1e-6;
            let du = (surface.point([uv[0] + h, uv[1]]) - q).map(|c| c / h);
            let dv = (surface.point([uv[0], uv[1] + h]) - q).map(|c| c / h);
            let gradient = [
                (towards([uv[0] + h, uv[1]]) - towards([uv[0] - h, uv[1]])) / du.length().max(1e-300),
                (towards([uv[0], uv[1] + h]) - towards([uv[0], uv[1] - h])) / dv.length().max(1e-300),
            ];
            let length = gradient[0].hypot(gradient[1]);
            let step = (SIDE_OFFSET * size).min(0.02 * du.length());
            let shifted = [
                uv[0] + s * step * gradient[0] / length / du.length().max(1e-300),
                uv[1] + s * step * gradient[1] / length / dv.length().max(1e-300),
            ];
            face.contains(surface.point(shifted))
        })
    };
    const PARTS: usize = 4;
    let inside: Vec<bool> = (0..PARTS).map(|k| is_in((k as f64 + 0.5) / PARTS as f64)).collect();
    let first = inside.iter().position(|i| *i)?;
    let last = inside.iter().rposition(|i| *i)?;
    // The end at which the outline leaves the face, by bisection.
    let reach = |mut within: f64, mut beyond: f64| {
        for _ in 0..HALVINGS + 8 {
            let middle = (within + beyond) / 2.0;
            *(if is_in(middle) { &mut within } else { &mut beyond }) = middle;
        }
        within
    };
    let share = |k: f64| (k + 0.5) / PARTS as f64;
    let from = if is_in(0.0) {
        0.0
    } else {
        reach(share(first as f64), if first == 0 { 0.0 } else { share(first as f64 - 1.0) })
    };
    let to = if is_in(1.0) {
        1.0
    } else {
        reach(share(last as f64), if last + 1 == PARTS { 1.0 } else { share(last as f64 + 1.0) })
    };
    let count = 1 << HALVINGS;
    let straight = [0.25, 0.5].iter().all(|s| {
        let p = [0, 1].map(|k| ends[0][k] + s * (ends[1][k] - ends[0][k]));
        towards(p).abs() < 1e-9
    }) && matches!(surface, FaceSurface::Cylinder { .. });
    let pieces = if straight { 1 } else { count };
    Some((0..=pieces).map(|k| surface.point(on(from + (to - from) * k as f64 / pieces as f64))).collect())
}
