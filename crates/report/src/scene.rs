//! What a 3D view shows, and how it is packed into a page.
//!
//! Places of surfaces are 32-bit floats about the scene's centre, so that maps far from the origin keep their
//! digits; places of dots and lines are steps of the scene's box over 65535, which no screen tells apart.
//! Values are 32-bit floats, as in files of meshes, or small integers.

mod thin;

use crate::colour::{Map, Scale, hex};
use crate::field::{Field, Values};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use thin::{MOST_TRIANGLES, thinned};

/// For each vertex, which scans saw it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SeenBy {
    /// The scans.
    pub names: Vec<String>,
    /// The sets of scans that occur.
    pub sets: Vec<Vec<u16>>,
    /// For each vertex, its set.
    pub of_vertex: Vec<u16>,
}

/// A surface of triangles.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SurfaceShown {
    /// What it is.
    pub name: String,
    /// Its vertices.
    pub positions: Vec<[f64; 3]>,
    /// Its triangles.
    pub triangles: Vec<[u32; 3]>,
    /// What it may be coloured by, the first at once.
    pub fields: Vec<Field>,
    /// Which scans saw it, where that is known.
    pub seen_by: Option<SeenBy>,
    /// Whether it is not shown at first.
    pub hidden: bool,
    /// Whether its triangles are flat, as those of solids are.
    pub flat: bool,
    /// Whether what lies behind is seen through it.
    pub translucent: bool,
}

/// Dots.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Cloud {
    /// What they are.
    pub name: String,
    /// Where.
    pub positions: Vec<[f64; 3]>,
    /// What they are coloured by, the first at once.
    pub fields: Vec<Field>,
    /// Whether they are not shown at first.
    pub hidden: bool,
    /// Width in pixels; 3 where it is 0.
    pub width: u8,
}

/// Straight lines.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LineSet {
    /// What they are.
    pub name: String,
    /// Both ends of each.
    pub segments: Vec<[[f64; 3]; 2]>,
    /// Colour as in CSS; dark where empty.
    pub colour: String,
    /// Whether they are not shown at first.
    pub hidden: bool,
}

/// A place with a number on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    /// Where.
    pub at: [f64; 3],
    /// The number.
    pub label: String,
    /// What is to be said of it.
    pub text: String,
    /// The direction from which it is seen.
    pub normal: [f64; 3],
}

/// What is shown in 3D.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scene {
    /// Unit of lengths.
    pub unit: String,
    /// Surfaces.
    pub surfaces: Vec<SurfaceShown>,
    /// Dots.
    pub clouds: Vec<Cloud>,
    /// Lines.
    pub lines: Vec<LineSet>,
    /// Marked places.
    pub marks: Vec<Mark>,
    /// What the marks are.
    pub marks_name: String,
}

/// Directions from which a thing is looked at.
const FROM: [f64; 3] = [0.55, -0.75, 0.5];
/// A surface faces one way when its normals add up to more than this share of its area.
const FACING: f64 = 0.6;

impl Scene {
    /// The smallest box about the surfaces, or about all that is shown where there is none.
    fn bounds(&self) -> Option<[[f64; 3]; 2]> {
        let surfaces = self.surfaces.iter().flat_map(|s| &s.positions);
        let others = (self.clouds.iter().flat_map(|c| &c.positions))
            .chain(self.lines.iter().flat_map(|l| l.segments.iter().flatten()))
            .chain(self.marks.iter().map(|m| &m.at));
        box_of(surfaces).or_else(|| box_of(others))
    }

    /// The whole box: what is quantised has to lie in it.
    fn outer(&self) -> Option<[[f64; 3]; 2]> {
        box_of(
            (self.surfaces.iter().flat_map(|s| &s.positions))
                .chain(self.clouds.iter().flat_map(|c| &c.positions))
                .chain(self.lines.iter().flat_map(|l| l.segments.iter().flatten()))
                .chain(self.marks.iter().map(|m| &m.at)),
        )
    }

    /// As JSON for `assets/viewer.js`; none where there is nothing to show.
    pub(crate) fn packed(&self) -> Option<Value> {
        let inner = self.bounds()?;
        let outer = self.outer()?;
        let centre: [f64; 3] = std::array::from_fn(|d| 0.5 * (inner[0][d] + inner[1][d]));
        let about = |p: &[f64; 3]| -> [f64; 3] { std::array::from_fn(|d| p[d] - centre[d]) };
        let steps = Steps { low: about(&outer[0]), high: about(&outer[1]) };
        let surfaces: Vec<Value> = (self.surfaces.iter())
            .map(|surface| {
                let fewer = thinned(surface, MOST_TRIANGLES);
                let thinned = fewer.is_some();
                let surface = fewer.as_ref().unwrap_or(surface);
                let places = surface.positions.iter().flat_map(about).map(|x| x as f32);
                let mut made = json!({
                    "name": surface.name,
                    "positions": floats(places),
                    "triangles": packed("u32", bytes_of(&surface.triangles)),
                    "fields": surface.fields.iter().map(Field::packed).collect::<Vec<_>>(),
                    "hidden": surface.hidden,
                    "flat": surface.flat,
                    "translucent": surface.translucent,
                    "thinned": thinned,
                });
                if let Some(seen) = &surface.seen_by {
                    made["sets"] = json!({
                        "names": seen.names,
                        "sets": seen.sets,
                        "of_vertex": packed("u16", seen.of_vertex.iter().flat_map(|k| k.to_le_bytes())),
                    });
                }
                made
            })
            .collect();
        let clouds: Vec<Value> = (self.clouds.iter())
            .map(|cloud| {
                json!({
                    "name": cloud.name,
                    "positions": steps.packed(cloud.positions.iter().map(about)),
                    "fields": cloud.fields.iter().map(Field::packed).collect::<Vec<_>>(),
                    "hidden": cloud.hidden,
                    "width": cloud.width,
                })
            })
            .collect();
        let lines: Vec<Value> = (self.lines.iter())
            .map(|lines| {
                json!({
                    "name": lines.name,
                    "positions": steps.packed(lines.segments.as_flattened().iter().map(about)),
                    "colour": lines.colour,
                    "hidden": lines.hidden,
                })
            })
            .collect();
        let marks: Vec<Value> = (self.marks.iter())
            .map(|mark| {
                let Mark { at, label, text, normal } = mark;
                json!({"at": about(at), "label": label, "text": text, "normal": normal})
            })
            .collect();
        let (from, up) = self.view();
        Some(json!({
            "unit": self.unit,
            "maps": colour_maps(),
            "centre": centre,
            // What is looked at, and the box that steps divide: readings may lie far outside.
            "low": about(&inner[0]),
            "high": about(&inner[1]),
            "steps": [steps.low, steps.high],
            "from": from,
            "up": up,
            "surfaces": surfaces,
            "clouds": clouds,
            "lines": lines,
            "marks": marks,
            "marks_name": self.marks_name,
        }))
    }

    /// From where the scene is looked at, and what is up: a sheet from its front, other things from a corner,
    /// z up.
    #[must_use]
    pub fn view(&self) -> ([f64; 3], [f64; 3]) {
        let (mut facing, mut area) = ([0.0; 3], 0.0);
        for surface in &self.surfaces {
            for t in &surface.triangles {
                let [a, b, c] = t.map(|k| surface.positions[k as usize]);
                let [p, q]: [[f64; 3]; 2] = [b, c].map(|x| std::array::from_fn(|d| x[d] - a[d]));
                let n = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
                for d in 0..3 {
                    facing[d] += n[d];
                }
                area += length(n);
            }
        }
        let towards = length(facing);
        if towards <= FACING * area || area == 0.0 {
            return (FROM, [0.0, 0.0, 1.0]);
        }
        let n = facing.map(|c| c / towards);
        // Up is what is nearest to z, else to y, and the view slants a little.
        let up = if n[2].abs() < 0.9 { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
        let from = std::array::from_fn(|d| n[d] + 0.35 * [0.5, -0.8, 0.4][d]);
        (from, up)
    }
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}

fn box_of<'a>(points: impl Iterator<Item = &'a [f64; 3]>) -> Option<[[f64; 3]; 2]> {
    points.filter(|p| p.iter().all(|c| c.is_finite())).fold(None, |found: Option<[[f64; 3]; 2]>, p| {
        let [low, high] = found.unwrap_or([*p, *p]);
        Some([std::array::from_fn(|d| low[d].min(p[d])), std::array::from_fn(|d| high[d].max(p[d]))])
    })
}

/// A box in 65535 steps along each side.
struct Steps {
    low: [f64; 3],
    high: [f64; 3],
}

impl Steps {
    fn packed(&self, places: impl Iterator<Item = [f64; 3]>) -> Value {
        let step = |p: [f64; 3]| -> [u16; 3] {
            std::array::from_fn(|d| {
                let side = self.high[d] - self.low[d];
                if side > 0.0 {
                    (65535.0 * (p[d] - self.low[d]) / side).round().clamp(0.0, 65535.0) as u16
                } else {
                    0
                }
            })
        };
        packed("u16", places.flat_map(step).flat_map(u16::to_le_bytes))
    }
}

impl Field {
    fn packed(&self) -> Value {
        let mut made = json!({"key": self.key, "label": self.label, "unit": self.unit});
        if let Some(shown) = &self.shown {
            made["shown"] = json!(shown);
        }
        match Scale::of(self) {
            Scale::Range(range) => {
                let ticks: Vec<(f64, &str)> =
                    (range.ticks.iter()).map(|tick| (tick.place, tick.label.as_str())).collect();
                made["range"] = json!({
                    "map": range.map.name(),
                    "low": range.low,
                    "high": range.high,
                    "logarithmic": range.logarithmic,
                    "ticks": ticks,
                });
            }
            Scale::Kinds(kinds) => {
                let kinds: Vec<(u16, &str, String)> =
                    (kinds.iter()).map(|kind| (kind.value, kind.label.as_str(), hex(kind.colour))).collect();
                made["categories"] = json!(kinds);
            }
        }
        made["values"] = match &self.values {
            Values::Numbers(values) => floats(values.iter().map(|v| *v as f32)),
            Values::Kinds(kinds) => packed("u16", kinds.iter().flat_map(|k| k.to_le_bytes())),
        };
        made
    }
}

fn floats(values: impl Iterator<Item = f32>) -> Value {
    packed("f32", values.flat_map(f32::to_le_bytes))
}

fn bytes_of(triangles: &[[u32; 3]]) -> impl Iterator<Item = u8> + '_ {
    triangles.as_flattened().iter().flat_map(|k| k.to_le_bytes())
}

/// Colours of every map, by its name.
fn colour_maps() -> serde_json::Map<String, Value> {
    let colours = |map: &Map| json!(map.colours().map(|c| format!("{c:06x}")));
    Map::ALL.iter().map(|map| (map.name().to_owned(), colours(map))).collect()
}

fn packed(kind: &str, bytes: impl Iterator<Item = u8>) -> Value {
    json!({"type": kind, "data": STANDARD.encode(bytes.collect::<Vec<u8>>())})
}
