//! B-spline surfaces for Planish: bases, truncated hierarchies, differential geometry, foot points, energies.
//!
//! The data flow is: a [`Hierarchy`] says which functions live where; a [`Surface`] adds control vertices;
//! foot points tie measured points to parameters; energies and observations become sparse information for
//! `planish-estimate`.

mod base;
mod basis;
mod cell_information;
mod directed_moments;
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
mod refinement;
mod surface;
mod system;
mod tangent_rows;
mod tessellation;

pub use base::{BaseShape, choose_base_shape, fit_function, principal_axes, symmetric_eigen};
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
    InnovationSum, PATCH_CELLS, PATCH_VERTICES, Patch, PatchBelief, PatchFilter, PatchFilterOptions,
    PatchFilterState, PatchState, PatchUpdate, SmoothnessPrior, StateLayout, Subdivision,
    SubdivisionCriteria, SubdivisionReason, SurfaceReading, VertexSharing, curvature_variation,
    parameter_plane, patch_hierarchy,
};
pub use planish_estimate::{Error, Result};
pub use propagation::{
    Classification, Facet, Facets, FittedPrimitive, FittedSymmetry, Prediction, Primitive, Symmetry,
    SymmetryKind, classify, fit_symmetry, propose_symmetry,
};
pub use refinement::{detail_covariance, energy_projection, refine_covariance, two_scale_matrix};
pub use surface::{Jet, Surface, ThirdDerivatives, leaf_weights};
pub use system::SurfaceSystem;
pub use tangent_rows::{TangentRows, curvature_tensor};
pub use tessellation::{Tessellation, TessellationOptions, least_triangles, tessellate};
