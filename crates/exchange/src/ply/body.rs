//! Bodies of PLY files: the elements in order, as rows of numbers.
//!
//! **Input.** A source positioned at the first row of an element.
//!
//! **Output.** Each row as `f64` (which holds every PLY type exactly) and at most one of its lists.
//!
//! Memory is not reserved from declared counts alone: they are compared with the size of the file before the
//! first row is read. Data after the last declared row, other than blanks, is an error, because a count that
//! is too small would lose measurements.

use std::fmt;
use std::io::Read;

use planish_estimate::{Error, Result};

use super::header::{Element, Encoding};
use crate::source::{Source, next_word, parse_number, shown};

/// Position of a row, for messages.
#[derive(Clone, Copy)]
pub(crate) struct Place<'a> {
    element: &'a str,
    row: u64,
    line: Option<u64>,
    byte: u64,
}

impl fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { element, row, line, byte } = self;
        match line {
            Some(line) => write!(f, "line {line} ({element} {row})"),
            None => write!(f, "byte {byte} ({element} {row})"),
        }
    }
}

/// One record of an element.
pub(crate) struct Row<'a> {
    /// One number per property; for a list, its length.
    pub(crate) values: &'a [f64],
    /// Items of the requested list.
    pub(crate) list: &'a [f64],
    pub(crate) place: Place<'a>,
}

fn cut_off(place: Place, promised: u64) -> Error {
    let Place { element, row, .. } = place;
    Error::input(format!(
        "{place}: the file ends here: it is cut off ({promised} records of `{element}` declared, {row} found)"
    ))
}

/// Minimum number of bytes of a row; lists count as empty.
fn min_row_bytes(element: &Element, encoding: Encoding) -> u64 {
    let sizes = element.properties.iter().map(|p| match encoding {
        // At least a digit, and a blank or line end.
        Encoding::Ascii => 2,
        Encoding::Little | Encoding::Big => p.length.unwrap_or(p.number).size() as u64,
    });
    sizes.sum()
}

/// Rejects a count that the rest of the file cannot hold; returns a safe number of rows to reserve.
pub(crate) fn check_count<R: Read>(
    source: &Source<R>,
    element: &Element,
    encoding: Encoding,
) -> Result<usize> {
    let row_bytes = min_row_bytes(element, encoding);
    // The last line of a text file may lack its end.
    let needed =
        element.count.saturating_mul(row_bytes).saturating_sub(u64::from(encoding == Encoding::Ascii));
    source.check_promise(element.count, format_args!("records of `{}`", element.name), needed)?;
    Ok(source.reserve(element.count, row_bytes))
}

/// Reads the rows of an element in order. `wanted_list` is the index of the list whose items are returned.
pub(crate) fn read_rows<R: Read>(
    source: &mut Source<R>,
    element: &Element,
    encoding: Encoding,
    wanted_list: Option<usize>,
    row: impl FnMut(&Row) -> Result<()>,
) -> Result<()> {
    // Again for each element, because only now the rest of the file behind the earlier ones is known.
    check_count(source, element, encoding)?;
    // Such rows take no bytes, so that no size of a file would bound the loop over them.
    if element.properties.is_empty() {
        return Ok(());
    }
    match encoding {
        Encoding::Ascii => read_text_rows(source, element, wanted_list, row),
        Encoding::Little => read_binary_rows::<R, false>(source, element, wanted_list, row),
        Encoding::Big => read_binary_rows::<R, true>(source, element, wanted_list, row),
    }
}

/// Skips an element.
///
/// Binary rows without lists have a fixed size and are skipped at once; others must be parsed to find their
/// end.
pub(crate) fn skip_rows<R: Read>(
    source: &mut Source<R>,
    element: &Element,
    encoding: Encoding,
) -> Result<()> {
    let has_lists = element.properties.iter().any(|p| p.length.is_some());
    if encoding == Encoding::Ascii || has_lists {
        return read_rows(source, element, encoding, None, |_| Ok(()));
    }
    check_count(source, element, encoding)?;
    let place = Place { element: &element.name, row: 0, line: None, byte: source.offset() };
    // Saturating: the count is not limited if the length of the file is unknown.
    match source.skip(element.count.saturating_mul(min_row_bytes(element, encoding)))? {
        true => Ok(()),
        false => Err(cut_off(place, element.count)),
    }
}

/// Rejects data after the last declared row, because they are measurements that would be lost (decision
/// 0042).
pub(crate) fn refuse_more<R: Read>(source: &mut Source<R>) -> Result<()> {
    let Some(byte) = source.more_than_blanks()? else {
        return Ok(());
    };
    let more = source.remaining().map_or("more".to_owned(), |n| format!("{n} more bytes"));
    Err(Error::input(format!(
        "byte {byte}: expected the end of the file, found {more}: the counts of the header are too small; \
         correct them, or cut the file there"
    )))
}

/// Length of a list, if the value is a valid count.
fn count_of(value: f64) -> Option<u64> {
    // Types of lengths have at most 32 bits.
    (value >= 0.0 && value <= f64::from(u32::MAX) && value.fract() == 0.0).then_some(value as u64)
}

fn read_text_rows<R: Read>(
    source: &mut Source<R>,
    element: &Element,
    wanted_list: Option<usize>,
    mut row: impl FnMut(&Row) -> Result<()>,
) -> Result<()> {
    let mut values = vec![0.0; element.properties.len()];
    let mut list = Vec::new();
    for index in 0..element.count {
        let (number, byte) = (source.line_number() + 1, source.offset());
        let mut place = Place { element: &element.name, row: index, line: Some(number), byte };
        let mut line = loop {
            let skipped = source.line_number() + 1;
            place.line = Some(skipped);
            match source.line()? {
                None => return Err(cut_off(place, element.count)),
                Some(line) if line.iter().all(u8::is_ascii_whitespace) => {}
                // Not copied: the line stays borrowed from the buffer until its words are parsed.
                Some(line) => break line,
            }
        };
        let too_short = |property: &str| Error::input(format!("{place}: the line ends before `{property}`"));
        let wrong = |property: &str, expected: &str, word: &[u8]| {
            Error::input(format!("{place}: expected {expected} for `{property}`, found {}", shown(word)))
        };
        for (k, property) in element.properties.iter().enumerate() {
            let name = property.name.as_str();
            let word = next_word(&mut line).ok_or_else(|| too_short(name))?;
            let value = parse_number(word).ok_or_else(|| wrong(name, "a number", word))?;
            values[k] = value;
            if property.length.is_some() {
                let items = count_of(value).ok_or_else(|| wrong(name, "a length", word))?;
                let wanted = wanted_list == Some(k);
                if wanted {
                    list.clear();
                }
                // The line bounds the loop: a damaged length fails at the first missing word.
                for _ in 0..items {
                    let word = next_word(&mut line).ok_or_else(|| too_short(name))?;
                    if wanted {
                        list.push(parse_number(word).ok_or_else(|| wrong(name, "numbers", word))?);
                    }
                }
            }
        }
        if let Some(word) = next_word(&mut line) {
            return Err(Error::input(format!(
                "{place}: expected the end of the line, found {} more",
                shown(word)
            )));
        }
        row(&Row { values: &values, list: &list, place })?;
    }
    Ok(())
}

fn read_binary_rows<R: Read, const BIG: bool>(
    source: &mut Source<R>,
    element: &Element,
    wanted_list: Option<usize>,
    mut row: impl FnMut(&Row) -> Result<()>,
) -> Result<()> {
    let mut values = vec![0.0; element.properties.len()];
    let mut list = Vec::new();
    // A row without lists has a fixed size and is read with one call, which is the fast path of large scans.
    let flat = element.properties.iter().all(|p| p.length.is_none());
    let row_size = element.properties.iter().map(|p| p.number.size()).sum();
    for index in 0..element.count {
        let place = Place { element: &element.name, row: index, line: None, byte: source.offset() };
        let ends = || cut_off(place, element.count);
        if flat {
            let mut bytes = source.bytes(row_size)?.ok_or_else(ends)?;
            for (value, property) in values.iter_mut().zip(&element.properties) {
                let (head, rest) = bytes.split_at(property.number.size());
                *value = property.number.decode::<BIG>(head);
                bytes = rest;
            }
        } else {
            for (k, property) in element.properties.iter().enumerate() {
                let first = property.length.unwrap_or(property.number);
                values[k] = first.decode::<BIG>(source.bytes(first.size())?.ok_or_else(ends)?);
                if property.length.is_none() {
                    continue;
                }
                let Some(items) = count_of(values[k]) else {
                    return Err(Error::input(format!(
                        "{place}: expected a length for `{}`, found {}",
                        property.name, values[k]
                    )));
                };
                let size = property.number.size();
                // Lists that are not requested are skipped without storing them.
                if wanted_list != Some(k) {
                    // At most 2³² items of eight bytes, so the product cannot overflow.
                    if !source.skip(items * size as u64)? {
                        return Err(ends());
                    }
                    continue;
                }
                list.clear();
                // Grown item by item, so that a damaged length reserves no memory before the file ends. All
                // lists share the memory of the longest.
                for _ in 0..items {
                    if list.len() == list.capacity() {
                        let bytes = size_of::<f64>() as u64;
                        let what = format_args!("list items ({place})");
                        source.budget().take_elements(list.len() as u64, bytes, what)?;
                    }
                    list.push(property.number.decode::<BIG>(source.bytes(size)?.ok_or_else(ends)?));
                }
            }
        }
        row(&Row { values: &values, list: &list, place })?;
    }
    Ok(())
}
