//! Writes meshes as GLB files.

use planish_core::DVec3;
use planish_core::vector3::coordinates;
use std::io::{self, Write};
use std::path::Path;

use planish_estimate::{Error, Result};
use serde_json::{Value, json};

use super::{BINARY_CHUNK, BYTE, FLOAT, INTEGER, JSON_CHUNK, MAGIC, TRIANGLES};
use crate::Unit;
use crate::atomic::write_packed;
use crate::mesh_data::MeshColumns;

/// The colour map Viridis at five equidistant places, as linear colours, which glTF prescribes for `COLOR_0`.
const RAMP: [DVec3; 5] = [
    DVec3::new(0.058, 0.000, 0.089),
    DVec3::new(0.044, 0.084, 0.258),
    DVec3::new(0.015, 0.282, 0.262),
    DVec3::new(0.110, 0.584, 0.122),
    DVec3::new(0.984, 0.799, 0.018),
];
/// Colour of unmeasured parts.
const GREY: DVec3 = DVec3::new(0.3, 0.3, 0.3);

/// Writes a mesh with its normals, the columns `sigma` and `observed`, and colours that show them. Other
/// columns are not written. Without a unit, lengths are millimetres.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) for columns of unequal length, corners beyond the points, or
/// no points; [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for more than 4 GiB;
/// [`Io`](planish_estimate::ErrorKind::Io) when the file cannot be written; nothing is left half-written.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::Unit;
/// use planish_exchange::glb::{read_mesh, write_mesh};
/// use planish_exchange::mesh::MeshColumns;
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("sheet.glb");
/// write_mesh(&path, &MeshColumns {
///     points: &[DVec3::ZERO, 1000.0 * DVec3::X, 1000.0 * DVec3::Y],
///     triangles: &[[0, 1, 2]],
///     unit: Some(Unit::Millimetre),
///     ..MeshColumns::default()
/// })?;
/// // glTF is in metres.
/// let mesh = read_mesh(&path)?;
/// assert_eq!((mesh.points[1], mesh.unit), (DVec3::X, Some(Unit::Metre)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_mesh(path: &Path, mesh: &MeshColumns) -> Result<()> {
    let layout =
        mesh.check(true).and_then(|()| Layout::new(mesh)).map_err(|e| e.in_context(path.display()))?;
    write_packed(path, |mut writer| write_to(&mut writer, mesh, &layout))
}

/// Header of a file and the origin of its positions.
pub(super) struct Layout {
    center: DVec3,
    head: Head,
}

/// Everything before the bytes of the binary chunk.
pub(super) struct Head {
    json: Vec<u8>,
    binary: u32,
    total: u32,
}

impl Head {
    /// Creates the header of a file with a JSON document and `binary` bytes of data.
    ///
    /// # Errors
    /// The length of the file, if it does not fit into the 32 bits of the format.
    pub(super) fn new(document: &Value, binary: u64) -> std::result::Result<Self, u64> {
        // The keys of a `Value` are sorted, so the same mesh gives the same bytes.
        let mut json = document.to_string().into_bytes();
        // Chunks are aligned to four bytes; JSON is padded with blanks (section 4.4.3.2).
        json.resize(json.len().next_multiple_of(4), b' ');
        let total = 12 + 8 + json.len() as u64 + 8 + binary;
        Ok(Self { json, binary: binary as u32, total: u32::try_from(total).map_err(|_| total)? })
    }

    pub(super) fn write_to(&self, writer: &mut impl Write) -> io::Result<()> {
        writer.write_all(&MAGIC)?;
        writer.write_all(&2_u32.to_le_bytes())?;
        writer.write_all(&self.total.to_le_bytes())?;
        writer.write_all(&(self.json.len() as u32).to_le_bytes())?;
        writer.write_all(&JSON_CHUNK)?;
        writer.write_all(&self.json)?;
        writer.write_all(&self.binary.to_le_bytes())?;
        writer.write_all(&BINARY_CHUNK)
    }
}

/// Consecutive sections of the binary chunk, and their accessors.
#[derive(Default)]
pub(super) struct Sections {
    pub views: Vec<Value>,
    pub accessors: Vec<Value>,
    pub length: u64,
}

impl Sections {
    /// Adds a section of `count` elements of `bytes` each; returns the index of its accessor. `target` is the
    /// purpose of a section that belongs to a mesh.
    pub(super) fn add(
        &mut self,
        count: usize,
        bytes: u64,
        target: Option<u64>,
        number: u64,
        kind: &str,
        more: Value,
    ) -> usize {
        let length = count as u64 * bytes;
        let mut view = json!({"buffer": 0, "byteOffset": self.length, "byteLength": length});
        if let (Some(view), Some(target)) = (view.as_object_mut(), target) {
            view.insert("target".to_owned(), json!(target));
        }
        self.views.push(view);
        let view = self.views.len() - 1;
        let mut accessor = json!({"bufferView": view, "componentType": number, "count": count, "type": kind});
        if let (Some(accessor), Value::Object(more)) = (accessor.as_object_mut(), more) {
            accessor.extend(more);
        }
        self.accessors.push(accessor);
        self.length += length;
        self.accessors.len() - 1
    }
}

/// Unit of models that state none, as for all commands.
pub(super) const DEFAULT_UNIT: Unit = Unit::Millimetre;

/// The node of a mesh in `unit` whose positions are relative to `center`: converts them to metres.
///
/// # Errors
/// `Input` if the centre is beyond the range of `float32`, which readers of glTF use for transforms.
pub(super) fn node(center: DVec3, unit: Option<Unit>) -> Result<Value> {
    let scale = unit.unwrap_or(DEFAULT_UNIT).millimetres() / 1000.0;
    let translation = (center * scale).to_array();
    check_floats("the middle of the mesh", &[translation.map(|c| c as f32)])?;
    Ok(json!({"mesh": 0, "translation": translation, "scale": [scale, scale, scale]}))
}

/// Refuses numbers that became infinite in `float32`, or were not finite before (glTF 2.0, section 3.6.2.2).
///
/// # Errors
/// `Input` with the index of the first such element, counted from 1.
pub(super) fn check_floats<const N: usize>(what: &str, values: &[[f32; N]]) -> Result<()> {
    match values.iter().position(|value| value.iter().any(|number| !number.is_finite())) {
        None => Ok(()),
        Some(at) => Err(Error::input(format!(
            "{what}{}: expected finite numbers in the range of float32 (up to 3.4e38), found another",
            if values.len() > 1 { format!(" of vertex {}", at + 1) } else { String::new() }
        ))),
    }
}

/// Targets of buffer views: vertex attributes and indices.
pub(super) const ATTRIBUTES: u64 = 34962;
pub(super) const INDICES: u64 = 34963;

/// A position relative to the centre, as it is written.
fn local(point: DVec3, center: DVec3) -> [f32; 3] {
    (point - center).to_array().map(|c| c as f32)
}

impl Layout {
    /// Lays out a checked mesh.
    ///
    /// # Errors
    /// `Input` for an empty mesh, coordinates beyond `float32`, or a file too long for the format.
    pub(super) fn new(mesh: &MeshColumns) -> Result<Self> {
        if mesh.points.is_empty() || mesh.triangles.is_empty() {
            return Err(Error::input("expected points and triangles, found none"));
        }
        let extreme = |pick: fn(f64, f64) -> f64| {
            let first = mesh.points[0];
            mesh.points.iter().fold(first, |m, p| DVec3::from_array([0, 1, 2].map(|k| pick(m[k], p[k]))))
        };
        let (low, high) = (extreme(f64::min), extreme(f64::max));
        let center = low + 0.5 * (high - low);
        // Rounding to `f32` is monotonic, so the rounded bounds are the bounds of the rounded positions.
        let bounds = json!({"min": local(low, center), "max": local(high, center)});
        let positions: Vec<[f32; 3]> = mesh.points.iter().map(|point| local(*point, center)).collect();
        check_floats("the position", &positions)?;
        let n = mesh.points.len();
        // One section per column in the order in which `write_to` writes them, which alone defines their
        // offsets.
        let mut sections = Sections::default();
        let mut attributes = serde_json::Map::new();
        let position = sections.add(n, 12, Some(ATTRIBUTES), FLOAT, "VEC3", bounds);
        attributes.insert("POSITION".to_owned(), json!(position));
        if mesh.normals.is_some() {
            let normal = sections.add(n, 12, Some(ATTRIBUTES), FLOAT, "VEC3", json!({}));
            attributes.insert("NORMAL".to_owned(), json!(normal));
        }
        if mesh.column("sigma").is_some() {
            // Opaque, but with a fourth byte, because glTF aligns the elements of attributes to four bytes.
            let colour = sections.add(n, 4, Some(ATTRIBUTES), BYTE, "VEC4", json!({"normalized": true}));
            attributes.insert("COLOR_0".to_owned(), json!(colour));
        }
        for (column, name) in [("sigma", "_SIGMA"), ("observed", "_OBSERVED")] {
            if mesh.column(column).is_some() {
                let accessor = sections.add(n, 4, Some(ATTRIBUTES), FLOAT, "SCALAR", json!({}));
                attributes.insert(name.to_owned(), json!(accessor));
            }
        }
        let indices = sections.add(3 * mesh.triangles.len(), 4, Some(INDICES), INTEGER, "SCALAR", json!({}));
        let unit = mesh.unit.unwrap_or(DEFAULT_UNIT).name();
        let document = json!({
            "asset": {"version": "2.0", "generator": "Planish"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [node(center, mesh.unit)?],
            "meshes": [{
                "primitives": [{
                    "attributes": attributes, "indices": indices, "mode": TRIANGLES, "material": 0,
                }],
                "extras": {"unit": unit},
            }],
            "materials": [{
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7},
                "doubleSided": true,
            }],
            "accessors": sections.accessors,
            "bufferViews": sections.views,
            "buffers": [{"byteLength": sections.length}],
        });
        let head = Head::new(&document, sections.length).map_err(|total| {
            Error::unsupported(format!(
                "expected a mesh of at most 4 GiB, the limit of GLB, found {total} bytes: write PLY instead"
            ))
        })?;
        Ok(Self { center, head })
    }
}

pub(super) fn write_to(writer: &mut impl Write, mesh: &MeshColumns, layout: &Layout) -> io::Result<()> {
    layout.head.write_to(writer)?;
    for point in mesh.points {
        for c in local(*point, layout.center) {
            writer.write_all(&c.to_le_bytes())?;
        }
    }
    for c in mesh.normals.iter().copied().flat_map(coordinates) {
        writer.write_all(&(*c as f32).to_le_bytes())?;
    }
    for colour in colours(mesh) {
        let [r, g, b] = colour.to_array().map(|c| (255.0 * c).round() as u8);
        writer.write_all(&[r, g, b, 255])?;
    }
    for column in ["sigma", "observed"].iter().filter_map(|name| mesh.column(name)) {
        for vertex in 0..mesh.points.len() {
            writer.write_all(&(column.at(vertex) as f32).to_le_bytes())?;
        }
    }
    for corner in mesh.triangles.iter().flatten() {
        writer.write_all(&corner.to_le_bytes())?;
    }
    Ok(())
}

/// Colours of the vertices; none without σ.
fn colours<'a>(mesh: &'a MeshColumns) -> impl Iterator<Item = DVec3> + 'a {
    let sigma = mesh.column("sigma");
    let observed = mesh.column("observed");
    // Completed parts (2) count as measured for the colour; only prior-only parts (0) are grey.
    let measured = move |vertex: usize| observed.is_none_or(|o| o.at(vertex) != 0.0);
    let count = if sigma.is_some() { mesh.points.len() } else { 0 };
    // σ spans decades, so the colours show its logarithm; zero is replaced by the smallest number.
    let log = move |vertex: usize| sigma.map_or(0.0, |s| s.at(vertex).max(f64::MIN_POSITIVE).ln());
    let mut known: Vec<f64> = (0..count).filter(|&v| measured(v)).map(log).collect();
    known.sort_unstable_by(f64::total_cmp);
    // Quantiles instead of extremes, so that a few outliers do not use up the colour range.
    let quantile = |share: f64| known.get((share * known.len() as f64) as usize).copied().unwrap_or(0.0);
    let (low, high) = (quantile(0.02), quantile(0.98));
    (0..count).map(move |vertex| {
        if !measured(vertex) {
            return GREY;
        }
        // Equal σ at all vertices would give 0/0.
        ramp((log(vertex) - low) / (high - low).max(f64::MIN_POSITIVE))
    })
}

/// Colour of the map at a share from 0 (dark violet) to 1 (yellow), as linear red, green and blue. Shares
/// outside this range have the colours of the ends.
///
/// # Examples
/// ```
/// use planish_exchange::glb::ramp;
/// assert_eq!(ramp(-1.0), ramp(0.0));
/// assert!(ramp(1.0)[0] > ramp(0.0)[0]);
/// ```
#[must_use]
pub fn ramp(share: f64) -> DVec3 {
    let place = share.clamp(0.0, 1.0);
    let place = if place.is_nan() { 0.0 } else { 4.0 * place };
    let cell = (place as usize).min(3);
    let share = place - cell as f64;
    RAMP[cell] + share * (RAMP[cell + 1] - RAMP[cell])
}
