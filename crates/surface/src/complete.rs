//! Completion of unobserved parts by inference from measured ones.
//!
//! Input: observations. Output: the same with inferred readings added, each with the variance of the
//! inference, and a report. Measurements take precedence: inferred readings are many times as uncertain, and
//! none is placed near a real one.
//!
//! | module | purpose |
//! |---|---|
//! | symmetry | copies of the readings by a rotation or a reflection |
//! | gap | report of a gap; `fit` finds the gaps of its surface |
//! | measured_region | where something was measured |
//!
//! # References
//! The paper on Kalman spline fusion, section 3.3 (propagation).

mod gap;
mod measured_region;
mod symmetry;

pub use gap::GapReport;
pub(crate) use measured_region::MeasuredRegion;
pub use symmetry::{SymmetryChoice, SymmetryCompletion, SymmetryReport, complete_by_symmetry};
