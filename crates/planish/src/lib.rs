//! From noisy measurements to 3D models that state how well they are known.
//!
//! The jobs of Planish as functions. `planish-cli` parses a command line, calls them and prints.

pub mod animation;
pub mod compare;
pub mod contour;
pub mod fit_files;
pub mod graphs;
pub mod info;
mod job;
pub mod merge;
pub mod next;
pub mod occluding;
pub mod output;
pub mod report;
pub mod sense;
pub mod shell;
pub mod simulate;
pub mod solid;
pub mod view;

pub use job::Job;
pub use planish_core::progress;
pub use planish_core::{Error, ErrorKind, Result};
pub use planish_exchange::Unit;
/// Settings of the sensors' front ends.
pub use planish_sense::{StereoOptions, StereoPoints, stripes::GridOptions};
pub use planish_spline::{Shape, SymmetryKind};
pub use planish_surface::{complete, export, fit, model, saved, stream};
