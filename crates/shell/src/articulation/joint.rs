//! Joints of parts whose motion, place and width are estimated together.
//!
//! In: a pose in which a part turned, and points. Out: the same part with a better motion and joint.
//!
//! A part turns about its joint by a rigid motion `exp(ξ)` relative to the rest, and positions in the joint
//! by the share `w` of it:
//!
//! `x ↦ M exp(w ξ) x`, `w = s(½ + (f(x) + gᵀ(x − c) − a)/b)`, `s(u) = 3u² − 2u³`
//!
//! with the rigid motion `M` of the rest, the function `f` of the part, its level `a`, the width `b` of the
//! joint and a tilt `g` of its level sets. All 17 numbers are estimated by iterated closest points (point to
//! plane), with weights that become narrower.
//!
//! Source of `exp`: J. Solà, J. Deray, D. Atchuthan, *A micro Lie theory for state estimation in robotics*,
//! 2018, eq. 172 to 174.
//!
//! Not guaranteed: the global optimum. From turns that are wrong by 4° and joints that are wrong by a quarter
//! of their width, all tests converge; from 12°, half of them.

use super::misfit::{JointSamples, Targets, agreement};
use super::motion::{RigidMotion, smooth_step};
use super::parts::Cut;
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};
use planish_core::DVec3;

/// Number of unknowns.
const UNKNOWNS: usize = 17;
/// Number of iterations.
const ITERATIONS: usize = 30;
/// Length `τ` of weights in the first iteration, the share that each leaves, and the minimum, as shares of
/// the diagonal.
const REACH: (f64, f64, f64) = (0.06, 0.92, 0.0125);
/// Step of numerical derivatives, for unknowns of the order of one.
const STEP: f64 = 1e-5;
/// Damping of each unknown as a share of the mean information.
const DAMPING: f64 = 1e-3;
/// σ of the logarithm of the width and of the tilt before the points are seen, as if each point had an error
/// of a thousandth of the diagonal and counted as a hundredth.
const PRIOR: [f64; 2] = [0.7, 0.3];
const PRIOR_WEIGHT: f64 = 1e-2;
const PRIOR_SIGMA: f64 = 1e-3;
/// Smallest and largest width of a joint, as shares of the diagonal.
const WIDTHS: (f64, f64) = (0.02, 0.6);

/// A joint between a part and the rest.
#[derive(Debug, Clone, Copy)]
pub(super) struct Joint {
    /// Where the joint is at first.
    pub cut: Cut,
    /// Motion of the rest.
    pub rest: RigidMotion,
    /// Rotation vector of the part relative to the rest.
    turn: Vector3<f64>,
    /// Velocity of `center` for the twist `ξ`.
    shift: Vector3<f64>,
    /// Point that twists refer to.
    center: DVec3,
    /// Change of the level, the logarithm of the factor on the width, and the tilt about `center`.
    level: f64,
    log_width: f64,
    tilt: Vector3<f64>,
}

/// A place before the motion: its position, its position at rest, and the argument of `s` for an unchanged
/// joint times the width.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub at: DVec3,
    pub rest: DVec3,
    /// Signed distance from the middle of the joint.
    pub value: f64,
}

impl Joint {
    /// A joint with the motions of the rest and of the part, whose tilt refers to a centre at rest.
    pub(super) fn new(cut: Cut, [rest, moved]: [RigidMotion; 2], center: DVec3) -> Self {
        let relative = rest.inverse().after(&moved);
        let turn = Rotation3::from_matrix_unchecked(relative.rotation).scaled_axis();
        let by = Vector3::from(relative.applied(center) - center);
        let shift = left_jacobian(&turn).try_inverse().map_or(by, |inverse| inverse * by);
        Self { cut, rest, turn, shift, center, level: 0.0, log_width: 0.0, tilt: Vector3::zeros() }
    }

    /// The same motion and width at another cut.
    pub(super) fn with_cut(&self, cut: Cut) -> Self {
        Self { cut, level: 0.0, tilt: Vector3::zeros(), ..*self }
    }

    /// The weight of the part at a place, for joints of a width.
    pub(super) fn weight(&self, place: &Place, width: f64) -> f64 {
        let tilted = self.tilt.dot(&Vector3::from(place.rest - self.center));
        smooth_step((place.value + tilted - self.level) / (width * self.log_width.exp()) + 0.5)
    }

    /// A position and a normal after the motion, for a weight of the part.
    pub(super) fn applied(&self, at: DVec3, normal: DVec3, weight: f64) -> (DVec3, DVec3) {
        let turn = weight * self.turn;
        let rotation = Rotation3::new(turn);
        let turned = |v: DVec3| DVec3::from(rotation * Vector3::from(v));
        let by = DVec3::from(left_jacobian(&turn) * (weight * self.shift));
        let at = self.center + turned(at - self.center) + by;
        (self.rest.applied(at), DVec3::from(self.rest.rotation * Vector3::from(turned(normal))))
    }

    fn moved(&self, place: &Place, width: f64) -> DVec3 {
        self.applied(place.at, DVec3::Z, self.weight(place, width)).0
    }

    /// The joint after a change of its unknowns, with lengths in `size` and the width kept within limits.
    fn changed(&self, by: &SVector<f64, UNKNOWNS>, size: f64, width: f64) -> Self {
        let three = |k: usize| Vector3::new(by[k], by[k + 1], by[k + 2]);
        let limits = [WIDTHS.0, WIDTHS.1].map(|share| (share * size / width).ln());
        Self {
            rest: self.rest.followed_by(three(0), size * three(3), self.center),
            turn: self.turn + three(6),
            shift: self.shift + size * three(9),
            level: self.level + size * by[12],
            log_width: (self.log_width + by[13]).clamp(limits[0], limits[1]),
            tilt: self.tilt + three(14),
            ..*self
        }
    }
}

/// The joint near a given one that agrees best with the points, after its misfit. `width` is that of joints
/// before.
pub(super) fn refined_joint(
    start: Joint,
    samples: &JointSamples,
    targets: &Targets,
    width: f64,
) -> (f64, Joint) {
    let mut joint = start;
    for k in 0..ITERATIONS {
        let (first, decay, last) = REACH;
        let reach = targets.size() * (first * decay.powi(k as i32)).max(last);
        let Some(step) = step(&joint, samples, targets, (reach, width)) else { break };
        joint = joint.changed(&step, targets.size(), width);
    }
    (targets.joint_misfit(&samples.posed(|place| joint.moved(place, width))), joint)
}

fn step(
    joint: &Joint,
    samples: &JointSamples,
    targets: &Targets,
    (reach, width): (f64, f64),
) -> Option<SVector<f64, UNKNOWNS>> {
    let size = targets.size();
    let mut information = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
    let mut vector = SVector::<f64, UNKNOWNS>::zeros();
    let mut sum = 0.0;
    let changed: Vec<Joint> = (0..UNKNOWNS)
        .map(|k| {
            let mut by = SVector::<f64, UNKNOWNS>::zeros();
            by[k] = STEP;
            joint.changed(&by, size, width)
        })
        .collect();
    let posed = samples.posed(|place| joint.moved(place, width));
    for m in posed.matches(targets.of_joints()) {
        let Some(weight) = agreement(m.distance, m.height, m.cosine, reach) else { continue };
        let (place, normal) = (samples.place(m.sample), posed.normal(m.sample));
        let at = joint.moved(&place, width);
        let row = SVector::<f64, UNKNOWNS>::from_fn(|k, _| {
            (changed[k].moved(&place, width) - at).dot(normal) / STEP
        });
        information += weight * row * row.transpose();
        vector += weight * m.height * row;
        sum += weight;
    }
    let mean = information.trace() / UNKNOWNS as f64;
    let prior = |sigma: f64| sum * PRIOR_WEIGHT * (PRIOR_SIGMA * size / sigma).powi(2);
    let values = [joint.log_width, joint.tilt[0], joint.tilt[1], joint.tilt[2]];
    for (k, value) in values.into_iter().enumerate() {
        let own = prior(PRIOR[usize::from(k > 0)]);
        information[(13 + k, 13 + k)] += own;
        vector[13 + k] -= own * value;
    }
    for k in 0..UNKNOWNS {
        information[(k, k)] += DAMPING * mean;
    }
    information.cholesky().map(|factor| factor.solve(&vector))
}

/// `V` of `exp`: `I + (1 − cos θ)/θ² [ω]ₓ + (θ − sin θ)/θ³ [ω]ₓ²`.
fn left_jacobian(turn: &Vector3<f64>) -> Matrix3<f64> {
    let angle = turn.norm();
    let cross = turn.cross_matrix();
    let (first, second) = match angle > 1e-4 {
        true => ((1.0 - angle.cos()) / angle.powi(2), (angle - angle.sin()) / angle.powi(3)),
        false => (0.5, 1.0 / 6.0),
    };
    Matrix3::identity() + first * cross + second * cross * cross
}
