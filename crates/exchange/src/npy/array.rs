//! Reads an NPY array record by record, in the order of its first axes.

use std::io::Read;

use planish_core::Budget;
use planish_estimate::{Error, Result};

use super::MAX_COLUMNS;
use super::header::{Header, read_header};
use crate::source::Source;

/// An array while it is read.
pub(super) struct Array<R> {
    header: Header,
    source: Source<R>,
    /// The whole data, if records are not contiguous (Fortran order).
    loaded: Option<Vec<u8>>,
    /// Number of last axes that form a record: 0 or 1.
    inner: usize,
    /// Index of the next record.
    next: u64,
}

impl<R: Read> Array<R> {
    /// Reads the header; the last `inner` axes form a record.
    pub(super) fn open(mut source: Source<R>, inner: usize) -> Result<Self> {
        let header = read_header(&mut source)?;
        let mut made = Self { header, source, loaded: None, inner, next: 0 };
        // A scalar (shape `()`) has no axis that could form a record.
        made.inner = inner.min(made.header.shape.len());
        let (elements, bytes) = made.header.extent();
        // Both are saturated, so that a shape whose product overflows fails here instead of wrapping around.
        made.source.check_promise(elements, "elements", bytes)?;
        // With one axis, Fortran and C order are the same.
        if made.header.columns_first && made.header.shape.len() > 1 {
            let byte = made.source.offset();
            made.budget().take_elements(
                elements,
                bytes / elements.max(1),
                "elements of a transposed array",
            )?;
            let size = usize::try_from(bytes)
                .map_err(|_| Error::unsupported("the array is too large for this computer"))?;
            let all = made.source.bytes(size)?.ok_or_else(|| {
                Error::input(format!("byte {byte}: the file ends within {bytes} bytes: it is cut off"))
            })?;
            made.loaded = Some(all.to_vec());
        }
        Ok(made)
    }

    /// Reads the header of an array of points: plain with three to [`MAX_COLUMNS`] numbers per point, or
    /// structured.
    pub(super) fn open_points(source: Source<R>) -> Result<Self> {
        let mut made = Self::open(source, 0)?;
        let axes = made.header.shape.len();
        let expected = "(n, 3) to (n, 16), (h, w, 3), or fields x y z";
        if made.header.structured {
            if !matches!(axes, 1 | 2) {
                return Err(made.wrong_shape("(n,) or (h, w) of structured points"));
            }
            return Ok(made);
        }
        let width = made.header.shape.last().copied().unwrap_or(0);
        if !matches!(axes, 2 | 3) || !(3..=MAX_COLUMNS).contains(&width) {
            return Err(made.wrong_shape(expected));
        }
        made.inner = 1;
        Ok(made)
    }

    pub(super) fn wrong_shape(&self, expected: &str) -> Error {
        let shape: Vec<String> = self.header.shape.iter().map(u64::to_string).collect();
        let kind = if self.header.structured { " structured" } else { "" };
        Error::input(format!("expected an array {expected}, found a{kind} shape ({})", shape.join(", ")))
    }

    /// The memory that the file may take.
    pub(super) fn budget(&self) -> &Budget {
        self.source.budget()
    }

    pub(super) fn shape(&self) -> &[u64] {
        &self.header.shape
    }

    pub(super) fn is_structured(&self) -> bool {
        self.header.structured
    }

    /// Lengths of the axes that count records.
    pub(super) fn outer(&self) -> &[u64] {
        &self.header.shape[..self.header.shape.len() - self.inner]
    }

    /// Number of elements in a record.
    fn width(&self) -> u64 {
        if self.inner == 0 { 1 } else { self.header.shape.last().copied().unwrap_or(1) }
    }

    pub(super) fn records(&self) -> u64 {
        self.outer().iter().fold(1, |n: u64, &side| n.saturating_mul(side))
    }

    /// Number of records to reserve, at most what the file can hold.
    pub(super) fn reserve(&self) -> usize {
        let bytes = self.width() * self.header.size as u64;
        match &self.loaded {
            Some(all) => all.len() / bytes.max(1) as usize,
            None => self.source.reserve(self.records(), bytes),
        }
    }

    /// Rows and columns, if the array is organised.
    pub(super) fn grid(&self) -> Option<[u64; 2]> {
        match *self.outer() {
            [rows, columns] if rows > 1 && columns > 1 => Some([rows, columns]),
            _ => None,
        }
    }

    /// Column names of a record; `x y z` for the first three numbers of a plain array.
    pub(super) fn names(&self) -> Result<Vec<String>> {
        if self.header.structured {
            return Ok(self.header.fields.iter().map(|f| f.name.clone()).collect());
        }
        let name = |k: u64| ["x", "y", "z"].get(k as usize).copied().unwrap_or_default().to_owned();
        Ok((0..self.width()).map(name).collect())
    }

    pub(super) fn offset(&self) -> u64 {
        self.source.offset()
    }

    /// Appends the numbers of the next record.
    #[inline]
    pub(super) fn next(&mut self, record: &mut Vec<f64>) -> Result<()> {
        let width = self.width() as usize;
        let size = self.header.size;
        let number = self.next;
        self.next += 1;
        let decode = |header: &Header, element: &[u8], record: &mut Vec<f64>| {
            for field in &header.fields {
                let bytes = &element[field.offset..field.offset + field.number.size()];
                record.push(match field.big {
                    true => field.number.decode::<true>(bytes),
                    false => field.number.decode::<false>(bytes),
                });
            }
        };
        if let Some(all) = &self.loaded {
            // In Fortran order, the numbers of a record are as many elements apart as there are records.
            let (records, place) = (self.records(), self.place(number));
            for k in 0..width as u64 {
                let at = (place + k * records) as usize * size;
                decode(&self.header, &all[at..at + size], record);
            }
            return Ok(());
        }
        let byte = self.source.offset();
        let Some(bytes) = self.source.bytes(width * size)? else {
            return Err(Error::input(format!(
                "byte {byte}: the file ends here: it is cut off ({} records declared, {number} found)",
                self.records()
            )));
        };
        for element in bytes.chunks_exact(size) {
            decode(&self.header, element, record);
        }
        Ok(())
    }

    /// Index of the first element of a record in Fortran order, where the first axis varies fastest.
    fn place(&self, record: u64) -> u64 {
        // Records are counted in C order, but stored in Fortran order.
        let (mut rest, mut place) = (record, 0);
        let outer = self.outer();
        let mut stride = self.records();
        for &side in outer.iter().rev() {
            stride /= side.max(1);
            place += rest % side.max(1) * stride;
            rest /= side.max(1);
        }
        place
    }
}
