//! Likelihood of readings whose places on the outline are unknown.
//!
//! In: an outline, and readings as points with a covariance. Out: their log-likelihood, with the place of
//! each integrated over the outline. Distances alone cannot compare kinds: each reading is assigned to the
//! place that suits it best, so that outlines with many corners or strong bends explain noise. Not
//! guaranteed: anything for readings that are spread very unevenly over the observed part of the outline.

use super::curve::arc_circle;
use super::kind::ContourKind;
use super::parts::typical_gap;
use super::reading::{ContourEquation, ContourModel, ContourReading};
use planish_core::BoundingBox;
use statrs::function::erf::erf;
use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

/// Maximum distance of a chord from its arc, as a fraction of the σ of a reading.
///
/// At one σ from the arc it changes the density by 2 %. The number of chords grows with the square root of
/// its inverse.
const SAGITTA: f64 = 0.02;
/// Parts of an arc more than this many σ from a reading are not integrated.
const WINDOW: f64 = 7.0;
/// Maximum number of chords per reading and arc; bounds the cost of arcs that are huge compared with σ.
const MAX_CHORDS: f64 = 200.0;
/// Smallest step along a piece as a fraction of it: outlines may be far larger than their observed part.
const MIN_STEP: f64 = 1e-4;
/// Maximum number of readings that are compared with the outline to find its observed part; the cost is
/// readings times steps.
const MAX_COMPARED: usize = 1000;

/// A measured point in the frame of the object.
pub(super) struct MeasuredPoint {
    pub(super) point: [f64; 2],
    /// Its covariance `[xx, xy, yy]`.
    pub(super) covariance: [f64; 3],
}

impl MeasuredPoint {
    /// Trace of the covariance.
    pub(super) fn variance(&self) -> f64 {
        self.covariance[0] + self.covariance[2]
    }
}

/// A piece of an outline: a segment, or an arc of a circle or an ellipse.
pub(super) enum Stroke {
    Straight([[f64; 2]; 2]),
    /// `center + semi[0] cos t · turn + semi[1] sin t · turn⊥` for `t` in `[from, from + sweep]`.
    Round {
        center: [f64; 2],
        semi: [f64; 2],
        turn: [f64; 2],
        from: f64,
        sweep: f64,
    },
}

/// Likelihood of the readings and observed fraction of the sides.
pub(super) struct LikelihoodAndCoverage {
    /// Log-likelihood; `None` if readings share poses. Their places then follow from the pose, and the
    /// integral over independent places would be wrong.
    pub(super) log_likelihood: Option<f64>,
    /// Smallest observed fraction of a straight side; 1 for regular polygons, whose sides are not
    /// independent.
    pub(super) min_side_coverage: f64,
}

/// Log-likelihood of all readings, `Σ log(√2π σ ∫ N(z; p(s), C) ds · E/L + exp(−g²/2))`.
///
/// Each reading may come from anywhere on the observed part of the outline, whose length is `L`. Outliers are
/// as unlikely as a reading at the gate `g`. `σ² = tr C` and the perimeter `E` of the bounding box of the
/// readings are common to all kinds; they make the value dimensionless and about `−½ Σ s²`.
///
/// On a straight side that is long compared with σ, the integral is the normal density of the distance. Near
/// corners and strong bends it differs, and there the distance is no likelihood. A line extends from the
/// first to the last reading, and so does a partially observed circle or ellipse. Cost: a few exponentials
/// per reading and piece, about thirty for an arc.
///
/// # References
/// Kendall and Stuart 1979, *The advanced theory of statistics*, chapter 29 (structural and functional
/// relations, and the incidental parameters of the latter); Neyman and Scott 1948, *Consistent estimates
/// based on partially consistent observations*.
pub(super) fn marginal_likelihood(
    model: &ContourModel,
    state: &[f64],
    readings: &[ContourReading],
    gate: f64,
) -> LikelihoodAndCoverage {
    let measured_points: Vec<MeasuredPoint> = readings
        .iter()
        .map(|reading| {
            let (point, covariance) = ContourEquation::new(model, reading).point_at_reference_time(state);
            MeasuredPoint { point, covariance }
        })
        .collect();
    let gap = typical_gap(readings);
    let strokes = strokes(&model.kind, &state[..model.kind.parameters()], &measured_points, gap);
    let observed = observed_lengths(&strokes, &measured_points, 0.5 * gap);
    let bounds: BoundingBox<[f64; 2]> = measured_points.iter().map(|measured| measured.point).collect();
    let size = bounds.extent();
    // The steps along an outline far larger than the readings can miss the observed part. Its length is at
    // least the extent of the readings.
    let length = (observed.iter().sum::<f64>()).max(size[0]).max(size[1]).max(f64::MIN_POSITIVE);
    let straight = strokes.iter().zip(&observed).filter_map(|(stroke, observed)| match stroke {
        Stroke::Straight(_) => Some(observed / stroke.speed()),
        Stroke::Round { .. } => None,
    });
    let min_side_coverage = match model.kind {
        ContourKind::RegularPolygon(_) => 1.0,
        _ => straight.fold(1.0, f64::min),
    };
    if model.shared_poses {
        return LikelihoodAndCoverage { log_likelihood: None, min_side_coverage };
    }
    // A common factor of all kinds, so that the value has no unit and kinds remain comparable.
    let around = 2.0 * (size[0] + size[1]);
    let outlier_density = (-0.5 * gate * gate).exp();
    let share = TAU.sqrt() * around / length;
    let each = measured_points.iter().map(|measured| {
        let density: f64 = strokes.iter().map(|stroke| stroke.density(measured)).sum();
        let sigma = measured.variance().sqrt();
        (share * sigma * density + outlier_density).ln()
    });
    LikelihoodAndCoverage { log_likelihood: Some(each.sum()), min_side_coverage }
}

/// The pieces of an outline.
///
/// A line, and a circle or ellipse with a part wider than `gap` without readings, extend from the first
/// reading to the last.
pub(super) fn strokes(
    kind: &ContourKind,
    theta: &[f64],
    measured_points: &[MeasuredPoint],
    gap: f64,
) -> Vec<Stroke> {
    let round = |semi: [f64; 2], turn: [f64; 2]| {
        let center = [theta[0], theta[1]];
        let mut angles: Vec<f64> =
            measured_points.iter().map(|measured| foot(measured.point, center, semi, turn)).collect();
        angles.sort_by(f64::total_cmp);
        // The largest gap between the directions of successive readings, across ±π included.
        let (mut from, mut free) = (0.0, 0.0);
        for (k, &after) in angles.iter().enumerate() {
            let before = if k > 0 { angles[k - 1] } else { angles[angles.len() - 1] - TAU };
            if after - before > free {
                (from, free) = (after, after - before);
            }
        }
        let is_closed = free * semi[0].max(semi[1]) <= gap;
        Stroke::Round { center, semi, turn, from, sweep: if is_closed { TAU } else { TAU - free } }
    };
    match kind {
        ContourKind::Line => {
            let (sin, cos) = theta[0].sin_cos();
            let along = measured_points.iter().map(|s| cos * s.point[0] + sin * s.point[1]);
            let (low, high) =
                along.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(t), b.max(t)));
            let at = |t: f64| [t * cos - theta[1] * sin, t * sin + theta[1] * cos];
            vec![Stroke::Straight([at(low), at(high)])]
        }
        ContourKind::Circle => vec![round([theta[2], theta[2]], [1.0, 0.0])],
        ContourKind::Ellipse => vec![round([theta[2], theta[3]], [theta[4].cos(), theta[4].sin()])],
        _ => {
            let count = kind.pieces() + usize::from(!kind.is_closed());
            let mut vertices = vec![[0.0; 2]; count];
            kind.vertices(theta, &mut vertices);
            (0..kind.pieces())
                .map(|i| Stroke::between(vertices[i], vertices[(i + 1) % count], kind.bulge(theta, i).0))
                .collect()
        }
    }
}

/// Parameter of an ellipse at the radial projection of a point, in (−π, π].
fn foot(p: [f64; 2], center: [f64; 2], semi: [f64; 2], turn: [f64; 2]) -> f64 {
    let d = [p[0] - center[0], p[1] - center[1]];
    let along = (turn[0] * d[0] + turn[1] * d[1]) / semi[0];
    let across = (turn[0] * d[1] - turn[1] * d[0]) / semi[1];
    across.atan2(along)
}

/// Length of the part of each piece that lies within `reach` of a reading.
fn observed_lengths(strokes: &[Stroke], measured_points: &[MeasuredPoint], reach: f64) -> Vec<f64> {
    let stride = measured_points.len().div_ceil(MAX_COMPARED);
    // A subset of the readings has larger gaps.
    let reach = reach * stride as f64;
    let step = 0.25 * reach;
    let nearest = |p: [f64; 2]| {
        let squared = |measured: &MeasuredPoint| {
            (measured.point[0] - p[0]).powi(2) + (measured.point[1] - p[1]).powi(2)
        };
        let min_squared = measured_points.iter().step_by(stride).map(squared).fold(f64::INFINITY, f64::min);
        min_squared.sqrt()
    };
    let seen_length = |stroke: &Stroke| {
        let mut observed = 0.0;
        let speed = stroke.speed();
        let step = (step / speed).max(MIN_STEP);
        let (mut share, mut from) = (0.0, stroke.at(0.0));
        while share < 1.0 {
            let next = (share + step).min(1.0);
            let to = stroke.at(next);
            let away = nearest([0.5 * (from[0] + to[0]), 0.5 * (from[1] + to[1])]);
            if away <= reach {
                observed += (to[0] - from[0]).hypot(to[1] - from[1]);
                (share, from) = (next, to);
            } else {
                // The distance to the nearest reading changes at most as fast as the arc length (sphere
                // tracing), so this step cannot skip an observed part.
                share = next.max(share + (away - reach) / speed);
                from = stroke.at(share);
            }
        }
        observed
    };
    strokes.iter().map(seen_length).collect()
}

impl Stroke {
    /// The piece between two vertices with this bulge.
    pub(super) fn between(a: [f64; 2], b: [f64; 2], bulge: f64) -> Self {
        if bulge == 0.0 {
            return Self::Straight([a, b]);
        }
        let (center, radius) = arc_circle(a, b, bulge);
        Self::Round {
            center,
            semi: [radius; 2],
            turn: [1.0, 0.0],
            from: (a[1] - center[1]).atan2(a[0] - center[0]),
            sweep: 4.0 * bulge.atan(),
        }
    }

    /// Maximum speed of [`Stroke::at`]; the length of segments and circular arcs.
    pub(super) fn speed(&self) -> f64 {
        match self {
            Self::Straight([a, b]) => (b[0] - a[0]).hypot(b[1] - a[1]),
            Self::Round { semi: [a, b], sweep, .. } => sweep.abs() * a.max(*b),
        }
        .max(f64::MIN_POSITIVE)
    }

    /// The point at a fraction (0 to 1) of the piece, in the parameter and not in arc length.
    pub(super) fn at(&self, share: f64) -> [f64; 2] {
        match self {
            Self::Straight([a, b]) => [0, 1].map(|k| a[k] + share * (b[k] - a[k])),
            Self::Round { from, sweep, .. } => self.on_round(from + share * sweep),
        }
    }

    /// The point of a round piece with parameter `t`.
    fn on_round(&self, t: f64) -> [f64; 2] {
        match self {
            Self::Straight([a, _]) => *a,
            Self::Round { center, semi, turn, .. } => {
                let (sin, cos) = t.sin_cos();
                let (x, y) = (semi[0] * cos, semi[1] * sin);
                [center[0] + turn[0] * x - turn[1] * y, center[1] + turn[1] * x + turn[0] * y]
            }
        }
    }

    /// The part between two fractions of the piece.
    pub(super) fn part(&self, low: f64, high: f64) -> Self {
        match *self {
            Self::Straight(_) => Self::Straight([self.at(low), self.at(high)]),
            Self::Round { center, semi, turn, from, sweep } => {
                Self::Round { center, semi, turn, from: from + low * sweep, sweep: (high - low) * sweep }
            }
        }
    }

    /// The point nearest to `p`. For ellipses it is only certain if `p` lies outside the evolute, where the
    /// nearest point is unique.
    pub(super) fn nearest(&self, p: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Straight([a, b]) => {
                let e = [b[0] - a[0], b[1] - a[1]];
                let squared = (e[0] * e[0] + e[1] * e[1]).max(f64::MIN_POSITIVE);
                self.at((((p[0] - a[0]) * e[0] + (p[1] - a[1]) * e[1]) / squared).clamp(0.0, 1.0))
            }
            Self::Round { center, semi, turn, from, sweep } => {
                let d = [p[0] - center[0], p[1] - center[1]];
                let q = [turn[0] * d[0] + turn[1] * d[1], turn[0] * d[1] - turn[1] * d[0]];
                // Newton steps on the angle. The absolute value of the second derivative turns steps towards
                // a maximum around, and the limit of an eighth of a turn keeps them on the same side.
                let mut t = foot(p, *center, *semi, *turn);
                for _ in 0..20 {
                    let (sin, cos) = t.sin_cos();
                    let e = [semi[0] * cos - q[0], semi[1] * sin - q[1]];
                    let by = [-semi[0] * sin, semi[1] * cos];
                    let slope = e[0] * by[0] + e[1] * by[1];
                    let bend = by[0] * by[0] + by[1] * by[1] - e[0] * semi[0] * cos - e[1] * semi[1] * sin;
                    let step = (slope / bend.abs().max(1e-300)).clamp(-PI / 4.0, PI / 4.0);
                    t -= step;
                    if step.abs() < 1e-12 {
                        break;
                    }
                }
                // The fraction of the sweep, measured from its middle to choose the right period.
                let middle = from + 0.5 * sweep;
                let off = t - middle - TAU * ((t - middle) / TAU).round();
                self.at((0.5 + off / sweep).clamp(0.0, 1.0))
            }
        }
    }

    /// Arc length between two fractions of the piece.
    pub(super) fn length(&self, low: f64, high: f64) -> f64 {
        match self {
            Self::Straight([a, b]) => (high - low) * (b[0] - a[0]).hypot(b[1] - a[1]),
            Self::Round { semi: [a, b], from, sweep, .. } => {
                // Gauss–Legendre quadrature with three points on parts of at most 0.4 rad; an ellipse has no
                // closed form.
                let count = ((high - low) * sweep.abs() / 0.4).ceil().max(1.0);
                let width = (high - low) / count;
                let speed = |share: f64| {
                    let (sin, cos) = (from + share * sweep).sin_cos();
                    (a * sin).hypot(b * cos)
                };
                let mean_speed = |k: usize| {
                    let middle = low + (k as f64 + 0.5) * width;
                    let off = 0.5 * width * 0.6f64.sqrt();
                    (5.0 * speed(middle - off) + 8.0 * speed(middle) + 5.0 * speed(middle + off)) / 18.0
                };
                (0..count as usize).map(mean_speed).sum::<f64>() * width * sweep.abs()
            }
        }
    }

    /// `∫ N(z; p(s), C) ds` along the piece.
    pub(super) fn density(&self, measured: &MeasuredPoint) -> f64 {
        match self {
            Self::Straight(ends) => chord(ends, measured),
            Self::Round { center, semi, turn, from, sweep } => {
                let [xx, xy, yy] = measured.covariance;
                let foot = foot(measured.point, *center, *semi, *turn);
                let spread = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
                let max_sigma = (0.5 * (xx + yy) + spread).sqrt();
                // Very elongated covariances would ask for far too many chords; the floor bounds them.
                let min_sigma = (0.5 * (xx + yy) - spread).max(0.0).sqrt().max(0.05 * max_sigma);
                let (long, short) = (semi[0].max(semi[1]), semi[0].min(semi[1]));
                let near = (WINDOW * max_sigma / short).min(PI);
                // The part of the piece within the window. The sweep may cross ±π, so windows one turn apart
                // are tried as well.
                let (start, end) = if *sweep >= 0.0 { (*from, from + sweep) } else { (from + sweep, *from) };
                // A chord of the angle t has the sagitta r t²/8.
                let step = (8.0 * SAGITTA * min_sigma / long).sqrt();
                let mut total = 0.0;
                let mut middle = foot + TAU * ((start - near - foot) / TAU).ceil();
                while middle - near < end {
                    let (a, b) = ((middle - near).max(start), (middle + near).min(end));
                    let count = ((b - a) / step).ceil().clamp(1.0, MAX_CHORDS);
                    // The mean sagitta is two thirds of the largest: move the chords outwards by it, so that
                    // they lie on the arc on average and the density has no bias of first order.
                    let grow = ((b - a) / count).powi(2) / 12.0;
                    let at = |k: f64| {
                        let p = self.on_round(a + (b - a) * k / count);
                        [0, 1].map(|i| p[i] + grow * (p[i] - center[i]))
                    };
                    let mut last = at(0.0);
                    for k in 1..=count as usize {
                        let next = at(k as f64);
                        total += chord(&[last, next], measured);
                        last = next;
                    }
                    middle += TAU;
                }
                total
            }
        }
    }
}

/// `∫ N(z; p(s), C) ds` along a segment.
///
/// The normal density splits into that of the distance across the segment and, given this, that of the place
/// along it; the latter integrates to a difference of error functions.
fn chord([a, b]: &[[f64; 2]; 2], measured: &MeasuredPoint) -> f64 {
    let e = [b[0] - a[0], b[1] - a[1]];
    let length = e[0].hypot(e[1]);
    if length <= 0.0 {
        return 0.0;
    }
    let t = [e[0] / length, e[1] / length];
    let n = [t[1], -t[0]];
    let [xx, xy, yy] = measured.covariance;
    let d = [measured.point[0] - a[0], measured.point[1] - a[1]];
    let off = n[0] * d[0] + n[1] * d[1];
    let pull = [xx * n[0] + xy * n[1], xy * n[0] + yy * n[1]];
    let across = (n[0] * pull[0] + n[1] * pull[1]).max(f64::MIN_POSITIVE);
    let squared = off * off / across;
    // e^(−100) vanishes beside the density of outliers; skip the error functions.
    if squared > 200.0 {
        return 0.0;
    }
    // Mean and variance of the place along the segment, given that it lies on the line. The floor on the
    // variance covers readings without noise along the segment.
    let along = t[0] * d[0] + t[1] * d[1] - (t[0] * pull[0] + t[1] * pull[1]) * off / across;
    let variance = ((xx * yy - xy * xy) / across).max(1e-24 * length * length);
    let scale = FRAC_1_SQRT_2 / variance.sqrt();
    let share = 0.5 * (erf(scale * (length - along)) + erf(scale * along));
    share * (-0.5 * squared).exp() / (TAU * across).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(point: [f64; 2]) -> MeasuredPoint {
        MeasuredPoint { point, covariance: [0.04, 0.01, 0.02] }
    }

    #[test]
    fn lengths_and_nearest_points_match_dense_sampling() {
        let ellipse =
            Stroke::Round { center: [0.3, -0.2], semi: [1.0, 0.4], turn: [0.8, 0.6], from: 0.4, sweep: 4.0 };
        for stroke in [
            ellipse,
            Stroke::Straight([[0.0, 1.0], [2.0, -1.0]]),
            Stroke::between([1.0, 0.0], [0.0, 1.0], -0.7),
        ] {
            let count = 20_000;
            let at = |k: usize| stroke.at(0.25 + 0.5 * k as f64 / count as f64);
            let far = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
            let summed: f64 = (0..count).map(|k| far(at(k), at(k + 1))).sum();
            let (length, part) = (stroke.length(0.25, 0.75), stroke.part(0.25, 0.75).length(0.0, 1.0));
            assert!((length - summed).abs() < 1e-6 * summed, "{length} {summed}");
            assert!((part - summed).abs() < 1e-6 * summed, "{part} {summed}");
            for p in [[0.5, 0.5], [-0.7, 0.1], [1.5, -1.2]] {
                let sampled_min = (0..=count)
                    .map(|k| far(stroke.at(k as f64 / count as f64), p))
                    .fold(f64::INFINITY, f64::min);
                let found = far(stroke.nearest(p), p);
                assert!(found < sampled_min + 1e-4, "{p:?}: {found} {sampled_min}");
            }
        }
    }

    /// Reference: the density summed over the piece in steps much shorter than σ.
    fn summed(stroke: &Stroke, measured: &MeasuredPoint) -> f64 {
        let [xx, xy, yy] = measured.covariance;
        let determinant = xx * yy - xy * xy;
        let count = 200_000;
        // For lines and circles the speed equals the length.
        let ds = stroke.speed() / f64::from(count);
        let each = (0..count).map(|k| {
            let p = stroke.at((f64::from(k) + 0.5) / f64::from(count));
            let d = [measured.point[0] - p[0], measured.point[1] - p[1]];
            let square = (yy * d[0] * d[0] - 2.0 * xy * d[0] * d[1] + xx * d[1] * d[1]) / determinant;
            (-0.5 * square).exp() / (TAU * determinant.sqrt())
        });
        each.sum::<f64>() * ds
    }

    #[test]
    fn density_is_the_integral_over_the_piece() {
        let strokes = [
            Stroke::Straight([[0.0, 0.0], [1.0, 0.5]]),
            Stroke::between([1.0, 0.0], [0.0, 1.0], 0.414),
            Stroke::between([1.0, 0.0], [0.0, 1.0], -0.3),
            Stroke::between([1.0, 0.0], [0.0, 0.1], 2.5),
        ];
        for (i, stroke) in strokes.iter().enumerate() {
            for point in [[0.9, 0.4], [0.0, 0.0], [1.2, -0.2], [0.5, 0.9], [0.1, 1.1]] {
                let (found, wanted) = (stroke.density(&measured(point)), summed(stroke, &measured(point)));
                assert!((found - wanted).abs() < 0.01 * wanted + 1e-6, "{i} {point:?}: {found} for {wanted}");
            }
        }
    }

    #[test]
    fn density_integrates_to_the_length_of_the_outline() {
        // Otherwise the likelihoods of different outlines could not be compared.
        let circle =
            [Stroke::Round { center: [0.2, 0.1], semi: [1.0, 1.0], turn: [1.0, 0.0], from: 0.0, sweep: TAU }];
        let corner =
            [Stroke::Straight([[-1.0, 1.0], [0.0, 0.0]]), Stroke::Straight([[0.0, 0.0], [1.0, 1.0]])];
        for outline in [&circle[..], &corner[..]] {
            let step = 0.05;
            let mut total = 0.0;
            for i in -60..60 {
                for j in -60..60 {
                    let at = measured([f64::from(i) * step, f64::from(j) * step]);
                    total += outline.iter().map(|s| s.density(&at)).sum::<f64>() * step * step;
                }
            }
            let length: f64 = outline.iter().map(Stroke::speed).sum();
            assert!((total / length - 1.0).abs() < 2e-3, "{total} for {length}");
        }
    }

    #[test]
    fn parts_without_nearby_readings_are_unobserved() {
        let square = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
        let strokes: Vec<Stroke> =
            (0..4).map(|i| Stroke::Straight([square[i], square[(i + 1) % 4]])).collect();
        let measured_points: Vec<MeasuredPoint> =
            (0..41).map(|k| measured([0.1 * f64::from(k), 0.0])).collect();
        let observed = observed_lengths(&strokes, &measured_points, 0.2);
        assert!((observed[0] - 4.0).abs() < 0.1 && observed[1] < 0.3 && observed[2] == 0.0, "{observed:?}");
    }
}
