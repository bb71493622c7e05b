//! Centres of short arcs from those of longer ones.
//!
//! A circle through points of an arc of angle θ has a centre with about 8/θ² times the error of the points.
//! If the points lie on a circle around the centre of a longer arc, that centre is used.

use super::{Accuracy, Stroke, ends};
use planish_solid::views::{Curve2, distance};

/// Error of points on a common circle, relative to that of coordinates: along both axes, and of the centre.
const ON_CIRCLE: f64 = 4.0;
/// Maximum error of a centre relative to the radius.
const MAX_CENTRE_ERROR: f64 = 0.05;
/// Maximum number of arcs that are compared with each other.
const MAX_ARCS: usize = 5000;

/// Gives short arcs the centres of longer ones around which they run.
pub(crate) fn share_centres(strokes: &mut [Stroke], accuracy: &Accuracy) {
    let mut arcs: Vec<(f64, usize)> = (strokes.iter().enumerate())
        .filter_map(|(k, stroke)| match &stroke.drawn.curve {
            Curve2::Arc { sweep, .. } => Some((*sweep, k)),
            _ => None,
        })
        .collect();
    if arcs.len() > MAX_ARCS {
        return;
    }
    arcs.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut centres: Vec<[f64; 2]> = Vec::new();
    for (_, at) in arcs {
        let curve = &mut strokes[at].drawn.curve;
        let Curve2::Arc { center, radius, start, sweep } = &*curve else { continue };
        let error = |angle: f64| (8.0 / (angle * angle)).max(1.0) * ON_CIRCLE * accuracy.rounding;
        let (near, own) = (error(*sweep), *center);
        let points = || {
            (0..=4)
                .map(|k| start + 0.25 * f64::from(k) * sweep)
                .map(|angle| [own[0] + radius * angle.cos(), own[1] + radius * angle.sin()])
        };
        let spread = |c: &[f64; 2]| {
            let (lo, hi) = points()
                .map(|p| distance(p, *c))
                .fold((f64::MAX, 0.0_f64), |(lo, hi), r| (lo.min(r), hi.max(r)));
            (hi - lo, 0.5 * (lo + hi))
        };
        // An arc so short that its centre may be anywhere lies on a circle around any centre.
        let is_known = near <= MAX_CENTRE_ERROR * radius;
        let shared = centres.iter().filter(|c| is_known && distance(**c, own) <= near);
        let best = shared.map(|c| (spread(c), *c)).min_by(|a, b| a.0.0.total_cmp(&b.0.0));
        match best {
            Some(((spread, mean), c)) if spread <= ON_CIRCLE * accuracy.rounding => {
                let [first, last] = ends(curve);
                let angle = |p: [f64; 2]| (p[1] - c[1]).atan2(p[0] - c[0]);
                let turned = (angle(last) - angle(first)).rem_euclid(std::f64::consts::TAU);
                let is_whole = *sweep >= std::f64::consts::TAU;
                let sweep = if is_whole { *sweep } else { turned };
                *curve = Curve2::Arc { center: c, radius: mean, start: angle(first), sweep };
            }
            _ if is_known => centres.push(own),
            _ => {}
        }
    }
}
