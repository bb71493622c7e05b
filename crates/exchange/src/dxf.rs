//! DXF (Drawing Interchange Format, ASCII): curves of drawings in.
//!
//! Comes in: `LINE`, `ARC`, `CIRCLE`, `ELLIPSE`, `LWPOLYLINE`, `SPLINE` of the section `ENTITIES`, on layers whose names hold `HIDDEN`
//! or with dashed line types for hidden lines; centre lines (`CENTER`, `DASHDOT`) are left out. Goes out: curves with their style,
//! the unit of `$INSUNITS`, and how many entities of which kind were passed over (texts, dimensions, hatches, blocks).
//! Coordinates are those of the file: x to the right, y up.
//!
//! Not guaranteed: entities out of the xy plane (an extrusion direction other than ±z is an error); binary DXF.
//!
//! # References
//! Autodesk, *AutoCAD 2012 DXF Reference* (group codes).

mod entity;
mod groups;

use crate::Unit;
use crate::source::read_file;
use entity::curves_of;
use groups::{Groups, Record};
use planish_estimate::{Error, Result};
use planish_solid::views::{DrawnCurve, LineStyle};
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
    pub warnings: Vec<String>,
}

/// Reads a DXF file.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) where it cannot be read; [`Input`](planish_estimate::ErrorKind::Input), naming entity and line,
/// where it is no ASCII DXF or an entity lacks what it needs.
pub fn read_dxf(path: &Path) -> Result<DxfDrawing> {
    read_file(path, |mut source, _| {
        let mut groups = Groups::new(&mut source);
        read(&mut groups)
    })
}

fn read<R: std::io::Read>(groups: &mut Groups<R>) -> Result<DxfDrawing> {
    let mut drawing = DxfDrawing::default();
    let mut layers: BTreeMap<String, String> = BTreeMap::new();
    let mut section = String::new();
    let mut entities = 0_usize;
    let mut ended = false;
    while let Some(record) = groups.next_record()? {
        match record.kind.as_str() {
            "SECTION" => {
                section = record.text(2).unwrap_or_default().to_owned();
                if section == "HEADER" {
                    drawing.unit = unit_of(&record);
                }
            }
            "ENDSEC" => section.clear(),
            "EOF" => {
                ended = true;
                break;
            }
            "LAYER" if section == "TABLES" => {
                if let (Some(name), Some(line_type)) = (record.text(2), record.text(6)) {
                    layers.insert(name.to_uppercase(), line_type.to_uppercase());
                }
            }
            _ if section == "ENTITIES" => {
                entities += 1;
                if entities > MOST_ENTITIES {
                    return Err(Error::input(format!(
                        "needed at most {MOST_ENTITIES} entities, found more"
                    )));
                }
                add(&mut drawing, &record, &layers)?;
            }
            _ => {}
        }
    }
    if !ended && drawing.curves.is_empty() {
        return Err(Error::input(
            "needed an ASCII DXF file that ends in EOF, found none of it: is it a DXF?",
        ));
    }
    Ok(drawing)
}

fn add(drawing: &mut DxfDrawing, record: &Record, layers: &BTreeMap<String, String>) -> Result<()> {
    // Paper space holds sheets, not the part.
    if record.number(67)?.is_some_and(|space| space == 1.0) {
        return Ok(());
    }
    let Some(style) = style_of(record, layers) else {
        *drawing.passed_over.entry("centre line".to_owned()).or_default() += 1;
        return Ok(());
    };
    let Some(curves) = curves_of(record).map_err(|e| e.in_context(record.name()))? else {
        *drawing.passed_over.entry(record.kind.clone()).or_default() += 1;
        return Ok(());
    };
    for curve in curves {
        if curve.length() <= 0.0 {
            drawing
                .warnings
                .push(format!("{} has no length: it is left out", record.name()));
            continue;
        }
        drawing.curves.push(DrawnCurve {
            curve,
            style,
            entity: record.name(),
        });
    }
    Ok(())
}

/// The style by line type, else by the layer's name or line type; none for centre lines.
fn style_of(record: &Record, layers: &BTreeMap<String, String>) -> Option<LineStyle> {
    let layer = record.text(8).unwrap_or_default().to_uppercase();
    let own = record.text(6).unwrap_or("BYLAYER").to_uppercase();
    let line_type = match own.as_str() {
        "BYLAYER" | "BYBLOCK" => layers.get(&layer).cloned().unwrap_or_default(),
        _ => own,
    };
    let says = |words: &[&str]| words.iter().any(|w| line_type.contains(w) || layer.contains(w));
    if says(&["CENTER", "CENTRE", "DASHDOT", "CHAIN", "PHANTOM", "DIVIDE"]) {
        return None;
    }
    Some(match says(&["HIDDEN", "DASH"]) {
        true => LineStyle::Hidden,
        false => LineStyle::Visible,
    })
}

/// `$INSUNITS`: 1 inches, 2 feet, 4 millimetres, 6 metres.
fn unit_of(header: &Record) -> Option<Unit> {
    let at = header
        .groups
        .iter()
        .position(|g| g.code == 9 && g.value == "$INSUNITS")?;
    match header.groups.get(at + 1)?.value.parse::<i64>().ok()? {
        1 => Some(Unit::Inch),
        2 => Some(Unit::Foot),
        4 => Some(Unit::Millimetre),
        6 => Some(Unit::Metre),
        _ => None,
    }
}
