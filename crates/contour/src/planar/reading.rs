//! A reading of a contour as an implicit equation `g(z − v, x) = 0`.
//!
//! In: a [`ContourReading`] and the model of the fit. Out: `g` with derivatives by the state `x` and by the
//! whitened noise `u = v/σ`, as `planish_estimate::implicit` needs them. The equation is the distance of the
//! corrected point to a piece of the contour (paper D eq. 2.7 and 2.10).

use super::curve::{beyond, distance, distance_hessian, nearest_piece, within};
use super::kind::ContourKind;
use super::soft_constraint::SoftConstraint;
use planish_estimate::implicit::{ImplicitReading, MAX_NOISE, MAX_STATE, NoiseHessian};
use std::f64::consts::FRAC_1_SQRT_2;

/// The measured values of a reading with their σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ContourTarget {
    /// A range from an uncertain pose: the point is `origin + range (cos heading, sin heading)`.
    Range {
        /// Measured position of the sensor.
        origin: [f64; 2],
        /// Measured direction of the ray, counter-clockwise from +x.
        heading_rad: f64,
        /// Measured distance along the ray.
        range: f64,
        /// σ of `x`, `y`, the heading (radians) and the range.
        sigma: [f64; 4],
    },
    /// A point, for example of an overhead sensor or of an edge in a picture.
    Point {
        /// Measured coordinates.
        position: [f64; 2],
        /// σ of each coordinate; the errors of both are independent.
        sigma: f64,
    },
}

/// One reading of a contour.
///
/// # Examples
/// ```
/// use planish_contour::planar::{ContourReading, ContourTarget};
///
/// // 5 mm along +y from the origin, with a heading known to 0.01 rad.
/// let target = ContourTarget::Range {
///     origin: [0.0, 0.0],
///     heading_rad: std::f64::consts::FRAC_PI_2,
///     range: 5.0,
///     sigma: [0.0, 0.0, 0.01, 0.1],
/// };
/// let reading = ContourReading { target, pose: None, time_s: 0.0, line: 1 };
/// assert!((reading.point()[1] - 5.0).abs() < 1e-12);
/// // Across the ray σ is the range times that of the heading: 0.05 mm; along it, 0.1 mm.
/// let [xx, _, yy] = reading.covariance();
/// assert!((xx.sqrt() - 0.05).abs() < 1e-12 && (yy.sqrt() - 0.1).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContourReading {
    /// The measured values.
    pub target: ContourTarget,
    /// Number of the pose. Ranges with the same number share the error of that pose; points have none.
    pub pose: Option<usize>,
    /// Time of the reading in seconds; only used if the object moves.
    pub time_s: f64,
    /// Line in the file of origin, or index of the reading.
    pub line: usize,
}

impl ContourReading {
    /// The measured point, without any correction.
    #[must_use]
    pub fn point(&self) -> [f64; 2] {
        match self.target {
            ContourTarget::Range { origin, heading_rad, range, .. } => {
                let (sin, cos) = heading_rad.sin_cos();
                [origin[0] + range * cos, origin[1] + range * sin]
            }
            ContourTarget::Point { position, .. } => position,
        }
    }

    /// Covariance `[xx, xy, yy]` of [`Self::point`] to first order; a shared pose is included.
    #[must_use]
    pub fn covariance(&self) -> [f64; 3] {
        match self.target {
            ContourTarget::Range { heading_rad, range, sigma, .. } => {
                let (sin, cos) = heading_rad.sin_cos();
                let along = sigma[3] * sigma[3];
                let across = (range * sigma[2]).powi(2);
                [
                    sigma[0] * sigma[0] + along * cos * cos + across * sin * sin,
                    (along - across) * sin * cos,
                    sigma[1] * sigma[1] + along * sin * sin + across * cos * cos,
                ]
            }
            ContourTarget::Point { sigma, .. } => [sigma * sigma, 0.0, sigma * sigma],
        }
    }
}

impl ContourReading {
    /// The same reading, shifted so that its measured point is `to`; heading and range do not change.
    pub(super) fn moved_to(&self, to: [f64; 2]) -> Self {
        let from = self.point();
        let mut moved = *self;
        let place = match &mut moved.target {
            ContourTarget::Range { origin, .. } => origin,
            ContourTarget::Point { position, .. } => position,
        };
        for k in 0..2 {
            place[k] += to[k] - from[k];
        }
        moved
    }

    /// Adds an error of `sigmas` σ to one measured value: 0 and 1 are `x` and `y`, 2 the heading, 3 the
    /// range.
    ///
    /// A point has only two values; axes 2 and 3 are `x` and `y` again.
    pub(super) fn with_error(&self, axis: usize, sigmas: f64) -> Self {
        let mut made = *self;
        match &mut made.target {
            ContourTarget::Range { origin, heading_rad, range, sigma } => {
                let by = sigmas * sigma[axis];
                match axis {
                    0 | 1 => origin[axis] += by,
                    2 => *heading_rad += by,
                    _ => *range += by,
                }
            }
            // Callers sum the effects of all four axes. A point's two axes are then counted twice: each error
            // is divided by √2, so that the sum of squares stays that of one σ per axis.
            ContourTarget::Point { position, sigma } => position[axis % 2] += sigmas * *sigma * FRAC_1_SQRT_2,
        }
        made
    }
}

/// Motion of the object during the measurement, about a fixed pivot.
///
/// The state holds the contour at the reference time, followed by the velocities listed here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlanarMotion {
    /// The object does not move.
    Still,
    /// Translation: `vx vy`, in units of length per second.
    Linear,
    /// Translation and rotation: `vx vy ω`, with ω in radians per second.
    Rigid,
}

impl PlanarMotion {
    /// Number of unknowns that the motion adds to the state.
    #[must_use]
    pub fn unknowns(self) -> usize {
        match self {
            Self::Still => 0,
            Self::Linear => 2,
            Self::Rigid => 3,
        }
    }
}

/// How the pieces of a contour are combined into one equation (Weiss-Cohen et al. 2009, eq. 2.2 and 2.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// The distance to the piece that best explains the reading.
    ActiveFacet,
    /// The product of the distances to all pieces.
    ///
    /// Its gradient vanishes at corners, where the weight of a reading would be unbounded; the variance of
    /// the second-order term is added to bound it.
    Product,
}

/// Settings that all equations of one fit share.
#[derive(Debug, Clone)]
pub(crate) struct ContourModel {
    pub(crate) kind: ContourKind,
    pub(crate) form: Form,
    pub(crate) motion: PlanarMotion,
    /// Fixed centre of rotation. It is chosen near the readings, so that rotation and translation are hardly
    /// correlated.
    pub(crate) pivot: [f64; 2],
    /// Reference time, at which the contour has its parameters.
    pub(crate) time_s: f64,
    /// True if the three errors of a pose are unknowns behind the state instead of noise of each range.
    pub(crate) shared_poses: bool,
    /// Soft constraints of a chain: positions of open ends and smooth joints.
    pub(crate) constraints: Vec<SoftConstraint>,
}

impl ContourModel {
    pub(crate) fn unknowns(&self) -> usize {
        self.kind.parameters() + self.motion.unknowns()
    }
}

/// The equation of one reading, or of one soft constraint in its place.
pub(crate) struct ContourEquation<'a> {
    pub(crate) model: &'a ContourModel,
    pub(crate) reading: &'a ContourReading,
    pub(crate) constraint: Option<SoftConstraint>,
}

/// A corrected point with its derivatives by the noise and by the errors of a shared pose.
struct Place {
    point: [f64; 2],
    by_noise: [[f64; 2]; 4],
    by_pose: [[f64; 2]; 3],
    /// `∂²p/∂u₂²` and `∂²p/∂u₂∂u₃`: heading and range are the only noises in which the point is not linear.
    by_heading: [[f64; 2]; 2],
}

impl<'a> ContourEquation<'a> {
    /// The equation of a reading.
    pub(crate) fn new(model: &'a ContourModel, reading: &'a ContourReading) -> Self {
        Self { model, reading, constraint: None }
    }

    /// The point `z − v` of whitened noise `u`, in the world at the time of the reading.
    fn place(&self, x: &[f64], u: &[f64]) -> Place {
        let mut place = Place {
            point: [0.0; 2],
            by_noise: [[0.0; 2]; 4],
            by_pose: [[0.0; 2]; 3],
            by_heading: [[0.0; 2]; 2],
        };
        match self.reading.target {
            ContourTarget::Point { position, sigma } => {
                place.point = [position[0] - sigma * u[0], position[1] - sigma * u[1]];
                place.by_noise[0] = [-sigma, 0.0];
                place.by_noise[1] = [0.0, -sigma];
            }
            ContourTarget::Range { origin, heading_rad, range, sigma } => {
                let shared = self.model.shared_poses;
                // Readings of one sweep share the three errors of its pose. As noise they would be correlated
                // between equations, so they become unknowns of unit variance at the end of the state.
                let (pose, own) = if shared { (&x[x.len() - 3..], u[0]) } else { (&u[..3], u[3]) };
                let (sin, cos) = (heading_rad - sigma[2] * pose[2]).sin_cos();
                let length = range - sigma[3] * own;
                place.point = [
                    origin[0] - sigma[0] * pose[0] + length * cos,
                    origin[1] - sigma[1] * pose[1] + length * sin,
                ];
                let by_pose =
                    [[-sigma[0], 0.0], [0.0, -sigma[1]], [sigma[2] * length * sin, -sigma[2] * length * cos]];
                let by_own = [-sigma[3] * cos, -sigma[3] * sin];
                if shared {
                    place.by_pose = by_pose;
                    place.by_noise[0] = by_own;
                } else {
                    place.by_noise[..3].copy_from_slice(&by_pose);
                    place.by_noise[3] = by_own;
                    let (square, product) = (sigma[2] * sigma[2], sigma[2] * sigma[3]);
                    place.by_heading =
                        [[-square * length * cos, -square * length * sin], [-product * sin, product * cos]];
                }
            }
        }
        place
    }

    /// Carries a point back to the reference time with the motion in `x`.
    ///
    /// Returns the point, the cosine and sine of the rotation applied, and the time since the reference time.
    fn carried_back(&self, x: &[f64], p: [f64; 2]) -> ([f64; 2], [f64; 2], f64) {
        let k = self.model.kind.parameters();
        let pivot = self.model.pivot;
        let time = self.reading.time_s - self.model.time_s;
        let moved = match self.model.motion {
            // Time zero: the derivatives by the motion then vanish without a case of their own.
            PlanarMotion::Still => return (p, [1.0, 0.0], 0.0),
            _ => [p[0] - pivot[0] - time * x[k], p[1] - pivot[1] - time * x[k + 1]],
        };
        let (sin, cos) = match self.model.motion {
            PlanarMotion::Rigid => (-time * x[k + 2]).sin_cos(),
            _ => (0.0, 1.0),
        };
        (
            [pivot[0] + cos * moved[0] - sin * moved[1], pivot[1] + sin * moved[0] + cos * moved[1]],
            [cos, sin],
            time,
        )
    }

    /// The measured point and its covariance `[xx, xy, yy]`, carried back to the reference time.
    pub(crate) fn point_at_reference_time(&self, x: &[f64]) -> ([f64; 2], [f64; 3]) {
        let (p, [cos, sin], _) = self.carried_back(x, self.reading.point());
        let [xx, xy, yy] = self.reading.covariance();
        // R C Rᵀ, written out.
        let (square, both, product) = (cos * cos, sin * cos, sin * sin);
        let turned = [
            square * xx - 2.0 * both * xy + product * yy,
            both * (xx - yy) + (square - product) * xy,
            product * xx + 2.0 * both * xy + square * yy,
        ];
        (p, turned)
    }

    /// σ of the corrected point along a piece: `√(det C / nᵀCn)`, the covariance conditioned on lying on it.
    fn sigma_along(&self, branch: usize, theta: &[f64], p: [f64; 2], [cos, sin]: [f64; 2]) -> f64 {
        let [xx, xy, yy] = self.reading.covariance();
        let mut by_theta = [0.0; MAX_STATE];
        let n = distance(&self.model.kind, theta, branch, p, &mut by_theta[..theta.len()]).by_point;
        let normal = [cos * n[0] + sin * n[1], cos * n[1] - sin * n[0]];
        let across =
            normal[0] * normal[0] * xx + 2.0 * normal[0] * normal[1] * xy + normal[1] * normal[1] * yy;
        ((xx * yy - xy * xy).max(f64::MIN_POSITIVE) / across).sqrt()
    }

    /// `g` of a point in the frame of the contour, with `∂g/∂p`; fills `by_theta` with `∂g/∂θ`.
    fn contour(&self, branch: usize, theta: &[f64], p: [f64; 2], by_theta: &mut [f64]) -> (f64, [f64; 2]) {
        let kind = &self.model.kind;
        if self.model.form == Form::ActiveFacet || kind.pieces() == 1 {
            let at = distance(kind, theta, branch, p, by_theta);
            return (at.value, at.by_point);
        }
        let mut values = [0.0; MAX_STATE];
        let mut slopes = [[0.0; 2]; MAX_STATE];
        let mut piece_theta = [0.0; MAX_STATE];
        let count = kind.pieces().min(MAX_STATE);
        let k = theta.len();
        for (i, (value, slope)) in values.iter_mut().zip(&mut slopes).take(count).enumerate() {
            let at = distance(kind, theta, i, p, &mut piece_theta[..k]);
            (*value, *slope) = (at.value, at.by_point);
        }
        // Product rule. The products of the other factors are formed anew each time: dividing the whole
        // product by one factor fails on the contour, where that factor is zero.
        by_theta.fill(0.0);
        let (mut product, mut by_point) = (1.0, [0.0; 2]);
        for i in 0..count {
            product *= values[i];
            let others: f64 = (0..count).filter(|&j| j != i).map(|j| values[j]).product();
            distance(kind, theta, i, p, &mut piece_theta[..k]);
            for (out, value) in by_theta.iter_mut().zip(&piece_theta[..k]) {
                *out += others * value;
            }
            by_point[0] += others * slopes[i][0];
            by_point[1] += others * slopes[i][1];
        }
        (product, by_point)
    }
}

impl ImplicitReading for ContourEquation<'_> {
    fn state(&self) -> usize {
        self.model.unknowns() + if self.model.shared_poses { 3 } else { 0 }
    }

    fn noise(&self) -> usize {
        if self.constraint.is_some() {
            return 1;
        }
        match self.reading.target {
            ContourTarget::Point { .. } => 2,
            ContourTarget::Range { .. } if self.model.shared_poses => 1,
            ContourTarget::Range { .. } => 4,
        }
    }

    fn branches(&self) -> usize {
        if self.constraint.is_some() {
            return 1;
        }
        match self.model.form {
            Form::ActiveFacet => self.model.kind.pieces(),
            Form::Product => 1,
        }
    }

    fn gradient(
        &self,
        branch: usize,
        x: &[f64],
        u: &[f64],
        by_state: &mut [f64],
        by_noise: &mut [f64],
    ) -> f64 {
        let k = self.model.kind.parameters();
        by_state.fill(0.0);
        if let Some(constraint) = self.constraint {
            let violation = constraint.violation(&self.model.kind, &x[..k], &mut by_state[..k]);
            // g = violation + σ u, so that the whitened noise of the constraint has unit variance as well.
            by_noise[0] = constraint.sigma();
            return violation + constraint.sigma() * u[0];
        }
        // Chain rule: noise → point in the world → point in the frame of the contour → distance.
        let place = self.place(x, u);
        let (p, [cos, sin], time) = self.carried_back(x, place.point);
        let (value, by_body) = self.contour(branch, &x[..k], p, &mut by_state[..k]);
        // From the frame of the contour at the reference time to the world at the time of the reading.
        let by_point = [cos * by_body[0] + sin * by_body[1], cos * by_body[1] - sin * by_body[0]];
        let dot = |d: [f64; 2]| by_point[0] * d[0] + by_point[1] * d[1];
        if self.model.motion != PlanarMotion::Still {
            by_state[k] = -time * by_point[0];
            by_state[k + 1] = -time * by_point[1];
        }
        if self.model.motion == PlanarMotion::Rigid {
            let arm = [p[0] - self.model.pivot[0], p[1] - self.model.pivot[1]];
            by_state[k + 2] = -time * (by_body[1] * arm[0] - by_body[0] * arm[1]);
        }
        for (out, column) in by_noise.iter_mut().zip(place.by_noise) {
            *out = dot(column);
        }
        if self.model.shared_poses {
            let first = x.len() - 3;
            for (j, column) in place.by_pose.into_iter().enumerate() {
                by_state[first + j] = dot(column);
            }
        }
        value
    }

    fn noise_hessian(&self, branch: usize, x: &[f64], u: &[f64], hessian: &mut NoiseHessian) -> bool {
        if self.constraint.is_some() {
            hessian[0][0] = 0.0;
            return true;
        }
        if self.model.form == Form::Product && self.model.kind.pieces() > 1 {
            return false;
        }
        let theta = &x[..self.model.kind.parameters()];
        let place = self.place(x, u);
        let (p, [cos, sin], _) = self.carried_back(x, place.point);
        let [xx, xy, yy] = distance_hessian(&self.model.kind, theta, branch, p);
        let count = self.noise();
        // The Hessian of the distance is in the frame of the contour; the motion rotates the noise into it.
        let mut columns = [[0.0; 2]; 4];
        for (column, by_noise) in columns.iter_mut().zip(&place.by_noise).take(count) {
            *column = [cos * by_noise[0] - sin * by_noise[1], sin * by_noise[0] + cos * by_noise[1]];
        }
        for i in 0..count {
            let [a, b] = columns[i];
            let image = [xx * a + xy * b, xy * a + yy * b];
            for j in 0..=i {
                let value = image[0] * columns[j][0] + image[1] * columns[j][1];
                hessian[i][j] = value;
                hessian[j][i] = value;
            }
        }
        // A point of a range is not linear in heading and range: add the gradient times its second
        // derivatives.
        if count == 4 {
            let mut by_theta = [0.0; MAX_STATE];
            let n = distance(&self.model.kind, theta, branch, p, &mut by_theta[..theta.len()]).by_point;
            let normal = [cos * n[0] + sin * n[1], cos * n[1] - sin * n[0]];
            let [turned, stretched] = place.by_heading.map(|d| normal[0] * d[0] + normal[1] * d[1]);
            hessian[2][2] += turned;
            hessian[2][3] += stretched;
            hessian[3][2] += stretched;
        }
        true
    }

    fn beyond_end_penalty(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        if self.constraint.is_some() {
            return 0.0;
        }
        let k = self.model.kind.parameters();
        let (p, [cos, sin], _) = self.carried_back(x, self.place(x, u).point);
        let length = beyond(&self.model.kind, &x[..k], branch, p);
        if length <= 0.0 {
            return 0.0;
        }
        let sigma = self.sigma_along(branch, &x[..k], p, [cos, sin]);
        (length / sigma).powi(2)
    }

    fn nearest_branch(&self, x: &[f64]) -> Option<usize> {
        if self.constraint.is_some() {
            return Some(0);
        }
        if self.model.shared_poses {
            // The only noise of the reading acts along its ray, so its covariance is singular and the search
            // for the nearest piece does not apply; the estimator compares all branches instead.
            return None;
        }
        let k = self.model.kind.parameters();
        let (p, covariance) = self.point_at_reference_time(x);
        nearest_piece(&self.model.kind, &x[..k], p, covariance)
    }

    fn margin(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        if self.model.form == Form::Product || self.constraint.is_some() {
            return f64::INFINITY;
        }
        let k = self.model.kind.parameters();
        let (p, turn, _) = self.carried_back(x, self.place(x, u).point);
        // In σ along the piece: this is independent of the distance across it, so selecting readings by it
        // causes no bias.
        let length = within(&self.model.kind, &x[..k], branch, p);
        if length.is_infinite() {
            return length;
        }
        length / self.sigma_along(branch, &x[..k], p, turn)
    }

    fn second_order_variance(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        if self.model.form == Form::ActiveFacet || self.model.kind.pieces() == 1 || self.constraint.is_some()
        {
            return 0.0;
        }
        // The variance of ½ uᵀ g_uu u is ½ |g_uu|² (Frobenius norm) for standard normal u. Central
        // differences of the gradient replace the second derivatives of a product of up to dozens of factors.
        let (n, p) = (x.len(), u.len());
        let mut by_state = [0.0; MAX_STATE];
        let mut place = [0.0; MAX_NOISE];
        place[..p].copy_from_slice(u);
        let spacing = 0.05;
        let mut sum = 0.0;
        for j in 0..p {
            let mut sides = [[0.0; MAX_NOISE]; 2];
            for (side, sign) in sides.iter_mut().zip([1.0, -1.0]) {
                place[j] = u[j] + sign * spacing;
                self.gradient(branch, x, &place[..p], &mut by_state[..n], &mut side[..p]);
            }
            place[j] = u[j];
            for i in 0..p {
                sum += ((sides[0][i] - sides[1][i]) / (2.0 * spacing)).powi(2);
            }
        }
        0.5 * sum
    }
}
