//! Starting surfaces of any topology, over a mesh of quads.
//!
//! Input: oriented points. Output: a surface on the level set of their indicator, if they enclose a solid
//! with handles or several bodies.
//!
//! Not guaranteed: details smaller than a grid cell of the indicator. The surface is near the points, and
//! refinement follows them.

use super::enclosed::{EnclosedSolid, EnclosedTopology};
use crate::layout::Layout;
use planish_core::DVec3;
use planish_estimate::Result;
use planish_spline::{Hierarchy, Surface};
use std::sync::Arc;

/// Steps of the interpolation of vertices. Each leaves about half of the rest.
const INTERPOLATION_STEPS: usize = 20;

/// A surface around the solid that points with outward normals enclose; none if a ball has its topology.
///
/// # Errors
/// As for [`Layout::on_mesh`].
pub(super) fn surface_over_quads(
    points: &[DVec3],
    normals: &[DVec3],
    max_quads: usize,
) -> Result<Option<Surface>> {
    let solid = EnclosedSolid::new(points, normals);
    if solid.topology == EnclosedTopology::BALL {
        return Ok(None);
    }
    let layout = Layout::on_mesh(&solid.mesh()?, max_quads)?;
    interpolating(layout).map(Some)
}

/// The surface over a layout that passes through the positions of its vertices.
///
/// Richardson iteration `c ← c + x − S(ξ)`, as in [`planish_spline::fit_function`].
fn interpolating(layout: Layout) -> Result<Surface> {
    let space = Arc::new(Hierarchy::over(Arc::new(layout.domain))?);
    // The nodes of an unrefined hierarchy are the vertices of the domain.
    let mut surface = Surface::new(Arc::clone(&space), layout.positions.clone())?;
    for _ in 0..INTERPOLATION_STEPS {
        let moved = surface.vertices().iter().zip(space.node_anchors()).zip(&layout.positions);
        let vertices = moved.map(|((vertex, &[u, v]), wanted)| *vertex + *wanted - surface.point(u, v));
        surface = surface.with_vertices(vertices.collect())?;
    }
    Ok(surface)
}

#[cfg(test)]
mod tests;
