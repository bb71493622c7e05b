//! Estimated poses and biases with their covariances, and their report.

mod finite_rotation;

use super::{BIAS, MAX_STEP, MIN_VARIANCE_REDUCTION, ScanErrors};
use crate::model::ScanPoseReport;
use crate::observe::ReadingColumns;
use finite_rotation::add_finite_rotation;
use planish_core::DVec3;
use planish_estimate::Result;
use planish_estimate::sparse::Bordered;
use planish_sense::Pose;

/// The estimate of one scan's pose and bias.
#[derive(Debug, Clone)]
pub(crate) struct ScanErrorEstimate {
    pub scan: usize,
    /// The stated and the estimated pose.
    stated: Pose,
    pub pose: Pose,
    /// Covariance of translation and rotation vector about the world's axes; none if the pose is exact.
    pub covariance: Option<[[f64; 6]; 6]>,
    /// Directions that the readings do not determine, each as long as one σ of the prior. σ of a free pose
    /// must be below [`MAX_STEP`] of its prior's: the covariance is linearised.
    pub undetermined: Vec<[f64; 6]>,
    /// The bias and its σ.
    pub bias: Option<(f64, f64)>,
}

impl ScanErrorEstimate {
    /// Fills in the report of the scan; `origin` is the world position of the origin of the estimate.
    pub(crate) fn report(&self, report: &mut ScanPoseReport, origin: DVec3, readings: &ReadingColumns) {
        if let Some(covariance) = &self.covariance {
            // The motion is reported at the readings: the translation of a pose depends on where the
            // scanner has its origin.
            let back = self.stated.after(&self.pose.inverse());
            let own = (readings.points.iter().zip(&readings.scan)).filter(|(_, s)| **s as usize == self.scan);
            let (sum, count) = own.fold((0.0, 0), |(sum, count), (p, _)| {
                (sum + back.apply(*p).distance(*p).powi(2), count + 1)
            });
            report.moved = Some((sum / f64::from(count.max(1))).sqrt());
            report.turned_deg = Some(back.rotation_vector().length().to_degrees());
            report.translation = (self.pose.translation + origin).to_array();
            report.quaternion_xyzw = self.pose.quaternion_xyzw();
            report.set_covariance(*covariance);
            report.undetermined.clone_from(&self.undetermined);
        }
        if let Some((bias, sigma)) = self.bias {
            (report.bias, report.sigma_bias) = (Some(bias), Some(sigma));
        }
    }
}

impl ScanErrors {
    /// Pose, bias and covariance of every scan, from the equations reduced by the vertices.
    pub(crate) fn estimates(&self, bordered: &Bordered, prior: &[f64]) -> Result<Vec<ScanErrorEstimate>> {
        let covariance = bordered.shared_covariance();
        let width = bordered.shared();
        // Unknowns of earlier sessions come first; their scans are not among those of this set.
        let mut start = self.earlier_width();
        (self.errors.iter())
            .map(|error| {
                let j = error.derivative();
                let m = error.width();
                // Covariance of the deviation from the stated pose, in the terms of a job file.
                let covariance_of = |a: usize, b: usize| -> f64 {
                    let (rows, columns) = (&j[a], &j[b]);
                    (0..m)
                        .flat_map(|p| (0..m).map(move |q| (p, q)))
                        .map(|(p, q)| {
                            rows[error.unknowns[p]]
                                * covariance[(start + p) * width + start + q]
                                * columns[error.unknowns[q]]
                        })
                        .sum()
                };
                let mut pose: [[f64; 6]; 6] =
                    std::array::from_fn(|a| std::array::from_fn(|b| covariance_of(a, b)));
                add_finite_rotation(&mut pose);
                let own: Vec<f64> =
                    (0..m * m).map(|k| prior[(start + k / m) * width + start + k % m]).collect();
                // The prior of a free pose only makes the equations solvable, so being better than it is not
                // enough. A stated σ is information.
                let reduction = match error.is_free {
                    true => 1.0 - MAX_STEP * MAX_STEP,
                    false => MIN_VARIANCE_REDUCTION,
                };
                let directions = bordered.undetermined(start..start + m, &own, reduction)?;
                let of_pose = |v: &Vec<f64>| -> [f64; 6] {
                    std::array::from_fn(|a| error.unknowns.iter().zip(v).map(|(&k, v)| j[a][k] * v).sum())
                };
                let made = ScanErrorEstimate {
                    scan: error.scan,
                    stated: error.stated,
                    pose: error.now,
                    covariance: error.moves().then_some(pose),
                    undetermined: directions.iter().map(of_pose).collect(),
                    bias: (error.unknowns.contains(&BIAS))
                        .then(|| (error.bias, covariance_of(BIAS, BIAS).max(0.0).sqrt())),
                };
                start += m;
                Ok(made)
            })
            .collect()
    }
}
