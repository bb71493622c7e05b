//! OFF, the object file format of Geomview: vertices and polygons.
//!
//! **Input.** `OFF` (or `COFF`, `NOFF`, `STOFF` and combinations; values after a position are ignored), three
//! counts, one line per vertex, and one line per polygon: the number of corners, their indices from 0, and
//! optionally a colour. Polygons are split into triangles; `#` begins a comment.
//!
//! **Output.** A [`PolygonMesh`]. Written files keep every digit.
//!
//! **Limits.** Several vertices or polygons in one line, binary files and four-dimensional vertices are not
//! supported. The format has no unit.
//!
//! # References
//! Phillips et al., *Geomview manual*, The Geometry Center, 1993.

use planish_core::DVec3;
use std::io::Read;
use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::Scan;

use crate::atomic::write_packed;
use crate::mesh_data::{MeshColumns, PolygonMesh, scan_of_vertices};
use crate::polygon::split_polygon;
use crate::source::{Source, next_word, parse_number, read_file, shown};

/// Length of the shortest line of a vertex, `0 0 0`, with its end.
const MIN_VERTEX_BYTES: u64 = 6;
/// Length of the shortest line of a polygon, `0`, with its end.
const MIN_POLYGON_BYTES: u64 = 2;

/// Reads a mesh.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable;
/// [`Input`](planish_estimate::ErrorKind::Input) for counts that the file cannot hold, words that are no
/// numbers, coordinates that are not finite, and corners that do not exist: with file and line;
/// [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for binary files and four dimensions.
pub fn read_mesh(path: &Path) -> Result<PolygonMesh> {
    read_file(path, |mut source, _| mesh_from(&mut source))
}

/// Reads the vertices as points of a scan.
///
/// # Errors
/// As [`read_mesh`].
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("cloud.off");
/// std::fs::write(&path, "OFF\n2 0 0\n1 2 3\n4 5 6\n")?;
/// let scan = planish_exchange::off::read_scan(&path)?;
/// assert_eq!(scan.points, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_scan(path: &Path) -> Result<Scan> {
    read_file(path, |mut source, name| {
        let points = mesh_from(&mut source)?.points;
        scan_of_vertices(points.into_iter(), &[], name, source.budget())
    })
}

/// Writes positions and triangles. OFF does not support columns, normals and units.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) for corners beyond the points;
/// [`Io`](planish_estimate::ErrorKind::Io) when the file cannot be written; nothing is left half-written.
pub fn write_mesh(path: &Path, mesh: &MeshColumns) -> Result<()> {
    mesh.check(true).map_err(|e| e.in_context(path.display()))?;
    write_packed(path, |writer| {
        writeln!(writer, "OFF\n{} {} 0", mesh.points.len(), mesh.triangles.len())?;
        for DVec3 { x, y, z } in mesh.points {
            writeln!(writer, "{x:?} {y:?} {z:?}")?;
        }
        for [a, b, c] in mesh.triangles {
            writeln!(writer, "3 {a} {b} {c}")?;
        }
        Ok(())
    })
}

/// Reads the next line that is neither blank nor a comment into `buffer`; returns its number.
fn line<'a, R: Read>(source: &'a mut Source<R>, buffer: &'a mut Vec<u8>, wanted: &str) -> Result<u64> {
    loop {
        let number = source.line_number() + 1;
        let Some(line) = source.line()? else {
            return Err(Error::input(format!("line {number}: expected {wanted}, found the end of the file")));
        };
        let line = line.split(|&b| b == b'#').next().unwrap_or_default().trim_ascii();
        if !line.is_empty() {
            buffer.clear();
            buffer.extend_from_slice(line);
            return Ok(number);
        }
    }
}

fn mesh_from<R: Read>(source: &mut Source<R>) -> Result<PolygonMesh> {
    let mut buffer = Vec::new();
    let number = line(source, &mut buffer, "`OFF`")?;
    let mut rest = &buffer[..];
    let word = next_word(&mut rest).unwrap_or_default().to_vec();
    let kind = word.strip_suffix(b"OFF").unwrap_or(b"?");
    // Prefixes: texture coordinates (ST), colours (C) and normals (N); `4` and `n` mean more dimensions.
    if kind.iter().any(|b| !b"STCN".contains(b)) {
        let message = format!("line {number}: expected `OFF`, found {}", shown(&word));
        return Err(match kind {
            [b'4' | b'n', ..] => Error::unsupported(message),
            _ => Error::input(message),
        });
    }
    if rest.trim_ascii() == b"BINARY" {
        return Err(Error::unsupported(format!(
            "line {number}: expected an ASCII file, found a binary OFF file"
        )));
    }
    let mut counts = rest.trim_ascii().to_vec();
    let mut at = number;
    if counts.is_empty() {
        at = line(source, &mut buffer, "the numbers of vertices, polygons and edges")?;
        counts.clone_from(&buffer);
    }
    let mut rest = &counts[..];
    // The third count, of edges, is not read, because nothing needs it.
    let [vertices, polygons] =
        [unsigned(&mut rest, at, "a number of vertices")?, unsigned(&mut rest, at, "a number of polygons")?];
    let of_vertices = vertices.saturating_mul(MIN_VERTEX_BYTES);
    let of_polygons = polygons.saturating_mul(MIN_POLYGON_BYTES);
    for (count, what, needed) in
        [(vertices, "vertices", of_vertices), (polygons, "polygons", of_vertices.saturating_add(of_polygons))]
    {
        // The last line of a file may lack its end.
        let checked = source.check_promise(count, what, needed.saturating_sub(1));
        checked.map_err(|e| e.in_context(format_args!("line {at}")))?;
    }
    if vertices > u64::from(u32::MAX) {
        return Err(Error::unsupported(format!(
            "line {at}: expected at most {} vertices, found more",
            u32::MAX
        )));
    }
    let budget = source.budget().clone();
    let mut points = Vec::with_capacity(source.reserve(vertices, MIN_VERTEX_BYTES));
    for _ in 0..vertices {
        let at = line(source, &mut buffer, "a vertex")?;
        budget.take_elements(1, size_of::<DVec3>() as u64, format_args!("vertices (line {at})"))?;
        let mut rest = &buffer[..];
        let mut point = DVec3::ZERO;
        for x in point.as_mut() {
            let word = next_word(&mut rest).unwrap_or_default();
            *x = (parse_number(word).filter(|x| x.is_finite())).ok_or_else(|| {
                Error::input(format!("line {at}: expected a finite coordinate, found {}", shown(word)))
            })?;
        }
        points.push(point);
    }
    let mut triangles: Vec<[u32; 3]> = Vec::with_capacity(source.reserve(polygons, MIN_POLYGON_BYTES));
    let mut corners: Vec<u32> = Vec::new();
    for _ in 0..polygons {
        let at = line(source, &mut buffer, "a polygon")?;
        let mut rest = &buffer[..];
        let count = unsigned(&mut rest, at, "a number of corners")?;
        // Each corner takes at least one byte of the line, so a larger count is damage.
        if count > buffer.len() as u64 {
            return Err(Error::input(format!(
                "line {at}: expected {count} corners, found the end of the line"
            )));
        }
        corners.clear();
        for _ in 0..count {
            let corner = unsigned(&mut rest, at, "the index of a vertex")?;
            if corner >= vertices {
                return Err(Error::input(format!(
                    "line {at}: expected the index of a vertex below {vertices}, found {corner}"
                )));
            }
            corners.push(corner as u32);
        }
        // Some programs write points and segments as polygons of one or two corners; they give no triangle.
        if let [_, others @ ..] = &corners[..] {
            let bytes = size_of::<[u32; 3]>() as u64;
            budget.take_elements(others.len() as u64, bytes, format_args!("triangles (line {at})"))?;
            let at = |k: usize| points.get(corners[k] as usize).copied();
            split_polygon(corners.len(), at, |t| triangles.push(t.map(|k| corners[k])));
        }
    }
    Ok(PolygonMesh { points, triangles, ..PolygonMesh::default() })
}

fn unsigned(rest: &mut &[u8], line: u64, what: &str) -> Result<u64> {
    let word = next_word(rest).unwrap_or_default();
    let text = std::str::from_utf8(word).unwrap_or_default();
    (text.parse()).map_err(|_| Error::input(format!("line {line}: expected {what}, found {}", shown(word))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<PolygonMesh> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.off");
        std::fs::write(&path, text).unwrap();
        read_mesh(&path)
    }

    #[test]
    fn written_meshes_read_back_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.off");
        let points = [DVec3::new(0.0, 0.1, 1e-17), DVec3::X, DVec3::new(0.0, 1.0, -0.3)];
        let mesh = MeshColumns { points: &points, triangles: &[[0, 1, 2]], ..MeshColumns::default() };
        write_mesh(&path, &mesh).unwrap();
        let found = read_mesh(&path).unwrap();
        assert_eq!((found.points, found.triangles), (points.to_vec(), vec![[0, 1, 2]]));
    }

    #[test]
    fn colours_comments_and_polygons_are_accepted() {
        let found =
            read("COFF 4 1 0 # counts\n\n0 0 0 255 0 0 255\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3 0.5 0.5 0.5\n")
                .unwrap();
        assert_eq!(found.triangles, [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn errors_name_the_line() {
        for (text, wanted) in [
            ("PLY\n", "line 1: expected `OFF`"),
            ("4OFF\n", "line 1"),
            ("OFF BINARY\n", "binary"),
            ("OFF\n3 x 0\n", "line 2: expected a number of polygons"),
            ("OFF\n3000000 1 0\n", "line 2: the header declares 3000000 vertices"),
            // Fewer bytes follow than these vertices, and then these polygons, take.
            ("OFF\n4 0 0\n0 0 0\n0 0 0\n", "line 2: the header declares 4 vertices, which take at least 23"),
            (
                "OFF\n1 9 0\n0 0 0\n1 0\n1 0\n",
                "line 2: the header declares 9 polygons, which take at least 23",
            ),
            ("OFF\n1 0 0\n0 nan 0\n", "line 3: expected a finite coordinate"),
            ("OFF\n1 1 0\n0 0 0\n\n\n", "line 6: expected a polygon, found the end of the file"),
            ("OFF\n1 1 0\n0 0 0\n3 0 0 1\n", "line 4: expected the index of a vertex below 1, found 1"),
            ("OFF\n1 1 0\n0 0 0\n99 0 0 0\n", "line 4: expected 99 corners"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(wanted), "{text:?}: {error}");
        }
    }
}
