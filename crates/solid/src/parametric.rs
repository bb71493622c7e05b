//! Trimmed parametric faces of CAD files and their triangulation.
//!
//! Input: vertices, edges with curves, faces with surfaces and loops, as read from a file. Output: triangles
//! whose corners lie on the surfaces and edges, and a list of the faces that could not be filled. Each edge
//! is divided into chords once, and all of its faces share them, so neighbouring triangles match.
//!
//! A face is filled in the parameters of its surface. Loops are projected there point by point, starting
//! from the previous parameters. A loop that winds around a periodic surface is joined by a bridge to the
//! other such loop, or to the pole inside the face.
//!
//! Limits: the shape of triangles is not controlled, and intersections between faces are not detected. Faces
//! with self-intersecting loops are skipped, and the reason is reported.
//!
//! # References
//! ISO 10303-42 (curves, surfaces and their parameters, and the sense of loops); Chew 1989, *Constrained
//! Delaunay triangulations*; the crate `spade`.

mod curve;
mod lifted;
mod mesh;
mod outline;
mod seeds;
mod spline;
mod surface;
#[cfg(test)]
mod tests;
mod weld;

pub use curve::ParametricCurve;
pub use mesh::{Meshed, Part, SkippedFace};
use planish_core::{BoundingBox, DVec3};
pub use spline::{MAX_DEGREE, SplineCurve, SplineSurface};
pub use surface::{ParametricSurface, Pole};

/// Resolution of a triangulation; lengths are in the unit of the coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fineness {
    /// Maximum chord error, > 0.
    pub chord: f64,
    /// Approximate maximum side length of a triangle; infinite for no limit.
    pub longest: f64,
}

/// An edge between two vertices, or a closed edge at one vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct ParametricEdge {
    /// Curve that carries the edge.
    pub curve: ParametricCurve,
    /// Indices of the start and end vertex.
    pub ends: [usize; 2],
    /// True if the edge runs in the direction of increasing curve parameter.
    pub is_forward: bool,
}

/// A part of a surface bounded by loops; without loops, the whole surface.
#[derive(Debug, Clone, PartialEq)]
pub struct ParametricFace {
    /// Name in the file, for messages.
    pub name: String,
    /// Surface that carries the face.
    pub surface: ParametricSurface,
    /// True if the surface normal `S_u × S_v` points outwards.
    pub is_outward: bool,
    /// Boundary loops in any order: edge indices, each with true if the edge is followed from its start.
    /// Seen from outside, the face lies to the left.
    pub loops: Vec<Vec<(usize, bool)>>,
}

/// Faces that share vertices and edges.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ParametricShape {
    /// Points where edges meet.
    pub vertices: Vec<DVec3>,
    /// Edges between them.
    pub edges: Vec<ParametricEdge>,
    /// Faces bounded by the edges.
    pub faces: Vec<ParametricFace>,
}

/// Sample points per closed edge, and per parameter of an untrimmed surface, for the bounding box.
///
/// More points give a tighter box at a higher cost.
const PROBES: usize = 8;

impl ParametricShape {
    /// The box around edges and untrimmed surfaces, by samples; `None` if the shape is empty.
    ///
    /// ```
    /// use planish_solid::parametric::ParametricShape;
    ///
    /// assert_eq!(ParametricShape::default().bounds(), None);
    /// ```
    #[must_use]
    pub fn bounds(&self) -> Option<BoundingBox> {
        let mut bounds: Option<BoundingBox> = None;
        let mut reach = |p| bounds.get_or_insert(BoundingBox { min: p, max: p }).include(p);
        let share = |k: usize| k as f64 / PROBES as f64;
        for edge in &self.edges {
            // Ends of an edge bound it roughly; only a closed edge needs samples. Indices are not checked
            // yet.
            edge.ends.iter().filter_map(|v| self.vertices.get(*v)).for_each(|p| reach(*p));
            if edge.ends[0] == edge.ends[1] && edge.curve.period().is_some() {
                let [lo, hi] = edge.curve.domain();
                (0..PROBES).for_each(|k| reach(edge.curve.point(lo + share(k) * (hi - lo))));
            }
        }
        for face in self.faces.iter().filter(|f| f.loops.is_empty()) {
            if let [Some(u), Some(v)] = face.surface.domain() {
                for i in 0..=PROBES {
                    for j in 0..=PROBES {
                        reach(
                            face.surface
                                .point([u[0] + share(i) * (u[1] - u[0]), v[0] + share(j) * (v[1] - v[0])]),
                        );
                    }
                }
            }
        }
        bounds
    }
}
