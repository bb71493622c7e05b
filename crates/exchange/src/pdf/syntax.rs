//! Objects of PDF files and the operators of content streams.
//!
//! # References
//! ISO 32000-1:2008, section 7.2 (lexical conventions) and 7.3 (objects).

use planish_estimate::{Error, Result};
use std::collections::BTreeMap;

/// Maximum nesting of arrays and dictionaries, which bounds the recursion.
const MAX_DEPTH: usize = 64;

/// Keys without their slash.
pub(super) type Dictionary = BTreeMap<String, Object>;

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Object {
    Number(f64),
    Name(String),
    Text(Vec<u8>),
    Array(Vec<Object>),
    Dictionary(Dictionary),
    Reference(u32),
    /// An operator of a content stream, or a keyword such as `true`, `null` and `endobj`.
    Word(String),
}

impl Object {
    pub(super) fn number(&self) -> Option<f64> {
        match self {
            Self::Number(number) => Some(*number),
            _ => None,
        }
    }

    pub(super) fn name(&self) -> Option<&str> {
        match self {
            Self::Name(name) => Some(name),
            _ => None,
        }
    }

    pub(super) fn array(&self) -> Option<&[Object]> {
        match self {
            Self::Array(items) => Some(items),
            _ => None,
        }
    }

    pub(super) fn dictionary(&self) -> Option<&Dictionary> {
        match self {
            Self::Dictionary(entries) => Some(entries),
            _ => None,
        }
    }
}

/// Reads objects one after the other.
pub(super) struct Lexer<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) at: usize,
    /// Number of digits behind the point of the last number.
    pub(super) decimals: usize,
}

impl<'a> Lexer<'a> {
    pub(super) fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at, decimals: 0 }
    }

    pub(super) fn peek(&self) -> Option<u8> {
        self.bytes.get(self.at).copied()
    }

    /// Skips white space and comments.
    pub(super) fn skip_space(&mut self) {
        while let Some(byte) = self.peek() {
            match byte {
                b'%' => {
                    while self.peek().is_some_and(|b| b != b'\n' && b != b'\r') {
                        self.at += 1;
                    }
                }
                byte if is_space(byte) => self.at += 1,
                _ => return,
            }
        }
    }

    /// The next object; none at the end.
    pub(super) fn object(&mut self) -> Result<Option<Object>> {
        self.nested(0)
    }

    /// A whole number, if one follows; the position stays otherwise.
    pub(super) fn whole_number(&mut self) -> Option<u32> {
        let begin = self.at;
        self.skip_space();
        let digits = self.bytes[self.at..].iter().take_while(|b| b.is_ascii_digit()).count();
        let text = std::str::from_utf8(&self.bytes[self.at..self.at + digits]).ok();
        let number = text.and_then(|t| t.parse().ok());
        self.at = if number.is_some() { self.at + digits } else { begin };
        number
    }

    /// Whether a word follows; it is skipped if so.
    pub(super) fn takes(&mut self, word: &[u8]) -> bool {
        let begin = self.at;
        self.skip_space();
        let end = self.at + word.len();
        if self.bytes[self.at..].starts_with(word) && !self.bytes.get(end).is_some_and(|b| is_regular(*b)) {
            self.at = end;
            return true;
        }
        self.at = begin;
        false
    }

    fn nested(&mut self, depth: usize) -> Result<Option<Object>> {
        if depth > MAX_DEPTH {
            return Err(self.wrong(&format!("at most {MAX_DEPTH} nested arrays")));
        }
        self.skip_space();
        let Some(byte) = self.peek() else { return Ok(None) };
        Ok(Some(match byte {
            b'/' => Object::Name(self.name()),
            b'(' => Object::Text(self.string()?),
            b'<' if self.bytes.get(self.at + 1) == Some(&b'<') => {
                self.at += 2;
                Object::Dictionary(self.dictionary(depth)?)
            }
            b'<' => Object::Text(self.hexadecimal()),
            b'[' => {
                self.at += 1;
                let mut items = Vec::new();
                loop {
                    self.skip_space();
                    if self.peek() == Some(b']') {
                        self.at += 1;
                        break;
                    }
                    let item = self.nested(depth + 1)?;
                    items.push(item.ok_or_else(|| self.wrong("an array that ends with `]`"))?);
                }
                Object::Array(items)
            }
            b'0'..=b'9' | b'+' | b'-' | b'.' => self.number_or_reference()?,
            byte if is_regular(byte) => {
                let begin = self.at;
                self.skip_regular();
                Object::Word(String::from_utf8_lossy(&self.bytes[begin..self.at]).into_owned())
            }
            // An unbalanced delimiter. The position moves on, so that a search after the error ends.
            _ => {
                self.at += 1;
                return Err(self.wrong("an object"));
            }
        }))
    }

    fn skip_regular(&mut self) {
        while self.peek().is_some_and(is_regular) {
            self.at += 1;
        }
    }

    fn number_or_reference(&mut self) -> Result<Object> {
        let begin = self.at;
        self.at += 1;
        while self.peek().is_some_and(|b| b.is_ascii_digit() || b == b'.' || b == b'-') {
            self.at += 1;
        }
        let text = &self.bytes[begin..self.at];
        self.decimals = text.iter().rev().position(|b| *b == b'.').unwrap_or(0);
        if text.iter().all(u8::is_ascii_digit) {
            let after = self.at;
            // `12 0 R` refers to object 12.
            if self.whole_number().is_some()
                && self.takes(b"R")
                && let Some(id) = std::str::from_utf8(text).ok().and_then(|t| t.parse().ok())
            {
                return Ok(Object::Reference(id));
            }
            self.at = after;
        }
        let number = std::str::from_utf8(text).ok().and_then(|t| t.parse().ok());
        // Coordinates are far smaller; larger numbers would overflow in products.
        let number = number.filter(|x: &f64| x.abs() < 1e12);
        number.map(Object::Number).ok_or_else(|| self.wrong("a number"))
    }

    fn name(&mut self) -> String {
        let begin = self.at + 1;
        self.at = begin;
        self.skip_regular();
        let raw = &self.bytes[begin..self.at];
        let mut name = Vec::with_capacity(raw.len());
        let mut left = raw;
        while let Some((first, rest)) = left.split_first() {
            let code = rest.get(..2).filter(|_| *first == b'#');
            match code.and_then(|c| Some(16 * hex(c[0])? + hex(c[1])?)) {
                Some(byte) => {
                    name.push(byte);
                    left = &rest[2..];
                }
                None => {
                    name.push(*first);
                    left = rest;
                }
            }
        }
        String::from_utf8_lossy(&name).into_owned()
    }

    fn dictionary(&mut self, depth: usize) -> Result<Dictionary> {
        let mut entries = Dictionary::new();
        loop {
            self.skip_space();
            if self.bytes[self.at..].starts_with(b">>") {
                self.at += 2;
                return Ok(entries);
            }
            match (self.nested(depth + 1)?, self.nested(depth + 1)?) {
                (Some(Object::Name(key)), Some(value)) => entries.insert(key, value),
                _ => return Err(self.wrong("a dictionary of names and values that ends with `>>`")),
            };
        }
    }

    fn string(&mut self) -> Result<Vec<u8>> {
        self.at += 1;
        let mut text = Vec::new();
        let mut open = 1;
        while let Some(byte) = self.peek() {
            self.at += 1;
            match byte {
                b'(' => open += 1,
                b')' if open == 1 => return Ok(text),
                b')' => open -= 1,
                b'\\' => {
                    self.escape(&mut text);
                    continue;
                }
                _ => {}
            }
            text.push(byte);
        }
        Err(self.wrong("a string that ends with `)`"))
    }

    /// What follows a backslash (ISO 32000-1, table 3).
    fn escape(&mut self, text: &mut Vec<u8>) {
        let Some(byte) = self.peek() else { return };
        self.at += 1;
        match byte {
            b'n' => text.push(b'\n'),
            b'r' => text.push(b'\r'),
            b't' => text.push(b'\t'),
            b'b' => text.push(8),
            b'f' => text.push(12),
            b'0'..=b'7' => {
                let mut code = u32::from(byte - b'0');
                for _ in 0..2 {
                    let Some(digit) = self.peek().filter(|b| (b'0'..=b'7').contains(b)) else { break };
                    code = 8 * code + u32::from(digit - b'0');
                    self.at += 1;
                }
                text.push(code as u8);
            }
            // A line that is continued.
            b'\r' => self.at += usize::from(self.peek() == Some(b'\n')),
            b'\n' => {}
            other => text.push(other),
        }
    }

    fn hexadecimal(&mut self) -> Vec<u8> {
        self.at += 1;
        let begin = self.at;
        while self.peek().is_some_and(|b| b != b'>') {
            self.at += 1;
        }
        let text = bytes_of_hexadecimal(&self.bytes[begin..self.at]);
        self.at = (self.at + 1).min(self.bytes.len());
        text
    }

    fn wrong(&self, expected: &str) -> Error {
        let found: String =
            self.bytes[self.at.min(self.bytes.len())..].iter().take(20).map(|b| char::from(*b)).collect();
        Error::input(format!("expected {expected}, found `{}` at byte {}", found.escape_debug(), self.at))
    }
}

/// The bytes of pairs of hexadecimal digits; a last single digit is the first of a pair with 0.
pub(super) fn bytes_of_hexadecimal(text: &[u8]) -> Vec<u8> {
    let digits: Vec<u8> = text.iter().filter_map(|b| hex(*b)).collect();
    digits.chunks(2).map(|pair| 16 * pair[0] + pair.get(1).copied().unwrap_or(0)).collect()
}

fn hex(byte: u8) -> Option<u8> {
    char::from(byte).to_digit(16).map(|digit| digit as u8)
}

pub(super) fn is_space(byte: u8) -> bool {
    matches!(byte, 0 | 9 | 10 | 12 | 13 | 32)
}

fn is_regular(byte: u8) -> bool {
    !is_space(byte) && !b"()<>[]{}/%".contains(&byte)
}
