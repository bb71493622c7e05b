//! Reads the points of LAZ files up to version 1.3, compressed one by one in chunks.
//!
//! **Input.** A file positioned at the start of its points, and the description of its compression.
//!
//! **Output.** Records with all times zero. Times are decoded here because the decoder of the `laz` crate
//! recurses as often as damaged bytes request, and overflows the stack.
//!
//! **Limits.** Chunks may be shorter or longer than their table declares; see [`super::limits`].
//!
//! # References
//! M. Isenburg, *LASzip: lossless compression of LiDAR data*, 2013; version 2 of the item `GPSTIME11`.

use std::io::{self, Read, Seek};

use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};
use laz::laszip::{ChunkTable, LazItem, LazItemType, LazVlr};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::{FieldDecompressor, RecordDecompressor, SequentialPointRecordDecompressor};

/// Reader of records in order.
pub(super) struct Sequential<R: Read> {
    decompressor: SequentialPointRecordDecompressor<'static, R>,
    items: Vec<LazItem>,
    /// Numbers of points of the chunks not yet started.
    chunks: std::vec::IntoIter<u64>,
    /// Points left in the current chunk.
    left: u64,
}

impl<R: Read + Seek> Sequential<R> {
    /// Starts reading after the header; `one_chunk` means that the file has no table of chunks.
    pub(super) fn new(mut file: R, description: &LazVlr, one_chunk: bool) -> laz::Result<Self> {
        let chunks = match one_chunk {
            // The caller reads as many records as the header declares, so the chunk needs no end.
            true => vec![u64::MAX],
            false => {
                let table = ChunkTable::read_from(&mut file, description)?;
                table.as_ref().iter().map(|chunk| chunk.point_count).collect()
            }
        };
        Ok(Self {
            decompressor: SequentialPointRecordDecompressor::new(file),
            items: description.items().clone(),
            chunks: chunks.into_iter(),
            left: 0,
        })
    }

    /// Reads the next record.
    pub(super) fn read(&mut self, record: &mut [u8]) -> laz::Result<()> {
        if self.left == 0 {
            self.left = self.chunks.next().ok_or(io::ErrorKind::UnexpectedEof).map_err(io::Error::from)?;
            // Each chunk starts with new models, so that readers can start at any chunk.
            self.decompressor.reset();
            for item in &self.items {
                // Only the decoder of GPS times recurses; other items use those of the crate.
                match (item.item_type(), item.version()) {
                    (LazItemType::GpsTime, 2) => self.decompressor.add_field_decompressor(Times::default()),
                    _ => self.decompressor.set_fields_from(&vec![*item])?,
                }
            }
        }
        self.left -= 1;
        Ok(self.decompressor.decompress_next(record)?)
    }
}

/// Largest multiple of the last difference by which the next time difference is predicted; the smallest is
/// [`MIN_MULTIPLE`].
const MAX_MULTIPLE: i32 = 500;
const MIN_MULTIPLE: i32 = -10;
/// Symbol of a time equal to the last one.
const REPEAT_SYMBOL: i32 = MAX_MULTIPLE - MIN_MULTIPLE + 1;
/// Symbol of a time that starts a new series; the symbols after it return to one of the other series.
const NEW_SERIES_SYMBOL: i32 = REPEAT_SYMBOL + 1;
/// Number of symbols, with three series to return to.
const SYMBOLS: u32 = (NEW_SERIES_SYMBOL + 4) as u32;
/// Maximum number of consecutive switches between series. A valid file needs one; damaged data request any
/// number. Guarded by `damaged_times_do_not_cause_endless_recursion`.
const MAX_SWITCHES: usize = 4;

/// Decodes times without keeping them: the position of the next item depends on their content.
///
/// The format distinguishes four series of times. For each it tracks the last difference and the number of
/// consecutive differences that were predicted badly.
struct Times {
    /// Models of symbols after a difference of zero, and after any other.
    after_zero: ArithmeticModel,
    after_other: ArithmeticModel,
    integers: IntegerDecompressor,
    differences: [i32; 4],
    misfits: [u32; 4],
    /// Series of the last time, and the series started last.
    series: usize,
    newest: usize,
}

impl Default for Times {
    fn default() -> Self {
        Self {
            after_zero: ArithmeticModelBuilder::new(6).build(),
            after_other: ArithmeticModelBuilder::new(SYMBOLS).build(),
            integers: IntegerDecompressorBuilder::new().bits(32).contexts(9).build_initialized(),
            differences: [0; 4],
            misfits: [0; 4],
            series: 0,
            newest: 0,
        }
    }
}

impl Times {
    /// Decodes a time, or switches to another series; false if the time still follows.
    fn pass<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> io::Result<bool> {
        let last = self.differences[self.series];
        if last == 0 {
            match decoder.decode_symbol(&mut self.after_zero)? {
                0 => {}
                1 => self.keep(self.series, decoder, 0)?,
                2 => self.begin(decoder)?,
                n => return Ok(self.switch(n as usize - 2)),
            }
            return Ok(true);
        }
        let symbol = decoder.decode_symbol(&mut self.after_other)? as i32;
        // Multiple of the last difference that predicts the next, and the context of its error. The contexts
        // are fixed by the format.
        let (multiple, context) = match symbol {
            0 => (0, 7),
            1 => (1, 1),
            2..10 => (symbol, 2),
            10..MAX_MULTIPLE => (symbol, 3),
            MAX_MULTIPLE => (symbol, 4),
            ..REPEAT_SYMBOL => match MAX_MULTIPLE - symbol {
                MIN_MULTIPLE => (MIN_MULTIPLE, 6),
                multiple => (multiple, 5),
            },
            REPEAT_SYMBOL => return Ok(true),
            NEW_SERIES_SYMBOL => return self.begin(decoder).map(|()| true),
            _ => return Ok(self.switch((symbol - NEW_SERIES_SYMBOL) as usize)),
        };
        // Wrapping, because damaged data may give any difference.
        let found = self.integers.decompress(decoder, last.wrapping_mul(multiple), context)?;
        match context {
            1 => self.misfits[self.series] = 0,
            // At the ends of the range of multiples: after more than three, the difference is replaced.
            4 | 6 | 7 => {
                self.misfits[self.series] += 1;
                if self.misfits[self.series] > 3 {
                    self.differences[self.series] = found;
                    self.misfits[self.series] = 0;
                }
            }
            _ => {}
        }
        Ok(true)
    }

    /// Decodes the next difference of a series without prediction.
    fn keep<R: Read>(
        &mut self,
        series: usize,
        decoder: &mut ArithmeticDecoder<R>,
        context: u32,
    ) -> io::Result<()> {
        self.differences[series] = self.integers.decompress(decoder, 0, context)?;
        self.misfits[series] = 0;
        Ok(())
    }

    /// Starts a series with a full time: the upper half is predicted, the lower half is stored plainly.
    fn begin<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> io::Result<()> {
        self.newest = (self.newest + 1) % 4;
        self.series = self.newest;
        self.keep(self.series, decoder, 8)?;
        // `keep` stores the upper half as a difference, but a new series has none yet.
        self.differences[self.series] = 0;
        decoder.read_int().map(drop)
    }

    /// Switches to another series; returns false, because its time follows.
    fn switch(&mut self, by: usize) -> bool {
        self.series = (self.series + by) % 4;
        false
    }
}

impl<R: Read> FieldDecompressor<R> for Times {
    fn size_of_field(&self) -> usize {
        8
    }

    fn decompress_first(&mut self, source: &mut R, time: &mut [u8]) -> io::Result<()> {
        source.read_exact(time)
    }

    fn decompress_with(&mut self, decoder: &mut ArithmeticDecoder<R>, _time: &mut [u8]) -> io::Result<()> {
        for _ in 0..MAX_SWITCHES {
            if self.pass(decoder)? {
                return Ok(());
            }
        }
        Err(io::Error::new(io::ErrorKind::InvalidData, "endless switching between series of times"))
    }
}
