//! Estimation for Planish: every measurement is an equation, and information adds.
//!
//! This crate knows no geometry. Models plug in through the measurement equation `g(z − v, x) = 0`.

pub mod error;
pub mod sparse;
pub mod vector3;

mod belief;
mod consistency;
mod equation;
mod kalman;
mod least_squares;
mod reml;
mod robust;
mod variance_components;

pub use belief::*;
pub use consistency::*;
pub use equation::*;
pub use error::{Error, ErrorKind, Result};
pub use kalman::*;
pub use least_squares::*;
pub use reml::*;
pub use robust::*;
pub use variance_components::*;
