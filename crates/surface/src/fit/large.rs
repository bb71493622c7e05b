//! Clouds that are too large to be looked at in every iteration.
//!
//! Comes in: scans with more points than the search for a shape has use for. Goes out: a first part, a sample
//! of them all, by which the surface is found; and what the other parts add to it, one after the other: each
//! is projected once, weighed and summed up, and then forgotten. Information adds, so the surface that is
//! solved from all of them knows every reading, but memory holds no more than a part.
//!
//! Points are dealt out by a hash of their coordinates: every part is a sample of the whole, and readings
//! that are written twice meet in one part, where they are found.
//!
//! Not guaranteed: normals of neighbours for what is added. Where a file states none, a reading belongs to
//! the nearest side of the surface.

use super::noise::{ResidualSums, SensorNoise};
use super::stages::{Settled, observed_leaves, weights};
use super::{FitOptions, observation_options, observe};
use crate::observe::{FootChannels, accumulate, add_up, normal_step, project};
use crate::observe::{ObservationOptions, Observations, Quantity, Rejection, has_ground};
use planish_core::Progress;
use planish_estimate::Result;
use planish_estimate::sparse::BlockInformation;
use planish_exchange::{PosedScan, ScanSet};
use planish_mesh::BoundingBox;
use planish_sense::{Ground, GroundOptions, Scan, classify_ground};
use planish_spline::{DirectedSums, FootPointSearch, Surface, SurfaceSystem};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Readings for each control vertex that may be used, from which on more of them find no other shape.
const READINGS_PER_COEFFICIENT: usize = 64;
/// The smallest part that is worth its overhead, and the most parts.
const LEAST_PART: usize = 100_000;
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
    /// Deals the points of large scans out; none where one part is enough. With `ground` only those on the
    /// ground are.
    ///
    /// # Errors
    /// Those of [`classify_ground`].
    pub(super) fn deal(
        set: &'a ScanSet,
        options: &FitOptions,
        ground: Option<&GroundOptions>,
    ) -> Result<Option<Self>> {
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
            for (posed, part) in set.scans.iter().zip(&mut part).filter(|(posed, _)| !has_ground(&posed.scan))
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
        Ok(Some(Self { set, part, count, rejected }))
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
        ScanSet { unit: self.set.unit, sensors: self.set.sensors.clone(), scans, ..ScanSet::default() }
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
        dropped_not_finite: if number == 0 { scan.dropped_not_finite } else { 0 },
    }
}

/// The numbers of points, ordered so that what is near in space is near in memory: by cells of a coarse grid,
/// along a curve.
fn neighbours_together(points: &[[f64; 3]]) -> Vec<u32> {
    let Some(bounds) = BoundingBox::from_points(points) else {
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
    /// Readings used, `Σ h²` of their heights, `Σ w h²`, and the sum of their stated variances: sensor by
    /// sensor.
    pub used: Vec<ResidualSums>,
}

/// The readings of a part, and an order in which neighbours follow each other.
fn prepared(
    parts: &Parts<'_>,
    number: usize,
    first: &Observations,
    origin: [f64; 3],
    options: &FitOptions,
) -> Result<(Observations, Vec<u32>)> {
    let options = ObservationOptions {
        held_out_share: 0.0,
        ground: None,
        as_they_are: true,
        ..observation_options(parts.set, options)
    };
    let set = parts.part(number);
    let mut observations = observe(&set, &options)?;
    observations.move_origin(origin);
    observations.shared = first.shared.clone();
    let motions = observations.shared.motions();
    observations.move_scans(&motions);
    let order = neighbours_together(&observations.points);
    Ok((observations, order))
}

impl Absorbed {
    fn add(
        &mut self,
        surface: &Surface,
        system: &SurfaceSystem,
        sums: &mut DirectedSums,
        noise: &SensorNoise,
        (observations, subset): (&Observations, &[u32]),
        search: &FootPointSearch,
        gate: f64,
    ) -> Result<()> {
        let mut at = vec![[f64::NAN; 2]; observations.len()];
        let feet = project(surface, observations, subset, &mut at, Some(search), &noise.used);
        let information = weights(observations, subset, &feet, noise, gate, false);
        add_up(sums, surface, &feet, &information);
        if feet.iter().any(|foot| foot.quantity != Quantity::Position) {
            let others: Vec<f64> = (feet.iter().zip(&information))
                .map(|(foot, &w)| if foot.quantity == Quantity::Position { 0.0 } else { w })
                .collect();
            self.data.add_scaled(&accumulate(system, surface, &feet, &others)?, 1.0)?;
        }
        for (seen, now) in self.observed.iter_mut().zip(observed_leaves(surface, &feet, &information)) {
            *seen |= now;
        }
        self.total += observations.total;
        for (cause, n) in &observations.rejected {
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

/// Adds all parts but the first to a settled surface, and moves the surface to where all readings want it.
pub(super) fn absorb(
    parts: &Parts<'_>,
    first: &Observations,
    origin: [f64; 3],
    settled: &mut Settled,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Absorbed> {
    let Settled { surface, system, noise, .. } = &*settled;
    let mut absorbed = Absorbed {
        data: system.nothing()?,
        observed: vec![false; surface.space().leaves().len()],
        rejected: parts.rejected.clone(),
        total: 0,
        used: vec![ResidualSums::default(); first.stated.len()],
    };
    let search = FootPointSearch::new(surface, 2, 0.0)?;
    let mut sums = DirectedSums::new(surface.space());
    // While one part is projected the next is dealt out, which one thread does.
    let mut coming = Some(prepared(parts, 1, first, origin, options));
    for number in 1..parts.count {
        progress.check("adding", 0.6 + 0.25 * number as f64 / parts.count as f64)?;
        progress.items(absorbed.total, "readings");
        let Some(part) = coming.take() else { break };
        let (observations, subset) = part?;
        let next = || (number + 1 < parts.count).then(|| prepared(parts, number + 1, first, origin, options));
        let add = || {
            absorbed.add(surface, system, &mut sums, noise, (&observations, &subset), &search, options.gate)
        };
        let (added, next) = rayon::join(add, next);
        added?;
        coming = next;
    }
    absorbed.data.add_scaled(&sums.information(system)?, 1.0)?;
    progress.check("settling", 0.86)?;
    let information = weights(first, &settled.subset, &settled.feet, &settled.noise, options.gate, false);
    let step = normal_step(
        &settled.system,
        &settled.surface,
        &settled.feet,
        &information,
        &FootChannels::new(first, &settled.subset).in_place(),
        &settled.prior,
        1.0,
        Some(&absorbed.data),
        &mut None,
    )?;
    settled.surface = step.surface;
    settled.feet =
        project(&settled.surface, first, &settled.subset, &mut settled.at, None, &settled.noise.used);
    Ok(absorbed)
}

#[cfg(test)]
mod tests {
    use crate::fit::{FitOptions, fit};
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
        let mut points: Vec<[f64; 3]> = (0..330_000)
            .map(|_| {
                let (x, y) = (10.0 * random.random::<f64>(), 8.0 * random.random::<f64>());
                [x, y, height(x, y)].map(|c| {
                    let noise: f64 = StandardNormal.sample(&mut random);
                    c + SIGMA * noise
                })
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

    /// Four parts must know what one would: every reading counts once, and σ is as small and as true as all
    /// of them make it.
    #[test]
    fn a_cloud_in_parts_is_fitted_as_if_it_were_whole() {
        let set = set();
        let fitted = |max_coefficients, threads| {
            let options = FitOptions { shape: Some(Shape::Sheet), max_coefficients, ..FitOptions::default() };
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| fit(&set, &options, &Silent)).unwrap()
        };
        let parts = fitted(1_000, 2);
        let whole = fitted(12_000, 2);
        assert_eq!(parts.report.rejected["duplicate"], 1000);
        assert_eq!(whole.report.rejected["duplicate"], 1000);
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
            let [x, y, z] = jet.point;
            squares += ((z - height(x, y)) * normal[2].abs() / sigma).powi(2) / leaves as f64;
        }
        assert!((0.5..1.6).contains(&squares), "mean square of normalised errors {squares}");
        let ratio = parts.report.sigma.median / whole.report.sigma.median;
        assert!((0.8..1.25).contains(&ratio), "{ratio} times the σ of the whole");
        let alone = fitted(1_000, 1);
        assert!(alone.model.surface.vertices() == parts.model.surface.vertices());
    }
}
