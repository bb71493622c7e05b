//! Fits from other starts, for meshes whose parts turned far.
//!
//! In: a fit that does not follow its points. Out: the best of it and of fits that start from poses in which
//! parts are turned ([`crate::articulation`]).
//!
//! Fits are compared by χ², in which rejected points count as much as the gate of the outliers
//! ([`super::comparison`]).
//!
//! Not guaranteed: the global optimum.

use super::comparison::is_better;
use super::dense::Factor;
use super::landmarks::with_landmark_start;
use super::solve::solve;
use super::{ShellFit, ShellFitOptions, ShellProgress, ShellReadings, undetermined};
use crate::articulation::far_pose;
use crate::deformation::{Deformation, displacements, parameter_row};
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::TriangleMesh;

/// Share of the points that agree with their neighbours but not with the mesh, from which a fit does not
/// follow them. Fits in the right position have less (`benches/peers/deformation.py`).
const MAX_UNFOLLOWED: f64 = 0.01;
/// The same, from which another start is tried. Fewer may be shape that 60 controls cannot represent.
const MIN_UNFOLLOWED_OF_TURNS: f64 = 0.02;
/// Share of the mesh's area that is strained, from which another start is tried ([`super::strain`]).
const MIN_STRAINED: f64 = 0.05;
/// Maximum number of vertices that determine the parameters of a pose.
const POSE_VERTICES: usize = 800;
/// Iterations that determine the parameters of a pose; one is enough for linear deformations.
const POSE_ITERATIONS: usize = 8;
/// Share of the mean information that is added to each parameter, for those that no vertex determines.
const POSE_DAMPING: f64 = 1e-6;

/// Fits the mesh from the start of the options, and from another pose if that does not follow the points.
pub(super) fn solve_from_starts(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    readings: &ShellReadings<'_>,
    options: &ShellFitOptions,
    watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
) -> Result<ShellFit> {
    let near = with_landmark_start(mesh, deformation, readings, options, watch)?;
    let first = solve(mesh, deformation, readings, &near, watch)?;
    let Some(pose) = other_start(mesh, readings, options, &first)? else { return Ok(first) };
    let initial = Some(parameters_at(mesh, deformation, &pose)?);
    let options = ShellFitOptions { initial, ..options.clone() };
    let other = solve(mesh, deformation, readings, &options, &mut |at| {
        watch(ShellProgress { iteration: first.iterations + at.iteration, ..at })
    })?;
    let iterations = first.iterations + other.iterations;
    Ok(ShellFit { iterations, ..if is_better(&other, &first, 0) { other } else { first } })
}

/// Positions of the vertices in a pose from which the fit may follow its points, if it does not.
pub(super) fn other_start(
    mesh: &TriangleMesh,
    readings: &ShellReadings<'_>,
    options: &ShellFitOptions,
    fit: &ShellFit,
) -> Result<Option<Vec<DVec3>>> {
    // A start that is given, or a prior, says where the mesh is. Only an energy that allows rotations keeps
    // parts in their new pose.
    let is_right = unfollowed_share(fit) < MIN_UNFOLLOWED_OF_TURNS && fit.strained_share < MIN_STRAINED;
    if options.rigidity.is_none() || has_given_start(options) || is_right {
        return Ok(None);
    }
    let points: Vec<DVec3> = readings.points.iter().map(|p| p.at).collect();
    far_pose(mesh, &points)
}

/// True if the options say where the mesh is.
pub(super) fn has_given_start(options: &ShellFitOptions) -> bool {
    let vectors = [&options.start, &options.initial];
    vectors.iter().any(|q| q.is_some()) || options.resume.is_some() || options.prior.is_some()
}

/// True if few points agree with their neighbours but not with the mesh.
pub(super) fn follows(fit: &ShellFit) -> bool {
    unfollowed_share(fit) < MAX_UNFOLLOWED
}

fn unfollowed_share(fit: &ShellFit) -> f64 {
    fit.unfollowed_points as f64 / fit.points.outliers.len().max(1) as f64
}

/// The parameters that move the vertices of the mesh nearest to given positions (least squares).
pub(super) fn parameters_at(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    positions: &[DVec3],
) -> Result<DVector<f64>> {
    let step = positions.len().div_ceil(POSE_VERTICES).max(1);
    let chosen: Vec<usize> = (0..positions.len()).step_by(step).collect();
    let mut q = DVector::zeros(deformation.parameters());
    for _ in 0..POSE_ITERATIONS {
        let moved = displacements(deformation, &q);
        let linear = deformation.linearised_at(&q);
        let rows = linear.as_deref().unwrap_or(deformation);
        let mut equations = DMatrix::zeros(3 * chosen.len(), q.len());
        let mut residuals = DVector::zeros(3 * chosen.len());
        for (i, &v) in chosen.iter().enumerate() {
            let off = positions[v] - mesh.positions[v] - moved[v];
            for (k, axis) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
                equations.row_mut(3 * i + k).tr_copy_from(&parameter_row(rows, v as u32, axis));
                residuals[3 * i + k] = off[k];
            }
        }
        let mut information = equations.tr_mul(&equations);
        let damping = POSE_DAMPING * information.trace() / q.len() as f64;
        (0..q.len()).for_each(|k| information[(k, k)] += damping);
        let change = Factor::new(&information).ok_or_else(undetermined)?.solve(&equations.tr_mul(&residuals));
        q += &change;
        if linear.is_none() {
            break;
        }
    }
    Ok(q)
}
