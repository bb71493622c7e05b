//! Bias from curvature: the mean of a signed distance is not zero, and is correlated with its row.

use super::{ImplicitReading, MAX_NOISE, MAX_STATE, Normalized};
use std::f64::consts::FRAC_PI_2;

/// Spacing of numerical differences, in standard deviations.
///
/// A smaller one loses digits to rounding, a larger one averages over curvature; the noise itself is 1.
const SPACING: f64 = 0.05;
/// Curvature (per standard deviation) below which the second order is accurate to 2e-4 standard deviations.
const SECOND_ORDER_CURVATURE: f64 = 0.1;
/// Distance along the most curved direction over which changes of curvature are measured, in standard
/// deviations. It is of the order of the noise, which is 1.
const REACH: f64 = 1.2;
/// Argument that separates two expansions of the modified Bessel functions of orders 0 and 1 (Abramowitz and
/// Stegun 1964, 9.8.1 to 9.8.4): `I₀` and `I₁/z` in `(z/3.75)²`, and `√z e^{−z} I` in `3.75/z`.
const BESSEL_SPLIT: f64 = 3.75;
const BESSEL_NEAR: [[f64; 7]; 2] = [
    [1.0, 3.515_622_9, 3.089_942_4, 1.206_749_2, 0.265_973_2, 0.036_076_8, 0.004_581_3],
    [0.5, 0.878_905_94, 0.514_988_69, 0.150_849_34, 0.026_587_33, 0.003_015_32, 0.000_324_11],
];
const BESSEL_FAR: [[f64; 9]; 2] = [
    [
        0.398_942_28,
        0.013_285_92,
        0.002_253_19,
        -0.001_575_65,
        0.009_162_81,
        -0.020_577_06,
        0.026_355_37,
        -0.016_476_33,
        0.003_923_77,
    ],
    [
        0.398_942_28,
        -0.039_880_24,
        -0.003_620_18,
        0.001_638_01,
        -0.010_315_55,
        0.022_829_67,
        -0.028_953_12,
        0.017_876_54,
        -0.004_200_59,
    ],
];

/// Second derivatives with respect to the noise.
pub type NoiseHessian = [[f64; MAX_NOISE]; MAX_NOISE];

/// Bias of the score `hᵀ s` of a reading: returns `b` and fills `c`, so that `hᵀ (s − b) − c` has zero mean
/// to fourth order in the noise.
///
/// The equation is a hypersurface in whitened noise. A reading is a standard normal step from its true point
/// on it, and the foot point `u` is the only estimate of that point. With the second fundamental form
/// `K = T g_uu T / |g_u|` (`T` the projector on the tangents), `κ` the curvature of the most curved
/// direction, primes derivatives along it, and `R(κ) = ½κ + ⅛κ³ + …` the mean distance to a circle of that
/// curvature (Rice):
///
/// ```text
/// b = −R(κ) − ½ (tr K − κ) + ⅛ κ''
/// c = ½ (κ h')'
/// ```
///
/// Both follow from `E F = F + ½ ΔF + ⅛ Δ²F` for functions of a standard normal step. At the true point the
/// mean of `s` contains `−⅛ κ''`. The remaining `¼ κ''`, and `c`, correct for evaluating `K` and `h` at a
/// foot point that is uncertain by one standard deviation. `at` is the linearisation at `u`. The bias is zero
/// if the reading has a second-order variance.
///
/// Cost: one set of second derivatives; if `|K|` exceeds 0.1, also two gradients and two more sets. Assumes
/// that curvature changes little within a standard deviation. About 5 % of `b` remain if the noise is half of
/// the radius of curvature.
///
/// # References
/// Kanatani 1998, *Cramér–Rao lower bounds for curve fitting*; Okatani and Kanatani 2009, *On bias correction
/// for geometric parameter estimation in computer vision*; Al-Sharadqah and Chernov 2009, *Error analysis for
/// circle fitting algorithms* (the essential bias σ²/2R); Rice 1944, *Mathematical analysis of random noise*.
pub fn curvature_bias<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    u: &[f64],
    at: &Normalized,
    row_bias: &mut [f64],
) -> f64 {
    let (n, p) = (x.len(), u.len());
    row_bias.fill(0.0);
    // A single noise component leaves no tangent along which an equation could be curved.
    if p < 2 || reading.second_order_variance(branch, x, u) > 0.0 {
        return 0.0;
    }
    let form = second_form(reading, branch, x, u, at);
    let total: f64 = (0..p).map(|k| form[k][k]).sum();
    let square: f64 = form[..p].iter().flat_map(|row| &row[..p]).map(|f| f * f).sum();
    // Most readings end here, before the costly derivatives of curvature.
    if square < SECOND_ORDER_CURVATURE * SECOND_ORDER_CURVATURE {
        return -0.5 * total;
    }
    let (curvature, along) = principal(&form, p);
    // Only the most curved direction gets the full series. The others enter to second order, which suffices
    // where they are flatter.
    let rest = total - curvature;
    let mut sides = [0.0; 2];
    let mut nodes = [Normalized::new(), Normalized::new()];
    for ((side, node), sign) in sides.iter_mut().zip(&mut nodes).zip([1.0, -1.0]) {
        // Step along the osculating circle, because a straight step leaves the surface.
        let turn = sign * REACH * curvature;
        let (sin, cos) = turn.sin_cos();
        let (forth, down) = (sin / curvature, (1.0 - cos) / curvature);
        let mut place = [0.0; MAX_NOISE];
        for k in 0..p {
            place[k] = u[k] + forth * along[k] - down * at.normal[k];
        }
        if !node.at(reading, branch, x, &place[..p], u) {
            return -rice(curvature) - 0.5 * rest;
        }
        let form = second_form(reading, branch, x, &place[..p], node);
        // The trace changes with the main curvature alone if the other curvatures stay. This needs no second
        // eigenvector.
        *side = (0..p).map(|k| form[k][k]).sum::<f64>() - rest;
    }
    let squared = REACH * REACH;
    // The series is meaningless if the change exceeds twice the curvature itself.
    let change = ((sides[0] - 2.0 * curvature + sides[1]) / squared)
        .clamp(-2.0 * curvature.abs(), 2.0 * curvature.abs());
    let (ahead, behind) = (0.5 * (curvature + sides[0]), 0.5 * (curvature + sides[1]));
    for k in 0..n {
        let (middle, ahead_row, behind_row) = (at.row[k], nodes[0].row[k], nodes[1].row[k]);
        row_bias[k] = 0.5 * (ahead * (ahead_row - middle) - behind * (middle - behind_row)) / squared;
    }
    -rice(curvature) - 0.5 * rest + 0.125 * change
}

/// `T g_uu T / |g_u|`.
pub(super) fn second_form<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    u: &[f64],
    at: &Normalized,
) -> NoiseHessian {
    let p = u.len();
    let mut hessian = [[0.0; MAX_NOISE]; MAX_NOISE];
    if !reading.noise_hessian(branch, x, u, &mut hessian) {
        differences(reading, branch, x, u, &mut hessian);
    }
    // `T g_uu T` with `T = I − n nᵀ`, multiplied out: one product with the normal instead of two matrix
    // products.
    let normal = &at.normal;
    let mut image = [0.0; MAX_NOISE];
    let mut twice = 0.0;
    for i in 0..p {
        image[i] = (0..p).map(|j| hessian[i][j] * normal[j]).sum();
        twice += image[i] * normal[i];
    }
    let scale = 1.0 / at.slope;
    for i in 0..p {
        for j in 0..p {
            let tangent =
                hessian[i][j] - normal[i] * image[j] - image[i] * normal[j] + twice * normal[i] * normal[j];
            hessian[i][j] = scale * tangent;
        }
    }
    hessian
}

fn differences<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    u: &[f64],
    hessian: &mut NoiseHessian,
) {
    let (n, p) = (x.len(), u.len());
    let mut by_state = [0.0; MAX_STATE];
    let mut place = [0.0; MAX_NOISE];
    place[..p].copy_from_slice(u);
    for j in 0..p {
        let mut sides = [[0.0; MAX_NOISE]; 2];
        for (side, sign) in sides.iter_mut().zip([1.0, -1.0]) {
            place[j] = u[j] + sign * SPACING;
            reading.gradient(branch, x, &place[..p], &mut by_state[..n], &mut side[..p]);
        }
        place[j] = u[j];
        for i in 0..p {
            hessian[i][j] = (sides[0][i] - sides[1][i]) / (2.0 * SPACING);
        }
    }
}

/// The eigenvalue of largest magnitude and its eigenvector.
///
/// Repeated squaring gives a projector on the dominant eigenvectors. Its longest column has a part along one
/// of them, whereas an iteration from a fixed vector may start, and stay, orthogonal to it.
fn principal(form: &NoiseHessian, p: usize) -> (f64, [f64; MAX_NOISE]) {
    /// The power 2¹⁰ suppresses an eigenvalue that is 1 % smaller to 3e-5.
    const SQUARINGS: usize = 10;
    let mut power = *form;
    for _ in 0..SQUARINGS {
        let largest = power[..p].iter().flat_map(|row| &row[..p]).fold(0.0_f64, |m, f| m.max(f.abs()));
        if largest == 0.0 {
            break;
        }
        let scaled = power.map(|row| row.map(|f| f / largest));
        for (i, row) in power[..p].iter_mut().enumerate() {
            for (j, entry) in row[..p].iter_mut().enumerate() {
                // The matrix is symmetric, so its rows serve as columns.
                *entry = (0..p).map(|k| scaled[i][k] * scaled[j][k]).sum();
            }
        }
    }
    // The diagonal of a projector has the squared lengths of its columns.
    let longest = (0..p).max_by(|&a, &b| power[a][a].total_cmp(&power[b][b])).unwrap_or(0);
    let length = power[longest][..p].iter().map(|c| c * c).sum::<f64>().sqrt();
    let mut vector = [0.0; MAX_NOISE];
    for (to, from) in vector[..p].iter_mut().zip(&power[longest]) {
        *to = from / length;
    }
    let value = (0..p).map(|i| vector[i] * (0..p).map(|j| form[i][j] * vector[j]).sum::<f64>()).sum();
    (value, vector)
}

/// `E |(r + n, t)| − r` with `r = 1/κ` and standard normal `n`, `t`: the mean distance to a circle, odd in
/// `κ`. Rice: `√(π/2) L(−r²/2) − r` with `L(−2z) = e^{−z} ((1 + 2z) I₀(z) + 2z I₁(z))`.
fn rice(curvature: f64) -> f64 {
    let squared = curvature * curvature;
    // The closed form subtracts the radius from a mean that is hardly larger. Cancellation would amplify the
    // error of the Bessel functions, which are accurate to seven digits only.
    if squared < 0.04 {
        return curvature * (0.5 + squared * (0.125 + 0.1875 * squared));
    }
    let radius = 1.0 / curvature.abs();
    let z = 0.25 * radius * radius;
    let [i0, i1] = scaled_bessel(z);
    let mean = FRAC_PI_2.sqrt() * ((1.0 + 2.0 * z) * i0 + 2.0 * z * i1);
    (mean - radius) * curvature.signum()
}

/// `e^{−z} I₀(z)` and `e^{−z} I₁(z)` for `z ≥ 0`, to 2e-7 of their size (Abramowitz and Stegun 1964, 9.8.1 to
/// 9.8.4).
fn scaled_bessel(z: f64) -> [f64; 2] {
    let polynomial = |t: f64, factors: &[f64]| factors.iter().rev().fold(0.0, |sum, f| sum * t + f);
    if z < BESSEL_SPLIT {
        let (t, scale) = ((z / BESSEL_SPLIT).powi(2), (-z).exp());
        [scale * polynomial(t, &BESSEL_NEAR[0]), scale * z * polynomial(t, &BESSEL_NEAR[1])]
    } else {
        BESSEL_FAR.map(|factors| polynomial(BESSEL_SPLIT / z, &factors) / z.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_curved_direction_may_be_orthogonal_to_the_longest_row() {
        // Eigenvalues 1 along (1, 1, 0), −0.8 along z: the row of z is the longest.
        let mut form = [[0.0; MAX_NOISE]; MAX_NOISE];
        form[0][..2].copy_from_slice(&[0.5, 0.5]);
        form[1][..2].copy_from_slice(&[0.5, 0.5]);
        form[2][2] = -0.8;
        let (value, vector) = principal(&form, 3);
        assert!((value - 1.0).abs() < 1e-12, "{value}");
        assert!(vector[2].abs() < 1e-12 && (vector[0] * vector[1] - 0.5).abs() < 1e-12, "{vector:?}");
        // The sign of the eigenvalue stays.
        form[2][2] = -1.2;
        assert!((principal(&form, 3).0 + 1.2).abs() < 1e-12);
    }
}
