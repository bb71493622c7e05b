//! Polylines that approximate curves.
//!
//! Input: the spans of a polyline, in order. Output: the same curves, but runs of short segments with small
//! angles between them are one chain, as the points of a spline are. Otherwise each segment of the image of
//! an intersection curve would be the edge of a plane.

use planish_solid::drawing::Curve2;

/// Maximum angle between neighbouring segments of a curve, in radians; sides of a regular 30-gon turn by
/// 0.21.
const MAX_TURN: f64 = 0.2;
/// Maximum ratio of the lengths of neighbouring segments of a curve. A side beside a rounding is longer.
const MAX_RATIO: f64 = 4.0;
/// Minimum number of segments of a curve.
const MIN_SEGMENTS: usize = 8;
/// Minimum angle between the first and the last segment of a curve, in radians, or sum of all angles.
/// Less is a straight line that was divided.
const MIN_TURN: f64 = 0.02;

/// Joins segments that approximate a curve.
pub(super) fn with_chains(curves: Vec<Curve2>) -> Vec<Curve2> {
    let mut found = Vec::new();
    let mut run: Vec<[[f64; 2]; 2]> = Vec::new();
    for curve in curves {
        let Curve2::Segment(a, b) = curve else {
            found.extend(ended(&mut run));
            found.push(curve);
            continue;
        };
        if run.last().is_some_and(|last| !continues(*last, [a, b])) {
            found.extend(ended(&mut run));
        }
        run.push([a, b]);
    }
    found.extend(ended(&mut run));
    found
}

/// The curves of a run of segments, which is empty after that.
fn ended(run: &mut Vec<[[f64; 2]; 2]>) -> Vec<Curve2> {
    let run = std::mem::take(run);
    let turns: f64 = run.windows(2).map(|pair| turn(pair[0], pair[1]).abs()).sum();
    if run.len() < MIN_SEGMENTS || turns < MIN_TURN {
        return run.into_iter().map(|[a, b]| Curve2::Segment(a, b)).collect();
    }
    let ends = run.iter().map(|[_, b]| *b);
    vec![Curve2::Chain(std::iter::once(run[0][0]).chain(ends).collect())]
}

/// Whether a segment continues the curve of the previous one.
fn continues(previous: [[f64; 2]; 2], next: [[f64; 2]; 2]) -> bool {
    let [a, b] = [previous, next].map(|[p, q]| (q[0] - p[0]).hypot(q[1] - p[1]));
    // A segment without length has no direction; its angle to others is zero.
    a > 0.0 && b > 0.0 && a.max(b) <= MAX_RATIO * a.min(b) && turn(previous, next).abs() <= MAX_TURN
}

/// Angle from the direction of one segment to that of another.
fn turn(first: [[f64; 2]; 2], second: [[f64; 2]; 2]) -> f64 {
    let [a, b] = [first, second].map(|[p, q]| [q[0] - p[0], q[1] - p[1]]);
    (a[0] * b[1] - a[1] * b[0]).atan2(a[0] * b[0] + a[1] * b[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polyline(points: &[[f64; 2]]) -> Vec<Curve2> {
        points.windows(2).map(|p| Curve2::Segment(p[0], p[1])).collect()
    }

    #[test]
    fn points_of_a_curve_are_a_chain_and_its_straight_neighbours_are_segments() {
        let mut points = vec![[-20.0, 5.0]];
        points.extend((0..=20).map(|k| {
            let (sin, cos) = (f64::from(k) * 0.05).sin_cos();
            [8.0 * sin, 5.0 * cos]
        }));
        points.push([7.0, -20.0]);
        let found = with_chains(polyline(&points));
        let [Curve2::Segment(..), Curve2::Chain(chain), Curve2::Segment(..)] = &found[..] else {
            panic!("{found:?}")
        };
        assert_eq!(chain[..], points[1..22]);
    }

    #[test]
    fn sides_of_a_polygon_and_a_divided_line_stay_segments() {
        let polygon: Vec<[f64; 2]> = (0..=16)
            .map(|k| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 16.0).sin_cos();
                [cos, sin]
            })
            .collect();
        let line: Vec<[f64; 2]> = (0..20).map(|k| [f64::from(k), 2.0 * f64::from(k)]).collect();
        for points in [polygon, line] {
            assert_eq!(with_chains(polyline(&points)), polyline(&points));
        }
    }
}
