//! Patches a little off, brought together before they are merged.
//!
//! Comes in: patches in frames that agree but for small motions. Goes out: the same in the frame of the first, and the pose of each with its covariance.
//!
//! This is the registration of `fit --align`, not one of its own: the vertices of every patch are readings of one scan with the σ that the patch states, and one surface is fitted to all of them together with a motion of each patch but the first, point to plane, with readings beyond the gate left out. Since the surface is unknown like the motions, the covariance of a pose holds what the surface is not known to.
//!
//! Not guaranteed: that patches which stand more than a few percent of their size off are found; that σ of poses is true where the errors of a patch's vertices depend on one another, as they do after smoothing: they are then too small by about the root of how many vertices err alike.

use super::NamedPatch;
use crate::fit::{FitOptions, fit};
use crate::model::PoseReport;
use crate::progress::Progress;
use planish_estimate::{Error, Result};
use planish_exchange::{PosedScan, ScanSet, Unit};
use planish_sense::{Pose, Scan, Sensor, SensorKind};

/// Vertices of a patch that take part, at most.
const MOST_VERTICES: usize = 20_000;
/// Vertices of the spline that holds them together, at most: it is there for the poses.
const MOST_COEFFICIENTS: usize = 3_000;

/// Moves all patches but the first to where they fit, and says how.
///
/// # Errors
/// As [`fit`], in the context of alignment.
pub(super) fn aligned(
    patches: &mut [NamedPatch],
    unit: Option<Unit>,
    progress: &dyn Progress,
) -> Result<Vec<PoseReport>> {
    let mut set = ScanSet {
        unit,
        ..ScanSet::default()
    };
    for (k, named) in patches.iter().enumerate() {
        let mesh = &named.patch.mesh;
        let normals = mesh.vertex_normals();
        let step = mesh.positions.len().div_ceil(MOST_VERTICES).max(1);
        let chosen: Vec<usize> = (0..mesh.positions.len()).step_by(step).collect();
        let sigma = &named.patch.sigma;
        set.sensors.push(Sensor {
            name: named.name.clone(),
            kind: SensorKind::Range,
            ..Sensor::default()
        });
        set.scans.push(PosedScan {
            scan: Scan {
                name: named.name.clone(),
                points: chosen.iter().map(|v| mesh.positions[*v]).collect(),
                normals: Some(chosen.iter().map(|v| normals[*v]).collect()),
                sigma: (!sigma.is_empty()).then(|| chosen.iter().map(|v| sigma[*v]).collect()),
                ..Scan::default()
            },
            sensor: k,
            sigma_translation: None,
            sigma_rotation_deg: None,
        });
    }
    let options = FitOptions {
        align: true,
        max_coefficients: MOST_COEFFICIENTS,
        held_out_share: 0.0,
        ..FitOptions::default()
    };
    let found = fit(&set, &options, progress).map_err(|e| match e.kind() {
        planish_estimate::ErrorKind::Interrupted => e,
        _ => e.in_context("aligning the patches"),
    })?;
    let poses = found.report.poses;
    for (named, report) in patches.iter_mut().zip(&poses) {
        let pose = Pose::from_quaternion_xyzw(report.quaternion_xyzw, report.translation)
            .ok_or_else(|| Error::undetermined(format!("{}: no pose was found", named.name)))?;
        for p in &mut named.patch.mesh.positions {
            *p = pose.apply(*p);
        }
    }
    Ok(poses)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merge::{MergeOptions, PatchSet, merge};
    use crate::progress::Silent;
    use nalgebra::{Matrix6, Vector6};
    use planish_mesh::{Patch, TriangleMesh};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const SIGMA: f64 = 0.02;

    /// A part of a rolling sheet, its vertices off by σ, moved by a pose.
    fn patch(name: &str, from: f64, moved: &Pose, random: &mut ChaCha8Rng) -> NamedPatch {
        const SIDE: usize = 61;
        let positions: Vec<[f64; 3]> = (0..SIDE * SIDE)
            .map(|k| {
                let [x, y] = [from + (k % SIDE) as f64 * 0.66, (k / SIDE) as f64 * 0.66 - 20.0];
                let e: f64 = StandardNormal.sample(random);
                let z = 3.0 * (x / 6.0).sin() * (y / 7.0).cos() + 0.05 * x;
                moved.apply([x, y, z + SIGMA * e])
            })
            .collect();
        let mut triangles = Vec::new();
        for row in 0..SIDE - 1 {
            for column in 0..SIDE - 1 {
                let at = |i: usize, j: usize| ((row + i) * SIDE + column + j) as u32;
                triangles.push([at(0, 0), at(0, 1), at(1, 1)]);
                triangles.push([at(0, 0), at(1, 1), at(1, 0)]);
            }
        }
        let mesh = TriangleMesh { positions, triangles };
        let sigma = vec![SIGMA; mesh.positions.len()];
        let (patch, dropped, _) = Patch::tidy(&mesh, &sigma).unwrap();
        NamedPatch {
            name: name.to_owned(),
            patch,
            dropped,
            observed: Vec::new(),
        }
    }

    /// Patches that were shaken come back to where they belong to within the covariance of their poses, and merge; without that they do not.
    #[test]
    fn shaken_patches_come_back_within_their_sigma() {
        let shaken = Pose::from_rotation_vector([0.004, -0.006, 0.005], [0.3, -0.25, 0.35]);
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let set = PatchSet {
            patches: vec![
                patch("still", -30.0, &Pose::identity(), &mut random),
                patch("shaken", -12.0, &shaken, &mut random),
            ],
            unit: Some(Unit::Millimetre),
            ..PatchSet::default()
        };
        let options = MergeOptions {
            align: true,
            ..MergeOptions::default()
        };
        let merged = merge(set.clone(), &options, &Silent).unwrap();
        let poses = &merged.report.poses;
        assert_eq!((poses.len(), poses[0].translation), (2, [0.0; 3]));
        let truth = shaken.inverse();
        let found = Pose::from_quaternion_xyzw(poses[1].quaternion_xyzw, poses[1].translation).unwrap();
        let turn = found.after(&shaken);
        let rotation = Pose {
            translation: [0.0; 3],
            ..turn
        }
        .rotation_vector();
        let error = Vector6::from_fn(|k, _| match k {
            0..3 => found.translation[k] - truth.translation[k],
            _ => rotation[k - 3],
        });
        let covariance = poses[1].covariance.unwrap();
        let covariance = Matrix6::from_fn(|i, j| covariance[i][j]);
        let chi2 = (error.transpose() * covariance.try_inverse().unwrap() * error)[(0, 0)];
        // χ² of six: 22.5 is exceeded once in a thousand.
        assert!(chi2 < 22.5, "{chi2} {error:?}");
        assert!(error.fixed_rows::<3>(0).norm() < 0.02, "{error:?}");
        let apart = merged.report.regions[0].rms;
        assert!(apart < 2.0 * SIGMA, "{apart}");
        let left = merge(
            set,
            &MergeOptions {
                epsilon: Some(1.0),
                ..MergeOptions::default()
            },
            &Silent,
        )
        .unwrap();
        assert!(left.report.regions[0].rms > 4.0 * apart && left.report.poses.is_empty());
    }
}
