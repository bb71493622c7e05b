//! Test of the stated σ of patches against the differences in their overlaps.
//!
//! In: patches with σ. Out: for every patch, the factor between the σ that the differences show and the
//! stated one, and how much of the differences is a common displacement.
//!
//! A vertex with σ_i is at the height `h` from a triangle of another patch, whose corners have the weights
//! `b` and σ_k. For independent errors, `z = h / √(σ_i² + Σ b² σ_k²)` has the variance 1; for errors that the
//! corners share, `(Σ b σ_k)²` takes the place of the sum. Only the feet that are nearest to a corner are
//! used, where both nearly agree and chord errors are smallest, with the mean of both.
//!
//! For each pair of patches, `z` is divided into a common displacement (a rigid motion and an offset along
//! the normals, by least squares) with the mean square `m²`, and the rest with the robust variance `s²` (the
//! 90 % quantile of magnitudes, divided by 1.645). The ratio `r = m² + s²` is 1 for the right σ. How far it
//! may differ from 1 by chance follows from the correlation of errors: a common displacement has one degree
//! of freedom, and the rest has `ν = 2 n_b / c²`, where `c` is the coefficient of variation of its mean
//! square among `n_b` batches of neighbours. With the right σ, `m²` has the expectation `1 − s²`, so that
//! both make `1 / (max(0, 1 − s²)² + s⁴/ν)` degrees of freedom.
//!
//! The factors `f_i` of the patches follow from `f_i² A_i + f_j² A_j = r_ij (A_i + A_j)`, where `A` are mean
//! stated variances. Multiplicative steps from 1 keep them positive, and equal if only two
//! patches overlap.
//!
//! Not guaranteed: errors common to all patches do not appear in differences. Differences do not show which
//! of two patches is wrong; a third one does. Deviations of less than a tenth of an overlap are taken for
//! outliers.

use super::MergePatch;
use super::overlap::{GATE, MAX_ANGLE_RAD, PatchOverlap, median};
use crate::deviation::quantile_of_sorted;
use crate::search::MeshSearch;
use nalgebra::{SMatrix, SVector};
use planish_core::DVec3;
use planish_estimate::{NestedBatches, chi_square_deviation};
use rayon::prelude::*;

/// Minimum number of differences between two patches that are tested.
const MIN_DIFFERENCES: usize = 50;
/// Number of vertices of a patch that are compared with the others. More cost time and hardly change the
/// result.
const MAX_SAMPLES: usize = 20_000;
/// Share of the differences that are used: those nearest to a corner.
const USED_SHARE: usize = 4;
/// Depth of the batches from which the correlation of the rest follows: 32 batches.
const BATCH_DEPTH: u32 = 5;
/// Deviation of a ratio, in standard deviations, above which it is no chance: 1 % of the cases.
const SIGNIFICANT: f64 = 2.326;
/// Factor of σ above which the stated σ is replaced. The formulas for independent and for shared errors of
/// corners differ by up to 0.07 and chords add to it, so smaller factors are not resolved.
const MIN_FACTOR: f64 = 1.2;
/// Factor of σ below which the errors of patches count as shared.
///
/// Differences cannot distinguish a σ that is too large from errors that patches share. Between both limits,
/// smooth errors of a few degrees of freedom are common.
const SHARED_FACTOR: f64 = 0.5;
/// Minimum degrees of freedom of a ratio that is too small. An offset and two tilts are at least in the
/// common displacement; independent patches have none of these in common.
const MIN_FREEDOM: f64 = 3.0;
/// Quantile of magnitudes from which the scale follows, and the quantile of a standard normal variable.
///
/// Intervals of σ are used at 95 %. The median fits them to the middle of a distribution: with errors of
/// Student's t with three degrees of freedom, it is 0.65 of the standard deviation, and this quantile 0.83. A
/// higher one depends on outliers.
const SCALE_QUANTILE: (f64, f64) = (0.9, 1.645);
/// Efficiency of that quantile, relative to the mean square of normal errors.
const EFFICIENCY: f64 = 0.6;
/// Number of multiplicative steps. The factors of a chain of patches have converged to 1 % then.
const STEPS: usize = 200;

/// What the differences from other patches show about σ of a patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SigmaCheck {
    /// Number of differences.
    pub differences: usize,
    /// Estimated σ over the stated σ; below 1 at most as small as its overlaps show.
    pub factor: f64,
    /// Share of the mean square of its differences that a common displacement explains.
    pub displaced_share: f64,
    /// Root mean square of this displacement, in the unit of the patches.
    pub displacement: f64,
    /// What follows from the factor and its significance.
    pub verdict: SigmaVerdict,
}

/// What a [`SigmaCheck`] implies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SigmaVerdict {
    /// The differences agree with the stated σ.
    Consistent,
    /// The stated σ is too small.
    TooSmall,
    /// The differences are far smaller than the stated σ: it is too large, or patches share their errors.
    Shared,
}

/// The differences of two patches.
struct PairCheck {
    patches: [usize; 2],
    count: usize,
    /// Mean stated variances.
    variances: [f64; 2],
    /// Ratio of the observed and the stated variance.
    ratio: f64,
    /// Its part by a common displacement.
    displaced: f64,
    verdict: SigmaVerdict,
}

/// A difference of two patches.
struct Difference {
    at: DVec3,
    normal: DVec3,
    height: f64,
    /// Stated variance of the vertex and of the foot.
    variances: [f64; 2],
    /// Square of the weights of the corners: 1 at a corner.
    nearness: f64,
}

/// Tests σ of patches; `None` for a patch without σ, or without enough differences.
///
/// Cost: a search for each of at most 20 000 vertices of a patch, in every other patch whose box contains it.
pub(super) fn check_sigma(
    patches: &[MergePatch],
    searches: &[MeshSearch],
    known: &[PatchOverlap],
) -> Vec<Option<SigmaCheck>> {
    let stated: Vec<usize> = (0..patches.len()).filter(|i| !patches[*i].sigma.is_empty()).collect();
    let of_two: Vec<[usize; 2]> =
        stated.iter().flat_map(|i| stated.iter().filter(move |j| *j > i).map(move |j| [*i, *j])).collect();
    let pairs: Vec<PairCheck> =
        of_two.into_par_iter().filter_map(|two| check_pair(two, patches, searches, known)).collect();
    let factors = factors_of(patches.len(), &pairs);
    (0..patches.len())
        .map(|i| {
            let own: Vec<&PairCheck> = pairs.iter().filter(|pair| pair.patches.contains(&i)).collect();
            let count: usize = own.iter().map(|pair| pair.count).sum();
            if own.is_empty() {
                return None;
            }
            let mean = |value: &dyn Fn(&PairCheck) -> f64| {
                own.iter().map(|pair| pair.count as f64 * value(pair)).sum::<f64>() / count as f64
            };
            let displaced = mean(&|pair| pair.displaced * (pair.variances[0] + pair.variances[1]));
            let all = mean(&|pair| pair.ratio * (pair.variances[0] + pair.variances[1]));
            let with = |verdict| own.iter().filter(move |pair| pair.verdict == verdict);
            // One other patch is enough: two models of one scan among independent ones share their errors.
            let least = with(SigmaVerdict::Shared).map(|pair| pair.ratio).min_by(f64::total_cmp);
            let (factor, verdict) = match least {
                _ if factors[i] > MIN_FACTOR && with(SigmaVerdict::TooSmall).next().is_some() => {
                    (factors[i], SigmaVerdict::TooSmall)
                }
                Some(ratio) => (ratio.sqrt().min(factors[i]), SigmaVerdict::Shared),
                None => (factors[i], SigmaVerdict::Consistent),
            };
            Some(SigmaCheck {
                differences: count,
                factor,
                displaced_share: displaced / all.max(f64::MIN_POSITIVE),
                displacement: displaced.sqrt(),
                verdict,
            })
        })
        .collect()
}

/// Compares two patches; `None` if they overlap too little.
fn check_pair(
    two: [usize; 2],
    patches: &[MergePatch],
    searches: &[MeshSearch],
    known: &[PatchOverlap],
) -> Option<PairCheck> {
    let sigma = median(&known[two[0]].sigma).hypot(median(&known[two[1]].sigma));
    let spacing = median(&known[two[0]].spacing).max(median(&known[two[1]].spacing));
    let (mut reach, mut found) = ((2.0 * spacing).max(2.0 * GATE * sigma), None);
    // A reach below 2.6 of the σ that it shows has cut differences off. Four doublings reach eight times the
    // σ that the first reach can show.
    for _ in 0..4 {
        let [a, b] = two;
        let mut differences = differences(a, b, reach, patches, searches, known);
        differences.extend(differences_reversed(b, a, reach, patches, searches, known));
        found = compared(two, differences);
        match &found {
            Some(pair) if GATE * sigma * pair.ratio.sqrt() > reach => reach *= 2.0,
            _ => break,
        }
    }
    found
}

/// [`differences`] with the variances in the order of the other patch.
fn differences_reversed(
    i: usize,
    j: usize,
    reach: f64,
    patches: &[MergePatch],
    searches: &[MeshSearch],
    known: &[PatchOverlap],
) -> Vec<Difference> {
    let mut found = differences(i, j, reach, patches, searches, known);
    for one in &mut found {
        one.variances.reverse();
        // Heights count along the normal from the first patch to the second.
        one.height = -one.height;
    }
    found
}

/// Differences of patch `j` from the vertices of patch `i`.
fn differences(
    i: usize,
    j: usize,
    reach: f64,
    patches: &[MergePatch],
    searches: &[MeshSearch],
    known: &[PatchOverlap],
) -> Vec<Difference> {
    let Some(bounds) = patches[j].mesh.bounding_box() else { return Vec::new() };
    let (own, other) = (&patches[i].mesh, &patches[j].mesh);
    let step = (own.positions.len() / MAX_SAMPLES).max(1);
    (0..own.positions.len())
        .into_par_iter()
        .step_by(step)
        .filter_map(|v| {
            let (p, normal) = (own.positions[v], known[i].normals[v]);
            if !(0..3).all(|k| p[k] >= bounds.min[k] - reach && p[k] <= bounds.max[k] + reach) {
                return None;
            }
            // The limit of the angle must not depend on σ, which is in doubt.
            let foot = searches[j].closest_compatible_within(p, normal, MAX_ANGLE_RAD, reach)?;
            // Beyond a border, the height contains slope and curvature up to the border.
            if foot.on_boundary {
                return None;
            }
            let corners = other.triangles[foot.triangle as usize];
            let of_corners: [f64; 3] =
                std::array::from_fn(|k| foot.barycentric[k] * known[j].sigma[corners[k] as usize]);
            let (shared, squares) =
                (of_corners.iter().sum::<f64>().powi(2), of_corners.iter().map(|s| s * s).sum::<f64>());
            Some(Difference {
                at: p,
                normal,
                height: (foot.point - p).dot(normal),
                variances: [known[i].sigma[v].powi(2), 0.5 * (shared + squares)],
                nearness: foot.barycentric.iter().map(|b| b * b).sum(),
            })
        })
        .collect()
}

/// The ratio of variances of two patches, and its significance.
fn compared(patches: [usize; 2], mut differences: Vec<Difference>) -> Option<PairCheck> {
    if differences.len() < MIN_DIFFERENCES {
        return None;
    }
    let used = (differences.len() / USED_SHARE).max(MIN_DIFFERENCES);
    // A stable sort: equal differences keep the order of the vertices.
    differences.sort_by(|a, b| b.nearness.total_cmp(&a.nearness));
    differences.truncate(used);
    let count = used as f64;
    let z: Vec<f64> =
        differences.iter().map(|d| d.height / (d.variances[0] + d.variances[1]).sqrt()).collect();
    let common = common_displacement(&differences, &z);
    let rest: Vec<f64> = z.iter().zip(&common).map(|(z, c)| z - c).collect();
    let scale = robust_scale(&rest).powi(2);
    let displaced = common.iter().map(|c| c * c).sum::<f64>() / count;
    let freedom = degrees_of_freedom(&differences, &rest, scale);
    let ratio = displaced + scale;
    // With the right σ, the variance that the rest lacks is that of the common displacement.
    let lacking = (1.0 - scale).max(0.0);
    let expected = 1.0 / (lacking * lacking + scale.min(1.0).powi(2) / freedom);
    let observed = ratio * ratio / (displaced * displaced + scale * scale / freedom).max(f64::MIN_POSITIVE);
    let verdict = if chi_square_deviation(ratio, expected.max(1.0)) > SIGNIFICANT {
        SigmaVerdict::TooSmall
    } else if ratio < SHARED_FACTOR * SHARED_FACTOR
        && chi_square_deviation(ratio, observed.max(MIN_FREEDOM)) < -SIGNIFICANT
    {
        SigmaVerdict::Shared
    } else {
        SigmaVerdict::Consistent
    };
    let mean = |k: usize| differences.iter().map(|d| d.variances[k]).sum::<f64>() / count;
    Some(PairCheck { patches, count: used, variances: [mean(0), mean(1)], ratio, displaced, verdict })
}

/// The part of each normalised difference that a rigid motion and an offset along the normals explain.
fn common_displacement(differences: &[Difference], z: &[f64]) -> Vec<f64> {
    let count = differences.len() as f64;
    let middle = differences.iter().map(|d| d.at).sum::<DVec3>() / count;
    let size = (differences.iter().map(|d| (d.at - middle).length_squared()).sum::<f64>() / count)
        .sqrt()
        .max(f64::MIN_POSITIVE);
    let row = |d: &Difference| {
        let turn = ((d.at - middle) / size).cross(d.normal);
        let sigma = (d.variances[0] + d.variances[1]).sqrt();
        let unit = differences[0].variances.iter().sum::<f64>().sqrt();
        SVector::<f64, 7>::from([d.normal.x, d.normal.y, d.normal.z, turn.x, turn.y, turn.z, 1.0])
            * (unit / sigma)
    };
    let mut limit = f64::INFINITY;
    let mut common = vec![0.0; z.len()];
    // Outliers of the first solution are ignored in the second.
    for _ in 0..2 {
        let (mut information, mut sum) = (SMatrix::<f64, 7, 7>::zeros(), SVector::<f64, 7>::zeros());
        for ((d, z), before) in differences.iter().zip(z).zip(&common) {
            if (z - before).abs() <= limit {
                let row = row(d);
                information += row * row.transpose();
                sum += row * *z;
            }
        }
        // Directions without information, such as a rotation of a sphere, stay zero.
        let ridge = 1e-9 * information.trace().max(f64::MIN_POSITIVE);
        information += SMatrix::<f64, 7, 7>::identity() * ridge;
        let Some(factor) = information.cholesky() else { return common };
        let solution = factor.solve(&sum);
        common = differences.iter().map(|d| row(d).dot(&solution)).collect();
        let rest: Vec<f64> = z.iter().zip(&common).map(|(z, c)| z - c).collect();
        limit = 4.0 * robust_scale(&rest);
    }
    common
}

/// Degrees of freedom of the mean square of the rest, from its scatter among batches of neighbours.
fn degrees_of_freedom(differences: &[Difference], rest: &[f64], scale: f64) -> f64 {
    let places: Vec<DVec3> = differences.iter().map(|d| d.at).collect();
    let batches = NestedBatches::new(&places);
    let depth = BATCH_DEPTH.min(batches.depth().saturating_sub(1));
    // Outliers are limited to 4 σ, as the robust scale hardly depends on them.
    let squares: Vec<f64> = (batches.batches(depth))
        .filter(|batch| !batch.is_empty())
        .map(|batch| {
            let sum: f64 = batch.iter().map(|k| rest[*k as usize].powi(2).min(16.0 * scale)).sum();
            sum / batch.len() as f64
        })
        .collect();
    let count = squares.len() as f64;
    let mean = squares.iter().sum::<f64>() / count;
    let variance = squares.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    let freedom = 2.0 * count * mean * mean / variance.max(f64::MIN_POSITIVE);
    // Independent differences have one each.
    freedom.clamp(1.0, EFFICIENCY * rest.len() as f64)
}

/// The standard deviation of normal values with the same quantile of magnitudes.
fn robust_scale(values: &[f64]) -> f64 {
    let mut magnitudes: Vec<f64> = values.iter().map(|x| x.abs()).collect();
    magnitudes.sort_unstable_by(f64::total_cmp);
    quantile_of_sorted(&magnitudes, SCALE_QUANTILE.0) / SCALE_QUANTILE.1
}

/// Factors of σ of the patches.
fn factors_of(patches: usize, pairs: &[PairCheck]) -> Vec<f64> {
    let mut squares = vec![1.0; patches];
    for _ in 0..STEPS {
        let (mut wanted, mut predicted) = (vec![0.0; patches], vec![0.0; patches]);
        for pair in pairs {
            let stated = pair.variances[0] + pair.variances[1];
            let [a, b] = [0, 1].map(|k| squares[pair.patches[k]] * pair.variances[k]);
            let sum = (a + b).max(f64::MIN_POSITIVE);
            for k in 0..2 {
                let share = pair.variances[k] / sum;
                wanted[pair.patches[k]] += share * pair.ratio.max(1e-12) * stated / sum;
                predicted[pair.patches[k]] += share;
            }
        }
        for (square, (wanted, predicted)) in squares.iter_mut().zip(wanted.into_iter().zip(predicted)) {
            if predicted > 0.0 {
                *square *= wanted / predicted;
            }
        }
    }
    // No patch is better than the best of its overlaps shows: a difference that the model of factors cannot
    // explain would otherwise make a third patch look exact.
    for (i, square) in squares.iter_mut().enumerate() {
        let own = pairs.iter().filter(|pair| pair.patches.contains(&i)).map(|pair| pair.ratio);
        let best = own.fold(f64::INFINITY, f64::min);
        if best.is_finite() {
            *square = square.max(best.min(1.0));
        }
    }
    squares.into_iter().map(f64::sqrt).collect()
}
