//! Random points on a surface with uniform density.
//!
//! In: a mesh, and uniform random numbers in [0, 1) from the caller, who controls the seed. Out: points with
//! uniform density per area. Not guaranteed: spacing; points are independent and may lie close together.

use planish_core::DVec3;
use planish_estimate::{Error, Result};

use crate::mesh::TriangleMesh;
use crate::triangle::{area, point_at, unit_normal};

/// A point on a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Position.
    pub position: DVec3,
    /// Unit normal of the triangle.
    pub normal: DVec3,
    /// Index of the triangle.
    pub triangle: u32,
    /// Barycentric coordinates in the triangle.
    pub barycentric: [f64; 3],
}

/// Draws random points with uniform density from the surface of a mesh.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_mesh::{SurfaceSampler, grid_sheet};
/// let sheet = grid_sheet(2.0, 2.0, 3, 3);
/// let sampler = SurfaceSampler::try_new(&sheet)?;
/// let point = sampler.sample(&mut || 0.5);
/// assert_eq!((point.position[2], point.normal), (0.0, DVec3::Z));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct SurfaceSampler<'a> {
    mesh: &'a TriangleMesh,
    /// For each triangle, the total area up to and including it.
    cumulative: Vec<f64>,
    total: f64,
}

impl<'a> SurfaceSampler<'a> {
    /// Prepares a mesh for sampling. Cost O(triangles).
    ///
    /// # Errors
    /// `Undetermined` if the mesh has no area.
    pub fn try_new(mesh: &'a TriangleMesh) -> Result<Self> {
        let mut total = 0.0;
        let cumulative: Vec<f64> = (0..mesh.triangles.len())
            .map(|t| {
                total += area(&mesh.corners(t));
                total
            })
            .collect();
        if !(total > 0.0 && total.is_finite()) {
            return Err(Error::undetermined(format!(
                "expected a surface with a positive area, found {total} in {} triangles",
                mesh.triangles.len()
            )));
        }
        Ok(Self { mesh, cumulative, total })
    }

    /// Draws one point with three numbers from `uniform`, which must lie in [0, 1). Cost O(log triangles).
    pub fn sample(&self, uniform: &mut impl FnMut() -> f64) -> SurfacePoint {
        let target = uniform() * self.total;
        // The first triangle whose total exceeds the target; a triangle without area never is. Rounding can
        // make the target equal to the whole area: then the last triangle with an area is selected.
        let found = self.cumulative.partition_point(|&end| end <= target);
        let triangle = if found < self.cumulative.len() {
            found
        } else {
            self.cumulative.partition_point(|&end| end < self.total).min(self.cumulative.len() - 1)
        };
        // The square root makes the density uniform (Osada and others 2002, eq. 1).
        let (root, v) = (uniform().sqrt(), uniform());
        let barycentric = [1.0 - root, root * (1.0 - v), root * v];
        let corners = self.mesh.corners(triangle);
        SurfacePoint {
            position: point_at(&corners, barycentric),
            normal: unit_normal(&corners),
            triangle: triangle as u32,
            barycentric,
        }
    }
}

/// Draws `count` points with uniform density per area.
///
/// # Errors
/// `Undetermined` if the mesh has no area.
///
/// # Examples
/// ```
/// # fn main() -> planish_estimate::Result<()> {
/// let ball = planish_mesh::icosphere(1.0, 3);
/// let mut state = 1_u64;
/// let uniform = || {
///     state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
///     (state >> 11) as f64 / (1_u64 << 53) as f64
/// };
/// assert_eq!(planish_mesh::sample_points(&ball, 100, uniform)?.len(), 100);
/// # Ok(())
/// # }
/// ```
///
/// # References
/// Osada, Funkhouser, Chazelle, Dobkin, *Shape Distributions*, ACM Transactions on Graphics 2002, eq. 1.
pub fn sample_points(
    mesh: &TriangleMesh,
    count: usize,
    mut uniform: impl FnMut() -> f64,
) -> Result<Vec<SurfacePoint>> {
    let sampler = SurfaceSampler::try_new(mesh)?;
    Ok((0..count).map(|_| sampler.sample(&mut uniform)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{grid_sheet, icosphere};
    use planish_estimate::ErrorKind;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn density_follows_area_not_triangles() {
        // One half of the sheet is cut into many more triangles; both halves must get half of the points.
        let mut mesh = grid_sheet(1.0, 1.0, 20, 20);
        for p in &mut mesh.positions {
            p[0] = if p[0] < 0.3 { (p[0] + 0.5) / 0.8 * 0.5 - 0.5 } else { (p[0] - 0.3) / 0.2 * 0.5 };
        }
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let points = sample_points(&mesh, 40_000, || random.random::<f64>()).unwrap();
        // Chi-square over a 4 × 4 grid of equal areas: 15 degrees of freedom, 0.999 quantile 37.7.
        let mut counts = [0_usize; 16];
        for p in &points {
            let cell = |x: f64| (((x + 0.5) * 4.0) as usize).min(3);
            counts[cell(p.position[0]) + 4 * cell(p.position[1])] += 1;
            assert!(p.normal[2] > 1.0 - 1e-15);
        }
        let chi: f64 = counts.iter().map(|&c| (c as f64 - 2500.0).powi(2) / 2500.0).sum();
        assert!(chi < 37.7, "{chi} {counts:?}");
    }

    #[test]
    fn a_seed_gives_the_same_points_and_they_lie_on_their_triangle() {
        let ball = icosphere(1.0, 2);
        let draw = || {
            let mut random = ChaCha8Rng::seed_from_u64(9);
            sample_points(&ball, 500, || random.random::<f64>()).unwrap()
        };
        let points = draw();
        assert_eq!(points, draw());
        for p in points {
            assert!(ball.point_at(p.triangle as usize, p.barycentric).distance(p.position) < 1e-15);
            assert!(p.barycentric.iter().all(|&b| (0.0..=1.0).contains(&b)));
        }
    }

    #[test]
    fn triangles_without_area_are_never_drawn() {
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(2.0, 0.0, 0.0)];
        let mesh = TriangleMesh::try_new(positions, vec![[0, 1, 3], [0, 1, 2], [0, 0, 1]]).unwrap();
        let sampler = SurfaceSampler::try_new(&mesh).unwrap();
        for u in [0.0, 0.5, 1.0 - f64::EPSILON / 2.0, 1.0] {
            assert_eq!(sampler.sample(&mut || u).triangle, 1);
        }
        let flat = TriangleMesh { triangles: vec![[0, 1, 3]], ..mesh };
        assert_eq!(SurfaceSampler::try_new(&flat).unwrap_err().kind(), ErrorKind::Undetermined);
    }
}
