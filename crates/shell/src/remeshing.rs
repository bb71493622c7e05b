//! Remeshes a closed mesh: grows it where the object is not covered yet, and cuts it where no object can be.
//!
//! In: a closed mesh that may intersect itself, the domain, and the region that the mesh covers. Out: a
//! closed manifold mesh of uniform facets.
//!
//! The new surface is the zero level of `max(−b, min(h, max(h − g, c)))`. Here `h` is the signed distance
//! from the mesh, negative where the winding number exceeds ½; `b` is the depth in the domain; `c` is the
//! depth in the covered region; and `g` is the distance of growth. Parts of winding number zero are dropped,
//! intersecting sheets are joined, and the domain may cut the mesh apart, so the topology may change.
//!
//! Not guaranteed: parts thinner than a cell are lost, and sharp edges are cut by chords.

use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{MeshSearch, TriangleMesh, WindingNumbers, isosurface};
use rayon::prelude::*;

/// A region of space with a signed depth.
pub trait Region: Sync {
    /// Depth of a point inside the region, in the unit of the mesh; negative outside.
    fn depth(&self, at: DVec3) -> f64;

    /// True if the depth may be zero within `reach` of a point. It may return true too often, but never false
    /// wrongly.
    fn may_contain_boundary(&self, at: DVec3, reach: f64) -> bool;
}

/// Options of [`remesh`].
#[derive(Clone, Copy)]
pub struct RemeshOptions<'a> {
    /// Region that contains the object.
    pub domain: &'a dyn Region,
    /// Region that the mesh covers already, and the distance by which it may grow outside of that region.
    pub flow: Option<(&'a dyn Region, f64)>,
    /// Side of a cell of the isosurface grid.
    pub cell: f64,
    /// Minimum volume of a connected part, as a share of the largest one; smaller fragments of a cut are
    /// dropped.
    pub min_part_volume_ratio: f64,
    /// Number of smoothing passes.
    pub smoothing_passes: usize,
}

/// Factors of one smoothing pass: a step towards the mean of the neighbours, then one back. Long waves keep
/// their size (G. Taubin, *A signal processing approach to fair surface design*, SIGGRAPH 1995; guarded by
/// the test `smoothing_does_not_shrink`).
const SHRINKING_STEP: f64 = 0.5;
const INFLATING_STEP: f64 = -0.53;

/// Remeshes a closed mesh, which may intersect itself, into a closed manifold mesh.
///
/// Cost: as [`isosurface`], with a closest point and a winding number for each cell corner near the surface.
///
/// # Errors
/// `Undetermined` for a mesh with open edges, or if nothing is left; as [`isosurface`].
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_mesh::icosphere;
/// use planish_shell::{Region, RemeshOptions, remesh};
/// struct HalfSpace;
/// impl Region for HalfSpace {
///     fn depth(&self, at: DVec3) -> f64 {
///         0.5 - at[2]
///     }
///     fn may_contain_boundary(&self, at: DVec3, reach: f64) -> bool {
///         self.depth(at).abs() <= reach
///     }
/// }
/// let options = RemeshOptions {
///     domain: &HalfSpace,
///     flow: None,
///     cell: 0.2,
///     min_part_volume_ratio: 0.01,
///     smoothing_passes: 0,
/// };
/// let cut = remesh(&icosphere(1.0, 3), &options)?;
/// assert!(cut.check().watertight && cut.positions.iter().all(|p| p[2] < 0.51));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn remesh(mesh: &TriangleMesh, options: &RemeshOptions<'_>) -> Result<TriangleMesh> {
    let RemeshOptions { domain, flow, cell, min_part_volume_ratio, smoothing_passes } = *options;
    let open = mesh.welded().check().boundary_edges;
    if open > 0 {
        return Err(Error::undetermined(format!(
            "expected a closed mesh, found {open} boundary edges: close it before remeshing"
        )));
    }
    let (search, winding) = (MeshSearch::try_new(mesh)?, WindingNumbers::new(mesh));
    let height = |at| {
        // Distance and sign come from different sources: the sign of the nearest facet would be wrong inside
        // of self-intersections.
        let far = search.closest(at).map_or(f64::INFINITY, |foot| foot.distance);
        if winding.at(at) > 0.5 { -far } else { far }
    };
    let value = |at: DVec3| {
        let height = height(at);
        let wanted = match flow {
            Some((covered, farthest)) => height.min(covered.depth(at).max(height - farthest)),
            None => height,
        };
        wanted.max(-domain.depth(at))
    };
    let may_pass = |at: DVec3, reach: f64| {
        let (height, ends) = (height(at), domain.may_contain_boundary(at, reach));
        // The ball is completely outside of the domain.
        if !ends && domain.depth(at) < 0.0 {
            return false;
        }
        match flow {
            _ if height.abs() <= reach => true,
            _ if height < 0.0 => ends,
            None => false,
            Some((_, farthest)) if height - farthest > reach => false,
            Some((covered, farthest)) => {
                ends || (height - farthest).abs() <= reach || covered.may_contain_boundary(at, reach)
            }
        }
    };
    let around = 2.0 * cell + flow.map_or(0.0, |(_, farthest)| farthest);
    let bounds =
        mesh.surface_bounds().ok_or_else(|| Error::input("expected a mesh with vertices, found none"))?;
    let around = bounds.grown(around);
    let made = isosurface(&around, cell, value, may_pass)?;
    let mut kept = large_parts(&made, min_part_volume_ratio);
    if kept.triangles.is_empty() {
        return Err(Error::undetermined(
            "expected a part of the mesh inside the domain, found none: it is elsewhere, or the cells are \
             larger than this part",
        ));
    }
    let neighbours = vertex_neighbours(&kept);
    for _ in 0..smoothing_passes {
        // Steps towards the mean alone would shrink the mesh.
        for share in [SHRINKING_STEP, INFLATING_STEP] {
            kept.positions = towards_neighbours(&kept.positions, &neighbours, share);
        }
    }
    Ok(kept)
}

/// Smooths values at the vertices of a closed, oriented mesh: in each step a vertex takes the mean of itself
/// and its neighbours.
///
/// # Examples
/// ```
/// use planish_mesh::icosphere;
/// use planish_shell::smooth_vertex_values;
/// let ball = icosphere(1.0, 1);
/// let values = smooth_vertex_values(&ball, &vec![2.0; ball.positions.len()], 3);
/// assert!(values.iter().all(|v| (v - 2.0).abs() < 1e-12));
/// ```
#[must_use]
pub fn smooth_vertex_values(mesh: &TriangleMesh, values: &[f64], steps: usize) -> Vec<f64> {
    let neighbours = vertex_neighbours(mesh);
    let mut means = values.to_vec();
    for _ in 0..steps {
        means = (means.par_iter().zip(&neighbours))
            .map(|(own, near)| {
                (own + near.iter().map(|v| means[*v as usize]).sum::<f64>()) / (1 + near.len()) as f64
            })
            .collect();
    }
    means
}

/// The vertices that share an edge with each.
fn vertex_neighbours(mesh: &TriangleMesh) -> Vec<Vec<u32>> {
    let mut found = vec![Vec::new(); mesh.positions.len()];
    for t in &mesh.triangles {
        // Closed and oriented: each edge is once in either direction.
        for k in 0..3 {
            found[t[k] as usize].push(t[(k + 1) % 3]);
        }
    }
    found
}

/// Moves every vertex by a share of the way towards the mean of its neighbours.
fn towards_neighbours(positions: &[DVec3], neighbours: &[Vec<u32>], share: f64) -> Vec<DVec3> {
    (positions.par_iter().zip(neighbours))
        .map(|(p, near)| {
            // From the old positions, so that the result depends neither on order nor on threads.
            let each = share / near.len().max(1) as f64;
            (near.iter()).fold(*p, |sum, v| sum + each * (positions[*v as usize] - *p))
        })
        .collect()
}

/// The connected parts of a closed mesh whose volume is at least a share of the largest one's. Unused
/// vertices are removed.
#[must_use]
pub fn large_parts(mesh: &TriangleMesh, min_ratio: f64) -> TriangleMesh {
    // Intersecting constraint surfaces cut off small fragments.
    let part_of = mesh.parts();
    let count = part_of.iter().map(|part| *part as usize + 1).max().unwrap_or(0);
    let mut volumes = vec![0.0; count];
    for (t, part) in part_of.iter().enumerate() {
        let [a, b, c] = mesh.corners(t);
        volumes[*part as usize] += a.dot(b.cross(c)) / 6.0;
    }
    let largest = volumes.iter().copied().fold(0.0, f64::max);
    let mut new_of = vec![u32::MAX; mesh.positions.len()];
    let mut kept = TriangleMesh::default();
    for (triangle, part) in mesh.triangles.iter().zip(part_of) {
        // A negative volume is a cavity, which stays filled.
        if volumes[part as usize] <= 0.0 || volumes[part as usize] < min_ratio * largest {
            continue;
        }
        kept.triangles.push(triangle.map(|v| {
            let new = &mut new_of[v as usize];
            if *new == u32::MAX {
                *new = kept.positions.len() as u32;
                kept.positions.push(mesh.positions[v as usize]);
            }
            *new
        }));
    }
    kept
}

#[cfg(test)]
mod tests;
