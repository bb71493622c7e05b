//! Reduces surfaces that have too many triangles for a fluent 3D view.
//!
//! In: a surface. Out: a surface over a subset of its vertices, with their values. Not guaranteed: that the
//! result is manifold; it is for display only.

use super::{SeenBy, SurfaceShown};
use crate::field::{Field, Values};
use crate::numbers::count;
use planish_core::DVec3;
use std::collections::{HashMap, HashSet};

/// Maximum number of triangles: a browser without a graphics card can load and rotate them without delay.
pub(crate) const MAX_TRIANGLES: usize = 150_000;
/// Estimated number of cells that a surface meets, per cell² of its area; oblique surfaces meet more.
///
/// Only a first guess of the cell size: [`GROWTH`] corrects it.
const CELLS_PER_AREA: f64 = 1.5;
/// Growth of the cells per attempt. Smaller steps come closer to the limit but need more attempts.
const GROWTH: f64 = 1.15;

/// Reduces a surface to at most `max_triangles`; `None` if it has no more, or is flat-shaded (a solid).
///
/// Vertices are clustered in the cells of a grid (Rossignac and Borrel 1993). Vertices with different
/// directions of their normals form separate clusters, so that both sides of a thin wall remain. The vertex
/// closest to the centre of a cluster represents it. Positions and values that a reader clicks are therefore
/// those of the file.
pub(crate) fn thinned(surface: &SurfaceShown, max_triangles: usize) -> Option<SurfaceShown> {
    if surface.triangles.len() <= max_triangles || surface.flat {
        return None;
    }
    let normals = normals(surface);
    let area: f64 = 0.5 * (surface.triangles.iter()).map(|t| length(cross_of(surface, t))).sum::<f64>();
    if !(area > 0.0 && area.is_finite()) {
        return None;
    }
    // A triangulated surface has about twice as many triangles as vertices, that is, as occupied cells.
    let mut side = (2.0 * CELLS_PER_AREA * area / max_triangles as f64).sqrt().max(f64::MIN_POSITIVE);
    // The number of triangles decreases to zero with growing cells, so the loop ends.
    loop {
        let (kept, triangles) = clustered(surface, &normals, side);
        if triangles.len() <= max_triangles {
            return Some(with_vertices(surface, &kept, triangles));
        }
        side *= GROWTH;
    }
}

/// Cross product of two sides: twice the area vector.
fn cross_of(surface: &SurfaceShown, triangle: &[u32; 3]) -> DVec3 {
    let [a, b, c] = triangle.map(|k| surface.positions[k as usize]);
    (b - a).cross(c - a)
}

/// Euclidean length, without overflow for huge coordinates.
fn length(v: DVec3) -> f64 {
    v.x.hypot(v.y).hypot(v.z)
}

/// Vertex normals, weighted by area (not normalised).
fn normals(surface: &SurfaceShown) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; surface.positions.len()];
    for triangle in &surface.triangles {
        let cross = cross_of(surface, triangle);
        for k in triangle {
            normals[*k as usize] += cross;
        }
    }
    normals
}

/// Index of the axis direction (±x, ±y, ±z) that is closest to a normal.
fn facing(normal: &DVec3) -> u8 {
    let axis = (0..3).fold(0, |largest, d| if normal[d].abs() > normal[largest].abs() { d } else { largest });
    2 * axis as u8 + u8::from(normal[axis] < 0.0)
}

/// The vertices that represent the clusters, and the triangles between three different clusters.
fn clustered(surface: &SurfaceShown, normals: &[DVec3], side: f64) -> (Vec<u32>, Vec<[u32; 3]>) {
    let mut numbers: HashMap<([i64; 3], u8), u32> = HashMap::new();
    let of_vertex: Vec<u32> = (surface.positions.iter().zip(normals))
        .map(|(p, normal)| {
            let next = numbers.len() as u32;
            let key = (p.to_array().map(|x| (x / side).floor() as i64), facing(normal));
            *numbers.entry(key).or_insert(next)
        })
        .collect();
    let mut sums = vec![(DVec3::ZERO, 0.0); numbers.len()];
    for (cluster, p) in of_vertex.iter().zip(&surface.positions) {
        let (sum, count) = &mut sums[*cluster as usize];
        *sum += *p;
        *count += 1.0;
    }
    // An existing vertex, not the mean: the mean would lie off the surface and would have no values.
    let mut nearest = vec![(f64::INFINITY, 0_u32); numbers.len()];
    for (k, (cluster, p)) in of_vertex.iter().zip(&surface.positions).enumerate() {
        let (sum, count) = sums[*cluster as usize];
        let away = length(*p - sum / count);
        if away < nearest[*cluster as usize].0 {
            nearest[*cluster as usize] = (away, k as u32);
        }
    }
    // Several fine triangles can collapse to the same coarse one, which must count once.
    let mut seen = HashSet::new();
    let triangles = (surface.triangles.iter())
        .map(|t| t.map(|k| of_vertex[k as usize]))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .filter(|t| {
            // Rotated copies of a triangle count as one.
            let first = (0..3).min_by_key(|k| t[*k]).unwrap_or(0);
            seen.insert([t[first], t[(first + 1) % 3], t[(first + 2) % 3]])
        })
        .collect();
    (nearest.into_iter().map(|(_, k)| k).collect(), triangles)
}

/// The surface over a subset of its vertices, named so that a reader sees the reduction.
fn with_vertices(surface: &SurfaceShown, kept: &[u32], triangles: Vec<[u32; 3]>) -> SurfaceShown {
    let at = |k: &u32| *k as usize;
    let field = |field: &Field| Field {
        values: match &field.values {
            Values::Numbers(numbers) => Values::Numbers(kept.iter().map(|k| numbers[at(k)]).collect()),
            Values::Kinds(kinds) => Values::Kinds(kept.iter().map(|k| kinds[at(k)]).collect()),
        },
        ..field.clone()
    };
    SurfaceShown {
        name: format!(
            "{} ({} of its {} triangles)",
            surface.name,
            count(triangles.len()),
            count(surface.triangles.len())
        ),
        positions: kept.iter().map(|k| surface.positions[at(k)]).collect(),
        fields: surface.fields.iter().map(field).collect(),
        seen_by: surface.seen_by.as_ref().map(|seen| SeenBy {
            of_vertex: kept.iter().map(|k| seen.of_vertex[at(k)]).collect(),
            ..seen.clone()
        }),
        triangles,
        ..*surface
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::FieldKind;

    /// Both sides of a plate that is thinner than the grid cells.
    fn plate(n: u32) -> SurfaceShown {
        let mut made = SurfaceShown { name: "plate".to_owned(), ..SurfaceShown::default() };
        for (z, up) in [(0.0, false), (1e-4, true)] {
            let base = made.positions.len() as u32;
            for i in 0..=n {
                for j in 0..=n {
                    made.positions.push(DVec3::new(
                        f64::from(i) / f64::from(n),
                        f64::from(j) / f64::from(n),
                        z,
                    ));
                }
            }
            for i in 0..n {
                for j in 0..n {
                    let a = base + i * (n + 1) + j;
                    let [b, c, d] = [a + n + 1, a + n + 2, a + 1];
                    let two = [[a, b, c], [a, c, d]];
                    made.triangles.extend(two.map(|[a, b, c]| if up { [a, b, c] } else { [a, c, b] }));
                }
            }
        }
        let values = made.positions.iter().map(|p| p[0] + 2.0 * p[1] + 3.0 * p[2]).collect();
        made.fields.push(Field {
            key: "sigma".to_owned(),
            label: "σ".to_owned(),
            unit: String::new(),
            shown: None,
            kind: FieldKind::Sequential,
            values: Values::Numbers(values),
        });
        made
    }

    #[test]
    fn reduction_keeps_both_sides_of_a_plate_and_values_of_vertices() {
        let full = plate(100);
        let few = thinned(&full, 4000).expect("fewer triangles");
        assert!((1000..=4000).contains(&few.triangles.len()), "{}", few.triangles.len());
        let area = |side: bool| -> f64 {
            let on_side = (few.triangles.iter())
                .filter(|t| t.iter().all(|k| (few.positions[*k as usize][2] > 0.0) == side));
            on_side.map(|t| 0.5 * cross_of(&few, t)[2]).sum()
        };
        // Clusters at the border end inside the plate, so some area is lost.
        assert!(area(true) > 0.85 && area(false) < -0.85, "{} {}", area(true), area(false));
        let Values::Numbers(values) = &few.fields[0].values else { panic!("numbers") };
        for (p, value) in few.positions.iter().zip(values) {
            assert!(full.positions.contains(p));
            assert_eq!(*value, p[0] + 2.0 * p[1] + 3.0 * p[2]);
        }
        assert!(few.name.ends_with("of its 40 000 triangles)"), "{}", few.name);
        assert_eq!(thinned(&few, 4000), None);
    }
}
