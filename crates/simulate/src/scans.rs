//! The scene `scans`: a freeform, measured by several sensors with outliers and a misstated σ.
//!
//! Input: [`ScanSceneOptions`]. Output: a [`ScanScene`] whose `set` is ready for
//! [`planish_surface::fit::fit`], or a folder with a PLY file for each scan, `job.toml` that names them,
//! `truth.ply` and `truth.json`.
//!
//! The sensors are
//!
//! - `laser`, a range camera with a different σ along and across the ray,
//! - `old`, a scanner with three times the σ of the laser in every direction, which states a smaller one,
//! - `probe`, a touch probe with a twenty-fifth of the σ of the laser.
//!
//! Not guaranteed: that the views cover the whole surface. Three views leave part of a ball unobserved; the
//! fourth, of the old scanner, covers it.

use super::form::ClosedForm;
use super::truth::{Truth, positive};
use super::virtual_sensor::{Optics, TrueReading, VirtualProbe, VirtualScan, VirtualScanner, scaled};
use planish_core::random::GOLDEN_GAMMA;
use planish_core::{Progress, ProgressPart, Silent, WRITING_STAGE};
use planish_estimate::vector3::{add_scaled, cross, scale, tangents, unit};
use planish_estimate::{Error, Result};
use planish_exchange::ply::{MeshColumns, write_mesh, write_scan};
use planish_exchange::{PosedScan, ScanSet, Unit, make_folder, write_atomically};
use planish_mesh::{BoundingBox, TriangleMesh};
use planish_sense::{Noise, Pose, Sensor, SensorKind, Viewing};
use planish_spline::Shape;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Length of the simulated objects, in millimetres.
const SIZE_MM: f64 = 100.0;
/// True σ of the old scanner, relative to the laser.
const OLD_SIGMA: f64 = 3.0;
/// True σ of the probe, relative to the laser.
const PROBE_SIGMA: f64 = 0.04;

/// Settings of the scene `scans`.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanSceneOptions {
    /// Topology: sheet, tube or ball.
    pub shape: Shape,
    /// Seed of the surface and of every error.
    pub seed: u64,
    /// Number of readings of all scanners together; the result differs by a few per cent.
    pub readings: usize,
    /// True σ of the laser along its rays, in `unit`; across them it is half as large. Default: a thousandth
    /// of the length of the object.
    pub sigma: Option<f64>,
    /// Number of views of the laser.
    pub views: usize,
    /// True if the old scanner adds another view.
    pub old_scanner: bool,
    /// True σ divided by the stated σ of the old scanner; 1 if it states the true σ.
    pub misstated: f64,
    /// Number of points of the touch probe; 0 for no probe.
    pub probe_points: usize,
    /// Share of the readings of scanners that are outliers, by 1 to 10 % of the length of the object along
    /// the ray.
    pub outlier_share: f64,
    /// Relative increase of σ from the middle of the field of view to its corners.
    ///
    /// If it is not zero, every reading states its own σ or covariance.
    pub unevenness: f64,
    /// True if scans keep their grids of columns and rows.
    pub organised: bool,
    /// Unit of every length.
    pub unit: Unit,
    /// Maximum number of triangles of `truth.ply`. Default: half the readings, between 5120 and 80 000.
    pub truth_triangles: Option<usize>,
}

impl Default for ScanSceneOptions {
    fn default() -> Self {
        Self {
            shape: Shape::Ball,
            seed: 0,
            readings: 100_000,
            sigma: None,
            views: 3,
            old_scanner: true,
            misstated: 3.0,
            probe_points: 60,
            outlier_share: 0.01,
            unevenness: 0.0,
            organised: true,
            unit: Unit::Millimetre,
            truth_triangles: None,
        }
    }
}

impl ScanSceneOptions {
    /// Length of the object, in `unit`.
    #[must_use]
    pub fn size(&self) -> f64 {
        SIZE_MM / self.unit.millimetres()
    }

    /// True σ of the laser along its rays, in `unit`.
    fn laser_sigma(&self) -> f64 {
        self.sigma.unwrap_or(1e-3 * self.size())
    }

    /// True noise of the laser.
    pub(super) fn laser(&self) -> Noise {
        let sigma = self.laser_sigma();
        Noise::Ray { sigma_along: sigma, sigma_across: 0.5 * sigma }
    }

    /// Rejects options out of range.
    pub(super) fn sanity_check(&self) -> Result<()> {
        if self.readings == 0 || (self.views == 0 && !self.old_scanner) {
            return Err(Error::input("needed at least one view and one reading, found none"));
        }
        if self.readings > 100_000_000 || self.views > 1000 {
            let found = format!("{} readings from {} views", self.readings, self.views);
            return Err(Error::input(format!(
                "needed at most 100 million readings from 1000 views, found {found}"
            )));
        }
        positive("misstated", self.misstated)?;
        if let Some(sigma) = self.sigma {
            positive("sigma", sigma)?;
            if sigma > 0.1 * self.size() {
                let size = self.size();
                let unit = self.unit;
                return Err(Error::input(format!(
                    "needed sigma of at most a tenth of the object's {size} {unit}, found {sigma}"
                )));
            }
        }
        Ok(())
    }
}

/// True properties of one sensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorTruth {
    /// Name in the job.
    pub name: String,
    /// True σ along the ray, in the middle of the field of view.
    pub sigma_along: f64,
    /// True σ across the ray there.
    pub sigma_across: f64,
    /// True σ divided by stated σ.
    pub misstatement: f64,
    /// Share of its readings that are outliers.
    pub outlier_share: f64,
}

/// Readings with their ground truth.
#[derive(Debug, Clone)]
pub struct ScanScene {
    /// Options of the scene.
    pub options: ScanSceneOptions,
    /// The input of a fit: scans, poses, and sensors with their stated σ.
    pub set: ScanSet,
    /// The true surface.
    pub truth: Truth,
    /// True properties of each sensor of the set.
    pub sensors: Vec<SensorTruth>,
    /// True values of the readings, by scan.
    pub readings: Vec<Vec<TrueReading>>,
    /// Motion of the object, if it moved.
    pub motion: Option<TrueMotion>,
    /// True surface of each scan, if the object changed its shape; `truth` is the last.
    pub states: Vec<Truth>,
}

/// The motion of a simulated object: a rotation about a fixed axis at constant speed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrueMotion {
    /// Speed in degrees per second.
    pub rate_deg_per_s: f64,
    /// Unit direction of the axis.
    pub axis: [f64; 3],
    /// A point on the axis.
    pub axis_point: [f64; 3],
    /// Time of each scan, in seconds; the truth is the object at the first.
    pub times_s: Vec<f64>,
}

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

/// Simulates the scene in memory.
///
/// # Errors
/// `Input` for options out of range; `Unsupported` for a torus.
///
/// # Examples
/// ```
/// use planish_simulate::{ScanSceneOptions, scans};
/// # fn main() -> planish_estimate::Result<()> {
/// let options = ScanSceneOptions { readings: 800, outlier_share: 0.1, ..ScanSceneOptions::default() };
/// let scene = scans(&options)?;
/// // The old scanner states a third of its true σ.
/// let old = scene.sensors.iter().find(|s| s.name == "old").expect("the default has an old scanner");
/// assert_eq!(old.misstatement, 3.0);
/// // Every reading is known to be an outlier or not.
/// assert!(scene.readings.iter().flatten().any(|reading| reading.outlier));
/// # Ok(())
/// # }
/// ```
pub fn scans(options: &ScanSceneOptions) -> Result<ScanScene> {
    simulate(options, &Silent)
}

fn simulate(options: &ScanSceneOptions, progress: &dyn Progress) -> Result<ScanScene> {
    options.sanity_check()?;
    let size = options.size();
    let truth = Truth::freeform(options.shape, size, options.seed)?;
    let (sigma, laser) = (options.laser_sigma(), options.laser());
    let old = Noise::Isotropic { sigma: OLD_SIGMA * sigma };
    let probe = Noise::Isotropic { sigma: PROBE_SIGMA * sigma };

    let mut scene = ScanScene {
        options: options.clone(),
        set: ScanSet { unit: Some(options.unit), ..ScanSet::default() },
        truth,
        sensors: Vec::new(),
        readings: Vec::new(),
        motion: None,
        states: Vec::new(),
    };
    // The old scanner has the last view.
    let views = options.views + usize::from(options.old_scanner);
    let each = options.readings.div_ceil(views);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(2);
    for view in 0..views {
        progress.check("scanning", view as f64 / views as f64)?;
        progress.items(view * each, "readings");
        let is_old = view == options.views;
        let (name, noise, misstatement) =
            if is_old { ("old", old, options.misstated) } else { ("laser", laser, 1.0) };
        // All views of the laser are of one sensor, whose σ they estimate together.
        if is_old || view == 0 {
            scene.add_sensor(name, SensorKind::Range, noise, misstatement, options.outlier_share);
        }
        let file = format!("{name}-{}.ply", if is_old { 1 } else { view + 1 });
        let pose = view_pose(&scene.truth, options.shape, view, views, size, &mut rng)?;
        let mut scanner = VirtualScanner {
            misstatement,
            unevenness: options.unevenness,
            outlier_share: options.outlier_share,
            outlier_size: 0.1 * size,
            organised: options.organised,
            ..VirtualScanner::new(&file, pose, field_of_view(&scene.truth, &pose, is_old), [64, 64], noise)
        };
        scanner.grid = grid_for(&scanner, &scene.truth, each)?;
        let scan = scanner.scan(&scene.truth, seed_of(options.seed, view))?;
        scene.add_scan(scan);
    }
    if options.probe_points > 0 {
        scene.add_sensor("probe", SensorKind::Touch, probe, 1.0, 0.0);
        let probe = VirtualProbe {
            name: "probe.ply".to_owned(),
            world_from_probe: Pose::identity(),
            points: options.probe_points,
            sigma: probe.sigma(),
        };
        let scan = probe.scan(&scene.truth, seed_of(options.seed, views))?;
        scene.add_scan(scan);
    }
    Ok(scene)
}

impl ScanScene {
    /// Adds a sensor whose stated σ is its true σ divided by the misstatement.
    pub(super) fn add_sensor(
        &mut self,
        name: &str,
        kind: SensorKind,
        noise: Noise,
        misstatement: f64,
        outlier_share: f64,
    ) {
        let (sigma_along, sigma_across) = match noise {
            Noise::Isotropic { sigma } => (sigma, sigma),
            Noise::Ray { sigma_along, sigma_across } => (sigma_along, sigma_across),
        };
        let stated = Some(scaled(noise, 1.0 / misstatement));
        self.set.sensors.push(Sensor {
            name: name.to_owned(),
            kind,
            noise: stated,
            ..planish_sense::Sensor::default()
        });
        let name = name.to_owned();
        self.sensors.push(SensorTruth { name, sigma_along, sigma_across, misstatement, outlier_share });
    }

    /// Adds a scan of the most recently added sensor.
    pub(super) fn add_scan(&mut self, scan: VirtualScan) {
        self.set.scans.push(PosedScan {
            scan: scan.scan,
            sensor: self.set.sensors.len() - 1,
            sigma_translation: None,
            sigma_rotation_deg: None,
        });
        self.readings.push(scan.truth);
    }
}

/// The seed of a scan.
pub(super) fn seed_of(seed: u64, scan: usize) -> u64 {
    // The odd constant is 2⁶⁴ over the golden ratio: neighbours in seed and scan get seeds far apart.
    seed.wrapping_add((scan as u64 + 1).wrapping_mul(GOLDEN_GAMMA))
}

/// Pose of a view from four lengths away towards the middle of the object, off by a few random degrees.
///
/// Exactly regular directions would be a special case, with views that are parallel to axes of the object.
fn view_pose(
    truth: &Truth,
    shape: Shape,
    view: usize,
    views: usize,
    size: f64,
    rng: &mut ChaCha8Rng,
) -> Result<Pose> {
    let turn = TAU * view as f64 / views as f64;
    let towards = match shape {
        Shape::Sheet => {
            let (sin, cos) = 25.0_f64.to_radians().sin_cos();
            [sin * turn.cos(), sin * turn.sin(), cos]
        }
        Shape::Tube => [turn.cos(), turn.sin(), 0.1],
        // The corners of a tetrahedron: no direction is more than 70.5° from one of them.
        _ if views <= 4 => [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]][view],
        _ => {
            let z = 1.0 - (2 * view + 1) as f64 / views as f64;
            let ring = (1.0 - z * z).sqrt();
            // The golden angle spreads any number of views.
            let angle = 2.399_963_229_728_653 * view as f64;
            [ring * angle.cos(), ring * angle.sin(), z]
        }
    };
    let [x, y, roll] = [0; 3].map(|_| rng.random::<f64>() - 0.5);
    let perturbed = unit(towards).and_then(|d| {
        let (e1, e2) = tangents(d);
        unit(add_scaled(add_scaled(d, 0.1 * x, e1), 0.1 * y, e2))
    });
    let z = perturbed.ok_or_else(|| Error::input("the direction of view is undefined"))?;
    looking_from(truth, z, TAU * roll, size)
}

/// A pose four lengths from the middle of the object in direction `z`, rotated about it by `roll_rad`.
///
/// A scanner looks along its −z axis, so `z` points from the object to the scanner.
pub(super) fn looking_from(truth: &Truth, z: [f64; 3], roll_rad: f64, size: f64) -> Result<Pose> {
    let (e1, e2) = tangents(z);
    let (sin, cos) = roll_rad.sin_cos();
    let x = add_scaled(scale(cos, e1), sin, e2);
    let y = cross(z, x);
    let rotation = [0, 1, 2].map(|k| [x[k], y[k], z[k]]);
    let middle = BoundingBox::from_points(&truth.mesh(5120).0.positions).map_or([0.0; 3], |b| b.center());
    let position = add_scaled(middle, 4.0 * size, z);
    let exact = Pose { rotation, translation: position };
    // A job states the pose as a quaternion. Its rounded value is used here, too, so that a scene in memory
    // and one read from files agree exactly.
    Pose::from_quaternion_xyzw(exact.quaternion_xyzw(), position)
        .ok_or_else(|| Error::input("the direction of view is undefined"))
}

/// Optics that cover the whole object: parallel rays for the old scanner, central rays for the laser.
pub(super) fn field_of_view(truth: &Truth, pose: &Pose, parallel: bool) -> Optics {
    let scanner_from_world = pose.inverse();
    let mut half = [0.0_f64; 2];
    for p in truth.mesh(5120).0.positions {
        let [x, y, z] = scanner_from_world.apply(p);
        let by = if parallel { 1.0 } else { -z };
        half = [half[0].max(x.abs() / by), half[1].max(y.abs() / by)];
    }
    // The coarse mesh is inscribed in the surface; 2 % cover what it misses.
    let half = half.map(|h| 1.02 * h);
    if parallel { Optics::Parallel { half } } else { Optics::Central { tangents: half } }
}

/// Columns and rows that give about `wanted` readings.
///
/// The share of rays that meet the surface is counted with the coarse grid of `pilot`.
pub(super) fn grid_for(pilot: &VirtualScanner, truth: &Truth, wanted: usize) -> Result<[usize; 2]> {
    pilot.sanity_check()?;
    let seen = pilot.count(truth);
    if seen == 0 {
        return Err(Error::undetermined(format!("no ray of {} meets the surface", pilot.name)));
    }
    let cells = wanted as f64 * (pilot.grid[0] * pilot.grid[1]) as f64 / seen as f64;
    let (Optics::Parallel { half } | Optics::Central { tangents: half }) = pilot.optics;
    let columns = (cells * half[0] / half[1]).sqrt().round().max(1.0);
    Ok([columns as usize, (cells / columns).round().max(1.0) as usize])
}

/// Simulates the scene and writes its files, as `planish simulate scene scans` does.
///
/// # Errors
/// As [`scans`] and [`write_scan_scene`]; `Interrupted` on request, before anything is written.
pub fn write_scans_scene(
    options: &ScanSceneOptions,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<ScanSceneSummary> {
    // Wrong options are reported before the folder is made.
    options.sanity_check()?;
    Truth::freeform(options.shape, options.size(), options.seed)?;
    write_simulated(folder, progress, |progress| simulate(options, progress))
}

/// Simulates a scene and writes its files, with progress.
pub(super) fn write_simulated(
    folder: &Path,
    progress: &dyn Progress,
    simulate: impl FnOnce(&dyn Progress) -> Result<ScanScene>,
) -> Result<ScanSceneSummary> {
    // A folder that cannot be made is reported before the simulation.
    make_folder(folder)?;
    let scene = simulate(&ProgressPart::new(progress, 0.0, 0.7))?;
    progress.check(WRITING_STAGE, 0.7)?;
    let summary = write_scan_scene(&scene, folder)?;
    progress.advance("done", 1.0);
    Ok(summary)
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
    for (k, state) in scene.states.iter().enumerate() {
        files.push(write_truth(state, &format!("truth-{}.ply", k + 1))?.0);
    }
    let (path, mesh) = write_truth(&scene.truth, "truth.ply")?;
    files.push(path);
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
        mesh_chord_error: (0..mesh.triangles.len()).into_par_iter().map(chord).reduce(|| 0.0, f64::max),
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
            pose.translation,
            pose.quaternion_xyzw()
        );
        if let Some(time) = posed.scan.time_s {
            let _ = writeln!(text, "time = {time:?}");
        }
        let _ = match posed.scan.viewing {
            Viewing::Unknown => Ok(()),
            Viewing::Direction(d) => writeln!(text, "direction = {d:?}"),
            Viewing::Origin(p) => writeln!(text, "viewpoint = {p:?}"),
        };
    }
    text
}
