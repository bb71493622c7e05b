//! Places where a boundary touches itself.
//!
//! Parts of a boundary that only touch have separate, coincident edges and vertices. Each part is closed, so
//! [`Solid::check`] passes. As a set of points the boundary is not manifold: four faces meet along a line, or
//! two fans of faces meet at a point. CAD programs read this as a solid within one body (pockets that meet at
//! their corners, a hole that touches a wall). Two bodies that only touch are neither one solid nor two.
//!
//! Limits: an edge that touches the interior of a face, such as that of a hole that touches a wall, is not
//! found. Its faces are manifold as they are written.

use super::{Edge, EdgeCurve, Solid};
use planish_core::{BoundingBox, DVec3};

/// Sample points of an edge that must all lie on another edge, as shares of its range.
///
/// Edges that only cross have isolated points in common, which do not include all three samples.
const SHARES: [f64; 3] = [0.23, 0.5, 0.77];
/// Number of pieces of a curved edge between which the nearest point is searched.
const PIECES: usize = 24;

/// A place at which the boundary touches itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// A point of the contact.
    pub at: DVec3,
    /// True if two edges coincide; false if two vertices do.
    pub is_line: bool,
    /// True if the contact is between two bodies.
    pub is_between_bodies: bool,
}

impl Solid {
    /// Places at which the boundary touches itself, those between bodies first.
    ///
    /// These are pairs of edges within `tolerance` of each other along the shorter one, and pairs of
    /// vertices. The cost is at most quadratic in their numbers; edges are compared only if their boxes
    /// overlap.
    ///
    /// ```
    /// use planish_solid::brep::Solid;
    ///
    /// assert!(Solid::default().contacts(1e-6).is_empty());
    /// ```
    #[must_use]
    pub fn contacts(&self, tolerance: f64) -> Vec<Contact> {
        let mut body_of = vec![0; self.faces.len()];
        for (index, body) in self.bodies().iter().enumerate() {
            for face in body.outer.iter().chain(body.voids.iter().flatten()) {
                body_of[*face] = index;
            }
        }
        let mut faces_of: Vec<Vec<usize>> = vec![Vec::new(); self.edges.len()];
        for (index, face) in self.faces.iter().enumerate() {
            for coedge in face.loops.iter().flatten() {
                faces_of[coedge.edge].push(index);
            }
        }
        // All faces of an edge belong to one body, because shells are connected by edges.
        let body_of_edge = |edge: usize| faces_of[edge].first().map(|f| body_of[*f]);
        let mut found = Vec::new();
        let boxes: Vec<BoundingBox> = self.edges.iter().map(|e| bounds(e, tolerance)).collect();
        for (index, edge) in self.edges.iter().enumerate() {
            let [from, to] = edge.range;
            let places = SHARES.map(|share| edge.curve.point(from + share * (to - from)));
            for (other, near) in boxes.iter().enumerate() {
                if other != index
                    && places.iter().all(|p| near.contains(*p))
                    && places.iter().all(|p| self.edges[other].distance(*p) <= tolerance)
                {
                    let at = places[1];
                    found.push(Contact {
                        at,
                        is_line: true,
                        is_between_bodies: body_of_edge(index) != body_of_edge(other),
                    });
                }
            }
        }
        let mut body_of_vertex = vec![None; self.vertices.len()];
        for (index, edge) in self.edges.iter().enumerate() {
            for vertex in [edge.start, edge.end] {
                body_of_vertex[vertex] = body_of_edge(index);
            }
        }
        for a in 0..self.vertices.len() {
            for b in 0..a {
                let at = self.vertices[a];
                if (at - self.vertices[b]).length() <= tolerance {
                    found.push(Contact {
                        at,
                        is_line: false,
                        is_between_bodies: body_of_vertex[a] != body_of_vertex[b],
                    });
                }
            }
        }
        found.sort_by_key(|contact| !contact.is_between_bodies);
        found
    }
}

/// A box around an edge, enlarged by a margin, and by the longest chord if the edge is curved: it cannot
/// bulge farther between two sample points.
fn bounds(edge: &Edge, margin: f64) -> BoundingBox {
    let points = points(edge);
    let longest = points.windows(2).map(|p| (p[1] - p[0]).length()).fold(0.0, f64::max);
    let more = margin
        + match edge.curve {
            EdgeCurve::Line { .. } => 0.0,
            _ => longest,
        };
    let mut bounds = BoundingBox { min: points[0], max: points[0] };
    points.iter().for_each(|p| bounds.include(*p));
    bounds.grown(more)
}

/// Points along an edge, at equal steps of its parameter.
fn points(edge: &Edge) -> Vec<DVec3> {
    let [from, to] = edge.range;
    let n = match edge.curve {
        EdgeCurve::Line { .. } => 1,
        _ => PIECES,
    };
    (0..=n).map(|k| edge.curve.point(from + (to - from) * k as f64 / n as f64)).collect()
}

impl Edge {
    /// The distance of a point from the edge, by Gauss–Newton steps from the nearest sample point.
    ///
    /// The result is not larger than the distance to that sample, also if the iteration fails.
    fn distance(&self, p: DVec3) -> f64 {
        let [from, to] = self.range;
        let points = points(self);
        let step = (to - from) / (points.len() - 1) as f64;
        let off = |k: &usize| (points[*k] - p).length();
        let nearest = (0..points.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0);
        let mut t = from + step * nearest as f64;
        // Gauss–Newton converges fast for points near the edge; farther ones need no exact distance.
        for _ in 0..8 {
            let d = self.curve.derivative(t);
            let square = d.length_squared();
            if square == 0.0 {
                break;
            }
            t = (t + (p - self.curve.point(t)).dot(d) / square).clamp(from, to);
        }
        let straight = p - self.curve.point(t);
        straight.length().min(off(&nearest))
    }
}
