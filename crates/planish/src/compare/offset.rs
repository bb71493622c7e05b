//! The common offset of two surfaces along their normals, apart from deviations of single places.
//!
//! In: points, their signed deviations and the directions in which these are signed. Out: a
//! [`CommonOffset`] with its σ. Not guaranteed: σ counts errors that are correlated over more than about a
//! quarter of the compared part as offset, because nothing distinguishes the two.

use crate::report::words::SmallUnit;
use planish_core::DVec3;
use planish_estimate::Loss;
use planish_mesh::BoundingBox;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;

/// Edges of the smallest blocks, in diagonals of the compared part. Each occupied block counts once, so that
/// dense places count no more than others.
const FINEST_BLOCK: f64 = 1.0 / 64.0;
/// Blocks that a variance needs: of seven degrees of freedom, it is known to half of itself.
const MIN_BLOCKS: f64 = 8.0;
/// Error probability of an offset that is named: that of 3 σ.
const MAX_CHANCE: f64 = 0.0027;
/// Smallest named offset relative to the scale of the deviations about it. Smaller ones explain less than six
/// per cent of the mean square; they are in the figures only.
const MIN_SHARE: f64 = 0.25;
/// Share of a constant deviation that a shift explains beyond which the two are indistinguishable.
const SHIFT_LIKE: f64 = 0.9;
const ITERATIONS: usize = 50;

/// A constant deviation along the normals: of a probe's radius, a coating, a calibration or a scale.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CommonOffset {
    /// Robust mean of the deviations, in the model's unit. Each place counts once, whatever its density.
    pub value: f64,
    /// σ of `value` with the spatial correlation of the deviations, in the same unit. If points are compared
    /// with a mesh, the chord error of the mesh is part of it.
    pub sigma: f64,
    /// Root mean square of the deviations without the offset, in the same unit.
    pub rms_without: f64,
    /// Share of a constant deviation that a shift of the frame explains: 1 for a plane, 0 for a sphere.
    pub explained_by_shift: f64,
    /// Degrees of freedom of `sigma`.
    #[serde(skip)]
    degrees: f64,
    /// Robust scale of the deviations about the offset.
    #[serde(skip)]
    scale: f64,
}

impl CommonOffset {
    /// Estimates the offset of `deviations` at `points`, signed along `directions` (unit vectors).
    ///
    /// The value is Huber's M-estimate `c` with a weight per block of equal size. The influences
    /// `w_i ψ((d_i − c)/s) s / Σ w ψ'` of the points of a block are summed; the sum of squares of these sums
    /// is the variance of `c` if blocks are independent. Blocks grow by factors of two, and the largest
    /// variance counts: it stops growing when blocks are larger than the correlation length. Returns `None`
    /// for fewer points than fill eight blocks. All numbers must be finite. Cost O(n log n).
    ///
    /// # References
    /// Flyvbjerg and Petersen, *Error estimates on averages of correlated data*, J. Chem. Phys. 1989;
    /// Huber and Ronchetti, *Robust statistics*, 2009, sections 4.5 and 6.4.
    pub(super) fn estimate(points: &[DVec3], deviations: &[f64], directions: &[DVec3]) -> Option<Self> {
        let extent = BoundingBox::from_points(points)?;
        let blocks = |edge: f64| -> Vec<[u32; 3]> {
            let block_of = |p: &DVec3| std::array::from_fn(|k| ((p[k] - extent.min[k]) / edge) as u32);
            points.iter().map(block_of).collect()
        };
        let diagonal = extent.diagonal();
        // Points that all coincide are one place.
        if diagonal <= 0.0 {
            return None;
        }
        let weights = weights_of_blocks(&blocks(FINEST_BLOCK * diagonal));
        let (value, scale) = location(deviations, &weights)?;
        let influence = influences(deviations, &weights, value, scale);
        let mut widest: Option<(f64, f64)> = None;
        let mut edge = FINEST_BLOCK;
        while edge < 1.0 {
            let (variance, effective) = variance_of_blocks(&blocks(edge * diagonal), &influence, &weights);
            if effective >= MIN_BLOCKS && widest.is_none_or(|(found, _)| variance > found) {
                widest = Some((variance, effective - 1.0));
            }
            edge *= 2.0;
        }
        let n = deviations.len() as f64;
        widest.map(|(variance, degrees)| Self {
            value,
            sigma: variance.sqrt(),
            rms_without: (deviations.iter().map(|d| (d - value).powi(2)).sum::<f64>() / n).sqrt(),
            explained_by_shift: explained_by_shift(directions, &weights),
            degrees,
            scale,
        })
    }

    /// The same with the mean height `gap` of the unknown smooth surface over the facets as an error.
    ///
    /// Points against a mesh have one direction only, so a chord error looks like an offset. It is not
    /// subtracted, because nothing states that the facets are chords.
    #[must_use]
    pub(super) fn with_chord_gap(self, gap: f64) -> Self {
        Self { sigma: self.sigma.hypot(gap), ..self }
    }

    /// Whether the offset is significant, and not small compared with the other deviations.
    pub(super) fn is_notable(&self) -> bool {
        // A constant deviation without any scatter has σ = 0 and is certain.
        let chance = match StudentsT::new(0.0, 1.0, self.degrees) {
            Ok(student) if self.sigma > 0.0 => 2.0 * student.cdf(-self.value.abs() / self.sigma),
            _ => f64::from(self.value == 0.0),
        };
        chance < MAX_CHANCE && self.value.abs() > MIN_SHARE * self.scale
    }

    /// The offset in words, with the causes that it may have.
    pub(super) fn text(&self, unit: SmallUnit<'_>) -> String {
        let causes = if self.explained_by_shift > SHIFT_LIKE {
            "the compared part is so flat that a shift of a frame looks the same"
        } else {
            "possible causes: a probe radius, a coating, the calibration or a scale"
        };
        format!(
            "the model has a common offset of {}{} ± {} {} along the normals of the reference; without it, \
             the rms of the deviations is {}; {causes}",
            if self.value > 0.0 { "+" } else { "" },
            unit.number(self.value, 3),
            unit.number(self.sigma, 2),
            unit.name,
            unit.text(self.rms_without),
        )
    }
}

/// Weights that make every block count once.
fn weights_of_blocks(blocks: &[[u32; 3]]) -> Vec<f64> {
    let mut counts: BTreeMap<[u32; 3], usize> = BTreeMap::new();
    for block in blocks {
        *counts.entry(*block).or_default() += 1;
    }
    blocks.iter().map(|block| 1.0 / counts[block] as f64).collect()
}

/// Huber's location and the scale about it, `1.4826` times the weighted median of magnitudes.
fn location(values: &[f64], weights: &[f64]) -> Option<(f64, f64)> {
    let mut center = weighted_median(values.iter().copied(), weights)?;
    let scale = 1.482_602_218_505_602 * weighted_median(values.iter().map(|v| (v - center).abs()), weights)?;
    if scale == 0.0 {
        return Some((center, scale));
    }
    let loss = Loss::huber();
    for _ in 0..ITERATIONS {
        let (mut sum, mut total) = (0.0, 0.0);
        for (value, weight) in values.iter().zip(weights) {
            let weight = weight * loss.weight((value - center) / scale);
            sum += weight * (value - center);
            total += weight;
        }
        let step = sum / total;
        center += step;
        if step.abs() <= 1e-9 * scale {
            break;
        }
    }
    Some((center, scale))
}

fn weighted_median(values: impl Iterator<Item = f64>, weights: &[f64]) -> Option<f64> {
    let mut sorted: Vec<(f64, f64)> = values.zip(weights.iter().copied()).collect();
    sorted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * weights.iter().sum::<f64>();
    let mut sum = 0.0;
    let reached = sorted.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    reached.or(sorted.last()).map(|(value, _)| *value)
}

/// Influence of each value on the location.
fn influences(values: &[f64], weights: &[f64], center: f64, scale: f64) -> Vec<f64> {
    if scale == 0.0 {
        return vec![0.0; values.len()];
    }
    let loss = Loss::huber();
    let normalised = |value: f64| (value - center) / scale;
    let slope: f64 = values.iter().zip(weights).map(|(v, w)| w * loss.psi_slope(normalised(*v))).sum();
    let influence = |(v, w): (&f64, &f64)| scale * w * loss.psi(normalised(*v)) / slope;
    values.iter().zip(weights).map(influence).collect()
}

/// Variance of the location if blocks are independent, and their effective number `(Σ W)²/Σ W²`.
fn variance_of_blocks(blocks: &[[u32; 3]], influence: &[f64], weights: &[f64]) -> (f64, f64) {
    let mut sums: BTreeMap<[u32; 3], [f64; 2]> = BTreeMap::new();
    for (k, block) in blocks.iter().enumerate() {
        let sum = sums.entry(*block).or_default();
        sum[0] += influence[k];
        sum[1] += weights[k];
    }
    let total: f64 = sums.values().map(|sum| sum[1]).sum();
    let effective = total * total / sums.values().map(|sum| sum[1] * sum[1]).sum::<f64>();
    // The factor n/(n − 1) of a variance about an estimated mean.
    let factor = if effective > 1.0 { effective / (effective - 1.0) } else { 0.0 };
    (factor * sums.values().map(|sum| sum[0] * sum[0]).sum::<f64>(), effective)
}

/// Share of a constant that the best shift `t` explains by `n·t`: `n̄ᵀ (Σ w n nᵀ)⁻¹ n̄ / Σ w` with
/// `n̄ = Σ w n`.
fn explained_by_shift(directions: &[DVec3], weights: &[f64]) -> f64 {
    let mut sum = nalgebra::Vector3::zeros();
    let mut square = nalgebra::Matrix3::zeros();
    let mut total = 0.0;
    for (n, w) in directions.iter().zip(weights) {
        let n = nalgebra::Vector3::new(n[0], n[1], n[2]);
        sum += *w * n;
        square += *w * n * n.transpose();
        total += w;
    }
    // The pseudo-inverse, because all normals of a plane are parallel.
    square.pseudo_inverse(1e-9 * total).map_or(0.0, |inverse| (sum.dot(&(inverse * sum)) / total).min(1.0))
}

#[cfg(test)]
mod tests;
