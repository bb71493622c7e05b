//! Where an open outline ends.
//!
//! Comes in: an open chain about where it is, and readings. Goes out: its two ends as equations beside the
//! readings. A distance to a line or circle does not tell where on it the outline ends; how far readings
//! reach along it does. Not guaranteed: that the thing ends there. It may go on where nothing was seen.

use super::curve::{distance, nearest_piece};
use super::kind::ContourKind;
use super::likelihood::Stroke;
use statrs::function::erf::erfc;
use std::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Readings farther than this many σ from the last piece do not tell its end.
const GATE: f64 = 4.0;

/// What is known of an end: `along · vertex = position`, to `sigma`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct End {
    /// The vertex.
    pub(crate) vertex: usize,
    /// The direction in which the outline ends there.
    pub(crate) along: [f64; 2],
    /// How far it goes that way.
    pub(crate) position: f64,
    /// The σ of that.
    pub(crate) sigma: f64,
}

impl End {
    /// `along · vertex − position`, and its derivative added to `by_theta`.
    pub(super) fn violation(&self, kind: &ContourKind, theta: &[f64], by_theta: &mut [f64]) -> f64 {
        let vertex = kind.vertex(theta, self.vertex);
        kind.add_vertex_derivative(theta, self.vertex, self.along, by_theta);
        self.along[0] * vertex[0] + self.along[1] * vertex[1] - self.position
    }
}

/// Both ends of an open chain near `theta`, from points with their covariances `[xx, xy, yy]`; none of any
/// other kind.
///
/// With `n` places spread evenly over a last piece of length `e`, each with an error `σ_i` along it, the most
/// likely `e` of `−n ln e + Σ ln Φ((e − x_i)/σ_i)` is taken, and its σ from the second derivative; at least
/// `e/n`, the usual distance of the last reading from the end. Cost: 60 passes over the readings of the last
/// pieces.
pub(crate) fn ends(kind: &ContourKind, theta: &[f64], points: &[([f64; 2], [f64; 3])]) -> Vec<End> {
    let ContourKind::Chain { closed: false, .. } = kind else {
        return Vec::new();
    };
    let last = kind.pieces();
    [(0, 1, 0), (last - 1, last - 1, last)]
        .into_iter()
        .map(|(piece, inner, vertex)| {
            let bulge = kind.bulge(theta, piece).0 * if vertex == 0 { -1.0 } else { 1.0 };
            let stroke = Stroke::between(kind.vertex(theta, inner), kind.vertex(theta, vertex), bulge);
            let mut by_theta = vec![0.0; kind.parameters()];
            let reach: Vec<(f64, f64)> = points
                .iter()
                .filter_map(|&(p, covariance)| {
                    if nearest_piece(kind, theta, p, covariance)? != piece {
                        return None;
                    }
                    let at = distance(kind, theta, piece, p, &mut by_theta);
                    let ([xx, xy, yy], n) = (covariance, at.by_point);
                    let across = n[0] * n[0] * xx + 2.0 * n[0] * n[1] * xy + n[1] * n[1] * yy;
                    let sigma = ((xx * yy - xy * xy).max(0.0) / across).sqrt();
                    let foot = [p[0] - at.value * n[0], p[1] - at.value * n[1]];
                    (at.value * at.value <= GATE * GATE * across).then(|| (along(&stroke, foot), sigma))
                })
                .collect();
            let (length, sigma) = longest(&reach, stroke.speed());
            let share = length / stroke.speed();
            let (end, before) = (stroke.at(share), stroke.at(share * (1.0 - 1e-6)));
            let step = [end[0] - before[0], end[1] - before[1]];
            let size = step[0].hypot(step[1]).max(f64::MIN_POSITIVE);
            let direction = step.map(|s| s / size);
            End { vertex, along: direction, position: direction[0] * end[0] + direction[1] * end[1], sigma }
        })
        .collect()
}

/// The length along a piece at which a point of it lies.
fn along(stroke: &Stroke, p: [f64; 2]) -> f64 {
    match stroke {
        Stroke::Straight([a, b]) => {
            let e = [b[0] - a[0], b[1] - a[1]];
            ((p[0] - a[0]) * e[0] + (p[1] - a[1]) * e[1]) / e[0].hypot(e[1]).max(f64::MIN_POSITIVE)
        }
        Stroke::Round { center, semi, from, sweep, .. } => {
            let turn = (p[1] - center[1]).atan2(p[0] - center[0]) - from;
            // The turn nearest to the middle of the piece.
            let turn = turn - TAU * ((turn - 0.5 * sweep) / TAU).round();
            semi[0] * turn * sweep.signum()
        }
    }
}

/// The most likely length of a piece of which places `x` were seen with errors of σ, and its σ; where none
/// were seen the length that was thought, and as much for its σ.
fn longest(reach: &[(f64, f64)], thought: f64) -> (f64, f64) {
    let farthest = reach.iter().map(|(x, _)| *x).fold(0.0, f64::max);
    if reach.len() < 2 || farthest <= 0.0 {
        return (thought, thought);
    }
    let count = reach.len() as f64;
    // The first two derivatives, and the second one's opposite.
    let slopes = |e: f64| {
        let (mut first, mut information) = (-count / e, -count / (e * e));
        for &(x, sigma) in reach {
            let z = (e - x) / sigma.max(1e-9 * farthest);
            let hazard = hazard(z);
            first += hazard / sigma.max(1e-9 * farthest);
            information += hazard * (hazard + z) / sigma.max(1e-9 * farthest).powi(2);
        }
        (first, information)
    };
    let widest = reach.iter().map(|(_, s)| *s).fold(0.0, f64::max);
    let (mut low, mut high) = (0.5 * farthest, farthest + 4.0 * widest);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if slopes(middle).0 > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    let length = 0.5 * (low + high);
    let information = slopes(length).1;
    let spacing = length / count;
    let sigma = if information > 0.0 { information.sqrt().recip() } else { spacing };
    (length, sigma.max(spacing))
}

/// `φ(z)/Φ(z)` of the normal distribution.
fn hazard(z: f64) -> f64 {
    if z < -30.0 {
        return -z;
    }
    let below = 0.5 * erfc(-z * FRAC_1_SQRT_2);
    (-0.5 * z * z).exp() / (TAU.sqrt() * below)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_length_of_a_piece_is_within_its_sigma() {
        // A low-discrepancy sequence for places and, by the sum of twelve, errors.
        let mut state = 0.0_f64;
        let mut uniform = || {
            state = (state + 0.618_033_988_749_895).fract();
            (state * 7919.0).fract()
        };
        for error in [1e-6, 0.02, 0.3] {
            let runs = 60;
            let mut squares = 0.0;
            for _ in 0..runs {
                let reach: Vec<(f64, f64)> = (0..80)
                    .map(|_| {
                        let normal: f64 = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
                        (2.0 * uniform() + error * normal, error)
                    })
                    .collect();
                let (length, sigma) = longest(&reach, 1.0);
                squares += ((length - 2.0) / sigma).powi(2);
            }
            let rms = (squares / f64::from(runs)).sqrt();
            assert!((0.5..1.6).contains(&rms), "errors of {error}: {rms} σ");
        }
    }

    #[test]
    fn ends_of_lines_and_arcs_are_where_readings_end() {
        let kind = ContourKind::Chain { arcs: vec![true, false], closed: false };
        // A quarter circle about the origin from (0, −1) to (1, 0), then up.
        let bulge = (std::f64::consts::PI / 8.0).tan();
        let theta = [0.0, -1.0, 1.0, 0.0, 1.0, 2.0, bulge];
        let covariance = [1e-6, 0.0, 1e-6];
        let mut points: Vec<([f64; 2], [f64; 3])> = (0..=100)
            .map(|k| {
                let t = -0.5 * std::f64::consts::PI * (0.8 - 0.008 * f64::from(k));
                ([t.cos(), t.sin()], covariance)
            })
            .collect();
        points.extend((0..=100).map(|k| ([1.0, 0.015 * f64::from(k)], covariance)));
        let found = ends(&kind, &theta, &points);
        // What was seen of the arc begins at −72°, and the line ends at 1.5.
        let (sin, cos) = (-0.4 * std::f64::consts::PI).sin_cos();
        let first = found[0].along;
        assert!((first[0] - sin).abs() < 0.05 && (first[1] + cos).abs() < 0.05, "{found:?}");
        assert!((found[0].position - (first[0] * cos + first[1] * sin)).abs() < 0.03, "{found:?}");
        assert!((found[1].position - 1.5).abs() < 0.03 && found[1].along[1] > 0.999, "{found:?}");
        assert!(ends(&ContourKind::Circle, &[0.0, 0.0, 1.0], &points).is_empty());
    }
}
