//! Reads group codes (pairs of lines) and joins them to records that begin with code 0.

use crate::source::Source;
use planish_estimate::{Error, Result};
use std::io::Read;

/// Maximum number of groups of a record, which bounds the memory of a damaged file.
const MAX_GROUPS: usize = 2_000_000;

/// A group code and its value.
pub(super) struct Group {
    pub(super) code: i32,
    pub(super) value: String,
    /// Line of the value, from 1.
    pub(super) line: u64,
}

/// A group of code 0 and the groups up to the next one.
pub(super) struct Record {
    pub(super) kind: String,
    pub(super) line: u64,
    pub(super) groups: Vec<Group>,
}

impl Record {
    /// Value of the first group with this code.
    pub(super) fn text(&self, code: i32) -> Option<&str> {
        self.groups.iter().find(|g| g.code == code).map(|g| g.value.as_str())
    }

    /// Number of the first group with this code.
    pub(super) fn number(&self, code: i32) -> Result<Option<f64>> {
        self.groups.iter().find(|g| g.code == code).map(Group::number).transpose()
    }

    /// Number of a required group.
    pub(super) fn required(&self, code: i32, what: &str) -> Result<f64> {
        self.number(code)?.ok_or_else(|| Error::input(format!("expected {what} (group {code}), found none")))
    }

    /// Description for messages: kind, handle and line.
    pub(super) fn name(&self) -> String {
        match self.text(5) {
            Some(handle) => format!("{} {handle} (line {})", self.kind, self.line),
            None => format!("{} (line {})", self.kind, self.line),
        }
    }
}

impl Group {
    pub(super) fn number(&self) -> Result<f64> {
        // The same limit as in `Affine::is_finite`; it keeps products of coordinates finite.
        self.value.parse().ok().filter(|x: &f64| x.is_finite() && x.abs() < 1e15).ok_or_else(|| {
            let found: String = self.value.chars().take(40).collect();
            Error::input(format!(
                "line {}: expected a number (group {}), found `{found}`",
                self.line, self.code
            ))
        })
    }
}

/// Reader of the records of a file.
pub(super) struct Groups<'a, R> {
    source: &'a mut Source<R>,
    line: u64,
    ahead: Option<Group>,
}

impl<'a, R: Read> Groups<'a, R> {
    pub(super) fn new(source: &'a mut Source<R>) -> Self {
        Self { source, line: 0, ahead: None }
    }

    fn next_line(&mut self) -> Result<Option<String>> {
        // Writers indent codes by blanks. Texts before AutoCAD 2007 are in code pages, but only keywords and
        // numbers matter here.
        let line = self.source.line()?.map(|l| String::from_utf8_lossy(l).trim().to_owned());
        self.line += u64::from(line.is_some());
        Ok(line)
    }

    fn next_group(&mut self) -> Result<Option<Group>> {
        if let Some(group) = self.ahead.take() {
            return Ok(Some(group));
        }
        let Some(code) = self.next_line()? else {
            return Ok(None);
        };
        let at = self.line;
        // A binary DXF file begins with text in place of a code and ends up here, too.
        let Ok(code) = code.parse::<i32>() else {
            // Blank lines at the end of a file are not an error.
            if code.is_empty() {
                return Ok(None);
            }
            let found: String = code.chars().take(40).collect();
            return Err(Error::input(format!(
                "line {at}: expected a DXF group code (a whole number), found `{found}`: not an ASCII DXF \
                 file?"
            )));
        };
        let Some(value) = self.next_line()? else {
            return Err(Error::input(format!(
                "line {at}: the file ends after group code {code}, before its value"
            )));
        };
        Ok(Some(Group { code, value, line: self.line }))
    }

    /// Reads the next record; groups before the first code 0 are skipped.
    pub(super) fn next_record(&mut self) -> Result<Option<Record>> {
        let first = loop {
            match self.next_group()? {
                None => return Ok(None),
                Some(group) if group.code == 0 => break group,
                // Comments (code 999) may precede the first section.
                Some(_) => {}
            }
        };
        let mut record = Record { kind: first.value, line: first.line, groups: Vec::new() };
        while let Some(group) = self.next_group()? {
            if group.code == 0 {
                self.ahead = Some(group);
                break;
            }
            if record.groups.len() >= MAX_GROUPS {
                return Err(Error::input(format!(
                    "line {}: expected at most {MAX_GROUPS} groups per entity, found more",
                    group.line
                )));
            }
            record.groups.push(group);
        }
        Ok(Some(record))
    }
}
