//! Small valid files of every format: the damage starts from them.
//!
//! Files come from our own writers where there is one; other variants are written by hand.

mod calibrations;
mod commands;
mod drawings;
mod images;
mod meshes;
mod scans;

pub use calibrations::*;
pub use commands::*;
pub use drawings::*;
pub use images::*;
pub use meshes::*;
pub use scans::*;

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use planish_estimate::{Error, Result};
use std::io::{Cursor, Write as _};
use std::path::Path;

/// Points of a wavy surface over the unit square, `side` in each direction.
fn points(side: u32) -> Vec<[f64; 3]> {
    let height = |x: f64, y: f64| 0.1 * (4.0 * x * x + 3.0 * y).sin();
    (0..side * side)
        .map(|k| [k % side, k / side].map(|c| f64::from(c) / f64::from(side - 1)))
        .map(|[x, y]| [x, y, height(x, y)])
        .collect()
}

/// The bytes of a file that `write` writes under this name.
fn written(write: impl FnOnce(&Path) -> Result<()>, name: &str) -> Result<Vec<u8>> {
    let folder =
        tempfile::tempdir().map_err(|e| Error::io("cannot create a temporary folder").with_source(e))?;
    let path = folder.path().join(name);
    write(&path)?;
    std::fs::read(&path).map_err(|e| Error::io("cannot read the written file").with_source(e))
}

/// The bytes, compressed with gzip.
pub fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    // Neither call can fail in memory.
    let _ = encoder.write_all(bytes);
    encoder.finish().unwrap_or_default()
}

/// The bytes, compressed as in PDF streams.
fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    let _ = encoder.write_all(bytes);
    encoder.finish().unwrap_or_default()
}

/// The files that lists, jobs and cameras refer to; they lie in the same folder.
pub fn neighbours() -> Result<Vec<(&'static str, Vec<u8>)>> {
    let points = b"0 0 0\n1 0 0\n0 1 0\n".to_vec();
    let mut files = vec![
        ("good.xyz", points.clone()),
        ("a scan.xyz", points),
        ("a.png", pngs()?.swap_remove(0)),
        ("a.toml", cameras()?.swap_remove(0)),
    ];
    files.extend(companions());
    Ok(files)
}

/// A ZIP archive (NPZ) that holds the array twice, under two names.
pub fn archive(array: &[u8], packed: bool) -> Vec<u8> {
    use zip::write::SimpleFileOptions;
    use zip::{CompressionMethod, ZipWriter};
    let method = if packed { CompressionMethod::Deflated } else { CompressionMethod::Stored };
    let options = SimpleFileOptions::default().compression_method(method);
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for name in ["points.npy", "normals.npy"] {
        // Neither call can fail in memory.
        let _ = writer.start_file(name, options);
        let _ = writer.write_all(array);
    }
    writer.finish().map(Cursor::into_inner).unwrap_or_default()
}
