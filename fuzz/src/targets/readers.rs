//! One function per reader. Formats that are also written are written and read again.

use planish::info::info;
use planish::saved::{load_with_provenance, save};
use planish_estimate::Result;
use planish_exchange::calibration::{
    read_grid_calibration, read_lights, read_stereo_calibration, read_view_sensor,
};
use planish_exchange::contours::{
    CarmenOptions, SigmaDefaults, read_contour_json, read_contour_readings, read_ray_readings,
};
use planish_exchange::dxf::read_dxf;
use planish_exchange::mesh::{Column, MeshColumns, PolygonMesh, read_mesh, write_mesh};
use planish_exchange::pdf::read_pdf;
use planish_exchange::picture::read_picture;
use planish_exchange::ply::{read_contents, read_scan, write_scan};
use planish_exchange::poses::read_poses;
use planish_exchange::step::read_step;
use planish_exchange::svg::read_svg;
use planish_exchange::textured::{read_materials, read_textured};
use planish_exchange::views::read_views;
use planish_exchange::{extension, read_inputs};
use std::path::Path;

pub(super) fn dxf(path: &Path) -> Result<()> {
    read_dxf(path).map(drop)
}

/// Tessellates coarsely (1 % of the size): enough to reach the code, and fast.
pub(super) fn step(path: &Path) -> Result<()> {
    let faces = read_step(path)?;
    let fineness = faces.fineness(Some(0.01 * faces.size()));
    faces.triangles(&fineness).map(drop)
}

pub(super) fn svg(path: &Path) -> Result<()> {
    read_svg(path).map(drop)
}

pub(super) fn pdf(path: &Path) -> Result<()> {
    read_pdf(path).map(drop)
}

/// Values of σ for files that state none.
fn sigma_defaults() -> SigmaDefaults {
    SigmaDefaults { position: Some(0.1), heading_deg: Some(0.5), range: Some(0.1), point: Some(0.1) }
}

pub(super) fn readings(path: &Path) -> Result<()> {
    read_contour_readings(path, &sigma_defaults(), &CarmenOptions::default()).map(drop)
}

pub(super) fn rays(path: &Path) -> Result<()> {
    read_ray_readings(path, &sigma_defaults()).map(drop)
}

pub(super) fn contour(path: &Path) -> Result<()> {
    read_contour_json(path).map(drop)
}

pub(super) fn picture(path: &Path) -> Result<()> {
    read_picture(path).map(drop)
}

pub(super) fn stereo_calibration(path: &Path) -> Result<()> {
    read_stereo_calibration(path).map(drop)
}

pub(super) fn view_sensor(path: &Path) -> Result<()> {
    read_view_sensor(path).map(drop)
}

pub(super) fn mask_views(path: &Path) -> Result<()> {
    read_views(path).map(drop)
}

pub(super) fn shell_poses(path: &Path) -> Result<()> {
    read_poses(path).map(drop)
}

pub(super) fn grid_calibration(path: &Path) -> Result<()> {
    read_grid_calibration(path).map(drop)
}

pub(super) fn lights(path: &Path) -> Result<()> {
    read_lights(path).map(drop)
}

/// Reads the depth image whose camera is described by the file.
pub(super) fn depth_image(path: &Path) -> Result<()> {
    scans(&sibling(path, "a.png"))
}

/// Reads a file of any kind as the input of a fit, as users do.
pub(super) fn scans(path: &Path) -> Result<()> {
    read_inputs(&[path], None).map(drop)
}

/// A file in the same folder.
fn sibling(path: &Path, name: &str) -> std::path::PathBuf {
    path.with_file_name(name)
}

/// The bytes of a file; none if it does not exist.
fn bytes_of(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_default()
}

/// Reads a scan, writes it, reads it and writes it again: both files must be equal.
pub(super) fn scan_round_trip(path: &Path) -> Result<()> {
    scans(path)?;
    // A scan has no unit of its own, so the unit is read with the other contents.
    let contents = read_contents(path)?;
    let (first, second) = (sibling(path, "first.ply"), sibling(path, "second.ply"));
    write_scan(&first, &read_scan(path)?, contents.unit)?;
    write_scan(&second, &read_scan(&first)?, read_contents(&first)?.unit)?;
    assert!(bytes_of(&first) == bytes_of(&second), "a written scan changes when it is read back");
    Ok(())
}

/// Reads a textured mesh and splits it at its texture seams, as a viewer does.
pub(super) fn textured(path: &Path) -> Result<()> {
    read_textured(path).map(|mesh| {
        // An index beyond the vertices would be noticed only later, in a viewer.
        let split = mesh.split();
        assert!(split.triangles.iter().flatten().all(|&v| (v as usize) < split.vertex_of.len()));
    })
}

pub(super) fn materials(path: &Path) -> Result<()> {
    read_materials(path).map(|_| ())
}

/// Reads a mesh, and writes and reads it three times: the second and third file must be equal.
pub(super) fn mesh_round_trip(path: &Path) -> Result<()> {
    // Mesh files are also read as point sets, and by `info`.
    let as_points = scans(path);
    let described = info(path, None);
    let mesh = read_mesh(path)?;
    let name = |name: &str| sibling(path, name).with_extension(extension(path));
    let (first, second, third) = (name("first"), name("second"), name("third"));
    // Column names that are not one plain word can be read but not written.
    if write(&mesh, &first).is_ok() {
        // Some formats round when they write for the first time, so the second and third files are compared.
        write(&read_mesh(&first)?, &second)?;
        write(&read_mesh(&second)?, &third)?;
        assert!(bytes_of(&second) == bytes_of(&third), "a written mesh changes when it is read back");
    }
    as_points.and(described.map(drop))
}

/// Writes a mesh with all its columns.
fn write(mesh: &PolygonMesh, path: &Path) -> Result<()> {
    write_mesh(
        path,
        &MeshColumns {
            points: &mesh.points,
            columns: mesh.columns.iter().map(|(name, column)| (name.as_str(), Column::F64(column))).collect(),
            triangles: &mesh.triangles,
            unit: mesh.unit,
            ..MeshColumns::default()
        },
    )
}

/// Reads a saved model, and writes and reads it twice: both files must be equal.
pub(super) fn model_round_trip(path: &Path) -> Result<()> {
    // The damaged file may have another layout than a written one, so two written files are compared.
    let saved = load_with_provenance(path)?;
    let (first, second) = (sibling(path, "first.planish"), sibling(path, "second.planish"));
    save(&saved.model, &saved.provenance, &first)?;
    let again = load_with_provenance(&first)?;
    save(&again.model, &again.provenance, &second)?;
    assert!(bytes_of(&first) == bytes_of(&second), "a written model changes when it is read back");
    Ok(())
}
