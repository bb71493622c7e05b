//! Writes values per pixel: TIFF and NPY in single precision.
//!
//! **Input.** Bands, such as disparities and their σ.
//!
//! **Output.** A TIFF with two or four samples per pixel, compressed by deflate, or an array (rows, columns,
//! bands). Unknown values are NaN.
//!
//! **Limits.** TIFF files have at most 4 GB.

use std::io::{self, Cursor, Write};
use std::path::Path;

use planish_estimate::{Error, Result};
use tiff::TiffError;
use tiff::encoder::colortype::ColorType;
use tiff::encoder::compression::DeflateLevel;
use tiff::encoder::{Compression, TiffEncoder};
use tiff::tags::{ExtraSamples, PhotometricInterpretation, SampleFormat, Tag};

use crate::npy::npy_header;
use crate::source::extension;
use crate::write_atomically;

/// `N` samples of single precision per pixel.
struct Samples<const N: usize>;

impl<const N: usize> ColorType for Samples<N> {
    type Inner = f32;
    const TIFF_VALUE: PhotometricInterpretation = PhotometricInterpretation::BlackIsZero;
    const BITS_PER_SAMPLE: &'static [u16] = &[32; N];
    const SAMPLE_FORMAT: &'static [SampleFormat] = &[SampleFormat::IEEEFP; N];

    fn horizontal_predict(row: &[f32], result: &mut Vec<f32>) {
        // Never used, because no predictor is requested.
        result.extend_from_slice(row);
    }
}

/// Writes bands of values; the extension selects the format (`.tif` and `.tiff` with two or four bands,
/// `.npy`).
///
/// # Errors
/// `Input` for bands with another number of values than pixels; `Unsupported` for other extensions, other
/// numbers of bands and more than 4 GB; `Io` when the file cannot be written; nothing is left half-written.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("disparity.npy");
/// let (disparity, sigma) = ([10.0, f32::NAN], [0.1, f32::NAN]);
/// planish_exchange::raster::write_raster(&path, 2, 1, &[&disparity, &sigma])?;
/// assert!(std::fs::read(&path)?.starts_with(b"\x93NUMPY"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_raster(path: &Path, columns: usize, rows: usize, bands: &[&[f32]]) -> Result<()> {
    if let Some(band) = bands.iter().find(|band| band.len() != columns * rows) {
        return Err(Error::input(format!(
            "{}: expected {columns} × {rows} pixels in every band, found {}",
            path.display(),
            band.len()
        )));
    }
    let values: Vec<f32> = (0..columns * rows).flat_map(|k| bands.iter().map(move |band| band[k])).collect();
    // In memory, because the encoder of TIFF seeks back to complete its directory, which a pipe does not
    // allow.
    let bytes = match (extension(path).as_str(), bands.len()) {
        ("npy", _) => npy(columns, rows, bands.len(), &values),
        ("tif" | "tiff", 2) => tiff::<2>(columns, rows, &values).map_err(|e| too_large(path, e))?,
        ("tif" | "tiff", 4) => tiff::<4>(columns, rows, &values).map_err(|e| too_large(path, e))?,
        (other, n) => {
            return Err(Error::unsupported(format!(
                "{}: expected two or four bands as .tif or .npy, found {n} as `{other}`",
                path.display()
            )));
        }
    };
    write_atomically(path, |writer| writer.write_all(&bytes))
}

fn too_large(path: &Path, e: TiffError) -> Error {
    Error::unsupported(format!("{}: the bands do not fit into a TIFF file; use .npy", path.display()))
        .with_source(e)
}

fn tiff<const N: usize>(
    columns: usize,
    rows: usize,
    values: &[f32],
) -> std::result::Result<Vec<u8>, TiffError> {
    let mut file = Cursor::new(Vec::new());
    let mut encoder =
        TiffEncoder::new(&mut file)?.with_compression(Compression::Deflate(DeflateLevel::Balanced));
    let size = |n: usize| u32::try_from(n).map_err(|e| TiffError::IoError(io::Error::other(e)));
    let mut image = encoder.new_image::<Samples<N>>(size(columns)?, size(rows)?)?;
    let unspecified = [ExtraSamples::Unspecified.to_u16(); N];
    // `BlackIsZero` describes one sample, so TIFF requires the others to be declared as extra.
    image.encoder().write_tag(Tag::ExtraSamples, &unspecified[1..])?;
    image.write_data(values)?;
    Ok(file.into_inner())
}

fn npy(columns: usize, rows: usize, bands: usize, values: &[f32]) -> Vec<u8> {
    let mut bytes = npy_header("'<f4'", false, &format!("({rows}, {columns}, {bands})"));
    bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiff::decoder::{Decoder, DecodingResult};

    #[test]
    fn bands_are_interleaved_pixel_by_pixel() {
        let folder = tempfile::tempdir().unwrap();
        let (a, b) = ([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [0.5, 0.25, 0.125, 1.0, 2.0, 4.0]);
        let path = folder.path().join("a.tif");
        write_raster(&path, 3, 2, &[&a, &b]).unwrap();
        let mut decoder = Decoder::new(std::fs::File::open(&path).unwrap()).unwrap();
        assert_eq!(decoder.dimensions().unwrap(), (3, 2));
        let DecodingResult::F32(values) = decoder.read_image().unwrap() else { panic!("expected f32") };
        assert_eq!(values[..4], [1.0, 0.5, 2.0, 0.25]);
        let path = folder.path().join("a.npy");
        write_raster(&path, 3, 2, &[&a, &b]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!((bytes.len() - 48) % 64, 0);
        assert!(String::from_utf8_lossy(&bytes[..128]).contains("(2, 3, 2)"));
        assert_eq!(bytes[bytes.len() - 4..], 4.0_f32.to_le_bytes());
        assert!(write_raster(&path, 3, 2, &[&a, &b[1..]]).is_err());
        assert!(write_raster(&folder.path().join("a.png"), 3, 2, &[&a, &b]).is_err());
    }
}
