//! The patch filter: a quadtree of small patches with dense covariances, updated by one reading at a time.
//!
//! Input: an initial surface, a smoothness prior, and readings at known parameters in any order. Output: a
//! surface and its σ at any time. Memory and the cost of a reading do not depend on the number of readings.
//!
//! | module | content |
//! |---|---|
//! | quadtree | leaf patches of 4 × 4 cells and 7 × 7 vertices, and the vertices that neighbours share |
//! | belief | mean and covariance of one patch, scalar updates |
//! | reading | positions, normals, curvatures as scalar equations |
//! | observe | update with one reading, or its rejection |
//! | prior | the smoothness prior, the same as in the global filter |
//! | reconcile | exchange of information between neighbours, without counting it twice |
//! | criterion | criteria for subdivision |
//! | evaluate | surface, σ and curvatures |
//! | state | state as plain data, for saving and resuming |
//! | filter | the filter built from these modules |
//!
//! A single patch is the global filter in covariance form. With several patches, a reading updates its own
//! patch at once and the others at the next [`PatchFilter::reconcile`]. On a strip of patches the result
//! equals that of the global filter; in a grid it is close.
//!
//! Not guaranteed: optimality in a grid of patches. Information that could reach a patch on several paths
//! uses only one.
//!
//! # References
//! Wang, Wang, *On 3D model construction by fusing heterogeneous sensor data*, CVGIP: Image Understanding
//! 1994, sections 3.1 and 3.2.

mod belief;
mod criterion;
mod evaluate;
mod filter;
mod observe;
mod options;
mod prior;
mod quadtree;
mod reading;
mod reconcile;
mod state;

pub use belief::PatchBelief;
pub use criterion::{InnovationSum, SubdivisionCriteria, SubdivisionReason, curvature_variation};
pub use filter::{PatchFilter, PatchUpdate, Subdivision};
pub use options::{PatchFilterOptions, StateLayout};
pub use prior::{SmoothnessPrior, parameter_plane};
pub use quadtree::{FilterPatch, PATCH_CELLS, PATCH_VERTICES, VertexSharing, patch_hierarchy};
pub use reading::SurfaceReading;
pub use state::{PatchFilterState, PatchState};

#[cfg(test)]
mod tests;
