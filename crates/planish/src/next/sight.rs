//! Visibility of a model for a sensor at a pose.
//!
//! Input: a model and a sensor. Output: whether a place is visible, all readings of a pose, and candidate
//! poses.
//!
//! A place is visible if it is in the field of view and in range, faces the sensor with its outer side (the
//! side of the normal) at no more than the maximum incidence angle, and is not occluded by the model. Rays
//! are traced against a tessellation of the model.
//!
//! Not guaranteed: obstacles that are not in the model, such as a table, are unknown. The roll of a pose
//! about its axis is not optimised.

use super::Place;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{BoundingBox, MeshSearch, TriangleMesh};
use planish_sense::{Pose, ViewSensor};
use planish_spline::{
    FootPointSearch, ProjectionOptions, Surface, TessellationOptions, leaf_weights, tessellate,
};
use planish_surface::export::affordable_tolerance;
use planish_surface::model::SurfaceModel;
use rayon::prelude::*;

/// A reading on a leaf: weights of its coefficients, direction, value and information.
type SeenRow = ([f64; 16], DVec3, f64, f64);

/// Chord error of the tessellation relative to the diagonal. The limit of triangles may make it larger. A
/// coarser mesh hides places just behind its chords.
const CHORD: f64 = 1e-4;
const MAX_TRIANGLES: u64 = 400_000;
/// Maximum number of rays per pose. For larger sensors, each ray represents several.
const MAX_RAYS: usize = 1 << 20;
/// Directions about a target. More find better poses; the cost grows in proportion.
const DIRECTIONS: usize = 60;
/// Number of distances of candidate poses to a target, in geometric progression.
const DISTANCES: usize = 4;
/// Number of targets besides the centre of the region.
const TARGETS: usize = 24;
/// The angle between neighbours of Fibonacci's spiral.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// A reading of a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reading {
    pub(super) leaf: u32,
    pub(super) local: [f64; 2],
    pub(super) point: DVec3,
    pub(super) normal: DVec3,
    /// Along the normal.
    pub(super) variance: f64,
    /// Along the ray.
    pub(super) sigma_along: f64,
}

/// All readings of a pose, and the number of rays that each represents.
pub(super) struct Readings {
    pub(super) readings: Vec<Reading>,
    pub(super) rays_per_reading: f64,
}

impl Readings {
    /// The readings of every leaf: row over its coefficients, direction, value and information.
    pub(super) fn by_leaf(&self, leaves: usize) -> Vec<Vec<SeenRow>> {
        let mut of_leaf = vec![Vec::new(); leaves];
        for r in &self.readings {
            let weights = leaf_weights(r.local[0], r.local[1]);
            let information = self.rays_per_reading / r.variance;
            of_leaf[r.leaf as usize].push((weights, r.normal, r.normal.dot(r.point), information));
        }
        of_leaf
    }
}

/// A model before a sensor.
pub(super) struct Sight<'a> {
    surface: &'a Surface,
    sensor: &'a ViewSensor,
    mesh: MeshSearch,
    bounds: BoundingBox,
    feet: FootPointSearch,
    /// Distance from its end within which a line of sight may touch the tessellation.
    clearance: f64,
}

impl<'a> Sight<'a> {
    pub(super) fn new(model: &'a SurfaceModel, sensor: &'a ViewSensor) -> Result<Self> {
        let surface = &model.surface;
        let bounds = BoundingBox::from_points(surface.vertices())
            .filter(|b| b.diagonal() > 0.0)
            .ok_or_else(|| Error::undetermined("expected a model with an extent, found a single point"))?;
        let tolerance = affordable_tolerance(surface, CHORD * bounds.diagonal(), MAX_TRIANGLES)?;
        let made = tessellate(surface, &TessellationOptions { tolerance, ..TessellationOptions::default() })?;
        Ok(Self {
            surface,
            sensor,
            mesh: MeshSearch::try_new(&TriangleMesh::try_new(made.positions, made.triangles)?)?,
            bounds,
            // Opposite sides of a thin part are as far apart as the whole.
            feet: FootPointSearch::new(surface, 3, 0.5 * bounds.diagonal())?,
            // At a grazing angle, a chord error along the normal is a longer distance along the ray.
            clearance: 2.0 * tolerance / sensor.max_incidence_rad.cos(),
        })
    }

    /// Coordinates of a visible place in the sensor's frame, and the cosine of its incidence angle.
    pub(super) fn visible_coordinates(&self, pose: &Pose, place: &Place) -> Option<(DVec3, f64)> {
        let local = pose.inverse().apply(place.position);
        // Cheap tests first. The line of sight costs most and is evaluated last.
        if !self.sensor.reaches(local) {
            return None;
        }
        let ray = (place.position - pose.translation).try_normalize()?;
        let cosine = -ray.dot(place.normal);
        let open = || self.mesh.is_unobstructed(pose.translation, place.position, self.clearance);
        (self.sensor.accepts(cosine) && open()).then_some((local, cosine))
    }

    /// All readings of the sensor at a pose, row by row.
    pub(super) fn readings(&self, pose: &Pose) -> Readings {
        let all = self.sensor.rays;
        // Fewer rays of more information each: sums over neighbouring rays stay the same.
        let thinner = ((all[0] * all[1]) as f64 / MAX_RAYS as f64).sqrt().max(1.0);
        let cast = all.map(|n| ((n as f64 / thinner) as usize).max(1));
        let readings = (0..cast[1])
            .into_par_iter()
            .flat_map_iter(|row| {
                (0..cast[0]).filter_map(move |column| {
                    let share = [column, row].map(|k| k as f64 + 0.5);
                    let share = [share[0] / cast[0] as f64, share[1] / cast[1] as f64];
                    self.reading(pose.translation, pose.rotate(self.sensor.direction(share)))
                })
            })
            .collect();
        Readings { readings, rays_per_reading: (all[0] * all[1]) as f64 / (cast[0] * cast[1]) as f64 }
    }

    fn reading(&self, origin: DVec3, ray: DVec3) -> Option<Reading> {
        let [near, far] = self.sensor.range;
        let hit = self.mesh.first_hit_between(origin, ray, 0.0, far)?;
        // A hit from behind ends the ray as well: the surface is opaque.
        if hit.distance < near || hit.normal.dot(ray) >= 0.0 {
            return None;
        }
        let start = self.feet.nearest(hit.point, hit.normal);
        let foot = self.surface.project(hit.point, start, &ProjectionOptions::default());
        let cosine = -ray.dot(foot.normal);
        let found = foot.converged && foot.jet.point.distance(hit.point) <= self.clearance;
        (found && self.sensor.accepts(cosine)).then(|| Reading {
            leaf: foot.leaf,
            local: foot.local,
            point: foot.jet.point,
            normal: foot.normal,
            variance: self.sensor.variance_along_normal(hit.distance, cosine),
            sigma_along: self.sensor.noise(hit.distance, cosine),
        })
    }

    /// Candidate poses from all directions at feasible distances. They face some of the places or the centre
    /// of all. No part of the model is nearer than the minimum range.
    pub(super) fn poses(&self, places: &[Place], representatives: &[usize]) -> Vec<Pose> {
        let [near, far] = self.sensor.range;
        let radius = 0.5 * self.bounds.diagonal();
        // Beyond 1.5 times the distance at which the whole object fits into the field of view, readings only
        // become sparser.
        let widest = (self.sensor.borders.iter()).map(|[low, high]| 0.5 * (high - low));
        let fits = 1.5 * radius / widest.fold(f64::INFINITY, f64::min);
        // A margin, so that rounding does not put a pose out of range.
        let nearest = 1.02 * near;
        let farthest = (0.98 * far).min(fits.max(1.2 * nearest)).max(nearest);
        let step = (farthest / nearest).powf(1.0 / (DISTANCES - 1) as f64);
        let distances: Vec<f64> = (0..DISTANCES as i32).map(|k| nearest * step.powi(k)).collect();
        let middle = self.bounds.center();
        let mut wanted = Vec::new();
        for towards in sphere() {
            // Distances count from the surface, so the radius is added for targets at the centre.
            wanted.extend(distances.iter().map(|d| (middle, towards, (d + radius).min(0.98 * far))));
        }
        for target in spread(places, representatives) {
            let Place { position, normal, .. } = places[target];
            let seen = sphere().filter(|towards| self.sensor.accepts(towards.dot(normal)));
            for towards in std::iter::once(normal).chain(seen) {
                wanted.extend(distances.iter().map(|d| (position, towards, *d)));
            }
        }
        (wanted.par_iter())
            .filter_map(|&(target, towards, far)| {
                let origin = target + far * towards;
                let free = self.mesh.closest_within(origin, near).is_none();
                if free { pose_looking_along(origin, -towards) } else { None }
            })
            .collect()
    }
}

/// Directions spread evenly over the sphere, along Fibonacci's spiral (González, *Measurement of areas on a
/// sphere using Fibonacci and latitude–longitude lattices*, 2010).
fn sphere() -> impl Iterator<Item = DVec3> {
    (0..DIRECTIONS).map(|k| {
        let z = 1.0 - (2.0 * k as f64 + 1.0) / DIRECTIONS as f64;
        let r = (1.0 - z * z).sqrt();
        let angle = GOLDEN_ANGLE * k as f64;
        DVec3::new(r * angle.cos(), r * angle.sin(), z)
    })
}

/// Some of the representatives, each the farthest from those before it.
fn spread(places: &[Place], representatives: &[usize]) -> Vec<usize> {
    let mut nearest = vec![f64::INFINITY; representatives.len()];
    let mut found = Vec::with_capacity(TARGETS);
    let mut next = 0;
    while found.len() < TARGETS.min(representatives.len()) {
        let at = representatives[next];
        found.push(at);
        for (distance, &other) in nearest.iter_mut().zip(representatives) {
            *distance = distance.min(places[at].position.distance(places[other].position));
        }
        // Reversed, because `max_by` returns the last of equal ones: the first is wanted.
        next = (0..nearest.len()).rev().max_by(|&a, &b| nearest[a].total_cmp(&nearest[b])).unwrap_or(0);
    }
    found
}

/// The pose at a place that looks along a direction: z forward, x level, y down; that of the quaternion as it
/// is written.
pub(super) fn pose_looking_along(origin: DVec3, z: DVec3) -> Option<Pose> {
    // Near the vertical, the horizontal axis would be undetermined.
    let up = if z[2].abs() > 0.95 { DVec3::Y } else { DVec3::Z };
    let x = z.cross(up).try_normalize()?;
    let y = z.cross(x);
    let exact = Pose { rotation: [0, 1, 2].map(|k| [x[k], y[k], z[k]]), translation: origin };
    // Through the quaternion, so that a pose that is read back from a file sees exactly the same.
    Pose::from_quaternion_xyzw(exact.quaternion_xyzw(), origin)
}
