//! Whether a fit is one that readings can have told.
//!
//! Comes in: a fit with its covariance, and the points that were seen. Goes out: whether its corners are
//! corners, and whether it lies where the readings are. Not guaranteed: that it is what was seen; the
//! likelihood says that.

use super::fit::ContourFit;
use super::kind::ContourKind;

/// Whether every corner of a polygon or chain is one: its sides longer than three σ of their ends, and no
/// spike. More corners than the readings tell apart would otherwise explain noise.
pub(super) fn corners_are_real(found: &ContourFit) -> bool {
    let (count, closed) = match &found.kind {
        ContourKind::Polygon(count) => (*count, true),
        ContourKind::Chain { arcs, closed } => (arcs.len() + usize::from(!closed), *closed),
        _ => return true,
    };
    let theta = found.state.as_slice();
    let vertex = |i: usize| [theta[2 * (i % count)], theta[2 * (i % count) + 1]];
    let variance = |i: usize| {
        let k = 2 * (i % count);
        0.5 * (found.covariance[(k, k)] + found.covariance[(k + 1, k + 1)])
    };
    let sides = if closed { count } else { count - 1 };
    let is_polygon = matches!(found.kind, ContourKind::Polygon(_));
    (0..sides).all(|i| {
        let (a, b, c) = (vertex(i), vertex(i + 1), vertex(i + 2));
        let (d, e) = ([b[0] - a[0], b[1] - a[1]], [c[0] - b[0], c[1] - b[1]]);
        let (length, next) = (d[0].hypot(d[1]), e[0].hypot(e[1]));
        let long = length * length > 9.0 * (variance(i) + variance(i + 1));
        // Turning back by more than 150°.
        let spike = is_polygon && d[0] * e[0] + d[1] * e[1] < -0.866 * length * next;
        long && !spike
    })
}

/// Whether no vertex lies farther from the readings' middle than three times the farthest reading.
pub(super) fn stays_near(kind: &ContourKind, state: &[f64], middle: [f64; 2], points: &[[f64; 2]]) -> bool {
    let from = |p: [f64; 2]| (p[0] - middle[0]).hypot(p[1] - middle[1]);
    let reach = points.iter().map(|&p| from(p)).fold(0.0, f64::max);
    let theta = &state[..kind.parameters()];
    let near = |p: &[f64; 2]| from(*p) <= 3.0 * reach;
    matches!(kind, ContourKind::Circle | ContourKind::Ellipse)
        || kind.outline(theta).is_none_or(|o| o.vertices.iter().all(near))
}
