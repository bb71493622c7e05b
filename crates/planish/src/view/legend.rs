//! The legend of a picture: colours with their values, the object's size, and the directions of its axes.

use super::camera::Camera;
use super::canvas::{Anchor, Canvas};
use planish_core::DVec3;
use planish_report::colour::{Colour, ColourKind, Range, Scale};

const INK: Colour = [0.11, 0.115, 0.125];
const MUTED: Colour = [0.36, 0.375, 0.41];
/// Maximum number of kinds that a legend names; the others are counted. More do not fit into one line.
const MAX_KINDS: usize = 8;

/// Contents of a legend.
pub(super) struct Legend {
    /// The quantity with its unit.
    pub title: String,
    /// Colour scale; none if colours do not represent values.
    pub scale: Option<Scale>,
    /// The size of the object's box, with its unit.
    pub size: String,
}

/// The em of letters in a picture, in pixels.
pub(super) fn letter_size([columns, rows]: [usize; 2]) -> f64 {
    // Wide pictures get the letters of a picture of 4:3. Below 9 pixels, letters are not readable.
    (columns.min(4 * rows / 3) as f64 / 64.0).max(9.0)
}

/// Height of the legend at the bottom of a picture, in rows.
pub(super) fn height(size: [usize; 2]) -> f64 {
    5.6 * letter_size(size)
}

/// Draws a legend at the bottom of a picture.
pub(super) fn draw(canvas: &mut Canvas, legend: &Legend, camera: &Camera) {
    let em = letter_size([canvas.columns, canvas.rows]);
    let margin = 1.6 * em;
    let (left, bottom) = (margin, canvas.rows as f64 - margin);
    axes(canvas, camera, [canvas.columns as f64 - margin - 1.7 * em, bottom - 1.7 * em], em);
    let right = canvas.columns as f64 - margin - 5.0 * em;
    let mut end = left;
    match &legend.scale {
        Some(Scale::Range(range)) => {
            let width = (19.0 * em).min(right - left).max(1.0);
            bar(canvas, range, [left, bottom], width, em);
            canvas.text([left, bottom - 2.45 * em], &legend.title, em, Anchor::Left, INK);
            end = left + width.max(canvas.width(&legend.title, em));
        }
        Some(Scale::Kinds(list)) => {
            end = kinds(canvas, list, [left, bottom], right - left, em);
            canvas.text([left, bottom - 1.75 * em], &legend.title, em, Anchor::Left, INK);
            end = end.max(left + canvas.width(&legend.title, em));
        }
        None | Some(Scale::Own) if !legend.title.is_empty() => {
            canvas.text([left, bottom], &legend.title, em, Anchor::Left, INK);
            end = left + canvas.width(&legend.title, em);
        }
        None | Some(Scale::Own) => {}
    }
    let size = 0.9 * em;
    if end == left {
        canvas.text([left, bottom], &legend.size, size, Anchor::Left, MUTED);
    // The size is omitted if it does not fit. The scale is more important.
    } else if right - end > canvas.width(&legend.size, size) + 2.0 * em {
        canvas.text([right, bottom], &legend.size, size, Anchor::Right, MUTED);
    }
}

fn bar(canvas: &mut Canvas, range: &Range, [left, bottom]: [f64; 2], width: f64, em: f64) {
    let top = bottom - 2.0 * em;
    let map = range.map;
    canvas.rounded([[left, top], [left + width, top + 0.8 * em]], 0.15 * em, |at| {
        map.at((at[0] - left) / width)
    });
    let size = 0.85 * em;
    for tick in &range.ticks {
        let x = left + tick.place * width;
        canvas.line([x, top + 0.8 * em], [x, top + 1.0 * em], (0.06 * em).max(1.0), MUTED);
        // Labels at the ends stay over the bar.
        let half = 0.5 * canvas.width(&tick.label, size);
        let middle = if 2.0 * half < width { x.clamp(left + half, left + width - half) } else { x };
        canvas.text([middle, bottom], &tick.label, size, Anchor::Middle, MUTED);
    }
}

/// Draws categories side by side; returns where the last one ends.
fn kinds(canvas: &mut Canvas, list: &[ColourKind], [left, bottom]: [f64; 2], room: f64, em: f64) -> f64 {
    let size = 0.9 * em;
    let mut x = left;
    for (k, kind) in list.iter().enumerate() {
        let rest = list.len() - k;
        let width = 1.1 * em + canvas.width(&kind.label, size);
        // Room is kept for the words "and n more".
        let is_full = k == MAX_KINDS || x + width > left + room - if rest > 1 { 5.0 * em } else { 0.0 };
        if is_full && k > 0 {
            let text = format!("and {rest} more");
            canvas.text([x, bottom], &text, size, Anchor::Left, MUTED);
            return x + canvas.width(&text, size);
        }
        let colour = kind.colour;
        canvas.rounded([[x, bottom - 0.7 * em], [x + 0.75 * em, bottom + 0.05 * em]], 0.15 * em, |_| colour);
        canvas.text([x + 1.1 * em, bottom], &kind.label, size, Anchor::Left, INK);
        x += width + 1.3 * em;
    }
    x
}

/// The axes of the world as the camera sees them, nearest last.
fn axes(canvas: &mut Canvas, camera: &Camera, middle: [f64; 2], em: f64) {
    const COLOURS: [Colour; 3] = [[0.80, 0.27, 0.22], [0.17, 0.52, 0.28], [0.16, 0.38, 0.70]];
    let mut all: Vec<(usize, DVec3)> = (0..3)
        .map(|d| {
            let mut axis = DVec3::ZERO;
            axis[d] = 1.0;
            (d, camera.turned(axis))
        })
        .collect();
    all.sort_by(|a, b| a.1[2].total_cmp(&b.1[2]));
    for (d, DVec3 { x: right, y: up, .. }) in all {
        let length = right.hypot(up);
        let end = [middle[0] + 1.5 * em * right, middle[1] - 1.5 * em * up];
        canvas.line(middle, end, 0.14 * em, COLOURS[d]);
        // An axis that points at the camera has no end to be named at.
        if length > 0.2 {
            let [x, y] = [right / length, up / length].map(|c| 0.62 * em * c);
            canvas.text(
                [end[0] + x, end[1] - y + 0.26 * em],
                ["x", "y", "z"][d],
                0.85 * em,
                Anchor::Middle,
                COLOURS[d],
            );
        }
    }
}
