//! Skeletons as graphs: paths of pixels between junctions and free ends.

use super::thinning::{AROUND, Mask};
use std::collections::BTreeMap;

/// A path of pixels.
#[derive(Debug, Clone)]
pub(super) struct PixelPath {
    /// Pixels from one end to the other, without those of junctions.
    pub(super) pixels: Vec<[i32; 2]>,
    /// Junctions at its ends; none at a free end, and for closed paths.
    pub(super) nodes: [Option<usize>; 2],
    /// Whether it has been closed where a spur was dropped.
    is_loop: bool,
}

impl PixelPath {
    #[cfg(test)]
    pub(super) fn new(pixels: Vec<[i32; 2]>) -> Self {
        Self { pixels, nodes: [None; 2], is_loop: false }
    }

    /// Whether it runs back to its begin without a junction.
    pub(super) fn is_closed(&self) -> bool {
        let (Some(a), Some(b)) = (self.pixels.first(), self.pixels.last()) else { return false };
        self.is_loop
            || self.nodes == [None; 2] && self.pixels.len() > 10 && (0..2).all(|k| (a[k] - b[k]).abs() <= 3)
    }
}

/// Paths and junctions.
#[derive(Debug, Clone, Default)]
pub(super) struct PixelGraph {
    pub(super) paths: Vec<PixelPath>,
    /// Mean places of junctions.
    pub(super) nodes: Vec<[f64; 2]>,
}

impl PixelGraph {
    /// The graph of a skeleton, without spurs and gaps between junctions shorter than `width`, the width of
    /// lines in pixels.
    pub(super) fn new(mask: &Mask, width: f64) -> Self {
        let mut graph = Self::of_pixels(mask);
        for _ in 0..4 {
            let before = graph.paths.len();
            graph.join_near_nodes(width + 1.0);
            graph.drop_spurs(0.5 * width + 0.6);
            graph.join_through_nodes();
            if graph.paths.len() == before {
                break;
            }
        }
        graph
    }

    fn of_pixels(mask: &Mask) -> Self {
        let index = |x: isize, y: isize| y as usize * mask.columns + x as usize;
        let beside = |k: usize| {
            let (x, y) = ((k % mask.columns) as isize, (k / mask.columns) as isize);
            let set = AROUND.into_iter().filter(move |[dx, dy]| mask.is_set(x + dx, y + dy));
            set.map(move |[dx, dy]| index(x + dx, y + dy))
        };
        let set: Vec<usize> = (0..mask.pixels.len()).filter(|k| mask.pixels[*k]).collect();
        // Junctions are clusters of pixels with three neighbours or more.
        let mut is_junction = vec![false; mask.pixels.len()];
        set.iter().for_each(|k| is_junction[*k] = beside(*k).count() > 2);
        let mut node_of: BTreeMap<usize, usize> = BTreeMap::new();
        let mut nodes = Vec::new();
        for first in set.iter().copied().filter(|k| is_junction[*k]) {
            if node_of.contains_key(&first) {
                continue;
            }
            let (mut open, mut sum, mut count) = (vec![first], [0.0, 0.0], 0.0);
            node_of.insert(first, nodes.len());
            while let Some(k) = open.pop() {
                sum = [sum[0] + (k % mask.columns) as f64, sum[1] + (k / mask.columns) as f64];
                count += 1.0;
                for other in beside(k).filter(|o| is_junction[*o]) {
                    if node_of.insert(other, nodes.len()).is_none() {
                        open.push(other);
                    }
                }
            }
            nodes.push(sum.map(|s| s / count));
        }
        let mut graph = Self { paths: Vec::new(), nodes };
        let mut is_used = vec![false; mask.pixels.len()];
        let pixel = |k: usize| [(k % mask.columns) as i32, (k / mask.columns) as i32];
        // From ends and neighbours of junctions first; then closed paths.
        let is_end = |k: usize| {
            let (mut count, mut at_junction) = (0, false);
            for other in beside(k) {
                count += 1;
                at_junction |= is_junction[other];
            }
            count < 2 || at_junction
        };
        for is_closed in [false, true] {
            for first in set.iter().copied() {
                if is_used[first] || is_junction[first] || !(is_closed || is_end(first)) {
                    continue;
                }
                is_used[first] = true;
                let begin = beside(first).find(|o| is_junction[*o]).map(|o| node_of[&o]);
                let (mut pixels, mut at) = (vec![pixel(first)], first);
                // Neighbours in the row or column first: a diagonal step would leave a pixel out.
                let next = |at: usize, is_used: &[bool]| {
                    let free = || beside(at).filter(|o| !is_used[*o] && !is_junction[*o]);
                    free()
                        .find(|o| o.abs_diff(at) == 1 || o.abs_diff(at) == mask.columns)
                        .or_else(|| free().next())
                };
                while let Some(k) = next(at, &is_used) {
                    is_used[k] = true;
                    pixels.push(pixel(k));
                    at = k;
                }
                // The junction at the end; a single pixel may lie between two.
                let single = pixels.len() == 1;
                let last = beside(at).filter(|o| is_junction[*o]).map(|o| node_of[&o]);
                let end = match single {
                    true => last.skip(1).find(|n| Some(*n) != begin),
                    false => { last }.next(),
                };
                graph.paths.push(PixelPath { pixels, nodes: [begin, end], is_loop: false });
            }
        }
        graph
    }

    fn degrees(&self) -> Vec<usize> {
        let mut degrees = vec![0; self.nodes.len()];
        self.paths.iter().flat_map(|p| p.nodes).flatten().for_each(|n| degrees[n] += 1);
        degrees
    }

    /// Drops short paths that end freely: thinning makes them at corners of wide lines.
    fn drop_spurs(&mut self, longest: f64) {
        let degrees = self.degrees();
        self.paths.retain(|path| match path.nodes {
            [Some(n), None] | [None, Some(n)] => path.pixels.len() as f64 > longest || degrees[n] < 3,
            _ => true,
        });
    }

    /// Joins junctions at the ends of a path shorter than a line is wide, such as the two halves of a cross.
    fn join_near_nodes(&mut self, longest: f64) {
        for k in (0..self.paths.len()).rev() {
            if let [Some(a), Some(b)] = self.paths[k].nodes
                && self.paths[k].pixels.len() as f64 <= 0.7 * longest
            {
                let dropped = self.paths.remove(k);
                if a == b {
                    continue;
                }
                let middle = [0, 1].map(|c| 0.5 * (self.nodes[a][c] + self.nodes[b][c]));
                self.nodes[a] = middle;
                drop(dropped);
                for node in self.paths.iter_mut().flat_map(|p| &mut p.nodes) {
                    if *node == Some(b) {
                        *node = Some(a);
                    }
                }
            }
        }
        // Junctions that touch each other diagonally without a path between them.
        for a in 0..self.nodes.len() {
            for b in a + 1..self.nodes.len() {
                let [p, q] = [self.nodes[a], self.nodes[b]];
                if (p[0] - q[0]).hypot(p[1] - q[1]) < 1.5 {
                    self.nodes[a] = [0, 1].map(|c| 0.5 * (p[c] + q[c]));
                    self.nodes[b] = [-1e9, -1e9 * (b as f64 + 1.0)];
                    for node in self.paths.iter_mut().flat_map(|p| &mut p.nodes) {
                        if *node == Some(b) {
                            *node = Some(a);
                        }
                    }
                }
            }
        }
    }

    /// Joins two paths at a junction where no other path ends.
    fn join_through_nodes(&mut self) {
        for node in 0..self.nodes.len() {
            let ends: Vec<(usize, usize)> = (self.paths.iter().enumerate())
                .flat_map(|(k, p)| (0..2).filter(|e| p.nodes[*e] == Some(node)).map(move |e| (k, e)))
                .collect();
            let [(a, end_a), (b, end_b)] = ends[..] else { continue };
            let at = self.nodes[node].map(|c| c.round() as i32);
            if a == b {
                // A closed path.
                self.paths[a].pixels.push(at);
                self.paths[a].nodes = [None; 2];
                self.paths[a].is_loop = true;
                continue;
            }
            let (mut first, mut second) = (self.paths[a].clone(), self.paths[b].clone());
            if end_a == 0 {
                first.pixels.reverse();
                first.nodes.reverse();
            }
            if end_b == 1 {
                second.pixels.reverse();
                second.nodes.reverse();
            }
            first.pixels.push(at);
            first.pixels.extend(second.pixels);
            first.nodes = [first.nodes[0], second.nodes[1]];
            self.paths[a] = first;
            self.paths.remove(b);
        }
    }
}
