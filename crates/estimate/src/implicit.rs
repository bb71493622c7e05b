//! Readings of one implicit equation each: `g(z − L u, x) = 0` with whitened noise `u ~ N(0, I)`.
//!
//! Input: readings of a curve or surface; the measured point on it is unknown. Output: signed distances in
//! standard deviations, sequential filters, a batch fit, the bias from curvature, and the lower bound of the
//! covariance. Not guaranteed: the global optimum; any accuracy if the noise exceeds the radius of curvature.
//!
//! This is [`MeasurementEquation`](crate::MeasurementEquation) for the frequent case of a single equation per
//! reading, without allocation: `v = L u` with `R = L Lᵀ`. If readings share noise (a sweep from one pose),
//! the shared components are further unknowns behind the state, with a unit prior: see [`SharedNoise`].
//!
//! ```text
//! ImplicitReading ─► signed_distance ─┬─► KalmanFilter::update_implicit     EKF, IEKF, NUIEKF
//!                        │            └─► fit_implicit                      batch (Gauss–Helmert)
//!                        └─► curvature_bias, kanatani_cramer_rao
//! ```

use nalgebra::{DMatrix, DVector};

mod batch;
mod bias;
mod filter;

pub use batch::{ImplicitFit, ImplicitOptions, SharedNoise, fit_implicit, kanatani_cramer_rao};
pub use bias::{NoiseHessian, curvature_bias};
pub use filter::{ImplicitInnovation, ImplicitUpdate};

/// Maximum number of whitened noise components of a reading: a ray in space has seven. Fixed, so that
/// readings need no allocation.
pub const MAX_NOISE: usize = 8;
/// Maximum number of unknowns of a state, including shared noise. Fixed, so that readings need no allocation.
pub const MAX_STATE: usize = 96;

/// A reading with one equation, `g(z − L u, x) = 0`, in whitened noise `u`.
///
/// The equation may have several smooth branches, such as the sides of a polygon. Laws: `gradient` fills
/// `∂g/∂x` and `∂g/∂u` of the branch; results do not depend on earlier calls. `g` is NaN where it is not
/// defined.
pub trait ImplicitReading {
    /// Number of components of the state, including shared noise; at most [`MAX_STATE`].
    fn state(&self) -> usize;

    /// Number of components of the whitened noise; at most [`MAX_NOISE`].
    fn noise(&self) -> usize;

    /// Returns `g` and fills `∂g/∂x` and `∂g/∂u` of a branch. The slices have the lengths of `x` and `u` and
    /// unspecified contents.
    fn gradient(
        &self,
        branch: usize,
        x: &[f64],
        u: &[f64],
        by_state: &mut [f64],
        by_noise: &mut [f64],
    ) -> f64;

    /// Number of branches.
    fn branches(&self) -> usize {
        1
    }

    /// Penalty, in squared standard deviations, for a corrected reading `z − L u` beyond the ends of the
    /// branch.
    fn beyond_end_penalty(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        let _ = (branch, x, u);
        0.0
    }

    /// The most likely branch at zero noise, if the reading can find it faster than [`best_branch`].
    fn nearest_branch(&self, x: &[f64]) -> Option<usize> {
        let _ = x;
        None
    }

    /// Distance, in standard deviations, of the corrected reading `z − L u` from the ends of the branch,
    /// where it meets another at an angle. Negative beyond an end, infinite if the branch has no ends.
    fn margin(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        let _ = (branch, x, u);
        f64::INFINITY
    }

    /// Fills `∂²g/∂u²` of a branch and returns true. If it returns false, differences of the gradient are
    /// used.
    fn noise_hessian(&self, branch: usize, x: &[f64], u: &[f64], hessian: &mut NoiseHessian) -> bool {
        let _ = (branch, x, u, hessian);
        false
    }

    /// Variance of `g` beyond `|∂g/∂u|²`, from its second derivatives. It bounds the weight of a product of
    /// facets at a corner, where the gradient vanishes.
    fn second_order_variance(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        let _ = (branch, x, u);
        0.0
    }
}

/// A linearised equation divided by its standard deviation: `n·u = s − h (x − x0)` with `|n| = 1`.
#[derive(Debug, Clone, Copy)]
pub struct Normalized {
    /// `s`: the signed distance from the origin of the noise to the linearised equation, in standard
    /// deviations.
    pub distance: f64,
    /// `h = ∂g/∂x / |∂g/∂u|`; the first `state` entries are used.
    pub row: [f64; MAX_STATE],
    /// `n = ∂g/∂u / |∂g/∂u|`; the first `noise` entries are used.
    pub normal: [f64; MAX_NOISE],
    /// `|∂g/∂u|`.
    pub slope: f64,
}

impl Normalized {
    pub(crate) fn new() -> Self {
        Self { distance: 0.0, row: [0.0; MAX_STATE], normal: [0.0; MAX_NOISE], slope: 1.0 }
    }

    /// Linearises at `(x, u)`; the distance is measured from `origin`. Returns false where the equation is
    /// not defined.
    pub(crate) fn at<R: ImplicitReading + ?Sized>(
        &mut self,
        reading: &R,
        branch: usize,
        x: &[f64],
        u: &[f64],
        origin: &[f64],
    ) -> bool {
        let (n, p) = (x.len(), u.len());
        let g = reading.gradient(branch, x, u, &mut self.row[..n], &mut self.normal[..p]);
        let mut square = reading.second_order_variance(branch, x, u);
        for value in &self.normal[..p] {
            square += value * value;
        }
        self.slope = square.sqrt();
        if !(g.is_finite() && self.slope > 0.0 && self.slope.is_finite()) {
            return false;
        }
        let scale = 1.0 / self.slope;
        let mut distance = -g * scale;
        for value in &mut self.row[..n] {
            *value *= scale;
        }
        for k in 0..p {
            self.normal[k] *= scale;
            distance += self.normal[k] * (u[k] - origin[k]);
        }
        self.distance = distance;
        distance.is_finite()
    }
}

/// Moves `u` to the smallest noise that explains the reading at `x`: the foot point of `origin` on
/// `g(z − L u, x) = 0`.
///
/// On return `at` is the linearisation there and `at.distance` the signed distance. Fixed point:
/// `u = origin + n s`. It converges fast for distances below the radius of curvature; beyond, steps are
/// shortened until they descend. Returns false where the equation is not defined or the iteration does not
/// converge. Cost: three or four gradients, dozens beyond the radius of curvature.
pub fn signed_distance<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    origin: &[f64],
    u: &mut [f64],
    at: &mut Normalized,
) -> bool {
    let p = u.len();
    let mut previous = f64::INFINITY;
    // Fraction of the step that is taken.
    let mut share = 1.0_f64;
    for _ in 0..60 {
        if !at.at(reading, branch, x, u, origin) {
            return false;
        }
        let mut moved = 0.0_f64;
        let mut step = [0.0; MAX_NOISE];
        for k in 0..p {
            step[k] = origin[k] + at.normal[k] * at.distance - u[k];
            moved = moved.max(step[k].abs());
        }
        // Far from the origin, rounding of the reading limits how small a step can get. Steps that no longer
        // shrink have reached that limit.
        if moved <= 1e-7 * (1.0 + at.distance.abs()) || (moved >= previous && moved <= 1e-5) {
            return true;
        }
        // Steps contract by the distance times the curvature. Near a factor of 1 they may oscillate, which
        // shorter steps damp.
        if moved > 0.7 * previous {
            share = (0.5 * share).max(0.05);
        }
        for k in 0..p {
            u[k] += share * step[k];
        }
        previous = moved;
    }
    if previous <= 1e-4 * (1.0 + at.distance.abs()) {
        return true;
    }
    let is_close = previous <= 1e-2 * (1.0 + at.distance.abs());
    let begun: [f64; MAX_NOISE] = std::array::from_fn(|k| u.get(k).copied().unwrap_or(0.0));
    if descend(reading, branch, x, origin, u, at) {
        return true;
    }
    // A nearly converged foot point is accurate enough for a robust weight; any other is rejected.
    u.copy_from_slice(&begun[..p]);
    is_close && at.at(reading, branch, x, u, origin)
}

/// [`signed_distance`] beyond the radius of curvature, where its fixed point is repelling.
///
/// Finds the nearest point of the equation by Newton steps along it: `(I − s B) t = −P (u − o)`, with the
/// second fundamental form `B`. The matrix is made positive definite if necessary. Each step is followed by a
/// projection onto the equation, and halved until `u` gets closer to the origin (Absil, Mahony and Sepulchre
/// 2008, *Optimization Algorithms on Matrix Manifolds*, chapter 6).
fn descend<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    origin: &[f64],
    u: &mut [f64],
    at: &mut Normalized,
) -> bool {
    /// Minimum decrease relative to the linear prediction (Armijo 1966).
    const DECREASE: f64 = 0.1;
    /// Maximum number of halvings of a step.
    const HALVINGS: i32 = 12;
    let p = u.len();
    // Start at the origin: the iterate that failed to converge can be anywhere.
    u.copy_from_slice(origin);
    if !onto_equation(reading, branch, x, origin, u, at) {
        return false;
    }
    // Every accepted step shortens `|u − o|²` on the equation, so the iteration cannot cycle.
    let squared = |u: &[f64]| (0..p).map(|k| (u[k] - origin[k]).powi(2)).sum::<f64>();
    for _ in 0..40 {
        let (step, slope) = tangent_step(reading, branch, x, u, origin, at);
        let moved = step.amax();
        let converged = 1e-6 * (1.0 + at.distance.abs());
        if moved <= converged {
            return true;
        }
        let before = squared(u);
        let mut begun = [0.0; MAX_NOISE];
        begun[..p].copy_from_slice(u);
        let nearer = (0..HALVINGS).map(|halving| 0.5_f64.powi(halving)).any(|share| {
            for k in 0..p {
                u[k] = begun[k] + share * step[k];
            }
            onto_equation(reading, branch, x, origin, u, at)
                && squared(u) <= before + DECREASE * share * slope
        });
        if !nearer {
            u.copy_from_slice(&begun[..p]);
            return at.at(reading, branch, x, u, origin) && moved <= 1e-2 * (1.0 + at.distance.abs());
        }
    }
    false
}

/// Moves `u` along the gradient onto the equation and linearises there. Each step is halved until it reduces
/// `|g|`. Returns false if this fails.
fn onto_equation<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    origin: &[f64],
    u: &mut [f64],
    at: &mut Normalized,
) -> bool {
    let p = u.len();
    // This is −g/|∂g/∂u|. Times the slope it is −g, whose size may be compared between points of different
    // slope.
    let off = |at: &Normalized, u: &[f64]| {
        let along: f64 = (0..p).map(|k| at.normal[k] * (u[k] - origin[k])).sum();
        at.distance - along
    };
    if !at.at(reading, branch, x, u, origin) {
        return false;
    }
    for _ in 0..60 {
        let (way, current) = (off(at, u), *at);
        if way.abs() <= 1e-9 * (1.0 + at.distance.abs()) {
            return true;
        }
        let mut begun = [0.0; MAX_NOISE];
        begun[..p].copy_from_slice(u);
        let nearer = (0..10).map(|halving| 0.5_f64.powi(halving)).any(|share| {
            for k in 0..p {
                u[k] = begun[k] + share * way * current.normal[k];
            }
            at.at(reading, branch, x, u, origin)
                && off(at, u).abs() * at.slope < (1.0 - 0.1 * share) * way.abs() * current.slope
        });
        if !nearer {
            return false;
        }
    }
    false
}

/// The step of [`descend`] from `u` and the derivative of `|u − o|²` along it; `at` is the linearisation at
/// `u`.
fn tangent_step<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    u: &[f64],
    origin: &[f64],
    at: &Normalized,
) -> (DVector<f64>, f64) {
    let p = u.len();
    let off = DVector::from_fn(p, |k, _| u[k] - origin[k]);
    let tangent = DVector::from_fn(p, |k, _| at.normal[k] * at.distance - off[k]);
    let form = bias::second_form(reading, branch, x, u, at);
    let bend = DMatrix::from_fn(p, p, |i, j| at.distance * form[i][j]);
    // The matrix is indefinite on a ridge between two foot points. Adding the norm of the form makes it
    // positive definite.
    let norm = bend.norm();
    // The smallest addition that works keeps the step close to Newton's. With the last one the factor always
    // exists.
    let solved = [0.0, 0.1, 0.3, 1.0].into_iter().find_map(|share| {
        let raised = DMatrix::identity(p, p) * (1.0 + share * norm) - &bend;
        Some(raised.cholesky()?.solve(&tangent))
    });
    let step = solved.unwrap_or_else(|| tangent.clone());
    let slope = -2.0 * tangent.dot(&step);
    (step, slope)
}

/// The most likely branch of a reading: the minimum of `s² + penalty` at the first-order foot point, with the
/// penalty of [`ImplicitReading::beyond_end_penalty`].
pub fn best_branch<R: ImplicitReading + ?Sized>(reading: &R, x: &[f64]) -> usize {
    let count = reading.branches();
    if count <= 1 {
        return 0;
    }
    if let Some(branch) = reading.nearest_branch(x) {
        return branch;
    }
    let p = reading.noise();
    let origin = [0.0; MAX_NOISE];
    let mut at = Normalized::new();
    let mut best = (f64::INFINITY, 0);
    for branch in 0..count {
        if !at.at(reading, branch, x, &origin[..p], &origin[..p]) {
            continue;
        }
        let mut cost = at.distance * at.distance;
        // Penalties are not negative, so this branch has lost already and its penalty need not be computed.
        if cost >= best.0 {
            continue;
        }
        let mut foot = [0.0; MAX_NOISE];
        for k in 0..p {
            foot[k] = at.normal[k] * at.distance;
        }
        cost += reading.beyond_end_penalty(branch, x, &foot[..p]);
        if cost < best.0 {
            best = (cost, branch);
        }
    }
    best.1
}

#[cfg(test)]
mod tests;
