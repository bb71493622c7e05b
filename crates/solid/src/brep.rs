//! Boundary representation of solids with analytic surfaces.
//!
//! Input: vertices, edges with curves, faces with surfaces and loops. [`Solid::check`] tests that they fit
//! together. [`Solid::measures`] computes volume, area and centroid by the divergence theorem.
//! [`Solid::contacts`] finds places where the boundary touches itself, and [`Solid::bodies`] separates
//! bodies.
//!
//! ```
//! use planish_solid::brep::Solid;
//!
//! let empty = Solid::default();
//! assert_eq!(empty.faces_by_kind(), [0; 5]);
//! assert!(empty.shells().is_empty());
//! ```

mod bodies;
mod check;
mod contact;
mod geometry;
mod measures;
mod trimmed;
mod turned;

use planish_core::{DVec3, DisjointSets};

pub use bodies::Body;
pub use contact::Contact;
pub(crate) use geometry::unit;
pub use geometry::{EdgeCurve, FaceSurface};
pub use measures::Measures;
pub(crate) use trimmed::TrimmedFace;
#[cfg(test)]
pub(crate) use trimmed::met_by_distance;

/// An edge between two vertices (or from one back to it).
#[derive(Debug, Clone, PartialEq)]
pub struct Edge {
    /// Curve that carries the edge.
    pub curve: EdgeCurve,
    /// Parameters of the curve at the ends, ascending.
    pub range: [f64; 2],
    /// Index of the vertex at the first parameter.
    pub start: usize,
    /// Index of the vertex at the second parameter.
    pub end: usize,
}

/// An oriented use of an edge by a loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Coedge {
    /// Index of the edge.
    pub edge: usize,
    /// True if the loop runs in the direction of the curve.
    pub forward: bool,
}

/// A part of a surface that is bounded by loops.
#[derive(Debug, Clone, PartialEq)]
pub struct Face {
    /// Surface that carries the face.
    pub surface: FaceSurface,
    /// True if the normal of the surface points out of the solid.
    pub outward: bool,
    /// Boundary loops. Seen from outside, the face lies to their left. Loops around a cylinder come in pairs;
    /// on other surfaces the first loop is the outer one.
    pub loops: Vec<Vec<Coedge>>,
}

impl Face {
    /// True if the face covers its complete sphere or torus. Each of its edges is then a seam, which the face
    /// uses twice.
    #[must_use]
    pub fn is_untrimmed(&self) -> bool {
        // A sphere or torus without loops counts as untrimmed, too.
        let edges: Vec<usize> = self.loops.iter().flatten().map(|c| c.edge).collect();
        let is_closed = matches!(self.surface, FaceSurface::Sphere { .. } | FaceSurface::Torus { .. });
        is_closed && edges.iter().all(|e| edges.iter().filter(|f| *f == e).count() == 2)
    }
}

/// A solid given by its boundary.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Solid {
    /// Points where edges meet.
    pub vertices: Vec<DVec3>,
    /// Edges between them, each used by two loops.
    pub edges: Vec<Edge>,
    /// Faces.
    pub faces: Vec<Face>,
}

impl Solid {
    /// Indices of the start and end vertex of a coedge.
    #[must_use]
    pub fn ends(&self, coedge: Coedge) -> [usize; 2] {
        let edge = &self.edges[coedge.edge];
        match coedge.forward {
            true => [edge.start, edge.end],
            false => [edge.end, edge.start],
        }
    }

    /// The solid with all lengths multiplied by a factor > 0.
    #[must_use]
    pub(crate) fn scaled(&self, factor: f64) -> Self {
        let mut solid = self.clone();
        let at = |p: &mut DVec3| *p *= factor;
        solid.vertices.iter_mut().for_each(at);
        for edge in &mut solid.edges {
            match &mut edge.curve {
                EdgeCurve::Line { origin, .. } => {
                    // The direction stays a unit vector, so the parameter is a length. Other parameters are
                    // angles or counts.
                    at(origin);
                    edge.range = edge.range.map(|t| factor * t);
                }
                EdgeCurve::Ellipse { center, a, b } => [center, a, b].into_iter().for_each(at),
                EdgeCurve::Spline { points, derivatives } => {
                    points.iter_mut().chain(derivatives).for_each(at)
                }
            }
        }
        for face in &mut solid.faces {
            match &mut face.surface {
                FaceSurface::Plane { origin, .. } => at(origin),
                FaceSurface::Cylinder { origin, radius, .. } | FaceSurface::Cone { origin, radius, .. } => {
                    at(origin);
                    *radius *= factor;
                }
                FaceSurface::Sphere { center, radius, .. } => {
                    at(center);
                    *radius *= factor;
                }
                FaceSurface::Torus { center, major, minor, .. } => {
                    at(center);
                    *major *= factor;
                    *minor *= factor;
                }
            }
        }
        solid
    }

    /// Number of faces on planes, cylinders, cones, spheres and tori.
    #[must_use]
    pub fn faces_by_kind(&self) -> [usize; 5] {
        let mut count = [0; 5];
        for face in &self.faces {
            count[match face.surface {
                FaceSurface::Plane { .. } => 0,
                FaceSurface::Cylinder { .. } => 1,
                FaceSurface::Cone { .. } => 2,
                FaceSurface::Sphere { .. } => 3,
                FaceSurface::Torus { .. } => 4,
            }] += 1;
        }
        count
    }

    /// Sets of faces that are connected by edges, as ascending indices.
    #[must_use]
    pub fn shells(&self) -> Vec<Vec<usize>> {
        let mut faces_of: Vec<Vec<usize>> = vec![Vec::new(); self.edges.len()];
        for (index, face) in self.faces.iter().enumerate() {
            for coedge in face.loops.iter().flatten() {
                faces_of[coedge.edge].push(index);
            }
        }
        // Connected by edges only: parts that share just a vertex are separate shells.
        let mut shell_of = vec![usize::MAX; self.faces.len()];
        let mut shells: Vec<Vec<usize>> = Vec::new();
        for first in 0..self.faces.len() {
            if shell_of[first] != usize::MAX {
                continue;
            }
            let mut open = vec![first];
            shell_of[first] = shells.len();
            let mut shell = Vec::new();
            while let Some(face) = open.pop() {
                shell.push(face);
                for coedge in self.faces[face].loops.iter().flatten() {
                    for &next in &faces_of[coedge.edge] {
                        if shell_of[next] == usize::MAX {
                            shell_of[next] = shells.len();
                            open.push(next);
                        }
                    }
                }
            }
            shell.sort_unstable();
            shells.push(shell);
        }
        shells
    }

    /// Adds a complete sphere or torus as a face, with seams where its parameters begin: a meridian of a
    /// sphere, both circles of a torus.
    ///
    /// A face needs a loop in STEP and in Euler's formula; seams make one.
    pub(crate) fn add_untrimmed(&mut self, surface: FaceSurface, outward: bool) {
        use std::f64::consts::{FRAC_PI_2, TAU};
        let arc = |center: DVec3, p: DVec3, q: DVec3| {
            let [a, b] = [p, q].map(|p| p - center);
            EdgeCurve::Ellipse { center, a, b }
        };
        let mut add = |curve: EdgeCurve, range: [f64; 2], ends: [usize; 2]| {
            self.edges.push(Edge { curve, range, start: ends[0], end: ends[1] });
            self.edges.len() - 1
        };
        let first = self.vertices.len();
        let at = |u: f64, v: f64| surface.point([u, v]);
        let edges = match surface {
            FaceSurface::Sphere { center, .. } => {
                self.vertices.extend([at(0.0, -FRAC_PI_2), at(0.0, FRAC_PI_2)]);
                let meridian = arc(center, at(0.0, 0.0), at(0.0, FRAC_PI_2));
                let edge = add(meridian, [-FRAC_PI_2, FRAC_PI_2], [first, first + 1]);
                vec![(edge, true), (edge, false)]
            }
            FaceSurface::Torus { center, x, major, .. } => {
                self.vertices.push(at(0.0, 0.0));
                let around = arc(center, at(0.0, 0.0), at(FRAC_PI_2, 0.0));
                let tube = arc(center + major * x, at(0.0, 0.0), at(0.0, FRAC_PI_2));
                let ends = [first, first];
                let (u, v) = (add(around, [0.0, TAU], ends), add(tube, [0.0, TAU], ends));
                // The face is left of the loop, seen from outside. A normal that points inwards reverses it.
                match outward {
                    true => vec![(u, true), (v, true), (u, false), (v, false)],
                    false => vec![(v, true), (u, true), (v, false), (u, false)],
                }
            }
            _ => return,
        };
        let ring = edges.into_iter().map(|(edge, forward)| Coedge { edge, forward });
        self.faces.push(Face { surface, outward, loops: vec![ring.collect()] });
    }

    /// Removes edges that no loop uses.
    pub(crate) fn drop_unused_edges(&mut self) {
        let mut new_of: Vec<Option<usize>> = vec![None; self.edges.len()];
        let mut edges = Vec::new();
        for coedge in self.faces.iter_mut().flat_map(|f| &mut f.loops).flatten() {
            let new = *new_of[coedge.edge].get_or_insert_with(|| {
                edges.push(self.edges[coedge.edge].clone());
                edges.len() - 1
            });
            coedge.edge = new;
        }
        self.edges = edges;
    }

    /// Adds the faces of another solid, with edges and vertices of their own.
    pub(crate) fn append(&mut self, mut other: Self) {
        let [vertices, edges] = [self.vertices.len(), self.edges.len()];
        self.vertices.append(&mut other.vertices);
        self.edges.extend(other.edges.into_iter().map(|e| Edge {
            start: e.start + vertices,
            end: e.end + vertices,
            ..e
        }));
        for coedge in other.faces.iter_mut().flat_map(|f| &mut f.loops).flatten() {
            coedge.edge += edges;
        }
        self.faces.append(&mut other.faces);
    }

    /// Gives each fan of faces around a point its own vertex.
    ///
    /// Parts of the boundary that only touch then share no vertex, which keeps the topology manifold.
    pub(crate) fn part_vertices(&mut self) {
        // Sets of the ends of edges (2 for each edge). Each corner of a loop joins two of them; those that
        // stay apart although they are at one vertex belong to different fans.
        let mut fans = DisjointSets::new(2 * self.edges.len());
        for ring in self.faces.iter().flat_map(|f| &f.loops) {
            for (k, coedge) in ring.iter().enumerate() {
                let next = ring[(k + 1) % ring.len()];
                let end = 2 * coedge.edge + usize::from(coedge.forward);
                let start = 2 * next.edge + usize::from(!next.forward);
                fans.join(end as u32, start as u32);
            }
        }
        // New vertices are numbered in the order of edges, so the result does not depend on the union's
        // order.
        let mut vertices = Vec::new();
        let mut vertex_of = std::collections::BTreeMap::new();
        for index in 0..self.edges.len() {
            for end in 0..2 {
                let edge = &mut self.edges[index];
                let old = if end == 0 { edge.start } else { edge.end };
                let new = *vertex_of.entry(fans.root((2 * index + end) as u32)).or_insert_with(|| {
                    vertices.push(self.vertices[old]);
                    vertices.len() - 1
                });
                *(if end == 0 { &mut edge.start } else { &mut edge.end }) = new;
            }
        }
        self.vertices = vertices;
    }
}
