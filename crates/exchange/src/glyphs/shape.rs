//! Connected strokes, and glyphs as the network takes them.

use super::ink::Ink;

/// Cells along a side of a glyph.
pub(super) const GRID: usize = 24;
/// Cells of the longer side of a glyph's box; the others are a margin.
const INNER: f32 = 20.0;
/// Number of values about the place of a glyph in its word.
pub(super) const PLACES: usize = 4;
/// Ink at the edge of a stroke, relative to that inside.
const EDGE: f32 = 0.45;
/// Share of the pixels of a shape that are at least as dark as the ink inside its strokes.
const DARK_SHARE: f32 = 0.1;

/// Pixels of a row: first and last column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Run {
    pub(super) row: u32,
    pub(super) first: u32,
    pub(super) last: u32,
}

/// A box of pixels: first column and row, last column and row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PixelBox {
    pub(super) low: [f32; 2],
    pub(super) high: [f32; 2],
}

impl PixelBox {
    const NONE: Self = Self { low: [f32::MAX; 2], high: [f32::MIN; 2] };

    pub(super) fn size(&self, axis: usize) -> f32 {
        self.high[axis] - self.low[axis] + 1.0
    }

    pub(super) fn middle(&self, axis: usize) -> f32 {
        0.5 * (self.low[axis] + self.high[axis])
    }

    pub(super) fn joined(&self, other: &Self) -> Self {
        Self {
            low: [0, 1].map(|k| self.low[k].min(other.low[k])),
            high: [0, 1].map(|k| self.high[k].max(other.high[k])),
        }
    }
}

/// Connected pixels (eight neighbours).
#[derive(Debug, Clone)]
pub(super) struct Shape {
    pub(super) runs: Vec<Run>,
    pub(super) bounds: PixelBox,
}

impl Shape {
    pub(super) fn new(runs: Vec<Run>) -> Self {
        let bounds = runs.iter().fold(PixelBox::NONE, |b, r| {
            let row = r.row as f32;
            b.joined(&PixelBox { low: [r.first as f32, row], high: [r.last as f32, row] })
        });
        Self { runs, bounds }
    }
}

/// Connects the pixels of a mask, row by row.
pub(super) fn connected(mask: &[bool], columns: usize) -> Vec<Shape> {
    let mut runs: Vec<Run> = Vec::new();
    let mut parents: Vec<u32> = Vec::new();
    let mut above = 0..0;
    for (row, pixels) in mask.chunks_exact(columns).enumerate() {
        let begin = runs.len();
        let mut x = 0;
        let mut candidate = above.start;
        while let Some(step) = pixels[x..].iter().position(|p| *p) {
            let first = x + step;
            let length = pixels[first..].iter().position(|p| !*p).unwrap_or(columns - first);
            let own = Run { row: row as u32, first: first as u32, last: (first + length - 1) as u32 };
            let id = runs.len() as u32;
            runs.push(own);
            parents.push(id);
            while candidate < above.end && runs[candidate].last + 1 < own.first {
                candidate += 1;
            }
            let touching = (candidate..above.end).take_while(|k| runs[*k].first <= own.last + 1);
            for k in touching {
                let [a, b] = [root(&mut parents, k as u32), root(&mut parents, id)];
                parents[a.max(b) as usize] = a.min(b);
            }
            x = first + length;
        }
        above = begin..runs.len();
    }
    let mut places = vec![usize::MAX; runs.len()];
    let mut found: Vec<Vec<Run>> = Vec::new();
    for (k, run) in runs.iter().enumerate() {
        let top = root(&mut parents, k as u32) as usize;
        if places[top] == usize::MAX {
            places[top] = found.len();
            found.push(Vec::new());
        }
        found[places[top]].push(*run);
    }
    found.into_iter().map(Shape::new).collect()
}

fn root(parents: &mut [u32], mut at: u32) -> u32 {
    while parents[at as usize] != at {
        let up = parents[parents[at as usize] as usize];
        parents[at as usize] = up;
        at = up;
    }
    at
}

/// Direction in which a text is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reading {
    /// From left to right.
    Rightwards,
    /// From bottom to top.
    Upwards,
}

/// The ink of a few shapes in the frame of the reader: x along the line, y downwards.
#[derive(Debug, Clone)]
pub(super) struct Patch {
    columns: usize,
    values: Vec<f32>,
    /// Column and row of the first value in the frame of the reader.
    origin: [f32; 2],
    /// Box of the pixels at least half as dark as the strokes, in the frame of the reader.
    pub(super) bounds: PixelBox,
}

impl Patch {
    /// The ink of shapes and of the rim around them, without that of their neighbours. None if nothing is
    /// dark.
    pub(super) fn of(ink: &Ink, shapes: &[&Shape], reading: Reading) -> Option<Self> {
        let around = shapes.iter().fold(PixelBox::NONE, |b, s| b.joined(&s.bounds));
        let low = [0, 1].map(|k| (around.low[k] as usize).saturating_sub(1));
        let limits = [ink.columns - 1, ink.rows - 1];
        let high = [0, 1].map(|k| (around.high[k] as usize + 1).min(limits[k]));
        let (columns, rows) = (high[0] - low[0] + 1, high[1] - low[1] + 1);
        let mut values = vec![0.0; columns * rows];
        let mut strongest = Vec::new();
        for run in shapes.iter().flat_map(|s| &s.runs) {
            let [first, last] = [run.first as usize, run.last as usize];
            let row = run.row as usize;
            strongest.extend_from_slice(&ink.values[row * ink.columns + first..=row * ink.columns + last]);
            let [left, right] = [first.saturating_sub(1).max(low[0]), (last + 1).min(high[0])];
            for y in row.saturating_sub(1).max(low[1])..=(row + 1).min(high[1]) {
                let from = &ink.values[y * ink.columns + left..=y * ink.columns + right];
                values[(y - low[1]) * columns + left - low[0]..][..from.len()].copy_from_slice(from);
            }
        }
        let at = ((1.0 - DARK_SHARE) * (strongest.len() - 1) as f32).round() as usize;
        let dark = *strongest.select_nth_unstable_by(at, f32::total_cmp).1;
        values.iter_mut().for_each(|v| *v = (*v / dark).min(1.0));
        Self::turned(values, columns, low, ink.rows, reading)
    }

    fn turned(
        values: Vec<f32>,
        columns: usize,
        low: [usize; 2],
        rows: usize,
        reading: Reading,
    ) -> Option<Self> {
        let height = values.len() / columns;
        let (columns, values, origin) = match reading {
            Reading::Rightwards => (columns, values, low.map(|v| v as f32)),
            // A pixel (x, y) is at (rows − 1 − y, x).
            Reading::Upwards => {
                let turned = (0..columns)
                    .flat_map(|x| (0..height).rev().map(move |y| (x, y)))
                    .map(|(x, y)| values[y * columns + x]);
                (height, turned.collect(), [(rows - low[1] - height) as f32, low[0] as f32])
            }
        };
        let mut patch = Self { columns, values, origin, bounds: PixelBox::NONE };
        patch.bounds = patch.dark_box(0.0, f32::MAX)?;
        Some(patch)
    }

    /// Box of the dark pixels between two columns (in the frame of the reader).
    fn dark_box(&self, left: f32, right: f32) -> Option<PixelBox> {
        let dark = self.values.iter().enumerate().filter(|(_, v)| **v > EDGE);
        let places = dark.map(|(k, _)| [k % self.columns, k / self.columns]);
        let found = places.map(|p| [0, 1].map(|c| self.origin[c] + p[c] as f32));
        let bounds = found
            .filter(|p| (left..=right).contains(&p[0]))
            .fold(PixelBox::NONE, |b, p| b.joined(&PixelBox { low: p, high: p }));
        (bounds.low[0] <= bounds.high[0]).then_some(bounds)
    }

    /// Ink of every column, with the column.
    pub(super) fn column_sums(&self) -> Vec<(f32, f32)> {
        let sum = |x: usize| self.values.iter().skip(x).step_by(self.columns).sum();
        (0..self.columns).map(|x| (self.origin[0] + x as f32, sum(x))).collect()
    }

    /// The part between two columns; None if nothing is dark there.
    pub(super) fn part(&self, left: f32, right: f32) -> Option<Self> {
        let mut part = self.clone();
        for (k, value) in part.values.iter_mut().enumerate() {
            let x = self.origin[0] + (k % self.columns) as f32;
            if !(left..=right).contains(&x) {
                *value = 0.0;
            }
        }
        part.bounds = part.dark_box(left, right)?;
        Some(part)
    }

    /// Several patches as one.
    pub(super) fn joined(patches: &[&Self]) -> Self {
        let bounds = patches.iter().fold(PixelBox::NONE, |b, p| b.joined(&p.bounds));
        let low = [0, 1].map(|c| patches.iter().map(|p| p.origin[c]).fold(f32::MAX, f32::min));
        let end = |p: &Self, c: usize| p.origin[c] + [p.columns, p.values.len() / p.columns][c] as f32;
        let size = [0, 1].map(|c| (patches.iter().map(|p| end(p, c)).fold(0.0, f32::max) - low[c]) as usize);
        let mut values = vec![0.0_f32; size[0] * size[1]];
        for patch in patches {
            let at = [0, 1].map(|c| (patch.origin[c] - low[c]) as usize);
            for (k, row) in patch.values.chunks_exact(patch.columns).enumerate() {
                let own = &mut values[(at[1] + k) * size[0] + at[0]..][..row.len()];
                own.iter_mut().zip(row).for_each(|(a, b)| *a = a.max(*b));
            }
        }
        Self { columns: size[0], values, origin: low, bounds }
    }

    fn at(&self, x: f32, y: f32) -> f32 {
        let [x, y] = [x - self.origin[0], y - self.origin[1]];
        let (left, top) = (x.floor(), y.floor());
        let rows = (self.values.len() / self.columns) as f32;
        let pixel = |x: f32, y: f32| match x >= 0.0 && y >= 0.0 && x < self.columns as f32 && y < rows {
            true => self.values[y as usize * self.columns + x as usize],
            false => 0.0,
        };
        let line = |y: f32| pixel(left, y) + (x - left) * (pixel(left + 1.0, y) - pixel(left, y));
        line(top) + (y - top) * (line(top + 1.0) - line(top))
    }

    /// The glyph of this patch in a line with a baseline and a height of capitals.
    pub(super) fn glyph(&self, line: &Line) -> Glyph {
        let bounds = &self.bounds;
        let scale = INNER / bounds.size(0).max(bounds.size(1));
        let fine = (1.0 / scale).ceil().clamp(1.0, 6.0) as usize;
        let step =
            |k: usize, f: usize| (k as f32 + (f as f32 + 0.5) / fine as f32 - GRID as f32 / 2.0) / scale;
        let mut cells = Vec::with_capacity(GRID * GRID);
        for row in 0..GRID {
            for column in 0..GRID {
                let mut sum = 0.0;
                for (i, j) in (0..fine).flat_map(|i| (0..fine).map(move |j| (i, j))) {
                    sum += self.at(bounds.middle(0) + step(column, j), bounds.middle(1) + step(row, i));
                }
                cells.push(sum / (fine * fine) as f32);
            }
        }
        let above = line.base_at(bounds.middle(0)) - bounds.high[1] - 0.5;
        let place = [bounds.size(1), above, bounds.size(0)].map(|v| v / line.height);
        Glyph {
            cells,
            place: [place[0], place[1], place[2], line.height.min(48.0) / 32.0].map(|v| v.clamp(-1.0, 3.0)),
        }
    }
}

/// A line of text in the frame of the reader.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    /// Height of capitals and digits.
    pub(super) height: f32,
    /// Row of the baseline at column 0, and its slope.
    pub(super) base: [f32; 2],
}

impl Line {
    pub(super) fn base_at(&self, x: f32) -> f32 {
        self.base[0] + self.base[1] * x
    }
}

/// A glyph as the network takes it.
pub(super) struct Glyph {
    /// Ink in a grid of 24 × 24 cells, row by row.
    pub(super) cells: Vec<f32>,
    /// Height, distance from the baseline and width in heights of the line, and that height in units of 32
    /// pixels.
    pub(super) place: [f32; PLACES],
}
