//! Triangle meshes in any of the formats, by the file's extension: PLY, OBJ, STL, OFF and GLB.
//!
//! Comes in: a path. Goes out: a [`PolygonMesh`]; or a file that holds what its format can of
//! [`MeshColumns`].
//!
//! | format | written | read |
//! |---|---|---|
//! | PLY | `float64` positions, normals, every column, the unit | the same |
//! | OBJ | all digits of positions and normals, the unit in a comment | the same |
//! | STL | `float32` positions, the unit in the header | equal vertices become one |
//! | OFF | all digits of positions | polygons; the unit and columns have no place |
//! | GLB | `float32` positions about an offset, normals, columns; metres | the same |
//! | STEP | surfaces, by [`crate::step`] | triangles of all faces, by [`crate::step::read_step`] |
//!
//! Not guaranteed: that columns survive OBJ and STL, which have no place for them.

use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::Scan;

use crate::Unit;
use crate::points::{PointCollector, PointColumns};
use crate::source::{extension, found_extension};

/// Triangles with named numbers at their vertices, as a file holds them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PolygonMesh {
    /// Positions, in the file's unit; all finite.
    pub points: Vec<[f64; 3]>,
    /// Indices of the corners, all below `points.len()`. A polygon is cut into the fan of its first corner.
    pub triangles: Vec<[u32; 3]>,
    /// The other plain vertex properties, in the file's order: a name and one number a vertex (maybe not
    /// finite).
    pub columns: Vec<(String, Vec<f64>)>,
    /// The unit of length, where the file names it.
    pub unit: Option<Unit>,
}

impl PolygonMesh {
    /// The numbers of a vertex property.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|(n, _)| n == name).map(|(_, c)| c.as_slice())
    }
}

/// One number for each vertex.
#[derive(Debug, Clone, Copy)]
pub enum Column<'a> {
    /// Written as 64-bit floating point where the format has it.
    F64(&'a [f64]),
    /// Written as bytes where the format has them.
    U8(&'a [u8]),
}

impl Column<'_> {
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::F64(values) => values.len(),
            Self::U8(values) => values.len(),
        }
    }

    /// The number of one vertex.
    pub(crate) fn at(&self, vertex: usize) -> f64 {
        match self {
            Self::F64(values) => values[vertex],
            Self::U8(values) => f64::from(values[vertex]),
        }
    }
}

/// What a mesh file holds.
///
/// The mesh of a fit has normals and the columns `sigma` ([`Column::F64`], along the normal) and `observed`
/// ([`Column::U8`]: 1 measured, 0 prior only, 2 completed).
#[derive(Debug, Clone, Default)]
pub struct MeshColumns<'a> {
    /// Positions.
    pub points: &'a [[f64; 3]],
    /// Normals `nx ny nz`, one for each point.
    pub normals: Option<&'a [[f64; 3]]>,
    /// Further columns: a name without blanks and one number for each point.
    pub columns: Vec<(&'a str, Column<'a>)>,
    /// Corners of triangles.
    pub triangles: &'a [[u32; 3]],
    /// Unit of length.
    pub unit: Option<Unit>,
}

impl MeshColumns<'_> {
    /// Whether columns are of one length and of different names, and corners (where `faces` are wanted) name
    /// points.
    pub(crate) fn check(&self, faces: bool) -> Result<()> {
        let points = self.points.len();
        let normals = self.normals.map(|n| ("normals", n.len()));
        let columns = self.columns.iter().map(|(name, column)| (*name, column.len()));
        for (name, length) in columns.clone().chain(normals) {
            if length != points {
                return Err(Error::input(format!(
                    "needed {points} entries in the column `{name}`, found {length}"
                )));
            }
        }
        let mut names: Vec<&str> = vec!["x", "y", "z"];
        if self.normals.is_some() {
            names.extend(["nx", "ny", "nz"]);
        }
        for (name, _) in columns {
            let word = !name.is_empty() && name.bytes().all(|b| b.is_ascii_graphic());
            if !word || names.contains(&name) {
                return Err(Error::input(format!(
                    "the column name {name:?}: needed one word that no other column has"
                )));
            }
            names.push(name);
        }
        if faces {
            let limit = points.min(i32::MAX as usize);
            if let Some(at) = self.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= limit)) {
                return Err(Error::input(format!(
                    "triangle {at}: needed indices below {limit}, found {:?}",
                    self.triangles[at]
                )));
            }
        }
        Ok(())
    }

    /// The column of a name.
    pub(crate) fn column(&self, name: &str) -> Option<Column<'_>> {
        self.columns.iter().find(|(n, _)| *n == name).map(|(_, column)| *column)
    }
}

/// Whether a path's extension is that of a format that holds meshes: `ply`, `obj`, `stl`, `off` or `glb`,
/// maybe behind gzip.
#[must_use]
pub fn is_mesh_file(path: &Path) -> bool {
    matches!(extension(path).as_str(), "ply" | "obj" | "stl" | "off" | "glb")
}

/// Whether a path's extension is that of a format of which faces are read: those of meshes, `step` and `stp`.
#[must_use]
pub fn has_faces(path: &Path) -> bool {
    is_mesh_file(path) || is_step_file(path)
}

/// Whether a path's extension is `step` or `stp`, maybe behind gzip.
#[must_use]
pub fn is_step_file(path: &Path) -> bool {
    matches!(extension(path).as_str(), "step" | "stp")
}

/// Reads a mesh of any format; one without faces has no triangles. Faces of STEP files are cut into triangles
/// that miss them by a ten thousandth of the size.
///
/// # Errors
/// As the format's reader; [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for other extensions,
/// and where a face of a STEP file cannot be read.
pub fn read_mesh(path: &Path) -> Result<PolygonMesh> {
    match extension(path).as_str() {
        "ply" => crate::ply::read_mesh(path),
        "obj" => crate::obj::read_mesh(path),
        "stl" => crate::stl::read_mesh(path),
        "off" => crate::off::read_mesh(path),
        "glb" => crate::glb::read_mesh(path),
        "step" | "stp" => crate::step::read_mesh(path),
        _ => Err(unsupported(path, ", step")),
    }
}

/// Writes a mesh in the format of the path's extension, compressed where it ends with `.gz`.
///
/// # Errors
/// As the format's writer; [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for other extensions.
///
/// # Examples
/// ```
/// use planish_exchange::mesh::{MeshColumns, read_mesh, write_mesh};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("one.stl");
/// write_mesh(&path, &MeshColumns {
///     points: &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
///     triangles: &[[0, 1, 2]],
///     ..MeshColumns::default()
/// })?;
/// assert_eq!(read_mesh(&path)?.triangles, [[0, 1, 2]]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_mesh(path: &Path, mesh: &MeshColumns) -> Result<()> {
    match extension(path).as_str() {
        "ply" => crate::ply::write_mesh(path, mesh),
        "obj" => crate::obj::write_mesh(path, mesh),
        "stl" => crate::stl::write_mesh(path, mesh),
        "off" => crate::off::write_mesh(path, mesh),
        "glb" => crate::glb::write_mesh(path, mesh),
        _ => Err(unsupported(path, "")),
    }
}

fn unsupported(path: &Path, more: &str) -> Error {
    Error::unsupported(format!(
        "{}: needed a mesh (ply, obj, stl, off, glb{more}), found {}",
        path.display(),
        found_extension(path)
    ))
}

/// The vertices as points of a scan, with what columns say of their errors and normals.
pub(crate) fn scan_of_vertices(
    points: impl ExactSizeIterator<Item = [f64; 3]>,
    columns: &[(String, Vec<f64>)],
    name: &str,
) -> Result<Scan> {
    let names: Vec<&str> =
        ["x", "y", "z"].into_iter().chain(columns.iter().map(|(name, _)| name.as_str())).collect();
    let mut collector = PointCollector::new(PointColumns::find(&names)?, points.len());
    let mut record = Vec::with_capacity(names.len());
    for (vertex, point) in points.enumerate() {
        record.clear();
        record.extend(point);
        record.extend(columns.iter().map(|(_, column)| column[vertex]));
        collector.push(&record, format_args!("vertex {vertex}"))?;
    }
    Ok(collector.finish(name).0)
}
