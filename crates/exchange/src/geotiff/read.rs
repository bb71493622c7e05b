//! Reads height maps: TIFF images of heights that are tied to a map.
//!
//! **Input.** One band of heights, or two bands as [`write_geotiff`](super::write_geotiff) writes them. Cells
//! without a height have the value of `GDAL_NODATA`, or are not finite.
//!
//! **Output.** An organised scan with a point at the middle of each cell. With σ of the heights, points have
//! covariances: σ along z, and [`SIGMA_ACROSS_SHARE`] of it along x and y.
//!
//! **Limits.** Rows run from north to south and columns from west to east. Rotated maps, maps in degrees and
//! maps whose heights have another unit than their coordinates are not supported.
//!
//! # References
//! OGC 19-008r4, *GeoTIFF standard*, 2019, section 7; GDAL, *GTiff: GeoTIFF file format*.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_sense::{Scan, Viewing};
use roxmltree::Document;
use tiff::decoder::Decoder;
use tiff::decoder::ifd::Value;
use tiff::tags::Tag;
use tiff::{ColorType, TiffError};

use super::{GDAL_METADATA, SIGMA_NAME};
use crate::depth::{picture_budget, tags, take_pixels, tiff_error, tiff_limits, tiff_samples};
use crate::georeference::{DOUBLES_TAG, RASTER_TYPE, TEXT_TAG, is_geographic};
use crate::points::{PointCollector, PointColumns, grid_without};
use crate::source::{extension, open_file};
use crate::{GeoReference, Unit};

/// σ of a point along x and y, as a share of the σ of its height. The middle of a cell is exact, but
/// covariances must be positive definite. This share enlarges σ along the normal by less than 1 % on slopes
/// of up to 70°.
const SIGMA_ACROSS_SHARE: f64 = 0.05;
/// Memory of a sample while the image is decoded and converted.
const SAMPLE_BYTES: u64 = 2 * size_of::<f64>() as u64;
/// Tag of a rotated map (`ModelTransformationTag`).
const TRANSFORMATION: Tag = Tag::Unknown(34264);

type TiffFile = Decoder<BufReader<File>>;

/// A height map as a scan in the coordinates of the map.
#[derive(Debug, Clone)]
pub struct HeightScan {
    /// Points at the middle of each cell.
    pub scan: Scan,
    /// Unit of every length, if stated.
    pub unit: Option<Unit>,
    /// Map projection, if stated.
    pub georeference: Option<GeoReference>,
}

/// Tie of an image to a map.
struct Placement {
    /// Coordinates of the middle of the first cell.
    first: [f64; 2],
    /// Sides of a cell.
    cell: [f64; 2],
}

/// True for a TIFF image that is tied to a map. A file that cannot be read is not.
pub(crate) fn is_height_map(path: &Path) -> bool {
    let has = |mut decoder: TiffFile| {
        [Tag::ModelPixelScaleTag, TRANSFORMATION]
            .into_iter()
            .any(|tag| matches!(decoder.find_tag(tag), Ok(Some(_))))
    };
    matches!(extension(path).as_str(), "tif" | "tiff") && open(path).is_ok_and(|(decoder, _)| has(decoder))
}

fn open(path: &Path) -> Result<(TiffFile, Option<u64>)> {
    let (file, length) = open_file(path)?;
    let mut file = BufReader::new(file);
    // First, because the decoder reads tags when it is created, before `with_limits` can bound them.
    tags::check(&mut file)?;
    let decoder = Decoder::new(file).map_err(tiff_error)?.with_limits(tiff_limits(length));
    Ok((decoder, length))
}

/// Reads a height map.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable;
/// [`Input`](planish_estimate::ErrorKind::Input) when it is malformed, cut off, not tied to a map, or has a σ
/// that is not positive; [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for other bands, rotated
/// maps, maps in degrees, and heights in another unit than the map.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::Unit;
/// use planish_exchange::geotiff::{HeightGrid, read_geotiff, write_geotiff};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("ground.tif");
/// write_geotiff(&path, &HeightGrid {
///     corner: [600_000.0, 4_000_000.0],
///     cell: 0.5,
///     columns: 2,
///     rows: 1,
///     values: vec![[12.5, 0.25], [12.75, 0.25]],
///     unit: Unit::Metre,
///     georeference: None,
/// })?;
/// let found = read_geotiff(&path)?;
/// assert_eq!(found.scan.points[1], DVec3::new(600_000.75, 3_999_999.75, 12.75));
/// assert_eq!(found.scan.covariance.unwrap()[1].zz, 0.0625);
/// assert_eq!(found.unit, Some(Unit::Metre));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_geotiff(path: &Path) -> Result<HeightScan> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let read = || {
        let (decoder, length) = open(path)?;
        heights_of(decoder, length, &name)
    };
    read().map_err(|e: Error| e.in_context(path.display()))
}

fn heights_of(mut decoder: TiffFile, length: Option<u64>, name: &str) -> Result<HeightScan> {
    let (columns, rows) = decoder.dimensions().map_err(tiff_error)?;
    let colour = decoder.colortype().map_err(tiff_error)?;
    let metadata = text_of(&mut decoder, GDAL_METADATA)?;
    let descriptions = BandTexts::parse(&metadata)?;
    let bands = match colour {
        ColorType::Gray(_) => 1,
        ColorType::Multiband { num_samples: 2, .. } if descriptions.has_sigma => 2,
        other => {
            return Err(Error::unsupported(format!(
                "expected one band of heights, or two bands of which the second is named `{SIGMA_NAME}`, \
                 found {other:?}"
            )));
        }
    };
    // Samples of separate planes follow each other in another order.
    if bands > 1 && unsigned(&mut decoder, Tag::PlanarConfiguration)?.is_some_and(|planes| planes != 1) {
        return Err(Error::unsupported("expected interleaved bands, found separate planes"));
    }
    let budget = picture_budget(length);
    take_pixels(columns, rows, length, bands as u64 * SAMPLE_BYTES, &budget)?;
    let placement = placement(&mut decoder)?;
    let (georeference, unit) = map_of(&mut decoder, descriptions.unit)?;
    let nodata = text_of(&mut decoder, Tag::GdalNodata)?;
    let nodata: Option<f64> = nodata.trim_matches(['\0', ' ']).parse().ok();
    let samples = tiff_samples(decoder.read_image().map_err(tiff_error)?)?;
    let (columns, rows) = (columns as usize, rows as usize);
    if samples.is_empty() || samples.len() != columns * rows * bands {
        return Err(Error::input(format!(
            "expected {columns} × {rows} cells with {bands} values each, found {} values",
            samples.len()
        )));
    }
    let layout = match bands {
        1 => PointColumns::positions_only(),
        _ => PointColumns::find(&["x", "y", "z", "cxx", "cxy", "cxz", "cyy", "cyz", "czz"])?,
    };
    let mut collector = PointCollector::new(layout, samples.len() / bands, &budget);
    for (index, values) in samples.chunks_exact(bands).enumerate() {
        let (row, column) = (index / columns, index % columns);
        // Compared in single precision, too: files state the rounded value with more or fewer digits.
        let is_empty =
            |height: f64| nodata.is_some_and(|none| height == none || height as f32 == none as f32);
        let height = if is_empty(values[0]) { f64::NAN } else { values[0] };
        let sigma = values.get(1).copied().unwrap_or_default();
        let across = (SIGMA_ACROSS_SHARE * sigma).powi(2);
        let x = placement.first[0] + column as f64 * placement.cell[0];
        let y = placement.first[1] - row as f64 * placement.cell[1];
        // Squaring would make a negative σ positive.
        if height.is_finite() && bands > 1 && (sigma.is_nan() || sigma <= 0.0) {
            return Err(Error::input(format!(
                "column {column}, row {row}: expected σ > 0 of the height, found {sigma}"
            )));
        }
        let record = [x, y, height, across, 0.0, 0.0, across, 0.0, sigma * sigma];
        collector.push(&record, format_args!("column {column}, row {row}"))?;
    }
    let (mut scan, dropped) = collector.finish(name);
    scan.grid = Some(grid_without(columns, rows, &dropped));
    // Each cell has one height, so the surface is seen from above.
    scan.viewing = Viewing::Direction(-DVec3::Z);
    Ok(HeightScan { scan, unit, georeference })
}

/// Position and size of cells.
fn placement(decoder: &mut TiffFile) -> Result<Placement> {
    let (Some(scale), Some(tie)) =
        (doubles(decoder, Tag::ModelPixelScaleTag)?, doubles(decoder, Tag::ModelTiepointTag)?)
    else {
        return Err(Error::unsupported(
            "expected the size of cells and one tie point (ModelPixelScaleTag and ModelTiepointTag), found \
             another tie to the map: rotate the map to the north first",
        ));
    };
    let ([width, height, ..], [column, row, _, x, y, z]) = (&scale[..], &tie[..]) else {
        return Err(Error::unsupported(format!(
            "expected two sizes of a cell and one tie point of six numbers, found {} and {}",
            scale.len(),
            tie.len()
        )));
    };
    let finite = scale.iter().chain(&tie).all(|v| v.is_finite());
    if !finite || *width <= 0.0 || *height <= 0.0 || *z != 0.0 {
        return Err(Error::input(format!(
            "expected cells with sides > 0 and a tie point at height 0, found the sides {width} and {height} \
             and the height {z}"
        )));
    }
    let keys = words(decoder, Tag::GeoKeyDirectoryTag)?;
    let is_point = keys.chunks_exact(4).skip(1).any(|k| k[0] == RASTER_TYPE && k[3] == 2);
    // The tie point of areas is a corner of a pixel, that of points its middle.
    let middle = if is_point { 0.0 } else { 0.5 };
    let first = [x + (middle - column) * width, y - (middle - row) * height];
    Ok(Placement { first, cell: [*width, *height] })
}

/// Map projection and unit; `of_heights` is the unit that the metadata state for heights.
fn map_of(decoder: &mut TiffFile, of_heights: Option<Unit>) -> Result<(Option<GeoReference>, Option<Unit>)> {
    let keys = words(decoder, Tag::GeoKeyDirectoryTag)?;
    if is_geographic(&keys) {
        return Err(Error::unsupported(
            "expected a map in metres or feet, found longitudes and latitudes in degrees: project the map \
             first",
        ));
    }
    let bytes: Vec<u8> = keys.iter().flat_map(|w| w.to_le_bytes()).collect();
    let numbers = doubles(decoder, Tag::Unknown(DOUBLES_TAG))?.unwrap_or_default();
    let numbers: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
    let text = text_of(decoder, Tag::Unknown(TEXT_TAG))?;
    let georeference = GeoReference::from_keys(&bytes, &numbers, text.as_bytes()).map(|mut found| {
        // It describes pixels, not the map; the writer adds its own.
        found.keys.retain(|k| k[0] != RASTER_TYPE);
        found
    });
    let of_map = georeference.as_ref().and_then(GeoReference::unit);
    let of_heights = of_heights.or(georeference.as_ref().and_then(GeoReference::height_unit));
    match (of_map, of_heights) {
        (Some(map), Some(heights)) if map != heights => Err(Error::unsupported(format!(
            "expected heights in the unit of the map ({map}), found heights in {heights}: convert them"
        ))),
        (map, heights) => Ok((georeference, map.or(heights))),
    }
}

/// The parts of GDAL's metadata that are used.
#[derive(Default)]
struct BandTexts {
    /// Unit of the first band.
    unit: Option<Unit>,
    /// True if the second band is the σ of the first.
    has_sigma: bool,
}

impl BandTexts {
    fn parse(xml: &str) -> Result<Self> {
        let xml = xml.trim_matches(['\0', ' ', '\n']);
        if xml.is_empty() {
            return Ok(Self::default());
        }
        let document = Document::parse(xml)
            .map_err(|e| Error::input(format!("expected the metadata of GDAL as XML: {e}")))?;
        let item = |name: &str, band: &str| {
            let items = document.root_element().children().filter(|n| n.has_tag_name("Item"));
            let mut named =
                items.filter(|n| n.attribute("name") == Some(name) && n.attribute("sample") == Some(band));
            named.next().and_then(|n| n.text())
        };
        Ok(Self {
            // Other names of units are left to the user.
            unit: item("UNITTYPE", "0").and_then(|name| name.trim().parse().ok()),
            has_sigma: item("DESCRIPTION", "1").is_some_and(|text| text.trim() == SIGMA_NAME),
        })
    }
}

fn value(decoder: &mut TiffFile, tag: Tag) -> Result<Option<Value>> {
    decoder.find_tag(tag).map_err(tiff_error)
}

/// Fails for a tag of another type.
fn typed<T>(
    tag: Tag,
    value: Option<Value>,
    into: impl Fn(Value) -> std::result::Result<T, TiffError>,
) -> Result<Option<T>> {
    let damaged = |e| Error::input(format!("the tag {} is damaged", tag.to_u16())).with_source(e);
    value.map(into).transpose().map_err(damaged)
}

fn doubles(decoder: &mut TiffFile, tag: Tag) -> Result<Option<Vec<f64>>> {
    typed(tag, value(decoder, tag)?, Value::into_f64_vec)
}

fn words(decoder: &mut TiffFile, tag: Tag) -> Result<Vec<u16>> {
    typed(tag, value(decoder, tag)?, Value::into_u16_vec).map(Option::unwrap_or_default)
}

fn unsigned(decoder: &mut TiffFile, tag: Tag) -> Result<Option<u32>> {
    typed(tag, value(decoder, tag)?, Value::into_u32)
}

fn text_of(decoder: &mut TiffFile, tag: Tag) -> Result<String> {
    typed(tag, value(decoder, tag)?, Value::into_string).map(Option::unwrap_or_default)
}
