//! Reads faces of STEP files and the shells that contain them.
//!
//! **Input.** Items of a representation.
//!
//! **Output.** Shapes that share vertices and edges as the file does. A face that cannot be read is skipped
//! and reported.

use super::geometry::Geometry;
use super::syntax::Index;
use planish_estimate::{Error, Result};
use planish_solid::parametric::{
    ParametricCurve, ParametricEdge, ParametricFace, ParametricShape, ParametricSurface,
};
use std::collections::HashMap;

/// A shape and its unreadable faces.
#[derive(Debug, Clone, Default)]
pub(super) struct Read {
    pub(super) shape: ParametricShape,
    /// Names of unreadable faces, each with the reason.
    pub(super) unreadable: Vec<(String, String)>,
}

/// Builds a shape from faces.
pub(super) struct Builder<'b, 'a> {
    geometry: Geometry<'b, 'a>,
    read: Read,
    vertex_of: HashMap<u64, usize>,
    edge_of: HashMap<u64, usize>,
    /// Straight edges of polygonal loops, by their vertices.
    side_of: HashMap<[usize; 2], usize>,
    surface_of: HashMap<u64, ParametricSurface>,
}

/// Maximum nesting of shells; finds cycles.
const MAX_DEPTH: usize = 8;

impl<'b, 'a> Builder<'b, 'a> {
    pub(super) fn new(geometry: Geometry<'b, 'a>) -> Self {
        Self {
            geometry,
            read: Read::default(),
            vertex_of: HashMap::new(),
            edge_of: HashMap::new(),
            side_of: HashMap::new(),
            surface_of: HashMap::new(),
        }
    }

    pub(super) fn finish(self) -> Read {
        self.read
    }

    pub(super) fn is_empty(&self) -> bool {
        self.read.shape.faces.is_empty() && self.read.unreadable.is_empty()
    }

    fn index(&self) -> &'b Index<'a> {
        self.geometry.index
    }

    /// Adds the faces of an item: a body, shells, faces or a bare surface. False for another kind of item.
    ///
    /// # Errors
    /// `Input` for invalid bodies and shells. Invalid faces are skipped and reported.
    pub(super) fn add_item(&mut self, id: u64) -> Result<bool> {
        self.add(id, true, 0)
    }

    fn add(&mut self, id: u64, forward: bool, depth: usize) -> Result<bool> {
        if depth > MAX_DEPTH {
            return Err(Error::input(format!("#{id}: expected a tree of shells, found a cycle")));
        }
        let records = self.index().records(id)?;
        let [record] = records.as_slice() else {
            let is_surface = records.iter().any(|r| r.keyword == "B_SPLINE_SURFACE");
            // A rational B-spline surface is a complex instance.
            if is_surface {
                self.add_bare(id);
            }
            return Ok(is_surface);
        };
        let entity = self.index().entity(id)?;
        match record.keyword {
            "MANIFOLD_SOLID_BREP" | "FACETED_BREP" => self.add(entity.reference(1)?, forward, depth + 1),
            "BREP_WITH_VOIDS" => {
                self.add(entity.reference(1)?, forward, depth + 1)?;
                self.add_all(&entity.references(2)?, forward, depth)
            }
            "ORIENTED_CLOSED_SHELL" | "ORIENTED_OPEN_SHELL" => {
                let same = entity.truth(3)?;
                // Two reversals cancel.
                self.add(entity.reference(2)?, forward == same, depth + 1)
            }
            "CLOSED_SHELL" | "OPEN_SHELL" | "CONNECTED_FACE_SET" => {
                for face in entity.references(1)? {
                    self.add_face(face, forward);
                }
                Ok(true)
            }
            "SHELL_BASED_SURFACE_MODEL" | "FACE_BASED_SURFACE_MODEL" | "GEOMETRIC_SET" => {
                self.add_all(&entity.references(1)?, forward, depth)
            }
            "ADVANCED_FACE" | "FACE_SURFACE" | "ORIENTED_FACE" => {
                self.add_face(id, forward);
                Ok(true)
            }
            // After the faces, because `FACE_SURFACE` has this ending, too.
            keyword if keyword.ends_with("_SURFACE") || keyword.starts_with("B_SPLINE_SURFACE") => {
                self.add_bare(id);
                Ok(true)
            }
            _ => Ok(false),
        }
    }

    fn add_all(&mut self, ids: &[u64], forward: bool, depth: usize) -> Result<bool> {
        let mut is_any = false;
        for id in ids {
            is_any |= self.add(*id, forward, depth + 1)?;
        }
        Ok(is_any)
    }

    /// Adds a whole surface without a face that bounds it.
    fn add_bare(&mut self, id: u64) {
        let name = format!("#{id}");
        match self.geometry.surface(id) {
            Ok(surface) => self.read.shape.faces.push(ParametricFace {
                name,
                surface,
                is_outward: true,
                loops: Vec::new(),
            }),
            Err(e) => self.read.unreadable.push((name, e.to_string())),
        }
    }

    fn add_face(&mut self, id: u64, forward: bool) {
        match self.face(id, forward, 0) {
            Ok(face) => self.read.shape.faces.push(face),
            Err(e) => self.read.unreadable.push((format!("#{id}"), e.to_string())),
        }
    }

    fn face(&mut self, id: u64, forward: bool, depth: usize) -> Result<ParametricFace> {
        let entity = self.index().entity(id)?;
        if entity.record.keyword == "ORIENTED_FACE" && depth < MAX_DEPTH {
            let same = entity.truth(4)?;
            return self.face(entity.reference(3)?, forward == same, depth + 1);
        }
        if !matches!(entity.record.keyword, "ADVANCED_FACE" | "FACE_SURFACE") {
            return Err(entity.wrong("expected ADVANCED_FACE or FACE_SURFACE"));
        }
        let surface_id = entity.reference(2)?;
        // Faces may share a surface, for example the halves of a cylinder.
        let surface = match self.surface_of.get(&surface_id) {
            Some(surface) => surface.clone(),
            None => {
                let surface = self.geometry.surface(surface_id)?;
                self.surface_of.insert(surface_id, surface.clone());
                surface
            }
        };
        let same_sense = entity.truth(3)?;
        let mut loops = Vec::new();
        for bound in entity.references(1)? {
            let bound = self.index().entity(bound)?;
            if !matches!(bound.record.keyword, "FACE_BOUND" | "FACE_OUTER_BOUND") {
                return Err(bound.wrong("expected FACE_BOUND or FACE_OUTER_BOUND"));
            }
            // `FACE_BOUND` may reverse its loop, and an enclosing oriented shell the whole face.
            let is_as_written = bound.truth(2)?;
            let mut ring = self.ring(bound.reference(1)?)?;
            // Loops run counter-clockwise about the normal of the face, so reversing the face reverses them.
            if is_as_written != forward {
                ring.reverse();
                for (_, forward) in &mut ring {
                    *forward = !*forward;
                }
            }
            if !ring.is_empty() {
                loops.push(ring);
            }
        }
        Ok(ParametricFace { name: format!("#{id}"), surface, is_outward: same_sense == forward, loops })
    }

    /// Edges of a loop; none for a loop that consists of a vertex.
    fn ring(&mut self, id: u64) -> Result<Vec<(usize, bool)>> {
        let entity = self.index().entity(id)?;
        match entity.record.keyword {
            "EDGE_LOOP" => {
                let mut ring = Vec::new();
                for oriented in entity.references(1)? {
                    let oriented = self.index().entity_of(oriented, "ORIENTED_EDGE")?;
                    // Attributes 1 and 2, the ends, are derived from the edge and have no value in the file.
                    ring.push((self.edge(oriented.reference(3)?)?, oriented.truth(4)?));
                }
                Ok(ring)
            }
            // A vertex bounds nothing: the surface is closed there, as at the tip of a cone.
            "VERTEX_LOOP" => Ok(Vec::new()),
            "POLY_LOOP" => {
                let points = entity.references(1)?;
                let vertices: Result<Vec<usize>> = points.into_iter().map(|p| self.corner(p)).collect();
                let vertices = vertices?;
                let n = vertices.len();
                Ok((0..n).map(|k| self.side([vertices[k], vertices[(k + 1) % n]])).collect())
            }
            _ => Err(entity.wrong("expected EDGE_LOOP, POLY_LOOP or VERTEX_LOOP")),
        }
    }

    fn edge(&mut self, id: u64) -> Result<usize> {
        if let Some(edge) = self.edge_of.get(&id) {
            return Ok(*edge);
        }
        let entity = self.index().entity_of(id, "EDGE_CURVE")?;
        // An edge is added once and shared by both faces, so that their triangles meet without gaps.
        let ends = [self.vertex(entity.reference(1)?)?, self.vertex(entity.reference(2)?)?];
        self.read.shape.edges.push(ParametricEdge {
            curve: self.geometry.curve(entity.reference(3)?)?,
            ends,
            is_forward: entity.truth(4)?,
        });
        let edge = self.read.shape.edges.len() - 1;
        self.edge_of.insert(id, edge);
        Ok(edge)
    }

    fn vertex(&mut self, id: u64) -> Result<usize> {
        if let Some(vertex) = self.vertex_of.get(&id) {
            return Ok(*vertex);
        }
        let entity = self.index().entity_of(id, "VERTEX_POINT")?;
        let vertex = self.corner(entity.reference(1)?)?;
        self.vertex_of.insert(id, vertex);
        Ok(vertex)
    }

    /// Vertex of a point. One map serves points and vertices, because numbers of instances are unique.
    fn corner(&mut self, point: u64) -> Result<usize> {
        if let Some(vertex) = self.vertex_of.get(&point) {
            return Ok(*vertex);
        }
        self.read.shape.vertices.push(self.geometry.point(point)?);
        let vertex = self.read.shape.vertices.len() - 1;
        self.vertex_of.insert(point, vertex);
        Ok(vertex)
    }

    /// Straight edge between two vertices, and whether it starts at the first.
    fn side(&mut self, [a, b]: [usize; 2]) -> (usize, bool) {
        // Both faces find the same side, whatever their direction.
        let ends = [a.min(b), a.max(b)];
        let shape = &mut self.read.shape;
        let edge = *self.side_of.entry(ends).or_insert_with(|| {
            let [from, to] = ends.map(|v| shape.vertices[v]);
            shape.edges.push(ParametricEdge {
                curve: ParametricCurve::Line { origin: from, along: to - from },
                ends,
                is_forward: true,
            });
            shape.edges.len() - 1
        });
        (edge, a <= b)
    }
}
