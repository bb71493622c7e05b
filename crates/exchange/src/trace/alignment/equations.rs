//! Equations between values of traced pieces: ends on curves, tangents, and circles that reach lines.

use super::super::consistent::Equation;
use super::super::ends::tangent_point;
use super::super::pieces::PieceGraph;
use super::{Frame, SAME, Values};

/// That ends lie on their circles and slanted lines, and that circles reach lines.
pub(super) fn equations<'a>(
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
