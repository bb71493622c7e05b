//! Separates the views of a sheet.
//!
//! Input: curves of one file, and the convention by which the views are placed. Output: a [`Drawing`] of
//! two or three views in the part's coordinates, with the lower left corner of each view at the origin. A
//! view consists of the curves whose bounding boxes touch; different views have a gap between them.
//!
//! Limits: sheets with a frame, auxiliary views and sections are rejected, as they align with no other view.

use crate::drawing::{Curve2, Drawing, DrawnCurve, View, ViewKind};
use planish_estimate::{Error, Result};

/// Minimum gap between two views, relative to the size of the sheet.
///
/// A larger value joins views that are close together; a smaller one splits views at gaps in their lines.
const MIN_GAP: f64 = 2e-3;
/// Maximum difference of aligned sides of two views, relative to the size of the sheet.
///
/// A larger value accepts views of different scales; a smaller one rejects inaccurate drawings.
const MAX_MISALIGNMENT: f64 = 2e-3;

/// Maximum number of groups while curves are joined. Each curve is compared with all groups.
const MAX_GROUPS: usize = 2000;

/// Placement of the views around the front view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Projection {
    /// Used in Europe: the view from above is below the front view, that from the left is at its right.
    FirstAngle,
    /// Used in America: the view from above is above the front view, that from the right is at its right.
    ThirdAngle,
}

/// Curves whose bounding boxes touch.
struct CurveCluster {
    curves: Vec<usize>,
    /// Left, right; bottom, top.
    span: [[f64; 2]; 2],
}

/// Finds the views of a sheet.
///
/// ```
/// use planish_solid::views::{Curve2, DrawnCurve, LineStyle, Projection, ViewKind, views_of_sheet};
///
/// let rectangle = |x: f64, y: f64, width: f64, height: f64| {
///     let corners = [[x, y], [x + width, y], [x + width, y + height], [x, y + height]];
///     (0..4).map(move |k| DrawnCurve {
///         curve: Curve2::Segment(corners[k], corners[(k + 1) % 4]),
///         style: LineStyle::Visible,
///         entity: format!("line {k}"),
///     })
/// };
/// // The view from above is placed above the front view.
/// let front = rectangle(0.0, 0.0, 40.0, 20.0);
/// let sheet: Vec<_> = front.chain(rectangle(0.0, 50.0, 40.0, 30.0)).collect();
/// let drawing = views_of_sheet(&sheet, Projection::ThirdAngle)?;
/// let kinds: Vec<_> = drawing.views.iter().map(|v| v.kind).collect();
/// assert_eq!(kinds, [ViewKind::Front, ViewKind::Top]);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # Errors
/// `Input` if there are fewer than two groups of curves, or a group is not where the convention places a
/// view. The message names an entity of the group.
pub fn views_of_sheet(curves: &[DrawnCurve], projection: Projection) -> Result<Drawing> {
    let groups = groups(curves)?;
    let (lo, hi) = groups.iter().fold((f64::MAX, f64::MIN), |(lo, hi), g| {
        (lo.min(g.span[0][0]).min(g.span[1][0]), hi.max(g.span[0][1]).max(g.span[1][1]))
    });
    let near = MAX_MISALIGNMENT * (hi - lo);
    let aligned = |a: &CurveCluster, b: &CurveCluster, k: usize| {
        (0..2).all(|e| (a.span[k][e] - b.span[k][e]).abs() <= near)
    };
    // Stacked views share their left and right sides, neighbours beside each other their lower and upper
    // ones.
    let stacked = |a: usize, b: usize| a != b && aligned(&groups[a], &groups[b], 0);
    let side_by_side = |a: usize, b: usize| a != b && aligned(&groups[a], &groups[b], 1);
    let n = groups.len();
    let front = match (projection, n) {
        (_, 0 | 1) => {
            return Err(Error::input(format!(
                "expected two or three separate views on one sheet, found {n}: specify the files of all \
                 views if each view has its own"
            )));
        }
        // Of two views, the convention tells which one is the front view: stacked views are front and top,
        // views beside each other front and side.
        (_, 2) => {
            let lower = usize::from(groups[0].span[1][0] > groups[1].span[1][0]);
            let left = usize::from(groups[0].span[0][0] > groups[1].span[0][0]);
            match (stacked(0, 1), projection) {
                (true, Projection::FirstAngle) => 1 - lower,
                (true, Projection::ThirdAngle) => lower,
                (false, _) => left,
            }
        }
        // The front view is the corner of the L that three views form.
        _ => (0..n)
            .find(|f| (0..n).any(|g| stacked(*f, g)) && (0..n).any(|g| side_by_side(*f, g)))
            .unwrap_or(0),
    };
    let mut views = vec![placed(curves, &groups[front], ViewKind::Front)];
    for g in (0..n).filter(|g| *g != front) {
        let is_above = groups[g].span[1][0] > groups[front].span[1][0];
        let is_right = groups[g].span[0][0] > groups[front].span[0][0];
        let kind = match (stacked(front, g), side_by_side(front, g), projection) {
            (true, _, Projection::FirstAngle) if !is_above => Some(ViewKind::Top),
            (true, _, Projection::ThirdAngle) if is_above => Some(ViewKind::Top),
            (_, true, Projection::FirstAngle) => Some(if is_right { ViewKind::Left } else { ViewKind::Side }),
            (_, true, Projection::ThirdAngle) => Some(if is_right { ViewKind::Side } else { ViewKind::Left }),
            _ => None,
        };
        let name = &curves[groups[g].curves[0]].entity;
        let Some(kind) = kind.filter(|k| views.iter().all(|v: &View| v.kind.axes() != k.axes())) else {
            let [[left, right], [bottom, top]] = groups[g].span;
            return Err(Error::input(format!(
                "{name}: expected views of one scale, aligned with the front view, found a view ({left:.3} \
                 to {right:.3}, {bottom:.3} to {top:.3}) that is neither at the position of the top view \
                 nor at that of a side view in the {} convention",
                match projection {
                    Projection::FirstAngle => "first-angle",
                    Projection::ThirdAngle => "third-angle",
                }
            )));
        };
        views.push(placed(curves, &groups[g], kind));
    }
    // Front, top, side, as in `ViewKind::ALL`; groups are in the order of the file.
    views.sort_by_key(|v| v.kind.axes() == ViewKind::Side.axes());
    Ok(Drawing { views })
}

/// Groups of curves whose boxes touch.
fn groups(curves: &[DrawnCurve]) -> Result<Vec<CurveCluster>> {
    let mut groups: Vec<CurveCluster> = Vec::new();
    let boxes: Vec<[[f64; 2]; 2]> = curves.iter().map(|c| span_of(&c.curve)).collect();
    let size = boxes.iter().flatten().fold((f64::MAX, f64::MIN), |(lo, hi), s| (lo.min(s[0]), hi.max(s[1])));
    let gap = MIN_GAP * (size.1 - size.0);
    // Long curves first, because nearly all others then join the group of an outline at once. The result does
    // not depend on the order.
    let extent = |k: usize| boxes[k].iter().map(|s| s[1] - s[0]).fold(0.0, f64::max);
    let mut order: Vec<usize> = (0..boxes.len()).collect();
    order.sort_by(|a, b| extent(*b).total_cmp(&extent(*a)));
    for index in order {
        let span = boxes[index];
        let mut joined = CurveCluster { curves: vec![index], span };
        // A joined box is larger and may touch further groups, so this repeats until none touches it.
        loop {
            let touches = |g: &CurveCluster| {
                (0..2).all(|k| {
                    g.span[k][0] <= joined.span[k][1] + gap && joined.span[k][0] <= g.span[k][1] + gap
                })
            };
            let Some(at) = groups.iter().position(touches) else {
                break;
            };
            let mut other = groups.swap_remove(at);
            // The longer list grows, so that a curve is copied a few times only.
            if other.curves.len() > joined.curves.len() {
                std::mem::swap(&mut other.curves, &mut joined.curves);
            }
            joined.curves.extend(other.curves);
            for k in 0..2 {
                joined.span[k] =
                    [joined.span[k][0].min(other.span[k][0]), joined.span[k][1].max(other.span[k][1])];
            }
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

fn span_of(curve: &Curve2) -> [[f64; 2]; 2] {
    let points = curve.points();
    [0, 1].map(|k| points.iter().fold([f64::MAX, f64::MIN], |s, p| [s[0].min(p[k]), s[1].max(p[k])]))
}

/// The curves of a group as a view, in the part's coordinates.
fn placed(curves: &[DrawnCurve], group: &CurveCluster, kind: ViewKind) -> View {
    // In a view from the left, y runs to the left. It is mirrored, so that y runs to the right in all views.
    let mirrored = kind == ViewKind::Left;
    let x = if mirrored { group.span[0][1] } else { group.span[0][0] };
    let at = |p: [f64; 2]| {
        let right = p[0] - x;
        [if mirrored { -right } else { right }, p[1] - group.span[1][0]]
    };
    View {
        kind,
        curves: group
            .curves
            .iter()
            .map(|&index| DrawnCurve {
                curve: curves[index].curve.moved(at, mirrored),
                ..curves[index].clone()
            })
            .collect(),
    }
}
