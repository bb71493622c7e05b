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

mod files;

pub(super) use files::SceneFiles;
pub use files::{ObjectTruth, ScanFile, ScanSceneSummary, TruthSummary, write_scan_scene};

use super::truth::{Truth, positive};
use super::virtual_sensor::{
    Optics, ScannedSurface, TrueReading, VirtualProbe, VirtualScan, VirtualScanner, scaled,
};
use planish_core::matrix3::from_columns;
use planish_core::random::GOLDEN_GAMMA;
use planish_core::vector3::tangents;
use planish_core::{DVec3, Progress, ProgressPart, Silent, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::{PosedScan, ScanSet, Unit, make_folder};
use planish_mesh::BoundingBox;
use planish_sense::{Noise, Pose, Sensor, SensorKind};
use planish_spline::Shape;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::f64::consts::TAU;
use std::path::Path;

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
            return Err(Error::input("expected at least one view and one reading, found none"));
        }
        if self.readings > 100_000_000 || self.views > 1000 {
            let found = format!("{} readings from {} views", self.readings, self.views);
            return Err(Error::input(format!(
                "expected at most 100 million readings from 1000 views, found {found}"
            )));
        }
        positive("misstated", self.misstated)?;
        if let Some(sigma) = self.sigma {
            positive("sigma", sigma)?;
            if sigma > 0.1 * self.size() {
                let size = self.size();
                let unit = self.unit;
                return Err(Error::input(format!(
                    "expected sigma of at most a tenth of the object's {size} {unit}, found {sigma}"
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

impl SensorTruth {
    /// A sensor that states its true σ.
    pub(super) fn exactly_stated(name: &str, noise: Noise, outlier_share: f64) -> Self {
        let (sigma_along, sigma_across) = match noise {
            Noise::Isotropic { sigma } => (sigma, sigma),
            Noise::Ray { sigma_along, sigma_across } => (sigma_along, sigma_across),
        };
        Self { name: name.to_owned(), sigma_along, sigma_across, misstatement: 1.0, outlier_share }
    }
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
    pub axis: DVec3,
    /// A point on the axis.
    pub axis_point: DVec3,
    /// Time of each scan, in seconds; the truth is the object at the first.
    pub times_s: Vec<f64>,
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
    // The same number for each view, however much of the surface it covers.
    let each = options.readings.div_ceil(views);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    // Stream 0 of this seed draws the surface: another number of views leaves it unchanged.
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
        // The object fills only part of the field of view, so the grid needs more cells than readings.
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
        let stated = Some(scaled(noise, 1.0 / misstatement));
        self.set.sensors.push(Sensor {
            name: name.to_owned(),
            kind,
            noise: stated,
            ..planish_sense::Sensor::default()
        });
        let exact = SensorTruth::exactly_stated(name, noise, outlier_share);
        self.sensors.push(SensorTruth { misstatement, ..exact });
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
            DVec3::new(sin * turn.cos(), sin * turn.sin(), cos)
        }
        Shape::Tube => DVec3::new(turn.cos(), turn.sin(), 0.1),
        // The corners of a tetrahedron: no direction is more than 70.5° from one of them.
        _ if views <= 4 => DVec3::from_array(
            [
                DVec3::new(1.0, 1.0, 1.0),
                DVec3::new(1.0, -1.0, -1.0),
                DVec3::new(-1.0, 1.0, -1.0),
                DVec3::new(-1.0, -1.0, 1.0),
            ][view]
                .to_array(),
        ),
        _ => {
            let z = 1.0 - (2 * view + 1) as f64 / views as f64;
            spiral_direction(z, view)
        }
    };
    let middle = BoundingBox::from_points(&truth.mesh(5120).0.positions).map_or(DVec3::ZERO, |b| b.center());
    roughly_from(middle, towards, size, rng)
}

/// Unit direction of a view at this height on a spiral that spreads any number of views around an object.
pub(super) fn spiral_direction(z: f64, view: usize) -> DVec3 {
    let ring = (1.0 - z * z).max(0.0).sqrt();
    // The golden angle.
    let angle = 2.399_963_229_728_653 * view as f64;
    DVec3::new(ring * angle.cos(), ring * angle.sin(), z)
}

/// A pose four lengths from `middle`, off the direction `towards` by a few random degrees.
pub(super) fn roughly_from(middle: DVec3, towards: DVec3, size: f64, rng: &mut ChaCha8Rng) -> Result<Pose> {
    let [x, y, roll] = [0; 3].map(|_| rng.random::<f64>() - 0.5);
    let perturbed = towards.try_normalize().and_then(|d| {
        let (e1, e2) = tangents(d);
        (d + 0.1 * x * e1 + 0.1 * y * e2).try_normalize()
    });
    let z = perturbed.ok_or_else(|| Error::input("the direction of view is undefined"))?;
    pose_towards(middle, z, TAU * roll, size)
}

/// A pose four lengths from the middle of the object in direction `z`, rotated about it by `roll_rad`.
///
/// A scanner looks along its −z axis, so `z` points from the object to the scanner.
pub(super) fn looking_from(truth: &Truth, z: DVec3, roll_rad: f64, size: f64) -> Result<Pose> {
    let middle = BoundingBox::from_points(&truth.mesh(5120).0.positions).map_or(DVec3::ZERO, |b| b.center());
    pose_towards(middle, z, roll_rad, size)
}

/// A pose four lengths from `middle` in direction `z`, rotated about it by `roll_rad`.
fn pose_towards(middle: DVec3, z: DVec3, roll_rad: f64, size: f64) -> Result<Pose> {
    let (e1, e2) = tangents(z);
    let (sin, cos) = roll_rad.sin_cos();
    let x = cos * e1 + sin * e2;
    let y = z.cross(x);
    let rotation = from_columns([x, y, z]);
    let position = middle + 4.0 * size * z;
    let exact = Pose { rotation, translation: position };
    // A job states the pose as a quaternion. Its rounded value is used here, too, so that a scene in memory
    // and one read from files agree exactly.
    Pose::from_quaternion_xyzw(exact.quaternion_xyzw(), position)
        .ok_or_else(|| Error::input("the direction of view is undefined"))
}

/// Optics that cover the whole object: parallel rays for the old scanner, central rays for the laser.
pub(super) fn field_of_view(truth: &Truth, pose: &Pose, parallel: bool) -> Optics {
    field_of_view_of(&truth.mesh(5120).0.positions, pose, parallel)
}

/// Optics that cover these points, with a margin of 2 %.
pub(super) fn field_of_view_of(points: &[DVec3], pose: &Pose, parallel: bool) -> Optics {
    let scanner_from_world = pose.inverse();
    let mut half = [0.0_f64; 2];
    for p in points {
        let DVec3 { x, y, z } = scanner_from_world.apply(*p);
        let by = if parallel { 1.0 } else { -z };
        half = [half[0].max(x.abs() / by), half[1].max(y.abs() / by)];
    }
    // A coarse mesh is inscribed in its surface; 2 % cover what it misses.
    let half = half.map(|h| 1.02 * h);
    if parallel { Optics::Parallel { half } } else { Optics::Central { tangents: half } }
}

/// Columns and rows that give about `wanted` readings.
///
/// The share of rays that meet the surface is counted with the coarse grid of `pilot`.
pub(super) fn grid_for(
    pilot: &VirtualScanner,
    surface: &impl ScannedSurface,
    wanted: usize,
) -> Result<[usize; 2]> {
    pilot.sanity_check()?;
    let seen = pilot.count(surface);
    if seen == 0 {
        return Err(Error::undetermined(format!(
            "expected rays of {} that meet the surface, found none",
            pilot.name
        )));
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
