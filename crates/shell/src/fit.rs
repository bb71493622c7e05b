//! Fits a shell to readings: moves control points until the mesh passes through noisy points and touches the
//! lines of sight of outlines.
//!
//! In: a mesh, a deformation, points with covariances, views with outlines, features tracked over views,
//! places of the mesh with measured positions. Out:
//! the parameters, the camera poses, their covariance, estimated factors on the stated σ, and the outliers
//! among the readings.
//!
//! Every reading is an equation ([`problem`]); there is no search for correspondences. The fit minimises
//!
//! `Σ ρ(D_i/σ_i) + λ/2 · qᵀ K q`, and `½ δᵀ Σ⁻¹ δ` for every pose that is uncertain,
//!
//! with a redescending loss `ρ` (the paper's field saturates far away and so rejects outliers by itself; a
//! distance does not) and `λ` by marginal likelihood ([`smoothness`]). The σ of points, outlines and tracks
//! are each scaled by a factor estimated from the residuals, corrected for the degrees of freedom. The
//! sharpness `k` increases in stages: coarse fields bridge gaps and thin parts, sharp ones are exact.
//!
//! In the last stage every sheet near a point has its own equation, weighted by the probability that the
//! point belongs to it ([`sheets`]).
//!
//! Pixels inside and outside of masks contribute to the sum while they are violated, but not to the
//! covariance: a satisfied inequality carries no information.
//!
//! For outlines, parts whose facets face inwards are turned first ([`orientation`]).
//!
//! Not guaranteed: the global optimum. A mesh that starts more than a tenth of its size away may be attracted
//! to the wrong side of a thin part.

mod comparison;
mod correlation;
mod dense;
mod equations;
mod folds;
mod growth;
mod interpolation;
mod landmarks;
mod orientation;
mod point_selection;
mod priors;
mod problem;
mod readings;
mod residual_leverage;
mod result;
mod roundness;
mod sequence;
mod sheets;
mod sight;
mod smoothness;
mod solve;
mod starts;
mod strain;
mod support;
mod tracks;
mod weight_spread;

pub use readings::{
    FeatureObservation, FeatureTrack, LandmarkReading, OutlineKind, OutlinePoint, PointReading, PoseNoise,
    ShellReadings, ShellView,
};

pub use growth::{ControlGrowth, ControlledDeformation, GrownFit, fit_with_growing_controls};
pub use roundness::FacetRoundness;
pub use sequence::smoothing::SmoothedMotion;
pub use sequence::{FrameFit, ShellTracker};
pub use support::{VertexResiduals, VertexSupport};

use crate::camera::Camera;
use crate::deformation::{Deformation, parameter_row};
use crate::field::Metaball;
use crate::rigidity::Rigidity;
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use planish_estimate::{Error, Loss, Result, Termination};
use planish_mesh::TriangleMesh;

/// Largest number of parameters. The equations are dense, so memory grows with the square and time with the
/// cube.
const MAX_PARAMETERS: usize = 6000;

/// Options of a shell fit.
///
/// # Examples
/// ```
/// use planish_shell::{Metaball, ShellFitOptions};
/// let options = ShellFitOptions { steps: 5, ..ShellFitOptions::default() };
/// assert_eq!(options.metaball, Metaball::Triangular);
/// assert!(!options.believe_sigma);
/// ```
#[derive(Debug, Clone)]
pub struct ShellFitOptions {
    /// What the metaballs are built around (default: whole facets).
    pub metaball: Metaball,
    /// Thickness `1/k` of the field in the first and in the last stage, as a share of the mesh's diagonal.
    pub softness: (f64, f64),
    /// Number of stages, from the first softness to the last.
    pub steps: usize,
    /// Maximum number of iterations in each stage.
    pub iterations: usize,
    /// Loss of normalised residuals (default: Tukey).
    pub loss: Loss,
    /// If true, the stated σ are used as they are; if false, a common factor is estimated for each kind of
    /// reading.
    pub believe_sigma: bool,
    /// Stiffness `K` of all parameters, the energy of rough displacements; `None` for no smoothness.
    pub stiffness: Option<DMatrix<f64>>,
    /// Energy of the controls, instead of the stiffness, that does not penalise rotations of parts. The first
    /// parameters are the displacements of its points.
    pub rigidity: Option<Rigidity>,
    /// Initial parameters; smoothness applies to displacements from them. Default: the prior's mean, or zero.
    pub start: Option<DVector<f64>>,
    /// Parameters at which the iterations begin, if other than `start`; smoothness applies to displacements
    /// from `start`.
    pub initial: Option<DVector<f64>>,
    /// σ of the initial position of each control, in the unit of the mesh, if the start is known to be near.
    ///
    /// It limits the smoothness weight to what displacements of this size allow, and the first stage has no
    /// extra stiffness without a rigidity. Use it for a start computed from the readings themselves: its
    /// agreement with them is no evidence that it is correct.
    pub start_sigma: Option<f64>,
    /// State from which the fit continues. It skips the coarsest fields.
    pub resume: Option<ResumePoint>,
    /// Prior of the parameters.
    pub prior: Option<ParameterPrior>,
    /// Maximum number of facets into which a mesh is subdivided for spherical metaballs.
    pub max_facets: usize,
}

impl Default for ShellFitOptions {
    fn default() -> Self {
        Self {
            metaball: Metaball::Triangular,
            softness: (0.01, 0.001),
            steps: 3,
            iterations: 12,
            loss: Loss::tukey(),
            believe_sigma: false,
            stiffness: None,
            rigidity: None,
            start: None,
            initial: None,
            start_sigma: None,
            resume: None,
            prior: None,
            max_facets: 200_000,
        }
    }
}

/// State of an earlier fit.
#[derive(Debug, Clone, PartialEq)]
pub struct ResumePoint {
    /// The parameters. Smoothness still applies to displacements from [`ShellFitOptions::start`].
    pub parameters: DVector<f64>,
    /// The cameras of the views.
    pub cameras: Vec<Camera>,
    /// The smoothness weight `λ`, a start for its estimation.
    pub smoothness_weight: f64,
}

/// Gaussian prior of the parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterPrior {
    /// The mean; also the start of the fit unless [`ShellFitOptions::start`] is given.
    pub mean: DVector<f64>,
    /// The inverse of the covariance.
    pub information: DMatrix<f64>,
}

/// Residuals of one kind of readings after the fit.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceFit {
    /// Ratio of the σ that the residuals indicate to the stated σ. The fit used it unless the stated σ hold
    /// ([`ShellFitOptions::believe_sigma`]).
    pub sigma_factor: f64,
    /// Root mean square of the residuals of the inliers: distances of points, pixels of outlines, multiples
    /// of σ of tracks, distances of landmarks along each axis.
    pub rms: f64,
    /// For each reading, true if its weight is (nearly) zero or it has no equation.
    pub outliers: Vec<bool>,
}

/// A fitted shell.
#[derive(Debug, Clone)]
pub struct ShellFit {
    /// The parameters.
    pub parameters: DVector<f64>,
    /// Their covariance. Readings with correlated residuals count as fewer independent ones.
    pub covariance: DMatrix<f64>,
    /// Cameras of the views.
    pub cameras: Vec<Camera>,
    /// Covariance of each pose, rotation and translation as in [`Camera::moved`]; `None` if the pose was
    /// known.
    pub pose_covariances: Vec<Option<DMatrix<f64>>>,
    /// Vertices of the deformed mesh.
    pub positions: Vec<DVec3>,
    /// Smoothness weight `λ`.
    pub smoothness_weight: f64,
    /// σ along the normal of shape that the parameters cannot represent; zero if the residuals are noise.
    ///
    /// It is estimated from the correlation of neighbouring residuals. It belongs to the surface, so the
    /// covariance of the parameters does not include it.
    pub unresolved_shape: f64,
    /// The same at each vertex, at least the error of interpolation between controls; empty for fits without
    /// points.
    pub unresolved_at: Vec<f64>,
    /// How points support each vertex; empty for fits without points.
    pub support: Vec<VertexSupport>,
    /// Residuals of the points around each vertex; empty for fits without points.
    pub residuals_at: Vec<VertexResiduals>,
    /// Number of points that the fit rejected although they agree with their neighbours: surface that the
    /// mesh does not follow.
    pub unfollowed_points: usize,
    /// Share of the mesh's area that is stretched in one direction more than twice as much as in the other,
    /// relative to the mesh at rest or in the pose that was found for its parts.
    pub strained_share: f64,
    /// How far the surface bulges over the facets; `None` for fits without points.
    pub facet_roundness: Option<FacetRoundness>,
    /// Points.
    pub points: SourceFit,
    /// Outline points, one view after the other.
    pub outlines: SourceFit,
    /// Tracks; an outlier is one without any inlying equation.
    pub tracks: SourceFit,
    /// Landmarks; one with any outlying coordinate is an outlier. Its factor is at least 1.
    pub landmarks: SourceFit,
    /// Information of the readings about the parameters, without priors, marginalised over the poses.
    pub data_information: DMatrix<f64>,
    /// The information times the parameters that the readings alone favour.
    pub data_vector: DVector<f64>,
    /// Why the iterations ended.
    pub termination: Termination,
    /// Total number of iterations.
    pub iterations: usize,
}

/// Fits a mesh to points. The crate's front page has an example.
///
/// # Errors
/// As [`fit_shell`].
pub fn fit_points(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    points: &[PointReading],
    options: &ShellFitOptions,
) -> Result<ShellFit> {
    let readings = ShellReadings { points, ..ShellReadings::default() };
    fit_shell(mesh, deformation, &readings, options)
}

/// Fits a mesh, and the poses of cameras that are uncertain, to readings.
///
/// # Errors
/// `Input` for a mesh and a deformation of different sizes, invalid readings, a stiffness whose size differs
/// from the number of parameters, or outlines with a mesh that is oriented inconsistently; `Undetermined` for
/// no readings, or parameters that neither readings nor smoothness determine.
///
/// # Examples
/// ```
/// use planish_core::SymmetricMatrix3;
/// use planish_mesh::icosphere;
/// use planish_shell::{Dirichlet, PointReading, ShellFitOptions, ShellReadings, fit_shell};
/// let ball = icosphere(1.0, 2);
/// let deformation = Dirichlet::new(&icosphere(1.2, 1).positions, &ball.positions)?;
/// let points: Vec<PointReading> = (icosphere(1.1, 3).positions.into_iter())
///     .map(|at| PointReading { at, covariance: SymmetricMatrix3::isotropic(1e-4) })
///     .collect();
/// let readings = ShellReadings { points: &points, ..ShellReadings::default() };
/// let fit = fit_shell(&ball, &deformation, &readings, &ShellFitOptions::default())?;
/// assert_eq!(fit.positions.len(), ball.positions.len());
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn fit_shell(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    readings: &ShellReadings<'_>,
    options: &ShellFitOptions,
) -> Result<ShellFit> {
    fit_shell_with_progress(mesh, deformation, readings, options, &mut |_| Ok(()))
}

/// Progress of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShellProgress {
    /// Share of all stages, in `[0, 1]`; a stage may end before its last iteration.
    pub share: f64,
    /// Iterations done.
    pub iteration: usize,
    /// Root mean square distance of the points from the shell, outliers included; `None` without points.
    pub rms_points: Option<f64>,
}

/// [`fit_shell`] that calls `watch` before each iteration. An error returned by `watch` stops the fit.
///
/// # Errors
/// As [`fit_shell`], and the error of `watch`.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_estimate::{Error, ErrorKind};
/// use planish_core::SymmetricMatrix3;
/// use planish_mesh::icosphere;
/// use planish_shell::{Dirichlet, PointReading, ShellFitOptions, ShellReadings, fit_shell_with_progress};
/// # fn main() -> planish_estimate::Result<()> {
/// let ball = icosphere(1.0, 2);
/// let controls: Vec<DVec3> = icosphere(1.2, 1).positions;
/// let deformation = Dirichlet::new(&controls, &ball.positions)?;
/// let points: Vec<PointReading> = icosphere(1.1, 3).positions.into_iter()
///     .map(|at| PointReading { at, covariance: SymmetricMatrix3::isotropic(1e-4) })
///     .collect();
/// let readings = ShellReadings { points: &points, ..ShellReadings::default() };
/// let mut calls = 0;
/// let stopped = fit_shell_with_progress(&ball, &deformation, &readings, &ShellFitOptions::default(), &mut
/// |at| {
///     calls += 1;
///     if at.iteration < 2 { Ok(()) } else { Err(Error::interrupted()) }
/// });
/// assert_eq!((stopped.unwrap_err().kind(), calls), (ErrorKind::Interrupted, 3));
/// # Ok(())
/// # }
/// ```
pub fn fit_shell_with_progress(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    readings: &ShellReadings<'_>,
    options: &ShellFitOptions,
    watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
) -> Result<ShellFit> {
    check(mesh, deformation, options)?;
    readings.check(mesh.positions.len())?;
    starts::solve_from_starts(mesh, deformation, readings, options, watch)
}

/// [`fit_shell_with_progress`] from the start of the options only.
fn fit_from_one_start(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    readings: &ShellReadings<'_>,
    options: &ShellFitOptions,
    watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
) -> Result<ShellFit> {
    check(mesh, deformation, options)?;
    readings.check(mesh.positions.len())?;
    solve::solve(mesh, deformation, readings, options, watch)
}

impl ShellFit {
    /// σ along the normal of a vertex of shape that the parameters cannot represent.
    #[must_use]
    pub fn unresolved_at(&self, vertex: u32) -> f64 {
        self.unresolved_at.get(vertex as usize).copied().unwrap_or(self.unresolved_shape)
    }

    /// σ of a vertex along a direction: `√(dᵀ W_v Σ W_vᵀ d + m_v²)`, with `m_v` the σ of unresolved shape
    /// there.
    #[must_use]
    pub fn sigma_along(&self, deformation: &dyn Deformation, vertex: u32, direction: DVec3) -> f64 {
        // First order; exact for deformations that are linear in their parameters.
        let linear = deformation.linearised_at(&self.parameters);
        let row = parameter_row(linear.as_deref().unwrap_or(deformation), vertex, direction);
        let by_parameters = row.dot(&(&self.covariance * &row)).max(0.0);
        // Shape that the controls cannot represent is independent of their errors.
        (by_parameters + self.unresolved_at(vertex).powi(2)).sqrt()
    }
}

fn undetermined() -> Error {
    Error::undetermined(
        "the readings and the smoothness do not determine some controls: add readings all over the object, \
         or use fewer controls",
    )
}

fn check(mesh: &TriangleMesh, deformation: &dyn Deformation, options: &ShellFitOptions) -> Result<()> {
    // All checks come before the first stage: a fit can take minutes.
    mesh.sanity_check()?;
    options.loss.validate()?;
    if deformation.vertices() != mesh.positions.len() {
        return Err(Error::input(format!(
            "expected a deformation of as many vertices as the mesh has, found {} instead of {}",
            deformation.vertices(),
            mesh.positions.len()
        )));
    }
    let parameters = deformation.parameters();
    if parameters == 0 || parameters > MAX_PARAMETERS {
        return Err(Error::unsupported(format!(
            "expected 1 to {MAX_PARAMETERS} parameters, three for each control point, found {parameters}"
        )));
    }
    let sizes = [
        ("the stiffness", options.stiffness.as_ref()),
        ("the prior", options.prior.as_ref().map(|prior| &prior.information)),
    ];
    for (name, matrix) in sizes {
        if let Some(k) = matrix.filter(|k| k.shape() != (parameters, parameters)) {
            return Err(Error::input(format!(
                "{name}: expected {parameters} × {parameters} entries, found {} × {}",
                k.nrows(),
                k.ncols()
            )));
        }
    }
    if let Some(points) = (options.rigidity.as_ref().map(Rigidity::points)).filter(|n| 3 * n > parameters) {
        return Err(Error::input(format!(
            "the rigidity: expected at most a third of {parameters} parameters as points, found {points}"
        )));
    }
    let lengths = [
        ("the prior", options.prior.as_ref().map(|prior| &prior.mean)),
        ("the start", options.start.as_ref()),
        ("the initial state", options.initial.as_ref()),
        ("the state to resume", options.resume.as_ref().map(|resume| &resume.parameters)),
    ];
    for (name, vector) in lengths {
        if let Some(q) = vector.filter(|q| q.len() != parameters) {
            return Err(Error::input(format!("{name}: expected {parameters} parameters, found {}", q.len())));
        }
    }
    if let Some(sigma) = options.start_sigma.filter(|sigma| !(sigma.is_finite() && *sigma > 0.0)) {
        return Err(Error::input(format!("expected σ > 0 of the start, found {sigma}")));
    }
    let (first, finest) = options.softness;
    if !(first >= finest && finest > 0.0 && first.is_finite()) {
        return Err(Error::input(format!(
            "expected a softness that falls from one positive share of the size to another, found {first} \
             and {finest}"
        )));
    }
    if options.steps == 0 || options.iterations == 0 {
        return Err(Error::input("expected at least one step of sharpness and one iteration"));
    }
    Ok(())
}

/// The stiffness of all three coordinates of every control, from that of one coordinate: `K ⊗ I₃`.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_shell::{stiffness, stiffness_for_xyz};
/// let k = stiffness(&[DVec3::ZERO, DVec3::X], &[], &[[0, 1]]);
/// let all = stiffness_for_xyz(&k);
/// assert_eq!((all.nrows(), all[(0, 3)]), (6, -1.0));
/// ```
#[must_use]
pub fn stiffness_for_xyz(stiffness: &DMatrix<f64>) -> DMatrix<f64> {
    stiffness.kronecker(&DMatrix::identity(3, 3))
}

#[cfg(test)]
mod tests;
