//! Checks the sizes declared by the tags of a TIFF image against the size of the file.
//!
//! **Input.** A file that can be rewound.
//!
//! **Output.** An error before anything is decoded, or success with the file rewound.
//!
//! **Limits.** The image may still fail to decode. Tags that cannot be interpreted here are left to the
//! decoder, which reports the reason.
//!
//! # References
//! Adobe, *TIFF Revision 6.0*, 1992, section 2 (image file directories); *BigTIFF*, 2007, which has counts
//! and offsets of eight bytes.

use std::io::{self, Read, Seek, SeekFrom};

use planish_estimate::{Error, Result};

use crate::numbers::NumberType;

/// Rejects tags with more values than the file has bytes, because the decoder allocates memory for them
/// before it reads them.
pub(crate) fn check<R: Read + Seek>(file: &mut R) -> Result<()> {
    let failed = |e: io::Error| Error::io("could not be read").with_source(e);
    let length = file.seek(SeekFrom::End(0)).map_err(failed)?;
    file.rewind().map_err(failed)?;
    // A file that ends inside its tags is reported by the decoder.
    let found = too_many(file, length).unwrap_or(None);
    file.rewind().map_err(failed)?;
    match found {
        Some((tag, count)) => Err(Error::input(format!(
            "the tag {tag} declares {count} values, but the file has {length} bytes: it is damaged or cut off"
        ))),
        None => Ok(()),
    }
}

/// Finds the first tag of the first image that has more values than the file has bytes.
fn too_many<R: Read + Seek>(file: &mut R, length: u64) -> io::Result<Option<(u64, u64)>> {
    let mut order = [0; 2];
    file.read_exact(&mut order)?;
    let big = order == *b"MM";
    let unsigned = |file: &mut R, number: NumberType| -> io::Result<u64> {
        let mut bytes = [0; 8];
        let bytes = &mut bytes[..number.size()];
        file.read_exact(bytes)?;
        // Values beyond 2⁵³ are rounded, which does not matter for a comparison with a file size.
        Ok(match big {
            true => number.decode::<true>(bytes),
            false => number.decode::<false>(bytes),
        } as u64)
    };
    // The version is 42 for TIFF and 43 for BigTIFF.
    let wide = unsigned(file, NumberType::U16)? == 43;
    let place = if wide { NumberType::U64 } else { NumberType::U32 };
    if wide {
        // Size of offsets (8) and a reserved word.
        file.seek(SeekFrom::Current(4))?;
    }
    let first = unsigned(file, place)?;
    file.seek(SeekFrom::Start(first))?;
    // A damaged number of tags needs no limit: reading beyond the end of the file fails and ends the loop.
    let tags = unsigned(file, if wide { NumberType::U64 } else { NumberType::U16 })?;
    for _ in 0..tags {
        let tag = unsigned(file, NumberType::U16)?;
        file.seek(SeekFrom::Current(2))?;
        let count = unsigned(file, place)?;
        file.seek(SeekFrom::Current(place.size() as i64))?;
        // A value takes at least one byte, so this holds for tags of any type.
        if count > length {
            return Ok(Some((tag, count)));
        }
    }
    Ok(None)
}
