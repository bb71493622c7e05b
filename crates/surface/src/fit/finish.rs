//! From a converged surface to a model with its covariance and the report.
//!
//! Comes in: a [`ConvergedFit`] surface. Goes out: the model with its information, linearised at itself, and
//! the figures by which a user judges it.

use super::batches::AddedBatches;
use super::noise::{ResidualSums, SensorNoise, kept_variance};
use super::patch::{self, PatchFilterOutcome};
use super::unresolved_shape::{UnresolvedShape, unresolved_shape};
use super::stages::{ConvergedFit, leaf_areas, leaves_with_feet, weights, weights_beside, with_neighbours};
use super::{Filter, Fit, FitOptions, FitReport, FitTermination, HeldOut, ResidualSample, rejected_readings};
use crate::model::{Observed, ScanPoseReport, Posterior, SensorReport, SurfaceModel};
use crate::observe::Linearized;
use crate::observe::surface_extent;
use crate::observe::{Foot, FootChannels, FootState, accumulate, by_leaf, normal_step, project};
use crate::observe::{Observations, Quantity, RejectionCause};
use crate::subdivision::RefinementLog;
use planish_core::Progress;
use planish_estimate::sparse::CholeskyFactor;
use planish_estimate::{Error, Result};
use planish_exchange::{ScanSet, Unit};
use planish_spline::{FootPointSearch, SurfaceSystem};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::sync::Arc;

/// A limit of depth that leaves shape out on more than this share of the area is told.
const MAX_LEFT: f64 = 0.1;
/// Draws of the surface's noise: each scan's share of them is summed over thousands of readings.
const NOISE_DRAWS: u64 = 12;

/// Makes the model and reports, in coordinates about `origin`, where the poses are those of the world;
/// `earlier` is the model that the scans add to, `added` what other readings have added.
pub(super) fn finish(
    set: &ScanSet,
    observations: &Observations,
    converged: ConvergedFit,
    options: &FitOptions,
    earlier: Option<&SurfaceModel>,
    added: Option<AddedBatches>,
    origin: [f64; 3],
    progress: &dyn Progress,
) -> Result<Fit> {
    let ConvergedFit {
        surface,
        system,
        subset,
        feet,
        mut noise,
        weight,
        prior,
        mut at,
        reached_limit,
        reached_tolerance,
        refined,
        filtered,
        moves_freely,
    } = converged;
    progress.check("information", 0.9)?;
    let information = match &filtered {
        Some(filtered) => filtered.information(observations, &subset, &feet, &noise),
        None => weights(observations, &subset, &feet, &noise, options.gate, false),
    };
    if earlier.is_none() {
        refuse_a_surface_of_the_fewer(observations, &subset, &feet, &information)?;
    }
    // What patches know is no information of the whole.
    let mut data = match &filtered {
        Some(_) => system.nothing()?,
        None => accumulate(&system, &surface, &feet, &information)?,
    };
    // Degrees of freedom are shared out by what the readings at hand determine of the whole.
    let own = added.as_ref().map(|_| data.clone());
    if let Some(model) = earlier.filter(|_| filtered.is_none()) {
        data.add_scaled(&model.data, 1.0)?;
    }
    if let Some(added) = &added {
        data.add_scaled(&added.data, 1.0)?;
    }
    let mut model = SurfaceModel {
        unit: set.unit.or(earlier.map(|m| m.unit)).unwrap_or(Unit::Millimetre),
        surface,
        prior,
        data,
        observed: Vec::new(),
        unresolved_shape: Vec::new(),
        sensors: Vec::new(),
        poses: earlier.map_or_else(Vec::new, |m| m.poses.clone()),
        smoothness_weight: weight,
        observations: earlier.map_or(0, |m| m.observations),
        measured_coordinates: None,
        moves_freely,
        patches: filtered.as_ref().map(|filtered| Arc::clone(&filtered.filter)),
        scan_errors: None,
    };
    let channels = FootChannels::new(observations, &subset);
    let mut stated = Vec::new();
    let directions = system.node_normals(&model.surface);
    let here = Linearized {
        surface: &model.surface,
        directions: &directions,
        feet: &feet,
        information: &information,
        channels: &channels,
    };
    // Batches are samples of the whole: the others say of their scans what these do.
    let parts = {
        let own = information.iter().filter(|&&w| w > 0.0).count().max(1) as f64;
        let others: usize = added.iter().flat_map(|a| &a.used).map(|o| o.count).sum();
        1.0 + others as f64 / own
    };
    if !observations.scan_errors.is_empty() {
        let equations = observations.scan_errors.equations(&here);
        stated = equations.prior.clone();
        model.scan_errors = Some(equations.into_information(parts));
    }
    progress.check("covariance", 0.95)?;
    let mut covariance = Arc::new(model.covariance(&system)?);
    if let Some(mut scan_error_information) = model.scan_errors.take() {
        let factor = system.factorize_scalar(&model.information_along(&system, &directions)?)?;
        let noise = noise_of_surface(&system, &here, &factor, parts)?;
        let of_noise = observations.scan_errors.noise_information(&here, &factor, &noise, parts)?;
        if let Some(made) = Arc::into_inner(covariance) {
            let (made, change) = made.without_noise_of_shared(&of_noise, &stated)?;
            for (corner, change) in scan_error_information.corner.iter_mut().zip(change) {
                *corner += change;
            }
            covariance = Arc::new(made);
        } else {
            unreachable!("nobody else holds the covariance")
        }
        model.scan_errors = Some(scan_error_information);
    }
    let posterior = Posterior::new(&model.surface, Arc::clone(&covariance));
    // What readings see of the surface they see from where their scans stand.
    let seen = posterior.given_shared();
    let surface = &model.surface;
    let degrees = if observations.stated.len() == 1 && earlier.is_none() && filtered.is_none() {
        vec![covariance.trace_with(own.as_ref().unwrap_or(&model.data), &system)?]
    } else {
        degrees_of_channels(&seen, &channels, &feet, &information)?
    };
    let found = SensorNoise::estimate(observations, &subset, &feet, options.gate, &degrees, true)?;
    let estimated_factors = (noise.lacks_redundancy.iter().zip(&noise.estimated_factors).zip(&found.estimated_factors))
        .map(|((&followed, &before), &after)| if followed { before } else { after })
        .collect();
    noise = SensorNoise {
        variance_factors: noise.variance_factors,
        lacks_redundancy: noise.lacks_redundancy,
        estimated_factors,
        ..found
    };
    let mut left = unresolved_shape(&seen, &channels, &feet, &information, &noise)?;
    // Other readings may have residual_sample more.
    if let Some(earlier) = earlier {
        for (leaf, left) in left.iter_mut().enumerate() {
            let [u, v] = surface.space().parameters(leaf, [0.5, 0.5]);
            let before = earlier.surface.space().locate(u, v).0;
            *left = left.max(earlier.unresolved_shape.get(before).copied().unwrap_or(0.0));
        }
    }
    if left.iter().any(|left| *left > 0.0) {
        model.unresolved_shape = left;
    }
    let surface = &model.surface;
    let posterior = Posterior::new(surface, Arc::clone(&covariance)).with_unresolved_shape(&model.unresolved_shape);
    let taken = |k: usize| observations.inferred(subset[k] as usize).is_none();
    let own = leaves_with_feet(surface, &feet, &information, taken);
    let mut measured = with_neighbours(surface.space(), &own);
    if let Some(added) = &added {
        for (now, other) in measured.iter_mut().zip(&added.observed) {
            *now |= other;
        }
    }
    let concluded = leaves_with_feet(surface, &feet, &information, |k| !taken(k));
    let inferred = with_neighbours(surface.space(), &concluded);
    // Patches may have been divided since.
    let before = |leaf: usize| {
        earlier.map_or(Observed::PriorOnly, |model| {
            let [u, v] = surface.space().parameters(leaf, [0.5, 0.5]);
            model.observed[model.surface.space().locate(u, v).0]
        })
    };
    let observed: Vec<Observed> = (0..measured.len())
        .map(|leaf| match before(leaf) {
            // Conclusions are drawn where no reading is near: a leaf that holds them alone was not measured,
            // even if its neighbour was.
            before if concluded[leaf] && !own[leaf] && !before.is_measured() => Observed::Inferred,
            _ if measured[leaf] => Observed::Measured,
            Observed::PriorOnly if inferred[leaf] => Observed::Inferred,
            before => before,
        })
        .collect();
    let mut rejected: std::collections::BTreeMap<String, usize> =
        observations.rejected.iter().map(|(cause, n)| (cause.name().to_owned(), *n)).collect();
    let causes = (feet.iter().zip(&information).enumerate())
        .filter(|(k, _)| taken(*k))
        .filter_map(|(_, (foot, &w))| foot.rejection(w));
    for cause in causes {
        *rejected.entry(cause.name().to_owned()).or_insert(0) += 1;
    }
    for (cause, n) in added.iter().flat_map(|added| &added.rejected) {
        *rejected.entry(cause.name().to_owned()).or_insert(0) += n;
    }
    // The σ of the readings was found from residuals that hold what is left out.
    let exact = Posterior::new(surface, Arc::clone(&covariance)).given_shared();
    let held_out = judge(&exact, observations, &noise, &mut at, options.gate)?;
    if !observed.contains(&Observed::Measured) {
        return Err(Error::undetermined("no part of the surface was measured: every reading was gated"));
    }
    let sigma = posterior.sigma_summary(&observed)?;
    let areas = leaf_areas(surface);
    let total_area: f64 = areas.iter().sum();
    let area_of = |what: Observed| -> f64 {
        let of_kind = areas.iter().zip(&observed).filter(|(_, o)| **o == what);
        of_kind.map(|(a, _)| a).sum()
    };
    let observed_area = area_of(Observed::Measured);
    let inferred_fraction = area_of(Observed::Inferred) / total_area;

    let used: Vec<(&Foot, f64)> = feet
        .iter()
        .zip(information.iter().copied())
        .enumerate()
        .filter(|(k, (_, w))| *w > 0.0 && taken(*k))
        .map(|(_, used)| used)
        .collect();
    let others = added.as_ref().map_or(&[][..], |added| &added.used);
    let count = used.len() + others.iter().map(|o| o.count).sum::<usize>();
    let chi2: f64 = used.iter().map(|(foot, w)| w * foot.extremes().1).sum::<f64>()
        + others.iter().map(|o| o.weighted).sum::<f64>();
    // Numbers that were read: a normal is two, a curvature three.
    let rows_of = |channel: usize| observations.channels[channel].quantity.rows();
    let own_rows: usize = used.iter().map(|(foot, _)| foot.quantity.rows()).sum();
    let other_rows: usize = (others.iter().enumerate()).map(|(channel, o)| o.count * rows_of(channel)).sum();
    let rows = (own_rows + other_rows).max(1) as f64;
    let kept = kept_variance(options.gate)?;
    // All that the readings determine: the share of those at hand, and of the others in proportion.
    let of_readings = (degrees.iter().zip(&observations.channels)).filter(|(_, channel)| !channel.inferred);
    let determined = of_readings.map(|(d, _)| d).sum::<f64>() * rows / own_rows.max(1) as f64;
    let sensors = sensor_reports(set, observations, &noise, &subset, &feet, &information, others);
    let positions = sensors.iter().filter(|sensor| sensor.quantity == Quantity::Position.name());
    let (square, placed) = positions.fold((0.0, 0), |(square, count), sensor| {
        (square + sensor.rms * sensor.rms * sensor.observations as f64, count + sensor.observations)
    });
    let total = observations.total + added.as_ref().map_or(0, |added| added.total);
    let mut warnings = warnings(&sensors, observed_area / total_area, inferred_fraction, &rejected, total);
    // Sensors of earlier sessions alone are not among these.
    if added.is_none() && sigma.median < IMPOSSIBLE * least_sigma(&sensors) {
        warnings.push(
            "σ of the surface is less than all readings together could make it: the surface is folded, and none of its figures holds; \
             give another --shape, or normals"
                .to_owned(),
        );
    }
    let left = UnresolvedShape::from_leaves(&model.unresolved_shape, &areas);
    let too_shallow = options.max_depth.is_some() && left.is_some_and(|left| left.area_fraction > MAX_LEFT);
    if too_shallow {
        warnings.push(
            "the limit of depth was reached before the residuals were down to noise: σ takes in what is left out of the shape, but σ of sensors that are estimated \
             do so, too; raise --max-depth for more detail"
                .to_owned(),
        );
    }
    if reached_limit {
        warnings.push(format!(
            "the limit of {} coefficients was reached before the residuals were down to noise: raise --max-coefficients for more detail",
            options.max_coefficients
        ));
    }
    for (channel, _) in (observations.channels.iter().zip(&noise.lacks_redundancy)).filter(|(_, followed)| **followed)
    {
        warnings.push(format!(
            "the readings of sensor \"{}\" state no σ and are so few that the surface follows them wherever they go: they count with what they missed the \
             model by before, which is too little if the model has heard of them; state their σ",
            set.sensors[channel.sensor].name
        ));
    }
    warnings.extend(filtered.as_ref().and_then(PatchFilterOutcome::warning));
    if filtered.is_some() && has_uncertain_pose(set) {
        warnings.push("the patch filter takes poses as exact: their σ was not used".to_owned());
    }
    if filtered.is_some() {
        warnings.extend(patch::unused_biases(set));
    }
    warnings.extend(observations.duplicate_scan_warnings(set));
    let mut poses = pose_reports(set);
    if let Some(bordered) = covariance.shared() {
        for estimate in observations.scan_errors.estimates(bordered, &stated)? {
            let pose = &mut poses[estimate.scan];
            estimate.report(pose, origin, observations);
            if !pose.undetermined.is_empty() {
                warnings.push(format!(
                    "the readings leave {} of the six directions of the pose of {} open: see `undetermined` in the JSON of its pose; the thing may be \
                     symmetric, or the scan small or flat",
                    pose.undetermined.len(),
                    pose.scan
                ));
            }
        }
    }
    let report = FitReport {
        observations: count,
        rejected,
        shape: surface.space().shape().name().to_owned(),
        coefficients: surface.space().node_count(),
        levels: surface.space().levels(),
        cells: surface.space().leaves().len(),
        filter: if filtered.is_some() { Filter::Patch } else { Filter::Global },
        refined: refined.levels(),
        rms: (square / placed.max(1) as f64).sqrt(),
        rms_normalised: (chi2 / rows).sqrt(),
        reduced_chi_square: chi2 / (rows * kept - determined).max(1.0),
        sensors: sensors.clone(),
        poses: poses.clone(),
        sigma,
        unresolved_shape: left,
        observed_area_fraction: observed_area / total_area,
        smoothness_weight: weight,
        propagation: None,
        held_out,
        termination: if reached_limit || too_shallow {
            FitTermination::Limit
        } else if reached_tolerance {
            FitTermination::ReachedTolerance
        } else {
            FitTermination::Converged
        },
        warnings,
    };
    let surface = &model.surface;
    let readings = ResidualSample::new(set, observations, surface, &subset, &feet, &information, &noise);
    model.observed = observed;
    model.sensors = sensors;
    model.poses.extend(poses);
    model.observations += count;
    progress.advance("done", 1.0);
    Ok(Fit { model, report, earlier_states: Vec::new(), formation: None, readings: Some(readings), covariance })
}

/// Draws of what the noise of the readings makes of the surface, coefficient by coefficient of every leaf:
/// `Λ⁻¹ Σ √w a ε`, ε ~ N(0, 1); there are so many `parts` of the readings as those at hand.
///
/// Its covariance `Λ⁻¹ Λ_data Λ⁻¹` is less than the posterior's, which also holds the detail that the surface
/// does not show.
fn noise_of_surface(
    system: &SurfaceSystem,
    at: &Linearized<'_>,
    factor: &CholeskyFactor,
    parts: f64,
) -> Result<Vec<Vec<[[f64; 3]; 16]>>> {
    let Linearized { surface, directions, feet, information, .. } = *at;
    let space = system.space();
    let (start, order) = by_leaf(feet, space.leaves().len());
    (0..NOISE_DRAWS)
        .map(|draw| {
            let mut rng = ChaCha8Rng::seed_from_u64(draw);
            let drawn: Vec<[f64; 3]> =
                (0..feet.len()).map(|_| [(); 3].map(|()| StandardNormal.sample(&mut rng))).collect();
            let sums = system.accumulate_along(directions, |leaf, add| {
                for &k in &order[start[leaf] as usize..start[leaf + 1] as usize] {
                    let (foot, w) = (&feet[k as usize], information[k as usize]);
                    if w > 0.0 {
                        foot.rows(surface, |r, row| {
                            add(row, foot.normal, drawn[k as usize][r] * (parts / w).sqrt(), w)
                        });
                    }
                }
            })?;
            let mut moved = sums.vector().to_vec();
            factor.solve_in_place(&mut moved)?;
            let vertices: Vec<[f64; 3]> =
                (directions.iter().zip(&moved)).map(|(d, by)| d.map(|d| d * by)).collect();
            Ok(space.leaf_coefficients(&vertices))
        })
        .collect()
}

/// Gross errors are fewer than what is right. A surface from which more positions are far than near has
/// followed some of them at the expense of the others.
fn refuse_a_surface_of_the_fewer(
    observations: &Observations,
    subset: &[u32],
    feet: &[Foot],
    information: &[f64],
) -> Result<()> {
    let (mut near, mut far) = (0_usize, 0_usize);
    for ((&i, foot), &w) in subset.iter().zip(feet).zip(information) {
        let channel = &observations.channels[observations.channel(i as usize)];
        if channel.quantity == Quantity::Position && !channel.inferred && foot.state == FootState::Good {
            *(if w > 0.0 { &mut near } else { &mut far }) += 1;
        }
    }
    if far > near {
        return Err(Error::undetermined(format!(
            "only {near} of {} positions lie near the surface that was found, given their σ: there are too few for the shape, or their σ is stated too small; add readings, leave σ out so that it is \
             estimated, or allow finer cells by --max-coefficients",
            near + far
        )));
    }
    Ok(())
}

/// How well the surface is known where each foot is and in what it reads: the largest variance of its rows.
fn variances_of_surface(posterior: &Posterior<'_>, feet: &[Foot]) -> Result<Vec<f64>> {
    let leaves = posterior.surface().space().leaves().len();
    let (start, order) = by_leaf(feet, leaves);
    let parts: Vec<Vec<(u32, f64)>> = (0..leaves)
        .into_par_iter()
        .map(|leaf| {
            let own = &order[start[leaf] as usize..start[leaf + 1] as usize];
            if own.is_empty() {
                return Ok(Vec::new());
            }
            let cell = posterior.leaf(leaf)?;
            let variance = |k: u32| {
                let foot = &feet[k as usize];
                let mut largest = 0.0_f64;
                foot.rows(posterior.surface(), |_, row| {
                    largest = largest.max(cell.variance_along(row, foot.normal));
                });
                (k, largest)
            };
            Ok(own.iter().map(|&k| variance(k)).collect())
        })
        .collect::<Result<_>>()?;
    let mut variances = vec![0.0; feet.len()];
    for (k, variance) in parts.into_iter().flatten() {
        variances[k as usize] = variance;
    }
    Ok(variances)
}

/// Lays new observations on the surface of a model whose hierarchy stays.
pub(super) fn place(
    model: &SurfaceModel,
    observations: &mut Observations,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<ConvergedFit> {
    let mut surface = model.surface.clone();
    let system = SurfaceSystem::new(surface.space())?;
    let subset: Vec<u32> =
        (0..observations.len() as u32).filter(|&i| !observations.held_out[i as usize]).collect();
    let mut at = vec![[0.0; 2]; observations.len()];
    let mut noise = SensorNoise::stated(observations);
    let (mut feet, mut factor) = (Vec::new(), None);
    let mut degrees = vec![0.0; observations.stated.len()];
    // The noise that the model before the update tells.
    let mut foretold: Option<SensorNoise> = None;
    // How well each reading's foot was known before: readings may be that far off as well, until the surface
    // has heard of them.
    let mut known_before: Vec<f64> = Vec::new();
    for iteration in 0..4 {
        progress.check("adding", 0.2 + 0.15 * f64::from(iteration))?;
        progress.items(iteration as usize * subset.len(), "readings");
        let search = if iteration == 0 { Some(FootPointSearch::new(&surface, 2, 0.0)?) } else { None };
        feet = project(&surface, observations, &subset, &mut at, search.as_ref(), &noise.variance_factors);
        let predicted: Vec<Foot>;
        let judged = if iteration == 0 {
            let before = Posterior::new(&model.surface, Arc::new(model.covariance(&system)?));
            known_before = variances_of_surface(&before.with_unresolved_shape(&model.unresolved_shape), &feet)?;
            predicted = (feet.iter().zip(&known_before).zip(&subset))
                .map(|((foot, of_surface), &i)| {
                    let stated = observations.stated[observations.channel(i as usize)];
                    Foot { variance: foot.variance + if stated { *of_surface } else { 0.0 }, ..*foot }
                })
                .collect();
            &predicted
        } else {
            &feet
        };
        noise = SensorNoise::estimate(observations, &subset, judged, options.gate, &degrees, true)?;
        if iteration == 0 {
            foretold = Some(noise.clone());
        } else if let Some(foretold) = &foretold {
            noise.keep_where_redundancy_lacks(observations, foretold, &degrees);
        }
        if iteration == 3 {
            break;
        }
        let information =
            weights_beside(observations, &subset, &feet, &noise, options.gate, false, |k| known_before[k]);
        let step = normal_step(
            &system,
            &surface,
            &feet,
            &information,
            &FootChannels::new(observations, &subset),
            &model.prior,
            1.0,
            Some(&model.data),
            &mut factor,
        )?;
        observations.apply_scan_error_step(&step.shared);
        (surface, degrees) = (step.surface, step.degrees);
    }
    Ok(ConvergedFit {
        surface,
        subset,
        feet,
        noise,
        weight: model.smoothness_weight,
        prior: model.prior.clone(),
        at,
        reached_limit: false,
        reached_tolerance: false,
        refined: RefinementLog::default(),
        filtered: None,
        moves_freely: false,
        system,
    })
}

/// `Σ_i w_i nᵢᵀ Σ nᵢ` over the readings of each sensor: how many degrees of freedom they determine.
fn degrees_of_channels(
    posterior: &Posterior<'_>,
    channels: &FootChannels<'_>,
    feet: &[Foot],
    information: &[f64],
) -> Result<Vec<f64>> {
    let leaves = posterior.surface().space().leaves().len();
    let (start, order) = by_leaf(feet, leaves);
    let parts: Vec<Vec<f64>> = (0..leaves.div_ceil(64))
        .into_par_iter()
        .map(|chunk| {
            let mut part = vec![0.0; channels.count];
            for leaf in chunk * 64..leaves.min((chunk + 1) * 64) {
                let own = &order[start[leaf] as usize..start[leaf + 1] as usize];
                if own.is_empty() {
                    continue;
                }
                let cell = posterior.leaf(leaf)?;
                for k in own.iter().map(|&k| k as usize).filter(|&k| information[k] > 0.0) {
                    feet[k].rows(posterior.surface(), |_, row| {
                        part[channels.channel(k)] += information[k] * cell.variance_along(row, feet[k].normal);
                    });
                }
            }
            Ok(part)
        })
        .collect::<Result<_>>()?;
    let mut degrees = vec![0.0; channels.count];
    for part in parts {
        for (d, p) in degrees.iter_mut().zip(part) {
            *d += p;
        }
    }
    Ok(degrees)
}

/// Held-out readings: residual over `√(σ_reading² + σ_surface²)`, behind the same gate as all others.
fn judge(
    posterior: &Posterior<'_>,
    observations: &Observations,
    noise: &SensorNoise,
    at: &mut [[f64; 2]],
    gate: f64,
) -> Result<HeldOut> {
    let surface = posterior.surface();
    let held: Vec<u32> =
        (0..observations.len() as u32).filter(|&i| observations.held_out[i as usize]).collect();
    if held.is_empty() {
        return Ok(HeldOut { n: 0, rms_normalised: f64::NAN });
    }
    let search = FootPointSearch::new(surface, 2, 0.1 * surface_extent(surface))?;
    let feet = project(surface, observations, &held, at, Some(&search), &noise.variance_factors);
    let normalised: Vec<Option<f64>> = held
        .par_iter()
        .zip(&feet)
        .with_min_len(256)
        .flat_map_iter(|(&i, foot)| {
            let mut rows = [None; 3];
            if foot.state == FootState::Good
                && let Ok(cell) = posterior.leaf(foot.leaf as usize)
            {
                let of_reading = noise.variance_factors[observations.channel(i as usize)] * foot.variance;
                foot.rows(surface, |r, row| {
                    let of_surface = cell.variance_along(row, foot.normal);
                    let normalised = foot.residuals()[r] / (of_reading + of_surface).sqrt();
                    rows[r] = (normalised.abs() <= gate).then_some(normalised);
                });
            }
            rows
        })
        .collect();
    let kept: Vec<f64> = normalised.into_iter().flatten().collect();
    let n = kept.len();
    let mean_square = kept.iter().map(|r| r * r).sum::<f64>() / n.max(1) as f64;
    Ok(HeldOut { n, rms_normalised: (mean_square / kept_variance(gate)?).sqrt() })
}

/// Whether any scan states how uncertain its pose is.
pub(super) fn has_uncertain_pose(set: &ScanSet) -> bool {
    (set.scans.iter()).any(|posed| posed.sigma_translation.is_some() || posed.sigma_rotation_deg.is_some())
}

/// The poses of all scans.
pub(super) fn pose_reports(set: &ScanSet) -> Vec<ScanPoseReport> {
    set.scans
        .iter()
        .map(|posed| ScanPoseReport {
            scan: posed.scan.name.clone(),
            translation: posed.scan.world_from_scanner.translation,
            quaternion_xyzw: posed.scan.world_from_scanner.quaternion_xyzw(),
            sigma_translation: posed.sigma_translation,
            sigma_rotation_deg: posed.sigma_rotation_deg,
            ..ScanPoseReport::default()
        })
        .collect()
}

fn sensor_reports(
    set: &ScanSet,
    observations: &Observations,
    noise: &SensorNoise,
    subset: &[u32],
    feet: &[Foot],
    information: &[f64],
    others: &[ResidualSums],
) -> Vec<SensorReport> {
    (observations.channels.iter().enumerate())
        .filter(|(c, channel)| !channel.inferred && observations.channel_of_scan.contains(c))
        .map(|(c, channel)| {
            let (mut count, mut square, mut stated) =
                others.get(c).map_or((0, 0.0, 0.0), |o| (o.count, o.square, o.variance));
            for ((&i, foot), &w) in subset.iter().zip(feet).zip(information) {
                if w > 0.0 && observations.channel(i as usize) == c {
                    count += 1;
                    square += foot.extremes().1 / foot.residuals().len() as f64;
                    stated += foot.variance;
                }
            }
            let n = count.max(1) as f64;
            // Where σ differs from point to point, its root mean square along the normals stands for it.
            let typical = (stated / n).sqrt();
            let in_unit = match channel.quantity {
                Quantity::Normal => 1.0_f64.to_degrees(),
                Quantity::Position | Quantity::Curvature => 1.0,
            };
            SensorReport {
                name: set.sensors[channel.sensor].name.clone(),
                quantity: channel.quantity.name().to_owned(),
                observations: count,
                sigma_stated: observations.stated[c].then_some(in_unit * typical),
                sigma_estimated: in_unit * noise.estimated_factors[c].sqrt() * typical,
                rms: in_unit * (square / n).sqrt(),
                sigma_used_is_estimated: !observations.stated[c] || noise.is_contradicted[c],
            }
        })
        // The places of a sensor that measures none are no readings.
        .filter(|report| {
            report.observations > 0
                || set.sensors.iter().any(|s| s.name == report.name && s.kind.measures_positions())
        })
        .collect()
}

/// σ of the mean of all positions, as if they were readings of one number: no part of a surface is known
/// better than that.
fn least_sigma(sensors: &[SensorReport]) -> f64 {
    let information: f64 = (sensors.iter())
        .filter(|s| s.quantity == Quantity::Position.name())
        .map(|s| s.observations as f64 / s.sigma_estimated.powi(2))
        .sum();
    if information > 0.0 { 1.0 / information.sqrt() } else { 0.0 }
}

/// A surface with less than this share of that σ cannot be.
const IMPOSSIBLE: f64 = 0.3;

/// What a user should know.
pub(super) fn warnings(
    sensors: &[SensorReport],
    observed: f64,
    inferred: f64,
    rejected: &std::collections::BTreeMap<String, usize>,
    total: usize,
) -> Vec<String> {
    let mut warnings = Vec::new();
    for sensor in sensors {
        if let (Some(stated), true) = (sensor.sigma_stated, sensor.sigma_used_is_estimated) {
            warnings.push(format!(
                "sensor {:?} states σ = {stated:.3e}, but its residuals say {:.3e}: the estimate was used",
                sensor.name, sensor.sigma_estimated
            ));
        }
    }
    if observed < 0.5 {
        let completed = if inferred > 0.0 {
            format!(", {:.0} % was completed by what was measured elsewhere", 100.0 * inferred)
        } else {
            String::new()
        };
        warnings.push(format!(
            "only {:.0} % of the surface was measured{completed}: the rest is the smoothness prior's guess",
            100.0 * observed
        ));
    }
    let not_finite = rejected.get(RejectionCause::NotFinite.name()).copied().unwrap_or(0);
    if not_finite > 0 {
        warnings.push(format!(
            "{not_finite} of {total} points have coordinates that are not finite numbers: they were left out"
        ));
    }
    let turned = rejected.get(RejectionCause::NormalMismatch.name()).copied().unwrap_or(0);
    if turned * 50 > total {
        warnings.push(format!(
            "{turned} of {total} readings face another way than the surface near them: it misses folds or thin parts there, or their \
             normals are wrong; σ says nothing of that"
        ));
    }
    let gated = rejected_readings(rejected);
    let total = total - (rejected.values().sum::<usize>() - gated);
    if gated * 10 > total {
        warnings.push(format!("{gated} of {total} readings were set aside: see `rejected`"));
    }
    warnings
}
