//! From noisy measurements to 3D models that state how well they are known.
//!
//! The jobs of Planish as functions. `planish-cli` parses a command line, calls them and prints.

pub mod brep;
pub mod fit;
pub mod model;
pub mod progress;
pub mod simulate;
