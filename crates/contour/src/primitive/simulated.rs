//! Simulated rays to known shapes.

use super::ray::{Ray, RayTarget};
use super::shape::PrimitiveKind;
use nalgebra::{Rotation3, Vector3};
use planish_core::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// A shape to simulate: kind, centre, rotation and sizes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedPrimitive {
    /// Kind of the shape.
    pub shape: PrimitiveKind,
    /// Centre of the shape.
    pub center: DVec3,
    /// Rotation vector (radians), world from the axes of the shape. The third axis is the normal of a plane
    /// and the axis of a cylinder.
    pub turn: DVec3,
    /// Sizes. Box: length, width, height. Sphere: radius. Cylinder: radius, observed length. Plane: the two
    /// sides of the observed rectangle. Further values are ignored.
    pub size: [f64; 3],
}

/// Sensor of a simulated measurement in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceSensor {
    /// Distance of the sensor from the centre of the shape.
    pub standoff: f64,
    /// σ of each coordinate of the sensor.
    pub sigma_position: f64,
    /// σ of azimuth and elevation, in radians.
    pub sigma_angle_rad: f64,
    /// σ of the range as a fraction of the range.
    pub sigma_range_share: f64,
}

/// The same rays with and without errors. Both state the same σ.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SimulatedRays {
    /// Rays with errors.
    pub noisy: Vec<Ray>,
    /// Rays without errors.
    pub exact: Vec<Ray>,
}

impl SimulatedPrimitive {
    /// True parameters in the order of [`PrimitiveKind::names`]. The point of a cylinder is its centre.
    #[must_use]
    pub fn parameters(&self) -> Vec<f64> {
        let r = self.rotation();
        let axis = |k: usize| {
            let n = r.matrix().column(k).into_owned();
            // The sign convention of the fit, so that both can be compared.
            if n[n.iamax()] < 0.0 { -n } else { n }
        };
        let mut values = self.center.to_array().to_vec();
        match self.shape {
            PrimitiveKind::Plane => {
                let n = axis(2);
                values = vec![n.x, n.y, n.z, n.dot(&Vector3::from(self.center))];
            }
            PrimitiveKind::Sphere => values.push(self.size[0]),
            PrimitiveKind::Cylinder => {
                values.extend(axis(2).iter());
                values.push(self.size[0]);
            }
            PrimitiveKind::Box => {
                let mut order = [0, 1, 2];
                order.sort_by(|&a: &usize, &b: &usize| self.size[b].total_cmp(&self.size[a]));
                values.extend(order.map(|k| self.size[k]));
                for k in order {
                    values.extend(axis(k).iter());
                }
            }
        }
        values
    }

    fn rotation(&self) -> Rotation3<f64> {
        Rotation3::new(Vector3::from(self.turn))
    }

    /// A place drawn evenly from the surface, and the outward normal there, in the axes of the shape.
    fn draw(&self, random: &mut ChaCha8Rng) -> (Vector3<f64>, Vector3<f64>) {
        let mut side = |length: f64| length * random.random_range(-0.5..0.5);
        match self.shape {
            PrimitiveKind::Plane => (Vector3::new(side(self.size[0]), side(self.size[1]), 0.0), Vector3::z()),
            PrimitiveKind::Sphere => {
                // Archimedes: the area of a sphere between two parallels depends on their distance only.
                let z: f64 = side(2.0);
                let (sin, cos) = side(std::f64::consts::TAU).sin_cos();
                let across = (1.0 - z * z).sqrt();
                let n = Vector3::new(across * cos, across * sin, z);
                (n * self.size[0], n)
            }
            PrimitiveKind::Cylinder => {
                let (sin, cos) = side(std::f64::consts::TAU).sin_cos();
                let n = Vector3::new(cos, sin, 0.0);
                (n * self.size[0] + Vector3::z() * side(self.size[1]), n)
            }
            PrimitiveKind::Box => {
                let [a, b, c] = self.size;
                // A side in proportion to its area.
                let at = random.random_range(0.0..b * c + a * c + a * b);
                let axis = usize::from(at > b * c) + usize::from(at > b * c + a * c);
                let sign = if random.random::<bool>() { 1.0 } else { -1.0 };
                let mut p = Vector3::from(self.size.map(|length| length * random.random_range(-0.5..0.5)));
                p[axis] = 0.5 * sign * self.size[axis];
                (p, Vector3::ith(axis, sign))
            }
        }
    }
}

/// Simulates rays to a shape from all around it.
///
/// Each ray aims at a place drawn evenly from the surface and comes from within 35° of the normal there. The
/// shapes are convex, so that this place is the first intersection. The same seed gives the same rays.
#[must_use]
pub fn rays(solid: &SimulatedPrimitive, count: usize, sensor: &SpaceSensor, seed: u64) -> SimulatedRays {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut made = SimulatedRays::default();
    let (rotation, center) = (solid.rotation(), Vector3::from(solid.center));
    for line in 0..count {
        let (place, normal) = solid.draw(&mut random);
        // The square root spreads directions evenly over the cone.
        let tilt = (0.61 * random.random::<f64>().sqrt(), std::f64::consts::TAU * random.random::<f64>());
        let first = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
        let second = normal.cross(&first);
        let back = normal * tilt.0.cos() + (first * tilt.1.cos() + second * tilt.1.sin()) * tilt.0.sin();
        let place = center + rotation * place;
        // The standoff is measured from the centre, but the sensor must stay outside of the shape.
        let range = sensor.standoff - (place - center).norm().min(0.9 * sensor.standoff);
        let origin = place + rotation * back * range;
        let towards = place - origin;
        let direction_rad = [towards.y.atan2(towards.x), towards.z.atan2(towards.x.hypot(towards.y))];
        let sigma_range = sensor.sigma_range_share * range;
        let [position, angle] = [sensor.sigma_position, sensor.sigma_angle_rad];
        let sigma = [position, position, position, angle, angle, sigma_range];
        let mut error = |sigma: f64| sigma * random.sample::<f64, _>(StandardNormal);
        let noisy = RayTarget::Range {
            origin: DVec3::from_array([0, 1, 2].map(|k| origin[k] + error(position))),
            direction_rad: direction_rad.map(|d| d + error(angle)),
            range: range + error(sigma_range),
            sigma,
        };
        let exact = RayTarget::Range { origin: origin.into(), direction_rad, range, sigma };
        made.noisy.push(Ray { target: noisy, line: line + 2 });
        made.exact.push(Ray { target: exact, line: line + 2 });
    }
    made
}
