//! Noise of readings from their neighbours, without a surface.
//!
//! Input: the points of one scan and their stated variances. Output: the σ of independent errors over the
//! stated σ. A fitted surface mixes noise with shape that it does not follow; a quadric through a dozen
//! neighbours follows any smooth shape.
//!
//! Each sampled point is predicted by a quadric through its nearest neighbours. With the weights `c` of that
//! prediction, the difference `y₀ − Σ c_j y_j` has the variance `v₀ + Σ c_j² v_j` under independent errors.
//! The scale of the normalised differences is robust: it starts from their quartile, because an outlier also
//! spoils the predictions of its neighbours, and a gate then removes what is far.
//!
//! Errors that neighbours share cancel in the differences of near neighbours. They show in those of wider
//! neighbourhoods, which grow until the neighbourhood is wider than the errors are shared.
//!
//! Not guaranteed: shape finer than the distance of neighbours counts as noise, unless it grows with the
//! neighbourhood ([`NeighbourNoise::lower`]); waves of a shape look like shared errors.

mod quadric;

use crate::neighbours::tree;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use planish_core::DVec3;
use planish_estimate::gated_scale_from;
use quadric::predicted_difference;
use rayon::prelude::*;
use std::num::NonZero;

/// Neighbours of the smallest quadrics. A quadric has six coefficients; fewer neighbours predict badly, and
/// more see more shape and more outliers.
const MIN_NEIGHBOURS: usize = 12;
/// Neighbours of the largest quadrics, a bound on the cost.
const MAX_NEIGHBOURS: usize = 1536;
/// Smallest radius of a neighbourhood in σ. The nearest neighbours of a point are those with similar errors:
/// at eight σ the scale is 3 % too large, at three 10 %, and in a neighbourhood below one it is that of the
/// neighbourhood's size.
const MIN_RADIUS: f64 = 8.0;
/// Minimum number of points for each neighbour, so that neighbourhoods are local.
const POINTS_PER_NEIGHBOUR: usize = 3;
/// Smallest growth of the variance from the smallest neighbourhood, for shared errors. Independent errors of
/// simulated sheets, tori and boxes grow by up to 1.4 before shape takes over.
const MIN_SHARED_GROWTH: f64 = 1.5;
/// Largest exponent of the growth with the number of neighbours where shared errors are complete. Smooth
/// shape grows with exponents from 1.5 to 3; those of errors shared over one to three spacings of simulated
/// sheets fell to 0.2 to 0.9 and rose again with the shape.
const MAX_SHARED_EXPONENT: f64 = 1.0;
/// Largest σ of shared errors over the radius; larger differences are shape. Errors that were shared over one
/// to three spacings, with slopes of up to 19°, had 0.02 to 0.05; a plate and a cup with sharp edges 0.35 and
/// 0.31.
const MAX_SHARED_SIGMA: f64 = 0.2;
/// Smallest share of differences within the gate for shared errors: outliers also make them grow.
const MIN_KEPT_SHARE: f64 = 0.9;
/// Points whose neighbourhoods are used. The standard error from a thousand is 2 to 3 %.
const MAX_SAMPLE: usize = 1000;
/// Minimum number of differences for a scale; its standard error is then 13 %.
const MIN_SAMPLE: usize = 30;
/// Differences beyond this many σ are outliers.
const GATE: f64 = 3.0;
/// `|x|` of a standard normal variable is below this with a probability of one quarter.
const NORMAL_QUARTILE: f64 = 0.318_639_363_964_375;

/// Noise of readings by their neighbours, over the stated σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NeighbourNoise {
    /// σ of the errors along the normal over the stated σ. It contains shape that neighbours do not
    /// resolve, so it is an upper bound for independent errors.
    pub upper: f64,
    /// The same without the variance that grows with the number of neighbours: a lower bound. Noise does not
    /// grow; shape grows with the third power of the number, or with less where it is as fine as the spacing.
    pub lower: f64,
    /// Relative standard error of both.
    pub standard_error: f64,
    /// Median radius of the neighbourhoods, in the unit of the points.
    pub radius: f64,
    /// Errors that neighbours seem to share, if differences to wider neighbourhoods show any.
    pub shared: Option<SharedNeighbourNoise>,
}

/// Errors that neighbours share, or shape of the same kind: points alone do not tell them apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharedNeighbourNoise {
    /// σ of all errors over the stated σ, where their differences have stopped to grow.
    pub sigma: f64,
    /// Radius of the neighbourhoods there, in the unit of the points. Errors are independent at about half
    /// of it.
    pub radius: f64,
}

/// Differences between points and the quadrics of their neighbours.
struct Differences {
    /// Over their σ.
    scale: f64,
    kept: usize,
    /// Share of the differences within the gate.
    share: f64,
    radius: f64,
    /// Median radius of the neighbourhoods over the stated σ.
    relative_radius: f64,
}

/// Estimates the noise of the points of one scan; `variance(i, n)` is the stated variance of point `i` along
/// the unit vector `n` (1 if none is stated).
///
/// `None` for fewer than 54 points, for points that do not lie on surfaces, and where the noise is so large
/// against the distances of points that no neighbourhood of 1536 points spans eight σ.
///
/// Cost: one tree of all points, and a few thousand neighbourhoods.
///
/// # Examples
/// ```
/// use planish_core::{
///     DVec3,
///     random::{nth, unit_interval},
/// };
/// use planish_sense::neighbour_noise;
/// // A parabolic sheet with errors of ±0.01, stated as 0.005.
/// let points: Vec<DVec3> = (0..900)
///     .map(|i| {
///         let (x, y) = (f64::from(i % 30), f64::from(i / 30));
///         let error = if unit_interval(nth(i as u64)) < 0.5 { 0.01 } else { -0.01 };
///         DVec3::new(x, y, 0.01 * x * x + error)
///     })
///     .collect();
/// let found = neighbour_noise(&points, |_, _| 0.005_f64.powi(2)).unwrap();
/// assert!((found.upper - 2.0).abs() < 0.2);
/// ```
///
/// # References
/// Rice, *Bandwidth choice for nonparametric regression*, 1984 (noise from differences of neighbours);
/// Cleveland, Devlin, *Locally weighted regression*, 1988 (local quadrics).
pub fn neighbour_noise(
    points: &[DVec3],
    variance: impl Fn(usize, DVec3) -> f64 + Sync,
) -> Option<NeighbourNoise> {
    let most = points.len() / POINTS_PER_NEIGHBOUR;
    let tree = tree(points).ok()?;
    let measure = |k: usize| differences(points, &tree, k, &variance);
    let mut neighbours = MIN_NEIGHBOURS;
    while neighbours <= most.min(MAX_NEIGHBOURS) {
        let own = measure(neighbours)?;
        if own.relative_radius >= MIN_RADIUS * own.scale {
            // At least half as many neighbours again, so that shape shows in the difference of the two.
            let more = (2 * neighbours).min(most);
            if 2 * more < 3 * neighbours {
                return None;
            }
            // A law of the third power, exact for cubic shape, took a third of the shape of a coarsely
            // sampled torus for noise; with the first power the bound is safe.
            let growth = more as f64 / neighbours as f64 - 1.0;
            let square = own.scale * own.scale;
            let next = measure(more);
            let shape =
                next.as_ref().map_or(0.0, |next| (next.scale * next.scale - square).max(0.0) / growth);
            let shared = next.and_then(|next| shared_noise(measure, &own, next, more, most));
            return Some(NeighbourNoise {
                upper: own.scale,
                lower: (square - shape).max(0.0).sqrt(),
                standard_error: (0.5 / own.kept as f64).sqrt(),
                radius: own.radius,
                shared,
            });
        }
        neighbours *= 2;
    }
    None
}

/// Follows the growth of the differences with the number of neighbours until it nearly stops.
fn shared_noise(
    measure: impl Fn(usize) -> Option<Differences>,
    smallest: &Differences,
    mut now: Differences,
    mut neighbours: usize,
    most: usize,
) -> Option<SharedNeighbourNoise> {
    let growth = |of: &Differences| (of.scale / smallest.scale).powi(2);
    let mut is_first = true;
    while 2 * neighbours <= most.min(MAX_NEIGHBOURS) {
        let next = measure(2 * neighbours)?;
        if next.share < MIN_KEPT_SHARE {
            return None;
        }
        let exponent = 2.0 * (next.scale / now.scale).log2();
        if growth(&now) >= MIN_SHARED_GROWTH && exponent < MAX_SHARED_EXPONENT {
            let is_shape = next.scale > MAX_SHARED_SIGMA * next.relative_radius;
            return (!is_shape).then_some(SharedNeighbourNoise { sigma: next.scale, radius: next.radius });
        }
        // Most scans have independent errors, which the first three neighbourhoods show.
        if is_first && growth(&next) < 0.5 * (1.0 + MIN_SHARED_GROWTH) {
            return None;
        }
        is_first = false;
        (now, neighbours) = (next, 2 * neighbours);
    }
    None
}

/// Normalised differences of a sample of points from quadrics of `k` neighbours.
fn differences(
    points: &[DVec3],
    tree: &ImmutableKdTree<f64, 3>,
    k: usize,
    variance: &(impl Fn(usize, DVec3) -> f64 + Sync),
) -> Option<Differences> {
    // The point itself is among its nearest.
    let count = NonZero::new(k + 1)?;
    let found: Vec<(f64, f64, f64)> = (0..points.len())
        .step_by(points.len().div_ceil(MAX_SAMPLE))
        .collect::<Vec<usize>>()
        .into_par_iter()
        .filter_map(|i| {
            let near = tree.query(points[i].as_ref()).nearest_n::<SquaredEuclidean<f64>>(count).execute();
            let radius = near.iter().map(|n| n.distance).fold(0.0, f64::max).sqrt();
            let others: Vec<usize> = near.iter().map(|n| n.item as usize).filter(|&j| j != i).collect();
            let (difference, own) = predicted_difference(points, i, &others, radius, variance)?;
            Some((difference, radius, radius / own.sqrt()))
        })
        .collect();
    if found.len() < MIN_SAMPLE {
        return None;
    }
    let quantile = |mut values: Vec<f64>, part: usize| {
        let at = values.len() / part;
        *values.select_nth_unstable_by(at, f64::total_cmp).1
    };
    let gated = |differences: Vec<f64>| {
        let first = quantile(differences.iter().map(|d| d.abs()).collect(), 4) / NORMAL_QUARTILE;
        gated_scale_from(&differences, GATE, first).ok()
    };
    let mut count = found.len();
    let mut scale = gated(found.iter().map(|f| f.0).collect())?;
    // Where σ differs from point to point, neighbourhoods are large enough for some points only.
    let wide: Vec<f64> = found.iter().filter(|f| f.2 >= MIN_RADIUS * scale.sigma).map(|f| f.0).collect();
    if wide.len() >= MIN_SAMPLE {
        count = wide.len();
        scale = gated(wide)?;
    }
    // Depths that are whole numbers agree exactly with many neighbours, which shows nothing of their errors.
    (scale.sigma > 0.0 && scale.kept >= MIN_SAMPLE).then(|| Differences {
        scale: scale.sigma,
        kept: scale.kept,
        share: scale.kept as f64 / count as f64,
        radius: quantile(found.iter().map(|f| f.1).collect(), 2),
        relative_radius: quantile(found.iter().map(|f| f.2).collect(), 2),
    })
}

#[cfg(test)]
mod tests;
