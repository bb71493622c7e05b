//! Geometric relations between the parts of a drawing: proposed, imposed and diagnosed.
//!
//! In: a [`ParametricDrawing`] (points, bars, circles, arcs), whose parameters may be an estimate with a
//! covariance, and [`Constraint`]s. Out: relations that agree with the estimate, and the estimate with them
//! imposed and a smaller covariance ([`constrain`]); dimensions on a grid, if the statistics allow it
//! ([`snap`]); the remaining degrees of freedom, redundant and conflicting constraints ([`diagnose`]). Not
//! guaranteed: that an accepted relation was intended; the expected number of accidents is reported. Nothing
//! here depends on the origin of a drawing.
//!
//! ```text
//! ParametricDrawing + covariance ─► candidates ─► constrain (χ², Holm) ─► Constrained ─► snap ─► Constrained
//! ParametricDrawing + constraints ─► diagnose: freedoms, redundant, conflicting ─► graph::ViewGraphs
//! ```
//!
//! # Examples
//! Relations of an estimated outline, its sizes on a grid of half a millimetre, its remaining degrees of
//! freedom, and its graphs:
//! ```
//! use nalgebra::DMatrix;
//! use planish_contour::constraint::{
//!     ConstrainOptions, Dimension, ParametricDrawing, constrain, diagnose, snap,
//! }; use planish_contour::graph::ViewGraphs;
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
//! assert_eq!((left.freedoms, left.rigid_motions), (2, 2)); // it may be translated, but not rotated
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
