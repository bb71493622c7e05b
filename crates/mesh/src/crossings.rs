//! Where a mesh crosses itself.
//!
//! Comes in: a [`MeshSearch`]. Goes out: how many pairs of triangles cross, and the first of them. Not
//! guaranteed: triangles that share a vertex, or lie in one plane, are not compared; what touches does not
//! cross.

use crate::bvh::{Bvh, MAX_DEPTH, Node, greater, lesser};
use crate::search::MeshSearch;
use planish_estimate::vector3::{add, cross, distance, dot, norm, scale, sub};
use rayon::prelude::*;

/// Minimum distance of the ends of an edge from the plane of a triangle that it pierces, in lengths of the
/// edge. An edge with a nearer end only touches.
const THROUGH: f64 = 1e-6;
/// Maximum number of nodes visited for one leaf. Without it, triangles whose boxes all overlap would take
/// time proportional to the square of their number.
const MOST_NODES: usize = 1 << 14;

/// What [`MeshSearch::self_crossings`] found.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SelfCrossings {
    /// Pairs of triangles that cross.
    pub pairs: usize,
    /// The pair with the lowest numbers, the lower first; zeros where nothing crosses.
    pub first: [u32; 2],
    /// Where an edge of one goes through the other.
    pub place: [f64; 3],
}

impl SelfCrossings {
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
    /// The pairs of triangles that cross: an edge of one goes through the other. Pairs that share a vertex
    /// are not compared. Cost O(n log n) where triangles are small beside the mesh.
    ///
    /// # References
    /// T. Möller, *A fast triangle-triangle intersection test*, Journal of Graphics Tools 1997: planes tell
    /// most pairs apart.
    #[must_use]
    pub fn self_crossings(&self) -> SelfCrossings {
        let leaves: Vec<&Node> = self.bvh.nodes.iter().filter(|n| n.count > 0).collect();
        (leaves.par_iter())
            .map(|leaf| self.crossings_of(leaf))
            .reduce(SelfCrossings::default, SelfCrossings::with)
    }

    /// Crossings of a leaf's triangles with those at later places of the leaf order.
    fn crossings_of(&self, leaf: &Node) -> SelfCrossings {
        let Bvh { nodes, corners, .. } = &self.bvh;
        let mine = leaf.first..leaf.first + leaf.count;
        let of_mine: Vec<[[f64; 3]; 2]> = mine.clone().map(|slot| box_of(&corners[slot as usize])).collect();
        let mut found = SelfCrossings::default();
        let mut stack = [0_u32; MAX_DEPTH + 1];
        let mut height = 1;
        let mut looked_at = 0;
        while height > 0 && looked_at < MOST_NODES {
            height -= 1;
            looked_at += 1;
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
            for there in node.first..node.first + node.count {
                if there <= leaf.first {
                    continue;
                }
                let theirs = &corners[there as usize];
                let of_theirs = box_of(theirs);
                if !meet(&[leaf.min, leaf.max], &of_theirs) {
                    continue;
                }
                for (here, of_ours) in mine.clone().zip(&of_mine).take_while(|(here, _)| *here < there) {
                    if !meet(of_ours, &of_theirs) {
                        continue;
                    }
                    let ours = &corners[here as usize];
                    let numbers = [here, there].map(|slot| self.bvh.triangles[slot as usize]);
                    let [a, b] = numbers.map(|t| self.vertices[t as usize]);
                    if a.iter().any(|v| b.contains(v)) {
                        continue;
                    }
                    if let Some(place) = crossing(ours, theirs) {
                        let first = [numbers[0].min(numbers[1]), numbers[0].max(numbers[1])];
                        found = found.with(SelfCrossings { pairs: 1, first, place });
                    }
                }
            }
        }
        found
    }
}

/// Whether two boxes meet, each given by its least and its greatest coordinates.
fn meet(a: &[[f64; 3]; 2], b: &[[f64; 3]; 2]) -> bool {
    (0..3).all(|k| a[0][k] <= b[1][k] && b[0][k] <= a[1][k])
}

fn box_of(t: &[[f64; 3]; 3]) -> [[f64; 3]; 2] {
    let of = |pick: fn(f64, f64) -> f64| std::array::from_fn(|k| pick(pick(t[0][k], t[1][k]), t[2][k]));
    [of(lesser), of(greater)]
}

/// Where an edge of one triangle goes through the other.
fn crossing(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> Option<[f64; 3]> {
    let normal = |t: &[[f64; 3]; 3]| cross(sub(t[1], t[0]), sub(t[2], t[0]));
    let heights = |t: &[[f64; 3]; 3], n: [f64; 3], of: &[[f64; 3]; 3]| of.map(|p| dot(n, sub(p, t[0])));
    let one_side = |h: [f64; 3]| h.iter().all(|x| *x >= 0.0) || h.iter().all(|x| *x <= 0.0);
    let (of_b, of_a) = (normal(b), normal(a));
    let over_b = heights(b, of_b, a);
    if one_side(over_b) {
        return None;
    }
    let over_a = heights(a, of_a, b);
    if one_side(over_a) {
        return None;
    }
    pierced(a, over_b, b, of_b).or_else(|| pierced(b, over_a, a, of_a))
}

/// Where an edge of a triangle, whose corners have such heights (times twice the area) over another's plane,
/// goes through that other.
fn pierced(
    edges: &[[f64; 3]; 3],
    heights: [f64; 3],
    through: &[[f64; 3]; 3],
    normal: [f64; 3],
) -> Option<[f64; 3]> {
    let doubled = norm(normal);
    (0..3).find_map(|k| {
        let (p, q) = (edges[k], edges[(k + 1) % 3]);
        let (hp, hq) = (heights[k], heights[(k + 1) % 3]);
        let least = THROUGH * distance(p, q) * doubled;
        if hp * hq >= 0.0 || hp.abs() < least || hq.abs() < least {
            return None;
        }
        let place = add(p, scale(hp / (hp - hq), sub(q, p)));
        let inside = (0..3).all(|k| {
            let (s, t) = (through[k], through[(k + 1) % 3]);
            let turn = dot(normal, cross(sub(t, s), sub(place, s)));
            turn > THROUGH * doubled * doubled
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
    fn what_does_not_cross_itself_is_clean() {
        for mesh in [icosphere(3.0, 4), grid_sheet(5.0, 4.0, 31, 17)] {
            assert_eq!(crossings(&mesh), SelfCrossings::default());
        }
    }

    /// Two sheets, one upright through the middle of the other: the number of pairs is that of all pairs
    /// tried.
    #[test]
    fn crossings_are_those_of_all_pairs() {
        let mut mesh = grid_sheet(4.0, 4.0, 21, 21);
        let upright = grid_sheet(2.03, 2.07, 14, 15);
        let from = mesh.positions.len() as u32;
        mesh.positions
            .extend(upright.positions.iter().map(|[x, y, z]| [x + 0.013, *z + 0.011 + 0.1 * x, *y + 0.017]));
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
    fn what_touches_does_not_cross() {
        let mut mesh = grid_sheet(2.0, 2.0, 3, 3);
        let from = mesh.positions.len() as u32;
        // A corner on a face, and an edge on it.
        mesh.positions.extend([[0.3, 0.2, 0.0], [0.3, 0.4, 1.0], [0.4, 0.2, 1.0]]);
        mesh.positions.extend([[0.3, 0.7, 0.0], [0.4, 0.75, 0.0], [0.4, 0.7, 1.0]]);
        mesh.triangles.extend([[from, from + 1, from + 2], [from + 3, from + 4, from + 5]]);
        assert_eq!(crossings(&mesh), SelfCrossings::default());
    }
}
