//! Places where lines are so close that their ink merges.
//!
//! A disc that is wider than a line, but not than the crossing of two lines, fits into the ink of merged
//! lines. At crossings it fits at single places, so only connected places longer than two widths count.

use super::marks::{PixelBox, contains};
use super::thinning::Mask;
use planish_core::{Finding, FindingCode};

/// Radius of the disc in widths and pixels. At the crossing of two lines at a right angle, the radius is
/// 0.71 widths.
const RADIUS: [f64; 2] = [0.75, 0.5];
/// Minimum extent of merged lines, in widths.
const MIN_EXTENT: f64 = 2.0;

/// Centres of the places within the boxes at which lines merge; rows count downwards.
pub(super) fn merged_places(mask: &Mask, boxes: &[PixelBox], width: f64) -> Vec<[f64; 2]> {
    let radius = RADIUS[0] * width + RADIUS[1];
    let reach = radius.floor() as isize;
    let square = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| [dx, dy]));
    let disc: Vec<[isize; 2]> =
        square.filter(|[dx, dy]| ((dx * dx + dy * dy) as f64).sqrt() <= radius).collect();
    let fits = |k: usize| {
        let (x, y) = (k % mask.columns, k / mask.columns);
        mask.pixels[k]
            && boxes.iter().any(|b| contains(b, [x as f64, y as f64], 0.0))
            && disc.iter().all(|[dx, dy]| mask.is_set(x as isize + dx, y as isize + dy))
    };
    let centres =
        Mask { columns: mask.columns, rows: mask.rows, pixels: (0..mask.pixels.len()).map(fits).collect() };
    let (labels, count) = centres.parts();
    let mut bounds = vec![[[f64::MAX, f64::MIN]; 2]; count];
    for (k, label) in labels.iter().enumerate().filter(|(_, label)| **label > 0) {
        let at = [(k % mask.columns) as f64, (k / mask.columns) as f64];
        for (range, c) in bounds[*label as usize - 1].iter_mut().zip(at) {
            *range = [range[0].min(c), range[1].max(c)];
        }
    }
    bounds.retain(|b| b.iter().any(|r| r[1] - r[0] > MIN_EXTENT * width));
    bounds.iter().map(|b| b.map(|r| 0.5 * (r[0] + r[1]))).collect()
}

/// That details may be lost at such places; none if there are none.
pub(super) fn finding(places: &[[f64; 2]], width: f64) -> Option<Finding> {
    let [x, y] = places.first()?;
    let more = match places.len() {
        1 => String::new(),
        n => format!(" and at {} more places", n - 1),
    };
    let text = format!(
        "lines merge at pixel {x:.0} {y:.0}{more}: details of less than {:.0} pixels, twice the width of \
         lines, may be lost; use a picture with more pixels",
        2.0 * width
    );
    Some(Finding::new(FindingCode::DetailsMerged, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two lines of 3 pixels side by side without a gap merge; a crossing does not.
    #[test]
    fn lines_without_a_gap_merge_and_crossings_do_not() {
        let (columns, rows) = (80, 80);
        let picture = |is_ink: &dyn Fn(usize, usize) -> bool| Mask {
            columns,
            rows,
            pixels: (0..columns * rows).map(|k| is_ink(k % columns, k / columns)).collect(),
        };
        let boxes = [[[0.0, 79.0]; 2]];
        let crossing = picture(&|x, y| (30..33).contains(&x) || (40..43).contains(&y));
        assert!(merged_places(&crossing, &boxes, 3.0).is_empty());
        assert!(finding(&[], 3.0).is_none());
        let merged = picture(&|x, y| (30..36).contains(&x) && (10..70).contains(&y));
        let places = merged_places(&merged, &boxes, 3.0);
        assert!(places.len() == 1 && (places[0][1] - 39.5).abs() < 1.0, "{places:?}");
        assert!(finding(&places, 3.0).is_some_and(|f| f.text.contains("6 pixels")));
    }
}
