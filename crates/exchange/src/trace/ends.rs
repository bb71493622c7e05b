//! Where pieces end: at the crossing with the pieces that they meet.

use super::joining::max_gap;
use super::moments::Shape;
use super::pieces::{LineScale, Piece, PieceGraph};
use planish_solid::views::{Curve2, distance, nearest_on_curve};

/// Pixels beyond the largest gap of a dashed line within which it may end.
const BEYOND: f64 = 3.0;
/// Largest distance from a circle to a line that touches it, in pixels and in radii.
const TANGENT: [f64; 2] = [0.9, 0.12];

impl PieceGraph {
    /// Extends free ends to the pieces that they run to; gives all ends a node. `dash` is the maximum
    /// length of a dash.
    pub(super) fn close_ends(&mut self, dash: f64, scale: LineScale) {
        let usual = self.largest_gap(scale);
        let length = |piece: &Piece| distance(piece.ends[0], piece.ends[1]);
        for piece in &mut self.pieces {
            // Visible lines end at other lines, or where a face becomes smooth.
            piece.is_hidden |= !piece.gaps.is_empty()
                || (!piece.is_closed && piece.nodes.contains(&None) && length(piece) <= dash);
        }
        for k in 0..self.pieces.len() {
            for end in 0..2 {
                let piece = &self.pieces[k];
                if piece.is_dropped || piece.is_closed || piece.nodes[end].is_some() {
                    continue;
                }
                let gap = piece.gaps.iter().copied().fold(usual, f64::max);
                let reach = gap + 1.5 * scale.width + BEYOND;
                let found = self.nearest_crossing(k, end, reach);
                let node = self.nodes.len();
                let Some((at, other)) = found else {
                    let into = piece.outwards(end);
                    let at = [0, 1].map(|c| piece.ends[end][c] - 0.5 * scale.width * into[c]);
                    self.nodes.push(at);
                    self.members.push(vec![k]);
                    self.pieces[k].nodes[end] = Some(node);
                    continue;
                };
                self.nodes.push(at);
                self.members.push(vec![k, other]);
                self.pieces[k].nodes[end] = Some(node);
                // The other one may end there as well.
                if let Some(e) = self.pieces[other].free_end_near(at, reach) {
                    self.pieces[other].nodes[e] = Some(node);
                }
            }
        }
    }

    /// The largest gap between dashes; that of the gap after a single dash is unknown.
    fn largest_gap(&self, scale: LineScale) -> f64 {
        let gaps = self.pieces.iter().filter(|p| !p.is_dropped).flat_map(|p| p.gaps.iter().copied());
        let largest = gaps.fold(0.0, f64::max);
        if largest > 0.0 { largest } else { max_gap(scale) }
    }

    /// The nearest crossing of a piece beyond its free end with another piece.
    pub(super) fn nearest_crossing(&self, own: usize, end: usize, reach: f64) -> Option<([f64; 2], usize)> {
        let piece = &self.pieces[own];
        let (from, into) = (piece.ends[end], piece.outwards(end));
        let mut best: Option<(f64, [f64; 2], usize)> = None;
        for (k, other) in self.pieces.iter().enumerate() {
            if k == own || other.is_dropped {
                continue;
            }
            for at in crossings(&piece.shape, &other.shape) {
                let step = [at[0] - from[0], at[1] - from[1]];
                let ahead = -(step[0] * into[0] + step[1] * into[1]);
                let length = step[0].hypot(step[1]);
                if length > reach || ahead < -1.5 {
                    continue;
                }
                // Within the other piece, or beyond a free end of it.
                let curve = other.raw_curve();
                let near = distance(nearest_on_curve(&curve, at), at);
                if near > 2.0 && other.free_end_near(at, reach).is_none() {
                    continue;
                }
                if best.is_none_or(|b| length < b.0) {
                    best = Some((length, at, k));
                }
            }
        }
        best.map(|(_, at, k)| (at, k))
    }

    /// Moves nodes to where their pieces meet; returns for each node whether two pieces touch there.
    pub(super) fn place_nodes(&mut self) {
        for node in 0..self.nodes.len() {
            let shapes = self.shapes_at(node);
            self.nodes[node] = meeting_point(&shapes, self.nodes[node]);
        }
    }

    pub(super) fn shapes_at(&self, node: usize) -> Vec<Shape> {
        let members = self.members[node].iter().filter(|k| !self.pieces[**k].is_dropped);
        members.map(|k| self.pieces[*k].shape).collect()
    }
}

impl Piece {
    /// The free end that is nearest to a place ahead of it.
    fn free_end_near(&self, at: [f64; 2], reach: f64) -> Option<usize> {
        let off = |e: usize| distance(self.ends[e], at);
        let nearest = if off(0) <= off(1) { 0 } else { 1 };
        (!self.is_closed && self.nodes[nearest].is_none() && off(nearest) <= reach).then_some(nearest)
    }

    /// A point between two ends of the piece: of an arc, one on the side with most points.
    pub(super) fn inner_point(&self, from: [f64; 2], to: [f64; 2]) -> [f64; 2] {
        let middle = |points: &[[f64; 2]]| points.get(points.len() / 2).copied().unwrap_or(self.ends[0]);
        let Shape::Circle(center, _) = self.shape else { return middle(&self.points) };
        let angle = |p: [f64; 2]| (p[1] - center[1]).atan2(p[0] - center[0]);
        let turn = |p: [f64; 2]| (angle(p) - angle(from)).rem_euclid(std::f64::consts::TAU);
        let sweep = turn(to);
        let (inside, outside): (Vec<[f64; 2]>, Vec<[f64; 2]>) =
            self.points.iter().copied().partition(|p| turn(*p) <= sweep);
        middle(if inside.len() >= outside.len() { &inside } else { &outside })
    }

    /// The curve between the places where its pixels end.
    pub(super) fn raw_curve(&self) -> Curve2 {
        match self.shape {
            Shape::Circle(center, radius) if self.is_closed => {
                Curve2::Arc { center, radius, start: 0.0, sweep: std::f64::consts::TAU }
            }
            _ => {
                let middle = self.inner_point(self.ends[0], self.ends[1]);
                self.shape.between(self.ends[0], middle, self.ends[1])
            }
        }
    }
}

/// The point of tangency of a line or circle and a circle that touch within the accuracy of pixels.
pub(super) fn tangent_point(a: &Shape, b: &Shape) -> Option<[f64; 2]> {
    let near = |off: f64, radius: f64| off.abs() <= TANGENT[0].min(TANGENT[1] * radius);
    match (a, b) {
        (line @ Shape::Line(..), Shape::Circle(c, r)) | (Shape::Circle(c, r), line @ Shape::Line(..)) => {
            near(line.off(*c).abs() - r, *r).then(|| line.nearest(*c))
        }
        (Shape::Circle(c, r), Shape::Circle(d, q)) => {
            let apart = distance(*c, *d);
            let is_outside = near(apart - r - q, r.min(*q));
            let is_inside = near(apart - (r - q).abs(), r.min(*q)) && apart > 1.0;
            (is_outside || is_inside).then(|| {
                // On the line through both centres.
                let sign = if is_inside && r < q { -1.0 } else { 1.0 };
                [0, 1].map(|k| c[k] + sign * r * (d[k] - c[k]) / apart)
            })
        }
        _ => None,
    }
}

/// The point nearest to all shapes, near a first guess.
fn meeting_point(shapes: &[Shape], guess: [f64; 2]) -> [f64; 2] {
    if let [a, b] = shapes
        && let Some(at) = tangent_point(a, b)
    {
        return at;
    }
    /// Weight of the first guess against a distance from a curve: σ of 0.1 and 2 pixels.
    const PRIOR: f64 = 0.0025;
    let mut at = guess;
    for _ in 0..8 {
        let mut m = [PRIOR, 0.0, PRIOR];
        let mut v = [PRIOR * (guess[0] - at[0]), PRIOR * (guess[1] - at[1])];
        for shape in shapes {
            let (off, n) = (shape.off(at), shape.normal(at));
            m = [m[0] + n[0] * n[0], m[1] + n[0] * n[1], m[2] + n[1] * n[1]];
            v = [v[0] - off * n[0], v[1] - off * n[1]];
        }
        let det = m[0] * m[2] - m[1] * m[1];
        let step = [(m[2] * v[0] - m[1] * v[1]) / det, (m[0] * v[1] - m[1] * v[0]) / det];
        at = [at[0] + step[0].clamp(-3.0, 3.0), at[1] + step[1].clamp(-3.0, 3.0)];
    }
    at
}

/// Crossings of two unbounded curves.
fn crossings(a: &Shape, b: &Shape) -> Vec<[f64; 2]> {
    match (a, b) {
        (Shape::Line(p, u), Shape::Line(q, v)) => {
            let cross = u[0] * v[1] - u[1] * v[0];
            // Nearly parallel lines cross nowhere in particular.
            if cross.abs() < 0.1 {
                return Vec::new();
            }
            let t = ((q[0] - p[0]) * v[1] - (q[1] - p[1]) * v[0]) / cross;
            vec![[p[0] + t * u[0], p[1] + t * u[1]]]
        }
        (line @ Shape::Line(_, u), Shape::Circle(c, r)) | (Shape::Circle(c, r), line @ Shape::Line(_, u)) => {
            let foot = line.nearest(*c);
            let off = distance(foot, *c);
            if off > r + 1.0 {
                return Vec::new();
            }
            let half = (r * r - off * off).max(0.0).sqrt();
            [-half, half].map(|t| [foot[0] + t * u[0], foot[1] + t * u[1]]).to_vec()
        }
        (Shape::Circle(c, r), Shape::Circle(d, q)) => {
            let apart = distance(*c, *d);
            if apart < 1.0 || apart > r + q + 1.0 || apart < (r - q).abs() - 1.0 {
                return Vec::new();
            }
            let along = (apart * apart + r * r - q * q) / (2.0 * apart);
            let half = (r * r - along * along).max(0.0).sqrt();
            let u = [(d[0] - c[0]) / apart, (d[1] - c[1]) / apart];
            [-half, half].map(|t| [c[0] + along * u[0] - t * u[1], c[1] + along * u[1] + t * u[0]]).to_vec()
        }
    }
}
