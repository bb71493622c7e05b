//! Update of a saved model: new readings on a surface whose hierarchy stays.

use super::FitOptions;
use super::finish::variances_of_surface;
use super::first::ShownShape;
use super::local_misfit::local_variances;
use super::noise::SensorNoise;
use super::refine::{ConvergedFit, ConvergedKind};
use super::weights::{Weighting, weights_with_surface_variance};
use crate::model::{Posterior, SurfaceModel, VertexInformation};
use crate::observe::{Foot, FootChannels, Observations, ProjectedReadings, StepInput, normal_step, project};
use crate::subdivision::RefinementLog;
use planish_core::Progress;
use planish_estimate::Result;
use planish_estimate::sparse::CholeskyFactor;
use planish_spline::{FootPointSearch, Surface, SurfaceSystem};
use std::sync::Arc;

/// Iterations of an update. The surface starts near its readings, so a few are enough; the last one only
/// projects them.
const ITERATIONS: u8 = 4;

/// The state of an update between its iterations.
struct Update<'a> {
    model: &'a SurfaceModel,
    /// The model's information about its vertices.
    information: &'a VertexInformation,
    system: &'a SurfaceSystem,
    options: &'a FitOptions,
    subset: Vec<u32>,
    surface: Surface,
    at: Vec<[f64; 2]>,
    noise: SensorNoise,
    degrees: Vec<f64>,
    /// The noise that the model before the update predicts, after the first projection.
    predicted: Option<SensorNoise>,
    /// Variance of the surface at each foot before the update: readings may be that far off as well, until
    /// the surface includes them.
    variance_before: Vec<f64>,
}

/// Adds observations to a model whose hierarchy stays.
pub(super) fn add_to_model(
    model: &SurfaceModel,
    information: &VertexInformation,
    observations: &mut Observations,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<ConvergedFit> {
    let system = SurfaceSystem::new(model.surface.space())?;
    let mut update = Update {
        model,
        information,
        system: &system,
        options,
        subset: observations.fitted(),
        surface: model.surface.clone(),
        at: vec![[0.0; 2]; observations.len()],
        noise: SensorNoise::stated(&observations.channels),
        degrees: vec![0.0; observations.channels.len()],
        predicted: None,
        variance_before: Vec::new(),
    };
    let (mut feet, mut factor) = (Vec::new(), None);
    for iteration in 0..ITERATIONS {
        progress.check("adding", 0.2 + 0.15 * f64::from(iteration))?;
        progress.items(usize::from(iteration) * update.subset.len(), "readings");
        feet = update.project(observations, iteration == 0)?;
        if iteration + 1 < ITERATIONS {
            update.step(observations, &feet, &mut factor)?;
        }
    }
    let Update { subset, surface, at, noise, .. } = update;
    Ok(ConvergedFit {
        surface,
        subset,
        feet,
        noise,
        weight: model.smoothness_weight,
        // Sessions add their data to one prior; a second prior would count smoothness twice.
        prior: information.prior.clone(),
        at,
        reached_limit: false,
        reached_tolerance: false,
        refined: RefinementLog::default(),
        kind: ConvergedKind::AlongNormals,
        marginal: None,
        shown: ShownShape::default(),
        system,
    })
}

impl Update<'_> {
    /// Projects the readings and estimates their noise.
    fn project(&mut self, observations: &Observations, is_first: bool) -> Result<Vec<Foot>> {
        let search = if is_first { Some(FootPointSearch::new(&self.surface, 2, 0.0)?) } else { None };
        let (subset, factors) = (&self.subset, &self.noise.variance_factors);
        let feet = project(&self.surface, observations, subset, &mut self.at, search.as_ref(), factors);
        // Before the first step, residuals contain the error of the surface as well. A stated σ is judged
        // with its variance added.
        let mut judged = Vec::new();
        if is_first {
            judged.clone_from(&feet);
            let before = Posterior::new(&self.model.surface, Arc::new(self.model.covariance(self.system)?));
            let before = before.with_excess_variance(&self.model.excess_variance);
            self.variance_before = variances_of_surface(&before, &feet)?;
            for ((foot, of_surface), &i) in judged.iter_mut().zip(&self.variance_before).zip(subset) {
                let stated = observations.channels[observations.channel(i as usize)].stated;
                foot.variance += if stated { *of_surface } else { 0.0 };
            }
        }
        let readings =
            ProjectedReadings { observations, subset, feet: if is_first { &judged } else { &feet } };
        self.noise = SensorNoise::estimate(readings, self.options.noise_rules(), &self.degrees, true)?;
        // After the first step the surface follows the new readings. Where these are few, only the noise
        // predicted before it does not depend on them.
        match &self.predicted {
            None => self.predicted = Some(self.noise.clone()),
            Some(predicted) => {
                self.noise.keep_where_redundancy_lacks(&observations.channels, predicted, &self.degrees);
                let readings = ProjectedReadings { observations, subset, feet: &feet };
                let misfit = local_variances(&self.surface, readings, &self.noise, self.options.gate)?;
                self.noise.local_variance = misfit;
            }
        }
        Ok(feet)
    }

    /// One step of the surface, and of the scans' poses and biases.
    fn step(
        &mut self,
        observations: &mut Observations,
        feet: &[Foot],
        factor: &mut Option<CholeskyFactor>,
    ) -> Result<()> {
        let readings = ProjectedReadings { observations, subset: &self.subset, feet };
        // The gate is widened by the surface's variance before the update: a reading may be far from a
        // surface that is not known there.
        let information =
            weights_with_surface_variance(readings, &self.noise, self.options.gate, Weighting::Gated, |k| {
                self.variance_before[k]
            });
        let step = normal_step(
            &StepInput {
                system: self.system,
                surface: &self.surface,
                feet,
                information: &information,
                channels: &FootChannels::new(observations, &self.subset),
                prior: &self.information.prior,
                weight: 1.0,
                earlier: Some(&self.information.data),
                damping: 0.0,
            },
            factor,
        )?;
        observations.apply_scan_error_step(&step.scan_errors);
        (self.surface, self.degrees) = (step.surface, step.degrees);
        Ok(())
    }
}
