//! Mesh types shared by all formats: [`PolygonMesh`] is what readers return, [`MeshColumns`] what writers
//! take.

use crate::Unit;
use crate::points::{PointCollector, PointColumns};
use planish_core::{Budget, DVec3};
use planish_estimate::{Error, Result};
use planish_sense::Scan;

/// A triangle mesh with named columns of numbers at its vertices, as read from a file.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::mesh::PolygonMesh;
/// let mesh = PolygonMesh {
///     points: vec![DVec3::ZERO],
///     columns: vec![("sigma".to_owned(), vec![0.5])],
///     ..PolygonMesh::default()
/// };
/// assert_eq!(mesh.column("sigma"), Some(&[0.5][..]));
/// assert_eq!(mesh.column("nx"), None);
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PolygonMesh {
    /// Positions, in the file's unit; all finite.
    pub points: Vec<DVec3>,
    /// Indices of the corners, all below `points.len()`. Polygons are split into triangles.
    pub triangles: Vec<[u32; 3]>,
    /// Further vertex properties in the order of the file: a name and one number per vertex, which may be not
    /// finite.
    pub columns: Vec<(String, Vec<f64>)>,
    /// The unit of length, if the file states it.
    pub unit: Option<Unit>,
}

impl PolygonMesh {
    /// Returns the values of a vertex property.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|(n, _)| n == name).map(|(_, c)| c.as_slice())
    }
}

/// One number per vertex.
#[derive(Debug, Clone, Copy)]
pub enum Column<'a> {
    /// Written as 64-bit floating-point numbers if the format supports them.
    F64(&'a [f64]),
    /// Written as bytes if the format supports them.
    U8(&'a [u8]),
}

impl Column<'_> {
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::F64(values) => values.len(),
            Self::U8(values) => values.len(),
        }
    }

    /// Value at one vertex.
    pub(crate) fn at(&self, vertex: usize) -> f64 {
        match self {
            Self::F64(values) => values[vertex],
            Self::U8(values) => f64::from(values[vertex]),
        }
    }
}

/// A mesh to be written.
///
/// The mesh of a fit has normals and the columns `sigma` ([`Column::F64`], along the normal) and `observed`
/// ([`Column::U8`]: 1 measured, 0 prior only, 2 completed).
#[derive(Debug, Clone, Default)]
pub struct MeshColumns<'a> {
    /// Positions.
    pub points: &'a [DVec3],
    /// Unit normals, one per point; written as `nx ny nz`.
    pub normals: Option<&'a [DVec3]>,
    /// Further columns: a name without blanks, and one number per point.
    pub columns: Vec<(&'a str, Column<'a>)>,
    /// Indices of the corners of each triangle.
    pub triangles: &'a [[u32; 3]],
    /// Unit of length.
    pub unit: Option<Unit>,
}

impl MeshColumns<'_> {
    /// Checks that columns have one length and different names and, if `faces`, that corners are valid
    /// indices.
    pub(crate) fn check(&self, faces: bool) -> Result<()> {
        let points = self.points.len();
        let normals = self.normals.map(|n| ("normals", n.len()));
        let columns = self.columns.iter().map(|(name, column)| (*name, column.len()));
        for (name, length) in columns.clone().chain(normals) {
            if length != points {
                return Err(Error::input(format!(
                    "expected {points} entries in the column `{name}`, found {length}"
                )));
            }
        }
        let mut names: Vec<&str> = vec!["x", "y", "z"];
        if self.normals.is_some() {
            names.extend(["nx", "ny", "nz"]);
        }
        for (name, _) in columns {
            // A PLY header separates its words by blanks, so a blank in a name would change the meaning of
            // the line.
            let word = !name.is_empty() && name.bytes().all(|b| b.is_ascii_graphic());
            if !word || names.contains(&name) {
                return Err(Error::input(format!(
                    "the column name {name:?}: expected one word that no other column uses"
                )));
            }
            names.push(name);
        }
        if faces {
            // PLY files store corners as signed 32-bit integers.
            let limit = points.min(i32::MAX as usize);
            if let Some(at) = self.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= limit)) {
                return Err(Error::input(format!(
                    "triangle {at}: expected indices below {limit}, found {:?}",
                    self.triangles[at]
                )));
            }
        }
        Ok(())
    }

    /// Returns a column by name.
    pub(crate) fn column(&self, name: &str) -> Option<Column<'_>> {
        self.columns.iter().find(|(n, _)| *n == name).map(|(_, column)| *column)
    }
}

/// Turns vertices into the points of a scan, with the uncertainties and normals of their columns.
pub(crate) fn scan_of_vertices(
    points: impl ExactSizeIterator<Item = DVec3>,
    columns: &[(String, Vec<f64>)],
    name: &str,
    budget: &Budget,
) -> Result<Scan> {
    let names: Vec<&str> =
        ["x", "y", "z"].into_iter().chain(columns.iter().map(|(name, _)| name.as_str())).collect();
    let mut collector = PointCollector::new(PointColumns::find(&names)?, points.len(), budget);
    // One buffer for all vertices: the collector copies what it keeps.
    let mut record = Vec::with_capacity(names.len());
    for (vertex, point) in points.enumerate() {
        record.clear();
        record.extend(point.to_array());
        record.extend(columns.iter().map(|(_, column)| column[vertex]));
        collector.push(&record, format_args!("vertex {vertex}"))?;
    }
    Ok(collector.finish(name).0)
}
