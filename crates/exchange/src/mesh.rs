//! Triangle meshes in any of the formats, by the file's extension: PLY, OBJ, STL, OFF and GLB.
//!
//! **Input.** A path; for writing also [`MeshColumns`].
//!
//! **Output.** A [`PolygonMesh`], or a file with everything of [`MeshColumns`] that its format can hold.
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
//! **Limits.** OBJ and STL have no place for columns, so these are lost.

use crate::source::{extension, found_extension};
use planish_estimate::{Error, Result};
use std::path::Path;

pub use crate::mesh_data::{Column, MeshColumns, PolygonMesh};

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
        "{}: expected a mesh (ply, obj, stl, off, glb{more}), found {}",
        path.display(),
        found_extension(path)
    ))
}
