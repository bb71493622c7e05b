//! Traces intersection curves that have no simple form, step by step.
//!
//! Input: two surfaces by their signed distances, and points near both. Output: equally spaced points on both
//! surfaces. Any other point between them is found by Newton's method.
//!
//! Limits: curves that cross themselves are not followed through the crossing, and curves shorter than a few
//! steps are not found.

use super::candidates::Candidate;
use crate::brep::unit;
use planish_core::DVec3;

/// Maximum number of steps of a curve. It bounds the time for curves that never close.
const MAX_STEPS: usize = 4000;
/// Near contacts of the surfaces, steps are halved down to this share of the first step.
///
/// Smaller steps come closer to the contact, but there the direction of the curve is undetermined.
const MIN_STEP: f64 = 1e-3;

/// A curve on two surfaces.
#[derive(Clone)]
pub(super) struct Traced {
    pub(super) points: Vec<DVec3>,
    pub(super) closed: bool,
    pub(super) surfaces: [Candidate; 2],
}

/// A point on two surfaces near a given point; `None` if the surfaces are nearly tangent to each other.
///
/// Each step goes to the nearest point of both tangent planes. Iteration stops at rounding, when the distance
/// no longer falls, so the result is as exact as the surfaces allow.
pub(super) fn on_both(surfaces: &[Candidate; 2], mut p: DVec3, within: f64) -> Option<DVec3> {
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
        let c = n.dot(m);
        let det = 1.0 - c * c;
        if det < 1e-10 {
            return None;
        }
        let (a, b) = ((u - c * v) / det, (v - c * u) / det);
        p = p - a * n - b * m;
    }
    (last < within).then_some(p)
}

impl Traced {
    /// Unit tangent at a point of the curve.
    pub(super) fn tangent(&self, p: DVec3) -> DVec3 {
        unit(self.surfaces[0].normal(p).cross(self.surfaces[1].normal(p)))
    }

    /// The largest parameter. A closed curve is at its start again there.
    pub(super) fn end(&self) -> f64 {
        let n = self.points.len();
        (if self.closed { n } else { n - 1 }) as f64
    }

    /// The point at a parameter: the index of a traced point, plus the share of the chord to the next.
    pub(super) fn point(&self, t: f64) -> DVec3 {
        let n = self.points.len();
        let t = if self.closed { t.rem_euclid(n as f64) } else { t.clamp(0.0, self.end()) };
        let k = (t.floor() as usize).min(if self.closed { n - 1 } else { n - 2 });
        let (a, b) = (self.points[k], self.points[(k + 1) % n]);
        let guess = a + (t - k as f64) * (b - a);
        on_both(&self.surfaces, guess, 1e-6 * (b - a).length()).unwrap_or(guess)
    }

    /// Parameters of points that are equally spaced between two others.
    pub(super) fn evenly(&self, [from, to]: [f64; 2], count: usize) -> Vec<f64> {
        let mut knots = vec![from];
        knots.extend(((from.floor() as usize + 1)..=(to.ceil() as usize)).map(|k| (k as f64).min(to)));
        let mut lengths = vec![0.0];
        for pair in knots.windows(2) {
            lengths.push(lengths[lengths.len() - 1] + (self.point(pair[1]) - self.point(pair[0])).length());
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

    /// The parameter of the point of the curve nearest to a given point.
    pub(super) fn parameter(&self, p: DVec3) -> f64 {
        let n = self.points.len();
        let segments = if self.closed { n } else { n - 1 };
        let mut best = (f64::MAX, 0.0);
        for k in 0..segments {
            let (a, b) = (self.points[k], self.points[(k + 1) % n]);
            let d = b - a;
            let share = ((p - a).dot(d) / d.length_squared()).clamp(0.0, 1.0);
            let far = (a + share * d - p).length();
            if far < best.0 {
                best = (far, k as f64 + share);
            }
        }
        let t = best.1;
        // Newton's method moves an interpolated point across the curve and hardly along it, so one correction
        // along the chord is enough.
        let k = (t.floor() as usize).min(segments - 1);
        let d = self.points[(k + 1) % n] - self.points[k];
        let t = t + (p - self.point(t)).dot(d) / d.length_squared();
        if self.closed { t.rem_euclid(n as f64) } else { t.clamp(0.0, self.end()) }
    }
}

/// Traces the intersection curves through points near them, while they stay `inside`.
pub(super) fn traced(
    surfaces: &[Candidate; 2],
    seeds: &[DVec3],
    step: f64,
    inside: impl Fn(DVec3) -> bool,
) -> Vec<Traced> {
    let mut found: Vec<Traced> = Vec::new();
    for seed in seeds {
        let Some(start) = on_both(surfaces, *seed, 1e-6 * step) else {
            continue;
        };
        // Many seeds lie on the same curve; one within a step of it adds nothing.
        let known = |c: &Traced| c.points.iter().any(|p| (*p - start).length() < step);
        if !inside(start) || found.iter().any(known) {
            continue;
        }
        let (forward, closed) = follow(surfaces, start, step, &inside);
        // An open curve is followed from the seed in both directions; the seed is in both parts.
        let mut points = forward;
        if !closed {
            let (mut back, _) = follow(surfaces, start, -step, &inside);
            back.reverse();
            back.pop();
            back.extend(points);
            points = back;
        }
        // Fewer points are a curve of a few steps, whose tangents would be inaccurate.
        if points.len() >= 4 {
            found.push(Traced { points, closed, surfaces: surfaces.clone() });
        }
    }
    found
}

/// Points of a curve from a start in the direction of the sign of `step`, and whether it is closed.
fn follow(
    surfaces: &[Candidate; 2],
    start: DVec3,
    step: f64,
    inside: &impl Fn(DVec3) -> bool,
) -> (Vec<DVec3>, bool) {
    let sense = step.signum();
    let max_step = step.abs();
    let normals = |p: DVec3| surfaces[0].normal(p).cross(surfaces[1].normal(p));
    let direction = |p: DVec3| {
        let d = normals(p);
        (d.length() > 1e-5).then(|| sense * unit(d))
    };
    // One step by the midpoint rule. `None` if the surfaces touch on the way: beyond a contact, the cross
    // product of the normals has the opposite direction, and the curve would be followed backwards.
    let stepped = |p: DVec3, length: f64| {
        let first = direction(p)?;
        let middle = on_both(surfaces, p + length / 2.0 * first, 1e-6 * max_step)?;
        let d = direction(middle)?;
        let next = on_both(surfaces, p + length * d, 1e-6 * max_step)?;
        let moved = next - p;
        let continues =
            moved.dot(d) > 0.3 * length && direction(next)?.dot(first) > 0.5 && d.dot(first) > 0.5;
        (continues && moved.length() < 1.5 * length).then_some(next)
    };
    let mut points = vec![start];
    let mut p = start;
    let mut length = max_step;
    while points.len() < MAX_STEPS {
        let Some(next) = stepped(p, length) else {
            length /= 2.0;
            if length < MIN_STEP * max_step {
                points.extend(touching_point(&points, normals));
                break;
            }
            continue;
        };
        // Back at the start. Instead of a very short last chord, the last one may have up to 1.5 steps.
        let left = start - next;
        let ahead = direction(next).is_some_and(|d| left.dot(d) >= -0.3 * max_step);
        if points.len() > 3 && left.length() < 1.01 * max_step && ahead {
            if left.length() > 0.5 * max_step {
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

/// The contact of two surfaces just beyond the last point.
///
/// The angle between the surfaces falls linearly towards a contact, so its zero is extrapolated from the last
/// two points.
fn touching_point(points: &[DVec3], normals: impl Fn(DVec3) -> DVec3) -> Option<DVec3> {
    let [.., before, last] = points else { return None };
    let moved = *last - *before;
    let (from, to) = (normals(*before).length(), normals(*last).length());
    let left = to / (from - to);
    (left > 0.0 && left < 4.0).then(|| *last + left * moved)
}
