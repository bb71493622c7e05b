//! The frames of a sequence, each from the readings of all.
//!
//! In: a [`ShellTracker`] that has followed the frames. Out: for each frame, the fit to its readings with a
//! prior from all other frames.
//!
//! A backward pass gives parameters and velocities by the readings of all frames (the smoother of Rauch, Tung
//! and Striebel): with the estimate `x, P` of a frame, the prediction `x⁻, P⁻` of the next one and its
//! smoothed estimate `xˢ, Pˢ`,
//!
//! `x + G (xˢ − x⁻)`, `P + G (Pˢ − P⁻) Gᵀ`, `G = P Fᵀ (P⁻)⁻¹`.
//!
//! What the frame's own readings told is subtracted as information, and the smoothness of the shape is added,
//! with the frame's own weight. This is the prior of a new fit of the frame, whose equations are linearised
//! where it ends.
//!
//! Source: H. Rauch, F. Tung, C. Striebel, *Maximum likelihood estimates of linear dynamic systems*, 1965.
//!
//! Not guaranteed: a frame that the filter has lost is not found again.

use super::{PastFrame, ShellTracker};
use crate::fit::dense::Factor;
use crate::fit::{
    ParameterPrior, ShellFit, ShellFitOptions, ShellProgress, ShellReadings, fit_shell_with_progress,
    undetermined,
};
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Error, Result};

/// Share of the mean variance that is added to predictions before they are inverted. An object at rest has
/// velocities that are known exactly.
const RIDGE: f64 = 1e-10;

/// What all frames of a sequence tell of each.
pub struct SmoothedMotion<'a, 't> {
    tracker: &'a ShellTracker<'t>,
    /// What the other frames tell of each one; none where it could not be separated from its own readings.
    priors: Vec<Option<ParameterPrior>>,
}

impl<'t> ShellTracker<'t> {
    /// The motion by all frames so far. Memory: each frame keeps 3.6 MB with 100 controls, and four times
    /// that with twice as many.
    ///
    /// # Errors
    /// `Undetermined` if the motion between two frames has no covariance.
    pub fn smoothed(&self) -> Result<SmoothedMotion<'_, 't>> {
        let mut priors = Vec::with_capacity(self.past.len());
        let mut later: Option<(&PastFrame, DVector<f64>, DMatrix<f64>)> = None;
        for frame in self.past.iter().rev() {
            let (mean, covariance) = match &later {
                Some((next, mean, covariance)) => self.smoothed_by(frame, next, mean, covariance)?,
                None => (frame.mean.clone(), frame.covariance.clone()),
            };
            priors.push(self.by_others(frame, &mean, &covariance));
            later = Some((frame, mean, covariance));
        }
        priors.reverse();
        Ok(SmoothedMotion { tracker: self, priors })
    }

    /// A frame given the smoothed estimate of the next one.
    fn smoothed_by(
        &self,
        frame: &PastFrame,
        next: &PastFrame,
        mean: &DVector<f64>,
        covariance: &DMatrix<f64>,
    ) -> Result<(DVector<f64>, DMatrix<f64>)> {
        let (predicted, mut spread) = self.moved(&frame.mean, &frame.covariance, next.motion.as_ref());
        let ridge = RIDGE * spread.trace() / spread.nrows() as f64;
        (0..spread.nrows()).for_each(|k| spread[(k, k)] += ridge);
        let inverse = Factor::new(&spread).ok_or_else(undetermined)?.inverse();
        let gain = &frame.covariance * self.step().transpose() * inverse;
        let smoothed = &frame.covariance + &gain * (covariance - spread) * gain.transpose();
        Ok((&frame.mean + gain * (mean - predicted), 0.5 * (&smoothed + smoothed.transpose())))
    }

    /// What all frames tell of one, without its own readings and with the smoothness of shapes.
    fn by_others(
        &self,
        frame: &PastFrame,
        mean: &DVector<f64>,
        covariance: &DMatrix<f64>,
    ) -> Option<ParameterPrior> {
        let n = self.deformation.parameters();
        let all = Factor::new(&covariance.view((0, 0), (n, n)).into_owned())?.inverse();
        let (shape, along) = frame.shape.0.weighed(frame.shape.1);
        let vector = &all * mean.rows(0, n) - &frame.vector + along;
        let floor = DMatrix::identity(n, n) * self.floor();
        let information = all - &frame.information + shape + floor;
        let mean = Factor::new(&information)?.solve(&vector);
        Some(ParameterPrior { mean, information })
    }
}

impl SmoothedMotion<'_, '_> {
    /// Fits a frame again, to its readings and to what the other frames tell; none for a frame of which they
    /// tell nothing that can be separated from its own readings. Frames count from 0.
    ///
    /// # Errors
    /// As [`super::super::fit_shell`], and the error of `watch`; `Input` for a frame that the tracker has not
    /// followed.
    pub fn fit(
        &self,
        frame: usize,
        readings: &ShellReadings<'_>,
        watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
    ) -> Result<Option<ShellFit>> {
        let ShellTracker { mesh, deformation, options, past, .. } = self.tracker;
        let Some((prior, past)) = self.priors.get(frame).zip(past.get(frame)) else {
            return Err(Error::input(format!(
                "expected one of the {} frames that were followed, found frame {frame}",
                self.priors.len()
            )));
        };
        let Some(prior) = prior else { return Ok(None) };
        let finest = options.softness.1;
        let options = ShellFitOptions {
            start: Some(past.found.clone()),
            prior: Some(prior.clone()),
            stiffness: None,
            rigidity: None,
            steps: 1,
            softness: (finest, finest),
            ..options.clone()
        };
        fit_shell_with_progress(mesh, *deformation, readings, &options, watch).map(Some)
    }
}
