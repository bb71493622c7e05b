//! Writes solids on analytic surfaces: `PLANE`, `CYLINDRICAL_SURFACE`, `CONICAL_SURFACE`,
//! `SPHERICAL_SURFACE`, `TOROIDAL_SURFACE`, bounded by `LINE`, `CIRCLE`, `ELLIPSE` and cubic splines.

use super::part21::{Id, Part21};
use super::{BsplineCurve, write_curve, write_point};
use crate::step::part21::reals;
use planish_core::DVec3;
use planish_solid::brep::{Edge, EdgeCurve, Face, FaceSurface, Solid};
use std::f64::consts::{PI, TAU};
use std::io::{self, Write};

fn write_direction<W: Write>(out: &mut Part21<W>, direction: DVec3) -> io::Result<Id> {
    out.add(format_args!("DIRECTION('',({}))", reals(direction.as_ref())))
}

fn write_frame<W: Write>(out: &mut Part21<W>, origin: DVec3, z: DVec3, x: DVec3) -> io::Result<Id> {
    let origin = write_point(out, origin)?;
    let z = write_direction(out, z)?;
    let x = write_direction(out, x)?;
    out.add(format_args!("AXIS2_PLACEMENT_3D('',{origin},{z},{x})"))
}

fn write_surface<W: Write>(out: &mut Part21<W>, surface: &FaceSurface) -> io::Result<Id> {
    match surface {
        FaceSurface::Plane { origin, normal, x } => {
            let frame = write_frame(out, *origin, *normal, *x)?;
            out.add(format_args!("PLANE('',{frame})"))
        }
        FaceSurface::Cylinder { origin, axis, x, radius } => {
            let frame = write_frame(out, *origin, *axis, *x)?;
            out.add(format_args!("CYLINDRICAL_SURFACE('',{frame},{})", reals(&[*radius])))
        }
        FaceSurface::Cone { origin, axis, x, radius, half_angle_rad } => {
            let frame = write_frame(out, *origin, *axis, *x)?;
            let sizes = [*radius, *half_angle_rad];
            out.add(format_args!("CONICAL_SURFACE('',{frame},{})", reals(&sizes)))
        }
        FaceSurface::Sphere { center, axis, x, radius } => {
            let frame = write_frame(out, *center, *axis, *x)?;
            out.add(format_args!("SPHERICAL_SURFACE('',{frame},{})", reals(&[*radius])))
        }
        FaceSurface::Torus { center, axis, x, major, minor } => {
            let frame = write_frame(out, *center, *axis, *x)?;
            let sizes = [*major, *minor];
            out.add(format_args!("TOROIDAL_SURFACE('',{frame},{})", reals(&sizes)))
        }
    }
}

fn write_edge_curve<W: Write>(out: &mut Part21<W>, edge: &Edge) -> io::Result<Id> {
    match &edge.curve {
        EdgeCurve::Line { origin, direction } => {
            let origin = write_point(out, *origin)?;
            let direction = write_direction(out, *direction)?;
            // A unit vector, so that parameters along the line are lengths.
            let vector = out.add(format_args!("VECTOR('',{direction},1.)"))?;
            out.add(format_args!("LINE('',{origin},{vector})"))
        }
        EdgeCurve::Ellipse { center, a, b } => {
            let (major, minor) = (a.length(), b.length());
            let x = 1.0 / major * *a;
            let normal = x.cross(1.0 / minor * *b);
            let frame = write_frame(out, *center, normal, x)?;
            // Axes that are equal up to rounding are those of a circle.
            match (major - minor).abs() <= 1e-12 * major {
                true => out.add(format_args!("CIRCLE('',{frame},{})", reals(&[major]))),
                false => out.add(format_args!("ELLIPSE('',{frame},{})", reals(&[major, minor]))),
            }
        }
        EdgeCurve::Spline { points, derivatives } => write_curve(out, &bspline(points, derivatives)),
    }
}

/// Joins cubic Hermite pieces to one B-spline. Double inner knots keep the continuity of the first
/// derivative, which is all that the pieces have.
fn bspline(points: &[DVec3], derivatives: &[DVec3]) -> BsplineCurve {
    let last = points.len() - 1;
    // From Hermite to Bézier form: inner poles are a third of the derivative away from the ends.
    let third = |k: usize, sign: f64| points[k] + sign * derivatives[k] / 3.0;
    let mut poles = vec![points[0]];
    for k in 0..last {
        poles.push(third(k, 1.0));
        poles.push(third(k + 1, -1.0));
    }
    poles.push(points[last]);
    let multiplicity = |k: usize| if k == 0 || k == last { 4 } else { 2 };
    BsplineCurve { degree: 3, knots: (0..=last).map(|k| (k as f64, multiplicity(k))).collect(), poles }
}

/// Number of samples per edge by which the angles that it covers on a cylinder are found.
const EDGE_SAMPLES: usize = 64;
/// Minimum angular gap without edges that proves that a face does not reach there: larger than the step of
/// samples, which is at most 360°/64 = 5.6°.
const MIN_GAP_RAD: f64 = TAU / 24.0;

/// Surface of a face, with the seam of a cylinder rotated into the part that the face does not cover. The
/// surface is unchanged if the face does not cross the seam, or covers the whole circumference.
///
/// Open Cascade 7.9 reads a face of more than half of a cylinder that crosses the seam as the other part.
fn with_turned_seam(solid: &Solid, face: &Face) -> FaceSurface {
    let FaceSurface::Cylinder { origin, axis, x, radius } = face.surface else {
        return face.surface;
    };
    let mut angles: Vec<f64> = face
        .loops
        .iter()
        .flatten()
        .flat_map(|coedge| {
            let edge = &solid.edges[coedge.edge];
            let [from, to] = edge.range;
            let at = move |k: usize| edge.curve.point(from + (to - from) * k as f64 / EDGE_SAMPLES as f64);
            (0..=EDGE_SAMPLES).map(move |k| face.surface.parameters(at(k))[0].rem_euclid(TAU))
        })
        .collect();
    angles.sort_by(f64::total_cmp);
    let Some(first) = angles.first().copied() else {
        return face.surface;
    };
    // Start and width of the widest part without edges; the first candidate is the part across angle 0.
    let (mut begins, mut width) = (angles[angles.len() - 1], first + TAU - angles[angles.len() - 1]);
    for pair in angles.windows(2) {
        if pair[1] - pair[0] > width {
            (begins, width) = (pair[0], pair[1] - pair[0]);
        }
    }
    let holds_seam = begins + width >= TAU;
    if width < MIN_GAP_RAD || holds_seam {
        return face.surface;
    }
    let (sin, cos) = (begins + width / 2.0).sin_cos();
    FaceSurface::Cylinder { origin, axis, x: cos * x + sin * axis.cross(x), radius }
}

/// Middle of an open arc of more than half a turn, which is written in two parts: Open Cascade 7.9 read such
/// an arc (of 184.7°) as the other arc between its ends.
fn middle_of_long_arc(edge: &Edge) -> Option<DVec3> {
    let [from, to] = edge.range;
    let is_long = matches!(edge.curve, EdgeCurve::Ellipse { .. }) && to - from > PI * (1.0 + 1e-9);
    (is_long && edge.start != edge.end).then(|| edge.curve.point(0.5 * (from + to)))
}

/// Writes the shells of each body of a solid: the outer one first, then those of voids.
pub(super) fn write_bodies<W: Write>(out: &mut Part21<W>, solid: &Solid) -> io::Result<Vec<Vec<Id>>> {
    let mut vertices = Vec::with_capacity(solid.vertices.len());
    for vertex in &solid.vertices {
        let point = write_point(out, *vertex)?;
        vertices.push(out.add(format_args!("VERTEX_POINT('',{point})"))?);
    }
    let mut edges = Vec::with_capacity(solid.edges.len());
    for edge in &solid.edges {
        let curve = write_edge_curve(out, edge)?;
        let (start, end) = (vertices[edge.start], vertices[edge.end]);
        let middle = match middle_of_long_arc(edge) {
            Some(middle) => {
                let middle = write_point(out, middle)?;
                Some(out.add(format_args!("VERTEX_POINT('',{middle})"))?)
            }
            None => None,
        };
        let along: Vec<Id> = [Some(start), middle, Some(end)].into_iter().flatten().collect();
        // Both parts of a split arc share one curve.
        let parts: io::Result<Vec<Id>> = along
            .windows(2)
            .map(|ends| out.add(format_args!("EDGE_CURVE('',{},{},{curve},.T.)", ends[0], ends[1])))
            .collect();
        edges.push(parts?);
    }
    let mut written = Vec::new();
    for body in solid.bodies() {
        let shells = std::iter::once(&body.outer).chain(&body.voids);
        // The outer shell comes first, which is how the caller recognises voids.
        let ids: io::Result<Vec<Id>> = shells.map(|shell| write_shell(out, solid, &edges, shell)).collect();
        written.push(ids?);
    }
    Ok(written)
}

/// Writes a closed shell.
fn write_shell<W: Write>(
    out: &mut Part21<W>,
    solid: &Solid,
    edges: &[Vec<Id>],
    shell: &[usize],
) -> io::Result<Id> {
    let mut faces = Vec::with_capacity(shell.len());
    for &index in shell {
        let face = &solid.faces[index];
        let surface = write_surface(out, &with_turned_seam(solid, face))?;
        let mut bounds = Vec::with_capacity(face.loops.len());
        for (k, ring) in face.loops.iter().enumerate() {
            let mut oriented = Vec::with_capacity(ring.len());
            for coedge in ring {
                // The two `*` below are the ends, which are derived from the edge.
                let sense = if coedge.forward { "T" } else { "F" };
                let mut parts = edges[coedge.edge].clone();
                if !coedge.forward {
                    // Traversed backwards, the parts come in reverse order.
                    parts.reverse();
                }
                for part in parts {
                    oriented.push(out.add(format_args!("ORIENTED_EDGE('',*,*,{part},.{sense}.)"))?);
                }
            }
            let ring = out.add_list("EDGE_LOOP('',", &oriented)?;
            // A face has at most one outer bound. `Solid` puts it first; around a cylinder, either loop will
            // do.
            let kind = if k == 0 { "FACE_OUTER_BOUND" } else { "FACE_BOUND" };
            bounds.push(out.add(format_args!("{kind}('',{ring},.T.)"))?);
        }
        let sense = if face.outward { "T" } else { "F" };
        let id = out.begin()?;
        write!(out.writer(), "ADVANCED_FACE('',(")?;
        for (k, bound) in bounds.iter().enumerate() {
            write!(out.writer(), "{}{bound}", if k > 0 { "," } else { "" })?;
        }
        write!(out.writer(), "),{surface},.{sense}.)")?;
        out.end()?;
        faces.push(id);
    }
    out.add_list("CLOSED_SHELL('',", &faces)
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_solid::brep::Coedge;

    /// A face of a cylinder between two angles, for z from 0 to 5.
    fn part(from: f64, to: f64) -> Solid {
        let surface = FaceSurface::Cylinder { origin: DVec3::ZERO, axis: DVec3::Z, x: DVec3::X, radius: 2.0 };
        let at = |angle: f64, z: f64| surface.point([angle, z]);
        let arc = |z: f64, [start, end]: [usize; 2]| Edge {
            curve: EdgeCurve::Ellipse {
                center: DVec3::new(0.0, 0.0, z),
                a: DVec3::new(2.0, 0.0, 0.0),
                b: DVec3::new(0.0, 2.0, 0.0),
            },
            range: [from, to],
            start,
            end,
        };
        let line = |angle: f64, [start, end]: [usize; 2]| Edge {
            curve: EdgeCurve::Line { origin: at(angle, 0.0), direction: DVec3::Z },
            range: [0.0, 5.0],
            start,
            end,
        };
        let uses = [(0, true), (1, true), (2, false), (3, false)];
        Solid {
            vertices: vec![at(from, 0.0), at(to, 0.0), at(to, 5.0), at(from, 5.0)],
            edges: vec![arc(0.0, [0, 1]), line(to, [1, 2]), arc(5.0, [3, 2]), line(from, [0, 3])],
            faces: vec![Face {
                surface,
                outward: true,
                loops: vec![uses.map(|(edge, forward)| Coedge { edge, forward }).to_vec()],
            }],
        }
    }

    #[test]
    fn the_seam_of_a_face_that_crosses_it_is_rotated() {
        // 185 degrees across angle 0.
        let (from, to) = (-100_f64.to_radians(), 85_f64.to_radians());
        let solid = part(from, to);
        let turned = with_turned_seam(&solid, &solid.faces[0]);
        let angle = |t: f64| turned.parameters(solid.edges[0].curve.point(t))[0].rem_euclid(TAU);
        let mut last = 0.0;
        for k in 0..=20 {
            let at = angle(from + (to - from) * f64::from(k) / 20.0);
            assert!(at > last && at < TAU, "{at} after {last}");
            last = at;
        }
    }

    #[test]
    fn arcs_of_more_than_half_a_turn_are_written_in_two_parts() {
        let long = part(0.0, 190_f64.to_radians());
        let middle = middle_of_long_arc(&long.edges[0]).expect("longer than half a turn");
        let angle = 95_f64.to_radians();
        assert!(
            (middle[0] - 2.0 * angle.cos()).abs() < 1e-12 && (middle[1] - 2.0 * angle.sin()).abs() < 1e-12
        );
        assert_eq!(middle_of_long_arc(&long.edges[1]), None);
        assert_eq!(middle_of_long_arc(&part(0.0, PI).edges[0]), None);
        let mut written = Vec::new();
        let mut out = Part21::new(&mut written);
        write_bodies(&mut out, &long).expect("a buffer takes all");
        let text = String::from_utf8(written).expect("text");
        assert_eq!(text.matches("EDGE_CURVE").count(), 6);
        assert_eq!(text.matches("ORIENTED_EDGE").count(), 6);
    }

    #[test]
    fn the_seam_is_kept_if_the_face_does_not_cross_it_or_closes() {
        for (from, to) in [(0.5, 4.0), (0.0, TAU)] {
            let solid = part(from, to);
            assert_eq!(with_turned_seam(&solid, &solid.faces[0]), solid.faces[0].surface);
        }
    }
}
