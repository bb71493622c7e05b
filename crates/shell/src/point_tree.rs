//! Nearest points, by a k-d tree.
//!
//! In: points. Out: for a place, its nearest ones with their distances, nearest first; equal distances in the
//! order of the points. Of several points at the largest distance, the tree chooses which are among the
//! nearest, always the same ones for the same points. Cost: `n log n` to build, about `log n` for each
//! neighbour.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Matrix3, Vector3};
use planish_core::DVec3;
use planish_core::vector3::as_arrays;
use planish_estimate::{Error, Result};
use std::num::NonZero;

/// Points that can be searched.
pub(crate) struct PointTree {
    /// `None` if there are no points.
    tree: Option<ImmutableKdTree<f64, 3>>,
}

impl PointTree {
    /// # Errors
    /// `Undetermined` for points that cannot be searched, such as ones that are not finite.
    pub(crate) fn new(points: &[DVec3]) -> Result<Self> {
        let tree = match points.is_empty() {
            true => None,
            false => Some(ImmutableKdTree::new_from_slice(as_arrays(points)).map_err(|e| {
                Error::undetermined(format!("the points cannot be searched for neighbours: {e:?}"))
            })?),
        };
        Ok(Self { tree })
    }

    /// The `count` nearest points with their distances; fewer if there are fewer.
    pub(crate) fn nearest(&self, at: DVec3, count: usize) -> Vec<(f64, u32)> {
        let (Some(tree), Some(count)) = (&self.tree, NonZero::new(count)) else {
            return Vec::new();
        };
        let near = tree.query(at.as_ref()).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        let mut found: Vec<(f64, u32)> = near.iter().map(|n| (n.distance.sqrt(), n.item)).collect();
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found
    }

    /// The nearest point with its distance; `None` if there are no points.
    pub(crate) fn nearest_one(&self, at: DVec3) -> Option<(f64, u32)> {
        let found = self.tree.as_ref()?.query(at.as_ref()).nearest_one::<SquaredEuclidean<f64>>().execute();
        Some((found.distance.sqrt(), found.item))
    }
}

/// A plane through points.
pub(crate) struct PlaneFit {
    pub center: DVec3,
    /// Unit normal.
    pub normal: DVec3,
    /// Root mean square distance of the points from it.
    pub thickness: f64,
    /// The smaller rms extent of the points along it.
    pub width: f64,
}

impl PlaneFit {
    /// Distance of a place from the plane.
    pub(crate) fn distance(&self, at: DVec3) -> f64 {
        (at - self.center).dot(self.normal).abs()
    }
}

/// The plane through points with the least squared distances.
pub(crate) fn plane_through(points: &[DVec3]) -> PlaneFit {
    let per = 1.0 / points.len().max(1) as f64;
    let center = per * points.iter().sum::<DVec3>();
    let spread = points.iter().fold(Matrix3::zeros(), |sum, p| {
        let off = Vector3::from(*p - center);
        sum + per * off * off.transpose()
    });
    let eigen = spread.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let extent = |k: usize| eigen.eigenvalues[order[k]].max(0.0).sqrt();
    PlaneFit {
        center,
        normal: DVec3::from(eigen.eigenvectors.column(order[0]).into_owned()),
        thickness: extent(0),
        width: extent(1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The distances of the nearest points are those of an exhaustive search, also of equal points and beyond
    /// their number. Points at equal distances are in their order.
    #[test]
    fn nearest_points_agree_with_a_full_search() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut number = || f64::from(random.random_range(0..12_u32));
        let mut points: Vec<DVec3> = (0..500).map(|_| DVec3::new(number(), number(), number())).collect();
        points.extend([DVec3::ONE; 100]);
        let tree = PointTree::new(&points).unwrap();
        for _ in 0..50 {
            let at = 0.7 * DVec3::new(number(), number(), number());
            let mut all: Vec<f64> = points.iter().map(|p| p.distance(at)).collect();
            all.sort_by(f64::total_cmp);
            let found = tree.nearest(at, 9);
            for (k, (distance, i)) in found.iter().enumerate() {
                assert!((distance - all[k]).abs() < 1e-12);
                assert!((points[*i as usize].distance(at) - distance).abs() < 1e-12);
                assert!(k == 0 || found[k - 1].0 < *distance || found[k - 1].1 < *i);
            }
        }
        assert_eq!(tree.nearest(DVec3::ZERO, 900).len(), 600);
        assert!(PointTree::new(&[]).unwrap().nearest(DVec3::ZERO, 3).is_empty());
    }
}
