//! The residuals between patches, and the normal equations of their motions.
//!
//! Input: patches at their poses. Output: how far they are apart along normals, and steps and
//! covariances of all motions but the first. Not guaranteed: that anything lies on anything.

use super::{Hold, Side};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use planish_estimate::vector3::{add, add_scaled, cross, dot, scale, sub, unit};
use planish_estimate::{Error, Loss, Result};
use planish_mesh::{BoundingBox, ClosestPoint};
use planish_sense::Pose;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Normals of one place differ by less.
const LARGEST_ANGLE_RAD: f64 = 0.8;
/// A direction is told by residuals where their information is more than so many times that of noise and
/// hold.
const DETERMINED: f64 = 3.0;
/// A triangle is bent where the cosines between its corners' normals and its own are above this; over a sharp
/// edge it is flat.
const BENT: f64 = 0.94;
/// Cells of space to a diagonal, whose sums tell how errors go together; and so many of them are needed to
/// tell.
const CELLS: [f64; 3] = [8.0, 16.0, 32.0];
const LEAST_CELLS: usize = 30;

/// A place of one patch beside its foot on another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Residual {
    pub here: usize,
    pub there: usize,
    place: [f64; 3],
    /// The mean of both normals, and half their difference.
    normal: [f64; 3],
    lean: [f64; 3],
    /// How far `here` lies above `there`.
    pub off: f64,
    /// σ of both, as they are at a vertex.
    sigma: f64,
    /// What it is worth where σ is true: one over a variance.
    weight: f64,
}

impl Residual {
    pub(super) fn normalised(&self) -> f64 {
        self.off / self.sigma
    }

    /// What it is worth beside the scale of all and a redescending loss.
    fn worth(&self, scale: f64) -> f64 {
        self.weight * Loss::tukey().weight(self.normalised() / scale) / (scale * scale)
    }

    /// The derivative by a motion about a middle, along a normal.
    fn derivative(&self, normal: [f64; 3], middle: [f64; 3]) -> [f64; 6] {
        let [x, y, z] = normal;
        let [a, b, c] = cross(sub(self.place, middle), normal);
        [x, y, z, a, b, c]
    }
}

/// All places that lie on another patch within a reach, in an order that does not depend on threads.
pub(super) fn residuals(sides: &[Side], reach: f64) -> Vec<Residual> {
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
    for (i, here) in sides.iter().enumerate() {
        for (j, there) in sides.iter().enumerate().filter(|(j, _)| *j != i && near(i, *j)) {
            let back = there.pose.inverse().after(&here.pose);
            let vertices: Vec<usize> = (0..here.patch.mesh.positions.len()).step_by(here.stride).collect();
            all.par_extend(
                vertices.par_iter().filter_map(|&v| residual([i, j], here, there, &back, v, reach)),
            );
        }
    }
    all
}

fn residual(
    [i, j]: [usize; 2],
    here: &Side,
    there: &Side,
    back: &Pose,
    vertex: usize,
    reach: f64,
) -> Option<Residual> {
    if !here.within[vertex] {
        return None;
    }
    let p = back.apply(here.patch.mesh.positions[vertex]);
    let mine = back.rotate(here.normals[vertex]);
    let foot = (there.search).closest_compatible_within(p, mine, LARGEST_ANGLE_RAD, reach)?;
    let mesh = &there.patch.mesh;
    let corners = mesh.triangles[foot.triangle as usize].map(|v| v as usize);
    if !corners.iter().all(|v| there.within[*v]) {
        return None;
    }
    let theirs = (corners.iter().zip(foot.barycentric))
        .fold([0.0; 3], |sum, (v, b)| add_scaled(sum, b, there.normals[*v]));
    let theirs = unit(theirs)?;
    let normal = unit(add(mine, theirs))?;
    let at_foot = |values: &[f64]| mesh.interpolate(values, foot.triangle as usize, foot.barycentric);
    let there_sigma = match there.patch.sigma.is_empty() {
        true => 1.0,
        false => at_foot(&there.patch.sigma),
    };
    let here_variance = here.sigma(vertex).powi(2);
    let area = here.areas[vertex] * here.stride as f64;
    let weight = 0.5 * area / (here_variance * area + there_sigma.powi(2) * at_foot(&there.areas));
    (weight > 0.0 && weight.is_finite()).then(|| Residual {
        here: i,
        there: j,
        place: there.pose.apply(p),
        normal: there.pose.rotate(normal),
        lean: there.pose.rotate(scale(0.5, sub(mine, theirs))),
        off: dot(normal, sub(p, foot.point)) - bulge(there, corners, &foot, normal),
        sigma: here_variance.sqrt().hypot(there_sigma),
        weight,
    })
}

/// How far the surface lies above the chord of a triangle: half of what the tangent planes at its corners
/// say, which is exact for a parabola (T. Boubekeur, M. Alexa 2008: Phong tessellation, with α = 1/2).
fn bulge(side: &Side, corners: [usize; 3], foot: &ClosestPoint, normal: [f64; 3]) -> f64 {
    if corners.iter().any(|v| dot(side.normals[*v], normal) < BENT) {
        return 0.0;
    }
    let mesh = &side.patch.mesh;
    let planes = corners.iter().zip(foot.barycentric);
    0.5 * planes.map(|(v, b)| b * dot(side.normals[*v], sub(mesh.positions[*v], foot.point))).sum::<f64>()
}

/// The normal equations of all motions but the first, in units of what holds them.
///
/// With `ā` the derivatives by the mean of both normals, `d` by half their difference, and `w` what a
/// residual is worth, `A = Σ w ā āᵀ` holds noise of the normals, and `N = Σ w d dᵀ` is as much of it: both
/// normals of a place have errors of their own, and `A − N` is the sum of products of one with the other
/// (instrumental variables). Without that, noise would seem to tell of motions along a plane. Directions in
/// which `A` is not several times `N + 1` are told by noise and hold alone; no step is made there.
pub(super) struct Equations {
    /// Columns are directions that are told, in units of the hold.
    determined: DMatrix<f64>,
    /// `(A − N + 1)` in these directions.
    factor: Cholesky<f64, Dyn>,
    /// Of these, the sums of the right side.
    right: DVector<f64>,
    /// Of these, `A`.
    data: DMatrix<f64>,
    /// The variance of what is not told.
    open: DMatrix<f64>,
    scales: Vec<f64>,
}

impl Equations {
    /// # Errors
    /// `Undetermined` where sums are not finite.
    pub(super) fn new(sides: &[Side], rows: &[Residual], scale: f64, hold: &Hold) -> Result<Self> {
        let n = 6 * (sides.len() - 1);
        let scales: Vec<f64> = (0..n).map(|k| hold.sigma(k % 6)).collect();
        let (mut data, mut noise) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
        let mut right = DVector::zeros(n);
        for (k, side) in sides.iter().enumerate().skip(1) {
            let start = 6 * (k - 1);
            // How far it has been moved: its middle, and its turn.
            let moved = sub(side.middle_now(), side.middle);
            let turned = side.pose.rotation_vector();
            for a in 0..6 {
                right[start + a] -= if a < 3 { moved[a] } else { turned[a - 3] } / scales[a];
            }
        }
        for row in rows {
            let worth = row.worth(scale);
            if worth == 0.0 {
                continue;
            }
            let of = |k: usize, sign: f64| {
                let of = |normal| {
                    let plain = row.derivative(normal, sides[k].middle_now());
                    std::array::from_fn::<f64, 6, _>(|a| sign * plain[a] * scales[a])
                };
                (k > 0).then(|| (6 * (k - 1), of(row.normal), of(row.lean)))
            };
            let blocks = [of(row.here, 1.0), of(row.there, -1.0)];
            for (start, derivative, lean) in blocks.iter().flatten() {
                for a in 0..6 {
                    right[start + a] -= worth * derivative[a] * row.off;
                    for (other, against, leaning) in blocks.iter().flatten() {
                        for b in 0..6 {
                            data[(start + a, other + b)] += worth * derivative[a] * against[b];
                            noise[(start + a, other + b)] += worth * lean[a] * leaning[b];
                        }
                    }
                }
            }
        }
        let not_finite = || Error::undetermined("the sums of the alignment are not finite");
        let held = Cholesky::new(&noise + DMatrix::identity(n, n)).ok_or_else(not_finite)?;
        let whitened = held.l().solve_lower_triangular(&data).ok_or_else(not_finite)?;
        let whitened = held.l().solve_lower_triangular(&whitened.transpose()).ok_or_else(not_finite)?;
        let eigen = ((&whitened + whitened.transpose()) * 0.5).symmetric_eigen();
        let directions = (held.l().tr_solve_lower_triangular(&eigen.eigenvectors)).ok_or_else(not_finite)?;
        let (mut determined, mut open) = (Vec::new(), Vec::new());
        for (k, value) in eigen.eigenvalues.iter().enumerate() {
            let column = directions.column(k).into_owned();
            if *value > DETERMINED { determined.push(column) } else { open.push(column) }
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

    /// The step of every patch, and how far it is in σ of its motion where that is largest.
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

    /// The covariance of all motions about the patches' middles, the variances of residuals times a factor.
    pub(super) fn covariances(&self, factor: f64) -> DMatrix<f64> {
        let inverse = self.factor.inverse();
        // The sandwich: the equations are solved by A − N, their right side varies by A.
        let hold = &self.determined.transpose() * &self.determined;
        let middle = &self.data * factor + hold;
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

/// How much more the sums of residuals over cells of space vary than independent errors of the stated σ
/// would; at least one where σ is stated.
///
/// A pair's residuals of both ways are the same errors with opposite signs, so they are added up with the
/// sign of the way.
pub(super) fn excess_variance(rows: &[Residual], scale: f64, size: f64, stated: bool) -> f64 {
    let mut most = if stated { 1.0 } else { 0.0_f64 };
    for cells in CELLS {
        let edge = size / cells;
        let mut sums: BTreeMap<([usize; 2], [i64; 3]), (f64, f64)> = BTreeMap::new();
        for row in rows {
            let worth = row.worth(scale);
            let cell = row.place.map(|x| (x / edge).floor() as i64);
            let (pair, sign) = match row.here < row.there {
                true => ([row.here, row.there], 1.0),
                false => ([row.there, row.here], -1.0),
            };
            let sum = sums.entry((pair, cell)).or_default();
            sum.0 += sign * worth * row.off;
            sum.1 += worth;
        }
        let kept: Vec<(f64, f64)> = sums.into_values().filter(|(_, v)| *v > 0.0).collect();
        if kept.len() >= LEAST_CELLS || most == 0.0 {
            let variance: f64 = kept.iter().map(|(_, v)| v).sum();
            let square: f64 = kept.iter().map(|(s, _)| s * s).sum();
            let ratio = square / variance;
            // A mean of so many squares of one variance has this σ; what chance explains is none.
            let chance = (2.0 / kept.len() as f64).sqrt();
            if !stated || ratio > 1.0 + 2.0 * chance {
                most = most.max(ratio);
            }
        }
    }
    most.max(f64::MIN_POSITIVE)
}
