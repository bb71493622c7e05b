//! Positions measured along one direction each, accumulated by leaf as moments.
//!
//! Input: a stream of scalar readings `a · S(x, y) = z` by leaf. Output: the information about the nodes. A
//! reading takes 340 multiply-adds instead of the 960 of [`CellInformation::add_scalar`], and the sums of a
//! leaf a quarter of the memory. This suits clouds that arrive in many parts. See
//! [`crate::moments`](CellMoments) for the map from moments to information.

use crate::cell_information::CellInformation;
use crate::hierarchy::Hierarchy;
use crate::moments::{matrix_of_moments, vector_of_moments};
use crate::system::SurfaceSystem;
use planish_core::DVec3;
use planish_estimate::sparse::BlockInformation;
use planish_estimate::{Error, Result};
use rayon::prelude::*;
use std::sync::Arc;

/// Moments of the readings on one leaf.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DirectedMoments {
    /// `Σ w a_p a_q sⁱ tʲ` at `[pq][j][i]` for `pq = xx xy xz yy yz zz`, `s, t ∈ [−1, 1]`; the last column
    /// stays zero.
    gram: [[[f64; 8]; 7]; 6],
    /// `Σ w z a_d sⁱ tʲ` at `[d][j][i]`.
    values: [[[f64; 4]; 4]; 3],
}

impl Default for DirectedMoments {
    fn default() -> Self {
        Self { gram: [[[0.0; 8]; 7]; 6], values: [[[0.0; 4]; 4]; 3] }
    }
}

impl DirectedMoments {
    /// Adds the reading `a · Σ_k b_k P_k = value` at local coordinates in `[0, 1]²`, with information `w`
    /// (1/variance).
    #[inline]
    pub fn add(&mut self, local: [f64; 2], a: DVec3, value: f64, information: f64) {
        // On [−1, 1] the map from moments to information is well conditioned; on [0, 1] all powers are alike.
        let [s, t] = local.map(|x| 2.0 * x - 1.0);
        let (s2, w) = (s * s, information);
        let s4 = s2 * s2;
        let powers = [1.0, s, s2, s2 * s, s4, s4 * s, s4 * s2, 0.0];
        let DVec3 { x, y, z } = w * a;
        // The six products of a symmetric `a aᵀ`.
        let products = [x * a[0], x * a[1], x * a[2], y * a[1], y * a[2], z * a[2]];
        let mut row_power = 1.0;
        for j in 0..7 {
            let row = powers.map(|p| p * row_power);
            for (gram, product) in self.gram.iter_mut().zip(products) {
                for (sum, p) in gram[j].iter_mut().zip(row) {
                    *sum += product * p;
                }
            }
            if j < 4 {
                for (sums, a) in self.values.iter_mut().zip([x, y, z]) {
                    for i in 0..4 {
                        sums[j][i] += a * value * row[i];
                    }
                }
            }
            row_power *= t;
        }
    }

    fn add_to(&self, cell: &mut CellInformation) {
        cell.add_triangles(&self.gram.each_ref().map(matrix_of_moments), &vector_of_moments(&self.values));
    }
}

/// Sums over the leaves of a hierarchy.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{DirectedSums, Hierarchy, Shape, SurfaceSystem};
/// use std::sync::Arc;
///
/// let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [4, 4])?);
/// let mut sums = DirectedSums::new(&space);
/// sums.add(|leaf, moments| {
///     if leaf == 5 {
///         moments.add([0.5, 0.5], DVec3::Z, 2.0, 4.0);
///     }
/// });
/// let information = sums.information(&SurfaceSystem::new(&space)?)?;
/// // A shift along z is measured, one along x is not.
/// let up = [0.0, 0.0, 1.0].repeat(space.node_count());
/// let shifted = [1.0, 0.0, 0.0].repeat(space.node_count());
/// assert!((information.quadratic_form(&up)? - 4.0).abs() < 1e-12);
/// assert_eq!(information.quadratic_form(&shifted)?, 0.0);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct DirectedSums {
    space: Arc<Hierarchy>,
    leaves: Vec<DirectedMoments>,
}

impl DirectedSums {
    /// Empty sums. Memory: 3 KB per leaf.
    #[must_use]
    pub fn new(space: &Arc<Hierarchy>) -> Self {
        Self { space: Arc::clone(space), leaves: vec![DirectedMoments::default(); space.leaves().len()] }
    }

    /// Adds the readings of each leaf in parallel. The result has the same bytes for any number of threads.
    pub fn add(&mut self, fill: impl Fn(usize, &mut DirectedMoments) + Sync) {
        (self.leaves.par_iter_mut().enumerate())
            .with_min_len(16)
            .for_each(|(leaf, moments)| fill(leaf, moments));
    }

    /// The information about the nodes, three unknowns each.
    ///
    /// # Errors
    /// `Input` when the system belongs to another hierarchy.
    pub fn information(&self, system: &SurfaceSystem) -> Result<BlockInformation> {
        if system.space().leaves() != self.space.leaves() {
            return Err(Error::input("the system belongs to another hierarchy"));
        }
        // Moments are converted once per leaf, not once per reading.
        system.accumulate(|leaf, cell| {
            let moments = &self.leaves[leaf];
            // For any direction at least one of the entries xx, yy and zz is positive.
            let any = moments.gram.iter().any(|gram| gram[0][0] != 0.0);
            if any {
                moments.add_to(cell);
            }
            any
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hierarchy::Shape;
    use crate::surface::leaf_weights;

    #[test]
    fn moments_equal_the_direct_accumulation() {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [5, 3]).unwrap().refine(&[6, 7]));
        let system = SurfaceSystem::new(&space).unwrap();
        // Readings with directions in all octants.
        let readings = |leaf: usize| {
            (0..7 * usize::from(!leaf.is_multiple_of(4))).map(move |k| {
                let x = (leaf * 7 + k) as f64;
                let (a, b) = (x * 0.618_034, x * 0.754_878);
                let direction = DVec3::new(a.cos() * b.sin(), a.sin() * b.sin(), b.cos());
                ([a.fract(), b.fract()], direction, 3.0 * a.sin(), 1.0 + b.fract())
            })
        };
        let plain = system
            .accumulate(|leaf, cell| {
                let mut any = false;
                for (local, direction, value, w) in readings(leaf) {
                    cell.add_scalar(&leaf_weights(local[0], local[1]), direction, value, w);
                    any = true;
                }
                any
            })
            .unwrap();
        let mut sums = DirectedSums::new(&space);
        sums.add(|leaf, moments| {
            for (local, direction, value, w) in readings(leaf) {
                moments.add(local, direction, value, w);
            }
        });
        let found = sums.information(&system).unwrap();
        let largest = plain.values().iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        for (a, b) in found.values().iter().zip(plain.values()) {
            assert!((a - b).abs() < 1e-12 * largest, "{a} {b}");
        }
        for (a, b) in found.vector().iter().zip(plain.vector()) {
            assert!((a - b).abs() < 1e-12 * largest, "{a} {b}");
        }
    }
}
