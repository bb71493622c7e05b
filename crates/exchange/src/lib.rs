//! Every file format of Planish, in and out; the only crate that touches files.
//!
//! | module | format | |
//! |---|---|---|
//! | [`ply`] | PLY | scans and meshes in; scans, meshes and points out |
//! | [`obj`] | OBJ | points and meshes in; meshes out |
//! | [`stl`] | STL, binary and ASCII | points and meshes in; meshes out |
//! | [`glb`] | GLB, binary glTF 2.0 | points and meshes in; meshes out |
//! | [`off`] | OFF | points and meshes in; meshes out |
//! | [`mesh`] | whichever of these five | meshes in and out |
//! | [`textured`] | OBJ with MTL | meshes with texture coordinates and named parts, in and out |
//! | [`xyz`] | XYZ, TXT, ASC, CSV, PTS | points in |
//! | [`pcd`] | PCD, three encodings | organised and plain clouds in |
//! | [`las`] | LAS, LAZ | points and their classes in |
//! | [`e57`] | E57 | several scans with poses in |
//! | [`npy`] | NPY, NPZ | points and organised points in |
//! | [`depth`] | PNG, TIFF, NPY | depth images in, with the [`calibration`] of their camera |
//! | [`dxf`] | DXF, ASCII | curves of drawings in |
//! | [`picture`] | PNG, TIFF, JPEG, TGA, PGM, PPM | pictures in |
//! | [`raster`] | TIFF, NPY | numbers of every pixel out |
//! | [`views`] | `views.toml` | cameras with masks, contours and tracks in |
//! | [`poses`] | TOML | moves of controls and keyframes in |
//! | [`vrip`] | VRIP `.conf` | scans with poses in |
//! | [`job`] | `job.toml` | sensors and scans in |
//! | [`geotiff`] | GeoTIFF | heights and their σ out |
//! | [`contours`] | CSV, CARMEN logs in; DXF, SVG out | readings of contours, and drawings of them |
//! | [`step`] | STEP (ISO 10303-21) | boundary representations out |
//! | [`model`] | `.planish` (safetensors) | saved models, in and out |
//!
//! [`read_inputs`] takes a list of any of the files that hold scans; PLY, OBJ, STL, GLB, PCD, NPY and text
//! may be compressed by gzip. Everything is written by [`write_atomically`]: a whole file or none. Errors
//! name the file, where in it (line, byte, index), what was needed and what was found.

pub mod calibration;
pub mod contours;
pub mod depth;
pub mod dxf;
pub mod e57;
pub mod geotiff;
pub mod glb;
pub mod job;
pub mod las;
pub mod mesh;
pub mod model;
pub mod npy;
pub mod obj;
pub mod off;
pub mod pcd;
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
mod checksum;
mod foreign;
mod georeference;
mod mesh_data;
mod numbers;
mod output_set;
mod points;
mod scan_set;
mod scans;
mod source;
mod split_scans;

pub use atomic::{FolderInWork, Writer, check_writable, make_folder, paths_in, real_path, write_atomically};
pub use checksum::sha256_of;
pub use georeference::GeoReference;
pub use output_set::write_as_set;
pub use planish_core::Unit;
pub use scans::{InputFile, PosedScan, ScanSet, read_inputs};
pub use source::{extension, found_extension};
