//! OBJ, the text format of Wavefront: vertices, normals and polygons.
//!
//! **Input.** `v x y z` or `v x y z red green blue` (other further values are ignored), `vn`, and `f` with
//! indices that count from 1 or, if negative, back from the last vertex. Polygons are split into triangles.
//! Lines that end with `\` continue in the next one; `#` begins a comment; other keywords are ignored.
//! Colours are no part of the format, but many programs write them; they become columns if all vertices have
//! one.
//!
//! **Output.** A [`PolygonMesh`] or a [`Scan`]. Written files keep every digit.
//!
//! **Normals.** The normal of a vertex is the sum of the different `vn` that faces assign to it. If no face
//! assigns any, and there are as many `vn` as `v`, they correspond in order, as in point clouds. The format
//! has no unit; a comment `# unit mm` states it.
//!
//! [`crate::textured::read_textured`] also reads texture coordinates, groups, objects and materials; the
//! other readers ignore them.
//!
//! **Limits.** Free-form curves and surfaces are ignored.
//!
//! # References
//! Wavefront Technologies, *Advanced Visualizer Manual*, appendix B1, *Object Files*.

mod appearance;
#[cfg(test)]
mod tests;

use planish_core::{Budget, DVec3};
use std::io::{self, Read, Write};
use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::Scan;

use crate::Unit;
use crate::atomic::write_packed;
use crate::mesh_data::{MeshColumns, PolygonMesh, scan_of_vertices};
use appearance::AppearanceReader;
pub(crate) use appearance::read_textured;

use crate::polygon::split_polygon;
use crate::source::{Source, next_word, parse_number, read_file, shown};

/// Prefix of the unit in comments that Planish writes.
const UNIT_COMMENT: &[u8] = b" unit ";

/// Marks a vertex to which no face has assigned a normal.
const NONE: u32 = u32::MAX;

/// Reads vertices as points, with their normals. Vertices with a coordinate that is not finite are dropped
/// and counted.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable,
/// [`Input`](planish_estimate::ErrorKind::Input) for a word that is no number, an index of a vertex or normal
/// that does not exist, or no vertices: with file and line.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("cloud.obj");
/// std::fs::write(&path, "v 1 2 3\nvn 0 0 1\nv 4 5 6\nvn 0 1 0\n")?;
/// let scan = planish_exchange::obj::read_scan(&path)?;
/// assert_eq!(scan.normals, Some(vec![DVec3::Z, DVec3::Y]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_scan(path: &Path) -> Result<Scan> {
    read_scan_and_unit(path).map(|(scan, _)| scan)
}

/// [`read_scan`], with the unit that the file states.
pub(crate) fn read_scan_and_unit(path: &Path) -> Result<(Scan, Option<Unit>)> {
    read_file(path, |mut source, name| scan_from(&mut source, name))
}

/// Reads a mesh; normals become the columns `nx ny nz`, colours of vertices `red green blue`.
///
/// # Errors
/// As [`read_scan`]; also for a coordinate that is not finite, if there are faces. Without faces, the vertex
/// is dropped.
pub fn read_mesh(path: &Path) -> Result<PolygonMesh> {
    read_file(path, |mut source, _| mesh_from(&mut source))
}

/// Writes positions, normals and triangles. OBJ does not support other columns.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) for normals of another number than points, or corners beyond
/// the points; [`Io`](planish_estimate::ErrorKind::Io) when the file cannot be written; nothing is left
/// half-written.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::mesh::MeshColumns;
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("one.obj");
/// planish_exchange::obj::write_mesh(&path, &MeshColumns {
///     points: &[DVec3::ZERO, DVec3::X, 0.5 * DVec3::Y],
///     triangles: &[[0, 1, 2]],
///     ..MeshColumns::default()
/// })?;
/// let text = std::fs::read_to_string(&path)?;
/// assert!(text.ends_with("v 0.0 0.5 0.0\nf 1 2 3\n"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_mesh(path: &Path, mesh: &MeshColumns) -> Result<()> {
    mesh.check(true).map_err(|e| e.in_context(path.display()))?;
    write_packed(path, |mut writer| write_to(&mut writer, mesh))
}

fn write_to(writer: &mut impl Write, mesh: &MeshColumns) -> io::Result<()> {
    writeln!(writer, "# Planish")?;
    if let Some(unit) = mesh.unit {
        writeln!(writer, "# unit {unit}")?;
    }
    // The debug format prints the shortest text that reads back as the same number, and uses exponents, where
    // the display format prints hundreds of zeros.
    for DVec3 { x, y, z } in mesh.points {
        writeln!(writer, "v {x:?} {y:?} {z:?}")?;
    }
    for DVec3 { x, y, z } in mesh.normals.unwrap_or_default() {
        writeln!(writer, "vn {x:?} {y:?} {z:?}")?;
    }
    for t in mesh.triangles {
        let [a, b, c] = t.map(|corner| u64::from(corner) + 1);
        match mesh.normals {
            Some(_) => writeln!(writer, "f {a}//{a} {b}//{b} {c}//{c}")?,
            None => writeln!(writer, "f {a} {b} {c}")?,
        }
    }
    Ok(())
}

/// Largest index in faces, and its line. Faces may come before their vertices, so it is checked at the end.
#[derive(Default)]
struct Farthest {
    index: u32,
    line: u64,
}

impl Farthest {
    fn update(&mut self, index: u32, line: u64) {
        if self.line == 0 || index > self.index {
            *self = Self { index, line };
        }
    }

    /// Checks that the largest index is below `count`.
    fn check(&self, count: usize, what: &str) -> Result<()> {
        if self.line > 0 && self.index as usize >= count {
            return Err(Error::input(format!(
                "line {}: expected a {what} index from 1 to {count}, found {}",
                self.line,
                u64::from(self.index) + 1
            )));
        }
        Ok(())
    }
}

/// A file while it is read.
#[derive(Default)]
struct Obj {
    points: Vec<DVec3>,
    /// Colours of the first vertices; complete if there are as many as points.
    colours: Vec<[f32; 3]>,
    /// Line of the first vertex that is not finite.
    not_finite: Option<u64>,
    /// Every `vn`, in order.
    stated: Vec<DVec3>,
    /// Per vertex: the sum of its normals, and the index of the last one that was added.
    normals: Vec<(DVec3, u32)>,
    /// Pairs of vertex and normal that faces use before both are defined.
    pending: Vec<(u32, u32)>,
    triangles: Vec<[u32; 3]>,
    farthest_vertex: Farthest,
    farthest_normal: Farthest,
    unit: Option<Unit>,
    /// Corners of the current face.
    face: Vec<u32>,
    /// Reader of texture coordinates and parts; none if the caller does not need them.
    appearance: Option<AppearanceReader>,
    budget: Budget,
}

impl Obj {
    fn read<R: Read>(source: &mut Source<R>, appearance: Option<AppearanceReader>) -> Result<Self> {
        let mut obj = Self { appearance, budget: source.budget().clone(), ..Self::default() };
        let mut joined = Vec::new();
        loop {
            let number = source.line_number() + 1;
            let Some(mut line) = source.line()? else { break };
            if number == 1 {
                // Byte order mark, which some Windows programs put before UTF-8.
                line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line);
            }
            if let Some(part) = line.trim_ascii_end().strip_suffix(b"\\") {
                joined.extend_from_slice(part);
                joined.push(b' ');
                continue;
            }
            // Lines of old Macintosh files end with CR alone.
            if joined.is_empty() {
                line.split(|&b| b == b'\r').try_for_each(|line| obj.line(line, number))?;
            } else {
                joined.extend_from_slice(line);
                obj.line(&joined, number)?;
                joined.clear();
            }
        }
        if !joined.is_empty() {
            obj.line(&joined, source.line_number())?;
        }
        if obj.points.is_empty() {
            return Err(Error::input(format!(
                "expected vertices (lines `v x y z`), found none in {} lines",
                source.line_number()
            )));
        }
        // Only now are all vertices known.
        obj.farthest_vertex.check(obj.points.len(), "vertex")?;
        obj.farthest_normal.check(obj.stated.len(), "normal")?;
        // Normals that faces used before their definition are known now.
        for (vertex, normal) in std::mem::take(&mut obj.pending) {
            obj.add_normal(vertex, normal);
        }
        Ok(obj)
    }

    fn line(&mut self, line: &[u8], number: u64) -> Result<()> {
        let mut rest = match line.iter().position(|&b| b == b'#') {
            None => line,
            Some(at) => {
                if let Some(name) = line[at + 1..].strip_prefix(UNIT_COMMENT)
                    && line[..at].trim_ascii().is_empty()
                {
                    let name = std::str::from_utf8(name.trim_ascii()).unwrap_or_default();
                    // Comments are free text, so one that names no unit is not an error.
                    self.unit = name.parse().ok().or(self.unit);
                }
                &line[..at]
            }
        };
        match next_word(&mut rest) {
            Some(b"v") => {
                let point = three(&mut rest, number)?;
                if self.points.len() as u64 >= u64::from(NONE) {
                    return Err(Error::unsupported(format!(
                        "line {number}: expected at most {NONE} vertices, found more"
                    )));
                }
                // Kept for now, because faces refer to vertices by their number in the file; `mesh_of`
                // decides.
                if self.not_finite.is_none() && !point.is_finite() {
                    self.not_finite = Some(number);
                }
                self.take::<DVec3>(1, "vertices", number)?;
                if self.colours.len() == self.points.len()
                    && let Some(colour) = vertex_colour(rest)
                {
                    self.take::<[f32; 3]>(1, "colours", number)?;
                    self.colours.push(colour);
                }
                self.points.push(point);
            }
            Some(b"vn") => {
                // With the entry of `normals` that it may need.
                self.take::<(DVec3, DVec3, u64)>(1, "normals", number)?;
                self.stated.push(three(&mut rest, number)?);
            }
            // `fo` (face outline) is an older keyword, which version 3.0 of the format reads as `f`.
            Some(b"f" | b"fo") => self.face(rest, number)?,
            Some(keyword) => {
                if let Some(appearance) = &mut self.appearance {
                    // Names and texture coordinates are at most as long as their lines, except short ones.
                    let bytes = line.len().max(64) as u64;
                    self.budget.take_elements(1, bytes, format_args!("names (line {number})"))?;
                    appearance.line(keyword, rest, number)?;
                }
            }
            None => {}
        }
        Ok(())
    }

    /// Takes memory for elements of type `T`.
    fn take<T>(&self, count: u64, what: &str, line: u64) -> Result<()> {
        self.budget.take_elements(count, size_of::<T>() as u64, format_args!("{what} (line {line})"))
    }

    fn face(&mut self, mut rest: &[u8], line: u64) -> Result<()> {
        self.face.clear();
        while let Some(corner) = next_word(&mut rest) {
            // The separators are part of a corner, so each error shows the whole corner.
            let wrong = || {
                Error::input(format!(
                    "line {line}: expected a corner `vertex`, `vertex/texture`, `vertex//normal` or \
                     `vertex/texture/normal`, found {}",
                    shown(corner)
                ))
            };
            let mut parts = corner.split(|&b| b == b'/');
            let index = |part: &[u8], count: usize, what: &str| {
                let text = std::str::from_utf8(part).map_err(|_| wrong())?;
                let stated: i64 = text.parse().map_err(|_| wrong())?;
                // Negative indices count back from the last element defined so far.
                let from_zero = if stated < 0 { count as i64 + stated } else { stated - 1 };
                u32::try_from(from_zero).ok().filter(|&i| i != NONE).ok_or_else(|| {
                    Error::input(format!(
                        "line {line}: expected a {what} index of at least 1, or from -{count} to -1, found \
                         {stated}"
                    ))
                })
            };
            let vertex = index(parts.next().unwrap_or_default(), self.points.len(), "vertex")?;
            let texture = parts.next();
            let normal = match (parts.next(), parts.next()) {
                (None | Some(b""), None) => None,
                (Some(normal), None) => Some(index(normal, self.stated.len(), "normal")?),
                _ => return Err(wrong()),
            };
            // Otherwise the texture index is not parsed, so that a damaged one does not prevent reading the
            // shape.
            if let Some(appearance) = &mut self.appearance {
                let count = appearance.uv.len();
                let uv = match texture {
                    None | Some(b"") => None,
                    Some(part) => Some(index(part, count, "texture coordinate")?),
                };
                appearance.corner(self.face.len(), uv, line);
            }
            self.farthest_vertex.update(vertex, line);
            if let Some(normal) = normal {
                self.farthest_normal.update(normal, line);
                // Added at once if possible, because the list of pending pairs takes memory for every corner.
                if (vertex as usize) < self.points.len() && (normal as usize) < self.stated.len() {
                    self.add_normal(vertex, normal);
                } else {
                    self.take::<(u32, u32)>(1, "normals", line)?;
                    self.pending.push((vertex, normal));
                }
            }
            self.face.push(vertex);
        }
        if self.face.len() < 3 {
            return Err(too_few(line, self.face.len()));
        }
        let count = self.face.len() as u64 - 2;
        // Each triangle is listed in every part that it belongs to: a line may name a million groups.
        let lists = self.appearance.as_ref().map_or(0, |a| 3 + a.current_parts() as u64);
        let bytes = size_of::<[u32; 3]>() as u64 + lists * size_of::<u32>() as u64;
        self.budget.take_elements(count, bytes, format_args!("triangles (line {line})"))?;
        let at = |k: usize| self.points.get(self.face[k] as usize).copied();
        // Texture coordinates are split along the same lines.
        split_polygon(self.face.len(), at, |t| {
            self.triangles.push(t.map(|k| self.face[k]));
            if let Some(appearance) = &mut self.appearance {
                appearance.add_triangle(t);
            }
        });
        if let Some(appearance) = &mut self.appearance {
            appearance.finish_face(self.triangles.len());
        }
        Ok(())
    }

    /// Adds a normal to a vertex; both must exist. A normal that neighbouring faces repeat is added once, so
    /// that the sum does not depend on the number of faces of a smooth vertex.
    fn add_normal(&mut self, vertex: u32, normal: u32) {
        if self.normals.len() < self.points.len() {
            self.normals.resize(self.points.len(), (DVec3::ZERO, NONE));
        }
        let (sum, last) = &mut self.normals[vertex as usize];
        if *last != normal {
            *sum += self.stated[normal as usize];
            *last = normal;
        }
    }

    /// Columns `nx ny nz`, if there are normals, and `red green blue`, if all vertices have colours.
    fn columns(&mut self) -> Vec<(String, Vec<f64>)> {
        let mut columns = self.normal_columns();
        let colours = std::mem::take(&mut self.colours);
        if colours.len() == self.points.len() {
            columns.extend(["red", "green", "blue"].iter().enumerate().map(|(k, name)| {
                ((*name).to_owned(), colours.iter().map(|colour| f64::from(colour[k])).collect())
            }));
        }
        columns
    }

    /// Columns `nx ny nz`, if there are normals.
    fn normal_columns(&mut self) -> Vec<(String, Vec<f64>)> {
        let stated = std::mem::take(&mut self.stated);
        let mut of_faces = std::mem::take(&mut self.normals);
        let column = |k: usize, numbers: Vec<f64>| (["nx", "ny", "nz"][k].to_owned(), numbers);
        if !of_faces.is_empty() {
            of_faces.resize(self.points.len(), (DVec3::ZERO, NONE));
            return (0..3).map(|k| column(k, of_faces.iter().map(|(n, _)| n[k]).collect())).collect();
        }
        // Normals of point clouds are stated without faces.
        if stated.len() == self.points.len() {
            return (0..3).map(|k| column(k, stated.iter().map(|n| n[k]).collect())).collect();
        }
        Vec::new()
    }
}

/// The colour behind the position of a vertex, if there are three numbers. One number is a weight.
fn vertex_colour(mut rest: &[u8]) -> Option<[f32; 3]> {
    let mut colour = [0.0; 3];
    for share in &mut colour {
        *share = parse_number(next_word(&mut rest)?)? as f32;
    }
    next_word(&mut rest).is_none().then_some(colour)
}

fn too_few(line: u64, found: usize) -> Error {
    Error::input(format!("line {line}: expected at least three corners, found {found}"))
}

/// Parses the next three numbers of a line.
fn three(rest: &mut &[u8], line: u64) -> Result<DVec3> {
    let mut numbers = DVec3::ZERO;
    for (found, number) in numbers.as_mut().iter_mut().enumerate() {
        let word = next_word(rest)
            .ok_or_else(|| Error::input(format!("line {line}: expected 3 numbers, found {found}")))?;
        *number = parse_number(word)
            .ok_or_else(|| Error::input(format!("line {line}: expected a number, found {}", shown(word))))?;
    }
    Ok(numbers)
}

fn scan_from<R: Read>(source: &mut Source<R>, name: &str) -> Result<(Scan, Option<Unit>)> {
    let mut obj = Obj::read(source, None)?;
    // Freed early, because a scan needs only vertices.
    obj.triangles = Vec::new();
    let columns = obj.normal_columns();
    let scan = scan_of_vertices(obj.points.into_iter(), &columns, name, source.budget())?;
    Ok((scan, obj.unit))
}

fn mesh_from<R: Read>(source: &mut Source<R>) -> Result<PolygonMesh> {
    mesh_of(Obj::read(source, None)?)
}

fn mesh_of(mut obj: Obj) -> Result<PolygonMesh> {
    let mut columns = obj.columns();
    if let Some(line) = obj.not_finite {
        if !obj.triangles.is_empty() {
            return Err(Error::input(format!("line {line}: expected finite coordinates")));
        }
        // Without faces, no index refers to a vertex, so vertices can be removed.
        let finite: Vec<bool> = obj.points.iter().map(|p| p.is_finite()).collect();
        let kept = |vertex: &mut usize| {
            *vertex += 1;
            finite[*vertex - 1]
        };
        let mut vertex = 0;
        obj.points.retain(|_| kept(&mut vertex));
        for (_, column) in &mut columns {
            let mut vertex = 0;
            column.retain(|_| kept(&mut vertex));
        }
    }
    Ok(PolygonMesh { columns, points: obj.points, triangles: obj.triangles, unit: obj.unit })
}
