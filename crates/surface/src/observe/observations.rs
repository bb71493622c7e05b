//! From scans to observations: world positions, covariances, normals, and first rejections.
//!
//! Comes in: scans with their sensors. Goes out: [`Observations`], column by column, each kept point once.
//! What the scan itself speaks against (depth edges, grazing angles) is counted by cause and left out; a
//! seeded share is held out of the fit to judge it.

use crate::observe::SharedErrors;
use planish_estimate::vector3::{cross, dot, norm, scale, sub, unit, upper_triangle};
use planish_estimate::{Error, Result};
use planish_exchange::ScanSet;
use planish_mesh::BoundingBox;
use planish_sense::{
    Ground, GroundOptions, Noise, Pose, Scan, ScanChecks, Sensor, SensorKind, Suspicion, Viewing,
    classify_ground, cloud_geometry, local_roughness, orient_normals, ray_at, scan_geometry, variance_along,
};
use planish_spline::{curvature_tensor, principal_axes};
use rayon::prelude::*;
use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::hash::{BuildHasherDefault, Hasher};

/// Why a reading takes no part in the fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Rejection {
    /// A coordinate was not finite.
    NotFinite,
    /// The same coordinates as an earlier point of its sensor, to the last digit: one reading written twice.
    Duplicate,
    /// Of a class that the file calls noise, or not ground where the ground is fitted.
    Class,
    /// On something that stands on the ground, where the ground is fitted.
    AboveGround,
    /// Far below the ground, where the ground is fitted.
    BelowGround,
    /// A jump in depth to all of its neighbours, or far from all others.
    Isolated,
    /// Next to a jump in depth.
    DepthEdge,
    /// Seen at a grazing angle.
    Grazing,
    /// Its scan normal disagrees with the surface where it projects to.
    NormalMismatch,
    /// It lies beyond the border of an open surface.
    BeyondBorder,
    /// Farther from the surface than its error explains.
    Outlier,
    /// A sensor of normals or curvatures states none there.
    NoDirection,
    /// The direction of its first curvature is that of its normal.
    DirectionAlongNormal,
}

impl Rejection {
    /// The key in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NotFinite => "not_finite",
            Self::Duplicate => "duplicate",
            Self::Class => "class",
            Self::AboveGround => "above_ground",
            Self::BelowGround => "below_ground",
            Self::Isolated => "isolated",
            Self::DepthEdge => "depth_edge",
            Self::Grazing => "grazing",
            Self::NormalMismatch => "normal_mismatch",
            Self::BeyondBorder => "beyond_border",
            Self::Outlier => "outlier",
            Self::NoDirection => "no_direction",
            Self::DirectionAlongNormal => "direction_along_normal",
        }
    }
}

/// What a reading is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Quantity {
    /// Where the surface is; what counts is the component along its normal.
    #[default]
    Position,
    /// How it is turned: the tilt of both tangents.
    Normal,
    /// How it is bent: the three components of the second fundamental form.
    Curvature,
}

impl Quantity {
    /// How many numbers a reading has that the surface determines.
    #[must_use]
    pub fn rows(self) -> usize {
        match self {
            Self::Position => 1,
            Self::Normal => 2,
            Self::Curvature => 3,
        }
    }

    /// The name in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Normal => "normal",
            Self::Curvature => "curvature",
        }
    }
}

/// One sensor's readings of one quantity: each has a σ of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Channel {
    /// The sensor, among those of the set.
    pub sensor: usize,
    /// What it reads.
    pub quantity: Quantity,
    /// Whether its readings were concluded from others: then it has no sensor, and none of its own errors can
    /// be told from theirs.
    pub invented: bool,
}

/// What one reading says, in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measured {
    /// Its place.
    Position,
    /// A unit normal.
    Normal([f64; 3]),
    /// The second fundamental form as a tensor `[xx, xy, xz, yy, yz, zz]` in space.
    Curvature([f64; 6]),
}

/// Where the covariances of one scan's points come from.
#[derive(Debug, Clone)]
enum ScanNoise {
    /// The sensor's model, with rays in the world frame.
    Model { noise: Noise, viewing: Viewing },
    /// One σ a point.
    Sigma(Vec<f64>),
    /// One covariance a point, in the world frame.
    Covariance(Vec<[f64; 6]>),
    /// Normals, each with its variance about each axis in the tangent plane, in radians squared.
    Normals(Vec<([f64; 3], f64)>),
    /// Curvature tensors, each with the variance of its components.
    Curvatures(Vec<([f64; 6], f64)>),
    /// Readings that were concluded from others.
    Invented(Vec<InventedVariance>),
}

/// The variance along its normal of a reading that was concluded from others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InventedVariance {
    /// Of the error that is its own.
    pub own: f64,
    /// Of the error that it shares with those around it, because they were concluded in the same way.
    pub shared: f64,
}

/// A reading that was concluded from others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InventedReading {
    /// Where the surface should be.
    pub point: [f64; 3],
    /// Its unit normal there.
    pub normal: [f64; 3],
    /// How uncertain that is.
    pub variance: InventedVariance,
}

impl Measured {
    /// The same after a rotation.
    pub(crate) fn turned(&self, by: &Pose) -> Self {
        match self {
            Self::Position => Self::Position,
            Self::Normal(n) => Self::Normal(by.rotate(*n)),
            Self::Curvature(tensor) => Self::Curvature(rotate_covariance(&by.rotation, tensor)),
        }
    }
}

/// The readings that a fit uses, in world coordinates.
#[derive(Debug, Clone, Default)]
pub struct Observations {
    /// Positions.
    pub points: Vec<[f64; 3]>,
    /// Unit normals of the scans, zero where unknown.
    pub normals: Vec<[f32; 3]>,
    /// Index of the scan of each point.
    pub scan: Vec<u32>,
    /// Index of the point among the scan's kept points.
    index: Vec<u32>,
    /// Whether the point is held out of the fit to judge it.
    pub held_out: Vec<bool>,
    /// For each scan, its channel. What a scan measures beside positions is a scan of its own, after all
    /// others.
    pub channel_of_scan: Vec<usize>,
    /// The channels: the positions of every sensor in the order of the sensors, then what else they read.
    pub channels: Vec<Channel>,
    /// Whether the sign of the point's normal is known, from the scan or its viewpoint.
    oriented: Vec<bool>,
    /// For each channel, how far the points of its largest scan lie from the planes of their neighbours:
    /// variance along the normal over that stated (over one where none was stated). No less than the noise,
    /// unless neighbours err together; none where there are too few points to tell.
    pub roughness: Vec<Option<f64>>,
    /// A variance that is rounding and no more.
    pub least_variance: f64,
    /// Whether the channel's σ was stated, by its sensor's model or by every point of its scans.
    pub stated: Vec<bool>,
    /// Whether the errors of a sensor's neighbouring readings are alike, by sensor: those of dense stereo
    /// are, as neighbours share most of what was matched.
    pub err_together: Vec<bool>,
    /// Whether they are what is left of points on the ground and above it: more of the latter may be among
    /// them.
    pub ground: bool,
    /// What was left out already, by cause.
    pub rejected: BTreeMap<Rejection, usize>,
    noise: Vec<ScanNoise>,
    /// For what scans measure beside positions, after all others: the scan that it is of.
    base: Vec<u32>,
    /// What the readings of a scan err in together.
    pub(crate) shared: SharedErrors,
    /// The point of its scan that each one is, until directions are added.
    source: Vec<u32>,
    /// Pairs of scans of which the second repeats readings of the first.
    copies: BTreeSet<(u32, u32)>,
    /// Number of readings before anything was left out.
    pub total: usize,
}

/// What observations are made from.
#[derive(Debug, Clone, Copy)]
pub struct ObservationOptions {
    /// Share of points held out.
    pub held_out_share: f64,
    /// Seed of the choice.
    pub seed: u64,
    /// Checks of each scan.
    pub checks: ScanChecks,
    /// Whether a sheet is wanted: of points that are classified the ground alone, and of every point whose
    /// side is not known the upper.
    pub sheet: bool,
    /// Whether readings are taken as they are: without normals but those that a file states, and without the
    /// checks that neighbours make.
    pub as_they_are: bool,
    /// How the ground is told from what stands on it, where only the ground is wanted and a scan has no
    /// classes that tell it.
    pub ground: Option<GroundOptions>,
}

/// Classes of the ASPRS that are readings of nothing: low and high noise.
const NOISE_CLASSES: [u8; 2] = [7, 18];
/// Classes that are bare earth: ground, and key points of it.
const GROUND_CLASSES: [u8; 2] = [2, 8];

/// Of a scan of fewer readings none is held out: four touches that anchor a surface judge nothing and are
/// missed.
const LEAST_JUDGED: usize = 30;

/// The least sine of the angle between a normal and the direction of a curvature: that lies in the tangent
/// plane, at a right angle.
const LEAST_ACROSS: f64 = 1e-6;

/// Pairs of scans with the same readings that are named one by one.
const COPIES_TOLD: usize = 5;

/// Points farther from the origin than so many times their size are moved there for the fit.
const FAR_FROM_ORIGIN: f64 = 8.0;

/// Fewer points say nothing of a curved surface and its noise: a plane alone takes three, a quadric nine.
const LEAST_POINTS: usize = 10;

impl Observations {
    /// Carries every scan into the world, makes normals, and leaves out what the scans themselves speak
    /// against.
    ///
    /// # Errors
    /// `Undetermined` when no scan has a usable point; `Input` when a σ is not positive.
    pub fn new(
        scans: &[&Scan],
        sensor_of_scan: &[usize],
        sensors: &[Sensor],
        options: &ObservationOptions,
    ) -> Result<Self> {
        let total: usize = scans.iter().map(|s| s.points.len() + s.dropped_not_finite).sum();
        let mut made = Self {
            channel_of_scan: sensor_of_scan.to_vec(),
            channels: (0..sensors.len())
                .map(|sensor| Channel { sensor, quantity: Quantity::Position, invented: false })
                .collect(),
            total,
            stated: vec![true; sensors.len()],
            err_together: sensors.iter().map(|s| s.kind == SensorKind::Stereo).collect(),
            ..Self::default()
        };
        let found: usize = scans.iter().map(|s| s.points.len()).sum();
        if found < LEAST_POINTS {
            return Err(Error::undetermined(format!(
                "needed at least {LEAST_POINTS} points that are not on one line, found {found} in all"
            )));
        }
        let not_finite: usize = scans.iter().map(|s| s.dropped_not_finite).sum();
        if not_finite > 0 {
            made.rejected.insert(Rejection::NotFinite, not_finite);
        }
        // Small clouds without a viewpoint get their normals from the union: neighbours come from any scan.
        let geometries = scans
            .par_iter()
            .map(|scan| {
                if options.as_they_are
                    || scan.points.len() < 3
                    || (scan.grid.is_none() && scan.normals.is_none() && scan.viewing == Viewing::Unknown)
                {
                    Ok(None)
                } else {
                    scan_geometry(scan, &options.checks).map(Some)
                }
            })
            .collect::<Result<Vec<_>>>()?;
        // Which point of its scan each one is, where that is asked for later.
        let mut source: Vec<u32> = Vec::new();
        let wanted = |s: usize| Directions::of(scans[s], &sensors[sensor_of_scan[s]]).any();
        let keep_source = (0..scans.len()).any(wanted);
        let mut seen: Vec<SeenPoints> = vec![SeenPoints::default(); sensors.len()];
        for (s, (scan, geometry)) in scans.iter().zip(&geometries).enumerate() {
            let sensor = &sensors[sensor_of_scan[s]];
            let mut kept = 0_u32;
            let (mut sigmas, mut covariances) = (Vec::new(), Vec::new());
            let seen = &mut seen[sensor_of_scan[s]];
            let copied_grid = copied_grid(scans, sensor_of_scan, s);
            let ground = options.sheet && has_ground(scan);
            for i in 0..scan.points.len() {
                if let Some(class) = scan.classes.as_ref().map(|classes| classes[i])
                    && (NOISE_CLASSES.contains(&class) || ground && !GROUND_CLASSES.contains(&class))
                {
                    *made.rejected.entry(Rejection::Class).or_insert(0) += 1;
                    continue;
                }
                let world = scan.world_from_scanner.apply(scan.points[i]);
                let repeated = match (&scan.grid, copied_grid) {
                    (Some(_), copied) => copied,
                    (None, _) => seen.scan_with(scans, sensor, (s, i), world),
                };
                if let Some(earlier) = repeated {
                    if earlier != s {
                        made.copies.insert((earlier as u32, s as u32));
                    }
                    *made.rejected.entry(Rejection::Duplicate).or_insert(0) += 1;
                    continue;
                }
                let suspicion = geometry.as_ref().map_or(Suspicion::None, |g| g.suspicion[i]);
                let cause = match suspicion {
                    Suspicion::None => None,
                    Suspicion::Isolated => Some(Rejection::Isolated),
                    Suspicion::DepthEdge => Some(Rejection::DepthEdge),
                    Suspicion::Grazing => Some(Rejection::Grazing),
                };
                if let Some(cause) = cause {
                    *made.rejected.entry(cause).or_insert(0) += 1;
                    continue;
                }
                let stated = || scan.normals.as_ref().filter(|_| options.as_they_are).map(|all| all[i]);
                let normal = geometry.as_ref().map(|g| g.normals[i]).or_else(stated);
                let normal = normal.unwrap_or([0.0; 3]);
                made.points.push(world);
                made.normals.push(scan.world_from_scanner.rotate(normal).map(|c| c as f32));
                made.scan.push(s as u32);
                made.index.push(kept);
                if keep_source {
                    source.push(i as u32);
                }
                // A normal of zero in a file means that it is not known.
                let known = scan.grid.is_some() || dot(normal, normal) > 0.0;
                made.oriented.push(known && geometry.as_ref().is_some_and(|g| g.oriented));
                let spared = scan.points.len() >= LEAST_JUDGED;
                made.held_out
                    .push(spared && hash01(options.seed, s as u64, i as u64) < options.held_out_share);
                if let Some(all) = &scan.covariance {
                    covariances.push(rotate_covariance(&scan.world_from_scanner.rotation, &all[i]));
                } else if let Some(all) = &scan.sigma {
                    sigmas.push(all[i]);
                }
                kept += 1;
            }
            let viewing = moved_viewing(scan.viewing, &scan.world_from_scanner);
            made.noise.push(if scan.covariance.is_some() {
                ScanNoise::Covariance(covariances)
            } else if scan.sigma.is_some() {
                ScanNoise::Sigma(sigmas)
            } else {
                match sensor.noise {
                    Some(noise) => ScanNoise::Model { noise, viewing },
                    None => {
                        made.stated[sensor_of_scan[s]] = false;
                        // One unit of length until the variance components say more.
                        ScanNoise::Model { noise: Noise::Isotropic { sigma: 1.0 }, viewing: Viewing::Unknown }
                    }
                }
            });
        }
        if made.points.len() < LEAST_POINTS {
            let left = made.points.len();
            let repeated = made.rejected.get(&Rejection::Duplicate).copied().unwrap_or(0);
            return Err(Error::undetermined(if repeated > 0 {
                format!(
                    "of {total} readings {repeated} repeat the coordinates of another, which leaves {left}: at least {LEAST_POINTS} are needed"
                )
            } else {
                format!(
                    "of {total} readings the scans' own checks leave {left}: at least {LEAST_POINTS} are needed"
                )
            }));
        }
        made.source = source;
        if let Some(ground) = &options.ground {
            made.keep_ground(scans, ground)?;
        }
        if !options.as_they_are {
            let touched = |sensor: usize| sensors[sensor].kind == SensorKind::Touch;
            made.complete_normals(options.checks.neighbours, !options.sheet, touched)?;
            if options.sheet {
                made.turn_upwards();
            }
            made.measure_roughness(scans, sensors.len(), options.checks.neighbours);
        }
        made.add_directions(scans, sensor_of_scan, sensors)?;
        Ok(made)
    }

    /// Adds what scans measure beside positions: for each normal and each curvature an observation of its
    /// own, at the same place. Sensors that measure nothing else lose their positions.
    fn add_directions(
        &mut self,
        scans: &[&Scan],
        sensor_of_scan: &[usize],
        sensors: &[Sensor],
    ) -> Result<()> {
        let placed = self.len();
        for (s, scan) in scans.iter().enumerate() {
            let sensor = &sensors[sensor_of_scan[s]];
            let wanted = Directions::of(scan, sensor);
            wanted.check(scan, sensor)?;
            if !wanted.any() {
                continue;
            }
            let turn = &scan.world_from_scanner;
            // Each reading's place, its point of the scan, its normal, and whether that is on the side that
            // was found out for it.
            let known: Vec<(usize, usize, [f64; 3], f64)> = (0..placed)
                .filter(|&k| self.scan[k] as usize == s)
                .filter_map(|k| {
                    let i = self.source[k] as usize;
                    let normal = unit(turn.rotate(scan.normals.as_ref().map_or([0.0; 3], |all| all[i])))?;
                    let side = dot(normal, self.normals[k].map(f64::from));
                    Some((k, i, normal, if side < 0.0 { -1.0 } else { 1.0 }))
                })
                .collect();
            if wanted.normals {
                let deg = |i: usize| {
                    let own = scan.sigma_normal_deg.as_ref().map(|all| all[i]);
                    own.or(sensor.sigma_normal_deg).map(f64::to_radians)
                };
                let stated = scan.sigma_normal_deg.is_some() || sensor.sigma_normal_deg.is_some();
                let at: Vec<usize> = known.iter().map(|(k, ..)| *k).collect();
                let readings = known.iter().map(|&(_, i, normal, side)| {
                    let variance = deg(i).unwrap_or(1.0).powi(2);
                    (scale(side, normal), variance)
                });
                let noise = ScanNoise::Normals(readings.collect());
                self.add_scan(sensor_of_scan[s], Quantity::Normal, stated, &at, noise);
            }
            if let (true, Some(curvatures)) = (wanted.curvatures, &scan.curvatures) {
                let mut along_normal = 0;
                let readings = known.iter().filter_map(|&(k, i, normal, side)| {
                    let direction = turn.rotate(curvatures[i].direction);
                    // One of zero says that nothing is known.
                    if norm(cross(direction, normal)) <= LEAST_ACROSS * norm(direction) {
                        along_normal += usize::from(norm(direction) > 0.0);
                        return None;
                    }
                    let tensor = curvature_tensor(curvatures[i].values, direction, normal)?.map(|c| side * c);
                    let own = scan.sigma_curvature.as_ref().map(|all| all[i]);
                    Some((k, (tensor, own.or(sensor.sigma_curvature).unwrap_or(1.0).powi(2))))
                });
                let (at, readings): (Vec<usize>, Vec<_>) = readings.unzip();
                if along_normal > 0 {
                    *self.rejected.entry(Rejection::DirectionAlongNormal).or_insert(0) += along_normal;
                    self.total += along_normal;
                }
                let stated = scan.sigma_curvature.is_some() || sensor.sigma_curvature.is_some();
                let noise = ScanNoise::Curvatures(readings);
                self.add_scan(sensor_of_scan[s], Quantity::Curvature, stated, &at, noise);
            }
            let silent = (0..placed).filter(|&k| self.scan[k] as usize == s).count() - known.len();
            if silent > 0 && !sensor.kind.measures_positions() {
                *self.rejected.entry(Rejection::NoDirection).or_insert(0) += silent;
            }
        }
        self.source = Vec::new();
        let gone: Vec<bool> = (0..self.len())
            .map(|k| k < placed && !sensors[sensor_of_scan[self.scan[k] as usize]].kind.measures_positions())
            .collect();
        self.total -= gone.iter().filter(|&&g| g).count();
        self.drop_marked(&gone);
        Ok(())
    }

    /// A scan of another quantity at places of one that is there.
    fn add_scan(&mut self, sensor: usize, quantity: Quantity, stated: bool, at: &[usize], noise: ScanNoise) {
        let channel = Channel { sensor, quantity, invented: false };
        let number = self.channels.iter().position(|c| *c == channel).unwrap_or_else(|| {
            self.channels.push(channel);
            self.stated.push(true);
            if !self.roughness.is_empty() {
                self.roughness.push(None);
            }
            self.channels.len() - 1
        });
        self.stated[number] &= stated;
        let scan = self.channel_of_scan.len() as u32;
        self.channel_of_scan.push(number);
        self.base.push(at.first().map_or(0, |&k| self.scan[k]));
        self.noise.push(noise);
        for (index, &k) in (0..).zip(at) {
            self.points.push(self.points[k]);
            self.normals.push(self.normals[k]);
            self.scan.push(scan);
            self.index.push(index);
            self.held_out.push(self.held_out[k]);
            self.oriented.push(self.oriented[k]);
        }
        self.total += at.len();
    }

    /// Adds readings that were concluded from others; what they were before does not count them among its
    /// own.
    pub fn add_invented(&mut self, readings: &[InventedReading]) {
        if readings.is_empty() {
            return;
        }
        let channel = self.channels.iter().position(|c| c.invented).unwrap_or_else(|| {
            self.channels.push(Channel { sensor: usize::MAX, quantity: Quantity::Position, invented: true });
            self.stated.push(true);
            if !self.roughness.is_empty() {
                self.roughness.push(None);
            }
            self.channels.len() - 1
        });
        let scan = self.channel_of_scan.len() as u32;
        self.channel_of_scan.push(channel);
        self.base.push(scan);
        self.shared.add_fixed_scan();
        self.noise.push(ScanNoise::Invented(readings.iter().map(|r| r.variance).collect()));
        for (index, reading) in (0..).zip(readings) {
            self.points.push(reading.point);
            self.normals.push(reading.normal.map(|c| c as f32));
            self.scan.push(scan);
            self.index.push(index);
            self.held_out.push(false);
            self.oriented.push(true);
        }
    }

    /// The variance of a reading that was concluded from others; none of one that was taken.
    #[inline]
    #[must_use]
    pub fn invented(&self, i: usize) -> Option<InventedVariance> {
        match &self.noise[self.scan[i] as usize] {
            ScanNoise::Invented(all) => Some(all[self.index[i] as usize]),
            _ => None,
        }
    }

    /// Which scans repeat each other, for people.
    pub(crate) fn copies_told(&self, set: &ScanSet) -> Vec<String> {
        let name = |scan: u32| set.scans.get(scan as usize).map_or("", |posed| posed.scan.name.as_str());
        let told = self.copies.iter().take(COPIES_TOLD).map(|&(first, second)| {
            format!(
                "{}: readings repeat those of {} to the last digit; they count once: see `duplicate` among what was set aside",
                name(second),
                name(first)
            )
        });
        let more = self.copies.len().saturating_sub(COPIES_TOLD);
        told.chain((more > 0).then(|| format!("{more} more pairs of scans share readings to the last digit")))
            .collect()
    }

    /// The scan of the set that a scan here is of.
    pub(crate) fn base_scan(&self, scan: usize) -> usize {
        let scans = self.channel_of_scan.len() - self.base.len();
        if scan < scans { scan } else { self.base[scan - scans] as usize }
    }

    /// How the sensor of a scan looks, where its noise depends on it.
    pub(crate) fn viewing(&self, scan: usize) -> Viewing {
        match &self.noise[scan] {
            ScanNoise::Model { viewing, .. } => *viewing,
            _ => Viewing::Unknown,
        }
    }

    /// Changes the shared unknowns by a step and moves the scans with them.
    pub(crate) fn take_shared(&mut self, step: &[f64]) {
        let motions = self.shared.take(step);
        self.move_scans(&motions);
    }

    /// Moves whole scans: their points, their normals, and how their sensors look.
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
                ScanNoise::Sigma(_) | ScanNoise::Invented(_) => {}
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

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
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

    /// What a reading is of.
    #[inline]
    #[must_use]
    pub fn quantity(&self, i: usize) -> Quantity {
        self.channels[self.channel(i)].quantity
    }

    /// What a reading says.
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

    /// Variance of each number of a reading as stated: of a position along a normal, of others as they are.
    #[inline]
    #[must_use]
    pub fn variance(&self, i: usize, normal: [f64; 3]) -> f64 {
        let index = self.index[i] as usize;
        match &self.noise[self.scan[i] as usize] {
            ScanNoise::Normals(all) => all[index].1,
            ScanNoise::Curvatures(all) => all[index].1,
            ScanNoise::Invented(all) => all[index].own + all[index].shared,
            _ => variance_along(&self.covariance(i), normal),
        }
    }

    /// The scan normal of a point, zero where unknown.
    #[inline]
    #[must_use]
    pub fn normal(&self, i: usize) -> [f64; 3] {
        self.normals[i].map(f64::from)
    }

    /// Covariance of a position as stated: `[xx, xy, xz, yy, yz, zz]` in world axes; zero where the place is
    /// no measurement, and of readings that were concluded from others, whose error is along their normal.
    #[inline]
    #[must_use]
    pub fn covariance(&self, i: usize) -> [f64; 6] {
        match &self.noise[self.scan[i] as usize] {
            ScanNoise::Model { noise, viewing } => noise.covariance(ray_at(*viewing, self.points[i])),
            ScanNoise::Sigma(all) => Noise::Isotropic { sigma: all[self.index[i] as usize] }.covariance(None),
            ScanNoise::Covariance(all) => all[self.index[i] as usize],
            ScanNoise::Normals(_) | ScanNoise::Curvatures(_) | ScanNoise::Invented(_) => [0.0; 6],
        }
    }

    /// Normals for the points that have none, and one orientation for those whose side is unknown if it is
    /// asked for; isolated ones among them go. Touches (`touched`, by sensor) are few and put where somebody
    /// wanted them: those are isolated that are so among touches, too.
    fn complete_normals(
        &mut self,
        neighbours: usize,
        orient: bool,
        touched: impl Fn(usize) -> bool,
    ) -> Result<()> {
        if self.oriented.iter().all(|&o| o) {
            return Ok(());
        }
        let unknown = |made: &Self, i: usize| !made.oriented[i] && made.normals[i] == [0.0; 3];
        if (0..self.len()).any(|i| unknown(self, i)) {
            let cloud = cloud_geometry(&self.points, neighbours)?;
            let touch = |i: usize| touched(self.channels[self.channel(i)].sensor);
            let mut gone: Vec<bool> =
                (0..self.len()).map(|i| unknown(self, i) && cloud.isolated[i]).collect();
            if (0..self.len()).any(|i| gone[i] && touch(i)) {
                let touches: Vec<usize> = (0..self.len()).filter(|&i| touch(i)).collect();
                let points: Vec<[f64; 3]> = touches.iter().map(|&i| self.points[i]).collect();
                let among_touches = match points.len() {
                    0..LEAST_POINTS => vec![false; points.len()],
                    _ => cloud_geometry(&points, neighbours)?.isolated,
                };
                for (i, isolated) in touches.into_iter().zip(among_touches) {
                    gone[i] &= isolated;
                }
            }
            for i in (0..self.len()).filter(|&i| !gone[i]) {
                if unknown(self, i) {
                    self.normals[i] = cloud.normals[i].map(|c| c as f32);
                }
            }
            self.leave_out(&gone, Rejection::Isolated);
        }
        if !orient {
            return Ok(());
        }
        let mut normals: Vec<[f64; 3]> = (0..self.len()).map(|i| self.normal(i)).collect();
        orient_normals(&self.points, &mut normals, &self.oriented, neighbours)?;
        self.normals = normals.iter().map(|n| n.map(|c| c as f32)).collect();
        Ok(())
    }

    /// Leaves out what stands on the ground, or lies far below it, of scans whose classes do not tell the
    /// ground already.
    fn keep_ground(&mut self, scans: &[&Scan], options: &GroundOptions) -> Result<()> {
        self.ground = true;
        let mut found = classify_ground(&self.points, options)?;
        let told: Vec<bool> = scans.iter().map(|scan| has_ground(scan)).collect();
        for (what, &scan) in found.iter_mut().zip(&self.scan) {
            if told[scan as usize] {
                *what = Ground::Bare;
            }
        }
        let left = found.iter().filter(|&&what| what == Ground::Bare).count();
        if left < LEAST_POINTS {
            return Err(Error::undetermined(format!(
                "of {} readings only {left} are on the ground: at least {LEAST_POINTS} are needed",
                found.len()
            )));
        }
        let below: Vec<bool> = found.iter().map(|&what| what == Ground::Below).collect();
        self.leave_out(&below, Rejection::BelowGround);
        found.retain(|&what| what != Ground::Below);
        let above: Vec<bool> = found.iter().map(|&what| what == Ground::Above).collect();
        self.leave_out(&above, Rejection::AboveGround);
        Ok(())
    }

    /// Turns normals whose side is not known to the upper side of the plane that is nearest to all points;
    /// upper is where the largest coordinate of its normal is positive. Those that are steep against it are
    /// not known after all: where readings are few or lie in rows, planes of neighbours stand up that no
    /// ground has.
    fn turn_upwards(&mut self) {
        /// Cosine of sixty degrees.
        const STEEP: f64 = 0.5;
        let (_, axes, _) = principal_axes(&self.points);
        let flat = axes[2];
        let largest = flat.into_iter().fold(0.0_f64, |a, b| if b.abs() > a.abs() { b } else { a });
        for i in (0..self.len()).filter(|&i| !self.oriented[i]) {
            let up = dot(self.normal(i), flat) * largest.signum();
            if up < -STEEP {
                self.normals[i] = self.normals[i].map(|c| -c);
            } else if up < STEEP {
                self.normals[i] = [0.0; 3];
            }
        }
    }

    /// Leaves out the points that are marked.
    fn leave_out(&mut self, gone: &[bool], cause: Rejection) {
        let count = gone.iter().filter(|&&g| g).count();
        if count == 0 {
            return;
        }
        *self.rejected.entry(cause).or_insert(0) += count;
        self.drop_marked(gone);
    }

    fn drop_marked(&mut self, gone: &[bool]) {
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

    /// Moves the origin near the points where they lie far from it, and says where it is now; exact to the
    /// last digit.
    ///
    /// Coordinates of a map have seven digits before the point: what is left of the sixteen after products of
    /// them is too little for an energy that no translation changes.
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

    /// Finds [`Self::roughness`] and [`Self::least_variance`].
    fn measure_roughness(&mut self, scans: &[&Scan], sensors: usize, neighbours: usize) {
        let size = BoundingBox::from_points(&self.points).map_or(0.0, |b| b.diagonal());
        self.least_variance = (1e-12 * size).powi(2).max(f64::MIN_POSITIVE);
        self.roughness = (0..sensors)
            .map(|sensor| {
                let largest = (0..scans.len())
                    .filter(|&s| self.channel_of_scan[s] == sensor)
                    .max_by_key(|&s| scans[s].points.len())?;
                let known = |i: usize| self.normals[i] != [0.0; 3];
                let own: Vec<usize> =
                    (0..self.len()).filter(|&i| self.scan[i] as usize == largest && known(i)).collect();
                let points: Vec<[f64; 3]> = own.iter().map(|&i| self.points[i]).collect();
                let variance = |&i: &usize| variance_along(&self.covariance(i), self.normal(i));
                let stated = own.iter().map(variance).sum::<f64>() / own.len().max(1) as f64;
                local_roughness(&points, neighbours)
                    .filter(|_| stated > 0.0)
                    .map(|roughness| (roughness * roughness).max(self.least_variance) / stated)
            })
            .collect();
    }

    /// Turns normals whose sign is not known to the side that `normal_near` says.
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

/// What a scan measures beside positions: what it states a σ of, or its sensor does, or what its sensor is
/// for.
#[derive(Clone, Copy)]
struct Directions {
    normals: bool,
    curvatures: bool,
}

impl Directions {
    fn of(scan: &Scan, sensor: &Sensor) -> Self {
        let (normals, curvatures) = (scan.normals.is_some(), scan.curvatures.is_some());
        Self {
            normals: sensor.kind == SensorKind::Normal
                || normals && (scan.sigma_normal_deg.is_some() || sensor.sigma_normal_deg.is_some()),
            curvatures: sensor.kind == SensorKind::Curvature
                || curvatures && (scan.sigma_curvature.is_some() || sensor.sigma_curvature.is_some()),
        }
    }

    fn any(self) -> bool {
        self.normals || self.curvatures
    }

    fn check(self, scan: &Scan, sensor: &Sensor) -> Result<()> {
        let needed = |columns: &str| {
            Error::input(format!(
                "{}: needed the columns {columns} of the sensor \"{}\" of the kind \"{}\", found none",
                scan.name,
                sensor.name,
                sensor.kind.name()
            ))
        };
        if self.curvatures && scan.curvatures.is_none() {
            return Err(needed("k1 k2 d1x d1y d1z"));
        }
        if self.any() && scan.normals.is_none() {
            return Err(needed("nx ny nz"));
        }
        Ok(())
    }
}

/// Where a sensor has read already, point by point, over all of its scans: noise of independent readings does
/// not repeat to the last digit.
#[derive(Debug, Clone, Default)]
struct SeenPoints(HashMap<[u64; 3], (u32, u32), BuildHasherDefault<BitsHasher>>);

impl SeenPoints {
    /// The earlier scan, or this one, that holds the same reading; none where it is new, and it is kept in
    /// mind then.
    ///
    /// Where a sensor measures no positions they are pixels, which its scans share: a reading is the same
    /// then where its normal is, too.
    fn scan_with(
        &mut self,
        scans: &[&Scan],
        sensor: &Sensor,
        (s, i): (usize, usize),
        world: [f64; 3],
    ) -> Option<usize> {
        match self.0.entry(world.map(f64::to_bits)) {
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

/// The earlier scan of the same sensor and pose that a scan with a grid repeats as a whole. Single cells may
/// agree: depths of images are whole numbers.
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

/// Whether a scan's classes tell the ground from the rest.
pub(crate) fn has_ground(scan: &Scan) -> bool {
    (scan.classes.iter().flatten()).any(|class| GROUND_CLASSES.contains(class))
}

/// Hashes the bits of coordinates; the standard hasher withstands attackers, and takes a tenth of the time of
/// reading a large cloud for it.
#[derive(Default)]
pub(crate) struct BitsHasher(u64);

impl Hasher for BitsHasher {
    fn write(&mut self, bytes: &[u8]) {
        for part in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..part.len()].copy_from_slice(part);
            self.0 = (self.0.rotate_left(23) ^ u64::from_le_bytes(word)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        }
    }

    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
}

/// A repeatable number in [0, 1) for a point of a scan.
pub(crate) fn hash01(seed: u64, scan: u64, point: u64) -> f64 {
    let mut x = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (scan << 40) ^ point;
    for _ in 0..2 {
        x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        x ^= x >> 31;
    }
    (x >> 11) as f64 / (1_u64 << 53) as f64
}

/// How a sensor looks after a motion.
pub(crate) fn moved_viewing(viewing: Viewing, motion: &Pose) -> Viewing {
    match viewing {
        Viewing::Unknown => Viewing::Unknown,
        Viewing::Direction(d) => Viewing::Direction(motion.rotate(d)),
        Viewing::Origin(o) => Viewing::Origin(motion.apply(o)),
    }
}

/// `R C Rᵀ` of a covariance `[xx, xy, xz, yy, yz, zz]`.
fn rotate_covariance(r: &[[f64; 3]; 3], c: &[f64; 6]) -> [f64; 6] {
    let full = [[c[0], c[1], c[2]], [c[1], c[3], c[4]], [c[2], c[4], c[5]]];
    let entry = |i: usize, j: usize| -> f64 {
        (0..3).map(|a| r[i][a] * (0..3).map(|b| full[a][b] * r[j][b]).sum::<f64>()).sum()
    };
    upper_triangle(entry)
}
