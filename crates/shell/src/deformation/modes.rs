//! Deformations by the principal modes of a family of meshes, and by independent vertices.
//!
//! In: meshes of one connectivity. Out: `V = V0 + Σ_m q_m M_m`, where each mode is scaled to the family's
//! standard deviation along it, so that `q` is of order one for members of the family (V. Blanz, T. Vetter
//! 1999).
//!
//! Not guaranteed: the meshes are not aligned. Rotations between them are not linear and need many modes.

use super::Deformation;
use nalgebra::DMatrix;
use planish_core::DVec3;
use planish_estimate::{Error, Result};

/// Modes below this share of the largest standard deviation are rounding errors. The eigenvalues are squares,
/// so their rounding of 1e-16 becomes 1e-8.
const ROUNDING: f64 = 1e-7;

/// Principal modes of a family of meshes.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_shell::{Deformation, Modes};
/// let family: Vec<Vec<DVec3>> = [-1.0, 0.0, 1.0].iter().map(|z| vec![*z * DVec3::Z; 4]).collect();
/// let modes = Modes::from_meshes(&family, 5)?;
/// assert_eq!(modes.parameters(), 1);
/// assert_eq!(modes.mean()[0], DVec3::ZERO);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Modes {
    mean: Vec<DVec3>,
    /// For each mode the displacement of each vertex.
    modes: Vec<Vec<DVec3>>,
    deviations: Vec<f64>,
}

impl Modes {
    /// Computes the largest modes of a family, at most `max_modes`. Entry `v` of every member is the same
    /// vertex.
    ///
    /// # Errors
    /// `Input` for fewer than two members, or members with different numbers of vertices; `Undetermined` if
    /// all are equal.
    pub fn from_meshes(family: &[Vec<DVec3>], max_modes: usize) -> Result<Self> {
        let Some(first) = family.first().filter(|_| family.len() > 1) else {
            return Err(Error::input("expected at least two meshes for principal modes"));
        };
        if let Some(other) = family.iter().position(|member| member.len() != first.len()) {
            return Err(Error::input(format!(
                "mesh {other} of the family: expected as many vertices as in the first, found {} instead \
                 of {}",
                family[other].len(),
                first.len()
            )));
        }
        let count = family.len();
        let mean: Vec<DVec3> = (0..first.len())
            .map(|v| 1.0 / count as f64 * family.iter().fold(DVec3::ZERO, |sum, member| sum + member[v]))
            .collect();
        let off: Vec<Vec<DVec3>> =
            (family.iter()).map(|member| member.iter().zip(&mean).map(|(p, m)| *p - *m).collect()).collect();
        // There are few meshes with many vertices: the small Gram matrix has the same nonzero eigenvalues as
        // the large covariance.
        let products = DMatrix::from_fn(count, count, |i, j| {
            let pairs = off[i].iter().zip(&off[j]);
            pairs.map(|(a, b)| (0..3).map(|k| a[k] * b[k]).sum::<f64>()).sum::<f64>() / (count - 1) as f64
        });
        let eigen = products.symmetric_eigen();
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let deviation = |k: usize| eigen.eigenvalues[k].max(0.0).sqrt();
        let largest = deviation(order[0]);
        if largest == 0.0 || !largest.is_finite() {
            return Err(Error::undetermined("expected different meshes in the family, found all equal"));
        }
        order.retain(|&k| deviation(k) > ROUNDING * largest);
        // The mean uses up one degree of freedom.
        order.truncate(max_modes.min(count - 1));
        let modes = (order.iter())
            .map(|&k| {
                // Scales the mode to one standard deviation of the family.
                let factor = 1.0 / ((count - 1) as f64).sqrt();
                (0..first.len())
                    .map(|v| {
                        let sum = (0..count)
                            .fold(DVec3::ZERO, |sum, i| sum + eigen.eigenvectors[(i, k)] * off[i][v]);
                        factor * sum
                    })
                    .collect()
            })
            .collect();
        Ok(Self { mean, modes, deviations: order.iter().map(|&k| deviation(k)).collect() })
    }

    /// The mean of the family, to be used as `V0`.
    #[must_use]
    pub fn mean(&self) -> &[DVec3] {
        &self.mean
    }

    /// The family's standard deviation along each mode: the root of the mean sum of squares over all
    /// vertices.
    #[must_use]
    pub fn deviations(&self) -> &[f64] {
        &self.deviations
    }
}

impl Deformation for Modes {
    fn parameters(&self) -> usize {
        self.modes.len()
    }

    fn vertices(&self) -> usize {
        self.mean.len()
    }

    fn row(&self, vertex: u32, direction: DVec3, visit: &mut dyn FnMut(usize, f64)) {
        for (m, mode) in self.modes.iter().enumerate() {
            let by = mode[vertex as usize];
            visit(m, (0..3).map(|k| by[k] * direction[k]).sum());
        }
    }
}

/// Every vertex moves independently: three parameters each.
#[derive(Debug, Clone)]
pub struct VertexDisplacements {
    vertices: Vec<DVec3>,
}

impl VertexDisplacements {
    /// A deformation of these vertices.
    #[must_use]
    pub fn new(vertices: &[DVec3]) -> Self {
        Self { vertices: vertices.to_vec() }
    }
}

impl Deformation for VertexDisplacements {
    fn parameters(&self) -> usize {
        3 * self.vertices.len()
    }

    fn vertices(&self) -> usize {
        self.vertices.len()
    }

    fn row(&self, vertex: u32, direction: DVec3, visit: &mut dyn FnMut(usize, f64)) {
        for (axis, d) in direction.to_array().into_iter().enumerate() {
            visit(3 * vertex as usize + axis, d);
        }
    }

    fn controls(&self) -> Option<&[DVec3]> {
        Some(&self.vertices)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::displacements;
    use nalgebra::DVector;
    use planish_mesh::icosphere;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Meshes stretched in two directions have two modes, which reproduce every mesh.
    #[test]
    fn meshes_stretched_in_two_directions_have_two_modes() {
        let ball = icosphere(1.0, 2).positions;
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let family: Vec<Vec<DVec3>> = (0..12)
            .map(|_| {
                let [a, b] = [0.5, 0.1].map(|size| 1.0 + size * random.random_range(-1.0..1.0));
                ball.iter().map(|p| DVec3::new(a * p.x, b * p.y, p.z)).collect()
            })
            .collect();
        let modes = Modes::from_meshes(&family, 10).unwrap();
        assert_eq!(modes.parameters(), 2);
        let [first, second] = [0, 1].map(|k| modes.deviations()[k]);
        assert!(first > 2.0 * second);
        for member in &family {
            let q = DVector::from_fn(2, |m, _| {
                let mode = &modes.modes[m];
                let along: f64 = (mode.iter().zip(member).zip(modes.mean()))
                    .map(|((d, p), mean)| (0..3).map(|k| d[k] * (p[k] - mean[k])).sum::<f64>())
                    .sum();
                along / modes.deviations()[m].powi(2)
            });
            assert!(q.amax() < 3.5);
            for ((by, mean), p) in displacements(&modes, &q).iter().zip(modes.mean()).zip(member) {
                assert!((*mean + *by).distance(*p) < 1e-9);
            }
        }
        assert!(Modes::from_meshes(&family[..1], 3).is_err());
        assert!(
            Modes::from_meshes(&[ball.clone(), ball.clone()], 3)
                .unwrap_err()
                .to_string()
                .contains("different meshes")
        );
        assert!(
            Modes::from_meshes(&[ball.clone(), vec![DVec3::ZERO]], 3)
                .unwrap_err()
                .to_string()
                .contains("mesh 1")
        );
    }
}
