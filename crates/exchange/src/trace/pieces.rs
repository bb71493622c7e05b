//! Lines and arcs along the paths of a skeleton.
//!
//! Points of the skeleton move to the middle of the ink across the path. The path is then divided into lines
//! and arcs: of all divisions, that with the smallest Σ r²/σ² + the price of its pieces (a BIC). Points near
//! ends of pieces count only for long pieces, because skeletons round corners off.

use super::ink::Ink;
use super::moments::{Fit, Moments, Shape};
use super::skeleton::{PixelGraph, PixelPath};

/// Price of a line and of an arc, in units of σ² (two parameters and the place of its end, or three). With
/// lower prices, lines of black and white pixels become stairs; with higher ones, small chamfers are lost.
const PRICE: [f64; 2] = [30.0, 40.0];
/// σ of points for the division of paths, in pixels: errors of neighbouring pixels are correlated.
pub(super) const PATH_SIGMA: f64 = 0.35;
/// Maximum radius of an arc, in pixels.
pub(super) const MAX_RADIUS: f64 = 1500.0;
/// σ of points near the ends of pieces, in pixels, and their maximum cost. Without it, small chamfers would
/// be ends of the lines beside them.
const END_SIGMA: f64 = 0.7;
const MAX_END_COST: f64 = 20.0;
/// Minimum number of points of an arc: near junctions, a few points are off by a pixel.
const MIN_ARC_POINTS: f64 = 9.0;
/// Price of a whole circle of a closed path, which has no ends.
const CIRCLE_PRICE: f64 = 20.0;
/// Minimum number of points of a line, and of lines, that show whether places are rounded, and how well the
/// fractions of pixels must agree.
const MIN_ROUNDED_POINTS: f64 = 12.0;
const MIN_ROUNDED_LINES: usize = 6;
const ROUNDED: f64 = 0.75;
/// σ of places that are rounded to whole pixels: 1/√12.
const ROUNDING_SIGMA: f64 = 0.35;
/// Maximum number of places at which a path may be divided.
const MAX_CUTS: usize = 400;
/// Distance of coverage samples across a line, in pixels.
const STEP: f64 = 0.25;

/// A line or an arc.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    pub(super) shape: Shape,
    pub(super) moments: Moments,
    pub(super) squares: f64,
    /// Its points, without those near its ends.
    pub(super) points: Vec<[f64; 2]>,
    /// All of its points.
    pub(super) raw: Vec<[f64; 2]>,
    /// Junctions or corners at its ends.
    pub(super) nodes: [Option<usize>; 2],
    /// Where its pixels begin and end.
    pub(super) ends: [[f64; 2]; 2],
    pub(super) is_closed: bool,
    /// Lengths of the gaps between its dashes; empty for a line without gaps.
    pub(super) gaps: Vec<f64>,
    /// Whether it has gaps or a free end.
    pub(super) is_hidden: bool,
    /// Whether it has been joined to another piece.
    pub(super) is_dropped: bool,
    /// Whether it is thinner than visible lines; none if the picture has one width of lines.
    pub(super) is_thin: Option<bool>,
}

/// Pieces that meet at nodes.
#[derive(Debug, Clone, Default)]
pub(super) struct PieceGraph {
    pub(super) pieces: Vec<Piece>,
    pub(super) nodes: Vec<[f64; 2]>,
    /// Pieces that end at each node or pass through it.
    pub(super) members: Vec<Vec<usize>>,
}

/// What is known about the lines of a picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct LineScale {
    /// Width in pixels.
    pub(super) width: f64,
    /// σ of a point of the middle of a line, in pixels.
    pub(super) sigma: f64,
}

impl PieceGraph {
    pub(super) fn new(graph: &PixelGraph, ink: &Ink, scale: LineScale) -> Self {
        let mut made = Self { pieces: Vec::new(), nodes: graph.nodes.clone(), members: Vec::new() };
        for path in &graph.paths {
            made.add(path, ink, scale);
        }
        made.members = vec![Vec::new(); made.nodes.len()];
        for (k, piece) in made.pieces.iter().enumerate() {
            piece.nodes.iter().flatten().for_each(|n| made.members[*n].push(k));
        }
        made.members.iter_mut().for_each(|members| members.dedup());
        made
    }

    /// Lets y run upwards.
    pub(super) fn flip(&mut self, rows: usize) {
        let flip = |p: &mut [f64; 2]| p[1] = rows as f64 - 1.0 - p[1];
        self.nodes.iter_mut().for_each(flip);
        for piece in &mut self.pieces {
            piece.points.iter_mut().chain(&mut piece.raw).chain(&mut piece.ends).for_each(flip);
            piece.fit_again();
        }
    }

    /// The scale with the σ of lines that are drawn at whole pixels, if they are: programs may round the
    /// places of lines along an axis, but not those of circles.
    pub(super) fn with_rounding(&self, scale: LineScale) -> LineScale {
        let places: Vec<f64> = (self.pieces.iter())
            .filter(|p| !p.is_dropped && p.moments.n >= MIN_ROUNDED_POINTS)
            .filter_map(|p| match p.shape {
                Shape::Line(at, along) => (0..2).find(|k| along[*k].abs() < 0.01).map(|k| at[k]),
                Shape::Circle(..) => None,
            })
            .collect();
        // Rounded places are whole or half pixels, all of one kind: the angles 2π·place agree.
        let [cos, sin] = places.iter().fold([0.0, 0.0], |[c, s], place| {
            let (sin, cos) = (std::f64::consts::TAU * place).sin_cos();
            [c + cos, s + sin]
        });
        let agreement = cos.hypot(sin) / places.len().max(1) as f64;
        match places.len() >= MIN_ROUNDED_LINES && agreement > ROUNDED {
            true => LineScale { sigma: scale.sigma.max(ROUNDING_SIGMA), ..scale },
            false => scale,
        }
    }

    fn add(&mut self, path: &PixelPath, ink: &Ink, scale: LineScale) {
        let mut path = path.clone();
        let is_closed = path.is_closed();
        if is_closed {
            begin_at_straight(&mut path.pixels);
        }
        let points = centred(&path, ink, scale.width);
        let sums = prefix_sums(&points);
        if is_closed && let Some(fit) = sums[points.len()].circle() {
            let divided = divided(&points, &sums, scale).1;
            if fit.squares / PATH_SIGMA.powi(2) + CIRCLE_PRICE <= divided {
                let ends = [points[0]; 2];
                let moments = sums[points.len()];
                let nodes = [None; 2];
                self.pieces.push(Piece { is_closed: true, ..piece(fit, moments, points, nodes, ends) });
                return;
            }
        }
        let (cuts, _) = divided(&points, &sums, scale);
        let mut nodes: Vec<Option<usize>> = Vec::new();
        for (k, cut) in cuts.iter().enumerate() {
            let outer = if k == 0 { path.nodes[0] } else { path.nodes[1] };
            let is_inner = k > 0 && k + 1 < cuts.len();
            // The first and the last cut of a closed path are one corner.
            let own = match (is_inner, is_closed) {
                (true, _) => Some(self.add_node(points[*cut])),
                (false, true) if k == 0 => Some(self.add_node(points[0])),
                (false, true) => nodes[0],
                _ => outer,
            };
            nodes.push(own);
        }
        for (k, pair) in cuts.windows(2).enumerate() {
            let [from, to] = [pair[0], pair[1]];
            let inner = trimmed(from, to, scale.width);
            let Some((fit, moments)) = best_fit(&sums, inner).map(|(fit, m, _)| (fit, m)) else {
                continue;
            };
            let ends = [points[from], points[to]];
            let own = points[inner.0..inner.1].to_vec();
            let raw = points[from..=to].to_vec();
            let nodes = [nodes[k], nodes[k + 1]];
            self.pieces.push(Piece { raw, ..piece(fit, moments, own, nodes, ends) });
        }
    }

    fn add_node(&mut self, at: [f64; 2]) -> usize {
        self.nodes.push(at);
        self.nodes.len() - 1
    }
}

impl Piece {
    /// Fits the shape to moved points.
    fn fit_again(&mut self) {
        self.moments = Moments::default();
        self.points.iter().for_each(|p| self.moments.add(*p));
        let fit = match self.shape {
            Shape::Line(..) => self.moments.line(),
            Shape::Circle(..) => self.moments.circle(),
        };
        if let Some(fit) = fit {
            self.shape = fit.shape;
            self.squares = fit.squares;
        }
    }
}

fn piece(
    fit: Fit,
    moments: Moments,
    points: Vec<[f64; 2]>,
    nodes: [Option<usize>; 2],
    ends: [[f64; 2]; 2],
) -> Piece {
    Piece {
        shape: fit.shape,
        squares: fit.squares,
        moments,
        raw: points.clone(),
        points,
        nodes,
        ends,
        is_closed: false,
        gaps: Vec::new(),
        is_hidden: false,
        is_dropped: false,
        is_thin: None,
    }
}

/// Lets a closed path begin where it is straight, far from the corners at which it is divided.
fn begin_at_straight(pixels: &mut [[i32; 2]]) {
    let n = pixels.len();
    let reach = (n / 8).clamp(2, 8);
    let turn = |k: usize| {
        let [a, b, c] = [(k + n - reach) % n, k, (k + reach) % n].map(|k| pixels[k]);
        let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - b[0], c[1] - b[1]]);
        f64::from(u[0] * v[1] - u[1] * v[0]).atan2(f64::from(u[0] * v[0] + u[1] * v[1])).abs()
    };
    // In the middle of the longest straight part.
    let is_straight = |k: usize| turn(k) < 0.1;
    let mut best = (0, 0);
    let mut length = 0;
    for k in 0..2 * n {
        length = if is_straight(k % n) { length + 1 } else { 0 };
        if length > best.0 && length <= n {
            best = (length, (k + n - length / 2) % n);
        }
    }
    pixels.rotate_left(best.1);
}

/// The pixels of a path, moved across it into the middle of the ink.
pub(super) fn centred(path: &PixelPath, ink: &Ink, width: f64) -> Vec<[f64; 2]> {
    let mut raw: Vec<[f64; 2]> = path.pixels.iter().map(|p| p.map(f64::from)).collect();
    let is_closed = path.is_closed();
    if is_closed {
        raw.push(raw[0]);
    }
    let n = raw.len();
    let turn = n.max(2) - 1;
    let reach = (width.ceil() as usize + 2).min(turn - usize::from(turn > 1));
    let moved = |k: usize| {
        let (a, b) = match is_closed {
            true => (raw[(k + turn - reach) % turn], raw[(k + reach) % turn]),
            false => (raw[k.saturating_sub(reach)], raw[(k + reach).min(n - 1)]),
        };
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = along[0].hypot(along[1]);
        if length < 1.0 {
            return raw[k];
        }
        let normal = [-along[1] / length, along[0] / length];
        let off = middle_of_ink(ink, raw[k], normal, 0.5 * width + 2.0);
        [raw[k][0] + off * normal[0], raw[k][1] + off * normal[1]]
    };
    (0..n).map(moved).collect()
}

/// Offset of the middle of the ink along a direction.
fn middle_of_ink(ink: &Ink, p: [f64; 2], along: [f64; 2], reach: f64) -> f64 {
    let coverage = |t: f64| ink.at([p[0] + t * along[0], p[1] + t * along[1]]);
    let count = (reach / STEP) as i32;
    // Pixels of the skeleton may be in the fainter row of a line.
    let peaks = (-4..=4).map(|k| STEP * f64::from(k)).map(|t| (coverage(t), t));
    let (own, peak) = peaks.fold((f64::MIN, 0.0), |best: (f64, f64), (c, t)| {
        let is_higher = c > best.0 + 1e-6 || c > best.0 - 1e-6 && t.abs() < best.1.abs();
        if is_higher { (c, t) } else { best }
    });
    let (mut sum, mut first) = (own, own * peak);
    for side in [1.0, -1.0] {
        let mut least = own;
        for k in 1..=count {
            let t = peak + side * STEP * f64::from(k);
            let c = coverage(t);
            // Beyond the edge of the line, or at another line.
            if c < 0.05 || (least < 0.6 && c > least + 0.05) {
                break;
            }
            least = least.min(c);
            sum += c;
            first += c * t;
        }
    }
    if sum > 0.0 { (first / sum).clamp(-1.2, 1.2) } else { 0.0 }
}

/// Moments of the first k points, for each k.
fn prefix_sums(points: &[[f64; 2]]) -> Vec<Moments> {
    let mut sums = vec![Moments::default()];
    for p in points {
        let mut next = sums[sums.len() - 1];
        next.add(*p);
        sums.push(next);
    }
    sums
}

/// The range of points of a piece without those near its ends.
fn trimmed(from: usize, to: usize, width: f64) -> (usize, usize) {
    let count = to + 1 - from;
    let trim = (0.5 * width + 1.5).ceil() as usize;
    let trim = trim.min(count.saturating_sub(4) / 4);
    (from + trim, to + 1 - trim)
}

/// The line or the arc of a range of points, and its cost.
fn best_fit(sums: &[Moments], (from, to): (usize, usize)) -> Option<(Fit, Moments, f64)> {
    let moments = sums[to].minus(&sums[from]);
    let cost = |fit: &Fit, price: f64| fit.squares / (PATH_SIGMA * PATH_SIGMA) + price;
    let line = moments.line().map(|fit| (fit, cost(&fit, PRICE[0])));
    let circle = match moments.n >= MIN_ARC_POINTS {
        true => moments.circle().filter(is_round).map(|fit| (fit, cost(&fit, PRICE[1]))),
        false => None,
    };
    let best = line.into_iter().chain(circle).min_by(|a, b| a.1.total_cmp(&b.1));
    best.map(|(fit, cost)| (fit, moments, cost))
}

/// Whether a circle is small enough to be distinguished from a line.
fn is_round(fit: &Fit) -> bool {
    matches!(fit.shape, Shape::Circle(_, radius) if radius <= MAX_RADIUS)
}

/// Cost of the points near the ends of a piece, which are less accurate.
fn end_cost<'a>(fit: &Fit, points: impl Iterator<Item = &'a [f64; 2]>) -> f64 {
    points.map(|p| (fit.shape.off(*p) / END_SIGMA).powi(2).min(MAX_END_COST)).sum()
}

/// Places at which a path is divided, from its first to its last point, and the cost.
fn divided(points: &[[f64; 2]], sums: &[Moments], scale: LineScale) -> (Vec<usize>, f64) {
    let last = points.len() - 1;
    let step = points.len().div_ceil(MAX_CUTS).max(1);
    let mut cuts: Vec<usize> = (0..last).step_by(step).collect();
    cuts.push(last);
    let mut best: Vec<(f64, usize)> = vec![(0.0, 0)];
    for to in 1..cuts.len() {
        let mut own = (f64::INFINITY, 0);
        for from in (0..to).rev() {
            // A piece alone costs no less than its price.
            if best[from].0 + PRICE[0] >= own.0 {
                continue;
            }
            let range = trimmed(cuts[from], cuts[to], scale.width);
            if let Some((fit, _, cost)) = best_fit(sums, range) {
                let ends = points[cuts[from]..range.0].iter().chain(&points[range.1..=cuts[to]]);
                let cost = best[from].0 + cost + end_cost(&fit, ends);
                if cost < own.0 {
                    own = (cost, from);
                }
            }
        }
        best.push(own);
    }
    let cost = best[best.len() - 1].0;
    let mut found = vec![cuts.len() - 1];
    while found[found.len() - 1] > 0 {
        found.push(best[found[found.len() - 1]].1);
    }
    found.reverse();
    (found.into_iter().map(|k| cuts[k]).collect(), cost)
}
