//! The readings of a fit: positions, covariances, normals and channels.
//!
//! Input: scans with their sensors. Output: [`Observations`], column by column, with each accepted reading
//! once.
//!
//! | module | purpose |
//! |---|---|
//! | intake | from scans to observations: checks, duplicates, held-out readings |
//! | normals | missing normals, orientation, ground |
//! | directions | normals and curvatures as readings of their own |

mod directions;
mod intake;
mod normals;

pub(crate) use intake::has_ground;
use planish_core::{Finding, FindingCode};

use super::quantity::{Channel, Measured, Quantity, rotate_covariance};
use super::rejection::RejectionCause;
use super::scan_errors::ScanErrors;
use planish_estimate::vector3::{dot, norm, sub};
use planish_exchange::ScanSet;
use planish_mesh::BoundingBox;
use planish_sense::{GroundOptions, Noise, Pose, ScanChecks, Viewing, ray_at, variance_along};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Duplicate pairs of scans that are listed one by one in findings.
const MAX_LISTED_DUPLICATES: usize = 5;

/// Points farther from the origin than this many times their size are moved there for the fit.
///
/// Below it, products of coordinates lose at most two digits.
const FAR_FROM_ORIGIN: f64 = 8.0;

/// The source of the covariances of one scan's points.
#[derive(Debug, Clone)]
enum ScanNoise {
    /// The sensor's noise model, with rays in the world frame.
    Model { noise: Noise, viewing: Viewing },
    /// One σ for each point.
    Sigma(Vec<f64>),
    /// One covariance for each point, in the world frame.
    Covariance(Vec<[f64; 6]>),
    /// Normals, each with its variance about each axis in the tangent plane, in radians squared.
    Normals(Vec<([f64; 3], f64)>),
    /// Curvature tensors, each with the variance of its components.
    Curvatures(Vec<([f64; 6], f64)>),
    /// Readings inferred from others.
    Inferred(Vec<InferredVariance>),
}

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
    pub point: [f64; 3],
    /// Expected unit normal there.
    pub normal: [f64; 3],
    /// Variance of the point along the normal.
    pub variance: InferredVariance,
}

/// The readings of a fit, in world coordinates, one entry for each reading.
#[derive(Debug, Clone, Default)]
pub struct Observations {
    /// Positions.
    pub points: Vec<[f64; 3]>,
    /// Unit normals of the scans; zero if unknown.
    pub normals: Vec<[f32; 3]>,
    /// Index of the scan of each point.
    pub scan: Vec<u32>,
    /// Index of the point among the scan's kept points.
    index: Vec<u32>,
    /// True if the point is held out of the fit to judge it.
    pub held_out: Vec<bool>,
    /// For each scan, its channel. Normals and curvatures of a scan form further scans, after all others.
    pub channel_of_scan: Vec<usize>,
    /// The channels: the positions of every sensor in their order, then normals and curvatures.
    pub channels: Vec<Channel>,
    /// True if the sign of the point's normal is known, from the scan or its viewpoint.
    oriented: Vec<bool>,
    /// For each channel, the variance of the points of its largest scan about the planes of their neighbours,
    /// over the stated variance (over 1 if none was stated). It is at least that of the noise, unless errors
    /// of neighbours are correlated. None if there are too few points.
    pub roughness: Vec<Option<f64>>,
    /// Variance of rounding: no estimate is smaller.
    pub min_variance: f64,
    /// For each channel, true if σ was stated: by the sensor's model, or for every point of its scans.
    pub stated: Vec<bool>,
    /// For each sensor, true if errors of neighbouring readings are correlated. In dense stereo they are,
    /// since neighbours share most of the matched pixels.
    pub correlated_errors: Vec<bool>,
    /// True if objects on the ground were removed; some of their points may remain.
    pub ground: bool,
    /// Rejected readings, by cause.
    pub rejected: BTreeMap<RejectionCause, usize>,
    noise: Vec<ScanNoise>,
    /// For each scan of normals or curvatures, the scan that it belongs to.
    base: Vec<u32>,
    /// Poses and biases that all readings of a scan share.
    pub(crate) scan_errors: ScanErrors,
    /// Index of each reading in its scan's file, until normals and curvatures are added.
    source: Vec<u32>,
    /// Pairs of scans of which the second repeats readings of the first.
    copies: BTreeSet<(u32, u32)>,
    /// Number of readings before any rejection.
    pub total: usize,
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
            self.channels.push(Channel { sensor: usize::MAX, quantity: Quantity::Position, inferred: true });
            self.stated.push(true);
            if !self.roughness.is_empty() {
                self.roughness.push(None);
            }
            self.channels.len() - 1
        });
        let scan = self.channel_of_scan.len() as u32;
        self.channel_of_scan.push(channel);
        self.base.push(scan);
        self.scan_errors.add_fixed_scan();
        self.noise.push(ScanNoise::Inferred(readings.iter().map(|r| r.variance).collect()));
        for (index, reading) in (0..).zip(readings) {
            self.points.push(reading.point);
            self.normals.push(reading.normal.map(|c| c as f32));
            self.scan.push(scan);
            self.index.push(index);
            self.held_out.push(false);
            self.oriented.push(true);
        }
    }

    /// The variance of an inferred reading; none for a real one.
    #[inline]
    #[must_use]
    pub fn inferred(&self, i: usize) -> Option<InferredVariance> {
        match &self.noise[self.scan[i] as usize] {
            ScanNoise::Inferred(all) => Some(all[self.index[i] as usize]),
            _ => None,
        }
    }

    /// Findings about scans that repeat each other.
    pub(crate) fn duplicate_scan_findings(&self, set: &ScanSet) -> Vec<Finding> {
        let name = |scan: u32| set.scans.get(scan as usize).map_or("", |posed| posed.scan.name.as_str());
        let listed = self.copies.iter().take(MAX_LISTED_DUPLICATES).map(|&(first, second)| {
            format!(
                "{}: readings repeat those of {} to the last digit; they count once: see `duplicate` among \
                 the rejected readings",
                name(second),
                name(first)
            )
        });
        let more = self.copies.len().saturating_sub(MAX_LISTED_DUPLICATES);
        listed
            .chain((more > 0).then(|| format!("{more} more pairs of scans share readings to the last digit")))
            .map(|text| Finding::new(FindingCode::DuplicateReadings, text))
            .collect()
    }

    /// The scan of the set to which a scan here belongs.
    pub(crate) fn base_scan(&self, scan: usize) -> usize {
        let scans = self.channel_of_scan.len() - self.base.len();
        if scan < scans { scan } else { self.base[scan - scans] as usize }
    }

    /// The viewing geometry of a scan's sensor, if its noise depends on it.
    pub(crate) fn viewing(&self, scan: usize) -> Viewing {
        match &self.noise[scan] {
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
        if motions.iter().all(Option::is_none) {
            return;
        }
        (self.points.par_iter_mut().zip(&mut self.normals).zip(&self.scan)).with_min_len(4096).for_each(
            |((point, normal), &scan)| {
                if let Some(motion) = &motions[scan as usize] {
                    *point = motion.apply(*point);
                    *normal = motion.rotate(normal.map(f64::from)).map(|c| c as f32);
                }
            },
        );
        for (noise, motion) in self.noise.iter_mut().zip(motions) {
            let Some(motion) = motion else { continue };
            match noise {
                ScanNoise::Model { viewing, .. } => *viewing = moved_viewing(*viewing, motion),
                ScanNoise::Sigma(_) | ScanNoise::Inferred(_) => {}
                ScanNoise::Covariance(all) => {
                    all.iter_mut().for_each(|c| *c = rotate_covariance(&motion.rotation, c))
                }
                ScanNoise::Normals(all) => all.iter_mut().for_each(|(n, _)| *n = motion.rotate(*n)),
                ScanNoise::Curvatures(all) => {
                    all.iter_mut().for_each(|(t, _)| *t = rotate_covariance(&motion.rotation, t));
                }
            }
        }
    }

    /// The readings that are not held out, by index.
    pub(crate) fn fitted(&self) -> Vec<u32> {
        (0..self.len() as u32).filter(|&i| !self.held_out[i as usize]).collect()
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// True if there is no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Channel of a reading.
    #[inline]
    #[must_use]
    pub fn channel(&self, i: usize) -> usize {
        self.channel_of_scan[self.scan[i] as usize]
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
        let index = self.index[i] as usize;
        match &self.noise[self.scan[i] as usize] {
            ScanNoise::Normals(all) => Measured::Normal(all[index].0),
            ScanNoise::Curvatures(all) => Measured::Curvature(all[index].0),
            _ => Measured::Position,
        }
    }

    /// Stated variance of each component of a reading: of a position along `normal`, of others as stated.
    #[inline]
    #[must_use]
    pub fn variance(&self, i: usize, normal: [f64; 3]) -> f64 {
        let index = self.index[i] as usize;
        match &self.noise[self.scan[i] as usize] {
            ScanNoise::Normals(all) => all[index].1,
            ScanNoise::Curvatures(all) => all[index].1,
            ScanNoise::Inferred(all) => all[index].own + all[index].shared,
            _ => variance_along(&self.covariance(i), normal),
        }
    }

    /// The scan normal of a point; zero if unknown.
    #[inline]
    #[must_use]
    pub fn normal(&self, i: usize) -> [f64; 3] {
        self.normals[i].map(f64::from)
    }

    /// Stated covariance of a position, `[xx, xy, xz, yy, yz, zz]` in world axes. It is zero for normals and
    /// curvatures, and for inferred readings, whose error is along their normal.
    #[inline]
    #[must_use]
    pub fn covariance(&self, i: usize) -> [f64; 6] {
        match &self.noise[self.scan[i] as usize] {
            ScanNoise::Model { noise, viewing } => noise.covariance(ray_at(*viewing, self.points[i])),
            ScanNoise::Sigma(all) => Noise::Isotropic { sigma: all[self.index[i] as usize] }.covariance(None),
            ScanNoise::Covariance(all) => all[self.index[i] as usize],
            ScanNoise::Normals(_) | ScanNoise::Curvatures(_) | ScanNoise::Inferred(_) => [0.0; 6],
        }
    }

    /// Rejects the marked points and counts them.
    pub(super) fn reject(&mut self, gone: &[bool], cause: RejectionCause) {
        let count = gone.iter().filter(|&&g| g).count();
        if count == 0 {
            return;
        }
        *self.rejected.entry(cause).or_insert(0) += count;
        self.drop_marked(gone);
    }

    /// Removes the marked points.
    pub(super) fn drop_marked(&mut self, gone: &[bool]) {
        fn keep<T>(values: &mut Vec<T>, gone: &[bool]) {
            let mut marks = gone.iter();
            values.retain(|_| !marks.next().is_some_and(|&g| g));
        }
        keep(&mut self.points, gone);
        keep(&mut self.normals, gone);
        keep(&mut self.scan, gone);
        keep(&mut self.index, gone);
        keep(&mut self.held_out, gone);
        keep(&mut self.oriented, gone);
        if !self.source.is_empty() {
            keep(&mut self.source, gone);
        }
    }

    /// Moves the origin near the points if they are far from it, and returns the new origin. The move is
    /// exact to the last digit.
    ///
    /// Map coordinates have seven digits before the point. Of the sixteen digits of a number, products of
    /// them leave too few for an energy that no translation changes.
    pub fn recentre(&mut self) -> [f64; 3] {
        let Some(bounds) = BoundingBox::from_points(&self.points) else {
            return [0.0; 3];
        };
        let (center, size) = (bounds.center(), bounds.diagonal());
        if norm(center) <= FAR_FROM_ORIGIN * size || size <= 0.0 {
            return [0.0; 3];
        }
        // A multiple of a power of two of about the size: differences to it are exact.
        let step = size.log2().ceil().exp2();
        let origin = center.map(|c| (c / step).round() * step);
        self.move_origin(origin);
        origin
    }

    /// Moves the origin to a point.
    pub(crate) fn move_origin(&mut self, origin: [f64; 3]) {
        if origin == [0.0; 3] {
            return;
        }
        for p in &mut self.points {
            *p = sub(*p, origin);
        }
        for noise in &mut self.noise {
            if let ScanNoise::Model { viewing: Viewing::Origin(from), .. } = noise {
                *from = sub(*from, origin);
            }
        }
    }

    /// Turns normals of unknown sign to the side of `normal_near` at their points.
    pub fn orient_by(&mut self, normal_near: impl Fn([f64; 3]) -> [f64; 3] + Sync) {
        self.normals
            .par_iter_mut()
            .zip(&self.points)
            .zip(&self.oriented)
            .with_min_len(256)
            .filter(|(_, oriented)| !**oriented)
            .for_each(|((normal, p), _)| {
                if dot(normal.map(f64::from), normal_near(*p)) < 0.0 {
                    *normal = normal.map(|c| -c);
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
