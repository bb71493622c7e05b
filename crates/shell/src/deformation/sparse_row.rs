//! A row of which few entries are not zero, added up one by one.

use planish_core::DVec3;

/// A row over the basis of a [`Deformation`](super::Deformation), of which few entries are not zero.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_shell::{Deformation, SparseRow, VertexDisplacements};
/// let deformation = VertexDisplacements::new(&[DVec3::ZERO, DVec3::X]);
/// let mut row = SparseRow::new(deformation.basis());
/// deformation.add_to(&[(1, DVec3::Y), (1, DVec3::Z), (0, DVec3::ZERO)], &mut row);
/// let mut entries = Vec::new();
/// row.take(&mut entries);
/// assert_eq!(entries, [(4, 1.0), (5, 1.0)]);
/// ```
#[derive(Debug, Clone)]
pub struct SparseRow {
    values: Vec<f64>,
    /// Indices of entries that were zero when a number was added; an entry that cancels comes twice.
    single: Vec<u32>,
    /// The same for the first of three entries.
    triple: Vec<u32>,
}

impl SparseRow {
    /// A row of zeros.
    #[must_use]
    pub fn new(size: usize) -> Self {
        Self { values: vec![0.0; size], single: Vec::new(), triple: Vec::new() }
    }

    /// Adds to an entry.
    #[inline]
    pub fn add(&mut self, k: usize, number: f64) {
        if self.values[k] == 0.0 {
            self.single.push(k as u32);
        }
        self.values[k] += number;
    }

    /// Adds `x`, `y` and `z` to three entries in turn.
    #[inline]
    pub fn add_vector(&mut self, first: usize, vector: DVec3) {
        let values = &mut self.values[first..first + 3];
        if values == [0.0; 3] {
            self.triple.push(first as u32);
        }
        values.iter_mut().zip(vector.to_array()).for_each(|(value, number)| *value += number);
    }

    /// Moves the entries that are not zero to a list, in the order of their indices.
    pub fn take(&mut self, entries: &mut Vec<(usize, f64)>) {
        entries.clear();
        self.triple.sort_unstable();
        let triple = self.triple.drain(..).flat_map(|first| first..first + 3);
        for k in triple.chain(self.single.drain(..)) {
            // The second of two equal indices finds zero.
            let entry = std::mem::take(&mut self.values[k as usize]);
            if entry != 0.0 {
                entries.push((k as usize, entry));
            }
        }
        if !entries.is_sorted_by_key(|(k, _)| *k) {
            entries.sort_unstable_by_key(|(k, _)| *k);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Entries that cancel are not listed, also if they return, and the row is empty afterwards.
    #[test]
    fn cancelled_entries_are_omitted() {
        let mut row = SparseRow::new(5);
        let mut entries = Vec::new();
        for (k, number) in [(4, 1.0), (2, 3.0), (4, -1.0), (0, 0.5), (0, -0.5), (0, 2.0)] {
            row.add(k, number);
        }
        row.take(&mut entries);
        assert_eq!(entries, [(0, 2.0), (2, 3.0)]);
        row.add_vector(1, DVec3::new(1.0, 0.0, 2.0));
        row.add(0, 4.0);
        row.add_vector(1, DVec3::new(-1.0, 0.0, 1.0));
        row.take(&mut entries);
        assert_eq!(entries, [(0, 4.0), (3, 3.0)]);
        row.take(&mut entries);
        assert_eq!(entries, []);
    }
}
