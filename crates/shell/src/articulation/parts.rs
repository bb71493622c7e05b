//! Parts of a mesh that may turn about a joint.
//!
//! In: a mesh. Out: for each part the weight of every vertex: 1 in the part, 0 in the rest, smooth across the
//! joint.
//!
//! Joints are level sets of functions on the vertices, at several levels:
//!
//! - distances along the mesh from its tips, which are the farthest vertices from each other: limbs and ends;
//! - half of the differences of such distances from two tips: joints between two ends;
//! - heights along directions of the principal axes: cuts by planes.
//!
//! Parts that hardly differ from an earlier one are left out.
//!
//! Not guaranteed: a part has one joint only. Two limbs that turn together are two parts.

use super::joint::{Joint, Place};
use super::misfit::Samples;
use super::motion::{Motion, shifted, smooth_step};
use crate::controls::EdgeGraph;
use nalgebra::{Matrix3, Vector3};
use planish_core::DVec3;
use planish_mesh::TriangleMesh;
use rayon::prelude::*;

/// Number of tips.
const TIPS: usize = 8;
/// Levels of distances from tips and of heights, and of differences, as shares of their range.
const LEVELS: [f64; 8] = [0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85];
const DIFFERENCE_LEVELS: [f64; 5] = [0.3, 0.4, 0.5, 0.6, 0.7];
/// Width of a joint, as a share of the diagonal. Fits correct it.
const JOINT: f64 = 0.15;
/// Smallest share of the samples in a part. Smaller ones are left to the fit.
const SMALLEST: f64 = 0.03;
/// Largest rms difference of the weights of parts that count as one.
const EQUAL: f64 = 0.1;

/// The level set of a function, with the side that turns.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cut {
    function: usize,
    level: f64,
    /// 1 if the part is above the level, −1 if it is below.
    side: f64,
}

impl Cut {
    /// The distance of a value from the level, positive in the part.
    fn signed(&self, value: f64) -> f64 {
        self.side * (value - self.level)
    }
}

/// A part with its weights at the samples.
pub(super) struct Part {
    /// `None` for the whole mesh.
    pub cut: Option<Cut>,
    weights: Vec<f64>,
}

/// The whole mesh, then its parts.
pub(super) struct Parts {
    pub all: Vec<Part>,
    /// Values of the functions at the vertices.
    functions: Vec<Vec<f64>>,
    /// Width of joints.
    pub width: f64,
}

impl Part {
    pub(super) fn whole(samples: usize) -> Self {
        Self { cut: None, weights: vec![1.0; samples] }
    }

    pub(super) fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// The centre of the joint in a pose.
    pub(super) fn pivot(&self, samples: &Samples) -> DVec3 {
        // Largest in the middle of the joint, zero outside.
        let share = |w: f64| w * (1.0 - w);
        samples.weighted_center(self.weights.iter().map(|w| share(*w)))
    }
}

impl Parts {
    pub(super) fn new(mesh: &TriangleMesh, samples: &Samples, size: f64) -> Self {
        let mut functions = Vec::new();
        let mut cuts = Vec::new();
        let mut add = |values: Vec<f64>, levels: &[f64]| {
            let (low, high) = range(&values);
            let function = functions.len();
            functions.push(values);
            cuts.extend(levels.iter().map(|level| (function, low + level * (high - low))));
        };
        let tips = distances_from_tips(mesh);
        for distances in &tips {
            add(distances.clone(), &LEVELS);
        }
        for (i, first) in tips.iter().enumerate() {
            for second in &tips[..i] {
                add(first.iter().zip(second).map(|(a, b)| 0.5 * (a - b)).collect(), &DIFFERENCE_LEVELS);
            }
        }
        for direction in principal_directions(samples) {
            add(mesh.positions.iter().map(|p| p.dot(direction)).collect(), &LEVELS);
        }
        let width = JOINT * size;
        let mut made = Self { all: vec![Part::whole(samples.len())], functions, width };
        for (function, level) in cuts {
            made.add(Cut { function, level, side: 1.0 }, mesh, samples);
        }
        made
    }

    /// Adds the smaller side of a cut, unless it is too small or equals another part.
    fn add(&mut self, cut: Cut, mesh: &TriangleMesh, samples: &Samples) {
        let at_samples = samples.interpolated(mesh, &self.functions[cut.function]);
        let mut weights: Vec<f64> = at_samples.iter().map(|value| weight(*value, &cut, self.width)).collect();
        let per = 1.0 / weights.len().max(1) as f64;
        let mut share = per * weights.iter().sum::<f64>();
        let mut cut = cut;
        if share > 0.5 {
            cut.side = -1.0;
            weights.iter_mut().for_each(|w| *w = 1.0 - *w);
            share = 1.0 - share;
        }
        let differs = |other: &Part| {
            let squares: f64 = other.weights.iter().zip(&weights).map(|(a, b)| (a - b).powi(2)).sum();
            per * squares > EQUAL * EQUAL
        };
        if share >= SMALLEST && self.all.par_iter().all(differs) {
            self.all.push(Part { cut: Some(cut), weights });
        }
    }

    /// Signed distances of the vertices from a cut, by its function.
    pub(super) fn signed_values(&self, cut: &Cut) -> Vec<f64> {
        self.functions[cut.function].iter().map(|value| cut.signed(*value)).collect()
    }

    /// Weights of a joint at samples of the mesh.
    pub(super) fn joint_weights(&self, mesh: &TriangleMesh, samples: &Samples, joint: &Joint) -> Vec<f64> {
        let weights: Vec<f64> = (mesh.positions.iter().zip(self.signed_values(&joint.cut)))
            .map(|(p, value)| joint.weight(&Place { at: *p, rest: *p, value }, self.width))
            .collect();
        samples.interpolated(mesh, &weights)
    }

    /// The joint with the cuts of other functions, those of the most similar weights first.
    pub(super) fn similar_joints(
        &self,
        mesh: &TriangleMesh,
        samples: &Samples,
        joint: &Joint,
        count: usize,
    ) -> Vec<Joint> {
        let weights = self.joint_weights(mesh, samples, joint);
        let mean_of = |share: &dyn Fn(f64) -> f64, values: &[f64]| {
            let (sum, all) = (weights.iter().zip(values))
                .fold((0.0, 0.0), |(sum, all), (w, v)| (sum + share(*w) * v, all + share(*w)));
            sum / all.max(f64::MIN_POSITIVE)
        };
        let mut found: Vec<(f64, Joint)> = (self.functions.par_iter().enumerate())
            .filter(|(function, _)| *function != joint.cut.function)
            .map(|(function, values)| {
                let at_samples = samples.interpolated(mesh, values);
                let above = mean_of(&|w| w, &at_samples) > mean_of(&|w| 1.0 - w, &at_samples);
                let level = mean_of(&|w| w * (1.0 - w), &at_samples);
                let cut = Cut { function, level, side: if above { 1.0 } else { -1.0 } };
                let other = joint.with_cut(cut);
                let squares: f64 = (weights.iter().zip(self.joint_weights(mesh, samples, &other)))
                    .map(|(a, b)| (a - b).powi(2))
                    .sum();
                (squares, other)
            })
            .collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.into_iter().take(count).map(|(_, other)| other).collect()
    }

    /// Positions of all vertices after motions of parts.
    pub(super) fn replayed(&self, positions: &[DVec3], motions: &[Motion]) -> Vec<DVec3> {
        let weight_of = |part: usize, vertex: usize| {
            (self.all[part].cut)
                .map_or(1.0, |cut| weight(self.functions[cut.function][vertex], &cut, self.width))
        };
        (positions.par_iter().enumerate())
            .map(|(v, p)| {
                motions.iter().fold(*p, |at, motion| match motion {
                    Motion::Turn(part, turn) => turn.applied(at, DVec3::Z, weight_of(*part, v)).0,
                    Motion::Shift(part, rigid) => shifted(rigid, at, DVec3::Z, weight_of(*part, v)).0,
                    Motion::Bend(joint) => {
                        let value = joint.cut.signed(self.functions[joint.cut.function][v]);
                        let weight = joint.weight(&Place { at, rest: *p, value }, self.width);
                        joint.applied(at, DVec3::Z, weight).0
                    }
                })
            })
            .collect()
    }
}

/// The weight of a part at a value of its function: `3s² − 2s³` across the joint.
fn weight(value: f64, cut: &Cut, width: f64) -> f64 {
    smooth_step(cut.signed(value) / width + 0.5)
}

fn range(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)))
}

/// Distances of all vertices from each tip, along the edges of the mesh. Vertices that cannot be reached are
/// as far as the farthest others.
fn distances_from_tips(mesh: &TriangleMesh) -> Vec<Vec<f64>> {
    let graph = EdgeGraph::with_plain_lengths(mesh);
    let distances = |source: usize| {
        let mut far = graph.distances(source as u32);
        let largest = far.iter().copied().filter(|d| d.is_finite()).fold(0.0, f64::max);
        far.iter_mut().filter(|d| !d.is_finite()).for_each(|d| *d = largest);
        far
    };
    let farthest = |far: &[f64]| (0..far.len()).fold(0, |best, v| if far[v] > far[best] { v } else { best });
    let first = mesh.triangles.first().map_or(0, |t| t[0] as usize);
    let mut made = vec![distances(farthest(&distances(first)))];
    let mut nearest = made[0].clone();
    while made.len() < TIPS {
        let next = distances(farthest(&nearest));
        nearest.iter_mut().zip(&next).for_each(|(a, b)| *a = a.min(*b));
        made.push(next);
    }
    made
}

/// The directions to the corners, edges and faces of a cube along the principal axes, one of each pair.
fn principal_directions(samples: &Samples) -> Vec<DVec3> {
    let center = samples.center();
    let spread = samples.positions().iter().fold(Matrix3::zeros(), |sum, p| {
        let off = Vector3::from(*p - center);
        sum + off * off.transpose()
    });
    let axes = spread.symmetric_eigen().eigenvectors;
    (14..27)
        .map(|k: i32| {
            let corner =
                Vector3::new(f64::from(k / 9) - 1.0, f64::from(k / 3 % 3) - 1.0, f64::from(k % 3) - 1.0);
            DVec3::from((axes * corner).normalize())
        })
        .collect()
}
