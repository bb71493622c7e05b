//! What holds between the parts of a drawing: found, imposed, counted.
//!
//! Comes in: a [`ParametricDrawing`] (points, bars, circles, arcs), whose parameters may be an estimate with a
//! covariance, and [`Constraint`]s. Goes out: relations that the estimate does not contradict
//! ([`constrain`]), the estimate with them imposed and its smaller covariance, dimensions on a grid where the
//! statistics allow ([`snap`]), and how many freedoms are left, which constraints are redundant and which
//! contradict each other ([`diagnose`]). Not guaranteed: that a relation which the errors hide is no
//! accident; its odds are reported. Nothing here knows where a drawing came from.
//!
//! ```text
//! ParametricDrawing + covariance ─► candidates ─► constrain (χ², Holm) ─► Constrained ─► snap ─► Constrained
//! ParametricDrawing + constraints ─► diagnose: freedoms, redundant, conflicting ─► graph::ViewGraphs
//! ```
//!
//! # Examples
//! An estimated outline, its relations, its sizes on half millimetres, what is left free, and its graphs:
//! ```
//! use nalgebra::DMatrix;
//! use planish_contour::constraint::{ConstrainOptions, Dimension, ParametricDrawing, constrain, diagnose, snap};
//! use planish_contour::graph::ViewGraphs;
//!
//! let outline = ParametricDrawing::polygon(&[[0.01, 0.0], [40.02, 0.03], [39.98, 29.97], [0.0, 30.01]])?;
//! let covariance = DMatrix::identity(8, 8) * 0.0009;
//! let found = constrain(&outline, &covariance, &ConstrainOptions::default())?;
//! let (found, sizes) = snap(&found, 0.5, &Dimension::all(&outline))?;
//! for proposal in found.accepted() {
//!     println!("{} (p = {:.2})", proposal.text, proposal.p_value);
//! }
//! for size in &sizes {
//!     println!("{}: {:.3} ± {:.3}, {:?}", size.text, size.value, size.sigma, size.outcome);
//! }
//! let left = diagnose(&found.drawing, &found.constraints)?;
//! assert_eq!((left.freedoms, left.rigid_motions), (2, 2)); // it may lie anywhere, but not turned
//! let dot = ViewGraphs::new(&found.drawing, &found.constraints).to_dot();
//! assert!(dot.starts_with("graph full {"));
//! # Ok::<(), planish_estimate::Error>(())
//! ```
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, *Reconstruction of 3D models from measurements obtained by a
//! moving sensor*, section 3; Langbein, Marshall and Martin 2004, *Choosing consistent constraints for
//! beautification of reverse engineered geometric models*.

mod candidates;
mod conflicts;
mod decomposition;
mod diagnose;
mod drawing;
mod draws;
mod equations;
mod evidence;
mod impose;
mod incidence;
mod minimal;
mod naming;
mod parse;
mod place;
mod propose;
mod rank;
mod relation;
mod scheme;
mod snap;
mod solve;

pub use candidates::{Candidate, candidates};
pub use decomposition::{Decomposition, EquationBlock};
pub use diagnose::{Dependence, Diagnosis, diagnose, implications, witness};
pub use drawing::{ArcId, BarId, CircleId, Offset, ParametricDrawing, PointId};
pub use equations::{ConstraintEquations, Equation};
pub use impose::{Imposed, chi_square_tail, impose};
pub use incidence::{Entry, Incidence};
pub use minimal::{deletion_filter, quick_xplain};
pub use place::Place;
pub use propose::{
    ConstrainOptions, Constrained, DEFAULT_LEVEL, Proposal, ProposalOutcome, constrain, constrain_among,
};
pub use relation::{Axis, Constraint};
pub use scheme::{Dimensioned, dimension_scheme, sigma};
pub use snap::{Dimension, Snap, SnapOutcome, snap};
pub use solve::{ConstraintSolution, solve};

#[cfg(test)]
mod tests;
