//! The scene `turning`: a freeform on a turntable, scanned by a fixed laser at known times.
//!
//! Input: [`TurningOptions`]. Output: a [`ScanScene`] whose scans all have the pose of the laser and state
//! their times. The truth is the object in its position at the first scan.

use super::scans::{
    ScanScene, ScanSceneOptions, ScanSceneSummary, TrueMotion, field_of_view, grid_for, looking_from,
    seed_of, write_simulated,
};
use super::truth::{Truth, positive};
use super::virtual_sensor::VirtualScanner;
use planish_core::{DVec3, Progress, Silent};
use planish_estimate::{Error, Result};
use planish_exchange::{ScanSet, Unit};
use planish_sense::{Pose, SensorKind};
use planish_spline::Shape;
use std::path::Path;

/// Direction from the object to the laser.
const FROM: DVec3 = DVec3::new(0.9, 0.1, 0.45);
/// Direction of the axis of the table, which is neither vertical nor through the origin: it has to be
/// estimated.
const AXIS: DVec3 = DVec3::new(0.05, -0.1, 1.0);
/// A point on the axis, relative to the size of the object.
const AXIS_POINT: DVec3 = DVec3::new(0.1, 0.05, 0.0);

/// Settings of the scene `turning`.
#[derive(Debug, Clone, PartialEq)]
pub struct TurningOptions {
    /// Seed of the surface and of every error.
    pub seed: u64,
    /// Number of readings of all scans together; the result differs by a few per cent.
    pub readings: usize,
    /// Number of scans, one per second.
    pub views: usize,
    /// Speed of the table in degrees per second.
    pub rate_deg_per_s: f64,
    /// True σ of the laser along its rays, in `unit`; across them it is half as large. Default: a thousandth
    /// of the length of the object.
    pub sigma: Option<f64>,
    /// Unit of every length.
    pub unit: Unit,
}

impl Default for TurningOptions {
    fn default() -> Self {
        Self { seed: 0, readings: 60_000, views: 6, rate_deg_per_s: 6.0, sigma: None, unit: Unit::Millimetre }
    }
}

impl TurningOptions {
    fn as_scans(&self) -> Result<ScanSceneOptions> {
        positive("rate", self.rate_deg_per_s)?;
        if self.views < 2 {
            return Err(Error::input(format!(
                "expected at least two views of a turning object, found {}",
                self.views
            )));
        }
        let options = ScanSceneOptions {
            shape: Shape::Ball,
            seed: self.seed,
            readings: self.readings,
            sigma: self.sigma,
            views: self.views,
            old_scanner: false,
            probe_points: 0,
            outlier_share: 0.0,
            unit: self.unit,
            ..ScanSceneOptions::default()
        };
        options.sanity_check()?;
        Ok(options)
    }
}

/// Simulates the scene in memory.
///
/// # Errors
/// `Input` for options out of range.
///
/// # Examples
/// ```
/// use planish_simulate::{TurningOptions, turning};
/// # fn main() -> planish_estimate::Result<()> {
/// let scene = turning(&TurningOptions { readings: 600, views: 3, ..TurningOptions::default() })?;
/// let motion = scene.motion.expect("the object turns");
/// assert_eq!((motion.rate_deg_per_s, motion.times_s), (6.0, vec![0.0, 1.0, 2.0]));
/// # Ok(())
/// # }
/// ```
pub fn turning(options: &TurningOptions) -> Result<ScanScene> {
    simulate(options, &Silent)
}

fn simulate(turning: &TurningOptions, progress: &dyn Progress) -> Result<ScanScene> {
    let options = turning.as_scans()?;
    let size = options.size();
    let truth = Truth::freeform(options.shape, size, options.seed)?;
    let noise = options.laser();
    let direction =
        |d: DVec3| d.try_normalize().ok_or_else(|| Error::input("the direction of view is undefined"));
    let laser = looking_from(&truth, direction(FROM)?, 0.0, size)?;
    let axis = direction(AXIS)?;
    let axis_point = size * AXIS_POINT;
    // The axis is part of the truth only. A job states times and poses, from which the motion has to be
    // estimated.
    let mut scene = ScanScene {
        set: ScanSet { unit: Some(options.unit), ..ScanSet::default() },
        motion: Some(TrueMotion {
            rate_deg_per_s: turning.rate_deg_per_s,
            axis,
            axis_point,
            times_s: (0..options.views).map(|k| k as f64).collect(),
        }),
        options,
        truth,
        sensors: Vec::new(),
        readings: Vec::new(),
        states: Vec::new(),
    };
    scene.add_sensor("laser", SensorKind::Range, noise, 1.0, 0.0);
    let turn = turning.rate_deg_per_s.to_radians() * axis;
    // A rotation about an axis through a is p ↦ a + R(p − a), whose twist is (ω, −ω × a).
    let slide = -turn.cross(axis_point);
    let each = turning.readings.div_ceil(turning.views);
    for view in 0..turning.views {
        progress.check("scanning", view as f64 / turning.views as f64)?;
        progress.items(view * each, "readings");
        let time = view as f64;
        // The truth stays fixed and the scanner moves in its frame: the surface is prepared for rays once.
        // The written pose is that of the fixed laser.
        let world_from_object = Pose::from_twist(time * turn, time * slide);
        let object_from_laser = world_from_object.inverse().after(&laser);
        let file = format!("laser-{}.ply", view + 1);
        // The field of view follows the object: a fixed one would have to cover it in all positions and
        // waste rays.
        let optics = field_of_view(&scene.truth, &object_from_laser, false);
        let mut scanner = VirtualScanner::new(&file, object_from_laser, optics, [64, 64], noise);
        scanner.grid = grid_for(&scanner, &scene.truth, each)?;
        let mut scan = scanner.scan(&scene.truth, seed_of(turning.seed, view))?;
        scan.scan.world_from_scanner = laser;
        scan.scan.time_s = Some(time);
        scene.add_scan(scan);
    }
    Ok(scene)
}

/// Simulates the scene and writes its files, as `planish simulate scene turning` does.
///
/// # Errors
/// As [`turning`] and [`super::write_scan_scene`]; `Interrupted` on request, before anything is written.
pub fn write_turning_scene(
    options: &TurningOptions,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<ScanSceneSummary> {
    options.as_scans()?;
    write_simulated(folder, progress, |progress| simulate(options, progress))
}
