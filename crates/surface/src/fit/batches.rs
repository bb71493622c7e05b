//! Fits of clouds that are too large to be used in every iteration.
//!
//! Input: scans with more points than the search for a shape needs. A first batch, a sample of them all,
//! gives the surface. Every other batch is projected once, weighed, summed up and forgotten: information
//! adds, so the final surface includes every reading, but memory holds one batch only.
//!
//! A hash of its coordinates decides the batch of a point. Every batch is therefore a sample of the whole,
//! and readings that were written twice meet in one batch, where they are found.
//!
//! Not guaranteed: normals from neighbours for the batches that are added. If a file states no normals, such
//! a reading belongs to the nearest side of the surface.

use super::noise::{ResidualSums, SensorNoise};
use super::refine::ConvergedFit;
use super::support::{Occupancy, occupancy_at};
use super::weights::{Weighting, weights};
use super::{FitOptions, observation_options, observe};
use crate::observe::{FootChannels, ProjectedReadings, StepInput, accumulate, add_up, normal_step, project};
use crate::observe::{ObservationOptions, Observations, Quantity, RejectionCause, has_ground};
use planish_core::{DVec3, Progress};
use planish_estimate::Result;
use planish_estimate::sparse::BlockInformation;
use planish_exchange::{PosedScan, ScanSet};
use planish_mesh::BoundingBox;
use planish_sense::{Ground, GroundOptions, Scan, classify_ground};
use planish_spline::{DirectedSums, FootPointSearch, Surface, SurfaceSystem};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Readings for each allowed control vertex; more of them do not change the shape that is found
/// (decision 0011).
const READINGS_PER_COEFFICIENT: usize = 64;
/// Minimum number of readings of a batch, for its overhead, and the maximum number of batches.
///
/// The batch of a point is one byte, of which [`REJECTED`] takes one value: a billion points need a gigabyte
/// of marks, not eight.
const MIN_BATCH: usize = 100_000;
/// Largest batch. It shows the shape that 62,500 control vertices follow, and takes about 100 MB.
const MAX_BATCH: usize = 1_000_000;
const MAX_BATCHES: usize = 255;

/// Batch number of points that are rejected before any batch is used.
const REJECTED: u8 = u8::MAX;

/// Scans divided into batches.
pub(super) struct Batches<'a> {
    set: &'a ScanSet,
    /// For each point of each scan its batch.
    batch: Vec<Vec<u8>>,
    /// Number of batches.
    pub count: usize,
    /// Points rejected before any batch was used, by cause.
    pub rejected: BTreeMap<RejectionCause, usize>,
}

impl<'a> Batches<'a> {
    /// Divides the points of large scans into batches; none if one batch is enough. With `ground`, only
    /// points on the ground are used.
    ///
    /// # Errors
    /// Those of [`classify_ground`].
    pub(super) fn divide(
        set: &'a ScanSet,
        options: &FitOptions,
        ground: Option<&GroundOptions>,
    ) -> Result<Option<Self>> {
        let loose: usize = (set.scans.iter())
            .filter(|posed| posed.scan.grid.is_none())
            .map(|posed| posed.scan.points.len())
            .sum();
        // Fewer than three batches would save little memory compared with one fit of all readings.
        let size = (READINGS_PER_COEFFICIENT * options.max_coefficients).clamp(MIN_BATCH, MAX_BATCH);
        let count = loose.div_ceil(size).min(MAX_BATCHES);
        if count < 3 {
            return Ok(None);
        }
        let mut batch: Vec<Vec<u8>> = (set.scans.iter())
            .map(|posed| match posed.scan.grid {
                // Neighbours in a grid are known by its cells, so a grid stays in one batch.
                Some(_) => vec![0; posed.scan.points.len()],
                None => (posed.scan.points.par_iter())
                    .with_min_len(4096)
                    .map(|p| (hash(*p, options.seed) % count as u64) as u8)
                    .collect(),
            })
            .collect();
        // The ground is found among all points: in a batch, which is a sample, the lowest point of a raster
        // cell often lies above the ground.
        let mut rejected = BTreeMap::new();
        if let Some(ground) = ground {
            for (posed, batch) in
                set.scans.iter().zip(&mut batch).filter(|(posed, _)| !has_ground(&posed.scan))
            {
                let points: Vec<DVec3> = (posed.scan.points.par_iter())
                    .with_min_len(4096)
                    .map(|p| posed.scan.world_from_scanner.apply(*p))
                    .collect();
                for (kind, batch) in classify_ground(&points, ground)?.into_iter().zip(batch) {
                    let cause = match kind {
                        Ground::Bare => continue,
                        Ground::Above => RejectionCause::AboveGround,
                        Ground::Below => RejectionCause::BelowGround,
                    };
                    *batch = REJECTED;
                    *rejected.entry(cause).or_insert(0) += 1;
                }
            }
        }
        Ok(Some(Self { set, batch, count, rejected }))
    }

    /// The scans of one batch; those without a point in it are empty.
    pub(super) fn batch(&self, number: usize) -> ScanSet {
        let scans = (self.set.scans.iter().zip(&self.batch))
            .map(|(posed, batch)| PosedScan {
                scan: scan_of_batch(&posed.scan, batch, number as u8),
                sensor: posed.sensor,
                sigma_translation: posed.sigma_translation,
                sigma_rotation_deg: posed.sigma_rotation_deg,
            })
            .collect();
        ScanSet { unit: self.set.unit, sensors: self.set.sensors.clone(), scans, ..ScanSet::default() }
    }
}

/// The points of a scan that belong to a batch.
fn scan_of_batch(scan: &Scan, part: &[u8], number: u8) -> Scan {
    fn pick<T: Copy>(values: &[T], part: &[u8], number: u8) -> Vec<T> {
        let own = values.iter().zip(part).filter(|(_, p)| **p == number);
        own.map(|(value, _)| *value).collect()
    }
    fn column<T: Copy>(values: Option<&Vec<T>>, part: &[u8], number: u8) -> Option<Vec<T>> {
        values.map(|values| pick(values, part, number))
    }
    if scan.grid.is_some() && number == 0 {
        return scan.clone();
    }
    Scan {
        time_s: scan.time_s,
        times_s: None,
        scan_numbers: None,
        name: scan.name.clone(),
        points: pick(&scan.points, part, number),
        sigma: column(scan.sigma.as_ref(), part, number),
        covariance: column(scan.covariance.as_ref(), part, number),
        normals: column(scan.normals.as_ref(), part, number),
        sigma_normal_deg: column(scan.sigma_normal_deg.as_ref(), part, number),
        curvatures: column(scan.curvatures.as_ref(), part, number),
        sigma_curvature: column(scan.sigma_curvature.as_ref(), part, number),
        classes: column(scan.classes.as_ref(), part, number),
        parameters: None,
        grid: None,
        viewing: scan.viewing,
        world_from_scanner: scan.world_from_scanner,
        // Counted for the scan once, not for each batch.
        dropped_not_finite: if number == 0 { scan.dropped_not_finite } else { 0 },
    }
}

/// The numbers of points in the order of a space-filling curve, so that points that are near in space are
/// near in memory.
fn neighbours_together(points: &[DVec3]) -> Vec<u32> {
    let Some(bounds) = BoundingBox::from_points(points) else {
        return Vec::new();
    };
    let scale = 1023.0 / bounds.diagonal().max(f64::MIN_POSITIVE);
    let mut numbers: Vec<(u32, u32)> = (points.par_iter())
        .with_min_len(4096)
        .enumerate()
        .map(|(k, p)| {
            let [x, y, z] = std::array::from_fn(|d| spread(((p[d] - bounds.min[d]) * scale) as u32));
            // Interleaved bits of the three coordinates give the Morton order.
            (x | y << 1 | z << 2, k as u32)
        })
        .collect();
    // Point numbers break ties, so the order does not depend on the threads.
    numbers.par_sort_unstable();
    numbers.into_iter().map(|(_, k)| k).collect()
}

/// Ten bits with two zeros between each (Morton 1966).
fn spread(x: u32) -> u32 {
    let x = (x | x << 16) & 0x0300_00FF;
    let x = (x | x << 8) & 0x0300_F00F;
    let x = (x | x << 4) & 0x030C_30C3;
    (x | x << 2) & 0x0924_9249
}

/// A hash of coordinates; the same in every run.
fn hash(p: DVec3, seed: u64) -> u64 {
    // Constants of SplitMix64 (Steele, Lea & Flood 2014), whose output bits all depend on all input bits:
    // points of one scan line must not fall into one batch.
    let mut x = seed ^ 0x9E37_79B9_7F4A_7C15;
    for c in p.to_array() {
        x = (x ^ c.to_bits()).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        x = (x ^ (x >> 29)).wrapping_mul(0x94D0_49BB_1331_11EB);
        x ^= x >> 32;
    }
    x
}

/// What further batches have added.
pub(super) struct AddedBatches {
    /// Their information.
    pub data: BlockInformation,
    /// For each leaf, where their positions lie.
    pub occupied: Vec<Occupancy>,
    /// Their rejected readings, by cause.
    pub rejected: BTreeMap<RejectionCause, usize>,
    /// Their readings before any rejection.
    pub total: usize,
    /// Residual sums of the readings used, by channel.
    pub used: Vec<ResidualSums>,
}

/// The readings of a batch, and an order in which neighbours follow each other.
fn prepared(
    batches: &Batches<'_>,
    number: usize,
    first: &Observations,
    origin: DVec3,
    options: &FitOptions,
) -> Result<(Observations, Vec<u32>)> {
    let options = ObservationOptions {
        // The held-out readings of the first batch judge the fit.
        held_out_share: 0.0,
        ground: None,
        unprocessed: true,
        ..observation_options(batches.set, options)
    };
    let set = batches.batch(number);
    let mut observations = observe(&set, &options)?;
    observations.move_origin(origin);
    observations.scan_errors = first.scan_errors.clone();
    // The first batch has moved the scans, and these readings belong to the same scans.
    let motions = observations.scan_errors.motions();
    observations.move_scans(&motions);
    let order = neighbours_together(&observations.readings.points);
    Ok((observations, order))
}

/// The converged surface to which batches are added.
struct Target<'a> {
    surface: &'a Surface,
    system: &'a SurfaceSystem,
    noise: &'a SensorNoise,
    search: &'a FootPointSearch,
    gate: f64,
}

impl AddedBatches {
    /// Projects the readings of one batch on the converged surface, weighs them, and adds them to the sums.
    fn add(
        &mut self,
        to: &Target<'_>,
        sums: &mut DirectedSums,
        observations: &Observations,
        subset: &[u32],
    ) -> Result<()> {
        let Target { surface, system, noise, search, gate } = *to;
        let mut at = vec![[f64::NAN; 2]; observations.len()];
        let feet = project(surface, observations, subset, &mut at, Some(search), &noise.variance_factors);
        let information =
            weights(ProjectedReadings { observations, subset, feet: &feet }, noise, gate, Weighting::Gated);
        // Moments of a leaf cost a third of the sums over products of weights (decision 0011).
        add_up(sums, surface, &feet, &information);
        // Normals and curvatures have rows of their own, which directed sums of positions cannot hold.
        if feet.iter().any(|foot| foot.quantity != Quantity::Position) {
            let others: Vec<f64> = (feet.iter().zip(&information))
                .map(|(foot, &w)| if foot.quantity == Quantity::Position { 0.0 } else { w })
                .collect();
            self.data.add_scaled(&accumulate(system, surface, &feet, &others)?, 1.0)?;
        }
        for (foot, &w) in feet.iter().zip(&information) {
            if w > 0.0 && foot.quantity == Quantity::Position {
                self.occupied[foot.leaf as usize] |= occupancy_at(foot.local);
            }
        }
        self.total += observations.intake.total;
        for (cause, n) in &observations.intake.rejected {
            *self.rejected.entry(*cause).or_insert(0) += n;
        }
        for ((&i, foot), &w) in subset.iter().zip(&feet).zip(&information) {
            match foot.rejection(w) {
                Some(cause) => *self.rejected.entry(cause).or_insert(0) += 1,
                None => self.used[observations.channel(i as usize)].add(&ResidualSums {
                    count: 1,
                    square: foot.extremes().1 / foot.residuals().len() as f64,
                    weighted: w * foot.extremes().1,
                    variance: foot.variance,
                }),
            }
        }
        Ok(())
    }
}

/// Adds all batches but the first to a converged surface, and moves the surface by one step of all readings.
pub(super) fn add_batches(
    batches: &Batches<'_>,
    first: &Observations,
    origin: DVec3,
    converged: &mut ConvergedFit,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<AddedBatches> {
    let ConvergedFit { surface, system, noise, .. } = &*converged;
    let mut added = AddedBatches {
        data: system.zero_information()?,
        occupied: vec![0; surface.space().leaves().len()],
        rejected: batches.rejected.clone(),
        total: 0,
        used: vec![ResidualSums::default(); first.channels.len()],
    };
    let search = FootPointSearch::new(surface, 2, 0.0)?;
    let target = Target { surface, system, noise, search: &search, gate: options.gate };
    let mut sums = DirectedSums::new(surface.space());
    // The next batch is prepared by one thread while this one is projected by the others.
    let mut next_batch = Some(prepared(batches, 1, first, origin, options));
    // Batch 0 is part of the converged surface already.
    for number in 1..batches.count {
        progress.check("adding", 0.6 + 0.25 * number as f64 / batches.count as f64)?;
        progress.items(added.total, "readings");
        let Some(batch) = next_batch.take() else { break };
        let (observations, subset) = batch?;
        let next =
            || (number + 1 < batches.count).then(|| prepared(batches, number + 1, first, origin, options));
        let add = || added.add(&target, &mut sums, &observations, &subset);
        let (added, next) = rayon::join(add, next);
        added?;
        next_batch = next;
    }
    // The sparse matrix is assembled once, from sums over all batches: each batch touches every leaf again.
    added.data.add_scaled(&sums.information(system)?, 1.0)?;
    progress.check("settling", 0.86)?;
    let information = weights(converged.readings(first), &converged.noise, options.gate, Weighting::Gated);
    // Poses stay where the first batch put them: the sums of the other batches were made with them.
    // One step: the sample has moved the surface to within its σ, where information linearised at it is
    // valid.
    let step = normal_step(
        &StepInput {
            system: &converged.system,
            surface: &converged.surface,
            feet: &converged.feet,
            information: &information,
            channels: &FootChannels::new(first, &converged.subset).in_place(),
            prior: &converged.prior,
            weight: 1.0,
            earlier: Some(&added.data),
            damping: 0.0,
        },
        &mut None,
    )?;
    converged.surface = step.surface;
    converged.feet = project(
        &converged.surface,
        first,
        &converged.subset,
        &mut converged.at,
        None,
        &converged.noise.variance_factors,
    );
    Ok(added)
}

#[cfg(test)]
mod tests {
    use crate::fit::{FitOptions, fit};
    use planish_core::DVec3;
    use planish_core::Silent;
    use planish_exchange::{PosedScan, ScanSet, Unit};
    use planish_sense::{Scan, Sensor, SensorKind};
    use planish_spline::Shape;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const SIGMA: f64 = 0.02;

    fn height(x: f64, y: f64) -> f64 {
        (0.7 * x).sin() * (0.5 * y).cos()
    }

    fn set() -> ScanSet {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let mut points: Vec<DVec3> = (0..330_000)
            .map(|_| {
                let (x, y) = (10.0 * random.random::<f64>(), 8.0 * random.random::<f64>());
                DVec3::from_array([x, y, height(x, y)].map(|c| {
                    let noise: f64 = StandardNormal.sample(&mut random);
                    c + SIGMA * noise
                }))
            })
            .collect();
        // Some are written twice, far from each other in the file.
        points.extend_from_within(..1000);
        ScanSet {
            unit: Some(Unit::Metre),
            sensors: vec![Sensor {
                name: "lidar".to_owned(),
                kind: SensorKind::Range,
                noise: None,
                ..planish_sense::Sensor::default()
            }],
            scans: vec![PosedScan {
                scan: Scan { name: "tile".to_owned(), points, ..Scan::default() },
                sensor: 0,
                sigma_translation: None,
                sigma_rotation_deg: None,
            }],
            ..ScanSet::default()
        }
    }

    /// Four batches must give what one would: every reading counts once, and σ is as small and as true as all
    /// of them make it.
    #[test]
    fn batches_give_the_same_surface_as_one_fit_of_all_readings() {
        let set = set();
        let fitted = |max_coefficients, threads| {
            let options = FitOptions { shape: Some(Shape::Sheet), max_coefficients, ..FitOptions::default() };
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| fit(&set, &options, &Silent)).unwrap()
        };
        let parts = fitted(1_000, 2);
        let at_once = fitted(12_000, 2);
        assert_eq!(parts.report.rejected["duplicate"], 1000);
        assert_eq!(at_once.report.rejected["duplicate"], 1000);
        let n = parts.report.observations;
        assert!((310_000..=330_000).contains(&n), "{n}");
        let sigma = parts.report.sensors[0].sigma_estimated;
        assert!((sigma / SIGMA - 1.0).abs() < 0.02, "{sigma}");
        assert!((parts.report.held_out.rms_normalised - 1.0).abs() < 0.02);
        let surface = &parts.model.surface;
        let posterior = parts.posterior();
        let leaves = surface.space().leaves().len();
        let mut squares = 0.0;
        for leaf in 0..leaves {
            let jet = surface.leaf_jet(leaf, 0.5, 0.5);
            let normal = jet.normal().unwrap();
            let sigma =
                crate::model::Posterior::sigma_along(&posterior.leaf(leaf).unwrap(), [0.5, 0.5], normal);
            let DVec3 { x, y, z } = jet.point;
            squares += ((z - height(x, y)) * normal[2].abs() / sigma).powi(2) / leaves as f64;
        }
        assert!((0.5..1.6).contains(&squares), "mean square of normalised errors {squares}");
        let ratio = parts.report.sigma.median / at_once.report.sigma.median;
        assert!((0.8..1.25).contains(&ratio), "{ratio} times the σ of the whole");
        let alone = fitted(1_000, 1);
        assert!(alone.model.surface.vertices() == parts.model.surface.vertices());
    }
}
