//! Cubic splines along intersection curves that are neither lines nor ellipses.
//!
//! Input: a curve and the range of an edge on it. Output: points and derivatives of a cubic Hermite spline.

use super::surfaces::Curve3;
use super::traced::Traced;
use crate::brep::{EdgeCurve, unit};
use planish_core::DVec3;
use std::f64::consts::PI;

/// Number of cubic pieces of the intersection curve of two cylinders.
///
/// More pieces follow the curve more closely (the error falls with the fourth power) and make files larger.
pub(super) const SPLINE_PIECES: usize = 48;
/// Number of cubic pieces of a traced curve.
///
/// The lengths of its derivatives are those of chords, which is less accurate than differences of the curve.
pub(super) const TRACED_PIECES: usize = 96;

/// A cubic Hermite spline through points of a curve, with the derivatives of the curve.
pub(super) fn spline(curve: &Curve3, [from, to]: [f64; 2]) -> EdgeCurve {
    let n = SPLINE_PIECES;
    let h = (to - from) / n as f64;
    let at = |k: usize| from + h * k as f64;
    let mut points: Vec<DVec3> = (0..=n).map(|k| curve.point(at(k))).collect();
    points[n] = curve.point(to);
    // Central differences of fourth order, and one-sided ones where these would leave the range [0, π] of the
    // parameter. A smaller step has a smaller truncation error (e⁴), but a larger rounding error (1/e).
    let e = 0.02 * h.abs().max(1e-3);
    let derivatives = (0..=n)
        .map(|k| {
            let t = at(k);
            let inside = |t: f64| (0.0..=PI).contains(&t);
            let d = match inside(t - 2.0 * e) && inside(t + 2.0 * e) {
                true => {
                    let (a, b, c, d) = (
                        curve.point(t - 2.0 * e),
                        curve.point(t - e),
                        curve.point(t + e),
                        curve.point(t + 2.0 * e),
                    );
                    (a - 8.0 * b + 8.0 * c - d) / (12.0 * e)
                }
                false => {
                    let s = if t < 1.0 { 1.0 } else { -1.0 };
                    let q = |m: f64| curve.point(t + s * m * e);
                    let (a, b, c, d, f) = (q(0.0), q(1.0), q(2.0), q(3.0), q(4.0));
                    DVec3::from_array([0, 1, 2].map(|i| {
                        s * (-25.0 * a[i] + 48.0 * b[i] - 36.0 * c[i] + 16.0 * d[i] - 3.0 * f[i]) / (12.0 * e)
                    }))
                }
            };
            d.map(|c| c * h)
        })
        .collect();
    EdgeCurve::Spline { points, derivatives }
}

/// A cubic Hermite spline through equally spaced points of a traced curve, with its tangents there.
pub(super) fn traced_spline(traced: &Traced, range: [f64; 2], ends: Option<[DVec3; 2]>) -> EdgeCurve {
    let n = TRACED_PIECES;
    let mut points: Vec<DVec3> = traced.evenly(range, n).into_iter().map(|t| traced.point(t)).collect();
    // The ends are vertices that other edges share, so they are taken exactly.
    if let Some([p, q]) = ends {
        (points[0], points[n]) = (p, q);
    }
    let chord = |k: usize| (points[k + 1] - points[k]).length();
    let derivatives = (0..=n)
        .map(|k| {
            let (lo, hi) = (k.saturating_sub(1), (k + 1).min(n));
            let length = (lo..hi).map(chord).sum::<f64>() / (hi - lo) as f64;
            let chord = unit(points[hi] - points[lo]);
            let tangent = traced.tangent(points[k]);
            let turn = tangent.dot(chord);
            // At an end where the surfaces touch, both normals agree and their cross product is rounding. The
            // tangent is used only if it agrees with the chord; its sign may be either.
            match turn.abs() > 0.9 {
                true => tangent.map(|c| turn.signum() * length * c),
                false => chord.map(|c| length * c),
            }
        })
        .collect();
    EdgeCurve::Spline { points, derivatives }
}
