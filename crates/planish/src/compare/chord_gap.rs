//! The height of a smooth surface over the facets of its mesh.
//!
//! Input: a mesh and feet on it. Output: the mean height at these feet, from the normals of the vertices. Not
//! guaranteed: meshes whose smooth surface turns by more than 30° along an edge.

use super::Pair;
use planish_mesh::TriangleMesh;

/// Smallest cosine between the normals at the ends of an edge along which a surface counts as smooth: that of
/// 30°. A sharp edge of a part has no gap, and its vertices have normals between those of the faces.
const SMOOTH: f64 = 0.866;

/// Mean of `½ Σ λ_i λ_j (n_j − n_i)·(p_j − p_i)` over the feet: the error of linear interpolation of a
/// quadratic with the normals `n` at the corners `p`. In the unit of the mesh.
///
/// For an edge of length `l` on a circle of radius `R` the middle has the height `l²/8R`.
pub(super) fn mean_chord_gap(mesh: &TriangleMesh, pairs: &[Pair]) -> f64 {
    let normals = mesh.vertex_normals();
    let gap = |(triangle, weights): (u32, [f64; 3])| -> f64 {
        let corners = mesh.triangles[triangle as usize].map(|v| v as usize);
        ([(0, 1), (1, 2), (2, 0)].into_iter())
            .map(|(i, j)| {
                let (a, b) = (corners[i], corners[j]);
                if normals[a].dot(normals[b]) < SMOOTH {
                    return 0.0;
                }
                let turned = (normals[b] - normals[a]).dot(mesh.positions[b] - mesh.positions[a]);
                0.5 * weights[i] * weights[j] * turned
            })
            .sum()
    };
    pairs.iter().filter_map(|pair| pair.facet).map(gap).sum::<f64>() / pairs.len().max(1) as f64
}
