//! The cost of matching a pixel of the left image with one of the right.
//!
//! In: two rectified images. Out, row by row: for every pixel and disparity a cost from 0 to [`MAX_COST`].
//! The cost is [`MAX_COST`] outside of the right image.
//!
//! The cost is the Hamming distance of two census transforms (Zabih and Woodfill 1994), which are invariant
//! to exposure, plus a share of the sampling-insensitive difference of brightness (Birchfield and Tomasi
//! 1998), after each image is scaled by its contrast. Census alone fails at thin objects, whose windows
//! contain mostly background.

use rayon::prelude::*;

use crate::Image;

/// The worst cost of one pixel.
pub(super) const MAX_COST: u8 = 127;

/// Half size of the census window, columns and rows: 9 × 7 without the centre gives 62 bits, which fit a
/// `u64`.
const CENSUS: [usize; 2] = [4, 3];

/// Cost of a census bit that differs.
const CENSUS_BIT: i16 = 2;

/// Limit of the difference of brightness, in hundredths of the contrast, so that occlusions do not dominate.
const MAX_DIFFERENCE: i16 = 40;

/// Hundredths of the contrast: twice the deviation of the brightness is 100.
const CONTRAST_STEPS: f32 = 100.0;

/// Both images, prepared for the cost. Rows of the right one are reversed, so that disparities run forwards.
pub(super) struct MatchingCost {
    columns: usize,
    min_disparity: i32,
    census: [Vec<u64>; 2],
    /// Brightness, and its minimum and maximum within half a pixel along the row.
    level: [[Vec<i16>; 3]; 2],
}

impl MatchingCost {
    /// Prepares both images; `min_disparity` is the disparity with index 0.
    pub(super) fn new(left: &Image, right: &Image, min_disparity: i32) -> Self {
        let columns = left.columns;
        let mut all = Self {
            columns,
            min_disparity,
            census: [census(left), census(right)],
            level: [levels(left), levels(right)],
        };
        // Disparities then run forwards in memory, which vector instructions need.
        all.census[1].chunks_exact_mut(columns).for_each(<[u64]>::reverse);
        for level in &mut all.level[1] {
            level.chunks_exact_mut(columns).for_each(<[i16]>::reverse);
        }
        all
    }

    /// The costs of a row: `disparities` for each pixel, pixel after pixel. Meant to be inlined where wide
    /// instructions are.
    #[inline(always)]
    pub(super) fn row(&self, row: usize, disparities: usize, costs: &mut [u8]) {
        let columns = self.columns;
        let of_row = row * columns..(row + 1) * columns;
        let [left, right] = [&self.census[0][of_row.clone()], &self.census[1][of_row.clone()]];
        let [value, low, high] = self.level[0].each_ref().map(|l| &l[of_row.clone()]);
        let [right_value, right_low, right_high] = self.level[1].each_ref().map(|l| &l[of_row.clone()]);
        for (x, costs) in costs.chunks_exact_mut(disparities).enumerate() {
            costs.fill(MAX_COST);
            // Disparity d is at the backward column `first + d`, which is one of the row.
            let first = (columns - 1 - x) as i64 + i64::from(self.min_disparity);
            let skipped = (-first).clamp(0, disparities as i64) as usize;
            let start = first.clamp(0, columns as i64) as usize;
            let inside = (disparities - skipped).min(columns - start);
            let costs = &mut costs[skipped..skipped + inside];
            let range = start..start + inside;
            let candidates = (right[range.clone()].iter().zip(&right_value[range.clone()]))
                .zip(right_low[range.clone()].iter().zip(&right_high[range]));
            let (code, a, a_low, a_high) = (left[x], value[x], low[x], high[x]);
            for (cost, ((&other, &b), (&b_low, &b_high))) in costs.iter_mut().zip(candidates) {
                let bits = (code ^ other).count_ones() as i16;
                // The difference that no shift of the sampling by up to half a pixel explains.
                let one = a.wrapping_sub(b_high).max(b_low.wrapping_sub(a));
                let other = b.wrapping_sub(a_high).max(a_low.wrapping_sub(b));
                let apart = one.min(other).clamp(0, MAX_DIFFERENCE);
                *cost = CENSUS_BIT.wrapping_mul(bits).wrapping_add(apart).min(i16::from(MAX_COST)) as u8;
            }
        }
    }
}

/// Brightness in hundredths of the contrast, with its range within half a pixel.
fn levels(image: &Image) -> [Vec<i16>; 3] {
    let count = image.values.len() as f64;
    let mean = image.values.iter().map(|&v| f64::from(v)).sum::<f64>() / count;
    let variance = image.values.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / count;
    let scale = match variance > 0.0 {
        true => f64::from(CONTRAST_STEPS) / (2.0 * variance.sqrt()),
        false => 0.0,
    };
    // In units of the image's own contrast, so that exposure and gain of the two cameras cancel. Sixteen-bit
    // integers fit twice as many lanes of a vector register as floating point.
    let level = |v: f32| (((f64::from(v) - mean) * scale).clamp(-8000.0, 8000.0)) as i16;
    let mut levels: [Vec<i16>; 3] = Default::default();
    for row in 0..image.rows {
        let row = image.row(row);
        for x in 0..row.len() {
            let center = level(row[x]);
            let half =
                [x.saturating_sub(1), (x + 1).min(row.len() - 1)].map(|k| level(0.5 * (row[x] + row[k])));
            levels[0].push(center);
            // Extremes of the linear interpolation within half a pixel (Birchfield and Tomasi 1998).
            levels[1].push(center.min(half[0]).min(half[1]));
            levels[2].push(center.max(half[0]).max(half[1]));
        }
    }
    levels
}

/// One bit per pixel of the window: true if it is darker than the centre. Pixels of the border are repeated
/// beyond it.
fn census(image: &Image) -> Vec<u64> {
    let [half_columns, half_rows] = CENSUS;
    let inside = |k: usize, half: usize, n: usize| k.saturating_sub(half).min(n - 1);
    let mut all = vec![0; image.values.len()];
    all.par_chunks_mut(image.columns).enumerate().for_each(|(y, codes)| {
        // Loops over the window outside, over columns inside: each step is one comparison of two contiguous
        // rows.
        for dy in 0..=2 * half_rows {
            let other = image.row(inside(y + dy, half_rows, image.rows));
            let middle_row = image.row(y);
            for dx in 0..=2 * half_columns {
                if dy == half_rows && dx == half_columns {
                    continue;
                }
                for (x, code) in codes.iter_mut().enumerate() {
                    let darker = other[inside(x + dx, half_columns, image.columns)] < middle_row[x];
                    *code = (*code << 1) | u64::from(darker);
                }
            }
        }
    });
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(columns: usize, rows: usize, shift: usize) -> Image {
        let value = |x: usize, y: usize| ((x * 7919 + y * 104_729 + (x * y) % 13 * 31) % 97) as f32;
        let values = (0..rows).flat_map(|y| (0..columns).map(move |x| value(x + shift, y))).collect();
        Image::try_new(columns, rows, values).unwrap()
    }

    #[test]
    fn the_true_disparity_has_zero_cost_at_any_exposure() {
        let (left, mut right) = (pattern(40, 20, 0), pattern(40, 20, 3));
        for v in &mut right.values {
            *v = 2.0 * *v + 30.0;
        }
        let cost = MatchingCost::new(&left, &right, 0);
        let mut row = vec![0; 40 * 8];
        cost.row(10, 8, &mut row);
        for x in 12..30 {
            let costs = &row[8 * x..][..8];
            assert!(costs[3] <= 4, "{costs:?}");
            assert!((0..8).all(|d| d == 3 || costs[d] > 10), "{costs:?}");
        }
        // Beyond the border nothing matches.
        assert_eq!(row[8 * 2 + 5], MAX_COST);
    }

    #[test]
    fn a_window_has_one_bit_per_pixel_around_its_middle() {
        let mut image = pattern(9, 7, 0);
        image.values[3 * 9 + 4] = 1e4;
        assert_eq!(census(&image)[3 * 9 + 4].count_ones(), 62);
    }
}
