//! Readings of one implicit equation each: `g(z − L u, x) = 0` with whitened noise `u ~ N(0, I)`.
//!
//! Input: readings of a curve or surface, whose places on it are unknown. Output: their signed distances to
//! it in standard deviations, filters that take them one at a time, a batch, the bias of both and the bound
//! for both. Not guaranteed: the global optimum, nor anything where noise is larger than the radius of
//! curvature.
//!
//! This is [`MeasurementEquation`](crate::MeasurementEquation) for the frequent case of a single equation a
//! reading, without allocation: `v = L u` with `R = L Lᵀ`. All readings of a batch that share noise (a sweep
//! from one pose) have it as unknowns behind the state, with a unit prior: [`SharedNoise`].
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

/// Most whitened noise components of a reading: a ray in space has seven.
pub const MOST_NOISE: usize = 8;
/// Most unknowns of a state, shared noise included.
pub const MOST_STATE: usize = 96;

/// A reading with one equation, `g(z − L u, x) = 0`, in whitened noise `u`.
///
/// The equation may have branches (the facets of a polygon); each is smooth. Laws: `gradient` fills `∂g/∂x`
/// and `∂g/∂u` of the branch; no call keeps anything from an earlier one. A point where `g` is not defined is
/// told by NaN.
pub trait ImplicitReading {
    /// Components of the state, shared noise included; at most [`MOST_STATE`].
    fn state(&self) -> usize;

    /// Components of the whitened noise; at most [`MOST_NOISE`].
    fn noise(&self) -> usize;

    /// `g`, with `∂g/∂x` and `∂g/∂u` of a branch. The slices have the lengths of `x` and `u` and unspecified
    /// contents.
    fn gradient(
        &self,
        branch: usize,
        x: &[f64],
        u: &[f64],
        by_state: &mut [f64],
        by_noise: &mut [f64],
    ) -> f64;

    /// How many branches there are.
    fn branches(&self) -> usize {
        1
    }

    /// What it costs, as a squared number of standard deviations, that the corrected reading `z − L u` lies
    /// beyond the ends of the branch.
    fn overrun(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        let _ = (branch, x, u);
        0.0
    }

    /// The branch that explains the reading best at no noise, where a reading knows a shorter way to it than
    /// [`best_branch`].
    fn nearest_branch(&self, x: &[f64]) -> Option<usize> {
        let _ = x;
        None
    }

    /// How many standard deviations the corrected reading `z − L u` lies within the ends of the branch, where
    /// it meets another at an angle: less than none beyond them, infinitely many where nothing ends.
    fn margin(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        let _ = (branch, x, u);
        f64::INFINITY
    }

    /// Fills `∂²g/∂u²` of a branch, or returns false: it is then taken by differences of the gradient.
    fn noise_hessian(&self, branch: usize, x: &[f64], u: &[f64], hessian: &mut NoiseHessian) -> bool {
        let _ = (branch, x, u, hessian);
        false
    }

    /// Variance of `g` beyond `|∂g/∂u|²`, where its second derivatives matter: what bounds the weight of a
    /// product of facets at a corner, whose gradient vanishes there.
    fn second_order_variance(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        let _ = (branch, x, u);
        0.0
    }
}

/// An equation made linear and divided by its standard deviation: `n·u = s − h (x − x0)` with `|n| = 1`.
#[derive(Debug, Clone, Copy)]
pub struct Normalized {
    /// `s`: the signed distance from the origin of the noise to the linearised equation, in standard
    /// deviations.
    pub distance: f64,
    /// `h = ∂g/∂x / |∂g/∂u|`; the first `state` are used.
    pub row: [f64; MOST_STATE],
    /// `n = ∂g/∂u / |∂g/∂u|`; the first `noise` are used.
    pub normal: [f64; MOST_NOISE],
    /// `|∂g/∂u|`.
    pub slope: f64,
}

impl Normalized {
    pub(crate) fn new() -> Self {
        Self { distance: 0.0, row: [0.0; MOST_STATE], normal: [0.0; MOST_NOISE], slope: 1.0 }
    }

    /// Linearises at `(x, u)`; the distance is from `origin`. False where the equation is not defined.
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

/// Moves `u` to the nearest noise that explains the reading at `x`: the foot of `origin` on
/// `g(z − L u, x) = 0`.
///
/// On return `at` is the linearisation there and `at.distance` the signed distance. Fixed point:
/// `u = origin + n s`. Converges at once for distances below the radius of curvature; beyond, steps are
/// shortened until they descend. False where the equation is not defined or does not settle. Cost: three or
/// four gradients, some dozens beyond the radius of curvature.
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
    let mut share = 1.0_f64;
    for _ in 0..60 {
        if !at.at(reading, branch, x, u, origin) {
            return false;
        }
        let mut moved = 0.0_f64;
        let mut step = [0.0; MOST_NOISE];
        for k in 0..p {
            step[k] = origin[k] + at.normal[k] * at.distance - u[k];
            moved = moved.max(step[k].abs());
        }
        if moved <= 1e-7 * (1.0 + at.distance.abs()) || (moved >= previous && moved <= 1e-5) {
            return true;
        }
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
    let is_near = previous <= 1e-2 * (1.0 + at.distance.abs());
    let begun: [f64; MOST_NOISE] = std::array::from_fn(|k| u.get(k).copied().unwrap_or(0.0));
    if descend(reading, branch, x, origin, u, at) {
        return true;
    }
    // What has not settled but is nearly there is good enough for a weight; what is not, is not.
    u.copy_from_slice(&begun[..p]);
    is_near && at.at(reading, branch, x, u, origin)
}

/// [`signed_distance`] beyond the radius of curvature, where its fixed point repels: the nearest place on the
/// equation by Newton's steps along it, `(I − s B) t = −P (u − o)` with the form `B` of second derivatives
/// (made definite where it is not), each followed by the way back onto the equation and as long as it brings
/// `u` nearer to the origin (Absil, Mahony and Sepulchre 2008, *Optimization Algorithms on Matrix Manifolds*,
/// chapter 6).
fn descend<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    origin: &[f64],
    u: &mut [f64],
    at: &mut Normalized,
) -> bool {
    /// Of the least decrease, over what the slope promises (Armijo 1966).
    const DECREASE: f64 = 0.1;
    /// A step is halved so many times.
    const HALVINGS: i32 = 12;
    let p = u.len();
    u.copy_from_slice(origin);
    if !onto_equation(reading, branch, x, origin, u, at) {
        return false;
    }
    let squared = |u: &[f64]| (0..p).map(|k| (u[k] - origin[k]).powi(2)).sum::<f64>();
    for _ in 0..40 {
        let (step, slope) = tangent_step(reading, branch, x, u, origin, at);
        let moved = step.amax();
        let settled = 1e-6 * (1.0 + at.distance.abs());
        if moved <= settled {
            return true;
        }
        let before = squared(u);
        let mut begun = [0.0; MOST_NOISE];
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

/// Moves `u` along the gradients until it fulfils the equation, each step as long as it lessens `|g|`, and
/// linearises there. False where it does not get there.
fn onto_equation<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    origin: &[f64],
    u: &mut [f64],
    at: &mut Normalized,
) -> bool {
    let p = u.len();
    let off = |at: &Normalized, u: &[f64]| {
        let along: f64 = (0..p).map(|k| at.normal[k] * (u[k] - origin[k])).sum();
        at.distance - along
    };
    if !at.at(reading, branch, x, u, origin) {
        return false;
    }
    for _ in 0..60 {
        let (way, here) = (off(at, u), *at);
        if way.abs() <= 1e-9 * (1.0 + at.distance.abs()) {
            return true;
        }
        let mut begun = [0.0; MOST_NOISE];
        begun[..p].copy_from_slice(u);
        let nearer = (0..10).map(|halving| 0.5_f64.powi(halving)).any(|share| {
            for k in 0..p {
                u[k] = begun[k] + share * way * here.normal[k];
            }
            at.at(reading, branch, x, u, origin)
                && off(at, u).abs() * at.slope < (1.0 - 0.1 * share) * way.abs() * here.slope
        });
        if !nearer {
            return false;
        }
    }
    false
}

/// The step of [`descend`] from `u`, where `at` is the linearisation, and the derivative of `|u − o|²` along
/// it.
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
    // What is not definite is a ridge between two feet: with this much more it surely is.
    let surely = bend.norm();
    let solved = [0.0, 0.1, 0.3, 1.0].into_iter().find_map(|share| {
        let raised = DMatrix::identity(p, p) * (1.0 + share * surely) - &bend;
        Some(raised.cholesky()?.solve(&tangent))
    });
    let step = solved.unwrap_or_else(|| tangent.clone());
    let slope = -2.0 * tangent.dot(&step);
    (step, slope)
}

/// The branch that explains a reading best: least `s² + overrun` at the first-order foot from `u`.
pub fn best_branch<R: ImplicitReading + ?Sized>(reading: &R, x: &[f64]) -> usize {
    let count = reading.branches();
    if count <= 1 {
        return 0;
    }
    if let Some(branch) = reading.nearest_branch(x) {
        return branch;
    }
    let p = reading.noise();
    let origin = [0.0; MOST_NOISE];
    let mut at = Normalized::new();
    let mut best = (f64::INFINITY, 0);
    for branch in 0..count {
        if !at.at(reading, branch, x, &origin[..p], &origin[..p]) {
            continue;
        }
        let mut cost = at.distance * at.distance;
        if cost >= best.0 {
            continue;
        }
        let mut foot = [0.0; MOST_NOISE];
        for k in 0..p {
            foot[k] = at.normal[k] * at.distance;
        }
        cost += reading.overrun(branch, x, &foot[..p]);
        if cost < best.0 {
            best = (cost, branch);
        }
    }
    best.1
}

#[cfg(test)]
mod tests;
