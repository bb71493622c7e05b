//! Small arcs between two lines that they touch.
//!
//! A fillet of a few pixels looks like a chamfer to a fit without its ends. With the lines on both sides
//! known, it has one unknown, its radius: an arc that touches both lines is compared with a chamfer by all
//! points.

use super::moments::Shape;
use super::pieces::{PATH_SIGMA, PieceGraph};
use planish_solid::views::distance;

/// Largest chord of a piece that may be a fillet instead of a chamfer, in pixels.
const MAX_CHAMFER: f64 = 40.0;
/// Step of the distance from the corner to the ends of the fillet, in pixels.
const STEP: f64 = 0.1;
/// Increase of Σ r²/σ² up to which an arc touches the lines beside it.
const TOUCHES: f64 = 25.0;
/// Minimum sine of the angle between the lines.
const MIN_SINE: f64 = 0.2;

impl PieceGraph {
    /// Replaces pieces between two lines by arcs that touch both, where these fit.
    pub(super) fn fit_fillets(&mut self) {
        for k in 0..self.pieces.len() {
            if let Some(shape) = self.fillet(k) {
                self.pieces[k].shape = shape;
            }
        }
    }

    /// The arc that replaces a piece.
    fn fillet(&self, k: usize) -> Option<Shape> {
        let piece = &self.pieces[k];
        if piece.is_dropped || piece.is_closed {
            return None;
        }
        let [Some(from), Some(to)] = piece.nodes else { return None };
        let beside = |node: usize| match self.members[node][..] {
            [a, b] if a == k => Some(b),
            [a, b] if b == k => Some(a),
            _ => None,
        };
        let [a, b] = [beside(from)?, beside(to)?];
        let [Shape::Line(p, u), Shape::Line(q, v)] = [self.pieces[a].shape, self.pieces[b].shape] else {
            return None;
        };
        let sine = u[0] * v[1] - u[1] * v[0];
        if a == b || sine.abs() < MIN_SINE {
            return None;
        }
        let is_line = matches!(piece.shape, Shape::Line(..));
        let chord = distance(piece.ends[0], piece.ends[1]);
        if is_line && chord > MAX_CHAMFER {
            return None;
        }
        // The corner of both lines, and the directions from it along them.
        let t = ((q[0] - p[0]) * v[1] - (q[1] - p[1]) * v[0]) / sine;
        let corner = [p[0] + t * u[0], p[1] + t * u[1]];
        let away = |along: [f64; 2], other: usize| {
            let far = self.pieces[other].points.get(self.pieces[other].points.len() / 2).copied();
            let far = far.unwrap_or(self.pieces[other].ends[0]);
            let sign = (far[0] - corner[0]) * along[0] + (far[1] - corner[1]) * along[1];
            if sign < 0.0 { along.map(|c| -c) } else { along }
        };
        let arms = [away(u, a), away(v, b)];
        // Points of the piece and of the lines near it.
        let mut points = piece.raw.clone();
        for (other, end) in [(a, piece.ends[0]), (b, piece.ends[1])] {
            let near = |p: &&[f64; 2]| distance(**p, end) <= 0.5 * chord + 4.0;
            points.extend(self.pieces[other].raw.iter().filter(near));
        }
        let longest = 2.0 * chord + 4.0;
        let fillets = (10..(longest / STEP) as usize).map(|n| Fillet::new(corner, arms, STEP * n as f64));
        let cost = |fillet: &Fillet| points.iter().map(|p| fillet.off(*p).powi(2)).sum::<f64>();
        let best = fillets.map(|f| (cost(&f), f)).min_by(|a, b| a.0.total_cmp(&b.0))?;
        let chain = [self.pieces[a].shape, piece.shape, self.pieces[b].shape];
        let off = |p: &[f64; 2]| chain.iter().map(|s| s.off(*p).abs()).fold(f64::MAX, f64::min);
        let other: f64 = points.iter().map(|p| off(p).powi(2)).sum();
        let is_better = match is_line {
            true => best.0 < other,
            false => best.0 <= other + TOUCHES * PATH_SIGMA * PATH_SIGMA,
        };
        is_better.then_some(Shape::Circle(best.1.center, best.1.radius))
    }
}

/// An arc between two lines from one corner.
struct Fillet {
    corner: [f64; 2],
    arms: [[f64; 2]; 2],
    reach: f64,
    center: [f64; 2],
    radius: f64,
}

impl Fillet {
    /// The arc that touches both lines at a distance from their corner.
    fn new(corner: [f64; 2], arms: [[f64; 2]; 2], reach: f64) -> Self {
        let sum = [arms[0][0] + arms[1][0], arms[0][1] + arms[1][1]];
        // The centre is on the bisector, and its foot on an arm is the end of the arc.
        let along = sum[0] * arms[0][0] + sum[1] * arms[0][1];
        let center = [0, 1].map(|k| corner[k] + reach * sum[k] / along);
        let foot = [0, 1].map(|k| corner[k] + reach * arms[0][k]);
        Self { corner, arms, reach, center, radius: distance(center, foot) }
    }

    /// Distance of a point from the lines and the arc between them.
    fn off(&self, p: [f64; 2]) -> f64 {
        let step = [p[0] - self.corner[0], p[1] - self.corner[1]];
        let along = self.arms.map(|arm| step[0] * arm[0] + step[1] * arm[1]);
        let arm = self.arms[usize::from(along[1] > along[0])];
        match along[0].max(along[1]) > self.reach {
            true => (step[0] * arm[1] - step[1] * arm[0]).abs(),
            false => (distance(p, self.center) - self.radius).abs(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arc_that_touches_both_arms_has_the_distance_of_its_ends() {
        let fillet = Fillet::new([10.0, 20.0], [[1.0, 0.0], [0.0, 1.0]], 6.0);
        assert!((fillet.center[0] - 16.0).abs() < 1e-12 && (fillet.radius - 6.0).abs() < 1e-12);
        assert!(fillet.off([30.0, 20.5]) - 0.5 < 1e-12);
        // The middle of the arc.
        let middle = 16.0 - 6.0 / 2.0_f64.sqrt();
        assert!(fillet.off([middle, middle + 10.0]) < 1e-12);
    }
}
