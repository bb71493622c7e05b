//! Reads and writes GeoTIFF: heights and their σ on a grid of a map.
//!
//! **Input.** A [`HeightGrid`] to write; a file of heights to read ([`read_geotiff`]).
//!
//! **Output.** One file with two interleaved bands in single precision, compressed by deflate. Band 1 is the
//! height, band 2 its σ; both are [`NODATA`] where the grid has no value. Coordinates have double precision.
//! A pixel is an area whose upper left corner is tied to the map.
//!
//! **Limits.** Files have at most 4 GB.

mod read;
#[cfg(test)]
mod tests;

use std::io::{self, Cursor, Write};
use std::path::Path;

use planish_estimate::{Error, Result};
use tiff::TiffError;
use tiff::encoder::colortype::ColorType;
use tiff::encoder::compression::DeflateLevel;
use tiff::encoder::{Compression, TiffEncoder};
use tiff::tags::{ExtraSamples, PhotometricInterpretation, SampleFormat, Tag};

use crate::georeference::{DOUBLES_TAG, RASTER_TYPE, TEXT_TAG};
use crate::{GeoReference, Unit, write_atomically};
pub(crate) use read::is_height_map;
pub use read::{HeightScan, read_geotiff};

/// Value of cells without a height. GIS programs read it from the tag `GDAL_NODATA`.
pub const NODATA: f32 = -9999.0;

/// Heights on a grid whose rows run from north to south.
#[derive(Debug, Clone, PartialEq)]
pub struct HeightGrid {
    /// West and north border: coordinates of the upper left corner of the first cell.
    pub corner: [f64; 2],
    /// Side of a cell.
    pub cell: f64,
    /// Cells from west to east.
    pub columns: usize,
    /// Cells from north to south.
    pub rows: usize,
    /// Height and σ at the middle of each cell, row by row; [`NODATA`] twice if unknown.
    pub values: Vec<[f32; 2]>,
    /// Unit of every length.
    pub unit: Unit,
    /// Map projection, if known.
    pub georeference: Option<GeoReference>,
}

/// Two samples of single precision per pixel.
struct HeightAndSigma;

impl ColorType for HeightAndSigma {
    type Inner = f32;
    const TIFF_VALUE: PhotometricInterpretation = PhotometricInterpretation::BlackIsZero;
    const BITS_PER_SAMPLE: &'static [u16] = &[32, 32];
    const SAMPLE_FORMAT: &'static [SampleFormat] = &[SampleFormat::IEEEFP; 2];

    fn horizontal_predict(row: &[f32], result: &mut Vec<f32>) {
        // Never used, because no predictor is requested.
        result.extend_from_slice(row);
    }
}

/// Private tag of GDAL for the names and units of bands.
const GDAL_METADATA: Tag = Tag::Unknown(42112);
/// Name of the second band.
const SIGMA_NAME: &str = "sigma of the height";

/// Writes a grid of heights.
///
/// # Errors
/// `Input` for a grid without cells, or with another number of values than cells; `Unsupported` for more than
/// 4 GB; `Io` when the file cannot be written; nothing is left half-written.
///
/// # Examples
/// ```
/// use planish_exchange::Unit;
/// use planish_exchange::geotiff::{HeightGrid, write_geotiff};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("ground.tif");
/// write_geotiff(&path, &HeightGrid {
///     corner: [600_000.0, 4_000_000.0],
///     cell: 0.5,
///     columns: 2,
///     rows: 1,
///     values: vec![[12.5, 0.1], [12.75, 0.1]],
///     unit: Unit::Metre,
///     georeference: None,
/// })?;
/// assert!(path.metadata()?.len() > 0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # References
/// - OGC 19-008r4, *GeoTIFF standard*, 2019.
/// - GDAL, *GTiff: GeoTIFF file format*, for tags 42112 and 42113.
pub fn write_geotiff(path: &Path, grid: &HeightGrid) -> Result<()> {
    if grid.values.is_empty() || grid.values.len() != grid.columns * grid.rows {
        return Err(Error::input(format!(
            "{}: expected {} × {} cells, found {}",
            path.display(),
            grid.columns,
            grid.rows,
            grid.values.len()
        )));
    }
    // In memory, because the encoder seeks back to complete its directory, which a pipe does not allow.
    let bytes = encoded(grid).map_err(|e| {
        Error::unsupported(format!(
            "{}: {} × {} cells do not fit into a TIFF file; use larger cells",
            path.display(),
            grid.columns,
            grid.rows
        ))
        .with_source(e)
    })?;
    write_atomically(path, |writer| writer.write_all(&bytes))
}

fn encoded(grid: &HeightGrid) -> std::result::Result<Vec<u8>, TiffError> {
    let mut file = Cursor::new(Vec::new());
    let mut encoder =
        TiffEncoder::new(&mut file)?.with_compression(Compression::Deflate(DeflateLevel::Balanced));
    let size = |n: usize| u32::try_from(n).map_err(|e| TiffError::IoError(io::Error::other(e)));
    let mut image = encoder.new_image::<HeightAndSigma>(size(grid.columns)?, size(grid.rows)?)?;
    let tags = image.encoder();
    // `BlackIsZero` describes one sample, so TIFF requires the second to be declared as extra.
    tags.write_tag(Tag::ExtraSamples, ExtraSamples::Unspecified.to_u16())?;
    tags.write_tag(Tag::ModelPixelScaleTag, &[grid.cell, grid.cell, 0.0][..])?;
    // Pixel (0, 0) is tied by its corner, because pixels are areas (`RASTER_TYPE` 1).
    let [west, north] = grid.corner;
    tags.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, west, north, 0.0][..])?;
    tags.write_tag(Tag::GdalNodata, format!("{NODATA}").as_str())?;
    tags.write_tag(GDAL_METADATA, metadata(grid.unit).as_str())?;
    let georeference = grid.georeference.as_ref();
    // The key that a pixel is an area is written even without a known projection: it shifts heights by half a
    // cell.
    let known = georeference.map_or(&[][..], |g| &g.keys);
    let mut keys: Vec<[u16; 4]> = known.iter().copied().filter(|k| k[0] != RASTER_TYPE).collect();
    keys.push([RASTER_TYPE, 0, 1, 1]);
    // The standard requires ascending keys.
    keys.sort_unstable();
    let mut directory = vec![1, 1, 0, keys.len() as u16];
    directory.extend(keys.iter().flatten());
    tags.write_tag(Tag::GeoKeyDirectoryTag, &directory[..])?;
    if let Some(georeference) = georeference {
        if !georeference.doubles.is_empty() {
            tags.write_tag(Tag::Unknown(DOUBLES_TAG), &georeference.doubles[..])?;
        }
        let text = String::from_utf8_lossy(&georeference.text);
        let text = text.trim_end_matches('\0');
        // The encoder rejects other texts, which would lose the heights for the sake of a name.
        if !text.is_empty() && text.is_ascii() {
            tags.write_tag(Tag::Unknown(TEXT_TAG), text)?;
        }
    }
    let samples: Vec<f32> = grid.values.iter().flatten().copied().collect();
    image.write_data(&samples)?;
    Ok(file.into_inner())
}

fn metadata(unit: Unit) -> String {
    let item = |name: &str, sample: u8, role: &str, value: &str| {
        let role = if role.is_empty() { String::new() } else { format!(" role=\"{role}\"") };
        format!("<Item name=\"{name}\" sample=\"{sample}\"{role}>{value}</Item>")
    };
    let unit = unit.name();
    format!(
        "<GDALMetadata>{}{}{}{}</GDALMetadata>",
        item("DESCRIPTION", 0, "description", "height"),
        item("UNITTYPE", 0, "unittype", unit),
        item("DESCRIPTION", 1, "description", SIGMA_NAME),
        item("UNITTYPE", 1, "unittype", unit),
    )
}
