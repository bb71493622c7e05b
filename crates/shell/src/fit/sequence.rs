//! A shell that is followed frame after frame: a Kalman filter of its parameters and their velocities.
//!
//! Comes in: the readings of each frame. Goes out: its parameters with their covariance, by all frames up to
//! it.
//!
//! Parameters `q` go on as they went: `q' = q + v + a/2`, `v' = v + a`, with accelerations `a ~ N(0, c M)`
//! that are smooth over the controls: `M ∝ (K + ε I)⁻¹`. The first frame is fitted alone, and of the velocity
//! after it nothing is known but that it is smooth.
//!
//! What the readings say goes through the filter; that shapes are smooth, `λ K` with the first frame's `λ`,
//! is said of every frame once and goes no further. Every frame is first fitted from where the last one was
//! found. What the readings alone say there, information `N` and vector `η`, says how strong accelerations
//! are: `c` makes the readings of all frames so far most likely, older ones less. With `m` and `Λ(c)` of what
//! was known before the frame,
//!
//! `ln L(c) = ηᵀm − ½ mᵀN m + ½ rᵀ (Λ + N)⁻¹ r + ½ ln |Λ| − ½ ln |Λ + N|`, `r = η − N m`.
//!
//! Prediction and smoothness are then the prior of a second fit, whose equations are linearised anew where it
//! ends (an iterated filter).
//!
//! Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, *Estimation with applications to tracking and navigation*,
//! 2001, sections 6.2 and 11.2.
//!
//! Not guaranteed: that a thing is found again which moved farther between two frames than
//! [`super::fit_shell`] can follow.

use super::{
    ParameterPrior, ShellFit, ShellFitOptions, ShellProgress, ShellReadings, fit_shell_with_progress,
    undetermined,
};
use crate::deformation::Deformation;
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Error, Result};
use planish_mesh::TriangleMesh;

/// `ε` as a share of the mean of `K`'s diagonal: how much less a motion of everything costs than one of a
/// control alone.
const WHOLE: f64 = 0.02;
/// Steps of `c` for a factor of ten.
const PER_DECADE: i32 = 3;
/// What the evidence of a frame still counts in the next.
const MEMORY: f64 = 0.8;
/// Decades of `c` that are looked at, around what the data know.
const DECADES: (i32, i32) = (-3, 6);

/// A frame, fitted.
#[derive(Debug, Clone)]
pub struct FrameFit {
    /// The fit by all frames up to this one: its parameters, covariance and positions are those of the
    /// filter.
    pub fit: ShellFit,
    /// What was predicted for it by those before; `None` for the first.
    pub predicted: Option<DVector<f64>>,
    /// The variance of accelerations, `c`; of velocities in the second frame.
    pub acceleration: f64,
}

/// Follows a shell.
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
    /// A tracker without a frame. The options' stiffness says what motions are smooth.
    ///
    /// # Errors
    /// `Input` where options have no stiffness, one of another size than the parameters, or a prior.
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
                    "following a shell needs a stiffness of its {parameters} parameters, and no prior of its own"
                ))
            })?;
        let stiffness = k.clone();
        let share = WHOLE * k.trace() / parameters as f64;
        let stiff = k + DMatrix::identity(parameters, parameters) * share.max(f64::MIN_POSITIVE);
        let mut smooth = stiff.cholesky().ok_or_else(undetermined)?.inverse();
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

    /// The next frame.
    ///
    /// # Errors
    /// As [`super::fit_shell`]; the tracker is then as it was before.
    pub fn follow(&mut self, readings: &ShellReadings<'_>) -> Result<FrameFit> {
        self.follow_with_progress(readings, &mut |_| Ok(()))
    }

    /// [`ShellTracker::follow`] that tells how far the frame is before each iteration, and ends with the
    /// error that `watch` gives.
    ///
    /// # Errors
    /// As [`ShellTracker::follow`], and what `watch` says; the tracker is then as it was before.
    pub fn follow_with_progress(
        &mut self,
        readings: &ShellReadings<'_>,
        watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
    ) -> Result<FrameFit> {
        let parameters = self.deformation.parameters();
        let identity = DMatrix::<f64>::identity(parameters, parameters);
        let Some(last) = &self.state else {
            let fit = fit_shell_with_progress(self.mesh, self.deformation, readings, &self.options, watch)?;
            let shape = fit.smoothness_weight * &self.stiffness;
            // What the readings alone say: where they say nothing, anything within the mesh's size may be.
            let least = (0.5 * self.size).powi(-2);
            let n = &fit.data_information;
            let covariance = (n + least * &identity).cholesky().ok_or_else(undetermined)?.inverse();
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
            return Ok(FrameFit { fit, predicted: None, acceleration: 0.0 });
        };
        let step = DMatrix::from_fn(2 * parameters, 2 * parameters, |i, j| {
            f64::from(u8::from(i == j || j == i + parameters))
        });
        let mean = &step * &last.mean;
        let mut joint = &step * &last.covariance * step.transpose();
        // A velocity of which nothing is known moves parameters by all of itself, a change of it by half.
        let of = if last.moves { [[0.25, 0.5], [0.5, 1.0]] } else { [[1.0, 1.0], [1.0, 1.0]] };
        let options = ShellFitOptions { start: Some(last.found.clone()), ..self.options.clone() };
        // The second fit begins near its end, and takes no longer than the first.
        let mut half = |of: f64, at: ShellProgress| watch(ShellProgress { share: of + 0.5 * at.share, ..at });
        let first = fit_shell_with_progress(self.mesh, self.deformation, readings, &options, &mut |at| {
            half(0.0, at)
        })?;
        // Where that fit ended, its readings pull as hard as smoothness does.
        let n = &first.data_information;
        let pull = first.smoothness_weight * (&self.stiffness * (&first.parameters - &last.found));
        let vector = n * &first.parameters + pull;
        let own_mean = mean.rows(0, parameters).into_owned();
        let base = joint.view((0, 0), (parameters, parameters)).into_owned();
        let mut evidence = last.evidence.clone();
        if evidence.steps.is_empty() {
            // Where the motion is about as large as what the readings leave open.
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
        // Only what the readings say goes into the filter: smoothness of the shape counts once, in every
        // frame anew.
        let n = &fit.data_information;
        let innovation =
            n * (&fit.parameters - &own_mean) + &prior.information * (&fit.parameters - &prior.mean);
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

/// A prediction by the readings before, and a shape that is smooth.
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

/// How likely each `c` is by all frames so far, older ones less.
#[derive(Clone, Default)]
struct Evidence {
    /// `c` and its log-likelihood.
    steps: Vec<(f64, f64)>,
}

impl Evidence {
    /// Adds a frame: covariance and growth of its prediction, the mean of that and the smoothness of shapes,
    /// and what the readings say.
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
                // The readings' own part, ηᵀq − ½ qᵀNq at the prior's mean, changes with that.
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
