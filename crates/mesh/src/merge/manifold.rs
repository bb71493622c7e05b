//! Extracts the manifold part of a mesh: at most two triangles at an edge, one fan at a vertex.
//!
//! In: any triangles. Out: the triangles that can be kept, in their order, and the source of each vertex. A
//! vertex with several fans is duplicated, once for each fan. Not guaranteed: that triangles do not
//! intersect, or that only a small part is removed.

use crate::edges::{EdgeTable, is_collapsed};
use crate::half_edges::{NONE, next_in_triangle, opposites, opposites_of, previous_in_triangle};
use crate::mesh::TriangleMesh;

/// A mesh whose edges and vertices are manifold and oriented.
#[derive(Debug, Clone)]
pub(super) struct Manifold {
    pub mesh: TriangleMesh,
    /// For each vertex, its index in the original mesh.
    pub source: Vec<u32>,
    /// For each triangle, its index in the original mesh.
    pub triangles: Vec<u32>,
}

/// Keeps the first triangle in each direction of every edge, then splits vertices with several fans. Unused
/// vertices are removed.
pub(super) fn manifold(mesh: &TriangleMesh) -> Manifold {
    let (mut numbers, mut triangles): (Vec<u32>, Vec<[u32; 3]>) =
        (0..).zip(mesh.triangles.iter().copied()).filter(|(_, t)| !is_collapsed(*t)).unzip();
    // A triangle that is dropped changes the table of edges. The loop therefore ends with a pass that
    // drops nothing, whose table is that of the result.
    let table = loop {
        let table = EdgeTable::new(&triangles);
        let mut drop = vec![false; triangles.len()];
        for edge in 0..table.len() {
            let mut occupied = [false; 2];
            for &half in table.half_edges(edge) {
                let t = half as usize / 3;
                let forwards = usize::from(triangles[t][half as usize % 3] == table.ends[edge][0]);
                // The first triangle in each direction stays. This depends only on the order of triangles
                // and edges, so the result is the same every time.
                if !drop[t] {
                    drop[t] = occupied[forwards];
                    occupied[forwards] = true;
                }
            }
        }
        if !drop.contains(&true) {
            break table;
        }
        let mut dropped = drop.iter();
        triangles.retain(|_| dropped.next() == Some(&false));
        let mut dropped = drop.iter();
        numbers.retain(|_| dropped.next() == Some(&false));
    };
    let opposite = opposites_of(&table, triangles.len());
    let (triangles, source) = split_fans(triangles, &opposite, mesh.positions.len());
    let positions = source.iter().map(|&v| mesh.positions[v as usize]).collect();
    Manifold { mesh: TriangleMesh { positions, triangles }, source, triangles: numbers }
}

/// Splits vertices with several fans. Returns the triangles over the new vertices, and the old index of each
/// vertex.
pub(super) fn one_fan_each(triangles: Vec<[u32; 3]>, vertices: usize) -> (Vec<[u32; 3]>, Vec<u32>) {
    let opposite = opposites(&triangles);
    split_fans(triangles, &opposite, vertices)
}

fn split_fans(mut triangles: Vec<[u32; 3]>, opposite: &[u32], vertices: usize) -> (Vec<[u32; 3]>, Vec<u32>) {
    let mut new_of_corner = vec![u32::MAX; 3 * triangles.len()];
    let mut source: Vec<u32> = Vec::with_capacity(vertices);
    for corner in 0..new_of_corner.len() as u32 {
        if new_of_corner[corner as usize] != u32::MAX {
            continue;
        }
        let vertex = source.len() as u32;
        source.push(triangles[corner as usize / 3][corner as usize % 3]);
        // Go around the vertex to the border or back to the start, then in the other direction.
        let mut at = corner;
        loop {
            new_of_corner[at as usize] = vertex;
            let over = opposite[at as usize];
            if over == NONE {
                break;
            }
            at = next_in_triangle(over);
            if at == corner {
                break;
            }
        }
        let mut at = corner;
        loop {
            let over = opposite[previous_in_triangle(at) as usize];
            if over == NONE || new_of_corner[over as usize] == vertex {
                break;
            }
            at = over;
            new_of_corner[at as usize] = vertex;
        }
    }
    for (t, corners) in triangles.iter_mut().enumerate() {
        *corners = std::array::from_fn(|k| new_of_corner[3 * t + k]);
    }
    (triangles, source)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{grid_sheet, icosphere};
    use planish_core::DVec3;

    #[test]
    fn manifold_meshes_stay_unchanged() {
        for mesh in [icosphere(1.0, 2), grid_sheet(1.0, 1.0, 4, 5)] {
            let kept = manifold(&mesh);
            assert!(kept.triangles.iter().copied().eq(0..mesh.triangles.len() as u32));
            assert_eq!(kept.mesh.check(), mesh.check());
        }
    }

    #[test]
    fn fins_are_removed_and_fans_at_a_vertex_are_split() {
        let positions =
            (0..8).map(|i| DVec3::new(f64::from(i), f64::from(i * i), f64::from(i * i * i))).collect();
        let mesh =
            TriangleMesh::try_new(positions, vec![[0, 1, 2], [1, 0, 3], [0, 1, 4], [2, 5, 6], [6, 6, 7]])
                .unwrap();
        let kept = manifold(&mesh);
        let check = kept.mesh.check();
        assert!(check.manifold && check.oriented, "{check:?}");
        assert_eq!((kept.triangles, check.components), (vec![0, 1, 3], 2));
        assert_eq!(kept.source.iter().filter(|&&v| v == 2).count(), 2);
    }
}
