//! The residuals between patches, and the normal equations of their motions.
//!
//! Input: patches at their current poses. Output: residuals along normals, and steps and covariances of all
//! motions except the first. Patches may have no residuals at all; the caller checks this.

use super::{PosePrior, Side};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use planish_core::DVec3;
use planish_estimate::{Error, Loss, Result};
use planish_mesh::{BoundingBox, ClosestPoint};
use planish_sense::Pose;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Maximum angle between the normals of a vertex and of its foot point (46°). Larger angles pair the two
/// sides of an edge.
const MAX_ANGLE_RAD: f64 = 0.8;
/// Minimum ratio of the information of residuals to that of noise and prior for a determined direction.
/// Smaller values follow noise of the normals along planes; larger ones leave weak but real directions open.
const MIN_INFORMATION_RATIO: f64 = 3.0;
/// Minimum cosine between the normals of a triangle's corners and its own for a curved triangle. Beyond it,
/// the triangle spans a sharp edge and is treated as flat.
const MIN_CURVED_COSINE: f64 = 0.94;
/// Cells per diagonal. The length of error correlation is unknown, so sums over three cell sizes are
/// compared.
const CELLS: [f64; 3] = [8.0, 16.0, 32.0];
/// Minimum number of cells for an estimate of the variance of their sums.
const MIN_CELLS: usize = 30;

/// A vertex of one patch and its foot point on another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Residual {
    pub patch: usize,
    pub other: usize,
    place: DVec3,
    /// The mean of both normals, and half their difference.
    normal: DVec3,
    lean: DVec3,
    /// Signed distance of `patch` above `other`.
    pub distance: f64,
    /// σ of the difference of one vertex and its foot point.
    sigma: f64,
    /// Information (1/σ²) of the represented area, if σ is correct.
    weight: f64,
}

impl Residual {
    pub(super) fn normalised(&self) -> f64 {
        self.distance / self.sigma
    }

    /// Weight after the common scale and the redescending loss.
    fn robust_weight(&self, scale: f64) -> f64 {
        self.weight * Loss::tukey().weight(self.normalised() / scale) / (scale * scale)
    }

    /// Derivative of the distance along a normal with respect to a motion about a centre.
    fn derivative(&self, normal: DVec3, middle: DVec3) -> [f64; 6] {
        let DVec3 { x, y, z } = normal;
        let [a, b, c] = (self.place - middle).cross(normal).to_array();
        [x, y, z, a, b, c]
    }
}

/// Residuals of all vertices that overlap another patch within `reach`. The order does not depend on threads.
pub(super) fn residuals(sides: &[Side], reach: f64) -> Vec<Residual> {
    // Of many patches, most pairs are far apart; boxes exclude them without a search.
    let boxes: Vec<Option<BoundingBox>> = (sides.iter())
        .map(|s| {
            let places = s.patch.mesh.positions.iter().step_by(s.stride);
            BoundingBox::around(places.map(|p| s.pose.apply(*p)))
        })
        .collect();
    let near = |i: usize, j: usize| match (&boxes[i], &boxes[j]) {
        (Some(a), Some(b)) => (0..3).all(|k| a.min[k] - reach <= b.max[k] && b.min[k] - reach <= a.max[k]),
        _ => false,
    };
    let mut all = Vec::new();
    for (i, side) in sides.iter().enumerate() {
        for (j, other) in sides.iter().enumerate().filter(|(j, _)| *j != i && near(i, *j)) {
            // Into the frame of the other patch, so that its search structure need not be rebuilt in every
            // round.
            let back = other.pose.inverse().after(&side.pose);
            let vertices: Vec<usize> = (0..side.patch.mesh.positions.len()).step_by(side.stride).collect();
            all.par_extend(
                vertices.par_iter().filter_map(|&v| residual([i, j], side, other, &back, v, reach)),
            );
        }
    }
    all
}

fn residual(
    [i, j]: [usize; 2],
    side: &Side,
    other: &Side,
    back: &Pose,
    vertex: usize,
    reach: f64,
) -> Option<Residual> {
    if !side.within[vertex] {
        return None;
    }
    let p = back.apply(side.patch.mesh.positions[vertex]);
    let own_normal = back.rotate(side.normals[vertex]);
    let foot = (other.search).closest_compatible_within(p, own_normal, MAX_ANGLE_RAD, reach)?;
    let mesh = &other.patch.mesh;
    let corners = mesh.triangles[foot.triangle as usize].map(|v| v as usize);
    // Both sides must be away from a border.
    if !corners.iter().all(|v| other.within[*v]) {
        return None;
    }
    let other_normal =
        (corners.iter().zip(foot.barycentric)).fold(DVec3::ZERO, |sum, (v, b)| sum + b * other.normals[*v]);
    let other_normal = other_normal.try_normalize()?;
    let normal = (own_normal + other_normal).try_normalize()?;
    let at_foot = |values: &[f64]| mesh.interpolate(values, foot.triangle as usize, foot.barycentric);
    // Without σ the weights are relative, and the common scale is estimated from the residuals.
    let other_sigma = match other.patch.sigma.is_empty() {
        true => 1.0,
        false => at_foot(&other.patch.sigma),
    };
    let variance = side.sigma(vertex).powi(2);
    let area = side.areas[vertex] * side.stride as f64;
    // The factor 0.5: each pair of places is measured in both directions.
    let weight = 0.5 * area / (variance * area + other_sigma.powi(2) * at_foot(&other.areas));
    (weight > 0.0 && weight.is_finite()).then(|| Residual {
        patch: i,
        other: j,
        place: other.pose.apply(p),
        normal: other.pose.rotate(normal),
        lean: other.pose.rotate(0.5 * (own_normal - other_normal)),
        distance: normal.dot(p - foot.point) - bulge(other, corners, &foot, normal),
        sigma: variance.sqrt().hypot(other_sigma),
        weight,
    })
}

/// Height of the curved surface above a triangle: half of the height of the tangent planes at the corners.
///
/// This is exact for a parabola (T. Boubekeur, M. Alexa 2008: Phong tessellation, α = 1/2). Without it,
/// chords of coarse patches would pull convex objects inwards.
fn bulge(side: &Side, corners: [usize; 3], foot: &ClosestPoint, normal: DVec3) -> f64 {
    if corners.iter().any(|v| side.normals[*v].dot(normal) < MIN_CURVED_COSINE) {
        return 0.0;
    }
    let mesh = &side.patch.mesh;
    let planes = corners.iter().zip(foot.barycentric);
    0.5 * planes.map(|(v, b)| b * side.normals[*v].dot(mesh.positions[*v] - foot.point)).sum::<f64>()
}

/// Normal equations of all motions except the first, in units of the prior's σ.
///
/// Let `ā` be the derivative with the mean of both normals, `d` with half their difference, and `w` the
/// robust weight. `A = Σ w ā āᵀ` contains the noise of the normals, and `N = Σ w d dᵀ` estimates it: the two
/// normals of a point have independent errors, so `A − N` is the sum of products of one with the other
/// (instrumental variables). With `A` alone, noise of normals would look like information about motions along
/// a plane. Directions in which `A` is not several times `N + 1` are undetermined. No step is made along
/// them.
pub(super) struct Equations {
    /// Determined directions as columns, in units of the prior.
    determined: DMatrix<f64>,
    /// `(A − N + 1)` in these directions.
    factor: Cholesky<f64, Dyn>,
    /// The right-hand side in these directions.
    right: DVector<f64>,
    /// `A` in these directions.
    data: DMatrix<f64>,
    /// Covariance of the undetermined directions: the prior.
    open: DMatrix<f64>,
    scales: Vec<f64>,
}

impl Equations {
    /// # Errors
    /// `Undetermined` if sums are not finite.
    pub(super) fn new(sides: &[Side], rows: &[Residual], scale: f64, prior: &PosePrior) -> Result<Self> {
        let n = 6 * (sides.len() - 1);
        let scales: Vec<f64> = (0..n).map(|k| prior.sigma(k % 6)).collect();
        let (mut data, mut noise) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
        let mut right = DVector::zeros(n);
        for (k, side) in sides.iter().enumerate().skip(1) {
            let start = 6 * (k - 1);
            // The prior pulls each patch back to its original pose: residuals of its centre and rotation.
            let moved = side.middle_now() - side.middle;
            let turned = side.pose.rotation_vector();
            for a in 0..6 {
                right[start + a] -= if a < 3 { moved[a] } else { turned[a - 3] } / scales[a];
            }
        }
        for row in rows {
            let weight = row.robust_weight(scale);
            if weight == 0.0 {
                continue;
            }
            let block = |k: usize, sign: f64| {
                let derivative_along = |normal| {
                    let plain = row.derivative(normal, sides[k].middle_now());
                    std::array::from_fn::<f64, 6, _>(|a| sign * plain[a] * scales[a])
                };
                (k > 0).then(|| (6 * (k - 1), derivative_along(row.normal), derivative_along(row.lean)))
            };
            let blocks = [block(row.patch, 1.0), block(row.other, -1.0)];
            for (start, derivative, lean) in blocks.iter().flatten() {
                for a in 0..6 {
                    right[start + a] -= weight * derivative[a] * row.distance;
                    for (other, against, other_lean) in blocks.iter().flatten() {
                        for b in 0..6 {
                            data[(start + a, other + b)] += weight * derivative[a] * against[b];
                            noise[(start + a, other + b)] += weight * lean[a] * other_lean[b];
                        }
                    }
                }
            }
        }
        let not_finite = || Error::undetermined("the sums of the alignment are not finite");
        // Generalised eigenvectors of A against N + 1 separate determined from undetermined directions.
        let whitener = Cholesky::new(&noise + DMatrix::identity(n, n)).ok_or_else(not_finite)?;
        let whitened = whitener.l().solve_lower_triangular(&data).ok_or_else(not_finite)?;
        let whitened = whitener.l().solve_lower_triangular(&whitened.transpose()).ok_or_else(not_finite)?;
        let eigen = ((&whitened + whitened.transpose()) * 0.5).symmetric_eigen();
        let directions =
            (whitener.l().tr_solve_lower_triangular(&eigen.eigenvectors)).ok_or_else(not_finite)?;
        let (mut determined, mut open) = (Vec::new(), Vec::new());
        for (k, value) in eigen.eigenvalues.iter().enumerate() {
            let column = directions.column(k).into_owned();
            if *value > MIN_INFORMATION_RATIO { determined.push(column) } else { open.push(column) }
        }
        let together = |columns: &[DVector<f64>]| match columns.is_empty() {
            true => DMatrix::zeros(n, 0),
            false => DMatrix::from_columns(columns),
        };
        let (determined, open) = (together(&determined), together(&open));
        let of_determined =
            &determined.transpose() * (&data - &noise + DMatrix::identity(n, n)) * &determined;
        let spread = Cholesky::new(&open.transpose() * &open).ok_or_else(not_finite)?;
        Ok(Self {
            factor: Cholesky::new(of_determined).ok_or_else(not_finite)?,
            right: &determined.transpose() * right,
            data: &determined.transpose() * data * &determined,
            open: &open * spread.solve(&open.transpose()),
            determined,
            scales,
        })
    }

    /// The step of every patch, and its largest component in σ of the motion.
    pub(super) fn step(&self, patches: usize) -> (Vec<[f64; 6]>, f64) {
        let solved = &self.determined * self.factor.solve(&self.right);
        let covariance = self.covariances(1.0);
        let largest = (solved.iter().enumerate())
            .map(|(k, s)| s.abs() * self.scales[k] / covariance[(k, k)].sqrt())
            .fold(0.0, f64::max);
        let step = |k: usize| std::array::from_fn(|a| solved[6 * (k - 1) + a] * self.scales[a]);
        let steps = (0..patches).map(|k| if k == 0 { [0.0; 6] } else { step(k) }).collect();
        (steps, largest)
    }

    /// Covariance of all motions about the patches' centres. `factor` multiplies the variance of residuals.
    pub(super) fn covariances(&self, factor: f64) -> DMatrix<f64> {
        let inverse = self.factor.inverse();
        // Sandwich estimator: the equations are solved with A − N, but the right-hand side has the variance
        // A.
        let prior = &self.determined.transpose() * &self.determined;
        let middle = &self.data * factor + prior;
        let mut all =
            &self.determined * (&inverse * middle * &inverse) * self.determined.transpose() + &self.open;
        for a in 0..all.nrows() {
            for b in 0..all.ncols() {
                all[(a, b)] *= self.scales[a] * self.scales[b];
            }
        }
        all
    }
}

/// Ratio of the variance of sums of residuals over cells of space to that of independent errors with the
/// stated σ. At least 1 if σ is stated.
///
/// The residuals of both directions of a pair are the same errors with opposite signs, so they are summed
/// with the sign of their direction.
pub(super) fn excess_variance(rows: &[Residual], scale: f64, size: f64, stated: bool) -> f64 {
    let mut largest = if stated { 1.0 } else { 0.0_f64 };
    for cells in CELLS {
        let edge = size / cells;
        // An ordered map: with a hash map, the order of the sums would vary between runs.
        let mut sums: BTreeMap<([usize; 2], [i64; 3]), (f64, f64)> = BTreeMap::new();
        for row in rows {
            let weight = row.robust_weight(scale);
            let cell = row.place.to_array().map(|x| (x / edge).floor() as i64);
            let (pair, sign) = match row.patch < row.other {
                true => ([row.patch, row.other], 1.0),
                false => ([row.other, row.patch], -1.0),
            };
            let sum = sums.entry((pair, cell)).or_default();
            sum.0 += sign * weight * row.distance;
            sum.1 += weight;
        }
        let kept: Vec<(f64, f64)> = sums.into_values().filter(|(_, v)| *v > 0.0).collect();
        // Without a stated σ, a rough estimate from few cells is better than none.
        if kept.len() >= MIN_CELLS || largest == 0.0 {
            let variance: f64 = kept.iter().map(|(_, v)| v).sum();
            let square: f64 = kept.iter().map(|(s, _)| s * s).sum();
            let ratio = square / variance;
            // σ of the mean of n squared normal values. An excess within two of these is chance.
            let chance = (2.0 / kept.len() as f64).sqrt();
            if !stated || ratio > 1.0 + 2.0 * chance {
                largest = largest.max(ratio);
            }
        }
    }
    largest.max(f64::MIN_POSITIVE)
}
