//! Writes contours as DXF: AutoCAD 2000 entities without tables, which common readers of drawings accept.

use super::DrawnContour;
use crate::atomic::write_atomically;
use planish_contour::planar::ContourKind;
use planish_core::Unit;
use planish_estimate::Result;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// Writes contours to layer VISIBLE: circles and ellipses as such, lines as LINE, all others as LWPOLYLINE
/// with bulges.
///
/// # Errors
/// `Io` when the file cannot be written.
///
/// # Examples
/// ```
/// use planish_contour::planar::ContourKind;
/// use planish_exchange::contours::{DrawnContour, write_contours_dxf};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("hole.dxf");
/// let hole = DrawnContour { kind: ContourKind::Circle, theta: vec![10.0, 20.0, 5.0], seen: None };
/// write_contours_dxf(&path, &[hole], None)?;
/// assert_eq!(planish_exchange::dxf::read_dxf(&path)?.curves.len(), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_contours_dxf(path: &Path, contours: &[DrawnContour], unit: Option<Unit>) -> Result<()> {
    let text = drawing(contours, unit);
    write_atomically(path, |out| out.write_all(text.as_bytes()))
}

fn drawing(contours: &[DrawnContour], unit: Option<Unit>) -> String {
    // Values of `$INSUNITS`.
    let code = match unit {
        None => 0,
        Some(Unit::Inch) => 1,
        Some(Unit::Foot) => 2,
        Some(Unit::Millimetre) => 4,
        Some(Unit::Metre) => 6,
    };
    let mut text = String::new();
    let mut put = |group: i32, value: &str| {
        let _ = writeln!(text, "{group}\n{value}");
    };
    // AC1015 is AutoCAD 2000, whose entities carry subclass markers (group 100) as `entity` writes them.
    for (group, value) in [(0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1015"), (9, "$INSUNITS")] {
        put(group, value);
    }
    put(70, &code.to_string());
    for (group, value) in [(0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")] {
        put(group, value);
    }
    for contour in contours {
        entity(contour, &mut put);
    }
    put(0, "ENDSEC");
    put(0, "EOF");
    text
}

fn entity(contour: &DrawnContour, put: &mut impl FnMut(i32, &str)) {
    let theta = &contour.theta;
    let mut begin = |name: &str, marker: &str| {
        put(0, name);
        put(100, "AcDbEntity");
        put(8, "VISIBLE");
        put(100, marker);
    };
    match &contour.kind {
        ContourKind::Line => {
            // An infinite line without observed ends cannot be drawn.
            let Some([a, b]) = contour.seen else { return };
            begin("LINE", "AcDbLine");
            numbers(put, &[(10, a[0]), (20, a[1]), (30, 0.0), (11, b[0]), (21, b[1]), (31, 0.0)]);
        }
        ContourKind::Circle => {
            begin("CIRCLE", "AcDbCircle");
            numbers(put, &[(10, theta[0]), (20, theta[1]), (30, 0.0), (40, theta[2])]);
        }
        ContourKind::Ellipse => {
            begin("ELLIPSE", "AcDbEllipse");
            let (sin, cos) = theta[4].sin_cos();
            let major = [(11, theta[2] * cos), (21, theta[2] * sin), (31, 0.0)];
            numbers(put, &[(10, theta[0]), (20, theta[1]), (30, 0.0)]);
            numbers(put, &major);
            numbers(put, &[(210, 0.0), (220, 0.0), (230, 1.0)]);
            // DXF states the minor axis only as a ratio, and a whole ellipse by its start and end parameters.
            numbers(put, &[(40, theta[3] / theta[2]), (41, 0.0), (42, std::f64::consts::TAU)]);
        }
        _ => {
            let Some(outline) = contour.kind.outline(theta) else {
                return;
            };
            begin("LWPOLYLINE", "AcDbPolyline");
            put(90, &outline.vertices.len().to_string());
            put(70, if outline.closed { "1" } else { "0" });
            for (i, vertex) in outline.vertices.iter().enumerate() {
                numbers(put, &[(10, vertex[0]), (20, vertex[1])]);
                match outline.bulges.get(i) {
                    Some(&bulge) if bulge != 0.0 => numbers(put, &[(42, bulge)]),
                    _ => {}
                }
            }
        }
    }
}

fn numbers(put: &mut impl FnMut(i32, &str), values: &[(i32, f64)]) {
    for (group, value) in values {
        // The shortest text that reads back to the same number, so that a drawing repeats the estimate
        // exactly.
        put(*group, &format!("{value}"));
    }
}
