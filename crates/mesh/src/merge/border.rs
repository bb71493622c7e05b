//! Distance from the vertices of a patch to its border.

use crate::half_edges::{NONE, opposites};
use crate::mesh::TriangleMesh;
use crate::neighbours::Neighbours;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// For each vertex, the length of the shortest path along edges to the border; infinite without a border.
///
/// Paths longer than `limit` are not followed: vertices farther away get `limit`.
///
/// Cost: O(n log n) for the part within the limit (Dijkstra from all border vertices at once).
pub(super) fn distance_to_border(mesh: &TriangleMesh, limit: f64) -> Vec<f64> {
    let opposite = opposites(&mesh.triangles);
    let mut far = vec![f64::INFINITY; mesh.positions.len()];
    let mut queue = BinaryHeap::new();
    for (half, _) in opposite.iter().enumerate().filter(|(_, o)| **o == NONE) {
        for k in [half % 3, (half % 3 + 1) % 3] {
            let v = mesh.triangles[half / 3][k];
            if far[v as usize] != 0.0 {
                far[v as usize] = 0.0;
                queue.push(Reverse((0, v)));
            }
        }
    }
    if queue.is_empty() {
        return far;
    }
    let neighbours = Neighbours::from_mesh(mesh);
    // The heap needs a total order, which floats lack. Non-negative floats compare like their bits.
    while let Some(Reverse((bits, v))) = queue.pop() {
        let distance = f64::from_bits(bits);
        // The heap has no decrease-key: a shorter path to this vertex was processed before.
        if distance > far[v as usize] {
            continue;
        }
        for &to in neighbours.of_vertex(v) {
            let longer = distance + mesh.positions[v as usize].distance(mesh.positions[to as usize]);
            if longer < far[to as usize] && longer < limit {
                far[to as usize] = longer;
                queue.push(Reverse((longer.to_bits(), to)));
            }
        }
    }
    for d in &mut far {
        *d = d.min(limit);
    }
    far
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{grid_sheet, icosphere};

    #[test]
    fn distances_match_a_flat_sheet_and_are_infinite_on_a_ball() {
        let sheet = grid_sheet(2.0, 4.0, 21, 41);
        let far = distance_to_border(&sheet, 10.0);
        for (p, d) in sheet.positions.iter().zip(&far) {
            let straight = (1.0 - p[0].abs()).min(2.0 - p[1].abs());
            assert!((d - straight).abs() < 1e-9, "{p:?}: {d}, {straight}");
        }
        assert!(distance_to_border(&sheet, 0.3).iter().all(|d| *d <= 0.3));
        assert!(distance_to_border(&icosphere(1.0, 1), 1.0).iter().all(|d| d.is_infinite()));
    }
}
