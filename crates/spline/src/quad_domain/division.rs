//! Division of all quads of a domain into four.
//!
//! Input: a domain. Output: the finer domain, and its control vertices as weighted sums of the coarser ones.
//! Each crease becomes two, and marked corners stay corners.
//! Where all corners have four quads, the surface stays the same (knot insertion). Around other vertices it
//! changes by a share of the cells that falls with their size; see the table in decision 0111.
//!
//! # References
//! Catmull, Clark, *Recursively generated B-spline surfaces on arbitrary topological meshes*, 1978.

use super::QuadDomain;
use super::level::{Level, LevelCell};
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

impl QuadDomain {
    /// Divides each cell into four.
    ///
    /// # Errors
    /// `Input` if the finer domain has too many cells, or a border vertex more than two quads.
    pub fn divided(&self) -> Result<Division> {
        self.check_borders()?;
        let (coarse, fine) = (Level::new(self, 0), Level::new(self, 1));
        let mut numbers: HashMap<usize, u32> = HashMap::new();
        let mut vertices: Vec<usize> = Vec::new();
        let mut cells = Vec::with_capacity(4 * self.cells);
        for quad in 0..self.cells as u32 {
            for at in QUARTERS {
                cells.push(fine.corners(LevelCell { quad, at }).map(|vertex| {
                    *numbers.entry(vertex).or_insert_with(|| {
                        vertices.push(vertex);
                        vertices.len() as u32 - 1
                    })
                }));
            }
        }
        let along = |&[a, b]: &[u32; 2]| self.halves(&fine, [a, b]);
        let creases = self.creases.given.iter().flat_map(along);
        let number = |vertex: usize| numbers.get(&vertex).copied().unwrap_or_default();
        let creases: Vec<[u32; 2]> = creases.map(|edge| edge.map(number)).collect();
        let corners: Vec<u32> = self.creases.corners.iter().map(|&v| number(v as usize)).collect();
        let domain = Self::with_creases(&cells, &creases, &corners)?;
        // Vertices beyond borders are found from the quads there, which share a side or corner with a cell.
        vertices.resize(domain.vertex_count(), usize::MAX);
        let finer = Level::new(&domain, 0);
        for cell in (0..domain.cells as u32).map(|quad| LevelCell { quad, at: [0, 0] }) {
            let origin = LevelCell { quad: cell.quad / 4, at: QUARTERS[cell.quad as usize % 4] };
            let near = finer.plain_neighbourhood(cell);
            let far = fine.plain_neighbourhood(origin);
            for (own, of_coarse) in near.into_iter().zip(far) {
                vertices[own] = of_coarse;
            }
        }
        let number = |(vertex, weight): (usize, f64)| (vertex as u32, weight);
        let weights = |&vertex: &usize| fine.parents(&coarse, vertex).into_iter().map(number).collect();
        Ok(Division { weights: vertices.iter().map(weights).collect(), domain })
    }

    /// Both halves of an edge of the mesh, as vertices of the finer level.
    fn halves(&self, fine: &Level, [a, b]: [u32; 2]) -> [[usize; 2]; 2] {
        let side = self.edges().around(a).find(|&h| self.edges().end(h) == b).unwrap_or_default();
        let middle = fine.middle_of(side);
        [[a as usize, middle], [middle, b as usize]]
    }
}

/// Places of the quarters of a quad, in the order of its corners.
const QUARTERS: [[i64; 2]; 4] = [[0, 0], [1, 0], [1, 1], [0, 1]];
