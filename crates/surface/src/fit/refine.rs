//! The second stage of a fit: iterations and refinements until the residuals contain only noise.
//!
//! Input: a starting surface and the [`Observations`]. Output: a [`ConvergedFit`] with feet, noise and
//! smoothness weight. The information and its inverse are made from it once, by [`super::finish`].
//!
//! A round iterates the surface over one hierarchy. Early rounds use a sample of the readings and end with
//! the division of leaves that cannot follow them. The last round uses all readings and iterates until the
//! surface has converged.

use super::FitOptions;
use super::bending_energy::{BendingEnergy, WeightSearch};
use super::division::{Misfit, chance_misfits, deepest, divided_within_budget, growth_log, log_divisions};
use super::first::ShownShape;
use super::folds::refuse_folds_at_creases;
use super::inferred::share_errors;
use super::leaves::leaf_areas;
use super::local_misfit::local_variances;
use super::marginal::MarginalHeights;
use super::misfit::misfit;
use super::noise::SensorNoise;
use super::patch::PatchFilterOutcome;
use super::refine_by_curvature::leaves_of_varying_curvature;
use super::refine_by_roughness::leaves_coarser_than_smoothing;
use super::spline_error::leaves_missing_shape;
use super::weights::{Weighting, weight_of_length, weights};
use crate::observe::{
    Foot, FootChannels, Observations, ProjectedReadings, Quantity, StepInput, normal_step, project,
    surface_extent,
};
use crate::subdivision::{Cause, RefineBy, RefinementLog};
use planish_core::Progress;
use planish_estimate::sparse::{BlockInformation, CholeskyFactor};
use planish_estimate::{Error, Result};
use planish_spline::{FootPointSearch, Hierarchy, Surface, SurfaceSystem};
use std::collections::HashSet;
use std::sync::Arc;

/// Minimum and maximum number of iterations of an early round.
const FINDING_ITERATIONS: usize = 2;
const MAX_FINDING_ITERATIONS: usize = 8;
/// An early round ends once the mean square step is below this many variances of the surface. The next
/// round changes the surface by more than that, so further iterations would be wasted.
const EARLY_ROUND_STEP: f64 = 30.0;
/// Maximum number of iterations of the last round, without and with unknown poses of scans.
const LAST_ITERATIONS: usize = 7;
const LAST_ITERATIONS_WITH_POSES: usize = 30;
/// Iterations of the last round in which the misfit of leaves is estimated anew.
const LOCAL_ITERATIONS: usize = 4;
/// The surface has converged when the mean square step that readings see is this share of its variance.
/// Smaller values cost iterations for changes well within σ. See decision 0004.
const CONVERGED_STEP: f64 = 0.1;
/// The same bound where only the prior holds the surface, which has a longer way to go there. Waiting for
/// these parts as well took twice as many rounds and changed no reading (decision 0004).
const CONVERGED_UNSEEN_STEP: f64 = 4.0;
/// Bound of the step of poses and biases of scans, squared in standard deviations of all their unknowns
/// together. Scans slide along the surface with the feet of their readings and come nearer by about half in
/// each iteration, so the bound is tighter. It is no mean: all scans refer to the same anchor, so the last
/// direction to converge is often one of all scans (decision 0096).
const CONVERGED_SCAN_ERRORS: f64 = 0.02;
/// Relative change of the smoothness weight below which it has converged.
const CONVERGED_WEIGHT: f64 = 0.02;
/// Readings of each leaf that an early round uses, on average, and their minimum in all.
///
/// A leaf needs [`super::division::MIN_READINGS`] readings to be tested, so a smaller sample would hide
/// misfits. A larger one projects more readings in rounds whose surface is refined anyway.
const SAMPLE_PER_LEAF: usize = 12;
const MIN_SAMPLE: usize = 40_000;
/// Readings for each of the sample of the last early round. In a smaller sample, noise hides what the cells
/// miss: [`super::spline_error::NOISE_SHARE`] of its variance would exceed that of all readings.
const READINGS_PER_SAMPLED: usize = 10;
/// Shortest length over which the prior smooths at the start, in leaves.
///
/// A stiffer start would undo what growth has found; a softer one would follow few readings anywhere. See
/// decision 0003.
const FIRST_SMOOTHING: f64 = 0.15;
/// Severity of residuals that is not by chance, and the number of such leaves, also as a share of those by
/// chance, up to which a surface is fine enough. Few leaves in many had shape of 3 mm, the tips of ears.
/// Single leaves are rather gross errors, or a sensor whose σ is stated too small.
const CERTAIN: f64 = 10.0;
const MAX_CERTAIN: usize = 3;
const MAX_CERTAIN_SHARE: f64 = 0.01;
/// Longest length over which the prior smooths, in square roots of the surface's area. A stiffer plate would
/// be no flatter, but the information of the readings about its place would be lost in rounding. See
/// decision 0003.
const STIFFEST: f64 = 2.0;
/// σ of tangential motion, as a share of a leaf's size. It names points of the surface without a measurable
/// effect on its shape. See decision 0002.
pub(super) const TANGENTIAL_HOLD: f64 = 0.5;

/// A surface that has converged on its observations.
pub(super) struct ConvergedFit {
    pub surface: Surface,
    pub system: SurfaceSystem,
    /// The readings that take part, and their feet.
    pub subset: Vec<u32>,
    pub feet: Vec<Foot>,
    pub noise: SensorNoise,
    pub weight: f64,
    /// The prior's information of all three coordinates.
    pub prior: BlockInformation,
    /// Parameters of every observation.
    pub at: Vec<[f64; 2]>,
    pub reached_limit: bool,
    pub reached_tolerance: bool,
    /// The divisions made on the way.
    pub refined: RefinementLog,
    pub kind: ConvergedKind,
    /// The posterior over σ and the weight, if the readings were few.
    pub marginal: Option<MarginalHeights>,
    /// What the readings showed before the fit.
    pub shown: ShownShape,
}

/// How the vertices of a converged surface are known; each kind becomes a [`crate::model::Knowledge`].
pub(super) enum ConvergedKind {
    /// Each vertex moves along its normal.
    AlongNormals,
    /// Vertices move in every direction.
    Free,
    /// The patch filter holds all that is known.
    Patches(PatchFilterOutcome),
}

impl ConvergedKind {
    /// The outcome of the patch filter, if it fused the readings.
    pub(super) fn filtered(&self) -> Option<&PatchFilterOutcome> {
        match self {
            Self::Patches(filtered) => Some(filtered),
            Self::AlongNormals | Self::Free => None,
        }
    }
}

impl ConvergedFit {
    /// The readings that take part, with their feet.
    pub(super) fn readings<'a>(&'a self, observations: &'a Observations) -> ProjectedReadings<'a> {
        ProjectedReadings { observations, subset: &self.subset, feet: &self.feet }
    }
}

/// The state of a refinement.
struct Refinement<'a> {
    observations: &'a mut Observations,
    options: &'a FitOptions,
    /// The readings that take part, and those of them that look for the shape: on a surface with their
    /// neighbours.
    subset: Vec<u32>,
    searching: Vec<u32>,
    surface: Surface,
    /// Parameters of every observation; not a number where none has been searched yet.
    at: Vec<[f64; 2]>,
    noise: SensorNoise,
    /// Weight of the thin plate, once there is one.
    weight: Option<f64>,
    weight_search: WeightSearch,
    /// Area of the first surface.
    area: Option<f64>,
    /// Degrees of freedom that the readings of each channel determine.
    degrees: Option<Vec<f64>>,
    /// Readings outside the gate in the last early round: they are searched for anew in the last round.
    outside: Vec<u32>,
    /// Readings that an early round uses at least.
    min_sample: usize,
    /// Readings projected so far, for the display of progress.
    projected: usize,
}

/// Factor of the damping of steps on surfaces with creases from one iteration of a round to the next, and its
/// share below which it changes nothing. With a constant one, a wedge of 15° stayed 0.01 mm away from the
/// solution, whose σ was 0.0025 mm, because the small cells along its edges hardly moved.
const DAMPING_FALLS: f64 = 0.1;
const UNDAMPED: f64 = 2e-3;

/// A round of a refinement.
#[derive(Clone, Copy)]
struct Round {
    number: usize,
    /// True for the last round, which uses all readings.
    is_last: bool,
    /// Iterations of this round that are done.
    iteration: usize,
}

impl Round {
    /// The damping of its next step.
    fn damping(&self) -> f64 {
        DAMPING_FALLS.powi(self.iteration as i32)
    }
}

/// The equations of a round, over one hierarchy.
struct RoundEquations<'a> {
    system: &'a SurfaceSystem,
    energy: BendingEnergy,
    /// The last factor; the next step uses its memory again.
    factor: Option<CholeskyFactor>,
}

/// Iterates and refines until the residuals contain only noise.
///
/// # Errors
/// `Undetermined` if no reading is near the surface, or the readings near it leave its shape open.
pub(super) fn refine_to_noise(
    observations: &mut Observations,
    surface: Surface,
    subset: Vec<u32>,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<ConvergedFit> {
    // A ball has grown before this stage, so the log starts with its levels.
    let mut refined = growth_log(surface.space(), 1);
    let (mut reached_limit, mut reached_tolerance) = (false, false);
    let mut is_last = false;
    let searching = searching_readings(observations, &subset);
    let mut state = Refinement {
        // NaN marks readings that were not searched for: samples of different rounds overlap only in part.
        at: vec![[f64::NAN; 2]; observations.len()],
        noise: SensorNoise::stated(&observations.channels),
        observations,
        options,
        subset,
        searching,
        surface,
        weight: None,
        weight_search: WeightSearch::default(),
        area: None,
        degrees: None,
        outside: Vec::new(),
        min_sample: MIN_SAMPLE,
        projected: 0,
    };
    for number in 0.. {
        let round = Round { number, is_last, iteration: 0 };
        // One pattern and one elimination order serve all steps of a round. They are found by one thread,
        // feet by the others.
        let space = Arc::clone(state.surface.space());
        let sample = state.sample(round);
        let (system, found) =
            rayon::join(|| SurfaceSystem::new(&space), || state.find_parameters(&sample, round));
        found?;
        let system = system?;
        let factor = state.iterate(&system, &sample, round, progress)?;
        if is_last {
            let fit = state.converged(system)?;
            return Ok(ConvergedFit { reached_limit, reached_tolerance, refined, ..fit });
        }
        refuse_folds_at_creases(&state.surface)?;
        let mut division = state.leaves_to_divide(&sample, factor.as_ref())?;
        let space = state.surface.space();
        reached_tolerance |= options.tolerance.is_some() && division.by_residuals == 0;
        if !division.is_beyond_chance(space) {
            // A larger sample shows what noise hides in a smaller one.
            is_last = !state.enlarge_sample(sample.len());
            continue;
        }
        // Worst first: if the limit of coefficients stops the division, the next round is the last.
        let (finer, divided) = divided_within_budget(space, &division.misfits, options.max_coefficients);
        let all = divided == division.misfits.len();
        log_divisions(&mut refined, space, &finer, &division.misfits[..divided]);
        reached_limit = !all;
        is_last = !all || finer.node_count() == space.node_count();
        state.surface = state.surface.refined(finer.into())?;
    }
    unreachable!("the loop ends by returning")
}

/// Leaves that should be divided.
struct LeavesToDivide {
    misfits: Vec<Misfit>,
    /// Number of misfits before roughness is considered.
    by_residuals: usize,
}

impl LeavesToDivide {
    /// False if there are no more misfits than by chance. Of few, only those remain that are certain.
    ///
    /// Some leaves are significant by chance. Dividing them would create new ones of the same kind, without
    /// end.
    fn is_beyond_chance(&mut self, space: &Hierarchy) -> bool {
        let by_chance = chance_misfits(space);
        if self.misfits.len() >= by_chance {
            return true;
        }
        self.misfits.retain(|m| m.cause == Cause::Residuals && m.severity > CERTAIN);
        self.misfits.len() > MAX_CERTAIN.max((MAX_CERTAIN_SHARE * by_chance as f64) as usize)
    }
}

impl Refinement<'_> {
    /// The readings of a round. An early round needs a few dozen for each leaf only.
    fn sample(&mut self, round: Round) -> Vec<u32> {
        if round.is_last {
            // The last round uses more readings, so its rate is counted anew.
            self.projected = 0;
            return self.subset.clone();
        }
        let wanted = (SAMPLE_PER_LEAF * self.surface.space().leaves().len()).max(self.min_sample);
        self.searching.iter().copied().step_by((self.searching.len() / wanted).max(1)).collect()
    }

    /// Readings of all batches that look for the shape.
    fn whole(&self) -> usize {
        self.searching.len() * (1 + self.observations.intake.later_batches)
    }

    /// Readings that the last early round uses at least.
    fn last_sample(&self) -> usize {
        (self.whole() / READINGS_PER_SAMPLED).min(self.searching.len())
    }

    /// Enlarges the sample of early rounds; false if `sample` is large enough for the last of them.
    fn enlarge_sample(&mut self, sample: usize) -> bool {
        self.min_sample = self.min_sample.max(self.last_sample());
        sample < self.last_sample()
    }

    /// Searches for the parameters of new readings, with their normals.
    ///
    /// Later a foot is followed from where it was. In the last round, readings outside the gate are searched
    /// for anew: their feet may have been caught on another part of the surface.
    fn find_parameters(&mut self, sample: &[u32], round: Round) -> Result<()> {
        let again = if round.is_last { std::mem::take(&mut self.outside) } else { Vec::new() };
        let new = sample.iter().copied().filter(|&i| self.at[i as usize][0].is_nan());
        let searched: Vec<u32> = new.chain(again).collect();
        if !searched.is_empty() {
            let search = FootPointSearch::new(&self.surface, 2, 0.1 * surface_extent(&self.surface))?;
            let factors = &self.noise.variance_factors;
            project(&self.surface, self.observations, &searched, &mut self.at, Some(&search), factors);
        }
        Ok(())
    }

    /// Projects readings, from the parameters that they have.
    fn project(&mut self, readings: &[u32]) -> Vec<Foot> {
        let factors = &self.noise.variance_factors;
        let mut feet = project(&self.surface, self.observations, readings, &mut self.at, None, factors);
        // The variance of inferred readings depends on the present weight of the plate.
        share_errors(self.observations, readings, &mut feet, &self.surface, self.weight);
        feet
    }

    /// Iterates over one hierarchy; returns the last factor.
    fn iterate(
        &mut self,
        system: &SurfaceSystem,
        sample: &[u32],
        round: Round,
        progress: &dyn Progress,
    ) -> Result<Option<CholeskyFactor>> {
        let iterations = if round.is_last && !self.observations.scan_errors.is_empty() {
            LAST_ITERATIONS_WITH_POSES
        } else if round.is_last {
            LAST_ITERATIONS
        } else {
            MAX_FINDING_ITERATIONS
        };
        // The metric stays that of the surface at the start of the round, so the energy is quadratic and each
        // step solves linear equations.
        let energy = BendingEnergy::new(system, &self.surface)?;
        let mut equations = RoundEquations { system, energy, factor: None };
        for iteration in 0..iterations {
            let rounds = round.number as f64 + iteration as f64 / iterations as f64;
            // The number of rounds is not known, so the progress approaches its end geometrically.
            let share = 0.4 + 0.5 * (1.0 - 0.6_f64.powf(rounds));
            progress.check(if round.is_last { "settling" } else { "refining" }, share)?;
            progress.items(self.projected, "readings");
            self.projected += sample.len();
            let rest = self.step(&mut equations, sample, Round { iteration, ..round }, progress)?;
            let is_found =
                !round.is_last && iteration + 1 >= FINDING_ITERATIONS && rest.decrement < EARLY_ROUND_STEP;
            if rest.has_converged || is_found {
                break;
            }
        }
        Ok(equations.factor)
    }

    /// One iteration: project, weigh, solve, and update the smoothness weight.
    fn step(
        &mut self,
        equations: &mut RoundEquations<'_>,
        sample: &[u32],
        round: Round,
        progress: &dyn Progress,
    ) -> Result<StepOutcome> {
        let RoundEquations { system, energy, factor } = equations;
        if round.iteration == 0 {
            self.weight_search = WeightSearch::default();
        }
        let gate = self.options.gate;
        let feet = self.project(sample);
        let readings = ProjectedReadings { observations: self.observations, subset: sample, feet: &feet };
        let channels = FootChannels::new(self.observations, sample);
        // The noise needs degrees of freedom, and these need a solution. A rough guess starts the cycle.
        let degrees = self.degrees.get_or_insert_with(|| first_degrees(&self.surface, &channels));
        let local_variance = std::mem::take(&mut self.noise.local_variance);
        self.noise = SensorNoise::estimate(readings, self.options.noise_rules(), degrees, round.is_last)?;
        // Held after some iterations: leaves at the limit of significance would change the weights in turn.
        self.noise.local_variance = match round.iteration {
            0..LOCAL_ITERATIONS if round.is_last => {
                local_variances(&self.surface, readings, &self.noise, gate)?
            }
            _ => local_variance,
        };
        // A start with creases has no lost tips. Beside a crease, readings on one side may belong to the face
        // beyond it.
        let weighting = match (self.surface.space().has_creases(), round.is_last) {
            (false, false) => Weighting::BoundedByLeaf,
            (false, true) => Weighting::BoundedWithinGate,
            (true, false) => Weighting::Bounded,
            (true, true) => Weighting::Gated,
        };
        let information = weights(readings, &self.noise, gate, weighting);
        if !information.iter().any(|&w| w > 0.0) {
            return Err(Error::undetermined(
                "expected readings near the surface, found none: they lie in two layers or on several \
                 objects, or the scans differ in frame or unit",
            ));
        }
        progress.rms(rms_of_positions(&feet, &information));
        let surface = &self.surface;
        let area = *self.area.get_or_insert_with(|| leaf_areas(surface).iter().sum());
        // The first iteration starts from a weight by the density of readings; later ones from the estimate.
        let weight = self.weight.unwrap_or_else(|| first_weight(surface, area, &feet, &information));
        let step = normal_step(
            &StepInput {
                system,
                surface,
                feet: &feet,
                information: &information,
                channels: &channels,
                prior: &energy.matrix,
                weight,
                earlier: None,
                damping: round.damping(),
            },
            factor,
        )?;
        self.observations.apply_scan_error_step(&step.scan_errors);
        self.surface = step.surface;
        energy.measure(&self.surface);
        let next = energy.next_weight(weight, step.degrees.iter().sum::<f64>());
        let stiffest = weight_of_length(&feet, &information, area, STIFFEST * area.sqrt());
        let next = self.weight_search.next(weight, next.min(stiffest));
        self.weight = Some(next);
        self.degrees = Some(step.degrees);
        Ok(StepOutcome {
            has_converged: (round.damping() < UNDAMPED || !self.surface.space().has_creases())
                && step.seen < CONVERGED_STEP
                && step.scan_error_decrement < CONVERGED_SCAN_ERRORS
                && step.decrement < CONVERGED_UNSEEN_STEP
                && (next / weight - 1.0).abs() < CONVERGED_WEIGHT,
            decrement: step.decrement,
        })
    }

    /// The leaves that cannot follow their readings, or whose shape asks for smaller cells.
    fn leaves_to_divide(
        &mut self,
        sample: &[u32],
        factor: Option<&CholeskyFactor>,
    ) -> Result<LeavesToDivide> {
        let options = self.options;
        // The last step has moved the surface since its feet were found.
        let feet = self.project(sample);
        let readings = ProjectedReadings { observations: self.observations, subset: sample, feet: &feet };
        let kept = weights(readings, &self.noise, options.gate, Weighting::Gated);
        self.outside = sample.iter().zip(&kept).filter(|(_, w)| **w == 0.0).map(|(i, _)| *i).collect();
        let degrees = self.degrees.iter().flatten().sum();
        let mut misfits = if options.refine_by.residuals() {
            misfit(&self.surface, readings, &self.noise, degrees, options)
        } else {
            Vec::new()
        };
        // A leaf is divided once, for the first cause that finds it.
        let mut known: HashSet<usize> = misfits.iter().map(|m| m.leaf).collect();
        if options.refine_by.residuals() && options.tolerance.is_none() {
            let per_sampled = self.whole() as f64 / sample.len() as f64;
            let missing =
                leaves_missing_shape(&self.surface, &feet, &kept, degrees, per_sampled, deepest(options));
            misfits.extend(missing.into_iter().filter(|m| !known.contains(&m.leaf)));
            known.extend(misfits.iter().map(|m| m.leaf));
        }
        if let (true, Some(factor)) = (options.refine_by.curvature(), factor) {
            let curved =
                leaves_of_varying_curvature(&self.surface, factor, readings, &self.noise, deepest(options))?;
            misfits.extend(curved.into_iter().filter(|m| !known.contains(&m.leaf)));
        }
        let by_residuals = misfits.len();
        // Shape that the readings show comes first, so roughness is considered once that is resolved.
        if options.refine_by == RefineBy::Roughness && by_residuals < chance_misfits(self.surface.space()) {
            let weight = self.weight.unwrap_or(0.0);
            misfits.extend(leaves_coarser_than_smoothing(
                &self.surface,
                &feet,
                &kept,
                weight,
                deepest(options),
            ));
        }
        Ok(LeavesToDivide { misfits, by_residuals })
    }

    /// The fit of the last round, with the feet, the noise and the prior of the final surface.
    fn converged(mut self, system: SurfaceSystem) -> Result<ConvergedFit> {
        let subset = std::mem::take(&mut self.subset);
        let feet = self.project(&subset);
        let readings = ProjectedReadings { observations: self.observations, subset: &subset, feet: &feet };
        let degrees = self.degrees.as_deref().unwrap_or(&[]);
        let mut noise = SensorNoise::estimate(readings, self.options.noise_rules(), degrees, true)?;
        noise.local_variance = local_variances(&self.surface, readings, &noise, self.options.gate)?;
        // The prior of the model is that of its own metric.
        let energy = BendingEnergy::new(&system, &self.surface)?;
        let weight = self.weight.unwrap_or(0.0);
        // Readings do not determine motion along the surface. The hold makes the stored matrix regular
        // (decision 0002).
        let mut prior = system.tangential_hold(&self.surface, TANGENTIAL_HOLD)?;
        prior.add_scaled(&energy.matrix.expanded(3)?, weight)?;
        Ok(ConvergedFit {
            surface: self.surface,
            system,
            subset,
            feet,
            noise,
            weight,
            prior,
            at: self.at,
            reached_limit: false,
            reached_tolerance: false,
            refined: RefinementLog::default(),
            kind: ConvergedKind::AlongNormals,
            marginal: None,
            shown: ShownShape::default(),
        })
    }
}

/// The readings that lie on a surface with their neighbours; all of them if none does.
fn searching_readings(observations: &Observations, subset: &[u32]) -> Vec<u32> {
    let on: Vec<u32> =
        subset.iter().copied().filter(|&i| observations.readings.on_surface[i as usize]).collect();
    if on.is_empty() { subset.to_vec() } else { on }
}

/// How far one iteration moved the surface.
struct StepOutcome {
    has_converged: bool,
    /// Mean square of the step in variances of the surface.
    decrement: f64,
}

/// Degrees of freedom before any are known: half the nodes, or a quarter of the readings, whichever is less.
fn first_degrees(surface: &Surface, channels: &FootChannels<'_>) -> Vec<f64> {
    let rows = |k: usize| channels.observations.channels[channels.channel(k)].quantity.rows() as f64;
    let numbers: f64 = (0..channels.subset.len()).map(rows).sum();
    let share = 0.5 * (surface.space().node_count() as f64 / numbers).min(0.5);
    let mut degrees = vec![0.0; channels.count];
    for k in 0..channels.subset.len() {
        degrees[channels.channel(k)] += share * rows(k);
    }
    degrees
}

/// The weight from which the search starts: see [`FIRST_SMOOTHING`]. Few readings start stiffer.
fn first_weight(surface: &Surface, area: f64, feet: &[Foot], information: &[f64]) -> f64 {
    let leaves = surface.space().leaves().len() as f64;
    let readings = information.iter().filter(|&&w| w > 0.0).count() as f64;
    weight_of_length(feet, information, area, (area / leaves).sqrt() * FIRST_SMOOTHING.max(leaves / readings))
}

/// Root mean square of the distances of positions with a weight; not finite if there are none.
fn rms_of_positions(feet: &[Foot], information: &[f64]) -> f64 {
    let counting = feet.iter().zip(information);
    let (squares, n) = counting
        .filter(|(foot, weight)| foot.quantity == Quantity::Position && **weight > 0.0)
        .fold((0.0, 0.0), |(squares, n), (foot, _)| (squares + foot.height() * foot.height(), n + 1.0));
    (squares / n).sqrt()
}
