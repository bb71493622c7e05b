//! Ink on paper: how much of each pixel is covered by lines, under uneven light and noise.

use planish_sense::Image;

/// Side of the blocks in which the brightness of the paper is measured, in pixels.
const BLOCK: usize = 32;
/// Share of the pixels of a block that are darker than its paper.
const PAPER_RANK: f64 = 0.75;
/// Contrast from which on a pixel may be ink, relative to the largest one.
const FAINT: f32 = 0.25;
/// Coverage from which on a pixel belongs to a line. Lines of one pixel between two rows cover half of each.
const COVERED: f32 = 0.38;
/// Minimum threshold in standard deviations of the noise of the paper.
const NOISE_FACTOR: f32 = 6.0;

/// How much of each pixel is ink.
#[derive(Debug, Clone)]
pub(super) struct Ink {
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// From 0 (paper) to 1 (ink), row by row.
    pub(super) coverage: Vec<f32>,
    /// Whether a pixel belongs to a line.
    pub(super) mask: Vec<bool>,
    /// Share of the pixels at the border of lines that are grey: small if each pixel is black or white.
    pub(super) grey_share: f64,
}

impl Ink {
    /// Separates ink from paper; none if there is no ink.
    pub(super) fn new(image: &Image) -> Option<Self> {
        let (columns, rows) = (image.columns, image.rows);
        let mut values: Vec<f32> =
            image.values.iter().map(|v| if v.is_finite() { *v } else { 0.0 }).collect();
        let [low, high] = values.iter().fold([f32::MAX, f32::MIN], |[l, h], v| [l.min(*v), h.max(*v)]);
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len().max(1) as f64;
        // Light lines on dark ground.
        if mean < 0.5 * f64::from(low + high) {
            values.iter_mut().for_each(|v| *v = -*v);
        }
        let paper = paper_of(&values, columns, rows);
        let contrast: Vec<f32> = values.iter().zip(&paper).map(|(v, p)| p - v).collect();
        let largest = contrast.iter().copied().fold(0.0, f32::max);
        let mut dark: Vec<f32> = contrast.iter().copied().filter(|c| *c > FAINT * largest).collect();
        if dark.is_empty() || largest <= 0.0 {
            return None;
        }
        let full = ranked(&mut dark, 0.8);
        let coverage: Vec<f32> = contrast.iter().map(|c| (c / full).clamp(0.0, 1.0)).collect();
        let mut noise: Vec<f32> = contrast.iter().map(|c| (c / full).abs()).collect();
        let noise = 1.48 * ranked(&mut noise, 0.5);
        let level = COVERED.max(NOISE_FACTOR * noise);
        let mask: Vec<bool> = coverage.iter().map(|c| *c >= level).collect();
        let border = |k: usize| {
            let (x, y) = (k % columns, k / columns);
            let beside = |dx: isize, dy: isize| {
                let (x, y) = (x as isize + dx, y as isize + dy);
                (0..columns as isize).contains(&x)
                    && (0..rows as isize).contains(&y)
                    && mask[y as usize * columns + x as usize] != mask[k]
            };
            beside(1, 0) || beside(-1, 0) || beside(0, 1) || beside(0, -1)
        };
        let (mut at_border, mut grey) = (0_usize, 0_usize);
        for k in (0..mask.len()).filter(|k| border(*k)) {
            at_border += 1;
            grey += usize::from((0.1..0.9).contains(&coverage[k]));
        }
        let grey_share = grey as f64 / at_border.max(1) as f64;
        Some(Self { columns, rows, coverage, mask, grey_share })
    }

    /// Coverage at a place between pixels; centres of pixels are at whole numbers.
    pub(super) fn at(&self, p: [f64; 2]) -> f64 {
        let [x, y] = [p[0].clamp(0.0, self.columns as f64 - 1.0), p[1].clamp(0.0, self.rows as f64 - 1.0)];
        let (i, j) = ((x as usize).min(self.columns.max(2) - 2), (y as usize).min(self.rows.max(2) - 2));
        let (u, v) = (x - i as f64, y - j as f64);
        let pixel = |i: usize, j: usize| {
            let (i, j) = (i.min(self.columns - 1), j.min(self.rows - 1));
            f64::from(self.coverage[j * self.columns + i])
        };
        (1.0 - v) * ((1.0 - u) * pixel(i, j) + u * pixel(i + 1, j))
            + v * ((1.0 - u) * pixel(i, j + 1) + u * pixel(i + 1, j + 1))
    }
}

/// The value at a rank from 0 to 1.
fn ranked(values: &mut [f32], rank: f64) -> f32 {
    let at = ((values.len().max(1) - 1) as f64 * rank) as usize;
    values.select_nth_unstable_by(at, f32::total_cmp).1.to_owned()
}

/// Brightness of the paper at each pixel, interpolated between blocks.
fn paper_of(values: &[f32], columns: usize, rows: usize) -> Vec<f32> {
    let (wide, high) = (columns.div_ceil(BLOCK), rows.div_ceil(BLOCK));
    let mut blocks = vec![0.0_f32; wide * high];
    for j in 0..high {
        for i in 0..wide {
            let mut own: Vec<f32> = Vec::with_capacity(BLOCK * BLOCK);
            for y in j * BLOCK..((j + 1) * BLOCK).min(rows) {
                let row = &values[y * columns..(y + 1) * columns];
                own.extend(&row[i * BLOCK..((i + 1) * BLOCK).min(columns)]);
            }
            blocks[j * wide + i] = ranked(&mut own, PAPER_RANK);
        }
    }
    // Of blocks that are mostly ink, the paper is that of a neighbour.
    let around = |i: usize, j: usize| {
        let rows = j.saturating_sub(1)..=(j + 1).min(high - 1);
        let all = rows.flat_map(|j| (i.saturating_sub(1)..=(i + 1).min(wide - 1)).map(move |i| (i, j)));
        let mut all: Vec<f32> = all.map(|(i, j)| blocks[j * wide + i]).collect();
        ranked(&mut all, 0.5)
    };
    let smooth: Vec<f32> = (0..blocks.len()).map(|k| around(k % wide, k / wide)).collect();
    let mut paper = Vec::with_capacity(values.len());
    let place = |p: usize, count: usize| {
        let at = ((p as f32 + 0.5) / BLOCK as f32 - 0.5).clamp(0.0, (count - 1) as f32);
        let low = at as usize;
        (low, (low + 1).min(count - 1), at - low as f32)
    };
    for y in 0..rows {
        let (j, k, v) = place(y, high);
        for x in 0..columns {
            let (i, m, u) = place(x, wide);
            let row = |j: usize| (1.0 - u) * smooth[j * wide + i] + u * smooth[j * wide + m];
            paper.push((1.0 - v) * row(j) + v * row(k));
        }
    }
    paper
}
