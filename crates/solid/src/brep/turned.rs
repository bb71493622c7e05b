//! Area, flux and moments of faces on cones, spheres and tori.
//!
//! Over a face in its parameters, `∬ f du dv = −∮ F du` with `F = ∫ f dv` from a base that the face does not
//! cross. This is a pole of the sphere or the apex of the cone, where circles around the axis have no length,
//! or a v at which the tube of a torus has no face. If a face goes all around the tube, it is `∮ G dv` with
//! `G = ∫ f du`. Inner integrals use Gauss–Legendre quadrature of ten points on pieces of at most 30°.
//!
//! Limits: a torus with a hole that goes around neither its axis nor its tube, and edges through the poles of
//! a sphere, are not supported.

use super::measures::{GAUSS, pieces};
use super::{Face, FaceSurface, Solid};
use planish_core::DVec3;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Values at a quadrature point of the boundary of a face, in the parameters of its surface.
struct Node {
    parameters: [f64; 2],
    /// Derivatives of the parameters along the edge, times the weight of the quadrature.
    derivatives: [f64; 2],
}

/// Start of the inner integral.
#[derive(Clone, Copy)]
enum Base {
    /// A value of v.
    V(f64),
    /// A value of v; the angles v are taken from this value to 2π above it.
    CutV(f64),
    /// As [`Base::CutV`], for u.
    CutU(f64),
}

impl Solid {
    /// Integrals of 1, `p · n` and `p_k² n_k` over a face of a cone, sphere or torus, with the normal of the
    /// surface and the direction of the loops.
    pub(super) fn turned_integrals(&self, face: &Face, origin: DVec3) -> [f64; 5] {
        let sense = if face.outward { 1.0 } else { -1.0 };
        if face.is_untrimmed() {
            return untrimmed_integrals(&face.surface, origin).map(|value| sense * value);
        }
        let nodes = self.nodes(face);
        let integral_from = |base| integrated(&face.surface, &nodes, base, origin);
        match face.surface {
            // Loops in parameters do not determine on which side of a cut the face lies. A gap without nodes
            // may be inside of the face, so cuts are tried from the widest gap until the area is positive.
            FaceSurface::Torus { .. } => {
                let v = gaps(&nodes, 1).into_iter().map(Base::CutV);
                let u = gaps(&nodes, 0).into_iter().map(Base::CutU);
                let mut best = [0.0; 5];
                for base in v.chain(u) {
                    let found = integral_from(base);
                    // If the face contains the base, the result is that of the rest of the torus, with the
                    // other sign.
                    if found[0] * sense > 0.0 {
                        return found;
                    }
                    best = found;
                }
                best
            }
            FaceSurface::Sphere { .. } => {
                let turns = nodes.iter().map(|n| n.derivatives[0]).sum::<f64>() / TAU * sense;
                let mut found = integral_from(Base::V(if turns > 0.5 { FRAC_PI_2 } else { -FRAC_PI_2 }));
                // If the face contains both poles, the result lacks the whole sphere.
                if found[0] * sense <= 0.0 {
                    for (sum, complete) in found.iter_mut().zip(untrimmed_integrals(&face.surface, origin)) {
                        *sum += sense * complete;
                    }
                }
                found
            }
            _ => integral_from(Base::V(face.surface.range_v()[0])),
        }
    }

    /// Quadrature points along all loops of a face.
    fn nodes(&self, face: &Face) -> Vec<Node> {
        let mut nodes = Vec::new();
        for coedge in face.loops.iter().flatten() {
            let edge = &self.edges[coedge.edge];
            let [from, to] = edge.range;
            let direction = if coedge.forward { 1.0 } else { -1.0 };
            let pieces = pieces(edge);
            let half = (to - from) / pieces as f64 / 2.0;
            for piece in 0..pieces {
                let middle = from + half * (2 * piece + 1) as f64;
                for (node, weight) in GAUSS {
                    let t = middle + half * node;
                    let (p, d) = (edge.curve.point(t), edge.curve.derivative(t));
                    // The outer quadrature, along edges; `integrated` adds the inner one for each base.
                    nodes.push(Node {
                        parameters: face.surface.parameters(p),
                        derivatives: derivatives(&face.surface, p, d).map(|d| direction * weight * half * d),
                    });
                }
            }
        }
        nodes
    }
}

/// The integrals over a whole sphere or torus: `∬ p · n = 3 V` and `∬ p_k² n_k = 2 V c_k` with the centre c.
fn untrimmed_integrals(surface: &FaceSurface, origin: DVec3) -> [f64; 5] {
    let (area, volume, center) = match *surface {
        FaceSurface::Sphere { center, radius, .. } => {
            let area = 4.0 * PI * radius * radius;
            (area, area * radius / 3.0, center)
        }
        FaceSurface::Torus { center, major, minor, .. } => {
            let volume = 2.0 * PI * PI * major * minor * minor;
            (2.0 * volume / minor, volume, center)
        }
        _ => return [0.0; 5],
    };
    let DVec3 { x, y, z } = 2.0 * volume * (center - origin);
    [area, 3.0 * volume, x, y, z]
}

/// Origin (or centre) and axis of a surface.
fn frame(surface: &FaceSurface) -> (DVec3, DVec3) {
    match surface {
        FaceSurface::Plane { origin, normal, .. } => (*origin, *normal),
        FaceSurface::Cylinder { origin, axis, .. } | FaceSurface::Cone { origin, axis, .. } => {
            (*origin, *axis)
        }
        FaceSurface::Sphere { center, axis, .. } | FaceSurface::Torus { center, axis, .. } => {
            (*center, *axis)
        }
    }
}

/// Derivatives of both parameters for the derivative `d` of a point.
fn derivatives(surface: &FaceSurface, p: DVec3, d: DVec3) -> [f64; 2] {
    let (center, axis) = frame(surface);
    let from = p - center;
    let across = from - from.dot(axis) * axis;
    let distance = across.length().max(f64::MIN_POSITIVE);
    let out = across.map(|c| c / distance);
    let du = d.dot(axis.cross(out)) / distance;
    let v = surface.parameters(p)[1];
    let along_v = |radius: f64| (d.dot(axis) * v.cos() - d.dot(out) * v.sin()) / radius;
    let dv = match surface {
        FaceSurface::Sphere { radius, .. } => along_v(*radius),
        FaceSurface::Torus { minor, .. } => along_v(*minor),
        _ => d.dot(axis),
    };
    [du, dv]
}

/// The area element over du dv.
fn element(surface: &FaceSurface, v: f64) -> f64 {
    match surface {
        FaceSurface::Cone { radius, half_angle_rad, .. } => {
            (radius + v * half_angle_rad.tan()) / half_angle_rad.cos()
        }
        FaceSurface::Sphere { radius, .. } => radius * radius * v.cos(),
        FaceSurface::Torus { major, minor, .. } => minor * (major + minor * v.cos()),
        _ => 1.0,
    }
}

/// The integrands at parameters, with the area element.
fn integrands(surface: &FaceSurface, at: [f64; 2], origin: DVec3) -> [f64; 5] {
    let p = surface.point(at);
    let n = surface.normal(p);
    let q = p - origin;
    let area = element(surface, at[1]);
    let moment = |k: usize| area * q[k] * q[k] * n[k];
    [area, area * q.dot(n), moment(0), moment(1), moment(2)]
}

/// The integrals over a face from a base: the inner integral at each node, weighted by the outer quadrature.
fn integrated(surface: &FaceSurface, nodes: &[Node], base: Base, origin: DVec3) -> [f64; 5] {
    let lifted = |value: f64, cut: f64| cut + (value - cut).rem_euclid(TAU);
    let mut sum = [0.0; 5];
    for node in nodes {
        let [u, v] = node.parameters;
        let (from, to, weight) = match base {
            Base::V(base) => (base, v, -node.derivatives[0]),
            Base::CutV(cut) => (cut, lifted(v, cut), -node.derivatives[0]),
            Base::CutU(cut) => (cut, lifted(u, cut), node.derivatives[1]),
        };
        let pieces = match surface {
            // On a cone the integrands are polynomials in v of a degree for which ten points are exact.
            FaceSurface::Cone { .. } => 1,
            _ => ((to - from).abs() / (PI / 6.0)).ceil().max(1.0) as usize,
        };
        let half = (to - from) / pieces as f64 / 2.0;
        for piece in 0..pieces {
            let middle = from + half * (2 * piece + 1) as f64;
            for (place, share) in GAUSS {
                let s = middle + half * place;
                let at = if matches!(base, Base::CutU(_)) { [s, v] } else { [u, s] };
                let found = integrands(surface, at, origin);
                for k in 0..5 {
                    sum[k] += weight * half * share * found[k];
                }
            }
        }
    }
    sum
}

/// Middles of the intervals of an angle without nodes, widest first.
fn gaps(nodes: &[Node], which: usize) -> Vec<f64> {
    /// Minimum width of a gap. Neighbouring nodes of an edge are closer: ten nodes on pieces of at most 15°.
    const MIN: f64 = 0.06;
    let mut values: Vec<f64> = nodes.iter().map(|n| n.parameters[which].rem_euclid(TAU)).collect();
    values.sort_by(f64::total_cmp);
    let Some(first) = values.first().copied() else {
        return Vec::new();
    };
    values.push(first + TAU);
    let mut found: Vec<(f64, f64)> =
        values.windows(2).filter(|v| v[1] - v[0] > MIN).map(|v| (v[1] - v[0], (v[0] + v[1]) / 2.0)).collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|f| f.1).collect()
}
