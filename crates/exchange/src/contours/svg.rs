//! Draws contours with their readings as an SVG picture.

use super::DrawnContour;
use crate::atomic::write_atomically;
use planish_core::BoundingBox;
use planish_estimate::Result;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// Width of the picture in pixels; the height follows from the drawing.
const WIDTH: f64 = 720.0;
const MARGIN: f64 = 24.0;
/// Additional margin for labels, at the sides and above.
const LABEL_ROOM: [f64; 2] = [96.0, 16.0];
/// Distance of a label from its line, in pixels.
const LABEL_DISTANCE: f64 = 9.0;

/// A size that is written next to its line.
#[derive(Debug, Clone, PartialEq)]
pub struct SizeLabel {
    /// Point on the line.
    pub at: [f64; 2],
    /// Unit vector to the side of the line on which the label is placed.
    pub outwards: [f64; 2],
    /// Text of the label.
    pub text: String,
}

/// Draws contours over the points of their readings, with y upwards. Each point states whether it was used;
/// rejected points are hollow.
///
/// # Errors
/// `Io` when the file cannot be written.
pub fn write_contours_svg(path: &Path, contours: &[DrawnContour], points: &[([f64; 2], bool)]) -> Result<()> {
    let text = contours_svg(contours, points, &[]);
    write_atomically(path, |out| out.write_all(text.as_bytes()))
}

/// Returns the drawing of [`write_contours_svg`] as text, with labels next to the lines.
///
/// # Examples
/// ```
/// use planish_contour::planar::ContourKind;
/// use planish_exchange::contours::{DrawnContour, contours_svg};
/// let hole = DrawnContour { kind: ContourKind::Circle, theta: vec![0.0, 0.0, 5.0], seen: None };
/// let text = contours_svg(&[hole], &[([5.1, 0.0], true)], &[]);
/// assert!(text.starts_with("<svg") && text.contains("<path"));
/// ```
#[must_use]
pub fn contours_svg(contours: &[DrawnContour], points: &[([f64; 2], bool)], labels: &[SizeLabel]) -> String {
    let outlines: Vec<(Vec<[f64; 2]>, Vec<f64>, bool)> = contours
        .iter()
        .filter_map(|c| match (c.kind.outline(&c.theta), c.seen) {
            (Some(o), _) => Some((o.vertices, o.bulges, o.closed)),
            (None, Some(seen)) => Some((seen.to_vec(), vec![0.0], false)),
            (None, None) => None,
        })
        .collect();
    let all = outlines.iter().flat_map(|o| o.0.iter()).chain(points.iter().map(|p| &p.0));
    let bounds: BoundingBox<[f64; 2]> = all.copied().collect();
    let BoundingBox { min: low, max: high } = bounds;
    // A drawing of a single point has no extent; the minimum avoids a division by zero.
    let extent = (high[0] - low[0]).max(high[1] - low[1]).max(f64::MIN_POSITIVE);
    let scale = (WIDTH - 2.0 * MARGIN) / extent;
    let [left_margin, top_margin] =
        LABEL_ROOM.map(|room| MARGIN + if labels.is_empty() { 0.0 } else { room });
    let place = |p: [f64; 2]| [left_margin + scale * (p[0] - low[0]), top_margin + scale * (high[1] - p[1])];
    let (width, height) =
        (2.0 * left_margin + scale * (high[0] - low[0]), 2.0 * top_margin + scale * (high[1] - low[1]));
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 \
         0 {width:.1} {height:.1}\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for (p, used) in points {
        let [x, y] = place(*p);
        let style = if *used { "fill=\"#888\"" } else { "fill=\"none\" stroke=\"#c33\"" };
        let _ = writeln!(text, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"1.6\" {style}/>");
    }
    for (vertices, bulges, closed) in &outlines {
        let _ = write!(text, "<path fill=\"none\" stroke=\"#0060a0\" stroke-width=\"2\" d=\"");
        let count = vertices.len();
        for (i, &vertex) in vertices.iter().enumerate() {
            let [x, y] = place(vertex);
            if i == 0 {
                let _ = write!(text, "M{x:.2} {y:.2}");
            }
            if i + 1 == count && !closed {
                break;
            }
            let to = vertices[(i + 1) % count];
            let [x, y] = place(to);
            match bulges.get(i) {
                Some(&b) if b != 0.0 => {
                    let chord = (to[0] - vertex[0]).hypot(to[1] - vertex[1]);
                    let radius = scale * chord * (1.0 + b * b) / (4.0 * b.abs());
                    // Bulges count counter-clockwise with y upwards, sweep flags clockwise with y downwards.
                    let (large, sweep) = (i32::from(b.abs() > 1.0), i32::from(b < 0.0));
                    let _ = write!(text, " A{radius:.2} {radius:.2} 0 {large} {sweep} {x:.2} {y:.2}");
                }
                _ => {
                    let _ = write!(text, " L{x:.2} {y:.2}");
                }
            }
        }
        text.push_str("\"/>\n");
    }
    for label in labels {
        let [x, y] = place(label.at);
        let [right, up] = label.outwards;
        let anchor = match right {
            r if r > 0.4 => "start",
            r if r < -0.4 => "end",
            _ => "middle",
        };
        // The anchor of a text is its base line: a label above the line ends there, one below starts there.
        let (x, y) = (x + LABEL_DISTANCE * right, y - LABEL_DISTANCE * up + 5.0 - 5.0 * up);
        // Only these two characters have a meaning in the text of an element.
        let words = label.text.replace('&', "&amp;").replace('<', "&lt;");
        let _ = writeln!(
            text,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" font-family=\"sans-serif\" \
             font-size=\"15\" fill=\"#111\" stroke=\"#fff\" stroke-width=\"4\" \
             stroke-linejoin=\"round\" paint-order=\"stroke\">{words}</text>"
        );
    }
    text.push_str("</svg>\n");
    text
}
