//! Triangle meshes: closest points, rays, sampling, checks and deviations.
//!
//! Comes in: a [`TriangleMesh`], plain positions and triangles in the model's unit, open or closed, manifold
//! or not. Goes out: distances and foot points ([`MeshSearch`]), points spread over the surface
//! ([`sample_points`]), what kind of mesh it is ([`MeshCheck`]), where it crosses itself ([`SelfCrossings`]),
//! whether a place is inside ([`WindingNumbers`]), surfaces of functions ([`isosurface()`]), the summary of a
//! comparison ([`DeviationStatistics`]), and what a camera sees of it ([`DepthBuffer`]).
//!
//! Not guaranteed: nothing here repairs a mesh. The sign of a distance is
//! right for a closed, consistently oriented mesh that does not cross itself; elsewhere it is the side of the
//! nearest piece of surface.
//!
//! ```
//! use planish_mesh::{MeshSearch, icosphere};
//!
//! # fn main() -> planish_estimate::Result<()> {
//! let ball = icosphere(10.0, 4);
//! assert!(ball.check().watertight);
//! let search = MeshSearch::try_new(&ball)?;
//! let foot = search.closest([0.0, 0.0, 12.0]).expect("the point is finite");
//! assert!((foot.signed_distance - 2.0).abs() < 0.05);
//! # Ok(())
//! # }
//! ```

mod bvh;
mod crossings;
mod curvature;
mod deviation;
mod edges;
mod facet_tree;
mod filling;
mod half_edges;
mod isosurface;
mod merge;
mod mesh;
mod neighbours;
mod packet;
mod primitives;
mod ray;
mod sampling;
mod search;
mod sets;
mod subdivision;
mod triangle;
mod visibility;
mod winding;

pub use crossings::SelfCrossings;
pub use curvature::{VertexCurvature, vertex_curvature};
pub use deviation::{DeviationStatistics, quantile_of_sorted};
pub use facet_tree::{FacetTree, NearFacet};
pub use filling::{Filled, fill_holes};
pub use isosurface::isosurface;
pub use merge::{
    CommonRegion, Fused, NoiseLikeness, Overlap, OverlapFoot, OverlapOptions, Patch, PatchOverlap, Tidied,
    ZipOptions, Zipped, fused, noise_likeness, searches_of, taper, zipped,
};
pub use mesh::{BoundingBox, Distortion, MeshCheck, TriangleMesh};
pub use neighbours::Neighbours;
pub use primitives::{cylinder, grid_sheet, icosphere, parallelepiped};
pub use ray::RayHit;
pub use sampling::{SurfacePoint, SurfaceSampler, sample_points};
pub use search::{ClosestPoint, MeshSearch};
pub use sets::DisjointSets;
pub use triangle::{Feature, triangle_shape};
pub use visibility::{DepthBuffer, Projected, Seen};
pub use winding::WindingNumbers;
