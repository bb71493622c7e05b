//! Batch fit of implicit readings: Gauss–Helmert with corrected misclosures, shared noise, bias correction
//! and losses.
//!
//! [`least_squares`](crate::least_squares) accepts any equations. This fit handles tens of thousands of
//! single equations per second, chooses branches, and corrects the bias.

use super::{
    ImplicitReading, MAX_NOISE, MAX_STATE, Normalized, best_branch, curvature_bias, signed_distance,
};
use crate::dense::ScaledCholesky;
use crate::{Error, Loss, Result, Termination};
use nalgebra::{DMatrix, DVector};

/// Assignment of readings to groups with shared noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharedNoise<'a> {
    /// Number of whitened shared noise components at the end of the state of each reading.
    pub size: usize,
    /// Group of each reading; readings of one group share their noise. Groups are numbered from 0 without
    /// gaps.
    pub groups: &'a [usize],
}

/// Options of [`fit_implicit`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImplicitOptions {
    /// Loss of the normalised distances.
    pub loss: Loss,
    /// If true, the mean distance caused by curvature is subtracted at the end.
    pub correct_bias: bool,
    /// Reject readings closer than this many standard deviations to an end of their branch, after a first
    /// fit. Their branch is uncertain, and choosing the more likely one is biased.
    pub margin: Option<f64>,
    /// Maximum number of steps.
    pub max_iterations: usize,
    /// Converged when a step is shorter than this many posterior standard deviations.
    pub step_tolerance: f64,
}

impl Default for ImplicitOptions {
    fn default() -> Self {
        Self {
            loss: Loss::Gaussian,
            correct_bias: true,
            margin: None,
            max_iterations: 60,
            step_tolerance: 1e-5,
        }
    }
}

/// Result of [`fit_implicit`].
#[derive(Debug, Clone, PartialEq)]
pub struct ImplicitFit {
    /// The state, without shared noise.
    pub state: DVector<f64>,
    /// Its covariance for Gaussian data; `None` if it is undetermined.
    pub covariance: Option<DMatrix<f64>>,
    /// Signed distance of each reading in standard deviations, with the bias subtracted; NaN if undefined.
    pub distances: Vec<f64>,
    /// Branch of each reading.
    pub branches: Vec<usize>,
    /// Weight of each reading, from its loss; 0 if its distance is undefined or it was rejected.
    pub weights: Vec<f64>,
    /// Whitened shared noise of each group.
    pub shared: Vec<DVector<f64>>,
    /// `Σ ρ(s) + ½ Σ |shared|²` of all readings, before the bias correction and before readings near ends are
    /// rejected.
    pub loss: f64,
    /// Number of steps.
    pub iterations: usize,
    /// Why the iteration stopped.
    pub termination: Termination,
}

/// Fits a state to implicit readings: minimises `Σ ρ(s_i(x)) + ½ Σ |shared|²`.
///
/// `s_i` is the [`signed_distance`] at `x`, so misclosures are evaluated at the corrected readings. The
/// method is Levenberg–Marquardt with the shared noise eliminated group by group. The bias correction then
/// solves `Σ w (hᵀ (s − b) − c) = 0` with `b` and `c` of [`curvature_bias`]. These equations have no
/// objective, so their steps are not damped; the correction stops if they grow. Bias from *shared* noise is
/// not corrected. Cost per step: four gradients and `n²` per reading.
///
/// # Errors
/// `Input` when shapes differ, or when no reading has a foot point at the start.
///
/// # Examples
/// Radius of a circle about the origin from three points with σ = 0.1 in both coordinates:
/// ```
/// use nalgebra::DVector;
/// use planish_estimate::implicit::{ImplicitOptions, ImplicitReading, fit_implicit};
///
/// struct OnCircle([f64; 2]);
///
/// impl ImplicitReading for OnCircle {
///     fn state(&self) -> usize {
///         1
///     }
///     fn noise(&self) -> usize {
///         2
///     }
///     fn gradient(&self, _: usize, x: &[f64], u: &[f64], by_x: &mut [f64], by_u: &mut [f64]) -> f64 {
///         let p = [self.0[0] - 0.1 * u[0], self.0[1] - 0.1 * u[1]];
///         let radius = p[0].hypot(p[1]);
///         by_x[0] = -1.0;
///         by_u[0] = -0.1 * p[0] / radius;
///         by_u[1] = -0.1 * p[1] / radius;
///         radius - x[0]
///     }
/// }
///
/// let readings = [[2.1, 0.0], [0.0, 1.9], [-2.0, 0.0]].map(OnCircle);
/// let start = DVector::from_element(1, 1.5);
/// let options = ImplicitOptions { correct_bias: false, ..ImplicitOptions::default() };
/// let fit = fit_implicit(&readings, None, &start, &options)?;
/// assert!((fit.state[0] - 2.0).abs() < 1e-6);
/// // Noise along the circle makes it seem larger by about σ²/2R.
/// let corrected = fit_implicit(&readings, None, &start, &ImplicitOptions::default())?;
/// assert!((corrected.state[0] - (2.0 - 0.1 * 0.1 / 4.0)).abs() < 1e-4);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Helmert 1907; Pope 1972, as [`least_squares`](crate::least_squares); Kanatani and Rangarajan 2011, *Hyper
/// least squares fitting of circles and ellipses* (second-order bias).
pub fn fit_implicit<R: ImplicitReading>(
    readings: &[R],
    shared: Option<SharedNoise<'_>>,
    start: &DVector<f64>,
    options: &ImplicitOptions,
) -> Result<ImplicitFit> {
    let mut batch = Batch::new(readings, shared, start.len(), *options)?;
    let mut point = batch.point(start.clone());
    batch.evaluate(&mut point, None);
    if point.used == 0 || !point.loss.is_finite() {
        return Err(Error::input(
            "no reading has a foot point on the start: choose a start closer to the readings",
        ));
    }
    let (iterations, mut termination) = batch.descend(&mut point);
    // Taken here, because the steps below change the equations or the readings, and with them the objective.
    let loss = point.loss;
    if let Some(margin) = options.margin
        && termination != Termination::Undetermined
    {
        batch.reject_near_ends(&mut point, margin);
    }
    // Last, because the bias is computed at foot points, and a reading near an end may have its foot point on
    // the wrong branch.
    if options.correct_bias && termination != Termination::Undetermined {
        batch.correct(&mut point);
    }
    let covariance = ScaledCholesky::new(&point.normal).ok().map(|factor| factor.inverse());
    if covariance.is_none() {
        termination = Termination::Undetermined;
    }
    Ok(ImplicitFit {
        state: point.state,
        covariance,
        distances: point.distances,
        branches: point.branches,
        weights: point.weights,
        shared: point.shared,
        loss,
        iterations,
        termination,
    })
}

/// The Kanatani–Cramér–Rao bound: `(Σ hᵀ h)⁻¹` at the true state and the true readings. To first order it
/// bounds the covariance of every unbiased estimate if the true measured points are unknown.
///
/// `readings` are noise-free, with the σ of the noisy readings.
///
/// # Errors
/// `Input` when shapes differ; `Undetermined` when the readings do not determine some direction of the state.
///
/// # References
/// Kanatani 1998, *Cramér–Rao lower bounds for curve fitting*; Chernov and Lesort 2004, *Statistical
/// efficiency of curve fitting algorithms*.
pub fn kanatani_cramer_rao<R: ImplicitReading>(
    readings: &[R],
    shared: Option<SharedNoise<'_>>,
    truth: &DVector<f64>,
) -> Result<DMatrix<f64>> {
    let mut batch = Batch::new(readings, shared, truth.len(), ImplicitOptions::default())?;
    let mut point = batch.point(truth.clone());
    batch.evaluate(&mut point, None);
    ScaledCholesky::new(&point.normal)
        .map(|factor| factor.inverse())
        .map_err(|null| null.into_error("the state"))
}

struct Batch<'a, R> {
    readings: &'a [R],
    /// Readings of each group; a single group of all readings if there is no shared noise.
    members: Vec<Vec<usize>>,
    size: usize,
    dimension: usize,
    options: ImplicitOptions,
    /// Readings rejected because they are close to an end of their branch.
    rejected: Vec<bool>,
    at: Normalized,
}

/// Results of [`curvature_bias`] for all readings.
struct Biases {
    /// Bias of each distance.
    distances: Vec<f64>,
    /// Sum of the biases of the scores of each group.
    rows: Vec<DVector<f64>>,
}

/// A state with its distances and normal equations.
#[derive(Clone)]
struct Point {
    state: DVector<f64>,
    shared: Vec<DVector<f64>>,
    noises: Vec<[f64; MAX_NOISE]>,
    distances: Vec<f64>,
    branches: Vec<usize>,
    weights: Vec<f64>,
    loss: f64,
    used: usize,
    /// Normal matrix with the shared noise eliminated.
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Per group: `(C⁻¹ b, C⁻¹ B)` of `C s = b − B x`, which give the step of the shared noise from that of
    /// the state.
    back: Vec<(DVector<f64>, DMatrix<f64>)>,
}

impl<'a, R: ImplicitReading> Batch<'a, R> {
    fn new(
        readings: &'a [R],
        shared: Option<SharedNoise<'_>>,
        dimension: usize,
        options: ImplicitOptions,
    ) -> Result<Self> {
        let size = shared.map_or(0, |s| s.size);
        if let Some(wrong) = readings
            .iter()
            .position(|r| r.state() != dimension + size || r.state() > MAX_STATE || r.noise() > MAX_NOISE)
        {
            return Err(Error::input(format!(
                "reading {wrong} has {} unknowns, expected {dimension} and {size} of shared noise",
                readings[wrong].state()
            )));
        }
        options.loss.validate()?;
        let mut members: Vec<Vec<usize>> = Vec::new();
        match shared {
            None => members.push((0..readings.len()).collect()),
            Some(shared) => {
                if shared.groups.len() != readings.len() {
                    return Err(Error::input("with shared noise every reading needs a group"));
                }
                for (i, &group) in shared.groups.iter().enumerate() {
                    // Without gaps there are no more groups than readings. The check also bounds the
                    // allocation below.
                    if group >= readings.len() {
                        return Err(Error::input(
                            "groups of shared noise must be numbered from 0 without gaps",
                        ));
                    }
                    if group >= members.len() {
                        members.resize(group + 1, Vec::new());
                    }
                    members[group].push(i);
                }
            }
        }
        Ok(Self {
            readings,
            members,
            size,
            dimension,
            options,
            rejected: vec![false; readings.len()],
            at: Normalized::new(),
        })
    }

    fn point(&self, state: DVector<f64>) -> Point {
        let count = self.readings.len();
        let n = self.dimension;
        Point {
            state,
            shared: vec![DVector::zeros(self.size); self.members.len()],
            noises: vec![[0.0; MAX_NOISE]; count],
            distances: vec![f64::NAN; count],
            branches: vec![usize::MAX; count],
            weights: vec![0.0; count],
            loss: 0.0,
            used: 0,
            normal: DMatrix::zeros(n, n),
            right: DVector::zeros(n),
            back: Vec::new(),
        }
    }

    /// Computes distances, objective and normal equations at a point, with the biases subtracted if given.
    fn evaluate(&mut self, point: &mut Point, biases: Option<&Biases>) {
        let (n, q) = (self.dimension, self.size);
        let m = n + q;
        let mut x = [0.0; MAX_STATE];
        x[..n].copy_from_slice(point.state.as_slice());
        point.normal.fill(0.0);
        point.right.fill(0.0);
        (point.loss, point.used) = (0.0, 0);
        point.back.clear();
        let mut full = DMatrix::zeros(m, m);
        let mut right = DVector::zeros(m);
        for (group, members) in self.members.iter().enumerate() {
            full.fill(0.0);
            right.fill(0.0);
            for k in 0..q {
                let s = point.shared[group][k];
                x[n + k] = s;
                full[(n + k, n + k)] = 1.0;
                right[n + k] = -s;
                point.loss += 0.5 * s * s;
            }
            for &i in members {
                let reading = &self.readings[i];
                let p = reading.noise();
                let branch = best_branch(reading, &x[..m]);
                let origin = [0.0; MAX_NOISE];
                let noise = &mut point.noises[i];
                // The noise of the previous state is a good start, but only on the branch for which it was
                // found.
                if branch != point.branches[i] {
                    noise.fill(0.0);
                }
                point.branches[i] = branch;
                let mut found =
                    signed_distance(reading, branch, &x[..m], &origin[..p], &mut noise[..p], &mut self.at);
                if !found {
                    // The foot point of an earlier state can be a bad start: try again from zero noise.
                    noise.fill(0.0);
                    found = signed_distance(
                        reading,
                        branch,
                        &x[..m],
                        &origin[..p],
                        &mut noise[..p],
                        &mut self.at,
                    );
                }
                if !found {
                    noise.fill(0.0);
                    (point.distances[i], point.weights[i]) = (f64::NAN, 0.0);
                    // Charge a reading without a foot point like a distance beyond any gate. A smaller loss
                    // would reward states that lose foot points.
                    point.loss += self.options.loss.rho(30.0);
                    continue;
                }
                let distance = self.at.distance - biases.map_or(0.0, |b| b.distances[i]);
                point.distances[i] = distance;
                // Its distance is still computed, so that the next round can decide about it again.
                if self.rejected[i] {
                    point.weights[i] = 0.0;
                    continue;
                }
                let weight = self.options.loss.weight(distance);
                point.weights[i] = weight;
                point.loss += self.options.loss.rho(distance);
                point.used += 1;
                let row = &self.at.row[..m];
                for a in 0..m {
                    let scaled = weight * row[a];
                    right[a] += scaled * distance;
                    // The lower triangle is sufficient; it is mirrored once per group.
                    for b in 0..=a {
                        full[(a, b)] += scaled * row[b];
                    }
                }
            }
            full.fill_upper_triangle_with_lower_triangle();
            if let Some(biases) = biases {
                right -= &biases.rows[group];
            }
            self.eliminate(point, &full, &right);
        }
    }

    /// Adds the equations of a group to those of the state and eliminates its shared noise.
    fn eliminate(&self, point: &mut Point, full: &DMatrix<f64>, right: &DVector<f64>) {
        let (n, q) = (self.dimension, self.size);
        // Groups are eliminated one by one. The full system, with the noise of all groups, would grow with
        // the number of groups.
        point.normal += full.view((0, 0), (n, n));
        point.right += right.rows(0, n);
        if q == 0 {
            return;
        }
        let cross = full.view((n, 0), (q, n)).into_owned();
        // Never singular, because it contains the unit prior of the noise.
        let Some(factor) = full.view((n, n), (q, q)).into_owned().cholesky() else {
            return;
        };
        let solved = factor.solve(&cross);
        let still = factor.solve(&right.rows(n, q).into_owned());
        // Schur complement of the shared noise; `back` keeps what its own step needs.
        point.normal -= cross.tr_mul(&solved);
        point.right -= cross.tr_mul(&still);
        point.back.push((still, solved));
    }

    fn moved(&self, point: &Point, step: &DVector<f64>) -> Point {
        let mut next = point.clone();
        next.state += step;
        for (shared, (still, solved)) in next.shared.iter_mut().zip(&point.back) {
            *shared += still - solved * step;
        }
        next
    }

    fn descend(&mut self, point: &mut Point) -> (usize, Termination) {
        let mut damping = 0.0_f64;
        for iteration in 1..=self.options.max_iterations {
            let mut damped = point.normal.clone();
            for k in 0..self.dimension {
                // Damping relative to the diagonal does not depend on the units of the unknowns (Marquardt).
                damped[(k, k)] += damping * point.normal[(k, k)].max(f64::MIN_POSITIVE);
            }
            let Ok(factor) = ScaledCholesky::new(&damped) else {
                if damping > 1e6 {
                    return (iteration, Termination::Undetermined);
                }
                damping = (10.0 * damping).max(1e-6);
                continue;
            };
            let step = factor.solve(&point.right);
            let decrement = factor.inverse_form(&point.right).sqrt();
            let mut trial = self.moved(point, &step);
            self.evaluate(&mut trial, None);
            // A state that loses all readings has a small loss but is useless.
            // Equality counts as success: at the optimum a step can be too small to change the loss.
            let better = trial.loss <= point.loss && trial.used > 0;
            let gained = point.loss - trial.loss;
            if better {
                *point = trial;
                damping = if damping > 1e-6 { 0.1 * damping } else { 0.0 };
            }
            // A strongly damped step is short anywhere, so its length shows convergence only if damping is
            // weak.
            if decrement <= self.options.step_tolerance && damping <= 1e-3 {
                return (iteration, Termination::Converged);
            }
            if better && gained <= 1e-9 * (1.0 + point.loss) {
                return (iteration, Termination::ReachedTolerance);
            }
            if !better {
                damping = (10.0 * damping).max(1e-3);
                if damping > 1e9 {
                    return (iteration, Termination::ReachedTolerance);
                }
            }
        }
        (self.options.max_iterations, Termination::Limit)
    }

    /// Rejects readings near the ends of their branches and fits again. Keeps them if the others do not
    /// determine the state.
    fn reject_near_ends(&mut self, point: &mut Point, margin: f64) {
        let m = self.dimension + self.size;
        let mut x = [0.0; MAX_STATE];
        // The state decides who is near an end, and the readings kept decide the state. Few rounds settle
        // this; more could alternate between two sets.
        for _ in 0..3 {
            let mut next = vec![false; self.readings.len()];
            x[..self.dimension].copy_from_slice(point.state.as_slice());
            for (group, members) in self.members.iter().enumerate() {
                x[self.dimension..m].copy_from_slice(point.shared[group].as_slice());
                for &i in members {
                    let reading = &self.readings[i];
                    let noise = &point.noises[i][..reading.noise()];
                    // The corrected place along the branch is independent of the distance, so this selection
                    // does not bias the fit. A selection by distance would.
                    next[i] = point.distances[i].is_finite()
                        && reading.margin(point.branches[i], &x[..m], noise) < margin;
                }
            }
            if next == self.rejected {
                return;
            }
            let before = std::mem::replace(&mut self.rejected, next);
            let mut trial = point.clone();
            self.evaluate(&mut trial, None);
            let (_, termination) = self.descend(&mut trial);
            if termination == Termination::Undetermined || ScaledCholesky::new(&trial.normal).is_err() {
                self.rejected = before;
                self.evaluate(point, None);
                return;
            }
            *point = trial;
        }
    }

    fn biases(&mut self, point: &Point) -> Biases {
        let m = self.dimension + self.size;
        let mut x = [0.0; MAX_STATE];
        x[..self.dimension].copy_from_slice(point.state.as_slice());
        let mut biases = Biases {
            distances: vec![0.0; self.readings.len()],
            rows: vec![DVector::zeros(m); self.members.len()],
        };
        let origin = [0.0; MAX_NOISE];
        let mut row_bias = [0.0; MAX_STATE];
        for (group, members) in self.members.iter().enumerate() {
            x[self.dimension..m].copy_from_slice(point.shared[group].as_slice());
            for &i in members {
                let reading = &self.readings[i];
                let p = reading.noise();
                let (branch, noise) = (point.branches[i], &point.noises[i][..p]);
                if point.distances[i].is_finite() && self.at.at(reading, branch, &x[..m], noise, &origin[..p])
                {
                    biases.distances[i] =
                        curvature_bias(reading, branch, &x[..m], noise, &self.at, &mut row_bias[..m]);
                    for (sum, value) in biases.rows[group].iter_mut().zip(&row_bias[..m]) {
                        *sum += point.weights[i] * value;
                    }
                }
            }
        }
        biases
    }

    /// Solves the bias-corrected equations. Steps may not grow: the equations have no objective to test.
    fn correct(&mut self, point: &mut Point) {
        let mut previous = f64::INFINITY;
        for _ in 0..25 {
            let biases = self.biases(point);
            let mut corrected = point.clone();
            self.evaluate(&mut corrected, Some(&biases));
            let Ok(factor) = ScaledCholesky::new(&corrected.normal) else {
                return;
            };
            let decrement = factor.inverse_form(&corrected.right).sqrt();
            // The equations have no objective, so growth of the step is the only sign of divergence.
            if !decrement.is_finite() || decrement > 2.0 * previous {
                return;
            }
            *point = self.moved(&corrected, &factor.solve(&corrected.right));
            if decrement <= 1e-3 {
                return;
            }
            previous = decrement;
        }
    }
}
