//! The points of LAZ files up to version 1.3: compressed one after the other, in chunks.
//!
//! **Input.** A file positioned at the start of its points, and the description of its compression.
//!
//! **Output.** Records with all times zero. Times are decoded here because the decoder of the `laz` crate
//! recurses as often as damaged bytes request, and overflows the stack.
//!
//! **Limits.** Chunks may be shorter or longer than their table declares; see [`super::limits`].
//!
//! # References
//! M. Isenburg, *LASzip: lossless compression of LiDAR data*, 2013; items of version 2.

use std::io::{self, Read, Seek};

use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};
use laz::laszip::{ChunkTable, LazItem, LazItemType, LazVlr};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::{FieldDecompressor, RecordDecompressor, SequentialPointRecordDecompressor};

/// Records, one after the other.
pub(super) struct Sequential<R: Read> {
    decompressor: SequentialPointRecordDecompressor<'static, R>,
    items: Vec<LazItem>,
    /// Points of the chunks that were not begun.
    chunks: std::vec::IntoIter<u64>,
    /// Points left in the chunk that was.
    left: u64,
}

impl<R: Read + Seek> Sequential<R> {
    /// The records behind a header; all are one chunk where no table names any.
    pub(super) fn new(mut file: R, description: &LazVlr, one_chunk: bool) -> laz::Result<Self> {
        let chunks = match one_chunk {
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
            self.decompressor.reset();
            for item in &self.items {
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

/// Differences from one time to the next are stated as a multiple of the last one, up to this and down to
/// [`MIN_MULTIPLE`].
const MAX_MULTIPLE: i32 = 500;
const MIN_MULTIPLE: i32 = -10;
/// The symbol of a time that is the last one.
const REPEAT_SYMBOL: i32 = MAX_MULTIPLE - MIN_MULTIPLE + 1;
/// The symbol of a time that begins another series; those behind it go back to one of the others.
const NEW_SERIES_SYMBOL: i32 = REPEAT_SYMBOL + 1;
/// All symbols: three series to go back to.
const SYMBOLS: u32 = (NEW_SERIES_SYMBOL + 4) as u32;
/// So often in a row a writer may go from one series to another; none needs it twice.
const MAX_SWITCHES: usize = 4;

/// Passes over times: what they say is not kept, but how many bytes they take depends on it.
///
/// Four series of times are told apart. Of each the last difference is known, and how often in a row a
/// difference did not fit.
struct Times {
    /// Symbols after a difference of zero, and after every other.
    after_zero: ArithmeticModel,
    after_other: ArithmeticModel,
    integers: IntegerDecompressor,
    differences: [i32; 4],
    misfits: [u32; 4],
    /// The series of the last time, and the one that was begun last.
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
    /// Passes over a time, or goes to another series: the time is then still to come.
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
        // The multiple of the last difference that predicts the next, and among which its error is looked up.
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
        let found = self.integers.decompress(decoder, last.wrapping_mul(multiple), context)?;
        match context {
            1 => self.misfits[self.series] = 0,
            // At the ends of what multiples reach.
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

    /// The next difference of a series, as it is.
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

    /// Begins a series with a time as it is: its upper half predicted, its lower half plain.
    fn begin<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> io::Result<()> {
        self.newest = (self.newest + 1) % 4;
        self.series = self.newest;
        self.keep(self.series, decoder, 8)?;
        self.differences[self.series] = 0;
        decoder.read_int().map(drop)
    }

    /// Goes on to another series; false, because its time comes next.
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
        Err(io::Error::new(io::ErrorKind::InvalidData, "times that go from series to series without end"))
    }
}
