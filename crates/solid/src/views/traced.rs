//! Curves between two surfaces that have no simple form, followed step by step.
//!
//! Input: two surfaces by their signed distances, and points near both. Output: chains of points on
//! both, equally far apart, between which any other point is found by Newton's method.
//!
//! Not guaranteed: curves that cross themselves, and parts shorter than a few steps.

use super::candidates::Candidate;
use crate::brep::{along, unit};
use planish_estimate::vector3::{cross, dot, norm, scale, sub};

/// Steps after which a curve is given up.
const MAX_STEPS: usize = 4000;
/// Where surfaces touch, steps are halved down to this share.
const SHORTEST: f64 = 1e-3;

/// A curve on two surfaces.
#[derive(Clone)]
pub(super) struct Traced {
    pub(super) points: Vec<[f64; 3]>,
    pub(super) closed: bool,
    pub(super) surfaces: [Candidate; 2],
}

/// The point on two surfaces that is nearest to a point, roughly; none where they run along each other.
pub(super) fn on_both(surfaces: &[Candidate; 2], mut p: [f64; 3], within: f64) -> Option<[f64; 3]> {
    let [s, t] = surfaces;
    let mut last = f64::MAX;
    for _ in 0..30 {
        let (u, v) = (s.value(p), t.value(p));
        let off = u.abs().max(v.abs());
        if off >= last && off < within {
            return Some(p);
        }
        last = off;
        let (n, m) = (s.normal(p), t.normal(p));
        let c = dot(n, m);
        let det = 1.0 - c * c;
        if det < 1e-10 {
            return None;
        }
        let (a, b) = ((u - c * v) / det, (v - c * u) / det);
        p = along(along(p, -a, n), -b, m);
    }
    (last < within).then_some(p)
}

impl Traced {
    /// The unit tangent at a point of it.
    pub(super) fn tangent(&self, p: [f64; 3]) -> [f64; 3] {
        unit(cross(self.surfaces[0].normal(p), self.surfaces[1].normal(p)))
    }

    /// The largest parameter; a closed curve's comes back to its start there.
    pub(super) fn end(&self) -> f64 {
        let n = self.points.len();
        (if self.closed { n } else { n - 1 }) as f64
    }

    /// The point of a parameter: the index of a point, and the share of the way to the next.
    pub(super) fn point(&self, t: f64) -> [f64; 3] {
        let n = self.points.len();
        let t = if self.closed { t.rem_euclid(n as f64) } else { t.clamp(0.0, self.end()) };
        let k = (t.floor() as usize).min(if self.closed { n - 1 } else { n - 2 });
        let (a, b) = (self.points[k], self.points[(k + 1) % n]);
        let guess = along(a, t - k as f64, sub(b, a));
        on_both(&self.surfaces, guess, 1e-6 * norm(sub(b, a))).unwrap_or(guess)
    }

    /// Parameters of points that are equally far apart between two others.
    pub(super) fn evenly(&self, [from, to]: [f64; 2], count: usize) -> Vec<f64> {
        let mut knots = vec![from];
        knots.extend(((from.floor() as usize + 1)..=(to.ceil() as usize)).map(|k| (k as f64).min(to)));
        let mut lengths = vec![0.0];
        for pair in knots.windows(2) {
            lengths.push(lengths[lengths.len() - 1] + norm(sub(self.point(pair[1]), self.point(pair[0]))));
        }
        let total = lengths[lengths.len() - 1];
        (0..=count)
            .map(|k| {
                let at = total * k as f64 / count as f64;
                let next = lengths.partition_point(|l| *l < at).clamp(1, knots.len() - 1);
                let share =
                    (at - lengths[next - 1]) / (lengths[next] - lengths[next - 1]).max(f64::MIN_POSITIVE);
                knots[next - 1] + share.min(1.0) * (knots[next] - knots[next - 1])
            })
            .collect()
    }

    /// The parameter of the point of the curve that is nearest to a point.
    pub(super) fn parameter(&self, p: [f64; 3]) -> f64 {
        let n = self.points.len();
        let segments = if self.closed { n } else { n - 1 };
        let mut best = (f64::MAX, 0.0);
        for k in 0..segments {
            let (a, b) = (self.points[k], self.points[(k + 1) % n]);
            let d = sub(b, a);
            let share = (dot(sub(p, a), d) / dot(d, d)).clamp(0.0, 1.0);
            let far = norm(sub(along(a, share, d), p));
            if far < best.0 {
                best = (far, k as f64 + share);
            }
        }
        let t = best.1;
        // Newton moves an interpolated point sideways, hardly along; once is enough.
        let k = (t.floor() as usize).min(segments - 1);
        let d = sub(self.points[(k + 1) % n], self.points[k]);
        let t = t + dot(sub(p, self.point(t)), d) / dot(d, d);
        if self.closed { t.rem_euclid(n as f64) } else { t.clamp(0.0, self.end()) }
    }
}

/// Follows the curves of two surfaces through points near them, while they stay `inside`.
pub(super) fn traced(
    surfaces: &[Candidate; 2],
    seeds: &[[f64; 3]],
    step: f64,
    inside: impl Fn([f64; 3]) -> bool,
) -> Vec<Traced> {
    let mut found: Vec<Traced> = Vec::new();
    for seed in seeds {
        let Some(start) = on_both(surfaces, *seed, 1e-6 * step) else {
            continue;
        };
        let known = |c: &Traced| c.points.iter().any(|p| norm(sub(*p, start)) < step);
        if !inside(start) || found.iter().any(known) {
            continue;
        }
        let (forward, closed) = follow(surfaces, start, step, &inside);
        let mut points = forward;
        if !closed {
            let (mut back, _) = follow(surfaces, start, -step, &inside);
            back.reverse();
            back.pop();
            back.extend(points);
            points = back;
        }
        if points.len() >= 4 {
            found.push(Traced { points, closed, surfaces: surfaces.clone() });
        }
    }
    found
}

fn follow(
    surfaces: &[Candidate; 2],
    start: [f64; 3],
    step: f64,
    inside: &impl Fn([f64; 3]) -> bool,
) -> (Vec<[f64; 3]>, bool) {
    let sense = step.signum();
    let whole = step.abs();
    let normals = |p: [f64; 3]| cross(surfaces[0].normal(p), surfaces[1].normal(p));
    let direction = |p: [f64; 3]| {
        let d = normals(p);
        (norm(d) > 1e-5).then(|| scale(sense, unit(d)))
    };
    // One step of a length; none where the surfaces touch on the way, as beyond that the direction turns
    // round.
    let stepped = |p: [f64; 3], length: f64| {
        let first = direction(p)?;
        let middle = on_both(surfaces, along(p, length / 2.0, first), 1e-6 * whole)?;
        let d = direction(middle)?;
        let next = on_both(surfaces, along(p, length, d), 1e-6 * whole)?;
        let moved = sub(next, p);
        let goes_on =
            dot(moved, d) > 0.3 * length && dot(direction(next)?, first) > 0.5 && dot(d, first) > 0.5;
        (goes_on && norm(moved) < 1.5 * length).then_some(next)
    };
    let mut points = vec![start];
    let mut p = start;
    let mut length = whole;
    while points.len() < MAX_STEPS {
        let Some(next) = stepped(p, length) else {
            length /= 2.0;
            if length < SHORTEST * whole {
                points.extend(touching_point(&points, normals));
                break;
            }
            continue;
        };
        // Back at the start: the last stretch may be up to one and a half steps long.
        let left = sub(start, next);
        let ahead = direction(next).is_some_and(|d| dot(left, d) >= -0.3 * whole);
        if points.len() > 3 && norm(left) < 1.01 * whole && ahead {
            if norm(left) > 0.5 * whole {
                points.push(next);
            }
            return (points, true);
        }
        points.push(next);
        if !inside(next) {
            break;
        }
        p = next;
    }
    (points, false)
}

/// Where two surfaces touch just beyond the last of some points: there the angle between them, which falls
/// evenly, is zero.
fn touching_point(points: &[[f64; 3]], normals: impl Fn([f64; 3]) -> [f64; 3]) -> Option<[f64; 3]> {
    let [.., before, last] = points else { return None };
    let moved = sub(*last, *before);
    let (from, to) = (norm(normals(*before)), norm(normals(*last)));
    let left = to / (from - to);
    (left > 0.0 && left < 4.0).then(|| along(*last, left, moved))
}
