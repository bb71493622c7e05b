//! Types of textured meshes, material files (MTL), and the writer of textured OBJ files.
//!
//! This module is below the formats that use it; users import it through [`crate::textured`].
//!
//! **Input.** A [`TexturedMesh`] and a picture, or a material file.
//!
//! **Output.** An OBJ file with its MTL file and picture, or the pictures of materials.
//!
//! **Limits.** Of a material, only the colour picture (`map_Kd`) is used.

use planish_core::{DVec3, Finding};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use planish_estimate::{Error, Result};

use crate::Unit;
use crate::atomic::{write_atomically, write_packed};
use crate::output_set::recover_outputs_in_folder_of;
use crate::source::{read_limited, read_text};

/// Marks a corner without texture coordinates.
pub const NO_UV: u32 = u32::MAX;

/// Kind of a named part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PartKind {
    /// `o` in OBJ.
    Object,
    /// `g` in OBJ.
    Group,
    /// `usemtl` in OBJ.
    Material,
}

/// Triangles with a common name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MeshPart {
    /// Keyword that names the part.
    pub kind: PartKind,
    /// Name.
    pub name: String,
    /// Indices of its triangles.
    pub triangles: Vec<u32>,
}

/// A mesh with texture coordinates, named parts and a texture.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TexturedMesh {
    /// Positions.
    pub points: Vec<DVec3>,
    /// Indices of the corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates from 0 to 1, from the lower left.
    pub uv: Vec<[f64; 2]>,
    /// Indices into `uv` of the corners of each triangle, or [`NO_UV`]; empty without texture coordinates.
    pub uv_triangles: Vec<[u32; 3]>,
    /// Named parts; a triangle may belong to several.
    pub parts: Vec<MeshPart>,
    /// Path of the picture of the material with the most triangles.
    pub texture: Option<PathBuf>,
    /// Bytes of the picture, PNG or JPEG, if the mesh file contains it.
    pub picture: Option<Vec<u8>>,
    /// Further columns of numbers at the vertices, as in [`PolygonMesh`](crate::mesh::PolygonMesh).
    pub columns: Vec<(String, Vec<f64>)>,
    /// Further files that were read.
    pub files: Vec<PathBuf>,
    /// References to missing files, and textures that are ignored.
    pub findings: Vec<Finding>,
    /// The unit of length, if the file states it.
    pub unit: Option<Unit>,
}

/// A mesh whose vertices are split at seams, so that each has one pair of texture coordinates, as GLB
/// requires.
#[derive(Debug, Clone, PartialEq)]
pub struct SplitMesh {
    /// Index of the original vertex of each vertex.
    pub vertex_of: Vec<u32>,
    /// Texture coordinates, one pair per vertex; empty for none.
    pub uv: Vec<[f64; 2]>,
    /// Indices of the corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl TexturedMesh {
    /// Splits vertices at seams of the texture.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_exchange::textured::TexturedMesh;
    /// let square = TexturedMesh {
    ///     points: vec![DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y],
    ///     triangles: vec![[0, 1, 2], [0, 2, 3]],
    ///     uv: vec![[0.0, 0.0], [0.5, 0.0], [0.5, 1.0], [0.75, 0.25], [1.0, 0.5], [0.75, 1.0]],
    ///     uv_triangles: vec![[0, 1, 2], [3, 4, 5]],
    ///     ..TexturedMesh::default()
    /// };
    /// // Vertices 0 and 2 are on the seam.
    /// assert_eq!(square.split().vertex_of, [0, 1, 2, 0, 2, 3]);
    /// ```
    #[must_use]
    pub fn split(&self) -> SplitMesh {
        if self.uv_triangles.is_empty() {
            return SplitMesh {
                vertex_of: (0..self.points.len() as u32).collect(),
                uv: Vec::new(),
                triangles: self.triangles.clone(),
            };
        }
        // Vertices are numbered in order of first use, which does not depend on the map.
        let mut made: BTreeMap<(u32, u32), u32> = BTreeMap::new();
        let mut split = SplitMesh {
            vertex_of: Vec::new(),
            uv: Vec::new(),
            triangles: Vec::with_capacity(self.triangles.len()),
        };
        for (corners, uvs) in self.triangles.iter().zip(&self.uv_triangles) {
            split.triangles.push(std::array::from_fn(|k| {
                *made.entry((corners[k], uvs[k])).or_insert_with(|| {
                    split.vertex_of.push(corners[k]);
                    split.uv.push(self.uv.get(uvs[k] as usize).copied().unwrap_or_default());
                    split.vertex_of.len() as u32 - 1
                })
            }));
        }
        split
    }

    /// Vertices of the part with this name, ascending. An object is preferred to a group, and a group to a
    /// material.
    #[must_use]
    pub fn vertices_of(&self, name: &str) -> Option<Vec<u32>> {
        // OBJ keeps the names of objects, groups and materials apart, so one name may denote several parts.
        let part = [PartKind::Object, PartKind::Group, PartKind::Material]
            .into_iter()
            .find_map(|kind| self.parts.iter().find(|part| part.kind == kind && part.name == name))?;
        let mut vertices: Vec<u32> =
            (part.triangles.iter()).flat_map(|t| self.triangles[*t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        Some(vertices)
    }
}

/// Maximum size of an embedded picture. The lengths of GLB files have 32 bits, and pictures of textures are
/// far smaller.
const MAX_EMBEDDED_BYTES: u64 = 256 << 20;

/// Reads a regular file of at most 256 MiB completely, such as a picture that is embedded unchanged.
///
/// The names of such files come from other files, which may name a device or a pipe. These are not opened,
/// because opening a pipe may wait forever.
///
/// # Errors
/// `Io` if the file cannot be read or is not a regular file; `Input` if it is longer.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    let read = || {
        recover_outputs_in_folder_of(path);
        let metadata = std::fs::metadata(path).map_err(|e| Error::io("could not be read").with_source(e))?;
        if !metadata.is_file() {
            return Err(Error::io("expected a regular file, found a folder, a device or a pipe"));
        }
        if metadata.len() > MAX_EMBEDDED_BYTES {
            return Err(Error::input(format!(
                "expected a picture of at most {MAX_EMBEDDED_BYTES} bytes, found {}",
                metadata.len()
            )));
        }
        read_limited(path, MAX_EMBEDDED_BYTES, "a picture")
    };
    read().map_err(|e: Error| e.in_context(path.display()))
}

/// Reads a list of vertex indices, separated by white space, with `#` for comments. Returns them ascending,
/// each once.
///
/// # Errors
/// `Io` if the file cannot be read; `Input` for a word that is not an index, with the line.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("held.txt");
/// std::fs::write(&path, "7 3 # left hand\n3\n")?;
/// assert_eq!(planish_exchange::textured::read_vertex_list(&path)?, [3, 7]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_vertex_list(path: &Path) -> Result<Vec<u32>> {
    let text = read_text(path)?;
    let mut vertices = Vec::new();
    for (index, line) in text.lines().enumerate() {
        for word in line.split('#').next().unwrap_or_default().split_whitespace() {
            vertices.push(word.parse().map_err(|_| {
                Error::input(format!(
                    "{}: line {}: expected a vertex index, found `{word}`",
                    path.display(),
                    index + 1
                ))
            })?);
        }
    }
    // Sorted first, because `dedup` compares only neighbours.
    vertices.sort_unstable();
    vertices.dedup();
    Ok(vertices)
}

/// Reads a material file (MTL): the path of the colour picture of each material that has one.
///
/// # Errors
/// `Io` if the file cannot be read; `Input` for a picture before any material, with the line.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("a.mtl");
/// std::fs::write(&path, "newmtl skin\nmap_Kd skin.png\n")?;
/// let pictures = planish_exchange::textured::read_materials(&path)?;
/// assert_eq!(pictures["skin"], folder.path().join("skin.png"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_materials(path: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let read = || {
        let text = read_text(path)?;
        let mut materials = BTreeMap::new();
        let mut current: Option<String> = None;
        for (index, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
            // Other keywords describe lighting and further maps. They are skipped without a check, because
            // programs add keywords of their own.
            match word {
                "newmtl" => current = Some(rest.trim().to_owned()),
                "map_Kd" => {
                    // Options precede the name. Without options, the whole rest is the name, which may
                    // contain blanks.
                    let rest = rest.trim();
                    let name = match rest.starts_with('-') {
                        true => rest.rsplit(char::is_whitespace).next().unwrap_or_default(),
                        false => rest,
                    };
                    let Some(material) = current.clone().filter(|_| !name.is_empty()) else {
                        return Err(Error::input(format!(
                            "line {}: expected `newmtl NAME` before `map_Kd`, and the name of an image \
                             after it",
                            index + 1
                        )));
                    };
                    let folder = path.parent().unwrap_or(Path::new(""));
                    // Programs on Windows write backslashes.
                    materials.insert(material, folder.join(name.replace('\\', "/")));
                }
                _ => {}
            }
        }
        Ok(materials)
    };
    read().map_err(|e: Error| e.in_context(path.display()))
}

/// True if the first bytes are those of a JPEG picture.
///
/// # Examples
/// ```
/// assert!(planish_exchange::textured::is_jpeg(b"\xff\xd8\xff\xe0"));
/// assert!(!planish_exchange::textured::is_jpeg(b"\x89PNG"));
/// ```
#[must_use]
pub fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, 0xd8])
}

/// Writes an OBJ file with its objects, groups and materials in the order of the triangles. With a picture,
/// it also writes `NAME.mtl` and `NAME.png` (or `NAME.jpg`); all materials use that picture. Returns the
/// paths.
///
/// # Errors
/// `Input` for corners or texture coordinates that do not exist; `Io` when a file cannot be written; none is
/// left half-written.
pub fn write_textured_obj(path: &Path, mesh: &TexturedMesh, picture: Option<&[u8]>) -> Result<Vec<PathBuf>> {
    check(mesh).map_err(|e| e.in_context(path.display()))?;
    let ending = if picture.is_some_and(is_jpeg) { "jpg" } else { "png" };
    let (materials, texture) = (path.with_extension("mtl"), path.with_extension(ending));
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    // OBJ states names before the triangles, while parts list triangles, so the lists are inverted once.
    let names = TriangleParts::new(mesh);
    let mut written = Vec::new();
    // Files are written before those that refer to them: picture, materials, mesh.
    if let Some(bytes) = picture {
        write_atomically(&texture, |writer| writer.write_all(bytes))?;
        write_atomically(&materials, |writer| {
            writeln!(writer, "# Planish")?;
            for material in names.materials(mesh) {
                writeln!(writer, "newmtl {material}\nKd 1 1 1\nmap_Kd {}", name(&texture))?;
            }
            Ok(())
        })?;
        written.extend([texture, materials.clone()]);
    }
    write_packed(path, |writer| {
        writeln!(writer, "# Planish")?;
        if let Some(unit) = mesh.unit {
            writeln!(writer, "# unit {unit}")?;
        }
        if picture.is_some() {
            writeln!(writer, "mtllib {}", name(&materials))?;
        }
        for DVec3 { x, y, z } in &mesh.points {
            // `{:?}` prints the shortest digits that read back to the same number.
            writeln!(writer, "v {x:?} {y:?} {z:?}")?;
        }
        for [u, v] in &mesh.uv {
            writeln!(writer, "vt {u:?} {v:?}")?;
        }
        for (t, corners) in mesh.triangles.iter().enumerate() {
            names.write_changes(writer, mesh, t, picture.is_some())?;
            write!(writer, "f")?;
            for (k, corner) in corners.iter().enumerate() {
                // `v/vt` with texture coordinates, `v` without.
                match mesh.uv_triangles.get(t).map(|uv| uv[k]).filter(|uv| *uv != NO_UV) {
                    Some(uv) => write!(writer, " {}/{}", corner + 1, uv + 1)?,
                    None => write!(writer, " {}", corner + 1)?,
                }
            }
            writeln!(writer)?;
        }
        Ok(())
    })?;
    written.push(path.to_owned());
    Ok(written)
}

/// Material of triangles without one, if there is a picture: viewers show a picture only through a material.
const UNNAMED_MATERIAL: &str = "surface";

/// Indices of the parts that each triangle belongs to.
struct TriangleParts {
    /// One list per triangle; indices into [`TexturedMesh::parts`], ascending.
    parts: Vec<Vec<u32>>,
}

impl TriangleParts {
    fn new(mesh: &TexturedMesh) -> Self {
        let mut parts = vec![Vec::new(); mesh.triangles.len()];
        for (index, part) in mesh.parts.iter().enumerate() {
            for t in &part.triangles {
                // `check` does not cover parts, so an index beyond the triangles must not panic here.
                if let Some(own) = parts.get_mut(*t as usize) {
                    own.push(index as u32);
                }
            }
        }
        Self { parts }
    }

    /// Names of one kind that apply to a triangle; none for `None`, the state before the first triangle.
    fn names<'a>(&self, mesh: &'a TexturedMesh, triangle: Option<usize>, kind: PartKind) -> Vec<&'a str> {
        (triangle.and_then(|t| self.parts.get(t)).into_iter().flatten())
            .map(|index| &mesh.parts[*index as usize])
            .filter(|part| part.kind == kind)
            .map(|part| part.name.as_str())
            .collect()
    }

    /// Names of all materials, with [`UNNAMED_MATERIAL`] if some triangle has none.
    fn materials<'a>(&self, mesh: &'a TexturedMesh) -> Vec<&'a str> {
        let mut all: Vec<&str> = (mesh.parts.iter())
            .filter(|part| part.kind == PartKind::Material)
            .map(|part| part.name.as_str())
            .collect();
        let bare = |t: usize| self.names(mesh, Some(t), PartKind::Material).is_empty();
        if !all.contains(&UNNAMED_MATERIAL) && (0..mesh.triangles.len()).any(bare) {
            all.push(UNNAMED_MATERIAL);
        }
        all
    }

    /// Writes the names of a triangle that differ from those of the previous one.
    fn write_changes(
        &self,
        writer: &mut dyn Write,
        mesh: &TexturedMesh,
        triangle: usize,
        with_picture: bool,
    ) -> std::io::Result<()> {
        let before = triangle.checked_sub(1);
        for (word, kind) in [("o", PartKind::Object), ("g", PartKind::Group), ("usemtl", PartKind::Material)]
        {
            let names = self.names(mesh, Some(triangle), kind);
            // Names are repeated only when they change, as in files of other programs.
            let changed = names != self.names(mesh, before, kind);
            match &names[..] {
                [] if kind == PartKind::Material && with_picture && (changed || before.is_none()) => {
                    writeln!(writer, "usemtl {UNNAMED_MATERIAL}")?;
                }
                // Only groups can be ended, by `g` without a name.
                [] if kind == PartKind::Group && changed => writeln!(writer, "g")?,
                [] => {}
                names if changed => writeln!(writer, "{word} {}", names.join(" "))?,
                _ => {}
            }
        }
        Ok(())
    }
}

/// The sRGB value of a colour component, which glTF states in proportion to light (section 3.7.2.1).
pub(crate) fn display_value(linear: f64) -> f64 {
    match linear {
        x if x <= 0.003_130_8 => 12.92 * x,
        x => 1.055 * x.powf(1.0 / 2.4) - 0.055,
    }
}

fn check(mesh: &TexturedMesh) -> Result<()> {
    let few = |triangles: &[[u32; 3]], count: usize| {
        triangles.iter().flatten().all(|&c| (c as usize) < count || c == NO_UV)
    };
    let corners = mesh.triangles.iter().flatten().all(|&c| (c as usize) < mesh.points.len());
    let paired = mesh.uv_triangles.is_empty() || mesh.uv_triangles.len() == mesh.triangles.len();
    if corners && paired && few(&mesh.uv_triangles, mesh.uv.len()) {
        return Ok(());
    }
    Err(Error::input("expected every triangle to refer to existing points and texture coordinates"))
}
