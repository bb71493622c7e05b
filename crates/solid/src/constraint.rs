//! What holds between the parts of a drawing: found, imposed, counted.
//!
//! Comes in: a [`Drawing`] (points, bars, circles, arcs), whose parameters may be an estimate with a covariance, and [`Constraint`]s.
//! Goes out: relations that the estimate does not contradict ([`constrain`]), the estimate with them imposed and its smaller
//! covariance, dimensions on a grid where the statistics allow ([`snap`]), and how many freedoms are left, which constraints are
//! redundant and which contradict each other ([`diagnose`]). Not guaranteed: that a relation which the errors hide is no
//! accident; its odds are reported. Nothing here knows where a drawing came from.
//!
//! ```text
//! Drawing + covariance ─► candidates ─► constrain (χ², Holm) ─► Constrained ─► snap ─► Constrained
//! Drawing + constraints ─► diagnose: freedoms, redundant, conflicting ─► graph::ViewGraphs
//! ```
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, *Reconstruction of 3D models from measurements obtained by a moving sensor*, section 3;
//! Langbein, Marshall and Martin 2004, *Choosing consistent constraints for beautification of reverse engineered geometric models*.

mod candidates;
mod diagnose;
mod drawing;
mod draws;
mod equations;
mod evidence;
mod impose;
mod minimal;
mod propose;
mod rank;
mod relation;
mod snap;
mod solve;

pub use candidates::{Candidate, candidates};
pub use diagnose::{Dependence, Diagnosis, diagnose, witness};
pub use drawing::{ArcId, BarId, CircleId, Drawing, PointId};
pub use equations::{ConstraintEquations, Equation};
pub use impose::{Imposed, impose};
pub use minimal::{deletion_filter, quick_xplain};
pub use propose::{ConstrainOptions, Constrained, Outcome, Proposal, constrain};
pub use relation::{Axis, Constraint};
pub use snap::{Dimension, Snap, SnapOutcome, snap};
pub use solve::{Solution, solve};

#[cfg(test)]
mod tests;
