//! The filter of pose and velocity: see [`super`].

use crate::fit::Fit;
use crate::model::Observed;
use crate::observe::Observations;
use nalgebra::{Matrix6, SMatrix, Vector6};
use planish_core::DVec3;
use planish_estimate::sparse::CholeskyFactor;
use planish_estimate::{Error, Result, gated_scale};
use planish_exchange::ScanSet;
use planish_mesh::BoundingBox;
use planish_sense::Pose;
use planish_spline::{FootPointSearch, Surface, SurfaceSystem};
use rayon::prelude::*;

/// Maximum number of readings of a scan that are used. A pose has six unknowns, so more of them mainly cost
/// time.
const MAX_READINGS: usize = 6000;
/// Number of Gauss–Newton steps for each scan. The gate shrinks during the first 60 % of them, and the last
/// four use the final gate.
const STEPS: usize = 14;
/// Gate of the first steps, as a share of the object's size. Readings farther away are of parts that the
/// first scan did not see.
pub(super) const FIRST_GATE: f64 = 0.06;
/// Gate of the last steps, in σ.
pub(super) const LAST_GATE: f64 = 4.0;
/// Minimum share of a scan's readings that must match the surface. Fewer indicate a wrong time or another
/// object; a larger share would refuse scans that see little of what the first one saw.
const MIN_MATCHED: f64 = 0.2;
/// Share of a scan's readings on the surface below which the surface is fitted to all scans so far. Each
/// such fit takes as long as that of the first scan, or longer; a scan of which less matches has an
/// uncertain pose.
const MIN_OVERLAP: f64 = 0.5;
/// Change of the velocity over the whole time, as a share of one radian (or of the object's size) over it. A
/// smaller value makes σ of the velocity too small if the motion is not quite steady; a larger one gives less
/// weight to earlier scans.
const UNSTEADINESS: f64 = 0.01;

/// The surface to which scans are matched, in the frame of the object.
pub(super) struct Reference {
    pub(super) surface: Surface,
    pub(super) observed: Vec<Observed>,
    pub(super) search: FootPointSearch,
    /// The factor of the surface's information along the normals of its nodes, and these normals. The
    /// covariance of a pose contains the error of the surface: its factor is kept for all scans.
    pub(super) factor: CholeskyFactor,
    pub(super) directions: Vec<DVec3>,
    /// Variance of the surface along its normal at the middle of each leaf.
    pub(super) variances: Vec<f64>,
}

impl Reference {
    fn new(fitted: &Fit, size: f64) -> Result<Self> {
        let surface = &fitted.model.surface;
        let system = SurfaceSystem::new(surface.space())?;
        let directions = surface.directions();
        let known = fitted.model.information_along(&system, &directions)?;
        let posterior = fitted.posterior();
        let variances = (0..surface.space().leaves().len())
            .into_par_iter()
            .map(|leaf| posterior.variance_at_middle(leaf))
            .collect::<Result<Vec<f64>>>()?;
        Ok(Self {
            surface: surface.clone(),
            observed: fitted.model.observed.clone(),
            search: FootPointSearch::new(surface, 2, 0.1 * size)?,
            factor: system.factorize_scalar(&known)?,
            directions,
            variances,
        })
    }
}

/// Tracks a rigid body from scan to scan.
pub(super) struct RigidTracker {
    pub(super) reference: Reference,
    /// Whether the surface is no longer that of the first scan alone.
    pub(super) is_chained: bool,
    pub(super) size: f64,
    pub(super) middle: DVec3,
    /// Number of readings of the first scan, and the covariance of the object's frame in its surface.
    pub(super) first_readings: f64,
    pub(super) frame: Matrix6<f64>,
    pub(super) duration: f64,
    /// The state: time, pose about the middle, twist, and the covariance of pose and twist.
    pub(super) time: f64,
    pub(super) pose: Pose,
    pub(super) twist: Vector6<f64>,
    pub(super) covariance: SMatrix<f64, 12, 12>,
    pub(super) tracked: Vec<TrackedPose>,
    pub(super) times: Vec<f64>,
}

/// The pose of the object at one scan.
pub(super) struct TrackedPose {
    pub(super) scan: usize,
    pub(super) pose: Pose,
    pub(super) covariance: Matrix6<f64>,
    pub(super) readings: usize,
    pub(super) innovation: f64,
}

/// A reading of a scan, relative to the middle.
pub(super) struct Reading {
    pub(super) point: DVec3,
    pub(super) normal: DVec3,
    pub(super) variance: f64,
}

/// A reading that matched the surface.
pub(super) struct MatchedReading {
    pub(super) leaf: usize,
    pub(super) local: [f64; 2],
    pub(super) normal: DVec3,
    pub(super) height: f64,
    /// Variance of the height: of reading and surface together, and of the reading alone.
    pub(super) variance: f64,
    pub(super) reading_variance: f64,
    /// Negative derivative of the height by the pose.
    pub(super) row: Vector6<f64>,
}

/// The normal equations of one step.
pub(super) struct NormalEquations {
    pub(super) information: Matrix6<f64>,
    pub(super) gradient: Vector6<f64>,
    pub(super) matched: usize,
    /// Sum over matched readings: 1 at the surface, 0 at the gate.
    pub(super) score: f64,
    pub(super) normalised: Vec<f64>,
}

impl RigidTracker {
    /// Starts at the first scan, which defines the object's frame.
    ///
    /// The prior of the velocity allows a turn of one radian and a motion by the object's size from one scan
    /// to the next.
    pub(crate) fn new(first: &Fit, set: &ScanSet, order: &[usize]) -> Result<Self> {
        let surface = &first.model.surface;
        let points: Vec<DVec3> = (0..surface.space().leaves().len())
            .filter(|&leaf| first.model.observed[leaf].is_measured())
            .map(|leaf| surface.leaf_point(leaf, 0.5, 0.5))
            .collect();
        let bounds = BoundingBox::from_points(&points).ok_or_else(|| {
            Error::undetermined(
                "the first scan determines no surface to which the others could be registered",
            )
        })?;
        let times: Vec<f64> = order.iter().map(|&k| set.scans[k].scan.time_s.unwrap_or_default()).collect();
        // Scans of the same time bound no velocity.
        let gap =
            (times.windows(2).map(|w| w[1] - w[0]).filter(|gap| *gap > 0.0)).fold(f64::INFINITY, f64::min);
        let size = bounds.diagonal();
        // The pose at the first scan defines the frame, so its variance is zero; only the twist is uncertain.
        let mut covariance = SMatrix::zeros();
        for k in 0..3 {
            covariance[(6 + k, 6 + k)] = gap.powi(-2);
            covariance[(9 + k, 9 + k)] = (size / gap).powi(2);
        }
        Ok(Self {
            reference: Reference::new(first, size)?,
            is_chained: false,
            size,
            middle: bounds.center(),
            first_readings: first.report.observations as f64,
            frame: Matrix6::zeros(),
            duration: times[times.len() - 1] - times[0],
            time: times[0],
            pose: Pose::identity(),
            twist: Vector6::zeros(),
            covariance,
            tracked: vec![TrackedPose {
                scan: order[0],
                pose: Pose::identity(),
                covariance: Matrix6::zeros(),
                readings: first.report.observations,
                innovation: 0.0,
            }],
            times,
        })
    }

    /// Matches scans from now on to the surface of all scans that were tracked.
    ///
    /// # Errors
    /// As for a fit.
    pub(crate) fn refer_to(&mut self, fitted: &Fit) -> Result<()> {
        self.reference = Reference::new(fitted, self.size)?;
        self.is_chained = true;
        Ok(())
    }

    /// True if so little of the next scan lies on the surface that the surface should be fitted to all scans
    /// that were tracked. None is expected to before a velocity is known.
    pub(crate) fn leaves_surface(&self, observations: &Observations) -> bool {
        if self.tracked.len() < 2 {
            return false;
        }
        let readings = self.readings(observations);
        let dt = self.times[self.tracked.len()] - self.time;
        let predicted = self.pose.after(&exp(&(self.twist * dt)));
        let matched = self.step(&predicted, &readings, 0.5 * FIRST_GATE * self.size, 1.0).matched;
        (matched as f64) < MIN_OVERLAP * readings.len() as f64
    }

    /// The readings of a scan that are used.
    fn readings(&self, observations: &Observations) -> Vec<Reading> {
        (0..observations.len())
            .step_by(observations.len().div_ceil(MAX_READINGS).max(1))
            .map(|i| Reading {
                point: observations.readings.points[i] - self.middle,
                normal: observations.normal(i),
                variance: observations.variance(i, observations.normal(i)).max(f64::MIN_POSITIVE),
            })
            .collect()
    }

    /// Matches the next scan to the surface and corrects pose and velocity.
    ///
    /// # Errors
    /// `Undetermined` if too few of its readings match the surface.
    pub(crate) fn follow(&mut self, scan: usize, observations: &Observations) -> Result<()> {
        let time = self.times[self.tracked.len()];
        let readings = self.readings(observations);
        // The second scan has no predicted velocity, so its pose is searched for. The frame's covariance B is
        // estimated there: see the module's documentation.
        if self.tracked.len() == 1 {
            self.pose = self.start(&readings);
            let sums = self.step(&self.pose, &readings, 0.2 * FIRST_GATE * self.size, 1.0);
            let frame = (sums.information + self.damping()).cholesky().map(|c| c.inverse());
            self.frame = frame.unwrap_or_default() * (sums.matched as f64 / self.first_readings);
            self.covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(&self.frame);
        }
        // The search gives a start for Gauss–Newton only. The prediction itself begins at the first pose.
        let start = self.pose;
        if self.tracked.len() == 1 {
            self.pose = Pose::identity();
        }
        self.predict(time - self.time);
        self.time = time;
        let predicted = self.pose;
        let pose_covariance: Matrix6<f64> = self.covariance.fixed_view::<6, 6>(0, 0).into_owned();
        let prior = pose_covariance
            .cholesky()
            .ok_or_else(|| Error::undetermined("the predicted pose has no covariance"))?
            .inverse();
        let mut pose = if self.tracked.len() == 1 { start } else { predicted };
        let stated = observations.channels.iter().all(|c| c.stated);
        let mut scale_of_variance = 1.0;
        let mut posterior = pose_covariance;
        let mut met = 0;
        // The gate shrinks from a share of the size to [`LAST_GATE`] σ, so that unseen parts drop out before
        // the last steps.
        for step in 0..STEPS {
            let share = (step as f64 / (0.6 * STEPS as f64)).min(1.0);
            let gate = if step + 4 < STEPS { FIRST_GATE * self.size * (0.02_f64).powf(share) } else { 0.0 };
            let sums = self.step(&pose, &readings, gate, scale_of_variance);
            met = sums.matched;
            if (met as f64) < MIN_MATCHED * readings.len() as f64 {
                return Err(Error::undetermined(format!(
                    "the scan at {time} s does not fit the surface of the scans before it: {met} of {} \
                     readings lie on it; a scan has to overlap these, be turned by less than about 40° from \
                     the one before, and show the same object",
                    readings.len()
                )));
            }
            // A stated σ may be enlarged by the residuals, but not reduced.
            let sigma = gated_scale(&sums.normalised, LAST_GATE)?.sigma;
            let factor = sigma * sigma * scale_of_variance;
            scale_of_variance = if stated { factor.max(1.0) } else { factor };
            // Gauss–Newton on readings and prediction together is the iterated Kalman update (Bell & Cathey
            // 1993).
            let away = log(&predicted.inverse().after(&pose));
            let total = (sums.information + prior)
                .cholesky()
                .ok_or_else(|| Error::undetermined("the scans do not determine a pose"))?;
            let by = total.solve(&(sums.gradient - prior * away));
            pose = pose.after(&exp(&by));
            posterior = total.inverse();
        }
        let away = log(&predicted.inverse().after(&pose));
        let innovation = match self.tracked.len() {
            1 => 0.0,
            _ => ((away.transpose() * prior * away)[0] / 6.0).max(0.0).sqrt(),
        };
        self.correct(&predicted, pose, &prior, &posterior);
        self.tracked.push(TrackedPose {
            scan,
            pose,
            covariance: self.covariance_on_surface(
                &pose,
                &readings,
                scale_of_variance,
                &prior,
                &posterior,
            )?,
            readings: met,
            innovation,
        });
        Ok(())
    }

    /// Predicts state and covariance `dt` seconds ahead.
    fn predict(&mut self, dt: f64) {
        let moved = exp(&(self.twist * dt));
        self.pose = self.pose.after(&moved);
        // Errors are multiplied from the right, so the pose error is carried by the adjoint of the inverse
        // motion.
        let mut carry = SMatrix::<f64, 12, 12>::identity();
        carry.fixed_view_mut::<6, 6>(0, 0).copy_from(&adjoint(&moved.inverse()));
        carry.fixed_view_mut::<6, 6>(0, 6).copy_from(&(Matrix6::identity() * dt));
        self.covariance = carry * self.covariance * carry.transpose();
        // White noise of acceleration, integrated over dt: dt³/3, dt²/2 and dt times its spectral density.
        let turn = (UNSTEADINESS / self.duration).powi(2) / self.duration;
        let shift = turn * self.size * self.size;
        for k in 0..6 {
            let q = if k < 3 { turn } else { shift };
            self.covariance[(k, k)] += q * dt.powi(3) / 3.0;
            self.covariance[(k, 6 + k)] += 0.5 * q * dt * dt;
            self.covariance[(6 + k, k)] += 0.5 * q * dt * dt;
            self.covariance[(6 + k, 6 + k)] += q * dt;
        }
    }

    /// Corrects the velocity by the Kalman gain times the difference of the pose from its prediction.
    fn correct(&mut self, predicted: &Pose, pose: Pose, prior: &Matrix6<f64>, posterior: &Matrix6<f64>) {
        let away = log(&predicted.inverse().after(&pose));
        let cross: Matrix6<f64> = self.covariance.fixed_view::<6, 6>(6, 0).into_owned();
        let before: Matrix6<f64> = self.covariance.fixed_view::<6, 6>(0, 0).into_owned();
        let own: Matrix6<f64> = self.covariance.fixed_view::<6, 6>(6, 6).into_owned();
        let gain = cross * prior;
        self.twist += gain * away;
        let now = gain * posterior;
        // Rounding makes the product asymmetric, so it is symmetrised below.
        let rest = own - gain * (before - posterior) * gain.transpose();
        self.covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(posterior);
        self.covariance.fixed_view_mut::<6, 6>(6, 0).copy_from(&now);
        self.covariance.fixed_view_mut::<6, 6>(0, 6).copy_from(&now.transpose());
        self.covariance.fixed_view_mut::<6, 6>(6, 6).copy_from(&((rest + rest.transpose()) * 0.5));
        self.pose = pose;
    }
}

/// A motion about the origin, given as one about the point `middle`.
pub(super) fn about_origin(pose: &Pose, middle: DVec3) -> Pose {
    Pose { translation: pose.translation + (middle - pose.rotate(middle)), rotation: pose.rotation }
}

pub(super) fn exp(twist: &Vector6<f64>) -> Pose {
    Pose::from_twist(DVec3::new(twist[0], twist[1], twist[2]), DVec3::new(twist[3], twist[4], twist[5]))
}

pub(super) fn log(pose: &Pose) -> Vector6<f64> {
    let (turn, shift) = pose.twist();
    Vector6::from([turn[0], turn[1], turn[2], shift[0], shift[1], shift[2]])
}

/// The adjoint of a pose, by which it maps twists: `Ad = [[R, 0], [t × R, R]]`.
pub(super) fn adjoint(pose: &Pose) -> Matrix6<f64> {
    let mut made = Matrix6::zeros();
    for j in 0..3 {
        let column = DVec3::from_array([0, 1, 2].map(|i| pose.rotation[i][j]));
        let moved = pose.translation.cross(column);
        for i in 0..3 {
            made[(i, j)] = column[i];
            made[(i + 3, j + 3)] = column[i];
            made[(i + 3, j)] = moved[i];
        }
    }
    made
}
