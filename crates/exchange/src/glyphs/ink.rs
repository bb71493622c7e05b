//! Ink: how dark a pixel is between paper (0) and lines (1), without the unevenness of the light.

use planish_sense::Image;

/// Side of the squares in which the brightness of paper is estimated, in pixels. Larger than letters, so that
/// each square has paper; smaller than shadows of a photographed page.
const TILE: usize = 64;
/// Ink from which a pixel belongs to a stroke. A line one pixel wide between two rows has 0.5 in each; noise
/// and JPEG stay below 0.3.
pub(super) const STROKE: f32 = 0.35;

/// Ink of a picture, row by row.
pub(super) struct Ink {
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) values: Vec<f32>,
}

impl Ink {
    /// The ink of a picture: dark lines on light paper, or the inverse if most of it is dark.
    pub(super) fn of(image: &Image) -> Self {
        let (columns, rows) = (image.columns, image.rows);
        let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
        let mut sample: Vec<f32> =
            image.values.iter().step_by(1 + image.values.len() / 65_536).map(|v| finite(*v)).collect();
        sample.sort_by(f32::total_cmp);
        let (low, median, high) = (sample[0], sample[sample.len() / 2], sample[sample.len() - 1]);
        let inverted = median - low < high - median;
        let light = |v: f32| if inverted { high - finite(v) } else { finite(v) - low };
        let tiles = [columns.div_ceil(TILE), rows.div_ceil(TILE)];
        let mut paper = vec![0.0_f32; tiles[0] * tiles[1]];
        let mut inside = Vec::with_capacity(TILE * TILE);
        for (k, tile) in paper.iter_mut().enumerate() {
            let [x, y] = [k % tiles[0] * TILE, k / tiles[0] * TILE];
            inside.clear();
            for row in y..(y + TILE).min(rows) {
                let own = &image.values[row * columns + x..row * columns + (x + TILE).min(columns)];
                inside.extend(own.iter().map(|v| light(*v)));
            }
            // The brighter part is paper unless a fill covers the square.
            let at = (inside.len() * 4 / 5).min(inside.len() - 1);
            *tile = *inside.select_nth_unstable_by(at, f32::total_cmp).1;
        }
        let brightest = paper.iter().copied().fold(0.0, f32::max).max(f32::MIN_POSITIVE);
        let paper: Vec<f32> =
            paper.iter().map(|p| if *p < 0.5 * brightest { brightest } else { *p }).collect();
        let mut values = Vec::with_capacity(columns * rows);
        for y in 0..rows {
            let row = between(y, tiles[1]);
            for x in 0..columns {
                let column = between(x, tiles[0]);
                let at = |i: usize, j: usize| paper[row.0[i] * tiles[0] + column.0[j]];
                let line = |i: usize| at(i, 0) + column.1 * (at(i, 1) - at(i, 0));
                let local = line(0) + row.1 * (line(1) - line(0));
                values.push(1.0 - light(image.values[y * columns + x]) / local);
            }
        }
        // Lines are as dark as most of what is clearly darker than paper.
        let mut dark: Vec<f32> = values.iter().copied().filter(|v| *v > 0.25).collect();
        let at = dark.len() * 3 / 4;
        let full = if dark.is_empty() { 1.0 } else { *dark.select_nth_unstable_by(at, f32::total_cmp).1 };
        values.iter_mut().for_each(|v| *v = (*v / full).clamp(0.0, 1.0));
        Self { columns, rows, values }
    }

    /// The pixels of strokes.
    pub(super) fn strokes(&self) -> Vec<bool> {
        self.values.iter().map(|v| *v > STROKE).collect()
    }
}

/// The two squares whose middles surround a pixel, and the weight of the second.
fn between(pixel: usize, count: usize) -> ([usize; 2], f32) {
    let at = (pixel as f32 + 0.5) / TILE as f32 - 0.5;
    let first = at.floor().max(0.0);
    let low = (first as usize).min(count - 1);
    ([low, (low + 1).min(count - 1)], (at - first).clamp(0.0, 1.0))
}
