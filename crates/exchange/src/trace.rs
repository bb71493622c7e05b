//! Traces the lines of drawings in pictures (PNG, JPEG, TIFF).
//!
//! **Input.** A picture of two or three views with dark lines on light paper. Hidden lines are dashed.
//!
//! **Output.** Lines, arcs and circles of the views, in pixels; y points up. Texts are left out; numbers of
//! dimensions state the length of a pixel.
//!
//! 1. Ink is separated from paper; scans and photographs are straightened, and frames, texts and thin lines
//!    of dimensions are removed. Strokes are thinned to a graph of paths.
//! 2. Points of paths move to the middle of the ink. Paths are divided into lines and arcs by a BIC.
//! 3. Pieces of one line or circle are joined at junctions, and over the gaps between dashes.
//! 4. Coordinates that agree within their σ are the same, in a view and between views.
//!
//! **Limits.** Details of less than about two line widths are lost.

mod alignment;
mod ends;
mod fillets;
mod frame;
mod ink;
mod joining;
mod layout;
mod long_lines;
mod marks;
mod merged;
mod moments;
mod paper_edge;
mod pieces;
mod scale;
mod sheet_picture;
mod skeleton;
mod straighten;
#[cfg(test)]
mod tests;
mod thinning;
mod titles;
mod widths;

use crate::dxf::DxfDrawing;
use crate::picture::read_brightness;
use alignment::AlignedCurve;
use moments::Shape;
use pieces::{LineScale, Piece, PieceGraph};
use planish_core::{Finding, FindingCode};
use planish_estimate::Result;
use planish_sense::Image;
use planish_solid::views::{DrawnCurve, LineStyle};
use sheet_picture::SheetPicture;
use skeleton::PixelGraph;
use std::path::Path;
use thinning::Mask;

/// σ of a point in the middle of a line: of black and white pixels, and of grey ones.
const SIGMAS: [f64; 2] = [0.35, 0.15];
/// Share of grey pixels at the border of lines from which on their values show the place of a line.
const GREY_SHARE: f64 = 0.3;

/// What a user must know about lengths.
const UNSCALED: &str = "lengths are in pixels of the picture, because no two dimensions that agree could be \
     read: specify the scale";

/// Reads a picture of a drawing.
pub(crate) fn read_traced(path: &Path) -> Result<DxfDrawing> {
    trace(&read_brightness(path)?).map_err(|e| e.in_context(path.display()))
}

/// The pieces of a picture before their coordinates are aligned.
struct TracedPieces {
    pieces: PieceGraph,
    /// Boxes of the views, y upwards.
    boxes: Vec<marks::PixelBox>,
    scale: LineScale,
    /// Maximum length of a dash.
    dash: f64,
    findings: Vec<Finding>,
}

fn traced_pieces(sheet: &SheetPicture) -> TracedPieces {
    let ink = &sheet.ink;
    let mask = Mask { columns: ink.columns, rows: ink.rows, pixels: ink.mask.clone() };
    let (labels, parts) = mask.parts();
    let part_of = |p: [i32; 2]| labels[p[1] as usize * ink.columns + p[0] as usize];
    let covered = mask.pixels.iter().filter(|p| **p).count();
    let skeleton = mask.clone().thinned();
    let length = skeleton.pixels.iter().filter(|p| **p).count().max(1);
    let sigma = SIGMAS[usize::from(ink.grey_share > GREY_SHARE)];
    let scale = LineScale { width: covered as f64 / length as f64, sigma };
    let graph = PixelGraph::new(&skeleton, scale.width);
    let size = ink.columns.max(ink.rows) as f64;
    let mut pieces = PieceGraph::new(&graph, ink, scale);
    let wide = match sheet.is_sheet {
        true => pieces.measure_widths(ink, scale),
        false => None,
    };
    pieces.flip(ink.rows);
    let dropped = wide.map_or(0, |wide| pieces.drop_annotation(wide, scale));
    let mut findings = sheet.left_out(dropped);
    let boxes: Vec<marks::PixelBox> = match wide {
        Some(_) => pieces.outline_boxes(size),
        None => {
            let boxes = marks::view_boxes(&graph, part_of, parts, size);
            findings.extend(merged::finding(&merged::merged_places(&mask, &boxes, scale.width), scale.width));
            boxes.iter().map(|[x, y]| [*x, flipped(*y, ink.rows)]).collect()
        }
    };
    for piece in &mut pieces.pieces {
        // Hidden lines end at visible ones.
        let margin = if piece.is_thin == Some(true) { 1.0 } else { 2.0 };
        let is_in = |b: &marks::PixelBox| piece.ends.iter().all(|p| marks::contains(b, *p, margin));
        piece.is_dropped |= !boxes.iter().any(is_in);
    }
    pieces.join_at_nodes(scale);
    pieces.fit_fillets();
    let dash = pieces.usual_dash(scale);
    pieces.join_dashes(scale);
    pieces.straighten_flat_arcs();
    let scale = pieces.with_rounding(scale);
    let dash = 1.2 * dash + scale.width;
    pieces.close_ends(dash, scale);
    pieces.place_nodes();
    pieces.keep_nodes_in(&boxes);
    for piece in &mut pieces.pieces {
        piece.is_hidden = piece.is_thin.unwrap_or(piece.is_hidden);
    }
    TracedPieces { pieces, boxes, scale, dash, findings }
}

fn trace(image: &Image) -> Result<DxfDrawing> {
    let sheet = SheetPicture::read(image)?;
    let [columns, rows] = [sheet.ink.columns, sheet.ink.rows];
    let TracedPieces { pieces, boxes, scale, dash, findings } = traced_pieces(&sheet);
    let mut drawing = DxfDrawing { findings, ..DxfDrawing::default() };
    let titles = titles::kinds_by_title(&sheet.texts, &boxes, [columns, rows]);
    let curves = alignment::aligned(&pieces, &boxes, &titles, scale)?;
    match scale::pixel_length(&sheet.dimensions(), &sizes(&curves, &pieces, &boxes)) {
        Some((length, _)) => drawing.pixel_length = Some(length),
        None => drawing.findings.push(Finding::new(FindingCode::ScaleUnknown, UNSCALED)),
    }
    for aligned in curves {
        let piece = &pieces.pieces[aligned.piece];
        if !piece.is_hidden && matches!(piece.shape, Shape::Line(..)) && aligned.curve.length() <= dash {
            drawing.open_styles.push(drawing.curves.len());
        }
        let [x, y] = piece.points.get(piece.points.len() / 2).copied().unwrap_or(piece.ends[0]);
        let [x, y] = sheet.in_picture([x, rows as f64 - 1.0 - y]);
        drawing.curves.push(DrawnCurve {
            curve: aligned.curve,
            style: if piece.is_hidden { LineStyle::Hidden } else { LineStyle::Visible },
            entity: format!("{} at pixel {x:.0} {y:.0}", kind_of(piece)),
        });
    }
    drawing.placement = sheet.placement();
    Ok(drawing)
}

/// Widths and heights of the views.
fn sizes(curves: &[AlignedCurve], pieces: &PieceGraph, boxes: &[marks::PixelBox]) -> Vec<f64> {
    let mut sizes = Vec::new();
    for view in boxes {
        let is_in = |c: &&AlignedCurve| marks::contains(view, pieces.pieces[c.piece].ends[0], 2.0);
        let bounds: Vec<[[f64; 2]; 2]> = curves.iter().filter(is_in).map(|c| c.curve.bounds()).collect();
        for axis in 0..2 {
            let from = bounds.iter().map(|b| b[axis][0]).fold(f64::INFINITY, f64::min);
            let to = bounds.iter().map(|b| b[axis][1]).fold(f64::NEG_INFINITY, f64::max);
            sizes.push(to - from);
        }
    }
    sizes
}

/// A range of rows as y upwards.
fn flipped([top, bottom]: [f64; 2], rows: usize) -> [f64; 2] {
    [rows as f64 - 1.0 - bottom, rows as f64 - 1.0 - top]
}

/// What a piece is, in messages.
fn kind_of(piece: &Piece) -> &'static str {
    match piece.shape {
        Shape::Line(..) => "line",
        Shape::Circle(..) if piece.is_closed => "circle",
        Shape::Circle(..) => "arc",
    }
}
