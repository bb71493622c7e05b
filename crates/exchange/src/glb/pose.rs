//! Writes a textured mesh with poses as one GLB file.
//!
//! The file holds the mesh at rest, a morph target per pose (differences of positions and normals), the
//! picture of the texture and, with keyframes, an animation of the weights.
//!
//! **Limits.** Targets that are applied together add up, which need not give a plausible shape.

use super::write::{ATTRIBUTES, DEFAULT_UNIT, Head, INDICES, Sections, check_floats, node};
use super::{FLOAT, INTEGER, TRIANGLES};
use crate::Unit;
use crate::atomic::write_packed;
use planish_core::DVec3;
use planish_core::vector3::as_arrays;
use planish_estimate::{Error, Result};
use serde_json::{Value, json};
use std::path::Path;

/// A pose of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct MorphTarget {
    /// Its name.
    pub name: String,
    /// Positions in this pose.
    pub points: Vec<DVec3>,
    /// Unit normals in this pose.
    pub normals: Vec<DVec3>,
}

/// Weights of all targets at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframe {
    /// Time in seconds.
    pub seconds: f64,
    /// One weight per target.
    pub weights: Vec<f64>,
}

/// A textured mesh with poses.
#[derive(Debug, Clone, Default)]
pub struct PosedMesh<'a> {
    /// Positions at rest.
    pub points: &'a [DVec3],
    /// Unit normals at rest.
    pub normals: &'a [DVec3],
    /// Indices of the corners of each triangle.
    pub triangles: &'a [[u32; 3]],
    /// Texture coordinates from the lower left, one pair per point; empty for none.
    pub uv: &'a [[f64; 2]],
    /// Linear colours of the points from 0 to 1; empty for none.
    pub colours: &'a [[f64; 3]],
    /// σ of the points along their normals, in the unit of the mesh, for `_SIGMA`; empty for none.
    pub sigma: &'a [f64],
    /// Whether each point was measured, for `_OBSERVED`; empty if unknown.
    pub observed: &'a [u8],
    /// Picture of the texture (PNG or JPEG).
    pub picture: Option<&'a [u8]>,
    /// Poses.
    pub targets: &'a [MorphTarget],
    /// Keyframes in order of time; empty for no animation.
    pub keyframes: &'a [Keyframe],
    /// Unit of length; none means millimetres.
    pub unit: Option<Unit>,
}

/// Writes a textured mesh with poses.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) for columns of unequal length, corners beyond the points,
/// keyframes that are not in order of time or have another number of weights than targets, numbers beyond the
/// range of `float32`, and a picture that is neither PNG nor JPEG;
/// [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for more than 4 GiB;
/// [`Io`](planish_estimate::ErrorKind::Io) when the file cannot be written; nothing is left half-written.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::Unit;
/// use planish_exchange::glb::{PosedMesh, read_mesh, write_posed};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("sheet.glb");
/// write_posed(&path, &PosedMesh {
///     points: &[DVec3::ZERO, DVec3::X, DVec3::Y],
///     normals: &[DVec3::Z; 3],
///     triangles: &[[0, 1, 2]],
///     sigma: &[0.5, 0.5, 0.25],
///     unit: Some(Unit::Metre),
///     ..PosedMesh::default()
/// })?;
/// assert_eq!(read_mesh(&path)?.column("sigma"), Some(&[0.5, 0.5, 0.25][..]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_posed(path: &Path, mesh: &PosedMesh<'_>) -> Result<()> {
    let (head, bytes) =
        check(mesh).and_then(|kind| pack(mesh, kind)).map_err(|e| e.in_context(path.display()))?;
    write_packed(path, |mut writer| {
        head.write_to(&mut writer)?;
        writer.write_all(&bytes)
    })
}

/// Checks lengths, corners and keyframes; returns the media type of the picture.
fn check(mesh: &PosedMesh<'_>) -> Result<Option<&'static str>> {
    let n = mesh.points.len();
    let optional = |length: usize| length == 0 || length == n;
    let equal = mesh.normals.len() == n
        && [mesh.uv.len(), mesh.colours.len(), mesh.sigma.len(), mesh.observed.len()]
            .into_iter()
            .all(optional);
    let poses = (mesh.targets.iter()).all(|t| t.points.len() == n && t.normals.len() == n);
    if n == 0 || mesh.triangles.is_empty() || !equal || !poses {
        return Err(Error::input(
            "expected triangles, and as many normals, texture coordinates, colours, σ and positions of each \
             pose as points",
        ));
    }
    if mesh.triangles.iter().flatten().any(|&corner| corner as usize >= n) {
        return Err(Error::input(format!("expected corners below {n}, the number of points, found another")));
    }
    let mut last = f32::NEG_INFINITY;
    for (k, frame) in mesh.keyframes.iter().enumerate() {
        // glTF requires times that increase strictly, and stores them in single precision.
        let seconds = frame.seconds as f32;
        let later = seconds.is_finite() && frame.seconds >= 0.0 && seconds > last;
        let weights = frame.weights.len() == mesh.targets.len()
            && frame.weights.iter().all(|w| (*w as f32).is_finite());
        if !(later && weights) {
            return Err(Error::input(format!(
                "keyframe {}: expected a time after {last} s and {} weights, found {} s and {}",
                k + 1,
                mesh.targets.len(),
                frame.seconds,
                frame.weights.len()
            )));
        }
        last = seconds;
    }
    match mesh.picture {
        None => Ok(None),
        Some([0x89, b'P', b'N', b'G', ..]) => Ok(Some("image/png")),
        Some([0xff, 0xd8, ..]) => Ok(Some("image/jpeg")),
        Some(_) => Err(Error::input("expected an image in PNG or JPEG, found another format: convert it")),
    }
}

/// The binary chunk under construction.
#[derive(Default)]
struct Chunk {
    sections: Sections,
    bytes: Vec<u8>,
}

impl Chunk {
    fn floats<const N: usize>(&mut self, values: &[[f32; N]], target: Option<u64>, more: Value) -> usize {
        let kind = ["SCALAR", "VEC2", "VEC3"][N - 1];
        self.bytes.extend(values.iter().flatten().flat_map(|value| value.to_le_bytes()));
        self.sections.add(values.len(), 4 * N as u64, target, FLOAT, kind, more)
    }

    /// Appends a picture, which is a section without an accessor.
    fn picture(&mut self, bytes: &[u8]) -> usize {
        self.sections
            .views
            .push(json!({"buffer": 0, "byteOffset": self.sections.length, "byteLength": bytes.len()}));
        self.bytes.extend_from_slice(bytes);
        // Accessors after the picture must start at a multiple of their component size.
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.sections.length = self.bytes.len() as u64;
        self.sections.views.len() - 1
    }
}

fn extremes<const N: usize>(values: &[[f32; N]]) -> Value {
    let pick = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
        (0..N).map(|k| values.iter().map(|v| v[k]).reduce(pick).unwrap_or_default()).collect()
    };
    json!({"min": pick(f32::min), "max": pick(f32::max)})
}

fn single(p: &[f64; 3]) -> [f32; 3] {
    p.map(|x| x as f32)
}

/// Appends the columns of the mesh at rest; returns their accessors by name.
fn attributes(
    chunk: &mut Chunk,
    mesh: &PosedMesh<'_>,
    points: &[[f32; 3]],
) -> Result<serde_json::Map<String, Value>> {
    let normals: Vec<[f32; 3]> = as_arrays(mesh.normals).iter().map(single).collect();
    check_floats("the position", points)?;
    check_floats("the normal", &normals)?;
    let mut attributes = serde_json::Map::new();
    let at = chunk.floats(points, Some(ATTRIBUTES), extremes(points));
    attributes.insert("POSITION".to_owned(), json!(at));
    let at = chunk.floats(&normals, Some(ATTRIBUTES), json!({}));
    attributes.insert("NORMAL".to_owned(), json!(at));
    if !mesh.uv.is_empty() {
        // The origin of glTF texture coordinates is the upper left corner.
        let uv: Vec<[f32; 2]> = mesh.uv.iter().map(|[u, v]| [*u as f32, (1.0 - v) as f32]).collect();
        check_floats("the texture coordinates", &uv)?;
        let at = chunk.floats(&uv, Some(ATTRIBUTES), json!({}));
        attributes.insert("TEXCOORD_0".to_owned(), json!(at));
    }
    if !mesh.colours.is_empty() {
        let colours: Vec<[f32; 3]> = mesh.colours.iter().map(single).collect();
        check_floats("the colour", &colours)?;
        let at = chunk.floats(&colours, Some(ATTRIBUTES), json!({}));
        attributes.insert("COLOR_0".to_owned(), json!(at));
    }
    let sigma: Vec<[f32; 1]> = mesh.sigma.iter().map(|sigma| [*sigma as f32]).collect();
    // Four bytes per mark, because glTF aligns the elements of attributes to four bytes.
    let observed: Vec<[f32; 1]> = mesh.observed.iter().map(|mark| [f32::from(*mark)]).collect();
    for (name, column) in [("_SIGMA", sigma), ("_OBSERVED", observed)] {
        if !column.is_empty() {
            let at = chunk.floats(&column, Some(ATTRIBUTES), json!({}));
            attributes.insert(name.to_owned(), json!(at));
        }
    }
    Ok(attributes)
}

/// Appends the poses; returns the accessors of each.
fn targets(chunk: &mut Chunk, mesh: &PosedMesh<'_>) -> Result<Vec<Value>> {
    let mut targets = Vec::new();
    for target in mesh.targets {
        // glTF morph targets are differences from the mesh at rest.
        let difference = |to: &[DVec3], from: &[DVec3]| -> Vec<[f32; 3]> {
            to.iter().zip(from).map(|(to, from)| single((*to - *from).as_ref())).collect()
        };
        let moved = difference(&target.points, mesh.points);
        let turned = difference(&target.normals, mesh.normals);
        check_floats(&format!("pose `{}`: the displacement", target.name), &moved)?;
        check_floats(&format!("pose `{}`: the normal", target.name), &turned)?;
        let position = chunk.floats(&moved, Some(ATTRIBUTES), extremes(&moved));
        let normal = chunk.floats(&turned, Some(ATTRIBUTES), json!({}));
        targets.push(json!({"POSITION": position, "NORMAL": normal}));
    }
    Ok(targets)
}

fn pack(mesh: &PosedMesh<'_>, picture_kind: Option<&str>) -> Result<(Head, Vec<u8>)> {
    // The middle of the bounds, unlike the mean, minimises the largest coordinate and so its rounding.
    let low = mesh.points.iter().fold(DVec3::MAX, |m, p| m.min(*p));
    let high = mesh.points.iter().fold(DVec3::MIN, |m, p| m.max(*p));
    let center = low + 0.5 * (high - low);
    let mut chunk = Chunk::default();
    // Relative to the middle, single precision resolves the size of the mesh, not its distance from the
    // origin.
    let points: Vec<[f32; 3]> = mesh.points.iter().map(|p| single((*p - center).as_ref())).collect();
    let attributes = attributes(&mut chunk, mesh, &points)?;
    let targets = targets(&mut chunk, mesh)?;
    chunk.bytes.extend(mesh.triangles.iter().flatten().flat_map(|corner| corner.to_le_bytes()));
    let indices =
        (chunk.sections).add(3 * mesh.triangles.len(), 4, Some(INDICES), INTEGER, "SCALAR", json!({}));
    let names: Vec<&str> = mesh.targets.iter().map(|target| target.name.as_str()).collect();
    let mut primitive =
        json!({"attributes": attributes, "indices": indices, "mode": TRIANGLES, "material": 0});
    let mut shape =
        json!({"extras": {"targetNames": names, "unit": mesh.unit.unwrap_or(DEFAULT_UNIT).name()}});
    if !targets.is_empty() {
        primitive["targets"] = json!(targets);
        shape["weights"] = json!(vec![0.0; targets.len()]);
    }
    shape["primitives"] = json!([primitive]);
    let mut surface = json!({"metallicFactor": 0.0, "roughnessFactor": 0.7});
    let mut document = json!({
        "asset": {"version": "2.0", "generator": "Planish"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node(center, mesh.unit)?],
        "meshes": [shape],
    });
    if let Some((bytes, kind)) = mesh.picture.zip(picture_kind) {
        let view = chunk.picture(bytes);
        document["images"] = json!([{"bufferView": view, "mimeType": kind}]);
        document["samplers"] = json!([{"magFilter": 9729, "minFilter": 9987}]);
        document["textures"] = json!([{"source": 0, "sampler": 0}]);
        surface["baseColorTexture"] = json!({"index": 0});
    }
    // Double-sided, because open surfaces are viewed from both sides.
    document["materials"] = json!([{"pbrMetallicRoughness": surface, "doubleSided": true}]);
    if !mesh.keyframes.is_empty() {
        let times: Vec<[f32; 1]> = mesh.keyframes.iter().map(|frame| [frame.seconds as f32]).collect();
        let weights: Vec<[f32; 1]> =
            (mesh.keyframes.iter()).flat_map(|frame| frame.weights.iter().map(|w| [*w as f32])).collect();
        let input = chunk.floats(&times, None, extremes(&times));
        let output = chunk.floats(&weights, None, json!({}));
        document["animations"] = json!([{
            "name": "poses",
            "samplers": [{"input": input, "output": output, "interpolation": "LINEAR"}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
        }]);
    }
    document["accessors"] = json!(chunk.sections.accessors);
    document["bufferViews"] = json!(chunk.sections.views);
    document["buffers"] = json!([{"byteLength": chunk.sections.length}]);
    let head = Head::new(&document, chunk.sections.length).map_err(|total| {
        Error::unsupported(format!("expected a mesh of at most 4 GiB, the limit of GLB, found {total} bytes"))
    })?;
    Ok((head, chunk.bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: [DVec3; 3] =
        [DVec3::new(10.0, 0.0, 0.0), DVec3::new(11.0, 0.0, 0.0), DVec3::new(10.0, 1.0, 0.0)];
    const NORMALS: [DVec3; 3] = [DVec3::Z; 3];
    const SIGMA: [f64; 3] = [0.25, 0.5, 1.0];

    fn posed(
        picture: Option<&'static [u8]>,
        weights: usize,
    ) -> (Result<()>, Vec<u8>, Result<crate::mesh_data::PolygonMesh>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.glb");
        let targets = [MorphTarget {
            name: "up".to_owned(),
            points: POINTS.map(|p| DVec3::new(p.x, p.y, p.z + 2.0)).to_vec(),
            normals: NORMALS.to_vec(),
        }];
        let keyframes = [0.0, 1.5].map(|seconds| Keyframe { seconds, weights: vec![seconds; weights] });
        let made = write_posed(
            &path,
            &PosedMesh {
                points: &POINTS,
                normals: &NORMALS,
                triangles: &[[0, 1, 2]],
                uv: &[[0.0, 0.0], [1.0, 0.0], [0.0, 0.25]],
                sigma: &SIGMA,
                observed: &[1, 0, 1],
                picture,
                targets: &targets,
                keyframes: &keyframes,
                unit: Some(Unit::Millimetre),
                ..PosedMesh::default()
            },
        );
        (made, std::fs::read(&path).unwrap_or_default(), super::super::read_mesh(&path))
    }

    /// Reads the mesh at rest back and finds each section, including the picture, at the stated offset.
    #[test]
    fn poses_and_pictures_are_at_the_stated_offsets() {
        let picture = b"\x89PNG picture".as_slice();
        let (made, bytes, read) = posed(Some(picture), 1);
        made.unwrap();
        let read = read.unwrap();
        // GLB is in metres.
        assert_eq!(read.triangles, [[0, 1, 2]]);
        assert!((read.points[1][0] - read.points[0][0] - 1e-3).abs() < 1e-9);
        for (found, wanted) in read.column("sigma").unwrap().iter().zip(SIGMA) {
            assert!((found / (1e-3 * wanted) - 1.0).abs() < 1e-6);
        }
        assert_eq!(read.column("observed").unwrap(), [1.0, 0.0, 1.0]);
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let document: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        let binary = &bytes[28 + length..];
        let section = |view: &Value| {
            let view = &document["bufferViews"][view.as_u64().unwrap() as usize];
            let [start, count] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap() as usize);
            &binary[start..start + count]
        };
        assert_eq!(section(&document["images"][0]["bufferView"]), picture);
        let accessor = |number: &Value| &document["accessors"][number.as_u64().unwrap() as usize];
        let target = &document["meshes"][0]["primitives"][0]["targets"][0]["POSITION"];
        let moved = section(&accessor(target)["bufferView"]);
        assert_eq!(f32::from_le_bytes(moved[8..12].try_into().unwrap()), 2.0);
        let uv = section(
            &accessor(&document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"])["bufferView"],
        );
        assert_eq!(f32::from_le_bytes(uv[20..24].try_into().unwrap()), 0.75);
        let times = accessor(&document["animations"][0]["samplers"][0]["input"]);
        assert_eq!((&times["min"][0], &times["max"][0]), (&json!(0.0), &json!(1.5)));
    }

    /// A mesh without a unit is in millimetres, like every other file of such a mesh.
    #[test]
    fn lengths_without_a_unit_are_millimetres() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.glb");
        let mesh =
            PosedMesh { points: &POINTS, normals: &NORMALS, triangles: &[[0, 1, 2]], ..PosedMesh::default() };
        write_posed(&path, &mesh).unwrap();
        let read = super::super::read_mesh(&path).unwrap();
        assert!((read.points[1][0] - 0.011).abs() < 1e-9, "{:?}", read.points);
    }

    #[test]
    fn numbers_beyond_single_precision_are_rejected_with_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.glb");
        let mesh =
            PosedMesh { points: &POINTS, normals: &NORMALS, triangles: &[[0, 1, 2]], ..PosedMesh::default() };
        let message = |mesh: &PosedMesh<'_>| {
            let error = write_posed(&path, mesh).unwrap_err().to_string();
            assert!(!path.exists(), "{error}");
            error
        };
        for wrong in [1e39, 1e300, f64::MAX, f64::INFINITY, f64::NAN] {
            let mut points = POINTS;
            points[1].y = wrong;
            let error = message(&PosedMesh { points: &points, ..mesh.clone() });
            assert!(error.contains("the position of vertex") && error.contains("float32"), "{error}");
            let moved =
                MorphTarget { name: "far".to_owned(), points: points.to_vec(), normals: NORMALS.to_vec() };
            let error = message(&PosedMesh { targets: &[moved], ..mesh.clone() });
            assert!(error.contains("pose `far`: the displacement of vertex 2"), "{error}");
            let normals = [DVec3::Z, DVec3::Z, DVec3::splat(wrong)];
            let turned =
                MorphTarget { name: "far".to_owned(), points: POINTS.to_vec(), normals: normals.to_vec() };
            let error = message(&PosedMesh { targets: &[turned], ..mesh.clone() });
            assert!(error.contains("pose `far`: the normal of vertex 3"), "{error}");
            let error = message(&PosedMesh { uv: &[[0.0; 2], [0.0; 2], [wrong, 0.0]], ..mesh.clone() });
            assert!(error.contains("the texture coordinates of vertex 3"), "{error}");
            let up =
                MorphTarget { name: "up".to_owned(), points: POINTS.to_vec(), normals: NORMALS.to_vec() };
            for frame in [
                Keyframe { seconds: wrong, weights: vec![0.0] },
                Keyframe { seconds: 1.0, weights: vec![wrong] },
            ] {
                let keyframes = [Keyframe { seconds: 0.0, weights: vec![0.0] }, frame];
                let targets = [up.clone()];
                let error = message(&PosedMesh { targets: &targets, keyframes: &keyframes, ..mesh.clone() });
                assert!(error.contains("keyframe 2"), "{error}");
            }
        }
        // All positions are near each other, but the translation of the node is too large.
        let far = POINTS.map(|p| p + DVec3::splat(1e300));
        assert!(message(&PosedMesh { points: &far, ..mesh.clone() }).contains("the middle of the mesh"));
        // Equal in single precision.
        let keyframes = [1.0, 1.0 + 1e-9].map(|seconds| Keyframe { seconds, weights: Vec::new() });
        assert!(message(&PosedMesh { keyframes: &keyframes, ..mesh }).contains("keyframe 2"));
    }

    #[test]
    fn inconsistent_input_is_rejected() {
        assert!(posed(Some(b"GIF89a"), 1).0.unwrap_err().to_string().contains("PNG or JPEG"));
        assert!(posed(None, 2).0.unwrap_err().to_string().contains("keyframe 1: expected a time"));
    }
}
