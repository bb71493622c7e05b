//! The scenes `handles`, `plate`, `cup` and `bracket`: a solid object, scanned by a laser from all around.
//!
//! Input: [`ObjectSceneOptions`]. Output: an [`ObjectScene`] whose `set` is ready for
//! [`planish_surface::fit::fit`], or a folder with a PLY file for each scan, `job.toml` that names them,
//! `truth.ply` and `truth.json`.
//!
//! Readings are points of the exact surface, not of its mesh, with Gaussian errors. The stated σ is correct.
//! A share of the readings are gross errors along their rays.
//!
//! Not guaranteed: that the views cover the whole surface. The twelve views of the default measure more than
//! 99 % of each object.

#[cfg(test)]
mod tests;

use super::objects::{ObjectKind, SolidObject};
use super::scans::{
    ObjectTruth, ScanSceneOptions, ScanSceneSummary, SceneFiles, SensorTruth, TruthSummary, field_of_view_of,
    grid_for, roughly_from, seed_of, spiral_direction,
};
use super::virtual_sensor::{TrueReading, VirtualScanner};
use planish_core::{DVec3, Progress, ProgressPart, Silent, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::{PosedScan, ScanSet, Unit, make_folder};
use planish_mesh::BoundingBox;
use planish_sense::{Sensor, SensorKind};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::Path;

/// Largest σ of normals, in degrees. A larger one would give directions that are almost random.
const MAX_NORMAL_SIGMA_DEG: f64 = 30.0;

/// Settings of the scenes of solid objects.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectSceneOptions {
    /// The object.
    pub object: ObjectKind,
    /// Seed of the poses and of every error.
    pub seed: u64,
    /// Number of readings of all scans together; the result differs by a few per cent.
    pub readings: usize,
    /// Number of scans, from directions all around the object.
    pub views: usize,
    /// True and stated σ of the laser along its rays, in `unit`; across them it is half as large. Default: a
    /// thousandth of the size of the object.
    pub sigma: Option<f64>,
    /// σ of the measured normals about each of two tangents, in degrees; `None` for no normals.
    pub sigma_normal_deg: Option<f64>,
    /// Share of the readings that are outliers, by 1 to 10 % of the size of the object along the ray.
    pub outlier_share: f64,
    /// Unit of every length. The size of the object is 100 mm.
    pub unit: Unit,
}

impl Default for ObjectSceneOptions {
    fn default() -> Self {
        Self {
            object: ObjectKind::Handles { genus: 2 },
            seed: 0,
            readings: 60_000,
            views: 12,
            sigma: None,
            sigma_normal_deg: Some(5.0),
            outlier_share: 0.01,
            unit: Unit::Millimetre,
        }
    }
}

impl ObjectSceneOptions {
    /// The settings of the laser, which are those of the scene `scans`.
    fn as_scans(&self) -> Result<ScanSceneOptions> {
        let options = ScanSceneOptions {
            seed: self.seed,
            readings: self.readings,
            sigma: self.sigma,
            views: self.views,
            old_scanner: false,
            probe_points: 0,
            outlier_share: self.outlier_share,
            unit: self.unit,
            ..ScanSceneOptions::default()
        };
        options.sanity_check()?;
        match self.sigma_normal_deg {
            Some(sigma) if !(sigma > 0.0 && sigma <= MAX_NORMAL_SIGMA_DEG) => Err(Error::input(format!(
                "expected a σ of normals above 0° and up to {MAX_NORMAL_SIGMA_DEG}°, found {sigma}°"
            ))),
            _ => Ok(options),
        }
    }

    /// The object.
    fn solid_object(&self) -> Result<SolidObject> {
        SolidObject::new(self.object, self.as_scans()?.size())
    }
}

/// Readings of a solid object with their ground truth.
#[derive(Debug, Clone)]
pub struct ObjectScene {
    /// Options of the scene.
    pub options: ObjectSceneOptions,
    /// The input of a fit: scans, poses, and the laser with its stated σ.
    pub set: ScanSet,
    /// The object.
    pub object: SolidObject,
    /// True properties of the laser.
    pub sensor: SensorTruth,
    /// True values of the readings, by scan.
    pub readings: Vec<Vec<TrueReading>>,
}

/// Simulates the scene in memory.
///
/// # Errors
/// `Input` for options out of range.
///
/// # Examples
/// ```
/// use planish_simulate::{ObjectKind, ObjectSceneOptions, object_scene};
/// # fn main() -> planish_estimate::Result<()> {
/// let options = ObjectSceneOptions {
///     object: ObjectKind::Handles { genus: 3 },
///     readings: 900,
///     ..ObjectSceneOptions::default()
/// };
/// let scene = object_scene(&options)?;
/// assert_eq!((scene.set.scans.len(), scene.object.genus()), (12, 3));
/// // True points lie on the surface.
/// assert!(scene.readings[0].iter().all(|r| scene.object.value(r.point.position).abs() < 1e-7));
/// # Ok(())
/// # }
/// ```
pub fn object_scene(options: &ObjectSceneOptions) -> Result<ObjectScene> {
    simulate(options, &Silent)
}

fn simulate(options: &ObjectSceneOptions, progress: &dyn Progress) -> Result<ObjectScene> {
    let as_scans = options.as_scans()?;
    let object = options.solid_object()?;
    let (size, noise) = (as_scans.size(), as_scans.laser());
    let bounds = object.bounds();
    let mut scene = ObjectScene {
        options: options.clone(),
        set: ScanSet { unit: Some(options.unit), ..ScanSet::default() },
        sensor: SensorTruth::exactly_stated("laser", noise, options.outlier_share),
        object,
        readings: Vec::new(),
    };
    scene.set.sensors.push(Sensor {
        name: scene.sensor.name.clone(),
        kind: SensorKind::Range,
        noise: Some(noise),
        ..Sensor::default()
    });
    let each = options.readings.div_ceil(options.views);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    for view in 0..options.views {
        progress.check("scanning", view as f64 / options.views as f64)?;
        progress.items(view * each, "readings");
        // From the first view straight from above to the last straight from below.
        let share = view as f64 / (options.views - 1).max(1) as f64;
        let towards = spiral_direction(scene.object.view_height(share), view);
        let pose = roughly_from(bounds.center(), towards, size, &mut rng)?;
        let optics = field_of_view_of(&corners(&bounds), &pose, false);
        let file = format!("laser-{}.ply", view + 1);
        let mut scanner = VirtualScanner {
            outlier_share: options.outlier_share,
            outlier_size: 0.1 * size,
            sigma_normal_deg: options.sigma_normal_deg,
            ..VirtualScanner::new(&file, pose, optics, [64, 64], noise)
        };
        // The object fills only part of the field of view, so the grid needs more cells than readings.
        scanner.grid = grid_for(&scanner, &scene.object, each)?;
        let scan = scanner.scan(&scene.object, seed_of(options.seed, view))?;
        scene.set.scans.push(PosedScan {
            scan: scan.scan,
            sensor: 0,
            sigma_translation: None,
            sigma_rotation_deg: None,
        });
        scene.readings.push(scan.truth);
    }
    Ok(scene)
}

/// The corners of a box.
fn corners(bounds: &BoundingBox) -> [DVec3; 8] {
    std::array::from_fn(|k| {
        let [x, y, z] = [0, 1, 2].map(|d| if k >> d & 1 == 1 { bounds.max[d] } else { bounds.min[d] });
        DVec3::new(x, y, z)
    })
}

/// Simulates the scene and writes its files, as `planish simulate scene handles` does.
///
/// # Errors
/// As [`object_scene`]; `Io` if the folder cannot be created or a file cannot be written; `Interrupted` on
/// request, before anything is written.
pub fn write_object_scene(
    options: &ObjectSceneOptions,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<ScanSceneSummary> {
    // Wrong options are reported before the folder is made, and a folder that cannot be made before the
    // simulation.
    options.solid_object()?;
    make_folder(folder)?;
    let scene = simulate(options, &ProgressPart::new(progress, 0.0, 0.7))?;
    progress.check(WRITING_STAGE, 0.7)?;
    let summary = write_files(&scene, folder)?;
    progress.advance("done", 1.0);
    Ok(summary)
}

fn write_files(scene: &ObjectScene, folder: &Path) -> Result<ScanSceneSummary> {
    let truth = scene.object.mesh()?;
    let mut files = SceneFiles::new(folder)?;
    let scans = files.write_scans(&scene.set, &scene.readings)?;
    files.write_mesh("truth.ply", &truth.mesh, &truth.normals, scene.set.unit)?;
    let summary = TruthSummary {
        shape: scene.object.name().to_owned(),
        seed: scene.options.seed,
        unit: scene.options.unit.name().to_owned(),
        sensors: vec![scene.sensor.clone()],
        scans,
        mesh_vertices: truth.mesh.positions.len(),
        mesh_triangles: truth.mesh.triangles.len(),
        mesh_chord_error: truth.chord_error,
        surface: None,
        motion: None,
        states: Vec::new(),
        object: Some(ObjectTruth {
            genus: scene.object.genus(),
            form: scene.object.clone(),
            holes: scene.object.holes().to_vec(),
            fillets: scene.object.fillets(),
            edges: truth.edges,
        }),
    };
    files.finish(&scene.set, summary)
}
