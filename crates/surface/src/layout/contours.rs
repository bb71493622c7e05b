//! A harmonic function on a mesh, its critical points, and its contours.
//!
//! Vertices are ordered by value, with their numbers as tie-breakers. The contour of rank `r` separates the
//! first `r` vertices from the others, so contours depend on comparisons alone and are always closed.

use planish_core::DVec3;
use planish_estimate::sparse::{
    BlockInformation, BlockPattern, CholeskyFactor, NodeOrdering, SymbolicFactor,
};
use planish_estimate::{Error, Result};
use planish_mesh::{Neighbours, TriangleMesh};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::sync::Arc;

/// Least cotangent weight of an edge: the function has no extrema between its ends if all are positive.
const MIN_WEIGHT: f64 = 0.05;

/// A cylinder of contours between two critical points.
#[derive(Debug, Clone)]
pub(super) struct Cylinder {
    /// Ranks of the critical points at its ends.
    pub(super) ends: [usize; 2],
    /// A half edge that the first contour crosses.
    first_edge: u32,
    /// Its regular vertices, in ascending order.
    pub(super) vertices: Vec<u32>,
}

/// A critical point.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Critical {
    Minimum {
        above: usize,
    },
    Maximum {
        below: usize,
    },
    /// One arc below and two above.
    Split {
        below: usize,
        above: [usize; 2],
    },
    /// Two arcs below and one above.
    Merge {
        below: [usize; 2],
        above: usize,
    },
}

/// A function on a mesh with its Reeb graph.
pub(super) struct Contours<'a> {
    pub(super) mesh: &'a TriangleMesh,
    opposite: Vec<u32>,
    /// A half edge that starts at each vertex.
    half_edge: Vec<u32>,
    values: Vec<f64>,
    /// Vertices in ascending order, and the rank of each.
    order: Vec<u32>,
    rank: Vec<u32>,
    pub(super) arcs: Vec<Cylinder>,
    /// Critical points in ascending order, with their ranks.
    pub(super) critical: Vec<(usize, Critical)>,
    /// Area around each vertex.
    pub(super) areas: Vec<f64>,
}

impl<'a> Contours<'a> {
    /// A harmonic function between two far points. None if it has critical points other than these and
    /// simple saddles; another attempt has other ends.
    pub(super) fn of_harmonic(mesh: &'a TriangleMesh, attempt: usize) -> Result<Option<Self>> {
        let opposite = opposites(mesh)?;
        let ends = far_points(mesh, attempt);
        let values = harmonic(mesh, ends)?;
        let mut order: Vec<u32> = (0..values.len() as u32).collect();
        order.sort_by(|&a, &b| values[a as usize].total_cmp(&values[b as usize]).then(a.cmp(&b)));
        let mut rank = vec![0; order.len()];
        (0..).zip(&order).for_each(|(r, &v)| rank[v as usize] = r);
        let mut areas = vec![0.0; values.len()];
        for (index, triangle) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = mesh.corners(index);
            let area = 0.5 * (b - a).cross(c - a).length();
            triangle.iter().for_each(|&v| areas[v as usize] += area / 3.0);
        }
        let mut half_edge = vec![0; values.len()];
        for (index, triangle) in mesh.triangles.iter().enumerate() {
            (0..).zip(triangle).for_each(|(k, &v)| half_edge[v as usize] = 3 * index as u32 + k);
        }
        let (arcs, critical) = (Vec::new(), Vec::new());
        let mut made = Self { mesh, opposite, half_edge, values, order, rank, arcs, critical, areas };
        Ok(made.find_arcs().then_some(made))
    }

    fn start(&self, h: u32) -> u32 {
        self.mesh.triangles[h as usize / 3][h as usize % 3]
    }

    fn end(&self, h: u32) -> u32 {
        self.start(next(h))
    }

    /// The half edges that start at a vertex, counter-clockwise from the given one.
    fn around(&self, first: u32) -> impl Iterator<Item = u32> + '_ {
        let turned = move |&h: &u32| Some(self.opposite[next(next(h)) as usize]).filter(|&o| o != first);
        std::iter::successors(Some(first), turned)
    }

    /// Sweeps over all vertices in ascending order. False if a critical point is not simple, or an extremum
    /// lies between the ends.
    fn find_arcs(&mut self) -> bool {
        // The arc of each half edge from a lower to a higher vertex, while the contour crosses it.
        let mut arc_of: Vec<usize> = vec![usize::MAX; self.opposite.len()];
        for r in 0..self.order.len() {
            let vertex = self.order[r];
            let around: Vec<u32> = self.around(self.half_edge[vertex as usize]).collect();
            let is_up = |h: &u32| self.rank[self.end(*h) as usize] as usize > r;
            // Rotate so that the list starts with the first upper edge after a lower one.
            let first = (0..around.len())
                .find(|&k| is_up(&around[k]) && !is_up(&around[(k + around.len() - 1) % around.len()]));
            let Some(first) = first else {
                let is_minimum = is_up(&around[0]);
                if is_minimum {
                    if r != 0 {
                        return false;
                    }
                    let arc = self.begin_arc(r, around[0]);
                    around.iter().for_each(|&h| arc_of[h as usize] = arc);
                    self.critical.push((r, Critical::Minimum { above: arc }));
                } else {
                    if r + 1 != self.order.len() {
                        return false;
                    }
                    let below = arc_of[self.opposite[around[0] as usize] as usize];
                    self.arcs[below].ends[1] = r;
                    self.critical.push((r, Critical::Maximum { below }));
                }
                continue;
            };
            let ordered: Vec<u32> = around[first..].iter().chain(&around[..first]).copied().collect();
            // Sectors of upper and lower edges in turn.
            let mut sectors: Vec<Vec<u32>> = Vec::new();
            for h in ordered {
                let joins = sectors.last().is_some_and(|last| is_up(&last[0]) == is_up(&h));
                match sectors.last_mut() {
                    Some(last) if joins => last.push(h),
                    _ => sectors.push(vec![h]),
                }
            }
            let below = |sector: &[u32]| arc_of[self.opposite[sector[0] as usize] as usize];
            match sectors.len() {
                2 => {
                    let arc = below(&sectors[1]);
                    sectors[0].iter().for_each(|&h| arc_of[h as usize] = arc);
                    self.arcs[arc].vertices.push(vertex);
                }
                4 => {
                    let lower = [below(&sectors[1]), below(&sectors[3])];
                    let begun = |made: &mut Self, arc_of: &mut Vec<usize>, h: u32| {
                        let arc = made.begin_arc(r, h);
                        made.loop_from(r + 1, h).into_iter().for_each(|h| arc_of[h as usize] = arc);
                        arc
                    };
                    lower.iter().for_each(|&arc| self.arcs[arc].ends[1] = r);
                    let first = begun(self, &mut arc_of, sectors[0][0]);
                    if lower[0] == lower[1] {
                        // The loop through the second sector is another one, or the surface had one side.
                        if arc_of[sectors[2][0] as usize] == first {
                            return false;
                        }
                        let second = begun(self, &mut arc_of, sectors[2][0]);
                        let above = [first, second];
                        self.critical.push((r, Critical::Split { below: lower[0], above }));
                    } else {
                        self.critical.push((r, Critical::Merge { below: lower, above: first }));
                    }
                }
                _ => return false,
            }
        }
        true
    }

    fn begin_arc(&mut self, rank: usize, first_edge: u32) -> usize {
        self.arcs.push(Cylinder { ends: [rank, rank], first_edge, vertices: Vec::new() });
        self.arcs.len() - 1
    }

    /// The contour of a rank that crosses a half edge from a lower to a higher vertex: all such half edges in
    /// order. Higher values are on its left.
    fn loop_from(&self, rank: usize, first: u32) -> Vec<u32> {
        let is_low = |v: u32| (self.rank[v as usize] as usize) < rank;
        let mut found = vec![first];
        loop {
            // In the triangle on the other side, the half edge that rises.
            let entered = self.opposite[found[found.len() - 1] as usize];
            let [a, b] = [next(entered), next(next(entered))];
            let left = if is_low(self.start(a)) && !is_low(self.end(a)) { a } else { b };
            if left == first {
                return found;
            }
            found.push(left);
        }
    }

    /// The contour of an arc at a rank after its first end, and not after its last one.
    pub(super) fn contour(&self, arc: usize, rank: usize) -> Contour {
        let own = &self.arcs[arc];
        let last = own.vertices.partition_point(|&v| (self.rank[v as usize] as usize) < rank);
        let first = match last {
            0 => own.first_edge,
            _ => {
                let vertex = own.vertices[last - 1];
                // Each regular vertex has a higher neighbour; it is found around any of its half edges.
                let any = self.half_edge[vertex as usize];
                let rises = |&h: &u32| self.rank[self.end(h) as usize] as usize >= rank;
                self.around(any).find(rises).unwrap_or(own.first_edge)
            }
        };
        let edges = self.loop_from(rank, first);
        let value = |r: usize| self.values[self.order[r] as usize];
        let level = 0.5 * (value(rank - 1) + value(rank));
        let points = edges.iter().map(|&h| {
            let [a, b] = [self.start(h), self.end(h)].map(|v| v as usize);
            let (low, high) = (self.values[a], self.values[b]);
            let t = if high > low { ((level - low) / (high - low)).clamp(0.0, 1.0) } else { 0.5 };
            self.mesh.positions[a].lerp(self.mesh.positions[b], t)
        });
        Contour { points: points.collect(), edges }
    }

    pub(super) fn position(&self, rank: usize) -> DVec3 {
        self.mesh.positions[self.order[rank] as usize]
    }

    /// Ranks of the vertices of an arc.
    pub(super) fn ranks(&self, arc: usize) -> Vec<usize> {
        self.arcs[arc].vertices.iter().map(|&v| self.rank[v as usize] as usize).collect()
    }

    /// Paths from a saddle to a contour of its trunk: of steepest descent if the trunk is below, of ascent
    /// otherwise. None if both end at the same edge.
    pub(super) fn paths_to(
        &self,
        contour: &Contour,
        rank: usize,
        trunk: usize,
        legs: &[usize; 2],
    ) -> Option<[Path; 2]> {
        let is_below = self.arcs[trunk].ends[1] == rank;
        let place: HashMap<u32, usize> = contour.edges.iter().enumerate().map(|(k, &h)| (h, k)).collect();
        let saddle = self.order[rank];
        let around: Vec<u32> = self.around(self.half_edge[saddle as usize]).collect();
        let n = around.len();
        let leads = |h: u32| (self.rank[self.end(h) as usize] < rank as u32) == is_below;
        let begins = (0..n).filter(|&k| leads(around[k]) && !leads(around[(k + n - 1) % n]));
        let paths = begins.map(|k| {
            let sector: Vec<u32> = (k..k + n).map(|k| around[k % n]).take_while(|&h| leads(h)).collect();
            // A contour has higher values on its left. From a lower sector it goes on below the next upper
            // one, counter-clockwise; from an upper sector, above the lower one before it.
            let leg = match is_below {
                true => usize::from(around[(k + sector.len()) % n] != self.arcs[legs[0]].first_edge),
                false => usize::from(around[k] == self.arcs[trunk].first_edge),
            };
            self.path_to(contour, &place, sector, is_below).map(|path| Path { leg, ..path })
        });
        let [a, b]: [Path; 2] = paths.collect::<Option<Vec<_>>>()?.try_into().ok()?;
        (a.end != b.end).then_some([a, b])
    }

    fn path_to(
        &self,
        contour: &Contour,
        place: &HashMap<u32, usize>,
        mut choice: Vec<u32>,
        is_below: bool,
    ) -> Option<Path> {
        let mut points = vec![self.mesh.positions[self.start(*choice.first()?) as usize]];
        let slope = |h: &u32| {
            let [a, b] = [self.start(*h), self.end(*h)].map(|v| v as usize);
            let rise = self.values[b] - self.values[a];
            let rise = if is_below { -rise } else { rise };
            rise / self.mesh.positions[a].distance(self.mesh.positions[b]).max(f64::MIN_POSITIVE)
        };
        loop {
            let step = *choice.iter().max_by(|a, b| slope(a).total_cmp(&slope(b)))?;
            let rising = if is_below { self.opposite[step as usize] } else { step };
            if let Some(&end) = place.get(&rising) {
                points.push(contour.points[end]);
                return Some(Path { points, end, leg: 0 });
            }
            let here = self.end(step);
            points.push(self.mesh.positions[here as usize]);
            let own = self.rank[here as usize];
            choice = self.around(self.half_edge[here as usize]).collect();
            choice.retain(|&h| (self.rank[self.end(h) as usize] < own) == is_below);
        }
    }
}

/// A path from a saddle to a point of a contour.
pub(super) struct Path {
    pub(super) points: Vec<DVec3>,
    /// Its number in the contour.
    pub(super) end: usize,
    /// The leg, of two, along which the contour goes on from there.
    pub(super) leg: usize,
}

/// A closed contour: the half edges that it crosses, from lower to higher vertices, and the points on them.
pub(super) struct Contour {
    pub(super) edges: Vec<u32>,
    pub(super) points: Vec<DVec3>,
}

fn next(h: u32) -> u32 {
    h / 3 * 3 + (h + 1) % 3
}

/// The half edge in the other direction, for each one.
fn opposites(mesh: &TriangleMesh) -> Result<Vec<u32>> {
    let ends = |h: usize| (mesh.triangles[h / 3][h % 3], mesh.triangles[h / 3][(h + 1) % 3]);
    let half_edges = 3 * mesh.triangles.len();
    let of_ends: HashMap<(u32, u32), u32> = (0..half_edges).map(|h| (ends(h), h as u32)).collect();
    let opposite = |h: usize| {
        let (a, b) = ends(h);
        of_ends.get(&(b, a)).copied().ok_or_else(|| Error::input(format!("edge {a}, {b} is on a border")))
    };
    (0..half_edges).map(opposite).collect()
}

/// The two ends: a point that is far from a first one, and the farthest from that.
fn far_points(mesh: &TriangleMesh, attempt: usize) -> [u32; 2] {
    let neighbours = Neighbours::from_mesh(mesh);
    let farthest = |from: u32| {
        // Lengths along edges, by Dijkstra's method.
        let mut distance = vec![f64::INFINITY; mesh.positions.len()];
        distance[from as usize] = 0.0;
        // The bits of numbers that are not negative have the order of the numbers.
        let mut heap = BinaryHeap::from([Reverse((0_u64, from))]);
        let mut last = from;
        while let Some(Reverse((bits, v))) = heap.pop() {
            let d = f64::from_bits(bits);
            if d > distance[v as usize] {
                continue;
            }
            last = v;
            for &w in neighbours.of_vertex(v) {
                let to = d + mesh.positions[v as usize].distance(mesh.positions[w as usize]);
                if to < distance[w as usize] {
                    distance[w as usize] = to;
                    heap.push(Reverse((to.to_bits(), w)));
                }
            }
        }
        last
    };
    let first = farthest((attempt * mesh.positions.len() / super::ATTEMPTS) as u32);
    [first, farthest(first)]
}

/// The harmonic function that is 0 at the first end and 1 at the second one, by cotangent weights.
fn harmonic(mesh: &TriangleMesh, ends: [u32; 2]) -> Result<Vec<f64>> {
    let count = mesh.positions.len();
    let mut weights: HashMap<(u32, u32), f64> = HashMap::new();
    for (index, triangle) in mesh.triangles.iter().enumerate() {
        let corners = mesh.corners(index);
        for k in 0..3 {
            let [i, j, o] = [k, (k + 1) % 3, (k + 2) % 3];
            let [a, b] = [corners[i] - corners[o], corners[j] - corners[o]];
            let cotangent = a.dot(b) / a.cross(b).length().max(f64::MIN_POSITIVE);
            let pair = (triangle[i].min(triangle[j]), triangle[i].max(triangle[j]));
            *weights.entry(pair).or_default() += 0.5 * cotangent;
        }
    }
    let mut weights: Vec<((u32, u32), f64)> = weights.into_iter().collect();
    weights.sort_unstable_by_key(|(pair, _)| *pair);
    let pattern = Arc::new(BlockPattern::from_elements(count, weights.iter().map(|((a, b), _)| [*a, *b]))?);
    let mut system = BlockInformation::zeros(Arc::clone(&pattern), 1, 1)?;
    let is_end = |v: u32| ends.contains(&v);
    for &((a, b), cotangent) in &weights {
        let w = cotangent.clamp(MIN_WEIGHT, 1.0 / MIN_WEIGHT);
        match (is_end(a), is_end(b)) {
            (false, false) => system.add_element(&[a, b], &[w, -w, -w, w], &[0.0, 0.0])?,
            (true, true) => {}
            (a_is_end, _) => {
                let (end, free) = if a_is_end { (a, b) } else { (b, a) };
                let value = f64::from(u8::from(end == ends[1]));
                system.add_element(&[free], &[w], &[w * value])?;
            }
        }
    }
    for (end, value) in ends.into_iter().zip([0.0, 1.0]) {
        system.add_element(&[end], &[1.0], &[value])?;
    }
    let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &NodeOrdering::amd(&pattern)?, 1)?);
    let mut values = system.vector().to_vec();
    CholeskyFactor::factorize(&symbolic, &system)?.solve_in_place(&mut values)?;
    Ok(values)
}
