//! The scene `bending`: a flat sheet that bends in steps, without stretch, and is scanned in every state.
//!
//! Input: [`BendingOptions`]. Output: a [`ScanScene`] with one scan per second. `states` holds the true sheet
//! of each scan, `truth` that of the last. The last scan has a hole over material that the earlier scans
//! observed, so that completing it can be judged.
//!
//! The true sheets have exactly the same first fundamental form `E, F, G`. If the options contain a stretch,
//! a bulge grows with the bend, and no isometry leads from one state to the next.

use super::form::{BentForm, ClosedForm, SheetBump};
use super::scans::{
    ScanScene, ScanSceneOptions, ScanSceneSummary, field_of_view, grid_for, looking_from, seed_of,
    write_simulated,
};
use super::truth::Truth;
use super::virtual_sensor::{VirtualScan, VirtualScanner};
use planish_core::{DVec3, Progress, Silent};
use planish_estimate::{Error, Result};
use planish_exchange::{ScanSet, Unit};
use planish_sense::SensorKind;
use planish_spline::Shape;
use std::path::Path;

/// Sides of the sheet, relative to its length.
const SIDES: [f64; 2] = [1.0, 0.7];
/// Final curvature times the length of the sheet: its ends are then inclined by about 50°.
const CURVATURE: f64 = 2.4;
/// Direction of the bend at the first state, and its rotation until the last, in degrees.
///
/// Along a parameter direction the bend would be a special case: one family of parameter lines stays
/// straight.
const ANGLE_DEG: [f64; 2] = [25.0, 5.0];
/// Distance of the bend from the middle of the sheet, relative to the length.
const OFFSET: f64 = 0.06;
/// Centre of the hole of the last scan, a disc of the material, relative to the length.
const HOLE: [f64; 2] = [0.2, -0.06];
/// Radius of the hole, relative to the length.
const HOLE_RADIUS: f64 = 0.11;
/// Centre of the bulge of a sheet that stretches, relative to the length.
const BULGE: [f64; 2] = [-0.15, 0.08];
/// Standard width of the bulge, relative to the length.
const BULGE_WIDTH: f64 = 0.12;
/// Direction from the sheet to the laser.
const FROM: DVec3 = DVec3::new(0.25, -0.15, 1.0);

/// Settings of the scene `bending`.
#[derive(Debug, Clone, PartialEq)]
pub struct BendingOptions {
    /// Seed of every error.
    pub seed: u64,
    /// Number of readings of all scans together; the result differs by a few per cent.
    pub readings: usize,
    /// Number of states, one per second; the first is flat.
    pub states: usize,
    /// Maximum relative elongation along the sheet at the last state, from 0 (pure bending) to 0.2.
    pub stretch: f64,
    /// True σ of the laser along its rays, in `unit`; across them it is half as large. Default: a thousandth
    /// of the length of the sheet.
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
                "expected at least two states of a sheet that bends, found {}",
                self.states
            )));
        }
        if !(0.0..=0.2).contains(&self.stretch) {
            return Err(Error::input(format!(
                "expected a stretch from 0 to 0.2, a share of the length, found {}",
                self.stretch
            )));
        }
        let options = ScanSceneOptions {
            shape: Shape::Sheet,
            seed: self.seed,
            readings: self.readings,
            sigma: self.sigma,
            views: self.states,
            // One sensor and no outliers, so that only the bend and the hole are difficult.
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

    /// The sheet after a share of the whole time, from 0 (flat) to 1.
    fn state(&self, size: f64, share: f64) -> Truth {
        // A bump of height h and width w lengthens its steepest line by (h/w)²/2e: its maximum slope is
        // h/(w√e), and a slope p stretches by p²/2.
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
/// `Input` for options out of range.
///
/// # Examples
/// ```
/// use planish_simulate::{BendingOptions, bending};
/// # fn main() -> planish_estimate::Result<()> {
/// let scene = bending(&BendingOptions { readings: 1000, states: 3, ..BendingOptions::default() })?;
/// assert_eq!(scene.set.scans.len(), 3);
/// // Bending preserves lengths: S_u · S_u is the same in every state.
/// let e = |state: usize| scene.states[state].jet(0.3, 0.6).first_form()[0];
/// assert!((e(2) / e(0) - 1.0).abs() < 1e-9);
/// # Ok(())
/// # }
/// ```
pub fn bending(options: &BendingOptions) -> Result<ScanScene> {
    simulate(options, &Silent)
}

fn simulate(bending: &BendingOptions, progress: &dyn Progress) -> Result<ScanScene> {
    let options = bending.as_scans()?;
    let size = options.size();
    let noise = options.laser();
    let from = FROM.try_normalize().ok_or_else(|| Error::input("the direction of view is undefined"))?;
    // At least two states are checked before, so this neither wraps nor divides by zero below.
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
            // A scan with a grid would refer to readings that the hole removes.
            organised: false,
            ..VirtualScanner::new(&name, pose, field_of_view(truth, &pose, false), [64, 64], noise)
        };
        // A grid for each state, so that all scans have about the same number of readings however bent
        // the sheet is.
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

/// True if a point of the sheet lies in the hole of the last scan, at parameters `(u, v)` in `[0, 1]²`.
///
/// `wider` is added to the radius of the hole, relative to the length of the sheet: readings near the rim of
/// the hole can be told from those inside.
///
/// # Examples
/// ```
/// use planish_simulate::in_bending_hole;
/// assert!(in_bending_hole([0.7, 0.41], 0.0));
/// assert!(!in_bending_hole([0.5, 0.5], 0.0) && in_bending_hole([0.5, 0.5], 0.1));
/// ```
#[must_use]
pub fn in_bending_hole([u, v]: [f64; 2], wider: f64) -> bool {
    let off = [(u - 0.5) * SIDES[0] - HOLE[0], (v - 0.5) * SIDES[1] - HOLE[1]];
    off[0].hypot(off[1]) < HOLE_RADIUS + wider
}

/// The scan without its readings in the hole. Requires a scan without a grid, whose indices would be wrong.
fn with_hole(scan: VirtualScan) -> VirtualScan {
    let VirtualScan { mut scan, truth } = scan;
    let seen: Vec<bool> =
        (truth.iter()).map(|r| r.point.parameters.is_none_or(|at| !in_bending_hole(at, 0.0))).collect();
    // `retain` visits the elements in order, so an iterator over the flags keeps step.
    let mut kept = seen.iter();
    scan.points.retain(|_| kept.next().is_some_and(|&kept| kept));
    let mut kept = seen.iter();
    let mut truth = truth;
    truth.retain(|_| kept.next().is_some_and(|&kept| kept));
    VirtualScan { scan, truth }
}

/// Simulates the scene and writes its files, as `planish simulate scene bending` does.
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
