//! Topology check of a mesh.
//!
//! In: a mesh. Out: counts of open, non-manifold, misoriented and unused elements. Vertices are equal only if
//! their indices are: weld a triangle soup first. Triangles that contain a vertex twice are counted and
//! otherwise ignored. Not guaranteed: self-intersections are not detected here; see
//! [`SelfCrossings`](crate::SelfCrossings).

use super::TriangleMesh;
use crate::edges::{EdgeTable, is_collapsed};
use crate::triangle::area_vector;
use planish_core::{DVec3, DisjointSets};

/// Counts that describe a mesh; see [`TriangleMesh::check`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeshCheck {
    /// Number of vertices, used or not.
    pub vertices: usize,
    /// Number of triangles, including degenerate ones.
    pub triangles: usize,
    /// Number of different edges.
    pub edges: usize,
    /// Edges with one triangle.
    pub boundary_edges: usize,
    /// Edges with three or more triangles.
    pub nonmanifold_edges: usize,
    /// Edges whose two triangles run along them in the same direction: one of the two is reversed.
    pub misoriented_edges: usize,
    /// Vertices whose triangles form more than one fan (two cones tip to tip).
    pub nonmanifold_vertices: usize,
    /// Components connected through edges or vertices; unused vertices are not counted.
    pub components: usize,
    /// Boundary loops, counted as connected sets of boundary edges.
    pub boundary_loops: usize,
    /// Triangles without area.
    pub degenerate_triangles: usize,
    /// Vertices without triangles.
    pub unused_vertices: usize,
    /// True if there is a triangle, and every edge has two triangles.
    pub watertight: bool,
    /// True if there are no misoriented and no non-manifold edges: the sides are well defined.
    pub oriented: bool,
    /// True if there are no non-manifold edges and vertices.
    pub manifold: bool,
    /// Used vertices − edges + triangles; 2 for a ball, 0 for a torus, 1 for a sheet.
    pub euler_characteristic: i64,
}

impl MeshCheck {
    pub(super) fn new(mesh: &TriangleMesh) -> Self {
        let table = EdgeTable::new(&mesh.triangles);
        let (mut edges, mut boundary_edges, mut nonmanifold_edges, mut misoriented_edges) = (0, 0, 0, 0);
        let vertex = |half: u32| mesh.triangles[half as usize / 3][half as usize % 3];
        let mut parts = DisjointSets::new(mesh.positions.len());
        // One set for each corner, joined across edges: a vertex has as many fans as its corners have sets.
        let mut fans = DisjointSets::new(3 * mesh.triangles.len());
        let mut boundary = DisjointSets::new(mesh.positions.len());
        let mut on_boundary = vec![false; mesh.positions.len()];
        let mut around: Vec<u32> = Vec::new();
        for edge in 0..table.len() {
            // A triangle that contains a vertex twice has an edge of no length and would connect others.
            around.clear();
            around.extend(
                table.half_edges(edge).iter().filter(|&&h| !is_collapsed(mesh.triangles[h as usize / 3])),
            );
            let [a, b] = table.ends[edge];
            match around[..] {
                [] => continue,
                [_] => {
                    boundary_edges += 1;
                    boundary.join(a, b);
                    on_boundary[a as usize] = true;
                    on_boundary[b as usize] = true;
                }
                [first, second] => misoriented_edges += usize::from(vertex(first) == vertex(second)),
                _ => nonmanifold_edges += 1,
            }
            // After the match, so that edges of collapsed triangles alone are not counted.
            edges += 1;
            parts.join(a, b);
            for pair in around.windows(2) {
                // Corners at the same end of the edge belong to the same fan. A vertex with several fans is
                // non-manifold.
                let ends = |half: u32| {
                    let next = if half % 3 == 2 { half - 2 } else { half + 1 };
                    if vertex(half) == a { (half, next) } else { (next, half) }
                };
                let ((a0, b0), (a1, b1)) = (ends(pair[0]), ends(pair[1]));
                fans.join(a0, a1);
                fans.join(b0, b1);
            }
        }

        let mut fan_of_vertex = vec![u32::MAX; mesh.positions.len()];
        let mut torn = vec![false; mesh.positions.len()];
        let mut degenerate_triangles = 0;
        let mut faces = 0_usize;
        for (t, corners) in mesh.triangles.iter().enumerate() {
            degenerate_triangles += usize::from(area_vector(&mesh.corners(t)) == DVec3::ZERO);
            if is_collapsed(*corners) {
                continue;
            }
            faces += 1;
            for k in 0..3 {
                let (v, fan) = (corners[k] as usize, fans.root((3 * t + k) as u32));
                torn[v] |= fan_of_vertex[v] != u32::MAX && fan_of_vertex[v] != fan;
                fan_of_vertex[v] = fan;
            }
        }
        let used: Vec<u32> =
            (0..mesh.positions.len() as u32).filter(|&v| fan_of_vertex[v as usize] != u32::MAX).collect();
        let components = used.iter().filter(|&&v| parts.root(v) == v).count();
        let boundary_loops =
            used.iter().filter(|&&v| on_boundary[v as usize] && boundary.root(v) == v).count();
        let nonmanifold_vertices = torn.iter().filter(|&&t| t).count();
        Self {
            vertices: mesh.positions.len(),
            triangles: mesh.triangles.len(),
            edges,
            boundary_edges,
            nonmanifold_edges,
            misoriented_edges,
            nonmanifold_vertices,
            components,
            boundary_loops,
            degenerate_triangles,
            unused_vertices: mesh.positions.len() - used.len(),
            watertight: faces > 0 && boundary_edges == 0 && nonmanifold_edges == 0,
            oriented: misoriented_edges == 0 && nonmanifold_edges == 0,
            manifold: nonmanifold_edges == 0 && nonmanifold_vertices == 0,
            euler_characteristic: used.len() as i64 - edges as i64 + faces as i64,
        }
    }
}

impl TriangleMesh {
    /// For each triangle, the number of its part of the mesh. Parts share no vertices.
    ///
    /// They are numbered by the number of triangles, the largest 0.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_mesh::TriangleMesh;
    /// let positions = (0..6).map(|i| DVec3::new(f64::from(i), f64::from(i * i), 0.0)).collect();
    /// let mesh = TriangleMesh::try_new(positions, vec![[0, 1, 2], [3, 4, 5], [5, 4, 3]])?;
    /// assert_eq!(mesh.parts(), [1, 0, 0]);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    #[must_use]
    pub fn parts(&self) -> Vec<u32> {
        let mut sets = DisjointSets::new(self.positions.len());
        for [a, b, c] in &self.triangles {
            sets.join(*a, *b);
            sets.join(*a, *c);
        }
        let roots: Vec<u32> = self.triangles.iter().map(|t| sets.root(t[0])).collect();
        let mut count = std::collections::BTreeMap::new();
        for root in &roots {
            *count.entry(*root).or_insert(0_usize) += 1;
        }
        let mut order: Vec<(u32, usize)> = count.into_iter().collect();
        // The root breaks ties, so that parts of equal size have a fixed order.
        order.sort_by_key(|(root, size)| (std::cmp::Reverse(*size), *root));
        let rank: std::collections::BTreeMap<u32, u32> =
            order.iter().enumerate().map(|(k, (root, _))| (*root, k as u32)).collect();
        roots.iter().map(|root| rank[root]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{cylinder, grid_sheet, icosphere};

    fn mesh(count: usize, triangles: &[[u32; 3]]) -> TriangleMesh {
        // Points on the moment curve, of which no three are collinear.
        let positions =
            (0..count).map(|i| DVec3::new(i as f64, (i * i) as f64, (i * i * i) as f64)).collect();
        TriangleMesh::try_new(positions, triangles.to_vec()).unwrap()
    }

    #[test]
    fn a_closed_ball_is_watertight_and_a_removed_triangle_opens_it() {
        let mut ball = icosphere(1.0, 3);
        let check = ball.check();
        assert!(check.watertight && check.oriented && check.manifold);
        assert_eq!((check.euler_characteristic, check.components, check.boundary_loops), (2, 1, 0));
        ball.triangles.pop();
        let open = ball.check();
        assert!(!open.watertight && open.oriented && open.manifold);
        assert_eq!((open.boundary_edges, open.boundary_loops, open.euler_characteristic), (3, 1, 1));
    }

    #[test]
    fn a_reversed_triangle_is_detected() {
        let mut ball = icosphere(1.0, 1);
        ball.triangles[5].swap(0, 1);
        let check = ball.check();
        assert!(check.watertight && !check.oriented);
        assert_eq!(check.misoriented_edges, 3);
        assert_eq!(ball.signed_volume(), None);
    }

    #[test]
    fn three_triangles_at_an_edge_are_not_manifold() {
        let check = mesh(5, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]).check();
        assert_eq!((check.nonmanifold_edges, check.boundary_edges, check.components), (1, 6, 1));
        assert!(!check.manifold && !check.watertight && !check.oriented);
        assert_eq!(check.nonmanifold_vertices, 0);
    }

    #[test]
    fn two_fans_at_a_vertex_are_not_manifold() {
        let check = mesh(5, &[[0, 1, 2], [0, 3, 4]]).check();
        assert_eq!((check.nonmanifold_edges, check.nonmanifold_vertices, check.components), (0, 1, 1));
        assert!(!check.manifold);
    }

    #[test]
    fn parts_loops_and_unused_vertices_are_counted() {
        let tube = cylinder(1.0, 1.0, 12, 3, false).check();
        assert_eq!((tube.boundary_loops, tube.boundary_edges, tube.euler_characteristic), (2, 24, 0));
        let sheet = grid_sheet(1.0, 1.0, 3, 3).check();
        assert_eq!((sheet.boundary_loops, sheet.boundary_edges, sheet.components), (1, 12, 1));
        let two = mesh(8, &[[0, 1, 2], [3, 4, 5], [6, 6, 7]]).check();
        assert_eq!(mesh(8, &[[0, 1, 2], [3, 4, 5], [6, 5, 7]]).parts(), [1, 0, 0]);
        assert_eq!((two.components, two.unused_vertices, two.degenerate_triangles), (2, 2, 1));
        let none = TriangleMesh::default().check();
        assert!(!none.watertight && none.components == 0);
    }
}
