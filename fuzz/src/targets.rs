//! The readers and commands that are tested with damaged files, one line each.
//!
//! In: a damaged file. Out: whether the reader accepts or rejects it. What is written from an accepted file
//! must read back the same. A new reader needs a line of [`TARGETS`], a function in [`crate::valid`], and the
//! words of its format in `words`.

mod commands;
mod pdf_words;
mod readers;
mod repairs;
mod words;

use crate::valid;
use pdf_words::PDF;
use planish_estimate::Result;
use rand_chacha::ChaCha8Rng;
use readers::*;
use repairs::*;
use std::path::Path;
use words::*;

/// A reader and its test files.
pub struct FuzzTarget {
    /// Name on the command line and in the log.
    pub name: &'static str,
    /// Name of the file to read; its extension selects the reader.
    pub file: &'static str,
    /// Valid files.
    pub valid: fn() -> Result<Vec<Vec<u8>>>,
    /// Words of the format, inserted by the damage.
    pub words: &'static [&'static str],
    /// Repairs lengths and checksums of the damaged bytes, so that the reader does not stop at them.
    pub repair: fn(&mut Vec<u8>, &mut ChaCha8Rng),
    /// Reads the file. If the format is also written, writes the result and reads it back.
    pub read: fn(&Path) -> Result<()>,
}

/// A row of [`TARGETS`]; one line per reader keeps the table readable.
const fn target(
    name: &'static str,
    file: &'static str,
    valid: fn() -> Result<Vec<Vec<u8>>>,
    words: &'static [&'static str],
    repair: fn(&mut Vec<u8>, &mut ChaCha8Rng),
    read: fn(&Path) -> Result<()>,
) -> FuzzTarget {
    FuzzTarget { name, file, valid, words, repair, read }
}

/// Every reader: name, file, valid files, words, repair, reader.
///
/// The name also seeds the damage: a renamed target is tested with other files.
#[rustfmt::skip]
pub const TARGETS: &[FuzzTarget] = &[
    target("ply-scan", "a.ply", valid::ply_scans, PLY, unchanged, scan_round_trip),
    target("ply-mesh", "a.ply", valid::ply_meshes, PLY, unchanged, mesh_round_trip),
    target("xyz", "a.xyz", valid::texts, TEXT, unchanged, scans),
    target("csv", "a.csv", valid::texts, TEXT, unchanged, scans),
    target("pts", "a.pts", valid::texts, TEXT, unchanged, scans),
    target("pcd", "a.pcd", valid::pcds, PCD, unchanged, scans),
    target("las", "a.las", valid::las, &[], unchanged, scans),
    target("laz", "a.laz", valid::laz, &[], unchanged, scans),
    // Repaired by packing: damage to the PLY file inside gets past the checksum of the archive.
    target("gzip", "a.ply.gz", valid::ply_scans, PLY, pack_gzip, scans),
    target("conf", "a.conf", valid::lists, LIST, unchanged, scans),
    target("job", "a.toml", valid::jobs, JOB, unchanged, scans),
    target("obj", "a.obj", valid::objs, OBJ, unchanged, mesh_round_trip),
    // The same files as `obj`, read with materials and texture coordinates.
    target("obj-looks", "a.obj", valid::objs, OBJ, unchanged, textured),
    target("mtl", "a.mtl", valid::mtls, MTL, unchanged, materials),
    target("off", "a.off", valid::offs, OFF, unchanged, mesh_round_trip),
    target("stl", "a.stl", valid::stls, STL, repair_stl_count, mesh_round_trip),
    target("step", "a.step", valid::steps, STEP, unchanged, step),
    target("glb-looks", "a.glb", valid::posed, GLB, repair_glb_lengths, textured),
    target("glb", "a.glb", valid::glbs, GLB, repair_glb_lengths, mesh_round_trip),
    target("npy", "a.npy", valid::npys, NPY, unchanged, scans),
    target("npz", "a.npz", valid::npys, NPY, pack_npz, scans),
    target("e57", "a.e57", valid::e57s, XML, repair_e57_checksums, scans),
    target("png", "a.png", valid::pngs, &[], repair_png_checksums, scans),
    target("tiff", "a.tif", valid::tiffs, &[], unchanged, scans),
    // Under this name, no calibration lies beside it.
    target("geotiff", "map.tif", valid::geotiffs, &[], unchanged, scans),
    // The image beside it is valid; only its calibration is damaged.
    target("camera", "a.toml", valid::cameras, CAMERA, unchanged, depth_image),
    target("picture", "p.png", valid::pngs, &[], repair_png_checksums, picture),
    target("jpeg", "p.jpg", valid::jpegs, &[], unchanged, picture),
    target("tga", "p.tga", valid::tgas, &[], unchanged, picture),
    target("pgm", "p.pgm", valid::pgms, PGM, unchanged, picture),
    target("stereo", "s.toml", valid::stereos, CAMERA, unchanged, stereo_calibration),
    target("view", "v.toml", valid::views, CAMERA, unchanged, view_sensor),
    target("views", "v.toml", valid::mask_views, VIEWS, unchanged, mask_views),
    target("poses", "p.toml", valid::poses, POSES, unchanged, shell_poses),
    target("grid", "g.toml", valid::grids, GRID, unchanged, grid_calibration),
    target("lights", "l.toml", valid::lights, LIGHTS, unchanged, lights),
    target("dxf", "a.dxf", valid::dxfs, DXF, unchanged, dxf),
    target("svg", "a.svg", valid::svgs, SVG, unchanged, svg),
    target("pdf", "a.pdf", valid::pdfs, PDF, unchanged, pdf),
    target("readings", "a.csv", valid::readings, READINGS, unchanged, readings),
    target("carmen", "a.log", valid::carmen_logs, READINGS, unchanged, readings),
    target("rays", "a.csv", valid::rays, READINGS, unchanged, rays),
    target("contour", "a.json", valid::contours, CONTOUR, unchanged, contour),
    target("planish", "a.planish", valid::models, JSON, repair_model, model_round_trip),
];

/// Whole commands, in the same columns. A case computes and writes, and takes a hundred times as long.
#[rustfmt::skip]
pub const COMMANDS: &[FuzzTarget] = &[
    target("fit", "a.xyz", valid::fitted_texts, TEXT, unchanged, commands::fit),
    target("fit-job", "a.toml", valid::fitted_jobs, JOB, unchanged, commands::fit),
    target("update", "a.planish", valid::sheets, JSON, repair_model, commands::update),
    target("compare", "a.ply", valid::fitted_meshes, PLY, unchanged, commands::compare),
    target("merge", "a.ply", valid::fitted_meshes, PLY, unchanged, commands::merge),
    target("next", "a.planish", valid::models, JSON, repair_model, commands::next),
    target("solid", "a.dxf", valid::front_views, DXF, unchanged, commands::solid),
    target("fit-contour", "a.csv", valid::outlines, READINGS, unchanged, commands::contour),
    target("pose", "p.toml", valid::patch_poses, POSES, unchanged, commands::pose),
    target("verify-glb", "a.glb", valid::glbs, GLB, repair_glb_lengths, commands::verify),
    target("verify-step", "a.step", valid::steps, STEP, unchanged, commands::verify),
];
