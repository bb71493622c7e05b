//! Depth images: PNG of 8 or 16 bits, TIFF and NPY of one channel, with the calibration of their camera.
//!
//! **Input.** An image and a [`Calibration`](crate::calibration::Calibration). Its σ = a + b z² gives each
//! point a covariance: σ along the ray, and the width of the pixel across it.
//!
//! **Output.** An organised [`Scan`] in the frame of the camera (x right, y down, z forward), viewed from the
//! centre of the camera.
//!
//! The calibration is the one that a job names, or else the file `NAME.toml` beside `NAME.png`.
//!
//! **Limits.** Depth is along the axis of the camera, not along the ray. A reading that is zero, negative or
//! not finite is an empty cell and counts as a point that is not finite.

pub(crate) mod tags;

use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};

use planish_estimate::{Error, Result};
use planish_sense::{Scan, Viewing};
use tiff::decoder::{Decoder as TiffDecoder, DecodingResult, Limits};
use tiff::{ColorType as TiffColor, TiffError};

use crate::Unit;
use crate::calibration::read_calibration;
use crate::npy;
use crate::points::{PointCollector, PointColumns, grid_without};
use crate::source::{extension, open_file};

/// A byte of a compressed image stands for so many at most (DEFLATE).
const MOST_EXPANSION: u64 = 1032;

/// Readings, row by row.
struct Image {
    columns: usize,
    rows: usize,
    readings: Vec<f64>,
}

/// Whether a file can only be a depth image, or has a calibration beside it and the shape of one.
pub(crate) fn is_depth_image(path: &Path) -> bool {
    match extension(path).as_str() {
        "png" | "tif" | "tiff" => true,
        "npy" => beside(path).is_file() && npy::is_image(path),
        _ => false,
    }
}

/// Where the calibration of an image is looked for when no job names one.
fn beside(path: &Path) -> PathBuf {
    match extension(path) == extension(path.with_extension("").as_path()) {
        // `.npy.gz` has two extensions.
        true => path.with_extension("").with_extension("toml"),
        false => path.with_extension("toml"),
    }
}

/// The calibration of an image: the one named, or the one beside it.
///
/// # Errors
/// `Io` for a missing image; `Input` where there is neither.
pub fn calibration_of(path: &Path, named: Option<&Path>) -> Result<PathBuf> {
    if let Some(named) = named {
        return Ok(named.to_path_buf());
    }
    // A missing image is the likelier mistake.
    open_file(path).map_err(|e| e.in_context(path.display()))?;
    let beside = beside(path);
    match beside.is_file() {
        true => Ok(beside),
        false => Err(Error::input(format!(
            "{}: a depth image needs the calibration of its camera: name one in a job (`calibration \
             = \"camera.toml\"` in its [[scan]]) or write \
             {} with fx fy cx cy and scale, and sigma_a sigma_b for σ = a + b z²",
            path.display(),
            beside.display()
        ))),
    }
}

/// Reads a depth image as an organised scan.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when a file is missing or unreadable;
/// [`Input`](planish_estimate::ErrorKind::Input) when one is malformed or cut off;
/// [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for images of several channels.
pub fn read_depth(path: &Path, calibration: &Path) -> Result<(Scan, Option<Unit>)> {
    let calibration = read_calibration(calibration)?;
    let camera = &calibration.camera;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let image = read_image(path).map_err(|e| e.in_context(path.display()))?;
    let columns = match camera.sigma {
        Some(_) => PointColumns::find(&["x", "y", "z", "cxx", "cxy", "cxz", "cyy", "cyz", "czz"])?,
        None => PointColumns::positions_only(),
    };
    let mut collector = PointCollector::new(columns, image.readings.len());
    let mut record = [0.0; 9];
    for (pixel, &reading) in image.readings.iter().enumerate() {
        let (row, column) = (pixel / image.columns, pixel % image.columns);
        let (u, v) = (column as f64, row as f64);
        let point = camera.point(u, v, reading).unwrap_or([f64::NAN; 3]);
        record[..3].copy_from_slice(&point);
        record[3..].copy_from_slice(&camera.covariance(u, v, point[2]).unwrap_or_default().to_array());
        collector
            .push(&record, format_args!("column {column}, row {row}"))
            .map_err(|e| e.in_context(path.display()))?;
    }
    let (mut scan, dropped) = collector.finish(&name);
    scan.grid = Some(grid_without(image.columns, image.rows, &dropped));
    scan.viewing = Viewing::Origin([0.0; 3]);
    Ok((scan, calibration.unit))
}

fn read_image(path: &Path) -> Result<Image> {
    let image = match extension(path).as_str() {
        "npy" => {
            let (columns, rows, readings) = npy::read_image(path)?;
            Image { columns, rows, readings }
        }
        "png" => {
            let (file, length) = open_file(path)?;
            read_png(BufReader::new(file), length)?
        }
        "tif" | "tiff" => {
            let (file, length) = open_file(path)?;
            read_tiff(BufReader::new(file), length)?
        }
        other => {
            return Err(Error::unsupported(format!(
                "has a calibration: needed a depth image (png, tif, tiff, npy), found the extension `{other}`"
            )));
        }
    };
    if image.readings.is_empty() || image.readings.len() != image.columns * image.rows {
        return Err(Error::input(format!(
            "needed {} × {} readings, found {}",
            image.columns,
            image.rows,
            image.readings.len()
        )));
    }
    Ok(image)
}

/// Refuses an image that so many bytes cannot hold.
pub(crate) fn check_promise(columns: u32, rows: u32, length: Option<u64>) -> Result<()> {
    let pixels = u64::from(columns) * u64::from(rows);
    match length {
        Some(length) if pixels > length.saturating_mul(MOST_EXPANSION) => Err(Error::input(format!(
            "the header promises {columns} × {rows} pixels, which {length} bytes cannot hold: the file is \
             damaged"
        ))),
        _ => Ok(()),
    }
}

fn read_png(file: impl std::io::BufRead + Seek, length: Option<u64>) -> Result<Image> {
    let damaged = |e: png::DecodingError| match e {
        png::DecodingError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => {
            Error::io("could not be read").with_source(e)
        }
        e => Error::input("is no PNG image, or is damaged or cut off").with_source(e),
    };
    let mut reader = png::Decoder::new(file).read_info().map_err(damaged)?;
    let info = reader.info();
    let (columns, rows) = (info.width, info.height);
    check_promise(columns, rows, length)?;
    let wide = match reader.output_color_type() {
        (png::ColorType::Grayscale, png::BitDepth::Sixteen) => true,
        (png::ColorType::Grayscale, png::BitDepth::Eight) => false,
        (colour, depth) => {
            return Err(Error::unsupported(format!(
                "needed depth in one channel of 16 (or 8) bits, found {colour:?} of {depth:?} bits: this is \
                 a picture"
            )));
        }
    };
    if info.interlaced {
        return Err(Error::unsupported("is interlaced: write it without"));
    }
    let mut readings = Vec::new();
    while let Some(row) = reader.next_row().map_err(damaged)? {
        match wide {
            true => readings
                .extend(row.data().chunks_exact(2).map(|b| f64::from(u16::from_be_bytes([b[0], b[1]])))),
            false => readings.extend(row.data().iter().map(|&b| f64::from(b))),
        }
    }
    Ok(Image { columns: columns as usize, rows: rows as usize, readings })
}

/// Memory in proportion to the file: the decoder takes what the header asks for before it reads.
pub(crate) fn tiff_limits(length: Option<u64>) -> Limits {
    let mut limits = Limits::default();
    if let Some(length) = length {
        let unpacked = usize::try_from(length.saturating_mul(MOST_EXPANSION)).unwrap_or(usize::MAX);
        // A pixel takes eight bytes at most.
        limits.decoding_buffer_size = limits.decoding_buffer_size.min(unpacked.saturating_mul(8));
        limits.intermediate_buffer_size = limits.intermediate_buffer_size.min(unpacked.saturating_mul(8));
        limits.ifd_value_size = limits.ifd_value_size.min(usize::try_from(length).unwrap_or(usize::MAX));
    }
    limits
}

fn read_tiff(mut file: impl Read + Seek, length: Option<u64>) -> Result<Image> {
    let damaged = |e: TiffError| match e {
        TiffError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => {
            Error::io("could not be read").with_source(e)
        }
        TiffError::LimitsExceeded => Error::unsupported(
            "a TIFF image of more than 256 MiB, or of more than its file can hold: write it in parts, or \
             anew",
        ),
        TiffError::UnsupportedError(_) => {
            Error::unsupported("a TIFF image of a kind that is not read").with_source(e)
        }
        e => Error::input("is no TIFF image, or is damaged or cut off").with_source(e),
    };
    tags::check(&mut file)?;
    let mut decoder = TiffDecoder::new(file).map_err(damaged)?.with_limits(tiff_limits(length));
    let (columns, rows) = decoder.dimensions().map_err(damaged)?;
    check_promise(columns, rows, length)?;
    match decoder.colortype().map_err(damaged)? {
        TiffColor::Gray(_) => {}
        other => {
            return Err(Error::unsupported(format!(
                "needed depth in one channel, found {other:?}: this is a picture"
            )));
        }
    }
    let readings = match decoder.read_image().map_err(damaged)? {
        DecodingResult::U8(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::U16(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::U32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::I16(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::I32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::F32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::F64(v) => v,
        _ => {
            return Err(Error::unsupported("needed numbers of 8, 16 or 32 bits, or floating point"));
        }
    };
    Ok(Image { columns: columns as usize, rows: rows as usize, readings })
}

#[cfg(test)]
mod tests;
