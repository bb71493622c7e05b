//! Which vertices of a mesh edges join.

use crate::mesh::TriangleMesh;

/// The neighbours of every vertex along edges.
#[derive(Debug, Clone)]
pub struct Neighbours {
    starts: Vec<u32>,
    all: Vec<u32>,
}

impl Neighbours {
    /// Cost O(n).
    #[must_use]
    pub fn of(mesh: &TriangleMesh) -> Self {
        let mut starts = vec![0_u32; mesh.positions.len() + 1];
        for v in mesh.triangles.iter().flatten() {
            starts[*v as usize + 1] += 2;
        }
        for v in 0..mesh.positions.len() {
            starts[v + 1] += starts[v];
        }
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

    /// Those of one vertex. Along an edge of two triangles each comes twice.
    ///
    /// # Panics
    /// Where there is no such vertex.
    #[must_use]
    pub fn of_vertex(&self, vertex: u32) -> &[u32] {
        &self.all[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }
}
