//! Solids as files: STEP, or meshes within a tolerance.

use super::SolidJob;
use planish_core::{DVec3, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::mesh::{MeshColumns, is_mesh_file, write_mesh};
use planish_exchange::step::{StepOptions, write_solid};
use planish_exchange::{Unit, extension};
use planish_mesh::TriangleMesh;
use planish_solid::brep::Solid;
use planish_solid::tessellation::{MAX_TRIANGLES, min_tolerance, tessellate, triangles_needed};
use std::path::{Path, PathBuf};

/// Stated uncertainty of STEP files, in millimetres: vertices, edges and faces meet within it.
const UNCERTAINTY_MM: f64 = 1e-5;

/// A solid, with its mesh if an output needs one.
pub(super) struct Prepared<'a> {
    solid: &'a Solid,
    mesh: Option<TriangleMesh>,
}

/// Whether a solid can be written under this name.
pub(super) fn is_solid_file(path: &Path) -> bool {
    matches!(extension(path).as_str(), "step" | "stp") || is_mesh_file(path)
}

/// Prepares all outputs. Nothing is written if one of them fails.
pub(super) fn prepare<'a>(job: &SolidJob, solids: &[&'a Solid], tolerance: f64) -> Result<Vec<Prepared<'a>>> {
    let is_meshed = job.outputs.iter().any(|output| is_mesh_file(output));
    let one = |(index, &solid): (usize, &&'a Solid)| {
        let mesh = match is_meshed {
            // Estimated before meshing, because the mesh itself could exhaust the memory.
            true if triangles_needed(solid, tolerance) > MAX_TRIANGLES => {
                return Err(too_fine(solid, tolerance));
            }
            true => Some(tessellate(solid, tolerance).map_err(|e| no_mesh(&e, index + 1))?),
            false => None,
        };
        if let Some(mesh) = &mesh {
            // Rounded coordinates would tear a watertight mesh apart.
            refuse_coarse_numbers(job, &mesh.positions, tolerance)?;
        }
        Ok(Prepared { solid, mesh })
    };
    solids.iter().enumerate().map(one).collect()
}

/// Error for a tolerance that needs too many triangles. States one that works.
fn too_fine(solid: &Solid, tolerance: f64) -> Error {
    Error::input(format!(
        "expected a mesh of at most {MAX_TRIANGLES:.0e} triangles, found about {:.1e} for a chord error of \
         {tolerance:e}: use {:.1e} or more, or .step, which is exact",
        triangles_needed(solid, tolerance),
        // Rounded up, so that it works.
        1.06 * min_tolerance(solid)
    ))
    .with_setting(Setting::MeshTolerance)
}

/// Refuses STL if the spacing of its 32-bit numbers, far from the origin, exceeds the mesh tolerance.
fn refuse_coarse_numbers(job: &SolidJob, positions: &[DVec3], tolerance: f64) -> Result<()> {
    let farthest = positions.iter().fold(0.0, |max: f64, p| max.max(p.abs().max_element()));
    let apart = farthest * f64::from(f32::EPSILON);
    match job.outputs.iter().find(|output| extension(output) == "stl") {
        Some(output) if apart > tolerance => Err(Error::unsupported(format!(
            "{}: expected coordinates that STL represents within the chord error of {tolerance:.1e}; its \
             32-bit numbers have steps of {apart:.1e} at {farthest:.3e}: write .ply or .step, or move the \
             drawing nearer to the origin",
            output.display()
        ))),
        _ => Ok(()),
    }
}

/// Why no mesh is written, and what can be done: neither the drawing nor the command is wrong.
fn no_mesh(e: &Error, rank: usize) -> Error {
    Error::undetermined(format!(
        "solid {rank} cannot be meshed, so no file is written: {e}; write only .step, without .ply, .stl, \
         .glb and .obj"
    ))
}

/// Writes all files; returns the first file of each solid, and all of them.
pub(super) fn write(
    job: &SolidJob,
    prepared: &[Prepared<'_>],
    unit: Unit,
) -> Result<(Vec<Option<String>>, Vec<PathBuf>)> {
    let (mut first, mut all) = (Vec::new(), Vec::new());
    for (index, one) in prepared.iter().enumerate() {
        let mut file = None;
        for output in job.outputs.iter().filter(|output| is_solid_file(output)) {
            let path = if job.all { numbered(output, index + 1) } else { output.clone() };
            match (&one.mesh, is_mesh_file(output)) {
                (Some(mesh), true) => {
                    let columns = MeshColumns {
                        points: &mesh.positions,
                        triangles: &mesh.triangles,
                        unit: Some(unit),
                        ..MeshColumns::default()
                    };
                    write_mesh(&path, &columns)?;
                }
                _ => write_solid(&path, one.solid, &options(output, unit))?,
            }
            // The report names one file per solid.
            file.get_or_insert(path.display().to_string());
            all.push(path);
        }
        first.push(file);
    }
    Ok((first, all))
}

fn options(output: &Path, unit: Unit) -> StepOptions {
    StepOptions {
        name: output.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        unit,
        uncertainty: UNCERTAINTY_MM / unit.millimetres(),
        ..StepOptions::default()
    }
}

/// `part.step` becomes `part.2.step`, `part.ply.gz` becomes `part.2.ply.gz`.
fn numbered(path: &Path, rank: usize) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let packed = name.to_lowercase().ends_with(".gz");
    let plain = if packed { &name[..name.len() - 3] } else { &name[..] };
    // The number goes before the extension, which selects the format.
    let at = plain.rfind('.').unwrap_or(plain.len());
    path.with_file_name(format!("{}.{rank}{}", &name[..at], &name[at..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stl_far_from_the_origin_is_refused() {
        let job = |output: &str| SolidJob {
            views: Vec::new(),
            outputs: vec![PathBuf::from(output)],
            ..SolidJob::default()
        };
        let far = [DVec3::splat(1e8), DVec3::new(1e8 + 40.0, 1e8, 1e8)];
        let message = refuse_coarse_numbers(&job("part.stl"), &far, 0.02).unwrap_err().to_string();
        assert!(message.starts_with("part.stl: expected coordinates that STL represents"), "{message}");
        refuse_coarse_numbers(&job("part.ply"), &far, 0.02).unwrap();
        refuse_coarse_numbers(&job("part.stl"), &[DVec3::splat(40.0)], 0.02).unwrap();
    }
}
