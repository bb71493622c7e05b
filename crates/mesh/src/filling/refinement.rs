//! Refines the cover of a hole to triangles like those around it.
//!
//! In: triangles between the vertices of a loop, and the edge length at each. Out: triangles with additional
//! vertices. Edges are as long as those of the border nearby and grow inwards ([`GROWTH_PER_DISTANCE`]), so
//! that a large hole needs few triangles. The method splits triangles at their centroid and flips edges (P.
//! Liepa, *Filling holes in meshes*, 2003, section 4, there without grading). Not guaranteed: that vertices
//! lie on a plausible surface; fairing moves them.

use crate::edges::edge;
use crate::half_edges::{NONE, around, flip, opposites, split_triangle};
use crate::triangle::{area_vector, smallest_angle};
use planish_core::DVec3;
use std::collections::HashSet;

/// Growth of the edge length per distance from the border. Larger values need fewer triangles but are
/// coarser.
const GROWTH_PER_DISTANCE: f64 = 0.2;
/// A triangle is split if its centroid is farther from each corner than this number of edge lengths (Liepa:
/// √2 times the distance must exceed the length).
const SPLIT_DISTANCE: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Maximum number of passes; each about halves the longest edges.
const MAX_PASSES: usize = 40;
/// Number of smoothing steps along the surface.
const SMOOTHING_STEPS: usize = 10;
/// Minimum relative growth of the smallest angle for a flip; above rounding, so that flips cannot cycle.
const MIN_GAIN: f64 = 1e-9;

/// The triangles that cover a hole.
pub(super) struct Lid {
    /// Triangles of the vertices below.
    pub triangles: Vec<[u32; 3]>,
    /// Vertex positions, those of the border first.
    pub positions: Vec<DVec3>,
    /// For each half-edge, its opposite.
    opposite: Vec<u32>,
    /// Edges of the cover, and existing edges between border vertices.
    edges: HashSet<[u32; 2]>,
}

impl Lid {
    /// Creates a cover with vertices numbered along the border; `existing` are the edges of the mesh between
    /// them.
    pub fn new(triangles: Vec<[u32; 3]>, positions: Vec<DVec3>, existing: HashSet<[u32; 2]>) -> Self {
        let mut edges = existing;
        for t in &triangles {
            edges.extend([edge(t[0], t[1]), edge(t[1], t[2]), edge(t[2], t[0])]);
        }
        Self { opposite: opposites(&triangles), triangles, positions, edges }
    }

    /// Splits triangles until edges have the lengths given at the border, graded inwards.
    pub fn refine(&mut self, lengths: &[f64]) {
        let mut lengths = lengths.to_vec();
        self.relax();
        for _ in 0..MAX_PASSES {
            let before = self.triangles.len();
            // Triangles made in this pass wait for the next, after flips have improved their shapes.
            for t in 0..before {
                let corners = self.triangles[t];
                let at = corners.map(|v| self.positions[v as usize]);
                let middle = 1.0 / 3.0 * (at[0] + (at[1] + at[2]));
                let away = at.map(|p| p.distance(middle));
                let graded = |k: usize| lengths[corners[k] as usize] + GROWTH_PER_DISTANCE * away[k];
                // The smallest of the three: a long edge at one corner must not hide the density at
                // another.
                let length = graded(0).min(graded(1)).min(graded(2));
                let large = |k: usize| away[k] > SPLIT_DISTANCE * length.max(lengths[corners[k] as usize]);
                if large(0) && large(1) && large(2) {
                    let v = self.positions.len() as u32;
                    self.positions.push(middle);
                    lengths.push(length);
                    self.edges.extend(corners.map(|c| edge(c, v)));
                    split_triangle(&mut self.triangles, &mut self.opposite, t as u32, v);
                }
            }
            self.relax();
            if self.triangles.len() == before {
                break;
            }
        }
    }

    /// Flips edges while this increases the smallest angle of both triangles. This ends, because the sorted
    /// angles increase.
    pub fn relax(&mut self) {
        let mut queue: Vec<u32> = (0..self.opposite.len() as u32).rev().collect();
        while let Some(half) = queue.pop() {
            if self.may_flip(half) {
                let [a, b, c, d] = around(&self.triangles, half, self.opposite[half as usize]);
                let [t, s] = flip(&mut self.triangles, &mut self.opposite, half);
                self.edges.remove(&edge(a, b));
                self.edges.insert(edge(c, d));
                queue.extend([3 * t + 1, 3 * t + 2, 3 * s + 1, 3 * s + 2]);
            }
        }
    }

    /// Moves inner vertices along the surface towards the centroid of their neighbours, for even triangles.
    pub fn spread(&mut self, rim: usize) {
        for _ in 0..SMOOTHING_STEPS {
            let n = self.positions.len();
            let (mut sums, mut counts, mut normals) =
                (vec![DVec3::ZERO; n], vec![0.0; n], vec![DVec3::ZERO; n]);
            for t in &self.triangles {
                let corners = t.map(|v| self.positions[v as usize]);
                let up = area_vector(&corners);
                for k in 0..3 {
                    let v = t[k] as usize;
                    sums[v] += corners[(k + 1) % 3] + corners[(k + 2) % 3];
                    counts[v] += 2.0;
                    normals[v] += up;
                }
            }
            for v in rim..n {
                let Some(normal) = normals[v].try_normalize() else { continue };
                // Only the tangential part moves the vertex. The whole step would shrink a curved cover.
                let way = 1.0 / counts[v] * sums[v] - self.positions[v];
                let along = way - way.dot(normal) * normal;
                self.positions[v] += 0.5 * along;
            }
        }
    }

    fn may_flip(&self, half: u32) -> bool {
        let over = self.opposite[half as usize];
        if over == NONE {
            return false;
        }
        let [a, b, c, d] = around(&self.triangles, half, over);
        if self.edges.contains(&edge(c, d)) {
            return false;
        }
        let corners = |t: [u32; 3]| t.map(|v| self.positions[v as usize]);
        let (old, new) = ([[a, b, c], [b, a, d]].map(corners), [[c, d, b], [d, c, a]].map(corners));
        let worst = |both: &[[DVec3; 3]; 2]| smallest_angle(&both[0]).min(smallest_angle(&both[1]));
        if worst(&new) <= (1.0 + MIN_GAIN) * worst(&old) {
            return false;
        }
        // Larger angles alone could fold the cover: the new triangles must face the mean normal of the old
        // ones.
        let (up, turned) = (old.each_ref().map(area_vector), new.each_ref().map(area_vector));
        let mean = up[0] + up[1];
        turned[0].dot(turned[1]) > 0.0 && turned.iter().all(|n| n.dot(mean) > 0.0)
    }
}
