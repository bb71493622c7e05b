//! Equations of features tracked over views: a point on the surface, and a line of sight through it from
//! every view.
//!
//! In: pixels of one feature in several views. Out: equations between the poses of those views and the shell.
//!
//! The position `X` of the feature is a nuisance parameter. Its pixels give `π_v(X) = x_v` and the shell
//! gives `D(X) = 0`: `2 n + 1` equations, three of which determine `X`. It is eliminated by multiplying the
//! whitened equations with the left null space of their derivatives by `X` (A. Björck, *Numerical methods for
//! least squares problems*, 1996, on separable problems).
//!
//! Not guaranteed: there is no equation if the lines of sight are nearly parallel.

use super::equations::{ByVertex, Equations, Source};
use super::readings::FeatureTrack;
use crate::camera::Camera;
use crate::field::{FacetShare, Shell};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use planish_core::DVec3;

/// Maximum number of Gauss–Newton steps for the position of a feature.
const STEPS: usize = 10;

/// The point nearest to all lines of sight.
fn triangulated(track: &FeatureTrack, cameras: &[Camera]) -> Option<Vector3<f64>> {
    let (mut n, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for seen in &track.observations {
        let camera = &cameras[seen.view as usize];
        let way = Vector3::from(camera.direction(seen.pixel));
        let across = Matrix3::identity() - way * way.transpose();
        n += across;
        b += across * Vector3::from(camera.center());
    }
    let eigen = n.symmetric_eigenvalues();
    // Nearly parallel lines leave the depth open.
    (eigen.min() > 1e-6 * eigen.max()).then_some(())?;
    n.try_inverse().map(|inverse| inverse * b)
}

/// Whitened residuals and derivatives by the position; `None` behind a camera.
fn linearized(
    track: &FeatureTrack,
    cameras: &[Camera],
    shell: &Shell<'_>,
    at: &Vector3<f64>,
    shares: &mut Vec<FacetShare>,
) -> Option<(DVector<f64>, DMatrix<f64>, crate::field::ShellDistance)> {
    let rows = 2 * track.observations.len() + 1;
    let (mut residual, mut by_place) = (DVector::zeros(rows), DMatrix::zeros(rows, 3));
    for (k, seen) in track.observations.iter().enumerate() {
        let camera = &cameras[seen.view as usize];
        let (pixel, _) = camera.project((*at).into())?;
        let inside = camera.pinhole.in_camera((*at).into());
        let j = camera.pixel_by_place(inside) * camera.rotation();
        for axis in 0..2 {
            residual[2 * k + axis] = (pixel[axis] - seen.pixel[axis]) / seen.sigma_px;
            by_place.row_mut(2 * k + axis).copy_from(&(j.row(axis) / seen.sigma_px));
        }
    }
    let found = shell.distance((*at).into(), shares)?;
    residual[rows - 1] = found.distance / track.sigma_surface;
    let gradient = Vector3::from(found.gradient) / track.sigma_surface;
    by_place.row_mut(rows - 1).copy_from(&gradient.transpose());
    Some((residual, by_place, found))
}

/// Converts a derivative by a vertex of the wrapped mesh to derivatives by vertices of the deformed mesh.
type Give<'a> = dyn Fn(u32, DVec3, &mut Vec<ByVertex>) + 'a;

/// Adds the equations of one track. `slots` gives the index of each camera's pose in the state; `give`
/// converts derivatives to the deformed mesh.
pub(super) fn add(
    track: &FeatureTrack,
    index: u32,
    (cameras, slots): (&[Camera], &[Option<u32>]),
    shell: &Shell<'_>,
    shares: &mut Vec<FacetShare>,
    give: &Give<'_>,
    made: &mut Equations,
) -> Option<()> {
    let mut at = triangulated(track, cameras)?;
    let mut state = linearized(track, cameras, shell, &at, shares)?;
    for _ in 0..STEPS {
        let (residual, by_place, _) = &state;
        let normal: Matrix3<f64> = (by_place.tr_mul(by_place)).fixed_view::<3, 3>(0, 0).into_owned();
        let slope: Vector3<f64> = by_place.tr_mul(residual).fixed_view::<3, 1>(0, 0).into_owned();
        let step = -(normal.cholesky()?.solve(&slope));
        let next = at + step;
        let Some(tried) = linearized(track, cameras, shell, &next, shares) else {
            break;
        };
        if tried.0.norm_squared() > residual.norm_squared() * (1.0 + 1e-12) {
            break;
        }
        let done = residual.norm_squared() - tried.0.norm_squared() < 1e-12 * (1.0 + residual.norm_squared());
        at = next;
        state = tried;
        if done {
            break;
        }
    }
    // Once more at the final position, because `shares` may belong to a rejected step.
    let (residual, by_place, _) = linearized(track, cameras, shell, &at, shares)?;
    let found = shell.distance(at.into(), shares)?;
    // A full orthogonal basis: its columns beyond the third are the left null space.
    let rows = residual.len();
    let null = left_null_space(&by_place);
    let mut vertices = Vec::new();
    shell.by_vertices(at.into(), shares, &found, |vertex, by| give(vertex, by, &mut vertices));
    for column in 0..rows - 3 {
        let n = null.column(column);
        let on_surface = n[rows - 1] / track.sigma_surface;
        let mut own: Vec<(u32, DVec3)> =
            (vertices.iter()).map(|(vertex, by)| (*vertex, by.map(|x| on_surface * x))).collect();
        let mut poses = Vec::new();
        for (k, seen) in track.observations.iter().enumerate() {
            let Some(slot) = slots[seen.view as usize] else {
                continue;
            };
            let camera = &cameras[seen.view as usize];
            let inside = camera.pinhole.in_camera(at.into());
            let j = camera.pixel_by_place(inside);
            let way = (n[2 * k] * j.row(0) + n[2 * k + 1] * j.row(1)).transpose() / seen.sigma_px;
            // X_camera changes by ω × X + τ.
            let turn = Vector3::from(inside).cross(&way);
            poses.push((slot, [turn.x, turn.y, turn.z, way.x, way.y, way.z]));
        }
        made.push(Source::Track, index, (n.dot(&residual), 1.0), &mut own, &poses);
    }
    Some(())
}

/// Orthonormal columns orthogonal to those of a tall matrix of full rank.
fn left_null_space(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let (rows, columns) = matrix.shape();
    let mut wide = DMatrix::zeros(rows, rows + columns);
    wide.columns_mut(0, columns).copy_from(matrix);
    wide.columns_mut(columns, rows).fill_with_identity();
    let q = wide.qr().q();
    q.columns(columns, rows - columns).into_owned()
}
