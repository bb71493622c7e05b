//! Tracks a shell over frames: a Kalman filter of its parameters and their velocities.
//!
//! In: the readings of each frame. Out: the parameters of the frame and their covariance, given all frames up
//! to it; afterwards also given all frames ([`smoothing`]).
//!
//! The motion model is `q' = q + v + a/2`, `v' = v + a`, with accelerations `a ~ N(0, c M)` that are smooth
//! over the controls: `M ∝ (H + ε I)⁻¹` with the energy of shapes `H` below, linearised at the frame. The
//! first frame is fitted alone; the velocity after it has only the smooth prior.
//!
//! The filter carries the information of the readings. The smoothness of shapes, `λ E/2`, is applied once in
//! each frame and is not carried on. Its energy `E` is that of a single fit, which may allow parts to turn;
//! it is linearised at a first fit of the frame, from the estimate of the last one: `E = qᵀHq − 2 vᵀq + e`.
//! With the information `N` and the vector `η` of the frame's readings, and a prior of mean `m` and
//! information `Λ`, its likelihood is
//!
//! `ln L = ηᵀm − ½ mᵀN m + ½ rᵀ (Λ + N)⁻¹ r + ½ ln |Λ| − ½ ln |Λ + N|`, `r = η − N m`.
//!
//! `λ` maximises that of the frame with the smoothness alone as its prior, times `exp(−½ λ min E)`. Each
//! frame has its own, because it measures how much the object has deformed: one for all frames made σ of
//! parts without readings too small by a half where an object at rest in the first frames bent later. If a
//! frame shows the object at rest, the likelihood grows with `λ` without bound; `ln λ` therefore has a wide
//! Gaussian prior. `c` maximises the likelihood of all frames with their predictions and the smoothness.
//! Older frames are discounted.
//!
//! Prediction and smoothness are then the prior of a second fit, whose equations are linearised anew where it
//! ends (an iterated filter).
//!
//! Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, *Estimation with applications to tracking and navigation*,
//! 2001, sections 6.2 and 11.2.
//!
//! Not guaranteed: an object that moves farther between two frames than [`super::fit_shell`] can follow is
//! lost.

pub(super) mod smoothing;

use super::dense::Factor;
use super::smoothness::{LinearisedEnergy, Smoothness, displaced};
use super::{
    ParameterPrior, ShellFit, ShellFitOptions, ShellProgress, ShellReadings, fit_shell_with_progress,
    undetermined,
};
use crate::deformation::Deformation;
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Error, Result};
use planish_mesh::TriangleMesh;
use rayon::prelude::*;

/// `ε` as a share of the mean diagonal of `H`: the cost of moving all controls together, relative to moving
/// one alone.
const COMMON_MOTION_COST: f64 = 0.02;
/// Factor on the log-likelihood of past frames. Smaller values follow a change of motion sooner; larger ones
/// give steadier weights.
const MEMORY: f64 = 0.8;
/// Candidates of `c` in half decades, around the value at which motion and readings have equal variance.
const MOTION_HALF_DECADES: (i32, i32) = (-6, 12);
/// Candidates of `λ` in half decades, around the value at which smoothness and readings have equal
/// information.
const SHAPE_HALF_DECADES: (i32, i32) = (-14, 6);
/// Standard deviation of the prior of `λ`, in half decades.
const SHAPE_PRIOR_HALF_DECADES: f64 = 4.0;

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
    /// Options of a fit without a smoothness of its own.
    options: ShellFitOptions,
    /// The smoothness of shapes.
    shape: Smoothness,
    /// The mesh's size.
    size: f64,
    state: Option<Motion>,
    /// All frames so far, for the smoother.
    past: Vec<PastFrame>,
}

/// A frame after it has been followed.
struct PastFrame {
    /// Parameters, then velocities, by the readings of all frames up to it.
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// The noise of the motion that led to it; none for the first frame.
    motion: Option<MotionNoise>,
    /// Information and vector of its own readings.
    information: DMatrix<f64>,
    vector: DVector<f64>,
    /// The parameters of its fit.
    found: DVector<f64>,
    /// The smoothness of shapes there, and its weight `λ`.
    shape: (ShapeEnergy, f64),
}

/// An energy of shapes near parameters, `qᵀHq − 2 vᵀq + e`.
struct ShapeEnergy {
    /// `H`.
    information: DMatrix<f64>,
    /// `v`.
    vector: DVector<f64>,
    /// `e`.
    constant: f64,
}

/// The covariance of what moves a shell from one frame to the next: `c M` for each pair of parameters and
/// velocities, times a share.
struct MotionNoise {
    /// `c M`.
    covariance: DMatrix<f64>,
    shares: [[f64; 2]; 2],
}

/// Parameters, then velocities, by the readings alone.
struct Motion {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// The parameters of the last frame.
    found: DVector<f64>,
    /// Whether anything is known of velocities.
    moves: bool,
    /// Candidates of `c`; none before the second frame.
    motions: Candidates,
}

impl<'a> ShellTracker<'a> {
    /// A tracker before its first frame. The rigidity in the options, or else the stiffness, defines smooth
    /// shapes and motions.
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
        Ok(Self {
            mesh,
            deformation,
            shape: Smoothness::new(k.clone(), options.rigidity.clone(), None)?,
            options,
            size: mesh.surface_bounds().map_or(0.0, |bounds| bounds.diagonal()),
            state: None,
            past: Vec::new(),
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
        let fit = fit_shell_with_progress(self.mesh, self.deformation, readings, &self.options, watch)?;
        let (n, vector) = (&fit.data_information, &fit.data_vector);
        // The information of the readings alone may be singular.
        let shape = self.shape_near(&fit.parameters);
        let floor = DMatrix::identity(parameters, parameters) * self.floor();
        let covariance = Factor::new(&(n + floor)).ok_or_else(undetermined)?.inverse();
        let mut joint = DMatrix::zeros(2 * parameters, 2 * parameters);
        joint.view_mut((0, 0), (parameters, parameters)).copy_from(&covariance);
        let mut mean = DVector::zeros(2 * parameters);
        mean.rows_mut(0, parameters).copy_from(&(&covariance * vector));
        let weight = self.shape_weight(&shape, (n, vector));
        self.past = vec![PastFrame {
            mean: mean.clone(),
            covariance: joint.clone(),
            motion: None,
            information: n.clone(),
            vector: vector.clone(),
            found: fit.parameters.clone(),
            shape: (shape, weight),
        }];
        self.state = Some(Motion {
            mean,
            covariance: joint,
            found: fit.parameters.clone(),
            moves: false,
            motions: Candidates::default(),
        });
        Ok(FrameFit { fit, predicted: None, acceleration: 0.0 })
    }

    /// The smoothness of shapes near parameters.
    fn shape_near(&self, parameters: &DVector<f64>) -> ShapeEnergy {
        let LinearisedEnergy { energy, gradient, information } = self.shape.linearised(parameters);
        let along = &*information * parameters;
        ShapeEnergy {
            constant: energy - 2.0 * gradient.dot(parameters) + parameters.dot(&along),
            vector: along - gradient,
            information: information.into_owned(),
        }
    }

    /// Information about each parameter before all readings: rigid motions are known to half the mesh's size.
    fn floor(&self) -> f64 {
        (0.5 * self.size).powi(-2)
    }

    /// The prior of shapes with a smoothness weight, and the logarithm of a factor on its likelihood.
    fn shape_alone(&self, shape: &ShapeEnergy, weight: f64) -> Option<(ParameterPrior, f64)> {
        let parameters = self.deformation.parameters();
        let information =
            weight * &shape.information + DMatrix::identity(parameters, parameters) * self.floor();
        let mean = Factor::new(&information)?.solve(&(weight * &shape.vector));
        let least = shape.constant - shape.vector.dot(&mean);
        Some((ParameterPrior { mean, information }, -0.5 * weight * least.max(0.0)))
    }

    /// The most likely smoothness weight of a frame with the information and the vector of its readings.
    fn shape_weight(&self, shape: &ShapeEnergy, (n, vector): (&DMatrix<f64>, &DVector<f64>)) -> f64 {
        let natural = n.trace() / shape.information.trace().max(f64::MIN_POSITIVE);
        let mut weights = Candidates::around(natural, SHAPE_HALF_DECADES, SHAPE_PRIOR_HALF_DECADES);
        weights.add((n, vector), 1.0, |weight| self.shape_alone(shape, weight));
        weights.most_likely()
    }

    /// Options of the first fit of a frame, in which displacements from the last one are smooth.
    fn options_from(&self, last: &DVector<f64>) -> ShellFitOptions {
        let rigidity = self.options.rigidity.clone().map(|rigidity| {
            let moved = displaced(&rigidity, last);
            rigidity.in_pose(moved)
        });
        ShellFitOptions { start: Some(last.clone()), rigidity, ..self.options.clone() }
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
        let (mean, mut joint) = self.moved(&last.mean, &last.covariance, None);
        // Noise enters as an unknown velocity (coefficient 1) in the second frame, as an acceleration (½)
        // later.
        let of = if last.moves { [[0.25, 0.5], [0.5, 1.0]] } else { [[1.0, 1.0], [1.0, 1.0]] };
        let options = self.options_from(&last.found);
        // Progress counts both fits of the frame as equally long.
        let mut half = |start_share: f64, at: ShellProgress| {
            watch(ShellProgress { share: start_share + 0.5 * at.share, ..at })
        };
        let first = fit_shell_with_progress(self.mesh, self.deformation, readings, &options, &mut |at| {
            half(0.0, at)
        })?;
        let (n, vector) = (&first.data_information, &first.data_vector);
        let own_mean = mean.rows(0, parameters).into_owned();
        let base = joint.view((0, 0), (parameters, parameters)).into_owned();
        let near = self.shape_near(&first.parameters);
        let weight = self.shape_weight(&near, (n, vector));
        let shape = near.weighed(weight);
        let smooth = smooth_motions(&near)?;
        let mut motions = last.motions.clone();
        if !last.moves {
            // The centre of the range: motion as large as the uncertainty of the readings.
            let unit = parameters as f64 / (n * &smooth).trace().max(f64::MIN_POSITIVE);
            motions = Candidates::around(unit, MOTION_HALF_DECADES, f64::INFINITY);
        }
        let growing = of[0][0] * &smooth;
        motions.add((n, vector), MEMORY, |c| {
            with_shape(&(&base + c * &growing), &own_mean, &shape).map(|prior| (prior, 0.0))
        });
        let acceleration = motions.most_likely();
        let noise = MotionNoise { covariance: acceleration * smooth, shares: of };
        self.add_noise(&mut joint, &noise);
        let columns = joint.columns(0, parameters).into_owned();
        let own = columns.rows(0, parameters).into_owned();
        let prior = with_shape(&own, &own_mean, &shape).ok_or_else(undetermined)?;
        let predicted = prior.mean.clone();
        let finest = self.options.softness.1;
        let options = ShellFitOptions {
            start: Some(first.parameters.clone()),
            prior: Some(prior.clone()),
            stiffness: None,
            rigidity: None,
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
        let covariance = 0.5 * (&covariance + covariance.transpose());
        self.past.push(PastFrame {
            mean: mean.clone(),
            covariance: covariance.clone(),
            motion: Some(noise),
            information: fit.data_information.clone(),
            vector: fit.data_vector.clone(),
            shape: (self.shape_near(&fit.parameters), weight),
            found: fit.parameters.clone(),
        });
        self.state = Some(Motion { mean, covariance, found: fit.parameters.clone(), moves: true, motions });
        Ok(FrameFit { fit, predicted: Some(predicted), acceleration })
    }

    /// Parameters and velocities one frame later, with their covariance.
    fn moved(
        &self,
        mean: &DVector<f64>,
        covariance: &DMatrix<f64>,
        noise: Option<&MotionNoise>,
    ) -> (DVector<f64>, DMatrix<f64>) {
        let step = self.step();
        let mut joint = &step * covariance * step.transpose();
        if let Some(noise) = noise {
            self.add_noise(&mut joint, noise);
        }
        (step * mean, joint)
    }

    /// `q' = q + v`, `v' = v` as a matrix.
    fn step(&self) -> DMatrix<f64> {
        let parameters = self.deformation.parameters();
        DMatrix::from_fn(2 * parameters, 2 * parameters, |i, j| {
            f64::from(u8::from(i == j || j == i + parameters))
        })
    }

    fn add_noise(&self, joint: &mut DMatrix<f64>, noise: &MotionNoise) {
        let parameters = self.deformation.parameters();
        for (i, row) in noise.shares.iter().enumerate() {
            for (j, share) in row.iter().enumerate() {
                let mut block = joint.view_mut((i * parameters, j * parameters), (parameters, parameters));
                block += *share * &noise.covariance;
            }
        }
    }
}

impl ShapeEnergy {
    /// Information and vector with a weight.
    fn weighed(&self, weight: f64) -> (DMatrix<f64>, DVector<f64>) {
        (weight * &self.information, weight * &self.vector)
    }
}

/// The covariance of smooth motions `M` near a shape, with a mean variance of 1.
fn smooth_motions(shape: &ShapeEnergy) -> Result<DMatrix<f64>> {
    let parameters = shape.information.nrows();
    let share = COMMON_MOTION_COST * shape.information.trace() / parameters as f64;
    let floor = DMatrix::identity(parameters, parameters) * share.max(f64::MIN_POSITIVE);
    let smooth = Factor::new(&(&shape.information + floor)).ok_or_else(undetermined)?.inverse();
    // Normalised, so that `c` is the mean variance of a parameter.
    Ok(&smooth * (parameters as f64 / smooth.trace()))
}

/// The prediction combined with the smoothness of the shape.
fn with_shape(
    covariance: &DMatrix<f64>,
    mean: &DVector<f64>,
    (shape, vector): &(DMatrix<f64>, DVector<f64>),
) -> Option<ParameterPrior> {
    let own = Factor::new(covariance)?.inverse();
    let information = &own + shape;
    let mean = Factor::new(&information)?.solve(&(own * mean + vector));
    Some(ParameterPrior { mean, information })
}

/// Values of a weight with their log-likelihoods over all frames so far.
#[derive(Clone, Default)]
struct Candidates {
    /// Value, log-prior and log-likelihood.
    all: Vec<[f64; 3]>,
}

impl Candidates {
    /// Half decades around a value, with a Gaussian prior of their number.
    fn around(middle: f64, (from, to): (i32, i32), prior: f64) -> Self {
        let candidate = |k: i32| {
            let k = f64::from(k);
            [middle * 10_f64.powf(0.5 * k), -0.5 * (k / prior).powi(2), 0.0]
        };
        Self { all: (from..=to).map(candidate).collect() }
    }

    /// Adds a frame with the information and vector of its readings, and its prior for each value with the
    /// logarithm of a factor. The sum over earlier frames counts by the factor `memory`.
    fn add(
        &mut self,
        (n, vector): (&DMatrix<f64>, &DVector<f64>),
        memory: f64,
        prior: impl Fn(f64) -> Option<(ParameterPrior, f64)> + Sync,
    ) {
        let likelihood = |value: f64| -> Option<f64> {
            let (ParameterPrior { mean, information }, log_factor) = prior(value)?;
            let before = Factor::new(&information)?;
            let after = Factor::new(&(information + n))?;
            let r = vector - n * &mean;
            // ηᵀm − ½ mᵀNm varies because the mean does.
            let own = vector.dot(&mean) - 0.5 * mean.dot(&(n * &mean));
            let determinants = before.log_determinant() - after.log_determinant();
            Some(own + 0.5 * r.dot(&after.solve(&r)) + 0.5 * determinants + log_factor)
        };
        self.all.par_iter_mut().for_each(|[value, _, sum]| {
            *sum = memory * *sum + likelihood(*value).unwrap_or(f64::NEG_INFINITY);
        });
    }

    /// The most likely value, by a parabola through the best candidate and its neighbours.
    fn most_likely(&self) -> f64 {
        let totals: Vec<f64> = self.all.iter().map(|[_, prior, sum]| prior + sum).collect();
        let best = (0..totals.len()).max_by(|a, b| totals[*a].total_cmp(&totals[*b])).unwrap_or(0);
        let shift = match best.checked_sub(1).and_then(|k| totals[k..].first_chunk::<3>()) {
            Some([before, own, after]) => 0.5 * (before - after) / (before - 2.0 * own + after),
            None => 0.0,
        };
        let shift = if shift.is_finite() { shift.clamp(-0.5, 0.5) } else { 0.0 };
        self.all[best][0] * 10_f64.powf(0.5 * shift)
    }
}
