//! Silhouettes: subpixel points on the border of a mask.
//!
//! In: a mask, or an image whose object is brighter than the background. Out: points on the border with their
//! σ, and pixels inside and outside.
//!
//! The mask is smoothed by a Gaussian. The border is its level ½, interpolated linearly between neighbouring
//! pixels. Small specks and holes are treated as errors of the mask and filled.
//!
//! Not guaranteed: an object that extends beyond the image has no border there. Smoothing rounds corners by
//! less than its width.

use crate::Image;
use planish_estimate::{Error, Result};

/// Options of [`silhouette`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SilhouetteOptions {
    /// Brightness above which a pixel shows the object (default: halfway between the darkest and the
    /// brightest pixel).
    pub threshold: Option<f64>,
    /// σ of the Gaussian by which the mask is smoothed, in pixels.
    pub smoothing_px: f64,
    /// Minimum distance of points on the border, in pixels. Closer points have correlated errors.
    pub apart_px: f64,
    /// σ of a point across the border, in pixels.
    pub sigma_px: f64,
    /// Specks and holes smaller than this share of the object's pixels are filled.
    pub min_share: f64,
    /// Approximate number of pixels returned inside, and outside.
    pub samples: usize,
}

impl Default for SilhouetteOptions {
    fn default() -> Self {
        Self {
            threshold: None,
            smoothing_px: 1.0,
            apart_px: 3.0,
            sigma_px: 0.5,
            min_share: 0.01,
            samples: 500,
        }
    }
}

/// The silhouette of an object in an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Silhouette {
    /// Points on the border; pixel centres are at integers.
    pub border: Vec<[f64; 2]>,
    /// Their σ across the border, in pixels.
    pub sigma_px: f64,
    /// Pixels of the object, on a grid, at least two pixels from its border.
    pub inside: Vec<[f64; 2]>,
    /// Pixels of the background, likewise.
    pub outside: Vec<[f64; 2]>,
    /// For each pixel, row by row, true if it shows the object.
    pub mask: Vec<bool>,
    /// Pixels in a row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
}

/// Minimum distance of the inside and outside pixels from the border, in pixels; larger than the error of the
/// border.
const MIN_BORDER_DISTANCE: usize = 2;
/// Points closer than this to the end of the image are not on the border of the object, in pixels.
pub(crate) const FRAME: f64 = 2.0;

/// Extracts the silhouette of a mask.
///
/// # Errors
/// `Input` for invalid options; `Undetermined` if all pixels are on one side of the threshold, or no border
/// is within the image.
///
/// # Examples
/// ```
/// use planish_sense::{Image, SilhouetteOptions, silhouette};
/// let inside = |k: usize| (8..24).contains(&(k % 32)) && (8..24).contains(&(k / 32));
/// let mask = Image::try_new(32, 32, (0..1024).map(|k| f32::from(u8::from(inside(k)))).collect())?;
/// let found = silhouette(&mask, &SilhouetteOptions::default())?;
/// assert!(!found.border.is_empty() && found.mask[16 * 32 + 16]);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn silhouette(picture: &Image, options: &SilhouetteOptions) -> Result<Silhouette> {
    let positive = [
        ("smoothing", options.smoothing_px),
        ("distance of places", options.apart_px),
        ("σ", options.sigma_px),
    ];
    for (name, value) in positive {
        if !(value.is_finite() && value > 0.0) {
            return Err(Error::input(format!(
                "expected a {name} of a silhouette above 0 pixels, found {value}"
            )));
        }
    }
    if !(0.0..=1.0).contains(&options.min_share) {
        return Err(Error::input(format!(
            "expected a minimum share of a part of a silhouette from 0 to 1, found {}",
            options.min_share
        )));
    }
    let (columns, rows) = (picture.columns, picture.rows);
    let (low, high) = (picture.values.iter())
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)));
    // Halfway between the extremes: correct for masks, which have two grey levels and blurred borders.
    let threshold = options.threshold.unwrap_or(0.5 * (f64::from(low) + f64::from(high)));
    let mut mask: Vec<bool> = picture.values.iter().map(|v| f64::from(*v) > threshold).collect();
    let object_pixels = mask.iter().filter(|m| **m).count();
    if object_pixels == 0 || object_pixels == mask.len() {
        return Err(Error::undetermined(format!(
            "expected pixels of a mask on both sides of the threshold {threshold}, found values from {low} \
             to {high}"
        )));
    }
    let minimum = (options.min_share * object_pixels as f64) as usize;
    fill(&mut mask, columns, true, minimum);
    fill(&mut mask, columns, false, minimum);
    let values: Vec<f64> = mask.iter().map(|m| f64::from(u8::from(*m))).collect();
    // The mask itself has steps of whole pixels; after smoothing its level ½ can be interpolated between
    // them.
    let smooth = smoothed(&values, columns, rows, options.smoothing_px);
    let border = thinned(crossings(&smooth, columns, rows), options.apart_px);
    if border.is_empty() {
        return Err(Error::undetermined("expected the outline of a mask within the image, found none"));
    }
    let (inside, outside) = samples(&mask, columns, rows, options.samples);
    Ok(Silhouette { border, sigma_px: options.sigma_px, inside, outside, mask, columns, rows })
}

/// Inverts connected parts of one colour that have fewer than `minimum` pixels.
pub(crate) fn fill(mask: &mut [bool], columns: usize, colour: bool, minimum: usize) {
    let mut seen = vec![false; mask.len()];
    // An explicit queue: recursion over a large region would overflow the stack.
    let mut part = Vec::new();
    for start in 0..mask.len() {
        if seen[start] || mask[start] != colour {
            continue;
        }
        part.clear();
        part.push(start);
        seen[start] = true;
        let mut next = 0;
        while let Some(&pixel) = part.get(next) {
            next += 1;
            let column = pixel % columns;
            let sides = [
                (column > 0).then(|| pixel - 1),
                (column + 1 < columns).then(|| pixel + 1),
                pixel.checked_sub(columns),
                (pixel + columns < mask.len()).then_some(pixel + columns),
            ];
            for side in sides.into_iter().flatten() {
                if !seen[side] && mask[side] == colour {
                    seen[side] = true;
                    part.push(side);
                }
            }
        }
        if part.len() < minimum {
            part.iter().for_each(|&pixel| mask[pixel] = !colour);
        }
    }
}

/// A Gaussian along rows, then along columns. Pixels of the border are repeated beyond it.
pub(crate) fn smoothed(values: &[f64], columns: usize, rows: usize, sigma: f64) -> Vec<f64> {
    let reach = (4.0 * sigma).ceil() as isize;
    let weights: Vec<f64> = (-reach..=reach).map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let along = |from: &[f64], at: &dyn Fn(isize, isize) -> usize| -> Vec<f64> {
        (0..rows as isize)
            .flat_map(|row| (0..columns as isize).map(move |column| (row, column)))
            .map(|(row, column)| {
                let sum: f64 = (weights.iter().zip(-reach..))
                    .map(|(w, k)| w * from[at(row * columns as isize + column, k)])
                    .sum();
                sum / total
            })
            .collect()
    };
    let width = columns as isize;
    let first = along(values, &|at, k| {
        let (row, column) = (at / width, at % width);
        (row * width + (column + k).clamp(0, width - 1)) as usize
    });
    along(&first, &|at, k| {
        let (row, column) = (at / width, at % width);
        ((row + k).clamp(0, rows as isize - 1) * width + column) as usize
    })
}

/// Positions where values cross one half between neighbours of a row or a column.
fn crossings(values: &[f64], columns: usize, rows: usize) -> Vec<[f64; 2]> {
    let mut found = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let value = values[row * columns + column] - 0.5;
            let right =
                (column + 1 < columns).then(|| (values[row * columns + column + 1] - 0.5, [1.0, 0.0]));
            let below = (row + 1 < rows).then(|| (values[(row + 1) * columns + column] - 0.5, [0.0, 1.0]));
            for (other, way) in [right, below].into_iter().flatten() {
                if (value > 0.0) != (other > 0.0) {
                    let share = value / (value - other);
                    let at = [column as f64 + share * way[0], row as f64 + share * way[1]];
                    let within = |x: f64, count: usize| x >= FRAME && x <= count as f64 - 1.0 - FRAME;
                    if within(at[0], columns) && within(at[1], rows) {
                        found.push(at);
                    }
                }
            }
        }
    }
    found
}

/// Drops points closer than `apart` to an earlier one.
fn thinned(places: Vec<[f64; 2]>, apart: f64) -> Vec<[f64; 2]> {
    let mut kept: std::collections::BTreeMap<[i64; 2], Vec<[f64; 2]>> = std::collections::BTreeMap::new();
    let mut all = Vec::new();
    for at in places {
        let [x, y] = at.map(|x| (x / apart).floor() as i64);
        let near = (-1..=1).flat_map(|i| (-1..=1).map(move |j| [x + i, y + j])).any(|cell| {
            (kept.get(&cell).into_iter().flatten())
                .any(|other| (other[0] - at[0]).hypot(other[1] - at[1]) < apart)
        });
        if !near {
            kept.entry([x, y]).or_default().push(at);
            all.push(at);
        }
    }
    all
}

/// Pixels on a grid over the object and its surroundings, on either side of the border.
#[allow(clippy::type_complexity, reason = "inside and outside")]
fn samples(mask: &[bool], columns: usize, rows: usize, count: usize) -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
    let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
    for (k, _) in mask.iter().enumerate().filter(|(_, m)| **m) {
        for (axis, at) in [k % columns, k / columns].into_iter().enumerate() {
            low[axis] = low[axis].min(at);
            high[axis] = high[axis].max(at);
        }
    }
    let margin = [0, 1].map(|k| (high[k].saturating_sub(low[k])) / 3 + MIN_BORDER_DISTANCE);
    let first = [0, 1].map(|k| low[k].saturating_sub(margin[k]));
    let last = [(high[0] + margin[0]).min(columns - 1), (high[1] + margin[1]).min(rows - 1)];
    let area = ((last[0] - first[0] + 1) * (last[1] - first[1] + 1)) as f64;
    let step = ((area / count.max(1) as f64).sqrt().floor() as usize).max(1);
    let (mut inside, mut outside) = (Vec::new(), Vec::new());
    for row in (first[1]..=last[1]).step_by(step) {
        for column in (first[0]..=last[0]).step_by(step) {
            let own = mask[row * columns + column];
            // Pixels next to the border may be wrong; those with a margin are certain.
            let clear = (row.saturating_sub(MIN_BORDER_DISTANCE)..=(row + MIN_BORDER_DISTANCE).min(rows - 1))
                .all(|r| {
                    (column.saturating_sub(MIN_BORDER_DISTANCE)
                        ..=(column + MIN_BORDER_DISTANCE).min(columns - 1))
                        .all(|c| mask[r * columns + c] == own)
                });
            if clear {
                let to = if own { &mut inside } else { &mut outside };
                to.push([column as f64, row as f64]);
            }
        }
    }
    (inside, outside)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc(center: [f64; 2], radius: f64) -> Image {
        let inside = |k: usize| ((k % 120) as f64 - center[0]).hypot((k / 120) as f64 - center[1]) < radius;
        Image::try_new(120, 100, (0..12_000).map(|k| if inside(k) { 255.0 } else { 0.0 }).collect()).unwrap()
    }

    /// The border of a disc is accurate to a third of a pixel all around. A speck is removed and a hole is
    /// filled.
    #[test]
    fn the_border_of_a_disc_has_subpixel_accuracy() {
        let mut picture = disc([60.3, 48.8], 30.4);
        picture.values[48 * 120 + 60] = 0.0;
        picture.values[5 * 120 + 5] = 255.0;
        let found = silhouette(&picture, &SilhouetteOptions::default()).unwrap();
        let off: Vec<f64> = (found.border.iter()).map(|p| (p[0] - 60.3).hypot(p[1] - 48.8) - 30.4).collect();
        let rms = (off.iter().map(|x| x * x).sum::<f64>() / off.len() as f64).sqrt();
        assert!(off.len() > 40 && rms < 0.2, "{} {rms}", off.len());
        assert!(off.iter().all(|x| x.abs() < 0.6));
        for p in &found.inside {
            assert!((p[0] - 60.3).hypot(p[1] - 48.8) < 30.4);
        }
        for p in &found.outside {
            assert!((p[0] - 60.3).hypot(p[1] - 48.8) > 30.4);
        }
        assert!(found.inside.len() > 100 && found.outside.len() > 100);
    }

    #[test]
    fn borders_end_at_the_image_and_invalid_masks_are_rejected() {
        let found = silhouette(&disc([0.0, 50.0], 30.0), &SilhouetteOptions::default()).unwrap();
        assert!(found.border.iter().all(|p| p[0] >= FRAME && (p[0].hypot(p[1] - 50.0) - 30.0).abs() < 1.0));
        let flat = Image::try_new(10, 10, vec![3.0; 100]).unwrap();
        let message = silhouette(&flat, &SilhouetteOptions::default()).unwrap_err().to_string();
        assert!(message.contains("both sides"));
        let invalid = SilhouetteOptions { apart_px: 0.0, ..SilhouetteOptions::default() };
        assert!(
            silhouette(&disc([60.0, 50.0], 30.0), &invalid)
                .unwrap_err()
                .to_string()
                .contains("distance of places")
        );
    }
}
