//! Valid depth images and pictures.

use super::written;
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_exchange::geotiff::{HeightGrid, NODATA, write_geotiff};
use std::io::Cursor;

/// Depth images of 16 and 8 bits.
pub fn pngs() -> Result<Vec<Vec<u8>>> {
    let image = |depth, body: &[u8]| -> std::result::Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 4, 3);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(depth);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(body)?;
        writer.finish()?;
        Ok(bytes)
    };
    let failed = |e: png::EncodingError| Error::io("no PNG").with_source(e);
    // A few pixels: checks of headers come first, and small files are read quickly.
    let wide: Vec<u8> = (0..12_u16).flat_map(|k| (900 * k).to_be_bytes()).collect();
    let narrow: Vec<u8> = (0..12).collect();
    Ok(vec![
        image(png::BitDepth::Sixteen, &wide).map_err(failed)?,
        image(png::BitDepth::Eight, &narrow).map_err(failed)?,
    ])
}

/// Height maps with σ and without a cell.
pub fn geotiffs() -> Result<Vec<Vec<u8>>> {
    let grid = |values: Vec<[f32; 2]>| HeightGrid {
        corner: [600_000.0, 4_000_000.0],
        cell: 0.5,
        columns: values.len() / 2,
        rows: 2,
        values,
        unit: Unit::Metre,
        georeference: None,
    };
    let heights = |count: u16| (0..count).map(|k| [0.1 * f32::from(k % 7), 0.05]).collect();
    let with_gap = vec![[1.0, 0.1], [NODATA; 2], [2.0, 0.2], [3.0, 0.1]];
    [heights(12), with_gap]
        .map(|values| written(|path| write_geotiff(path, &grid(values)), "map.tif"))
        .into_iter()
        .collect()
}

/// Depth images of 16 bits and of floating point.
pub fn tiffs() -> Result<Vec<Vec<u8>>> {
    use tiff::encoder::{TiffEncoder, colortype};
    let failed = |e: tiff::TiffError| Error::io("no TIFF").with_source(e);
    let (mut wide, mut floating) = (Cursor::new(Vec::new()), Cursor::new(Vec::new()));
    let depths: Vec<u16> = (0..12).map(|k| 900 * k).collect();
    let mut encoder = TiffEncoder::new(&mut wide).map_err(failed)?;
    encoder.write_image::<colortype::Gray16>(4, 3, &depths).map_err(failed)?;
    let depths: Vec<f32> = depths.iter().map(|&d| f32::from(d) + 0.5).collect();
    let mut encoder = TiffEncoder::new(&mut floating).map_err(failed)?;
    encoder.write_image::<colortype::Gray32Float>(4, 3, &depths).map_err(failed)?;
    Ok(vec![wide.into_inner(), floating.into_inner()])
}

/// Grey and coloured JPEG images, one of them progressive.
pub fn jpegs() -> Result<Vec<Vec<u8>>> {
    Ok(vec![include_bytes!("../../data/grey.jpg").to_vec(), include_bytes!("../../data/colour.jpg").to_vec()])
}

/// Grey and coloured TGA images, uncompressed and run-length encoded.
pub fn tgas() -> Result<Vec<Vec<u8>>> {
    let header =
        |kind: u8, bits: u8| [0, 0, kind, 0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 0, 3, 0, bits, 0x20].to_vec();
    let mut grey = header(3, 8);
    grey.extend(0..12);
    let mut colour = header(2, 24);
    colour.extend(0..36);
    let mut runs = header(10, 24);
    // A run of six equal pixels, then six literal ones.
    runs.extend([0x85, 1, 2, 3, 0x05]);
    runs.extend(0..18);
    Ok(vec![grey, colour, runs])
}

/// Grey and coloured images of the Netpbm family, in text and in binary.
pub fn pgms() -> Result<Vec<Vec<u8>>> {
    // Comments are permitted between the numbers of a header.
    let mut bytes = b"P5\n# a comment\n4 3\n255\n".to_vec();
    bytes.extend(0..12);
    let mut wide = b"P6 2 2 65535\n".to_vec();
    wide.extend(0..24);
    Ok(vec![bytes, wide, b"P2\n2 2 255\n0 1 2 255\n".to_vec()])
}
