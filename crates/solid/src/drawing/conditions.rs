//! Conditions between coordinates of a view: points on circles and lines, and curves that touch.
//!
//! Input: indices of values. A point is a pair of coordinates; a circle is its centre and its radius.
//! Coordinates may be the same value. Output: residuals in the unit of the coordinates, with derivatives.

use planish_estimate::Condition;

/// Smallest length by which is divided.
const MIN_LENGTH: f64 = 1e-9;

/// Difference of two points, its length, and its direction.
fn between(x: &[f64], from: [usize; 2], to: [usize; 2]) -> ([f64; 2], f64, [f64; 2]) {
    let d = [0, 1].map(|k| x[to[k]] - x[from[k]]);
    let length = d[0].hypot(d[1]).max(MIN_LENGTH);
    (d, length, d.map(|c| c / length))
}

/// The point is on the circle: |p − c| − r = 0.
///
/// ```
/// use planish_solid::drawing::conditions::on_circle;
///
/// // The point 3 4, and a circle of radius 4.9 about the origin.
/// let condition = on_circle([0, 1], [2, 3, 4]);
/// assert!((condition(&[3.0, 4.0, 0.0, 0.0, 4.9]).0 - 0.1).abs() < 1e-12);
/// ```
#[must_use]
pub fn on_circle<'a>(p: [usize; 2], [cx, cy, r]: [usize; 3]) -> Condition<'a> {
    Box::new(move |x| {
        let (_, length, u) = between(x, [cx, cy], p);
        (length - x[r], vec![(p[0], u[0]), (p[1], u[1]), (cx, -u[0]), (cy, -u[1]), (r, -1.0)])
    })
}

/// The point is on the line through two others: its distance from the line is zero.
#[must_use]
pub fn on_line<'a>(own: [usize; 2], [p, q]: [[usize; 2]; 2]) -> Condition<'a> {
    Box::new(move |x| {
        let (d, length, u) = between(x, p, q);
        let e = [0, 1].map(|k| x[own[k]] - x[p[k]]);
        let n = [-u[1], u[0]];
        // How far along the line the point is.
        let share = (d[0] * e[0] + d[1] * e[1]) / (length * length);
        let mut slopes = Vec::with_capacity(6);
        for k in 0..2 {
            slopes.extend([(own[k], n[k]), (p[k], -(1.0 - share) * n[k]), (q[k], -share * n[k])]);
        }
        (n[0] * e[0] + n[1] * e[1], slopes)
    })
}

/// The point is the foot of the centre on the direction of a line: a line through the point then touches the
/// circle there.
#[must_use]
pub fn tangent_at<'a>(own: [usize; 2], center: [usize; 2], [p, q]: [[usize; 2]; 2]) -> Condition<'a> {
    Box::new(move |x| {
        let (_, length, u) = between(x, p, q);
        let e = [0, 1].map(|k| x[own[k]] - x[center[k]]);
        let residual = e[0] * u[0] + e[1] * u[1];
        // The direction of the line depends on its ends.
        let slope = |k: usize| (e[k] - residual * u[k]) / length;
        let mut slopes = Vec::with_capacity(8);
        for k in 0..2 {
            slopes.extend([(own[k], u[k]), (center[k], -u[k]), (q[k], slope(k)), (p[k], -slope(k))]);
        }
        (residual, slopes)
    })
}

/// The line through two points touches the circle: its distance from the centre is the radius. `side` is 1
/// if the centre is to the left of the line, else −1.
#[must_use]
pub fn touches<'a>(line: [[usize; 2]; 2], [cx, cy, r]: [usize; 3], side: f64) -> Condition<'a> {
    let center = on_line([cx, cy], line);
    Box::new(move |x| {
        let (off, mut slopes) = center(x);
        slopes.iter_mut().for_each(|s| s.1 *= side);
        slopes.push((r, -1.0));
        (side * off - x[r], slopes)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_differences() {
        let x = [0.3, 1.2, 2.5, -0.4, 4.0, 3.1, 0.8];
        let conditions = [
            on_circle([0, 1], [2, 3, 6]),
            on_line([0, 1], [[2, 3], [4, 5]]),
            tangent_at([0, 1], [2, 3], [[4, 5], [6, 0]]),
            // The end of a line is also the point.
            tangent_at([0, 1], [2, 3], [[0, 1], [4, 5]]),
            touches([[2, 3], [4, 5]], [0, 1, 6], -1.0),
        ];
        for (number, condition) in conditions.iter().enumerate() {
            let (_, slopes) = condition(&x);
            for k in 0..x.len() {
                let own: f64 = slopes.iter().filter(|s| s.0 == k).map(|s| s.1).sum();
                let at = |step: f64| {
                    let mut moved = x;
                    moved[k] += step;
                    condition(&moved).0
                };
                let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
                assert!((own - difference).abs() < 1e-8, "{number} by {k}: {own} {difference}");
            }
        }
    }

    #[test]
    fn conditions_hold_where_the_curves_meet() {
        // The line y = 2 touches the circle of radius 2 about the origin at (0, 2).
        let x = [-1.0, 2.0, 3.0, 2.0, 0.0, 0.0, 2.0, 0.0, 2.0];
        let (line, center, radius, point) = ([[0, 1], [2, 3]], [4, 5], 6, [7, 8]);
        let circle = [center[0], center[1], radius];
        let all = [
            on_line(point, line),
            on_circle(point, circle),
            tangent_at(point, center, line),
            touches(line, circle, -1.0),
        ];
        assert!(all.iter().all(|c| c(&x).0.abs() < 1e-12));
    }
}
