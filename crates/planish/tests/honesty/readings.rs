//! Readings of a true surface with one kind of defect.
//!
//! Input: a topology, a condition and a seed. Output: a scan set in a random frame, and what is true of it.
//! What the condition leaves open varies with the seed: size of the noise, whether σ is stated, whether the
//! readings have normals, and whether they are dense in some places.

use crate::truth::{Placement, SmoothObject, Topology, TrueSurface, rng_of, sample_surface};
use planish_core::DVec3;
use planish_exchange::{PosedScan, ScanSet, Unit};
use planish_sense::{Noise, Scan, Sensor};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

/// The defect of the readings of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Condition {
    /// Independent normal errors.
    Clean,
    /// A percentage of the readings is anywhere: along the normals, or in a box about the object.
    UniformOutliers(u32),
    /// A percentage of the readings lies outside of the surface, all on the same side.
    OneSidedOutliers(u32),
    /// Half of the normals point inwards.
    HalfFlippedNormals,
    /// Normals are random directions.
    RandomNormals,
    /// Half of the readings lie on a second layer, a tenth of the size away.
    TwoLayers,
    /// Each reading states its true σ; these span nine decades.
    NineDecades,
    /// The stated σ is the true one times this factor.
    MisstatedSigma(f64),
    /// Errors are a smooth field with a correlation length of this many spacings.
    Correlated(f64),
    /// This number of readings.
    Readings(usize),
    /// Only the side that faces one direction was seen (half of a sheet).
    OneSide,
    /// A hole of ten spacings in the readings.
    Hole,
}

impl Condition {
    pub const ALL: [Self; 22] = [
        Self::Clean,
        Self::UniformOutliers(5),
        Self::UniformOutliers(15),
        Self::UniformOutliers(30),
        Self::UniformOutliers(45),
        Self::OneSidedOutliers(30),
        Self::HalfFlippedNormals,
        Self::RandomNormals,
        Self::TwoLayers,
        Self::NineDecades,
        Self::MisstatedSigma(3.0),
        Self::MisstatedSigma(1.0 / 3.0),
        Self::Correlated(3.0),
        Self::Correlated(10.0),
        Self::Readings(12),
        Self::Readings(20),
        Self::Readings(50),
        Self::Readings(100),
        Self::Readings(1000),
        Self::Readings(30_000),
        Self::OneSide,
        Self::Hole,
    ];

    pub fn name(self) -> String {
        match self {
            Self::Clean => "clean".to_owned(),
            Self::UniformOutliers(percent) => format!("uniform-{percent}"),
            Self::OneSidedOutliers(percent) => format!("one-sided-{percent}"),
            Self::HalfFlippedNormals => "half-flipped-normals".to_owned(),
            Self::RandomNormals => "random-normals".to_owned(),
            Self::TwoLayers => "two-layers".to_owned(),
            Self::NineDecades => "nine-decades".to_owned(),
            Self::MisstatedSigma(factor) if factor > 1.0 => "sigma-too-large".to_owned(),
            Self::MisstatedSigma(_) => "sigma-too-small".to_owned(),
            Self::Correlated(spacings) => format!("correlated-{spacings}"),
            Self::Readings(count) => format!("readings-{count}"),
            Self::OneSide => "one-side".to_owned(),
            Self::Hole => "hole".to_owned(),
        }
    }

    /// Whether σ is stated: always where the cell is about a stated σ or cannot do without, else for every
    /// second seed. Errors that are smooth over ten spacings cannot be told from shape without a stated σ.
    fn states_sigma(self, seed: u64) -> bool {
        matches!(self, Self::MisstatedSigma(_) | Self::Correlated(_) | Self::NineDecades)
            || seed.is_multiple_of(2)
    }

    /// Whether each reading has a normal.
    fn has_normals(self, seed: u64) -> bool {
        match self {
            Self::HalfFlippedNormals | Self::RandomNormals => true,
            _ => seed % 4 >= 2,
        }
    }
}

/// Readings, and what is true of them.
pub struct SimulatedReadings {
    pub set: ScanSet,
    pub placement: Placement,
    pub object: SmoothObject,
    /// Points of the surface that the good readings are of, in the object's frame.
    pub seen: Vec<DVec3>,
    /// Mean distance of neighbouring readings in the object's frame: the square root of area per reading.
    pub spacing: f64,
    /// Standard deviation of the errors in the object's frame (the median, where it varies).
    pub sigma: f64,
    /// Whether a σ is stated, and it is the true one.
    pub true_sigma_stated: bool,
    /// Height of the second layer above the surface, if there is one.
    pub second_layer: Option<f64>,
}

struct Reading {
    point: DVec3,
    normal: DVec3,
    sigma: f64,
}

fn normal_vector(rng: &mut ChaCha8Rng) -> DVec3 {
    DVec3::from_array([0; 3].map(|_| StandardNormal.sample(rng)))
}

/// Simulates the readings of a cell.
pub fn simulate(topology: Topology, condition: Condition, seed: u64, count: usize) -> SimulatedReadings {
    let mut rng = rng_of(&format!("{} {}", topology.name(), condition.name()), seed);
    let object = SmoothObject::random(topology, &mut rng);
    let placement = Placement::random(&mut rng);
    let sigma = 10_f64.powf(rng.random_range(-3.5..-2.0));
    let count = if let Condition::Readings(count) = condition { count } else { count };

    // Every third seed: readings are up to three times as dense in some places.
    let wave = 2.0 * normal_vector(&mut rng);
    let depth = if seed % 3 == 2 { 0.5 } else { 0.0 };
    let density = |p: DVec3| (1.0 + depth * wave.dot(p).sin()) / (1.0 + depth);
    let view = normal_vector(&mut rng).normalize();
    let is_seen = |p: DVec3| match topology {
        _ if condition != Condition::OneSide => 1.0,
        Topology::Sheet => f64::from(p.x * view.x + p.y * view.y > 0.0),
        _ => f64::from(object.normal(p).dot(view) > 0.0),
    };
    let mut sample = sample_surface(&object, count, |p| density(p) * is_seen(p), &mut rng);
    let seen_area = if condition == Condition::OneSide { 0.5 * sample.area } else { sample.area };
    let spacing = (seen_area / count as f64).sqrt();
    if condition == Condition::Hole {
        let centre = sample.points[rng.random_range(0..count)];
        sample.points.retain(|p| (*p - centre).length() > 5.0 * spacing);
    }
    let seen = sample.points;

    let mut readings: Vec<Reading> =
        (seen.iter()).map(|&p| Reading { point: p, normal: object.normal(p), sigma }).collect();
    let second_layer = (condition == Condition::TwoLayers).then_some(0.1);
    displace(&mut readings, condition, &object, spacing, &mut rng);
    let stated = condition.states_sigma(seed);
    let set = scan_set(&readings, condition, stated, condition.has_normals(seed), &placement, &mut rng);
    let true_sigma_stated = stated && !matches!(condition, Condition::MisstatedSigma(_));
    SimulatedReadings { set, placement, object, seen, spacing, sigma, true_sigma_stated, second_layer }
}

/// Adds errors, outliers and layers to points of the surface.
fn displace(
    readings: &mut [Reading],
    condition: Condition,
    object: &SmoothObject,
    spacing: f64,
    rng: &mut ChaCha8Rng,
) {
    if let Condition::Correlated(spacings) = condition {
        add_smooth_errors(readings, spacings * spacing, rng);
        return;
    }
    let mode: bool = rng.random();
    let half = 1.5 * object.half_side();
    for reading in readings {
        if condition == Condition::NineDecades {
            // From a tenth of the object's size down.
            reading.sigma = 10_f64.powf(rng.random_range(-10.0..-1.0));
        }
        if condition == Condition::TwoLayers && rng.random() {
            reading.point += 0.1 * reading.normal;
        }
        reading.point += reading.sigma * normal_vector(rng);
        match condition {
            Condition::UniformOutliers(percent) if rng.random_range(0..100) < percent => {
                if mode {
                    reading.point += rng.random_range(-1.0..1.0) * object.half_thickness() * reading.normal;
                } else {
                    reading.point = DVec3::from_array([0; 3].map(|_| rng.random_range(-half..half)));
                }
            }
            Condition::OneSidedOutliers(percent) if rng.random_range(0..100) < percent => {
                reading.point += rng.random_range(0.1..0.3) * reading.normal;
            }
            _ => {}
        }
    }
}

/// Adds errors of standard deviation σ along the normals whose correlation falls as `exp(−d² / 2 l²)` with
/// the distance `d` of two readings: a sum of random waves, as Rahimi and Recht, Random features for
/// large-scale kernel machines, 2007, section 3.
fn add_smooth_errors(readings: &mut [Reading], correlation_length: f64, rng: &mut ChaCha8Rng) {
    let waves: Vec<(DVec3, f64)> =
        (0..300).map(|_| (normal_vector(rng) / correlation_length, rng.random_range(0.0..TAU))).collect();
    let scale = (2.0 / waves.len() as f64).sqrt();
    for reading in readings {
        let field: f64 = waves.iter().map(|(k, phase)| (k.dot(reading.point) + phase).cos()).sum();
        reading.point += reading.sigma * scale * field * reading.normal;
    }
}

/// The readings in the random frame, with the columns of the condition.
fn scan_set(
    readings: &[Reading],
    condition: Condition,
    stated: bool,
    has_normals: bool,
    placement: &Placement,
    rng: &mut ChaCha8Rng,
) -> ScanSet {
    let scale = placement.scale;
    let normals = has_normals.then(|| {
        let normal = |reading: &Reading| {
            // Normals of scanners are off by some degrees.
            let noisy = (reading.normal + 0.05 * normal_vector(rng)).normalize();
            let given = match condition {
                Condition::HalfFlippedNormals if rng.random() => -noisy,
                Condition::RandomNormals => normal_vector(rng).normalize(),
                _ => noisy,
            };
            placement.rotate(given)
        };
        readings.iter().map(normal).collect()
    });
    let per_reading = condition == Condition::NineDecades;
    let factor = if let Condition::MisstatedSigma(factor) = condition { factor } else { 1.0 };
    let sigma = factor * scale * readings[0].sigma;
    let sensor = Sensor {
        name: "sensor".to_owned(),
        noise: (stated && !per_reading).then_some(Noise::Isotropic { sigma }),
        ..Sensor::default()
    };
    let scan = Scan {
        name: "readings".to_owned(),
        points: readings.iter().map(|r| placement.place(r.point)).collect(),
        sigma: per_reading.then(|| readings.iter().map(|r| scale * r.sigma).collect()),
        normals,
        ..Scan::default()
    };
    single_scan(scan, sensor)
}

/// A set of one scan in millimetres.
pub fn single_scan(scan: Scan, sensor: Sensor) -> ScanSet {
    ScanSet {
        unit: Some(Unit::Millimetre),
        sensors: vec![sensor],
        scans: vec![PosedScan { scan, sensor: 0, sigma_translation: None, sigma_rotation_deg: None }],
        ..ScanSet::default()
    }
}
