//! The scene `scans`: one freeform, several sensors, everything that goes wrong, and the truth.
//!
//! Input: [`ScanSceneOptions`]. Output: a [`ScanScene`] whose `set` is ready for
//! [`planish_surface::fit::fit`], or a folder: a PLY file for each scan, `job.toml` that names them,
//! `truth.ply` and `truth.json`.
//!
//! The sensors: `laser`, a range camera with other σ along than across the ray; `old`, a scanner with three
//! times its σ in every direction that states less than is true; `probe`, a touch probe with a twenty-fifth
//! of the laser's σ.
//!
//! Not guaranteed: that all of a surface is seen. Three views leave part of a ball open; the fourth, the old
//! scanner's, closes it.

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
/// True σ of the old scanner over the laser's.
const OLD_SIGMA: f64 = 3.0;
/// True σ of the probe over the laser's.
const PROBE_SIGMA: f64 = 0.04;

/// Settings of the scene `scans`.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanSceneOptions {
    /// Sheet, tube or ball.
    pub shape: Shape,
    /// Seed of the surface and of every error.
    pub seed: u64,
    /// Readings of all scanners together, to within a few per cent.
    pub readings: usize,
    /// True σ of the laser along its rays, in `unit`; half of it holds across. A thousandth of the object's
    /// length if none is given.
    pub sigma: Option<f64>,
    /// Views of the laser.
    pub views: usize,
    /// Whether the old scanner adds one more view.
    pub old_scanner: bool,
    /// True σ over stated σ of the old scanner: 1 is honest.
    pub misstated: f64,
    /// Points of the touch probe; 0 for no probe.
    pub probe_points: usize,
    /// Share of the scanners' readings with a gross error, of 1 to 10 % of the object's length along the ray.
    pub outlier_share: f64,
    /// σ grows by this share from the middle of each scanner's field of view to its corners; every reading
    /// then states its own.
    pub unevenness: f64,
    /// Whether scans keep their grids.
    pub organised: bool,
    /// Unit of every length.
    pub unit: Unit,
    /// Triangles of `truth.ply`, at most; half the readings, between 5120 and 80 000, if none is given.
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
    /// The object's length, in the unit.
    #[must_use]
    pub fn size(&self) -> f64 {
        SIZE_MM / self.unit.millimetres()
    }

    /// True σ of the laser along its rays.
    fn laser_sigma(&self) -> f64 {
        self.sigma.unwrap_or(1e-3 * self.size())
    }

    /// True noise of the laser.
    pub(super) fn laser(&self) -> Noise {
        let sigma = self.laser_sigma();
        Noise::Ray { sigma_along: sigma, sigma_across: 0.5 * sigma }
    }

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

/// What is true of one sensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorTruth {
    /// Its name in the job.
    pub name: String,
    /// True σ along the ray, at the middle of the field of view.
    pub sigma_along: f64,
    /// True σ across the ray there.
    pub sigma_across: f64,
    /// True σ over stated σ.
    pub misstatement: f64,
    /// Share of its readings with a gross error.
    pub outlier_share: f64,
}

/// Readings with the truth behind them.
#[derive(Debug, Clone)]
pub struct ScanScene {
    /// What was asked for.
    pub options: ScanSceneOptions,
    /// What a user would have: scans, poses, sensors with their stated σ.
    pub set: ScanSet,
    /// The true surface.
    pub truth: Truth,
    /// What is true of each of the set's sensors.
    pub sensors: Vec<SensorTruth>,
    /// For each scan, what each of its readings really saw.
    pub readings: Vec<Vec<TrueReading>>,
    /// How the object moved, where it did.
    pub motion: Option<TrueMotion>,
    /// Of an object that changes its shape, the true surface behind each scan; `truth` is the last.
    pub states: Vec<Truth>,
}

/// The motion of a simulated object: a constant turn about a fixed axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrueMotion {
    /// Degrees per second.
    pub rate_deg_per_s: f64,
    /// The unit direction of the axis.
    pub axis: [f64; 3],
    /// A point of it.
    pub axis_point: [f64; 3],
    /// When each scan was taken, in seconds; the truth is the object at the first.
    pub times_s: Vec<f64>,
}

/// One scan's file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScanFile {
    /// Its name in the folder.
    pub file: String,
    /// Its sensor.
    pub sensor: String,
    /// How many readings it holds.
    pub readings: usize,
    /// How many of them have a gross error.
    pub outliers: usize,
}

/// What `truth.json` says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthSummary {
    /// Sheet, tube or ball.
    pub shape: String,
    /// Seed of the scene.
    pub seed: u64,
    /// Unit of every length.
    pub unit: String,
    /// The sensors as they really are.
    pub sensors: Vec<SensorTruth>,
    /// The scans.
    pub scans: Vec<ScanFile>,
    /// Vertices of `truth.ply`; they lie on the surface, their normals are exact.
    pub mesh_vertices: usize,
    /// Triangles of `truth.ply`.
    pub mesh_triangles: usize,
    /// The largest distance of a triangle's middle to the surface: what comparing with its facets cannot see
    /// below.
    pub mesh_chord_error: f64,
    /// The formula of the surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<ClosedForm>,
    /// How the object moved, where it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<TrueMotion>,
    /// The formulas of the surface at each time, where it changed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub states: Vec<ClosedForm>,
}

/// What [`write_scans_scene`] wrote.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScanSceneSummary {
    /// Readings in all.
    pub rows: usize,
    /// Columns of the scans.
    pub columns: Vec<String>,
    /// Every file that was written, the job first.
    pub files: Vec<PathBuf>,
    /// What is true of them.
    pub truth: TruthSummary,
}

/// Simulates the scene in memory.
///
/// # Errors
/// `Input` for options that make no sense; `Unsupported` for a torus.
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
        if is_old || view == 0 {
            scene.add_sensor(name, SensorKind::Range, noise, misstatement, options.outlier_share);
        }
        let file = format!("{name}-{}.ply", if is_old { 1 } else { view + 1 });
        let pose = pose(&scene.truth, options.shape, view, views, size, &mut rng)?;
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

    /// Adds a scan of the sensor that was added last.
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

/// A seed for each scan.
pub(super) fn seed_of(seed: u64, scan: usize) -> u64 {
    // The odd constant is 2⁶⁴ over the golden ratio: neighbours in seed and scan get seeds far apart.
    seed.wrapping_add((scan as u64 + 1).wrapping_mul(GOLDEN_GAMMA))
}

/// Where a view stands: looking at the middle of the object from four lengths away, with a few degrees of
/// disorder.
fn pose(
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
    let disordered = unit(towards).and_then(|d| {
        let (e1, e2) = tangents(d);
        unit(add_scaled(add_scaled(d, 0.1 * x, e1), 0.1 * y, e2))
    });
    let z = disordered.ok_or_else(|| Error::input("a view without a direction"))?;
    looking_from(truth, z, TAU * roll, size)
}

/// A pose four lengths away from the middle of the object, in a direction, turned about it by `roll_rad`.
pub(super) fn looking_from(truth: &Truth, z: [f64; 3], roll_rad: f64, size: f64) -> Result<Pose> {
    let (e1, e2) = tangents(z);
    let (sin, cos) = roll_rad.sin_cos();
    let x = add_scaled(scale(cos, e1), sin, e2);
    let y = cross(z, x);
    let rotation = [0, 1, 2].map(|k| [x[k], y[k], z[k]]);
    let middle = BoundingBox::from_points(&truth.mesh(5120).0.positions).map_or([0.0; 3], |b| b.center());
    let position = add_scaled(middle, 4.0 * size, z);
    let exact = Pose { rotation, translation: position };
    // The pose of the quaternion as it is written, so that memory and file agree.
    Pose::from_quaternion_xyzw(exact.quaternion_xyzw(), position)
        .ok_or_else(|| Error::input("a view without a direction"))
}

/// Optics that take in all of the object: parallel rays for the old scanner, rays from a point for the laser.
pub(super) fn field_of_view(truth: &Truth, pose: &Pose, parallel: bool) -> Optics {
    let scanner_from_world = pose.inverse();
    let mut half = [0.0_f64; 2];
    for p in truth.mesh(5120).0.positions {
        let [x, y, z] = scanner_from_world.apply(p);
        let by = if parallel { 1.0 } else { -z };
        half = [half[0].max(x.abs() / by), half[1].max(y.abs() / by)];
    }
    let half = half.map(|h| 1.02 * h);
    if parallel { Optics::Parallel { half } } else { Optics::Central { tangents: half } }
}

/// Columns and rows that give about as many readings as wanted, by counting those of a coarse grid.
pub(super) fn grid_for(pilot: &VirtualScanner, truth: &Truth, wanted: usize) -> Result<[usize; 2]> {
    pilot.sanity_check()?;
    let seen = pilot.count(truth);
    if seen == 0 {
        return Err(Error::undetermined(format!("{} sees nothing of the surface", pilot.name)));
    }
    let cells = wanted as f64 * (pilot.grid[0] * pilot.grid[1]) as f64 / seen as f64;
    let (Optics::Parallel { half } | Optics::Central { tangents: half }) = pilot.optics;
    let columns = (cells * half[0] / half[1]).sqrt().round().max(1.0);
    Ok([columns as usize, (cells / columns).round().max(1.0) as usize])
}

/// Simulates the scene and writes it: what `planish simulate scene scans` does.
///
/// # Errors
/// As [`scans`] and [`write_scan_scene`]; `Interrupted` on request, before anything is written.
pub fn write_scans_scene(
    options: &ScanSceneOptions,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<ScanSceneSummary> {
    options.sanity_check()?;
    Truth::freeform(options.shape, options.size(), options.seed)?;
    write_simulated(folder, progress, |progress| simulate(options, progress))
}

/// Simulates a scene and writes it, with progress.
pub(super) fn write_simulated(
    folder: &Path,
    progress: &dyn Progress,
    simulate: impl FnOnce(&dyn Progress) -> Result<ScanScene>,
) -> Result<ScanSceneSummary> {
    // A folder that cannot be made is known before the work.
    make_folder(folder)?;
    let scene = simulate(&ProgressPart::new(progress, 0.0, 0.7))?;
    progress.check(WRITING_STAGE, 0.7)?;
    let summary = write_scan_scene(&scene, folder)?;
    progress.advance("done", 1.0);
    Ok(summary)
}

/// Writes a scene into a folder, which is made where it is missing: the scans, `truth.ply`, `truth.json`, and
/// `job.toml` last.
///
/// Each file is whole or not there. Files of the same names are replaced; others stay.
///
/// # Errors
/// `Io` when the folder cannot be made or a file not written.
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

/// The job that names the scans, as [`planish_exchange::job::read_job`] reads it.
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
