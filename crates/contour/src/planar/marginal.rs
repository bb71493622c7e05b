//! Maximum of the marginal likelihood of an outline: the place of each reading on it is integrated out.
//!
//! In: an outline near its optimum with its covariance, and readings with independent errors. Out: the most
//! likely outline, and its covariance from the curvature of the likelihood. Not guaranteed: anything for
//! readings that share the error of a pose, or too few readings to show how they are spread along the
//! outline.
//!
//! A fit by distances assigns readings near a corner to the side that fits better, and ignores that the foot
//! point on a curve is uncertain. Both cause a bias, and the first-order covariance is too small if the noise
//! is a large fraction of a side or a radius. The marginal likelihood has almost no such bias while the noise
//! is below a tenth of a side. At a fifth, sides are still too long and σ too small; `docs/contours.md` has
//! the figures. The density of readings on each part of the outline is a nuisance parameter, so that hidden
//! or densely read parts do not pull at corners (decision record 0050).
//!
//! # References
//! Kiefer and Wolfowitz 1956, *Consistency of the maximum likelihood estimator in the presence of infinitely
//! many incidental parameters*; Berndt, Hall, Hall and Hausman 1974, *Estimation and inference in nonlinear
//! structural models* (steps from the squares of scores).

use super::kind::ContourKind;
use super::likelihood::{MeasuredPoint, Stroke, strokes};
use super::parts::typical_gap;
use super::reading::{ContourEquation, ContourModel, ContourReading, ContourTarget, PlanarMotion};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Readings per cell of the outline. Smaller cells follow the density of readings better, but their shares
/// become noisy.
const READINGS_PER_CELL: f64 = 20.0;
/// Maximum number of cells per piece; bounds the cost, which is proportional to readings times cells.
const MAX_CELLS: f64 = 12.0;
/// Prior readings per cell. They keep the share of an unobserved cell above zero, whose logarithm is needed.
const PRIOR_READINGS: f64 = 0.5;
/// Rounds of expectation maximisation that estimate the shares for the initial outline.
const SHARE_ROUNDS: usize = 10;
/// Half the spacing of central differences, in σ of the parameters; second derivatives use twice as much.
///
/// The likelihood is smooth on the scale of σ. Much smaller steps lose second differences to rounding.
const STEP: f64 = 0.1;
/// Converged if the next step is shorter than this, in σ: far below the statistical error.
const MIN_STEP_SIGMAS: f64 = 0.02;
/// Maximum number of steps; the climb starts close to its maximum.
const MAX_STEPS: usize = 20;
/// Maximum length of a step, in σ of each parameter; also the largest bias correction.
const MAX_STEP_SIGMAS: f64 = 2.0;
/// Above this number of readings, the covariance comes from the squares of the scores alone.
///
/// Both estimates of the information agree for many readings, and second differences are costly.
const MAX_FOR_CURVATURE: usize = 4000;
/// Circles and ellipses observed over at least this angle (rad) are treated as complete.
///
/// The cells of unobserved parts then get almost no share. Below it, the arc ends at its last readings.
const MIN_CLOSED_SWEEP: f64 = 0.6 * TAU;
/// Cells more than this many σ from a reading are skipped: e^(−24) is below any density that matters.
const MAX_SIGMAS: f64 = 7.0;
/// Smallest number of readings per parallel task.
const READINGS_PER_THREAD: usize = 256;

/// The most likely state with its covariance.
pub(super) struct MostLikely {
    pub(super) state: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
}

/// Maximises `Σᵢ log(Σₖ πₖ/Lₖ(θ) ∫ₖ N(zᵢ; p(s), Cᵢ) ds + w)` over the parameters θ and the shares `πₖ`.
///
/// Cell `k` of the outline has the length `Lₖ` and the share `πₖ` of all readings. The constant `w` is the
/// density of outliers: that of a reading at the gate, inversely proportional to the variance of a reading.
///
/// For outlines without corners, the remaining bias is then subtracted: the expected score at the maximum if
/// each reading belongs to its nearest place. It arises because the places visible from one pose are spread
/// less evenly than those of all poses together, and because heading errors shift the end of a ray towards
/// the sensor.
///
/// Returns `None` if the likelihood has no maximum nearby.
pub(super) fn most_likely(
    model: &ContourModel,
    readings: &[ContourReading],
    start: &DVector<f64>,
    covariance: &DMatrix<f64>,
    gate: f64,
) -> Option<MostLikely> {
    PlaceLikelihood::new(model, readings, start, covariance, gate)?.climb()
}

/// A part of a piece of the outline, from one fraction of its length to another, with an even density of
/// readings.
#[derive(Clone)]
struct Cell {
    piece: usize,
    from: f64,
    to: f64,
}

/// The likelihood as a function of the whitened parameters `u` and of the shares of the cells.
struct PlaceLikelihood<'a> {
    model: &'a ContourModel,
    readings: &'a [ContourReading],
    start: &'a DVector<f64>,
    /// Cholesky factor of the initial covariance: the state is `start + scale u`. In `u`, one step length
    /// suits all parameters, whatever their units and correlations.
    scale: DMatrix<f64>,
    cells: Vec<Cell>,
    /// Start angle and sweep of a complete circle or ellipse; `None` if only a part was observed.
    ///
    /// They stay fixed, since ends that follow the readings would make the likelihood discontinuous in θ.
    full_sweep: Option<(f64, f64)>,
    gap: f64,
    /// Density of outliers times the variance of a reading.
    outlier_density: f64,
}

/// Point at which the likelihood is evaluated: whitened parameters and unnormalised log-shares.
#[derive(Clone)]
struct At {
    u: DVector<f64>,
    weights: DVector<f64>,
}

/// Log-likelihood of each reading and its split into cells.
struct Terms {
    logs: Vec<f64>,
    /// Probability that each reading (column) comes from each cell (row).
    chances: DMatrix<f64>,
}

impl<'a> PlaceLikelihood<'a> {
    fn new(
        model: &'a ContourModel,
        readings: &'a [ContourReading],
        start: &'a DVector<f64>,
        covariance: &DMatrix<f64>,
        gate: f64,
    ) -> Option<Self> {
        let scale = Cholesky::new(covariance.clone())?.unpack();
        let gap = typical_gap(readings);
        let measured_points = measured_points(model, readings, start.as_slice());
        let pieces =
            strokes(&model.kind, &start.as_slice()[..model.kind.parameters()], &measured_points, gap);
        // Cells in proportion to length, but at least one per piece.
        let lengths: Vec<f64> = pieces.iter().map(|piece| piece.length(0.0, 1.0)).collect();
        let perimeter = lengths.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let many = readings.len() as f64 / READINGS_PER_CELL;
        let mut cells = Vec::new();
        for (piece, length) in lengths.iter().enumerate() {
            let count = (many * length / perimeter).round().clamp(1.0, MAX_CELLS);
            cells.extend((0..count as usize).map(|k| Cell {
                piece,
                from: k as f64 / count,
                to: (k as f64 + 1.0) / count,
            }));
        }
        let full_sweep = match pieces[..] {
            [Stroke::Round { from, sweep, .. }] if sweep >= MIN_CLOSED_SWEEP => Some((from, TAU)),
            _ => None,
        };
        let sigma = (measured_points.iter().map(MeasuredPoint::variance).sum::<f64>()
            / measured_points.len() as f64)
            .sqrt();
        // The density of an evenly read outline at the distance of the gate.
        let outlier_density = (-0.5 * gate * gate).exp() * sigma / (TAU.sqrt() * perimeter);
        Some(Self { model, readings, start, scale, cells, full_sweep, gap, outlier_density })
    }

    /// State of the whitened parameters.
    fn state(&self, u: &DVector<f64>) -> DVector<f64> {
        self.start + &self.scale * u
    }

    /// The parameters of the contour without those of the motion.
    fn theta<'s>(&self, state: &'s DVector<f64>) -> &'s [f64] {
        &state.as_slice()[..self.model.kind.parameters()]
    }

    /// Likelihood of every reading, in parallel over readings; sums are formed by the callers in a fixed
    /// order.
    fn terms(&self, at: &At) -> Terms {
        let state = self.state(&at.u);
        let measured_points = measured_points(self.model, self.readings, state.as_slice());
        let mut pieces = strokes(&self.model.kind, self.theta(&state), &measured_points, self.gap);
        // `strokes` would end the arc at its last readings, which change with θ.
        if let (Some(full_sweep), [Stroke::Round { from, sweep, .. }]) = (self.full_sweep, &mut pieces[..]) {
            (*from, *sweep) = full_sweep;
        }
        let parts: Vec<Part> = (self.cells.iter().zip(&shares(&at.weights)))
            .map(|(cell, share)| Part::new(&pieces[cell.piece], cell, *share))
            .collect();
        let mut chances = DMatrix::zeros(parts.len(), measured_points.len());
        let one = |(measured, chances): (&MeasuredPoint, &mut [f64])| {
            let mut total = self.outlier_density / measured.variance().max(f64::MIN_POSITIVE);
            for (chance, part) in chances.iter_mut().zip(&parts) {
                *chance = part.density(measured);
                total += *chance;
            }
            // The probability of an outlier is the rest to one.
            chances.iter_mut().for_each(|chance| *chance /= total);
            total.ln()
        };
        let logs = (measured_points.par_iter())
            .zip(chances.as_mut_slice().par_chunks_mut(parts.len()))
            .with_min_len(READINGS_PER_THREAD)
            .map(one)
            .collect();
        Terms { logs, chances }
    }

    /// Sum of the log-likelihood, the soft constraints of a chain, and the log-prior of the shares.
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

    /// Climbs to the maximum by steps from the squares of the scores (Berndt et al. 1974), with step halving.
    fn climb(&self) -> Option<MostLikely> {
        let p = self.start.len();
        let mut at = At { u: DVector::zeros(p), weights: DVector::zeros(self.cells.len()) };
        // Start with shares that suit the initial outline; otherwise the first steps would move corners to
        // make up for wrong shares.
        for _ in 0..SHARE_ROUNDS {
            at.weights = self.terms(&at).chances.column_sum().map(|s| (s + PRIOR_READINGS).ln());
        }
        let mut best = self.total(&at);
        for _ in 0..MAX_STEPS {
            // The squares of the scores are positive definite far from the maximum, too, unlike the Hessian.
            let (gradient, squares) = self.scores(&at);
            let step = Cholesky::new(squares)?.solve(&gradient);
            let size = step.rows(0, p).amax();
            if !size.is_finite() {
                return None;
            }
            // The quadratic model of the likelihood holds over a few σ only.
            let mut share = (MAX_STEP_SIGMAS / size).min(1.0);
            let better = loop {
                let next = At {
                    u: &at.u + share * step.rows(0, p),
                    weights: &at.weights + share * step.rows(p, self.cells.len()),
                };
                // Invalid sizes have no likelihood; the step is halved until they are valid.
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
        // The covariance of the parameters is the block of the inverse of the whole information, so that it
        // includes the uncertainty of the shares.
        let information = self.information(&at)?;
        let inverse = information.inverse();
        let of_u = inverse.view((0, 0), (p, p));
        if !self.has_corners() && self.model.motion == PlanarMotion::Still {
            // A correction larger than the bound is not a bias: the expansion has failed.
            let bias = information.solve(&self.expected_scores(&at));
            if bias.rows(0, p).amax() < MAX_STEP_SIGMAS {
                at.u -= bias.rows(0, p);
            }
        }
        Some(MostLikely { state: self.state(&at.u), covariance: &self.scale * of_u * self.scale.transpose() })
    }

    /// Information at the maximum: the curvature, or the squares of the scores if it is not positive definite
    /// or the readings are many.
    fn information(&self, at: &At) -> Option<Cholesky<f64, Dyn>> {
        let by_curvature = || Cholesky::new(self.curvature(at));
        let few = self.readings.len() <= MAX_FOR_CURVATURE;
        let curvature = if few { by_curvature() } else { None };
        curvature.or_else(|| Cholesky::new(self.scores(at).1))
    }

    /// True for kinds with corners, where the bias is not corrected: nearest places pile up at corners, true
    /// ones do not.
    fn has_corners(&self) -> bool {
        matches!(
            self.model.kind,
            ContourKind::Rectangle
                | ContourKind::Polygon(_)
                | ContourKind::RegularPolygon(_)
                | ContourKind::Chain { .. }
        )
    }

    /// Sum of the scores (the gradient) and of their outer products, which estimates the information.
    fn scores(&self, at: &At) -> (DVector<f64>, DMatrix<f64>) {
        let (p, k, n) = (at.u.len(), self.cells.len(), self.readings.len());
        let shares = shares(&at.weights);
        let mut scores = DMatrix::zeros(p + k, n);
        for j in 0..p {
            let [ahead, behind] = [STEP, -STEP].map(|h| self.terms(&at.moved(j, h)).logs);
            for (i, (ahead, behind)) in ahead.iter().zip(&behind).enumerate() {
                scores[(j, i)] = (ahead - behind) / (2.0 * STEP);
            }
        }
        let at_point = self.terms(at);
        // By a log-share, the score is exact: the probability of the cell minus its share (softmax).
        for i in 0..n {
            for (c, share) in shares.iter().enumerate() {
                scores[(p + c, i)] = at_point.chances[(c, i)] - share;
            }
        }
        let mut gradient = scores.column_sum();
        let mut squares = &scores * scores.transpose();
        // Adding a constant to all log-shares changes nothing; the prior also removes this null direction.
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

    /// Violation of each soft constraint in σ, with its derivative by `u`.
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

    /// Negative second derivatives of the log-posterior: by differences in θ, analytic in the shares.
    fn curvature(&self, at: &At) -> DMatrix<f64> {
        let (p, k, n) = (at.u.len(), self.cells.len(), self.readings.len() as f64);
        let shares = shares(&at.weights);
        let at_point = self.terms(at);
        let sum = |terms: &Terms| terms.logs.iter().sum::<f64>();
        // Second differences divide by h² and need a larger spacing than first ones.
        let h = 2.0 * STEP;
        let corner = |i: usize, a: f64, j: usize, b: f64| sum(&self.terms(&at.moved(i, a).moved(j, b)));
        let mut out = DMatrix::zeros(p + k, p + k);
        for i in 0..p {
            let [ahead, behind] = [h, -h].map(|h| self.terms(&at.moved(i, h)));
            out[(i, i)] = (2.0 * sum(&at_point) - sum(&ahead) - sum(&behind)) / (h * h);
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
        // For log-shares, the Hessian is that of a softmax mixture: probabilities and shares suffice.
        let squares = &at_point.chances * at_point.chances.transpose();
        let sums = at_point.chances.column_sum();
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

    /// Expected sum of the scores if every reading belongs to the nearest place of the outline.
    ///
    /// The expectation is the mean over errors of ±√m σ in each of the `m` measured values. This rule with
    /// `2m` points is exact up to the third power of the errors (McNamee and Stenger 1967); random draws
    /// would add noise to the estimate.
    fn expected_scores(&self, at: &At) -> DVector<f64> {
        let state = self.state(&at.u);
        let measured_points = measured_points(self.model, self.readings, state.as_slice());
        let pieces = strokes(&self.model.kind, self.theta(&state), &measured_points, self.gap);
        let exact: Vec<ContourReading> = (self.readings.iter().zip(&measured_points))
            .map(|(reading, measured)| reading.moved_to(nearest(&pieces, measured.point)))
            .collect();
        let mut sum = DVector::zeros(at.u.len() + self.cells.len());
        for axis in 0..MEASURED {
            for side in [-1.0, 1.0] {
                let sigmas = side * (MEASURED as f64).sqrt();
                let made: Vec<ContourReading> =
                    exact.iter().map(|reading| reading.with_error(axis, sigmas)).collect();
                let model = PlaceLikelihood {
                    readings: &made,
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

/// Number of measured values of a reading: two coordinates of the sensor, heading and range. The two
/// coordinates of a point are counted twice.
const MEASURED: usize = 4;

impl At {
    fn moved(&self, k: usize, by: f64) -> Self {
        let mut next = self.clone();
        next.u[k] += by;
        next
    }
}

/// A cell of the current outline.
struct Part {
    stroke: Stroke,
    /// Share of the readings divided by the length of the cell.
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

    /// Density of a reading from this cell; 0 if it is too far to matter.
    fn density(&self, measured: &MeasuredPoint) -> f64 {
        // A bounding circle, since most cells are far from a reading and exponentials are costly.
        let away =
            (measured.point[0] - self.middle[0]).hypot(measured.point[1] - self.middle[1]) - self.reach;
        if away > 0.0 && away * away > MAX_SIGMAS * MAX_SIGMAS * measured.variance() {
            return 0.0;
        }
        self.rate * self.stroke.density(measured)
    }
}

/// Normalised exponentials of the weights; the maximum is subtracted first to avoid overflow.
fn shares(weights: &DVector<f64>) -> Vec<f64> {
    let top = weights.max();
    let each: Vec<f64> = weights.iter().map(|w| (w - top).exp()).collect();
    let sum: f64 = each.iter().sum();
    each.iter().map(|share| share / sum).collect()
}

/// The readings as points with covariances, carried back to the reference time.
///
/// Points of rays are moved outwards by `½ r σ_h²`: for a heading error of σ_h, the mean of `r cos` is
/// shorter than `r` by that amount.
fn measured_points(model: &ContourModel, readings: &[ContourReading], state: &[f64]) -> Vec<MeasuredPoint> {
    let one = |reading: &ContourReading| {
        let (point, covariance) = ContourEquation::new(model, reading).point_at_reference_time(state);
        let away = match reading.target {
            ContourTarget::Range { heading_rad, range, sigma, .. } => {
                // A rotation of the object also rotates the ray. The effect on this second-order term is
                // negligible.
                let short = 0.5 * range * sigma[2] * sigma[2];
                [short * heading_rad.cos(), short * heading_rad.sin()]
            }
            ContourTarget::Point { .. } => [0.0; 2],
        };
        MeasuredPoint { point: [point[0] + away[0], point[1] + away[1]], covariance }
    };
    readings.iter().map(one).collect()
}

/// The point of an outline that is nearest to `p`.
fn nearest(pieces: &[Stroke], p: [f64; 2]) -> [f64; 2] {
    let away = |q: &[f64; 2]| (q[0] - p[0]).hypot(q[1] - p[1]);
    let on = pieces.iter().map(|piece| piece.nearest(p));
    on.min_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or(p)
}
