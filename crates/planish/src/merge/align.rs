//! Patches a little off, brought together before they are merged.
//!
//! Input: patches in frames that agree but for small motions, all facing alike. Output: the same in the
//! frame of the first, and the motion of each with its covariance.
//!
//! Every vertex `p` of a patch `i` that lies on another, `j`, says how far both are apart along the normal
//! there (Y. Chen, G. Medioni 1992: point to plane),
//!
//! ```text
//! r = n · (p − q),   ∂r/∂ξ_i = (n, (p − c_i) × n),   ∂r/∂ξ_j = −(n, (p − c_j) × n),
//! ξ = (translation, rotation vector) about the patch's centroid c
//! ```
//!
//! and all pairs are brought to rest together, as K. Pulli (1999) asks, by Gauss-Newton steps with a
//! redescending loss. A vertex stands for its area `A`; what both patches say there is worth
//! `A / (σ_i² A + σ_j² a_j)`, `a_j` the area of a vertex of the other patch: so much is known of a smooth
//! difference of two samplings with independent errors, however many vertices one of them has. Both ways of
//! looking count half: each sees the other's triangles as chords, and the two errors of that are opposite.
//!
//! Beside what they say of one another, patches stay where they are by a [`Hold`]: a motion that leaves the
//! overlaps as they are is not made. The covariance of the motions is that of the equations, times how much
//! more the sums of residuals over regions of space vary than independent errors would: neighbours that err
//! alike (smoothed patches, poses within a patch) are told by that.
//!
//! Not guaranteed: that patches are found which stand farther off than the hold says; that a patch bends.

mod equations;

#[cfg(test)]
mod tests;

use equations::{Equations, Residual, excess_variance, residuals};
use nalgebra::{DMatrix, Matrix6};
use planish_core::Progress;
use planish_core::{Finding, FindingCode, Setting};
use planish_estimate::vector3::{add, cross, distance, norm, sub, unit};
use planish_estimate::{Error, Result, median_magnitude_scale};
use planish_mesh::{BoundingBox, MergePatch, MeshSearch, Neighbours, TriangleMesh};
use planish_sense::Pose;
use planish_surface::model::ScanPoseReport;

/// Vertices of a patch that are used, at most.
const MOST_VERTICES: usize = 5000;
/// A motion that leaves the residuals less than so many of its places apart is not told by them.
const LEAST_RESIDUALS: usize = 12;
const MOST_ROUNDS: u32 = 60;
/// So many steps are made whole.
const FULL_STEPS: f64 = 10.0;
/// So many times normals are averaged with their neighbours'.
const SMOOTHED: usize = 2;
/// Places nearer to a border than so many edges say nothing.
const FROM_BORDER: usize = 2;
/// A step that moves no place by more than so many of the smallest σ of a motion ends the search.
const AT_REST: f64 = 0.05;
/// A direction whose variance is more than this share of what was held before is open.
const DETERMINED: f64 = 0.25;
/// The least scale of residuals, as a share of the size of all patches: what rounding to single precision
/// does.
const LEAST_SCALE: f64 = 1e-7;
/// Patches that are parts of one object lie at most so many σ apart when they are aligned, and, where σ
/// is not stated, at most an edge.
const APART: f64 = 5.0;
/// Planes and balls leave three directions open, nothing that patches share leaves more.
const MOST_OPEN: usize = 4;
/// Places are sought within so many scales of the residuals.
const REACH: f64 = 8.0;

/// How far patches may stand off before they are aligned, as one σ.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Hold {
    translation: f64,
    rotation_rad: f64,
}

impl Hold {
    /// One percent of the diagonal of all patches, and one degree.
    fn from_size(size: f64) -> Self {
        Self { translation: 0.01 * size, rotation_rad: 1.0_f64.to_radians() }
    }

    fn sigma(&self, k: usize) -> f64 {
        if k < 3 { self.translation } else { self.rotation_rad }
    }
}

/// A patch as it takes part.
struct Side<'a> {
    patch: &'a MergePatch,
    search: &'a MeshSearch,
    /// Of the vertices, smoothed.
    normals: Vec<[f64; 3]>,
    /// Whether a vertex lies a few edges from the border: nearer ones know their normals from one side only,
    /// and scanners see them worst.
    within: Vec<bool>,
    /// The area of a vertex: a third of its triangles'.
    areas: Vec<f64>,
    /// Every so many-th vertex speaks, for so many of them.
    stride: usize,
    middle: [f64; 3],
    /// Half its diagonal.
    radius: f64,
    pose: Pose,
}

impl Side<'_> {
    /// σ of a vertex; one if none is known.
    fn sigma(&self, vertex: usize) -> f64 {
        self.patch.sigma.get(vertex).copied().unwrap_or(1.0)
    }
}

/// Moves all patches but the first to where they lie on one another. Gives the motion of each, and what a
/// user should know.
///
/// # Errors
/// `Undetermined` where nothing lies on anything within reach, or a patch is far from what is near it and
/// hardly any of its directions is told; `Interrupted` when told to stop.
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
            let moved = pose.apply(*p);
            square += distance(moved, *p).powi(2) / count;
            *p = moved;
        }
        if k > 0 {
            searches[k] = MeshSearch::try_new(&patch.mesh)?;
        }
        if let Some(covariance) = &motion.covariance {
            add_pose_variance(patch, covariance, pose.translation);
        }
        if !motion.undetermined.is_empty() {
            let text = format!(
                "the overlaps leave {} of the six directions of {} open: there it stays where it was (see \
                 `undetermined` of its pose); the overlap may be small, flat or round",
                motion.undetermined.len(),
                names[k]
            );
            findings.push(Finding::new(FindingCode::PoseUndetermined, text));
        }
        let mut report = ScanPoseReport {
            scan: names[k].clone(),
            translation: pose.translation,
            quaternion_xyzw: pose.quaternion_xyzw(),
            undetermined: motion.undetermined,
            moved: (k > 0).then(|| square.sqrt()),
            turned_deg: (k > 0).then(|| norm(pose.rotation_vector()).to_degrees()),
            ..ScanPoseReport::default()
        };
        if let Some(covariance) = motion.covariance {
            report.set_covariance(covariance);
        }
        reports.push(report);
    }
    Ok((reports, findings))
}

/// Adds to the variance along each vertex's normal what the pose is not known to. Where patches are fused
/// afterwards it counts like an error of each vertex alone.
fn add_pose_variance(patch: &mut MergePatch, covariance: &[[f64; 6]; 6], origin: [f64; 3]) {
    if patch.sigma.is_empty() {
        return;
    }
    let normals = patch.mesh.vertex_normals();
    for ((p, n), sigma) in (patch.mesh.positions.iter().zip(normals)).zip(&mut patch.sigma) {
        let [a, b, c] = cross(sub(*p, origin), n);
        let row = [n[0], n[1], n[2], a, b, c];
        let variance: f64 = (0..36).map(|k| row[k / 6] * covariance[k / 6][k % 6] * row[k % 6]).sum();
        *sigma = sigma.hypot(variance.max(0.0).sqrt());
    }
}

/// The motion of one patch.
struct Motion {
    pose: Pose,
    /// Of translation and rotation vector about the axes; none for what is held still.
    covariance: Option<[[f64; 6]; 6]>,
    /// Directions that stay open, each as long as one σ of the hold.
    undetermined: Vec<[f64; 6]>,
}

/// The motions of all patches, and what a user should know.
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
    let hold = Hold::from_size(size);
    let stated = patches.iter().all(|p| !p.sigma.is_empty());
    let spacing = (sides.iter())
        .map(|s| (s.patch.mesh.area() / s.patch.mesh.positions.len().max(1) as f64).sqrt())
        .fold(0.0, f64::max);
    let sigma = (sides.iter()).flat_map(|s| s.patch.sigma.iter().copied()).fold(0.0, f64::max);
    let least_reach = 2.0 * spacing + REACH * sigma;
    // Two σ of the hold of each of both, and what a turn does at the end of a patch.
    let turn = sides.iter().map(|s| s.radius).fold(0.0, f64::max) * hold.rotation_rad;
    let mut reach = least_reach.max(3.0 * (hold.translation + turn));
    let mut findings = Vec::new();
    for round in 0_u32.. {
        progress.check("aligning", f64::from(round) / f64::from(MOST_ROUNDS))?;
        let rows = residuals(&sides, reach);
        let lengths: Vec<f64> = rows.iter().map(|r| r.off).collect();
        let normalised: Vec<f64> = rows.iter().map(Residual::normalised).collect();
        if rows.len() < LEAST_RESIDUALS {
            return Err(Error::undetermined(format!(
                "no two of the {} patches lie within {reach:.3} of one another: patches are aligned that \
                 stand a percent of their size and a degree off",
                patches.len()
            )));
        }
        let least = if stated { 1.0 } else { LEAST_SCALE * size };
        let scale = median_magnitude_scale(&normalised)?.max(least);
        let equations = Equations::new(&sides, &rows, scale, &hold)?;
        let (step, largest) = equations.step(sides.len());
        // Feet that come and go at borders make steps go to and fro: later ones are averaged.
        let share = (FULL_STEPS / f64::from(round + 1)).min(1.0);
        let largest = share * largest;
        let at_rest = largest <= AT_REST;
        for (side, by) in sides.iter_mut().zip(&step) {
            let middle = side.middle_now();
            side.pose = about(by.map(|x| share * x), middle).after(&side.pose);
        }
        reach = (REACH * median_magnitude_scale(&lengths)?).max(least_reach).min(reach);
        if at_rest || round + 1 == MOST_ROUNDS {
            if !at_rest {
                findings.push(Finding::new(
                    FindingCode::NotConverged,
                    format!(
                        "the alignment did not converge in {MOST_ROUNDS} rounds: its last step was \
                     {largest:.2} σ of a pose"
                    ),
                ));
            }
            let covariances = equations.covariances(excess_variance(&rows, scale, size, stated));
            let motions: Vec<Motion> =
                (0..sides.len()).map(|k| motion(k, &sides, &rows, &covariances, &hold)).collect();
            findings.extend(unaligned(&sides, &rows, names));
            // How far a patch lies from its neighbours, in what it should at most.
            for (k, motion) in motions.iter().enumerate().skip(1) {
                let (off, normalised) = apart(k, &rows)?;
                let how = match stated {
                    true if normalised > APART => {
                        format!("{off:.3} apart, {normalised:.0} σ of their difference")
                    }
                    false if off > spacing => format!("{off:.3} apart, farther than edges are long"),
                    _ => continue,
                };
                if motion.undetermined.len() >= MOST_OPEN {
                    return Err(Error::undetermined(format!(
                        "{} cannot be aligned: what is near it on other patches is {how}, and tells {} of \
                         its six directions; check that it is of the same object, in the same frame and \
                         unit, and that its σ is true",
                        names[k],
                        6 - motion.undetermined.len()
                    ))
                    .with_setting(Setting::Unit));
                }
                findings.push(Finding::new(
                    FindingCode::AlignmentMisfit,
                    format!(
                        "{} and what is near it on other patches are still {how}: it is of another \
                     object, in another unit, or its σ is too small",
                        names[k]
                    ),
                ));
            }
            return Ok((motions, findings));
        }
    }
    unreachable!("the last round returns")
}

/// Patches that too little lies on.
fn unaligned<'a>(
    sides: &'a [Side],
    rows: &'a [Residual],
    names: &'a [String],
) -> impl Iterator<Item = Finding> + 'a {
    (1..sides.len()).filter(|k| residual_count(*k, rows) < LEAST_RESIDUALS).map(|k| {
        let text = format!("{} lies on no other patch within reach: it was not aligned", names[k]);
        Finding::new(FindingCode::PatchNotAligned, text)
    })
}

/// The scale of what is between a patch and others: as a length, and in σ where they are stated. Nothing
/// where it lies on none.
fn apart(k: usize, rows: &[Residual]) -> Result<(f64, f64)> {
    let mine = || rows.iter().filter(|r| r.here == k || r.there == k);
    let off: Vec<f64> = mine().map(|r| r.off).collect();
    if off.is_empty() {
        return Ok((0.0, 0.0));
    }
    let normalised: Vec<f64> = mine().map(Residual::normalised).collect();
    Ok((median_magnitude_scale(&off)?, median_magnitude_scale(&normalised)?))
}

fn residual_count(k: usize, rows: &[Residual]) -> usize {
    rows.iter().filter(|r| r.here == k || r.there == k).count()
}

fn motion(k: usize, sides: &[Side], rows: &[Residual], covariances: &DMatrix<f64>, hold: &Hold) -> Motion {
    let pose = sides[k].pose;
    if k == 0 || residual_count(k, rows) < LEAST_RESIDUALS {
        return Motion { pose, covariance: None, undetermined: Vec::new() };
    }
    let start = 6 * (k - 1);
    let about_middle = Matrix6::from_fn(|a, b| covariances[(start + a, start + b)]);
    // A turn about the middle moves the frame's origin, too.
    let arm = sub(pose.translation, sides[k].middle_now());
    let of_frame = |v: [f64; 6]| -> [f64; 6] {
        let [x, y, z, a, b, c] = v;
        let by = cross([a, b, c], arm);
        [x + by[0], y + by[1], z + by[2], a, b, c]
    };
    let columns: [[f64; 6]; 6] =
        std::array::from_fn(|b| of_frame(std::array::from_fn(|a| about_middle[(a, b)])));
    let rows_too: [[f64; 6]; 6] = std::array::from_fn(|a| of_frame(std::array::from_fn(|b| columns[b][a])));
    let held = Matrix6::from_fn(|a, b| about_middle[(a, b)] / (hold.sigma(a) * hold.sigma(b)));
    let open = held.symmetric_eigen();
    let undetermined = (0..6)
        .filter(|v| open.eigenvalues[*v] > DETERMINED)
        .map(|v| of_frame(std::array::from_fn(|a| hold.sigma(a) * open.eigenvectors[(a, v)])))
        .collect();
    Motion { pose, covariance: Some(rows_too), undetermined }
}

impl Side<'_> {
    fn middle_now(&self) -> [f64; 3] {
        self.pose.apply(self.middle)
    }
}

/// The motion by a translation and a turn about a place.
fn about(by: [f64; 6], middle: [f64; 3]) -> Pose {
    let [x, y, z, a, b, c] = by;
    let turn = Pose::from_rotation_vector([a, b, c], [0.0; 3]);
    let turned = turn.rotate(middle);
    Pose {
        translation: [middle[0] - turned[0] + x, middle[1] - turned[1] + y, middle[2] - turned[2] + z],
        ..turn
    }
}

fn side<'a>(patch: &'a MergePatch, search: &'a MeshSearch) -> Side<'a> {
    let mesh = &patch.mesh;
    let bounds = mesh.bounding_box();
    let mut areas = vec![0.0; mesh.positions.len()];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        let third = norm(cross(sub(b, a), sub(c, a))) / 6.0;
        for v in t {
            areas[*v as usize] += third;
        }
    }
    let neighbours = Neighbours::from_mesh(mesh);
    Side {
        normals: smooth_normals(mesh, &neighbours),
        within: within_border(mesh, &neighbours),
        areas,
        stride: mesh.positions.len().div_ceil(MOST_VERTICES).max(1),
        middle: bounds.as_ref().map_or([0.0; 3], BoundingBox::center),
        radius: bounds.as_ref().map_or(0.0, |b| 0.5 * b.diagonal()),
        pose: Pose::identity(),
        patch,
        search,
    }
}

/// Normals of the vertices, averaged with their neighbours': their noise would seem to tell of motions along
/// the surface.
fn smooth_normals(mesh: &TriangleMesh, neighbours: &Neighbours) -> Vec<[f64; 3]> {
    let mut normals = mesh.vertex_normals();
    for _ in 0..SMOOTHED {
        normals = (0..normals.len())
            .map(|v| {
                let around = neighbours.of_vertex(v as u32).iter().map(|n| normals[*n as usize]);
                unit(around.fold(normals[v], add)).unwrap_or(normals[v])
            })
            .collect();
    }
    normals
}

/// Whether vertices are at least [`FROM_BORDER`] edges from a border.
fn within_border(mesh: &TriangleMesh, neighbours: &Neighbours) -> Vec<bool> {
    // Around a vertex inside, each neighbour is named by two triangles.
    let closed = |v: usize| {
        let around = neighbours.of_vertex(v as u32);
        around.iter().all(|n| around.iter().filter(|m| *m == n).count() == 2)
    };
    let mut within: Vec<bool> = (0..mesh.positions.len()).map(closed).collect();
    for _ in 1..FROM_BORDER {
        within = (0..within.len())
            .map(|v| within[v] && neighbours.of_vertex(v as u32).iter().all(|n| within[*n as usize]))
            .collect();
    }
    within
}
