//! Objects that a sheet, tube, ball or torus does not represent, or only in part: handles, holes, edges, thin
//! walls, several bodies. All have a size of about 1.

use crate::truth::{SmoothObject, Topology, TrueSurface};
use planish_core::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::path::Path;

/// A solid given by a signed distance (or a bound of it) that is positive outside.
///
/// # References
/// Signed distances of boxes, cylinders and tori: Hart, Sphere tracing, The Visual Computer 12, 1996,
/// appendix A. Union and difference are minimum and maximum of distances, which keeps the zero exact.
pub struct Solid {
    distance: Box<dyn Fn(DVec3) -> f64 + Sync>,
    half_side: f64,
}

impl TrueSurface for Solid {
    fn value(&self, p: DVec3) -> f64 {
        (self.distance)(p)
    }

    fn half_side(&self) -> f64 {
        self.half_side
    }
}

fn box_distance(p: DVec3, half: DVec3) -> f64 {
    let q = p.abs() - half;
    q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
}

fn cylinder_distance(p: DVec3, radius: f64, half_length: f64) -> f64 {
    let (across, along) = (p.x.hypot(p.y) - radius, p.z.abs() - half_length);
    across.max(0.0).hypot(along.max(0.0)) + across.max(along).min(0.0)
}

fn torus_distance(p: DVec3, major: f64, minor: f64) -> f64 {
    (p.x.hypot(p.y) - major).hypot(p.z) - minor
}

/// Minimum of two distances, rounded where they differ by less than `blend`, so that the union is smooth.
fn smooth_minimum(a: f64, b: f64, blend: f64) -> f64 {
    let h = (blend - (a - b).abs()).max(0.0) / blend;
    a.min(b) - 0.25 * blend * h * h
}

fn solid(half_side: f64, distance: impl Fn(DVec3) -> f64 + Sync + 'static) -> Box<dyn TrueSurface> {
    Box::new(Solid { distance: Box::new(distance), half_side })
}

/// A smooth torus, displaced by random waves.
pub fn torus(rng: &mut ChaCha8Rng) -> Box<dyn TrueSurface> {
    Box::new(SmoothObject::random(Topology::Torus, rng))
}

/// Two tori side by side that share a wall: genus 2.
pub fn genus_two(rng: &mut ChaCha8Rng) -> Box<dyn TrueSurface> {
    let minor = rng.random_range(0.15..0.22);
    let half_gap = 0.55;
    solid(1.4, move |p| {
        let at = |side: f64| torus_distance(p - side * half_gap * DVec3::X, 0.5, minor);
        smooth_minimum(at(-1.0), at(1.0), 0.1)
    })
}

/// A plate with a round hole: genus 1, with edges and a thin wall.
pub fn plate_with_hole(rng: &mut ChaCha8Rng) -> Box<dyn TrueSurface> {
    let half = DVec3::new(1.0, rng.random_range(0.6..0.9), rng.random_range(0.05..0.1));
    let radius = rng.random_range(0.2..0.4);
    solid(1.1, move |p| box_distance(p, half).max(-cylinder_distance(p, radius, 1.0)))
}

/// A cup with a handle: genus 1, with a thin wall and a rim.
pub fn cup(rng: &mut ChaCha8Rng) -> Box<dyn TrueSurface> {
    let wall = rng.random_range(0.05..0.09);
    let radius = 0.6;
    solid(1.2, move |p| {
        let outside = cylinder_distance(p, radius, 0.8);
        let inside = cylinder_distance(p - 2.0 * wall * DVec3::Z, radius - wall, 0.8);
        // The handle is the part of a torus in the plane x, z that is outside of the cup's wall.
        let turned = DVec3::new(p.x - radius, p.z, p.y);
        let handle = torus_distance(turned, 0.38, 0.08).max(-cylinder_distance(p, radius - 0.5 * wall, 2.0));
        outside.max(-inside).min(handle)
    })
}

/// A box with sharp edges.
pub fn sharp_box(rng: &mut ChaCha8Rng) -> Box<dyn TrueSurface> {
    let half = DVec3::new(0.9, rng.random_range(0.4..0.8), rng.random_range(0.4..0.8));
    solid(1.0, move |p| box_distance(p, half))
}

/// A pipe along more than half of a ring, open at both ends.
struct BentPipe {
    radius: f64,
    half_angle: f64,
}

impl TrueSurface for BentPipe {
    fn value(&self, p: DVec3) -> f64 {
        torus_distance(p, 0.7, self.radius)
    }

    fn half_side(&self) -> f64 {
        1.0
    }

    fn beyond_rim(&self, p: DVec3) -> f64 {
        0.7 * (p.y.atan2(p.x).abs() - self.half_angle)
    }
}

/// A bent pipe of 230° to 300°.
pub fn bent_pipe(rng: &mut ChaCha8Rng) -> Box<dyn TrueSurface> {
    let half_angle = rng.random_range(115.0_f64..150.0).to_radians();
    Box::new(BentPipe { radius: rng.random_range(0.15..0.22), half_angle })
}

/// Two balls of different radius that do not touch.
pub fn two_bodies(rng: &mut ChaCha8Rng) -> Box<dyn TrueSurface> {
    let radius = rng.random_range(0.35..0.45);
    solid(1.2, move |p| {
        let first = (p - 0.5 * DVec3::X).length() - 0.4;
        first.min((p + 0.6 * DVec3::X).length() - radius)
    })
}

/// A closed triangle mesh of half size 1, as a true surface.
pub struct MeshSolid {
    triangles: Vec<[DVec3; 3]>,
    /// Centre and radius of a sphere about each triangle.
    bounds: Vec<(DVec3, f64)>,
    cumulative_area: Vec<f64>,
}

impl MeshSolid {
    /// Reads a mesh and scales it to half size 1; none if the file is not there.
    pub fn read(path: &Path) -> Option<Self> {
        if !path.is_file() {
            println!("skipped: {} does not exist", path.display());
            return None;
        }
        let file = planish_exchange::mesh::read_mesh(path).unwrap();
        let (low, high) = (file.points.iter())
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
        let (centre, half) = (0.5 * (low + high), 0.5 * (high - low).max_element());
        let triangles: Vec<[DVec3; 3]> =
            (file.triangles.iter()).map(|t| t.map(|i| (file.points[i as usize] - centre) / half)).collect();
        let bounds = (triangles.iter())
            .map(|t| {
                let middle = (t[0] + t[1] + t[2]) / 3.0;
                (middle, t.iter().map(|p| (*p - middle).length()).fold(0.0, f64::max))
            })
            .collect();
        let mut total = 0.0;
        let cumulative_area = (triangles.iter())
            .map(|[a, b, c]| {
                total += 0.5 * (*b - *a).cross(*c - *a).length();
                total
            })
            .collect();
        Some(Self { triangles, bounds, cumulative_area })
    }

    pub fn area(&self) -> f64 {
        self.cumulative_area.last().copied().unwrap()
    }

    /// A point drawn by area, with the normal of its triangle.
    pub fn draw(&self, rng: &mut ChaCha8Rng) -> (DVec3, DVec3) {
        let at = rng.random::<f64>() * self.area();
        let index = self.cumulative_area.partition_point(|c| *c < at).min(self.triangles.len() - 1);
        let [a, b, c] = self.triangles[index];
        let (mut u, mut v): (f64, f64) = (rng.random(), rng.random());
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        (a + u * (b - a) + v * (c - a), (b - a).cross(c - a).normalize_or_zero())
    }

    /// Distance of a point from the nearest triangle.
    pub fn distance(&self, p: DVec3) -> f64 {
        let mut nearest = f64::INFINITY;
        for (t, (middle, radius)) in self.triangles.iter().zip(&self.bounds) {
            if (p - *middle).length() - radius < nearest {
                nearest = nearest.min(triangle_distance(p, t));
            }
        }
        nearest
    }
}

/// Distance of a point from a triangle: from its plane if the foot point is inside, else from its edges.
fn triangle_distance(p: DVec3, [a, b, c]: &[DVec3; 3]) -> f64 {
    let normal = (*b - *a).cross(*c - *a);
    let edges = [(*a, *b), (*b, *c), (*c, *a)];
    let inside = edges.iter().all(|(s, e)| (*e - *s).cross(p - *s).dot(normal) >= 0.0);
    if inside && normal.length() > 0.0 {
        return (p - *a).dot(normal).abs() / normal.length();
    }
    let to_edge = |(s, e): (DVec3, DVec3)| {
        let along = e - s;
        let t = ((p - s).dot(along) / along.length_squared().max(1e-300)).clamp(0.0, 1.0);
        (p - s - t * along).length()
    };
    edges.into_iter().map(to_edge).fold(f64::INFINITY, f64::min)
}
