//! Tracks a shell over frames: a Kalman filter of its parameters and their velocities.
//!
//! In: the readings of each frame. Out: the parameters of the frame and their covariance, given all frames up
//! to it.
//!
//! The motion model is `q' = q + v + a/2`, `v' = v + a`, with accelerations `a ~ N(0, c M)` that are smooth
//! over the controls: `M ∝ (K + ε I)⁻¹`. The first frame is fitted alone; the velocity after it has only the
//! smooth prior.
//!
//! The filter carries the information of the readings. The smoothness of shapes, `λ K` with the `λ` of the
//! first frame, is applied once in each frame and is not carried on. Each frame is first fitted from the
//! estimate of the last one. The information `N` and the vector `η` of its readings determine the strength of
//! accelerations: `c` maximises the likelihood of all frames so far, with older frames discounted. With the
//! prior mean `m` and information `Λ(c)` of the frame,
//!
//! `ln L(c) = ηᵀm − ½ mᵀN m + ½ rᵀ (Λ + N)⁻¹ r + ½ ln |Λ| − ½ ln |Λ + N|`, `r = η − N m`.
//!
//! Prediction and smoothness are then the prior of a second fit, whose equations are linearised anew where it
//! ends (an iterated filter).
//!
//! Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, *Estimation with applications to tracking and navigation*,
//! 2001, sections 6.2 and 11.2.
//!
//! Not guaranteed: an object that moves farther between two frames than [`super::fit_shell`] can follow is
//! lost.

use super::{
    ParameterPrior, ShellFit, ShellFitOptions, ShellProgress, ShellReadings, fit_shell_with_progress,
    undetermined,
};
use crate::deformation::Deformation;
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Error, Result};
use planish_mesh::TriangleMesh;

/// `ε` as a share of the mean diagonal of `K`: the cost of moving all controls together, relative to moving
/// one alone.
const COMMON_MOTION_COST: f64 = 0.02;
/// Candidates of `c` per factor of ten.
const PER_DECADE: i32 = 3;
/// Factor on the log-likelihood of past frames. Smaller values follow a change of motion sooner; larger ones
/// give a steadier `c`.
const MEMORY: f64 = 0.8;
/// Range of the candidates of `c` in decades, around the value at which motion and readings have equal
/// variance.
const DECADES: (i32, i32) = (-3, 6);

/// The fit of one frame.
#[derive(Debug, Clone)]
pub struct FrameFit {
    /// The filtered estimate, given all frames up to this one.
    pub fit: ShellFit,
    /// Parameters predicted from the frames before; `None` for the first frame.
    pub predicted: Option<DVector<f64>>,
    /// Variance `c` of accelerations; in the second frame, of velocities.
    pub acceleration: f64,
}

/// Tracks a shell over frames.
///
/// # Examples
/// ```
/// use planish_core::SymmetricMatrix3;
/// use planish_mesh::icosphere;
/// use planish_shell::{Dirichlet, PointReading, ShellFitOptions, ShellReadings, ShellTracker};
/// use planish_shell::{automatic_controls, stiffness, stiffness_for_xyz};
/// let ball = icosphere(1.0, 2);
/// let controls = automatic_controls(&ball, 12)?;
/// let deformation = Dirichlet::new(&controls.points, &ball.positions)?;
/// let k = stiffness_for_xyz(&stiffness(&controls.points, &controls.triangles, &controls.edges));
/// let options = ShellFitOptions { stiffness: Some(k), ..ShellFitOptions::default() };
/// let mut tracker = ShellTracker::new(&ball, &deformation, options)?;
/// let points: Vec<PointReading> = (icosphere(1.05, 3).positions.into_iter())
///     .map(|at| PointReading { at, covariance: SymmetricMatrix3::isotropic(1e-4) })
///     .collect();
/// let readings = ShellReadings { points: &points, ..ShellReadings::default() };
/// assert!(tracker.follow(&readings)?.predicted.is_none());
/// assert!(tracker.follow(&readings)?.predicted.is_some());
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub struct ShellTracker<'a> {
    mesh: &'a TriangleMesh,
    deformation: &'a dyn Deformation,
    options: ShellFitOptions,
    /// `K`.
    stiffness: DMatrix<f64>,
    /// `M`.
    smooth: DMatrix<f64>,
    /// The mesh's size.
    size: f64,
    state: Option<Motion>,
}

/// Parameters, then velocities, by the readings alone.
struct Motion {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// The parameters of the last frame.
    found: DVector<f64>,
    /// `λ K` of shapes.
    shape: DMatrix<f64>,
    /// Whether anything is known of velocities.
    moves: bool,
    /// How strong accelerations are.
    evidence: Evidence,
}

impl<'a> ShellTracker<'a> {
    /// A tracker before its first frame. The stiffness in the options defines smooth motions.
    ///
    /// # Errors
    /// `Input` if the options have no stiffness, a stiffness of the wrong size, or a prior.
    pub fn new(
        mesh: &'a TriangleMesh,
        deformation: &'a dyn Deformation,
        options: ShellFitOptions,
    ) -> Result<Self> {
        let parameters = deformation.parameters();
        let k = (options.stiffness.as_ref())
            .filter(|k| k.shape() == (parameters, parameters) && options.prior.is_none())
            .ok_or_else(|| {
                Error::input(format!(
                    "expected a stiffness of the {parameters} parameters and no other prior for a sequence"
                ))
            })?;
        let stiffness = k.clone();
        let share = COMMON_MOTION_COST * k.trace() / parameters as f64;
        let stiff = k + DMatrix::identity(parameters, parameters) * share.max(f64::MIN_POSITIVE);
        let mut smooth = stiff.cholesky().ok_or_else(undetermined)?.inverse();
        // Normalised, so that `c` is the mean variance of a parameter.
        smooth *= parameters as f64 / smooth.trace();
        Ok(Self {
            mesh,
            deformation,
            options,
            stiffness,
            smooth,
            size: mesh.surface_bounds().map_or(0.0, |bounds| bounds.diagonal()),
            state: None,
        })
    }

    /// Fits the next frame.
    ///
    /// # Errors
    /// As [`super::fit_shell`]; an error leaves the tracker unchanged.
    pub fn follow(&mut self, readings: &ShellReadings<'_>) -> Result<FrameFit> {
        self.follow_with_progress(readings, &mut |_| Ok(()))
    }

    /// Fits the first frame, without a prediction.
    fn begin(
        &mut self,
        readings: &ShellReadings<'_>,
        watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
    ) -> Result<FrameFit> {
        let parameters = self.deformation.parameters();
        let identity = DMatrix::<f64>::identity(parameters, parameters);
        let fit = fit_shell_with_progress(self.mesh, self.deformation, readings, &self.options, watch)?;
        let shape = fit.smoothness_weight * &self.stiffness;
        // The information of the readings alone may be singular; a prior of half the mesh's size makes it
        // regular.
        let floor = (0.5 * self.size).powi(-2);
        let n = &fit.data_information;
        let covariance = (n + floor * &identity).cholesky().ok_or_else(undetermined)?.inverse();
        let mut joint = DMatrix::zeros(2 * parameters, 2 * parameters);
        joint.view_mut((0, 0), (parameters, parameters)).copy_from(&covariance);
        let mut mean = DVector::zeros(2 * parameters);
        let own = &covariance * (n * &fit.parameters + &shape * &fit.parameters);
        mean.rows_mut(0, parameters).copy_from(&own);
        self.state = Some(Motion {
            mean,
            covariance: joint,
            found: fit.parameters.clone(),
            shape,
            moves: false,
            evidence: Evidence::default(),
        });
        Ok(FrameFit { fit, predicted: None, acceleration: 0.0 })
    }

    /// [`ShellTracker::follow`] that calls `watch` before each iteration. An error returned by `watch` stops
    /// the fit.
    ///
    /// # Errors
    /// As [`ShellTracker::follow`], and the error of `watch`; an error leaves the tracker unchanged.
    pub fn follow_with_progress(
        &mut self,
        readings: &ShellReadings<'_>,
        watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
    ) -> Result<FrameFit> {
        let parameters = self.deformation.parameters();
        let identity = DMatrix::<f64>::identity(parameters, parameters);
        let Some(last) = &self.state else {
            return self.begin(readings, watch);
        };
        let step = DMatrix::from_fn(2 * parameters, 2 * parameters, |i, j| {
            f64::from(u8::from(i == j || j == i + parameters))
        });
        let mean = &step * &last.mean;
        let mut joint = &step * &last.covariance * step.transpose();
        // Noise enters as an unknown velocity (coefficient 1) in the second frame, as an acceleration (½)
        // later.
        let of = if last.moves { [[0.25, 0.5], [0.5, 1.0]] } else { [[1.0, 1.0], [1.0, 1.0]] };
        let options = ShellFitOptions { start: Some(last.found.clone()), ..self.options.clone() };
        // Progress counts both fits of the frame as equally long.
        let mut half = |start_share: f64, at: ShellProgress| {
            watch(ShellProgress { share: start_share + 0.5 * at.share, ..at })
        };
        let first = fit_shell_with_progress(self.mesh, self.deformation, readings, &options, &mut |at| {
            half(0.0, at)
        })?;
        // At the minimum, the gradients of the readings and of the smoothness cancel: that gives the vector
        // η.
        let n = &first.data_information;
        let pull = first.smoothness_weight * (&self.stiffness * (&first.parameters - &last.found));
        let vector = n * &first.parameters + pull;
        let own_mean = mean.rows(0, parameters).into_owned();
        let base = joint.view((0, 0), (parameters, parameters)).into_owned();
        let mut evidence = last.evidence.clone();
        if evidence.steps.is_empty() {
            // The centre of the range: motion as large as the uncertainty of the readings.
            let unit = parameters as f64 / (n * &self.smooth).trace().max(f64::MIN_POSITIVE);
            evidence.steps = (DECADES.0 * PER_DECADE..=DECADES.1 * PER_DECADE)
                .map(|k| (unit * 10_f64.powf(f64::from(k) / f64::from(PER_DECADE)), 0.0))
                .collect();
        }
        evidence.add((&base, &(of[0][0] * &self.smooth)), (&own_mean, &last.shape), (n, &vector));
        let acceleration = evidence.most_likely();
        for (i, row) in of.iter().enumerate() {
            for (j, share) in row.iter().enumerate() {
                let mut block = joint.view_mut((i * parameters, j * parameters), (parameters, parameters));
                block += acceleration * *share * &self.smooth;
            }
        }
        let columns = joint.columns(0, parameters).into_owned();
        let own = columns.rows(0, parameters).into_owned();
        let prior = with_shape(&own, &own_mean, &last.shape).ok_or_else(undetermined)?;
        let predicted = prior.mean.clone();
        let finest = self.options.softness.1;
        let options = ShellFitOptions {
            start: Some(first.parameters.clone()),
            prior: Some(prior.clone()),
            stiffness: None,
            steps: 1,
            softness: (finest, finest),
            ..self.options.clone()
        };
        let fit = fit_shell_with_progress(self.mesh, self.deformation, readings, &options, &mut |at| {
            half(0.5, at)
        })?;
        // Only the information of the readings enters the filter. Smoothness would otherwise be counted again
        // in every frame.
        let n = &fit.data_information;
        let innovation =
            n * (&fit.parameters - &own_mean) + &prior.information * (&fit.parameters - &prior.mean);
        // `P (I + N P)⁻¹` equals `(P⁻¹ + N)⁻¹` and needs no inverse of `N`, which is singular where a frame
        // has no readings.
        let both = (&identity + n * &own).lu();
        let by_readings = both.solve(&innovation).ok_or_else(undetermined)?;
        let gain = both.solve(n).ok_or_else(undetermined)?;
        let mean = mean + &columns * by_readings;
        let covariance = joint - &columns * gain * columns.transpose();
        self.state = Some(Motion {
            mean,
            covariance: 0.5 * (&covariance + covariance.transpose()),
            found: fit.parameters.clone(),
            shape: last.shape.clone(),
            moves: true,
            evidence,
        });
        Ok(FrameFit { fit, predicted: Some(predicted), acceleration })
    }
}

/// The prediction combined with the smoothness prior of the shape.
fn with_shape(
    covariance: &DMatrix<f64>,
    mean: &DVector<f64>,
    shape: &DMatrix<f64>,
) -> Option<ParameterPrior> {
    let own = covariance.clone().cholesky()?.inverse();
    let information = &own + shape;
    let mean = information.clone().cholesky()?.solve(&(own * mean));
    Some(ParameterPrior { mean, information })
}

/// Log-likelihood of each candidate `c` over all frames so far, older ones discounted.
#[derive(Clone, Default)]
struct Evidence {
    /// `c` and its log-likelihood.
    steps: Vec<(f64, f64)>,
}

impl Evidence {
    /// Adds a frame: covariance of its prediction and its growth with `c`, predicted mean and smoothness of
    /// shapes, and information and vector of the readings.
    fn add(
        &mut self,
        (base, growing): (&DMatrix<f64>, &DMatrix<f64>),
        (mean, shape): (&DVector<f64>, &DMatrix<f64>),
        (n, vector): (&DMatrix<f64>, &DVector<f64>),
    ) {
        for (c, likelihood) in &mut self.steps {
            *likelihood *= MEMORY;
            let prior = with_shape(&(base + *c * growing), mean, shape);
            let found = prior.and_then(|prior| {
                let before = prior.information.clone().cholesky()?;
                let after = (&prior.information + n).cholesky()?;
                let r = vector - n * &prior.mean;
                let half_determinant = |l: &DMatrix<f64>| l.diagonal().iter().map(|d| d.ln()).sum::<f64>();
                // ηᵀq − ½ qᵀNq at the prior's mean: it varies with c because the mean does.
                let own = vector.dot(&prior.mean) - 0.5 * prior.mean.dot(&(n * &prior.mean));
                Some(
                    own + 0.5 * r.dot(&after.solve(&r)) + half_determinant(before.l_dirty())
                        - half_determinant(after.l_dirty()),
                )
            });
            *likelihood += found.unwrap_or(f64::NEG_INFINITY);
        }
    }

    fn most_likely(&self) -> f64 {
        (self.steps.iter())
            .fold((0.0, f64::NEG_INFINITY), |best, step| if step.1 > best.1 { *step } else { best })
            .0
    }
}
