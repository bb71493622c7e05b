//! Reads and writes triangle meshes; the extension of the file selects PLY, OBJ, STL, OFF or GLB.
//!
//! **Input.** A path; for writing also [`MeshColumns`].
//!
//! **Output.** A [`PolygonMesh`], or a file with the parts of [`MeshColumns`] that its format supports.
//!
//! | format | written | read |
//! |---|---|---|
//! | PLY | `float64` positions, normals, every column, the unit | the same |
//! | OBJ | all digits of positions and normals, the unit in a comment | the same |
//! | STL | `float32` positions, the unit in the header | equal corners become one vertex |
//! | OFF | all digits of positions; no unit and no columns | polygons |
//! | GLB | `float32` positions about an offset, normals, columns; metres | the same |
//! | STEP | not as a mesh; see [`crate::step`] | triangles of all faces, by [`crate::step::read_step`] |
//!
//! **Limits.** OBJ, OFF and STL do not support columns, so σ is lost. STL also loses the normals of vertices.

use crate::source::{describe_extension, extension};
use planish_estimate::{Error, Result};
use std::path::Path;

pub use crate::mesh_data::{Column, MeshColumns, PolygonMesh};

/// True if the extension is that of a mesh format: `ply`, `obj`, `stl`, `off` or `glb`, with or without
/// `.gz`.
#[must_use]
pub fn is_mesh_file(path: &Path) -> bool {
    matches!(extension(path).as_str(), "ply" | "obj" | "stl" | "off" | "glb")
}

/// True if faces can be read from files of this extension: mesh formats, `step` and `stp`.
#[must_use]
pub fn has_faces(path: &Path) -> bool {
    is_mesh_file(path) || is_step_file(path)
}

/// True if the extension is `step` or `stp`, with or without `.gz`.
#[must_use]
pub fn is_step_file(path: &Path) -> bool {
    matches!(extension(path).as_str(), "step" | "stp")
}

/// Reads a mesh of any format. A file without faces gives no triangles. Faces of STEP files are triangulated
/// with a chord error of at most 1/10 000 of the size.
///
/// # Errors
/// As the reader of the format; [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for other
/// extensions, and if a face of a STEP file cannot be read.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("square.off");
/// std::fs::write(&path, "OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n")?;
/// let mesh = planish_exchange::mesh::read_mesh(&path)?;
/// assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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

/// Writes a mesh in the format of the extension, compressed if the path ends with `.gz`.
///
/// # Errors
/// As the writer of the format; [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for other
/// extensions.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::mesh::{MeshColumns, read_mesh, write_mesh};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("one.stl");
/// write_mesh(&path, &MeshColumns {
///     points: &[DVec3::ZERO, DVec3::X, DVec3::Y],
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
        describe_extension(path)
    ))
}
