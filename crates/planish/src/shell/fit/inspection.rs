//! What of a fit's input cannot be meant, and what of its outcome should be looked at.
//!
//! Input: the mesh and the readings of a frame before the fit; what was found after it. Output: an error
//! where readings and mesh are of other sizes or places, and words for a user. Not guaranteed: that what
//! passes is right; half an object in the right place looks like the whole of a smaller one.

use super::input::Frame;
use super::{ReadingsReport, ShellFitReport};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_mesh::{BoundingBox, MeshSearch, TriangleMesh, quantile_of_sorted};
use planish_report::numbers::{counted, percent, significant};
use planish_shell::intersection_over_union;
use rayon::prelude::*;

/// Maximum size of the points relative to the mesh. Larger points probably have another unit.
const MAX_SIZE_RATIO: f64 = 8.0;
/// And those that reach over less than this share of it; a part of an object may be small.
const SMALLER: f64 = 1.0 / 100.0;
/// Half of the points are within this distance of the mesh, in its sizes.
const FAR: f64 = 0.25;
/// Approximate number of points that are sampled for distances.
const DISTANCE_SAMPLES: usize = 1000;
/// This share of points, in either direction, may be anything.
const WILD: usize = 10;
/// Ratio of estimated to stated σ (or its inverse) beyond which a warning is given.
const MISSTATED: f64 = 3.0;
/// A mask that a mesh agrees with by less before the fit is not that view's.
const UNLIKE: f64 = 0.05;
/// Overlap after the fit below which the mask counts as not matched.
const NOT_REACHED: f64 = 0.5;
/// The axis of a camera is within this share of the picture about its middle.
const OFF_AXIS: f64 = 0.25;
/// An object covers less of a picture's frame than this.
const AT_FRAME: f64 = 0.5;

/// Whether points can be of the mesh: neither a hundred times larger or smaller, nor far off.
///
/// # Errors
/// `Undetermined` where they cannot.
pub(super) fn points_and_mesh(frame: &Frame, mesh: &TriangleMesh, unit: Unit) -> Result<()> {
    let Some(of_mesh) = mesh.surface_bounds().filter(|b| b.diagonal() > 0.0) else {
        return Ok(());
    };
    let Some(of_points) = most_of(frame) else {
        return Ok(());
    };
    let (size, reach) = (of_mesh.diagonal(), of_points.diagonal());
    let [size_text, reach_text] = [size, reach].map(|length| significant(length, 3));
    if reach > MAX_SIZE_RATIO * size || reach < SMALLER * size {
        return Err(Error::undetermined(format!(
            "the points reach over {reach_text} {unit}, the mesh over {size_text} {unit}: needed one unit \
             (--unit is that of files that name none), or a mesh of the thing's size"
        )));
    }
    let search = MeshSearch::try_new(mesh)?;
    let step = (frame.points.len() / DISTANCE_SAMPLES).max(1);
    let mut away: Vec<f64> = (frame.points.par_iter().step_by(step))
        .filter_map(|p| search.closest(p.at).map(|foot| foot.distance))
        .collect();
    away.sort_unstable_by(f64::total_cmp);
    let median = quantile_of_sorted(&away, 0.5);
    if median > (FAR * size).min(reach) {
        return Err(Error::undetermined(format!(
            "half of the points are more than {} {unit} from the mesh, which reaches over {size_text} \
             {unit}, and they over {reach_text} {unit}: bring both into one frame and unit first",
            significant(median, 3)
        )));
    }
    Ok(())
}

/// The box of all points but the tenth that is farthest out, each way along each axis.
fn most_of(frame: &Frame) -> Option<BoundingBox> {
    let count = frame.points.len();
    if count < WILD {
        return None;
    }
    let along = |axis: usize| {
        let mut values: Vec<f64> = frame.points.iter().map(|p| p.at[axis]).collect();
        values.sort_unstable_by(f64::total_cmp);
        [values[count / WILD], values[count - 1 - count / WILD]]
    };
    let ends = [0, 1, 2].map(along);
    BoundingBox::from_points(&[ends.map(|e| e[0]), ends.map(|e| e[1])])
}

/// Warnings about masks before the fit. `should_show`: also check that the mesh is visible in them (not for a
/// rough start).
pub(super) fn masks(frame: &Frame, mesh: &TriangleMesh, should_show: bool) -> Vec<String> {
    let mut words = Vec::new();
    for ((view, mask), fitted) in frame.views.iter().zip(&frame.masks).zip(&frame.fitted) {
        let Some(mask) = mask else { continue };
        let name = &view.name;
        let share = at_frame(&mask.mask, mask.columns, mask.rows);
        if share > AT_FRAME {
            words.push(format!(
                "view {name}: {} of the mask's frame is the thing: is the mask inverted? The thing is what \
                 is brighter than its threshold",
                percent(share)
            ));
        }
        if should_show
            && intersection_over_union(mesh, &fitted.camera, &mask.mask, mask.columns, mask.rows) < UNLIKE
        {
            let middle = [fitted.camera.pinhole.k[0][2], fitted.camera.pinhole.k[1][2]];
            let picture = [mask.columns as f64, mask.rows as f64];
            // In calibrations from projection matrices, the optical axis may be anywhere. Alone, it is no
            // evidence of an error.
            let off_axis = (0..2).any(|k| (middle[k] - 0.5 * picture[k]).abs() > OFF_AXIS * picture[k]);
            words.push(format!(
                "view {name}: the mesh shows next to nowhere in its mask before the fit: is it the mask of \
                 another view, or the camera or the mesh in another unit or frame?{}",
                match off_axis {
                    true => format!(
                        " The camera's axis meets the picture at {:.0}, {:.0}, and the mask has {} × {} \
                         pixels: K may be of a picture of another size",
                        middle[0], middle[1], mask.columns, mask.rows
                    ),
                    false => String::new(),
                }
            ));
        }
    }
    words
}

/// The share of a picture's outermost pixels that a mask has.
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
    found: &[[f64; 3]],
    states_sigma: bool,
    believed: bool,
) -> Vec<String> {
    let mut words = Vec::new();
    for (what, report) in [("points", &done.points), ("outlines", &done.outlines)] {
        let Some(report) = report else { continue };
        if 3 * report.outliers > report.count {
            words.push(format!(
                "{} of {} {what} are gross errors: the mesh may have too few controls for the thing, or \
                 have started too far away",
                report.outliers, report.count
            ));
        }
    }
    if let Some(points) = done.points.filter(|_| states_sigma) {
        words.extend(misstated(&points, believed));
    }
    for (view, iou) in done.iou.iter().filter(|(_, iou)| **iou < NOT_REACHED) {
        words.push(format!(
            "view {view}: what the mesh shows agrees with its mask by {} only (intersection over union): \
             see whether the mask is that view's",
            significant(*iou, 2)
        ));
    }
    let distortion = mesh.distortion(found);
    if distortion.folds > 0 {
        words.push(format!(
            "{} of the mesh folded over: bent by less than a right angle before, by more than 120° now; \
             fewer controls hold it smoother",
            counted(distortion.folds, "edge")
        ));
    }
    if distortion.stretched > 0 {
        words.push(format!(
            "{} grew by four times what the others did, and more: see whether there are spikes, which fewer \
             controls or more points prevent",
            counted(distortion.stretched, "edge")
        ));
    }
    words
}

fn misstated(points: &ReadingsReport, believed: bool) -> Option<String> {
    let factor = points.sigma_factor;
    let grossly = !(1.0 / MISSTATED..=MISSTATED).contains(&factor);
    (grossly && !believed).then(|| {
        format!(
            "the points' residuals are {} of what their σ say: that was taken (--believe-sigma takes σ as \
             stated)",
            match factor > 1.0 {
                true => format!("{} times", significant(factor, 2)),
                false => percent(factor),
            }
        )
    })
}
