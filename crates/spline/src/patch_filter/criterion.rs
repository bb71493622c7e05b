//! Criteria for the subdivision of a patch: variation of curvature, and large innovations.
//!
//! Input: Gaussian curvatures of a patch with their σ, and the squared normalised innovations of its readings
//! by cell. Output: a [`SubdivisionReason`] or `None`.
//!
//! Curvature: `sd(K) / max(|K̄|, σ_K) > limit`, with K at the centres of the sixteen cells. (Eq. 13 of the
//! paper divides a variance by a mean: it has units and is infinite at `K̄ = 0`.) By default the mean of σ_K²
//! is subtracted from `sd(K)²`. Second derivatives are much less accurate than positions, and a variation
//! within their σ does not justify finer patches.
//!
//! Readings: a 2 × 2 block of cells is the smallest support of a finer function. Over each block, the sum of
//! squared normalised innovations is χ² with one degree of freedom per reading. The criterion is met if the
//! sum is too large by the given number of standard deviations (Wilson–Hilferty).
//!
//! Not guaranteed: detection of weak detail by curvature before it is well measured. The criterion of
//! readings detects it with enough data.
//!
//! # References
//! Wang, Wang 1994, eq. 11–13; Wilson, Hilferty, *The distribution of chi-square*, PNAS 1931.

use crate::surface::Jet;
use planish_core::DVec3;
use planish_core::vector3::coordinates;
use planish_estimate::chi_square_deviation;

/// Criteria for subdivision; `None` disables a criterion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SubdivisionCriteria {
    /// Maximum `sd(K) / max(|K̄|, σ_K)` of a patch that is not subdivided.
    pub curvature_variation: Option<f64>,
    /// If true, the variation explained by σ_K is subtracted first.
    pub discount_noise: bool,
    /// Maximum excess of the innovations of a 2 × 2 block, in standard deviations.
    pub chi_square: Option<f64>,
    /// Minimum number of scalar readings of a block, and of a patch.
    pub min_readings: u64,
    /// Maximum number of patches, apart from those required by grading.
    pub max_patches: usize,
}

impl Default for SubdivisionCriteria {
    /// A curvature variation of 0.5 (the limit of the paper) with noise subtracted, and a χ² excess of 3
    /// standard deviations with at least 24 scalar readings.
    fn default() -> Self {
        Self {
            curvature_variation: Some(0.5),
            discount_noise: true,
            chi_square: Some(3.0),
            min_readings: 24,
            max_patches: usize::MAX,
        }
    }
}

/// Why a patch was subdivided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SubdivisionReason {
    /// `sd(K) / max(|K̄|, σ_K)` was this large.
    CurvatureVariation(f64),
    /// Innovations were too large by this many standard deviations.
    ChiSquare(f64),
    /// A neighbour was subdivided: neighbouring cells differ by at most one level.
    Grading,
    /// The caller requested it.
    Requested,
}

impl SubdivisionReason {
    /// Order of reasons: readings come before curvature.
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
    /// Number of scalar readings.
    pub count: u64,
    /// `Σ e²/S`
    pub normalized_squared: f64,
    /// Number of scalar readings beyond the gate, not included in the other two.
    pub far: u64,
}

/// Maximum fraction of readings beyond the gate that are treated as outliers. More of them indicate shape
/// that the patch cannot represent.
///
/// A lower value subdivides patches at outliers; a higher one rejects good readings of small features (test
/// `outliers_are_rejected_and_shape_is_not`).
const MAX_OUTLIER_FRACTION: f64 = 0.25;
/// Minimum number of readings beyond the gate that indicate shape. A single outlier among the first few
/// readings of a cell would exceed the fraction above.
const MIN_FAR: u64 = 6;
/// Contribution of a reading beyond the gate to a sum of squares, the square of 4 standard deviations (the
/// usual gate). The actual squares are unbounded, so a few gross errors would dominate the sum.
const FAR_SQUARED: f64 = 16.0;

impl InnovationSum {
    /// True if enough readings are beyond the gate to indicate shape.
    pub(super) fn far_is_shape(&self) -> bool {
        self.far >= MIN_FAR && self.far as f64 > MAX_OUTLIER_FRACTION * (self.count + self.far) as f64
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
    /// Applies the criteria. `curvatures` returns value and σ at the centre of each cell, or `None` if the
    /// surface is singular.
    pub(super) fn reason(
        &self,
        innovations: &[InnovationSum; 16],
        curvatures: impl FnOnce() -> Option<[[f64; 2]; 16]>,
    ) -> Option<SubdivisionReason> {
        if innovations.iter().map(|s| s.count + s.far).sum::<u64>() < self.min_readings {
            return None;
        }
        if let Some(limit) = self.chi_square {
            let worst = worst_block(innovations, self.min_readings);
            if worst > limit {
                return Some(SubdivisionReason::ChiSquare(worst));
            }
        }
        // Curvatures come last: with their σ they cost far more than the sums of innovations.
        let variation = curvature_variation(&curvatures()?, self.discount_noise);
        (variation > self.curvature_variation?).then_some(SubdivisionReason::CurvatureVariation(variation))
    }
}

/// `sd(K) / max(|K̄|, σ_K)` of Gaussian curvatures `[K, σ]`, with σ_K the root mean square of the σ. If
/// `discount_noise`, σ_K² is subtracted from `sd(K)²`. It is 0 for fewer than two curvatures.
///
/// # Examples
/// ```
/// use planish_spline::curvature_variation;
///
/// // K = 1 and 3 with a negligible σ: standard deviation over mean.
/// let variation = curvature_variation(&[[1.0, 1e-9], [3.0, 1e-9]], true);
/// assert!(variation > 0.5);
/// assert_eq!(curvature_variation(&[[1.0, 5.0], [3.0, 5.0]], true), 0.0); // within σ
/// ```
#[must_use]
pub fn curvature_variation(curvatures: &[[f64; 2]], discount_noise: bool) -> f64 {
    let n = curvatures.len() as f64;
    if n < 2.0 {
        return 0.0;
    }
    let mean = curvatures.iter().map(|[k, _]| k).sum::<f64>() / n;
    let variance = curvatures.iter().map(|[k, _]| (k - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let sigma2 = curvatures.iter().map(|[_, s]| s * s).sum::<f64>() / n;
    // On flat regions the mean is noise, and a ratio to it would be arbitrary.
    let scale = mean.abs().max(sigma2.sqrt());
    let beyond = if discount_noise { variance - sigma2 } else { variance };
    if beyond > 0.0 { beyond.sqrt() / scale } else { 0.0 }
}

/// Largest excess of the innovations of a 2 × 2 block, in standard deviations.
fn worst_block(innovations: &[InnovationSum; 16], min_readings: u64) -> f64 {
    let mut worst = f64::NEG_INFINITY;
    for row in 0..3 {
        for column in 0..3 {
            // Overlapping blocks of 2 × 2 cells: a misfit on a border between cells is still in one block.
            let block = [0, 1, 4, 5].map(|k| innovations[4 * row + column + k]);
            let all = block.iter().fold(InnovationSum::default(), InnovationSum::with);
            let far = if all.far_is_shape() { all.far } else { 0 };
            if all.count + far < min_readings.max(1) {
                continue;
            }
            let n = (all.count + far) as f64;
            // Rejected readings have no innovation; they count with the square at the gate.
            let sum = all.normalized_squared + FAR_SQUARED * far as f64;
            worst = worst.max(chi_square_deviation(sum / n, n));
        }
    }
    worst
}

/// Gaussian curvature and its gradient with respect to the five derivatives of a jet (`u, v, uu, uv, vv`);
/// `None` if the surface is singular.
pub(super) fn gaussian_curvature(jet: &Jet) -> Option<(f64, [DVec3; 5])> {
    let value = jet.curvature()?.gaussian();
    let mut gradient = [DVec3::ZERO; 5];
    let largest =
        |start, vectors: &[DVec3]| coordinates(vectors).iter().fold(start, |m: f64, x| m.max(x.abs()));
    let first = largest(0.0, &[jet.du, jet.dv]);
    // A flat surface has no second derivatives from which a step could be derived.
    let second = largest(1e-3 * first, &[jet.duu, jet.duv, jet.dvv]);
    for (which, by) in gradient.iter_mut().enumerate() {
        // Near the cube root of the rounding unit, the best relative step of a central difference.
        let h = 1e-5 * if which < 2 { first } else { second };
        for d in 0..3 {
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
            by[d] = (at(h)? - at(-h)?) / (2.0 * h);
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
            du: DVec3::X,
            dv: DVec3::Y,
            duu: DVec3::new(0.0, 0.0, -1.0 / r),
            dvv: DVec3::new(0.0, 0.0, -1.0 / r),
            ..Jet::default()
        };
        let (value, gradient) = gaussian_curvature(&jet).expect("a regular jet");
        assert!((value - 0.25).abs() < 1e-12);
        // K = (S_uu·n)(S_vv·n) / (EG): by S_uu,z it is S_vv,z; by S_u,x it is −2 K.
        assert!((gradient[2][2] + 0.5).abs() < 1e-6 && (gradient[0][0] + 0.5).abs() < 1e-6, "{gradient:?}");
    }
}
