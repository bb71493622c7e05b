//! Dense stereo: disparities with σ from two rectified images.
//!
//! In: two images whose rows correspond, and the range of disparities. Out: a [`DisparityMap`], which
//! [`StereoCamera`](crate::StereoCamera) turns into points.
//!
//! | module | content |
//! |---|---|
//! | cost | matching cost from census and brightness |
//! | paths | costs summed along eight paths |
//! | winner | best disparity, uniqueness, left-right check, speckles |
//! | subpixel | least squares on brightness: subpixel disparity and σ |
//!
//! Not guaranteed: disparities in repetitive or untextured regions may be wrong. Their σ is large, but may be
//! too small.
//!
//! # References
//! Hirschmüller, *Stereo Processing by Semi-Global Matching and Mutual Information*, PAMI 2008.

mod cost;
mod paths;
mod subpixel;
#[cfg(test)]
mod tests;
mod winner;

use planish_estimate::{Error, Result};

use crate::Image;
use cost::MatchingCost;
use paths::Penalties;

/// Maximum number of pixels times disparities, at two bytes each: a memory limit of 12 GB.
const MAX_CELLS: usize = 6_000_000_000;

/// Largest difference between neighbours of one region of disparities, in pixels: the accuracy before the
/// refinement.
const SPECKLE_STEP: f32 = 1.0;

/// Largest σ of a disparity, in pixels. A window without texture adds nothing to the integer disparity.
const MAX_SIGMA: f32 = 1.0;

/// Options of [`match_stereo`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoOptions {
    /// Minimum disparity, in pixels.
    pub min_disparity: i32,
    /// Number of integer disparities to search, from the minimum on.
    pub disparities: usize,
    /// Penalty P1 of a change of disparity by one between pixels. For comparison, a bit of the census costs
    /// 2.
    pub small_step: u16,
    /// Penalty P2 of a larger change where the brightness is constant.
    pub large_step: u16,
    /// Margin by which the second minimum must exceed the best one, in percent.
    pub uniqueness: u32,
    /// Maximum difference to the disparity found from the right image, in pixels.
    pub left_right: u32,
    /// Minimum number of pixels of a region; smaller ones are rejected as speckle.
    pub speckle: u32,
}

impl Default for StereoOptions {
    fn default() -> Self {
        Self {
            min_disparity: 0,
            disparities: 64,
            small_step: 45,
            large_step: 300,
            uniqueness: 3,
            left_right: 1,
            speckle: 100,
        }
    }
}

/// Number of pixels without a disparity, by the first cause that applies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StereoRejected {
    /// Another disparity is nearly as good, or there is no texture at all.
    pub ambiguous: usize,
    /// The right image disagrees, mostly where only the left camera sees the surface.
    pub left_right: usize,
    /// The region is too small.
    pub speckle: usize,
    /// At an end of the search range, so the true disparity may be outside.
    pub range: usize,
}

/// Disparities of the left image: `x_right = x_left − d`.
#[derive(Debug, Clone, PartialEq)]
pub struct DisparityMap {
    /// Pixels in a row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Disparity of each pixel, row by row; NaN where it was rejected.
    pub disparity: Vec<f32>,
    /// σ of each disparity, in pixels; NaN where it was rejected.
    pub sigma: Vec<f32>,
    /// Counts of rejected pixels.
    pub rejected: StereoRejected,
}

/// Matches two rectified images by semi-global matching.
///
/// Cost: two bytes and about 40 ns on one core per pixel and disparity. `watch` receives the completed share
/// of the work between steps; an error that it returns stops the matching.
///
/// # Errors
/// `Input` for images of different sizes or smaller than a window, or options out of range; `Unsupported` if
/// the sums would need more than 12 GB; the error of `watch`.
///
/// # Examples
/// ```
/// use planish_sense::{Image, StereoOptions, match_stereo};
/// // A texture that is shifted by 3 pixels in the right image.
/// let texture = |u: usize, v: usize| ((u * 7919 + v * 104_729) % 251) as f32;
/// let image = |shift: usize| {
///     Image::try_new(64, 48, (0..64 * 48).map(|k| texture(k % 64 + shift, k / 64)).collect())
/// };
/// let options = StereoOptions { disparities: 16, ..StereoOptions::default() };
/// let map = match_stereo(&image(0)?, &image(3)?, &options, &mut |_| Ok(()))?;
/// let d = map.disparity[24 * 64 + 40];
/// assert!((d - 3.0).abs() < 0.2, "{d}");
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn match_stereo(
    left: &Image,
    right: &Image,
    options: &StereoOptions,
    watch: &mut dyn FnMut(f64) -> Result<()>,
) -> Result<DisparityMap> {
    check(left, right, options)?;
    let columns = left.columns;
    let disparities = options.disparities;
    let contrast = contrast(left);
    let cost = MatchingCost::new(left, right, options.min_disparity);
    let penalties = Penalties { one: options.small_step, more: options.large_step, contrast };
    let sums = paths::sums(left, &cost, disparities, penalties, &mut |share| watch(0.7 * share))?;
    let winners = winner::winners(&sums, columns, disparities, options.min_disparity, options.uniqueness);
    let right_best = winner::right_winners(&sums, columns, disparities, options.min_disparity);
    // The sums of costs are by far the largest array. They are freed before the refinement allocates.
    drop(sums);
    watch(0.8)?;

    let mut rejected = StereoRejected::default();
    let mut first = vec![f32::NAN; winners.len()];
    for (k, w) in winners.iter().enumerate() {
        let right_column = (k % columns) as i64 - i64::from(options.min_disparity) - i64::from(w.best);
        let agrees =
            usize::try_from(right_column).ok().filter(|t| *t < columns).is_some_and(|right_column| {
                let other = right_best[k - k % columns + right_column];
                u32::from(other.abs_diff(w.best)) <= options.left_right
            });
        let tested_disparities = (k % columns) as i64 - i64::from(options.min_disparity);
        // Uniqueness compares with the other disparities. With few of them a chance match passes that test,
        // so the window must also have texture.
        let by_chance =
            || tested_disparities < MIN_TESTED_DISPARITIES && local_range(left, k) < 0.5 * contrast;
        // Only the first test that fails is counted, so that the counts add up to the number of rejected
        // pixels.
        match () {
            () if !w.clear || by_chance() => rejected.ambiguous += 1,
            () if !agrees => rejected.left_right += 1,
            () if w.at_end => rejected.range += 1,
            () => first[k] = w.between + options.min_disparity as f32,
        }
    }
    // Small regions are removed before the refinement, because the plane of a window would be fitted to them.
    let sizes = winner::region_sizes(&first, columns, SPECKLE_STEP);
    for (value, size) in first.iter_mut().zip(sizes) {
        if value.is_finite() && size < options.speckle {
            *value = f32::NAN;
            rejected.speckle += 1;
        }
    }
    watch(0.85)?;
    let refined = subpixel::refine(left, right, &first, 0.5 * contrast);
    watch(1.0)?;
    // A pixel whose refinement failed had no texture, as for an ambiguous match.
    let known = |count: usize| first.iter().filter(|d| d.is_finite()).count() - count;
    rejected.ambiguous += known(refined.iter().flatten().count());
    let (disparity, sigma) =
        refined.iter().map(|r| r.map_or((f32::NAN, f32::NAN), |r| (r.disparity, sigma_of(&r)))).unzip();
    Ok(DisparityMap { columns, rows: left.rows, disparity, sigma, rejected })
}

/// Brightness, as a share of the bright pixels, below which texture is not used: differences there are mostly
/// noise.
const MIN_BRIGHTNESS: f32 = 0.06;
/// Number of possible matches below which a pixel is close to the border. One of a few matches is always the
/// best, so more texture is required there: half the usual contrast.
const MIN_TESTED_DISPARITIES: i64 = 32;

/// Range of the values of the 5 × 5 pixels around a pixel.
fn local_range(image: &Image, pixel: usize) -> f32 {
    let (column, row) = (pixel % image.columns, pixel / image.columns);
    let around = |at: usize, end: usize| at.saturating_sub(2)..(at + 3).min(end);
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    for r in around(row, image.rows) {
        for c in around(column, image.columns) {
            let value = image.values[r * image.columns + c];
            low = low.min(value);
            high = high.max(value);
        }
    }
    high - low
}

/// The σ of a disparity in pixels, from the statistics of its window.
///
/// `σ² = 0.11² + (2.5 σ_t)² + (1.2 h)² + (0.7 m)² + (0.5 r)²` with the σ_t of least squares, the share h of
/// the window that lies on other surfaces, the distance m by which least squares moved the disparity, and the
/// roughness r of the first disparities, all but h in pixels. Least squares alone does not account for
/// depth edges, where most gross errors are.
///
/// The factors are those of the greatest likelihood of the errors on the image pairs *cones* and *aloe*
/// (Scharstein and Szeliski 2003, 2006) under Student's t of three degrees, rounded, and enlarged until the
/// intervals cover. The two pairs alone give nearly the same ones. σ_t is 2.5 times too small because noise
/// of neighbours is not independent, and interpolation errs.
fn sigma_of(refined: &subpixel::Refined) -> f32 {
    let terms = [
        0.11,
        2.5 * refined.sigma.min(MAX_SIGMA),
        1.2 * (1.0 - refined.support),
        0.7 * refined.moved,
        0.5 * refined.rough,
    ];
    terms.iter().map(|t| t * t).sum::<f32>().sqrt()
}

/// Four times the median difference of brightness between neighbours of a row that differ. Dark pixels are
/// skipped, because a black background would halve the median.
fn contrast(image: &Image) -> f32 {
    let mut values = image.values.clone();
    // A quantile instead of the maximum, which a single reflection would determine.
    let bright = values.len() * 99 / 100;
    let dark = MIN_BRIGHTNESS * *values.select_nth_unstable_by(bright, f32::total_cmp).1;
    let mut changes: Vec<f32> = (0..image.rows)
        .flat_map(|y| image.row(y).windows(2).filter(|w| w[0].min(w[1]) >= dark).map(|w| (w[1] - w[0]).abs()))
        .filter(|change| *change > 0.0)
        .collect();
    let middle = changes.len() / 2;
    match changes.is_empty() {
        true => 1.0,
        false => 4.0 * *changes.select_nth_unstable_by(middle, f32::total_cmp).1,
    }
}

fn check(left: &Image, right: &Image, options: &StereoOptions) -> Result<()> {
    if (left.columns, left.rows) != (right.columns, right.rows) {
        return Err(Error::input(format!(
            "expected two images of one size, found {} × {} and {} × {} pixels",
            left.columns, left.rows, right.columns, right.rows
        )));
    }
    if left.columns < 16 || left.rows < 16 {
        return Err(Error::input(format!(
            "expected images of at least 16 × 16 pixels, found {} × {}",
            left.columns, left.rows
        )));
    }
    if !(4..=4096).contains(&options.disparities) {
        return Err(Error::input(format!(
            "expected a search range of 4 to 4096 disparities, found {}",
            options.disparities
        )));
    }
    if !(1..=1000).contains(&options.small_step) || !(options.small_step..=4000).contains(&options.large_step)
    {
        return Err(Error::input(format!(
            "expected penalties 1 ≤ P1 ≤ 1000 and P1 ≤ P2 ≤ 4000, found {} and {}",
            options.small_step, options.large_step
        )));
    }
    let reach = options.min_disparity.unsigned_abs() as usize;
    if reach >= left.columns {
        return Err(Error::input(format!(
            "expected a minimum disparity below the images' width of {}, found {}",
            left.columns, options.min_disparity
        )));
    }
    if left.values.len().saturating_mul(options.disparities) > MAX_CELLS {
        return Err(Error::unsupported(format!(
            "expected at most {3} GB of memory, found more for {0} × {1} pixels with {2} disparities: \
             search fewer disparities, or reduce the images",
            left.columns,
            left.rows,
            options.disparities,
            MAX_CELLS / 500_000_000
        )));
    }
    if let Some(k) = left.values.iter().chain(&right.values).position(|v| !v.is_finite()) {
        return Err(Error::input(format!(
            "expected finite brightness, found none at pixel {}",
            k % left.values.len()
        )));
    }
    Ok(())
}
