//! Ink on paper: how much of each pixel is covered by lines, under uneven light and noise.

use super::paper_edge::Quad;
use planish_sense::Image;

/// Minimum number of pixels of a block on the page.
const MIN_BLOCK: usize = 100;
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
/// Thin lines that blur has made faint: share of the largest coverage nearby, the distance that is nearby in
/// pixels, and the minimum coverage, which is above the artefacts of JPEG beside wide lines (up to 0.1 at
/// quality 50). The flanks of a wide blurred line fall below the share within this distance.
const FAINT_SHARE: f32 = 0.55;
const FAINT_REACH: usize = 3;
const FAINTEST: f32 = 0.12;

/// How much of each pixel is ink.
#[derive(Debug, Clone)]
pub(super) struct Ink {
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// About 0 (paper, with noise of both signs) to 1 (ink), row by row.
    pub(super) coverage: Vec<f32>,
    /// Whether a pixel belongs to a line.
    pub(super) mask: Vec<bool>,
    /// Share of the pixels at the border of lines that are grey: small if each pixel is black or white.
    pub(super) grey_share: f64,
}

impl Ink {
    /// Separates ink from paper; none if there is no ink. Pixels outside of a page are paper.
    pub(super) fn new(image: &Image, page: Option<&Quad>) -> Option<Self> {
        let (columns, rows) = (image.columns, image.rows);
        let mut values: Vec<f32> =
            image.values.iter().map(|v| if v.is_finite() { *v } else { 0.0 }).collect();
        let [low, high] = values.iter().fold([f32::MAX, f32::MIN], |[l, h], v| [l.min(*v), h.max(*v)]);
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len().max(1) as f64;
        let is_page: Vec<bool> = match page {
            Some(page) => (0..values.len()).map(|k| page.contains(k % columns, k / columns)).collect(),
            None => Vec::new(),
        };
        // Light lines on dark ground.
        if page.is_none() && mean < 0.5 * f64::from(low + high) {
            values.iter_mut().for_each(|v| *v = -*v);
        }
        let paper = paper_of(&values, &is_page, columns, rows);
        let mut contrast: Vec<f32> = values.iter().zip(&paper).map(|(v, p)| p - v).collect();
        // With noise, the rank of the paper's brightness is above its mean.
        let bias = ranked(&mut on_page(&contrast, &is_page), 0.5);
        contrast.iter_mut().for_each(|c| *c -= bias);
        contrast.iter_mut().zip(&is_page).filter(|(_, is_page)| !**is_page).for_each(|(c, _)| *c = 0.0);
        let largest = contrast.iter().copied().fold(0.0, f32::max);
        let mut dark: Vec<f32> = contrast.iter().copied().filter(|c| *c > FAINT * largest).collect();
        if dark.is_empty() || largest <= 0.0 {
            return None;
        }
        let full = ranked(&mut dark, 0.8);
        contrast.iter_mut().for_each(|c| *c /= full);
        Some(Self::from_contrast(columns, rows, contrast))
    }

    /// Ink by its contrast: about 0 on paper and 1 on wide lines.
    pub(super) fn from_contrast(columns: usize, rows: usize, contrast: Vec<f32>) -> Self {
        // Outside of the page, contrast is exactly zero, as is that of the paper of clean pictures.
        let mut noise: Vec<f32> = contrast.iter().map(|c| c.abs()).filter(|c| *c > 0.0).collect();
        let noise = match noise.len() * 5 > contrast.len() {
            true => 1.48 * ranked(&mut noise, 0.5),
            false => 0.0,
        };
        let coverage: Vec<f32> = contrast.into_iter().map(|c| c.clamp(-1.0, 1.0)).collect();
        let level = COVERED.max(NOISE_FACTOR * noise);
        let faintest = FAINTEST.max(NOISE_FACTOR * noise);
        let nearby = largest_nearby(&coverage, columns, rows);
        let is_ink = |(c, n): (&f32, &f32)| *c >= level || (*c >= faintest && *c >= FAINT_SHARE * n);
        let mask: Vec<bool> = coverage.iter().zip(&nearby).map(is_ink).collect();
        let grey_share = grey_share(&coverage, &mask, columns, rows);
        Self { columns, rows, coverage, mask, grey_share }
    }

    /// Makes a pixel paper.
    pub(super) fn clear(&mut self, k: usize) {
        self.mask[k] = false;
        self.coverage[k] = 0.0;
    }

    /// Dark lines on white paper.
    pub(super) fn image(&self) -> Image {
        let values = self.coverage.iter().map(|c| 255.0 * (1.0 - c.clamp(0.0, 1.0))).collect();
        Image { columns: self.columns, rows: self.rows, values }
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

/// Share of the pixels at the border of lines that are grey.
fn grey_share(coverage: &[f32], mask: &[bool], columns: usize, rows: usize) -> f64 {
    let is_border = |k: usize| {
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
    for k in (0..mask.len()).filter(|k| is_border(*k)) {
        at_border += 1;
        grey += usize::from((0.1..0.9).contains(&coverage[k]));
    }
    grey as f64 / at_border.max(1) as f64
}

/// The largest coverage in the square around each pixel.
fn largest_nearby(coverage: &[f32], columns: usize, rows: usize) -> Vec<f32> {
    let mut in_row = vec![0.0_f32; coverage.len()];
    for (row, out) in coverage.chunks_exact(columns).zip(in_row.chunks_exact_mut(columns)) {
        for (x, largest) in out.iter_mut().enumerate() {
            let near = &row[x.saturating_sub(FAINT_REACH)..(x + FAINT_REACH + 1).min(columns)];
            *largest = near.iter().copied().fold(0.0, f32::max);
        }
    }
    let mut found = in_row.clone();
    for y in 0..rows {
        let own = y * columns;
        for other in y.saturating_sub(FAINT_REACH)..(y + FAINT_REACH + 1).min(rows) {
            let near = &in_row[other * columns..(other + 1) * columns];
            for (largest, value) in found[own..own + columns].iter_mut().zip(near) {
                *largest = largest.max(*value);
            }
        }
    }
    found
}

/// The value at a rank from 0 to 1.
fn ranked(values: &mut [f32], rank: f64) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let at = ((values.len().max(1) - 1) as f64 * rank) as usize;
    values.select_nth_unstable_by(at, f32::total_cmp).1.to_owned()
}

/// The values on the page; all if the page is the whole picture.
fn on_page(values: &[f32], is_page: &[bool]) -> Vec<f32> {
    match is_page.is_empty() {
        true => values.to_vec(),
        false => values.iter().zip(is_page).filter(|(_, is_page)| **is_page).map(|(v, _)| *v).collect(),
    }
}

/// Brightness of the paper at each pixel, interpolated between blocks.
fn paper_of(values: &[f32], is_page: &[bool], columns: usize, rows: usize) -> Vec<f32> {
    let (wide, high) = (columns.div_ceil(BLOCK), rows.div_ceil(BLOCK));
    let mut blocks = vec![f32::NAN; wide * high];
    for j in 0..high {
        for i in 0..wide {
            let mut own: Vec<f32> = Vec::with_capacity(BLOCK * BLOCK);
            for y in j * BLOCK..((j + 1) * BLOCK).min(rows) {
                let (from, to) = (y * columns + i * BLOCK, y * columns + ((i + 1) * BLOCK).min(columns));
                match is_page.is_empty() {
                    true => own.extend(&values[from..to]),
                    false => own.extend(on_page(&values[from..to], &is_page[from..to])),
                }
            }
            if is_page.is_empty() || own.len() > MIN_BLOCK {
                blocks[j * wide + i] = ranked(&mut own, PAPER_RANK);
            }
        }
    }
    // Of blocks that are mostly ink, the paper is that of a neighbour.
    let around = |i: usize, j: usize| {
        let rows = j.saturating_sub(1)..=(j + 1).min(high - 1);
        let all = rows.flat_map(|j| (i.saturating_sub(1)..=(i + 1).min(wide - 1)).map(move |i| (i, j)));
        let mut all: Vec<f32> = all.map(|(i, j)| blocks[j * wide + i]).filter(|v| v.is_finite()).collect();
        (!all.is_empty()).then(|| ranked(&mut all, 0.5))
    };
    let smooth: Vec<f32> =
        (0..blocks.len()).map(|k| around(k % wide, k / wide).unwrap_or(f32::NAN)).collect();
    let smooth = without_gaps(smooth, wide);
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

/// Fills values that are not known, outside of the page, with those before or after them.
fn without_gaps(mut values: Vec<f32>, wide: usize) -> Vec<f32> {
    for row in values.chunks_exact_mut(wide) {
        let mut last = f32::NAN;
        for k in (0..wide).chain((0..wide).rev()) {
            if row[k].is_finite() {
                last = row[k];
            } else {
                row[k] = last;
            }
        }
    }
    let any = values.iter().copied().find(|v| v.is_finite()).unwrap_or(0.0);
    values.iter_mut().filter(|v| !v.is_finite()).for_each(|v| *v = any);
    values
}
