//! Decodes the streams of PDF files.
//!
//! # References
//! ISO 32000-1:2008, section 7.4 (filters); PNG specification, section 9 (predictors).

use super::syntax::{Dictionary, Object, bytes_of_hexadecimal, is_space};
use flate2::read::ZlibDecoder;
use planish_estimate::{Error, Result};
use std::io::Read;

/// Decodes a stream whose filters are known; `limit` bounds its size.
pub(super) fn decoded(raw: &[u8], filters: &[(String, Dictionary)], limit: u64) -> Result<Vec<u8>> {
    let mut bytes = raw.to_vec();
    for (name, options) in filters {
        bytes = match name.as_str() {
            "FlateDecode" | "Fl" => without_predictor(inflated(&bytes, limit)?, options)?,
            "ASCII85Decode" | "A85" => ascii85(&bytes)?,
            "ASCIIHexDecode" | "AHx" => {
                bytes_of_hexadecimal(bytes.split(|b| *b == b'>').next().unwrap_or_default())
            }
            "RunLengthDecode" | "RL" => run_length(&bytes, limit)?,
            other => {
                return Err(Error::unsupported(format!(
                    "expected content with the filters FlateDecode, ASCII85Decode, ASCIIHexDecode or \
                     RunLengthDecode, found {other}"
                )));
            }
        };
    }
    Ok(bytes)
}

fn too_large(limit: u64) -> Error {
    Error::input(format!(
        "the streams unpack to more than {limit} bytes, which is out of proportion to the file: it may be \
         damaged"
    ))
}

fn inflated(bytes: &[u8], limit: u64) -> Result<Vec<u8>> {
    let mut decoded = Vec::new();
    let result = ZlibDecoder::new(bytes).take(limit + 1).read_to_end(&mut decoded);
    if decoded.len() as u64 > limit {
        return Err(too_large(limit));
    }
    result.map_err(|e| Error::input("a compressed stream is damaged or cut off").with_source(e))?;
    Ok(decoded)
}

/// Undoes the differences between rows, which only streams of references use.
fn without_predictor(bytes: Vec<u8>, options: &Dictionary) -> Result<Vec<u8>> {
    let option = |key: &str, default: f64| options.get(key).and_then(Object::number).unwrap_or(default);
    let predictor = option("Predictor", 1.0);
    if predictor < 2.0 {
        return Ok(bytes);
    }
    let [colors, bits, columns] =
        [("Colors", 1.0), ("BitsPerComponent", 8.0), ("Columns", 1.0)].map(|(key, d)| option(key, d));
    let row = colors * columns;
    if predictor < 10.0 || bits != 8.0 || !(1.0..1e6).contains(&row) {
        return Err(Error::unsupported(format!(
            "expected a stream with PNG predictors of 8 bits, found predictor {predictor} of {bits} bits"
        )));
    }
    let (row, pixel) = (row as usize, colors as usize);
    let mut decoded: Vec<u8> = Vec::with_capacity(bytes.len());
    let mut above = vec![0_u8; row];
    for line in bytes.chunks(row + 1) {
        let mut own = vec![0_u8; row];
        for (k, byte) in line[1..].iter().enumerate() {
            let left = if k >= pixel { own[k - pixel] } else { 0 };
            let corner = if k >= pixel { above[k - pixel] } else { 0 };
            own[k] = byte.wrapping_add(match line[0] {
                1 => left,
                2 => above[k],
                3 => ((u16::from(left) + u16::from(above[k])) / 2) as u8,
                4 => paeth(left, above[k], corner),
                _ => 0,
            });
        }
        decoded.extend(&own[..line.len() - 1]);
        above = own;
    }
    Ok(decoded)
}

fn paeth(left: u8, above: u8, corner: u8) -> u8 {
    let [a, b, c] = [left, above, corner].map(i16::from);
    let p = a + b - c;
    match [a, b, c].map(|v| (p - v).abs()) {
        [pa, pb, pc] if pa <= pb && pa <= pc => left,
        [_, pb, pc] if pb <= pc => above,
        _ => corner,
    }
}

fn ascii85(text: &[u8]) -> Result<Vec<u8>> {
    let wrong = || Error::input("an ASCII85 stream is damaged");
    let mut bytes = Vec::new();
    let mut group: Vec<u8> = Vec::new();
    let flush = |group: &mut Vec<u8>, bytes: &mut Vec<u8>| {
        let count = group.len();
        group.resize(5, 84);
        let value = group.iter().fold(0_u64, |sum, digit| 85 * sum + u64::from(*digit));
        group.clear();
        let value = u32::try_from(value).map_err(|_| wrong())?;
        bytes.extend(&value.to_be_bytes()[..count - 1]);
        Ok::<(), Error>(())
    };
    for &byte in text.strip_prefix(b"<~").unwrap_or(text) {
        match byte {
            b'~' => break,
            b'z' if group.is_empty() => bytes.extend([0; 4]),
            b'!'..=b'u' => {
                group.push(byte - b'!');
                if group.len() == 5 {
                    flush(&mut group, &mut bytes)?;
                }
            }
            byte if is_space(byte) => {}
            _ => return Err(wrong()),
        }
    }
    if group.len() > 1 {
        flush(&mut group, &mut bytes)?;
    }
    Ok(bytes)
}

fn run_length(mut left: &[u8], limit: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    while let Some((&length, rest)) = left.split_first() {
        let length = usize::from(length);
        match length {
            128 => break,
            0..128 => {
                let count = (length + 1).min(rest.len());
                bytes.extend(&rest[..count]);
                left = &rest[count..];
            }
            _ => {
                let Some((&byte, after)) = rest.split_first() else { break };
                bytes.resize(bytes.len() + 257 - length, byte);
                left = after;
            }
        }
        if bytes.len() as u64 > limit {
            return Err(too_large(limit));
        }
    }
    Ok(bytes)
}
