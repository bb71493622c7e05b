//! How well the prior predicts surface without readings: whole regions of the readings are left out,
//! predicted from the others, and compared.
//!
//! Regions are of two kinds. Balls of readings around places at the rim of the data and inside it, with radii
//! from a few spacings up to the largest distance of unobserved surface, show how well holes are closed.
//! Caps, all readings on the unobserved side of a plane, show how well a side that nobody saw is continued:
//! surface that is held from one side only errs several times more. The larger error of the two kinds counts.
//!
//! All balls of one size that are far from each other are left out together, so each set of regions costs one
//! step of the fit and one selected inverse. The errors of a region are correlated; `m` regions therefore
//! have `m` degrees of freedom, and the quantile of Student's t with `m` degrees replaces that of the normal
//! distribution.

use super::Finishing;
use super::departure::departure;
use super::openings::{UnobservedCell, unobserved_cells};
use crate::fit::leaves::leaf_areas;
use crate::fit::support::{Supporters, search_tree};
use crate::model::{
    Knowledge, NodeCovariance, Posterior, PredictionError, PredictiveSigma, SurfaceModel, VertexMotion,
    is_closed,
};
use crate::observe::{FootChannels, Quantity, StepInput, normal_step};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use planish_core::DVec3;
use planish_estimate::sparse::SelectedInverse;
use planish_estimate::{ErrorKind, Result};
use planish_spline::{Surface, leaf_weights};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Radius of the smallest regions, in spacings.
const SMALLEST_RADIUS: f64 = 4.0;
/// Distance in spacings up to which openings of closed surfaces are not tested. Left-out regions are larger,
/// and would cost a closed object with one small opening up to 40 % of the time of its fit.
const NEAR: f64 = 2.0;
/// Radius of the largest regions, as a share of the radius of the readings. More would leave too little.
const LARGEST_SHARE: f64 = 0.7;
/// Largest share of the readings that is left out at once.
const MAX_LEFT_OUT: f64 = 0.35;
/// Smallest distance between the middles of regions that are left out together, in radii.
const APART: f64 = 3.0;
/// Regions of a set, and places that are tried for their middles.
const MAX_REGIONS: usize = 24;
const TRIES: usize = 100;
/// Readings of a set that are compared. Their errors are correlated, so more would not help.
const MAX_COMPARED: usize = 3000;
/// Shares of the readings in successive caps.
const CAP_SHARES: [f64; 2] = [0.5, 0.3];
/// Caps of these shares overlap: at most this many have no reading in common.
const INDEPENDENT_CAPS: usize = 3;
/// Control vertices over all sets. Each set costs as much as an iteration of the fit.
const MAX_NODES: usize = 24_000;
/// Ratio of the distances of successive steps.
const DISTANCE_STEP: f64 = 1.5;
/// Readings that a step must have.
const MIN_READINGS: usize = 4;
/// Regions that a kind must have where the other kind has as many.
const MIN_REGIONS: usize = 3;
/// Limits of the power of the distance with which errors grow beyond the tested ones. A surface that is
/// continued with constant curvature deviates with the square of the distance.
const GROWTH: [f64; 2] = [0.0, 2.0];
/// 97.5 % quantile of the normal distribution.
const NORMAL_QUANTILE: f64 = 1.959_963_984_540_054;

/// The errors of one region at one distance: sums of `e² − σ²`, of the predicted variance, and their number.
#[derive(Clone, Copy, Default)]
struct RegionErrors {
    square: f64,
    variance: f64,
    count: usize,
}

/// What a set of regions leaves out.
#[derive(Clone, Copy)]
enum Regions {
    /// Balls of this radius.
    Balls(f64),
    /// This share of the readings, on one side of a plane.
    Cap(f64),
}

/// By step of the distance and kind (true for caps), the errors of each region.
type ErrorsByDistance = BTreeMap<i32, [BTreeMap<usize, RegionErrors>; 2]>;

impl Finishing<'_> {
    /// How errors of unobserved surface exceed the covariance, from left-out regions; that of the earlier
    /// model for an update. None if all of the surface is observed, and for kinds of knowledge that no step
    /// along normals describes.
    ///
    /// # Errors
    /// What the factorisation reports, except that left-out regions leave the surface open.
    pub(super) fn predictive_sigma(
        &self,
        model: &SurfaceModel,
        measured: &Supporters,
    ) -> Result<Option<PredictiveSigma>> {
        // The readings of the earlier model are not at hand, so none of its regions can be left out.
        if let Some(earlier) = self.earlier {
            return Ok(earlier.predictive.as_ref().map(|errors| carried(errors, earlier, model)));
        }
        let (Knowledge::AlongNormals { .. }, None) = (&model.known, self.filtered) else { return Ok(None) };
        let unobserved = unobserved_cells(model, &leaf_areas(&model.surface));
        let reach = unobserved.iter().map(|cell| cell.distance).fold(0.0, f64::max);
        let used: Vec<usize> =
            (0..self.feet.len()).filter(|&k| self.supports(k) && self.is_measured_foot(k)).collect();
        let spacing = measured.median_spacing();
        if reach == 0.0 || spacing == 0.0 || used.len() < 2 * MIN_READINGS {
            return Ok(None);
        }
        let is_closed = is_closed(model.surface.space());
        if is_closed && reach <= NEAR * spacing {
            return with_departure(None, model, measured, &unobserved);
        }
        let points: Vec<DVec3> = used.iter().map(|&k| self.foot_point(model, k)).collect();
        let middle = 1.0 / points.len() as f64 * points.iter().sum::<DVec3>();
        let radius = points.iter().map(|p| p.distance(middle)).fold(0.0, f64::max);
        let smallest = (SMALLEST_RADIUS * spacing).min(LARGEST_SHARE * radius);
        let largest = reach.clamp(smallest, (LARGEST_SHARE * radius).max(smallest));
        let readings = LeftOutReadings { used: &used, points: &points, spacing };
        let mut errors = ErrorsByDistance::new();
        let mut regions = 0;
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let max_sets = MAX_NODES / model.surface.space().node_count().max(1);
        for set in sets_of_regions(smallest, largest, max_sets) {
            let (left_out, kind) = match set {
                Regions::Balls(radius) => (balls(&points, &unobserved, radius, &mut rng)?, 0),
                Regions::Cap(share) => (cap(&points, &unobserved, middle, share, &mut rng), 1),
            };
            let of_set = self.errors_of_set(model, &readings, &left_out)?;
            for ((step, region), sums) in of_set {
                errors.entry(step).or_default()[kind].insert(regions + region, sums);
            }
            regions += left_out.iter().flatten().max().map_or(0, |last| last + 1);
        }
        let law = law(&errors, spacing, 2.0 * radius)?;
        if is_closed { with_departure(law, model, measured, &unobserved) } else { Ok(law) }
    }

    fn foot_point(&self, model: &SurfaceModel, k: usize) -> DVec3 {
        let foot = &self.feet[k];
        model.surface.leaf_point(foot.leaf as usize, foot.local[0], foot.local[1])
    }

    /// Predicts the readings of left-out regions from all others: the errors of each region by step of the
    /// distance. Empty if the rest does not determine the surface.
    fn errors_of_set(
        &self,
        model: &SurfaceModel,
        readings: &LeftOutReadings<'_>,
        left_out: &[Option<usize>],
    ) -> Result<BTreeMap<(i32, usize), RegionErrors>> {
        let LeftOutReadings { used, points, spacing } = *readings;
        let mut errors = BTreeMap::<(i32, usize), RegionErrors>::new();
        let (removed, kept): (Vec<usize>, Vec<usize>) = (0..used.len()).partition(|&k| left_out[k].is_some());
        if removed.is_empty() || kept.is_empty() {
            return Ok(errors);
        }
        let tree_of = |part: &[usize]| search_tree(&part.iter().map(|&k| points[k]).collect::<Vec<_>>());
        let (of_removed, of_kept) = (tree_of(&removed)?, tree_of(&kept)?);
        let distance = |tree: &ImmutableKdTree<f64, 3>, p: DVec3| {
            tree.query(p.as_ref()).nearest_one::<SquaredEuclidean<f64>>().execute().distance.sqrt()
        };
        // Batches are samples of one cloud, so all of it has this many times the information at hand.
        let own = self.information.iter().filter(|&&w| w > 0.0).count().max(1) as f64;
        let others: usize = self.residuals_of_batches().iter().map(|o| o.count).sum();
        let parts = 1.0 + others as f64 / own;
        let mut information: Vec<f64> = self.information.iter().map(|w| parts * w).collect();
        for &k in &removed {
            information[used[k]] = 0.0;
        }
        // Readings of other kinds are left out with the positions around them.
        for k in (0..self.feet.len()).filter(|&k| self.feet[k].quantity != Quantity::Position) {
            let p = self.foot_point(model, k);
            if distance(&of_removed, p) < distance(&of_kept, p) {
                information[k] = 0.0;
            }
        }
        let Some((moved, posterior)) = self.predicted(model, &information)? else { return Ok(errors) };
        let compared: Vec<usize> =
            removed.iter().copied().step_by(removed.len().div_ceil(MAX_COMPARED)).collect();
        let found: Vec<(f64, RegionErrors)> = (compared.par_iter().with_min_len(16))
            .map(|&k| {
                let foot = &self.feet[used[k]];
                let (leaf, [s, t]) = (foot.leaf as usize, foot.local);
                let error = foot.height() - foot.normal.dot(moved.leaf_point(leaf, s, t) - points[k]);
                let variance = posterior.leaf(leaf)?.variance_along(&leaf_weights(s, t), foot.normal);
                Ok((
                    distance(&of_kept, points[k]),
                    RegionErrors {
                        square: error * error - 1.0 / self.information[used[k]],
                        variance: variance.max(0.0),
                        count: 1,
                    },
                ))
            })
            .collect::<Result<_>>()?;
        for (&k, (distance, of_reading)) in compared.iter().zip(found) {
            let Some(region) = left_out[k] else { continue };
            let step = ((distance / spacing).max(1.0).ln() / DISTANCE_STEP.ln()) as i32;
            let sums = errors.entry((step, region)).or_default();
            sums.square += of_reading.square;
            sums.variance += of_reading.variance;
            sums.count += 1;
        }
        Ok(errors)
    }

    /// The surface by readings with the given information, and its covariance; none if they leave it open.
    fn predicted<'m>(
        &self,
        model: &'m SurfaceModel,
        information: &[f64],
    ) -> Result<Option<(Surface, Posterior<'m>)>> {
        let Some(known) = model.known.information() else { return Ok(None) };
        let surface = &model.surface;
        let mut factor = None;
        let step = normal_step(
            &StepInput {
                system: self.system,
                surface,
                feet: self.feet,
                information,
                channels: &FootChannels::new(self.observations, self.subset).in_place(),
                prior: &known.prior,
                weight: 1.0,
                earlier: None,
                damping: 0.0,
            },
            &mut factor,
        );
        let step = match step {
            Ok(step) => step,
            Err(e) if e.kind() == ErrorKind::Undetermined => return Ok(None),
            Err(e) => return Err(e),
        };
        let motion = VertexMotion::Along(surface.directions());
        Ok(factor.map(|factor| {
            let covariance = NodeCovariance::of_motion(SelectedInverse::new(&factor), motion);
            (step.surface, Posterior::new(surface, Arc::new(covariance)))
        }))
    }
}

/// The readings of which parts are left out.
struct LeftOutReadings<'a> {
    /// Their feet, by number, and the points of these on the surface.
    used: &'a [usize],
    points: &'a [DVec3],
    /// Their median spacing.
    spacing: f64,
}

/// The sets of regions, the most important first.
fn sets_of_regions(smallest: f64, largest: f64, max_sets: usize) -> Vec<Regions> {
    let balls = |share: f64| Regions::Balls(smallest * (largest / smallest).powf(share));
    let [half, less] = CAP_SHARES.map(Regions::Cap);
    let all = [half, balls(0.5), half, balls(1.0), less, balls(0.0), half, balls(0.75), less, half];
    all[..max_sets.clamp(2, all.len())].to_vec()
}

/// The given share of the points, on that side of a plane where some unobserved place is: one region.
fn cap(
    points: &[DVec3],
    unobserved: &[UnobservedCell],
    middle: DVec3,
    share: f64,
    rng: &mut ChaCha8Rng,
) -> Vec<Option<usize>> {
    let place = unobserved[rng.random_range(0..unobserved.len())].place;
    let heights: Vec<f64> = points.iter().map(|p| (place - middle).dot(*p - middle)).collect();
    let mut sorted = heights.clone();
    let rank = ((1.0 - share) * points.len() as f64) as usize;
    let (_, limit, _) = sorted.select_nth_unstable_by(rank.min(points.len() - 1), f64::total_cmp);
    heights.iter().map(|height| (height > limit).then_some(0)).collect()
}

/// For each point, the region in which it is left out.
fn balls(
    points: &[DVec3],
    unobserved: &[UnobservedCell],
    radius: f64,
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Option<usize>>> {
    let mut left_out = vec![None; points.len()];
    let tree = search_tree(points)?;
    let mut middles: Vec<DVec3> = Vec::new();
    let mut total = 0;
    for attempt in 0..TRIES {
        // In turn at the rim, where surface is continued, and inside, where a hole is closed.
        let middle = match (attempt % 2, unobserved.len()) {
            (0, 1..) => {
                let place = unobserved[rng.random_range(0..unobserved.len())].place;
                let near = tree.query(place.as_ref()).nearest_one::<SquaredEuclidean<f64>>().execute();
                points[near.item as usize]
            }
            _ => points[rng.random_range(0..points.len())],
        };
        if middles.iter().any(|other| other.distance(middle) < APART * radius) {
            continue;
        }
        let inside: Vec<usize> = (0..points.len()).filter(|&k| points[k].distance(middle) < radius).collect();
        if (total + inside.len()) as f64 > MAX_LEFT_OUT * points.len() as f64 {
            continue;
        }
        total += inside.len();
        for k in inside {
            left_out[k] = Some(middles.len());
        }
        middles.push(middle);
        if middles.len() == MAX_REGIONS {
            break;
        }
    }
    Ok(left_out)
}

/// The errors by distance: mean squares over the regions of a kind, times the quantile of their number.
fn law(errors: &ErrorsByDistance, spacing: f64, largest: f64) -> Result<Option<PredictiveSigma>> {
    let mut found: Vec<PredictionError> = Vec::new();
    let (mut factor, mut floor) = (1.0_f64, 0.0_f64);
    for (&step, kinds) in errors {
        let mut tested: Vec<_> = (kinds.iter().zip([usize::MAX, INDEPENDENT_CAPS]))
            .filter(|(regions, _)| regions.values().map(|r| r.count).sum::<usize>() >= MIN_READINGS)
            .collect();
        // Student's t of one or two regions is so wide that it says less than the other kind.
        if tested.iter().any(|(regions, _)| regions.len() >= MIN_REGIONS) {
            tested.retain(|(regions, _)| regions.len() >= MIN_REGIONS);
        }
        if tested.is_empty() {
            continue;
        }
        for (regions, independent) in tested {
            // Each region counts once: a large one has more readings, but one error.
            let mean = |of: &dyn Fn(&RegionErrors) -> f64| {
                regions.values().map(of).sum::<f64>() / regions.len() as f64
            };
            let ratio = mean(&|r| (r.square / r.variance.max(f64::MIN_POSITIVE)).max(0.0));
            let square = mean(&|r| (r.square / r.count as f64).max(0.0));
            let quantile = student_quantile(regions.len().min(independent)) / NORMAL_QUANTILE;
            factor = factor.max(quantile * ratio.sqrt());
            floor = floor.max(quantile * square.sqrt());
        }
        let distance = spacing * DISTANCE_STEP.powf(f64::from(step) + 0.5);
        found.push(PredictionError { distance, factor, floor });
    }
    if found.is_empty() {
        return Ok(None);
    }
    let growth = growth(&found);
    PredictiveSigma::new(found, growth, largest).map(Some)
}

/// The errors of the earlier model, for the leaves of its update.
fn carried(errors: &PredictiveSigma, earlier: &SurfaceModel, model: &SurfaceModel) -> PredictiveSigma {
    let space = model.surface.space();
    let former = (0..space.leaves().len()).map(|leaf| {
        let [u, v] = space.parameters(leaf, [0.5; 2]);
        earlier.surface.space().locate(u, v).0
    });
    match errors.departure() {
        Some(departure) => errors.clone().with_departure(departure.for_leaves(former)),
        None => errors.clone(),
    }
}

/// The errors with the departure of the openings of a closed surface.
fn with_departure(
    law: Option<PredictiveSigma>,
    model: &SurfaceModel,
    measured: &Supporters,
    unobserved: &[UnobservedCell],
) -> Result<Option<PredictiveSigma>> {
    // Without regions that can be left out, the posterior stays.
    let unchanged = PredictionError { distance: 1.0, factor: 1.0, floor: 0.0 };
    let law = law.map_or_else(|| PredictiveSigma::new(vec![unchanged], 0.0, 1.0), Ok)?;
    Ok(Some(law.with_departure(departure(model, measured, unobserved)?)))
}

/// Power of the distance with which the factor grows over the farther half of the tested distances.
fn growth(found: &[PredictionError]) -> f64 {
    let far = &found[found.len() / 2..];
    let (Some(first), Some(last)) = (far.first(), far.last()) else { return GROWTH[1] };
    if first.distance == last.distance {
        return 1.0;
    }
    let power = (last.factor / first.factor).ln() / (last.distance / first.distance).ln();
    power.clamp(GROWTH[0], GROWTH[1])
}

/// 97.5 % quantile of Student's t with `m` degrees of freedom.
///
/// The first are from tables; the expansion of Cornish and Fisher is within 1 % beyond.
fn student_quantile(m: usize) -> f64 {
    const FEW: [f64; 4] = [12.706, 4.303, 3.182, 2.776];
    match m {
        0 => FEW[0],
        1..=4 => FEW[m - 1],
        _ => {
            let (z, n) = (NORMAL_QUANTILE, m as f64);
            z + (z.powi(3) + z) / (4.0 * n) + (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / (96.0 * n * n)
        }
    }
}
