//! `planish shell`: any mesh, wrapped in an implicit shell and moved by a few controls.

pub mod fit;
mod looks;
pub mod pose;
pub mod surface;
pub mod texture;
