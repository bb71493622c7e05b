//! Checks of the input of a fit, and findings about its result.
//!
//! Input: the mesh and the readings of a frame before the fit; what was found after it. Output: an error
//! where readings and mesh are of other sizes or places, and findings. Not guaranteed: that what
//! passes is right; half an object in the right place looks like the whole of a smaller one.

use super::input::Frame;
use super::{ReadingsReport, ShellFitReport};
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_mesh::{BoundingBox, MeshSearch, TriangleMesh, quantile_of_sorted};
use planish_report::numbers::{counted, percent, significant};
use planish_shell::{ShellFit, intersection_over_union};
use rayon::prelude::*;

/// Maximum size of the points relative to the mesh. Larger points probably have another unit.
const MAX_SIZE_RATIO: f64 = 8.0;
/// Minimum size of the points relative to the mesh. The points may belong to a small part of the object, so
/// this limit is wider than the upper one.
const MIN_SIZE_RATIO: f64 = 1.0 / 100.0;
/// Maximum median distance of the points from the mesh, relative to its size. Fits start from within a tenth;
/// beyond a quarter, frames or units differ.
const MAX_MEDIAN_DISTANCE: f64 = 0.25;
/// Number of landmarks that determine a position and a rotation.
const MIN_LANDMARKS: usize = 3;
/// Approximate number of points that are sampled for distances.
const DISTANCE_SAMPLES: usize = 1000;
/// One in this many points is ignored at each end of each axis: a few outliers must not decide the size.
const TRIMMED_ONE_IN: usize = 10;
/// Factors between the estimated and the stated σ that are not reported. A σ that is too small biases the
/// fusion, so the upper limit is narrower.
pub(super) const ACCEPTED_FACTORS: [f64; 2] = [1.0 / 3.0, 1.5];
/// Minimum share of points off the mesh that agree with their neighbours, above which they are reported: a
/// few gross errors do by chance.
const MIN_UNFOLLOWED_SHARE: f64 = 0.01;
/// The same, from which a fit is refused.
const MAX_UNFOLLOWED_SHARE: f64 = 0.05;
/// Minimum rms distance of these points from the mesh, relative to its size, for a refusal. Exact points show
/// deviations that matter little, as of a part that was asked to stay rigid.
const MIN_UNFOLLOWED_DISTANCE: f64 = 0.01;
/// Maximum share of the mesh's area that is stretched in one direction more than twice as much as in the
/// other while it folds. Fits that ended at a wrong position have 10 % and more, others 0.3 %.
const MAX_STRAINED_SHARE: f64 = 0.03;
/// Ratio of the σ of points by their residuals to the stated one, above which the mesh does not follow them.
/// Sensors are rarely that much worse than stated.
const MAX_FACTOR: f64 = 3.0;
/// Minimum number of points for each control. With 150 points for 60 controls, 0.80 to 0.94 of the vertices
/// of six fits were within 1.96 σ.
const MIN_POINTS_PER_CONTROL: usize = 8;
/// Minimum overlap of a held-out view with its mask that is reported as good.
pub(super) const MIN_OVERLAP: f64 = 0.9;
/// Minimum overlap with a mask before the fit. A smaller one means another view, unit or frame.
const MIN_INITIAL_OVERLAP: f64 = 0.05;
/// Overlap after the fit below which the mask counts as not matched. Half of the pixels differ then, which no
/// inaccurate σ explains.
const MIN_FITTED_OVERLAP: f64 = 0.5;
/// Maximum distance of the optical axis from the middle of the picture, relative to its size.
const MAX_AXIS_OFFSET: f64 = 0.25;
/// Maximum fraction of the outermost pixels that belong to the object. More means an inverted mask.
const MAX_FRAME_SHARE: f64 = 0.5;

/// Refuses points that cannot belong to the mesh: of another size, or far away.
///
/// # Errors
/// `Undetermined` for such points.
pub(super) fn points_and_mesh(frame: &Frame, mesh: &TriangleMesh, unit: Unit) -> Result<()> {
    let Some(of_mesh) = mesh.surface_bounds().filter(|b| b.diagonal() > 0.0) else {
        return Ok(());
    };
    let Some(of_points) = trimmed_bounds(frame) else {
        return Ok(());
    };
    let (size, reach) = (of_mesh.diagonal(), of_points.diagonal());
    let [size_text, reach_text] = [size, reach].map(|length| significant(length, 3));
    // An error: a wrong unit is far more likely than an object that differs so much from its mesh.
    if reach > MAX_SIZE_RATIO * size || reach < MIN_SIZE_RATIO * size {
        return Err(Error::undetermined(format!(
            "expected points and a mesh of similar size, found extents of {reach_text} {unit} and \
             {size_text} {unit}: check the units"
        ))
        .with_setting(Setting::Unit));
    }
    // Landmarks bring the mesh to its points.
    if frame.landmarks.len() >= MIN_LANDMARKS {
        return Ok(());
    }
    let search = MeshSearch::try_new(mesh)?;
    // A median of a thousand distances is accurate enough for a limit of a quarter of the size.
    let step = (frame.points.len() / DISTANCE_SAMPLES).max(1);
    let mut away: Vec<f64> = (frame.points.par_iter().step_by(step))
        .filter_map(|p| search.closest(p.at).map(|foot| foot.distance))
        .collect();
    away.sort_unstable_by(f64::total_cmp);
    let median = quantile_of_sorted(&away, 0.5);
    // Points of a small part must also be nearer than their own extent.
    if median > (MAX_MEDIAN_DISTANCE * size).min(reach) {
        return Err(Error::undetermined(format!(
            "expected points near the mesh, found half of them more than {} {unit} away (extent of the \
             mesh {size_text} {unit}, of the points {reach_text} {unit}): bring both into one frame and \
             unit first",
            significant(median, 3)
        )));
    }
    Ok(())
}

/// The box of all points except the outer tenth at each end of each axis.
fn trimmed_bounds(frame: &Frame) -> Option<BoundingBox> {
    let count = frame.points.len();
    if count < TRIMMED_ONE_IN {
        return None;
    }
    let along = |axis: usize| {
        let mut values: Vec<f64> = frame.points.iter().map(|p| p.at[axis]).collect();
        values.sort_unstable_by(f64::total_cmp);
        [values[count / TRIMMED_ONE_IN], values[count - 1 - count / TRIMMED_ONE_IN]]
    };
    let ends = [0, 1, 2].map(along);
    BoundingBox::from_points(&[DVec3::from(ends.map(|e| e[0])), DVec3::from(ends.map(|e| e[1]))])
}

/// Warnings about masks before the fit. `should_show`: also check that the mesh is visible in them (not for a
/// rough start).
pub(super) fn masks(frame: &Frame, mesh: &TriangleMesh, should_show: bool) -> Vec<Finding> {
    let mut findings = Vec::new();
    for ((view, mask), fitted) in frame.views.iter().zip(&frame.masks).zip(&frame.fitted) {
        let Some(mask) = mask else { continue };
        let name = &view.name;
        let share = at_frame(&mask.mask, mask.columns, mask.rows);
        if share > MAX_FRAME_SHARE {
            let text = format!(
                "view {name}: {} of the border of the mask image belongs to the object: check that the \
                 mask is not inverted; the object must be brighter than the threshold",
                percent(share)
            );
            findings.push(Finding::new(FindingCode::MaskInverted, text));
        }
        // A rough start grows into its masks, so a small overlap is no evidence there.
        if should_show
            && intersection_over_union(mesh, &fitted.camera, &mask.mask, mask.columns, mask.rows)
                < MIN_INITIAL_OVERLAP
        {
            let middle = [fitted.camera.pinhole.k[0][2], fitted.camera.pinhole.k[1][2]];
            let picture = [mask.columns as f64, mask.rows as f64];
            // In calibrations from projection matrices, the optical axis may be anywhere. Alone, it is no
            // evidence of an error.
            let off_axis =
                (0..2).any(|k| (middle[k] - 0.5 * picture[k]).abs() > MAX_AXIS_OFFSET * picture[k]);
            findings.push(Finding::new(
                FindingCode::MaskMismatch,
                format!(
                    "view {name}: the mesh hardly overlaps its mask before the fit: check that the mask \
                     belongs to this view, and that camera and mesh have the same unit and frame{}",
                    match off_axis {
                        true => format!(
                            "; the optical axis meets the image at {:.0}, {:.0}, but the mask has {} × {} \
                             pixels: K may belong to an image of another size",
                            middle[0], middle[1], mask.columns, mask.rows
                        ),
                        false => String::new(),
                    }
                ),
            ));
        }
    }
    findings
}

/// The share of the outermost pixels of a picture that belong to the mask.
fn at_frame(mask: &[bool], columns: usize, rows: usize) -> f64 {
    let frame = |k: &usize| {
        let (column, row) = (k % columns, k / columns);
        row == 0 || column == 0 || row + 1 == rows || column + 1 == columns
    };
    let outer: Vec<usize> = (0..mask.len()).filter(frame).collect();
    outer.iter().filter(|k| mask[**k]).count() as f64 / outer.len().max(1) as f64
}

/// Warnings after the fit. `states_sigma`: whether points state their own σ.
pub(super) fn outcome(
    done: &ShellFitReport,
    mesh: &TriangleMesh,
    found: &[DVec3],
    states_sigma: bool,
    trusts_sigma: bool,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (what, report) in [("points", &done.points), ("outlines", &done.outlines)] {
        let Some(report) = report else { continue };
        // So many are rarely gross errors. More often the controls cannot follow the shape, or the start is
        // far off.
        if 3 * report.outliers > report.count {
            findings.push(Finding::new(
                FindingCode::ManyOutliers,
                format!(
                    "{} of {} {what} are outliers: the mesh may have too few controls for the object, or \
                     start too far away",
                    report.outliers, report.count
                ),
            ));
        }
    }
    for (what, report) in [("points", &done.points), ("outlines", &done.outlines), ("tracks", &done.tracks)] {
        // Points without σ have an assumed one, and there is nothing to judge.
        if let Some(report) = report.filter(|_| what != "points" || states_sigma) {
            findings.extend(misstated(what, &report, trusts_sigma));
        }
    }
    findings.extend(done.points.as_ref().and_then(|points| unresolved(done, points)));
    findings.extend(done.points.as_ref().and_then(|points| sparse(done, points)));
    for (view, iou) in done.iou.iter().filter(|(_, iou)| **iou < MIN_FITTED_OVERLAP) {
        findings.push(Finding::new(
            FindingCode::MaskNotReached,
            format!(
                "view {view}: the overlap of the mesh with its mask is only {} (intersection over union): \
                 check that the mask belongs to this view",
                significant(*iou, 2)
            ),
        ));
    }
    // Folds and spikes are warnings: the mesh is still the best answer, and the page shows where they are.
    let distortion = mesh.distortion(found);
    if distortion.folds > 0 {
        findings.push(Finding::new(
            FindingCode::MeshFolded,
            format!(
                "{} of the mesh folded over (bent by less than 90° before and by more than 120° now): use \
                 fewer controls for a smoother deformation",
                counted(distortion.folds, "edge")
            ),
        ));
    }
    if distortion.stretched > 0 {
        let text = format!(
            "{} grew at least four times as much as other edges: check for spikes; fewer controls or more \
             points prevent them",
            counted(distortion.stretched, "edge")
        );
        findings.push(Finding::new(FindingCode::MeshStretched, text));
    }
    findings
}

/// True if a fit, of a mesh, probably ended at the right position: few points agree with their neighbours but
/// not with the mesh, residuals are not far above the stated σ, and the mesh is not both strained and folded.
pub(super) fn follows(fit: &ShellFit, mesh: &TriangleMesh, states_sigma: bool) -> bool {
    let share = fit.unfollowed_points as f64 / fit.points.outliers.len().max(1) as f64;
    share < MIN_UNFOLLOWED_SHARE
        && !(states_sigma && fit.points.sigma_factor > MAX_FACTOR)
        && !is_strained(fit, mesh)
}

/// True if much of a mesh is strained and it folds: its points are near it, but those of other places.
fn is_strained(fit: &ShellFit, mesh: &TriangleMesh) -> bool {
    fit.strained_share > MAX_STRAINED_SHARE && mesh.distortion(&fit.positions).folds > 0
}

/// A finding if the mesh, of a size, does not follow surface that the points of a frame show. `name` is that
/// of the frame of a sequence, or empty.
///
/// # Errors
/// `Undetermined` for a single fit that is far from much of the surface, unless `force` keeps it. Later
/// frames of a sequence may be right again.
pub(super) fn unfollowed(
    fit: &ShellFit,
    frame: &Frame,
    (mesh, size): (&TriangleMesh, f64),
    name: &str,
    force: bool,
) -> Result<Option<Finding>> {
    let (count, all) = (fit.unfollowed_points as f64, fit.points.outliers.len() as f64);
    let place = if name.is_empty() { String::new() } else { format!("frame {name}: ") };
    if all == 0.0 || count < MIN_UNFOLLOWED_SHARE * all {
        let text = format!(
            "{place}{} of the mesh is stretched in one direction more than twice as much as in the other, \
             and it folds: parts probably ended at a wrong position",
            percent(fit.strained_share)
        );
        return Ok(is_strained(fit, mesh).then(|| Finding::new(FindingCode::SurfaceNotFollowing, text)));
    }
    let text = format!(
        "{place}{count} of {all} points ({}) agree with their neighbours but not with the mesh: it does not \
         follow the object there (`observed` is 3), or ended at a wrong position; parts that turn far need a \
         nearer start, small shapes more controls",
        percent(count / all.max(1.0))
    );
    let is_far = unfollowed_distance(fit, frame) > MIN_UNFOLLOWED_DISTANCE * size;
    if !name.is_empty() || count < MAX_UNFOLLOWED_SHARE * all || !is_far {
        return Ok(Some(Finding::new(FindingCode::SurfaceNotFollowing, text)));
    }
    if !force {
        let text = format!("{text}; a result can be forced, but is wrong there");
        return Err(Error::undetermined(text).with_setting(Setting::Force));
    }
    Ok(Some(Finding::new(FindingCode::SurfaceRefused, text)))
}

/// Root mean square distance from the mesh of the points that it does not follow, for the mean σ of a point.
fn unfollowed_distance(fit: &ShellFit, frame: &Frame) -> f64 {
    let sums = fit.residuals_at.iter().fold((0.0, 0.0), |(squares, count), at| {
        (squares + at.unfollowed_squares, count + f64::from(at.unfollowed))
    });
    let variances: f64 = frame.points.iter().map(|p| p.covariance.trace() / 3.0).sum();
    (sums.0 / sums.1.max(1.0) * variances / frame.points.len().max(1) as f64).sqrt()
}

/// A finding for each landmark that was rejected.
pub(super) fn rejected_landmarks(fit: &ShellFit, frame: &Frame, unit: Unit) -> Vec<Finding> {
    let rejected = fit.landmarks.outliers.iter().zip(&frame.landmarks).zip(&frame.landmark_names);
    (rejected.filter(|((outlier, _), _)| **outlier))
        .map(|((_, landmark), name)| {
            let place = landmark.place(&fit.positions);
            let text = format!(
                "landmark {name}: its place on the fitted mesh is {} {unit} away from the measured position, \
                 much more than its σ: it was not used; check its place and σ",
                significant(place.distance(landmark.at), 3)
            );
            Finding::new(FindingCode::LandmarkRejected, text)
        })
        .collect()
}

/// A finding if the residuals contradict the stated σ.
fn misstated(what: &str, report: &ReadingsReport, trusts_sigma: bool) -> Option<Finding> {
    let factor = report.sigma_factor;
    if (ACCEPTED_FACTORS[0]..=ACCEPTED_FACTORS[1]).contains(&factor) {
        return None;
    }
    let times = match factor > 1.0 {
        true => format!("{} times", significant(factor, 2)),
        false => percent(factor),
    };
    let used = if trusts_sigma { "the stated σ was used, as asked" } else { "the estimate was used" };
    let text = format!(
        "the residuals indicate that σ of {what} is {times} the stated value: the stated σ is wrong, or \
         there are too few controls; {used}"
    );
    Some(Finding::new(FindingCode::SensorSigmaMisstated, text).with_setting(Setting::BelieveSigma))
}

/// A finding if neighbouring points have residuals in common that are larger than the rest of them.
fn unresolved(done: &ShellFitReport, points: &ReadingsReport) -> Option<Finding> {
    let (shape, unit) = (done.unresolved_shape, done.unit);
    // The square of the rms residual is that of noise and shape together.
    (2.0 * shape * shape > points.rms * points.rms).then(|| {
        let text = format!(
            "residuals of neighbouring points agree: shape of σ = {} {unit} is finer than the distances of \
             the controls, or errors of the points are correlated; σ contains it on average, not place by \
             place: use more controls if it is shape",
            significant(shape, 2)
        );
        Finding::new(FindingCode::UnresolvedShape, text)
    })
}

/// A finding if there are few points for the controls of the mesh.
fn sparse(done: &ShellFitReport, points: &ReadingsReport) -> Option<Finding> {
    let used = points.count - points.outliers;
    (used < MIN_POINTS_PER_CONTROL * done.controls && done.outlines.is_none()).then(|| {
        let text = format!(
            "{used} points for {}: fewer than {MIN_POINTS_PER_CONTROL} for each leave much of the shape to \
             smoothness, and σ is less certain: measure more points, or use fewer controls",
            counted(done.controls, "control")
        );
        Finding::new(FindingCode::ReadingsSparse, text)
    })
}

/// Findings about the end of the fit and about views that were held out.
pub(super) fn ending(done: &ShellFitReport) -> Vec<Finding> {
    let mut found = Vec::new();
    for view in &done.held_out {
        if let Some(share) = done.iou.get(view) {
            let code = match *share < MIN_OVERLAP {
                true => FindingCode::HeldOutViewMisfit,
                false => FindingCode::HeldOutView,
            };
            let text = format!("held-out view {view}: the overlap with its mask is {}", percent(*share));
            found.push(Finding::new(code, text));
        }
    }
    let iterations = counted(done.iterations, "iteration");
    found.extend(match done.termination {
        // A finding about the points says more.
        "not_following" => None,
        "limit" => {
            Some(Finding::new(FindingCode::NotConverged, format!("the fit did not converge in {iterations}")))
        }
        _ => Some(Finding::new(FindingCode::Converged, format!("the fit converged in {iterations}"))),
    });
    found
}
