//! Reads texture coordinates, parts and materials of OBJ files.

use planish_core::{Finding, FindingCode};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use planish_estimate::{Error, Result};

use super::{Farthest, Obj, mesh_of};
use crate::appearance::{MeshPart, NO_UV, PartKind, TexturedMesh, read_materials};
use crate::source::{next_word, parse_number, read_file, shown};

/// Collects texture coordinates, parts and material libraries while a file is read.
#[derive(Default)]
pub(super) struct AppearanceReader {
    pub uv: Vec<[f64; 2]>,
    /// Texture coordinates of the current face.
    face: Vec<u32>,
    triangles: Vec<[u32; 3]>,
    /// Number of triangles of the faces before.
    finished: usize,
    farthest: Farthest,
    /// Parts in the order of their first line.
    parts: Vec<MeshPart>,
    /// Index into `parts` by kind and name.
    index: BTreeMap<(u8, String), usize>,
    /// Parts that the next faces belong to, by kind: objects, groups, materials.
    current: [Vec<usize>; 3],
    libraries: Vec<String>,
}

impl AppearanceReader {
    /// Handles a line whose keyword concerns the appearance; ignores every other keyword.
    ///
    /// # Errors
    /// `Input` for a texture coordinate that is missing, malformed or not finite.
    pub fn line(&mut self, keyword: &[u8], mut rest: &[u8], line: u64) -> Result<()> {
        let text = || String::from_utf8_lossy(rest.trim_ascii()).into_owned();
        match keyword {
            b"vt" => {
                let mut uv = [0.0; 2];
                for (found, x) in uv.iter_mut().enumerate() {
                    let word = next_word(&mut rest).ok_or_else(|| {
                        Error::input(format!("line {line}: expected 2 numbers, found {found}"))
                    })?;
                    *x = parse_number(word).filter(|x| x.is_finite()).ok_or_else(|| {
                        Error::input(format!("line {line}: expected a finite number, found {}", shown(word)))
                    })?;
                }
                self.uv.push(uv);
            }
            b"o" => self.begin(PartKind::Object, vec![text()]),
            b"usemtl" => self.begin(PartKind::Material, vec![text()]),
            // A face has one object and one material, whose names may contain blanks, but any number of
            // groups.
            b"g" => {
                let names = text().split_ascii_whitespace().map(str::to_owned).collect();
                self.begin(PartKind::Group, names);
            }
            b"mtllib" => self.libraries.push(text()),
            _ => {}
        }
        Ok(())
    }

    /// Number of parts that the next faces belong to.
    pub fn current_parts(&self) -> usize {
        self.current.iter().map(Vec::len).sum()
    }

    /// Makes the named parts the current ones of their kind.
    fn begin(&mut self, kind: PartKind, names: Vec<String>) {
        let own = kind as usize;
        self.current[own].clear();
        for name in names {
            let parts = &mut self.parts;
            // A file may return to an earlier part, to which the next triangles then belong.
            let at = *self.index.entry((own as u8, name.clone())).or_insert_with(|| {
                parts.push(MeshPart { kind, name, triangles: Vec::new() });
                parts.len() - 1
            });
            self.current[own].push(at);
        }
    }

    /// Adds a corner of a face; `before` is the number of its earlier corners.
    pub fn corner(&mut self, before: usize, uv: Option<u32>, line: u64) {
        if before == 0 {
            self.face.clear();
        }
        if let Some(uv) = uv {
            self.farthest.update(uv, line);
        }
        self.face.push(uv.unwrap_or(NO_UV));
    }

    /// Adds a triangle of the current face, by the numbers of its corners in the face.
    pub fn add_triangle(&mut self, corners: [usize; 3]) {
        self.triangles.push(corners.map(|k| self.face[k]));
    }

    /// Ends a face; `triangles` is the number of triangles of the mesh, those of this face included.
    pub fn finish_face(&mut self, triangles: usize) {
        let first = std::mem::replace(&mut self.finished, triangles) as u32;
        for part in self.current.iter().flatten() {
            self.parts[*part].triangles.extend(first..triangles as u32);
        }
    }
}

/// Reads a mesh with texture coordinates, parts, and the colour picture that most triangles use.
pub(crate) fn read_textured(path: &Path) -> Result<TexturedMesh> {
    let (mesh, appearance) = read_file(path, |mut source, _| {
        let mut obj = Obj::read(&mut source, Some(AppearanceReader::default()))?;
        let appearance = obj.appearance.take().unwrap_or_default();
        appearance.farthest.check(appearance.uv.len(), "texture coordinate")?;
        Ok((mesh_of(obj)?, appearance))
    })?;
    let mut made = TexturedMesh {
        points: mesh.points,
        triangles: mesh.triangles,
        // Without coordinates every corner is `NO_UV`; the empty list says so for the whole mesh.
        uv_triangles: if appearance.uv.is_empty() { Vec::new() } else { appearance.triangles },
        uv: appearance.uv,
        parts: appearance.parts.into_iter().filter(|part| !part.triangles.is_empty()).collect(),
        unit: mesh.unit,
        ..TexturedMesh::default()
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut pictures: BTreeMap<String, PathBuf> = BTreeMap::new();
    // Each library is read once, however often the file names it.
    let mut read: BTreeSet<PathBuf> = BTreeSet::new();
    for line in &appearance.libraries {
        // Exporters write names with blanks, but the format also allows several names per line. The whole
        // line is tried first.
        let single_path = folder.join(line);
        let names: Vec<PathBuf> = match single_path.is_file() {
            true => vec![single_path],
            false => line.split_ascii_whitespace().map(|name| folder.join(name)).collect(),
        };
        for name in names.into_iter().filter(|name| read.insert(name.clone())) {
            if name.is_file() {
                pictures.extend(read_materials(&name)?);
                made.files.push(name);
            } else {
                // Not an error, because the shape does not depend on materials.
                made.findings.push(Finding::new(
                    FindingCode::MaterialsMissing,
                    format!("{}: the material file {} does not exist", path.display(), name.display()),
                ));
            }
        }
    }
    let textured = || {
        (made.parts.iter())
            .filter(|part| part.kind == PartKind::Material)
            .filter_map(|part| pictures.get(&part.name).map(|picture| (part.triangles.len(), picture)))
    };
    made.texture = textured().max_by_key(|(count, _)| *count).map(|(_, picture)| picture.clone());
    if let Some(other) = textured().find(|(_, picture)| Some(*picture) != made.texture.as_ref()) {
        let other = other.1.display().to_string();
        made.findings.push(Finding::new(
            FindingCode::TextureIgnored,
            format!("{}: only one of several textures is used; {other} is ignored", path.display()),
        ));
    }
    Ok(made)
}
