//! How much of a mesh a fit strains.
//!
//! In: a mesh before and after. Out: the share of its area whose triangles are stretched in one direction
//! more than twice as much as in the other.
//!
//! A triangle with edges `e₁, e₂` has the metric `G = [eᵢ·eⱼ]`. The squared stretches `λ₁ ≥ λ₂` are the
//! eigenvalues of `G₀⁻¹ G`, and `(λ₁ + λ₂)²/(λ₁ λ₂) = (r + 1/r)²` with the ratio `r` of the stretches.
//!
//! Not guaranteed: objects may differ that much from their meshes.

use planish_core::DVec3;
use planish_mesh::TriangleMesh;

/// Ratio of the stretches in two directions, above which a triangle counts. Twists and bends by 40°, changes
/// of size by a quarter and waves have it on at most 0.3 % of the area; fits that ended with a part at
/// another angle than the object's on 10 to 40 %.
const MAX_RATIO: f64 = 2.0;

/// Share of the area of a mesh that is strained, from one set of positions to another.
pub(super) fn strained_share(mesh: &TriangleMesh, before: &[DVec3], after: &[DVec3]) -> f64 {
    let limit = (MAX_RATIO + 1.0 / MAX_RATIO).powi(2);
    let (mut strained, mut all) = (0.0, 0.0);
    for triangle in &mesh.triangles {
        let [[a, b, c], [d, e, f]] = [before, after].map(|positions| metric(positions, triangle));
        let (area, now) = (a * c - b * b, d * f - e * e);
        if area <= 0.0 {
            continue;
        }
        let trace = (c * d - 2.0 * b * e + a * f) / area;
        all += area.sqrt();
        if trace * trace * area > limit * now.max(0.0) {
            strained += area.sqrt();
        }
    }
    if all > 0.0 { strained / all } else { 0.0 }
}

fn metric(positions: &[DVec3], [a, b, c]: &[u32; 3]) -> [f64; 3] {
    let [a, b, c] = [a, b, c].map(|v| positions[*v as usize]);
    let (first, second) = (b - a, c - a);
    [first.length_squared(), first.dot(second), second.length_squared()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_mesh::icosphere;

    /// Rotations and changes of size strain nothing; stretches in one direction do from the limit on.
    #[test]
    fn stretches_in_one_direction_are_found() {
        let ball = icosphere(1.0, 3);
        let share = |map: &dyn Fn(&DVec3) -> DVec3| {
            strained_share(&ball, &ball.positions, &ball.positions.iter().map(map).collect::<Vec<_>>())
        };
        assert_eq!(share(&|p| 3.0 * DVec3::new(-p[1], p[0], p[2])), 0.0);
        assert_eq!(share(&|p| DVec3::new(p[0], p[1], 1.9 * p[2])), 0.0);
        let long = share(&|p| DVec3::new(p[0], p[1], 4.0 * p[2]));
        assert!(long > 0.5 && long < 1.0, "{long}");
        assert_eq!(share(&|p| DVec3::new(p[0], 0.0, 0.0)), 1.0);
    }
}
