//! Fits whose controls increase where the mesh does not follow its points.
//!
//! In: a mesh, points, and a function that makes a deformation of controls. Out: the fit with its deformation
//! and controls.
//!
//! A fit with few controls is followed by fits with more, each of which continues from the one before. The
//! points nearest to a control are its region. The mean product of the residuals of neighbours in a region is
//! the variance `m²` of shape that the mesh does not follow ([`super::support`]). Of `n` points with noise of
//! variance `s²` it has the σ `s² / √(n c/2)`, with `c` neighbours each. A region gets more controls if its
//! `m²` is significantly larger than zero, or if the fit rejects many of its points although they agree with
//! their neighbours. Its controls become closer by `√(m₀/m)`, because the error of interpolation falls with
//! the square of their distance.
//!
//! A fit replaces the one before if it is better ([`super::comparison`]).
//!
//! The remaining error of interpolation is estimated from the changes (L. F. Richardson, *The approximate
//! arithmetical solution by finite differences*, 1911): if each fit leaves the share `ρ` of the error of the
//! one before, a change `c` leaves `c ρ/(1 − ρ)`. The σ of unresolved shape is at least this. Residuals do
//! not show all of it, because it is largest where few points are: at tips, ears and fingers.
//!
//! If the first fit does not follow its points, another one begins in a pose in which parts turned far
//! ([`super::starts`]), with more controls; the better one counts.
//!
//! Not guaranteed: controls are vertices of the mesh, so a mesh that is coarser than the shape stays wrong.
//! Mistakes of correspondence, such as a part on the wrong side of a sheet, are not removed by more controls.

use super::comparison::is_better;
use super::landmarks::{median_distance, with_landmark_start};
use super::readings::ShellReadings;
use super::starts::{follows, other_start, parameters_at};
use super::support::VertexResiduals;
use super::{ResumePoint, ShellFit, ShellFitOptions, ShellProgress, fit_from_one_start};
use crate::controls::{ControlSampling, Controls};
use crate::deformation::{Deformation, Dirichlet, PosedDeformation, displacements};
use crate::point_tree::PointTree;
use crate::rigidity::Rigidity;
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::TriangleMesh;
use rayon::prelude::*;

/// Significance, in σ, from which a region gets more controls. In noise alone, one of 30,000 regions would.
const MIN_SIGNIFICANCE: f64 = 4.0;
/// Minimum share of points that agree with their neighbours but not with the mesh, from which a region gets
/// more controls, and their minimum number.
const MIN_UNFOLLOWED: (f64, u32) = (0.05, 3);
/// σ of shape that is aimed at, in σ of a point. Smaller values are significant only for very many points.
const SHAPE_GOAL: f64 = 0.3;
/// Smallest and largest ratio of the distances of controls after and before.
const CLOSER: (f64, f64) = (0.5, 0.8);
/// Minimum number of points for each new control. Fewer do not determine its three unknowns much better than
/// smoothness does.
const MIN_POINTS: f64 = 8.0;
/// Maximum number of fits after the first one.
const MAX_ROUNDS: usize = 5;
/// Share `ρ` of the error of interpolation that more controls leave. For distances of 0.6 and errors in the
/// square of the distance it is 0.36. With 1/3, 92 to 95 % of the vertices of three fits were within 1.96 σ;
/// without this term, 79 to 81 %.
const REMAINING_ERROR: f64 = 1.0 / 3.0;
/// Share of the points that the mesh does not follow, of those before a round, above which no more controls
/// are added.
const MIN_LEFT: f64 = 0.75;
/// Number of vertices over which squared changes are averaged. Single changes are zero by chance.
const CHANGE_NEIGHBOURS: usize = 12;
/// σ of a normal distribution over the median of its absolute values.
const SIGMA_OF_MEDIAN: f64 = 1.4826;
/// Numbers of controls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ControlGrowth {
    /// Number of controls of the first fit.
    pub initial: usize,
    /// Maximum number of controls. Time grows with the cube.
    pub max: usize,
}

impl Default for ControlGrowth {
    fn default() -> Self {
        Self { initial: 60, max: 400 }
    }
}

/// A deformation of controls with the energy of their displacements. The first parameters are the
/// displacements of the controls.
pub struct ControlledDeformation {
    /// The deformation.
    pub deformation: Box<dyn Deformation>,
    /// As [`ShellFitOptions::stiffness`].
    pub stiffness: Option<DMatrix<f64>>,
    /// As [`ShellFitOptions::rigidity`].
    pub rigidity: Option<Rigidity>,
}

/// A fit with its controls.
pub struct GrownFit {
    /// The fit.
    pub fit: ShellFit,
    /// Its deformation.
    pub deformation: Box<dyn Deformation>,
    /// Its controls.
    pub controls: Controls,
}

/// Where the iterations of a fit begin.
enum Begin {
    /// At the start of the options.
    Given,
    /// At the end of an earlier fit.
    Resume(ResumePoint),
}

/// A pose from which displacements count.
struct Start {
    positions: Vec<DVec3>,
    /// σ of each coordinate. The pose was found from the points, so that a fit that hardly differs from it
    /// where there are points is no evidence that it is right elsewhere.
    sigma: f64,
}

impl Start {
    /// A pose whose σ is that of its distances from the points.
    fn new(mesh: &TriangleMesh, positions: Vec<DVec3>, readings: &ShellReadings<'_>) -> Result<Self> {
        let sigma = SIGMA_OF_MEDIAN * median_distance(mesh, &positions, readings.points)?;
        Ok(Self { positions, sigma })
    }
}

/// Fits a mesh to readings with few controls first, and adds controls where the mesh does not follow its
/// points. Controls are chosen on the triangles of `controlled`, which has the vertices of the mesh.
///
/// `build` makes the deformation of given controls; stiffness and rigidity of the options are replaced.
///
/// # Errors
/// As [`super::fit_shell`], and errors of `build` and `watch`.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, SymmetricMatrix3};
/// use planish_mesh::icosphere;
/// use planish_shell::{ControlGrowth, ControlledDeformation, Dirichlet, PointReading, ShellFitOptions};
/// use planish_shell::{ShellReadings, fit_with_growing_controls, stiffness, stiffness_for_xyz};
/// let ball = icosphere(1.0, 4);
/// // Points of a ball with a bump on one side.
/// let bump = |p: &DVec3| (1.0 + 0.2 * (-(*p - DVec3::X).length_squared() / 0.05).exp()) * *p;
/// let points: Vec<PointReading> = (icosphere(1.0, 5).positions.iter())
///     .map(|p| PointReading { at: bump(p), covariance: SymmetricMatrix3::isotropic(1e-6) })
///     .collect();
/// let readings = ShellReadings { points: &points, ..ShellReadings::default() };
/// let made = fit_with_growing_controls(
///     &ball,
///     &ball,
///     &|controls| {
///         let k = stiffness(&controls.points, &controls.triangles, &controls.edges);
///         Ok(ControlledDeformation {
///             deformation: Box::new(Dirichlet::new(&controls.points, &ball.positions)?),
///             stiffness: Some(stiffness_for_xyz(&k)),
///             rigidity: None,
///         })
///     },
///     &readings,
///     &ShellFitOptions::default(),
///     ControlGrowth { initial: 20, max: 100 },
///     &mut |_| Ok(()),
/// )?;
/// // A sixteenth of the ball is that near to the bump; controls are denser there.
/// let near = made.controls.points.iter().filter(|p| p.distance(DVec3::X) < 0.5).count();
/// assert!(16 * near > made.controls.points.len(), "{near} of {}", made.controls.points.len());
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn fit_with_growing_controls(
    mesh: &TriangleMesh,
    controlled: &TriangleMesh,
    build: &dyn Fn(&Controls) -> Result<ControlledDeformation>,
    readings: &ShellReadings<'_>,
    options: &ShellFitOptions,
    growth: ControlGrowth,
    watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
) -> Result<GrownFit> {
    let mut sampling = ControlSampling::new(controlled, growth.initial, 0)?;
    let mut iterations = 0;
    let mut fit_of = |controls: &Controls, pose: Option<&Start>, begin: Begin, round: usize| {
        let mut made = build(controls)?;
        let has_parts = made.deformation.parameters() > 3 * controls.points.len();
        let counted = pose.filter(|_| !has_parts);
        if let Some(pose) = counted {
            made = in_pose(made, mesh, controls, &pose.positions);
        }
        let ControlledDeformation { deformation, stiffness, rigidity } = made;
        let resumes = matches!(begin, Begin::Resume(_));
        let start_sigma = counted.map(|pose| pose.sigma).or(options.start_sigma);
        let given = ShellFitOptions { stiffness, rigidity, start_sigma, ..options.clone() };
        let mut options = given.clone();
        match (begin, pose) {
            (Begin::Resume(resume), _) => options.resume = Some(resume),
            // A pose would deform rigid parts.
            (Begin::Given, Some(pose)) if has_parts => {
                options.initial = Some(parameters_at(mesh, &*deformation, &pose.positions)?);
            }
            (Begin::Given, None) => {
                options = with_landmark_start(mesh, &*deformation, readings, &given, watch)?;
            }
            _ => {}
        }
        let before = iterations;
        let fit = fit_from_one_start(mesh, &*deformation, readings, &options, &mut |at| {
            // The number of fits is unknown; each takes half of the remaining share.
            let share = 1.0 - 0.5_f64.powi(round as i32) * (1.0 - 0.5 * at.share);
            watch(ShellProgress { share, iteration: before + at.iteration, ..at })
        })?;
        iterations += fit.iterations;
        let other = match pose {
            None if !resumes => match other_start(mesh, readings, &given, &fit)? {
                Some(positions) => Some(Start::new(mesh, positions, readings)?),
                None => None,
            },
            _ => None,
        };
        Ok::<_, planish_estimate::Error>((deformation, fit, other))
    };
    let mut controls = sampling.controls();
    let (mut deformation, mut fit, mut pose) = fit_of(&controls, None, Begin::Given, 0)?;
    if let Some(found) = &pose {
        let (moved, turned, _) = fit_of(&controls, Some(found), Begin::Given, 1)?;
        // Shape that few controls cannot represent may look like a part that turned; more controls follow it.
        if is_better(&turned, &fit, 0) && 2 * turned.unfollowed_points <= fit.unfollowed_points {
            (deformation, fit) = (moved, turned);
        } else {
            pose = None;
        }
    }
    let mut errors = vec![0.0; mesh.positions.len()];
    for round in 1..=MAX_ROUNDS {
        let radii = wanted_radii(&sampling, &fit);
        let regions = sampling.regions().to_vec();
        let added = sampling.refine(&radii, growth.max.saturating_sub(sampling.count()));
        if added == 0 {
            break;
        }
        let next = sampling.controls();
        let resume = ResumePoint {
            parameters: transferred(&controls, &next, &fit.parameters)?,
            cameras: fit.cameras.clone(),
            smoothness_weight: fit.smoothness_weight,
        };
        let (moved, refined, _) = fit_of(&next, pose.as_ref(), Begin::Resume(resume), round)?;
        if !is_better(&refined, &fit, 3 * added) {
            break;
        }
        // More controls do not turn a part to its right position; each round only folds the mesh more.
        let gives_up =
            !follows(&refined) && refined.unfollowed_points as f64 > MIN_LEFT * fit.unfollowed_points as f64;
        let is_refined = |v: usize| regions.get(v) != sampling.regions().get(v);
        let changes = changes(mesh, &fit, &refined)?;
        for (v, (error, change)) in errors.iter_mut().zip(changes).enumerate() {
            let kept = if is_refined(v) { REMAINING_ERROR } else { 1.0 };
            *error = (change * REMAINING_ERROR / (1.0 - REMAINING_ERROR)).max(kept * *error);
        }
        (controls, deformation, fit) = (next, moved, refined);
        if gives_up {
            break;
        }
    }
    fit.iterations = iterations;
    for (sigma, error) in fit.unresolved_at.iter_mut().zip(errors) {
        *sigma = sigma.max(error);
    }
    Ok(GrownFit { fit, deformation, controls })
}

/// A deformation that counts from a pose of the vertices, with the energy of changes from it.
fn in_pose(
    made: ControlledDeformation,
    mesh: &TriangleMesh,
    controls: &Controls,
    pose: &[DVec3],
) -> ControlledDeformation {
    let of_controls = controls.vertices.iter().map(|v| pose[*v as usize]).collect();
    let by = pose.iter().zip(&mesh.positions).map(|(after, before)| *after - *before).collect();
    ControlledDeformation {
        deformation: Box::new(PosedDeformation { inner: made.deformation, pose: by }),
        rigidity: made.rigidity.map(|rigidity| rigidity.in_pose(of_controls)),
        ..made
    }
}

/// Radii of the regions of controls: smaller ones where the mesh does not follow its points, otherwise
/// infinite.
fn wanted_radii(sampling: &ControlSampling, fit: &ShellFit) -> Vec<f64> {
    let mut radii = sampling.radii();
    let mut regions = vec![VertexResiduals::default(); radii.len()];
    for (region, residuals) in sampling.regions().iter().zip(&fit.residuals_at) {
        if let Some(sum) = regions.get_mut(*region as usize) {
            sum.add(residuals);
        }
    }
    for (radius, region) in radii.iter_mut().zip(&regions) {
        *radius *= ratio_of_distances(region).unwrap_or(f64::INFINITY);
    }
    radii
}

/// Ratio of the distances of controls after and before, if a region needs more of them.
fn ratio_of_distances(region: &VertexResiduals) -> Option<f64> {
    let count = f64::from(region.points);
    let all = count + f64::from(region.unfollowed);
    let per = 1.0 / count.max(1.0);
    // Squares contain noise and shape, products shape only.
    let noise = (per * (region.squares - region.products)).max(f64::MIN_POSITIVE);
    let pairs = 0.5 * count * VertexResiduals::NEIGHBOURS as f64;
    let significance = per * region.products / noise * pairs.sqrt();
    let (share, minimum) = MIN_UNFOLLOWED;
    let rejects = region.unfollowed >= minimum && f64::from(region.unfollowed) >= share * all;
    if significance < MIN_SIGNIFICANCE && !rejects {
        return None;
    }
    let shape = (region.products.max(0.0) + region.unfollowed_squares) / all;
    let wanted = (SHAPE_GOAL * (noise / shape).sqrt()).sqrt().clamp(CLOSER.0, CLOSER.1);
    let possible = wanted.max((MIN_POINTS / all).sqrt());
    (possible <= CLOSER.1).then_some(possible)
}

/// The parameters of more controls that move the mesh as before. Those of the former controls come first;
/// parameters after those of controls stay as they are.
fn transferred(before: &Controls, next: &Controls, parameters: &DVector<f64>) -> Result<DVector<f64>> {
    let own = 3 * before.points.len();
    let new: &[DVec3] = &next.points[before.points.len()..];
    let dirichlet = Dirichlet::new(&before.points, new)?;
    let of_controls = parameters.rows(0, own).into_owned();
    let moved = displacements(&dirichlet, &of_controls);
    let rest = parameters.iter().skip(own);
    let numbers: Vec<f64> = (of_controls.iter().copied())
        .chain(moved.iter().flat_map(|d| d.to_array()))
        .chain(rest.copied())
        .collect();
    Ok(DVector::from_vec(numbers))
}

/// Root mean square change along normals around each vertex, from one fit to the next.
fn changes(mesh: &TriangleMesh, before: &ShellFit, fit: &ShellFit) -> Result<Vec<f64>> {
    let moved = TriangleMesh { positions: fit.positions.clone(), triangles: mesh.triangles.clone() };
    let squares: Vec<f64> = (moved.vertex_normals().iter().zip(&fit.positions).zip(&before.positions))
        .map(|((normal, after), before)| (*after - *before).dot(*normal).powi(2))
        .collect();
    let tree = PointTree::new(&fit.positions)?;
    let around = |at: &DVec3| {
        let near = tree.nearest(*at, CHANGE_NEIGHBOURS);
        let sum: f64 = near.iter().map(|(_, v)| squares[*v as usize]).sum();
        (sum / near.len().max(1) as f64).sqrt()
    };
    Ok(fit.positions.par_iter().map(around).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controls::automatic_controls;
    use planish_mesh::icosphere;

    /// A region needs more controls for significant shape or rejected points, as far as it has points.
    #[test]
    fn regions_with_shape_need_closer_controls() {
        let noise = VertexResiduals { points: 100, squares: 105.0, products: 8.0, ..Default::default() };
        assert_eq!(ratio_of_distances(&noise), None);
        let shape = VertexResiduals { squares: 200.0, products: 100.0, ..noise };
        let found = ratio_of_distances(&shape).unwrap();
        assert!((found - 0.3_f64.sqrt()).abs() < 1e-9, "{found}");
        assert_eq!(
            ratio_of_distances(&VertexResiduals { points: 10, squares: 20.0, products: 10.0, ..noise }),
            None
        );
        let rejected = VertexResiduals { unfollowed: 10, unfollowed_squares: 900.0, ..noise };
        assert_eq!(ratio_of_distances(&rejected), Some(CLOSER.0));
        assert_eq!(ratio_of_distances(&VertexResiduals::default()), None);
    }

    /// More controls continue an affine motion of the former ones exactly, and keep other parameters.
    #[test]
    fn motions_are_transferred_to_more_controls() {
        let ball = icosphere(1.0, 3);
        let [before, next] = [20, 50].map(|count| automatic_controls(&ball, count).unwrap());
        let moved = |p: &DVec3| DVec3::new(0.2 * p[1] + 0.1, 0.5 * p[0], p[2] - 0.3 * p[1]);
        let numbers = |controls: &Controls| -> Vec<f64> {
            controls.points.iter().flat_map(|p| moved(p).to_array()).chain([7.0, 8.0]).collect()
        };
        let found = transferred(&before, &next, &DVector::from_vec(numbers(&before))).unwrap();
        assert!((found - DVector::from_vec(numbers(&next))).amax() < 1e-9);
    }
}
