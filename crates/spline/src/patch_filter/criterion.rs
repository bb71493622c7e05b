//! When a patch is divided: where its curvature varies, or where its readings surprise it.
//!
//! Comes in: Gaussian curvatures of a patch with their σ, and the squared normalised innovations of its
//! readings by cell. Goes out: a [`SubdivisionReason`] or none.
//!
//! Curvature: `sd(K) / max(|K̄|, σ_K) > limit`, K taken at the middles of the sixteen cells (the paper's eq.
//! 13 divides a variance by a mean: it has units and blows up at `K̄ = 0`). From `sd(K)²` the mean of σ_K² is
//! taken off, unless that is switched off: curvature of second derivatives is badly known long after
//! positions are well known, and what varies within its σ asks for no finer patches. Readings: over each 2 ×
//! 2 block of cells, the least on which a finer function lives, the sum of squared normalised innovations is
//! χ² with one degree of freedom each; the block speaks when the sum is that many standard deviations too
//! large (Wilson–Hilferty).
//!
//! Not guaranteed: that weak detail is found by its curvature before it is well measured; the readings'
//! criterion finds it by numbers.
//!
//! # References
//! Wang, Wang 1994, eq. 11–13; Wilson, Hilferty, *The distribution of chi-square*, PNAS 1931.

use crate::surface::Jet;

/// When to divide a patch; a criterion that is none is not asked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SubdivisionCriteria {
    /// The most `sd(K) / max(|K̄|, σ_K)` of a patch that is left whole.
    pub curvature_variation: Option<f64>,
    /// Whether the variation that σ_K explains is taken off first.
    pub discount_noise: bool,
    /// How many standard deviations the innovations of a 2 × 2 block may be too large.
    pub chi_square: Option<f64>,
    /// Scalar readings that a block, and a patch, needs before it is judged.
    pub least_readings: u64,
    /// No more patches than this, but for what grading asks for.
    pub most_patches: usize,
}

impl Default for SubdivisionCriteria {
    /// The paper's limit of 0.5 beside a χ² of 3 standard deviations, on 24 scalar readings or more; noise is
    /// discounted.
    fn default() -> Self {
        Self {
            curvature_variation: Some(0.5),
            discount_noise: true,
            chi_square: Some(3.0),
            least_readings: 24,
            most_patches: usize::MAX,
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

impl SubdivisionReason {
    /// Which of two reasons is the stronger: readings speak before curvature.
    pub(super) fn strength(self) -> (u8, f64) {
        match self {
            Self::Requested => (3, 0.0),
            Self::ChiSquare(x) => (2, x),
            Self::CurvatureVariation(x) => (1, x),
            Self::Grading => (0, 0.0),
        }
    }
}

/// Squared normalised innovations of one cell.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct InnovationSum {
    /// Scalar readings.
    pub count: u64,
    /// `Σ e²/S`
    pub normalized_squared: f64,
    /// Scalar readings beyond the gate, which the other two leave out.
    pub far: u64,
}

/// Readings beyond the gate are gross errors where they are fewer than this share, and shape that the patch
/// does not have where they are more.
const MOST_GROSS: f64 = 0.25;
/// Fewer far readings are no shape.
const LEAST_FAR: u64 = 6;
/// What a far reading adds to a sum of squares.
const FAR_SQUARED: f64 = 16.0;

impl InnovationSum {
    /// Whether so many of the readings are far that they are shape.
    pub(super) fn far_is_shape(&self) -> bool {
        self.far >= LEAST_FAR && self.far as f64 > MOST_GROSS * (self.count + self.far) as f64
    }

    fn with(self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            normalized_squared: self.normalized_squared + other.normalized_squared,
            far: self.far + other.far,
        }
    }
}

impl SubdivisionCriteria {
    /// `curvatures`: value and σ at the middle of each cell, none where the surface is singular.
    pub(super) fn reason(
        &self,
        innovations: &[InnovationSum; 16],
        curvatures: impl FnOnce() -> Option<[[f64; 2]; 16]>,
    ) -> Option<SubdivisionReason> {
        if innovations.iter().map(|s| s.count + s.far).sum::<u64>() < self.least_readings {
            return None;
        }
        if let Some(limit) = self.chi_square {
            let worst = worst_block(innovations, self.least_readings);
            if worst > limit {
                return Some(SubdivisionReason::ChiSquare(worst));
            }
        }
        let variation = curvature_variation(&curvatures()?, self.discount_noise);
        (variation > self.curvature_variation?).then_some(SubdivisionReason::CurvatureVariation(variation))
    }
}

/// `sd(K) / max(|K̄|, σ_K)` of Gaussian curvatures `[K, σ]`, σ_K the root mean square of the σ; of `sd(K)`
/// what is beyond σ_K where noise is discounted. Of fewer than two it is 0.
#[must_use]
pub fn curvature_variation(curvatures: &[[f64; 2]], discount_noise: bool) -> f64 {
    let n = curvatures.len() as f64;
    if n < 2.0 {
        return 0.0;
    }
    let mean = curvatures.iter().map(|[k, _]| k).sum::<f64>() / n;
    let variance = curvatures.iter().map(|[k, _]| (k - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let sigma2 = curvatures.iter().map(|[_, s]| s * s).sum::<f64>() / n;
    let scale = mean.abs().max(sigma2.sqrt());
    let beyond = if discount_noise { variance - sigma2 } else { variance };
    if beyond > 0.0 { beyond.sqrt() / scale } else { 0.0 }
}

/// By how many standard deviations the innovations of the worst 2 × 2 block are too large.
fn worst_block(innovations: &[InnovationSum; 16], least: u64) -> f64 {
    let mut worst = f64::NEG_INFINITY;
    for row in 0..3 {
        for column in 0..3 {
            let block = [0, 1, 4, 5].map(|k| innovations[4 * row + column + k]);
            let all = block.iter().fold(InnovationSum::default(), InnovationSum::with);
            let far = if all.far_is_shape() { all.far } else { 0 };
            if all.count + far < least.max(1) {
                continue;
            }
            let n = (all.count + far) as f64;
            let sum = all.normalized_squared + FAR_SQUARED * far as f64;
            let spread = 2.0 / (9.0 * n);
            worst = worst.max(((sum / n).cbrt() - 1.0 + spread) / spread.sqrt());
        }
    }
    worst
}

/// Gaussian curvature and its gradient by the five derivatives of a jet (`u, v, uu, uv, vv`); none where the
/// surface is singular.
pub(super) fn gaussian_curvature(jet: &Jet) -> Option<(f64, [[f64; 3]; 5])> {
    let value = jet.curvature()?.gaussian();
    let mut gradient = [[0.0; 3]; 5];
    let first = jet.du.iter().chain(&jet.dv).fold(0.0_f64, |m, x| m.max(x.abs()));
    let second = jet.duu.iter().chain(&jet.duv).chain(&jet.dvv).fold(1e-3 * first, |m, x| m.max(x.abs()));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variation_has_no_unit_and_survives_a_mean_of_zero() {
        let waves = |scale: f64, sigma: f64| -> [[f64; 2]; 16] {
            std::array::from_fn(|k| [scale * (k as f64 - 7.5), scale * sigma])
        };
        let one = curvature_variation(&waves(1.0, 2.0), false);
        assert!(
            (curvature_variation(&waves(1e-6, 2.0), false) / one - 1.0).abs() < 1e-12,
            "metres or millimetres"
        );
        assert!((one - (22.666_666_666_666_668_f64).sqrt() / 2.0).abs() < 1e-12);
        assert!(curvature_variation(&waves(1.0, 2.0), true) < one);
        assert_eq!(curvature_variation(&waves(1.0, 5.0), true), 0.0, "all within its σ");
        assert!(curvature_variation(&[[0.3, 0.0]; 16], false) < 1e-12);
    }

    #[test]
    fn gradients_of_curvature_agree_with_a_sphere_that_grows() {
        // K = 1/r² on the graph of a sphere: at its top du = (1,0,0), dv = (0,1,0), duu = dvv = (0,0,−1/r).
        let r = 2.0;
        let jet = Jet {
            du: [1.0, 0.0, 0.0],
            dv: [0.0, 1.0, 0.0],
            duu: [0.0, 0.0, -1.0 / r],
            dvv: [0.0, 0.0, -1.0 / r],
            ..Jet::default()
        };
        let (value, gradient) = gaussian_curvature(&jet).expect("a regular jet");
        assert!((value - 0.25).abs() < 1e-12);
        // K = (S_uu·n)(S_vv·n) / (EG): by S_uu,z it is S_vv,z; by S_u,x it is −2 K.
        assert!((gradient[2][2] + 0.5).abs() < 1e-6 && (gradient[0][0] + 0.5).abs() < 1e-6, "{gradient:?}");
    }
}
