//! Reads drawings of any format.

use crate::dxf::{DxfDrawing, read_dxf};
use crate::pdf::read_pdf;
use crate::source::extension;
use crate::svg::read_svg;
use crate::trace::read_traced;
use planish_estimate::Result;
use std::path::Path;

/// Reads a drawing: SVG, PDF and pictures by their extensions, all others as DXF.
///
/// # Errors
/// As [`read_dxf`], [`read_svg`], [`read_pdf`] and [`read_brightness`](crate::picture::read_brightness).
pub fn read_drawing(path: &Path) -> Result<DxfDrawing> {
    match extension(path).as_str() {
        "svg" => read_svg(path),
        "pdf" => read_pdf(path),
        "png" | "jpg" | "jpeg" | "tif" | "tiff" => read_traced(path),
        _ => read_dxf(path),
    }
}
