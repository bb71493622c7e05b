//! How far what a camera would see of a mesh agrees with a mask.

use planish_mesh::{DepthBuffer, Projected, TriangleMesh};
use planish_sense::Silhouette;
use planish_shell::Camera;

/// The vertices of a mesh as a depth buffer takes them.
pub(super) fn projected(mesh: &TriangleMesh, camera: &Camera) -> Vec<Projected> {
    (mesh.positions.iter())
        .map(|p| match camera.project(*p) {
            // Pixel centres are at integers, the middle of the buffer's first place is at one half.
            Some((at, depth)) => Projected { at: at.map(|x| x + 0.5), depth },
            None => Projected { at: [0.0; 2], depth: -1.0 },
        })
        .collect()
}

/// Which pixels a mesh covers.
pub(crate) fn covered(mesh: &TriangleMesh, camera: &Camera, columns: usize, rows: usize) -> Vec<bool> {
    let buffer = DepthBuffer::draw(columns, rows, &projected(mesh, camera), &mesh.triangles);
    (0..columns * rows).map(|k| buffer.at(k % columns, k / columns).is_some()).collect()
}

/// The pixels that both cover, of those that either does (P. Jaccard 1901).
pub(super) fn intersection_over_union(mesh: &TriangleMesh, camera: &Camera, mask: &Silhouette) -> f64 {
    agreement(mesh, camera, &mask.mask, mask.columns, mask.rows)
}

/// As [`intersection_over_union`], of a mask row by row.
pub(crate) fn agreement(
    mesh: &TriangleMesh,
    camera: &Camera,
    mask: &[bool],
    columns: usize,
    rows: usize,
) -> f64 {
    let own = covered(mesh, camera, columns, rows);
    let (mut both, mut either) = (0_usize, 0_usize);
    for (a, b) in own.iter().zip(mask) {
        both += usize::from(*a && *b);
        either += usize::from(*a || *b);
    }
    both as f64 / either.max(1) as f64
}
