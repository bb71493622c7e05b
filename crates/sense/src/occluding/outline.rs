//! Outlines: ordered subpixel borders of a mask.
//!
//! In: a mask, or an image whose object is brighter than the background. Out: [`Contour`]s with the object on
//! their right.
//!
//! Not guaranteed: contours are open where the object extends beyond the image. Smoothing rounds corners.

use super::matching::inside;
use crate::silhouette::{FRAME, fill, smoothed};
use crate::{Image, SilhouetteOptions};
use planish_estimate::{Error, Result};
use std::collections::BTreeMap;

/// Distance from a contour at which the side of the object is tested, in pixels.
const SIDE_PX: f64 = 3.0;

/// Ordered points along a contour in an image.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contour {
    /// Image positions; pixel centres are at integers. The object is on the right as seen in the image; the
    /// outward direction is `(dy, −dx)`.
    pub places: Vec<[f64; 2]>,
    /// True if the first point follows the last.
    pub closed: bool,
}

impl Contour {
    /// Marks the contour as closed if the distance of its ends is at most three of its steps.
    pub fn close(&mut self) {
        let apart = |p: [f64; 2], q: [f64; 2]| (p[0] - q[0]).hypot(p[1] - q[1]);
        if let ([first, .., last], true) = (&self.places[..], self.places.len() > 8) {
            let mut steps: Vec<f64> = self.places.windows(2).map(|pair| apart(pair[0], pair[1])).collect();
            steps.sort_by(f64::total_cmp);
            self.closed = apart(*first, *last) <= 3.0 * steps[steps.len() / 2];
        }
    }

    /// Reverses the contour if the object, which is inside the closed `outlines`, is on the left. It stays
    /// unchanged if they do not determine the side.
    pub fn face(&mut self, outlines: &[Contour]) {
        let outlines: Vec<Contour> = outlines.iter().filter(|o| o.closed).cloned().collect();
        let sides: i64 = (self.places.windows(2))
            .map(|pair| {
                let [p, q] = [pair[0], pair[1]];
                let length = (q[0] - p[0]).hypot(q[1] - p[1]).max(f64::MIN_POSITIVE);
                let out = [(q[1] - p[1]) / length, (p[0] - q[0]) / length].map(|x| SIDE_PX * x);
                let held = |sign: f64| inside(&outlines, [0, 1].map(|k| p[k] + sign * out[k]));
                i64::from(held(-1.0)) - i64::from(held(1.0))
            })
            .sum();
        if sides < 0 {
            self.places.reverse();
        }
    }
}

/// Extracts the ordered borders of a mask.
///
/// Without a threshold, grey levels are the share of each pixel that the object covers, which locates the
/// border to a few hundredths of a pixel. Values are smoothed by a Gaussian of `smoothing_px`. The border is
/// their level ½, by marching squares with linear interpolation. Smoothing moves a border of radius `r`
/// inwards by about `smoothing_px² / 2r`.
///
/// Cost: one pass over the image.
///
/// # Errors
/// `Input` for a smoothing that is not positive; `Undetermined` if all pixels are equal, or no border is
/// within the image.
///
/// # Examples
/// ```
/// use planish_sense::{Image, SilhouetteOptions, occluding::outlines};
/// let inside = |k: usize| (8..24).contains(&(k % 32)) && (8..24).contains(&(k / 32));
/// let mask = Image::try_new(32, 32, (0..1024).map(|k| f32::from(u8::from(inside(k)))).collect())?;
/// let found = outlines(&mask, &SilhouetteOptions::default())?;
/// assert!(found.len() == 1 && found[0].closed);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn outlines(picture: &Image, options: &SilhouetteOptions) -> Result<Vec<Contour>> {
    if !(options.smoothing_px.is_finite() && options.smoothing_px > 0.0) {
        return Err(Error::input(format!(
            "expected a smoothing of an outline above 0 pixels, found {}",
            options.smoothing_px
        )));
    }
    let (columns, rows) = (picture.columns, picture.rows);
    let (low, high) = (picture.values.iter())
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)));
    let (low, high) = (f64::from(low), f64::from(high));
    let threshold = options.threshold.unwrap_or(0.5 * (low + high));
    let mut mask: Vec<bool> = picture.values.iter().map(|v| f64::from(*v) > threshold).collect();
    let object_pixels = mask.iter().filter(|m| **m).count();
    if object_pixels == 0 || object_pixels == mask.len() {
        return Err(Error::undetermined(format!(
            "expected pixels of a mask on both sides of the threshold {threshold}, found values from {low} \
             to {high}"
        )));
    }
    // Grey levels at the border of a mask are the covered shares of pixels, so they are kept, except where a
    // speck or hole was filled.
    let before = mask.clone();
    let min_pixels = (options.min_share * object_pixels as f64) as usize;
    fill(&mut mask, columns, true, min_pixels);
    fill(&mut mask, columns, false, min_pixels);
    let values: Vec<f64> = (picture.values.iter().zip(&mask).zip(&before))
        .map(|((v, now), was)| match options.threshold.is_none() && now == was {
            true => (f64::from(*v) - low) / (high - low),
            false => f64::from(u8::from(*now)),
        })
        .collect();
    let smooth = smoothed(&values, columns, rows, options.smoothing_px);
    let found = followed(&smooth, columns, rows);
    if found.is_empty() {
        return Err(Error::undetermined("expected the outline of a mask within the image, found none"));
    }
    Ok(found)
}

/// The lines where values pass one half, cell by cell, then joined.
fn followed(values: &[f64], columns: usize, rows: usize) -> Vec<Contour> {
    // Crossings by the pixel they start at and the way they go: 0 to the right, 1 down.
    let place = |edge: usize| -> [f64; 2] {
        let (pixel, way) = (edge / 2, edge % 2);
        let other = if way == 0 { pixel + 1 } else { pixel + columns };
        let (start_value, end_value) = (values[pixel] - 0.5, values[other] - 0.5);
        let share = start_value / (start_value - end_value);
        let at = [(pixel % columns) as f64, (pixel / columns) as f64];
        if way == 0 { [at[0] + share, at[1]] } else { [at[0], at[1] + share] }
    };
    let mut next: BTreeMap<usize, usize> = BTreeMap::new();
    // Smoothing repeats pixels beyond the border of the image, so crossings there are not borders of the
    // object.
    let clear = FRAME as usize;
    for row in clear..rows.saturating_sub(clear + 1) {
        for column in clear..columns.saturating_sub(clear + 1) {
            let first = row * columns + column;
            // Clockwise from the upper left, and the edge that follows each corner.
            let corners = [first, first + 1, first + columns + 1, first + columns];
            let edges = [2 * first, 2 * (first + 1) + 1, 2 * (first + columns), 2 * first + 1];
            let inside = corners.map(|k| values[k] > 0.5);
            let leaves: Vec<usize> = (0..4).filter(|&k| inside[k] && !inside[(k + 1) % 4]).collect();
            if leaves.is_empty() {
                continue;
            }
            let middle: f64 = corners.iter().map(|k| values[*k]).sum::<f64>() / 4.0;
            for &leave in &leaves {
                // In an ambiguous square the mean decides: if it belongs to the object, the lines separate
                // the two outside corners, otherwise the two inside corners.
                let steps: [usize; 3] = match leaves.len() == 2 && middle <= 0.5 {
                    true => [3, 2, 1],
                    false => [1, 2, 3],
                };
                let enter =
                    steps.into_iter().map(|by| (leave + by) % 4).find(|&k| !inside[k] && inside[(k + 1) % 4]);
                if let Some(enter) = enter {
                    next.insert(edges[leave], edges[enter]);
                }
            }
        }
    }
    // Open lines have a start that no square leads to. They are followed first, from there; started in the
    // middle, they would be split.
    let reached: std::collections::BTreeSet<usize> = next.values().copied().collect();
    let mut starts: Vec<usize> = next.keys().copied().filter(|edge| !reached.contains(edge)).collect();
    starts.extend(next.keys().copied());
    let mut found = Vec::new();
    for start in starts {
        let mut places = Vec::new();
        let mut current = start;
        let closed = loop {
            let Some(to) = next.remove(&current) else { break false };
            places.push(place(current));
            current = to;
            if current == start {
                break true;
            }
        };
        if places.len() > 2 {
            if !closed {
                places.push(place(current));
            }
            found.push(Contour { places, closed });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc whose grey levels are the covered shares of pixels: one closed, ordered border, accurate to
    /// some hundredths of a pixel, with the disc on its right.
    #[test]
    fn a_disc_has_one_closed_outline() {
        let center = [60.3, 48.8];
        let covered = |k: usize| {
            let within = (0..64).filter(|j| {
                let x = (k % 120) as f64 + ((j % 8) as f64 - 3.5) / 8.0 - center[0];
                let y = (k / 120) as f64 + ((j / 8) as f64 - 3.5) / 8.0 - center[1];
                x.hypot(y) < 30.4
            });
            255.0 * within.count() as f32 / 64.0
        };
        let picture = Image::try_new(120, 100, (0..12_000).map(covered).collect()).unwrap();
        let found = outlines(&picture, &SilhouetteOptions::default()).unwrap();
        assert_eq!(found.len(), 1);
        assert!(found[0].closed && found[0].places.len() > 200);
        let places = &found[0].places;
        let mut turned = 0.0;
        for k in 0..places.len() {
            let [p, q] =
                [places[k], places[(k + 1) % places.len()]].map(|p| [p[0] - center[0], p[1] - center[1]]);
            assert!((p[0].hypot(p[1]) - 30.4).abs() < 0.06, "{}", p[0].hypot(p[1]));
            assert!((q[0] - p[0]).hypot(q[1] - p[1]) < 1.5);
            turned += (p[0] * q[1] - p[1] * q[0]).atan2(p[0] * q[0] + p[1] * q[1]);
        }
        // Clockwise as one sees it, with y downwards.
        assert!((turned - std::f64::consts::TAU).abs() < 1e-9, "{turned}");
    }

    #[test]
    fn contours_are_closed_and_oriented() {
        let ring = |count: usize| Contour {
            places: (0..count)
                .map(|k| 0.1 * k as f64)
                .map(|a| [50.0 + 20.0 * a.cos(), 50.0 + 20.0 * a.sin()])
                .collect(),
            closed: false,
        };
        let (mut full, mut half) = (ring(62), ring(31));
        full.close();
        half.close();
        assert!(full.closed && !half.closed);
        let mut turned = half.clone();
        turned.places.reverse();
        turned.face(&[full.clone()]);
        half.face(&[full]);
        assert_eq!(turned, half);
        // Clockwise as one sees it: the middle is on the right.
        assert_eq!(half.places[0], [70.0, 50.0]);
    }

    #[test]
    fn outlines_are_open_at_the_border_of_the_image() {
        let inside = |k: usize| ((k % 120) as f64).hypot((k / 120) as f64 - 50.0) < 30.0;
        let values = (0..12_000).map(|k| if inside(k) { 255.0 } else { 0.0 }).collect();
        let picture = Image::try_new(120, 100, values).unwrap();
        let found = outlines(&picture, &SilhouetteOptions::default()).unwrap();
        assert!(found.len() == 1 && !found[0].closed);
        let flat = Image::try_new(10, 10, vec![3.0; 100]).unwrap();
        let message = outlines(&flat, &SilhouetteOptions::default()).unwrap_err().to_string();
        assert!(message.contains("both sides"), "{message}");
    }
}
