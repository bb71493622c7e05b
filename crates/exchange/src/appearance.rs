//! Meshes with texture coordinates, named parts and a texture: types, materials, and OBJ with MTL.
//!
//! **Input.** Any mesh file. OBJ is read with `vt`, with its groups, objects and materials as parts, and with
//! the pictures that its material files (`.mtl`, `map_Kd`) name; GLB with `TEXCOORD_0` and the picture of its
//! base colour.
//!
//! **Output.** OBJ with its MTL file and picture.
//!
//! **Limits.** Of a material only the colour picture is used. Texture coordinates are read from OBJ and GLB
//! files only.

use planish_core::Finding;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use planish_estimate::{Error, Result};

use crate::Unit;
use crate::atomic::{write_atomically, write_packed};
use crate::source::read_text;

/// No texture coordinates at a corner.
pub const NO_UV: u32 = u32::MAX;

/// What names a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PartKind {
    /// `o` in OBJ.
    Object,
    /// `g` in OBJ.
    Group,
    /// `usemtl` in OBJ.
    Material,
}

/// Triangles of one name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MeshPart {
    /// What names it.
    pub kind: PartKind,
    /// Its name.
    pub name: String,
    /// Its triangles.
    pub triangles: Vec<u32>,
}

/// A mesh with what makes it look like something.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TexturedMesh {
    /// Positions.
    pub points: Vec<[f64; 3]>,
    /// Corners of triangles.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates from 0 to 1, from the lower left.
    pub uv: Vec<[f64; 2]>,
    /// Those of the corners of each triangle, or [`NO_UV`]; empty where the mesh has none.
    pub uv_triangles: Vec<[u32; 3]>,
    /// Parts by name.
    pub parts: Vec<MeshPart>,
    /// The picture of the material that most triangles have.
    pub texture: Option<PathBuf>,
    /// The same where it stands in the file itself: PNG or JPEG.
    pub picture: Option<Vec<u8>>,
    /// Further numbers of the vertices by their names, as [`PolygonMesh`](crate::mesh::PolygonMesh) has them.
    pub columns: Vec<(String, Vec<f64>)>,
    /// Further files that were read.
    pub files: Vec<PathBuf>,
    /// What is named and not there, or not looked at.
    pub findings: Vec<Finding>,
    /// The unit of length, where the file names it.
    pub unit: Option<Unit>,
}

/// Vertices made so many that each has one pair of texture coordinates, as viewers want it.
#[derive(Debug, Clone, PartialEq)]
pub struct SplitMesh {
    /// The vertex that each was.
    pub vertex_of: Vec<u32>,
    /// Texture coordinates, one for each; empty where there are none.
    pub uv: Vec<[f64; 2]>,
    /// Corners of triangles.
    pub triangles: Vec<[u32; 3]>,
}

impl TexturedMesh {
    /// Splits vertices at seams of the texture.
    #[must_use]
    pub fn split(&self) -> SplitMesh {
        if self.uv_triangles.is_empty() {
            return SplitMesh {
                vertex_of: (0..self.points.len() as u32).collect(),
                uv: Vec::new(),
                triangles: self.triangles.clone(),
            };
        }
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

    /// The vertices of parts of a name; of objects before groups before materials, where several have it.
    #[must_use]
    pub fn vertices_of(&self, name: &str) -> Option<Vec<u32>> {
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

/// The bytes of a picture, to be put into another file as they are.
///
/// # Errors
/// `Io` where the file cannot be read.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path)
        .map_err(|e| Error::io(format!("{}: could not be read", path.display())).with_source(e))
}

/// Indices of vertices from 0, in any order, with blanks or lines between them; `#` begins a comment. Goes
/// out: each once, in order.
///
/// # Errors
/// `Io` where the file cannot be read; `Input` for what is no index, with the line.
pub fn read_vertex_list(path: &Path) -> Result<Vec<u32>> {
    let text = read_text(path)?;
    let mut vertices = Vec::new();
    for (index, line) in text.lines().enumerate() {
        for word in line.split('#').next().unwrap_or_default().split_whitespace() {
            vertices.push(word.parse().map_err(|_| {
                Error::input(format!(
                    "{}: line {}: needed the index of a vertex, found `{word}`",
                    path.display(),
                    index + 1
                ))
            })?);
        }
    }
    vertices.sort_unstable();
    vertices.dedup();
    Ok(vertices)
}

/// The picture of each material's colour that a material file names, beside it.
///
/// # Errors
/// `Io` where the file cannot be read; `Input` for pictures before any material, with the line.
pub fn read_materials(path: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let read = || {
        let text = read_text(path)?;
        let mut materials = BTreeMap::new();
        let mut current: Option<String> = None;
        for (index, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
            match word {
                "newmtl" => current = Some(rest.trim().to_owned()),
                "map_Kd" => {
                    // Options stand before the name; a name without options may have blanks.
                    let rest = rest.trim();
                    let name = match rest.starts_with('-') {
                        true => rest.rsplit(char::is_whitespace).next().unwrap_or_default(),
                        false => rest,
                    };
                    let Some(material) = current.clone().filter(|_| !name.is_empty()) else {
                        return Err(Error::input(format!(
                            "line {}: needed `newmtl` before a picture, and the picture's name",
                            index + 1
                        )));
                    };
                    let folder = path.parent().unwrap_or(Path::new(""));
                    materials.insert(material, folder.join(name.replace('\\', "/")));
                }
                _ => {}
            }
        }
        Ok(materials)
    };
    read().map_err(|e: Error| e.in_context(path.display()))
}

/// Whether a picture is JPEG, by its first bytes.
#[must_use]
pub fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, 0xd8])
}

/// Writes OBJ with its objects, groups and materials in the order of the triangles; with a picture also
/// `NAME.mtl` and `NAME.png` beside it, or `NAME.jpg` where it is JPEG, which all materials show. Gives the
/// files.
///
/// # Errors
/// `Input` for corners that are not there; `Io` when a file cannot be written; none of them is left
/// half-written.
pub fn write_textured_obj(path: &Path, mesh: &TexturedMesh, picture: Option<&[u8]>) -> Result<Vec<PathBuf>> {
    check(mesh).map_err(|e| e.in_context(path.display()))?;
    let ending = if picture.is_some_and(is_jpeg) { "jpg" } else { "png" };
    let (materials, texture) = (path.with_extension("mtl"), path.with_extension(ending));
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let names = TriangleParts::new(mesh);
    let mut written = Vec::new();
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
        for [x, y, z] in &mesh.points {
            writeln!(writer, "v {x:?} {y:?} {z:?}")?;
        }
        for [u, v] in &mesh.uv {
            writeln!(writer, "vt {u:?} {v:?}")?;
        }
        for (t, corners) in mesh.triangles.iter().enumerate() {
            names.write_changes(writer, mesh, t, picture.is_some())?;
            write!(writer, "f")?;
            for (k, corner) in corners.iter().enumerate() {
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

/// The material of triangles that have none, where there is a picture.
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
                if let Some(own) = parts.get_mut(*t as usize) {
                    own.push(index as u32);
                }
            }
        }
        Self { parts }
    }

    /// Names of one kind that a triangle has; none before the first.
    fn names<'a>(&self, mesh: &'a TexturedMesh, triangle: Option<usize>, kind: PartKind) -> Vec<&'a str> {
        (triangle.and_then(|t| self.parts.get(t)).into_iter().flatten())
            .map(|index| &mesh.parts[*index as usize])
            .filter(|part| part.kind == kind)
            .map(|part| part.name.as_str())
            .collect()
    }

    /// Names of all materials that triangles have.
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

    /// Writes the names of a triangle that are not those of the one before.
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
            let here = self.names(mesh, Some(triangle), kind);
            let changed = here != self.names(mesh, before, kind);
            match &here[..] {
                [] if kind == PartKind::Material && with_picture && (changed || before.is_none()) => {
                    writeln!(writer, "usemtl {UNNAMED_MATERIAL}")?;
                }
                // Only groups can end: a `g` of no name.
                [] if kind == PartKind::Group && changed => writeln!(writer, "g")?,
                [] => {}
                names if changed => writeln!(writer, "{word} {}", names.join(" "))?,
                _ => {}
            }
        }
        Ok(())
    }
}

fn check(mesh: &TexturedMesh) -> Result<()> {
    let few =
        |of: &[[u32; 3]], count: usize| of.iter().flatten().all(|&c| (c as usize) < count || c == NO_UV);
    let corners = mesh.triangles.iter().flatten().all(|&c| (c as usize) < mesh.points.len());
    let paired = mesh.uv_triangles.is_empty() || mesh.uv_triangles.len() == mesh.triangles.len();
    if corners && paired && few(&mesh.uv_triangles, mesh.uv.len()) {
        return Ok(());
    }
    Err(Error::input("needed corners and texture coordinates that are there, for every triangle"))
}
