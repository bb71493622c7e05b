//! Division of all quads of a domain into four.
//!
//! Input: a domain. Output: the finer domain, and its control vertices as weighted sums of the coarser ones.
//! Where all corners have four quads, the surface stays the same (knot insertion). Around other vertices it
//! changes by a share of the cells that falls with their size; see the table in decision 0111.
//!
//! # References
//! Catmull, Clark, *Recursively generated B-spline surfaces on arbitrary topological meshes*, 1978.

use super::QuadDomain;
use super::half_edges::HalfEdges;
use planish_core::DVec3;
use planish_estimate::Result;
use std::collections::HashMap;

/// A divided domain with its control vertices.
#[derive(Debug, Clone)]
pub struct Division {
    /// The finer domain. Cell `4 c + k` covers the quarter of cell `c` at its corner `k`, with `u` and `v` in
    /// the same directions.
    pub domain: QuadDomain,
    /// For each of its control vertices, the coarser ones with their weights.
    pub weights: Vec<Vec<(u32, f64)>>,
}

impl Division {
    /// The control vertices of the finer domain.
    #[must_use]
    pub fn apply(&self, vertices: &[DVec3]) -> Vec<DVec3> {
        let sum = |row: &Vec<(u32, f64)>| row.iter().map(|&(k, w)| w * vertices[k as usize]).sum();
        self.weights.iter().map(sum).collect()
    }
}

/// What a vertex of the finer domain comes from.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Origin {
    Vertex(u32),
    /// The smaller of two opposite half edges.
    Edge(u32),
    Quad(u32),
}

impl QuadDomain {
    /// Divides each cell into four.
    ///
    /// # Errors
    /// `Input` if the finer domain has too many cells.
    pub fn divided(&self) -> Result<Division> {
        let edges = self.edges();
        let mut numbers: HashMap<Origin, u32> = HashMap::new();
        let mut origins = Vec::new();
        let mut number = |origin: Origin| {
            *numbers.entry(origin).or_insert_with(|| {
                origins.push(origin);
                origins.len() as u32 - 1
            })
        };
        let mut cells = Vec::with_capacity(4 * self.cells);
        for q in 0..self.cells as u32 {
            let corner = [0, 1, 2, 3].map(|k| number(Origin::Vertex(edges.start(4 * q + k))));
            let side = [0, 1, 2, 3].map(|k| number(edge_of(edges, 4 * q + k)));
            let middle = number(Origin::Quad(q));
            cells.push([corner[0], side[0], middle, side[3]]);
            cells.push([side[0], corner[1], side[1], middle]);
            cells.push([middle, side[1], corner[2], side[2]]);
            cells.push([side[3], middle, side[2], corner[3]]);
        }
        let domain = Self::new(&cells)?;
        origins.resize(domain.vertex_count(), Origin::Quad(0));
        self.find_outer_origins(&domain, &mut origins);
        let weights = origins.into_iter().map(|origin| self.weights_of(origin)).collect();
        Ok(Division { domain, weights })
    }

    /// The origins of the finer vertices beyond borders. The quad beyond a border edge is divided as the
    /// cells are, and half of its quarters remain.
    fn find_outer_origins(&self, finer: &Self, origins: &mut [Origin]) {
        let (coarse, fine) = (self.edges(), finer.edges());
        for q in finer.cells as u32..fine.quads().len() as u32 {
            let quad = fine.quads()[q as usize];
            let [b, a] = [quad[0], quad[1]].map(|v| origins[v as usize]);
            match (a, b) {
                // Beyond the first half of a border edge, and beyond the second one.
                (Origin::Vertex(_), Origin::Edge(h)) if (quad[1] as usize) < finer.inner_vertices => {
                    let outer = 4 * outer_quad(coarse, h);
                    origins[quad[2] as usize] = edge_of(coarse, outer + 1);
                    origins[quad[3] as usize] = Origin::Quad(outer / 4);
                }
                (Origin::Edge(h), Origin::Vertex(_)) if (quad[1] as usize) < finer.inner_vertices => {
                    let outer = 4 * outer_quad(coarse, h);
                    origins[quad[2] as usize] = Origin::Quad(outer / 4);
                    origins[quad[3] as usize] = edge_of(coarse, outer + 3);
                }
                // Beyond a corner.
                _ => {
                    let Origin::Vertex(corner) = b else { continue };
                    let outer = coarse.around(corner).find(|&h| {
                        coarse.quads()[(h / 4) as usize][0] == corner
                            && (h / 4) as usize >= self.cells
                            && coarse.quads()[(h / 4) as usize][1] as usize >= self.inner_vertices
                    });
                    if let Some(h) = outer {
                        origins[quad[2] as usize] = Origin::Quad(h / 4);
                    }
                }
            }
        }
    }

    /// The rules of Catmull and Clark.
    fn weights_of(&self, origin: Origin) -> Vec<(u32, f64)> {
        let edges = self.edges();
        let mut sum: HashMap<u32, f64> = HashMap::new();
        let mut add = |vertex: u32, weight: f64| *sum.entry(vertex).or_default() += weight;
        let add_quad = |q: u32, weight: f64, add: &mut dyn FnMut(u32, f64)| {
            edges.quads()[q as usize].iter().for_each(|&v| add(v, 0.25 * weight));
        };
        match origin {
            Origin::Quad(q) => add_quad(q, 1.0, &mut add),
            Origin::Edge(h) => {
                let other = edges.opposite(h).unwrap_or(h);
                [edges.start(h), edges.end(h)].into_iter().for_each(|v| add(v, 0.25));
                [h, other].into_iter().for_each(|h| add_quad(h / 4, 0.25, &mut add));
            }
            Origin::Vertex(v) => {
                let n = edges.around(v).count() as f64;
                add(v, (n - 3.0) / n);
                for h in edges.around(v) {
                    add_quad(h / 4, 1.0 / (n * n), &mut add);
                    add(v, 1.0 / (n * n));
                    add(edges.end(h), 1.0 / (n * n));
                }
            }
        }
        let mut weights: Vec<(u32, f64)> = sum.into_iter().collect();
        weights.sort_unstable_by_key(|(vertex, _)| *vertex);
        weights
    }
}

fn edge_of(edges: &HalfEdges, h: u32) -> Origin {
    Origin::Edge(edges.opposite(h).map_or(h, |o| o.min(h)))
}

/// The quad beyond a border edge, whose half edge 0 is opposite to it.
fn outer_quad(edges: &HalfEdges, h: u32) -> u32 {
    edges.opposite(h).map_or(h, |o| o.max(h)) / 4
}
