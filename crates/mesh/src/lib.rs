//! Triangle meshes: closest points, rays, sampling, checks, merging and hole filling.
//!
//! A [`TriangleMesh`] holds positions in the unit of the model and triangles of vertex indices. It may be
//! open or closed, manifold or not.
//!
//! | Task | Entry point |
//! |---|---|
//! | Distances and closest points | [`MeshSearch`], [`FacetTree`] |
//! | First hit of a ray | [`MeshSearch::first_hit`] |
//! | Topology: open, closed, manifold, genus | [`TriangleMesh::check`] |
//! | Self-intersections | [`SelfCrossings`] |
//! | Inside or outside | [`WindingNumbers`] |
//! | Random points on the surface | [`sample_points`] |
//! | Curvature | [`vertex_curvature`] |
//! | Comparison of two surfaces | [`DeviationStatistics`] |
//! | Zero surface of a function | [`isosurface()`], with sharp features [`dual_contour()`] |
//! | Merging of overlapping patches | [`Overlap`], [`fuse_patches`], [`stitch_patches`] |
//! | Hole filling | [`fill_holes`] |
//! | Visibility in an image | [`DepthBuffer`] |
//!
//! Not guaranteed: the sign of a distance is correct for a closed, consistently oriented mesh that does not
//! intersect itself. For other meshes, it is the side of the nearest triangle.
//!
//! # Examples
//! The signed distance of a point from a ball:
//! ```
//! use planish_core::DVec3;
//! use planish_mesh::{MeshSearch, icosphere};
//!
//! # fn main() -> planish_estimate::Result<()> {
//! let ball = icosphere(10.0, 4);
//! assert!(ball.check().watertight);
//! let search = MeshSearch::try_new(&ball)?;
//! let foot = search.closest(12.0 * DVec3::Z).expect("the point is finite");
//! assert!((foot.signed_distance - 2.0).abs() < 0.05);
//! # Ok(())
//! # }
//! ```
//!
//! A check that reports why a mesh has no volume:
//! ```
//! let sheet = planish_mesh::grid_sheet(2.0, 3.0, 4, 4);
//! let check = sheet.check();
//! assert!(!check.watertight && check.boundary_loops == 1);
//! assert_eq!(sheet.signed_volume(), None);
//! ```

mod bvh;
mod copies;
mod crossings;
mod curvature;
mod deviation;
mod dual_contour;
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
mod subdivision;
mod surface_cells;
mod triangle;
mod visibility;
mod winding;

pub use copies::distinct_triangles;
pub use crossings::SelfCrossings;
pub use curvature::{VertexCurvature, vertex_curvature};
pub use deviation::{DeviationStatistics, quantile_of_sorted};
pub use dual_contour::{DistanceField, dual_contour};
pub use facet_tree::{FacetTree, NearFacet};
pub use filling::{Filled, HoleLimit, fill_holes};
pub use isosurface::isosurface;
pub use merge::{
    CommonRegion, FusedVertices, ManifoldPatch, MergePatch, NoiseCorrelation, Overlap, OverlapFoot,
    OverlapOptions, PatchOverlap, SigmaCheck, SigmaVerdict, StitchOptions, StitchedMesh, fuse_patches,
    noise_correlation, searches_of, stitch_patches, taper,
};
pub use mesh::{Distortion, MeshCheck, TriangleMesh};
pub use neighbours::Neighbours;
// Re-exported because functions of this crate take and return them.
pub use planish_core::{BoundingBox, DisjointSets};
pub use primitives::{cylinder, grid_sheet, icosphere, parallelepiped};
pub use ray::RayHit;
pub use sampling::{SurfacePoint, SurfaceSampler, sample_points};
pub use search::{ClosestPoint, MeshSearch};
pub use triangle::{Feature, triangle_shape};
pub use visibility::{DepthBuffer, DepthVisibility, Projected};
pub use winding::WindingNumbers;
