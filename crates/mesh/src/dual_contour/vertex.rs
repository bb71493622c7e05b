//! The place of a vertex: where the tangent planes of the crossings of its piece meet.

use super::DistanceField;
use planish_core::{DVec3, SymmetricMatrix3};

/// Smallest eigenvalue of the normals, relative to the largest, for which planes are taken to meet in an edge
/// or a corner. Two planes with 16° between them have this ratio. Less curved pieces are placed in the middle
/// of their crossings and moved onto the surface.
const MIN_EIGENVALUE: f64 = 0.02;
/// Distance of vertices from the faces of their cube, in cells; vertices of neighbours then never coincide.
const MARGIN: f64 = 1e-3;
/// Distance from the surface, in cells, below which a vertex is not moved again.
const NEAR: f64 = 1e-4;
/// Steps of the search in a cube. Two directions at an angle of 16° converge by a factor of 0.92 a step.
const STEPS: usize = 40;

/// The mean of the crossings.
pub(super) fn middle(crossings: &[(DVec3, DVec3)]) -> DVec3 {
    crossings.iter().map(|(at, _)| *at).sum::<DVec3>() / crossings.len().max(1) as f64
}

/// The vertex of a piece with these crossings and normals, within the cube with the lowest corner `low`.
///
/// It minimises `Σ (n_i · (x − p_i))²`, in directions that the normals do not determine as near to the mean
/// of the crossings as possible (P. Lindstrom, *Out-of-core simplification of large polygonal models*,
/// SIGGRAPH 2000), and is then moved onto the surface along the gradient.
pub(super) fn on_surface(
    crossings: &[(DVec3, DVec3)],
    low: DVec3,
    cell: f64,
    field: &impl DistanceField,
) -> DVec3 {
    let mean = middle(crossings);
    let (lowest, highest) = (low + MARGIN * cell, low + (1.0 - MARGIN) * cell);
    let mut normals = SymmetricMatrix3::ZERO;
    let mut right = DVec3::ZERO;
    for (at, normal) in crossings {
        normals.add_outer(1.0, *normal);
        right += normal.dot(*at - mean) * *normal;
    }
    let (vectors, values) = normals.eigen();
    let offset: DVec3 = (vectors.iter().zip(values))
        .filter(|(_, value)| *value > MIN_EIGENVALUE * values[0])
        .map(|(vector, value)| vector.dot(right) / value * *vector)
        .sum();
    let mut at = mean + offset;
    if at.clamp(lowest, highest) != at {
        at = nearest_in_box(&normals, right, mean, [lowest, highest]);
    }
    // A step along the gradient, which is exact where the surface is smooth. On an edge the distance is zero
    // already, and where features are smaller than the cube, the step may not help.
    let (distance, gradient) = field.distance_and_gradient(at);
    if distance.abs() > NEAR * cell {
        let moved = (at - distance * gradient).clamp(lowest, highest);
        if field.distance(moved).abs() < distance.abs() {
            return moved;
        }
    }
    at
}

/// The minimum of `(x − mean)ᵀ A (x − mean) − 2 right·(x − mean)` in a box, one coordinate after the other.
fn nearest_in_box(
    normals: &SymmetricMatrix3,
    right: DVec3,
    mean: DVec3,
    [lowest, highest]: [DVec3; 2],
) -> DVec3 {
    let rows = normals.rows();
    // Fixes directions that no normal determines.
    let weight = 1e-3 * normals.trace();
    let mut offset = DVec3::ZERO;
    for _ in 0..STEPS {
        for k in 0..3 {
            let others: f64 = (0..3).filter(|&j| j != k).map(|j| rows[k][j] * offset[j]).sum();
            let best = (right[k] - others) / (rows[k][k] + weight);
            offset[k] = best.clamp(lowest[k] - mean[k], highest[k] - mean[k]);
        }
    }
    mean + offset
}
