//! A reading of a contour as an implicit equation.

use super::curve::{beyond, distance, distance_hessian, nearest_piece, within};
use super::kind::ContourKind;
use super::soft_constraint::SoftConstraint;
use planish_estimate::implicit::{ImplicitReading, MAX_NOISE, MAX_STATE, NoiseHessian};
use std::f64::consts::FRAC_1_SQRT_2;

/// What a sensor saw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ContourTarget {
    /// A range from a pose: the point is `origin + range (cos heading, sin heading)`.
    Range {
        /// Where the sensor was thought to be.
        origin: [f64; 2],
        /// Where it was thought to look, counter-clockwise from +x.
        heading_rad: f64,
        /// What it read.
        range: f64,
        /// σ of `x`, `y`, the heading (radians) and the range.
        sigma: [f64; 4],
    },
    /// A point, as of an overhead sensor or the edge in a picture.
    Point {
        /// Where it is.
        position: [f64; 2],
        /// σ of both coordinates.
        sigma: f64,
    },
}

/// A reading, with what it shares with others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContourReading {
    /// What was seen.
    pub target: ContourTarget,
    /// Readings of one number were taken from one pose, and share its error; only ranges have one.
    pub pose: Option<usize>,
    /// Seconds, where the thing moves.
    pub time_s: f64,
    /// Line of the file it comes from, or its index.
    pub line: usize,
}

impl ContourReading {
    /// The point that was seen, as measured.
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

    /// Covariance `[xx, xy, yy]` of that point, to first order.
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
    /// The same measurement, carried along so that it is of the point `to`.
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

    /// With an error of so many σ in `x`, `y`, the heading or the range; of a point, heading and range are
    /// `x` and `y` again.
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
            // Two axes, each twice as often: errors of √2 σ rather than √4.
            ContourTarget::Point { position, sigma } => position[axis % 2] += sigmas * *sigma * FRAC_1_SQRT_2,
        }
        made
    }
}

/// How the thing moves while it is measured, about a fixed pivot: the state has its velocity behind the
/// contour, which is that of time zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlanarMotion {
    /// It stands still.
    Still,
    /// `vx vy`, in lengths a second.
    Linear,
    /// `vx vy ω`, ω in radians a second.
    Rigid,
}

impl PlanarMotion {
    /// How many unknowns it adds.
    #[must_use]
    pub fn unknowns(self) -> usize {
        match self {
            Self::Still => 0,
            Self::Linear => 2,
            Self::Rigid => 3,
        }
    }
}

/// How the pieces of a contour become one equation (paper D eq. 2.2 and 2.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// The distance to the piece that explains the reading best.
    ActiveFacet,
    /// The product of the distances to all pieces. Its gradient vanishes at corners: the variance of the
    /// second order bounds the weight there.
    Product,
}

/// What all readings of one fit have in common.
#[derive(Debug, Clone)]
pub(crate) struct ContourModel {
    pub(crate) kind: ContourKind,
    pub(crate) form: Form,
    pub(crate) motion: PlanarMotion,
    /// The fixed pivot of the rotation, and the time of the contour.
    pub(crate) pivot: [f64; 2],
    pub(crate) time_s: f64,
    /// Whether ranges have the error of their pose behind the state, and not in their own noise.
    pub(crate) shared_poses: bool,
    /// What is known of a chain beside the readings: where an open one ends, and which joints are smooth.
    pub(crate) constraints: Vec<SoftConstraint>,
}

impl ContourModel {
    pub(crate) fn unknowns(&self) -> usize {
        self.kind.parameters() + self.motion.unknowns()
    }
}

/// A sighting against a contour, or in its place something known of it.
pub(crate) struct ContourEquation<'a> {
    pub(crate) model: &'a ContourModel,
    pub(crate) sighting: &'a ContourReading,
    pub(crate) constraint: Option<SoftConstraint>,
}

/// A point with its derivatives by noise, and by shared pose errors.
struct Place {
    point: [f64; 2],
    by_noise: [[f64; 2]; 4],
    by_pose: [[f64; 2]; 3],
    /// `∂²p/∂u₂²` and `∂²p/∂u₂∂u₃`, where heading and range are noise.
    by_heading: [[f64; 2]; 2],
}

impl<'a> ContourEquation<'a> {
    /// That of a sighting.
    pub(crate) fn new(model: &'a ContourModel, sighting: &'a ContourReading) -> Self {
        Self { model, sighting, constraint: None }
    }

    fn place(&self, x: &[f64], u: &[f64]) -> Place {
        let mut place = Place {
            point: [0.0; 2],
            by_noise: [[0.0; 2]; 4],
            by_pose: [[0.0; 2]; 3],
            by_heading: [[0.0; 2]; 2],
        };
        match self.sighting.target {
            ContourTarget::Point { position, sigma } => {
                place.point = [position[0] - sigma * u[0], position[1] - sigma * u[1]];
                place.by_noise[0] = [-sigma, 0.0];
                place.by_noise[1] = [0.0, -sigma];
            }
            ContourTarget::Range { origin, heading_rad, range, sigma } => {
                let shared = self.model.shared_poses;
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

    /// Carries a point back to where the thing was at time zero: the point, its rotation (cos, sin), and the
    /// time between.
    fn carried_back(&self, x: &[f64], p: [f64; 2]) -> ([f64; 2], [f64; 2], f64) {
        let k = self.model.kind.parameters();
        let pivot = self.model.pivot;
        let time = self.sighting.time_s - self.model.time_s;
        let moved = match self.model.motion {
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

    /// The point as measured and its covariance `[xx, xy, yy]`, carried back to where the thing was at time
    /// zero.
    pub(crate) fn seen_at_rest(&self, x: &[f64]) -> ([f64; 2], [f64; 3]) {
        let (p, [cos, sin], _) = self.carried_back(x, self.sighting.point());
        let [xx, xy, yy] = self.sighting.covariance();
        let (square, both, product) = (cos * cos, sin * cos, sin * sin);
        let turned = [
            square * xx - 2.0 * both * xy + product * yy,
            both * (xx - yy) + (square - product) * xy,
            product * xx + 2.0 * both * xy + square * yy,
        ];
        (p, turned)
    }

    /// σ along a piece of a point that is held to it: `√(det C / nᵀCn)`.
    fn sigma_along(&self, branch: usize, theta: &[f64], p: [f64; 2], [cos, sin]: [f64; 2]) -> f64 {
        let [xx, xy, yy] = self.sighting.covariance();
        let mut by_theta = [0.0; MAX_STATE];
        let n = distance(&self.model.kind, theta, branch, p, &mut by_theta[..theta.len()]).by_point;
        let normal = [cos * n[0] + sin * n[1], cos * n[1] - sin * n[0]];
        let across =
            normal[0] * normal[0] * xx + 2.0 * normal[0] * normal[1] * xy + normal[1] * normal[1] * yy;
        ((xx * yy - xy * xy).max(f64::MIN_POSITIVE) / across).sqrt()
    }

    /// `g` of a body point with `∂g/∂p`; `∂g/∂θ` into `by_theta`.
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
        match self.sighting.target {
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
            by_noise[0] = constraint.sigma();
            return violation + constraint.sigma() * u[0];
        }
        let place = self.place(x, u);
        let (p, [cos, sin], time) = self.carried_back(x, place.point);
        let (value, by_body) = self.contour(branch, &x[..k], p, &mut by_state[..k]);
        // From the body's frame at time zero to the world.
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
        // Columns in the frame of the body.
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
            // A reading's own noise is along its ray only.
            return None;
        }
        let k = self.model.kind.parameters();
        let (p, covariance) = self.seen_at_rest(x);
        nearest_piece(&self.model.kind, &x[..k], p, covariance)
    }

    fn margin(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        if self.model.form == Form::Product || self.constraint.is_some() {
            return f64::INFINITY;
        }
        let k = self.model.kind.parameters();
        let (p, turn, _) = self.carried_back(x, self.place(x, u).point);
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
        // ½ |g_uu|², the variance of ½ uᵀ g_uu u, by differences of the gradient.
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
