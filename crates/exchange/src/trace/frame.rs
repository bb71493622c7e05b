//! The frame of a sheet with all that it encloses beside the drawing area: zones and the title block.
//!
//! A frame is a connected shape that spans nearly all of the ink and is mostly empty. It divides the sheet
//! into regions; the largest is the drawing area. A title block belongs to the frame, so that its cells are
//! regions of their own, wherever it stands.

use super::ink::Ink;
use super::thinning::Mask;

/// Share of the extent of all ink that a frame spans, in both directions.
const SPAN: f64 = 0.75;
/// Maximum share of the box of a frame that is ink.
const MAX_FILL: f64 = 0.1;
/// Minimum share of the box of the frame that is the drawing area; with less, the frame has gaps.
const MIN_AREA: f64 = 0.3;
/// Minimum size of a view, relative to all ink; at least two are inside of a frame.
const MIN_VIEW: f64 = 0.04;
/// Rim around the frame that is cleared as well: blurred flanks of its lines, in pixels.
const RIM: usize = 3;
/// Shapes of fewer pixels are noise.
const MIN_PIXELS: usize = 200;

/// Clears all ink outside of the drawing area; returns whether there is a frame.
pub(super) fn clear_frame(ink: &mut Ink) -> bool {
    let mask = Mask { columns: ink.columns, rows: ink.rows, pixels: ink.mask.clone() };
    let (labels, parts) = mask.parts();
    let mut boxes = vec![[usize::MAX, 0, usize::MAX, 0]; parts + 1];
    let mut pixels = vec![0_usize; parts + 1];
    for (k, label) in labels.iter().enumerate().filter(|(_, l)| **l > 0) {
        let (x, y) = (k % ink.columns, k / ink.columns);
        let own = &mut boxes[*label as usize];
        *own = [own[0].min(x), own[1].max(x), own[2].min(y), own[3].max(y)];
        pixels[*label as usize] += 1;
    }
    let size = |b: &[usize; 4]| [b[1].saturating_sub(b[0]) + 1, b[3].saturating_sub(b[2]) + 1];
    let whole =
        (1..=parts).filter(|k| pixels[*k] >= MIN_PIXELS).fold([usize::MAX, 0, usize::MAX, 0], |a, k| {
            let b = boxes[k];
            [a[0].min(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].max(b[3])]
        });
    let all = size(&whole);
    let is_frame: Vec<bool> = (0..=parts)
        .map(|k| {
            let [wide, high] = size(&boxes[k]);
            k > 0
                && pixels[k] >= MIN_PIXELS
                && wide as f64 >= SPAN * all[0] as f64
                && high as f64 >= SPAN * all[1] as f64
                && (pixels[k] as f64) < MAX_FILL * (wide * high) as f64
        })
        .collect();
    if !is_frame.contains(&true) {
        return false;
    }
    let is_wall: Vec<bool> = labels.iter().map(|l| is_frame[*l as usize]).collect();
    let Some(area) = largest_region(&is_wall, ink.columns) else { return false };
    let count = area.iter().filter(|is_in| **is_in).count();
    if (count as f64) < MIN_AREA * (all[0] * all[1]) as f64 {
        return false;
    }
    // The outline of a single view is no frame.
    let is_view = |k: &usize| {
        let [wide, high] = size(&boxes[*k]);
        !is_frame[*k] && wide.max(high) as f64 >= MIN_VIEW * all[0].max(all[1]) as f64
    };
    let inside = |k: &usize| {
        let [left, right, top, bottom] = boxes[*k];
        area[(top + bottom) / 2 * ink.columns + (left + right) / 2]
    };
    if (1..=parts).filter(is_view).filter(inside).count() < 2 {
        return false;
    }
    for k in 0..area.len() {
        if !area[k] {
            ink.clear(k);
        }
    }
    // Flanks of the frame's lines in the drawing area.
    for k in (0..is_wall.len()).filter(|k| is_wall[*k]) {
        let (x, y) = (k % ink.columns, k / ink.columns);
        for row in y.saturating_sub(RIM)..=(y + RIM).min(ink.rows - 1) {
            for column in x.saturating_sub(RIM)..=(x + RIM).min(ink.columns - 1) {
                let other = row * ink.columns + column;
                if !ink.mask[other] {
                    ink.clear(other);
                }
            }
        }
    }
    true
}

/// The pixels of the largest region between walls that does not reach the border of the picture.
fn largest_region(is_wall: &[bool], columns: usize) -> Option<Vec<bool>> {
    let rows = is_wall.len() / columns;
    let mut region = vec![0_u32; is_wall.len()];
    let (mut best, mut largest, mut count) = (None, 0, 0_u32);
    let mut open = Vec::new();
    for first in 0..is_wall.len() {
        if is_wall[first] || region[first] != 0 {
            continue;
        }
        count += 1;
        let (mut size, mut at_border) = (0_usize, false);
        region[first] = count;
        open.push(first);
        while let Some(k) = open.pop() {
            size += 1;
            let (x, y) = (k % columns, k / columns);
            at_border |= x == 0 || y == 0 || x + 1 == columns || y + 1 == rows;
            let beside = [
                (x > 0).then(|| k - 1),
                (x + 1 < columns).then_some(k + 1),
                (y > 0).then(|| k - columns),
                (y + 1 < rows).then_some(k + columns),
            ];
            for other in beside.into_iter().flatten() {
                if !is_wall[other] && region[other] == 0 {
                    region[other] = count;
                    open.push(other);
                }
            }
        }
        if size > largest && !at_border {
            (best, largest) = (Some(count), size);
        }
    }
    let best = best?;
    Some(region.iter().map(|r| *r == best).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame with a title block in its corner, two views, and a letter in a cell: the views are left.
    #[test]
    fn only_the_drawing_area_of_a_framed_sheet_is_left() {
        let (columns, rows) = (300, 200);
        let mut contrast = vec![0.0_f32; columns * rows];
        let mut rectangle = |x0: usize, y0: usize, x1: usize, y1: usize| {
            for y in y0..=y1 {
                for x in x0..=x1 {
                    if x < x0 + 2 || y < y0 + 2 || x + 2 > x1 || y + 2 > y1 {
                        contrast[y * columns + x] = 1.0;
                    }
                }
            }
        };
        rectangle(10, 10, 290, 190);
        rectangle(200, 150, 290, 190);
        rectangle(240, 160, 250, 175);
        rectangle(60, 60, 120, 110);
        rectangle(150, 60, 190, 110);
        let mut ink = Ink::from_contrast(columns, rows, contrast);
        assert!(clear_frame(&mut ink));
        assert!(ink.mask[60 * columns + 80] && ink.mask[110 * columns + 80]);
        let left = ink.mask.iter().filter(|m| **m).count();
        assert_eq!(left, 61 * 51 - 57 * 47 + 41 * 51 - 37 * 47);
        // Views without a frame stay.
        assert!(!clear_frame(&mut ink));
    }
}
