//! Optimal segmentation of ordered points into lines and arcs by dynamic programming.
//!
//! Split-and-merge is not used, because its result depends on the first split. Dynamic programming finds the
//! best segmentation for each number of pieces; the fits that start there decide between these numbers.

use super::super::kind::ContourKind;
use super::mean;
use super::sequence::{Sequence, Sums};

/// Maximum number of pieces of a chain. The cost of the segmentation is proportional to it, and the BIC of a
/// chain pays for the choice among so many.
pub(crate) const MAX_PIECES: usize = 14;
/// Maximum number of further start bins for a closed sequence. Each costs a complete segmentation.
const MAX_STARTS: usize = 10;
/// Chains with at most this many pieces are always fitted, whatever their cost here.
///
/// They are cheap to fit, and with uneven σ this cost prefers more pieces than the likelihood does.
const FEW_PIECES: usize = 4;

/// Best segmentations into 1, 2, … `max_pieces` pieces that begin at bin `start`: cost, and first bin of each
/// piece (Bellman 1961).
fn best_cuts(costs: &[Vec<f64>], bins: usize, start: usize, max_pieces: usize) -> Vec<(f64, Vec<usize>)> {
    let mut value = vec![vec![f64::INFINITY; bins + 1]; max_pieces + 1];
    let mut from = vec![vec![0; bins + 1]; max_pieces + 1];
    value[0][0] = 0.0;
    for k in 1..=max_pieces {
        for to in k..=bins {
            // Each of the k − 1 pieces before needs at least one bin.
            for middle in (k - 1)..to {
                let cost = value[k - 1][middle] + costs[(start + middle) % bins][to - middle];
                if cost < value[k][to] {
                    (value[k][to], from[k][to]) = (cost, middle);
                }
            }
        }
    }
    // Follow the stored predecessors back from the last bin.
    (1..=max_pieces)
        .map(|count| {
            let mut cuts = Vec::with_capacity(count);
            let mut at = bins;
            for k in (1..=count).rev() {
                at = from[k][at];
                cuts.push((start + at) % bins);
            }
            cuts.reverse();
            (value[count][bins], cuts)
        })
        .collect()
}

/// Costs of all runs `[from, from + length)` of bins; infinite for runs that do not exist.
fn table(sequence: &Sequence, cost: impl Fn(&Sums) -> f64) -> Vec<Vec<f64>> {
    let bins = sequence.bins;
    (0..bins)
        .map(|from| {
            (0..=bins)
                .map(|length| match length {
                    0 => f64::INFINITY,
                    _ if !sequence.is_closed && from + length > bins => f64::INFINITY,
                    _ => cost(&sequence.sums(from, from + length)),
                })
                .collect()
        })
        .collect()
}

/// Best segmentations into 1, 2, … `max_pieces` pieces: cost, and first bin of each piece.
///
/// An open sequence begins at its first point. For a closed one, the dynamic program needs a start that is a
/// cut of the optimum. Segmentations from another start into more pieces than needed have it among their
/// cuts, so the most frequent cuts are tried next. Trying every bin would cost the number of bins times as
/// much.
fn segmented(costs: &[Vec<f64>], sequence: &Sequence, max_pieces: usize) -> Vec<(f64, Vec<usize>)> {
    let bins = sequence.bins;
    let mut best = best_cuts(costs, bins, 0, max_pieces);
    let mut tried = vec![0];
    while sequence.is_closed && tried.len() <= MAX_STARTS {
        // The most frequent cut among the best segmentations that was not a start yet.
        let cuts = best.iter().flat_map(|(_, cuts)| cuts);
        let mut times = vec![0; bins];
        for &cut in cuts.filter(|cut| !tried.contains(cut)) {
            times[cut] += 1;
        }
        let Some(start) = (0..bins).filter(|&cut| times[cut] > 0).max_by_key(|&cut| times[cut]) else {
            break;
        };
        tried.push(start);
        for (best, found) in best.iter_mut().zip(best_cuts(costs, bins, start, max_pieces)) {
            if found.0 < best.0 {
                *best = found;
            }
        }
    }
    best
}

/// Vertices of the best polygon with `count` sides; `None` with fewer than two readings per side.
pub(super) fn polygon(sequence: &Sequence, count: usize) -> Option<Vec<f64>> {
    if sequence.count() < 2 * count || count < 3 {
        return None;
    }
    // A single reading fits any line; a finite penalty keeps such runs possible but unattractive.
    let costs = table(sequence, |sums| if sums.count() < 2.0 { 1e3 } else { sums.line().2 });
    let (cost, cuts) = segmented(&costs, sequence, count).pop()?;
    if !cost.is_finite() {
        return None;
    }
    let vertices = corners(sequence, &cuts);
    Some(vertices.into_iter().flatten().collect())
}

/// First vertex of each run: the intersection of its line with that of the run before.
///
/// For nearly parallel lines, or a very distant intersection, it is the first point of the run.
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
    // The size of the outline: the distance of a single point from the origin is small near an elbow.
    let from_origin = |p: &[f64; 2]| (p[0] - sequence.origin[0]).hypot(p[1] - sequence.origin[1]);
    let reach = sequence.points.iter().map(from_origin).fold(0.0, f64::max);
    (0..count)
        .map(|k| {
            let (before, after) = (lines[(k + count - 1) % count], lines[k]);
            let at = sequence.points[sequence.first[cuts[k]]];
            let cross = before.0[0] * after.0[1] - before.0[1] * after.0[0];
            let met = [
                sequence.origin[0] + (before.1 * after.0[1] - after.1 * before.0[1]) / cross,
                sequence.origin[1] + (after.1 * before.0[0] - before.1 * after.0[0]) / cross,
            ];
            // Nearly parallel lines meet far away or at random: use the measured point instead.
            if cross.abs() > 0.1 && (met[0] - at[0]).hypot(met[1] - at[1]) < 0.7 * reach { met } else { at }
        })
        .collect()
}

/// Chains with the best number of pieces by penalised cost, and those with few pieces.
///
/// A closed chain has at least one arc, otherwise it is a polygon. An open one has an arc or at least two
/// pieces.
pub(super) fn chains(sequence: &Sequence) -> Vec<(ContourKind, Vec<f64>)> {
    // The penalty of BIC: two parameters per line and three per arc, ln n each.
    let penalty = (sequence.count() as f64).ln();
    let costs = table(sequence, |sums| {
        if sums.count() < 3.0 {
            return 1e3;
        }
        (sums.line().2 + 2.0 * penalty).min(sums.arc() + 3.0 * penalty)
    });
    let fewest = if sequence.is_closed { 2 } else { 1 };
    let max_pieces = MAX_PIECES.min(sequence.bins / 4);
    let mut found: Vec<(f64, ContourKind, Vec<f64>)> =
        (segmented(&costs, sequence, max_pieces).into_iter().skip(fewest - 1))
            .filter(|(cost, _)| cost.is_finite())
            .filter_map(|(cost, cuts)| {
                let (kind, theta) = chain(sequence, &cuts, penalty)?;
                Some((cost, kind, theta))
            })
            .collect();
    let min_cost = found.iter().map(|one| one.0).fold(f64::INFINITY, f64::min);
    // Each chain costs a complete fit.
    found.retain(|one| one.0 <= min_cost || one.1.pieces() <= FEW_PIECES);
    found.into_iter().map(|(_, kind, theta)| (kind, theta)).collect()
}

/// The chain whose pieces begin at the cuts, each a line or an arc, whichever has the smaller penalised cost.
fn chain(sequence: &Sequence, cuts: &[usize], penalty: f64) -> Option<(ContourKind, Vec<f64>)> {
    let count = cuts.len();
    let is_closed = sequence.is_closed;
    let run = |k: usize| {
        let (from, to) = (cuts[k], cuts[(k + 1) % count]);
        // The last run of a closed sequence continues past its end, which the cumulated sums allow for. That
        // of an open sequence ends there.
        (from, if to <= from { to + sequence.bins } else { to })
    };
    let arcs: Vec<bool> = (0..count)
        .map(|k| {
            let (from, to) = run(k);
            let sums = sequence.sums(from, to);
            sums.arc() + penalty < sums.line().2
        })
        .collect();
    if !arcs.contains(&true) && (is_closed || count < 2) {
        return None;
    }
    // At the ends of an arc there are no two lines to intersect: use the mean of the neighbouring points.
    let vertex = |k: usize| {
        let n = sequence.count();
        let at = sequence.first[cuts[k]];
        let near = [sequence.points[(at + n - 1) % n], sequence.points[at]];
        mean(&near)
    };
    let crossings = corners(sequence, cuts);
    let mut vertices: Vec<[f64; 2]> = (0..count)
        .map(|k| if arcs[k] || arcs[(k + count - 1) % count] { vertex(k) } else { crossings[k] })
        .collect();
    if !is_closed {
        vertices[0] = sequence.points[0];
        vertices.push(sequence.points[sequence.count() - 1]);
    }
    let mut theta: Vec<f64> = vertices.iter().flatten().copied().collect();
    for k in (0..count).filter(|&k| arcs[k]) {
        let (from, to) = run(k);
        let (a, b) = (vertices[k], vertices[(k + 1) % vertices.len()]);
        theta.push(bulge_through(sequence, from, to, a, b));
    }
    let kind = ContourKind::Chain { arcs, closed: is_closed };
    Some((kind, theta))
}

/// Bulge of the arc between two vertices through the middle of a run: sagitta divided by half the chord.
///
/// It is kept away from zero, where the radius is infinite, and below 3, almost a full circle.
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
    if bulge.abs() < 1e-3 { 1e-3 } else { bulge.clamp(-3.0, 3.0) }
}
