//! Subdivides meshes into small facets, for spherical metaballs.
//!
//! In: a mesh. Out: facets with separate vertices, and the vertices of the mesh with which each of them
//! moves.

use planish_core::DVec3;
use planish_mesh::TriangleMesh;

/// Subdivides the facets of a mesh into similar ones until no circle around a facet is larger than `radius`,
/// or there would be more than `max_facets` facets.
///
/// The second result has, for every new vertex, the corners of the facet that contains it, and their weights.
///
/// # Examples
/// ```
/// use planish_mesh::icosphere;
/// use planish_shell::subdivide_for_spheres;
/// let ball = icosphere(1.0, 1);
/// let (fine, origins) = subdivide_for_spheres(&ball, 0.1, 10_000);
/// assert!(fine.triangles.len() > ball.triangles.len());
/// assert_eq!(origins.len(), fine.positions.len());
/// ```
#[must_use]
pub fn subdivide_for_spheres(
    mesh: &TriangleMesh,
    radius: f64,
    max_facets: usize,
) -> (TriangleMesh, Vec<[(u32, f64); 3]>) {
    let mut positions = mesh.positions.clone();
    let mut origins: Vec<[(u32, f64); 3]> =
        (0..positions.len() as u32).map(|v| [(v, 1.0), (v, 0.0), (v, 0.0)]).collect();
    let mut triangles = Vec::with_capacity(mesh.triangles.len());
    let room = max_facets.max(mesh.triangles.len());
    let mut total: usize = 0;
    let pieces: Vec<usize> = (mesh.triangles.iter())
        .map(|t| {
            let corners = t.map(|c| mesh.positions[c as usize]);
            let longest = (0..3).map(|k| corners[k].distance(corners[(k + 1) % 3])).fold(0.0, f64::max);
            // The circle about a piece is at most half of its longest side where it is obtuse, and less than
            // 0.58 of it anywhere.
            let along = (longest / (1.73 * radius)).ceil().clamp(1.0, 1e4) as usize;
            total = total.saturating_add(along * along);
            along
        })
        .collect();
    let shrink = if total > room { (room as f64 / total as f64).sqrt() } else { 1.0 };
    for (t, pieces) in mesh.triangles.iter().zip(pieces) {
        let n = ((pieces as f64 * shrink) as usize).max(1);
        if n == 1 {
            triangles.push(*t);
            continue;
        }
        // The n × n pieces of a triangle have separate vertices; shells need no shared ones.
        let first = positions.len() as u32;
        let row_start = |row: usize| (row * (n + 1) - row * row.saturating_sub(1) / 2) as u32;
        for row in 0..=n {
            for column in 0..=n - row {
                let [b, c] = [column, row].map(|i| i as f64 / n as f64);
                let weights = [1.0 - b - c, b, c];
                let at = std::array::from_fn(|k| {
                    (0..3).map(|i| weights[i] * mesh.positions[t[i] as usize][k]).sum()
                });
                positions.push(DVec3::from_array(at));
                origins.push(std::array::from_fn(|i| (t[i], weights[i])));
            }
        }
        for row in 0..n {
            for column in 0..n - row {
                let corner = first + row_start(row) + column as u32;
                let above = first + row_start(row + 1) + column as u32;
                triangles.push([corner, corner + 1, above]);
                if column + 1 < n - row {
                    triangles.push([corner + 1, above + 1, above]);
                }
            }
        }
    }
    (TriangleMesh { positions, triangles }, origins)
}
