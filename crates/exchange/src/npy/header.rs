//! The header of an NPY file: a Python dictionary with the shape, order and type of the array.

use std::io::Read;

use planish_estimate::{Error, Result};

use crate::numbers::NumberType;
use crate::points::is_point_column;
use crate::source::{Source, shown};

/// Maximum length of a header. Version 2 allows 4 GiB; headers of structured arrays have some kilobytes.
const MAX_HEADER_BYTES: u64 = 1 << 20;
/// Maximum nesting of lists, which bounds the recursion of the parser.
const MAX_DEPTH: usize = 8;
/// Maximum number of numbers per element, which bounds the memory that a header can request.
const MAX_NUMBERS: u64 = 1 << 16;

/// One number of an element.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Field {
    /// Column name; empty if the number is not a column.
    pub name: String,
    pub number: NumberType,
    pub big: bool,
    /// Offset in the element, in bytes.
    pub offset: usize,
}

/// Description of the array that follows the header.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub shape: Vec<u64>,
    pub columns_first: bool,
    /// The numbers of an element; a plain array has one without a name.
    pub fields: Vec<Field>,
    /// Size of an element in bytes.
    pub size: usize,
    pub structured: bool,
}

pub(super) fn read_header<R: Read>(source: &mut Source<R>) -> Result<Header> {
    let no_npy = || Error::input("byte 0: expected `\\x93NUMPY` and a version: not an NPY file, or cut off");
    let start = source.bytes(8)?.ok_or_else(no_npy)?;
    if !start.starts_with(b"\x93NUMPY") {
        return Err(no_npy());
    }
    let version = start[6];
    // Length of the field that states the length of the header, in bytes.
    let width = match version {
        1 => 2,
        2 | 3 => 4,
        _ => {
            return Err(Error::unsupported(format!("byte 6: expected version 1, 2 or 3, found {version}")));
        }
    };
    let cut_off =
        |byte: u64| Error::input(format!("byte {byte}: the file ends within its header: it is cut off"));
    // Little endian on every machine (NEP 1), unlike the numbers of the array.
    let length = source
        .bytes(width)?
        .map(|bytes| bytes.iter().rev().fold(0, |n, &b| n << 8 | u64::from(b)))
        .ok_or_else(|| cut_off(8))?;
    if length > MAX_HEADER_BYTES {
        return Err(Error::input(format!(
            "byte 8: expected a header of at most {MAX_HEADER_BYTES} bytes, found {length}: the file is \
             damaged"
        )));
    }
    let text = source.bytes(length as usize)?.ok_or_else(|| cut_off(8 + width as u64))?;
    let mut parser = Parser { text, at: 0 };
    parser
        .literal(0)
        .and_then(|literal| Header::from_literal(&literal))
        .map_err(|e| e.in_context(format_args!("header {}", shown(text))))
}

impl Header {
    /// Builds the header from the parsed Python dictionary.
    fn from_literal(literal: &Literal) -> Result<Self> {
        let entry = |key: &str| {
            let Literal::Dictionary(entries) = literal else {
                return Err(Error::input("expected a dictionary"));
            };
            // NumPy sorts the keys, but the format does not require an order.
            let found = entries.iter().find(|(name, _)| name == key);
            found.map(|(_, value)| value).ok_or_else(|| Error::input(format!("expected the key '{key}'")))
        };
        let Literal::Flag(columns_first) = entry("fortran_order")? else {
            return Err(Error::input("expected True or False for 'fortran_order'"));
        };
        let shape = shape(entry("shape")?)?;
        let mut made =
            Self { shape, columns_first: *columns_first, fields: Vec::new(), size: 0, structured: false };
        match entry("descr")? {
            Literal::Text(kind) => made.add(vec![String::new()], kind)?,
            Literal::List(fields) => {
                made.structured = true;
                for field in fields {
                    made.add_field(field)?;
                }
            }
            _ => return Err(Error::input("expected a type or a list of fields for 'descr'")),
        }
        if made.size == 0 {
            return Err(Error::input("expected elements of at least one byte"));
        }
        Ok(made)
    }

    /// Adds a field of a structured array: a name, a type, and optionally a shape.
    fn add_field(&mut self, field: &Literal) -> Result<()> {
        let wrong = || Error::input("expected fields ('name', 'type') or ('name', 'type', shape)");
        let Literal::List(parts) = field else {
            return Err(wrong());
        };
        let (name, kind, shape) = match &parts[..] {
            [name, kind] => (name, kind, Vec::new()),
            [name, kind, inner] => (name, kind, shape(inner)?),
            _ => return Err(wrong()),
        };
        // `(title, name)` may replace the name.
        let name = match name {
            Literal::List(both) => both.last().unwrap_or(name),
            _ => name,
        };
        let Literal::Text(name) = name else {
            return Err(wrong());
        };
        let Literal::Text(kind) = kind else {
            return Err(Error::unsupported(format!(
                "the field '{name}': expected a number type, found nested fields: write them as fields of \
                 the array"
            )));
        };
        let count = shape.iter().try_fold(1_u64, |n, &side| n.checked_mul(side));
        let count = count.filter(|&n| n + self.fields.len() as u64 <= MAX_NUMBERS).ok_or_else(|| {
            Error::input(format!(
                "the field '{name}': expected at most {MAX_NUMBERS} numbers per element, found more"
            ))
        })?;
        let lower = name.to_ascii_lowercase();
        let family: &[&str] = match (count, lower.as_str()) {
            (3, "xyz" | "points" | "position") => &["x", "y", "z"],
            (3, "normal" | "normals") => &["nx", "ny", "nz"],
            (6, "covariance") => &["cxx", "cxy", "cxz", "cyy", "cyz", "czz"],
            (1, _) => &[lower.as_str()],
            _ => &[],
        };
        let names = match family {
            [] => vec![String::new(); count as usize],
            family => family.iter().map(|&name| name.to_owned()).collect(),
        };
        self.add(names, kind)
    }

    /// Appends numbers of a type. Other types only advance the offset, so that text and dates beside points
    /// are accepted.
    fn add(&mut self, names: Vec<String>, kind: &str) -> Result<()> {
        let unknown = || {
            Error::unsupported(format!(
                "expected integers or floating-point numbers, found the type '{kind}'"
            ))
        };
        // A missing or native byte order is read as little endian.
        let (order, rest) = match kind.as_bytes() {
            [order @ (b'<' | b'>' | b'|' | b'='), rest @ ..] => (*order, rest),
            rest => (b'=', rest),
        };
        let (&letter, digits) = rest.split_first().ok_or_else(unknown)?;
        let digits = std::str::from_utf8(digits).map_err(|_| unknown())?;
        // The unit of dates follows in brackets: `<M8[ns]`.
        let digits = digits.split('[').next().unwrap_or_default();
        // The limit keeps the size of an element, a product with at most `MAX_NUMBERS`, far from an overflow.
        let stated: usize = digits.parse().ok().filter(|&n: &usize| n <= 1 << 20).ok_or_else(unknown)?;
        // Booleans are read as bytes. Half and extended precision have no `NumberType` and are rejected.
        let number = match letter {
            b'b' => NumberType::of_kind("U", "1").filter(|_| stated == 1),
            b'f' => NumberType::of_kind("F", digits),
            b'i' => NumberType::of_kind("I", digits),
            b'u' => NumberType::of_kind("U", digits),
            _ => None,
        };
        let bytes = match letter {
            // Characters of `U` have four bytes (UCS-4).
            b'U' => 4 * stated,
            b'b' | b'f' | b'i' | b'u' | b'c' | b'm' | b'M' | b'S' | b'V' => stated,
            _ => return Err(unknown()),
        };
        let Some(number) = number else {
            if !self.structured || names.iter().any(|name| is_point_column(name)) {
                return Err(unknown());
            }
            self.size += names.len() * bytes;
            return Ok(());
        };
        for name in names {
            if !name.is_empty() && self.fields.iter().any(|f| f.name == name) {
                return Err(Error::input(format!("the column `{name}` is named twice")));
            }
            self.fields.push(Field { name, number, big: order == b'>', offset: self.size });
            self.size += bytes;
        }
        Ok(())
    }

    /// Number of elements and of bytes, saturated at the largest `u64`.
    pub(super) fn extent(&self) -> (u64, u64) {
        let elements = self.shape.iter().fold(1_u64, |n, &side| n.saturating_mul(side));
        (elements, elements.saturating_mul(self.size as u64))
    }
}

fn shape(literal: &Literal) -> Result<Vec<u64>> {
    let wrong = || Error::input("expected a tuple of whole numbers for the shape");
    match literal {
        Literal::Number(side) => Ok(vec![*side]),
        Literal::List(sides) => sides
            .iter()
            .map(|side| match side {
                Literal::Number(side) => Ok(*side),
                _ => Err(wrong()),
            })
            .collect(),
        _ => Err(wrong()),
    }
}

/// A Python literal of the kinds that headers contain; tuples are lists.
#[derive(Debug, PartialEq)]
enum Literal {
    Text(String),
    Number(u64),
    Flag(bool),
    List(Vec<Literal>),
    Dictionary(Vec<(String, Literal)>),
}

struct Parser<'a> {
    text: &'a [u8],
    at: usize,
}

impl Parser<'_> {
    /// Next byte that is not white space.
    fn peek(&mut self) -> Option<u8> {
        while self.text.get(self.at).is_some_and(u8::is_ascii_whitespace) {
            self.at += 1;
        }
        self.text.get(self.at).copied()
    }

    fn wrong(&self, expected: &str) -> Error {
        Error::input(format!("byte {} of it: expected {expected}", self.at))
    }

    fn literal(&mut self, depth: usize) -> Result<Literal> {
        if depth > MAX_DEPTH {
            return Err(self.wrong("fewer nested lists"));
        }
        match self.peek() {
            Some(b'\'' | b'"') => self.string().map(Literal::Text),
            Some(b'0'..=b'9') => self.number(),
            Some(b'(') => self.list(b')', depth).map(Literal::List),
            Some(b'[') => self.list(b']', depth).map(Literal::List),
            Some(b'{') => self.dictionary(depth),
            _ => self.flag(),
        }
    }

    fn string(&mut self) -> Result<String> {
        // Escapes are not interpreted: no type and no column that is used contains one.
        let quote = self.text[self.at];
        let rest = &self.text[self.at + 1..];
        let end = rest.iter().position(|&b| b == quote);
        let end = end.ok_or_else(|| self.wrong("the end of a string"))?;
        self.at += end + 2;
        Ok(String::from_utf8_lossy(&rest[..end]).into_owned())
    }

    fn number(&mut self) -> Result<Literal> {
        let mut value = 0_u64;
        while let Some(digit @ b'0'..=b'9') = self.text.get(self.at) {
            let next = value.checked_mul(10).and_then(|v| v.checked_add(u64::from(digit - b'0')));
            value = next.ok_or_else(|| self.wrong("a smaller number"))?;
            self.at += 1;
        }
        // Python 2 wrote long integers with a suffix, as `3L`.
        if self.text.get(self.at) == Some(&b'L') {
            self.at += 1;
        }
        Ok(Literal::Number(value))
    }

    fn flag(&mut self) -> Result<Literal> {
        for (word, value) in [("True", true), ("False", false)] {
            if self.text[self.at..].starts_with(word.as_bytes()) {
                self.at += word.len();
                return Ok(Literal::Flag(value));
            }
        }
        Err(self.wrong("a string, a number, True, False, or a list of them"))
    }

    /// Consumes a comma or the end of a list; true at the end. A comma may precede the end, as in `(3,)`.
    fn ends(&mut self, end: u8) -> Result<bool> {
        match self.peek() {
            Some(found) if found == end => {
                self.at += 1;
                Ok(true)
            }
            Some(b',') => {
                self.at += 1;
                let over = self.peek() == Some(end);
                self.at += usize::from(over);
                Ok(over)
            }
            _ => Err(self.wrong("a comma or the end of a list")),
        }
    }

    fn list(&mut self, end: u8, depth: usize) -> Result<Vec<Literal>> {
        self.at += 1;
        let mut items = Vec::new();
        if self.peek() == Some(end) {
            self.at += 1;
            return Ok(items);
        }
        loop {
            items.push(self.literal(depth + 1)?);
            if self.ends(end)? {
                return Ok(items);
            }
        }
    }

    fn dictionary(&mut self, depth: usize) -> Result<Literal> {
        self.at += 1;
        let mut entries = Vec::new();
        loop {
            if !matches!(self.peek(), Some(b'\'' | b'"')) {
                return Err(self.wrong("a key"));
            }
            let key = self.string()?;
            if self.peek() != Some(b':') {
                return Err(self.wrong("`:`"));
            }
            self.at += 1;
            entries.push((key, self.literal(depth + 1)?));
            if self.ends(b'}')? {
                return Ok(Literal::Dictionary(entries));
            }
        }
    }
}
