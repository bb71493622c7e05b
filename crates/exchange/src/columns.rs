//! Columns of CSV files with a header.

use crate::source::{parse_number, read_file, shown};
use planish_estimate::{Error, Result};
use std::path::Path;

/// The number of a line, and its words.
pub(crate) type Row = (u64, Vec<Option<String>>);

/// Reads a CSV file with a header: for each line its number and the words of the named columns, `None` for a
/// missing column. The first `needed` columns are required.
pub(crate) fn read_columns(path: &Path, names: &[&str], needed: usize) -> Result<Vec<Row>> {
    read_file(path, |mut source, _| {
        let mut header: Option<Vec<Option<usize>>> = None;
        let mut rows = Vec::new();
        let mut number = 0;
        while let Some(line) = source.line()? {
            number += 1;
            // Byte order mark, which some Windows programs put before UTF-8.
            let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line).trim_ascii();
            if line.is_empty() || line.starts_with(b"#") {
                continue;
            }
            let words: Vec<&[u8]> = line.split(|&b| b == b',').map(<[u8]>::trim_ascii).collect();
            match &header {
                None => {
                    let places: Vec<Option<usize>> = (names.iter())
                        .map(|name| words.iter().position(|word| *word == name.as_bytes()))
                        .collect();
                    if places[..needed].contains(&None) {
                        return Err(Error::input(format!(
                            "line {number}: expected a header with {}, found {}",
                            names[..needed].join(","),
                            shown(line)
                        )));
                    }
                    header = Some(places);
                }
                Some(places) => {
                    let mut row = Vec::with_capacity(names.len());
                    for (place, name) in places.iter().zip(names) {
                        row.push(match place {
                            None => None,
                            Some(place) => match words.get(*place).filter(|word| !word.is_empty()) {
                                Some(word) => Some(String::from_utf8_lossy(word).into_owned()),
                                None => {
                                    return Err(Error::input(format!(
                                        "line {number}: expected a value in the column {name}, found none"
                                    )));
                                }
                            },
                        });
                    }
                    rows.push((number, row));
                }
            }
        }
        Ok(rows)
    })
}

/// The number in a column, or `fallback` without that column.
pub(crate) fn number(line: u64, word: Option<&str>, fallback: f64, positive: bool) -> Result<f64> {
    let Some(word) = word else { return Ok(fallback) };
    match parse_number(word.as_bytes()) {
        Some(value) if value.is_finite() && (value > 0.0 || !positive) => Ok(value),
        _ => Err(Error::input(format!(
            "line {line}: expected a {} number, found `{word}`",
            if positive { "finite positive" } else { "finite" }
        ))),
    }
}
