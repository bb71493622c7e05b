//! What nobody measured, concluded from what was: the paper's propagation.
//!
//! Comes in: observations. Goes out: the same with readings added that were concluded from them, each with
//! the variance of its conclusion, and a report that says what was found. Wherever something was measured,
//! that overrules: concluded readings are many times as uncertain, and none is put beside a real one.
//!
//! | module | what |
//! |---|---|
//! | symmetry | copies of the readings by a rotation or a reflection |
//! | gap | what surrounds a gap; `fit` finds the gaps of its surface |
//!
//! # References
//! The paper on Kalman spline fusion, section 3.3.

mod gap;
mod measured_region;
mod symmetry;

pub use gap::GapReport;
pub(crate) use measured_region::MeasuredRegion;
pub use symmetry::{SymmetryChoice, SymmetryCompletion, SymmetryReport, complete_by_symmetry};
