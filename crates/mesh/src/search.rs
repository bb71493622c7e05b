//! Closest points on a mesh and signed distances.
//!
//! In: a mesh, and points in its frame. Out: the nearest point of the surface, the feature on which it lies,
//! and the distance, with the sign of the angle-weighted pseudo-normal of this feature.
//!
//! Not guaranteed: which of several triangles is reported if their distances differ by rounding only (of
//! equal distances, the lowest index is reported); the sign at features whose triangles all lack area (it is
//! positive).

use planish_core::DVec3;
use rayon::prelude::*;

use planish_estimate::{Error, Result};

use crate::bvh::{Bvh, MAX_DEPTH, squared_distance_to_box};
use crate::copies::first_copies;
use crate::edges::EdgeTable;
use crate::mesh::TriangleMesh;
use crate::triangle::{Feature, Foot, area_vector, closest_on_triangle, unit_normal, unit_or_zero};

/// Number of points in one parallel task.
///
/// It is fixed, so that the hints within a task do not depend on the number of threads.
const CHUNK: usize = 256;
/// Relative slack of squared distances: a box is skipped only if it is farther than the best triangle by more
/// than rounding errors. Otherwise a triangle at the same distance with a lower index could be missed.
const ROUNDING_SLACK: f64 = 1.0 + 1e-14;

/// The point of a mesh that is closest to a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestPoint {
    /// Distance, not negative.
    pub distance: f64,
    /// Distance, positive on the side of the normal.
    pub signed_distance: f64,
    /// The closest point.
    pub point: DVec3,
    /// Index of its triangle.
    pub triangle: u32,
    /// Barycentric coordinates in the triangle.
    pub barycentric: [f64; 3],
    /// Part of the triangle on which it lies.
    pub feature: Feature,
    /// Unit pseudo-normal of the feature: the normal of a face, the sum of both at an edge, or the
    /// angle-weighted sum at a vertex. Zero if no adjacent face has an area.
    pub normal: DVec3,
    /// True if the feature is on an open border of the mesh, as for points beyond the border.
    pub on_boundary: bool,
}

/// A mesh prepared for closest points and rays. It holds its own copy, about 180 bytes per triangle.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_mesh::{MeshSearch, icosphere};
/// let search = MeshSearch::try_new(&icosphere(10.0, 4))?;
/// let inside = search.closest(9.0 * DVec3::Z).expect("the point is finite");
/// assert!((inside.signed_distance + 1.0).abs() < 0.05);
/// // A limit saves time if only near points matter.
/// assert!(search.closest_within(9.0 * DVec3::Z, 0.5).is_none());
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Bærentzen and Aanæs, *Signed Distance Computation Using the Angle Weighted Pseudonormal*, IEEE TVCG 2005.
#[derive(Debug, Clone)]
pub struct MeshSearch {
    pub(crate) bvh: Bvh,
    /// For each triangle, its position in leaf order.
    slots: Vec<u32>,
    /// Vertices of each triangle; vertices at equal positions have the same number.
    pub(crate) vertices: Vec<[u32; 3]>,
    edges: Vec<[u32; 3]>,
    vertex_normals: Vec<DVec3>,
    edge_normals: Vec<DVec3>,
    boundary_vertices: Vec<bool>,
    boundary_edges: Vec<bool>,
}

impl MeshSearch {
    /// Prepares a mesh. Cost O(n log n).
    ///
    /// Vertices at equal positions count as one, so that signs are right for triangle soups, too.
    ///
    /// # Errors
    /// `Undetermined` for a mesh without triangles; `Input` for a mesh that fails
    /// [`TriangleMesh::sanity_check`].
    pub fn try_new(mesh: &TriangleMesh) -> Result<Self> {
        mesh.sanity_check()?;
        if mesh.triangles.is_empty() {
            return Err(Error::undetermined(
                "expected a mesh with triangles, found none: there are no closest points",
            ));
        }
        // The tree keeps the triangles of the caller, whose numbers are reported. Signs need welded
        // vertices: the corners of a triangle soup have no neighbours.
        let welded = mesh.welded();
        // Copies of a triangle are left out. A search would compare all of them, because none is nearer, and
        // report the first one in the end.
        let first = first_copies(&welded.triangles);
        let kept: Vec<u32> = (0..).zip(&first).filter(|(t, first)| t == *first).map(|(t, _)| t).collect();
        let mut bvh = Bvh::new(kept.len(), |k| mesh.corners(kept[k] as usize));
        let mut slots = vec![0; mesh.triangles.len()];
        for (slot, triangle) in bvh.triangles.iter_mut().enumerate() {
            *triangle = kept[*triangle as usize];
            slots[*triangle as usize] = slot as u32;
        }
        for (t, first) in first.iter().enumerate() {
            slots[t] = slots[*first as usize];
        }
        let table = EdgeTable::new(&welded.triangles);
        let face_normals = welded.face_normals();
        let mut edge_normals = vec![DVec3::ZERO; table.len()];
        let mut boundary_edges = vec![false; table.len()];
        let mut boundary_vertices = vec![false; welded.positions.len()];
        for edge in 0..table.len() {
            let around = table.half_edges(edge);
            // Both normals have the same weight, π of the full angle each: the angle-weighted normal of
            // an edge is their plain sum (Bærentzen and Aanæs 2005).
            let sum = around.iter().fold(DVec3::ZERO, |sum, &half| sum + face_normals[half as usize / 3]);
            edge_normals[edge] = unit_or_zero(sum);
            if around.len() == 1 {
                boundary_edges[edge] = true;
                for v in table.ends[edge] {
                    boundary_vertices[v as usize] = true;
                }
            }
        }
        Ok(Self {
            bvh,
            slots,
            vertex_normals: welded.vertex_normals(),
            vertices: welded.triangles,
            edges: table.triangle_edges,
            edge_normals,
            boundary_vertices,
            boundary_edges,
        })
    }

    /// Number of triangles.
    #[must_use]
    pub fn triangle_count(&self) -> usize {
        self.slots.len()
    }

    /// The closest point of the mesh; `None` only if `point` is not finite.
    #[must_use]
    pub fn closest(&self, point: DVec3) -> Option<ClosestPoint> {
        self.closest_within(point, f64::INFINITY)
    }

    /// The closest point within `max_distance`. A smaller distance takes less time.
    #[must_use]
    pub fn closest_within(&self, point: DVec3, max_distance: f64) -> Option<ClosestPoint> {
        let slot = self.nearest_slot(point, squared_bound(max_distance), None, |_| true)?;
        self.describe(point, slot)
    }

    /// The closest point, with the triangle `hint` of a previous or neighbouring search as start.
    ///
    /// The answer does not depend on the hint, and an invalid one is ignored. It saves at most a fifth of the
    /// time where it was measured, because the tree finds a near triangle early in any case.
    #[must_use]
    pub fn closest_hinted(&self, point: DVec3, hint: u32) -> Option<ClosestPoint> {
        let slot =
            self.nearest_slot(point, f64::INFINITY, self.slots.get(hint as usize).copied(), |_| true)?;
        self.describe(point, slot)
    }

    /// The closest point on triangles whose normal is within `max_angle_rad` of `normal`.
    ///
    /// Triangles without area are ignored. `None` if no triangle qualifies, or if `normal` is zero or not
    /// finite.
    #[must_use]
    pub fn closest_compatible(
        &self,
        point: DVec3,
        normal: DVec3,
        max_angle_rad: f64,
    ) -> Option<ClosestPoint> {
        self.closest_compatible_within(point, normal, max_angle_rad, f64::INFINITY)
    }

    /// As [`MeshSearch::closest_compatible`], within `max_distance`.
    #[must_use]
    pub fn closest_compatible_within(
        &self,
        point: DVec3,
        normal: DVec3,
        max_angle_rad: f64,
        max_distance: f64,
    ) -> Option<ClosestPoint> {
        let normal = normal.try_normalize()?;
        let min_cosine = max_angle_rad.clamp(0.0, std::f64::consts::PI).cos();
        let agrees = |corners: &[DVec3; 3]| {
            let n = area_vector(corners);
            n != DVec3::ZERO && n.dot(normal) >= min_cosine * n.length()
        };
        let slot = self.nearest_slot(point, squared_bound(max_distance), None, agrees)?;
        self.describe(point, slot)
    }

    /// [`MeshSearch::closest`] for many points, in parallel, with the same answers for any number of threads.
    ///
    /// Points are found faster if each is near the previous one.
    #[must_use]
    pub fn closest_all(&self, points: &[DVec3]) -> Vec<Option<ClosestPoint>> {
        self.closest_all_within(points, f64::INFINITY)
    }

    /// [`MeshSearch::closest_within`] for many points, in parallel, with the same answers for any number of
    /// threads.
    #[must_use]
    pub fn closest_all_within(&self, points: &[DVec3], max_distance: f64) -> Vec<Option<ClosestPoint>> {
        let bound = squared_bound(max_distance);
        let mut feet = vec![None; points.len()];
        feet.par_chunks_mut(CHUNK).zip(points.par_chunks(CHUNK)).for_each(|(feet, points)| {
            let mut hint = None;
            for (foot, &point) in feet.iter_mut().zip(points) {
                let slot = self.nearest_slot(point, bound, hint, |_| true);
                *foot = slot.and_then(|slot| self.describe(point, slot));
                hint = slot.or(hint);
            }
        });
        feet
    }

    /// Number of triangles that a search of the closest point visits: the cost of the search. It is small for
    /// a surface, and may be the number of all triangles if they overlap.
    #[must_use]
    pub fn visits(&self, point: DVec3) -> usize {
        let mut visited = 0;
        self.nearest_slot_counted(point, f64::INFINITY, None, |_| true, &mut visited);
        visited
    }

    /// The position in leaf order of the nearest accepted triangle within the bound.
    fn nearest_slot(
        &self,
        p: DVec3,
        squared_bound: f64,
        hint: Option<u32>,
        accept: impl Fn(&[DVec3; 3]) -> bool,
    ) -> Option<u32> {
        self.nearest_slot_counted(p, squared_bound, hint, accept, &mut 0)
    }

    /// As [`MeshSearch::nearest_slot`]; adds the number of visited triangles to `visited`.
    fn nearest_slot_counted(
        &self,
        p: DVec3,
        squared_bound: f64,
        hint: Option<u32>,
        accept: impl Fn(&[DVec3; 3]) -> bool,
        visited: &mut usize,
    ) -> Option<u32> {
        if !p.is_finite() {
            return None;
        }
        let Bvh { nodes, corners, triangles } = &self.bvh;
        let mut best = squared_bound;
        let mut found: Option<u32> = None;
        let mut visit = |slot: u32, best: &mut f64| {
            let Some(foot) = closest_on_triangle(p, &corners[slot as usize], *best) else {
                return;
            };
            let d = foot.squared_distance;
            // The lower index wins among equal distances, so that the answer does not depend on the shape
            // of the tree or on a hint.
            let nearer = d < *best
                || d == *best && found.is_none_or(|f| triangles[slot as usize] < triangles[f as usize]);
            // The test of acceptance is expensive and comes last.
            if nearer && accept(&corners[slot as usize]) {
                *best = d;
                found = Some(slot);
            }
        };
        // Only a first bound: the tree is searched as usual, so the answer does not depend on the hint.
        if let Some(hint) = hint {
            visit(hint, &mut best);
        }
        let mut stack = [(0_u32, 0.0_f64); MAX_DEPTH];
        let mut height = 0;
        let mut at = 0;
        loop {
            let node = &nodes[at as usize];
            if node.count > 0 {
                *visited += node.count as usize;
                for slot in node.first..node.first + node.count {
                    visit(slot, &mut best);
                }
            } else {
                let (left, right) = (node.first, node.first + 1);
                let to_left = squared_distance_to_box(p, &nodes[left as usize]);
                let to_right = squared_distance_to_box(p, &nodes[right as usize]);
                // The nearer child first: it lowers the bound before the other is tested.
                let (near, to_near, far, to_far) = if to_left <= to_right {
                    (left, to_left, right, to_right)
                } else {
                    (right, to_right, left, to_left)
                };
                let limit = best * ROUNDING_SLACK;
                if to_near <= limit {
                    if to_far <= limit {
                        stack[height] = (far, to_far);
                        height += 1;
                    }
                    at = near;
                    continue;
                }
            }
            loop {
                if height == 0 {
                    return found;
                }
                height -= 1;
                let (next, distance) = stack[height];
                if distance <= best * ROUNDING_SLACK {
                    at = next;
                    break;
                }
            }
        }
    }

    /// The closest point on the triangle at a position in leaf order, with its feature and sign.
    fn describe(&self, p: DVec3, slot: u32) -> Option<ClosestPoint> {
        let corners = &self.bvh.corners[slot as usize];
        let Foot { squared_distance, point, barycentric, feature } =
            closest_on_triangle(p, corners, f64::INFINITY)?;
        let triangle = self.bvh.triangles[slot as usize];
        let (normal, on_boundary) = match feature {
            Feature::Face => (unit_normal(corners), false),
            Feature::Edge(k) => {
                let edge = self.edges[triangle as usize][k as usize] as usize;
                (self.edge_normals[edge], self.boundary_edges[edge])
            }
            Feature::Vertex(k) => {
                let vertex = self.vertices[triangle as usize][k as usize] as usize;
                (self.vertex_normals[vertex], self.boundary_vertices[vertex])
            }
        };
        let distance = squared_distance.sqrt();
        // The sign is that of the pseudo-normal, not of the face: at edges and corners, faces that are
        // equally near can disagree.
        let behind = (p - point).dot(normal) < 0.0;
        let signed_distance = if behind { -distance } else { distance };
        Some(ClosestPoint {
            distance,
            signed_distance,
            point,
            triangle,
            barycentric,
            feature,
            normal,
            on_boundary,
        })
    }
}

/// The square of a distance, negative for a negative distance, within which no point lies.
fn squared_bound(max_distance: f64) -> f64 {
    max_distance * max_distance.abs()
}

#[cfg(test)]
mod tests;
