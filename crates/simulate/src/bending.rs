//! The scene `bending`: a flat sheet that is bent further and further, without stretch, and scanned in every
//! state.
//!
//! Input: [`BendingOptions`]. Output: a [`ScanScene`] with one scan a second, and the truth behind each
//! in `states`; `truth` is the sheet at the last. The last scan has a hole, whose material the others saw.
//! The truth keeps `E, F, G` exactly, unless a stretch is asked for: then a bulge grows with the bend, and no
//! isometry leads from one state to the next.

use super::form::{BentForm, ClosedForm, SheetBump};
use super::scans::{
    ScanScene, ScanSceneOptions, ScanSceneSummary, field_of_view, grid_for, looking_from, seed_of,
    write_simulated,
};
use super::truth::Truth;
use super::virtual_sensor::{VirtualScan, VirtualScanner};
use planish_core::{Progress, Silent};
use planish_estimate::vector3::unit;
use planish_estimate::{Error, Result};
use planish_exchange::{ScanSet, Unit};
use planish_sense::SensorKind;
use planish_spline::Shape;
use std::path::Path;

/// Sides of the sheet, over its length.
const SIDES: [f64; 2] = [1.0, 0.7];
/// Curvature at the last time, times the length: the ends then stand at about 50°.
const CURVATURE: f64 = 2.4;
/// Where the bend lies: across the sheet at this angle, which turns a little from state to state, and beside
/// its middle.
const ANGLE_DEG: [f64; 2] = [25.0, 5.0];
const OFFSET: f64 = 0.06;
/// The hole of the last scan, a disc of the material: its middle and radius, over the length.
const HOLE: [f64; 2] = [0.2, -0.06];
const HOLE_RADIUS: f64 = 0.11;
/// The bulge of a sheet that stretches: its middle and width, over the length.
const BULGE: [f64; 2] = [-0.15, 0.08];
const BULGE_WIDTH: f64 = 0.12;
/// Where the laser looks from.
const FROM: [f64; 3] = [0.25, -0.15, 1.0];

/// Settings of the scene `bending`.
#[derive(Debug, Clone, PartialEq)]
pub struct BendingOptions {
    /// Seed of every error.
    pub seed: u64,
    /// Readings of all scans together, to within a few per cent.
    pub readings: usize,
    /// States, one a second; the first is flat.
    pub states: usize,
    /// The largest share by which a length along the sheet grows, at the last time; 0 for a sheet that bends
    /// only.
    pub stretch: f64,
    /// True σ of the laser along its rays, in `unit`; half of it holds across. A thousandth of the sheet's
    /// length if none is given.
    pub sigma: Option<f64>,
    /// Unit of every length.
    pub unit: Unit,
}

impl Default for BendingOptions {
    fn default() -> Self {
        Self { seed: 0, readings: 40_000, states: 4, stretch: 0.0, sigma: None, unit: Unit::Millimetre }
    }
}

impl BendingOptions {
    fn as_scans(&self) -> Result<ScanSceneOptions> {
        if self.states < 2 {
            return Err(Error::input(format!(
                "needed at least two states of a sheet that bends, found {}",
                self.states
            )));
        }
        if !(0.0..=0.2).contains(&self.stretch) {
            return Err(Error::input(format!(
                "needed a stretch from 0 to 0.2, a share of the length, found {}",
                self.stretch
            )));
        }
        let options = ScanSceneOptions {
            shape: Shape::Sheet,
            seed: self.seed,
            readings: self.readings,
            sigma: self.sigma,
            views: self.states,
            old_scanner: false,
            probe_points: 0,
            outlier_share: 0.0,
            unit: self.unit,
            organised: false,
            ..ScanSceneOptions::default()
        };
        options.sanity_check()?;
        Ok(options)
    }

    /// The sheet, a share of the whole time on.
    fn state(&self, size: f64, share: f64) -> Truth {
        // A bump of height h and width w lengthens its steepest line by (h/w)²/2e.
        let steep = (2.0 * std::f64::consts::E * share * self.stretch).sqrt();
        let bulge = SheetBump {
            centre: BULGE.map(|c| c * size),
            width: BULGE_WIDTH * size,
            height: BULGE_WIDTH * size * steep,
        };
        Truth::from_closed_form(ClosedForm::Bent(BentForm {
            sides: SIDES.map(|side| side * size),
            curvature: share * CURVATURE / size,
            angle_rad: (ANGLE_DEG[0] + share * ANGLE_DEG[1]).to_radians(),
            offset: OFFSET * size,
            bulge: (steep > 0.0).then_some(bulge),
        }))
    }
}

/// Simulates the scene in memory.
///
/// # Errors
/// `Input` for options that make no sense.
pub fn bending(options: &BendingOptions) -> Result<ScanScene> {
    simulate(options, &Silent)
}

fn simulate(bending: &BendingOptions, progress: &dyn Progress) -> Result<ScanScene> {
    let options = bending.as_scans()?;
    let size = options.size();
    let noise = options.laser();
    let from = unit(FROM).ok_or_else(|| Error::input("a view without a direction"))?;
    let last = bending.states - 1;
    let states: Vec<Truth> = (0..=last).map(|k| bending.state(size, k as f64 / last as f64)).collect();
    let mut scene = ScanScene {
        set: ScanSet { unit: Some(options.unit), ..ScanSet::default() },
        options,
        truth: states[last].clone(),
        sensors: Vec::new(),
        readings: Vec::new(),
        motion: None,
        states,
    };
    scene.add_sensor("laser", SensorKind::Range, noise, 1.0, 0.0);
    let each = bending.readings.div_ceil(bending.states);
    for k in 0..=last {
        progress.check("scanning", k as f64 / bending.states as f64)?;
        progress.items(k * each, "readings");
        let truth = &scene.states[k];
        let pose = looking_from(truth, from, 0.0, size)?;
        let name = format!("laser-{}.ply", k + 1);
        let mut scanner = VirtualScanner {
            organised: false,
            ..VirtualScanner::new(&name, pose, field_of_view(truth, &pose, false), [64, 64], noise)
        };
        scanner.grid = grid_for(&scanner, truth, each)?;
        let mut scan = scanner.scan(truth, seed_of(bending.seed, k))?;
        if k == last {
            scan = with_hole(scan);
        }
        scan.scan.time_s = Some(k as f64);
        scene.add_scan(scan);
    }
    Ok(scene)
}

/// Whether parameters of the sheet lie in the hole of the last scan, made wider by a share of the sheet's
/// length.
#[must_use]
pub fn in_bending_hole([u, v]: [f64; 2], wider: f64) -> bool {
    let off = [(u - 0.5) * SIDES[0] - HOLE[0], (v - 0.5) * SIDES[1] - HOLE[1]];
    off[0].hypot(off[1]) < HOLE_RADIUS + wider
}

/// The scan without what it saw of the hole. It keeps no grid.
fn with_hole(scan: VirtualScan) -> VirtualScan {
    let VirtualScan { mut scan, truth } = scan;
    let seen: Vec<bool> =
        (truth.iter()).map(|reading| !in_bending_hole(reading.point.parameters, 0.0)).collect();
    let mut kept = seen.iter();
    scan.points.retain(|_| kept.next().is_some_and(|&kept| kept));
    let mut kept = seen.iter();
    let mut truth = truth;
    truth.retain(|_| kept.next().is_some_and(|&kept| kept));
    VirtualScan { scan, truth }
}

/// Simulates the scene and writes it: what `planish simulate scene bending` does.
///
/// # Errors
/// As [`bending`] and [`super::write_scan_scene`]; `Interrupted` on request, before anything is written.
pub fn write_bending_scene(
    options: &BendingOptions,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<ScanSceneSummary> {
    options.as_scans()?;
    write_simulated(folder, progress, |progress| simulate(options, progress))
}
