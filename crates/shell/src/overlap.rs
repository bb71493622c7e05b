//! Pixels that a mesh covers in a camera, and their agreement with a mask.

use crate::camera::Camera;
use planish_mesh::{DepthBuffer, Projected, TriangleMesh};

/// Vertices of a mesh in the image of a camera, as input of a depth buffer.
#[must_use]
pub fn projected_vertices(mesh: &TriangleMesh, camera: &Camera) -> Vec<Projected> {
    (mesh.positions.iter())
        .map(|p| match camera.project(*p) {
            // Pixel centres are at integers here, and at half integers in the buffer.
            Some((at, depth)) => Projected { at: at.map(|x| x + 0.5), depth },
            None => Projected { at: [0.0; 2], depth: -1.0 },
        })
        .collect()
}

/// Pixels that a mesh covers, row by row.
#[must_use]
pub fn covered_pixels(mesh: &TriangleMesh, camera: &Camera, columns: usize, rows: usize) -> Vec<bool> {
    let buffer = DepthBuffer::draw(columns, rows, &projected_vertices(mesh, camera), &mesh.triangles);
    (0..columns * rows).map(|k| buffer.at(k % columns, k / columns).is_some()).collect()
}

/// Intersection over union of the covered pixels and a mask, row by row (P. Jaccard 1901).
#[must_use]
pub fn intersection_over_union(
    mesh: &TriangleMesh,
    camera: &Camera,
    mask: &[bool],
    columns: usize,
    rows: usize,
) -> f64 {
    let own = covered_pixels(mesh, camera, columns, rows);
    let (mut both, mut either) = (0_usize, 0_usize);
    for (a, b) in own.iter().zip(mask) {
        both += usize::from(*a && *b);
        either += usize::from(*a || *b);
    }
    // Two empty masks give zero instead of NaN.
    both as f64 / either.max(1) as f64
}
