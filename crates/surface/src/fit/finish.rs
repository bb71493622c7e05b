//! The last stage of a fit: from a converged surface to a model with its covariance and the report.
//!
//! Input: a [`ConvergedFit`]. Output: a [`Fit`]. Its model holds the information linearised at its own
//! surface, and its report the figures by which a user judges the fit.
//!
//! | module | purpose |
//! |---|---|
//! | covariance | posterior covariance, with the poses and biases of scans as common unknowns |
//! | degrees | degrees of freedom that the readings of each channel determine |
//! | held_out | comparison with the readings that were held out |
//! | support | how each place of the surface is known |
//! | openings | parts of a closed surface without readings |
//! | prediction | errors of unobserved surface, by left-out regions |
//! | departure | how far the object may turn away where nothing was measured |
//! | reports | figures of sensors and poses |
//! | findings | what a user should know |

mod covariance;
mod degrees;
mod departure;
mod findings;
mod held_out;
mod openings;
mod prediction;
mod reports;
mod support;

pub(super) use degrees::variances_of_surface;
pub(super) use findings::common_findings;
pub(crate) use openings::open_leaves;
use planish_core::{DVec3, Setting};
pub(super) use reports::{has_uncertain_pose, scan_pose_reports};

use super::batches::AddedBatches;
use super::first::ShownShape;
use super::leaves::leaf_areas;
use super::local_misfit::{LeafMisfit, local_misfit};
use super::misfit_report::{MisfitReport, misfit_regions};
use super::noise::{SensorNoise, kept_variance};
use super::patch::PatchFilterOutcome;
use super::refine::{ConvergedFit, ConvergedKind};
use super::rough_places::lacking_variances;
use super::shared_errors::shared_variance;
use super::spline_error::spline_variances;
use super::unresolved_shape::{UnresolvedShape, unresolved_shape};
use super::verdict::{Verdict, VerdictInput, judge_surface, refuse_far_larger_noise};
use super::weights::{Weighting, weights};
use super::{Filter, Fit, FitOptions, FitReport, FitTermination, ResidualSample};
use crate::model::{
    CreaseSummary, Knowledge, NodeCovariance, Observed, Posterior, SensorReport, Support, SurfaceModel,
    SurfaceTopology, VertexInformation,
};
use crate::observe::{Foot, FootChannels, FootState, Observations, ProjectedReadings, Quantity, accumulate};
use crate::subdivision::RefinementLog;
use degrees::degrees_of_channels;
use findings::{SurfaceResults, all_findings};
use held_out::judge_held_out;
use openings::closed_openings;
use planish_core::Progress;
use planish_estimate::sparse::BlockInformation;
use planish_estimate::{Error, Result};
use planish_exchange::{ScanSet, Unit};
use planish_spline::SurfaceSystem;
use reports::sensor_reports;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Largest share of the area with unresolved shape before a depth limit is reported as the cause.
///
/// A smaller share would warn about a few leaves at rims and edges; a larger one would call a fit converged
/// that is not.
const MAX_UNRESOLVED_SHARE: f64 = 0.1;

/// What the last stage needs besides the converged fit.
pub(super) struct FinishInput<'a> {
    pub set: &'a ScanSet,
    pub observations: &'a Observations,
    pub options: &'a FitOptions,
    /// The model to which the scans are added, if any.
    pub earlier: Option<&'a SurfaceModel>,
    /// What further batches of a large cloud have added, if any.
    pub added: Option<AddedBatches>,
    /// World coordinates of the origin of all coordinates here.
    pub origin: DVec3,
}

impl<'a> FinishInput<'a> {
    /// A fit of one cloud, without an earlier model or further batches.
    pub(super) fn new(
        set: &'a ScanSet,
        observations: &'a Observations,
        options: &'a FitOptions,
        origin: DVec3,
    ) -> Self {
        Self { set, observations, options, earlier: None, added: None, origin }
    }
}

/// The fit as the steps of the last stage see it.
struct Finishing<'a> {
    set: &'a ScanSet,
    observations: &'a Observations,
    options: &'a FitOptions,
    earlier: Option<&'a SurfaceModel>,
    added: Option<&'a AddedBatches>,
    origin: DVec3,
    system: &'a SurfaceSystem,
    /// The readings that take part, their feet, and the information of each.
    subset: &'a [u32],
    feet: &'a [Foot],
    information: &'a [f64],
    filtered: Option<&'a PatchFilterOutcome>,
}

/// Sums over all readings used, those of further batches included.
struct Totals {
    /// Readings.
    count: usize,
    /// `Σ w h²`.
    chi_square: f64,
    /// Measured components: a normal has two, a curvature three. `own_rows` counts those of the readings at
    /// hand.
    rows: f64,
    own_rows: usize,
}

/// Makes the model and the report, in coordinates about `input.origin`.
///
/// # Errors
/// `Undetermined` if most positions are far from the surface, or no part of it was measured; what the
/// factorisation reports.
pub(super) fn finish(
    input: FinishInput<'_>,
    converged: ConvergedFit,
    progress: &dyn Progress,
) -> Result<Fit> {
    let ConvergedFit { surface, system, subset, feet, noise, weight, prior, mut at, .. } = converged;
    let ConvergedFit { reached_limit, reached_tolerance, kind, refined, marginal, shown, .. } = converged;
    let FinishInput { set, observations, options, earlier, added, origin } = input;
    progress.check("information", 0.9)?;
    let readings = ProjectedReadings { observations, subset: &subset, feet: &feet };
    let filtered = kind.filtered();
    let information = match filtered {
        Some(filtered) => filtered.information(readings, &noise),
        None => weights(readings, &noise, options.gate, Weighting::Gated),
    };
    let this = Finishing {
        set,
        observations,
        options,
        earlier,
        added: added.as_ref(),
        origin,
        system: &system,
        subset: &subset,
        feet: &feet,
        information: &information,
        filtered,
    };
    let verdict = this.verdict(&surface, &noise)?;
    let own_data = match filtered {
        // Beliefs of single patches are no information of the whole.
        Some(_) => system.zero_information()?,
        None => accumulate(&system, &surface, &feet, &information)?,
    };
    let mut model = SurfaceModel {
        unit: set.unit.or(earlier.map(|m| m.unit)).unwrap_or(Unit::Millimetre),
        unit_assumed: set.unit.is_none() && earlier.is_none_or(|m| m.unit_assumed),
        known: this.knowledge(&kind, &own_data, prior)?,
        surface,
        observed: Vec::new(),
        support: Support::default(),
        predictive: None,
        excess_variance: Vec::new(),
        sensors: Vec::new(),
        poses: earlier.map_or_else(Vec::new, |m| m.poses.clone()),
        smoothness_weight: weight,
        observations: earlier.map_or(0, |m| m.observations),
    };
    let (covariance, stated) = this.covariance(&mut model, progress)?;

    // The noise, and the shape that the cells cannot follow, from the residuals of the final surface.
    let channels = FootChannels::new(observations, &subset);
    // Readings see the surface from where their scan is, so errors of its pose are not part of residuals.
    let seen = Posterior::new(&model.surface, Arc::clone(&covariance)).given_scan_errors();
    let degrees = match this.degrees_by_trace(&model, &own_data, &covariance)? {
        Some(degrees) => vec![degrees],
        None => degrees_of_channels(&seen, &channels, &feet, &information)?,
    };
    // The posterior of few readings has found the noise already.
    let noise = if marginal.is_some() { noise } else { this.final_noise(noise, &degrees)? };
    // The unresolved shape comes after the noise, by which its test weighs the residuals.
    let mut left = unresolved_shape(&seen, &channels, &feet, &information, &noise)?;
    let unresolved = UnresolvedShape::from_leaves(&left, &leaf_areas(&model.surface));
    if let Some(marginal) = &marginal {
        left.iter_mut().zip(marginal.excess(&seen)?).for_each(|(left, excess)| *left += excess);
    }
    left.iter_mut().zip(spline_variances(&model.surface)).for_each(|(left, missed)| *left += missed);
    let shared = shared_variance(&model.surface, &channels, &feet, &information, &noise);
    let mut misfits = local_misfit(&model.surface, readings, &noise, options.gate)?;
    for (misfit, lacking) in misfits.iter_mut().zip(lacking_variances(&seen)?) {
        misfit.variance = misfit.variance.max(lacking);
    }
    model.excess_variance = this.excess_variance(&model.surface, left, &misfits, &shared);
    let regions = misfit_regions(&model.surface, &misfits);
    this.add_support(&mut model, &verdict.misfit.feet, &regions)?;
    let misfit = MisfitReport::from_leaves(&model.surface, &misfits, &regions, origin);
    let verdict = if this.is_judged() && misfit.is_some() {
        verdict.with_missed_readings(model.surface.space(), readings, &noise, this.verdict_input())?
    } else {
        verdict
    };

    let judged = Judged {
        model: &model,
        covariance: &covariance,
        stated: &stated,
        noise: &noise,
        // Inferred readings are no measurements: their degrees of freedom reduce no residual of a sensor.
        determined: (degrees.iter().zip(&observations.channels))
            .filter(|(_, channel)| !channel.inferred)
            .map(|(d, _)| d)
            .sum::<f64>(),
        unresolved,
        verdict: &verdict,
        misfit,
        ending: Ending { reached_limit, reached_tolerance, refined, shown },
    };
    let report = this.report(&judged, &mut at)?;
    let sample = ResidualSample::new(set, &model.surface, readings, &information, &noise, options.gate);
    model.sensors.clone_from(&report.sensors);
    // Poses of earlier sessions come first, as their unknowns do in the information.
    model.poses.extend(report.poses.iter().cloned());
    model.observations += report.observations;
    progress.advance("done", 1.0);
    Ok(Fit { model, report, earlier_states: Vec::new(), formation: None, readings: Some(sample), covariance })
}

/// The fit with its covariance and noise, from which all figures of the report follow.
struct Judged<'a> {
    model: &'a SurfaceModel,
    covariance: &'a Arc<NodeCovariance>,
    /// Information that was stated about the unknowns of scans.
    stated: &'a [f64],
    noise: &'a SensorNoise,
    /// Degrees of freedom that the readings at hand determine.
    determined: f64,
    /// The unresolved shape of the leaves, without the errors that readings share.
    unresolved: Option<UnresolvedShape>,
    verdict: &'a Verdict,
    /// What σ contains because the surface does not follow it.
    misfit: Option<MisfitReport>,
    ending: Ending,
}

/// From what the iterations began, and how they ended.
struct Ending {
    reached_limit: bool,
    reached_tolerance: bool,
    refined: RefinementLog,
    shown: ShownShape,
}

/// Root mean square of the residuals of all positions.
fn rms_of_positions(sensors: &[SensorReport]) -> f64 {
    let positions = sensors.iter().filter(|sensor| sensor.quantity == Quantity::Position.name());
    let (square, count) = positions.fold((0.0, 0), |(square, count), sensor| {
        (square + sensor.rms * sensor.rms * sensor.observations as f64, count + sensor.observations)
    });
    (square / count.max(1) as f64).sqrt()
}

impl Finishing<'_> {
    fn readings(&self) -> ProjectedReadings<'_> {
        ProjectedReadings { observations: self.observations, subset: self.subset, feet: self.feet }
    }

    /// True if foot `k` belongs to a reading of a sensor, not to one inferred from others.
    fn is_measured_foot(&self, k: usize) -> bool {
        self.observations.inferred(self.subset[k] as usize).is_none()
    }

    /// Degrees of freedom that the only channel determines, by a trace over the sparse inverse, which is
    /// exact and cheaper than a variance for each reading. None for several channels, updates and the patch
    /// filter.
    fn degrees_by_trace(
        &self,
        model: &SurfaceModel,
        own_data: &BlockInformation,
        covariance: &NodeCovariance,
    ) -> Result<Option<f64>> {
        let is_single = self.observations.channels.len() == 1;
        if !is_single || self.earlier.is_some() || self.filtered.is_some() {
            return Ok(None);
        }
        // With further batches the readings at hand determine only their share of the degrees of freedom.
        let data = match model.known.information() {
            Some(all) if self.added.is_none() => &all.data,
            _ => own_data,
        };
        covariance.trace_with(data, self.system).map(Some)
    }

    /// The report. `at` holds the parameters of all observations, by which held-out readings are projected.
    fn report(&self, fit: &Judged<'_>, at: &mut [[f64; 2]]) -> Result<FitReport> {
        let Finishing { set, observations, options, .. } = *self;
        let Judged { model, covariance, noise, ref ending, .. } = *fit;
        let observed = &model.observed;
        let rejected = self.rejected();
        // The readings' σ comes from residuals that contain the unresolved shape. Adding that to the σ of the
        // surface as well would count it twice.
        let exact = Posterior::new(&model.surface, Arc::clone(covariance)).given_scan_errors();
        let held_out = judge_held_out(&exact, observations, noise, at, options.gate)?;
        let areas = leaf_areas(&model.surface);
        let share_of = |kind: Observed| model.area_fraction_of(&areas, kind);
        let observed_area_fraction = share_of(Observed::Measured);
        if observed_area_fraction == 0.0 {
            return Err(Error::undetermined(
                "expected readings within the gate, found none: no part of the surface was measured",
            ));
        }
        // A user reads this σ as that of the real surface, so it includes the unresolved shape.
        let posterior = Posterior::new(&model.surface, Arc::clone(covariance)).of_model(model);
        let (sigma, creases) = (posterior.sigma_summary(observed)?, CreaseSummary::of(&posterior)?);
        let totals = self.totals();
        // Degrees of freedom that all readings determine: those at hand, and further batches in proportion.
        let determined = fit.determined * totals.rows / totals.own_rows.max(1) as f64;
        let sensors =
            sensor_reports(set, self.readings(), self.information, noise, self.residuals_of_batches());
        let unresolved = fit.unresolved;
        // Only a limit that the user has set can be raised by the user.
        let too_shallow = options.max_depth.is_some()
            && unresolved.is_some_and(|left| left.area_fraction > MAX_UNRESOLVED_SHARE);
        let mut findings = all_findings(
            self,
            &SurfaceResults {
                sensors: &sensors,
                noise,
                rejected: &rejected,
                sigma,
                observed_share: observed_area_fraction,
                inferred_share: share_of(Observed::Inferred),
                too_shallow,
                reached_limit: ending.reached_limit,
                edge_lengths: [ending.shown.edge_length, creases.map_or(0.0, |own| own.length)],
            },
        );
        // Places that the verdict names are far from the surface, and contain those of larger residuals.
        let misfit = || fit.misfit.as_ref().and_then(|found| found.finding(model.unit));
        findings.extend(fit.verdict.finding.clone().or_else(misfit));
        findings.extend(closed_openings(model, &areas, self.origin, &rejected));
        let poses = self.poses(covariance, fit.stated, &mut findings)?;
        let space = model.surface.space();
        Ok(FitReport {
            observations: totals.count,
            rejected,
            topology: SurfaceTopology::of(space),
            topology_margin: ending.shown.topology_margin,
            coefficients: space.node_count(),
            levels: space.levels(),
            cells: space.leaves().len(),
            filter: if self.filtered.is_some() { Filter::Patch } else { Filter::Global },
            refined: ending.refined.levels(),
            rms: rms_of_positions(&sensors),
            rms_normalised: (totals.chi_square / totals.rows).sqrt(),
            // The gate removes the tails, so the expected sum of squares is less than the number of rows.
            reduced_chi_square: totals.chi_square
                / (totals.rows * kept_variance(options.gate)? - determined).max(1.0),
            sensors,
            poses,
            sigma,
            creases,
            unresolved_shape: unresolved,
            misfit: fit.misfit.clone(),
            observed_area_fraction,
            verdict: fit.verdict.verdict,
            unresolved_area_fraction: fit.verdict.misfit.area_fraction,
            unresolved_places: fit.verdict.listed_places(),
            smoothness_weight: model.smoothness_weight,
            propagation: None,
            held_out,
            termination: if ending.reached_limit || too_shallow {
                FitTermination::Limit
            } else if ending.reached_tolerance {
                FitTermination::ReachedTolerance
            } else {
                FitTermination::Converged
            },
            findings,
        })
    }

    /// Refuses a surface from which more positions are far than near.
    ///
    /// Gross errors are fewer than correct readings. A surface that is far from most positions has followed
    /// some of them at the expense of the others.
    fn refuse_minority_surface(&self) -> Result<()> {
        let (mut near, mut far) = (0_usize, 0_usize);
        for ((&i, foot), &w) in self.subset.iter().zip(self.feet).zip(self.information) {
            let channel = &self.observations.channels[self.observations.channel(i as usize)];
            if channel.quantity == Quantity::Position && !channel.inferred && foot.state == FootState::Good {
                *(if w > 0.0 { &mut near } else { &mut far }) += 1;
            }
        }
        if far > near {
            return Err(Error::undetermined(format!(
                "only {near} of {} positions lie near the fitted surface, compared with their σ: there are \
                 too few readings for the shape, or the stated σ is too small; add readings, omit σ so \
                 that it is estimated, or allow more coefficients",
                near + far
            ))
            .with_setting(Setting::MaxCoefficients));
        }
        Ok(())
    }

    /// True if the surface has to follow its readings. A later session may measure parts far from the model,
    /// and what lies on the ground is not followed on purpose.
    fn is_judged(&self) -> bool {
        self.earlier.is_none() && self.options.ground().is_none()
    }

    /// Judges whether the surface follows its readings.
    fn verdict(&self, surface: &planish_spline::Surface, noise: &SensorNoise) -> Result<Verdict> {
        if self.earlier.is_none() {
            self.refuse_minority_surface()?;
        }
        if !self.is_judged() {
            return Ok(Verdict::default());
        }
        // A user who asks for an estimate knows that the statement may be wrong.
        if !self.options.force && !self.options.noise_rules().may_lower {
            refuse_far_larger_noise(self.set, self.readings(), noise)?;
        }
        judge_surface(surface, self.readings(), self.verdict_input())
    }

    fn verdict_input(&self) -> VerdictInput<'_> {
        VerdictInput {
            gate: self.options.gate,
            information: self.information,
            force: self.options.force,
            several_scans: self.set.scans.len() > 1,
            origin: self.origin,
        }
    }

    /// What is known about the vertices, before the poses and biases of scans.
    fn knowledge(
        &self,
        kind: &ConvergedKind,
        own: &BlockInformation,
        prior: BlockInformation,
    ) -> Result<Knowledge> {
        let information = || Ok::<_, Error>(VertexInformation { data: self.all_data(own)?, prior });
        Ok(match kind {
            ConvergedKind::AlongNormals => {
                Knowledge::AlongNormals { information: information()?, scan_errors: None }
            }
            ConvergedKind::Free => Knowledge::Free { information: information()? },
            ConvergedKind::Patches(filtered) => Knowledge::Patches(Arc::clone(&filtered.filter)),
        })
    }

    /// Information of the readings at hand, of the earlier model, and of further batches.
    fn all_data(&self, own: &BlockInformation) -> Result<BlockInformation> {
        let mut data = own.clone();
        if let Some(earlier) = self.earlier.and_then(|model| model.known.information()) {
            data.add_scaled(&earlier.data, 1.0)?;
        }
        if let Some(added) = self.added {
            data.add_scaled(&added.data, 1.0)?;
        }
        Ok(data)
    }

    /// Residual sums of further batches, channel by channel.
    fn residuals_of_batches(&self) -> &[super::noise::ResidualSums] {
        self.added.map_or(&[][..], |added| &added.used)
    }

    /// The noise of every sensor, estimated anew with the final degrees of freedom.
    ///
    /// The factors by which readings were weighed stay, since the information was made with them. A channel
    /// that lacks redundancy keeps its earlier estimate.
    fn final_noise(&self, before: SensorNoise, degrees: &[f64]) -> Result<SensorNoise> {
        let found = SensorNoise::estimate(self.readings(), self.options.noise_rules(), degrees, true)?;
        let estimates = before.estimated_factors.iter().zip(&found.estimated_factors);
        let estimated_factors = (before.lacks_redundancy.iter().zip(estimates))
            .map(|(&lacks_redundancy, (&before, &after))| if lacks_redundancy { before } else { after })
            .collect();
        Ok(SensorNoise {
            variance_factors: before.variance_factors,
            local_variance: before.local_variance,
            lacks_redundancy: before.lacks_redundancy,
            estimated_factors,
            ..found
        })
    }

    /// For each leaf, what σ² contains besides the covariance: unresolved shape or misfit, and errors that
    /// readings share, and no less than what the earlier model had there, since other readings may have shown
    /// more. Empty if there is none.
    fn excess_variance(
        &self,
        surface: &planish_spline::Surface,
        unresolved: Vec<f64>,
        misfits: &[LeafMisfit],
        shared: &[f64],
    ) -> Vec<f64> {
        let mut excess = unresolved;
        for (own, misfit) in excess.iter_mut().zip(misfits) {
            *own = own.max(misfit.variance);
        }
        for (own, shared) in excess.iter_mut().zip(shared) {
            *own += shared;
        }
        if let Some(earlier) = self.earlier {
            for (leaf, own) in excess.iter_mut().enumerate() {
                let [u, v] = surface.space().parameters(leaf, [0.5, 0.5]);
                let before = earlier.surface.space().locate(u, v).0;
                *own = own.max(earlier.excess_variance.get(before).copied().unwrap_or(0.0));
            }
        }
        if excess.iter().any(|own| *own > 0.0) { excess } else { Vec::new() }
    }

    /// Rejected readings by cause, those of further batches included.
    fn rejected(&self) -> BTreeMap<String, usize> {
        let mut rejected: BTreeMap<String, usize> = self
            .observations
            .intake
            .rejected
            .iter()
            .map(|(cause, n)| (cause.name().to_owned(), *n))
            .collect();
        let causes = (self.feet.iter().zip(self.information).enumerate())
            .filter(|(k, _)| self.is_measured_foot(*k))
            .filter_map(|(_, (foot, &w))| foot.rejection(w));
        for cause in causes {
            *rejected.entry(cause.name().to_owned()).or_insert(0) += 1;
        }
        for (cause, n) in self.added.iter().flat_map(|added| &added.rejected) {
            *rejected.entry(cause.name().to_owned()).or_insert(0) += n;
        }
        rejected
    }

    /// Readings before any rejection, those of further batches included.
    fn total(&self) -> usize {
        self.observations.intake.total + self.added.map_or(0, |added| added.total)
    }

    fn totals(&self) -> Totals {
        // Inferred readings are no measurements: they count neither as observations nor in χ².
        let used: Vec<(&Foot, f64)> = (self.feet.iter().zip(self.information.iter().copied()).enumerate())
            .filter(|(k, (_, w))| *w > 0.0 && self.is_measured_foot(*k))
            .map(|(_, used)| used)
            .collect();
        let others = self.residuals_of_batches();
        let rows_of = |channel: usize| self.observations.channels[channel].quantity.rows();
        let own_rows: usize = used.iter().map(|(foot, _)| foot.quantity.rows()).sum();
        let other_rows: usize =
            (others.iter().enumerate()).map(|(channel, o)| o.count * rows_of(channel)).sum();
        Totals {
            count: used.len() + others.iter().map(|o| o.count).sum::<usize>(),
            chi_square: used.iter().map(|(foot, w)| w * foot.extremes().1).sum::<f64>()
                + others.iter().map(|o| o.weighted).sum::<f64>(),
            rows: (own_rows + other_rows).max(1) as f64,
            own_rows,
        }
    }
}
