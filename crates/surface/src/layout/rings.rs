//! Vertices and quads along the arcs of a function.

use super::contours::{Contour, Contours, Critical};
use planish_core::DVec3;
use planish_estimate::{Error, Result};

/// Distance of the ring around a cap from its middle, in sides of quads times `cap`.
const CAP_RADIUS: f64 = 1.2;
/// Distance of the ring of a trunk from its saddle, in the same unit.
const MEETING_REACH: f64 = 0.8;
/// Contours at which the length of an arc is measured.
const LENGTH_SAMPLES: usize = 48;
/// Turns of a ring that are compared.
const TURNS: usize = 64;

/// Lengths along all arcs.
pub(super) fn lengths(contours: &Contours) -> Vec<Along> {
    (0..contours.arcs.len()).map(|arc| Along::new(contours, arc)).collect()
}

/// Quads over the whole mesh, and the positions of their vertices. There are `cap` edges from the middle of a
/// cap to its sides, and as many from a saddle to the ends of the line along which its rings meet.
///
/// # Errors
/// `Undetermined` if contours do not meet at a saddle as they should.
pub(super) fn quads_along(
    contours: &Contours,
    along: &[Along],
    cap: usize,
) -> Result<(Vec<[u32; 4]>, Vec<DVec3>)> {
    let starts = vec![None; contours.arcs.len()];
    let mut made = Made { contours, cap, along, positions: Vec::new(), quads: Vec::new(), starts };
    for (rank, critical) in &contours.critical {
        match critical {
            Critical::Minimum { .. } => {}
            Critical::Maximum { below } => made.add_arc(*below, None)?,
            Critical::Split { below, above } => {
                let columns = made.columns(*below);
                let (ring, legs, at) = made.meeting(*rank, *below, above, |lengths: [f64; 2], _| {
                    let share = (columns as f64 * lengths[0] / (lengths[0] + lengths[1])).round() as usize;
                    let first = share.clamp(2 * cap, columns - 2 * cap);
                    [first, columns - first]
                })?;
                made.add_arc(*below, Some(End { ring, at }))?;
                for (arc, ring) in above.iter().zip(legs) {
                    made.starts[*arc] = Some(End { ring, at: 0.0 });
                }
            }
            Critical::Merge { below, above } => {
                let columns = below.map(|arc| made.columns(arc));
                let (ring, legs, at) = made.meeting(*rank, *above, below, |_, leg_of_side: [usize; 2]| {
                    leg_of_side.map(|leg| columns[leg] - 2 * cap)
                })?;
                for (arc, ring) in below.iter().zip(legs) {
                    let at = made.along[*arc].total();
                    made.add_arc(*arc, Some(End { ring, at }))?;
                }
                made.starts[*above] = Some(End { ring, at });
            }
        }
    }
    Ok((made.quads, made.positions))
}

/// Numbers of the vertices of a ring.
type Ring = Vec<u32>;

/// The ring at one end of an arc.
#[derive(Clone)]
struct End {
    ring: Ring,
    /// Length along the arc at which it lies.
    at: f64,
}

struct Made<'a> {
    contours: &'a Contours<'a>,
    cap: usize,
    /// Lengths along each arc.
    along: &'a [Along],
    positions: Vec<DVec3>,
    quads: Vec<[u32; 4]>,
    /// The first ring of each arc that begins at a saddle.
    starts: Vec<Option<End>>,
}

impl Made<'_> {
    fn add_vertex(&mut self, position: DVec3) -> u32 {
        self.positions.push(position);
        self.positions.len() as u32 - 1
    }

    /// Those of an arc that begins at a cap are the vertices around it.
    fn columns(&self, arc: usize) -> usize {
        self.starts[arc].as_ref().map_or(8 * self.cap, |start| start.ring.len())
    }

    /// The vertices of the three rings at a saddle: the ring of the trunk, those of both legs, and where on
    /// the trunk its ring lies.
    ///
    /// The ring of the trunk is a contour near the saddle. Two paths lead from the saddle to it, and divide
    /// it into two sides, one for each leg. `edges` gives their numbers of edges, from their lengths and
    /// their legs.
    fn meeting(
        &mut self,
        rank: usize,
        trunk: usize,
        legs: &[usize; 2],
        edges: impl FnOnce([f64; 2], [usize; 2]) -> [usize; 2],
    ) -> Result<(Ring, [Ring; 2], f64)> {
        let is_below = self.contours.arcs[trunk].ends[1] == rank;
        let along = &self.along[trunk];
        let reach = MEETING_REACH * self.cap as f64 * along.mean_length() / self.columns(trunk) as f64;
        let mut reach = reach.min(along.total() / 3.0);
        let (contour, paths, at) = loop {
            let at = if is_below { along.total() - reach } else { reach };
            let contour = self.contours.contour(trunk, along.rank_at(at));
            let paths = self.contours.paths_to(&contour, rank, trunk, legs);
            if let Some(paths) = paths {
                break (contour, paths, at);
            }
            if reach < 1e-6 * along.total() {
                return Err(Error::undetermined("a contour of the surface does not pass its saddle twice"));
            }
            reach *= 0.5;
        };
        let count = contour.points.len();
        let between = |from: usize, to: usize| -> Vec<usize> {
            (from..=if to > from { to } else { to + count }).map(|k| k % count).collect()
        };
        let [first, second] = [paths[0].end, paths[1].end];
        let sides = [between(first, second), between(second, first)];
        let leg_of_side = [paths[0].leg, paths[1].leg];
        let lines = sides.each_ref().map(|side| side.iter().map(|&k| contour.points[k]).collect::<Vec<_>>());
        let edges = edges(lines.each_ref().map(|line| length(line)), leg_of_side);
        let ends = [first, second].map(|k| self.add_vertex(contour.points[k]));
        let middle = self.add_vertex(self.contours.position(rank));
        // From each end to the saddle.
        let ways: [Ring; 2] = std::array::from_fn(|k| {
            let inner = inner_points(&paths[k].points, self.cap);
            inner.into_iter().rev().map(|p| self.add_vertex(p)).collect()
        });
        let mut ring = Ring::new();
        let mut leg_rings = [Ring::new(), Ring::new()];
        for side in 0..2 {
            let inner = inner_points(&lines[side], edges[side]).into_iter().map(|p| self.add_vertex(p));
            let own: Ring = std::iter::once(ends[side]).chain(inner).collect();
            ring.extend(&own);
            let there = std::iter::once(ends[1 - side]).chain(ways[1 - side].iter().copied());
            let back = std::iter::once(middle).chain(ways[side].iter().rev().copied());
            leg_rings[leg_of_side[side]] = own.into_iter().chain(there).chain(back).collect();
        }
        Ok((ring, leg_rings, at))
    }

    /// The quads of an arc, up to the given ring or to a cap.
    fn add_arc(&mut self, arc: usize, last: Option<End>) -> Result<()> {
        let columns = self.columns(arc);
        let start = self.starts[arc].take();
        let total = self.along[arc].total();
        let side = self.along[arc].mean_length() / columns as f64;
        let radius = (CAP_RADIUS * self.cap as f64 * side).min(total / 3.0);
        let begin = start.as_ref().map_or(radius, |start| start.at);
        let end = last.as_ref().map_or(total - radius, |last| last.at);
        // With a single row, two arcs between the same saddles could have an edge in common.
        let rows = (((end - begin) / side).round() as usize).max(2);
        let inner = usize::from(start.is_some())..if last.is_some() { rows } else { rows + 1 };
        let mut previous = start.map(|start| start.ring);
        for row in inner {
            let contour = self.contour_at(arc, begin + (end - begin) * row as f64 / rows as f64);
            let points = match &previous {
                None => sampled(&contour.points, columns, 0.0),
                Some(ring) => {
                    let known: Vec<DVec3> = ring.iter().map(|&v| self.positions[v as usize]).collect();
                    aligned(&contour.points, &known)
                }
            };
            let ring: Ring = points.into_iter().map(|p| self.add_vertex(p)).collect();
            match &previous {
                Some(below) => self.add_row(below, &ring),
                None => self.add_cap(arc, &ring, radius, false),
            }
            previous = Some(ring);
        }
        let below = previous.unwrap_or_default();
        match last {
            Some(End { ring, .. }) => {
                let turn = self.best_turn(&below, &ring);
                let turned: Ring = (0..ring.len()).map(|k| ring[(k + turn) % ring.len()]).collect();
                self.add_row(&below, &turned);
            }
            None => self.add_cap(arc, &below, radius, true),
        }
        Ok(())
    }

    fn contour_at(&self, arc: usize, at: f64) -> Contour {
        self.contours.contour(arc, self.along[arc].rank_at(at))
    }

    fn add_row(&mut self, below: &[u32], above: &[u32]) {
        let n = below.len();
        self.quads.extend((0..n).map(|k| [below[k], below[(k + 1) % n], above[(k + 1) % n], above[k]]));
    }

    /// A square grid of quads inside of a ring, up to an end of the function. Squares around its middle are
    /// contours.
    fn add_cap(&mut self, arc: usize, ring: &[u32], radius: f64, is_above: bool) {
        let total = self.along[arc].total();
        let mut squares = vec![ring.to_vec()];
        for square in (1..self.cap).rev() {
            let outer: Vec<DVec3> = squares[0].iter().map(|&v| self.positions[v as usize]).collect();
            let from_end = radius * square as f64 / self.cap as f64;
            let contour = self.contour_at(arc, if is_above { total - from_end } else { from_end });
            let known: Vec<DVec3> = sampled(&outer, 8 * square, 0.0);
            let points = aligned(&contour.points, &known);
            squares.insert(0, points.into_iter().map(|p| self.add_vertex(p)).collect());
        }
        let end = self.contours.arcs[arc].ends[usize::from(is_above)];
        let middle = self.add_vertex(self.contours.position(end));
        // The vertex at a place of the grid: squares begin at their lower left corner and run around.
        let at = |x: i64, y: i64| {
            let square = x.abs().max(y.abs());
            let place = match () {
                () if square == 0 => return middle,
                () if y == -square => x + square,
                () if x == square => 3 * square + y,
                () if y == square => 5 * square - x,
                () => 7 * square - y,
            };
            squares[square as usize - 1][place as usize % (8 * square as usize)]
        };
        let reach = self.cap as i64;
        let places = (-reach..reach).flat_map(|y| (-reach..reach).map(move |x| (x, y)));
        self.quads.extend(places.map(|(x, y)| {
            let quad = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            // The cap at the lower end is seen from the other side.
            if is_above { quad } else { [quad[3], quad[2], quad[1], quad[0]] }
        }));
    }

    /// The turn of a ring that brings its vertices nearest to those of another one.
    fn best_turn(&self, below: &[u32], ring: &[u32]) -> usize {
        let at = |v: u32| self.positions[v as usize];
        let cost = |turn: &usize| -> f64 {
            (0..ring.len()).map(|k| at(below[k]).distance_squared(at(ring[(k + turn) % ring.len()]))).sum()
        };
        (0..ring.len()).min_by(|a, b| cost(a).total_cmp(&cost(b))).unwrap_or(0)
    }
}

/// Lengths along an arc, from areas and lengths of contours.
pub(super) struct Along {
    ranks: Vec<usize>,
    last_rank: usize,
    /// Number of vertices of the arc below each sample, and the length up to it.
    samples: Vec<(usize, f64)>,
    mean: f64,
}

impl Along {
    fn new(contours: &Contours, arc: usize) -> Self {
        let ranks = contours.ranks(arc);
        let last_rank = contours.arcs[arc].ends[1];
        let vertices = &contours.arcs[arc].vertices;
        let count = ranks.len().clamp(1, LENGTH_SAMPLES);
        let indices: Vec<usize> = (0..=count).map(|k| k * ranks.len() / count).collect();
        let girth = |index: usize| {
            let rank = ranks.get(index).copied().unwrap_or(last_rank);
            let points = contours.contour(arc, rank).points;
            length(&points) + points[0].distance(points[points.len() - 1])
        };
        let girths: Vec<f64> = indices.iter().map(|&index| girth(index)).collect();
        let mut samples = vec![(0, 0.0)];
        let (mut area, mut total) = (0.0, 0.0);
        for (pair, girth) in indices.windows(2).zip(girths.windows(2)) {
            let own: f64 = vertices[pair[0]..pair[1]].iter().map(|&v| contours.areas[v as usize]).sum();
            let mean = (0.5 * (girth[0] + girth[1])).max(f64::MIN_POSITIVE);
            total += own / mean;
            area += own;
            samples.push((pair[1], total));
        }
        let mean = if total > 0.0 { area / total } else { girths[0] };
        Self { ranks, last_rank, samples, mean }
    }

    fn total(&self) -> f64 {
        self.samples[self.samples.len() - 1].1
    }

    fn mean_length(&self) -> f64 {
        self.mean.max(f64::MIN_POSITIVE)
    }

    /// The rank of the contour at a length.
    fn rank_at(&self, at: f64) -> usize {
        let k = self.samples.partition_point(|(_, length)| *length < at).clamp(1, self.samples.len() - 1);
        let [(i, a), (j, b)] = [self.samples[k - 1], self.samples[k]];
        let t = if b > a { ((at - a) / (b - a)).clamp(0.0, 1.0) } else { 0.0 };
        let index = i + (t * (j - i) as f64).round() as usize;
        self.ranks.get(index).copied().unwrap_or(self.last_rank)
    }
}

fn length(line: &[DVec3]) -> f64 {
    line.windows(2).map(|pair| pair[0].distance(pair[1])).sum()
}

/// The point at a share of the length of a line.
fn point_along(line: &[DVec3], share: f64) -> DVec3 {
    let mut left = share * length(line);
    for pair in line.windows(2) {
        let own = pair[0].distance(pair[1]);
        if left <= own {
            return pair[0].lerp(pair[1], if own > 0.0 { left / own } else { 0.0 });
        }
        left -= own;
    }
    line[line.len() - 1]
}

/// Points that divide a line into equal parts, without its ends.
fn inner_points(line: &[DVec3], parts: usize) -> Vec<DVec3> {
    (1..parts).map(|k| point_along(line, k as f64 / parts as f64)).collect()
}

/// Points at equal distances along a closed line, from a share of one of these distances on.
fn sampled(closed: &[DVec3], count: usize, turn: f64) -> Vec<DVec3> {
    let line: Vec<DVec3> = closed.iter().chain(&closed[..1]).copied().collect();
    (0..count).map(|k| point_along(&line, ((k as f64 + turn) / count as f64).fract())).collect()
}

/// Points at equal distances along a closed line, turned so that they are nearest to known ones.
fn aligned(closed: &[DVec3], known: &[DVec3]) -> Vec<DVec3> {
    let count = known.len();
    let dense = sampled(closed, TURNS * count, 0.0);
    let cost = |turn: &usize| -> f64 {
        (0..count).map(|k| dense[(turn + k * TURNS) % dense.len()].distance_squared(known[k])).sum()
    };
    let turn = (0..dense.len()).min_by(|a, b| cost(a).total_cmp(&cost(b))).unwrap_or(0);
    (0..count).map(|k| dense[(turn + k * TURNS) % dense.len()]).collect()
}
