//! A rigid body that moves while it is scanned: a Kalman filter of pose and velocity.
//!
//! The state is the pose `T(t)` of the thing and its twist `ξ`, constant but for white noise of acceleration:
//! `T(t + dt) = T(t) exp(ξ dt)`. Errors are multiplied from the right, `T = T̂ exp(δ)`. A scan at a known
//! time is laid on the surface that the first scan made: the height of a reading `z` over it is
//! `h = n·(T⁻¹z − foot)`, with `∂h/∂δ = −[p × n, n]`, `p = T⁻¹z`; Gauss–Newton on these and the predicted
//! pose is the iterated filter.
//!
//! The surface has errors of its own, `e ~ N(0, Σ)` of its nodes along their normals, which all scans share.
//! They move a pose by `P Aᵀe`, `A = Σ w a jᵀ` over the readings that met it (`a` their rows over the nodes,
//! `j = ∂h/∂δ`, `P` the inverse of the pose's information). Readings count by `w = 1/(σ² + σ_S²)`, σ_S that
//! of the surface where they met it, so the covariance of a pose is `P (Λ₀ + Σ w²σ² jjᵀ + AᵀΣA) P`, `Λ₀` the
//! information of the prediction. To the velocity only what differs from scan to scan matters: for the filter
//! the frame is off by `B = N/N₀ H⁻¹`, `H` the information of `N` readings of a scan and the surface made of
//! `N₀`, and the first pose is known to within `B` in it.
//!
//! Positions are about the middle of the thing, so that turn and translation are nearly independent.
//!
//! Then all scans are fitted together, with these poses as what was known of them before, four times weaker
//! than found: the surface of all scans says more of each pose than that of the first.
//! [`RigidTracker::settle`] takes them back, and the steady motion nearest to them.
//!
//! Not guaranteed: turns of more than about forty degrees from scan to scan are not found.
//!
//! # References
//! Bell & Cathey, *The iterated Kalman filter update as a Gauss–Newton method*, IEEE TAC 38 (1993).

use super::Fit;
use crate::model::{Observed, PoseReport};
use crate::observe::Observations;
use nalgebra::{Matrix6, SMatrix, Vector6};
use planish_estimate::sparse::CholeskyFactor;
use planish_estimate::vector3::{add, cross, dot, norm, scale, sub};
use planish_estimate::{Error, Result, gated_scale};
use planish_exchange::ScanSet;
use planish_mesh::BoundingBox;
use planish_sense::Pose;
use planish_spline::{FootPointSearch, ProjectionOptions, Surface, SurfaceSystem, leaf_weights};
use rayon::prelude::*;
use serde::Serialize;

/// Readings of a scan that take part, at most, and in the search for a start.
const MOST_READINGS: usize = 6000;
const START_READINGS: usize = 300;
/// Steps of a start, and at the end.
const START_STEPS: usize = 6;
const STEPS: usize = 14;
/// Readings farther than this share of the size are of parts that were not seen, at the start.
const FIRST_GATE: f64 = 0.06;
/// And so many σ, at the end.
const LAST_GATE: f64 = 4.0;
/// Turns at the start in degrees, about each axis.
const START_TURNS_DEG: [f64; 6] = [-32.0, -21.0, -10.0, 10.0, 21.0, 32.0];
/// Cosine between a reading's normal and the surface's, at least.
const LEAST_COSINE: f64 = 0.5;
/// Share of a scan's readings that meets the surface, at least.
const LEAST_MET: f64 = 0.2;
/// How much weaker than found the poses go into the fit of all scans.
const WEAKER: f64 = 4.0;
/// Change of the velocity over the whole time, as a share of one radian (of the size) over it.
const UNSTEADINESS: f64 = 0.01;

/// A thing's motion.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MotionReport {
    /// `rigid`.
    pub kind: String,
    /// Angular velocity about the coordinate axes of the thing's frame, in degrees per second.
    pub angular_velocity_deg_per_s: [f64; 3],
    /// σ of each.
    pub sigma_angular_velocity_deg_per_s: [f64; 3],
    /// Velocity of the middle, per second, in the thing's frame.
    pub velocity: [f64; 3],
    /// σ of each.
    pub sigma_velocity: [f64; 3],
    /// How fast it turns, in degrees per second, and σ.
    pub rate_deg_per_s: [f64; 2],
    /// How fast its middle moves, per second, and σ.
    pub speed: [f64; 2],
    /// The point whose velocity is stated: the middle of what the first scan saw.
    pub middle: [f64; 3],
    /// A point of the axis about which it turns, where it does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis_point: Option<[f64; 3]>,
    /// Pose by pose, in the order of time.
    pub poses: Vec<MotionPose>,
}

/// Where the thing was when a scan was taken.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MotionPose {
    /// The scan.
    pub scan: String,
    /// When, in seconds.
    pub time_s: f64,
    /// World from thing.
    pub translation: [f64; 3],
    /// World from thing.
    pub quaternion_xyzw: [f64; 4],
    /// σ of the middle's place along the axes of the thing's frame.
    pub sigma_translation: [f64; 3],
    /// σ of the turn about them, in degrees.
    pub sigma_rotation_deg: [f64; 3],
    /// Readings that met the surface of the first scan.
    pub readings: usize,
    /// How far it is from where the scans before it lead, as a steady motion: `√(dᵀ C⁻¹ d / 6)` with the
    /// covariance `C` of that prediction. About one or less; zero of the first two scans, before which no
    /// motion is known.
    pub innovation: f64,
}

/// The scans in the order of their times.
///
/// # Errors
/// `Input` where one states none, or all state the same.
pub(crate) fn scans_in_time(set: &ScanSet) -> Result<Vec<usize>> {
    if let Some(untimed) = set.scans.iter().find(|posed| posed.scan.time_s.is_none()) {
        return Err(Error::input(format!(
            "{}: needed the time of every scan of a thing that moves, found none: say `time = 1.5` (seconds) in its [[scan]]",
            untimed.scan.name
        )));
    }
    let time = |k: usize| set.scans[k].scan.time_s.unwrap_or_default();
    let mut order: Vec<usize> = (0..set.scans.len()).collect();
    order.sort_by(|&a, &b| time(a).total_cmp(&time(b)));
    match (order.first(), order.last()) {
        (Some(&first), Some(&last)) if time(last) > time(first) => Ok(order),
        _ => {
            Err(Error::input(format!("needed scans of at least two times, found {} of one", set.scans.len())))
        }
    }
}

/// Follows a rigid body from scan to scan.
pub(crate) struct RigidTracker<'a> {
    surface: &'a Surface,
    observed: &'a [Observed],
    search: FootPointSearch,
    size: f64,
    middle: [f64; 3],
    /// Readings that made the surface, and the covariance of the thing's frame in it.
    made_of: f64,
    frame: Matrix6<f64>,
    /// The factor of the surface's information along the normals of its nodes, and those.
    factor: CholeskyFactor,
    directions: Vec<[f64; 3]>,
    /// The surface's variance along its normal in the middle of each leaf.
    variances: Vec<f64>,
    duration: f64,
    /// The state: when, pose about the middle, twist, and the covariance of both.
    time: f64,
    pose: Pose,
    twist: Vector6<f64>,
    covariance: SMatrix<f64, 12, 12>,
    known: Vec<Known>,
    times: Vec<f64>,
}

/// What is known of one scan's pose.
struct Known {
    scan: usize,
    pose: Pose,
    covariance: Matrix6<f64>,
    readings: usize,
    innovation: f64,
}

/// A reading of a scan, about the middle.
struct Reading {
    point: [f64; 3],
    normal: [f64; 3],
    variance: f64,
}

/// A reading that met the surface.
struct Met {
    leaf: usize,
    local: [f64; 2],
    normal: [f64; 3],
    height: f64,
    /// Of reading and surface, and of the reading alone.
    variance: f64,
    of_reading: f64,
    /// How the height falls with the pose.
    row: Vector6<f64>,
}

/// The sums of one step.
struct Step {
    information: Matrix6<f64>,
    gradient: Vector6<f64>,
    met: usize,
    /// The nearer the readings are, the more.
    score: f64,
    normalised: Vec<f64>,
}

impl<'a> RigidTracker<'a> {
    /// Starts at the first scan, which places the thing; nothing is known of the velocity but that it does
    /// not turn by more than a radian, or move by more than its size, from one scan to the next.
    pub(crate) fn new(first: &'a Fit, set: &ScanSet, order: &[usize]) -> Result<Self> {
        let surface = &first.model.surface;
        let points: Vec<[f64; 3]> = (0..surface.space().leaves().len())
            .filter(|&leaf| first.model.observed[leaf].is_measured())
            .map(|leaf| surface.leaf_point(leaf, 0.5, 0.5))
            .collect();
        let bounds = BoundingBox::from_points(&points).ok_or_else(|| {
            Error::undetermined("the first scan made no surface that the others could be laid on")
        })?;
        let times: Vec<f64> = order.iter().map(|&k| set.scans[k].scan.time_s.unwrap_or_default()).collect();
        let gap =
            (times.windows(2).map(|w| w[1] - w[0]).filter(|gap| *gap > 0.0)).fold(f64::INFINITY, f64::min);
        let size = bounds.diagonal();
        let system = SurfaceSystem::new(surface.space())?;
        let directions = system.node_normals(surface);
        let known = first.model.information_along(&system, &directions)?;
        let posterior = first.posterior();
        let variances = (0..surface.space().leaves().len())
            .into_par_iter()
            .map(|leaf| posterior.variance_at_middle(leaf))
            .collect::<Result<Vec<f64>>>()?;
        let mut covariance = SMatrix::zeros();
        for k in 0..3 {
            covariance[(6 + k, 6 + k)] = gap.powi(-2);
            covariance[(9 + k, 9 + k)] = (size / gap).powi(2);
        }
        Ok(Self {
            surface,
            observed: &first.model.observed,
            search: FootPointSearch::new(surface, 2, 0.1 * size)?,
            size,
            middle: bounds.center(),
            made_of: first.report.observations as f64,
            frame: Matrix6::zeros(),
            factor: system.factorize_scalar(&known)?,
            directions,
            variances,
            duration: times[times.len() - 1] - times[0],
            time: times[0],
            pose: Pose::identity(),
            twist: Vector6::zeros(),
            covariance,
            known: vec![Known {
                scan: order[0],
                pose: Pose::identity(),
                covariance: Matrix6::zeros(),
                readings: first.report.observations,
                innovation: 0.0,
            }],
            times,
        })
    }

    /// Lays the next scan on the surface and corrects pose and velocity.
    ///
    /// # Errors
    /// `Undetermined` where too few of its readings meet the surface.
    pub(crate) fn follow(&mut self, scan: usize, observations: &Observations) -> Result<()> {
        let time = self.times[self.known.len()];
        let readings: Vec<Reading> = (0..observations.len())
            .step_by(observations.len().div_ceil(MOST_READINGS).max(1))
            .map(|i| Reading {
                point: sub(observations.points[i], self.middle),
                normal: observations.normal(i),
                variance: observations.variance(i, observations.normal(i)).max(f64::MIN_POSITIVE),
            })
            .collect();
        if self.known.len() == 1 {
            self.pose = self.start(&readings);
            let sums = self.step(&self.pose, &readings, 0.2 * FIRST_GATE * self.size, 1.0);
            let frame = (sums.information + self.damping()).cholesky().map(|c| c.inverse());
            self.frame = frame.unwrap_or_default() * (sums.met as f64 / self.made_of);
            self.covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(&self.frame);
        }
        let start = self.pose;
        if self.known.len() == 1 {
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
        let mut pose = if self.known.len() == 1 { start } else { predicted };
        let stated = observations.stated.iter().all(|&s| s);
        let mut scale_of_variance = 1.0;
        let mut posterior = pose_covariance;
        let mut met = 0;
        for step in 0..STEPS {
            let share = (step as f64 / (0.6 * STEPS as f64)).min(1.0);
            let gate = if step + 4 < STEPS { FIRST_GATE * self.size * (0.02_f64).powf(share) } else { 0.0 };
            let sums = self.step(&pose, &readings, gate, scale_of_variance);
            met = sums.met;
            if (met as f64) < LEAST_MET * readings.len() as f64 {
                return Err(Error::undetermined(format!(
                    "the scan at {time} s does not lie on the surface of the first: {met} of {} readings meet it; is the turn between them small \
                     enough, and is the thing the same?",
                    readings.len()
                )));
            }
            let sigma = gated_scale(&sums.normalised, LAST_GATE)?.sigma;
            let factor = sigma * sigma * scale_of_variance;
            scale_of_variance = if stated { factor.max(1.0) } else { factor };
            let away = log(&predicted.inverse().after(&pose));
            let total = (sums.information + prior)
                .cholesky()
                .ok_or_else(|| Error::undetermined("the scans determine no pose"))?;
            let by = total.solve(&(sums.gradient - prior * away));
            pose = pose.after(&exp(&by));
            posterior = total.inverse();
        }
        let away = log(&predicted.inverse().after(&pose));
        let innovation = match self.known.len() {
            1 => 0.0,
            _ => ((away.transpose() * prior * away)[0] / 6.0).max(0.0).sqrt(),
        };
        self.correct(&predicted, pose, &prior, &posterior);
        self.known.push(Known {
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

    /// Carries state and covariance on by `dt` seconds.
    fn predict(&mut self, dt: f64) {
        let moved = exp(&(self.twist * dt));
        self.pose = self.pose.after(&moved);
        let mut carry = SMatrix::<f64, 12, 12>::identity();
        carry.fixed_view_mut::<6, 6>(0, 0).copy_from(&adjoint(&moved.inverse()));
        carry.fixed_view_mut::<6, 6>(0, 6).copy_from(&(Matrix6::identity() * dt));
        self.covariance = carry * self.covariance * carry.transpose();
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

    /// What the new pose says of the velocity: the Kalman gain on how far it lies from the prediction.
    fn correct(&mut self, predicted: &Pose, pose: Pose, prior: &Matrix6<f64>, posterior: &Matrix6<f64>) {
        let away = log(&predicted.inverse().after(&pose));
        let cross: Matrix6<f64> = self.covariance.fixed_view::<6, 6>(6, 0).into_owned();
        let before: Matrix6<f64> = self.covariance.fixed_view::<6, 6>(0, 0).into_owned();
        let own: Matrix6<f64> = self.covariance.fixed_view::<6, 6>(6, 6).into_owned();
        let gain = cross * prior;
        self.twist += gain * away;
        let now = gain * posterior;
        let rest = own - gain * (before - posterior) * gain.transpose();
        self.covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(posterior);
        self.covariance.fixed_view_mut::<6, 6>(6, 0).copy_from(&now);
        self.covariance.fixed_view_mut::<6, 6>(0, 6).copy_from(&now.transpose());
        self.covariance.fixed_view_mut::<6, 6>(6, 6).copy_from(&((rest + rest.transpose()) * 0.5));
        self.pose = pose;
    }

    /// Where to start while the velocity is unknown: the turn from which most readings come near.
    fn start(&self, readings: &[Reading]) -> Pose {
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let turns = axes.into_iter().flat_map(|axis| {
            START_TURNS_DEG.map(|deg| Pose::from_twist(scale(deg.to_radians(), axis), [0.0; 3]))
        });
        let starts: Vec<Pose> = std::iter::once(Pose::identity()).chain(turns).collect();
        let some: Vec<&Reading> = readings.iter().step_by(readings.len().div_ceil(START_READINGS)).collect();
        let gate = FIRST_GATE * self.size;
        let tried: Vec<(f64, Pose)> = starts
            .into_par_iter()
            .map(|turn| {
                let mut pose = turn;
                for _ in 0..START_STEPS {
                    let sums = self.step_over(&pose, some.iter().copied(), gate, 1.0);
                    let Some(factor) = (sums.information + self.damping()).cholesky() else {
                        break;
                    };
                    pose = pose.after(&exp(&factor.solve(&sums.gradient)));
                }
                let sums = self.step_over(&pose, some.iter().copied(), 0.15 * gate, 1.0);
                (sums.score, pose)
            })
            .collect();
        tried
            .into_iter()
            .fold(
                (f64::NEG_INFINITY, Pose::identity()),
                |best, next| {
                    if next.0 > best.0 { next } else { best }
                },
            )
            .1
    }

    /// So little information that it changes nothing that readings say.
    fn damping(&self) -> Matrix6<f64> {
        let shift = self.size.powi(-2);
        Matrix6::from_diagonal(&Vector6::from([1.0, 1.0, 1.0, shift, shift, shift]))
    }

    fn step(&self, pose: &Pose, readings: &[Reading], gate: f64, scale_of_variance: f64) -> Step {
        self.step_over(pose, readings.iter(), gate, scale_of_variance)
    }

    /// The normal equations at a pose. Readings nearer than `gate`, or than so many σ, take part; the gate is
    /// a length.
    fn step_over<'r>(
        &self,
        pose: &Pose,
        readings: impl Iterator<Item = &'r Reading>,
        gate: f64,
        scale_of_variance: f64,
    ) -> Step {
        let mut sums = Step {
            information: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            met: 0,
            score: 0.0,
            normalised: Vec::new(),
        };
        let readings: Vec<&Reading> = readings.collect();
        for met in self.met(pose, &readings, gate, scale_of_variance) {
            let Met { height, variance, row, .. } = met;
            sums.information += row * row.transpose() / variance;
            sums.gradient += row * (height / variance);
            sums.met += 1;
            sums.normalised.push(height / variance.sqrt());
            sums.score += 1.0 - (height / gate.max(f64::MIN_POSITIVE)).powi(2).min(1.0);
        }
        sums
    }

    /// The readings that meet the surface, nearer than a gate or so many σ.
    fn met(&self, pose: &Pose, readings: &[&Reading], gate: f64, scale_of_variance: f64) -> Vec<Met> {
        let thing_from_world = pose.inverse();
        let meet = |z: &&Reading| {
            let p = thing_from_world.apply(z.point);
            let facing = thing_from_world.rotate(z.normal);
            let place = add(p, self.middle);
            let start = self.search.nearest(place, facing);
            let foot = self.surface.project(place, start, &ProjectionOptions::default());
            let n = foot.normal;
            let leaf = foot.leaf as usize;
            if foot.at_border || !self.observed[leaf].is_measured() || dot(n, facing) < LEAST_COSINE {
                return None;
            }
            let of_reading = z.variance * scale_of_variance;
            let variance = of_reading + self.variances[leaf];
            if foot.height.abs() > gate.max(LAST_GATE * variance.sqrt()) {
                return None;
            }
            let turn = cross(p, n);
            Some(Met {
                leaf,
                local: foot.local,
                normal: n,
                height: foot.height,
                variance,
                of_reading,
                row: Vector6::from([turn[0], turn[1], turn[2], n[0], n[1], n[2]]),
            })
        };
        let met: Vec<Option<Met>> = readings.par_iter().with_min_len(64).map(meet).collect();
        met.into_iter().flatten().collect()
    }

    /// The covariance of a pose, errors of the surface included.
    fn covariance_on_surface(
        &self,
        pose: &Pose,
        readings: &[Reading],
        scale_of_variance: f64,
        prior: &Matrix6<f64>,
        inverse: &Matrix6<f64>,
    ) -> Result<Matrix6<f64>> {
        let space = self.surface.space();
        let mut moved = vec![0.0; 6 * self.directions.len()];
        let mut spread = *prior;
        let readings: Vec<&Reading> = readings.iter().collect();
        for met in self.met(pose, &readings, 0.0, scale_of_variance) {
            spread += met.row * met.row.transpose() * (met.of_reading / (met.variance * met.variance));
            let weights = leaf_weights(met.local[0], met.local[1]);
            let (nodes, extraction) = space.extraction(met.leaf);
            for (&node, e) in nodes.iter().zip(extraction) {
                let weight: f64 = e.iter().zip(&weights).map(|(e, w)| e * w).sum();
                let weight = weight * dot(met.normal, self.directions[node as usize]) / met.variance;
                for (sum, j) in moved[6 * node as usize..][..6].iter_mut().zip(met.row.iter()) {
                    *sum += weight * j;
                }
            }
        }
        let mut solved = moved.clone();
        self.factor.solve_in_place(&mut solved)?;
        for (a, b) in moved.chunks_exact(6).zip(solved.chunks_exact(6)) {
            spread += Vector6::from_row_slice(a) * Vector6::from_row_slice(b).transpose();
        }
        Ok(inverse * (0.5 * (spread + spread.transpose())) * inverse)
    }

    /// The pose of the thing in the world when a scan was taken.
    pub(crate) fn pose(&self, scan: usize) -> Option<Pose> {
        let known = self.known.iter().find(|known| known.scan == scan)?;
        Some(about_origin(&known.pose, self.middle))
    }

    /// σ of where a scanner stands in the thing's frame, and of its turn: the largest along any axis, with
    /// the arm from the middle.
    pub(crate) fn sigmas(&self, scan: usize, scanner: [f64; 3]) -> [f64; 2] {
        let known = self.known.iter().find(|known| known.scan == scan);
        let largest = |from: usize| {
            let variances =
                known.map_or([0.0; 3], |known| [0, 1, 2].map(|k| known.covariance[(from + k, from + k)]));
            WEAKER * variances.into_iter().fold(0.0, f64::max).sqrt()
        };
        let (turn, shift) = (largest(0), largest(3));
        let arm = norm(sub(scanner, self.middle));
        [(shift * shift + (arm * turn).powi(2)).sqrt(), turn]
    }

    /// Takes the poses that the fit of all scans found, and the steady motion that is nearest to them,
    /// `T(t) = exp(ξ t)`: `ξ = (Σ t² W)⁻¹ Σ t W log T(t)`, `W` the inverse of a pose's covariance.
    ///
    /// The poses stand on one surface and err alike. How much so is not known from their covariances one by
    /// one; that of `ξ` is of errors that are wholly common, the largest that it may be but for the turns of
    /// their axes.
    ///
    /// # Errors
    /// `Undetermined` where a covariance has no inverse.
    pub(crate) fn settle(&mut self, set: &ScanSet, poses: &[PoseReport]) -> Result<()> {
        let start = self.times[0];
        let (mut information, mut pull) = (Matrix6::zeros(), Vector6::zeros());
        let (mut roots, mut found) = (Matrix6::zeros(), 0);
        for (known, &time) in self.known.iter_mut().zip(&self.times).skip(1) {
            let report = &poses[known.scan];
            let Some((covariance, thing_from_scanner)) =
                report.covariance.zip(Pose::from_quaternion_xyzw(report.quaternion_xyzw, report.translation))
            else {
                continue;
            };
            let world_from_thing =
                set.scans[known.scan].scan.world_from_scanner.after(&thing_from_scanner.inverse());
            known.pose = about_origin(&world_from_thing, scale(-1.0, self.middle));
            // A scanner that is moved by E in the thing's frame moves the thing by E⁻¹: −ω, and −(τ + ω ×
            // arm) of the middle.
            let arm = sub(self.middle, thing_from_scanner.translation);
            let mut by = Matrix6::zeros();
            for axis in 0..3 {
                by[(axis, 3 + axis)] = -1.0;
                by[(3 + axis, axis)] = -1.0;
                let mut turn = [0.0; 3];
                turn[axis] = 1.0;
                for (k, moved) in cross(turn, arm).into_iter().enumerate() {
                    by[(3 + k, 3 + axis)] = -moved;
                }
            }
            known.covariance = by * Matrix6::from_fn(|a, b| covariance[a][b]) * by.transpose();
            let symmetric = 0.5 * (known.covariance + known.covariance.transpose());
            let weight = (symmetric.cholesky())
                .ok_or_else(|| Error::undetermined(format!("{}: its pose has no covariance", report.scan)))?
                .inverse();
            let eigen = symmetric.symmetric_eigen();
            let root = eigen.eigenvectors
                * Matrix6::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()))
                * eigen.eigenvectors.transpose();
            let since = time - start;
            information += weight * (since * since);
            pull += weight * log(&known.pose) * since;
            roots += weight * root * since;
            found += 1;
        }
        let Some(inverse) = information.cholesky().filter(|_| found > 0).map(|c| c.inverse()) else {
            return Ok(());
        };
        self.twist = inverse * pull;
        let common = inverse * roots;
        self.covariance.fixed_view_mut::<6, 6>(6, 6).copy_from(&(common * common.transpose()));
        Ok(())
    }

    /// What was found.
    pub(crate) fn report(&self, set: &ScanSet) -> Result<MotionReport> {
        let sigma = |k: usize| self.covariance[(k, k)].max(0.0).sqrt();
        let turn = [0, 1, 2].map(|k| self.twist[k]);
        let velocity = [3, 4, 5].map(|k| self.twist[k]);
        // σ of the length of a vector: that along it.
        let length = |first: usize, v: [f64; 3]| {
            let size = norm(v);
            let along = if size > 0.0 { scale(1.0 / size, v) } else { [1.0, 0.0, 0.0] };
            let variance: f64 = (0..9)
                .map(|k| along[k / 3] * along[k % 3] * self.covariance[(first + k / 3, first + k % 3)])
                .sum();
            [size, variance.max(0.0).sqrt()]
        };
        let rate = length(6, turn);
        let turns = rate[0] > 3.0 * rate[1];
        Ok(MotionReport {
            kind: "rigid".to_owned(),
            angular_velocity_deg_per_s: turn.map(f64::to_degrees),
            sigma_angular_velocity_deg_per_s: [6, 7, 8].map(|k| sigma(k).to_degrees()),
            velocity,
            sigma_velocity: [9, 10, 11].map(sigma),
            rate_deg_per_s: rate.map(f64::to_degrees),
            speed: length(9, velocity),
            middle: self.middle,
            axis_point: turns.then(|| add(self.middle, scale(1.0 / dot(turn, turn), cross(turn, velocity)))),
            poses: (self.known.iter().zip(&self.times))
                .map(|(known, &time_s)| {
                    let pose = about_origin(&known.pose, self.middle);
                    let sigma = |k: usize| known.covariance[(k, k)].max(0.0).sqrt();
                    MotionPose {
                        scan: set.scans[known.scan].scan.name.clone(),
                        time_s,
                        translation: pose.translation,
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

/// A motion that is given about a point, about the origin.
fn about_origin(pose: &Pose, middle: [f64; 3]) -> Pose {
    Pose { translation: add(pose.translation, sub(middle, pose.rotate(middle))), rotation: pose.rotation }
}

fn exp(twist: &Vector6<f64>) -> Pose {
    Pose::from_twist([twist[0], twist[1], twist[2]], [twist[3], twist[4], twist[5]])
}

fn log(pose: &Pose) -> Vector6<f64> {
    let (turn, shift) = pose.twist();
    Vector6::from([turn[0], turn[1], turn[2], shift[0], shift[1], shift[2]])
}

/// How a motion carries twists: `Ad = [[R, 0], [t × R, R]]`.
fn adjoint(pose: &Pose) -> Matrix6<f64> {
    let mut made = Matrix6::zeros();
    for j in 0..3 {
        let column = [0, 1, 2].map(|i| pose.rotation[i][j]);
        let moved = cross(pose.translation, column);
        for i in 0..3 {
            made[(i, j)] = column[i];
            made[(i + 3, j + 3)] = column[i];
            made[(i + 3, j)] = moved[i];
        }
    }
    made
}
