//! A shell fitted to readings: control points moved until the mesh goes through noisy points and touches the
//! lines of sight of outlines.
//!
//! Comes in: a mesh, a deformation, points with their covariance, views with outlines, features tracked over
//! views. Goes out: the parameters, the poses of cameras, their covariance, how far the stated σ are to be
//! believed, and which readings are gross errors.
//!
//! Every reading is an equation ([`problem`]), and nothing is searched for. The sum that is minimised is
//!
//! `Σ ρ(D_i/σ_i) + λ/2 · qᵀ K q`, and `½ δᵀ Σ⁻¹ δ` for every pose that is uncertain,
//!
//! with a redescending loss `ρ` (the paper's field saturates far away and so drops outliers by itself; a
//! distance does not), and `λ` by marginal likelihood ([`smoothness`]). σ of points, of outlines and of
//! tracks are each true up to a factor that the residuals say, corrected for the parameters. The sharpness
//! `k` rises step by step: coarse fields see over gaps and thin parts, sharp ones are exact.
//!
//! In the last of them every sheet near a point has an equation of its own, weighed by the probability that
//! the point is of it ([`sheets`]).
//!
//! Pixels inside and outside of masks count in the sum while they are wrong, and not in the covariance: an
//! inequality that holds tells nothing.
//!
//! Not guaranteed: the global optimum; a mesh that starts more than a tenth of its size away may be drawn to
//! the wrong side of a thin part. For outlines parts whose facets are turned inwards are turned outwards
//! first ([`outward`]).

mod choice;
mod dense;
mod equations;
mod known;
mod misfit;
mod outcome;
mod outward;
mod problem;
mod readings;
mod sequence;
mod sheets;
mod sight;
mod smoothness;
mod solve;
mod taken;
mod tracks;

pub use readings::{
    FeatureObservation, FeatureTrack, OutlineKind, OutlinePoint, PointReading, PoseNoise, ShellReadings,
    ShellView,
};

pub use sequence::{FrameFit, ShellTracker};

use crate::camera::Camera;
use crate::deformation::{Deformation, parameter_row};
use crate::field::Metaball;
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Error, Loss, Result, Termination};
use planish_mesh::TriangleMesh;

/// Parameters at most: equations are dense.
const MOST_PARAMETERS: usize = 6000;

/// How a shell is fitted.
#[derive(Debug, Clone)]
pub struct ShellFitOptions {
    /// What metaballs are built around.
    pub metaball: Metaball,
    /// Thickness `1/k` of the field at first, as a share of the mesh's size, and at last.
    pub softness: (f64, f64),
    /// Steps of sharpness from the first to the last.
    pub steps: usize,
    /// Iterations at each.
    pub iterations: usize,
    /// What residuals cost.
    pub loss: Loss,
    /// Whether σ of readings are what they are, or stated up to a common factor of each kind.
    pub believe_sigma: bool,
    /// `K`, of all parameters: what is smooth. Nothing is asked for where none is given.
    pub stiffness: Option<DMatrix<f64>>,
    /// Parameters where the fit starts, and from which on displacements are to be smooth; the prior's mean,
    /// or none, where it is not given.
    pub start: Option<DVector<f64>>,
    /// σ by which every control may be off at the start, in the unit of the mesh, where the start is known to
    /// be near: smoothness then weighs no more than displacements of that size allow, however well the start
    /// fits, and no iteration is stiffer. For a start that was made of the readings themselves, whose
    /// agreement with them is no proof of it.
    pub start_sigma: Option<f64>,
    /// What is known of the parameters before.
    pub prior: Option<ParameterPrior>,
    /// Facets that spherical shells are subdivide_for_spheres into, at most.
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
            start: None,
            start_sigma: None,
            prior: None,
            max_facets: 200_000,
        }
    }
}

/// A Gaussian belief of the parameters, before the readings.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterPrior {
    /// The mean, where the fit starts.
    pub mean: DVector<f64>,
    /// The inverse of the covariance.
    pub information: DMatrix<f64>,
}

/// What became of one kind of readings.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceFit {
    /// By how much their σ are larger than stated.
    pub sigma_factor: f64,
    /// Root mean square of the residuals of those that are no gross errors: distances of points, pixels of
    /// outlines, σ of tracks.
    pub rms: f64,
    /// Which the loss ignores all but altogether, or that have no equation.
    pub outliers: Vec<bool>,
}

/// A fitted shell.
#[derive(Debug, Clone)]
pub struct ShellFit {
    /// The parameters.
    pub parameters: DVector<f64>,
    /// Their covariance. Readings whose residuals hang together count as fewer ones.
    pub covariance: DMatrix<f64>,
    /// Cameras of the views.
    pub cameras: Vec<Camera>,
    /// Covariance of their poses, turn and step as in [`Camera::moved`]; `None` where a pose was known.
    pub pose_covariances: Vec<Option<DMatrix<f64>>>,
    /// Vertices of the deformed mesh.
    pub positions: Vec<[f64; 3]>,
    /// `λ`.
    pub smoothness_weight: f64,
    /// σ of what the parameters cannot follow, along normals, by residuals of neighbours that are alike; zero
    /// where they are noise. It is of the surface, not of the parameters: their covariance does not hold it.
    pub unresolved_shape: f64,
    /// Points.
    pub points: SourceFit,
    /// Places on outlines, of one view after the other.
    pub outlines: SourceFit,
    /// Tracks; an outlier is one without any sighting that counts.
    pub tracks: SourceFit,
    /// The data's information about the parameters, without what was known before: poses are taken out.
    pub data_information: DMatrix<f64>,
    /// How it ended.
    pub termination: Termination,
    /// Iterations in all.
    pub iterations: usize,
}

/// Fits a mesh to points.
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
/// `Input` for a mesh and a deformation of different sizes, readings that make no sense, a stiffness of
/// another size than the parameters, or outlines of a mesh whose facets are turned both ways; `Undetermined`
/// for no readings, or parameters on which neither readings nor smoothness say anything.
pub fn fit_shell(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    readings: &ShellReadings<'_>,
    options: &ShellFitOptions,
) -> Result<ShellFit> {
    fit_shell_with_progress(mesh, deformation, readings, options, &mut |_| Ok(()))
}

/// How far a fit has come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShellProgress {
    /// Of all steps of sharpness, in `[0, 1]`; a step may end before its last iteration.
    pub share: f64,
    /// Iterations done.
    pub iteration: usize,
    /// Root mean square distance of the points from the shell, gross errors with them; none where there are
    /// no points.
    pub rms_points: Option<f64>,
}

/// [`fit_shell`] that tells how far it is before each iteration, and ends with the error that `watch` gives.
///
/// # Errors
/// As [`fit_shell`], and what `watch` says.
///
/// # Examples
/// ```
/// use planish_estimate::{Error, ErrorKind};
/// use planish_mesh::icosphere;
/// use planish_shell::{Dirichlet, PointReading, ShellFitOptions, ShellReadings, fit_shell_with_progress};
/// # fn main() -> planish_estimate::Result<()> {
/// let ball = icosphere(1.0, 2);
/// let controls: Vec<[f64; 3]> = icosphere(1.2, 1).positions;
/// let deformation = Dirichlet::new(&controls, &ball.positions)?;
/// let points: Vec<PointReading> = icosphere(1.1, 3).positions.into_iter()
///     .map(|at| PointReading { at, covariance: [1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4] })
///     .collect();
/// let readings = ShellReadings { points: &points, ..ShellReadings::default() };
/// let mut told = 0;
/// let stopped = fit_shell_with_progress(&ball, &deformation, &readings, &ShellFitOptions::default(), &mut |at| {
///     told += 1;
///     if at.iteration < 2 { Ok(()) } else { Err(Error::interrupted()) }
/// });
/// assert_eq!((stopped.unwrap_err().kind(), told), (ErrorKind::Interrupted, 3));
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
    readings.check()?;
    solve::solve(mesh, deformation, readings, options, watch)
}

impl ShellFit {
    /// σ of a vertex along a direction: `√(dᵀ W_v Σ W_vᵀ d + m²)`, with `m` the σ of what parameters cannot
    /// follow.
    #[must_use]
    pub fn sigma_along(&self, deformation: &dyn Deformation, vertex: u32, direction: [f64; 3]) -> f64 {
        let row = parameter_row(deformation, vertex, direction);
        let by_parameters = row.dot(&(&self.covariance * &row)).max(0.0);
        (by_parameters + self.unresolved_shape * self.unresolved_shape).sqrt()
    }
}

fn undetermined() -> Error {
    Error::undetermined(
        "neither the readings nor smoothness say where some controls are: give readings all over the thing, or fewer controls",
    )
}

fn check(mesh: &TriangleMesh, deformation: &dyn Deformation, options: &ShellFitOptions) -> Result<()> {
    mesh.sanity_check()?;
    options.loss.validate()?;
    if deformation.vertices() != mesh.positions.len() {
        return Err(Error::input(format!(
            "the deformation moves {} vertices, the mesh has {}",
            deformation.vertices(),
            mesh.positions.len()
        )));
    }
    let parameters = deformation.parameters();
    if parameters == 0 || parameters > MOST_PARAMETERS {
        return Err(Error::unsupported(format!(
            "{parameters} parameters: needed between 1 and {MOST_PARAMETERS}, as a third as many control points"
        )));
    }
    let sizes = [
        ("the stiffness", options.stiffness.as_ref()),
        ("the prior", options.prior.as_ref().map(|prior| &prior.information)),
    ];
    for (name, matrix) in sizes {
        if let Some(k) = matrix.filter(|k| k.shape() != (parameters, parameters)) {
            return Err(Error::input(format!(
                "{name} is {} × {}, and there are {parameters} parameters",
                k.nrows(),
                k.ncols()
            )));
        }
    }
    let lengths = [
        ("the prior", options.prior.as_ref().map(|prior| &prior.mean)),
        ("the start", options.start.as_ref()),
    ];
    for (name, vector) in lengths {
        if let Some(q) = vector.filter(|q| q.len() != parameters) {
            return Err(Error::input(format!(
                "{name} is of {} parameters, and there are {parameters}",
                q.len()
            )));
        }
    }
    if let Some(sigma) = options.start_sigma.filter(|sigma| !(sigma.is_finite() && *sigma > 0.0)) {
        return Err(Error::input(format!("σ of the start is a positive length, got {sigma}")));
    }
    let (first, finest) = options.softness;
    if !(first >= finest && finest > 0.0 && first.is_finite()) {
        return Err(Error::input(format!(
            "the softness of a shell falls from one positive share of its size to another, got {first} and {finest}"
        )));
    }
    if options.steps == 0 || options.iterations == 0 {
        return Err(Error::input("a fit needs at least one step of sharpness and one iteration"));
    }
    Ok(())
}

/// The stiffness of one coordinate for all three of every control.
#[must_use]
pub fn stiffness_for_xyz(stiffness: &DMatrix<f64>) -> DMatrix<f64> {
    stiffness.kronecker(&DMatrix::identity(3, 3))
}

#[cfg(test)]
mod tests;
