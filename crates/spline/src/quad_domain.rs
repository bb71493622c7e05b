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
//! Edges can be creases: the surface is continuous across them, its normal is not. Each side sees a row of
//! vertices beyond the crease that is not free: `2 · (vertex on the crease) − (vertex inside)`, so the second
//! derivative across the crease is zero at it. See decision 0115.
//!
//! | module | purpose |
//! |---|---|
//! | half_edges | neighbours across edges and around vertices, and defects of a mesh |
//! | creases | edges across which normals jump, and rules of the vertices on them |
//! | level | cells and vertices of the levels |
//! | extraordinary | extraction around a vertex that has not four quads, or where creases end or meet |
//! | division | division of all quads by the rules of Catmull and Clark, with creases |
//!
//! Not guaranteed: positions. A domain has no geometry, and any vertices may be its control vertices.

mod creases;
mod division;
mod extraordinary;
mod half_edges;
mod level;
#[doc(hidden)]
pub mod test_meshes;
#[cfg(test)]
mod tests;

pub use creases::ConcaveFan;
use creases::Creases;
pub use division::Division;
pub(crate) use extraordinary::{PIECES, leaf_weights};
use half_edges::HalfEdges;
pub(crate) use level::{Level, LevelCell, Neighbourhood, Weighted, from_edge, to_edge};
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
    creases: Creases,
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
        Ok(Self { edges, cells: cells.len(), inner_vertices, borders, creases: Creases::default() })
    }

    /// A domain of which some edges are creases: across them, the surface is continuous and its normal may
    /// jump. Of each crease the two vertices are given, in any order.
    ///
    /// The curve of a crease is the cubic spline of the vertices on it. It passes smoothly through a vertex
    /// with two creases, unless the vertex is one of the `corners` or a single quad lies on one side. A
    /// vertex where more creases meet is a corner too, except where one of three ends on the curve of the
    /// other two: with four quads of which two lie on the same side. The surface passes through the control
    /// vertices of corners. At a vertex with one crease, the jump of the normal fades to zero.
    ///
    /// Between creases at a corner, one or two quads have less than 180° and more quads have more. Of both
    /// sides of two creases, the one with fewer quads has less than 180°.
    ///
    /// # Errors
    /// As for [`QuadDomain::new`]. `Input` with the vertices of a crease that is no edge of a quad or lies on
    /// a border, and with the number of a corner that has not two creases, lies on a border,
    /// or has as many quads on both sides of two creases.
    ///
    /// # Examples
    /// A cube with sharp edges. Its surface is that of the cube:
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::{Hierarchy, QuadDomain, Surface};
    /// let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    /// let edges = [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6],
    ///     [3, 7]];
    /// let cube = QuadDomain::with_creases(&quads, &edges, &[])?;
    /// assert!(cube.is_crease([1, 0]) && cube.creases().len() == 12);
    /// let space = Hierarchy::over(cube.into())?;
    /// let corners = (0..8).map(|k| DVec3::new((k & 1).into(), (k >> 1 & 1).into(), (k >> 2).into()));
    /// let surface = Surface::new(space.into(), corners.collect())?;
    /// assert!(surface.point(1.5, 0.25).distance(DVec3::new(0.5, 0.25, 1.0)) < 1e-12);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    pub fn with_creases(cells: &[[u32; 4]], creases: &[[u32; 2]], corners: &[u32]) -> Result<Self> {
        let mut made = Self::new(cells)?;
        made.creases = Creases::new(&made, creases, corners)?;
        Ok(made)
    }

    /// The cells: corners of each, counter-clockwise.
    #[must_use]
    pub fn cells(&self) -> &[[u32; 4]] {
        &self.edges.quads()[..self.cells]
    }

    /// The creases: both vertices of each, the smaller number first, in ascending order.
    #[must_use]
    pub fn creases(&self) -> &[[u32; 2]] {
        &self.creases.given
    }

    /// The vertices that were marked as corners, in ascending order.
    #[must_use]
    pub fn corners(&self) -> &[u32] {
        &self.creases.corners
    }

    /// True if the edge between two vertices is a crease.
    #[must_use]
    pub fn is_crease(&self, [a, b]: [u32; 2]) -> bool {
        self.creases.given.binary_search(&[a.min(b), a.max(b)]).is_ok()
    }

    /// True if a side of a cell lies on a crease.
    pub(crate) fn is_crease_side(&self, quad: u32, side: u32) -> bool {
        self.creases.has(&self.edges, 4 * quad + side)
    }

    /// True if the spline over a cell is not uniform because of one of its corners (0 to 3): there lie other
    /// than four quads, or creases end or meet. A cell at such a corner has several leaves.
    #[must_use]
    pub fn is_extraordinary_corner(&self, cell: usize, corner: usize) -> bool {
        self.is_special_corner((4 * cell + corner) as u32)
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
            let mut special = (0..4).filter(|&k| self.is_extraordinary_corner(q, k)).map(|k| quad[k]);
            if let (Some(a), Some(b)) = (special.next(), special.next()) {
                let cause = if self.creases.given.is_empty() {
                    "have not four quads each"
                } else {
                    "both have no uniform spline: other than four quads, or ends of creases"
                };
                return Err(invalid(format_args!(
                    "vertices {a} and {b} of quad {q} {cause}; divide the domain once"
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
