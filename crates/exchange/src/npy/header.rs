//! The header of an NPY file: a Python dictionary that names shape, order and type of what follows.

use std::io::Read;

use planish_estimate::{Error, Result};

use crate::numbers::NumberType;
use crate::points::is_point_column;
use crate::source::{Source, shown};

/// A longer header is no header.
const MAX_HEADER_BYTES: u64 = 1 << 20;
/// Lists in lists are not deeper in any header.
const MAX_DEPTH: usize = 8;
/// Most numbers of an element.
const MAX_NUMBERS: u64 = 1 << 16;

/// One number of an element.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Field {
    /// The column that it is; empty where it is none.
    pub name: String,
    pub number: NumberType,
    pub big: bool,
    /// Bytes of the element before it.
    pub offset: usize,
}

/// What follows the header.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub shape: Vec<u64>,
    pub columns_first: bool,
    /// The numbers of an element: one, unnamed, where the array is not structured.
    pub fields: Vec<Field>,
    /// Bytes of an element.
    pub size: usize,
    pub structured: bool,
}

pub(super) fn read_header<R: Read>(source: &mut Source<R>) -> Result<Header> {
    let no_npy =
        || Error::input("byte 0: expected `\\x93NUMPY` and a version: this is no NPY file, or it is cut off");
    let start = source.bytes(8)?.ok_or_else(no_npy)?;
    if !start.starts_with(b"\x93NUMPY") {
        return Err(no_npy());
    }
    let version = start[6];
    let width = match version {
        1 => 2,
        2 | 3 => 4,
        _ => {
            return Err(Error::unsupported(format!("byte 6: expected version 1, 2 or 3, found {version}")));
        }
    };
    let cut_off =
        |byte: u64| Error::input(format!("byte {byte}: the file ends within its header: it is cut off"));
    let length = source
        .bytes(width)?
        .map(|bytes| bytes.iter().rev().fold(0, |n, &b| n << 8 | u64::from(b)))
        .ok_or_else(|| cut_off(8))?;
    if length > MAX_HEADER_BYTES {
        return Err(Error::input(format!("byte 8: a header of {length} bytes: the file is damaged")));
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

    /// A field of a structured array: its name, its type, and maybe a shape.
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
        // A title may stand before the name.
        let name = match name {
            Literal::List(both) => both.last().unwrap_or(name),
            _ => name,
        };
        let Literal::Text(name) = name else {
            return Err(wrong());
        };
        let Literal::Text(kind) = kind else {
            return Err(Error::unsupported(format!(
                "the field '{name}' is structured itself: write its fields beside the others"
            )));
        };
        let count = shape.iter().try_fold(1_u64, |n, &side| n.checked_mul(side));
        let count = count.filter(|&n| n + self.fields.len() as u64 <= MAX_NUMBERS).ok_or_else(|| {
            Error::input(format!("the field '{name}': an element of more than {MAX_NUMBERS} numbers"))
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

    /// Numbers of a type, behind those that were added before; of other types only the bytes count.
    fn add(&mut self, names: Vec<String>, kind: &str) -> Result<()> {
        let unknown = || {
            Error::unsupported(format!(
                "expected integers or floating-point numbers, found the type '{kind}'"
            ))
        };
        let (order, rest) = match kind.as_bytes() {
            [order @ (b'<' | b'>' | b'|' | b'='), rest @ ..] => (*order, rest),
            rest => (b'=', rest),
        };
        let (&letter, digits) = rest.split_first().ok_or_else(unknown)?;
        let digits = std::str::from_utf8(digits).map_err(|_| unknown())?;
        // Dates have their unit behind: <M8[ns].
        let digits = digits.split('[').next().unwrap_or_default();
        let stated: usize = digits.parse().ok().filter(|&n: &usize| n <= 1 << 20).ok_or_else(unknown)?;
        let number = match letter {
            b'b' => NumberType::of_kind("U", "1").filter(|_| stated == 1),
            b'f' => NumberType::of_kind("F", digits),
            b'i' => NumberType::of_kind("I", digits),
            b'u' => NumberType::of_kind("U", digits),
            _ => None,
        };
        let bytes = match letter {
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
                return Err(Error::input(format!("the column `{name}` is there twice")));
            }
            self.fields.push(Field { name, number, big: order == b'>', offset: self.size });
            self.size += bytes;
        }
        Ok(())
    }

    /// How many elements, and how many bytes they take; as many as there can be where that is too many to
    /// count.
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

/// A Python literal, as far as headers use them; tuples are lists.
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
    /// The next byte that is no blank.
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
            return Err(self.wrong("fewer lists in lists"));
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
        // Python 2 wrote long integers so.
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

    /// Whether the end comes next, or a comma before more.
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
