//! The triangle mesh.
//!
//! Comes in: positions in the model's unit and triangles of indices into them. Goes out: normals, area, volume, box.
//! Not guaranteed: manifoldness, closedness, or triangles with area; [`TriangleMesh::check`] tells.

use rayon::prelude::*;
use std::collections::HashMap;

use planish_estimate::vector3::{add, add_scaled, cross, distance, dot, scale, sub};
use planish_estimate::{Error, Result};

use crate::check::MeshCheck;
use crate::triangle;

/// Triangles over shared vertices.
///
/// Invariants, proved by [`TriangleMesh::sanity_check`]: every position is finite, every index is below
/// `positions.len()`. A triangle is counter-clockwise seen from outside. Triangles may name a vertex twice and vertices
/// may be unused.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriangleMesh {
    /// Vertex positions in the model's unit.
    pub positions: Vec<[f64; 3]>,
    /// Vertex indices, three to a triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// An axis-parallel box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundingBox {
    /// Least coordinates.
    pub min: [f64; 3],
    /// Greatest coordinates.
    pub max: [f64; 3],
}

impl BoundingBox {
    /// The box around points, `None` for no points.
    #[must_use]
    pub fn of(points: &[[f64; 3]]) -> Option<Self> {
        Self::around(points.iter().copied())
    }

    /// The box around points that come one by one, `None` for no points.
    pub fn around(mut points: impl Iterator<Item = [f64; 3]>) -> Option<Self> {
        let first = points.next()?;
        Some(points.fold(Self { min: first, max: first }, |b, p| Self {
            min: std::array::from_fn(|k| b.min[k].min(p[k])),
            max: std::array::from_fn(|k| b.max[k].max(p[k])),
        }))
    }

    /// The middle of the box.
    #[must_use]
    pub fn center(&self) -> [f64; 3] {
        scale(0.5, add(self.min, self.max))
    }

    /// The length of the space diagonal.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        distance(self.min, self.max)
    }
}

impl TriangleMesh {
    /// A mesh of checked positions and triangles.
    ///
    /// # Errors
    /// `Input` for a position that is not finite, an index beyond the vertices, or more vertices or triangles than 32-bit
    /// indices (and three half-edges a triangle) can number.
    pub fn try_new(positions: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> Result<Self> {
        let mesh = Self { positions, triangles };
        mesh.sanity_check()?;
        Ok(mesh)
    }

    /// Proves the invariants of the type.
    ///
    /// # Errors
    /// As [`TriangleMesh::try_new`].
    pub fn sanity_check(&self) -> Result<()> {
        if self.positions.len() > u32::MAX as usize || self.triangles.len() > (u32::MAX / 3) as usize {
            return Err(Error::input(format!(
                "a mesh holds at most {} vertices and {} triangles, found {} and {}: cut it into parts",
                u32::MAX,
                u32::MAX / 3,
                self.positions.len(),
                self.triangles.len()
            )));
        }
        if let Some(at) = self.positions.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
            let p = self.positions[at];
            return Err(Error::input(format!(
                "vertex {at} is not finite: ({}, {}, {})",
                p[0], p[1], p[2]
            )));
        }
        let count = self.positions.len();
        if let Some(at) = self
            .triangles
            .iter()
            .position(|t| t.iter().any(|&i| i as usize >= count))
        {
            return Err(Error::input(format!(
                "triangle {at} names vertices {:?}, but there are only {count} vertices (counted from 0)",
                self.triangles[at]
            )));
        }
        Ok(())
    }

    /// The corners of triangle `index`.
    ///
    /// # Panics
    /// Where there is no such triangle.
    #[inline]
    #[must_use]
    pub fn corners(&self, index: usize) -> [[f64; 3]; 3] {
        self.triangles[index].map(|i| self.positions[i as usize])
    }

    /// The point `Σ b_k corner_k` of triangle `index`.
    ///
    /// # Panics
    /// Where there is no such triangle.
    #[must_use]
    pub fn point_at(&self, index: usize, barycentric: [f64; 3]) -> [f64; 3] {
        triangle::point_at(&self.corners(index), barycentric)
    }

    /// The vertex values `values` interpolated linearly at a point of triangle `index`.
    ///
    /// # Panics
    /// Where there is no such triangle, or fewer values than vertices.
    #[must_use]
    pub fn interpolate(&self, values: &[f64], index: usize, barycentric: [f64; 3]) -> f64 {
        dot(self.triangles[index].map(|i| values[i as usize]), barycentric)
    }

    /// The unit normal of each triangle, zero where a triangle has no area.
    #[must_use]
    pub fn face_normals(&self) -> Vec<[f64; 3]> {
        (0..self.triangles.len())
            .map(|t| triangle::unit_normal(&self.corners(t)))
            .collect()
    }

    /// The unit normal of each vertex: the normals of its triangles weighted by their angle there.
    ///
    /// Zero for a vertex without triangles, or whose triangles cancel. Cost O(triangles).
    ///
    /// # References
    /// Thürmer and Wüthrich, *Computing vertex normals from polygonal facets*, Journal of Graphics Tools 1998.
    #[must_use]
    pub fn vertex_normals(&self) -> Vec<[f64; 3]> {
        // Angles take the time; they are added up in one order.
        let of_triangles: Vec<([f64; 3], [f64; 3])> = (0..self.triangles.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(|t| {
                let position = self.corners(t);
                (triangle::unit_normal(&position), triangle::angles(&position))
            })
            .collect();
        let mut normals = vec![[0.0; 3]; self.positions.len()];
        for (corners, (normal, angles)) in self.triangles.iter().zip(of_triangles) {
            for k in 0..3 {
                let sum = &mut normals[corners[k] as usize];
                *sum = add_scaled(*sum, angles[k], normal);
            }
        }
        normals.into_iter().map(triangle::unit_or_zero).collect()
    }

    /// The sum of the triangles' areas.
    #[must_use]
    pub fn area(&self) -> f64 {
        (0..self.triangles.len())
            .map(|t| triangle::area(&self.corners(t)))
            .sum()
    }

    /// The enclosed volume, positive where the triangles face outwards; `None` unless the mesh is watertight and
    /// consistently oriented. Parts that overlap count twice. Cost: one [`TriangleMesh::check`].
    #[must_use]
    pub fn signed_volume(&self) -> Option<f64> {
        let check = self.check();
        if !(check.watertight && check.oriented) {
            return None;
        }
        // From the middle of the box, so that a far-away origin costs no digits.
        let origin = self.bounding_box()?.center();
        let six_volumes = (0..self.triangles.len()).map(|t| {
            let [a, b, c] = self.corners(t).map(|p| sub(p, origin));
            dot(a, cross(b, c))
        });
        Some(six_volumes.sum::<f64>() / 6.0)
    }

    /// The box around all vertices, used or not; `None` without vertices.
    #[must_use]
    pub fn bounding_box(&self) -> Option<BoundingBox> {
        BoundingBox::of(&self.positions)
    }

    /// What kind of mesh this is: open, closed, manifold, oriented, of how many parts. Cost O(n log n).
    #[must_use]
    pub fn check(&self) -> MeshCheck {
        MeshCheck::of(self)
    }

    /// The same triangles over vertices merged where their coordinates are equal, first come first; unused vertices
    /// stay. Triangle soups (STL) need this before [`TriangleMesh::check`] says anything.
    #[must_use]
    pub fn welded(&self) -> Self {
        let mut first = HashMap::with_capacity(self.positions.len());
        let mut positions = Vec::with_capacity(self.positions.len());
        let new_from_old: Vec<u32> = self
            .positions
            .iter()
            .map(|&p| {
                // Adding zero makes −0 and 0 one key.
                *first.entry(p.map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
                    positions.push(p);
                    (positions.len() - 1) as u32
                })
            })
            .collect();
        let triangles = self
            .triangles
            .iter()
            .map(|t| t.map(|i| new_from_old[i as usize]))
            .collect();
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
    fn bad_indices_and_coordinates_are_refused() {
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let beyond = TriangleMesh::try_new(positions.clone(), vec![[0, 1, 2], [0, 1, 3]]).unwrap_err();
        assert_eq!(beyond.kind(), ErrorKind::Input);
        assert!(beyond.to_string().contains("triangle 1"), "{beyond}");
        let mut holed = positions;
        holed[2][1] = f64::NAN;
        assert!(
            TriangleMesh::try_new(holed, vec![])
                .unwrap_err()
                .to_string()
                .contains("vertex 2")
        );
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
        assert_eq!((b.min, b.max), ([-1.0, -1.5, 0.0], [1.0, 1.5, 0.0]));
    }

    #[test]
    fn volume_survives_a_far_origin() {
        let mut ball = icosphere(1.0, 3);
        let near = ball.signed_volume().unwrap();
        for p in &mut ball.positions {
            *p = add(*p, [1e6, -1e6, 1e6]);
        }
        assert!((ball.signed_volume().unwrap() - near).abs() < 1e-8);
    }

    #[test]
    fn vertex_normals_ignore_how_a_flat_corner_is_cut() {
        // A cube corner whose one side is cut into two triangles: angle weights see three equal sides all the same.
        let positions = vec![
            [0.0; 3],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [1.0, 1.0, 0.0],
        ];
        let mesh = TriangleMesh::try_new(positions, vec![[0, 4, 1], [0, 2, 4], [0, 1, 3], [0, 3, 2]]).unwrap();
        let expected = -1.0 / 3.0_f64.sqrt();
        for x in mesh.vertex_normals()[0] {
            assert!((x - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn vertex_normals_of_a_ball_point_outwards() {
        let ball = icosphere(3.0, 4);
        for (p, n) in ball.positions.iter().zip(ball.vertex_normals()) {
            assert!(dot(*p, n) / 3.0 > 0.9999);
        }
        for (t, n) in ball.face_normals().iter().enumerate() {
            assert!(dot(ball.corners(t)[0], *n) > 0.0);
        }
    }

    #[test]
    fn welding_closes_a_soup() {
        let ball = icosphere(1.0, 2);
        let soup = TriangleMesh {
            positions: (0..ball.triangles.len()).flat_map(|t| ball.corners(t)).collect(),
            triangles: (0..ball.triangles.len() as u32)
                .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
                .collect(),
        };
        assert!(!soup.check().watertight);
        let welded = soup.welded();
        assert_eq!(welded.positions.len(), ball.positions.len());
        assert!(welded.check().watertight);
    }
}
