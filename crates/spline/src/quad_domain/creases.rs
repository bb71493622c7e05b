//! Creases: edges across which the surface is continuous and its normal may jump.
//!
//! Input: edges of a mesh, and vertices that are marked as corners. Output: for each vertex its rule, and the
//! fan of quads between creases to which a corner of a quad belongs.
//!
//! | creases at a vertex | rule |
//! |---|---|
//! | none | smooth |
//! | one | dart: the crease ends, and the normal is continuous at the vertex |
//! | two | their curve passes smoothly, unless the vertex is marked or one side has a single quad |
//! | three, four quads, not marked | the curve beside the two quads passes; the third crease ends on it |
//! | others | corner: the surface has its control vertex, and all curves end there |
//!
//! Where a crease reaches a border, it continues on the edge outside of it.
//!
//! # References
//! Hoppe and others, *Piecewise smooth surface reconstruction*, SIGGRAPH 1994 (rules of vertices).
//! Biermann, Levin, Zorin, *Piecewise smooth subdivision surfaces with normal control*, SIGGRAPH 2000
//! (sectors).

use super::extraordinary::{FanKind, FanShape};
use super::half_edges::{HalfEdges, previous};
use super::{QuadDomain, invalid};
use planish_estimate::Result;
use std::collections::HashMap;

/// How the surface is formed at a vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum VertexRule {
    Smooth,
    Dart,
    /// A curve passes: the half edges from the vertex along it.
    Through([u32; 2]),
    Corner,
}

/// The creases of a domain.
#[derive(Debug, Clone, Default)]
pub(super) struct Creases {
    /// Vertices of the given edges, the smaller one first, in ascending order.
    pub(super) given: Vec<[u32; 2]>,
    /// Marked vertices, in ascending order.
    pub(super) corners: Vec<u32>,
    /// For each edge number, true for creases, those outside of borders included. Empty without creases.
    is_crease: Vec<bool>,
    /// The rules of vertices on creases.
    rules: HashMap<u32, VertexRule>,
}

/// A fan of quads at a corner with more than 180° between its creases.
#[derive(Debug, Clone, PartialEq)]
pub struct ConcaveFan {
    /// The corner.
    pub corner: u32,
    /// The other ends of its edges, counter-clockwise from one crease to the other.
    pub ends: Vec<u32>,
    /// For each edge between these, its direction as a sum of those of both creases: the share of each.
    pub shares: Vec<[f64; 2]>,
}

/// The fan of quads between creases to which a corner of a quad belongs.
pub(super) struct CornerFan {
    pub(super) shape: FanShape,
    /// The half edge from the vertex at which the fan starts.
    pub(super) first: u32,
    /// Number of the corner's quad in the fan.
    pub(super) cell: usize,
}

impl Creases {
    /// # Errors
    /// `Input` for edges that are none of the mesh or lie on a border, and for corners without two creases.
    pub(super) fn new(domain: &QuadDomain, edges: &[[u32; 2]], corners: &[u32]) -> Result<Self> {
        let mesh = domain.edges();
        let mut given: Vec<[u32; 2]> = edges.iter().map(|&[a, b]| [a.min(b), a.max(b)]).collect();
        given.sort_unstable();
        given.dedup();
        let mut corners = corners.to_vec();
        corners.sort_unstable();
        corners.dedup();
        let mut is_crease = vec![false; if given.is_empty() { 0 } else { mesh.of_edges().len() }];
        let is_outside = |h: u32| h / 4 >= domain.cells as u32;
        let is_on_border = |v: u32| mesh.around(v).any(is_outside);
        for &[a, b] in &given {
            let found = ((a as usize) < domain.inner_vertices)
                .then(|| mesh.around(a).find(|&h| mesh.end(h) == b))
                .flatten()
                .filter(|_| (b as usize) < domain.inner_vertices)
                .ok_or_else(|| {
                    invalid(format_args!("the crease from vertex {a} to {b} is no edge of a quad"))
                })?;
            if mesh.opposite(found).is_none_or(is_outside) || is_outside(found) {
                return Err(invalid(format_args!("the crease from vertex {a} to {b} lies on a border")));
            }
            is_crease[mesh.edge(found) as usize] = true;
            for (v, other) in [(a, b), (b, a)].into_iter().filter(|&(v, _)| is_on_border(v)) {
                let around: Vec<u32> = mesh.around(v).collect();
                let Some(k) = around.iter().position(|&h| mesh.end(h) == other).filter(|_| around.len() == 4)
                else {
                    return Err(invalid(format_args!("vertex {v} on a border has more than two quads")));
                };
                is_crease[mesh.edge(around[(k + 2) % 4]) as usize] = true;
            }
        }
        let mut made = Self { given, corners, is_crease, rules: HashMap::new() };
        for &v in made.given.clone().iter().flatten() {
            made.rules.insert(v, made.find_rule(mesh, v));
        }
        for &v in &made.corners {
            match made.rules.get(&v) {
                None | Some(VertexRule::Dart) => {
                    return Err(invalid(format_args!(
                        "the corner at vertex {v} has not two creases or more"
                    )));
                }
                Some(_) if is_on_border(v) => {
                    return Err(invalid(format_args!("the corner at vertex {v} lies on a border")));
                }
                // Which of both sides has less than 180° is not known.
                Some(_) if made.halves(mesh, v).is_some_and(|[a, b]| a == b && a > 1) => {
                    return Err(invalid(format_args!(
                        "the corner at vertex {v} has as many quads on both sides of its creases; it needs \
                         fewer on the side with less than 180°"
                    )));
                }
                Some(_) => {}
            }
        }
        Ok(made)
    }

    fn find_rule(&self, mesh: &HalfEdges, v: u32) -> VertexRule {
        let around: Vec<u32> = mesh.around(v).collect();
        let n = around.len();
        let places: Vec<usize> = (0..n).filter(|&k| self.has(mesh, around[k])).collect();
        let is_marked = self.corners.binary_search(&v).is_ok();
        match places[..] {
            [_] => VertexRule::Dart,
            // A smooth curve around a single quad would leave it no angle.
            [a, b] if !is_marked && b - a > 1 && n + a - b > 1 => VertexRule::Through([around[a], around[b]]),
            [..] if !is_marked && n == 4 && places.len() == 3 => {
                let other = (0..n).find(|k| !places.contains(k)).unwrap_or_default();
                VertexRule::Through([around[(other + 3) % 4], around[(other + 1) % 4]])
            }
            _ => VertexRule::Corner,
        }
    }

    /// The numbers of quads on both sides of a vertex with two creases.
    fn halves(&self, mesh: &HalfEdges, v: u32) -> Option<[usize; 2]> {
        let on: Vec<bool> = mesh.around(v).map(|h| self.has(mesh, h)).collect();
        let first = on.iter().position(|&is_crease| is_crease)?;
        let second = first + 1 + on[first + 1..].iter().position(|&is_crease| is_crease)?;
        let is_last = !on[second + 1..].contains(&true);
        is_last.then_some([second - first, on.len() + first - second])
    }

    /// True for half edges on creases.
    pub(super) fn has(&self, mesh: &HalfEdges, h: u32) -> bool {
        self.is_crease.get(mesh.edge(h) as usize).copied().unwrap_or(false)
    }

    pub(super) fn rule(&self, vertex: u32) -> VertexRule {
        self.rules.get(&vertex).copied().unwrap_or(VertexRule::Smooth)
    }
}

/// A place on a crease.
pub(crate) struct CreasePlace {
    /// The cells around it, with the place in each.
    pub(crate) around: Vec<(u32, [f64; 2])>,
    /// The direction of the crease in the first of them; none at corners, and where creases meet.
    pub(crate) along: Option<[f64; 2]>,
}

/// Places of the corners of a cell, and directions of its sides.
const CORNERS: [[f64; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
const SIDES: [[f64; 2]; 4] = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]];

impl QuadDomain {
    /// The crease on which a place in a cell lies; none if it lies on none, or where a single crease ends.
    pub(crate) fn place_on_crease(&self, cell: u32, at: [f64; 2]) -> Option<CreasePlace> {
        if let Some(k) = CORNERS.iter().position(|corner| *corner == at) {
            return self.vertex_on_crease(self.cells()[cell as usize][k]);
        }
        let side = [at[1] == 0.0, at[0] == 1.0, at[1] == 1.0, at[0] == 0.0].iter().position(|on| *on)?;
        if !self.is_crease_side(cell, side as u32) {
            return None;
        }
        let across = self.across(cell, side as u32, at, 1.0).map(|(next, at, _)| (next, at));
        Some(CreasePlace {
            around: std::iter::once((cell, at)).chain(across).collect(),
            along: Some(SIDES[side]),
        })
    }

    fn vertex_on_crease(&self, vertex: u32) -> Option<CreasePlace> {
        let mesh = self.edges();
        let is_cell = |h: &u32| ((h / 4) as usize) < self.cells;
        let creases: Vec<u32> = mesh.around(vertex).filter(|&h| self.creases.has(mesh, h)).collect();
        // A crease that a quad beyond a border would follow runs along the cell on its other side.
        let first = creases.iter().copied().find(is_cell).or_else(|| mesh.around(vertex).find(is_cell))?;
        let along = match self.creases.rule(vertex) {
            VertexRule::Smooth | VertexRule::Dart => return None,
            VertexRule::Through(_) if creases.len() == 2 => Some(SIDES[(first % 4) as usize]),
            VertexRule::Through(_) | VertexRule::Corner => None,
        };
        let around = mesh.around_from(first).chain(mesh.around(vertex)).filter(is_cell);
        let mut found: Vec<(u32, [f64; 2])> = Vec::new();
        for (cell, at) in around.map(|h| (h / 4, CORNERS[(h % 4) as usize])) {
            if !found.contains(&(cell, at)) {
                found.push((cell, at));
            }
        }
        Some(CreasePlace { around: found, along })
    }

    /// The fan at the start of a half edge to which its quad belongs.
    pub(super) fn fan(&self, h: u32) -> CornerFan {
        let mesh = self.edges();
        let vertex = mesh.start(h);
        let kind = match self.creases.rule(vertex) {
            VertexRule::Smooth => {
                let shape = FanShape { quads: self.valence(vertex), kind: FanKind::Smooth };
                return CornerFan { shape, first: h, cell: 0 };
            }
            VertexRule::Dart => FanKind::Dart,
            VertexRule::Through(_) => FanKind::Through,
            VertexRule::Corner => FanKind::Convex,
        };
        let is_crease = |h: u32| self.creases.has(mesh, h);
        // The vertex has a crease, so both walks end.
        let clockwise = std::iter::successors(Some(h), |&h| mesh.clockwise(h));
        let cell = clockwise.clone().position(is_crease).unwrap_or_default();
        let first = clockwise.take(cell + 1).last().unwrap_or(h);
        let after = mesh.around_from(h).position(|h| is_crease(previous(h))).unwrap_or_default();
        let quads = cell + after + 1;
        let kind = match kind {
            FanKind::Convex if !self.is_convex(vertex, quads) => FanKind::Concave,
            kind => kind,
        };
        CornerFan { shape: FanShape { quads, kind }, first, cell }
    }

    /// The fans of three or more quads at corners whose cells are those of more than 180°.
    ///
    /// In these cells, the tangents between both creases follow from those of the creases. Pieces fold if
    /// edges have other directions.
    #[must_use]
    pub fn concave_fans(&self) -> Vec<ConcaveFan> {
        let mesh = self.edges();
        let corners = (0..self.inner_vertices as u32).filter(|&v| self.creases.rule(v) == VertexRule::Corner);
        let first = corners.flat_map(|v| mesh.around(v)).filter(|&h| self.creases.has(mesh, h));
        let fans = first.filter_map(|h| {
            let shape = self.fan(h).shape;
            let ends: Vec<u32> = mesh.around_from(h).take(shape.quads + 1).map(|h| mesh.end(h)).collect();
            (shape.kind == FanKind::Concave && shape.quads > 1 && ends.len() > shape.quads).then(|| {
                ConcaveFan {
                    corner: mesh.start(h),
                    shares: (1..shape.quads).map(|cell| shape.shares_of_creases(cell)).collect(),
                    ends,
                }
            })
        });
        fans.collect()
    }

    /// True if a fan at a corner has less than 180°. Of two fans, that is the one with fewer quads.
    fn is_convex(&self, corner: u32, quads: usize) -> bool {
        let mesh = self.edges();
        match mesh.around(corner).filter(|&h| self.creases.has(mesh, h)).count() {
            2 => 2 * quads <= self.valence(corner),
            _ => quads <= 2,
        }
    }

    /// True if the quad of a half edge has no uniform spline because of the vertex at its start.
    pub(super) fn is_special_corner(&self, h: u32) -> bool {
        (self.edges().start(h) as usize) < self.inner_vertices && !self.fan(h).shape.is_regular()
    }
}
