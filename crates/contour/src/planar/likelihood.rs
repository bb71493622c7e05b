//! How likely readings are whose places on the outline are not known.
//!
//! Comes in: an outline and readings as points with a covariance. Goes out: the logarithm of their
//! likelihood, the place of each integrated over the outline. Distances alone do not compare kinds: each
//! reading lies at the place that suits it best, so that outlines with many corners or strong bends explain
//! noise. Not guaranteed: anything where readings are far from evenly spread over what was seen of the
//! outline.

use super::curve::arc_circle;
use super::kind::ContourKind;
use super::parts::usual_gap;
use super::reading::{ContourEquation, ContourModel, ContourReading};
use planish_core::BoundingBox;
use statrs::function::erf::erf;
use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

/// A chord may be this share of a reading's σ from its arc.
const SAGITTA: f64 = 0.02;
/// Of an arc, what is farther from the reading than so many of its σ does not count.
const WINDOW: f64 = 7.0;
/// Most chords of an arc that one reading looks at.
const MAX_CHORDS: f64 = 200.0;
/// The least share of a piece that is looked at as one: outlines may be far larger than what was seen of
/// them.
const MIN_STEP: f64 = 1e-4;
/// Readings that are compared with the outline to tell what was seen of it, at most.
const MAX_COMPARED: usize = 1000;

/// A point that was seen, in the frame of the thing.
pub(super) struct Spot {
    pub(super) point: [f64; 2],
    /// `[xx, xy, yy]`.
    pub(super) covariance: [f64; 3],
}

impl Spot {
    /// Of both coordinates together.
    pub(super) fn variance(&self) -> f64 {
        self.covariance[0] + self.covariance[2]
    }
}

/// A piece of an outline.
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

/// What readings say of an outline whose places are not known.
pub(super) struct LikelihoodAndCoverage {
    /// The logarithm of their likelihood; `None` where readings share poses: their place then follows from
    /// the pose, and needs no integral.
    pub(super) log_likelihood: Option<f64>,
    /// The least share of a straight side that a reading came near; 1 where sides follow from one another.
    pub(super) min_side_coverage: f64,
}

/// `Σ log(√2π σ ∫ N(z; p(s), C) ds · E/L + exp(−g²/2))` over all readings: their likelihood when each one's
/// place is anywhere on what was seen of the outline, of the length `L`, and wild readings are as unlikely as
/// those at the gate `g`.
///
/// `σ² = tr C` and the perimeter `E` of the readings' box make it a number without unit that is about
/// `−½ Σ s²`; all kinds share them. On a straight side that is long beside σ the integral is the normal
/// density of the distance; at corners, and where the outline bends within a few σ, it is what the distance
/// to the nearest side is not: the likelihood. An endless line counts from the first to the last reading, and
/// so does a circle or ellipse of which a part was not seen. Cost: a few exponentials a reading and piece,
/// thirty for an arc.
///
/// # References
/// Kendall and Stuart 1979, *The advanced theory of statistics*, chapter 29 (structural and functional
/// relations, and the incidental parameters of the latter); Neyman and Scott 1948, *Consistent estimates
/// based on partially consistent observations*.
pub(super) fn placed(
    model: &ContourModel,
    state: &[f64],
    sightings: &[ContourReading],
    gate: f64,
) -> LikelihoodAndCoverage {
    let spots: Vec<Spot> = sightings
        .iter()
        .map(|sighting| {
            let (point, covariance) = ContourEquation::new(model, sighting).seen_at_rest(state);
            Spot { point, covariance }
        })
        .collect();
    let gap = usual_gap(sightings);
    let strokes = strokes(&model.kind, &state[..model.kind.parameters()], &spots, gap);
    let seen = seen_lengths(&strokes, &spots, 0.5 * gap);
    let bounds: BoundingBox<2> = spots.iter().map(|spot| spot.point).collect();
    let size = bounds.extent();
    // Of an outline that is far larger than the readings the part they see is hard to hit upon; it is no
    // shorter than they reach.
    let length = (seen.iter().sum::<f64>()).max(size[0]).max(size[1]).max(f64::MIN_POSITIVE);
    let straight = strokes.iter().zip(&seen).filter_map(|(stroke, seen)| match stroke {
        Stroke::Straight(_) => Some(seen / stroke.speed()),
        Stroke::Round { .. } => None,
    });
    let min_side_coverage = match model.kind {
        ContourKind::RegularPolygon(_) => 1.0,
        _ => straight.fold(1.0, f64::min),
    };
    if model.shared_poses {
        return LikelihoodAndCoverage { log_likelihood: None, min_side_coverage };
    }
    let around = 2.0 * (size[0] + size[1]);
    let wild = (-0.5 * gate * gate).exp();
    let share = TAU.sqrt() * around / length;
    let each = spots.iter().map(|spot| {
        let density: f64 = strokes.iter().map(|stroke| stroke.density(spot)).sum();
        let sigma = spot.variance().sqrt();
        (share * sigma * density + wild).ln()
    });
    LikelihoodAndCoverage { log_likelihood: Some(each.sum()), min_side_coverage }
}

/// The pieces of an outline; a whole circle or ellipse from its first to its last reading where none lies in
/// a part that is wider than `gap`.
pub(super) fn strokes(kind: &ContourKind, theta: &[f64], spots: &[Spot], gap: f64) -> Vec<Stroke> {
    let round = |semi: [f64; 2], turn: [f64; 2]| {
        let center = [theta[0], theta[1]];
        let mut angles: Vec<f64> = spots.iter().map(|spot| foot(spot.point, center, semi, turn)).collect();
        angles.sort_by(f64::total_cmp);
        let (mut from, mut free) = (0.0, 0.0);
        for (k, &after) in angles.iter().enumerate() {
            let before = if k > 0 { angles[k - 1] } else { angles[angles.len() - 1] - TAU };
            if after - before > free {
                (from, free) = (after, after - before);
            }
        }
        let is_whole = free * semi[0].max(semi[1]) <= gap;
        Stroke::Round { center, semi, turn, from, sweep: if is_whole { TAU } else { TAU - free } }
    };
    match kind {
        ContourKind::Line => {
            let (sin, cos) = theta[0].sin_cos();
            let along = spots.iter().map(|s| cos * s.point[0] + sin * s.point[1]);
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

/// The angle about an ellipse at which a point lies, in (−π, π]; of a point on it, its parameter.
fn foot(p: [f64; 2], center: [f64; 2], semi: [f64; 2], turn: [f64; 2]) -> f64 {
    let d = [p[0] - center[0], p[1] - center[1]];
    let along = (turn[0] * d[0] + turn[1] * d[1]) / semi[0];
    let across = (turn[0] * d[1] - turn[1] * d[0]) / semi[1];
    across.atan2(along)
}

/// The length of each piece that lies within `reach` of a reading.
fn seen_lengths(strokes: &[Stroke], spots: &[Spot], reach: f64) -> Vec<f64> {
    let stride = spots.len().div_ceil(MAX_COMPARED);
    // Fewer readings lie farther apart.
    let reach = reach * stride as f64;
    let step = 0.25 * reach;
    let nearest = |p: [f64; 2]| {
        let squared = |spot: &Spot| (spot.point[0] - p[0]).powi(2) + (spot.point[1] - p[1]).powi(2);
        let least = spots.iter().step_by(stride).map(squared).fold(f64::INFINITY, f64::min);
        least.sqrt()
    };
    let of = |stroke: &Stroke| {
        let mut seen = 0.0;
        let speed = stroke.speed();
        let step = (step / speed).max(MIN_STEP);
        let (mut share, mut from) = (0.0, stroke.at(0.0));
        while share < 1.0 {
            let next = (share + step).min(1.0);
            let to = stroke.at(next);
            let away = nearest([0.5 * (from[0] + to[0]), 0.5 * (from[1] + to[1])]);
            if away <= reach {
                seen += (to[0] - from[0]).hypot(to[1] - from[1]);
                (share, from) = (next, to);
            } else {
                // No reading comes within reach before the outline has gone so far.
                share = next.max(share + (away - reach) / speed);
                from = stroke.at(share);
            }
        }
        seen
    };
    strokes.iter().map(of).collect()
}

impl Stroke {
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

    /// How fast [`Stroke::at`] moves with its share, at most.
    pub(super) fn speed(&self) -> f64 {
        match self {
            Self::Straight([a, b]) => (b[0] - a[0]).hypot(b[1] - a[1]),
            Self::Round { semi: [a, b], sweep, .. } => sweep.abs() * a.max(*b),
        }
        .max(f64::MIN_POSITIVE)
    }

    /// The point at a share of the piece.
    pub(super) fn at(&self, share: f64) -> [f64; 2] {
        match self {
            Self::Straight([a, b]) => [0, 1].map(|k| a[k] + share * (b[k] - a[k])),
            Self::Round { from, sweep, .. } => self.on_round(from + share * sweep),
        }
    }

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

    /// The part of it between two shares.
    pub(super) fn part(&self, low: f64, high: f64) -> Self {
        match *self {
            Self::Straight(_) => Self::Straight([self.at(low), self.at(high)]),
            Self::Round { center, semi, turn, from, sweep } => {
                Self::Round { center, semi, turn, from: from + low * sweep, sweep: (high - low) * sweep }
            }
        }
    }

    /// The point of it that is nearest to `p`, of those from which `p` is not farther than the bend of an
    /// ellipse reaches inwards.
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
                // Newton's steps on the angle, from that of the scaled point; each no longer than an eighth
                // of a turn.
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
                // As a share of the sweep, from its middle.
                let middle = from + 0.5 * sweep;
                let off = t - middle - TAU * ((t - middle) / TAU).round();
                self.at((0.5 + off / sweep).clamp(0.0, 1.0))
            }
        }
    }

    /// The length between two shares.
    pub(super) fn length(&self, low: f64, high: f64) -> f64 {
        match self {
            Self::Straight([a, b]) => (high - low) * (b[0] - a[0]).hypot(b[1] - a[1]),
            Self::Round { semi: [a, b], from, sweep, .. } => {
                // Gauss and Legendre's rule for three places, of as many parts as an eighth of a turn needs.
                let count = ((high - low) * sweep.abs() / 0.4).ceil().max(1.0);
                let width = (high - low) / count;
                let speed = |share: f64| {
                    let (sin, cos) = (from + share * sweep).sin_cos();
                    (a * sin).hypot(b * cos)
                };
                let of = |k: usize| {
                    let middle = low + (k as f64 + 0.5) * width;
                    let off = 0.5 * width * 0.6f64.sqrt();
                    (5.0 * speed(middle - off) + 8.0 * speed(middle) + 5.0 * speed(middle + off)) / 18.0
                };
                (0..count as usize).map(of).sum::<f64>() * width * sweep.abs()
            }
        }
    }

    /// `∫ N(z; p(s), C) ds` along the piece.
    pub(super) fn density(&self, spot: &Spot) -> f64 {
        match self {
            Self::Straight(ends) => chord(ends, spot),
            Self::Round { center, semi, turn, from, sweep } => {
                let [xx, xy, yy] = spot.covariance;
                let foot = foot(spot.point, *center, *semi, *turn);
                let spread = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
                let largest = (0.5 * (xx + yy) + spread).sqrt();
                let least = (0.5 * (xx + yy) - spread).max(0.0).sqrt().max(0.05 * largest);
                let (long, short) = (semi[0].max(semi[1]), semi[0].min(semi[1]));
                let near = (WINDOW * largest / short).min(PI);
                // The part of the piece within the window, which may lie a turn away.
                let (start, end) = if *sweep >= 0.0 { (*from, from + sweep) } else { (from + sweep, *from) };
                let step = (8.0 * SAGITTA * least / long).sqrt();
                let mut total = 0.0;
                let mut middle = foot + TAU * ((start - near - foot) / TAU).ceil();
                while middle - near < end {
                    let (a, b) = ((middle - near).max(start), (middle + near).min(end));
                    let count = ((b - a) / step).ceil().clamp(1.0, MAX_CHORDS);
                    // A little outwards, so that the chords lie on the arc on average.
                    let grow = ((b - a) / count).powi(2) / 12.0;
                    let at = |k: f64| {
                        let p = self.on_round(a + (b - a) * k / count);
                        [0, 1].map(|i| p[i] + grow * (p[i] - center[i]))
                    };
                    let mut last = at(0.0);
                    for k in 1..=count as usize {
                        let next = at(k as f64);
                        total += chord(&[last, next], spot);
                        last = next;
                    }
                    middle += TAU;
                }
                total
            }
        }
    }
}

/// `∫ N(z; p(s), C) ds` along a segment: the density of the distance across, times how much of what is along
/// lies on it.
fn chord([a, b]: &[[f64; 2]; 2], spot: &Spot) -> f64 {
    let e = [b[0] - a[0], b[1] - a[1]];
    let length = e[0].hypot(e[1]);
    if length <= 0.0 {
        return 0.0;
    }
    let t = [e[0] / length, e[1] / length];
    let n = [t[1], -t[0]];
    let [xx, xy, yy] = spot.covariance;
    let d = [spot.point[0] - a[0], spot.point[1] - a[1]];
    let off = n[0] * d[0] + n[1] * d[1];
    let pull = [xx * n[0] + xy * n[1], xy * n[0] + yy * n[1]];
    let across = (n[0] * pull[0] + n[1] * pull[1]).max(f64::MIN_POSITIVE);
    let squared = off * off / across;
    if squared > 200.0 {
        return 0.0;
    }
    // Where the reading is along the segment, given that it is on it.
    let along = t[0] * d[0] + t[1] * d[1] - (t[0] * pull[0] + t[1] * pull[1]) * off / across;
    let variance = ((xx * yy - xy * xy) / across).max(1e-24 * length * length);
    let scale = FRAC_1_SQRT_2 / variance.sqrt();
    let share = 0.5 * (erf(scale * (length - along)) + erf(scale * along));
    share * (-0.5 * squared).exp() / (TAU * across).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(point: [f64; 2]) -> Spot {
        Spot { point, covariance: [0.04, 0.01, 0.02] }
    }

    #[test]
    fn lengths_and_nearest_points_are_those_of_many_small_steps() {
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
                let least = (0..=count)
                    .map(|k| far(stroke.at(k as f64 / count as f64), p))
                    .fold(f64::INFINITY, f64::min);
                let found = far(stroke.nearest(p), p);
                assert!(found < least + 1e-4, "{p:?}: {found} {least}");
            }
        }
    }

    /// By summing the density over the piece in steps that are short beside σ.
    fn summed(stroke: &Stroke, spot: &Spot) -> f64 {
        let [xx, xy, yy] = spot.covariance;
        let determinant = xx * yy - xy * xy;
        let count = 200_000;
        // Of lines and circles the speed is the length.
        let ds = stroke.speed() / f64::from(count);
        let each = (0..count).map(|k| {
            let p = stroke.at((f64::from(k) + 0.5) / f64::from(count));
            let d = [spot.point[0] - p[0], spot.point[1] - p[1]];
            let square = (yy * d[0] * d[0] - 2.0 * xy * d[0] * d[1] + xx * d[1] * d[1]) / determinant;
            (-0.5 * square).exp() / (TAU * determinant.sqrt())
        });
        each.sum::<f64>() * ds
    }

    #[test]
    fn the_density_of_a_place_is_the_integral_over_the_piece() {
        let strokes = [
            Stroke::Straight([[0.0, 0.0], [1.0, 0.5]]),
            Stroke::between([1.0, 0.0], [0.0, 1.0], 0.414),
            Stroke::between([1.0, 0.0], [0.0, 1.0], -0.3),
            Stroke::between([1.0, 0.0], [0.0, 0.1], 2.5),
        ];
        for (i, stroke) in strokes.iter().enumerate() {
            for point in [[0.9, 0.4], [0.0, 0.0], [1.2, -0.2], [0.5, 0.9], [0.1, 1.1]] {
                let (found, wanted) = (stroke.density(&spot(point)), summed(stroke, &spot(point)));
                assert!((found - wanted).abs() < 0.01 * wanted + 1e-6, "{i} {point:?}: {found} for {wanted}");
            }
        }
    }

    #[test]
    fn the_density_of_a_whole_outline_integrates_to_its_length() {
        // So that likelihoods of different outlines can be compared at all.
        let circle =
            [Stroke::Round { center: [0.2, 0.1], semi: [1.0, 1.0], turn: [1.0, 0.0], from: 0.0, sweep: TAU }];
        let corner =
            [Stroke::Straight([[-1.0, 1.0], [0.0, 0.0]]), Stroke::Straight([[0.0, 0.0], [1.0, 1.0]])];
        for outline in [&circle[..], &corner[..]] {
            let step = 0.05;
            let mut total = 0.0;
            for i in -60..60 {
                for j in -60..60 {
                    let at = spot([f64::from(i) * step, f64::from(j) * step]);
                    total += outline.iter().map(|s| s.density(&at)).sum::<f64>() * step * step;
                }
            }
            let length: f64 = outline.iter().map(Stroke::speed).sum();
            assert!((total / length - 1.0).abs() < 2e-3, "{total} for {length}");
        }
    }

    #[test]
    fn what_no_reading_is_near_was_not_seen() {
        let square = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
        let strokes: Vec<Stroke> =
            (0..4).map(|i| Stroke::Straight([square[i], square[(i + 1) % 4]])).collect();
        let spots: Vec<Spot> = (0..41).map(|k| spot([0.1 * f64::from(k), 0.0])).collect();
        let seen = seen_lengths(&strokes, &spots, 0.2);
        assert!((seen[0] - 4.0).abs() < 0.1 && seen[1] < 0.3 && seen[2] == 0.0, "{seen:?}");
    }
}
