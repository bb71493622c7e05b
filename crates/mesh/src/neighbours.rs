//! Adjacency of the vertices of a mesh.

use crate::mesh::TriangleMesh;

/// The neighbours of every vertex along edges.
///
/// # Examples
/// ```
/// use planish_mesh::{Neighbours, grid_sheet};
/// // Two triangles over four vertices; both contain vertices 0 and 3.
/// let neighbours = Neighbours::from_mesh(&grid_sheet(1.0, 1.0, 1, 1));
/// let mut around = neighbours.of_vertex(0).to_vec();
/// around.sort_unstable();
/// assert_eq!(around, [1, 2, 3, 3]);
/// ```
#[derive(Debug, Clone)]
pub struct Neighbours {
    starts: Vec<u32>,
    all: Vec<u32>,
}

impl Neighbours {
    /// Collects the neighbours of a mesh. Cost O(n).
    #[must_use]
    pub fn from_mesh(mesh: &TriangleMesh) -> Self {
        // One flat array with start indices: a list for each vertex would be an allocation for each
        // vertex.
        let mut starts = vec![0_u32; mesh.positions.len() + 1];
        for v in mesh.triangles.iter().flatten() {
            starts[*v as usize + 1] += 2;
        }
        for v in 0..mesh.positions.len() {
            starts[v + 1] += starts[v];
        }
        // Filled in the order of the triangles, so that sums over neighbours have a fixed order.
        let mut place = starts.clone();
        let mut all = vec![0; 6 * mesh.triangles.len()];
        for t in &mesh.triangles {
            for k in 0..3 {
                for other in [t[(k + 1) % 3], t[(k + 2) % 3]] {
                    let at = &mut place[t[k] as usize];
                    all[*at as usize] = other;
                    *at += 1;
                }
            }
        }
        Self { starts, all }
    }

    /// Neighbours of one vertex. A neighbour occurs once for each triangle at the common edge, usually twice.
    ///
    /// # Panics
    /// If there is no such vertex.
    #[must_use]
    pub fn of_vertex(&self, vertex: u32) -> &[u32] {
        &self.all[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }
}
