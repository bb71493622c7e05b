//! Properties of one triangle: normal, angles, area, and its closest point to another point.
//!
//! In: three corners in any position, which may coincide. Out: finite numbers. A triangle without area has a
//! zero normal.

use planish_core::DVec3;

/// Ratio of height to longest edge at which a triangle counts as having no area.
///
/// At this ratio, rounding of the corners turns the normal by about 2e-16 / 1e-12 rad, which is harmless. For
/// thinner triangles the normal becomes arbitrary.
const DEGENERATE_RATIO: f64 = 1e-12;

/// The part of a triangle on which a point lies. Corner `k` is the k-th index of the triangle; edge `k` runs
/// from corner `k` to corner `(k + 1) % 3`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Feature {
    /// The open interior.
    Face,
    /// The open edge from this corner to the next.
    Edge(u8),
    /// This corner.
    Vertex(u8),
}

/// The closest point of one triangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Foot {
    pub squared_distance: f64,
    pub point: DVec3,
    pub barycentric: [f64; 3],
    pub feature: Feature,
}

/// `(b − a) × (c − a)`, or zero for a triangle that is too thin for a reliable direction.
#[inline]
pub(crate) fn area_vector(t: &[DVec3; 3]) -> DVec3 {
    let (ab, ac) = (t[1] - t[0], t[2] - t[0]);
    let n = ab.cross(ac);
    if has_area(n.length_squared(), ab, ac) { n } else { DVec3::ZERO }
}

/// The unit normal, counter-clockwise seen from its tip, or zero where there is no area.
#[inline]
pub(crate) fn unit_normal(t: &[DVec3; 3]) -> DVec3 {
    unit_or_zero(area_vector(t))
}

/// `a / |a|`, or zero.
#[inline]
pub(crate) fn unit_or_zero(a: DVec3) -> DVec3 {
    a.normalize_or_zero()
}

/// The three interior angles in radians.
pub(crate) fn angles(t: &[DVec3; 3]) -> [f64; 3] {
    // The sine of each angle has twice the area in its numerator; the third angle is π minus the others.
    let doubled = area_vector(t).length();
    let [first, second] = [0, 1].map(|k| {
        let (a, b) = (t[(k + 1) % 3] - t[k], t[(k + 2) % 3] - t[k]);
        doubled.atan2(a.dot(b))
    });
    [first, second, (std::f64::consts::PI - first - second).max(0.0)]
}

/// Smallest angle of a triangle in radians, and its aspect ratio: longest edge over the height on it.
///
/// The aspect ratio is at least 1.15 (equilateral) and infinite without area.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// let (smallest, aspect) = planish_mesh::triangle_shape(&[DVec3::ZERO, DVec3::X, DVec3::Y]);
/// assert!((smallest.to_degrees() - 45.0).abs() < 1e-9);
/// assert!((aspect - 2.0).abs() < 1e-9);
/// ```
#[must_use]
pub fn triangle_shape(corners: &[DVec3; 3]) -> (f64, f64) {
    let longest = (0..3).map(|k| (corners[(k + 1) % 3] - corners[k]).length()).fold(0.0, f64::max);
    let doubled = area_vector(corners).length();
    (smallest_angle(corners), longest * longest / doubled)
}

/// Mixed Voronoi area of corner `k`: the part of the triangle that is nearest to it.
///
/// In an obtuse triangle, the obtuse corner has half of the area and the others a quarter each, so that the
/// areas add up to that of the mesh (M. Meyer, M. Desbrun, P. Schröder, A. Barr, 2003, figure 4).
pub(crate) fn mixed_area(corners: &[DVec3; 3], k: usize) -> f64 {
    let triangle_area = area(corners);
    let [p, q, r] = [0, 1, 2].map(|i| corners[(k + i) % 3]);
    let cosines = [(q - p).dot(r - p), (r - q).dot(p - q), (p - r).dot(q - r)];
    // The circumcentre of an obtuse triangle is outside it, so areas by nearness would be negative or too
    // large.
    if cosines[0] <= 0.0 {
        return 0.5 * triangle_area;
    }
    if cosines[1] <= 0.0 || cosines[2] <= 0.0 || triangle_area == 0.0 {
        return 0.25 * triangle_area;
    }
    // (|pq|² cot r + |pr|² cot q) / 8, where each cotangent is the dot product over twice the area.
    let squared = |a: DVec3, b: DVec3| (a - b).length_squared();
    (squared(p, q) * cosines[2] + squared(p, r) * cosines[1]) / (16.0 * triangle_area)
}

/// Smallest angle in radians: the one opposite to the shortest edge.
pub(crate) fn smallest_angle(corners: &[DVec3; 3]) -> f64 {
    let across: [f64; 3] = std::array::from_fn(|k| {
        let edge = corners[(k + 2) % 3] - corners[(k + 1) % 3];
        edge.length_squared()
    });
    // atan2 of the cross and dot product is accurate for small angles, unlike the arc cosine.
    let at = (1..3).fold(0, |shortest, k| if across[k] < across[shortest] { k } else { shortest });
    let [u, v] = [1, 2].map(|k| corners[(at + k) % 3] - corners[at]);
    u.cross(v).length().atan2(u.dot(v))
}

/// `Σ b_k corner_k`.
#[inline]
pub(crate) fn point_at(t: &[DVec3; 3], barycentric: [f64; 3]) -> DVec3 {
    barycentric[0] * t[0] + barycentric[1] * t[1] + barycentric[2] * t[2]
}

#[inline]
fn has_area(squared_cross: f64, ab: DVec3, ac: DVec3) -> bool {
    let bc = ac - ab;
    let longest = ab.length_squared().max(ac.length_squared()).max(bc.length_squared());
    squared_cross > (DEGENERATE_RATIO * longest) * (DEGENERATE_RATIO * longest)
}

/// The closest point of triangle `t` to `p`; `None` if the plane of the triangle is farther away than
/// `sqrt(squared_bound)`.
///
/// If a point projects outside some edges, its closest point lies on one of them, so only these edges are
/// tested. Without area, all three are tested.
#[inline]
pub(crate) fn closest_on_triangle(p: DVec3, t: &[DVec3; 3], squared_bound: f64) -> Option<Foot> {
    let (ab, ac, ap) = (t[1] - t[0], t[2] - t[0], p - t[0]);
    let n = ab.cross(ac);
    let nn = n.length_squared();
    let mut outside = [true; 3];
    if has_area(nn, ab, ac) {
        let height = n.dot(ap);
        // Without the slack, rounding could reject a triangle at the same distance as the best one.
        if height * height > squared_bound * nn * (1.0 + 1e-12) {
            return None;
        }
        let (v, w) = (ap.cross(ac).dot(n), ab.cross(ap).dot(n));
        // All three are scaled by `nn`. Signs need no division, which only a foot inside pays for.
        let u = nn - v - w;
        if u > 0.0 && v > 0.0 && w > 0.0 {
            return Some(Foot {
                squared_distance: height * height / nn,
                point: p - height / nn * n,
                barycentric: [u / nn, v / nn, w / nn],
                feature: Feature::Face,
            });
        }
        outside = [w <= 0.0, u <= 0.0, v <= 0.0];
    }
    let mut best: Option<Foot> = None;
    for k in 0..3 {
        if outside[k] {
            let foot = closest_on_edge(p, t, k);
            if best.is_none_or(|best| foot.squared_distance < best.squared_distance) {
                best = Some(foot);
            }
        }
    }
    best
}

#[inline]
fn closest_on_edge(p: DVec3, t: &[DVec3; 3], k: usize) -> Foot {
    let next = if k == 2 { 0 } else { k + 1 };
    let (a, b) = (t[k], t[next]);
    let ab = b - a;
    let along = (p - a).dot(ab);
    let length = ab.length_squared();
    let mut barycentric = [0.0; 3];
    let (point, feature) = if along <= 0.0 || length == 0.0 {
        barycentric[k] = 1.0;
        (a, Feature::Vertex(k as u8))
    } else if along >= length {
        barycentric[next] = 1.0;
        (b, Feature::Vertex(next as u8))
    } else {
        let s = along / length;
        barycentric[k] = 1.0 - s;
        barycentric[next] = s;
        (a + s * ab, Feature::Edge(k as u8))
    };
    let d = p - point;
    Foot { squared_distance: d.length_squared(), point, barycentric, feature }
}

/// Area of a triangle.
#[inline]
pub(crate) fn area(t: &[DVec3; 3]) -> f64 {
    0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_angle_is_the_minimum_of_three() {
        let triangles = [
            [DVec3::ZERO, DVec3::new(3.0, 0.0, 0.0), DVec3::new(0.4, 1.7, 0.2)],
            [DVec3::new(1.0, 2.0, 3.0), DVec3::new(1.1, 2.0, 3.5), DVec3::new(9.0, -4.0, 2.0)],
            [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.01, 0.0)],
        ];
        for t in triangles {
            let smallest = angles(&t).into_iter().fold(f64::INFINITY, f64::min);
            assert!((smallest_angle(&t) - smallest).abs() < 1e-14, "{t:?}");
        }
        for flat in [[DVec3::ONE; 3], [DVec3::ZERO, DVec3::X, 3.0 * DVec3::X]] {
            assert_eq!(smallest_angle(&flat), 0.0);
        }
    }
}
