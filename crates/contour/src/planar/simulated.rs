//! Simulated readings of a known contour.
//!
//! In: a kind with its true parameters, a sensor, a seed. Out: [`SimulatedReadings`], with and without
//! errors. The order of the random draws is part of the result: tests and examples depend on it.

use super::curve::{arc_circle, beyond, ends};
use super::kind::ContourKind;
use super::reading::{ContourReading, ContourTarget, PlanarMotion};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Number of poses in a row from which no beam may meet the contour. Beams aim at the contour, so that even a
/// fast object is met far more often.
const MAX_MISSES: usize = 1000;

/// Sensor and conditions of a simulated measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorOptions {
    /// Distance of the sensor from the centre of the contour.
    pub standoff: f64,
    /// σ of `x`, `y`, the heading (radians) and the constant part of the range error.
    pub sigma: [f64; 4],
    /// σ of the range as a fraction of the range, added to the constant part in quadrature.
    pub sigma_range_share: f64,
    /// Number of readings from each pose.
    pub sweep: usize,
    /// Fraction of outliers: ranges evenly distributed between half and twice the true range.
    pub outlier_share: f64,
    /// Velocity of the object, `vx vy ω` (length and radians per second), with rotation about the origin.
    pub velocity: [f64; 3],
    /// Readings per second.
    pub rate_hz: f64,
}

/// The same readings with and without errors. Both state the same σ.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SimulatedReadings {
    /// Readings with errors.
    pub noisy: Vec<ContourReading>,
    /// Readings without errors.
    pub exact: Vec<ContourReading>,
}

/// Simulates ranges to a closed contour from all around it.
///
/// Each ray aims at a random place of the outline, drawn evenly. The sensor stands within 25° of the
/// direction of that place as seen from `middle`, and reads the first intersection. A beam that meets nothing
/// is skipped, and another pose is drawn. If 1000 poses in a row meet nothing, as with an object that moves
/// away, the readings made so far are returned. The same seed gives the same readings. A line gives none.
///
/// # Examples
/// ```
/// use planish_contour::planar::{ContourKind, SensorOptions, ranges};
///
/// let sensor = SensorOptions::around(10.0, 0.1);
/// let simulated = ranges(&ContourKind::Circle, &[0.0, 0.0, 5.0], [0.0, 0.0], 50, &sensor, 3);
/// for reading in &simulated.exact {
///     let [x, y] = reading.point();
///     assert!((x.hypot(y) - 5.0).abs() < 1e-9);
/// }
/// ```
#[must_use]
pub fn ranges(
    kind: &ContourKind,
    theta: &[f64],
    middle: [f64; 2],
    count: usize,
    options: &SensorOptions,
    seed: u64,
) -> SimulatedReadings {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let Some(outline) = kind.outline(theta) else {
        return SimulatedReadings::default();
    };
    let places = along(kind, theta, &outline.vertices);
    // Only used for sweeps; single readings have poses of their own anyway.
    let mut made = SimulatedReadings::default();
    let mut pose = 0;
    let mut misses = 0;
    while made.exact.len() < count && misses < MAX_MISSES && !places.is_empty() {
        let before = made.exact.len();
        let aim = places[random.random_range(0..places.len())];
        let towards = (aim[1] - middle[1]).atan2(aim[0] - middle[0]) + random.random_range(-0.44..0.44);
        let origin =
            [middle[0] + options.standoff * towards.cos(), middle[1] + options.standoff * towards.sin()];
        // Errors of the pose are drawn once per sweep: its readings share them.
        let errors: [f64; 3] = [0; 3].map(|_: i32| random.sample(StandardNormal));
        let heading = (aim[1] - origin[1]).atan2(aim[0] - origin[0]);
        // The last sweep may be cut to reach exactly the requested number.
        let beams = options.sweep.max(1).min(count - made.exact.len());
        for beam in 0..beams {
            let fan = if beams > 1 { 0.35 * (beam as f64 / (beams - 1) as f64 - 0.5) } else { 0.0 };
            let heading = heading + fan;
            let time = made.exact.len() as f64 / options.rate_hz;
            // In the frame of the object, where it does not move.
            let turn = -options.velocity[2] * time;
            let (sin, cos) = turn.sin_cos();
            let shifted = [origin[0] - time * options.velocity[0], origin[1] - time * options.velocity[1]];
            let from = [cos * shifted[0] - sin * shifted[1], sin * shifted[0] + cos * shifted[1]];
            // Beams of a fan can miss the contour; the next pose makes up for them.
            let Some(range) = first_hit(kind, theta, from, heading + turn) else {
                continue;
            };
            let along = (options.sigma[3].powi(2) + (options.sigma_range_share * range).powi(2)).sqrt();
            let sigma = [options.sigma[0], options.sigma[1], options.sigma[2], along];
            let exact = ContourReading {
                target: ContourTarget::Range { origin, heading_rad: heading, range, sigma },
                pose: (options.sweep > 1).then_some(pose),
                time_s: time,
                line: made.exact.len() + 2,
            };
            let is_outlier = random.random::<f64>() < options.outlier_share;
            let error: f64 = random.sample(StandardNormal);
            let read =
                if is_outlier { range * random.random_range(0.5..2.0) } else { range + sigma[3] * error };
            made.noisy.push(ContourReading {
                target: ContourTarget::Range {
                    origin: [origin[0] + sigma[0] * errors[0], origin[1] + sigma[1] * errors[1]],
                    heading_rad: heading + sigma[2] * errors[2],
                    range: read,
                    sigma,
                },
                ..exact
            });
            made.exact.push(exact);
        }
        pose += 1;
        misses = if made.exact.len() > before { 0 } else { misses + 1 };
    }
    made
}

/// Simulates points of the outline, evenly distributed over its length, with an error of σ in each
/// coordinate.
#[must_use]
pub fn points(kind: &ContourKind, theta: &[f64], count: usize, sigma: f64, seed: u64) -> SimulatedReadings {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let Some(outline) = kind.outline(theta) else {
        return SimulatedReadings::default();
    };
    let places = along(kind, theta, &outline.vertices);
    let mut made = SimulatedReadings::default();
    for line in 0..count {
        let position = places[random.random_range(0..places.len())];
        let reading = |position| ContourReading {
            target: ContourTarget::Point { position, sigma },
            pose: None,
            time_s: 0.0,
            line: line + 2,
        };
        made.exact.push(reading(position));
        let noise = [0; 2].map(|_: i32| sigma * random.sample::<f64, _>(StandardNormal));
        made.noisy.push(reading([position[0] + noise[0], position[1] + noise[1]]));
    }
    made
}

/// About 4000 places spread evenly over the outline.
///
/// A random choice among them is a draw by arc length, without the inverse of an elliptic integral.
fn along(kind: &ContourKind, theta: &[f64], vertices: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let smooth = kind.pieces() == 1;
    let count = vertices.len();
    let bulge = |i: usize| if smooth { 0.0 } else { kind.bulge(theta, i).0 };
    let last = if kind.is_closed() { count } else { count - 1 };
    let lengths: Vec<f64> = (0..last)
        .map(|i| {
            let (a, b) = (vertices[i], vertices[(i + 1) % count]);
            let chord = (b[0] - a[0]).hypot(b[1] - a[1]);
            match bulge(i) {
                0.0 => chord,
                b => arc_circle(a, vertices[(i + 1) % count], b).1 * 4.0 * b.abs().atan(),
            }
        })
        .collect();
    let total: f64 = lengths.iter().sum();
    let mut places = Vec::new();
    for i in 0..last {
        let (a, b) = (vertices[i], vertices[(i + 1) % count]);
        // Midpoints of equal steps: no place lies on a vertex.
        let steps = (4000.0 * lengths[i] / total).ceil() as usize;
        for k in 0..steps {
            let t = (k as f64 + 0.5) / steps as f64;
            places.push(match bulge(i) {
                0.0 => [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])],
                bulge => {
                    let (c, _) = arc_circle(a, b, bulge);
                    let (sin, cos) = (4.0 * bulge.atan() * t).sin_cos();
                    let d = [a[0] - c[0], a[1] - c[1]];
                    [c[0] + cos * d[0] - sin * d[1], c[1] + sin * d[0] + cos * d[1]]
                }
            });
        }
    }
    places
}

/// Distance along a ray to its first intersection with the contour.
pub(crate) fn first_hit(kind: &ContourKind, theta: &[f64], from: [f64; 2], heading: f64) -> Option<f64> {
    let (sin, cos) = heading.sin_cos();
    let circle = |center: [f64; 2], radius: f64| {
        let d = [from[0] - center[0], from[1] - center[1]];
        quadratic(1.0, cos * d[0] + sin * d[1], d[0] * d[0] + d[1] * d[1] - radius * radius)
    };
    let hits: Vec<f64> = match kind {
        ContourKind::Line => Vec::new(),
        ContourKind::Circle => circle([theta[0], theta[1]], theta[2]),
        ContourKind::Ellipse => {
            let (s, c) = theta[4].sin_cos();
            let local = |v: [f64; 2]| [(c * v[0] + s * v[1]) / theta[2], (c * v[1] - s * v[0]) / theta[3]];
            // An affine map turns the ellipse into the unit circle and keeps the parameter of the ray.
            let (d, e) = (local([from[0] - theta[0], from[1] - theta[1]]), local([cos, sin]));
            quadratic(e[0] * e[0] + e[1] * e[1], d[0] * e[0] + d[1] * e[1], d[0] * d[0] + d[1] * d[1] - 1.0)
        }
        _ => (0..kind.pieces())
            .flat_map(|i| {
                let (from_vertex, to_vertex) = ends(kind, i);
                let (a, b) = (kind.vertex(theta, from_vertex), kind.vertex(theta, to_vertex));
                let bulge = kind.bulge(theta, i).0;
                let found = if bulge == 0.0 {
                    let e = [b[0] - a[0], b[1] - a[1]];
                    let cross = cos * e[1] - sin * e[0];
                    let d = [a[0] - from[0], a[1] - from[1]];
                    vec![(d[0] * e[1] - d[1] * e[0]) / cross]
                } else {
                    let (center, radius) = arc_circle(a, b, bulge);
                    circle(center, radius)
                };
                let size = (b[0] - a[0]).hypot(b[1] - a[1]);
                found.into_iter().filter(move |t| {
                    let p = [from[0] + t * cos, from[1] + t * sin];
                    // With a tolerance: a ray through a vertex must not slip between two pieces.
                    beyond(kind, theta, i, p) <= 1e-9 * size
                })
            })
            .collect(),
    };
    // Intersections behind the sensor do not count.
    hits.into_iter().filter(|t| *t > 0.0).min_by(f64::total_cmp)
}

/// Real roots of `a t² + 2 b t + c`.
fn quadratic(a: f64, b: f64, c: f64) -> Vec<f64> {
    let discriminant = b * b - a * c;
    if discriminant < 0.0 {
        return Vec::new();
    }
    let root = discriminant.sqrt();
    vec![(-b - root) / a, (-b + root) / a]
}

impl SensorOptions {
    /// A sensor at three times the size of the object, with typical errors multiplied by `noise`.
    ///
    /// σ of its position is 2 % of `size`, of its heading 2°, of the range 1 %. Each reading has its own
    /// pose, at 100 readings per second, and the object does not move.
    #[must_use]
    pub fn around(size: f64, noise: f64) -> Self {
        Self {
            standoff: 3.0 * size,
            sigma: [0.02 * size * noise, 0.02 * size * noise, 2f64.to_radians() * noise, 0.0],
            sigma_range_share: 0.01 * noise,
            sweep: 1,
            outlier_share: 0.0,
            velocity: [0.0; 3],
            rate_hz: 100.0,
        }
    }

    /// The motion model that a fit of these readings needs.
    #[must_use]
    pub fn motion(&self) -> PlanarMotion {
        match self.velocity {
            [0.0, 0.0, 0.0] => PlanarMotion::Still,
            [_, _, 0.0] => PlanarMotion::Linear,
            _ => PlanarMotion::Rigid,
        }
    }
}
