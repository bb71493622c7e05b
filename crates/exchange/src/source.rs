//! Reads a file through a buffer of fixed size: lines, records, and positions for messages.
//!
//! **Input.** Any reader.
//!
//! **Output.** Lines without their end (LF or CRLF) and runs of bytes. Memory does not depend on the size of
//! the file: the buffer grows only to hold one line or record, up to [`MAX_LINE_BYTES`] or the size of the
//! file.

use std::fmt::Display;
use std::fs::{self, File};
use std::io::{self, ErrorKind as IoKind, Read};
use std::path::Path;

use crate::output_set::recover_outputs_in_folder_of;
use flate2::read::MultiGzDecoder;
use planish_core::Budget;
use planish_estimate::{Error, Result};

/// Initial size of the buffer. Large enough that system calls cost little, small enough for many readers.
const BUFFER_BYTES: usize = 1 << 16;
/// Maximum length of a line. It stops a binary file without line ends from filling the memory, and is far
/// above the longest line of a point file (guarded by
/// `an_endless_line_is_rejected_before_it_fills_the_memory`).
const MAX_LINE_BYTES: usize = 1 << 22;

/// A buffered reader that counts lines and bytes.
pub(crate) struct Source<R> {
    reader: R,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    /// Bytes of the file before `start`.
    offset: u64,
    length: Option<u64>,
    /// Lines returned so far.
    lines: u64,
    budget: Budget,
}

/// Opens a file and returns its length, which is unknown for devices and pipes. Folders, missing files and
/// empty files have their own messages.
pub(crate) fn open_file(path: &Path) -> Result<(File, Option<u64>)> {
    let failed = |e: std::io::Error| match e.kind() {
        IoKind::NotFound => Error::io("does not exist"),
        _ => Error::io("could not be opened").with_source(e),
    };
    // A process that was killed while it published this file may have left the set half renamed.
    recover_outputs_in_folder_of(path);
    let metadata = fs::metadata(path).map_err(failed)?;
    // Checked first, because opening a folder succeeds on Linux and only reading from it fails.
    if metadata.is_dir() {
        return Err(Error::io("expected a file, found a folder"));
    }
    let length = metadata.is_file().then_some(metadata.len());
    if length == Some(0) {
        return Err(Error::input("the file is empty"));
    }
    Ok((File::open(path).map_err(failed)?, length))
}

/// Maximum ratio of unpacked to packed bytes of DEFLATE.
///
/// # References
/// M. Adler, *zlib technical details*: 1032 to 1.
pub(crate) const MAX_DEFLATE_RATIO: u64 = 1032;

/// First bytes of a gzip file (RFC 1952, section 2.3.1).
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Opens a file and passes its source and file name to `read`; errors name the path.
pub(crate) fn read_file<T>(
    path: &Path,
    read: impl FnOnce(Source<Box<dyn Read>>, &str) -> Result<T>,
) -> Result<T> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    open(path).and_then(|source| read(source, &name)).map_err(|e| e.in_context(path.display()))
}

/// Opens a file as a source and unpacks gzip.
///
/// Gzip is recognised by its first bytes, whatever the name of the file.
pub(crate) fn open(path: &Path) -> Result<Source<Box<dyn Read>>> {
    let (mut file, length) = open_file(path)?;
    let mut first = [0; 2];
    let mut found = 0;
    // A read may return fewer bytes than requested.
    while found < first.len() {
        match file.read(&mut first[found..]) {
            Ok(0) => break,
            Ok(n) => found += n,
            // A signal interrupted the call, which has read nothing and is repeated.
            Err(e) if e.kind() == IoKind::Interrupted => {}
            Err(e) => return Err(Error::io("could not be read").with_source(e)),
        }
    }
    // A pipe cannot be rewound, so the bytes that were read are chained before the rest.
    let content = io::Cursor::new(first).take(found as u64).chain(file);
    Ok(match first == GZIP {
        true => {
            // A pipe has no length; what it packs is then limited as if it were small.
            let budget = Budget::of_compressed(length.unwrap_or(0), DATA_RATIO);
            let unpacked: Box<dyn Read> = Box::new(Unpacked::new(content));
            Source::new(unpacked, None).with_budget(budget)
        }
        false => Source::new(Box::new(content), length),
    })
}

/// Bytes of memory that a packed byte of a compressed file may take. Measurements pack to a third or more of
/// their size, and a point takes at most eight times the memory of its record (decision 0089).
pub(crate) const DATA_RATIO: u64 = 16;

/// Maximum ratio of unpacked to packed bytes. Deflate reaches 1032, but only without measurements; nearly
/// empty organised clouds reach some dozens (decision 0041).
const MAX_EXPANSION: u64 = 100;
/// Unpacked size that is accepted at any ratio: a size that does no harm.
const ALWAYS_ALLOWED_BYTES: u64 = 64 << 20;

/// Rejects a small file that unpacks to far more than measurements do, whatever the memory holds.
pub(crate) fn check_expansion(packed: u64, unpacked: u64) -> Result<()> {
    match unpacked > ALWAYS_ALLOWED_BYTES.saturating_add(packed.saturating_mul(MAX_EXPANSION)) {
        true => Err(Error::input(format!(
            "{packed} compressed bytes unpack to {unpacked} or more, over {MAX_EXPANSION} times their size: \
             the file may be damaged; if it is valid, unpack it first"
        ))),
        false => Ok(()),
    }
}

/// Unpacks gzip and fails if the result is out of proportion to the file ([`check_expansion`]).
struct Unpacked<R> {
    // A gzip file may consist of several members (RFC 1952, section 2.2), as block compressors write them.
    decoder: MultiGzDecoder<Counted<R>>,
    unpacked: u64,
}

/// Counts the bytes that are read.
struct Counted<R> {
    reader: R,
    count: u64,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.reader.read(buffer)?;
        self.count += n as u64;
        Ok(n)
    }
}

impl<R: Read> Unpacked<R> {
    fn new(reader: R) -> Self {
        Self { decoder: MultiGzDecoder::new(Counted { reader, count: 0 }), unpacked: 0 }
    }
}

impl<R: Read> Read for Unpacked<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.decoder.read(buffer)?;
        self.unpacked += n as u64;
        check_expansion(self.decoder.get_ref().count, self.unpacked)
            // The kind marks the error, so that `Source::fill` reports it as a fault of the file.
            .map_err(|e| io::Error::new(IoKind::FileTooLarge, e.to_string()))?;
        Ok(n)
    }
}

/// Returns the extension of a file name in lower case, without a trailing `.gz`.
///
/// # Examples
/// ```
/// use planish_exchange::extension;
/// assert_eq!(extension("scan.PLY.gz".as_ref()), "ply");
/// assert_eq!(extension("scan".as_ref()), "");
/// ```
#[must_use]
pub fn extension(path: &Path) -> String {
    let lower = |path: &Path| path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    match lower(path).as_str() {
        "gz" => lower(Path::new(path.file_stem().unwrap_or_default())),
        other => other.to_owned(),
    }
}

/// Describes the extension of a path for the `found …` part of a message.
///
/// # Examples
/// ```
/// use planish_exchange::describe_extension;
/// assert_eq!(describe_extension("part.3mf".as_ref()), "the extension `3mf`");
/// assert_eq!(describe_extension("part".as_ref()), "no extension");
/// ```
#[must_use]
pub fn describe_extension(path: &Path) -> String {
    match extension(path).as_str() {
        "" => "no extension".to_owned(),
        "iges" | "igs" => {
            "IGES, which is not supported: convert it to STEP, or to a mesh (.stl, .obj, .ply) with a chord \
             error well below the deviations of interest"
                .to_owned()
        }
        other => format!("the extension `{other}`"),
    }
}

/// Says why a path is not a file that can be read.
pub(crate) fn no_file(path: &Path) -> &'static str {
    match path.exists() {
        true => "is not a file: expected a file of points",
        false => "does not exist",
    }
}

/// Reads a file as a whole. A regular file may be as large as the memory allows, other ones (pipes, devices)
/// up to `max` bytes; `what` names the expected content.
pub(crate) fn read_limited(path: &Path, max: u64, what: &str) -> Result<Vec<u8>> {
    let (file, length) = open_file(path)?;
    let budget = Budget::of_process();
    budget.take_elements(length.unwrap_or(0), 1, format_args!("bytes of {what}"))?;
    let max = length.map_or(max, |length| length.max(max));
    let mut bytes = Vec::new();
    // One more byte than allowed shows that the file is too long.
    let read = file.take(max.saturating_add(1)).read_to_end(&mut bytes);
    read.map_err(|e| Error::io("could not be read").with_source(e))?;
    match bytes.len() as u64 > max {
        true => Err(Error::input(format!("expected {what} of at most {max} bytes, found more"))),
        false => Ok(bytes),
    }
}

/// Maximum size of a text that is read as a whole. Far above the lists of scans and the drawings that people
/// or programs write; a point cloud named by mistake exceeds it.
pub(crate) const MAX_TEXT_BYTES: u64 = 16 << 20;

/// Reads a small text file completely (a list or a job, not a point cloud).
pub(crate) fn read_text(path: &Path) -> Result<String> {
    let (file, _) = open_file(path)?;
    let mut bytes = Vec::new();
    // One more byte than allowed shows that the file is too long.
    let read = file.take(MAX_TEXT_BYTES + 1).read_to_end(&mut bytes);
    read.map_err(|e| Error::io("could not be read").with_source(e))?;
    if bytes.len() as u64 > MAX_TEXT_BYTES {
        return Err(Error::input("longer than 16 MiB: expected a list of scans or a table of settings"));
    }
    String::from_utf8(bytes).map_err(|e| {
        let at = e.utf8_error().valid_up_to();
        let line = 1 + e.as_bytes()[..at].iter().filter(|&&b| b == b'\n').count();
        Error::input(format!("line {line}: expected text in UTF-8, found another encoding (byte {at})"))
    })
}

impl<R: Read> Source<R> {
    /// Creates a source over a reader; `length` is the number of bytes, if known.
    ///
    /// Its budget is that of the process: the size of a plain file bounds what it describes.
    pub(crate) fn new(reader: R, length: Option<u64>) -> Self {
        let budget = Budget::of_process();
        Self { reader, buffer: vec![0; BUFFER_BYTES], start: 0, end: 0, offset: 0, length, lines: 0, budget }
    }

    /// The same source with the budget of a compressed file.
    pub(crate) fn with_budget(self, budget: Budget) -> Self {
        Self { budget, ..self }
    }

    /// The memory that the content may take.
    pub(crate) fn budget(&self) -> &Budget {
        &self.budget
    }

    /// Number of bytes returned so far.
    pub(crate) fn offset(&self) -> u64 {
        self.offset
    }

    /// Number of the last line that was returned, from 1.
    pub(crate) fn line_number(&self) -> u64 {
        self.lines
    }

    /// Number of bytes left, if the length of the file is known.
    pub(crate) fn remaining(&self) -> Option<u64> {
        self.length.map(|length| length.saturating_sub(self.offset))
    }

    /// Rejects a declared count of records that need more bytes than are left.
    ///
    /// Called before memory is allocated, so that a damaged header cannot request more than the file holds.
    pub(crate) fn check_promise(&self, count: u64, what: impl Display, needed: u64) -> Result<()> {
        match self.remaining() {
            Some(left) if left < needed => Err(Error::input(format!(
                "the header declares {count} {what}, which take at least {needed} bytes, but only {left} \
                 bytes follow: the file is cut off or its header is wrong"
            ))),
            _ => Ok(()),
        }
    }

    /// Number of entries to reserve for a declared count of records of at least `min_record_bytes` bytes
    /// each.
    ///
    /// Never more than the rest of the file can hold; one buffer full if the length is unknown (gzip, pipes).
    pub(crate) fn reserve(&self, promised: u64, min_record_bytes: u64) -> usize {
        let holds = self.remaining().map_or(BUFFER_BYTES as u64, |bytes| bytes / min_record_bytes.max(1) + 1);
        // Entries take more than a byte, so the budget allows at most as many as it has bytes left.
        usize::try_from(promised.min(holds).min(self.budget.left(1))).unwrap_or(0)
    }

    /// Appends more bytes to the buffer; false at the end of the file.
    fn fill(&mut self) -> Result<bool> {
        if self.start > 0 {
            // Unread bytes move to the front, so that the buffer grows only for a line or record larger than
            // it.
            self.buffer.copy_within(self.start..self.end, 0);
            self.end -= self.start;
            self.start = 0;
        }
        if self.end == self.buffer.len() {
            // Doubled, so that a long line is copied only a few times while the buffer grows.
            let at = self.offset + self.end as u64;
            self.budget.take_elements(1, self.buffer.len() as u64, format_args!("text at byte {at}"))?;
            self.buffer.resize(2 * self.buffer.len(), 0);
        }
        loop {
            match self.reader.read(&mut self.buffer[self.end..]) {
                Ok(0) => return Ok(false),
                Ok(n) => {
                    self.end += n;
                    return Ok(true);
                }
                Err(e) if e.kind() == IoKind::Interrupted => {}
                Err(e) => {
                    let at = self.offset + (self.end - self.start) as u64;
                    if e.kind() == IoKind::FileTooLarge {
                        return Err(Error::input(e.to_string()));
                    }
                    // These kinds come from the gzip decoder; errors of the disk have other kinds.
                    if matches!(e.kind(), IoKind::InvalidInput | IoKind::InvalidData | IoKind::UnexpectedEof)
                    {
                        return Err(Error::input(format!(
                            "the compressed file is damaged or cut off: it cannot be unpacked from byte \
                             {at} on"
                        ))
                        .with_source(e));
                    }
                    return Err(Error::io(format!("could not be read at byte {at}")).with_source(e));
                }
            }
        }
    }

    fn take(&mut self, n: usize) -> &[u8] {
        self.start += n;
        self.offset += n as u64;
        &self.buffer[self.start - n..self.start]
    }

    /// Returns the next line without its end, or `None` at the end of the file. The last line may lack its
    /// end.
    pub(crate) fn line(&mut self) -> Result<Option<&[u8]>> {
        let mut searched = 0;
        let length = loop {
            let unseen = &self.buffer[self.start + searched..self.end];
            if let Some(at) = unseen.iter().position(|&b| b == b'\n') {
                break searched + at + 1;
            }
            // Bytes are searched once, also if the buffer grows, so that long lines take linear time.
            searched = self.end - self.start;
            if searched > MAX_LINE_BYTES {
                let line = self.lines + 1;
                return Err(Error::input(format!(
                    "line {line}: longer than {MAX_LINE_BYTES} bytes: expected a text file"
                )));
            }
            if !self.fill()? {
                if searched == 0 {
                    return Ok(None);
                }
                break searched;
            }
        };
        self.lines += 1;
        let line = self.take(length);
        let line = line.strip_suffix(b"\n").unwrap_or(line);
        Ok(Some(line.strip_suffix(b"\r").unwrap_or(line)))
    }

    /// Returns the next `n` bytes, or `None` if fewer are left.
    pub(crate) fn bytes(&mut self, n: usize) -> Result<Option<&[u8]>> {
        // Checked before the buffer grows, so that a damaged size allocates nothing.
        if self.remaining().is_some_and(|left| left < n as u64) {
            return Ok(None);
        }
        // If the length is unknown, the buffer still grows only as bytes arrive, not to the requested size.
        while self.end - self.start < n {
            if !self.fill()? {
                return Ok(None);
            }
        }
        Ok(Some(self.take(n)))
    }

    /// Returns the rest of the file.
    pub(crate) fn rest(mut self) -> Result<Vec<u8>> {
        // Needs no limit of its own: `fill` takes the buffer from the budget.
        while self.fill()? {}
        self.buffer.truncate(self.end);
        self.buffer.drain(..self.start);
        Ok(self.buffer)
    }

    /// Skips white space up to the end of the file; returns the offset of the first other byte, if any.
    pub(crate) fn more_than_blanks(&mut self) -> Result<Option<u64>> {
        loop {
            let rest = &self.buffer[self.start..self.end];
            let blanks = rest.iter().take_while(|b| b.is_ascii_whitespace()).count();
            let all = blanks == rest.len();
            self.take(blanks);
            if !all {
                return Ok(Some(self.offset));
            }
            if !self.fill()? {
                return Ok(None);
            }
        }
    }

    /// Returns the next `n` bytes, or fewer at the end of the file, without consuming them.
    pub(crate) fn peek(&mut self, n: usize) -> Result<&[u8]> {
        while self.end - self.start < n {
            if !self.fill()? {
                break;
            }
        }
        let found = n.min(self.end - self.start);
        Ok(&self.buffer[self.start..self.start + found])
    }

    /// Skips `n` bytes; false if fewer are left.
    pub(crate) fn skip(&mut self, n: u64) -> Result<bool> {
        let mut left = n;
        loop {
            let buffered = self.end - self.start;
            // Reads instead of seeking, because the source may be a pipe or unpack gzip.
            let step = usize::try_from(left).unwrap_or(usize::MAX).min(buffered);
            self.take(step);
            left -= step as u64;
            if left == 0 {
                return Ok(true);
            }
            if !self.fill()? {
                return Ok(false);
            }
        }
    }
}

/// Parses a number of a text file, exact to the last bit; `None` if it is not a number.
///
/// Accepts what Rust accepts (`1`, `-1.5e-3`, `.5`, `nan`, `inf`), and as NaN the forms that older Microsoft
/// run-time libraries print (`1.#QNAN`, `-nan(ind)`, `1.#INF`), because files of Windows programs hold them.
#[inline]
pub(crate) fn parse_number(text: &[u8]) -> Option<f64> {
    // Fast path for counts and indices: up to 15 digits are below 2⁵³ and hence exact.
    if text.len() <= 15 && !text.is_empty() && text.iter().all(u8::is_ascii_digit) {
        return Some(text.iter().fold(0_u64, |n, &d| 10 * n + u64::from(d - b'0')) as f64);
    }
    let text = std::str::from_utf8(text).ok()?;
    text.parse().ok().or_else(|| {
        let unsigned = text.strip_prefix(['-', '+']).unwrap_or(text).to_ascii_lowercase();
        let not_finite = unsigned.starts_with("nan(") || unsigned.starts_with("1.#");
        not_finite.then_some(f64::NAN)
    })
}

/// Returns the next word, delimited by white space.
#[inline]
pub(crate) fn next_word<'a>(line: &mut &'a [u8]) -> Option<&'a [u8]> {
    let start = line.iter().position(|b| !b.is_ascii_whitespace())?;
    let rest = &line[start..];
    let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
    *line = &rest[end..];
    Some(&rest[..end])
}

/// Formats bytes for a message: as text between back quotes, shortened, without control characters.
pub(crate) fn shown(bytes: &[u8]) -> String {
    const MAX_CHARS: usize = 40;
    // A character has at most four bytes, so the rest of a long line need not be decoded.
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(4 * MAX_CHARS)]);
    let clean: String =
        text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).take(MAX_CHARS).collect();
    let cut = if clean.len() < bytes.len() { "…" } else { "" };
    format!("`{clean}{cut}`")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_in_lf_crlf_or_the_file() {
        let mut source = Source::new(&b"a\r\n\nb c"[..], Some(7));
        assert_eq!(source.line().unwrap(), Some(&b"a"[..]));
        assert_eq!(source.line().unwrap(), Some(&b""[..]));
        assert_eq!(source.line().unwrap(), Some(&b"b c"[..]));
        assert_eq!(source.line().unwrap(), None);
        assert_eq!((source.line_number(), source.offset(), source.remaining()), (3, 7, Some(0)));
    }

    #[test]
    fn gzip_is_unpacked_and_its_damage_reported() {
        use flate2::{Compression, write::GzEncoder};
        use std::io::Write;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.xyz.gz");
        let text: Vec<u8> = (0..20_000).flat_map(|i| format!("{i} {} 3\n", i * i).into_bytes()).collect();
        let mut packed = Vec::new();
        // Two members, as of files joined by `cat`.
        for half in text.chunks(text.len() / 2 + 1) {
            let mut encoder = GzEncoder::new(&mut packed, Compression::fast());
            encoder.write_all(half).unwrap();
            encoder.finish().unwrap();
        }
        fs::write(&path, &packed).unwrap();
        let mut source = open(&path).unwrap();
        let mut lines = 0;
        while source.line().unwrap().is_some() {
            lines += 1;
        }
        assert_eq!((lines, extension(&path).as_str()), (20_000, "xyz"));
        fs::write(&path, &packed[..packed.len() - 9]).unwrap();
        let mut source = open(&path).unwrap();
        let error = loop {
            match source.line() {
                Ok(line) => assert!(line.is_some(), "a file that is cut off has no good end"),
                Err(e) => break e,
            }
        };
        assert!(error.to_string().contains("damaged or cut off"), "{error}");
        // Other files, short ones too, are as they are.
        fs::write(&path, b"x").unwrap();
        assert_eq!(open(&path).unwrap().line().unwrap(), Some(&b"x"[..]));
    }

    #[test]
    fn a_small_file_that_unpacks_to_gigabytes_is_rejected_early() {
        use flate2::{Compression, write::GzEncoder};
        use std::io::Write;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bomb.xyz.gz");
        let mut encoder = GzEncoder::new(fs::File::create(&path).unwrap(), Compression::fast());
        let points = b"0 0 0\n".repeat(1 << 16);
        for _ in 0..1 << 9 {
            encoder.write_all(&points).unwrap();
        }
        let packed = encoder.finish().unwrap().metadata().unwrap().len();
        let mut source = open(&path).unwrap();
        let error = loop {
            if let Err(e) = source.line() {
                break e;
            }
        };
        assert!(error.kind() == planish_estimate::ErrorKind::Input, "{error}");
        assert!(error.to_string().contains("over 100 times their size"), "{error}");
        assert!(source.offset() < ALWAYS_ALLOWED_BYTES + 2 * MAX_EXPANSION * packed);
    }

    #[test]
    fn lines_cross_the_buffers_end() {
        let mut text = vec![b'x'; BUFFER_BYTES - 1];
        text.extend_from_slice(b"yz\nlast\n");
        let mut source = Source::new(&text[..], None);
        assert_eq!(source.line().unwrap().unwrap().len(), BUFFER_BYTES + 1);
        assert_eq!(source.line().unwrap(), Some(&b"last"[..]));
    }

    #[test]
    fn an_endless_line_is_rejected_before_it_fills_the_memory() {
        let mut source = Source::new(std::io::repeat(b'x'), None);
        assert!(source.line().unwrap_err().to_string().contains("line 1: longer than"));
    }

    #[test]
    fn numbers_are_exact_to_the_last_bit() {
        for text in ["0.0359793", "-1e-300", "7", "123456789012345", "9007199254740993", ".5", "+2."] {
            assert_eq!(parse_number(text.as_bytes()), Some(text.parse().unwrap()), "{text}");
        }
        for text in ["nan", "NaN", "-nan(ind)", "1.#QNAN", "-1.#IND", "inf"] {
            assert!(!parse_number(text.as_bytes()).unwrap().is_finite(), "{text}");
        }
        for text in ["", "x", "1,5", "1_0", "0x10", "--1", "\u{fffd}"] {
            assert_eq!(parse_number(text.as_bytes()), None, "{text}");
        }
    }
}
