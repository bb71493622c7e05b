//! Exports of a model: meshes with σ, rasters of heights, exact surfaces for CAD.

mod brep;
mod height_raster;
mod mesh;
mod trimming;

pub use brep::{BrepOptions, brep_from_surface};
pub use height_raster::*;
pub use mesh::*;
pub use trimming::{Closing, brep_from_model};
