//! When a patch is divided: where its curvature varies, or where its readings surprise it.
//!
//! Comes in: Gaussian curvatures of a patch with their σ, and the squared normalised innovations of its readings by cell. Goes out:
//! a [`SubdivisionReason`] or none.
//!
//! Curvature: `sd(K) / max(|K̄|, σ_K) > limit`, K taken at the middles of the sixteen cells (the paper's eq. 13 divides a variance by a
//! mean: it has units and blows up at `K̄ = 0`). Readings: over each 2 × 2 block of cells, the least on which a finer function lives, the
//! sum of squared normalised innovations is χ² with one degree of freedom each; the block speaks when the sum is that many standard
//! deviations too large (Wilson–Hilferty).
//!
//! Not guaranteed: that curvature which varies only because it is badly known is told from that which varies truly when σ_K exceeds |K̄|.
//!
//! # References
//! Wang, Wang 1994, eq. 11–13; Wilson, Hilferty, *The distribution of chi-square*, PNAS 1931.

use crate::surface::Jet;

/// When to divide a patch; a criterion that is none is not asked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SubdivisionCriteria {
    /// The most `sd(K) / max(|K̄|, σ_K)` of a patch that is left whole.
    pub curvature_variation: Option<f64>,
    /// How many standard deviations the innovations of a 2 × 2 block may be too large.
    pub chi_square: Option<f64>,
    /// Scalar readings that a block, and a patch, needs before it is judged.
    pub least_readings: u64,
}

impl Default for SubdivisionCriteria {
    /// The paper's limit of 0.5 beside a χ² of 3 standard deviations, on 8 readings or more.
    fn default() -> Self {
        Self {
            curvature_variation: Some(0.5),
            chi_square: Some(3.0),
            least_readings: 8,
        }
    }
}

/// Why a patch was divided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SubdivisionReason {
    /// `sd(K) / max(|K̄|, σ_K)` was this large.
    CurvatureVariation(f64),
    /// Innovations were this many standard deviations too large.
    ChiSquare(f64),
    /// A neighbour was divided, and neighbouring cells may differ by one level only.
    Grading,
    /// It was asked for.
    Requested,
}

/// Squared normalised innovations of one cell.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct InnovationSum {
    /// Scalar readings.
    pub count: u64,
    /// `Σ e²/S`
    pub normalized_squared: f64,
}

impl SubdivisionCriteria {
    /// `curvatures`: value and σ at the middle of each cell, none where the surface is singular.
    pub(super) fn reason(
        &self,
        innovations: &[InnovationSum; 16],
        curvatures: impl FnOnce() -> Option<[[f64; 2]; 16]>,
    ) -> Option<SubdivisionReason> {
        if innovations.iter().map(|s| s.count).sum::<u64>() < self.least_readings {
            return None;
        }
        if let Some(limit) = self.chi_square {
            let worst = worst_block(innovations, self.least_readings);
            if worst > limit {
                return Some(SubdivisionReason::ChiSquare(worst));
            }
        }
        let variation = curvature_variation(&curvatures()?);
        (variation > self.curvature_variation?).then_some(SubdivisionReason::CurvatureVariation(variation))
    }
}

/// `sd(K) / max(|K̄|, σ_K)`, σ_K the root mean square of the σ.
pub(super) fn curvature_variation(curvatures: &[[f64; 2]; 16]) -> f64 {
    let mean = curvatures.iter().map(|[k, _]| k).sum::<f64>() / 16.0;
    let variance = curvatures.iter().map(|[k, _]| (k - mean).powi(2)).sum::<f64>() / 15.0;
    let sigma2 = curvatures.iter().map(|[_, s]| s * s).sum::<f64>() / 16.0;
    let scale = mean.abs().max(sigma2.sqrt());
    if variance == 0.0 { 0.0 } else { variance.sqrt() / scale }
}

/// By how many standard deviations the innovations of the worst 2 × 2 block are too large.
fn worst_block(innovations: &[InnovationSum; 16], least: u64) -> f64 {
    let mut worst = f64::NEG_INFINITY;
    for row in 0..3 {
        for column in 0..3 {
            let block = [0, 1, 4, 5].map(|k| innovations[4 * row + column + k]);
            let count: u64 = block.iter().map(|s| s.count).sum();
            if count < least.max(1) {
                continue;
            }
            let n = count as f64;
            let sum: f64 = block.iter().map(|s| s.normalized_squared).sum();
            let spread = 2.0 / (9.0 * n);
            worst = worst.max(((sum / n).cbrt() - 1.0 + spread) / spread.sqrt());
        }
    }
    worst
}

/// Gaussian curvature and its gradient by the five derivatives of a jet (`u, v, uu, uv, vv`); none where the surface is singular.
pub(super) fn gaussian_curvature(jet: &Jet) -> Option<(f64, [[f64; 3]; 5])> {
    let value = jet.curvature()?.gaussian();
    let mut gradient = [[0.0; 3]; 5];
    let first = jet.du.iter().chain(&jet.dv).fold(0.0_f64, |m, x| m.max(x.abs()));
    let second = jet
        .duu
        .iter()
        .chain(&jet.duv)
        .chain(&jet.dvv)
        .fold(1e-3 * first, |m, x| m.max(x.abs()));
    for (which, by) in gradient.iter_mut().enumerate() {
        let h = 1e-5 * if which < 2 { first } else { second };
        for (d, slope) in by.iter_mut().enumerate() {
            let at = |step: f64| {
                let mut moved = *jet;
                let part = match which {
                    0 => &mut moved.du,
                    1 => &mut moved.dv,
                    2 => &mut moved.duu,
                    3 => &mut moved.duv,
                    _ => &mut moved.dvv,
                };
                part[d] += step;
                moved.curvature().map(|c| c.gaussian())
            };
            *slope = (at(h)? - at(-h)?) / (2.0 * h);
        }
    }
    Some((value, gradient))
}
