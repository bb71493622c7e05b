//! Bounding boxes of curves, and groups of curves whose boxes touch.

use super::SheetBox;
use planish_estimate::{Error, Result};

/// Minimum gap between two views, relative to the size of the sheet.
///
/// A larger value joins views that are close together; a smaller one splits views at gaps in their lines.
const MIN_GAP: f64 = 2e-3;

/// Maximum number of groups while curves are joined. Each curve is compared with all groups.
const MAX_GROUPS: usize = 2000;

/// Curves whose bounding boxes touch.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CurveGroup {
    pub curves: Vec<usize>,
    pub bounds: SheetBox,
    /// Whether a part of it is hatched.
    pub is_section: bool,
}

impl CurveGroup {
    /// Width or height.
    pub(super) fn extent(&self, axis: usize) -> f64 {
        self.bounds[axis][1] - self.bounds[axis][0]
    }
}

pub(super) fn joined_box(boxes: impl IntoIterator<Item = SheetBox>) -> SheetBox {
    boxes.into_iter().fold([[f64::MAX, f64::MIN]; 2], |all, own| {
        [0, 1].map(|k| [all[k][0].min(own[k][0]), all[k][1].max(own[k][1])])
    })
}

/// The larger side of the box around all boxes.
pub(super) fn size_of_boxes(boxes: &[SheetBox]) -> f64 {
    joined_box(boxes.iter().copied()).iter().map(|s| s[1] - s[0]).fold(0.0, f64::max)
}

pub(super) fn touch(a: &SheetBox, b: &SheetBox, gap: f64) -> bool {
    (0..2).all(|k| a[k][0] <= b[k][1] + gap && b[k][0] <= a[k][1] + gap)
}

pub(super) fn is_within(inner: &SheetBox, outer: &SheetBox, gap: f64) -> bool {
    (0..2).all(|k| inner[k][0] >= outer[k][0] - gap && inner[k][1] <= outer[k][1] + gap)
}

/// Groups of the given curves, in the order of their first curves.
///
/// # Errors
/// `Input` for more than [`MAX_GROUPS`].
pub(super) fn grouped(curves: &[usize], boxes: &[SheetBox], size: f64) -> Result<Vec<CurveGroup>> {
    let mut groups: Vec<CurveGroup> = Vec::new();
    let gap = MIN_GAP * size;
    // Long curves first, because nearly all others then join the group of an outline at once. The result does
    // not depend on the order.
    let extent = |k: usize| boxes[k].iter().map(|s| s[1] - s[0]).fold(0.0, f64::max);
    let mut order = curves.to_vec();
    order.sort_by(|a, b| extent(*b).total_cmp(&extent(*a)));
    for index in order {
        let mut joined = CurveGroup { curves: vec![index], bounds: boxes[index], is_section: false };
        // A joined box is larger and may touch further groups, so this repeats until none touches it.
        while let Some(at) = groups.iter().position(|group| touch(&group.bounds, &joined.bounds, gap)) {
            let mut other = groups.swap_remove(at);
            // The longer list grows, so that a curve is copied a few times only.
            if other.curves.len() > joined.curves.len() {
                std::mem::swap(&mut other.curves, &mut joined.curves);
            }
            joined.curves.extend(other.curves);
            joined.bounds = joined_box([joined.bounds, other.bounds]);
        }
        groups.push(joined);
        if groups.len() > MAX_GROUPS {
            return Err(Error::input(format!(
                "expected two or three separate views on one sheet, found more than {MAX_GROUPS} groups of \
                 lines that do not touch"
            )));
        }
    }
    // Once at the end: groups may be joined many times.
    groups.iter_mut().for_each(|group| group.curves.sort_unstable());
    groups.sort_by_key(|g| g.curves[0]);
    Ok(groups)
}
