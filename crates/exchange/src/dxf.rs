//! Reads the curves of drawings from DXF files (Drawing Interchange Format, ASCII).
//!
//! **Input.** `LINE`, `ARC`, `CIRCLE`, `ELLIPSE`, `LWPOLYLINE`, `POLYLINE` and `SPLINE` of the section
//! `ENTITIES`, and of blocks placed by `INSERT`. Lines are hidden if their line type has dashes of one
//! length, or if its name or that of the layer says so (`HIDDEN`, `VERDECKT`, `CACHE` …). Centre lines, of
//! alternating dashes, are ignored.
//!
//! **Output.** Curves with their style, the unit of `$INSUNITS`, counts of ignored entities by kind, and
//! messages on what was ignored and on dimensions that conflict with the drawing. Texts, outlines of
//! hatches, centre lines, arrowheads and dimensions are [`Annotations`]. Coordinates are those of the file: x
//! to the right, y up.
//!
//! **Limits.** Entities outside the xy plane (an extrusion direction other than ±z) are errors. Binary DXF
//! and meshes (`POLYLINE` of faces) are not supported.
//!
//! # References
//! Autodesk, *AutoCAD 2012 DXF Reference* (group codes).

mod annotation;
mod dimension;
mod entity;
mod groups;
mod hatch;
mod line_style;
mod placed;
mod smooth;
#[cfg(test)]
mod tests;

use crate::Unit;
use crate::source::read_file;
use crate::strokes::add_dimensions_between;
use dimension::DimensionLengths;
use groups::{Groups, Record};
use line_style::Dashes;
use placed::{Block, Drawer, Items, Place, Sheet};
use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_solid::sheet::Annotations;
use planish_solid::views::DrawnCurve;
use std::collections::BTreeMap;
use std::path::Path;

/// Maximum number of entities, counted again for each insert of a block. Far above the drawing of a part;
/// blocks of blocks multiply, so that a small file could draw any number. Guarded by
/// `a_missing_or_recursive_block_is_named`.
const MAX_ENTITIES: usize = 200_000;

/// Content of a drawing file (DXF, SVG, PDF or a picture).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DxfDrawing {
    /// Curves in the order of the file.
    pub curves: Vec<DrawnCurve>,
    /// What accompanies the curves.
    pub annotations: Annotations,
    /// Unit of length, if the file states it.
    pub unit: Option<Unit>,
    /// Maximum error of coordinates by rounding, if the format has few digits.
    pub rounding: Option<f64>,
    /// For a picture: length per pixel, if its dimensions state it.
    pub pixel_length: Option<f64>,
    /// Curves of a picture that may be visible or hidden: they are no longer than a dash.
    pub open_styles: Vec<usize>,
    /// For a scan or a photograph that was straightened: how the sheet lies in it.
    pub placement: Option<PicturePlacement>,
    /// Number of ignored entities by kind, such as texts and hatches.
    pub ignored: BTreeMap<String, usize>,
    /// Ignored entities and conflicting dimensions; each text names an entity.
    pub findings: Vec<Finding>,
}

/// How a sheet lies in its picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PicturePlacement {
    /// Homography, row by row, from pixels of the picture (x to the right, y down, the middle of the first
    /// pixel is the origin) to pixels of the straight sheet.
    pub sheet_from_picture: [[f64; 3]; 3],
    /// Clockwise rotation in the middle of the picture, and its σ.
    pub rotation_rad: f64,
    /// σ of the rotation.
    pub sigma_rad: f64,
    /// `none`, `page-of-series-a` (the page is assumed to have the ratio √2), or `unknown-ratio`.
    pub perspective: &'static str,
}

/// Reads a DXF file.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) if it cannot be read;
/// [`Input`](planish_estimate::ErrorKind::Input), naming entity and line, if it is not an ASCII DXF file or
/// an entity is incomplete.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("line.dxf");
/// let groups = "0 SECTION 2 ENTITIES 0 LINE 10 0 20 0 11 3 21 4 0 ENDSEC 0 EOF";
/// std::fs::write(&path, groups.replace(' ', "\n"))?;
/// let drawing = planish_exchange::dxf::read_dxf(&path)?;
/// assert_eq!(drawing.curves[0].curve.length(), 5.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_dxf(path: &Path) -> Result<DxfDrawing> {
    read_file(path, |mut source, _| {
        let mut groups = Groups::new(&mut source);
        read(&mut groups)
    })
}

fn read<R: std::io::Read>(groups: &mut Groups<R>) -> Result<DxfDrawing> {
    let mut unit = None;
    let mut sheet = Sheet::default();
    let mut items = Items::default();
    let mut lengths = DimensionLengths::default();
    let mut block: Option<(String, Block)> = None;
    let mut section = String::new();
    let mut entities = 0_usize;
    let mut ended = false;
    while let Some(record) = groups.next_record()? {
        match record.kind.as_str() {
            "SECTION" => {
                section = record.text(2).unwrap_or_default().to_owned();
                // Header variables have no code 0, so all of them belong to the record of the section.
                if section == "HEADER" {
                    unit = unit_of(&record);
                    lengths.read_header(&record);
                }
            }
            "ENDSEC" => section.clear(),
            "EOF" => {
                ended = true;
                break;
            }
            // Entities with line type BYLAYER need the line types of layers, which precede them in the file.
            "LAYER" if section == "TABLES" => {
                if let (Some(name), Some(line_type)) = (record.text(2), record.text(6)) {
                    sheet.layers.insert(name.to_uppercase(), line_type.to_uppercase());
                }
            }
            "LTYPE" if section == "TABLES" => {
                let name = record.text(2).unwrap_or_default().to_uppercase();
                sheet.line_types.insert(name, Dashes::of_pattern(&record)?);
            }
            "DIMSTYLE" if section == "TABLES" => lengths.read_style(&record)?,
            // Blocks may insert blocks that are defined later, so all are read before anything is drawn.
            "BLOCK" if section == "BLOCKS" => {
                let name = record.text(2).unwrap_or_default().to_uppercase();
                block = Some((name, Block::at(&record)?));
            }
            "ENDBLK" if section == "BLOCKS" => sheet.blocks.extend(block.take()),
            _ if section == "ENTITIES" || section == "BLOCKS" => {
                // Counted here as well as on drawing, because the records themselves take memory.
                entities += 1;
                if entities > MAX_ENTITIES {
                    return Err(too_many());
                }
                match &mut block {
                    Some((_, block)) if section == "BLOCKS" => block.items.add(record),
                    None if section == "BLOCKS" => {}
                    _ => items.add(record),
                }
            }
            _ => {}
        }
    }
    let empty = DxfDrawing { unit, ..DxfDrawing::default() };
    let mut drawer = Drawer::new(&sheet, empty);
    drawer.draw(&items, &Place::default())?;
    let (mut drawing, dimensions, ignored) = drawer.finish();
    // One finding per kind, because a drawing may have thousands of texts.
    for (kind, (count, first)) in &ignored {
        drawing.ignored.insert(kind.clone(), *count);
        drawing.findings.push(Finding::new(
            FindingCode::EntitiesSkipped,
            format!("ignored {count} × {kind}, which draws no edges; the first is {first}"),
        ));
    }
    drawing.annotations.dimensions = lengths.of(&dimensions)?;
    drawing.annotations.diameters = lengths.diameters(&dimensions)?;
    drawing.annotations.length_factor = lengths.only_factor();
    // Programs also write dimensions as lines, arrowheads and texts.
    add_dimensions_between(&mut drawing.annotations);
    drawing.findings.extend(dimension::conflicts(&dimensions, &drawing)?);
    // Otherwise any text of alternating whole numbers and words would count as an empty drawing.
    if !ended && drawing.curves.is_empty() {
        return Err(Error::input(
            "expected an ASCII DXF file that ends with EOF, found no entities and no EOF",
        ));
    }
    Ok(drawing)
}

fn too_many() -> Error {
    Error::input(format!("expected at most {MAX_ENTITIES} entities, found more"))
}

/// Unit of `$INSUNITS`: 1 inches, 2 feet, 4 millimetres, 6 metres; others are ignored.
fn unit_of(header: &Record) -> Option<Unit> {
    let at = header.groups.iter().position(|g| g.code == 9 && g.value == "$INSUNITS")?;
    match header.groups.get(at + 1)?.value.parse::<i64>().ok()? {
        1 => Some(Unit::Inch),
        2 => Some(Unit::Foot),
        4 => Some(Unit::Millimetre),
        6 => Some(Unit::Metre),
        _ => None,
    }
}
