//! STL, the triangles of 3D printing: reads binary and ASCII files, writes binary files.
//!
//! **Input.** Triangles that each repeat their corners; equal corners become one vertex. The normal of a
//! facet is ignored, because the order of its corners defines it.
//!
//! **Output.** A [`PolygonMesh`] or a [`Scan`] of the vertices. Written files are binary.
//!
//! A binary file may begin with `solid` like an ASCII one. It is recognised by zero bytes near its start,
//! which text never contains.
//!
//! **Limits.** Binary files hold seven digits of a coordinate; [`rounding`] gives the resulting error. The
//! unit is read only from headers that Planish wrote, because the format defines none.
//!
//! # References
//! 3D Systems, *StereoLithography Interface Specification*, 1988.

#[cfg(test)]
mod tests;

use planish_core::vector3::coordinates;
use planish_core::{Budget, DVec3};
use std::collections::HashMap;
use std::io::{self, Read, Write};
use std::path::Path;

use planish_estimate::{Error, ErrorKind, Result};
use planish_sense::Scan;

use crate::Unit;
use crate::atomic::write_packed;
use crate::mesh_data::{MeshColumns, PolygonMesh, scan_of_vertices};
use crate::numbers::NumberType;
use crate::source::{Source, next_word, parse_number, read_file, shown};

/// Size of the header before the count of triangles; its content is free.
const HEADER: usize = 80;
/// Size of a triangle: twelve numbers of four bytes, and two bytes of attributes.
const RECORD: usize = 50;
/// Prefix of the unit in headers that Planish writes. It must not begin with `solid`, the mark of ASCII
/// files.
const UNIT_HEADER: &str = "Planish mesh, unit ";

/// Reads the vertices as points. Corners with a coordinate that is not finite are dropped and counted.
///
/// # Errors
/// [`Io`](ErrorKind::Io) when the file is missing or unreadable, [`Input`](ErrorKind::Input) when it is
/// malformed or cut off: with the file and the line (ASCII) or byte and triangle (binary).
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("one.stl");
/// std::fs::write(&path, "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n\
///     endloop\nendfacet\nendsolid\n")?;
/// assert_eq!(planish_exchange::stl::read_scan(&path)?.points.len(), 3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_scan(path: &Path) -> Result<Scan> {
    read_scan_and_unit(path).map(|(scan, _)| scan)
}

/// [`read_scan`], with the unit that the file states.
pub(crate) fn read_scan_and_unit(path: &Path) -> Result<(Scan, Option<Unit>)> {
    read_file(path, |mut source, name| scan_from(&mut source, name))
}

/// Reads a mesh; equal corners become one vertex.
///
/// # Errors
/// As [`read_scan`]; also for a coordinate that is not finite.
pub fn read_mesh(path: &Path) -> Result<PolygonMesh> {
    read_file(path, |mut source, _| mesh_from(&mut source))
}

/// Writes the triangles as a binary file. STL does not support columns and normals of vertices.
///
/// # Errors
/// [`Input`](ErrorKind::Input) for corners beyond the points, and for points outside the range of `float32`;
/// [`Unsupported`](ErrorKind::Unsupported) for more than 2³² triangles; [`Io`](ErrorKind::Io) when the file
/// cannot be written; nothing is left half-written.
pub fn write_mesh(path: &Path, mesh: &MeshColumns) -> Result<()> {
    let count = mesh.check(true).and_then(|()| check_size(mesh)).map_err(|e| e.in_context(path.display()))?;
    write_packed(path, |mut writer| write_to(&mut writer, mesh, count))
}

/// Maximum rounding error of a coordinate in a binary file: half the distance of neighbouring `float32`
/// numbers at the largest coordinate.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// // Coordinates of 1000 mm are rounded by at most 0.06 µm.
/// let error = planish_exchange::stl::rounding(&[1000.0 * DVec3::X]);
/// assert!(error > 5e-5 && error < 6e-5);
/// ```
#[must_use]
pub fn rounding(points: &[DVec3]) -> f64 {
    let largest = coordinates(points).iter().fold(0.0_f64, |m, c| m.max(c.abs()));
    f64::from(f32::EPSILON) / 2.0 * largest
}

/// Number of triangles, if the format can hold it and the points.
fn check_size(mesh: &MeshColumns) -> Result<u32> {
    let too_large = |p: &DVec3| p.to_array().iter().any(|&c| !(c as f32).is_finite());
    if let Some(at) = mesh.points.iter().position(too_large) {
        let DVec3 { x, y, z } = mesh.points[at];
        return Err(Error::input(format!(
            "vertex {at}: expected coordinates in the range of float32, found {x} {y} {z}"
        )));
    }
    u32::try_from(mesh.triangles.len()).map_err(|_| {
        Error::new(
            ErrorKind::Unsupported,
            "expected at most 2³² triangles, the limit of STL: write PLY instead",
        )
    })
}

fn write_to(writer: &mut impl Write, mesh: &MeshColumns, count: u32) -> io::Result<()> {
    let mut header = [b' '; HEADER];
    let text = match mesh.unit {
        Some(unit) => format!("{UNIT_HEADER}{unit}"),
        None => "Planish mesh".to_owned(),
    };
    header[..text.len()].copy_from_slice(text.as_bytes());
    writer.write_all(&header)?;
    writer.write_all(&count.to_le_bytes())?;
    for triangle in mesh.triangles {
        let corners = triangle.map(|v| mesh.points[v as usize]);
        let [a, b, c] = corners;
        // A degenerate triangle has no normal and gets zero.
        let normal = (b - a).cross(c - a).normalize_or_zero();
        // The last two bytes, the attributes, stay 0: programs disagree on the colours that they encode
        // there.
        let mut record = [0; RECORD];
        let numbers = normal.as_ref().iter().chain(coordinates(&corners));
        for (bytes, number) in record.chunks_exact_mut(4).zip(numbers) {
            bytes.copy_from_slice(&(*number as f32).to_le_bytes());
        }
        writer.write_all(&record)?;
    }
    Ok(())
}

/// Triangles and merged vertices while a file is read.
struct Soup {
    vertices: HashMap<[u64; 3], u32>,
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Number of corners that are not finite, and the position of the first.
    dropped: usize,
    first_dropped: Option<String>,
    unit: Option<Unit>,
    budget: Budget,
}

/// Memory of a vertex in bytes: its point, and its entry in the map, which is at least half full.
const VERTEX_BYTES: u64 = (size_of::<DVec3>() + 2 * size_of::<([u64; 3], u32)>()) as u64;

impl Soup {
    fn new(budget: &Budget) -> Self {
        Self {
            vertices: HashMap::new(),
            points: Vec::new(),
            triangles: Vec::new(),
            dropped: 0,
            first_dropped: None,
            unit: None,
            budget: budget.clone(),
        }
    }

    fn read<R: Read>(source: &mut Source<R>) -> Result<Self> {
        let mut soup = Self::new(source.budget());
        // Header, count and first triangle: a binary file has a zero byte among them.
        let head = source.peek(HEADER + 4 + RECORD)?;
        let text = head.trim_ascii_start();
        // Some programs write blanks before `solid`, or capitals.
        let solid = text.len() >= 5 && text[..5].eq_ignore_ascii_case(b"solid");
        if solid && !head.contains(&0) {
            soup.read_text(source)?;
        } else {
            soup.read_binary(source)?;
        }
        if soup.triangles.is_empty() && soup.dropped == 0 {
            return Err(Error::input("expected triangles, found none"));
        }
        Ok(soup)
    }

    fn read_binary<R: Read>(&mut self, source: &mut Source<R>) -> Result<()> {
        let Some(header) = source.bytes(HEADER + 4)? else {
            return Err(Error::input(format!(
                "expected a header of {} bytes, or text that begins with `solid`: the file is cut off or not \
                 an STL file",
                HEADER + 4
            )));
        };
        let (header, count) = header.split_at(HEADER);
        let named = header.strip_prefix(UNIT_HEADER.as_bytes());
        self.unit = named.and_then(|name| std::str::from_utf8(name).ok()?.trim_ascii().parse().ok());
        let count = NumberType::U32.decode::<false>(count) as u64;
        // The count has 32 bits, so the product cannot overflow.
        source.check_promise(count, "triangles", count * RECORD as u64)?;
        // The length of a compressed file is unknown, so the reservation is limited as well.
        self.triangles.reserve(source.reserve(count, RECORD as u64));
        for triangle in 0..count {
            let byte = source.offset();
            let Some(record) = source.bytes(RECORD)? else {
                return Err(Error::input(format!(
                    "byte {byte}: the file ends here: it is cut off ({count} triangles declared, {triangle} \
                     found)"
                )));
            };
            let mut corners = [DVec3::ZERO; 3];
            for (number, bytes) in
                corners.iter_mut().flat_map(|p| p.as_mut()).zip(record[12..].chunks_exact(4))
            {
                *number = NumberType::F32.decode::<false>(bytes);
            }
            self.push(&corners, format_args!("byte {byte} (triangle {triangle})"))?;
        }
        Ok(())
    }

    fn read_text<R: Read>(&mut self, source: &mut Source<R>) -> Result<()> {
        let mut corners: Vec<DVec3> = Vec::new();
        let mut ended = false;
        loop {
            let number = source.line_number() + 1;
            let Some(mut line) = source.line()? else { break };
            while let Some(word) = next_word(&mut line) {
                // Words are read one by one, so that line breaks do not matter.
                match word.to_ascii_lowercase().as_slice() {
                    // The rest of the line is a name, which may contain any words.
                    b"solid" => {
                        // Several solids may follow each other; the last one shows whether the file is
                        // complete.
                        ended = false;
                        line = &[];
                    }
                    b"endsolid" => {
                        ended = true;
                        line = &[];
                    }
                    b"facet" => {
                        // The word `normal` and three numbers, which are not used.
                        for _ in 0..4 {
                            next_word(&mut line);
                        }
                    }
                    b"outer" | b"loop" | b"endfacet" => {}
                    b"vertex" => {
                        let mut point = DVec3::ZERO;
                        for (found, coordinate) in point.as_mut().iter_mut().enumerate() {
                            let word = next_word(&mut line).ok_or_else(|| {
                                Error::input(format!("line {number}: expected 3 numbers, found {found}"))
                            })?;
                            *coordinate = parse_number(word).ok_or_else(|| {
                                Error::input(format!(
                                    "line {number}: expected a number, found {}",
                                    shown(word)
                                ))
                            })?;
                        }
                        corners.push(point);
                    }
                    b"endloop" => {
                        let [a, b, c] = corners[..] else {
                            return Err(Error::input(format!(
                                "line {number}: expected three corners per facet, found {}",
                                corners.len()
                            )));
                        };
                        self.push(&[a, b, c], format_args!("line {number}"))?;
                        corners.clear();
                    }
                    _ => {
                        return Err(Error::input(format!(
                            "line {number}: expected `facet`, `outer loop`, `vertex`, `endloop`, `endfacet` \
                             or `endsolid`, found {}",
                            shown(word)
                        )));
                    }
                }
            }
        }
        // Without this check, a truncated text file would be read as a smaller mesh.
        if !ended {
            return Err(Error::input(format!(
                "line {}: the file ends before `endsolid`: it is cut off",
                source.line_number()
            )));
        }
        Ok(())
    }

    fn push(&mut self, corners: &[DVec3; 3], place: std::fmt::Arguments) -> Result<()> {
        let mut triangle = [0; 3];
        let mut is_complete = true;
        for (index, corner) in triangle.iter_mut().zip(corners) {
            if !corner.is_finite() {
                // The other corners are still points of a scan.
                is_complete = false;
                self.dropped += 1;
                self.first_dropped.get_or_insert_with(|| place.to_string());
                continue;
            }
            let next = u32::try_from(self.points.len()).map_err(|_| {
                Error::new(
                    ErrorKind::Unsupported,
                    "expected at most 2³² vertices, found more: split the mesh",
                )
            })?;
            // Adding zero turns −0 into +0, so that both are one key.
            *index = *self.vertices.entry(corner.to_array().map(|c| (c + 0.0).to_bits())).or_insert(next);
            if *index == next {
                self.budget.take_elements(1, VERTEX_BYTES, format_args!("vertices ({place})"))?;
                self.points.push(*corner);
            }
        }
        if is_complete {
            let bytes = size_of::<[u32; 3]>() as u64;
            self.budget.take_elements(1, bytes, format_args!("triangles ({place})"))?;
            self.triangles.push(triangle);
        }
        Ok(())
    }
}

fn scan_from<R: Read>(source: &mut Source<R>, name: &str) -> Result<(Scan, Option<Unit>)> {
    let soup = Soup::read(source)?;
    let mut scan = scan_of_vertices(soup.points.into_iter(), &[], name, source.budget())?;
    scan.dropped_not_finite = soup.dropped;
    Ok((scan, soup.unit))
}

fn mesh_from<R: Read>(source: &mut Source<R>) -> Result<PolygonMesh> {
    let soup = Soup::read(source)?;
    match soup.first_dropped {
        Some(place) => Err(Error::input(format!("{place}: expected finite coordinates"))),
        None => Ok(PolygonMesh {
            points: soup.points,
            triangles: soup.triangles,
            columns: Vec::new(),
            unit: soup.unit,
        }),
    }
}
