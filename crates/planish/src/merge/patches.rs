//! Reads patches from files: saved models, meshes, CAD faces and organised scans.
//!
//! Input: paths. Output: patches in one frame and unit, with σ if the files state it. Not guaranteed: frames
//! of files without poses may disagree.

use crate::compare::ComparedMesh;
use crate::saved;
use planish_core::{DVec3, Finding, FindingCode, Length, Setting, SymmetricMatrix3};
use planish_estimate::{Error, Result};
use planish_exchange::mesh::{is_mesh_file, is_step_file, read_mesh};
use planish_exchange::step::read_step;
use planish_exchange::{PosedScan, Unit, extension, read_inputs};
use planish_mesh::{ManifoldPatch, MergePatch, TriangleMesh};
use planish_sense::{RangeGrid, Scan, Sensor, Viewing, ray_at};
use planish_surface::export::mesh_from_model;
use planish_surface::model::Observed;
use std::path::{Path, PathBuf};

/// Maximum edge length of a scan's triangles, relative to its median edge. Longer triangles span a depth
/// edge.
const MAX_EDGE_RATIO: f64 = 4.0;

/// A patch and its origin.
#[derive(Debug, Clone)]
pub struct NamedPatch {
    /// The file, and the scan in it if there are several.
    pub name: String,
    /// The surface, and the numbers of its triangles in the file.
    pub tidied: ManifoldPatch,
    /// For each vertex, 1 if measured and 2 if completed. Empty if all were measured.
    pub observed: Vec<u8>,
}

/// Patches, and other contents of their files.
#[derive(Debug, Clone, Default)]
pub struct PatchSet {
    /// The patches, in the order of the files.
    pub patches: Vec<NamedPatch>,
    /// A surface that contains the object. It is used where there is no patch.
    pub bound: Option<NamedPatch>,
    /// Unit of every length.
    pub unit: Option<Unit>,
    /// Every file that was read.
    pub inputs: Vec<PathBuf>,
    /// Findings for the user.
    pub findings: Vec<Finding>,
}

/// Reads patches from files.
///
/// Formats: `.planish` (measured and completed regions), meshes with faces (with the column `sigma` if
/// present), STEP files (one patch for each set of faces that share edges), organised scans, and lists of
/// scans. `chord` is the maximum chord error of the meshes of models and STEP faces, in the unit of the file.
/// Its default is half the median σ of a model, or 1/10 000 of the size of a STEP file.
///
/// `bound` is an additional file with a surface that contains the object. `unit` applies to files without a
/// unit. All lengths are converted to the unit of the first file that has one. Files without a unit are
/// assumed to be in that unit, with a finding.
///
/// # Errors
/// Those of the readers; `Input` for points without a surface, for a model without measured regions, and for
/// a `bound` with several patches; `Unsupported` for other extensions.
pub fn read_patches(
    paths: &[PathBuf],
    bound: Option<&PathBuf>,
    unit: Option<Unit>,
    chord: Option<Length>,
) -> Result<PatchSet> {
    let mut set = PatchSet::default();
    let mut read: Vec<(NamedPatch, Option<Unit>)> = Vec::new();
    // The bound is read like a patch and separated at the end.
    for (at, path) in paths.iter().chain(bound).enumerate() {
        let first = read.len();
        let name = path.display().to_string();
        let with_faces = match is_mesh_file(path) {
            true => Some(read_mesh(path)?).filter(|file| !file.triangles.is_empty()),
            false => None,
        };
        if extension(path) == "planish" {
            set.inputs.push(path.clone());
            let model = saved::load(path)?;
            let chord = chord.map(|chord| chord.in_unit(model.unit));
            let mesh = mesh_from_model(&model, &model.posterior()?, chord)
                .map_err(|e| e.in_context(path.display()))?;
            // Parts that only the prior determines are no evidence and are not merged.
            let known: Vec<bool> = mesh.observed.iter().map(|o| *o != 0).collect();
            let stated = (!model.unit_assumed).then_some(mesh.unit).or(unit);
            read.push((of_mesh(name, &mesh.mesh, &mesh.sigma, &known, &mesh.observed)?, stated));
        } else if let Some(file) = with_faces {
            set.inputs.push(path.clone());
            let ComparedMesh { mesh, sigma, observed, unit: of_file, .. } =
                ComparedMesh::from_file(file, path)?;
            let known: Vec<bool> = match &observed {
                Some(observed) => observed.iter().map(|o| *o != Observed::PriorOnly).collect(),
                None => vec![true; mesh.positions.len()],
            };
            let marks: Vec<u8> = observed.iter().flatten().map(|o| o.mark()).collect();
            let sigma = sigma.unwrap_or_default();
            // An error: σ = 0 would give a vertex infinite weight in the fusion.
            let is_zero = |v: &usize| known[*v] && sigma[*v] <= 0.0;
            let zeros = (0..sigma.len()).filter(is_zero).count();
            if let Some(v) = (0..sigma.len()).find(is_zero) {
                return Err(Error::input(format!(
                    "{name}: vertex {v}: expected σ > 0, found {} ({zeros} of {} vertices have no positive \
                     σ); omit the column `sigma` if σ is unknown",
                    sigma[v],
                    sigma.len()
                )));
            }
            read.push((of_mesh(name, &mesh, &sigma, &known, &marks)?, of_file.or(unit)));
        } else if is_step_file(path) {
            set.inputs.push(path.clone());
            of_faces(path, unit, chord, &mut read, &mut set.findings)?;
        } else {
            let scans = read_inputs(&[path], unit)?;
            set.inputs.extend(scans.inputs.iter().map(|i| i.path.clone()));
            for posed in &scans.scans {
                let sensor = scans.sensors.get(posed.sensor);
                read.push((of_scan(path, posed, sensor)?, scans.unit));
            }
        }
        // Only the last path can be the bound.
        if at == paths.len() && read.len() != first + 1 {
            return Err(Error::input(format!(
                "{}: expected one surface as the bound of the object, found {}",
                path.display(),
                read.len() - first
            )));
        }
    }
    // After all files are read: the first that states a unit need not be the first file.
    set.unit = read.iter().find_map(|(_, unit)| *unit).or(unit);
    for (mut named, of_file) in read {
        match (of_file, set.unit) {
            (Some(from), Some(to)) if from != to => {
                let factor = from.millimetres() / to.millimetres();
                let patch = &mut named.tidied.patch;
                for p in &mut patch.mesh.positions {
                    *p = p.map(|x| factor * x);
                }
                for s in &mut patch.sigma {
                    *s *= factor;
                }
                let text = format!("{}: converted from {from} to {to}", named.name);
                set.findings.push(Finding::new(FindingCode::UnitConverted, text));
            }
            (None, Some(to)) => {
                let text = format!(
                    "{} states no unit: {to} is assumed, as in the other files; specify the unit if this \
                     is wrong",
                    named.name
                );
                let finding = Finding::new(FindingCode::UnitAssumed, text);
                set.findings.push(finding.with_setting(Setting::Unit));
            }
            _ => {}
        }
        set.patches.push(named);
    }
    set.bound = bound.and_then(|_| set.patches.pop());
    Ok(set)
}

/// The faces of a STEP file: a patch for every set that shares edges.
fn of_faces(
    path: &Path,
    unit: Option<Unit>,
    chord: Option<Length>,
    read: &mut Vec<(NamedPatch, Option<Unit>)>,
    findings: &mut Vec<Finding>,
) -> Result<()> {
    let faces = read_step(path)?;
    let unit = faces.unit().or(unit);
    let chord = chord.map(|chord| chord.in_unit(unit.unwrap_or(Unit::Millimetre)));
    let mesh = faces.triangles(&faces.fineness(chord)).map_err(|e| e.in_context(path.display()))?;
    if let Some(first) = mesh.unreadable.first() {
        findings.push(Finding::new(
            FindingCode::FacesSkipped,
            format!(
                "{}: {} of {} faces are skipped, the first: {first}",
                path.display(),
                mesh.unreadable.len(),
                mesh.unreadable.len() + mesh.faces
            ),
        ));
    }
    let count = mesh.parts.len();
    for (k, part) in mesh.parts.into_iter().enumerate() {
        let name = match count {
            1 => path.display().to_string(),
            _ => format!("{} part {}", path.display(), k + 1),
        };
        let known = vec![true; part.points.len()];
        let mesh = TriangleMesh::try_new(part.points, part.triangles).map_err(|e| e.in_context(&name))?;
        read.push((of_mesh(name, &mesh, &[], &known, &[])?, unit));
    }
    Ok(())
}

/// The manifold part of the triangles whose corners are known.
fn of_mesh(
    name: String,
    mesh: &TriangleMesh,
    sigma: &[f64],
    known: &[bool],
    observed: &[u8],
) -> Result<NamedPatch> {
    let (numbers, triangles): (Vec<u32>, Vec<[u32; 3]>) = (0..)
        .zip(mesh.triangles.iter().copied())
        .filter(|(_, t)| t.iter().all(|v| known[*v as usize]))
        .unzip();
    let seen = TriangleMesh { positions: mesh.positions.clone(), triangles };
    if seen.triangles.is_empty() {
        return Err(Error::input(format!("{name}: expected measured parts, found none")));
    }
    let mut tidied = MergePatch::make_manifold(&seen, sigma).map_err(|e| e.in_context(&name))?;
    for t in &mut tidied.triangles {
        *t = numbers[*t as usize];
    }
    let observed = match observed.is_empty() {
        true => Vec::new(),
        false => tidied.vertices.iter().map(|v| observed[*v as usize]).collect(),
    };
    Ok(NamedPatch { name, tidied, observed })
}

fn of_scan(path: &Path, posed: &PosedScan, sensor: Option<&Sensor>) -> Result<NamedPatch> {
    let scan = &posed.scan;
    let name = match scan.name.is_empty() {
        true => path.display().to_string(),
        false => scan.name.clone(),
    };
    // Loose points have no neighbours. Guessing them would be a surface reconstruction, which a fit does
    // better.
    let Some(grid) = &scan.grid else {
        return Err(Error::input(format!(
            "{name}: expected a surface (a saved model, a mesh with faces, or a scan in rows and columns), \
             found {} unconnected points: fit a surface to them first",
            scan.points.len()
        )));
    };
    let mut triangles = triangles_of_grid(grid, &scan.points);
    // In the scanner's frame, where the viewing direction is known.
    face_the_sensor(&mut triangles, &scan.points, scan.viewing);
    let mesh = TriangleMesh::try_new(
        scan.points.iter().map(|p| scan.world_from_scanner.apply(*p)).collect(),
        triangles,
    )
    .map_err(|e| e.in_context(&name))?;
    let sigma = sigma_of_points(scan, sensor, &mesh);
    let known = vec![true; mesh.positions.len()];
    of_mesh(name, &mesh, &sigma, &known, &[])
}

/// σ along the normals, where points or their sensor state it.
fn sigma_of_points(scan: &Scan, sensor: Option<&Sensor>, mesh: &TriangleMesh) -> Vec<f64> {
    // The most specific statement counts: σ of a point, then its covariance, then the sensor.
    if let Some(sigma) = &scan.sigma {
        return sigma.clone();
    }
    let normals = mesh.vertex_normals();
    // Covariances of a scan are in the scanner's frame.
    let back = scan.world_from_scanner.inverse();
    let along =
        |k: usize, covariance: &SymmetricMatrix3| covariance.along(back.rotate(normals[k])).max(0.0).sqrt();
    if let Some(covariance) = &scan.covariance {
        return covariance.iter().enumerate().map(|(k, c)| along(k, c)).collect();
    }
    let Some(noise) = sensor.and_then(|s| s.noise) else {
        return Vec::new();
    };
    (0..scan.points.len())
        .map(|k| along(k, &noise.covariance(ray_at(scan.viewing, scan.points[k]))))
        .collect()
}

/// Triangles of an organised scan: two for every four neighbours, split at the shorter diagonal, or one if a
/// corner is missing. Triangles across a depth edge are dropped (G. Turk, M. Levoy 1994, section 3).
fn triangles_of_grid(grid: &RangeGrid, points: &[DVec3]) -> Vec<[u32; 3]> {
    let mut triangles = Vec::new();
    let at = |k: usize| points[k];
    for row in 0..grid.rows.saturating_sub(1) {
        for column in 0..grid.columns.saturating_sub(1) {
            let corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| grid.point(column + i, row + j));
            match corners {
                [Some(a), Some(b), Some(c), Some(d)] => {
                    if at(a).distance(at(c)) <= at(b).distance(at(d)) {
                        triangles.extend([[a, b, c], [a, c, d]]);
                    } else {
                        triangles.extend([[a, b, d], [b, c, d]]);
                    }
                }
                _ => {
                    let present: Vec<usize> = corners.into_iter().flatten().collect();
                    if let [a, b, c] = present[..] {
                        triangles.push([a, b, c]);
                    }
                }
            }
        }
    }
    let longest = |t: &[usize; 3]| (0..3).map(|k| at(t[k]).distance(at(t[(k + 1) % 3]))).fold(0.0, f64::max);
    let mut lengths: Vec<f64> = triangles.iter().map(longest).collect();
    if lengths.is_empty() {
        return Vec::new();
    }
    let middle = lengths.len() / 2;
    let typical = *lengths.select_nth_unstable_by(middle, f64::total_cmp).1;
    // Relative to the median, which adapts to the resolution of the scan. Depth edges are too few to shift
    // it.
    triangles.retain(|t| longest(t) <= MAX_EDGE_RATIO * typical);
    triangles.into_iter().map(|t| t.map(|v| v as u32)).collect()
}

/// Flips all triangles if most of them face away from the sensor. Their orientation depends on the order of
/// rows and columns.
fn face_the_sensor(triangles: &mut [[u32; 3]], points: &[DVec3], viewing: Viewing) {
    let against: f64 = triangles
        .iter()
        .filter_map(|t| {
            let [a, b, c] = t.map(|v| points[v as usize]);
            Some(ray_at(viewing, a)?.dot((b - a).cross(c - a)))
        })
        .sum();
    // Weighted by area and decided once for the whole scan: single triangles at noise may face anywhere.
    if against > 0.0 {
        for t in triangles {
            t.swap(1, 2);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn older_cad_files_are_rejected_with_advice() {
        let folder = tempfile::tempdir().unwrap();
        let iges = folder.path().join("part.IGES");
        std::fs::write(&iges, "an older part\n").unwrap();
        let refused = read_patches(&[iges], None, None, None).unwrap_err();
        assert_eq!(refused.kind(), planish_estimate::ErrorKind::Unsupported);
        let message = refused.to_string();
        assert!(message.contains("part.IGES") && message.contains(".stl"), "{message}");
    }
}
