//! What curvature makes of noise: the mean of a signed distance is not zero.

use super::{ImplicitReading, MOST_NOISE, MOST_STATE, Normalized, signed_distance};

/// Spacing of differences, in standard deviations: the noise itself is one.
const SPACING: f64 = 0.05;
/// Below this curvature (one over standard deviations) the second order is all there is, to 5e-4 standard deviations.
const BENT: f64 = 0.15;

/// The mean of the signed distance of a reading whose true noise is at `u`, a foot on the equation: `E[s]`.
///
/// The equation is a hypersurface in whitened noise; a reading is a standard normal step away from it. To second order the
/// mean is `−½ tr(T g_uu) / |g_u|` with `T` the projector on the tangents: half the sum of the principal curvatures. The
/// largest of them is treated beyond it, by a product of Gauss–Hermite rules, of three nodes over the normal and five over its
/// direction, with the foot of each node searched: with noise of half the radius of curvature the second order alone errs by
/// 8 %, this by 5 %. `at` is the linearisation at the foot. Assumes that curvature changes little within a standard deviation.
///
/// Cost: `2 (p − 1)` gradients, and some 40 more where a curvature exceeds 0.15.
///
/// # References
/// Kanatani 1998, *Cramér–Rao lower bounds for curve fitting*; Okatani and Kanatani 2009, *On bias correction for geometric
/// parameter estimation in computer vision*; Al-Sharadqah and Chernov 2009, *Error analysis for circle fitting algorithms*
/// (the essential bias σ²/2R).
pub fn curvature_bias<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    u: &[f64],
    at: &Normalized,
) -> f64 {
    let p = u.len();
    if p < 2 || reading.second_order_variance(branch, x, u) > 0.0 {
        return 0.0;
    }
    let (shape, basis) = shape_operator(reading, branch, x, u, at);
    let tangents = p - 1;
    let total: f64 = (0..tangents).map(|i| shape[i][i]).sum();
    let (curvature, direction) = principal(&shape, tangents);
    if curvature.abs() < BENT {
        return -0.5 * total;
    }
    let mut along = [0.0; MOST_NOISE];
    for i in 0..tangents {
        for k in 0..p {
            along[k] += direction[i] * basis[i][k];
        }
    }
    match mean_over_plane(reading, branch, x, u, at, &along) {
        Some(mean) => mean - 0.5 * (total - curvature),
        None => -0.5 * total,
    }
}

type Tangents = [[f64; MOST_NOISE]; MOST_NOISE];

/// `t_iᵀ g_uu t_j / |g_u|` on a basis of the tangents, and that basis.
fn shape_operator<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    u: &[f64],
    at: &Normalized,
) -> (Tangents, Tangents) {
    let (n, p) = (x.len(), u.len());
    // Householder: the reflection that takes the normal to ±e₀ has the tangents as its other rows.
    let mut mirror = [0.0; MOST_NOISE];
    mirror[..p].copy_from_slice(&at.normal[..p]);
    mirror[0] += if mirror[0] >= 0.0 { 1.0 } else { -1.0 };
    let square: f64 = mirror[..p].iter().map(|m| m * m).sum();
    let mut basis = [[0.0; MOST_NOISE]; MOST_NOISE];
    for i in 1..p {
        for k in 0..p {
            basis[i - 1][k] = f64::from(i == k) - 2.0 * mirror[i] * mirror[k] / square;
        }
    }
    let mut shape = [[0.0; MOST_NOISE]; MOST_NOISE];
    let mut by_state = [0.0; MOST_STATE];
    let (mut up, mut down) = ([0.0; MOST_NOISE], [0.0; MOST_NOISE]);
    for j in 0..p - 1 {
        let mut place = [0.0; MOST_NOISE];
        for k in 0..p {
            place[k] = u[k] + SPACING * basis[j][k];
        }
        reading.gradient(branch, x, &place[..p], &mut by_state[..n], &mut up[..p]);
        for k in 0..p {
            place[k] = u[k] - SPACING * basis[j][k];
        }
        reading.gradient(branch, x, &place[..p], &mut by_state[..n], &mut down[..p]);
        for i in 0..p - 1 {
            let difference: f64 = (0..p).map(|k| basis[i][k] * (up[k] - down[k])).sum();
            shape[i][j] = difference / (2.0 * SPACING * at.slope);
        }
    }
    (shape, basis)
}

/// The eigenvalue of largest magnitude and its vector, by powers: its accuracy matters little.
fn principal(shape: &Tangents, count: usize) -> (f64, [f64; MOST_NOISE]) {
    let largest = (0..count).max_by(|&a, &b| shape[a][a].abs().total_cmp(&shape[b][b].abs()));
    let mut vector = [0.0; MOST_NOISE];
    vector[largest.unwrap_or(0)] = 1.0;
    let mut value = 0.0;
    for _ in 0..12 {
        let mut next = [0.0; MOST_NOISE];
        for i in 0..count {
            next[i] = (0..count).map(|j| shape[i][j] * vector[j]).sum();
        }
        let length = next[..count].iter().map(|c| c * c).sum::<f64>().sqrt();
        if length <= 0.0 {
            return (0.0, vector);
        }
        value = (0..count).map(|i| next[i] * vector[i]).sum();
        for i in 0..count {
            vector[i] = next[i] / length;
        }
    }
    (value, vector)
}

/// `E[s]` over normal and one tangent, by 3 × 5 Gauss–Hermite nodes, of which those without tangent add nothing; `None` where a node has no foot.
fn mean_over_plane<R: ImplicitReading + ?Sized>(
    reading: &R,
    branch: usize,
    x: &[f64],
    u: &[f64],
    at: &Normalized,
    along: &[f64; MOST_NOISE],
) -> Option<f64> {
    let p = u.len();
    let node = 3.0_f64.sqrt();
    let normals = [(-node, 1.0 / 6.0), (0.0, 2.0 / 3.0), (node, 1.0 / 6.0)];
    let (near, far) = (1.355_626_179_974_266, 2.856_970_013_872_806);
    let (near_weight, far_weight) = (0.222_075_922_005_612_6, 0.011_257_411_327_720_7);
    let tangents = [
        (-far, far_weight),
        (-near, near_weight),
        (near, near_weight),
        (far, far_weight),
    ];
    let mut mean = 0.0;
    let mut foot_at = Normalized::new();
    for (tangent, tangent_weight) in tangents {
        for (normal, weight) in normals {
            let mut origin = [0.0; MOST_NOISE];
            let mut foot = [0.0; MOST_NOISE];
            for k in 0..p {
                // The reading would stand at `u − step` of the foot's own noise.
                origin[k] = u[k] - normal * at.normal[k] - tangent * along[k];
                foot[k] = u[k] - tangent * along[k];
            }
            if !signed_distance(reading, branch, x, &origin[..p], &mut foot[..p], &mut foot_at) {
                return None;
            }
            mean += tangent_weight * weight * (foot_at.distance - normal);
        }
    }
    Some(mean)
}
