//! The report of a motion, and the poses that the fit of all scans found.

use super::tracker::{RigidTracker, about_origin, adjoint, exp, log};
use crate::model::ScanPoseReport;
use nalgebra::{Matrix6, Vector6};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_exchange::ScanSet;
use planish_sense::Pose;
use serde::Serialize;

/// Factor by which σ of the tracked poses is enlarged as a prior of the fit of all scans.
///
/// The readings of a scan count in both steps. With a weak prior they count little more than once. See
/// decision 0019.
const PRIOR_SIGMA_FACTOR: f64 = 4.0;
/// This factor once scans were matched to a surface of several scans. The errors of their poses then add up
/// from scan to scan, which their own covariances do not contain: σ of the rate of 200° to 400° would be
/// 0.4 times as large as its errors.
const CHAINED_SIGMA_FACTOR: f64 = 100.0;

/// The motion of an object during scanning.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MotionReport {
    /// Always `rigid`.
    pub kind: String,
    /// Angular velocity about the coordinate axes of the object's frame, in degrees per second.
    pub angular_velocity_deg_per_s: [f64; 3],
    /// σ of each.
    pub sigma_angular_velocity_deg_per_s: [f64; 3],
    /// Velocity of the point `middle`, per second, in the object's frame.
    pub velocity: [f64; 3],
    /// σ of each.
    pub sigma_velocity: [f64; 3],
    /// Magnitude of the angular velocity, in degrees per second, and its σ.
    pub rate_deg_per_s: [f64; 2],
    /// Rates that differ by a multiple of this one, in degrees per second, give the same views. The reported
    /// rate turns the object by less than half a turn between the first two scans.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_period_deg_per_s: Option<f64>,
    /// Angle of the rotation from the first scan to the last, in degrees, with whole turns.
    pub angle_deg: f64,
    /// Speed of the point `middle`, per second, and its σ.
    pub speed: [f64; 2],
    /// The point whose velocity is reported: the middle of the part that the first scan measured.
    pub middle: [f64; 3],
    /// A point of the axis of rotation; none if the object does not turn significantly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis_point: Option<[f64; 3]>,
    /// One pose for each scan, in the order of time.
    pub poses: Vec<MotionPose>,
}

/// The pose of the object at the time of a scan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MotionPose {
    /// Name of the scan.
    pub scan: String,
    /// Time, in seconds.
    pub time_s: f64,
    /// Translation, world from object.
    pub translation: [f64; 3],
    /// Rotation, world from object.
    pub quaternion_xyzw: [f64; 4],
    /// σ of the position of the middle along the axes of the object's frame.
    pub sigma_translation: [f64; 3],
    /// σ of the rotation about these axes, in degrees.
    pub sigma_rotation_deg: [f64; 3],
    /// Readings that matched the surface of the first scan.
    pub readings: usize,
    /// Distance from the pose that the earlier scans predict for a steady motion: `√(dᵀ C⁻¹ d / 6)` with
    /// the covariance `C` of that prediction. It is about 1 or less for a steady motion, and 0 for the first
    /// two scans, before which no motion is known.
    pub innovation: f64,
}

/// A pose of the fit of all scans.
struct AdoptedPose {
    /// Time since the first scan.
    since: f64,
    pose: Pose,
    /// Inverse of its covariance, and the root of it.
    weight: Matrix6<f64>,
    root: Matrix6<f64>,
}

/// The steady motion nearest to some poses, from a twist near it, and its covariance for common errors; none
/// if they do not determine it.
fn steady_motion(start: Vector6<f64>, poses: &[AdoptedPose]) -> Option<(Vector6<f64>, Matrix6<f64>)> {
    /// The filter's twist is near the solution, where the steps shrink quadratically.
    const STEPS: usize = 8;
    let mut twist = start;
    let mut covariance = None;
    for _ in 0..STEPS {
        let (mut information, mut pull) = (Matrix6::zeros(), Vector6::zeros());
        let mut roots = Matrix6::zeros();
        for AdoptedPose { since, pose, weight, root } in poses {
            let away = log(&exp(&(twist * *since)).inverse().after(pose));
            let by_twist = right_jacobian(&(twist * *since)) * *since;
            information += by_twist.transpose() * weight * by_twist;
            pull += by_twist.transpose() * weight * away;
            roots += by_twist.transpose() * weight * root;
        }
        let inverse = information.cholesky()?.inverse();
        twist += inverse * pull;
        let common = inverse * roots;
        covariance = Some(common * common.transpose());
    }
    Some((twist, covariance?))
}

/// The right Jacobian of SE(3): `exp(x + δ) ≈ exp(x) exp(J_r δ)`, `J_r = ∫₀¹ Ad(exp(−s x)) ds` (Simpson's
/// rule).
fn right_jacobian(x: &Vector6<f64>) -> Matrix6<f64> {
    let turn = x.fixed_rows::<3>(0).norm();
    // Eight intervals a radian leave a relative error of 1e-6.
    let halves = 4 * (1 + turn.ceil() as usize);
    let step = 1.0 / (2 * halves) as f64;
    let at = |k: usize| adjoint(&exp(&(x * (-step * k as f64))));
    let mut sum = at(0) + at(2 * halves);
    for k in 1..2 * halves {
        sum += at(k) * if k % 2 == 1 { 4.0 } else { 2.0 };
    }
    sum * (step / 3.0)
}

/// The largest time of which all times are whole multiples, in a tolerance of a thousandth of the shortest
/// gap; zero if there is none.
fn common_period(times: &[f64]) -> f64 {
    let gaps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).filter(|gap| *gap > 0.0).collect();
    let shortest = gaps.iter().copied().fold(f64::INFINITY, f64::min);
    let mut period = 0.0_f64;
    for gap in gaps {
        // Euclid's algorithm; remainders below the tolerance are rounding.
        let (mut a, mut b) = (gap, period);
        while b > 1e-3 * shortest {
            let rest = a - b * (a / b).round();
            (a, b) = (b, rest.abs());
        }
        period = a;
    }
    period
}

impl RigidTracker {
    /// The pose of the object in the world at the time of a scan.
    pub(crate) fn pose(&self, scan: usize) -> Option<Pose> {
        let tracked = self.tracked.iter().find(|pose| pose.scan == scan)?;
        Some(about_origin(&tracked.pose, self.middle))
    }

    /// σ of a scanner's position in the object's frame, and of its rotation: the largest along any axis. The
    /// lever arm from the middle is taken into account.
    pub(crate) fn sigmas(&self, scan: usize, scanner: DVec3) -> [f64; 2] {
        let tracked = self.tracked.iter().find(|pose| pose.scan == scan);
        let factor = if self.is_chained { CHAINED_SIGMA_FACTOR } else { PRIOR_SIGMA_FACTOR };
        let largest = |from: usize| {
            let variances =
                tracked.map_or([0.0; 3], |pose| [0, 1, 2].map(|k| pose.covariance[(from + k, from + k)]));
            factor * variances.into_iter().fold(0.0, f64::max).sqrt()
        };
        // A scan states one σ for all axes, so the largest stands for the three.
        let (turn, shift) = (largest(0), largest(3));
        let arm = (scanner - self.middle).length();
        [(shift * shift + (arm * turn).powi(2)).sqrt(), turn]
    }

    /// Adopts the poses that the fit of all scans found, and the steady motion nearest to them.
    ///
    /// With `T_k` the pose at the time `t_k` since the first scan and `W_k` the inverse of its covariance,
    /// the twist minimises `Σ d_kᵀ W_k d_k`, `d_k = log(exp(ξ t_k)⁻¹ T_k)` (Gauss–Newton, from the twist of
    /// the filter). `∂d_k/∂ξ = −t_k J_r(ξ t_k)` with the right Jacobian `J_r` of SE(3). `log T_k` itself
    /// would lose whole turns: the filter's twist counts them, because it follows the rotations between
    /// neighbouring scans.
    ///
    /// The errors of the poses are correlated, since all refer to one surface. The correlation is not known
    /// from the single covariances, so the covariance of `ξ` assumes wholly common errors: an upper bound but
    /// for the rotations of their axes.
    ///
    /// # Errors
    /// `Undetermined` if a covariance has no inverse.
    pub(crate) fn adopt_poses(&mut self, set: &ScanSet, poses: &[ScanPoseReport]) -> Result<()> {
        let start = self.times[0];
        let mut adopted = Vec::new();
        // The first scan defines the frame, so its pose has no error.
        for (tracked, &time) in self.tracked.iter_mut().zip(&self.times).skip(1) {
            let report = &poses[tracked.scan];
            let Some((covariance, object_from_scanner)) = report
                .covariance
                .zip(Pose::from_quaternion_xyzw(report.quaternion_xyzw, report.translation.into()))
            else {
                continue;
            };
            let world_from_object =
                set.scans[tracked.scan].scan.world_from_scanner.after(&object_from_scanner.inverse());
            tracked.pose = about_origin(&world_from_object, -self.middle);
            // A motion E of the scanner in the object's frame moves the object by E⁻¹: −ω, and −(τ + ω × arm)
            // at the middle.
            let arm = self.middle - object_from_scanner.translation;
            let mut by = Matrix6::zeros();
            for axis in 0..3 {
                by[(axis, 3 + axis)] = -1.0;
                by[(3 + axis, axis)] = -1.0;
                let mut turn = DVec3::ZERO;
                turn[axis] = 1.0;
                for (k, moved) in turn.cross(arm).to_array().into_iter().enumerate() {
                    by[(3 + k, 3 + axis)] = -moved;
                }
            }
            tracked.covariance = by * Matrix6::from_fn(|a, b| covariance[a][b]) * by.transpose();
            let symmetric = 0.5 * (tracked.covariance + tracked.covariance.transpose());
            let weight = (symmetric.cholesky())
                .ok_or_else(|| Error::undetermined(format!("{}: its pose has no covariance", report.scan)))?
                .inverse();
            let eigen = symmetric.symmetric_eigen();
            // Common errors add linearly, so the roots of the covariances are summed, not the covariances.
            let root = eigen.eigenvectors
                * Matrix6::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()))
                * eigen.eigenvectors.transpose();
            adopted.push(AdoptedPose { since: time - start, pose: tracked.pose, weight, root });
        }
        if let Some((twist, covariance)) = steady_motion(self.twist, &adopted) {
            self.twist = twist;
            self.covariance.fixed_view_mut::<6, 6>(6, 6).copy_from(&covariance);
        }
        Ok(())
    }

    /// The report of the motion.
    pub(crate) fn report(&self, set: &ScanSet) -> Result<MotionReport> {
        let sigma = |k: usize| self.covariance[(k, k)].max(0.0).sqrt();
        let turn = DVec3::from_slice(&self.twist.as_slice()[..3]);
        let velocity = DVec3::from_slice(&self.twist.as_slice()[3..]);
        // σ of the length of a vector is its σ along the vector.
        let length = |first: usize, v: DVec3| {
            let size = v.length();
            // Without a velocity every direction is as good.
            let along = if size > 0.0 { 1.0 / size * v } else { DVec3::X };
            let variance: f64 = (0..9)
                .map(|k| along[k / 3] * along[k % 3] * self.covariance[(first + k / 3, first + k % 3)])
                .sum();
            [size, variance.max(0.0).sqrt()]
        };
        let rate = length(6, turn);
        // Without a significant turn the axis would lie anywhere.
        let is_turning = rate[0] > 3.0 * rate[1];
        Ok(MotionReport {
            kind: "rigid".to_owned(),
            angular_velocity_deg_per_s: turn.map(f64::to_degrees).to_array(),
            sigma_angular_velocity_deg_per_s: [6, 7, 8].map(|k| sigma(k).to_degrees()),
            velocity: velocity.to_array(),
            sigma_velocity: [9, 10, 11].map(sigma),
            rate_deg_per_s: rate.map(f64::to_degrees),
            rate_period_deg_per_s: Some(common_period(&self.times))
                .filter(|period| *period > 0.0)
                .map(|period| 360.0 / period),
            angle_deg: rate[0].to_degrees() * self.duration,
            speed: length(9, velocity),
            middle: self.middle.to_array(),
            axis_point: is_turning
                .then(|| (self.middle + 1.0 / turn.length_squared() * turn.cross(velocity)).to_array()),
            poses: (self.tracked.iter().zip(&self.times))
                .map(|(known, &time_s)| {
                    let pose = about_origin(&known.pose, self.middle);
                    let sigma = |k: usize| known.covariance[(k, k)].max(0.0).sqrt();
                    MotionPose {
                        scan: set.scans[known.scan].scan.name.clone(),
                        time_s,
                        translation: pose.translation.to_array(),
                        quaternion_xyzw: pose.quaternion_xyzw(),
                        sigma_translation: [3, 4, 5].map(sigma),
                        sigma_rotation_deg: [0, 1, 2].map(|k| sigma(k).to_degrees()),
                        readings: known.readings,
                        innovation: known.innovation,
                    }
                })
                .collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn right_jacobian_matches_differences() {
        // One twist is beyond a whole turn.
        for x in [[0.3, -0.2, 0.5, 1.0, -2.0, 0.4], [4.0, -3.0, 5.0, 0.3, 0.1, -0.7]] {
            let x = Vector6::from(x);
            let found = right_jacobian(&x);
            for k in 0..6 {
                let mut by = Vector6::zeros();
                by[k] = 1e-6;
                let column = log(&exp(&x).inverse().after(&exp(&(x + by)))) / 1e-6;
                assert!((column - found.column(k)).norm() < 1e-4, "{k}: {column} {}", found.column(k));
            }
        }
    }

    #[test]
    fn whole_turns_are_counted() {
        for rate_deg in [3.0_f64, 25.0, 55.0, -55.0, 95.0, 170.0] {
            let truth = Vector6::from([0.1, -0.2, rate_deg.to_radians(), 0.4, 0.0, -0.1]);
            let poses: Vec<AdoptedPose> = (1..=14)
                .map(|k| AdoptedPose {
                    since: f64::from(k),
                    pose: exp(&(truth * f64::from(k))),
                    weight: Matrix6::identity() * 1e6,
                    root: Matrix6::identity() * 1e-3,
                })
                .collect();
            // The filter knows the rate to about a degree per second.
            let start = truth + Vector6::from([0.01, -0.01, 0.015, 0.02, 0.02, 0.02]);
            let (found, _) = steady_motion(start, &poses).unwrap();
            assert!((found - truth).norm() < 1e-9, "{rate_deg}: {found}");
        }
    }

    #[test]
    fn rates_that_give_the_same_views_follow_from_the_times() {
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(close(common_period(&[0.0, 0.5, 1.0, 2.5]), 0.5));
        assert!(close(common_period(&[0.0, 0.6, 1.0]), 0.2));
        assert_eq!(common_period(&[1.0, 1.0]), 0.0);
    }
}
