//! Leaves of a domain, and their coefficients from control vertices.

use super::extraordinary::{PIECES, PLACES, leaf_weights_around};
use super::half_edges::next;
use super::{QuadDomain, invalid};
use crate::surface::leaf_weights;
use planish_core::DVec3;
use planish_estimate::Result;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A square on which the spline is one bicubic piece.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuadLeaf {
    /// The cell to which it belongs.
    pub cell: u32,
    /// Parameters of its lower left corner.
    pub corner: [f64; 2],
    /// Its side; that of a cell is 1.
    pub side: f64,
}

/// The cubic splines over a domain: for each leaf, the sixteen B-spline coefficients as a linear map of the
/// control vertices.
///
/// Surfaces have continuous normals everywhere, and continuous curvature where all corners of the cells have
/// four quads. Weights sum to one. They are not negative there, and at least −0.0015 elsewhere.
///
/// # Examples
/// The faces of a cube, divided once, with the control vertices on a sphere:
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{QuadDomain, QuadSpace};
/// use std::sync::Arc;
/// let cube = QuadDomain::new(&[
///     [0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5],
/// ])?;
/// let corner = |k: u32| DVec3::from_array([k % 2, k / 2 % 2, k / 4].map(f64::from));
/// let corners: Vec<DVec3> = (0..8).map(corner).collect();
/// let division = cube.divided()?;
/// let vertices: Vec<DVec3> =
///     division.apply(&corners).into_iter().map(|p| (p - DVec3::splat(0.5)).normalize_or_zero()).collect();
/// let space = QuadSpace::new(Arc::new(division.domain))?;
/// // Each of the 24 cells has a corner with three quads, so it has 16 leaves.
/// assert_eq!(space.leaves().len(), 24 * 16);
/// let radius = space.point(&vertices, 0, [0.5, 0.5]).length();
/// assert!((0.8..1.0).contains(&radius));
/// # Ok::<(), planish_spline::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct QuadSpace {
    domain: Arc<QuadDomain>,
    leaves: Vec<QuadLeaf>,
    offsets: Vec<u32>,
    nodes: Vec<u32>,
    weights: Vec<[f64; 16]>,
}

impl QuadSpace {
    /// The space over a domain.
    ///
    /// # Errors
    /// `Input` for a cell with several corners that have not four quads: divide the domain first.
    pub fn new(domain: Arc<QuadDomain>) -> Result<Self> {
        let mut made =
            Self { domain, leaves: Vec::new(), offsets: vec![0], nodes: Vec::new(), weights: Vec::new() };
        let domain = Arc::clone(&made.domain);
        let mut around: BTreeMap<usize, Vec<Vec<[f64; 16]>>> = BTreeMap::new();
        for (cell, quad) in (0..).zip(domain.cells()) {
            let mut special = (0..4).filter(|&k| domain.valence(quad[k as usize]) != 4);
            match (special.next(), special.next()) {
                (None, _) => made.add_regular(cell),
                (Some(corner), None) => {
                    let valence = domain.valence(quad[corner as usize]);
                    let weights = around.entry(valence).or_insert_with(|| leaf_weights_around(valence));
                    made.add_around(cell, corner, weights);
                }
                (Some(a), Some(b)) => {
                    let [a, b] = [a, b].map(|k| quad[k as usize]);
                    return Err(invalid(format_args!(
                        "vertices {a} and {b} of quad {cell} have not four quads each; divide the domain once"
                    )));
                }
            }
        }
        Ok(made)
    }

    /// The domain.
    #[must_use]
    pub fn domain(&self) -> &Arc<QuadDomain> {
        &self.domain
    }

    /// The leaves, ordered by cells.
    #[must_use]
    pub fn leaves(&self) -> &[QuadLeaf] {
        &self.leaves
    }

    /// The control vertices of a leaf, and their weights in its sixteen coefficients, `4 · row + column`.
    #[must_use]
    pub fn extraction(&self, leaf: usize) -> (&[u32], &[[f64; 16]]) {
        let range = self.offsets[leaf] as usize..self.offsets[leaf + 1] as usize;
        (&self.nodes[range.clone()], &self.weights[range])
    }

    /// The coefficients of a leaf.
    #[must_use]
    pub fn leaf_coefficients(&self, vertices: &[DVec3], leaf: usize) -> [DVec3; 16] {
        let (nodes, weights) = self.extraction(leaf);
        let mut coefficients = [DVec3::ZERO; 16];
        for (&node, own) in nodes.iter().zip(weights) {
            for (c, w) in coefficients.iter_mut().zip(own) {
                *c += *w * vertices[node as usize];
            }
        }
        coefficients
    }

    /// The leaf over parameters of a cell, and the place on it, in `[0, 1]²`.
    #[must_use]
    pub fn locate(&self, cell: u32, [u, v]: [f64; 2]) -> (usize, [f64; 2]) {
        let first = self.leaves.partition_point(|leaf| leaf.cell < cell);
        let side = self.leaves[first].side;
        let count = (1.0 / side).round();
        let [column, row] = [u, v].map(|x| (x * count).floor().clamp(0.0, count - 1.0));
        let leaf = first + (row * count + column) as usize;
        (leaf, [u * count - column, v * count - row])
    }

    /// A point of the surface.
    #[must_use]
    pub fn point(&self, vertices: &[DVec3], cell: u32, at: [f64; 2]) -> DVec3 {
        let (leaf, [s, t]) = self.locate(cell, at);
        let coefficients = self.leaf_coefficients(vertices, leaf);
        coefficients.iter().zip(leaf_weights(s, t)).map(|(c, w)| w * *c).sum()
    }

    fn add_leaf(&mut self, leaf: QuadLeaf, entries: impl Iterator<Item = (u32, [f64; 16])>) {
        for (node, weights) in entries.filter(|(_, weights)| weights.iter().any(|&w| w != 0.0)) {
            self.nodes.push(node);
            self.weights.push(weights);
        }
        self.leaves.push(leaf);
        self.offsets.push(self.nodes.len() as u32);
    }

    /// A cell whose corners have four quads each: its coefficients are the 4 × 4 vertices around it.
    fn add_regular(&mut self, cell: u32) {
        let domain = Arc::clone(&self.domain);
        let vertices = regular_neighbourhood(&domain, 4 * cell);
        let one = |k: usize| std::array::from_fn(|j| f64::from(u8::from(j == k)));
        let entries = vertices.into_iter().enumerate().map(|(k, vertex)| (vertex, one(k)));
        self.add_leaf(QuadLeaf { cell, corner: [0.0; 2], side: 1.0 }, entries);
    }

    /// A cell with one corner that has not four quads.
    fn add_around(&mut self, cell: u32, corner: u32, weights: &[Vec<[f64; 16]>]) {
        let domain = Arc::clone(&self.domain);
        let nodes = fan_vertices(&domain, 4 * cell + corner);
        let side = 1.0 / PIECES as f64;
        for row in 0..PIECES {
            for column in 0..PIECES {
                // The same leaf in the frame in which the corner is at (0, 0).
                let [s, t] = to_corner(corner, [column, row], PIECES - 1);
                let own = &weights[t * PIECES + s];
                let turned = own.iter().map(|w| {
                    std::array::from_fn(|k| {
                        let [s, t] = to_corner(corner, [k % 4, k / 4], 3);
                        w[4 * t + s]
                    })
                });
                let leaf = QuadLeaf { cell, corner: [column as f64 * side, row as f64 * side], side };
                self.add_leaf(leaf, nodes.iter().copied().zip(turned));
            }
        }
    }
}

/// Place `(u, v)` of a grid of `last + 1` in the frame that has `corner` at (0, 0).
fn to_corner(corner: u32, [u, v]: [usize; 2], last: usize) -> [usize; 2] {
    match corner {
        0 => [u, v],
        1 => [v, last - u],
        2 => [last - u, last - v],
        _ => [last - v, u],
    }
}

/// The 4 × 4 vertices around a cell, all corners of which have four quads: row by row, from the diagonal
/// neighbour of the start of half edge `h`.
fn regular_neighbourhood(domain: &QuadDomain, h: u32) -> [u32; 16] {
    let edges = domain.edges();
    let side = [h, next(h), next(next(h)), next(next(next(h)))];
    let corner = side.map(|h| edges.start(h));
    // Each vertex of a cell is inside of the mesh, so the neighbours exist.
    let start = side.map(|h| edges.beyond_start(h).unwrap_or_default());
    let end = side.map(|h| edges.beyond_end(h).unwrap_or_default());
    let diagonal = side.map(|h| edges.diagonal(h).unwrap_or_default());
    [
        diagonal[0],
        start[0],
        end[0],
        diagonal[1],
        end[3],
        corner[0],
        corner[1],
        start[1],
        start[3],
        corner[3],
        corner[2],
        end[1],
        diagonal[3],
        end[2],
        start[2],
        diagonal[2],
    ]
}

/// The control vertices of the cells around the start of half edge `h`, in the order of
/// [`leaf_weights_around`].
fn fan_vertices(domain: &QuadDomain, h: u32) -> Vec<u32> {
    let edges = domain.edges();
    let mut nodes = vec![edges.start(h)];
    let mut spoke = h;
    for _ in 0..domain.valence(edges.start(h)) {
        let (second, third) = (next(spoke), next(next(spoke)));
        let at = |place: [i8; 2]| match place {
            [1, 0] => edges.end(spoke),
            [1, 1] => edges.end(second),
            [2, 0] => edges.beyond_start(second).unwrap_or_default(),
            [2, 1] => edges.beyond_end(second).unwrap_or_default(),
            [2, 2] => edges.diagonal(third).unwrap_or_default(),
            _ => edges.beyond_start(third).unwrap_or_default(),
        };
        nodes.extend(PLACES.map(at));
        // The next spoke counter-clockwise is the other edge of this quad.
        spoke = edges.opposite(next(third)).unwrap_or(h);
    }
    nodes
}
