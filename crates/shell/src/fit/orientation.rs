//! Orients the parts of a mesh so that their front sides are outside, as lines of sight need it.
//!
//! In: any mesh. Out: the same triangles, some of them flipped. A part is connected over edges with two
//! consistently oriented facets. Parallel rays from many directions vote on the outer side of a part by their
//! first hits. After K. Takayama, A. Jacobson, L. Kavan, O. Sorkine-Hornung, *A
//! simple method for correcting facet orientations in polygon meshes based on ray casting*, 2014.
//!
//! Not guaranteed: parts that no ray hits, and sheets that are hit equally from both sides, stay unchanged.

use planish_core::DVec3;
use planish_core::vector3::tangents;
use planish_estimate::Result;
use planish_mesh::{DisjointSets, MeshSearch, TriangleMesh};
use rayon::prelude::*;
use std::collections::HashMap;

/// Number of directions of rays, and rays along each side of a grid. More rays hit smaller parts; time is
/// proportional.
const DIRECTIONS: usize = 32;
const RAYS: usize = 48;

/// The index of the part of each triangle.
fn parts(mesh: &TriangleMesh) -> Vec<u32> {
    // Seams of textures duplicate vertices; without welding a part would end at each seam.
    let welded = mesh.welded();
    let mut at_edge: HashMap<[u32; 2], Vec<(u32, bool)>> = HashMap::new();
    for (i, t) in welded.triangles.iter().enumerate() {
        for k in 0..3 {
            let [a, b] = [t[k], t[(k + 1) % 3]];
            (at_edge.entry([a.min(b), a.max(b)]).or_default()).push((i as u32, a < b));
        }
    }
    let mut part = DisjointSets::new(mesh.triangles.len());
    // The order of a hash table varies, but it only changes the labels of parts, not the parts.
    for facets in at_edge.values() {
        if let [(a, along), (b, other)] = facets[..]
            && along != other
        {
            part.join(a, b);
        }
    }
    (0..mesh.triangles.len() as u32).map(|i| part.root(i)).collect()
}

/// The triangles of a mesh, with those of inwards facing parts flipped.
///
/// # Errors
/// As [`MeshSearch::try_new`].
pub(super) fn outward(mesh: &TriangleMesh) -> Result<Vec<[u32; 3]>> {
    let Some(bounds) = mesh.surface_bounds() else {
        return Ok(mesh.triangles.clone());
    };
    let part = parts(mesh);
    let search = MeshSearch::try_new(mesh)?;
    let (center, radius) = (bounds.center(), 0.5 * bounds.diagonal());
    let seen: Vec<Vec<(u32, bool)>> = (0..DIRECTIONS)
        .into_par_iter()
        .map(|k| {
            // A spiral over the sphere distributes directions evenly and symmetrically.
            let z = 1.0 - (2 * k + 1) as f64 / DIRECTIONS as f64;
            let (sin, cos) = (2.4 * k as f64).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let way = DVec3::new(r * cos, r * sin, z);
            let (across, up) = tangents(way);
            let from = center - 2.0 * radius * way;
            let share = |i: usize| (2 * i + 1) as f64 / RAYS as f64 - 1.0;
            (0..RAYS * RAYS)
                .filter_map(|i| {
                    let at = from + radius * share(i / RAYS) * across;
                    let hit = search.first_hit(at + radius * share(i % RAYS) * up, way)?;
                    Some((part[hit.triangle as usize], hit.normal.dot(way) > 0.0))
                })
                .collect()
        })
        .collect();
    let mut votes: HashMap<u32, i64> = HashMap::new();
    for (part, behind) in seen.into_iter().flatten() {
        *votes.entry(part).or_default() += if behind { 1 } else { -1 };
    }
    Ok((mesh.triangles.iter().zip(part))
        .map(|([a, b, c], part)| {
            // Equal votes leave a part unchanged: it is a sheet seen from both sides.
            if votes.get(&part).is_some_and(|votes| *votes > 0) { [*a, *c, *b] } else { [*a, *b, *c] }
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_mesh::icosphere;

    /// A ball that faces inwards and has a hole, a reversed patch of it, and a closed ball next to it are
    /// flipped; a ball inside it is not.
    #[test]
    fn inwards_facing_parts_are_flipped() {
        let mut right = icosphere(1.0, 3);
        let positions = right.positions.clone();
        right.triangles.retain(|t| t.iter().any(|v| positions[*v as usize][2] > -0.8));
        let own = right.triangles.len();
        for (radius, at) in [(0.5, 3.0), (0.2, 0.0)] {
            let first = right.positions.len() as u32;
            let other = icosphere(radius, 2);
            (right.positions).extend(other.positions.iter().map(|p| DVec3::new(p.x + at, p.y, p.z + 0.3)));
            (right.triangles).extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
        }
        let mut wrong = right.clone();
        let hidden = right.triangles.len() - icosphere(0.2, 2).triangles.len();
        for (i, t) in wrong.triangles.iter_mut().enumerate() {
            let patch = i < own && t.iter().all(|v| positions[*v as usize][0] > 0.8);
            if i < hidden && !patch {
                t.swap(1, 2);
            }
        }
        let same = |a: &[u32; 3], b: &[u32; 3]| (0..3).any(|k| [a[k], a[(k + 1) % 3], a[(k + 2) % 3]] == *b);
        assert!(!(wrong.triangles.iter().zip(&right.triangles)).all(|(a, b)| same(a, b)));
        for mesh in [&wrong, &right] {
            let made = outward(mesh).unwrap();
            assert!((made.iter().zip(&right.triangles)).all(|(a, b)| same(a, b)));
        }
    }
}
