//! Texts, hatches and arrowheads of a sheet.

use super::groups::Record;
use super::hatch;
use crate::affine::Affine;
use crate::dimension_text::plain_text;
use planish_estimate::Result;
use planish_solid::sheet::{Annotations, SheetText};

/// Adds what an entity says about the sheet; false if its kind says nothing.
pub(super) fn add(annotations: &mut Annotations, record: &Record, map: &Affine) -> Result<bool> {
    match record.kind.as_str() {
        "TEXT" | "MTEXT" | "ATTRIB" => {
            let text = record.groups.iter().filter(|g| g.code == 3 || g.code == 1).map(|g| g.value.as_str());
            let text = plain_text(&text.collect::<String>());
            if let Some(at) = place_of_text(record)? {
                annotations.texts.push(SheetText { at: map.point(at), text });
            }
        }
        "HATCH" => annotations.hatches.extend(hatch::outlines(record, map)?),
        "SOLID" | "TRACE" => annotations.arrowheads.extend(triangle(record, map)?),
        _ => return Ok(false),
    }
    Ok(true)
}

/// Where a text is; the second point counts if the text is aligned with it.
fn place_of_text(record: &Record) -> Result<Option<[f64; 2]>> {
    let is_aligned = record.kind != "MTEXT"
        && (record.number(72)?.unwrap_or(0.0) != 0.0 || record.number(73)?.unwrap_or(0.0) != 0.0);
    let point =
        |code: i32| Ok::<_, planish_estimate::Error>(record.number(code)?.zip(record.number(code + 10)?));
    let second = if is_aligned { point(11)? } else { None };
    Ok(match second {
        Some(second) => Some(second),
        None => point(10)?,
    }
    .map(|(x, y)| [x, y]))
}

/// A filled triangle: the third and fourth corner of a `SOLID` are the same.
fn triangle(record: &Record, map: &Affine) -> Result<Option<[[f64; 2]; 3]>> {
    let mut corners = Vec::new();
    for code in 10..14 {
        let Some(corner) = record.number(code)?.zip(record.number(code + 10)?) else { break };
        corners.push(map.point([corner.0, corner.1]));
    }
    Ok(match corners[..] {
        [a, b, c] => Some([a, b, c]),
        [a, b, c, d] if c == d => Some([a, b, c]),
        // Two other corners may be the same as well.
        [a, b, c, d] if a == b => Some([b, c, d]),
        _ => None,
    })
}
