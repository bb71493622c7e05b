//! Reads the curves of drawings from PDF files.
//!
//! **Input.** One page with lines, Bézier curves, rectangles and forms; streams packed by Flate, ASCII85,
//! hexadecimal or run length. Hidden lines have a dash pattern, or are drawn as single dashes.
//!
//! **Output.** The same as for a DXF file, in millimetres on the paper (units of a page are 1/72 inch); y
//! points up as a viewer shows the page. Bézier curves and short lines along a circle become arcs. Texts,
//! boxes of hatches and filled triangles (arrowheads) are [`Annotations`];
//! lengths between two arrowheads with a number beside them are dimensions.
//!
//! **Limits.** Encrypted files, several pages, and pages with nothing but a picture are errors. Clips are
//! rectangles, and curves that cross their sides are not cut. White lines count if a dark fill covers the
//! page. Layers that are switched off are left out.
//!
//! # References
//! ISO 32000-1:2008, *Document management — Portable document format — Part 1: PDF 1.7*.

mod content;
mod file;
mod filter;
mod state;
mod syntax;
#[cfg(test)]
mod tests;
mod text;

use crate::Unit;
use crate::dxf::DxfDrawing;
use crate::source::read_file;
use crate::strokes::{
    Accuracy, Stroke, add_dimensions_between, join_dashes, share_centres, smoothed, take_hatching,
};
use content::{Drawn, Painter};
use file::PdfFile;
use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_solid::sheet::Annotations;
use std::path::Path;
use text::texts_of;

/// Steps of coordinates of cairo in points, which it writes with three digits behind the point.
const CAIRO_STEP: f64 = 1.0 / 256.0;
/// Error of coordinates in points, which many programs keep in single precision: 2⁻²⁵ of 1024 pt.
const SINGLE_PRECISION: f64 = 3.1e-5;
/// Maximum gap between dashes on paper, in millimetres. ISO 128-2 has 18 line widths for dashed spaced lines.
const LONGEST_GAP: f64 = 13.0;

/// Reads a PDF file.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) if it cannot be read;
/// [`Input`](planish_estimate::ErrorKind::Input) if it is damaged, or has no or several pages;
/// [`Unsupported`](planish_estimate::ErrorKind::Unsupported) if it is encrypted, has other filters, or shows
/// a picture only.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("line.pdf");
/// let page = "%PDF-1.4 1 0 obj<</Pages 2 0 R>>endobj 2 0 obj<</Kids[3 0 R]>>endobj
///     3 0 obj<</MediaBox[0 0 72 72]/Contents 4 0 R>>endobj
///     4 0 obj<</Length 20>>stream\n0 0 m 36 0 l S      \nendstream endobj trailer<</Root 1 0 R>>";
/// std::fs::write(&path, page)?;
/// let drawing = planish_exchange::pdf::read_pdf(&path)?;
/// // Half an inch.
/// assert!((drawing.curves[0].curve.length() - 12.7).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_pdf(path: &Path) -> Result<DxfDrawing> {
    read_file(path, |source, _| read(&source.rest()?))
}

fn read(bytes: &[u8]) -> Result<DxfDrawing> {
    let file = PdfFile::new(bytes)?;
    let drawn = Painter::draw(&file, &file.page()?)?;
    if drawn.curves.is_empty() {
        return Err(match drawn.pictures {
            0 => Error::input("expected a page with lines, found none"),
            _ => Error::unsupported(
                "expected a page with lines, found a picture only: trace it, or export the drawing from the \
                 program that made it",
            ),
        });
    }
    Ok(drawing_of(drawn))
}

/// The drawing that the strokes, fills and texts of a page show.
fn drawing_of(drawn: Drawn) -> DxfDrawing {
    let rounding = rounding(&drawn);
    // Arcs of a curve meet within the accuracy of the Bézier curves, whatever the digits.
    let accuracy = Accuracy {
        rounding,
        position: (2.0 * rounding).max(CAIRO_STEP * drawn.unit),
        longest_gap: LONGEST_GAP,
    };
    let mut drawing = DxfDrawing { unit: Some(Unit::Millimetre), ..DxfDrawing::default() };
    let ignore = |drawing: &mut DxfDrawing, kind: &str, count: usize, first: &str| {
        if count > 0 {
            let text = format!("ignored {count} × {kind}, which draws no edges{first}");
            drawing.findings.push(Finding::new(FindingCode::EntitiesSkipped, text));
            drawing.ignored.insert(kind.to_owned(), count);
        }
    };
    for (kind, (count, first)) in &drawn.ignored {
        ignore(&mut drawing, kind, *count, &format!("; the first is {first}"));
    }
    ignore(&mut drawing, "picture", drawn.pictures, "");
    let strokes = drawn.curves.into_iter().map(|(drawn, pen)| Stroke { drawn, pen }).collect();
    let (strokes, hatching, hatches) = take_hatching(smoothed(strokes, &accuracy), &accuracy);
    ignore(&mut drawing, "hatching line", hatching, "");
    let (mut strokes, centre_lines) = join_dashes(strokes, &accuracy);
    share_centres(&mut strokes, &accuracy);
    ignore(&mut drawing, "centre line of single dashes", centre_lines, "");
    let texts = texts_of(drawn.runs);
    ignore(&mut drawing, "text", texts.len(), "");
    let pens = strokes.iter().map(|s| s.pen).collect();
    drawing.curves = strokes.into_iter().map(|s| s.drawn).collect();
    // Only the box of a hatch is known, so that it states a section, and rarely its shape.
    let corners = |[low, high]: [[f64; 2]; 2]| vec![low, [high[0], low[1]], high, [low[0], high[1]]];
    drawing.annotations = Annotations {
        pens,
        texts,
        hatches: hatches.into_iter().map(corners).collect(),
        arrowheads: drawn.triangles,
        ..Annotations::default()
    };
    add_dimensions_between(&mut drawing.annotations);
    drawing.rounding = Some(rounding);
    drawing
}

/// Maximum error of a coordinate in millimetres, by the usual number of digits.
fn rounding(drawn: &Drawn) -> f64 {
    let usual = (1..8).max_by_key(|digits| drawn.decimals[*digits]).unwrap_or(7);
    let step = 10_f64.powi(-(usual as i32));
    let step = if usual <= 3 { step.max(CAIRO_STEP) } else { step };
    (0.5 * step).max(SINGLE_PRECISION) * drawn.unit
}
