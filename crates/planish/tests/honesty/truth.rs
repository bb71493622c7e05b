//! True surfaces: zeros of functions, with the exact distance of a point from them.
//!
//! Input: a seed. Output: a surface from which points are drawn uniformly by area, and to which distances
//! are measured. Everything is computed from the function alone, without code of the program.

use planish_core::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

/// Points are drawn from a layer of this half thickness about the surface and moved onto it. The layer's
/// volume is proportional to the area, up to the square of thickness times curvature.
const LAYER: f64 = 0.02;

/// A surface within the cube of half side [`TrueSurface::half_side`] about the origin.
pub trait TrueSurface: Sync {
    /// A function that is zero on the surface, and positive outside of a closed one.
    fn value(&self, p: DVec3) -> f64;

    /// Half the side of a cube that contains the surface.
    fn half_side(&self) -> f64;

    /// How far a point of the surface's continuation lies beyond its rim; not positive on the surface itself
    /// and for closed surfaces.
    fn beyond_rim(&self, _p: DVec3) -> f64 {
        f64::NEG_INFINITY
    }

    /// Gradient of [`TrueSurface::value`], by central differences.
    fn gradient(&self, p: DVec3) -> DVec3 {
        let step = 1e-5;
        let along = |axis: DVec3| self.value(p + step * axis) - self.value(p - step * axis);
        DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z)) / (2.0 * step)
    }

    /// Unit normal, outwards for closed surfaces.
    fn normal(&self, p: DVec3) -> DVec3 {
        self.gradient(p).normalize_or_zero()
    }

    /// The point of the surface that Newton's steps along the gradient reach from `p`.
    fn onto(&self, p: DVec3) -> Option<DVec3> {
        let mut q = p;
        for _ in 0..20 {
            let g = self.gradient(q);
            let step = self.value(q) / g.length_squared().max(1e-12) * g;
            q -= step;
            if step.length() < 1e-13 {
                break;
            }
        }
        (self.value(q).abs() < 1e-9).then_some(q)
    }

    /// The foot point of `p`: a point of the surface or its continuation whose normal passes through `p`.
    fn foot_from(&self, p: DVec3, start: DVec3) -> Option<DVec3> {
        let mut q = start;
        for _ in 0..30 {
            let g = self.gradient(q);
            let t = p - q;
            let next = q + t - (self.value(q) + t.dot(g)) / g.length_squared().max(1e-12) * g;
            let moved = (next - q).length();
            q = next;
            if moved < 1e-12 {
                break;
            }
        }
        self.onto(q)
    }
}

/// Points of a true surface, and what follows from their number.
pub struct SurfaceSample {
    /// Points, uniform by area.
    pub points: Vec<DVec3>,
    /// Estimated area of the surface.
    pub area: f64,
}

/// Draws points of a surface, uniform by area times `density` (at most 1).
pub fn sample_surface(
    surface: &dyn TrueSurface,
    count: usize,
    density: impl Fn(DVec3) -> f64,
    rng: &mut ChaCha8Rng,
) -> SurfaceSample {
    let half = surface.half_side();
    let (mut points, mut tried, mut on_surface) = (Vec::with_capacity(count), 0_u64, 0_u64);
    while points.len() < count {
        tried += 1;
        let p = DVec3::from_array([0; 3].map(|_| rng.random_range(-half..half)));
        let value = surface.value(p);
        if value.abs() > 20.0 * LAYER || value.abs() > LAYER * surface.gradient(p).length() {
            continue;
        }
        let Some(q) = surface.onto(p) else { continue };
        if surface.beyond_rim(q) > 0.0 {
            continue;
        }
        on_surface += 1;
        if rng.random::<f64>() < density(q) {
            points.push(q);
        }
    }
    let volume = (2.0 * half).powi(3) * on_surface as f64 / tried as f64;
    SurfaceSample { points, area: volume / (2.0 * LAYER) }
}

/// The topology of a smooth object of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Topology {
    Sheet,
    Tube,
    Ball,
    Torus,
}

impl Topology {
    pub const ALL: [Self; 4] = [Self::Sheet, Self::Tube, Self::Ball, Self::Torus];

    pub fn name(self) -> &'static str {
        match self {
            Self::Sheet => "sheet",
            Self::Tube => "tube",
            Self::Ball => "ball",
            Self::Torus => "torus",
        }
    }
}

/// A wave over the coordinates of a base shape.
struct Wave {
    vector: [f64; 4],
    amplitude: f64,
    phase: f64,
}

/// A sheet, tube, ball or torus of size 1, displaced by random waves of low frequency.
///
/// The waves are functions of the base's own coordinates: `(x, y)` of a sheet, the unit direction of a ball,
/// sines and cosines of the angles of tubes and tori. So they close up without a seam.
pub struct SmoothObject {
    topology: Topology,
    waves: Vec<Wave>,
    /// Half length of a tube; minor radius of a torus.
    proportion: f64,
    /// Sum of the amplitudes: the displacement is smaller than that.
    max_displacement: f64,
}

impl SmoothObject {
    pub fn random(topology: Topology, rng: &mut ChaCha8Rng) -> Self {
        // From nearly the plain shape to displacements of about a tenth of the size, as parts and stones
        // have.
        let strength = 10_f64.powf(rng.random_range(-2.3..-1.3));
        let waves: Vec<Wave> = (0..9)
            .map(|_| {
                let mut normal = || -> f64 { StandardNormal.sample(rng) };
                let vector = [0; 4].map(|_| 1.3 * normal());
                let amplitude = strength * normal();
                Wave { vector, amplitude, phase: rng.random_range(0.0..TAU) }
            })
            .collect();
        let proportion = match topology {
            Topology::Tube => rng.random_range(0.7..1.3),
            _ => rng.random_range(0.3..0.45),
        };
        let max_displacement = waves.iter().map(|w| w.amplitude.abs()).sum();
        Self { topology, waves, proportion, max_displacement }
    }

    /// Half of the smallest radius of a closed section; 1 for a sheet. Points that are displaced by less
    /// along the normals do not gather at a centre or an axis, where they would be dense like a surface.
    pub fn half_thickness(&self) -> f64 {
        match self.topology {
            Topology::Sheet => 1.0,
            Topology::Tube => 0.25,
            Topology::Ball => 0.5,
            Topology::Torus => 0.5 * self.proportion,
        }
    }

    fn displacement(&self, at: [f64; 4]) -> f64 {
        let phase_of = |w: &Wave| w.vector.iter().zip(at).map(|(k, q)| k * q).sum::<f64>() + w.phase;
        self.waves.iter().map(|w| w.amplitude * phase_of(w).sin()).sum()
    }
}

impl TrueSurface for SmoothObject {
    fn value(&self, p: DVec3) -> f64 {
        let DVec3 { x, y, z } = p;
        let rho = x.hypot(y).max(1e-12);
        match self.topology {
            Topology::Sheet => z - self.displacement([x, y, 0.0, 0.0]),
            Topology::Tube => rho - 0.5 * (1.0 + self.displacement([x / rho, y / rho, z, 0.0])),
            Topology::Ball => {
                let length = p.length().max(1e-12);
                length - 1.0 - self.displacement([x / length, y / length, z / length, 0.0])
            }
            Topology::Torus => {
                let from_core = (rho - 1.0).hypot(z).max(1e-12);
                let along = [x / rho, y / rho, (rho - 1.0) / from_core, z / from_core];
                from_core - self.proportion * (1.0 + self.displacement(along))
            }
        }
    }

    fn half_side(&self) -> f64 {
        let largest = 1.0 + self.max_displacement;
        2.0 * LAYER
            + match self.topology {
                Topology::Sheet | Topology::Ball => largest,
                Topology::Tube => self.proportion.max(0.5 * largest),
                Topology::Torus => 1.0 + self.proportion * largest,
            }
    }

    fn beyond_rim(&self, p: DVec3) -> f64 {
        match self.topology {
            Topology::Sheet => p.x.abs().max(p.y.abs()) - 1.0,
            Topology::Tube => p.z.abs() - self.proportion,
            Topology::Ball | Topology::Torus => f64::NEG_INFINITY,
        }
    }
}

/// A random position, orientation and unit: the fit sees the object in this frame.
#[derive(Debug, Clone)]
pub struct Placement {
    axes: [DVec3; 3],
    origin: DVec3,
    pub scale: f64,
}

impl Placement {
    pub fn random(rng: &mut ChaCha8Rng) -> Self {
        let mut direction = || {
            let c = [0; 3].map(|_| Distribution::<f64>::sample(&StandardNormal, rng));
            DVec3::from_array(c).normalize()
        };
        let x = direction();
        let y = direction().cross(x).normalize();
        let axes = [x, y, x.cross(y)];
        let scale = 10_f64.powf(rng.random_range(0.0..2.0));
        let origin = DVec3::from_array([0; 3].map(|_| scale * rng.random_range(-3.0..3.0)));
        Self { axes, origin, scale }
    }

    pub fn place(&self, p: DVec3) -> DVec3 {
        self.origin + self.scale * self.rotate(p)
    }

    pub fn rotate(&self, d: DVec3) -> DVec3 {
        d.x * self.axes[0] + d.y * self.axes[1] + d.z * self.axes[2]
    }

    pub fn back(&self, p: DVec3) -> DVec3 {
        let t = (p - self.origin) / self.scale;
        DVec3::from_array(self.axes.map(|axis| axis.dot(t)))
    }
}

/// A generator of random numbers that depends on a name and a seed.
pub fn rng_of(name: &str, seed: u64) -> ChaCha8Rng {
    // FNV-1a: the order and number of cells do not change the draws of a cell.
    let hash = name
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    ChaCha8Rng::seed_from_u64(hash.wrapping_add(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
}

/// Signed distance of points from a surface, by foot points from several starts.
pub struct Distances<'a> {
    surface: &'a dyn TrueSurface,
    starts: Vec<DVec3>,
}

impl<'a> Distances<'a> {
    pub fn new(surface: &'a dyn TrueSurface, rng: &mut ChaCha8Rng) -> Self {
        Self { surface, starts: sample_surface(surface, 800, |_| 1.0, rng).points }
    }

    /// Signed distance of `p`, and its foot point.
    pub fn of(&self, p: DVec3) -> (f64, DVec3) {
        let nearest = self
            .starts
            .iter()
            .copied()
            .min_by(|a, b| (*a - p).length_squared().total_cmp(&(*b - p).length_squared()));
        let nearest = nearest.unwrap();
        // The point of the sample is itself a point of the surface: its distance is an upper bound, also
        // where Newton's steps do not converge.
        let feet = [p, nearest].into_iter().filter_map(|start| self.surface.foot_from(p, start));
        let foot = feet.chain([nearest]).min_by(|a, b| (*a - p).length().total_cmp(&(*b - p).length()));
        let foot = foot.unwrap();
        let sign = if self.surface.value(p) < 0.0 { -1.0 } else { 1.0 };
        (sign * (foot - p).length(), foot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reference that errs would make honest fits look wrong, or the reverse.
    #[test]
    fn distances_from_each_object_are_exact() {
        for topology in Topology::ALL {
            for seed in 0..3 {
                let mut rng = rng_of(topology.name(), seed);
                let object = SmoothObject::random(topology, &mut rng);
                let placement = Placement::random(&mut rng);
                let sample = sample_surface(&object, 200, |_| 1.0, &mut rng);
                let distances = Distances::new(&object, &mut rng);
                for &p in &sample.points {
                    assert!(object.value(p).abs() < 1e-9);
                    let height = rng.random_range(-0.05..0.05);
                    let moved = placement.place(p + height * object.normal(p));
                    let (found, foot) = distances.of(placement.back(moved));
                    assert!((found - height).abs() < 1e-7, "{topology:?}: {found} instead of {height}");
                    assert!((foot - p).length() < 1e-5, "{topology:?}");
                }
            }
        }
    }

    #[test]
    fn areas_of_samples_are_those_of_the_surface() {
        let mut rng = rng_of("areas", 0);
        let flat = |topology, proportion| SmoothObject {
            topology,
            waves: Vec::new(),
            proportion,
            max_displacement: 0.0,
        };
        let pi = std::f64::consts::PI;
        for (topology, proportion, area) in [
            (Topology::Sheet, 0.4, 4.0),
            (Topology::Tube, 0.8, 2.0 * pi * 0.5 * 1.6),
            (Topology::Ball, 0.4, 4.0 * pi),
            (Topology::Torus, 0.4, 4.0 * pi * pi * 0.4),
        ] {
            let found = sample_surface(&flat(topology, proportion), 4000, |_| 1.0, &mut rng).area;
            // The number of accepted points varies by 1.6 %.
            assert!((found / area - 1.0).abs() < 0.07, "{topology:?}: {found} instead of {area}");
        }
    }
}
