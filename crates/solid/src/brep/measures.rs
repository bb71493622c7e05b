//! Volume, area and centroid by the divergence theorem.
//!
//! `3 V = ∮ p · n dA`. Over a face, `∬ f du dv = −∮ F du` with `F = ∫ f dv` along its loops (Green's
//! theorem). On planes and cylinders the integrands are polynomials in v, so F has a closed form; `turned`
//! handles the other surfaces. Integrals along edges use Gauss–Legendre quadrature of ten points on pieces of
//! at most 15°.
//!
//! The results depend on the boundary only, so no mesh and no tolerance is needed.

use super::{Coedge, Face, FaceSurface, Solid};
use planish_core::DVec3;
use std::f64::consts::PI;

/// Volume, area and centroid of a solid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measures {
    /// Volume; negative if the boundary is oriented inwards.
    pub volume: f64,
    /// Area of all faces.
    pub area: f64,
    /// Centroid of the volume.
    pub centroid: DVec3,
}

/// Nodes on (−1, 1) and weights of Gauss–Legendre quadrature. Ten points are exact up to degree 19.
pub(super) const GAUSS: [(f64, f64); 10] = [
    (-0.973_906_528_517_171_7, 0.066_671_344_308_688_14),
    (-0.865_063_366_688_984_5, 0.149_451_349_150_580_6),
    (-0.679_409_568_299_024_4, 0.219_086_362_515_982_04),
    (-0.433_395_394_129_247_2, 0.269_266_719_309_996_35),
    (-0.148_874_338_981_631_2, 0.295_524_224_714_752_87),
    (0.148_874_338_981_631_2, 0.295_524_224_714_752_87),
    (0.433_395_394_129_247_2, 0.269_266_719_309_996_35),
    (0.679_409_568_299_024_4, 0.219_086_362_515_982_04),
    (0.865_063_366_688_984_5, 0.149_451_349_150_580_6),
    (0.973_906_528_517_171_7, 0.066_671_344_308_688_14),
];

impl Solid {
    /// Volume, area and centroid.
    #[must_use]
    pub fn measures(&self) -> Measures {
        // An origin near the solid. Far from it, the integrals over opposite faces nearly cancel.
        let origin = self.vertices.first().copied().unwrap_or_default();
        let (mut area, mut flux, mut moments) = (0.0, 0.0, DVec3::ZERO);
        for face in &self.faces {
            let found = self.integrals(face, origin);
            area += found[0];
            flux += found[1];
            for k in 0..3 {
                moments[k] += found[2 + k];
            }
        }
        let volume = flux / 3.0;
        Measures { volume, area, centroid: origin + moments / (2.0 * volume) }
    }

    /// The volume that some faces enclose; negative for the inside of a void.
    #[must_use]
    pub fn volume_of(&self, faces: &[usize]) -> f64 {
        let origin = self.vertices.first().copied().unwrap_or_default();
        faces.iter().map(|f| self.integrals(&self.faces[*f], origin)[1]).sum::<f64>() / 3.0
    }

    /// The area of some faces.
    #[must_use]
    pub fn area_of(&self, faces: &[usize]) -> f64 {
        let origin = self.vertices.first().copied().unwrap_or_default();
        faces.iter().map(|f| self.integrals(&self.faces[*f], origin)[0]).sum()
    }

    /// Integrals over a face of 1, `p · n`, and `p_k² n_k`, with p from the origin and n outwards.
    ///
    /// By the divergence theorem, the second gives three times the volume, and the last ones twice the
    /// moments of the volume.
    fn integrals(&self, face: &Face, origin: DVec3) -> [f64; 5] {
        let sign = if face.outward { 1.0 } else { -1.0 };
        let mut sum = [0.0; 5];
        if !matches!(face.surface, FaceSurface::Plane { .. } | FaceSurface::Cylinder { .. }) {
            sum = self.turned_integrals(face, origin);
            sum[0] *= sign;
            return sum;
        }
        for coedge in face.loops.iter().flatten() {
            let along = self.along_edge(face, *coedge, origin);
            for k in 0..5 {
                sum[k] += along[k];
            }
        }
        // Loops run counter-clockwise seen from outside. If the normal of the surface points inwards, this
        // reverses the sign of all integrals, and n has the other sign, too. Only the area then needs a sign.
        sum[0] *= sign;
        sum
    }

    /// Integrals along a coedge of a face on a plane or cylinder.
    fn along_edge(&self, face: &Face, coedge: Coedge, origin: DVec3) -> [f64; 5] {
        let edge = &self.edges[coedge.edge];
        let [from, to] = edge.range;
        let pieces = pieces(edge);
        let direction = if coedge.forward { 1.0 } else { -1.0 };
        let half = (to - from) / pieces as f64 / 2.0;
        let mut sum = [0.0; 5];
        for piece in 0..pieces {
            let middle = from + half * (2 * piece + 1) as f64;
            for (node, weight) in GAUSS {
                let t = middle + half * node;
                let (p, d) = (edge.curve.point(t), edge.curve.derivative(t));
                let found = integrands(&face.surface, p, d, origin);
                for k in 0..5 {
                    sum[k] += direction * weight * half * found[k];
                }
            }
        }
        sum
    }
}

/// Number of pieces of an edge for the quadrature.
pub(super) fn pieces(edge: &super::Edge) -> usize {
    let [from, to] = edge.range;
    match &edge.curve {
        super::EdgeCurve::Line { .. } => 1,
        super::EdgeCurve::Ellipse { .. } => ((to - from) / (PI / 12.0)).ceil().max(1.0) as usize,
        super::EdgeCurve::Spline { points, .. } => points.len() - 1,
    }
}

/// `−F du/dt` for the five integrands, with the normal and orientation of the surface itself.
fn integrands(surface: &FaceSurface, p: DVec3, d: DVec3, origin: DVec3) -> [f64; 5] {
    let [_, v] = surface.parameters(p);
    match surface {
        FaceSurface::Cone { .. } | FaceSurface::Sphere { .. } | FaceSurface::Torus { .. } => [0.0; 5],
        FaceSurface::Plane { origin: at, normal, x, .. } => {
            let y = normal.cross(*x);
            let du = d.dot(*x);
            let level = (*at - origin).dot(*normal);
            // p_k is q_k + v y_k, with q at v = 0, and its square is integrated over v.
            let q = p - v * y - origin;
            let second = |k: usize| {
                normal[k] * (q[k] * q[k] * v + q[k] * y[k] * v * v + y[k] * y[k] * v * v * v / 3.0)
            };
            [-v * du, -level * v * du, -second(0) * du, -second(1) * du, -second(2) * du]
        }
        FaceSurface::Cylinder { origin: at, axis, radius, .. } => {
            let n = surface.normal(p);
            // du is (axis × n) · dp / r, and an element of area is r du dv: the radii cancel.
            let du = d.dot(axis.cross(n));
            let q = p - v * *axis - origin;
            let level = (*at - origin).dot(n) + radius;
            let second = |k: usize| {
                n[k] * (q[k] * q[k] * v + q[k] * axis[k] * v * v + axis[k] * axis[k] * v * v * v / 3.0)
            };
            [-v * du, -level * v * du, -second(0) * du, -second(1) * du, -second(2) * du]
        }
    }
}
