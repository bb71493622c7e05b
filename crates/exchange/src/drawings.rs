//! Reads drawings of any format.

use crate::dxf::{DxfDrawing, read_dxf};
use crate::pdf::read_pdf;
use crate::source::extension;
use crate::svg::read_svg;
use planish_estimate::{Error, Result};
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
        "png" | "jpg" | "jpeg" | "tif" | "tiff" => Err(Error::unsupported(format!(
            "{}: expected a drawing with lines (.dxf, .svg, .pdf), found a picture: trace it, or export the \
             drawing from the program that made it",
            path.display()
        ))),
        _ => read_dxf(path),
    }
}
