//! Report of a fitted shell.

use super::input::Frame;
use super::{CameraPoseReport, MIN_DATA_SHARE};
use planish_core::DVec3;
use planish_mesh::TriangleMesh;
use planish_shell::{Deformation, ShellFit, VertexSupport, parameter_row};
use rayon::prelude::*;

/// `observed` of vertices that were measured but are not followed by the mesh.
const NOT_FOLLOWED: u8 = 3;

/// Normals of vertices, σ along them, and `observed`: 1 if points are near on this side of the sheet, or if,
/// from outlines, readings determine the vertex more than the prior. σ includes unresolved shape and the σ of
/// the start (`start_sigma`, one value per vertex or empty).
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
    let (sigma, observed) = (0..mesh.positions.len())
        .into_par_iter()
        .map(|v| {
            let row = parameter_row(deformation, v as u32, normals[v]);
            let variance = row.dot(&(&made.covariance * &row)).max(0.0);
            let share = row.dot(&(&by_data * &row)) / variance;
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
