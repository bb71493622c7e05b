//! Bézier curves of drawings (SVG, PDF) as lines, arcs or points.

use planish_solid::views::Curve2;
use std::f64::consts::TAU;

/// Maximum deviation of a cubic curve that is read as an arc, as a share of the radius.
///
/// Drawing programs write a quarter circle as one cubic, which deviates by 2.7e-4. A larger tolerance would
/// turn other curves into arcs. Guarded by `a_cubic_along_a_circle_becomes_an_arc`.
pub const ARC_TOLERANCE: f64 = 4e-4;
/// Number of segments of a Bézier curve.
const CURVE_SEGMENTS: usize = 48;

/// Converts a Bézier curve: to a line if straight, to an arc if it follows a circle, else to points.
pub(crate) fn bezier(poles: &[[f64; 2]]) -> Curve2 {
    let at = |t: f64| {
        let mut p: Vec<[f64; 2]> = poles.to_vec();
        while p.len() > 1 {
            p = p.windows(2).map(|q| [0, 1].map(|k| q[0][k] + t * (q[1][k] - q[0][k]))).collect();
        }
        p[0]
    };
    let points: Vec<[f64; 2]> = (0..=CURVE_SEGMENTS).map(|k| at(k as f64 / CURVE_SEGMENTS as f64)).collect();
    let (a, m, b) = (points[0], points[CURVE_SEGMENTS / 2], points[CURVE_SEGMENTS]);
    let cross = (m[0] - a[0]) * (b[1] - a[1]) - (m[1] - a[1]) * (b[0] - a[0]);
    let chord = (b[0] - a[0]).hypot(b[1] - a[1]);
    let off = |p: &[f64; 2]| ((p[0] - a[0]) * (b[1] - a[1]) - (p[1] - a[1]) * (b[0] - a[0])).abs();
    let forward = |p: &[f64; 2]| (p[0] - a[0]) * (b[0] - a[0]) + (p[1] - a[1]) * (b[1] - a[1]);
    if chord > 0.0
        && points.iter().all(|p| off(p) <= 1e-9 * chord * chord)
        // A curve on a line that turns back covers more than the segment between its ends.
        && points.windows(2).all(|p| forward(&p[0]) <= forward(&p[1]))
    {
        return Curve2::Segment(a, b);
    }
    // Circle through both ends and the middle.
    let square = |p: [f64; 2]| (p[0] - a[0]).powi(2) + (p[1] - a[1]).powi(2);
    let (sm, sb) = (square(m), square(b));
    let center = [
        a[0] + (sm * (b[1] - a[1]) - sb * (m[1] - a[1])) / (2.0 * cross),
        a[1] + (sb * (m[0] - a[0]) - sm * (b[0] - a[0])) / (2.0 * cross),
    ];
    let radius = (a[0] - center[0]).hypot(a[1] - center[1]);
    let follows =
        |p: &[f64; 2]| ((p[0] - center[0]).hypot(p[1] - center[1]) - radius).abs() <= ARC_TOLERANCE * radius;
    // For collinear points the radius is not finite.
    if radius.is_finite() && radius > 0.0 && points.iter().all(follows) {
        let angle = |p: [f64; 2]| (p[1] - center[1]).atan2(p[0] - center[0]);
        // Summed over small steps, because the angles of the ends leave full turns open.
        let sweeps: f64 = points.windows(2).map(|p| turn(angle(p[1]) - angle(p[0]))).sum();
        let start = angle(if sweeps > 0.0 { a } else { b });
        return Curve2::Arc { center, radius, start, sweep: sweeps.abs().min(TAU) };
    }
    Curve2::Chain(points)
}

/// Reduces an angle to −π to π.
pub(crate) fn turn(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}
