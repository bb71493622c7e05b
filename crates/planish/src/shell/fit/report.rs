//! Report of a fitted shell.

use super::input::Frame;
use super::{CameraPoseReport, MIN_DATA_SHARE};
use planish_core::DVec3;
use planish_mesh::TriangleMesh;
use planish_shell::{Deformation, RowForms, ShellFit, VertexSupport};
use rayon::prelude::*;

/// `observed` of vertices that were measured but are not followed by the mesh.
const NOT_FOLLOWED: u8 = 3;

/// Normals of vertices, σ along them, and `observed`: 1 if points are near on this side of the sheet, or if,
/// from outlines, readings determine the vertex more than the prior. σ includes unresolved shape and the σ of
/// the start (`start_sigma`, one value per vertex or empty). A vertex without faces has no normal; σ is that
/// of its most uncertain coordinate.
pub(super) fn known(
    mesh: &TriangleMesh,
    made: &ShellFit,
    deformation: &dyn Deformation,
    start_sigma: &[f64],
) -> (Vec<DVec3>, Vec<f64>, Vec<u8>) {
    let linear = deformation.linearised_at(&made.parameters);
    let deformation = linear.as_deref().unwrap_or(deformation);
    let normals = mesh.vertex_normals();
    // The part of the variance that readings account for: with information `A = D + P` of data and prior,
    // `A⁻¹ = A⁻¹ D A⁻¹ + A⁻¹ P A⁻¹`.
    let by_data = &made.covariance * &made.data_information * &made.covariance;
    let variances = RowForms::new(deformation, &made.covariance);
    let by_data = RowForms::new(deformation, &by_data);
    let (sigma, observed) = (0..mesh.positions.len())
        .into_par_iter()
        .map(|v| {
            let variance_along = |direction: DVec3| variances.at(v as u32, direction).max(0.0);
            let direction = match normals[v] {
                DVec3::ZERO => most_uncertain(variance_along),
                normal => normal,
            };
            let variance = variance_along(direction);
            let share = by_data.at(v as u32, direction) / variance;
            let start = start_sigma.get(v).copied().unwrap_or(0.0);
            let lacking = made.unresolved_at(v as u32).powi(2) + start * start;
            // Outlines touch the surface along lines, so their support is a share of the information.
            let by_outlines = !made.outlines.outliers.is_empty() && share > MIN_DATA_SHARE;
            let observed = match made.support.get(v) {
                Some(VertexSupport::NotFollowed) => NOT_FOLLOWED,
                Some(VertexSupport::None) => u8::from(by_outlines),
                Some(VertexSupport::Points) => 1,
                None => u8::from(share > MIN_DATA_SHARE),
            };
            ((variance + lacking).sqrt(), observed)
        })
        .unzip();
    (normals, sigma, observed)
}

/// The axis along which a variance is the largest.
fn most_uncertain(variance_along: impl Fn(DVec3) -> f64) -> DVec3 {
    let [x, y, z] = DVec3::AXES;
    let larger = |a: DVec3, b: DVec3| if variance_along(a) >= variance_along(b) { a } else { b };
    larger(larger(x, y), z)
}

pub(super) fn poses(frame: &Frame, made: &ShellFit) -> Vec<CameraPoseReport> {
    let mut reports = Vec::new();
    for (v, covariance) in made.pose_covariances.iter().enumerate() {
        // Only cameras whose pose was stated as uncertain were moved.
        let Some(covariance) = covariance else { continue };
        let camera = &made.cameras[v];
        let change = camera.change_from(&frame.fitted[v].camera);
        let length = |c: &[f64]| c.iter().map(|x| x * x).sum::<f64>().sqrt();
        reports.push(CameraPoseReport {
            view: frame.views[v].name.clone(),
            turned_deg: length(&change[..3]).to_degrees(),
            moved: length(&change[3..]),
            r: camera.pinhole.r,
            t: camera.pinhole.t.to_array(),
            sigma_rotation_deg: std::array::from_fn(|k| covariance[(k, k)].sqrt().to_degrees()),
            sigma_translation: std::array::from_fn(|k| covariance[(3 + k, 3 + k)].sqrt()),
        });
    }
    reports
}
