//! As-rigid-as-possible energy of points that are joined by springs.
//!
//! In: points at rest and the weights `w_ij` of their springs. Out: for displaced points, the energy, its
//! gradient and its information matrix.
//!
//! Each point `i` and its neighbours `N(i)` are a cell, which may turn by a rotation `R_i` of its own:
//!
//! `E(p) = min_R Σ_i Σ_{j ∈ N(i)} ½ w_ij |(p_i − p_j) − R_i (r_i − r_j)|²`
//!
//! with `r` the points at rest. Rotations and translations of the whole cost nothing, and neither does a
//! rotation of a part outside of its joint. For `R = I` the energy is that of the stiffness `K` with the same
//! springs, `Σ w_ij |d_i − d_j|²` over all pairs.
//!
//! The best `R_i` follow from `p` by singular value decompositions. At the optimum the derivatives by `R_i`
//! vanish, so the gradient is that for constant rotations. The information takes into account that they turn:
//! with `a_ij = R_i (r_i − r_j)`, a displacement `δ` and a rotation `ω_i` change the residuals by
//! `δ_i − δ_j + a_ij × ω_i`, and `ω_i` is eliminated cell by cell (Gauss-Newton; terms of the size of the
//! strain are omitted, so the matrix is positive semidefinite).
//!
//! Source: O. Sorkine, M. Alexa, *As-rigid-as-possible surface modeling*, 2007.
//!
//! Not guaranteed: points whose neighbours lie on a line can turn about it without energy.

use crate::deformation::nearest_rotation;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::DisjointSets;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Minimum weight of a spring, relative to the mean. Cotangents of obtuse triangles are zero, and points
/// would lose the neighbours that hold them.
const MIN_SPRING: f64 = 0.1;
/// Eigenvalues of a cell below this share of the largest are zero: the cell can turn about an axis freely.
const FREE_TURN: f64 = 1e-9;

/// Points joined by springs.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_shell::{Rigidity, automatic_controls, stiffness};
/// use planish_mesh::icosphere;
/// let controls = automatic_controls(&icosphere(1.0, 3), 20)?;
/// let k = stiffness(&controls.points, &controls.triangles, &controls.edges);
/// let rigidity = Rigidity::new(&controls.points, &controls.edges, &k)?;
/// // A quarter turn about z costs nothing.
/// let turned = |p: &DVec3| DVec3::new(-p[1], p[0], p[2]);
/// assert!(rigidity.energy(&controls.points.iter().map(turned).collect::<Vec<_>>()) < 1e-20);
/// let larger: Vec<DVec3> = controls.points.iter().map(|p| 1.1 * *p).collect();
/// assert!(rigidity.energy(&larger) > 1e-3);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Rigidity {
    rest: Vec<DVec3>,
    /// Neighbours of each point with the weights of their springs.
    cells: Vec<Vec<(u32, f64)>>,
}

/// The energy near given positions: `E + gᵀδ + ½ δᵀ H δ` for `E/2`.
pub(crate) struct LinearisedRigidity {
    /// The energy.
    pub energy: f64,
    /// Half of its gradient.
    pub gradient: DVector<f64>,
    /// Half of its second derivative.
    pub information: DMatrix<f64>,
}

impl Rigidity {
    /// Points with springs where the stiffness of one coordinate ([`crate::stiffness`]) has negative entries,
    /// which are minus their weights, and along `edges`.
    ///
    /// # Errors
    /// `Input` for a stiffness of another size, or an edge of a point that does not exist.
    pub fn new(points: &[DVec3], edges: &[[u32; 2]], stiffness: &DMatrix<f64>) -> Result<Self> {
        let count = points.len();
        if stiffness.shape() != (count, count) {
            return Err(Error::input(format!(
                "expected a stiffness of {count} × {count} entries, found {} × {}",
                stiffness.nrows(),
                stiffness.ncols()
            )));
        }
        if let Some([a, b]) = edges.iter().find(|e| e.iter().any(|v| *v as usize >= count)) {
            return Err(Error::input(format!("expected edges of points below {count}, found {a} to {b}")));
        }
        let mut edges: BTreeSet<[u32; 2]> =
            edges.iter().filter(|[a, b]| a != b).map(|[a, b]| [*a.min(b), *a.max(b)]).collect();
        let joined = |a: u32, b: u32| stiffness[(a as usize, b as usize)] < 0.0;
        for a in 0..count as u32 {
            edges.extend((a + 1..count as u32).filter(|b| joined(a, *b)).map(|b| [a, b]));
        }
        let spring = |[a, b]: [u32; 2]| (-stiffness[(a as usize, b as usize)]).max(0.0);
        let mean = edges.iter().map(|e| spring(*e)).sum::<f64>() / edges.len().max(1) as f64;
        let mut cells = vec![Vec::new(); count];
        for edge in edges {
            let weight = spring(edge).max(MIN_SPRING * mean);
            cells[edge[0] as usize].push((edge[1], weight));
            cells[edge[1] as usize].push((edge[0], weight));
        }
        Ok(Self { rest: points.to_vec(), cells })
    }

    /// The same springs between points that are at rest in another pose.
    pub(crate) fn in_pose(self, rest: Vec<DVec3>) -> Self {
        Self { rest, ..self }
    }

    /// Number of points.
    #[must_use]
    pub fn points(&self) -> usize {
        self.rest.len()
    }

    /// The points at rest.
    pub(crate) fn rest(&self) -> &[DVec3] {
        &self.rest
    }

    /// Number of independent changes of shape: all but the six rigid motions of every connected part.
    pub(crate) fn rank(&self) -> usize {
        let mut parts = DisjointSets::new(self.rest.len());
        let mut count = self.rest.len();
        for (i, cell) in self.cells.iter().enumerate() {
            for (j, _) in cell {
                count -= usize::from(parts.join(i as u32, *j));
            }
        }
        (3 * self.rest.len()).saturating_sub(6 * count)
    }

    /// The energy of displaced points.
    #[must_use]
    pub fn energy(&self, positions: &[DVec3]) -> f64 {
        (0..self.cells.len()).map(|i| self.cell_energy(i, positions)).sum()
    }

    fn cell_energy(&self, i: usize, positions: &[DVec3]) -> f64 {
        let rotation = self.rotation(i, positions);
        (self.cells[i].iter())
            .map(|(j, w)| {
                let rest = Vector3::from(self.rest[i] - self.rest[*j as usize]);
                let now = Vector3::from(positions[i] - positions[*j as usize]);
                0.5 * w * (now - rotation * rest).norm_squared()
            })
            .sum()
    }

    /// The rotation of a cell that fits its displaced points best.
    fn rotation(&self, i: usize, positions: &[DVec3]) -> Matrix3<f64> {
        let mut products = Matrix3::zeros();
        for (j, w) in &self.cells[i] {
            let rest = Vector3::from(self.rest[i] - self.rest[*j as usize]);
            let now = Vector3::from(positions[i] - positions[*j as usize]);
            products += *w * now * rest.transpose();
        }
        nearest_rotation(&products)
    }

    /// The energy, its gradient and its information at displaced points; x, y, z of each point in turn.
    pub(crate) fn linearised(&self, positions: &[DVec3]) -> LinearisedRigidity {
        let count = self.rest.len();
        let rotations: Vec<Matrix3<f64>> =
            (0..count).into_par_iter().map(|i| self.rotation(i, positions)).collect();
        let mut made = LinearisedRigidity {
            energy: 0.0,
            gradient: DVector::zeros(3 * count),
            information: DMatrix::zeros(3 * count, 3 * count),
        };
        for (i, cell) in self.cells.iter().enumerate() {
            let mut of_turn = Matrix3::zeros();
            // Turned edges of the cell with their weights and neighbours.
            let mut arms = Vec::with_capacity(cell.len());
            for &(j, w) in cell {
                let j = j as usize;
                let arm = rotations[i] * Vector3::from(self.rest[i] - self.rest[j]);
                let residual = Vector3::from(positions[i] - positions[j]) - arm;
                made.energy += 0.5 * w * residual.norm_squared();
                for k in 0..3 {
                    made.gradient[3 * i + k] += 0.5 * w * residual[k];
                    made.gradient[3 * j + k] -= 0.5 * w * residual[k];
                    for (a, b, sign) in [(i, i, 0.5), (j, j, 0.5), (i, j, -0.5), (j, i, -0.5)] {
                        made.information[(3 * a + k, 3 * b + k)] += sign * w;
                    }
                }
                let cross = arm.cross_matrix();
                of_turn += 0.5 * w * cross.transpose() * cross;
                arms.push((j, 0.5 * w * cross));
            }
            let inverse = pseudo_inverse(&of_turn);
            // `Σ w [a]ₓᵀ (δ_i − δ_j)` by the displacements of the cell's points.
            let own = arms.iter().fold(Matrix3::zeros(), |sum, (_, cross)| sum + cross.transpose());
            let mut columns = vec![(i, own)];
            columns.extend(arms.iter().map(|(j, cross)| (*j, -cross.transpose())));
            for (a, by_a) in &columns {
                let left = by_a.transpose() * inverse;
                for (b, by_b) in &columns {
                    let block = left * by_b;
                    let mut at = made.information.fixed_view_mut::<3, 3>(3 * a, 3 * b);
                    at -= block;
                }
            }
        }
        made
    }
}

/// The inverse of a positive semidefinite matrix on the directions in which it is not zero.
fn pseudo_inverse(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    let eigen = matrix.symmetric_eigen();
    let limit = FREE_TURN * eigen.eigenvalues.amax();
    let inverted = eigen.eigenvalues.map(|e| if e > limit { 1.0 / e } else { 0.0 });
    eigen.eigenvectors * Matrix3::from_diagonal(&inverted) * eigen.eigenvectors.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{automatic_controls, stiffness};
    use planish_mesh::icosphere;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn ball() -> (Vec<DVec3>, Rigidity) {
        let controls = automatic_controls(&icosphere(1.0, 3), 25).unwrap();
        let k = stiffness(&controls.points, &controls.triangles, &controls.edges);
        let made = Rigidity::new(&controls.points, &controls.edges, &k).unwrap();
        (controls.points, made)
    }

    fn shaken(points: &[DVec3], by: f64, random: &mut ChaCha8Rng) -> Vec<DVec3> {
        let mut number = || random.random_range(-by..by);
        points.iter().map(|p| *p + DVec3::new(number(), number(), number())).collect()
    }

    /// The gradient is that of the energy, at positions far from rest.
    #[test]
    fn gradient_agrees_with_differences() {
        let (points, rigidity) = ball();
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let at = shaken(&points, 0.4, &mut random);
        let made = rigidity.linearised(&at);
        assert!((made.energy - rigidity.energy(&at)).abs() < 1e-12 * made.energy);
        for k in [0, 7, 31, 74] {
            let moved = |step: f64| {
                let mut all = at.clone();
                all[k / 3][k % 3] += step;
                rigidity.energy(&all)
            };
            let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            assert!((2.0 * made.gradient[k] - difference).abs() < 1e-6, "{k}: {difference}");
        }
    }

    /// The information is the second derivative at rest and after any rotation, where residuals are zero. It
    /// vanishes for the six rigid motions only, and is positive semidefinite elsewhere.
    #[test]
    fn information_agrees_with_differences() {
        let (points, rigidity) = ball();
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let turned: Vec<DVec3> = points.iter().map(|p| DVec3::new(-p[1], p[0], p[2])).collect();
        for at in [&points, &turned] {
            let made = rigidity.linearised(at);
            let by = shaken(&vec![DVec3::ZERO; points.len()], 1.0, &mut random);
            let step = 1e-4;
            let moved: Vec<DVec3> = at.iter().zip(&by).map(|(p, d)| *p + step * *d).collect();
            let flat = DVector::from_fn(3 * by.len(), |k, _| by[k / 3][k % 3]);
            let expected = rigidity.energy(&moved) / (step * step);
            let found = flat.dot(&(&made.information * &flat));
            assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
            let eigen = made.information.symmetric_eigenvalues();
            assert_eq!(eigen.iter().filter(|e| e.abs() < 1e-9 * eigen.amax()).count(), 6);
        }
        let eigen =
            rigidity.linearised(&shaken(&points, 0.5, &mut random)).information.symmetric_eigenvalues();
        assert!(eigen.min() > -1e-9 * eigen.max());
    }

    /// Inputs of wrong sizes are refused.
    #[test]
    fn sizes_are_checked() {
        let (points, _) = ball();
        assert!(Rigidity::new(&points, &[], &DMatrix::zeros(3, 3)).is_err());
        assert!(Rigidity::new(&points[..2], &[[0, 2]], &DMatrix::zeros(2, 2)).is_err());
    }
}
