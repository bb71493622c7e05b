//! Neighbours in a mesh of quads.
//!
//! Half edge `4 q + k` runs from corner `k` of quad `q` to the next corner, with the quad on its left.

use super::invalid;
use planish_estimate::Result;
use std::collections::HashMap;

const NONE: u32 = u32::MAX;

/// Quads with the opposite of each half edge.
#[derive(Debug, Clone)]
pub(super) struct HalfEdges {
    quads: Vec<[u32; 4]>,
    opposite: Vec<u32>,
    /// The number of the edge of each half edge.
    edge: Vec<u32>,
    /// One half edge of each edge.
    of_edge: Vec<u32>,
    /// A half edge that starts at each vertex: of a border vertex the one that no other follows clockwise.
    first: Vec<u32>,
}

impl HalfEdges {
    /// # Errors
    /// `Input` if the quads are no manifold.
    pub(super) fn new(quads: Vec<[u32; 4]>) -> Result<Self> {
        let count = quads.iter().flatten().max().map_or(0, |&v| v as usize + 1);
        if quads.is_empty() || quads.len() >= (NONE / 4) as usize {
            return Err(invalid(format_args!("expected 1 to {} quads, found {}", NONE / 4 - 1, quads.len())));
        }
        let mut of_pair = HashMap::with_capacity(4 * quads.len());
        for (q, quad) in quads.iter().enumerate() {
            for k in 0..4 {
                if quad[k + 1..].contains(&quad[k]) {
                    return Err(invalid(format_args!("quad {q} has corner {} twice", quad[k])));
                }
                let (a, b) = (quad[k], quad[(k + 1) % 4]);
                if let Some(other) = of_pair.insert((a, b), (4 * q + k) as u32) {
                    let other = other / 4;
                    return Err(invalid(format_args!(
                        "quads {other} and {q} both have the edge from vertex {a} to {b}"
                    )));
                }
            }
        }
        let half_edges = 4 * quads.len();
        let mut made = Self {
            opposite: vec![NONE; half_edges],
            edge: vec![NONE; half_edges],
            of_edge: Vec::with_capacity(half_edges / 2),
            first: vec![NONE; count],
            quads,
        };
        for (&(a, b), &h) in &of_pair {
            made.opposite[h as usize] = of_pair.get(&(b, a)).copied().unwrap_or(NONE);
        }
        for h in 0..half_edges {
            match made.opposite(h as u32).map(|o| made.edge[o as usize]) {
                Some(edge) if edge != NONE => made.edge[h] = edge,
                _ => {
                    made.edge[h] = made.of_edge.len() as u32;
                    made.of_edge.push(h as u32);
                }
            }
        }
        made.find_first_edges()?;
        Ok(made)
    }

    /// # Errors
    /// `Input` for unused vertices, and for vertices where several fans of quads meet.
    fn find_first_edges(&mut self) -> Result<()> {
        let mut used = vec![0_usize; self.first.len()];
        for h in 0..self.opposite.len() as u32 {
            let vertex = self.start(h) as usize;
            used[vertex] += 1;
            // With the border on its right, a half edge begins the fan of its vertex.
            if self.first[vertex] == NONE || self.opposite[h as usize] == NONE {
                self.first[vertex] = h;
            }
        }
        for (vertex, &used) in used.iter().enumerate() {
            if used == 0 {
                return Err(invalid(format_args!("vertex {vertex} has no quad")));
            }
            if self.around(vertex as u32).count() != used {
                return Err(invalid(format_args!("at vertex {vertex} several fans of quads meet")));
            }
        }
        Ok(())
    }

    pub(super) fn quads(&self) -> &[[u32; 4]] {
        &self.quads
    }

    pub(super) fn vertex_count(&self) -> usize {
        self.first.len()
    }

    /// The vertex at which a half edge starts.
    pub(super) fn start(&self, h: u32) -> u32 {
        self.quads[(h / 4) as usize][(h % 4) as usize]
    }

    /// The vertex at which it ends.
    pub(super) fn end(&self, h: u32) -> u32 {
        self.start(next(h))
    }

    /// The same edge in the opposite direction, in the quad on the right; none at a border.
    pub(super) fn opposite(&self, h: u32) -> Option<u32> {
        Some(self.opposite[h as usize]).filter(|&o| o != NONE)
    }

    /// The number of its edge.
    pub(super) fn edge(&self, h: u32) -> u32 {
        self.edge[h as usize]
    }

    /// One half edge of each edge: the smaller one.
    pub(super) fn of_edges(&self) -> &[u32] {
        &self.of_edge
    }

    /// Half edges without an opposite.
    pub(super) fn border_edges(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.opposite.len() as u32).filter(|&h| self.opposite[h as usize] == NONE)
    }

    /// The half edges that start at a vertex, counter-clockwise.
    pub(super) fn around(&self, vertex: u32) -> impl Iterator<Item = u32> + '_ {
        self.around_from(self.first[vertex as usize])
    }

    /// The next half edge with the same start, clockwise; none at a border.
    pub(super) fn clockwise(&self, h: u32) -> Option<u32> {
        self.opposite(h).map(next)
    }

    /// The half edges with the same start as a given one, counter-clockwise from it.
    pub(super) fn around_from(&self, first: u32) -> impl Iterator<Item = u32> + '_ {
        std::iter::successors(Some(first), move |&h| self.opposite(previous(h)).filter(|&o| o != first))
    }
}

/// The next half edge of the same quad.
pub(super) fn next(h: u32) -> u32 {
    h / 4 * 4 + (h + 1) % 4
}

/// The one before it.
pub(super) fn previous(h: u32) -> u32 {
    h / 4 * 4 + (h + 3) % 4
}
