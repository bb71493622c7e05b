//! Bytes of a file through a buffer of fixed size: lines, records, places for messages.
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

use flate2::read::MultiGzDecoder;
use planish_estimate::{Error, Result};

/// Size of the buffer to begin with.
const BUFFER_BYTES: usize = 1 << 16;
/// A longer line is taken for a file that is no text.
const MAX_LINE_BYTES: usize = 1 << 22;

/// A buffered reader that knows where it is.
pub(crate) struct Source<R> {
    reader: R,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    /// Bytes of the file before `start`.
    offset: u64,
    length: Option<u64>,
    /// Lines handed out.
    lines: u64,
}

/// Opens a file; folders, missing and empty files have their own messages. The length is known for plain
/// files.
pub(crate) fn open_file(path: &Path) -> Result<(File, Option<u64>)> {
    let failed = |e: std::io::Error| match e.kind() {
        IoKind::NotFound => Error::io("does not exist"),
        _ => Error::io("could not be opened").with_source(e),
    };
    let metadata = fs::metadata(path).map_err(failed)?;
    if metadata.is_dir() {
        return Err(Error::io("is a folder, expected a file"));
    }
    let length = metadata.is_file().then_some(metadata.len());
    if length == Some(0) {
        return Err(Error::input("the file is empty"));
    }
    Ok((File::open(path).map_err(failed)?, length))
}

/// What files compressed by gzip begin with.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Reads a file by what makes something of its source and its name; errors name the path.
pub(crate) fn read_file<T>(
    path: &Path,
    read: impl FnOnce(Source<Box<dyn Read>>, &str) -> Result<T>,
) -> Result<T> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    open(path).and_then(|source| read(source, &name)).map_err(|e| e.in_context(path.display()))
}

/// Opens a file as a source; what gzip has compressed is read as what it was, whatever its name.
pub(crate) fn open(path: &Path) -> Result<Source<Box<dyn Read>>> {
    let (mut file, length) = open_file(path)?;
    let mut first = [0; 2];
    let mut found = 0;
    while found < first.len() {
        match file.read(&mut first[found..]) {
            Ok(0) => break,
            Ok(n) => found += n,
            Err(e) if e.kind() == IoKind::Interrupted => {}
            Err(e) => return Err(Error::io("could not be read").with_source(e)),
        }
    }
    // A pipe cannot be rewound: the first bytes are put before the rest.
    let whole = io::Cursor::new(first).take(found as u64).chain(file);
    Ok(match first == GZIP {
        true => Source::new(Box::new(Unpacked::new(whole)), None),
        false => Source::new(Box::new(whole), length),
    })
}

/// No measurement is compressed to less than this share.
const MAX_EXPANSION: u64 = 100;
/// What any file may unpack to, however small it is.
const ALWAYS_ALLOWED_BYTES: u64 = 64 << 20;

/// Refuses what is small on the disk and fills the memory.
pub(crate) fn check_expansion(packed: u64, unpacked: u64) -> Result<()> {
    match unpacked > ALWAYS_ALLOWED_BYTES.saturating_add(packed.saturating_mul(MAX_EXPANSION)) {
        true => Err(Error::input(format!(
            "{packed} compressed bytes stand for {unpacked} and more: no measurements do, and they would \
             fill the memory; unpack the file \
             first if it is to be read"
        ))),
        false => Ok(()),
    }
}

/// Unpacks gzip as long as it stays in proportion.
struct Unpacked<R> {
    decoder: MultiGzDecoder<Counted<R>>,
    given: u64,
}

/// Counts what is read.
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
        Self { decoder: MultiGzDecoder::new(Counted { reader, count: 0 }), given: 0 }
    }
}

impl<R: Read> Read for Unpacked<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.decoder.read(buffer)?;
        self.given += n as u64;
        check_expansion(self.decoder.get_ref().count, self.given)
            .map_err(|e| io::Error::new(IoKind::FileTooLarge, e.to_string()))?;
        Ok(n)
    }
}

/// The extension of a file's name in lower case; `.gz` at its end does not count.
#[must_use]
pub fn extension(path: &Path) -> String {
    let lower = |path: &Path| path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    match lower(path).as_str() {
        "gz" => lower(Path::new(path.file_stem().unwrap_or_default())),
        other => other.to_owned(),
    }
}

/// What a message says was found where no reader takes the extension.
#[must_use]
pub fn found_extension(path: &Path) -> String {
    match extension(path).as_str() {
        "" => "no extension".to_owned(),
        "iges" | "igs" => {
            "IGES, which is not read: write it as STEP, or as a mesh (.stl, .obj, .ply) with a chord error \
             well below what is to be told apart"
                .to_owned()
        }
        other => format!("the extension `{other}`"),
    }
}

/// What is wrong with a path that is no file.
pub(crate) fn no_file(path: &Path) -> &'static str {
    match path.exists() {
        true => "is no file: expected one that holds points",
        false => "does not exist",
    }
}

/// Reads a small text file whole (a list or a job, not a cloud).
pub(crate) fn read_text(path: &Path) -> Result<String> {
    /// No list of scans that a person or script wrote comes near.
    const MAX_TEXT_BYTES: u64 = 16 << 20;
    let (file, _) = open_file(path)?;
    let mut bytes = Vec::new();
    let read = file.take(MAX_TEXT_BYTES + 1).read_to_end(&mut bytes);
    read.map_err(|e| Error::io("could not be read").with_source(e))?;
    if bytes.len() as u64 > MAX_TEXT_BYTES {
        return Err(Error::input("longer than 16 MiB: this is no list of scans"));
    }
    String::from_utf8(bytes).map_err(|e| {
        let at = e.utf8_error().valid_up_to();
        let line = 1 + e.as_bytes()[..at].iter().filter(|&&b| b == b'\n').count();
        Error::input(format!("line {line}: is not text in UTF-8 (byte {at})"))
    })
}

impl<R: Read> Source<R> {
    /// A source over a reader, with the number of bytes that it will give where that is known.
    pub(crate) fn new(reader: R, length: Option<u64>) -> Self {
        Self { reader, buffer: vec![0; BUFFER_BYTES], start: 0, end: 0, offset: 0, length, lines: 0 }
    }

    /// How many bytes were handed out.
    pub(crate) fn offset(&self) -> u64 {
        self.offset
    }

    /// The number, from 1, of the line handed out last.
    pub(crate) fn line_number(&self) -> u64 {
        self.lines
    }

    /// How many bytes are left, where the file's length is known.
    pub(crate) fn remaining(&self) -> Option<u64> {
        self.length.map(|length| length.saturating_sub(self.offset))
    }

    /// Refuses a promise of records, `count` and what they are, that take more bytes than are left.
    pub(crate) fn check_promise(&self, count: u64, what: impl Display, needed: u64) -> Result<()> {
        match self.remaining() {
            Some(left) if left < needed => Err(Error::input(format!(
                "the header promises {count} {what}, which take at least {needed} bytes, but only {left} \
                 bytes follow: \
                 the file is cut off or its header is wrong"
            ))),
            _ => Ok(()),
        }
    }

    /// A safe number of entries to reserve for a promised count of records of at least `least` bytes each.
    pub(crate) fn reserve(&self, promised: u64, least: u64) -> usize {
        let holds = self.remaining().map_or(BUFFER_BYTES as u64, |bytes| bytes / least.max(1) + 1);
        usize::try_from(promised.min(holds)).unwrap_or(0)
    }

    /// Reads more behind what is buffered; false at the end of the file.
    fn fill(&mut self) -> Result<bool> {
        if self.start > 0 {
            self.buffer.copy_within(self.start..self.end, 0);
            self.end -= self.start;
            self.start = 0;
        }
        if self.end == self.buffer.len() {
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
                    // The decoder's own complaints; the disk's are of other kinds.
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

    /// The next line without its end, `None` after the last. A last line needs no end.
    pub(crate) fn line(&mut self) -> Result<Option<&[u8]>> {
        let mut searched = 0;
        let length = loop {
            let unseen = &self.buffer[self.start + searched..self.end];
            if let Some(at) = unseen.iter().position(|&b| b == b'\n') {
                break searched + at + 1;
            }
            searched = self.end - self.start;
            if searched > MAX_LINE_BYTES {
                let line = self.lines + 1;
                return Err(Error::input(format!(
                    "line {line}: longer than {MAX_LINE_BYTES} bytes: is this a text file?"
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

    /// The next `n` bytes, `None` where fewer are left.
    pub(crate) fn bytes(&mut self, n: usize) -> Result<Option<&[u8]>> {
        if self.remaining().is_some_and(|left| left < n as u64) {
            return Ok(None);
        }
        while self.end - self.start < n {
            if !self.fill()? {
                return Ok(None);
            }
        }
        Ok(Some(self.take(n)))
    }

    /// All that is left.
    pub(crate) fn rest(mut self) -> Result<Vec<u8>> {
        while self.fill()? {}
        self.buffer.truncate(self.end);
        self.buffer.drain(..self.start);
        Ok(self.buffer)
    }

    /// Passes over blanks to the end of the file; the place of the first byte that is none, where there is
    /// one.
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

    /// The next `n` bytes, fewer where the file ends before; they are handed out again.
    pub(crate) fn peek(&mut self, n: usize) -> Result<&[u8]> {
        while self.end - self.start < n {
            if !self.fill()? {
                break;
            }
        }
        let found = n.min(self.end - self.start);
        Ok(&self.buffer[self.start..self.start + found])
    }

    /// Passes over `n` bytes; false where fewer are left.
    pub(crate) fn skip(&mut self, n: u64) -> Result<bool> {
        let mut left = n;
        loop {
            let buffered = self.end - self.start;
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

/// A number as text files write it, to the last bit; `None` where it is none.
///
/// Besides what Rust reads (`1`, `-1.5e-3`, `.5`, `nan`, `inf`) the printed forms of Microsoft's older
/// run-time library (`1.#QNAN`, `-nan(ind)`, `1.#INF`) are taken as not finite.
#[inline]
pub(crate) fn parse_number(text: &[u8]) -> Option<f64> {
    // Counts and indices: short runs of digits are exact without the general machinery.
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

/// The next run of bytes between blanks.
#[inline]
pub(crate) fn next_word<'a>(line: &mut &'a [u8]) -> Option<&'a [u8]> {
    let start = line.iter().position(|b| !b.is_ascii_whitespace())?;
    let rest = &line[start..];
    let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
    *line = &rest[end..];
    Some(&rest[..end])
}

/// Bytes for a message: as text, cut short.
pub(crate) fn shown(bytes: &[u8]) -> String {
    const MAX_CHARS: usize = 40;
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
    fn compressed_files_read_as_what_they_were_and_damaged_ones_say_so() {
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
    fn a_small_file_that_unpacks_to_gigabytes_is_refused_early() {
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
        assert!(error.to_string().contains("would fill the memory"), "{error}");
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
    fn an_endless_line_is_refused_before_it_fills_the_memory() {
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
