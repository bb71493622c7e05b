//! Matching of a scan's readings to the surface of the scans before it.

use super::tracker::{LAST_GATE, MatchedReading, NormalEquations, Reading, RigidTracker, exp};
use nalgebra::{Matrix6, Vector6};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_sense::Pose;
use planish_spline::{ProjectionOptions, leaf_weights};
use rayon::prelude::*;

use super::tracker::FIRST_GATE;

/// Number of readings that the search for a start uses, and number of steps from each start. Nineteen starts
/// are compared, so each of them has to be cheap.
const START_READINGS: usize = 300;
const START_STEPS: usize = 6;
/// Rotations about each axis from which the search starts, in degrees. Their range limits the rotation
/// between two scans that is found, and their number the cost of the search.
const START_TURNS_DEG: [f64; 6] = [-32.0, -21.0, -10.0, 10.0, 21.0, 32.0];
/// Minimum cosine between the normals of a reading and of the surface at its foot. A smaller one would match
/// the other side of thin parts; a larger one would reject correct readings while the pose is still wrong.
const MIN_COSINE: f64 = 0.5;

impl RigidTracker {
    /// Searches for the pose of the second scan, while the velocity is unknown: the start from which most
    /// readings come near the surface.
    pub(super) fn start(&self, readings: &[Reading]) -> Pose {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        let turns = axes.into_iter().flat_map(|axis| {
            START_TURNS_DEG.map(|deg| Pose::from_twist(deg.to_radians() * axis, DVec3::ZERO))
        });
        let starts: Vec<Pose> = std::iter::once(Pose::identity()).chain(turns).collect();
        let sample: Vec<&Reading> =
            readings.iter().step_by(readings.len().div_ceil(START_READINGS)).collect();
        let gate = FIRST_GATE * self.size;
        // All starts run in parallel; the fold below prefers the first of equal scores at any number of
        // threads.
        let tried: Vec<(f64, Pose)> = starts
            .into_par_iter()
            .map(|turn| {
                let mut pose = turn;
                for _ in 0..START_STEPS {
                    let sums = self.step_over(&pose, sample.iter().copied(), gate, 1.0);
                    let Some(factor) = (sums.information + self.damping()).cholesky() else {
                        break;
                    };
                    pose = pose.after(&exp(&factor.solve(&sums.gradient)));
                }
                // A narrower gate for the score separates poses on the surface from those that only come
                // near.
                let sums = self.step_over(&pose, sample.iter().copied(), 0.15 * gate, 1.0);
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

    /// Information that makes the equations regular and is negligible compared with that of any reading.
    pub(super) fn damping(&self) -> Matrix6<f64> {
        let shift = self.size.powi(-2);
        Matrix6::from_diagonal(&Vector6::from([1.0, 1.0, 1.0, shift, shift, shift]))
    }

    pub(super) fn step(
        &self,
        pose: &Pose,
        readings: &[Reading],
        gate: f64,
        scale_of_variance: f64,
    ) -> NormalEquations {
        self.step_over(pose, readings.iter(), gate, scale_of_variance)
    }

    /// The normal equations at a pose. Readings nearer than the length `gate`, or than [`LAST_GATE`] σ, take
    /// part.
    fn step_over<'r>(
        &self,
        pose: &Pose,
        readings: impl Iterator<Item = &'r Reading>,
        gate: f64,
        scale_of_variance: f64,
    ) -> NormalEquations {
        let mut sums = NormalEquations {
            information: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            matched: 0,
            score: 0.0,
            normalised: Vec::new(),
        };
        // Matching runs in parallel, but the sums are made in order: they must not depend on the threads.
        let readings: Vec<&Reading> = readings.collect();
        for met in self.matched(pose, &readings, gate, scale_of_variance) {
            let MatchedReading { height, variance, row, .. } = met;
            sums.information += row * row.transpose() / variance;
            sums.gradient += row * (height / variance);
            sums.matched += 1;
            sums.normalised.push(height / variance.sqrt());
            // A truncated parabola: readings beyond the gate neither help nor harm a start.
            sums.score += 1.0 - (height / gate.max(f64::MIN_POSITIVE)).powi(2).min(1.0);
        }
        sums
    }

    /// The readings that match the surface: see [`Self::step_over`].
    fn matched(
        &self,
        pose: &Pose,
        readings: &[&Reading],
        gate: f64,
        scale_of_variance: f64,
    ) -> Vec<MatchedReading> {
        let object_from_world = pose.inverse();
        let meet = |z: &&Reading| {
            let p = object_from_world.apply(z.point);
            let facing = object_from_world.rotate(z.normal);
            let place = p + self.middle;
            let start = self.reference.search.nearest(place, facing);
            let foot = self.reference.surface.project(place, start, &ProjectionOptions::default());
            let n = foot.normal;
            let leaf = foot.leaf as usize;
            // Beyond the part that was measured, or on the other side of the object, there is
            // nothing to match.
            if foot.at_border || !self.reference.observed[leaf].is_measured() || n.dot(facing) < MIN_COSINE {
                return None;
            }
            // The error of the surface counts as well: see the documentation of `super`.
            let reading_variance = z.variance * scale_of_variance;
            let variance = reading_variance + self.reference.variances[leaf];
            if foot.height.abs() > gate.max(LAST_GATE * variance.sqrt()) {
                return None;
            }
            let turn = p.cross(n);
            Some(MatchedReading {
                leaf,
                local: foot.local,
                normal: n,
                height: foot.height,
                variance,
                reading_variance,
                row: Vector6::from([turn[0], turn[1], turn[2], n[0], n[1], n[2]]),
            })
        };
        let met: Vec<Option<MatchedReading>> = readings.par_iter().with_min_len(64).map(meet).collect();
        met.into_iter().flatten().collect()
    }

    /// The covariance of a pose, with the errors of the surface included.
    pub(super) fn covariance_on_surface(
        &self,
        pose: &Pose,
        readings: &[Reading],
        scale_of_variance: f64,
        prior: &Matrix6<f64>,
        inverse: &Matrix6<f64>,
    ) -> Result<Matrix6<f64>> {
        let space = self.reference.surface.space();
        let mut moved = vec![0.0; 6 * self.reference.directions.len()];
        let mut spread = *prior;
        let readings: Vec<&Reading> = readings.iter().collect();
        for met in self.matched(pose, &readings, 0.0, scale_of_variance) {
            spread += met.row * met.row.transpose() * (met.reading_variance / (met.variance * met.variance));
            let weights = leaf_weights(met.local[0], met.local[1]);
            for (unknown, e) in space.unknowns(met.leaf) {
                let weight: f64 = e.iter().zip(&weights).map(|(e, w)| e * w).sum();
                let weight =
                    weight * met.normal.dot(self.reference.directions[unknown as usize]) / met.variance;
                for (sum, j) in moved[6 * unknown as usize..][..6].iter_mut().zip(met.row.iter()) {
                    *sum += weight * j;
                }
            }
        }
        // `moved` is A, six columns for each displacement; the loop adds AᵀΣA with Σ = Λ⁻¹ from the factor.
        let mut solved = moved.clone();
        self.reference.factor.solve_in_place(&mut solved)?;
        for (a, b) in moved.chunks_exact(6).zip(solved.chunks_exact(6)) {
            spread += Vector6::from_row_slice(a) * Vector6::from_row_slice(b).transpose();
        }
        // Rounding makes the sums slightly asymmetric.
        Ok(inverse * (0.5 * (spread + spread.transpose())) * inverse)
    }
}
