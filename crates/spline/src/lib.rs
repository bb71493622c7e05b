//! B-spline surfaces for Planish: bases, truncated hierarchies, differential geometry, foot points and
//! energies.
//!
//! A [`Hierarchy`] defines the basis functions and a [`Surface`] adds control vertices. Foot points assign
//! parameters to measured points. Energies and observations become sparse information, which
//! `planish-estimate` solves.
//!
//! # Example
//! Fit noise-free heights of a paraboloid with a weak smoothness prior, and evaluate the surface:
//! ```
//! use planish_core::DVec3;
//! use planish_spline::{Hierarchy, Shape, Surface, SurfaceSystem, leaf_weights};
//! use std::sync::Arc;
//!
//! let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [4, 4])?);
//! let flat = space.node_anchors().iter().map(|a| DVec3::new(a[0], a[1], 0.0)).collect();
//! let plane = Surface::new(space.clone(), flat)?;
//!
//! let system = SurfaceSystem::new(&space)?;
//! let mut information = system.accumulate(|leaf, cell| {
//!     for (s, t) in [(0.2, 0.2), (0.2, 0.8), (0.8, 0.2), (0.8, 0.8)] {
//!         let [u, v] = space.parameters(leaf, [s, t]);
//!         let point = DVec3::new(u, v, 0.1 * (u * u + v * v));
//!         cell.add_vector(&leaf_weights(s, t), point, &[1e6, 0.0, 0.0, 1e6, 0.0, 1e6]);
//!     }
//!     true
//! })?;
//! information.add_scaled(&system.thin_plate(&plane)?.expanded(3)?, 1e-3)?;
//!
//! let factor = system.factorize(&information)?;
//! let mut solution = information.vector().to_vec();
//! factor.solve_in_place(&mut solution)?;
//! let surface = system.surface(&solution)?;
//! assert!((surface.point(1.3, 2.1)[2] - 0.61).abs() < 1e-6);
//! // Curvature of z = 0.1 (u² + v²) at its vertex is 0.2 in every direction.
//! let curvature = surface.curvature(0.0, 0.0).expect("a regular point");
//! assert!((curvature.mean() - 0.2).abs() < 1e-4);
//! # Ok::<(), planish_spline::Error>(())
//! ```

mod base;
mod base_fit;
mod basis;
mod cell_information;
mod directed_moments;
mod directions;
mod energy;
mod field;
mod foot;
mod geometry;
mod height_field;
mod hierarchy;
mod isometry;
mod moments;
mod patch_filter;
mod propagation;
mod quad_domain;
mod refinement;
mod shape_choice;
mod surface;
mod system;
mod tangent_rows;
mod tessellation;

pub use base::{BaseShape, fit_function};
pub use base_fit::{fit_base_shape, scatter_about, shape_parameters};
pub use basis::{End, MAX_DEGREE, UniformBasis, cubic, cubic_bezier, cubic_half};
pub use cell_information::{CellCovariance, CellInformation, scalar_element, variance_along};
pub use directed_moments::{DirectedMoments, DirectedSums};
pub use energy::{LeafEnergy, QuadraturePoint, quadrature};
pub use field::FieldPoints;
pub use foot::{FootPoint, FootPointSearch, ProjectionOptions};
pub use geometry::Curvature;
pub use height_field::{Height, HeightField, HeightReading};
pub use hierarchy::{Cell, Hierarchy, MAX_LEVEL, Shape, quarter, quarter3};
pub use isometry::{Metric, MetricChange};
pub use moments::{AffineMap, CellMoments, PositionReading, PositionSums};
pub use patch_filter::{
    FilterPatch, InnovationSum, PATCH_CELLS, PATCH_VERTICES, PatchBelief, PatchFilter, PatchFilterOptions,
    PatchFilterState, PatchState, PatchUpdate, SmoothnessPrior, StateLayout, Subdivision,
    SubdivisionCriteria, SubdivisionReason, SurfaceReading, VertexSharing, curvature_variation,
    parameter_plane, patch_hierarchy,
};
pub use planish_estimate::{Error, Result};
pub use propagation::{
    Classification, Facet, Facets, FittedPrimitive, FittedSymmetry, Prediction, Primitive, Symmetry,
    SymmetryKind, classify, fit_symmetry, propose_symmetry,
};
#[doc(hidden)]
pub use quad_domain::test_meshes;
pub use quad_domain::{ConcaveFan, Division, QuadDomain};
pub use refinement::{detail_covariance, energy_projection, refine_covariance, two_scale_matrix};
pub use shape_choice::{choose_base_shape, principal_axes};
pub use surface::{Jet, Surface, ThirdDerivatives, leaf_weights};
pub use system::SurfaceSystem;
pub use tangent_rows::{TangentRows, curvature_tensor};
pub use tessellation::{Tessellation, TessellationOptions, min_triangles, tessellate, tessellate_parts};
