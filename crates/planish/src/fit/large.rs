//! Clouds that are too large to be looked at in every iteration.
//!
//! Comes in: scans with more points than the search for a shape has use for. Goes out: a first part, a sample of them all, by which the surface
//! is found; and what the other parts add to it, one after the other: each is projected once, weighed and summed up, and then forgotten.
//! Information adds, so the surface that is solved from all of them knows every reading, but memory holds no more than a part.
//!
//! Points are dealt out by a hash of their coordinates: every part is a sample of the whole, and readings that are written twice meet in
//! one part, where they are found.
//!
//! Not guaranteed: normals of neighbours for what is added. Where a file states none, a reading belongs to the nearest side of the surface.

use super::engine::{FootSensors, FootState, accumulate, normal_step, project};
use super::observations::{Observations, Rejection, has_ground};
use super::stages::{Settled, observed_leaves, weights};
use super::{FitOptions, observation_options};
use crate::progress::Progress;
use planish_estimate::Result;
use planish_estimate::sparse::BlockInformation;
use planish_exchange::{PosedScan, ScanSet};
use planish_mesh::BoundingBox;
use planish_sense::{Ground, GroundOptions, Scan, classify_ground};
use planish_spline::FootPointSearch;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Readings for each control vertex that may be used, from which on more of them find no other shape.
const READINGS_PER_COEFFICIENT: usize = 64;
/// The smallest part that is worth its overhead, and the most parts.
const LEAST_PART: usize = 500_000;
const MOST_PARTS: usize = 255;

/// What is dealt to no part.
const LEFT_OUT: u8 = u8::MAX;

/// Scans dealt out into parts.
pub(super) struct Parts<'a> {
    set: &'a ScanSet,
    /// For each point of each scan its part.
    part: Vec<Vec<u8>>,
    /// How many parts there are.
    pub count: usize,
    /// Left out before any part was looked at, by cause.
    pub rejected: BTreeMap<Rejection, usize>,
}

impl<'a> Parts<'a> {
    /// Deals the points of large scans out; none where one part is enough. With `ground` only those on the ground are.
    ///
    /// # Errors
    /// Those of [`classify_ground`].
    pub(super) fn deal(set: &'a ScanSet, options: &FitOptions, ground: Option<&GroundOptions>) -> Result<Option<Self>> {
        let loose: usize = (set.scans.iter())
            .filter(|posed| posed.scan.grid.is_none())
            .map(|posed| posed.scan.points.len())
            .sum();
        let size = (READINGS_PER_COEFFICIENT * options.max_coefficients).max(LEAST_PART);
        let count = loose.div_ceil(size).min(MOST_PARTS);
        if count < 3 {
            return Ok(None);
        }
        let mut part: Vec<Vec<u8>> = (set.scans.iter())
            .map(|posed| match posed.scan.grid {
                // A grid is what tells its neighbours: it stays whole.
                Some(_) => vec![0; posed.scan.points.len()],
                None => (posed.scan.points.par_iter())
                    .with_min_len(4096)
                    .map(|p| (hash(p, options.seed) % count as u64) as u8)
                    .collect(),
            })
            .collect();
        let mut rejected = BTreeMap::new();
        if let Some(ground) = ground {
            for (posed, part) in set
                .scans
                .iter()
                .zip(&mut part)
                .filter(|(posed, _)| !has_ground(&posed.scan))
            {
                let points: Vec<[f64; 3]> = (posed.scan.points.par_iter())
                    .with_min_len(4096)
                    .map(|p| posed.scan.world_from_scanner.apply(*p))
                    .collect();
                for (what, part) in classify_ground(&points, ground)?.into_iter().zip(part) {
                    let cause = match what {
                        Ground::Bare => continue,
                        Ground::Above => Rejection::AboveGround,
                        Ground::Below => Rejection::BelowGround,
                    };
                    *part = LEFT_OUT;
                    *rejected.entry(cause).or_insert(0) += 1;
                }
            }
        }
        Ok(Some(Self {
            set,
            part,
            count,
            rejected,
        }))
    }

    /// The scans of one part; those of which it has nothing are empty.
    pub(super) fn part(&self, number: usize) -> ScanSet {
        let scans = (self.set.scans.iter().zip(&self.part))
            .map(|(posed, part)| PosedScan {
                scan: kept(&posed.scan, part, number as u8),
                sensor: posed.sensor,
                sigma_translation: posed.sigma_translation,
                sigma_rotation_deg: posed.sigma_rotation_deg,
            })
            .collect();
        ScanSet {
            unit: self.set.unit,
            sensors: self.set.sensors.clone(),
            scans,
            ..ScanSet::default()
        }
    }
}

/// The points of a scan that are of a part.
fn kept(scan: &Scan, part: &[u8], number: u8) -> Scan {
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
        name: scan.name.clone(),
        points: pick(&scan.points, part, number),
        sigma: column(scan.sigma.as_ref(), part, number),
        covariance: column(scan.covariance.as_ref(), part, number),
        normals: column(scan.normals.as_ref(), part, number),
        sigma_normal_deg: column(scan.sigma_normal_deg.as_ref(), part, number),
        classes: column(scan.classes.as_ref(), part, number),
        parameters: None,
        grid: None,
        viewing: scan.viewing,
        world_from_scanner: scan.world_from_scanner,
        dropped_not_finite: if number == 0 { scan.dropped_not_finite } else { 0 },
    }
}

/// The numbers of points, ordered so that what is near in space is near in memory: by cells of a coarse grid, along a curve.
fn neighbours_together(points: &[[f64; 3]]) -> Vec<u32> {
    let Some(bounds) = BoundingBox::of(points) else {
        return Vec::new();
    };
    let scale = 1023.0 / bounds.diagonal().max(f64::MIN_POSITIVE);
    let mut numbers: Vec<(u32, u32)> = (points.par_iter())
        .with_min_len(4096)
        .enumerate()
        .map(|(k, p)| {
            let [x, y, z] = std::array::from_fn(|d| spread(((p[d] - bounds.min[d]) * scale) as u32));
            (x | y << 1 | z << 2, k as u32)
        })
        .collect();
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

/// A repeatable number for coordinates.
fn hash(p: &[f64; 3], seed: u64) -> u64 {
    let mut x = seed ^ 0x9E37_79B9_7F4A_7C15;
    for c in p {
        x = (x ^ c.to_bits()).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        x = (x ^ (x >> 29)).wrapping_mul(0x94D0_49BB_1331_11EB);
        x ^= x >> 32;
    }
    x
}

/// What parts have added.
pub(super) struct Absorbed {
    /// Their information.
    pub data: BlockInformation,
    /// Which leaves they have seen.
    pub observed: Vec<bool>,
    /// What was left out of them, by cause.
    pub rejected: BTreeMap<Rejection, usize>,
    /// What there was, before anything was left out.
    pub total: usize,
    /// Readings used, `Σ h²` of their heights, `Σ w h²`, and the sum of their stated variances: sensor by sensor.
    pub used: Vec<Used>,
}

/// Sums over readings of one sensor.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Used {
    pub count: usize,
    pub square: f64,
    pub weighted: f64,
    pub variance: f64,
}

/// Adds all parts but the first to a settled surface, and moves the surface to where all readings want it.
pub(super) fn absorb(
    parts: &Parts<'_>,
    first: &Observations,
    origin: [f64; 3],
    settled: &mut Settled,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Absorbed> {
    let Settled {
        surface, system, noise, ..
    } = &*settled;
    let mut absorbed = Absorbed {
        data: system.nothing()?,
        observed: vec![false; surface.space().leaves().len()],
        rejected: parts.rejected.clone(),
        total: 0,
        used: vec![Used::default(); first.stated.len()],
    };
    let search = FootPointSearch::new(surface, 2, 0.0)?;
    for number in 1..parts.count {
        progress.check("adding", 0.6 + 0.25 * number as f64 / parts.count as f64)?;
        let mut options_of_part = observation_options(parts.set, options);
        options_of_part.held_out_share = 0.0;
        options_of_part.ground = None;
        options_of_part.as_they_are = true;
        let set = parts.part(number);
        let scans = set.scans.iter().map(|posed| &posed.scan).collect::<Vec<_>>();
        let sensor_of_scan = set.scans.iter().map(|posed| posed.sensor).collect::<Vec<_>>();
        let mut observations = Observations::new(&scans, &sensor_of_scan, &set.sensors, &options_of_part)?;
        observations.move_origin(origin);
        let subset = neighbours_together(&observations.points);
        let mut at = vec![[f64::NAN; 2]; observations.len()];
        let feet = project(surface, &observations, &subset, &mut at, Some(&search), &noise.used);
        let information = weights(&observations, &subset, &feet, noise, options.gate, false);
        absorbed
            .data
            .add_scaled(&accumulate(system, surface, &feet, &information)?, 1.0)?;
        for (seen, now) in absorbed
            .observed
            .iter_mut()
            .zip(observed_leaves(surface, &feet, &information))
        {
            *seen |= now;
        }
        absorbed.total += observations.total;
        for (cause, n) in &observations.rejected {
            *absorbed.rejected.entry(*cause).or_insert(0) += n;
        }
        for ((&i, foot), &w) in subset.iter().zip(&feet).zip(&information) {
            let cause = match foot.state {
                FootState::NormalMismatch => Rejection::NormalMismatch,
                FootState::BeyondBorder => Rejection::BeyondBorder,
                FootState::Good if w == 0.0 => Rejection::Outlier,
                FootState::Good => {
                    let used = &mut absorbed.used[observations.sensor(i as usize)];
                    used.count += 1;
                    used.square += foot.height * foot.height;
                    used.weighted += w * foot.height * foot.height;
                    used.variance += foot.variance;
                    continue;
                }
            };
            *absorbed.rejected.entry(cause).or_insert(0) += 1;
        }
    }
    progress.check("settling", 0.86)?;
    let information = weights(
        first,
        &settled.subset,
        &settled.feet,
        &settled.noise,
        options.gate,
        false,
    );
    let step = normal_step(
        &settled.system,
        &settled.surface,
        &settled.feet,
        &information,
        &FootSensors::new(first, &settled.subset),
        &settled.prior,
        1.0,
        Some(&absorbed.data),
        &mut None,
    )?;
    settled.surface = step.surface;
    settled.feet = project(
        &settled.surface,
        first,
        &settled.subset,
        &mut settled.at,
        None,
        &settled.noise.used,
    );
    Ok(absorbed)
}
