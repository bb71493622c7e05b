//! Parametric domains of any topology: manifold meshes of quads, and the cubic spline space over them.
//!
//! Input: quads that share edges, closed or with borders, of any genus, in one or several components. Output:
//! a [`QuadDomain`] with its neighbourhoods on all levels, for [`Hierarchy::over`](crate::Hierarchy::over).
//!
//! A quad is one cell; its corners are numbered counter-clockwise, `u` runs from corner 0 to 1 and `v` from 0
//! to 3. Outside of each border lies a ring of quads that are no cells. Their vertices are control vertices
//! beyond the border, as an open uniform spline has them. Where all corners of a cell have four quads, the
//! spline is the uniform bicubic one. See decision 0111 for the other cells.
//!
//! | module | purpose |
//! |---|---|
//! | half_edges | neighbours across edges and around vertices, and defects of a mesh |
//! | level | cells and vertices of the levels |
//! | extraordinary | extraction around a vertex that has not four quads |
//! | division | division of all quads by the rules of Catmull and Clark |
//!
//! Not guaranteed: positions. A domain has no geometry, and any vertices may be its control vertices.

mod division;
mod extraordinary;
mod half_edges;
mod level;
#[cfg(test)]
pub(crate) mod test_meshes;
#[cfg(test)]
mod tests;

pub use division::Division;
pub(crate) use extraordinary::{PIECES, VERTICES_PER_CELL, leaf_weights_around};
use half_edges::HalfEdges;
pub(crate) use level::{Level, LevelCell, Neighbourhood, to_edge};
use planish_core::DisjointSets;
use planish_estimate::{Error, Result};
use std::collections::HashMap;

/// A manifold mesh of quads as a parametric domain.
///
/// # Examples
/// The faces of a cube, each corner of which has three quads:
/// ```
/// use planish_spline::QuadDomain;
/// let cube = QuadDomain::new(&[
///     [0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5],
/// ])?;
/// assert_eq!((cube.components(), cube.borders(), cube.genus()), (1, 0, 0));
/// assert_eq!(cube.extraordinary_vertices().len(), 8);
/// # Ok::<(), planish_spline::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct QuadDomain {
    /// Cells first, then the quads outside of borders.
    edges: HalfEdges,
    cells: usize,
    /// Vertices of cells; those beyond borders follow.
    inner_vertices: usize,
    borders: usize,
}

impl QuadDomain {
    /// A domain from quads with counter-clockwise corners.
    ///
    /// # Errors
    /// `Input` with the number of a quad or vertex: a quad with a repeated corner, an edge with more than two
    /// quads or with two of opposite orientation, a vertex where several fans of quads meet, an unused
    /// vertex.
    pub fn new(cells: &[[u32; 4]]) -> Result<Self> {
        let inner = HalfEdges::new(cells.to_vec())?;
        let inner_vertices = inner.vertex_count();
        let mut quads = cells.to_vec();
        let borders = add_outer_quads(&inner, &mut quads);
        let edges = if borders == 0 { inner } else { HalfEdges::new(quads)? };
        Ok(Self { edges, cells: cells.len(), inner_vertices, borders })
    }

    /// The cells: corners of each, counter-clockwise.
    #[must_use]
    pub fn cells(&self) -> &[[u32; 4]] {
        &self.edges.quads()[..self.cells]
    }

    /// Number of control vertices, those beyond borders included.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.edges.vertex_count()
    }

    /// Number of vertices of cells. They come before those beyond borders.
    #[must_use]
    pub fn inner_vertex_count(&self) -> usize {
        self.inner_vertices
    }

    /// Number of quads around a vertex of a cell, those beyond borders included.
    #[must_use]
    pub fn valence(&self, vertex: u32) -> usize {
        self.edges.around(vertex).count()
    }

    /// Vertices of cells that have not four quads, in ascending order.
    #[must_use]
    pub fn extraordinary_vertices(&self) -> Vec<u32> {
        (0..self.inner_vertices as u32).filter(|&v| self.valence(v) != 4).collect()
    }

    /// The quad across a side of a quad, and which of its sides that is; none at a border. Side `k` runs from
    /// corner `k` to the next one.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::QuadDomain;
    /// let strip = QuadDomain::new(&[[0, 1, 4, 3], [4, 1, 2, 5]])?;
    /// assert_eq!(strip.neighbour(0, 1), Some((1, 0)));
    /// assert_eq!(strip.neighbour(0, 0), None);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn neighbour(&self, quad: u32, side: u32) -> Option<(u32, u32)> {
        let opposite = self.edges.opposite(4 * quad + side)?;
        ((opposite as usize) < 4 * self.cells).then_some((opposite / 4, opposite % 4))
    }

    /// Number of border loops.
    #[must_use]
    pub fn borders(&self) -> usize {
        self.borders
    }

    /// Number of connected components.
    #[must_use]
    pub fn components(&self) -> usize {
        let mut sets = DisjointSets::new(self.inner_vertices);
        let mut count = self.inner_vertices;
        for quad in self.cells() {
            count -= quad.windows(2).filter(|pair| sets.join(pair[0], pair[1])).count();
        }
        count
    }

    /// Sum of the genera of all components, with each border closed by a disc.
    #[must_use]
    pub fn genus(&self) -> usize {
        let inner_edges: usize =
            (0..4 * self.cells as u32).filter(|&h| self.edges.opposite(h).is_none_or(|o| o > h)).count();
        // χ = V − E + F, and each component has χ = 2 − 2 g − borders.
        let closed = (self.inner_vertices + self.cells + self.borders) as i64 - inner_edges as i64;
        ((2 * self.components() as i64 - closed) / 2).max(0) as usize
    }

    /// # Errors
    /// `Input` if cubic splines over the domain are not defined.
    pub(crate) fn check_spline(&self) -> Result<()> {
        for (q, quad) in self.cells().iter().enumerate() {
            let mut special = quad.iter().filter(|&&v| self.valence(v) != 4);
            if let (Some(a), Some(b)) = (special.next(), special.next()) {
                return Err(invalid(format_args!(
                    "vertices {a} and {b} of quad {q} have not four quads each; divide the domain once"
                )));
            }
        }
        self.check_borders()
    }

    /// # Errors
    /// `Input` for border vertices with more than two quads: no spline has vertices beyond the border there.
    fn check_borders(&self) -> Result<()> {
        let on_border = self.edges.quads()[self.cells..].iter().flatten();
        let mut crowded = on_border.filter(|&&v| (v as usize) < self.inner_vertices && self.valence(v) != 4);
        match crowded.next() {
            Some(v) => Err(invalid(format_args!("vertex {v} on a border has more than two quads"))),
            None => Ok(()),
        }
    }

    fn edges(&self) -> &HalfEdges {
        &self.edges
    }
}

/// Adds the quads outside of all borders, and returns the number of border loops.
///
/// A border vertex gets one vertex outside, and a corner that has a single quad three: with them each has
/// four quads, unless it had more than two.
fn add_outer_quads(inner: &HalfEdges, quads: &mut Vec<[u32; 4]>) -> usize {
    let borders: Vec<u32> = inner.border_edges().collect();
    if borders.is_empty() {
        return 0;
    }
    let mut next_vertex = inner.vertex_count() as u32;
    let mut take = || {
        next_vertex += 1;
        next_vertex - 1
    };
    // For each border vertex, its outer neighbours beside the border edge that ends and that begins there.
    let mut outside: HashMap<u32, [u32; 2]> = HashMap::new();
    for &h in &borders {
        let vertex = inner.start(h);
        let is_corner = inner.around(vertex).count() == 1;
        let first = take();
        if is_corner {
            let (second, diagonal) = (take(), take());
            outside.insert(vertex, [first, second]);
            quads.push([vertex, first, diagonal, second]);
        } else {
            outside.insert(vertex, [first, first]);
        }
    }
    for &h in &borders {
        let (a, b) = (inner.start(h), inner.end(h));
        quads.push([b, a, outside[&a][1], outside[&b][0]]);
    }
    // Each edge of a loop joins two of its vertices, except the last one.
    let mut sets = DisjointSets::new(inner.vertex_count());
    borders.iter().filter(|&&h| !sets.join(inner.start(h), inner.end(h))).count()
}

/// `Input` error of a mesh that is no domain.
fn invalid(text: impl std::fmt::Display) -> Error {
    Error::input(format!("the quads are no domain: {text}"))
}
