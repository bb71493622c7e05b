//! Reads scans and meshes from PLY files.

use planish_core::DVec3;
use std::io::Read;
use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::{RangeGrid, Scan, Viewing};

use super::body::{Place, Row, check_count, read_rows, refuse_more, skip_rows};
use super::header::{Element, Encoding, Header, read_header};
use crate::Unit;
use crate::mesh_data::PolygonMesh;
use crate::points::{PointCollector, PointColumns};
use crate::polygon::split_polygon;
use crate::source::{Source, read_file};

/// Reads the points of a scan with their uncertainties, normals and sampling grid.
///
/// Vertex properties: `x y z`; `sigma` or `cxx cxy cxz cyy cyz czz`; `nx ny nz`; `sigma_n_deg`. An element
/// `range_grid` (a list `vertex_indices` of none or one vertex per cell, row by row, with `obj_info num_cols`
/// and `num_rows`) gives the sampling grid. `obj_info is_cyberware_data 1` means that the scanner looked
/// along −z of its own frame. Vertices whose coordinates are not finite are dropped and counted, and the grid
/// is renumbered. The pose is the identity.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable,
/// [`Input`](planish_estimate::ErrorKind::Input) when it is malformed, cut off, longer than its header
/// promises, or states a σ or covariance that is not positive: with the file and the line (ASCII) or byte and
/// index (binary).
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("scan.ply");
/// std::fs::write(&path, "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
///     property float z\nproperty float sigma\nend_header\n1 2 3 0.5\n")?;
/// let scan = planish_exchange::ply::read_scan(&path)?;
/// assert_eq!((scan.points, scan.sigma), (vec![DVec3::new(1.0, 2.0, 3.0)], Some(vec![0.5])));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_scan(path: &Path) -> Result<Scan> {
    read_scan_and_unit(path).map(|(scan, _)| scan)
}

/// [`read_scan`], with the unit that the file states.
pub(crate) fn read_scan_and_unit(path: &Path) -> Result<(Scan, Option<Unit>)> {
    read_file(path, |mut source, name| scan_from(&mut source, name))
}

/// Reads a mesh.
///
/// The vertex properties `x y z` are required. Without an element `face` with a list `vertex_indices` (or
/// `vertex_index`), the mesh has no triangles.
///
/// # Errors
/// As [`read_scan`]; also for a coordinate that is not finite, an index beyond the vertices, and a face of
/// fewer than three corners.
pub fn read_mesh(path: &Path) -> Result<PolygonMesh> {
    read_file(path, |mut source, _| mesh_from(&mut source))
}

/// Content of a PLY file according to its header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlyContents {
    /// `ascii`, `binary_little_endian` or `binary_big_endian`.
    pub encoding: &'static str,
    /// Elements: name, number of records, and names of the properties.
    pub elements: Vec<(String, u64, Vec<String>)>,
    /// The unit of length, if a line `comment unit mm` states it.
    pub unit: Option<Unit>,
}

impl PlyContents {
    /// Number of records of an element; 0 if the file does not have it.
    #[must_use]
    pub fn count(&self, element: &str) -> u64 {
        let found = self.elements.iter().find(|(name, ..)| name == element);
        found.map_or(0, |(_, count, _)| *count)
    }

    /// Names of the properties of an element; empty if the file does not have it.
    #[must_use]
    pub fn properties(&self, element: &str) -> &[String] {
        let found = self.elements.iter().find(|(name, ..)| name == element);
        found.map_or(&[], |(.., properties)| properties)
    }
}

/// Reads only the header, to find out whether a file holds a scan or a mesh, and which columns.
///
/// # Errors
/// As [`read_scan`], for errors of the header.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::ply::{MeshColumns, read_contents, write_points};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("points.ply");
/// write_points(&path, &MeshColumns { points: &[DVec3::ZERO; 5], ..MeshColumns::default() })?;
/// let contents = read_contents(&path)?;
/// assert_eq!((contents.count("vertex"), contents.count("face")), (5, 0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_contents(path: &Path) -> Result<PlyContents> {
    let header = read_file(path, |mut source, _| read_header(&mut source))?;
    Ok(PlyContents {
        encoding: match header.encoding {
            Encoding::Ascii => "ascii",
            Encoding::Little => "binary_little_endian",
            Encoding::Big => "binary_big_endian",
        },
        elements: header
            .elements
            .into_iter()
            .map(|e| (e.name, e.count, e.properties.into_iter().map(|p| p.name).collect()))
            .collect(),
        unit: header.unit,
    })
}

/// The vertex element and the names of its properties; "" for lists, which are not columns.
fn vertices(header: &Header) -> Result<(&Element, Vec<&str>)> {
    let element = header.element("vertex").ok_or_else(|| {
        let names: Vec<_> = header.elements.iter().map(|e| e.name.as_str()).collect();
        Error::input(format!("expected an element `vertex`, found [{}]", names.join(", ")))
    })?;
    let names = element.properties.iter().map(|p| match p.length {
        None => p.name.as_str(),
        Some(_) => "",
    });
    Ok((element, names.collect()))
}

/// Converts a value to an index below `count`.
fn index_below(value: f64, count: u64, place: Place) -> Result<u32> {
    // `f64` holds every PLY type exactly, so this comparison is exact, too.
    if value >= 0.0 && value < count as f64 && value.fract() == 0.0 && value <= f64::from(u32::MAX) {
        return Ok(value as u32);
    }
    Err(Error::input(format!("{place}: expected a vertex index below {count}, found {value}")))
}

/// Index of the list `vertex_indices` of an element; older files call it `vertex_index`.
fn index_list(element: &Element) -> Result<usize> {
    let found = element
        .properties
        .iter()
        .position(|p| p.length.is_some() && matches!(p.name.as_str(), "vertex_indices" | "vertex_index"));
    found.ok_or_else(|| {
        Error::input(format!(
            "the element `{}`: expected a list property `vertex_indices`, found none",
            element.name
        ))
    })
}

pub(crate) fn scan_from<R: Read>(source: &mut Source<R>, name: &str) -> Result<(Scan, Option<Unit>)> {
    let header = read_header(source)?;
    let (vertex, names) = vertices(&header)?;
    let columns = PointColumns::find(&names).map_err(|e| e.in_context("element `vertex`"))?;
    let mut collector =
        PointCollector::new(columns, check_count(source, vertex, header.encoding)?, source.budget());
    let mut grid = None;
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => read_rows(source, element, header.encoding, None, |row| {
                collector.push(row.values, row.place)
            })?,
            "range_grid" => grid = Some(range_grid(source, &header, element, vertex.count)?),
            _ => skip_rows(source, element, header.encoding)?,
        }
    }
    refuse_more(source)?;
    let (mut scan, dropped) = collector.finish(name);
    if let Some(grid) = &mut grid
        && !dropped.is_empty()
    {
        // The grid may come before the vertices, so it is renumbered only now that all dropped ones are
        // known.
        for cell in grid.cells.iter_mut().filter(|cell| **cell != RangeGrid::EMPTY) {
            // `dropped` ascends, so the place of a kept vertex in it is the number of vertices dropped
            // before.
            *cell = match dropped.binary_search(&u64::from(*cell)) {
                Ok(_) => RangeGrid::EMPTY,
                Err(before) => *cell - before as u32,
            };
        }
    }
    scan.grid = grid;
    if header.cyberware {
        scan.viewing = Viewing::Direction(DVec3::new(0.0, 0.0, -1.0));
    }
    Ok((scan, header.unit))
}

fn range_grid<R: Read>(
    source: &mut Source<R>,
    header: &Header,
    element: &Element,
    vertices: u64,
) -> Result<RangeGrid> {
    let (Some(columns), Some(rows)) = (header.grid_columns, header.grid_rows) else {
        return Err(Error::input(
            "the element `range_grid` requires `obj_info num_cols` and `obj_info num_rows`",
        ));
    };
    // The sizes come from comments, the count from the element: both must agree.
    if columns.checked_mul(rows) != Some(element.count) {
        return Err(Error::input(format!(
            "expected {columns} x {rows} cells in `range_grid`, found {}",
            element.count
        )));
    }
    let list = index_list(element)?;
    let mut cells = Vec::with_capacity(check_count(source, element, header.encoding)?);
    let budget = source.budget().clone();
    read_rows(source, element, header.encoding, Some(list), |row: &Row| {
        budget.take_elements(1, size_of::<u32>() as u64, format_args!("cells ({})", row.place))?;
        cells.push(match *row.list {
            [] => RangeGrid::EMPTY,
            [index] => index_below(index, vertices, row.place)?,
            _ => {
                return Err(Error::input(format!(
                    "{}: expected none or one vertex in a cell, found {}",
                    row.place,
                    row.list.len()
                )));
            }
        });
        Ok(())
    })?;
    // Both fit into `usize`, because their product is the number of records just read.
    Ok(RangeGrid {
        columns: usize::try_from(columns).unwrap_or(0),
        rows: usize::try_from(rows).unwrap_or(0),
        cells,
    })
}

pub(crate) fn mesh_from<R: Read>(source: &mut Source<R>) -> Result<PolygonMesh> {
    let header = read_header(source)?;
    let (vertex, names) = vertices(&header)?;
    let position = ["x", "y", "z"].map(|axis| names.iter().position(|n| *n == axis));
    // Properties may come in any order.
    let [Some(x), Some(y), Some(z)] = position else {
        return Err(Error::input(format!(
            "element `vertex`: expected the properties x y z, found {}",
            names.join(" ")
        )));
    };
    let others: Vec<usize> =
        (0..names.len()).filter(|&k| !names[k].is_empty() && ![x, y, z].contains(&k)).collect();
    let mut mesh = PolygonMesh {
        columns: others.iter().map(|&k| (names[k].to_owned(), Vec::new())).collect(),
        unit: header.unit,
        ..PolygonMesh::default()
    };
    let budget = source.budget().clone();
    let bytes = (size_of::<DVec3>() + others.len() * size_of::<f64>()) as u64;
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => {
                mesh.points.reserve(check_count(source, element, header.encoding)?);
                read_rows(source, element, header.encoding, None, |row| {
                    let point = DVec3::new(row.values[x], row.values[y], row.values[z]);
                    // A mesh cannot drop a vertex, because faces refer to vertices by index.
                    if !point.is_finite() {
                        return Err(Error::input(format!(
                            "{}: expected finite coordinates, found {} {} {}",
                            row.place, point[0], point[1], point[2]
                        )));
                    }
                    budget.take_elements(1, bytes, format_args!("vertices ({})", row.place))?;
                    mesh.points.push(point);
                    for ((_, column), &k) in mesh.columns.iter_mut().zip(&others) {
                        column.push(row.values[k]);
                    }
                    Ok(())
                })?;
            }
            "face" => {
                let list = index_list(element)?;
                let mut corners: Vec<u32> = Vec::new();
                mesh.triangles.reserve(check_count(source, element, header.encoding)?);
                read_rows(source, element, header.encoding, Some(list), |row| {
                    if row.list.len() < 3 {
                        return Err(Error::input(format!(
                            "{}: expected at least three corners, found {}",
                            row.place,
                            row.list.len()
                        )));
                    }
                    let (count, bytes) = (row.list.len() as u64 - 2, size_of::<[u32; 3]>() as u64);
                    budget.take_elements(count, bytes, format_args!("triangles ({})", row.place))?;
                    corners.clear();
                    for corner in row.list {
                        corners.push(index_below(*corner, vertex.count, row.place)?);
                    }
                    let at = |k: usize| mesh.points.get(corners[k] as usize).copied();
                    let add = |t: [usize; 3]| mesh.triangles.push(t.map(|k| corners[k]));
                    split_polygon(corners.len(), at, add);
                    Ok(())
                })?;
            }
            _ => skip_rows(source, element, header.encoding)?,
        }
    }
    refuse_more(source)?;
    Ok(mesh)
}
