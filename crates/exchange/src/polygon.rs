//! Splits the polygons of mesh files into triangles.
//!
//! **Input.** The corners of a polygon.
//!
//! **Output.** Triangles of its corners. A convex polygon of few corners becomes a fan around its first
//! corner; another one is triangulated in its plane in O(n log n).
//!
//! **Limits.** A polygon that crosses itself, or whose corners are not known yet, becomes a fan.

use planish_core::DVec3;
use planish_solid::tessellation::triangulate_polygon;

/// Maximum number of corners of a fan. A fan of many corners has thin triangles that overlap in every search
/// tree, so that searches would visit all of them.
const MAX_FAN: usize = 32;

/// Calls `add` with the triangles of a polygon of `count` corners, as indices of its corners. `at` returns
/// the position of a corner, if it is known.
pub(crate) fn split_polygon(
    count: usize,
    at: impl Fn(usize) -> Option<DVec3>,
    mut add: impl FnMut([usize; 3]),
) {
    // Triangles first, because nearly all polygons are.
    if count > 3
        && let Some(corners) = (0..count).map(&at).collect::<Option<Vec<DVec3>>>()
        && let Some(triangles) = triangles(&corners)
    {
        return triangles.into_iter().for_each(|t| add(t.map(|k| k as usize)));
    }
    (1..count.saturating_sub(1)).for_each(|k| add([0, k, k + 1]));
}

/// Triangles in the plane of a polygon; none if a fan is as good or nothing else is possible.
fn triangles(corners: &[DVec3]) -> Option<Vec<[u32; 3]>> {
    // Relative to the first corner: a far origin would lose digits.
    let from_first = |k: usize| corners[k % corners.len()] - corners[0];
    // Twice the area vector (Newell): exact for a plane polygon, and a mean for another one.
    let normal: DVec3 = (0..corners.len()).map(|k| from_first(k).cross(from_first(k + 1))).sum();
    let turns = |k: usize| {
        let (a, b) = (from_first(k + 1) - from_first(k), from_first(k + 2) - from_first(k + 1));
        a.cross(b).dot(normal) >= 0.0
    };
    if corners.len() <= MAX_FAN && (0..corners.len()).all(turns) {
        return None;
    }
    // Along the axis of the largest component, so that the projection keeps most of the area.
    let size = normal.abs().to_array();
    let axis = (1..3).fold(0, |largest, k| if size[k] > size[largest] { k } else { largest });
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let is_turned = normal[axis] < 0.0;
    let flat: Vec<[f64; 2]> = (0..corners.len())
        .map(from_first)
        .map(|p| if is_turned { [p[v], p[u]] } else { [p[u], p[v]] })
        .collect();
    triangulate_polygon(&flat).ok().filter(|triangles| !triangles.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn split(corners: &[DVec3]) -> Vec<[usize; 3]> {
        let mut found = Vec::new();
        split_polygon(corners.len(), |k| Some(corners[k]), |t| found.push(t));
        found
    }

    fn area(corners: &[DVec3], triangles: &[[usize; 3]]) -> f64 {
        let of = |t: &[usize; 3]| {
            let [a, b, c] = t.map(|k| corners[k]);
            0.5 * (b - a).cross(c - a).length()
        };
        triangles.iter().map(of).sum()
    }

    /// A star in a tilted plane.
    fn star(count: usize) -> Vec<DVec3> {
        let corner = |k: usize| {
            let (sin, cos) = (TAU * k as f64 / count as f64).sin_cos();
            let radius = 1.0 + (k % 2) as f64;
            DVec3::new(radius * cos, radius * sin, 0.3 * radius * cos) + DVec3::splat(1000.0)
        };
        (0..count).map(corner).collect()
    }

    #[test]
    fn triangles_of_a_star_cover_it_once_and_keep_its_orientation() {
        for count in [10, 200] {
            for corners in [star(count), star(count).into_iter().rev().collect::<Vec<_>>()] {
                let found = split(&corners);
                // Each pair of neighbouring corners and the centre form a triangle.
                let n = count as f64;
                let exact = 0.5 * 2.0 * (TAU / n).sin() * n * 1.09_f64.sqrt();
                assert_eq!(found.len(), count - 2);
                assert!((area(&corners, &found) - exact).abs() < 1e-9 * exact);
                let sum = |triangles: &[[usize; 3]]| -> DVec3 {
                    let of =
                        |t: &[usize; 3]| (corners[t[1]] - corners[t[0]]).cross(corners[t[2]] - corners[t[0]]);
                    triangles.iter().map(of).sum()
                };
                let fan: Vec<[usize; 3]> = (1..count - 1).map(|k| [0, k, k + 1]).collect();
                assert!(sum(&found).dot(sum(&fan)) > 0.0);
            }
        }
    }

    #[test]
    fn convex_polygons_stay_fans_and_large_ones_have_no_hub() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
        assert_eq!(split(&square), [[0, 1, 2], [0, 2, 3]]);
        let arrow =
            [DVec3::ZERO, DVec3::new(2.0, 1.0, 0.0), DVec3::new(1.0, 1.0, 0.0), DVec3::new(1.0, 2.0, 0.0)];
        assert!((area(&arrow, &split(&arrow)) - 1.0).abs() < 1e-12);
        let count = 5000;
        let circle: Vec<DVec3> = (0..count)
            .map(|k| TAU * f64::from(k) / f64::from(count))
            .map(|angle| DVec3::new(angle.cos(), 0.0, angle.sin()))
            .collect();
        let found = split(&circle);
        let mut valence = vec![0; circle.len()];
        found.iter().flatten().for_each(|k| valence[*k] += 1);
        assert_eq!(found.len(), circle.len() - 2);
        assert!(valence.iter().max() < Some(&1000));
    }

    #[test]
    fn crossing_and_flat_polygons_become_fans() {
        let bow = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(1.0, 1.0, 0.0)];
        assert_eq!(split(&bow), [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(split(&[DVec3::ZERO; 5]).len(), 3);
        assert!(split(&[DVec3::ZERO; 2]).is_empty());
    }
}
