//! Prediction of a point from a quadric through its neighbours.

use crate::neighbours::flattest_direction;
use planish_core::{DVec3, vector3::tangents};

/// Coefficients of a quadric `z = a + b x + c y + d x² + e x y + f y²`.
const COEFFICIENTS: usize = 6;
/// Smallest variance of a neighbour in the weights of a fit, over the median of the neighbourhood. Without
/// it, a few neighbours of a tiny σ would determine the quadric alone and leave no residual. The variance of
/// the difference holds for any weights.
const MIN_RELATIVE_VARIANCE: f64 = 1e-4;
/// Largest variance of a prediction over that of the point. A larger one tells of the neighbours only, and
/// is usually an extrapolation.
const MAX_PREDICTION_VARIANCE: f64 = 4.0;
/// Smallest pivot of the normal equations over the diagonal. Neighbours on one line are below it.
const MIN_PIVOT: f64 = 1e-9;

/// The height of point `i` over the quadric of its neighbours, over its σ, and the stated variance of the
/// point along the normal.
///
/// `None` if the neighbours do not determine a quadric, or predict much worse than the point measures.
pub(super) fn predicted_difference(
    points: &[DVec3],
    i: usize,
    neighbours: &[usize],
    radius: f64,
    variance: &impl Fn(usize, DVec3) -> f64,
) -> Option<(f64, f64)> {
    let sample: Vec<DVec3> = neighbours.iter().map(|&j| points[j]).collect();
    let normal = flattest_direction(&sample).0;
    if normal == DVec3::ZERO || radius <= 0.0 {
        return None;
    }
    let (e1, e2) = tangents(normal);
    let variances: Vec<f64> = neighbours.iter().map(|&j| variance(j, normal)).collect();
    let own = variance(i, normal);
    let mut sorted = variances.clone();
    let middle = sorted.len() / 2;
    let floor = MIN_RELATIVE_VARIANCE * *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
    if !(own > 0.0 && floor > 0.0) {
        return None;
    }
    let mut matrix = [[0.0; COEFFICIENTS]; COEFFICIENTS];
    let rows: Vec<([f64; COEFFICIENTS], f64)> = (sample.iter().zip(&variances))
        .map(|(p, v)| {
            let d = (*p - points[i]) / radius;
            let (x, y) = (d.dot(e1), d.dot(e2));
            ([1.0, x, y, x * x, x * y, y * y], floor / v.max(floor))
        })
        .collect();
    for (row, weight) in &rows {
        for (line, a) in matrix.iter_mut().zip(row) {
            for (entry, b) in line.iter_mut().zip(row) {
                *entry += weight * a * b;
            }
        }
    }
    // The prediction at the point itself is the first coefficient: its row of the inverse gives the weights.
    let first = first_row_of_inverse(matrix)?;
    let (mut predicted, mut predicted_variance) = (0.0, 0.0);
    for ((row, weight), (p, v)) in rows.iter().zip(sample.iter().zip(&variances)) {
        let c = weight * row.iter().zip(&first).map(|(a, b)| a * b).sum::<f64>();
        predicted += c * (*p - points[i]).dot(normal);
        predicted_variance += c * c * v;
    }
    (predicted_variance <= MAX_PREDICTION_VARIANCE * own)
        .then(|| (-predicted / (own + predicted_variance).sqrt(), own))
}

/// The first row of the inverse of a symmetric positive definite matrix, by its Cholesky factor; `None` if
/// it is singular.
fn first_row_of_inverse(mut m: [[f64; COEFFICIENTS]; COEFFICIENTS]) -> Option<[f64; COEFFICIENTS]> {
    for k in 0..COEFFICIENTS {
        let before = m[k][k];
        let pivot = before - (0..k).map(|l| m[k][l] * m[k][l]).sum::<f64>();
        if pivot.is_nan() || pivot <= MIN_PIVOT * before {
            return None;
        }
        m[k][k] = pivot.sqrt();
        for r in k + 1..COEFFICIENTS {
            m[r][k] = (m[r][k] - (0..k).map(|l| m[r][l] * m[k][l]).sum::<f64>()) / m[k][k];
        }
    }
    let mut x = [0.0; COEFFICIENTS];
    x[0] = 1.0;
    for k in 0..COEFFICIENTS {
        x[k] = (x[k] - (0..k).map(|l| m[k][l] * x[l]).sum::<f64>()) / m[k][k];
    }
    for k in (0..COEFFICIENTS).rev() {
        x[k] = (x[k] - (k + 1..COEFFICIENTS).map(|l| m[l][k] * x[l]).sum::<f64>()) / m[k][k];
    }
    Some(x)
}
