//! Writes meshes and points as binary little-endian PLY files.
//!
//! **Input.** Positions with named columns.
//!
//! **Output.** `float64 x y z`, then the columns in the given order, then faces as `list uchar int
//! vertex_indices`. The same input gives the same bytes.

use std::io::{self, Write};
use std::path::Path;

use planish_estimate::Result;

use crate::atomic::write_packed;
use crate::mesh_data::{Column, MeshColumns};

/// Writes a mesh; [`read_mesh`](super::read_mesh) returns the same numbers.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) for columns of unequal length, bad names, or corners beyond
/// the points; [`Io`](planish_estimate::ErrorKind::Io) when the file cannot be written; nothing is left
/// half-written.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::ply::{Column, MeshColumns, read_mesh, write_mesh};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("one.ply");
/// write_mesh(&path, &MeshColumns {
///     points: &[DVec3::ZERO, DVec3::X, DVec3::Y],
///     columns: vec![("sigma", Column::F64(&[0.1, 0.1, 0.2])), ("observed", Column::U8(&[1, 1, 0]))],
///     triangles: &[[0, 1, 2]],
///     ..MeshColumns::default()
/// })?;
/// assert_eq!(read_mesh(&path)?.column("sigma"), Some(&[0.1, 0.1, 0.2][..]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_mesh(path: &Path, mesh: &MeshColumns) -> Result<()> {
    write_file(path, mesh, true)
}

/// Writes the points and their columns without faces; `mesh.triangles` is ignored.
///
/// # Errors
/// As [`write_mesh`].
pub fn write_points(path: &Path, mesh: &MeshColumns) -> Result<()> {
    write_file(path, mesh, false)
}

fn write_file(path: &Path, mesh: &MeshColumns, faces: bool) -> Result<()> {
    mesh.check(faces).map_err(|e| e.in_context(path.display()))?;
    write_packed(path, |mut writer| write_to(&mut writer, mesh, faces))
}

pub(super) fn write_to(writer: &mut impl Write, mesh: &MeshColumns, faces: bool) -> io::Result<()> {
    writeln!(writer, "ply\nformat binary_little_endian 1.0")?;
    if let Some(unit) = mesh.unit {
        writeln!(writer, "comment unit {unit}")?;
    }
    writeln!(writer, "element vertex {}", mesh.points.len())?;
    let normals: &[&str] = if mesh.normals.is_some() { &["nx", "ny", "nz"] } else { &[] };
    for name in ["x", "y", "z"].iter().chain(normals) {
        writeln!(writer, "property double {name}")?;
    }
    for (name, column) in &mesh.columns {
        let number = match column {
            Column::F64(_) => "double",
            Column::U8(_) => "uchar",
        };
        writeln!(writer, "property {number} {name}")?;
    }
    if faces {
        writeln!(writer, "element face {}", mesh.triangles.len())?;
        writeln!(writer, "property list uchar int vertex_indices")?;
    }
    writeln!(writer, "end_header")?;
    for (i, point) in mesh.points.iter().enumerate() {
        let normal = mesh.normals.map(|normals| normals[i]);
        for coordinate in point.as_ref().iter().chain(normal.iter().flat_map(|n| n.as_ref())) {
            writer.write_all(&coordinate.to_le_bytes())?;
        }
        for (_, column) in &mesh.columns {
            match column {
                Column::F64(values) => writer.write_all(&values[i].to_le_bytes())?,
                Column::U8(values) => writer.write_all(&values[i..=i])?,
            }
        }
    }
    if faces {
        for triangle in mesh.triangles {
            // One byte with the number of corners, 3, then three corners of four bytes.
            let mut record = [3; 13];
            for (k, corner) in triangle.iter().enumerate() {
                record[1 + 4 * k..5 + 4 * k].copy_from_slice(&corner.to_le_bytes());
            }
            writer.write_all(&record)?;
        }
    }
    Ok(())
}
