//! The patch filter: a quadtree of small patches, each with its own dense covariance, fed one reading at a
//! time.
//!
//! Comes in: an initial surface, a smoothness prior, readings at known parameters in any order, whenever they
//! come. Goes out: a surface and its σ at any time. Memory is that of the patches, whatever the number of
//! readings; a reading costs the same in the first minute and after years.
//!
//! | module | what |
//! |---|---|
//! | quadtree | leaf patches of 4 × 4 cells and 7 × 7 vertices, and what neighbours share |
//! | belief | mean and covariance of one patch, scalar updates |
//! | reading | positions, normals, curvatures as scalar equations |
//! | observe | one reading taken in, or set aside |
//! | prior | the smoothness prior, the same that the global filter has |
//! | reconcile | neighbours made to agree, with nothing counted twice |
//! | criterion | when a patch is divided |
//! | filter | the filter that is made of these |
//!
//! With one patch it is the global filter in covariance form. With more, a reading updates its own patch at
//! once and the others at the next [`PatchFilter::reconcile`]; on a strip of patches that again is the global
//! answer, and in a grid close to it.
//!
//! Not guaranteed: optimality in a grid of patches. What reaches a patch by several ways is taken in by one
//! of them.
//!
//! # References
//! Wang, Wang, *On 3D model construction by fusing heterogeneous sensor data*, CVGIP: Image Understanding
//! 1994, sections 3.1 and 3.2.

mod belief;
mod criterion;
mod filter;
mod observe;
mod prior;
mod quadtree;
mod reading;
mod reconcile;
mod state;

pub use belief::PatchBelief;
pub use criterion::{InnovationSum, SubdivisionCriteria, SubdivisionReason, curvature_variation};
pub use filter::{PatchFilter, PatchFilterOptions, PatchUpdate, StateLayout, Subdivision};
pub use prior::{SmoothnessPrior, parameter_plane};
pub use quadtree::{PATCH_CELLS, PATCH_VERTICES, Patch, VertexSharing, patch_hierarchy};
pub use reading::SurfaceReading;
pub use state::{PatchFilterState, PatchState};

#[cfg(test)]
mod tests;
