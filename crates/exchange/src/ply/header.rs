//! Headers of PLY files.
//!
//! **Input.** The lines of a file up to `end_header`.
//!
//! **Output.** The elements and properties that the header declares. Whether the file contains them is
//! checked by [`super::body`].

use std::io::Read;

use planish_estimate::{Error, Result};

use crate::Unit;
use crate::numbers::NumberType;
use crate::source::{Source, shown};

/// Maximum number of elements of a file and of properties of an element.
///
/// Names are searched linearly, so a header of a million names would take quadratic time. Far above what
/// programs write. Guarded by `headers_of_a_million_names_are_rejected_at_once`.
const MAX_NAMES: usize = 4096;

/// Encoding of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Encoding {
    Ascii,
    Little,
    Big,
}

/// A property: one number, or a list of numbers preceded by its length.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Property {
    pub(crate) name: String,
    /// Type of the length, for a list.
    pub(crate) length: Option<NumberType>,
    pub(crate) number: NumberType,
}

/// A kind of record and the number of its records.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) count: u64,
    pub(crate) properties: Vec<Property>,
}

/// Content of a header.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Header {
    pub(crate) encoding: Encoding,
    pub(crate) elements: Vec<Element>,
    /// `obj_info num_cols` and `num_rows`: size of the sampling grid, as in the scans of the Stanford
    /// repository.
    pub(crate) grid_columns: Option<u64>,
    pub(crate) grid_rows: Option<u64>,
    /// `obj_info is_cyberware_data 1`: the scanner looked along −z.
    pub(crate) cyberware: bool,
    /// `comment unit mm`, as Planish writes it: the format itself has no unit.
    pub(crate) unit: Option<Unit>,
}

impl Header {
    pub(crate) fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|e| e.name == name)
    }
}

/// Adds a property to the last element; `words` follow `property`, and `wrong` makes the error of the line.
fn add_property(header: &mut Header, words: &[&str], wrong: &dyn Fn(&str) -> Error) -> Result<()> {
    let (name, length, number) = match *words {
        ["list", length, item, name] => {
            // A floating-point length could be a fraction or NaN.
            let length =
                NumberType::parse(length).filter(|t| !matches!(t, NumberType::F32 | NumberType::F64));
            let length = length.ok_or_else(|| wrong("a list length of an integer type"))?;
            (name, Some(length), NumberType::parse(item))
        }
        [number, name] => (name, None, NumberType::parse(number)),
        _ => return Err(wrong("`property TYPE NAME` or `property list TYPE TYPE NAME`")),
    };
    let number = number.ok_or_else(|| wrong("a type among char … double, int8 … float64"))?;
    let Some(element) = header.elements.last_mut() else {
        return Err(wrong("an `element` line before its properties"));
    };
    if element.properties.len() == MAX_NAMES {
        return Err(wrong(&format!("at most {MAX_NAMES} properties of an element")));
    }
    if element.properties.iter().any(|p| p.name == name) {
        return Err(wrong("a name that no other property of the element uses"));
    }
    element.properties.push(Property { name: name.to_owned(), length, number });
    Ok(())
}

/// Reads a header through `end_header`.
pub(crate) fn read_header<R: Read>(source: &mut Source<R>) -> Result<Header> {
    match source.line()? {
        None => return Err(Error::input("the file is empty")),
        Some(b"ply") => {}
        // Lines end at LF, so the header would be one line together with the body.
        Some(line) if line.starts_with(b"ply\r") => {
            return Err(Error::input(
                "line 1: expected lines that end in LF or CRLF, found a lone carriage return",
            ));
        }
        Some(line) => {
            return Err(Error::input(format!("line 1: expected `ply`, found {}", shown(line))));
        }
    }
    let mut encoding = None;
    let mut header = Header {
        encoding: Encoding::Ascii,
        elements: Vec::new(),
        grid_columns: None,
        grid_rows: None,
        cyberware: false,
        unit: None,
    };
    loop {
        let number = source.line_number() + 1;
        let Some(line) = source.line()? else {
            return Err(Error::input(format!(
                "line {number}: the file ends before `end_header`: it is cut off"
            )));
        };
        // Comments may be in any encoding, so invalid UTF-8 is replaced, not rejected.
        let text = String::from_utf8_lossy(line);
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let wrong = |expected: &str| {
            Error::input(format!("line {number}: expected {expected}, found {}", shown(line)))
        };
        match words[..] {
            ["end_header"] => break,
            // Comments are free text, so a word that is no unit is not an error.
            ["comment", "unit", name] => header.unit = name.parse().ok(),
            [] | ["comment", ..] => {}
            ["obj_info", "num_cols", n] => {
                header.grid_columns = Some(n.parse().map_err(|_| wrong("a number of columns"))?)
            }
            ["obj_info", "num_rows", n] => {
                header.grid_rows = Some(n.parse().map_err(|_| wrong("a number of rows"))?)
            }
            ["obj_info", "is_cyberware_data", flag] => header.cyberware = flag == "1",
            ["obj_info", ..] => {}
            ["format", name, version] => {
                if encoding.is_some() {
                    return Err(wrong("one `format` line"));
                }
                encoding = Some(match name {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    _ => return Err(wrong("`ascii`, `binary_little_endian` or `binary_big_endian`")),
                });
                if version != "1.0" {
                    return Err(wrong("version 1.0"));
                }
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| wrong("a count that is not negative"))?;
                if header.element(name).is_some() {
                    return Err(wrong("a name that no other element uses"));
                }
                if header.elements.len() == MAX_NAMES {
                    return Err(wrong(&format!("at most {MAX_NAMES} elements")));
                }
                header.elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
            }
            ["property", ref words @ ..] => add_property(&mut header, words, &wrong)?,
            _ => {
                return Err(wrong("`format`, `comment`, `obj_info`, `element`, `property` or `end_header`"));
            }
        }
    }
    header.encoding =
        encoding.ok_or_else(|| Error::input("expected a `format` line in the header, found none"))?;
    Ok(header)
}
