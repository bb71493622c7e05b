//! From scans to observations: checks of points, duplicates, and held-out readings.

use super::columns::{IntakeFigures, ReadingRow, ScanColumns, ScanNoise};
use super::directions::Directions;
use super::{ObservationOptions, Observations, moved_viewing};
use crate::observe::hashing::{BitsHasher, hash01};
use crate::observe::{Channel, Quantity, RejectionCause};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_sense::{Noise, PointFlag, Scan, ScanGeometry, Sensor, SensorKind, Viewing, scan_geometry};
use rayon::prelude::*;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hash::BuildHasherDefault;

/// ASPRS classes of noise: low and high.
const NOISE_CLASSES: [u8; 2] = [7, 18];
/// ASPRS classes of bare earth: ground, and key points of it.
const GROUND_CLASSES: [u8; 2] = [2, 8];

/// Scans with fewer readings have none held out: four touches that anchor a surface cannot judge it, and the
/// fit would miss them.
const MIN_JUDGED: usize = 30;

/// Minimum number of points of a fit. A quadric has nine coefficients; one more point leaves a residual.
pub(super) const MIN_POINTS: usize = 10;

/// Scans on their way to observations.
struct Intake<'a> {
    scans: &'a [&'a Scan],
    sensor_of_scan: &'a [usize],
    sensors: &'a [Sensor],
    options: &'a ObservationOptions,
    /// True if the index of each point in its scan is needed later.
    keep_source: bool,
    /// The points of each sensor so far.
    seen: Vec<SeenPoints>,
}

/// What the points of one scan are checked with.
struct PointChecks<'a> {
    /// Normals and suspicions of the scan.
    geometry: Option<&'a ScanGeometry>,
    /// The earlier scan whose grid this scan repeats.
    copied_grid: Option<usize>,
    /// Keep only ground points of a classified scan.
    ground_only: bool,
}

impl Observations {
    /// Transforms every scan to the world frame, estimates missing normals, and rejects points that fail the
    /// checks of their scans.
    ///
    /// # Errors
    /// `Undetermined` if fewer than ten usable points are left; `Input` if columns that a sensor needs are
    /// missing.
    pub fn new(
        scans: &[&Scan],
        sensor_of_scan: &[usize],
        sensors: &[Sensor],
        options: &ObservationOptions,
    ) -> Result<Self> {
        let total: usize = scans.iter().map(|s| s.points.len() + s.dropped_not_finite).sum();
        let mut made = Self {
            scans: ScanColumns { channel: sensor_of_scan.to_vec(), ..ScanColumns::default() },
            channels: (sensors.iter().enumerate())
                .map(|(number, sensor)| Channel {
                    correlated_errors: sensor.kind == SensorKind::Stereo,
                    ..Channel::new(number, Quantity::Position)
                })
                .collect(),
            intake: IntakeFigures { total, ..IntakeFigures::default() },
            ..Self::default()
        };
        let found: usize = scans.iter().map(|s| s.points.len()).sum();
        if found < MIN_POINTS {
            return Err(Error::undetermined(format!(
                "expected at least {MIN_POINTS} points that are not on one line, found {found} in all"
            )));
        }
        let not_finite: usize = scans.iter().map(|s| s.dropped_not_finite).sum();
        if not_finite > 0 {
            made.intake.rejected.insert(RejectionCause::NotFinite, not_finite);
        }
        // Normals and suspicions by scan, in parallel.
        let geometries = geometries(scans, options)?;
        let wanted = |s: usize| Directions::requested(scans[s], &sensors[sensor_of_scan[s]]).any();
        let mut intake = Intake {
            scans,
            sensor_of_scan,
            sensors,
            options,
            keep_source: (0..scans.len()).any(wanted),
            // By sensor, because two sensors may measure the same place (decision 0030).
            seen: vec![SeenPoints::default(); sensors.len()],
        };
        for (s, geometry) in geometries.iter().enumerate() {
            made.add_positions(&mut intake, s, geometry.as_ref());
        }
        made.refuse_too_few()?;
        // The ground comes first: normals and roughness from neighbours are then those of the ground alone.
        if let Some(ground) = &options.ground {
            made.keep_ground(scans, ground)?;
        }
        if !options.unprocessed {
            made.find_surface(scans, sensors)?;
            let touched = |sensor: usize| sensors[sensor].kind == SensorKind::Touch;
            made.complete_normals(options.checks.neighbours, !options.sheet, touched)?;
            if options.sheet {
                made.turn_upwards();
            }
            made.measure_roughness(scans, sensors.len(), options.checks.neighbours);
        }
        // Directions come last: they copy the place, side and held-out mark of the positions.
        made.add_directions(scans, sensor_of_scan, sensors)?;
        Ok(made)
    }

    /// Adds the accepted points of one scan, and the source of their covariances.
    fn add_positions(&mut self, intake: &mut Intake<'_>, s: usize, geometry: Option<&ScanGeometry>) {
        let (scan, options) = (intake.scans[s], intake.options);
        let sensor = &intake.sensors[intake.sensor_of_scan[s]];
        let mut kept = 0_u32;
        let (mut sigmas, mut covariances) = (Vec::new(), Vec::new());
        let checks = PointChecks {
            geometry,
            copied_grid: copied_grid(intake.scans, intake.sensor_of_scan, s),
            ground_only: options.sheet && has_ground(scan),
        };
        for i in 0..scan.points.len() {
            let world = scan.world_from_scanner.apply(scan.points[i]);
            if let Some(cause) = self.point_rejection(intake, (s, i), world, &checks) {
                *self.intake.rejected.entry(cause).or_insert(0) += 1;
                continue;
            }
            let stated = || scan.normals.as_ref().filter(|_| options.unprocessed).map(|all| all[i]);
            let normal = geometry.map(|g| g.normals[i]).or_else(stated).unwrap_or(DVec3::ZERO);
            if intake.keep_source {
                self.readings.source.push(i as u32);
            }
            // A normal of zero in a file means that it is not known.
            let known = scan.grid.is_some() || normal.length_squared() > 0.0;
            let may_be_held_out = scan.points.len() >= MIN_JUDGED;
            self.readings.push(ReadingRow {
                point: world,
                normal: scan.world_from_scanner.rotate(normal).as_vec3(),
                scan: s as u32,
                // By a hash of the point number, so that the choice depends on no other point.
                held_out: may_be_held_out
                    && hash01(options.seed, s as u64, i as u64) < options.held_out_share,
                index: kept,
                oriented: known && geometry.is_some_and(|g| g.oriented),
                on_surface: true,
            });
            if let Some(all) = &scan.covariance {
                covariances.push(all[i].rotated(&scan.world_from_scanner.rotation));
            } else if let Some(all) = &scan.sigma {
                sigmas.push(all[i]);
            }
            kept += 1;
        }
        let viewing = moved_viewing(scan.viewing, &scan.world_from_scanner);
        self.scans.noise.push(if scan.covariance.is_some() {
            ScanNoise::Covariance(covariances)
        } else if scan.sigma.is_some() {
            ScanNoise::Sigma(sigmas)
        } else if let Some(noise) = sensor.noise {
            ScanNoise::Model { noise, viewing }
        } else {
            // A channel has one scale, so a single scan without σ makes all of its σ unstated.
            self.channels[intake.sensor_of_scan[s]].stated = false;
            // One unit of length stands for the unknown σ until it is estimated.
            ScanNoise::Model { noise: Noise::Isotropic { sigma: 1.0 }, viewing: Viewing::Unknown }
        });
    }

    /// Why point `i` of scan `s` is rejected; none if it is accepted. Scans that repeat each other are noted.
    fn point_rejection(
        &mut self,
        intake: &mut Intake<'_>,
        (s, i): (usize, usize),
        world: DVec3,
        checks: &PointChecks<'_>,
    ) -> Option<RejectionCause> {
        let scan = intake.scans[s];
        // Classes come first, so that a point of an unwanted class is not remembered as the original of
        // another.
        if let Some(class) = scan.classes.as_ref().map(|classes| classes[i])
            && (NOISE_CLASSES.contains(&class) || checks.ground_only && !GROUND_CLASSES.contains(&class))
        {
            return Some(RejectionCause::Class);
        }
        let sensor = intake.sensor_of_scan[s];
        let repeated = match (&scan.grid, checks.copied_grid) {
            (Some(_), copied) => copied,
            (None, _) => intake.seen[sensor].scan_with(intake.scans, &intake.sensors[sensor], (s, i), world),
        };
        if let Some(earlier) = repeated {
            if earlier != s {
                self.intake.copies.insert((earlier as u32, s as u32));
            }
            return Some(RejectionCause::Duplicate);
        }
        match checks.geometry.map_or(PointFlag::None, |g| g.flags[i]) {
            PointFlag::None => None,
            PointFlag::Isolated => Some(RejectionCause::Isolated),
            PointFlag::DepthEdge => Some(RejectionCause::DepthEdge),
            PointFlag::Grazing => Some(RejectionCause::Grazing),
        }
    }

    fn refuse_too_few(&self) -> Result<()> {
        let (left, total) = (self.readings.points.len(), self.intake.total);
        if left >= MIN_POINTS {
            return Ok(());
        }
        let repeated = self.intake.rejected.get(&RejectionCause::Duplicate).copied().unwrap_or(0);
        Err(Error::undetermined(if repeated > 0 {
            format!(
                "expected at least {MIN_POINTS} readings, found {left}: {repeated} of {total} readings \
                 repeat the coordinates of another"
            )
        } else {
            format!(
                "expected at least {MIN_POINTS} readings, found {left}: the checks of each scan rejected \
                 the others of {total}"
            )
        }))
    }
}

/// Normals and suspicions of each scan; none for small clouds without a viewpoint, whose normals come from
/// the union of all scans, and for unprocessed readings.
fn geometries(scans: &[&Scan], options: &ObservationOptions) -> Result<Vec<Option<ScanGeometry>>> {
    scans
        .par_iter()
        .map(|scan| {
            if options.unprocessed
                || scan.points.len() < 3
                || (scan.grid.is_none() && scan.normals.is_none() && scan.viewing == Viewing::Unknown)
            {
                Ok(None)
            } else {
                scan_geometry(scan, &options.checks).map(Some)
            }
        })
        .collect()
}

/// The points of all scans of one sensor so far. Noise of independent readings does not repeat to the last
/// digit, so equal points are one reading written twice.
#[derive(Debug, Clone, Default)]
struct SeenPoints(HashMap<[u64; 3], (u32, u32), BuildHasherDefault<BitsHasher>>);

impl SeenPoints {
    /// The scan that holds the same reading, this one or an earlier one. A new reading is remembered.
    ///
    /// The points of a sensor without positions are pixels, which its scans share. Readings are then equal
    /// only if their normals are equal, too.
    fn scan_with(
        &mut self,
        scans: &[&Scan],
        sensor: &Sensor,
        (s, i): (usize, usize),
        world: DVec3,
    ) -> Option<usize> {
        match self.0.entry(world.to_array().map(f64::to_bits)) {
            Entry::Vacant(new) => {
                new.insert((s as u32, i as u32));
                None
            }
            Entry::Occupied(known) => {
                let (earlier, k) = *known.get();
                let normal = |scan: usize, point: usize| scans[scan].normals.as_ref().map(|all| all[point]);
                let same = earlier as usize == s
                    || sensor.kind.measures_positions()
                    || normal(earlier as usize, k as usize) == normal(s, i);
                same.then_some(earlier as usize)
            }
        }
    }
}

/// The earlier scan of the same sensor and pose that a gridded scan repeats as a whole. Single cells may
/// agree by chance, since depths of images are integers.
fn copied_grid(scans: &[&Scan], sensor_of_scan: &[usize], s: usize) -> Option<usize> {
    let scan = scans[s];
    scan.grid.as_ref()?;
    (0..s).find(|&k| {
        let other = scans[k];
        sensor_of_scan[k] == sensor_of_scan[s]
            && !scan.points.is_empty()
            && other.grid == scan.grid
            && other.world_from_scanner == scan.world_from_scanner
            && other.points == scan.points
            && other.normals == scan.normals
    })
}

/// True if a scan's classes mark ground points.
pub(crate) fn has_ground(scan: &Scan) -> bool {
    (scan.classes.iter().flatten()).any(|class| GROUND_CLASSES.contains(class))
}
