//! Alignment of patches before they are merged.
//!
//! Input: patches whose frames agree except for small motions, with consistent orientation. Output: the
//! patches in the frame of the first, and the motion of each with its covariance.
//!
//! Every vertex `p` of a patch `i` that overlaps a patch `j` gives one residual: the distance to the foot
//! point `q` along the normal (point to plane, Y. Chen, G. Medioni 1992),
//!
//! ```text
//! r = n · (p − q),   ∂r/∂ξ_i = (n, (p − c_i) × n),   ∂r/∂ξ_j = −(n, (p − c_j) × n),
//! ξ = (translation, rotation vector) about the patch's centroid c
//! ```
//!
//! All pairs are solved together (K. Pulli 1999) by Gauss-Newton steps with a redescending loss. A vertex
//! represents its area `A`. Its residual has the weight `A / (σ_i² A + σ_j² a_j)`, where `a_j` is the area of
//! a vertex of the other patch. This is the information about a smooth difference of two samplings with
//! independent errors, and it does not grow if one patch is sampled more densely. Both directions of a pair
//! count half: each measures to the chords of the other patch, and the two chord errors have opposite signs.
//!
//! A weak prior ([`PosePrior`]) keeps patches in place along motions that do not change the overlaps. The
//! covariance of the motions is that of the normal equations times a factor for correlated errors (smoothed
//! patches, pose errors within a patch). The factor compares the variance of sums of residuals over regions
//! of space with that of independent errors.
//!
//! Not guaranteed: patches that are farther off than the prior allows may not be found. Patches stay rigid.

mod equations;

#[cfg(test)]
mod tests;

use equations::{Equations, Residual, excess_variance, residuals};
use nalgebra::{DMatrix, Matrix6};
use planish_core::Progress;
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_estimate::{Error, Result, median_magnitude_scale};
use planish_mesh::{BoundingBox, MergePatch, MeshSearch, Neighbours, TriangleMesh};
use planish_sense::Pose;
use planish_surface::model::ScanPoseReport;

/// Maximum number of vertices per patch. More of them only cost time: the weights do not depend on density.
const MAX_VERTICES: usize = 5000;
/// Minimum number of residuals of a patch: twice the six parameters of its motion.
const MIN_RESIDUALS: usize = 12;
/// Bound of the cost. An alignment that reaches it is reported as not converged.
const MAX_ROUNDS: u32 = 60;
/// Number of full Gauss-Newton steps. Later steps are averaged, because overlaps at borders change from step
/// to step.
const FULL_STEPS: f64 = 10.0;
/// Rounds of averaging normals with their neighbours.
const NORMAL_SMOOTHING_ROUNDS: usize = 2;
/// Minimum distance of a used vertex from the border, in edges.
const BORDER_EDGES: usize = 2;
/// The iteration has converged when a step is at most this many σ of every motion.
const CONVERGED: f64 = 0.05;
/// A direction is undetermined if its posterior variance is more than this fraction of its prior variance.
const MAX_VARIANCE_RATIO: f64 = 0.25;
/// Minimum scale of residuals relative to the size of all patches: the rounding of single-precision files.
const MIN_SCALE: f64 = 1e-7;
/// Maximum distance of aligned patches of one object, in σ. Without stated σ, the limit is one edge.
const MAX_DISTANCE: f64 = 5.0;
/// Number of undetermined directions from which a distant patch is an error. Planes and spheres leave three
/// directions open, and no overlap of real surfaces leaves more.
const MANY_UNDETERMINED: usize = 4;
/// Search distance for foot points, in scales of the residuals.
const REACH: f64 = 8.0;

/// σ of the initial poses of patches.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PosePrior {
    translation: f64,
    rotation_rad: f64,
}

impl PosePrior {
    /// 1 % of the diagonal of all patches, and 1°.
    fn from_size(size: f64) -> Self {
        Self { translation: 0.01 * size, rotation_rad: 1.0_f64.to_radians() }
    }

    fn sigma(&self, k: usize) -> f64 {
        if k < 3 { self.translation } else { self.rotation_rad }
    }
}

/// A patch during alignment.
struct Side<'a> {
    patch: &'a MergePatch,
    search: &'a MeshSearch,
    /// Smoothed normals of the vertices.
    normals: Vec<DVec3>,
    /// Whether a vertex is far enough from the border. Normals at the border use triangles of one side only,
    /// and scanners measure borders worst.
    within: Vec<bool>,
    /// Area of each vertex: a third of the area of its triangles.
    areas: Vec<f64>,
    /// Every `stride`-th vertex is used and represents `stride` vertices.
    stride: usize,
    middle: DVec3,
    /// Half the diagonal of the bounding box.
    radius: f64,
    pose: Pose,
}

impl Side<'_> {
    /// σ of a vertex, or 1 if the patch has none.
    fn sigma(&self, vertex: usize) -> f64 {
        self.patch.sigma.get(vertex).copied().unwrap_or(1.0)
    }
}

/// Moves all patches except the first so that overlaps agree. Returns the motion of each patch, and warnings.
///
/// # Errors
/// `Undetermined` if no patches overlap within reach, or if a patch stays far from its neighbours and hardly
/// any direction of its motion is determined; `Interrupted` on request.
pub(super) fn align(
    patches: &mut [MergePatch],
    searches: &mut [MeshSearch],
    names: &[String],
    progress: &dyn Progress,
) -> Result<(Vec<ScanPoseReport>, Vec<Finding>)> {
    let (motions, mut findings) = motions(patches, searches, names, progress)?;
    let mut reports = Vec::with_capacity(patches.len());
    for (k, (patch, motion)) in patches.iter_mut().zip(motions).enumerate() {
        let pose = motion.pose;
        let (mut square, count) = (0.0, patch.mesh.positions.len().max(1) as f64);
        for p in &mut patch.mesh.positions {
            // The reported motion is the rms over vertices: a translation alone would depend on the origin.
            let moved = pose.apply(*p);
            square += moved.distance(*p).powi(2) / count;
            *p = moved;
        }
        // The first patch does not move, so its search structure stays valid.
        if k > 0 {
            searches[k] = MeshSearch::try_new(&patch.mesh)?;
        }
        if let Some(covariance) = &motion.covariance {
            add_pose_variance(patch, covariance, pose.translation);
        }
        if !motion.undetermined.is_empty() {
            let text = format!(
                "the overlaps do not determine {} of the six directions of motion of {}: it was not moved \
                 along these (see `undetermined` of its pose); the overlap may be small, flat or round",
                motion.undetermined.len(),
                names[k]
            );
            findings.push(Finding::new(FindingCode::PoseUndetermined, text));
        }
        let mut report = ScanPoseReport {
            scan: names[k].clone(),
            translation: pose.translation.to_array(),
            quaternion_xyzw: pose.quaternion_xyzw(),
            undetermined: motion.undetermined,
            moved: (k > 0).then(|| square.sqrt()),
            turned_deg: (k > 0).then(|| pose.rotation_vector().length().to_degrees()),
            ..ScanPoseReport::default()
        };
        if let Some(covariance) = motion.covariance {
            report.set_covariance(covariance);
        }
        reports.push(report);
    }
    Ok((reports, findings))
}

/// Adds the pose's variance to the variance of each vertex along its normal. The later fusion treats it as
/// an independent error of each vertex.
fn add_pose_variance(patch: &mut MergePatch, covariance: &[[f64; 6]; 6], origin: DVec3) {
    if patch.sigma.is_empty() {
        return;
    }
    let normals = patch.mesh.vertex_normals();
    for ((p, n), sigma) in (patch.mesh.positions.iter().zip(normals)).zip(&mut patch.sigma) {
        let [a, b, c] = (*p - origin).cross(n).to_array();
        let row = [n[0], n[1], n[2], a, b, c];
        let variance: f64 = (0..36).map(|k| row[k / 6] * covariance[k / 6][k % 6] * row[k % 6]).sum();
        *sigma = sigma.hypot(variance.max(0.0).sqrt());
    }
}

/// The motion of one patch.
struct Motion {
    pose: Pose,
    /// Covariance of translation and rotation vector; none for a patch that was not moved.
    covariance: Option<[[f64; 6]; 6]>,
    /// Undetermined directions, each with the length of one σ of the prior.
    undetermined: Vec<[f64; 6]>,
}

/// Motions of all patches, and warnings.
fn motions(
    patches: &[MergePatch],
    searches: &[MeshSearch],
    names: &[String],
    progress: &dyn Progress,
) -> Result<(Vec<Motion>, Vec<Finding>)> {
    let mut sides: Vec<Side> =
        (patches.iter().zip(searches)).map(|(patch, search)| side(patch, search)).collect();
    let all = patches.iter().flat_map(|p| p.mesh.positions.iter().copied());
    let size = BoundingBox::around(all).map_or(0.0, |b| b.diagonal());
    let prior = PosePrior::from_size(size);
    let stated = patches.iter().all(|p| !p.sigma.is_empty());
    let spacing = (sides.iter())
        // Without stated σ, the spacing of vertices is the only scale of their distance.
        .map(|s| (s.patch.mesh.area() / s.patch.mesh.positions.len().max(1) as f64).sqrt())
        .fold(0.0, f64::max);
    let sigma = (sides.iter()).flat_map(|s| s.patch.sigma.iter().copied()).fold(0.0, f64::max);
    let min_reach = 2.0 * spacing + REACH * sigma;
    // Three σ of the prior: a translation, and a rotation at the end of the largest patch.
    let turn = sides.iter().map(|s| s.radius).fold(0.0, f64::max) * prior.rotation_rad;
    let mut reach = min_reach.max(3.0 * (prior.translation + turn));
    let mut findings = Vec::new();
    for round in 0_u32.. {
        progress.check("aligning", f64::from(round) / f64::from(MAX_ROUNDS))?;
        let rows = residuals(&sides, reach);
        let lengths: Vec<f64> = rows.iter().map(|r| r.distance).collect();
        let normalised: Vec<f64> = rows.iter().map(Residual::normalised).collect();
        if rows.len() < MIN_RESIDUALS {
            return Err(Error::undetermined(format!(
                "expected patches within {reach:.3} of each other, found none among {}: poses can be \
                 corrected by about 1 % of the size and 1°",
                patches.len()
            )));
        }
        // The scale never falls below a stated σ. Otherwise a good fit would reject correct residuals.
        let min_scale = if stated { 1.0 } else { MIN_SCALE * size };
        let scale = median_magnitude_scale(&normalised)?.max(min_scale);
        let equations = Equations::new(&sides, &rows, scale, &prior)?;
        let (step, largest) = equations.step(sides.len());
        // Foot points that appear and disappear at borders make full steps oscillate. A share of 1/n averages
        // the later ones.
        let share = (FULL_STEPS / f64::from(round + 1)).min(1.0);
        let largest = share * largest;
        let converged = largest <= CONVERGED;
        for (side, by) in sides.iter_mut().zip(&step) {
            let middle = side.middle_now();
            side.pose = about(by.map(|x| share * x), middle).after(&side.pose);
        }
        // The reach only shrinks: a larger one would bring back pairs of different surfaces.
        reach = (REACH * median_magnitude_scale(&lengths)?).max(min_reach).min(reach);
        if converged || round + 1 == MAX_ROUNDS {
            if !converged {
                findings.push(Finding::new(
                    FindingCode::NotConverged,
                    format!(
                        "the alignment did not converge in {MAX_ROUNDS} rounds: the last step was \
                     {largest:.2} σ of a pose"
                    ),
                ));
            }
            let covariances = equations.covariances(excess_variance(&rows, scale, size, stated));
            let motions: Vec<Motion> =
                (0..sides.len()).map(|k| motion(k, &sides, &rows, &covariances, &prior)).collect();
            findings.extend(unaligned(&sides, &rows, names));
            // A patch that is still far from its neighbours is not a part of the object.
            for (k, motion) in motions.iter().enumerate().skip(1) {
                let (distance, normalised) = distance_scales(k, &rows)?;
                let how = match stated {
                    true if normalised > MAX_DISTANCE => {
                        format!("{distance:.3} apart ({normalised:.0} σ of their difference)")
                    }
                    false if distance > spacing => {
                        format!("{distance:.3} apart (more than the length of an edge)")
                    }
                    _ => continue,
                };
                if motion.undetermined.len() >= MANY_UNDETERMINED {
                    return Err(Error::undetermined(format!(
                        "{} cannot be aligned: it and the patches near it are {how}, and the overlap \
                         determines only {} of the six directions of its motion; check that it belongs to \
                         the same object, that frame and unit are the same, and that its σ is correct",
                        names[k],
                        6 - motion.undetermined.len()
                    ))
                    .with_setting(Setting::Unit));
                }
                findings.push(Finding::new(
                    FindingCode::AlignmentMisfit,
                    format!(
                        "{} and the patches near it are still {how} after the alignment: it may belong to \
                         another object or have another unit, or its σ is too small",
                        names[k]
                    ),
                ));
            }
            return Ok((motions, findings));
        }
    }
    unreachable!("the last round returns")
}

/// Messages about patches with too few residuals.
fn unaligned<'a>(
    sides: &'a [Side],
    rows: &'a [Residual],
    names: &'a [String],
) -> impl Iterator<Item = Finding> + 'a {
    (1..sides.len()).filter(|k| residual_count(*k, rows) < MIN_RESIDUALS).map(|k| {
        let text = format!("{} has no other patch within the search distance: it was not aligned", names[k]);
        Finding::new(FindingCode::PatchNotAligned, text)
    })
}

/// Robust scale of the distances between a patch and others: as a length, and in σ if they are stated. Zero
/// without overlap.
fn distance_scales(k: usize, rows: &[Residual]) -> Result<(f64, f64)> {
    // Both directions count: a small patch has few vertices, but the others have many beside it.
    let own_residuals = || rows.iter().filter(|r| r.patch == k || r.other == k);
    let off: Vec<f64> = own_residuals().map(|r| r.distance).collect();
    if off.is_empty() {
        return Ok((0.0, 0.0));
    }
    let normalised: Vec<f64> = own_residuals().map(Residual::normalised).collect();
    Ok((median_magnitude_scale(&off)?, median_magnitude_scale(&normalised)?))
}

fn residual_count(k: usize, rows: &[Residual]) -> usize {
    rows.iter().filter(|r| r.patch == k || r.other == k).count()
}

fn motion(
    k: usize,
    sides: &[Side],
    rows: &[Residual],
    covariances: &DMatrix<f64>,
    prior: &PosePrior,
) -> Motion {
    let pose = sides[k].pose;
    // The frame is that of patch 0, and a patch with too few residuals has only its prior.
    if k == 0 || residual_count(k, rows) < MIN_RESIDUALS {
        return Motion { pose, covariance: None, undetermined: Vec::new() };
    }
    let start = 6 * (k - 1);
    let about_middle = Matrix6::from_fn(|a, b| covariances[(start + a, start + b)]);
    // The covariance is that of a rotation about the centre; in the frame of the pose, rotation also moves
    // the origin.
    let arm = pose.translation - sides[k].middle_now();
    let of_frame = |v: [f64; 6]| -> [f64; 6] {
        let [x, y, z, a, b, c] = v;
        let by = DVec3::new(a, b, c).cross(arm);
        [x + by[0], y + by[1], z + by[2], a, b, c]
    };
    // `T C Tᵀ` in two passes, with `T` the change of the centre of rotation.
    let columns: [[f64; 6]; 6] =
        std::array::from_fn(|b| of_frame(std::array::from_fn(|a| about_middle[(a, b)])));
    let rows_too: [[f64; 6]; 6] = std::array::from_fn(|a| of_frame(std::array::from_fn(|b| columns[b][a])));
    // Relative to the prior, translations and rotations have the same unit and can share one limit.
    let held = Matrix6::from_fn(|a, b| about_middle[(a, b)] / (prior.sigma(a) * prior.sigma(b)));
    let open = held.symmetric_eigen();
    let undetermined = (0..6)
        .filter(|v| open.eigenvalues[*v] > MAX_VARIANCE_RATIO)
        .map(|v| of_frame(std::array::from_fn(|a| prior.sigma(a) * open.eigenvectors[(a, v)])))
        .collect();
    Motion { pose, covariance: Some(rows_too), undetermined }
}

impl Side<'_> {
    fn middle_now(&self) -> DVec3 {
        self.pose.apply(self.middle)
    }
}

/// Motion by a translation and a rotation vector about a centre.
fn about(by: [f64; 6], middle: DVec3) -> Pose {
    let [x, y, z, a, b, c] = by;
    let turn = Pose::from_rotation_vector(DVec3::new(a, b, c), DVec3::ZERO);
    let turned = turn.rotate(middle);
    Pose {
        translation: DVec3::new(
            middle[0] - turned[0] + x,
            middle[1] - turned[1] + y,
            middle[2] - turned[2] + z,
        ),
        ..turn
    }
}

fn side<'a>(patch: &'a MergePatch, search: &'a MeshSearch) -> Side<'a> {
    let mesh = &patch.mesh;
    let bounds = mesh.bounding_box();
    let mut areas = vec![0.0; mesh.positions.len()];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        // A vertex represents a third of each of its triangles, so the areas add up to that of the mesh.
        let third = (b - a).cross(c - a).length() / 6.0;
        for v in t {
            areas[*v as usize] += third;
        }
    }
    let neighbours = Neighbours::from_mesh(mesh);
    Side {
        normals: smooth_normals(mesh, &neighbours),
        within: within_border(mesh, &neighbours),
        areas,
        stride: mesh.positions.len().div_ceil(MAX_VERTICES).max(1),
        middle: bounds.as_ref().map_or(DVec3::ZERO, BoundingBox::center),
        radius: bounds.as_ref().map_or(0.0, |b| 0.5 * b.diagonal()),
        pose: Pose::identity(),
        patch,
        search,
    }
}

/// Vertex normals, averaged with their neighbours. Noise of normals would appear as information about motions
/// along the surface.
fn smooth_normals(mesh: &TriangleMesh, neighbours: &Neighbours) -> Vec<DVec3> {
    let mut normals = mesh.vertex_normals();
    for _ in 0..NORMAL_SMOOTHING_ROUNDS {
        normals = (0..normals.len())
            .map(|v| {
                let around = neighbours.of_vertex(v as u32).iter().map(|n| normals[*n as usize]);
                around.fold(normals[v], |sum, n| sum + n).try_normalize().unwrap_or(normals[v])
            })
            .collect();
    }
    normals
}

/// Whether vertices are at least [`BORDER_EDGES`] edges from a border.
fn within_border(mesh: &TriangleMesh, neighbours: &Neighbours) -> Vec<bool> {
    // Each neighbour of an interior vertex appears in exactly two triangles.
    let closed = |v: usize| {
        let around = neighbours.of_vertex(v as u32);
        around.iter().all(|n| around.iter().filter(|m| *m == n).count() == 2)
    };
    let mut within: Vec<bool> = (0..mesh.positions.len()).map(closed).collect();
    for _ in 1..BORDER_EDGES {
        within = (0..within.len())
            .map(|v| within[v] && neighbours.of_vertex(v as u32).iter().all(|n| within[*n as usize]))
            .collect();
    }
    within
}
