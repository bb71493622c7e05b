//! Coordinates of traced pieces that agree within their σ become the same, in a view and between views.
//!
//! 1. Lines that are parallel to an axis have one coordinate. Ends, centres and radii are further values.
//! 2. Values of one axis of the part are grouped; two lines side by side in one view stay apart.
//! 3. The groups change as little as their σ allow so that ends lie on circles, and circles reach the lines
//!    that show them in other views.

mod equations;

use super::ends::tangent_point;
use super::layout::{Extent, Layout, corners, layout_of};
use super::marks::PixelBox;
use super::moments::Shape;
use super::pieces::{LineScale, Piece, PieceGraph};
use equations::{consistent, equations};
use planish_estimate::{Error, Result};
use planish_solid::drawing::ViewKind;
use planish_solid::views::{Curve2, distance};
use std::f64::consts::TAU;

/// Values at most this many σ apart are the same.
const SAME: f64 = 3.0;
/// The same for corners at rims of circles, and for radii: pixels, or σ of a line.
const RIM: [f64; 2] = [0.3, 1.2];
/// Maximum difference of sizes of views after alignment, relative to the size.
const MAX_MISFIT: f64 = 2e-3;
/// σ of a node in σ of a line, at a right angle: corners of skeletons are rounded off.
const NODE_FACTOR: f64 = 1.7;
/// Maximum σ of a node for comparisons, σ from which on it is a point of tangency, and maximum σ for changes,
/// in pixels.
const MAX_NODE_SIGMA: f64 = 1.5;
const TANGENT_SIGMA: f64 = 3.0;
const MAX_SPREAD: f64 = 10.0;
/// Distance in pixels beyond the outline of a view from which on a curve is false.
const OUTSIDE: f64 = 1.5;
/// Maximum distance of the line at the end of a view from the extent of all its curves, in pixels.
const END_OF_VIEW: f64 = 1.5;
/// Slope of a line that is parallel to an axis: pixels over its length, in addition σ, and radians.
const PARALLEL: [f64; 3] = [0.35, 1.5, 0.12];
/// Largest change of a value by the equations, in σ and pixels.
const MAX_CHANGE: [f64; 2] = [4.0, 0.5];
/// Maximum length of an arc: factor of its number of points, and pixels in addition.
const MAX_UNCOVERED: [f64; 2] = [2.5, 20.0];
/// Sine of the angle to an axis below which a line shows the extent of a view.
const STRAIGHT: f64 = 0.01;
/// Minimum number of points of a piece from which the extent of a view follows.
const MIN_CLEAR_POINTS: usize = 6;

/// A value of an axis.
#[derive(Debug, Clone)]
struct Value {
    /// 3 · view + axis of the view (0, 1), or 2 for a radius.
    owner: usize,
    at: f64,
    /// σ for comparisons with other values.
    sigma: f64,
    /// σ by which the value may change: where curves meet at a small angle, much more.
    spread: f64,
    /// The range of a line across the axis.
    range: Option<[f64; 2]>,
    /// Whether it is that of a corner at the rim of a circle, often close to an extreme of the circle.
    is_rim: bool,
    /// Number of its group, once it is known.
    group: usize,
    /// Whether it is the first (0) or last (1) line of its view along its axis: those of all views are one.
    end_of_view: Option<usize>,
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
///
/// `titles`: the kinds that titles state for the boxes.
///
/// # Errors
/// `Input` if the sizes of the views do not agree.
pub(super) fn aligned(
    graph: &PieceGraph,
    boxes: &[PixelBox],
    titles: &[Option<ViewKind>],
    scale: LineScale,
) -> Result<Vec<AlignedCurve>> {
    let view_of = views_of(graph, boxes);
    let extents: Vec<Extent> = (0..boxes.len()).map(|v| extent_of(graph, &view_of, v)).collect();
    let layout = layout_of(&extents, titles);
    let mut values = Values::new(graph, &view_of, &extents, scale);
    let frames = frames_of(&extents, layout.as_ref());
    if layout.is_some() {
        values.mark_ends(&extents);
    }
    let groups = values.grouped(&frames, scale);
    let sigmas: Vec<f64> = groups.iter().map(|g| g.1).collect();
    let start: Vec<f64> = groups.iter().map(|g| g.0).collect();
    let equations = equations(graph, &values, &frames, &start, &sigmas);
    let found = consistent(&start, &sigmas, &equations);
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
    let curves = within_views(curves, &view_of, &frames, places.as_deref());
    check_sizes(&curves, &view_of, &extents, layout.as_ref())?;
    Ok(curves)
}

/// The curves without those that reach beyond their view: the outline has no false ends.
fn within_views(
    mut curves: Vec<AlignedCurve>,
    view_of: &[Option<usize>],
    frames: &[[Frame; 2]],
    places: Option<&[[f64; 2]]>,
) -> Vec<AlignedCurve> {
    let Some(places) = places else { return curves };
    curves.retain(|c| {
        let Some(v) = view_of[c.piece] else { return false };
        let bounds = c.curve.bounds();
        (0..2).all(|k| {
            let low = places[v][k].round();
            bounds[k][0] >= low - OUTSIDE && bounds[k][1] <= low + frames[v][k].extent + OUTSIDE
        })
    });
    curves
}

/// Refuses groups of lines that are no views, and views of different sizes: otherwise a view would be left
/// out, and two views have more solids than three.
fn check_sizes(
    curves: &[AlignedCurve],
    view_of: &[Option<usize>],
    extents: &[Extent],
    layout: Option<&Layout>,
) -> Result<()> {
    let mut sizes: [Option<f64>; 3] = [None; 3];
    for (v, [[left, right], [bottom, top]]) in extents.iter().enumerate() {
        let own = curves.iter().filter(|c| view_of[c.piece] == Some(v)).map(|c| c.curve.bounds());
        let bounds = own.fold([[f64::MAX, f64::MIN]; 2], |all, b| {
            [0, 1].map(|k| [all[k][0].min(b[k][0]), all[k][1].max(b[k][1])])
        });
        let kind = layout.and_then(|l| l.kinds[v]);
        let agrees = kind.is_some_and(|kind| {
            (0..2).all(|k| {
                let size = bounds[k][1] - bounds[k][0];
                let known = *sizes[kind.axes()[k]].get_or_insert(size);
                (known - size).abs() <= MAX_MISFIT * known.max(size)
            })
        });
        if !agrees {
            return Err(Error::input(format!(
                "expected two or three views of one part whose sizes agree, found a group of lines from \
                 pixel {left:.0} {bottom:.0} to {right:.0} {top:.0} (y upwards) that does not: crop the \
                 picture to the views, or use one with more pixels"
            )));
        }
    }
    Ok(())
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
    let middle = piece.inner_point(raw[0], raw[1]);
    let angle = |p: [f64; 2], c: [f64; 2]| (p[1] - c[1]).atan2(p[0] - c[0]);
    let turn = |a: f64, b: f64| (b - a).rem_euclid(TAU);
    let (s, m, e) = (angle(raw[0], own), angle(middle, own), angle(raw[1], own));
    let (from, to) = if is_first_arc(piece, [turn(s, e), turn(e, s)], turn(s, m)) { (a, b) } else { (b, a) };
    let start = angle(from, center);
    let sweep = turn(start, angle(to, center));
    (sweep > 1e-6 && piece.covers(radius * sweep)).then_some(Curve2::Arc { center, radius, start, sweep })
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

/// The arc of a piece from one node to another, past a place in its middle.
fn arc_between(piece: &Piece, places: [[f64; 2]; 3], center: [f64; 2], radius: f64) -> Curve2 {
    let turn = |from: f64, to: f64| (to - from).rem_euclid(TAU);
    let [s, m, e] = places.map(|p: [f64; 2]| (p[1] - center[1]).atan2(p[0] - center[0]));
    match is_first_arc(piece, [turn(s, e), turn(e, s)], turn(s, m)) {
        true => Curve2::Arc { center, radius, start: s, sweep: turn(s, e) },
        false => Curve2::Arc { center, radius, start: e, sweep: turn(e, s) },
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
    let is_own = |k: &usize| view_of[*k] == Some(view) && !graph.pieces[*k].is_dropped;
    // The outline of a part is visible; hidden lines and short pieces have less accurate ends.
    let is_clear = |k: &usize| {
        let piece = &graph.pieces[*k];
        is_own(k) && !piece.is_hidden && piece.is_thin != Some(true) && piece.raw.len() >= MIN_CLEAR_POINTS
    };
    let clear: Vec<usize> = (0..graph.pieces.len()).filter(is_clear).collect();
    let own = if clear.is_empty() { (0..graph.pieces.len()).filter(is_own).collect() } else { clear };
    own.into_iter().fold([[f64::MAX, f64::MIN]; 2], |all, k| {
        let mut bounds = graph.placed_curve(k).bounds();
        // Of lines a few pixels apart that share their nodes, the nodes are between both.
        if let Shape::Line(at, along) = graph.pieces[k].shape
            && let Some(axis) = (0..2).find(|axis| along[*axis].abs() <= STRAIGHT)
        {
            bounds[axis] = [bounds[axis][0].min(at[axis]), bounds[axis][1].max(at[axis])];
        }
        [0, 1].map(|c| [all[c][0].min(bounds[c][0]), all[c][1].max(bounds[c][1])])
    })
}

impl Piece {
    /// Whether a curve of a length may be that of its points: a false arc reaches far beyond them. Gaps of a
    /// dashed one are shorter than its dashes.
    fn covers(&self, length: f64) -> bool {
        length <= MAX_UNCOVERED[0] * self.raw.len() as f64 + MAX_UNCOVERED[1]
    }
}

impl PieceGraph {
    /// The curve of a piece between its nodes.
    pub(super) fn placed_curve(&self, k: usize) -> Curve2 {
        let piece = &self.pieces[k];
        match piece.nodes {
            [Some(a), Some(b)] if !piece.is_closed => {
                let middle = piece.inner_point(self.nodes[a], self.nodes[b]);
                let [a, b] = [self.nodes[a], self.nodes[b]];
                let curve = match piece.shape {
                    Shape::Circle(center, radius) => arc_between(piece, [a, middle, b], center, radius),
                    Shape::Line(..) => piece.shape.between(a, middle, b),
                };
                match piece.covers(curve.length()) {
                    true => curve,
                    false => Curve2::Segment(a, b),
                }
            }
            _ => piece.raw_curve(),
        }
    }
}

impl Values {
    fn new(graph: &PieceGraph, view_of: &[Option<usize>], extents: &[Extent], scale: LineScale) -> Self {
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
                        spread: scale.sigma,
                        range,
                        is_rim: false,
                        group: 0,
                        end_of_view: None,
                    };
                    made.axes[k] = Some(axis);
                    let index = made.push(value);
                    for (n, members) in graph.members.iter().enumerate() {
                        if members.contains(&k) {
                            // Of two lines, the outer one is the outline.
                            let middle = 0.5 * (extents[view][axis][0] + extents[view][axis][1]);
                            let off = |v: usize| (made.all[v].at - middle).abs();
                            let own = &mut node_values[n][axis];
                            *own = Some(own.filter(|known| off(*known) >= off(index)).unwrap_or(index));
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
                            spread: sigma,
                            range: None,
                            is_rim: false,
                            group: 0,
                            end_of_view: None,
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
            let spreads = node_spreads(&shapes, graph.nodes[n], scale);
            let values = [0, 1].map(|axis| {
                known[axis].unwrap_or_else(|| {
                    let (at, spread) = (graph.nodes[n][axis], spreads[axis]);
                    let owner = 3 * view + axis;
                    // A point of tangency follows from an equation, and would join the wrong group.
                    let is_tangent = spread > TANGENT_SIGMA;
                    let sigma = if is_tangent { scale.sigma } else { spread.min(MAX_NODE_SIGMA) };
                    let value =
                        Value { owner, at, sigma, spread, range: None, is_rim, group: 0, end_of_view: None };
                    made.push(value)
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

    /// Marks the lines at the ends of each view.
    fn mark_ends(&mut self, extents: &[Extent]) {
        for (view, extent) in extents.iter().enumerate() {
            for (axis, range) in extent.iter().enumerate() {
                for (end, place) in range.iter().enumerate() {
                    let off = |v: &Value| (v.at - place).abs();
                    let own = |v: &&mut Value| {
                        v.owner == 3 * view + axis && v.range.is_some() && off(v) <= END_OF_VIEW
                    };
                    let lines = self.all.iter_mut().filter(own);
                    if let Some(line) = lines.min_by(|a, b| off(a).total_cmp(&off(b))) {
                        line.end_of_view = Some(end);
                    }
                }
            }
        }
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
                let weight = |k: usize| self.all[k].spread.powi(-2);
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
        // Sizes of views may differ by more than their σ, but the views are those of one part.
        for end in 0..2 {
            let is_end = |c: &Cluster| self.all[c.members[0].1].end_of_view == Some(end);
            let (ends, others): (Vec<Cluster>, Vec<Cluster>) = all.into_iter().partition(is_end);
            let members: Vec<(f64, usize)> = ends.into_iter().flat_map(|c| c.members).collect();
            let mean = members.iter().map(|m| m.0).sum::<f64>() / members.len().max(1) as f64;
            all = others;
            let Some((_, first)) = members.first() else { continue };
            all.push(Cluster { mean, sigma: self.all[*first].sigma, members });
            all.sort_by(|a, b| a.mean.total_cmp(&b.mean));
        }
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

/// σ of both coordinates of a node: the covariance σ² (Σ n nᵀ)⁻¹ of the point where curves with normals n
/// meet. Where only one piece ends, its place along that piece is known poorly.
fn node_spreads(shapes: &[Shape], node: [f64; 2], scale: LineScale) -> [f64; 2] {
    if shapes.len() < 2 {
        return [1.0; 2];
    }
    let prior = (scale.sigma / MAX_SPREAD).powi(2);
    let mut m = [prior, 0.0, prior];
    for shape in shapes {
        let n = shape.normal(node);
        m = [m[0] + n[0] * n[0], m[1] + n[0] * n[1], m[2] + n[1] * n[1]];
    }
    let det = m[0] * m[2] - m[1] * m[1];
    [m[2], m[0]].map(|c| scale.sigma * (c / det).sqrt().max(NODE_FACTOR))
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
