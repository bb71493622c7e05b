//! Writes a mesh whose shape and colours change in time as one GLB file.
//!
//! The file holds the last frame as a mesh, each earlier frame as a morph target (differences of positions,
//! normals and colours), and one animation of the weights. Viewers without animation show the last frame.
//!
//! **Limits.** Viewers need not animate colours: glTF 2.0 allows morph targets of `COLOR_0` (section
//! 3.7.2.2), but does not require viewers to support them.

use super::write::{ATTRIBUTES, DEFAULT_UNIT, Head, INDICES, Sections, check_floats, node};
use super::{FLOAT, INTEGER, TRIANGLES};
use crate::Unit;
use crate::atomic::write_packed;
use planish_core::vector3::as_arrays;
use planish_core::{BoundingBox, DVec3};
use planish_estimate::{Error, Result};
use serde_json::{Value, json};
use std::io::{self, Write};
use std::path::Path;

/// A mesh at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshFrame {
    /// Short description.
    pub name: String,
    /// Positions, in the unit of the mesh.
    pub points: Vec<DVec3>,
    /// Unit normals.
    pub normals: Vec<DVec3>,
    /// Linear colours from 0 to 1.
    pub colours: Vec<[f64; 3]>,
}

/// A column of a frame as it is written.
type Column = Vec<[f32; 3]>;

/// Writes frames with common triangles as one animated mesh, one frame per `seconds_per_frame`. Without a
/// unit, lengths are millimetres.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) for fewer than two frames, frames of unequal length, corners
/// beyond the points or a time that is not positive;
/// [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for more than 4 GiB;
/// [`Io`](planish_estimate::ErrorKind::Io) when the file cannot be written; nothing is left half-written.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::Unit;
/// use planish_exchange::glb::{MeshFrame, write_animation};
/// # let folder = tempfile::tempdir()?;
/// let frame = |height: f64| MeshFrame {
///     name: format!("z = {height}"),
///     points: vec![height * DVec3::Z, DVec3::X, DVec3::Y],
///     normals: vec![DVec3::Z; 3],
///     colours: vec![[0.5; 3]; 3],
/// };
/// let path = folder.path().join("rise.glb");
/// write_animation(&path, &[frame(0.0), frame(1.0)], &[[0, 1, 2]], Some(Unit::Metre), 0.5)?;
/// // Readers that ignore animations see the last frame.
/// assert_eq!(planish_exchange::glb::read_mesh(&path)?.points[0], DVec3::Z);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_animation(
    path: &Path,
    frames: &[MeshFrame],
    triangles: &[[u32; 3]],
    unit: Option<Unit>,
    seconds_per_frame: f64,
) -> Result<()> {
    let animation = Animation::new(frames, triangles, unit, seconds_per_frame)
        .map_err(|e| e.in_context(path.display()))?;
    write_packed(path, |mut writer| animation.write_to(&mut writer, triangles))
}

struct Animation {
    head: Head,
    /// The last frame, then the other ones as differences from it.
    columns: Vec<Column>,
    times: Vec<f32>,
    weights: Vec<f32>,
}

impl Animation {
    fn new(frames: &[MeshFrame], triangles: &[[u32; 3]], unit: Option<Unit>, seconds: f64) -> Result<Self> {
        let Some((last, earlier)) = frames.split_last().filter(|(_, earlier)| !earlier.is_empty()) else {
            return Err(Error::input(format!(
                "expected at least two frames for an animation, found {}",
                frames.len()
            )));
        };
        let n = last.points.len();
        let fits = |f: &MeshFrame| f.points.len() == n && f.normals.len() == n && f.colours.len() == n;
        if n == 0 || triangles.is_empty() || !frames.iter().all(fits) {
            return Err(Error::input(
                "expected frames of one mesh with as many normals and colours as points",
            ));
        }
        if triangles.iter().flatten().any(|&corner| corner as usize >= n) {
            return Err(Error::input(format!(
                "expected corners below {n}, the number of points, found another"
            )));
        }
        if !(seconds > 0.0 && seconds.is_finite()) {
            return Err(Error::input(format!("expected a positive time per frame, found {seconds} s")));
        }
        let centre =
            BoundingBox::from_points(&last.points).map_or(DVec3::ZERO, |b| b.min + 0.5 * (b.max - b.min));
        let mut columns: Vec<Column> = vec![
            last.points.iter().map(|p| (*p - centre).to_array().map(|c| c as f32)).collect(),
            last.normals.iter().map(|n| n.to_array().map(|c| c as f32)).collect(),
            last.colours.iter().map(|c| c.map(|c| c as f32)).collect(),
        ];
        // Computed in double precision and rounded once.
        let differences = |from: &[[f64; 3]], to: &[[f64; 3]]| -> Column {
            to.iter().zip(from).map(|(to, from)| [0, 1, 2].map(|k| (to[k] - from[k]) as f32)).collect()
        };
        for frame in earlier {
            columns.push(differences(as_arrays(&last.points), as_arrays(&frame.points)));
            columns.push(differences(as_arrays(&last.normals), as_arrays(&frame.normals)));
            columns.push(differences(&last.colours, &frame.colours));
        }
        for (column, what) in columns.iter().zip(["the position", "the normal", "the colour"].iter().cycle())
        {
            check_floats(what, column)?;
        }
        let targets = earlier.len();
        let times: Vec<f32> = (0..frames.len()).map(|k| (seconds * k as f64) as f32).collect();
        // At the time of frame k, target k has weight 1; at the end all weights are 0, which is the mesh
        // itself.
        let weights: Vec<f32> = (0..frames.len())
            .flat_map(|k| (0..targets).map(move |target| if target == k { 1.0 } else { 0.0 }))
            .collect();

        let mut sections = Sections::default();
        let attributes: Vec<Value> = columns
            .chunks_exact(3)
            .map(|columns| {
                let [position, normal, colour] = [0, 1, 2].map(|k| {
                    let more = if k == 0 { extremes(&columns[0]) } else { json!({}) };
                    sections.add(n, 12, Some(ATTRIBUTES), FLOAT, "VEC3", more)
                });
                json!({"POSITION": position, "NORMAL": normal, "COLOR_0": colour})
            })
            .collect();
        let indices = sections.add(3 * triangles.len(), 4, Some(INDICES), INTEGER, "SCALAR", json!({}));
        let end = json!({"min": [times[0]], "max": [times[times.len() - 1]]});
        let input = sections.add(times.len(), 4, None, FLOAT, "SCALAR", end);
        let output = sections.add(weights.len(), 4, None, FLOAT, "SCALAR", json!({}));
        let names: Vec<&str> = earlier.iter().map(|frame| frame.name.as_str()).collect();
        let document = json!({
            "asset": {"version": "2.0", "generator": "Planish"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [node(centre, unit)?],
            "meshes": [{
                "primitives": [{
                    "attributes": attributes[0], "targets": attributes[1..], "indices": indices,
                    "mode": TRIANGLES, "material": 0,
                }],
                "weights": vec![0.0; targets],
                "extras": {"targetNames": names, "unit": unit.unwrap_or(DEFAULT_UNIT).name()},
            }],
            "materials": [{
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7},
                "doubleSided": true,
            }],
            "animations": [{
                "name": "forming",
                "samplers": [{"input": input, "output": output, "interpolation": "LINEAR"}],
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
            }],
            "accessors": sections.accessors,
            "bufferViews": sections.views,
            "buffers": [{"byteLength": sections.length}],
        });
        let head = Head::new(&document, sections.length).map_err(|total| {
            Error::unsupported(format!(
                "expected an animation of at most 4 GiB, the limit of GLB, found {total} bytes"
            ))
        })?;
        Ok(Self { head, columns, times, weights })
    }

    fn write_to(&self, writer: &mut impl Write, triangles: &[[u32; 3]]) -> io::Result<()> {
        self.head.write_to(writer)?;
        // In the order in which `new` added the sections: it alone defines their offsets.
        for c in self.columns.iter().flatten().flatten() {
            writer.write_all(&c.to_le_bytes())?;
        }
        for corner in triangles.iter().flatten() {
            writer.write_all(&corner.to_le_bytes())?;
        }
        for number in self.times.iter().chain(&self.weights) {
            writer.write_all(&number.to_le_bytes())?;
        }
        Ok(())
    }
}

/// Minimum and maximum of each coordinate as written; glTF requires them for positions (section 3.6.2.5).
fn extremes(column: &Column) -> Value {
    let pick = |pick: fn(f32, f32) -> f32| -> [f32; 3] {
        (column.iter()).fold(column[0], |m, p| std::array::from_fn(|k| pick(m[k], p[k])))
    };
    json!({"min": pick(f32::min), "max": pick(f32::max)})
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(height: f64) -> MeshFrame {
        MeshFrame {
            name: format!("{height}"),
            points: vec![
                DVec3::new(10.0, 0.0, height),
                DVec3::new(11.0, 0.0, 0.0),
                DVec3::new(10.0, 1.0, 0.0),
            ],
            normals: vec![DVec3::Z; 3],
            colours: vec![[height, 0.5, 0.0]; 3],
        }
    }

    #[test]
    fn each_earlier_frame_is_a_target_with_weight_one_at_its_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("forming.glb");
        let frames = [frame(0.0), frame(0.25), frame(0.5)];
        write_animation(&path, &frames, &[[0, 1, 2]], Some(Unit::Millimetre), 0.5).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let number =
            |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize;
        assert_eq!(number(8), bytes.len());
        let json: Value = serde_json::from_slice(&bytes[20..20 + number(12)]).unwrap();
        let binary = 20 + number(12) + 8;
        let floats = |accessor: &Value| -> Vec<f32> {
            let accessor = &json["accessors"][accessor.as_u64().unwrap() as usize];
            let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
            let from = binary + view["byteOffset"].as_u64().unwrap() as usize;
            let length = view["byteLength"].as_u64().unwrap() as usize;
            bytes[from..from + length]
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect()
        };
        let primitive = &json["meshes"][0]["primitives"][0];
        let targets = primitive["targets"].as_array().unwrap();
        assert_eq!(targets.len(), 2);
        let base = floats(&primitive["attributes"]["POSITION"]);
        let first = floats(&targets[0]["POSITION"]);
        // Base plus target is the first frame, relative to the middle of the last.
        assert_eq!(base[2] + first[2], -0.25);
        assert_eq!(floats(&targets[1]["COLOR_0"])[0], -0.25);
        let sampler = &json["animations"][0]["samplers"][0];
        assert_eq!(floats(&sampler["input"]), [0.0, 0.5, 1.0]);
        assert_eq!(floats(&sampler["output"]), [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        let mesh = crate::glb::read_mesh(&path).unwrap();
        assert_eq!(mesh.points.len(), 3);
    }

    #[test]
    fn one_frame_is_rejected() {
        let error = write_animation("x.glb".as_ref(), &[frame(0.0)], &[[0, 1, 2]], None, 0.5).unwrap_err();
        assert!(error.to_string().contains("at least two frames for an animation, found 1"), "{error}");
    }
}
