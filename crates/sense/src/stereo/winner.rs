//! Selects the disparity of minimum cost, and the tests that accept or reject it.
//!
//! In: sums for each pixel and disparity. Out: for each pixel its best disparity with subpixel interpolation,
//! and three tests: a unique minimum, the same match from the right image, no speckle.
//!
//! Disparities of the right image come from the diagonals of the same sums (Hirschmüller 2008, section 2.3).
//!
//! Not guaranteed: repetitive patterns may pass all tests.

use rayon::prelude::*;

/// The best disparity of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Winner {
    /// The index of the minimum sum.
    pub(super) best: u16,
    /// True if no disparity other than its neighbours has a similar sum.
    pub(super) clear: bool,
    /// True at either end of the search range: disparities outside may match better.
    pub(super) at_end: bool,
    /// The minimum between whole numbers, as an index.
    pub(super) between: f32,
}

/// The winners of all pixels.
///
/// `share` is the minimum excess of the next best sum, in hundredths. `min_disparity` is that of index 0.
/// Near the beginning of a row, large disparities are outside the right image. A smallest sum at either end
/// of the range is not a minimum.
pub(super) fn winners(
    sums: &[u16],
    columns: usize,
    disparities: usize,
    min_disparity: i32,
    share: u32,
) -> Vec<Winner> {
    sums.par_chunks_exact(disparities)
        .enumerate()
        .map(|(pixel, sums)| {
            let mut found = winner(sums, share);
            // Near the border the range ends where the match would leave the right image.
            let within = (pixel % columns) as i64 - i64::from(min_disparity);
            let last = within.min(disparities as i64 - 1);
            found.at_end = found.best == 0 || i64::from(found.best) >= last;
            found
        })
        .collect()
}

fn winner(sums: &[u16], share: u32) -> Winner {
    let minimum = sums.iter().copied().min().unwrap_or(0);
    let best = sums.iter().position(|s| *s == minimum).unwrap_or(0);
    // Direct neighbours of a minimum always have similar sums.
    let others = sums[..best.saturating_sub(1)].iter().chain(sums.iter().skip(best + 2));
    // In integers, so that the comparison below is exact.
    let next = others.copied().min().unwrap_or(u16::MAX);
    Winner {
        best: best as u16,
        clear: u32::from(next) * 100 > u32::from(minimum) * (100 + share),
        at_end: best == 0 || best + 1 == sums.len(),
        between: best as f32 + offset(sums, best),
    }
}

/// Position of the minimum between whole numbers, from two lines of equal slope through three sums (Shimizu
/// and Okutomi 2001). Sums of absolute differences and Hamming distances follow lines rather than a parabola.
fn offset(sums: &[u16], best: usize) -> f32 {
    if best == 0 || best + 1 >= sums.len() {
        return 0.0;
    }
    let [below, middle, above] = [best - 1, best, best + 1].map(|d| f32::from(sums[d]));
    let rise = below.max(above) - middle;
    if rise > 0.0 { 0.5 * (below - above) / rise } else { 0.0 }
}

/// The index of the disparity of each pixel of the right image, row by row; `min_disparity` is that of index
/// 0.
pub(super) fn right_winners(
    sums: &[u16],
    columns: usize,
    disparities: usize,
    min_disparity: i32,
) -> Vec<u16> {
    let rows = sums.len() / (columns * disparities);
    let mut all = vec![0; columns * rows];
    let rows = all.par_chunks_exact_mut(columns).zip(sums.par_chunks_exact(columns * disparities));
    rows.for_each(|(winners, sums)| {
        let mut costs = vec![u16::MAX; columns];
        for (x, sums) in sums.chunks_exact(disparities).enumerate() {
            for (d, &sum) in sums.iter().enumerate() {
                let right_column = x as i64 - i64::from(min_disparity) - d as i64;
                if let Some(right_column) = usize::try_from(right_column).ok().filter(|t| *t < columns)
                    && sum < costs[right_column]
                {
                    // From the same sums, transposed: a second matching from the right image would double the
                    // time.
                    costs[right_column] = sum;
                    winners[right_column] = d as u16;
                }
            }
        }
    });
    all
}

/// The sizes of the regions in which neighbours differ by no more than `step`; 0 where a value is not finite.
pub(super) fn region_sizes(values: &[f32], columns: usize, step: f32) -> Vec<u32> {
    let mut label = vec![u32::MAX; values.len()];
    let mut sizes = Vec::new();
    let mut stack = Vec::new();
    for start in 0..values.len() {
        if label[start] != u32::MAX || !values[start].is_finite() {
            continue;
        }
        let name = sizes.len() as u32;
        label[start] = name;
        stack.push(start);
        let mut size = 0_u32;
        // An explicit stack: recursion over a large region would overflow that of the thread.
        while let Some(k) = stack.pop() {
            size += 1;
            let x = k % columns;
            let around = [
                (x > 0).then(|| k - 1),
                (x + 1 < columns).then_some(k + 1),
                k.checked_sub(columns),
                Some(k + columns).filter(|n| *n < values.len()),
            ];
            for n in around.into_iter().flatten() {
                // NaN fails the comparison.
                if label[n] == u32::MAX && (values[n] - values[k]).abs() <= step {
                    label[n] = name;
                    stack.push(n);
                }
            }
        }
        sizes.push(size);
    }
    let size = |name: &u32| {
        if *name == u32::MAX { 0 } else { sizes[*name as usize] }
    };
    label.iter().map(size).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subpixel_minima_and_ambiguous_ones_are_found() {
        // A vee with its foot at 2.25.
        let sums = [325_u16, 225, 125, 175, 275, 375].map(|s| s + 100);
        let w = winner(&sums, 10);
        assert!((w.between - 2.25).abs() < 1e-6 && w.clear, "{w:?}");
        let mut costs = vec![900_u16; 32];
        (costs[4], costs[24]) = (100, 110);
        let w = winner(&costs, 15);
        assert!(w.best == 4 && !w.clear, "{w:?}");
    }

    #[test]
    fn a_minimum_at_an_end_of_the_range_is_rejected() {
        // Two pixels at columns 0 and 9 of one row, disparities 2 to 5; the least is at the second, then at
        // either end.
        let clear = |sums: [u16; 4], column: usize| {
            let mut row = vec![200_u16; 40];
            row[4 * column..4 * column + 4].copy_from_slice(&sums);
            let w = winners(&row, 10, 4, 2, 10)[column];
            w.clear && !w.at_end
        };
        assert!(clear([200, 100, 200, 300], 9));
        assert!(!clear([100, 200, 300, 400], 9));
        assert!(!clear([400, 300, 200, 100], 9));
        // Disparities 4 and 5 look beyond the right image from column 3.
        assert!(!clear([200, 100, 200, 300], 3));
    }

    #[test]
    fn right_matches_agree_with_left_matches() {
        // One row of six pixels, disparities 1 and 2; pixel 4 matches pixel 2 best.
        let mut sums = vec![50_u16; 12];
        sums[4 * 2 + 1] = 1;
        assert_eq!(right_winners(&sums, 6, 2, 1)[2], 1);
    }

    #[test]
    fn regions_end_at_steps_and_rejected_pixels() {
        let nan = f32::NAN;
        let sizes = region_sizes(&[1.0, 1.5, 9.0, nan, 1.2, 9.5, 9.0, nan], 4, 1.0);
        assert_eq!(sizes, [3, 3, 3, 0, 3, 3, 3, 0]);
    }
}
