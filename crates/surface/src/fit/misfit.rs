//! Leaves whose residuals contain more than noise.
//!
//! Input: a surface that has converged on its readings. Output: the leaves that cannot follow them, worst
//! first.
//!
//! Residuals are averaged over bins of each leaf. Only products of residuals of *different* readings are
//! counted: their mean is zero under independent noise of any size, so the noise need not be known exactly.

use super::FitOptions;
use super::division::{CORNERS, MIN_LEAF_SIGMAS, MIN_READINGS, Misfit, blocks, chance_misfits, deepest};
use super::leaves::{leaf_areas, neighbourhood};
use super::noise::SensorNoise;
use crate::observe::{Foot, FootState, ProjectedReadings, Quantity, by_leaf};
use crate::subdivision::Cause;
use planish_spline::{Hierarchy, Surface};
use rayon::prelude::*;

/// Bins along each side of a leaf in which residuals are averaged to find shape that the leaf cannot follow.
///
/// Only products of readings in one bin count. Smaller bins show finer shape, but hold fewer pairs of
/// readings. See decision 0005.
pub(super) const BINS: usize = 4;
/// Shape worth a division explains at least this share of the variance of a leaf's readings. Less would
/// spend coefficients on shape far below the noise.
const MIN_EXPLAINED_SHARE: f64 = 0.02;
/// Shape of a single leaf counts if it is this many standard deviations of noise.
///
/// A lower bound divides leaves by chance; [`chance_misfits`] allows for 2 % of them. Of a normal variable
/// far fewer would exceed it, but a sum of few products is skewed. At 2.5, 5 % of gross errors changed the
/// error of one smooth ball in six by more than a tenth, because leaves at the bound passed in one fit only;
/// at 3.5 none of twenty.
const MIN_SIGNIFICANCE: f64 = 3.5;
/// The same for the quarters of a leaf and its neighbours together.
///
/// Shape of that size is about five times the variance of the surface by noise. A division quadruples that
/// variance, and neighbours are divided along, so that less shape costs more than it adds: at 2, smooth balls
/// of 40,000 readings had up to three times the cells and 1.6 times the error. σ contains what remains
/// ([`super::spline_error`], [`super::unresolved_shape`]). See decisions 0005 and 0110.
const MIN_POOLED_SIGNIFICANCE: f64 = 4.0;
/// Readings beyond the gate are gross errors while they are fewer than this share of a leaf; more of them
/// are shape. See decision 0005.
pub(super) const MAX_GROSS: f64 = 0.25;
/// Residuals beyond this many σ are weighed down to it, so that one wild reading cannot divide a leaf.
const HUBER_BOUND: f64 = 3.0;
/// The share of `pairs` up to which the degrees of freedom that the fit used are added back.
///
/// The degrees are an average over leaves. A leaf with few readings cannot have lost more than its own
/// residuals.
const MAX_RESTORED: f64 = 0.8;

/// The bin of a place on a leaf, row by row.
pub(super) fn bin_of(local: [f64; 2]) -> usize {
    let [i, j] = local.map(|x| ((x * BINS as f64) as usize).min(BINS - 1));
    j * BINS + i
}

/// The residuals `h` of one bin with weights `w`.
#[derive(Clone, Copy, Default)]
struct Bin {
    /// `Σ w h`, `Σ (w h)²` and `Σ w`.
    sum: f64,
    squares: f64,
    precision: f64,
    count: f64,
}

/// The residuals of one leaf, in bins for each component: the height, and the tilts along two tangents.
///
/// Smooth shape is smooth in each component. Residuals of curvatures are not used: the prior acts on
/// curvature itself and shrinks all of its wavelengths alike, more so with more cells.
#[derive(Clone, Default)]
struct LeafResiduals {
    /// The bins of the first component, then those of the next.
    bins: Vec<Bin>,
    /// Number of residuals, and how many of them belong to positions.
    count: u32,
    positions: u32,
    /// Mean variance of the positions; the smallest plausible one.
    variance: f64,
}

/// Components whose residuals are used: the height, and the tilts along two tangents.
const COUNTED_NUMBERS: usize = 3;

/// The first of these components that belongs to a quantity.
fn first_number(quantity: Quantity) -> usize {
    match quantity {
        Quantity::Position => 0,
        Quantity::Normal => 1,
        Quantity::Curvature => COUNTED_NUMBERS,
    }
}

impl LeafResiduals {
    /// The residuals of `feet`, all on one leaf.
    fn new<'f>(feet: impl Iterator<Item = (&'f Foot, FootNoise)> + Clone, numbers: usize, gate: f64) -> Self {
        // A few distant readings are gross errors, many are shape.
        let far = feet.clone().filter(|(_, noise)| noise.normalised > gate).count();
        let gross = (far as f64) < MAX_GROSS * feet.clone().count() as f64;
        let mut made = Self { bins: vec![Bin::default(); numbers * BINS * BINS], ..Self::default() };
        for (foot, FootNoise { normalised: r, variance, min_variance }) in feet {
            if gross && r > gate {
                continue;
            }
            let w = (if r > HUBER_BOUND { HUBER_BOUND / r } else { 1.0 }) / variance;
            let bin = bin_of(foot.local);
            for (number, h) in (first_number(foot.quantity)..).zip(foot.residuals()) {
                let bin = &mut made.bins[number * BINS * BINS + bin];
                bin.sum += w * h;
                bin.squares += (w * h).powi(2);
                bin.precision += w;
                bin.count += 1.0;
                made.count += 1;
            }
            if foot.quantity == Quantity::Position {
                made.positions += 1;
                made.variance += min_variance;
            }
        }
        made.variance /= f64::from(made.positions.max(1));
        made
    }

    /// `Σ_b ((Σ w h)² − Σ (w h)²) / Σ w` over the bins that `group` maps to, and half its variance under
    /// noise.
    ///
    /// The mean of this sum is zero under any symmetric and independent noise, gross errors included. It
    /// grows with the shape that neighbouring readings share.
    fn shared_shape(&self, group: impl Fn(usize) -> Option<usize>) -> (f64, f64) {
        let (mut shape, mut pairs) = (0.0, 0.0);
        for number in self.bins.chunks_exact(BINS * BINS) {
            let mut merged = [Bin::default(); BINS * BINS];
            for (bin, own) in number.iter().enumerate() {
                if let Some(to) = group(bin) {
                    let to = &mut merged[to];
                    to.sum += own.sum;
                    to.squares += own.squares;
                    to.precision += own.precision;
                    to.count += own.count;
                }
            }
            // A single reading has no other one to form a product with.
            for bin in merged.iter().filter(|bin| bin.count > 1.0) {
                shape += (bin.sum * bin.sum - bin.squares) / bin.precision;
                // With equal weights, the term of `n` readings has the variance 2 n (n − 1) / n² under noise.
                pairs += 1.0 - 1.0 / bin.count;
            }
        }
        (shape, pairs)
    }

    /// The quarter of the leaf that a bin lies in.
    fn quarter(bin: usize) -> usize {
        usize::from(bin / BINS >= BINS / 2) * 2 + usize::from(bin % BINS >= BINS / 2)
    }

    /// The largest mean residual of the positions of a bin.
    fn largest_mean(&self) -> f64 {
        self.bins
            .iter()
            .take(BINS * BINS)
            .filter(|b| b.count > 0.0)
            .map(|b| (b.sum / b.precision).abs())
            .fold(0.0, f64::max)
    }

    /// The quarter with the largest misfit, as the signs of its corner.
    fn worst_corner(&self) -> [f64; 2] {
        let mut misfit = [0.0; 4];
        for (bin, b) in self.bins.iter().enumerate().filter(|(_, b)| b.count > 0.0) {
            misfit[Self::quarter(bin % (BINS * BINS))] += b.sum * b.sum / b.precision;
        }
        let worst = (0..4).max_by(|&a, &b| misfit[a].total_cmp(&misfit[b])).unwrap_or(0);
        CORNERS[worst]
    }
}

/// The noise of one reading as the test uses it.
#[derive(Clone, Copy)]
struct FootNoise {
    /// The largest residual over its σ.
    normalised: f64,
    variance: f64,
    /// The smallest plausible variance.
    min_variance: f64,
}

impl FootNoise {
    /// The noise of foot `k`.
    ///
    /// Missing shape inflates every estimate, so the variance is bounded by the stated σ and by how well
    /// neighbouring points agree. Errors of neighbours in one scan may be correlated, though: without a
    /// stated σ their agreement only bounds how small a leaf may be.
    fn new(readings: ProjectedReadings<'_>, noise: &SensorNoise, k: usize) -> Self {
        let foot = &readings.feet[k];
        let channel = readings.channel(k);
        let bounded = noise.variance_factors[channel].min(noise.factor_bounds[channel]);
        let factor = if readings.observations.channels[channel].stated {
            bounded
        } else {
            noise.variance_factors[channel]
        };
        let variance = factor * foot.variance;
        Self {
            normalised: foot.extremes().0 / variance.sqrt(),
            variance,
            min_variance: bounded * foot.variance,
        }
    }
}

/// Leaves whose residuals are too large and too similar to be noise, worst first.
///
/// `degrees` are the degrees of freedom that the fit used; what they took out of the residuals is added
/// back. Strong misfit shows on one leaf alone. Weaker misfit is searched for in the quarters of a leaf and
/// its eight neighbours together, because unresolved shape that goes unnoticed makes a stated σ too small;
/// but only once strong misfit is gone. With a tolerance, the size of the mean residuals decides.
pub(super) fn misfit(
    surface: &Surface,
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    degrees: f64,
    options: &FitOptions,
) -> Vec<Misfit> {
    let space = surface.space();
    let residuals = residuals_by_leaf(space, readings, noise, options.gate);
    // What the fit took out of each measured leaf, on average.
    let measured = residuals.iter().filter(|r| r.count > 0).count();
    // A fit with `k` degrees of freedom lowers χ², and with it the sum of products, by about `k`.
    let removed = degrees / measured.max(1) as f64;
    let quarters: Vec<(f64, f64)> = residuals
        .par_iter()
        .with_min_len(64)
        .map(|r| {
            let (shape, pairs) = r.shared_shape(|bin| Some(LeafResiduals::quarter(bin)));
            (shape + removed.min(MAX_RESTORED * pairs), pairs)
        })
        .collect();
    let areas = leaf_areas(surface);
    let deepest = deepest(options);
    let (mut strong, mut weak) = (Vec::new(), Vec::new());
    for (leaf, own) in residuals.iter().enumerate() {
        // Leaves that cannot or must not be divided are skipped, but they count in the pools of their
        // neighbours.
        let too_small = areas[leaf] < MIN_LEAF_SIGMAS.powi(2) * own.variance;
        if too_small || space.leaves()[leaf].level >= deepest || own.count < MIN_READINGS {
            continue;
        }
        let (shape, pairs) = own.shared_shape(Some);
        let spread = (2.0 * pairs).sqrt();
        let found = || Misfit {
            leaf,
            cause: Cause::Residuals,
            severity: shape / spread.max(1.0),
            corner: own.worst_corner(),
        };
        // With many readings, shape far below the noise becomes significant. The second bound keeps it from
        // asking for cells.
        let significant = shape > (MIN_SIGNIFICANCE * spread).max(MIN_EXPLAINED_SHARE * f64::from(own.count));
        // Shape below a tolerance need not be resolved, so weak misfits are not searched for.
        if let Some(tolerance) = options.tolerance {
            if significant && own.largest_mean() > tolerance {
                strong.push(found());
            }
        } else if significant {
            strong.push(found());
        } else {
            // Quarters are pooled rather than single bins: weak shape is wide compared with a bin.
            let (mut excess, mut spread, mut count) = (0.0, 0.0, 0.0);
            for other in neighbourhood(space, leaf) {
                excess += quarters[other].0;
                spread += 2.0 * quarters[other].1;
                count += f64::from(residuals[other].count);
            }
            if excess > (MIN_POOLED_SIGNIFICANCE * f64::sqrt(spread)).max(MIN_EXPLAINED_SHARE * count) {
                weak.push(found());
            }
        }
    }
    strong_first(space, strong, weak, options)
}

/// Strong and weak misfits, worst first; the weak ones only if they leave most of the budget to strong ones
/// that are still to be found.
fn strong_first(
    space: &Hierarchy,
    mut strong: Vec<Misfit>,
    mut weak: Vec<Misfit>,
    options: &FitOptions,
) -> Vec<Misfit> {
    // Ties are broken by the number of the leaf, so that the order is always the same.
    let worst_first = |a: &Misfit, b: &Misfit| b.severity.total_cmp(&a.severity).then(a.leaf.cmp(&b.leaf));
    strong.sort_by(worst_first);
    let before = strong.len();
    strong.append(&mut weak);
    if before >= chance_misfits(space)
        && space.refined_node_count(&blocks(space, &strong)) > options.max_coefficients / 2
    {
        strong.truncate(before);
    }
    strong.sort_by(worst_first);
    strong
}

/// The binned residuals of every leaf.
fn residuals_by_leaf(
    space: &Hierarchy,
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    gate: f64,
) -> Vec<LeafResiduals> {
    let ProjectedReadings { observations, feet, .. } = readings;
    let (start, order) = by_leaf(feet, space.leaves().len());
    let numbers = (observations.channels.iter())
        .map(|channel| first_number(channel.quantity) + channel.quantity.rows())
        .max()
        .unwrap_or(1)
        .min(COUNTED_NUMBERS);
    (0..space.leaves().len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let own = order[start[leaf] as usize..start[leaf + 1] as usize].iter().map(|&k| k as usize);
            let good = own
                .filter(|&k| feet[k].state == FootState::Good && first_number(feet[k].quantity) < numbers)
                .map(|k| (&feet[k], FootNoise::new(readings, noise, k)));
            LeafResiduals::new(good, numbers, gate)
        })
        .collect()
}
