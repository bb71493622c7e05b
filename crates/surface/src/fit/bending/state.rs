//! One state of a sheet that bends, from its readings and the state before.
//!
//! Input: the state before, the lengths of the sheet, and observations. Output: a [`ConvergedFit`] whose
//! prior contains all information besides the heights of the readings. See [`super`].

use super::{Lengths, SIGMA_STRETCH};
use crate::fit::FitOptions;
use crate::fit::first::ShownShape;
use crate::fit::leaves::{leaf_areas, leaves_with_feet};
use crate::fit::noise::SensorNoise;
use crate::fit::refine::{ConvergedFit, ConvergedKind};
use crate::fit::weights::{Weighting, weight_of_length, weights};
use crate::observe::surface_extent;
use crate::observe::{Foot, FootState, ProjectedReadings, accumulate, by_leaf, project};
use crate::observe::{Observations, Quantity, ReadingColumns};
use crate::subdivision::RefinementLog;
use planish_core::vector3::coordinates;
use planish_core::{DVec3, Progress};
use planish_estimate::sparse::{BlockInformation, SelectedInverse};
use planish_estimate::{Error, Result};
use planish_spline::{FootPointSearch, Surface, SurfaceSystem, leaf_weights};

/// Relative σ of lengths in the first iteration, and iterations until it has its final value.
///
/// A flat sheet that is stiff from the start cannot leave its plane: to first order a normal displacement
/// changes no length, to second order all (decision 0020).
const FIRST_STRETCH: f64 = 0.1;
const ANNEALING: usize = 10;
/// Largest number of iterations, and mean square step of a converged state, in variances of a vertex.
const MAX_ITERATIONS: usize = 40;
const CONVERGED_STEP: f64 = 1e-3;
/// Length over which displacements are smoothed at the start, and at most, in square roots of the sheet's
/// area.
const FIRST_SMOOTHING: f64 = 0.1;
const MAX_STIFFNESS: f64 = 2.0;
/// σ of sliding along the sheet, in leaves.
///
/// Range readings do not determine sliding, so some hold is needed. A tighter one would resist the bending
/// itself.
const SLIDING_SIGMA: f64 = 5.0;
/// Readings beyond the border belong to the sheet if they are nearer to it than this share of its extent.
/// Their pull is bounded beyond [`BOUNDED_FROM_SIGMAS`] spacings of the readings.
const BORDER_REACH: f64 = 0.1;
const BOUNDED_FROM_SIGMAS: f64 = 3.0;

/// The problem of one state.
pub(super) struct Sheet<'a> {
    pub system: &'a SurfaceSystem,
    pub lengths: &'a Lengths,
    /// The state before.
    pub previous: &'a Surface,
    pub options: &'a FitOptions,
}

/// A converged state.
pub(super) struct BentState {
    pub converged: ConvergedFit,
    /// Number of readings beyond the border.
    pub beyond: usize,
    /// For each leaf, true if it holds readings of this time.
    pub held: Vec<bool>,
}

/// The parts of the prior that do not change from iteration to iteration.
struct FixedPrior {
    /// Thin plate over the displacement: `K`, and `K x` of the state before.
    smooth: BlockInformation,
    /// Weak hold of points along the sheet.
    sliding: BlockInformation,
}

impl Sheet<'_> {
    /// Lays the sheet on the readings.
    ///
    /// The weight of the smooth displacement is estimated after the annealing only: until then the
    /// displacement is not yet that of the sheet. Its changes are bounded as in [`crate::fit::refine`].
    ///
    /// # Errors
    /// `Undetermined` if no reading is near the sheet.
    pub(super) fn fit(&self, observations: &mut Observations, progress: &dyn Progress) -> Result<BentState> {
        let Self { system, previous, .. } = *self;
        let search = FootPointSearch::new(previous, 2, 0.1 * surface_extent(previous))?;
        observations.orient_by(|p| {
            let [u, v] = search.nearest(p, DVec3::ZERO);
            previous.normal(u, v).unwrap_or(DVec3::ZERO)
        });
        let subset = observations.fitted();
        let fixed = self.fixed_prior()?;
        let area: f64 = leaf_areas(previous).iter().sum();
        let spacing = (area / subset.len().max(1) as f64).sqrt();
        let mut at = vec![[0.0; 2]; observations.len()];
        let mut noise = SensorNoise::stated(&observations.channels);
        let unknown = vec![0.0; observations.channels.len()];
        let mut surface = previous.clone();
        let (mut weight, mut has_converged) = (None, false);
        let gate = self.options.gate;
        for iteration in 0..MAX_ITERATIONS {
            progress.check("bending", iteration as f64 / MAX_ITERATIONS as f64)?;
            progress.items(iteration * subset.len(), "readings");
            let annealed = iteration >= ANNEALING;
            // The sheet moves far in the first iterations, so feet are searched for anew; later every fifth
            // time.
            let search = if annealed && iteration % 5 != 0 {
                None
            } else {
                Some(FootPointSearch::new(&surface, 2, 0.1 * surface_extent(&surface))?)
            };
            let feet =
                project(&surface, observations, &subset, &mut at, search.as_ref(), &noise.variance_factors);
            let readings = ProjectedReadings { observations, subset: &subset, feet: &feet };
            noise = SensorNoise::estimate(readings, self.options.noise_rules(), &unknown, annealed)?;
            // While lengths are soft, residuals are mostly shape: far readings pull with bounded force.
            let weighting = if annealed { Weighting::Gated } else { Weighting::Bounded };
            let information = weights(readings, &noise, gate, weighting);
            if !information.iter().any(|&w| w > 0.0) {
                return Err(Error::undetermined(
                    "expected readings near the previous state of the sheet, found none: check that the \
                     scans have one frame and show the same sheet",
                ));
            }
            let smoothing = |length: f64| weight_of_length(&feet, &information, area, length * area.sqrt());
            let now = weight.unwrap_or_else(|| smoothing(FIRST_SMOOTHING));
            let data = accumulate(system, &surface, &feet, &information)?;
            let border = self.border(&surface, &observations.readings, &subset, &feet, spacing)?;
            let prior = self.prior(&fixed, &surface, border, now, iteration)?;
            let mut total = data.clone();
            total.add_scaled(&prior, 1.0)?;
            let factor = system.factorize(&total)?;
            let mut solution = total.vector().to_vec();
            factor.solve_in_place(&mut solution)?;
            let step = solution
                .iter()
                .zip(coordinates(surface.vertices()))
                .map(|(new, old)| new - old)
                .collect::<Vec<f64>>();
            // Newton's decrement for each unknown: the mean square of the step in its own variances.
            let decrement = total.quadratic_form(&step)? / step.len() as f64;
            surface = system.surface(&solution)?;
            let mut next = now;
            if annealed {
                next = likeliest_weight(&fixed, &solution, previous, &SelectedInverse::new(&factor), now)?
                    .clamp(0.2 * now, 5.0 * now)
                    .min(smoothing(MAX_STIFFNESS));
            }
            weight = Some(next);
            has_converged = annealed && decrement < CONVERGED_STEP && (next / now - 1.0).abs() < 0.05;
            if has_converged {
                break;
            }
        }
        let feet = project(&surface, observations, &subset, &mut at, None, &noise.variance_factors);
        let readings = ProjectedReadings { observations, subset: &subset, feet: &feet };
        let noise = SensorNoise::estimate(readings, self.options.noise_rules(), &unknown, true)?;
        let border = self.border(&surface, &observations.readings, &subset, &feet, spacing)?;
        let weight = weight.unwrap_or(0.0);
        let prior = self.prior(&fixed, &surface, border, weight, MAX_ITERATIONS)?;
        let beyond = (subset.iter().zip(&feet))
            .filter(|(i, foot)| {
                beyond_by(&surface, &observations.readings, **i, foot).is_some_and(|d| d > spacing)
            })
            .count();
        let information = weights(readings, &noise, gate, Weighting::Gated);
        let held = leaves_with_feet(&surface, &feet, &information, |_| true);
        let converged = ConvergedFit {
            surface,
            system: system.clone(),
            subset,
            feet,
            noise,
            weight,
            prior,
            at,
            reached_limit: !has_converged,
            reached_tolerance: false,
            refined: RefinementLog::default(),
            kind: ConvergedKind::Free,
            marginal: None,
            shown: ShownShape::default(),
        };
        Ok(BentState { converged, beyond, held })
    }

    fn fixed_prior(&self) -> Result<FixedPrior> {
        let mut smooth = self.system.thin_plate(self.previous)?.expanded(3)?;
        let x: Vec<f64> = coordinates(self.previous.vertices()).to_vec();
        let mut pull = vec![0.0; x.len()];
        smooth.multiply(&x, &mut pull)?;
        // The energy is that of the displacement x − x₀, so the information vector is K x₀.
        smooth.vector_mut().copy_from_slice(&pull);
        Ok(FixedPrior { smooth, sliding: self.system.tangential_hold(self.previous, SLIDING_SIGMA)? })
    }

    /// All information besides the heights of the readings, linearised at a surface.
    fn prior(
        &self,
        fixed: &FixedPrior,
        surface: &Surface,
        border: BlockInformation,
        weight: f64,
        iteration: usize,
    ) -> Result<BlockInformation> {
        // Geometric from the first to the final σ: every iteration stiffens the sheet by the same factor.
        let left = 1.0 - (iteration as f64 / ANNEALING as f64).min(1.0);
        // The relative σ of a squared length is twice that of the length.
        let softness = 2.0 * (SIGMA_STRETCH * (FIRST_STRETCH / SIGMA_STRETCH).powf(left));
        // The final σ contains the stretch of the sheet already: it must not be added twice.
        let softness = if left > 0.0 { softness } else { 0.0 };
        let sigma: Vec<f64> = self.lengths.sigma.iter().map(|s| s.hypot(softness)).collect();
        let mut prior = self.system.isometry(surface, &self.lengths.metric, &sigma)?;
        prior.add_scaled(&fixed.smooth, weight)?;
        prior.add_scaled(&fixed.sliding, 1.0)?;
        prior.add_scaled(&border, 1.0)?;
        Ok(prior)
    }

    /// Equations of readings beyond the border: the border lies at each of them to within their spacing.
    fn border(
        &self,
        surface: &Surface,
        readings: &ReadingColumns,
        subset: &[u32],
        feet: &[Foot],
        spacing: f64,
    ) -> Result<BlockInformation> {
        let (start, order) = by_leaf(feet, surface.space().leaves().len());
        let reach = BORDER_REACH * surface_extent(surface);
        self.system.accumulate(|leaf, cell| {
            let mut any = false;
            for k in order[start[leaf] as usize..start[leaf + 1] as usize].iter().map(|&k| k as usize) {
                let foot = &feet[k];
                let Some(distance) = beyond_by(surface, readings, subset[k], foot).filter(|d| *d < reach)
                else {
                    continue;
                };
                // Huber's weight: a reading far beyond the border must not tear it out.
                let w = spacing.powi(-2) * (BOUNDED_FROM_SIGMAS * spacing / distance).min(1.0);
                let z = readings.points[subset[k] as usize];
                cell.add_vector(&leaf_weights(foot.local[0], foot.local[1]), z, &[w, 0.0, 0.0, w, 0.0, w]);
                any = true;
            }
            any
        })
    }
}

/// Distance of a position beyond the border, along the sheet; none if it is not beyond.
fn beyond_by(surface: &Surface, readings: &ReadingColumns, reading: u32, foot: &Foot) -> Option<f64> {
    if foot.state != FootState::BeyondBorder || foot.quantity != Quantity::Position {
        return None;
    }
    let from = surface.leaf_point(foot.leaf as usize, foot.local[0], foot.local[1]);
    let off = readings.points[reading as usize] - from;
    // Along the sheet only: the component along the normal is noise or bending.
    Some((off - off.dot(foot.normal) * foot.normal).length())
}

/// The next weight of the thin plate by marginal likelihood (Wood & Fasiolo 2017, eq. 6).
fn likeliest_weight(
    fixed: &FixedPrior,
    solution: &[f64],
    previous: &Surface,
    covariance: &SelectedInverse,
    weight: f64,
) -> Result<f64> {
    let displacement: Vec<f64> =
        solution.iter().zip(coordinates(previous.vertices())).map(|(new, old)| new - old).collect();
    // A plate leaves three functions of each coordinate free.
    let rank = displacement.len() as f64 - 9.0;
    let determined = rank - weight * covariance.trace_with(&fixed.smooth)?;
    Ok(determined.max(1.0) / fixed.smooth.quadratic_form(&displacement)?.max(f64::MIN_POSITIVE))
}
