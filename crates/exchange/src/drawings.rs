//! Reads drawings of any format.

use crate::dxf::{DxfDrawing, read_dxf};
use crate::pdf::read_pdf;
use crate::source::extension;
use crate::svg::read_svg;
use crate::trace::read_traced;
use planish_estimate::Result;
use std::path::Path;

/// Reads a drawing: SVG and PDF by their extensions, all others as DXF.
///
/// # Errors
/// [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for pictures; otherwise as [`read_dxf`],
/// [`read_svg`] and [`read_pdf`].
pub fn read_drawing(path: &Path) -> Result<DxfDrawing> {
    match extension(path).as_str() {
        "svg" => read_svg(path),
        "pdf" => read_pdf(path),
        "png" | "jpg" | "jpeg" | "tif" | "tiff" => read_traced(path),
        _ => read_dxf(path),
    }
}
