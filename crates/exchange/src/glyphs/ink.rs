//! Ink: how dark a pixel is between paper (0) and lines (1), without the unevenness of the light.

use super::shape::{Reading, Shape, connected};
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
        if high <= low {
            return Self { columns, rows, values: vec![0.0; columns * rows] };
        }
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

    /// Points too faint for strokes: in small texts those of numbers are smaller than a pixel or blurred.
    pub(super) fn faint_points(&self) -> Vec<Shape> {
        /// Ink that noise of a picture rarely has.
        const FAINT: f32 = 0.18;
        /// Ink of all pixels of a point. Noise of 5 % has a standard deviation of 0.15 in nine pixels.
        const LEAST: f32 = 0.45;
        const LARGEST: f32 = 5.0;
        let mask: Vec<bool> = self.values.iter().map(|v| *v > FAINT).collect();
        let is_point = |shape: &Shape| {
            let pixels = shape.runs.iter().flat_map(|r| {
                let at = r.row as usize * self.columns;
                &self.values[at + r.first as usize..=at + r.last as usize]
            });
            let (total, top) = pixels.fold((0.0, 0.0), |(sum, top): (f32, f32), v| (sum + v, top.max(*v)));
            top <= STROKE && total >= LEAST && shape.bounds.size(0).max(shape.bounds.size(1)) <= LARGEST
        };
        connected(&mask, self.columns).into_iter().filter(is_point).collect()
    }

    /// The strongest ink between two columns and two rows in the frame of a reader, ends included.
    pub(super) fn strongest(&self, low: [f32; 2], high: [f32; 2], reading: Reading) -> f32 {
        let last = [self.columns - 1, self.rows - 1];
        let clamped = |v: f32, k: usize| (v.max(0.0) as usize).min(last[k]);
        let ([left, top], [right, bottom]) = match reading {
            Reading::Rightwards => {
                ([clamped(low[0], 0), clamped(low[1], 1)], [clamped(high[0], 0), clamped(high[1], 1)])
            }
            Reading::Upwards => {
                let row = |v: f32| clamped(last[1] as f32 - v, 1);
                ([clamped(low[1], 0), row(high[0])], [clamped(high[1], 0), row(low[0])])
            }
        };
        let rows = (top..=bottom)
            .map(|y| &self.values[y * self.columns + left..=y * self.columns + right.max(left)]);
        rows.flatten().copied().fold(0.0, f32::max)
    }
}

/// The two squares whose middles surround a pixel, and the weight of the second.
fn between(pixel: usize, count: usize) -> ([usize; 2], f32) {
    let at = (pixel as f32 + 0.5) / TILE as f32 - 0.5;
    let first = at.floor().max(0.0);
    let low = (first as usize).min(count - 1);
    ([low, (low + 1).min(count - 1)], (at - first).clamp(0.0, 1.0))
}
