//! Intersection of rays with a mesh.
//!
//! In: an origin and a direction of any length. Out: the first triangle hit, from either side. A ray through
//! an edge or vertex shared by several triangles hits one of them, never none. Not guaranteed: hits of
//! triangles that are seen exactly edge-on.
//!
//! Reference: Woop, Benthin and Wald, *Watertight Ray/Triangle Intersection*, Journal of Computer Graphics
//! Techniques 2013.

use crate::bvh::{Bvh, MAX_DEPTH, Node, max_number, min_number};
use crate::search::MeshSearch;
use crate::triangle::{point_at, unit_normal};
use planish_core::DVec3;

/// Factor on the far side of boxes that covers the rounding errors of the slab test.
///
/// Without it, rays along the faces of boxes miss triangles there. Reference: Ize, *Robust BVH Ray
/// Traversal*, 2013.
const BOX_SLACK: f64 = 1.0 + 8.0 * f64::EPSILON;

/// The intersection of a ray with a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayHit {
    /// Distance from the origin in the unit of the model, for a direction of any length.
    pub distance: f64,
    /// The point on the triangle.
    pub point: DVec3,
    /// Index of the triangle.
    pub triangle: u32,
    /// Barycentric coordinates in the triangle.
    pub barycentric: [f64; 3],
    /// Unit normal of the triangle; it points along the ray if the back was hit.
    pub normal: DVec3,
}

impl MeshSearch {
    /// The first hit in front of the origin or on it.
    ///
    /// `None` if nothing is hit, if the direction is zero, or if a number is not finite.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_mesh::{MeshSearch, icosphere};
    /// let search = MeshSearch::try_new(&icosphere(1.0, 4))?;
    /// let hit = search.first_hit(5.0 * DVec3::Z, DVec3::NEG_Z).expect("the ball is below");
    /// assert!((hit.distance - 4.0).abs() < 0.01 && hit.normal[2] > 0.9);
    /// assert!(search.first_hit(5.0 * DVec3::Z, DVec3::Z).is_none());
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    #[must_use]
    pub fn first_hit(&self, origin: DVec3, direction: DVec3) -> Option<RayHit> {
        self.first_hit_between(origin, direction, 0.0, f64::INFINITY)
    }

    /// The first hit at a distance between `near` and `far`.
    ///
    /// A ray that starts on the surface, such as a shadow ray, needs a `near` well above rounding errors, or
    /// it hits the triangle where it starts.
    #[must_use]
    pub fn first_hit_between(&self, origin: DVec3, direction: DVec3, near: f64, far: f64) -> Option<RayHit> {
        let ray = Ray::new(origin, direction)?;
        let Bvh { nodes, corners, triangles } = &self.bvh;
        let mut best = far;
        let mut found: Option<(u32, [f64; 3])> = None;
        let mut stack = [(0_u32, 0.0_f64); MAX_DEPTH];
        let mut height = 0;
        let mut at = 0;
        ray.entry(&nodes[0], near, best)?;
        'walk: loop {
            let node = &nodes[at as usize];
            if node.count > 0 {
                for slot in node.first..node.first + node.count {
                    let Some((t, barycentric)) = ray.hit(&corners[slot as usize]) else {
                        continue;
                    };
                    // Of two hits at the same distance, as on a common edge, the lower index wins: the answer
                    // does not depend on the tree.
                    let lower =
                        || found.is_none_or(|(f, _)| triangles[slot as usize] < triangles[f as usize]);
                    if t >= near && (t < best || t == best && lower()) {
                        best = t;
                        found = Some((slot, barycentric));
                    }
                }
            } else {
                let (left, right) = (node.first, node.first + 1);
                let to_left = ray.entry(&nodes[left as usize], near, best);
                let to_right = ray.entry(&nodes[right as usize], near, best);
                match (to_left, to_right) {
                    // The nearer child first: its hit often excludes the other.
                    (Some(l), Some(r)) => {
                        stack[height] = if l <= r { (right, r) } else { (left, l) };
                        height += 1;
                        at = if l <= r { left } else { right };
                        continue;
                    }
                    (Some(_), None) => {
                        at = left;
                        continue;
                    }
                    (None, Some(_)) => {
                        at = right;
                        continue;
                    }
                    (None, None) => {}
                }
            }
            while height > 0 {
                height -= 1;
                let (next, entry) = stack[height];
                if entry <= best {
                    at = next;
                    continue 'walk;
                }
            }
            break;
        }
        let (slot, barycentric) = found?;
        let corners = &corners[slot as usize];
        Some(RayHit {
            distance: best,
            point: point_at(corners, barycentric),
            triangle: triangles[slot as usize],
            barycentric,
            normal: unit_normal(corners),
        })
    }

    /// True if the straight line between two points meets no triangle, except within `clearance` of its ends.
    #[must_use]
    pub fn is_unobstructed(&self, from: DVec3, to: DVec3, clearance: f64) -> bool {
        let length = from.distance(to);
        self.first_hit_between(from, to - from, clearance, length - clearance).is_none()
    }
}

/// A ray with the precomputed values of the tests for boxes and triangles.
struct Ray {
    origin: DVec3,
    inverse: DVec3,
    /// Permutation of the axes; the direction is largest along the last. Dividing by its component is safe.
    axes: [usize; 3],
    /// Shear of the first two axes and scale of the last, which turn the ray into the unit vector of that
    /// axis.
    shear: [f64; 3],
}

impl Ray {
    fn new(origin: DVec3, direction: DVec3) -> Option<Self> {
        let finite = origin.is_finite() && direction.is_finite();
        // Scaled first, so that the square of a very short or long direction neither underflows nor
        // overflows.
        let size = direction.to_array().iter().fold(0.0_f64, |size, x| size.max(x.abs()));
        if !finite || size == 0.0 {
            return None;
        }
        let d = (direction / size).try_normalize()?;
        let z = (1..3).fold(0, |z, k| if d[k].abs() > d[z].abs() { k } else { z });
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        Some(Self {
            origin,
            inverse: d.map(|x| 1.0 / x),
            axes: [x, y, z],
            shear: [d[x] / d[z], d[y] / d[z], 1.0 / d[z]],
        })
    }

    /// The distance at which the ray enters a box, if it does so between `near` and `far`.
    #[inline(always)]
    fn entry(&self, node: &Node, near: f64, far: f64) -> Option<f64> {
        let (mut enter, mut leave) = (near, far);
        for k in 0..3 {
            let a = (node.min[k] - self.origin[k]) * self.inverse[k];
            let b = (node.max[k] - self.origin[k]) * self.inverse[k];
            // 0 · ∞ on a face of the box is NaN. The comparisons then keep the limits, and the box is
            // visited.
            let (low, high) = if self.inverse[k] >= 0.0 { (a, b) } else { (b, a) };
            enter = max_number(low, enter);
            leave = min_number(high * BOX_SLACK, leave);
        }
        (enter <= leave).then_some(enter)
    }

    /// Distance and barycentric coordinates of the hit of a triangle from either side, also behind the
    /// origin.
    #[inline]
    fn hit(&self, corners: &[DVec3; 3]) -> Option<(f64, [f64; 3])> {
        let [x, y, z] = self.axes;
        let local = corners.map(|c| {
            let c = c - self.origin;
            [c[x] - self.shear[0] * c[z], c[y] - self.shear[1] * c[z], self.shear[2] * c[z]]
        });
        let [a, b, c] = local;
        // Areas of the edge functions. Two triangles evaluate a common edge to the same value with opposite
        // signs, so a ray cannot pass between them; zero counts as inside for both.
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let sum = u + v + w;
        if sum == 0.0 {
            return None;
        }
        let barycentric = [u, v, w].map(|area| 1.0 / sum * area);
        let t = barycentric[0] * a[2] + barycentric[1] * b[2] + barycentric[2] * c[2];
        t.is_finite().then_some((t, barycentric))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriangleMesh;
    use crate::primitives::{grid_sheet, icosphere};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn search(mesh: &TriangleMesh) -> MeshSearch {
        MeshSearch::try_new(mesh).unwrap()
    }

    #[test]
    fn a_ball_is_hit_from_outside_and_inside() {
        let ball = icosphere(1.0, 5);
        let search = search(&ball);
        let mut random = ChaCha8Rng::seed_from_u64(5);
        for _ in 0..2000 {
            let mut any = || DVec3::from_array(std::array::from_fn(|_| random.random::<f64>() - 0.5));
            let (toward, direction) = (any(), any());
            let d = direction.try_normalize().unwrap();
            let origin = toward - 3.0 * d;
            let hit = search.first_hit(origin, direction).unwrap();
            // The answer for the smooth sphere, within the chord error, which a slanted ray magnifies.
            let b = origin.dot(d);
            let smooth = -b - (b * b - origin.length_squared() + 1.0).sqrt();
            assert!((hit.distance - smooth).abs() < 2e-3, "{} {smooth}", hit.distance);
            assert!(hit.point.distance(origin + hit.distance * d) < 1e-14);
            assert!(hit.normal.dot(d) < 0.0);
            let out = search.first_hit(DVec3::ZERO, direction).unwrap();
            assert!((out.distance - 1.0).abs() < 1e-3 && out.normal.dot(d) > 0.0);
            let away = search.first_hit(origin, -direction);
            assert_eq!(away, None);
        }
    }

    #[test]
    fn first_hit_agrees_with_all_triangles() {
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let mut any = || DVec3::from_array(std::array::from_fn(|_| random.random::<f64>() * 2.0 - 1.0));
        let corners: Vec<[DVec3; 3]> = (0..300)
            .map(|_| {
                let middle = any();
                std::array::from_fn(|_| middle + 0.15 * any())
            })
            .collect();
        let mesh = TriangleMesh::try_new(
            corners.iter().flatten().copied().collect(),
            (0..300).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        )
        .unwrap();
        let search = search(&mesh);
        let mut hits = 0;
        for round in 0..2000 {
            let mut direction = any();
            if round % 4 == 0 {
                direction[round % 3] = 0.0;
            }
            let origin = any();
            let ray = Ray::new(origin, direction).unwrap();
            let expected = corners
                .iter()
                .enumerate()
                .filter_map(|(i, c)| ray.hit(c).filter(|h| h.0 >= 0.0).map(|h| (h.0, i as u32)))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let hit = search.first_hit(origin, direction);
            assert_eq!(hit.map(|h| (h.distance, h.triangle)), expected);
            if let Some(hit) = hit {
                hits += 1;
                let off = hit.point - (origin + hit.distance / direction.length() * direction);
                assert!(off.length() < 1e-13);
            }
        }
        assert!(hits > 300, "{hits}");
    }

    #[test]
    fn no_ray_passes_through_edges_or_vertices() {
        let sheet = grid_sheet(1.0, 1.0, 8, 8);
        let search = search(&sheet);
        for i in 1..32 {
            for j in 1..32 {
                // Every fourth of these points lies on grid lines, many on diagonals; rays are straight and
                // slanted.
                let (x, y) = (f64::from(i) / 32.0 - 0.5, f64::from(j) / 32.0 - 0.5);
                for slant in [0.0, 0.25, -1.0] {
                    let hit = search
                        .first_hit(DVec3::new(x - slant, y, 1.0), DVec3::new(slant, 0.0, -1.0))
                        .unwrap();
                    assert!(hit.point.distance(DVec3::new(x, y, 0.0)) < 1e-15);
                }
            }
        }
        let ball = icosphere(1.0, 3);
        let around = MeshSearch::try_new(&ball).unwrap();
        for p in &ball.positions {
            assert!((around.first_hit(DVec3::ZERO, *p).unwrap().distance - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn limits_are_respected_and_invalid_rays_have_no_hit() {
        let sheet = search(&grid_sheet(1.0, 1.0, 1, 1));
        let (origin, down) = (DVec3::new(0.1, 0.2, 1.0), -7.0 * DVec3::Z);
        let at_one = |d| (sheet.first_hit(origin, d).unwrap().distance - 1.0).abs() < 1e-15;
        assert!(at_one(down));
        assert!(sheet.first_hit_between(origin, down, 0.0, 0.99).is_none());
        assert!(sheet.first_hit_between(origin, down, 1.01, 9.0).is_none());
        assert!(sheet.first_hit(origin, DVec3::ZERO).is_none());
        assert!(sheet.first_hit(origin, DVec3::new(f64::NAN, 0.0, 1.0)).is_none());
        assert!(sheet.first_hit(origin, DVec3::X).is_none());
        assert!(at_one(DVec3::new(0.0, 0.0, -1e-300)) && at_one(DVec3::new(0.0, 0.0, -1e300)));
        assert!(!sheet.is_unobstructed(origin, DVec3::new(0.1, 0.2, -1.0), 1e-9));
        assert!(sheet.is_unobstructed(origin, DVec3::new(0.1, 0.2, 0.0), 1e-9));
    }
}
