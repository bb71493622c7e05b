//! Merges vertices and edges that a file contains more than once.

use super::{ParametricEdge, ParametricFace, ParametricShape};
use planish_core::DVec3;
use std::collections::HashMap;

/// For each point, the index of the first earlier point within a tolerance, or its own index.
///
/// A hash of grid cells with twice the tolerance finds candidates in constant time.
fn same_points(points: &[DVec3], tolerance: f64) -> Vec<usize> {
    let side = tolerance.max(f64::MIN_POSITIVE) * 2.0;
    let cell = |p: DVec3| (p / side).floor();
    let mut cells: HashMap<[u64; 3], Vec<usize>> = HashMap::new();
    // Cells as floating-point numbers: far coordinates over a small tolerance would overflow integers.
    // Adding zero turns −0 into 0.
    let key = |c: DVec3| c.to_array().map(|x| (x + 0.0).to_bits());
    let mut same = Vec::with_capacity(points.len());
    for (k, p) in points.iter().enumerate() {
        let at = cell(*p);
        let mut found = None;
        'search: for dx in [0.0, -1.0, 1.0] {
            for dy in [0.0, -1.0, 1.0] {
                for dz in [0.0, -1.0, 1.0] {
                    let neighbour = key(at + DVec3::new(dx, dy, dz));
                    let mut candidates = cells.get(&neighbour).into_iter().flatten();
                    if let Some(other) = candidates.find(|o| points[**o].distance(*p) <= tolerance) {
                        found = Some(*other);
                        break 'search;
                    }
                }
            }
        }
        if found.is_none() {
            cells.entry(key(at)).or_default().push(k);
        }
        same.push(found.unwrap_or(k));
    }
    same
}

/// Loops in an order that does not depend on where they begin.
fn canonical(loops: &[Vec<(usize, bool)>]) -> Vec<Vec<(usize, bool)>> {
    let mut all: Vec<Vec<(usize, bool)>> = loops.to_vec();
    for ring in &mut all {
        let least = (0..ring.len()).min_by_key(|k| ring[*k]).unwrap_or(0);
        ring.rotate_left(least);
    }
    all.sort_unstable();
    all
}

impl ParametricShape {
    /// Merges vertices within a tolerance, edges that coincide between the same vertices, and faces that are
    /// copies of each other.
    ///
    /// Many programs write faces that share neither. Without welding, the mesh has gaps along all edges.
    pub fn weld(&mut self, tolerance: f64) {
        let vertex = same_points(&self.vertices, tolerance);
        for edge in &mut self.edges {
            edge.ends = edge.ends.map(|v| vertex[v]);
        }
        let middles: Vec<DVec3> = self.edges.iter().map(|e| self.middle(e)).collect();
        let mut between: HashMap<[usize; 2], Vec<usize>> = HashMap::new();
        let mut same: Vec<(usize, bool)> = Vec::with_capacity(self.edges.len());
        for (k, edge) in self.edges.iter().enumerate() {
            let [a, b] = edge.ends;
            let candidates = between.entry([a.min(b), a.max(b)]).or_default();
            // Middles agree less than ends: two curves of one edge may have different parametrisations.
            let size = self.vertices[a].distance(middles[k]).max(tolerance);
            let near = (10.0 * tolerance).max(1e-6 * size);
            // Equal ends are not enough: two half circles have the same ends.
            let found = candidates.iter().find(|o| middles[**o].distance(middles[k]) <= near);
            match found {
                Some(other) if a != b => same.push((*other, self.edges[*other].ends != edge.ends)),
                Some(other) => same.push((*other, self.has_opposite_direction(&self.edges[*other], edge))),
                None => {
                    candidates.push(k);
                    same.push((k, false));
                }
            }
        }
        for (edge, forward) in self.faces.iter_mut().flat_map(|f| &mut f.loops).flatten() {
            let (other, is_turned) = same[*edge];
            *edge = other;
            *forward ^= is_turned;
        }
        self.remove_copies();
    }

    /// Removes faces that equal an earlier one: the same loops on the same surface. Some programs write a
    /// face once per colour or layer, and each copy would cost as much as the first.
    fn remove_copies(&mut self) {
        /// Faces of equal loops that are compared. Two half spheres share their loop, but hardly more faces.
        const COMPARED: usize = 8;
        let mut known: HashMap<Vec<Vec<(usize, bool)>>, Vec<usize>> = HashMap::new();
        let mut kept: Vec<ParametricFace> = Vec::with_capacity(self.faces.len());
        for face in std::mem::take(&mut self.faces) {
            // Whole surfaces have no loops, so that all of them would be compared.
            if !face.loops.is_empty() {
                let alike = known.entry(canonical(&face.loops)).or_default();
                let is_copy = |other: &usize| {
                    kept[*other].is_outward == face.is_outward && kept[*other].surface == face.surface
                };
                if alike.iter().any(is_copy) {
                    continue;
                }
                if alike.len() < COMPARED {
                    alike.push(kept.len());
                }
            }
            kept.push(face);
        }
        self.faces = kept;
    }

    /// Range of the curve parameter of an edge.
    fn span(&self, edge: &ParametricEdge) -> [f64; 2] {
        let [a, b] = edge.ends;
        let [from, to] = [a, b].map(|v| self.vertices[v]);
        let ends = if edge.is_forward { [from, to] } else { [to, from] };
        edge.curve.range(ends, a == b)
    }

    /// The point at the middle of the parameter range.
    fn middle(&self, edge: &ParametricEdge) -> DVec3 {
        let [from, to] = self.span(edge);
        edge.curve.point(0.5 * (from + to))
    }

    /// True if two coincident closed edges have opposite directions. Their ends do not show this.
    fn has_opposite_direction(&self, one: &ParametricEdge, other: &ParametricEdge) -> bool {
        let near_start = |edge: &ParametricEdge| {
            let [from, to] = self.span(edge);
            let share = if edge.is_forward { 0.2 } else { 0.8 };
            edge.curve.point(from + share * (to - from))
        };
        let near_end = |edge: &ParametricEdge| {
            let [from, to] = self.span(edge);
            let share = if edge.is_forward { 0.8 } else { 0.2 };
            edge.curve.point(from + share * (to - from))
        };
        let p = near_start(one);
        p.distance(near_end(other)) < p.distance(near_start(other))
    }
}
