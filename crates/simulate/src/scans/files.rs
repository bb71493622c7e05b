//! The files of a scene of scans: the scans, the ground truth and the job.
//!
//! Input: a [`ScanScene`] and a folder. Output: the files, and a [`ScanSceneSummary`] of them.

use super::{ScanScene, SensorTruth, TrueMotion};
use crate::form::ClosedForm;
use crate::truth::Truth;
use planish_estimate::{Error, Result};
use planish_exchange::ply::{MeshColumns, write_mesh, write_scan};
use planish_exchange::{ScanSet, make_folder, write_atomically};
use planish_mesh::TriangleMesh;
use planish_sense::{Noise, Viewing};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// The file of one scan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScanFile {
    /// File name in the folder of the scene.
    pub file: String,
    /// Name of the sensor.
    pub sensor: String,
    /// Number of readings.
    pub readings: usize,
    /// Number of readings that are outliers.
    pub outliers: usize,
}

/// Contents of `truth.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthSummary {
    /// Topology: sheet, tube or ball.
    pub shape: String,
    /// Seed of the scene.
    pub seed: u64,
    /// Unit of every length.
    pub unit: String,
    /// True properties of the sensors.
    pub sensors: Vec<SensorTruth>,
    /// Files of the scans.
    pub scans: Vec<ScanFile>,
    /// Number of vertices of `truth.ply`. They lie on the surface and have exact normals.
    pub mesh_vertices: usize,
    /// Number of triangles of `truth.ply`.
    pub mesh_triangles: usize,
    /// Maximum distance of the centre of a triangle from the surface.
    ///
    /// A comparison with the facets of `truth.ply` cannot resolve smaller deviations.
    pub mesh_chord_error: f64,
    /// Formula of the surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<ClosedForm>,
    /// Motion of the object, if it moved.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<TrueMotion>,
    /// Formula of the surface at each time, if it changed its shape.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub states: Vec<ClosedForm>,
}

/// The files that [`write_scan_scene`] and its relatives write.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScanSceneSummary {
    /// Number of readings of all scans.
    pub rows: usize,
    /// Columns of the files of scans.
    pub columns: Vec<String>,
    /// All files, the job first.
    pub files: Vec<PathBuf>,
    /// Contents of `truth.json`.
    pub truth: TruthSummary,
}

/// Writes the scans, `truth.ply`, `truth.json` and `job.toml` of a scene into a folder.
///
/// The folder is created if it is missing. Each file is written completely or not at all, the job last. Files
/// with the same names are replaced, others remain.
///
/// # Errors
/// `Io` if the folder cannot be created or a file cannot be written.
///
/// # Examples
/// ```
/// use planish_exchange::read_inputs;
/// use planish_simulate::{ScanSceneOptions, scans, write_scan_scene};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let scene = scans(&ScanSceneOptions { readings: 500, ..ScanSceneOptions::default() })?;
/// let folder = tempfile::tempdir()?;
/// let summary = write_scan_scene(&scene, folder.path())?;
/// // The job gives back the same points.
/// let set = read_inputs(&[summary.files[0].clone()], None)?;
/// assert_eq!(set.scans[0].scan.points, scene.set.scans[0].scan.points);
/// # Ok(())
/// # }
/// ```
pub fn write_scan_scene(scene: &ScanScene, folder: &Path) -> Result<ScanSceneSummary> {
    make_folder(folder)?;
    let options = &scene.options;
    let job_path = folder.join("job.toml");
    let mut files = vec![job_path.clone()];
    let mut written = Vec::new();
    for (posed, readings) in scene.set.scans.iter().zip(&scene.readings) {
        let path = folder.join(&posed.scan.name);
        write_scan(&path, &posed.scan, scene.set.unit)?;
        files.push(path);
        written.push(ScanFile {
            file: posed.scan.name.clone(),
            sensor: scene.set.sensors[posed.sensor].name.clone(),
            readings: readings.len(),
            outliers: readings.iter().filter(|r| r.outlier).count(),
        });
    }
    // As fine as the readings, within limits that keep comparisons accurate and files small.
    let triangles = options.truth_triangles.unwrap_or((options.readings / 2).clamp(5120, 80_000));
    let write_truth = |truth: &Truth, name: &str| -> Result<(PathBuf, TriangleMesh)> {
        let (mesh, normals) = truth.mesh(triangles);
        let path = folder.join(name);
        write_mesh(
            &path,
            &MeshColumns {
                points: &mesh.positions,
                normals: Some(&normals),
                triangles: &mesh.triangles,
                unit: scene.set.unit,
                ..MeshColumns::default()
            },
        )?;
        Ok((path, mesh))
    };
    // The last state is written again below, as the `truth.ply` that every scene has.
    for (k, state) in scene.states.iter().enumerate() {
        files.push(write_truth(state, &format!("truth-{}.ply", k + 1))?.0);
    }
    let (path, mesh) = write_truth(&scene.truth, "truth.ply")?;
    files.push(path);
    // The centre of a triangle is about where its chord error is largest.
    let chord = |t: usize| {
        let middle = mesh.point_at(t, [1.0 / 3.0; 3]);
        scene.truth.foot(middle).map_or(0.0, |foot| foot.signed_distance.abs())
    };
    let truth = TruthSummary {
        shape: options.shape.name().to_owned(),
        seed: options.seed,
        unit: options.unit.name().to_owned(),
        sensors: scene.sensors.clone(),
        scans: written,
        mesh_vertices: mesh.positions.len(),
        mesh_triangles: mesh.triangles.len(),
        // A maximum does not depend on the order, so the parallel reduction gives the same value every
        // time.
        mesh_chord_error: (0..mesh.triangles.len()).into_par_iter().map(chord).reduce(|| 0.0, f64::max),
        // A truth that is a spline has no formula; its mesh is the reference then.
        surface: scene.truth.closed_form().cloned(),
        motion: scene.motion.clone(),
        states: scene.states.iter().filter_map(|truth| truth.closed_form().cloned()).collect(),
    };
    let path = folder.join("truth.json");
    let mut text = serde_json::to_string_pretty(&truth)
        .map_err(|e| Error::io(format!("{}: could not be written", path.display())).with_source(e))?;
    text.push('\n');
    write_atomically(&path, |writer| writer.write_all(text.as_bytes()))?;
    files.push(path);
    // The job is last: while it is missing, the folder is known to be incomplete.
    let job = job_text(&scene.set);
    write_atomically(&job_path, |writer| writer.write_all(job.as_bytes()))?;

    // The columns that `write_scan` wrote above, for the summary.
    let mut columns = vec!["x", "y", "z"];
    if scene.set.scans.iter().any(|s| s.scan.covariance.is_some()) {
        columns.extend(["cxx", "cxy", "cxz", "cyy", "cyz", "czz"]);
    }
    if scene.set.scans.iter().any(|s| s.scan.sigma.is_some()) {
        columns.push("sigma");
    }
    Ok(ScanSceneSummary {
        rows: scene.readings.iter().map(Vec::len).sum(),
        columns: columns.into_iter().map(str::to_owned).collect(),
        files,
        truth,
    })
}

/// The text of a job that names the scans, for [`planish_exchange::job::read_job`].
fn job_text(set: &ScanSet) -> String {
    let mut text =
        "# A simulated scene. The σ are those that the sensors state; truth.json holds the true values.\n"
            .to_owned();
    if let Some(unit) = set.unit {
        let _ = writeln!(text, "unit = \"{unit}\"");
    }
    for sensor in &set.sensors {
        let _ = writeln!(text, "\n[sensor.{}]\nkind = \"{}\"", sensor.name, sensor.kind.name());
        let _ = match sensor.noise {
            None => Ok(()),
            // `{:?}` writes the shortest number that reads back exactly.
            Some(Noise::Isotropic { sigma }) => writeln!(text, "sigma = {sigma:?}"),
            Some(Noise::Ray { sigma_along, sigma_across }) => {
                writeln!(text, "sigma_along = {sigma_along:?}\nsigma_across = {sigma_across:?}")
            }
        };
    }
    for posed in &set.scans {
        let pose = posed.scan.world_from_scanner;
        let sensor = &set.sensors[posed.sensor].name;
        let _ = writeln!(text, "\n[[scan]]\nsensor = \"{sensor}\"\nfile = \"{}\"", posed.scan.name);
        let _ = writeln!(
            text,
            "pose = {{ translation = {:?}, quaternion_xyzw = {:?} }}",
            pose.translation.to_array(),
            pose.quaternion_xyzw()
        );
        if let Some(time) = posed.scan.time_s {
            let _ = writeln!(text, "time = {time:?}");
        }
        let _ = match posed.scan.viewing {
            Viewing::Unknown => Ok(()),
            Viewing::Direction(d) => writeln!(text, "direction = {:?}", d.to_array()),
            Viewing::Origin(p) => writeln!(text, "viewpoint = {:?}", p.to_array()),
        };
    }
    text
}
