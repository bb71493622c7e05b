//! Points in order cut into lines and arcs, optimally, by dynamic programming.
//!
//! In place of split-and-merge, whose result depends on where it splits first.

use super::super::kind::Kind;
use super::super::sighting::Sighting;
use super::{circle, mean};

/// Points are put into at most so many bins: the table of costs has the square of it.
const MOST_BINS: usize = 120;
/// So many places each way are tried to look around from.
const GRID: usize = 6;
/// Most pieces of a chain.
pub(crate) const MOST_PIECES: usize = 14;

/// Sums over points: number, coordinates, their products to fourth order about the sequence's middle, and covariances.
#[derive(Debug, Clone, Copy, Default)]
struct Sums([f64; 13]);

impl Sums {
    fn add(&mut self, p: [f64; 2], covariance: [f64; 3]) {
        let [x, y] = p;
        let z = x * x + y * y;
        let [xx, xy, yy] = covariance;
        let values = [1.0, x, y, x * x, x * y, y * y, x * z, y * z, z * z, z, xx, xy, yy];
        for (sum, value) in self.0.iter_mut().zip(values) {
            *sum += value;
        }
    }

    fn minus(&self, other: &Self) -> Self {
        let mut rest = *self;
        for (sum, value) in rest.0.iter_mut().zip(other.0) {
            *sum -= value;
        }
        rest
    }

    fn plus(&self, other: &Self) -> Self {
        let mut both = *self;
        for (sum, value) in both.0.iter_mut().zip(other.0) {
            *sum += value;
        }
        both
    }

    fn count(&self) -> f64 {
        self.0[0]
    }

    fn variance_along(&self, n: [f64; 2]) -> f64 {
        let [xx, xy, yy] = [self.0[10], self.0[11], self.0[12]].map(|c| c / self.count());
        (n[0] * n[0] * xx + 2.0 * n[0] * n[1] * xy + n[1] * n[1] * yy).max(f64::MIN_POSITIVE)
    }

    /// The line of least squares `(normal, offset)` and its squared residuals over their variance.
    fn line(&self) -> ([f64; 2], f64, f64) {
        let m = self.count();
        let c = [self.0[1] / m, self.0[2] / m];
        let (xx, xy, yy) = (
            self.0[3] - m * c[0] * c[0],
            self.0[4] - m * c[0] * c[1],
            self.0[5] - m * c[1] * c[1],
        );
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let normal = [-angle.sin(), angle.cos()];
        let left = 0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let offset = normal[0] * c[0] + normal[1] * c[1];
        (normal, offset, left.max(0.0) / self.variance_along(normal))
    }

    /// Squared residuals of Kåsa's circle over their variance, in units of a point of its middle.
    fn arc(&self) -> f64 {
        let m = self.count();
        if m < 5.0 {
            return f64::INFINITY;
        }
        let c = [self.0[1] / m, self.0[2] / m];
        let z = self.0[9] / m;
        let xx = self.0[3] / m - c[0] * c[0];
        let xy = self.0[4] / m - c[0] * c[1];
        let yy = self.0[5] / m - c[1] * c[1];
        let xz = self.0[6] / m - c[0] * z;
        let yz = self.0[7] / m - c[1] * z;
        let zz = self.0[8] / m - z * z;
        let determinant = xx * yy - xy * xy;
        if determinant <= 1e-12 * (xx + yy) * (xx + yy) {
            return f64::INFINITY;
        }
        let b = [(xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant];
        let left = (zz - b[0] * xz - b[1] * yz).max(0.0) * m;
        let center = [0.5 * b[0], 0.5 * b[1]];
        let squared = z - b[0] * c[0] - b[1] * c[1] + center[0] * center[0] + center[1] * center[1];
        if squared <= 0.0 {
            return f64::INFINITY;
        }
        let towards = [c[0] - center[0], c[1] - center[1]];
        let length = towards[0].hypot(towards[1]);
        if length <= 0.0 {
            return f64::INFINITY;
        }
        left / (4.0 * squared * self.variance_along([towards[0] / length, towards[1] / length]))
    }
}

/// Points in the order in which they lie on a closed contour.
pub(crate) struct Sequence {
    origin: [f64; 2],
    points: Vec<[f64; 2]>,
    /// Sums of each bin, of two rounds, cumulated.
    cumulated: Vec<Sums>,
    bins: usize,
    /// The first point of each bin.
    first: Vec<usize>,
}

impl Sequence {
    /// Ordered by direction from the middle, or from that place among the points from which the way around is shortest: within
    /// an outline that is bent inwards there is often a place that sees all of it. Where the file's own order is shorter,
    /// that is kept.
    pub(crate) fn closed(sightings: &[Sighting]) -> Self {
        let points: Vec<[f64; 2]> = sightings.iter().map(Sighting::point).collect();
        let origin = circle(&points).map_or_else(
            || mean(&points),
            |c| {
                let m = mean(&points);
                // A far centre is that of a nearly straight run.
                if (c[0] - m[0]).hypot(c[1] - m[1]) < c[2] {
                    [c[0], c[1]]
                } else {
                    m
                }
            },
        );
        let mut best = around(&points, origin);
        for from in places(&points) {
            let one = around(&points, from);
            if one.0 < 0.9 * best.0 {
                best = one;
            }
        }
        let filed: Vec<usize> = (0..points.len()).collect();
        let mut order = if way(&points, &filed) < 0.95 * best.0 {
            filed
        } else {
            best.1
        };
        let area: f64 = (0..order.len())
            .map(|k| {
                let (a, b) = (points[order[k]], points[order[(k + 1) % order.len()]]);
                a[0] * b[1] - a[1] * b[0]
            })
            .sum();
        if area < 0.0 {
            order.reverse();
        }
        let count = order.len();
        let bins = count.min(MOST_BINS);
        let first: Vec<usize> = (0..bins).map(|b| b * count / bins).collect();
        let mut each = vec![Sums::default(); bins];
        for (b, sums) in each.iter_mut().enumerate() {
            let end = if b + 1 < bins { first[b + 1] } else { count };
            for &i in &order[first[b]..end] {
                let p = [points[i][0] - origin[0], points[i][1] - origin[1]];
                sums.add(p, sightings[i].covariance());
            }
        }
        let mut cumulated = vec![Sums::default()];
        for k in 0..2 * bins {
            cumulated.push(cumulated[k].plus(&each[k % bins]));
        }
        Self {
            origin,
            points: order.iter().map(|&i| points[i]).collect(),
            cumulated,
            bins,
            first,
        }
    }

    fn sums(&self, from: usize, to: usize) -> Sums {
        self.cumulated[to].minus(&self.cumulated[from])
    }

    fn count(&self) -> usize {
        self.points.len()
    }
}

/// The length of the closed way through the points in an order.
fn way(points: &[[f64; 2]], order: &[usize]) -> f64 {
    let step = |k: usize| {
        let (a, b) = (points[order[k]], points[order[(k + 1) % order.len()]]);
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    (0..order.len()).map(step).sum()
}

/// The points by their direction from a place, and the length of the way.
fn around(points: &[[f64; 2]], from: [f64; 2]) -> (f64, Vec<usize>) {
    let mut turns: Vec<(f64, usize)> = (points.iter().enumerate())
        .map(|(i, p)| ((p[1] - from[1]).atan2(p[0] - from[0]), i))
        .collect();
    turns.sort_by(|a, b| a.0.total_cmp(&b.0));
    let order: Vec<usize> = turns.into_iter().map(|(_, i)| i).collect();
    (way(points, &order), order)
}

/// A grid of places within the points' box.
fn places(points: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> {
    let bound = |k: usize, start: f64, pick: fn(f64, f64) -> f64| points.iter().map(|p| p[k]).fold(start, pick);
    let low = [0, 1].map(|k| bound(k, f64::INFINITY, f64::min));
    let high = [0, 1].map(|k| bound(k, f64::NEG_INFINITY, f64::max));
    (0..GRID * GRID).map(move |k| {
        let share = |i: usize| (i as f64 + 0.5) / GRID as f64;
        [
            low[0] + share(k % GRID) * (high[0] - low[0]),
            low[1] + share(k / GRID) * (high[1] - low[1]),
        ]
    })
}

/// Where the pieces of the best segmentation into `count` begin, from a given first bin; the cost with it.
fn best_cuts(costs: &[Vec<f64>], bins: usize, start: usize, count: usize) -> Option<(f64, Vec<usize>)> {
    let mut value = vec![vec![f64::INFINITY; bins + 1]; count + 1];
    let mut from = vec![vec![0; bins + 1]; count + 1];
    value[0][0] = 0.0;
    for k in 1..=count {
        for to in k..=bins {
            for middle in (k - 1)..to {
                let cost = value[k - 1][middle] + costs[(start + middle) % bins][to - middle];
                if cost < value[k][to] {
                    (value[k][to], from[k][to]) = (cost, middle);
                }
            }
        }
    }
    if !value[count][bins].is_finite() {
        return None;
    }
    let mut cuts = Vec::with_capacity(count);
    let mut at = bins;
    for k in (1..=count).rev() {
        at = from[k][at];
        cuts.push((start + at) % bins);
    }
    cuts.reverse();
    Some((value[count][bins], cuts))
}

/// Costs of all runs `[from, from + length)` of bins.
fn table(sequence: &Sequence, cost: impl Fn(&Sums) -> f64) -> Vec<Vec<f64>> {
    let bins = sequence.bins;
    (0..bins)
        .map(|from| {
            (0..=bins)
                .map(|length| match length {
                    0 => f64::INFINITY,
                    _ => cost(&sequence.sums(from, from + length)),
                })
                .collect()
        })
        .collect()
}

fn segmented(costs: &[Vec<f64>], bins: usize, count: usize) -> Option<(f64, Vec<usize>)> {
    // The first run starts anywhere; then from a cut in the middle of what was found, until nothing changes.
    let mut best: Option<(f64, Vec<usize>)> = None;
    let mut start = 0;
    for round in 0..4 {
        let found = best_cuts(costs, bins, start, count)?;
        let next = found.1[(1 + round) % count];
        if best.as_ref().is_none_or(|b| found.0 < b.0 - 1e-9) {
            best = Some(found);
        }
        start = next;
    }
    best
}

/// Vertices of the polygon of so many sides.
pub(crate) fn polygon(sequence: &Sequence, count: usize) -> Option<Vec<f64>> {
    if sequence.count() < 2 * count || count < 3 {
        return None;
    }
    let costs = table(sequence, |sums| if sums.count() < 2.0 { 1e3 } else { sums.line().2 });
    let (_, cuts) = segmented(&costs, sequence.bins, count)?;
    let vertices = corners(sequence, &cuts);
    Some(vertices.into_iter().flatten().collect())
}

/// The vertex before each run: where its line meets the one before, or the point there where they hardly meet.
fn corners(sequence: &Sequence, cuts: &[usize]) -> Vec<[f64; 2]> {
    let count = cuts.len();
    let lines: Vec<([f64; 2], f64)> = (0..count)
        .map(|k| {
            let (from, mut to) = (cuts[k], cuts[(k + 1) % count]);
            if to <= from {
                to += sequence.bins;
            }
            let (normal, offset, _) = sequence.sums(from, to).line();
            (normal, offset)
        })
        .collect();
    (0..count)
        .map(|k| {
            let (before, after) = (lines[(k + count - 1) % count], lines[k]);
            let at = sequence.points[sequence.first[cuts[k]]];
            let cross = before.0[0] * after.0[1] - before.0[1] * after.0[0];
            let met = [
                sequence.origin[0] + (before.1 * after.0[1] - after.1 * before.0[1]) / cross,
                sequence.origin[1] + (after.1 * before.0[0] - before.1 * after.0[0]) / cross,
            ];
            let reach = (at[0] - sequence.origin[0]).hypot(at[1] - sequence.origin[1]);
            if cross.abs() > 0.1 && (met[0] - at[0]).hypot(met[1] - at[1]) < 0.7 * reach {
                met
            } else {
                at
            }
        })
        .collect()
}

/// The chain of least penalised cost, where it has an arc and more than one piece.
pub(crate) fn chain(sequence: &Sequence) -> Option<(Kind, Vec<f64>)> {
    let penalty = (sequence.count() as f64).ln();
    let costs = table(sequence, |sums| {
        if sums.count() < 3.0 {
            return 1e3;
        }
        (sums.line().2 + 2.0 * penalty).min(sums.arc() + 3.0 * penalty)
    });
    let mut best: Option<(f64, Vec<usize>)> = None;
    for count in 2..=MOST_PIECES.min(sequence.bins / 4) {
        let found = segmented(&costs, sequence.bins, count)?;
        if best.as_ref().is_none_or(|b| found.0 < b.0) {
            best = Some(found);
        }
    }
    let (_, cuts) = best?;
    let count = cuts.len();
    let run = |k: usize| {
        let (from, mut to) = (cuts[k], cuts[(k + 1) % count]);
        if to <= from {
            to += sequence.bins;
        }
        (from, to)
    };
    let arcs: Vec<bool> = (0..count)
        .map(|k| {
            let (from, to) = run(k);
            let sums = sequence.sums(from, to);
            sums.arc() + penalty < sums.line().2
        })
        .collect();
    if !arcs.contains(&true) {
        return None;
    }
    // Where an arc begins there is no crossing of lines to take: the points there tell.
    let vertex = |k: usize| {
        let n = sequence.count();
        let at = sequence.first[cuts[k]];
        let near = [sequence.points[(at + n - 1) % n], sequence.points[at]];
        mean(&near)
    };
    let crossings = corners(sequence, &cuts);
    let vertices: Vec<[f64; 2]> = (0..count)
        .map(|k| {
            if arcs[k] || arcs[(k + count - 1) % count] {
                vertex(k)
            } else {
                crossings[k]
            }
        })
        .collect();
    let mut theta: Vec<f64> = vertices.iter().flatten().copied().collect();
    for k in (0..count).filter(|&k| arcs[k]) {
        let (from, to) = run(k);
        let (a, b) = (vertices[k], vertices[(k + 1) % count]);
        theta.push(bulge_through(sequence, from, to, a, b));
    }
    Some((Kind::Chain { arcs, closed: true }, theta))
}

/// `tan(θ/4)` of the arc between two vertices that goes through the middle of a run: sagitta over half the chord.
fn bulge_through(sequence: &Sequence, from: usize, to: usize, a: [f64; 2], b: [f64; 2]) -> f64 {
    let middle = (from + to) / 2;
    let n = sequence.count();
    let at = sequence.first[middle % sequence.bins];
    let near: Vec<[f64; 2]> = (0..5).map(|k| sequence.points[(at + n + k - 2) % n]).collect();
    let m = mean(&near);
    let e = [b[0] - a[0], b[1] - a[1]];
    let chord = e[0].hypot(e[1]).max(f64::MIN_POSITIVE);
    let sagitta = ((m[0] - a[0]) * e[1] - (m[1] - a[1]) * e[0]) / chord;
    let bulge = 2.0 * sagitta / chord;
    if bulge.abs() < 1e-3 {
        1e-3
    } else {
        bulge.clamp(-3.0, 3.0)
    }
}
