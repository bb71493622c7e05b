//! The triangle mesh: positions and triangles, with normals, area, volume and bounding box.
//!
//! A mesh may be open, non-manifold or have triangles without area; [`TriangleMesh::check`] reports this.

use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

use planish_core::{BoundingBox, DVec3};
use planish_estimate::{Error, Result};

mod check;
mod orientation;

use crate::edges::EdgeTable;
use crate::triangle;
pub use check::MeshCheck;

/// Cosine between the normals of two neighbouring triangles below which the edge is a fold (120°), if the
/// cosine was positive before the deformation.
///
/// A limit of 90° would report sharp bends of a deformed part as folds. A limit near 180° would find only
/// folds that are nearly closed.
const FOLDED_COSINE: f64 = -0.5;
/// Growth of an edge, relative to the median growth of all edges, above which it counts as stretched.
///
/// The median makes the count independent of a change of scale. A smaller factor reports uneven stretching as
/// spikes; a larger one misses small spikes.
const MAX_RELATIVE_GROWTH: f64 = 4.0;

/// Folds and spikes after the vertices of a mesh were moved; see [`TriangleMesh::distortion`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Distortion {
    /// Number of edges whose two triangles enclosed less than 90° (between normals) before, and more than
    /// 120° now.
    pub folds: usize,
    /// Number of edges that grew by more than four times the growth of the median edge (spikes).
    pub stretched: usize,
}

/// Triangles over shared vertices.
///
/// Invariants, tested by [`TriangleMesh::sanity_check`]: every position is finite, and every index is below
/// `positions.len()`. Triangles are counter-clockwise seen from outside. Triangles may contain a vertex
/// twice, and vertices may be unused.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_mesh::TriangleMesh;
/// let corners = vec![DVec3::ZERO, 2.0 * DVec3::X, DVec3::Y];
/// let mesh = TriangleMesh::try_new(corners.clone(), vec![[0, 1, 2]])?;
/// assert_eq!((mesh.area(), mesh.face_normals()[0]), (1.0, DVec3::Z));
/// assert!(TriangleMesh::try_new(corners, vec![[0, 1, 3]]).is_err());
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriangleMesh {
    /// Vertex positions in the unit of the model.
    pub positions: Vec<DVec3>,
    /// Three vertex indices for each triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// Creates a mesh and checks its invariants.
    ///
    /// # Errors
    /// `Input` for a position that is not finite, an index beyond the vertices, or too many vertices or
    /// triangles for 32-bit indices (each triangle needs three half-edges).
    pub fn try_new(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Result<Self> {
        let mesh = Self { positions, triangles };
        mesh.sanity_check()?;
        Ok(mesh)
    }

    /// Checks the invariants of the type.
    ///
    /// # Errors
    /// As [`TriangleMesh::try_new`].
    pub fn sanity_check(&self) -> Result<()> {
        if self.positions.len() > u32::MAX as usize || self.triangles.len() > (u32::MAX / 3) as usize {
            return Err(Error::input(format!(
                "expected at most {} vertices and {} triangles in a mesh, found {} and {}: cut it into \
                 parts",
                u32::MAX,
                u32::MAX / 3,
                self.positions.len(),
                self.triangles.len()
            )));
        }
        if let Some(at) = self.positions.iter().position(|p| !p.is_finite()) {
            let p = self.positions[at];
            return Err(Error::input(format!(
                "vertex {at}: expected finite coordinates, found ({}, {}, {})",
                p[0], p[1], p[2]
            )));
        }
        let count = self.positions.len();
        if let Some(at) = self.triangles.iter().position(|t| t.iter().any(|&i| i as usize >= count)) {
            return Err(Error::input(format!(
                "triangle {at}: expected vertices below {count} (counted from 0), found {:?}",
                self.triangles[at]
            )));
        }
        Ok(())
    }

    /// The corners of triangle `index`.
    ///
    /// # Panics
    /// If there is no such triangle.
    #[inline]
    #[must_use]
    pub fn corners(&self, index: usize) -> [DVec3; 3] {
        self.triangles[index].map(|i| self.positions[i as usize])
    }

    /// The point `Σ b_k corner_k` of triangle `index`.
    ///
    /// # Panics
    /// If there is no such triangle.
    #[must_use]
    pub fn point_at(&self, index: usize, barycentric: [f64; 3]) -> DVec3 {
        triangle::point_at(&self.corners(index), barycentric)
    }

    /// Interpolates vertex values linearly at a point of triangle `index`.
    ///
    /// # Panics
    /// If there is no such triangle, or fewer values than vertices.
    #[must_use]
    pub fn interpolate(&self, values: &[f64], index: usize, barycentric: [f64; 3]) -> f64 {
        let values = self.triangles[index].map(|i| values[i as usize]);
        (0..3).map(|k| values[k] * barycentric[k]).sum()
    }

    /// The unit normal of each triangle; zero if it has no area.
    #[must_use]
    pub fn face_normals(&self) -> Vec<DVec3> {
        (0..self.triangles.len()).map(|t| triangle::unit_normal(&self.corners(t))).collect()
    }

    /// The unit normal of each vertex: the mean of its triangle normals, weighted by their angles there.
    ///
    /// Zero for a vertex without triangles, or if the normals cancel. Cost O(triangles).
    ///
    /// # References
    /// Thürmer and Wüthrich, *Computing vertex normals from polygonal facets*, Journal of Graphics Tools
    /// 1998.
    #[must_use]
    pub fn vertex_normals(&self) -> Vec<DVec3> {
        // Angles are the expensive part and computed in parallel. The sums have a fixed order, so that
        // results do not depend on the number of threads.
        let of_triangles: Vec<(DVec3, [f64; 3])> = (0..self.triangles.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(|t| {
                let position = self.corners(t);
                (triangle::unit_normal(&position), triangle::angles(&position))
            })
            .collect();
        let mut normals = vec![DVec3::ZERO; self.positions.len()];
        for (corners, (normal, angles)) in self.triangles.iter().zip(of_triangles) {
            for k in 0..3 {
                let sum = &mut normals[corners[k] as usize];
                *sum += angles[k] * normal;
            }
        }
        normals.into_iter().map(triangle::unit_or_zero).collect()
    }

    /// The sum of the triangles' areas.
    #[must_use]
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|t| triangle::area(&self.corners(t))).sum()
    }

    /// The enclosed volume, positive if the triangles face outwards; `None` unless the mesh is watertight and
    /// consistently oriented. Overlapping parts count twice. Cost: one [`TriangleMesh::check`].
    #[must_use]
    pub fn signed_volume(&self) -> Option<f64> {
        let check = self.check();
        if !(check.watertight && check.oriented) {
            return None;
        }
        // Relative to the centre of the box: a far origin would lose digits by cancellation.
        let origin = self.bounding_box()?.center();
        let six_volumes = (0..self.triangles.len()).map(|t| {
            let [a, b, c] = self.corners(t).map(|p| p - origin);
            a.dot(b.cross(c))
        });
        Some(six_volumes.sum::<f64>() / 6.0)
    }

    /// The box around all vertices, used or not; `None` without vertices.
    #[must_use]
    pub fn bounding_box(&self) -> Option<BoundingBox> {
        BoundingBox::from_points(&self.positions)
    }

    /// The box around the vertices of triangles. Unused vertices, which may be far away, are ignored.
    #[must_use]
    pub fn surface_bounds(&self) -> Option<BoundingBox> {
        let corners = self.triangles.iter().flatten();
        BoundingBox::around(corners.map(|v| self.positions[*v as usize]))
    }

    /// The triangles without duplicates. A duplicate has the same three positions as an earlier triangle, in
    /// any order.
    #[must_use]
    pub fn triangles_once(&self) -> Vec<[u32; 3]> {
        let mut known = HashSet::with_capacity(self.triangles.len());
        let key = |t: &[u32; 3]| {
            // Adding zero turns −0 into 0, so that both have the same key.
            let mut corners = t.map(|v| self.positions[v as usize].to_array().map(|x| (x + 0.0).to_bits()));
            corners.sort_unstable();
            corners
        };
        let first = |t: &&[u32; 3]| known.insert(key(t));
        self.triangles.iter().filter(first).copied().collect()
    }

    /// Counts the folds and spikes that appear if the vertices move to the positions `now`.
    ///
    /// # Panics
    /// If `now` has fewer positions than the mesh has vertices.
    #[must_use]
    pub fn distortion(&self, now: &[DVec3]) -> Distortion {
        let normal =
            |t: usize, at: &[DVec3]| triangle::unit_normal(&self.triangles[t].map(|v| at[v as usize]));
        let table = EdgeTable::new(&self.triangles);
        // Only edges that were not sharp before can fold: a sharp edge of the original is no defect.
        let folded = |edge: usize| {
            let [a, b] = *table.half_edges(edge) else {
                return false;
            };
            let [a, b] = [a, b].map(|half| half as usize / 3);
            let cosine = |at: &[DVec3]| normal(a, at).dot(normal(b, at));
            cosine(&self.positions) > 0.0 && cosine(now) < FOLDED_COSINE
        };
        let length = |at: &[DVec3], [a, b]: [u32; 2]| at[a as usize].distance(at[b as usize]);
        let mut stretches: Vec<f64> = (table.ends.iter())
            .map(|ends| length(now, *ends) / length(&self.positions, *ends))
            // Edges without length have no growth.
            .filter(|stretch| stretch.is_finite())
            .collect();
        stretches.sort_unstable_by(f64::total_cmp);
        // Relative to the median, so that a uniform change of size is no distortion.
        let median = stretches.get(stretches.len() / 2).copied().unwrap_or(1.0);
        Distortion {
            folds: (0..table.len()).filter(|edge| folded(*edge)).count(),
            stretched: stretches.len()
                - stretches.partition_point(|stretch| *stretch <= MAX_RELATIVE_GROWTH * median),
        }
    }

    /// Checks the topology: open or closed, manifold, oriented, number of components. Cost O(n log n).
    #[must_use]
    pub fn check(&self) -> MeshCheck {
        MeshCheck::new(self)
    }

    /// Merges vertices with equal coordinates; unused vertices stay. Triangle soups (STL) have no shared
    /// vertices, so that [`TriangleMesh::check`] is meaningful only afterwards.
    #[must_use]
    pub fn welded(&self) -> Self {
        let mut first = HashMap::with_capacity(self.positions.len());
        let mut positions = Vec::with_capacity(self.positions.len());
        let new_from_old: Vec<u32> = self
            .positions
            .iter()
            .map(|&p| {
                // Adding zero turns −0 into 0, so that both have the same key.
                *first.entry(p.to_array().map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
                    positions.push(p);
                    (positions.len() - 1) as u32
                })
            })
            .collect();
        let triangles = self.triangles.iter().map(|t| t.map(|i| new_from_old[i as usize])).collect();
        Self { positions, triangles }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{cylinder, grid_sheet, icosphere};
    use planish_estimate::ErrorKind;
    use std::f64::consts::PI;

    #[test]
    fn invalid_indices_and_coordinates_are_rejected() {
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let beyond = TriangleMesh::try_new(positions.clone(), vec![[0, 1, 2], [0, 1, 3]]).unwrap_err();
        assert_eq!(beyond.kind(), ErrorKind::Input);
        assert!(beyond.to_string().contains("triangle 1"), "{beyond}");
        let mut holed = positions;
        holed[2][1] = f64::NAN;
        assert!(TriangleMesh::try_new(holed, vec![]).unwrap_err().to_string().contains("vertex 2"));
    }

    #[test]
    fn measures_of_known_bodies() {
        let ball = icosphere(2.0, 5);
        assert!((ball.area() / (4.0 * PI * 4.0) - 1.0).abs() < 1e-3);
        assert!((ball.signed_volume().unwrap() / (4.0 / 3.0 * PI * 8.0) - 1.0).abs() < 2e-3);
        let can = cylinder(1.0, 3.0, 256, 4, true);
        assert!((can.signed_volume().unwrap() / (3.0 * PI) - 1.0).abs() < 1e-3);
        let sheet = grid_sheet(2.0, 3.0, 5, 7);
        assert!((sheet.area() - 6.0).abs() < 1e-12);
        assert_eq!(sheet.signed_volume(), None);
        let b = sheet.bounding_box().unwrap();
        assert_eq!((b.min, b.max), (DVec3::new(-1.0, -1.5, 0.0), DVec3::new(1.0, 1.5, 0.0)));
    }

    #[test]
    fn volume_is_accurate_far_from_the_origin() {
        let mut ball = icosphere(1.0, 3);
        let near = ball.signed_volume().unwrap();
        for p in &mut ball.positions {
            *p += DVec3::new(1e6, -1e6, 1e6);
        }
        assert!((ball.signed_volume().unwrap() - near).abs() < 1e-8);
    }

    #[test]
    fn vertex_normals_do_not_depend_on_the_triangulation_of_flat_faces() {
        // A corner of a cube with one side cut into two triangles: with angle weights, all three sides still
        // count equally.
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(1.0, 1.0, 0.0)];
        let mesh =
            TriangleMesh::try_new(positions, vec![[0, 4, 1], [0, 2, 4], [0, 1, 3], [0, 3, 2]]).unwrap();
        let expected = -1.0 / 3.0_f64.sqrt();
        assert!(mesh.vertex_normals()[0].abs_diff_eq(DVec3::splat(expected), 1e-12));
    }

    #[test]
    fn vertex_normals_of_a_ball_point_outwards() {
        let ball = icosphere(3.0, 4);
        for (p, n) in ball.positions.iter().zip(ball.vertex_normals()) {
            assert!(p.dot(n) / 3.0 > 0.9999);
        }
        for (t, n) in ball.face_normals().iter().enumerate() {
            assert!(ball.corners(t)[0].dot(*n) > 0.0);
        }
    }

    #[test]
    fn welding_closes_a_soup() {
        let ball = icosphere(1.0, 2);
        let soup = TriangleMesh {
            positions: (0..ball.triangles.len()).flat_map(|t| ball.corners(t)).collect(),
            triangles: (0..ball.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        };
        assert!(!soup.check().watertight);
        let welded = soup.welded();
        assert_eq!(welded.positions.len(), ball.positions.len());
        assert!(welded.check().watertight);
    }

    /// Duplicate faces count once, also with other vertices and the opposite orientation. Unused vertices do
    /// not enlarge the bounds. A displaced vertex is a spike, and a sheet that is turned over has folds.
    #[test]
    fn duplicates_unused_vertices_folds_and_spikes_are_recognised() {
        let ball = crate::primitives::icosphere(1.0, 2);
        let mut double = ball.clone();
        let count = ball.positions.len() as u32;
        double.positions.extend_from_slice(&ball.positions);
        double.triangles.extend(ball.triangles.iter().map(|[a, b, c]| [a + count, c + count, b + count]));
        double.triangles.extend_from_slice(&ball.triangles);
        double.positions.push(DVec3::splat(500.0));
        assert_eq!(double.triangles_once(), ball.triangles);
        assert_eq!(double.surface_bounds(), ball.bounding_box());
        let none = Distortion { folds: 0, stretched: 0 };
        assert_eq!(ball.distortion(&ball.positions), none);
        let scaled: Vec<DVec3> = ball.positions.iter().map(|p| 9.0 * *p).collect();
        assert_eq!(ball.distortion(&scaled), none);
        let mut spiked = ball.positions.clone();
        spiked[0] = 3.0 * spiked[0];
        assert_eq!(ball.distortion(&spiked).stretched, 5);
        let sheet = crate::primitives::grid_sheet(1.0, 1.0, 5, 5);
        let mut folded = sheet.positions.clone();
        for p in folded.iter_mut().filter(|p| p[0] > 0.1) {
            *p = DVec3::new(-p[0], p[1], 0.05);
        }
        assert!(sheet.distortion(&folded).folds >= 4);
    }
}
