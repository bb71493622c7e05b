//! What all readings of one scan err in together: where the scan stands, and what its sensor adds to every
//! range.
//!
//! Comes in: scans whose pose or bias has a σ. Goes out: up to seven unknowns for each of them, `τ` and `ω`
//! of a motion and a bias `b`, that are part of the state beside the control vertices, their coupling with
//! these, and their covariance. A reading's residual changes with them by
//!
//! ```text
//! position    ∂r/∂τ = n      ∂r/∂ω = (z − c) × n      ∂r/∂b = −n·d
//! ```
//!
//! with the foot's normal `n`, a centre `c` that the motion turns about, and the ray `d`. What the paper
//! calls the registration of views is this part of the state; correlated noise is a low-rank term, not a
//! matrix over all readings.
//!
//! Not guaranteed: that scans which start far from where they belong find there. The motion is linearised at
//! every iteration and follows the slope of the residuals.

use crate::model::{PoseReport, SharedInformation, SurfaceModel};
use crate::observe::{Foot, FootChannels};
use crate::observe::{Measured, Observations, Quantity, moved_viewing};
use planish_estimate::Result;
use planish_estimate::sparse::{Bordered, CholeskyFactor};
use planish_estimate::vector3::{add, add_scaled, cross, distance, dot, norm, scale, sub};
use planish_exchange::ScanSet;
use planish_mesh::BoundingBox;
use planish_sense::{Pose, Viewing, ray_at};
use planish_spline::Surface;
use rayon::prelude::*;

/// Unknowns of one scan: a translation, a rotation, a bias.
const UNKNOWNS: usize = 7;
const ROTATION: usize = 3;
const BIAS: usize = 6;
/// σ of the rotation of a scan of which nothing is known but its rough place, in radians; that of its place
/// is the cloud's size.
const FREE_ROTATION: f64 = 1.0;
/// A scan moves no farther in one iteration than this share of the cloud's size, and turns by no more
/// radians.
const LONGEST_STEP: f64 = 0.1;
/// Readings that took away less than this share of the variance from a direction do not determine it.
const DETERMINED: f64 = 0.05;
/// Rotation by which the change of directions is found by differences, in radians.
const DIFFERENCE: f64 = 1e-5;

/// Changes of the residuals of one reading with the unknowns of its scan.
type Rows = [[f64; UNKNOWNS]; 3];

/// The unknowns of one scan.
#[derive(Debug, Clone)]
pub(crate) struct SharedError {
    /// The scan, among those of the set.
    pub scan: usize,
    /// Which of the seven unknowns it has.
    unknowns: Vec<usize>,
    /// σ of translation, rotation and bias; zero where exact.
    sigmas: [f64; 3],
    /// What the motion turns about.
    center: [f64; 3],
    /// The pose as stated, as it is now, and the bias.
    stated: Pose,
    pub now: Pose,
    pub bias: f64,
    /// How the sensor looks, in the world as it is now.
    viewing: Viewing,
}

/// All of them.
#[derive(Debug, Clone, Default)]
pub(crate) struct SharedErrors {
    pub errors: Vec<SharedError>,
    /// For each scan of the set its error.
    of_scan: Vec<Option<usize>>,
    /// The size of the cloud.
    size: f64,
    /// What the scans of earlier sessions share: the first of all unknowns.
    earlier: Option<EarlierShared>,
}

/// What the scans of earlier sessions share: about where their model was, and how far they have come from
/// there.
#[derive(Debug, Clone)]
struct EarlierShared {
    information: SharedInformation,
    vertices: Vec<[f64; 3]>,
    moved: Vec<f64>,
}

impl EarlierShared {
    fn width(&self) -> usize {
        self.moved.len()
    }

    /// `Cᵀ s + P δ` of the vertices' way `s` along their normals, and `C δ`.
    fn products(&self, surface: &Surface, directions: &[[f64; 3]]) -> (Vec<f64>, Vec<f64>) {
        let SharedInformation { coupling, corner } = &self.information;
        let m = self.width();
        let mut of_shared: Vec<f64> = (corner.chunks_exact(m))
            .map(|row| row.iter().zip(&self.moved).map(|(p, d)| p * d).sum())
            .collect();
        let ways = (surface.vertices().iter().zip(&self.vertices).zip(directions))
            .map(|((x, x0), d)| dot(sub(*x, *x0), *d));
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

impl SharedError {
    fn width(&self) -> usize {
        self.unknowns.len()
    }

    fn moves(&self) -> bool {
        self.unknowns.iter().any(|&k| k < BIAS)
    }

    /// The rotation from the stated pose, and the motion of the scanner's origin.
    fn deviation(&self) -> [f64; UNKNOWNS] {
        let turn = Pose { translation: [0.0; 3], ..self.now }
            .after(&Pose { translation: [0.0; 3], ..self.stated.inverse() });
        let t = sub(self.now.translation, self.stated.translation);
        let w = turn.rotation_vector();
        [t[0], t[1], t[2], w[0], w[1], w[2], self.bias]
    }

    /// How the deviation from what was stated changes with the unknowns: a turn about the centre moves the
    /// scanner's origin.
    fn derivative(&self) -> [[f64; UNKNOWNS]; UNKNOWNS] {
        let mut d = [[0.0; UNKNOWNS]; UNKNOWNS];
        for (k, row) in d.iter_mut().enumerate() {
            row[k] = 1.0;
        }
        let arm = sub(self.now.translation, self.center);
        for axis in 0..3 {
            let mut turn = [0.0; 3];
            turn[axis] = 1.0;
            let moved = cross(turn, arm);
            for k in 0..3 {
                d[k][ROTATION + axis] = moved[k];
            }
        }
        d
    }

    /// 1/σ² of each of the seven; nothing of those that are exact, as they do not move.
    fn stated_information(&self) -> [f64; UNKNOWNS] {
        std::array::from_fn(|k| {
            let sigma = self.sigmas[(k / 3).min(2)];
            if sigma > 0.0 { 1.0 / (sigma * sigma) } else { 0.0 }
        })
    }

    /// What was stated, as information about the unknowns and its pull on them.
    fn prior(&self) -> (Vec<f64>, Vec<f64>) {
        let (j, w, e) = (self.derivative(), self.stated_information(), self.deviation());
        let of = |a: usize, b: usize| (0..UNKNOWNS).map(|k| j[k][a] * w[k] * j[k][b]).sum::<f64>();
        let pull = |a: usize| -(0..UNKNOWNS).map(|k| j[k][a] * w[k] * e[k]).sum::<f64>();
        let own = || self.unknowns.iter().copied();
        (own().flat_map(|a| own().map(move |b| of(a, b))).collect(), own().map(pull).collect())
    }

    /// The ray through a point, where it is known.
    fn ray(&self, p: [f64; 3]) -> Option<[f64; 3]> {
        ray_at(self.viewing, p)
    }

    /// Change of the residual of a position with all seven, linear in the normal `n`; where no ray is known
    /// it is taken along the surface's.
    fn position_row(&self, point: [f64; 3], n: [f64; 3], normal: [f64; 3]) -> [f64; UNKNOWNS] {
        let turn = cross(sub(point, self.center), n);
        let along = dot(n, self.ray(point).unwrap_or(normal));
        [n[0], n[1], n[2], turn[0], turn[1], turn[2], -along]
    }

    /// Changes of the residuals of a reading with all seven.
    fn rows(&self, surface: &Surface, foot: &Foot, point: [f64; 3], measured: &Measured) -> Rows {
        let mut rows = Rows::default();
        match measured {
            Measured::Position => {
                rows[0] = self.position_row(point, foot.normal, foot.normal);
            }
            Measured::Normal(_) | Measured::Curvature(_) => {
                for axis in 0..3 {
                    let turned = |by: f64| {
                        let mut omega = [0.0; 3];
                        omega[axis] = by;
                        foot.directional(
                            surface,
                            &measured.turned(&Pose::from_rotation_vector(omega, [0.0; 3])),
                        )
                    };
                    if let (Some(more), Some(less)) = (turned(DIFFERENCE), turned(-DIFFERENCE)) {
                        for r in 0..3 {
                            rows[r][ROTATION + axis] = (more[r] - less[r]) / (2.0 * DIFFERENCE);
                        }
                    }
                }
            }
        }
        rows
    }
}

impl SharedErrors {
    /// The unknowns of scans with a stated σ of pose or bias; with `align` those of all others, too, but for
    /// the first of them where no earlier model is there to stand by.
    pub(crate) fn new(
        set: &ScanSet,
        observations: &Observations,
        origin: [f64; 3],
        align: bool,
        earlier: Option<&SurfaceModel>,
    ) -> Self {
        let size = BoundingBox::from_points(&observations.points).map_or(0.0, |b| b.diagonal());
        let mut made = Self {
            of_scan: vec![None; observations.channel_of_scan.len()],
            size,
            earlier: earlier.and_then(|model| {
                let information = model.shared.clone()?;
                Some(EarlierShared {
                    moved: vec![0.0; information.corner.len().isqrt()],
                    vertices: model.surface.vertices().to_vec(),
                    information,
                })
            }),
            ..Self::default()
        };
        let mut sums = vec![([0.0; 3], 0_usize); set.scans.len()];
        for (p, &s) in observations.points.iter().zip(&observations.scan) {
            if let Some((sum, count)) = sums.get_mut(observations.base_scan(s as usize)) {
                (*sum, *count) = (add(*sum, *p), *count + 1);
            }
        }
        let mut anchored = earlier.is_some();
        for (s, posed) in set.scans.iter().enumerate() {
            let (sum, count) = sums[s];
            let states_none = posed.sigma_translation.is_none() && posed.sigma_rotation_deg.is_none();
            let is_free = align && states_none && anchored;
            anchored |= states_none;
            let sigmas = [
                posed.sigma_translation.or(is_free.then_some(size)),
                (posed.sigma_rotation_deg.map(f64::to_radians)).or(is_free.then_some(FREE_ROTATION)),
                set.sensors[posed.sensor].sigma_bias,
            ]
            .map(|sigma| sigma.unwrap_or(0.0));
            let unknowns: Vec<usize> = (0..UNKNOWNS).filter(|k| sigmas[(k / 3).min(2)] > 0.0).collect();
            if unknowns.is_empty() || count == 0 {
                continue;
            }
            let mut stated = posed.scan.world_from_scanner;
            stated.translation = sub(stated.translation, origin);
            made.of_scan[s] = Some(made.errors.len());
            made.errors.push(SharedError {
                scan: s,
                center: if sigmas[0] > 0.0 {
                    sum.map(|c| c / count as f64)
                } else {
                    // Its place is exact: it turns about it.
                    stated.translation
                },
                unknowns,
                sigmas,
                stated,
                now: stated,
                bias: 0.0,
                viewing: observations.viewing(s),
            });
        }
        for s in set.scans.len()..made.of_scan.len() {
            made.of_scan[s] = made.of_scan[observations.base_scan(s)];
        }
        made
    }

    /// One more scan of the observations that has none.
    pub(crate) fn add_fixed_scan(&mut self) {
        self.of_scan.push(None);
    }

    /// Whether no scan has any.
    pub(crate) fn is_empty(&self) -> bool {
        self.errors.is_empty() && self.earlier.is_none()
    }

    /// How many unknowns are of earlier sessions.
    fn earlier_width(&self) -> usize {
        self.earlier.as_ref().map_or(0, EarlierShared::width)
    }

    /// How many unknowns there are, those of earlier sessions first.
    fn width(&self) -> usize {
        self.earlier_width() + self.errors.iter().map(SharedError::width).sum::<usize>()
    }

    /// What is to be taken off the height of a position: the bias as far as it lies along the normal.
    #[inline]
    pub(crate) fn bias_along(&self, scan: u32, point: [f64; 3], normal: [f64; 3]) -> f64 {
        let Some(error) = self.of_scan.get(scan as usize).copied().flatten() else {
            return 0.0;
        };
        let error = &self.errors[error];
        if error.bias == 0.0 {
            return 0.0;
        }
        error.bias * error.ray(point).map_or(1.0, |d| dot(normal, d))
    }

    /// Changes the unknowns by a step, and says how each scan of the observations is moved by it.
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
            let most = |v: [f64; 3], longest: f64| {
                let length = norm(v);
                if length > longest { v.map(|c| c * longest / length) } else { v }
            };
            let translation = most([by[0], by[1], by[2]], LONGEST_STEP * self.size);
            let rotation = most([by[3], by[4], by[5]], LONGEST_STEP);
            let turn = Pose::from_rotation_vector(rotation, [0.0; 3]);
            // About the centre: z ↦ R (z − c) + c + τ.
            let motion =
                Pose { translation: add(translation, sub(error.center, turn.rotate(error.center))), ..turn };
            error.now = motion.after(&error.now);
            error.viewing = moved_viewing(error.viewing, &motion);
            *moved = Some(motion);
        }
        (self.of_scan.iter()).map(|error| error.and_then(|e| moved[e])).collect()
    }

    /// The motions from where scans were stated to stand to where they stand now, for those of other
    /// observations of the same set.
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

    /// Information of the readings about the unknowns and their coupling with the vertices.
    pub(crate) fn equations(&self, at: &Linearized<'_>) -> SharedEquations {
        let mut made = self.of_readings(at, |error, foot, i| {
            let observations = at.channels.observations;
            error.rows(at.surface, foot, observations.points[i], &observations.measured(i))
        });
        let width = self.width();
        if let Some(earlier) = &self.earlier {
            let m = earlier.width();
            for (row, part) in
                (made.coupling.chunks_exact_mut(width)).zip(earlier.information.coupling.chunks_exact(m))
            {
                row[..m].copy_from_slice(part);
            }
            put_block(&mut made.corner, width, 0, &earlier.information.corner, m);
            put_block(&mut made.prior, width, 0, &earlier.information.corner, m);
            let (of_shared, of_vertices) = earlier.products(at.surface, at.directions);
            for (g, product) in made.gradient.iter_mut().zip(of_shared) {
                *g = -product;
            }
            made.pull = of_vertices.iter().map(|product| -product).collect();
        }
        let mut start = self.earlier_width();
        for error in &self.errors {
            let (m, (prior, pull)) = (error.width(), error.prior());
            for a in 0..m {
                for b in 0..m {
                    made.corner[(start + a) * width + start + b] += prior[a * m + b];
                }
                made.gradient[start + a] += pull[a];
            }
            put_block(&mut made.prior, width, start, &prior, m);
            start += m;
        }
        made
    }

    /// The same of readings alone, each with its rows; nothing of what was stated, nor of earlier sessions.
    fn of_readings(
        &self,
        at: &Linearized<'_>,
        rows: impl Fn(&SharedError, &Foot, usize) -> Rows + Sync,
    ) -> SharedEquations {
        let own = self.readings(at.information, at.channels);
        // Scan by scan: each has columns of its own.
        let parts: Vec<_> = (self.errors.par_iter().zip(&own))
            .map(|(error, own)| error.equations(at, own, |foot, i| rows(error, foot, i)))
            .collect();
        let (mut start, width) = (self.earlier_width(), self.width());
        let mut made = SharedEquations::zeros(at.surface.space().node_count(), width);
        for (error, part) in self.errors.iter().zip(parts) {
            let m = error.width();
            for (row, part) in made.coupling.chunks_exact_mut(width).zip(part.coupling.chunks_exact(m)) {
                row[start..start + m].copy_from_slice(part);
            }
            put_block(&mut made.corner, width, start, &part.corner, m);
            made.gradient[start..start + m].copy_from_slice(&part.gradient);
            start += m;
        }
        made
    }

    /// What noise of the surface alone seems to say of the poses, the surface left open: the mean over draws
    /// of its noise of `P − Cᵀ A⁻¹ C` with the rows `J δn` of what the noise adds to the normals at the feet,
    /// `J = ∂(n, (z − c) × n)/∂n`.
    ///
    /// The rows of a pose are made with the normals of the estimated surface. On a sphere each true row of a
    /// rotation is zero; those of its noisy estimate are not, and would count as information that nobody has,
    /// whatever the σ: more noise makes more of it. What of it the surface itself takes up, as it would of
    /// true rows, counts for nothing in either. There are so many `parts` of the readings as those at hand.
    pub(crate) fn noise_information(
        &self,
        at: &Linearized<'_>,
        factor: &CholeskyFactor,
        noise: &[Vec<[[f64; 3]; 16]>],
        parts: f64,
    ) -> Result<Vec<f64>> {
        let mut mean = vec![0.0; self.width() * self.width()];
        for drawn in noise {
            let equations = self.of_readings(at, |error, foot, i| {
                error.noise_rows(at.surface, drawn, foot, at.channels.observations.points[i])
            });
            let SharedInformation { coupling, corner } = equations.into_information(parts);
            for (mean, seen) in mean.iter_mut().zip(Bordered::complement_of(factor, &coupling, &corner)?) {
                *mean += seen / noise.len() as f64;
            }
        }
        Ok(mean)
    }

    /// The readings of each error's scan that take part.
    fn readings(&self, information: &[f64], channels: &FootChannels<'_>) -> Vec<Vec<u32>> {
        let mut own: Vec<Vec<u32>> = vec![Vec::new(); self.errors.len()];
        for (k, (&i, &w)) in channels.subset.iter().zip(information).enumerate() {
            let scan = channels.observations.scan[i as usize] as usize;
            if w > 0.0
                && let Some(error) = self.of_scan[scan]
            {
                own[error].push(k as u32);
            }
        }
        own
    }

    /// σ of every scan's pose and bias from the reduced equations.
    pub(crate) fn estimates(&self, bordered: &Bordered, prior: &[f64]) -> Result<Vec<SharedEstimate>> {
        let covariance = bordered.shared_covariance();
        let width = bordered.shared();
        let mut start = self.earlier_width();
        (self.errors.iter())
            .map(|error| {
                let j = error.derivative();
                let m = error.width();
                // Of the deviation from the stated pose: what a job file would state.
                let of = |a: usize, b: usize| -> f64 {
                    let (rows, columns) = (&j[a], &j[b]);
                    (0..m)
                        .flat_map(|p| (0..m).map(move |q| (p, q)))
                        .map(|(p, q)| {
                            rows[error.unknowns[p]]
                                * covariance[(start + p) * width + start + q]
                                * columns[error.unknowns[q]]
                        })
                        .sum()
                };
                let pose: [[f64; 6]; 6] = std::array::from_fn(|a| std::array::from_fn(|b| of(a, b)));
                let own: Vec<f64> =
                    (0..m * m).map(|k| prior[(start + k / m) * width + start + k % m]).collect();
                let directions = bordered.undetermined(start..start + m, &own, DETERMINED)?;
                let of_pose = |v: &Vec<f64>| -> [f64; 6] {
                    std::array::from_fn(|a| error.unknowns.iter().zip(v).map(|(&k, v)| j[a][k] * v).sum())
                };
                let made = SharedEstimate {
                    scan: error.scan,
                    stated: error.stated,
                    pose: error.now,
                    covariance: error.moves().then_some(pose),
                    undetermined: directions.iter().map(of_pose).collect(),
                    bias: (error.unknowns.contains(&BIAS))
                        .then(|| (error.bias, of(BIAS, BIAS).max(0.0).sqrt())),
                };
                start += m;
                Ok(made)
            })
            .collect()
    }
}

/// What a fit found of one scan.
#[derive(Debug, Clone)]
pub(crate) struct SharedEstimate {
    pub scan: usize,
    /// As it was stated and as it is.
    stated: Pose,
    pub pose: Pose,
    /// Of translation and rotation vector about the world's axes, where it has any.
    pub covariance: Option<[[f64; 6]; 6]>,
    /// Directions that the readings do not determine, each as long as one σ of what was known before.
    pub undetermined: Vec<[f64; 6]>,
    /// The bias and its σ.
    pub bias: Option<(f64, f64)>,
}

impl SharedEstimate {
    /// Fills in the report of the scan; `origin` is where that of the estimate lies in the world.
    pub(crate) fn report(&self, report: &mut PoseReport, origin: [f64; 3], observations: &Observations) {
        if let Some(covariance) = &self.covariance {
            let back = self.stated.after(&self.pose.inverse());
            let own = (observations.points.iter().zip(&observations.scan))
                .filter(|(_, s)| **s as usize == self.scan);
            let (sum, count) = own.fold((0.0, 0), |(sum, count), (p, _)| {
                (sum + distance(back.apply(*p), *p).powi(2), count + 1)
            });
            report.moved = Some((sum / f64::from(count.max(1))).sqrt());
            report.turned_deg = Some(norm(back.rotation_vector()).to_degrees());
            report.translation = add(self.pose.translation, origin);
            report.quaternion_xyzw = self.pose.quaternion_xyzw();
            report.set_covariance(*covariance);
            report.undetermined.clone_from(&self.undetermined);
        }
        if let Some((bias, sigma)) = self.bias {
            (report.bias, report.sigma_bias) = (Some(bias), Some(sigma));
        }
    }
}

/// `[… C; Cᵀ P] [x; p] = [… ; h]`: what readings say of the shared unknowns.
pub(crate) struct SharedEquations {
    /// `C`, nodes × unknowns.
    pub coupling: Vec<f64>,
    /// `P` with what was stated.
    pub corner: Vec<f64>,
    /// `h`.
    pub gradient: Vec<f64>,
    /// What was stated, alone.
    pub prior: Vec<f64>,
    /// What earlier sessions' unknowns add to the right-hand side of the vertices; empty where there are
    /// none.
    pub pull: Vec<f64>,
}

/// Where readings are linearised: feet on a surface whose vertices move along `directions`, each with its
/// information.
#[derive(Clone, Copy)]
pub(crate) struct Linearized<'a> {
    pub surface: &'a Surface,
    pub directions: &'a [[f64; 3]],
    pub feet: &'a [Foot],
    pub information: &'a [f64],
    pub channels: &'a FootChannels<'a>,
}

/// Writes a block of `m × m` on the diagonal of a matrix that is `width` wide.
fn put_block(matrix: &mut [f64], width: usize, start: usize, block: &[f64], m: usize) {
    for (a, row) in block.chunks_exact(m).enumerate() {
        matrix[(start + a) * width + start..][..m].copy_from_slice(row);
    }
}

impl SharedEquations {
    /// Nothing said of so many unknowns.
    fn zeros(nodes: usize, width: usize) -> Self {
        Self {
            coupling: vec![0.0; nodes * width],
            corner: vec![0.0; width * width],
            gradient: vec![0.0; width],
            prior: vec![0.0; width * width],
            pull: Vec::new(),
        }
    }

    /// As it goes into a model; readings like these were so many times as many.
    pub(crate) fn into_information(mut self, factor: f64) -> SharedInformation {
        self.coupling.iter_mut().for_each(|c| *c *= factor);
        for (p, prior) in self.corner.iter_mut().zip(&self.prior) {
            *p = factor * (*p - prior) + prior;
        }
        SharedInformation { coupling: self.coupling, corner: self.corner }
    }
}

impl SharedError {
    /// What the surface's noise adds to the [`Self::rows`] of a position: how the normal there is turned by
    /// it, both tangents together.
    fn noise_rows(&self, surface: &Surface, drawn: &[[[f64; 3]; 16]], foot: &Foot, point: [f64; 3]) -> Rows {
        let mut rows = Rows::default();
        let leaf = foot.leaf as usize;
        if let Some(frame) =
            surface.tangent_rows(leaf, foot.local).filter(|_| foot.quantity == Quantity::Position)
        {
            let [a, b] = [0, 1].map(|t| -> f64 {
                (frame.slopes[t].iter().zip(&drawn[leaf])).map(|(s, c)| s * dot(foot.normal, *c)).sum()
            });
            let turned = add_scaled(scale(a, frame.tangents[0]), b, frame.tangents[1]);
            rows[0] = self.position_row(point, turned, foot.normal);
        }
        rows
    }

    /// [`SharedErrors::equations`] of one scan, by its readings `own` with their `rows`.
    fn equations(
        &self,
        at: &Linearized<'_>,
        own: &[u32],
        rows: impl Fn(&Foot, usize) -> Rows,
    ) -> SharedEquations {
        let Linearized { surface, directions, feet, information, channels } = *at;
        let (space, m) = (surface.space(), self.width());
        let mut made = SharedEquations::zeros(space.node_count(), m);
        for &k in own {
            let (foot, w) = (&feet[k as usize], information[k as usize]);
            let rows = rows(foot, channels.subset[k as usize] as usize);
            let (nodes, weights) = space.extraction(foot.leaf as usize);
            foot.rows(surface, |r, over_leaf| {
                let row: Vec<f64> = self.unknowns.iter().map(|&k| rows[r][k]).collect();
                let residual = foot.residuals()[r];
                for (a, ra) in row.iter().enumerate() {
                    made.gradient[a] -= w * ra * residual;
                    for (b, rb) in row.iter().enumerate() {
                        made.corner[a * m + b] += w * ra * rb;
                    }
                }
                for (&node, weights) in nodes.iter().zip(weights) {
                    let along: f64 = weights.iter().zip(over_leaf).map(|(w, c)| w * c).sum();
                    let of_node = w * along * dot(foot.normal, directions[node as usize]);
                    if of_node != 0.0 {
                        for (c, r) in made.coupling[node as usize * m..].iter_mut().zip(&row) {
                            *c -= of_node * r;
                        }
                    }
                }
            });
        }
        made
    }
}
