//! Depth images: PNG of 8 or 16 bits, TIFF and NPY of one channel, with the calibration of their camera.
//!
//! **Input.** An image and a [`Calibration`](crate::calibration::Calibration). Its σ = a + b z² gives each
//! point a covariance: σ along the ray, and the width of the pixel across it.
//!
//! **Output.** An organised [`Scan`] in the frame of the camera (x right, y down, z forward), viewed from the
//! centre of the camera.
//!
//! The calibration is the one that a job names, or else the file `NAME.toml` beside `NAME.png`. It is never
//! guessed from the size of the image (decision 0038).
//!
//! **Limits.** Depth is measured along the axis of the camera, not along the ray. A reading that is zero,
//! negative or not finite is an empty cell and counts as a dropped point.

pub(crate) mod tags;

use planish_core::{Budget, DVec3};
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
use crate::source::{MAX_DEFLATE_RATIO, describe_extension, extension, open_file};

/// Formats of depth images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Npy,
    Png,
    Tiff,
}

impl Format {
    /// The format by the extension of a name.
    ///
    /// # Errors
    /// `Unsupported` for other extensions.
    fn of_name(path: &Path) -> Result<Self> {
        match extension(path).as_str() {
            "npy" => Ok(Self::Npy),
            "png" => Ok(Self::Png),
            "tif" | "tiff" => Ok(Self::Tiff),
            _ => Err(Error::unsupported(format!(
                "expected a depth image (png, tif, tiff, npy), found {}; other formats of scans hold points \
                 and need no camera",
                describe_extension(path)
            ))),
        }
    }
}

/// Memory of a reading.
const READING_BYTES: u64 = size_of::<f64>() as u64;

/// A depth image: readings row by row from the top.
struct Image {
    columns: usize,
    rows: usize,
    readings: Vec<f64>,
    /// The memory that the file may take.
    budget: Budget,
}

/// True for PNG and TIFF files, and for NPY files that have the shape of an image and a calibration beside
/// them.
///
/// An NPY array of 16 columns or fewer may also hold points, so its shape and the calibration decide.
pub(crate) fn is_depth_image(path: &Path) -> bool {
    match Format::of_name(path) {
        Ok(Format::Png | Format::Tiff) => true,
        Ok(Format::Npy) => default_calibration(path).is_file() && npy::is_image(path),
        Err(_) => false,
    }
}

/// Default path of the calibration of an image.
fn default_calibration(path: &Path) -> PathBuf {
    match extension(path) == extension(path.with_extension("").as_path()) {
        // `extension` ignores `.gz`, so both extensions of `NAME.npy.gz` must be removed.
        true => path.with_extension("").with_extension("toml"),
        false => path.with_extension("toml"),
    }
}

/// Returns the path of the calibration of an image: the given one, or the default beside the image.
///
/// # Errors
/// Without a given path: `Io` for a missing image, `Unsupported` for a file that is no depth image by its
/// extension, and `Input` if there is no calibration.
pub fn find_calibration(path: &Path, named: Option<&Path>) -> Result<PathBuf> {
    if let Some(named) = named {
        return Ok(named.to_path_buf());
    }
    // If the image is missing, too, its name is the mistake. Files that need no camera are refused before it
    // is looked for.
    let format = open_file(path).and_then(|_| Format::of_name(path));
    format.map_err(|e| e.in_context(path.display()))?;
    let found = default_calibration(path);
    match found.is_file() {
        true => Ok(found),
        false => Err(Error::input(format!(
            "{}: expected the calibration of the camera, found none: name it in a job (`calibration = \
             \"camera.toml\"` in the [[scan]]), or write {} with fx fy cx cy and scale, and sigma_a sigma_b \
             for σ = a + b z²",
            path.display(),
            found.display()
        ))),
    }
}

/// Reads a depth image as an organised scan.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when a file is missing or unreadable;
/// [`Input`](planish_estimate::ErrorKind::Input) when one is malformed or cut off;
/// [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for images of several channels.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::depth::read_depth;
/// use planish_exchange::picture::write_grey_png;
/// # let folder = tempfile::tempdir()?;
/// let (image, camera) = (folder.path().join("depth.png"), folder.path().join("depth.toml"));
/// write_grey_png(&image, 2, 1, &[100, 0])?;
/// std::fs::write(&camera, "fx = 1\nfy = 1\ncx = 0\ncy = 0\n")?;
/// let (scan, _) = read_depth(&image, &camera)?;
/// // The second pixel has no reading.
/// assert_eq!((scan.points, scan.dropped_not_finite), (vec![100.0 * DVec3::Z], 1));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_depth(path: &Path, calibration: &Path) -> Result<(Scan, Option<Unit>)> {
    let calibration = read_calibration(calibration)?;
    let camera = &calibration.camera;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let image = read_image(path).map_err(|e| e.in_context(path.display()))?;
    // Without σ the columns are absent, not zero: only then is the noise estimated from the readings.
    let columns = match camera.sigma {
        Some(_) => PointColumns::find(&["x", "y", "z", "cxx", "cxy", "cxz", "cyy", "cyz", "czz"])?,
        None => PointColumns::positions_only(),
    };
    let mut collector = PointCollector::new(columns, image.readings.len(), &image.budget);
    let mut record = [0.0; 9];
    for (pixel, &reading) in image.readings.iter().enumerate() {
        let (row, column) = (pixel / image.columns, pixel % image.columns);
        let (u, v) = (column as f64, row as f64);
        // A pixel without a reading becomes NaN and is dropped, so its covariance does not matter.
        let point = camera.point(u, v, reading).unwrap_or(DVec3::splat(f64::NAN));
        record[..3].copy_from_slice(point.as_ref());
        record[3..].copy_from_slice(&camera.covariance(u, v, point[2]).unwrap_or_default().to_array());
        collector
            .push(&record, format_args!("column {column}, row {row}"))
            .map_err(|e| e.in_context(path.display()))?;
    }
    let (mut scan, dropped) = collector.finish(&name);
    scan.grid = Some(grid_without(image.columns, image.rows, &dropped));
    scan.viewing = Viewing::Origin(DVec3::ZERO);
    Ok((scan, calibration.unit))
}

fn read_image(path: &Path) -> Result<Image> {
    let image = match Format::of_name(path)? {
        Format::Npy => {
            let (columns, rows, readings) = npy::read_image(path)?;
            Image { columns, rows, readings, budget: Budget::of_process() }
        }
        Format::Png => {
            let (file, length) = open_file(path)?;
            read_png(BufReader::new(file), length)?
        }
        Format::Tiff => {
            let (file, length) = open_file(path)?;
            read_tiff(BufReader::new(file), length)?
        }
    };
    // The caller divides by the number of columns, and its grid needs a reading for each cell.
    if image.readings.is_empty() || image.readings.len() != image.columns * image.rows {
        return Err(Error::input(format!(
            "expected {} × {} readings, found {}",
            image.columns,
            image.rows,
            image.readings.len()
        )));
    }
    Ok(image)
}

/// Bytes of memory that a byte of a picture may take. A depth image takes up to 90 bytes per pixel, with the
/// covariance of its point, and packs a measured pixel into a byte or more (decision 0089).
const PICTURE_RATIO: u64 = 64;

/// The memory that a picture of `length` bytes may take.
pub(crate) fn picture_budget(length: Option<u64>) -> Budget {
    length.map_or_else(Budget::of_process, |length| Budget::of_compressed(length, PICTURE_RATIO))
}

/// Takes the memory of an image, `bytes` per pixel, before it is decoded. Also rejects a declared size that a
/// file of this length cannot hold.
pub(crate) fn take_pixels(
    columns: u32,
    rows: u32,
    length: Option<u64>,
    bytes: u64,
    budget: &Budget,
) -> Result<()> {
    // The product of two 32-bit numbers fits.
    let pixels = u64::from(columns) * u64::from(rows);
    match length {
        Some(length) if pixels > length.saturating_mul(MAX_DEFLATE_RATIO) => Err(Error::input(format!(
            "the header declares {columns} × {rows} pixels, which {length} bytes cannot hold: the file is \
             damaged"
        ))),
        _ => budget.take_elements(pixels, bytes, format_args!("pixels ({columns} × {rows})")),
    }
}

fn read_png(file: impl std::io::BufRead + Seek, length: Option<u64>) -> Result<Image> {
    let damaged = |e: png::DecodingError| match e {
        png::DecodingError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => {
            Error::io("could not be read").with_source(e)
        }
        e => Error::input("not a PNG image, or damaged or cut off").with_source(e),
    };
    let mut reader = png::Decoder::new(file).read_info().map_err(damaged)?;
    let info = reader.info();
    let (columns, rows) = (info.width, info.height);
    // Before any row is decoded, because the header alone can request gigabytes.
    let budget = picture_budget(length);
    take_pixels(columns, rows, length, READING_BYTES, &budget)?;
    let wide = match reader.output_color_type() {
        (png::ColorType::Grayscale, png::BitDepth::Sixteen) => true,
        (png::ColorType::Grayscale, png::BitDepth::Eight) => false,
        (colour, depth) => {
            return Err(Error::unsupported(format!(
                "expected a depth image with one channel of 16 or 8 bits, found {colour:?} of {depth:?} bits"
            )));
        }
    };
    // Rows of an interlaced image arrive in seven passes of partial rows, which the loop below would
    // misplace.
    if info.interlaced {
        return Err(Error::unsupported("the PNG image is interlaced: save it without interlacing"));
    }
    let mut readings = Vec::new();
    while let Some(row) = reader.next_row().map_err(damaged)? {
        match wide {
            // PNG stores 16-bit values in big endian.
            true => readings
                .extend(row.data().chunks_exact(2).map(|b| f64::from(u16::from_be_bytes([b[0], b[1]])))),
            false => readings.extend(row.data().iter().map(|&b| f64::from(b))),
        }
    }
    Ok(Image { columns: columns as usize, rows: rows as usize, readings, budget })
}

/// Memory limits in proportion to the file, because the decoder allocates what the header declares before it
/// reads.
pub(crate) fn tiff_limits(length: Option<u64>) -> Limits {
    let mut limits = Limits::default();
    if let Some(length) = length {
        let unpacked = usize::try_from(length.saturating_mul(MAX_DEFLATE_RATIO)).unwrap_or(usize::MAX);
        // Decoded values have at most eight bytes.
        // `min` keeps the absolute limits of the decoder, which bound large files too.
        limits.decoding_buffer_size = limits.decoding_buffer_size.min(unpacked.saturating_mul(8));
        limits.intermediate_buffer_size = limits.intermediate_buffer_size.min(unpacked.saturating_mul(8));
        limits.ifd_value_size = limits.ifd_value_size.min(usize::try_from(length).unwrap_or(usize::MAX));
    }
    limits
}

/// The error of a TIFF decoder in terms of the file.
pub(crate) fn tiff_error(e: TiffError) -> Error {
    match e {
        TiffError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => {
            Error::io("could not be read").with_source(e)
        }
        TiffError::LimitsExceeded => Error::unsupported(
            "expected a TIFF image of at most 256 MiB that its file can hold: split it, or save it again",
        ),
        TiffError::UnsupportedError(_) => {
            Error::unsupported("this kind of TIFF image is not supported").with_source(e)
        }
        e => Error::input("not a TIFF image, or damaged or cut off").with_source(e),
    }
}

/// The samples of a decoded TIFF image as numbers.
pub(crate) fn tiff_samples(decoded: DecodingResult) -> Result<Vec<f64>> {
    Ok(match decoded {
        DecodingResult::U8(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::U16(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::U32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::I16(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::I32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::F32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::F64(v) => v,
        _ => {
            return Err(Error::unsupported(
                "expected integers of 8, 16 or 32 bits, or floating-point numbers",
            ));
        }
    })
}

fn read_tiff(mut file: impl Read + Seek, length: Option<u64>) -> Result<Image> {
    // First, because the decoder reads tags when it is created, before `with_limits` can bound them.
    tags::check(&mut file)?;
    let mut decoder = TiffDecoder::new(file).map_err(tiff_error)?.with_limits(tiff_limits(length));
    let (columns, rows) = decoder.dimensions().map_err(tiff_error)?;
    let budget = picture_budget(length);
    // Twice, because the decoded values are converted.
    take_pixels(columns, rows, length, 2 * READING_BYTES, &budget)?;
    match decoder.colortype().map_err(tiff_error)? {
        TiffColor::Gray(_) => {}
        other => {
            return Err(Error::unsupported(format!(
                "expected a depth image with one channel, found {other:?}"
            )));
        }
    }
    let readings = tiff_samples(decoder.read_image().map_err(tiff_error)?)?;
    Ok(Image { columns: columns as usize, rows: rows as usize, readings, budget })
}

#[cfg(test)]
mod tests;
