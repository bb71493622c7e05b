//! The readings of a fit: positions, covariances, normals and channels.
//!
//! Input: scans with their sensors. Output: [`Observations`], with each accepted reading once.
//!
//! | module | purpose |
//! |---|---|
//! | columns | what readings, scans and the intake consist of |
//! | intake | from scans to observations: checks, duplicates, held-out readings |
//! | consensus | readings that lie on a surface with their neighbours; checks of stated normals |
//! | normals | missing normals, orientation, ground |
//! | directions | normals and curvatures as readings of their own |

mod columns;
mod consensus;
mod directions;
mod intake;
mod normals;

pub use columns::{IntakeFigures, ReadingColumns, ScanColumns};
pub(crate) use intake::has_ground;
use planish_core::{DVec3, Finding, FindingCode};

use super::quantity::{Channel, Measured, Quantity};
use super::rejection::RejectionCause;
use super::scan_errors::ScanErrors;
use columns::{ReadingRow, ScanNoise};
use planish_core::SymmetricMatrix3;
use planish_exchange::ScanSet;
use planish_mesh::BoundingBox;
use planish_sense::{GroundOptions, Noise, Pose, ScanChecks, Viewing, ray_at};
use rayon::prelude::*;

/// Duplicate pairs of scans that are listed one by one in findings.
const MAX_LISTED_DUPLICATES: usize = 5;

/// Points farther from the origin than this many times their size are moved there for the fit.
///
/// Below it, products of coordinates lose at most two digits. See decision 0010.
const FAR_FROM_ORIGIN: f64 = 8.0;

/// Variance of an inferred reading along its normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InferredVariance {
    /// Variance of its own, independent error.
    pub own: f64,
    /// Variance of the error that it shares with the readings around it, since they were inferred together.
    pub shared: f64,
}

/// A reading inferred from others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InferredReading {
    /// Expected point of the surface.
    pub point: DVec3,
    /// Expected unit normal there.
    pub normal: DVec3,
    /// Variance of the point along the normal.
    pub variance: InferredVariance,
}

/// The readings of a fit, in world coordinates, with what is known about their noise.
///
/// A reading belongs to a scan, and a scan to a channel: the readings of one quantity by one sensor.
#[derive(Debug, Clone, Default)]
pub struct Observations {
    /// The readings.
    pub readings: ReadingColumns,
    /// The scans that the readings belong to.
    pub scans: ScanColumns,
    /// The channels: the positions of every sensor in their order, then normals and curvatures.
    pub channels: Vec<Channel>,
    /// Variance of rounding: no estimate is smaller.
    pub min_variance: f64,
    /// Variance of rounding, if all coordinates are multiples of a step: `step² / 12`. An estimated σ is no
    /// smaller.
    pub rounding_variance: f64,
    /// What the intake found.
    pub intake: IntakeFigures,
    /// Poses and biases that all readings of a scan share.
    pub(crate) scan_errors: ScanErrors,
}

/// Settings of the intake of scans.
#[derive(Debug, Clone, Copy)]
pub struct ObservationOptions {
    /// Share of the points that are held out.
    pub held_out_share: f64,
    /// Seed of that choice.
    pub seed: u64,
    /// Checks of each scan.
    pub checks: ScanChecks,
    /// Fit a sheet: keep only ground points of classified scans, and orient normals upwards if their side is
    /// unknown.
    pub sheet: bool,
    /// Use readings without processing: no estimated normals, and no checks against neighbours.
    pub unprocessed: bool,
    /// Settings that separate the ground from objects, if only the ground is fitted. Scans with ground
    /// classes are not affected.
    pub ground: Option<GroundOptions>,
}

impl Observations {
    /// Adds readings inferred from others. They form a channel of their own and are not counted in `total`.
    pub fn add_inferred(&mut self, readings: &[InferredReading]) {
        if readings.is_empty() {
            return;
        }
        let channel = self.channels.iter().position(|c| c.inferred).unwrap_or_else(|| {
            // No sensor has this index: inferred readings have none, and reports of sensors omit the channel.
            self.channels.push(Channel { inferred: true, ..Channel::new(usize::MAX, Quantity::Position) });
            self.channels.len() - 1
        });
        // A scan of its own, which belongs to no measured one.
        let scan = self.scans.channel.len() as u32;
        self.scans.channel.push(channel);
        self.scans.base.push(scan);
        self.scan_errors.add_fixed_scan();
        self.scans.noise.push(ScanNoise::Inferred(readings.iter().map(|r| r.variance).collect()));
        for (index, reading) in (0..).zip(readings) {
            self.readings.push(ReadingRow {
                point: reading.point,
                normal: reading.normal.as_vec3(),
                scan,
                // Inferred readings follow from the others, so they cannot judge the fit.
                held_out: false,
                index,
                oriented: true,
                on_surface: true,
            });
        }
    }

    /// The variance of an inferred reading; none for a real one.
    #[inline]
    #[must_use]
    pub fn inferred(&self, i: usize) -> Option<InferredVariance> {
        match &self.scans.noise[self.readings.scan[i] as usize] {
            ScanNoise::Inferred(all) => Some(all[self.readings.index[i] as usize]),
            _ => None,
        }
    }

    /// Findings about scans that repeat each other.
    pub(crate) fn duplicate_scan_findings(&self, set: &ScanSet) -> Vec<Finding> {
        let name = |scan: u32| set.scans.get(scan as usize).map_or("", |posed| posed.scan.name.as_str());
        let listed = self.intake.copies.iter().take(MAX_LISTED_DUPLICATES).map(|&(first, second)| {
            format!(
                "{}: readings repeat those of {} to the last digit, so they count once (`duplicate` in the \
                 rejected readings)",
                name(second),
                name(first)
            )
        });
        let more = self.intake.copies.len().saturating_sub(MAX_LISTED_DUPLICATES);
        listed
            .chain((more > 0).then(|| {
                format!("{more} more pairs of scans have readings that are equal to the last digit")
            }))
            .map(|text| Finding::new(FindingCode::DuplicateReadings, text))
            .collect()
    }

    /// The scan of the set to which a scan here belongs.
    pub(crate) fn base_scan(&self, scan: usize) -> usize {
        // Scans of directions and of inferred readings follow those of the set, and only they have a base.
        let scans = self.scans.channel.len() - self.scans.base.len();
        if scan < scans { scan } else { self.scans.base[scan - scans] as usize }
    }

    /// The viewing geometry of a scan's sensor, if its noise depends on it.
    pub(crate) fn viewing(&self, scan: usize) -> Viewing {
        match &self.scans.noise[scan] {
            ScanNoise::Model { viewing, .. } => *viewing,
            _ => Viewing::Unknown,
        }
    }

    /// Changes poses and biases of scans by a step, and moves the scans.
    pub(crate) fn apply_scan_error_step(&mut self, step: &[f64]) {
        let motions = self.scan_errors.take(step);
        self.move_scans(&motions);
    }

    /// Moves whole scans: their points, normals, covariances and viewing geometry.
    pub(crate) fn move_scans(&mut self, motions: &[Option<Pose>]) {
        // Most fits have no unknown poses: every iteration of theirs would visit all readings for nothing.
        if motions.iter().all(Option::is_none) {
            return;
        }
        (self.readings.points.par_iter_mut().zip(&mut self.readings.normals).zip(&self.readings.scan))
            .with_min_len(4096)
            .for_each(|((point, normal), &scan)| {
                if let Some(motion) = &motions[scan as usize] {
                    *point = motion.apply(*point);
                    *normal = motion.rotate(normal.as_dvec3()).as_vec3();
                }
            });
        for (noise, motion) in self.scans.noise.iter_mut().zip(motions) {
            let Some(motion) = motion else { continue };
            match noise {
                ScanNoise::Model { viewing, .. } => *viewing = moved_viewing(*viewing, motion),
                // One σ for all directions does not turn, and inferred readings are never moved.
                ScanNoise::Sigma(_) | ScanNoise::Inferred(_) => {}
                ScanNoise::Covariance(all) => all.iter_mut().for_each(|c| *c = c.rotated(&motion.rotation)),
                ScanNoise::Normals(all) => all.iter_mut().for_each(|(n, _)| *n = motion.rotate(*n)),
                ScanNoise::Curvatures(all) => {
                    all.iter_mut().for_each(|(t, _)| *t = t.rotated(&motion.rotation));
                }
            }
        }
    }

    /// The readings that are not held out, by index.
    pub(crate) fn fitted(&self) -> Vec<u32> {
        (0..self.len() as u32).filter(|&i| !self.readings.held_out[i as usize]).collect()
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.readings.len()
    }

    /// True if there is no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.readings.is_empty()
    }

    /// Channel of a reading.
    #[inline]
    #[must_use]
    pub fn channel(&self, i: usize) -> usize {
        self.scans.channel[self.readings.scan[i] as usize]
    }

    /// The quantity that a reading measures.
    #[inline]
    #[must_use]
    pub fn quantity(&self, i: usize) -> Quantity {
        self.channels[self.channel(i)].quantity
    }

    /// The value of a reading.
    #[inline]
    #[must_use]
    pub fn measured(&self, i: usize) -> Measured {
        let index = self.readings.index[i] as usize;
        match &self.scans.noise[self.readings.scan[i] as usize] {
            ScanNoise::Normals(all) => Measured::Normal(all[index].0),
            ScanNoise::Curvatures(all) => Measured::Curvature(all[index].0),
            _ => Measured::Position,
        }
    }

    /// Stated variance of each component of a reading: of a position along `normal`, of others as stated.
    #[inline]
    #[must_use]
    pub fn variance(&self, i: usize, normal: DVec3) -> f64 {
        let index = self.readings.index[i] as usize;
        match &self.scans.noise[self.readings.scan[i] as usize] {
            ScanNoise::Normals(all) => all[index].1,
            ScanNoise::Curvatures(all) => all[index].1,
            // That of one reading alone. Where many share their error, `share_errors` enlarges it (decision
            // 0017).
            ScanNoise::Inferred(all) => all[index].own + all[index].shared,
            _ => self.covariance(i).along(normal),
        }
    }

    /// The scan normal of a point; zero if unknown.
    #[inline]
    #[must_use]
    pub fn normal(&self, i: usize) -> DVec3 {
        self.readings.normal(i)
    }

    /// Stated covariance of a position, in world axes. It is zero for normals and
    /// curvatures, and for inferred readings, whose error is along their normal.
    #[inline]
    #[must_use]
    pub fn covariance(&self, i: usize) -> SymmetricMatrix3 {
        match &self.scans.noise[self.readings.scan[i] as usize] {
            ScanNoise::Model { noise, viewing } => {
                noise.covariance(ray_at(*viewing, self.readings.points[i]))
            }
            ScanNoise::Sigma(all) => {
                Noise::Isotropic { sigma: all[self.readings.index[i] as usize] }.covariance(None)
            }
            ScanNoise::Covariance(all) => all[self.readings.index[i] as usize],
            ScanNoise::Normals(_) | ScanNoise::Curvatures(_) | ScanNoise::Inferred(_) => {
                SymmetricMatrix3::ZERO
            }
        }
    }

    /// Rejects the marked points and counts them.
    pub(super) fn reject(&mut self, dropped: &[bool], cause: RejectionCause) {
        let count = dropped.iter().filter(|&&g| g).count();
        if count == 0 {
            return;
        }
        *self.intake.rejected.entry(cause).or_insert(0) += count;
        self.readings.drop_marked(dropped);
    }

    /// Moves the origin near the points if they are far from it, and returns the new origin. The move is
    /// exact to the last digit.
    ///
    /// Map coordinates have seven digits before the point. Of the sixteen digits of a number, products of
    /// them leave too few for an energy that no translation changes.
    pub fn recentre(&mut self) -> DVec3 {
        let Some(bounds) = BoundingBox::from_points(&self.readings.points) else {
            return DVec3::ZERO;
        };
        let (center, size) = (bounds.center(), bounds.diagonal());
        if center.length() <= FAR_FROM_ORIGIN * size || size <= 0.0 {
            return DVec3::ZERO;
        }
        // A multiple of a power of two of about the size: differences to it are exact.
        let step = size.log2().ceil().exp2();
        let origin = center.map(|c| (c / step).round() * step);
        self.move_origin(origin);
        origin
    }

    /// Moves the origin to a point.
    pub(crate) fn move_origin(&mut self, origin: DVec3) {
        if origin == DVec3::ZERO {
            return;
        }
        for p in &mut self.readings.points {
            *p -= origin;
        }
        for noise in &mut self.scans.noise {
            // Directions and covariances do not depend on the origin; a viewpoint does.
            if let ScanNoise::Model { viewing: Viewing::Origin(from), .. } = noise {
                *from -= origin;
            }
        }
    }

    /// Turns normals of unknown sign to the side of `normal_near` at their points.
    pub fn orient_by(&mut self, normal_near: impl Fn(DVec3) -> DVec3 + Sync) {
        self.readings
            .normals
            .par_iter_mut()
            .zip(&self.readings.points)
            .zip(&self.readings.oriented)
            .with_min_len(256)
            .filter(|(_, oriented)| !**oriented)
            .for_each(|((normal, p), _)| {
                if normal.as_dvec3().dot(normal_near(*p)) < 0.0 {
                    *normal = -*normal;
                }
            });
    }
}

/// The viewing geometry of a sensor after a motion.
pub(crate) fn moved_viewing(viewing: Viewing, motion: &Pose) -> Viewing {
    match viewing {
        Viewing::Unknown => Viewing::Unknown,
        Viewing::Direction(d) => Viewing::Direction(motion.rotate(d)),
        Viewing::Origin(o) => Viewing::Origin(motion.apply(o)),
    }
}
