//! Figures of sensors and of the poses of scans.

use super::Finishing;
use crate::fit::noise::{ResidualSums, SensorNoise};
use crate::model::{NodeCovariance, ScanPoseReport, SensorReport};
use crate::observe::{ProjectedReadings, Quantity};
use planish_core::{Finding, FindingCode};
use planish_estimate::Result;
use planish_exchange::ScanSet;

/// True if any scan states an uncertainty of its pose.
pub(in crate::fit) fn has_uncertain_pose(set: &ScanSet) -> bool {
    (set.scans.iter()).any(|posed| posed.sigma_translation.is_some() || posed.sigma_rotation_deg.is_some())
}

/// The poses of all scans as stated.
pub(in crate::fit) fn scan_pose_reports(set: &ScanSet) -> Vec<ScanPoseReport> {
    set.scans
        .iter()
        .map(|posed| ScanPoseReport {
            scan: posed.scan.name.clone(),
            translation: posed.scan.world_from_scanner.translation.to_array(),
            quaternion_xyzw: posed.scan.world_from_scanner.quaternion_xyzw(),
            sigma_translation: posed.sigma_translation,
            sigma_rotation_deg: posed.sigma_rotation_deg,
            ..ScanPoseReport::default()
        })
        .collect()
}

/// σ, residuals and counts of every sensor and quantity; `others` are the sums of further batches.
pub(super) fn sensor_reports(
    set: &ScanSet,
    readings: ProjectedReadings<'_>,
    information: &[f64],
    noise: &SensorNoise,
    others: &[ResidualSums],
) -> Vec<SensorReport> {
    let ProjectedReadings { observations, subset, feet } = readings;
    (observations.channels.iter().enumerate())
        .filter(|(c, channel)| !channel.inferred && observations.scans.channel.contains(c))
        .map(|(c, channel)| {
            let (mut count, mut square, mut stated) =
                others.get(c).map_or((0, 0.0, 0.0), |o| (o.count, o.square, o.variance));
            for ((&i, foot), &w) in subset.iter().zip(feet).zip(information) {
                if w > 0.0 && observations.channel(i as usize) == c {
                    count += 1;
                    square += foot.extremes().1 / foot.residuals().len() as f64;
                    stated += foot.variance;
                }
            }
            let n = count.max(1) as f64;
            // Where σ differs from point to point, its root mean square along the normals stands for it.
            let typical = (stated / n).sqrt();
            // Reports state σ of normals in degrees, as files do.
            let in_unit = match channel.quantity {
                Quantity::Normal => 1.0_f64.to_degrees(),
                Quantity::Position | Quantity::Curvature => 1.0,
            };
            SensorReport {
                name: set.sensors[channel.sensor].name.clone(),
                quantity: channel.quantity.name().to_owned(),
                observations: count,
                sigma_stated: observations.channels[c].stated.then_some(in_unit * typical),
                sigma_estimated: in_unit * noise.estimated_factors[c].sqrt() * typical,
                sigma_shared: Some(noise.shared_share[c])
                    .filter(|share| *share > 0.0)
                    .map(|share| in_unit * share.sqrt() * typical),
                rms: in_unit * (square / n).sqrt(),
                sigma_used_is_estimated: !observations.channels[c].stated || noise.is_contradicted[c],
            }
        })
        // A sensor of normals or curvatures has places, but they are not position readings.
        .filter(|report| {
            report.observations > 0
                || set.sensors.iter().any(|s| s.name == report.name && s.kind.measures_positions())
        })
        .collect()
}

impl Finishing<'_> {
    /// The pose of every scan, with its estimate where it was unknown; directions that stay open are added
    /// to the findings.
    pub(super) fn poses(
        &self,
        covariance: &NodeCovariance,
        stated: &[f64],
        findings: &mut Vec<Finding>,
    ) -> Result<Vec<ScanPoseReport>> {
        let mut poses = scan_pose_reports(self.set);
        let Some(bordered) = covariance.scan_errors() else {
            return Ok(poses);
        };
        for estimate in self.observations.scan_errors.estimates(bordered, stated)? {
            let pose = &mut poses[estimate.scan];
            estimate.report(pose, self.origin, &self.observations.readings);
            if !pose.undetermined.is_empty() {
                findings.push(Finding::new(
                    FindingCode::PoseUndetermined,
                    format!(
                        "the readings do not determine {} of the six directions of the pose of {} (see \
                         `undetermined` of the pose in the JSON object); the object may be symmetric, or \
                         the scan small or flat",
                        pose.undetermined.len(),
                        pose.scan
                    ),
                ));
            }
        }
        Ok(poses)
    }
}
