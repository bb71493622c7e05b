//! Plausibility checks of a fit.
//!
//! In: a fit with its covariance, and the measured points. Out: whether its corners are significant, and
//! whether it lies where the readings are. Not guaranteed: that the fit is right; that is for the likelihood
//! to judge.

use super::fit::ContourFit;
use super::kind::ContourKind;

/// True if every side of a polygon or chain is longer than three σ of its ends, and no corner is a spike.
///
/// More corners than the readings resolve would otherwise explain noise.
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
        // A turn by more than 150°: two sides along one row of readings, with a corner in the noise. Chains
        // may have it, where an arc meets its chord.
        let spike = is_polygon && d[0] * e[0] + d[1] * e[1] < -0.866 * length * next;
        long && !spike
    })
}

/// True if no vertex is more than three times as far from the centre of the readings as the farthest reading.
///
/// Two nearly parallel sides may meet far away without a cost to the distances. Circles and ellipses are
/// exempt: a short arc has a distant centre.
pub(super) fn stays_near(kind: &ContourKind, state: &[f64], middle: [f64; 2], points: &[[f64; 2]]) -> bool {
    let from = |p: [f64; 2]| (p[0] - middle[0]).hypot(p[1] - middle[1]);
    let reach = points.iter().map(|&p| from(p)).fold(0.0, f64::max);
    let theta = &state[..kind.parameters()];
    let near = |p: &[f64; 2]| from(*p) <= 3.0 * reach;
    matches!(kind, ContourKind::Circle | ContourKind::Ellipse)
        || kind.outline(theta).is_none_or(|o| o.vertices.iter().all(near))
}
