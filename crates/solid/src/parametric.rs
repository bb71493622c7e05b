//! Faces of CAD programs, trimmed by edges, as triangles.
//!
//! Input: vertices, edges with curves, faces with surfaces of any kind and loops of edges, as others wrote
//! them. Output: triangles whose corners lie on the surfaces and along the edges, and for each face whether
//! it could be filled. Every edge is cut into chords once, and all its faces use these: where faces share an
//! edge their triangles do, too.
//!
//! A face is filled in the parameters of its surface. Loops are brought there point by point, each near the
//! one before; a loop that winds around is joined by a bridge to the other one that does, or to the pole that
//! the face holds.
//!
//! Not guaranteed: shapes of triangles; that faces do not cross one another; faces whose loops cross
//! themselves are left out, with the reason.
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
pub use spline::{MAX_DEGREE, SplineCurve, SplineSurface};
pub use surface::{ParametricSurface, Pole};

/// How fine triangles are; lengths in the unit of the coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fineness {
    /// How far triangles may be from their surface, > 0.
    pub chord: f64,
    /// The longest side that a triangle may have, about; infinite where it does not matter.
    pub longest: f64,
}

/// An edge between two vertices, or from one back to it.
#[derive(Debug, Clone, PartialEq)]
pub struct ParametricEdge {
    /// Where it runs.
    pub curve: ParametricCurve,
    /// The vertices where it begins and ends.
    pub ends: [usize; 2],
    /// Whether it runs as its curve's parameter grows.
    pub is_forward: bool,
}

/// A part of a surface within loops; all of it where there are none.
#[derive(Debug, Clone, PartialEq)]
pub struct ParametricFace {
    /// What others call it, for messages.
    pub name: String,
    /// Where it lies.
    pub surface: ParametricSurface,
    /// Whether its outer side is that of the surface's normal, `S_u × S_v`.
    pub is_outward: bool,
    /// Its loops in any order: edges, each with whether it is run along from its beginning, the face to the
    /// left as seen from its outer side.
    pub loops: Vec<Vec<(usize, bool)>>,
}

/// Faces that share vertices and edges.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ParametricShape {
    /// Points where edges meet.
    pub vertices: Vec<[f64; 3]>,
    /// Edges between them.
    pub edges: Vec<ParametricEdge>,
    /// Faces between these.
    pub faces: Vec<ParametricFace>,
}

/// Places along an edge, and along each parameter of a whole surface, that bounds are taken of.
const PROBES: usize = 8;

impl ParametricShape {
    /// Least and largest coordinates of what edges and whole surfaces reach; the least are above the largest
    /// where there is nothing.
    #[must_use]
    pub fn bounds(&self) -> [[f64; 3]; 2] {
        let mut bounds = [[f64::MAX; 3], [f64::MIN; 3]];
        let mut reach = |p: [f64; 3]| {
            for c in 0..3 {
                bounds[0][c] = bounds[0][c].min(p[c]);
                bounds[1][c] = bounds[1][c].max(p[c]);
            }
        };
        let share = |k: usize| k as f64 / PROBES as f64;
        for edge in &self.edges {
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
