//! Implicit shells: any triangle mesh wrapped in a smooth field, deformed by a handful of control points, fitted and posed.
//!
//! Comes in: a mesh, control points, and points or silhouettes of a real thing. Goes out: the mesh, moved.
//! Source: S. Ilic, P. Fua, "From explicit to implicit surfaces for visualization, animation and modeling", 2003.
//!
//! Not guaranteed: that a deformed mesh does not cross itself.

mod delaunay;
mod natural_neighbour;

pub use delaunay::Delaunay;
pub use natural_neighbour::{NaturalNeighbours, Weight};
