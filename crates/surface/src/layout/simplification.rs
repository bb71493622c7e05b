//! Coarser meshes of the same surface and topology.
//!
//! Edges are collapsed into one of their ends, the shortest first, so vertices stay where they are. Creases
//! keep their ends and their curves.

use super::creases::CreaseEdges;
use super::faces::{Face, Faces};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::TriangleMesh;

/// Rounds of collapses. In each, edges that were blocked by others get another chance.
const PASSES: usize = 8;
/// Least cosine between the normals of a triangle before and after one of its corners moves.
const MIN_COSINE: f64 = 0.3;

/// A mesh without edges shorter than a length, where its topology and shape allow that.
pub(super) fn simplified(
    mesh: &TriangleMesh,
    creases: &CreaseEdges,
    shortest: f64,
) -> Result<(TriangleMesh, CreaseEdges)> {
    let mut creases = creases.clone();
    let mut faces = Faces::new(&mesh.triangles, mesh.positions.len());
    let at = &mesh.positions;
    for _ in 0..PASSES {
        let length = |(a, b): (u32, u32)| at[a as usize].distance(at[b as usize]);
        let mut short: Vec<(f64, (u32, u32))> = faces.edges().into_iter().map(|e| (length(e), e)).collect();
        short.retain(|(own, _)| *own < shortest);
        short.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let collapsed = |&&(_, (a, b)): &&(f64, (u32, u32))| collapse(&mut faces, &mut creases, at, a, b);
        if short.iter().filter(collapsed).count() == 0 {
            break;
        }
    }
    let (triangles, positions, numbers) = faces.numbered(at);
    let triangles = triangles.into_iter().map(|[a, b, c, _]| [a, b, c]).collect();
    Ok((TriangleMesh::try_new(positions, triangles)?, creases.renumbered(&numbers)))
}

/// Moves the second vertex to the first, or the first to the second.
fn collapse(faces: &mut Faces, creases: &mut CreaseEdges, at: &[DVec3], a: u32, b: u32) -> bool {
    faces.are_joined(a, b)
        && faces.common_neighbours(a, b).len() == 2
        && faces.valence(a) + faces.valence(b) > 7
        && [(a, b), (b, a)].into_iter().any(|(kept, gone)| {
            let moved = |face: Face| {
                let [before, after] =
                    [face, face.renamed(gone, kept)].map(|face| area_vector(face.corners(), at));
                face.corners().contains(&kept)
                    || before.dot(after) >= MIN_COSINE * before.length() * after.length()
            };
            let near = if creases.is_free(gone) { Vec::new() } else { faces.neighbours(gone).to_vec() };
            let is_merged = creases.allows_merge(faces, kept, gone)
                && faces.around(gone).all(|(_, face)| moved(face))
                && faces.merge_into(kept, gone);
            if is_merged {
                creases.merged(kept, gone, &near);
            }
            is_merged
        })
}

fn area_vector(corners: &[u32], at: &[DVec3]) -> DVec3 {
    let [a, b, c] = [0, 1, 2].map(|k| at[corners[k] as usize]);
    (b - a).cross(c - a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_mesh::icosphere;

    #[test]
    fn a_sphere_keeps_its_topology_and_shape() {
        let fine = icosphere(1.0, 5);
        let (coarse, _) = simplified(&fine, &CreaseEdges::default(), 0.3).unwrap();
        let check = coarse.check();
        assert!(check.watertight && check.manifold && check.euler_characteristic == 2, "{check:?}");
        assert!(coarse.positions.len() < fine.positions.len() / 8);
        assert!((coarse.area() / fine.area() - 1.0).abs() < 0.04);
        let shortest =
            |t: &[u32; 3]| coarse.positions[t[0] as usize].distance(coarse.positions[t[1] as usize]);
        assert!(coarse.triangles.iter().map(shortest).fold(1.0, f64::min) >= 0.3);
    }
}
