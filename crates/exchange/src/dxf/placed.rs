//! Draws entities directly or through blocks that are placed by `INSERT`.
//!
//! A point p of a block is drawn at `P + R S (p − b)` with the base point b of the block, and the scales S,
//! rotation R and insertion point P of the insert. Blocks may contain inserts. An entity on layer 0 of a
//! block takes the layer of the insert, and with line type `BYBLOCK` also its line type.

use super::annotation;
use super::entity::{curves_of, polyline_curves};
use super::groups::Record;
use super::line_style::Dashes;
use super::{DxfDrawing, MAX_ENTITIES, too_many};
use crate::affine::Affine;
use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_solid::views::{Curve2, DrawnCurve};
use std::collections::{BTreeMap, HashMap};

/// Maximum nesting of blocks. The format forbids recursion; the limit finds it.
const MAX_DEPTH: usize = 16;

/// Entities in the order of the file; an old-style polyline is stored with its vertices.
#[derive(Default)]
pub(super) struct Items(Vec<(Record, Vec<Record>)>);

impl Items {
    pub(super) fn add(&mut self, record: Record) {
        match (record.kind.as_str(), self.0.last_mut()) {
            // Old-style polylines are a sequence POLYLINE, VERTEX …, SEQEND of records at the same level.
            ("VERTEX", Some((polyline, vertices))) if polyline.kind == "POLYLINE" => vertices.push(record),
            ("SEQEND", _) => {}
            _ => self.0.push((record, Vec::new())),
        }
    }
}

/// A block: a base point and entities.
pub(super) struct Block {
    base: [f64; 2],
    pub(super) items: Items,
}

impl Block {
    pub(super) fn at(record: &Record) -> Result<Self> {
        Ok(Self {
            base: [record.number(10)?.unwrap_or(0.0), record.number(20)?.unwrap_or(0.0)],
            items: Items::default(),
        })
    }
}

/// Layers with their line types, the dashes of line types, and blocks. Keys are in capitals, because names
/// are not case-sensitive.
#[derive(Default)]
pub(super) struct Sheet {
    pub(super) layers: BTreeMap<String, String>,
    pub(super) line_types: HashMap<String, Option<Dashes>>,
    pub(super) blocks: HashMap<String, Block>,
}

/// Placement and style of entities.
#[derive(Clone)]
pub(super) struct Place {
    map: Affine,
    /// Layer and line type of the insert, if any.
    outer: Option<(String, String)>,
    /// Blocks and inserts of the entities, for messages.
    named: String,
    depth: usize,
}

impl Default for Place {
    fn default() -> Self {
        Self { map: Affine::IDENTITY, outer: None, named: String::new(), depth: 0 }
    }
}

impl Place {
    /// Placement of the content of a block that is inserted here; `shift` is in the directions of the insert.
    fn of_insert(
        &self,
        record: &Record,
        block: &Block,
        shift: [f64; 2],
        style: (String, String),
    ) -> Result<Self> {
        let number = |code: i32, default: f64| Ok::<f64, Error>(record.number(code)?.unwrap_or(default));
        let (sin, cos) = number(50, 0.0)?.to_radians().sin_cos();
        let (sx, sy) = (number(41, 1.0)?, number(42, 1.0)?);
        // A scale of 0 would collapse the block.
        if sx == 0.0 || sy == 0.0 {
            return Err(Error::input("expected scales other than 0, found 0"));
        }
        // An extrusion direction of −z mirrors x.
        let mirror = if number(230, 1.0)? < 0.0 { -1.0 } else { 1.0 };
        let columns = [[mirror * sx * cos, sx * sin], [-mirror * sy * sin, sy * cos]];
        let at = [number(10, 0.0)?, number(20, 0.0)?];
        let [dx, dy] = shift;
        let [bx, by] = block.base;
        let own = [
            // The shift of rows and columns turns with the insert but is not scaled.
            mirror * (at[0] + cos * dx - sin * dy) - columns[0][0] * bx - columns[1][0] * by,
            at[1] + sin * dx + cos * dy - columns[0][1] * bx - columns[1][1] * by,
        ];
        Ok(Self {
            map: self.map.after(&Affine { columns, origin: own }),
            outer: Some(style),
            named: format!(
                "{} in block {} by {}",
                self.named,
                record.text(2).unwrap_or_default(),
                record.name()
            ),
            depth: self.depth + 1,
        })
    }
}

/// Kinds that draw no edges: number and first entity.
pub(super) type Ignored = BTreeMap<String, (usize, String)>;

/// Draws entities into a drawing.
pub(super) struct Drawer<'a> {
    sheet: &'a Sheet,
    drawing: DxfDrawing,
    dimensions: Vec<&'a Record>,
    ignored: Ignored,
    drawn: usize,
    /// Numbers of layers, line types, colours and weights.
    pens: HashMap<(String, String, [String; 3]), u32>,
}

impl<'a> Drawer<'a> {
    pub(super) fn new(sheet: &'a Sheet, drawing: DxfDrawing) -> Self {
        Self {
            sheet,
            drawing,
            dimensions: Vec::new(),
            ignored: Ignored::new(),
            drawn: 0,
            pens: HashMap::new(),
        }
    }

    /// Returns the drawing, the dimensions outside blocks, and the ignored kinds.
    pub(super) fn finish(self) -> (DxfDrawing, Vec<&'a Record>, Ignored) {
        (self.drawing, self.dimensions, self.ignored)
    }

    pub(super) fn draw<'b: 'a>(&mut self, items: &'b Items, place: &Place) -> Result<()> {
        for (record, vertices) in &items.0 {
            // Counted here, because nested blocks multiply the entities of the file.
            self.drawn += 1;
            if self.drawn > MAX_ENTITIES {
                return Err(too_many());
            }
            // Group 67 = 1: paper space holds the layout of sheets, not the part.
            if record.number(67)?.is_some_and(|space| space == 1.0) {
                continue;
            }
            match record.kind.as_str() {
                "INSERT" => self.insert(record, place).map_err(|e| e.in_context(record.name()))?,
                // Dimensions inside blocks measure the block before it is scaled, so they are not compared.
                "DIMENSION" if place.depth == 0 => self.dimensions.push(record),
                _ => self.draw_one(record, vertices, place)?,
            }
        }
        Ok(())
    }

    fn draw_one(&mut self, record: &Record, vertices: &[Record], place: &Place) -> Result<()> {
        let name = format!("{}{}", record.name(), place.named);
        let read = annotation::add(&mut self.drawing.annotations, record, &place.map);
        if read.map_err(|e| e.in_context(&name))? {
            self.ignore(&record.kind, name);
            return Ok(());
        }
        let (layer, line_type) = outer_style(record, &self.sheet.layers, place.outer.as_ref());
        let dashes = match self.sheet.line_types.get(&line_type) {
            Some(Some(dashes)) => Some(*dashes),
            _ => Dashes::of_name(&line_type).or_else(|| Dashes::of_name(&layer)),
        };
        let Some(style) = Dashes::line_style(dashes) else {
            for curve in curves_of(record).ok().flatten().unwrap_or_default() {
                if let Curve2::Segment(a, b) = curve {
                    self.drawing.annotations.centre_lines.push([a, b].map(|p| place.map.point(p)));
                }
            }
            self.ignore("centre line", name);
            return Ok(());
        };
        let look = [62, 420, 370].map(|code| record.text(code).unwrap_or_default().to_owned());
        let next = self.pens.len() as u32;
        let pen = *self.pens.entry((layer, line_type, look)).or_insert(next);
        let curves = match record.kind.as_str() {
            "POLYLINE" => polyline_curves(record, vertices),
            _ => curves_of(record),
        };
        let Some(curves) = curves.map_err(|e| e.in_context(&name))? else {
            self.ignore(&record.kind, name);
            return Ok(());
        };
        for curve in curves {
            if curve.length() <= 0.0 {
                self.drawing.findings.push(Finding::new(
                    FindingCode::EntityWithoutLength,
                    format!("{name} has no length and is ignored"),
                ));
                continue;
            }
            self.drawing.annotations.pens.push(pen);
            self.drawing.curves.push(DrawnCurve {
                // The identity map would change the last bits of start angles, which pass through cos and
                // atan2.
                curve: if place.depth == 0 { curve } else { place.map.curve(&curve) },
                style,
                entity: name.clone(),
            });
        }
        Ok(())
    }

    fn insert(&mut self, record: &Record, place: &Place) -> Result<()> {
        let name = record.text(2).unwrap_or_default();
        let sheet: &'a Sheet = self.sheet;
        let Some(block) = sheet.blocks.get(&name.to_uppercase()) else {
            return Err(Error::input(format!(
                "expected the block `{name}` in the section BLOCKS, found none"
            )));
        };
        if place.depth >= MAX_DEPTH {
            return Err(Error::input(format!(
                "expected at most {MAX_DEPTH} nested blocks, found more: does `{name}` contain itself?"
            )));
        }
        if record.number(210)?.unwrap_or(0.0).abs() + record.number(220)?.unwrap_or(0.0).abs() > 1e-9 {
            return Err(Error::input(
                "expected an entity in the xy plane, found another extrusion direction",
            ));
        }
        let count = |code: i32| Ok::<usize, Error>((record.number(code)?.unwrap_or(1.0).max(1.0)) as usize);
        let (columns, rows) = (count(70)?, count(71)?);
        let (dx, dy) = (record.number(44)?.unwrap_or(0.0), record.number(45)?.unwrap_or(0.0));
        // Checked before drawing, because rows and columns can be any numbers.
        if columns.saturating_mul(rows) > MAX_ENTITIES {
            return Err(too_many());
        }
        let style = outer_style(record, &self.sheet.layers, place.outer.as_ref());
        for k in 0..columns * rows {
            let shift = [(k % columns) as f64 * dx, (k / columns) as f64 * dy];
            let inner = place.of_insert(record, block, shift, style.clone())?;
            self.draw(&block.items, &inner)?;
        }
        Ok(())
    }

    fn ignore(&mut self, kind: &str, name: String) {
        self.ignored.entry(kind.to_owned()).or_insert((0, name)).0 += 1;
    }
}

/// Layer and line type of an entity, in capitals.
fn outer_style(
    record: &Record,
    layers: &BTreeMap<String, String>,
    outer: Option<&(String, String)>,
) -> (String, String) {
    let mut layer = record.text(8).unwrap_or_default().to_uppercase();
    if let (Some((outer, _)), "0" | "") = (outer, layer.as_str()) {
        layer.clone_from(outer);
    }
    let own = record.text(6).unwrap_or("BYLAYER").to_uppercase();
    let line_type = match (own.as_str(), outer) {
        ("BYBLOCK", Some((_, line_type))) => line_type.clone(),
        // `BYBLOCK` outside a block has no insert to inherit from, so the layer decides.
        ("BYLAYER" | "BYBLOCK", _) => layers.get(&layer).cloned().unwrap_or_default(),
        _ => own,
    };
    (layer, line_type)
}
