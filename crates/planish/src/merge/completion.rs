//! Completes a merged surface with a surface that contains the object.
//!
//! Input: a merged surface, and a mesh that contains the object (the bound), such as the visual hull of its
//! silhouettes (A. Laurentini 1994). Output: one mesh that follows the bound where no patch is. Not
//! guaranteed: the object may be smaller there than its bound. Parts of patches whose orientation relative to
//! the bound is undetermined are kept as they are ([`Facing::undetermined`]).

use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_mesh::{
    DisjointSets, FusedVertices, MergePatch, MeshSearch, Overlap, OverlapOptions, StitchOptions,
    StitchedMesh, TriangleMesh, stitch_patches,
};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The bound is removed where a patch is within this many of its edges along the normal. With a smaller
/// value, pieces of the bound remain over a patch where the hull stands off.
const MAX_GAP_EDGES: f64 = 6.0;
/// The bound is also removed within this many edges of a patch's border, which leaves room for stitching.
const BORDER_EDGES: f64 = 1.0;
/// Maximum angle between normals of the same side of an object. Larger angles would pair the two sides of a
/// thin part.
const MAX_ANGLE_RAD: f64 = 1.2;
/// ε of the overlap search, in edges. The remaining bound overlaps no patch, so almost nothing may be fused.
const EPSILON: f64 = 0.01;

/// Maximum distance of patch triangles outside the bound, in edges of the bound.
const MAX_OUTSIDE_EDGES: f64 = 1.5;
/// Maximum number of edges of a notch in a stitched border. Larger holes are left to hole filling.
const MAX_NOTCH_EDGES: usize = 8;
/// Maximum number of sample points along an edge of a triangle.
const MAX_STEPS: usize = 32;

/// A part of the patches faces outwards or inwards where the mean cosine between its normals and those of the
/// bound is larger than this. A sheet that stands on edge has a mean near zero, and reversing it would be a
/// guess (see the tests).
const MIN_FACING_COSINE: f64 = 0.1;
/// Approximate number of sample points of a part for its orientation.
const ORIENTATION_SAMPLES: usize = 5000;

/// Orientation of the parts of patches relative to a bound.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Facing {
    /// Connected parts that faced inwards, and were turned over.
    pub turned: usize,
    /// Parts whose orientation is undetermined. They are kept as they are.
    pub undetermined: usize,
}

/// A completed mesh, and the part of it that comes from the bound.
pub(super) struct Completed {
    /// The completed mesh. In its sources, patch 0 is the merged surface and 1 is the bound.
    pub merged: StitchedMesh,
    /// Vertices that are the bound's.
    pub vertices: usize,
    /// Triangles that were removed because they lie outside the bound.
    pub carved: usize,
    /// Orientation of the patches.
    pub facing: Facing,
}

/// Stitches the bound to a merged surface where the surface has no patch.
///
/// σ of the bound is its own, or the length of its edges. It does not include how far the object may lie
/// inside the bound. Triangles outside a closed bound are removed. A closed bound is oriented outwards,
/// whatever its file states, and parts of patches that face against it are flipped.
pub(super) fn completed(merged: &StitchedMesh, bound: &MergePatch) -> Result<Completed> {
    let mut mesh = bound.mesh.clone();
    // Of an equilateral triangle with the mean area.
    let edge = (mesh.area() / mesh.triangles.len() as f64 * 4.0 / 3.0_f64.sqrt()).sqrt();
    // Only a closed bound has an inside, so only then is anything carved or oriented.
    let volume = mesh.signed_volume();
    if volume.is_some_and(|volume| volume < 0.0) {
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    let bound_search = MeshSearch::try_new(&mesh)?;
    let mut patches = merged.mesh.clone();
    // Orientation first: coverage compares normals.
    let facing = face_as(&mut patches, &bound_search);
    let limits = volume.is_some().then_some((&bound_search, edge));
    let (first, source, mut carved) = within(&patches, &merged.sigma, limits)?;
    let search = MeshSearch::try_new(&first.mesh)?;
    let normals = mesh.vertex_normals();
    let covered: Vec<bool> = (mesh.positions.par_iter().zip(&normals))
        .map(|(p, n)| {
            let foot = search.closest_compatible_within(*p, *n, MAX_ANGLE_RAD, MAX_GAP_EDGES * edge);
            // Beside a border, the foot is on the border itself. Only a narrow strip is removed there.
            foot.is_some_and(|foot| !foot.on_boundary || foot.distance <= BORDER_EDGES * edge)
        })
        .collect();
    mesh.triangles.retain(|t| t.iter().all(|v| !covered[*v as usize]));
    let sigma = match bound.sigma.is_empty() {
        // Without σ, the size of its cells is the best that is known of a hull.
        true => vec![edge; mesh.positions.len()],
        false => bound.sigma.clone(),
    };
    let rest = MergePatch::make_manifold(&mesh, &sigma)?.patch;
    let completed = if rest.mesh.triangles.is_empty() {
        let count = first.mesh.positions.len();
        StitchedMesh {
            kept: first.mesh.triangles.len(),
            source: (0..count as u32).map(|v| (0, v)).collect(),
            stitched: vec![false; count],
            holes_closed: 0,
            fragments: 0,
            turned: 0,
            valence: Vec::new(),
            mesh: first.mesh,
            sigma: first.sigma,
        }
    } else {
        let patches = [first, rest];
        let options = OverlapOptions { epsilon: Some(EPSILON * edge), theta_rad: None, believe_sigma: true };
        let overlap = Overlap::find(&patches, &options)?;
        let places = patches.each_ref().map(|patch| FusedVertices {
            positions: patch.mesh.positions.clone(),
            sigma: patch.sigma.clone(),
        });
        stitch_patches(&patches, &overlap, &places, &StitchOptions { notches: MAX_NOTCH_EDGES })?
    };
    // Stitching may have closed holes outside the bound, so the limits are applied again.
    let (last, kept_vertices, again) = within(&completed.mesh, &completed.sigma, limits)?;
    carved += again;
    let completed = StitchedMesh {
        source: (kept_vertices.iter().map(|v| completed.source[*v as usize]))
            .map(|(patch, v)| (patch, if patch == 0 { source[v as usize] } else { v }))
            .collect(),
        stitched: kept_vertices.iter().map(|v| completed.stitched[*v as usize]).collect(),
        kept: completed.kept.min(last.mesh.triangles.len()),
        mesh: last.mesh,
        sigma: last.sigma,
        ..completed
    };
    let vertices = completed.source.iter().filter(|(patch, _)| *patch == 1).count();
    Ok(Completed { merged: completed, vertices, carved, facing })
}

/// Findings about which way patches faced.
pub(super) fn facing_findings(facing: Facing, bound: &str) -> Vec<Finding> {
    let parts = |count: usize| match count {
        1 => "one part of the patches".to_owned(),
        count => format!("{count} parts of the patches"),
    };
    let mut findings = Vec::new();
    if facing.turned > 0 {
        findings.push(Finding::new(
            FindingCode::PatchReversed,
            format!("{} faced inwards according to {bound} and was reversed", parts(facing.turned)),
        ));
    }
    if facing.undetermined > 0 {
        let text = format!(
            "{bound} does not determine which way {} faces: the completion is correct only if it faces \
             outwards",
            parts(facing.undetermined)
        );
        findings.push(Finding::new(FindingCode::PatchFacingUnknown, text));
    }
    findings
}

/// Turns over the connected parts of a mesh whose normals are against those of the bound's nearest places.
fn face_as(mesh: &mut TriangleMesh, bound: &MeshSearch) -> Facing {
    let part = parts_of(mesh);
    let normals = mesh.vertex_normals();
    // A majority decision, so a sample is enough.
    let step = (mesh.positions.len() / ORIENTATION_SAMPLES).max(1);
    let cosines: Vec<f64> = (mesh.positions.par_iter().zip(&normals).enumerate())
        .map(|(v, (p, n))| match v % step {
            0 => bound.closest(*p).map_or(0.0, |foot| foot.normal.dot(*n)),
            _ => 0.0,
        })
        .collect();
    let mut sums: BTreeMap<u32, (f64, f64)> = BTreeMap::new();
    for t in &mesh.triangles {
        for v in t.map(|v| v as usize).into_iter().filter(|v| v % step == 0) {
            let (sum, count) = sums.entry(part[v]).or_default();
            *sum += cosines[v];
            *count += 1.0;
        }
    }
    let against = |t: &[u32; 3]| {
        (sums.get(&part[t[0] as usize])).is_some_and(|(sum, count)| *sum < -MIN_FACING_COSINE * count)
    };
    for t in &mut mesh.triangles {
        if against(t) {
            t.swap(1, 2);
        }
    }
    Facing {
        turned: sums.values().filter(|(sum, count)| *sum < -MIN_FACING_COSINE * count).count(),
        undetermined: sums.values().filter(|(sum, count)| sum.abs() <= MIN_FACING_COSINE * count).count(),
    }
}

/// For each vertex, the smallest vertex of its connected part.
fn parts_of(mesh: &TriangleMesh) -> Vec<u32> {
    let mut sets = DisjointSets::new(mesh.positions.len());
    for [a, b, c] in &mesh.triangles {
        sets.join(*a, *b);
        sets.join(*a, *c);
    }
    sets.into_roots()
}

/// Triangles inside the bound, the original numbers of their vertices, and the number of removed triangles.
fn within(
    mesh: &TriangleMesh,
    sigma: &[f64],
    bound: Option<(&MeshSearch, f64)>,
) -> Result<(MergePatch, Vec<u32>, usize)> {
    let stays = |t: usize| {
        let Some((search, edge)) = bound else { return true };
        let [a, b, c] = mesh.corners(t);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        // Corners alone would miss a large triangle that leaves the bound in its middle.
        let steps = ((longest / edge).ceil().max(1.0) as usize).min(MAX_STEPS);
        let mut places = (0..=steps).flat_map(|i| (0..=steps - i).map(move |j| [i, j, steps - i - j]));
        places.all(|weights| {
            let place = mesh.point_at(t, weights.map(|w| w as f64 / steps as f64));
            search.closest(place).is_none_or(|foot| foot.signed_distance <= MAX_OUTSIDE_EDGES * edge)
        })
    };
    let stay: Vec<bool> = (0..mesh.triangles.len()).into_par_iter().map(stays).collect();
    let triangles: Vec<[u32; 3]> =
        (mesh.triangles.iter().zip(&stay)).filter(|(_, stays)| **stays).map(|(t, _)| *t).collect();
    let carved = mesh.triangles.len() - triangles.len();
    if triangles.is_empty() {
        return Err(Error::undetermined(
            "expected patches inside the mesh that completes them, found all outside: check that both have \
             the same frame and unit",
        ));
    }
    let mesh = TriangleMesh { positions: mesh.positions.clone(), triangles };
    let tidied = MergePatch::make_manifold(&mesh, sigma)?;
    Ok((tidied.patch, tidied.vertices, carved))
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::DVec3;
    use planish_mesh::icosphere;

    /// Two patches of a ball leave its poles open. The bound is a little larger and oriented inwards; patches
    /// that face inwards are flipped.
    #[test]
    fn holes_are_closed_by_the_bound_and_patches_stay() {
        for inwards in [false, true] {
            let mut ball = icosphere(10.0, 4);
            // What reaches far out of the bound is carved away.
            let far = ball.positions.len() as u32;
            ball.positions.extend([[0.0, 40.0, 0.0], [1.0, 40.0, 0.0], [0.0, 40.0, 1.0]].map(DVec3::from));
            ball.triangles.retain(|t| t.iter().all(|v| ball.positions[*v as usize][2].abs() < 7.0));
            ball.triangles.push([far, far + 2, far + 1]);
            let turn = |mesh: &mut TriangleMesh| mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
            if inwards {
                turn(&mut ball);
            }
            let patch = MergePatch::make_manifold(&ball, &vec![0.02; ball.positions.len()]).unwrap().patch;
            let mut bound = icosphere(10.3, 4);
            turn(&mut bound);
            let count = patch.mesh.positions.len();
            let merged = StitchedMesh {
                source: vec![(0, 0); count],
                stitched: vec![false; count],
                kept: patch.mesh.triangles.len(),
                holes_closed: 0,
                fragments: 0,
                turned: 0,
                valence: Vec::new(),
                mesh: patch.mesh,
                sigma: patch.sigma,
            };
            let bound = MergePatch { mesh: bound, sigma: Vec::new() };
            let done = completed(&merged, &bound).unwrap();
            let check = done.merged.mesh.check();
            assert!(check.watertight && check.oriented && check.components == 1, "{check:?}");
            assert!(done.merged.mesh.signed_volume().unwrap() > 0.0);
            assert!(done.vertices > 100);
            for (p, (source, _)) in done.merged.mesh.positions.iter().zip(&done.merged.source) {
                let radius = if *source == 0 { 10.0 } else { 10.3 };
                assert!((p.length() - radius).abs() < 1e-9, "{p:?}");
            }
            let kept = done.merged.source.iter().filter(|(source, _)| *source == 0).count();
            assert_eq!((kept, done.carved), (count - 3, 1));
            // The ball, and the triangle far off.
            let turned = if inwards { 2 } else { 0 };
            assert_eq!(done.facing, Facing { turned, undetermined: 0 });
        }
    }

    /// A sheet on edge to the bound faces neither way.
    #[test]
    fn a_sheet_facing_neither_side_is_not_turned() {
        let mut upright = planish_mesh::grid_sheet(4.0, 4.0, 5, 5);
        upright.positions.iter_mut().for_each(|p| *p = DVec3::new(0.0, p[0], p[1]));
        let before = upright.clone();
        let search = MeshSearch::try_new(&icosphere(10.0, 3)).unwrap();
        assert_eq!(face_as(&mut upright, &search), Facing { turned: 0, undetermined: 1 });
        assert_eq!(upright, before);
    }
}
