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
use super::joint::{Joint, Place};
use super::motion::{Motion, PartRotation, RigidMotion, shifted};
use super::parts::{Cut, Part, Parts};
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
/// Number of samples of the mesh and of points by which joints are estimated.
const OF_JOINTS: (usize, usize) = (4000, 1500);
/// `τ` of [`Targets::joint_misfit`] as a multiple.
const JOINT_REACH: f64 = 0.3;
/// `τ` as a share of the diagonal. About twice the distance of neighbouring samples.
const REACH: f64 = 0.05;
/// Neighbours to which the plane of a point is fitted.
const PLANE_NEIGHBOURS: usize = 9;
/// Height above which a point is far from a sample, as a multiple of `τ`.
const FAR: f64 = 0.2;
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

    fn matches<'a>(&'a self, points: &'a [(DVec3, DVec3)]) -> impl Iterator<Item = Match> + 'a {
        matches(&self.positions, &self.normals, points)
    }

    pub(super) fn turned(&self, motion: &PartRotation, weights: &[f64]) -> Self {
        self.moved(weights, |at, normal, weight| motion.applied(at, normal, weight))
    }

    pub(super) fn bent(&self, joint: &Joint, weights: &[f64]) -> Self {
        self.moved(weights, |at, normal, weight| joint.applied(at, normal, weight))
    }

    fn moved(&self, weights: &[f64], motion: impl Fn(DVec3, DVec3, f64) -> (DVec3, DVec3)) -> Self {
        let (positions, normals) = (self.positions.iter().zip(&self.normals).zip(weights))
            .map(|((at, normal), weight)| motion(*at, *normal, *weight))
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
pub(super) struct Match {
    pub sample: usize,
    pub distance: f64,
    /// Height of the point above the plane of the sample.
    pub height: f64,
    /// Cosine between their normals, without a sign.
    pub cosine: f64,
}

/// Samples by which a joint is estimated: places on triangles, whose corners move.
pub(super) struct JointSamples {
    corners: Vec<Place>,
    /// Corners and barycentric coordinates.
    sources: Vec<([u32; 3], [f64; 3])>,
}

impl JointSamples {
    /// Samples of a mesh whose vertices are at `posed`, for a joint at a cut.
    ///
    /// # Errors
    /// As [`sample_points`].
    pub(super) fn new(mesh: &TriangleMesh, posed: &[DVec3], parts: &Parts, cut: &Cut) -> Result<Self> {
        let mut random = SplitMix64::new(2);
        let made: Vec<SurfacePoint> = sample_points(mesh, OF_JOINTS.0, || unit_interval(random.next_u64()))?;
        let values = parts.signed_values(cut);
        let (mut own, mut corners) = (vec![u32::MAX; posed.len()], Vec::new());
        let sources = (made.iter())
            .map(|sample| {
                let triangle = mesh.triangles[sample.triangle as usize];
                let places = triangle.map(|v| {
                    let v = v as usize;
                    if own[v] == u32::MAX {
                        own[v] = corners.len() as u32;
                        corners.push(Place { at: posed[v], rest: mesh.positions[v], value: values[v] });
                    }
                    own[v]
                });
                (places, sample.barycentric)
            })
            .collect();
        Ok(Self { corners, sources })
    }

    /// The place of a sample before the motion of the joint.
    pub(super) fn place(&self, sample: usize) -> Place {
        let (corners, weights) = &self.sources[sample];
        let mut made = Place { at: DVec3::ZERO, rest: DVec3::ZERO, value: 0.0 };
        for (corner, weight) in corners.iter().zip(weights) {
            let own = &self.corners[*corner as usize];
            made.at += *weight * own.at;
            made.rest += *weight * own.rest;
            made.value += weight * own.value;
        }
        made
    }

    /// The samples after a motion.
    pub(super) fn posed(&self, motion: impl Fn(&Place) -> DVec3) -> PosedSamples {
        let corners: Vec<DVec3> = self.corners.iter().map(motion).collect();
        let (positions, normals) = (self.sources.iter())
            .map(|(triangle, weights)| {
                let [a, b, c] = triangle.map(|v| corners[v as usize]);
                let normal = (b - a).cross(c - a).try_normalize().unwrap_or(DVec3::ZERO);
                (weights[0] * a + weights[1] * b + weights[2] * c, normal)
            })
            .unzip();
        PosedSamples { positions, normals }
    }
}

/// Samples after a motion.
pub(super) struct PosedSamples {
    positions: Vec<DVec3>,
    normals: Vec<DVec3>,
}

impl PosedSamples {
    pub(super) fn normal(&self, sample: usize) -> DVec3 {
        self.normals[sample]
    }

    /// Points beside their nearest samples.
    pub(super) fn matches<'a>(&'a self, points: &'a [(DVec3, DVec3)]) -> impl Iterator<Item = Match> + 'a {
        matches(&self.positions, &self.normals, points)
    }
}

fn matches<'a>(
    positions: &'a [DVec3],
    normals: &'a [DVec3],
    points: &'a [(DVec3, DVec3)],
) -> impl Iterator<Item = Match> + 'a {
    let tree = PointTree::new(positions).ok();
    points.iter().filter_map(move |(point, normal)| {
        let (distance, sample) = tree.as_ref()?.nearest_one(*point)?;
        let sample = sample as usize;
        let own = normals[sample];
        Some(Match {
            sample,
            distance,
            height: (*point - positions[sample]).dot(own),
            cosine: normal.dot(own).abs(),
        })
    })
}

/// Mean of `min(1, (h/τ)² + 2 (1 − |n·m|) + 2 max(0, d/τ − 1))`.
fn mean_misfit(matches: impl Iterator<Item = Match>, count: usize, reach: f64) -> f64 {
    let sum: f64 = matches
        .map(|m| {
            let beyond = 2.0 * (m.distance / reach - 1.0).max(0.0);
            ((m.height / reach).powi(2) + 2.0 * (1.0 - m.cosine) + beyond).min(1.0)
        })
        .sum();
    sum / count.max(1) as f64
}

/// Weight `(1 − e)²` of a match in a refinement, with `e = 0.3 (d/τ)² + (h/τ)² + 1 − |n·m|`; `None` if `e` is
/// above 1.
pub(super) fn agreement(distance: f64, height: f64, cosine: f64, reach: f64) -> Option<f64> {
    let error = 0.3 * (distance / reach).powi(2) + (height / reach).powi(2) + (1.0 - cosine);
    (error < 1.0).then(|| (1.0 - error).powi(2))
}

impl Targets {
    /// # Errors
    /// As [`PointTree::new`].
    pub(super) fn new(points: &[DVec3], size: f64) -> Result<Self> {
        let tree = PointTree::new(points)?;
        // By a random order, so that points of one scan line are not left out together.
        let mut order: Vec<(u64, usize)> =
            (0..points.len()).map(|i| (planish_core::random::mix64(i as u64), i)).collect();
        order.sort_unstable();
        let all = (order.par_iter().take(OF_JOINTS.1))
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

    fn misfit_of(&self, samples: &Samples, effort: Effort, reach: f64) -> f64 {
        let points = self.of(effort);
        mean_misfit(samples.matches(points), points.len(), reach)
    }

    /// The misfit of a pose with an estimated joint, for a smaller `τ`.
    pub(super) fn joint_misfit(&self, samples: &PosedSamples) -> f64 {
        let points = self.of_joints();
        mean_misfit(samples.matches(points), points.len(), JOINT_REACH * self.reach)
    }

    /// Share of the points that are far from the planes of their nearest samples.
    pub(super) fn far_share(&self, samples: &Samples) -> f64 {
        let points = self.of(Effort::Full);
        let is_far = |m: &Match| m.height.abs() > FAR * self.reach;
        samples.matches(points).filter(is_far).count() as f64 / points.len().max(1) as f64
    }

    /// The misfit of a pose.
    pub(super) fn misfit(&self, samples: &Samples) -> f64 {
        self.misfit_of(samples, Effort::Full, self.reach)
    }

    /// Diagonal of the mesh.
    pub(super) fn size(&self) -> f64 {
        self.reach / REACH
    }

    /// The points by which joints are estimated, with their normals.
    pub(super) fn of_joints(&self) -> &[(DVec3, DVec3)] {
        &self.all
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
        for m in samples.matches(self.of(effort)) {
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
        let size = self.size();
        for k in 0..12 {
            let unit = if k % 6 < 3 { size * size } else { 1.0 };
            information[(k, k)] += DAMPING * unit * sum.max(f64::MIN_POSITIVE);
        }
        information.cholesky().map(|factor| factor.solve(&vector))
    }
}

/// Information about each motion in addition to that of the points, as a share of it.
const DAMPING: f64 = 1e-4;
