//! PLY, the polygon file format: scans and meshes in, scans, meshes and points out.
//!
//! Comes in: ASCII and both binary orders, any number types, lists, elements that nobody asked for, LF or
//! CRLF, comments. Goes out: a [`Scan`](planish_sense::Scan) or a [`PolygonMesh`]; written files are binary
//! little endian. Not guaranteed: `tristrips`, colours and other elements and properties are passed over.
//!
//! Files are streamed: beside the result, memory does not depend on the file's size, and no promised count
//! reserves more than the file can hold.
//!
//! # References
//! G. Turk, *The PLY Polygon File Format*, 1994.

mod body;
mod header;
mod read;
#[cfg(test)]
mod tests;
mod write;
mod write_scan;

pub use crate::mesh_data::{Column, MeshColumns, PolygonMesh};
pub(crate) use read::read_scan_and_unit;
pub use read::{PlyContents, read_contents, read_mesh, read_scan};
pub use write::{write_mesh, write_points};
pub use write_scan::write_scan;
