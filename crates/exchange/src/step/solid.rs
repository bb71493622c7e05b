//! Solids on analytic surfaces: `PLANE`, `CYLINDRICAL_SURFACE`, `CONICAL_SURFACE`, `SPHERICAL_SURFACE`, `TOROIDAL_SURFACE`, bounded by `LINE`, `CIRCLE`, `ELLIPSE` and cubic splines.

use super::part21::{Id, Part21};
use super::{BsplineCurve, write_curve, write_point};
use crate::step::part21::reals;
use planish_estimate::vector3::{cross, norm, scale};
use planish_solid::brep::{Curve, Edge, Solid, Surface};
use std::io::{self, Write};

fn write_direction<W: Write>(out: &mut Part21<W>, direction: [f64; 3]) -> io::Result<Id> {
    out.add(format_args!("DIRECTION('',({}))", reals(&direction)))
}

fn write_frame<W: Write>(out: &mut Part21<W>, origin: [f64; 3], z: [f64; 3], x: [f64; 3]) -> io::Result<Id> {
    let origin = write_point(out, origin)?;
    let z = write_direction(out, z)?;
    let x = write_direction(out, x)?;
    out.add(format_args!("AXIS2_PLACEMENT_3D('',{origin},{z},{x})"))
}

fn write_surface<W: Write>(out: &mut Part21<W>, surface: &Surface) -> io::Result<Id> {
    match surface {
        Surface::Plane { origin, normal, x } => {
            let frame = write_frame(out, *origin, *normal, *x)?;
            out.add(format_args!("PLANE('',{frame})"))
        }
        Surface::Cylinder {
            origin,
            axis,
            x,
            radius,
        } => {
            let frame = write_frame(out, *origin, *axis, *x)?;
            out.add(format_args!("CYLINDRICAL_SURFACE('',{frame},{})", reals(&[*radius])))
        }
        Surface::Cone {
            origin,
            axis,
            x,
            radius,
            half_angle_rad,
        } => {
            let frame = write_frame(out, *origin, *axis, *x)?;
            let sizes = [*radius, *half_angle_rad];
            out.add(format_args!("CONICAL_SURFACE('',{frame},{})", reals(&sizes)))
        }
        Surface::Sphere {
            center,
            axis,
            x,
            radius,
        } => {
            let frame = write_frame(out, *center, *axis, *x)?;
            out.add(format_args!("SPHERICAL_SURFACE('',{frame},{})", reals(&[*radius])))
        }
        Surface::Torus {
            center,
            axis,
            x,
            major,
            minor,
        } => {
            let frame = write_frame(out, *center, *axis, *x)?;
            let sizes = [*major, *minor];
            out.add(format_args!("TOROIDAL_SURFACE('',{frame},{})", reals(&sizes)))
        }
    }
}

fn write_edge_curve<W: Write>(out: &mut Part21<W>, edge: &Edge) -> io::Result<Id> {
    match &edge.curve {
        Curve::Line { origin, direction } => {
            let origin = write_point(out, *origin)?;
            let direction = write_direction(out, *direction)?;
            let vector = out.add(format_args!("VECTOR('',{direction},1.)"))?;
            out.add(format_args!("LINE('',{origin},{vector})"))
        }
        Curve::Ellipse { center, a, b } => {
            let (major, minor) = (norm(*a), norm(*b));
            let x = scale(1.0 / major, *a);
            let normal = cross(x, scale(1.0 / minor, *b));
            let frame = write_frame(out, *center, normal, x)?;
            match (major - minor).abs() <= 1e-12 * major {
                true => out.add(format_args!("CIRCLE('',{frame},{})", reals(&[major]))),
                false => out.add(format_args!("ELLIPSE('',{frame},{})", reals(&[major, minor]))),
            }
        }
        Curve::Spline { points, derivatives } => write_curve(out, &bspline(points, derivatives)),
    }
}

/// Cubic Hermite pieces as one B-spline with double knots.
fn bspline(points: &[[f64; 3]], derivatives: &[[f64; 3]]) -> BsplineCurve {
    let last = points.len() - 1;
    let third = |k: usize, sign: f64| [0, 1, 2].map(|c| points[k][c] + sign * derivatives[k][c] / 3.0);
    let mut poles = vec![points[0]];
    for k in 0..last {
        poles.push(third(k, 1.0));
        poles.push(third(k + 1, -1.0));
    }
    poles.push(points[last]);
    let multiplicity = |k: usize| if k == 0 || k == last { 4 } else { 2 };
    BsplineCurve {
        degree: 3,
        knots: (0..=last).map(|k| (k as f64, multiplicity(k))).collect(),
        poles,
    }
}

/// The shells of a solid: the outer one first, then those of voids.
pub(super) fn write_shells<W: Write>(out: &mut Part21<W>, solid: &Solid) -> io::Result<Vec<Id>> {
    let mut vertices = Vec::with_capacity(solid.vertices.len());
    for vertex in &solid.vertices {
        let point = write_point(out, *vertex)?;
        vertices.push(out.add(format_args!("VERTEX_POINT('',{point})"))?);
    }
    let mut edges = Vec::with_capacity(solid.edges.len());
    for edge in &solid.edges {
        let curve = write_edge_curve(out, edge)?;
        let (start, end) = (vertices[edge.start], vertices[edge.end]);
        edges.push(out.add(format_args!("EDGE_CURVE('',{start},{end},{curve},.T.)"))?);
    }
    let mut shells = solid.shells();
    shells.sort_by(|a, b| solid.volume_of(b).total_cmp(&solid.volume_of(a)));
    let mut written = Vec::with_capacity(shells.len());
    for shell in shells {
        let mut faces = Vec::with_capacity(shell.len());
        for index in shell {
            let face = &solid.faces[index];
            let surface = write_surface(out, &face.surface)?;
            let mut bounds = Vec::with_capacity(face.loops.len());
            for (k, ring) in face.loops.iter().enumerate() {
                let mut oriented = Vec::with_capacity(ring.len());
                for coedge in ring {
                    let sense = if coedge.forward { "T" } else { "F" };
                    oriented.push(out.add(format_args!("ORIENTED_EDGE('',*,*,{},.{sense}.)", edges[coedge.edge]))?);
                }
                let ring = out.add_list("EDGE_LOOP('',", &oriented)?;
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
        written.push(out.add_list("CLOSED_SHELL('',", &faces)?);
    }
    Ok(written)
}
