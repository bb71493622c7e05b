//! Reads and writes every file format of Planish. Other crates do not open files of measurements or results.
//!
//! # Tour
//!
//! [`read_inputs`] reads any combination of scans, depth images and lists of scans into one [`ScanSet`]:
//! scans with their poses, sensors and units, ready for a fit. [`mesh`] reads and writes triangle meshes in
//! any format; the extension of the file selects it. Modules named after a format offer the same with its
//! details.
//!
//! ```
//! use planish_exchange::mesh::{MeshColumns, read_mesh, write_mesh};
//! use planish_exchange::{Unit, read_inputs};
//! # let folder = tempfile::tempdir()?;
//! // Measurements with a σ each.
//! let scan = folder.path().join("probe.csv");
//! std::fs::write(&scan, "x,y,z,sigma\n0,0,0,0.05\n1,0,0,0.05\n0,1,0,0.05\n")?;
//! let set = read_inputs(&[&scan], Some(Unit::Millimetre))?;
//! let points = &set.scans[0].scan.points;
//!
//! // A mesh; `.ply` keeps every bit and further columns, `.stl` only positions.
//! let part = folder.path().join("part.ply");
//! let unit = Some(Unit::Millimetre);
//! write_mesh(&part, &MeshColumns { points, triangles: &[[0, 1, 2]], unit, ..MeshColumns::default() })?;
//! assert_eq!(read_mesh(&part)?.unit, unit);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Errors state what was expected, what was found, and where: file, and line, byte or index.
//!
//! ```
//! # let folder = tempfile::tempdir()?;
//! let path = folder.path().join("cup.xyz");
//! std::fs::write(&path, "1 2 3\n4 5\n")?;
//! let error = planish_exchange::xyz::read_points(&path).unwrap_err();
//! assert!(error.to_string().ends_with("cup.xyz: line 2: expected 3 numbers, found 2"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Formats
//!
//! | module | format | reads | writes |
//! |---|---|---|---|
//! | [`ply`] | PLY | scans, meshes | scans, meshes, points |
//! | [`obj`] | OBJ | points, meshes | meshes |
//! | [`stl`] | STL, binary and ASCII | points, meshes | meshes |
//! | [`glb`] | GLB (binary glTF 2.0) | points, meshes | meshes, animations, poses |
//! | [`off`] | OFF | points, meshes | meshes |
//! | [`mesh`] | any of these five, STEP | meshes | meshes |
//! | [`textured`] | OBJ with MTL, GLB | meshes with texture and parts | OBJ with MTL |
//! | [`xyz`] | XYZ, TXT, ASC, CSV, PTS | points | |
//! | [`pcd`] | PCD, three encodings | organised and plain clouds | |
//! | [`las`] | LAS, LAZ | points with classes | |
//! | [`e57`] | E57 | scans with poses | |
//! | [`npy`] | NPY, NPZ | points, organised points | |
//! | [`depth`] | PNG, TIFF, NPY | depth images, with the [`calibration`] of their camera | |
//! | [`dxf`], [`svg`], [`pdf`] | DXF (ASCII), SVG, PDF | curves of drawings | |
//! | [`read_drawing`] | the same, and pictures (PNG, JPEG, TIFF) | curves of drawings | |
//! | [`picture`] | PNG, TIFF, JPEG, TGA, PGM, PPM | pictures | PNG |
//! | [`glyphs`] | pictures | texts, arrowheads and dimensions of drawings | |
//! | [`raster`] | TIFF, NPY | | values per pixel |
//! | [`views`] | `views.toml` | cameras with masks, contours and tracks | |
//! | [`landmarks`] | CSV | measured positions of places of a mesh | |
//! | [`poses`] | TOML | displacements of controls, keyframes | |
//! | [`vrip`] | VRIP `.conf` | lists of scans with poses | |
//! | [`job`] | `job.toml` | sensors and scans | |
//! | [`geotiff`] | GeoTIFF | | heights with their σ |
//! | [`contours`] | CSV, CARMEN logs, JSON, DXF, SVG | readings of contours, contours | drawings |
//! | [`step`] | STEP (ISO 10303-21) | faces, as triangles | boundary representations |
//! | [`model`] | `.planish` (safetensors) | saved models | saved models |
//!
//! PLY, OBJ, STL, OFF, GLB, PCD, NPY, STEP, DXF and text may be compressed by gzip.
//!
//! # Guarantees
//!
//! - An output file appears complete or not at all ([`write_atomically`]).
//! - The same input gives the same bytes.
//! - Time and memory are proportional to the size of a file, whatever its header declares (decision 0041).
//!   Readers take memory from a [`Budget`](planish_core::Budget) before they keep it (decision 0089).

pub mod calibration;
pub mod contours;
pub mod depth;
pub mod dxf;
pub mod e57;
pub mod geotiff;
pub mod glb;
pub mod glyphs;
pub mod job;
pub mod landmarks;
pub mod las;
pub mod mesh;
pub mod model;
pub mod npy;
pub mod obj;
pub mod off;
pub mod pcd;
pub mod pdf;
pub mod picture;
pub mod ply;
pub mod poses;
pub mod raster;
pub mod step;
pub mod stl;
pub mod svg;
pub mod textured;
pub mod views;
pub mod vrip;
pub mod xyz;

mod affine;
mod appearance;
mod atomic;
mod bezier;
#[cfg(test)]
mod budget_tests;
mod checksum;
mod columns;
mod dash_pattern;
mod dimension_text;
mod drawings;
mod file_kind;
mod foreign;
mod georeference;
mod mesh_data;
mod numbers;
mod output_set;
mod points;
mod polygon;
mod scan_set;
mod scans;
mod source;
mod split_scans;
mod strokes;
mod trace;

pub use atomic::{PendingFolder, Writer, check_writable, make_folder, paths_in, real_path, write_atomically};
pub use checksum::sha256_of;
pub use drawings::read_drawing;
pub use file_kind::FileKind;
pub use georeference::GeoReference;
pub use output_set::{recover_outputs_in_folder_of, write_as_set};
pub use planish_core::Unit;
pub use scans::{InputFile, PosedScan, ScanSet, read_inputs};
pub use source::{describe_extension, extension};
