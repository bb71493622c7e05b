//! Encoding of STEP files: numbered instances, reals and strings.
//!
//! # References
//! ISO 10303-21:2016, *Clear text encoding of the exchange structure*.
//!
//! **Input.** Instances as text.
//!
//! **Output.** Lines `#12=TEXT;` with consecutive numbers.

use std::fmt;
use std::io::{self, Write};

/// Number of an instance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Id(u64);

impl Id {
    /// Instance with a number that is larger by `steps`.
    pub(super) fn after(self, steps: usize) -> Self {
        Self(self.0 + steps as u64)
    }

    /// Formats consecutive instances: `#12,#13,…`.
    pub(super) fn run(self, length: usize) -> impl fmt::Display {
        fmt::from_fn(move |f| {
            for k in 0..length as u64 {
                write!(f, "{}#{}", if k > 0 { "," } else { "" }, self.0 + k)?;
            }
            Ok(())
        })
    }
}

impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "#{}", self.0)
    }
}

/// Writer of a data section.
pub(super) struct Part21<'a, W> {
    writer: &'a mut W,
    next: u64,
}

impl<'a, W: Write> Part21<'a, W> {
    pub(super) fn new(writer: &'a mut W) -> Self {
        Self { writer, next: 1 }
    }

    /// Number of the next instance.
    pub(super) fn next_id(&self) -> Id {
        Id(self.next)
    }

    /// Starts an instance, whose text goes to [`Part21::writer`] until [`Part21::end`].
    pub(super) fn begin(&mut self) -> io::Result<Id> {
        let id = self.next_id();
        self.next += 1;
        // Streamed instead of formatted first, because the text of a control net can be large.
        write!(self.writer, "{id}=")?;
        Ok(id)
    }

    pub(super) fn writer(&mut self) -> &mut W {
        self.writer
    }

    pub(super) fn end(&mut self) -> io::Result<()> {
        self.writer.write_all(b";\n")
    }

    /// Writes an instance.
    pub(super) fn add(&mut self, instance: fmt::Arguments) -> io::Result<Id> {
        let id = self.begin()?;
        self.writer.write_fmt(instance)?;
        self.end()?;
        Ok(id)
    }

    /// Writes an instance that ends in a list of instances: `BEGINNING(#1,#2))`.
    pub(super) fn add_list(&mut self, beginning: &str, list: &[Id]) -> io::Result<Id> {
        let id = self.begin()?;
        write!(self.writer, "{beginning}(")?;
        for (k, item) in list.iter().enumerate() {
            write!(self.writer, "{}{item}", if k > 0 { "," } else { "" })?;
        }
        self.writer.write_all(b"))")?;
        self.end()?;
        Ok(id)
    }
}

/// Formats a real with the fewest digits that read back as the same number, and the `.` and `E` that Part 21
/// requires.
pub(super) fn real(f: &mut fmt::Formatter<'_>, value: f64) -> fmt::Result {
    // −0 has no meaning in a shape and would change the bytes of equal shapes.
    let value = if value == 0.0 { 0.0 } else { value };
    let shortest = format!("{value:?}");
    match shortest.split_once('e') {
        Some((mantissa, exponent)) if mantissa.contains('.') => write!(f, "{mantissa}E{exponent}"),
        Some((mantissa, exponent)) => write!(f, "{mantissa}.E{exponent}"),
        None => {
            // Part 21 requires the point, but no digit after it.
            f.write_str(shortest.strip_suffix(".0").map_or(&shortest, |_| &shortest[..shortest.len() - 1]))
        }
    }
}

/// Formats reals separated by commas.
pub(super) fn reals(values: &[f64]) -> impl fmt::Display {
    fmt::from_fn(move |f| {
        for (k, &value) in values.iter().enumerate() {
            if k > 0 {
                f.write_str(",")?;
            }
            real(f, value)?;
        }
        Ok(())
    })
}

/// Formats integers separated by commas.
pub(super) fn integers(values: &[usize]) -> impl fmt::Display {
    fmt::from_fn(move |f| {
        for (k, value) in values.iter().enumerate() {
            write!(f, "{}{value}", if k > 0 { "," } else { "" })?;
        }
        Ok(())
    })
}

/// Formats a quoted string; characters beyond printable ASCII become `\X2\…\X0\` in UTF-16.
pub(super) fn text(string: &str) -> String {
    let mut quoted = String::from("'");
    for c in string.chars() {
        match c {
            '\'' => quoted.push_str("''"),
            '\\' => quoted.push_str("\\\\"),
            ' '..='~' => quoted.push(c),
            _ => {
                quoted.push_str("\\X2\\");
                // `\X2\` holds UTF-16 code units, so characters beyond the basic plane take two.
                for unit in c.encode_utf16(&mut [0; 2]) {
                    quoted.push_str(&format!("{unit:04X}"));
                }
                quoted.push_str("\\X0\\");
            }
        }
    }
    quoted.push('\'');
    quoted
}
