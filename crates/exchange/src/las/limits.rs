//! Checks the sizes declared by a LAS or LAZ file against the size of the file.
//!
//! **Input.** A file that can be rewound.
//!
//! **Output.** An error before anything is decoded, or success with the file rewound. Every number that makes
//! the decoder allocate memory is checked: metadata records, points, chunks, and the layers of each chunk.
//!
//! **Limits.** The file may still fail to decode. A header that cannot be interpreted here is left to the
//! decoder, which reports the reason.
//!
//! # References
//! ASPRS, *LAS Specification 1.4-R15*, 2019; M. Isenburg, *LASzip: lossless compression of LiDAR data*, 2013.

use std::io::{Read, Seek, SeekFrom};

use las::raw;
use laz::laszip::{ChunkTable, LazItem, LazItemType, LazVlr};
use planish_estimate::{Error, Result};

use crate::foreign::guarded;
use crate::source::check_expansion;

/// Maximum size of a point record. The decoder allocates several kilobytes of tables per extra byte of a
/// record; the largest standard format has 67 bytes.
const MAX_RECORD_BYTES: u64 = 4096;
/// Size of the header of an extended variable-length record.
const EXTENDED_HEADER_BYTES: u64 = 60;
/// First two bytes of a LASzip description with which all points form one chunk without a table.
pub(super) const ONE_CHUNK: [u8; 2] = [1, 0];

/// Rejects a file that declares more data than it can hold.
pub(super) fn check<R: Read + Seek>(file: &mut R) -> Result<()> {
    let failed = |e: std::io::Error| Error::io("could not be read").with_source(e);
    let length = file.seek(SeekFrom::End(0)).map_err(failed)?;
    file.rewind().map_err(failed)?;
    let checked = check_from_start(file, length);
    file.rewind().map_err(failed)?;
    checked
}

fn check_from_start<R: Read + Seek>(file: &mut R, length: u64) -> Result<()> {
    // An invalid header is reported better by the decoder.
    let Ok(header) = guarded(|| raw::Header::read_from(&mut *file))? else {
        return Ok(());
    };
    if let Some(extended) = header.evlr {
        let start = extended.start_of_first_evlr;
        let size = file
            .stream_position()
            .and_then(|position| {
                // The size of the data is at offset 20 of the header of the record.
                file.seek(SeekFrom::Start(start.saturating_add(20)))?;
                let size = u64_from(file)?;
                file.seek(SeekFrom::Start(position))?;
                Ok(size)
            })
            .map_err(|e| {
                Error::input(format!("byte {start}: expected an extended record, found the end of the file"))
                    .with_source(e)
            })?;
        if start.saturating_add(EXTENDED_HEADER_BYTES).saturating_add(size) > length {
            return Err(Error::input(format!(
                "byte {start}: an extended record declares {size} bytes, but the file has {length}: it is \
                 cut off or damaged"
            )));
        }
    }
    let legacy = u64::from(header.number_of_point_records);
    // Version 1.4 stores counts beyond 2³² in another field and sets the old one to zero.
    let promised = match (legacy, header.large_file) {
        (0, Some(large)) => large.number_of_point_records,
        _ => legacy,
    };
    let record = u64::from(header.point_data_record_length);
    let points = promised.saturating_mul(record);
    let offset = u64::from(header.offset_to_point_data);
    // LASzip marks compression by the highest bit of the format.
    let compressed = header.point_data_record_format & 0b1000_0000 != 0;
    if !compressed {
        return match offset.saturating_add(points) > length {
            true => Err(Error::input(format!(
                "the header declares {promised} points of {record} bytes, but the file has {length} bytes: \
                 it is cut off or its header is wrong"
            ))),
            false => Ok(()),
        };
    }
    check_expansion(length, points)
        .map_err(|e| e.in_context(format_args!("the header declares {promised} points of {record} bytes")))?;
    if record > MAX_RECORD_BYTES {
        return Err(Error::input(format!(
            "expected point records of at most {MAX_RECORD_BYTES} bytes, found {record}"
        )));
    }
    let mut description = None;
    // The description of the compression is one of the metadata records.
    for _ in 0..header.number_of_variable_length_records {
        let Ok(found) = raw::Vlr::read_from(&mut *file, false) else {
            return Ok(());
        };
        let user = found.user_id.split(|&b| b == 0).next().unwrap_or_default();
        if user == LazVlr::USER_ID.as_bytes() && found.record_id == LazVlr::RECORD_ID {
            description = Some(found.data);
            break;
        }
    }
    let Some(bytes) = description else {
        return Ok(());
    };
    // As for the header, the decoder reports the reason.
    let Ok(description) = LazVlr::from_buffer(&bytes) else {
        return Ok(());
    };
    check_items(description.items(), record)?;
    let chunks = Chunks {
        length,
        record,
        promised,
        layers: description.items().iter().map(|item| item_sizes(item).1).sum(),
        description: &description,
    };
    file.seek(SeekFrom::Start(offset)).map_err(|e| Error::io("could not be read").with_source(e))?;
    match bytes.starts_with(&ONE_CHUNK) {
        true => chunks.check_one(file, 0, offset).map(drop),
        false => chunks.check(file),
    }
}

/// Size of an item in a record in bytes, and the number of its layers in a chunk.
fn item_sizes(item: &LazItem) -> (u64, u64) {
    match item.item_type() {
        LazItemType::Byte(n) => (u64::from(n), 0),
        LazItemType::Byte14(n) => (u64::from(n), u64::from(n)),
        LazItemType::Point10 => (20, 0),
        LazItemType::GpsTime => (8, 0),
        LazItemType::RGB12 => (6, 0),
        LazItemType::WavePacket13 => (29, 0),
        LazItemType::Point14 => (30, 9),
        LazItemType::RGB14 => (6, 1),
        LazItemType::RGBNIR14 => (8, 2),
        LazItemType::WavePacket14 => (29, 1),
    }
}

/// Checks that the compressed items add up to the record. The decoder trusts their sizes and would otherwise
/// write beyond the record.
fn check_items(items: &[LazItem], record: u64) -> Result<()> {
    let size: u64 = items.iter().map(|item| item_sizes(item).0).sum();
    let consistent = items.iter().all(|item| {
        let (size, layers) = item_sizes(item);
        u64::from(item.size()) == size && size > 0 && (layers > 0) == (item.version() >= 3)
    });
    if items.is_empty() || !consistent || size != record {
        return Err(Error::input(format!(
            "the compressed items of a point: expected {record} bytes in all, found {size}: the file is \
             damaged"
        )));
    }
    Ok(())
}

/// Compressed points of a file.
struct Chunks<'a> {
    length: u64,
    record: u64,
    promised: u64,
    /// Number of layers of a chunk; 0 if points are compressed one by one.
    layers: u64,
    description: &'a LazVlr,
}

impl Chunks<'_> {
    fn damaged(&self, what: impl std::fmt::Display) -> Error {
        Error::input(format!("{what}: the file is cut off or damaged"))
    }

    /// Checks the table of the chunks and each layered chunk. The file is positioned at the first point.
    fn check<R: Read + Seek>(&self, file: &mut R) -> Result<()> {
        let failed =
            |e: std::io::Error| self.damaged("the table of the chunks cannot be read").with_source(e);
        let start = file.stream_position().map_err(failed)?;
        let mut table = i64_from(file).map_err(failed)?;
        if table <= start as i64 {
            // A writer that cannot seek back stores the position of the table at the end of the file.
            file.seek(SeekFrom::End(-8)).map_err(failed)?;
            table = i64_from(file).map_err(failed)?;
        }
        let table = u64::try_from(table)
            .ok()
            .filter(|table| (start..self.length).contains(table))
            .ok_or_else(|| self.damaged("the table of the chunks is not at the stated position"))?;
        file.seek(SeekFrom::Start(table + 4)).map_err(failed)?;
        let count = u64::from(u32_from(file).map_err(failed)?);
        // Each chunk begins with an uncompressed point.
        if count > self.length / self.record.max(1) {
            return Err(self.damaged(format_args!(
                "byte {table}: a table of {count} chunks in a file of {} bytes",
                self.length
            )));
        }
        // The count is now plausible, so the decoder may allocate the table.
        file.seek(SeekFrom::Start(start)).map_err(failed)?;
        let chunks = guarded(|| ChunkTable::read_from(&mut *file, self.description))?
            .map_err(|e| self.damaged("the table of the chunks cannot be read").with_source(e))?;
        let (mut byte, mut points) = (start + 8, 0_u64);
        for (k, chunk) in chunks.as_ref().iter().enumerate() {
            // Later chunks are never read, so their sizes do not matter.
            if points >= self.promised {
                break;
            }
            if chunk.point_count == 0 {
                return Err(self.damaged(format_args!("chunk {k} is empty")));
            }
            // Saturating, because a table may state any counts.
            points = points.saturating_add(chunk.point_count);
            byte = self.check_one(file, k, byte)?;
        }
        match points < self.promised {
            true => Err(self.damaged(format_args!(
                "the header declares {} points, the chunks hold {points}",
                self.promised
            ))),
            false => Ok(()),
        }
    }

    /// Checks that the layers of a chunk end inside the file; returns the position after them.
    fn check_one<R: Read + Seek>(&self, file: &mut R, chunk: usize, byte: u64) -> Result<u64> {
        if self.layers == 0 {
            return Ok(byte);
        }
        let early = |e: std::io::Error| {
            self.damaged(format_args!("byte {byte}: chunk {chunk} ends early")).with_source(e)
        };
        // A chunk: the first point uncompressed, a count, the sizes of the layers, the layers.
        file.seek(SeekFrom::Start(byte + self.record + 4)).map_err(early)?;
        let mut size = self.record + 4 + 4 * self.layers;
        for _ in 0..self.layers {
            size += u64::from(u32_from(file).map_err(early)?);
        }
        match byte + size > self.length {
            true => Err(self.damaged(format_args!(
                "byte {byte}: chunk {chunk} declares {size} bytes, but the file has {}",
                self.length
            ))),
            false => Ok(byte + size),
        }
    }
}

fn bytes_from<const N: usize>(file: &mut impl Read) -> std::io::Result<[u8; N]> {
    let mut bytes = [0; N];
    file.read_exact(&mut bytes).map(|()| bytes)
}

fn u32_from(file: &mut impl Read) -> std::io::Result<u32> {
    bytes_from(file).map(u32::from_le_bytes)
}

fn u64_from(file: &mut impl Read) -> std::io::Result<u64> {
    bytes_from(file).map(u64::from_le_bytes)
}

fn i64_from(file: &mut impl Read) -> std::io::Result<i64> {
    bytes_from(file).map(i64::from_le_bytes)
}
