//! Sums costs along eight paths (semi-global matching).
//!
//! In: the costs of every pixel and disparity, row by row. Out: their sum over eight directions r,
//! `S(p, d) = Σ_r L_r(p, d)`,
//! `L_r(p, d) = C(p, d) + min(L_r(p−r, d), L_r(p−r, d±1) + P1, min_k L_r(p−r, k) + P2) − min_k L_r(p−r, k)`.
//! P2 decreases where the brightness jumps, because depth jumps are more likely there: `P2 / (1 + |ΔI| /
//! contrast)`, at least P1.
//!
//! Sums are integers, so the result does not depend on the order or the number of threads. Memory: two bytes
//! per pixel and disparity.
//!
//! Not guaranteed: a global minimum over the image, because each path is minimised alone.
//!
//! # References
//! Hirschmüller, *Stereo Processing by Semi-Global Matching and Mutual Information*, PAMI 2008, eq. 13.

use planish_estimate::Result;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::cost::MatchingCost;
use crate::Image;

/// An infinite cost, small enough that adding a penalty does not overflow.
const INFINITE_COST: u16 = 1 << 14;

/// Number of columns of a row per task. Trades parallel work against the cost of tasks.
const COLUMNS_A_TASK: usize = 64;

/// Number of rows whose costs are computed together. Trades memory against parallel work.
const ROWS_OF_COSTS: usize = 32;

/// Penalties of a path.
#[derive(Clone, Copy)]
pub(super) struct Penalties {
    /// For a step of one disparity.
    pub(super) one: u16,
    /// For a larger step, where brightness does not change.
    pub(super) more: u16,
    /// The change of brightness that halves `more`.
    pub(super) contrast: f32,
}

impl Penalties {
    fn more_at(&self, change: f32) -> u16 {
        let softened = f32::from(self.more) / (1.0 + change.abs() / self.contrast);
        (softened as u16).max(self.one + 1)
    }
}

/// Advances one path by one pixel. Each path stores its costs between two infinite entries, which no step
/// takes, followed by their minimum.
#[inline(always)]
fn step(costs: &[u8], before: &[u16], more: u16, one: u16, current: &mut [u16], sums: &mut [u16]) {
    let n = costs.len();
    let lowest = before[n + 2];
    // The minimum over all disparities is found once per pixel, which makes a step linear in their number.
    let jump = lowest.wrapping_add(more);
    let neighbours = before[..n].iter().zip(&before[2..n + 2]);
    let from = before[1..=n].iter().zip(neighbours);
    let mut smallest = u16::MAX;
    for (((current, sum), &cost), (&same, (&below, &above))) in
        current[1..=n].iter_mut().zip(sums).zip(costs).zip(from)
    {
        let adjacent = below.min(above).wrapping_add(one);
        // Subtracting the minimum keeps the cost of a path at most `MAX_COST + P2`, however long it is, so
        // eight of them fit 16 bits.
        let path = u16::from(cost).wrapping_add(same.min(adjacent).min(jump).wrapping_sub(lowest));
        *current = path;
        *sum = sum.wrapping_add(path);
        smallest = smallest.min(path);
    }
    current[n + 2] = smallest;
}

/// The state of paths before their first pixel.
fn fresh(disparities: usize, pixels: usize) -> Vec<u16> {
    let mut all = vec![0; (disparities + 3) * pixels];
    for pixel in all.chunks_exact_mut(disparities + 3) {
        pixel[0] = INFINITE_COST;
        pixel[disparities + 1] = INFINITE_COST;
    }
    all
}

/// The sums of all pixels and disparities, pixel by pixel.
///
/// `watch` receives the share of the work that is done; its error stops the computation.
pub(super) fn sums(
    image: &Image,
    cost: &MatchingCost,
    disparities: usize,
    penalties: Penalties,
    watch: &mut dyn FnMut(f64) -> Result<()>,
) -> Result<Vec<u16>> {
    let mut sums = vec![0; image.values.len() * disparities];
    along_rows(image, cost, disparities, penalties, &mut sums);
    watch(0.3)?;
    across_rows(image, cost, disparities, penalties, &mut sums, false);
    watch(0.65)?;
    across_rows(image, cost, disparities, penalties, &mut sums, true);
    watch(1.0)?;
    Ok(sums)
}

/// The two directions along the rows.
fn along_rows(
    image: &Image,
    cost: &MatchingCost,
    disparities: usize,
    penalties: Penalties,
    sums: &mut [u16],
) {
    let columns = image.columns;
    // Rows are independent in this direction, so each is a task. The sums of a row belong to one task alone.
    let row_length = columns * disparities;
    let simd = pulp::Arch::new();
    sums.par_chunks_exact_mut(row_length).enumerate().for_each_init(
        || vec![0; row_length],
        |costs, (y, sums)| {
            simd.dispatch(AlongRow {
                brightness: image.row(y),
                cost,
                row: y,
                disparities,
                penalties,
                costs,
                sums,
            });
        },
    );
}

/// Both directions along one row.
struct AlongRow<'a> {
    brightness: &'a [f32],
    cost: &'a MatchingCost,
    row: usize,
    disparities: usize,
    penalties: Penalties,
    costs: &'a mut [u8],
    sums: &'a mut [u16],
}

impl WithSimd for AlongRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { brightness, disparities, penalties, costs, sums, .. } = self;
        let columns = brightness.len();
        self.cost.row(self.row, disparities, costs);
        for backwards in [false, true] {
            let mut path = fresh(disparities, 2);
            let (mut before, mut current) = path.split_at_mut(disparities + 3);
            for k in 0..columns {
                let x = if backwards { columns - 1 - k } else { k };
                let last = if backwards { (x + 1).min(columns - 1) } else { x.saturating_sub(1) };
                let at = x * disparities..(x + 1) * disparities;
                let more = penalties.more_at(brightness[x] - brightness[last]);
                step(&costs[at.clone()], before, more, penalties.one, current, &mut sums[at]);
                std::mem::swap(&mut before, &mut current);
            }
        }
    }
}

/// The three directions from above, or those from below.
fn across_rows(
    image: &Image,
    cost: &MatchingCost,
    disparities: usize,
    penalties: Penalties,
    sums: &mut [u16],
    upwards: bool,
) {
    let (columns, rows) = (image.columns, image.rows);
    let row_length = columns * disparities;
    let width = disparities + 3;
    let simd = pulp::Arch::new();
    // Pixel by pixel, three paths each.
    let mut before = fresh(disparities, 3 * columns);
    let mut current = before.clone();
    let start = fresh(disparities, 1);
    // Costs of many rows at once, in parallel: they do not depend on each other.
    let mut costs = vec![0; row_length * ROWS_OF_COSTS.min(rows)];
    for first in (0..rows).step_by(ROWS_OF_COSTS) {
        let block = ROWS_OF_COSTS.min(rows - first);
        let row_of = |k: usize| if upwards { rows - 1 - k } else { k };
        costs[..block * row_length].par_chunks_exact_mut(row_length).enumerate().for_each(|(i, costs)| {
            let (row, disparities) = (row_of(first + i), disparities);
            simd.dispatch(RowCosts { cost, row, disparities, costs });
        });
        for i in 0..block {
            let k = first + i;
            let y = row_of(k);
            let last = if upwards { (y + 1).min(rows - 1) } else { y.saturating_sub(1) };
            let (brightness, other) = (image.row(y), image.row(last));
            let costs = &costs[i * row_length..][..row_length];
            let tasks = current
                .par_chunks_mut(COLUMNS_A_TASK * 3 * width)
                .zip(sums[y * row_length..][..row_length].par_chunks_mut(COLUMNS_A_TASK * disparities))
                .enumerate();
            tasks.for_each(|(task, (current, sums))| {
                // The row before is complete when this one starts, so the columns of a row are independent of
                // each other.
                simd.dispatch(Across {
                    first: task * COLUMNS_A_TASK,
                    begun: k > 0,
                    brightness,
                    other,
                    costs,
                    before: &before,
                    start: &start,
                    disparities,
                    penalties,
                    current,
                    sums,
                });
            });
            std::mem::swap(&mut before, &mut current);
        }
    }
}

/// The costs of one row.
struct RowCosts<'a> {
    cost: &'a MatchingCost,
    row: usize,
    disparities: usize,
    costs: &'a mut [u8],
}

impl WithSimd for RowCosts<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.cost.row(self.row, self.disparities, self.costs);
    }
}

/// Three directions across a part of a row.
struct Across<'a> {
    first: usize,
    begun: bool,
    brightness: &'a [f32],
    other: &'a [f32],
    costs: &'a [u8],
    before: &'a [u16],
    start: &'a [u16],
    disparities: usize,
    penalties: Penalties,
    current: &'a mut [u16],
    sums: &'a mut [u16],
}

impl WithSimd for Across<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { disparities, penalties, brightness, .. } = self;
        let width = disparities + 3;
        let pixels = self.current.chunks_exact_mut(3 * width).zip(self.sums.chunks_exact_mut(disparities));
        for (x, (current, sums)) in (self.first..).zip(pixels) {
            let costs = &self.costs[x * disparities..][..disparities];
            for (path, current) in current.chunks_exact_mut(width).enumerate() {
                let from = (x + path).checked_sub(1).filter(|from| *from < brightness.len() && self.begun);
                let (before, change) = match from {
                    Some(from) => {
                        (&self.before[(3 * from + path) * width..][..width], brightness[x] - self.other[from])
                    }
                    None => (self.start, 0.0),
                };
                step(costs, before, penalties.more_at(change), penalties.one, current, sums);
            }
        }
    }
}
