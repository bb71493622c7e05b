//! From noisy measurements to 3D models that state how well they are known.
//!
//! The jobs of Planish as functions. `planish-cli` parses a command line, calls them and prints.

pub mod animation;
pub mod brep;
pub mod compare;
pub mod contour;
pub mod dem;
mod domain;
pub mod fit;
pub mod fit_files;
pub mod graphs;
pub mod info;
pub mod merge;
pub mod mesh_output;
pub mod model;
pub mod next;
pub mod occluding;
pub mod output;
mod point_sigmas;
pub mod progress;
pub mod propagate;
pub mod report;
pub mod saved;
pub mod sense;
pub mod shell;
pub mod simulate;
pub mod solid;
pub mod stream;
#[cfg(test)]
mod test_support;
pub mod view;

pub use planish_estimate::{Error, ErrorKind, Result};
pub use planish_exchange::Unit;
/// Settings of the sensors' front ends.
pub use planish_sense::{StereoOptions, StereoPoints, stripes::GridOptions};
pub use planish_spline::{Shape, SymmetryKind};
