//! The content of a 3D view, and its encoding in the page.
//!
//! Positions of surfaces are 32-bit floats relative to the centre of the scene, so that maps far from the
//! origin keep their precision. Positions of points and lines are quantised to 1/65535 of the bounding box,
//! which is finer than the pixels of a screen. Values are 32-bit floats, as in mesh files, or small integers.

mod thin;

use crate::colour::{Map, Scale, hex};
use crate::field::{Field, Values};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use planish_core::DVec3;
use serde_json::{Value, json};
use thin::{MAX_TRIANGLES, thinned};

/// For each vertex, the scans that observed it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SeenBy {
    /// Names of the scans.
    pub names: Vec<String>,
    /// The sets of scans that occur, as indices into `names`.
    pub sets: Vec<Vec<u32>>,
    /// For each vertex, the index of its set.
    pub of_vertex: Vec<u32>,
}

/// A triangle surface in the 3D view.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SurfaceShown {
    /// Name shown to the reader.
    pub name: String,
    /// Vertex positions, in the unit of the scene.
    pub positions: Vec<DVec3>,
    /// Triangles as vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// Quantities for colouring; the first is selected at the start.
    pub fields: Vec<Field>,
    /// The scans that observed each vertex, if known.
    pub seen_by: Option<SeenBy>,
    /// True if it is hidden at the start.
    pub hidden: bool,
    /// True for flat shading, as for solids.
    pub flat: bool,
    /// True if it is translucent.
    pub translucent: bool,
}

/// A point cloud in the 3D view.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Cloud {
    /// Name shown to the reader.
    pub name: String,
    /// Positions, in the unit of the scene.
    pub positions: Vec<DVec3>,
    /// Quantities for colouring; the first is selected at the start.
    pub fields: Vec<Field>,
    /// True if they are hidden at the start.
    pub hidden: bool,
    /// Width of a point in pixels; 0 means 3.
    pub width: u8,
}

/// Line segments in the 3D view.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LineSet {
    /// Name shown to the reader.
    pub name: String,
    /// Both ends of each segment.
    pub segments: Vec<[DVec3; 2]>,
    /// CSS colour; dark grey if empty.
    pub colour: String,
    /// True if they are hidden at the start.
    pub hidden: bool,
}

/// A numbered point in the 3D view.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    /// Position.
    pub at: DVec3,
    /// The number, as text.
    pub label: String,
    /// Description, shown on a click.
    pub text: String,
    /// Direction from which the mark is visible: the outward normal.
    pub normal: DVec3,
}

/// The content of a 3D view.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scene {
    /// Unit of all lengths.
    pub unit: String,
    /// Surfaces.
    pub surfaces: Vec<SurfaceShown>,
    /// A point cloud in the 3D view.
    pub clouds: Vec<Cloud>,
    /// Line sets.
    pub lines: Vec<LineSet>,
    /// Numbered points.
    pub marks: Vec<Mark>,
    /// Name of the marks, shown to the reader.
    pub marks_name: String,
}

/// Default viewing direction, from the object to the camera (not normalised): oblique from above.
const OBLIQUE_VIEW: DVec3 = DVec3::new(0.55, -0.75, 0.5);
/// Ratio of |Σ area vectors| to the area above which a surface faces one direction and is shown from the
/// front.
///
/// It is 0 for a closed surface and 1 for a plane. A hemisphere has 0.5 and is shown obliquely.
const MIN_FACING: f64 = 0.6;

impl Scene {
    /// Bounding box of the surfaces, or of everything if there is no surface. It determines the view.
    ///
    /// Points include outliers, which would make the surface a speck.
    fn bounds(&self) -> Option<[DVec3; 2]> {
        let surfaces = self.surfaces.iter().flat_map(|s| &s.positions);
        let others = (self.clouds.iter().flat_map(|c| &c.positions))
            .chain(self.lines.iter().flat_map(|l| l.segments.iter().flatten()))
            .chain(self.marks.iter().map(|m| &m.at));
        // Infinite coordinates are ignored: one of them would shrink everything else to a point.
        box_of(surfaces).or_else(|| box_of(others))
    }

    /// Bounding box of everything: the range of the quantised positions.
    fn outer(&self) -> Option<[DVec3; 2]> {
        box_of(
            (self.surfaces.iter().flat_map(|s| &s.positions))
                .chain(self.clouds.iter().flat_map(|c| &c.positions))
                .chain(self.lines.iter().flat_map(|l| l.segments.iter().flatten()))
                .chain(self.marks.iter().map(|m| &m.at)),
        )
    }

    /// Encodes the scene as JSON for `assets/viewer.js`; `None` if it is empty.
    pub(crate) fn packed(&self) -> Option<Value> {
        let inner = self.bounds()?;
        let outer = self.outer()?;
        // 32-bit floats of map coordinates would have steps of up to half a metre.
        let centre = 0.5 * (inner[0] + inner[1]);
        let about = |p: &DVec3| *p - centre;
        let steps = Steps { low: about(&outer[0]), high: about(&outer[1]) };
        let surfaces: Vec<Value> = (self.surfaces.iter())
            .map(|surface| {
                // Only the page has fewer triangles; files of the job are complete.
                let fewer = thinned(surface, MAX_TRIANGLES);
                let thinned = fewer.is_some();
                let surface = fewer.as_ref().unwrap_or(surface);
                let positions = surface.positions.iter().flat_map(|p| about(p).to_array()).map(|x| x as f32);
                let mut made = json!({
                    "name": surface.name,
                    "positions": floats(positions),
                    "triangles":
                        packed("u32", surface.triangles.as_flattened().iter().flat_map(|k| k.to_le_bytes())),
                    "fields": surface.fields.iter().map(Field::packed).collect::<Vec<_>>(),
                    "hidden": surface.hidden,
                    "flat": surface.flat,
                    "translucent": surface.translucent,
                    "thinned": thinned,
                });
                // Each set is stored once and named by number, because neighbouring vertices are mostly
                // seen by the same scans.
                if let Some(seen) = &surface.seen_by {
                    made["sets"] = json!({
                        "names": seen.names,
                        "sets": seen.sets,
                        "of_vertex": packed("u32", seen.of_vertex.iter().flat_map(|k| k.to_le_bytes())),
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
                let at = about(&mark.at);
                json!({"at": at, "label": mark.label, "text": mark.text, "normal": mark.normal})
            })
            .collect();
        // The page gets the tables of colours, so that its script has no copy that could differ.
        let maps = Map::ALL
            .iter()
            .map(|map| (map.name().to_owned(), json!(map.colours().map(|c| format!("{c:06x}")))));
        let (from, up) = self.view();
        Some(json!({
            "unit": self.unit,
            "maps": maps.collect::<serde_json::Map<_, _>>(),
            "centre": centre,
            // `low` and `high` determine the view; `steps` is the range of quantised positions. They differ,
            // because outliers can lie far outside.
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

    /// Viewing direction (from the object to the camera) and up direction.
    ///
    /// A sheet is shown from its front, other objects obliquely with z up.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// let (_, up) = planish_report::Scene::default().view();
    /// assert_eq!(up, DVec3::Z);
    /// ```
    #[must_use]
    pub fn view(&self) -> (DVec3, DVec3) {
        let (mut facing, mut area) = (DVec3::ZERO, 0.0);
        for surface in &self.surfaces {
            for t in &surface.triangles {
                let [a, b, c] = t.map(|k| surface.positions[k as usize]);
                let n = (b - a).cross(c - a);
                facing += n;
                area += n.length();
            }
        }
        // Area vectors of a closed surface cancel, so their sum shows whether it faces one way.
        let towards = facing.length();
        if towards <= MIN_FACING * area || area == 0.0 {
            return (OBLIQUE_VIEW, DVec3::Z);
        }
        let n = facing / towards;
        // Up is z unless the sheet faces up or down; then it is y. A slight slant shows the relief.
        let up = if n[2].abs() < 0.9 { DVec3::Z } else { DVec3::Y };
        (n + 0.35 * DVec3::new(0.5, -0.8, 0.4), up)
    }
}

/// Bounding box of the finite points.
fn box_of<'a>(points: impl Iterator<Item = &'a DVec3>) -> Option<[DVec3; 2]> {
    points.filter(|p| p.is_finite()).fold(None, |found: Option<[DVec3; 2]>, p| {
        let [low, high] = found.unwrap_or([*p, *p]);
        Some([low.min(*p), high.max(*p)])
    })
}

/// Quantisation of positions: a box, divided into 65535 steps along each side.
///
/// 16 bits halve the size of the file, and no screen resolves the steps.
struct Steps {
    low: DVec3,
    high: DVec3,
}

impl Steps {
    /// Encodes positions as 16-bit steps.
    fn packed(&self, places: impl Iterator<Item = DVec3>) -> Value {
        let step = |p: DVec3| -> [u16; 3] {
            std::array::from_fn(|d| {
                // A flat scene has no extent along one axis.
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
    /// Encodes the values with their scale. Colours and ticks are computed here, so that pages and images
    /// agree.
    fn packed(&self) -> Value {
        let mut made = json!({"key": self.key, "label": self.label, "unit": self.unit});
        if let Some(shown) = &self.shown {
            made["shown"] = json!(shown);
        }
        match Scale::from_field(self) {
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
            Scale::Own => made["colours"] = json!(true),
        }
        made["values"] = match &self.values {
            // The precision of mesh files, so that a click shows what a file holds (decision 0080).
            Values::Numbers(values) => floats(values.iter().map(|v| *v as f32)),
            Values::Kinds(kinds) => packed("u16", kinds.iter().flat_map(|k| k.to_le_bytes())),
        };
        made
    }
}

/// Encodes values as 32-bit floats.
fn floats(values: impl Iterator<Item = f32>) -> Value {
    packed("f32", values.flat_map(f32::to_le_bytes))
}

/// Encodes little-endian bytes in base64: text that needs no escaping in a script.
fn packed(kind: &str, bytes: impl Iterator<Item = u8>) -> Value {
    // Typed arrays in JavaScript have the byte order of the machine, which is little-endian on all common
    // ones.
    json!({"type": kind, "data": STANDARD.encode(bytes.collect::<Vec<u8>>())})
}
