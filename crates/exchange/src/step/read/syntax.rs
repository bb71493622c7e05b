//! Syntax of STEP files: position and content of each instance.
//!
//! **Input.** The bytes of a file.
//!
//! **Output.** An index of instances. Each is parsed when it is requested, so that notes and tessellations,
//! often most of a file, cost only their entry in the index (decision 0044).
//!
//! **Limits.** Anchors, references and signatures of later editions are ignored.
//!
//! # References
//! ISO 10303-21:2016, *Clear text encoding of the exchange structure*.

use planish_estimate::{Error, Result};
use std::collections::HashMap;
use std::fmt;

/// Maximum nesting of lists, which bounds the recursion of the parser.
const MAX_DEPTH: usize = 24;

/// A parameter of an instance.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value<'a> {
    Reference(u64),
    Number(f64),
    Text(&'a [u8]),
    /// `.NAME.`
    Name(&'a [u8]),
    List(Vec<Value<'a>>),
    /// `NAME(…)`
    Typed(&'a [u8], Vec<Value<'a>>),
    /// `$`
    Omitted,
    /// `*`
    Derived,
}

impl fmt::Display for Value<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reference(id) => write!(f, "#{id}"),
            Self::Number(x) => write!(f, "{x}"),
            Self::Text(text) => write!(f, "'{}'", String::from_utf8_lossy(text)),
            Self::Name(name) => write!(f, ".{}.", String::from_utf8_lossy(name)),
            Self::List(values) => write!(f, "a list of {}", values.len()),
            Self::Typed(name, _) => write!(f, "{}(…)", String::from_utf8_lossy(name)),
            Self::Omitted => f.write_str("$"),
            Self::Derived => f.write_str("*"),
        }
    }
}

/// A keyword and its parameters.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Record<'a> {
    pub(super) keyword: &'a str,
    pub(super) values: Vec<Value<'a>>,
}

/// Position of an instance.
#[derive(Debug, Clone, Copy)]
struct Place {
    start: usize,
    end: usize,
    line: usize,
}

/// The instances of a file.
pub(super) struct Index<'a> {
    bytes: &'a [u8],
    places: HashMap<u64, Place>,
    /// Instances by keyword, in the order of the file; complex instances have the empty keyword.
    by_keyword: HashMap<&'a str, Vec<u64>>,
}

fn is_space(byte: u8) -> bool {
    byte.is_ascii_whitespace()
}

/// Position in the bytes; skips comments.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    /// Skips blanks and comments.
    fn skip(&mut self) {
        loop {
            match self.bytes.get(self.at) {
                Some(b) if is_space(*b) => self.at += 1,
                Some(b'/') if self.bytes.get(self.at + 1) == Some(&b'*') => {
                    self.at = comment_end(self.bytes, self.at)
                }
                _ => return,
            }
        }
    }

    fn peek(&mut self) -> Option<u8> {
        self.skip();
        self.bytes.get(self.at).copied()
    }

    fn take(&mut self, byte: u8) -> bool {
        let is_next = self.peek() == Some(byte);
        self.at += usize::from(is_next);
        is_next
    }

    fn expect(&mut self, byte: u8) -> Result<()> {
        match self.take(byte) {
            true => Ok(()),
            false => Err(self.found(&format!("`{}`", char::from(byte)))),
        }
    }

    fn found(&self, expected: &str) -> Error {
        Error::input(match self.bytes.get(self.at) {
            Some(b) => format!("expected {expected}, found `{}`", char::from(*b).escape_default()),
            None => format!("expected {expected}, found the end"),
        })
    }

    fn take_while(&mut self, is: impl Fn(u8) -> bool) -> &'a [u8] {
        let from = self.at;
        while self.bytes.get(self.at).is_some_and(|b| is(*b)) {
            self.at += 1;
        }
        &self.bytes[from..self.at]
    }

    fn keyword(&mut self) -> Result<&'a str> {
        self.skip();
        // `!` begins user-defined keywords.
        let word = self.take_while(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'!');
        match std::str::from_utf8(word) {
            Ok(word) if !word.is_empty() => Ok(word),
            _ => Err(self.found("a keyword")),
        }
    }

    fn list(&mut self, depth: usize) -> Result<Vec<Value<'a>>> {
        if depth > MAX_DEPTH {
            return Err(Error::input(format!("expected at most {MAX_DEPTH} nested lists, found more")));
        }
        self.expect(b'(')?;
        let mut values = Vec::new();
        if self.take(b')') {
            return Ok(values);
        }
        loop {
            values.push(self.value(depth)?);
            if self.take(b')') {
                return Ok(values);
            }
            self.expect(b',')?;
        }
    }

    fn value(&mut self, depth: usize) -> Result<Value<'a>> {
        match self.peek() {
            Some(b'#') => {
                self.at += 1;
                Ok(Value::Reference(self.number_of_instance()?))
            }
            Some(b'$') => {
                self.at += 1;
                Ok(Value::Omitted)
            }
            Some(b'*') => {
                self.at += 1;
                Ok(Value::Derived)
            }
            Some(b'(') => Ok(Value::List(self.list(depth + 1)?)),
            // `"` delimits binary values, which no face uses; they only have to be skipped correctly.
            Some(quote @ (b'\'' | b'"')) => {
                let end = text_end(self.bytes, self.at, quote)
                    .ok_or_else(|| Error::input("expected the end of a string, found the end of the file"))?;
                // Control directives such as `\X2\` stay encoded, because texts appear only in messages.
                let text = &self.bytes[self.at + 1..end - 1];
                self.at = end;
                Ok(Value::Text(text))
            }
            Some(b'.') => {
                self.at += 1;
                let name = self.take_while(|b| b.is_ascii_alphanumeric() || b == b'_');
                self.expect(b'.')?;
                Ok(Value::Name(name))
            }
            Some(b'+' | b'-' | b'0'..=b'9') => {
                let text =
                    self.take_while(|b| b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'.' | b'E' | b'e'));
                // Rust parses `1.` and `1.E-7`, as STEP writes reals.
                let number = std::str::from_utf8(text).ok().and_then(|t| t.parse::<f64>().ok());
                match number {
                    Some(x) if x.is_finite() => Ok(Value::Number(x)),
                    _ => Err(Error::input(format!(
                        "expected a finite number, found `{}`",
                        String::from_utf8_lossy(text)
                    ))),
                }
            }
            Some(b) if b.is_ascii_alphabetic() || b == b'!' => {
                let keyword = self.keyword()?;
                Ok(Value::Typed(keyword.as_bytes(), self.list(depth + 1)?))
            }
            _ => Err(self.found("a value")),
        }
    }

    fn number_of_instance(&mut self) -> Result<u64> {
        let digits = self.take_while(|b| b.is_ascii_digit());
        std::str::from_utf8(digits)
            .ok()
            .and_then(|d| d.parse().ok())
            .ok_or_else(|| self.found("the number of an instance"))
    }
}

/// Position after the comment that starts at `from`; the end of the file if it is not closed.
fn comment_end(bytes: &[u8], from: usize) -> usize {
    let rest = bytes.get(from + 2..).unwrap_or_default();
    match rest.windows(2).position(|w| w == b"*/") {
        Some(k) => from + 2 + k + 2,
        None => bytes.len(),
    }
}

/// Position after the string that starts at `from`; none if it does not end. Quotes inside it are doubled.
fn text_end(bytes: &[u8], from: usize, quote: u8) -> Option<usize> {
    let mut at = from + 1;
    loop {
        at += bytes.get(at..)?.iter().position(|b| *b == quote)? + 1;
        if bytes.get(at) != Some(&quote) {
            return Some(at);
        }
        at += 1;
    }
}

impl<'a> Index<'a> {
    /// Finds the instances of all data sections.
    ///
    /// # Errors
    /// `Input`, with the line, for a file that is not STEP or ends too early, a repeated number, and an
    /// invalid statement.
    pub(super) fn new(bytes: &'a [u8]) -> Result<Self> {
        let mut index = Self { bytes, places: HashMap::new(), by_keyword: HashMap::new() };
        let mut start = bytes.strip_prefix(b"\xef\xbb\xbf").map_or(0, |_| 3);
        let mut line = 1;
        let mut is_data = false;
        let mut sections = 0;
        let mut is_first = true;
        while let Some(end) = statement_end(bytes, start) {
            let mut cursor = Cursor { bytes, at: start };
            cursor.skip();
            let (from, at_line) = (cursor.at, line + count_lines(&bytes[start..cursor.at]));
            let named = |e: Error| e.in_context(format!("line {at_line}"));
            // Lines are counted statement by statement, so that the file is scanned once.
            line += count_lines(&bytes[start..end]);
            start = end;
            // Only the position and the keyword are stored; attributes are parsed on request.
            if bytes[from] == b'#' {
                if !is_data {
                    return Err(named(Error::input(
                        "expected a DATA section before an instance, found none",
                    )));
                }
                index.add(from, end, at_line).map_err(named)?;
                continue;
            }
            let text = &bytes[from..end];
            // A file of another format is recognised at its first statement.
            if std::mem::take(&mut is_first) && !text.starts_with(b"ISO-10303-21") {
                break;
            }
            match text {
                t if t.starts_with(b"DATA") => {
                    is_data = true;
                    sections += 1;
                }
                t if t.starts_with(b"ENDSEC") => is_data = false,
                t if t.starts_with(b"END-ISO-10303-21") => return index.checked(sections),
                _ if is_data => {
                    return Err(named(Error::input("expected an instance `#n = …;` or `ENDSEC;`")));
                }
                // Entries of the header are skipped: the data section states the units of each
                // representation.
                _ => {}
            }
        }
        Err(
            match is_first || sections == 0 && index.places.is_empty() && !bytes.starts_with(b"ISO-10303-21")
            {
                true => Error::input("expected `ISO-10303-21;` at the beginning: not a STEP file"),
                false => Error::input(format!("line {line}: the file ends before `END-ISO-10303-21;`")),
            },
        )
    }

    fn checked(self, sections: usize) -> Result<Self> {
        match sections {
            0 => Err(Error::input("expected a DATA section, found none")),
            _ => Ok(self),
        }
    }

    fn add(&mut self, start: usize, end: usize, line: usize) -> Result<()> {
        let mut cursor = Cursor { bytes: self.bytes, at: start + 1 };
        let id = cursor.number_of_instance()?;
        cursor.expect(b'=').map_err(|e| e.in_context(format!("#{id}")))?;
        cursor.skip();
        let place = Place { start: cursor.at, end, line };
        // A complex instance begins with a bracket; its keywords are read when it is parsed.
        let keyword = match cursor.peek() {
            Some(b'(') => "",
            _ => cursor.keyword().map_err(|e| e.in_context(format!("#{id}")))?,
        };
        // A second instance of a number would make every reference to it ambiguous.
        if self.places.insert(id, place).is_some() {
            return Err(Error::input(format!("expected one instance #{id}, found two")));
        }
        self.by_keyword.entry(keyword).or_default().push(id);
        Ok(())
    }

    /// Instances with one keyword, in the order of the file.
    pub(super) fn of_keyword(&self, keyword: &str) -> &[u64] {
        self.by_keyword.get(keyword).map_or(&[], Vec::as_slice)
    }

    /// Complex instances, which have several keywords.
    pub(super) fn complex(&self) -> &[u64] {
        self.of_keyword("")
    }

    /// Keywords of the file with their instances. The order is arbitrary: callers must not depend on it.
    pub(super) fn keywords(&self) -> impl Iterator<Item = (&'a str, &[u64])> {
        self.by_keyword.iter().map(|(k, ids)| (*k, ids.as_slice()))
    }

    /// Parses the records of an instance: one, or several of a complex instance.
    ///
    /// # Errors
    /// `Input`, with number and line, if the instance does not exist or is malformed.
    pub(super) fn records(&self, id: u64) -> Result<Vec<Record<'a>>> {
        let Some(place) = self.places.get(&id) else {
            return Err(Error::input(format!("expected the instance #{id}, found none")));
        };
        // Limited to the statement, so that a missing bracket cannot consume the next instance.
        let mut cursor = Cursor { bytes: &self.bytes[..place.end], at: place.start };
        let read = |cursor: &mut Cursor<'a>| -> Result<Vec<Record<'a>>> {
            let mut records = Vec::new();
            if cursor.peek() != Some(b'(') {
                let keyword = cursor.keyword()?;
                let values = cursor.list(0)?;
                records.push(Record { keyword, values });
            } else {
                cursor.expect(b'(')?;
                while !cursor.take(b')') {
                    let keyword = cursor.keyword()?;
                    let values = cursor.list(0)?;
                    records.push(Record { keyword, values });
                }
            }
            cursor.expect(b';')?;
            Ok(records)
        };
        read(&mut cursor).map_err(|e| e.in_context(format!("#{id} in line {}", place.line)))
    }

    /// Line of an instance, for messages.
    pub(super) fn line(&self, id: u64) -> usize {
        self.places.get(&id).map_or(0, |p| p.line)
    }
}

fn count_lines(bytes: &[u8]) -> usize {
    bytes.iter().filter(|b| **b == b'\n').count()
}

/// Position after the statement that starts at `from`; none at the end. Semicolons in strings and comments do
/// not count.
fn statement_end(bytes: &[u8], from: usize) -> Option<usize> {
    let mut at = from;
    while let Some(byte) = bytes.get(at) {
        at = match byte {
            b';' => return Some(at + 1),
            b'\'' | b'"' => text_end(bytes, at, *byte)?,
            b'/' if bytes.get(at + 1) == Some(&b'*') => comment_end(bytes, at),
            _ => at + 1,
        };
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "ISO-10303-21;\nHEADER;\nFILE_NAME('it''s; here');ENDSEC;\nDATA;\n\
        #1 = POINT ( 'a;''b' , (1., -2.5E-1, 3) , $ , * , .T. ) ; /* #9=X(); */\n\
        #20=(A_B(#1)C()D(LENGTH(2.),(),((1),(2))));\nENDSEC;\nEND-ISO-10303-21;\n";

    #[test]
    fn all_kinds_of_values_are_parsed() {
        let index = Index::new(FILE.as_bytes()).unwrap();
        let one = &index.records(1).unwrap()[0];
        assert_eq!(one.keyword, "POINT");
        use Value::{Derived, List, Name, Number, Omitted, Reference, Text, Typed};
        let expected = vec![
            Text(b"a;''b"),
            List(vec![Number(1.0), Number(-0.25), Number(3.0)]),
            Omitted,
            Derived,
            Name(b"T"),
        ];
        assert_eq!(one.values, expected);
        let parts = index.records(20).unwrap();
        let words: Vec<&str> = parts.iter().map(|r| r.keyword).collect();
        assert_eq!(words, ["A_B", "C", "D"]);
        assert_eq!(parts[0].values, [Reference(1)]);
        assert_eq!(parts[2].values[0], Typed(b"LENGTH", vec![Number(2.0)]));
        assert_eq!((index.of_keyword("POINT"), index.complex()), (&[1][..], &[20][..]));
        assert_eq!(index.line(20), 6);
    }

    #[test]
    fn errors_name_line_and_instance() {
        let broken = |from: &str, to: &str| {
            let text = FILE.replace(from, to);
            let index = Index::new(text.as_bytes());
            match index {
                Ok(index) => index.records(1).and(index.records(20)).unwrap_err().to_string(),
                Err(e) => e.to_string(),
            }
        };
        for (from, to, error) in [
            ("ISO-10303-21;\n", "solid\n", "not a STEP file"),
            ("END-ISO-10303-21;", "", "ends before"),
            ("ENDSEC;\nEND", "END", "expected a DATA section, found none"),
            ("#20=", "#1=", "line 6: expected one instance #1, found two"),
            ("#20=", "#20", "line 6: #20: expected `=`"),
            ("#20=", "HELLO;#20=", "line 6: expected an instance"),
            ("3)", "3", "#1 in line 5: expected"),
            ("-2.5E-1", "-2.5E-1E", "expected a finite number, found `-2.5E-1E`"),
            ("-2.5E-1", "1E999", "expected a finite number"),
            ("DATA;\n", "", "expected a DATA section before an instance"),
            ("(1),(2)", &format!("{}1{}", "(".repeat(40), ")".repeat(40)), "nested lists"),
        ] {
            let e = match from {
                "ENDSEC;\nEND" => Index::new(FILE.replace("DATA;", "HEADER;").as_bytes())
                    .err()
                    .map_or(String::new(), |e| e.to_string()),
                _ => broken(from, to),
            };
            match from {
                "ENDSEC;\nEND" => assert!(e.contains("expected a DATA section"), "{e}"),
                _ => assert!(e.contains(error), "{from}: {e}"),
            }
        }
        assert!(Index::new(b"").is_err() && Index::new(b"ISO-10303-21;").is_err());
        let index = Index::new(FILE.as_bytes()).unwrap();
        assert_eq!(index.records(7).unwrap_err().to_string(), "expected the instance #7, found none");
    }
}
