//! PLY, the polygon file format: scans and meshes in, scans, meshes and points out.
//!
//! **Input.** ASCII, binary little endian or binary big endian, with any number types, lists, unknown
//! elements, comments, and lines that end in LF or CRLF.
//!
//! **Output.** A [`Scan`](planish_sense::Scan) or a [`PolygonMesh`]. Written files are binary little endian
//! and keep every bit of a number.
//!
//! **Limits.** `tristrips`, colours and other elements and properties are ignored.
//!
//! Files are streamed: apart from the result, memory does not depend on the size of the file, and a declared
//! count never reserves more than the file can hold.
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
#[cfg(test)]
pub(crate) use read::{mesh_from, scan_from};
pub use write::{write_mesh, write_points};
pub use write_scan::write_scan;
