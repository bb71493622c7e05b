//! Self-intersections of a mesh.
//!
//! In: a [`MeshSearch`]. Out: the number of pairs of triangles that intersect, and the first of them. Not
//! guaranteed: triangles that share a vertex or lie in one plane are not compared. Triangles that touch do
//! not count.

use crate::bvh::{Bvh, MAX_DEPTH, Node, max_number, min_number};
use crate::search::MeshSearch;
use planish_core::DVec3;
use rayon::prelude::*;

/// Minimum distance of the ends of an edge from the plane of a triangle that it pierces, relative to its
/// length.
///
/// Edges that end nearer to the plane only touch the triangle. The value is far above rounding and far below
/// the intersections that matter (test `touching_is_not_crossing`).
const MIN_PIERCING: f64 = 1e-6;
/// Maximum number of nodes visited for one leaf.
///
/// Without it, the cost is quadratic if all triangles lie in each other's boxes, as slivers through one
/// point.
const MAX_NODES: usize = 1 << 14;

/// The result of [`MeshSearch::self_crossings`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SelfCrossings {
    /// Number of pairs of triangles that intersect.
    pub pairs: usize,
    /// The pair with the lowest indices, the lower first; zeros without intersections.
    pub first: [u32; 2],
    /// A point where an edge of one triangle of this pair pierces the other.
    pub place: DVec3,
}

impl SelfCrossings {
    /// The union of two results. It does not depend on the order, so leaves can be searched in parallel.
    fn with(self, other: Self) -> Self {
        let first = match (self.pairs, other.pairs) {
            (_, 0) => self,
            (0, _) => other,
            _ if self.first <= other.first => self,
            _ => other,
        };
        Self { pairs: self.pairs + other.pairs, ..first }
    }
}

impl MeshSearch {
    /// Finds the pairs of triangles that intersect: an edge of one pierces the other.
    ///
    /// Pairs that share a vertex are not compared. Cost O(n log n) if triangles are small relative to the
    /// mesh.
    ///
    /// # Examples
    /// ```
    /// use planish_mesh::{MeshSearch, icosphere};
    /// # fn main() -> planish_estimate::Result<()> {
    /// let mut mesh = icosphere(1.0, 2);
    /// assert_eq!(MeshSearch::try_new(&mesh)?.self_crossings().pairs, 0);
    /// // Pull one vertex through the opposite side.
    /// mesh.positions[0] = mesh.positions[0].map(|x| -1.5 * x);
    /// assert!(MeshSearch::try_new(&mesh)?.self_crossings().pairs > 0);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # References
    /// T. Möller, *A fast triangle-triangle intersection test*, Journal of Graphics Tools 1997; most pairs
    /// are separated by one of their planes.
    #[must_use]
    pub fn self_crossings(&self) -> SelfCrossings {
        let of_leaf = |leaf: &Node| {
            let mut found = SelfCrossings::default();
            self.for_crossings_of(leaf, |first, place| {
                found = found.with(SelfCrossings { pairs: 1, first, place });
            });
            found
        };
        self.leaves().par_iter().map(|leaf| of_leaf(leaf)).reduce(SelfCrossings::default, SelfCrossings::with)
    }

    /// The pairs of triangles that intersect, in ascending order; as for [`MeshSearch::self_crossings`].
    #[must_use]
    pub fn crossing_pairs(&self) -> Vec<[u32; 2]> {
        let of_leaf = |leaf: &Node| {
            let mut found = Vec::new();
            self.for_crossings_of(leaf, |pair, _| found.push(pair));
            found
        };
        let mut all: Vec<[u32; 2]> = self.leaves().par_iter().flat_map_iter(|leaf| of_leaf(leaf)).collect();
        all.sort_unstable();
        all
    }

    fn leaves(&self) -> Vec<&Node> {
        self.bvh.nodes.iter().filter(|n| n.count > 0).collect()
    }

    /// Calls `act` with each pair of a triangle of a leaf and one at a later position of the leaf order that
    /// intersect, the lower number first, and a point where they do.
    fn for_crossings_of(&self, leaf: &Node, mut act: impl FnMut([u32; 2], DVec3)) {
        let Bvh { nodes, corners, .. } = &self.bvh;
        let own_slots = leaf.first..leaf.first + leaf.count;
        let own_boxes: Vec<[DVec3; 2]> =
            own_slots.clone().map(|slot| box_of(&corners[slot as usize])).collect();
        let mut stack = [0_u32; MAX_DEPTH + 1];
        let mut height = 1;
        // Nodes are counted, not time: the number of pairs found is then the same on every machine.
        let mut visited = 0;
        while height > 0 && visited < MAX_NODES {
            height -= 1;
            visited += 1;
            let node = &nodes[stack[height] as usize];
            if !meet(&[leaf.min, leaf.max], &[node.min, node.max]) {
                continue;
            }
            if node.count == 0 {
                stack[height] = node.first;
                stack[height + 1] = node.first + 1;
                height += 2;
                continue;
            }
            for other_slot in node.first..node.first + node.count {
                // Each pair is tested once, from the triangle that comes first in leaf order.
                if other_slot <= leaf.first {
                    continue;
                }
                let other_triangle = &corners[other_slot as usize];
                let other_box = box_of(other_triangle);
                if !meet(&[leaf.min, leaf.max], &other_box) {
                    continue;
                }
                for (own_slot, own_box) in
                    own_slots.clone().zip(&own_boxes).take_while(|(own_slot, _)| *own_slot < other_slot)
                {
                    if !meet(own_box, &other_box) {
                        continue;
                    }
                    let own_triangle = &corners[own_slot as usize];
                    let numbers = [own_slot, other_slot].map(|slot| self.bvh.triangles[slot as usize]);
                    let [a, b] = numbers.map(|t| self.vertices[t as usize]);
                    // Neighbours touch along what they share, which rounding could take for a crossing.
                    if a.iter().any(|v| b.contains(v)) {
                        continue;
                    }
                    if let Some(place) = crossing(own_triangle, other_triangle) {
                        act([numbers[0].min(numbers[1]), numbers[0].max(numbers[1])], place);
                    }
                }
            }
        }
    }
}

/// True if two boxes, given by their minimum and maximum coordinates, intersect.
fn meet(a: &[DVec3; 2], b: &[DVec3; 2]) -> bool {
    (0..3).all(|k| a[0][k] <= b[1][k] && b[0][k] <= a[1][k])
}

/// The bounding box of a triangle.
fn box_of(t: &[DVec3; 3]) -> [DVec3; 2] {
    let extreme = |pick: fn(f64, f64) -> f64| {
        DVec3::from_array(std::array::from_fn(|k| pick(pick(t[0][k], t[1][k]), t[2][k])))
    };
    [extreme(min_number), extreme(max_number)]
}

/// A point where an edge of one triangle pierces the other.
fn crossing(a: &[DVec3; 3], b: &[DVec3; 3]) -> Option<DVec3> {
    let normal = |t: &[DVec3; 3]| (t[1] - t[0]).cross(t[2] - t[0]);
    let heights = |t: &[DVec3; 3], n: DVec3, triangle: &[DVec3; 3]| triangle.map(|p| n.dot(p - t[0]));
    let one_side = |h: [f64; 3]| h.iter().all(|x| *x >= 0.0) || h.iter().all(|x| *x <= 0.0);
    let (of_b, of_a) = (normal(b), normal(a));
    let over_b = heights(b, of_b, a);
    // Most pairs end here: all corners of one triangle lie on one side of the plane of the other.
    if one_side(over_b) {
        return None;
    }
    let over_a = heights(a, of_a, b);
    if one_side(over_a) {
        return None;
    }
    pierced(a, over_b, b, of_b).or_else(|| pierced(b, over_a, a, of_a))
}

/// A point where an edge of the triangle `edges` pierces the triangle `through`.
///
/// `heights` are those of the corners over the plane of `through`, times the length of its `normal`.
fn pierced(edges: &[DVec3; 3], heights: [f64; 3], through: &[DVec3; 3], normal: DVec3) -> Option<DVec3> {
    let doubled = normal.length();
    (0..3).find_map(|k| {
        let (p, q) = (edges[k], edges[(k + 1) % 3]);
        let (hp, hq) = (heights[k], heights[(k + 1) % 3]);
        // Heights are scaled by the normal, which has twice the area as its length; so is the limit.
        let minimum = MIN_PIERCING * p.distance(q) * doubled;
        if hp * hq >= 0.0 || hp.abs() < minimum || hq.abs() < minimum {
            return None;
        }
        let place = p + hp / (hp - hq) * (q - p);
        let inside = (0..3).all(|k| {
            let (s, t) = (through[k], through[(k + 1) % 3]);
            let turn = normal.dot((t - s).cross(place - s));
            // Strictly inside: an edge that passes through a side of the triangle only touches it.
            turn > MIN_PIERCING * doubled * doubled
        });
        inside.then_some(place)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriangleMesh;
    use crate::primitives::{grid_sheet, icosphere};

    fn crossings(mesh: &TriangleMesh) -> SelfCrossings {
        MeshSearch::try_new(mesh).unwrap().self_crossings()
    }

    #[test]
    fn balls_and_sheets_have_no_crossings() {
        for mesh in [icosphere(3.0, 4), grid_sheet(5.0, 4.0, 31, 17)] {
            assert_eq!(crossings(&mesh), SelfCrossings::default());
        }
    }

    /// The number of pairs is that of an exhaustive search, for two sheets that intersect at a right angle.
    #[test]
    fn crossings_match_an_exhaustive_search() {
        let mut mesh = grid_sheet(4.0, 4.0, 21, 21);
        let upright = grid_sheet(2.03, 2.07, 14, 15);
        let from = mesh.positions.len() as u32;
        mesh.positions.extend(
            upright.positions.iter().map(|p| DVec3::new(p.x + 0.013, p.z + 0.011 + 0.1 * p.x, p.y + 0.017)),
        );
        (mesh.triangles).extend(upright.triangles.iter().map(|t| t.map(|v| v + from)));
        let found = crossings(&mesh);
        let mut all = Vec::new();
        for a in 0..mesh.triangles.len() {
            for b in a + 1..mesh.triangles.len() {
                let shared = mesh.triangles[a].iter().any(|v| mesh.triangles[b].contains(v));
                if !shared && crossing(&mesh.corners(a), &mesh.corners(b)).is_some() {
                    all.push([a as u32, b as u32]);
                }
            }
        }
        assert!(all.len() > 20 && found.pairs == all.len(), "{found:?} {}", all.len());
        assert_eq!(found.first, all[0]);
        assert!(found.place[2].abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn touching_is_not_crossing() {
        let mut mesh = grid_sheet(2.0, 2.0, 3, 3);
        let from = mesh.positions.len() as u32;
        // A triangle with a corner on a face, and one with an edge on it.
        let on_face = [[0.3, 0.2, 0.0], [0.3, 0.4, 1.0], [0.4, 0.2, 1.0]];
        let with_edge = [[0.3, 0.7, 0.0], [0.4, 0.75, 0.0], [0.4, 0.7, 1.0]];
        mesh.positions.extend(on_face.into_iter().chain(with_edge).map(DVec3::from_array));
        mesh.triangles.extend([[from, from + 1, from + 2], [from + 3, from + 4, from + 5]]);
        assert_eq!(crossings(&mesh), SelfCrossings::default());
    }
}
