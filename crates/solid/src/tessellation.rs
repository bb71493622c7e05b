//! Watertight triangle mesh of a solid within a chord tolerance.
//!
//! Input: a boundary representation. Output: a closed, manifold [`TriangleMesh`] that is oriented outwards.
//! Its vertices lie on the edges and faces of the solid. Each edge is divided into chords once, and both of
//! its faces share these chords, which makes the mesh watertight. Each face is filled by a constrained
//! Delaunay triangulation in plane coordinates of its surface (`chart`). Points are inserted where the chord
//! error exceeds the tolerance.
//!
//! Limits: the shape of triangles is not controlled. A torus trimmed by a loop that goes around neither its
//! axis nor its tube is not supported.
//!
//! # References
//! Chew 1989, *Constrained Delaunay triangulations*; the crate `spade` (exact predicates).

mod chart;
mod domain;
mod effort;
pub(crate) mod fill;
pub(crate) mod polygon;
#[cfg(test)]
mod tests;
mod untrimmed;

use crate::brep::{Coedge, Edge, EdgeCurve, Solid};
pub use effort::{MAX_TRIANGLES, min_tolerance, triangles_needed};
pub use fill::{triangulate_polygon, triangulate_region};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::TriangleMesh;
use std::collections::HashMap;
use std::f64::consts::PI;

/// Maximum angle of a chord of a circle, in radians.
///
/// A circle then has at least 12 chords. The chord error alone would allow a chord over half of the circle as
/// soon as the tolerance reaches the radius, and small holes would lose their shape. A smaller angle makes
/// more triangles at coarse tolerances.
const WIDEST_CHORD: f64 = PI / 6.0;
/// Maximum number of tolerances that are tried; each is a quarter of the previous one.
///
/// Chords of two neighbouring edges can cross at a coarse tolerance. Finer ones then make more triangles than
/// needed, but a mesh instead of an error.
const TRIES: usize = 4;

/// Points of the mesh under construction: first those of the edges, each created once, then those in faces.
struct Points {
    positions: Vec<DVec3>,
    /// Points along each edge in the direction of its curve, including its vertices.
    of_edge: Vec<Vec<u32>>,
}

impl Points {
    /// Divides all edges into chords.
    fn new(solid: &Solid, tolerance: f64) -> Self {
        let mut positions = solid.vertices.clone();
        // Two straight edges between the same vertices occur where a hole touches a wall. Each needs a point
        // of its own; otherwise both would be the same edge of the mesh, with four triangles.
        let ends = |edge: &Edge| (edge.start.min(edge.end), edge.start.max(edge.end));
        let mut between: HashMap<(usize, usize), usize> = HashMap::new();
        for edge in &solid.edges {
            *between.entry(ends(edge)).or_default() += 1;
        }
        let of_edge = solid
            .edges
            .iter()
            .map(|edge| {
                let [from, to] = edge.range;
                let n = chords(edge, tolerance).max(if between[&ends(edge)] > 1 { 2 } else { 1 });
                let mut points = vec![edge.start as u32];
                for k in 1..n {
                    points.push(positions.len() as u32);
                    positions.push(edge.curve.point(from + (to - from) * k as f64 / n as f64));
                }
                points.push(edge.end as u32);
                points
            })
            .collect();
        Self { positions, of_edge }
    }

    fn add(&mut self, p: DVec3) -> u32 {
        self.positions.push(p);
        (self.positions.len() - 1) as u32
    }

    /// The points of a coedge in the direction of its loop, without the last one, which begins the next
    /// coedge.
    fn along(&self, coedge: Coedge) -> Vec<u32> {
        let mut points = self.of_edge[coedge.edge].clone();
        if !coedge.forward {
            points.reverse();
        }
        points.pop();
        points
    }
}

/// Number of chords of an edge.
fn chords(edge: &Edge, tolerance: f64) -> usize {
    let [from, to] = edge.range;
    match &edge.curve {
        EdgeCurve::Line { .. } => 1,
        EdgeCurve::Ellipse { a, .. } => {
            // The error of a chord over the angle θ is r (1 − cos θ/2). For an ellipse, `a` is the longer
            // semi-axis, which is on the safe side.
            let widest = 2.0 * (1.0 - (tolerance / a.length()).min(1.0)).acos();
            let n = ((to - from) / widest.clamp(1e-5, WIDEST_CHORD)).ceil() as usize;
            // A closed edge needs three chords to enclose an area, and an arc two to differ from its chord.
            n.max(if edge.start == edge.end { 3 } else { 2 })
        }
        EdgeCurve::Spline { points, .. } => {
            let pieces = points.len().max(2) - 1;
            let miss = (0..pieces)
                .map(|k| {
                    let at = |share: f64| {
                        edge.curve.point(from + (to - from) * (k as f64 + share) / pieces as f64)
                    };
                    let (a, m, b) = (at(0.0), at(0.5), at(1.0));
                    (m - (a + b) / 2.0).length()
                })
                .fold(0.0, f64::max);
            // The chord error falls with the square of the length. The bound of 64 limits the number of
            // points for tolerances near rounding.
            pieces * ((miss / tolerance).sqrt().ceil() as usize).clamp(1, 64)
        }
    }
}

/// Triangulates the boundary of a solid with a chord error of at most `tolerance`, in the unit of its
/// coordinates.
///
/// The volume differs from the exact one by less than twice the tolerance times the area. This bound and
/// watertightness are checked.
///
/// ```
/// use planish_solid::brep::Solid;
/// use planish_solid::tessellation::tessellate;
///
/// // The tolerance must be positive.
/// assert!(tessellate(&Solid::default(), 0.0).is_err());
/// ```
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) if the tolerance is not positive, or needs more than
/// [`MAX_TRIANGLES`]; [`Unsupported`](planish_estimate::ErrorKind::Unsupported), naming the face, if a face
/// cannot be filled.
pub fn tessellate(solid: &Solid, tolerance: f64) -> Result<TriangleMesh> {
    if !(tolerance > 0.0 && tolerance.is_finite()) {
        return Err(Error::input(format!("expected a chord tolerance > 0, found {tolerance}")));
    }
    let needed = triangles_needed(solid, tolerance);
    if needed > MAX_TRIANGLES {
        return Err(Error::input(format!(
            "expected a mesh of at most {MAX_TRIANGLES:.0e} triangles, found about {needed:.1e} for a \
             chord error of {tolerance:e}: use {:.1e} or more",
            // Printed with two digits: rounding down could give a tolerance that is rejected again.
            1.06 * min_tolerance(solid)
        )));
    }
    let mut finer = tolerance;
    let mut made = once(solid, finer);
    for _ in 1..TRIES {
        if made.is_ok() {
            break;
        }
        // A quarter of the tolerance halves the chords.
        finer /= 4.0;
        made = once(solid, finer);
    }
    checked(solid, made?, tolerance)
}

/// Triangulates all faces at one tolerance.
fn once(solid: &Solid, tolerance: f64) -> Result<TriangleMesh> {
    let mut points = Points::new(solid, tolerance);
    let mut triangles = Vec::new();
    for (index, face) in solid.faces.iter().enumerate() {
        if face.is_untrimmed() {
            triangles.extend(untrimmed::triangles(face, &mut points, tolerance));
            continue;
        }
        let named = |e: Error| e.in_context(format!("face {index} ({})", face.surface.kind()));
        let domain = domain::Domain::new(face, &mut points, tolerance).map_err(named)?;
        triangles.extend(fill::triangles(face, &domain, &mut points, tolerance).map_err(named)?);
    }
    // Drop unused vertices, for example those of a circle without corners.
    let mut new_of = vec![u32::MAX; points.positions.len()];
    let mut positions = Vec::new();
    for v in triangles.iter_mut().flatten() {
        let new = &mut new_of[*v as usize];
        if *new == u32::MAX {
            *new = positions.len() as u32;
            positions.push(points.positions[*v as usize]);
        }
        *v = *new;
    }
    TriangleMesh::try_new(positions, triangles)
}

/// Returns the mesh if it is closed and its volume agrees with that of the solid.
fn checked(solid: &Solid, mesh: TriangleMesh, tolerance: f64) -> Result<TriangleMesh> {
    // The volume is an independent test: a mesh can be closed although a face was filled on the wrong side.
    let found = mesh.check();
    if !(found.watertight && found.oriented && found.manifold) {
        return Err(Error::unsupported(format!(
            "its triangles do not close: {} boundary, {} non-manifold and {} misoriented edges",
            found.boundary_edges, found.nonmanifold_edges, found.misoriented_edges
        )));
    }
    let exact = solid.measures();
    let volume = mesh.signed_volume().unwrap_or(f64::NAN);
    let allowed = 2.0 * tolerance * exact.area + 1e-9 * exact.volume.abs();
    match (volume - exact.volume).abs() <= allowed {
        true => Ok(mesh),
        false => Err(Error::unsupported(format!(
            "expected volumes of mesh and solid that differ by less than {allowed}, found {volume} and {}",
            exact.volume
        ))),
    }
}

/// Lengths of the derivatives of a surface along its two parameters, by differences.
fn steps(surface: &crate::brep::FaceSurface, [u, v]: [f64; 2]) -> [f64; 2] {
    let h = 1e-6;
    let p = surface.point([u, v]);
    [[u + h, v], [u, v + h]].map(|q| (1.0 / h * (surface.point(q) - p)).length().max(1e-12))
}
