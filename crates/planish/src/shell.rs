//! `planish shell`: any mesh, wrapped in an implicit shell and moved by a few controls.

mod appearance;
pub mod fit;
pub mod pose;
pub mod surface;
pub mod texture;
