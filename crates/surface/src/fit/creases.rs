//! Sharp edges of a closed surface, from oriented readings.
//!
//! Input: the level-set mesh of the readings, which is rounded at edges, and positions, normals and σ of a
//! sample of the readings. Output: a mesh of the same topology on which sharp edges are chains of edges.
//!
//! | module | purpose |
//! |---|---|
//! | patch | quadratic patches, and where they meet |
//! | sides | a patch of one side around each reading |
//! | crossings | edges of the mesh between two sides, and the points of creases on them |
//! | sharpened | a mesh whose edges run along creases |
//! | gaps | paths that close gaps |
//! | chains | short creases and corners |
//!
//! Edges of less than 18°, and round ones with a radius above about two spacings, are no creases.
//!
//! With normals that are estimated from neighbours, creases are found less completely, and lie within a few
//! tenths of a spacing of the edges instead of about σ.
//!
//! Not guaranteed: edges of walls thinner than about three spacings, and edges closer than that to others. A
//! crease may end early where its angle fades.
//!
//! # References
//! Öztireli, Guennebaud, Gross, *Feature preserving point set surfaces based on non-linear kernel
//! regression*, Eurographics 2009; Kobbelt, Botsch, Schwanecke, Seidel, *Feature sensitive surface
//! extraction from volume data*, SIGGRAPH 2001.

mod chains;
mod crossings;
mod gaps;
mod patch;
mod sharpened;
mod sides;
#[cfg(test)]
mod tests;

use crate::layout::{CreasedMesh, without_short_edges};
use crossings::{crossings, sides_of_vertices};
use patch::Patch;
use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::{MeshCheck, TriangleMesh};
use sharpened::SharpMesh;
use sides::Cloud;

/// Edges of the mesh on which creases are found, at least, in spacings. Longer ones miss thin parts; shorter
/// ones take longer, and several cross a crease between two readings.
const SHORTEST_EDGE: f64 = 0.6;
/// Edges of the mesh, at least, in σ.
const MIN_EDGE_SIGMAS: f64 = 4.0;
/// Radius of the spheres around corners that are close to each other, in spacings.
const CLUSTER_RADIUS: f64 = 2.5;
/// Rounds in which a mesh is made round where edges are left out.
const ROUNDS_OFF: usize = 6;
/// Faces turned over, at most, as a share of the edges on creases. Estimated normals, which are wrong beside
/// edges, turn some over; layouts pass over single ones.
const MAX_TURNED_OVER: f64 = 0.1;

/// A part of space.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sphere {
    pub center: DVec3,
    pub radius: f64,
}

/// A mesh on which the sharp edges of its surface are chains of edges.
pub(super) struct SharpEdges {
    pub mesh: CreasedMesh,
    /// Spacing of the readings that show them.
    spacing: f64,
    /// Corners that noise put close to each other, or that are.
    clusters: Vec<DVec3>,
}

impl SharpEdges {
    fn none(mesh: TriangleMesh) -> Self {
        Self { mesh: CreasedMesh::smooth(mesh), spacing: 0.0, clusters: Vec::new() }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.mesh.creases.is_empty()
    }

    /// Length of all of them.
    pub(super) fn length(&self) -> f64 {
        let at = |v: u32| self.mesh.mesh.positions[v as usize];
        self.mesh.creases.iter().map(|&[a, b]| at(a).distance(at(b))).sum()
    }

    /// Spheres around corners that are close to each other, from the readings or by noise.
    pub(super) fn clusters(&self) -> Vec<Sphere> {
        let radius = CLUSTER_RADIUS * self.spacing;
        self.clusters.iter().map(|&center| Sphere { center, radius }).collect()
    }

    /// The same without the parts in some spheres, and without what is short then. The mesh is round there.
    pub(super) fn without(&self, spheres: &[Sphere]) -> Self {
        let at = |v: u32| self.mesh.mesh.positions[v as usize];
        let is_kept = |edge: &&[u32; 2]| {
            let middle = 0.5 * (at(edge[0]) + at(edge[1]));
            spheres.iter().all(|sphere| middle.distance(sphere.center) > sphere.radius)
        };
        let creases = self.mesh.creases.iter().filter(is_kept).copied().collect();
        let mesh = CreasedMesh { mesh: self.mesh.mesh.clone(), creases, corners: Vec::new() };
        let (mut made, _) = chains::tidy(mesh, self.spacing);
        let mut is_moved: Vec<bool> = (made.mesh.positions.iter())
            .map(|p| spheres.iter().any(|sphere| p.distance(sphere.center) < sphere.radius))
            .collect();
        made.creases.iter().flatten().for_each(|&v| is_moved[v as usize] = false);
        round_off(&mut made.mesh, &is_moved);
        Self { mesh: made, spacing: self.spacing, clusters: Vec::new() }
    }
}

/// Moves vertices to the mean of their neighbours, for a few rounds.
fn round_off(mesh: &mut TriangleMesh, is_moved: &[bool]) {
    let mut sums = vec![(DVec3::ZERO, 0.0); mesh.positions.len()];
    for _ in 0..ROUNDS_OFF {
        sums.fill((DVec3::ZERO, 0.0));
        for &[a, b, c] in &mesh.triangles {
            for (v, w) in [(a, b), (b, c), (c, a)] {
                let own = &mut sums[v as usize];
                *own = (own.0 + mesh.positions[w as usize], own.1 + 1.0);
            }
        }
        for (p, ((sum, count), _)) in
            mesh.positions.iter_mut().zip(sums.iter().zip(is_moved)).filter(|(_, (_, moved))| **moved)
        {
            *p = *sum / *count;
        }
    }
}

/// A mesh on which the sharp edges that readings show are chains of edges. The given mesh if there are none.
///
/// Processor time for 20,000 readings: 0.3 s for a smooth surface, 2 to 3 s with sharp edges or fine details.
///
/// # Errors
/// `Undetermined` if the points cannot be searched.
pub(super) fn with_creases(
    mesh: TriangleMesh,
    points: &[DVec3],
    normals: &[DVec3],
    sigma: f64,
) -> Result<SharpEdges> {
    let smooth = |mesh| Ok(SharpEdges::none(mesh));
    let mut cloud = Cloud::new(points, normals, sigma)?;
    let Some(sides) = cloud.sides() else { return smooth(mesh) };
    // Noise would turn shorter edges of a crease around.
    let unit = cloud.spacing.max(MIN_EDGE_SIGMAS / SHORTEST_EDGE * cloud.scales.height);
    let coarse = without_short_edges(&mesh, SHORTEST_EDGE * unit)?;
    let own = sides_of_vertices(&cloud, &sides, &coarse);
    let found = crossings(&cloud, &sides, &coarse, &own);
    if found.is_empty() {
        return smooth(mesh);
    }
    let patches = sides.iter().map(|side| side.map_or_else(Patch::default, |side| side.patch)).collect();
    let mut sharp = SharpMesh::new(&coarse, &own, patches, &found, unit);
    sharp.improve();
    let turned_over = sharp.turned_over();
    let (made, clusters) = chains::tidy(sharp.into_mesh()?, cloud.spacing);
    let is_sound = has_topology_of(&made.mesh.check(), &mesh.check())
        && turned_over as f64 <= MAX_TURNED_OVER * made.creases.len() as f64;
    if made.creases.is_empty() || !is_sound {
        return smooth(mesh);
    }
    let clusters = clusters.iter().map(|&v| made.mesh.positions[v as usize]).collect();
    Ok(SharpEdges { mesh: made, spacing: cloud.spacing, clusters })
}

/// True if the surface is not smooth near readings: it may have sharp edges.
///
/// # Errors
/// As for [`with_creases`].
pub(super) fn may_have_creases(points: &[DVec3], normals: &[DVec3], sigma: f64) -> Result<bool> {
    Ok(Cloud::new(points, normals, sigma)?.sides().is_some())
}

/// True for closed manifolds of the same components and handles.
fn has_topology_of(made: &MeshCheck, given: &MeshCheck) -> bool {
    made.watertight
        && made.manifold
        && made.oriented
        && made.components == given.components
        && made.euler_characteristic == given.euler_characteristic
}
