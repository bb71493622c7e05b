//! Coordinates of traced pieces that agree within their σ become the same, in a view and between views.
//!
//! 1. Lines that are parallel to an axis have one coordinate. Ends, centres and radii are further values.
//! 2. Values of one axis of the part are grouped; two lines side by side in one view stay apart.
//! 3. The groups change as little as their σ allow so that ends lie on circles, and circles reach the lines
//!    that show them in other views.

use super::consistent::{Equation, SOLVED, solved};
use super::ends::tangent_point;
use super::layout::{Extent, Layout, corners, layout_of};
use super::marks::PixelBox;
use super::moments::Shape;
use super::pieces::{LineScale, Piece, PieceGraph};
use planish_estimate::{Error, Result};
use planish_solid::drawing::ViewKind;
use planish_solid::views::{Curve2, distance};
use std::f64::consts::TAU;

/// Values at most this many σ apart are the same.
const SAME: f64 = 3.0;
/// The same for corners at rims of circles, and for radii: pixels, or σ of a line.
const RIM: [f64; 2] = [0.3, 1.2];
/// Maximum difference of sizes of views after alignment, relative to the largest size.
const MAX_MISFIT: f64 = 1e-3;
/// Slope of a line that is parallel to an axis: pixels over its length, in addition σ, and radians.
const PARALLEL: [f64; 3] = [0.35, 1.5, 0.12];
/// Largest change of a value by the equations, in σ and pixels.
const MAX_CHANGE: [f64; 2] = [4.0, 0.5];
/// How often equations that contradict others are left out.
const MAX_REPEATS: usize = 8;

/// A value of an axis.
#[derive(Debug, Clone)]
struct Value {
    /// 3 · view + axis of the view (0, 1), or 2 for a radius.
    owner: usize,
    at: f64,
    sigma: f64,
    /// The range of a line across the axis.
    range: Option<[f64; 2]>,
    /// Whether it is that of a corner at the rim of a circle, often close to an extreme of the circle.
    is_rim: bool,
    /// Number of its group, once it is known.
    group: usize,
}

/// Values, and which pieces and nodes have them.
struct Values {
    all: Vec<Value>,
    /// For each node and axis.
    nodes: Vec<[usize; 2]>,
    /// For each piece that is a circle: centre and radius.
    circles: Vec<Option<[usize; 3]>>,
    /// For each piece that is a line along an axis: the axis whose coordinate it has.
    axes: Vec<Option<usize>>,
}

/// A traced curve, its piece, and its view.
#[derive(Debug, Clone)]
pub(super) struct AlignedCurve {
    pub(super) curve: Curve2,
    pub(super) piece: usize,
}

/// The curves of all views, placed in rows and columns, in pixels with y upwards.
pub(super) fn aligned(graph: &PieceGraph, boxes: &[PixelBox], scale: LineScale) -> Result<Vec<AlignedCurve>> {
    let view_of = views_of(graph, boxes);
    let extents: Vec<Extent> = (0..boxes.len()).map(|v| extent_of(graph, &view_of, v)).collect();
    let layout = layout_of(&extents);
    let mut values = Values::new(graph, &view_of, scale);
    let frames = frames_of(&extents, layout.as_ref());
    let groups = values.grouped(&frames, scale);
    let sigmas: Vec<f64> = groups.iter().map(|g| g.1).collect();
    let start: Vec<f64> = groups.iter().map(|g| g.0).collect();
    let equations = equations(graph, &values, &frames, &start, &sigmas);
    let found = consistent(&start, &sigmas, equations);
    let places = layout.as_ref().map(|l| corners(l, &extents));
    let curves: Vec<AlignedCurve> = (0..graph.pieces.len())
        .filter(|k| !graph.pieces[*k].is_dropped)
        .filter_map(|k| {
            let v = view_of[k]?;
            // Values of the part to places on the sheet.
            let to_sheet = |axis: usize, value: f64| {
                let frame = frames[v][axis];
                match &places {
                    Some(places) => places[v][axis].round() + frame.sheet(value),
                    None => frame.sign * value + frame.offset,
                }
            };
            let node = |n: usize| [0, 1].map(|c| to_sheet(c, found[values.all[values.nodes[n][c]].group]));
            let curve = curve_of(graph, &values, &found, k, &node, &to_sheet)?;
            Some(AlignedCurve { curve, piece: k })
        })
        .collect();
    // Otherwise a view would be left out, and two views have more solids than three.
    let largest = frames.iter().flatten().map(|f| f.extent).fold(0.0, f64::max);
    for (v, own) in frames.iter().enumerate() {
        let bounds = curves.iter().filter(|c| view_of[c.piece] == Some(v)).map(|c| c.curve.bounds());
        let bounds = bounds.fold([[f64::MAX, f64::MIN]; 2], |all, b| {
            [0, 1].map(|k| [all[k][0].min(b[k][0]), all[k][1].max(b[k][1])])
        });
        let is_off = |k: usize| (bounds[k][1] - bounds[k][0] - own[k].extent).abs() > MAX_MISFIT * largest;
        if layout.as_ref().is_none_or(|l| l.kinds[v].is_none()) || is_off(0) || is_off(1) {
            let [[left, right], [bottom, top]] = extents[v];
            return Err(Error::input(format!(
                "expected two or three views of one part whose sizes agree, found a group of lines from \
                 pixel {left:.0} {bottom:.0} to {right:.0} {top:.0} (y upwards) that does not: crop the \
                 picture to the views, or use one with more pixels"
            )));
        }
    }
    Ok(curves)
}

/// The values that meet the equations; those that would change values by too much are left out.
fn consistent(start: &[f64], sigmas: &[f64], mut equations: Vec<Equation<'_>>) -> Vec<f64> {
    let change = |found: &[f64], k: usize| (found[k] - start[k]).abs() - MAX_CHANGE[0] * sigmas[k];
    for _ in 0..MAX_REPEATS {
        let before = equations.len();
        let Some((found, residuals)) = solved(start, sigmas, &equations) else { break };
        let largest = residuals.iter().copied().fold(0.0, f64::max);
        let is_moved: Vec<bool> = (0..found.len()).map(|k| change(&found, k) > MAX_CHANGE[1]).collect();
        if largest < 1e3 * SOLVED && !is_moved.contains(&true) {
            return found;
        }
        // Those that contradict others have large residuals.
        let mut left = residuals.iter();
        equations.retain(|e| {
            let is_met = left.next().is_some_and(|r| *r < (0.5 * largest).max(1e3 * SOLVED));
            is_met && (largest >= 1e3 * SOLVED || e(start).1.iter().all(|(k, _)| !is_moved[*k]))
        });
        if equations.len() == before {
            break;
        }
    }
    start.to_vec()
}

/// The curve of a piece with consistent values.
fn curve_of(
    graph: &PieceGraph,
    values: &Values,
    found: &[f64],
    k: usize,
    node: &impl Fn(usize) -> [f64; 2],
    to_sheet: &impl Fn(usize, f64) -> f64,
) -> Option<Curve2> {
    let piece = &graph.pieces[k];
    let ends = piece.nodes.map(|n| n.map(node));
    let Some(circle) = values.circles[k] else {
        let [Some(a), Some(b)] = ends else { return None };
        return (distance(a, b) > 0.0).then_some(Curve2::Segment(a, b));
    };
    let [x, y, radius] = circle.map(|c| found[values.all[c].group]);
    let center = [to_sheet(0, x), to_sheet(1, y)];
    let [Some(a), Some(b)] = ends.map(|e| e.filter(|_| !piece.is_closed)) else {
        return Some(Curve2::Arc { center, radius, start: 0.0, sweep: TAU });
    };
    // The direction is that of the traced arc.
    let Shape::Circle(own, _) = piece.shape else { return None };
    let raw = piece.nodes.map(|n| n.map_or(own, |n| graph.nodes[n]));
    let middle = piece.points.get(piece.points.len() / 2).copied().unwrap_or(own);
    let angle = |p: [f64; 2], c: [f64; 2]| (p[1] - c[1]).atan2(p[0] - c[0]);
    let turn = |a: f64, b: f64| (b - a).rem_euclid(TAU);
    let (s, m, e) = (angle(raw[0], own), angle(middle, own), angle(raw[1], own));
    let (from, to) = if is_first_arc(piece, [turn(s, e), turn(e, s)], turn(s, m)) { (a, b) } else { (b, a) };
    let start = angle(from, center);
    let sweep = turn(start, angle(to, center));
    (sweep > 1e-6).then_some(Curve2::Arc { center, radius, start, sweep })
}

/// Whether an arc runs from its first to its second node counter-clockwise: `turns` is the angle from the
/// first to the second node and that back, `middle` the angle to its middle.
fn is_first_arc(piece: &Piece, turns: [f64; 2], middle: f64) -> bool {
    let Shape::Circle(_, radius) = piece.shape else { return true };
    // Nodes of short arcs may have moved past the middle; then the length decides.
    let length = piece.raw.len() as f64;
    let off = turns.map(|turn| (radius * turn - length).abs());
    match off[0].max(off[1]) > 3.0 * off[0].min(off[1]) + 5.0 {
        true => off[0] < off[1],
        false => middle <= turns[0],
    }
}

/// How a coordinate of a view is one of the part: part = sign · (sheet − offset).
#[derive(Debug, Clone, Copy)]
struct Frame {
    /// Number of the axis; equal numbers are the same axis.
    axis: usize,
    sign: f64,
    offset: f64,
    /// Extent of the view along the axis in values of the part, for mirrored views.
    extent: f64,
}

impl Frame {
    /// Distance on the sheet from the lower left corner of the view.
    fn sheet(&self, value: f64) -> f64 {
        if self.sign < 0.0 { self.extent - value } else { value }
    }
}

/// The frames of both axes of each view.
fn frames_of(extents: &[Extent], layout: Option<&Layout>) -> Vec<[Frame; 2]> {
    let own = |v: usize, k: usize| Frame {
        axis: 10 + 2 * v + k,
        sign: 1.0,
        offset: extents[v][k][0],
        extent: extents[v][k][1] - extents[v][k][0],
    };
    let Some(layout) = layout else {
        return (0..extents.len()).map(|v| [0, 1].map(|k| own(v, k))).collect();
    };
    // Mean sizes: a view's lower end has an error of its own.
    let mut sizes: [Vec<f64>; 3] = Default::default();
    for (v, kind) in layout.kinds.iter().enumerate() {
        if let Some(kind) = kind {
            (0..2).for_each(|k| sizes[kind.axes()[k]].push(extents[v][k][1] - extents[v][k][0]));
        }
    }
    let mean = |axis: usize| sizes[axis].iter().sum::<f64>() / sizes[axis].len().max(1) as f64;
    let frame = |v: usize, k: usize| match layout.kinds[v] {
        None => own(v, k),
        Some(kind) => {
            let axis = kind.axes()[k];
            let sign = if kind == ViewKind::Left && k == 0 { -1.0 } else { 1.0 };
            let middle = 0.5 * (extents[v][k][0] + extents[v][k][1]);
            let extent = mean(axis);
            Frame { axis, sign, offset: middle - sign * 0.5 * extent, extent }
        }
    };
    (0..extents.len()).map(|v| [0, 1].map(|k| frame(v, k))).collect()
}

fn views_of(graph: &PieceGraph, boxes: &[PixelBox]) -> Vec<Option<usize>> {
    let view = |piece: &Piece| {
        let p = piece.points.get(piece.points.len() / 2).copied().unwrap_or(piece.ends[0]);
        boxes.iter().position(|b| super::marks::contains(b, p, 2.0))
    };
    graph.pieces.iter().map(view).collect()
}

fn extent_of(graph: &PieceGraph, view_of: &[Option<usize>], view: usize) -> Extent {
    // Hidden lines do not reach beyond visible ones.
    let is_used = |p: &Piece| !p.is_dropped && p.is_thin != Some(true);
    let own = (0..graph.pieces.len()).filter(|k| view_of[*k] == Some(view) && is_used(&graph.pieces[*k]));
    own.fold([[f64::MAX, f64::MIN]; 2], |all, k| {
        let bounds = graph.placed_curve(k).bounds();
        [0, 1].map(|c| [all[c][0].min(bounds[c][0]), all[c][1].max(bounds[c][1])])
    })
}

impl PieceGraph {
    /// The curve of a piece between its nodes.
    pub(super) fn placed_curve(&self, k: usize) -> Curve2 {
        let piece = &self.pieces[k];
        match piece.nodes {
            [Some(a), Some(b)] if !piece.is_closed => {
                let middle = piece.points.get(piece.points.len() / 2).copied().unwrap_or(piece.ends[0]);
                let [a, b] = [self.nodes[a], self.nodes[b]];
                let Shape::Circle(center, radius) = piece.shape else {
                    return piece.shape.between(a, middle, b);
                };
                let angle = |p: [f64; 2]| (p[1] - center[1]).atan2(p[0] - center[0]);
                let turn = |from: f64, to: f64| (to - from).rem_euclid(TAU);
                let [s, m, e] = [a, middle, b].map(angle);
                match is_first_arc(piece, [turn(s, e), turn(e, s)], turn(s, m)) {
                    true => Curve2::Arc { center, radius, start: s, sweep: turn(s, e) },
                    false => Curve2::Arc { center, radius, start: e, sweep: turn(e, s) },
                }
            }
            _ => piece.raw_curve(),
        }
    }
}

impl Values {
    fn new(graph: &PieceGraph, view_of: &[Option<usize>], scale: LineScale) -> Self {
        let count = graph.pieces.len();
        let mut made =
            Self { all: Vec::new(), nodes: Vec::new(), circles: vec![None; count], axes: vec![None; count] };
        let mut node_values: Vec<[Option<usize>; 2]> = vec![[None; 2]; graph.nodes.len()];
        for (k, piece) in graph.pieces.iter().enumerate().filter(|(_, p)| !p.is_dropped) {
            let Some(view) = view_of[k] else { continue };
            match piece.shape {
                Shape::Line(at, along) => {
                    let Some(axis) = parallel_axis(piece, along, scale) else { continue };
                    let range =
                        [0, 1].map(|e| piece.nodes[e].map_or(piece.ends[e], |n| graph.nodes[n])[1 - axis]);
                    let range = Some([range[0].min(range[1]), range[0].max(range[1])]);
                    let value = Value {
                        owner: 3 * view + axis,
                        at: at[axis],
                        sigma: scale.sigma,
                        range,
                        is_rim: false,
                        group: 0,
                    };
                    made.axes[k] = Some(axis);
                    let index = made.push(value);
                    for (n, members) in graph.members.iter().enumerate() {
                        if members.contains(&k) {
                            node_values[n][axis].get_or_insert(index);
                        }
                    }
                }
                Shape::Circle(center, radius) => {
                    let sigma = scale.sigma * centre_error(piece);
                    let at = |made: &mut Self, axis: usize, at: f64| {
                        made.push(Value {
                            owner: 3 * view + axis,
                            at,
                            sigma,
                            range: None,
                            is_rim: false,
                            group: 0,
                        })
                    };
                    let [x, y] = [at(&mut made, 0, center[0]), at(&mut made, 1, center[1])];
                    made.circles[k] = Some([x, y, at(&mut made, 2, radius)]);
                }
            }
        }
        for (n, known) in node_values.into_iter().enumerate() {
            let view = graph.members[n].iter().find_map(|k| view_of[*k]).unwrap_or(0);
            let shapes = graph.shapes_at(n);
            let is_circle = |s: &Shape| matches!(s, Shape::Circle(..));
            let touches =
                shapes.iter().any(|a| shapes.iter().any(|b| a != b && tangent_point(a, b).is_some()));
            let is_rim = !touches && shapes.iter().any(is_circle);
            // Where only one piece ends, its place along that piece is known poorly.
            let sigma = if shapes.len() > 1 { 1.7 * scale.sigma } else { 1.0 };
            let values = [0, 1].map(|axis| {
                known[axis].unwrap_or_else(|| {
                    let at = graph.nodes[n][axis];
                    made.push(Value { owner: 3 * view + axis, at, sigma, range: None, is_rim, group: 0 })
                })
            });
            made.nodes.push(values);
        }
        made
    }

    fn push(&mut self, value: Value) -> usize {
        self.all.push(value);
        self.all.len() - 1
    }

    /// Groups values of one axis; returns value and σ of each group.
    fn grouped(&mut self, frames: &[[Frame; 2]], scale: LineScale) -> Vec<(f64, f64)> {
        // Key of the axis, and values in coordinates of the part.
        let frame = |value: &Value| frames.get(value.owner / 3).and_then(|f| f.get(value.owner % 3)).copied();
        let mut order: Vec<(usize, f64, usize)> = (self.all.iter().enumerate())
            .map(|(k, value)| match frame(value) {
                Some(f) => (f.axis, f.sign * (value.at - f.offset), k),
                // Radii of all views are compared with each other.
                None => (usize::MAX, value.at, k),
            })
            .collect();
        order.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut groups: Vec<(f64, f64)> = Vec::new();
        let mut first = 0;
        while first < order.len() {
            let last = first + order[first..].iter().take_while(|o| o.0 == order[first].0).count();
            for members in self.clusters(&order[first..last], scale) {
                let weight = |k: usize| self.all[k].sigma.powi(-2);
                let total: f64 = members.iter().map(|(_, k)| weight(*k)).sum();
                let mean = members.iter().map(|(at, k)| weight(*k) * at).sum::<f64>() / total;
                members.iter().for_each(|(_, k)| self.all[*k].group = groups.len());
                // Errors of pixels are correlated: the σ of a mean has a lower limit.
                groups.push((mean, total.sqrt().recip().max(0.3 * scale.sigma)));
            }
            first = last;
        }
        groups
    }

    /// Groups of sorted values of one axis: the nearest neighbours join first.
    fn clusters(&self, order: &[(usize, f64, usize)], scale: LineScale) -> Vec<Vec<(f64, usize)>> {
        struct Cluster {
            members: Vec<(f64, usize)>,
            mean: f64,
            sigma: f64,
        }
        let rim = RIM[0].max(RIM[1] * scale.sigma);
        let mut all: Vec<Cluster> = order
            .iter()
            .map(|(_, at, k)| Cluster { members: vec![(*at, *k)], mean: *at, sigma: self.all[*k].sigma })
            .collect();
        loop {
            let gap = |k: usize| {
                let (a, b) = (&all[k], &all[k + 1]);
                (b.mean - a.mean) / (a.sigma * a.sigma + b.sigma * b.sigma).sqrt()
            };
            let is_narrow = |v: usize| self.all[v].is_rim || self.all[v].owner % 3 == 2;
            let has_rim = |k: usize| all[k].members.iter().any(|(_, v)| is_narrow(*v));
            let may_join = |k: &usize| {
                gap(*k) <= SAME
                    && (all[*k + 1].mean - all[*k].mean <= rim || !(has_rim(*k) || has_rim(*k + 1)))
                    && !all[*k]
                        .members
                        .iter()
                        .any(|(_, a)| all[*k + 1].members.iter().any(|(_, b)| self.are_apart(*a, *b, scale)))
            };
            let nearest = (0..all.len().saturating_sub(1)).filter(may_join);
            let Some(k) = nearest.min_by(|a, b| gap(*a).total_cmp(&gap(*b))) else { break };
            let other = all.remove(k + 1);
            let own = &mut all[k];
            let weights = [own.sigma.powi(-2), other.sigma.powi(-2)];
            own.mean = (weights[0] * own.mean + weights[1] * other.mean) / (weights[0] + weights[1]);
            own.sigma = own.sigma.min(other.sigma);
            own.members.extend(other.members);
        }
        all.into_iter().map(|c| c.members).collect()
    }

    /// Whether two values are those of lines side by side in one view.
    fn are_apart(&self, a: usize, b: usize, scale: LineScale) -> bool {
        let (a, b) = (&self.all[a], &self.all[b]);
        a.owner == b.owner
            && a.range.zip(b.range).is_some_and(|(r, s)| r[0].max(s[0]) + scale.width < r[1].min(s[1]))
    }

    fn group(&self, value: usize) -> usize {
        self.all[value].group
    }
}

/// The axis whose coordinate a line has, if it is parallel to the other one.
fn parallel_axis(piece: &Piece, along: [f64; 2], scale: LineScale) -> Option<usize> {
    let length = distance(piece.ends[0], piece.ends[1]).max(1.0);
    let limit = ((PARALLEL[0] + PARALLEL[1] * scale.sigma) / length).min(PARALLEL[2]);
    (0..2).find(|axis| along[*axis].abs() <= limit)
}

/// σ of a centre in σ of points: it grows with the inverse square of the angle of the arc.
fn centre_error(piece: &Piece) -> f64 {
    if piece.is_closed {
        return 0.7;
    }
    let sweep = match piece.raw_curve() {
        Curve2::Arc { sweep, .. } => sweep,
        _ => 1.0,
    };
    (0.7 + 4.0 / (sweep * sweep)).min(8.0)
}

/// That ends lie on their circles and slanted lines, and that circles reach lines.
fn equations<'a>(
    graph: &'a PieceGraph,
    values: &'a Values,
    frames: &'a [[Frame; 2]],
    start: &[f64],
    sigmas: &[f64],
) -> Vec<Equation<'a>> {
    let mut all: Vec<Equation<'a>> = Vec::new();
    let mut has_line = vec![false; start.len()];
    for value in values.all.iter().filter(|v| v.range.is_some()) {
        has_line[value.group] = true;
    }
    let frame_of = |value: usize| {
        let owner = values.all[value].owner;
        frames[owner / 3][owner % 3]
    };
    let axis_of_group: Vec<Option<usize>> = {
        let mut axes = vec![None; start.len()];
        for (k, value) in values.all.iter().enumerate().filter(|(_, v)| v.owner % 3 != 2) {
            axes[value.group] = Some(frame_of(k).axis);
        }
        axes
    };
    // Circles reach lines: of this view or of others.
    let mut reached = std::collections::BTreeSet::new();
    for circle in values.circles.iter().flatten() {
        let r = values.group(circle[2]);
        for center in &circle[..2] {
            let c = values.group(*center);
            let own_axis = axis_of_group[c];
            for sign in [1.0, -1.0] {
                let reach = start[c] + sign * start[r];
                let off = |g: &usize| (start[*g] - reach).abs();
                let near = (0..start.len()).filter(|g| has_line[*g] && axis_of_group[*g] == own_axis);
                let Some(g) = near.min_by(|a, b| off(a).total_cmp(&off(b))) else { continue };
                let limit = SAME * (sigmas[c].powi(2) + sigmas[r].powi(2) + sigmas[g].powi(2)).sqrt() + 0.3;
                if off(&g) <= limit && g != c && reached.insert((c, r, g)) {
                    all.push(Box::new(move |x| {
                        (x[c] + sign * x[r] - x[g], vec![(c, 1.0), (r, sign), (g, -1.0)])
                    }));
                }
            }
        }
    }
    for (n, members) in graph.members.iter().enumerate() {
        let own = values.nodes[n].map(|v| values.group(v));
        let shapes: Vec<usize> = members.iter().copied().filter(|k| !graph.pieces[*k].is_dropped).collect();
        for k in &shapes {
            if let Some(circle) = values.circles[*k] {
                let [cx, cy, r] = circle.map(|v| values.group(v));
                all.push(Box::new(move |x| {
                    let d = [x[own[0]] - x[cx], x[own[1]] - x[cy]];
                    let length = d[0].hypot(d[1]).max(1e-9);
                    let u = d.map(|c| c / length);
                    (length - x[r], vec![(own[0], u[0]), (own[1], u[1]), (cx, -u[0]), (cy, -u[1]), (r, -1.0)])
                }));
            } else if values.axes[*k].is_none()
                && let [Some(a), Some(b)] = graph.pieces[*k].nodes
                && a != n
                && b != n
            {
                // On a slanted line.
                let [p, q] = [a, b].map(|n| values.nodes[n].map(|v| values.group(v)));
                all.push(Box::new(move |x| on_line(x, own, p, q)));
            }
        }
        for (i, a) in shapes.iter().enumerate() {
            for b in &shapes[i + 1..] {
                if tangent_point(&graph.pieces[*a].shape, &graph.pieces[*b].shape).is_none() {
                    continue;
                }
                let [first, second] = [values.circles[*a], values.circles[*b]];
                if let (Some(circle), None) | (None, Some(circle)) = (first, second) {
                    let line = if first.is_none() { *a } else { *b };
                    all.extend(tangency(graph, values, own, circle, line));
                }
            }
        }
    }
    all
}

/// That a point is the foot of a circle's centre on a line.
fn tangency<'a>(
    graph: &PieceGraph,
    values: &Values,
    own: [usize; 2],
    circle: [usize; 3],
    line: usize,
) -> Option<Equation<'a>> {
    let center = [values.group(circle[0]), values.group(circle[1])];
    if let Some(axis) = values.axes[line] {
        // The line runs along the other axis.
        let (n, c) = (own[1 - axis], center[1 - axis]);
        return (n != c)
            .then(|| -> Equation<'a> { Box::new(move |x| (x[n] - x[c], vec![(n, 1.0), (c, -1.0)])) });
    }
    let [Some(a), Some(b)] = graph.pieces[line].nodes else { return None };
    let [p, q] = [a, b].map(|n| values.nodes[n].map(|v| values.group(v)));
    Some(Box::new(move |x| {
        let d = [x[q[0]] - x[p[0]], x[q[1]] - x[p[1]]];
        let length = d[0].hypot(d[1]).max(1e-9);
        let e = [x[own[0]] - x[center[0]], x[own[1]] - x[center[1]]];
        let u = d.map(|c| c / length);
        let residual = e[0] * u[0] + e[1] * u[1];
        // The direction of the line depends on its ends.
        let slope = |k: usize| (e[k] - residual * u[k]) / length;
        let mut slopes: Vec<(usize, f64)> = Vec::with_capacity(8);
        for k in 0..2 {
            slopes.extend([(own[k], u[k]), (center[k], -u[k]), (q[k], slope(k)), (p[k], -slope(k))]);
        }
        (residual, slopes)
    }))
}

/// Distance of a point from the line through two others.
fn on_line(x: &[f64], own: [usize; 2], p: [usize; 2], q: [usize; 2]) -> (f64, Vec<(usize, f64)>) {
    let d = [x[q[0]] - x[p[0]], x[q[1]] - x[p[1]]];
    let e = [x[own[0]] - x[p[0]], x[own[1]] - x[p[1]]];
    let length = d[0].hypot(d[1]).max(1e-9);
    let residual = (d[0] * e[1] - d[1] * e[0]) / length;
    let n = [-d[1] / length, d[0] / length];
    // How far along the line the point is.
    let share = (d[0] * e[0] + d[1] * e[1]) / (length * length);
    let mut slopes = Vec::with_capacity(6);
    for k in 0..2 {
        slopes.extend([(own[k], n[k]), (p[k], -(1.0 - share) * n[k]), (q[k], -share * n[k])]);
    }
    (residual, slopes)
}
