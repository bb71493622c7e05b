//! Equations of landmarks, and the start that they give.
//!
//! In: places of the mesh with measured positions. Out: three equations each, `L⁻¹ (Σ_j w_j V_j − x) = 0`
//! with the covariance `L Lᵀ` of the position `x`; and parameters that bring the places near their positions.
//!
//! Points and outlines say where the surface is, but not where its vertices are along it. Landmarks do.
//!
//! In coarse stages landmarks are never rejected, because the mesh may be far from all of them.
//!
//! The start: the mesh is moved rigidly (W. Kabsch 1976, with weights `1/|residual|` so that a few confused
//! landmarks do not decide), then deformed by the landmarks alone. Of the mesh at rest and these two, the one
//! is chosen that is nearest to the points. With fewer than three landmarks, or with landmarks along a line,
//! the rotation is open, and the fit starts at the mesh as it is.

use super::equations::{Equations, Source};
use super::readings::{LandmarkReading, PointReading, ShellReadings};
use super::solve::solve;
use super::starts::{has_given_start, parameters_at};
use super::{ShellFitOptions, ShellProgress};
use crate::deformation::{Deformation, nearest_rotation};
use nalgebra::{Matrix3, Vector3};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::{MeshSearch, TriangleMesh};
use rayon::prelude::*;

/// Smallest ratio of the second to the first singular value of the places of landmarks that determine a
/// rotation.
const MIN_SPREAD: f64 = 0.01;
/// Approximate number of points by which starts are compared.
const SAMPLED_POINTS: usize = 1000;
/// Rounds of the robust alignment, and the smallest residual that increases a weight, as a share of the
/// distance of the landmarks from their centre.
const ALIGNMENT: (usize, f64) = (20, 0.01);
/// Floor of the variances of a position, as a share of their mean: it keeps weights finite.
const MIN_VARIANCE: f64 = 1e-9;

impl LandmarkReading {
    /// The place on a mesh whose vertices have these positions.
    #[must_use]
    pub fn place(&self, positions: &[DVec3]) -> DVec3 {
        let terms = self.vertices.iter().zip(self.weights);
        terms.fold(DVec3::ZERO, |sum, (v, weight)| sum + weight * positions[*v as usize])
    }

    /// σ along one axis, averaged over the axes.
    pub(super) fn sigma(&self) -> f64 {
        (self.covariance.trace() / 3.0).sqrt()
    }

    /// A matrix `W` with `Wᵀ W = Σ⁻¹`.
    fn whitening(&self) -> Matrix3<f64> {
        let s = self.covariance;
        let floor = MIN_VARIANCE * s.trace() / 3.0;
        let covariance =
            Matrix3::new(s.xx + floor, s.xy, s.xz, s.xy, s.yy + floor, s.yz, s.xz, s.yz, s.zz + floor);
        let factor = covariance.cholesky().and_then(|root| root.l().try_inverse());
        // The readings have been checked; a covariance that is not positive definite counts by its trace.
        factor.unwrap_or_else(|| Matrix3::identity() / self.sigma())
    }
}

/// The equations of all landmarks at the positions of the vertices.
pub(super) fn equations(landmarks: &[LandmarkReading], positions: &[DVec3], is_last: bool) -> Equations {
    let source = if is_last { Source::Landmark } else { Source::DistantLandmark };
    let mut made = Equations::default();
    let mut vertices = Vec::with_capacity(3);
    for (reading, landmark) in (0..).zip(landmarks) {
        let whitening = landmark.whitening();
        let residual = whitening * Vector3::from(landmark.place(positions) - landmark.at);
        for (k, distance) in residual.iter().enumerate() {
            let along = DVec3::new(whitening[(k, 0)], whitening[(k, 1)], whitening[(k, 2)]);
            vertices.extend((landmark.vertices.iter().zip(landmark.weights)).map(|(v, w)| (*v, w * along)));
            made.push(source, reading, (*distance, 1.0), &mut vertices, &[]);
        }
    }
    made
}

/// The options of a fit with the start that its landmarks give; unchanged without landmarks, or if a start is
/// given.
pub(super) fn with_landmark_start(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    readings: &ShellReadings<'_>,
    options: &ShellFitOptions,
    watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
) -> Result<ShellFitOptions> {
    let aligned =
        if has_given_start(options) { None } else { rigidly_aligned(&mesh.positions, readings.landmarks) };
    let Some(aligned) = aligned else { return Ok(options.clone()) };
    let misfit = |positions: &[DVec3]| median_distance(mesh, positions, readings.points);
    let (at_rest, after_motion) = (misfit(&mesh.positions)?, misfit(&aligned)?);
    let moved = Some(parameters_at(mesh, deformation, &aligned)?);
    // An energy that allows rotations refers to the mesh at rest; others count a rotation as roughness.
    let start = if options.rigidity.is_some() { None } else { moved.clone() };
    let given = options;
    let options = ShellFitOptions { start, initial: moved, ..given.clone() };
    let alone = ShellReadings { landmarks: readings.landmarks, ..ShellReadings::default() };
    let by_landmarks = ShellFitOptions { believe_sigma: true, ..options.clone() };
    let found =
        solve(mesh, deformation, &alone, &by_landmarks, &mut |at| watch(ShellProgress { share: 0.0, ..at }))?;
    let bent = misfit(&found.positions)?;
    // Without points all misfits are zero, and only landmarks say where the mesh is.
    if at_rest < after_motion.min(bent) {
        return Ok(given.clone());
    }
    let initial = if bent <= after_motion { Some(found.parameters) } else { options.initial };
    Ok(ShellFitOptions { initial, ..options })
}

/// Median distance of some points from a mesh whose vertices have other positions; zero without points.
pub(super) fn median_distance(
    mesh: &TriangleMesh,
    positions: &[DVec3],
    points: &[PointReading],
) -> Result<f64> {
    let moved = TriangleMesh { positions: positions.to_vec(), triangles: mesh.triangles.clone() };
    let search = MeshSearch::try_new(&moved)?;
    let step = points.len().div_ceil(SAMPLED_POINTS).max(1);
    let mut distances: Vec<f64> = (points.par_iter().step_by(step))
        .filter_map(|point| search.closest(point.at).map(|foot| foot.distance))
        .collect();
    distances.sort_unstable_by(f64::total_cmp);
    Ok(distances.get(distances.len() / 2).copied().unwrap_or(0.0))
}

/// Positions moved rigidly so that the places of landmarks are near their measured positions; `None` if these
/// do not determine the rotation.
fn rigidly_aligned(positions: &[DVec3], landmarks: &[LandmarkReading]) -> Option<Vec<DVec3>> {
    let mut weights: Vec<f64> = landmarks.iter().map(|l| l.sigma().powi(-2)).collect();
    let mut motion = weighted_motion(positions, landmarks, &weights)?;
    for _ in 0..ALIGNMENT.0 {
        let floor = ALIGNMENT.1 * motion.radius;
        for (weight, landmark) in weights.iter_mut().zip(landmarks) {
            let off = motion.apply(landmark.place(positions)).distance(landmark.at);
            *weight = 1.0 / off.max(floor);
        }
        motion = weighted_motion(positions, landmarks, &weights)?;
    }
    Some(positions.iter().map(|p| motion.apply(*p)).collect())
}

/// A rigid motion.
struct Motion {
    from: DVec3,
    to: DVec3,
    rotation: Matrix3<f64>,
    /// Root mean square distance of the landmarks from their centre.
    radius: f64,
}

impl Motion {
    fn apply(&self, at: DVec3) -> DVec3 {
        self.to + DVec3::from(self.rotation * Vector3::from(at - self.from))
    }
}

/// The motion of least squares for given weights.
fn weighted_motion(positions: &[DVec3], landmarks: &[LandmarkReading], weights: &[f64]) -> Option<Motion> {
    let total: f64 = weights.iter().sum();
    let mean = |of: &dyn Fn(&LandmarkReading) -> DVec3| {
        (landmarks.iter().zip(weights)).fold(DVec3::ZERO, |sum, (l, w)| sum + w / total * of(l))
    };
    let (from, to) = (mean(&|l| l.place(positions)), mean(&|l| l.at));
    let (mut products, mut spread) = (Matrix3::zeros(), Matrix3::zeros());
    for (landmark, weight) in landmarks.iter().zip(weights) {
        let at_rest = Vector3::from(landmark.place(positions) - from);
        products += weight / total * Vector3::from(landmark.at - to) * at_rest.transpose();
        spread += weight / total * at_rest * at_rest.transpose();
    }
    // The square roots of the eigenvalues are the singular values of the places.
    let mut squares = spread.symmetric_eigenvalues();
    squares.as_mut_slice().sort_unstable_by(|a, b| b.total_cmp(a));
    let is_determined = landmarks.len() > 2 && squares[1] > MIN_SPREAD * MIN_SPREAD * squares[0];
    let rotation = nearest_rotation(&products);
    is_determined.then(|| Motion { from, to, rotation, radius: spread.trace().sqrt() })
}
