//! Typed access to the attributes of instances, with errors that name the instance.

use super::syntax::{Index, Record, Value};
use planish_estimate::{Error, Result};

/// An instance with one keyword, and its attributes.
pub(super) struct Entity<'a> {
    pub(super) id: u64,
    line: usize,
    pub(super) record: Record<'a>,
}

impl<'a> Index<'a> {
    /// Parses an instance that must have one keyword.
    pub(super) fn entity(&self, id: u64) -> Result<Entity<'a>> {
        let mut records = self.records(id)?;
        match records.len() {
            1 => Ok(Entity { id, line: self.line(id), record: records.remove(0) }),
            n => {
                Err(Error::input(format!("#{id} in line {}: expected one keyword, found {n}", self.line(id))))
            }
        }
    }

    /// Parses an instance that must have the given keyword.
    pub(super) fn entity_of(&self, id: u64, keyword: &str) -> Result<Entity<'a>> {
        let entity = self.entity(id)?;
        match entity.record.keyword == keyword {
            true => Ok(entity),
            false => Err(entity.wrong(&format!("expected {keyword}"))),
        }
    }

    /// Parses the parts of a complex instance.
    pub(super) fn parts(&self, id: u64) -> Result<Vec<Entity<'a>>> {
        let line = self.line(id);
        let records = self.records(id)?;
        Ok(records.into_iter().map(|record| Entity { id, line, record }).collect())
    }
}

/// Finds the part with a keyword.
pub(super) fn part<'b, 'a>(parts: &'b [Entity<'a>], keyword: &str) -> Option<&'b Entity<'a>> {
    parts.iter().find(|p| p.record.keyword == keyword)
}

impl<'a> Entity<'a> {
    /// Creates an error that names this instance.
    pub(super) fn wrong(&self, what: &str) -> Error {
        Error::input(format!("#{} {} in line {}: {what}", self.id, self.record.keyword, self.line))
    }

    /// Error for an attribute of another kind than expected, or a missing one.
    fn unexpected(&self, at: usize, what: &str) -> Error {
        match self.record.values.get(at) {
            Some(found) => self.wrong(&format!("attribute {}: expected {what}, found {found}", at + 1)),
            None => {
                self.wrong(&format!("expected {} attributes, found {}", at + 1, self.record.values.len()))
            }
        }
    }

    pub(super) fn value(&self, at: usize) -> Option<&Value<'a>> {
        self.record.values.get(at)
    }

    pub(super) fn reference(&self, at: usize) -> Result<u64> {
        match self.value(at) {
            Some(Value::Reference(id)) => Ok(*id),
            _ => Err(self.unexpected(at, "an instance")),
        }
    }

    /// An instance, or none if the attribute is omitted.
    pub(super) fn optional(&self, at: usize) -> Result<Option<u64>> {
        match self.value(at) {
            Some(Value::Reference(id)) => Ok(Some(*id)),
            // `*` marks an attribute that a subtype derives, which has no value in the file.
            Some(Value::Omitted | Value::Derived) => Ok(None),
            _ => Err(self.unexpected(at, "an instance or $")),
        }
    }

    pub(super) fn number(&self, at: usize) -> Result<f64> {
        match self.value(at).and_then(number) {
            Some(x) => Ok(x),
            None => Err(self.unexpected(at, "a number")),
        }
    }

    pub(super) fn count(&self, at: usize) -> Result<usize> {
        match self.value(at).and_then(count) {
            Some(n) => Ok(n),
            None => Err(self.unexpected(at, "a count")),
        }
    }

    pub(super) fn truth(&self, at: usize) -> Result<bool> {
        match self.value(at) {
            Some(Value::Name(b"T")) => Ok(true),
            Some(Value::Name(b"F")) => Ok(false),
            // `.U.` (unknown) is refused: all flags that are read here are BOOLEAN, not LOGICAL.
            _ => Err(self.unexpected(at, ".T. or .F.")),
        }
    }

    pub(super) fn list(&self, at: usize) -> Result<&[Value<'a>]> {
        match self.value(at) {
            Some(Value::List(values)) => Ok(values),
            _ => Err(self.unexpected(at, "a list")),
        }
    }

    fn all<T>(&self, at: usize, what: &str, convert: impl Fn(&Value<'a>) -> Option<T>) -> Result<Vec<T>> {
        let each = self.list(at)?.iter().enumerate();
        each.map(|(k, value)| {
            convert(value).ok_or_else(|| {
                let place = format!("attribute {}, value {}", at + 1, k + 1);
                self.wrong(&format!("{place}: expected a list of {what}, found {value} in it"))
            })
        })
        .collect()
    }

    pub(super) fn references(&self, at: usize) -> Result<Vec<u64>> {
        self.all(at, "instances", |v| match v {
            Value::Reference(id) => Some(*id),
            _ => None,
        })
    }

    pub(super) fn numbers(&self, at: usize) -> Result<Vec<f64>> {
        self.all(at, "numbers", number)
    }

    pub(super) fn counts(&self, at: usize) -> Result<Vec<usize>> {
        self.all(at, "counts", count)
    }

    /// Number of rows of equal length, and their values row by row.
    pub(super) fn rows<T>(
        &self,
        at: usize,
        what: &str,
        convert: impl Fn(&Value<'a>) -> Option<T>,
    ) -> Result<(usize, Vec<T>)> {
        let rows = self.list(at)?;
        let mut found = Vec::new();
        let mut width = None;
        for row in rows {
            let Value::List(row) = row else {
                return Err(self.unexpected(at, what));
            };
            // Callers compute the index of a value from its row and column.
            if *width.get_or_insert(row.len()) != row.len() {
                return Err(
                    self.wrong(&format!("attribute {}: expected rows of equal length, found others", at + 1))
                );
            }
            let values: Option<Vec<T>> = row.iter().map(&convert).collect();
            found.extend(values.ok_or_else(|| self.unexpected(at, what))?);
        }
        Ok((rows.len(), found))
    }

    pub(super) fn rows_of_references(&self, at: usize) -> Result<(usize, Vec<u64>)> {
        self.rows(at, "rows of instances", |v| match v {
            Value::Reference(id) => Some(*id),
            _ => None,
        })
    }

    pub(super) fn rows_of_numbers(&self, at: usize) -> Result<(usize, Vec<f64>)> {
        self.rows(at, "rows of numbers", number)
    }
}

/// A number, plain or with its type, as `LENGTH_MEASURE(2.)`.
fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Number(x) => Some(*x),
        Value::Typed(_, values) => match values.as_slice() {
            [Value::Number(x)] => Some(*x),
            _ => None,
        },
        _ => None,
    }
}

fn count(value: &Value) -> Option<usize> {
    match value {
        // The limit keeps the conversion exact and excludes sizes that no file can hold.
        Value::Number(x) if *x >= 0.0 && x.fract() == 0.0 && *x <= 1e9 => Some(*x as usize),
        _ => None,
    }
}
