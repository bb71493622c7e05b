//! Positions of the two ends of an open outline.
//!
//! In: an open chain near its optimum, and readings. Out: its two ends as soft constraints. The distance of a
//! reading to a line or circle carries no information about where the outline ends on it; the extent of the
//! readings along it does. Not guaranteed: that the object ends there. It may continue where nothing was
//! observed.

use super::curve::{distance, nearest_piece};
use super::kind::ContourKind;
use super::likelihood::Stroke;
use statrs::function::erf::erfc;
use std::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Readings more than this many σ from the last piece are ignored: a single outlier would move the end.
const GATE: f64 = 4.0;

/// Soft constraint on an end: `along · vertex = position` with σ = `sigma`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct End {
    /// Index of the vertex.
    pub(crate) vertex: usize,
    /// Unit tangent of the outline at the end, pointing outwards.
    pub(crate) along: [f64; 2],
    /// Coordinate of the end along that direction.
    pub(crate) position: f64,
    /// σ of the position.
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

/// Both ends of an open chain near `theta`, from points with covariances `[xx, xy, yy]`; empty for other
/// kinds.
///
/// Assumes `n` places spread evenly over a last piece of length `e`, each observed with an error of `σ_i`
/// along it. The length maximises `−n ln e + Σ ln Φ((e − x_i)/σ_i)`; its σ follows from the second derivative
/// and is at least `e/n`, the expected distance of the last reading from the end. Cost: 60 passes over the
/// readings of the last pieces.
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
            // The tangent by a backward difference: the same code serves lines and arcs.
            let share = length / stroke.speed();
            let (end, before) = (stroke.at(share), stroke.at(share * (1.0 - 1e-6)));
            let step = [end[0] - before[0], end[1] - before[1]];
            let size = step[0].hypot(step[1]).max(f64::MIN_POSITIVE);
            let direction = step.map(|s| s / size);
            End { vertex, along: direction, position: direction[0] * end[0] + direction[1] * end[1], sigma }
        })
        .collect()
}

/// Arc length from the start of a piece to a point on it; negative before the start.
fn along(stroke: &Stroke, p: [f64; 2]) -> f64 {
    match stroke {
        Stroke::Straight([a, b]) => {
            let e = [b[0] - a[0], b[1] - a[1]];
            ((p[0] - a[0]) * e[0] + (p[1] - a[1]) * e[1]) / e[0].hypot(e[1]).max(f64::MIN_POSITIVE)
        }
        Stroke::Round { center, semi, from, sweep, .. } => {
            let turn = (p[1] - center[1]).atan2(p[0] - center[0]) - from;
            // Choose the period nearest to the middle of the piece, so that the cut of atan2 is far from both
            // ends.
            let turn = turn - TAU * ((turn - 0.5 * sweep) / TAU).round();
            semi[0] * turn * sweep.signum()
        }
    }
}

/// Most likely length of a piece with readings at `(x, σ)` along it, and its σ.
///
/// With fewer than two readings, it is the assumed length, with the same value as its σ.
fn longest(reach: &[(f64, f64)], assumed: f64) -> (f64, f64) {
    let farthest = reach.iter().map(|(x, _)| *x).fold(0.0, f64::max);
    if reach.len() < 2 || farthest <= 0.0 {
        return (assumed, assumed);
    }
    let count = reach.len() as f64;
    // First derivative of the log-likelihood and the negative second one. The floor on σ keeps exact readings
    // from dividing by zero.
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
    // Bisection: the likelihood is steep on one side only, where Newton steps overshoot. 60 halvings exhaust
    // the precision of f64.
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

/// `φ(z)/Φ(z)` of the standard normal distribution (inverse Mills ratio).
fn hazard(z: f64) -> f64 {
    // Φ(z) underflows far below zero; its asymptote replaces the ratio there.
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
    fn length_errors_of_an_end_piece_match_its_sigma() {
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
    fn lines_and_arcs_end_at_the_last_reading() {
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
        // The observed part of the arc begins at −72°, and the line ends at 1.5.
        let (sin, cos) = (-0.4 * std::f64::consts::PI).sin_cos();
        let first = found[0].along;
        assert!((first[0] - sin).abs() < 0.05 && (first[1] + cos).abs() < 0.05, "{found:?}");
        assert!((found[0].position - (first[0] * cos + first[1] * sin)).abs() < 0.03, "{found:?}");
        assert!((found[1].position - 1.5).abs() < 0.03 && found[1].along[1] > 0.999, "{found:?}");
        assert!(ends(&ContourKind::Circle, &[0.0, 0.0, 1.0], &points).is_empty());
    }
}
