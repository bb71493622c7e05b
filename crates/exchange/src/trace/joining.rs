//! Joins pieces of one line or circle: at junctions, and over the gaps between dashes.

use super::moments::{Fit, Moments, Shape};
use super::pieces::{LineScale, MAX_RADIUS, PATH_SIGMA, Piece, PieceGraph};
use planish_solid::views::{Curve2, distance};
use std::f64::consts::{PI, TAU};

/// Maximum number of points of a piece between two parts of one line that need not fit it.
const MAX_BRIDGE: usize = 14;
/// Increase of Σ r²/σ² up to which two pieces are one.
const SAME_CURVE: f64 = 30.0;
/// Maximum distance of a point from the joint curve, in σ.
const MAX_OFF: f64 = 2.5;
/// Maximum cosine between the directions in which two pieces leave a junction, if one continues the other.
const OPPOSITE: f64 = -0.8;
/// Maximum gap between dashes, in widths of the line and in pixels.
const MAX_GAP: [f64; 2] = [9.0, 14.0];
/// Maximum ratio of gaps of a line, and pixels by which they may differ in addition.
const GAP_RATIO: f64 = 1.5;
const GAP_SLACK: f64 = 2.0;
/// Number of dashes that a crossing line may join to one.
const MAX_DASHES: f64 = 2.2;
/// Maximum length of a dash between two other lines, in usual dashes.
const MAX_LONE_DASH: f64 = 1.3;
/// Largest part of a dashed circle that may be missing, in gaps.
const CLOSING_GAPS: f64 = 2.2;

/// A piece, and 0 for its first or 1 for its last end.
type PieceEnd = (usize, usize);

/// Maximum gap between dashes, in pixels.
pub(super) fn max_gap(scale: LineScale) -> f64 {
    (MAX_GAP[0] * scale.width).max(MAX_GAP[1])
}

impl PieceGraph {
    /// Joins pieces that continue each other at junctions.
    pub(super) fn join_at_nodes(&mut self, scale: LineScale) {
        let dash = MAX_LONE_DASH * self.usual_dash(scale);
        for node in 0..self.nodes.len() {
            loop {
                let ends = self.ends_at(node);
                let mut best: Option<(f64, [PieceEnd; 2], Fit)> = None;
                for (k, a) in ends.iter().enumerate() {
                    for b in &ends[k + 1..] {
                        if !self.is_line_with_dash(a.0, b.0, dash)
                            && let Some((cost, fit)) = self.continues(*a, *b)
                            && best.as_ref().is_none_or(|best| cost < best.0)
                        {
                            best = Some((cost, [*a, *b], fit));
                        }
                    }
                }
                let Some((_, [a, b], fit)) = best else { break };
                self.join(a, b, fit, None);
            }
        }
        for k in 0..self.pieces.len() {
            self.join_over(k);
        }
    }

    /// Whether one piece may be a dash, and the other a visible line that ends at a hidden one.
    fn is_line_with_dash(&self, a: usize, b: usize, dash: f64) -> bool {
        let [first, second] = [a, b].map(|k| {
            let piece = &self.pieces[k];
            let is_short = piece.raw_curve().length() <= dash;
            (piece.nodes.contains(&None) && is_short, !piece.nodes.contains(&None) && !is_short)
        });
        a != b && (first.0 && second.1 || second.0 && first.1)
    }

    /// Joins the lines at both ends of a short piece if they are one: near junctions, few points of the short
    /// piece are accurate.
    fn join_over(&mut self, k: usize) {
        let piece = &self.pieces[k];
        let [Some(from), Some(to)] = piece.nodes else { return };
        if piece.is_dropped || piece.is_closed || piece.raw.len() > MAX_BRIDGE || from == to {
            return;
        }
        let beside = |node: usize| self.ends_at(node).into_iter().filter(|end| end.0 != k);
        let pairs = beside(from).flat_map(|a| beside(to).map(move |b| (a, b)));
        let joints = pairs.filter_map(|(a, b)| Some((self.continues(a, b)?, a, b)));
        let lines = joints.filter(|((_, fit), a, b)| a.0 != b.0 && matches!(fit.shape, Shape::Line(..)));
        if let Some(((_, fit), a, b)) = lines.min_by(|p, q| p.0.0.total_cmp(&q.0.0)) {
            let bridge = &mut self.pieces[k];
            bridge.moments = Moments::default();
            bridge.points.clear();
            self.join(a, (k, 0), fit, None);
            self.join(a, b, fit, None);
        }
    }

    /// Ends of pieces at a node: a piece, and 0 or 1.
    fn ends_at(&self, node: usize) -> Vec<PieceEnd> {
        let ends = |k: usize| {
            let piece = &self.pieces[k];
            (0..2).filter(move |e| !piece.is_closed && piece.nodes[*e] == Some(node)).map(move |e| (k, e))
        };
        self.members[node].iter().copied().filter(|k| !self.pieces[*k].is_dropped).flat_map(ends).collect()
    }

    /// The joint curve of two pieces of which one continues the other, and how much worse it fits.
    fn continues(&self, a: PieceEnd, b: PieceEnd) -> Option<(f64, Fit)> {
        let (first, second) = (&self.pieces[a.0], &self.pieces[b.0]);
        if a.0 == b.0 {
            // Both ends of a circle.
            let is_circle = matches!(first.shape, Shape::Circle(..));
            return is_circle.then_some((0.0, Fit { shape: first.shape, squares: first.squares }));
        }
        let (u, v) = (first.outwards(a.1), second.outwards(b.1));
        if u[0] * v[0] + u[1] * v[1] > OPPOSITE {
            return None;
        }
        joint(first, second, false)
    }

    /// Joins two ends; `gap` is the distance between two dashes.
    pub(super) fn join(&mut self, a: PieceEnd, b: PieceEnd, fit: Fit, gap: Option<f64>) {
        if a.0 == b.0 {
            self.pieces[a.0].is_closed = true;
            self.pieces[a.0].gaps.extend(gap);
            return;
        }
        let second = self.pieces[b.0].clone();
        self.pieces[b.0].is_dropped = true;
        let first = &mut self.pieces[a.0];
        first.shape = fit.shape;
        first.squares = fit.squares;
        first.moments = first.moments.plus(&second.moments);
        first.points.extend(second.points);
        first.raw.extend(second.raw);
        first.gaps.extend(second.gaps);
        first.gaps.extend(gap);
        first.nodes[a.1] = second.nodes[1 - b.1];
        first.ends[a.1] = second.ends[1 - b.1];
        for members in self.members.iter_mut().filter(|m| m.contains(&b.0)) {
            members.iter_mut().filter(|k| **k == b.0).for_each(|k| *k = a.0);
            members.sort_unstable();
            members.dedup();
        }
    }

    /// The length of a usual dash: of pieces with two free ends; the longest gap if there are none.
    pub(super) fn usual_dash(&self, scale: LineScale) -> f64 {
        let dashes = self.pieces.iter().filter(|p| !p.is_dropped && !p.is_closed && p.nodes == [None; 2]);
        let mut lengths: Vec<f64> = dashes.map(|p| distance(p.ends[0], p.ends[1])).collect();
        lengths.sort_by(f64::total_cmp);
        lengths.get(lengths.len() * 3 / 4).copied().unwrap_or_else(|| max_gap(scale))
    }

    /// Joins dashes.
    pub(super) fn join_dashes(&mut self, scale: LineScale) {
        let dash = self.usual_dash(scale);
        let max_gap = max_gap(scale);
        loop {
            // A gap may begin where a dash meets another line.
            let free: Vec<PieceEnd> = (self.pieces.iter().enumerate())
                .filter(|(_, p)| {
                    !p.is_dropped && !p.is_closed && (p.nodes.contains(&None) || !p.gaps.is_empty())
                })
                .flat_map(|(k, _)| [(k, 0), (k, 1)])
                .collect();
            let mut found: Vec<(f64, PieceEnd, PieceEnd, Fit)> = Vec::new();
            for (k, a) in free.iter().enumerate() {
                for b in &free[k + 1..] {
                    if let Some((gap, fit)) = self.dash_gap(*a, *b, [dash, max_gap], scale) {
                        found.push((gap, *a, *b, fit));
                    }
                }
            }
            // Of several continuations the nearest; each end once in a round.
            found.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
            let mut is_used = vec![false; self.pieces.len()];
            let mut count = 0;
            for (gap, a, b, fit) in found {
                if !is_used[a.0] && !is_used[b.0] {
                    is_used[a.0] = true;
                    is_used[b.0] = true;
                    self.join(a, b, fit, Some(gap));
                    count += 1;
                }
            }
            if count == 0 {
                break;
            }
        }
        self.join_dashed_arcs(max_gap);
        self.close_dashed_circles(max_gap);
    }

    /// Joins parts of dashed circles over larger gaps, such as those of a dash that was lost.
    fn join_dashed_arcs(&mut self, max_gap: f64) {
        let is_part = |p: &Piece| {
            let is_dashed = !p.gaps.is_empty() || p.nodes == [None; 2];
            !p.is_dropped && !p.is_closed && is_dashed && matches!(p.shape, Shape::Circle(..))
        };
        for a in 0..self.pieces.len() {
            for b in 0..self.pieces.len() {
                let (first, second) = (&self.pieces[a], &self.pieces[b]);
                // The longer one takes the other.
                let is_longer = (first.moments.n, b) > (second.moments.n, a);
                if a == b || !is_longer || !is_part(first) || !is_part(second) || first.gaps.len() < 2 {
                    continue;
                }
                let pairs = [(0, 0), (0, 1), (1, 0), (1, 1)];
                let off = |(i, j): &PieceEnd| distance(first.ends[*i], second.ends[*j]);
                let Some((i, j)) = pairs.into_iter().min_by(|p, q| off(p).total_cmp(&off(q))) else {
                    continue;
                };
                let is_free = first.nodes[i].is_none() && second.nodes[j].is_none();
                if is_free
                    && off(&(i, j)) <= 2.0 * max_gap
                    && let Some((_, fit)) = joint(first, second, false)
                {
                    self.join((a, i), (b, j), fit, Some(max_gap));
                }
            }
        }
    }

    /// Closes dashed circles of which at most about two gaps are missing: their ends may be in a gap.
    fn close_dashed_circles(&mut self, max_gap: f64) {
        for piece in self.pieces.iter_mut().filter(|p| !p.is_dropped && !p.is_closed && p.gaps.len() > 1) {
            let Curve2::Arc { radius, sweep, .. } = piece.raw_curve() else { continue };
            let gap = piece.gaps.iter().copied().fold(0.0, f64::max).min(max_gap);
            piece.is_closed = radius * (TAU - sweep) <= CLOSING_GAPS * gap + 4.0 && sweep > PI;
        }
    }

    /// The gap between two free ends if the pieces are dashes of one curve.
    ///
    /// `longest` are the length of a usual dash and the maximum gap.
    fn dash_gap(
        &self,
        a: PieceEnd,
        b: PieceEnd,
        [dash, max_gap]: [f64; 2],
        scale: LineScale,
    ) -> Option<(f64, Fit)> {
        let (first, second) = (&self.pieces[a.0], &self.pieces[b.0]);
        // A visible line may go on as a hidden one. The ink of a crossing line joins two dashes.
        let is_too_long = |p: &&Piece| {
            // Both ends of a dash are rarely at other lines.
            let is_closed = !p.nodes.contains(&None);
            let longest =
                if is_closed { MAX_LONE_DASH * dash } else { MAX_DASHES * dash + max_gap.min(dash) };
            p.gaps.is_empty() && p.raw_curve().length() > longest + scale.width
        };
        if [first, second].iter().any(is_too_long) {
            return None;
        }
        let (p, q) = (first.ends[a.1], second.ends[b.1]);
        // Skeletons end half a width before the dash does.
        let gap = distance(p, q) - scale.width;
        if gap > max_gap || gap < 0.5 {
            return None;
        }
        let known: Vec<f64> = first.gaps.iter().chain(&second.gaps).copied().collect();
        if known.iter().any(|k| k.max(gap) > GAP_RATIO * k.min(gap) + GAP_SLACK) {
            return None;
        }
        // Where a dash meets another line, the gap must be known.
        let is_free = first.nodes[a.1].is_none() && second.nodes[b.1].is_none();
        if !is_free && known.is_empty() {
            return None;
        }
        if a.0 == b.0 {
            let is_circle = matches!(first.shape, Shape::Circle(..)) && first.gaps.len() > 1;
            return is_circle.then_some((gap, Fit { shape: first.shape, squares: first.squares }));
        }
        let step = [q[0] - p[0], q[1] - p[1]];
        let length = step[0].hypot(step[1]).max(1e-9);
        let (u, v) = (first.outwards(a.1), second.outwards(b.1));
        // Along the gap, and towards each other. Directions of short dashes of a small circle differ.
        let is_ahead = -(u[0] * step[0] + u[1] * step[1]) > 0.8 * length
            && v[0] * step[0] + v[1] * step[1] > 0.8 * length;
        if !is_ahead {
            return None;
        }
        joint(first, second, true).map(|(_, fit)| (gap, fit))
    }
}

impl Piece {
    /// Direction from one of its ends into the piece.
    pub(super) fn outwards(&self, end: usize) -> [f64; 2] {
        let (from, to) = (self.ends[end], self.ends[1 - end]);
        let chord = match self.shape {
            // The tangent that points into the piece.
            Shape::Circle(..) => {
                let near = self.points.iter().min_by(|a, b| {
                    // A point a few pixels from the end.
                    let off = |p: &[f64; 2]| (distance(*p, from) - 4.0).abs();
                    off(a).total_cmp(&off(b))
                });
                let near = near.copied().unwrap_or(to);
                let normal = self.shape.normal(from);
                let along = [-normal[1], normal[0]];
                let sign = (near[0] - from[0]) * along[0] + (near[1] - from[1]) * along[1];
                return if sign < 0.0 { along.map(|c| -c) } else { along };
            }
            Shape::Line(..) => [to[0] - from[0], to[1] - from[1]],
        };
        let length = chord[0].hypot(chord[1]).max(1e-9);
        chord.map(|c| c / length)
    }
}

/// The joint curve of two pieces, if it fits both.
fn joint(first: &Piece, second: &Piece, are_dashes: bool) -> Option<(f64, Fit)> {
    // A hidden line may go on as a visible one.
    if first.is_thin != second.is_thin {
        return None;
    }
    let moments: Moments = first.moments.plus(&second.moments);
    let is_line = |p: &Piece| matches!(p.shape, Shape::Line(..));
    let (line, circle) = match (is_line(first), is_line(second)) {
        (true, true) if !are_dashes => (moments.line(), None),
        (false, false) => (None, moments.circle()),
        (true, true) => {
            let is_round = |fit: &Fit| matches!(fit.shape, Shape::Circle(_, r) if r <= MAX_RADIUS);
            (moments.line(), moments.circle().filter(is_round))
        }
        // A short end of an arc looks straight, and a short end of a line curved. So do dashes.
        (first_is_line, _) => match (first.moments.n >= second.moments.n) == first_is_line {
            true => (moments.line(), None),
            false => (None, moments.circle()),
        },
    };
    let square = PATH_SIGMA * PATH_SIGMA;
    let fits = [line, circle].into_iter().flatten().filter_map(|fit| {
        let price = if matches!(fit.shape, Shape::Circle(..)) { 10.0 } else { 0.0 };
        let cost = price + (fit.squares - first.squares - second.squares) / square;
        let limit = MAX_OFF * PATH_SIGMA;
        let is_near = || first.points.iter().chain(&second.points).all(|p| fit.shape.off(*p).abs() <= limit);
        (cost <= SAME_CURVE && is_near()).then_some((cost, fit))
    });
    fits.min_by(|a, b| a.0.total_cmp(&b.0))
}
