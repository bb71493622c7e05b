//! The table of what is fed with damaged files: one line a reader.
//!
//! Comes in: a damaged file. Goes out: whether the reader took it or refused it; what is written of it must
//! read as the same again. A new reader: a line of [`TARGETS`], a function in [`crate::valid`], and the words
//! of its header.

use crate::valid;
use planish::info::info;
use planish::saved::{load_with_provenance, save};
use planish_estimate::Result;
use planish_exchange::calibration::{
    read_grid_calibration, read_lights, read_stereo_calibration, read_view_sensor,
};
use planish_exchange::contours::{
    CarmenOptions, SigmaDefaults, read_contour_json, read_contour_readings, read_ray_readings,
};
use planish_exchange::dxf::read_dxf;
use planish_exchange::mesh::{Column, MeshColumns, PolygonMesh, read_mesh, write_mesh};
use planish_exchange::picture::read_picture;
use planish_exchange::ply::{read_contents, read_scan, write_scan};
use planish_exchange::poses::read_poses;
use planish_exchange::step::read_step;
use planish_exchange::svg::read_svg;
use planish_exchange::textured::{read_materials, read_textured};
use planish_exchange::views::read_views;
use planish_exchange::{extension, read_inputs};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::path::Path;

/// A reader and what it is fed with.
pub struct Target {
    /// What it is called on the command line and in the log.
    pub name: &'static str,
    /// Name of the file that it reads: the extension decides.
    pub file: &'static str,
    /// Valid files.
    pub valid: fn() -> Result<Vec<Vec<u8>>>,
    /// Words of the format.
    pub words: &'static [&'static str],
    /// What is done to damaged bytes, so that the damage gets past lengths and checksums.
    pub mend: fn(&mut Vec<u8>, &mut ChaCha8Rng),
    /// Reads the file; writes what it read, and reads that, where the format is also written.
    pub read: fn(&Path) -> Result<()>,
}

/// Every reader.
#[rustfmt::skip]
pub const TARGETS: &[Target] = &[
    Target { name: "ply-scan", file: "a.ply",     valid: valid::ply_scans,  words: PLY,  mend: as_it_is,   read: scan_and_back },
    Target { name: "ply-mesh", file: "a.ply",     valid: valid::ply_meshes, words: PLY,  mend: as_it_is,   read: mesh_and_back },
    Target { name: "xyz",      file: "a.xyz",     valid: valid::texts,      words: TEXT, mend: as_it_is,   read: scans },
    Target { name: "csv",      file: "a.csv",     valid: valid::texts,      words: TEXT, mend: as_it_is,   read: scans },
    Target { name: "pts",      file: "a.pts",     valid: valid::texts,      words: TEXT, mend: as_it_is,   read: scans },
    Target { name: "pcd",      file: "a.pcd",     valid: valid::pcds,       words: PCD,  mend: as_it_is,   read: scans },
    Target { name: "las",      file: "a.las",     valid: valid::las,        words: &[],  mend: as_it_is,   read: scans },
    Target { name: "laz",      file: "a.laz",     valid: valid::laz,        words: &[],  mend: as_it_is,   read: scans },
    Target { name: "gzip",     file: "a.ply.gz",  valid: valid::ply_scans,  words: PLY,  mend: gzip,       read: scans },
    Target { name: "conf",     file: "a.conf",    valid: valid::lists,      words: LIST, mend: as_it_is,   read: scans },
    Target { name: "job",      file: "a.toml",    valid: valid::jobs,       words: JOB,  mend: as_it_is,   read: scans },
    Target { name: "obj",      file: "a.obj",     valid: valid::objs,       words: OBJ,  mend: as_it_is,   read: mesh_and_back },
    Target { name: "obj-looks", file: "a.obj",    valid: valid::objs,       words: OBJ,  mend: as_it_is,   read: textured },
    Target { name: "mtl",      file: "a.mtl",     valid: valid::mtls,       words: MTL,  mend: as_it_is,   read: materials },
    Target { name: "off",      file: "a.off",     valid: valid::offs,       words: OFF,  mend: as_it_is,   read: mesh_and_back },
    Target { name: "stl",      file: "a.stl",     valid: valid::stls,       words: STL,  mend: count_of_stl, read: mesh_and_back },
    Target { name: "step",     file: "a.step",    valid: valid::steps,      words: STEP, mend: as_it_is,   read: step },
    Target { name: "glb-looks", file: "a.glb",    valid: valid::posed,      words: GLB,  mend: lengths_of_glb, read: textured },
    Target { name: "glb",      file: "a.glb",     valid: valid::glbs,       words: GLB,  mend: lengths_of_glb, read: mesh_and_back },
    Target { name: "npy",      file: "a.npy",     valid: valid::npys,       words: NPY,  mend: as_it_is,   read: scans },
    Target { name: "npz",      file: "a.npz",     valid: valid::npys,       words: NPY,  mend: npz,        read: scans },
    Target { name: "e57",      file: "a.e57",     valid: valid::e57s,       words: XML,  mend: sums_of_e57, read: scans },
    Target { name: "png",      file: "a.png",     valid: valid::pngs,       words: &[],  mend: sums_of_png, read: scans },
    Target { name: "tiff",     file: "a.tif",     valid: valid::tiffs,      words: &[],  mend: as_it_is,   read: scans },
    Target { name: "camera",   file: "a.toml",    valid: valid::cameras,    words: CAMERA, mend: as_it_is, read: image_beside },
    Target { name: "picture",  file: "p.png",     valid: valid::pngs,       words: &[],  mend: sums_of_png, read: picture },
    Target { name: "jpeg",     file: "p.jpg",     valid: valid::jpegs,      words: &[],  mend: as_it_is,   read: picture },
    Target { name: "tga",      file: "p.tga",     valid: valid::tgas,       words: &[],  mend: as_it_is,   read: picture },
    Target { name: "pgm",      file: "p.pgm",     valid: valid::pgms,       words: PGM,  mend: as_it_is,   read: picture },
    Target { name: "stereo",   file: "s.toml",    valid: valid::stereos,    words: CAMERA, mend: as_it_is, read: stereo_calibration },
    Target { name: "view",     file: "v.toml",    valid: valid::views,      words: CAMERA, mend: as_it_is, read: view_sensor },
    Target { name: "views",    file: "v.toml",    valid: valid::mask_views, words: VIEWS, mend: as_it_is,  read: mask_views },
    Target { name: "poses",    file: "p.toml",    valid: valid::poses,      words: POSES, mend: as_it_is,  read: shell_poses },
    Target { name: "grid",     file: "g.toml",    valid: valid::grids,      words: GRID, mend: as_it_is, read: grid_calibration },
    Target { name: "lights",   file: "l.toml",    valid: valid::lights,     words: LIGHTS, mend: as_it_is, read: lights },
    Target { name: "dxf",      file: "a.dxf",     valid: valid::dxfs,       words: DXF,  mend: as_it_is,   read: dxf },
    Target { name: "svg",      file: "a.svg",     valid: valid::svgs,       words: SVG,  mend: as_it_is,   read: svg },
    Target { name: "readings", file: "a.csv",     valid: valid::readings,   words: READINGS, mend: as_it_is, read: readings },
    Target { name: "carmen",   file: "a.log",     valid: valid::carmen_logs, words: READINGS, mend: as_it_is, read: readings },
    Target { name: "rays",     file: "a.csv",     valid: valid::rays,       words: READINGS, mend: as_it_is, read: rays },
    Target { name: "contour",  file: "a.json",    valid: valid::contours,   words: CONTOUR, mend: as_it_is, read: contour },
    Target { name: "planish",  file: "a.planish", valid: valid::models,     words: JSON, mend: safetensors, read: model_and_back },
];

const PLY: &[&str] = &[
    "ply",
    "format",
    "ascii",
    "binary_little_endian",
    "binary_big_endian",
    "1.0",
    "element",
    "vertex",
    "face",
    "range_grid",
    "property",
    "list",
    "uchar",
    "int",
    "uint",
    "short",
    "float",
    "double",
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "sigma",
    "sigma_n_deg",
    "cxx",
    "cxy",
    "cxz",
    "cyy",
    "cyz",
    "czz",
    "k1",
    "k2",
    "d1x",
    "d1y",
    "d1z",
    "sigma_k",
    "vertex_indices",
    "vertex_index",
    "comment",
    "unit",
    "mm",
    "obj_info",
    "num_cols",
    "num_rows",
    "end_header\n",
    "\n",
    "\r\n",
];
const TEXT: &[&str] = &[
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "sigma",
    "sigma_n_deg",
    "cxx",
    "cxy",
    "cxz",
    "cyy",
    "cyz",
    "czz",
    "#",
    "//",
    ",",
    ";",
    "\t",
    "\"",
    "\u{feff}",
    "\r\n",
    "1.#QNAN",
    "-nan(ind)",
    "é",
    "\0",
];
const PCD: &[&str] = &[
    "VERSION",
    "FIELDS",
    "COLUMNS",
    "SIZE",
    "TYPE",
    "COUNT",
    "WIDTH",
    "HEIGHT",
    "VIEWPOINT",
    "POINTS",
    "DATA",
    "ascii",
    "binary",
    "binary_compressed",
    "x",
    "y",
    "z",
    "normal_x",
    "nx",
    "sigma",
    "F",
    "U",
    "I",
    "1",
    "2",
    "4",
    "8",
    "_",
    "\n",
];
const LIST: &[&str] =
    &["bmesh", "camera", "#", "good.xyz", "a.conf", "a scan.xyz", "..", "/", "/dev/zero", "\r\n", "\0"];
const JOB: &[&str] = &[
    "unit",
    "\"mm\"",
    "[[scan]]",
    "[sensor.a]",
    "kind",
    "\"range\"",
    "\"touch\"",
    "\"normal\"",
    "sigma",
    "sigma_along",
    "sigma_across",
    "sensor",
    "file",
    "\"good.xyz\"",
    "\"a.toml\"",
    "pose",
    "translation",
    "quaternion_xyzw",
    "viewpoint",
    "direction",
    "[[[[[[[[[[[[[[[[",
    "{",
    "}",
    "=",
    "'''",
    "\"\"\"",
    "1979-05-27",
    "\\u0000",
    "\n",
];
const JSON: &[&str] = &[
    "\"dtype\"",
    "\"shape\"",
    "\"data_offsets\"",
    "\"F64\"",
    "\"U32\"",
    "\"U8\"",
    "\"BF16\"",
    "null",
    "true",
    "[]",
    "{}",
    "[[[[[[[[",
    "sheet",
    "tube",
    "ball",
    "torus",
    "__metadata__",
    "knots_u",
    "cells",
    "1e999",
    "\\\"",
    "schema",
];

const OBJ: &[&str] = &[
    "v", "vn", "vt", "f", "l", "p", "o", "g", "s", "usemtl", "#", "unit", "mm", "/", "//", "-1", "\\\n", "\n",
];
const OFF: &[&str] = &["OFF", "COFF", "4OFF", "BINARY", "#", "3", "4", "0", "-1", "1e400", "\n"];
const MTL: &[&str] = &["newmtl", "map_Kd", "Kd", "-s", "#", "a.png", " ", "\n"];
const STL: &[&str] = &[
    "solid", "facet", "normal", "outer", "loop", "vertex", "endloop", "endfacet", "endsolid", "unit=mm", "\n",
];
const GLB: &[&str] = &[
    "\"asset\"",
    "\"meshes\"",
    "\"primitives\"",
    "\"attributes\"",
    "\"POSITION\"",
    "\"NORMAL\"",
    "\"indices\"",
    "\"mode\"",
    "\"accessors\"",
    "\"bufferViews\"",
    "\"byteStride\"",
    "\"byteOffset\"",
    "\"byteLength\"",
    "\"componentType\"",
    "5126",
    "5125",
    "5123",
    "\"count\"",
    "\"nodes\"",
    "\"children\"",
    "\"matrix\"",
    "\"translation\"",
    "\"scenes\"",
    "\"sparse\"",
    "null",
    "[]",
    "{}",
    "[[[[[[[[",
    "1e999",
];
const NPY: &[&str] = &[
    "descr",
    "fortran_order",
    "shape",
    "True",
    "False",
    "'<f8'",
    "'>f4'",
    "'|u1'",
    "'<i8'",
    "(",
    ")",
    ",",
    "{",
    "}",
    "L",
    "()",
];
const XML: &[&str] = &[
    "<",
    ">",
    "/>",
    "</",
    "type=\"Float\"",
    "type=\"Integer\"",
    "type=\"ScaledInteger\"",
    "minimum=",
    "maximum=",
    "scale=",
    "precision=\"single\"",
    "fileOffset=",
    "recordCount=",
    "cartesianX",
    "sphericalRange",
    "rowIndex",
    "cartesianInvalidState",
    "<![CDATA[",
    "]]>",
    "&amp;",
    "&#0;",
];
const CAMERA: &[&str] =
    &["unit", "\"m\"", "fx", "fy", "cx", "cy", "scale", "sigma_a", "sigma_b", "=", "[a]", "\n"];

const VIEWS: &[&str] = &[
    "unit", "[[view]]", "K", "R", "t", "P", "name", "mask", "contours", "held_out", "true", "sigma_px",
    "tracks", "=", "[", "]", "\n",
];

const POSES: &[&str] = &[
    "controls",
    "blend",
    "[[rigid]]",
    "part",
    "motion",
    "\"held\"",
    "[[pose]]",
    "name",
    "move",
    "near",
    "within",
    "by",
    "control",
    "[[keyframe]]",
    "seconds",
    "weights",
    "=",
    "[",
    "]",
    "{",
    "}",
    "\n",
];

const PGM: &[&str] = &["P2", "P3", "P5", "P6", "255", "65535", "#", "\n", " ", "4294967296"];
const GRID: &[&str] = &[
    "unit",
    "sigma_px",
    "[camera]",
    "[projector]",
    "[stripes]",
    "K",
    "R",
    "t",
    "directions_deg",
    "spacing",
    "origin",
    "range",
    "[",
    "]",
    "=",
    "1e308",
    "nan",
    "2147483647",
    "-1024",
];
const LIGHTS: &[&str] = &[
    "unit",
    "frame",
    "\"viewer\"",
    "\"camera\"",
    "lights",
    "[ball]",
    "images",
    "mask",
    "pixel_size",
    "sigma_brightness",
    "sigma_light_deg",
    "[",
    "]",
    "1e308",
    "nan",
    "=",
];

const STEP: &[&str] = &[
    "ISO-10303-21;",
    "DATA;",
    "ENDSEC;",
    "END-ISO-10303-21;",
    "#1",
    "#12",
    "#30",
    "=",
    "(",
    ")",
    ",",
    ";",
    "'",
    "$",
    "*",
    ".T.",
    ".F.",
    "/*",
    "*/",
    "0.",
    "1.E300",
    "-1.E-300",
    "999999999",
    "LINE",
    "CIRCLE",
    "PLANE",
    "CYLINDRICAL_SURFACE",
    "CONICAL_SURFACE",
    "SPHERICAL_SURFACE",
    "TOROIDAL_SURFACE",
    "OFFSET_SURFACE",
    "SURFACE_OF_REVOLUTION",
    "SURFACE_OF_LINEAR_EXTRUSION",
    "VERTEX_LOOP",
    "ORIENTED_FACE",
    "MAPPED_ITEM",
    "SHAPE_REPRESENTATION",
    "SHAPE_REPRESENTATION_RELATIONSHIP",
];
const DXF: &[&str] = &[
    "SECTION",
    "ENDSEC",
    "HEADER",
    "TABLES",
    "BLOCKS",
    "ENTITIES",
    "EOF",
    "LAYER",
    "BLOCK",
    "ENDBLK",
    "INSERT",
    "LINE",
    "ARC",
    "CIRCLE",
    "ELLIPSE",
    "LWPOLYLINE",
    "POLYLINE",
    "VERTEX",
    "SEQEND",
    "SPLINE",
    "DIMENSION",
    "TEXT",
    "HATCH",
    "HIDDEN",
    "CENTER",
    "BYLAYER",
    "BYBLOCK",
    "part",
    "$INSUNITS",
    "\n0\n",
    "\n2\n",
    "\n8\n",
    "\n10\n",
    "\n20\n",
    "\n40\n",
    "\n41\n",
    "\n42\n",
    "\n50\n",
    "\n70\n",
    "\n71\n",
    "\n230\n",
    "1e308",
    "nan",
    "\\A1;",
    "%%c",
    "<>",
    "\r\n",
];
const SVG: &[&str] = &[
    "<svg>",
    "</svg>",
    "<g>",
    "</g>",
    "<path d='",
    "'/>",
    "<line ",
    "<rect ",
    "<circle ",
    "<style>",
    "<!DOCTYPE svg [",
    "<!ENTITY a '",
    "&a;",
    "]>",
    "transform='",
    "matrix(",
    "rotate(",
    "scale(",
    "skewX(90)",
    ")",
    "viewBox='",
    "width='",
    "mm",
    "px",
    "%",
    "M",
    "m",
    "L",
    "A",
    "C",
    "S",
    "Q",
    "T",
    "Z",
    "H",
    "V",
    "0 0 0 1 1",
    "stroke-dasharray",
    "points='",
    "1e308",
    "nan",
    "-",
    ".",
    "e",
    ",",
    "<![CDATA[",
    "&#0;",
];
const READINGS: &[&str] = &[
    "x",
    "y",
    "z",
    "heading_deg",
    "azimuth_deg",
    "elevation_deg",
    "range",
    "sigma",
    "sigma_x",
    "sigma_y",
    "sigma_z",
    "sigma_heading_deg",
    "sigma_range",
    "pose_id",
    "time",
    "level",
    "FLASER",
    "PARAM",
    "#",
    ",",
    "\n",
    "1e308",
    "nan",
    "inf",
    "-1",
    "0",
    "180",
    "4294967296",
];
const CONTOUR: &[&str] = &[
    "\"kind\"",
    "\"circle\"",
    "\"ellipse\"",
    "\"rectangle\"",
    "\"polygon\"",
    "\"line\"",
    "\"parameters\"",
    "\"value\"",
    "\"sigma\"",
    "\"order\"",
    "\"covariance\"",
    "\"contours\"",
    "\"hole_of\"",
    "\"level\"",
    "\"unit\"",
    "\"mm\"",
    "\"constrained\"",
    "\"constraints\"",
    "\"radius\"",
    "\"x0\"",
    "null",
    "[]",
    "{}",
    "[[[[[[[[",
    "1e999",
    "-1",
    "0",
];

fn dxf(path: &Path) -> Result<()> {
    read_dxf(path).map(drop)
}

/// Faces are cut as coarsely as shows what a file can do to that.
fn step(path: &Path) -> Result<()> {
    let faces = read_step(path)?;
    let fineness = faces.fineness(Some(0.01 * faces.size()));
    faces.triangles(&fineness).map(drop)
}

fn svg(path: &Path) -> Result<()> {
    read_svg(path).map(drop)
}

/// What is stated where a file is silent.
fn stated() -> SigmaDefaults {
    SigmaDefaults { position: Some(0.1), heading_deg: Some(0.5), range: Some(0.1), point: Some(0.1) }
}

fn readings(path: &Path) -> Result<()> {
    read_contour_readings(path, &stated(), &CarmenOptions::default()).map(drop)
}

fn rays(path: &Path) -> Result<()> {
    read_ray_readings(path, &stated()).map(drop)
}

fn contour(path: &Path) -> Result<()> {
    read_contour_json(path).map(drop)
}

fn picture(path: &Path) -> Result<()> {
    read_picture(path).map(drop)
}

fn stereo_calibration(path: &Path) -> Result<()> {
    read_stereo_calibration(path).map(drop)
}

fn view_sensor(path: &Path) -> Result<()> {
    read_view_sensor(path).map(drop)
}

fn mask_views(path: &Path) -> Result<()> {
    read_views(path).map(drop)
}

fn shell_poses(path: &Path) -> Result<()> {
    read_poses(path).map(drop)
}

fn grid_calibration(path: &Path) -> Result<()> {
    read_grid_calibration(path).map(drop)
}

fn lights(path: &Path) -> Result<()> {
    read_lights(path).map(drop)
}

fn as_it_is(_: &mut Vec<u8>, _: &mut ChaCha8Rng) {}

/// Packs; every other time the packed bytes are damaged too.
fn gzip(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    *bytes = valid::packed(bytes);
    if random.random() {
        wear(bytes, random);
    }
}

/// Makes the length before the header that of the JSON object that follows, every other time.
#[allow(clippy::ptr_arg, reason = "everything that mends has one type")]
fn safetensors(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if bytes.len() < 8 || random.random() {
        return;
    }
    // Tensors begin after the header's last brace; numbers may look like one.
    let near = bytes.len().min(8192);
    if let Some(end) = bytes[8..near].windows(2).rposition(|pair| pair == b"}}") {
        let length = (end + 2) as u64;
        bytes[..8].copy_from_slice(&length.to_le_bytes());
    }
}

/// Damages bytes that were packed.
fn wear(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    for _ in 0..random.random_range(1..4) {
        if bytes.is_empty() {
            return;
        }
        let at = random.random_range(0..bytes.len());
        match random.random_range(0..3) {
            0 => bytes[at] = random.random(),
            1 => bytes.truncate(at.max(1)),
            _ => drop(bytes.drain(at..bytes.len().min(at + 4))),
        }
    }
}

/// Makes the count of triangles that of the bytes that follow, every other time.
fn count_of_stl(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if bytes.len() < 84 || bytes.starts_with(b"solid ") || random.random() {
        return;
    }
    let count = (bytes.len() - 84) / 50;
    bytes.truncate(84 + 50 * count);
    bytes[80..84].copy_from_slice(&(count as u32).to_le_bytes());
}

/// Makes the lengths of the file and its first chunk fit, every other time.
#[allow(clippy::ptr_arg, reason = "everything that mends has one type")]
fn lengths_of_glb(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if bytes.len() < 28 || random.random() {
        return;
    }
    let whole = (bytes.len() as u32).to_le_bytes();
    bytes[8..12].copy_from_slice(&whole);
    if let Some(at) = bytes.windows(4).position(|w| w == b"BIN\0").filter(|&at| at >= 24) {
        bytes[12..16].copy_from_slice(&((at - 24) as u32).to_le_bytes());
    }
}

/// Puts the bytes into an archive; every other time the archive is damaged too.
fn npz(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    *bytes = valid::archive(bytes, random.random());
    if random.random() {
        wear(bytes, random);
    }
}

/// Makes the checksums of the pages fit, three times of four.
#[allow(clippy::ptr_arg, reason = "everything that mends has one type")]
fn sums_of_e57(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if random.random_range(0..4) == 0 {
        return;
    }
    for page in bytes.as_chunks_mut::<1024>().0 {
        let (body, sum) = page.split_at_mut(1020);
        // CRC-32C, bit by bit.
        let crc = body.iter().fold(u32::MAX, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0x82f6_3b78 * (crc & 1)))
        });
        sum.copy_from_slice(&(!crc).to_be_bytes());
    }
}

/// Makes the checksums of the chunks fit, every other time.
#[allow(clippy::ptr_arg, reason = "everything that mends has one type")]
fn sums_of_png(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if random.random() {
        return;
    }
    let mut rest = bytes.get_mut(8..).unwrap_or_default();
    while let Some((&length, _)) = rest.split_first_chunk::<4>() {
        let end = (u32::from_be_bytes(length) as usize).saturating_add(8);
        let Some((chunk, after)) = rest.split_at_mut_checked(end) else {
            return;
        };
        let Some((sum, next)) = after.split_first_chunk_mut::<4>() else {
            return;
        };
        let mut crc = flate2::Crc::new();
        crc.update(&chunk[4..]);
        *sum = crc.sum().to_be_bytes();
        rest = next;
    }
}

/// Reads the image whose camera a file describes.
fn image_beside(path: &Path) -> Result<()> {
    scans(&beside(path, "a.png"))
}

fn scans(path: &Path) -> Result<()> {
    read_inputs(&[path], None).map(drop)
}

/// A name beside a file.
fn beside(path: &Path, name: &str) -> std::path::PathBuf {
    path.with_file_name(name)
}

fn bytes_of(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_default()
}

fn scan_and_back(path: &Path) -> Result<()> {
    scans(path)?;
    let contents = read_contents(path)?;
    let (first, second) = (beside(path, "first.ply"), beside(path, "second.ply"));
    write_scan(&first, &read_scan(path)?, contents.unit)?;
    write_scan(&second, &read_scan(&first)?, read_contents(&first)?.unit)?;
    assert!(bytes_of(&first) == bytes_of(&second), "a scan that was written reads as another");
    Ok(())
}

/// A mesh with its looks, which is split at its seams as for a viewer.
fn textured(path: &Path) -> Result<()> {
    read_textured(path).map(|mesh| {
        let split = mesh.split();
        assert!(split.triangles.iter().flatten().all(|&v| (v as usize) < split.vertex_of.len()));
    })
}

fn materials(path: &Path) -> Result<()> {
    read_materials(path).map(|_| ())
}

fn mesh_and_back(path: &Path) -> Result<()> {
    // A mesh may be read as points, and is asked what it holds by everyone who uses it.
    let as_points = scans(path);
    let described = info(path, None);
    let mesh = read_mesh(path)?;
    let name = |name: &str| beside(path, name).with_extension(extension(path));
    let (first, second, third) = (name("first"), name("second"), name("third"));
    // Names that are not one plain word are read and not written.
    if write(&mesh, &first).is_ok() {
        // The first time some formats round.
        write(&read_mesh(&first)?, &second)?;
        write(&read_mesh(&second)?, &third)?;
        assert!(bytes_of(&second) == bytes_of(&third), "a mesh that was written reads as another");
    }
    as_points.and(described.map(drop))
}

fn write(mesh: &PolygonMesh, path: &Path) -> Result<()> {
    write_mesh(
        path,
        &MeshColumns {
            points: &mesh.points,
            columns: mesh.columns.iter().map(|(name, column)| (name.as_str(), Column::F64(column))).collect(),
            triangles: &mesh.triangles,
            unit: mesh.unit,
            ..MeshColumns::default()
        },
    )
}

fn model_and_back(path: &Path) -> Result<()> {
    let saved = load_with_provenance(path)?;
    let (first, second) = (beside(path, "first.planish"), beside(path, "second.planish"));
    save(&saved.model, &saved.provenance, &first)?;
    let again = load_with_provenance(&first)?;
    save(&again.model, &again.provenance, &second)?;
    assert!(bytes_of(&first) == bytes_of(&second), "a model that was written reads as another");
    Ok(())
}
