//! How well a pose of the mesh agrees with points, and rigid motions that improve it.
//!
//! In: samples of the mesh with normals, points with the normals of planes through their neighbours. Out: a
//! misfit between 0 and 1.
//!
//! The misfit of a point with the nearest sample `x`, its normal `n`, and the length `τ` is the mean of
//!
//! `min(1, (h/τ)² + 2 (1 − |n·m|) + 2 max(0, d/τ − 1))`
//!
//! with the height `h` of the point above the plane of the sample, the distance `d`, and the normal `m` of
//! the point. Normals have no sign. Points only: the mesh may be larger than what was measured.

use super::Pose;
use super::motion::{Motion, PartRotation, RigidMotion, shifted};
use super::parts::Part;
use crate::point_tree::{PointTree, plane_through};
use nalgebra::{SMatrix, SVector, Vector3};
use planish_core::DVec3;
use planish_core::random::{SplitMix64, unit_interval};
use planish_estimate::Result;
use planish_mesh::{SurfacePoint, TriangleMesh, sample_points};
use rayon::prelude::*;

/// Number of samples of the mesh.
const SAMPLES: usize = 1000;
/// Number of points, and of those that score trials before they are refined.
const POINTS: (usize, usize) = (800, 250);
/// `τ` as a share of the diagonal. About twice the distance of neighbouring samples.
const REACH: f64 = 0.05;
/// Neighbours to which the plane of a point is fitted.
const PLANE_NEIGHBOURS: usize = 9;
/// `τ` of [`Targets::quick_misfit`] as a multiple: unrefined trials are farther away.
const QUICK_REACH: f64 = 1.5;
/// `τ` of the first iteration of a refinement as a multiple, the share of it that each iteration leaves, and
/// its minimum.
const REFINED_REACH: (f64, f64, f64) = (2.0, 0.8, 0.5);

/// Iterations and points of a refinement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Effort {
    Quick,
    Full,
}

impl Effort {
    fn iterations(self) -> usize {
        match self {
            Self::Quick => 5,
            Self::Full => 14,
        }
    }

    fn points(self) -> usize {
        match self {
            Self::Quick => POINTS.1,
            Self::Full => POINTS.0,
        }
    }
}

/// Samples of a posed mesh.
#[derive(Clone)]
pub(super) struct Samples {
    sources: std::sync::Arc<Vec<(u32, [f64; 3])>>,
    positions: Vec<DVec3>,
    normals: Vec<DVec3>,
}

impl Samples {
    pub(super) fn new(mesh: &TriangleMesh) -> Result<Self> {
        let mut random = SplitMix64::new(1);
        let made: Vec<SurfacePoint> = sample_points(mesh, SAMPLES, || unit_interval(random.next_u64()))?;
        Ok(Self {
            sources: std::sync::Arc::new(made.iter().map(|s| (s.triangle, s.barycentric)).collect()),
            positions: made.iter().map(|s| s.position).collect(),
            normals: made.iter().map(|s| s.normal).collect(),
        })
    }

    pub(super) fn len(&self) -> usize {
        self.positions.len()
    }

    pub(super) fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    pub(super) fn center(&self) -> DVec3 {
        self.weighted_center(self.positions.iter().map(|_| 1.0))
    }

    pub(super) fn weighted_center(&self, weights: impl Iterator<Item = f64>) -> DVec3 {
        let (sum, all) = (self.positions.iter().zip(weights))
            .fold((DVec3::ZERO, 0.0), |(sum, all), (p, w)| (sum + w * *p, all + w));
        if all > 0.0 { sum / all } else { self.positions.first().copied().unwrap_or(DVec3::ZERO) }
    }

    /// Values of the vertices at the samples.
    pub(super) fn interpolated(&self, mesh: &TriangleMesh, values: &[f64]) -> Vec<f64> {
        let at = |(triangle, weights): &(u32, [f64; 3])| {
            let corners = mesh.triangles[*triangle as usize];
            corners.iter().zip(weights).map(|(v, w)| w * values[*v as usize]).sum()
        };
        self.sources.iter().map(at).collect()
    }

    pub(super) fn turned(&self, motion: &PartRotation, weights: &[f64]) -> Self {
        self.moved(weights, |at, normal, weight| motion.applied(at, normal, weight))
    }

    fn moved(&self, weights: &[f64], motion: impl Fn(DVec3, DVec3, f64) -> (DVec3, DVec3)) -> Self {
        let (positions, normals) = (self.positions.iter().zip(&self.normals).zip(weights))
            .map(|((at, normal), weight)| match *weight {
                0.0 => motion(*at, *normal, 0.0),
                weight => motion(*at, *normal, weight),
            })
            .unzip();
        Self { sources: self.sources.clone(), positions, normals }
    }
}

/// Points with the normals of planes through their neighbours.
pub(super) struct Targets {
    all: Vec<(DVec3, DVec3)>,
    reach: f64,
}

/// A point beside its nearest sample.
struct Match {
    sample: usize,
    distance: f64,
    /// Height of the point above the plane of the sample.
    height: f64,
    /// Cosine between their normals, without a sign.
    cosine: f64,
}

/// Weight `(1 − e)²` of a match in a refinement, with `e = 0.3 (d/τ)² + (h/τ)² + 1 − |n·m|`; `None` if `e` is
/// above 1.
fn agreement(distance: f64, height: f64, cosine: f64, reach: f64) -> Option<f64> {
    let error = 0.3 * (distance / reach).powi(2) + (height / reach).powi(2) + (1.0 - cosine);
    (error < 1.0).then(|| (1.0 - error).powi(2))
}

impl Targets {
    /// # Errors
    /// As [`PointTree::new`].
    pub(super) fn new(points: &[DVec3], size: f64) -> Result<Self> {
        let tree = PointTree::new(points)?;
        let step = points.len().div_ceil(POINTS.0).max(1);
        // By a random order, so that points of one scan line are not left out together.
        let mut order: Vec<(u64, usize)> =
            (0..points.len()).map(|i| (planish_core::random::mix64(i as u64), i)).collect();
        order.sort_unstable();
        let all = (order.par_iter().take(points.len() / step))
            .map(|(_, i)| {
                let near: Vec<DVec3> = (tree.nearest(points[*i], PLANE_NEIGHBOURS).iter())
                    .map(|(_, j)| points[*j as usize])
                    .collect();
                (points[*i], plane_through(&near).normal)
            })
            .collect();
        Ok(Self { all, reach: REACH * size })
    }

    pub(super) fn is_empty(&self) -> bool {
        self.all.len() < PLANE_NEIGHBOURS
    }

    fn of(&self, effort: Effort) -> &[(DVec3, DVec3)] {
        &self.all[..effort.points().min(self.all.len())]
    }

    fn matches<'a>(samples: &'a Samples, points: &'a [(DVec3, DVec3)]) -> impl Iterator<Item = Match> + 'a {
        let tree = PointTree::new(&samples.positions).ok();
        points.iter().filter_map(move |(point, normal)| {
            let (distance, sample) = tree.as_ref()?.nearest_one(*point)?;
            let sample = sample as usize;
            let own = samples.normals[sample];
            Some(Match {
                sample,
                distance,
                height: (*point - samples.positions[sample]).dot(own),
                cosine: normal.dot(own).abs(),
            })
        })
    }

    fn misfit_of(&self, samples: &Samples, effort: Effort, reach: f64) -> f64 {
        let points = self.of(effort);
        let sum: f64 = Self::matches(samples, points)
            .map(|m| {
                let beyond = 2.0 * (m.distance / reach - 1.0).max(0.0);
                ((m.height / reach).powi(2) + 2.0 * (1.0 - m.cosine) + beyond).min(1.0)
            })
            .sum();
        sum / points.len().max(1) as f64
    }

    /// The misfit of fewer points with a larger `τ`.
    pub(super) fn quick_misfit(&self, samples: &Samples) -> f64 {
        self.misfit_of(samples, Effort::Quick, QUICK_REACH * self.reach)
    }

    /// A pose after rigid motions of a part and of the rest that bring the samples closer to the points
    /// (iterated closest points, point to plane, weights of [`agreement`]).
    pub(super) fn refined(&self, from: &Pose, part: &Part, index: usize, effort: Effort) -> Pose {
        let mut motions = [RigidMotion::IDENTITY; 2];
        let posed = |motions: &[RigidMotion; 2]| {
            from.samples.moved(part.weights(), |at, normal, weight| shifted(motions, at, normal, weight))
        };
        let mut samples = from.samples.clone();
        for k in 0..effort.iterations() {
            let (first, decay, last) = REFINED_REACH;
            let reach = self.reach * (first * decay.powi(k as i32)).max(last);
            let center = samples.center();
            let Some(step) = self.step(&samples, part, (reach, effort), center) else { break };
            for (motion, own) in motions.iter_mut().zip([0, 6]) {
                let by = |k: usize| Vector3::new(step[own + k], step[own + k + 1], step[own + k + 2]);
                *motion = motion.followed_by(by(0), by(3), center);
            }
            samples = posed(&motions);
        }
        let misfit = self.misfit_of(&samples, effort, self.reach);
        Pose { samples, misfit, motions: [&from.motions[..], &[Motion::Shift(index, motions)]].concat() }
    }

    /// Rotation vectors about a centre and translations, of the rest and of the part.
    fn step(
        &self,
        samples: &Samples,
        part: &Part,
        (reach, effort): (f64, Effort),
        center: DVec3,
    ) -> Option<SVector<f64, 12>> {
        let mut information = SMatrix::<f64, 12, 12>::zeros();
        let mut vector = SVector::<f64, 12>::zeros();
        let mut sum = 0.0;
        for m in Self::matches(samples, self.of(effort)) {
            let Some(weight) = agreement(m.distance, m.height, m.cosine, reach) else { continue };
            let (at, normal) = (samples.positions[m.sample], samples.normals[m.sample]);
            let arm = (at - center).cross(normal);
            let share = part.weights()[m.sample];
            let row = SVector::<f64, 12>::from_fn(|k, _| {
                let own = if k < 6 { 1.0 - share } else { share };
                own * if k % 6 < 3 { arm[k % 3] } else { normal[k % 3] }
            });
            information += weight * row * row.transpose();
            vector += weight * m.height * row;
            sum += weight;
        }
        // Directions that no point determines stay as they are.
        let size = self.reach / REACH;
        for k in 0..12 {
            let unit = if k % 6 < 3 { size * size } else { 1.0 };
            information[(k, k)] += DAMPING * unit * sum.max(f64::MIN_POSITIVE);
        }
        information.cholesky().map(|factor| factor.solve(&vector))
    }
}

/// Information about each motion in addition to that of the points, as a share of it.
const DAMPING: f64 = 1e-4;
