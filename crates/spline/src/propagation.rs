//! Estimators for completing unobserved parts of a surface: symmetries and simple shapes.
//!
//! | module | content |
//! |---|---|
//! | facets | a cloud as a few hundred independent facets, each a quadric with its covariance |
//! | maps | reflections and rotations, with their derivatives |
//! | pairs | facets that a symmetry maps onto each other |
//! | starts | initial values of a symmetry |
//! | primitive | planes, spheres and cylinders, and the classification of a patch |
//! | symmetry | estimate and test of an axis or plane of symmetry |
//!
//! Input: points with normals. Output: a symmetry with its covariance, and a test of whether the cloud
//! supports it.

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
