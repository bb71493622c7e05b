//! Nearly smooth joints of a chain, as soft constraints.
//!
//! If an arc continues a line in its direction, the joint can slide along the line while the circle of the
//! arc stays the same. The outline then changes to second order only, and readings leave the joint
//! undetermined. In: a chain near its optimum. Out: for each nearly smooth joint, the equation that it is
//! smooth to a few degrees. Not guaranteed: that it is smooth; better-informed readings overrule the
//! equation.

use super::curve::ends;
use super::kind::ContourKind;
use std::f64::consts::{PI, TAU};

/// σ of the angle of a smooth joint.
///
/// Smaller values would force slight corners to be smooth; much larger ones leave the joint undetermined
/// (decision record 0053).
const SIGMA_RAD: f64 = 5.0 * PI / 180.0;
/// Joints that turn by more than this many σ (15°) at the start are corners and get no equation.
const MAX_SMOOTH_TURN_SIGMAS: f64 = 3.0;

/// A joint at which the outline does not turn, up to σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Joint {
    /// The piece that ends at the joint, and the next one.
    pub(crate) pieces: [usize; 2],
    /// σ of the angle in radians.
    pub(crate) sigma_rad: f64,
}

impl Joint {
    /// The angle by which the outline turns at the joint, in (−π, π]; adds its derivative to `by_theta`.
    ///
    /// With `e` the chord of a piece and `b = tan(θ/4)`, the outline leaves it at
    /// `atan2(e_y, e_x) + 2 atan b` and enters it at `… − 2 atan b`.
    pub(super) fn violation(&self, kind: &ContourKind, theta: &[f64], by_theta: &mut [f64]) -> f64 {
        let mut turn = 0.0;
        for (piece, sign) in self.pieces.into_iter().zip([-1.0, 1.0]) {
            let (from, to) = ends(kind, piece);
            let (a, b) = (kind.vertex(theta, from), kind.vertex(theta, to));
            let e = [b[0] - a[0], b[1] - a[1]];
            let square = (e[0] * e[0] + e[1] * e[1]).max(f64::MIN_POSITIVE);
            let (bulge, index) = kind.bulge(theta, piece);
            turn += sign * e[1].atan2(e[0]) - 2.0 * bulge.atan();
            let by_end = [-sign * e[1] / square, sign * e[0] / square];
            kind.add_vertex_derivative(theta, to, by_end, by_theta);
            kind.add_vertex_derivative(theta, from, by_end.map(|d| -d), by_theta);
            if let Some(index) = index {
                by_theta[index] -= 2.0 / (1.0 + bulge * bulge);
            }
        }
        // Each term has a cut of its own; only the sum modulo a full turn is meaningful.
        turn - TAU * (turn / TAU).round()
    }
}

/// The joints of a chain with an arc on at least one side that turn by less than 15° at `theta`; empty for
/// other kinds.
///
/// Joints of two lines are excluded: sliding one of these changes the outline to first order.
pub(crate) fn joints(kind: &ContourKind, theta: &[f64]) -> Vec<Joint> {
    let ContourKind::Chain { arcs, closed } = kind else {
        return Vec::new();
    };
    let count = arcs.len();
    // A closed chain also has a joint between its last and its first piece.
    let last = if *closed && count > 1 { count } else { count - 1 };
    (0..last)
        .map(|k| Joint { pieces: [k, (k + 1) % count], sigma_rad: SIGMA_RAD })
        .filter(|joint| joint.pieces.iter().any(|&k| arcs[k]))
        .filter(|joint| {
            joint.violation(kind, theta, &mut vec![0.0; theta.len()]).abs()
                <= MAX_SMOOTH_TURN_SIGMAS * SIGMA_RAD
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line, a quarter circle that continues it smoothly, and a line that turns by 45°.
    fn line_arc_line() -> (ContourKind, Vec<f64>) {
        let kind = ContourKind::Chain { arcs: vec![false, true, false], closed: false };
        let bulge = (PI / 8.0).tan();
        (kind, vec![-1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 2.0, bulge])
    }

    #[test]
    fn smooth_joints_are_distinguished_from_corners() {
        let (kind, theta) = line_arc_line();
        let found = joints(&kind, &theta);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].pieces, [0, 1]);
        let corner = Joint { pieces: [1, 2], sigma_rad: 1.0 };
        let turn = corner.violation(&kind, &theta, &mut [0.0; 9]);
        assert!((turn - 0.25 * PI).abs() < 1e-12, "{turn}");
        assert!(joints(&ContourKind::Slot, &[0.0, 0.0, 2.0, 1.0, 0.0]).is_empty());
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let (kind, theta) = line_arc_line();
        for pieces in [[0, 1], [1, 2]] {
            let joint = Joint { pieces, sigma_rad: 1.0 };
            let mut by_theta = vec![0.0; theta.len()];
            joint.violation(&kind, &theta, &mut by_theta);
            for k in 0..theta.len() {
                let at = |step: f64| {
                    let mut near = theta.clone();
                    near[k] += step;
                    joint.violation(&kind, &near, &mut vec![0.0; theta.len()])
                };
                let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
                assert!((slope - by_theta[k]).abs() < 1e-8, "{pieces:?} {k}: {slope} {}", by_theta[k]);
            }
        }
    }
}
