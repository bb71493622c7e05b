//! Tracks a shell over frames: a Kalman filter of its parameters and their velocities.
//!
//! In: the readings of each frame. Out: the parameters of the frame and their covariance, given all frames up
//! to it.
//!
//! The motion model is `q' = q + v + a/2`, `v' = v + a`, with accelerations `a ~ N(0, c M)` that are smooth
//! over the controls: `M ∝ (K + ε I)⁻¹`. The first frame is fitted alone; the velocity after it has only the
//! smooth prior.
//!
//! The filter carries the information of the readings. The smoothness of shapes, `λ K`, is applied once in
//! each frame and is not carried on. Each frame is first fitted from the estimate of the last one. The
//! information `N` and the vector `η` of its readings determine `λ` and the strength of accelerations: both
//! maximise the likelihood of all frames so far, with older frames discounted. With the prior mean `m` and
//! information `Λ(c, λ)` of the frame,
//!
//! `ln L = ηᵀm − ½ mᵀN m + ½ rᵀ (Λ + N)⁻¹ r + ½ ln |Λ| − ½ ln |Λ + N|`, `r = η − N m`.
//!
//! A single frame says little about `λ`: if it shows the object at rest, its likelihood grows with `λ`
//! without bound. `ln λ` therefore has a wide Gaussian prior, and later frames count.
//!
//! Prediction and smoothness are then the prior of a second fit, whose equations are linearised anew where it
//! ends (an iterated filter).
//!
//! Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, *Estimation with applications to tracking and navigation*,
//! 2001, sections 6.2 and 11.2.
//!
//! Not guaranteed: an object that moves farther between two frames than [`super::fit_shell`] can follow is
//! lost.

use super::dense::Factor;
use super::{
    ParameterPrior, ShellFit, ShellFitOptions, ShellProgress, ShellReadings, fit_shell_with_progress,
    undetermined,
};
use crate::deformation::Deformation;
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Error, Result};
use planish_mesh::TriangleMesh;
use rayon::prelude::*;

/// `ε` as a share of the mean diagonal of `K`: the cost of moving all controls together, relative to moving
/// one alone.
const COMMON_MOTION_COST: f64 = 0.02;
/// Factor on the log-likelihood of past frames. Smaller values follow a change of motion sooner; larger ones
/// give steadier weights.
const MEMORY: f64 = 0.8;
/// Candidates of `c` in half decades, around the value at which motion and readings have equal variance.
const MOTION_HALF_DECADES: (i32, i32) = (-6, 12);
/// Candidates of `λ` in decades, around the value at which smoothness and readings have equal information.
const SHAPE_DECADES: (i32, i32) = (-6, 3);
/// Standard deviation of the prior of `λ`, in decades.
const SHAPE_PRIOR_DECADES: f64 = 2.0;

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
    /// Whether anything is known of velocities.
    moves: bool,
    /// How strong accelerations and smoothness are.
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
        // The information of the readings alone may be singular; a prior of half the mesh's size makes it
        // regular.
        let floor = (0.5 * self.size).powi(-2);
        let n = &fit.data_information;
        let vector = n * &fit.parameters + fit.smoothness_weight * (&self.stiffness * &fit.parameters);
        let covariance = Factor::new(&(n + floor * &identity)).ok_or_else(undetermined)?.inverse();
        let mut joint = DMatrix::zeros(2 * parameters, 2 * parameters);
        joint.view_mut((0, 0), (parameters, parameters)).copy_from(&covariance);
        let mut mean = DVector::zeros(2 * parameters);
        mean.rows_mut(0, parameters).copy_from(&(&covariance * &vector));
        let mut evidence = Evidence::of_shapes(n.trace() / self.stiffness.trace().max(f64::MIN_POSITIVE));
        let zero = DVector::zeros(parameters);
        evidence.add(&self.stiffness, (n, &vector), &[Prediction::new(floor * identity, &zero)]);
        self.state =
            Some(Motion { mean, covariance: joint, found: fit.parameters.clone(), moves: false, evidence });
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
        // The centre of the range: motion as large as the uncertainty of the readings.
        let unit = parameters as f64 / (n * &self.smooth).trace().max(f64::MIN_POSITIVE);
        let mut evidence = match last.moves {
            true => last.evidence.clone(),
            false => last.evidence.with_motions(unit),
        };
        let growing = of[0][0] * &self.smooth;
        let predictions: Vec<Prediction> = (evidence.motions.par_iter())
            .map(|c| {
                let own = Factor::new(&(&base + *c * &growing)).ok_or_else(undetermined)?.inverse();
                Ok(Prediction::new(own, &own_mean))
            })
            .collect::<Result<_>>()?;
        evidence.add(&self.stiffness, (n, &vector), &predictions);
        let [acceleration, weight] = evidence.most_likely();
        let shape = weight * &self.stiffness;
        for (i, row) in of.iter().enumerate() {
            for (j, share) in row.iter().enumerate() {
                let mut block = joint.view_mut((i * parameters, j * parameters), (parameters, parameters));
                block += acceleration * *share * &self.smooth;
            }
        }
        let columns = joint.columns(0, parameters).into_owned();
        let own = columns.rows(0, parameters).into_owned();
        let prior = with_shape(&own, &own_mean, &shape).ok_or_else(undetermined)?;
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
    let own = Factor::new(covariance)?.inverse();
    let information = &own + shape;
    let mean = Factor::new(&information)?.solve(&(own * mean));
    Some(ParameterPrior { mean, information })
}

/// What the frames before predict: the information, and its product with the mean.
struct Prediction {
    information: DMatrix<f64>,
    vector: DVector<f64>,
}

impl Prediction {
    fn new(information: DMatrix<f64>, mean: &DVector<f64>) -> Self {
        Self { vector: &information * mean, information }
    }
}

/// Log-likelihoods of pairs of `c` and `λ` over all frames so far, older ones discounted.
#[derive(Clone)]
struct Evidence {
    /// Candidates of `c`; none before the second frame.
    motions: Vec<f64>,
    /// Candidates of `λ`, each with its log-prior.
    shapes: Vec<[f64; 2]>,
    /// For each motion, or once before the second frame: the log-likelihood of each shape.
    likelihoods: Vec<Vec<f64>>,
}

impl Evidence {
    /// Candidates of `λ` around a value.
    fn of_shapes(middle: f64) -> Self {
        let shapes: Vec<[f64; 2]> = (SHAPE_DECADES.0..=SHAPE_DECADES.1)
            .map(|k| [middle * 10_f64.powi(k), -0.5 * (f64::from(k) / SHAPE_PRIOR_DECADES).powi(2)])
            .collect();
        Self { motions: Vec::new(), likelihoods: vec![vec![0.0; shapes.len()]], shapes }
    }

    /// The same shapes with each of the candidates of `c` around a value.
    fn with_motions(&self, middle: f64) -> Self {
        let half_decades = MOTION_HALF_DECADES.0..=MOTION_HALF_DECADES.1;
        let motions: Vec<f64> = half_decades.map(|k| middle * 10_f64.powf(0.5 * f64::from(k))).collect();
        Self {
            likelihoods: vec![self.likelihoods[0].clone(); motions.len()],
            motions,
            shapes: self.shapes.clone(),
        }
    }

    /// Adds a frame with the information and vector of its readings, and what each motion predicts.
    fn add(
        &mut self,
        stiffness: &DMatrix<f64>,
        (n, vector): (&DMatrix<f64>, &DVector<f64>),
        predictions: &[Prediction],
    ) {
        let likelihood = |prediction: &Prediction, weight: f64| -> Option<f64> {
            let information = &prediction.information + weight * stiffness;
            let before = Factor::new(&information)?;
            let after = Factor::new(&(information + n))?;
            let mean = before.solve(&prediction.vector);
            let r = vector - n * &mean;
            // ηᵀm − ½ mᵀNm varies because the mean does.
            let own = vector.dot(&mean) - 0.5 * mean.dot(&(n * &mean));
            let determinants = before.log_determinant() - after.log_determinant();
            Some(own + 0.5 * r.dot(&after.solve(&r)) + 0.5 * determinants)
        };
        let shapes = &self.shapes;
        self.likelihoods.par_iter_mut().zip(predictions).for_each(|(own, prediction)| {
            for (sum, [weight, _]) in own.iter_mut().zip(shapes) {
                *sum = MEMORY * *sum + likelihood(prediction, *weight).unwrap_or(f64::NEG_INFINITY);
            }
        });
    }

    /// The most likely `c` and `λ`.
    fn most_likely(&self) -> [f64; 2] {
        let pairs = self.motions.iter().zip(&self.likelihoods).flat_map(|(c, own)| {
            self.shapes.iter().zip(own).map(move |([weight, prior], sum)| ([*c, *weight], prior + sum))
        });
        pairs.fold(([0.0; 2], f64::NEG_INFINITY), |best, pair| if pair.1 > best.1 { pair } else { best }).0
    }
}
