//! All implicit readings at once: Gauss–Helmert with corrected misclosures, shared noise, bias correction and
//! losses.
//!
//! Beside [`least_squares`](crate::least_squares), which takes any equations, this one takes tens of
//! thousands of single ones a second, chooses facets, and corrects the bias.

use super::{
    ImplicitReading, MOST_NOISE, MOST_STATE, Normalized, best_branch, curvature_bias, signed_distance,
};
use crate::dense::ScaledCholesky;
use crate::{Error, Loss, Result, Termination};
use nalgebra::{DMatrix, DVector};

/// Which readings share noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharedNoise<'a> {
    /// How many unknowns at the end of each reading's state are whitened shared noise.
    pub size: usize,
    /// The group of each reading; readings of one group share their noise. Groups are numbered from 0 without
    /// gaps.
    pub groups: &'a [usize],
}

/// How to search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImplicitOptions {
    /// What a distance is charged.
    pub loss: Loss,
    /// Whether the mean that curvature causes is taken off each distance at the end.
    pub correct_bias: bool,
    /// Readings nearer to the ends of their branch than so many standard deviations, at the optimum of all,
    /// are then left out: which branch they are of is not certain, and the likelier one is a biased choice.
    pub margin: Option<f64>,
    /// The most steps tried.
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

/// The outcome of a batch of implicit readings.
#[derive(Debug, Clone, PartialEq)]
pub struct ImplicitFit {
    /// The state, without shared noise.
    pub state: DVector<f64>,
    /// Its covariance, for Gaussian data; `None` where it is undetermined.
    pub covariance: Option<DMatrix<f64>>,
    /// Signed distance of each reading in standard deviations, the bias taken off; NaN where it has none.
    pub distances: Vec<f64>,
    /// The branch that each reading is on.
    pub branches: Vec<usize>,
    /// The loss's weight of each reading; 0 where it has no distance, or was left out.
    pub weights: Vec<f64>,
    /// Whitened shared noise of each group.
    pub shared: Vec<DVector<f64>>,
    /// `Σ ρ(s) + ½ Σ |shared|²` of all readings, before the bias correction and before any are left out near
    /// ends.
    pub loss: f64,
    /// Steps tried.
    pub iterations: usize,
    /// How it ended.
    pub termination: Termination,
}

/// The state that minimises `Σ ρ(s_i(x)) + ½ Σ |shared|²`: most likely readings on the equation, each at its
/// own place.
///
/// `s_i` is the [`signed_distance`] at `x`, so that misclosures are those at the corrected readings.
/// Levenberg–Marquardt with the shared noise eliminated group by group; then, where asked, solves
/// `Σ w (hᵀ (s − b) − c) = 0` with [`curvature_bias`]'s `b` and `c`. That second equation has no objective:
/// its few steps are taken as they come, and given up where they grow. Bias from *shared* noise is not
/// corrected. Cost a step: four gradients and `n²` a reading.
///
/// # Errors
/// `Input` when shapes differ, or when no reading has a distance at the start.
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
        return Err(Error::input("no reading has a distance to the start: give one nearer to the readings"));
    }
    let (iterations, mut termination) = batch.descend(&mut point);
    let loss = point.loss;
    if let Some(margin) = options.margin
        && termination != Termination::Undetermined
    {
        batch.leave_out(&mut point, margin);
    }
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

/// The Kanatani–Cramér–Rao bound: `(Σ hᵀ h)⁻¹` at the true state and true readings, which bounds every
/// unbiased estimate to first order when the true places of the readings are unknown.
///
/// `readings` are noise-free ones, with the σ of the noisy ones.
///
/// # Errors
/// `Input` when shapes differ; `Undetermined` when the readings leave a direction of the state free.
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
    /// Readings of each group, or one group of all without shared noise.
    members: Vec<Vec<usize>>,
    size: usize,
    dimension: usize,
    options: ImplicitOptions,
    /// Readings that do not count, by their place near an end.
    left_out: Vec<bool>,
    at: Normalized,
}

/// What [`curvature_bias`] says of all readings.
struct Biases {
    /// Of each distance.
    distances: Vec<f64>,
    /// Of the scores of each group, summed up.
    rows: Vec<DVector<f64>>,
}

/// A state with everything that belongs to it.
#[derive(Clone)]
struct Point {
    state: DVector<f64>,
    shared: Vec<DVector<f64>>,
    noises: Vec<[f64; MOST_NOISE]>,
    distances: Vec<f64>,
    branches: Vec<usize>,
    weights: Vec<f64>,
    loss: f64,
    used: usize,
    /// Shared noise eliminated.
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Per group: `(C⁻¹ b, C⁻¹ B)` of `C s = b − B x`, to step the shared noise with the state.
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
            .position(|r| r.state() != dimension + size || r.state() > MOST_STATE || r.noise() > MOST_NOISE)
        {
            return Err(Error::input(format!(
                "reading {wrong} is about {} unknowns, needed {dimension} and {size} of shared noise",
                readings[wrong].state()
            )));
        }
        options.loss.validate()?;
        let mut members: Vec<Vec<usize>> = Vec::new();
        match shared {
            None => members.push((0..readings.len()).collect()),
            Some(shared) => {
                if shared.groups.len() != readings.len() {
                    return Err(Error::input("every reading needs a group where noise is shared"));
                }
                for (i, &group) in shared.groups.iter().enumerate() {
                    if group >= readings.len() {
                        return Err(Error::input("groups of shared noise must be numbered without gaps"));
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
            left_out: vec![false; readings.len()],
            at: Normalized::new(),
        })
    }

    fn point(&self, state: DVector<f64>) -> Point {
        let count = self.readings.len();
        let n = self.dimension;
        Point {
            state,
            shared: vec![DVector::zeros(self.size); self.members.len()],
            noises: vec![[0.0; MOST_NOISE]; count],
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

    /// Distances, objective and normal equations at a point; with the biases to take off, where given.
    fn evaluate(&mut self, point: &mut Point, biases: Option<&Biases>) {
        let (n, q) = (self.dimension, self.size);
        let m = n + q;
        let mut x = [0.0; MOST_STATE];
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
                let origin = [0.0; MOST_NOISE];
                let noise = &mut point.noises[i];
                if branch != point.branches[i] {
                    noise.fill(0.0);
                }
                point.branches[i] = branch;
                let mut found =
                    signed_distance(reading, branch, &x[..m], &origin[..p], &mut noise[..p], &mut self.at);
                if !found {
                    // A foot of an earlier state may be a bad start.
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
                    // As far as a gate would ever look: a reading without a foot must not look like a good
                    // one.
                    point.loss += self.options.loss.rho(30.0);
                    continue;
                }
                let distance = self.at.distance - biases.map_or(0.0, |b| b.distances[i]);
                point.distances[i] = distance;
                if self.left_out[i] {
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

    /// Adds a group's equations to those of the state, its shared noise eliminated.
    fn eliminate(&self, point: &mut Point, full: &DMatrix<f64>, right: &DVector<f64>) {
        let (n, q) = (self.dimension, self.size);
        point.normal += full.view((0, 0), (n, n));
        point.right += right.rows(0, n);
        if q == 0 {
            return;
        }
        let cross = full.view((n, 0), (q, n)).into_owned();
        // Never singular: the unit prior of the noise is in it.
        let Some(factor) = full.view((n, n), (q, q)).into_owned().cholesky() else {
            return;
        };
        let solved = factor.solve(&cross);
        let still = factor.solve(&right.rows(n, q).into_owned());
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
            let better = trial.loss <= point.loss && trial.used > 0;
            let gained = point.loss - trial.loss;
            if better {
                *point = trial;
                damping = if damping > 1e-6 { 0.1 * damping } else { 0.0 };
            }
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

    /// Leaves out readings near the ends of their branches, and searches anew; all stay where the rest does
    /// not determine the state.
    fn leave_out(&mut self, point: &mut Point, margin: f64) {
        let m = self.dimension + self.size;
        let mut x = [0.0; MOST_STATE];
        for _ in 0..3 {
            let mut next = vec![false; self.readings.len()];
            x[..self.dimension].copy_from_slice(point.state.as_slice());
            for (group, members) in self.members.iter().enumerate() {
                x[self.dimension..m].copy_from_slice(point.shared[group].as_slice());
                for &i in members {
                    let reading = &self.readings[i];
                    let noise = &point.noises[i][..reading.noise()];
                    next[i] = point.distances[i].is_finite()
                        && reading.margin(point.branches[i], &x[..m], noise) < margin;
                }
            }
            if next == self.left_out {
                return;
            }
            let before = std::mem::replace(&mut self.left_out, next);
            let mut trial = point.clone();
            self.evaluate(&mut trial, None);
            let (_, termination) = self.descend(&mut trial);
            if termination == Termination::Undetermined || ScaledCholesky::new(&trial.normal).is_err() {
                self.left_out = before;
                self.evaluate(point, None);
                return;
            }
            *point = trial;
        }
    }

    fn biases(&mut self, point: &Point) -> Biases {
        let m = self.dimension + self.size;
        let mut x = [0.0; MOST_STATE];
        x[..self.dimension].copy_from_slice(point.state.as_slice());
        let mut biases = Biases {
            distances: vec![0.0; self.readings.len()],
            rows: vec![DVector::zeros(m); self.members.len()],
        };
        let origin = [0.0; MOST_NOISE];
        let mut row_bias = [0.0; MOST_STATE];
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

    fn correct(&mut self, point: &mut Point) {
        let mut previous = f64::INFINITY;
        for _ in 0..25 {
            let biases = self.biases(point);
            let mut here = point.clone();
            self.evaluate(&mut here, Some(&biases));
            let Ok(factor) = ScaledCholesky::new(&here.normal) else {
                return;
            };
            let decrement = factor.inverse_form(&here.right).sqrt();
            if !decrement.is_finite() || decrement > 2.0 * previous {
                return;
            }
            *point = self.moved(&here, &factor.solve(&here.right));
            if decrement <= 1e-3 {
                return;
            }
            previous = decrement;
        }
    }
}
