//! Errors common to all readings of a scan: its pose, and a bias of its ranges.
//!
//! Input: scans whose pose or bias has a σ. Output: up to seven unknowns for each of them, `τ` and `ω` of a
//! motion and a bias `b`, which are part of the state in addition to the control vertices; their coupling
//! with these; and their covariance. The residual of a reading changes with them by
//!
//! ```text
//! position    ∂r/∂τ = n      ∂r/∂ω = (z − c) × n      ∂r/∂b = −n·d
//! ```
//!
//! with the normal `n` at the foot, a centre `c` of rotation, and the ray `d`. The registration of views is
//! this part of the state. Correlated noise is a low-rank term, not a matrix over all readings.
//!
//! Not guaranteed: that scans far from their true pose find it. The motion is linearised in every iteration
//! and follows the slope of the residuals.

mod equations;
mod estimates;

pub(crate) use equations::Linearized;

use super::feet::Foot;
use super::observations::{Observations, moved_viewing};
use super::quantity::Measured;
use crate::model::{ScanErrorInformation, SurfaceModel};
use planish_core::DVec3;
use planish_exchange::ScanSet;
use planish_mesh::BoundingBox;
use planish_sense::{Pose, Viewing, ray_at};
use planish_spline::Surface;

/// Unknowns of one scan: a translation, a rotation, a bias.
const UNKNOWNS: usize = 7;
const ROTATION: usize = 3;
const BIAS: usize = 6;
/// σ of the rotation of a scan whose pose is free, in radians. σ of its position is the cloud's size, so the
/// prior is negligible compared with any reading.
const FREE_ROTATION: f64 = 1.0;
/// Largest motion of a scan in one iteration: as a share of the cloud's size, and in radians. Larger steps
/// leave the range of the linearisation.
const MAX_STEP: f64 = 0.1;
/// A direction of a pose is undetermined if the readings remove less than this share of its prior variance.
/// See decision 0014.
const MIN_VARIANCE_REDUCTION: f64 = 0.05;
/// Step of central differences by rotation, in radians: their error is about its square, and rounding about
/// 1e-16 over it.
const DIFFERENCE_STEP: f64 = 1e-5;

/// Derivatives of the residuals of one reading by the unknowns of its scan.
type Rows = [[f64; UNKNOWNS]; 3];

/// The unknowns of one scan.
#[derive(Debug, Clone)]
pub(crate) struct ScanError {
    /// The scan, among those of the set.
    pub scan: usize,
    /// Which of the seven unknowns it has.
    unknowns: Vec<usize>,
    /// True if the pose has no stated σ and is estimated all the same.
    is_free: bool,
    /// σ of translation, rotation and bias; zero where exact.
    sigmas: [f64; 3],
    /// Centre of rotations.
    center: DVec3,
    /// The stated pose, the current one, and the bias.
    stated: Pose,
    pub now: Pose,
    pub bias: f64,
    /// Viewing geometry of the sensor for the current pose.
    viewing: Viewing,
}

/// The unknowns of all scans.
#[derive(Debug, Clone, Default)]
pub(crate) struct ScanErrors {
    pub errors: Vec<ScanError>,
    /// For each scan of the observations, its entry in `errors`.
    of_scan: Vec<Option<usize>>,
    /// The size of the cloud.
    size: f64,
    /// Unknowns of earlier sessions; they come before all others.
    earlier: Option<EarlierScanErrors>,
}

/// Poses and biases of earlier sessions: their information, linearised at the model of these sessions, and
/// how far they have moved since.
#[derive(Debug, Clone)]
struct EarlierScanErrors {
    information: ScanErrorInformation,
    vertices: Vec<DVec3>,
    moved: Vec<f64>,
}

impl EarlierScanErrors {
    fn width(&self) -> usize {
        self.moved.len()
    }

    /// `Cᵀ s + P δ` and `C δ`, where the vertices have moved by `s` along their directions and the unknowns
    /// by `δ`.
    fn products(&self, surface: &Surface, directions: &[DVec3]) -> (Vec<f64>, Vec<f64>) {
        let ScanErrorInformation { coupling, corner } = &self.information;
        let m = self.width();
        let mut of_shared: Vec<f64> = (corner.chunks_exact(m))
            .map(|row| row.iter().zip(&self.moved).map(|(p, d)| p * d).sum())
            .collect();
        let ways = directions.iter().enumerate().map(|(unknown, d)| {
            let node = surface.space().node_of_unknown(unknown);
            (surface.vertices()[node] - self.vertices[node]).dot(*d)
        });
        let of_vertices = (coupling.chunks_exact(m).zip(ways))
            .map(|(row, way)| {
                for (sum, c) in of_shared.iter_mut().zip(row) {
                    *sum += c * way;
                }
                row.iter().zip(&self.moved).map(|(c, d)| c * d).sum()
            })
            .collect();
        (of_shared, of_vertices)
    }
}

impl ScanError {
    fn width(&self) -> usize {
        self.unknowns.len()
    }

    fn moves(&self) -> bool {
        self.unknowns.iter().any(|&k| k < BIAS)
    }

    /// The deviation from what was stated: motion of the scanner's origin, rotation vector, bias.
    fn deviation(&self) -> [f64; UNKNOWNS] {
        let turn = Pose { translation: DVec3::ZERO, ..self.now }
            .after(&Pose { translation: DVec3::ZERO, ..self.stated.inverse() });
        let t = self.now.translation - self.stated.translation;
        let w = turn.rotation_vector();
        [t[0], t[1], t[2], w[0], w[1], w[2], self.bias]
    }

    /// Derivative of the deviation by the unknowns: a rotation about the centre moves the scanner's origin.
    fn derivative(&self) -> [[f64; UNKNOWNS]; UNKNOWNS] {
        let mut d = [[0.0; UNKNOWNS]; UNKNOWNS];
        for (k, row) in d.iter_mut().enumerate() {
            row[k] = 1.0;
        }
        let arm = self.now.translation - self.center;
        for axis in 0..3 {
            let mut turn = DVec3::ZERO;
            turn[axis] = 1.0;
            let moved = turn.cross(arm);
            for k in 0..3 {
                d[k][ROTATION + axis] = moved[k];
            }
        }
        d
    }

    /// 1/σ² of each unknown; 0 for exact ones, which do not move.
    fn stated_information(&self) -> [f64; UNKNOWNS] {
        std::array::from_fn(|k| {
            // Unknowns 0 to 2 are the translation, 3 to 5 the rotation, and 6 is the bias.
            let sigma = self.sigmas[(k / 3).min(2)];
            if sigma > 0.0 { 1.0 / (sigma * sigma) } else { 0.0 }
        })
    }

    /// Information that was stated about the unknowns, and the gradient of its term.
    fn prior(&self) -> (Vec<f64>, Vec<f64>) {
        let (j, w, e) = (self.derivative(), self.stated_information(), self.deviation());
        let information_of =
            |a: usize, b: usize| (0..UNKNOWNS).map(|k| j[k][a] * w[k] * j[k][b]).sum::<f64>();
        let pull = |a: usize| -(0..UNKNOWNS).map(|k| j[k][a] * w[k] * e[k]).sum::<f64>();
        let own = || self.unknowns.iter().copied();
        (own().flat_map(|a| own().map(move |b| information_of(a, b))).collect(), own().map(pull).collect())
    }

    /// The ray through a point, if it is known.
    fn ray(&self, p: DVec3) -> Option<DVec3> {
        ray_at(self.viewing, p)
    }

    /// Derivative of the residual of a position by all unknowns, linear in the normal `n`. If the ray is
    /// unknown, the surface's `normal` stands for it.
    fn position_row(&self, point: DVec3, n: DVec3, normal: DVec3) -> [f64; UNKNOWNS] {
        let turn = (point - self.center).cross(n);
        let along = n.dot(self.ray(point).unwrap_or(normal));
        [n[0], n[1], n[2], turn[0], turn[1], turn[2], -along]
    }

    /// Derivatives of the residuals of a reading by all unknowns.
    fn rows(&self, surface: &Surface, foot: &Foot, point: DVec3, measured: &Measured) -> Rows {
        let mut rows = Rows::default();
        match measured {
            Measured::Position => {
                rows[0] = self.position_row(point, foot.normal, foot.normal);
            }
            Measured::Normal(_) | Measured::Curvature(_) => {
                for axis in 0..3 {
                    let turned = |by: f64| {
                        let mut omega = DVec3::ZERO;
                        omega[axis] = by;
                        foot.directional(
                            surface,
                            &measured.turned(&Pose::from_rotation_vector(omega, DVec3::ZERO)),
                        )
                    };
                    if let (Some(more), Some(less)) = (turned(DIFFERENCE_STEP), turned(-DIFFERENCE_STEP)) {
                        for r in 0..3 {
                            rows[r][ROTATION + axis] = (more[r] - less[r]) / (2.0 * DIFFERENCE_STEP);
                        }
                    }
                }
            }
        }
        rows
    }
}

impl ScanErrors {
    /// The unknowns of scans with a stated σ of pose or bias.
    ///
    /// With `align`, the poses of all other scans are unknowns, too. Without an earlier model the first of
    /// them is held as the anchor of the frame.
    pub(crate) fn new(
        set: &ScanSet,
        observations: &Observations,
        origin: DVec3,
        align: bool,
        earlier: Option<&SurfaceModel>,
    ) -> Self {
        let size = BoundingBox::from_points(&observations.readings.points).map_or(0.0, |b| b.diagonal());
        let mut made = Self {
            of_scan: vec![None; observations.scans.channel.len()],
            size,
            earlier: earlier.and_then(|model| {
                let information = model.known.scan_errors()?.clone();
                Some(EarlierScanErrors {
                    moved: vec![0.0; information.corner.len().isqrt()],
                    vertices: model.surface.vertices().to_vec(),
                    information,
                })
            }),
            ..Self::default()
        };
        let mut sums = vec![(DVec3::ZERO, 0_usize); set.scans.len()];
        for (p, &s) in observations.readings.points.iter().zip(&observations.readings.scan) {
            if let Some((sum, count)) = sums.get_mut(observations.base_scan(s as usize)) {
                (*sum, *count) = (*sum + *p, *count + 1);
            }
        }
        // The frame of an earlier model is the anchor; without one, a scan has to be.
        let mut anchored = earlier.is_some();
        for (s, posed) in set.scans.iter().enumerate() {
            let (sum, count) = sums[s];
            let states_none = posed.sigma_translation.is_none() && posed.sigma_rotation_deg.is_none();
            // A scan without a stated σ stays fixed unless `align` frees it. The first such scan is the
            // anchor.
            let is_free = align && states_none && anchored;
            anchored |= states_none;
            let sigmas = [
                posed.sigma_translation.or(is_free.then_some(size)),
                (posed.sigma_rotation_deg.map(f64::to_radians)).or(is_free.then_some(FREE_ROTATION)),
                set.sensors[posed.sensor].sigma_bias,
            ]
            .map(|sigma| sigma.unwrap_or(0.0));
            let unknowns: Vec<usize> = (0..UNKNOWNS).filter(|k| sigmas[(k / 3).min(2)] > 0.0).collect();
            // Without readings, only the prior would determine the unknowns of a scan.
            if unknowns.is_empty() || count == 0 {
                continue;
            }
            let mut stated = posed.scan.world_from_scanner;
            stated.translation -= origin;
            made.of_scan[s] = Some(made.errors.len());
            made.errors.push(ScanError {
                scan: s,
                // About the centroid of its readings, rotation and translation of a scan are nearly
                // independent.
                center: if sigmas[0] > 0.0 {
                    sum.map(|c| c / count as f64)
                } else {
                    // Its position is exact, so it rotates about it.
                    stated.translation
                },
                unknowns,
                is_free,
                sigmas,
                stated,
                now: stated,
                bias: 0.0,
                viewing: observations.viewing(s),
            });
        }
        // Normals and curvatures of a scan move with its positions.
        for s in set.scans.len()..made.of_scan.len() {
            made.of_scan[s] = made.of_scan[observations.base_scan(s)];
        }
        made
    }

    /// Adds a scan without unknowns.
    pub(crate) fn add_fixed_scan(&mut self) {
        self.of_scan.push(None);
    }

    /// True if there are no unknowns.
    pub(crate) fn is_empty(&self) -> bool {
        self.errors.is_empty() && self.earlier.is_none()
    }

    /// Number of unknowns of earlier sessions.
    fn earlier_width(&self) -> usize {
        self.earlier.as_ref().map_or(0, EarlierScanErrors::width)
    }

    /// Number of all unknowns, those of earlier sessions first.
    fn width(&self) -> usize {
        self.earlier_width() + self.errors.iter().map(ScanError::width).sum::<usize>()
    }

    /// The component of a scan's bias along the normal, which is subtracted from the height of a position.
    #[inline]
    pub(crate) fn bias_along(&self, scan: u32, point: DVec3, normal: DVec3) -> f64 {
        let Some(error) = self.of_scan.get(scan as usize).copied().flatten() else {
            return 0.0;
        };
        let error = &self.errors[error];
        // Most scans have no bias, and the ray of a point takes a square root.
        if error.bias == 0.0 {
            return 0.0;
        }
        error.bias * error.ray(point).map_or(1.0, |d| normal.dot(d))
    }

    /// Changes the unknowns by a step; returns the motion of each scan of the observations.
    pub(crate) fn take(&mut self, step: &[f64]) -> Vec<Option<Pose>> {
        let mut moved = vec![None; self.errors.len()];
        let mut start = self.earlier_width();
        if let Some(earlier) = &mut self.earlier {
            for (way, s) in earlier.moved.iter_mut().zip(step) {
                *way += s;
            }
        }
        for (error, moved) in self.errors.iter_mut().zip(&mut moved) {
            let mut by = [0.0; UNKNOWNS];
            for (&k, s) in error.unknowns.iter().zip(&step[start..]) {
                by[k] = *s;
            }
            start += error.width();
            error.bias += by[BIAS];
            if !error.moves() {
                continue;
            }
            let limited = |v: DVec3, longest: f64| {
                let length = v.length();
                if length > longest { v.map(|c| c * longest / length) } else { v }
            };
            // A limited step keeps its direction, so the iteration still goes downhill.
            let translation = limited(DVec3::new(by[0], by[1], by[2]), MAX_STEP * self.size);
            let rotation = limited(DVec3::new(by[3], by[4], by[5]), MAX_STEP);
            let turn = Pose::from_rotation_vector(rotation, DVec3::ZERO);
            // About the centre: z ↦ R (z − c) + c + τ.
            let motion =
                Pose { translation: translation + (error.center - turn.rotate(error.center)), ..turn };
            // The caller moves the readings by the same motion, so that poses and readings agree.
            error.now = motion.after(&error.now);
            error.viewing = moved_viewing(error.viewing, &motion);
            *moved = Some(motion);
        }
        (self.of_scan.iter()).map(|error| error.and_then(|e| moved[e])).collect()
    }

    /// The motion of each scan from its stated pose to the current one, for other observations of the same
    /// set.
    pub(crate) fn motions(&self) -> Vec<Option<Pose>> {
        (self.of_scan.iter())
            .map(|error| {
                error
                    .map(|e| &self.errors[e])
                    .filter(|error| error.moves())
                    .map(|error| error.now.after(&error.stated.inverse()))
            })
            .collect()
    }
}
