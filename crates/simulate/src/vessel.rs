//! The scene `vessel`: a surface of revolution, scanned by a laser from one side.
//!
//! Input: [`VesselOptions`]. Output: a [`ScanScene`] with one scan; the truth is the whole vessel. The far
//! side follows from the symmetry alone. The middle of the bottom is not observed at any angle about the
//! axis, so symmetry does not determine it either.

use super::form::{BallBump, BallForm, ClosedForm};
use super::scans::{
    ScanScene, ScanSceneOptions, ScanSceneSummary, field_of_view, grid_for, looking_from, seed_of,
    write_simulated,
};
use super::truth::Truth;
use super::virtual_sensor::{Optics, VirtualScanner};
use planish_core::{DVec3, Progress};
use planish_estimate::{Error, Result};
use planish_exchange::{ScanSet, Unit};
use planish_sense::SensorKind;
use planish_spline::Shape;
use std::path::Path;

/// Semi-axes of the ellipsoid from which the vessel is formed, relative to the size.
const SEMI_AXES: DVec3 = DVec3::new(0.34, 0.34, 0.42);
/// Bump that forms the neck at the top: sharpness and amplitude.
const NECK: [f64; 2] = [9.0, 0.34];
/// Dent that forms the foot at the bottom: sharpness and amplitude.
const FOOT: [f64; 2] = [5.0, -0.22];
/// Direction from the object to the laser.
const FROM: DVec3 = DVec3::new(0.9, 0.35, 0.25);

/// Settings of the scene `vessel`.
#[derive(Debug, Clone, PartialEq)]
pub struct VesselOptions {
    /// Seed of every error.
    pub seed: u64,
    /// Number of readings; the result differs by a few per cent.
    pub readings: usize,
    /// True σ of the laser along its rays, in `unit`; across them it is half as large. Default: a thousandth
    /// of the height of the vessel.
    pub sigma: Option<f64>,
    /// Unit of every length.
    pub unit: Unit,
}

impl Default for VesselOptions {
    fn default() -> Self {
        Self { seed: 0, readings: 30_000, sigma: None, unit: Unit::Millimetre }
    }
}

impl VesselOptions {
    fn as_scans(&self) -> ScanSceneOptions {
        ScanSceneOptions {
            shape: Shape::Ball,
            seed: self.seed,
            readings: self.readings,
            sigma: self.sigma,
            // A second view would show the far side, which only the symmetry should determine.
            views: 1,
            old_scanner: false,
            probe_points: 0,
            outlier_share: 0.0,
            unit: self.unit,
            ..ScanSceneOptions::default()
        }
    }
}

/// Simulates the scene in memory.
///
/// # Errors
/// `Input` for options out of range.
///
/// # Examples
/// ```
/// use planish_simulate::{VesselOptions, vessel};
/// # fn main() -> planish_estimate::Result<()> {
/// let scene = vessel(&VesselOptions { readings: 500, ..VesselOptions::default() })?;
/// assert_eq!(scene.set.scans.len(), 1);
/// // The laser is at x > 0 and does not see the far side.
/// let far = scene.truth.point(0.5, 0.5);
/// assert!(far[0] < 0.0 && scene.readings[0].iter().all(|r| r.point.position[0] > 0.9 * far[0]));
/// # Ok(())
/// # }
/// ```
pub fn vessel(options: &VesselOptions) -> Result<ScanScene> {
    let options = options.as_scans();
    options.sanity_check()?;
    let size = options.size();
    let bump = |z: f64, [sharpness, amplitude]: [f64; 2]| BallBump {
        direction: DVec3::new(0.0, 0.0, z),
        sharpness,
        amplitude,
    };
    // Bumps lie on the axis of an ellipsoid with equal semi-axes, so the vessel is exactly a surface of
    // revolution.
    let truth = Truth::from_closed_form(ClosedForm::Ball(BallForm {
        semi_axes: SEMI_AXES * size,
        bumps: vec![bump(1.0, NECK), bump(-1.0, FOOT)],
    }));
    // The laser of the scene `scans`, so that σ has one default for all scenes of scans.
    let noise = options.laser();
    let from = FROM.try_normalize().ok_or_else(|| Error::input("the direction of view is undefined"))?;
    let pose = looking_from(&truth, from, 0.0, size)?;
    let optics: Optics = field_of_view(&truth, &pose, false);
    let mut scanner = VirtualScanner::new("laser-1.ply", pose, optics, [64, 64], noise);
    scanner.grid = grid_for(&scanner, &truth, options.readings)?;
    let scan = scanner.scan(&truth, seed_of(options.seed, 0))?;
    let mut scene = ScanScene {
        set: ScanSet { unit: Some(options.unit), ..ScanSet::default() },
        options,
        truth,
        sensors: Vec::new(),
        readings: Vec::new(),
        motion: None,
        states: Vec::new(),
    };
    scene.add_sensor("laser", SensorKind::Range, noise, 1.0, 0.0);
    scene.add_scan(scan);
    Ok(scene)
}

/// Simulates the scene and writes its files, as `planish simulate scene vessel` does.
///
/// # Errors
/// As [`vessel`] and [`super::write_scan_scene`]; `Interrupted` on request, before anything is written.
pub fn write_vessel_scene(
    options: &VesselOptions,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<ScanSceneSummary> {
    options.as_scans().sanity_check()?;
    write_simulated(folder, progress, |progress| {
        progress.check("scanning", 0.0)?;
        vessel(options)
    })
}
