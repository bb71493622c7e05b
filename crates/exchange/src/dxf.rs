//! DXF (Drawing Interchange Format, ASCII): curves of drawings in.
//!
//! **Input.** `LINE`, `ARC`, `CIRCLE`, `ELLIPSE`, `LWPOLYLINE`, `POLYLINE` and `SPLINE` of the section
//! `ENTITIES`, and of blocks placed by `INSERT`. Lines are hidden if the name of their layer contains
//! `HIDDEN` or their line type is dashed. Centre lines (`CENTER`, `DASHDOT`) are ignored.
//!
//! **Output.** Curves with their style, the unit of `$INSUNITS`, counts of ignored entities by kind (texts,
//! hatches), and messages on what was ignored and on dimensions that conflict with the drawing. Coordinates
//! are those of the file: x to the right, y up.
//!
//! **Limits.** Entities outside the xy plane (an extrusion direction other than ±z) are errors. Binary DXF
//! and meshes (`POLYLINE` of faces) are not supported.
//!
//! # References
//! Autodesk, *AutoCAD 2012 DXF Reference* (group codes).

mod dimension;
mod entity;
mod groups;
mod placed;
#[cfg(test)]
mod tests;

use crate::Unit;
use crate::source::read_file;
use groups::{Groups, Record};
use placed::{Block, Drawer, Items, Place, Sheet};
use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_solid::views::DrawnCurve;
use std::collections::BTreeMap;
use std::path::Path;

/// More entities than this are not a drawing of a part.
const MOST_ENTITIES: usize = 200_000;

/// What a DXF file holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DxfDrawing {
    /// Its curves, in the file's order.
    pub curves: Vec<DrawnCurve>,
    /// The unit that it names.
    pub unit: Option<Unit>,
    /// How many entities of which kind were passed over.
    pub passed_over: BTreeMap<String, usize>,
    /// What was left out for another reason, in words that name the entity.
    pub findings: Vec<Finding>,
}

/// Reads a DXF file.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) where it cannot be read;
/// [`Input`](planish_estimate::ErrorKind::Input), naming entity and line, where it is no ASCII DXF or an
/// entity lacks what it needs.
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
    let mut block: Option<(String, Block)> = None;
    let mut section = String::new();
    let mut entities = 0_usize;
    let mut ended = false;
    while let Some(record) = groups.next_record()? {
        match record.kind.as_str() {
            "SECTION" => {
                section = record.text(2).unwrap_or_default().to_owned();
                if section == "HEADER" {
                    unit = unit_of(&record);
                }
            }
            "ENDSEC" => section.clear(),
            "EOF" => {
                ended = true;
                break;
            }
            "LAYER" if section == "TABLES" => {
                if let (Some(name), Some(line_type)) = (record.text(2), record.text(6)) {
                    sheet.layers.insert(name.to_uppercase(), line_type.to_uppercase());
                }
            }
            "BLOCK" if section == "BLOCKS" => {
                let name = record.text(2).unwrap_or_default().to_uppercase();
                block = Some((name, Block::at(&record)?));
            }
            "ENDBLK" if section == "BLOCKS" => sheet.blocks.extend(block.take()),
            _ if section == "ENTITIES" || section == "BLOCKS" => {
                entities += 1;
                if entities > MOST_ENTITIES {
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
    let (mut drawing, dimensions, passed_over) = drawer.finish();
    for (kind, (count, first)) in &passed_over {
        drawing.passed_over.insert(kind.clone(), *count);
        drawing.findings.push(Finding::new(
            FindingCode::EntitiesSkipped,
            format!("passed over {count} of {kind}, the first {first}: it draws no edges"),
        ));
    }
    drawing.findings.extend(dimension::mismatches(&dimensions, &drawing.curves)?);
    if !ended && drawing.curves.is_empty() {
        return Err(Error::input(
            "needed an ASCII DXF file that ends in EOF, found none of it: is it a DXF?",
        ));
    }
    Ok(drawing)
}

fn too_many() -> Error {
    Error::input(format!("needed at most {MOST_ENTITIES} entities, found more"))
}

/// `$INSUNITS`: 1 inches, 2 feet, 4 millimetres, 6 metres.
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
