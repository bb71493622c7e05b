//! The most likely outline when it is not known from which place on it each reading is.
//!
//! Comes in: an outline near the truth with its covariance, and readings whose errors are their own. Goes
//! out: the outline of the greatest likelihood, the place of each reading integrated over the outline, and
//! the covariance from the curvature of that likelihood. Not guaranteed: anything where readings share the
//! error of their pose, or are too few to tell how they spread along the outline.
//!
//! A distance to the nearest side takes every reading near a corner for the side that suits it better, and a
//! distance to a round outline forgets that its foot is uncertain: both are biased, and their covariance, of
//! the first order, is too small where the noise is a good part of a side or a radius. The likelihood has
//! hardly anything of either while the noise is a tenth of a side; at a fifth of it, sides are still found
//! too long, and σ too small, by what `docs/contours.md` measures. How densely each part of the outline was
//! read is a nuisance parameter of its own, so that hidden or favoured parts do not pull at corners.
//!
//! # References
//! Kiefer and Wolfowitz 1956, *Consistency of the maximum likelihood estimator in the presence of infinitely
//! many incidental parameters*; Berndt, Hall, Hall and Hausman 1974, *Estimation and inference in nonlinear
//! structural models* (steps from the squares of scores).

use super::kind::ContourKind;
use super::likelihood::{Spot, Stroke, strokes};
use super::parts::usual_gap;
use super::reading::{ContourEquation, ContourModel, ContourReading, ContourTarget, PlanarMotion};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// One cell of the outline for so many readings.
const READINGS_PER_CELL: f64 = 20.0;
/// Most cells of one piece of the outline.
const MAX_CELLS: f64 = 12.0;
/// A cell is given so many readings beforehand, so that no share is zero.
const PRIOR_READINGS: f64 = 0.5;
/// Rounds that find the shares where the outline is to begin with.
const SHARE_ROUNDS: usize = 10;
/// Differences are taken over this many σ; second ones over twice as many.
const STEP: f64 = 0.1;
/// Ends where the next step is shorter than this, in σ.
const MIN_STEP_SIGMAS: f64 = 0.02;
const MAX_STEPS: usize = 20;
/// A step is at most this long, in σ of each parameter.
const MAX_STEP_SIGMAS: f64 = 2.0;
/// With more readings than this the covariance is from the squares of the scores alone: they are enough to
/// average over.
const MAX_FOR_CURVATURE: usize = 4000;
/// A circle or ellipse of which so much was seen is taken as whole: parts without readings have hardly a
/// share.
const MIN_WHOLE_SWEEP: f64 = 0.6 * TAU;
/// What is farther from a reading than so many of its σ says nothing of it.
const FARTHEST: f64 = 7.0;
/// So many readings are worth a thread's while.
const READINGS_PER_THREAD: usize = 256;

/// What was found.
pub(super) struct MostLikely {
    pub(super) state: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
}

/// Maximises `Σᵢ log(Σₖ πₖ/Lₖ(θ) ∫ₖ N(zᵢ; p(s), Cᵢ) ds + w)` over the parameters `θ` and the shares `πₖ` of
/// cells of the outline, of lengths `Lₖ`; `w` is the density of wild readings, as unlikely as those at the
/// gate and in inverse proportion to a reading's variance.
///
/// Outlines without corners are then freed of what is left of a bias: the score that is to be expected at the
/// maximum, if each reading were of the place nearest to it, is taken off. The places that a sensor sees from
/// where it stands are not spread as evenly as those that all readings see together, and a heading's error
/// bends its ray's end towards the sensor.
///
/// `None` where the likelihood has no maximum nearby.
pub(super) fn most_likely(
    model: &ContourModel,
    sightings: &[ContourReading],
    start: &DVector<f64>,
    covariance: &DMatrix<f64>,
    gate: f64,
) -> Option<MostLikely> {
    PlaceLikelihood::new(model, sightings, start, covariance, gate)?.climb()
}

/// A part of a piece of the outline with an even spread of readings.
#[derive(Clone)]
struct Cell {
    piece: usize,
    from: f64,
    to: f64,
}

/// The likelihood as a function of the parameters, in σ about the start, and of the cells' shares.
struct PlaceLikelihood<'a> {
    model: &'a ContourModel,
    sightings: &'a [ContourReading],
    start: &'a DVector<f64>,
    /// `θ = start + scale u`.
    scale: DMatrix<f64>,
    cells: Vec<Cell>,
    /// Where a whole circle or ellipse begins and how far it goes, which does not move; a part of one ends
    /// where its readings do.
    whole: Option<(f64, f64)>,
    gap: f64,
    /// The density of wild readings, times the variance of a reading.
    wild: f64,
}

/// Where the model is: the parameters and the logarithms of the shares.
#[derive(Clone)]
struct At {
    u: DVector<f64>,
    weights: DVector<f64>,
}

/// The likelihood of each reading, and how it comes from the cells.
struct Terms {
    logs: Vec<f64>,
    /// Of each reading (column) the chance that it is from each cell.
    chances: DMatrix<f64>,
}

impl<'a> PlaceLikelihood<'a> {
    fn new(
        model: &'a ContourModel,
        sightings: &'a [ContourReading],
        start: &'a DVector<f64>,
        covariance: &DMatrix<f64>,
        gate: f64,
    ) -> Option<Self> {
        let scale = Cholesky::new(covariance.clone())?.unpack();
        let gap = usual_gap(sightings);
        let spots = spots(model, sightings, start.as_slice());
        let pieces = strokes(&model.kind, &start.as_slice()[..model.kind.parameters()], &spots, gap);
        let lengths: Vec<f64> = pieces.iter().map(|piece| piece.length(0.0, 1.0)).collect();
        let perimeter = lengths.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let many = sightings.len() as f64 / READINGS_PER_CELL;
        let mut cells = Vec::new();
        for (piece, length) in lengths.iter().enumerate() {
            let count = (many * length / perimeter).round().clamp(1.0, MAX_CELLS);
            cells.extend((0..count as usize).map(|k| Cell {
                piece,
                from: k as f64 / count,
                to: (k as f64 + 1.0) / count,
            }));
        }
        let whole = match pieces[..] {
            [Stroke::Round { from, sweep, .. }] if sweep >= MIN_WHOLE_SWEEP => Some((from, TAU)),
            _ => None,
        };
        let sigma = (spots.iter().map(Spot::variance).sum::<f64>() / spots.len() as f64).sqrt();
        // The density beside an outline that is read evenly, at the gate.
        let wild = (-0.5 * gate * gate).exp() * sigma / (TAU.sqrt() * perimeter);
        Some(Self { model, sightings, start, scale, cells, whole, gap, wild })
    }

    fn state(&self, u: &DVector<f64>) -> DVector<f64> {
        self.start + &self.scale * u
    }

    fn theta<'s>(&self, state: &'s DVector<f64>) -> &'s [f64] {
        &state.as_slice()[..self.model.kind.parameters()]
    }

    fn terms(&self, at: &At) -> Terms {
        let state = self.state(&at.u);
        let spots = spots(self.model, self.sightings, state.as_slice());
        let mut pieces = strokes(&self.model.kind, self.theta(&state), &spots, self.gap);
        if let (Some(whole), [Stroke::Round { from, sweep, .. }]) = (self.whole, &mut pieces[..]) {
            (*from, *sweep) = whole;
        }
        let parts: Vec<Part> = (self.cells.iter().zip(&shares(&at.weights)))
            .map(|(cell, share)| Part::new(&pieces[cell.piece], cell, *share))
            .collect();
        let mut chances = DMatrix::zeros(parts.len(), spots.len());
        let one = |(spot, chances): (&Spot, &mut [f64])| {
            let mut total = self.wild / spot.variance().max(f64::MIN_POSITIVE);
            for (chance, part) in chances.iter_mut().zip(&parts) {
                *chance = part.density(spot);
                total += *chance;
            }
            chances.iter_mut().for_each(|chance| *chance /= total);
            total.ln()
        };
        let logs = (spots.par_iter())
            .zip(chances.as_mut_slice().par_chunks_mut(parts.len()))
            .with_min_len(READINGS_PER_THREAD)
            .map(one)
            .collect();
        Terms { logs, chances }
    }

    /// The logarithm of the likelihood, of what is known of a chain, and of the prior of the shares.
    fn total(&self, at: &At) -> f64 {
        let log_prior: f64 = shares(&at.weights).iter().map(|s| PRIOR_READINGS * s.ln()).sum();
        let state = self.state(&at.u);
        let mut unused = vec![0.0; self.model.kind.parameters()];
        let penalties = self.model.constraints.iter().map(|constraint| {
            let violation =
                constraint.violation(&self.model.kind, self.theta(&state), &mut unused) / constraint.sigma();
            0.5 * violation * violation
        });
        self.terms(at).logs.iter().sum::<f64>() + log_prior - penalties.sum::<f64>()
    }

    fn climb(&self) -> Option<MostLikely> {
        let p = self.start.len();
        let mut at = At { u: DVector::zeros(p), weights: DVector::zeros(self.cells.len()) };
        for _ in 0..SHARE_ROUNDS {
            at.weights = self.terms(&at).chances.column_sum().map(|s| (s + PRIOR_READINGS).ln());
        }
        let mut best = self.total(&at);
        for _ in 0..MAX_STEPS {
            let (gradient, squares) = self.scores(&at);
            let step = Cholesky::new(squares)?.solve(&gradient);
            let size = step.rows(0, p).amax();
            if !size.is_finite() {
                return None;
            }
            let mut share = (MAX_STEP_SIGMAS / size).min(1.0);
            let better = loop {
                let next = At {
                    u: &at.u + share * step.rows(0, p),
                    weights: &at.weights + share * step.rows(p, self.cells.len()),
                };
                if self.model.kind.is_valid(self.theta(&self.state(&next.u))) {
                    let total = self.total(&next);
                    if total > best {
                        break Some((next, total));
                    }
                }
                share *= 0.5;
                if share * size < MIN_STEP_SIGMAS {
                    break None;
                }
            };
            let Some((next, total)) = better else { break };
            (at, best) = (next, total);
            if share * size < MIN_STEP_SIGMAS {
                break;
            }
        }
        let information = self.information(&at)?;
        let inverse = information.inverse();
        let of_u = inverse.view((0, 0), (p, p));
        if !self.has_corners() && self.model.motion == PlanarMotion::Still {
            let bias = information.solve(&self.expected_scores(&at));
            if bias.rows(0, p).amax() < MAX_STEP_SIGMAS {
                at.u -= bias.rows(0, p);
            }
        }
        Some(MostLikely { state: self.state(&at.u), covariance: &self.scale * of_u * self.scale.transpose() })
    }

    fn information(&self, at: &At) -> Option<Cholesky<f64, Dyn>> {
        let by_curvature = || Cholesky::new(self.curvature(at));
        let few = self.sightings.len() <= MAX_FOR_CURVATURE;
        let curvature = if few { by_curvature() } else { None };
        curvature.or_else(|| Cholesky::new(self.scores(at).1))
    }

    fn has_corners(&self) -> bool {
        matches!(
            self.model.kind,
            ContourKind::Rectangle
                | ContourKind::Polygon(_)
                | ContourKind::RegularPolygon(_)
                | ContourKind::Chain { .. }
        )
    }

    /// The sum of the scores, and of their squares, which is the information where readings are many.
    fn scores(&self, at: &At) -> (DVector<f64>, DMatrix<f64>) {
        let (p, k, n) = (at.u.len(), self.cells.len(), self.sightings.len());
        let shares = shares(&at.weights);
        let mut scores = DMatrix::zeros(p + k, n);
        for j in 0..p {
            let [ahead, behind] = [STEP, -STEP].map(|h| self.terms(&at.moved(j, h)).logs);
            for (i, (ahead, behind)) in ahead.iter().zip(&behind).enumerate() {
                scores[(j, i)] = (ahead - behind) / (2.0 * STEP);
            }
        }
        let here = self.terms(at);
        for i in 0..n {
            for (c, share) in shares.iter().enumerate() {
                scores[(p + c, i)] = here.chances[(c, i)] - share;
            }
        }
        let mut gradient = scores.column_sum();
        let mut squares = &scores * scores.transpose();
        for (c, share) in shares.iter().enumerate() {
            gradient[p + c] += PRIOR_READINGS * (1.0 - k as f64 * share);
            squares[(p + c, p + c)] += PRIOR_READINGS;
        }
        for (violation, row) in self.soft_constraints(at) {
            for i in 0..p {
                gradient[i] -= violation * row[i];
                for j in 0..p {
                    squares[(i, j)] += row[i] * row[j];
                }
            }
        }
        (gradient, squares)
    }

    /// What is known of a chain: by how many σ each is violated, and the derivative of that by `u`.
    fn soft_constraints(&self, at: &At) -> Vec<(f64, DVector<f64>)> {
        let state = self.state(&at.u);
        let theta = self.theta(&state);
        let one = |constraint: &super::soft_constraint::SoftConstraint| {
            let mut by_theta = vec![0.0; theta.len()];
            let violation = constraint.violation(&self.model.kind, theta, &mut by_theta) / constraint.sigma();
            let by_theta = DVector::from_vec(by_theta) / constraint.sigma();
            (violation, self.scale.rows(0, theta.len()).tr_mul(&by_theta))
        };
        self.model.constraints.iter().map(one).collect()
    }

    /// The negative second derivatives.
    fn curvature(&self, at: &At) -> DMatrix<f64> {
        let (p, k, n) = (at.u.len(), self.cells.len(), self.sightings.len() as f64);
        let shares = shares(&at.weights);
        let here = self.terms(at);
        let sum = |terms: &Terms| terms.logs.iter().sum::<f64>();
        let h = 2.0 * STEP;
        let corner = |i: usize, a: f64, j: usize, b: f64| sum(&self.terms(&at.moved(i, a).moved(j, b)));
        let mut out = DMatrix::zeros(p + k, p + k);
        for i in 0..p {
            let [ahead, behind] = [h, -h].map(|h| self.terms(&at.moved(i, h)));
            out[(i, i)] = (2.0 * sum(&here) - sum(&ahead) - sum(&behind)) / (h * h);
            let by = (behind.chances.column_sum() - ahead.chances.column_sum()) / (2.0 * h);
            for c in 0..k {
                out[(i, p + c)] = by[c];
                out[(p + c, i)] = by[c];
            }
            for j in 0..i {
                let mixed =
                    corner(i, h, j, -h) + corner(i, -h, j, h) - corner(i, h, j, h) - corner(i, -h, j, -h);
                out[(i, j)] = mixed / (4.0 * h * h);
                out[(j, i)] = out[(i, j)];
            }
        }
        let squares = &here.chances * here.chances.transpose();
        let sums = here.chances.column_sum();
        for a in 0..k {
            for b in 0..k {
                out[(p + a, p + b)] = squares[(a, b)] - n * shares[a] * shares[b];
            }
            out[(p + a, p + a)] += n * shares[a] - sums[a] + PRIOR_READINGS;
        }
        for (_, row) in self.soft_constraints(at) {
            for i in 0..p {
                for j in 0..p {
                    out[(i, j)] += row[i] * row[j];
                }
            }
        }
        out
    }

    /// What the scores are on average, if every reading is of the place of the outline that is nearest to it:
    /// the mean over errors of `√m` standard deviations, both ways, in each of the `m` things that are
    /// measured, which is right to the third power of the errors (McNamee and Stenger 1967).
    fn expected_scores(&self, at: &At) -> DVector<f64> {
        let state = self.state(&at.u);
        let spots = spots(self.model, self.sightings, state.as_slice());
        let pieces = strokes(&self.model.kind, self.theta(&state), &spots, self.gap);
        let exact: Vec<ContourReading> = (self.sightings.iter().zip(&spots))
            .map(|(sighting, spot)| sighting.moved_to(nearest(&pieces, spot.point)))
            .collect();
        let mut sum = DVector::zeros(at.u.len() + self.cells.len());
        for axis in 0..MEASURED {
            for side in [-1.0, 1.0] {
                let sigmas = side * (MEASURED as f64).sqrt();
                let made: Vec<ContourReading> =
                    exact.iter().map(|sighting| sighting.with_error(axis, sigmas)).collect();
                let model = PlaceLikelihood {
                    sightings: &made,
                    scale: self.scale.clone(),
                    cells: self.cells.clone(),
                    ..*self
                };
                sum += model.scores(at).0;
            }
        }
        sum / (2.0 * MEASURED as f64)
    }
}

/// Place, heading and range; a point has its two coordinates twice.
const MEASURED: usize = 4;

impl At {
    fn moved(&self, k: usize, by: f64) -> Self {
        let mut next = self.clone();
        next.u[k] += by;
        next
    }
}

/// A cell where the outline is now.
struct Part {
    stroke: Stroke,
    /// Share of the readings over its length.
    rate: f64,
    middle: [f64; 2],
    reach: f64,
}

impl Part {
    fn new(piece: &Stroke, cell: &Cell, share: f64) -> Self {
        let stroke = piece.part(cell.from, cell.to);
        Self {
            rate: share / stroke.length(0.0, 1.0).max(f64::MIN_POSITIVE),
            middle: stroke.at(0.5),
            reach: 0.5 * stroke.speed(),
            stroke,
        }
    }

    fn density(&self, spot: &Spot) -> f64 {
        let away = (spot.point[0] - self.middle[0]).hypot(spot.point[1] - self.middle[1]) - self.reach;
        if away > 0.0 && away * away > FARTHEST * FARTHEST * spot.variance() {
            return 0.0;
        }
        self.rate * self.stroke.density(spot)
    }
}

fn shares(weights: &DVector<f64>) -> Vec<f64> {
    let top = weights.max();
    let each: Vec<f64> = weights.iter().map(|w| (w - top).exp()).collect();
    let sum: f64 = each.iter().sum();
    each.iter().map(|share| share / sum).collect()
}

/// The readings as points at rest. The end of a ray of an uncertain heading is nearer to the sensor than what
/// it is of, on average.
fn spots(model: &ContourModel, sightings: &[ContourReading], state: &[f64]) -> Vec<Spot> {
    let one = |sighting: &ContourReading| {
        let (point, covariance) = ContourEquation::new(model, sighting).seen_at_rest(state);
        let away = match sighting.target {
            ContourTarget::Range { heading_rad, range, sigma, .. } => {
                // A thing that turns while it is measured turns the ray as well, by less than matters here.
                let short = 0.5 * range * sigma[2] * sigma[2];
                [short * heading_rad.cos(), short * heading_rad.sin()]
            }
            ContourTarget::Point { .. } => [0.0; 2],
        };
        Spot { point: [point[0] + away[0], point[1] + away[1]], covariance }
    };
    sightings.iter().map(one).collect()
}

/// The point of an outline that is nearest.
fn nearest(pieces: &[Stroke], p: [f64; 2]) -> [f64; 2] {
    let away = |q: &[f64; 2]| (q[0] - p[0]).hypot(q[1] - p[1]);
    let on = pieces.iter().map(|piece| piece.nearest(p));
    on.min_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or(p)
}
