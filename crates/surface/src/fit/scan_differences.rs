//! Differences between scans where they overlap.
//!
//! A surface follows each scan where that scan is alone, and runs between two that are displaced against each
//! other. Where they overlap little, the mean residual of neither shows it. Input: projected readings.
//! Output: for each scan, how far a rigid motion would have to move it to fit the others.
//!
//! On every leaf `l` with readings of a scan and of others, the difference `d` of their mean residuals has
//! the variance `v`. With the centre `z` of the readings there and their normal `n`, a translation `τ` and a
//! rotation `ω` minimise
//!
//! ```text
//! Σ (d − n·τ − (z × n)·ω)² / v
//! ```
//!
//! The surface itself cancels in the differences. Their rest shows how far errors of neighbours are alike.
//!
//! Not guaranteed: displacements along a plane, about an axis of symmetry and of scans that share few leaves.

use super::noise::SensorNoise;
use crate::observe::{ProjectedReadings, Quantity};
use nalgebra::{Matrix6, Vector6};
use planish_core::DVec3;
use planish_estimate::chi_square_deviation;
use std::collections::{BTreeMap, HashMap};

/// Smallest number of common leaves, and number from which a rotation is determined as well.
const MIN_LEAVES: usize = 8;
const MIN_FOR_ROTATION: usize = 24;
/// Significance of a motion, in standard deviations of a normal variable: a set has tens of scans.
const SIGNIFICANT: f64 = 5.0;
/// Prior information of directions that the leaves do not determine, over that of the others.
const RIDGE: f64 = 1e-9;

/// How far a scan lies from the others where they overlap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanDifference {
    /// Root mean square of the difference along the normals, as far as a rigid motion explains it.
    pub rms: f64,
    /// Root mean square of σ of the scan's readings there.
    pub sigma: f64,
    /// Number of cells with readings of the scan and of others.
    pub cells: usize,
}

/// Sums over the readings of one scan on one leaf.
#[derive(Clone, Copy, Default)]
struct Sums {
    count: f64,
    weight: f64,
    height: f64,
    point: DVec3,
    normal: DVec3,
}

impl Sums {
    fn plus(self, other: &Self, sign: f64) -> Self {
        Self {
            count: self.count + sign * other.count,
            weight: self.weight + sign * other.weight,
            height: self.height + sign * other.height,
            point: self.point + sign * other.point,
            normal: self.normal + sign * other.normal,
        }
    }
}

/// The difference of a scan from the others on one leaf.
struct Difference {
    distance: f64,
    weight: f64,
    point: DVec3,
    normal: DVec3,
    /// Variance of a reading of the scan.
    variance: f64,
}

/// The significant differences of each of `scans` scans from the others.
pub(super) fn scan_differences(
    readings: ProjectedReadings<'_>,
    information: &[f64],
    noise: &SensorNoise,
    scans: usize,
) -> Vec<Option<ScanDifference>> {
    if scans < 2 {
        return vec![None; scans];
    }
    let mut sums: HashMap<(u32, u32), Sums> = HashMap::new();
    for (k, foot) in readings.feet.iter().enumerate() {
        let i = readings.subset[k] as usize;
        let (scan, channel) = (readings.observations.readings.scan[i], readings.channel(k));
        let is_measured =
            foot.quantity == Quantity::Position && !readings.observations.channels[channel].inferred;
        let variance = noise.variance_factors[channel] * foot.variance;
        if !is_measured || information[k] == 0.0 || variance <= 0.0 || scan as usize >= scans {
            continue;
        }
        let weight = 1.0 / variance;
        let own = sums.entry((foot.leaf, scan)).or_default();
        *own = own.plus(
            &Sums {
                count: 1.0,
                weight,
                height: weight * foot.height(),
                point: weight * readings.observations.readings.points[i],
                normal: foot.normal,
            },
            1.0,
        );
    }
    // In the order of leaves, so that sums are the same every time.
    let sums: BTreeMap<(u32, u32), Sums> = sums.into_iter().collect();
    let mut of_leaf: HashMap<u32, Sums> = HashMap::new();
    for ((leaf, _), own) in &sums {
        let all = of_leaf.entry(*leaf).or_default();
        *all = all.plus(own, 1.0);
    }
    let mut differences: Vec<Vec<Difference>> = (0..scans).map(|_| Vec::new()).collect();
    for ((leaf, scan), own) in &sums {
        let all = of_leaf[leaf];
        let others = all.plus(own, -1.0);
        // Counts are exact, weights are not.
        if others.count > 0.0 && others.weight > 0.0 {
            differences[*scan as usize].push(Difference {
                distance: own.height / own.weight - others.height / others.weight,
                weight: 1.0 / (1.0 / own.weight + 1.0 / others.weight),
                point: all.point / all.weight,
                normal: all.normal.normalize_or_zero(),
                variance: own.count / own.weight,
            });
        }
    }
    differences.iter().map(|own| explained(own)).collect()
}

/// The part of differences that a rigid motion explains; none if it is not significant.
fn explained(differences: &[Difference]) -> Option<ScanDifference> {
    let cells = differences.len();
    if cells < MIN_LEAVES {
        return None;
    }
    let total: f64 = differences.iter().map(|d| d.weight).sum();
    let middle: DVec3 = differences.iter().map(|d| d.weight / total * d.point).sum();
    let size = differences.iter().map(|d| d.point.distance(middle)).fold(f64::MIN_POSITIVE, f64::max);
    let unknowns = if cells < MIN_FOR_ROTATION { 3 } else { 6 };
    let row = |d: &Difference| {
        let turn = ((d.point - middle) / size).cross(d.normal);
        let all = [d.normal.x, d.normal.y, d.normal.z, turn.x, turn.y, turn.z];
        Vector6::from_fn(|k, _| if k < unknowns { all[k] } else { 0.0 })
    };
    let (mut matrix, mut right) = (Matrix6::identity() * (RIDGE * total), Vector6::zeros());
    for d in differences {
        let row = row(d);
        matrix += d.weight * row * row.transpose();
        right += d.weight * d.distance * row;
    }
    let motion = matrix.cholesky()?.solve(&right);
    let (mut of_motion, mut of_rest) = (0.0, 0.0);
    for d in differences {
        let moved = row(d).dot(&motion);
        of_motion += d.weight * moved * moved;
        of_rest += d.weight * (d.distance - moved) * (d.distance - moved);
    }
    // Errors that neighbours share make differences larger than their σ, with or without a motion.
    let scatter = (of_rest / (cells - unknowns) as f64).max(1.0);
    let mean_square = of_motion / scatter / unknowns as f64;
    (chi_square_deviation(mean_square, unknowns as f64) > SIGNIFICANT).then(|| ScanDifference {
        rms: (of_motion / total).sqrt(),
        sigma: (differences.iter().map(|d| d.weight * d.variance).sum::<f64>() / total).sqrt(),
        cells,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Differences with errors of σ 1 on part of a sphere of radius 100 that is displaced by `shift`.
    fn differences(seed: u64, cells: usize, shift: DVec3) -> Vec<Difference> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..cells)
            .map(|k| {
                let error: f64 = StandardNormal.sample(&mut rng);
                let (sin, cos) = (0.6 * k as f64).sin_cos();
                let height = 1.0 - 0.5 * k as f64 / cells as f64;
                let radius = (1.0 - height * height).sqrt();
                let normal = DVec3::new(radius * cos, radius * sin, height);
                Difference {
                    distance: error + normal.dot(shift),
                    weight: 1.0,
                    point: 100.0 * normal,
                    normal,
                    variance: 1.0,
                }
            })
            .collect()
    }

    #[test]
    fn a_displacement_is_found_and_noise_is_none() {
        for cells in [10, 40, 400] {
            let chance = (0..200).filter(|&seed| explained(&differences(seed, cells, DVec3::ZERO)).is_some());
            assert_eq!(chance.count(), 0, "{cells} cells");
            let shift = DVec3::new(0.0, 0.0, 4.0);
            let found = (0..200).filter(|&seed| explained(&differences(seed, cells, shift)).is_some());
            assert!(found.count() >= 195, "{cells} cells");
        }
        let found = explained(&differences(1, 400, DVec3::new(2.0, 0.0, 1.0))).unwrap();
        assert!((found.rms - 1.3).abs() < 0.4, "{found:?}");
    }
}
