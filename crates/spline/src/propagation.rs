//! What a surface must be where nobody measured it, if it is symmetric or made of simple shapes: the
//! estimators.
//!
//! | module | what |
//! |---|---|
//! | facets | a cloud as a few hundred independent pieces, each a quadric with its covariance |
//! | maps | reflections and rotations, with their derivatives |
//! | pairs | pieces that a symmetry lays on one another |
//! | starts | where the search for a symmetry starts |
//! | primitive | planes, spheres and cylinders, and which of them a patch is |
//! | symmetry | the axis or plane that makes the pieces agree, and whether they do |
//!
//! Comes in: points with normals. Goes out: a symmetry with its covariance, and how well the cloud obeys it.

mod facets;
mod maps;
mod pairs;
mod primitive;
mod starts;
mod symmetry;

pub use facets::{Facet, Facets};
pub use maps::Symmetry;
pub use primitive::{Classification, FittedPrimitive, Prediction, Primitive, classify};
pub use symmetry::{FittedSymmetry, SymmetryKind, fit_symmetry, propose_symmetry};
