//! The measured region: no readings are inferred there.

use crate::observe::ReadingColumns;
use planish_core::DVec3;
use std::collections::HashMap;

/// Minimum cosine between normals on the same side of an object. A larger one would take noisy normals for
/// another side; a smaller one would take both sides of a thin part for one.
const MIN_SIDE_COSINE: f64 = 0.3;

/// The readings of a cloud in a grid of cells.
pub(crate) struct MeasuredRegion<'a> {
    readings: &'a ReadingColumns,
    reach: f64,
    cells: HashMap<[i64; 3], Vec<u32>>,
}

impl<'a> MeasuredRegion<'a> {
    /// Points within `reach` of a reading count as measured.
    pub(crate) fn new(readings: &'a ReadingColumns, reach: f64) -> Self {
        let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
        for (i, p) in (0..).zip(&readings.points) {
            cells.entry(cell(*p, reach)).or_default().push(i);
        }
        Self { readings, reach, cells }
    }

    /// True if a reading lies within reach of `p` on the same side.
    pub(crate) fn contains(&self, p: DVec3, normal: DVec3) -> bool {
        let [x, y, z] = cell(p, self.reach);
        // Cells are as wide as the reach, so a cell and its neighbours contain every reading within it.
        (0..27).any(|k| {
            let neighbour = [x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1];
            self.cells.get(&neighbour).into_iter().flatten().any(|&i| {
                let i = i as usize;
                let d = self.readings.points[i] - p;
                d.length_squared() <= self.reach * self.reach
                    // On a thin part, readings of one side must not make the other side measured.
                    && self.readings.normal(i).dot(normal) > MIN_SIDE_COSINE
            })
        })
    }
}

fn cell(p: DVec3, side: f64) -> [i64; 3] {
    p.to_array().map(|c| (c / side).floor() as i64)
}
