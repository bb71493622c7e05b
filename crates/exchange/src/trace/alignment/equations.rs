//! Equations between values of traced pieces: ends on curves, tangents, and circles that reach lines.

use super::super::ends::tangent_point;
use super::super::pieces::PieceGraph;
use super::{Frame, MAX_CHANGE, SAME, Values};
use planish_estimate::{Condition, adjusted};
use planish_solid::drawing::conditions::{on_circle, on_line, tangent_at};

/// Maximum residual of an equation that is met, in pixels.
const SOLVED: f64 = 1e-9;

/// That ends lie on their circles and slanted lines, and that circles reach lines.
pub(super) fn equations<'a>(
    graph: &'a PieceGraph,
    values: &'a Values,
    frames: &'a [[Frame; 2]],
    start: &[f64],
    sigmas: &[f64],
) -> Vec<Condition<'a>> {
    let mut all: Vec<Condition<'a>> = Vec::new();
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
                all.push(on_circle(own, circle.map(|v| values.group(v))));
            } else if values.axes[*k].is_none()
                && let [Some(a), Some(b)] = graph.pieces[*k].nodes
                && a != n
                && b != n
            {
                // On a slanted line.
                let [p, q] = [a, b].map(|n| values.nodes[n].map(|v| values.group(v)));
                all.push(on_line(own, [p, q]));
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
) -> Option<Condition<'a>> {
    let center = [values.group(circle[0]), values.group(circle[1])];
    if let Some(axis) = values.axes[line] {
        // The line runs along the other axis.
        let (n, c) = (own[1 - axis], center[1 - axis]);
        return (n != c)
            .then(|| -> Condition<'a> { Box::new(move |x| (x[n] - x[c], vec![(n, 1.0), (c, -1.0)])) });
    }
    let [Some(a), Some(b)] = graph.pieces[line].nodes else { return None };
    let [p, q] = [a, b].map(|n| values.nodes[n].map(|v| values.group(v)));
    Some(tangent_at(own, center, [p, q]))
}

/// The values that meet the equations. Equations are added in the order of their misfit, and those that
/// contradict the ones before, or change values by too much, are left out.
pub(super) fn consistent(start: &[f64], sigmas: &[f64], equations: &[Condition<'_>]) -> Vec<f64> {
    let misfit = |e: &Condition<'_>| {
        let (residual, slopes) = e(start);
        let sigma = slopes.iter().map(|(k, slope)| (slope * sigmas[*k]).powi(2)).sum::<f64>().sqrt();
        let limit = (MAX_CHANGE[0] * sigma).max(MAX_CHANGE[1]);
        // Equations whose unknowns are one value have no derivatives.
        if sigma > 1e-6 && residual.abs() <= limit { residual.abs() / sigma } else { f64::INFINITY }
    };
    let mut order: Vec<(f64, &Condition<'_>)> = equations.iter().map(|e| (misfit(e), e)).collect();
    order.retain(|(misfit, _)| misfit.is_finite());
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let order: Vec<&Condition<'_>> = order.into_iter().map(|(_, e)| e).collect();
    let mut values = start.to_vec();
    add_equations(start, sigmas, &mut Vec::new(), &order, &mut values);
    values
}

/// Adds equations to those that are met; if they cannot all be met, each half of them.
fn add_equations<'e, 'f>(
    start: &[f64],
    sigmas: &[f64],
    met: &mut Vec<&'e Condition<'f>>,
    more: &[&'e Condition<'f>],
    values: &mut Vec<f64>,
) {
    if more.is_empty() {
        return;
    }
    let before = met.len();
    met.extend(more);
    if let Some((found, residuals)) = adjusted(start, sigmas, met, SOLVED) {
        let is_near = |k: usize| (found[k] - start[k]).abs() <= MAX_CHANGE[0] * sigmas[k] + MAX_CHANGE[1];
        if residuals.iter().all(|r| *r < 1e3 * SOLVED) && (0..found.len()).all(is_near) {
            *values = found;
            return;
        }
    }
    met.truncate(before);
    if more.len() > 1 {
        let (first, second) = more.split_at(more.len() / 2);
        add_equations(start, sigmas, met, first, values);
        add_equations(start, sigmas, met, second, values);
    }
}
