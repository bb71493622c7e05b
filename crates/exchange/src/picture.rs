//! Reads pictures (PNG, TIFF, JPEG, TGA, PGM, PPM) and writes PNG.
//!
//! **Input.** A picture with one channel or colours, 8 or 16 bits (TIFF also in floating point).
//!
//! **Output.** A [`Picture`] with one or three channels, or the brightness alone as an [`Image`]. Opacity is
//! ignored.
//!
//! **Limits.** Values are those of the file. They are not linear in brightness if a camera or program applied
//! a gamma curve.
//!
//! # References
//! - ITU-R BT.601, for the brightness of colours: 0.299 R + 0.587 G + 0.114 B.
//! - Truevision, *TGA file format specification 2.0*, 1991: types 2, 3, 10 and 11.
//! - Poskanzer, *Netpbm*: P2, P3, P5 and P6.

use std::io::{self, BufReader, Cursor, Write};
use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::Image;
use tiff::decoder::{Decoder as TiffDecoder, DecodingResult};
use tiff::{ColorType as TiffColor, TiffError};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::appearance::is_jpeg;
use crate::depth::{picture_budget, tags, take_pixels, tiff_limits};
use crate::foreign::guarded;
use crate::source::{extension, read_limited};
use crate::write_atomically;

/// Maximum number of pixels along a side of a JPEG picture, which bounds the memory of the decoder. The
/// format itself has 16 bits per side.
const MAX_SIDE: usize = 1 << 16;

/// Maximum size of a picture file that is a pipe or a device, which may be endless.
const MAX_PICTURE_BYTES: u64 = 256 << 20;

/// A picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Number of columns.
    pub columns: usize,
    /// Number of rows.
    pub rows: usize,
    /// 1 (brightness) or 3 (red, green, blue).
    pub channels: usize,
    /// Values of the file, pixel by pixel and row by row from the top.
    pub values: Vec<f32>,
    /// Value of white: 255 or 65535, or 1 for floating-point numbers.
    pub white: f32,
}

impl Picture {
    /// Computes the brightness of every pixel (ITU-R BT.601).
    ///
    /// # Errors
    /// As [`Image::try_new`].
    ///
    /// # Examples
    /// ```
    /// use planish_exchange::picture::Picture;
    /// let red = Picture { columns: 1, rows: 1, channels: 3, values: vec![100.0, 0.0, 0.0], white: 255.0 };
    /// assert!((red.brightness()?.values[0] - 29.9).abs() < 1e-4);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn brightness(&self) -> Result<Image> {
        let values = match self.channels {
            3 => {
                let pixels = self.values.chunks_exact(3);
                pixels.map(|p| 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2]).collect()
            }
            _ => self.values.clone(),
        };
        Image::try_new(self.columns, self.rows, values)
    }

    /// Computes the brightness of every pixel under a light of unit strength: each channel is divided by the
    /// `intensity` of the light in red, green and blue. Pixels with a channel of `saturation` or more are
    /// NaN.
    ///
    /// # Errors
    /// As [`Image::try_new`].
    pub fn brightness_under(&self, intensity: [f64; 3], saturation: f32) -> Result<Image> {
        let [red, green, blue] = intensity.map(|i| i as f32);
        let grey = 0.299 * red + 0.587 * green + 0.114 * blue;
        let of_pixel = |p: &[f32]| match *p {
            _ if p.iter().any(|c| *c >= saturation) => f32::NAN,
            [r, g, b] => 0.299 * r / red + 0.587 * g / green + 0.114 * b / blue,
            _ => p[0] / grey,
        };
        let values = self.values.chunks_exact(self.channels).map(of_pixel).collect();
        Image::try_new(self.columns, self.rows, values)
    }
}

/// The value from which readings of pictures of one camera are saturated; infinite if none are.
///
/// Integers are saturated near white. Any camera is saturated where its largest value, below white, occurs
/// more often than the 2 % of the scale below it, because clipping collects all that is brighter.
#[must_use]
pub fn saturation_of(pictures: &[Picture]) -> f32 {
    /// Share of white from which integers count as saturated: compression blurs clipped areas by some levels.
    const NEAR_WHITE: f32 = 0.985;
    /// Width of the levels that are compared, as shares of the largest value.
    const TOP: f32 = 0.999;
    const BELOW: f32 = 0.98;
    /// Fewer readings at the largest value are chance.
    const MIN_CLIPPED: usize = 16;
    /// Fewer different values are those of a rendered flat object, not of a camera.
    const MIN_LEVELS: usize = 64;
    let values = || pictures.iter().flat_map(|p| &p.values).copied();
    let largest = values().fold(0.0, f32::max);
    let near_white = pictures.iter().map(|p| p.white).fold(0.0, f32::max);
    // Numbers in floating point have no largest value.
    let level = if near_white > 1.0 { NEAR_WHITE * near_white } else { f32::INFINITY };
    let clipped = values().filter(|v| *v >= TOP * largest).count();
    let below = values().filter(|v| (BELOW * largest..TOP * largest).contains(v)).count();
    if clipped < MIN_CLIPPED || clipped <= below {
        return level;
    }
    let levels: std::collections::BTreeSet<u32> = values().map(f32::to_bits).take(1 << 20).collect();
    if levels.len() < MIN_LEVELS { level } else { level.min(NEAR_WHITE * largest) }
}

/// Reads the brightness of a picture.
///
/// # Errors
/// As [`read_picture`].
pub fn read_brightness(path: &Path) -> Result<Image> {
    read_picture(path)?.brightness().map_err(|e| e.in_context(path.display()))
}

/// Reads a picture; the extension selects the format.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable;
/// [`Input`](planish_estimate::ErrorKind::Input) when it is malformed or cut off;
/// [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for other formats and kinds of pixels. Each
/// error names the file.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("grey.pgm");
/// std::fs::write(&path, "P2 2 1 255 0 128")?;
/// let picture = planish_exchange::picture::read_picture(&path)?;
/// assert_eq!((picture.columns, picture.channels, picture.values), (2, 1, vec![0.0, 128.0]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_picture(path: &Path) -> Result<Picture> {
    let read = || {
        let bytes = || read_limited(path, MAX_PICTURE_BYTES, "a picture");
        let picture = match extension(path).as_str() {
            "png" => png(&bytes()?)?,
            "tif" | "tiff" => tiff(&bytes()?)?,
            "jpg" | "jpeg" => jpeg(&bytes()?)?,
            "tga" => tga(&bytes()?)?,
            "pgm" | "ppm" | "pnm" => netpbm(&bytes()?)?,
            other => {
                return Err(Error::unsupported(format!(
                    "expected an image (.png, .tif, .jpg, .tga, .pgm or .ppm), found the extension \
                     `{other}`"
                )));
            }
        };
        complete(picture)
    };
    read().map_err(|e: Error| e.in_context(path.display()))
}

/// Reads a PNG or JPEG picture from its bytes, for example those of a texture inside another file.
///
/// # Errors
/// As [`read_picture`], without a name.
///
/// # Examples
/// ```
/// use planish_exchange::picture::{colour_png, decode_picture};
/// let picture = decode_picture(&colour_png([1, 1], &[255, 0, 0])?)?;
/// assert_eq!(picture.values, [255.0, 0.0, 0.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn decode_picture(bytes: &[u8]) -> Result<Picture> {
    complete(if is_jpeg(bytes) { jpeg(bytes)? } else { png(bytes)? })
}

/// The picture, if it has all of its pixels.
fn complete(picture: Picture) -> Result<Picture> {
    match picture.values.len() == picture.columns * picture.rows * picture.channels
        && !picture.values.is_empty()
    {
        true => Ok(picture),
        false => Err(Error::input(format!(
            "expected {} × {} pixels, found {} values: the file is damaged or cut off",
            picture.columns,
            picture.rows,
            picture.values.len()
        ))),
    }
}

/// Writes brightness from 0 to 255, row by row, as a grey PNG with 8 bits.
///
/// # Errors
/// `Input` for another number of values than pixels; `Io` when the file cannot be written; nothing is left
/// half-written.
///
/// # Examples
/// ```
/// use planish_exchange::picture::{read_picture, write_grey_png};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("grey.png");
/// write_grey_png(&path, 3, 1, &[0, 128, 255])?;
/// assert_eq!(read_picture(&path)?.values, [0.0, 128.0, 255.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_grey_png(path: &Path, columns: usize, rows: usize, values: &[u8]) -> Result<()> {
    write_png(path, [columns, rows], png::ColorType::Grayscale, values)
}

/// Writes red, green and blue from 0 to 255, row by row, as a PNG with 8 bits per channel. `size` is columns
/// and rows.
///
/// # Errors
/// As [`write_grey_png`].
pub fn write_colour_png(path: &Path, size: [usize; 2], values: &[u8]) -> Result<()> {
    write_png(path, size, png::ColorType::Rgb, values)
}

fn write_png(path: &Path, [columns, rows]: [usize; 2], kind: png::ColorType, values: &[u8]) -> Result<()> {
    let wanted = columns.checked_mul(rows).and_then(|pixels| pixels.checked_mul(kind.samples()));
    let size = u32::try_from(columns).ok().zip(u32::try_from(rows).ok());
    let Some((width, height)) = size.filter(|_| wanted == Some(values.len()) && !values.is_empty()) else {
        return Err(Error::input(format!(
            "{}: expected {columns} × {rows} pixels, found {} values",
            path.display(),
            values.len()
        )));
    };
    write_atomically(path, |writer| encode_png(writer, [width, height], kind, values))
}

fn encode_png(
    writer: impl Write,
    [width, height]: [u32; 2],
    kind: png::ColorType,
    values: &[u8],
) -> io::Result<()> {
    let mut encoder = png::Encoder::new(writer, width, height);
    // No chunks of time or text are added, so that the same values give the same bytes.
    encoder.set_color(kind);
    let mut out = encoder.write_header()?;
    out.write_image_data(values)?;
    Ok(out.finish()?)
}

/// Encodes red, green and blue from 0 to 255 as a PNG, for embedding into another file. `size` is columns and
/// rows.
///
/// # Errors
/// `Input` for another number of values than pixels.
///
/// # Examples
/// ```
/// let bytes = planish_exchange::picture::colour_png([1, 1], &[255, 0, 0])?;
/// assert!(bytes.starts_with(b"\x89PNG"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn colour_png(size: [usize; 2], values: &[u8]) -> Result<Vec<u8>> {
    let [columns, rows] = size;
    let sides = u32::try_from(columns).ok().zip(u32::try_from(rows).ok());
    let Some((width, height)) = sides.filter(|_| 3 * columns * rows == values.len() && !values.is_empty())
    else {
        return Err(Error::input(format!(
            "expected {columns} × {rows} pixels of three values, found {} values",
            values.len()
        )));
    };
    let mut bytes = Vec::new();
    encode_png(&mut bytes, [width, height], png::ColorType::Rgb, values)
        .map_err(|e| Error::io("the image could not be encoded").with_source(e))?;
    Ok(bytes)
}

/// Memory of a pixel with so many samples in bytes; opacity is removed from a copy.
fn pixel_bytes(samples: usize) -> u64 {
    let kept = if samples < 3 { 1 } else { 3 };
    let copied = if samples == kept { 0 } else { kept };
    ((samples + copied) * size_of::<f32>()) as u64
}

/// Builds a picture from one or three of the samples of each pixel; opacity, which follows them, is removed.
fn channels(columns: usize, rows: usize, samples: usize, values: Vec<f32>, white: f32) -> Picture {
    let channels = if samples < 3 { 1 } else { 3 };
    let values = match samples == channels {
        true => values,
        false => values.chunks_exact(samples).flat_map(|p| p[..channels].iter().copied()).collect(),
    };
    Picture { columns, rows, channels, values, white }
}

fn png(bytes: &[u8]) -> Result<Picture> {
    let damaged =
        |e: png::DecodingError| Error::input("not a PNG image, or damaged or cut off").with_source(e);
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    // Expands palettes, and grey levels of fewer than 8 bits, to 8 bits.
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let (columns, rows) = (reader.info().width, reader.info().height);
    let (colour, depth) = reader.output_color_type();
    let length = Some(bytes.len() as u64);
    take_pixels(columns, rows, length, pixel_bytes(colour.samples()), &picture_budget(length))?;
    // Rows of an interlaced image arrive in seven passes of partial rows, which the loop below would
    // misplace.
    if reader.info().interlaced {
        return Err(Error::unsupported("the PNG image is interlaced: save it without interlacing"));
    }
    let mut values = Vec::new();
    while let Some(row) = reader.next_row().map_err(damaged)? {
        match depth {
            png::BitDepth::Sixteen => {
                values
                    .extend(row.data().chunks_exact(2).map(|b| f32::from(u16::from_be_bytes([b[0], b[1]]))));
            }
            _ => values.extend(row.data().iter().map(|&b| f32::from(b))),
        }
    }
    let white = if depth == png::BitDepth::Sixteen { 65535.0 } else { 255.0 };
    Ok(channels(columns as usize, rows as usize, colour.samples(), values, white))
}

fn tiff(bytes: &[u8]) -> Result<Picture> {
    let length = Some(bytes.len() as u64);
    let damaged = |e: TiffError| match e {
        TiffError::UnsupportedError(_) => {
            Error::unsupported("this kind of TIFF image is not supported").with_source(e)
        }
        e => Error::input("not a TIFF image, or damaged or cut off").with_source(e),
    };
    let mut file = Cursor::new(bytes);
    tags::check(&mut file)?;
    let mut decoder =
        TiffDecoder::new(BufReader::new(file)).map_err(damaged)?.with_limits(tiff_limits(length));
    let (columns, rows) = decoder.dimensions().map_err(damaged)?;
    // Only the first one or three samples are used; the others are opacity or further bands.
    let samples = match decoder.colortype().map_err(damaged)? {
        TiffColor::Gray(_) => 1,
        TiffColor::GrayA(_) => 2,
        TiffColor::RGB(_) => 3,
        TiffColor::RGBA(_) => 4,
        TiffColor::Multiband { num_samples, .. } if num_samples > 0 => usize::from(num_samples),
        other => {
            return Err(Error::unsupported(format!("expected a grey or colour image, found {other:?}")));
        }
    };
    // The decoded values have up to eight bytes and are converted afterwards.
    let bytes = pixel_bytes(samples) + 8 * samples as u64;
    take_pixels(columns, rows, length, bytes, &picture_budget(length))?;
    let (values, white): (Vec<f32>, f32) = match decoder.read_image().map_err(damaged)? {
        DecodingResult::U8(v) => (v.into_iter().map(f32::from).collect(), 255.0),
        DecodingResult::U16(v) => (v.into_iter().map(f32::from).collect(), 65535.0),
        DecodingResult::F32(v) => (v, 1.0),
        DecodingResult::F64(v) => (v.into_iter().map(|v| v as f32).collect(), 1.0),
        _ => {
            return Err(Error::unsupported("expected values of 8 or 16 bits, or floating-point numbers"));
        }
    };
    Ok(channels(columns as usize, rows as usize, samples, values, white))
}

fn jpeg(bytes: &[u8]) -> Result<Picture> {
    guarded(|| {
        let damaged = |e| Error::input(format!("not a JPEG image, or damaged or cut off ({e:?})"));
        // Strict mode reports damaged data instead of decoding around them.
        let options =
            DecoderOptions::default().set_strict_mode(true).set_max_width(MAX_SIDE).set_max_height(MAX_SIDE);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
        decoder.decode_headers().map_err(damaged)?;
        let (columns, rows) = decoder.dimensions().unwrap_or_default();
        // Checked between header and data, before the decoder allocates the image.
        let grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
        let (samples, length) = (if grey { 1 } else { 3 }, Some(bytes.len() as u64));
        let per_pixel = pixel_bytes(samples) + samples as u64;
        take_pixels(columns as u32, rows as u32, length, per_pixel, &picture_budget(length))?;
        let wanted = if grey { ColorSpace::Luma } else { ColorSpace::RGB };
        // Only now, because the headers decide; a grey picture expanded to RGB would take three times the
        // memory.
        decoder.set_options(options.jpeg_set_out_colorspace(wanted));
        let values = decoder.decode().map_err(damaged)?.into_iter().map(f32::from).collect();
        Ok(channels(columns, rows, if grey { 1 } else { 3 }, values, 255.0))
    })?
}

fn tga(bytes: &[u8]) -> Result<Picture> {
    let damaged = || Error::input("not a TGA image, or cut off");
    let head = bytes.get(..18).ok_or_else(damaged)?;
    let (kind, bits) = (head[2], head[16]);
    let side = |k: usize| usize::from(u16::from_le_bytes([head[k], head[k + 1]]));
    let (columns, rows) = (side(12), side(14));
    let samples = usize::from(bits / 8);
    // Types 9 to 11 are the run-length encoded forms of 1 to 3.
    let grey = matches!(kind, 3 | 11);
    // Byte 1 announces a colour map, which would lie between the header and the pixels.
    if !matches!((kind, bits), (2 | 10, 24 | 32) | (3 | 11, 8)) || head[1] != 0 {
        return Err(Error::unsupported(format!(
            "expected a TGA image with 24 or 32 bits of colour or 8 bits of grey, found type {kind} with \
             {bits} bits"
        )));
    }
    // Byte 0 is the length of a free text between the header and the pixels.
    let mut body = bytes.get(18 + usize::from(head[0])..).ok_or_else(damaged)?;
    // Sides have 16 bits and pixels at most four bytes, so the product cannot overflow.
    let size = columns * rows * samples;
    // A run-length packet of at least two bytes stands for at most 128 pixels.
    if columns * rows > body.len().saturating_mul(128) {
        return Err(damaged());
    }
    let (length, per_pixel) = (Some(bytes.len() as u64), pixel_bytes(samples) + samples as u64);
    take_pixels(columns as u32, rows as u32, length, per_pixel, &picture_budget(length))?;
    let mut unpacked = Vec::with_capacity(size);
    if kind < 9 {
        unpacked.extend_from_slice(body.get(..size).ok_or_else(damaged)?);
    }
    // Run-length packets: bit 7 of the first byte marks a repeated pixel, the other bits are the count less
    // one.
    while unpacked.len() < size {
        let (&head, rest) = body.split_first().ok_or_else(damaged)?;
        let count = usize::from(head & 0x7f) + 1;
        let stored = if head & 0x80 == 0 { count } else { 1 };
        let pixels = rest.get(..stored * samples).ok_or_else(damaged)?;
        (0..count / stored).for_each(|_| unpacked.extend_from_slice(pixels));
        body = &rest[stored * samples..];
    }
    // The last packet may reach beyond the picture.
    unpacked.truncate(size);
    // Colours are stored as blue, green, red. Rows run from the bottom unless bit 5 of the descriptor is set,
    // and from right to left if bit 4 is set.
    let (downwards, backwards) = (head[17] & 0x20 != 0, head[17] & 0x10 != 0);
    let mut values = Vec::with_capacity(size);
    for y in 0..rows {
        let y = if downwards { y } else { rows - 1 - y };
        for x in 0..columns {
            let x = if backwards { columns - 1 - x } else { x };
            let pixel = &unpacked[(y * columns + x) * samples..][..samples];
            match grey {
                true => values.push(f32::from(pixel[0])),
                false => values.extend([pixel[2], pixel[1], pixel[0]].map(f32::from)),
            }
        }
    }
    Ok(channels(columns, rows, if grey { 1 } else { 3 }, values, 255.0))
}

fn netpbm(bytes: &[u8]) -> Result<Picture> {
    let damaged = || Error::input("not a PGM or PPM image (P2, P3, P5 or P6), or cut off");
    let mut at = 0;
    let mut word = || -> Result<&[u8]> {
        loop {
            match bytes.get(at).ok_or_else(damaged)? {
                b'#' => at += bytes[at..].iter().take_while(|b| **b != b'\n').count(),
                b if b.is_ascii_whitespace() => at += 1,
                _ => break,
            }
        }
        let length = bytes[at..].iter().take_while(|b| !b.is_ascii_whitespace()).count();
        at += length;
        Ok(&bytes[at - length..at])
    };
    let kind = word()?.to_vec();
    let mut number = || -> Result<usize> {
        let text = std::str::from_utf8(word()?).map_err(|_| damaged())?;
        text.parse().map_err(|_| damaged())
    };
    let samples = match &kind[..] {
        b"P2" | b"P5" => 1,
        b"P3" | b"P6" => 3,
        _ => return Err(damaged()),
    };
    let (columns, rows, white) = (number()?, number()?, number()?);
    // Each value takes at least one byte, which bounds the size before memory is allocated.
    let size = columns.checked_mul(rows).and_then(|n| n.checked_mul(samples)).filter(|n| *n <= bytes.len());
    let size = size.ok_or_else(damaged)?;
    if !(1..=65535).contains(&white) {
        return Err(Error::input(format!("expected a maximum value from 1 to 65535, found {white}")));
    }
    let values = match kind[1] {
        b'2' | b'3' => (0..size).map(|_| Ok(number()? as f32)).collect::<Result<_>>()?,
        _ => {
            // One white-space byte separates the header from the binary values.
            let body = bytes.get(at + 1..).ok_or_else(damaged)?;
            let width = if white > 255 { 2 } else { 1 };
            let body = body.get(..size * width).ok_or_else(damaged)?;
            // Netpbm stores the more significant byte first.
            let value = |b: &[u8]| b.iter().fold(0_u16, |v, b| (v << 8) | u16::from(*b));
            body.chunks_exact(width).map(|b| f32::from(value(b))).collect()
        }
    };
    Ok(channels(columns, rows, samples, values, white as f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn tga_bytes(kind: u8, body: &[u8], descriptor: u8) -> Vec<u8> {
        let mut bytes = vec![0, 0, kind, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0, 2, 0, 24, descriptor];
        bytes.extend_from_slice(body);
        bytes
    }

    #[test]
    fn every_format_gives_the_same_picture() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let rgb: Vec<u8> = (0..18).map(|k| 10 * k).collect();
        fs::write(at("a.ppm"), [b"P6 # a comment\n3 2\n255\n".as_slice(), &rgb].concat()).unwrap();
        let text: String = rgb.iter().map(|v| format!("{v} ")).collect();
        fs::write(at("b.ppm"), format!("P3 3 2 255 {text}")).unwrap();
        let mut png = Vec::new();
        let mut encoder = png::Encoder::new(&mut png, 3, 2);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().unwrap().write_image_data(&rgb).unwrap();
        fs::write(at("c.png"), &png).unwrap();
        let mut file = Cursor::new(Vec::new());
        let mut encoder = tiff::encoder::TiffEncoder::new(&mut file).unwrap();
        encoder.write_image::<tiff::encoder::colortype::RGB8>(3, 2, &rgb).unwrap();
        fs::write(at("d.tif"), file.into_inner()).unwrap();
        let bgr = |row: &[u8]| row.chunks(3).flat_map(|p| [p[2], p[1], p[0]]).collect::<Vec<u8>>();
        let upwards = [bgr(&rgb[9..]), bgr(&rgb[..9])].concat();
        fs::write(at("e.tga"), tga_bytes(2, &upwards, 0)).unwrap();
        let packed = [vec![2], bgr(&rgb[..9]), vec![2], bgr(&rgb[9..])].concat();
        fs::write(at("f.tga"), tga_bytes(10, &packed, 0x20)).unwrap();
        let first = read_picture(&at("a.ppm")).unwrap();
        assert_eq!((first.columns, first.rows, first.channels), (3, 2, 3));
        assert_eq!(first.values[..3], [0.0, 10.0, 20.0]);
        for name in ["b.ppm", "c.png", "d.tif", "e.tga", "f.tga"] {
            assert_eq!(read_picture(&at(name)).unwrap(), first, "{name}");
        }
        assert!((read_brightness(&at("a.ppm")).unwrap().values[0] - 8.15).abs() < 1e-4);
        // A repeated pixel.
        fs::write(at("g.tga"), tga_bytes(10, &[0x85, 1, 2, 3], 0x20)).unwrap();
        assert_eq!(read_picture(&at("g.tga")).unwrap().values, [3.0, 2.0, 1.0].repeat(6));
    }

    #[test]
    fn errors_of_damaged_pictures_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes, words) in [
            ("a.tga", tga_bytes(10, &[0x85, 1], 0), "cut off"),
            ("b.tga", tga_bytes(1, &[0; 40], 0), "found type 1"),
            ("c.pgm", b"P5 99999999 99999999 255 a".to_vec(), "cut off"),
            ("d.pgm", b"P7 1 1 255 a".to_vec(), "not a PGM"),
            ("e.jpg", b"\xff\xd8\xff\xe0 nothing".to_vec(), "JPEG"),
            ("f.png", b"nothing".to_vec(), "not a PNG"),
            ("g.bmp", b"BM".to_vec(), "extension `bmp`"),
        ] {
            let path = folder.path().join(name);
            fs::write(&path, bytes).unwrap();
            let e = read_picture(&path).unwrap_err().to_string();
            assert!(e.contains(name) && e.contains(words), "{e}");
        }
    }
}
