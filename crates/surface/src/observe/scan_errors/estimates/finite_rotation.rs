//! The covariance of a pose whose rotation is not small.
//!
//! Input: the covariance of translation and rotation vector from linearised equations. Output: the same with
//! the second-order effect of the rotation on the translation. Not guaranteed: rotations beyond about half a
//! radian, whose higher orders matter. Such directions are reported as undetermined.

use nalgebra::{Matrix3, Vector3};

/// Relative size of an eigenvalue that counts as zero, for rotations about one axis.
const RANK: f64 = 1e-9;

/// Adds the second moment of the quadratic part of the translation's error.
///
/// A scan of a nearly round object turns about a point that the readings determine well, its pivot. The
/// origin of the scanner lies at an arm `a` from the pivot and moves along a circle when the scan turns
/// by `ω`:
///
/// ```text
/// δt = τ + ω × a + q        q = −½ ω × (ω × a) = ½ (|ω|² a − ω (ω·a))
/// ```
///
/// With an arm of 100 mm and a rotation of 2°, `q` is 0.06 mm; the readings may determine `τ` to 0.001 mm.
/// For Gaussian `ω` with covariance `W` and `s = tr W`, Isserlis' theorem gives
///
/// ```text
/// 4 E[q qᵀ] = a aᵀ (s² + 2 tr W²) − a uᵀ − u aᵀ + W (aᵀWa) + 2 (Wa)(Wa)ᵀ        u = s Wa + 2 W²a
/// ```
///
/// Odd moments vanish, so `q` is uncorrelated with `τ` and `ω`. The pivot minimises the trace of the
/// covariance of its translation: `a = (s I − W)⁻¹ E[δt × ω]`.
///
/// # References
/// Isserlis, *On a formula for the product-moment coefficient of any order of a normal frequency
/// distribution*, Biometrika 1918.
pub(super) fn add_finite_rotation(covariance: &mut [[f64; 6]; 6]) {
    let rotation = Matrix3::from_fn(|i, k| covariance[3 + i][3 + k]);
    let total = rotation.trace();
    if total <= 0.0 {
        return;
    }
    // E[δt × ω], from the block of translation and rotation.
    let cross = Vector3::from_fn(|i, _| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        covariance[j][3 + k] - covariance[k][3 + j]
    });
    // Rotations about a single axis leave the place of the pivot along it open.
    let metric = Matrix3::identity() * total - rotation;
    let Ok(inverse) = metric.pseudo_inverse(RANK * total) else { return };
    let arm = inverse * cross;
    let turned = rotation * arm;
    let mixed = total * turned + 2.0 * rotation * turned;
    let fourth = total * total + 2.0 * (rotation * rotation).trace();
    let sum = arm * arm.transpose() * fourth - arm * mixed.transpose() - mixed * arm.transpose()
        + rotation * arm.dot(&turned)
        + 2.0 * turned * turned.transpose();
    for (i, row) in covariance.iter_mut().take(3).enumerate() {
        for (k, entry) in row.iter_mut().take(3).enumerate() {
            *entry += 0.25 * sum[(i, k)];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix6, Rotation3, SVector};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const DRAWS: usize = 4000;

    #[test]
    fn a_scan_that_turns_about_a_pivot_has_calibrated_covariance() {
        // σ of the pivot is 0.001, of the rotation 0.06, 0.03 and 0.005 rad about the axes; the arm is 100.
        let arm = Vector3::new(60.0, -64.0, 48.0);
        let [still, turns] = [Vector3::repeat(0.001), Vector3::new(0.06, 0.03, 0.005)];
        // δt = τ + ω × a, so the derivative by ω is −[a]ₓ.
        let mut root = Matrix6::zeros();
        root.fixed_view_mut::<3, 3>(0, 0).set_diagonal(&still);
        root.fixed_view_mut::<3, 3>(3, 3).set_diagonal(&turns);
        let by_rotation = -arm.cross_matrix() * Matrix3::from_diagonal(&turns);
        root.fixed_view_mut::<3, 3>(0, 3).copy_from(&by_rotation);
        let linear = root * root.transpose();
        let mut enlarged: [[f64; 6]; 6] = std::array::from_fn(|a| std::array::from_fn(|b| linear[(a, b)]));
        add_finite_rotation(&mut enlarged);
        let covariances = [linear, Matrix6::from_fn(|a, b| enlarged[a][b])];
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut means = [0.0; 2];
        for _ in 0..DRAWS {
            let z: [f64; 6] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
            let tau = still.component_mul(&Vector3::new(z[0], z[1], z[2]));
            let omega = turns.component_mul(&Vector3::new(z[3], z[4], z[5]));
            // The true pose is the estimate turned back.
            let t = tau + arm - Rotation3::new(-omega) * arm;
            let e = SVector::<f64, 6>::from_column_slice(&[t[0], t[1], t[2], omega[0], omega[1], omega[2]]);
            for (mean, covariance) in means.iter_mut().zip(&covariances) {
                *mean += e.dot(&covariance.lu().solve(&e).unwrap()) / DRAWS as f64;
            }
        }
        // The linear covariance alone is wrong by orders of magnitude.
        assert!(means[0] > 1000.0 && (5.0..7.5).contains(&means[1]), "{means:?}");
    }

    #[test]
    fn nothing_is_added_where_it_does_not_belong() {
        let mut covariance: [[f64; 6]; 6] =
            std::array::from_fn(|a| std::array::from_fn(|b| if a == b { 0.01 } else { 0.0 }));
        let before = covariance;
        // The scanner is at the pivot.
        add_finite_rotation(&mut covariance);
        assert_eq!(covariance, before);
        // The rotation is exact.
        covariance[3..].fill([0.0; 6]);
        let before = covariance;
        add_finite_rotation(&mut covariance);
        assert_eq!(covariance, before);
    }
}
