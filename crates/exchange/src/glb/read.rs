//! Reads meshes from GLB files.

use planish_core::{Budget, DVec3};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::Scan;
use serde_json::Value;

use super::{BINARY_CHUNK, BYTE, FLOAT, INTEGER, JSON_CHUNK, MAGIC, SHORT, TRIANGLES};
use crate::Unit;
use crate::appearance::{TexturedMesh, display_value};
use crate::mesh_data::{PolygonMesh, scan_of_vertices};
use crate::numbers::NumberType;
use crate::source::{DATA_RATIO, Source, read_file};

/// Maximum depth of the tree of nodes. glTF forbids cycles; the limit finds them.
const MAX_DEPTH: usize = 64;
/// Maximum number of visited nodes. A node that is referred to twice at each of 40 levels would be visited
/// 2⁴⁰ times. Guarded by `endless_copies_are_rejected`.
const MAX_NODES: usize = 100_000;

/// Maximum ratio of vertices to those that the file can hold: nodes may repeat a mesh, and a small file must
/// not fill the memory.
const MAX_COPIES: usize = 256;
/// Number of vertices that is accepted at any ratio.
const ALWAYS_ALLOWED_VERTICES: usize = 1 << 20;

/// Reads all triangles of the default scene, in metres.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable;
/// [`Input`](planish_estimate::ErrorKind::Input) when it is malformed, cut off, or has an invalid reference:
/// with the file and the accessor or node; [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for
/// geometry in other files, compressed, sparse or quantised.
pub fn read_mesh(path: &Path) -> Result<PolygonMesh> {
    read_file(path, |mut source, _| mesh_from(&mut source))
}

/// Reads all triangles with their texture coordinates (`TEXCOORD_0`) and the base-colour picture of the most
/// triangles.
///
/// Vertices at the same position are merged, because glTF splits vertices at seams of the texture.
pub(crate) fn read_textured(path: &Path) -> Result<TexturedMesh> {
    let (mesh, picture) = read_file(path, |mut source, _| textured_from(&mut source))?;
    Ok(welded(mesh, picture))
}

/// Reads the vertices as points.
pub(crate) fn read_scan(path: &Path) -> Result<(Scan, Option<Unit>)> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mesh = read_mesh(path)?;
    let normals: Vec<(String, Vec<f64>)> =
        mesh.columns.into_iter().filter(|(name, _)| name.starts_with('n')).collect();
    let scan = scan_of_vertices(mesh.points.into_iter(), &normals, &name, &Budget::of_process())
        .map_err(|e| e.in_context(path.display()))?;
    Ok((scan, mesh.unit))
}

/// Temporary columns of texture coordinates between reading and merging.
const UV: [&str; 2] = ["TEXCOORD_0 u", "TEXCOORD_0 v"];

pub(super) fn mesh_from<R: Read>(source: &mut Source<R>) -> Result<PolygonMesh> {
    with_file(source, |file| file.mesh(false).map(|(mesh, _)| mesh))
}

fn textured_from<R: Read>(source: &mut Source<R>) -> Result<(PolygonMesh, Option<Vec<u8>>)> {
    with_file(source, |file| {
        let (mesh, materials) = file.mesh(true)?;
        // One picture only, because `TexturedMesh` has one texture.
        let largest = (materials.iter())
            .filter_map(|(material, count)| file.picture(*material).map(|picture| (*count, picture)))
            .max_by_key(|(count, _)| *count);
        Ok((mesh, largest.map(|(_, picture)| picture.to_vec())))
    })
}

fn welded(mut mesh: PolygonMesh, picture: Option<Vec<u8>>) -> TexturedMesh {
    let mut uv = Vec::new();
    if let [Some(u), Some(v)] = UV.map(|name| mesh.column(name)) {
        // The origin of glTF texture coordinates is the upper left corner.
        uv = u.iter().zip(v).map(|(u, v)| [*u, 1.0 - v]).collect();
    }
    mesh.columns.retain(|(name, _)| !UV.contains(&name.as_str()));
    if uv.is_empty() {
        return TexturedMesh {
            points: mesh.points,
            triangles: mesh.triangles,
            columns: mesh.columns,
            unit: mesh.unit,
            ..TexturedMesh::default()
        };
    }
    let mut places: BTreeMap<[u64; 3], u32> = BTreeMap::new();
    let (mut kept, mut new) = (Vec::new(), Vec::with_capacity(mesh.points.len()));
    // The first vertex at a position keeps its columns; copies differ only in texture coordinates.
    for (vertex, point) in mesh.points.iter().enumerate() {
        // Adding zero turns −0 into +0, so that both are one position.
        let place = point.to_array().map(|x| (x + 0.0).to_bits());
        new.push(*places.entry(place).or_insert_with(|| {
            kept.push(vertex);
            kept.len() as u32 - 1
        }));
    }
    let selected = |column: &[f64]| kept.iter().map(|v| column[*v]).collect();
    TexturedMesh {
        points: kept.iter().map(|v| mesh.points[*v]).collect(),
        triangles: (mesh.triangles.iter()).map(|t| t.map(|v| new[v as usize])).collect(),
        uv,
        uv_triangles: mesh.triangles,
        picture,
        columns: (mesh.columns.iter()).map(|(name, column)| (name.clone(), selected(column))).collect(),
        unit: mesh.unit,
        ..TexturedMesh::default()
    }
}

fn with_file<R: Read, T>(source: &mut Source<R>, take: impl FnOnce(File<'_>) -> Result<T>) -> Result<T> {
    let header = source.bytes(12)?.map(<[u8]>::to_vec).unwrap_or_default();
    if !header.starts_with(&MAGIC) {
        return Err(Error::input("byte 0: expected `glTF`: not a GLB file, or cut off"));
    }
    // The total length behind it is not used: the lengths of the chunks are checked instead.
    let version = NumberType::U32.decode::<false>(&header[4..8]);
    if version != 2.0 {
        return Err(Error::unsupported(format!("byte 4: expected version 2 of glTF, found {version}")));
    }
    let json = chunk(source, JSON_CHUNK)?;
    // The tree of the document takes some 24 bytes per byte of its text.
    let length = json.len() as u64;
    Budget::of_compressed(length, DATA_RATIO).take_elements(length, 24, "bytes of JSON")?;
    // Untyped, so that malformed parts that are not needed, such as cameras, do not prevent reading the mesh.
    let document: Value = serde_json::from_slice(&json)
        .map_err(|e| Error::input(format!("the JSON chunk is malformed (line {} of it): {e}", e.line())))?;
    // The text is as large as the document, so it is freed before the binary chunk is read.
    drop(json);
    if let Some(extension) = document["extensionsRequired"].as_array().and_then(|names| names.first()) {
        return Err(Error::unsupported(format!(
            "the file requires the extension {extension}, which is not supported: export it without \
             compression and quantisation"
        )));
    }
    // The binary chunk is optional (section 4.4.3.3), and chunks behind it are ignored.
    let binary = match source.peek(1)?.is_empty() {
        true => Vec::new(),
        false => chunk(source, BINARY_CHUNK)?,
    };
    // Nodes may repeat a mesh, so that a small file describes a large scene.
    let budget = Budget::of_compressed(binary.len() as u64, DATA_RATIO);
    take(File { document: &document, binary: &binary, budget })
}

/// Reads the next chunk, which must have the given type.
fn chunk<R: Read>(source: &mut Source<R>, wanted: [u8; 4]) -> Result<Vec<u8>> {
    let byte = source.offset();
    let name = String::from_utf8_lossy(&wanted[..3]).into_owned();
    let cut_off = |n: u64| {
        Error::input(format!(
            "byte {byte}: the file ends inside the {n} bytes of its {name} chunk: it is cut off"
        ))
    };
    let head = source.bytes(8)?.ok_or_else(|| cut_off(8))?;
    if head[4..8] != wanted {
        return Err(Error::input(format!("byte {byte}: expected a {name} chunk, found another type")));
    }
    let length = NumberType::U32.decode::<false>(&head[..4]) as u64;
    source.check_promise(length, format_args!("bytes in its {name} chunk"), length)?;
    Ok(source.bytes(length as usize)?.ok_or_else(|| cut_off(length))?.to_vec())
}

/// An affine map: the columns of its matrix, and a translation.
#[derive(Clone, Copy)]
struct Transform {
    columns: [DVec3; 3],
    translation: DVec3,
}

impl Transform {
    const IDENTITY: Self = Self { columns: [DVec3::X, DVec3::Y, DVec3::Z], translation: DVec3::ZERO };

    fn rotate(&self, v: DVec3) -> DVec3 {
        let [a, b, c] = self.columns;
        a * v[0] + b * v[1] + c * v[2]
    }

    fn apply(&self, p: DVec3) -> DVec3 {
        let q = self.rotate(p);
        q + self.translation
    }

    /// Composition that applies `inner` first.
    fn after(&self, inner: &Self) -> Self {
        Self { columns: inner.columns.map(|c| self.rotate(c)), translation: self.apply(inner.translation) }
    }

    fn determinant(&self) -> f64 {
        let [a, b, c] = self.columns;
        a.dot(b.cross(c))
    }

    /// Transforms a unit normal by the matrix of cofactors, which keeps it perpendicular to a stretched
    /// surface. Unlike the inverse transpose, it needs no division by a determinant that may be zero.
    fn normal(&self, n: DVec3) -> DVec3 {
        let [a, b, c] = self.columns;
        let sign = self.determinant().signum();
        let (x, y, z) = (b.cross(c), c.cross(a), a.cross(b));
        let carried = sign * (x * n[0] + y * n[1] + z * n[2]);
        carried.normalize_or_zero()
    }
}

struct File<'a> {
    document: &'a Value,
    binary: &'a [u8],
    budget: Budget,
}

/// Columns and the attributes that store them.
const COLUMNS: [(&str, &str); 2] = [("sigma", "_SIGMA"), ("observed", "_OBSERVED")];

fn index(value: &Value) -> Option<usize> {
    value.as_u64().and_then(|v| usize::try_from(v).ok())
}

fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let array = value.as_array().filter(|a| a.len() == N)?;
    let mut found = [0.0; N];
    for (to, from) in found.iter_mut().zip(array) {
        *to = from.as_f64().filter(|v| v.is_finite())?;
    }
    Some(found)
}

impl File<'_> {
    /// Reads the mesh, with the columns [`UV`] if requested, and the number of triangles of each material.
    fn mesh(&self, with_uv: bool) -> Result<(PolygonMesh, BTreeMap<usize, usize>)> {
        let mut materials = BTreeMap::new();
        let mut mesh = PolygonMesh { unit: Some(Unit::Metre), ..PolygonMesh::default() };
        // glTF leaves the choice open if no default scene is stated; the first one is read then.
        let scene = index(&self.document["scene"]).unwrap_or(0);
        let mut stack: Vec<(usize, Transform, usize)> =
            match self.document["scenes"][scene]["nodes"].as_array() {
                Some(nodes) => nodes.iter().filter_map(index).map(|n| (n, Transform::IDENTITY, 0)).collect(),
                None => return Err(Error::input(format!("scene {scene}: expected nodes, found none"))),
            };
        // An explicit stack, because the file determines the depth. It returns the last node first, so nodes
        // are pushed in reverse order.
        stack.reverse();
        let mut visited = 0;
        while let Some((node, parent, depth)) = stack.pop() {
            visited += 1;
            if depth > MAX_DEPTH || visited > MAX_NODES {
                return Err(Error::input(format!(
                    "node {node}: expected a tree of nodes, found a cycle or too many nodes"
                )));
            }
            let value = &self.document["nodes"][node];
            if !value.is_object() {
                return Err(Error::input(format!("expected the node {node}, found none")));
            }
            let transform =
                parent.after(&node_transform(value).map_err(|e| e.in_context(format_args!("node {node}")))?);
            if let Some(number) = index(&value["mesh"]) {
                self.add_mesh(&mut mesh, &mut materials, number, &transform, with_uv)
                    .map_err(|e| e.in_context(format_args!("mesh {number}")))?;
            }
            let children = value["children"].as_array().into_iter().flatten().filter_map(index);
            stack.extend(children.rev().map(|child| (child, transform, depth + 1)));
        }
        if mesh.points.is_empty() {
            return Err(Error::input("expected triangles in the scene, found none"));
        }
        // A column that some primitive lacks has the wrong length and is discarded.
        let points = mesh.points.len();
        mesh.columns.retain(|(_, column)| column.len() == points);
        Ok((mesh, materials))
    }

    /// Picture of the base colour of a material, if it is in the file, is PNG or JPEG, and uses the first
    /// texture coordinates.
    fn picture(&self, material: usize) -> Option<&[u8]> {
        let texture = &self.document["materials"][material]["pbrMetallicRoughness"]["baseColorTexture"];
        if texture["texCoord"].as_u64().unwrap_or(0) != 0 {
            return None;
        }
        let source = index(&self.document["textures"][index(&texture["index"])?]["source"])?;
        let view = &self.document["bufferViews"][index(&self.document["images"][source]["bufferView"])?];
        let start = index(&view["byteOffset"]).unwrap_or(0);
        let bytes = self.binary.get(start..start.checked_add(index(&view["byteLength"])?)?)?;
        let known = bytes.starts_with(b"\x89PNG") || crate::appearance::is_jpeg(bytes);
        (known && index(&view["buffer"]) == Some(0)).then_some(bytes)
    }

    fn add_mesh(
        &self,
        mesh: &mut PolygonMesh,
        materials: &mut BTreeMap<usize, usize>,
        number: usize,
        transform: &Transform,
        with_uv: bool,
    ) -> Result<()> {
        let Some(primitives) = self.document["meshes"][number]["primitives"].as_array() else {
            return Err(Error::input("expected a list of primitives, found none"));
        };
        // σ is a length, so it scales with the mean factor of the three axes.
        let length = transform.determinant().abs().cbrt();
        for primitive in primitives {
            let mode = primitive["mode"].as_u64().unwrap_or(TRIANGLES);
            match mode {
                TRIANGLES => {}
                // Points and lines.
                0..TRIANGLES => continue,
                _ => {
                    return Err(Error::unsupported(
                        "strips and fans of triangles are not supported: export separate triangles",
                    ));
                }
            }
            let attributes = &primitive["attributes"];
            let positions = self.accessor(&attributes["POSITION"], FLOAT, "VEC3")?;
            let first = mesh.points.len();
            // A position takes twelve bytes.
            let max_vertices =
                (self.binary.len() / 12).saturating_mul(MAX_COPIES).max(ALWAYS_ALLOWED_VERTICES);
            if first.saturating_add(positions.count) > max_vertices {
                return Err(Error::input(format!(
                    "expected at most {max_vertices} vertices for a file of this size, found more in \
                     repeated meshes: export one copy"
                )));
            }
            // With all columns that this reader knows.
            let bytes = (size_of::<DVec3>() + 10 * size_of::<f64>()) as u64;
            self.budget.take_elements(positions.count as u64, bytes, "vertices")?;
            for vertex in 0..positions.count {
                let point = transform.apply(positions.vector(vertex));
                if !point.is_finite() {
                    return Err(Error::input(format!(
                        "vertex {vertex}: expected finite coordinates, found {} {} {}",
                        point[0], point[1], point[2]
                    )));
                }
                mesh.points.push(point);
            }
            let mut column = |name: &str, value: &dyn Fn(usize) -> f64| {
                let at = mesh.columns.iter().position(|(n, _)| n == name).unwrap_or_else(|| {
                    mesh.columns.push((name.to_owned(), Vec::new()));
                    mesh.columns.len() - 1
                });
                mesh.columns[at].1.extend((0..positions.count).map(value));
            };
            let same = |accessor: &Accessor, name: &str| match accessor.count == positions.count {
                true => Ok(()),
                false => Err(Error::input(format!(
                    "{name}: expected {} entries, as many as positions, found {}",
                    positions.count, accessor.count
                ))),
            };
            if !attributes["NORMAL"].is_null() {
                let normals = self.accessor(&attributes["NORMAL"], FLOAT, "VEC3")?;
                same(&normals, "NORMAL")?;
                for (k, name) in ["nx", "ny", "nz"].iter().enumerate() {
                    column(name, &|vertex| transform.normal(normals.vector(vertex))[k]);
                }
            }
            for (name, attribute) in COLUMNS {
                if !attributes[attribute].is_null() {
                    let found = self.accessor(&attributes[attribute], FLOAT, "SCALAR")?;
                    same(&found, attribute)?;
                    let factor = if name == "sigma" { length } else { 1.0 };
                    column(name, &|vertex| factor * found.number(vertex, 0));
                }
            }
            // Files with σ show it by their colours.
            if attributes["_SIGMA"].is_null() && !attributes["COLOR_0"].is_null() {
                let found = self.colours(&attributes["COLOR_0"])?;
                same(&found, "COLOR_0")?;
                let largest = found.largest();
                for (k, name) in ["red", "green", "blue"].iter().enumerate() {
                    column(name, &|vertex| display_value(found.number(vertex, k) / largest));
                }
            }
            if with_uv && !attributes["TEXCOORD_0"].is_null() {
                let found = self.accessor_of(&attributes["TEXCOORD_0"], &[FLOAT, BYTE, SHORT], "VEC2")?;
                same(&found, "TEXCOORD_0")?;
                let largest = found.largest();
                for (k, name) in UV.iter().enumerate() {
                    found.check_finite(k, "TEXCOORD_0")?;
                    column(name, &|vertex| found.number(vertex, k) / largest);
                }
            }
            let before = mesh.triangles.len();
            self.add_triangles(mesh, &primitive["indices"], first, transform.determinant() < 0.0)?;
            if let Some(material) = index(&primitive["material"]) {
                *materials.entry(material).or_default() += mesh.triangles.len() - before;
            }
        }
        Ok(())
    }

    /// The accessor of colours, which have three or four components.
    fn colours(&self, number: &Value) -> Result<Accessor<'_>> {
        let kinds = &[FLOAT, BYTE, SHORT];
        let opaque = index(number).is_some_and(|k| self.document["accessors"][k]["type"] == "VEC3");
        self.accessor_of(number, kinds, if opaque { "VEC3" } else { "VEC4" })
    }

    fn add_triangles(
        &self,
        mesh: &mut PolygonMesh,
        indices: &Value,
        first: usize,
        mirrored: bool,
    ) -> Result<()> {
        let vertices = mesh.points.len() - first;
        u32::try_from(mesh.points.len())
            .map_err(|_| Error::unsupported("expected at most 2³² vertices, found more"))?;
        let indices = match indices.is_null() {
            true => None,
            false => Some(self.accessor_of(indices, &[BYTE, SHORT, INTEGER], "SCALAR")?),
        };
        // Without indices, consecutive vertices form the triangles.
        let corners = indices.as_ref().map_or(vertices, |i| i.count);
        if corners % 3 != 0 {
            return Err(Error::input(format!("expected three corners per triangle, found {corners} in all")));
        }
        self.budget.take_elements((corners / 3) as u64, size_of::<[u32; 3]>() as u64, "triangles")?;
        for triangle in 0..corners / 3 {
            let mut made = [0; 3];
            for (k, to) in made.iter_mut().enumerate() {
                let corner = 3 * triangle + k;
                let vertex = indices.as_ref().map_or(corner, |i| i.number(corner, 0) as usize);
                if vertex >= vertices {
                    return Err(Error::input(format!(
                        "triangle {triangle}: expected a vertex index below {vertices}, found {vertex}"
                    )));
                }
                *to = (first + vertex) as u32;
            }
            // A mirrored node would turn the triangles inside out.
            if mirrored {
                made.swap(1, 2);
            }
            mesh.triangles.push(made);
        }
        Ok(())
    }

    fn accessor(&self, number: &Value, component: u64, kind: &str) -> Result<Accessor<'_>> {
        self.accessor_of(number, &[component], kind)
    }

    /// Checks an accessor against its view and the binary chunk, so that reading from it cannot fail.
    fn accessor_of(&self, number: &Value, components: &[u64], kind: &str) -> Result<Accessor<'_>> {
        let Some(number) = index(number) else {
            return Err(Error::input(
                "expected an accessor for the positions, attributes or indices of a primitive, found none",
            ));
        };
        let accessor = &self.document["accessors"][number];
        let wrong = |what: String| Error::input(format!("accessor {number}: {what}"));
        let component = accessor["componentType"].as_u64().unwrap_or(0);
        let found = accessor["type"].as_str().unwrap_or("nothing");
        if !components.contains(&component) || found != kind {
            return Err(Error::unsupported(format!(
                "accessor {number}: expected {kind} of component type {components:?}, found {found} of \
                 {component}"
            )));
        }
        // Without a view, glTF prescribes zeros, which are no geometry.
        if accessor["sparse"].is_object() || accessor["bufferView"].is_null() {
            return Err(Error::unsupported(format!(
                "accessor {number}: sparse data, or data without a bufferView, are not supported"
            )));
        }
        let type_ = match component {
            BYTE => NumberType::U8,
            SHORT => NumberType::U16,
            INTEGER => NumberType::U32,
            _ => NumberType::F32,
        };
        let size = type_.size()
            * match kind {
                "VEC4" => 4,
                "VEC3" => 3,
                "VEC2" => 2,
                _ => 1,
            };
        let view = &self.document["bufferViews"][index(&accessor["bufferView"]).unwrap_or(usize::MAX)];
        if !view.is_object() {
            return Err(wrong("refers to a bufferView that does not exist".to_owned()));
        }
        if index(&view["buffer"]) != Some(0) || !self.document["buffers"][0]["uri"].is_null() {
            return Err(Error::unsupported(format!(
                "accessor {number}: expected all data in one file, found a reference to another"
            )));
        }
        let optional = |value: &Value, default: usize| match value.is_null() {
            true => Some(default),
            false => index(value),
        };
        // All arithmetic is checked, because offsets, strides and counts come from the file and may overflow.
        let place = || {
            let start = optional(&view["byteOffset"], 0)?;
            let length = index(&view["byteLength"])?;
            let within = optional(&accessor["byteOffset"], 0)?;
            let stride = optional(&view["byteStride"], size)?;
            let count = index(&accessor["count"])?;
            let bytes = self.binary.get(start..start.checked_add(length)?)?.get(within..)?;
            let needed = match count {
                0 => 0,
                n => (n - 1).checked_mul(stride)?.checked_add(size)?,
            };
            (stride >= size && needed <= bytes.len()).then_some(Accessor { bytes, type_, stride, count })
        };
        place().ok_or_else(|| {
            wrong(format!(
                "its count, offset or stride exceeds its bufferView or the {} bytes of the binary chunk",
                self.binary.len()
            ))
        })
    }
}

/// Numbers of one type in the binary chunk.
struct Accessor<'a> {
    bytes: &'a [u8],
    type_: NumberType,
    stride: usize,
    count: usize,
}

impl Accessor<'_> {
    fn number(&self, element: usize, component: usize) -> f64 {
        let at = element * self.stride + component * self.type_.size();
        self.type_.decode::<false>(&self.bytes[at..at + self.type_.size()])
    }

    /// Value that means 1: integers are normalised.
    fn largest(&self) -> f64 {
        match self.type_ {
            NumberType::U8 => 255.0,
            NumberType::U16 => 65535.0,
            _ => 1.0,
        }
    }

    /// Rejects the first number of a component that is not finite.
    fn check_finite(&self, component: usize, name: &str) -> Result<()> {
        match (0..self.count).find(|vertex| !self.number(*vertex, component).is_finite()) {
            Some(vertex) => Err(Error::input(format!(
                "{name}: expected finite numbers, found {} at vertex {vertex}",
                self.number(vertex, component)
            ))),
            None => Ok(()),
        }
    }

    fn vector(&self, element: usize) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|k| self.number(element, k)))
    }
}

/// Local transform of a node: a matrix, or translation, rotation and scale (section 3.5.3).
fn node_transform(node: &Value) -> Result<Transform> {
    let stated = |key: &str| !node[key].is_null();
    let wrong = |key: &str, n: usize| Error::input(format!("expected {n} finite numbers for its {key}"));
    // glTF forbids a matrix beside the other three.
    if stated("matrix") {
        let m: [f64; 16] = numbers(&node["matrix"]).ok_or_else(|| wrong("matrix", 16))?;
        return Ok(Transform {
            // glTF stores matrices by columns.
            columns: [0, 1, 2].map(|c| DVec3::from_slice(&m[4 * c..4 * c + 3])),
            translation: DVec3::new(m[12], m[13], m[14]),
        });
    }
    // Scale is applied first, then rotation, then translation.
    let mut made = Transform::IDENTITY;
    if stated("rotation") {
        let q: [f64; 4] = numbers(&node["rotation"]).ok_or_else(|| wrong("rotation", 4))?;
        let pose =
            planish_sense::Pose::from_quaternion_xyzw(q, DVec3::ZERO).ok_or_else(|| wrong("rotation", 4))?;
        made.columns = made.columns.map(|axis| pose.rotate(axis));
    }
    if stated("scale") {
        let s: [f64; 3] = numbers(&node["scale"]).ok_or_else(|| wrong("scale", 3))?;
        for (column, factor) in made.columns.iter_mut().zip(s) {
            *column *= factor;
        }
    }
    if stated("translation") {
        made.translation = DVec3::from(numbers(&node["translation"]).ok_or_else(|| wrong("translation", 3))?);
    }
    Ok(made)
}
