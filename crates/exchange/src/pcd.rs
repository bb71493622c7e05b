//! PCD, the point clouds of the Point Cloud Library: ASCII, binary and binary_compressed.
//!
//! **Input.** A header of `KEY value …` lines through `DATA`, and one record per point.
//!
//! **Output.** A [`Scan`] at the identity pose.
//!
//! **Fields.** `x y z`; `normal_x normal_y normal_z` or `nx ny nz`; `sigma` or `cxx cxy cxz cyy cyz czz`;
//! `sigma_n_deg`. Other fields are ignored. A cloud with more than one row (`HEIGHT`) is organised: it gives
//! the sampling grid. `VIEWPOINT` is the position of the scanner. Its default, the origin, is used only for
//! organised clouds, because other clouds also state it when the position is unknown.
//!
//! **Limits.** The rotation of `VIEWPOINT` is not applied.

use planish_core::{Budget, DVec3};
use std::io::Read;
use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::{Scan, Viewing};

use crate::numbers::NumberType;
use crate::points::{PointCollector, PointColumns, grid_without};
use crate::source::{DATA_RATIO, Source, next_word, parse_number, read_file, shown};

/// A field of a record: `count` numbers of one type.
struct Field {
    name: String,
    number: NumberType,
    count: usize,
}

/// Encoding of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Ascii,
    Binary,
    Compressed,
}

struct Header {
    fields: Vec<Field>,
    width: u64,
    height: u64,
    points: u64,
    viewpoint: Option<DVec3>,
    encoding: Encoding,
}

impl Header {
    /// Size of a binary record in bytes.
    fn record_size(&self) -> u64 {
        self.fields.iter().map(|f| (f.count * f.number.size()) as u64).sum()
    }

    /// Names of the columns, one per number. Fields of several numbers, such as histograms, get empty names.
    fn columns(&self) -> Vec<&str> {
        self.fields
            .iter()
            .flat_map(|f| {
                let name = match (f.count, f.name.as_str()) {
                    (1, "normal_x") => "nx",
                    (1, "normal_y") => "ny",
                    (1, "normal_z") => "nz",
                    (1, name) => name,
                    _ => "",
                };
                std::iter::repeat_n(name, f.count)
            })
            .collect()
    }

    /// Types of the columns, one per number.
    fn types(&self) -> Vec<NumberType> {
        self.fields.iter().flat_map(|f| std::iter::repeat_n(f.number, f.count)).collect()
    }
}

/// Reads points. Records with a coordinate that is not finite are dropped and counted; in an organised cloud
/// they are empty cells.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable,
/// [`Input`](planish_estimate::ErrorKind::Input) when it is malformed, cut off, or states a σ or covariance
/// that is not positive: with the file and the line or byte.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("cloud.pcd");
/// std::fs::write(&path, "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\n\
///     POINTS 2\nDATA ascii\n1 2 3\n4 5 6\n")?;
/// let scan = planish_exchange::pcd::read_pcd(&path)?;
/// assert_eq!(scan.points, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_pcd(path: &Path) -> Result<Scan> {
    read_file(path, |mut source, name| scan_from(&mut source, name))
}

/// Maximum count of numbers per record. It limits the memory that a malformed header can request, and is far
/// above the records that scanners write.
const MAX_COLUMNS: usize = 1 << 16;

/// Entries of the header as they appear in the file, before they are checked against each other.
#[derive(Default)]
struct HeaderEntries {
    names: Vec<String>,
    sizes: Vec<String>,
    kinds: Vec<String>,
    counts: Vec<String>,
    width: Option<u64>,
    height: Option<u64>,
    points: Option<u64>,
    viewpoint: Option<DVec3>,
}

impl HeaderEntries {
    /// Parses a line of the header; returns the encoding for `DATA`, the last line.
    fn line(&mut self, line: &[u8], number: u64) -> Result<Option<Encoding>> {
        let text = String::from_utf8_lossy(line);
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let wrong = |expected: &str| {
            Error::input(format!("line {number}: expected {expected}, found {}", shown(line)))
        };
        let count = |word: &str| word.parse::<u64>().map_err(|_| wrong("a count that is not negative"));
        let owned = |words: &[&str]| words.iter().map(|&w| w.to_owned()).collect::<Vec<String>>();
        match words[..] {
            [] | ["VERSION", ..] => {}
            [first, ..] if first.starts_with('#') => {}
            ["FIELDS" | "COLUMNS", ref rest @ ..] => self.names = owned(rest),
            ["SIZE", ref rest @ ..] => self.sizes = owned(rest),
            ["TYPE", ref rest @ ..] => self.kinds = owned(rest),
            ["COUNT", ref rest @ ..] => self.counts = owned(rest),
            ["WIDTH", n] => self.width = Some(count(n)?),
            ["HEIGHT", n] => self.height = Some(count(n)?),
            ["POINTS", n] => self.points = Some(count(n)?),
            ["VIEWPOINT", ref rest @ ..] => {
                let numbers: Option<Vec<f64>> = rest.iter().map(|w| parse_number(w.as_bytes())).collect();
                match numbers.as_deref() {
                    // The quaternion is not used: only the position of the scanner matters.
                    Some(&[x, y, z, _, _, _, _]) if [x, y, z].iter().all(|c| c.is_finite()) => {
                        self.viewpoint = Some(DVec3::new(x, y, z));
                    }
                    _ => return Err(wrong("seven numbers: tx ty tz qw qx qy qz")),
                }
            }
            ["DATA", "ascii"] => return Ok(Some(Encoding::Ascii)),
            ["DATA", "binary"] => return Ok(Some(Encoding::Binary)),
            ["DATA", "binary_compressed"] => return Ok(Some(Encoding::Compressed)),
            ["DATA", ..] => return Err(wrong("`ascii`, `binary` or `binary_compressed`")),
            _ => {
                return Err(wrong(
                    "`VERSION`, `FIELDS`, `SIZE`, `TYPE`, `COUNT`, `WIDTH`, `HEIGHT`, `VIEWPOINT`, `POINTS` \
                     or `DATA`",
                ));
            }
        }
        Ok(None)
    }

    /// Combines `FIELDS`, `SIZE`, `TYPE` and `COUNT`. Without `COUNT`, each field has one number.
    fn fields(&self) -> Result<Vec<Field>> {
        let ones = vec!["1".to_owned(); self.names.len()];
        let counts = if self.counts.is_empty() { &ones } else { &self.counts };
        for (key, found) in [("SIZE", self.sizes.len()), ("TYPE", self.kinds.len()), ("COUNT", counts.len())]
        {
            if found != self.names.len() {
                return Err(Error::input(format!(
                    "the header: expected {} entries in `{key}`, one per field, found {found}",
                    self.names.len()
                )));
            }
        }
        let fields = self
            .names
            .iter()
            .zip(self.sizes.iter().zip(&self.kinds))
            .zip(counts)
            .map(|((name, (size, kind)), count)| field(name, size, kind, count))
            .collect::<Result<Vec<_>>>()?;
        if fields.iter().map(|f| f.count).sum::<usize>() > MAX_COLUMNS {
            return Err(Error::input(format!(
                "expected at most {MAX_COLUMNS} numbers per record, found more"
            )));
        }
        Ok(fields)
    }

    /// Width, height and number of points. `POINTS` alone describes a cloud of one row.
    fn dimensions(&self) -> Result<(u64, u64, u64)> {
        match (self.width, self.height.unwrap_or(1), self.points) {
            (Some(width), height, points) => {
                let area = u64::checked_mul(width, height).ok_or_else(|| {
                    Error::input(format!(
                        "the header declares {width} × {height} points, which no file can hold: correct \
                         `WIDTH` or `HEIGHT`"
                    ))
                })?;
                if let Some(points) = points.filter(|&points| points != area) {
                    return Err(Error::input(format!(
                        "the header declares {points} points, but `WIDTH` × `HEIGHT` is {area}"
                    )));
                }
                Ok((width, height, area))
            }
            (None, 0..=1, Some(points)) => Ok((points, 1, points)),
            (None, _, Some(_)) => {
                Err(Error::input("expected `WIDTH` in the header with `HEIGHT`, found none"))
            }
            (None, _, None) => Err(Error::input("expected `POINTS` or `WIDTH` in the header, found neither")),
        }
    }
}

/// A field of the header from its name and its entries in `SIZE`, `TYPE` and `COUNT`.
fn field(name: &str, size: &str, kind: &str, count: &str) -> Result<Field> {
    let number = NumberType::of_kind(kind, size).ok_or_else(|| {
        Error::input(format!(
            "the field `{name}`: expected a type I or U of 1, 2, 4 or 8 bytes, or F of 4 or 8, found {kind} \
             of {size}"
        ))
    })?;
    let count = count.parse().ok().filter(|&n: &usize| n <= MAX_COLUMNS).ok_or_else(|| {
        Error::input(format!("the field `{name}`: expected a count, found {}", shown(count.as_bytes())))
    })?;
    Ok(Field { name: name.to_owned(), number, count })
}

/// Reads the header through its `DATA` line.
fn read_header<R: Read>(source: &mut Source<R>) -> Result<Header> {
    let mut entries = HeaderEntries::default();
    let encoding = loop {
        let number = source.line_number() + 1;
        let Some(line) = source.line()? else {
            return Err(Error::input(format!(
                "line {number}: the file ends before `DATA`: it is cut off or not a PCD file"
            )));
        };
        if let Some(encoding) = entries.line(line, number)? {
            break encoding;
        }
    };
    let fields = entries.fields()?;
    let (width, height, points) = entries.dimensions()?;
    Ok(Header { fields, width, height, points, viewpoint: entries.viewpoint, encoding })
}

fn scan_from<R: Read>(source: &mut Source<R>, name: &str) -> Result<Scan> {
    let header = read_header(source)?;
    let columns = PointColumns::find(&header.columns()).map_err(|e| e.in_context("`FIELDS`"))?;
    // Minimum number of bytes per point, as a fraction: compressed points may take less than one.
    let (bytes, of_points) = match header.encoding {
        // At least a digit and a blank for each number.
        Encoding::Ascii => (2 * header.columns().len() as u64, 1),
        Encoding::Binary => (header.record_size(), 1),
        Encoding::Compressed => (header.record_size(), MAX_EXPANSION),
    };
    let needed = header.points.saturating_mul(bytes) / of_points;
    // The last line of a text file may lack its end.
    let needed = needed.saturating_sub(u64::from(header.encoding == Encoding::Ascii));
    source.check_promise(header.points, "points", needed)?;
    // Only compressed points may take more than a fixed multiple of the file.
    let budget = match (header.encoding, source.remaining()) {
        (Encoding::Compressed, Some(length)) => Budget::of_compressed(length, DATA_RATIO),
        _ => source.budget().clone(),
    };
    let reserve = source.reserve(header.points, bytes / of_points);
    let mut collector = PointCollector::new(columns, reserve, &budget);
    match header.encoding {
        Encoding::Ascii => read_text(source, &header, &mut collector)?,
        Encoding::Binary => read_binary(source, &header, &mut collector)?,
        Encoding::Compressed => read_compressed(source, &header, &mut collector, &budget)?,
    }
    let (mut scan, dropped) = collector.finish(name);
    if header.height > 1 {
        let side = |n: u64| {
            usize::try_from(n).map_err(|_| Error::unsupported("the grid is too large for this computer"))
        };
        scan.grid = Some(grid_without(side(header.width)?, side(header.height)?, &dropped));
    }
    // The origin is the default of the format and is also written if the position is unknown. Only an
    // organised cloud, which comes from one place, makes it credible.
    scan.viewing = match header.viewpoint {
        Some(origin) if header.height > 1 || origin != DVec3::ZERO => Viewing::Origin(origin),
        _ => Viewing::Unknown,
    };
    Ok(scan)
}

fn cut_off(place: impl std::fmt::Display, header: &Header, found: u64) -> Error {
    Error::input(format!(
        "{place}: the file ends here: it is cut off ({} points declared, {found} found)",
        header.points
    ))
}

fn read_text<R: Read>(source: &mut Source<R>, header: &Header, collector: &mut PointCollector) -> Result<()> {
    let width = header.columns().len();
    let mut record = vec![0.0; width];
    for point in 0..header.points {
        let (number, mut line) = loop {
            let number = source.line_number() + 1;
            match source.line()? {
                None => return Err(cut_off(format_args!("line {number}"), header, point)),
                Some(line) if line.iter().all(u8::is_ascii_whitespace) => {}
                Some(line) => break (number, line),
            }
        };
        for (found, value) in record.iter_mut().enumerate() {
            let word = next_word(&mut line).ok_or_else(|| {
                Error::input(format!("line {number}: expected {width} numbers, found {found}"))
            })?;
            *value = parse_number(word).ok_or_else(|| {
                Error::input(format!("line {number}: expected a number, found {}", shown(word)))
            })?;
        }
        if let Some(word) = next_word(&mut line) {
            return Err(Error::input(format!(
                "line {number}: expected the end of the line, found {} more",
                shown(word)
            )));
        }
        collector.push(&record, format_args!("line {number}"))?;
    }
    Ok(())
}

fn read_binary<R: Read>(
    source: &mut Source<R>,
    header: &Header,
    collector: &mut PointCollector,
) -> Result<()> {
    let types = header.types();
    let size = types.iter().map(|t| t.size()).sum();
    let mut record = vec![0.0; types.len()];
    for point in 0..header.points {
        let byte = source.offset();
        let Some(mut bytes) = source.bytes(size)? else {
            return Err(cut_off(format_args!("byte {byte}"), header, point));
        };
        for (value, number) in record.iter_mut().zip(&types) {
            let (head, rest) = bytes.split_at(number.size());
            *value = number.decode::<false>(head);
            bytes = rest;
        }
        collector.push(&record, format_args!("byte {byte} (point {point})"))?;
    }
    Ok(())
}

/// Reads a body that is compressed as a whole, with all numbers of a field stored together.
fn read_compressed<R: Read>(
    source: &mut Source<R>,
    header: &Header,
    collector: &mut PointCollector,
    budget: &Budget,
) -> Result<()> {
    let byte = source.offset();
    let Some(sizes) = source.bytes(8)? else {
        return Err(cut_off(format_args!("byte {byte}"), header, 0));
    };
    let word = |k: usize| NumberType::U32.decode::<false>(&sizes[4 * k..4 * k + 4]) as u64;
    let (packed, unpacked) = (word(0), word(1));
    let needed = header.points.saturating_mul(header.record_size());
    // The file states both sizes. They are compared before memory is allocated.
    if unpacked != needed {
        return Err(Error::input(format!(
            "byte {byte}: {} points of {} bytes take {needed} bytes, but the compressed body states \
             {unpacked}",
            header.points,
            header.record_size()
        )));
    }
    if unpacked > packed.saturating_mul(MAX_EXPANSION) {
        return Err(Error::input(format!(
            "byte {byte}: {packed} compressed bytes cannot hold {unpacked}: the file is damaged"
        )));
    }
    budget.take_elements(1, unpacked, format_args!("bytes of the body (byte {byte})"))?;
    let size =
        usize::try_from(packed).map_err(|_| Error::unsupported("the file is too large for this computer"))?;
    let Some(bytes) = source.bytes(size)? else {
        return Err(cut_off(format_args!("byte {byte}"), header, 0));
    };
    let body = unpack(bytes, usize::try_from(unpacked).unwrap_or(0)).ok_or_else(|| {
        Error::input(format!(
            "byte {byte}: the compressed body is damaged: it does not unpack to {unpacked} bytes"
        ))
    })?;
    // Unpacked, the fields follow each other. Within a field, the numbers of one point are adjacent.
    let points = usize::try_from(header.points).unwrap_or(0);
    let mut columns = Vec::new();
    let mut start = 0;
    for field in &header.fields {
        let stride = field.count * field.number.size();
        columns.extend((0..field.count).map(|k| (field.number, start + k * field.number.size(), stride)));
        start += points * stride;
    }
    let mut record = vec![0.0; columns.len()];
    for point in 0..points {
        for (value, &(number, first, stride)) in record.iter_mut().zip(&columns) {
            let at = first + point * stride;
            *value = number.decode::<false>(&body[at..at + number.size()]);
        }
        collector.push(&record, format_args!("point {point}"))?;
    }
    Ok(())
}

/// Maximum ratio of LZF: a copy of three bytes stands for at most 264 (length 7 + 255 + 2).
const MAX_EXPANSION: u64 = 88;

/// Unpacks LZF; `None` if the data are malformed or do not give `length` bytes.
///
/// A control byte `000lllll` precedes `l + 1` literal bytes. `lllooooo oooooooo` copies `l + 2` bytes,
/// starting `o + 1` bytes back; for `l = 7`, another byte before the second one is added to the length.
///
/// # References
/// M. Lehmann, *LibLZF* (`lzf_d.c`).
fn unpack(packed: &[u8], length: usize) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(length);
    let mut rest = packed;
    while let Some((&control, after)) = rest.split_first() {
        let control = usize::from(control);
        if control < 32 {
            let (run, after) = after.split_at_checked(control + 1)?;
            out.extend_from_slice(run);
            rest = after;
        } else {
            let (longer, after) = match control >> 5 {
                7 => (usize::from(*after.first()?), &after[1..]),
                _ => (0, after),
            };
            let (&low, after) = after.split_first()?;
            let copied = (control >> 5) + longer + 2;
            let from = out.len().checked_sub(((control & 31) << 8) + usize::from(low) + 1)?;
            // Byte by byte, because a copy may overlap its own output: that is how runs are encoded.
            for k in from..from + copied {
                out.push(out[k]);
            }
            rest = after;
        }
        // Stops early, so that damaged data cannot grow the output without limit.
        if out.len() > length {
            return None;
        }
    }
    (out.len() == length).then_some(out)
}

#[cfg(test)]
mod tests;
