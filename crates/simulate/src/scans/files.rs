//! The files of a scene of scans: the scans, the ground truth and the job.
//!
//! Input: a [`ScanScene`] and a folder. Output: the files, and a [`ScanSceneSummary`] of them.

use super::{ScanScene, SensorTruth, TrueMotion};
use crate::form::ClosedForm;
use crate::objects::{SolidObject, TrueEdge, TrueFillet, TrueHole};
use crate::truth::Truth;
use crate::virtual_sensor::TrueReading;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_exchange::ply::{MeshColumns, write_mesh, write_scan};
use planish_exchange::{ScanSet, Unit, make_folder, write_atomically};
use planish_mesh::TriangleMesh;
use planish_sense::{Noise, Scan, Viewing};
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
    /// Topology (sheet, tube or ball), or the name of a solid object.
    pub shape: String,
    /// Seed of the scene.
    pub seed: u64,
    /// Unit of every length.
    pub unit: String,
    /// True properties of the sensors.
    pub sensors: Vec<SensorTruth>,
    /// Files of the scans.
    pub scans: Vec<ScanFile>,
    /// Number of vertices of `truth.ply`. They lie on the surface and have exact normals, except at sharp
    /// edges.
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
    /// Genus, sizes and features of a solid object.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub object: Option<ObjectTruth>,
}

/// Part of `truth.json` for a solid object.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ObjectTruth {
    /// Number of handles of the surface.
    pub genus: usize,
    /// Sizes.
    pub form: SolidObject,
    /// Round through holes.
    pub holes: Vec<TrueHole>,
    /// Fillets.
    pub fillets: Vec<TrueFillet>,
    /// Sharp edges.
    pub edges: Vec<TrueEdge>,
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
    let options = &scene.options;
    let mut files = SceneFiles::new(folder)?;
    let scans = files.write_scans(&scene.set, &scene.readings)?;
    // As fine as the readings, within limits that keep comparisons accurate and files small.
    let triangles = options.truth_triangles.unwrap_or((options.readings / 2).clamp(5120, 80_000));
    let mut write_truth = |truth: &Truth, name: &str| -> Result<TriangleMesh> {
        let (mesh, normals) = truth.mesh(triangles);
        files.write_mesh(name, &mesh, &normals, scene.set.unit)?;
        Ok(mesh)
    };
    // The last state is written again below, as the `truth.ply` that every scene has.
    for (k, state) in scene.states.iter().enumerate() {
        write_truth(state, &format!("truth-{}.ply", k + 1))?;
    }
    let mesh = write_truth(&scene.truth, "truth.ply")?;
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
        scans,
        mesh_vertices: mesh.positions.len(),
        mesh_triangles: mesh.triangles.len(),
        // A maximum does not depend on the order, so the parallel reduction gives the same value every
        // time.
        mesh_chord_error: (0..mesh.triangles.len()).into_par_iter().map(chord).reduce(|| 0.0, f64::max),
        // A truth that is a spline has no formula; its mesh is the reference then.
        surface: scene.truth.closed_form().cloned(),
        motion: scene.motion.clone(),
        states: scene.states.iter().filter_map(|truth| truth.closed_form().cloned()).collect(),
        object: None,
    };
    files.finish(&scene.set, truth)
}

/// The files of a scene while they are written: first scans and meshes, then the ground truth and the job.
pub(crate) struct SceneFiles<'a> {
    folder: &'a Path,
    files: Vec<PathBuf>,
}

impl<'a> SceneFiles<'a> {
    /// Files in this folder, which is created if it is missing.
    pub(crate) fn new(folder: &'a Path) -> Result<Self> {
        make_folder(folder)?;
        Ok(Self { folder, files: vec![folder.join("job.toml")] })
    }

    /// Writes the scans of a set.
    pub(crate) fn write_scans(
        &mut self,
        set: &ScanSet,
        readings: &[Vec<TrueReading>],
    ) -> Result<Vec<ScanFile>> {
        let mut written = Vec::new();
        for (posed, readings) in set.scans.iter().zip(readings) {
            let path = self.folder.join(&posed.scan.name);
            write_scan(&path, &posed.scan, set.unit)?;
            self.files.push(path);
            written.push(ScanFile {
                file: posed.scan.name.clone(),
                sensor: set.sensors[posed.sensor].name.clone(),
                readings: readings.len(),
                outliers: readings.iter().filter(|r| r.outlier).count(),
            });
        }
        Ok(written)
    }

    /// Writes a mesh with normals.
    pub(crate) fn write_mesh(
        &mut self,
        name: &str,
        mesh: &TriangleMesh,
        normals: &[DVec3],
        unit: Option<Unit>,
    ) -> Result<()> {
        let path = self.folder.join(name);
        write_mesh(
            &path,
            &MeshColumns {
                points: &mesh.positions,
                normals: Some(normals),
                triangles: &mesh.triangles,
                unit,
                ..MeshColumns::default()
            },
        )?;
        self.files.push(path);
        Ok(())
    }

    /// Writes `truth.json` and the job.
    pub(crate) fn finish(mut self, set: &ScanSet, truth: TruthSummary) -> Result<ScanSceneSummary> {
        let path = self.folder.join("truth.json");
        let mut text = serde_json::to_string_pretty(&truth)
            .map_err(|e| Error::io(format!("{}: could not be written", path.display())).with_source(e))?;
        text.push('\n');
        write_atomically(&path, |writer| writer.write_all(text.as_bytes()))?;
        self.files.push(path);
        // The job is last: while it is missing, the folder is known to be incomplete.
        let job = job_text(set);
        write_atomically(&self.files[0], |writer| writer.write_all(job.as_bytes()))?;

        // The columns that `write_scan` wrote, for the summary.
        let mut columns = vec!["x", "y", "z"];
        let has = |given: fn(&Scan) -> bool| set.scans.iter().any(|s| given(&s.scan));
        if has(|scan| scan.normals.is_some()) {
            columns.extend(["nx", "ny", "nz", "sigma_n_deg"]);
        }
        if has(|scan| scan.covariance.is_some()) {
            columns.extend(["cxx", "cxy", "cxz", "cyy", "cyz", "czz"]);
        }
        if has(|scan| scan.sigma.is_some()) {
            columns.push("sigma");
        }
        Ok(ScanSceneSummary {
            rows: truth.scans.iter().map(|scan| scan.readings).sum(),
            columns: columns.into_iter().map(str::to_owned).collect(),
            files: self.files,
            truth,
        })
    }
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
